"""By how much an arm's torques are off altogether, by weighing objects whose mass is known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.identification.judge import ACCEPTED, FAR, Refusal, not_identifiable, rejected
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.regression import refusals
from proprio_ros.identification.regression.error_budget import CALIBRATION
from proprio_ros.identification.regression.known_load import (
    ReferenceMotion,
    learnt_with,
)
from proprio_ros.identification.regression.motion_fit import (
    Centre,
    MotionFit,
    fit_payload,
    run_entry,
)
from proprio_ros.identification.regression.recording_variability import by_own_spread
from proprio_ros.quantity import Z95, shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot

LIGHT_REFERENCE = 0.45
"""A reference that is read with a greater relative half interval leaves torque constants as they are stated: a guess."""

Reference = tuple[Motion, float]  # A motion with a weighed object in the hand, and its mass [kg].


def scaled_by_references(
    robot: Robot,
    calibration: MotionCalibration,
    references: Sequence[Reference],
    centre: Centre | None,
) -> tuple[MotionCalibration, Refusal]:
    """The calibration with the torque scale that the references show, or why they do not show it.

    Args:
        robot: As its file states it.
        calibration: Of motions with an empty hand.
        references: At least one.
        centre: Of the objects, where that is stated.
    """
    open_scale = replace(calibration, torque_scale=1.0, torque_scale_std=0.0)
    readings = [
        _Reading(
            motion,
            mass_kg,
            fit_payload(robot, [motion], open_scale, centre=centre),
        )
        for motion, mass_kg in references
    ]
    ratios: list[_Ratio] = []
    coarse = ""
    # the best one first: one that is too coarse beside others says nothing, and does no harm
    for reading in sorted(readings, key=lambda each: each.std_kg / each.mass_kg):
        misplaced = next(
            _misplaced(robot, reading, open_scale, centre),
            None,
        )
        if misplaced is not None:
            return calibration, misplaced
        if reading.is_coarse and (ratios or coarse):
            continue
        doubt = next(reading.doubts(calibration.torque_scale_std), None)
        if doubt is not None:
            return calibration, doubt
        if reading.is_coarse:
            coarse = reading.too_coarse(place_is_stated=centre is not None)
        else:
            ratios.append(reading.ratio)
    # one that says nothing is no reason to stop: an answer is as uncertain as without it
    if not ratios:
        return calibration, replace(
            ACCEPTED,
            reasons=(Reason("says_too_little", coarse),),
        )
    differ, scale, variance = _mean_scale(ratios)
    stated = _stated_variance(scale, variance, calibration.torque_scale_std)
    scaled = replace(open_scale, torque_scale_std=float(np.sqrt(stated)))
    for reading in readings:
        if not reading.is_coarse:
            scaled = learnt_with(scaled, reading.known_load(differ))
    runs = [run_entry(motion, mass_kg) for motion, mass_kg in references]
    by_references = [by_own_spread(reading.fit.spread_evidence) for reading in readings]
    scaled = replace(
        scaled,
        runs=(*calibration.runs, *runs),
        spread_evidence=calibration.spread_evidence + np.sum(by_references, axis=0),
    )
    return scaled, ACCEPTED


@dataclass(frozen=True)
class _Ratio:
    """True torque over that of the stated constants."""

    value: float
    std: float
    shared: float = 0.0  # of that, by the calibration that all readings lean on


@dataclass(frozen=True)
class _Reading:
    """A reference, and what it is weighed to with torque constants as they are stated."""

    motion: Motion
    mass_kg: float  # its own
    fit: MotionFit

    @property
    def read_kg(self) -> float:
        return float(self.fit.values[0])

    @property
    def std_kg(self) -> float:
        return float(self.fit.std[0])

    @property
    def is_coarse(self) -> bool:
        """Whether it says too little about torque constants."""
        return self.read_kg <= 0.0 or self.fit.half_width > LIGHT_REFERENCE * self.mass_kg

    @property
    def ratio(self) -> _Ratio:
        read = self.read_kg
        std = self.std_kg
        # the reciprocal of what is uncertain is on average too large by its variance
        relative = self.mass_kg / read**2
        return _Ratio(
            self.mass_kg * read / (read**2 + std**2),
            relative * std,
            relative * self.fit.parts[CALIBRATION],
        )

    def known_load(self, differ: float) -> ReferenceMotion:
        """Of its own mass; ``differ``: by how much more known loads differ from each other than they say, as a ratio of squares."""
        fit = self.fit
        solution = fit.solution
        by_weights = solution.covariance[0] @ solution.information @ solution.covariance[0]
        # its stretches may scatter by more than the weights say
        noisier = float(solution.noise()[0, 0] / by_weights) * differ
        return ReferenceMotion(self.mass_kg, fit.problem, solution, fit.scatter, noisier)

    @property
    def words(self) -> str:
        """The beginning of a sentence about it."""
        stated, read, std = (
            shown("kg", kg, spec=".0f") for kg in (self.mass_kg, self.read_kg, self.std_kg)
        )
        return f"{self.motion.name}: the reference of {stated} is read as {read} +- {std}, "

    def doubts(self, scale_std: float) -> Iterator[Refusal]:
        """Where its mass is not that of the object, by torque constants that are known so well, relative."""
        read = self.read_kg
        std = self.std_kg
        if read + Z95 * std < 0.0:
            yield not_identifiable(
                "says_too_little",
                "the reference says nothing about the torque constants",
                f"{self.words}lighter than nothing: are the recordings mixed up?",
            )
        ratio = _Ratio(read / self.mass_kg, std / self.mass_kg) if self.is_coarse else self.ratio
        if abs(ratio.value - 1.0) > FAR * np.hypot(scale_std, ratio.std):
            yield rejected(
                "misfit",
                "the reference does not weigh what was stated",
                f"{self.words}and the torque constants are stated to {100.0 * scale_std:.0f} %: check the mass and "
                "the torque constants",
            )

    def too_coarse(self, place_is_stated: bool) -> str:
        """The sentence where it is."""
        check = ", and check payload.com" if place_is_stated else ""
        stay = "too coarse to tell the torque constants, which stay as stated"
        return f"{self.words}{stay}: take a heavier one, or move longer{check}"


def _misplaced(
    robot: Robot, reading: _Reading, calibration: MotionCalibration, centre: Centre | None
) -> Iterator[Refusal]:
    """Where positions are not those of the empty arm, or the object is not where it is stated to be."""
    name = reading.motion.name
    yield from refusals.other_zero(name, reading.fit)
    if centre is not None:
        free = fit_payload(robot, [reading.motion], calibration)
        yield from refusals.centre_elsewhere(name, centre, reading.fit, free)


def _mean_scale(ratios: Sequence[_Ratio]) -> tuple[float, float, float]:
    """By how much more ratios differ than they say, as a ratio of squares; their mean and its variance.

    The mean is by what each has of its own; of that its variance tells apart, of the calibration they do not. Where they differ by
    more than they say, what they have of their own counts as much as they differ (Birge 1932, Physical Review 40).
    """
    values = np.array([ratio.value for ratio in ratios])
    stds = np.array([ratio.std for ratio in ratios])
    shared = np.array([ratio.shared for ratio in ratios])
    weights = 1.0 / np.maximum(np.square(stds) - np.square(shared), 1e-4 * np.square(stds))
    scale = float(weights @ values / weights.sum())
    differ = max(1.0, float(weights @ np.square(values - scale)) / max(len(values) - 1, 1))
    in_common = float(weights @ shared / weights.sum())
    return differ, scale, differ / float(weights.sum()) + in_common**2


def _stated_variance(scale: float, variance: float, stated_std: float) -> float:
    """Of what a file states of the torque constants, as far as references, by their mean and variance, do not contradict it."""
    return float(max(stated_std**2, (scale - 1.0) ** 2 - variance))
