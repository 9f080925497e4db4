"""Dependencies point down only: this test reads the imports and fails on an arrow that points up."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from proprio_ros.probes import PROBES
from proprio_ros.public import MODULES

PACKAGE = Path(__file__).resolve().parents[1] / "proprio_ros"

# modules on top of the package: values and conventions that every room may use; they know each other and nothing else
BASE = {
    "version",
    "errors",
    "records",
    "quantity",
    "kinds",
    "progress",
    "schema",
    "threads",
    "clock",
    "whole_files",
    "registry",
    "public",
}
# each room below stands on those above it; its row says on which
ROOMS: dict[str, set[str]] = {
    "inputs": set(),
    "calibration_files": {"inputs"},
    "robot": {"inputs", "calibration_files"},
    "recordings": {"inputs", "calibration_files", "robot"},
    "bus": {"calibration_files", "robot"},
    # an emulated servo is the same table of registers as a real one
    "virtual": {"robot", "bus"},
    "excitation": {"inputs", "robot"},
    "sim": {"inputs", "robot"},
    "identification": {"calibration_files", "robot", "recordings", "sim"},
    "experiment_design": {"robot", "recordings", "excitation", "sim", "identification"},
    "report": {"inputs", "calibration_files", "identification"},
    # what can be identified: each probe in a folder of its own, and none of them known to any room above
    "probes": {
        *(
            "inputs",
            "calibration_files",
            "robot",
            "recordings",
            "virtual",
            "excitation",
            "sim",
            "identification",
        ),
        *("experiment_design", "report"),
    },
    "pipeline": {
        *(
            "inputs",
            "calibration_files",
            "robot",
            "recordings",
            "sim",
            "identification",
            "experiment_design",
        ),
        *("report", "probes"),
    },
    "live": {
        *(
            "inputs",
            "robot",
            "recordings",
            "excitation",
            "sim",
            "identification",
            "experiment_design",
        ),
        *("probes", "pipeline"),
    },
    "nodes": {
        *(
            "inputs",
            "calibration_files",
            "robot",
            "recordings",
            "bus",
            "virtual",
            "excitation",
            "identification",
        ),
        *("experiment_design", "report", "probes", "pipeline", "live"),
    },
    "cli": {
        *(
            "inputs",
            "robot",
            "recordings",
            "identification",
            "report",
            "probes",
            "pipeline",
            "nodes",
        )
    },
    # what can be deleted: `registry` finds it, and nothing above looks at it
    "addons.contents": {
        *(
            "inputs",
            "robot",
            "virtual",
            "sim",
            "identification",
            "report",
            "probes",
        )
    },
    "addons.fleet": {
        *(
            "inputs",
            "calibration_files",
            "robot",
            "recordings",
            "identification",
            "report",
            "probes",
            "pipeline",
            "cli",
        )
    },
    "addons.paper": {
        *(
            "inputs",
            "robot",
            "recordings",
            "excitation",
            "virtual",
            "sim",
            "identification",
            "report",
            "probes",
            "pipeline",
            "cli",
        )
    },
    # a client of the nodes
    "addons.pendant": {
        *(
            "inputs",
            "robot",
            "recordings",
            "excitation",
            "identification",
            "report",
            "probes",
            "pipeline",
            "nodes",
            "cli",
        )
    },
}
ROS = {
    "rclpy",
    "std_msgs",
    "std_srvs",
    "sensor_msgs",
    "geometry_msgs",
    "diagnostic_msgs",
    "visualization_msgs",
    "rcl_interfaces",
    "builtin_interfaces",
    "launch",
}
# heavy or special libraries, and the only rooms that may import them
ONLY_IN = {
    "warp": {"sim", "addons.contents", "addons.paper"},
    "rosbags": {"recordings"},
    "mujoco": {"virtual", "addons.paper"},
    "dynamixel_sdk": {"bus"},
    "matplotlib": {"report", "probes", "pipeline"},
    "pandas": {"pipeline"},
    "cma": {"identification"},
    "meshio": {"sim"},
    "pyarrow": {"recordings", "addons.fleet"},
    "ray": {"addons.fleet"},
    "nicegui": {"addons.pendant"},
}


def room_of(path: Path) -> str:
    return room_named(path.relative_to(PACKAGE).with_suffix("").parts)


def room_named(parts: Sequence[str]) -> str:
    """The room of a module, of its path or dotted name below the package; each add-on is one."""
    return ".".join(parts[:2]) if parts[0] == "addons" else parts[0]


def modules() -> list[Path]:
    return [
        path
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.parent not in (PACKAGE / "launch", PACKAGE / "addons")
        and path != PACKAGE / "__init__.py"
    ]


def imports(path: Path) -> set[str]:
    """Dotted names of everything a file imports, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize(
    "path",
    modules(),
    ids=lambda path: str(path.relative_to(PACKAGE)),
)
def test_no_arrow_points_up(path: Path) -> None:
    room = room_of(path)
    assert room in ROOMS.keys() | BASE, f"{room} has no place in the house: give it one in ROOMS"
    may = BASE | {room} | ROOMS.get(room, set())
    for name in imports(path):
        top, _, rest = name.partition(".")
        if top == "proprio_ros":
            target = room_named(rest.split("."))
            assert target in may, f"{room} must not look at {target}"
        hears = room == "nodes" or path.match("addons/pendant/listener.py")
        assert top not in ROS or hears, f"{room} must not import {top}"
        assert room in ONLY_IN.get(top, {room}), f"{room} must not import {top}"


