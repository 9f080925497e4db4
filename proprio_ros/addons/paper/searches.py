"""Figures 6 and 7: searches with gradients and without on one problem, and what their cost looks like."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from proprio_ros.addons.paper.cases import (
    CUBES,
    LIFT,
    Rows,
    box,
    calibrated_robot,
    one_lift,
    payload,
    soft_cube,
    squeezed,
)
from proprio_ros.addons.paper.hand import play
from proprio_ros.addons.paper.ways import SphereLastFrame
from proprio_ros.identification import solvers
from proprio_ros.identification.problem import Problem
from proprio_ros.probes.payload.paper import PaperOptions, last_frame_loss

EVALUATIONS = 150  # simulations that each search may ask for


class Watched:
    """A problem, with every cost that a search asked for and when it was known."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.coordinates = problem.coordinates
        self.cost: list[float] = []
        self.seconds: list[float] = []
        self.began = time.process_time()  # and later by what is not part of the search

    def linearise(self, internal: np.ndarray, counts: Any = None) -> Any:
        """As `Problem.linearise`."""
        found = self._problem.linearise(internal, counts)
        now = time.process_time()
        self.seconds += [now - self.began] * len(internal)
        # on a window that still grows the cost is another: what is drawn is that of all samples
        whole = found if counts is None else self._problem.linearise(internal)
        self.cost += whole[0].tolist()
        self.began += time.process_time() - now
        return found


def optimisers(seed: int) -> Rows:
    """Figure 6: cost over simulations and over time, the same problem and first guess for every search."""
    held, facts = payload("heavy ball")
    run = play("payload_elbow", seed, held).runs[LIFT]
    robot = calibrated_robot(seed, "empty_hand_elbow")
    problem = one_lift(robot, run, facts)
    rng = np.random.default_rng((seed, 6))
    first = problem.coordinates.prior_mean.copy()
    first[0] = float(np.exp(rng.uniform(np.log(0.002), np.log(0.5))))
    start = problem.coordinates.internal(first[None])
    windows = problem.simulator.windows
    searches: dict[str, Callable[[Watched], Any]] = {
        "Levenberg-Marquardt (ours)": lambda watched: solvers.levenberg_marquardt(
            watched, start, windows
        ),
        "Adam": lambda watched: solvers.adam(watched, start, EVALUATIONS - 1),
        "CMA-ES": lambda watched: solvers.cma(
            watched, start, generations=EVALUATIONS // 7, seed=seed + 1
        ),
        "tree-structured Parzen": lambda watched: _parzen(watched, first, start[0], rng),
    }
    # compiles, and loads the library, before anyone is timed
    solvers.cma(problem, start, generations=1)
    rows = []
    for name, search in searches.items():
        watched = Watched(problem)
        search(watched)
        costs = np.where(np.isfinite(watched.cost), watched.cost, 1e12)
        best = np.minimum.accumulate(costs)[:EVALUATIONS]
        rows.append(
            {
                "search": name,
                "cost": best.tolist(),
                "seconds": watched.seconds[: len(best)],
            }
        )
    least = min(row["cost"][-1] for row in rows)
    return {"rows": [{**row, "cost": [cost / least for cost in row["cost"]]} for row in rows]}


