"""What differs between two recordings of one machine: torque, friction, offsets and zeros; by how much is learnt or as published.

Windings and magnets warm up, grease does, a brake lets go a little elsewhere. So each recording has of its own a share of the
torque (one that all joints have in common, one of each joint), friction, an offset and a zero of each joint, about the machine's.
How far they scatter is a standard deviation for each kind: what was published of repeated recordings counts as so many recordings,
and those at hand as what each of them tells (MacKay 1992, Neural Computation 4: the evidence of a variance). A few of them say
little about their scatter, so intervals take Student's factor for their number.

Where it is from: magnets lose 0.1 % of their torque per kelvin, and motors that work warm by 10 to 20; friction goes with warmth by
1 % per kelvin (`calibration_files/drift.py`). Recordings of one UR10e differ by 1.5 to 2 % of a mass, those of STS servos that were
let go by 1.9 to 4.5 %, those of driven servos by 2 to 9 % (docs: validation).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import SPREAD_FACTORS
from proprio_ros.identification.scatter import half_cauchy, under
from proprio_ros.records import FloatArray

PUBLISHED: Mapping[str, float] = {
    "common_scale": 0.015,
    "own_scale": 0.01,
    "friction": 0.15,
    "offset": 0.1,
    "zero": 0.003,
    "pace": 0.0,
    "lag": 0.0,
}
"""Standard deviation by kind: both scales and friction relative, the offset in parts of Coulomb friction, the zero [rad].

A clock keeps time until a recording shows that it does not (`time_axis`): pace is by how much accelerations are larger than it has
them, relative, and lag how much later torques are recorded than positions [s].
"""
PSEUDO_RECORDINGS = 4.0  # So many recordings the published word counts as.
CONSIDERED = ("common_scale", "own_scale", "zero")
"""Kinds that the fit of empty recordings does not follow, since whatever the model lacks looks like them; a weighing does as far as
the evidence says, and they count in what it errs by (as consider parameters do: Schmidt 1966, Advances in Control Systems 3)."""
LEARNT = ("friction", "offset")
"""Kinds whose spread is learnt of what was found; what was found of the others is also what the model lacks."""
CLOCK = ("pace", "lag")
"""Kinds that are looked for in each recording alone, before all else."""
FOLLOWED_TOGETHER = (("common_scale",), ("own_scale", "zero"))
"""Kinds whose spread the evidence decides, some together."""
FACTORS = SPREAD_FACTORS
PAIRS = np.array(list(itertools.product(FACTORS, repeat=len(FOLLOWED_TOGETHER))))  # shape (F, 2)
# How likely it is that torque and zeros of two recordings are alike, before they are looked at.
AGREE = 0.5
DIFFERS = "torque and zeros that differ between recordings"
WORDS: Mapping[str, str] = {
    "friction": "friction that differs between recordings",
    "offset": "offsets that differ between recordings",
    **dict.fromkeys(CONSIDERED, DIFFERS),
    **dict.fromkeys(CLOCK, "the clock of the recording"),
}
SPREAD_SCALE = 0.05
"""Of the prior of how far masses differ from recording to recording, relative: those of real XL330 and STS3215 do by 2 to 9 %."""
SPREADS = np.geomspace(1e-4, 1.0, 200)  # At which the posterior of that is taken.


def spread_of_runs(
    stated: float, found: FloatArray, learnt: FloatArray, pseudo_runs: float
) -> float:
    """Standard deviation of what differs from run to run, by what R runs have of it.

    Args:
        stated: Standard deviation that is expected.
        found: What each run has, shape (R,).
        learnt: How much of it the run determines rather than its prior, 0 to 1, shape (R,).
        pseudo_runs: How many runs the expectation is worth.
    """
    total = float(np.sum(np.square(found))) + pseudo_runs * stated**2
    return float(np.sqrt(total / (max(float(np.sum(learnt)), 0.0) + pseudo_runs)))


@dataclass(frozen=True)
class RecordingVariability:
    """What recordings of an arm of n joints have of their own, as standard deviations.

    A recording's own terms are viscous friction, Coulomb friction, offset, share of the torque and zero of each joint, and a share
    of the torque in common, pace and lag of its clock: 5 n + 3.
    """

    spreads: Mapping[str, float]  # by kind, in the units of `PUBLISHED`
    recordings: Mapping[str, float]  # on how many recordings' word each rests
    # what a spread of 1 is: of viscous friction, Coulomb friction and the offset, shape (3 n,)
    friction: FloatArray
    drift: FloatArray  # what these change by within a recording, shape (3 n,)

    @classmethod
    def published(cls, friction: FloatArray, drift: FloatArray) -> RecordingVariability:
        """Nothing is known of this arm but its friction."""
        return cls(
            PUBLISHED,
            dict.fromkeys(PUBLISHED, PSEUDO_RECORDINGS),
            friction,
            drift,
        )

    @classmethod
    def unknown(cls, count: int) -> RecordingVariability:
        """Nothing is known of an arm of so many joints, not even its friction."""
        friction = np.zeros(3 * count)
        return cls.published(friction, friction)

    def place(self, kind: str) -> int:
        """Where the first term of a kind stands among a recording's own."""
        return int(np.flatnonzero(self.kinds == kind)[0])

    @property
    def kinds(self) -> NDArray[np.str_]:
        """Of the own terms, shape (5 n + 3,)."""
        count = len(self.friction) // 3
        return np.repeat(
            ["friction", "offset", "own_scale", "zero", "common_scale", "pace", "lag"],
            [2 * count, count, count, count, 1, 1, 1],
        )

    @property
    def by_word(self) -> dict[str, float]:
        """On how many recordings' word each of `WORDS` rests: of its kinds, that of which fewest tell."""
        return {
            word: min(self.recordings[kind] for kind in WORDS if WORDS[kind] == word)
            for word in WORDS.values()
        }

    @property
    def std(self) -> FloatArray:
        """Of the own terms, shape (5 n + 3,)."""
        kinds = self.kinds
        of_friction = len(self.friction)
        std = np.array([self.spreads[kind] for kind in kinds])
        std[:of_friction] = np.hypot(
            std[:of_friction] * self.friction,
            self.drift,
        )
        return np.maximum(std, 1e-9)

    def learnt(
        self,
        now: RecordingVariability,
        off: FloatArray,
        variances: FloatArray,
        kinds: Iterable[str] = PUBLISHED,
    ) -> RecordingVariability:
        """With what R recordings show, beside what this says.

        Args:
            now: The spreads under which they were fitted.
            off: How each one's own terms differ from the machine's, shape (R, 5 n + 3).
            variances: Of these, after the fit, shape (R, 5 n + 3).
            kinds: What is learnt.
        """
        std = now.std
        own = self.kinds
        spreads = dict(self.spreads)
        recordings = dict(self.recordings)
        for kind in kinds:
            mine = own == kind
            stated = self.spreads[kind]
            determined = np.clip(
                1.0 - variances[:, mine] / std[mine] ** 2,
                0.0,
                1.0,
            )
            found = off[:, mine] / std[mine] * now.spreads[kind]
            spreads[kind] = spread_of_runs(
                stated,
                found,
                determined,
                self.recordings[kind],
            )
            recordings[kind] = self.recordings[kind] + float(determined.sum())
        return replace(self, spreads=spreads, recordings=recordings)


