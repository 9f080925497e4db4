"""What a fit of runs says about the mass in the hand: its interval, what speaks against it, and what is assumed."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.identification import gates, sentences
from proprio_ros.identification.chance import chi2_limit
from proprio_ros.identification.conclude import Conclusion, stated_in
from proprio_ros.identification.estimate import (
    WIDEST_FLOOR_KG,
    WIDEST_SHARE,
    SolverSummary,
    Value,
    Verdict,
    WidthLimit,
)
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    fit_opened,
    known_exactly,
    solve_load,
    summary,
)
from proprio_ros.identification.judge import (
    Guess,
    Refusal,
    not_identifiable,
    positive,
    rejected,
)
from proprio_ros.identification.mistakes import Mistake, of_held, of_joint
from proprio_ros.identification.position_steps import driven_jump
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.prepared_runs import PreparedRun, joints_of, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.unknowns import Role
from proprio_ros.kinds import name_of
from proprio_ros.quantity import Z95, shown
from proprio_ros.sim.payload import PayloadFacts

COM = tuple(f"payload_com_{axis}" for axis in "xyz")
ALIKE_KG, ALIKE_SHARE = 5e-4, 0.05
"""Masses that differ by less, or by this share, do not contradict each other: what a model misses of torque and friction goes with
the mass, by 1 to 2 % in each run. Half of the difference then counts as uncertainty."""
# How far off the centre of mass may be, per axis, where nobody stated it: standard deviation.
GUESSED_PLACE_M = 5e-3
# A guess that is worth less than this share of the standard deviation is not worth a sentence.
DECIDES = 0.1
CAUSE_RATIO, BETTER = 10.0, 3.0
"""A mistake is named where undoing it makes the reduced chi-square so many times smaller; and so many times, where only then it is
no larger than chance makes it."""
AS_WELL, MEASURED = 4.0, 0.02
"""A fit whose chi-square is larger by less explains a recording as well as another; a torque constant that is known better than so,
relative, has been measured."""
LEAN_RAD = 0.02
"""So far elsewhere a zero may be unseen, as by a base that was tilted by a degree: said where it matters."""
OPEN_FILE = "what it leaves open was fitted under its priors"


@dataclass(frozen=True)
class WeighingOptions(SearchOptions):
    """How to solve; an answer whose half width exceeds this share of the value, and this mass, is ``too_wide``."""

    wide_share: float = WIDEST_SHARE
    wide_floor_kg: float = WIDEST_FLOOR_KG


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
        sticks = gates.stood_still(self.robot, fit.problem, fit.values, self.still, mass)
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
