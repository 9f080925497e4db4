"""The particles that judge `contents` obey the laws of others: waves, viscosity, weight, and the arm that carries them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

pytest.importorskip("mujoco")
if shutil.which("gcc") is None:
    pytest.skip("needs gcc", allow_module_level=True)

from filled_arm import CONTAINERS, EXCHANGE_S, PUSHES, Case, Filled, filled, probe_of
from random_arm import JOINTS, STEP_S, HiddenRobot, Probe, simulate
from support.contents import Cylinder, Grains, Liquid, library, sloshing, theory_hz

from proprio_ros.addons.contents.models import Slosh
from proprio_ros.addons.contents.slosh import SloshRun, SloshSimulator
from proprio_ros.addons.contents.slosh_kernels import SLOSH_PARAMETERS
from proprio_ros.sim.joint import JointRun

CYLINDER = Cylinder(0.035, 0.1)
FILL_M = 0.06
NONE, DOWN = np.zeros(3), np.array([0.0, 0.0, -9.81])


def test_whoever_loads_it_keeps_subnormal_numbers() -> None:
    library()
    assert np.float64(5e-324) * np.float64(1.0) > 0.0


@pytest.mark.long
def test_a_wave_is_as_fast_as_theory_says_and_a_finer_grid_agrees() -> None:
    coarse, fine = (
        sloshing(
            CYLINDER,
            FILL_M,
            0.1,
            layers,
            EXCHANGE_S,
        )
        for layers in (20, 26)
    )
    thin, _ = sloshing(CYLINDER, FILL_M, 0.001, 20, EXCHANGE_S)
    assert thin == pytest.approx(theory_hz(0.035, FILL_M), rel=0.03)
    assert coarse[0] == pytest.approx(fine[0], rel=0.04)
    assert coarse[1] == pytest.approx(fine[1], rel=0.25) and coarse[1] < 0.1


def test_a_swirl_dies_as_stokes_says() -> None:
    """Azimuthal flow J1(3.8317 r/R) sin(pi z/2h): no slip at side and bottom, no stress on top, an exact solution."""
    liquid = Liquid(CYLINDER, FILL_M, 1.0, 20)
    r = np.hypot(
        liquid.x[:, 0],
        liquid.x[:, 1],
    )
    angle = np.linspace(0.0, np.pi, 61)
    bessel = np.cos(angle - 3.8317 / 0.035 * r[:, None] * np.sin(angle)).mean(axis=1)
    size = 0.05 * bessel * np.sin(0.5 * np.pi * liquid.x[:, 2] / FILL_M) / r
    liquid.v[:] = size[:, None] * np.column_stack(
        [-liquid.x[:, 1], liquid.x[:, 0], np.zeros_like(r)]
    )

    def spin() -> float:
        return float((liquid.x[:, 0] * liquid.v[:, 1] - liquid.x[:, 1] * liquid.v[:, 0]).sum())

    found = []
    for _ in range(50):
        liquid.step(DOWN, NONE, NONE, NONE, EXCHANGE_S)
        found.append(spin())
    rate = np.log(found[9] / found[49]) / (40 * EXCHANGE_S)
    assert rate == pytest.approx(
        1e-3 * ((3.8317 / 0.035) ** 2 + (0.5 * np.pi / FILL_M) ** 2), rel=0.03
    )


def test_contents_weigh_what_they_weigh_and_follow_their_container() -> None:
    liquid = Liquid(CYLINDER, FILL_M, 0.001, 14)
    grains = Grains(CYLINDER, 0.03, 0.008, 1400.0, 0.4)
    assert len(grains.x) >= 100
    for contents in (liquid, grains):
        told = np.mean(
            [
                contents.step(
                    DOWN,
                    NONE,
                    NONE,
                    NONE,
                    EXCHANGE_S,
                )
                for _ in range(10)
            ],
            axis=0,
        )
        centre, _ = contents.moments()
        weight = contents.kg * DOWN
        np.testing.assert_allclose(
            told,
            [
                *weight,
                *np.cross(centre, weight),
            ],
            atol=2e-3 * contents.kg * 9.81,
        )
    push = np.array([1.0, 0.0, 0.0])
    share = -liquid.step(DOWN, push, NONE, NONE, EXCHANGE_S)[0] / liquid.kg
    ks = 1.8412 / 0.035 * FILL_M
    # the rest sloshes
    assert share == pytest.approx(1.0 - 2.0 * np.tanh(ks) / (2.39 * ks), abs=0.03)
    held = (
        np.mean(
            [
                grains.step(
                    DOWN,
                    push,
                    NONE,
                    NONE,
                    EXCHANGE_S,
                )[0]
                for _ in range(50)
            ]
        )
        / grains.kg
    )
    assert held == pytest.approx(-1.0, abs=0.03)  # grains that do not slide are carried along


REACH_M = 0.152
LOW_M = -0.149
"""From the joint to the bottom of the container, along it and along its axis."""
JOINT_KG_M2 = 0.03
SPRING_N_M = 1.0
LOSS_N_M_S = 0.1
TURNS_STEP_S = 0.002


class Turned:
    """A joint on a spring that turns a liquid; what the liquid does beside its frozen self acts a step late, carried on linearly.

    Args:
        liquid: At rest.
        moving: Whether it sloshes; else it stays frozen.
    """

    def __init__(self, liquid: Liquid, moving: bool) -> None:
        centre, about = liquid.moments()
        self.liquid = liquid
        self.moving = moving
        self.place = centre + np.array([REACH_M, 0.0, LOW_M])
        steiner = liquid.kg * (self.place @ self.place - centre @ centre)
        self.inertia = JOINT_KG_M2 + about[1, 1] + steiner
        self.q = 0.0
        self.v = 0.0
        self.told = [0.0, 0.0]

    def weight(self, q: float) -> float:
        """Torque of the frozen liquid's weight [N m]."""
        lever = self.place[0] * np.cos(q) + self.place[2] * np.sin(q)
        return float(self.liquid.kg * 9.81 * lever)

    def acceleration(
        self,
        pull: float,
        q: float,
        v: float,
    ) -> float:
        """Under a torque [N m], at an angle and a speed [rad/s^2]."""
        level = self.liquid.kg * 9.81 * REACH_M
        rest = self.weight(q) - level + 2.0 * self.told[1] - self.told[0]
        return float(pull - SPRING_N_M * np.sin(q) - LOSS_N_M_S * v + rest) / self.inertia

    def step(self, pull: float) -> None:
        """Moves on by the midpoint rule under a torque [N m]."""
        middle = self.q + 0.5 * TURNS_STEP_S * self.v
        fast = self.v + 0.5 * TURNS_STEP_S * self.acceleration(pull, self.q, self.v)
        a = self.acceleration(pull, middle, fast)
        self.q = self.q + TURNS_STEP_S * fast
        self.v = self.v + TURNS_STEP_S * a
        if self.moving:
            self.told = [self.told[1], self._beside_frozen(middle, fast, a)]

    def _beside_frozen(
        self,
        q: float,
        v: float,
        a: float,
    ) -> float:
        """Torque of the liquid less that of the frozen one [N m], at an angle, a speed and an acceleration."""
        gravity = 9.81 * np.array([np.sin(q), 0.0, -np.cos(q)])
        drag = np.array([a * LOW_M - v**2 * REACH_M, 0.0, -a * REACH_M - v**2 * LOW_M])
        angular = np.array([0.0, a, 0.0])
        turning = np.array([0.0, v, 0.0])
        wrench = self.liquid.step(gravity, drag, angular, turning, TURNS_STEP_S)
        frozen = self.weight(q) - a * (self.inertia - JOINT_KG_M2)
        return float(wrench[4] + LOW_M * wrench[0] - REACH_M * wrench[2] - frozen)


