"""What goes in and out of the machine that pushes: samples of all driven joints, and commands for their servos."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class JointSample:
    """One reading of all driven joints.

    Attributes:
        time_s: When it was taken, on the clock of `ExcitationMachine.tick` [s].
        position: By joint [rad or m].
        velocity: By joint [rad/s or m/s].
    """

    time_s: float
    position: Mapping[str, float]
    velocity: Mapping[str, float]


@dataclass(frozen=True)
class Command:
    """What the servos are to do; no joint is in two of these.

    Attributes:
        position: Goals of joints that are held or moved [rad or m].
        current_A: Currents of joints that are pushed [A].
        stepped: Goals of joints that are pushed by a step of it [rad or m].
    """

    position: dict[str, float] = field(default_factory=dict)
    current_A: dict[str, float] = field(default_factory=dict)
    stepped: dict[str, float] = field(default_factory=dict)
