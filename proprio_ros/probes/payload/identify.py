"""From runs to the mass of what the hand holds, with an interval and a verdict.

A calibrated robot is fitted once, from every start: everything about it moves under the calibration's correlated prior.

Without a calibration, every recording is fitted twice. In the *nominal* fit the robot is taken as its file states it, and only
the payload and each run's start move. In the *open* fit everything that the file leaves open (torque constant, friction, armature,
delay, joint zeros, the arm's masses) moves too, under its prior, so its covariance says what one recording can and cannot
separate. If the nominal fit explains the recording, its mass is the value: the recording gives no reason to leave the file's
numbers, and a single run would trade torque against friction at random. The interval is the open fit's, widened by the distance
of the two values. If the nominal fit does not explain the recording, value and interval are the open fit's. What neither explains
is rejected.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.identification import gates, sentences, swings
from proprio_ros.identification.chance import chi2_limit
from proprio_ros.identification.conclude import Conclusion, stated_in
from proprio_ros.identification.estimate import (
    WIDEST_FLOOR_KG,
    WIDEST_SHARE,
    Estimate,
    SolverSummary,
    Value,
    Verdict,
    WidthLimit,
    no_answer,
)
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    fit_both,
    fit_opened,
    known_exactly,
    solve_load,
    summary,
)
from proprio_ros.identification.judge import (
    FAR,
    Guess,
    Refusal,
    not_identifiable,
    positive,
    rejected,
)
from proprio_ros.identification.mistakes import Mistake, of_held, of_joint
from proprio_ros.identification.position_steps import driven_jump
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, joints_of, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import ZEROS_BESIDE
from proprio_ros.identification.run_kinds import FREE_SWING, ZERO_REPEATS, one_kind
from proprio_ros.identification.same_joint import (
    LIKELY_ANOTHER,
    TOGETHER,
    OtherJoint,
    compared,
    determined,
    mean_of,
    outside,
    refused,
)
from proprio_ros.identification.swing_friction import TERMS, own_friction, swing_starts
from proprio_ros.identification.unknowns import Role
from proprio_ros.kinds import name_of
from proprio_ros.probes.payload.narrowing import what_would_narrow
from proprio_ros.quantity import Z95, shown
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

COM = tuple(f"payload_com_{axis}" for axis in "xyz")
ALIKE_KG, ALIKE_SHARE = 5e-4, 0.05
"""Masses that differ by less, or by this share, do not contradict each other: what a model misses of torque and friction goes with
the mass, by 1 to 2 % in each run. Half of the difference then counts as uncertainty."""
# How far off the centre of mass may be, per axis, where nobody stated it: standard deviation.
GUESSED_PLACE_M = 5e-3
# A guess that is worth less than this share of the standard deviation is not worth a sentence.
DECIDES = 0.1
# How far from nothing an empty hand may weigh before the calibration is called out of date.
DRIFT_SIGMAS = 3.0

CAUSE_RATIO, BETTER = 10.0, 3.0
"""A mistake is named where undoing it makes the reduced chi-square so many times smaller; and so many times, where only then it is
no larger than chance makes it."""
AS_WELL, MEASURED = 4.0, 0.02
"""A fit whose chi-square is larger by less explains a recording as well as another; a torque constant that is known better than so,
relative, has been measured."""

GYRATION_M = 0.05
"""By what it is said how far a swing's answer leans on the payload's own inertia: a radius of gyration."""
LEAN_RAD = 0.02
"""So far elsewhere a zero may be unseen, as by a base that was tilted by a degree: said where it matters."""
ANY_ZERO_RAD = 0.3  # How far a horn may be put on elsewhere than it was: standard deviation.
# So many times better, and an open zero is believed; less, and the mass may be either.
BETTER_FOLLOWED = 1.5
SWING_ROUNDS = 4  # How often the error of a simulated swing is looked at again.
OPEN_FILE = "what it leaves open was fitted under its priors"


@dataclass(frozen=True)
class WeighingOptions(SearchOptions):
    """How to solve; an answer whose half width exceeds this share of the value, and this mass, is ``too_wide``."""

    wide_share: float = WIDEST_SHARE
    wide_floor_kg: float = WIDEST_FLOOR_KG


def weigh(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts | None = None,
    options: WeighingOptions | None = None,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """Identify the payload that all ``runs`` share.

    Of four runs or more of one recording, one in four at most is left out that contradicts the others, is not stamped as its joint
    moved, or begins otherwise than is known: a computer that is busy elsewhere pushes late now and then. What is left must agree.
    Another recording may be of another object.

    Args:
        robot: As its file or its calibration states it.
        runs: With the payload.
        facts: Of the payload; default a ball of unknown size at the payload frame.
        options: Of the solver.
        baseline: Runs with nothing in the hand, fitted together with the others; they show whether the robot has changed since its
            calibration.

    Raises:
        RecordingError: A run cannot be related to the robot at all (unknown joint, missing held joint).
    """
    return _leaving_runs_out(robot, runs, facts, options, baseline).estimate


def weigh_with_advice(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts,
    options: WeighingOptions,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """As `weigh`, with a note on what would narrow the interval, and to what.

    Args:
        robot: As its file or its calibration states it.
        runs: With the payload.
        facts: Of the payload.
        options: Of the solver.
        baseline: Runs with nothing in the hand.

    Raises:
        RecordingError: As `weigh` does.
    """
    answer = _leaving_runs_out(robot, runs, facts, options, baseline)
    estimate = answer.estimate
    if answer.weighed is None:
        return estimate
    advice = what_would_narrow(answer.weighed, estimate.verdict)
    return replace(estimate, notes=(*estimate.notes, *advice))


def _leaving_runs_out(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts | None,
    options: WeighingOptions | None,
    baseline: Sequence[Run],
) -> _Attempt:
    """What `weigh` answers, and from what."""
    facts = facts or PayloadFacts()
    options = options or WeighingOptions()
    kept = list(runs)
    left_out = list[str]()
    first = _attempt(robot, kept, facts, options, baseline)
    last = first
    recordings = {run.name.rpartition("#")[0] or run.name for run in runs}
    while len(recordings) == 1 and last.blocking_run is not None:
        if len(left_out) + 1 > gates.LEFT_OUT_AT_MOST * len(runs):
            break
        left_out.append(last.blocking_run.name)
        kept = [run for run in kept if run is not last.blocking_run]
        last = _attempt(robot, kept, facts, options, baseline)
    if last.estimate.verdict is Verdict.REJECTED:
        cause = () if first.weighed is None else first.weighed.cause
        said = replace(first.estimate, reasons=(*cause, *first.estimate.reasons))
        return replace(first, estimate=said)
    if not left_out:
        return last
    question = "was the object held as in the others, and nothing in the way?"
    reason = Reason("runs_differ", sentences.left_out(left_out, len(runs), question))
    estimate = replace(
        last.estimate,
        reasons=(*last.estimate.reasons, reason),
        runs=len(runs),
    )
    return replace(last, estimate=estimate)


@dataclass(frozen=True)
class _Attempt:
    """The answer from some runs."""

    estimate: Estimate
    weighed: Weighed | None = None  # what may tell the cause of a refusal
    blocking_run: Run | None = None  # the run that stands in its way, where there is one


@dataclass(frozen=True)
class _Usable:
    """Runs that a fit can use, those of the weighing before the empty hand's."""

    runs: list[PreparedRun]
    recorded: list[Run]  # what these were made from
    weighing: int  # how many of them are of the weighing
    still: list[PreparedRun]  # of no use, because their joint hardly moved


