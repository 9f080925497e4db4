"""Rollouts without tangents, and on a ``wp.Tape``: the second, independent derivative that all tangents are held against."""

from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim import runtime
from proprio_ros.sim.joint import JointSimulator
from proprio_ros.sim.joint_kernels import (
    DELAY,
    VEC3,
    JointData,
)
from proprio_ros.sim.runtime import FLOAT
from support.taped_kernels import PlainLaw, observe, plain_joint_law, plain_rate, schedule, taped

MAX_STEPS = 200_000


def forward(
    owner: JointSimulator,
    law: PlainLaw,
    runs: wp.array,
    p: wp.array,
    capacity: int = 0,
    record_cmd: bool = False,
) -> tuple[list[wp.array], Any]:
    """Launch the rollout without tangents, or record it; with a ``capacity`` it writes down so many steps.

    Returns:
        The outputs of `schedule`, on the device, and the recorded command.
    """
    worlds = len(p)
    steps = max(capacity, 1)
    samples = owner._width
    out = [
        owner._zeros((worlds, samples), law.state),
        owner._zeros((worlds, steps)),
        owner._zeros((worlds, steps)),
    ]
    out += [
        owner._zeros((worlds, steps), VEC3),
        owner._zeros(worlds, wp.int32),
    ]
    out += [owner._zeros((worlds, samples), wp.int32)]
    given = [
        *owner.run_data(owner._full_counts),
        runs,
        p,
        capacity,
    ]
    how: dict[str, Any] = {
        "dim": worlds,
        "device": "cpu",
        "record_cmd": record_cmd,
    }
    return out, runtime.launch(
        schedule(law),
        inputs=given,
        outputs=out,
        **how,
    )


class TapedRollout:
    """One rollout on a ``wp.Tape``: states of every step are kept, gradients come from reverse mode.

    The step lengths are those the forward kernel takes at the same parameters; they follow the delay to first order, which is
    exact, and stay frozen otherwise.

    Attributes:
        q: Positions at the sample instants, shape (W, T).
    """

    def __init__(
        self,
        owner: JointSimulator,
        law: PlainLaw,
        world_run: np.ndarray,
        p: np.ndarray,
    ) -> None:
        worlds = len(p)
        width = owner._width
        longest = max(
            float(run.sample_times_s[-1]) + abs(float(p[:, DELAY].min())) for run in owner.runs
        )
        finest = min(min(run.fine_step_s, run.step_s) for run in owner.runs)
        capacity = int(np.ceil(longest / finest)) + width + int(owner._switch_times.shape[1]) + 2
        if capacity > MAX_STEPS:
            raise SimulationError(
                f"{capacity} steps of {finest:.2g} s are too many for a tape (at most {MAX_STEPS}): use a longer step, "
                "or the forward sensitivities"
            )
        runs = wp.array(world_run, dtype=wp.int32, device="cpu")
        self._p = wp.array(
            p,
            dtype=FLOAT,
            device="cpu",
            requires_grad=True,
        )
        (_, *taken, sample_step), _ = forward(
            owner,
            law,
            runs,
            self._p,
            capacity,
        )
        self._sampled = owner._zeros((worlds, width), requires_grad=True)
        y = owner._zeros(
            (worlds, capacity + 1),
            law.state,
            requires_grad=True,
        )
        steps = [
            owner.law_data(),
            runs,
            self._p,
            owner._array(p[:, DELAY]),
            *taken,
        ]
        samples = [
            owner._samples,
            owner.law_data(),
            runs,
            self._p,
            sample_step,
            y,
        ]
        self._tape = wp.Tape()
        with self._tape:
            runtime.launch(
                taped(law),
                dim=worlds,
                inputs=steps,
                outputs=[y],
                device="cpu",
            )
            runtime.launch(
                observe(law),
                dim=(worlds, width),
                inputs=samples,
                outputs=[self._sampled],
                device="cpu",
            )
        self.q = self._sampled.numpy().copy()

    def gradient(self, weights: np.ndarray) -> np.ndarray:
        """Gradient of ``sum(weights * q)`` by the parameters of each world: weights (W, T), gradient (W, P), a copy."""
        seed = wp.array(
            np.ascontiguousarray(weights, dtype=np.float64),
            dtype=FLOAT,
            device="cpu",
        )
        self._tape.backward(grads={self._sampled: seed})
        gradient = self._p.grad.numpy().copy()  # a view on the CPU, and zero() below would empty it
        self._tape.zero()
        return gradient


def tape(
    simulator: JointSimulator,
    world_run: np.ndarray,
    p: np.ndarray,
    law: PlainLaw | None = None,
) -> TapedRollout:
    """A rollout recorded on a ``wp.Tape``, by a law without tangents; None is the joint's own."""
    law = plain_joint_law(plain_rate, JointData, simulator.integrator) if law is None else law
    return TapedRollout(
        simulator, law, np.asarray(world_run, dtype=np.int32), np.asarray(p, dtype=np.float64)
    )
