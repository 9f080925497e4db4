"""A robot whose description may lie in a bag."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from proprio_ros.robot import Robot, load_robot


def robot_named(
    name_or_path: str | Path,
    overrides: Mapping[str, Any] | None = None,
) -> Robot:
    """As `load_robot`, where the file may name a bag that holds ``/robot_description``; Raises as that, and as `description_of`."""
    return load_robot(name_or_path, overrides, description_of)


def description_of(bag: Path) -> str:
    """The URDF that a bag holds on ``/robot_description``. Raises `RecordingError`: It cannot be read, or holds no description."""
    from proprio_ros.recordings.sources import BagSource

    with BagSource(bag) as source:
        return source.description()
