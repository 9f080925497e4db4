"""Plans are inside the robot's limits, and promise what a weighing then gives: against recordings of an independent simulator."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import seven_joints

import proprio_ros
from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError
from proprio_ros.experiment_design.candidates import CLEARANCE_M
from proprio_ros.experiment_design.planning import (
    ADVISED_TERMS,
    SAME_KIND,
    advise,
    plan,
    with_advice,
)
from proprio_ros.identification.calibration_estimate import CalibrationEstimate, ExcitationPlan
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.gates import LITTLE_TRAVEL
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.kinematics import clearance
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

TO_ITS_END = 600.0  # a search of so few joints ends before
MASSES = (0.01, 0.03, 0.1)
BALL = PayloadFacts(shape=PayloadShape.of("sphere", 0.03))


@pytest.fixture(scope="module")
def estimate(bags: Path) -> CalibrationEstimate:
    robot = load_robot("open_manipulator_x")
    known = [
        LoadedRun(run)
        for folder in sorted(bags.glob("realistic_s00_empty_*"))
        for run in bag_runs(folder / "bag_mcap", Request(robot))
    ]
    return calibrate(robot, known)


@pytest.fixture(scope="module")
def calibrated(estimate: CalibrationEstimate) -> Robot:
    assert estimate.calibration is not None
    return load_robot("open_manipulator_x").with_calibration(estimate.calibration)


def test_only_a_calibration_that_holds_gets_advice(estimate: CalibrationEstimate) -> None:
    robot = load_robot("open_manipulator_x")
    assert not estimate.advice and estimate.weighable is None
    for other in (replace(estimate, verdict=Verdict.REJECTED), replace(estimate, calibration=None)):
        advised = with_advice(robot, other)
        assert not advised.advice and advised.weighable is None
    said: list[str] = []
    refreshed = with_advice(
        robot,
        replace(estimate, whole=None),
        progress=said.append,
    )
    assert (
        not refreshed.advice
        and refreshed.weighable is not None
        and said == ["looking at what can be weighed"]
    )
    assert estimate.calibration is not None
    upwards = dict.fromkeys(estimate.calibration.joints, True)
    one_way = with_advice(
        robot,
        replace(estimate, driven_one_way=upwards),
        count=2,
    )
    assert len(one_way.advice) == 2 and all(plan.travel[0] < 0.0 for plan in one_way.advice)


@pytest.fixture(scope="module")
def plans(calibrated: Robot) -> list[ExcitationPlan]:
    return plan(calibrated, MASSES, BALL, count=20, seconds=TO_ITS_END)


@pytest.mark.long
def test_every_plan_keeps_the_limits(calibrated: Robot, plans: list[ExcitationPlan]) -> None:
    assert len(plans) >= 6
    for entry in plans:
        limits = calibrated.model.joint(entry.joint)
        for name, position in entry.start.items():
            joint = calibrated.model.joint(name)
            assert joint.lower <= position <= joint.upper
        for travel in entry.travel:
            assert abs(travel) >= LITTLE_TRAVEL
            assert limits.lower < entry.start[entry.joint] + travel < limits.upper
            end = {
                **entry.start,
                entry.joint: entry.start[entry.joint] + travel,
            }
            assert clearance(calibrated, end) >= CLEARANCE_M - 1e-9
        assert 0.0 < abs(entry.current_A) <= calibrated.motors[entry.joint].current_limit_A
        assert (
            entry.clearance_m >= CLEARANCE_M
            and entry.kind in ("lift", "lower", "driven")
            and entry.reason
        )


@pytest.mark.long
def test_the_best_comes_first_and_not_ten_times(plans: list[ExcitationPlan]) -> None:
    widest = [max(entry.std_kg) for entry in plans]
    assert widest == sorted(widest)
    kinds = [(entry.joint, entry.kind) for entry in plans]
    assert max(kinds.count(kind) for kind in kinds) <= SAME_KIND and len(set(kinds)) >= 4


@pytest.mark.long
def test_a_plan_promises_what_the_weighing_gives(bags: Path, plans: list[ExcitationPlan]) -> None:
    """A robot without friction, exactly as its file says but for what that leaves open, recorded in MuJoCo at the plan's pose."""
    from random_arm import EMPTY_PROBES, GRIPPER, JOINTS, ball, draw_robot, record

    robot = load_robot("open_manipulator_x")
    rng = np.random.default_rng(11)
    hidden = draw_robot(rng, ("quantised", "encoder_noise", "coulomb", "viscous"))

    def run_of(joint, start, current, load):
        recording = record(hidden, joint, start, current, 0.6, load, rng)
        return cut_runs(recording, joints=[*JOINTS, GRIPPER])[0]

    known = [
        LoadedRun(
            run_of(
                p.joint,
                p.start,
                p.current_A,
                None,
            )
        )
        for p in EMPTY_PROBES
    ]
    learnt = calibrate(robot, known).calibration
    assert learnt is not None
    arm = robot.with_calibration(learnt)
    checked = 0
    for entry in plan(arm, [0.03], BALL, count=6, seconds=TO_ITS_END):
        run = run_of(
            entry.joint,
            entry.start,
            entry.current_A,
            ball(0.03, 0.03),
        )
        estimate = weigh(arm, [run], BALL)
        value = estimate.value("payload_mass")
        assert value.std == pytest.approx(entry.std_kg[0], rel=0.2), entry
        assert abs(value.value - 0.03) < 3.5 * value.std
        travel = estimate.run_fits[0].travel
        assert travel == pytest.approx(entry.travel[0], rel=0.25), entry
        checked += 1
    assert checked >= 3


