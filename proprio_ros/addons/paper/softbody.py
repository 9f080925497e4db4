"""The block as the paper moves it: explicit elastodynamics of its nodes between two fingers that one motor closes.

What it is for: it is the paper's way, and it checks the quasi-static block of ``quasistatic.py`` and ``squeeze.py``, which is what
a fit runs. Nothing here is fast enough for that: the step is limited by the block's fastest wave (``most_step_s``).

With nodal forces f = -dE/dx of the energy of ``quasistatic.py`` and a viscosity of the material as warp.sim has it, equations
(2) and (4) of the paper (Chen et al. 2025, arXiv:2410.03920) for a gripper with joint coordinate q, positive when closing:

    d = travel q - gap                                     squeeze; each finger moves by d / 2
    J dw/dt = k_t i - f_c tanh(w / v_s) - f_v w - travel P,      P = (push on one finger + push on the other) / 2
    m_i dv_i/dt = f_i,      F_i from stress P(F) + eta dF/dt,     F = sum of x_k (x) grad N_k

integrated by semi-implicit Euler: first w and v from the state as it was, then q and x with the new w and v. While d > 0 the
nodes of a face have its x; ``bonded`` ones also keep their place on it, ``frictionless`` ones slide. The faces' nodes are part
of the gripper's inertia, with travel^2 / 4 of their mass. Before the fingers touch, the block is at rest. Gravity of the block
is left out: at most 0.2 % of the force at squeezes of 10 to 30 %.

All steps of a segment of frames run in one launch and every step writes its own row (an adjoint is only right when no state is
overwritten). The gradient comes from the adjoint of the same kernel, segment by segment from the last one backwards.
``keep="states"`` holds the states of all steps; ``keep="starts"`` holds those at the start of each segment and computes the
others again: the same gradient for a third more time and a fraction of the memory.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import eigsh

from proprio_ros.addons.paper.softbody_kernels import MAT33, SOFT_PARAMETERS, frame_kernel
from proprio_ros.errors import SimulationError
from proprio_ros.sim.energies import check_law, check_material
from proprio_ros.sim.joint_kernels import VEC3
from proprio_ros.sim.mesh import TetMesh
from proprio_ros.sim.quasistatic import CONTACTS, Elastic
from proprio_ros.sim.runtime import FLOAT

SOFT_INDEX = {name: row for row, name in enumerate(SOFT_PARAMETERS)}
KEEP = ("states", "starts")
SEGMENT_BYTES = 2**20
"""States of a segment: as many whole frames as fit, at least one. A launch costs 50 us, and what fits into the cache is faster."""
_STATES = 4
FRICTION_VELOCITY = 1e-3  # v_s, where Coulomb's law is smoothed [rad/s]
# of the longest stable step at rest; a block that is squeezed by 40 % is stiffer, by 1.2 in frequency
MARGIN = 0.8


@dataclass(frozen=True)
class SoftRun:
    """What one rollout is driven by."""

    input_times_s: np.ndarray  # when the current changes [s], increasing, first at 0, shape (I,)
    input_current_A: np.ndarray  # from each of those instants on, shape (I,)
    frames: int  # a position is compared at the end of each
    frame_s: float = 1.0 / 60.0
    substeps: int = 64  # of a frame

    @property
    def step_s(self) -> float:
        """Length of one step [s]."""
        return self.frame_s / self.substeps

    def currents(self) -> np.ndarray:
        """The current at the start of every step [A], shape (frames * substeps,)."""
        times = np.arange(self.frames * self.substeps) * self.step_s
        last = np.searchsorted(self.input_times_s, times + 1e-9, side="right") - 1
        return np.asarray(self.input_current_A, dtype=np.float64)[last]


def _zeros(
    worlds: int,
    steps: int,
    nodes: int,
    cells: int,
) -> list[wp.array]:
    """States of some steps (or their adjoints): q, w, x, v; and what the kernel sums up in every step."""
    shapes = [((steps + 1,), FLOAT)] * 2 + [((steps + 1, nodes), VEC3)] * 2
    shapes += [
        ((steps, cells), FLOAT),
        ((steps, nodes), VEC3),
        ((steps,), FLOAT),
    ]
    return [wp.zeros((worlds, *shape), dtype=kind, device="cpu") for shape, kind in shapes]


def _carry(
    source: list[wp.array],
    row: int,
    target: list[wp.array],
    to: int,
) -> None:
    """Copy one row of the states to another."""
    for before, after in zip(source[:_STATES], target, strict=False):
        after.numpy()[:, to] = before.numpy()[:, row]


class SoftBody:
    """A block between the fingers of a gripper, many guesses (worlds) at a time.

    Its mass [kg] is spread evenly over its volume; the fingers close on each other by ``travel`` per unit of the joint
    [m/rad, or m/m], not 0. The law is one of ``energies.LAWS``, the contact one of ``quasistatic.CONTACTS``.

    Raises `SimulationError`: Unknown law or contact, no mass or no travel.
    """

    def __init__(
        self,
        mesh: TetMesh,
        mass: float,
        travel: float,
        law: str = "log",
        contact: str = "bonded",
    ) -> None:
        if contact not in CONTACTS:
            raise SimulationError(
                f"unknown contact {contact!r}: choose one of {', '.join(CONTACTS)}"
            )
        if not (np.isfinite(mass) and mass > 0.0 and np.isfinite(travel) and travel != 0.0):
            raise SimulationError(
                f"block.mass={mass:g} kg and a travel of {travel:g} m: the first must be above 0, the second not 0"
            )
        self.mesh = mesh
        self.law = check_law(law)
        self.contact = contact
        self.elastic = Elastic(mesh, law)
        self.travel = travel
        density = mass / float(mesh.volumes.sum())
        self.masses = np.bincount(
            mesh.tets.ravel(),
            np.repeat(0.25 * density * mesh.volumes, 4),
        )
        middle = np.array([mesh.low[0] + 0.5 * mesh.length, 0.0, 0.0])
        self._points = mesh.points - middle
        self._sides = np.zeros(len(mesh.points))
        self._sides[mesh.end(0, False)] = -1.0
        self._sides[mesh.end(0, True)] = 1.0
        self._ends = np.flatnonzero(self._sides)
        inverses = mesh.gradients[:, 1:]
        shares = mesh.volumes / np.bincount(mesh.cells, mesh.volumes)[mesh.cells]
        grams = inverses @ np.swapaxes(inverses, 1, 2)
        block = (
            mesh.tets,
            mesh.cells,
            shares,
            mesh.volumes,
            inverses,
            grams,
            self.masses,
            self._sides,
            self._ends,
        )
        kinds = wp.int32, wp.int32, FLOAT, FLOAT, MAT33, MAT33, FLOAT, FLOAT, wp.int32
        self._block = [
            wp.array(np.ascontiguousarray(values), dtype=kind, device="cpu")
            for values, kind in zip(block, kinds, strict=True)
        ]

    @cached_property
    def _fastest(self) -> tuple[float, float, float]:
        """Largest eigenvalues of stiffness over mass at mu = 1, lambda = 1, and of viscosity over mass at eta = 1.

        Of what can move: the fingers, or rest before they touch, hold the faces.
        """
        mesh = self.mesh
        gradients = mesh.gradients
        products = gradients @ np.swapaxes(gradients, 1, 2)
        local = mesh.volumes[:, None, None] * products
        rows = np.repeat(mesh.tets, 4, axis=1).ravel()
        columns = np.tile(mesh.tets, (1, 4)).ravel()
        shape = (len(mesh.points),) * 2
        viscous = coo_matrix((local.ravel(), (rows, columns)), shape=shape).tocsr()
        moves = np.ones((len(mesh.points), 3), dtype=bool)
        moves[self._ends, : 3 if self.contact == "bonded" else 1] = False
        if not moves.any():
            return 0.0, 0.0, 0.0
        masses = np.repeat(self.masses, 3)
        shear = self.elastic.linearised(mesh.points, 1.0, 0.0)[2]
        bulk = self.elastic.linearised(mesh.points, 0.0, 1.0)[2]
        return (
            _largest(shear, masses, moves.ravel()),
            _largest(bulk, masses, moves.ravel()),
            _largest(viscous, self.masses, moves.any(axis=1)),
        )

    def most_step_s(self, mu: float, lam: float, viscosity: float = 0.0) -> float:
        """Longest stable step at rest [s]: h^2 omega^2 + 2 h c < 4 with the fastest wave's omega and damping c.

        Args:
            mu: Lame's second parameter, the shear modulus [Pa].
            lam: Lame's first parameter [Pa].
            viscosity: Of the block [Pa s].
        """
        shear, bulk, viscous = self._fastest
        omega2 = mu * shear + max(lam, 0.0) * bulk
        damping = viscosity * viscous
        if omega2 == 0.0:
            return np.inf
        return float((np.sqrt(damping**2 + 4.0 * omega2) - damping) / omega2)

    def rollout(
        self,
        run: SoftRun,
        p: np.ndarray,
        keep: str = "states",
        start: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> "SoftRollout":
        """Integrate the run for some guesses.

        Args:
            run: Current and steps.
            p: Parameters of each world in the order of ``SOFT_PARAMETERS``, shape (W, P).
            keep: ``"states"`` of all steps, or ``"starts"`` of the segments.
            start: Positions [m] and velocities [m/s] of the nodes at the start, relative to the middle between the fingers,
                each (N, 3); default at rest. Nodes of pressed faces go to where the fingers are.

        Raises `SimulationError`: Unknown ``keep``, no such solid, steps too long, or the block was torn to pieces on the way.
        """
        if keep not in KEEP:
            raise SimulationError(f"unknown keep={keep!r}: choose one of {', '.join(KEEP)}")
        p = np.array(p, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != len(SOFT_PARAMETERS) or not np.isfinite(p).all():
            raise SimulationError(
                f"parameters must be rows of finite numbers: {', '.join(SOFT_PARAMETERS)}"
            )
        for row in p:
            mu = row[SOFT_INDEX["lame_mu"]]
            lam = row[SOFT_INDEX["lame_lambda"]]
            eta = row[SOFT_INDEX["viscosity"]]
            check_material(self.law, mu, lam)
            longest = MARGIN * self.most_step_s(mu, lam, eta)
            if run.step_s > longest:
                raise SimulationError(
                    f"steps of {1e6 * run.step_s:.3g} us are too long for a block of mu = {mu:.4g} Pa, lambda = {lam:.4g} Pa on "
                    f"this mesh: take {int(np.ceil(run.frame_s / longest))} substeps or more instead of {run.substeps}"
                )
        return SoftRollout(self, run, p, keep, start)

    def _start(
        self, p: np.ndarray, given: tuple[np.ndarray, np.ndarray] | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities of the nodes of each world, each (W, N, 3)."""
        x, v = (self._points, np.zeros_like(self._points)) if given is None else given
        x = np.tile(x, (len(p), 1, 1))
        v = np.tile(v, (len(p), 1, 1))
        squeeze = self.travel * p[:, SOFT_INDEX["q0"]] - p[:, SOFT_INDEX["gap"]]
        pressed = squeeze > 0.0
        side = self._sides[self._ends]
        x[:, self._ends, 0] = side * (
            0.5 * self.mesh.length - 0.5 * np.maximum(squeeze, 0.0)[:, None]
        )
        v[:, self._ends, 0] = (
            -0.5 * side * self.travel * (pressed * p[:, SOFT_INDEX["v0"]])[:, None]
        )
        if self.contact == "bonded":
            v[:, self._ends, 1:] = 0.0
        return x, v


