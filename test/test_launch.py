"""Launch and parameter files: they agree with what the nodes declare, and every argument says what it is for."""

from __future__ import annotations

import importlib
import py_compile
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from proprio_ros.errors import ProprioError
from proprio_ros.inputs.resources import resource
from proprio_ros.nodes.starting import check_arguments
from proprio_ros.probes import virtual_object
from proprio_ros.probes.container.virtual_object import Container

REPOSITORY = Path(__file__).resolve().parents[1]
LAUNCH = sorted((REPOSITORY / "proprio_ros" / "launch").glob("*.launch.py"))
CLASSES = {
    "driver": "DriverNode",
    "excitation": "ExcitationNode",
    "identifier": "IdentifierNode",
    "virtual": "VirtualNode",
}


def stated(node: str) -> dict[str, Any]:
    """The parameters in config/<node>.yaml."""
    content = YAML(typ="safe", pure=True).load(resource("parameters", node).read_text())
    assert list(content) == [f"/**/{node}"], "in whatever namespace the node runs"
    assert list(content[f"/**/{node}"]) == ["ros__parameters"]
    return dict(content[f"/**/{node}"]["ros__parameters"])


def node_class(node: str) -> Any:
    """Its class; needs rclpy."""
    pytest.importorskip("rclpy")
    return getattr(importlib.import_module(f"proprio_ros.nodes.{node}"), CLASSES[node])


@pytest.mark.parametrize("node", CLASSES)
def test_a_parameter_file_states_every_parameter_and_its_default(node: str) -> None:
    kind = node_class(node)
    tables = importlib.import_module("proprio_ros.nodes.tables")
    declared = {
        parameter.name: parameter.default for parameter in (tables.AUTOSTART, *kind.parameters)
    }
    # `[]` would leave the parameter without a value, and `ros2 param dump` without an answer
    expected = {name: [""] if default == [] else default for name, default in declared.items()}
    if "link" in expected:
        # by default in this machine's folder for temporary files
        expected["link"] = "/tmp/proprio_virtual"
    values = stated(node)
    assert values == expected
    # true and 1, 1 and 1.0 are equal, but not to rcl
    assert {name: type(value) for name, value in values.items()} == {
        name: type(v) for name, v in expected.items()
    }


@pytest.mark.parametrize("node", CLASSES)
def test_rcl_reads_the_file_as_it_is_meant(node: str, tmp_path: Path) -> None:
    """The file itself goes through rcl's own reader, and a user's file on top of it counts."""
    rclpy = pytest.importorskip("rclpy")
    kind = node_class(node)
    mine = tmp_path / "mine.yaml"
    mine.write_text(f"/**/{node}:\n  ros__parameters:\n    robot: pendulum\n    autostart: false\n")
    files = [str(resource("parameters", node)), str(mine)]
    context = rclpy.Context()
    words = [
        "--ros-args",
        *(word for file in files for word in ("--params-file", file)),
        "-r",
        "__ns:=/arm1",
    ]
    rclpy.init(args=words, context=context)
    try:
        live = kind(context=context)
        try:
            assert live.values["robot"] == "pendulum" and live.values["autostart"] is False
            rest = {
                name: value
                for name, value in stated(node).items()
                if name not in ("robot", "autostart")
            }
            assert {name: live.values[name] for name in rest} == {
                name: [] if value == [""] else value for name, value in rest.items()
            }
        finally:
            live.destroy_node()
    finally:
        context.try_shutdown()


@pytest.mark.parametrize("text", ['["payload.size=0.03"]', '[""]', "[]", "nothing at all"])
def test_a_list_of_words_stays_one_that_can_be_set(text: str, tmp_path: Path) -> None:
    """`[]` in a file has no type for rcl, and rclpy takes an empty default for one of bytes: both could never be set again."""
    rclpy = pytest.importorskip("rclpy")
    kind = node_class("identifier")
    parameters = importlib.import_module("proprio_ros.nodes.parameters")
    file = tmp_path / "mine.yaml"
    line = "report: true" if text == "nothing at all" else f"settings: {text}"
    file.write_text(f"/**/identifier:\n  ros__parameters:\n    {line}\n")
    context = rclpy.Context()
    rclpy.init(
        args=["--ros-args", "--params-file", str(file)],
        context=context,
    )
    try:
        node = kind(context=context)
        try:
            assert node.values["settings"] == (["payload.size=0.03"] if "size" in text else [])
            (result,) = node.set_parameters(
                [rclpy.Parameter("settings", value=["payload.size=0.04"])]
            )
            assert result.successful, result.reason
            assert parameters.value_of(node, "settings") == ["payload.size=0.04"]
            (result,) = node.set_parameters([rclpy.Parameter("settings", value=[""])])
            assert result.successful and parameters.value_of(node, "settings") == []
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


def test_a_node_that_is_configured_again_offers_everything_once() -> None:
    rclpy = pytest.importorskip("rclpy")
    kind = node_class("excitation")
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "-r", "__ns:=/again"], context=context)
    try:
        node = kind(context=context)
        bare = offered(node)
        try:
            node.trigger_configure()
            once = offered(node)
            assert sum(once) > sum(bare)
            node.trigger_cleanup()
            assert offered(node) == bare
            node.trigger_configure()
            assert offered(node) == once
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


def offered(node: Any) -> tuple[int, ...]:
    """How many publishers, subscriptions, services, clients and timers a node has."""
    kinds = (node.publishers, node.subscriptions, node.services, node.clients, node.timers)
    return tuple(len(list(kind)) for kind in kinds)


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.name)
def test_a_launch_file_is_python(path: Path, tmp_path: Path) -> None:
    py_compile.compile(
        str(path),
        cfile=str(tmp_path / "compiled"),
        doraise=True,
    )


