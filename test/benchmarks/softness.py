"""The soft block: our explicit solver against launches per substep on a ``wp.Tape``, and our fit against scipy over the same FEM.

``PerSubstep`` is how a simulator in Warp is usually differentiated, and how the paper does it: kernels over tetrahedra and nodes,
three launches per substep, every state in an array of its own, all on one tape. The same numbers as ours, so their times compare.
``OnePerSubstep`` is the fewest launches there can be: our own kernel, one step at a time.

The fit: Young's modulus, Poisson's ratio and gap from one closing of a gripper. Ours reads the table and has exact sensitivities;
``scipy.optimize.least_squares`` has differences, and the finite elements' force over 11 squeezes at every guess. It gets the same
octant of the block, and our own rollout of the gripper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import case as cases
import numpy as np
import warp as wp
from case import Kept, Row, Timing, measure, measure_in_turn
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares
from softness_kernels import cell_kernel, force_kernel, node_kernel

from proprio_ros.addons.paper.softbody import (
    FRICTION_VELOCITY,
    SOFT_INDEX,
    SOFT_PARAMETERS,
    SoftBody,
    SoftRun,
)
from proprio_ros.addons.paper.softbody_kernels import VEC3, frame_kernel
from proprio_ros.sim.energies import lame
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.mesh import box
from proprio_ros.sim.quasistatic import QuasiStatic
from proprio_ros.sim.response import Response, build
from proprio_ros.sim.runtime import FLOAT
from proprio_ros.sim.squeeze import SQUEEZE_INDEX, SQUEEZE_PARAMETERS, SqueezeRun, SqueezeSimulator

EDGE = 0.03
MASS = 0.023
TRAVEL = 0.023
HEAVY = (5097.6, 5430.4)
GOALS = {2: 20.0, 4: 5.0}
FIT_GOAL = 100.0
EQUAL = 1e-9


@dataclass(frozen=True)
class BlockState:
    """On the device: coordinate and velocity of the gripper (2,), positions and velocities of the nodes (N,)."""

    q: wp.array
    x: wp.array
    v: wp.array


class PerSubstep:
    """The bonded block between the fingers, three launches per substep on one tape."""

    def __init__(
        self,
        body: SoftBody,
        run: SoftRun,
        p: np.ndarray,
    ) -> None:
        self.run, self.body = run, body
        (
            self._tets,
            self._cells,
            self._shares,
            self._volumes,
            self._inverses,
            self._grams,
            self._masses,
            self._sides,
            _,
        ) = body._block
        faces = float(body.masses[body._ends].sum())
        constants = np.array(
            [0.5 * body.mesh.length, body.travel, FRICTION_VELOCITY, faces, run.step_s]
        )
        self._constants = wp.array(constants, dtype=FLOAT)
        self._p = wp.array(
            p[0],
            dtype=FLOAT,
            requires_grad=True,
        )
        self._start = body._start(p, None)
        self._currents = run.currents()

    def __call__(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions at the end of every frame (K,), and the gradient of their sum by the parameters (P,)."""
        state = self._at_start()
        angles = [state.q]
        tape = wp.Tape()
        with tape:
            for current in self._currents:
                state = self._stepped(state, float(current))
                angles.append(state.q)
        one = wp.array([1.0, 0.0], dtype=FLOAT)
        frames = angles[self.run.substeps :: self.run.substeps]
        tape.backward(grads=dict.fromkeys(frames, one))
        gradient = self._p.grad.numpy().copy()
        tape.zero()
        return np.array([frame.numpy()[0] for frame in frames]), gradient

    def _at_start(self) -> BlockState:
        first = self._p.numpy()[[SOFT_INDEX["q0"], SOFT_INDEX["v0"]]]
        x, v = self._start
        return BlockState(
            wp.array(first, dtype=FLOAT, requires_grad=True),
            wp.array(x[0], dtype=VEC3, requires_grad=True),
            wp.array(v[0], dtype=VEC3, requires_grad=True),
        )

    def _stepped(self, state: BlockState, current: float) -> BlockState:
        """After a substep under that current [A]: changes of volume, forces of tetrahedra, motion of nodes."""
        tets = self._tets.shape[0]
        nodes = len(self.body.mesh.points)
        cell_j = wp.zeros(self.body.mesh.cell_count, dtype=FLOAT, requires_grad=True)
        force = wp.zeros(nodes, dtype=VEC3, requires_grad=True)
        push = wp.zeros(1, dtype=FLOAT, requires_grad=True)
        after = BlockState(*(wp.empty_like(part) for part in (state.q, state.x, state.v)))
        mesh = [self._tets, self._cells]
        wp.launch(
            cell_kernel,
            dim=tets,
            inputs=[*mesh, self._shares, self._volumes, self._inverses, state.x, cell_j],
        )
        elastic = [self._volumes, self._inverses, self._grams, self._p]
        wp.launch(
            force_kernel,
            dim=tets,
            inputs=[*mesh, *elastic, state.x, state.v, cell_j, self._sides, force, push],
        )
        known = [self._masses, self._sides, self._constants, current, self._p]
        wp.launch(
            node_kernel,
            dim=nodes + 1,
            inputs=[
                *known,
                force,
                push,
                state.q,
                state.x,
                state.v,
                after.q,
                after.x,
                after.v,
            ],
        )
        return after


