"""What the hand holds, from a motion of several joints under whatever controller, against the same arm with an empty hand.

What the empty arm does comes from motions that were recorded with the others, or from a calibration by such motions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import RecordingError, TooLittleMotion
from proprio_ros.identification.estimate import (
    WIDEST_SHARE,
    Estimate,
    Fit,
    JointFit,
    Value,
    Verdict,
    limit_by_goals,
    limit_in_motion,
)
from proprio_ros.identification.judge import (
    ACCEPTED,
    Refusal,
    judge,
    not_identifiable,
    positive,
    rejected,
)
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.regression import refusals
from proprio_ros.identification.regression.causes import with_cause
from proprio_ros.identification.regression.motion_equations import STRETCH_S, once_each
from proprio_ros.identification.regression.motion_estimate import calibration_refusals
from proprio_ros.identification.regression.motion_fit import (
    Centre,
    MotionFit,
    fit_empty,
    fit_payload,
)
from proprio_ros.identification.regression.motion_prior import relative_torque_std
from proprio_ros.identification.regression.narrowing import by_one_more
from proprio_ros.identification.regression.rigid_body import inertia_about_centre, nearest_body
from proprio_ros.identification.regression.time_axis import (
    with_read_time_axis,
    with_time_axes,
    with_time_axes_named,
)
from proprio_ros.identification.regression.trends import CHANGES, ROUNDS, Trend, without_trend
from proprio_ros.quantity import shown
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

# How far from nothing an empty hand may weigh before the calibration is called out of date.
DRIFT_SIGMAS = 3.0
UNTOLD = 0.98  # Of that spread: nothing at all was told.
SEEN_SHARE = 0.5  # Of the spread of any load's parameters: what is known no better is not seen.


@dataclass(frozen=True)
class MotionDetail:
    """What only an answer from a motion has."""

    stretches: int  # with the payload, that the interval was made from
    # of the ten inertial parameters, those that this motion does not determine
    unseen: tuple[str, ...]
    stretch_s: float = STRETCH_S  # their length [s]

    def as_json(self) -> dict[str, object]:
        return {
            "motion": {
                "stretches": self.stretches,
                "stretch_s": self.stretch_s,
                "undetermined": list(self.unseen),
            }
        }


def motion_answer(
    robot: Robot,
    motions: Sequence[Motion],
    refusal: Refusal,
    values: Sequence[Value],
    assumptions: tuple[str, ...],
    *,
    fit: Fit | None,
    budget: Sequence[tuple[str, float]],
    detail: MotionDetail | None,
    beside: Sequence[Motion] = (),
    notes: tuple[str, ...] = (),
    shown: tuple[JointFit, ...] = (),
) -> Estimate:
    """The answer of any regression.

    Args:
        robot: That moved.
        motions: With the payload.
        refusal: And its verdict.
        values: That are stated.
        assumptions: Which they rest on.
        fit: How well torques are explained; None where nothing was fitted.
        budget: Standard deviation that each source puts on the mass [kg].
        detail: What only motions have.
        beside: Motions of the empty hand, whose notes count, too.
        notes: Beside those of the motions.
        shown: Torques of each joint, for the page.
    """
    return Estimate(
        probe="payload",
        robot=robot.name,
        verdict=refusal.verdict,
        reasons=refusal.reasons,
        values=tuple(values),
        fit=fit,
        solver=None,
        runs=len(motions),
        joint_fits=shown,
        budget=tuple(sorted(budget, key=lambda part: -part[1])),
        detail=detail,
        assumptions=assumptions,
        notes=(*chain.from_iterable(motion.notes for motion in (*motions, *beside)), *notes),
    )


@once_each()
def identify_in_motion(
    robot: Robot,
    motions: Sequence[Motion],
    baseline: Sequence[Motion],
    facts: PayloadFacts,
    centre_is_stated: bool = False,
) -> Estimate:
    """Identify the payload that all ``motions`` share.

    Args:
        robot: As its file states it; the empty motions correct it.
        motions: With the payload, at least one.
        baseline: The same arm with an empty hand: what a calibration is made of, where the robot has none.
        facts: Where the payload's centre is, and how well that is known.
        centre_is_stated: Whether the user said so; else it is identified, too.

    Raises `RecordingError`: A motion is of no use.
    """
    everything = _of_measured_joints((*motions, *baseline))
    motions = everything[: len(motions)]
    baseline = everything[len(motions) :]
    with _naming_what_is_missing(everything):
        return _identified(robot, motions, baseline, facts, centre_is_stated)


def _of_measured_joints(motions: Sequence[Motion]) -> Sequence[Motion]:
    """The same without efforts of joints that one of them never measured: a joint is explained by all of them, or by none."""
    absent = {
        joint
        for motion in motions
        for joint, column in zip(motion.joints, motion.current_A.T, strict=True)
        if np.isnan(column).all()
    }
    if not absent:
        return motions
    found = []
    for motion in motions:
        current = motion.current_A.copy()
        current[:, np.isin(motion.joints, list(absent))] = np.nan
        found.append(replace(motion, current_A=current))
    return found


@contextmanager
def _naming_what_is_missing(motions: Sequence[Motion]) -> Iterator[None]:
    """Where too little is left of motions, what was left out stands before that."""
    try:
        yield
    except TooLittleMotion as error:
        left_out = [note for motion in motions for note in motion.left_out]
        if not left_out:
            raise
        raise TooLittleMotion(f"{left_out[0]}; {error}") from None


@dataclass(frozen=True)
class _Weighing:
    """Motions with a payload, and what the arm is known by."""

    motions: Sequence[Motion]
    baseline: Sequence[Motion]
    calibration: MotionCalibration
    known: str  # "calibration" or "baseline"
    centre: Centre | None  # of the payload, where it was stated

    def fitted(self, robot: Robot, motions: Sequence[Motion], *, stated: bool = True) -> MotionFit:
        """A fit of motions by what the arm is known by.

        Args:
            robot: As its file or its calibration states it.
            motions: With the payload.
            stated: Whether its centre is where it was stated; else it is looked for.
        """
        return fit_payload(
            robot,
            motions,
            self.calibration,
            empty=self.baseline if self.known == "calibration" else (),
            centre=self.centre if stated else None,
        )

    def arm_refusals(self, robot: Robot) -> Iterator[Refusal]:
        """What the empty hand's motions say against what the arm is known by."""
        if self.known == "baseline":
            yield from calibration_refusals(robot, self.baseline, self.calibration)
        elif self.baseline:
            fit = fit_payload(robot, self.baseline, self.calibration)
            yield from drift(float(fit.values[0]), float(fit.std[0]))


