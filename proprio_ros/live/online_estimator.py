"""Weighing while the arm works: joint states under whatever controller in, a running estimate out. No ROS here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from proprio_ros.identification.regression.at_rest import StandingEstimator
from proprio_ros.identification.regression.online import OnlineEstimate, Stretch
from proprio_ros.inputs.signs import Signs
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
    """What flows in a motor by the effort of a joint state.

    Args:
        effort: As the joint state has it, in ``unit``.
        unit: ``N.m``, ``A``, ``mA`` or ``raw``.
        effort_per_current: Of the joint, for efforts in N m [N m/A].

    Returns:
        The current [A].
    """
    scale = 1.0 / effort_per_current if unit == "N.m" else ampere(unit)
    return scale * effort


def any_moved(
    states: Iterable[tuple[Sequence[str], Sequence[float]]], joints: Iterable[str]
) -> bool:
    """Whether any of these joints moved, by the names and positions of joint states [rad or m]."""
    seen: dict[str, list[float]] = {name: [] for name in joints}
    for names, positions in states:
        for name, position in zip(names, positions, strict=False):
            if name in seen and math.isfinite(position):
                seen[name].append(position)
    spans = [max(places) - min(places) for places in seen.values() if places]
    return any(span > MOVED_RAD for span in spans)


@dataclass(frozen=True)
class _Reading:
    """The latest one of a joint."""

    position: float  # [rad or m]
    current_A: float

    @property
    def known(self) -> bool:
        return math.isfinite(self.position) and math.isfinite(self.current_A)


class OnlineFeed:
    """Makes a running estimate of joint states as they come, on a robot with a calibration of motions.

    Args:
        probe: What is identified while the arm works.
        robot: The arm, with a calibration of motions.
        facts: What the user states of the object.
        stated: Where joints stand, whatever is heard of them [rad or m]; the robot's file says it of those that are not heard.
        signs: By what efforts are multiplied.

    Attributes:
        others: Joints that are not in the calibration and count as standing.
        waits_for: Why no joint state counted since the last that did; empty: nothing is wrong.
        samples: How many counted.
        stall: What flows in motors that a voltage drives; goals and voltage go in there.
        moved: Those of the others that are elsewhere than they count as standing.

    Raises:
        RobotError: The calibration is of another arm.
    """

    def __init__(
        self,
        probe: Online[Any],
        robot: Robot,
        facts: Any,
        stated: Mapping[str, float] | None = None,
        signs: Signs | None = None,
    ) -> None:
        assert robot.motion_calibration is not None
        self._stated = dict(stated or {})
        self._signs = signs or Signs()
        self.probe = probe
        self._robot = robot
        self._facts = facts
        self._per_current = {
            name: drive.nominal_effort_per_current for name, drive in robot.drive_trains.items()
        }
        self.stall = StallCurrents(robot)
        self.joints = robot.motion_calibration.joints
        # whose effort counts
        self._measured = [name for name in self.joints if name not in self.stall.joints]
        idle = {*self.joints, *robot.model.beside(self.joints)}
        self.others = [name for name in robot.model.independent_joints if name not in idle]
        self._make({})  # so that a calibration of another arm is refused now
        self._latest: dict[str, _Reading] = {}
        self._running: StandingEstimator | None = None
        self._unfed = Stretch(math.inf, 0.0)
        self._held = zero_pose(self._robot, self.others)
        for name, position in {**robot.held, **self._stated}.items():
            if name in self._held:
                self._held[name] = position
        self.waits_for = ""
        self.samples = 0
        self.moved: set[str] = set()

    def _make(self, held: dict[str, float]) -> StandingEstimator:
        return self.probe.running(
            self._robot,
            self._facts,
            held,
        )

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
        takes = "goals and positions"
        if self._measured:
            takes = "measured effort of the joint states alone"
        words = f"the running estimate takes {takes}"
        if not self.others:
            return words
        return f"{words}; {', '.join(self.others)} counts as standing where it first stood"

    @property
    def warning(self) -> str:
        """What is wrong with the estimate that the newest joint state gave; empty: nothing."""
        if self._running is not None and self._running.scale.is_other:
            return self._running.scale.words
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
        """Take one joint state, of some or all joints.

        Args:
            time_s: Its stamp [s].
            names: Joints, shape (J,).
            position: Of these, shape (J,) [rad or m].
            effort: Of these, or of the first of them, shape (J,) at most, in ``unit``.
            unit: Of efforts: ``N.m``, ``A``, ``mA`` or ``raw``; empty where nobody says it.

        Returns:
            The estimate, where there is a new one.
        """
        self._note_others(names, position)
        if self._measured:
            self.waits_for = self._why_no_effort(names, effort, unit) or self.waits_for
            if not unit:
                return None
        self._read(time_s, names, position, effort, unit)
        absent = [name for name in self.joints if name not in self._latest]
        if absent and not self.waits_for:
            self.waits_for = f"no joint states of {', '.join(absent)} are coming"
        if absent or self.joints[0] not in names:
            return None
        return self._estimated(time_s)

    def _note_others(self, names: Sequence[str], position: Sequence[float]) -> None:
        """Where joints that count as standing are, and which of them moved."""
        for name, at in zip(names, position, strict=False):
            if name not in self._held or name in self._stated or not math.isfinite(at):
                continue
            if self._running is None:
                self._held[name] = at
            if abs(at - self._held[name]) > MOVED_RAD:
                self.moved.add(name)

    def _why_no_effort(self, names: Sequence[str], effort: Sequence[float], unit: str) -> str:
        """Why the effort of a joint state says nothing, or an empty string."""
        if not unit:
            return "nothing says what the effort of the joint states is; give the parameter driver or effort_unit"
        efforts = dict(
            zip_longest(
                names,
                effort[: len(names)],
                fillvalue=math.nan,
            )
        )
        without = [
            name
            for name, value in efforts.items()
            if name in self._measured and not math.isfinite(value)
        ]
        if not without:
            return ""
        none = f"the joint states carry no measured effort of {', '.join(without)}"
        remedy = "have the driver publish what it measures"
        return f"{none}, and what is commanded does not count: {remedy}"

    def _read(
        self,
        time_s: float,
        names: Sequence[str],
        position: Sequence[float],
        effort: Sequence[float],
        unit: str,
    ) -> None:
        """Where each joint with a motor is, and what flows in its motor."""
        efforts = effort[: len(names)]
        for name, at, value in zip_longest(names, position, efforts, fillvalue=math.nan):
            if name in self.stall.joints:
                current = self.stall.current_A(name, time_s, at, value)
                if math.isnan(current) and name in self.joints:
                    remedy = "publish goals on joint_command, stamped as joint states are"
                    self.waits_for = f"nobody says where {name} is sent: {remedy}"
                self._latest[name] = _Reading(at, current)
            elif name in self._per_current:
                own = self._signs.of(name) * value
                current = current_A(own, unit, self._per_current[name])
                self._latest[name] = _Reading(at, current)

    def _estimated(self, time_s: float) -> OnlineEstimate | None:
        """Hand the latest readings of all joints of the calibration to the estimate; a new one, where there is one."""
        if self._running is None:
            self._running = self._make(self._held)
        readings = [self._latest[name] for name in self.joints]
        new = self._running.add(
            time_s,
            [each.position for each in readings],
            [each.current_A for each in readings],
            self.stall.works(time_s),
        )
        if self._running.frozen:
            self.waits_for = "joint states say the same again and again of an arm that was moving: their publisher stalls"
        elif all(each.known for each in readings):
            self.waits_for = ""
            self.samples += 1
        return self._running.estimate() if new else None


def online_entries(feed: OnlineFeed, estimate: OnlineEstimate, behind_s: float) -> dict[str, Any]:
    """Keys and values of a diagnostics message.

    Args:
        feed: That made the estimate.
        estimate: What the hand holds.
        behind_s: How long ago the newest sample was sent that it rests on [s].

    Returns:
        As `~/estimate` has them.
    """
    name, unit = feed.probe.answer
    at_rest_s = 0.0
    if estimate.resting_since_s is not None:
        at_rest_s = estimate.time_s - estimate.resting_since_s
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
    return f"running: changed just now: {words}" if estimate.changed else f"running: {words}"
