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
      motors:                            # whose arm it is, where the recordings say so; without this section nothing is compared
        joint3: {model: 1020, id: 13, firmware: 46, homing_offset: 0, drive_mode: 0, moving_threshold: 10}
      made: {time_s: 1760000009.8, temperature_C: {joint3: 34.0}}   # when, by the clock of the recordings; see `drift`
      start_velocity_rad_s: 0.003        # how still the held joint is when its probe begins; all numbers have ranges, see `RANGES`
      unknowns:
        torque_constant[joint3]: {value: 1.74, std: 0.02, unit: N m/A}
      correlation: |                     # lower triangle, a line per unknown in the order above
        1
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motors import MotorIdentity, Motors
from proprio_ros.errors import RobotError, one_line
from proprio_ros.inputs.forms import Form, FormError, Number, Text, Whole, shortly
from proprio_ros.kinds import KINDS, Key, key_of, name_of
from proprio_ros.quantity import Quantity

FloatArray = NDArray[np.float64]
RANGES: dict[str, Number] = {
    "torque_constant": Number("at the output shaft", "N m/A", 0.0, 1e3, open=True),
    "coulomb": Number("dry friction", "N m", 0.0, 1e3),
    "viscous": Number("viscous friction", "N m s/rad", 0.0, 1e3),
    "load_friction": Number("part of the motor's torque that the gears lose", "", 0.0, 1.0),
    "armature": Number("rotor and gears, seen at the output", "kg m^2", 0.0, 100.0),
    "stribeck": Number("by how much of itself dry friction is greater at rest", "", 0.0, 10.0),
    "stribeck_velocity": Number("speed at which 1/e of that is left", "rad/s", 0.0, 100.0, open=True),
    "zero": Number("true position minus reading", "rad", -7.0, 7.0),
    "ripple_cos": Number("encoder error", "rad", -0.2, 0.2),
    "ripple_sin": Number("encoder error", "rad", -0.2, 0.2),
    "link_mass": Number("beyond the URDF's, relative", "", -0.9, 5.0),
    "link_com_x": Number("beyond the URDF's", "m", -0.5, 0.5),
    "link_com_y": Number("beyond the URDF's", "m", -0.5, 0.5),
    "link_com_z": Number("beyond the URDF's", "m", -0.5, 0.5),
    "link_inertia": Number("beyond the URDF's, relative", "", -0.9, 10.0),
    "arm_scale": Number("all masses of the URDF times this", "", 0.5, 2.0),
    "delay": Number("from the command's stamp to torque, less that of the position", "s", -0.1, 0.1),
}
"""What a calibration may say of each kind of unknown; further off is no arm, but a slip of the hand or of a unit."""
NOISE: dict[str, Number] = {
    "residual_scale": Number("residuals over what encoder and stamps explain", "", 0.01, 10.0),
    "stamp_jitter_s": Number("standard deviation of the stamps", "s", 0.0, 0.1),
    "torque_disturbance_N_m": Number("torque that differs from run to run", "N m", 0.0, 100.0),
    "start_velocity_rad_s": Number("of a held joint when its probe begins", "rad/s", 0.0, 10.0, open=True),
    "friction_spread": Number("friction that differs from one free swing to the next, relative", "", 0.0, 1.0),
    "swing_error_rad": Number("simulated less measured free swing, in which samples share an error", "rad", 0.0, 10.0),
}
_RUN: dict[str, Form] = {
    "name": Text(longest=9000),
    "joint": Text(),
    "current_A": Number(unit="A", lowest=-1e3, highest=1e3),
    "load_kg": Number(unit="kg", lowest=0.0, highest=1e3),
    "samples": Whole(lowest=0, highest=10**9),
}
_TIME = Number("since 1970", "s", lowest=0.0, highest=1e11)
_TEMPERATURE = Number("of a motor", "deg C", lowest=-273.0, highest=1e3)
TERMS = (
    "torque_constant", "coulomb", "viscous", "load_friction", "armature", "zero", "stribeck", "stribeck_velocity",
)  # fmt: skip
"""Kinds of unknowns that a drive train has."""
_LEAST_STD = 1e-10  # of any unknown, in its unit: below it, a covariance loses its digits
_FARTHEST = 5.0  # times the nominal torque constant, or that part of it
_MOST_STDS = 10.0
_SMALLEST_EIGENVALUE = 1e-12  # of a correlation matrix: below it, rounding has made it no covariance


