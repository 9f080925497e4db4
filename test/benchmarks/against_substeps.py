"""The paper's way: one launch per substep on a ``wp.Tape``, gradient of the last frame's error, Adam.

64 semi-implicit Euler steps per 1/60 s frame, every state in an array of its own, so the adjoint is right; the tape is recorded
anew in each iteration. Compared with our one launch at the same 64 substeps (same numbers), and with what we really run (RK4).

The paper's 50 iterations stop on the way: half a gram off here. So the identification that is timed is the shortest of
``SCHEDULES`` whose answer agrees with ours; which one that is, our own launch finds out, because its numbers are the same.
"""

from __future__ import annotations

from dataclasses import replace

import case as cases
import numpy as np
import warp as wp
from case import AGREEMENT_KG, STARTS_KG, Case, Row, Timing, compare, measure_in_turn

from proprio_ros.identification.solvers import adam_descent
from proprio_ros.probes.payload.paper import FRAME_S
from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator
from proprio_ros.sim.runtime import FLOAT

GOAL = 50.0
SUBSTEPS = 64
PAPER_ITERATIONS = 50
RATE_KG = 0.01
SCHEDULES = (PAPER_ITERATIONS, 75, 100, 150, 200)
EQUAL = 1e-9


@wp.kernel(module="unique")
def _step(
    mass: wp.array(dtype=FLOAT),
    empty: wp.array(dtype=FLOAT),
    per_kg: wp.array(dtype=FLOAT),
    torque: FLOAT,
    h: FLOAT,
    q_in: wp.array(dtype=FLOAT),
    v_in: wp.array(dtype=FLOAT),
    q_out: wp.array(dtype=FLOAT),
    v_out: wp.array(dtype=FLOAT),
):
    w = wp.tid()
    m = mass[w]
    q = q_in[w]
    load = (
        (empty[1] + m * per_kg[1]) * wp.cos(q)
        + (empty[2] + m * per_kg[2]) * wp.sin(q)
        + empty[3]
        + m * per_kg[3]
    )
    v = v_in[w] + h * (torque - load) / (empty[0] + m * per_kg[0])
    v_out[w] = v
    q_out[w] = q + h * v


@wp.kernel(module="unique")
def _squared_error(
    target: FLOAT,
    q: wp.array(dtype=FLOAT),
    loss: wp.array(dtype=FLOAT),
):
    w = wp.tid()
    error = q[w] - target
    wp.atomic_add(loss, 0, error * error)


