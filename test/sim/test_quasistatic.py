"""The squeezed block in equilibrium: closed form, an independent second-order solver, energy, and every derivative."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from support.second_order import bonded_force

from proprio_ros.errors import SimulationError
from proprio_ros.sim.energies import LAWS, lame, small_strain_lame, young
from proprio_ros.sim.mesh import TetMesh, box
from proprio_ros.sim.quasistatic import QuasiStatic

EDGE = 0.03
HEAVY = (5097.6, 5430.4)
MATERIALS = [(749.6, 264.3), HEAVY, lame(1e4, 0.45)]


def cube(n: int) -> TetMesh:
    return box(
        np.full(3, EDGE),
        (n, n, n),
    )


def octant(n: int) -> TetMesh:
    """An eighth of ``cube(2 n)``."""
    return box(
        np.full(3, EDGE / 2),
        (n, n, n),
        corner=np.zeros(3),
    )


def uniaxial(
    law: str,
    stretch: float,
    mu: float,
    lam: float,
) -> float:
    """Nominal pressure on free sides [Pa]: the side stress, written out by hand, is zero at the side's stretch s."""

    def nominal(one: float, other: float) -> float:
        """P along ``one`` where the three stretches are ``stretch``, s, s: dPsi/d one at fixed volume of the others."""
        j = stretch * side**2
        ic = stretch**2 + 2 * side**2
        if law == "log":
            return mu * (one - 1 / one) + lam * np.log(j) / one
        if law == "smith":
            return mu * one + (-mu + (lam + mu) * (j - 1)) * other
        if law == "warp_compat":
            shear = mu * (1 - 1 / (ic + 1))
            bulk = lam * (j - 1) - 0.75 * mu
            return shear * one + bulk * other
        return 2 * mu * (one - 1) + lam * (stretch + 2 * side - 3)

    def sideways(guess: float) -> float:
        nonlocal side
        side = guess
        return nominal(side, stretch * side)

    side = 1.0
    brentq(sideways, 0.7, 1.6, xtol=1e-15, rtol=1e-15)
    return -nominal(stretch, side**2)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "cells",
    [
        (1, 1, 1),
        (2, 2, 2),
        (3, 2, 4),
        (5, 1, 2),
    ],
)
@pytest.mark.parametrize(("mu", "lam"), MATERIALS)
def test_frictionless_faces_have_a_closed_form(
    law: str,
    cells: tuple[int, int, int],
    mu: float,
    lam: float,
) -> None:
    size = np.array([0.03, 0.02, 0.025])
    squeezes = np.array([0.02, 0.1, 0.3])
    solver = QuasiStatic(box(size, cells), law, "frictionless")
    curve = solver.curve(squeezes * size[0], mu, lam)
    pressures = [uniaxial(law, stretch, mu, lam) for stretch in (0.98, 0.9, 0.7)]
    area = size[1] * size[2]
    np.testing.assert_allclose(
        curve.force,
        area * np.array(pressures),
        rtol=1e-8,
    )


def uncelled(mesh: TetMesh) -> TetMesh:
    """Every tetrahedron keeps its volume by itself."""
    return replace(
        mesh,
        cells=np.arange(len(mesh.tets)),
    )


def test_frictionless_faces_of_an_irregular_mesh() -> None:
    """Inner nodes out of place: the state is homogeneous all the same."""
    regular = cube(3)
    inside = np.abs(regular.points).max(axis=1) < 0.499 * EDGE
    rng = np.random.default_rng(0)
    shake = rng.normal(size=regular.points.shape) * 0.06 * EDGE / 3
    mesh = TetMesh(
        regular.points + inside[:, None] * shake,
        regular.tets,
        regular.cells,
    )
    for each in (mesh, uncelled(mesh)):
        curve = QuasiStatic(each, "log", "frictionless").curve(
            [0.3 * EDGE],
            *HEAVY,
        )
        exact = EDGE**2 * uniaxial("log", 0.7, *HEAVY)
        assert curve.force[0] == pytest.approx(exact, rel=1e-8)