@pytest.mark.long
def test_a_calibration_makes_better_promises(plans: list[ExcitationPlan]) -> None:
    (before, *_) = plan(
        load_robot("open_manipulator_x"),
        [0.03],
        BALL,
        count=1,
        seconds=TO_ITS_END,
    )
    assert min(entry.std_kg[MASSES.index(0.03)] for entry in plans) < 0.2 * before.std_kg[0]


@pytest.mark.long
def test_masses_that_no_run_suits() -> None:
    with pytest.raises(ConfigurationError, match="narrow the range"):
        plan(load_robot("open_manipulator_x"), [0.001, 10.0], BALL)
    with pytest.raises(ConfigurationError, match="must be positive"):
        plan(load_robot("open_manipulator_x"), [0.0], BALL)


def test_clearance_of_a_known_pose() -> None:
    """Upper arm upright, forearm level: the hand is as high as the elbow, 0.017 + 0.0595 + 0.128 m up."""
    robot = load_robot("open_manipulator_x")
    pose = dict.fromkeys(robot.model.independent_joints, 0.0)
    assert clearance(robot, pose) == pytest.approx(0.017 + 0.0595 + 0.128)
    hanging = {**pose, "joint2": 1.4, "joint3": 1.2}
    assert clearance(robot, hanging) < clearance(robot, pose)
    assert clearance(robot, hanging) == pytest.approx(
        min(
            robot.model.frame_transform(link, hanging)[2, 3]
            for link in ("link5", robot.payload_frame, "gripper_left_link")
        )
    )


