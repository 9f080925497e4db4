"""A simulated arm behind what looks like somebody else's driver: an effort or position controller, and joint states on a topic.

As `forward_command_controller` does it, a command counts for all joints in a fixed order and stays until the next; one of another
length is ignored. As `joint_state_broadcaster` does it, the joints come in the order of the alphabet, among others that are not the
arm's, and what the hardware does not state is NaN.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from proprio_ros import clock
from proprio_ros.errors import ConfigurationError
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.drives import PositionServo
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.objects import HandObject
from proprio_ros.virtual.robot import LONGEST_PAUSE_S, parked
from proprio_ros.virtual.truth import Truth

PERIOD_S = 0.001  # of the motors' current controllers, as of the virtual servos'
# what an effort may be: the motor's current, or current x nominal torque constant (N for a slide)
UNITS = ("A", "N.m")
FOREIGN_JOINTS = ("conveyor", "lift")  # joints of other machines on the same topic


class EffortDriver:
    """Arm, motors and the last command; until the first one somebody holds the arm, as a person would.

    Of a robot as its file states it, and as it is really like; efforts in one of `UNITS` are of the controller's joints
    in its order (none: the robot file's), positions those at the start [rad or m].

    Raises `ConfigurationError`: The unit or a joint is not known, MuJoCo is missing, or the robot cannot be simulated.
    """

    units: tuple[str, ...] = UNITS

    def __init__(
        self,
        robot: Robot,
        truth: Truth,
        *,
        joints: Sequence[str] = (),
        unit: str = "N.m",
        position: Mapping[str, float] | None = None,
        seed: int = 0,
    ) -> None:
        if unit not in self.units:
            raise ConfigurationError(f"effort_unit={unit!r}: choose one of {', '.join(self.units)}")
        self.joints = tuple(joints) or tuple(robot.drive_trains)
        unknown = [name for name in self.joints if name not in robot.drive_trains]
        if unknown:
            raise ConfigurationError(
                f"controller_joints: {robot.name} does not drive {', '.join(unknown)}"
            )
        start = parked(robot) if position is None else position
        self.arm = VirtualArm(
            robot,
            truth,
            position=start,
            seed=seed,
            control_period_s=PERIOD_S,
        )
        self.lock = clock.lock()
        drives = [robot.drive_trains[name] for name in self.arm.joints]
        self._limits = np.array([robot.motors[name].current_limit_A for name in self.arm.joints])
        self._transmission = np.array([drive.transmission for drive in drives])
        self._count_rad = np.array([drive.encoder_resolution for drive in drives])
        per_current = np.array([drive.nominal_effort_per_current for drive in drives])
        # without a supply or a resistance stated nothing limits the current at speed
        laws = [(d.supply_voltage_V, d.back_emf_V_s_per_rad, d.resistance_ohm) for d in drives]
        bounds = [
            (volt / ohm, emf / ohm) if volt > 0.0 and ohm > 0.0 else (math.inf, 0.0)
            for volt, emf, ohm in laws
        ]
        self._supply_A, self._per_speed_A = np.array(bounds).T
        self._effort_per_A = np.ones(len(per_current)) if unit == "A" else per_current
        self._columns = [self.arm.joints.index(name) for name in self.joints]
        self._latency_s = truth.latency_s
        self._coming: deque[tuple[float, FloatArray]] = deque()
        self._wanted: FloatArray | None = None
        self._current_A = np.zeros(len(self.arm.joints))
        self._time_s: float | None = None
        self.broadcast = tuple(sorted([*self.arm.joints, *FOREIGN_JOINTS]))

    @classmethod
    def of_parameters(
        cls, robot: Robot, truth: Truth, values: Mapping[str, Any], seed: int
    ) -> EffortDriver:
        """As the virtual node's parameters state it; its unit where there is more than one.

        Args:
            robot: As its file states it.
            truth: What it is really like.
            values: Of the parameters, by name.
            seed: Of the noise.
        """
        options: dict[str, Any] = {"joints": values["controller_joints"], "seed": seed}
        if len(cls.units) > 1:
            options["unit"] = values["effort_unit"]
        return cls(robot, truth, **options)

    def command(self, now_s: float, efforts: Sequence[float]) -> bool:
        """Take a command; whether it has one finite effort for each of the controller's joints."""
        if len(efforts) != len(self.joints) or not all(map(math.isfinite, efforts)):
            return False
        with self.lock:
            self._advance(now_s)
            wanted = self._uncommanded()
            wanted[self._columns] = efforts
            self._coming.append((now_s + self._latency_s, wanted))
        return True

    def _uncommanded(self) -> FloatArray:
        """What joints are told that are not the controller's, shape (J,)."""
        return np.zeros(len(self.arm.joints))

    def advance(self, now_s: float) -> None:
        """Move the arm on to an instant."""
        with self.lock:
            self._advance(now_s)

    def _advance(self, now_s: float) -> None:
        if self._time_s is None or now_s - self._time_s > LONGEST_PAUSE_S:
            self._time_s = now_s - PERIOD_S
        while self._time_s + PERIOD_S <= now_s:
            self._time_s += PERIOD_S
            while self._coming and self._coming[0][0] <= self._time_s:
                self._wanted = self._coming.popleft()[1]
            if self._wanted is not None:
                self._current_A = self._currents(self._wanted)
                self.arm.step(self._current_A)

    def _currents(self, wanted: FloatArray) -> FloatArray:
        """Of the motors [A], within their limits, and what the supply can drive at this speed."""
        wanted_A = wanted / self._effort_per_A
        slowed_A = self._per_speed_A * self.arm.velocity_rad_s()
        current = np.clip(
            wanted_A,
            -self._limits,
            self._limits,
        )
        return np.clip(
            current,
            -self._supply_A - slowed_A,
            self._supply_A - slowed_A,
        )

    def states(self) -> tuple[list[float], list[float], list[float]]:
        """Positions [rad or m], velocities (none is stated) and efforts in the drive's unit, in the order of `broadcast`."""
        with self.lock:
            counts = np.rint(self.arm.encoder_rad() / self._count_rad)
            position = dict(
                zip(
                    self.arm.joints,
                    (counts * self._count_rad * self._transmission).tolist(),
                    strict=True,
                )
            )
            effort = dict(
                zip(self.arm.joints, (self._current_A * self._effort_per_A).tolist(), strict=True)
            )
        positions = [position.get(name, 0.25) for name in self.broadcast]
        return (
            positions,
            [math.nan] * len(positions),
            [effort.get(name, math.nan) for name in self.broadcast],
        )

    def truth(self) -> tuple[dict[str, float], dict[str, float]]:
        """True joint positions [rad or m] and the currents that flow in the motors [A], by joint."""
        with self.lock:
            return self.arm.position(), dict(
                zip(self.arm.joints, self._current_A.tolist(), strict=True)
            )

    def hold(self, thing: HandObject | None) -> None:
        """Put something into the hand, or take it out."""
        with self.lock:
            if thing != self.arm.object:
                self.arm.hold(thing)

    def set_fault(self, text: str) -> None:
        """Refuse a fault: they are those of a servo bus, which is not here."""
        if text:
            raise ConfigurationError(
                f"fault {text!r}: behind a controller there is no servo bus; choose interface:=bus"
            )

    def close(self) -> None:
        """Nothing is open."""


class PositionDriver(EffortDriver):
    """The same behind a position controller: each servo makes a voltage of the distance to its goal, by its law in the robot file.

    Goals are in rad; the options are `joints`, `position` and `seed` of `EffortDriver`.

    Raises `ConfigurationError`: Also where the robot file states no law of a position servo for a joint.
    """

    units = ("rad",)

    def __init__(self, robot: Robot, truth: Truth, **options: Any) -> None:
        laws = {name: drive.driven_by for name, drive in robot.drive_trains.items()}
        other = [name for name, law in laws.items() if not isinstance(law, PositionServo)]
        if other:
            raise ConfigurationError(
                f"{robot.name}: {', '.join(other)} are no position servos (driven_by); choose interface:=effort_controller"
            )
        super().__init__(
            robot,
            truth,
            unit="rad",
            **options,
        )
        self._gain, self._limit, self._dead, self._step = (
            np.array([getattr(law, term) for law in laws.values()])
            for term in ("gain_per_rad", "limit", "dead_band_rad", "goal_speed_rad_s")
        )
        self._step *= PERIOD_S
        drives = [robot.drive_trains[name] for name in self.arm.joints]
        self._supply_V, self._resistance_ohm = np.array(
            [(d.supply_voltage_V, d.resistance_ohm) for d in drives]
        ).T
        # a motor's back EMF is its torque constant
        self._back_emf = np.array([truth.joints[name].torque_constant for name in self.arm.joints])
        self._effort_per_A = np.full(len(drives), math.nan)  # such a servo knows no effort
        self._begun = self.arm.encoder_rad() * self._transmission
        self._moved = self._begun.copy()

    def _uncommanded(self) -> FloatArray:
        return self._begun.copy()

    def _currents(self, wanted: FloatArray) -> FloatArray:
        """What the voltage drives [A]; the firmware moves its goal no faster than it can."""
        self._moved = self._moved + np.clip(wanted - self._moved, -self._step, self._step)
        counts = np.rint(self.arm.encoder_rad() / self._count_rad)
        distance = self._moved - counts * self._count_rad * self._transmission
        distance = np.sign(distance) * np.maximum(np.abs(distance) - self._dead, 0.0)
        duty = np.clip(
            self._gain * distance,
            -self._limit,
            self._limit,
        )
        return (
            self._supply_V * duty - self._back_emf * self.arm.velocity_rad_s()
        ) / self._resistance_ohm


DRIVERS: dict[str, type[EffortDriver]] = {
    "effort_controller": EffortDriver,
    "position_controller": PositionDriver,
}
"""What may drive the virtual arm instead of the servo bus, by the virtual node's `interface`."""
