"""An independent block: 27-node hexahedra of second order and the paper's equation (4), written down without anything of ours.

Only an eighth of the block is meshed; its faces at zero are planes of symmetry, and the one at the highest x is bonded to a
finger.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

_NODES = np.array([-1.0, 0.0, 1.0])
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def _shape(at: float) -> tuple[np.ndarray, np.ndarray]:
    """The three polynomials of an edge and their slopes."""
    left = 0.5 * at * (at - 1.0)
    right = 0.5 * at * (at + 1.0)
    value = np.array([left, 1.0 - at**2, right])
    return value, np.array([at - 0.5, -2.0 * at, at + 0.5])


def _points_of_integration(h: float) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the 27 polynomials (Q, 27, 3) and weights (Q,) of an element of edge h."""
    gradients = []
    weights = []
    rule = list(zip(_POINTS, _WEIGHTS, strict=True))
    for (a, wa), (b, wb), (c, wc) in product(rule, repeat=3):
        na, da = _shape(a)
        nb, db = _shape(b)
        nc, dc = _shape(c)
        parts = [
            np.einsum("i,j,k", da, nb, nc).ravel(),
            np.einsum("i,j,k", na, db, nc).ravel(),
            np.einsum("i,j,k", na, nb, dc).ravel(),
        ]
        gradients.append(np.stack(parts, axis=1) * 2.0 / h)
        weights.append(wa * wb * wc * (h / 2.0) ** 3)
    return np.array(gradients), np.array(weights)


class _Eighth:
    """Nodes, elements and held degrees of freedom of an eighth of the cube."""

    def __init__(self, edge: float, elements: int) -> None:
        n = 2 * elements + 1
        grid = np.linspace(0.0, edge / 2.0, n)
        places = np.meshgrid(grid, grid, grid, indexing="ij")
        self.points = np.stack(places, axis=-1).reshape(-1, 3)
        number = np.arange(n**3).reshape(n, n, n)
        corners = []
        for i, j, k in product(range(0, n - 1, 2), repeat=3):
            element = number[i : i + 3, j : j + 3, k : k + 3]
            corners.append(element.ravel())
        self.corners = np.array(corners)
        self.top = number[-1].ravel()
        held = np.zeros((n**3, 3), dtype=bool)
        held[number[0].ravel(), 0] = True
        held[number[:, 0].ravel(), 1] = True
        held[number[:, :, 0].ravel(), 2] = True
        held[self.top] = True
        self.free = np.flatnonzero(~held)
        of_element = 3 * self.corners[:, :, None] + np.arange(3)
        self.rows = of_element.reshape(len(corners), 81)
        self.gradients, self.weights = _points_of_integration(edge / 2.0 / elements)

    def assembled(
        self,
        x: np.ndarray,
        mu: float,
        lam: float,
    ) -> tuple[np.ndarray, csc_matrix]:
        """Forces (3 N,) and stiffness (3 N, 3 N) of nodes at x (N, 3)."""
        grad = self.gradients
        f = np.einsum("eka,qkb->eqab", x[self.corners], grad)
        inverse = np.linalg.inv(f).swapaxes(-1, -2)  # F^-T
        log_j = np.log(np.linalg.det(f))[..., None, None]
        p = mu * (f - inverse) + lam * log_j * inverse
        tangent = _tangent(inverse, log_j[..., 0, 0], mu, lam)
        force = np.einsum("q,eqab,qkb->eka", self.weights, p, grad)
        half = np.einsum("q,eqabcd,qkb->eqkacd", self.weights, tangent, grad)
        stiff = np.einsum("eqkacd,qld->ekalc", half, grad, optimize=True)
        total = np.bincount(self.rows.ravel(), force.ravel(), minlength=x.size)
        down = np.repeat(self.rows, 81, axis=1).ravel()
        across = np.tile(self.rows, (1, 81)).ravel()
        return total, csc_matrix(
            (stiff.ravel(), (down, across)),
            shape=(x.size, x.size),
        )


def _tangent(
    inverse: np.ndarray,
    log_j: np.ndarray,
    mu: float,
    lam: float,
) -> np.ndarray:
    """Slope of the stress by the deformation, (E, Q, 3, 3, 3, 3)."""
    one = np.eye(3)
    tangent = mu * np.einsum("ac,bd->abcd", one, one)
    tangent = tangent + lam * np.einsum("eqab,eqcd->eqabcd", inverse, inverse)
    return tangent + np.einsum("eq,eqad,eqcb->eqabcd", mu - lam * log_j, inverse, inverse)


def bonded_force(
    edge: float,
    elements: int,
    squeezes: np.ndarray,
    mu: float,
    lam: float,
) -> np.ndarray:
    """Force on a finger [N] of a cube with bonded faces, at squeezes [m] in rising order.

    Args:
        edge: of the cube [m].
        elements: along each edge of an eighth of it.
        squeezes: how much nearer the fingers are than at first.
        mu: of the law [Pa].
        lam: of the law [Pa].
    """
    eighth = _Eighth(edge, elements)
    top = eighth.top
    free = eighth.free
    forces = []
    x = eighth.points.copy()
    for squeeze in squeezes:
        ratio = (edge / 2.0 - squeeze / 2.0) / x[top[0], 0]
        x[:, 0] *= ratio  # stretch the last answer
        for _ in range(30):
            total, stiff = eighth.assembled(x, mu, lam)
            if np.abs(total[free]).max() < 1e-10 * mu * edge**2:
                break
            step = splu(stiff[free][:, free]).solve(total[free])
            x.ravel()[free] -= step
        else:
            raise AssertionError("the reference found no equilibrium")
        pushes = total.reshape(-1, 3)[top, 0]
        forces.append(-4.0 * pushes.sum())
    return np.array(forces)
