"""What motions with known loads say about a robot of one joint under a controller: its torque, rotor and friction.

It is the section ``joint_calibration`` of a robot file that ``extends`` the robot it was made with:

    joint_calibration:
      joint: pendulum
      torque_constant_N_m_per_A: 1.21              # that the currents were multiplied with
      torque_scale: 0.4 ..                         # the terms, see `TERMS`, by name
      spread: 0.04                                 # by which recordings differ beyond their own error, relative to the mass
      residual_N_m: 0.1                            # that the model leaves over, in a window
      runs: [{name: .., duration_s: 6.0, load_kg: 0.5, read_kg: 0.52, std_kg: 0.03}, ..]    # each weighed by the others
      without: |                                   # the terms, a line for each run left out
        0.4 ..
      own_terms: |                                 # rotor, viscous and Coulomb friction by each run itself, see `own_terms`
        0.02 ..
      driven_by: {kind: position_servo, gain_per_rad: 2.656, ..}   # what made currents of goals, where something did
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from proprio_ros.calibration_files.own_terms import (
    ARMATURE,
    COULOMB,
    VISCOUS,
    OwnTerms,
    own_terms_of,
    own_terms_text,
)
from proprio_ros.calibration_files.section import (
    RUN,
    check_section,
    lines_of,
    numbers_of,
    part_of,
    read_under,
    runs_of,
    short,
)
from proprio_ros.inputs.forms import Form, FormError, Number, Text, under
from proprio_ros.records import FloatArray

TERMS: Mapping[str, str] = {
    "scale": "1",
    "armature": "kg m^2",
    "viscous": "N m s/rad",
    "coulomb": "N m",
    "load_friction": "1",
    "heavy_load_friction": "1/(N m)",
}
"""All in torques as the robot file's torque constant makes them of currents: ``scale`` is such a torque over the true one, the two
shares of load friction are of the true torque and of its square."""
OWN_TERMS = (ARMATURE, VISCOUS, COULOMB)
"""What each recording shows by itself, in torques as the scale has them."""
FEWEST_RUNS = 3  # of fewer, none says by how much they differ
_LARGEST = 1e6


def _any_number(unit: str = "") -> Number:
    return Number(unit=unit, lowest=-_LARGEST, highest=_LARGEST)


_RUN: dict[str, Form] = RUN | {
    "read_kg": _any_number("kg"),
    "std_kg": Number(unit="kg", lowest=0.0, highest=_LARGEST),
}
_FORMS: dict[str, Form] = {
    "torque_constant_N_m_per_A": Number(
        "that the currents were multiplied with", "N m/A", 0.0, 1e3, open=True
    ),
    **{term: _any_number(unit) for term, unit in TERMS.items()},
    "spread": Number("by which recordings differ, relative", "", 0.0, 10.0, open=True),
    "residual_N_m": Number("left over", "N m", 0.0, 1e4, open=True),
}


@dataclass(frozen=True, eq=False)
class JointCalibration:
    """One joint as motions with known loads show it."""

    section: ClassVar[str] = "joint_calibration"
    made_of: ClassVar[str] = "motions"
    beside: ClassVar[Mapping[str, bool]] = {}

    joint: str
    torque_constant: float  # that the currents were multiplied with [N m/A]
    values: FloatArray  # see `TERMS`, shape (6,)
    without: FloatArray  # the same from all recordings but one, shape (runs, 6)
    # by how much masses of recordings differ beyond what each knows of its own error, relative
    spread: float
    residual: float  # RMS of the windows' mean torque that is left over [N m]
    # one mapping per recording: name, duration_s, load_kg; read_kg, std_kg: what the others make of it
    runs: tuple[Mapping[str, Any], ...]
    # `OWN_TERMS` of each recording; none in older files
    own_terms: tuple[OwnTerms, ...] = ()
    # the law that made currents of goals and duty cycles, as the robot file had it; nothing where there was none, or in older files
    driven_by: Mapping[str, Any] = field(default_factory=dict)

    @property
    def loads_kg(self) -> FloatArray:
        """What was held, shape (runs,)."""
        return np.array([float(run["load_kg"]) for run in self.runs])

    @property
    def std(self) -> FloatArray:
        """Of every term, by leaving out one recording at a time, shape (6,)."""
        apart = self.without - self.without.mean(axis=0)
        share = (len(apart) - 1) / len(apart)
        return np.sqrt(share * np.square(apart).sum(axis=0))

    def as_settings(self) -> dict[str, Any]:
        """Plain numbers for the file."""
        terms = [short(value, 15) for value in self.values]
        return {
            "joint": self.joint,
            "torque_constant_N_m_per_A": short(self.torque_constant, 15),
            **dict(zip(TERMS, terms, strict=True)),
            "spread": short(self.spread),
            "residual_N_m": short(self.residual),
            "runs": [dict(run) for run in self.runs],
            "without": lines_of(self.without, 15),
            **own_terms_text(self.own_terms),
            **({"driven_by": dict(self.driven_by)} if self.driven_by else {}),
        }

    @classmethod
    def from_settings(cls, section: Any) -> JointCalibration:
        """Read the section of a robot file; raises `FormError` where a key is missing, or a number is none."""
        check_section(section)
        runs = runs_of(section, _RUN)
        joint = part_of(section, "joint", str)
        constant, *terms, spread, residual = (
            read_under(section, key, form) for key, form in _FORMS.items()
        )
        rows = numbers_of(section, "without")
        whole = (
            len(rows) == len(runs)
            and all(len(row) == len(TERMS) for row in rows)
            and np.all(np.isfinite(rows))
        )
        if len(runs) < FEWEST_RUNS or not whole:
            raise FormError(
                f"without must have a line of {len(TERMS)} finite numbers for each of {FEWEST_RUNS} runs or more; calibrate again"
            )
        own_terms = own_terms_of(section, len(runs), len(OWN_TERMS))
        driven_by = _law_of(section)
        return cls(
            joint,
            constant,
            np.array(terms),
            np.array(rows),
            spread,
            residual,
            runs,
            own_terms,
            driven_by,
        )


def _law_of(section: Mapping[str, Any]) -> dict[str, Any]:
    """What drove the joint, by key; nothing where the section says nothing of it; raises `FormError`."""
    if "driven_by" not in section:
        return {}
    given = part_of(section, "driven_by", Mapping)
    law = {}
    with under("driven_by"):
        for key, value in given.items():
            form = Text() if key == "kind" else _any_number()
            law[str(key)] = form.read(value)
    return law
