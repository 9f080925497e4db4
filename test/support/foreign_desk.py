"""`ForeignArm` behind its position controller, with state machine and goals but no nodes, and what a recorder would have of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from proprio_ros.excitation.commands import JointSample, JointStates
from proprio_ros.excitation.first import first_sequence
from proprio_ros.excitation.goal_controller import GoalController
from proprio_ros.excitation.guards import Guards
from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.recordings.motions import Motion, motion_of
from proprio_ros.recordings.voltage import with_stall_currents
from proprio_ros.records import DriveSignals, JointRecord, Recording
from proprio_ros.robot import Robot
from support.foreign_arm import BROADCAST, JOINTS, ORDER, STEP_S, Busy, ForeignArm

NOTHING_NS = np.zeros(0, dtype=np.int64)
PERIOD_S = 0.01  # of joint states


class GoalDesk:
    """A millisecond at a time: the arm, its computer, the state machine and what sends goals.

    Args:
        robot: As its owner states it.
        seed: Of the arm.
        busy: Of its computer.
        stiffness_per_rad: Of its servos.
    """

    def __init__(self, robot: Robot, seed: int, busy: Busy, stiffness_per_rad: float) -> None:
        self.robot = robot
        self.arm = ForeignArm(seed, True, busy, stiffness_per_rad)
        self.time_s = 10.0
        self.machine = ExcitationMachine(robot, Guards())
        self.controller = GoalController(robot, ORDER)
        self._states = JointStates(self.machine.joints, Guards().stale_after_s)
        self._heard_s = self.time_s
        self._sample: JointSample | None = None
        self._sent: list[float] | None = None
        self._positions: list[tuple[int, list[float]]] = []
        self._goals: list[tuple[int, list[float]]] = []

    def weigh(self, hand: str, held_kg: float) -> Motion:
        """Put so much into the hand, make the first sequence for it, and take the motion of it."""
        self.arm.hold(held_kg)
        self._go_on(self.time_s + 4.0)
        assert self._sample is not None
        self._positions.clear()
        self._goals.clear()
        self.machine.start(first_sequence(self.robot, hand), self._sample)
        self.controller.begin()
        self._go_on(math.inf)
        assert self.machine.phase is Phase.DONE, self.machine.message
        return self._motion(hand)

    def _go_on(self, end_s: float) -> None:
        """Until then, or until the sequence ends."""
        while self.time_s < end_s and (self.machine.busy or math.isfinite(end_s)):
            self.time_s += STEP_S
            commands_come = self.arm.stalled(self.time_s, "commands") <= self.time_s
            if self._sent is not None and commands_come:
                self.arm.command(self.time_s, self._sent)
                self._sent = None
            states_come = self.arm.stalled(self.time_s, "states") <= self.time_s
            if self.time_s >= self._heard_s + PERIOD_S and states_come:
                self._heard_s = self.time_s
                self._hear()

    def _hear(self) -> None:
        """A joint state comes, and goals are sent."""
        self.arm.advance(self.time_s)
        places = self.arm.positions()
        self._sample = self._states.add(self.time_s, BROADCAST, places)
        if self.machine.busy:
            self.machine.pace = self.controller.pace
            self.controller.take(self.machine.tick(self.time_s, self._sample))
        self.controller.observe(self.time_s, dict(zip(BROADCAST, places, strict=True)))
        now_ns = round(1e9 * self.time_s)
        self._positions.append((now_ns, places))
        if self.controller.holding:
            self._sent = self.controller.commands()
            goals = self.controller.record
            self._goals.append((now_ns, [goals[name] for name in JOINTS]))

    def _motion(self, name: str) -> Motion:
        positions_ns, places = _columns(self._positions)
        goals_ns, goals = _columns(self._goals)
        recording = Recording(
            name,
            JointRecord(positions_ns, BROADCAST, places),
            None,
            signals=DriveSignals(goals_ns, JOINTS, goals, NOTHING_NS, np.zeros(0)),
        )
        return motion_of(with_stall_currents(recording, self.robot), joints=JOINTS)


def _columns(rows: Sequence[tuple[int, list[float]]]) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns] and values."""
    stamps, values = zip(*rows, strict=True)
    return np.array(stamps), np.array(values)
