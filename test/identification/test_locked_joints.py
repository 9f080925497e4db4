"""Joints that yield: the motion read back from a noisy encoder, and the torque it causes, against MuJoCo's inverse dynamics."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.identification.locked_joints import (
    DRIVEN_SCALES,
    LOCKED_SCALES,
    MOVED_EVIDENCE,
    Followed,
    joint_torque,
    loads_of_yielding,
    locked_motions,
    rests_from,
    smooth,
)
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.records import Run
from proprio_ros.robot import ReducedModel, load_robot
from proprio_ros.sim.payload import (
    PayloadFacts,
    PayloadShape,
    payload_parameters,
    pseudo_inertia_basis,
)

TIMES = np.arange(-10, 25) / 40.0
SIGMA = 0.66e-3


def test_a_known_motion_is_read_back() -> None:
    """A joint that is pushed away like a damped spring; 20 mrad over a noise of 0.7."""
    rng = np.random.default_rng(3)
    since = np.maximum(TIMES, 0.0)
    truth = 0.3 + 0.02 * (1.0 - np.exp(-((since / 0.25) ** 2)))
    motion = smooth(
        TIMES,
        truth + SIGMA * rng.standard_normal(len(TIMES)),
        SIGMA,
        LOCKED_SCALES,
    )
    assert motion.evidence > 100.0
    assert motion.start == pytest.approx(0.3, abs=0.5e-3)
    away, velocity, acceleration = motion.at(since)
    np.testing.assert_allclose(motion.start + away, truth, atol=1e-3)
    inner = slice(12, -3)
    rate = 0.02 * np.exp(-((since / 0.25) ** 2)) * 2.0 * since / 0.25**2
    assert np.sqrt(np.mean((velocity - rate)[inner] ** 2)) < 0.012
    bend = np.gradient(
        rate,
        since + 1e-9 * np.arange(len(since)),
    )
    assert np.sqrt(np.mean((acceleration - bend)[inner] ** 2)) < 0.2  # of up to 0.6 rad/s^2


FINE_RAD, FINE_TIMES = 2.0 * np.pi / 2**15, np.arange(-500, 250) / 500.0
"""15 bits at 500 Hz, of which the robot file, a guess, says a fifth of them and a millirad of noise."""


def fine(truth: np.ndarray) -> np.ndarray:
    return FINE_RAD * np.round(truth / FINE_RAD)


def test_readings_that_are_finer_than_the_file_says_are_believed_to_what_they_are() -> None:
    """A joint gives way at once and is caught by a damped spring: 5 rad/s^2 for 20 ms, of which 1 mrad would show nothing."""
    since = np.maximum(FINE_TIMES, 0.0)
    rate = 12.0
    spring = 25.0
    size = 5.0 / (rate**2 + spring**2)
    truth = 0.3 + size * (
        1.0
        - np.exp(-rate * since) * (np.cos(spring * since) + rate / spring * np.sin(spring * since))
    )
    bend = (
        5.0
        * np.exp(-rate * since)
        * (np.cos(spring * since) - rate / spring * np.sin(spring * since))
    )
    motion = smooth(FINE_TIMES, fine(truth), 1.1e-3, LOCKED_SCALES)
    _, _, acceleration = motion.at(since)
    for begins_s, ends_s, within in ((0.005, 0.03, 1.2), (0.03, 0.45, 0.4)):
        part = (since > begins_s) & (since < ends_s)
        assert np.sqrt(np.mean((acceleration - bend)[part] ** 2)) < within


def test_rest_begins_where_a_joint_has_come_to_it() -> None:
    drive = replace(
        load_robot("open_manipulator_x").drive_trains["joint2"],
        encoder_resolution=1.5e-3,
        encoder_noise=1e-3,
    )
    before = FINE_TIMES[FINE_TIMES < 0.0]
    slipped = fine(np.where(before < -0.5, -4e-3, 0.0) + 0.3 - 3e-4 * before)
    assert before[rests_from(before, slipped, drive)] == pytest.approx(-0.5)
    noisy = 0.3 + 1e-3 * np.random.default_rng(2).standard_normal(len(before))
    assert rests_from(before, noisy, drive) == 0
    assert (
        rests_from(before, noisy + np.where(before < -0.7, 0.1, 0.0), drive)
        == np.flatnonzero(before >= -0.7)[0]
    )
    unrounded = (
        0.3
        + 1e-9 * np.random.default_rng(2).standard_normal(len(before))
        + np.where(before < -0.7, 0.1, 0.0)
    )
    assert rests_from(before, unrounded, drive) == np.flatnonzero(before >= -0.7)[0]
    on_its_way = 0.3 + 0.2 * before
    assert rests_from(before, on_its_way, drive) == 0
    assert rests_from(before[:0], before[:0], drive) == 0


def test_what_a_held_joint_did_before_it_came_to_rest_is_no_yielding() -> None:
    """12 mrad, half a second before the push: it was taken for a jump at the onset, whose torque bent all that was learnt."""
    robot = load_robot("open_manipulator_x")
    robot = replace(robot, drive_trains={
        name: replace(drive, encoder_resolution=1.5e-3, encoder_noise=1e-3,) for name, drive in robot.drive_trains.items()
    })  # fmt: skip
    since = np.maximum(FINE_TIMES, 0.0)
    yields = 0.3 + 0.1 * since**2
    readings = {"joint2": fine(yields - np.where(FINE_TIMES < -0.5, 0.012, 0.0))}
    before = FINE_TIMES < 0.0
    run = Run(
        name="push", joint="joint3", onset_ns=0, times_s=FINE_TIMES[~before], position=2.0 * since[~before] ** 2,
        before_times_s=FINE_TIMES[before], before_position=np.zeros(int(before.sum())), held={"joint2": 0.3},
        held_span={"joint2": 0.012}, held_position=readings, input_times_s=np.zeros(1), input_current_A=np.array([0.3]),
        duration_s=0.5, source="/applied_effort",
    )  # fmt: skip
    motion = locked_motions(robot, run, ("joint2",))[1]["joint2"]
    away, _, acceleration = motion.at(since[~before])
    np.testing.assert_allclose(
        motion.start + away,
        yields[~before],
        atol=3e-4,
    )
    assert np.abs(acceleration[5:-5] - 0.2).max() < 0.15  # 4 rad/s^2, if it had to jump
    still = fine(0.3 - np.where(FINE_TIMES < -0.5, 0.094, 0.0))
    run = replace(
        run,
        held={"joint2": float(np.mean(still))},
        held_position={"joint2": still},
    )
    stood, motions = locked_motions(robot, run, ("joint2",))
    assert not motions and stood["joint2"] == pytest.approx(0.3, abs=3e-4), (
        "where it was held, not the mean with what was before"
    )


def test_a_motion_is_consistent_with_itself() -> None:
    """Velocity and acceleration are the derivatives of the position, also at the first knot, and nothing moves before 0."""
    motion = smooth(
        TIMES,
        0.01 * np.maximum(TIMES, 0.0) ** 2,
        SIGMA,
        LOCKED_SCALES,
    )
    motion = replace(
        motion,
        acceleration=np.random.default_rng(1).normal(size=len(motion.knots_s)),
    )
    times = np.linspace(0.0, 0.6, 60001)
    position, velocity, acceleration = motion.at(times)
    np.testing.assert_allclose(
        np.gradient(position, times)[1:-1],
        velocity[1:-1],
        atol=2e-4,
    )
    middle = 0.5 * (acceleration[1:] + acceleration[:-1])
    np.testing.assert_allclose(
        np.cumsum(middle) * (times[1] - times[0]),
        velocity[1:],
        atol=1e-9,
    )
    assert abs(position[0]) < 1e-15 and abs(velocity[0]) < 1e-15
    for part in motion.at(np.array([-0.2, -0.01])):
        np.testing.assert_array_equal(part, 0.0)


def test_a_joint_that_stands_still_is_left_alone() -> None:
    rng = np.random.default_rng(4)
    counts = 2.0 * np.pi / 4096
    called = 0
    for _ in range(200):
        reading = 0.4 + 0.5e-3 * rng.standard_normal(len(TIMES))
        called += (
            smooth(TIMES, counts * np.round(reading / counts), SIGMA, LOCKED_SCALES).evidence
            > MOVED_EVIDENCE
        )
    assert called <= 4


def test_the_driven_joint_too(bags: Path) -> None:
    robot = load_robot("open_manipulator_x")
    (run,) = bag_runs(bags / "realistic_s00_empty_03_joint3" / "bag_mcap", Request(robot))
    times = np.concatenate([run.before_times_s, run.times_s])
    position = np.concatenate([run.before_position, run.position])
    motion = smooth(times, position, SIGMA, DRIVEN_SCALES)
    assert np.sqrt(np.mean((motion.start + motion.at(times)[0] - position) ** 2)) < 1.5 * SIGMA


@pytest.fixture(scope="module")
def mujoco_arm():
    """MuJoCo's own reading of the same URDF, with a load of its own, without damping and limits."""
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec.from_file(
        str(Path(__file__).resolve().parents[2] / "urdf" / "open_manipulator_x.urdf")
    )
    spec.compiler.fusestatic = False
    spec.option.disableflags = int(
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    )
    for equality in list(spec.equalities):
        spec.delete(equality)
    body = spec.body("end_effector_link").add_body(name="load", explicitinertial=True)
    body.mass, body.ipos, body.fullinertia = (
        0.08,
        (0.01, -0.005, 0.02),
        (4e-5, 3e-5, 5e-5, 1e-6, -2e-6, 3e-6),
    )
    model = spec.compile()
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.dof_armature[:] = 0.0
    return mujoco, model, mujoco.MjData(model)