def _weighing(
    robot: Robot, motions: Sequence[Motion], baseline: Sequence[Motion], centre: Centre | None
) -> _Weighing | None:
    """By the robot's calibration or that of its baseline, with clocks followed; None where it has neither."""
    calibration = robot.motion_calibration
    known = "calibration"
    if calibration is not None:
        motions = with_time_axes(robot, motions, calibration, loaded=True)
        baseline = with_time_axes(robot, baseline, calibration)
    elif baseline:
        known = "baseline"
        baseline = with_time_axes(robot, baseline)
        calibration = with_read_time_axis(robot, baseline, fit_empty(robot, baseline))
        motions = with_time_axes(robot, motions, calibration, loaded=True)
    else:
        return None
    return _Weighing(motions, baseline, calibration, known, centre)


def _identified(
    robot: Robot,
    motions: Sequence[Motion],
    baseline: Sequence[Motion],
    facts: PayloadFacts,
    centre_is_stated: bool,
) -> Estimate:
    """As `identify_in_motion`, of joints whose efforts were measured."""
    centre = (np.asarray(facts.com), np.asarray(facts.com_std)) if centre_is_stated else None
    weighing = _weighing(robot, motions, baseline, centre)
    if weighing is None:
        return _of_an_unknown_arm(robot, motions)
    fit = weighing.fitted(robot, weighing.motions)
    trends = fit.trends
    followed, fit = _without_trends(robot, weighing.motions, fit, partial(weighing.fitted, robot))
    weighing = replace(weighing, motions=followed)
    refusal = judge(
        chain(
            weighing.arm_refusals(robot),
            _refusals(followed, fit, weighing.known),
            _too_wide(fit, followed[0].made_by_law),
        )
    )
    as_stamped = (motions, baseline)
    refusal, weighing = _with_what_explains_it(refusal, robot, weighing, as_stamped, fit, trends)
    mass = positive(
        "payload_mass",
        "kg",
        float(fit.values[0]),
        float(fit.std[0]),
        refusal.withheld,
        quantile=fit.quantile,
    )
    place = () if refusal.withheld or centre_is_stated else _place(fit)
    return motion_answer(
        robot,
        weighing.motions,
        refusal,
        (mass, *place),
        _assumptions(robot, weighing.motions, weighing.calibration, fit),
        fit=Fit(
            _rms(fit.residual),
            _rms(fit.empty_residual),
            fit.misfit,
            "N m",
        ),
        budget=list(fit.parts.items()),
        detail=MotionDetail(fit.stretches, fit.unseen()),
        beside=weighing.baseline,
        notes=(
            *refusals.moved_only_loaded(fit),
            *refusals.heard_late(fit),
            *refusals.passed_over(fit.joints, fit.tells, fit.unexplained, motions[0]),
            *(() if refusal.withheld else by_one_more(robot, weighing.calibration, fit)),
        ),
        shown=fit.shown,
    )


