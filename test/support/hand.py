"""A virtual arm that obeys commands without a bus: MuJoCo moves hand and object, and shares no line with the machine."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from proprio_ros.excitation.commands import Command, JointSample
from proprio_ros.probes.container.virtual_object import Container
from proprio_ros.records import FloatArray
from proprio_ros.robot import load_robot
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.objects import HandObject
from proprio_ros.virtual.robot import PARKED
from proprio_ros.virtual.truth import Truth

ROBOT = load_robot("open_manipulator_x")
JOINTS = tuple(ROBOT.drive_trains)
SCALE = {name: ROBOT.drive_trains[name].transmission for name in JOINTS}
PERIOD_S = 0.001
RATE_HZ = 40.0
COUNT_RAD = 0.001534
COUNT_A = 0.00269
VELOCITY_COUNT_RAD_S = 0.02398
SUPPLY_V = 12.0
BACK_EMF_V_S = 2.49
RESISTANCE_OHM = 5.22


class Hand:
    """A virtual arm whose joints are held by their servos, or driven, after the truth's latency."""

    def __init__(
        self,
        seed: int,
        held: HandObject | None,
        coulomb: float | None = None,
    ) -> None:
        truth = Truth.draw(ROBOT, seed, links=True, stribeck=True)
        if coulomb is not None:
            joints = {name: replace(joint, coulomb=coulomb) for name, joint in truth.joints.items()}
            truth = replace(truth, joints=joints)
        self.arm = VirtualArm(
            ROBOT,
            truth,
            position=PARKED,
            seed=seed,
            control_period_s=PERIOD_S,
        )
        self.arm.hold(held)
        self.time_s = 10.0
        self.spheres: list[FloatArray] = []
        goals = dict(
            zip(
                JOINTS,
                (self.arm.shaft_rad() * list(SCALE.values())).tolist(),
                strict=True,
            )
        )
        self.waiting = deque([Command(goals)] * round(truth.latency_s / PERIOD_S))

    def sample(self) -> JointSample:
        angles = (COUNT_RAD * np.rint(self.arm.encoder_rad() / COUNT_RAD)).tolist()
        speeds = (
            VELOCITY_COUNT_RAD_S * np.rint(self.arm.velocity_rad_s() / VELOCITY_COUNT_RAD_S)
        ).tolist()
        position = {name: SCALE[name] * angle for name, angle in zip(JOINTS, angles, strict=True)}
        velocity = {name: SCALE[name] * speed for name, speed in zip(JOINTS, speeds, strict=True)}
        return JointSample(self.time_s, position, velocity)

    def step(self, command: Command) -> JointSample:
        for _ in range(round(1.0 / (RATE_HZ * PERIOD_S))):
            self.waiting.append(command)
            now = self.waiting.popleft()
            angles = self.arm.encoder_rad()
            speeds = self.arm.velocity_rad_s()
            current = np.empty(len(JOINTS))
            for row, name in enumerate(JOINTS):
                if name in now.current_A:
                    current[row] = COUNT_A * round(now.current_A[name] / COUNT_A)
                else:
                    current[row] = (
                        22.5 * (now.position[name] / SCALE[name] - angles[row]) - 0.84 * speeds[row]
                    )
            least, most = (
                (volts - BACK_EMF_V_S * speeds) / RESISTANCE_OHM for volts in (-SUPPLY_V, SUPPLY_V)
            )
            self.arm.step(
                np.clip(
                    current,
                    np.maximum(least, -1.0),
                    np.minimum(most, 1.0),
                )
            )
            if isinstance(self.arm.object, Container):
                self.spheres.append(self.arm.object.sphere_m(self.arm))
        self.time_s += 1.0 / RATE_HZ
        return self.sample()
