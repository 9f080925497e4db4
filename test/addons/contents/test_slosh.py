"""The law of moving contents: its tangents against finite differences, itself against SciPy and a closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from proprio_ros.addons.contents.slosh import SloshRun, SloshSimulator
from proprio_ros.addons.contents.slosh_kernels import (
    DAMPING,
    FRICTION,
    FRICTION_SPEED,
    HEIGHT,
    MASS,
    SLOSH_PARAMETERS,
    STIFFNESS,
)
from proprio_ros.sim.joint import JointRun

TIMES = np.linspace(0.02, 0.7, 18)
REACH = 0.25
BELOW = -0.05


def simulator(current_A: float = 0.25, shake: bool = False) -> SloshSimulator:
    switches = np.arange(0.0, 0.7, 0.15) if shake else np.zeros(1)
    signs = np.where(
        np.arange(len(switches)) % 2,
        -1.0,
        1.0,
    )
    joint = JointRun(
        TIMES,
        switches,
        current_A * signs,
        friction_velocity=1e-2,
        step_s=1 / 480,
    )
    # the joint's axis is level, the container upright at q = 0: gravity along s and z
    return SloshSimulator(
        [
            SloshRun(
                joint,
                REACH,
                BELOW,
                np.array([0.0, 0.0, 9.81]),
                np.array([0.0, -9.81, 0.0]),
            )
        ]
    )


def values(**others: float) -> np.ndarray:
    p = np.zeros((1, len(SLOSH_PARAMETERS)))
    chosen = {
        "inertia": 0.03, "torque_constant": 1.8, "viscous": 0.02, "coulomb": 0.03, "load_friction": 0.02, "stribeck": 0.2,
        "stribeck_velocity": 0.1, "gravity_cos": 0.1, "gravity_sin": 0.2, "delay": 0.004, "q0": 0.1, "v0": 0.0, "slosh_mass": 0.15,
        "slosh_height": 0.03, "slosh_stiffness": 400.0, "slosh_damping": 2.0, "slosh_friction": 0.0, "settled": 1.0, "tilt": 0.01,
    }  # fmt: skip
    for name, value in (chosen | others).items():
        p[0, SLOSH_PARAMETERS.index(name)] = value
    return p


@pytest.mark.parametrize(
    "others",
    [
        {},
        {"slosh_mass": 0.0, "settled": 0.5},
        {"slosh_friction": 3.0, "settled": 0.0},
        {"slosh_stiffness": 900.0, "v0": 0.4},
    ],
)
def test_tangents_are_the_slopes_of_the_rollout(others: dict[str, float]) -> None:
    rolled = simulator(shake=True)
    p = values(**others)
    world = np.zeros(1, dtype=np.int32)
    every = np.eye(len(SLOSH_PARAMETERS))[None]
    *_, dq = (array.copy() for array in rolled.jacobian(world, p, every))
    for row, name in enumerate(SLOSH_PARAMETERS):
        step = 1e-5 * max(abs(p[0, row]), 0.1)
        ends = [rolled.rollout(world, p + sign * step * every[:, row])[0] for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1])[0] / (2.0 * step)
        np.testing.assert_allclose(
            dq[0, :, row], slope, rtol=2e-4, atol=2e-5 * max(1.0, np.abs(slope).max()), err_msg=name
        )


@dataclass(frozen=True)
class Bowl:
    """A mass in a bowl in a turning frame, by energies that are differentiated numerically, without the law's equations.

    Attributes:
        mass, height: Of what moves [kg, m].
        radius: Of the bowl [m].
        loss, dry: Of its friction, viscous and dry, per unit of mass.
    """

    mass: float
    height: float
    radius: float
    loss: float
    dry: float

    def place(self, q: float, x: float) -> np.ndarray:
        """In the world: level, and up [m]; s points down where q grows, as gravity's sine says."""
        s = np.array([np.cos(q), -np.sin(q)])
        z = np.array([np.sin(q), np.cos(q)])
        up = BELOW + self.height + 0.5 * x**2 / self.radius
        return np.asarray((REACH + x) * s + up * z)

    def rates(self, _: float, y: np.ndarray) -> np.ndarray:
        """Of the joint's angle and speed, and of the mass's place and speed in the bowl."""
        q, v, x, u = y
        e = 1e-4
        place = self.place
        by_q = (place(q + e, x) - place(q - e, x)) / (2 * e)
        by_x = (place(q, x + e) - place(q, x - e)) / (2 * e)
        # acceleration of the place where q'' = x'' = 0: second difference along the motion
        bias = (place(q + e * v, x + e * u) - 2 * place(q, x) + place(q - e * v, x - e * u)) / e**2
        falling = np.array([0.0, -9.81]) - bias
        torque = 1.8 * 0.25 - 0.1 * np.cos(q) - 0.2 * np.sin(q)
        inner = -self.loss * u - self.dry * np.tanh(u / FRICTION_SPEED)
        mass = self.mass
        by_both = np.stack([by_q, by_x])  # of the place by q and x, (2, 2)
        matrix = np.diag([0.03, 0.0]) + mass * by_both @ by_both.T
        right = np.array([torque, mass * inner]) + mass * by_both @ falling
        a, k = np.linalg.solve(matrix, right)
        return np.array([v, a, u, k])


def test_the_rollout_is_lagranges_by_scipy() -> None:
    p = values(viscous=0.0, coulomb=0.0, load_friction=0.0, delay=0.0, tilt=0.0, slosh_friction=0.4)
    radius = 9.81 / p[0, STIFFNESS]
    bowl = Bowl(p[0, MASS], p[0, HEIGHT], radius, p[0, DAMPING], p[0, FRICTION])
    start = np.array([0.1, 0.0, radius * np.tan(0.1), 0.0])
    expected = solve_ivp(
        bowl.rates, (0.0, 0.7), start, t_eval=TIMES, rtol=1e-8, atol=1e-10, max_step=2e-3
    ).y
    world = np.zeros(1, dtype=np.int32)
    rolled = simulator()
    np.testing.assert_allclose(
        rolled.rollout(world, p)[0][0],
        expected[0],
        atol=2e-5,
    )
    np.testing.assert_allclose(
        rolled.path(world, p)[0],
        expected[2],
        atol=2e-5,
    )


def test_small_motions_are_two_coupled_oscillators() -> None:
    """Gravity that turns with the container: a constant torque turns all at once, the mass swings at the frequency of the pair."""
    still = JointRun(
        TIMES,
        np.zeros(1),
        np.array([1e-4]),
        friction_velocity=1e-2,
        step_s=1 / 480,
    )
    rolled = SloshSimulator(
        [
            SloshRun(
                still,
                0.0,
                0.2,
                np.zeros(3),
                np.array([-9.81, 0.0, 0.0]),
            )
        ]
    )
    for mass in (0.05, 0.15, 0.4):
        p = values(viscous=0.0, coulomb=0.0, load_friction=0.0, stribeck=0.0, gravity_cos=0.0, gravity_sin=0.0, delay=0.0, q0=0.0,
                   slosh_mass=mass, slosh_height=0.0, slosh_damping=0.0, tilt=0.0, settled=0.0)  # fmt: skip
        torque = 1.8e-4
        high = 0.2
        stiffness = 400.0
        inertia = 0.03
        turn = np.sqrt(stiffness * (1.0 + mass * high**2 / inertia) + 9.81 * mass * high / inertia)
        x = -high * torque / inertia / turn**2 * (1.0 - np.cos(turn * TIMES))
        np.testing.assert_allclose(
            rolled.path(np.zeros(1, dtype=np.int32), p)[0], x, rtol=1e-4, atol=1e-10
        )
