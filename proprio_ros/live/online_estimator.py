"""Weighing while the arm works: joint states under whatever controller in, a running estimate out. No ROS here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

from proprio_ros.identification.regression.at_rest import StandingEstimator
from proprio_ros.identification.regression.online import OnlineEstimate, Stretch
from proprio_ros.live.news import WARNED_S
from proprio_ros.live.stall_current import StallCurrents
from proprio_ros.probes.base import Carried, Online
from proprio_ros.quantity import Z95, shown, spec_for
from proprio_ros.recordings.effort import ampere
from proprio_ros.recordings.motions import MOVED_RAD
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import zero_pose

_RECORD = (
    "record the arm with an empty hand while it works, run `proprio calibrate BAG --output FILE`"
)
NO_MOTIONS = f"there is no calibration of motions; {_RECORD}, and give that file as the parameter calibration"


def current_A(effort: float, unit: str, effort_per_current: float) -> float:
    """What flows in a motor by the effort of a joint state."""
    return (1.0 / effort_per_current if unit == "N.m" else ampere(unit)) * effort


def any_moved(
    states: Iterable[tuple[Sequence[str], Sequence[float]]],
    joints: Iterable[str],
) -> bool:
    """Whether any of these joints moved, by the names and positions of joint states [rad or m]."""
    seen: dict[str, list[float]] = {name: [] for name in joints}
    for names, positions in states:
        for name, position in zip(names, positions, strict=False):
            if name in seen and math.isfinite(position):
                seen[name].append(position)
    return any(max(at) - min(at) > MOVED_RAD for at in seen.values() if at)


class OnlineFeed:
    """Makes a running estimate of joint states as they come, on a robot with a calibration of motions.

    Args:
        stated: Where joints stand, whatever is heard of them [rad or m]; the robot's file says it of those that are not heard.

    Attributes:
        others: Joints that are not in the calibration and count as standing.
        waits_for: Why no joint state counted since the last that did; empty: nothing is wrong.
        samples: How many counted.
        stall: What flows in motors that a voltage drives; goals and voltage go in there.
        moved: Those of the others that are elsewhere than they count as standing.

    Raises `RobotError`: The calibration is of another arm.
    """

    def __init__(
        self,
        probe: Online[Any],
        robot: Robot,
        facts: Any,
        stated: Mapping[str, float] | None = None,
    ) -> None:
        assert robot.motion_calibration is not None
        self._stated = dict(stated or {})
        self.probe, self._robot, self._facts = probe, robot, facts
        self._per_current = {
            n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()
        }
        self.stall = StallCurrents(robot)
        self.joints = robot.motion_calibration.joints
        # whose effort counts
        self._measured = [name for name in self.joints if name not in self.stall.joints]
        self.others = [name for name in robot.model.independent_joints if name not in self.joints]
        self._make({})  # so that a calibration of another arm is refused now
        self._latest: dict[str, tuple[float, float]] = {}
        self._running: StandingEstimator | None = None
        self._unfed = Stretch(math.inf, 0.0)
        here = {
            name: at for name, at in {**robot.held, **self._stated}.items() if name in self.others
        }
        self._held = {**zero_pose(self._robot, self.others), **here}
        self.waits_for, self.samples = "", 0
        self.moved: set[str] = set()

    def _make(self, held: dict[str, float]) -> StandingEstimator:
        return self.probe.running(self._robot, self._facts, held)

    def load(self, mass_kg: float) -> Carried:
        """The rigid load of that mass, its place and shape as far as they are stated."""
        return self.probe.load(self._facts, mass_kg)

    @property
    def needs(self) -> Stretch:
        """What the estimate needs of the joint states from now on."""
        return self._unfed if self._running is None else self._running.needs

    @property
    def about(self) -> str:
        """What a user should know of it, as a sentence without its end."""
        stand = (
            f"; {', '.join(self.others)} counts as standing where it first stood"
            if self.others
            else ""
        )
        takes = (
            "measured effort of the joint states alone" if self._measured else "goals and positions"
        )
        return f"the running estimate takes {takes}{stand}"

    @property
    def warning(self) -> str:
        """What is wrong with the estimate that the newest joint state gave; empty: nothing."""
        if not self.moved:
            return ""
        elsewhere = "is not in the calibration and not where it counts as standing"
        return f"{', '.join(sorted(self.moved))} {elsewhere}: calibrate with it moving, or activate the node again"

    def add(
        self,
        time_s: float,
        names: Sequence[str],
        position: Sequence[float],
        effort: Sequence[float],
        unit: str,
    ) -> OnlineEstimate | None:
        """One joint state, of some or all joints, and the estimate, where there is a new one.

        Positions are in rad or m; the unit of efforts is ``N.m``, ``A``, ``mA`` or ``raw``, and empty where nobody says it.
        """
        heard = {name: at for name, at in zip(names, position, strict=False) if math.isfinite(at)}
        others = {
            name: at
            for name, at in heard.items()
            if name in self._held and name not in self._stated
        }
        if self._running is None:
            self._held |= others
        self.moved |= {
            name for name, at in others.items() if abs(at - self._held[name]) > MOVED_RAD
        }
        if self._measured:
            mine = {name: number for number, name in enumerate(names) if name in self._measured}
            self.waits_for = _why_not(mine, effort, unit) or self.waits_for
            if not unit:
                return None
        for name, at, said in zip_longest(
            names, position, effort[: len(names)], fillvalue=math.nan
        ):
            if name in self.stall.joints:
                self._latest[name] = (
                    at,
                    self.stall.current_A(
                        name,
                        time_s,
                        at,
                        said,
                    ),
                )
                if math.isnan(self._latest[name][1]) and name in self.joints:
                    self.waits_for = (
                        f"nobody says where {name} is sent: publish goals on joint_command, "
                        "stamped as joint states are"
                    )
            elif name in self._per_current:
                self._latest[name] = at, current_A(said, unit, self._per_current[name])
        if absent := [name for name in self.joints if name not in self._latest]:
            self.waits_for = self.waits_for or f"no joint states of {', '.join(absent)} are coming"
            return None
        if self.joints[0] not in names:
            return None
        if self._running is None:
            self._running = self._make(self._held)
        rows = [self._latest[name] for name in self.joints]
        works = self.stall.works(time_s)
        new = self._running.add(
            time_s,
            [row[0] for row in rows],
            [row[1] for row in rows],
            works,
        )
        if self._running.frozen:
            self.waits_for = "joint states say the same again and again of an arm that was moving: their publisher stalls"
        elif all(math.isfinite(value) for row in rows for value in row):
            self.waits_for, self.samples = "", self.samples + 1
        return self._running.estimate() if new else None


def _why_not(
    mine: Mapping[str, int],
    effort: Sequence[float],
    unit: str,
) -> str:
    """Why the effort of a joint state says nothing, or an empty string; ``mine``: the place of each joint that matters."""
    if not unit:
        return "nothing says what the effort of the joint states is; give the parameter driver or effort_unit"
    without = [
        name for name, at in mine.items() if at >= len(effort) or not math.isfinite(effort[at])
    ]
    if not without:
        return ""
    none = f"the joint states carry no measured effort of {', '.join(without)}, and what is commanded does not count"
    return f"{none}: have the driver publish what it measures"


def online_entries(
    feed: OnlineFeed,
    estimate: OnlineEstimate,
    behind_s: float,
) -> dict[str, Any]:
    """Keys and values of a diagnostics message.

    Args:
        feed: That made the estimate.
        estimate: What the hand holds.
        behind_s: How long ago the newest sample was sent that it rests on [s].

    Returns: As `~/estimate` has them.
    """
    name, unit = feed.probe.answer
    at_rest_s = (
        0.0 if estimate.resting_since_s is None else estimate.time_s - estimate.resting_since_s
    )
    return {
        "probe": feed.probe.name,
        "running": True,
        "final": False,
        "changed": estimate.changed,
        "seconds_since_change": estimate.time_s - estimate.since_s,
        "seconds_of_motion": estimate.motion_s,
        "seconds_at_rest": at_rest_s,
        "seconds_behind": behind_s,
        "taken_to_stand": feed.others,
        name: estimate.mass_kg if estimate.known else "not determined",
        f"{name}.unit": unit,
        f"{name}.std": estimate.std_kg,
        f"{name}.ci95": list(estimate.ci95_kg),
    }


def withdrawn_entries(feed: OnlineFeed, why: str) -> dict[str, Any]:
    """The same where nothing is known of what the hand holds now, and why in a sentence."""
    name, unit = feed.probe.answer
    return {
        "probe": feed.probe.name,
        "running": True,
        "final": False,
        "verdict": "withdrawn",
        "reason.1": why,
        name: "not determined",
        f"{name}.unit": unit,
    }


def late_words(behind_s: float) -> str:
    """That an estimate is not of now, from where on that matters; empty: it does not."""
    if behind_s < WARNED_S:
        return ""
    return f"{behind_s:.1f} s behind: what the hand holds now is not known"


def online_words(estimate: OnlineEstimate) -> str:
    """The same as a sentence."""
    words = shown(
        "kg",
        estimate.mass_kg,
        Z95 * estimate.std_kg,
        spec=spec_for("kg", estimate.std_kg),
        between=" +- ",
    )
    return f"running: {f'changed just now: {words}' if estimate.changed else words}"
