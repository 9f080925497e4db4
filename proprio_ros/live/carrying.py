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
WAY_POSES = 15  # poses of the way to another one that are looked at


@dataclass(frozen=True)
class Load:
    """What the hand holds: mass [kg] with its standard deviation, and centre in the payload frame [m], shape (3,)."""

    mass_kg: float
    std_kg: float = 0.0
    centre_m: Sequence[float] = (0.0, 0.0, 0.0)


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

    Raises `RobotError`: No such joint moves the hand.
    """

    def __init__(self, robot: Robot) -> None:
        known = robot.motion_calibration
        turning = [
            n for n in robot.model.independent_joints if robot.model.joint(n).kind != "prismatic"
        ]
        joints = (
            [name for name in turning if name in robot.drive_trains]
            if known is None
            else list(known.joints)
        )
        others = [name for name in robot.model.independent_joints if name not in joints]
        held = zero_pose(robot, others) | {
            name: at for name, at in robot.held.items() if name in others
        }
        self._arm = Arm.of(robot, joints, held)
        self.joints, count = self._arm.model.joint_names, len(joints)
        if known is None:
            stated = file_prior(robot, self._arm)
            self._values, covariance, self._scale = stated.values, stated.covariance.copy(), 1.0
            self._friction = np.array(
                [robot.drive_trains[name].coulomb.value for name in self.joints]
            )
            own = slice(-FRICTION * count, None)  # nobody knows an offset: none
            self._values[own] = covariance[own] = covariance[:, own] = 0.0
        else:
            self._values, covariance, self._scale = (
                known.values,
                known.covariance.copy(),
                known.torque_scale,
            )
            covariance[known.friction, known.friction] += np.diag(known.friction_spread**2)
            self._friction = np.abs(known.values[known.friction][count : 2 * count])
        self._covariance = covariance
        self.limits = np.array([self._limit(robot, name) for name in self.joints])

    @staticmethod
    def _limit(robot: Robot, name: str) -> float:
        motor = robot.motors.get(name)
        constant = robot.drive_trains[name].torque_constant.value
        by_current = (
            np.inf
            if motor is None or motor.current_limit_A <= 0.0
            else motor.current_limit_A * constant
        )
        return float(min(robot.model.joint(name).effort_limit or np.inf, by_current))

    def efforts(
        self,
        pose: Mapping[str, float],
        load: Load,
    ) -> tuple[FloatArray, FloatArray]:
        """Torque of each joint that carries arm and load at a pose [rad], and its standard deviation [N m], shape (n,) each.

        Raises `RobotError`: The pose lacks a joint.
        """
        if lacking := [name for name in self.joints if name not in pose]:
            raise RobotError(f"the pose lacks {', '.join(lacking)}; state all joints")
        count = len(self.joints)
        columns = gravity_torques(
            self._arm.model, np.array([[pose[name] for name in self.joints]])
        )[0]
        own = np.eye(count)
        none = np.zeros((count, count))
        bodies = columns.reshape(count, -1)
        design = np.hstack([bodies, *[none] * (len(self._values) // count - PARAMETERS - 1), own])
        hand = columns[:, self._arm.body] @ self._arm.from_payload
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
        along = hand @ point_mass(np.asarray(load.centre_m)) / self._scale
        fill_drives(
            design,
            self._values,
            rows,
            ArmTerms(count),
            load.mass_kg * along,
        )
        variance = (
            np.einsum("ij,jk,ik->i", design, self._covariance, design) + (load.std_kg * along) ** 2
        )
        variance += np.square(load.mass_kg * CENTRE_STD_M / self._scale * hand[:, 1:4]).sum(axis=1)
        result: FloatArray = design @ self._values + load.mass_kg * along
        return result, np.sqrt(variance)

    def _left(self, pose: Mapping[str, float], load: Load) -> FloatArray:
        """Of each joint, relative to its limit; shape (n,)."""
        efforts, stds = self.efforts(pose, load)
        needed = np.abs(efforts) + self._friction + Z95 * stds
        with np.errstate(invalid="ignore"):
            return np.where(
                np.isfinite(self.limits),
                1.0 - needed / self.limits,
                1.0,
            )

    def capability(
        self,
        poses: Sequence[Mapping[str, float]],
        load: Load,
    ) -> Capability:
        """Whether the arm can carry a load at all of some poses [rad]; the worst of them decides."""
        worst = min((self._left(pose, load) for pose in poses), key=lambda left: float(left.min()))
        least = 0.0
        most = self._arm.kg
        for _ in range(30):
            middle = 0.5 * (least + most)
            able = (
                min(
                    float(self._left(pose, Load(middle, 0.0, load.centre_m)).min())
                    for pose in poses
                )
                >= 0.0
            )
            least, most = (middle, most) if able else (least, middle)
        return Capability(
            self.joints[int(worst.argmin())],
            float(worst.min()),
            least,
        )


def way(
    start: Mapping[str, float],
    goal: Mapping[str, float],
) -> list[dict[str, float]]:
    """Poses on the straight way of the joints from one pose to another, which may leave joints where they are [rad]."""
    shares = np.linspace(0.0, 1.0, WAY_POSES)
    return [
        {**start, **{name: (1.0 - s) * start.get(name, to) + s * to for name, to in goal.items()}}
        for s in shares.tolist()
    ]


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
