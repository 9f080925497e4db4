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
    other_suspects,
    source_label,
    unknown_rows,
    warn_if_uncalibrated,
)
from proprio_ros.identification.gates import MOVING_START, Contradiction, Findings, chance_limit
from proprio_ros.identification.posterior import Posterior, run_fits
from proprio_ros.identification.prepared_runs import PreparedRun, joints_of
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.stamps import stamps_off
from proprio_ros.kinds import label_of
from proprio_ros.quantity import Z95, shown, spec_for
from proprio_ros.robot import Robot

FAR = 5.0
"""Standard deviations of its prior beyond which an unknown says that the model is wrong, whatever the residuals say (DESIGN)."""
NAMED_AT_MOST = 3
PAUSE_S, PAUSE_STEPS = 0.03, 4.0
"""A gap between two samples that is longer than both is a pause; the second in usual steps of its recording."""
UNEVEN_S, UNEVEN_SHARE = 1e-3, 0.15
"""Steps that scatter by more than both are uneven; the second in usual steps of their run. At 1 rad/s a millisecond is an encoder's
count."""


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


def paused(runs: Sequence[PreparedRun]) -> list[Reason]:
    """What may be wrong with a recording that no model explains: whoever held the arm and recorded it was not always awake."""
    longest_s, where = 0.0, ""
    for prepared in runs:
        steps_s = np.diff(np.concatenate([prepared.run.before_times_s, prepared.run.times_s]))
        if len(steps_s) and max(longest_s, PAUSE_S, PAUSE_STEPS * float(np.median(steps_s))) < steps_s.max():
            longest_s, where = float(steps_s.max()), prepared.run.name
    if not where:
        return []
    return [
        Reason(
            "paused",
            f"{where}: the joint states pause for {1e3 * longest_s:.0f} ms: a computer that is busy elsewhere pushes and holds an "
            "arm too late; keep it free and record again",
        )
    ]


def uneven(runs: Sequence[PreparedRun]) -> list[Reason]:
    """What else may be wrong with it: stamps that are not when the positions were read, which shows in their steps."""
    widest_s, every_s, where = 0.0, 0.0, ""
    for prepared in runs:
        steps_s = np.diff(prepared.run.times_s)
        usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        if len(steps_s) and steps_s.std() > max(widest_s, UNEVEN_S, UNEVEN_SHARE * usual_s):
            widest_s, every_s, where = float(steps_s.std()), usual_s, prepared.run.name
    if not where:
        return []
    return [
        Reason(
            "uneven",
            f"{where}: the joint states come every {1e3 * every_s:.0f} ms and scatter by {1e3 * widest_s:.1f} ms: a computer that "
            "is busy elsewhere stamps positions when it did not read them; keep it free and record again",
        )
    ]


def contradicted(apart: Contradiction | None) -> Iterable[Refusal]:
    """A refusal where runs say different values."""
    if apart is not None and apart.half is None:
        yield rejected("runs_contradict", "the runs contradict each other", apart.sentence)


@dataclass(frozen=True)
class Useful:
    """From when on an interval is too wide for an accepted answer: both must be exceeded by its half width, cut off at nothing.

    Attributes:
        share: of the value.
        floor: in its unit; what is nearly nothing has no share to speak of.
    """

    share: float
    floor: float = 0.0

    def exceeded_by(self, value: float, std: float) -> bool:
        """Whether the 95 % interval of a quantity that is not negative is too wide."""
        low, high = max(value - Z95 * std, 0.0), max(value + Z95 * std, 0.0)
        return 0.5 * (high - low) > max(self.share * max(value, 0.0), self.floor)