class OnePerSubstep:
    """Our kernel, one launch per substep on one tape; the states' arrays are there before."""

    def __init__(
        self,
        body: SoftBody,
        run: SoftRun,
        p: np.ndarray,
    ) -> None:
        steps = run.frames * run.substeps
        nodes = len(body.mesh.points)
        self._rest = PerSubstep(body, run, p)
        self._p = wp.array(p, dtype=FLOAT, requires_grad=True)
        self._kernel = frame_kernel(body.law, True)
        currents = wp.array(run.currents(), dtype=FLOAT)
        shapes = [((1, steps + 1), FLOAT)] * 2 + [((1, steps + 1, nodes), VEC3)] * 2
        shapes += [
            ((1, steps, body.mesh.cell_count), FLOAT),
            ((1, steps, nodes), VEC3),
            ((1, steps), FLOAT),
        ]
        self._arrays = [
            wp.zeros(
                shape,
                dtype=kind,
                requires_grad=True,
            )
            for shape, kind in shapes
        ]
        start = (*p[:, [SOFT_INDEX["q0"], SOFT_INDEX["v0"]]].T, *body._start(p, None))
        for array, value in zip(self._arrays, start, strict=False):
            array.numpy()[:, 0] = value
        self._launches = [
            [
                currents[n : n + 1],
                *(a[:, n : n + 2] for a in self._arrays[:4]),
                *(a[:, n : n + 1] for a in self._arrays[4:]),
            ]
            for n in range(steps)
        ]
        self._block = body._block
        self._substeps = run.substeps

    def __call__(self) -> tuple[np.ndarray, np.ndarray]:
        """As ``PerSubstep.__call__``."""
        for array in self._arrays[4:]:
            array.zero_()
        tape = wp.Tape()
        with tape:
            for current, *rows in self._launches:
                inputs = [
                    *self._block,
                    self._rest._constants,
                    current,
                    self._p,
                ]
                wp.launch(
                    self._kernel,
                    dim=1,
                    inputs=inputs,
                    outputs=rows,
                )
        for array in self._arrays:
            array.grad.zero_()
        self._p.grad.zero_()
        self._arrays[0].grad.numpy()[:, self._substeps :: self._substeps] = 1.0
        tape.backward()
        return self._arrays[0].numpy()[
            0, self._substeps :: self._substeps
        ].copy(), self._p.grad.numpy()[0].copy()


def explicit_case(
    cells: int,
    frames: int = 60,
) -> tuple[SoftBody, SoftRun, np.ndarray]:
    """A second of the paper's heavy cube under its motor, in touch from the start."""
    body = SoftBody(
        box(
            np.full(3, EDGE),
            (cells, cells, cells),
        ),
        MASS,
        TRAVEL,
    )
    values = {
        "inertia": 0.005,
        "torque_constant": 1.0,
        "coulomb": 0.01,
        "viscous": 0.01,
        "v0": 0.01,
        "gap": -1e-4,
    }
    values |= {"lame_mu": HEAVY[0], "lame_lambda": HEAVY[1]}
    p = np.array([[values.get(name, 0.0) for name in SOFT_PARAMETERS]])
    return (
        body,
        SoftRun(
            np.zeros(1),
            np.array([0.08]),
            frames,
        ),
        p,
    )


