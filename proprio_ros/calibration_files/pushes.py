"""What a calibration knows about one arm: values with their full covariance, and where they come from.

It is the section ``calibration`` of a robot file that ``extends`` the robot it was made with:

    extends: open_manipulator_x
    calibrated: true
    model_fingerprint: 5ab1..            # of the URDF; another URDF is refused
    calibration:
      runs: [{name: .., joint: joint3, current_A: -0.3, load_kg: 0.0, samples: 24}, ..]
      residual_scale: 1.02               # residuals over what encoder and stamps explain
      stamp_jitter_s: 0.0003             # standard deviation of the stamps, as the runs show it
      torque_disturbance_N_m: 0.0004     # what differs from run to run
      onset_jitter_s: 0.001              # standard deviation of the delay from run to run
      motors:                            # whose arm it is, where the recordings say so; without this section nothing is compared
        joint3: {model: 1020, id: 13, firmware: 46, homing_offset: 0, drive_mode: 0, moving_threshold: 10}
      made: {time_s: 1760000009.8, temperature_C: {joint3: 34.0}}   # when, by the clock of the recordings; see `drift`
      delivered:                         # measured over commanded current, where the recordings say so
        joint3: {value: 0.985, std: 0.002}
      start_velocity_rad_s: 0.003        # how still the joint is when its excitation begins; all numbers have ranges, see `RANGES`
      own_terms: |                       # of free responses, a line for each run, see `own_terms`
        0.14 0.015 ..
      torque_spread:                     # how well torque_disturbance_N_m is known, see `torque_spread`
        {stated_N_m: 0.001, weights: 0.01 0.012 ..}
      unknowns:
        torque_constant[joint3]: {value: 1.74, std: 0.02, unit: N m/A}
      correlation: |                     # lower triangle, a line per unknown in the order above
        1
      digest: 3f0c..                     # of all of the above, as it was written; without this line nothing is compared
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from proprio_ros.calibration_files.motors import MotorIdentity, Motors
from proprio_ros.calibration_files.own_terms import OwnTerms, own_terms_of, own_terms_text
from proprio_ros.calibration_files.section import (
    check_section,
    correlation_of,
    exactly,
    part_of,
    read_under,
    runs_of,
    short,
    triangle_of,
)
from proprio_ros.calibration_files.torque_spread import (
    TorqueSpread,
    torque_spread_of,
    torque_spread_settings,
)
from proprio_ros.errors import one_line
from proprio_ros.inputs.forms import Form, FormError, Number, Text, Whole, shortly, under
from proprio_ros.kinds import KINDS, Key, key_of, name_of
from proprio_ros.quantity import Quantity
from proprio_ros.records import FloatArray

RANGES: dict[str, Number] = {
    "torque_constant": Number("at the output shaft", "N m/A", 0.0, 1e3, open=True),
    "coulomb": Number("dry friction", "N m", 0.0, 1e3),
    "viscous": Number("viscous friction", "N m s/rad", 0.0, 1e3),
    "load_friction": Number("part of the motor's torque that the gears lose", "", 0.0, 1.0),
    "armature": Number("rotor and gears, seen at the output", "kg m^2", 0.0, 100.0),
    "stribeck": Number("by how much of itself dry friction is greater at rest", "", 0.0, 10.0),
    "stribeck_velocity": Number(
        "speed at which 1/e of that is left", "rad/s", 0.0, 100.0, open=True
    ),
    "zero": Number("true position minus reading", "rad", -7.0, 7.0),
    "ripple_cos": Number("encoder error", "rad", -0.2, 0.2),
    "ripple_sin": Number("encoder error", "rad", -0.2, 0.2),
    "link_mass": Number("beyond the URDF's, relative", "", -0.9, 5.0),
    "link_com_x": Number("beyond the URDF's", "m", -0.5, 0.5),
    "link_com_y": Number("beyond the URDF's", "m", -0.5, 0.5),
    "link_com_z": Number("beyond the URDF's", "m", -0.5, 0.5),
    "link_inertia": Number("beyond the URDF's, relative", "", -0.9, 10.0),
    "arm_scale": Number("all masses of the URDF times this", "", 0.5, 2.0),
    "delay": Number(
        "from the command's stamp to torque, less that of the position", "s", -0.1, 0.1
    ),
}
"""What a calibration may say of each kind of unknown; further off is no arm, but a slip of the hand or of a unit."""
NOISE: dict[str, Number] = {
    "residual_scale": Number("residuals over what encoder and stamps explain", "", 0.01, 10.0),
    "stamp_jitter_s": Number("standard deviation of the stamps", "s", 0.0, 0.1),
    "torque_disturbance_N_m": Number("torque that differs from run to run", "N m", 0.0, 100.0),
    "onset_jitter_s": Number("standard deviation of the delay from run to run", "s", 0.0, 0.1),
    "start_velocity_rad_s": Number(
        "of a locked joint when its excitation begins", "rad/s", 0.0, 10.0, open=True
    ),
    "friction_spread": Number(
        "friction that differs from one free response to the next, relative", "", 0.0, 1.0
    ),
    "swing_error_rad": Number(
        "simulated less measured free response, in which samples share an error", "rad", 0.0, 10.0
    ),
}
# of each where a file does not say it
_NO_NOISE = (1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0)
_RUN: dict[str, Form] = {
    "name": Text(longest=9000),
    "joint": Text(),
    "current_A": Number(unit="A", lowest=-1e3, highest=1e3),
    "load_kg": Number(unit="kg", lowest=0.0, highest=1e3),
    "samples": Whole(lowest=0, highest=10**9),
}
_DELIVERED: dict[str, Form] = {
    "value": Number(lowest=0.0, highest=10.0, open=True),
    "std": Number(lowest=0.0, highest=10.0),
}
_TIME = Number("since 1970", "s", lowest=0.0, highest=1e11)
_TEMPERATURE = Number("of a motor", "deg C", lowest=-273.0, highest=1e3)
TERMS = (
    "torque_constant", "coulomb", "viscous", "load_friction", "armature", "zero", "stribeck", "stribeck_velocity",
)  # fmt: skip
"""Kinds of unknowns that a drive train has."""
TERMS_OF_A_SWING = 2  # dry and viscous friction, see `own_terms`
_LEAST_STD = 1e-10  # of any unknown, in its unit: below it, a covariance loses its digits
_FARTHEST = 5.0  # times the nominal torque constant, or that part of it
_MOST_STDS = 10.0
# of a correlation matrix: below it, rounding has made it no covariance
_SMALLEST_EIGENVALUE = 1e-12


@dataclass(frozen=True)
class Moment:
    """When something was recorded, and how warm the motors were."""

    time_s: float  # mean over its runs, by the clock of the recording [s]
    # of the motors that say it, by joint
    temperature_C: Mapping[str, float] = field(default_factory=dict)

    def as_settings(self) -> dict[str, Any]:
        """Plain numbers."""
        warmth = {joint: short(t, 4) for joint, t in self.temperature_C.items()}
        return {
            "time_s": round(self.time_s, 1),
            **({"temperature_C": warmth} if warmth else {}),
        }

    @classmethod
    def from_settings(cls, given: Any) -> Moment:
        """The reverse of ``as_settings``; raises `FormError`."""
        if not isinstance(given, Mapping) or not {"time_s"} <= set(given) <= {
            "time_s",
            "temperature_C",
        }:
            raise FormError(f"expected time_s and perhaps temperature_C, got {shortly(given)}")
        time_s = read_under(given, "time_s", _TIME)
        warmth = {}
        for joint, value in (
            part_of(given, "temperature_C", Mapping) if "temperature_C" in given else {}
        ).items():
            with under("temperature_C", shortly(joint)):
                warmth[str(joint)] = _TEMPERATURE.read(value)
        return cls(time_s, warmth)


@dataclass(frozen=True, eq=False)
class Calibration:
    """The robot as its own recordings show it."""

    section: ClassVar[str] = "calibration"
    made_of: ClassVar[str] = "runs"
    beside: ClassVar[Mapping[str, bool]] = {"calibrated": True}
    """Key of its section in a robot file; what it was made of, in a word; and what else stands in the file then."""

    keys: tuple[Key, ...]  # of the unknowns, such as ``("coulomb", "joint3")``, length C
    values: FloatArray  # shape (C,)
    covariance: FloatArray  # shape (C, C), positive definite
    residual_scale: float = 1.0  # residuals over what encoder and stamps explain
    stamp_jitter_s: float = 0.0  # standard deviation of the stamps
    # standard deviation of a torque that differs from run to run [N m]
    torque_disturbance: float = 0.0
    # standard deviation of the velocity at which excitations begin [rad/s]
    start_velocity: float = 0.01
    # one mapping per run used: name, joint, current_A, load_kg, samples
    runs: tuple[Mapping[str, Any], ...] = ()
    # of the arm, by joint, where its recordings say so
    motors: Motors = field(default_factory=dict)
    # relative standard deviation of friction from one free response to the next; 0: it was made of none
    friction_spread: float = 0.0
    swing_error: float = 0.0  # error of simulated free responses, see `Robot.swing_error` [rad]
    # standard deviation of the delay from run to run; 0: as the robot file has it
    onset_jitter_s: float = 0.0
    # when it was made, or since when it counts (see `drift`); None where the recordings do not say it
    made: Moment | None = None
    # current by measured effort over that commanded in its runs, by joint where both were recorded
    delivered: Mapping[str, Quantity] = field(default_factory=dict)
    # of each free response, dry and viscous friction by itself; none in older files, and of pushes
    own_terms: tuple[OwnTerms, ...] = ()
    # how well `torque_disturbance`, its median, is known; None in older files, and of free responses
    torque_spread: TorqueSpread | None = None

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns, such as ``coulomb[joint3]``."""
        return tuple(name_of(key) for key in self.keys)

    @functools.cached_property
    def quantities(self) -> dict[Key, Quantity]:
        """Each unknown by key, with its own standard deviation."""
        stds = np.sqrt(np.diag(self.covariance))
        return {
            key: Quantity(float(v), float(s))
            for key, v, s in zip(self.keys, self.values, stds, strict=True)
        }

    @functools.cached_property
    def correlation(self) -> FloatArray:
        """Shape (C, C)."""
        stds = np.sqrt(np.diag(self.covariance))
        return self.covariance / stds[:, None] / stds[None, :]

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints whose drive trains were calibrated; a free response needs no torque constant, which may be stated exactly."""
        swung = {run["joint"] for run in self.runs} if self.swing_error > 0.0 else set()
        known = (
            key
            for key in self.keys
            if key[0] == "torque_constant" or (key[0] in TERMS and key[1] in swung)
        )
        return tuple(dict.fromkeys(str(key[1]) for key in known))

    @property
    def driven(self) -> tuple[str, ...]:
        """Joints of which it knows what a current does: a free response tells nothing of that."""
        return () if self.swing_error > 0.0 else self.joints

    def without(self, keys: set[Key]) -> Calibration:
        """The same with some unknowns marginalised out; keys that it does not hold are ignored."""
        keep = [row for row, key in enumerate(self.keys) if key not in keys]
        kept = tuple(self.keys[row] for row in keep)
        covariance = self.covariance[np.ix_(keep, keep)]
        return replace(
            self,
            keys=kept,
            values=self.values[keep],
            covariance=covariance,
        )

    def given(self, keys: set[Key]) -> Calibration:
        """What is known of the others where some unknowns are exactly as here; keys that it does not hold are ignored."""
        fixed = [row for row, key in enumerate(self.keys) if key in keys]
        others = [row for row, key in enumerate(self.keys) if key not in keys]
        across = self.covariance[np.ix_(others, fixed)]
        follows = np.linalg.solve(
            self.covariance[np.ix_(fixed, fixed)],
            across.T,
        )
        covariance = self.covariance.copy()
        covariance[np.ix_(others, others)] -= across @ follows
        return replace(self, covariance=covariance).without(keys)

    def with_other_zeros(self, std_rad: float) -> Calibration:
        """What it says of another recording, in which each joint's zero is off by as much, independently [rad]."""
        of_zeros = np.array([key[0] == "zero" for key in self.keys])
        grown = self.covariance + np.diag(std_rad**2 * of_zeros)
        return replace(self, covariance=grown)

    def as_settings(self) -> dict[str, Any]:
        """Plain numbers for the file; the correlations as text, which reads a hundred times faster than as YAML numbers."""
        settings: dict[str, Any] = {
            "runs": [dict(run) for run in self.runs],
            "residual_scale": short(self.residual_scale),
            "stamp_jitter_s": short(self.stamp_jitter_s),
            "torque_disturbance_N_m": short(self.torque_disturbance),
            "start_velocity_rad_s": short(self.start_velocity),
        }
        if self.onset_jitter_s > 0.0:
            settings["onset_jitter_s"] = short(self.onset_jitter_s)
        if self.made is not None:
            settings["made"] = self.made.as_settings()
        if self.motors:
            settings["motors"] = {
                joint: motor.as_settings() for joint, motor in self.motors.items()
            }
        if self.swing_error > 0.0:
            settings["friction_spread"] = short(self.friction_spread)
            settings["swing_error_rad"] = short(self.swing_error)
        if self.delivered:
            settings["delivered"] = {
                joint: {"value": short(share.value), "std": short(share.std)}
                for joint, share in self.delivered.items()
            }
        settings |= own_terms_text(self.own_terms)
        settings |= torque_spread_settings(self.torque_spread)
        unknowns = {}
        for key, known in self.quantities.items():
            unknowns[name_of(key)] = {
                "value": short(known.value, 15),
                "std": short(known.std, 15),
                "unit": _unit(key),
            }
        return {**settings, "unknowns": unknowns, "correlation": triangle_of(self.correlation)}

    @classmethod
    def from_settings(cls, section: Any) -> Calibration:
        """Read the section of a robot file; raises `FormError`."""
        check_section(section)
        runs = runs_of(section, _RUN)
        motors = {}
        given_motors = part_of(section, "motors", Mapping) if "motors" in section else {}
        for joint, entry in given_motors.items():
            with under("motors", one_line(str(joint), 80)):
                motors[str(joint)] = MotorIdentity.from_settings(entry)
        known: dict[Key, tuple[float, float]] = {}
        for name, entry in part_of(section, "unknowns", Mapping).items():
            with under("unknowns", one_line(str(name), 80)):
                key, value, std = _read_unknown(name, entry)
            known[key] = (value, std)
        keys = tuple(known)
        values = np.array([value for value, _ in known.values()])
        stds = np.array([std for _, std in known.values()])
        correlation = correlation_of(section, len(keys), _SMALLEST_EIGENVALUE)
        made = None
        if "made" in section:
            with under("made"):
                made = Moment.from_settings(section["made"])
        return cls(
            keys,
            values,
            correlation * stds[:, None] * stds[None, :],
            runs=runs,
            motors=motors,
            made=made,
            delivered=_delivered(section),
            own_terms=own_terms_of(section, len(runs), TERMS_OF_A_SWING),
            torque_spread=torque_spread_of(section),
            **_read_noise(section),
        )


