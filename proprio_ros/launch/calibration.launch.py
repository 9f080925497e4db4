"""Driver, excitation and identifier, and with ``virtual:=true`` a robot for them.

Then ``ros2 service call /identifier/calibrate_payload std_srvs/srv/Trigger``; for a container with a sphere in it first
``/identifier/record_container_baseline`` without the sphere, then ``/identifier/calibrate_container``. With ``virtual:=true`` the
robot's helper takes the sphere out and puts it back; ``object:=container:0.03,sphere=0.012`` is the container that
`config/probes/container.yaml` expects. For a soft block between the fingers call ``/identifier/calibrate_softness``
(``object:=block:12000,gap=0.0005`` is one of 30 mm).

End it with Ctrl-C or SIGINT: `ros2 launch` passes SIGINT on to the nodes, which release the arm. A launch that is killed or gets
SIGTERM (systemd, docker stop) does not (ros2/launch issue 666): then the kernel tells them, through `setpriv`.
"""

from __future__ import annotations

import shutil
import sys
from functools import partial
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown, TimerAction
from launch.substitutions import LaunchConfiguration, TextSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from proprio_ros.errors import ProprioError
from proprio_ros.nodes.arguments import ARGUMENTS, Stated
from proprio_ros.nodes.starting import RELEASE_S, Start, ends_all, services_for, starts

KILL_S = "5.0"
BOOLEAN = ["true", "false"]
DECLARED = [
    DeclareLaunchArgument(
        name,
        default_value=argument.default,
        description=argument.about,
        choices=BOOLEAN if argument.default in BOOLEAN else None,
    )
    for name, argument in ARGUMENTS.items()
]


def _program(node: str) -> dict[str, str]:
    """From a sourced workspace, else (pip) the script beside the running interpreter."""
    try:
        get_package_prefix("proprio_ros")
    except (PackageNotFoundError, OSError):
        return {"executable": str(Path(sys.executable).with_name(f"proprio_{node}"))}
    return {"package": "proprio_ros", "executable": f"proprio_{node}"}


def _node(start: Start, namespace: str) -> Node:
    stated = {
        name: ParameterValue(TextSubstitution(text=str(value)), value_type=type(value))
        for name, value in start.parameters.items()
    }
    return Node(
        **_program(start.node),
        name=start.node,
        namespace=namespace,
        parameters=[*start.files, stated] if stated else [*start.files],
        prefix="setpriv --pdeathsig INT --" if shutil.which("setpriv") else None,
        exec_name=f"proprio_{start.node}",
        output="screen",
        sigterm_timeout=str(RELEASE_S),
        sigkill_timeout=KILL_S,
        on_exit=partial(_ended, start.node),
    )


def _nodes(context: LaunchContext) -> list[Any]:
    texts = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    stated = Stated(texts)
    try:
        found = starts(stated)
    except ProprioError as error:
        # this ends the launch with one line and exit code 1; a Shutdown would end it with 0
        raise RuntimeError(str(error)) from None
    actions: list[Any] = [_node(start, stated.namespace) for start in found]
    base = f"/{stated.namespace}" if stated.namespace else ""
    for service in services_for(stated.held):
        call = f"ros2 service call {base}/identifier/{service} std_srvs/srv/Trigger"
        actions.append(LogInfo(msg=call))
    return actions


def _ended(node: str, event: Any, context: LaunchContext) -> list[Any]:
    """End all others, too, where that is so; with exit code 1 where it was an error."""
    words = f"the {node} node has ended"
    if not ends_all(node):
        return []
    if event.returncode == 0 or context.is_shutdown:
        return [Shutdown(reason=words)]

    def fail(_: LaunchContext) -> None:
        raise RuntimeError(f"{words} with exit code {event.returncode}; its last line says why")

    # what it said last is still to be shown
    return [TimerAction(period=0.2, actions=[OpaqueFunction(function=fail)])]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return LaunchDescription([*DECLARED, OpaqueFunction(function=_nodes)])
