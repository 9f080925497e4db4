"""Probe files: the package's own load and fit the arm, and users' mistakes get one line that says what to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.excitation.plans import (
    LEAST_CURRENT_A,
    START_MARGIN_RAD,
    ExcitationRun,
    ExcitationSequence,
    check_sequence,
    load_sequence,
    sequence_names,
)
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.kinematics import clearance

RUN = "{joint: joint3, current_A: -0.3, duration_s: 0.6, start: {joint2: -1.4, joint3: 0.6, joint4: 0.0}}"


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


def section(
    tmp_path: Path,
    run: str = RUN,
    more: str = "",
) -> Path:
    return written(tmp_path, f"excitation:\n  hand: payload\n{more}  runs:\n    - {run}\n")


def test_the_packages_own_sequences(robot: Robot) -> None:
    assert list(sequence_names()) == sorted(sequence_names())
    others = {"so101": load_robot("so101")}
    hands = {
        name: load_sequence(name, others.get(name.split("_")[0], robot)).hand
        for name in sequence_names()
    }
    assert hands.items() >= {
        "container": "container", "container_shake": "container", "container_until": "container",
        "contents": "container", "contents_shake": "container",
        "empty_hand": "empty", "paper_elbow": "payload", "paper_gripper": "block", "paper_wrist": "container", "payload": "payload",
    }.items()  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        "container",
        "container_shake",
        "contents",
        "contents_shake",
        "empty_hand",
        "payload",
        "paper_elbow",
        "paper_wrist",
    ],
)
def test_starts_are_high_and_inside_the_limits(robot: Robot, name: str) -> None:
    for run in load_sequence(name, robot).runs:
        if run.joint == "gripper_left_joint":
            continue  # the arm stays where it is
        assert set(run.start) == {"joint2", "joint3", "joint4"}
        for joint, position in run.start.items():
            limits = robot.model.joint(joint)
            assert limits.lower + START_MARGIN_RAD <= position <= limits.upper - START_MARGIN_RAD
        assert clearance(robot, {"joint1": 0.0, "gripper_left_joint": 0.0, **run.start}) >= 0.03


def test_a_calibration_moves_each_joint_both_ways(robot: Robot) -> None:
    runs = load_sequence("empty_hand", robot).runs
    assert len(runs) == 16
    for joint in ("joint2", "joint3", "joint4", "gripper_left_joint"):
        own = [run for run in runs if run.joint == joint]
        assert len(own) == 4
        assert min(run.current_A for run in own) < 0.0 < max(run.current_A for run in own)
        assert all(run.min_travel == (0.003 if "gripper" in joint else 0.3) for run in own)
    assert load_sequence("empty_hand_gripper", robot).runs == runs[-4:]


def test_a_squeeze_begins_where_the_fingers_stand_and_cannot_crush(robot: Robot) -> None:
    sequence = load_sequence("softness", robot)
    assert sequence.from_here == ("gripper_left_joint",)
    assert not any(run.start for run in sequence.runs)
    least = [run.min_travel for run in sequence.runs]
    assert len(least) == 3 and least == sorted(set(least)), "three levels"
    assert all(2.0 * run.max_travel / 0.03 < 0.4 for run in sequence.runs), (
        "two fingers, a block of 30 mm"
    )
    begun = sequence.begun_at({"joint1": 0.2, "gripper_left_joint": 0.008})
    assert all(run.start == {"gripper_left_joint": 0.008} for run in begun.runs)
    assert begun.home == {"gripper_left_joint": 0.008}
    stated = replace(
        sequence,
        runs=(
            replace(
                sequence.runs[0],
                start={"gripper_left_joint": 0.01},
            ),
        ),
    )
    assert stated.begun_at({"gripper_left_joint": 0.008}).runs[0].start == {
        "gripper_left_joint": 0.01
    }


def test_a_container_is_tilted_up_and_left_alone_before_each_run(robot: Robot) -> None:
    """The rear end of the hand is its lowest, and the sphere has time to get there."""
    for name in ("container", "container_shake"):
        sequence = load_sequence(name, robot)
        assert sequence.settle_s >= 1.5
        for run in sequence.runs:
            pose = {"joint1": 0.0, "gripper_left_joint": 0.0, **run.start}
            forward = robot.model.frame_transform(robot.payload_frame, pose)[:3, 0]
            assert forward[2] > 0.05  # 3 degrees


def test_the_container_runs(robot: Robot) -> None:
    """Those of the hardware notes, the second from nearer to level, so that the sphere rolls."""
    told = [
        (run.joint, run.current_A, *run.start.values())
        for run in load_sequence("container", robot).runs
    ]
    assert told == [
        ("joint4", -0.10, -0.6, -1.0, 0.6),
        ("joint4", -0.03, -0.6, -0.2, 0.4),
        ("joint3", -0.10, -0.6, -0.4, 0.0),
    ]


def test_a_square_wave_halves_and_keeps_away_from_zero_in_every_attempt(robot: Robot) -> None:
    for run in load_sequence("container_shake", robot).runs:
        mean_A: float | None = run.current_A
        attempts = 0
        while mean_A is not None:
            first = [
                run.current_at(part * run.shake_period_s, mean_A)
                for part in (0.0, 0.49, 1.01, 2.49)
            ]
            second = [
                run.current_at(part * run.shake_period_s, mean_A)
                for part in (0.51, 0.99, 1.51, 2.99)
            ]
            assert first == pytest.approx([mean_A + run.shake_A] * 4)
            assert second == pytest.approx([mean_A - run.shake_A] * 4)
            assert min(map(abs, first + second)) >= LEAST_CURRENT_A
            mean_A = run.other_current(mean_A)
            attempts += 1
        assert attempts > 3
    constant = ExcitationRun("joint4", -0.1, 0.6)
    assert {constant.current_at(0.01 * n, -0.115) for n in range(60)} == {-0.115}


def test_the_papers_numbers(robot: Robot) -> None:
    told = {
        name: (run.joint, abs(run.current_A), run.duration_s, run.max_current_A)
        for name in ("paper_elbow", "paper_wrist", "paper_gripper")
        for run in load_sequence(name, robot).runs
    }
    assert told == {
        "paper_elbow": ("joint3", 0.3, 0.6, None),
        "paper_wrist": ("joint4", 0.1, 0.6, None),
        "paper_gripper": ("gripper_left_joint", 0.3, 1.0, None),
    }


def test_a_file_of_the_users(robot: Robot, tmp_path: Path) -> None:
    path = section(tmp_path, more="  settle_s: 2\n  home: {joint2: -1.0}\n")
    sequence = load_sequence(path, robot)
    assert sequence == load_sequence(str(path), robot)
    assert sequence == ExcitationSequence(
        name="mine",
        hand="payload",
        runs=(
            ExcitationRun(
                "joint3",
                -0.3,
                0.6,
                {"joint2": -1.4, "joint3": 0.6, "joint4": 0.0},
            ),
        ),
        settle_s=2.0,
        home={"joint2": -1.0},
    )


def test_a_finger_has_a_travel_of_its_own(robot: Robot, tmp_path: Path) -> None:
    """1 rad of the motor, in m of the finger: not 1 m."""
    path = section(tmp_path, "{joint: gripper_left_joint, current_A: -0.1, duration_s: 0.5}")
    assert load_sequence(path, robot).runs[0].max_travel == pytest.approx(0.01149)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("current_A: -0.3", "current_A: -300"), "in A, not mA"),
        (("current_A: -0.3", "current_A: -1.2"), "limit of 1 A"),
        (("current_A: -0.3", "current_A: much"), "expected a number, got 'much'"),
        (("current_A: -0.3", "current_A: .nan"), "expected a number"),
        (("current_A: -0.3", "current: -0.3"), "unknown key current; valid keys: joint, current_A"),
        (("current_A: -0.3, ", ""), "lacks current_A"),
        (("joint: joint3", "joint: elbow"), "drives joint1, joint2"),
        (("joint: joint3", "joint: 3"), "name of a joint"),
        (("joint2: -1.4", "joint7: -1.4"), "'joint7' is no driven joint"),
        (("joint3: 0.6", "joint3: 34"), "in rad, not degrees"),
        (("joint3: 0.6", "joint3: 1.35"), "limits less a margin"),
        (("joint3: 0.6", "gripper_left_joint: 15"), "in m, not mm"),
        (
            ("joint2: -1.4, joint3: 0.6, joint4: 0.0", "joint2: 1.3, joint3: 0.9"),
            "above the base's plane",
        ),
        (
            ("start: {joint2: -1.4, joint3: 0.6, joint4: 0.0}", "start: 0.6"),
            "expected joints and their positions",
        ),
        (("duration_s: 0.6", "duration_s: 600"), "60 s at most"),
        (("duration_s: 0.6", "duration_s: 0.6, min_travel: 2"), "below max_travel"),
        (("duration_s: 0.6", "duration_s: 0.6, max_current_A: 0.2"), "must not be below"),
        (("duration_s: 0.6", "duration_s: 0.6, max_current_A: 3"), "limit of 1 A"),
        (("duration_s: 0.6", "duration_s: 0.6, raise_by: 1.0"), "1.05 or more"),
        (("duration_s: 0.6", "duration_s: 0.6, duration_s: 0.6"), "not readable as YAML"),
        (("duration_s: 0.6", "duration_s: 0.6, shake_A: 200"), "in A, not mA"),
        (
            ("duration_s: 0.6", "duration_s: 0.6, shake_A: -0.8"),
            "1.1 A with shake_A is above the motor's limit of 1 A",
        ),
        (
            ("duration_s: 0.6", "duration_s: 0.6, shake_A: 0.2, max_current_A: 0.9"),
            "1.1 A with shake_A",
        ),
        (("duration_s: 0.6", "duration_s: 0.6, shake_A: .nan"), "expected a number"),
        (
            ("duration_s: 0.6", "duration_s: 0.6, shake_A: 0.2, shake_period_s: 200"),
            "0.3 s, .* in s, not ms",
        ),
        (
            ("duration_s: 0.6", "duration_s: 0.6, shake_A: 0.2, shake_period_s: 0.31"),
            "2 periods fit into duration_s=0.6",
        ),
        (("duration_s: 0.6", "duration_s: 0.6, shake_A: 0.2, shake_period_s: 0.07"), "from 0.08 s"),
        (
            ("duration_s: 0.6", "duration_s: 0.6, shake_A: 0.3"),
            "the current is 0 A for half of each period",
        ),
        (
            ("duration_s: 0.6", "duration_s: 0.6, shake_A: -0.3"),
            "the current is 0 A for half of each period",
        ),
        # not at first, but in the second attempt, and in the third
        (
            (
                "duration_s: 0.6",
                "duration_s: 0.6, shake_A: 0.36, raise_by: 1.2, max_current_A: 0.5",
            ),
            "about -0.36 A",
        ),
        (("duration_s: 0.6", "duration_s: 0.6, shake_A: 0.08, raise_by: 0.5"), "about -0.075 A"),
    ],
)
def test_mistakes_in_a_run_get_one_line(
    robot: Robot,
    tmp_path: Path,
    change: tuple[str, str],
    message: str,
) -> None:
    assert change[0] in RUN
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_sequence(section(tmp_path, RUN.replace(*change)), robot)
    assert "\n" not in str(caught.value)
    assert "mine" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("payload: {}\n", "no section 'excitation'; probe files with one: block_until, container"),
        ("- 1\n", "starts with 'excitation:'"),
        ("excitation: 1\n", "expected keys and values"),
        ("excitation: {hand: payload}\n", "lacks runs"),
        ("excitation: {hand: payload, runs: []}\n", "expected a list of runs"),
        (f"excitation: {{hand: full, runs: [{RUN}]}}\n", "choose from: empty"),
        (f"excitation: {{hand: any, name: x, runs: [{RUN}]}}\n", "unknown key name"),
        (f"excitation: {{hand: any, settle_s: -1, runs: [{RUN}]}}\n", "settle_s=-1"),
        (
            f"excitation: {{hand: any, approach_velocity: 0, runs: [{RUN}]}}\n",
            "approach_velocity=0",
        ),
        (f"excitation: {{hand: any, home: {{joint3: 9}}, runs: [{RUN}]}}\n", "home: joint3=9"),
        (
            f"excitation: {{hand: any, runs: [{RUN}, {{joint: joint3}}]}}\n",
            r"runs\[2\]: lacks current_A, duration_s",
        ),
        ("excitation: [\n", "not readable as YAML"),
    ],
)
def test_mistakes_in_a_file_get_one_line(
    robot: Robot, tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_sequence(written(tmp_path, text), robot)
    assert "\n" not in str(caught.value)


def test_names_and_paths_that_are_not_there(robot: Robot, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="there are: block_until, container"):
        load_sequence("full_hand", robot)
    with pytest.raises(ConfigurationError, match="No such file"):
        load_sequence(tmp_path / "none.yaml", robot)


def test_another_robot_says_what_it_lacks() -> None:
    with pytest.raises(ConfigurationError, match="drives pivot"):
        load_sequence("container", load_robot("pendulum"))


def test_sequences_made_in_code_are_checked_too(robot: Robot) -> None:
    good = load_sequence("paper_elbow", robot)
    check_sequence(good, robot)
    for bad in (
        replace(good, runs=()),
        replace(good, hand="full"),
        replace(good, settle_s=float("nan")),
        replace(good, runs=(replace(good.runs[0], current_A=float("inf")),)),
        replace(good, runs=(replace(good.runs[0], max_current_A=float("nan")),)),
        replace(good, runs=(replace(good.runs[0], shake_A=float("nan")),)),
        replace(
            good,
            runs=(
                replace(
                    good.runs[0],
                    shake_A=0.1,
                    shake_period_s=float("nan"),
                ),
            ),
        ),
        replace(good, runs=(replace(good.runs[0], start={"joint3": float("nan")}),)),
    ):
        with pytest.raises(ConfigurationError):
            check_sequence(bad, robot)


def test_clearance_against_the_models_transforms() -> None:
    """The vertical is carried down the tree by its own arithmetic. On a tilted base every joint counts, the sliding ones too."""
    up = np.array([0.3, -0.8, 0.5]) / np.linalg.norm([0.3, -0.8, 0.5])
    robot = replace(load_robot("open_manipulator_x"), gravity=-9.81 * up)
    # the origins of the first two links lie on joint1's axis; the right finger follows the left one, and is no joint of its own
    still = ("joint1", "joint2", "gripper_right_joint")
    moving = [joint.child for joint in robot.model.joints if joint.name not in still]
    for shift in range(-3, 4):
        pose = {
            name: 0.2 * n - 0.15 * shift for n, name in enumerate(robot.model.independent_joints)
        }
        pose["gripper_left_joint"] = 0.01 * shift
        lowest = min(up @ robot.model.frame_transform(frame, pose)[:3, 3] for frame in moving)
        assert clearance(robot, pose) == pytest.approx(lowest, abs=1e-12)
        slid = [clearance(robot, {**pose, "gripper_left_joint": slide}) for slide in (-0.5, 0.5)]
        assert min(slid) < clearance(robot, pose) - 0.01
    with pytest.raises(RobotError, match="lacks the position of joint 'joint4'"):
        clearance(
            robot,
            {name: 0.0 for name in robot.model.independent_joints if name != "joint4"},
        )


def test_a_sequence_is_like_another_but_for_what_it_states(robot: Robot, tmp_path: Path) -> None:
    base = load_sequence("reference", robot)
    longer = load_sequence("reference_until", robot)
    assert longer.runs == base.runs
    assert longer.settle_s == base.settle_s
    assert longer.until is not None
    path = tmp_path / "mine.yaml"
    path.write_text("excitation: {like: payload, settle_s: 2.0}\n")
    mine = load_sequence(path, robot)
    assert mine.runs == load_sequence("payload", robot).runs
    assert mine.settle_s == 2.0
    for wrong in ("payloads", "reference_until", "[payload]"):
        path.write_text(f"excitation: {{like: {wrong}}}\n")
        with pytest.raises(ConfigurationError, match="name one of the package's sequences"):
            load_sequence(path, robot)