def _delivered(section: Mapping[str, Any]) -> dict[str, Quantity]:
    """By joint what the file says of measured over commanded currents; older files say nothing."""
    found = {}
    given = part_of(section, "delivered", Mapping) if "delivered" in section else {}
    for joint, entry in given.items():
        with under("delivered", one_line(str(joint), 80)):
            found[str(joint)] = Quantity(*exactly(entry, _DELIVERED))
    return found


def _read_noise(section: Mapping[str, Any]) -> dict[str, float]:
    """By field what the file says of it, else what holds without."""
    noise = {}
    for (name, form), default in zip(NOISE.items(), _NO_NOISE, strict=True):
        field_name = re.sub("_(N_m|rad_s|rad)$", "", name)
        noise[field_name] = read_under(section, name, form, default)
    return noise


def _read_unknown(name: Any, entry: Any) -> tuple[Key, float, float]:
    """Key, value and standard deviation of an unknown."""
    if not isinstance(entry, Mapping):
        raise FormError(f"expected value, std and unit, got {shortly(entry)}")
    key = _key(name)
    form = RANGES[_kind(key)]
    value = read_under(entry, "value", form)
    spread = Number(
        unit=form.unit,
        lowest=_LEAST_STD,
        highest=form.highest,
    )
    std = read_under(entry, "std", spread)
    unit = _unit(key)
    if entry.get("unit", unit) != unit:
        raise FormError(f"unit must be {unit!r}, got {shortly(entry['unit'])}")
    return key, value, std


