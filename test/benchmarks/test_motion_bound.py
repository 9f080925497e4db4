"""The bound of `motion_bound` is one: its model is the simulator's, and the best estimate on that model errs by as much."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from motion_bound import Model


MASS_KG = 0.1
CENTRE_M = np.array([0.02, -0.01, 0.01])


@pytest.mark.long
@pytest.mark.parametrize("teeth", [False, True])
def test_the_best_estimate_on_the_simulator_s_own_laws_errs_as_much_as_the_bound_says(
    teeth: bool,
) -> None:
    pytest.importorskip("mujoco")
    from motion_bound import Model, bound, parameters
    from support.arm_in_motion import FOUR, Twin

    arm = Twin(21, FOUR, teeth=teeth)
    arm.record("empty", 5.0)
    arm.record("loaded", 4.0, (MASS_KG, CENTRE_M))
    empty = arm.truths["empty"]
    loaded = arm.truths["loaded"]
    held = parameters(MASS_KG, CENTRE_M, np.full(3, 0.4 * MASS_KG * 0.05**2))
    model = Model(arm, [(empty, False), (loaded, True)], held)
    for torque, truth in zip(model.read(model.truth), (empty, loaded), strict=True):
        np.testing.assert_allclose(torque * arm.torque, truth.torque, atol=1e-9)
    check_slopes(model)
    std = FOUR.current_noise_A * np.array(FOUR.constants)
    errors = errors_of_the_best(model, std, 400)
    least = bound(arm, empty, loaded, MASS_KG, CENTRE_M)
    assert least == pytest.approx(np.sqrt(model.covariance()[0][0, 0]))
    # 400 draws show a standard deviation to 3.5 %
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(least, rel=0.1)
    # noise of the positions makes no bound smaller, and hardly any larger
    assert 1.0 <= bound(arm, empty, loaded, MASS_KG, CENTRE_M, positions=True) / least < 1.05


def check_slopes(model: Model) -> None:
    """The slopes at the truth are differences."""
    slopes = model.slopes()
    for unknown in range(len(model.truth)):
        step = 1e-6 * np.eye(len(model.truth))[unknown]
        for rows, up, down in zip(
            slopes, model.read(model.truth + step), model.read(model.truth - step), strict=True
        ):
            np.testing.assert_allclose(
                rows[:, unknown], (up - down).ravel() / 2e-6, atol=1e-4 * np.abs(rows).max()
            )


def errors_of_the_best(model: Model, std: np.ndarray, draws: int) -> list[float]:
    """Errors of the mass [kg] that is fitted to readings with noise, with priors that are like measurements around the truth.

    Each fit takes four of Newton's steps from there, with the slopes of the truth.

    Args:
        model: The laws, and the truth.
        std: Of the noise of each joint [N m], (n,).
        draws: How many readings are made.
    """
    covariance, precision = model.covariance()
    slopes = model.slopes()
    clean = model.read(model.truth)
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(draws):
        stated = rng.multivariate_normal(
            model.truth,
            np.linalg.inv(precision),
            method="cholesky",
        )
        read = [torque + std * rng.standard_normal(torque.shape) for torque in clean]
        estimate = model.truth.copy()
        for _ in range(4):
            left = [
                ((y - f) / std**2).ravel()
                for y, f in zip(
                    read,
                    model.read(estimate),
                    strict=True,
                )
            ]
            score = sum(rows.T @ part for rows, part in zip(slopes, left, strict=True))
            step = covariance @ (score + precision @ (stated - estimate))
            estimate += step
        assert abs(step[0]) < 0.05 * np.sqrt(covariance[0, 0])
        errors.append(float(estimate[0] - MASS_KG))
    return errors
