"""How a source is read: what its driver and the user say of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from proprio_ros.recordings.effort import Effort
from proprio_ros.recordings.topics import OUR_DRIVER, Conventions
from proprio_ros.records import Span

POSITION_UNITS = ("rad", "deg")
"""Units of the positions of a data set."""


POSITION, EFFORT, GOAL = "observation.state", "observation.effort", "action"
"""Columns of a LeRobot data set."""
TIME_UNITS = ("s", "ms", "us", "ns")
"""Units of the times of a table."""


@dataclass(frozen=True)
class Columns:
    """Which columns of a data set or a table are what.

    A data set's are vectors. Of a table ``*`` stands for the joint in a name, and those that keep their default are found by
    their headers.
    """

    # column of the joint positions; of names that end in ``.vel``, ``.torque`` and the like, only ``.pos`` counts
    position: str = POSITION
    position_unit: str | None = None  # one of `POSITION_UNITS`; None: nobody says it
    # column of the measured effort; where it is not there, names in the column of the positions that end in
    # ``.torque``, ``.effort`` or ``.current`` count
    effort: str = EFFORT
    goal: str = GOAL  # column of what the joints were sent to, in the unit of the positions
    # joints, in the driver's names, whose positions are percent of their range
    percent: tuple[str, ...] = ()
    # of a table alone
    time: str = ""
    time_unit: str | None = None  # one of `TIME_UNITS`
    velocity: str = ""
    effort_unit: str | None = None  # what effort is in, where its headers do not say it
    command: str = ""  # what drove the joints
    command_unit: str | None = None
    joints: tuple[
        str, ...
    ] = ()  # those that are numbered, in the driver's names; empty: the robot's, in its order


@dataclass(frozen=True)
class ReadOptions:
    """How a source is read."""

    # what effort of the joint states means, and with which torque constants it was published
    effort: Effort
    # the robot's joints that have a motor, in the order of an unlabelled current command
    joint_order: Sequence[str] = ()
    conventions: Conventions = OUR_DRIVER  # of the driver that published
    # topic of the joint states; None takes that of the conventions, also under a namespace, else the only one
    state_topic: str | None = None
    # topic of the input: a JointState whose effort is commanded current x nominal torque constant [N m or N], or an array of
    # currents [A]; None looks for those of the conventions, which say unit and order of the joints of either type
    command_topic: str | None = None
    # the part that is read, by the recorder's times; None: all. A command that was given before it is not known
    span: Span | None = None
    # whether names that are the robot's but for a prefix or a suffix are taken for them
    fits_names: bool = True
    states_only: bool = False  # whether to leave the input out, whatever there is of it
    # which column of a data set or a table is what; None: nobody says it, and no episode is read
    columns: Columns | None = None
    # lowest and highest position of each joint [rad or m], for those of a data set in percent
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
