"""What the block is made of: four laws of elasticity, with exact first and second derivatives.

With the deformation gradient F, J = det F and Ic = |F|^2, the energy per reference volume of each law is linear in the two Lamé
parameters of the paper (Chen et al. 2025, arXiv:2410.03920):

    Psi(F) = mu w(F) + lambda u(j)

    log          w = (Ic - 3) / 2 - log J                          u = (log j)^2 / 2    j = J     the paper's equation (4)
    smith        w = (Ic - 3) / 2 - (J - 1) + (J - 1)^2 / 2        u = (j - 1)^2 / 2    j = J     stable neo-Hookean
    linear       w = |sym F - 1|^2                                 u = (j - 1)^2 / 2    j = tr F - 2      Hooke
    warp_compat  w = (Ic - 3) / 2 - 3/4 (J - 1) - log((Ic + 1) / 4) / 2     u = (j - 1)^2 / 2    j = J

``log`` is Bonet and Wood's compressible neo-Hookean. ``smith`` is that of Smith, de Goes and Kim, "Stable Neo-Hookean Flesh
Simulation" (2018) without its logarithm and with lambda + mu before the square, so that mu and lambda mean what they mean in
Hooke's law; it stays finite where J <= 0, but its force in a strong squeeze rises to a peak and drops: no law for reported
values below a stretch of 0.7. ``warp_compat`` is equation (14) of Smith et al. (2018) with mu and lambda put in as they are, which
is what warp.sim integrated: at small strain it behaves as mu 3/4 and lambda - 5/8 mu (``small_strain_lame``). ``linear`` is for
tests; it takes a rotation for a strain.

Four-node tetrahedra with Poisson's ratios above 0.4 lock: each of them alone must keep its volume. The cure is to take j as the
mean over the cell, so that the lambda term is V_cell u(j_cell); at mu everything stays with the tetrahedron.

Inversion: log J is continued below J_0 = 0.05 by its second-order Taylor polynomial, with continuous first and second
derivative. Every energy is then finite everywhere, and an element that a step has turned inside out is pushed back. An answer of
``log`` that holds such an element means nothing, and the solvers refuse it. ``smith`` and ``warp_compat`` allow inverted elements
by design: in a strong squeeze single elements at the edge of a bonded face do invert.

Shapes: F (M, 3, 3) for M tetrahedra; first derivatives (M, 9) by the entries of F row by row; second ones (M, 9, 9).
"""

from __future__ import annotations

import numpy as np

from proprio_ros.errors import SimulationError

LAWS = ("log", "smith", "linear", "warp_compat")
LEAST_J = 0.05  # where log J is continued; smaller than in any squeeze that a block survives

