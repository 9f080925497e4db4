"""From runs with a filled container to what is inside: every model is fitted, and their evidence compared.

The evidence of a model is Laplace's: its fit's probability times the share of the prior that the recording leaves (MacKay 2003,
Information Theory, Inference and Learning Algorithms, chapter 28). Under each model held joints shake as their servos let them
(`held_by_servos`), or what they leave would look like a liquid. Where the best model leaves more of the empty container's runs than
the encoder explains, residuals count for less, in all models alike. Masses are averaged over what is probable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import softmax

from proprio_ros.addons.contents import models as law
from proprio_ros.addons.contents.detail import KINDS_INSIDE, MOVING, ContentsDetail
from proprio_ros.addons.contents.models import ContentsFacts
from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.identification import solvers
from proprio_ros.identification.conclude import Conclusion, stated_in
from proprio_ros.identification.estimate import (
    WIDEST_SHARE,
    Estimate,
    SolverSummary,
    Value,
    WidthLimit,
    no_answer,
)
from proprio_ros.identification.fit import FitResult, SearchOptions, summary, unknown_rows
from proprio_ros.identification.gates import Findings, admitted
from proprio_ros.identification.judge import Assessment, Refusal, positive
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.reasons import Reason
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot

SURE = 0.95  # probability from which on a kind is said
# robot and held joints are models, too: what is inside differs by so many times less than chi-square says
ALIKE_RUNS = 2.0
# probability at least that what seems rigid moves (honey, still sand), and that what seems to be grains is rigid
UNSEEN = 0.1
STARTS_KG = (0.03, 0.1, 0.3)
# held joints give way anew below this reduced chi-square, so often, while it gains so much
HOPELESS = 100.0
PASSES = 6
WORTH = 1.0
# nor where chi-square is farther beyond the best model's, in what each of its degrees of freedom has
BESIDE = 200.0
# of its prior's standard deviation: what a recording must leave at most for a value to be its own
LEARNT = 0.6
CLASSES = (
    (0.02, "thin, like water or alcohol"),
    (0.3, "like oil or syrup"),
    (np.inf, "thick, like honey"),
)
"""Dynamic viscosity below which a liquid is of a class [Pa s]."""
KINDS = np.array([*law.MODELS.values()])  # of each model
# standard deviations of frequency and density together from which on a cylinder is not as stated
UNLIKE = 3.0
FILL_SHARE = 0.1  # of the container's height: how well a fill has to be known
LIQUID = (
    ("fill", "m"),
    ("slosh_frequency", "Hz"),
    ("slosh_damping", "1"),
    ("viscosity", "Pa s"),
)
"""What is said of a liquid, and units."""


def evidence(known: Posterior) -> float:
    """Logarithm of a model's evidence, but for what all models share."""
    coordinates = known.problem.coordinates
    off = known.values[known.problem.estimated] - coordinates.prior_mean
    fit = float(known.residual @ known.residual) + float(off @ coordinates.prior_precision @ off)
    kept = sum(
        np.linalg.slogdet(matrix)[1] for matrix in (coordinates.prior_precision, known.covariance)
    )
    return 0.5 * (float(kept) - fit)


def left_over(fit: FitResult, rows: np.ndarray) -> float:
    """Mean square of what is left of some runs, in that of their encoders."""
    shown = fit.problem.simulate(fit.values[None], fit.problem.estimated[:1])[0][0]
    weight = fit.problem.weight
    squares = np.square((shown - fit.problem.measured) * weight)[rows]
    return float(squares.sum() / np.count_nonzero(weight[rows]))