def check_complete(
    calibration: Calibration,
    links: Sequence[str],
    drive_trains: Mapping[str, Any],
    priors: Mapping[str, Quantity],
) -> None:
    """Check a calibration against the robot file.

    Args:
        calibration: As its section was read.
        links: Of the robot.
        drive_trains: By joint.
        priors: What the file says of other unknowns, by kind.

    Raises:
        FormError: An unknown belongs to no joint or link of the robot, a joint lacks one that the robot file leaves open, or a
            value is far from what the robot file says, or a torque constant from the motor's nominal one.
    """
    for key in calibration.keys:
        of = KINDS[_kind(key)].of
        scope = "" if isinstance(key, str) else str(key[1])
        there: Sequence[str] = ()
        if of == "joint":
            there = tuple(drive_trains)
        elif of == "link":
            there = links
        if of and scope not in there:
            raise FormError(
                f"{name_of(key)}: the robot has no such {of}; it has {', '.join(there)}"
            )
    # of a joint that was only held, its zero is known and nothing else
    known_of = [key[1] for key in calibration.keys if key[0] in TERMS and key[0] != "zero"]
    for joint in dict.fromkeys(map(str, known_of)):
        _check_joint(calibration, joint, drive_trains[joint])
    for key, known in calibration.quantities.items():
        kind = _kind(key)
        prior = getattr(drive_trains[str(key[1])], kind) if kind in TERMS else priors.get(kind)
        if prior is not None and 0.0 < _MOST_STDS * prior.std < abs(known.value - prior.value):
            raise FormError(
                f"{name_of(key)}: {known.value:g} is over {_MOST_STDS:g} of the robot file's standard deviations ({prior.std:g}) "
                f"from {f'{prior.value:g}' if prior.value else 'zero'}: calibrate again"
            )


