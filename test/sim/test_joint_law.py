"""The one-joint law against closed forms and an independent ODE solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk
from support.taped import tape

from proprio_ros.errors import SimulationError
from proprio_ros.sim.joint import INDEX, PARAMETERS, JointRun, JointSimulator

ONE = np.zeros(1, dtype=np.int32)


def parameters(**values: float) -> np.ndarray:
    p = np.zeros((1, len(PARAMETERS)))
    p[0, INDEX["inertia"]] = 1.0
    for name, value in values.items():
        p[0, INDEX[name]] = value
    return p


def constant_run(times: np.ndarray, current: float = 0.0, **options: float) -> JointRun:
    return JointRun(
        times,
        np.zeros(1),
        np.array([current]),
        **options,
    )


@pytest.mark.parametrize("amplitude", [0.3, 1.5, 2.8])
def test_pendulum_with_large_swing(amplitude: float) -> None:
    """q'' = -w^2 sin q from rest at the amplitude: q = 2 asin(k sn(K - w t | k^2)), k = sin(amplitude / 2)."""
    omega = 4.0
    times = np.linspace(0.05, 2.0, 40)
    k = np.sin(amplitude / 2.0)
    sn = ellipj(ellipk(k**2) - omega * times, k**2)[0]
    exact = 2.0 * np.arcsin(k * sn)
    run = constant_run(times, step_s=1e-3, fine_step_s=1e-3)
    q, _ = JointSimulator([run]).rollout(
        ONE,
        parameters(gravity_sin=omega**2, q0=amplitude),
    )
    # RK4: global error of order (w h)^4 w t, here 4e-10
    np.testing.assert_allclose(q[0], exact, atol=3e-9)


def test_slide_under_constant_force_is_a_parabola() -> None:
    times = np.linspace(0.01, 1.0, 17)
    mass = 0.7
    force = 2.0
    gravity = 0.9
    v0 = -0.4
    run = constant_run(times, current=force)
    q, v = JointSimulator([run]).rollout(
        ONE,
        parameters(
            inertia=mass,
            torque_constant=1.0,
            gravity_constant=gravity,
            v0=v0,
            q0=0.1,
        ),
    )
    acceleration = (force - gravity) / mass
    np.testing.assert_allclose(
        q[0],
        0.1 + v0 * times + 0.5 * acceleration * times**2,
        atol=1e-13,
    )
    np.testing.assert_allclose(
        v[0],
        v0 + acceleration * times,
        atol=1e-13,
    )


def test_viscous_decay() -> None:
    times = np.linspace(0.01, 1.0, 9)
    q, v = JointSimulator([constant_run(times)]).rollout(
        ONE, parameters(inertia=0.02, viscous=0.05, v0=1.0)
    )
    np.testing.assert_allclose(
        v[0],
        np.exp(-2.5 * times),
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        q[0],
        (1.0 - np.exp(-2.5 * times)) / 2.5,
        rtol=1e-9,
    )


def test_dry_friction_stops_a_sliding_joint_where_energy_says() -> None:
    """J v0^2 / 2 = f_c travel; the smoothing adds at most a creep of the order of the smoothing velocity x time."""
    inertia = 0.02
    friction = 0.05
    v0 = 1.0
    stop = inertia * v0 / friction
    run = constant_run(
        np.array([0.5 * stop, stop + 0.2]),
        step_s=1 / 240,
        fine_step_s=1e-4,
    )
    q, v = JointSimulator([run]).rollout(
        ONE,
        parameters(inertia=inertia, coulomb=friction, v0=v0),
    )
    np.testing.assert_allclose(
        q[0, 1],
        0.5 * inertia * v0**2 / friction,
        rtol=1e-4,
    )
    assert abs(v[0, 1]) < 1e-3


def test_dry_friction_holds_what_it_can_hold() -> None:
    run = constant_run(
        np.array([0.6]),
        current=0.02,
        step_s=1 / 240,
        fine_step_s=1e-4,
    )
    q, _ = JointSimulator([run]).rollout(
        ONE, parameters(inertia=0.02, torque_constant=2.0, coulomb=0.05)
    )
    assert abs(q[0, 0]) < 1.2e-3  # creep at v_s atanh(0.8)


def test_back_emf_limits_the_speed() -> None:
    """With the current limited by (V - k_e v) / R the joint tends to V / k_e, and a braking current is not limited."""
    run = JointRun(
        np.array([0.02, 20.0]),
        np.zeros(1),
        np.array([0.5]),
        supply=(12.0, 2.49, 5.22),
    )
    _, v = JointSimulator([run]).rollout(
        ONE,
        parameters(inertia=0.02, torque_constant=1.78),
    )
    np.testing.assert_allclose(
        v[0, 0],
        0.5 * 1.78 / 0.02 * 0.02,
        rtol=1e-9,
    )  # not limited yet
    np.testing.assert_allclose(
        v[0, 1],
        12.0 / 2.49,
        rtol=1e-6,
    )
    braking = JointRun(
        np.array([0.01]),
        np.zeros(1),
        np.array([-0.5]),
        supply=(12.0, 2.49, 5.22),
    )
    _, v = JointSimulator([braking]).rollout(
        ONE, parameters(inertia=0.02, torque_constant=1.78, v0=10.0)
    )
    np.testing.assert_allclose(
        v[0, 0],
        10.0 - 0.5 * 1.78 / 0.02 * 0.01,
        rtol=1e-9,
    )


def test_energy_drift_over_ten_seconds() -> None:
    times = np.linspace(0.1, 10.0, 100)
    run = constant_run(times, step_s=1e-3)
    q, v = JointSimulator([run]).rollout(
        ONE,
        parameters(inertia=0.03, gravity_sin=0.5, q0=2.0),
    )
    energy = 0.5 * 0.03 * v[0] ** 2 - 0.5 * np.cos(q[0])
    assert np.ptp(energy) < 1e-9


@pytest.mark.parametrize("delay", [0.0, 0.004, -0.002])
def test_against_an_independent_solver(delay: float) -> None:
    """All terms at once, irregular stamps, a current that changes three times."""
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0.0, 0.6, 24))
    switches = np.array([0.0, 0.13, 0.31, 0.5])
    currents = np.array([-0.3, -0.22, 0.05, -0.36])
    law = {
        "inertia": 0.027, "gravity_cos": 0.31, "gravity_sin": -0.11, "torque_constant": 1.71,
        "coulomb": 0.04, "viscous": 0.013, "load_friction": 0.02, "q0": 0.4, "v0": 0.05,
    }  # fmt: skip
    run = JointRun(
        times,
        switches,
        currents,
        friction_velocity=SETTLES_RAD_S,
        step_s=1 / 240,
        fine_step_s=1 / 20000,
    )
    q, _ = JointSimulator([run]).rollout(
        ONE,
        parameters(**law, delay=delay),
    )
    exact = by_lsoda(law, switches, currents, times - delay)
    np.testing.assert_allclose(q[0], exact, atol=2e-8)


SETTLES_RAD_S = 0.01
"""Speed at which friction has most of its size."""


def by_lsoda(
    law: dict[str, float],
    switches: np.ndarray,
    currents: np.ndarray,
    wanted: np.ndarray,
) -> np.ndarray:
    """Angles at rtol 1e-11, piece by piece.

    Args:
        law: values of the joint's parameters.
        switches: when each current begins [s].
        currents: of each piece [A].
        wanted: when the angles are wanted [s]; before 0 the joint has its first speed.
    """

    def motion(
        _: float,
        state: np.ndarray,
        current: float,
    ) -> list[float]:
        q, v = state
        motor = law["torque_constant"] * current
        size = law["coulomb"] + law["load_friction"] * abs(motor)
        friction = size * np.tanh(v / SETTLES_RAD_S) + law["viscous"] * v
        load = law["gravity_cos"] * np.cos(q) + law["gravity_sin"] * np.sin(q)
        return [v, (motor - friction - load) / law["inertia"]]

    exact = np.where(
        wanted <= 0.0,
        law["q0"] + law["v0"] * wanted,
        np.nan,
    )
    state = np.array([law["q0"], law["v0"]])
    for begin, end, current in zip(
        switches,
        [*switches[1:], 0.7],
        currents,
        strict=True,
    ):
        inside = (wanted > begin) & (wanted <= end)
        solution = solve_ivp(
            motion,
            (begin, end),
            state,
            method="LSODA",
            rtol=1e-11,
            atol=1e-13,
            t_eval=[*wanted[inside], end],
            args=(current,),
        )
        exact[inside] = solution.y[0, : inside.sum()]
        state = solution.y[:, -1]
    return exact


def test_integrator_orders() -> None:
    """Halving the step divides the error by 16 (RK4) and by 2 (semi-implicit Euler)."""
    times = np.array([1.0])
    law = parameters(gravity_sin=16.0, q0=2.0)
    exact = JointSimulator([constant_run(times, step_s=1e-4)]).rollout(ONE, law)[0][0, 0]
    for integrator, ratio in (("rk4", 16.0), ("semi_implicit", 2.0)):
        errors = [
            JointSimulator(
                [constant_run(times, step_s=step, fine_step_s=step)], integrator
            ).rollout(ONE, law)[0][0, 0]
            - exact
            for step in (1 / 400, 1 / 800)
        ]
        assert errors[0] / errors[1] == pytest.approx(ratio, rel=0.2)


def test_semi_implicit_is_equation_two_to_the_letter() -> None:
    """v' = v + h a(q, v), q' = q + h v', 60 frames per second, 16 substeps."""
    h = 1.0 / 60.0 / 16.0
    q = 0.3
    v = 0.0
    expected = []
    for step in range(36 * 16):
        a = (-0.3 * 1.78 - 0.01 * v - 0.2 * np.cos(q)) / 0.03
        v = v + h * a
        q = q + h * v
        if (step + 1) % 16 == 0:
            expected.append(q)
    run = constant_run(
        np.arange(1, 37) / 60.0,
        current=-0.3,
        step_s=h,
        fine_step_s=h,
    )
    got, _ = JointSimulator([run], "semi_implicit").rollout(
        ONE, parameters(inertia=0.03, torque_constant=1.78, viscous=0.01, gravity_cos=0.2, q0=0.3)
    )
    np.testing.assert_allclose(got[0], expected, atol=1e-13)