@dataclass(frozen=True)
class Moment:
    """When something was recorded, and how warm the motors were.

    Attributes:
        time_s: Mean over its runs, by the clock of the recording [s].
        temperature_C: Of the motors that say it, by joint.
    """

    time_s: float
    temperature_C: Mapping[str, float] = field(default_factory=dict)

    def as_settings(self) -> dict[str, Any]:
        """Plain numbers."""
        warmth = {joint: short(t, 4) for joint, t in self.temperature_C.items()}
        return {"time_s": round(self.time_s, 1), **({"temperature_C": warmth} if warmth else {})}

    @classmethod
    def from_settings(cls, given: Any, where: str) -> Moment:
        """The reverse of ``as_settings``.

        Raises:
            RobotError: It is none.
        """
        if not isinstance(given, Mapping) or not {"time_s"} <= set(given) <= {"time_s", "temperature_C"}:
            raise RobotError(f"{where}: expected time_s and perhaps temperature_C, got {shortly(given)}")
        warmth = part_of(given, "temperature_C", Mapping, where) if "temperature_C" in given else {}
        return cls(
            read_as(given["time_s"], _TIME, f"{where}: time_s"),
            {str(j): read_as(t, _TEMPERATURE, f"{where}: temperature_C: {shortly(j)}") for j, t in warmth.items()},
        )


