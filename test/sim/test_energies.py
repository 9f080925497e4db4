"""The laws of elasticity against finite differences, Hooke's law, their published formulae, and Cauchy's symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from proprio_ros.errors import SimulationError
from proprio_ros.sim.energies import (
    LAWS,
    LEAST_J,
    bulk_energy,
    check_law,
    check_material,
    lame,
    lame_by_poissons_ratio,
    lame_of_small_strain,
    shear_energy,
    small_strain_lame,
    volume,
    young,
)

MATERIALS = [
    (749.6, 264.3),
    (5097.6, 5430.4),
    (1.0, -0.3),
    (300.0, 9000.0),
]


def stress(
    law: str, f: np.ndarray, mu: float, lam: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy density, first Piola-Kirchhoff stress and its tangent where j is each tetrahedron's own."""
    w, by_f, curvature = shear_energy(law, f)
    j, j_by_f, j_curvature = volume(law, f)
    u, first, second = bulk_energy(law, j)
    energy = mu * w + lam * u
    force = mu * by_f + lam * first[:, None] * j_by_f
    squared = j_by_f[:, :, None] * j_by_f[:, None, :]
    tangent = mu * curvature + lam * first[:, None, None] * j_curvature
    tangent = tangent + (lam * second)[:, None, None] * squared
    return energy, force.reshape(-1, 3, 3), tangent


def deformations(
    count: int,
    spread: float,
    seed: int = 3,
) -> np.ndarray:
    shake = np.random.default_rng(seed).normal(size=(count, 3, 3))
    return np.eye(3) + spread * shake


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("mu", "lam"), MATERIALS)
def test_stress_and_tangent_against_central_differences(law: str, mu: float, lam: float) -> None:
    """Also where a tetrahedron is inside out, and where it is nearly flat."""
    inverted = deformations(4, 0.2) * np.array([-0.6, 1.0, 1.0])
    crushed = deformations(4, 0.05) * np.array([0.03, 1.0, 1.0])
    f = np.concatenate([deformations(8, 0.2), inverted, crushed])
    _, exact, tangent = stress(law, f, mu, lam)
    step = 1e-6
    scale = np.abs(exact).max(axis=(1, 2)) + mu
    size = np.abs(tangent).max(axis=(1, 2))[:, None]
    for entry in range(9):
        moved = np.zeros((3, 3))
        moved.flat[entry] = step
        up = stress(law, f + moved, mu, lam)
        down = stress(law, f - moved, mu, lam)
        difference = (up[0] - down[0]) / (2 * step)
        off = difference - exact.reshape(-1, 9)[:, entry]
        assert np.abs(off / scale).max() < 1e-6
        slope = (up[1] - down[1]) / (2 * step)
        off = slope.reshape(-1, 9) - tangent[:, :, entry]
        assert np.abs(off / size).max() < 1e-6
    np.testing.assert_allclose(
        tangent,
        tangent.swapaxes(1, 2),
        rtol=1e-12,
        atol=1e-12 * np.abs(tangent).max(),
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("mu", "lam"), MATERIALS)
def test_the_slope_at_rest_is_hooke_s_law(law: str, mu: float, lam: float) -> None:
    rest = np.eye(3)[None]
    energy, force, tangent = stress(law, rest, mu, lam)
    assert abs(energy[0]) < 1e-12 * mu
    assert np.abs(force).max() < 1e-12 * mu
    shear, bulk = small_strain_lame(law, mu, lam)
    one = np.eye(3)
    hooke = bulk * np.einsum("ab,cd->abcd", one, one)
    hooke += shear * np.einsum("ac,bd->abcd", one, one)
    hooke += shear * np.einsum("ad,bc->abcd", one, one)
    np.testing.assert_allclose(
        tangent[0],
        hooke.reshape(9, 9),
        atol=1e-10 * (mu + abs(lam)),
    )


