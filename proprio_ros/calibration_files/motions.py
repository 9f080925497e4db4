"""What motions of an arm with an empty hand say about it: bodies, rotors, gears and friction, with their covariance.

It is the section ``motion_calibration`` of a robot file that ``extends`` the robot it was made with:

    motion_calibration:
      version: 2                                                 # of what stands here; files of another one are refused
      runs: [{name: .., duration_s: 50.0, load_kg: 0.0}, ..]     # load_kg: of a weighed reference
      torque_scale: {value: 1.0, std: 0.01}                      # true torque over that of the robot file's torque constants
      arm_over_urdf: 1.04                                        # what the torques say the arm weighs, over its URDF's masses
      between_recordings: {common_scale: {std: 0.015, recordings: 4.0}, ..}    # what differs from recording to recording
      spread_evidence: |                                         # how likely each spread of joints and zeros makes the recordings
        0 0 0 0 0 0 0 0 0
      joints: [{name: joint1, torque_constant_N_m_per_A: 1.78, residual_N_m: 0.02, correlated_windows: 3.5}, ..]
      unknowns:
        coulomb[joint1]: {value: 0.05, std: 0.004, unit: N m, run_to_run: 0.01}
      correlation: |                                             # lower triangle, a line per unknown in the order above
        1
      deviations: |                                              # which way each stretch pulls, in the unknowns' std
        0.1
      scale_of_load: |                                           # of the torque scale, where a known load told it: its correlations
        0.3                                                      # with the unknowns, and its own deviations, each in one line
        0.1
      read_time_axis: |                                          # of arms that a voltage drives, see `ReadTimeAxis`
        0.05 -0.007
        1e-4 -1e-5
        -1e-5 1e-6
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from proprio_ros.calibration_files.section import (
    RUN,
    check_section,
    correlation_of,
    exactly,
    lines_of,
    numbers_of,
    part_of,
    read_under,
    runs_of,
    short,
    triangle_of,
)
from proprio_ros.inputs.forms import Form, FormError, Number, Text, shortly, under
from proprio_ros.kinds import name_of
from proprio_ros.records import FloatArray

BODY_TERMS: Mapping[str, str] = {
    "body_mass": "kg",
    **{f"body_moment_{axis}": "kg m" for axis in "xyz"},
    **{f"body_inertia_{axes}": "kg m^2" for axes in ("xx", "xy", "xz", "yy", "yz", "zz")},
}
"""Parameters of the body behind a joint, about the joint's frame, and their units; everything up to the next joint is one body."""
DRIVE_TERMS: Mapping[str, str] = {
    "armature": "kg m^2",
    "load_friction": "1",
    "torque_share": "1",
    **{f"coulomb_{wave}": "N m" for wave in ("sine", "cosine", "sine_twice", "cosine_twice")},
}
"""Of rotor and gears, the same in every run: also by how much more than its constant says a motor's torque is, and Coulomb friction
that goes with sine and cosine of the joint's angle, and of twice the angle."""
FRICTION_TERMS: Mapping[str, str] = {"viscous": "N m s/rad", "coulomb": "N m", "offset": "N m"}
"""What differs from run to run."""
ARM_TERMS = len(BODY_TERMS) + len(DRIVE_TERMS)  # per joint, that do not differ from run to run
TERMS = ARM_TERMS + len(FRICTION_TERMS)
UNITS: Mapping[str, str] = {**BODY_TERMS, **DRIVE_TERMS, **FRICTION_TERMS}
# of the section; 1 had no such number, no torque constants and no friction that goes with the angle
VERSION = 2
Key = tuple[str, str]  # kind of a term, and its joint
_LARGEST = 1e5
_LEAST_STD = 1e-15
_JOINT: dict[str, Form] = {
    "name": Text(),
    "torque_constant_N_m_per_A": Number(
        "that the currents were multiplied with", "N m/A", 0.0, 1e3, open=True
    ),
    "residual_N_m": Number(
        "what the model leaves over; 0: the joint did not move", "N m", 0.0, 1e4
    ),
    "correlated_windows": Number("over so many windows the residuals are correlated", "", 1.0, 1e4),
}
_SCALE: dict[str, Form] = {
    "value": Number("true torque over the robot file's", "", 0.05, 20.0),
    "std": Number("relative", "", 0.0, 10.0, open=True),
}


BETWEEN = frozenset({"common_scale", "own_scale", "friction", "offset", "zero"})
"""What differs between recordings: torque scales and friction relative, offsets in parts of Coulomb friction, zeros [rad]."""
SPREAD_FACTORS = (0.03, 0.1, 0.2, 0.4, 0.8, 1.3, 2.0, 3.2, 5.0)
"""Spreads of torque and zeros that are looked at, over those that were published; torques that differ by more are refused as those
of another unit."""
_BETWEEN: dict[str, Form] = {
    "std": Number(unit="", lowest=0.0, highest=10.0, open=True),
    "recordings": Number("of what its word is worth", "", 0.0, 1e6, open=True),
}