def _parzen(
    watched: Watched,
    first: np.ndarray,
    start: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """The tree-structured estimator on masses of 1 g to 1 kg, from a first guess (F,) and what it is inside, (F,)."""
    coordinates = watched.coordinates
    natural = coordinates.natural
    low = start - 5.0 * natural
    high = start + 5.0 * natural
    guesses = np.array([[1e-3, *first[1:]], [1.0, *first[1:]]])
    ends = coordinates.internal(guesses)
    low[0], high[0] = ends[:, 0]
    tree_parzen(lambda x: float(watched.linearise(x[None])[0][0]), low, high, start, rng)


def tree_parzen(
    cost: Callable[[np.ndarray], float],
    low: np.ndarray,
    high: np.ndarray,
    first: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Tree-structured Parzen estimator (Bergstra et al. 2011) in a box, one coordinate at a time; the best point, shape (F,).

    The best quarter of the points (at most 25) makes one density, the others make the other; of 24 draws from the first the one
    with the greatest ratio of the two is tried next. Ten points come first, nine of them drawn evenly.

    Args:
        cost: Of a point, shape (F,).
        low: The box's lower ends, shape (F,).
        high: Its upper ends, shape (F,).
        first: The first guess, shape (F,).
        rng: Draws the points.
    """
    points = [first]
    costs = [cost(first)]
    while len(points) < EVALUATIONS:
        drawn = rng.uniform(low, high)
        if len(points) >= 10:
            order = np.argsort(np.where(np.isfinite(costs), costs, np.inf))
            count = min(max(len(points) // 4, 2), 25)
            good = np.array(points)[order[:count]]
            bad = np.array(points)[order[count:]]
            for axis, ends in enumerate(zip(low, high, strict=True)):
                better = _mixture(good[:, axis], *ends)
                worse = _mixture(bad[:, axis], *ends)
                centres, widths = better
                chosen = rng.integers(len(centres), size=24)
                tried = np.clip(
                    centres[chosen] + widths[chosen] * rng.standard_normal(24),
                    *ends,
                )
                drawn[axis] = tried[
                    np.argmax(_logarithm(tried, *better) - _logarithm(tried, *worse))
                ]
        points.append(drawn)
        costs.append(cost(drawn))
    return points[int(np.argmin(costs))]


def _mixture(
    points: np.ndarray,
    low: float,
    high: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Centres and widths of a normal density about every point, as wide as its neighbours are apart, and of one over all."""
    ordered = np.sort(points)
    gaps = np.diff(ordered, prepend=low, append=high)
    span = high - low
    widths = np.clip(
        np.maximum(gaps[:-1], gaps[1:]),
        span / min(100, len(points) + 1),
        span,
    )
    return np.append(
        ordered,
        0.5 * (low + high),
    ), np.append(widths, span)


def _logarithm(
    x: np.ndarray,
    centres: np.ndarray,
    widths: np.ndarray,
) -> np.ndarray:
    """Of the densities' mean at x, shape (K,), less a constant."""
    distance = (x[:, None] - centres) / widths
    densities = np.exp(-0.5 * distance**2) / widths
    return np.log(densities.mean(axis=1) + 1e-300)


def landscapes(seed: int) -> Rows:
    """Figure 7: the cost of the three experiments over what is searched for: last frame, and all samples."""
    return {"rows": [_over_mass(seed), _over_sphere(seed), _over_modulus(seed)]}


def _over_mass(seed: int) -> Rows:
    held, facts = payload("heavy ball")
    run = play("payload_elbow", seed, held).runs[LIFT]
    robot = calibrated_robot(seed, "empty_hand_elbow")
    loss = last_frame_loss(robot, run, facts, PaperOptions())
    masses = np.linspace(0.0, 0.15, 76)
    whole = one_lift(robot, run, facts)
    inside = np.tile(whole.coordinates.prior_mean, (len(masses), 1))
    inside[:, 0] = masses
    q, _, _ = whole.simulate(whole.all_values(inside), whole.estimated)
    seen = whole.runs[0]
    last = loss(np.maximum(masses, 1e-6)[:, None])[0]
    off = q[:, 0, : seen.used] - seen.position
    every = (off**2).mean(axis=1)
    return _landscape("payload", masses, held.mass_kg, last, every)


def _over_sphere(seed: int) -> Rows:
    held, facts, _ = box()
    run = play("container", seed, held).runs[LIFT]
    robot = calibrated_robot(seed, "empty_hand_container")
    masses = np.linspace(0.001, 0.04, 79)
    last = SphereLastFrame(robot, run, facts)(masses[:, None])[0]
    all_samples = SphereLastFrame(robot, run, facts, all_samples=True)
    every = all_samples(masses[:, None])[0] / all_samples.samples
    return _landscape("sphere", masses, held.sphere_mass_kg, last, every)


def _over_modulus(seed: int) -> Rows:
    modulus, ratio = CUBES["heavy cube"]
    run = play("softness", seed, soft_cube("heavy cube")).runs[-1]
    robot = calibrated_robot(seed, "empty_hand_gripper")
    moduli = np.geomspace(1e3, 1e5, 61)
    problem, q = squeezed(robot, run, moduli.tolist(), ratio)
    off = q - problem.runs[0].position
    return _landscape("squeeze", moduli, modulus, off[:, -1] ** 2, (off**2).mean(axis=1))


def _landscape(
    name: str,
    x: np.ndarray,
    truth: float,
    last: np.ndarray,
    every: np.ndarray,
) -> Rows:
    return {
        "experiment": name,
        "x": x.tolist(),
        "truth": truth,
        "last": last.tolist(),
        "all": every.tolist(),
    }
