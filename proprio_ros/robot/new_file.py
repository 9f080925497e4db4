"""A robot file to fill in, from a URDF: every key with its default, its unit and what it is for, from the forms it is read with."""

from __future__ import annotations

import math
import os
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from proprio_ros.errors import RobotError, some
from proprio_ros.inputs.forms import Field, Text, Truth
from proprio_ros.quantity import Quantity
from proprio_ros.robot.default_priors import RECORDED_TORQUE, DefaultPrior, largest_torque
from proprio_ros.robot.description import PACKAGE, check_masses, read_model
from proprio_ros.robot.fields import DRIVE_TRAIN, JOINT, MOTOR, NOMINAL, ROBOT, Uncertain
from proprio_ros.robot.hands import arm_joints, hand_link, path_to, tip_of
from proprio_ros.robot.links import Joint
from proprio_ros.robot.tree import STANDARD_GRAVITY, RobotModel
from proprio_ros.robot.urdf import MOST_EFFORT
from proprio_ros.whole_files import real_path

STATE = "STATE THIS"
CHECK = "CHECK THIS"
_COLUMN = 52  # where comments begin
# what YAML reads as something else
_NO_TEXT = ("null", "true", "false", "yes", "no", "on", "off", "y", "n")
_WRITTEN_BY_CALIBRATE = ("model_fingerprint", "calibration", "joint_calibration")


@dataclass(frozen=True)
class NewFile:
    """A robot file to fill in."""

    name: str
    text: str
    joints: tuple[str, ...]
    payload_frame: str  # a guess at the link in which objects are held, to be checked
    to_state: tuple[str, ...]  # dotted keys that must be stated before the file can be loaded
    # joints of which the URDF states no limit of effort: plans and pushes want their current_limit_A
    unlimited: tuple[str, ...]
    notes: tuple[
        str, ...
    ]  # what was taken for something else than the URDF states, and what was left out
    tip: str | None  # last link of the arm, where the robot has joints beside it
    only_read: tuple[str, ...]  # joints that carry the arm and more, and those beside it


def new_robot_file(
    source: str,
    output: Path,
    of_bag: Callable[[Path], str] | None = None,
    torque_recorded: bool = False,
    tip: str | None = None,
) -> NewFile:
    """Write down what a URDF says of a robot, and what must be stated beside it.

    Args:
        source: Of the URDF, as in `read_model`.
        output: Where the file will be; it names its URDF by the way from there.
        of_bag: Takes the URDF out of a bag.
        torque_recorded: Whether efforts are torque: then no torque constant is needed, and fingers, which only squeezes drive, are
            left out.
        tip: Last link of the arm; None: of the only one.

    Raises:
        RobotError, RecordingError: The description cannot be read, links that move have no mass, or it is not said which of several
            hands holds the object; these are named.
    """
    model = read_model(source, of_bag)
    if not model.independent_joints:
        raise RobotError(
            f"{source}: no joint of it moves: give the URDF of an arm, with revolute, continuous or prismatic joints"
        )
    check_masses(model, source if source.startswith(PACKAGE) else Path(source).name)
    tip = tip or tip_of(model)
    frame = hand_link(model, tip)
    values = {"name": model.name, "payload_frame": frame, "tip": tip}
    joints = _driven(model, tip, torque_recorded)
    carrying, beside = _read_only(model, tip, joints)
    notes = _notes(model, carrying, beside)
    lines = _head(model.name, notes, torque_recorded)
    for key, entry in ROBOT.items():
        if key in _WRITTEN_BY_CALIBRATE:
            continue
        guess = f"{CHECK}, a guess: " if key == "payload_frame" else ""
        value = values.get(key, _default(entry, model))
        lines.append(_line(0, key, value, guess + _words(entry)))
        if key == "name":
            words = "its description: a .urdf file, a bag, robot_descriptions:NAME"
            lines.append(_line(0, "urdf", _way(source, output), words))
    lines += [
        "",
        "# delete a joint that has no motor, such as a wheel that rolls freely: it is then held",
        "joints:",
    ]
    to_state = []
    for number, name in enumerate(joints):
        lines += _joint(model, name, explained=number == 0, torque_recorded=torque_recorded)
        if torque_recorded:
            continue
        to_state.append(f"joints.{name}.motor.{NOMINAL}")
        if model.joint(name).kind == "prismatic":
            to_state.append(f"joints.{name}.transmission_m_per_rad")
    unlimited = tuple(name for name in joints if model.joint(name).effort_limit > MOST_EFFORT)
    return NewFile(
        model.name,
        "\n".join(lines) + "\n",
        joints,
        frame,
        tuple(to_state),
        unlimited,
        notes,
        tip,
        (*carrying, *beside),
    )


