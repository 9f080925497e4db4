"""The solvers on problems whose answer is known without them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification import solvers
from proprio_ros.identification.unknowns import Coordinates, Role, Unknown


class Valley:
    """Rosenbrock's valley as least squares, r = (10 (y - x^2), 1 - x): minimum 0 at (1, 1)."""

    def __init__(self, upper_x: float = np.inf) -> None:
        self.coordinates = Coordinates(
            [
                Unknown("payload_com_x", 0.0, np.inf, -5.0, upper_x),
                Unknown("payload_com_y", 0.0, np.inf, -50.0, 50.0),
            ]
        )

    def linearise(
        self, internal: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, y = internal.T
        residual = np.stack(
            [10.0 * (y - x**2), 1.0 - x],
            axis=1,
        )
        jacobian = np.zeros((len(x), 2, 2))
        jacobian[:, 0, 0], jacobian[:, 0, 1], jacobian[:, 1, 0] = -20.0 * x, 10.0, -1.0
        transposed = jacobian.transpose(0, 2, 1)
        return (
            0.5 * (residual**2).sum(1),
            (transposed @ residual[..., None])[..., 0],
            transposed @ jacobian,
        )


STARTS = np.array([[-1.2, 1.0], [2.0, -3.0], [0.0, 0.0]])


def whole(_: float) -> np.ndarray:
    return np.array([1])


def test_levenberg_marquardt_reaches_the_minimum_from_every_start() -> None:
    found = solvers.levenberg_marquardt(Valley(), STARTS, whole, iterations=100)
    np.testing.assert_allclose(found.internal, 1.0, atol=1e-6)
    assert found.cost.max() < 1e-12
    assert found.path.shape == (found.iterations + 1, 3, 2) and found.path_cost.shape == (
        found.iterations + 1,
        3,
    )


class RunsAway(Valley):
    """One start's curvature is near the largest number that there is, as of a simulation that grows without bound."""

    def linearise(
        self, internal: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cost, gradient, matrix = super().linearise(internal)
        steep = np.where(internal[:, 0] < -1.0, 3.115e305, 1.0)
        return cost, gradient * steep[:, None], matrix * steep[:, None, None]


def test_a_start_that_runs_away_overflows_nothing_and_changes_no_other() -> None:
    found = solvers.levenberg_marquardt(RunsAway(), STARTS, whole, iterations=100)
    np.testing.assert_allclose(found.internal, 1.0, atol=1e-6)


def test_levenberg_marquardt_slides_along_a_bound() -> None:
    """With x <= 0.5 the minimum is at x = 0.5, y = 0.25."""
    found = solvers.levenberg_marquardt(
        Valley(upper_x=0.5),
        STARTS,
        whole,
        iterations=100,
    )
    np.testing.assert_allclose(
        found.internal,
        np.tile([0.5, 0.25], (3, 1)),
        atol=1e-6,
    )


class Saturated:
    """r = arctan x: from x = 20 every step of Gauss and Newton lands farther away, until it is 15 times shorter."""

    coordinates = Coordinates([Unknown("payload_com_x", 0.0, np.inf, -1e4, 1e4)])

    def linearise(
        self, internal: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        residual = np.arctan(internal)
        slope = 1.0 / (1.0 + internal**2)
        return 0.5 * (residual**2).sum(1), residual * slope, (slope**2)[..., None]


def test_levenberg_marquardt_that_overshoots_goes_on_unless_rough_is_enough() -> None:
    given_up = solvers.levenberg_marquardt(
        Saturated(),
        np.array([[20.0]]),
        None,
        persistent=False,
    )
    assert given_up.internal == 20.0
    found = solvers.levenberg_marquardt(
        Saturated(),
        np.array([[20.0]]),
        None,
    )
    np.testing.assert_allclose(found.internal, 0.0, atol=1e-6)


def test_adam_follows_its_published_first_steps() -> None:
    """Kingma & Ba: the first step is the learning rate times the sign of the gradient, whatever its size."""

    def gradient_of(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.5 * (u**2).sum(1) * 1e4, 1e4 * u

    found = solvers.adam_descent(
        gradient_of,
        np.array([[3.0], [-7.0]]),
        rate=0.1,
        iterations=1,
    )
    np.testing.assert_allclose(
        found.internal,
        [[2.9], [-6.9]],
        atol=1e-6,
    )


def test_cosine_annealing() -> None:
    rates = [solvers.cosine_annealed(0.01, n, 15) for n in range(15)]
    assert rates[0] == 0.01 and all(a > b for a, b in pairwise(rates))
    # so no start moves further than 80 g in the paper's 15 iterations
    assert sum(rates) == pytest.approx(0.08)


def test_adam_and_cma_agree_with_the_known_minimum() -> None:
    adam = solvers.adam(
        Valley(),
        STARTS[:1],
        iterations=3000,
        rate=0.05,
    )
    np.testing.assert_allclose(adam.internal, 1.0, atol=2e-2)
    pytest.importorskip("cma")
    cma = solvers.cma(Valley(), STARTS)
    np.testing.assert_allclose(cma.internal, 1.0, atol=1e-4)


def test_mass_coordinate_is_a_logarithm_that_passes_through_zero() -> None:
    coordinates = Coordinates(
        [Unknown("payload_mass", 0.05, np.inf, -0.5, 20.0, asinh_scale=0.005)]
    )
    masses = np.array([[-0.01], [0.0], [1e-4], [0.5]])
    u = coordinates.internal(masses)
    np.testing.assert_allclose(
        coordinates.physical(u),
        masses,
        atol=1e-15,
    )
    np.testing.assert_allclose(
        u[3] - coordinates.internal(np.array([0.05])), np.log(10.0), rtol=3e-3
    )
    step = 1e-6
    slope = (coordinates.physical(u + step) - coordinates.physical(u - step)) / (2.0 * step)
    np.testing.assert_allclose(
        coordinates.slope(u),
        slope,
        rtol=1e-8,
    )


def test_an_unknown_that_is_known_exactly_stays_frozen() -> None:
    known = Unknown("torque_constant", 1.78, 0.0)
    assert known.at_role(Role.ESTIMATED).role is Role.FIXED
    assert Unknown("torque_constant", 1.78, 0.1).at_role(Role.ESTIMATED).role is Role.ESTIMATED
    with pytest.raises(ConfigurationError, match="outside"):
        Unknown("coulomb", -0.1, 0.01, lower=0.0)
    with pytest.raises(ConfigurationError, match="std"):
        Unknown("coulomb", 0.1, -1.0)
