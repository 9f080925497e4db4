"""Robot files: a robot with its drive trains as YAML states it, what a file extends, and what is overridden."""

from __future__ import annotations

import copy
import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.calibration_files.drift import FORMS, Drift
from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.calibration_files.one_joint import JointCalibration
from proprio_ros.calibration_files.pushes import NOISE, RANGES, TERMS, Calibration, check_complete
from proprio_ros.errors import RobotError, one_line
from proprio_ros.inputs.forms import Form, FormError, Number, Numbers, Text, Truth, Whole, shortly
from proprio_ros.inputs.reading import LONGEST_PATH, path_problem, text_of, yaml_of
from proprio_ros.inputs.resources import resource, resource_names
from proprio_ros.kinds import Key
from proprio_ros.quantity import Quantity
from proprio_ros.robot.description import PACKAGE, check_masses, hand_link, is_bag, is_description, read_model
from proprio_ros.robot.drive_train import DriveTrain, FingerTravel, Motor
from proprio_ros.robot.drives import KINDS_OF_DRIVE, Drive, required
from proprio_ros.robot.geometry import FloatArray, frozen
from proprio_ros.robot.tree import STANDARD_GRAVITY, RobotModel
from proprio_ros.robot.wide import Wide, largest_torque


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot with its drive trains, as its YAML file states it.

    Attributes:
        name: Its name.
        model: Tree of links.
        drive_trains: By joint; joints without a motor have none.
        motors: By joint, the same joints.
        delay: From the stamp of a command to torque, less that of a position [s].
        arm_scale: All masses of the model times this.
        stamp_jitter_s: Standard deviation of the stamps.
        onset_jitter_s: Standard deviation of the delay from run to run.
        torque_disturbance: Standard deviation of a torque that is there in one run and not in the next, such as friction
            that is not the same every time [N m].
        start_velocity: Standard deviation of the velocity at which a held joint is when its probe begins [rad/s].
        friction_spread: Standard deviation of friction from one free swing to the next, relative.
        swing_error: What neighbouring samples of a free swing share of the error of its simulation: standard deviation that one
            sample must have so that independent ones weigh as much [rad]. Calibrations and swings themselves show it.
        link_mass_std, link_com_std, link_inertia_std: How far a single link lies off the URDF, beyond `arm_scale`:
            relative mass, each coordinate of its centre of mass [m], relative inertia about it.
        drift: How fast a calibration ages.
        residual_scale: Residuals of a calibration over what encoder and stamps explain.
        calibration: What is known about this very arm, with all correlations; None when the file's numbers stand alone.
        motion_calibration: What motions with an empty hand say about this very arm; it is for motions alone.
        joint_calibration: What motions with known loads say about the only joint of this very robot.
        friction_velocity: Coulomb's law is smoothed over this speed [rad/s].
        payload_frame: Link in which objects are held.
        gravity: In the base frame [m/s^2], shape (3,).
        source: The YAML file.
        settings: The YAML file's content with everything it extends merged in; `with_overrides` builds on it.
    """

    name: str
    model: RobotModel
    drive_trains: dict[str, DriveTrain]
    motors: dict[str, Motor]
    delay: Quantity
    arm_scale: Quantity
    stamp_jitter_s: float
    friction_velocity: float
    payload_frame: str
    gravity: FloatArray
    source: Path
    settings: Mapping[str, Any] = field(default_factory=dict, repr=False)
    onset_jitter_s: float = 0.0
    torque_disturbance: float = 0.0
    start_velocity: float = 0.01
    friction_spread: float = 0.15
    swing_error: float = 0.0
    link_mass_std: float = 0.0
    link_com_std: float = 0.0
    link_inertia_std: float = 0.0
    residual_scale: float = 1.0
    calibration: Calibration | None = None
    motion_calibration: MotionCalibration | None = None
    joint_calibration: JointCalibration | None = None
    drift: Drift = field(default_factory=Drift)

    def is_calibrated(self, joints: Iterable[str] | None = None) -> bool:
        """Whether the numbers come from this very arm, as its file says and as every calibration does.

        Args:
            joints: Whether a calibration has learnt the drive trains of all of these; a file that only says so has learnt none.
        """
        if joints is None:
            return self.calibration is not None or bool(self.settings.get("calibrated"))
        return self.calibration is not None and set(joints) <= set(self.calibration.joints)

    @property
    def friction_rises(self) -> bool:
        """Whether dry friction of any joint is, or may turn out to be, greater at rest."""
        return any(drive.stribeck.value > 0.0 or drive.stribeck.std > 0.0 for drive in self.drive_trains.values())

    def with_overrides(self, overrides: Mapping[str, Any]) -> Robot:
        """The same robot with some settings replaced.

        Args:
            overrides: By dotted key, such as ``joints.joint3.drive_train.coulomb_N_m``. A number replaces a quantity
                and is known exactly; ``{"std": 0.01}`` changes only what it names.

        Raises:
            RobotError: A key is unknown or a value does not fit it.
        """
        settings = _merged(copy.deepcopy(dict(self.settings)), nested_settings(self.model, overrides))
        settings.pop("calibration", None)
        robot = _robot(settings, self.source, self.model)
        if self.calibration is None:
            return robot
        # what the user states stands beside the calibration and replaces its number
        paths = _override_paths(self.model.independent_joints)
        stated = {_unknown_of(paths[key]) for key in overrides}
        return robot.with_calibration(self.calibration.without(stated))

    def with_calibration(self, calibration: Calibration) -> Robot:
        """The same robot with the numbers of its calibration, and their correlations.

        Raises:
            RobotError: The calibration is of a joint that the robot does not drive.
        """
        foreign = [joint for joint in calibration.joints if joint not in self.drive_trains]
        if foreign:
            raise RobotError(
                f"{self.source.name}: the calibration is of {', '.join(foreign)}, but {self.name} drives "
                f"{', '.join(self.drive_trains)}: calibrate this robot"
            )
        known = calibration.quantities
        drives = {}
        for joint, drive in self.drive_trains.items():
            terms: dict[str, Any] = {term: known.get((term, joint), getattr(drive, term)) for term in TERMS}
            drives[joint] = replace(drive, **terms)
        return replace(
            self,
            drive_trains=drives,
            arm_scale=known.get("arm_scale", self.arm_scale),
            delay=known.get("delay", self.delay),
            torque_disturbance=calibration.torque_disturbance,
            start_velocity=calibration.start_velocity,
            friction_spread=calibration.friction_spread or self.friction_spread,
            swing_error=calibration.swing_error,
            residual_scale=calibration.residual_scale,
            stamp_jitter_s=calibration.stamp_jitter_s,
            calibration=calibration,
        )


_REQUIRED = object()


@dataclass(frozen=True)
class _Field:
    """One key of the file: its form, and what holds when it is absent."""

    form: Form
    default: Any = _REQUIRED

    def read(self, value: Any, where: str) -> Any:
        if isinstance(self.form, _Nested):
            return self.form.nested(value, where)
        try:
            return self.form.read(value)
        except FormError as error:
            raise RobotError(f"{where}: {error}") from None


@dataclass(frozen=True)
class _Nested(Form):
    """Keys and values, whose messages say where in the file they stand."""

    nested: Callable[[Any, str], Any] = field(kw_only=True)
    of: Form | None = None

    def described(self) -> str:
        return "keys and values" if self.of is None else f"{self.of.described()}, or its value and std"


def _finger_travel(value: Any, where: str) -> FingerTravel:
    rising = _Field(Numbers(least=2, rising=True, example="a list of two or more numbers"))
    parts = _section(value, {"at_rad": rising, "open_m": rising}, where)
    at_rad, open_m = parts["at_rad"], parts["open_m"]
    if len(at_rad) != len(open_m):
        raise RobotError(f"{where}: {len(at_rad)} angles and {len(open_m)} openings; give one opening for each angle")
    if max(map(abs, open_m)) > 1.0:
        raise RobotError(f"{where}: open_m={list(open_m)} is over 1 m: openings are in m, not mm")
    if max(map(abs, at_rad)) > 10.0:
        raise RobotError(f"{where}: at_rad={list(at_rad)} is over a full turn: angles are in rad, not degrees")
    travel = FingerTravel(at_rad, open_m)
    if travel.ratio_at(np.linspace(at_rad[0], at_rad[-1], 101)).min() <= 0.0:
        raise RobotError(f"{where}: by these openings the finger turns back in between; measure them again")
    return travel


def _drive(value: Any, where: str) -> Drive:
    given = dict(_as_mapping(value, where))
    name = given.pop("kind", None)
    kind = KINDS_OF_DRIVE.get(name) if isinstance(name, str) else None
    if kind is None:
        raise RobotError(f"{where}: kind must be one of {', '.join(KINDS_OF_DRIVE)}, got {shortly(name)}")
    defaults = {key: getattr(kind, key) for key in kind.forms if key not in required(kind)}
    fields = {key: _Field(form, defaults.get(key, _REQUIRED)) for key, form in kind.forms.items()}
    return kind(**_section(given, fields, where))


def _drift(value: Any, where: str) -> Drift:
    return Drift(**_section(value, {key: _Field(form, getattr(Drift(), key)) for key, form in FORMS.items()}, where))


def _quantity(form: Number) -> _Nested:
    """A number that is known exactly, or its value and standard deviation."""

    def quantity(value: Any, where: str) -> Quantity:
        if not isinstance(value, Mapping):
            return Quantity(_Field(form).read(value, where), 0.0)
        std = Number(unit=form.unit, lowest=0.0, highest=form.highest)
        parts = _section(value, {"value": _Field(form), "std": _Field(std, 0.0)}, where)
        return Quantity(parts["value"], parts["std"])

    return _Nested(form.meaning, nested=quantity, of=form)


NOMINAL = "nominal_torque_constant_N_m_per_A"
_MOTOR = {
    "model": _Field(Text("name of the model"), ""),
    "id": _Field(Whole("its number on the bus", "", 0, 252), None),
    NOMINAL: _Field(Number("what published efforts are made with", "N m/A", 0.0, 1e3, open=True)),
    "supply_voltage_V": _Field(Number("0: the supply does not limit the current", "V", 0.0, 1e3), 0.0),
    "back_emf_V_s_per_rad": _Field(Number("voltage that the motor makes per speed", "V s/rad", 0.0, 1e3), 0.0),
    "resistance_ohm": _Field(Number("of the winding", "ohm", 0.0, 1e4), 0.0),
    "current_limit_A": _Field(Number("the driver never commands more", "A", 0.0, 1e3, open=True), math.inf),
    "encoder_resolution_rad": _Field(Number("one count", "rad", 0.0, 1.0), 0.0015),
    "encoder_noise_rad": _Field(Number("standard deviation of a reading, beyond rounding", "rad", 0.0, 1.0), 0.001),
    "encoder_once_per_turn_rad": _Field(
        Number("a magnet off the axis: std of the sine and of the cosine part", "rad", 0.0, 1.0), 0.002
    ),
    "driven_by": _Field(
        _Nested(
            "what drives the motor where no current does, as {kind: duty_cycle, per_count: 0.00113}; null: a current",
            nested=_drive,
        ),
        None,
    ),
}
_DRIVE_TRAIN = {
    # what is left out is not known exactly: friction that was forgotten would bias every mass
    "torque_constant_N_m_per_A": _Field(_quantity(RANGES["torque_constant"]), Wide("nominal", 0.15)),
    "coulomb_N_m": _Field(_quantity(RANGES["coulomb"]), Wide("largest torque", 0.1)),
    "viscous_N_m_s_per_rad": _Field(_quantity(RANGES["viscous"]), Wide("largest torque", 0.05)),
    "load_friction": _Field(_quantity(RANGES["load_friction"]), Quantity(0.0, 0.1)),
    "armature_kg_m2": _Field(_quantity(RANGES["armature"]), Wide("largest torque", 0.01)),
    "zero_rad": _Field(_quantity(RANGES["zero"]), Quantity(0.0, 0.01)),
    "stribeck": _Field(_quantity(RANGES["stribeck"]), Quantity(0.0, 0.3)),
    "stribeck_velocity_rad_s": _Field(_quantity(RANGES["stribeck_velocity"]), Quantity(0.1, 0.05)),
}
_JOINT = {
    "usable_velocity_rad_s": _Field(Number("faster samples are left out", "rad/s", 0.0, 1e3, open=True), math.inf),
    "transmission_m_per_rad": _Field(
        Number("how far a sliding joint moves per rad of the motor", "m/rad", 0.0, 10.0, open=True), None
    ),
    "finger_travel": _Field(
        _Nested("what gauge blocks said of one finger: at_rad and open_m", nested=_finger_travel), None
    ),
}
_ROBOT = {
    "name": _Field(Text("of the robot")),
    "payload_frame": _Field(Text("link in which objects are held")),
    "gravity": _Field(
        Numbers(
            "in the frame of the root link",
            Number(unit="m/s^2", lowest=-100.0, highest=100.0),
            3,
            example="three numbers [x, y, z]",
        ),
        STANDARD_GRAVITY,
    ),
    "arm_scale": _Field(_quantity(Number("all masses of the URDF times this", "", 0.1, 10.0)), Quantity(1.0, 0.1)),
    "delay_s": _Field(_quantity(RANGES["delay"]), Quantity(0.0, 0.01)),
    "stamp_jitter_s": _Field(NOISE["stamp_jitter_s"], 0.001),
    "onset_jitter_s": _Field(Number("standard deviation of the delay from run to run", "s", 0.0, 0.1), 0.001),
    "torque_disturbance_N_m": _Field(NOISE["torque_disturbance_N_m"], Wide("weakest", 0.002)),
    "start_velocity_rad_s": _Field(NOISE["start_velocity_rad_s"], 0.01),
    "friction_spread": _Field(NOISE["friction_spread"], 0.15),
    "link_mass_std": _Field(Number("how far a link lies off its URDF, relative mass", "", 0.0, 1.0), 0.05),
    "link_com_std_m": _Field(Number("each coordinate of a link's centre of mass", "m", 0.0, 0.5), 0.005),
    "link_inertia_std": _Field(Number("relative inertia about it", "", 0.0, 10.0), 0.2),
    # a tenth of a rad/s would take the place of the friction that it smooths
    "friction_velocity_rad_s": _Field(
        Number("Coulomb friction is smoothed over this speed", "rad/s", 0.0, 0.01, open=True), 0.001
    ),
    "drift": _Field(_Nested("how fast a calibration ages: four relative standard deviations", nested=_drift), Drift()),
    "calibrated": _Field(Truth("whether the numbers come from this very arm"), False),
    "model_fingerprint": _Field(Text("of the URDF that a calibration was made with"), None),
    "calibration": _Field(_Nested("what `proprio calibrate` learnt", nested=Calibration.from_settings), None),
    "motion_calibration": _Field(
        _Nested(
            "what `proprio calibrate` learnt from motions of several joints", nested=MotionCalibration.from_settings
        ),
        None,
    ),
    "joint_calibration": _Field(
        _Nested("what `proprio calibrate` learnt from motions of one joint", nested=JointCalibration.from_settings),
        None,
    ),
}
_ELSEWHERE = ("urdf", "joints", "extends")  # read before the others
_CALIBRATIONS = ("calibration", "motion_calibration", "joint_calibration")
_FILE_ONLY = ("model_fingerprint", *_CALIBRATIONS)  # no --set


def _unknown_of(path: tuple[str, ...]) -> Key:
    """Key of the unknown that a setting states, such as ``("coulomb", "joint3")``; that of no unknown where it states none."""
    name = path[-1]
    for unit in ("_N_m_per_A", "_N_m_s_per_rad", "_N_m", "_kg_m2", "_rad_s", "_rad", "_s"):
        name = name.removesuffix(unit)
    return name if len(path) == 1 else (name, path[1])


def _as_mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RobotError(f"{where}: expected keys and values, got {shortly(value)}")
    return value


def _refuse_unknown(given: Mapping[str, Any], fields: Mapping[str, Any], where: str) -> None:
    for key in given:
        if key not in fields:
            close = difflib.get_close_matches(str(key)[:100], fields, n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise RobotError(f"{where}: unknown key {shortly(key)}; {hint}valid keys: {', '.join(fields)}")


def _section(value: Any, fields: Mapping[str, _Field], where: str) -> dict[str, Any]:
    """Read one mapping of the file; unknown and missing keys are refused."""
    given = _as_mapping(value, where)
    _refuse_unknown(given, fields, where)
    result = {}
    for key, entry in fields.items():
        if key in given:
            result[key] = entry.read(given[key], f"{where}: {key}")
        elif entry.default is _REQUIRED:
            raise RobotError(f"{where}: {key} is missing; state it")
        else:
            result[key] = entry.default
    return result


def _override_paths(joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Every key that may be overridden, as text and as the way to it; a joint's name may itself hold dots."""
    paths: list[tuple[str, ...]] = [(key,) for key in _ROBOT if key not in _FILE_ONLY]
    for joint in joints:
        paths += [("joints", joint, "motor", key) for key in _MOTOR]
        paths += [("joints", joint, "drive_train", key) for key in _DRIVE_TRAIN]
        paths += [("joints", joint, key) for key in _JOINT]
    return {".".join(path): path for path in paths}