@dataclass(frozen=True)
class Evidence:
    """What data say of T terms of which nobody knows how far they scatter, at each of F spreads."""

    mean: FloatArray  # of the terms over all spreads, none among them, shape (T,)
    wider: Mapping[str, float]  # how many times as far as stated they scatter if they do, by kind
    terms: FloatArray  # by each spread, shape (F, T)
    weights: (
        FloatArray  # how likely each spread is, by what was known before, too, shape (F,), sum 1
    )
    log_likelihood: (
        FloatArray  # of these data by each spread, over that without the terms, shape (F,)
    )
    variances: FloatArray  # of what follows the terms, by each spread, shape (F,)
    variance: float  # of it by the root mean square of spreads
    log_likelihood_of_more: (
        FloatArray  # that one more recording like this is expected to have, shape (F,)
    )


def by_evidence(
    kinds: NDArray[np.str_],
    information: FloatArray,
    side: FloatArray,
    lead: FloatArray,
    before: FloatArray | float = 0.0,
) -> Evidence:
    """Average terms over how far they may scatter, by how likely each spread makes the data.

    Args:
        kinds: Of the T terms.
        information: Of the data, in parts of what is stated of the terms, shape (T, T).
        side: What the data say, weighted alike, shape (T,).
        lead: By how much something follows each of the terms, shape (T,).
        before: Of other recordings of the machine, see `by_own_spread`.
    """
    together = np.array([[kind in group for group in FOLLOWED_TOGETHER] for kind in kinds])
    pairs = PAIRS
    each = [under(np.square(together @ pair), information, side) for pair in pairs]
    evidence = np.array([log_evidence for log_evidence, _ in each])
    terms = np.array([values for _, values in each])
    weights, agree = likely(evidence, pairs, before)
    wider: dict[str, float] = {}
    rms = np.sqrt(weights @ np.square(pairs))
    for group, factor in zip(FOLLOWED_TOGETHER, rms, strict=True):
        wider |= dict.fromkeys(group, float(factor))

    def variance(pair: FloatArray) -> float:
        _, along = under(np.square(together @ pair), information, lead)
        return float(lead @ along)

    return Evidence(
        (1.0 - agree) * (weights @ terms),
        wider,
        terms,
        weights,
        evidence,
        np.array([variance(pair) for pair in pairs]),
        variance(rms),
        _of_more(together, pairs, weights, information),
    )