def term_keys(joints: tuple[str, ...]) -> tuple[Key, ...]:
    """All terms of an arm in the order of a calibration's arrays: bodies joint by joint, then every other kind joint by joint."""
    bodies = [(kind, joint) for joint in joints for kind in BODY_TERMS]
    return (
        *bodies,
        *((kind, joint) for kind in (*DRIVE_TERMS, *FRICTION_TERMS) for joint in joints),
    )


@dataclass(frozen=True, eq=False)
class LoadScale:
    """How the torque scale errs together with an arm's P terms, where a known load told both."""

    covariance: FloatArray  # of the relative scale with each term, shape (P,)
    deviations: FloatArray  # which way each stretch pulls the relative scale, shape (stretches,)


@dataclass(frozen=True, eq=False)
class ReadTimeAxis:
    """What torques read of the clocks of recordings that keep time, the same in every recording of an arm that a voltage drives.

    Torques that are made of goals act a little later than the robot file says, which looks like another pace, too.
    """

    values: FloatArray  # logarithm of true over stamped time, and by how much torques come later than positions [s], (2,)
    covariance: FloatArray  # (2, 2)


@dataclass(frozen=True, eq=False)
class MotionCalibration:
    """An arm as motions with an empty hand show it, in torques as the robot file's torque constants make them of currents.

    n joints have P = 20 n terms, see `term_keys`.
    """

    section: ClassVar[str] = "motion_calibration"
    made_of: ClassVar[str] = "motions"
    beside: ClassVar[Mapping[str, bool]] = {}

    joints: tuple[str, ...]  # parents before children, length n
    torque_constants: FloatArray  # that the currents were multiplied with [N m/A], shape (n,)
    values: FloatArray  # friction is the mean of the runs; shape (P,)
    # as a prior of the next fit, correlated residuals and the robot file's own priors counted; shape (P, P)
    covariance: FloatArray
    # which way each stretch of 2.5 s pulls the values: the sum of the rows' outer products is a covariance that assumes
    # nothing about the residuals within a stretch; shape (stretches, P)
    deviations: FloatArray
    # standard deviation of viscous friction, Coulomb friction and offset from run to run, in the order of
    # `FRICTION_TERMS` and then of the joints; shape (3 n,)
    friction_spread: FloatArray
    residual: FloatArray  # RMS of the mean torque in a window that is left over [N m], shape (n,)
    # over how many windows the residuals of a joint are correlated: so much less they say; shape (n,)
    correlation: FloatArray
    # true torque over that of the robot file's constants; 1 where no reference was held
    torque_scale: float
    torque_scale_std: float  # how well that is known, relative
    # by how much the torques of the arm's own bodies are those that its URDF says
    arm_over_urdf: float
    fingerprint: str  # of the URDF
    runs: tuple[Mapping[str, Any], ...]  # one mapping per run: name, duration_s, load_kg
    # what differs between recordings: of each of `BETWEEN` its standard deviation, and on the word of how many
    # recordings that rests; empty in files that do not say
    between: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # logarithm of how likely each of `SPREAD_FACTORS` makes these recordings, over how likely none does; 0 where they say nothing
    spread_evidence: FloatArray = field(default_factory=lambda: np.zeros(len(SPREAD_FACTORS)))
    # how much each joint would tell of a mass in these motions, shape (n,), sum 1; None: not kept in files
    tells: FloatArray | None = None
    # None: no known load told the scale, or a file of before there was this
    scale_of_load: LoadScale | None = None
    # None: of torques that were measured, or a file of before there was this
    read_time_axis: ReadTimeAxis | None = None

    @property
    def keys(self) -> tuple[Key, ...]:
        """Kind and joint of every term, length P."""
        return term_keys(self.joints)

    @property
    def referenced(self) -> bool:
        """Whether a weighed object told the torque constants."""
        return any(run["load_kg"] > 0.0 for run in self.runs)

    @property
    def empty_motions(self) -> int:
        """How many motions with an empty hand it is of."""
        return sum(run["load_kg"] == 0.0 for run in self.runs)

    @property
    def stretches(self) -> int:
        """Of 2.5 s that were fitted."""
        return len(self.deviations)

    @property
    def std(self) -> FloatArray:
        """Of every value, shape (P,): the larger of what the fit and what its stretches say."""
        by_stretches = (self.deviations**2).sum(axis=0)
        return np.sqrt(np.maximum(np.diag(self.covariance), by_stretches))

    @property
    def friction(self) -> slice:
        """Where viscous friction, Coulomb friction and offset stand."""
        return slice(ARM_TERMS * len(self.joints), TERMS * len(self.joints))

    def as_settings(self) -> dict[str, Any]:
        """Plain numbers for the file, whose ``model_fingerprint`` is that of the URDF."""
        std = np.sqrt(np.diag(self.covariance))
        unknowns: dict[str, Any] = {}
        for row, (kind, joint) in enumerate(self.keys):
            entry = {
                "value": short(self.values[row], 15),
                "std": short(std[row], 15),
                "unit": UNITS[kind],
            }
            if kind in FRICTION_TERMS:
                entry["run_to_run"] = short(self.friction_spread[row - self.friction.start])
            unknowns[name_of((kind, joint))] = entry
        columns = (self.joints, self.torque_constants, self.residual, self.correlation)
        joints = []
        for joint, constant, rms, windows in zip(*columns, strict=True):
            numbers = (joint, short(constant, 15), short(rms), short(windows))
            joints.append(dict(zip(_JOINT, numbers, strict=True)))
        section = {
            "version": VERSION,
            "runs": [dict(run) for run in self.runs],
            "torque_scale": {
                "value": short(self.torque_scale),
                "std": short(self.torque_scale_std),
            },
            "arm_over_urdf": short(self.arm_over_urdf),
            "joints": joints,
            "between_recordings": {
                kind: {"std": short(std), "recordings": short(recordings)}
                for kind, (std, recordings) in self.between.items()
            },
            "spread_evidence": lines_of([self.spread_evidence], 6),
            "unknowns": unknowns,
            "correlation": triangle_of(self.covariance / std[:, None] / std),
            "deviations": lines_of(self.deviations / std, 9),
        }
        self._add_optional(section, std)
        return section

    def _add_optional(self, section: dict[str, Any], std: FloatArray) -> None:
        """What not every calibration has, as plain numbers; ``std``: of the terms, (P,)."""
        axis = self.read_time_axis
        if axis is not None:
            section["read_time_axis"] = lines_of([axis.values, *axis.covariance], 9)
        scale = self.scale_of_load
        if scale is not None:
            of_scale = self.torque_scale_std
            correlation = scale.covariance / std / of_scale
            section["scale_of_load"] = lines_of([correlation], 12) + lines_of(
                [scale.deviations / of_scale], 9
            )

    @classmethod
    def from_settings(cls, section: Any) -> MotionCalibration:
        """Read the section of a robot file, but for the fingerprint, which stands elsewhere in it; raises `FormError`."""
        check_section(section)
        if section.get("version", 1) != VERSION:
            raise FormError(
                f"version {shortly(section.get('version', 1))} is of another release, this one reads {VERSION}: calibrate "
                "again with the same recordings (`proprio calibrate`), which takes seconds"
            )
        runs = runs_of(section, RUN)
        joints, constants, residual, correlated = _read_joints(section)
        terms = _Terms.of(section, joints)
        count = len(terms.place)
        std = terms.std
        correlation = correlation_of(section, count, -1e-9)[np.ix_(terms.place, terms.place)]
        deviations = _read_deviations(section, count)
        stated = part_of(section, "torque_scale", Mapping)
        with under("torque_scale"):
            torque_scale, torque_scale_std = exactly(stated, _SCALE)
        return cls(
            joints=joints,
            torque_constants=constants,
            values=terms.values,
            covariance=correlation * std[:, None] * std,
            deviations=deviations[:, terms.place] * std,
            friction_spread=terms.friction_spread,
            residual=residual,
            correlation=correlated,
            torque_scale=torque_scale,
            torque_scale_std=torque_scale_std,
            arm_over_urdf=read_under(section, "arm_over_urdf", Number("", "", -100.0, 100.0)),
            fingerprint="",
            runs=runs,
            between=_read_between(section.get("between_recordings", {})),
            spread_evidence=_read_spread_evidence(section),
            scale_of_load=_read_scale_of_load(section, terms, len(deviations), torque_scale_std),
            read_time_axis=_read_time_axis(section),
        )


