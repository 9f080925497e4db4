"""Three ways down the same hill: batched Levenberg-Marquardt (default), Adam, CMA-ES."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.unknowns import Coordinates
from proprio_ros.version import to_install

SOLVERS = ("lm", "adam", "cma")
WINDOWS = (0.25, 0.5, 0.75, 1.0)
"""Growing windows: the early part of a trajectory is nearly linear in the unknowns, so it leads every start into the right
valley before the late, sensitive part is believed."""
IDLE_GAIN = 1e-6
"""A decrease of half chi-square below this moves nothing by more than a thousandth of its standard deviation."""

LARGEST_CURVATURE = 1e100
"""Of a start, products of whose numbers are still finite."""


class LeastSquares(Protocol):
    """What a solver needs of a problem."""

    coordinates: Coordinates

    def linearise(
        self,
        internal: np.ndarray,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cost (S,), gradient (S, F), Gauss-Newton matrix (S, F, F)."""
        ...


@dataclass(frozen=True)
class Solution:
    """Where every start ended."""

    internal: np.ndarray  # solver coordinates, shape (S, F)
    cost: np.ndarray  # at the end, shape (S,)
    path: np.ndarray  # solver coordinates after each iteration, shape (I, S, F)
    path_cost: np.ndarray  # each over the window in use then, shape (I, S)
    iterations: int  # that were taken

    @property
    def best(self) -> int:
        return int(np.argmin(self.cost))


def bounded_step(
    u: np.ndarray,
    gradient: np.ndarray,
    matrix: np.ndarray,
    damping: np.ndarray,
    coordinates: Coordinates,
) -> np.ndarray:
    """Damped Gauss-Newton step of every start that respects the bounds.

    An unknown that sits on a bound and is pushed outward stays; one whose step would cross a bound goes to it, and the others
    are solved for again with that in mind.

    Args:
        u: Solver coordinates, shape (S, F).
        gradient: Of the cost there, shape (S, F).
        matrix: Gauss-Newton's, shape (S, F, F).
        damping: Factor on the diagonal, less one, shape (S,).
        coordinates: Their bounds, and how long a step may be.

    Returns: the steps, shape (S, F).
    """
    lower = coordinates.lower
    upper = coordinates.upper
    diagonal = np.arange(u.shape[1])
    pushed_down = (u <= lower) & (gradient > 0.0)
    pushed_up = (u >= upper) & (gradient < 0.0)
    fixed = pushed_down | pushed_up
    step = np.zeros_like(u)
    for _ in range(3):
        moves = ~fixed
        damped = np.where(
            moves[:, :, None] & moves[:, None, :],
            matrix,
            0.0,
        )
        damped[:, diagonal, diagonal] *= 1.0 + damping[:, None]
        damped[:, diagonal, diagonal] += np.where(fixed, 1.0, 1e-300)
        held = np.where(fixed, step, 0.0)
        right = gradient + np.einsum("sij,sj->si", matrix, held)
        rights = np.where(moves, right, 0.0)[..., None]
        try:
            found = np.linalg.solve(damped, rights)
        except np.linalg.LinAlgError:  # numbers so far apart that a guess determines nothing
            damped[:, diagonal, diagonal] += 1.0 + 1e-9 * damped.max()
            found = np.linalg.solve(damped, rights)
        step = held - found[..., 0]
        step = np.clip(step, -coordinates.step_limit, coordinates.step_limit)
        crosses = moves & ((u + step < lower) | (u + step > upper))
        if not crosses.any():
            break
        step = np.where(
            crosses,
            np.clip(u + step, lower, upper) - u,
            step,
        )
        fixed |= crosses
    return step