def angles_under(torque: np.ndarray, turned: Turned) -> np.ndarray:
    """Before each step under these torques [N m], shape (T,)."""
    angles = []
    for pull in torque:
        angles.append(turned.q)
        turned.step(pull)
    return np.array(angles)


def slosh_parameters(
    radius: float,
    fill: float,
    damping: float,
) -> np.ndarray:
    """Parameters of the law by theory, shape (1, P).

    Args:
        radius: Of the container [m].
        fill: Of the water [m].
        damping: Ratio of the first wave.
    """
    slosh = Slosh.of(radius, np.array(fill))
    kg = 1000.0 * np.pi * radius**2 * fill
    still_kg = kg * (1.0 - float(slosh.share))
    up = LOW_M + float((0.5 * fill - slosh.share * slosh.height) / (1.0 - slosh.share))
    own = 0.6 * kg * (radius**2 / 4.0 + fill**2 / 12.0)
    values = {
        "inertia": JOINT_KG_M2 + still_kg * (REACH_M**2 + up**2) + own,
        "torque_constant": 1.0,
        "viscous": LOSS_N_M_S,
        "gravity_constant": 9.81 * kg * REACH_M,
        "gravity_cos": -9.81 * still_kg * REACH_M,
        "gravity_sin": SPRING_N_M - 9.81 * still_kg * up,
        "slosh_mass": kg * float(slosh.share),
        "slosh_height": slosh.height,
        "slosh_stiffness": slosh.stiffness,
        "slosh_damping": 2.0 * damping * np.sqrt(slosh.stiffness),
        "settled": 1.0,
    }
    p = np.zeros((1, len(SLOSH_PARAMETERS)))
    for name, value in values.items():
        p[0, SLOSH_PARAMETERS.index(name)] = value
    return p