def _of_an_unknown_arm(robot: Robot, motions: Sequence[Motion]) -> Estimate:
    """The answer where nothing says what the arm itself weighs."""
    unknown = not_identifiable(
        "no_empty_motion",
        "nothing says what the arm itself weighs",
        "the arm moved under a controller, and a URDF alone puts an arm off by some percent of its own weight: record about "
        "the same motion with an empty hand and add it with --baseline, or calibrate with it (`proprio calibrate`)",
    )
    # what the recording contradicts would stand in the way of an empty hand's, too
    unknown = with_cause(unknown, robot, motions) or unknown
    nothing = [positive("payload_mass", "kg", 0.0, 0.0, unknown.withheld)]
    assumptions = _assumptions(robot, motions, None, None)
    return motion_answer(
        robot, motions, unknown, nothing, assumptions, fit=None, budget=(), detail=None
    )


def _with_what_explains_it(
    refusal: Refusal,
    robot: Robot,
    weighing: _Weighing,
    as_stamped: tuple[Sequence[Motion], Sequence[Motion]],
    fit: MotionFit,
    trends: Sequence[Trend],
) -> tuple[Refusal, _Weighing]:
    """The refusal with the first explanation that is found for it, and the motions that it speaks of.

    In this order: each motion by itself, what makes torques different or clocks run off, a trend, a payload that sits elsewhere.
    What looks for one returns the refusal with it, or None where it finds none.

    Args:
        refusal: Of all motions together; an accepted answer stays as it is.
        robot: As it was weighed with.
        weighing: What was fitted.
        as_stamped: Its motions and its baseline before clocks were followed.
        fit: Of the weighing.
        trends: Of its motions, before they were followed.
    """
    motions = weighing.motions
    known = weighing.known
    if refusal.verdict is Verdict.TOO_WIDE and motions[0].made_by_law:
        # all is explained but for goals that were late, which would be taken for something else here
        return refusal, weighing
    search = partial(weighing.fitted, robot, stated=False)
    apart = _each_by_itself(refusal, motions, search, known)
    if apart is not None:
        return apart, weighing
    unexplained = float(np.nan_to_num(fit.unexplained).max())
    by_mistake = with_cause(refusal, robot, *as_stamped, unexplained)
    if by_mistake is not None:
        # what explains the torques by their stamps bent the clock, too
        stamped, empty_stamped = as_stamped
        return by_mistake, replace(weighing, motions=stamped, baseline=empty_stamped)
    refusal = with_time_axes_named(refusal, (*motions, *weighing.baseline))
    by_trend = _with_trend(refusal, motions, trends)
    if by_trend is not None:
        return by_trend, weighing
    if weighing.centre is not None:
        elsewhere = _elsewhere(refusal, motions, weighing.centre, fit, search(motions), known)
        return elsewhere or refusal, weighing
    return refusal, weighing


