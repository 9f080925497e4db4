"""What a reader is told: a function for each reason that the core finds, from what it is about and its numbers to a sentence.

Who decides (`gates`, `judge`, `conclude`, `stamps`, calibrations) asks here for the words. No number is computed here.
"""

from __future__ import annotations

from collections.abc import Sequence

from proprio_ros.identification.reasons import Reason
from proprio_ros.quantity import shown

_BUSY = "a computer that is busy elsewhere"
_AGAIN = "keep it free and record again"
MOVED_BEFORE = (
    "as if the joint had moved before the command, or the command were stamped late or early"
)
"""What a start velocity means that no rest has."""


# ------------------------------------------------------------------------------------------------------------- A run by itself


def few_samples(used: int, why: str) -> Reason:
    """Too little of a run is usable; ``why``: what ended it."""
    return Reason("few_samples", f"only {used} usable samples, because {why}")


def position_jumps(sentence: str) -> Reason:
    """Of a jump that is described already: which joint, by how much, when."""
    question = "did its encoder slip, or was its zero set meanwhile? Record again"
    return Reason("position_jumps", f"{sentence}: {question}")


def stuck(
    joint: str, travel_rad: float, least_rad: float, instead: tuple[str, float] | None
) -> Reason:
    """A driven joint hardly moved.

    Args:
        joint: The driven one.
        travel_rad: How far it moved.
        least_rad: How far it should at least.
        instead: Another joint that moved meanwhile, and how far [rad]; None: none did.
    """
    why = "so friction and not the weight decides where it is"
    if instead is not None:
        other, span_rad = instead
        why = (
            f"while {other} moved {span_rad:.2f} rad: are the columns of the two joints exchanged, or was the command for another "
            "joint? If not"
        )
    cure = f"probe with more current or from a pose that leaves at least {least_rad} rad of travel"
    return Reason("stuck", f"{joint} moved only {travel_rad:.3f} rad, {why}: {cure}")


def left_out_samples(run: str, why: str, count: int) -> Reason:
    """Samples at the end of a run are not used.

    Args:
        run: Its name.
        why: They are not used.
        count: How many.
    """
    return Reason("left_out_samples", f"{why}; {count} later samples were left out", run)


def short_travel(run: str, joint: str, travel_rad: float, least_rad: float) -> Reason:
    """A joint moved, but less than a narrow interval needs.

    Args:
        run: Its name.
        joint: The driven one.
        travel_rad: How far it moved.
        least_rad: How far it should at least.
    """
    cure = f"a probe with at least {least_rad} rad gives a much narrower interval"
    moved = f"{joint} moved only {travel_rad:.2f} rad in the samples used"
    return Reason("short_travel", f"{moved}: {cure}", run)


def starts_at_limit(run: str, joint: str, at_rad: float) -> Reason:
    """A joint starts at its stop.

    Args:
        run: Its name.
        joint: The driven one.
        at_rad: Where it starts.
    """
    stop = "where the stop may carry part of the weight: start away from it"
    return Reason("starts_at_limit", f"{joint} starts at its limit ({at_rad:.3f} rad), {stop}", run)


def current_above_limit(run: str, joint: str, current_A: float, allowed_A: float) -> Reason:
    """More was commanded than a motor lets flow.

    Args:
        run: Its name.
        joint: The driven one.
        current_A: Largest that was commanded.
        allowed_A: By the robot file.
    """
    given = (
        f"{shown('A', current_A)} were commanded, but {joint} is limited to {shown('A', allowed_A)}"
    )
    cure = "probe below the limit, or correct current_limit_A in the robot file"
    return Reason(
        "current_above_limit", f"{given}, so less flowed than the input says: {cure}", run
    )


def held_joint_moved(run: str, joint: str, span_rad: float) -> Reason:
    """A joint that was to be held yields.

    Args:
        run: Its name.
        joint: The held one.
        span_rad: How far it moved.
    """
    return Reason(
        "held_joint_moved", f"{joint} should be held but moved by {span_rad:.3f} rad", run
    )


