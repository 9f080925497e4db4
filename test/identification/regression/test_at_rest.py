"""An arm that stands, or moves for a few seconds, weighed with a calibration of motions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from proprio_ros.errors import TooLittleMotion
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.regression.at_rest import SAME_POSE_RAD, Stances
from proprio_ros.identification.regression.motion_equations import Arm
from proprio_ros.identification.regression.online import OnlineEstimate
from proprio_ros.inputs.resources import share_directory
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.regressor import gravity_torques

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("so101")


@pytest.mark.parametrize(
    "pose", [[0.0] * 5, [0.3, -0.8, 0.9, 0.4, -0.2], [-1.0, 0.5, -0.6, -1.2, 1.5]]
)
def test_gravity_is_that_of_mujoco(robot: Robot, pose: list[float]) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjSpec.from_file(str(share_directory() / "urdf" / "so101.urdf")).compile()
    data = mujoco.MjData(model)
    places = [int(model.joint(name).qposadr[0]) for name in JOINTS]
    data.qpos[places] = pose
    mujoco.mj_forward(model, data)
    arm = Arm.of(robot, JOINTS, {"gripper": 0.0})
    order = [JOINTS.index(name) for name in arm.model.joint_names]
    by_body = gravity_torques(arm.model, np.array([pose])[:, order])[0]
    found = np.einsum(
        "jbp,bp->j",
        by_body,
        np.array(arm.bodies),
    )
    places = [int(model.joint(name).dofadr[0]) for name in arm.model.joint_names]
    wanted = data.qfrc_bias[places]
    assert found == pytest.approx(wanted, abs=1e-6)


def recorded(
    robot: Robot,
    goals: list[list[float]],
    rate_hz: float = 30.0,
) -> Motion:
    """Each pose for 2 s, and a straight way of 1 s to the next; one count of noise."""
    random = np.random.default_rng(1)
    rows = [np.array(goals[0], float)]
    for goal in goals:
        start = rows[-1]
        rows += [
            start + (np.array(goal) - start) * k / rate_hz for k in range(1, round(rate_hz) + 1)
        ]
        rows += [np.array(goal, float)] * round(2.0 * rate_hz)
    noise = random.standard_normal((len(rows), len(JOINTS)))
    position = np.array(rows) + 1e-4 * noise
    times_s = np.arange(len(rows)) / rate_hz
    return Motion(
        "made", JOINTS, times_s, position, 0.1 * position, {"gripper": 0.0}, "measured current"
    )


def test_where_it_stood_and_how_it_came_there(robot: Robot) -> None:
    goals = [
        [0.0] * 5,
        [0.5, -0.5, 0.2, 0.0, 0.3],
        [0.1, -0.9, 0.6, 0.0, 0.3],
        [0.1 + 0.5 * SAME_POSE_RAD, -0.9, 0.6, 0.0, 0.3],
    ]
    found = Stances.of(robot, recorded(robot, goals), JOINTS)
    assert found.position == pytest.approx(np.array(goals), abs=1e-3)
    assert found.current_A == pytest.approx(0.1 * found.position)
    assert found.way.tolist() == [
        [0, 0, 0, 0, 0],
        [1, -1, 1, 0, 1],
        [-1, -1, 1, 0, 1],
        [1, -1, 1, 0, 1],
    ]
    # a touch, the way it came
    further = [
        *goals[:3],
        [0.1 - 0.5 * SAME_POSE_RAD, -0.9, 0.6, 0.0, 0.3],
    ]
    assert Stances.of(robot, recorded(robot, further), JOINTS).position == pytest.approx(
        np.array([*further[:2], further[3]]), abs=1e-3
    )
    # the same pose from the other side is another stance
    step = [
        goals[0],
        goals[2],
        [at + 0.02 for at in goals[2]],
        goals[2],
    ]
    stances = Stances.of(robot, recorded(robot, step), JOINTS)
    assert stances.way[:, 1].tolist() == [0, -1, 1, -1]
    # one that never rests has none
    swaying = recorded(
        robot,
        [[0.1 * (-1) ** k] * 5 for k in range(4)],
    )
    steps = np.abs(np.diff(swaying.position[:, 0]))
    ways = np.flatnonzero(steps > 2e-3)
    moving = Motion(
        "m",
        JOINTS,
        swaying.times_s[: len(ways)],
        swaying.position[ways],
        swaying.current_A[ways],
        {},
        "",
    )
    assert not len(Stances.of(robot, moving, JOINTS).way)


def test_servos_of_another_gain_are_named_by_how_they_moved(tmp_path: Path) -> None:
    """Where an arm stands a heavy load hides it."""
    pytest.importorskip("mujoco")
    from at_rest import GAIN, SETTINGS, Sticky, calibrated, fed, new_feed, write

    from proprio_ros.pipeline.replay import replay
    from proprio_ros.pipeline.request import Options

    random = np.random.default_rng(500)
    arm = Sticky(random)
    output = calibrated(arm, random, tmp_path, seconds=20.0)
    options = Options(calibration=output, settings=SETTINGS)
    right, _ = arm.stood(0.6, random, poses=1)
    answer = replay(write(tmp_path / "right", right), options)
    assert answer.verdict is Verdict.ACCEPTED, answer.reasons
    assert answer.values[0].ci95[0] <= 0.6 <= answer.values[0].ci95[1]
    assert "motion shows it to" in answer.assumptions[1]

    arm.gain = 2.0 * GAIN
    whole, poses = arm.stood(0.6, random)
    for name, parts in (("whole", [whole]), ("poses", poses)):
        bags = [write(tmp_path / f"{name}{number}", rows) for number, rows in enumerate(parts)]
        refused = replay(bags, options)
        assert refused.reasons[0].code == "other_torque", refused.reasons
        assert "P gain" in refused.reasons[0]
    feed = new_feed(output)
    running = fed(feed, whole)
    assert running is not None and not running.known and "P gain" in feed.warning


@pytest.mark.long
def test_two_poses_tell_a_load(tmp_path: Path) -> None:
    """Of an arm in MuJoCo whose joints stick, by the benchmark that says how often intervals hold."""
    pytest.importorskip("mujoco")
    from at_rest import STANDS, STILL, WHOLE, Sticky, weighed, write

    answers = weighed(
        501,
        (0.3,),
        seconds=30.0,
    )
    told = {what: (kg, answer) for what, kg, answer in answers}
    for what in (STANDS, WHOLE):
        kg, answer = told[what]
        assert not isinstance(answer, str) and answer.verdict in (
            Verdict.ACCEPTED,
            Verdict.TOO_WIDE,
        ), answer
        low, high = answer.values[0].ci95
        assert low <= kg <= high and high - low < 0.3
    _, still = told[STILL]
    assert (
        isinstance(still, OnlineEstimate)
        and still.known
        and still.ci95_kg[0] <= 0.3 <= still.ci95_kg[1]
    ), still
    assert "each servo has the gain that it was calibrated with" in told[STANDS][1].assumptions[1]  # type: ignore[union-attr]

    from proprio_ros.pipeline.replay import replay
    from proprio_ros.pipeline.request import Options

    arm = Sticky(np.random.default_rng(1))
    _, (pose, _) = arm.stood(
        0.3,
        np.random.default_rng(2),
    )
    still = {name: values[12:] for name, values in pose.items()}
    # and nothing was calibrated
    with pytest.raises(TooLittleMotion, match="no joint moved by more than"):
        replay(
            write(tmp_path / "still", still),
            Options(robot="so101"),
        )
