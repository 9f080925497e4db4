"""One driven joint with everything else locked, with its exact tangents.

Equation (1) of the paper (Chen et al. 2025, arXiv:2410.03920) for one degree of freedom, as docs/pages/how_it_works.md writes it
down. The rollout starts when the command does, at time 0 in state (q0, v0); sample k is compared at ``t_k - delay``, so the delay
from command to motion shifts the observation and needs no moving discontinuity.

Departures from the paper: armature, friction, supply limit and delay are ours (leaving one of them out costs 10 g or more);
the default integrator is RK4, because the substep error of the paper's equation (2), semi-implicit Euler, is itself grams of
mass. ``integrator="semi_implicit"`` is equation (2) to the letter.

Tests hold the forward sensitivities of the rollout against ``wp.Tape`` over a kernel that stores every state. The law is in
``joint_kernels.py``, the walk through time in ``rollout_kernels.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim import runtime
from proprio_ros.sim.joint_kernels import (
    PARAMETERS,
    VEC3,
    JointData,
    joint_law,
)
from proprio_ros.sim.rollout_kernels import TIME_EPS, Law, rollout
from proprio_ros.sim.runtime import FLOAT

INDEX = {name: row for row, name in enumerate(PARAMETERS)}
INTEGRATORS = ("rk4", "semi_implicit")
_TANGENT_SIZES = (1, 3, 6, 16, 18, 24, 32)
"""Each is two kernels that a new computer compiles ahead, for a second and more: between 6 and 16 none is worth that. All 14
parameters go in 16 directions, which fill a processor's vectors: with AVX-512 in two thirds of the time that 14 take."""


def harmless(parameters: Sequence[str]) -> np.ndarray:
    """Parameters of a world that does nothing, shape (P,)."""
    return np.array([float(name in ("inertia", "stribeck_velocity")) for name in parameters])


@dataclass(frozen=True)
class JointRun:
    """What one rollout is driven by and where it is looked at."""

    sample_times_s: np.ndarray  # encoder stamps after command onset [s], shape (T,), increasing
    input_times_s: np.ndarray  # when the current changes [s], shape (S,), increasing, first at 0
    input_current_A: np.ndarray  # the current from each of those instants on [A], shape (S,)
    # (voltage [V], back-EMF constant [V s/rad], resistance [ohm]); voltage 0 means no limit
    supply: tuple[float, float, float] = (0.0, 0.0, 1.0)
    friction_velocity: float = 1e-3  # v_s, where Coulomb's law is smoothed [rad/s]
    # longest integration step [s]; 1/60/substeps makes semi-implicit Euler the paper's
    step_s: float = 1.0 / 240.0
    # step while the joint is near standstill [s]; equal to ``step_s`` where there is no dry friction
    fine_step_s: float = 1.0 / 240.0
    # load from each of those instants on beside gravity's, shape (S, 2): with an empty hand [N m], and what each
    # kilogram carried adds [N m/kg]; None is none
    input_load: np.ndarray | None = None


@dataclass(frozen=True)
class _Padded:
    """All runs of a simulator side by side, each with zeros behind its end."""

    sample_counts: np.ndarray  # (R,), int32
    input_counts: np.ndarray  # (R,), int32
    sample_times_s: np.ndarray  # (R, T)
    input_times_s: np.ndarray  # (R, S)
    inputs: np.ndarray  # current, and the two of ``input_load``, (R, S, 3)
    constants: np.ndarray  # supply and friction velocity, (R, 4)
    steps_s: np.ndarray  # coarse and fine, (R, 2)

    @classmethod
    def of(cls, runs: Sequence[JointRun]) -> _Padded:
        sample_counts = np.array(
            [len(run.sample_times_s) for run in runs],
            dtype=np.int32,
        )
        input_counts = np.array(
            [len(run.input_times_s) for run in runs],
            dtype=np.int32,
        )
        samples = np.zeros((len(runs), int(sample_counts.max())))
        switch_times = np.zeros((len(runs), int(input_counts.max())))
        inputs = np.zeros((*switch_times.shape, 3))
        constants = np.zeros((len(runs), 4))
        steps = np.zeros((len(runs), 2))
        for row, run in enumerate(runs):
            samples[row, : sample_counts[row]] = run.sample_times_s
            switch_times[row, : input_counts[row]] = run.input_times_s
            inputs[row, : input_counts[row], 0] = run.input_current_A
            if run.input_load is not None:
                inputs[row, : input_counts[row], 1:] = run.input_load
            constants[row] = (*run.supply, run.friction_velocity)
            steps[row] = (
                run.step_s,
                min(run.fine_step_s, run.step_s),
            )
        return cls(
            sample_counts,
            input_counts,
            samples,
            switch_times,
            inputs,
            constants,
            steps,
        )