@dataclass(frozen=True, eq=False)
class Calibration:
    """The robot as its own recordings show it.

    Attributes:
        keys: Of the unknowns, such as ``("coulomb", "joint3")``, length C.
        values: Shape (C,).
        covariance: Shape (C, C), positive definite.
        residual_scale: Residuals over what encoder and stamps explain.
        stamp_jitter_s: Standard deviation of the stamps.
        torque_disturbance: Standard deviation of a torque that differs from run to run [N m].
        start_velocity: Standard deviation of the velocity at which probes begin [rad/s].
        friction_spread: Relative standard deviation of friction from one free swing to the next; 0 where none was calibrated with.
        swing_error: Error of simulated free swings, see `Robot.swing_error` [rad].
        runs: One mapping per run used: name, joint, current_A, load_kg, samples.
        motors: Of the arm, by joint, where its recordings say so.
        made: When it was made, or since when it counts (see `drift`); None where the recordings do not say it.
    """

    keys: tuple[Key, ...]
    values: FloatArray
    covariance: FloatArray
    residual_scale: float = 1.0
    stamp_jitter_s: float = 0.0
    torque_disturbance: float = 0.0
    start_velocity: float = 0.01
    runs: tuple[Mapping[str, Any], ...] = ()
    motors: Motors = field(default_factory=dict)
    friction_spread: float = 0.0
    swing_error: float = 0.0
    made: Moment | None = None

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns, such as ``coulomb[joint3]``."""
        return tuple(name_of(key) for key in self.keys)

    @functools.cached_property
    def quantities(self) -> dict[Key, Quantity]:
        """Each unknown by key, with its own standard deviation."""
        stds = np.sqrt(np.diag(self.covariance))
        return {key: Quantity(float(v), float(s)) for key, v, s in zip(self.keys, self.values, stds, strict=True)}

    @functools.cached_property
    def correlation(self) -> FloatArray:
        """Shape (C, C)."""
        stds = np.sqrt(np.diag(self.covariance))
        result: FloatArray = self.covariance / stds[:, None] / stds[None, :]
        return result

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints whose drive trains were calibrated; a free swing does without a torque constant, which may be stated exactly."""
        swung = {run["joint"] for run in self.runs} if self.swing_error > 0.0 else set()
        known = (
            str(key[1]) for key in self.keys if key[0] == "torque_constant" or (key[0] in TERMS and key[1] in swung)
        )
        return tuple(dict.fromkeys(known))

    @property
    def driven(self) -> tuple[str, ...]:
        """Joints of which it knows what a current does: a free swing tells nothing of that."""
        return () if self.swing_error > 0.0 else self.joints

    def without(self, keys: set[Key]) -> Calibration:
        """The same with some unknowns marginalised out; keys that it does not hold are ignored."""
        keep = [row for row, key in enumerate(self.keys) if key not in keys]
        return replace(
            self,
            keys=tuple(self.keys[row] for row in keep),
            values=self.values[keep],
            covariance=self.covariance[np.ix_(keep, keep)],
        )

    def given(self, keys: set[Key]) -> Calibration:
        """What is known of the others where some unknowns are exactly as here; keys that it does not hold are ignored."""
        fixed = [row for row, key in enumerate(self.keys) if key in keys]
        others = [row for row, key in enumerate(self.keys) if key not in keys]
        across = self.covariance[np.ix_(others, fixed)]
        follows = np.linalg.solve(self.covariance[np.ix_(fixed, fixed)], across.T)
        covariance = self.covariance.copy()
        covariance[np.ix_(others, others)] -= across @ follows
        return replace(self, covariance=covariance).without(keys)

    def as_settings(self) -> dict[str, Any]:
        """Plain numbers for the file; the correlations as text, which reads a hundred times faster than as YAML numbers."""
        return {
            "runs": [dict(run) for run in self.runs],
            "residual_scale": short(self.residual_scale),
            "stamp_jitter_s": short(self.stamp_jitter_s),
            "torque_disturbance_N_m": short(self.torque_disturbance),
            "start_velocity_rad_s": short(self.start_velocity),
            **({"made": self.made.as_settings()} if self.made is not None else {}),
            **({"motors": {joint: motor.as_settings() for joint, motor in self.motors.items()}} if self.motors else {}),
            **(
                {"friction_spread": short(self.friction_spread), "swing_error_rad": short(self.swing_error)}
                if self.swing_error > 0.0
                else {}
            ),
            "unknowns": {
                name_of(key): {"value": short(known.value, 15), "std": short(known.std, 15), "unit": _unit(key)}
                for key, known in self.quantities.items()
            },
            "correlation": triangle_of(self.correlation),
        }  # fmt: skip

    @classmethod
    def from_settings(cls, section: Any, where: str) -> Calibration:
        """Read the section of a robot file.

        Raises:
            RobotError: A key is missing, a number is none, or the correlations belong to no covariance.
        """
        check_section(section, where)
        unknowns = part_of(section, "unknowns", Mapping, where)
        correlation = part_of(section, "correlation", str, where)
        runs = runs_of(section, _RUN, where)
        motors = {}
        for joint, entry in (part_of(section, "motors", Mapping, where) if "motors" in section else {}).items():
            at = f"{where}: motors: {one_line(str(joint), 80)}"
            try:
                motors[str(joint)] = MotorIdentity.from_settings(entry)
            except FormError as error:
                raise RobotError(f"{at}: {error}") from None
        keys, values, stds = [], [], []
        for name, entry in unknowns.items():
            at = f"{where}: unknowns: {one_line(str(name), 80)}"
            if not isinstance(entry, Mapping):
                raise RobotError(f"{at}: expected value, std and unit, got {shortly(entry)}")
            keys.append(_key(name, at))
            form = RANGES[_kind(keys[-1])]
            values.append(read_as(entry.get("value"), form, f"{at}: value"))
            spread = Number(unit=form.unit, lowest=_LEAST_STD, highest=form.highest)
            stds.append(read_as(entry.get("std"), spread, f"{at}: std"))
            if entry.get("unit", _unit(keys[-1])) != _unit(keys[-1]):
                raise RobotError(f"{at}: unit must be {_unit(keys[-1])!r}, got {shortly(entry['unit'])}")
        matrix = correlation_of(correlation, len(keys), f"{where}: correlation")
        if np.linalg.eigvalsh(matrix)[0] < _SMALLEST_EIGENVALUE:
            raise RobotError(f"{where}: correlation is not one of any covariance; calibrate again")
        scale = np.array(stds)
        residual_scale, stamp_jitter_s, torque_disturbance, start_velocity, friction_spread, swing_error = (
            read_as(section.get(name, default), NOISE[name], f"{where}: {name}")
            for name, default in zip(NOISE, (1.0, 0.0, 0.0, 0.01, 0.0, 0.0), strict=True)
        )
        return cls(
            tuple(keys),
            np.array(values),
            matrix * scale[:, None] * scale[None, :],
            residual_scale,
            stamp_jitter_s,
            torque_disturbance,
            start_velocity,
            tuple(runs),
            motors,
            friction_spread,
            swing_error,
            Moment.from_settings(section["made"], f"{where}: made") if "made" in section else None,
        )