class PerSubstep:
    """Error of the last frame and its gradient by the mass, all starts in each launch.

    Args:
        case: the run and the coefficients of its joint.
        frames: how many frames are simulated.
        target: the position that the last one should have [rad].
        substeps: steps of a frame.
    """

    def __init__(
        self,
        case: Case,
        frames: int,
        target: float,
        substeps: int,
    ) -> None:
        p, dp = case.parameters(np.array([0.0]))
        worlds = len(STARTS_KG)
        self._target = target
        self._torque = float(p[0, INDEX["torque_constant"]] * case.run.input_current_A[0])
        self._empty = wp.array(
            p[0, :4],
            dtype=FLOAT,
            device="cpu",
        )
        self._per_kg = wp.array(
            dp[0, :4, 0],
            dtype=FLOAT,
            device="cpu",
        )
        self.mass = wp.zeros(
            worlds,
            dtype=FLOAT,
            device="cpu",
            requires_grad=True,
        )
        steps = frames * substeps
        self._step_s = FRAME_S / substeps
        self._q = [
            wp.zeros(worlds, dtype=FLOAT, device="cpu", requires_grad=True)
            for _ in range(steps + 1)
        ]
        self._v = [
            wp.zeros(worlds, dtype=FLOAT, device="cpu", requires_grad=True)
            for _ in range(steps + 1)
        ]
        self._q[0].fill_(float(p[0, INDEX["q0"]]))
        self._loss = wp.zeros(
            1,
            dtype=FLOAT,
            device="cpu",
            requires_grad=True,
        )

    def __call__(
        self,
        mass: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Loss (S,) and gradient (S, 1) at masses (S, 1)."""
        self.mass.assign(mass[:, 0])
        self._loss.zero_()
        tape = wp.Tape()
        with tape:
            for n in range(len(self._q) - 1):
                wp.launch(
                    _step,
                    dim=len(mass),
                    inputs=[
                        self.mass,
                        self._empty,
                        self._per_kg,
                        self._torque,
                        self._step_s,
                        self._q[n],
                        self._v[n],
                    ],
                    outputs=[
                        self._q[n + 1],
                        self._v[n + 1],
                    ],
                    device="cpu",
                )
            wp.launch(
                _squared_error,
                dim=len(mass),
                inputs=[self._target, self._q[-1]],
                outputs=[self._loss],
                device="cpu",
            )
        tape.backward(loss=self._loss)
        gradient = self.mass.grad.numpy().copy()[:, None]
        tape.zero()
        return (self._q[-1].numpy() - self._target) ** 2, gradient


class OneLaunch:
    """The same loss and gradient from our tangent kernel with the same substeps."""

    def __init__(
        self,
        case: Case,
        frames: int,
        target: float,
        substeps: int,
    ) -> None:
        run = case.problem.simulator.runs[0]
        step = FRAME_S / substeps
        last = JointRun(
            np.array([frames * FRAME_S]),
            run.input_times_s,
            run.input_current_A,
            run.supply,
            run.friction_velocity,
            step,
            step,
        )
        self._simulator = JointSimulator([last], "semi_implicit")
        self._target = target
        self._p, self._dp = case.parameters(np.zeros(len(STARTS_KG)))
        # in the mass alone; the parameters are linear in it
        self._dp = np.ascontiguousarray(self._dp[:, :, :1])
        self._worlds = np.zeros(
            len(STARTS_KG),
            dtype=np.int32,
        )

    def __call__(
        self,
        mass: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Loss (S,) and gradient (S, 1) at masses (S, 1)."""
        q, _, dq = self._simulator.jacobian(
            self._worlds, self._p + mass * self._dp[:, :, 0], self._dp
        )
        error = q[:, :1] - self._target
        return error[:, 0] ** 2, 2.0 * error * dq[:, 0]


def adam(
    loss: PerSubstep | OneLaunch,
    iterations: int,
) -> tuple[np.ndarray, float]:
    """Masses of all starts [kg], and that of the least error."""
    end = adam_descent(
        loss,
        np.array(STARTS_KG)[:, None],
        RATE_KG,
        iterations,
        lower=1e-6,
    )
    return end.internal[:, 0], float(end.internal[end.best, 0])


def rows(case: Case) -> list[Row]:
    """Time of a gradient, and of an identification."""
    frames = int(np.floor(case.prepared.times_s[-1] / FRAME_S + 1e-6))
    target = float(np.interp(frames * FRAME_S, case.prepared.times_s, case.prepared.position))
    substeps = 16 if cases.once else SUBSTEPS
    theirs, same = (way(case, frames, target, substeps) for way in (PerSubstep, OneLaunch))
    what = f"one launch per substep + wp.Tape, {substeps} Euler steps a frame"
    starts = np.array(STARTS_KG)[:, None]
    both = zip(theirs(starts), same(starts), strict=True)
    apart = max(float(np.abs(x - y).max() / np.abs(y).max()) for x, y in both)
    if not apart <= EQUAL:
        return [Row(what, None, "void", False, f"gradients differ by {apart:.1e}")]
    gradients = _gradient_rows(what, theirs, same, case, apart)
    return [*gradients, _descent_row(theirs, same, case)]


def _gradient_rows(
    what: str,
    theirs: PerSubstep,
    same: OneLaunch,
    case: Case,
    apart: float,
) -> list[Row]:
    """Time of a gradient of five starts.

    Args:
        what: The other way in words.
        theirs: It.
        same: Ours at the same substeps.
        case: Whose run it is.
        apart: Share by which both gradients differ.
    """
    starts = np.array(STARTS_KG)[:, None]
    p, dp = case.parameters(np.array(STARTS_KG))
    worlds = np.zeros(len(STARTS_KG), dtype=np.int32)
    slow, fused, real = measure_in_turn(
        (
            lambda: theirs(starts),
            lambda: same(starts),
            lambda: case.problem.simulator.jacobian(worlds, p, dp),
        ),
        repeats=9,
        calls=(1, 20, 50),
    )
    return [
        Row(
            f"{what}, one gradient of five starts",
            slow,
            note=f"same numbers as ours to {apart:.0e}",
        ),
        _faster("  our kernel, the same substeps", fused, slow),
        _faster("  our kernel as used (RK4, all samples, three unknowns)", real, slow),
    ]


def _descent_row(
    theirs: PerSubstep,
    same: OneLaunch,
    case: Case,
) -> Row:
    """Time of the shortest of `SCHEDULES` that ends where we do."""
    stops = {iterations: adam(same, iterations)[1] - case.mass for iterations in SCHEDULES}
    agreeing = [iterations for iterations, off in stops.items() if abs(off) <= AGREEMENT_KG]
    iterations = agreeing[0] if agreeing else PAPER_ITERATIONS
    row = compare(
        f"  Adam {iterations}, five starts",
        lambda: adam(theirs, iterations),
        GOAL,
        case,
    )
    stop = 1e3 * stops[PAPER_ITERATIONS]
    words = f"the paper's {PAPER_ITERATIONS} iterations stop {stop:+.2f} g from ours"
    return replace(row, note=f"{row.note}; {words}")


def _faster(what: str, ours: Timing, theirs: Timing) -> Row:
    ratio = theirs.median / ours.median
    return Row(what, ours, f"{ratio:.0f}x (goal >= {GOAL:g}x)", ratio >= GOAL)