@pytest.mark.long
@pytest.mark.parametrize(
    ("radius", "fill", "viscosity"),
    [(0.035, 0.045, 0.001), (0.035, 0.06, 0.1), (0.045, 0.025, 1.0)],
)
def test_the_law_turns_a_joint_as_the_particles_do(
    radius: float, fill: float, viscosity: float
) -> None:
    """By theory, nothing fitted: tilted by 0.2 rad, shaken, 0.15 m beside the joint. A mass on a rail is 20 to 70 % off."""
    cylinder = Cylinder(radius, 0.1)
    times_s = TURNS_STEP_S * np.arange(750)
    torque = -0.2 + 0.24 * np.where(times_s % 0.22 < 0.11, 1.0, -1.0)
    _, damping = sloshing(cylinder, fill, viscosity, 20, TURNS_STEP_S)
    run = JointRun(times_s, times_s, torque, friction_velocity=1e-2, step_s=TURNS_STEP_S)
    by_cos = np.array([0.0, 0.0, 9.81])
    by_sin = np.array([0.0, -9.81, 0.0])
    law = SloshSimulator([SloshRun(run, REACH_M, LOW_M, by_cos, by_sin)])
    p = slosh_parameters(radius, fill, damping)
    shown = law.rollout(np.zeros(1, dtype=np.int32), p)[0][0]
    real, frozen = (
        angles_under(torque, Turned(Liquid(cylinder, fill, viscosity, 20), moving))
        for moving in (True, False)
    )
    assert np.std(frozen - real) > 5e-4
    assert np.std(shown - real) < 0.2 * np.std(frozen - real)


@dataclass
class Bob:
    """A point that slides along x on a spring in the container: MuJoCo has it, too."""

    kg: float = 0.06
    height: float = 0.04
    per_m: float = 30.0
    damping: float = 0.1
    at: float = 0.0
    speed: float = 0.0
    steps: ClassVar[int] = 20

    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        c = np.array([0.0, 0.0, self.height])
        return c, self.kg * (c @ c * np.eye(3) - np.outer(c, c))

    def step(
        self,
        gravity: np.ndarray,
        acceleration: np.ndarray,
        angular: np.ndarray,
        turning: np.ndarray,
        seconds: float,
    ) -> np.ndarray:
        told = np.zeros(6)
        for _ in range(self.steps):
            x = np.array([self.at, 0.0, self.height])
            v = np.array([self.speed, 0.0, 0.0])
            free = (
                gravity
                - acceleration
                - np.cross(angular, x)
                - np.cross(turning, np.cross(turning, x))
            )
            free -= 2.0 * np.cross(turning, v)
            gained = free[0] - (self.per_m * self.at + self.damping * self.speed) / self.kg
            force = self.kg * (free - [gained, 0.0, 0.0])
            told += np.concatenate([force, np.cross(x, force)]) / self.steps
            self.speed += seconds / self.steps * gained
            self.at += seconds / self.steps * self.speed
        return told


