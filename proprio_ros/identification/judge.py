"""What a fit is worth: the interval, how it is widened, the verdict, and the answer that says all of it.

A probe looks at its fit from the worst that can be wrong with it to the least, and yields a `Refusal` for what it finds; the first
one counts. Everything else about an answer is the same for every probe, and is made here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.identification.estimate import (
    Detail,
    Estimate,
    Fit,
    Scan,
    SolverSummary,
    UnknownRow,
    Value,
    Verdict,
)
from proprio_ros.identification.fit import (
    FitResult,
    error_budget,
    misfit_profile,
    unknown_rows,
    warn_if_uncalibrated,
)
from proprio_ros.identification.gates import Contradiction, Findings
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.problem import PreparedRun
from proprio_ros.identification.reasons import Reason
from proprio_ros.quantity import Z95
from proprio_ros.robot import Robot


@dataclass(frozen=True)
class Refusal:
    """Why there is no value.

    Attributes:
        verdict: what that makes of the answer.
        withheld: in a few words, where the value would stand.
        reasons: in sentences, before whatever else was found.
    """

    verdict: Verdict
    withheld: str
    reasons: Sequence[str]


def rejected(code: str, withheld: str, sentence: str, *more: str) -> Refusal:
    """The model does not explain the recording; ``code`` is that of ``sentence`` (see ``reasons.CODES``)."""
    return Refusal(Verdict.REJECTED, withheld, (Reason(code, sentence), *more))


def not_identifiable(code: str, withheld: str, sentence: str) -> Refusal:
    """The recording does not determine the value."""
    return Refusal(Verdict.NOT_IDENTIFIABLE, withheld, (Reason(code, sentence),))


def contradicted(apart: Contradiction | None) -> Iterable[Refusal]:
    """A refusal where runs say different values."""
    if apart is not None and apart.half is None:
        yield rejected("runs_contradict", "the runs contradict each other", apart.sentence)


class Assessment:
    """A fit with what it is worth.

    Args:
        fit: whose values are given.
        name: of the unknown that the probe is for.
        runs: of the fit.
        known: whether the robot's calibration knows the joints that they drive: then the residuals are known, too, and only
            more than chance makes the interval wider.
        opened: whose covariance is given; default that of ``fit``.

    Attributes:
        run_fits, rms, expected: see ``run_fits``.
        inflation: factor on the encoder's variance.
        posterior: of ``opened``.
        covariance: of all unknowns, shape (N, N); ``widen`` adds to it.
    """

    def __init__(
        self, fit: FitResult, name: str, runs: Sequence[PreparedRun], known: bool, opened: FitResult | None = None
    ) -> None:
        self.fit, self.name, self.runs = fit, name, runs
        self.opened = opened or fit
        self.row = fit.problem.index[name]
        self.run_fits, self.rms, self.expected = run_fits(fit.problem, fit.values, runs)
        self.inflation = 1.0 if known and fit.explains else max(1.0, fit.reduced_chi2)
        self.posterior = Posterior(self.opened.problem, self.opened.values, self.inflation)
        self.covariance = self.posterior.whole_covariance()

    @property
    def value(self) -> float:
        """Of the unknown that the probe is for, in its unit."""
        return float(self.fit.values[self.row])

    @property
    def std(self) -> float:
        """Its standard deviation."""
        return float(np.sqrt(self.covariance[self.row, self.row]))

    def widen(self, by: float) -> None:
        """Count another uncertainty, independent of the others, as a standard deviation in the unknown's unit."""
        self.covariance[self.row, self.row] += by**2

    def budget(self) -> list[tuple[str, float]]:
        """Which source puts how much standard deviation on the unknown, as it stands now."""
        return error_budget(self.opened, self.covariance, self.name)

    def profile(self) -> Scan:
        """How much worse other values of the unknown explain the recording, everything else that is open fitted again."""
        return misfit_profile(self.opened, self.name, self.posterior, self.inflation, self.value, self.std)


def judge(
    robot: Robot,
    assessed: Assessment,
    refusals: Iterable[Refusal],
    found: Findings,
    *,
    probe: str,
    run_count: int,
    values: Callable[[str], tuple[Value, ...]],
    solver: SolverSummary,
    budget: Sequence[tuple[str, float]],
    assumptions: tuple[str, ...],
    apart: Contradiction | None = None,
    remarks: Callable[[], Sequence[str]] = tuple,
    open_drive_train: Sequence[tuple[str, float]] = (),
    unknowns: tuple[UnknownRow, ...] | None = None,
    detail: Callable[[str], Detail] | None = None,
) -> Estimate:
    """The answer.

    Args:
        robot: as it was identified with.
        assessed: the fit, and what is known after it.
        refusals: in order; only the first is taken, and what comes after it is not computed.
        found: on the way here.
        probe: its name.
        run_count: how many runs there were, the unusable ones included.
        values: made when the verdict is known, from the words where a value would stand (empty where it is given).
        solver: see ``Estimate``.
        budget: see ``Estimate``.
        assumptions: see ``Estimate``.
        apart: runs that say different values.
        remarks: reasons to look closer at an accepted answer.
        open_drive_train: what an uncalibrated robot puts on the value [kg], for a sentence.
        unknowns: default all of the fit.
        detail: made as ``values`` are.
    """
    fit = assessed.fit
    withheld = ""
    refusal = next(iter(refusals), None)
    if refusal is not None:
        withheld = refusal.withheld
        found.reasons[:0] = refusal.reasons
    else:
        if apart is not None and apart.sentence:
            found.reasons.append(apart.sentence)
        if assessed.inflation > 1.0 and not fit.explains:
            found.reasons.append(
                Reason(
                    "coarse_fit",
                    f"the fit is {np.sqrt(assessed.inflation):.1f} times coarser than the encoder (rms {1e3 * assessed.rms:.2f} "
                    "mrad): the interval was widened by that factor",
                )
            )
        found.reasons += remarks()
        warn_if_uncalibrated(robot, assessed.runs, open_drive_train, found)
    return Estimate(
        probe=probe,
        robot=robot.name,
        verdict=Verdict.ACCEPTED if refusal is None else refusal.verdict,
        reasons=tuple(found.reasons),
        values=values(withheld),
        fit=Fit(assessed.rms, assessed.expected, fit.reduced_chi2, condition=assessed.posterior.condition),
        solver=solver,
        runs=run_count,
        run_fits=assessed.run_fits,
        unknowns=unknown_rows(assessed.opened, assessed.covariance) if unknowns is None else unknowns,
        budget=tuple(budget),
        scan=assessed.profile(),
        detail=None if detail is None else detail(withheld),
        assumptions=assumptions,
        notes=tuple(found.notes),
    )


def positive(name: str, unit: str, value: float, std: float, withheld: str = "", highest: float = np.inf) -> Value:
    """A quantity that is not negative, with an interval that is not either: an empty hand reads 0.

    Args:
        name: of the quantity.
        unit: of value, std and highest.
        value: estimated; what is below 0 reads 0.
        std: of the estimate.
        withheld: why no number is given; empty where it is.
        highest: that it can have.
    """
    if withheld:
        return Value(name, unit, None, reason=withheld)
    interval = [max(value - Z95 * std, 0.0), min(max(value + Z95 * std, 0.0), highest)]
    return Value(name, unit, max(value, 0.0), std, interval)