def _read_joints(
    section: Mapping[str, Any],
) -> tuple[tuple[str, ...], FloatArray, FloatArray, FloatArray]:
    """Of n joints their names, torque constants [N m/A], residuals [N m] and numbers of correlated windows, (n,) each."""
    entries = []
    for number, entry in enumerate(part_of(section, "joints", list), 1):
        with under("joints", number):
            entries.append(exactly(entry, _JOINT))
    names = tuple(entry[0] for entry in entries)
    numbers = np.array([entry[1:] for entry in entries]).reshape(-1, 3)
    constants, residual, correlated = numbers.T
    return names, constants, residual, correlated


@dataclass(frozen=True)
class _Terms:
    """What a file says of the P terms of an arm, in the order of `term_keys`."""

    place: list[int]  # of each term in the file: its correlations and deviations follow that order
    values: FloatArray  # (P,)
    std: FloatArray  # (P,)
    friction_spread: FloatArray  # from run to run, (3 n,)

    @classmethod
    def of(cls, section: Mapping[str, Any], joints: tuple[str, ...]) -> _Terms:
        """Raises: FormError: A term is missing, of no joint of the arm, or no number."""
        keys = term_keys(joints)
        names = [name_of(key) for key in keys]
        unknowns = part_of(section, "unknowns", Mapping)
        if not joints or set(unknowns) != set(names):
            wrong = sorted(set(names) ^ {str(name) for name in unknowns}) or ["no joints"]
            raise FormError(
                f"unknowns: {shortly(wrong[0])} is missing or of no joint of it; calibrate again"
            )
        read = []
        for (kind, _), name in zip(keys, names, strict=True):
            with under("unknowns", name):
                read.append(_read_term(unknowns[name], kind))
        order = list(unknowns)
        return cls(
            [order.index(name) for name in names],
            np.array([term[0] for term in read]),
            np.array([term[1] for term in read]),
            np.array([part for term in read for part in term[2:]]),
        )


