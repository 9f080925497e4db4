"""Joints that servos hold, shaken in MuJoCo: what they do is found by what drives them and by a coarse encoder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")
from random_arm import JOINTS, HiddenRobot, Load, Motion, simulate

from proprio_ros.addons.contents import held_by_servos
from proprio_ros.addons.contents.held_by_servos import Servo, forced_on, give_way
from proprio_ros.identification.locked_joints import LOCKED_SCALES, Followed, smooth
from proprio_ros.quantity import Quantity
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.joint import JointSimulator
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

KG, PLACE, SIGMA = 0.3, (0.02, 0.0, -0.01), 2.0 * np.pi / 4096.0 / np.sqrt(12.0)
LOAD = Load(
    KG,
    PLACE,
    (2e-4, 2e-4, 2e-4, 0.0, 0.0, 0.0),
)
FACTS = PayloadFacts(
    np.array(PLACE),
    np.zeros(3),
    PayloadShape(np.eye(3) * 1e-4 / KG, "a lump"),
)
STIFFNESS, LAG_S = 1.78 * 10.6, 0.48 / 10.6
"""Of the simulated servo, as its current over an angle and over a speed."""


def calibrated(coulomb: float) -> Robot:
    """What is known of the simulated arm."""
    robot = load_robot("open_manipulator_x")
    none = Quantity(0.0)
    known = {
        "coulomb": Quantity(coulomb),
        "viscous": none,
        "load_friction": none,
        "stribeck": none,
        "armature": Quantity(0.012),
    }
    return replace(
        robot,
        drive_trains={name: replace(drive, **known) for name, drive in robot.drive_trains.items()},
    )


SHAKEN_FROM = {
    "joint1": 0.0,
    "joint2": 0.15,
    "joint3": 1.2,
    "joint4": -1.35,
    "gripper_left_joint": 0.0,
}
COUNT_RAD = 2.0 * np.pi / 4096.0
CYCLE_S = 0.025
BEFORE = 20
"""Samples before the onset."""


def shaken(
    seed: int,
    coulomb: float,
) -> tuple[Robot, Run, Followed, Followed]:
    """The elbow swings 0.3 kg at 3 Hz; robot, run, and the true motions of elbow and shoulder."""
    hidden = HiddenRobot(
        torque_constant=(1.78,) * 4, armature=(0.012,) * 4, coulomb=(coulomb,) * 4, compliance=True
    )
    made = simulate(
        hidden, "joint3", SHAKEN_FROM, -0.33, 2.0, LOAD, shake=(0.12, 1.0 / 3.0), braked_s=0.0
    )
    run = shaken_run(readings(made, np.random.default_rng(seed)))
    return calibrated(coulomb), run, true_motion(made, "joint3"), true_motion(made, "joint2")


def readings(made: Motion, rng: np.random.Generator) -> np.ndarray:
    """What noisy encoders say before and during the push [rad], (T, 4)."""
    times_s = np.concatenate([np.arange(-BEFORE, 0) * CYCLE_S, np.arange(0.0, 2.0, CYCLE_S)])
    columns = [np.interp(times_s, made.times_s, column) for column in made.position.T]
    read = np.stack(columns, axis=1)
    noise = 3e-4 * rng.standard_normal(read.shape)
    counted: np.ndarray = COUNT_RAD * np.round((read + noise) / COUNT_RAD)
    return counted


def shaken_run(read: np.ndarray) -> Run:
    """The run of those readings [rad], (T, 4)."""
    held = {
        name: float(np.mean(read[:BEFORE, n])) for n, name in enumerate(JOINTS) if name != "joint3"
    }
    return Run(
        name="shake",
        joint="joint3",
        onset_ns=0,
        times_s=np.arange(0.0, 2.0, CYCLE_S),
        position=read[BEFORE:, 2],
        before_times_s=np.arange(-BEFORE, 0) * CYCLE_S,
        before_position=read[:BEFORE, 2],
        held={**held, "gripper_left_joint": 0.0, "gripper_right_joint": 0.0},
        held_span=dict.fromkeys(held, 0.0),
        held_position={name: read[:, JOINTS.index(name)] for name in held},
        input_times_s=np.zeros(1),
        input_current_A=np.array([-0.33]),
        duration_s=2.0,
        source="/current_command",
    )


def true_motion(made: Motion, joint: str) -> Followed:
    """Angles and speeds of a joint, each 2.5 ms."""
    grid = np.arange(0.0, 2.0, 0.0025)
    column = JOINTS.index(joint)
    speed = np.gradient(made.position, made.times_s, axis=0)
    return Followed(
        grid,
        np.interp(grid, made.times_s, made.position[:, column]),
        np.interp(grid, made.times_s, speed[:, column]),
    )


def off(motion: Followed, truth: Followed) -> float:
    """Of its acceleration, in that of the truth."""
    grid = truth.times_s[40:]
    mine, its = (each.at(grid)[2] for each in (motion, truth))
    return float(np.std(mine - its) / np.std(its))


@pytest.mark.parametrize("coulomb", [0.0, 0.02, 0.05])
def test_a_shaken_shoulder(coulomb: float) -> None:
    robot, run, elbow, truth = shaken(1, coulomb)
    (found,) = give_way(
        robot,
        [run],
        [elbow],
        FACTS,
        [KG],
    )
    away = found["joint2"].position - truth.position
    assert np.ptp(truth.position) > 5e-3
    assert np.std(away) < 2e-4, "an encoder's count is 1.5 mrad"
    assert off(found["joint2"], truth) < 0.25
    readings = run.held_position["joint2"]
    times_s = np.concatenate([run.before_times_s, run.times_s])
    grid = truth.times_s[40:]
    smoothed = smooth(times_s, readings, SIGMA, LOCKED_SCALES).at(grid)[2] - truth.at(grid)[2]
    assert np.std(smoothed) > 0.5 * np.std(truth.at(grid)[2]), "smoothed readings tell less"


def test_runs_of_one_servo_are_taken_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its stiffness and damping are the simulation's."""
    found: list[np.ndarray] = []
    solve = held_by_servos.least_squares

    def spied(*given: object, **options: object) -> object:
        solution = solve(*given, **options)
        found.append(solution.x)
        return solution

    monkeypatch.setattr(held_by_servos, "least_squares", spied)
    made = [shaken(seed, 0.02) for seed in (1, 2, 3)]
    give_way(
        made[0][0],
        [run for _, run, _, _ in made],
        [elbow for _, _, elbow, _ in made],
        FACTS,
        [KG] * 3,
    )
    of_shoulder = found[len(found) // 2]  # the first joint of the second sweep
    stiffness, lag_s = np.exp(held_by_servos.SERVO + held_by_servos.SPREADS[:2] * of_shoulder[:2])
    assert len(of_shoulder) == 6
    assert stiffness == pytest.approx(STIFFNESS, rel=0.1)
    assert lag_s == pytest.approx(LAG_S, rel=0.2)


def test_gradients_are_those_of_finite_differences() -> None:
    robot, run, elbow, _ = shaken(1, 0.02)
    push = forced_on(
        robot,
        run,
        "joint2",
        {"joint3": elbow},
        FACTS,
        KG,
    )
    assert push is not None
    servo = Servo([push, push], SIGMA)
    for z in (
        np.zeros(5),
        np.array([0.3, -0.5, 0.4, 0.6, -0.2]),
        np.array([-0.4, 0.8, -0.7, -0.3, 0.9]),
    ):
        step = 1e-5
        differences = [
            (servo.residual(z + step * e) - servo.residual(z - step * e)) / (2.0 * step)
            for e in np.eye(5)
        ]
        exact = servo.jacobian(z).T
        for mine, its in zip(exact, differences, strict=True):
            assert np.linalg.norm(mine - its) < 2e-3 * np.linalg.norm(its) + 1e-6


def test_implicit_steps_go_where_short_explicit_ones_do() -> None:
    """A joint that sticks, slips and stops again, by the plain walk with steps that friction cannot outrun."""
    robot, run, elbow, _ = shaken(1, 0.05)
    push = forced_on(robot, run, "joint2", {"joint3": elbow}, FACTS, KG)
    assert push is not None
    servo = Servo([push], SIGMA)
    for z in (np.zeros(4), np.array([0.4, -0.6, 0.5, 0.7]), np.array([-0.5, 0.3, -0.8, -0.9])):
        position, velocity, _ = servo.shaken(z)
        short = replace(push.run, step_s=1e-5)
        q, v = JointSimulator([short]).rollout(np.zeros(1, np.int32), servo.along(z)[0])
        assert np.ptp(q) > 1e-3
        assert np.abs(position - q).max() < 2e-5, "a hundredth of a count"
        assert np.abs(velocity - v).max() < 3e-3 * np.abs(v).max()


def test_a_fit_that_failed_moves_no_held_joint() -> None:
    robot, run, elbow, _ = shaken(1, 0.02)
    lost = replace(
        elbow,
        velocity=np.full_like(elbow.velocity, np.nan),
    )
    assert give_way(robot, [run], [lost], FACTS, [KG]) == [{}]
