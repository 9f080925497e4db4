"""A virtual arm that the excitation's machine drives, sequence after sequence, without a bus; MuJoCo moves it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from proprio_ros.addons.paper import hand as paper_hand
from proprio_ros.excitation.commands import Command, JointSample
from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import InputRecord, JointRecord, Recording, Run
from proprio_ros.robot import Robot


@dataclass
class Hand:
    """A virtual arm that the excitation's machine drives, sequence after sequence; encoders and currents in whole counts."""

    robot: Robot
    arm: Any
    time_s: float = 10.0
    runs: list[Run] = field(default_factory=list)

    def sample(self) -> JointSample:
        joints, scale = self._joints()
        position = (
            scale * paper_hand.COUNT_RAD * np.rint(self.arm.encoder_rad() / paper_hand.COUNT_RAD)
        )
        velocity = (
            scale
            * paper_hand.COUNT_RAD_S
            * np.rint(self.arm.velocity_rad_s() / paper_hand.COUNT_RAD_S)
        )
        named = [
            dict(
                zip(
                    joints,
                    row.tolist(),
                    strict=True,
                )
            )
            for row in (position, velocity)
        ]
        return JointSample(self.time_s, *named)

    def _joints(self) -> tuple[tuple[str, ...], np.ndarray]:
        joints = tuple(self.robot.drive_trains)
        return joints, np.array([self.robot.drive_trains[joint].transmission for joint in joints])

    def make(self, sequence: ExcitationSequence) -> None:
        machine = ExcitationMachine(self.robot)
        now = self.sample()
        joints, scale = self._joints()
        machine.start(sequence, now)
        stamps: list[int] = []
        places: list[list[float]] = []
        currents: list[list[float]] = []
        command = Command(dict(now.position))
        while machine.busy:
            before = command
            command = machine.tick(self.time_s, now)
            stamps.append(round(1e9 * now.time_s))
            places.append([now.position[joint] for joint in joints])
            currents.append(
                [paper_hand._counted(command.current_A.get(joint, 0.0)) for joint in joints]
            )
            for tick in range(25):  # what is commanded comes into effect 4 ms later
                paper_hand._drive(
                    self.arm,
                    before if tick < 4 else command,
                    joints,
                    scale,
                )
            self.time_s += 0.025
            now = self.sample()
        assert machine.phase is Phase.DONE, machine.message
        times = np.array(stamps)
        inputs = InputRecord(times, joints, np.array(currents), "/applied_effort")
        record = JointRecord(times, joints, np.array(places))
        self.runs += cut_runs(
            Recording("sure", record, inputs),
            joints=list(joints),
        )