def _usable(
    robot: Robot,
    runs: Sequence[Run],
    baseline: Sequence[Run],
    facts: PayloadFacts,
    found: gates.Findings,
) -> _Usable:
    """The usable ones of all runs; ``found`` gets why others are not."""
    usable: list[PreparedRun] = []
    recorded: list[Run] = []
    still: list[PreparedRun] = []
    weighing = 0
    for number, run in enumerate((*runs, *baseline)):
        load = None if number < len(runs) else KnownLoad()
        prepared = prepare_run(robot, run, load, facts)
        if gates.admitted(robot, prepared, found):
            usable.append(prepared)
            recorded.append(run)
            weighing += load is None
        elif prepared.used >= gates.MIN_USED:
            still.append(prepared)
    return _Usable(_off_alike(usable), recorded, weighing, still)


def _off_alike(runs: Sequence[PreparedRun]) -> list[PreparedRun]:
    """Runs whose commands are as far off together as each of them is alone.

    What a motor delivers otherwise than its command says, it does in all pushes of a joint alike: more of them make it no smaller.
    """
    pushes = Counter(run.run.joint for run in runs)
    return [
        replace(run, current_torque_std=run.current_torque_std * np.sqrt(pushes[run.run.joint]))
        for run in runs
    ]


def _attempt(
    robot: Robot,
    runs: Sequence[Run],
    facts: PayloadFacts,
    options: WeighingOptions,
    baseline: Sequence[Run],
) -> _Attempt:
    found = gates.Findings()
    usable = _usable(robot, runs, baseline, facts, found)
    if not usable.weighing:
        return _Attempt(
            no_answer(
                "payload", "payload_mass", "kg", robot.name, len(runs), found.reasons, found.notes
            )
        )
    if one_kind(usable.runs) is FREE_SWING:
        estimate = _weigh_swings(
            robot,
            usable.runs,
            facts,
            options,
            found,
            len(runs),
        )
        return _Attempt(estimate)
    drift = _drift(
        robot,
        usable.runs[usable.weighing :],
        facts,
        options,
    )
    nominal, opened = _nominal_and_open(
        robot,
        usable.runs,
        facts,
        options,
    )
    open_file = not robot.is_calibrated() and not known_exactly(robot, usable.runs)
    if open_file and not nominal.explains and opened.chi2 < 0.5 * nominal.chi2:
        found.notes.append(
            "the robot file's own values do not explain the recording, so what the file leaves open was fitted too, under its "
            "priors"
        )
    weighed = Weighed(
        nominal,
        opened,
        found,
        len(runs),
        facts,
        options,
        usable.still,
        against=drift,
    ).with_own_scatter()
    estimate = weighed.estimate()
    if estimate.verdict is not Verdict.REJECTED:
        return _Attempt(estimate, weighed)
    return _Attempt(estimate, weighed, _blocking_run(weighed, estimate, usable))


