"""What the nodes and the pages have kept: weighings, calibrations, recordings, a folder each."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from proprio_ros.addons.pendant.desk import BATCH, CALIBRATION, ESTIMATE, REPORT
from proprio_ros.addons.pendant.places import Places
from proprio_ros.errors import ProprioError
from proprio_ros.robot import load_robot

MOST_FOLDERS = 300
LARGEST = 2**22  # bytes of an answer
_STAMP = "%Y%m%d_%H%M%S"
_STAMP_LENGTH = 15


@dataclass(frozen=True)
class Kept:
    """One folder.

    Attributes:
        estimate: The answer; empty: there is none.
        calibration: Its file; None: there is none.
        bag: What was recorded; None: nothing was.
        report: The page; None: there is none.
    """

    folder: Path
    when: datetime
    estimate: dict[str, Any]
    calibration: Path | None
    bag: Path | None
    report: Path | None

    @property
    def what(self) -> str:
        """As the nodes call it."""
        return self.folder.name.rpartition("_")[2]


def kept(places: Places) -> list[Kept]:
    """What is in the folder of answers, newest first. Raises `ConfigurationError`: It may not be looked into."""
    return list(_each(places.inside(places.data)))


def _each(folder: Path) -> Iterator[Kept]:
    try:
        inner = sorted(folder.iterdir(), key=lambda path: path.name, reverse=True)
    except OSError:
        return  # nothing was kept yet
    for path in [path for path in inner if path.is_dir() and not path.is_symlink()][:MOST_FOLDERS]:
        estimate = estimate_in(path)
        calibration = _there(path / CALIBRATION)
        bag = _there(path / "bag")
        report = _there(path / REPORT) or _there(path / BATCH)
        if estimate or calibration or bag or report:
            yield Kept(
                path,
                _when(path),
                estimate,
                calibration,
                bag,
                report,
            )


def _there(path: Path) -> Path | None:
    return path if path.exists() and not path.is_symlink() else None


def estimate_in(folder: Path) -> dict[str, Any]:
    """The answer in a folder; empty: there is none."""
    path = folder / ESTIMATE
    try:
        if path.is_symlink() or path.stat().st_size > LARGEST:
            return {}
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _when(folder: Path) -> datetime:
    """By the name that the nodes give; else when it was changed."""
    try:
        return datetime.strptime(folder.name[:_STAMP_LENGTH], _STAMP)
    except ValueError:
        return datetime.fromtimestamp(folder.stat().st_mtime)


def calibrations(places: Places) -> list[Path]:
    """Files of calibrations, newest first: those kept, and those in the folder where the pendant was started."""
    found = [each.calibration for each in kept(places) if each.calibration]
    beside = [path for path in places.begun.glob("*.yaml") if _is_calibration(path)]
    return [*found, *beside]


def _is_calibration(path: Path) -> bool:
    with path.open(encoding="utf-8", errors="replace") as stream:
        return "\ncalibrated: true" in stream.read(2000)


def terms(path: Path) -> dict[str, tuple[float, float]]:
    """What a calibration says of each joint: friction [N m or N] with its standard deviation; empty where it cannot be read."""
    try:
        robot = load_robot(path)
    except ProprioError:
        return {}
    return {
        joint: (drive.coulomb.value, drive.coulomb.std)
        for joint, drive in robot.drive_trains.items()
    }
