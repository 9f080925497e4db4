"""The block between two fingers, in equilibrium at every instant: force, stiffness and exact sensitivities from finite elements.

The nodal positions x minimise the elastic energy of ``energies.py``,

    E(x) = sum_t V_t mu w(F_t) + sum_c V_c lambda u(j_c),     j_c = sum over the tetrahedra t of cell c of V_t j_t / V_c

with both ends held by the fingers' faces. One face stays, the other is moved towards it by the squeeze d. ``bonded``: the nodes
of both faces keep their places on it (sandpaper, or glue). ``frictionless``: they slide (oil on PTFE); a rigid motion along the
faces is then taken out by three constraints that bear no force.

Equilibrium is found by Newton's method with the exact Hessian K, from one squeeze to the next along the tangent of the
solution; a step that does not lower the energy is shortened, a Hessian that is not positive along its step is shifted. The
force and its derivatives follow from the implicit function theorem with one more solve,

    P = dE/dd = g . f,     f = dE/dx,     g = dx/dd of the held coordinates
    a = K_ff^-1 K_fp g,    dP/dd = g . K_pp g - a . K_fp g,    dP/dtheta = g . f_theta - a . f_theta,     theta = mu, lambda

(f of the free coordinates, p of the held ones), and as E is linear in mu and lambda, f_theta is the force of a block of mu = 1
alone or of lambda = 1 alone.

Departures from the paper (Chen et al. 2025, arXiv:2410.03920): it integrates the block's own elastodynamics. The fingers'
reflected inertia is a thousand times the block's mass, so that the two differ by a tenth of an encoder count (measured with
``softbody.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, identity
from scipy.sparse.linalg import splu

from proprio_ros.errors import SimulationError
from proprio_ros.sim.energies import (
    LEAST_J,
    bulk_energy,
    check_law,
    check_material,
    shear_energy,
    volume,
)
from proprio_ros.sim.mesh import TetMesh

CONTACTS = ("bonded", "frictionless")
TOLERANCE = 1e-11
"""Out-of-balance force at which Newton's method ends, relative to shear and first Lamé modulus times cross-section."""
MAX_ITERATIONS = 60
_SHORTEST = 2.0**-12  # of an increment of the squeeze


class Elastic:
    """Energy, force and stiffness of a mesh under a law; j is the mean over a cell, which cures locking."""

    def __init__(self, mesh: TetMesh, law: str = "log") -> None:
        self.mesh = mesh
        self.law = check_law(law)
        tets, count, self._cells = mesh.tets, len(mesh.tets), mesh.cells
        self._cell_volumes = np.bincount(mesh.cells, mesh.volumes)
        self._share = mesh.volumes / self._cell_volumes[mesh.cells]
        self._unknowns = 3 * len(mesh.points)
        # of the entries of F by the twelve coordinates of a tetrahedron, (M, 9, 12)
        self._by_corner = (
            np.einsum("ab,mkc->macbk", np.eye(3), mesh.gradients)
            .swapaxes(3, 4)
            .reshape(count, 9, 12)
        )
        self._rows = (3 * tets[:, :, None] + np.arange(3)).reshape(
            count,
            12,
        )
        of_row = np.repeat(self._rows, 12, axis=1) * self._unknowns
        pairs = of_row + np.tile(self._rows, (1, 12))
        unique, self._slots = np.unique(pairs, return_inverse=True)
        self._slots = self._slots.reshape(-1)
        # symmetric: rows and columns may change places
        self._pointers = np.searchsorted(
            unique // self._unknowns,
            np.arange(self._unknowns + 1),
        )
        self._indices = unique % self._unknowns
        self._cell_rows = np.repeat(mesh.cells, 12)

    def deformation(self, points: np.ndarray) -> np.ndarray:
        """F of every tetrahedron, (M, 3, 3)."""
        corners = points[self.mesh.tets]
        return np.asarray(np.swapaxes(corners, 1, 2) @ self.mesh.gradients)

    def energies(self, points: np.ndarray) -> np.ndarray:
        """Elastic energy at mu = 1 alone and at lambda = 1 alone [m^3], shape (2,)."""
        f = self.deformation(points)
        u = bulk_energy(self.law, self._cell_mean(volume(self.law, f)[0]))[0]
        return np.array([self.mesh.volumes @ shear_energy(self.law, f)[0], self._cell_volumes @ u])

    def forces(self, points: np.ndarray) -> np.ndarray:
        """dE/dx at mu = 1 alone and at lambda = 1 alone [m^2], shape (2, N, 3)."""
        f = self.deformation(points)
        j, j_by_f, _ = volume(self.law, f)
        first = bulk_energy(self.law, self._cell_mean(j))[1][self._cells]
        by_mu = self.mesh.volumes[:, None] * shear_energy(self.law, f)[1]
        by_lambda = (self.mesh.volumes * first)[:, None] * j_by_f
        return np.stack([self._gather(by_mu), self._gather(by_lambda)])

    def linearised(
        self, points: np.ndarray, mu: float, lam: float
    ) -> tuple[float, np.ndarray, csc_matrix]:
        """Energy [J], dE/dx (N, 3) [N] and its derivative (3N, 3N) [N/m].

        Args:
            points: Where the nodes are [m], shape (N, 3).
            mu: First parameter of the law [Pa].
            lam: Second [Pa].
        """
        f = self.deformation(points)
        w, by_f, tangent = shear_energy(self.law, f)
        j, j_by_f, j_curvature = volume(self.law, f)
        u, first, second = bulk_energy(self.law, self._cell_mean(j))
        push = lam * first[self._cells]
        volumes = self.mesh.volumes[:, None]
        of_shear = mu * float(self.mesh.volumes @ w)
        energy = of_shear + lam * float(self._cell_volumes @ u)
        stress = mu * by_f + push[:, None] * j_by_f  # (M, 9)
        force = self._gather(volumes * stress)
        by_stretch = mu * tangent + push[:, None, None] * j_curvature  # (M, 9, 9)
        local = volumes[:, :, None] * by_stretch
        blocks = np.swapaxes(self._by_corner, 1, 2) @ local @ self._by_corner
        values = np.bincount(
            self._slots,
            blocks.ravel(),
            minlength=len(self._indices),
        )
        shape = (self._unknowns, self._unknowns)
        stiffness = csc_matrix((values, self._indices, self._pointers), shape=shape)
        # and lambda V_c u'' grad j_c (x) grad j_c of the cells
        slope = (self._share[:, None] * j_by_f)[:, None, :] @ self._by_corner
        by_x = csr_matrix(
            (slope.ravel(), (self._cell_rows, self._rows.ravel())),
            (len(self._cell_volumes), shape[0]),
        )
        weights = lam * second * self._cell_volumes
        of_cells = by_x.T @ by_x.multiply(weights[:, None]).tocsr()
        return energy, force, (stiffness + of_cells).tocsc()

    def least_j(self, points: np.ndarray) -> float:
        """Smallest volume of a tetrahedron relative to that at rest."""
        return float(np.linalg.det(self.deformation(points)).min())

    def _cell_mean(self, j: np.ndarray) -> np.ndarray:
        return np.bincount(self._cells, self._share * j)

    def _gather(self, by_f: np.ndarray) -> np.ndarray:
        by_corner = np.einsum("mi,mij->mj", by_f, self._by_corner)
        return np.bincount(self._rows.ravel(), by_corner.ravel(), minlength=self._unknowns).reshape(
            -1, 3
        )