def stood_still(run: str, joint: str, current_A: float, mass_kg: float, left_N_m: float) -> Reason:
    """A joint stood still where the answer says that it should have moved.

    Args:
        run: Its name.
        joint: The driven one.
        current_A: That drove it.
        mass_kg: In the hand, by the answer.
        left_N_m: What that leaves to move the joint.
    """
    stood = f"{run}: {joint} stood still with {shown('A', current_A)}"
    left = f"{shown('kg', mass_kg)} would leave {shown('N m', left_N_m)} to move it"
    why = "more than its friction can hold: it sticks, or leans on something"
    return Reason("stood_still", f"{stood}, where {left}, {why}")


def paused(run: str, longest_s: float) -> Reason:
    """Joint states of a run paused, at most for ``longest_s`` [s]."""
    pause = f"{run}: the joint states pause for {1e3 * longest_s:.0f} ms"
    return Reason("paused", f"{pause}: {_BUSY} pushes and holds an arm too late; {_AGAIN}")


def uneven(run: str, every_s: float, scatter_s: float) -> Reason:
    """Joint states come unevenly.

    Args:
        run: Its name.
        every_s: Usual step between two.
        scatter_s: Standard deviation of the steps.
    """
    come = f"come every {1e3 * every_s:.0f} ms and scatter by {1e3 * scatter_s:.1f} ms"
    why = f"{_BUSY} stamps positions when it did not read them"
    return Reason("uneven", f"{run}: the joint states {come}: {why}; {_AGAIN}")


def moved_before(run: str, joint: str, source: str, early_s: float) -> Reason:
    """A joint moves before the current that drives it.

    Args:
        run: Its name.
        joint: The driven one.
        source: Of the current.
        early_s: By how much, at least.
    """
    moves = (
        f"{joint} moves {1e3 * early_s:.0f} ms or more before the current that is said to drive it"
    )
    return _stamps_off(run, moves, source, "late", "early")


def driven_beyond(run: str, joint: str, source: str, late_s: float) -> Reason:
    """A joint is driven after its current ended.

    Args:
        run: Its name.
        joint: The driven one.
        source: Of the current.
        late_s: For how long, at least.
    """
    driven = (
        f"{joint} is still driven {1e3 * late_s:.0f} ms after the current is said to have ended"
    )
    return _stamps_off(run, driven, source, "early", "late")


def _stamps_off(run: str, seen: str, source: str, of_source: str, of_states: str) -> Reason:
    """Stamps of the current, or those of the joint states, are late or early, as is ``seen``."""
    question = f"are the stamps of {source} {of_source}, or those of the joint states {of_states}?"
    cure = "have both stamped by one clock, or state the true delay (robot.delay_s)"
    return Reason("stamps_off", f"{seen}: {question} {cure}", run)


# ---------------------------------------------------------------------------------------------------------- Runs beside each other


def never_reversed(joint: str, upwards: bool) -> Reason:
    """Of a joint that all runs drive the same way; ``upwards``: the positive one."""
    towards, back = ("positive", "negative") if upwards else ("negative", "positive")
    moved = f"{joint} only ever moved in the {towards} direction, so its friction was never seen reversed"
    cure = f"add a run in which it moves in the {back} direction"
    return Reason(
        "never_reversed", f"{moved} and cannot be separated from torque and weight: {cure}"
    )


def _both_say(unit: str, one: float, others: float) -> str:
    return f"it says {shown(unit, one, spec='.1f')}, they say {shown(unit, others, spec='.1f')}"


def runs_differ(run: str, unit: str, one: float, others: float) -> Reason:
    """A run says nearly what the others say.

    Args:
        run: Its name.
        unit: Of both values.
        one: What it says.
        others: What they say.
    """
    said = _both_say(unit, one, others)
    return Reason(
        "runs_differ",
        f"{run} differs from the other runs: {said}; the interval carries half of that",
    )


def runs_contradict(run: str, unit: str, one: float, others: float, question: str) -> Reason:
    """A run says another value than the others.

    Args:
        run: Its name.
        unit: Of both values.
        one: What it says.
        others: What they say.
        question: Put to the user.
    """
    said = _both_say(unit, one, others)
    return Reason("runs_contradict", f"{run} contradicts the other runs: {said}; {question}")


