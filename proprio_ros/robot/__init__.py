"""A robot as numbers: the tree of links from its URDF, and the drive train of each joint from its YAML file."""

from proprio_ros.robot.robot_file import (
    JOINT_KINDS,
    DriveTrain,
    FingerTravel,
    Joint,
    Motor,
    ReducedModel,
    Robot,
    RobotModel,
    inertia_about_origin,
    load_robot,
    motion,
    nested_settings,
    pseudo_inertia,
    rotation_about,
    rotation_from_rpy,
    transform,
)

__all__ = [
    "JOINT_KINDS",
    "DriveTrain",
    "FingerTravel",
    "Joint",
    "Motor",
    "ReducedModel",
    "Robot",
    "RobotModel",
    "inertia_about_origin",
    "load_robot",
    "motion",
    "nested_settings",
    "pseudo_inertia",
    "rotation_about",
    "rotation_from_rpy",
    "transform",
]