@dataclass(frozen=True)
class SqueezeCurve:
    """Equilibria at K squeezes; all shapes are (K,) but for the nodes' positions."""

    squeeze: np.ndarray  # how far the faces were moved together [m]
    # that the block pushes each finger with [N], and its derivatives [N/m, N/Pa, N/Pa]
    force: np.ndarray
    by_squeeze: np.ndarray
    by_mu: np.ndarray
    by_lambda: np.ndarray
    points: np.ndarray  # nodal positions [m], shape (K, N, 3)
    least_j: np.ndarray  # smallest relative volume of a tetrahedron
    iterations: int  # of Newton's method, in all


class QuasiStatic:
    """Squeezes a block to given distances, by one of ``energies.LAWS`` and one of ``CONTACTS`` (else SimulationError).

    As an octant the mesh is an eighth of the block, and its faces at the lowest x, y and z are planes of symmetry.
    Squeeze and force are still those of the whole block.
    """

    def __init__(
        self,
        mesh: TetMesh,
        law: str = "log",
        contact: str = "bonded",
        octant: bool = False,
    ) -> None:
        if contact not in CONTACTS:
            raise SimulationError(
                f"unknown contact {contact!r}: choose one of {', '.join(CONTACTS)}"
            )
        self.mesh = mesh
        self.elastic = Elastic(mesh, law)
        low = mesh.end(0, False)
        high = mesh.end(0, True)
        held = np.zeros((len(mesh.points), 3), dtype=bool)
        held[low, 0] = held[high, 0] = True
        if contact == "bonded":
            held[high] = True
        if octant:
            held[mesh.end(1, False), 1] = held[mesh.end(2, False), 2] = True
        elif contact == "bonded":
            held[low] = True
        else:
            _pin(mesh, held)
        self._held = np.flatnonzero(held)
        self._free = np.flatnonzero(~held)
        # one finger's share of a unit of squeeze, and how many times the mesh's force one finger feels
        self._travel, self._fold = (0.5, 4.0) if octant else (1.0, 1.0)
        self._by_squeeze = np.zeros((len(mesh.points), 3))
        self._by_squeeze[high, 0] = -1.0
        self._length = mesh.length / self._travel

    def curve(
        self,
        squeeze: Sequence[float] | np.ndarray,
        mu: float,
        lam: float,
    ) -> SqueezeCurve:
        """Equilibria at squeezes, reached from rest one after the other.

        Args:
            squeeze: By how much the block is shortened [m], shape (K,).
            mu: First parameter of the law [Pa].
            lam: Second [Pa].

        Raises:
            SimulationError: No such solid, a squeeze of the whole length, or no equilibrium found.
        """
        check_material(self.elastic.law, mu, lam)
        squeeze = np.asarray(squeeze, dtype=np.float64)
        if squeeze.ndim != 1 or not np.isfinite(squeeze).all() or (squeeze >= self._length).any():
            raise SimulationError(
                f"a block of {1e3 * self._length:g} mm cannot be squeezed by that much: give less, in metres"
            )
        unit = abs(mu) + abs(lam)
        soft = (mu / unit, lam / unit)
        scales = np.array([unit, unit * self._travel, 1.0, 1.0])
        results = np.zeros((4, len(squeeze)))
        least_j = np.zeros(len(squeeze))
        places = np.zeros((len(squeeze), *self.mesh.points.shape))
        points = self.mesh.points.copy()
        at = 0.0
        iterations = 0
        derivatives, slope = self._sensitivities(points, soft)
        for k, goal in enumerate(self._travel * squeeze):
            increment = goal - at
            while at != goal:
                end = goal if abs(goal - at) <= abs(increment) else at + increment
                found, count = self._equilibrium(points + (end - at) * slope, soft)
                iterations += count
                if found is None:
                    increment *= 0.5
                    if abs(increment) < _SHORTEST * self.mesh.length:
                        raise SimulationError(
                            f"no equilibrium beyond a squeeze of {100 * at / self.mesh.length:.3g} % of the block's length: "
                            "squeeze less, or take a coarser mesh or another law"
                        )
                    continue
                points = found
                at = end
                derivatives, slope = self._sensitivities(points, soft)
            results[:, k] = self._fold * scales * derivatives
            least_j[k] = self.elastic.least_j(points)
            places[k] = points
            if self.elastic.law == "log" and least_j[k] <= LEAST_J:
                raise SimulationError(
                    f"at a squeeze of {100 * squeeze[k] / self._length:.3g} % an element is crushed to "
                    f"{100 * least_j[k]:.3g} % of its volume: squeeze less"
                )
        force, by_squeeze, by_mu, by_lambda = results
        return SqueezeCurve(
            squeeze, force, by_squeeze, by_mu, by_lambda, places, least_j, iterations
        )

    def _equilibrium(
        self, points: np.ndarray, soft: tuple[float, float]
    ) -> tuple[np.ndarray | None, int]:
        """The free nodes' places at these places of the held ones, and the number of iterations; None where not found."""
        free = self._free
        limit = TOLERANCE * self.mesh.area
        energy, force, stiffness = self.elastic.linearised(points, *soft)
        for iteration in range(MAX_ITERATIONS):
            residual = force.ravel()[free]
            if not np.isfinite(residual).all():
                return None, iteration
            if np.abs(residual).max() <= limit:
                return points, iteration
            step = self._descent(stiffness[free][:, free], residual)
            slope = float(residual @ step)
            if np.abs(step).max() > 0.5 * self.mesh.length:
                return None, iteration
            rounding = 1e-13 * (abs(energy) + abs(slope))
            for halvings in range(12):
                moved = points.copy()
                moved.ravel()[free] += 0.5**halvings * step
                if (
                    self.elastic.energies(moved) @ soft
                    <= energy + 1e-4 * 0.5**halvings * slope + rounding
                ):
                    break
            else:
                return None, iteration
            points = moved
            energy, force, stiffness = self.elastic.linearised(points, *soft)
        return None, MAX_ITERATIONS

    def _descent(self, stiffness: csc_matrix, residual: np.ndarray) -> np.ndarray:
        shift = 0.0
        while True:
            shifted = (
                stiffness + shift * identity(len(residual), format="csc") if shift else stiffness
            )
            step = -_factor(shifted).solve(residual)
            if residual @ step < 0.0:
                return step
            shift = 10.0 * shift or 1e-3 * float(np.abs(stiffness.diagonal()).mean())

    def _sensitivities(
        self, points: np.ndarray, soft: tuple[float, float]
    ) -> tuple[tuple[float, float, float, float], np.ndarray]:
        """Force and its derivatives by the mesh's squeeze, mu and lambda (in units of ``unit``); dx/dd (N, 3)."""
        _, force, stiffness = self.elastic.linearised(points, *soft)
        free = self._free
        g = self._by_squeeze.ravel()
        pull = stiffness @ g
        answer = np.zeros_like(g)
        answer[free] = _factor(stiffness[free][:, free]).solve(pull[free])
        by_theta = self.elastic.forces(points).reshape(2, -1) @ (g - answer)
        by_d = float(g @ pull - answer @ pull)
        return (
            float(g @ force.ravel()),
            by_d,
            float(by_theta[0]),
            float(by_theta[1]),
        ), (g - answer).reshape(-1, 3)


def _factor(stiffness: csc_matrix) -> splu:
    return splu(
        stiffness,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.01,
        options={"SymmetricMode": True},
    )


def _pin(mesh: TetMesh, held: np.ndarray) -> None:
    """Hold three coordinates so that the block cannot slide or turn along frictionless faces."""
    face = mesh.end(0, False)
    first = face[0]
    _, across, along = np.abs(mesh.points[face] - mesh.points[first]).T
    second = face[np.argmax(across - 10.0 * along)]
    held[first, 1:] = True
    held[second, 2] = True