@pytest.mark.long
def test_the_advised_run_teaches_more_than_a_middling_one(bags: Path) -> None:
    """Calibrated on three runs, then with the advised fourth, and with one of those that were made: both recorded in MuJoCo."""
    from random_arm import EFFECTS_DEFAULT, EMPTY_PROBES, GRIPPER, JOINTS, draw_robot, record

    robot = load_robot("open_manipulator_x")
    rng = np.random.default_rng(4)
    hidden = draw_robot(rng, EFFECTS_DEFAULT)

    def run_of(joint, start, current):
        return LoadedRun(
            cut_runs(
                record(hidden, joint, start, current, 0.6, None, rng), joints=[*JOINTS, GRIPPER]
            )[0]
        )

    known = [
        run_of(p.joint, p.start, p.current_A)
        for p in (EMPTY_PROBES[0], EMPTY_PROBES[2], EMPTY_PROBES[4])
    ]

    def uncertainty(runs) -> float:
        calibration = calibrate(robot, runs).calibration
        rows = [calibration.keys.index((term, "joint3")) for term in ADVISED_TERMS]
        return float(np.linalg.slogdet(calibration.covariance[np.ix_(rows, rows)])[1])

    first = calibrate(robot, known).calibration
    advised = advise(robot.with_calibration(first), ["joint3"], count=1)[0]
    middling = EMPTY_PROBES[1]
    gains = [
        uncertainty(known) - uncertainty([*known, extra])
        for extra in (
            run_of(advised.joint, advised.start, advised.current_A),
            run_of(middling.joint, middling.start, middling.current_A),
        )
    ]
    assert gains[0] > gains[1] > 0.0


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["plan", "--mass", "0.02..0.05", "--robot", "pendulum", "--json", "--count", "2"]) == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert (
        told["robot"] == "pendulum" and told["calibrated"] is False and len(told["masses_kg"]) == 3
    )
    assert len(told["plans"]) == 2
    assert set(told["plans"][0]) == {
        "joint", "start", "current_A", "duration_s", "kind", "travel_rad", "clearance_m", "std_kg", "reason",
    }  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [
        ["--mass", "abc"],
        ["--mass", "0.2..0.1"],
        ["--mass", "-1"],
        ["--mass", "0.1", "--count", "0"],
    ],
)
def test_mistakes_get_one_line(
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
) -> None:
    assert main(["plan", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("proprio: --")


# --- seven joints, and a search that can be stopped ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def seven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seven")
    urdf = seven_joints.write(folder)
    robot = folder / "robot.yaml"
    assert main(["robot", "new", str(urdf), "--effort-unit", "N.m", "--output", str(robot)]) == 0
    return robot


def test_seven_joints_have_a_plan_at_once_and_better_ones_later(seven: Path) -> None:
    said: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        (first,) = proprio_ros.plan(
            0.05,
            robot=seven,
            count=1,
            seconds=0.0,
            progress=said.append,
        )
        later = proprio_ros.plan(
            0.05,
            robot=seven,
            count=20,
            seconds=4.0,
            progress=said.append,
        )
    assert "trying start poses of joint2" in said[0] and any(
        "start poses tried in" in one for one in said
    )
    assert 0.0 < later[0].std_kg[0] <= first.std_kg[0]
    kinds = [(entry.joint, entry.kind) for entry in later]
    assert max(kinds.count(kind) for kind in kinds) <= SAME_KIND
    limits = load_robot(seven).model
    for name, position in later[0].start.items():
        assert limits.joint(name).lower <= position <= limits.joint(name).upper


def test_interrupted_it_returns_the_best_so_far(seven: Path) -> None:
    said: list[str] = []

    def interrupt(sentence: str, after: str) -> None:
        said.append(sentence)
        if after in sentence:
            raise KeyboardInterrupt

    plans = proprio_ros.plan(
        0.05, robot=seven, seconds=60.0, progress=lambda one: interrupt(one, "so far joint")
    )
    assert plans and said[-1] == "stopped: these are the best so far"
    with pytest.raises(KeyboardInterrupt):
        proprio_ros.plan(
            0.05, robot=seven, progress=lambda one: interrupt(one, "trying start poses")
        )


def test_the_command_interrupted_prints_the_best_so_far(seven: Path) -> None:
    words = [
        "plan",
        "--mass",
        "0.05",
        "--robot",
        str(seven),
        "--count",
        "1",
        "--seconds",
        "600",
        "--json",
    ]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-m", "proprio_ros.cli", *words],
        stdout=pipe,
        stderr=pipe,
        text=True,
        # what a shell starts in the background has it ignored, and hands that on
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as command:
        assert command.stderr is not None
        for line in command.stderr:
            if "so far joint" in line:
                break
        command.send_signal(signal.SIGINT)
        out, error = command.communicate()
    assert command.returncode == 0 and "proprio: stopped: these are the best so far" in error
    assert len(json.loads(out)["plans"]) == 1


def test_a_mass_that_nothing_tells_is_no_plan() -> None:
    """The flange of a UR5e turns about its own axis: an object in the middle of it changes nothing."""
    plans = plan(
        load_robot("ur5e"),
        [0.05],
        count=20,
        seconds=2.0,
    )
    assert plans and all(
        entry.joint != "wrist_3_joint" and entry.std_kg[0] > 1e-3 for entry in plans
    )


def test_a_joint_that_drives_another_one_is_held() -> None:
    assert all(
        entry.joint != "gripper_joint_1" for entry in plan(load_robot("omx_f"), [0.05], seconds=0.0)
    )