def _check_joint(calibration: Calibration, joint: str, drive: Any) -> None:
    """Refuse what lacks a term of a joint's drive train that the file leaves open, or has another torque constant."""
    lost = []
    for term in TERMS:
        # a slide has no zero of its own
        is_open = getattr(drive, term).std > 0.0 and (term != "zero" or drive.transmission == 1.0)
        if is_open and (term, joint) not in calibration.keys:
            lost.append(name_of((term, joint)))
    if lost:
        raise FormError(
            f"unknowns: {', '.join(lost)} missing; write it again with `proprio calibrate`"
        )
    found = calibration.quantities.get(("torque_constant", joint), drive.torque_constant).value
    if not 1.0 / _FARTHEST <= found / drive.nominal_torque_constant <= _FARTHEST:
        raise FormError(
            f"torque_constant[{joint}]: {found:g} N m/A is over {_FARTHEST:g} times or under a fifth of the motor's "
            f"nominal {drive.nominal_torque_constant:g}: calibrate again"
        )


def _kind(key: Key) -> str:
    return key if isinstance(key, str) else key[0]


def _key(name: Any) -> Key:
    """The key of an unknown that a calibration may hold."""
    kind, _, scope = str(name).partition("[")
    if (
        kind not in RANGES
        or bool(KINDS[kind].of) != bool(scope)
        or (scope and not scope.endswith("]"))
    ):
        raise FormError(
            f"no such unknown; valid are {', '.join(RANGES)}, of joints and links as kind[name]"
        )
    return key_of(str(name))


def _unit(key: Key) -> str:
    return KINDS[_kind(key)].unit if _kind(key) in KINDS else ""
