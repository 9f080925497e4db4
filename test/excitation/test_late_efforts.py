"""First sequences of somebody else's arm behind an effort controller that takes commands late, and stalls: as test/support says."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.foreign_arm import BROADCAST, JOINTS, ORDER, Busy, ForeignArm, write_urdf

from proprio_ros.cli import main as proprio
from proprio_ros.excitation.commands import JointSample, JointStates
from proprio_ros.excitation.effort_controller import EffortController
from proprio_ros.excitation.first import first_sequence
from proprio_ros.excitation.guards import Guards
from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import InputRecord, JointRecord, Recording, Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

STEP_S = 1e-3


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder = tmp_path_factory.mktemp("foreign")
    path = folder / "foreign.yaml"
    assert (
        proprio(
            ["robot", "new", str(write_urdf(folder)), "--output", str(path), "--effort-unit", "N.m"]
        )
        == 0
    )
    return load_robot(Path(path))


class Desk:
    """The arm, its computer, the state machine and the controller, a millisecond at a time; ``period_s``: of joint states."""

    def __init__(
        self,
        robot: Robot,
        seed: int,
        busy: Busy,
        period_s: float = 2e-3,
    ) -> None:
        self.robot = robot
        self.arm = ForeignArm(seed, busy=busy)
        self.time_s = 10.0
        self.period_s = period_s
        guards = Guards()
        self.machine = ExcitationMachine(
            robot, replace(guards, patience_s=3.0 * guards.stale_after_s)
        )
        self.controller = EffortController(robot, ORDER, "N.m")
        self._states = JointStates(self.machine.joints, guards.stale_after_s)
        self._next_s = self.time_s
        self._sample: JointSample | None = None
        self._sent: list[float] | None = None
        self._heard: list[tuple[int, list[float]]] = []
        self._drives: dict[int, list[float]] = {}

    def recorded(self) -> list[Run]:
        """The pushes since this was asked last."""
        stamps, places = zip(*self._heard, strict=True)
        times = np.array(sorted(self._drives))
        drives = InputRecord(
            times,
            JOINTS,
            np.array([self._drives[time] for time in times.tolist()]),
            "/applied_effort",
        )
        self._heard.clear()
        self._drives.clear()
        return cut_runs(
            Recording(
                "late",
                JointRecord(
                    np.array(stamps),
                    BROADCAST,
                    np.array(places),
                ),
                drives,
            ),
            joints=list(JOINTS),
        )

    def run(self, seconds: float = math.inf) -> None:
        """For so long, or until a sequence ends."""
        end_s = self.time_s + seconds
        while self.time_s < end_s and (self.machine.busy or math.isfinite(seconds)):
            self.time_s += STEP_S
            if self._sent is not None and self.arm.stalled(self.time_s, "commands") <= self.time_s:
                self.arm.command(self.time_s, self._sent)
                self._sent = None
            if (
                self.time_s >= self._next_s
                and self.arm.stalled(self.time_s, "states") <= self.time_s
            ):
                self._next_s = self.time_s + self.period_s
                self._hear()

    def _hear(self) -> None:
        self.arm.advance(self.time_s)
        positions = dict(zip(BROADCAST, self.arm.positions(), strict=True))
        self._sample = self._states.add(
            self.time_s,
            list(positions),
            list(positions.values()),
        )
        if self.machine.busy:
            self.machine.pace = self.controller.pace
            self.controller.take(self.machine.tick(self.time_s, self._sample))
        self.controller.observe(self.time_s, positions)
        self._heard.append((round(1e9 * self.time_s), list(positions.values())))
        record = self.controller.record
        drives = [record.get(joint, 0.0) for joint in JOINTS]
        if not self._drives or drives != list(self._drives.values())[-1]:
            self._drives[round(1e9 * (self.time_s + self.period_s + self.controller.late_s))] = (
                drives
            )
        if self.controller.holding:
            self._sent = self.controller.commands()
            if self.controller.lost:
                self.machine.abort(self.controller.lost)

    def make(self, hand: str) -> None:
        sequence = first_sequence(self.robot, hand, self.controller.held_kg)
        assert self._sample is not None
        self.machine.start(sequence, self._sample)
        self.controller.begin()
        self.controller.take(self.machine.command)
        self.run()


@pytest.mark.long
@pytest.mark.parametrize(
    ("delay_s", "load_kg", "period_s"), [(0.05, 0.5, 2e-3), (0.075, 1.0, 4e-3)]
)
def test_an_arm_whose_efforts_come_late_makes_its_first_pushes_and_is_learnt(
    robot: Robot, delay_s: float, load_kg: float, period_s: float
) -> None:
    """With a hold that knew nothing of the delay it was let go from 30 ms on, in the first second."""
    desk = Desk(
        robot,
        1,
        Busy(delay_s, 0.2 * delay_s, every_s=1e3),
        period_s,
    )
    desk.run(0.5)
    desk.make("empty")
    assert desk.machine.phase is Phase.DONE, desk.machine.message
    assert desk.controller.late_s == pytest.approx(delay_s - period_s, abs=0.005)
    assert desk.controller.held_kg < 0.1
    runs = [LoadedRun(run) for run in desk.recorded()]
    desk.arm.hold(load_kg)
    desk.run(3.0)
    assert desk.controller.held_kg == pytest.approx(load_kg, rel=0.3)
    desk.make("payload")
    assert desk.machine.phase is Phase.DONE, desk.machine.message
    used = {outcome.run_number for outcome in desk.machine.outcomes if outcome.used}
    assert len(used) >= desk.machine.runs - 1
    held = KnownLoad(load_kg, PayloadFacts(com=np.zeros(3)))
    learnt = calibrate(
        robot,
        [
            *runs,
            *(LoadedRun(run, held) for run in desk.recorded()),
        ],
    )
    assert learnt.verdict is Verdict.ACCEPTED, learnt.reasons
    for row in learnt.unknowns:
        if row.kind == "torque_constant":
            truth = desk.arm.scale[JOINTS.index(str(row.scope))]
            assert abs(row.value - truth) < 3.0 * row.std < 0.05
            assert abs(row.value - truth) < 0.015


@pytest.mark.long
def test_who_takes_commands_may_stall_in_mid_braking(robot: Robot) -> None:
    """For 0.2 s the last effort stays; a brake as hard as the motor threw the arm back, and it was let go."""
    desk = Desk(
        robot,
        4,
        replace(Busy.draw(4), every_s=3.0),
    )
    desk.run(0.5)
    for _ in range(3):  # a stall may cost a sequence, and never the arm
        desk.make("empty")
        assert not desk.controller.lost
        if desk.machine.phase is Phase.DONE:
            break
    assert desk.machine.phase is Phase.DONE, desk.machine.message