def _without_trends(
    robot: Robot,
    motions: Sequence[Motion],
    fit: MotionFit,
    refit: Callable[[Sequence[Motion]], MotionFit],
) -> tuple[Sequence[Motion], MotionFit]:
    """The motions without what clearly changed along each of them, which is noted, and what they say.

    Args:
        robot: Whose torque constants the currents have.
        motions: With the payload.
        fit: Of these.
        refit: Makes another one.
    """
    clear = fit.trends
    if not any(trend.is_clear for trend in clear):
        return motions, fit
    trends = clear
    for _ in range(ROUNDS):
        found = [
            without_trend(robot, motion, trend, which)
            for motion, trend, which in zip(motions, trends, clear, strict=True)
        ]
        fit = refit(found)
        trends = tuple(old.plus(new) for old, new in zip(trends, fit.trends, strict=True))
    noted = [
        replace(motion, notes=(*motion.notes, f"{motion.name}: {trend.words()}; it was followed"))
        if trend.is_clear
        else motion
        for motion, trend in zip(found, clear, strict=True)
    ]
    # nobody knows when of it torques were those of the empty hand's motion
    torque = max(abs(trend.torque) if trend.torque_is_clear else 0.0 for trend in clear)
    off = 0.5 * torque * fit.values
    parts = {**fit.parts, CHANGES: float(abs(off[0]))}
    return noted, replace(
        fit,
        covariance=fit.covariance + np.outer(off, off),
        parts=parts,
    )


def _with_trend(
    refusal: Refusal,
    motions: Sequence[Motion],
    trends: Sequence[Trend],
) -> Refusal | None:
    """The refusal of a fit that does not explain its motions, with what changed along one of these; None where nothing did."""
    if refusal.verdict is not Verdict.REJECTED:
        return None
    for motion, trend in zip(motions, trends, strict=True):
        if trend.is_clear:
            reason = Reason("changed_along", f"{motion.name}: {trend.words()}")
            return replace(refusal, reasons=(reason, *refusal.reasons))
    return None


def _each_by_itself(
    refusal: Refusal,
    motions: Sequence[Motion],
    fitted: Callable[[Sequence[Motion]], MotionFit],
    known: str,
) -> Refusal | None:
    """The refusal of several motions together, with what each says alone; None where that is not explained.

    Args:
        refusal: Of all together.
        motions: With the payload.
        fitted: Makes the fit of some of them.
        known: What the arm is known by.
    """
    if len(motions) < 2 or refusal.verdict is not Verdict.REJECTED:
        return None
    try:
        alone = [fitted([motion]) for motion in motions]
        return _apart(refusal, motions, alone, known)
    except RecordingError:  # one is too short by itself
        return None


def _apart(
    refusal: Refusal, motions: Sequence[Motion], alone: Sequence[MotionFit], known: str
) -> Refusal | None:
    """The refusal, with what each motion says ``alone``; None where one is not explained by itself."""
    if any(
        judge(_refusals([motion], fit, known)) is not ACCEPTED
        for motion, fit in zip(motions, alone, strict=True)
    ):
        return None
    places = [_place(fit)[0].value for fit in alone]
    told = ", ".join(
        f"{motion.name} {shown('kg', float(fit.values[0]), spec='.0f')} at [{', '.join(f'{x:.3f}' for x in place)}] m"
        for motion, fit, place in zip(motions, alone, places, strict=True)
        if isinstance(place, list) and None not in place
    )
    said = f"each motion is explained by itself, and together they are not: {told}"
    cure = "was the same object held in the same place? Weigh them apart"
    return replace(
        refusal, reasons=(Reason("runs_contradict", f"{said}: {cure}"), *refusal.reasons)
    )