def _scaled_down(
    cost: np.ndarray, gradient: np.ndarray, matrix: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs (S,), and slopes (S, F) and curvatures (S, F, F) of those starts that run away brought to where products are finite.

    The simulation of a bad guess may grow by a hundred powers of ten. A factor that both share changes no step.
    """
    diagonal = np.diagonal(matrix, axis1=1, axis2=2)
    largest = np.abs(diagonal).max(axis=1, initial=0.0)
    runs_away = np.isfinite(largest) & (largest > LARGEST_CURVATURE)
    if not runs_away.any():
        return cost, gradient, matrix
    factor = LARGEST_CURVATURE / np.where(runs_away, largest, LARGEST_CURVATURE)
    return (
        cost,
        gradient * factor[:, None],
        matrix * factor[:, None, None],
    )


@dataclass(eq=False)
class _Descent:
    """Every start of Levenberg-Marquardt on its way down: a row each."""

    problem: LeastSquares
    u: np.ndarray  # solver coordinates, (S, F)
    damping: np.ndarray  # (S,)
    growth: np.ndarray  # factor on the damping after a step that gains nothing, (S,)
    # of the window in use, at ``u``
    cost: np.ndarray = field(init=False)  # (S,)
    gradient: np.ndarray = field(init=False)  # (S, F)
    matrix: np.ndarray = field(init=False)  # (S, F, F)
    idle: np.ndarray = field(init=False)  # steps in a row that gained nothing that matters, (S,)

    def look(self, counts: np.ndarray | None) -> None:
        """Begin with another window, which has so many samples of each run, shape (R,); None is all."""
        linearised = self.problem.linearise(self.u, counts)
        self.cost, self.gradient, self.matrix = _scaled_down(*linearised)
        self.idle = np.zeros(len(self.u), dtype=int)

    def step(self, counts: np.ndarray | None, persistent: bool) -> np.ndarray:
        """Move every start that gains by it; how long the steps were in standard deviations, shape (S,)."""
        coordinates = self.problem.coordinates
        step = bounded_step(
            self.u,
            self.gradient,
            self.matrix,
            self.damping,
            coordinates,
        )
        trial = np.clip(self.u + step, coordinates.lower, coordinates.upper)
        cost, gradient, matrix = _scaled_down(*self.problem.linearise(trial, counts))
        better = np.isfinite(cost) & (cost <= self.cost)
        moved = trial - self.u
        curvature = np.einsum("si,sij,sj->s", moved, self.matrix, moved)
        downhill = -np.einsum("si,si->s", self.gradient, moved)
        gained = self._gained(cost, better)
        self._damp(better, gained, downhill - 0.5 * curvature)
        overshot = persistent & ~better & (downhill > IDLE_GAIN)  # a shorter step gains
        self.idle = np.where((gained < IDLE_GAIN) & ~overshot, self.idle + 1, 0)
        self.u = np.where(better[:, None], trial, self.u)
        self.cost = np.where(better, cost, self.cost)
        self.gradient = np.where(better[:, None], gradient, self.gradient)
        self.matrix = np.where(better[:, None, None], matrix, self.matrix)
        return np.sqrt(np.maximum(curvature, 0.0))

    def _gained(self, cost: np.ndarray, better: np.ndarray) -> np.ndarray:
        """How much lower the costs of better guesses are; the first that can be simulated gains without measure."""
        finite = better & np.isfinite(self.cost)
        return np.where(
            finite,
            np.where(finite, self.cost, 0.0) - np.where(finite, cost, 0.0),
            0.0,
        )

    def _damp(
        self,
        better: np.ndarray,
        gained: np.ndarray,
        promised: np.ndarray,
    ) -> None:
        """Nielsen 1999: the damping follows how much of the promised decrease came true."""
        kept = np.clip(
            gained / np.maximum(promised, np.maximum(gained, 1e-300)),
            0.0,
            1.0,
        )
        factor = np.where(
            better,
            np.maximum(0.1, 1.0 - (2.0 * kept - 1.0) ** 3),
            self.growth,
        )
        self.damping = np.clip(self.damping * factor, 1e-8, 1e10)
        self.growth = np.where(better, 2.0, 2.0 * self.growth)


def levenberg_marquardt(
    problem: LeastSquares,
    starts: np.ndarray,
    windows: Callable[[float], np.ndarray] | None,
    window_iterations: int = 3,
    iterations: int = 30,
    tolerance: float = 1e-4,
    persistent: bool = True,
) -> Solution:
    """Batched Levenberg-Marquardt on growing windows (Marquardt 1963, damping scaled by the diagonal).

    Every start moves in the same launch. It ends when every start's next step is shorter than ``tolerance`` of its own standard
    deviation, or three in a row gain nothing that matters.

    Args:
        problem: What is to be minimised.
        starts: Solver coordinates, shape (S, F).
        windows: How many samples of each run lie in a fraction of its time; None fits everything at once, from a good start.
        window_iterations: On each window but the last.
        iterations: At most so many on the last.
        tolerance: Of a start's step over its standard deviation.
        persistent: Whether a start that overshot three times goes on with shorter steps, until the damping ends it: without that
            it may end far from the least cost, so only a rough fit goes without.

    Returns: where every start ended.
    """
    coordinates = problem.coordinates
    u = np.clip(starts, coordinates.lower, coordinates.upper)
    damping = np.full(len(u), 1e-3)
    descent = _Descent(problem, u, damping, np.full(len(u), 2.0))
    path: list[np.ndarray] = [u.copy()]
    path_cost: list[np.ndarray] = []
    for fraction in WINDOWS if windows is not None else WINDOWS[-1:]:
        last = fraction == WINDOWS[-1]
        counts = None if last or windows is None else windows(fraction)
        descent.look(counts)
        if not path_cost:
            path_cost.append(descent.cost.copy())
        for _ in range(iterations if last else window_iterations):
            size = descent.step(counts, persistent)
            path.append(descent.u.copy())
            path_cost.append(descent.cost.copy())
            ended = (size < tolerance) | (descent.damping > 1e6) | (descent.idle >= 3)
            if last and np.all(ended):
                break
    return Solution(
        descent.u,
        descent.cost,
        np.array(path),
        np.array(path_cost),
        len(path) - 1,
    )


def cosine_annealed(rate: float, iteration: int, iterations: int) -> float:
    """Learning rate of SGDR without restarts (Loshchilov & Hutter 2017, eq. 5), from ``rate`` towards 0.

    Args:
        rate: At the first iteration.
        iteration: Which one, from 0.
        iterations: How many there are.
    """
    return 0.5 * rate * (1.0 + np.cos(np.pi * iteration / iterations))


def adam_descent(
    gradient_of: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    starts: np.ndarray,
    rate: float,
    iterations: int,
    lower: np.ndarray | float = -np.inf,
    upper: np.ndarray | float = np.inf,
) -> Solution:
    """Adam (Kingma & Ba 2015, algorithm 1, their constants) under cosine annealing, all starts at once.

    Args:
        gradient_of: Takes coordinates (S, F), gives cost (S,) and gradient (S, F).
        starts: Coordinates, shape (S, F).
        rate: First learning rate, in coordinate units per iteration.
        iterations: All of them are made.
        lower: Bound of the coordinates, shape (F,) or one for all.
        upper: The other bound.

    Returns: where every start ended.
    """
    u = starts.astype(np.float64).copy()
    first = np.zeros_like(u)
    second = np.zeros_like(u)
    path = [u.copy()]
    path_cost = []
    for n in range(iterations):
        cost, gradient = gradient_of(u)
        path_cost.append(cost.copy())
        first = 0.9 * first + 0.1 * gradient
        second = 0.999 * second + 0.001 * gradient**2
        direction = (first / (1.0 - 0.9 ** (n + 1))) / (
            np.sqrt(second / (1.0 - 0.999 ** (n + 1))) + 1e-8
        )
        u = np.clip(
            u - cosine_annealed(rate, n, iterations) * direction,
            lower,
            upper,
        )
        path.append(u.copy())
    cost, _ = gradient_of(u)
    path_cost.append(cost.copy())
    return Solution(
        u,
        cost,
        np.array(path),
        np.array(path_cost),
        iterations,
    )


def adam(
    problem: LeastSquares,
    starts: np.ndarray,
    iterations: int = 400,
    rate: float = 0.1,
) -> Solution:
    """Adam on the same cost as Levenberg-Marquardt, in units of each unknown's natural length.

    Args:
        problem: What is to be minimised.
        starts: Solver coordinates, shape (S, F).
        iterations: All of them are made.
        rate: First learning rate, in natural lengths per iteration.
    """
    coordinates = problem.coordinates
    natural = coordinates.natural

    def gradient_of(
        scaled: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        cost, gradient, _ = problem.linearise(scaled * natural)
        return cost, gradient * natural

    lower = coordinates.lower / natural
    upper = coordinates.upper / natural
    found = adam_descent(
        gradient_of,
        starts / natural,
        rate,
        iterations,
        lower,
        upper,
    )
    return replace(
        found,
        internal=found.internal * natural,
        path=found.path * natural,
    )


def cma_library() -> Any:
    """Hansen's module ``cma``.

    Raises `ConfigurationError`: It is not installed.
    """
    try:
        import cma as library
    except ImportError as error:
        raise ConfigurationError(
            f"CMA-ES needs the package cma: {to_install('cma')}, or use --solver lm"
        ) from error
    return library


def cma(
    problem: LeastSquares,
    starts: np.ndarray,
    generations: int = 150,
    seed: int = 1,
) -> Solution:
    """CMA-ES (Hansen's ``cma``), one search per start, each generation in one launch.

    Args:
        problem: What is to be minimised.
        starts: Solver coordinates, shape (S, F).
        generations: At most so many.
        seed: Of its random numbers.

    Raises:
        ConfigurationError: The library is not installed.
    """
    library = cma_library()
    coordinates = problem.coordinates
    natural = coordinates.natural
    bounds = [
        list(coordinates.lower / natural),
        list(coordinates.upper / natural),
    ]
    options = {
        "bounds": bounds,
        "seed": seed,
        "verbose": -9,
        "maxiter": generations,
        "tolfun": 1e-9,
        "tolx": 1e-9,
    }
    paths = []
    path_costs = []
    for start in starts:
        search = library.CMAEvolutionStrategy(start / natural, 0.5, options)
        path = [start]
        path_cost = [float(problem.linearise(start[None])[0][0])]
        while not search.stop():
            asked = np.array(search.ask())
            cost = problem.linearise(asked * natural)[0]
            search.tell(
                list(asked),
                list(np.where(np.isfinite(cost), cost, 1e30)),
            )
            path.append(np.asarray(search.result.xbest) * natural)
            path_cost.append(float(search.result.fbest))
        paths.append(path)
        path_costs.append(path_cost)
    # a search that ends early stays where it ended
    length = max(len(path) for path in paths)
    padded = np.array([_lengthened(path, length) for path in paths]).transpose(1, 0, 2)
    padded_cost = np.array([_lengthened(cost, length) for cost in path_costs]).T
    return Solution(
        padded[-1],
        padded_cost[-1],
        padded,
        padded_cost,
        length - 1,
    )


def _lengthened(values: list[Any], length: int) -> list[Any]:
    """The same with the last one again and again, up to a length."""
    return values + [values[-1]] * (length - len(values))