LOAD = PayloadFacts(
    com=np.array([0.01, -0.005, 0.02]),
    shape=PayloadShape.from_inertia_per_mass(
        np.array([4e-5, 3e-5, 5e-5, 1e-6, -2e-6, 3e-6]) / 0.08
    ),
)


def inverse_dynamics(arm, joint: str, positions, velocities, accelerations) -> float:
    mujoco, model, data = arm
    for values, name in itertools.product(
        ((data.qpos, positions), (data.qvel, velocities), (data.qacc, accelerations)), positions
    ):
        values[0][model.joint(name).qposadr[0]] = values[1].get(name, 0.0)
    mujoco.mj_inverse(model, data)
    return float(data.qfrc_inverse[model.joint(joint).dofadr[0]])


def with_load(
    model: ReducedModel,
    frame: str,
    kg: float,
) -> np.ndarray:
    """Pseudo-inertia of every body with so much of `LOAD` in a frame, shape (n, 4, 4)."""
    body, place = model.frames[frame]
    per_mass = payload_parameters(
        np.array(1.0),
        LOAD.com,
        LOAD.shape.second_moment_per_mass,
    )
    per_kg = np.tensordot(per_mass, pseudo_inertia_basis(), axes=1)
    loaded = model.pseudo_inertia.copy()
    loaded[body] += kg * place @ per_kg @ place.T
    return loaded