def fused(
    body: SoftBody,
    run: SoftRun,
    p: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Ours, as ``PerSubstep.__call__``."""
    result = body.rollout(run, p)
    return result.q[0], result.gradient(np.ones_like(result.q))[0]


def difference(
    ours: tuple[np.ndarray, np.ndarray],
    theirs: tuple[np.ndarray, np.ndarray],
) -> float:
    """Largest relative difference of positions and of the gradient by what both differentiate."""
    rows = [
        SOFT_INDEX[name]
        for name in ("inertia", "torque_constant", "coulomb", "viscous", "lame_mu", "lame_lambda")
    ]
    by_ours = ours[1][rows]
    by_theirs = theirs[1][rows]
    return float(
        max(np.abs(ours[0] / theirs[0] - 1.0).max(), np.abs(by_ours / by_theirs - 1.0).max())
    )


class Fit:
    """E, nu and gap from one closing, both ways.

    Args:
        cells: of the octant.
    """

    names = ("youngs_modulus", "poissons_ratio", "gap")
    truth = np.array([12824.6, 0.258, 0.0004])
    start = np.array([3 * 12824.6, 0.35, 0.0])

    def __init__(self, cells: int = 2) -> None:
        self.table = build(
            np.full(3, EDGE),
            cells=cells,
        )
        mesh = box(
            np.full(3, 0.5 * EDGE),
            (cells, cells, cells),
            corner=np.zeros(3),
        )
        self.solver = QuasiStatic(mesh, octant=True)
        self.simulator = self._simulator(self.table)
        self.rows = [SQUEEZE_INDEX[name] for name in self.names]
        self.fixed = np.zeros((1, len(SQUEEZE_PARAMETERS)))
        values = {"inertia": 0.005, "torque_constant": 1.0, "viscous": 0.02, "coulomb": 0.01}
        for name, value in values.items():
            self.fixed[0, SQUEEZE_INDEX[name]] = value
        self.directions = np.zeros((1, len(SQUEEZE_PARAMETERS), 3))
        self.directions[0, self.rows, range(3)] = 1.0
        self.directions.setflags(write=False)
        self.one = np.zeros(1, dtype=np.int32)
        self.one.setflags(write=False)
        self.seen = self._rollout(self.simulator, self.truth)
        self.scale = np.array([1e4, 0.1, 1e-3])

    def _simulator(self, table: Response) -> SqueezeSimulator:
        times = np.arange(1, 41) / 40.0
        joint = JointRun(
            times,
            np.zeros(1),
            np.array([0.11]),
            friction_velocity=0.01,
            step_s=1 / 480,
            fine_step_s=1 / 480,
        )
        return SqueezeSimulator([SqueezeRun(joint, EDGE, EDGE**2, TRAVEL, table)])

    def _p(self, values: np.ndarray) -> np.ndarray:
        p = self.fixed.copy()
        p[0, self.rows] = values
        return p

    def _rollout(
        self,
        simulator: SqueezeSimulator,
        values: np.ndarray,
    ) -> np.ndarray:
        return simulator.rollout(self.one, self._p(values))[0][0]

    def ours(self) -> np.ndarray:
        """Levenberg and Marquardt with exact sensitivities over the table; E in logarithms."""
        values = self.start.copy()
        damping = 1e-3

        def linearised(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            q, _, dq = self.simulator.jacobian(
                self.one,
                self._p(at),
                self.directions,
            )
            return q[0] - self.seen, dq[0] * np.array([at[0], 0.1, 1e-3])

        residual, jacobian = linearised(values)
        for _ in range(60):
            normal = jacobian.T @ jacobian
            step = -np.linalg.solve(
                normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual
            )
            moved = values * [
                np.exp(
                    np.clip(
                        step[0],
                        -1,
                        1,
                    )
                ),
                1,
                1,
            ] + [
                0,
                0.1 * step[1],
                1e-3 * step[2],
            ]
            moved[1] = np.clip(moved[1], 0.0, 0.48)
            new_residual, new_jacobian = (part.copy() for part in linearised(moved))
            if new_residual @ new_residual < residual @ residual:
                done = np.abs(step).max() < 1e-8
                values = moved
                residual = new_residual
                jacobian = new_jacobian
                damping = 0.1 * damping
                if done:
                    break
            else:
                damping *= 10.0
                if damping > 1e8:
                    break
        return values

    def scipy(self) -> np.ndarray:
        """Trust region with two-point differences; the finite elements at every guess."""
        squeezes = np.linspace(0.0, 0.6, 11)
        grid = self.table.squeeze

        def residual(scaled: np.ndarray) -> np.ndarray:
            values = scaled * self.scale
            curve = self.solver.curve(
                squeezes * EDGE,
                *lame(1.0, values[1]),
            )
            spline = CubicHermiteSpline(
                squeezes,
                curve.force / EDGE**2,
                curve.by_squeeze / EDGE,
            )
            nodes = np.zeros((len(grid), 2, 4))
            nodes[:, :, 0] = spline(grid)[:, None]
            nodes[:, :, 1] = spline(grid, 1)[:, None] * grid[1]
            table = Response(
                f"one curve at {values[1]}",
                grid,
                np.array([0.0, 0.48]),
                nodes,
            )
            return (self._rollout(self._simulator(table), values) - self.seen) / 1e-3

        bounds = np.array([[100.0, 0.0, -0.005], [1e6, 0.48, 0.005]]) / self.scale
        found = least_squares(
            residual, self.start / self.scale, bounds=bounds, xtol=1e-8, ftol=1e-8, gtol=1e-8
        )
        return found.x * self.scale


def rows(_: Any = None) -> list[Row]:
    """The table's lines."""
    # a tenth of the motion is enough to see that it runs
    frames = 6 if cases.once else 60
    lines = []
    for cells, goal in GOALS.items():
        lines += _rollout_rows(cells, frames, goal)
    lines += _memory_rows(frames)
    lines += _fit_rows()
    return lines


def _rollout_rows(
    cells: int,
    frames: int,
    goal: float,
) -> list[Row]:
    """Rollout and gradient in three ways, for a block of so many cells along an edge."""
    body, run, p = explicit_case(cells, frames)
    three = PerSubstep(body, run, p)
    one = OnePerSubstep(body, run, p)
    answer = fused(body, run, p)
    off = difference(answer, three())
    off_one = difference(answer, one())
    by_three, by_one, ours = measure_in_turn(
        (three, one, lambda: fused(body, run, p)), 3, (1, 1, 3)
    )
    block = f"soft block {cells}^3"
    ratio = f"{by_one.median / ours.median:.0f}x"
    return [
        Row(f"{block}: ours, a segment per launch, rollout and gradient", ours),
        _compared(
            f"{block}: three launches per substep and wp.Tape",
            by_three,
            ours,
            goal,
            off <= EQUAL,
            f"differs by {off:.1g}",
        ),
        Row(
            f"{block}: our kernel once per substep and wp.Tape",
            by_one,
            ratio,
            note=f"no goal; differs by {off_one:.1g}",
        ),
    ]


def _memory_rows(frames: int) -> list[Row]:
    """A fine block with all states kept, and with those at the starts of segments alone."""
    body, run, p = explicit_case(8, frames)
    lines = []
    for keep in ("states", "starts"):
        eight = measure(
            lambda k=keep: body.rollout(run, p, k).gradient(np.ones((1, frames))),
            repeats=3,
            warm_up=1,
        )
        mebibytes = body.rollout(run, p, keep).bytes / 2**20
        lines.append(
            Row(
                f"soft block 8^3, keep={keep}: rollout and gradient",
                eight,
                note=f"{mebibytes:.0f} MiB of states",
            )
        )
    return lines


def _fit_rows() -> list[Row]:
    """Softness from one closing, both ways."""
    fit = Fit()
    by_scipy = Kept(fit.scipy)
    by_us = Kept(fit.ours)
    theirs, ours = measure_in_turn((by_scipy, by_us), 3, (1, 10))
    ours_off = np.abs(by_us.answer / fit.truth - 1.0)
    scipy_off = np.abs(by_scipy.answer / fit.truth - 1.0)
    same = bool(ours_off[0] < 0.005 and scipy_off[0] < 0.005)
    return [
        Row("softness: our fit over the table", ours, note=_found(by_us.answer, fit)),
        _compared(
            "softness: scipy, differences over the same finite elements",
            theirs,
            ours,
            FIT_GOAL,
            same,
            _found(by_scipy.answer, fit),
        ),
    ]


def _compared(
    what: str,
    theirs: Timing,
    ours: Timing,
    goal: float,
    same: bool,
    note: str,
) -> Row:
    if not same:
        return Row(what, theirs, "void", False, note)
    ratio = theirs.median / ours.median
    return Row(what, theirs, f"{ratio:.0f}x (goal >= {goal:g}x)", ratio >= goal, note)


def _found(values: np.ndarray, fit: Fit) -> str:
    return f"E {values[0]:.1f} Pa ({100 * (values[0] / fit.truth[0] - 1):+.3f} %), nu {values[1]:.4f}, gap {1e3 * values[2]:.3f} mm"