def check_complete(
    calibration: Calibration,
    links: Sequence[str],
    drive_trains: Mapping[str, Any],
    spreads: Mapping[str, float],
    where: str,
) -> None:
    """Whether the unknowns of a calibration file are those of this robot, and none of a calibrated joint was lost.

    Args:
        calibration: as the file has it.
        links: of the robot, by name.
        drive_trains: of the robot file, by joint; each a ``DriveTrain``.
        spreads: standard deviations that the robot file gives to what it takes for zero, by kind of unknown.
        where: for the message.

    Raises:
        RobotError: an unknown belongs to no joint or link of the robot, a joint lacks one that the robot file leaves open, or a
            torque constant is far from the motor's nominal one.
    """
    there = set(calibration.keys)
    for key in calibration.keys:
        of, scope = KINDS[_kind(key)].of, "" if isinstance(key, str) else str(key[1])
        names = {"joint": tuple(drive_trains), "link": tuple(links)}.get(of, ())
        if of and scope not in names:
            raise RobotError(f"{where}: {name_of(key)}: the robot has no such {of}; it has {', '.join(names)}")
        value, spread = calibration.quantities[key].value, spreads.get(_kind(key), 0.0)
        if spread > 0.0 and abs(value) > _MOST_STDS * spread:
            raise RobotError(
                f"{where}: {name_of(key)}: {value:g} is over {_MOST_STDS:g} of the robot file's standard deviations ({spread:g}) "
                "from zero: calibrate again"
            )
    # of a joint that was only held, its zero is known and nothing else
    for joint in dict.fromkeys(str(key[1]) for key in calibration.keys if key[0] in TERMS and key[0] != "zero"):
        drive = drive_trains[joint]
        # a slide has no zero of its own
        open_terms = [t for t in TERMS if getattr(drive, t).std > 0.0 and (t != "zero" or drive.transmission == 1.0)]
        lost = [name_of((t, joint)) for t in open_terms if (t, joint) not in there]
        if lost:
            raise RobotError(f"{where}: unknowns: {', '.join(lost)} missing; write it again with `proprio calibrate`")
        found = calibration.quantities.get(("torque_constant", joint), drive.torque_constant).value
        if not 1.0 / _FARTHEST <= found / drive.nominal_torque_constant <= _FARTHEST:
            raise RobotError(
                f"{where}: torque_constant[{joint}]: {found:g} N m/A is over {_FARTHEST:g} times or under a fifth of the motor's "
                f"nominal {drive.nominal_torque_constant:g}: calibrate again"
            )