def weighted(
    logs: np.ndarray,
    kinds: np.ndarray,
    explains: np.ndarray,
) -> np.ndarray:
    """Probabilities of M models by logarithms of evidence, shape (M,), the first of nothing inside; whether each explains it.

    Args:
        logs: Logarithms of the models' evidence, shape (M,), the first of nothing inside.
        kinds: Kind of each model, shape (M,).
        explains: Whether each explains the recording, shape (M,).

    Returns:
        Shape (M,), with a sum of 1.
    """
    logs = logs.copy()
    moves = np.isin(kinds, MOVING)
    rigid = max(
        np.flatnonzero(kinds == "rigid"),
        key=lambda row: logs[row],
    )
    # what grains explain a robot's friction may; and where nothing that is rigid explains the recording, nobody says that it is
    logs[rigid] = max(
        logs[rigid],
        logs[kinds == "granular"].max() - np.log(1.0 / UNSEEN - 1.0),
    )
    plain = softmax(logs)
    least = UNSEEN if explains[rigid] else 0.5
    share = max(
        float(plain[moves].sum()),
        least * (1.0 - float(plain[0])),
    )
    # each side by itself: beside the other's its evidence may be nothing
    within = softmax(np.where(moves, logs, -np.inf))
    beside = softmax(np.where(~moves, logs, -np.inf))
    return share * within + (1.0 - share) * beside


def searched(
    problem: law.ContentsProblem,
    starts: np.ndarray,
    windows: Callable[[float], np.ndarray] | None,
) -> FitResult:
    """Search from some starts, roughly.

    Args:
        problem: What is fitted.
        starts: Values of all unknowns, in their own units, shape (S, P).
        windows: How many samples of each run lie in a fraction of its time; None fits everything at once.

    Returns:
        Where the starts ended.
    """
    internal = problem.coordinates.internal(starts[:, problem.estimated])
    return FitResult.of(
        problem,
        solvers.levenberg_marquardt(problem, internal, windows, tolerance=1e-2),
    )


def first_guesses(problem: law.ContentsProblem) -> np.ndarray:
    """Values of all unknowns from which a model's search starts, shape (S, P)."""
    if not problem.inside:
        return problem.base[None]
    starts = np.tile(problem.base, (len(STARTS_KG), 1))
    starts[:, problem.index["contents_mass"]] = STARTS_KG
    return starts


def once_more(fits: Sequence[FitResult], best: FitResult | None) -> bool:
    """Whether it is worth while that held joints give way anew, as a model's last fit moves them; ``best`` is another's."""
    if fits[0].reduced_chi2 >= HOPELESS or len(fits) > PASSES:
        return False
    if len(fits) == 1:
        return True
    last = fits[-1].chi2
    beside = best is not None and last - best.chi2 > BESIDE * max(1.0, best.reduced_chi2)
    return fits[-2].chi2 - last > WORTH and not beside


def fitted(
    problem: law.ContentsProblem,
    best: FitResult | None,
) -> list[FitResult]:
    """A model's search from all starts, and the best from there on, with held joints as the motion before moves them.

    Args:
        problem: Of the model.
        best: The best fit of the models before it, if there is one.

    Returns:
        The first search's fit and the best one.
    """
    fits = [searched(problem, first_guesses(problem), problem.simulator.windows)]
    while once_more(fits, best):
        problem = problem.with_runs(problem.held(fits[-1].values))
        fits.append(searched(problem, fits[-1].values[None], None))
    return [fits[0], min(fits, key=lambda fit: fit.chi2)]


def all_fitted(
    robot: Robot, runs: Sequence[PreparedRun], facts: ContentsFacts, filled: Sequence[bool]
) -> list[list[FitResult]]:
    """Each model's first fit and its best.

    Args:
        robot: The arm.
        runs: What is fitted.
        facts: The container.
        filled: Which of the runs have the contents.
    """
    found: list[list[FitResult]] = []
    best = None
    for model in law.MODELS:
        problem = law.ContentsProblem(robot, runs, facts, filled, model)
        found.append(fitted(problem, best))
        fit = found[-1][1]
        if fit.reduced_chi2 < HOPELESS and (best is None or fit.chi2 < best.chi2):
            best = fit
    return found