@dataclass(frozen=True)
class Guess:
    """A fact that the user did not state and that decides the answer.

    Attributes:
        key: that states it, such as ``block.size``.
        taken: the value it was taken to have, in words.
        spread: how far off that may be, in words.
        std: what that puts on the answer, in its unit.
    """

    key: str
    taken: str
    spread: str
    std: float


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

    def far_from_priors(self, robot: Robot) -> list[str]:
        """Which unknowns ended further from their priors than a right model takes them, the furthest first.

        A run's start velocity has a prior worth the name only from a calibration; without one it is far where the joint clearly
        moved. What a calibration left correlated is looked at together, too.
        """
        far: dict[str, tuple[float, str]] = {}
        for fit in (self.opened, self.fit):
            for row in unknown_rows(fit, self.covariance):
                pull = row.pull
                guessed = row.kind == "v0" and robot.calibration is None and abs(row.value) < MOVING_START
                if pull is None or abs(pull) <= FAR or guessed:
                    continue
                known = shown(row.unit, row.prior, row.prior_std, between=" +- ")
                far[row.name] = (
                    abs(pull),
                    f"{row.name} came out as {shown(row.unit, row.value)}, {abs(pull):.1f} standard deviations from what was known "
                    f"({known})",
                )
        sentences = [sentence for _, sentence in sorted(far.values(), reverse=True)[:NAMED_AT_MOST]]
        return sentences or self._far_together()

    def _far_together(self) -> list[str]:
        problem = self.opened.problem
        calibration = problem.robot.calibration
        if calibration is None:
            return []
        keys = set(calibration.keys)
        own = [column for column, row in enumerate(problem.free) if problem.unknowns[row].key in keys]
        block = np.ix_(own, own)
        precision = problem.coordinates.prior_precision[block]
        off = self.opened.values[problem.free[own]] - problem.coordinates.prior_mean[own]
        # with a right model, the distance squared is on average the number of directions that the recording has determined
        learnt = max(len(own) - float(np.sum(precision * self.posterior.covariance[block])), 1.0)
        distance2 = float(off @ precision @ off)
        if distance2 <= chance_limit(learnt, FAR):
            return []
        return [
            f"what the calibration knows ended {np.sqrt(distance2):.1f} standard deviations from it in {learnt:.0f} "
            f"direction{'s' * (round(learnt) != 1)} together"
        ]

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
    useful: Useful | None = None,
    guesses: Sequence[Guess] = (),
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
        useful: how wide an accepted answer's interval may be; default any.
        guesses: facts that were not stated; what they put on the answer is in ``assessed`` already.
    """
    fit = assessed.fit
    withheld = ""
    verdict = Verdict.ACCEPTED
    refusal = next(iter(refusals), None)
    far = assessed.far_from_priors(robot) if np.isfinite(fit.chi2) else []
    if far and (refusal is None or refusal.verdict is Verdict.NOT_IDENTIFIABLE):
        suspects = other_suspects(robot)
        refusal = rejected(
            "far_from_prior",
            "the model only explains the recording far from what is known",
            f"the simulation only follows the recording where {'; '.join(far)}: the model is wrong, or the file is",
            *suspects,
        )
    elif far and refusal is not None:
        refusal = Refusal(
            refusal.verdict,
            refusal.withheld,
            (*refusal.reasons, Reason("far_from_prior", f"moreover, {'; '.join(far)}")),
        )
    if np.isfinite(fit.chi2) and (off := stamps_off(robot, fit)):
        before = () if refusal is None else refusal.reasons
        refusal = Refusal(Verdict.REJECTED, "the input is not stamped as the joint moved", (*off, *before))
    if refusal is not None:
        verdict = refusal.verdict
        withheld = refusal.withheld
        found.reasons[:0] = refusal.reasons
        if verdict is Verdict.REJECTED:
            found.reasons += paused(assessed.runs) or uneven(assessed.runs)
    else:
        value, std = assessed.value, assessed.std
        name, unit = assessed.name, fit.problem.unknowns[assessed.row].unit
        if useful is not None and useful.exceeded_by(value, std):
            verdict = Verdict.TOO_WIDE
            calibrated = robot.is_calibrated(joints_of(assessed.runs))
            found.reasons.insert(0, _too_wide(unit, value, std, useful, budget, calibrated))
        if guesses:
            found.reasons.append(_guessed(guesses, value))
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
        elsewhere = len(solver.paths) - solver.starts_agreeing
        if elsewhere:
            found.reasons.append(
                Reason(
                    "starts_disagree",
                    f"{elsewhere} of {len(solver.paths)} starts of the search ended at another {label_of(name)} or in a worse fit; "
                    "the best was taken",
                )
            )
        warn_if_uncalibrated(robot, assessed.runs, open_drive_train, found)
    return Estimate(
        probe=probe,
        robot=robot.name,
        verdict=verdict,
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
        assumptions=(*assumptions, *(f"guessed, not stated: {guess.key} {guess.taken}" for guess in guesses)),
        notes=tuple(found.notes),
    )


def _too_wide(
    unit: str, value: float, std: float, useful: Useful, budget: Sequence[tuple[str, float]], calibrated: bool
) -> Reason:
    spec = spec_for(unit, std)
    interval = shown(unit, max(value - Z95 * std, 0.0), max(value + Z95 * std, 0.0), spec=spec)
    limit = f"+-{100.0 * useful.share:.0f} % of the value"
    if useful.floor:
        limit += f" and than +-{shown(unit, useful.floor, spec='.3g')}"
    return Reason(
        "too_wide",
        f"anything from {interval} explains the recording, wider than {limit}"
        + (f", mostly because of {source_label(budget[0][0])}" if budget else "")
        + (
            ": record more runs, with more travel"
            if calibrated
            else ": calibrate the robot on empty-hand runs, or record more runs"
        ),
    )


def _guessed(guesses: Sequence[Guess], value: float) -> Reason:
    off = float(np.sqrt(sum(guess.std**2 for guess in guesses)))
    listed = ", ".join(f"{guess.key} ({guess.taken}, counted as +- {guess.spread})" for guess in guesses)
    first = guesses[0].key
    share = f" ({100.0 * off / value:.0f} % standard deviation)" if value > 0.0 else ""
    return Reason(
        "guessed_facts",
        f"guessed, since not stated: {listed}; the interval carries that{share}: state what is true of your object with "
        f"--set {first}=..",
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
