"""What goes in and out of the machine that pushes: samples of all driven joints, put together from messages, and commands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

SPAN_S = 0.02
"""A velocity that is not stated is the mean over at least so long: encoders are coarse, and messages may come in pairs."""


@dataclass(frozen=True)
class JointSample:
    """One reading of all driven joints."""

    time_s: float  # when it was taken, on the clock of `ExcitationMachine.tick` [s]
    position: Mapping[str, float]  # by joint [rad or m]
    velocity: Mapping[str, float]  # by joint [rad/s or m/s]
    # when positions were read, by whoever read them; only differences count [s]
    stamp_s: float = math.nan


@dataclass(frozen=True)
class Command:
    """What the servos are to do; no joint is in two of these."""

    # goals of joints that are held or moved [rad or m]
    position: dict[str, float] = field(default_factory=dict)
    # currents of joints that are pushed [A]
    current_A: dict[str, float] = field(default_factory=dict)
    # goals of joints that are pushed by a step of it [rad or m]
    stepped: dict[str, float] = field(default_factory=dict)


class JointStates:
    """Joint states of one arm, from as many publishers as it has, as samples.

    Messages about other joints are passed over; a joint that a message lacks is where it was last seen. Velocities that are missing
    or NaN (as joint_state_broadcaster sends them) follow from the positions. A position that is no number is passed on: the
    state machine stops for it.

    Args:
        joints: Of the arm.
        stale_after_s: A sample is given only while every joint that was ever seen was seen within this time [s].
    """

    def __init__(self, joints: Sequence[str], stale_after_s: float) -> None:
        self._joints = frozenset(joints)
        self._stale_after_s = stale_after_s
        self._seen_s: dict[str, float] = {}
        self._position: dict[str, float] = {}
        self._velocity: dict[str, float] = {}
        # time and position from which the mean velocity counts
        self._before: dict[str, tuple[float, float]] = {}

    def add(
        self,
        now_s: float,
        names: Sequence[str],
        position: Sequence[float],
        velocity: Sequence[float] = (),
        stamp_s: float = math.nan,
    ) -> JointSample | None:
        """One message.

        Args:
            now_s: When it came [s].
            names: Joints, in the order of the message, shape (J,).
            position: Of these, shape (J,) [rad or m].
            velocity: Of all, some or none of these, shape (J,) at most [rad/s or m/s].
            stamp_s: Of the message [s].

        Returns:
            All joints as last seen; None where the message says nothing about this arm, or one of its joints is not seen any more.
        """
        stated = dict(zip(names, velocity, strict=False))
        mine = {
            name: value
            for name, value in zip(names, position, strict=False)
            if name in self._joints
        }
        if not mine:
            return None
        if now_s < max(self._seen_s.values(), default=now_s):  # a simulation was set back
            self._seen_s = dict.fromkeys(self._seen_s, now_s)
            self._before.clear()
        for name, value in mine.items():
            self._position[name] = value
            self._seen_s[name] = now_s
            speed = stated.get(name, math.nan)
            if not math.isfinite(speed):
                speed = self._mean_velocity(name, now_s, value)
            self._velocity[name] = speed
        if now_s - min(self._seen_s.values()) > self._stale_after_s:
            return None
        return JointSample(
            now_s,
            dict(self._position),
            dict(self._velocity),
            stamp_s,
        )

    def _mean_velocity(self, name: str, now_s: float, position: float) -> float:
        """Of a joint that is at a position now, over `SPAN_S` or a little more."""
        before_s, before = self._before.setdefault(name, (now_s, position))
        span_s = now_s - before_s
        if span_s < SPAN_S:
            return self._velocity.get(name, 0.0)
        self._before[name] = (now_s, position)
        velocity = (position - before) / span_s
        return velocity if math.isfinite(velocity) else 0.0
