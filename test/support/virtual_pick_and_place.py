"""A virtual OpenManipulator-X under its servos' own position controller, picking things up and putting them down, without a clock.

Servos and arm are those of the virtual robot: currents in whole counts, positions in counts of the encoder, dry friction that
sticks. They share no line with the identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.bus.control_table import OperatingMode, servo_model
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.objects import Payload
from proprio_ros.virtual.servo import CONTROL_PERIOD_S, VirtualServo
from proprio_ros.virtual.truth import Truth

RATE_HZ = 100.0
PARKED = {"joint1": 0.0, "joint2": -0.6, "joint3": 0.4, "joint4": 0.3, "gripper_left_joint": 0.0}
LOWEST = np.array([-0.8, -0.9, -0.3, -0.4])
HIGHEST = np.array([0.8, 0.3, 0.7, 0.9])
"""Poses that are reached lie in between [rad]."""


@dataclass
class Worker:
    """An arm that moves from pose to pose without an end.

    Args:
        robot: With servos and one gripper.
        seed: Of its hidden numbers, of encoder noise and of the poses.
        pause_s: It rests so long at each pose.
        move_s: It takes so long from one to the next, and half as much more at most.
    """

    robot: Robot
    seed: int
    pause_s: float = 0.4
    move_s: float = 0.9

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng((self.seed, 77))
        truth = Truth.draw(self.robot, self.seed, links=True)
        self.arm = VirtualArm(
            self.robot, truth, position=PARKED, seed=self.seed, control_period_s=CONTROL_PERIOD_S
        )
        self.servos = []
        for name in self.arm.joints:
            motor = self.robot.motors[name]
            drive = self.robot.drive_trains[name]
            servo = VirtualServo(
                servo_model(motor.model),
                int(motor.id or 0),
                back_emf_V_s_per_rad=drive.back_emf_V_s_per_rad,
                resistance_ohm=drive.resistance_ohm or 5.0,
                latency_s=truth.latency_s,
            )
            self.servos.append(servo)
        self.now_s = 0.0
        self._from = self._to = self._angles()[:4]
        self._begun_s, self._takes_s = 0.0, 0.0
        angles = self.arm.encoder_rad()
        for servo, angle in zip(self.servos, angles, strict=True):
            servo.control(self.now_s, angle, 0.0)
            self._write(servo, "operating_mode", int(OperatingMode.CURRENT_BASED_POSITION))
            self._write(servo, "position_d_gain", 2000)
            self._write(servo, "torque_enable", 1)
        self._goal = self._angles()
        self.motors = [i for i, name in enumerate(self.arm.joints) if name.startswith("joint")]

    def _angles(self) -> np.ndarray:
        return np.array(self.arm.shaft_rad(), dtype=float)

    def _write(
        self,
        servo: VirtualServo,
        register: str,
        value: int,
    ) -> None:
        place = servo.model.registers[register]
        servo.heard(self.now_s)
        error = servo.write(
            place.address,
            place.encode(value),
            self.now_s,
        )
        assert not error, (register, error)

    def _wanted(self) -> np.ndarray:
        """The goal of the four joints now: a smooth way from pose to pose, then a pause."""
        if self.now_s - self._begun_s > self._takes_s + self.pause_s:
            self._from, self._begun_s = self._to, self.now_s
            self._to = self.rng.uniform(LOWEST, HIGHEST)
            self._takes_s = self.move_s * self.rng.uniform(1.0, 1.5)
        share = 1.0
        if self._takes_s > 0.0:
            share = min((self.now_s - self._begun_s) / self._takes_s, 1.0)
        smooth = 10 * share**3 - 15 * share**4 + 6 * share**5
        return self._from + (self._to - self._from) * smooth

    @property
    def resting(self) -> bool:
        """Whether it has arrived."""
        return self.now_s - self._begun_s > self._takes_s + 0.5 * self.pause_s

    def work(
        self,
        seconds: float,
        mass_kg: float = 0.0,
        com_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> Motion:
        """What it reports for some seconds with this in its hand; it takes it where it stands."""
        self.arm.hold(Payload(mass_kg, com_m=tuple(com_m)) if mass_kg > 0.0 else None)
        times = []
        positions = []
        currents = []
        current = np.zeros(len(self.servos))
        every = round(1.0 / RATE_HZ / CONTROL_PERIOD_S)
        for step in range(round(seconds / CONTROL_PERIOD_S)):
            self.now_s += CONTROL_PERIOD_S
            if step % every == 0:
                self._goal[self.motors] = self._wanted()
                for row, servo in enumerate(self.servos):
                    self._write(
                        servo,
                        "goal_position",
                        servo.model.counts_of_position(float(self._goal[row])),
                    )
            angle = self.arm.encoder_rad().tolist()
            velocity = self.arm.velocity_rad_s().tolist()
            for row, servo in enumerate(self.servos):
                current[row] = servo.control(
                    self.now_s,
                    angle[row],
                    velocity[row],
                )
            self.arm.step(current)
            if step % every == every // 2:
                times.append(self.now_s)
                positions.append(
                    [servo.model.angle_rad(servo["present_position"]) for servo in self.servos]
                )
                currents.append(
                    [servo.model.current_A(servo["present_current"]) for servo in self.servos]
                )
        names = tuple(self.arm.joints[i] for i in self.motors)
        return Motion(
            f"work {mass_kg:g} kg", names, np.array(times), np.array(positions)[:, self.motors],
            np.array(currents)[:, self.motors], {"gripper_left_joint": 0.0}, "measured current",
        )  # fmt: skip
