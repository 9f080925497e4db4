"""The keys of a robot file: what each may be, what holds where it is left out, and how dotted settings name them."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from proprio_ros.calibration_files import drift
from proprio_ros.calibration_files.drift import AgeingRates
from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.calibration_files.one_joint import JointCalibration
from proprio_ros.calibration_files.pushes import NOISE, RANGES, Calibration
from proprio_ros.errors import RobotError
from proprio_ros.inputs.forms import (
    Field,
    Form,
    FormError,
    Number,
    Numbers,
    Part,
    Text,
    Truth,
    Whole,
    did_you_mean,
    mapping,
    section,
    shortly,
)
from proprio_ros.inputs.reading import LONGEST_PATH
from proprio_ros.inputs.signs import EFFORT_SIGN, Signs
from proprio_ros.kinds import Key
from proprio_ros.quantity import Quantity
from proprio_ros.robot.default_priors import DefaultPrior
from proprio_ros.robot.drive_train import FingerTravel
from proprio_ros.robot.drives import KINDS_OF_DRIVE, Drive, required
from proprio_ros.robot.tree import STANDARD_GRAVITY


def _finger_travel(value: Any) -> FingerTravel:
    rising = Field(Numbers(least=2, rising=True, example="a list of two or more numbers"))
    at_rad, open_m = section(value, {"at_rad": rising, "open_m": rising}).values()
    if len(at_rad) != len(open_m):
        raise FormError(
            f"{len(at_rad)} angles and {len(open_m)} openings; give one opening for each angle"
        )
    if max(map(abs, open_m)) > 1.0:
        raise FormError(f"open_m={list(open_m)} is over 1 m: openings are in m, not mm")
    if max(map(abs, at_rad)) > 10.0:
        raise FormError(
            f"at_rad={list(at_rad)} is over a full turn: angles are in rad, not degrees"
        )
    travel = FingerTravel(at_rad, open_m)
    if travel.ratio_at(np.linspace(at_rad[0], at_rad[-1], 101)).min() <= 0.0:
        raise FormError("by these openings the finger turns back in between; measure them again")
    return travel


def _drive(value: Any) -> Drive:
    given = dict(mapping(value))
    name = given.pop("kind", None)
    kind = KINDS_OF_DRIVE.get(name) if isinstance(name, str) else None
    if kind is None:
        raise FormError(f"kind must be one of {', '.join(KINDS_OF_DRIVE)}, got {shortly(name)}")
    needed = required(kind)
    return kind(
        **section(
            given, {key: Field(form) if key in needed else form for key, form in kind.forms.items()}
        )
    )


def _drift(value: Any) -> AgeingRates:
    return AgeingRates(**section(value, drift.FORMS))


def _held(value: Any) -> dict[str, float]:
    return section(
        value,
        dict.fromkeys(
            mapping(value),
            Field(Number(unit="rad or m", lowest=-100.0, highest=100.0)),
        ),
    )


@dataclass(frozen=True)
class Uncertain(Form):
    """A number that is known exactly, or its value and standard deviation."""

    of: Number = field(kw_only=True)

    def read(self, value: Any) -> Quantity:
        if not isinstance(value, Mapping):
            return Quantity(self.of.read(value), 0.0)
        std = Number(
            unit=self.of.unit,
            lowest=0.0,
            highest=self.of.highest,
        )
        return Quantity(**section(value, {"value": Field(self.of), "std": Field(std, 0.0)}))

    def described(self) -> str:
        return f"{self.of.described()}, or its value and std"


def _quantity(form: Number) -> Uncertain:
    return Uncertain(form.meaning, of=form)


NOMINAL = "nominal_torque_constant_N_m_per_A"
MOTOR: dict[str, Field] = {
    "model": Field(Text("name of the model"), ""),
    "id": Field(Whole("its number on the bus", "", 0, 252), None),
    NOMINAL: Field(Number("what published efforts are made with", "N m/A", 0.0, 1e3, open=True)),
    "supply_voltage_V": Field(
        Number("0: the supply does not limit the current", "V", 0.0, 1e3), 0.0
    ),
    "back_emf_V_s_per_rad": Field(
        Number("voltage that the motor makes per speed", "V s/rad", 0.0, 1e3), 0.0
    ),
    "resistance_ohm": Field(Number("of the winding", "ohm", 0.0, 1e4), 0.0),
    "current_limit_A": Field(
        Number("the driver never commands more", "A", 0.0, 1e3, open=True), math.inf
    ),
    "encoder_resolution_rad": Field(Number("one count", "rad", 0.0, 1.0), 0.0015),
    "encoder_noise_rad": Field(
        Number("standard deviation of a reading, beyond rounding", "rad", 0.0, 1.0), 0.001
    ),
    "encoder_once_per_turn_rad": Field(
        Number("a magnet off the axis: std of the sine and of the cosine part", "rad", 0.0, 1.0),
        0.002,
    ),
    "driven_by": Field(
        Part(
            "what drives the motor where no current does, as {kind: duty_cycle, per_count: 0.00113}; null: a current",
            by=_drive,
        ),
        None,
    ),
}
DRIVE_TRAIN: dict[str, Field] = {
    # what is left out is not known exactly: friction that was forgotten would bias every mass
    "torque_constant_N_m_per_A": Field(
        _quantity(RANGES["torque_constant"]), DefaultPrior("nominal", 0.15)
    ),
    "coulomb_N_m": Field(_quantity(RANGES["coulomb"]), DefaultPrior("largest torque", 0.1)),
    "viscous_N_m_s_per_rad": Field(
        _quantity(RANGES["viscous"]), DefaultPrior("largest torque", 0.05)
    ),
    "load_friction": Field(_quantity(RANGES["load_friction"]), Quantity(0.0, 0.1)),
    "armature_kg_m2": Field(_quantity(RANGES["armature"]), DefaultPrior("largest torque", 0.01)),
    "zero_rad": Field(_quantity(RANGES["zero"]), Quantity(0.0, 0.01)),
    "stribeck": Field(_quantity(RANGES["stribeck"]), Quantity(0.0, 0.3)),
    "stribeck_velocity_rad_s": Field(_quantity(RANGES["stribeck_velocity"]), Quantity(0.1, 0.05)),
}
JOINT: dict[str, Field] = {
    "usable_velocity_rad_s": Field(
        Number("faster samples are left out", "rad/s", 0.0, 1e3, open=True), math.inf
    ),
    "transmission_m_per_rad": Field(
        Number("how far a sliding joint moves per rad of the motor", "m/rad", 0.0, 10.0, open=True),
        None,
    ),
    "finger_travel": Field(
        Part("what gauge blocks measured of one finger: at_rad and open_m", by=_finger_travel), None
    ),
}
LEAST_GRAVITY, MOST_GRAVITY = 1.5, 26.0  # of the moon and of Jupiter, rounded [m/s^2]


class _Gravity(Numbers):
    """A direction as long as gravity is somewhere."""

    def read(self, value: Any) -> tuple[float, ...]:
        pull = super().read(value)
        length = math.hypot(*pull)
        if not LEAST_GRAVITY <= length <= MOST_GRAVITY:
            raise FormError(
                f"{shortly(list(pull))} m/s^2 is {length:g} long, and nothing is weighed by that: state which way is down in the "
                "frame of the root link, such as [0, 0, -9.81] where z is up"
            )
        return pull


ROBOT: dict[str, Field] = {
    "name": Field(Text("of the robot")),
    "payload_frame": Field(Text("link in which objects are held")),
    "tip": Field(
        Text("last link of the arm, where a robot has joints beside it: those are only read"), None
    ),
    "gravity": Field(
        _Gravity(
            "in the frame of the root link",
            Number(unit="m/s^2", lowest=-100.0, highest=100.0),
            3,
            example="three numbers [x, y, z]",
        ),
        STANDARD_GRAVITY,
    ),
    "effort_sign": Field(EFFORT_SIGN, Signs()),
    "arm_scale": Field(
        _quantity(Number("all masses of the URDF times this", "", 0.1, 10.0)), Quantity(1.0, 0.1)
    ),
    "delay_s": Field(_quantity(RANGES["delay"]), Quantity(0.0, 0.01)),
    "stamp_jitter_s": Field(NOISE["stamp_jitter_s"], 0.001),
    "onset_jitter_s": Field(NOISE["onset_jitter_s"], 0.001),
    "torque_disturbance_N_m": Field(
        NOISE["torque_disturbance_N_m"], DefaultPrior("weakest", 0.002)
    ),
    "start_velocity_rad_s": Field(NOISE["start_velocity_rad_s"], 0.01),
    "friction_spread": Field(NOISE["friction_spread"], 0.15),
    "zero_repeat_rad": Field(
        Number("a joint's zero from one recording of an arm to the next, std", "rad", 0.0, 0.5),
        0.001,
    ),
    "link_mass_std": Field(
        Number("how far a link lies off its URDF, relative mass", "", 0.0, 1.0), 0.05
    ),
    "link_com_std_m": Field(
        Number("each coordinate of a link's centre of mass", "m", 0.0, 0.5), 0.005
    ),
    "link_inertia_std": Field(Number("relative inertia about it", "", 0.0, 10.0), 0.2),
    # a tenth of a rad/s would take the place of the friction that it smooths
    "friction_velocity_rad_s": Field(
        Number("Coulomb friction is smoothed over this speed", "rad/s", 0.0, 0.01, open=True), 0.001
    ),
    "held": Field(
        Part("where joints stand that recordings lack, by name, in rad or m", by=_held), {}
    ),
    "drift": Field(
        Part("how fast a calibration ages: four relative standard deviations", by=_drift),
        AgeingRates(),
    ),
    "calibrated": Field(Truth("whether the numbers come from this very arm"), False),
    "model_fingerprint": Field(Text("of the URDF that a calibration was made with"), None),
    "calibration": Field(
        Part("what `proprio calibrate` identified", by=Calibration.from_settings), None
    ),
    "motion_calibration": Field(
        Part(
            "what `proprio calibrate` identified from motions of several joints",
            by=MotionCalibration.from_settings,
        ),
        None,
    ),
    "joint_calibration": Field(
        Part(
            "what `proprio calibrate` identified from motions of one joint",
            by=JointCalibration.from_settings,
        ),
        None,
    ),
}
ELSEWHERE = dict.fromkeys(
    ("urdf", "joints", "extends"),
    Field(Text(longest=LONGEST_PATH), None),
)
"""Keys that are read before the others."""
CALIBRATIONS = ("calibration", "motion_calibration", "joint_calibration")
_FILE_ONLY = ("model_fingerprint", *CALIBRATIONS)  # no --set


def without_unit(key: str) -> str:
    """What a key states, such as ``coulomb`` of ``coulomb_N_m``."""
    return re.sub("_(N_m_per_A|N_m_s_per_rad|N_m|kg_m2|rad_s|rad|s)$", "", key)


def unknown_of(path: tuple[str, ...]) -> Key:
    """Key of the unknown that a setting states, such as ``("coulomb", "joint3")``; that of no unknown where it states none."""
    name = without_unit(path[-1])
    return name if len(path) == 1 else (name, path[1])


def override_paths(joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Every key that may be overridden, as text and as the way to it; a joint's name may itself hold dots."""
    paths: list[tuple[str, ...]] = [(key,) for key in ROBOT if key not in _FILE_ONLY]
    of_joint = [
        *(("motor", key) for key in MOTOR),
        *(("drive_train", key) for key in DRIVE_TRAIN),
        *((key,) for key in JOINT),
    ]
    paths += [("joints", joint, *path) for joint in joints for path in of_joint]
    return {".".join(path): path for path in paths}


