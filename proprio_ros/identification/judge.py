"""What a fit is worth: the interval, how it is widened, and the verdict.

A probe looks at its fit from the worst that can be wrong with it to the least, and yields a `Refusal` for what it finds; the first
one counts. Calibrations and motions are judged by the same function.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from proprio_ros.identification import sentences
from proprio_ros.identification.chance import beyond_chance
from proprio_ros.identification.estimate import (
    Scan,
    Value,
    Verdict,
    WidthLimit,
    not_negative,
)
from proprio_ros.identification.fit import (
    FitResult,
    error_budget,
    misfit_profile,
    other_suspects,
    source_label,
    unknown_rows,
)
from proprio_ros.identification.gates import (
    MOVING_START,
)
from proprio_ros.identification.posterior import (
    Posterior,
    run_fits,
)
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    joints_of,
)
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import (
    zero_repeat_of,
)
from proprio_ros.identification.stamps import stamps_off
from proprio_ros.quantity import Z95, shown, spec_for

FAR = 5.0
"""Standard deviations of its prior beyond which an unknown says that the model is wrong, whatever the residuals say."""
NAMED_AT_MOST = 3
LEAST_LEARNT = 1e-4  # of a zero's variance: a recording that tells less of it tells nothing
ELSEWHERE = 4.0
"""Standard deviations that a zero may seem elsewhere; uneven stamps make three of them. 240 simulated pushes had 2.4 at most."""
SEEMS_ELSEWHERE = 2.5
"""From so many on, what it seems counts in the interval: 6 of 304 simulated pushes with zeros that repeat had more."""
ALIKE_PULL = 0.9
"""Joints whose axes are parallel turn the hand alike: those that are off by nearly as many standard deviations are named, too."""
PAUSE_S, PAUSE_STEPS = 0.03, 4.0
"""A gap between two samples that is longer than both is a pause; the second in usual steps of its recording."""
UNEVEN_S, UNEVEN_SHARE = 1e-3, 0.15
"""Steps that scatter by more than both are uneven; the second in usual steps of their run. At 1 rad/s a millisecond is an encoder's
count."""
Budget = Sequence[tuple[str, float]]
"""Sources of uncertainty, and the standard deviation that each puts on the value, in its unit; the largest first."""


@dataclass(frozen=True)
class Refusal:
    """Why an answer is not simply accepted."""

    verdict: Verdict  # what that makes of the answer
    # in a few words, where the value would stand; empty where the value is given nevertheless
    withheld: str
    reasons: tuple[str, ...]  # in sentences, before whatever else was found


ACCEPTED = Refusal(Verdict.ACCEPTED, "", ())  # nothing speaks against the answer


def rejected(code: str, withheld: str, sentence: str, *more: str) -> Refusal:
    """The model does not explain the recording.

    Args:
        code: Of the sentence (see ``reasons.CODES``).
        withheld: In a few words, where the value would stand.
        sentence: Why.
        more: Further sentences.
    """
    return Refusal(
        Verdict.REJECTED,
        withheld,
        (Reason(code, sentence), *more),
    )


def not_identifiable(code: str, withheld: str, sentence: str) -> Refusal:
    """The recording does not determine the value.

    Args:
        code: Of the sentence (see ``reasons.CODES``).
        withheld: In a few words, where the value would stand.
        sentence: Why.
    """
    return Refusal(
        Verdict.NOT_IDENTIFIABLE,
        withheld,
        (Reason(code, sentence),),
    )


def wide(width_limit: WidthLimit, sentence: str) -> Refusal:
    """The interval is wider than is useful: the value is given with its interval, or not stated at all."""
    if width_limit.verdict is Verdict.TOO_WIDE:
        return Refusal(
            Verdict.TOO_WIDE,
            "",
            (Reason("too_wide", sentence),),
        )
    return not_identifiable(
        "says_too_little",
        "the interval is too wide to state a mass",
        sentence,
    )


def unsteady(runs: Sequence[PreparedRun]) -> list[Reason]:
    """What may be wrong with a recording that no model explains: the computer that held the arm and recorded it was busy elsewhere.

    Then joint states pause, or come with stamps that are not when the positions were read, which shows in their steps.
    """
    pauses = []
    scatters = []
    for run in (prepared.run for prepared in runs):
        steps_s = np.diff(np.concatenate([run.before_times_s, run.times_s]))
        if len(steps_s) and steps_s.max() > max(PAUSE_S, PAUSE_STEPS * float(np.median(steps_s))):
            pauses.append((float(steps_s.max()), run.name))
        steps_s = np.diff(run.times_s)
        usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        if len(steps_s) and steps_s.std() > max(UNEVEN_S, UNEVEN_SHARE * usual_s):
            scatters.append((float(steps_s.std()), usual_s, run.name))
    if pauses:
        longest_s, name = max(pauses, key=lambda entry: entry[0])
        return [sentences.paused(name, longest_s)]
    if scatters:
        widest_s, every_s, name = max(scatters, key=lambda entry: entry[0])
        return [sentences.uneven(name, every_s, widest_s)]
    return []


@dataclass(frozen=True)
class Guess:
    """A fact that the user did not state and that decides the answer."""

    key: str  # that states it, such as `block.size`
    taken: str  # the value it was taken to have, in words
    spread: str  # how far off that may be, in words
    std: float  # what that puts on the answer, in its unit

    @property
    def source(self) -> str:
        """Of uncertainty, as a budget lists it."""
        return f"{self.key}, guessed"


class SeenZero(NamedTuple):
    """What a recording by itself says of the zero of a joint."""

    pull: float  # standard deviations by which it seems elsewhere than the calibration has it
    off_rad: float  # where it would be without a prior, less where the calibration has it
    joint: str


class Assessment:
    """A fit with what it is worth; ``name`` is the unknown that the probe is for, and the covariance that of ``opened``.

    Attributes:
        known: Whether the robot's calibration knows the joints that were driven: then the residuals are known, too, and only more
            than chance makes the interval wider.
        run_fits, rms, expected: See ``run_fits``.
        inflation: Factor on the encoder's variance.
        posterior: Of ``opened``.
        covariance: Of all unknowns, shape (N, N); ``widen`` adds to it.
    """

    def __init__(
        self,
        fit: FitResult,
        name: str,
        opened: FitResult | None = None,
    ) -> None:
        self.fit = fit
        self.name = name
        self.opened = opened or fit
        self.robot = fit.problem.robot
        self.runs = fit.problem.runs
        self.known = self.robot.is_calibrated(joints_of(self.runs))
        self.row = fit.problem.index[name]
        self.unit = fit.problem.unknowns[self.row].unit
        self.run_fits, self.rms, self.expected = run_fits(
            fit.problem,
            fit.values,
            self.runs,
        )
        self.inflation = 1.0 if self.known and fit.explains else max(1.0, fit.reduced_chi2)
        self.posterior = Posterior(
            self.opened.problem,
            self.opened.values,
            self.inflation,
        )
        self.covariance = self.posterior.whole_covariance()

    @property
    def value(self) -> float:
        """Of the unknown that the probe is for, in its unit."""
        return float(self.fit.values[self.row])

    @functools.cached_property
    def leans(self) -> dict[str, float]:
        """By how much the value is wrong if a joint's zero is elsewhere than its prior has it, per rad, by joint.

        The posterior's mean moves by C P with the prior's: C the covariance, P the precision of the prior.
        """
        if not self.known or "zero" in self.runs[0].kind.kept:
            return {}
        problem = self.opened.problem
        column = self.opened.column(self.name)
        moved = problem.coordinates.prior_precision @ self.posterior.covariance[:, column]  # (F,)
        zeros = [(f, problem.unknowns[row]) for f, row in enumerate(problem.estimated)]
        zeros = [(f, u) for f, u in zeros if u.kind == "zero"]
        return {str(u.scope): float(moved[f]) for f, u in zeros}

    @property
    def zeros_std(self) -> float:
        """What zeros that differ from one recording to the next put on the value, as a standard deviation."""
        return self.zero_repeat * float(np.linalg.norm(list(self.leans.values())))

    @property
    def zero_repeat(self) -> float:
        """How far the zero of a joint may be elsewhere than the calibration has it, as a standard deviation [rad]."""
        return zero_repeat_of(self.robot, self.runs)

    @property
    def std(self) -> float:
        """Its standard deviation."""
        return float(np.sqrt(self.covariance[self.row, self.row]))

    def widen(self, by: float) -> None:
        """Count another uncertainty, independent of the others, as a standard deviation in the unknown's unit."""
        self.covariance[self.row, self.row] += by**2

    def far_from_priors(self) -> list[str]:
        """Which unknowns ended further from their priors than a right model takes them, the furthest first.

        A run's start velocity has a prior worth the name only from a calibration; without one it is far where the joint clearly
        moved. What a calibration left correlated is looked at together, too.
        """
        far: dict[str, tuple[float, str]] = {}
        for row in (
            row for fit in (self.opened, self.fit) for row in unknown_rows(fit, self.covariance)
        ):
            guessed = (
                row.kind == "v0"
                and self.robot.calibration is None
                and abs(row.value) < MOVING_START
            )
            if guessed or row.pull is None or abs(row.pull) <= FAR:
                continue
            known = shown(
                row.unit,
                row.prior,
                row.prior_std,
                between=" +- ",
            )
            came_out = shown(row.unit, row.value)
            pull = abs(row.pull)
            far[row.name] = (
                pull,
                sentences.far_from_prior(row.name, came_out, pull, known, row.kind == "v0"),
            )
        furthest = sorted(far.values(), reverse=True)[:NAMED_AT_MOST]
        return [sentence for _, sentence in furthest] or self._far_together()

    @functools.cached_property
    def zeros_seen(self) -> list[SeenZero]:
        """What the recording itself says of joints' zeros, the most certain to be elsewhere first; none where no zero explains it.

        What is learnt of a zero is less than its prior lets it move, so it is measured by what the recording adds: with a right
        model, value less prior has the prior's variance less the posterior's.
        """
        if not self.known:
            return []
        problem = self.opened.problem
        covariance = Posterior(problem, self.opened.values).covariance
        found = []
        for column, row in enumerate(problem.estimated):
            unknown = problem.unknowns[row]
            learnt = unknown.std**2 - float(covariance[column, column])
            if unknown.kind != "zero" or learnt < LEAST_LEARNT * unknown.std**2:
                continue
            off = float(self.opened.values[row]) - unknown.value
            found.append(
                SeenZero(
                    abs(off) / float(np.sqrt(learnt)),
                    off * unknown.std**2 / learnt,
                    str(unknown.scope),
                )
            )
        found.sort(reverse=True)
        # what no zero explains bends zeros, too
        left = self.opened.chi2 - found[0].pull ** 2 if found else 0.0
        return [] if beyond_chance(left, self.opened.dof) else found

    @property
    def seeming_zero(self) -> tuple[str, float]:
        """The joint whose zero seems elsewhere, by less than is refused, and what that would change in the value's unit."""
        # residuals that chance does not explain have something of a zero's, too
        unseen = not self.zeros_seen or not self.fit.explains
        if unseen or self.zeros_seen[0].pull <= SEEMS_ELSEWHERE:
            return "", 0.0
        first = self.zeros_seen[0]
        return first.joint, self.leans.get(first.joint, 0.0) * first.off_rad

    def other_zeros(self) -> list[Reason]:
        """The joints whose zero the recording itself shows elsewhere than the calibration has it, as far as it tells them apart."""
        found = self.zeros_seen
        if not found or found[0].pull <= ELSEWHERE:
            return []
        first = found[0]
        alike = [
            each.joint for each in found[:NAMED_AT_MOST] if each.pull > ALIKE_PULL * first.pull
        ]
        return [sentences.other_zero(alike, first.off_rad, first.pull)]

    def _far_together(self) -> list[str]:
        problem = self.opened.problem
        calibration = self.robot.calibration
        if calibration is None:
            return []
        keys = set(calibration.keys)
        own = [
            column
            for column, row in enumerate(problem.estimated)
            if problem.unknowns[row].key in keys
        ]
        block = np.ix_(own, own)
        precision = problem.coordinates.prior_precision[block]
        off = self.opened.values[problem.estimated[own]] - problem.coordinates.prior_mean[own]
        # with a right model, the distance squared is on average the number of directions that the recording has determined
        learnt = max(
            len(own) - float(np.sum(precision * self.posterior.covariance[block])),
            1.0,
        )
        distance2 = float(off @ precision @ off)
        if not beyond_chance(distance2, learnt, FAR):
            return []
        return [sentences.far_together(float(np.sqrt(distance2)), learnt)]

    def budget(self) -> list[tuple[str, float]]:
        """Which source puts how much standard deviation on the unknown, as it stands now."""
        return error_budget(self.opened, self.covariance, self.name)

    def profile(self) -> Scan:
        """How much worse other values of the unknown explain the recording, everything else that is open fitted again."""
        return misfit_profile(
            self.opened,
            self.name,
            self.posterior,
            self.inflation,
            self.value,
            self.std,
        )


