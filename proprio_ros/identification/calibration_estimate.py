"""The answer of a calibration: what is known about the robot now, how well it predicts runs, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.calibration_files.one_joint import JointCalibration
from proprio_ros.calibration_files.pushes import Calibration
from proprio_ros.identification.estimate import Fit, RecordedRun, RunFit, UnknownRow, Verdict, picked, plain
from proprio_ros.quantity import Z95, shown
from proprio_ros.schema import header, reason_codes

NOT_EMPTY = 5.0
"""Standard deviations of a mass in the hand beyond which runs that were stated to be empty are not believed."""


@dataclass(frozen=True)
class ExcitationPlan:
    """A run that has not been made.

    Attributes:
        joint: to be driven; current_A: by this, for duration_s.
        start: position of every joint before it [rad or m].
        kind: ``lift``, ``lower`` (gravity wins against the motor) or ``driven`` (motor and gravity pull together).
        travel: expected, smallest and largest over the masses asked for [rad].
        clearance_m: lowest point of arm and hand above the base's plane during the run.
        std_kg: expected standard deviation of each mass asked for; empty for a calibration run.
        reason: why this run, in a sentence.
    """

    joint: str
    start: Mapping[str, float]
    current_A: float
    duration_s: float
    kind: str
    travel: tuple[float, float]
    clearance_m: float
    std_kg: tuple[float, ...] = ()
    reason: str = ""

    def as_json(self) -> dict[str, Any]:
        known = picked(self, "joint", "start", "current_A", "duration_s", "kind", "clearance_m", "reason")
        return plain({**known, "travel_rad": self.travel, **(picked(self, "std_kg") if self.std_kg else {})})


@dataclass(frozen=True)
class HeldOutRun:
    """One run as predicted by all others.

    Attributes:
        rms: of measured less predicted [rad].
        reduced_chi2: of the same under the covariance of the prediction; 1 is as good as promised.
    """

    name: str
    joint: str
    rms: float
    reduced_chi2: float
    samples: int

    def as_json(self) -> dict[str, Any]:
        return picked(self, "name", "joint", "rms", "reduced_chi2")


@dataclass(frozen=True)
class Weighable:
    """What a weighing with a calibration would give, were it made as well as this robot can.

    Attributes:
        mass_kg: of the object; std_kg: expected standard deviation of its mass.
        joints: that would be driven, each both ways where it can be.
        in_motion: empty where they are driven one at a time; else, of a motion of all of them, what limits it.
    """

    mass_kg: float
    std_kg: float
    joints: tuple[str, ...]
    in_motion: str = ""

    def sentence(self) -> str:
        """The headline of a calibration."""
        mass, half = shown("kg", self.mass_kg, spec=".0f"), shown("kg", Z95 * self.std_kg, spec=".1f")
        if self.in_motion:
            return f"weighs {mass} to +-{half} (95 %) in motion; {self.in_motion}"
        return f"weighs {mass} to +-{half} (95 %) with {' and '.join(self.joints)}"

    def as_json(self) -> dict[str, Any]:
        return {**picked(self, "mass_kg", "std_kg", "joints"), "half_width95_kg": Z95 * self.std_kg}


@dataclass(frozen=True)
class EmptyHand:
    """What the runs that were stated to be empty say about the hand, were it not.

    Attributes:
        mass_kg: with which in the hand they would fit best; std_kg: standard deviation of it.
    """

    mass_kg: float
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
        unnoticed = shown("kg", self.unnoticed_kg, spec=".0f")
        return (
            f"by the runs themselves it held {self._said}: up to {unnoticed} in it would not have been refused, and every weighing "
            "would read that much less"
        )

    def contradiction(self) -> str:
        """What is wrong where the runs do not look like those of an empty hand."""
        if self.mass_kg > 0.0:
            return f"the empty-hand runs look as if the hand held {self._said}: empty it and record them again"
        return (
            f"the empty-hand runs look as if {self._said} hung at the hand: does the robot file describe this arm, and is the "
            "reference's mass right?"
        )

    def as_json(self) -> dict[str, Any]:
        return picked(self, "mass_kg", "std_kg", "unnoticed_kg")


@dataclass(frozen=True)
class EmptyHandEstimate:
    """A motion with an empty hand, weighed by the calibration of the others.

    Attributes:
        name: of the motion, or of the half of one.
        mass_kg: that came out; std_kg: its standard deviation.
        quantile: half width of a 95 % interval in standard deviations.
    """

    name: str
    mass_kg: float
    std_kg: float
    quantile: float

    @property
    def half_width(self) -> float:
        """Of the 95 % interval [kg]."""
        return self.quantile * self.std_kg

    def as_json(self) -> dict[str, Any]:
        return {**picked(self, "name", "mass_kg"), "half_width95_kg": self.half_width}


@dataclass(frozen=True)
class CalibrationEstimate:
    """The result of one calibration.

    Attributes:
        robot: its name.
        runs: how many were given; run_fits: those used, as recorded and as simulated; unused: the others.
        calibration: what is known now; None where the runs do not determine it.
        unknowns: every shared unknown, robot file's word against posterior.
        held_out: one entry per run used.
        not_separated: sentences on what these runs leave open.
        advice: the runs that would help most, best first.
        weighable: what can be weighed with it; None where that was not asked for, or nothing can.
        empty_hand: how far the runs themselves say that the hand was empty; None where no empty run moved it.
        motion: what motions say instead of runs; then ``calibration`` is None.
        joint: what motions of one joint with known loads say; then ``calibration`` is None, too.
        weighed_empty: of motions, what each weighs by the others, which should be nothing, or the known load.
        origin: bags, references, and the file that was written, as ``as_json`` gives them.
        whole: ``calibration`` with the joints that were driven one way only; None of one that was only brought up to date.
        driven_one_way: those joints, and whether upwards.
    """

    robot: str
    verdict: Verdict
    reasons: tuple[str, ...]
    runs: int
    calibration: Calibration | None
    fit: Fit | None = None
    run_fits: tuple[RunFit, ...] = ()
    unused: tuple[RecordedRun, ...] = ()
    unknowns: tuple[UnknownRow, ...] = ()
    held_out: tuple[HeldOutRun, ...] = ()
    not_separated: tuple[str, ...] = ()
    advice: tuple[ExcitationPlan, ...] = ()
    notes: tuple[str, ...] = ()
    weighable: Weighable | None = None
    empty_hand: EmptyHand | None = None
    motion: MotionCalibration | None = None
    joint: JointCalibration | None = None
    weighed_empty: tuple[EmptyHandEstimate, ...] = ()
    timing_s: dict[str, float] = field(default_factory=dict)
    origin: dict[str, Any] = field(default_factory=dict)
    whole: Calibration | None = None
    driven_one_way: Mapping[str, bool] = field(default_factory=dict)

    @property
    def used(self) -> int:
        """How many of the runs, or of the motions, were used."""
        learnt = self.motion or self.joint
        return len(self.run_fits) if learnt is None else len(learnt.runs)

    def as_json(self) -> dict[str, Any]:
        """Plain numbers; what is not a number is null."""
        calibration, motion, joint = self.calibration, self.motion, self.joint
        record: dict[str, Any] = {
            **header("calibration"),
            "bags": [],
            "references": [],
            "calibration": None,
            **self.origin,
            **picked(self, "robot", "runs", "verdict", "reasons"),
            "reason_codes": reason_codes(self.reasons),
            "can_weigh": self.weighable,
            "empty_hand": self.empty_hand,
            "unknowns": [picked(row, "name", "value", "std", "unit", "prior", "prior_std") for row in self.unknowns],
            "noise": None,
            **picked(self, "fit", "held_out"),
        }
        if calibration is not None:
            record["noise"] = {
                **picked(calibration, "residual_scale", "stamp_jitter_s"),
                "torque_disturbance_N_m": calibration.torque_disturbance,
                "start_velocity_rad_s": calibration.start_velocity,
            }
        if motion is not None:
            record["motion"] = {
                **picked(motion, "stretches", "torque_scale", "torque_scale_std", "arm_over_urdf", "runs"),
                "residual_N_m": dict(zip(motion.joints, motion.residual.tolist(), strict=True)),
                "weighed_empty": self.weighed_empty,
            }
        if joint is not None:
            record["one_joint"] = {**picked(joint, "joint", "spread", "runs"), "residual_N_m": joint.residual}
        return plain({**record, **picked(self, "not_separated", "advice", "notes", "timing_s")})