@pytest.mark.parametrize("law", LAWS)
def test_first_slope_is_young_s_modulus(law: str) -> None:
    """Stiffness E A / L of a cube is E L."""
    modulus, _ = young(*small_strain_lame(law, *HEAVY))
    curve = QuasiStatic(cube(2), law, "frictionless").curve(
        [0.0, 1e-6 * EDGE],
        *HEAVY,
    )
    assert curve.force[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(curve.by_squeeze, modulus * EDGE, rtol=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("nu", [0.13, 0.258, 0.40])
def test_bonded_faces_converge_to_second_order_elements(nu: float) -> None:
    """Errors fall with the mesh, about as h^1.5 (the edges of a bonded face are singular); worst of three squeezes up to 30 %."""
    material = lame(1e4, nu)
    squeezes = np.array([0.05, 0.15, 0.3]) * EDGE
    exact = bonded_force(EDGE, 3, squeezes, *material)
    errors = []
    for half in (1, 2, 4, 6):
        curve = QuasiStatic(octant(half), octant=True).curve(
            squeezes,
            *material,
        )
        errors.append(np.abs(curve.force / exact - 1.0).max())
    assert np.all(np.diff(errors) < 0.0)
    assert errors[2] < {0.13: 0.005, 0.258: 0.017, 0.40: 0.038}[nu]
    assert errors[3] < 0.65 * errors[2]


def test_averaging_cures_the_locking() -> None:
    material = lame(1e4, 0.45)
    exact = bonded_force(EDGE, 3, np.array([0.15 * EDGE]), *material)[0]

    def too_stiff(mesh: TetMesh) -> float:
        curve = QuasiStatic(mesh, octant=True).curve([0.15 * EDGE], *material)
        return float(curve.force[0] / exact - 1.0)

    locked = too_stiff(uncelled(octant(2)))
    assert locked > 0.15
    assert too_stiff(octant(2)) < 0.5 * locked


def test_an_octant_is_the_block() -> None:
    squeezes = np.array([0.1, 0.35]) * EDGE
    for contact in ("bonded", "frictionless"):
        whole = QuasiStatic(cube(4), contact=contact).curve(
            squeezes,
            *HEAVY,
        )
        eighth = QuasiStatic(octant(2), contact=contact, octant=True).curve(
            squeezes,
            *HEAVY,
        )
        for name in ("force", "by_squeeze", "by_mu", "by_lambda", "least_j"):
            np.testing.assert_allclose(
                getattr(eighth, name), getattr(whole, name), rtol=1e-9, err_msg=name
            )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("contact", ["bonded", "frictionless"])
@pytest.mark.parametrize(("mu", "lam"), MATERIALS)
def test_sensitivities_against_central_differences(
    law: str, contact: str, mu: float, lam: float
) -> None:
    solver = QuasiStatic(
        box(
            np.array([0.03, 0.02, 0.025]),
            (3, 2, 2),
        ),
        law,
        contact,
    )
    squeeze = np.array([0.08, 0.25]) * 0.03
    curve = solver.curve(squeeze, mu, lam)
    step = 1e-5
    for name, difference in {
        "by_mu": (
            solver.curve(squeeze, mu * (1 + step), lam).force
            - solver.curve(squeeze, mu * (1 - step), lam).force
        )
        / (2 * step * mu),
        "by_lambda": (
            solver.curve(squeeze, mu, lam * (1 + step)).force
            - solver.curve(squeeze, mu, lam * (1 - step)).force
        )
        / (2 * step * lam),
        "by_squeeze": (
            solver.curve(squeeze + step * 0.03, mu, lam).force
            - solver.curve(squeeze - step * 0.03, mu, lam).force
        )
        / (2 * step * 0.03),
    }.items():
        exact = getattr(curve, name)
        np.testing.assert_allclose(
            exact,
            difference,
            rtol=1e-6,
            atol=1e-6 * np.abs(exact).max(),
            err_msg=name,
        )


@pytest.mark.parametrize("law", ["log", "smith"])
def test_the_work_of_the_fingers_is_the_energy(law: str) -> None:
    """Simpson's rule over the squeeze; and nothing pushes sideways or turns."""
    solver = QuasiStatic(cube(3), law)
    squeezes = np.linspace(0.0, 0.3, 21) * EDGE
    curve = solver.curve(squeezes, *HEAVY)
    weights = np.array([1.0, *([4.0, 2.0] * 9), 4.0, 1.0])
    work = weights @ curve.force * squeezes[1] / 3.0
    energy = solver.elastic.energies(curve.points[-1]) @ HEAVY
    assert work == pytest.approx(energy, rel=1e-6)
    force = np.tensordot(
        HEAVY,
        solver.elastic.forces(curve.points[-1]),
        axes=1,
    )
    pushes = force.sum(axis=0)
    turns = np.cross(curve.points[-1], force).sum(axis=0)
    small = 1e-9 * curve.force[-1]
    assert np.abs(pushes).max() < small
    assert np.abs(turns).max() < small * EDGE


def test_force_is_linear_in_young_s_modulus() -> None:
    squeeze = [0.2 * EDGE]
    soft = QuasiStatic(cube(2)).curve(squeeze, *lame(1.0, 0.3))
    stiff = QuasiStatic(cube(2)).curve(squeeze, *lame(1e6, 0.3))
    np.testing.assert_allclose(
        stiff.force,
        1e6 * soft.force,
        rtol=1e-9,
    )


def test_one_big_step_ends_where_small_ones_do() -> None:
    """The first guess holds elements that are inside out."""
    solver = QuasiStatic(cube(3))
    at_once = solver.curve([0.5 * EDGE], *HEAVY)
    slowly = solver.curve(
        np.linspace(0.05, 0.5, 10) * EDGE,
        *HEAVY,
    )
    assert at_once.force[0] == pytest.approx(slowly.force[-1], rel=1e-8)


def test_what_cannot_be_simulated() -> None:
    solver = QuasiStatic(cube(2))
    with pytest.raises(SimulationError, match="squeezed by that much"):
        solver.curve([EDGE], *HEAVY)
    with pytest.raises(SimulationError, match="no solid"):
        solver.curve([0.001], -1.0, 1.0)
    with pytest.raises(SimulationError, match="squeeze less"):
        solver.curve([0.97 * EDGE], *HEAVY)
    with pytest.raises(SimulationError, match="choose one of bonded"):
        QuasiStatic(cube(1), contact="sticky")
