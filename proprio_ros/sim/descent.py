"""Thousands of fits of single joints at once, on the processor or a graphics card: one launch for all recordings and starts.

The method is that of ``identification/solvers.py``, start by start and fit by fit (growing windows, Marquardt's damping after
Nielsen, bounds, when a fit has ended), so both end at the same numbers but for the order in which sums are taken. What differs is
where things are: everything stays on the device from the first guess to the last, and the host hears once per iteration how many
fits go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim import descent_kernels as kernels
from proprio_ros.sim import runtime
from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator
from proprio_ros.sim.rollout_kernels import rollout
from proprio_ros.sim.runtime import FLOAT

_BLOCK = 64
"""Threads of a card that share a multiprocessor: few, since each is a whole rollout that needs many registers."""
_IDLE = JointRun(np.ones(1), np.zeros(1), np.zeros(1))
_STATES = ("u", "gradient", "trial", "trial_gradient", "step")
_NUMBERS = ("cost", "trial_cost", "damping", "growth", "size")
_COORDINATES = ("lower", "upper", "step_limit", "scale", "prior_mean")


@dataclass(frozen=True)
class AffineFit:
    """A fit of F unknowns to R runs of a joint, whose simulator's parameters are affine in the unknowns.

    Solver coordinates are those of ``Coordinates`` in ``identification/unknowns.py``.
    """

    runs: Sequence[JointRun]
    measured: Sequence[np.ndarray]  # positions of each run, (T,) [rad]
    weight: Sequence[np.ndarray]  # one over their standard deviations, (T,)
    ripple: (
        np.ndarray
    )  # the encoder of each run shows ``q + a cos q + b sin q``: a and b [rad], (R, 2)
    offset: np.ndarray  # parameters where all unknowns are 0, (R, P)
    slope: np.ndarray  # what each unknown adds, (R, P, F)
    lower: np.ndarray  # bounds in solver coordinates, (F,)
    upper: np.ndarray
    step_limit: np.ndarray  # longest step, (F,)
    scale: np.ndarray  # of coordinates that are an inverse hyperbolic sine, else 0, (F,)
    prior_mean: np.ndarray  # in physical units, (F,)
    prior_precision: np.ndarray  # (F, F)
    starts: np.ndarray  # solver coordinates, (S, F)


@dataclass(frozen=True)
class Rules:
    """How far a descent goes; ``levenberg_marquardt`` explains them."""

    windows: Sequence[float]  # parts of each run's time, the last is all of it
    window_iterations: int  # on each window but the last
    iterations: int  # at most, on the last
    tolerance: float
    persistent: bool
    idle_gain: float
    largest_curvature: float
    settling: int = 3  # undamped steps at the end, which the solver of one problem does not take


@dataclass(frozen=True)
class Descended:
    """Where the starts of one fit ended; the fields are those of ``Solution``."""

    internal: np.ndarray  # (S, F)
    cost: np.ndarray  # (S,)
    path: np.ndarray  # (I, S, F)
    path_cost: np.ndarray  # (I, S)
    iterations: int


class Descents:
    """Many fits with as many unknowns each, ready to run.

    Args:
        fits: They may differ in runs, samples and starts.
        rules: How far they go.
        device: ``"cpu"`` or a graphics card's name.
        integrator: As of ``JointSimulator``.

    Raises:
        SimulationError: There are no fits, or their numbers of unknowns differ.
    """

    def __init__(
        self,
        fits: Sequence[AffineFit],
        rules: Rules,
        device: str = "cpu",
        integrator: str = "rk4",
    ) -> None:
        if len({len(fit.lower) for fit in fits}) != 1:
            raise SimulationError("fits of one launch have one number of unknowns")
        self.fits = tuple(fits)
        self.rules = rules
        self.device = device
        runs = [run for fit in fits for run in fit.runs]
        # finished fits wait in a run of their own, which has no samples
        self._simulator = JointSimulator([*runs, _IDLE], integrator, device)
        self._known = self._fits_struct(len(runs))
        self._guesses = self._guesses_struct()
        self._launch = self._rollout()

    # ------------------------------------------------------------------------------------------------- What goes to the device

    def _floats(self, values: np.ndarray) -> wp.array:
        return wp.array(
            np.ascontiguousarray(values, dtype=np.float64), dtype=FLOAT, device=self.device
        )

    def _ints(self, values: np.ndarray | Sequence[int]) -> wp.array:
        return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=self.device)

    def _empty(self, *shape: int, kind: Any = FLOAT) -> wp.array:
        return wp.zeros(shape, dtype=kind, device=self.device)

    def _fits_struct(self, idle_run: int) -> Any:
        """What is known about the fits."""
        fits = self.fits
        starts = [len(fit.starts) for fit in fits]
        runs = [len(fit.runs) for fit in fits]
        first_run = np.cumsum([0, *runs])
        worlds_of_guess = np.repeat(runs, starts)
        self._first_guess = np.cumsum([0, *starts])
        # a guess's worlds are side by side: the runs of its fit in their order
        self._run_of = np.concatenate(
            [
                np.tile(np.arange(first, first + count), guesses)
                for first, count, guesses in zip(first_run[:-1], runs, starts, strict=True)
            ]
        )
        known = kernels.Fits()
        known.fit_of = self._ints(np.repeat(np.arange(len(fits)), starts))
        known.first_guess = self._ints(self._first_guess)
        known.first_world = self._ints(np.cumsum([0, *worlds_of_guess]))
        known.run_of = self._ints(self._run_of)
        known.idle_run = idle_run
        known.offset = self._floats(np.concatenate([fit.offset for fit in fits]))
        known.slope = self._floats(np.concatenate([fit.slope for fit in fits]))
        known.harmless = self._floats(self._simulator.harmless)
        for name in (*_COORDINATES, "prior_precision"):
            setattr(known, name, self._floats(np.stack([getattr(fit, name) for fit in fits])))
        known.idle_gain = self.rules.idle_gain
        known.largest_curvature = self.rules.largest_curvature
        known.persistent = int(self.rules.persistent)
        return known

    def _guesses_struct(self) -> Any:
        """Every start where it begins."""
        starts = np.concatenate([np.clip(fit.starts, fit.lower, fit.upper) for fit in self.fits])
        count, size = starts.shape
        rules = self.rules
        longest = 1 + rules.window_iterations * (len(rules.windows) - 1) + rules.iterations
        guesses = kernels.Guesses()
        for name in _STATES:
            setattr(guesses, name, self._empty(count, size))
        for name in _NUMBERS:
            setattr(guesses, name, self._empty(count))
        for name in ("matrix", "trial_matrix", "factor"):
            setattr(guesses, name, self._empty(count, size, size))
        for name in ("lost", "idle"):
            setattr(guesses, name, self._empty(count, kind=wp.int32))
        guesses.fixed = self._empty(count, size, kind=wp.int32)
        guesses.running = self._empty(len(self.fits), kind=wp.int32)
        guesses.path = self._empty(longest, count, size)
        guesses.path_cost = self._empty(longest, count)
        self._starts = self._floats(starts)
        return guesses

    def _rollout(self) -> Any:
        """The recorded launch of all worlds, with the arrays that it reads and writes."""
        simulator = self._simulator
        worlds = len(self._run_of)
        parameters, unknowns = self.fits[0].slope.shape[1:]
        directions = next((s for s in simulator.tangent_sizes if s >= unknowns), unknowns)
        tangents = np.zeros((worlds, parameters, directions))
        slopes = np.concatenate([fit.slope for fit in self.fits])
        tangents[:, :, :unknowns] = slopes[self._run_of]
        rise = INDEX["stribeck"]
        stribeck = bool(
            slopes[:, rise].any() or any(fit.offset[:, rise].any() for fit in self.fits)
        )
        self._sums = self._sums_struct(worlds, directions)
        self._counts = self._ints(simulator.sample_counts)
        self._world_run = self._empty(worlds, kind=wp.int32)
        self._p = self._empty(worlds, parameters)
        vec = wp.types.vector(length=directions, dtype=FLOAT)
        dp = wp.array(tangents, dtype=vec, device=self.device)
        return runtime.launch(
            rollout(kernels.fitted_law(directions, stribeck), simulator.integrator),
            dim=worlds,
            inputs=[*simulator.run_data(self._counts), self._world_run, self._p, dp],
            outputs=[self._sums],
            device=self.device,
            block_dim=_BLOCK,
            record_cmd=True,
        )

    def _sums_struct(self, worlds: int, directions: int) -> Any:
        """What was measured, and room for every world's normal equations."""
        counts = self._simulator.sample_counts
        measured = np.zeros((len(counts), int(counts.max())))
        weight = np.zeros_like(measured)
        row = 0
        for fit in self.fits:
            for position, one_over_std in zip(fit.measured, fit.weight, strict=True):
                measured[row, : len(position)] = position
                weight[row, : len(position)] = one_over_std
                row += 1
        sums = kernels.Sums()
        sums.measured = self._floats(measured)
        sums.weight = self._floats(weight)
        # the run of those that wait has none
        sums.ripple = self._floats(
            np.concatenate([*(fit.ripple for fit in self.fits), np.zeros((1, 2))])
        )
        sums.run_of = self._known.run_of
        sums.cost = self._empty(worlds)
        sums.gradient = self._empty(directions, worlds)
        sums.matrix = self._empty(directions, directions, worlds)
        return sums

    # ------------------------------------------------------------------------------------------------------------ The descent

    def run(self) -> list[Descended]:
        """Every fit from its starts to where they end."""
        rules = self.rules
        guesses = self._guesses
        self._begin()
        iteration = 0
        for fraction in rules.windows:
            last = fraction == rules.windows[-1]
            self._look_at(1.0 if last else fraction)
            wp.copy(guesses.trial, guesses.u)
            self._simulate()
            self._each_guess(kernels.look, iteration, self._known, guesses, self._sums, self._p)
            for _ in range(rules.iterations if last else rules.window_iterations):
                iteration += 1
                self._each_guess(kernels.propose, self._known, guesses)
                self._simulate()
                self._each_guess(
                    kernels.judge, iteration, self._known, guesses, self._sums, self._p
                )
                if last and not self._going_on(iteration):
                    break
        self._settle()
        return self._ended()

    def _settle(self) -> None:
        """Undamped steps of all fits that have ended, from where they did: rounding decides no longer where that is."""
        guesses = self._guesses
        guesses.running.assign(1 - guesses.running.numpy())
        guesses.damping.fill_(kernels.SMALLEST_DAMPING)
        for _ in range(self.rules.settling):
            self._each_guess(kernels.propose, self._known, guesses)
            self._simulate()
            self._each_guess(kernels.settle, self._known, guesses, self._sums, self._p)

    def linearise(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cost (G,), gradient (G, F) and Gauss-Newton matrix (G, F, F) of every start, in solver coordinates, over all samples."""
        guesses = self._guesses
        self._begin()
        self._look_at(1.0)
        wp.copy(guesses.trial, guesses.u)
        self._simulate()
        self._each_guess(kernels.look, 0, self._known, guesses, self._sums, self._p)
        return (
            guesses.cost.numpy().copy(),
            guesses.gradient.numpy().copy(),
            guesses.matrix.numpy().copy(),
        )

    def _begin(self) -> None:
        guesses = self._guesses
        wp.copy(guesses.u, self._starts)
        guesses.damping.fill_(kernels.FIRST_DAMPING)
        guesses.growth.fill_(kernels.FIRST_GROWTH)
        guesses.running.fill_(1)
        self._iterations = self._empty(len(self.fits), kind=wp.int32)

    def _look_at(self, fraction: float) -> None:
        """Only the first part of every run's time counts from now on."""
        counts = self._simulator.windows(fraction)
        if fraction == 1.0:
            counts = self._simulator.sample_counts.copy()
        counts[self._known.idle_run] = 0
        self._counts.assign(counts)

    def _each_guess(self, kernel: Any, *inputs: Any) -> None:
        count = int(self._first_guess[-1])
        runtime.launch(kernel, dim=count, inputs=list(inputs), device=self.device)

    def _simulate(self) -> None:
        """All worlds where their guesses try to go."""
        for array in (self._sums.cost, self._sums.gradient, self._sums.matrix):
            array.zero_()
        self._each_guess(kernels.place, self._known, self._guesses, self._world_run, self._p)
        self._launch.launch()

    def _going_on(self, iteration: int) -> int:
        """How many fits have not ended."""
        going_on = self._empty(1, kind=wp.int32)
        runtime.launch(
            kernels.end,
            dim=len(self.fits),
            inputs=[iteration, self.rules.tolerance, self._known, self._guesses],
            outputs=[self._iterations, going_on],
            device=self.device,
        )
        return int(going_on.numpy()[0])

    def _ended(self) -> list[Descended]:
        guesses = self._guesses
        internal = guesses.u.numpy()
        cost = guesses.cost.numpy()
        path = guesses.path.numpy()
        path_cost = guesses.path_cost.numpy()
        found = []
        for row, made in enumerate(self._iterations.numpy().tolist()):
            own = slice(self._first_guess[row], self._first_guess[row + 1])
            path[made, own] = internal[own]  # where it settled
            path_cost[made, own] = cost[own]
            found.append(
                Descended(
                    internal[own].copy(),
                    cost[own].copy(),
                    path[: made + 1, own].copy(),
                    path_cost[: made + 1, own].copy(),
                    made,
                )
            )
        return found
