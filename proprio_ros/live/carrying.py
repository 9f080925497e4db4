"""What an arm's joints carry in a pose, with its uncertainty, and whether it can carry a load there. No ROS here.

By a calibration of motions where there is one, else by the URDF with the uncertainty that nobody measured it: bodies, the offsets
of the torques that are read, and shares of the torque constants, with their covariance. Efforts are torques as the robot file's
constants make them of currents, which is what a measured effort in N m is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import RobotError
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.motion_equations import Arm, Rows, fill_drives
from proprio_ros.identification.regression.motion_prior import file_prior
from proprio_ros.quantity import Z95
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.regressor import PARAMETERS, gravity_torques, point_mass

CENTRE_STD_M = 0.01  # of a load's centre in each direction, where nobody says how well it is known
FRICTION = 3  # viscous, dry, and the offset: the last terms of each joint that a calibration has
BISECTIONS = 30  # of the heaviest load
WAY_POSES = 15  # poses of the way to another one that are looked at


@dataclass(frozen=True)
class Load:
    """What the hand holds."""

    mass_kg: float
    std_kg: float = 0.0  # standard deviation of the mass
    centre_m: Sequence[float] = (0.0, 0.0, 0.0)  # in the payload frame, shape (3,)


@dataclass(frozen=True)
class Capability:
    """Whether the joints can hold a load and move it slowly."""

    joint: str  # that has the least left
    # what it has left over of its limit, relative to it, after gravity, dry friction and 1.96 standard deviations
    margin: float
    # the heaviest load with which every joint has something left; 0: not even the arm alone
    most_kg: float

    @property
    def can(self) -> bool:
        """Whether every joint has something left."""
        return self.margin >= 0.0


class Carrier:
    """The statics of a robot's revolute joints; the others stand where they are held.

    Attributes:
        joints: Of the calibration, or all revolute ones with a motor, n.
        limits: Largest effort of each [N m], by URDF and current limit; infinite where nobody says, shape (n,).

    Raises:
        RobotError: No such joint moves the hand.
    """

    def __init__(self, robot: Robot) -> None:
        known = robot.motion_calibration
        joints = _turning_joints(robot) if known is None else list(known.joints)
        others = [name for name in robot.model.independent_joints if name not in joints]
        held = zero_pose(robot, others)
        for name, position in robot.held.items():
            if name in held:
                held[name] = position
        self._arm = Arm.of(robot, joints, held)
        self.joints = self._arm.model.joint_names
        if known is None:
            self._take_urdf(robot, len(joints))
        else:
            self._take_calibration(robot, len(joints))
        self.limits = np.array([self._limit(robot, name) for name in self.joints])

    def _take_urdf(self, robot: Robot, count: int) -> None:
        stated = file_prior(robot, self._arm)
        self._values = stated.values
        self._covariance = stated.covariance.copy()
        self._scale = 1.0
        coulomb = [robot.drive_trains[name].coulomb.value for name in self.joints]
        self._friction = np.array(coulomb)
        own = slice(-FRICTION * count, None)  # nobody knows an offset: none
        self._values[own] = 0.0
        self._covariance[own] = 0.0
        self._covariance[:, own] = 0.0

    def _take_calibration(self, robot: Robot, count: int) -> None:
        known = robot.motion_calibration
        assert known is not None
        self._values = known.values
        self._covariance = known.covariance.copy()
        self._scale = known.torque_scale
        self._covariance[known.friction, known.friction] += np.diag(known.friction_spread**2)
        coulomb = known.values[known.friction][count : 2 * count]
        self._friction = np.abs(coulomb)

    @staticmethod
    def _limit(robot: Robot, name: str) -> float:
        by_urdf = robot.model.joint(name).effort_limit or np.inf
        by_current = np.inf
        motor = robot.motors.get(name)
        if motor is not None and motor.current_limit_A > 0.0:
            by_current = motor.current_limit_A * robot.drive_trains[name].torque_constant.value
        return float(min(by_urdf, by_current))

    def efforts(self, pose: Mapping[str, float], load: Load) -> tuple[FloatArray, FloatArray]:
        """Torque of each joint that carries arm and load at a pose [rad], and its standard deviation [N m], shape (n,) each.

        Raises:
            RobotError: The pose lacks a joint.
        """
        lacking = [name for name in self.joints if name not in pose]
        if lacking:
            raise RobotError(f"the pose lacks {', '.join(lacking)}; state all joints")
        positions = np.array([[pose[name] for name in self.joints]])  # (1, n)
        columns = gravity_torques(self._arm.model, positions)[0]
        hand = columns[:, self._arm.body] @ self._arm.from_payload  # (n, 10)
        per_kg = hand @ point_mass(np.asarray(load.centre_m)) / self._scale  # (n,)
        design = self._design(columns, hand, load.mass_kg * per_kg)
        covariance = np.einsum("ij,jk,ik->i", design, self._covariance, design)
        variance = covariance + (load.std_kg * per_kg) ** 2
        of_centre = load.mass_kg * CENTRE_STD_M / self._scale * hand[:, 1:4]
        variance += np.square(of_centre).sum(axis=1)
        result: FloatArray = design @ self._values + load.mass_kg * per_kg
        return result, np.sqrt(variance)

    def _design(self, columns: FloatArray, hand: FloatArray, carried: FloatArray) -> FloatArray:
        """What each of the calibration's values gives to each torque of an arm at rest, shape (n, P).

        Args:
            columns: Gravity's torques by the bodies' parameters.
            hand: By the parameters of what the hand holds, shape (n, 10).
            carried: Torques that the load takes, shape (n,) [N m].
        """
        count = len(self.joints)
        bodies = columns.reshape(count, -1)
        # at rest nothing of the motors but the offset
        none = [np.zeros((count, count))] * (len(self._values) // count - PARAMETERS - 1)
        design = np.hstack([bodies, *none, np.eye(count)])
        nothing = np.zeros(0)
        rows = Rows(
            start_s=np.zeros(count),
            joint=np.arange(count),
            design=design,
            payload=hand,
            direction=np.zeros(count),
            torque=np.zeros(count),
            zero=nothing,
            inertial=nothing,
            torque_rate=nothing,
        )
        fill_drives(
            design,
            self._values,
            rows,
            ArmTerms(count),
            carried,
        )
        return design

    def _left(self, pose: Mapping[str, float], load: Load) -> FloatArray:
        """Of each joint, relative to its limit; shape (n,)."""
        efforts, stds = self.efforts(pose, load)
        needed = np.abs(efforts) + self._friction + Z95 * stds
        with np.errstate(invalid="ignore"):
            left = 1.0 - needed / self.limits
        return np.where(
            np.isfinite(self.limits),
            left,
            1.0,
        )

    def capability(self, poses: Sequence[Mapping[str, float]], load: Load) -> Capability:
        """Whether the arm can carry a load at all of some poses [rad]; the worst of them decides."""

        def least_left(carried: Load) -> FloatArray:
            """At the worst pose."""
            all_left = [self._left(pose, carried) for pose in poses]
            return min(all_left, key=lambda left: float(left.min()))

        worst = least_left(load)
        able_kg = 0.0
        unable_kg = self._arm.kg
        for _ in range(BISECTIONS):
            middle_kg = 0.5 * (able_kg + unable_kg)
            if least_left(Load(middle_kg, 0.0, load.centre_m)).min() >= 0.0:
                able_kg = middle_kg
            else:
                unable_kg = middle_kg
        joint = self.joints[int(worst.argmin())]
        return Capability(
            joint,
            margin=float(worst.min()),
            most_kg=able_kg,
        )


def _turning_joints(robot: Robot) -> list[str]:
    """Revolute joints with a motor."""
    return [
        name
        for name in robot.model.independent_joints
        if name in robot.drive_trains and robot.model.joint(name).kind != "prismatic"
    ]


def way(start: Mapping[str, float], goal: Mapping[str, float]) -> list[dict[str, float]]:
    """Poses on the straight way of the joints from one pose to another, which may leave joints where they are [rad]."""
    poses = []
    for share in np.linspace(0.0, 1.0, WAY_POSES).tolist():
        pose = dict(start)
        for name, to in goal.items():
            pose[name] = (1.0 - share) * start.get(name, to) + share * to
        poses.append(pose)
    return poses


def capability_entries(found: Capability, load: Load) -> dict[str, object]:
    """Keys and values of a diagnostics message."""
    return {
        "can_carry": found.can,
        "joint": found.joint,
        "margin": found.margin,
        "most": found.most_kg,
        "most.unit": "kg",
        "load": load.mass_kg,
        "load.unit": "kg",
        "load.std": load.std_kg,
    }
