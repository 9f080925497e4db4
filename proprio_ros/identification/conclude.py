"""From a fit to the answer: what is the same for every probe, in one order, and where a probe says what only it knows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from proprio_ros.identification import sentences
from proprio_ros.identification.estimate import (
    Detail,
    Estimate,
    Fit,
    SolverSummary,
    Value,
    Verdict,
    WidthLimit,
)
from proprio_ros.identification.fit import (
    FitResult,
    other_suspects,
    rivals,
    uncalibrated,
    unknown_rows,
)
from proprio_ros.identification.gates import (
    MISFIT_LIMIT,
    Findings,
    RunComparison,
    contradicting,
)
from proprio_ros.identification.judge import (
    Assessment,
    Guess,
    Refusal,
    guessed,
    judge,
    not_identifiable,
    rejected,
    too_wide,
    unsteady,
)
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import joints_of
from proprio_ros.identification.run_scatter import (
    differs_more,
    followed,
    known_spread,
    least_steady,
)
from proprio_ros.kinds import label_of
from proprio_ros.quantity import Z95
from proprio_ros.robot import Robot

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(eq=False)
class Conclusion:
    """The answer that a fit gives; a probe's own class says what only it knows."""

    # the search from all starts, with the robot as its file or calibration states it
    nominal: FitResult
    opened: FitResult  # the fit in which all that is open moves; its covariance is given
    found: Findings  # on the way here
    run_count: int  # of all runs, the unusable ones included
    # before runs are compared, the worst first
    against: Sequence[Refusal] = field(default=(), kw_only=True)

    probe: ClassVar[str]
    name: ClassVar[str]  # of the unknown that the probe is for
    searched_for: ClassVar[str] = "mass"  # the same in a word
    # what to look at where nothing could be simulated
    check: ClassVar[str] = "check the robot file's inertias"
    # what else than that unknown may be the cause of a misfit
    beside: ClassVar[str] = "a robot or a start"
    # unknowns that an answer shows under another kind
    called: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def __post_init__(self) -> None:
        self.robot = self.opened.problem.robot
        self.runs = self.opened.problem.runs
        self.known = self.robot.is_calibrated(joints_of(self.runs))
        self.assessed = Assessment(self.fit, self.name, self.opened)
        # what each source puts on the value, the largest first
        self.budget = [
            (self.called.get(source, source), std) for source, std in self.assessed.budget()
        ]
        # found by `compare_runs`: which run contradicts the others, and what both say
        self.outlier: int | None = None
        self.comparison: RunComparison | None = None
        self.guesses: list[Guess] = []

    def values(self, withheld: str) -> tuple[Value, ...]:
        """What is stated."""
        raise NotImplementedError

    def assumptions(self) -> tuple[str, ...]:
        """What the answer rests on."""
        raise NotImplementedError

    def solver(self) -> SolverSummary:
        """What every start did."""
        raise NotImplementedError

    @property
    def fit(self) -> FitResult:
        """Whose values are given."""
        return self.opened

    def widen(self) -> None:
        """Count what only this probe is unsure of."""

    def comparable(self) -> bool:
        """Whether to ask if a run contradicts the others, which may take more fits."""
        return not self.fit.explains

    def unlike_others(self) -> int | None:
        """The run that contradicts the others; None: they agree."""
        return contradicting(Posterior(self.opened.problem, self.opened.values))

    @property
    def contradiction(self) -> RunComparison | None:
        """The comparison of a run that says another value than the others, as `compare_runs` found it; None: they agree."""
        found = self.comparison
        return found if found is not None and found.contradicts else None

    def fitted_with(self, robot: Robot, start: FitResult) -> FitResult:
        """The fit with torque that differs from run to run as it does of another robot, from where a fit has ended."""
        raise NotImplementedError

    def starts(self) -> Sequence[FitResult]:
        """Fits from which another is started, the one in which all that is open moves first."""
        return (self.opened,)

    def with_own_scatter(self) -> Self:
        """The same with torque that differs as these runs say, too; as it is where one contradicts the others."""
        spread = known_spread(self.robot, self.runs)
        if spread is None or self.against:
            return self
        self.compare_runs()
        if self.contradiction is not None:
            return self
        fits = []
        for start in self.starts():
            fits.append(followed(self.opened, spread, partial(self.fitted_with, start=start)))
        opened = least_steady(fits, spread)
        self.found.notes += differs_more(opened.problem.robot, spread)
        return replace(self, opened=opened)

    def compared_with_others(self, outlier: int) -> RunComparison:
        """What a run says that the others predict badly."""
        return RunComparison(f"{self.runs[outlier].run.name} contradicts the other runs")

    def guess(self) -> list[Guess]:
        """Facts that were not stated, and what that puts on the value."""
        return []

    def refusals(self) -> Iterator[Refusal]:
        """What else speaks against the answer, the worst first."""
        yield from self.misfit()

    def width_limit(self) -> WidthLimit | None:
        """How wide an accepted answer's interval may be; None: as wide as it is."""
        return None

    def remarks(self) -> Iterator[str]:
        """Reasons to look closer at an answer that is given."""
        yield from ()

    def detail(self, withheld: str) -> Detail | None:
        """What only this probe's answers have."""
        return None

    def misfit(
        self,
        suspects: Callable[[], Sequence[str]] = tuple,
    ) -> Iterator[Refusal]:
        """Where the model does not explain the recording; ``suspects`` may be why, default what the robot file leaves open."""
        if self.fit.reduced_chi2 > MISFIT_LIMIT:
            yield self.misfit_of(*(suspects() or other_suspects(self.robot)))

    def misfit_of(self, *suspects: str) -> Refusal:
        """Residuals larger than expected, or unknowns too far from their priors; and what may be the cause."""
        rms = self.assessed.rms
        expected = self.assessed.expected
        at = self.assessed.value
        unit = self.assessed.unit
        value = f"{1e3 * at:.1f} g" if unit == "kg" else f"{at:.3g} {unit}"
        if rms <= expected:
            sentence = sentences.misfit_of_priors(value, self.beside, self.fit.reduced_chi2)
        else:
            sentence = sentences.misfit_of_residuals(value, rms, expected, unit == "kg")
        return rejected(
            "misfit",
            "the model does not explain the recording",
            sentence,
            *suspects,
        )

    def lighter(
        self,
        thing: str,
        question: str,
        loaded: str = "",
    ) -> Iterator[Refusal]:
        """Where something is lighter than it was empty, to the end of its interval.

        Args:
            thing: What is lighter.
            question: Put to the user.
            loaded: How the thing is now, behind its name.
        """
        mass = self.assessed.value
        if mass + Z95 * self.assessed.std < 0.0:
            said = (
                f"{thing}{loaded} seems {-1e3 * mass:.1f} g lighter than it was empty: {question}"
            )
            yield rejected(
                "lighter_than_empty",
                f"{thing} seems lighter than empty",
                said,
            )

    def several(self, share: float, cure: str = "") -> Iterator[Refusal]:
        """Where other starts explain the recording as well, at masses that differ by more than ``share``."""
        mass = self.assessed.value
        others = rivals(
            self.fit,
            self.name,
            mass,
            self.assessed.std,
            share,
        )
        if others:
            several = "more than one mass explains the recording"
            masses = ", ".join(f"{1e3 * each:.1f} g" for each in sorted((mass, *others)))
            yield not_identifiable(
                "several_values",
                several,
                f"{several}: {masses}{cure}",
            )

    def count(self, std: float, source: str) -> None:
        """Widen the interval by an uncertainty of its own, and show it in the budget."""
        self.assessed.widen(std)
        self.budget = sorted(
            [*self.budget, (source, abs(std))],
            key=lambda entry: -entry[1],
        )

    def compare_runs(self) -> None:
        """Look for a run that says another value than the others: `outlier` and `comparison` are that run, where there is one."""
        if len(self.runs) < 2 or not np.isfinite(self.fit.chi2) or not self.comparable():
            return
        self.outlier = self.unlike_others()
        if self.outlier is not None:
            self.comparison = self.compared_with_others(self.outlier)

    def widen_by_comparison(self) -> None:
        """Count half of what a run and the others differ by, where that is too little for a contradiction."""
        if self.comparison is not None:
            self.assessed.widen(self.comparison.extra_std)

    def estimate(self) -> Estimate:
        """The answer: widened by what the probe is unsure of, by what runs say differently, and by what was guessed."""
        assessed = self.assessed
        self.widen()
        self.compare_runs()
        self.widen_by_comparison()
        self.guesses = self.guess() if np.isfinite(self.fit.chi2) else []
        for guess in self.guesses:
            self.count(guess.std, guess.source)
        solver = self.solver()
        refusal = judge(self._all_refusals(), assessed)
        reasons = [*refusal.reasons, *self.found.reasons]
        if refusal.verdict is Verdict.REJECTED:
            reasons += unsteady(self.runs)
        elif not refusal.withheld:
            reasons += self.cautions(solver)
        rows = unknown_rows(self.opened, assessed.covariance)
        return Estimate(
            self.probe,
            self.robot.name,
            refusal.verdict,
            tuple(reasons),
            self.values(refusal.withheld),
            Fit(
                assessed.rms,
                assessed.expected,
                self.fit.reduced_chi2,
                condition=assessed.posterior.condition,
            ),
            solver,
            self.run_count,
            assessed.run_fits,
            unknowns=tuple(replace(row, kind=self.called.get(row.kind, row.kind)) for row in rows),
            budget=tuple(self.budget),
            scanned=assessed.profile,
            detail=self.detail(refusal.withheld),
            assumptions=(
                *self.assumptions(),
                *(f"guessed, not stated: {g.key} {g.taken}" for g in self.guesses),
            ),
            notes=tuple(self.found.notes),
        )

    def _all_refusals(self) -> Iterator[Refusal]:
        if not np.isfinite(self.fit.chi2):
            unsimulated = f"no guess of the {self.searched_for} could be simulated"
            yield rejected(
                "unsimulated",
                unsimulated,
                f"{unsimulated}: {self.check}",
            )
        yield from self.against
        contradiction = self.contradiction
        if contradiction is not None:
            yield rejected(
                "runs_contradict",
                "the runs contradict each other",
                contradiction.sentence,
            )
        yield from self.refusals()
        width_limit = self.width_limit()
        if width_limit:
            yield from too_wide(self.assessed, width_limit, self.budget)

    def cautions(self, solver: SolverSummary) -> Iterator[str]:
        """Reasons to look closer at an answer that is given, those of every probe among them."""
        assessed = self.assessed
        if self.guesses:
            yield guessed(self.guesses, assessed.value)
        if self.comparison is not None and self.comparison.sentence:
            yield self.comparison.sentence
        if assessed.inflation > 1.0 and not self.fit.explains:
            yield sentences.coarse_fit(float(np.sqrt(assessed.inflation)), assessed.rms)
        yield from self.remarks()
        elsewhere = len(solver.paths) - solver.starts_agreeing
        if elsewhere:
            yield sentences.starts_disagree(elsewhere, len(solver.paths), label_of(self.name))
        sources = [] if assessed.unit != "kg" else self.budget
        sought = {guess.source for guess in self.guesses}
        yield from uncalibrated(
            self.robot,
            self.runs,
            [entry for entry in sources if entry[0] not in sought],
        )


def stated_in(robot: Robot) -> str:
    """For assumptions: which robot file, and whether it was calibrated."""
    return f"robot file {robot.source.name}, " + (
        "calibrated" if robot.is_calibrated() else "not calibrated"
    )
