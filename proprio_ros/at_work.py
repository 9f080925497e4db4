"""Weighing while the arm works: joint states under whatever controller in, a running estimate out. No ROS here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from proprio_ros.identification.running import RunningEstimate, RunningWeight
from proprio_ros.motions import MOVED_RAD
from proprio_ros.probes.base import Probe
from proprio_ros.quantity import Z95, shown, spec_for
from proprio_ros.robot import Robot

NO_MOTIONS = (
    "there is no calibration of motions; record the arm with an empty hand while it works, run `proprio calibrate BAG --output "
    "FILE`, and give that file as the parameter calibration"
)


def current_A(effort: float, unit: str, effort_per_current: float) -> float:
    """What flows in a motor by the effort of a joint state."""
    return {"A": 1.0, "mA": 1e-3}.get(unit, 1.0 / effort_per_current) * effort


def any_moved(states: Iterable[tuple[Sequence[str], Sequence[float]]], joints: Iterable[str]) -> bool:
    """Whether any of these joints moved.

    Args:
        states: Names and positions of each joint state [rad or m].
        joints: Those that count.
    """
    least: dict[str, float] = {}
    most: dict[str, float] = {}
    for names, positions in states:
        for name, position in zip(names, positions, strict=False):
            if math.isfinite(position):
                least[name] = min(position, least.get(name, position))
                most[name] = max(position, most.get(name, position))
    return any(most[name] - least[name] > MOVED_RAD for name in joints if name in least)


class RunningFeed:
    """Makes a running estimate of joint states as they come.

    Args:
        probe: That is `at_work`.
        robot: With a calibration of motions.
        facts: What is stated about what the hand holds.

    Raises:
        RobotError: The calibration is of another arm.
    """

    def __init__(self, probe: Probe[Any], robot: Robot, facts: Any) -> None:
        assert robot.motion_calibration is not None
        self.probe, self._robot, self._facts = probe, robot, facts
        self._per_current = {n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()}
        self.joints = robot.motion_calibration.joints
        self._others = [name for name in robot.model.independent_joints if name not in self.joints]
        self.centre_m = self._make({}).centre_m  # made once, so that a calibration of another arm is refused now
        self.forget()

    def _make(self, held: dict[str, float]) -> RunningWeight:
        return self.probe.running(self._robot, self._facts, held)

    def forget(self) -> None:
        """As if nothing had come."""
        self._latest: dict[str, tuple[float, float]] = {}
        self._running: RunningWeight | None = None

    def add(
        self, time_s: float, names: Sequence[str], position: Sequence[float], effort: Sequence[float], unit: str
    ) -> RunningEstimate | None:
        """One joint state, of some or all joints.

        Args:
            time_s: Its stamp.
            names: Of the joints.
            position: [rad or m].
            effort: In the unit.
            unit: ``N.m``, ``A`` or ``mA``.

        Returns:
            The estimate, where there is a new one.
        """
        for name, at, measured in zip(names, position, effort, strict=False):
            if name in self._per_current:
                self._latest[name] = at, current_A(measured, unit, self._per_current[name])
        if self._running is None:
            heard = dict(zip(names, position, strict=False))
            self._running = self._make({name: heard[name] for name in self._others if name in heard})
        if self.joints[0] not in names or any(name not in self._latest for name in self.joints):
            return None
        rows = [self._latest[name] for name in self.joints]
        new = self._running.add(time_s, [row[0] for row in rows], [row[1] for row in rows])
        return self._running.estimate() if new else None


def running_entries(probe: Probe[Any], estimate: RunningEstimate, behind_s: float) -> Mapping[str, Any]:
    """Keys and values of a diagnostics message.

    Args:
        probe: Whose answer it is.
        estimate: Of now.
        behind_s: How long ago the newest sample of it came.
    """
    name, unit = probe.answer
    return {
        "probe": probe.name, "running": True, "final": False, "changed": estimate.changed,
        "seconds_since_change": estimate.time_s - estimate.since_s, "seconds_of_motion": estimate.motion_s,
        "seconds_at_rest": 0.0 if estimate.resting_since_s is None else estimate.time_s - estimate.resting_since_s,
        "seconds_behind": behind_s,
        name: estimate.mass_kg if estimate.known else "not determined", f"{name}.unit": unit,
        f"{name}.std": estimate.std_kg, f"{name}.ci95": list(estimate.ci95_kg),
    }  # fmt: skip


def running_words(estimate: RunningEstimate) -> str:
    """The same as a sentence."""
    words = shown("kg", estimate.mass_kg, Z95 * estimate.std_kg, spec=spec_for("kg", estimate.std_kg), between=" +- ")
    return f"running: {f'changed just now: {words}' if estimate.changed else words}"