def judge(
    refusals: Iterable[Refusal],
    assessed: Assessment | None = None,
) -> Refusal:
    """The verdict on an answer, and why.

    Of what a probe has against it the first counts; the others are not computed. Whatever that is, three things that only a fit
    shows make it a rejection: unknowns far from what is known, joints read from elsewhere, and an input stamped at another time.

    Args:
        refusals: Those of the probe, from the worst that can be wrong to the least.
        assessed: The fit; None where there is none.

    Returns:
        What speaks against the answer; `ACCEPTED` where nothing does.
    """
    refusal = next(iter(refusals), ACCEPTED)
    if assessed is None or not np.isfinite(assessed.fit.chi2):
        return refusal
    refusal = _far_from_priors(refusal, assessed)
    refusal = _read_from_elsewhere(refusal, assessed)
    return _stamped_at_another_time(refusal, assessed)


def _far_from_priors(refusal: Refusal, assessed: Assessment) -> Refusal:
    """A rejection is also for that; another refusal gives way to it."""
    far = assessed.far_from_priors()
    if not far:
        return refusal
    if refusal.verdict is Verdict.REJECTED:
        moreover = [Reason("far_from_prior", f"moreover, {each}") for each in far]
        return replace(refusal, reasons=(*refusal.reasons, *moreover))
    return rejected(
        "far_from_prior",
        "the model only explains the recording far from what is known",
        sentences.only_far(far),
        *other_suspects(assessed.robot),
    )