def test_formulae_as_published() -> None:
    f = deformations(6, 0.15)
    mu = 700.0
    lam = 900.0
    j = np.linalg.det(f)
    ic = np.einsum("mab,mab->m", f, f)
    sheared = mu / 2 * (ic - 3)
    eq4 = sheared - mu * np.log(j) + lam / 2 * np.log(j) ** 2
    np.testing.assert_allclose(
        stress("log", f, mu, lam)[0],
        eq4,
    )
    # Smith 2018 with its rest constant a = 1 + mu' / lambda' and without its logarithm, lambda' = lambda + mu
    shift = 1 + mu / (lam + mu)
    squeezed = (j - shift) ** 2 - (1 - shift) ** 2
    smith = sheared + (lam + mu) / 2 * squeezed
    np.testing.assert_allclose(
        stress("smith", f, mu, lam)[0],
        smith,
    )
    # what warp.sim computed: P = mu F (1 - 1 / (Ic + 1)) + lambda (J - alpha) dJ/dF
    alpha = 1 + mu / lam - mu / (4 * lam)
    by_f = np.linalg.inv(f).swapaxes(1, 2)
    shear = mu * (1 - 1 / (ic + 1))
    bulk = lam * (j - alpha) * j
    np.testing.assert_allclose(
        stress("warp_compat", f, mu, lam)[1],
        shear[:, None, None] * f + bulk[:, None, None] * by_f,
        atol=1e-9,
    )


@pytest.mark.parametrize("law", [law for law in LAWS if law != "linear"])
def test_turning_the_block_costs_nothing(law: str) -> None:
    f = deformations(5, 0.2)
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    energy, force, _ = stress(law, f, 700.0, 900.0)
    turned, force_turned, _ = stress(law, turn @ f, 700.0, 900.0)
    np.testing.assert_allclose(turned, energy, rtol=1e-12)
    np.testing.assert_allclose(force_turned, turn @ force, atol=1e-9)
    cauchy = force @ f.swapaxes(1, 2)
    np.testing.assert_allclose(
        cauchy,
        cauchy.swapaxes(1, 2),
        atol=1e-9,
    )


def test_the_papers_pair_under_warp_is_auxetic() -> None:
    modulus, ratio = young(*small_strain_lame("warp_compat", 749.6, 264.3))
    assert modulus == pytest.approx(804.0, abs=1.0)
    assert ratio == pytest.approx(-0.285, abs=1e-3)


def test_logarithm_is_continued_smoothly_and_pushes_back() -> None:
    near = LEAST_J + np.array([-1e-7, 1e-7])
    for values in bulk_energy("log", near):
        assert values[0] == pytest.approx(values[1], rel=1e-4)
    j = np.linspace(-1.0, 0.9, 200)
    energy, slope, curvature = bulk_energy("log", j)
    assert np.isfinite(energy).all()
    assert (slope < 0.0).all()
    assert (curvature > 0.0).all()


@pytest.mark.parametrize("ratio", [-0.3, 0.0, 0.13, 0.45])
def test_moduli_there_and_back(ratio: float) -> None:
    assert young(*lame(1234.0, ratio)) == pytest.approx((1234.0, ratio))
    for law in LAWS:
        assert small_strain_lame(law, *lame_of_small_strain(law, 3.0, 1.5)) == pytest.approx(
            (3.0, 1.5)
        )
    step = 1e-6
    above = np.array(lame(1.0, ratio + step))
    below = np.array(lame(1.0, ratio - step))
    difference = (above - below) / (2 * step)
    assert lame_by_poissons_ratio(ratio) == pytest.approx(difference, rel=1e-6)


def test_bad_materials() -> None:
    with pytest.raises(SimulationError, match="choose one of log, smith"):
        check_law("rubber")
    no_solids = ((0.0, 1.0), (1.0, -0.7), (np.nan, 1.0))
    for mu, lam in no_solids:
        with pytest.raises(SimulationError, match="no solid"):
            check_material("log", mu, lam)
    check_material("warp_compat", 749.6, 264.3)