def test_no_room_but_the_probes_names_a_probe() -> None:
    """Command line, services, report, demo and launch file ask the registry."""
    # what a hand holds in a sequence is called the same
    may = {"probes", "excitation", "addons.paper"}
    for path in PACKAGE.rglob("*.py"):
        if room_of(path) in may:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert node.value not in ("container", "softness"), (
                    f"{path}:{node.lineno} names a probe"
                )


def test_only_add_ons_look_into_a_probe() -> None:
    """All others ask the registry."""
    inside = tuple(f"proprio_ros.probes.{name}" for name in PROBES)
    for path in PACKAGE.rglob("*.py"):
        if room_of(path) != "probes" and not room_of(path).startswith("addons."):
            looks = [name for name in imports(path) if name.startswith(inside)]
            assert not looks, f"{path} looks at {looks}"


def test_nodes_name_no_probe() -> None:
    """Not even the first. A topic of the contract and a sequence are called like it; sentences are for people."""
    topic = {("results.py", "~/payload"), ("interface.py", "/identifier/payload")}
    may = topic | {("tables.py", "payload")}
    for path in (PACKAGE / "nodes").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and " " not in node.value.strip()
            ):
                named = set(re.findall("[a-z]+", node.value)) & set(PROBES)
                assert not named or (path.name, node.value) in may, (
                    f"{path}:{node.lineno} names {named}"
                )


def test_the_core_names_no_add_on() -> None:
    """Only `registry` knows where they are; each can be deleted."""
    for path in PACKAGE.rglob("*.*"):
        if path.suffix in (".py", ".css", ".js") and not room_of(path).startswith("addons"):
            if path != PACKAGE / "registry.py":
                assert "addons" not in path.read_text(encoding="utf-8"), path


def test_add_ons_use_the_public_part_of_the_core() -> None:
    public = {
        ".".join(filter(None, ("proprio_ros", room, name)))
        for room, names in MODULES.items()
        for name in names
    }
    used = set()
    for path in (PACKAGE / "addons").glob("*/*.py"):
        for name in imports(path):
            if name.startswith("proprio_ros.") and not name.startswith("proprio_ros.addons."):
                module = name if name in public else name.rpartition(".")[0]
                assert module in public, f"{path}: {name} is not of the public part of the core"
                assert not re.search(r"\._[^_]", name), f"{path}: {name} is private"
                used.add(module)
    assert used == public and len(public) <= 90, f"no add-on uses {public - used}"


def test_few_modules_stand_on_top() -> None:
    on_top = [path.name for path in PACKAGE.glob("*.py")]
    assert len(on_top) <= 13, on_top


def test_rooms_stand_on_those_above() -> None:
    above: set[str] = set()
    for room, targets in ROOMS.items():
        assert targets <= above, f"{room} looks at {sorted(targets - above)}, which come after it"
        above.add(room)


@pytest.mark.long
def test_only_the_command_line_prints() -> None:
    for path in modules():
        calls = [
            node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
        ]
        prints = [
            node.lineno
            for node in calls
            if isinstance(node.func, ast.Name) and node.func.id == "print"
        ]
        assert not prints or room_of(path) == "cli", f"{path}:{prints}"
