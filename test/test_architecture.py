"""Dependencies point down only: this test reads the imports and fails on an arrow that points up."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from proprio_ros.probes import PROBES

PACKAGE = Path(__file__).resolve().parents[1] / "proprio_ros"

# each room, and the rooms it may look at
ROOMS: dict[str, set[str]] = {
    "errors": set(),
    "schema": set(),
    "threads": set(),
    # what takes long says so to whoever listens
    "progress": set(),
    # what a user hands in: parsed with limits, and read by stated types, units and ranges
    "reading": {"errors"},
    "forms": {"reading"},
    "records": {"errors"},
    "resources": {"errors"},
    "quantity": {"errors"},
    # the unknowns that fits may have, with their units and what to call them
    "kinds": set(),
    # whose arm it is
    "motors": {"forms"},
    "calibration": {"errors", "quantity", "kinds", "forms", "motors"},
    # what a calibration is worth some time later
    "drift": {"calibration", "forms"},
    # a bag may hold the robot's description
    "robot": {
        "drift",
        "errors",
        "resources",
        "quantity",
        "calibration",
        "motion_calibration",
        "joint_calibration",
        "kinds",
        "forms",
        "reading",
        "bags",
    },
    # what drives a motor that knows no current
    "voltage": {"errors", "records", "robot"},
    # what motions with known loads say about the only joint of a robot
    "joint_calibration": {"errors", "forms", "records", "calibration"},
    "settings": {"errors", "resources", "forms", "reading"},
    "realtime": set(),
    "bags": {"errors", "records", "forms", "reading", "motors"},
    # episodes of data sets in parquet
    "datasets": {"errors", "records", "reading", "bags"},
    # which topics a driver has and what they mean, as files say it
    "drivers": {"errors", "forms", "reading", "resources", "bags", "datasets"},
    "runs": {"errors", "records"},
    # recordings in which several joints move at once
    "motions": {"errors", "records"},
    # what motions with an empty hand say about an arm
    "motion_calibration": {"errors", "forms", "kinds", "calibration"},
    "sim": {"errors", "progress", "records", "robot", "reading"},
    "identification": {
        "errors",
        "schema",
        "records",
        "motions",
        "motion_calibration",
        "joint_calibration",
        "quantity",
        "kinds",
        "robot",
        "calibration",
        "sim",
    },
    "report": {"errors", "resources", "quantity", "kinds", "calibration", "identification"},
    "published": {"errors", "records", "robot", "bags"},
    # which push comes next, and when there is none: for anything that is identified, and for weighings
    "choosing": {"errors", "quantity", "records", "robot", "identification", "excitation"},
    "until": {"choosing", "quantity", "records", "robot", "sim", "identification", "excitation"},
    # what can be identified: each probe in a folder of its own, and none of them known to any room below
    "probes": {
        "errors",
        "forms",
        "reading",
        "records",
        "motions",
        "motion_calibration",
        "joint_calibration",
        "quantity",
        "kinds",
        "settings",
        "robot",
        "bags",
        "published",
        "sim",
        "identification",
        "report",
        "excitation",
        "choosing",
        "until",
    },
    "replay": {
        "errors",
        "calibration",
        "drift",
        "motors",
        "schema",
        "threads",
        "records",
        "reading",
        "resources",
        "settings",
        "robot",
        "bags",
        "datasets",
        "drivers",
        "runs",
        "motions",
        "plausibility",
        "published",
        "identification",
        "probes",
        "report",
        "voltage",
    },
    "calibrating": {
        "errors",
        "reading",
        "bags",
        "datasets",
        "motors",
        "schema",
        "threads",
        "resources",
        "settings",
        "robot",
        "calibration",
        "motion_calibration",
        "joint_calibration",
        "quantity",
        "voltage",
        "motions",
        "sim",
        "identification",
        "probes",
        "replay",
    },
    # a live recording: raw messages to a bag, and the bag to a result
    "session": {
        "errors",
        "resources",
        "records",
        "settings",
        "robot",
        "bags",
        "runs",
        "sim",
        "identification",
        "probes",
        "replay",
        "calibrating",
    },
    # what a live job goes by, and the folder where all is kept
    "keeping": {"errors", "settings", "robot", "probes", "replay", "session"},
    # joint states of an arm at work, and what they say of its hand
    "at_work": {"bags", "motions", "quantity", "robot", "identification", "probes"},
    # an answer in words, and as keys and values
    "answers": {"quantity", "identification", "probes"},
    # what is in a bag, before any fit
    # what a recording shows of itself
    "plausibility": {"records", "motions", "robot", "identification"},
    "checking": {
        "errors",
        "quantity",
        "plausibility",
        "schema",
        "threads",
        "records",
        "resources",
        "settings",
        "robot",
        "bags",
        "drivers",
        "runs",
        "motions",
        "identification",
        "probes",
        "replay",
        "voltage",
    },
    # many recordings: rows in parquet, by processes or a Ray cluster
    "batch": {
        "errors",
        "records",
        "reading",
        "resources",
        "schema",
        "threads",
        "settings",
        "quantity",
        "bags",
        "datasets",
        "motions",
        "robot",
        "motion_calibration",
        "identification",
        "probes",
        "replay",
        "calibrating",
        "report",
    },
    # for scripts and notebooks
    "api": {
        "errors",
        "quantity",
        "schema",
        "resources",
        "robot",
        "calibration",
        "identification",
        "replay",
        "calibrating",
        "checking",
        "report",
    },
    # the paper's experiments again: recordings of a virtual arm, the paper's way and ours, and one page
    "paper": {
        "replay",
        "errors",
        "threads",
        "records",
        "runs",
        "resources",
        "robot",
        "sim",
        "identification",
        "excitation",
        "virtual",
        "probes",
        "report",
        "quantity",
    },
    "cli": {
        "batch",
        "paper",
        "errors",
        "progress",
        "reading",
        "quantity",
        "schema",
        "settings",
        "resources",
        "robot",
        "identification",
        "probes",
        "replay",
        "calibrating",
        "checking",
        "api",
        "report",
        "nodes",
    },
    # what the arm's own controller is told
    "handing_on": {"errors", "robot", "probes"},
    "bus": {"errors", "records", "robot", "realtime", "motors"},
    # an emulated servo is the same table of registers as a real one
    "virtual": {"errors", "records", "robot", "realtime", "bus"},
    "excitation": {"errors", "reading", "records", "resources", "robot"},
    "nodes": {
        "calibration",
        "errors",
        "motions",
        "motors",
        "progress",
        "quantity",
        "records",
        "resources",
        "robot",
        "bags",
        "runs",
        "identification",
        "probes",
        "replay",
        "calibrating",
        "report",
        "bus",
        "excitation",
        "virtual",
        "session",
        "keeping",
        "at_work",
        "answers",
        "handing_on",
        "settings",
        "realtime",
        "choosing",
        "until",
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
    # the paper's room for Newton only, whose models and gradients are Warp's
    "warp": {"sim", "paper"},
    "newton": {"paper"},
    "rosbags": {"bags"},
    "mujoco": {"virtual", "paper"},
    "dynamixel_sdk": {"bus"},
    "matplotlib": {"report", "probes", "api"},
    "pandas": {"api"},
    "cma": {"identification"},
    "meshio": {"sim"},
    "pyarrow": {"datasets", "batch"},
    "ray": {"batch"},
}


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def modules() -> list[Path]:
    return [
        path for path in sorted(PACKAGE.rglob("*.py")) if path != PACKAGE / "__init__.py" and "launch" not in path.parts
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


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_arrow_points_up(path: Path) -> None:
    room = room_of(path)
    assert room in ROOMS, f"{room} has no place in the house: give it one in ROOMS"
    for name in imports(path):
        top, _, rest = name.partition(".")
        if top == "proprio_ros":
            target = rest.split(".")[0]
            assert target in ROOMS[room] | {room, "__version__"}, f"{room} must not look at {target}"
        assert top not in ROS or room == "nodes", f"{room} must not import {top}"
        assert room in ONLY_IN.get(top, {room}), f"{room} must not import {top}"


def test_no_room_but_the_probes_names_a_probe() -> None:
    """Command line, services, report, demo and launch file ask the registry."""
    # virtual objects, simulators and what a hand holds in a sequence are called the same
    may = {"probes", "virtual", "sim", "excitation", "paper"}
    for path in PACKAGE.rglob("*.py"):
        if room_of(path) in may:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert node.value not in ("container", "softness"), f"{path}:{node.lineno} names a probe"


def test_nodes_name_no_probe() -> None:
    """Not even the first. A topic of the contract and a sequence are called like it; sentences are for people."""
    may = {("results.py", "~/payload"), ("excitation.py", "payload")}
    for path in (PACKAGE / "nodes").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value.strip():
                named = set(re.findall("[a-z]+", node.value)) & set(PROBES)
                assert not named or (path.name, node.value) in may, f"{path}:{node.lineno} names {named}"


def test_no_file_of_nodes_is_long() -> None:
    """Nodes are thin: parameters in, messages out, one call between."""
    for path in (PACKAGE / "nodes").glob("*.py"):
        lines = len(path.read_text().splitlines())
        assert lines <= 500, f"{path} has {lines} lines: what needs no ROS goes into a module of its own"


def test_the_table_has_no_circle() -> None:
    open_rooms = dict(ROOMS)
    while open_rooms:
        leaves = [room for room, targets in open_rooms.items() if not targets & open_rooms.keys()]
        assert leaves, f"a circle among {sorted(open_rooms)}"
        for room in leaves:
            del open_rooms[room]


@pytest.mark.long
def test_only_the_command_line_prints() -> None:
    for path in modules():
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        prints = [node.lineno for node in calls if isinstance(node.func, ast.Name) and node.func.id == "print"]
        assert not prints or room_of(path) == "cli", f"{path}:{prints}"