def _elsewhere(
    refusal: Refusal,
    motions: Sequence[Motion],
    stated: Centre,
    fit: MotionFit,
    free: MotionFit,
    known: str,
) -> Refusal | None:
    """The refusal, with what a fit that looks for the payload's centre says of the stated one; None where it explains no more."""
    place = _place(free)[0].value
    if (
        not isinstance(place, list)
        or None in place
        or judge(_refusals(motions, free, known)) is not ACCEPTED
    ):
        return None
    name = motions[0].name
    found: Refusal | None
    if refusal.verdict is Verdict.REJECTED:
        found = refusals.elsewhere(name, stated[0], np.asarray(place))
    else:
        found = next(refusals.centre_elsewhere(name, stated, fit, free), None)
    if found is None:
        return None
    return replace(found, reasons=(*found.reasons, *refusal.reasons))


def drift(mass: float, std: float) -> Iterator[Refusal]:
    """What an empty hand that weighs so much [kg], and not nothing, says about the calibration."""
    if abs(mass) > DRIFT_SIGMAS * std:
        yield rejected(
            "drift",
            "the robot has changed since its calibration",
            f"drift: the empty hand now weighs {shown('kg', mass, spec='+.0f')}, where {shown('kg', std, spec='.0f')} is the "
            "standard deviation: the robot has changed since its calibration; calibrate again",
        )


def _refusals(
    motions: Sequence[Motion],
    fit: MotionFit,
    known: str,
) -> Iterator[Refusal]:
    name = motions[0].name
    for motion, trend in zip(motions, fit.trends, strict=True):
        yield from refusals.changed_at_once(motion, trend)
    yield from refusals.other_zero(name, fit)
    yield from refusals.other_torque(motions[0], fit)
    yield from refusals.halves_disagree(name, fit)
    yield from refusals.joints_disagree(motions[0], fit)
    unexplained = refusals.deciding(fit.tells, fit.unexplained)
    yield from refusals.unexplained_torque(
        fit.joints,
        unexplained,
        "the arm, its friction and a payload",
        f"{name}: ",
        motions[0].made_of_goals,
    )
    yield from refusals.explained_worse(motions[0], fit)
    yield from refusals.unlike_urdf(fit.arm_over_urdf, motions[0])
    yield from refusals.far_from_prior(fit.arm, known)
    yield from refusals.lighter_than_empty(
        float(fit.values[0]), fit.half_width, "are the recordings mixed up?"
    )


def _louder(fit: MotionFit) -> str:
    """What it would do if all torques were read too large, and whether that would be noticed."""
    least = float(refusals.noticed(fit).min())
    much = shown("kg", 0.1 * fit.louder_kg, spec="+.0f")
    shows = (
        f"shows that from some {100.0 * least:.0f} % on"
        if np.isfinite(least)
        else "does not show that"
    )
    return f"torques are read as with the empty hand: were all 10 % larger, the mass would err by up to {much}; this motion {shows}"


def _too_wide(fit: MotionFit, by_goals: bool) -> Iterator[Refusal]:
    """Why an answer that nothing else speaks against is not accepted; ``by_goals``: whether its torques are made of goals."""
    width_limit = limit_in_motion(fit.arm_kg)
    cure = (
        f"move faster and through more attitudes of the hand, longer than the {STRETCH_S * fit.stretches:.0f} s used here, and "
        "record the empty hand in the same motion"
    )
    if by_goals:
        width_limit = limit_by_goals(fit.arm_kg)
        cure = "keep the computer that hands goals on free, weigh again, and calibrate with a reference as heavy as the load"
    return refusals.interval_too_wide(width_limit, float(fit.values[0]), fit.half_width, cure)