def test_the_launch_files_are_there() -> None:
    assert [path.name for path in LAUNCH] == ["calibration.launch.py", "display.launch.py"]
    view = YAML(typ="safe", pure=True).load((REPOSITORY / "config" / "proprio.rviz").read_text())
    topics = [
        display["Topic"]["Value"]
        for display in view["Visualization Manager"]["Displays"]
        if "Topic" in display
    ]
    assert topics == ["/identifier/markers", "/identifier/next_push"]


def test_the_manifest_names_what_launch_files_need() -> None:
    needed = {"launch", "launch_ros", "ament_index_python"}
    for path in LAUNCH:
        needed |= set(re.findall(r'package="(\w+)"', path.read_text()))
    assert {"robot_state_publisher", "rviz2"} < needed
    manifest = ElementTree.parse(REPOSITORY / "package.xml").getroot()
    assert needed <= {entry.text for entry in manifest.findall("exec_depend")}


def test_the_container_that_is_typed_is_the_one_that_is_expected() -> None:
    """`object:=container:0.03,sphere=0.012` needs no further settings."""
    held = virtual_object("container:0.03,sphere=0.012")
    assert isinstance(held, Container) and (held.mass_kg, held.sphere_mass_kg) == (0.03, 0.012)
    expected = YAML(typ="safe", pure=True).load(resource("probes", "container").read_text())
    assert expected["container"]["shape"] == "box" and expected["container"]["rpy"] == [
        0.0,
        0.0,
        0.0,
    ]
    assert list(held.inner_size_m) == expected["container"]["inner_size"]
    assert list(held.centre_m) == expected["container"]["centre"]
    assert held.sphere_radius_m == expected["sphere"]["radius"]


def description(path: Path) -> Any:
    """The launch file, loaded as `ros2 launch` loads it; needs launch."""
    pytest.importorskip("launch_ros", reason="launch and launch_ros come with ROS only")
    sources = importlib.import_module("launch.launch_description_sources")
    return sources.get_launch_description_from_python_launch_file(str(path))


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.name)
def test_every_launch_argument_is_described(path: Path) -> None:
    arguments = description(path).get_launch_arguments()
    assert {"namespace"} < {argument.name for argument in arguments}
    for argument in arguments:
        assert argument.default_value is not None, f"{argument.name} can be left out"
        words, _, _ = argument.description.partition(" Valid choices are")
        assert len(words.split()) > 3 and words.endswith("."), argument.name
        defaults = "".join(part.text for part in argument.default_value)
        assert not argument.choices or defaults in argument.choices


def started(**arguments: str) -> list[str]:
    """Programs that calibration.launch.py would start; none is started."""
    described = description(LAUNCH[0])
    launch = importlib.import_module("launch")
    context = launch.LaunchContext()
    for name, value in arguments.items():
        context.launch_configurations[name] = value
    return [
        Path(launch.utilities.perform_substitutions(context, action.cmd[0])).name
        for entity in described.entities
        for action in entity.visit(context) or []
        if type(action).__name__ == "Node"
    ]


REFUSED = [
    ({"held": "50g"}, "object '50g': mass=50g must be a number; valid: none | 0.05"),
    ({"robot": "nonsense"}, "unknown robot 'nonsense'; known robots: fr3, "),
    (
        {"params_file": "/nowhere/mine.yaml"},
        "params_file /nowhere/mine.yaml: not readable (No such file or directory)",
    ),
]


@pytest.mark.parametrize(("arguments", "reason"), REFUSED)
def test_what_the_nodes_would_refuse_is_refused_before_they_start(
    arguments: dict[str, str], reason: str
) -> None:
    with pytest.raises(ProprioError) as caught:
        check_arguments(**arguments)
    assert str(caught.value).startswith(reason) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "driver:\n  rate: 100.0\n", "/**/driver:\n  ros__parameters:\n    rate: a: b\n"]
)
def test_a_parameter_file_that_states_nothing_is_refused(text: str, tmp_path: Path) -> None:
    """The arm would move on default limits."""
    mine = tmp_path / "mine.yaml"
    mine.write_text(text)
    with pytest.raises(ProprioError, match=r"nothing was started"):
        check_arguments(params_file=str(mine))
    mine.write_text("/**/driver:\n  ros__parameters:\n    rate: 100.0\n")
    check_arguments(robot="pendulum", params_file=str(mine), held="0.05")


@pytest.mark.parametrize(("arguments", "reason"), REFUSED)
def test_a_launch_that_is_refused_says_so_in_one_line_and_fails(
    arguments: dict[str, str], reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("launch_ros", reason="launch and launch_ros come with ROS only")
    launch = importlib.import_module("launch")
    words = {"virtual": "true"} | {
        "object" if name == "held" else name: value for name, value in arguments.items()
    }
    service = launch.LaunchService(argv=[])
    file = launch.launch_description_sources.AnyLaunchDescriptionSource(str(LAUNCH[0]))
    included = launch.actions.IncludeLaunchDescription(file, launch_arguments=words.items())
    service.include_launch_description(launch.LaunchDescription([included]))
    assert service.run() == 1
    shown = "\n".join(
        record.getMessage() for record in caplog.records if record.levelname != "DEBUG"
    )
    assert reason in shown and "Traceback" not in shown and "process started" not in shown


def test_the_virtual_robot_is_started_on_request_only() -> None:
    real = ["proprio_driver", "proprio_excitation", "proprio_identifier"]
    assert started() == real
    assert started(virtual="true", object="0.02") == ["proprio_virtual", *real]