def left_out(names: Sequence[str], count: int, question: str) -> str:
    """Runs were left out, since they contradict the others.

    Args:
        names: Of those that were left out.
        count: Of all runs.
        question: Put to the user.
    """
    contradict, were = ("contradicts", "was") if len(names) == 1 else ("contradict", "were")
    out = f"{', '.join(names)} {contradict} the other runs and {were} left out ({len(names)} of {count})"
    return f"{out}: {question}"


# ------------------------------------------------------------------------------------------------------------------ A fit


def far_from_prior(name: str, came_out: str, pull: float, known: str, of_start: bool) -> str:
    """What an unknown says that ended far from its prior.

    Args:
        name: Of the unknown.
        came_out: Its value, with unit.
        pull: Standard deviations from its prior.
        known: The prior, with unit.
        of_start: Whether it is the velocity with which a run starts.
    """
    off = f"{pull:.1f} standard deviations from what was known"
    means = f", {MOVED_BEFORE}" if of_start else ""
    return f"{name} came out as {came_out}, {off} ({known}){means}"


def far_together(distance: float, directions: float) -> str:
    """The same of all that a calibration knows; ``distance`` in standard deviations, in so many directions that are determined."""
    plural = "s" * (round(directions) != 1)
    away = f"{distance:.1f} standard deviations from it in {directions:.0f} direction{plural}"
    return f"what the calibration knows ended {away} together"


def only_far(far: Sequence[str]) -> str:
    """That nothing nearer than these explains the recording."""
    return f"the simulation only follows the recording where {'; '.join(far)}: the model is wrong, or the file is"


def other_zero(joints: Sequence[str], off_rad: float, pull: float) -> Reason:
    """One of these joints is read from elsewhere.

    Args:
        joints: That cannot be told apart.
        off_rad: How far off the first one's zero seems.
        pull: The same in standard deviations.
    """
    names = " or ".join(joints)
    off = f"{names} is read as if its zero were {1e3 * off_rad:+.0f} mrad off what the calibration knows"
    question = "was it put together anew or read wrong, or does the base stand otherwise? If so, calibrate again"
    return Reason("other_zero", f"{off} ({pull:.1f} standard deviations): {question}")


def any_of(interval: str, limit: str, mostly: str, calibrated: bool) -> str:
    """That an interval is too wide.

    Args:
        interval: With its unit.
        limit: How wide it may be.
        mostly: What makes it wide; empty: not known.
        calibrated: Whether the robot is.
    """
    more = "calibrate the robot on empty-hand runs, or record more runs"
    if calibrated:
        more = "record more runs, with more travel"
    because = f", mostly because of {mostly}" if mostly else ""
    return f"anything from {interval} explains the recording, wider than {limit}{because}: {more}"


def guessed(listed: str, share: float | None, first_key: str) -> Reason:
    """Facts were guessed that decide the answer.

    Args:
        listed: What was taken for what.
        share: What that puts on the answer, as a share of it; None: the answer is nothing.
        first_key: The setting that states the first.
    """
    std = "" if share is None else f" (std {100.0 * share:.0f} %)"
    cure = f"state it with --set {first_key}=.."
    return Reason(
        "guessed_facts",
        f"guessed, not stated: {listed}; the interval carries that{std}: {cure}",
    )


def misfit_of_priors(value: str, beside: str, reduced_chi2: float) -> str:
    """The residuals are as expected, but unknowns are not.

    Args:
        value: Of the best simulation, with its unit.
        beside: Unknowns that are too far from what is known.
        reduced_chi2: Of the fit.
    """
    far = f"{beside} further from what is known about them than chance allows"
    chi2 = f"reduced chi-square {reduced_chi2:.1f}"
    return f"misfit: the simulation ({value}) only follows the recording with {far} ({chi2})"


def misfit_of_residuals(value: str, rms_rad: float, expected_rad: float, a_mass: bool) -> str:
    """The residuals are larger than the encoder's.

    Args:
        value: Of the best simulation, with its unit.
        rms_rad: Of the residuals.
        expected_rad: Of the encoder.
        a_mass: Whether the value is one.
    """
    misses = f"misses the recording by {1e3 * rms_rad:.2f} mrad rms where the encoder explains {1e3 * expected_rad:.2f} mrad"
    weighing = ", so its mass is no weighing" if a_mass else ""
    return f"misfit: the best simulation ({value}) {misses}{weighing}"