def _read_deviations(section: Mapping[str, Any], count: int) -> FloatArray:
    """Rows of so many numbers."""
    rows = numbers_of(section, "deviations")
    wrong = any(len(row) != count for row in rows)
    if not rows or wrong or not np.all(np.isfinite(rows)):
        raise FormError(f"deviations must be rows of {count} finite numbers; calibrate again")
    return np.array(rows)


def _read_between(given: Any) -> dict[str, tuple[float, float]]:
    """What differs between recordings; nothing where the file says nothing."""
    if not isinstance(given, Mapping) or set(given) not in (set(), BETWEEN):
        raise FormError(
            f"between_recordings must have {', '.join(sorted(BETWEEN))}, got {shortly(given)}"
        )
    read = {}
    for kind, entry in given.items():
        with under("between_recordings", kind):
            std, recordings = exactly(entry, _BETWEEN)
            read[kind] = (std, recordings)
    return read


def _read_spread_evidence(section: Mapping[str, Any]) -> FloatArray:
    """Nothing where the file says nothing."""
    if "spread_evidence" not in section:
        return np.zeros(len(SPREAD_FACTORS))
    evidence = np.array([value for row in numbers_of(section, "spread_evidence") for value in row])
    if len(evidence) != len(SPREAD_FACTORS) or not np.all(np.isfinite(evidence)):
        raise FormError("spread_evidence is of another release; calibrate again")
    return evidence


def _read_scale_of_load(
    section: Mapping[str, Any],
    terms: _Terms,
    stretches: int,
    scale_std: float,
) -> LoadScale | None:
    """None where the file says nothing; ``scale_std``: of the relative scale."""
    if "scale_of_load" not in section:
        return None
    rows = numbers_of(section, "scale_of_load")
    count = len(terms.place)
    if [len(row) for row in rows] != [count, stretches]:
        raise FormError(
            f"scale_of_load must be a row of {count} correlations and one of {stretches} deviations; calibrate again"
        )
    correlation = np.array(rows[0])
    deviations = np.array(rows[1])
    if not np.all(np.isfinite(deviations)) or not np.all(np.abs(correlation) <= 1.0):
        raise FormError("scale_of_load must be correlations and finite numbers; calibrate again")
    return LoadScale(correlation[terms.place] * terms.std * scale_std, deviations * scale_std)


def _read_time_axis(section: Mapping[str, Any]) -> ReadTimeAxis | None:
    """None where the file says nothing."""
    if "read_time_axis" not in section:
        return None
    rows = numbers_of(section, "read_time_axis")
    if [len(row) for row in rows] != [2, 2, 2] or not np.all(np.isfinite(rows)):
        raise FormError("read_time_axis must be three rows of two finite numbers; calibrate again")
    values = np.array(rows[0])
    covariance = np.array(rows[1:])
    if np.any(covariance != covariance.T) or np.any(np.linalg.eigvalsh(covariance) <= 0.0):
        raise FormError("read_time_axis: the last two rows are no covariance; calibrate again")
    return ReadTimeAxis(values, covariance)


def _read_term(entry: Any, kind: str) -> list[float]:
    """Value, standard deviation and, of friction, the spread from run to run."""
    unit = UNITS[kind]
    forms: dict[str, Form] = {
        "value": Number(unit=unit, lowest=-_LARGEST, highest=_LARGEST),
        "std": Number(unit=unit, lowest=_LEAST_STD, highest=_LARGEST),
    }
    if kind in FRICTION_TERMS:
        forms["run_to_run"] = Number(
            unit=unit,
            lowest=0.0,
            highest=_LARGEST,
        )
    if isinstance(entry, Mapping) and entry.get("unit") != unit:
        raise FormError(f"unit must be {unit!r}, got {shortly(entry.get('unit'))}")
    return exactly(entry, forms, ("unit",))
