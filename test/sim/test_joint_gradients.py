"""Every derivative of the one-joint rollout three ways: forward sensitivities, tape, central differences."""

from __future__ import annotations

import numpy as np
import pytest
from support.plain_laws import difference
from support.taped import tape

from proprio_ros.sim.joint import INDEX, PARAMETERS, JointRun, JointSimulator

ONE = np.zeros(1, dtype=np.int32)
SCALES = {
    "inertia": 0.025,
    "gravity_cos": 0.5,
    "gravity_sin": 0.2,
    "gravity_constant": 0.05,
    "torque_constant": 1.78,
    "coulomb": 0.05,
    "viscous": 0.01,
    "load_friction": 0.03,
    "delay": 0.004,
    "q0": 0.6,
    "v0": 0.1,
    "carried": 0.05,
    "stribeck": 0.4,
    "stribeck_velocity": 0.3,
}
POINTS = 4


def simulator(integrator: str) -> JointSimulator:
    rng = np.random.default_rng(7)
    times = np.sort(rng.uniform(0.0, 0.6, 24))
    run = JointRun(
        times,
        np.array([0.0, 0.2, 0.33]),
        np.array([-0.3, -0.25, -0.31]),
        supply=(6.0, 2.49, 5.22),  # low enough for the back-EMF limit to act
        friction_velocity=1e-3,
        step_s=1 / 240,
        fine_step_s=1 / 240 if integrator == "semi_implicit" else 1 / 4000,
        input_load=np.array(
            [
                [0.01, 0.2],
                [-0.02, 0.3],
                [0.015, -0.1],
            ]
        ),
    )
    return JointSimulator([run], integrator)


def point(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    p = np.array([[SCALES[name] for name in PARAMETERS]]) * rng.uniform(
        0.7, 1.3, (1, len(PARAMETERS))
    )
    p[0, INDEX["delay"]] *= rng.choice([-1.0, 1.0])
    return p


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("seed", range(POINTS))
def test_sensitivities_against_central_differences(integrator: str, seed: int) -> None:
    sim = simulator(integrator)
    p = point(seed)
    exact = sim.jacobian(
        ONE,
        p,
        np.eye(len(PARAMETERS))[None],
    )[2].copy()
    for name, row in INDEX.items():
        # the rise of friction at rest moves little: its difference must rise above the rounding of a stiff rollout
        step = 1e-4 if name.startswith("stribeck") else 1e-6 * max(1e-1, abs(SCALES[name]))
        scale = np.abs(exact[..., row]).max()
        assert scale > 0.0, name
        np.testing.assert_allclose(
            difference(sim, p, row, step),
            exact[..., row],
            atol=1e-6 * scale,
            err_msg=name,
        )


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("seed", range(POINTS))
def test_tape_against_sensitivities(integrator: str, seed: int) -> None:
    sim = simulator(integrator)
    p = point(seed)
    q, _, exact = sim.jacobian(
        ONE,
        p,
        np.eye(len(PARAMETERS))[None],
    )
    weights = np.random.default_rng(seed).normal(size=q.shape)
    expected = np.einsum("wt,wtd->wd", weights, exact)
    taped = tape(sim, ONE, p)
    np.testing.assert_allclose(taped.q, q, atol=1e-13)
    gradient = taped.gradient(weights)
    np.testing.assert_allclose(
        gradient,
        expected,
        rtol=1e-10,
        atol=1e-10 * np.abs(expected).max(),
    )
    # a second backward pass of the same tape starts from zero
    np.testing.assert_array_equal(taped.gradient(weights), gradient)


def test_many_directions_equal_one_at_a_time() -> None:
    sim = simulator("rk4")
    p = point(0)
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(1, len(PARAMETERS), 20))
    together = sim.jacobian(ONE, p, directions)[2].copy()
    for column in range(20):
        alone = sim.jacobian(
            ONE,
            p,
            directions[:, :, column : column + 1],
        )[2]
        np.testing.assert_allclose(
            together[..., column],
            alone[..., 0],
            rtol=1e-12,
            atol=1e-12,
        )


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_delay_of_a_sample_on_a_change_of_the_current(integrator: str) -> None:
    """Without delay a sample may fall on a change of the current; a longer delay takes it under the former one.

    One-sided differences (-3, 4, -1) towards longer delays, and the tape, must see the same in all later samples.
    """
    run = JointRun(
        np.array([0.05, 0.1, 0.13, 0.2]),
        np.array([0.0, 0.1]),
        np.array([0.3, -0.6]),
    )
    sim = JointSimulator([run], integrator)
    p = point(1)
    p[0, INDEX["delay"]] = 0.0
    direction = np.zeros((1, len(PARAMETERS), 1))
    direction[0, INDEX["delay"]] = 1.0
    found = sim.jacobian(ONE, p, direction)
    q, _, exact = (array.copy() for array in found)
    step = 1e-6
    moved = np.repeat(p, 2, axis=0)
    moved[:, INDEX["delay"]] = [step, 2.0 * step]
    once, twice = sim.rollout(np.zeros(2, dtype=np.int32), moved)[0]
    one_sided = (-3.0 * q[0] + 4.0 * once - twice) / (2.0 * step)
    np.testing.assert_allclose(
        one_sided,
        exact[0, :, 0],
        atol=1e-6 * np.abs(exact).max(),
    )
    weights = np.random.default_rng(2).normal(size=q.shape)
    gradient = tape(sim, ONE, p).gradient(weights)[0, INDEX["delay"]]
    np.testing.assert_allclose(
        gradient,
        (weights * exact[..., 0]).sum(),
        rtol=1e-10,
    )
