"""Recordings as text: the motion of one joint with its setting, and places that a camera saw."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.inputs.forms import FormError, Number, Text, Whole, shortly
from proprio_ros.inputs.reading import LONGEST_TABLE, finite, json_of, path_problem, text_of
from proprio_ros.records import IMPLAUSIBLE_POSITION, MIN_SAMPLES, FloatArray, PointTrack

MOST_ROWS = 200_000  # rows of a CSV file: nearly two hours at 30 Hz

LONGEST_PERIOD_S = 0.25  # of a joint that is pushed: half a second of it would be two rows


@dataclass(frozen=True)
class TextRecording:
    """The motion of one joint as text, with the setting in which it was made."""

    # name, joint: of the folder, and of the joint that moved
    name: str
    joint: str
    times_s: FloatArray  # sampling instants [s], strictly increasing, shape (T,)
    relative_position: FloatArray  # position of the joint minus its start pose [rad], shape (T,)
    # what setting.json says: `moving_joint`, `torque_N_m`, `start_pose_rad` by joint, and whatever else
    setting: dict[str, Any]


def is_text_recording(path: str | Path) -> bool:
    """Whether a path is a folder with trajectory.csv and setting.json."""
    return not path_problem(path) and all(
        (Path(path) / name).is_file() for name in ("trajectory.csv", "setting.json")
    )


def read_text_recording(path: str | Path) -> TextRecording:
    """Read a folder with trajectory.csv (columns `time_s,<joint>_relative_rad`) and setting.json; refuses malformed ones."""
    path = Path(path)
    if not is_text_recording(path):
        raise RecordingError("not a text recording; it needs trajectory.csv and setting.json", path)
    setting = _setting(path / "setting.json")
    joint = setting["moving_joint"]
    file = path / "trajectory.csv"
    names = ["time_s", f"{joint}_relative_rad"]
    expected = ",".join(names)
    header, rows = _csv_table(file, expected)
    try:
        table = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise RecordingError(
            f"not a table of numbers under the header {expected} ({error})", file
        ) from error
    if header != names:
        raise RecordingError(f"the header must be {expected}, got {','.join(header)}", file)
    if (
        table.ndim != 2
        or table.shape[1] != 2
        or len(table) < MIN_SAMPLES
        or not np.isfinite(table).all()
    ):
        raise RecordingError(f"needs at least {MIN_SAMPLES} rows of two finite numbers", file)
    if not bool(np.all(np.diff(table[:, 0]) > 0)):
        raise RecordingError("time_s must increase from row to row", file)
    period_s = float(np.median(np.diff(table[:, 0])))
    if period_s > LONGEST_PERIOD_S:
        numbers = bool(np.all(np.diff(table[:, 0]) == 1.0))
        what = "holds row numbers" if numbers else f"goes by {period_s:.3g} a row: is it in ms?"
        raise RecordingError(f"time_s {what}; it must be in seconds, of a clock", file)
    table.setflags(write=False)
    return TextRecording(
        path.resolve().name,
        joint,
        table[:, 0],
        table[:, 1],
        setting,
    )


_SETTING_NUMBERS = {
    "torque_N_m": Number("that drives the joint", "N m", -1e3, 1e3),
    "true_mass_kg": Number("of the object", "kg", 0.0, 1e3),
    "current_A_by_the_paper": Number("that drives the joint", "A", -1e3, 1e3),
    "armature_kg_m2": Number("of the joint", "kg m^2", 0.0, 100.0),
    "gravity_m_s2": Number("downwards", "m/s^2", -100.0, 100.0),
    "simulation.substeps": Whole("of the paper's own fit", "", 1, 1024),
    "fit.start_mass_kg": Number("first guess of the paper's own fit", "kg", 0.0, 20.0, open=True),
}
_POSITION = Number("of a joint", "rad", -IMPLAUSIBLE_POSITION, IMPLAUSIBLE_POSITION)


def _setting(file: Path) -> dict[str, Any]:
    text = text_of(file, RecordingError)
    try:
        setting = json_of(text)
    except ValueError as error:
        raise RecordingError(f"not readable as JSON ({error})", file) from error
    needed = ("moving_joint", "torque_N_m", "start_pose_rad")
    missing = [key for key in needed if not isinstance(setting, dict) or key not in setting]
    if missing:
        raise RecordingError(
            f"{', '.join(missing)} missing; it must be an object with {', '.join(needed)}", file
        )
    try:
        Text(what="text").read(setting["moving_joint"])
    except FormError as error:
        raise RecordingError(f"moving_joint must be a name: {error}", file) from error
    pose = setting["start_pose_rad"]
    joint = setting["moving_joint"]
    numbers = {key: setting[key] for key in _SETTING_NUMBERS if key in setting}
    if not isinstance(pose, dict) or joint not in pose:
        raise RecordingError(
            f"start_pose_rad must give a position for each joint, {joint!r} too", file
        )
    for section in ("simulation", "fit"):
        part = setting.get(section, {})
        if not isinstance(part, dict):
            raise RecordingError(f"{section} must be an object, got {shortly(part)}", file)
        numbers |= {
            f"{section}.{key}": value
            for key, value in part.items()
            if f"{section}.{key}" in _SETTING_NUMBERS
        }
    numbers |= {f"start_pose_rad.{joint}": value for joint, value in pose.items()}
    for key, value in numbers.items():
        if finite(value) is None:
            raise RecordingError(f"{key} must be a number, got {shortly(value)}", file)
        try:
            _SETTING_NUMBERS.get(key, _POSITION).read(value)
        except FormError as error:
            raise RecordingError(f"{key}: {error}", file) from error
    return dict(setting)


def read_point_file(path: str | Path) -> PointTrack:
    """Where something was seen, by a CSV file with the header ``stamp_ns,x,y,z``: clock of the joint states [ns], and m."""
    header, table = _csv_table(Path(path), "stamp_ns,x,y,z")
    if header != ["stamp_ns", "x", "y", "z"]:
        raise RecordingError(f"the header must be stamp_ns,x,y,z, got {','.join(header)}", path)
    try:
        stamps = np.array(
            [int(row[0]) for row in table],
            dtype=np.int64,
        )
        points = np.array([[float(cell) for cell in row[1:]] for row in table]).reshape(
            -1,
            3,
        )
    except (ValueError, OverflowError) as error:
        raise RecordingError(
            f"needs rows of a whole number of ns and three numbers in m ({error})", path
        ) from error
    return PointTrack.of_seen(stamps, points)


def _csv_table(
    file: Path,
    form: str,
) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a CSV file, all cells as text."""
    text = text_of(file, RecordingError, LONGEST_TABLE)
    try:
        header, *rows = [row for row in csv.reader(text.splitlines()) if row]
    except (ValueError, csv.Error) as error:
        raise RecordingError(
            f"not a table of numbers under the header {form} ({error})", file
        ) from error
    if len(rows) > MOST_ROWS:
        raise RecordingError(
            f"has {len(rows)} rows, and {MOST_ROWS} are the most that are read: cut it", file
        )
    return [cell.strip() for cell in header], rows