def triangle_of(correlation: FloatArray) -> str:
    """The lower triangle as text, a line per unknown."""
    return "".join(" ".join(f"{c:.12g}" for c in row[: n + 1]) + "\n" for n, row in enumerate(correlation))


def correlation_of(text: str, count: int, where: str) -> FloatArray:
    """The correlation matrix of such a text, shape (count, count).

    Raises:
        RobotError: It is none of so many unknowns.
    """
    rows = numbers_of(text, where)
    if not count or [len(row) for row in rows] != [n + 1 for n in range(count)]:
        raise RobotError(f"{where} must be the lower triangle of {count} unknowns, one row each; calibrate again")
    matrix = np.zeros((count, count))
    for n, row in enumerate(rows):
        matrix[n, : n + 1] = row
    matrix = matrix + np.tril(matrix, -1).T
    if not np.all(np.isfinite(matrix)) or np.abs(np.diag(matrix) - 1.0).max() > 1e-9:
        raise RobotError(f"{where} must be finite, with ones on its diagonal; calibrate again")
    return matrix


def numbers_of(text: str, where: str) -> list[list[float]]:
    """Lines of numbers.

    Raises:
        RobotError: A word is none.
    """
    rows = []
    for n, line in enumerate(text.splitlines(), start=1):
        try:
            rows.append([float(word) for word in line.split()])
        except ValueError as error:
            raise RobotError(f"{where}, line {n}: {error}; calibrate again") from error
    return rows


def _kind(key: Key) -> str:
    return key if isinstance(key, str) else key[0]


def _key(name: Any, where: str) -> Key:
    """The key of an unknown that a calibration may hold."""
    kind, _, scope = str(name).partition("[")
    if kind not in RANGES or bool(KINDS[kind].of) != bool(scope) or (scope and not scope.endswith("]")):
        raise RobotError(f"{where}: no such unknown; valid are {', '.join(RANGES)}, of joints and links as kind[name]")
    return key_of(str(name))


def _unit(key: Key) -> str:
    kind = key if isinstance(key, str) else key[0]
    return KINDS[kind].unit if kind in KINDS else ""


def read_forms(entry: Any, forms: Mapping[str, Form], where: str, beside: tuple[str, ...] = ()) -> list[Any]:
    """The values of a mapping that has exactly these keys, in their order."""
    if not isinstance(entry, Mapping) or set(entry) != {*forms, *beside}:
        raise RobotError(f"{where}: expected {', '.join((*forms, *beside))}, got {shortly(entry)}")
    return [read_as(entry[key], form, f"{where}: {key}") for key, form in forms.items()]


def check_section(section: Any, where: str) -> None:
    """Raises: RobotError: What a robot file has as a calibration is no mapping."""
    if not isinstance(section, Mapping):
        raise RobotError(
            f"{where}: expected keys and values, got {shortly(section)}; write it with `proprio calibrate`"
        )


def runs_of(section: Mapping[str, Any], forms: Mapping[str, Form], where: str) -> list[Any]:
    """The runs of a calibration, each a mapping that has exactly these keys."""
    runs: list[Any] = part_of(section, "runs", list, where)
    for number, run in enumerate(runs, 1):
        read_forms(run, forms, f"{where}: runs: {number}")
    return runs


def part_of(section: Mapping[str, Any], key: str, kind: type, where: str) -> Any:
    """A part of a section that must be there.

    Raises:
        RobotError: It is not, or is something else.
    """
    if not isinstance(section.get(key), kind):
        raise RobotError(f"{where}: {key} is missing or no {kind.__name__}; write it with `proprio calibrate`")
    return section[key]


def read_as(value: Any, form: Form, where: str) -> Any:
    """A value as its form takes it.

    Raises:
        RobotError: It is none of that form.
    """
    try:
        return form.read(value)
    except FormError as error:
        raise RobotError(f"{where}: {error}") from None


def short(value: float, digits: int = 12) -> float:
    """A number as the file has it."""
    return float(f"{value:.{digits}g}")
