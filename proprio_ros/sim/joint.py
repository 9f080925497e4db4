"""One driven joint with everything else locked: the law, its exact tangents, and its adjoint.

Equation (1) of the paper (Chen et al. 2025, arXiv:2410.03920) for one degree of freedom, with the drive train it leaves out:

    J a + g(q) = tau_m - (f_c + f_l |tau_m|) (1 + s exp(-(v / w)^2)) tanh(v / v_s) - f_v v,      tau_m = k_t i
    g(q) = g_a cos q + g_b sin q + g_c + e_0(t) + m e_1(t)
    i    = command, held inside what the supply can push against the back-EMF: |i| <= (V -+ k_e v) / R

``J`` holds the merged arm, the payload and the armature; ``g_a, g_b, g_c`` its gravity load (``payload.py`` says how they come
from inertial parameters). ``e_0, e_1`` is the torque that the locked joints cause by yielding, with nothing in the hand and per
kilogram of payload ``m``; it is given with the current, piecewise constant. The rollout starts when the command does, at time 0
in state (q0, v0); sample k is compared at ``t_k - delay``, so the delay from command to motion shifts the observation and needs
no moving discontinuity.

Departures from the paper: armature, friction, supply limit and delay are ours (leaving one of them out costs 10 g or more);
the default integrator is RK4, because the substep error of the paper's equation (2), semi-implicit Euler, is itself grams of
mass. ``integrator="semi_implicit"`` is equation (2) to the letter.

Two independent derivatives: forward sensitivities in the same launch as the rollout (the default), and ``wp.Tape`` over a
separate kernel that stores every state (an adjoint is only right when no state is overwritten). The kernels are in
``joint_kernels.py``, the walk through time in ``rollout.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim import runtime
from proprio_ros.sim.joint_kernels import (
    DELAY,
    PARAMETERS,
    VEC3,
    JointData,
    joint_law,
    plain_joint_law,
    plain_rate,
)
from proprio_ros.sim.rollout import TIME_EPS, PlainLaw, observe, rollout, schedule, taped
from proprio_ros.sim.runtime import FLOAT

INDEX = {name: row for row, name in enumerate(PARAMETERS)}
INTEGRATORS = ("rk4", "semi_implicit")
_TANGENT_SIZES = (1, 3, 4, 6, 8, 12, 14, 16, 18, 24, 32)
MAX_STEPS = 200_000


def harmless(parameters: Sequence[str]) -> np.ndarray:
    """Parameters of a world that does nothing, shape (P,)."""
    return np.array([float(name in ("inertia", "stribeck_velocity")) for name in parameters])


@dataclass(frozen=True)
class JointRun:
    """What one rollout is driven by and where it is looked at.

    Attributes:
        sample_times_s: Encoder stamps after command onset [s], shape (T,), increasing.
        input_times_s: When the current changes [s], shape (S,), increasing, first at 0.
        input_current_A: The current from each of those instants on [A], shape (S,).
        input_load: Load from each of those instants on beside gravity's, shape (S, 2): with an empty hand [N m], and what each
            kilogram carried adds [N m/kg]; None is none.
        supply: (voltage [V], back-EMF constant [V s/rad], resistance [ohm]); voltage 0 means no limit.
        friction_velocity: v_s, where Coulomb's law is smoothed [rad/s].
        step_s: Longest integration step [s]; 1/60/substeps makes semi-implicit Euler the paper's.
        fine_step_s: Step while the joint is near standstill [s]; equal to ``step_s`` where there is no dry friction.
    """

    sample_times_s: np.ndarray
    input_times_s: np.ndarray
    input_current_A: np.ndarray
    supply: tuple[float, float, float] = (0.0, 0.0, 1.0)
    friction_velocity: float = 1e-3
    step_s: float = 1.0 / 240.0
    fine_step_s: float = 1.0 / 240.0
    input_load: np.ndarray | None = None


@dataclass(frozen=True)
class Schedule:
    """Some rollouts without tangents, on the device, with every step for the adjoint to follow.

    Attributes:
        states: At the samples, shape (W, T).
        step, step_by_delay: Length of each step and its change with the delay, shape (W, N).
        given: The input during each step, shape (W, N).
        steps: How many of each world, shape (W,); sample_step: after which each sample is taken, -1 before all, shape (W, T).
    """

    states: wp.array
    step: wp.array
    step_by_delay: wp.array
    given: wp.array
    steps: wp.array
    sample_step: wp.array

    @classmethod
    def empty(cls, state: Any, worlds: int, capacity: int, samples: int, device: str) -> "Schedule":
        """Arrays to be filled by a kernel."""
        kinds = {"states": (state, samples), "step": (FLOAT, capacity), "step_by_delay": (FLOAT, capacity)}
        kinds |= {"given": (VEC3, capacity), "sample_step": (wp.int32, samples)}
        arrays = {name: wp.zeros((worlds, n), dtype=kind, device=device) for name, (kind, n) in kinds.items()}
        return cls(steps=wp.zeros(worlds, dtype=wp.int32, device=device), **arrays)

    def inputs(self) -> list[wp.array]:
        """What a taped kernel reads, in its order."""
        return [self.step, self.step_by_delay, self.given, self.steps]


class JointSimulator:
    """Rolls out many worlds (guesses) of one or more runs of single joints in one launch.

    Args:
        runs: The runs; worlds refer to them by index. Runs may have different lengths.
        integrator: ``"rk4"`` or ``"semi_implicit"`` (the paper's equation (2)).
        device: Warp device name.

    Raises:
        ConfigurationError: Warp cannot keep compiled kernels.
        SimulationError: Unknown integrator, no runs, or a run without samples.
    """

    parameters: tuple[str, ...] = PARAMETERS
    harmless: np.ndarray = harmless(PARAMETERS)
    tangent_sizes: tuple[int, ...] = _TANGENT_SIZES

    def __init__(self, runs: Sequence[JointRun], integrator: str = "rk4", device: str = "cpu") -> None:
        runtime.check()
        if integrator not in INTEGRATORS:
            raise SimulationError(f"unknown integrator {integrator!r}: choose one of {', '.join(INTEGRATORS)}")
        if not runs or any(len(run.sample_times_s) == 0 for run in runs):
            raise SimulationError("nothing to simulate: every run needs at least one sample after the command's onset")
        self.runs = tuple(runs)
        self.integrator = integrator
        self.device = device
        self.sample_counts = np.array([len(run.sample_times_s) for run in runs], dtype=np.int32)
        self.sample_counts.setflags(write=False)
        self._width = int(self.sample_counts.max())
        input_counts = np.array([len(run.input_times_s) for run in runs], dtype=np.int32)
        samples = np.zeros((len(runs), self._width))
        switch_times = np.zeros((len(runs), int(input_counts.max())))
        inputs = np.zeros((*switch_times.shape, 3))
        constants, steps = np.zeros((len(runs), 4)), np.zeros((len(runs), 2))
        for row, run in enumerate(runs):
            samples[row, : self.sample_counts[row]] = run.sample_times_s
            switch_times[row, : input_counts[row]] = run.input_times_s
            inputs[row, : input_counts[row], 0] = run.input_current_A
            if run.input_load is not None:
                inputs[row, : input_counts[row], 1:] = run.input_load
            constants[row] = (*run.supply, run.friction_velocity)
            steps[row] = run.step_s, min(run.fine_step_s, run.step_s)
        self._samples = self._array(samples)
        self._switch_times = self._array(switch_times)
        self._inputs = wp.array(inputs, dtype=VEC3, device=device)
        self._constants, self._steps = self._array(constants), self._array(steps)
        self._input_counts = wp.array(input_counts, dtype=wp.int32, device=device)
        self._full_counts = wp.array(self.sample_counts, dtype=wp.int32, device=device)
        self._launches: dict[tuple[int, int, bool], _Launch] = {}

    def _array(self, values: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=FLOAT, device=self.device)

    def windows(self, fraction: float) -> np.ndarray:
        """How many samples of each run lie in the first ``fraction`` of its time, at least three; shape (R,), int32."""
        counts = [
            int(np.searchsorted(run.sample_times_s, fraction * run.sample_times_s[-1] + TIME_EPS, side="right"))
            for run in self.runs
        ]
        return np.minimum(np.maximum(np.array(counts, dtype=np.int32), 3), self.sample_counts)

    def jacobian(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions and velocities at the sample instants with exact forward sensitivities.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters of each world in the order of ``PARAMETERS``, shape (W, P).
            dp: D tangent directions of each world in parameter space, shape (W, P, D); a read-only array that comes again is
                not copied again (nor are ``world_run`` and ``counts``).
            counts: Only the first ``counts[r]`` samples of run r are computed, shape (R,); default all.

        Worlds whose parameters are not all finite give NaN.

        Returns:
            q (W, T), v (W, T), dq (W, T, D). Columns past a run's count hold stale numbers. The arrays are views of
            buffers that the next call of the same shape overwrites.
        """
        directions = dp.shape[2]
        q, v, dq, *_ = self._launch(world_run, p, dp, counts)
        return q, v, dq[:, :, :directions]

    def _launch(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray, counts: np.ndarray | None
    ) -> tuple[np.ndarray, ...]:
        """All outputs of the tangent kernel; its directions are padded to one of ``tangent_sizes``."""
        worlds, _, directions = dp.shape
        size = next((s for s in self.tangent_sizes if s >= directions), directions)
        stribeck = bool(p[:, INDEX["stribeck"]].any() or dp[:, INDEX["stribeck"]].any())
        launch = self._launches.get((worlds, size, stribeck))
        if launch is None:
            launch = self._launches[worlds, size, stribeck] = _Launch(self, worlds, size, stribeck)
        lost = ~np.isfinite(p).all(axis=1)
        if lost.any():  # a rollout of what is no number would not end
            p = np.where(lost[:, None], self.harmless, p)
        results = launch(world_run, p, dp, self.sample_counts if counts is None else counts)
        if lost.any():
            results[0][lost] = results[1][lost] = np.nan
        return results

    def _kernel(self, size: int, stribeck: bool) -> tuple[Any, Any]:
        """The kernel with tangents, and the struct of its results."""
        law = joint_law(size, stribeck)
        return rollout(law, self.integrator), law.out

    def _plain_law(self) -> PlainLaw:
        """The law for the kernels without tangents."""
        return plain_joint_law(plain_rate, JointData, self.integrator)

    def _data(self) -> Any:
        """What the law knows about the runs."""
        data = JointData()
        data.constants = self._constants
        return data

    def _run_data(self, counts: wp.array) -> list[Any]:
        """What every kernel knows about the runs, in its order."""
        times, inputs = self._switch_times, self._inputs
        return [self._samples, counts, times, inputs, self._input_counts, self._steps, self._data()]

    def _outputs(self, worlds: int, size: int) -> list[wp.array]:
        vec = wp.types.vector(length=size, dtype=FLOAT)
        return [wp.zeros((worlds, self._width), dtype=kind, device=self.device) for kind in (FLOAT, FLOAT, vec)]

    def _forward(self, runs: wp.array, p: wp.array, capacity: int, record_cmd: bool = False) -> tuple[Schedule, Any]:
        """Launch the rollout without tangents, or record it; with a ``capacity`` it writes down so many steps."""
        law = self._plain_law()
        plan = Schedule.empty(law.state, len(p), max(capacity, 1), self._width, self.device)
        command = runtime.launch(
            schedule(law),
            dim=len(p),
            inputs=[*self._run_data(self._full_counts), runs, p, capacity],
            outputs=[plan.states, *plan.inputs(), plan.sample_step],
            device=self.device,
            record_cmd=record_cmd,
        )
        return plan, command

    def rollout(self, world_run: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities at the sample instants, shapes (W, T); arguments as in ``jacobian``."""
        q, v, _ = self.jacobian(world_run, p, np.zeros((*p.shape, 1)))
        return q.copy(), v.copy()

    def tape(self, world_run: np.ndarray, p: np.ndarray) -> "TapedRollout":
        """The same rollout recorded on a ``wp.Tape`` (see ``TapedRollout``)."""
        return TapedRollout(self, np.asarray(world_run, dtype=np.int32), np.asarray(p, dtype=np.float64))


def compile_kernels(integrator: str = "rk4", *, rises: bool = True) -> None:
    """Compile and load the kernels of all usual sizes, for whoever cannot wait for one later; again it costs nothing.

    Args:
        integrator: As for ``JointSimulator``.
        rises: Whether the robot's friction may rise towards standstill; kernels for that are nearly as many again.
    """
    # more directions than parameters come only from callers of their own
    sizes = [size for size in _TANGENT_SIZES if size <= len(PARAMETERS)]
    runtime.load([rollout(joint_law(*kind), integrator) for kind in kinds_of_kernel(sizes, rises)], "cpu")


def kinds_of_kernel(sizes: Sequence[int], rises: bool) -> list[tuple[int, bool]]:
    """Size, and whether friction rises towards standstill, of each kernel that a robot's fits may need.

    Args:
        sizes: Numbers of directions, the last that of all parameters.
        rises: Whether the robot's friction may rise.
    """
    # all parameters at once are more than some fits have unknowns, and the rise is one of them on every robot
    return [
        (size, stribeck) for size in sizes for stribeck in (False, True) if rises or not stribeck or size == sizes[-1]
    ]


def plain_kernel(directions: int, integrator: str) -> Any:
    """The joint's own kernel for runs with an empty hand among those of another law, which has more parameters."""
    size = next(size for size in _TANGENT_SIZES if size >= directions)
    return rollout(joint_law(size, True), integrator)


class _Launch:
    """Buffers and recorded launch for one batch shape: a recorded launch costs a fifth of a fresh one."""

    def __init__(self, owner: JointSimulator, worlds: int, size: int, stribeck: bool) -> None:
        vec = wp.types.vector(length=size, dtype=FLOAT)
        device = owner.device
        self._given: dict[str, np.ndarray | None] = {}
        self._world_run = wp.zeros(worlds, dtype=wp.int32, device=device)
        self._counts = wp.clone(owner._full_counts)
        self._p = wp.zeros((worlds, len(owner.parameters)), dtype=FLOAT, device=device)
        self._dp = wp.zeros((worlds, len(owner.parameters)), dtype=vec, device=device)
        self._outputs = owner._outputs(worlds, size)
        kernel, out_type = owner._kernel(size, stribeck)
        out = out_type()
        for name, array in zip(out_type.vars, self._outputs, strict=True):
            setattr(out, name, array)
        self._command = runtime.launch(
            kernel,
            dim=worlds,
            inputs=[*owner._run_data(self._counts), self._world_run, self._p, self._dp],
            outputs=[out],
            device=device,
            record_cmd=True,
        )
        # on the CPU a Warp array is the host's own memory: written and read in place, without a copy
        inputs = {"world_run": self._world_run, "counts": self._counts, "p": self._p, "dp": self._dp}
        self._views = {name: array.numpy() for name, array in inputs.items()} if self._p.device.is_cpu else {}
        self._results = self._read() if self._views else None

    def __call__(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray, counts: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        self._put("world_run", self._world_run, world_run)
        self._put("counts", self._counts, counts)
        self._put("p", self._p, p)
        self._put("dp", self._dp, dp)
        self._command.launch()
        return self._results or self._read()

    def _read(self) -> tuple[np.ndarray, ...]:
        return tuple(output.numpy() for output in self._outputs)

    def _put(self, what: str, array: wp.array, values: np.ndarray) -> None:
        """Hand an input over; a read-only array that was already given has not changed."""
        if self._given.get(what) is values:
            return
        self._given[what] = None if values.flags.writeable else values
        if self._views:
            view = self._views[what]
            view[..., : values.shape[-1]] = values
            view[..., values.shape[-1] :] = 0
        else:
            whole = np.zeros_like(array.numpy())
            whole[..., : values.shape[-1]] = values
            array.assign(whole)


class TapedRollout:
    """One rollout on a ``wp.Tape``: states of every step are kept, gradients come from reverse mode.

    The step lengths are those the forward kernel takes at the same parameters; they follow the delay to first order, which is
    exact, and stay frozen otherwise.

    Attributes:
        q: Positions at the sample instants, shape (W, T).
    """

    def __init__(self, owner: JointSimulator, world_run: np.ndarray, p: np.ndarray) -> None:
        device = owner.device
        worlds = len(p)
        longest = max(float(run.sample_times_s[-1]) + abs(float(p[:, DELAY].min())) for run in owner.runs)
        finest = min(min(run.fine_step_s, run.step_s) for run in owner.runs)
        events = owner._width + int(owner._switch_times.shape[1])
        capacity = int(np.ceil(longest / finest)) + events + 2
        if capacity > MAX_STEPS:
            raise SimulationError(
                f"{capacity} steps of {finest:.2g} s are too many for a tape (at most {MAX_STEPS}): use a longer step, "
                "or the forward sensitivities"
            )
        self._worlds = worlds
        self._samples = owner._width
        runs = wp.array(world_run, dtype=wp.int32, device=device)
        self._p = wp.array(p, dtype=FLOAT, device=device, requires_grad=True)
        plan, _ = owner._forward(runs, self._p, capacity)
        law = owner._plain_law()
        self._sampled = wp.zeros((worlds, owner._width), dtype=FLOAT, device=device, requires_grad=True)
        delay_at = wp.array(p[:, DELAY].copy(), dtype=FLOAT, device=device)
        self._tape = wp.Tape()
        with self._tape:
            y = wp.zeros((worlds, capacity + 1), dtype=law.state, device=device, requires_grad=True)
            runtime.launch(
                taped(law),
                dim=worlds,
                inputs=[owner._data(), runs, self._p, delay_at, *plan.inputs()],
                outputs=[y],
                device=device,
            )
            runtime.launch(
                observe(law),
                dim=(worlds, owner._width),
                inputs=[owner._samples, owner._data(), runs, self._p, plan.sample_step, y],
                outputs=[self._sampled],
                device=device,
            )
        self.q = self._sampled.numpy().copy()

    def gradient(self, weights: np.ndarray) -> np.ndarray:
        """Gradient of ``sum(weights * q)`` by the parameters of each world.

        Args:
            weights: Shape (W, T).

        Returns:
            shape (W, P), a copy.
        """
        seed = wp.array(np.ascontiguousarray(weights, dtype=np.float64), dtype=FLOAT, device=self._p.device)
        self._tape.backward(grads={self._sampled: seed})
        gradient = self._p.grad.numpy().copy()  # a view on the CPU, and zero() below would empty it
        self._tape.zero()
        return gradient