def test_runs_of_different_length_share_a_launch() -> None:
    short = constant_run(
        np.array([0.1, 0.2]),
        current=0.1,
    )
    long = constant_run(
        np.linspace(0.01, 0.6, 30),
        current=-0.2,
    )
    both = JointSimulator([short, long])
    law = parameters(torque_constant=1.5, gravity_cos=0.1)
    q, _ = both.rollout(
        np.array([1, 0, 1]),
        np.repeat(law, 3, axis=0),
    )
    alone = JointSimulator([long]).rollout(ONE, law)[0]
    np.testing.assert_array_equal(q[0], alone[0])
    np.testing.assert_array_equal(q[2], alone[0])
    np.testing.assert_array_equal(
        q[1, :2],
        JointSimulator([short]).rollout(ONE, law)[0][0],
    )


def test_windows_count_samples_by_time() -> None:
    simulator = JointSimulator([constant_run(np.arange(1, 25) * 0.025)])
    for fraction, samples in ((0.01, 3), (0.25, 6), (0.5, 12), (1.0, 24)):
        assert simulator.windows(fraction)[0] == samples


def test_what_cannot_be_simulated_is_said() -> None:
    with pytest.raises(SimulationError, match="unknown integrator 'euler'"):
        JointSimulator([constant_run(np.array([0.1]))], "euler")
    with pytest.raises(SimulationError, match="at least one sample"):
        JointSimulator([constant_run(np.zeros(0))])
    tiny = JointSimulator(
        [
            constant_run(
                np.array([1.0]),
                step_s=1e-6,
                fine_step_s=1e-6,
            )
        ]
    )
    with pytest.raises(SimulationError, match="too many for a tape"):
        tape(tiny, ONE, parameters())


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_guess_that_is_no_number_ends(name: str) -> None:
    """A solver that went astray gets a number that it can reject, not a rollout without end."""
    p = np.zeros((1, len(PARAMETERS)))
    p[0, INDEX["inertia"]] = p[0, INDEX["stribeck_velocity"]] = 1.0
    for value in (np.nan, np.inf, -np.inf):
        p[0, INDEX[name]] = value
        run = JointRun(
            np.array([0.1, 0.2]),
            np.array([0.0, 0.05]),
            np.array([1.0, 2.0]),
            fine_step_s=1e-3,
        )
        with np.errstate(invalid="ignore"):
            q, _ = JointSimulator([run]).rollout(
                np.zeros(1, dtype=np.int32),
                p,
            )
        assert np.isnan(q).all()