def nested_settings(
    joints: Sequence[str],
    overrides: Mapping[str, Any],
) -> dict[str, Any]:
    """Dotted settings as the robot file nests them. Raises `RobotError`: A key is unknown."""
    paths = override_paths(joints)
    settings: dict[str, Any] = {}
    for key, value in overrides.items():
        if key not in paths:
            top = [path for path in paths if not path.startswith("joints.")]
            raise RobotError(
                f"unknown robot setting {shortly(key)}; {did_you_mean(key, paths)}valid: {', '.join(top)}, "
                f"joints.JOINT.motor.({'|'.join(MOTOR)}), joints.JOINT.drive_train.({'|'.join(DRIVE_TRAIN)}), "
                f"joints.JOINT.({'|'.join(JOINT)}), where JOINT is one of {', '.join(joints)}"
            )
        if value is None:
            raise RobotError(f"robot setting {key}: expected a value, got null")
        addition: Any = copy.deepcopy(value)
        for part in reversed(paths[key]):
            addition = {part: addition}
        settings = merged(settings, addition)
    return settings


def merged(base: Any, addition: Any) -> Any:
    """Deep merge: mappings key by key, anything else replaces."""
    if not isinstance(base, Mapping) or not isinstance(addition, Mapping):
        return addition
    result = dict(base)
    for key, value in addition.items():
        result[key] = merged(result[key], value) if key in result else value
    return result