@pytest.mark.parametrize("joint", ["joint1", "joint2", "joint3", "joint4"])
def test_the_torque_of_a_motion_of_all_joints(mujoco_arm, joint: str) -> None:
    robot = load_robot("open_manipulator_x")
    arm_joints = ["joint1", "joint2", "joint3", "joint4"]
    rng = np.random.default_rng(8)
    q, v, a = rng.uniform(-1.0, 1.0, (3, 6, 4)) * np.array([1.0, 2.0, 10.0])[:, None, None]
    fingers = {"gripper_left_joint": 0.004, "gripper_right_joint": 0.004}
    model = robot.model.lock(
        arm_joints,
        {"gripper_left_joint": 0.004},
        robot.gravity,
    )
    row = model.joint_names.index(joint)
    motion = [(q[:, n], v[:, n], a[:, n]) for n in range(4)]
    empty = joint_torque(model, motion, row, model.pseudo_inertia[None])[:, 0]
    loaded = with_load(model, robot.payload_frame, 0.08)
    total = joint_torque(model, motion, row, loaded[None])[:, 0]
    for t in range(len(q)):
        states = [dict(zip(arm_joints, values[t].tolist(), strict=True)) for values in (q, v, a)]
        states[0] |= fingers
        expected = inverse_dynamics(mujoco_arm, joint, *states)
        assert total[t] == pytest.approx(expected, rel=1e-9, abs=1e-10)
        assert abs(total[t] - empty[t]) > 1e-5


def state_at(
    time_s: float,
    followed: Mapping[str, Followed],
    moving: Collection[str],
    held: Mapping[str, float],
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Angles, speeds and accelerations by joint.

    Args:
        time_s: When [s].
        followed: Motions of joints.
        moving: Those that move; the others are where they were at the start.
        held: Angles of the joints that are not followed [rad].
    """
    position = dict(held)
    velocity: dict[str, float] = {}
    acceleration: dict[str, float] = {}
    for name, motion in followed.items():
        away, rate, bend = (float(part[0]) for part in motion.at(np.array([time_s])))
        live = name in moving
        position[name] = motion.start + away * live
        velocity[name] = rate * live
        acceleration[name] = bend * live
    position["gripper_right_joint"] = position["gripper_left_joint"]
    return position, velocity, acceleration


def test_the_load_of_yielding_joints_is_the_difference_of_two_motions(
    mujoco_arm, bags: Path
) -> None:
    """What the driven joint feels, at the recorded motion: moving joints less the same joints at rest."""
    robot = load_robot("open_manipulator_x")
    (run,) = bag_runs(bags / "realistic_s00_empty_00_joint3" / "bag_mcap", Request(robot))
    _, motions = locked_motions(robot, run, ("joint1", "joint2", "joint4"))
    assert "joint2" in motions  # the shoulder gives way by 8 mrad
    begins, loads, _ = loads_of_yielding(robot, run, motions, LOAD, SIGMA)
    assert begins[0] == 0.0 and loads.shape == (len(begins), 2)
    times = np.concatenate([run.before_times_s, run.times_s])
    driven = smooth(
        times, np.concatenate([run.before_position, run.position]), SIGMA, DRIVEN_SCALES
    )
    middles = begins + 0.5 * (begins[1] - begins[0])
    followed = {**motions, run.joint: driven}
    for t in (0, 7, 20, len(begins) - 1):
        states = []
        for moving in (set(followed), {run.joint}):
            state = state_at(middles[t], followed, moving, run.held)
            states.append(inverse_dynamics(mujoco_arm, run.joint, *state))
        assert loads[t] @ [1.0, 0.08] == pytest.approx(
            states[0] - states[1],
            rel=1e-6,
            abs=1e-9,
        )
