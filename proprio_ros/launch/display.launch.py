"""The arm as it moves, and what its hand holds, in RViz; beside calibration.launch.py, or any driver of the arm."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from proprio_ros.errors import ProprioError
from proprio_ros.inputs.resources import resource, share_directory
from proprio_ros.robot import RobotModel

ABOUT = {
    "urdf": (
        "open_manipulator_x",
        "URDF of the robot: one that comes with the package, or a path.",
    ),
    "namespace": ("", "Of the arm's nodes and frames, as in calibration.launch.py."),
    "rviz": ("true", "Start RViz; false publishes the frames only."),
    "rviz_config": ("", "RViz configuration file. Empty: the package's config/proprio.rviz."),
}
"""Default and description of every argument."""
BOOLEAN = ["true", "false"]
ARGUMENTS = [
    DeclareLaunchArgument(
        name, default_value=value, description=words, choices=BOOLEAN if value in BOOLEAN else None
    )
    for name, (value, words) in ABOUT.items()
]


def _installed(package: str) -> bool:
    try:
        get_package_prefix(package)
    except (PackageNotFoundError, OSError):
        return False
    return True


def _rviz_config(namespace: str) -> Path:
    """The package's; where the frames have a prefix a copy that says so, since RViz takes it from nowhere else."""
    config = share_directory() / "config" / "proprio.rviz"
    if not namespace:
        return config
    copy = Path(tempfile.mkdtemp(prefix="proprio_rviz_")) / config.name
    text = config.read_text(encoding="utf-8").replace('TF Prefix: ""', f"TF Prefix: {namespace}")
    copy.write_text(text, encoding="utf-8")
    return copy


def _nodes(context: LaunchContext) -> list[Any]:
    given = {
        argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS
    }
    namespace = given["namespace"].strip("/")
    wanted = ["robot_state_publisher", *(["rviz2"] if given["rviz"] == "true" else [])]
    missing = [package for package in wanted if not _installed(package)]
    if missing:
        packages = " ".join(f"ros-jazzy-{package.replace('_', '-')}" for package in missing)
        words = f"{' and '.join(missing)} not found: install them (apt install {packages}) and source the workspace"
        # ends the launch with one line and exit code 1; a Shutdown would end it with 0
        raise RuntimeError(words)
    try:
        urdf = (
            Path(given["urdf"])
            if Path(given["urdf"]).is_file()
            else resource("urdf", given["urdf"])
        )
        root = RobotModel.from_urdf(urdf).root
    except ProprioError as error:
        raise RuntimeError(str(error)) from None
    prefix = f"/{namespace}" if namespace else ""
    frames = f"{namespace}/" if namespace else ""
    text = ParameterValue(urdf.read_text(encoding="utf-8"), value_type=str)
    actions: list[Any] = [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[{"robot_description": text, "frame_prefix": frames}],
            output="screen",
        )
    ]
    if "rviz2" in wanted:
        config = given["rviz_config"] or str(_rviz_config(namespace))
        topics = ("robot_description", "identifier/markers")
        actions.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=namespace,
                arguments=["-d", config, "-f", frames + root],
                remappings=[(f"/{topic}", f"{prefix}/{topic}") for topic in topics]
                if namespace
                else [],
                output="screen",
                on_exit=[Shutdown(reason="RViz was closed")],
            )
        )
    return actions


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_nodes)])