def _notes(
    model: RobotModel,
    carrying: tuple[str, ...],
    beside: tuple[str, ...],
) -> tuple[str, ...]:
    """What was taken for something else than the URDF states, and what was left out.

    Args:
        model: The description.
        carrying: Joints that carry the arm and more.
        beside: Those beside it.
    """
    idle = f"left out, since nothing that moves with them has mass: {some(model.idle_joints)}"
    read = f"beside the arm, only read: {some(beside)}"
    carried = (
        f"the arm and more is carried by {some(carrying)}: positions count, efforts are not used"
    )
    return (
        *model.notes,
        *[idle] * bool(model.idle_joints),
        *[carried] * bool(carrying),
        *[read] * bool(beside),
    )


def _driven(model: RobotModel, tip: str | None, torque_recorded: bool) -> tuple[str, ...]:
    """The joints that are listed as driven: those of the arm, or all where nothing is beside it."""
    joints = model.independent_joints if tip is None else arm_joints(model, tip)
    moving = tuple(name for name in joints if name not in model.idle_joints)
    of_hand = path_to(model, hand_link(model, tip))
    turning = tuple(
        name for name in moving if model.joint(name).kind != "prismatic" or name in of_hand
    )
    return turning if torque_recorded and turning else moving


def _read_only(
    model: RobotModel,
    tip: str | None,
    joints: tuple[str, ...],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Joints that carry the arm and more, and those beside it."""
    if tip is None:
        return (), ()
    carrying = tuple(name for name in path_to(model, tip) if name not in joints)
    others = {*model.independent_joints} - {*joints, *carrying}
    return carrying, tuple(name for name in model.independent_joints if name in others)


def _head(
    name: str,
    notes: tuple[str, ...],
    torque_recorded: bool,
) -> list[str]:
    state = f"What says {STATE} must be stated before it can be used"
    if torque_recorded:
        state = "Efforts are torque, N m: use it with --effort-unit N.m"
    words = (
        f"Robot file of {name}, written by `proprio robot new`. {state}; what says {CHECK} is a guess. Everything else has a "
        "default, wide enough to hold on most arms: state what you know, and `proprio calibrate` learns the rest. An uncertain "
        "number is {value: .., std: ..}; a plain number is known exactly; null is left out, and what is left out has its default. "
        "Everything under `joints` counts at the motor's output shaft, gear included."
    )
    lines = textwrap.wrap(words, 118)
    for note in notes:
        lines += textwrap.wrap(f"Note: {note}.", 118)
    return [*(f"# {line}" for line in lines), ""]


def _joint(
    model: RobotModel,
    name: str,
    explained: bool,
    torque_recorded: bool,
) -> list[str]:
    """All keys of one joint; what they are for stands at the first joint only."""
    joint = model.joint(name)
    unit = "N" if joint.kind == "prismatic" else "N m"
    limits = f", at most {joint.effort_limit:g} {unit} by its URDF"
    if joint.effort_limit > MOST_EFFORT:
        limits = ", its URDF states no limit of effort that a motor has"
    writer = _JointWriter(model, joint, unit, explained, torque_recorded)
    return [
        f"  {_yaml(name)}:  # {joint.kind}{limits}",
        "    motor:",
        *(writer.motor(key, entry) for key, entry in MOTOR.items()),
        "    drive_train:",
        *(writer.drive_train(key, entry) for key, entry in DRIVE_TRAIN.items()),
        *writer.rest(),
    ]


@dataclass(frozen=True)
class _JointWriter:
    """Lines of one joint in a robot file."""

    model: RobotModel
    joint: Joint
    unit: str  # of its effort
    explained: bool  # whether it is said what keys are for
    torque_recorded: bool

    @property
    def slides(self) -> bool:
        return self.joint.kind == "prismatic"

    def motor(self, key: str, entry: Field) -> str:
        """A key of the motor, whose nominal torque constant must be stated where no torque is recorded."""
        limit = self.joint.effort_limit
        if key == NOMINAL and self.torque_recorded:
            return self._stated(key, entry, 1, "torque is recorded, not current: ")
        if key == NOMINAL:
            about = f"; 1 where torque is recorded, not current; {_words(entry)}"
            return _line(
                6,
                key,
                None,
                STATE + (about if self.explained else ""),
            )
        if key == "current_limit_A" and self.torque_recorded and limit <= MOST_EFFORT:
            return self._stated(key, entry, limit, f"{self.unit}, its URDF's: ")
        return self._by_default(6, key, entry)

    def drive_train(self, key: str, entry: Field) -> str:
        """A key of the drive train; what is a part of something not yet stated is left to the reader of the file."""
        wide = entry.default if isinstance(entry.default, DefaultPrior) else None
        if wide is not None and wide.of == "nominal" and self.torque_recorded:
            return self._stated(key, entry, RECORDED_TORQUE)
        if wide is not None and (wide.of == "nominal" or self.slides):
            return self._stated(key, entry, None, f"null: {wide.described()}; ")
        return self._by_default(6, key, entry)

    def rest(self) -> list[str]:
        """What is neither of the motor nor of the drive train; most of it only a slide has."""
        lines = []
        for key, entry in JOINT.items():
            if key == "transmission_m_per_rad" and self.slides and self.torque_recorded:
                lines.append(_line(4, key, 1, "efforts are forces, N"))
            elif key == "transmission_m_per_rad" and self.slides:
                lines.append(self._by_default(4, key, entry, f"{STATE}: "))
            elif self.slides or key == "usable_velocity_rad_s":
                lines.append(self._by_default(4, key, entry))
        return lines

    def _stated(self, key: str, entry: Field, value: Any, mark: str = "") -> str:
        """A value, and why that one before what the key is for."""
        return _line(
            6,
            key,
            value,
            mark + _words(entry) if self.explained else "",
        )

    def _by_default(self, indent: int, key: str, entry: Field, mark: str = "") -> str:
        """The default; a mark stands there in any case."""
        words = mark + _words(entry) if self.explained or mark else ""
        return _line(
            indent,
            key,
            _default(entry, self.model, self.joint.name),
            words,
        )


def _default(entry: Field, model: RobotModel, joint: str = "") -> Any:
    """What holds where the key is left out, as the file writes it."""
    default = entry.default
    if isinstance(default, DefaultPrior):
        turning = [
            name for name in model.independent_joints if model.joint(name).kind != "prismatic"
        ]
        names = [joint] if joint else turning or model.independent_joints
        spread = default.at(0.0, min(largest_torque(model, name) for name in names)).std
        if not joint:
            return float(f"{spread:.4g}")
        default = Quantity(0.0, float(f"{spread:.4g}"))
    if isinstance(default, Quantity):
        return {"value": default.value, "std": default.std}
    if default is STANDARD_GRAVITY:
        return list(default)
    is_number = isinstance(default, (int, float)) and default != math.inf
    return default if is_number else None


def _words(entry: Field) -> str:
    """What a key is for, with its range and unit."""
    form = entry.form.of if isinstance(entry.form, Uncertain) else entry.form
    if isinstance(form, Truth):
        return form.meaning
    if isinstance(form, Text):
        return form.meaning or form.described()
    return f"{form.meaning} ({form.described()})"


def _way(source: str, output: Path) -> str:
    """How the file names its description: by the way from one to the other where that is short."""
    if source.startswith(PACKAGE):
        return source
    folder = real_path(output).parent
    path = real_path(source)
    return os.path.relpath(path, folder) if path.is_relative_to(folder) else str(path)


def _line(indent: int, key: str, value: Any, words: str) -> str:
    text = f"{' ' * indent}{key}: {_yaml(value)}"
    return f"{text:{_COLUMN}s}  # {words}" if words else text


def _yaml(value: Any) -> str:
    """A plain value on one line."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_yaml(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    if isinstance(value, str):
        plain = re.fullmatch(r"[^\W\d_][\w/.-]*", value) and value.lower() not in _NO_TEXT
        if plain:
            return value
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"'
    if "e" in f"{value:g}":
        return f"{value:.12f}".rstrip("0")
    return f"{value:g}"