def _nominal_and_open(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> tuple[FitResult, FitResult]:
    """The fit with the robot as it is stated, and the one in which all that is open moves."""
    known = robot.is_calibrated(joints_of(runs))

    def solve(role: Role, start: FitResult | None = None) -> FitResult:
        rough = known and role is Role.FIXED
        return solve_load(
            robot,
            runs,
            facts,
            options,
            role,
            start,
            rough=rough,
        )

    def again(nominal: FitResult, opened: FitResult) -> bool:
        return not (opened if known else nominal).explains

    return fit_both(solve, again)


def _blocking_run(weighed: Weighed, estimate: Estimate, usable: _Usable) -> Run | None:
    """The run of the weighing that stands in the way of an answer, where there is one.

    First one whose stamps are off, then the outlier, then the push with the strongest onset of its own. Scopes of unknowns count
    as `usable.runs` do.
    """
    off = {
        reason.subject
        for reason in estimate.reasons
        if isinstance(reason, Reason) and reason.code == "stamps_off"
    }
    rows = [row for row, run in enumerate(usable.runs) if run.run.name in off]
    if weighed.outlier is not None and weighed.contradiction is not None:
        rows.append(weighed.outlier)
    # a push that came late for a stall: only with another onset of its own is it followed
    own = [
        (abs(unknown.pull or 0.0), unknown.scope)
        for unknown in estimate.unknowns
        if isinstance(unknown.scope, int)
    ]
    rows += [row for pull, row in sorted(own, reverse=True) if pull > FAR]
    weighing = [row for row in rows if usable.runs[row].load is None]
    return usable.recorded[weighing[0]] if weighing else None


def _weigh_swings(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    options: WeighingOptions,
    found: gates.Findings,
    count: int,
) -> Estimate:
    """From free swings; those that are followed worse than the calibration's count for less."""
    options = replace(options, starts_kg=swing_starts(robot, runs[0], facts))
    searched, opened, misfit = _followed(robot, runs, facts, options)
    either_kg = 0.0
    if robot.is_calibrated(joints_of(runs)):
        # a swing shows its own zero: one that was put on anew may explain what nothing else does, or as well another mass
        joint = runs[0].run.joint
        drive = robot.drive_trains[joint]
        anew = replace(drive, zero=replace(drive.zero, std=ANY_ZERO_RAD / ZERO_REPEATS))
        elsewhere = replace(robot, drive_trains={**robot.drive_trains, joint: anew})
        again_searched, again, worse = _followed(
            elsewhere,
            runs,
            facts,
            options,
        )
        better = (
            opened.problem.robot.swing_error > BETTER_FOLLOWED * again.problem.robot.swing_error
        )
        if not worse and (misfit or better):
            searched = again_searched
            opened = again
            misfit = worse
            off = opened.value_of(("swing_zero", 0))
            found.notes.append(
                f"{joint} swings as if its zero were {off:+.3f} rad off what the file says: was the horn put on anew? The zero was "
                "fitted, too"
            )
        elif not worse:
            either_kg = again.value_of("payload_mass") - opened.value_of("payload_mass")
    other = _other_joint(opened, runs, facts, options)
    against = [] if other is None else list(_of_another_joint(robot, runs, other))
    if misfit:
        against.append(rejected("misfit", "the model does not explain the recording", misfit))
    if not robot.is_calibrated(joints_of(runs)) and not known_exactly(robot, runs):
        # all that moves may be lighter or heavier together: a ridge along which no interval around the best fit holds
        nothing = (
            "a free swing tells gravity moment over inertia, and nothing says what the rotor's inertia is: calibrate with swings "
            "of two known loads (calibrate --reference BAG=KG --reference BAG=KG)"
        )
        against.append(
            not_identifiable("not_calibrated", "a free swing alone does not tell a mass", nothing)
        )
    return WeighedSwings(
        searched,
        opened,
        found,
        count,
        facts,
        options,
        against=against,
        either_kg=either_kg,
        other=other,
    ).estimate()


def _other_joint(
    fit: FitResult, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> OtherJoint | None:
    """Whether swings are of another joint than the calibration's; None where it, or they, show no friction of their own."""
    robot = fit.problem.robot
    if robot.calibration is None or not robot.calibration.own_terms:
        return None
    now = mean_of([own_friction(robot, run.run, facts, options) for run in runs])
    if not determined(now):
        return None
    comparison = compared(robot.calibration.own_terms, now, TOGETHER)
    return OtherJoint.of(comparison, fit.value_of("payload_mass"), _known_kg(robot))


def _known_kg(robot: Robot) -> list[float]:
    """The loads of its calibration [kg]."""
    calibration = robot.calibration
    return [] if calibration is None else [float(run["load_kg"]) for run in calibration.runs]


def _of_another_joint(
    robot: Robot,
    runs: Sequence[PreparedRun],
    other: OtherJoint,
) -> Iterator[Refusal]:
    """Where that is too likely."""
    if robot.calibration is not None and other.probability > LIKELY_ANOTHER:
        yield refused(
            runs[0].run.joint,
            TERMS,
            other.comparison,
            robot.calibration.own_terms,
        )


def _followed(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> tuple[FitResult, FitResult, str]:
    """The first fit of swings, that with the error that they show, and why no swing of this robot explains them, or nothing."""
    known = robot.swing_error
    opened = searched = solve_load(robot, runs, facts, options, Role.ESTIMATED)
    for _ in range(SWING_ROUNDS):
        posterior = Posterior(opened.problem, opened.values)
        error = max(swings.swing_error(posterior), known)
        if error <= 1.05 * robot.swing_error:
            break
        robot = replace(robot, swing_error=error)
        runs = [prepare_run(robot, run.run, run.load, facts) for run in runs]
        opened = solve_load(
            robot,
            runs,
            facts,
            options,
            Role.ESTIMATED,
            start=opened,
        )
    misfit = ""
    share = swings.missed_share(posterior)
    if share > runs[0].kind.most_missed:
        misfit = sentences.swing_missed(share)
    elif known and error > swings.MUCH_WORSE * known:
        misfit = (
            f"misfit: the swing is followed {error / known:.1f} times worse than those of the calibration: is the joint free, was "
            "torque off all the time, and is the object's place and shape as stated?"
        )
    return searched, opened, misfit


def _drift(
    robot: Robot, baseline: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> list[Refusal]:
    """What an empty hand that does not weigh nothing says against the calibration."""
    if not baseline:
        return []
    runs = [replace(run, load=None) for run in baseline]
    # zeros that are elsewhere today are followed in what is weighed, too
    robot = replace(robot, zero_repeat=ZEROS_BESIDE * robot.zero_repeat)
    fit = fit_opened(partial(solve_load, robot, runs, facts, options))
    mass, std = fit.determined("payload_mass")
    since = "its calibration" if robot.is_calibrated() else "its robot file was written"
    if not fit.explains:
        drift = (
            f"drift: the empty-hand run is no longer explained by the robot as it was at {since} (reduced chi-square "
            f"{fit.reduced_chi2:.1f}): calibrate again"
        )
    elif abs(mass) > DRIFT_SIGMAS * std:
        drift = (
            f"drift: the empty hand now weighs {1e3 * mass:+.1f} g, where {1e3 * std:.1f} g is the standard deviation: the robot "
            f"has changed since {since}; calibrate again"
        )
    else:
        return []
    return [rejected("drift", "the robot has changed since its calibration", drift)]


@dataclass(eq=False)
class Weighed(Conclusion):
    """What a fit says about the mass in the hand; ``still`` are runs that are of no use because their joint hardly moved."""

    facts: PayloadFacts
    options: WeighingOptions
    still: Sequence[PreparedRun] = ()

    probe = "payload"
    name = "payload_mass"

    @property
    def fit(self) -> FitResult:
        """The nominal one where it explains what no calibration knows better."""
        if self.nominal.explains and not self.known:
            return self.nominal
        return self.opened

    def fitted_with(self, robot: Robot, start: FitResult) -> FitResult:
        return solve_load(
            robot,
            self.runs,
            self.facts,
            self.options,
            Role.ESTIMATED,
            start,
        )

    def widen(self) -> None:
        mass = self.assessed.value
        if not self.known:
            # the nominal mass may sit anywhere inside the open fit's interval: count how far
            self.assessed.widen(mass - float(self.opened.values[self.assessed.row]))
            # where the joint hardly moves, the balance of torques is all that was seen, and no linearisation about a creep holds
            self.assessed.widen(_static_std(self.fit.problem, self.runs))
        else:
            joint, off_kg = self.assessed.seeming_zero
            if joint:
                self.count(off_kg, name_of(("zero", joint)))

    def comparable(self) -> bool:
        return True

    def unlike_others(self) -> int | None:
        found = super().unlike_others()
        return (
            gates.of_another_value(self.assessed.posterior, self.name) if found is None else found
        )

    def compared_with_others(self, outlier: int) -> gates.RunComparison:
        mass = self.assessed.value
        name = self.runs[outlier].run.name
        if self.runs[outlier].load is not None:
            why = "the empty hand contradicts the other runs: was it empty, and has the robot changed meanwhile?"
            return gates.RunComparison(f"{name}: {why}")
        others = [run for row, run in enumerate(self.runs) if row != outlier]
        if all(run.load is not None for run in others):
            together = f"the empty-hand runs ({1e3 * mass:.1f} g together)"
            return gates.RunComparison(
                f"{name} contradicts {together}: has the robot changed meanwhile?"
            )
        # where they say the same, the run is coarser than the others, and the fit's residuals show by how much
        question = "was the same object held in the same place, and does the base stand as it did?"
        return gates.compare_run(
            name,
            "kg",
            self._mass_of([self.runs[outlier]]),
            self._mass_of(others),
            ALIKE_SHARE * abs(mass),
            ALIKE_KG,
            question,
        )

    def _mass_of(self, runs: Sequence[PreparedRun]) -> float:
        """What some of the runs say by themselves [kg]."""
        fit = fit_opened(partial(solve_load, self.robot, runs, self.facts, self.options))
        return fit.value_of(self.name)

    def guess(self) -> list[Guess]:
        """Where the centre of mass is, unless that was stated: on a wrist joint 5 mm are 4 % of the mass."""
        if not self.facts.com_guessed:
            return []
        shifts = self.assessed.posterior.follows(self.name, COM) * GUESSED_PLACE_M
        off = float(np.linalg.norm(shifts))
        if off < DECIDES * self.assessed.std:
            return []
        taken = f"[{', '.join(f'{1e3 * place:g}' for place in self.facts.com)}] mm"
        return [Guess("payload.com", taken, f"{1e3 * GUESSED_PLACE_M:g} mm per axis", off)]

    def refusals(self) -> Iterator[Refusal]:
        fit = self.fit
        mass = self.assessed.value
        unknown = self.fit.problem.unknowns[self.assessed.row]
        sticks = gates.stood_still(
            self.robot,
            fit.problem,
            fit.values,
            self.still,
            mass,
        )
        if sticks:
            yield rejected("stood_still", "a joint stood still that should have moved", sticks)
        if mass <= unknown.lower * (1.0 - 1e-6) or mass >= unknown.upper * (1.0 - 1e-6):
            bound = "the mass ended on a bound of the search"
            yield rejected(
                "on_bound",
                bound,
                f"{bound} ({mass:.3g} kg): is this the right robot, joint and unit of current?",
            )
        if not fit.explains:
            yield from self.unlike_pushes()
        yield from self.misfit()
        calibrate = (
            "has the robot changed since? calibrate it again"
            if self.known
            else "calibrate the robot"
        )
        yield from self.lighter("the hand", calibrate, " with its load")
        slow = [run for run in self.runs if abs(run.travel) < gates.LITTLE_TRAVEL]
        if fit is self.opened and not self.known and len(slow) == len(self.runs):
            yield not_identifiable(
                "short_travel",
                "too little travel to separate friction from weight",
                f"{slow[0].run.joint} moved only {abs(slow[0].travel):.2f} rad, too little to separate friction from weight: "
                "calibrate the robot on empty-hand runs, or probe with more current",
            )
        yield from self.several(0.02)

    def unlike_pushes(self) -> Iterator[Refusal]:
        """What a push does not do, where it explains a fit that does not explain its runs."""
        fit = self.fit
        posterior = Posterior(fit.problem, fit.values)
        jump = driven_jump(posterior, fit.chi2, chi2_limit(fit.dof))
        if jump:
            yield self.misfit_of(sentences.position_jumps(jump))
        moving = self._moving_starts()
        if moving:
            yield self.misfit_of(*moving)

    def _all_refusals(self) -> Iterator[Refusal]:
        """And what takes more fits: an interval that hardly reaches above nothing may lie elsewhere, not just be too wide."""
        highest = self.assessed.value + Z95 * self.assessed.std
        for refusal in super()._all_refusals():
            if refusal.verdict is Verdict.TOO_WIDE and highest < 2.0 * self.options.wide_floor_kg:
                yield from self.by_more_fits()
            yield refusal
        yield from self.by_more_fits()

    def by_more_fits(self) -> Iterator[Refusal]:
        """What other numbers of the file would explain."""
        if not self.fit.explains and self.cause:
            yield self.misfit_of()
        constants = [run.drive.torque_constant for run in self.runs]
        measured = all(each.std < MEASURED * each.value for each in constants)
        if self.known or measured:
            return
        # nothing but the file says what it is, and one run seldom does
        for words, fit in self._without(Mistake("half", 2.0), Mistake("twice", 0.5)):
            other = fit.value_of(self.name)
            mass = self.assessed.value
            elsewhere = abs(other - mass) > Z95 * self.assessed.std
            if elsewhere and fit.chi2 < self.fit.chi2 + AS_WELL:
                several = "more than one mass explains the recording"
                said = f"{1e3 * mass:.1f} g, or {1e3 * other:.1f} g if the torque constant of {', '.join(joints_of(self.runs))} is"
                cure = f"{words} what the robot file says, which nothing here tells: calibrate the robot"
                yield not_identifiable("several_values", several, f"{several}: {said} {cure}")

    @functools.cached_property
    def cause(self) -> tuple[Reason, ...]:
        """The one mistake in current or angles without which a fit explains runs that it does not with it."""
        # less than nothing is no payload, however well it explains: then what is the only one that does is named
        light = self.assessed.value + Z95 * self.assessed.std < 0.0
        # tens and hundreds are no unit of current, and another mass makes up for them
        factors = (1e-3, 1.0, 1e3) if light else (1e-3, 0.5, 1.0, 2.0, 1e3)
        mistakes = of_joint(", ".join(joints_of(self.runs)), "current", "fits")
        asked = [mistake for mistake in mistakes if abs(mistake.torque) in factors]
        if self.known:  # an arm that only its file describes may be off by as much
            asked += of_held([each.run for each in self.runs])
        tried = [(fit.reduced_chi2, fit.explains, words) for words, fit in self._without(*asked)]
        chi2, explains, words = min(tried, default=(np.inf, False, ""))
        only = light and len({said for _, explained, said in tried if explained}) == 1
        better = BETTER if explains and not self.opened.explains else CAUSE_RATIO
        if not only and better * chi2 > self.opened.reduced_chi2:
            return ()
        return (
            Reason("misfit", f"{words}: then a payload explains the recording, and now none does"),
        )

    def _without(self, *mistakes: Mistake) -> Iterator[tuple[str, FitResult]]:
        """What each mistake is called, and the fit without it where that is of a payload."""
        for mistake in mistakes:
            try:
                undone = [
                    prepare_run(self.robot, mistake.undone(each.run), each.load, self.facts)
                    for each in self.runs
                ]
                fit = fit_opened(partial(solve_load, self.robot, undone, self.facts, self.options))
            except (RecordingError, np.linalg.LinAlgError):
                continue
            highest = 0.99 * fit.problem.unknowns[self.assessed.row].upper
            if -self.options.wide_floor_kg < fit.value_of(self.name) < highest:
                yield mistake.words, fit

    def _moving_starts(self) -> list[str]:
        """A sentence for each run that fits far better if it did not start from rest."""
        # with the robot as its file states it: free friction can imitate a start velocity, and the other way round
        options = replace(self.options, solver="lm")
        moving = solve_load(
            self.robot, self.runs, self.facts, options, Role.FIXED, start_velocity_std=10.0
        )
        if not moving.chi2 < 0.5 * self.fit.chi2:
            return []
        mass = moving.value_of(self.name)
        rms = run_fits(moving.problem, moving.values, self.runs)[1]
        reasons = []
        for row, run in enumerate(self.runs):
            velocity = moving.value_of(("v0", row))
            if abs(velocity) > gates.MOVING_START:
                reasons.append(
                    f"start velocity: {run.run.name} fits better if {run.run.joint} already moves at {velocity:+.2f} rad/s when "
                    f"the current comes on (then {1e3 * mass:.0f} g, rms {1e3 * rms:.2f} mrad): a probe must start from rest"
                )
        return reasons

    def width_limit(self) -> WidthLimit:
        return WidthLimit(self.options.wide_share, self.options.wide_floor_kg)

    @property
    def leaning(self) -> tuple[str, float]:
        """The joint whose zero matters most, and what `LEAN_RAD` of it are [kg]; no joint where that stays within the interval."""
        joint, per_rad = max(
            self.assessed.leans.items(),
            key=lambda entry: abs(entry[1]),
            default=("", 0.0),
        )
        within = LEAN_RAD * abs(per_rad) < Z95 * self.assessed.std
        return ("", 0.0) if within else (joint, LEAN_RAD * per_rad)

    def if_zeros_moved(self) -> list[float]:
        """What the interval would be if the zero that matters most were `LEAN_RAD` elsewhere, to either side [kg]."""
        half = Z95 * self.assessed.std + abs(self.leaning[1])
        return [max(self.assessed.value - half, 0.0), max(self.assessed.value + half, 0.0)]

    def remarks(self) -> Iterator[str]:
        """How far an answer leans on zeros that one pose does not tell."""
        joint, more_kg = self.leaning
        if not joint:
            return
        more = shown("kg", more_kg, spec="+.1f")
        said = f"this pose does not tell the zero of {joint} from weight: {1e3 * LEAN_RAD:.0f} mrad more are {more}"
        counted = f"the interval counts {1e3 * self.assessed.zero_repeat:g} mrad (zero_repeat_rad)"
        ends = shown("kg", *self.if_zeros_moved(), spec=".1f", between=" to ")
        wide = f"with horns or base off by a degree it is {ends}"
        remedy = "an empty hand beside it (--baseline) tells"
        yield Reason("leans_on_zero", f"{said}; {counted}; {wide}; {remedy}")

    def cautions(self, solver: SolverSummary) -> Iterator[str]:
        yield from super().cautions(solver)
        if not self.known and not known_exactly(self.robot, self.runs):
            yield from gates.never_reversed(self.runs)

    def solver(self) -> SolverSummary:
        searched = self.opened
        if self.nominal.explains or len(self.opened.solution.cost) == 1:
            searched = self.nominal
        best = float(searched.physical(self.name)[searched.solution.best])
        # starts agree when they explain the recording alike, at masses that the interval cannot separate
        alike = max(1e-4, 0.01 * abs(best), 0.1 * self.assessed.std)
        made = searched.solution.iterations
        options = self.options
        return summary(
            searched, self.name, options.starts_kg, alike, made, options, margin=0.5, final=self.fit
        )

    def values(self, withheld: str) -> tuple[Value, ...]:
        problem = self.fit.problem
        mass = positive(
            self.name,
            "kg",
            self.assessed.value,
            self.assessed.std,
            withheld,
        )
        if mass.known and self.leaning[0]:
            mass = replace(mass, if_zeros_moved=self.if_zeros_moved())
        rows = [problem.index[axis] for axis in COM]
        if not any(problem.unknowns[row].std > 0.0 for row in rows):
            return (mass,)
        return mass, _centre_of_mass(self.fit, self.assessed.covariance, rows, withheld)

    def assumptions(self) -> tuple[str, ...]:
        facts = self.facts
        robot = self.robot
        options = self.options
        place = ", ".join(f"{1e3 * c:g}" for c in facts.com)
        if np.isfinite(self.fit.chi2) and not any(facts.com_std):
            per_m = self.assessed.posterior.follows(self.name, COM)
            off = 0.01 * float(np.linalg.norm(per_m))
            changes = f"; 1 cm elsewhere changes the mass by up to {shown('kg', off, spec='.2g')}"
        else:
            changes = ""
        size = " (size guessed, its uncertainty counted)" if facts.shape_std_relative > 0.0 else ""
        return (
            f"the payload is rigid, {facts.shape.description}{size}, its centre at [{place}] mm in {robot.payload_frame}{changes}",
            f"{self.about_runs()}; the held joints stand at their recorded mean",
            f"{stated_in(robot)}; {self.about_file()}",
            f"stamps keep time: a clock that runs 1 % fast or slow changes the mass by up to {self._by_clock()}",
            f"integrator {options.integrator}, steps of at most {1e3 * options.step_s:.3g} ms, "
            f"Coulomb's law smoothed over {robot.friction_velocity:g} rad/s",
        )

    def about_runs(self) -> str:
        """What is assumed of how they go."""
        return "each probe starts from rest"

    def about_file(self) -> str:
        """What is assumed of the robot file, and of how its base stands."""
        file = "its values stay where the file puts them" if self.fit is self.nominal else OPEN_FILE
        tilt = shown("kg", self._tilted(1.0), spec=".2g")
        return f"{file}; 1 degree of tilt of its base changes the mass by up to {tilt}"

    def _by_clock(self) -> str:
        """What it is worth that all stamps run one percent too fast or too slow."""
        if not np.isfinite(self.fit.chi2):
            return "an unknown amount"
        per_pace = self.assessed.posterior.follows_clock(self.name)
        return shown("kg", abs(0.01 * per_pace), spec=".2g")

    def _tilted(self, degrees: float) -> float:
        """What it is worth that gravity pulls from elsewhere about a driven joint, by the balance at rest of the worst run [kg]."""
        worst = 0.0
        for run in self.runs:
            if run.load is not None:
                continue
            per_kg = run.coefficients.per_kg(self.facts)
            _, cos, sin, _ = run.coefficients.arm + self.assessed.value * per_kg
            turned = run.weight_at_rest(np.array([0.0, sin, -cos, 0.0]))
            weight = run.weight_at_rest(per_kg) or np.inf
            worst = max(worst, abs(np.radians(degrees) * turned / weight))
        return worst


@dataclass(eq=False)
class WeighedSwings(Weighed):
    """What a fit of free swings says about the mass in the hand."""

    either_kg: float = 0.0  # how far off a mass is that explains them as well
    other: OtherJoint | None = None  # whether they are of another joint

    @property
    def fit(self) -> FitResult:
        return self.opened

    def widen(self) -> None:
        mass = self.assessed.value
        self.count(swings.FRICTION_LAW_SHARE * abs(mass), swings.FRICTION_LAW)
        self.count(self.either_kg, swings.HORN)
        if self.other is not None:
            self.count(self.other.share * abs(mass), swings.WHOSE)

    def unlike_others(self) -> int | None:
        return Conclusion.unlike_others(self)

    def refusals(self) -> Iterator[Refusal]:
        yield from super().refusals()
        if self.robot.calibration is not None:
            joint = self.runs[0].run.joint
            yield from outside(joint, self.assessed.value, _known_kg(self.robot))

    def unlike_pushes(self) -> Iterator[Refusal]:
        yield from ()

    def by_more_fits(self) -> Iterator[Refusal]:
        """A torque constant says nothing here."""
        yield from ()

    def about_runs(self) -> str:
        free = "friction differs from swing to swing, by one factor each"
        if self.known:
            free += "; the joint is that of the calibration, as far as friction shows it"
            if self.other is not None:
                free += f" (another one's with a probability of {100.0 * self.other.probability:.2g} %, which counts)"
            free += ", and arm and known loads are as stated: a shorter arm swings like a lighter load, and nothing here tells; so "
            free += f"with the payload's inertia, of which a radius of gyration of 5 cm is worth about {self._by_inertia()}"
        return free

    def about_file(self) -> str:
        return OPEN_FILE

    def _by_inertia(self) -> str:
        """What it is worth to a swing that the payload is no point about its centre.

        Its moment over all inertia stays, so the mass grows as the inertia that is not the payload's has to make up for.
        """
        run = self.runs[0]
        without = float(run.coefficients.arm[0]) + run.drive.armature.value
        more = (self.assessed.value * GYRATION_M) ** 2 / max(without, 1e-9)
        return shown("kg", more, spec=".0f")


def _centre_of_mass(
    fit: FitResult, covariance: np.ndarray, rows: list[int], withheld: str
) -> Value:
    """Each coordinate on its own: what the probe did not excite stays at its prior, and is not called an estimate."""
    values = fit.values[rows]
    stds = np.sqrt(np.diag(covariance)[rows])
    priors = np.array([fit.problem.unknowns[row].std for row in rows])
    silent = (priors > 0.0) & (stds > 0.7 * priors) | bool(withheld)
    intervals = np.stack(
        [values - Z95 * stds, values + Z95 * stds],
        axis=1,
    )
    value, std, interval = (
        [None if off else each for each, off in zip(of.tolist(), silent, strict=True)]
        for of in (values, stds, intervals)
    )
    unexcited = ", ".join(axis for axis, off in zip("xyz", silent, strict=True) if off)
    reason = f"{unexcited} not excited: the probe adds nothing to the prior" if unexcited else ""
    return Value("payload_com", "m", value, std, interval, withheld or reason)


def _static_std(problem: Problem, runs: Sequence[PreparedRun]) -> float:
    """What the open friction and torque constant are worth as a weight at rest [kg]; 0 if any run moved far enough."""
    if any(abs(run.travel) >= gates.LITTLE_TRAVEL for run in runs):
        return 0.0
    per_kg = [abs(run.weight_at_rest(run.coefficients.per_kg(problem.facts))) for run in runs]
    return min(
        float(np.hypot.reduce(run.torque_stds)) / max(w, 1e-9)
        for run, w in zip(runs, per_kg, strict=True)
    )


def scan_masses(mass: float) -> np.ndarray:
    """Masses worth looking at around a value: three orders of magnitude, and a fine stretch about it [kg], shape (M,)."""
    everywhere = np.geomspace(1e-3, 0.5, 60)
    about = max(mass, 1e-3) * np.linspace(0.5, 1.5, 41)
    return np.unique(np.concatenate([everywhere, about]))