def _read_from_elsewhere(refusal: Refusal, assessed: Assessment) -> Refusal:
    """A rejection is also for that; another refusal gives way to it."""
    zeros = assessed.other_zeros()
    if not zeros:
        return refusal
    if refusal.verdict is Verdict.REJECTED:
        return replace(refusal, reasons=(*refusal.reasons, *zeros))
    return Refusal(Verdict.REJECTED, "a joint is read from elsewhere than it is", tuple(zeros))


def _stamped_at_another_time(refusal: Refusal, assessed: Assessment) -> Refusal:
    """This comes first, since it spoils everything else; that the interval is wide as well is not worth a word."""
    off = stamps_off(assessed.fit)
    if not off:
        return refusal
    others = () if refusal.verdict is Verdict.TOO_WIDE else refusal.reasons
    return Refusal(
        Verdict.REJECTED,
        "the input is not stamped as the joint moved",
        (*off, *others),
    )


def too_wide(assessed: Assessment, width_limit: WidthLimit, budget: Budget) -> Iterator[Refusal]:
    """Where the interval of a fit is wider than is useful, whatever explains the recording.

    Args:
        assessed: The fit.
        width_limit: How wide the interval may be.
        budget: What puts how much on the value, the largest first.
    """
    unit = assessed.unit
    value = assessed.value
    std = assessed.std
    # zeros are asked for by a sentence of their own, which says what tells them
    std_but_zeros = float(np.sqrt(max(std**2 - assessed.zeros_std**2, 0.0)))
    if not width_limit.exceeded_as_printed(value, std_but_zeros):
        return
    interval = shown(
        unit,
        *not_negative(value, std),
        spec=spec_for(unit, std),
    )
    limit = f"+-{100.0 * width_limit.share:.0f} % of the value"
    if width_limit.floor:
        limit += f" and than +-{shown(unit, width_limit.floor, spec='.3g')}"
    mostly = source_label(budget[0][0]) if budget else ""
    yield wide(width_limit, sentences.any_of(interval, limit, mostly, assessed.known))


def guessed(guesses: Sequence[Guess], value: float) -> Reason:
    """What an answer that is ``value`` owes to facts that nobody stated."""
    off = float(np.sqrt(sum(guess.std**2 for guess in guesses)))
    listed = ", ".join(f"{guess.key} ({guess.taken}, +- {guess.spread})" for guess in guesses)
    share = off / value if value > 0.0 else None
    return sentences.guessed(listed, share, guesses[0].key)


def positive(
    name: str,
    unit: str,
    value: float,
    std: float,
    withheld: str = "",
    highest: float = np.inf,
    quantile: float = Z95,
) -> Value:
    """A quantity that is not negative, with an interval whose lower end is cut off at 0: an empty hand reads 0.

    Args:
        name: Of the quantity.
        unit: Of value, std and highest.
        value: That was found.
        std: Its standard deviation.
        withheld: Why no number is given; empty where one is.
        highest: Where the interval ends at most.
        quantile: Half the width of a 95 % interval in standard deviations.
    """
    if withheld:
        return Value(name, unit, None, reason=withheld)
    low, high = not_negative(value, std, quantile)
    return Value(
        name,
        unit,
        max(value, 0.0),
        std,
        [low, min(high, highest)],
    )