def _doubles(values: Any) -> wp.array:
    return wp.array(np.asarray(values), dtype=FLOAT, device="cpu")


def _largest(matrix: Any, masses: np.ndarray, moves: Any) -> float:
    """Largest eigenvalue of a symmetric matrix over masses, of the coordinates that move."""
    root = diags(1.0 / np.sqrt(masses[moves]))
    scaled = root @ matrix.tocsr()[moves][:, moves] @ root
    if scaled.shape[0] < 50:
        return float(np.linalg.eigvalsh(scaled.toarray())[-1])
    return float(eigsh(scaled, k=1, which="LA", return_eigenvectors=False, tol=1e-4)[0])


class SoftRollout:
    """One rollout and its adjoint.

    Attributes:
        q, v: Joint coordinate and velocity at the end of every frame, shape (W, K).
        points, velocities: Of the nodes at the end, relative to the middle between the fingers, shape (W, N, 3).
        bytes: Of memory, for all states that are kept and those of one segment.
    """

    def __init__(
        self,
        owner: SoftBody,
        run: SoftRun,
        p: np.ndarray,
        keep: str,
        start: tuple[np.ndarray, np.ndarray] | None,
    ) -> None:
        self._owner = owner
        self._run = run
        self._keep = keep
        self._given = p
        self._p = _doubles(p)
        faces_mass = float(owner.masses[owner._ends].sum())
        self._constants = _doubles(
            [0.5 * owner.mesh.length, owner.travel, FRICTION_VELOCITY, faces_mass, run.step_s]
        )
        self._kernel = frame_kernel(owner.law, owner.contact == "bonded")
        self._frames = self._frames_of_a_segment()
        self._first = list(range(0, run.frames, self._frames))  # frame of each segment
        currents = run.currents()
        self._currents = [
            _doubles(currents[k * run.substeps : (k + self._frames) * run.substeps])
            for k in self._first
        ]
        squeezed = owner.travel * p[:, SOFT_INDEX["q0"]]
        self._pressed_at_start = squeezed > p[:, SOFT_INDEX["gap"]]
        self._segments: list[list[wp.array]] = []
        self.q = np.zeros((len(p), run.frames))
        self.v = np.zeros((len(p), run.frames))
        done = self._roll(start)
        self.points = done[2].numpy()[:, -1].copy()
        self.velocities = done[3].numpy()[:, -1].copy()
        if not (np.isfinite(self.q).all() and np.isfinite(self.points).all()):
            raise SimulationError(
                "the rollout diverged: a squeezed block is stiffer than at rest; take more substeps, or less current"
            )
        kept = [*self._segments]
        if keep == "starts":
            kept.append(done)
        self.bytes = sum(int(array.capacity) for rows in kept for array in rows)

    def _frames_of_a_segment(self) -> int:
        """As many as `SEGMENT_BYTES` hold the states of."""
        mesh = self._owner.mesh
        numbers = 3 + 9 * len(mesh.points) + mesh.cell_count
        per_frame = 8 * len(self._given) * self._run.substeps * numbers
        return max(1, min(self._run.frames, SEGMENT_BYTES // per_frame))

    def _roll(self, start: tuple[np.ndarray, np.ndarray] | None) -> list[wp.array]:
        """All segments, one after the other; returns the states of the last one."""
        owner = self._owner
        substeps = self._run.substeps
        p = self._given
        done: list[wp.array] = []
        for segment, frame in enumerate(self._first):
            rows = self._rows(0 if self._keep == "starts" else self._steps(segment))
            if segment:
                _carry(done, self._steps(segment - 1), rows, 0)
            else:
                q0 = p[:, SOFT_INDEX["q0"]]
                v0 = p[:, SOFT_INDEX["v0"]]
                for array, value in zip(rows, (q0, v0, *owner._start(p, start)), strict=False):
                    array.numpy()[:, 0] = value
            self._segments.append(rows)
            done = self._integrate(segment)
            ends = slice(frame, frame + self._frames)
            self.q[:, ends] = done[0].numpy()[:, substeps::substeps]
            self.v[:, ends] = done[1].numpy()[:, substeps::substeps]
        return done

    def _steps(self, segment: int) -> int:
        return int(self._currents[segment].shape[0])

    def _rows(self, steps: int) -> list[wp.array]:
        mesh = self._owner.mesh
        return _zeros(
            len(self._given),
            steps,
            len(mesh.points),
            mesh.cell_count,
        )

    def _launch(self, segment: int, rows: list[wp.array], **adjoint: Any) -> None:
        inputs = [
            *self._owner._block,
            self._constants,
            self._currents[segment],
            self._p,
        ]
        wp.launch(
            self._kernel, dim=len(self._given), inputs=inputs, outputs=rows, device="cpu", **adjoint
        )

    def _integrate(self, segment: int) -> list[wp.array]:
        """Every step of a segment, from the start that is kept."""
        rows = self._segments[segment]
        if self._keep == "starts":
            start = rows
            rows = self._rows(self._steps(segment))
            _carry(start, 0, rows, 0)
        self._launch(segment, rows)
        return rows

    def gradient(self, weights: np.ndarray) -> np.ndarray:
        """Gradient of ``sum(weights * q)``, weights of shape (W, K), by the parameters of each world, shape (W, P)."""
        run = self._run
        later = self._rows(0)
        by_p = wp.zeros_like(self._p)
        given = [None] * (len(self._owner._block) + 2)
        adjoint: dict[int, list[wp.array]] = {}
        for segment, frame in reversed(list(enumerate(self._first))):
            rows = self._segments[segment] if self._keep == "states" else self._integrate(segment)
            steps = self._steps(segment)
            if steps not in adjoint:  # two lengths at most: the last segment may be shorter
                adjoint[steps] = self._rows(steps)
            mine = adjoint[steps]
            for array in mine:
                array.zero_()
            _carry(later, 0, mine, steps)
            at_ends = weights[:, frame : frame + steps // run.substeps]
            mine[0].numpy()[:, run.substeps :: run.substeps] += at_ends
            self._launch(
                segment,
                rows,
                adj_inputs=[*given, by_p],
                adj_outputs=mine,
                adjoint=True,
            )
            _carry(mine, 0, later, 0)
        return by_p.numpy() + self._by_start(later)

    def _by_start(self, adjoint: list[wp.array]) -> np.ndarray:
        """What parameters change through the state at the start, by its adjoint, shape (W, P)."""
        owner = self._owner
        gradient = np.zeros((len(self._given), len(SOFT_PARAMETERS)))
        by_q, by_u, by_x, by_v = (array.numpy()[:, 0] for array in adjoint[:_STATES])
        # the start: q0 and v0, and the faces' nodes that the fingers hold there
        side = owner._sides[owner._ends]
        ends = owner._ends
        half = 0.5 * self._pressed_at_start
        along = -half * (by_x[:, ends, 0] @ side)
        gradient[:, SOFT_INDEX["q0"]] += by_q + owner.travel * along
        gradient[:, SOFT_INDEX["gap"]] -= along
        through_faces = half * owner.travel * (by_v[:, ends, 0] @ side)
        gradient[:, SOFT_INDEX["v0"]] += by_u - through_faces
        return gradient
