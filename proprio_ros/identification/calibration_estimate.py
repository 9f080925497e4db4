"""The answer of a calibration: what is known about the robot now, how well it predicts runs, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from proprio_ros.calibration_files.motions import (
    MotionCalibration,
)
from proprio_ros.calibration_files.one_joint import (
    JointCalibration,
)
from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.identification.estimate import (
    Fit,
    JointFit,
    RecordedRun,
    RunFit,
    UnknownRow,
    Verdict,
    picked,
    plain,
)
from proprio_ros.quantity import Z95, shown
from proprio_ros.schema import header, reason_codes

NOT_EMPTY = 5.0
"""Standard deviations of a mass in the hand beyond which runs that were stated to be empty are not believed."""


@dataclass(frozen=True)
class ExcitationPlan:
    """A run that has not been made."""

    joint: str  # to be driven
    start: Mapping[str, float]  # position of every joint before it [rad or m]
    current_A: float
    duration_s: float
    # `lift`, `lower` (gravity wins against the motor) or `driven` (motor and gravity pull together)
    kind: str
    travel: tuple[float, float]  # expected, smallest and largest over the masses asked for [rad]
    clearance_m: float  # lowest point of arm and hand above the base's plane during the run
    # expected standard deviation of each mass asked for; empty for a calibration run
    std_kg: tuple[float, ...] = ()
    reason: str = ""  # why this run, in a sentence

    def as_json(self) -> dict[str, Any]:
        known = picked(
            self,
            "joint",
            "start",
            "current_A",
            "duration_s",
            "kind",
            "clearance_m",
            "reason",
        )
        return plain(
            {
                **known,
                "travel_rad": self.travel,
                **(picked(self, "std_kg") if self.std_kg else {}),
            }
        )


@dataclass(frozen=True)
class HeldOutRun:
    """One run as predicted by all others."""

    name: str
    joint: str
    rms: float  # of measured less predicted [rad]
    # of the same under the covariance of the prediction; 1 is as good as promised
    reduced_chi2: float

    def as_json(self) -> dict[str, Any]:
        return picked(self, "name", "joint", "rms", "reduced_chi2")


@dataclass(frozen=True)
class Weighable:
    """What a weighing with a calibration would give, were it made as well as this robot can."""

    mass_kg: float  # of the object
    std_kg: float  # expected, of its mass
    joints: tuple[str, ...]  # that would be driven, each both ways where it can be
    # empty where they are driven one at a time; else, of a motion of all of them, what limits it
    in_motion: str = ""

    def sentence(self) -> str:
        """The headline of a calibration."""
        mass = shown("kg", self.mass_kg, spec=".0f")
        half = shown("kg", Z95 * self.std_kg, spec=".1f")
        how = (
            f"in motion; {self.in_motion}"
            if self.in_motion
            else f"with {' and '.join(self.joints)}"
        )
        return f"weighs {mass} to +-{half} (95 %) {how}"

    def as_json(self) -> dict[str, Any]:
        return {
            **picked(self, "mass_kg", "std_kg", "joints"),
            "half_width95_kg": Z95 * self.std_kg,
        }


@dataclass(frozen=True)
class EmptyHand:
    """What the runs that were stated to be empty say about the hand, were it not."""

    mass_kg: float  # with which in the hand they would fit best
    std_kg: float

    @property
    def pull(self) -> float:
        """Standard deviations from nothing."""
        return self.mass_kg / self.std_kg

    @property
    def unnoticed_kg(self) -> float:
        """A mass in the hand up to which the runs would have been believed."""
        return NOT_EMPTY * self.std_kg

    @property
    def _said(self) -> str:
        return f"{1e3 * self.mass_kg:.1f} +- {shown('kg', self.std_kg, spec='.1f')}"

    def sentence(self) -> str:
        """What a mass that nobody knew of would have done."""
        unnoticed = (
            f"up to {shown('kg', self.unnoticed_kg, spec='.0f')} in it would not have been refused"
        )
        return f"by the runs themselves it held {self._said}: {unnoticed}, and every weighing would read that much less"

    def contradiction(self) -> str:
        """What is wrong where the runs do not look like those of an empty hand."""
        if self.mass_kg > 0.0:
            return f"the empty-hand runs look as if the hand held {self._said}: empty it and record them again"
        question = "does the robot file describe this arm, and is the reference's mass right?"
        return f"the empty-hand runs look as if {self._said} hung at the hand: {question}"

    def as_json(self) -> dict[str, Any]:
        return picked(self, "mass_kg", "std_kg", "unnoticed_kg")


@dataclass(frozen=True)
class EmptyHandEstimate:
    """A motion with an empty hand, weighed by the calibration of the others."""

    name: str  # of the motion, or of the half of one
    mass_kg: float  # that came out
    std_kg: float
    quantile: float  # half width of a 95 % interval in standard deviations

    @property
    def half_width(self) -> float:
        """Of the 95 % interval [kg]."""
        return self.quantile * self.std_kg

    def as_json(self) -> dict[str, Any]:
        return {
            **picked(self, "name", "mass_kg"),
            "half_width95_kg": self.half_width,
        }


@dataclass(frozen=True)
class CalibrationEstimate:
    """The result of one calibration; of motions ``calibration`` is None, and what they say in ``motion`` or ``joint``."""

    robot: str
    verdict: Verdict
    reasons: tuple[str, ...]
    runs: int  # how many were given
    calibration: Calibration | None  # what is known now; None where the runs do not determine it
    fit: Fit | None = None
    run_fits: tuple[RunFit, ...] = ()  # the runs that were used
    unused: tuple[RecordedRun, ...] = ()  # the others
    # every shared unknown, robot file's word against posterior
    unknowns: tuple[UnknownRow, ...] = ()
    held_out: tuple[HeldOutRun, ...] = ()  # one entry per run used
    not_separated: tuple[str, ...] = ()  # sentences on what these runs leave open
    advice: tuple[ExcitationPlan, ...] = ()  # the runs that would help most, best first
    notes: tuple[str, ...] = ()
    # what can be weighed with it; None where that was not asked for, or nothing can
    weighable: Weighable | None = None
    # what the runs say of how empty it was; None where no empty run moved it
    empty_hand: EmptyHand | None = None
    motion: MotionCalibration | None = None
    joint: JointCalibration | None = None  # of motions of one joint with known loads
    joint_fits: tuple[JointFit, ...] = ()  # of motions, where runs have `run_fits`
    # each motion by the others: nothing, or the known load
    weighed_empty: tuple[EmptyHandEstimate, ...] = ()
    timing_s: dict[str, float] = field(default_factory=dict)
    # bags, references, file written, as `as_json` gives them
    origin: dict[str, Any] = field(default_factory=dict)
    # with joints driven one way only; None where it was only brought up to date
    whole: Calibration | None = None
    # those joints, and whether upwards
    driven_one_way: Mapping[str, bool] = field(default_factory=dict)

    @property
    def used(self) -> int:
        """How many of the runs, or of the motions, were used."""
        learnt = self.motion or self.joint
        return len(self.run_fits) if learnt is None else len(learnt.runs)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers; what is not a number is null."""
        calibration = self.calibration
        motion = self.motion
        joint = self.joint
        record = {
            **header("calibration"),
            "bags": [],
            "references": [],
            "calibration": None,
            **self.origin,
        }
        record |= picked(self, "robot", "runs", "verdict", "reasons")
        record |= {
            "reason_codes": reason_codes(self.reasons),
            "can_weigh": self.weighable,
        }
        rows = [
            picked(
                row,
                "name",
                "value",
                "std",
                "unit",
                "prior",
                "prior_std",
            )
            for row in self.unknowns
        ]
        record |= {
            "empty_hand": self.empty_hand,
            "unknowns": rows,
            "noise": None,
            **picked(self, "fit", "held_out"),
        }
        if calibration is not None:
            units = {
                "torque_disturbance": "_N_m",
                "start_velocity": "_rad_s",
            }
            noise = picked(
                calibration,
                "residual_scale",
                "stamp_jitter_s",
                "onset_jitter_s",
                *units,
            )
            record["noise"] = {name + units.get(name, ""): std for name, std in noise.items()}
        if motion is not None:
            record["motion"] = {
                **picked(
                    motion,
                    "stretches",
                    "torque_scale",
                    "torque_scale_std",
                    "arm_over_urdf",
                    "runs",
                ),
                "residual_N_m": dict(
                    zip(
                        motion.joints,
                        motion.residual.tolist(),
                        strict=True,
                    )
                ),
                "weighed_empty": self.weighed_empty,
            }
        if joint is not None:
            record["one_joint"] = {
                **picked(joint, "joint", "spread", "runs"),
                "residual_N_m": joint.residual,
            }
        return plain(
            {
                **record,
                **picked(
                    self,
                    "not_separated",
                    "advice",
                    "notes",
                    "timing_s",
                ),
            }
        )