def coarse_fit(times: float, rms_rad: float) -> Reason:
    """Residuals are so many times the encoder's."""
    coarser = f"{times:.1f} times coarser than the encoder (rms {1e3 * rms_rad:.2f} mrad)"
    return Reason("coarse_fit", f"the fit is {coarser}: the interval was widened by that factor")


def starts_disagree(elsewhere: int, count: int, value: str) -> Reason:
    """Some starts ended elsewhere.

    Args:
        elsewhere: How many.
        count: Of all starts.
        value: What is searched for, in words.
    """
    ended = f"{elsewhere} of {count} starts of the search ended at another {value}"
    return Reason("starts_disagree", f"{ended} or in a worse fit; the best was taken")


def not_calibrated(stds_g: Sequence[tuple[str, float]]) -> Reason:
    """Of a whole robot, with what its file leaves open of the mass, by source [g]."""
    sentence = "the robot has not been calibrated: the interval carries what its file leaves open"
    if stds_g:
        sentence += f" (standard deviations: {', '.join(f'{s} {std:.1f} g' for s, std in stds_g)})"
    return Reason("not_calibrated", sentence)


def joints_not_calibrated(joints: Sequence[str]) -> Reason:
    """Of joints that a calibration does not know."""
    carries = "so the interval carries what the robot file leaves open of it"
    return Reason("not_calibrated", f"{', '.join(joints)} was not calibrated, {carries}")


def swing_missed(share: float) -> Reason:
    """That no swing of this joint explains the recording; ``share`` of its span by which the best one misses it (rms)."""
    missed = f"misfit: the best simulated swing misses the recorded one by {100.0 * share:.1f} % of its span (rms)"
    question = "does the joint hang free, was torque off all the time, and are the loads as stated?"
    return Reason("misfit", f"{missed}: {question}")


# --------------------------------------------------------------------------------------------------------------- A calibration


def drifted(what: str) -> Reason:
    """That a calibration no longer fits; ``what``: by how much."""
    sentence = f"the calibration no longer fits, not even with the drift that the robot file states ({what})"
    cure = "was the hand empty, and did anything touch the arm? If not, calibrate anew"
    return Reason("drift", f"{sentence}: {cure}")


def one_run(run: str) -> Reason:
    """A calibration rests on one run."""
    return Reason(
        "one_run", f"{run} is the only run, and nothing confirms it: add others, both ways"
    )


def none_separated() -> Reason:
    """No joint of a calibration was driven both ways."""
    none = "no joint was driven both ways, so torque and friction were not told apart"
    return Reason("not_separated", none)


def not_separated(joints: Sequence[str]) -> Reason:
    """These joints were driven one way only."""
    stays, its = ("stays", "it was") if len(joints) == 1 else ("stay", "they were")
    uncalibrated = f"{', '.join(joints)} {stays} uncalibrated"
    return Reason("not_separated", f"{uncalibrated}, because {its} driven one way only")


def frictions_differ(spread: float) -> Reason:
    """Friction differs by such a share between free responses."""
    differs = f"friction differs by {100 * spread:.0f} % from one to the next"
    agree = f"misfit: the swings only agree if {differs}"
    return Reason("misfit", f"{agree}: are the loads as stated, and is their inertia?")


def other_reference(off_kg: float, std_kg: float) -> Reason:
    """A reference weighs so much more than was stated [kg]."""
    by = f"{shown('kg', abs(off_kg), spec='.1f')} +- {shown('kg', std_kg, spec='.1f')}"
    less = "less" if off_kg < 0.0 else "more"
    weighs = f"by these runs your reference weighs {by} {less} than you stated"
    return Reason("far_from_prior", f"{weighs}: weigh it again, since every mass follows it")


def delay_on_bound(delay_s: float) -> Reason:
    """A delay ended on a bound of the search [s]."""
    ended = "the delay from a command's stamp to what the joint does ended on its bound"
    cure = "have commands and joint states stamped by one clock"
    return Reason("on_bound", f"{ended}, {shown('s', delay_s, spec='+.0f')}: {cure}")