@dataclass(frozen=True)
class InMujoco(Filled):
    """The same, solved as one system."""

    def add_to(self, spec: Any) -> Any:
        import mujoco

        body = super().add_to(spec)
        bob = Bob()
        moving = body.add_body(
            name="bob",
            pos=self.bottom + np.array([0.0, 0.0, bob.height]),
            mass=bob.kg,
            inertia=[1e-9] * 3,
        )
        moving.explicitinertial, moving.ipos = True, np.zeros(3)
        moving.add_joint(
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[1, 0, 0],
            stiffness=bob.per_m,
            damping=[bob.damping, 0.0, 0.0],
        )
        return body

    def settle(self, model: Any, data: Any) -> np.ndarray:
        import mujoco

        data.qpos[4] = 0.0
        mujoco.mj_forward(model, data)
        return np.zeros(4)


@pytest.mark.parametrize("period_s", [0.1, 0.2, 0.25, 0.3, 0.35])
def test_a_shake_switches_when_its_command_says(period_s: float) -> None:
    """At some whole periods ``time % period`` is a hair below the period."""
    shaken = simulate(
        HiddenRobot(),
        "joint3",
        {},
        0.0,
        2.5,
        shake=(0.1, period_s),
    )
    half = round(0.5 * period_s / STEP_S)
    says = np.where(
        np.arange(round(2.5 / STEP_S)) // half % 2 == 0,
        0.1,
        -0.1,
    )
    np.testing.assert_array_equal(
        shaken.current_A[: len(says)],
        says,
    )


def frozen_together(empty: Filled, bob: Bob) -> Filled:
    """A container and the bob in it, as one rigid load."""
    kg = empty.mass + bob.kg
    centre = empty.bottom + np.array([0.0, 0.0, bob.height])
    both = (empty.mass * np.array(empty.offset) + bob.kg * centre) / kg
    about = np.diag(empty.inertia[:3])
    for mass, place in ((empty.mass, np.array(empty.offset)), (bob.kg, centre)):
        d = place - both
        about = about + mass * (d @ d * np.eye(3) - np.outer(d, d))
    xx, yy, zz = (float(about[n, n]) for n in range(3))
    six = (xx, yy, zz, float(about[0, 1]), float(about[0, 2]), float(about[1, 2]))
    inner = (bob.kg, *bob.moments())
    return Filled(kg, tuple(both.tolist()), six, empty.bottom, None, inner)


@pytest.mark.long
def test_an_arm_feels_what_moves_in_its_hand_as_if_it_were_one_system() -> None:
    """A bob on a spring, a quarter of the load, coupled step by step and solved by MuJoCo as one; frozen, it moves otherwise."""
    empty = filled(Case("nothing", 1))
    frozen = frozen_together(empty, Bob())
    one = InMujoco(empty.mass, empty.offset, empty.inertia, empty.bottom)
    coupled = replace(frozen, pour=lambda tilt: Bob())
    hidden = HiddenRobot(
        coulomb=(0.02,) * 4, viscous=(0.01,) * 4, armature=(0.005,) * 4, compliance=True
    )
    for push in PUSHES[2:]:
        probe = probe_of(push, hidden, frozen)
        shake = (push.shake_A, 0.25) if push.shake_A else (0.0, 1.0)

        def driven(
            load: Filled, probe: Probe = probe, shake: tuple[float, float] = shake
        ) -> np.ndarray:
            """Angles of the driven joint up to when it is caught: what each weighs then is no part of the push."""
            made = simulate(
                hidden,
                probe.joint,
                probe.start,
                probe.current_A,
                probe.duration_s,
                load,
                shake=shake,
            )
            steps = round(probe.duration_s / STEP_S)
            return made.position[:steps, JOINTS.index(probe.joint)]

        truth = driven(one)
        off = np.abs(driven(coupled) - truth).max()
        off_frozen = np.abs(driven(frozen) - truth).max()
        assert off < 0.02 * off_frozen
    assert CONTAINERS[1].mass == empty.mass