def samples_within(times_s: np.ndarray, counts: np.ndarray, fraction: float) -> np.ndarray:
    """How many samples of each of R runs lie in the first part of its time, at least three, shape (R,), int32.

    Args:
        times_s: Of the samples, each row from 0 on [s]; behind its samples a row may have anything, shape (R, T).
        counts: How many samples each run has, shape (R,).
        fraction: Of each run's time.
    """
    ends = times_s[np.arange(len(counts)), counts - 1]
    within = times_s <= (fraction * ends + TIME_EPS)[:, None]
    within &= np.arange(times_s.shape[1]) < counts[:, None]
    return np.minimum(np.maximum(within.sum(axis=1, dtype=np.int32), 3), counts)


class JointSimulator:
    """Rolls out many worlds (guesses) of one or more runs of single joints in one launch.

    Args:
        runs: The runs; worlds refer to them by index. Runs may have different lengths.
        integrator: One of ``INTEGRATORS``.
        device: Where the kernels run: ``"cpu"`` or a graphics card, as `runtime.device_named` gives it.

    Raises:
        ConfigurationError: Warp cannot keep compiled kernels.
        SimulationError: Unknown integrator, no runs, or a run without samples.
    """

    parameters: tuple[str, ...] = PARAMETERS
    harmless: np.ndarray = harmless(PARAMETERS)
    tangent_sizes: tuple[int, ...] = _TANGENT_SIZES

    def __init__(
        self, runs: Sequence[JointRun], integrator: str = "rk4", device: str = "cpu"
    ) -> None:
        runtime.check()
        if integrator not in INTEGRATORS:
            raise SimulationError(
                f"unknown integrator {integrator!r}: choose one of {', '.join(INTEGRATORS)}"
            )
        if not runs or any(len(run.sample_times_s) == 0 for run in runs):
            raise SimulationError(
                "nothing to simulate: every run needs at least one sample after the command's onset"
            )
        self.runs = tuple(runs)
        self.integrator = integrator
        self.device = device
        padded = _Padded.of(runs)
        self.sample_counts = padded.sample_counts
        self.sample_counts.setflags(write=False)
        self._width = int(self.sample_counts.max())
        self._times_s = padded.sample_times_s
        self._samples = self._array(padded.sample_times_s)
        self._switch_times = self._array(padded.input_times_s)
        self._inputs = wp.array(padded.inputs, dtype=VEC3, device=device)
        self._constants = self._array(padded.constants)
        self._steps = self._array(padded.steps_s)
        self._input_counts = wp.array(padded.input_counts, dtype=wp.int32, device=device)
        self._full_counts = wp.array(self.sample_counts, dtype=wp.int32, device=device)
        self._launches: dict[tuple[int, int, bool], _Launch] = {}

    # A simulator of something else in the hand is a subclass that overrides the class attributes above and these:

    def law_of(self, size: int, stribeck: bool) -> Law:
        """What moves, with so many tangents, where friction may rise towards standstill or not."""
        return joint_law(size, stribeck)

    def usual_kernels(self) -> list[Any]:
        """All that fits of this law may need, as `compile_kernels` compiles them ahead."""
        return [self.kernel_of(*kind) for kind in kinds_of_kernel(self.usual_sizes(), True)]

    @classmethod
    def usual_sizes(cls) -> list[int]:
        """Of ``tangent_sizes`` those that fits need: up to the first that has room for all parameters, where one has."""
        # more directions than parameters come only from callers of their own
        enough = [size for size in cls.tangent_sizes if size >= len(cls.parameters)]
        most = enough[0] if enough else cls.tangent_sizes[-1]
        return [size for size in cls.tangent_sizes if size <= most]

    def kernel_of(self, size: int, stribeck: bool) -> Any:
        """The walk through time of what `law_of` gives."""
        return rollout(self.law_of(size, stribeck), self.integrator)

    def law_data(self) -> Any:
        """The law's struct of what is known about the runs."""
        data = JointData()
        data.constants = self._constants
        return data

    def output_arrays(self, worlds: int, size: int) -> list[wp.array]:
        """Arrays for the fields of the law's struct of results, in their order."""
        vec = wp.types.vector(length=size, dtype=FLOAT)
        shape = (worlds, self._width)
        return [self._zeros(shape, kind) for kind in (FLOAT, FLOAT, vec)]

    def launch(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray | None,
    ) -> tuple[np.ndarray, ...]:
        """All results of one launch, padded to one of ``tangent_sizes`` directions.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters, shape (W, P).
            dp: Tangent directions, shape (W, P, D).
            counts: Samples of each run that are computed, shape (R,); None is all.
        """
        worlds, _, directions = dp.shape
        size = next(
            (s for s in self.tangent_sizes if s >= directions),
            directions,
        )
        stribeck = bool(p[:, INDEX["stribeck"]].any() or dp[:, INDEX["stribeck"]].any())
        launch = self._launches.get((worlds, size, stribeck))
        if launch is None:
            launch = _Launch(self, worlds, size, stribeck)
            self._launches[worlds, size, stribeck] = launch
        lost = ~np.isfinite(p).all(axis=1)
        if lost.any():  # a rollout of what is no number would not end
            p = np.where(lost[:, None], self.harmless, p)
        results = launch(
            world_run,
            p,
            dp,
            self.sample_counts if counts is None else counts,
        )
        if lost.any():
            results[0][lost] = np.nan
            results[1][lost] = np.nan
        return results

    def _array(self, values: np.ndarray) -> wp.array:
        return wp.array(
            np.ascontiguousarray(values, dtype=np.float64),
            dtype=FLOAT,
            device=self.device,
        )

    def _zeros(
        self,
        shape: int | tuple[int, ...],
        kind: Any = FLOAT,
        **options: bool,
    ) -> wp.array:
        return wp.zeros(shape, dtype=kind, device=self.device, **options)

    def windows(self, fraction: float) -> np.ndarray:
        """How many samples of each run lie in the first ``fraction`` of its time, at least three; shape (R,), int32."""
        return samples_within(self._times_s, self.sample_counts, fraction)

    def jacobian(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and velocities at the sample instants with exact forward sensitivities.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters of each world in the order of ``PARAMETERS``, shape (W, P); where one is not finite, the world is NaN.
            dp: D tangent directions of each world in parameter space, shape (W, P, D); a read-only array that comes again is
                not copied again (nor are ``world_run`` and ``counts``).
            counts: Only the first ``counts[r]`` samples of run r are computed, shape (R,); default all.

        Returns:
            q (W, T), v (W, T), dq (W, T, D). Columns past a run's count hold stale numbers. The arrays are views of
            buffers that the next call of the same shape overwrites.
        """
        q, v, dq, *_ = self.launch(world_run, p, dp, counts)
        return q, v, dq[:, :, : dp.shape[2]]

    def run_data(self, counts: wp.array) -> list[Any]:
        """What every kernel knows about the runs, in its order."""
        times = self._switch_times
        inputs = self._inputs
        return [
            self._samples,
            counts,
            times,
            inputs,
            self._input_counts,
            self._steps,
            self.law_data(),
        ]

    def rollout(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities at the sample instants, shapes (W, T); arguments as in ``jacobian``."""
        q, v, _ = self.jacobian(
            world_run,
            p,
            np.zeros((*p.shape, 1)),
        )
        return q.copy(), v.copy()


def compile_kernels(integrator: str = "rk4", *, rises: bool = True) -> None:
    """Compile and load the kernels of all usual sizes, for whoever cannot wait for one later; again it costs nothing.

    Where the robot's friction may rise towards standstill (``rises``), they are nearly as many again.
    """
    kinds = kinds_of_kernel(JointSimulator.usual_sizes(), rises)
    runtime.load([rollout(joint_law(*kind), integrator) for kind in kinds], "cpu")


def kinds_of_kernel(
    sizes: Sequence[int],
    rises: bool,
) -> list[tuple[int, bool]]:
    """Size, and whether friction rises towards standstill, of each kernel that fits may need; the last size has all parameters."""
    # all parameters at once are more than some fits have unknowns, and the rise is one of them on every robot
    return [
        (size, stribeck)
        for size in sizes
        for stribeck in (False, True)
        if rises or not stribeck or size == sizes[-1]
    ]


def plain_kernel(directions: int, integrator: str) -> Any:
    """The joint's own kernel for runs with an empty hand among those of another law, which has more parameters."""
    return rollout(
        joint_law(_size_of(min(directions, len(PARAMETERS))), True),
        integrator,
    )


def _size_of(directions: int) -> int:
    return next(size for size in _TANGENT_SIZES if size >= directions)


class _Launch:
    """Buffers and recorded launch for one batch shape: a recorded launch costs a fifth of a fresh one."""

    def __init__(
        self,
        owner: JointSimulator,
        worlds: int,
        size: int,
        stribeck: bool,
    ) -> None:
        vec = wp.types.vector(length=size, dtype=FLOAT)
        shape = (worlds, len(owner.parameters))
        counts = wp.clone(owner._full_counts)
        world_run = owner._zeros(worlds, wp.int32)
        p = owner._zeros(shape)
        dp = owner._zeros(shape, vec)
        self._outputs = owner.output_arrays(worlds, size)
        law = owner.law_of(size, stribeck)
        out = law.out()
        for name, array in zip(law.out.vars, self._outputs, strict=True):
            setattr(out, name, array)
        inputs = [*owner.run_data(counts), world_run, p, dp]
        self._command = runtime.launch(
            owner.kernel_of(size, stribeck),
            dim=worlds,
            inputs=inputs,
            outputs=[out],
            device=owner.device,
            others=owner.usual_kernels,
            record_cmd=True,
        )
        # on the CPU a Warp array is the host's own memory: written and read in place, without a copy
        self._in_place = p.device.is_cpu
        self._inputs = (world_run, counts, p, dp)
        self._views = [array.numpy() for array in self._inputs]
        self._given: list[np.ndarray | None] = [None] * len(self._views)
        self._results = self._read()

    def __call__(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        for at, values in enumerate((world_run, counts, p, dp)):
            self._put(at, values)
        self._command.launch()
        if not self._in_place:
            self._results = self._read()
        return self._results

    def _read(self) -> tuple[np.ndarray, ...]:
        return tuple(output.numpy() for output in self._outputs)

    def _put(self, at: int, values: np.ndarray) -> None:
        """Hand an input over; a read-only array that was already given has not changed."""
        if self._given[at] is values:
            return
        self._given[at] = None if values.flags.writeable else values
        whole = self._views[at]
        whole[..., : values.shape[-1]] = values
        whole[..., values.shape[-1] :] = 0
        if not self._in_place:
            self._inputs[at].assign(whole)