def find_contents(
    robot: Robot,
    runs: Sequence[Run],
    facts: ContentsFacts,
    baseline: Sequence[Run] = (),
) -> Estimate:
    """Identify what is in the container in all ``runs``; the baseline is runs with it empty.

    Args:
        robot: The arm.
        runs: With the contents.
        facts: The container.
        baseline: With the container empty.

    Raises:
        ConfigurationError: Neither a baseline nor the container's mass.
        RecordingError: A run cannot be related to the robot, or does not move the container across its axis.
    """
    if not baseline and not np.isfinite(facts.mass_std):
        raise ConfigurationError(
            "the empty container is not known: give its recording (--baseline), or its mass (--set contents.mass=KG)"
        )
    found = Findings()
    used, filled = _usable(robot, runs, baseline, facts, found)
    if not any(filled):
        return no_answer(
            "contents", "contents_mass", "kg", robot.name, len(runs), found.reasons, found.notes
        )
    models = all_fitted(robot, used, facts, filled)
    opened = [fit for _, fit in models]
    empty = ~np.array(filled)
    best = min(opened, key=lambda fit: fit.reduced_chi2)
    inflation = ALIKE_RUNS * max(1.0, left_over(best, empty) if empty.any() else best.reduced_chi2)
    known = [Posterior(fit.problem, fit.values, inflation) for fit in opened]
    logs = np.array([evidence(each) for each in known])
    logs -= np.log([np.sum(kind == KINDS) for kind in KINDS])  # each kind is as likely beforehand
    weight = weighted(
        logs,
        KINDS,
        np.array([fit.explains for fit in opened]),
    )
    first, best = models[1 + int(np.argmax(weight[1:]))]
    return ContentsFound(first, best, found, len(runs), opened, weight, facts).estimate()


def _usable(
    robot: Robot,
    runs: Sequence[Run],
    baseline: Sequence[Run],
    facts: ContentsFacts,
    found: Findings,
) -> tuple[list[PreparedRun], list[bool]]:
    """The runs that can be fitted, and which of them have the contents.

    Args:
        robot: The arm.
        runs: With the contents.
        baseline: With the container empty.
        facts: The container.
        found: Hears why a run is left out.

    Raises:
        RecordingError: A run turns the container about its own axis.
    """
    used = []
    filled = []
    with_contents = [True] * len(runs) + [False] * len(baseline)
    for run, has in zip((*runs, *baseline), with_contents, strict=True):
        prepared = prepare_run(robot, run, None, facts.shell)
        if abs(law.container_seen(robot, prepared, facts)[0]) > law.LEVEL:
            raise RecordingError(
                f"{run.name}: {run.joint} turns the container about its own axis, so that nothing in it has to move; "
                "drive a joint whose axis is level, or state contents.rpy"
            )
        if admitted(robot, prepared, found):
            used.append(prepared)
            filled.append(has)
    return used, filled