def nested_settings(model: RobotModel, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted settings as the robot file nests them.

    Raises:
        RobotError: A key is unknown.
    """
    paths = _override_paths(model.independent_joints)
    settings: dict[str, Any] = {}
    for key, value in overrides.items():
        if key not in paths:
            raise RobotError(_unknown_override(key, paths, model.independent_joints))
        if value is None:
            raise RobotError(f"robot setting {key}: expected a value, got null")
        addition: Any = copy.deepcopy(value)
        for part in reversed(paths[key]):
            addition = {part: addition}
        settings = _merged(settings, addition)
    return settings


def _unknown_override(key: str, paths: Mapping[str, tuple[str, ...]], joints: Sequence[str]) -> str:
    close = difflib.get_close_matches(key[:100], paths, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    top = [path for path in paths if not path.startswith("joints.")]
    return (
        f"unknown robot setting {shortly(key)}; {hint}valid: {', '.join(top)}, "
        f"joints.JOINT.motor.({'|'.join(_MOTOR)}), joints.JOINT.drive_train.({'|'.join(_DRIVE_TRAIN)}), "
        f"joints.JOINT.({'|'.join(_JOINT)}), where JOINT is one of {', '.join(joints)}"
    )


def _merged(base: Any, addition: Any) -> Any:
    """Deep merge: mappings key by key, anything else replaces."""
    if not isinstance(base, Mapping) or not isinstance(addition, Mapping):
        return addition
    result = dict(base)
    for key, value in addition.items():
        result[key] = _merged(result[key], value) if key in result else value
    return result


_PATH = _Field(Text(longest=LONGEST_PATH))


def _read_settings(path: Path, below: tuple[Path, ...] = ()) -> dict[str, Any]:
    """One YAML file with all that it extends merged in, and the path of its URDF made absolute."""
    if path in below:
        raise RobotError(f"{path}: files extend each other in a circle: {' -> '.join(p.name for p in (*below, path))}")
    if is_description(str(path)):
        return bare_settings(str(path))
    try:
        text = text_of(path, RobotError)
    except RobotError as error:
        raise RobotError(f"{error}; {_choices()}") from error
    try:
        content = yaml_of(text)
    except ValueError as error:
        raise RobotError(f"{path}: not YAML ({error})") from error
    settings = dict(_as_mapping(content, path.name))
    if settings.get("urdf") is not None:
        settings["urdf"] = _urdf_source(_PATH.read(settings["urdf"], f"{path.name}: urdf"), path)
    if "extends" in settings:
        base = _read_settings(
            _located(_PATH.read(settings.pop("extends"), f"{path.name}: extends"), path.parent), (*below, path)
        )
        for section in _CALIBRATIONS:
            if section in settings:
                base.pop(section, None)  # a newer calibration replaces an older one as a whole
        settings = _merged(base, settings)
    return settings


def _urdf_source(text: str, source: Path) -> str:
    """Where the description lies that a robot file names: an absolute path, or a name of the package robot_descriptions."""
    if text.startswith(PACKAGE):
        return text
    beside = source.parent / text
    problem = path_problem(beside)
    if problem:
        raise RobotError(f"{source.name}: urdf: {one_line(text, 60)} {problem}")
    beside = beside.resolve()
    if beside.is_file() or (beside.is_dir() and is_bag(beside)):
        return str(beside)
    if text.removesuffix(".urdf") in resource_names("urdf"):
        return str(resource("urdf", text))
    raise RobotError(
        f"{source.name}: urdf: there is no {beside}; give a path relative to {source.parent}, or an absolute one"
    )


def _choices() -> str:
    return f"known robots: {', '.join(resource_names('robots'))}; or give the path of a .yaml file"


def _located(name_or_path: str, folder: Path) -> Path:
    """The YAML file that a name or a path (relative to a folder) means."""
    path = folder / name_or_path
    problem = path_problem(path) or ("" if path.name.isprintable() else "holds characters that are not printable")
    if problem:
        raise RobotError(f"robot {one_line(name_or_path, 60)} {problem}; {_choices()}")
    if name_or_path.startswith(PACKAGE):
        return Path(name_or_path)
    if is_description(name_or_path):
        if not path.is_file():
            raise RobotError(f"there is no URDF {path}; {_choices()}")
        return path.resolve()
    if path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise RobotError(f"there is no robot file {path}; {_choices()}")
        return path.resolve()
    if name_or_path not in resource_names("robots"):
        raise RobotError(f"unknown robot {name_or_path!r}; {_choices()}")
    return resource("robots", name_or_path)


def bare_settings(source: str) -> dict[str, Any]:
    """What a description alone says of a robot: its joints that turn have motors of which nothing is known.

    Raises:
        RobotError: there is no such description, or a link that moves has no mass.
    """
    model = read_model(source)
    check_masses(model, Path(source).name)
    return {
        "name": model.name,
        "urdf": source,
        "payload_frame": hand_link(model),
        "joints": {name: {} for name in model.independent_joints if model.joint(name).kind != "prismatic"},
    }


def _stated(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Without keys that are null: those are left out, as a new robot file leaves them."""

    def kept(value: Any, depth: int) -> Any:
        if not isinstance(value, Mapping) or depth == 0:
            return value
        return {key: kept(inner, depth - 1) for key, inner in value.items() if inner is not None}

    joints = settings.get("joints")
    result = {key: value for key, value in settings.items() if value is not None}
    if isinstance(joints, Mapping):
        result["joints"] = {name: {} if joint is None else kept(joint, 2) for name, joint in joints.items()}
    return result


def _part(settings: Any, key: str) -> Mapping[str, Any]:
    part = settings.get(key) if isinstance(settings, Mapping) else None
    return part if isinstance(part, Mapping) else {}


def _check_stated(settings: Mapping[str, Any], source: Path, model: RobotModel) -> None:
    """Name all that is missing at once; a key that is only mistyped comes first.

    Raises:
        RobotError: something is.
    """
    _refuse_unknown(settings, _ROBOT | dict.fromkeys(_ELSEWHERE), source.name)
    for name, joint in _part(settings, "joints").items():
        for section, fields in (("motor", _MOTOR), ("drive_train", _DRIVE_TRAIN)):
            _refuse_unknown(_part(joint, section), fields, f"{source.name}: joints: {name}: {section}")
    missing = [key for key, entry in _ROBOT.items() if entry.default is _REQUIRED and key not in settings]
    without: dict[str, list[str]] = {}
    for name, joint in _part(settings, "joints").items():
        if NOMINAL not in _part(joint, "motor") and "torque_constant_N_m_per_A" not in _part(joint, "drive_train"):
            without.setdefault(f"motor.{NOMINAL}", []).append(name)
        slides = name in model.independent_joints and model.joint(name).kind == "prismatic"
        if slides and isinstance(joint, Mapping) and "transmission_m_per_rad" not in joint:
            without.setdefault("transmission_m_per_rad (how far the joint slides per rad of the motor)", []).append(
                name
            )
    missing += [f"{key} of {_few(joints)}" for key, joints in without.items()]
    if not missing:
        return
    if is_description(str(source)):
        raise RobotError(
            f"{source.name}: states no {'; '.join(missing)}: --set robot.joints.JOINT.{next(iter(without))}=VALUE, or write a file "
            "with `proprio robot new`, or --effort-unit N.m where torque was recorded"
        )
    raise RobotError(f"{source.name}: missing: {'; '.join(missing)}; state each")


def _few(names: Sequence[str], longest: int = 60) -> str:
    """As many names as fit, and how many more there are."""
    count = len(names)
    while count > 1 and len(", ".join(names[:count])) > longest:
        count -= 1
    return ", ".join(names[:count]) + (f" and {len(names) - count} more" if count < len(names) else "")


def _robot(settings: dict[str, Any], source: Path, model: RobotModel | None = None) -> Robot:
    """A robot from merged settings; None: they name no URDF."""
    file = source.name
    settings = _stated(settings)
    if model is not None:
        _check_stated(settings, source, model)
    given = _section(
        {key: value for key, value in settings.items() if key not in ("urdf", "joints")},
        # listed for the message about unknown keys; read below
        _ROBOT | {key: _Field(Text(longest=LONGEST_PATH), None) for key in _ELSEWHERE},
        file,
    )
    if model is None:
        raise RobotError(f"{file}: urdf is missing; state the robot's URDF file")
    expected = given["model_fingerprint"]
    motion = given["motion_calibration"]
    of_joint = given["joint_calibration"]
    if expected is None and any(each is not None for each in (given["calibration"], motion, of_joint)):
        raise RobotError(
            f"{file}: model_fingerprint is missing: which URDF the calibration was made with cannot be checked; write it again "
            "with `proprio calibrate`"
        )
    if expected is not None and expected != model.fingerprint():
        raise RobotError(
            f"{file}: was made with another URDF than {settings.get('urdf')} (model_fingerprint {expected[:12]}.., "
            f"now {model.fingerprint()[:12]}..): calibrate again, or restore the URDF"
        )
    link_names = [link.name for link in model.links]
    if given["payload_frame"] not in link_names:
        raise RobotError(
            f"{file}: payload_frame: {model.name} has no link {given['payload_frame']!r}; "
            f"links: {', '.join(link_names)}"
        )
    drive_trains, motors = {}, {}
    for name, joint_settings in _as_mapping(settings.get("joints", {}), f"{file}: joints").items():
        if name not in model.independent_joints:
            raise RobotError(
                f"{file}: joints: {model.name} has no joint {name!r} that a motor could drive; "
                f"choose from: {', '.join(model.independent_joints)}"
            )
        drive_trains[name], motors[name] = _drive_train(joint_settings, model, name, f"{file}: joints: {name}")
    if not drive_trains:
        raise RobotError(f"{file}: joints is missing or empty; state the drive train of at least one joint")
    disturbance = given["torque_disturbance_N_m"]
    if isinstance(disturbance, Wide):
        # of the weakest joint: what differs from run to run goes with friction
        weakest = min(largest_torque(model, name, drive.transmission) for name, drive in drive_trains.items())
        disturbance = disturbance.at(0.0, weakest).std
    calibration = given["calibration"]
    if motion is not None:
        motion = replace(motion, fingerprint=expected)
        foreign = [joint for joint in motion.joints if joint not in drive_trains]
        if foreign:
            raise RobotError(
                f"{file}: motion_calibration: is of {', '.join(foreign)}, but {given['name']} drives {', '.join(drive_trains)}: "
                "calibrate this robot"
            )
    if of_joint is not None and [of_joint.joint] != list(drive_trains):
        raise RobotError(
            f"{file}: joint_calibration: is of {of_joint.joint}, but {given['name']} drives {', '.join(drive_trains)}: calibrate "
            "this robot"
        )
    robot = Robot(
        name=given["name"],
        model=model,
        drive_trains=drive_trains,
        motors=motors,
        delay=given["delay_s"],
        arm_scale=given["arm_scale"],
        stamp_jitter_s=given["stamp_jitter_s"],
        onset_jitter_s=given["onset_jitter_s"],
        torque_disturbance=disturbance,
        start_velocity=given["start_velocity_rad_s"],
        friction_spread=given["friction_spread"],
        link_mass_std=given["link_mass_std"],
        link_com_std=given["link_com_std_m"],
        link_inertia_std=given["link_inertia_std"],
        friction_velocity=given["friction_velocity_rad_s"],
        payload_frame=given["payload_frame"],
        gravity=frozen(given["gravity"]),
        source=source,
        settings=settings,
        motion_calibration=motion,
        joint_calibration=of_joint,
        drift=given["drift"],
    )
    if calibration is None:
        return robot
    calibrated = robot.with_calibration(calibration)
    spreads = {"link_mass": robot.link_mass_std, "link_inertia": robot.link_inertia_std}
    spreads |= {f"link_com_{axis}": robot.link_com_std for axis in "xyz"}
    check_complete(calibration, link_names, drive_trains, spreads, f"{file}: calibration")
    return calibrated


def _drive_train(settings: Any, model: RobotModel, name: str, where: str) -> tuple[DriveTrain, Motor]:
    joint = model.joint(name)
    fields = {
        "motor": _Field(_Nested(nested=lambda value, at: _section(value, _MOTOR, at))),
        "drive_train": _Field(_Nested(nested=lambda value, at: _section(value, _DRIVE_TRAIN, at)), {}),
    }
    settings = _as_mapping(settings, where)
    stated = _part(settings, "drive_train").get("torque_constant_N_m_per_A")
    if stated is not None and NOMINAL not in _part(settings, "motor"):
        # who states the torque constant alone publishes no efforts that another one was made with
        value = stated.get("value") if isinstance(stated, Mapping) else stated
        settings = _merged(settings, {"motor": {NOMINAL: value}})
    parts = _section(settings, fields | _JOINT, where)
    motor = parts["motor"]
    largest = largest_torque(model, name, parts["transmission_m_per_rad"] or 1.0)
    drive = {
        key: value.at(motor[NOMINAL], largest) if isinstance(value, Wide) else value
        for key, value in (parts["drive_train"] or _section({}, _DRIVE_TRAIN, where)).items()
    }
    transmission = parts["transmission_m_per_rad"]
    if joint.kind != "prismatic" and transmission is not None:
        raise RobotError(
            f"{where}: transmission_m_per_rad is for a prismatic joint, but this one is {joint.kind}; remove it"
        )
    travel = parts["finger_travel"]
    if travel is not None and (transmission is None or not 0.5 < travel.mean_ratio / transmission < 2.0):
        nominal = "not there" if transmission is None else f"{1e3 * transmission:g} mm per rad"
        raise RobotError(
            f"{where}: finger_travel opens by {1e3 * travel.mean_ratio:.3g} mm per rad of the motor, transmission_m_per_rad is "
            f"{nominal}: one of them is wrong, or not of one finger"
        )
    if motor["supply_voltage_V"] > 0.0 and motor["resistance_ohm"] == 0.0:
        raise RobotError(
            f"{where}: motor: supply_voltage_V needs resistance_ohm too; state it, or a voltage of 0 for no limit"
        )
    if motor["driven_by"] is not None:
        if joint.kind == "prismatic":
            raise RobotError(f"{where}: motor: driven_by is for a joint that turns, but this one slides; remove it")
        if motor["resistance_ohm"] == 0.0:
            raise RobotError(
                f"{where}: motor: driven_by {motor['driven_by'].kind} needs resistance_ohm too, to make a current of a voltage; "
                "state it"
            )
    if motor["encoder_resolution_rad"] == 0.0 and motor["encoder_noise_rad"] == 0.0:
        raise RobotError(
            f"{where}: motor: encoder_resolution_rad and encoder_noise_rad are both 0; no encoder is perfect"
        )
    return (
        DriveTrain(
            torque_constant=drive["torque_constant_N_m_per_A"],
            coulomb=drive["coulomb_N_m"],
            viscous=drive["viscous_N_m_s_per_rad"],
            load_friction=drive["load_friction"],
            armature=drive["armature_kg_m2"],
            zero=drive["zero_rad"],
            stribeck=drive["stribeck"],
            stribeck_velocity=drive["stribeck_velocity_rad_s"],
            nominal_torque_constant=motor["nominal_torque_constant_N_m_per_A"],
            supply_voltage_V=motor["supply_voltage_V"],
            back_emf_V_s_per_rad=motor["back_emf_V_s_per_rad"],
            resistance_ohm=motor["resistance_ohm"],
            usable_velocity=parts["usable_velocity_rad_s"],
            encoder_resolution=motor["encoder_resolution_rad"],
            encoder_noise=motor["encoder_noise_rad"],
            encoder_once_per_turn=motor["encoder_once_per_turn_rad"],
            transmission=1.0 if transmission is None else transmission,
            finger_travel=travel,
            driven_by=motor["driven_by"],
        ),
        Motor(model=motor["model"], id=motor["id"], current_limit_A=motor["current_limit_A"]),
    )


def load_robot(
    name_or_path: str | Path,
    overrides: Mapping[str, Any] | None = None,
    of_bag: Callable[[Path], str] | None = None,
) -> Robot:
    """Read a robot.

    Args:
        name_or_path: Name of a robot that comes with the package (a file of ``config/robots`` without its suffix), or
            the path of a YAML file, whose keys are explained in ``config/robots/open_manipulator_x.yaml``; or a description
            alone (a URDF file, or ``robot_descriptions:NAME``), whose torque constants the overrides must state.
        overrides: As for `Robot.with_overrides`; they may state what a file leaves open.
        of_bag: As for `read_model`.

    Raises:
        RobotError: There is no such robot, or its file or its URDF is wrong.
    """
    path = _located(str(name_or_path), Path())
    settings = _read_settings(path)
    model = None if settings.get("urdf") is None else read_model(settings["urdf"], of_bag)
    if not overrides or model is None or settings.get("calibration") is not None:
        robot = _robot(settings, path, model)
        return robot.with_overrides(overrides) if overrides else robot
    return _robot(_merged(settings, nested_settings(model, overrides)), path, model)


def with_recorded_torque(name_or_path: str | Path, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Overrides for a description alone whose motors' torque was recorded, so that no torque constant is needed.

    Torque then counts as current of 1 N m/A, known to a tenth: boards that estimate their motors' torque were seen to err by that.

    Args:
        name_or_path: As for `load_robot`.
        overrides: What the user states beside that.
    """
    path = _located(str(name_or_path), Path())
    if not is_description(str(path)):
        return dict(overrides)
    unit: dict[str, Any] = {}
    for name in bare_settings(str(path))["joints"]:
        nominal, constant = f"joints.{name}.motor.{NOMINAL}", f"joints.{name}.drive_train.torque_constant_N_m_per_A"
        if nominal not in overrides and constant not in overrides:
            unit |= {nominal: 1.0, constant: {"value": 1.0, "std": 0.1}}
    return unit | dict(overrides)
