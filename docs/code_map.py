"""Which rooms of the package import which heavy library, read from the code for the page about its design."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "proprio_ros"
LIBRARIES = {
    "warp": "simulation and its derivatives",
    "mujoco": "the virtual arm",
    "rosbags": "bags, and messages without ROS",
    "rclpy": "nodes",
    "dynamixel_sdk": "the vendor's protocol",
    "matplotlib": "figures of pages and notebooks",
    "pyarrow": "rows and data sets",
    "ray": "batches on a cluster",
    "cma": "one of the solvers",
    "meshio": "blocks from mesh files",
    "pandas": "`to_frame()` of results",
    "nicegui": "pages of the pendant",
}
"""Imported where they are used and when they are needed, and what for."""


def imported(path: Path) -> set[str]:
    """Top-level names of the modules that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add((node.module or "").partition(".")[0])
    return found


def room_of(path: Path) -> str:
    """The room of a file: its folder, of an add-on with the add-on's name."""
    parts = path.relative_to(PACKAGE).parts
    depth = 2 if parts[0] == "addons" else 1
    return "/".join(parts[:depth]) if len(parts) > depth else parts[0]


def libraries() -> list[tuple[str, str, str]]:
    """Of each heavy library its name, what it is for, and the rooms that import it."""
    rooms: dict[str, set[str]] = defaultdict(set)
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in imported(path) & LIBRARIES.keys():
            rooms[name].add(room_of(path))
    return [
        (f"`{name}`", purpose, ", ".join(f"`{room}`" for room in sorted(rooms[name])) or "none")
        for name, purpose in LIBRARIES.items()
    ]