def _assumptions(
    robot: Robot,
    motions: Sequence[Motion],
    calibration: MotionCalibration | None,
    fit: MotionFit | None,
) -> tuple[str, ...]:
    known = (
        "together with the baseline's"
        if robot.motion_calibration is None
        else "under the calibration's"
    )
    stated = max(relative_torque_std(robot, joint) for joint in motions[0].joints)
    torque_std = stated if calibration is None else calibration.torque_scale_std
    referenced = calibration is not None and calibration.referenced
    return (
        f"several joints moved at once: the {motions[0].source} of {len(motions[0].joints)} joints and their positions were fitted "
        f"{known}, the arm's own inertia and friction included",
        f"torque constants as {'the reference showed them' if referenced else f'in {robot.source.name}'}, to "
        f"{100.0 * torque_std:.1f} %: a mass errs as they do",
        *(
            []
            if fit is None
            else [
                f"by its torques the arm weighs {refusals.times(fit.arm_over_urdf)} what its URDF says",
                _louder(fit),
            ]
        ),
        "friction is that of each recording: Coulomb, viscous, a share of the torque, and an offset per joint",
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def _place(fit: MotionFit) -> tuple[Value, Value]:
    """Centre of mass, and inertia about it, in the payload's frame, where the mass is known well enough to divide by."""
    mass = float(fit.values[0])
    std = fit.std
    nowhere = bool((std[1:4] > UNTOLD * fit.payload_prior[1:4]).all())  # an arm of slides alone
    if nowhere or abs(mass) < refusals.LEAST_SIGMAS * std[0] or mass <= 0.0:
        nothing = "too little is held to say "
        if nowhere:
            nothing = "the hand is never turned, which alone would say "
        return (
            Value(
                "payload_com",
                "m",
                [None] * 3,
                [None] * 3,
                [None] * 3,
                nothing + "where",
            ),
            Value(
                "payload_inertia",
                "kg m^2",
                [None] * 6,
                [None] * 6,
                [None] * 6,
                nothing + "how it is spread",
            ),
        )
    body = nearest_body(fit.values, fit.covariance)
    centre = body[1:4] / mass
    # of the quotient, to first order
    gradient = np.hstack([-centre[:, None], np.eye(3)]) / mass
    stds = np.sqrt(np.diag(gradient @ fit.covariance[:4, :4] @ gradient.T))
    bounds = [
        [float(c - fit.quantile * s), float(c + fit.quantile * s)]
        for c, s in zip(centre, stds, strict=True)
    ]
    return Value(
        "payload_com",
        "m",
        centre.tolist(),
        stds.tolist(),
        bounds,
    ), _inertia(fit, body)


def _inertia(fit: MotionFit, body: np.ndarray) -> Value:
    """About the centre of mass: xx, xy, xz, yy, yz, zz; None where the motion says little more than that mass does."""
    value, gradient = inertia_about_centre(body)
    stds = np.sqrt(np.diag(gradient @ fit.covariance @ gradient.T))
    # a moment of inertia is told as a mass is, to half of itself, and a product only means something beside its moments
    seen = stds < SEEN_SHARE * fit.payload_prior[4:]
    moments = [0, 3, 5]
    seen[moments] &= fit.quantile * stds[moments] < WIDEST_SHARE * value[moments]
    for product, one, other in ((1, 0, 3), (2, 0, 5), (4, 3, 5)):
        seen[product] &= seen[one] or seen[other]
    names = [
        name
        for name, told in zip(("xx", "xy", "xz", "yy", "yz", "zz"), seen, strict=True)
        if not told
    ]
    reason = ""
    if names:
        reason = f"{', '.join(names)} not determined by this motion: turn the hand faster about the axes that it is about"
    bounds = np.stack(
        [value - fit.quantile * stds, value + fit.quantile * stds],
        axis=1,
    )

    def told(values: np.ndarray) -> list[Any]:
        return [each if known else None for each, known in zip(values.tolist(), seen, strict=True)]

    return Value(
        "payload_inertia",
        "kg m^2",
        told(value),
        told(stds),
        told(bounds),
        reason,
    )