@dataclass(eq=False)
class ContentsFound(Conclusion):
    """What the models together say: values are those of the most probable one that has contents."""

    models: list[FitResult]
    weights: np.ndarray  # their probabilities
    facts: ContentsFacts

    probe = "contents"
    name = "contents_mass"
    check = "check contents.radius, contents.bottom and the robot file's inertias"

    def __post_init__(self) -> None:
        super().__post_init__()
        assert isinstance(self.opened.problem, law.ContentsProblem)
        self.problem = self.opened.problem
        shares = [self.weights[kind == KINDS].sum() for kind in KINDS_INSIDE]
        self.probabilities = np.array(shares)

    def kind(self, sure: float = SURE) -> str:
        """What is inside, where that is so sure; empty where it is not."""
        return (
            KINDS_INSIDE[int(np.argmax(self.probabilities))]
            if float(self.probabilities.max()) >= sure
            else ""
        )

    def widen(self) -> None:
        # by how far apart the models' masses are, as probable as they are
        off = (
            np.array([0.0, *(model.value_of(self.name) for model in self.models[1:])])
            - self.assessed.value
        )
        self.count(float(np.sqrt(self.weights @ off**2)), "models of the contents")

    def comparable(self) -> bool:
        return False  # the models are compared, not the runs

    def refusals(self) -> Iterator[Refusal]:
        yield from self.misfit()
        yield from self.lighter(
            "the container", "was the baseline empty, and held in the same place?"
        )

    def width_limit(self) -> WidthLimit:
        return WidthLimit(WIDEST_SHARE, 0.02)

    def remarks(self) -> Iterator[str]:
        if not self.kind():
            order = np.argsort(-self.probabilities)
            each = ", ".join(
                f"{KINDS_INSIDE[n]} {100.0 * self.probabilities[n]:.0f} %" for n in order
            )
            cure = "shake it harder, or with the container further from the joint"
            yield Reason(
                "kind_open", f"the recording does not tell what is inside ({each}): {cure}"
            )
        if self.kind() == "liquid" and (words := self.viscosity_class):
            yield f"the liquid is {words}"

    @property
    def log_damping(self) -> tuple[float, float] | None:
        """Logarithm of the damping ratio and its standard deviation, where the recording says it."""
        row = self.problem.index.get("slosh_damping_log")
        if row is None:
            return None
        std = float(np.sqrt(self.assessed.covariance[row, row]))
        return (
            None
            if std > LEARNT * self.problem.unknowns[row].std
            else (float(self.fit.values[row]), std)
        )

    @property
    def viscosity_class(self) -> str:
        """In words, where its whole interval is in one class."""
        known = self.log_damping
        if known is None:
            return ""
        log, std = known
        ends = [self.viscosity(log + side * Z95 * std) for side in (-1.0, 1.0)]
        words = [next(said for limit, said in CLASSES if end < limit) for end in ends]
        return words[0] if words[0] == words[1] else ""

    def viscosity(self, log_damping: float) -> float:
        """Dynamic viscosity [Pa s] that gives this damping, by Mikishev and Dorozhkin."""
        fill = float(self.of_liquid[0][0])
        per_root = law.damping_ratio(self.facts.radius, fill, 1.0)
        return float((np.exp(log_damping) / per_root) ** 2 * self.facts.density)

    @cached_property
    def of_liquid(self) -> tuple[np.ndarray, np.ndarray]:
        """Fill [m], slosh frequency [Hz] and damping ratio of the liquid, and their standard deviations; shape (3,)."""
        names = [unknown.kind for unknown in self.problem.inside]
        rows = [self.problem.index[name] for name in names]
        values = [np.array([self.fit.values[row]]) for row in rows]
        at = dict(zip(names, values, strict=True))
        slopes = np.zeros((3, len(rows)))
        for n, name in enumerate(names):
            changed = {**at, name: at[name] + 1j * law.COMPLEX_STEP}
            slopes[:, n] = law.slosh_of(self.facts, changed)[0].imag / law.COMPLEX_STEP
        own = self.assessed.covariance[np.ix_(rows, rows)]
        return law.slosh_of(self.facts, at)[0], np.sqrt(
            np.einsum("in,nm,im->i", slopes, own, slopes)
        )

    def values(self, withheld: str) -> tuple[Value, ...]:
        mass, shell = (self.problem.index[name] for name in (self.name, "payload_mass"))
        covariance = self.assessed.covariance
        both = (mass, shell)
        together = float(np.sqrt(np.sum(covariance[np.ix_(both, both)])))
        total = float(self.fit.values[mass] + self.fit.values[shell])
        shares = zip(KINDS_INSIDE, self.probabilities.tolist(), strict=True)
        return (
            positive(
                self.name,
                "kg",
                self.assessed.value,
                self.assessed.std,
                withheld,
            ),
            positive("total_mass", "kg", total, together, withheld),
            *(
                Value(f"{kind}_inside", "1", None if withheld else share, reason=withheld)
                for kind, share in shares
            ),
            *self.liquid_values(withheld),
        )

    def liquid_values(self, withheld: str) -> Iterator[Value]:
        """What is said of a liquid; with the reason where it is not."""
        if not withheld and self.kind() != "liquid":
            withheld = "the recording does not say that it is a liquid"
        if not withheld and in_another_cylinder(self.fit, self.assessed.covariance):
            withheld = "it sloshes as its mass does in another cylinder: check contents.radius and contents.density"
        if withheld:
            yield from not_determined(LIQUID, withheld)
            return
        explained = self.fit.explains
        if explained:
            (fill, frequency, _), (fill_std, frequency_std, _) = self.of_liquid
        else:
            fill, fill_std = fill_by_mass(self.assessed, self.facts)
        height = self.facts.height
        wide = "it is not known to a tenth of the container's height"
        known = Z95 * fill_std <= FILL_SHARE * height
        yield positive("fill", "m", float(fill), float(fill_std), "" if known else wide, height)
        if not explained:
            why = "it moves otherwise than small waves do: push it less"
            yield from not_determined(LIQUID[1:], why)
            return
        yield positive("slosh_frequency", "Hz", float(frequency), float(frequency_std))
        damping = self.log_damping
        if damping is None:
            why = "the recording says too little of how fast the sloshing dies"
            yield from not_determined(LIQUID[2:], why)
            return
        yield from self.damping_values(*damping)

    def damping_values(self, log: float, std: float) -> Iterator[Value]:
        """Damping ratio and viscosity, by the ratio's logarithm and its standard deviation."""
        ends = [log + side * Z95 * std for side in (-1.0, 1.0)]
        ratio = float(np.exp(log))
        yield Value("slosh_damping", "1", ratio, ratio * std, np.exp(ends).tolist())
        value = self.viscosity(log)
        limits = [self.viscosity(end) for end in ends]
        yield Value("viscosity", "Pa s", value, 2.0 * std * value, limits)

    def detail(self, withheld: str) -> ContentsDetail:
        shares = dict(zip(KINDS_INSIDE, self.probabilities.tolist(), strict=True))
        kind = "" if withheld else self.kind()
        moved = () if withheld else tuple(self.problem.path(self.fit.values))
        return ContentsDetail(kind, shares, moved if self.kind(0.0) in MOVING else ())

    def solver(self) -> SolverSummary:
        used = self.nominal.solution.iterations + self.fit.solution.iterations
        return summary(
            self.nominal,
            self.name,
            STARTS_KG,
            max(2e-3, self.assessed.std),
            used,
            SearchOptions(),
            final=self.fit,
        )

    def assumptions(self) -> tuple[str, ...]:
        facts = self.facts
        place = ", ".join(f"{1e3 * each:g}" for each in facts.bottom)
        return (
            f"an upright cylinder of {2e3 * facts.radius:g} mm inside, {1e3 * facts.height:g} mm high, the middle of its bottom at "
            f"[{place}] mm in {self.robot.payload_frame}, held upright and at rest when the current came on",
            f"a liquid weighs {facts.density:g} +- {facts.density_std:g} kg/m^3: its fill is its mass over that, as far as its "
            "frequency does not say it",
            "one of four: nothing, one rigid thing, a liquid (first sloshing mode), grains; each as likely as another beforehand",
            stated_in(self.robot),
        )


def not_determined(values: Sequence[tuple[str, str]], why: str) -> list[Value]:
    """Values without a number, by name and unit, and the reason."""
    return [Value(name, unit, None, reason=why) for name, unit in values]


def in_another_cylinder(fit: FitResult, covariance: np.ndarray) -> bool:
    """Whether frequency and density, whose priors follow from the stated cylinder, are pulled far from them together."""
    pulls = [
        row.pull or 0.0
        for row in unknown_rows(fit, covariance)
        if row.kind in ("slosh_tuning", "contents_density")
    ]
    return bool(np.linalg.norm(pulls) > UNLIKE)


def fill_by_mass(mass: Assessment, facts: ContentsFacts) -> tuple[float, float]:
    """How high a liquid of this mass stands, however it moves, and the standard deviation [m]."""
    fill = mass.value / (facts.density * np.pi * facts.radius**2)
    share = np.hypot(mass.std / mass.value, facts.density_std / facts.density)
    return fill, fill * share
