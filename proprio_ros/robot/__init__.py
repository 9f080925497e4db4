"""A robot as numbers: the tree of links from its URDF, and the drive train of each joint from its YAML file.

`geometry` is at the bottom; `urdf` reads `links` and joints, `bodies` says which body each link is, `tree` places and merges
them, `description` finds the URDF,
`live_description` takes it from a topic, `drive_train` is what moves them, `wide` is what holds of a number that nobody stated,
`fields` is what a robot file may say, `robot_file` puts all of it into a `Robot`, `new_file` writes one to fill in, and
`kinematics` asks that how high it stands.
"""

from proprio_ros.robot.description import is_description
from proprio_ros.robot.drive_train import DriveTrain
from proprio_ros.robot.fields import nested_settings
from proprio_ros.robot.geometry import (
    inertia_about_origin,
    motion,
    pseudo_inertia,
    rotation_about,
    rotation_from_rpy,
)
from proprio_ros.robot.links import Joint
from proprio_ros.robot.live_description import LiveDescription
from proprio_ros.robot.robot_file import Robot, load_robot, with_recorded_torque
from proprio_ros.robot.tree import ReducedModel, RobotModel

__all__ = [
    "DriveTrain",
    "Joint",
    "LiveDescription",
    "ReducedModel",
    "Robot",
    "RobotModel",
    "inertia_about_origin",
    "is_description",
    "load_robot",
    "motion",
    "nested_settings",
    "pseudo_inertia",
    "rotation_about",
    "rotation_from_rpy",
    "with_recorded_torque",
]
