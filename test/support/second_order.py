"""An independent block: 27-node hexahedra of second order and the paper's equation (4), written down without anything of ours.

Only an eighth of the block is meshed; its faces at zero are planes of symmetry, and the one at the highest x is bonded to a
finger.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

_NODES = np.array([-1.0, 0.0, 1.0])
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def _shape(at: float) -> tuple[np.ndarray, np.ndarray]:
    value = np.array([0.5 * at * (at - 1.0), 1.0 - at**2, 0.5 * at * (at + 1.0)])
    return value, np.array([at - 0.5, -2.0 * at, at + 0.5])


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
    """
    n = 2 * elements + 1
    h = edge / 2.0 / elements
    grid = np.linspace(0.0, edge / 2.0, n)
    points = np.stack(
        np.meshgrid(
            grid,
            grid,
            grid,
            indexing="ij",
        ),
        axis=-1,
    ).reshape(-1, 3)
    number = np.arange(n**3).reshape(
        n,
        n,
        n,
    )
    corners = np.array(
        [
            number[2 * i : 2 * i + 3, 2 * j : 2 * j + 3, 2 * k : 2 * k + 3].ravel()
            for i in range(elements)
            for j in range(elements)
            for k in range(elements)
        ]
    )
    gradients = []
    weights = []
    for a, wa in zip(_POINTS, _WEIGHTS, strict=True):
        for b, wb in zip(_POINTS, _WEIGHTS, strict=True):
            for c, wc in zip(_POINTS, _WEIGHTS, strict=True):
                (na, da), (nb, db), (nc, dc) = _shape(a), _shape(b), _shape(c)
                parts = [
                    np.einsum("i,j,k", *x).ravel()
                    for x in ((da, nb, nc), (na, db, nc), (na, nb, dc))
                ]
                gradients.append(np.stack(parts, axis=1) * 2.0 / h)
                weights.append(wa * wb * wc * (h / 2.0) ** 3)
    grad, weight = np.array(gradients), np.array(weights)
    top = number[-1].ravel()
    held = np.zeros((n**3, 3), dtype=bool)
    held[number[0].ravel(), 0] = held[number[:, 0].ravel(), 1] = held[
        number[:, :, 0].ravel(), 2
    ] = True
    held[top] = True
    free = np.flatnonzero(~held)
    rows = (3 * corners[:, :, None] + np.arange(3)).reshape(
        len(corners),
        81,
    )
    identity = np.eye(3)

    def assemble(x: np.ndarray) -> tuple[np.ndarray, csc_matrix]:
        f = np.einsum("eka,qkb->eqab", x[corners], grad)
        inverse = np.linalg.inv(f).swapaxes(-1, -2)  # F^-T
        log_j = np.log(np.linalg.det(f))[..., None, None]
        p = mu * (f - inverse) + lam * log_j * inverse
        tangent = mu * np.einsum("ac,bd->abcd", identity, identity) + lam * np.einsum(
            "eqab,eqcd->eqabcd", inverse, inverse
        )
        tangent = tangent + np.einsum(
            "eq,eqad,eqcb->eqabcd", mu - lam * log_j[..., 0, 0], inverse, inverse
        )
        force = np.einsum("q,eqab,qkb->eka", weight, p, grad)
        half = np.einsum("q,eqabcd,qkb->eqkacd", weight, tangent, grad)
        stiff = np.einsum("eqkacd,qld->ekalc", half, grad, optimize=True).reshape(
            len(corners), 81, 81
        )
        total = np.bincount(
            rows.ravel(), force.reshape(len(corners), 81).ravel(), minlength=3 * n**3
        )
        index = np.repeat(rows, 81, axis=1).ravel(), np.tile(rows, (1, 81)).ravel()
        return total, csc_matrix(
            (stiff.ravel(), index),
            shape=(3 * n**3, 3 * n**3),
        )

    forces = []
    x = points.copy()
    for squeeze in squeezes:
        ratio = (edge / 2.0 - squeeze / 2.0) / x[top[0], 0]
        x[:, 0] *= ratio  # stretch the last answer
        for _ in range(30):
            total, stiff = assemble(x)
            if np.abs(total[free]).max() < 1e-10 * mu * edge**2:
                break
            x.ravel()[free] -= splu(stiff[free][:, free]).solve(total[free])
        else:
            raise AssertionError("the reference found no equilibrium")
        forces.append(-4.0 * total.reshape(-1, 3)[top, 0].sum())
    return np.array(forces)