def _of_more(
    together: NDArray[np.bool_],
    pairs: FloatArray,
    weights: FloatArray,
    information: FloatArray,
) -> FloatArray:
    """Logarithm of how likely each spread is expected to make one more recording that says as much as this one, shape (F,).

    Its terms scatter by the spread that is most likely, on average over what noise it may have.

    Args:
        together: Which of a pair's spreads each of the T terms has, shape (T, 2).
        pairs: Of `FACTORS`, shape (F, 2).
        weights: How likely each is, shape (F,).
        information: Of the data on the terms, in parts of what is stated of them, shape (T, T).
    """
    usual = np.square(together @ np.exp(weights @ np.log(pairs)))
    of_data = information + information * usual @ information  # covariance of what it says
    found = []
    for pair in pairs:
        variances = np.square(together @ pair)
        widened = np.eye(len(information)) + variances[:, None] * information
        fit = np.trace(np.linalg.solve(widened, variances[:, None] * of_data))
        found.append(0.5 * float(fit - np.linalg.slogdet(widened)[1]))
    return np.array(found)


def likely(
    log_evidence: FloatArray, factors: FloatArray, before: FloatArray | float = 0.0
) -> tuple[FloatArray, float]:
    """How likely pairs of `FACTORS` are by their evidence, where recordings differ, and that they agree.

    Args:
        log_evidence: Of a recording, shape (F,).
        factors: The pairs, shape (F, 2).
        before: Of other recordings of the machine, see `by_own_spread`, in the order of `FACTORS`.

    Returns: Shape (F,), sum 1; and the probability that recordings agree.
    """
    prior = _prior_weights(factors).prod(axis=1)
    known = log_evidence + np.tile(before + np.zeros(len(FACTORS)), len(FACTORS))
    highest = max(float(known.max()), 0.0)
    weights: FloatArray = prior / prior.sum() * np.exp(known - highest)
    agree = AGREE * np.exp(-highest)
    return weights / weights.sum(), float(agree / (agree + (1.0 - AGREE) * weights.sum()))


def by_own_spread(log_likelihood: FloatArray) -> FloatArray:
    """Logarithm of how likely each spread of joints and zeros makes recordings, in the order of `FACTORS`.

    What they say of the share in common is not kept: motors warm up together, and the recordings at hand may be of one hour.

    Args:
        log_likelihood: By each of `PAIRS`, shape (F,).
    """
    highest = float(log_likelihood.max())
    common = _prior_weights(np.array(FACTORS))
    likelihood = np.exp(log_likelihood - highest).reshape(len(FACTORS), -1)
    mean = common @ likelihood / common.sum()
    # a spread that is out of the question may be less likely than any number says
    result: FloatArray = np.log(np.maximum(mean, np.finfo(np.float64).tiny)) + highest
    return result


def _prior_weights(factors: FloatArray) -> FloatArray:
    """Half-Cauchy prior of spreads times the steps of the grid, of the shape of the factors."""
    steps = np.gradient(np.array(FACTORS))[np.searchsorted(FACTORS, factors)]
    result: FloatArray = steps * half_cauchy(factors)
    return result


def spread_posterior(errors: FloatArray, variances: FloatArray) -> FloatArray:
    """How likely it is that values differ by each of `SPREADS` beyond what each knows of its own error, shape (200,), sum 1.

    ``errors``: of each, relative, shape (n,); ``variances``: that each knows, shape (n,).
    """
    apart = np.maximum(variances, 1e-12) + SPREADS[:, None] ** 2
    fit = -0.5 * np.sum(
        np.log(apart) + np.square(errors) / apart,
        axis=1,
    )
    # a half Cauchy prior, too; the steps grow with the spread
    log = fit - np.log1p(np.square(SPREADS / SPREAD_SCALE)) + np.log(SPREADS)
    weights: FloatArray = np.exp(log - log.max())
    return weights / weights.sum()


def spread_of(posterior: FloatArray) -> float:
    """Its median."""
    return float(SPREADS[int(np.searchsorted(np.cumsum(posterior), 0.5))])


def effective_freedom(
    total: FloatArray | float, parts: Sequence[tuple[float, float]]
) -> FloatArray:
    """Degrees of freedom of a variance, parts of which few say: Satterthwaite 1946, Biometrics Bulletin 2.

    ``total``: variance; ``parts``: of it, each with its degrees of freedom.
    """
    shares = sum(variance**2 / degrees for variance, degrees in parts)
    result: FloatArray = np.maximum(
        np.square(total) / max(shares, 1e-300),
        1.0,
    )
    return result


def half_width(
    posterior: FloatArray,
    mass: float,
    rest: float,
    freedom: Sequence[tuple[float, float]],
) -> float:
    """Half width of the 95 % interval of a mass [kg].

    Args:
        posterior: How likely each of `SPREADS` is, see `spread_posterior`, shape (200,).
        mass: That the spread is relative to [kg].
        rest: Variance of everything else [kg^2].
        freedom: Variance [kg^2] and degrees of freedom of the parts of it that a few recordings say.
    """
    from scipy.optimize import brentq
    from scipy.special import stdtr

    total = rest + np.square(SPREADS * mass)
    effective = effective_freedom(total, freedom)
    stds = np.sqrt(total)

    def beyond(half: float) -> float:
        return float(posterior @ stdtr(effective, half / stds)) - 0.975

    highest = float(stds[-1])
    while beyond(highest) < 0.0:
        highest *= 2.0
    return float(brentq(beyond, 0.0, highest))