_PERMUTATION = np.zeros((3, 3, 3))
_PERMUTATION[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_PERMUTATION[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1.0
# d^2 J / dF_ab dF_cd = e_ace e_bdf F_ef
_CURVATURE_OF_J = np.einsum("ace,bdf->abcdef", _PERMUTATION, _PERMUTATION).reshape(81, 9)
_ONE = np.eye(3).ravel()
_TRANSPOSE = np.eye(9).reshape(3, 3, 3, 3).swapaxes(0, 1).reshape(9, 9)


def check_law(law: str) -> str:
    """The law, if there is such a one. Raises `SimulationError`: There is none of that name."""
    if law not in LAWS:
        raise SimulationError(f"unknown law of elasticity {law!r}: choose one of {', '.join(LAWS)}")
    return law


def lame(youngs_modulus: float, poissons_ratio: float) -> tuple[float, float]:
    """mu, lambda [Pa] of Young's modulus [Pa] and Poisson's ratio."""
    mu = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
    return mu, 2.0 * mu * poissons_ratio / (1.0 - 2.0 * poissons_ratio)


def lame_by_poissons_ratio(poissons_ratio: float) -> tuple[float, float]:
    """d mu / d nu and d lambda / d nu at Young's modulus 1."""
    nu = poissons_ratio
    both = (1.0 + nu) * (1.0 - 2.0 * nu)
    return -0.5 / (1.0 + nu) ** 2, (1.0 + 2.0 * nu**2) / both**2


def young(mu: float, lam: float) -> tuple[float, float]:
    """Young's modulus [Pa] and Poisson's ratio of mu, lambda [Pa]."""
    return mu * (3.0 * lam + 2.0 * mu) / (lam + mu), lam / (2.0 * (lam + mu))


def small_strain_lame(
    law: str,
    mu: float,
    lam: float,
) -> tuple[float, float]:
    """The Lamé parameters of Hooke's law that a law with these parameters starts with [Pa].

    Args:
        law: Its name.
        mu: Its first parameter [Pa].
        lam: Its second [Pa].
    """
    return (0.75 * mu, lam - 0.625 * mu) if law == "warp_compat" else (mu, lam)


def lame_of_small_strain(
    law: str,
    mu: float,
    lam: float,
) -> tuple[float, float]:
    """The parameters with which a law starts as Hooke's law does: `small_strain_lame` the other way round [Pa].

    Args:
        law: Its name.
        mu: Shear modulus at small strain [Pa].
        lam: Lamé's first parameter at small strain [Pa].
    """
    return (mu / 0.75, lam + 0.625 / 0.75 * mu) if law == "warp_compat" else (mu, lam)


def check_material(law: str, mu: float, lam: float) -> None:
    """Refuse what no solid is made of.

    Args:
        law: Its name.
        mu: Its first parameter [Pa].
        lam: Its second [Pa].

    Raises:
        SimulationError: Shear or bulk modulus at small strain not above zero.
    """
    shear, lame_lambda = small_strain_lame(law, mu, lam)
    if not (np.isfinite([mu, lam]).all() and shear > 0.0 and 3.0 * lame_lambda + 2.0 * shear > 0.0):
        raise SimulationError(
            f"no solid has the Lamé parameters mu = {mu:g} Pa, lambda = {lam:g} Pa under the law {law!r}: mu must be above 0 "
            "and lambda above -2/3 of it (at small strain)"
        )


def log_j(j: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """log J, continued below ``LEAST_J``, with two derivatives."""
    safe = np.maximum(j, LEAST_J)
    below = np.minimum(j - LEAST_J, 0.0) / LEAST_J
    first = (1.0 - below) / safe
    return np.log(safe) + below - 0.5 * below**2, first, -1.0 / safe**2


def shear_energy(
    law: str,
    f: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """w of the law and its derivatives: (M,), (M, 9), (M, 9, 9)."""
    flat = f.reshape(-1, 9)
    if law == "linear":
        return _linear_shear_energy(flat)
    ic = (flat**2).sum(axis=1)
    j, by_f, curvature = _determinant(f)
    by_ic = np.full_like(ic, 0.5)
    w = 0.5 * (ic - 3.0)
    if law == "log":
        value, first, second = log_j(j)
        w = w - value
        by_j = -first
        by_jj = -second
    elif law == "smith":
        w = w - (j - 1.0) + 0.5 * (j - 1.0) ** 2
        by_j = j - 2.0
        by_jj = np.ones_like(j)
    else:
        w = w - 0.75 * (j - 1.0) - 0.5 * np.log(0.25 * (ic + 1.0))
        by_j = np.full_like(j, -0.75)
        by_ic = 0.5 - 0.5 / (ic + 1.0)
    hessian = 2.0 * by_ic[:, None, None] * np.eye(9) + by_j[:, None, None] * curvature
    if law == "warp_compat":
        by_ic_ic = 2.0 / (ic + 1.0) ** 2
        hessian += by_ic_ic[:, None, None] * _squares(flat)
    else:
        hessian += by_jj[:, None, None] * _squares(by_f)
    gradient = 2.0 * by_ic[:, None] * flat + by_j[:, None] * by_f
    return w, gradient, hessian


def _linear_shear_energy(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `shear_energy`, of the linear law and with deformations of shape (M, 9)."""
    strain = 0.5 * (flat + flat @ _TRANSPOSE) - _ONE
    hessian = np.broadcast_to(np.eye(9) + _TRANSPOSE, (len(flat), 9, 9))
    return (strain**2).sum(axis=1), 2.0 * strain, hessian


def _squares(rows: np.ndarray) -> np.ndarray:
    """Outer product of each row with itself, shape (M, 9, 9)."""
    return rows[:, :, None] * rows[:, None, :]


def volume(
    law: str,
    f: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """j of the law, its change of volume, and derivatives: (M,), (M, 9), (M, 9, 9)."""
    if law != "linear":
        return _determinant(f)
    by_f = np.broadcast_to(_ONE, (len(f), 9))
    by_ff = np.broadcast_to(
        np.zeros((9, 9)),
        (len(f), 9, 9),
    )
    return np.trace(f, axis1=1, axis2=2) - 2.0, by_f, by_ff


def bulk_energy(
    law: str,
    j: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u of the law and two derivatives, each (C,)."""
    if law == "log":
        value, first, second = log_j(j)
        return 0.5 * value**2, value * first, first**2 + value * second
    return 0.5 * (j - 1.0) ** 2, j - 1.0, np.ones_like(j)


def _determinant(f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """J and its derivatives; exact also where F is singular."""
    curvature = (f.reshape(-1, 9) @ _CURVATURE_OF_J.T).reshape(-1, 9, 9)
    cofactor = 0.5 * np.einsum("mij,mj->mi", curvature, f.reshape(-1, 9))
    return np.einsum("mi,mi->m", cofactor, f.reshape(-1, 9)) / 3.0, cofactor, curvature
