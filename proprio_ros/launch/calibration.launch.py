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
import tempfile
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
from proprio_ros.inputs.resources import resource
from proprio_ros.nodes.arguments import check_arguments
from proprio_ros.probes import all_probes
from proprio_ros.probes.base import HasBaseline

RELEASE_S = "15.0"
"""From SIGINT to SIGTERM [s]: a job that is under way is ended and its recording written before a node goes."""
KILL_S = "5.0"
TYPES = {
    "seed": int,
    "rate": float,
    "reference": float,
    "reference_mass": float,
    "reference_wait": float,
}
"""Of parameters that are no texts."""
ABOUT = {
    "virtual": ("false", "Start a virtual robot, and drive it."),
    "robot": ("", "Robot of config/robots, or a robot file. Empty: as in the parameter files."),
    "port": ("", "Serial port of the servo bus; with virtual:=true the path under which the virtual bus appears. "
             "Empty: as in the parameter files (/dev/ttyUSB0); with virtual:=true one in the folder for temporary files."),
    "rate": ("", "Cycles per second of the driver [Hz]. Empty: as in the parameter files (100)."),
    "object": ("0.05", "What the virtual hand holds in a probe: a mass [kg], payload:.., container:.., block:.., or none."),
    "seed": ("", "Draws the virtual arm's hidden numbers. Empty: as in the parameter files (1)."),
    "reference_mass": ("", "Mass of a weighed object that you put into the hand when calibrate_robot asks for it [kg]; 0: none. "
                       "Empty: as in the parameter files (0); with virtual:=true 0.1, and the virtual robot's helper does it."),
    "data_directory": ("", "Where recordings, results and calibrations are kept. Empty: as in the parameter files; with "
                       "virtual:=true a folder of its own, so that no real arm is weighed with a virtual one's calibration."),
    "params_file": ("", "A parameter file of yours; counts over the package's, not over arguments."),
    "namespace": ("", "Of all nodes, for several arms on one network; frames begin with it, too."),
}  # fmt: skip
"""Default and description of every argument."""
BOOLEAN = ["true", "false"]
ARGUMENTS = [
    DeclareLaunchArgument(
        name, default_value=value, description=words, choices=BOOLEAN if value in BOOLEAN else None
    )
    for name, (value, words) in ABOUT.items()
]


def _program(node: str) -> dict[str, str]:
    """From a sourced workspace, else (pip) the script beside the running interpreter."""
    try:
        get_package_prefix("proprio_ros")
    except (PackageNotFoundError, OSError):
        return {"executable": str(Path(sys.executable).with_name(f"proprio_{node}"))}
    return {"package": "proprio_ros", "executable": f"proprio_{node}"}


class _Given:
    """What the arguments state, as texts; empty: nothing."""

    def __init__(self, context: LaunchContext) -> None:
        self._texts: dict[str, str] = {}
        for argument in ARGUMENTS:
            self._texts[argument.name] = LaunchConfiguration(argument.name).perform(context)

    def __getitem__(self, name: str) -> str:
        return self._texts[name]

    @property
    def namespace(self) -> str:
        return self["namespace"].strip("/")

    @property
    def virtual(self) -> bool:
        return self["virtual"] == "true"

    @property
    def held(self) -> str:
        """By the virtual hand."""
        return self["object"] if self.virtual else ""

    @property
    def port(self) -> str:
        if self["port"] or not self.virtual:
            return self["port"]
        name = "_".join(["proprio_virtual", *self.namespace.split("/")])
        return str(Path(tempfile.gettempdir()) / name.rstrip("_"))

    @property
    def reference_mass(self) -> str:
        return self["reference_mass"] or ("0.1" if self.virtual else "")

    @property
    def data_directory(self) -> str:
        if self["data_directory"] or not self.virtual:
            return self["data_directory"]
        return f"~/.ros/proprio_ros/virtual_{self['seed'] or 'default'}"

    @property
    def parameter_files(self) -> list[str]:
        """Of the user."""
        stated = self["params_file"]
        return [str(Path(stated).expanduser())] if stated else []


def _parameters(given: _Given) -> dict[str, dict[str, str]]:
    """By node, what the arguments state of its parameters."""
    namespace = given.namespace
    parameters = {
        "driver": {"port": given.port, "rate": given["rate"]},
        "excitation": {},
        "identifier": {
            "data_directory": given.data_directory,
            "reference_mass": given.reference_mass,
            "reference_wait": "1.0" if given.virtual else "",
            "frame_prefix": f"{namespace}/" if namespace else "",
        },
    }
    if not given.virtual:
        return parameters
    # whoever has no weight has none to put into the hand either
    reference = given.reference_mass if float(given.reference_mass) > 0.0 else ""
    robot = {
        "link": given.port,
        "object": given["object"],
        "seed": given["seed"],
        "reference": reference,
    }
    return {"virtual": robot, **parameters}


def _node(name: str, given: _Given, parameters: dict[str, str]) -> Node:
    files = [str(resource("parameters", name)), *given.parameter_files]
    stated = {
        key: ParameterValue(TextSubstitution(text=value), value_type=TYPES.get(key, str))
        for key, value in {"robot": given["robot"], **parameters}.items()
        if value
    }
    # nothing can be weighed without the driver; started anew it would take hold of an arm that nobody expects to move
    ends = name in ("driver", "virtual")
    return Node(
        **_program(name),
        name=name,
        namespace=given.namespace,
        parameters=[*files, stated] if stated else files,
        prefix="setpriv --pdeathsig INT --" if shutil.which("setpriv") else None,
        exec_name=f"proprio_{name}",
        output="screen",
        sigterm_timeout=RELEASE_S,
        sigkill_timeout=KILL_S,
        on_exit=partial(_ended, name) if ends else None,
    )


def _nodes(context: LaunchContext) -> list[Any]:
    given = _Given(context)
    try:
        check_arguments(given["robot"], "".join(given.parameter_files), given.held)
    except ProprioError as error:
        # this ends the launch with one line and exit code 1; a Shutdown would end it with 0
        raise RuntimeError(str(error)) from None
    actions: list[Any] = []
    for name, parameters in _parameters(given).items():
        actions.append(_node(name, given, parameters))
    base = f"/{given.namespace}" if given.namespace else ""
    for service in _services_for(given.held):
        call = f"ros2 service call {base}/identifier/{service} std_srvs/srv/Trigger"
        actions.append(LogInfo(msg=call))
    return actions


def _ended(node: str, event: Any, context: LaunchContext) -> list[Any]:
    """End all others, too; with exit code 1 where it was an error."""
    words = f"the {node} node has ended"
    if event.returncode == 0 or context.is_shutdown:
        return [Shutdown(reason=words)]

    def fail(_: LaunchContext) -> None:
        raise RuntimeError(f"{words} with exit code {event.returncode}; its last line says why")

    # what it said last is still to be shown
    return [TimerAction(period=0.2, actions=[OpaqueFunction(function=fail)])]


def _services_for(held: str) -> list[str]:
    """What to call for what the virtual hand holds; without one, for a payload."""
    kind = held.partition(":")[0].strip()
    theirs = (
        probe
        for probe in all_probes()
        if probe.virtual_object is not None and probe.virtual_object.kind == kind
    )
    probe = next(theirs, all_probes()[0])
    baseline = [f"record_{probe.name}_baseline"] if isinstance(probe, HasBaseline) else []
    return [*baseline, f"calibrate_{probe.name}"]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_nodes)])
