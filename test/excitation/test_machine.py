"""The state machine against a small arm that obeys it, and against everything that may go wrong while a current is on."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.recording_bag import write_recording

from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import Command, JointSample
from proprio_ros.excitation.guards import Guards
from proprio_ros.excitation.machine import MOST_LOST_RUNS, ExcitationMachine, Phase, RunOutcome
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence, load_sequence
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import InputRecord, JointRecord, Recording
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.kinematics import clearance

ROBOT = load_robot("open_manipulator_x")
JOINTS = tuple(ROBOT.drive_trains)
GRIPPER = "gripper_left_joint"
FINGER = 0.01149  # m per rad of its motor
COUNT_RAD = 0.001534
VELOCITY_COUNT_RAD_S = 0.024
HOME = {
    "joint1": 0.2,
    "joint2": -0.8,
    "joint3": 0.4,
    "joint4": 0.3,
    GRIPPER: 0.004,
}
QUICK = ExcitationSequence(
    "quick", "any", (ExcitationRun("joint3", -0.3, 0.6),), settle_s=0.3, brake_s=0.1
)


# ------------------------------------------------------------------------------------------------------------ an arm


class Arm:
    """Joints as double integrators with gravity, dry friction, and servos that get each command one tick late.

    Weights are those of the OpenMANIPULATOR-X: 285 mA hold the level forearm, 77 mA the hand, 338 mA the whole arm.
    """

    STEP_S = 0.001
    INERTIA: ClassVar = {
        "joint1": 0.03,
        "joint2": 0.04,
        "joint3": 0.03,
        "joint4": 0.02,
        GRIPPER: 0.02,
    }
    CONSTANT = 1.78
    FRICTION = 0.05
    STIFFNESS = 40.0
    DAMPING = 1.5
    SUPPLY_V = 12.0
    BACK_EMF_V_S = 2.49
    RESISTANCE_OHM = 5.22

    def __init__(
        self,
        pose: dict[str, float],
        friction: float = FRICTION,
    ) -> None:
        self.q = {name: pose[name] / (FINGER if name == GRIPPER else 1.0) for name in JOINTS}
        self.v = dict.fromkeys(JOINTS, 0.0)
        self.friction = friction
        self.time_s = 10.0
        self.waiting = Command(dict(pose))
        self.external: dict[str, float] = {}  # N m

    def weight(self) -> dict[str, float]:
        forearm = self.q["joint2"] + self.q["joint3"]
        hand = 0.137 * math.cos(forearm + self.q["joint4"])
        elbow = 0.37 * math.cos(forearm) + hand
        return {
            "joint2": 0.095 + 0.55 * math.sin(self.q["joint2"]) + elbow,
            "joint3": elbow,
            "joint4": hand,
        }

    def step(self, command: Command, duration_s: float) -> JointSample:
        goals = self.waiting
        self.waiting = command
        for _ in range(round(duration_s / self.STEP_S)):
            weight = self.weight()
            for name in JOINTS:
                q = self.q[name]
                v = self.v[name]
                if name in goals.current_A:
                    induced_V = self.BACK_EMF_V_S * v
                    most = (self.SUPPLY_V - induced_V) / self.RESISTANCE_OHM
                    least = (-self.SUPPLY_V - induced_V) / self.RESISTANCE_OHM
                    torque = self.CONSTANT * min(max(goals.current_A[name], least), most)
                else:
                    goal = goals.position[name] / (FINGER if name == GRIPPER else 1.0)
                    torque = self.STIFFNESS * (goal - q) - self.DAMPING * v
                torque += weight.get(name, 0.0) + self.external.get(name, 0.0)
                torque -= self.friction * math.tanh(v / 0.01)
                self.v[name] = v + self.STEP_S * torque / self.INERTIA[name]
                self.q[name] = q + self.STEP_S * self.v[name]
        self.time_s += duration_s
        return self.sample()

    def sample(self) -> JointSample:
        scale = {name: FINGER if name == GRIPPER else 1.0 for name in JOINTS}
        return JointSample(
            self.time_s,
            {name: scale[name] * COUNT_RAD * round(self.q[name] / COUNT_RAD) for name in JOINTS},
            {
                name: scale[name]
                * VELOCITY_COUNT_RAD_S
                * round(self.v[name] / VELOCITY_COUNT_RAD_S)
                for name in JOINTS
            },
        )


@dataclass(frozen=True)
class Tick:
    phase: Phase
    command: Command
    fraction: float
    sample: JointSample


def check_command(machine: ExcitationMachine, command: Command, phase: Phase) -> None:
    """What must hold of every command, come what may."""
    assert not command.position.keys() & command.current_A.keys()
    assert command.position.keys() | command.current_A.keys() == set(JOINTS)
    assert all(math.isfinite(goal) for goal in command.position.values())
    assert bool(command.current_A) == (phase is Phase.PROBE)
    for joint, current in command.current_A.items():
        run = machine.sequence.runs[machine.run_number - 1]
        assert joint == run.joint
        most_A = max(abs(run.current_A), run.max_current_A or 0.0) + abs(run.shake_A)
        assert abs(current) <= most_A <= ROBOT.motors[joint].current_limit_A


def drive(
    machine: ExcitationMachine,
    arm: Arm,
    rate_hz: float,
    meddle: Callable[[Arm], None] = lambda _: None,
) -> list[Tick]:
    """Tick until the machine is done."""
    ticks = []
    sample = arm.sample()
    while machine.busy:
        meddle(arm)
        command = machine.tick(arm.time_s, sample)
        check_command(machine, command, machine.phase)
        ticks.append(
            Tick(
                machine.phase,
                command,
                machine.fraction,
                sample,
            )
        )
        sample = arm.step(command, 1.0 / rate_hz)
        assert len(ticks) < 400 * rate_hz
    return ticks


# -------------------------------------------------------------------------------------------------- all goes well


@pytest.mark.parametrize("rate_hz", [100.0, 40.0])
def test_a_calibrations_runs(rate_hz: float) -> None:
    sequence = replace(load_sequence("empty_hand", ROBOT), home=HOME)
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    machine.start(sequence, arm.sample())
    ticks = drive(machine, arm, rate_hz)
    assert machine.phase is Phase.DONE, machine.message
    assert not machine.abort_reason
    used = [outcome for outcome in machine.outcomes if outcome.used]
    assert [outcome.run_number for outcome in used] == list(range(1, 17))
    assert {outcome.ended_by for outcome in used} == {"time", "travel"}
    for outcome in used:
        check_within(outcome, sequence.runs[outcome.run_number - 1], 1.0 / rate_hz)
    fractions = [tick.fraction for tick in ticks]
    assert fractions == sorted(fractions)
    assert fractions[0] < 0.01
    assert fractions[-1] == 1.0
    # at home, but for what the servos give under the arm's weight
    for name, position in arm.sample().position.items():
        assert position == pytest.approx(HOME[name], abs=0.05), name
    assert machine.tick(arm.time_s + 100.0, None) == Command(ticks[-1].command.position)
    assert machine.message == "empty_hand is done: all 16 runs are good"


def check_within(outcome: RunOutcome, run: ExcitationRun, period_s: float) -> None:
    """A push travelled and lasted as it should, up to what happens within a tick [s]."""
    shaft = ROBOT.drive_trains[run.joint].transmission
    assert run.min_travel <= outcome.travel <= run.max_travel + 6.0 * shaft * period_s
    assert outcome.duration_s <= run.duration_s + period_s


@pytest.mark.parametrize("rate_hz", [100.0, 40.0])
def test_goals_begin_at_the_measured_pose_and_keep_the_speed(rate_hz: float) -> None:
    sequence = replace(
        load_sequence("payload", ROBOT),
        home={**HOME, GRIPPER: 0.012},
    )
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    measured = arm.sample()
    machine.start(sequence, measured)
    assert machine.command == Command(dict(measured.position))
    ticks = drive(machine, arm, rate_hz)
    assert ticks[0].command == Command(dict(measured.position))
    assert machine.phase is Phase.DONE
    fastest = 0.0
    for before, after in itertools.pairwise(ticks):
        for name, goal in after.command.position.items():
            if name in before.command.position:
                moved = abs(goal - before.command.position[name]) / (
                    FINGER if name == GRIPPER else 1.0
                )
                fastest = max(fastest, moved * rate_hz)
                assert moved * rate_hz <= sequence.approach_velocity * (1.0 + 1e-6)
        if before.phase is Phase.PROBE and after.phase is not Phase.PROBE:
            # held where it is at the end of the current
            joint = next(iter(before.command.current_A))
            assert after.command.position[joint] == after.sample.position[joint]
    assert fastest > 0.9 * sequence.approach_velocity


def test_the_rest_before_a_run_is_as_long_as_stated_and_truly_a_rest() -> None:
    sequence = replace(load_sequence("paper_elbow", ROBOT), settle_s=1.2)
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME, friction=0.1)
    machine.start(sequence, arm.sample())
    ticks = drive(machine, arm, 40.0)
    phases = [tick.phase for tick in ticks]
    onset = phases.index(Phase.PROBE)
    rest = [tick.sample.position["joint3"] for tick in ticks if tick.phase is Phase.SETTLE]
    assert len(rest) >= 1.2 * 40 - 1
    assert max(rest[-8:]) - min(rest[-8:]) <= 2 * COUNT_RAD
    assert phases.count(Phase.PROBE) == 24
    assert {tick.command.current_A["joint3"] for tick in ticks[onset : onset + 24]} == {-0.3}
    # other joints keep the goals they had, not where they were seen
    held = {
        name: goal for name, goal in ticks[onset - 1].command.position.items() if name != "joint3"
    }
    assert all(tick.command.position == held for tick in ticks[onset : onset + 24])


@pytest.mark.parametrize("tick_s", [0.0249, 0.0251])
def test_a_run_ends_at_the_nearest_tick(tick_s: float) -> None:
    ready = bench(Phase.PROBE)
    while ready.machine.phase is Phase.PROBE:
        ready.tick(tick_s)
    assert ready.machine.outcomes[-1].duration_s == pytest.approx(24 * tick_s)


def test_a_run_that_moves_too_little_is_made_with_more_current_until_it_moves() -> None:
    # begins, and begins again, where the joint is
    run = ExcitationRun(
        "joint4",
        -0.05,
        0.6,
        {},
        0.8,
        0.3,
        1.5,
        0.3,
    )
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME, friction=0.03)
    machine.start(
        replace(QUICK, runs=(run,)),
        arm.sample(),
    )
    ticks = drive(machine, arm, 100.0)
    tried = [outcome.current_A for outcome in machine.outcomes]
    assert len(tried) >= 2
    assert tried == pytest.approx([-0.05 * 1.5**n for n in range(len(tried))])
    assert [outcome.used for outcome in machine.outcomes] == [False] * (len(tried) - 1) + [True]
    assert [outcome.attempt for outcome in machine.outcomes] == list(range(1, len(tried) + 1))
    onsets = [
        after.sample.position["joint4"]
        for before, after in itertools.pairwise(ticks)
        if before.phase is Phase.SETTLE and after.phase is Phase.PROBE
    ]
    assert onsets == pytest.approx([HOME["joint4"]] * len(tried), abs=0.02)
    fractions = [tick.fraction for tick in ticks]
    assert fractions == sorted(fractions)


def test_raising_ends_at_the_largest_current_and_says_so() -> None:
    stuck = ExcitationRun(
        "joint4",
        -0.05,
        0.2,
        {"joint4": 0.0},
        0.8,
        0.3,
        1.5,
        0.1,
    )
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME, friction=0.8)
    machine.start(
        replace(
            QUICK,
            runs=(stuck, ExcitationRun("joint1", 0.55, 0.3)),
        ),
        arm.sample(),
    )
    drive(machine, arm, 100.0)
    assert machine.phase is Phase.DONE
    first = [outcome for outcome in machine.outcomes if outcome.run_number == 1]
    assert [outcome.current_A for outcome in first] == pytest.approx([-0.05, -0.075, -0.1])
    assert not any(outcome.used for outcome in first)
    assert (
        machine.outcomes[-1].run_number,
        machine.outcomes[-1].attempt,
    ) == (2, 1)
    assert "1 of 2 runs are good; run 1 moved too little" in machine.message


def test_a_lowering_run_is_eased() -> None:
    held = ExcitationRun(
        "joint4", -0.08, 0.6, {"joint3": 0.0, "joint2": -0.3, "joint4": 0.3}, 0.8, 0.15, 0.5
    )
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    machine.start(
        replace(QUICK, runs=(held,)),
        arm.sample(),
    )
    drive(machine, arm, 100.0)
    tried = [outcome.current_A for outcome in machine.outcomes]
    assert len(tried) >= 2
    assert tried == pytest.approx([-0.08 * 0.5**n for n in range(len(tried))])
    assert machine.outcomes[-1].used


SHAKE = ExcitationRun(
    "joint4",
    -0.08,
    0.6,
    {},
    0.9,
    0.0,
    0.5,
    None,
    0.12,
    0.2,
)


def waves(ticks: list[Tick]) -> list[list[float]]:
    """The currents of joint4, attempt by attempt."""
    stretches = itertools.groupby(
        ticks,
        key=lambda tick: tick.phase is Phase.PROBE,
    )
    return [
        [tick.command.current_A["joint4"] for tick in group]
        for pushing, group in stretches
        if pushing
    ]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_shaken_joint_gets_a_square_wave_that_begins_with_its_first_half(sign: float) -> None:
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    machine.start(
        replace(
            QUICK,
            runs=(replace(SHAKE, shake_A=sign * 0.12),),
        ),
        arm.sample(),
    )
    ticks = drive(machine, arm, 40.0)
    high = [-0.08 + sign * 0.12] * 4
    low = [-0.08 - sign * 0.12] * 4
    assert waves(ticks) == [pytest.approx((high + low) * 3)]
    assert [(outcome.current_A, outcome.used) for outcome in machine.outcomes] == [(-0.08, True)]
    shaking = bench(Phase.PROBE, machine.sequence).machine
    assert shaking.message == "run 1 of 1: joint4 is pushed with -0.08 +-0.12 A"


def test_halves_of_a_wave_are_equal_although_ticks_are_not() -> None:
    """Ticks come up to 3 ms early or late."""
    ready = bench(
        Phase.PROBE,
        replace(QUICK, runs=(SHAKE,)),
    )
    currents = [ready.machine.command.current_A["joint4"]]
    ticks_s = itertools.cycle([0.027, 0.022, 0.025, 0.028, 0.023])
    while ready.machine.phase is Phase.PROBE:
        currents.append(ready.tick(next(ticks_s)).current_A.get("joint4", 0.0))
    assert currents == pytest.approx(([0.04] * 4 + [-0.2] * 4) * 3 + [0.0])


def test_a_pause_before_the_onset_is_no_part_of_the_wave() -> None:
    ready = bench(
        Phase.SETTLE,
        replace(
            QUICK,
            runs=(replace(SHAKE, shake_period_s=0.08),),
            settle_s=1.0,
        ),
    )
    for _ in range(95):
        ready.tick()
    assert ready.machine.phase is Phase.SETTLE
    command = ready.tick(0.12)
    assert ready.machine.phase is Phase.PROBE
    assert command.current_A == pytest.approx({"joint4": 0.04})


def test_another_attempt_changes_the_mean_of_a_wave_and_not_its_size() -> None:
    stuck = replace(
        SHAKE, duration_s=0.4, min_travel=0.3, raise_by=1.5, max_current_A=0.15, shake_A=0.2
    )
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME, friction=0.8)
    machine.start(
        replace(QUICK, runs=(stuck,)),
        arm.sample(),
    )
    ticks = drive(machine, arm, 100.0)
    assert [outcome.current_A for outcome in machine.outcomes] == pytest.approx(
        [-0.08, -0.12, -0.15]
    )
    assert [(wave[0], wave[10]) for wave in waves(ticks)] == [
        pytest.approx((mean_A + 0.2, mean_A - 0.2)) for mean_A in (-0.08, -0.12, -0.15)
    ]


def test_a_shaken_joint_is_guarded_like_a_pushed_one() -> None:
    sequence = replace(
        QUICK,
        runs=(replace(SHAKE, joint="joint3"),),
    )
    for change, ended_by, words in MISHAPS.values():
        ready = bench(Phase.PROBE, sequence)
        ready.tick()
        assert_stopped(ready, ready.tick(**change), ended_by, words)
    ready = bench(
        Phase.PROBE,
        replace(
            QUICK,
            runs=(replace(SHAKE, max_travel=0.1),),
        ),
    )
    assert ready.tick(joint4=HOME["joint4"] + 0.09).current_A
    assert not ready.tick(joint4=HOME["joint4"] + 0.11).current_A
    assert ready.machine.outcomes[-1].ended_by == "travel"
    assert ready.machine.outcomes[-1].used


def recorded(ticks: list[Tick], topic: str) -> Recording:
    """What a recorder gets: joint states, and commands while there is a current, or the driver's echo at every sample."""
    stamps = np.array([round(1e9 * tick.sample.time_s) for tick in ticks])
    positions = [[tick.sample.position[name] for name in JOINTS] for tick in ticks]
    current = np.array(
        [[tick.command.current_A.get(name, 0.0) for name in JOINTS] for tick in ticks]
    )
    rows = np.ones(len(ticks), dtype=bool)
    if topic == "/current_command":
        driven = current.any(axis=1)
        rows = driven | np.roll(driven, 1)  # the command that ends the current is the last one
    else:
        current = 0.00269 * np.rint(current / 0.00269)  # as sent to the servo
    inputs = InputRecord(
        stamps[rows],
        JOINTS,
        current[rows],
        topic,
    )
    return Recording(
        "shaken",
        JointRecord(stamps, JOINTS, np.array(positions)),
        inputs,
    )


@pytest.mark.parametrize("rate_hz", [100.0, 40.0])
@pytest.mark.parametrize("topic", ["/current_command", "/applied_effort"])
def test_a_recording_of_a_shaken_joint_is_one_run_with_the_wave_in_it(
    topic: str, rate_hz: float, tmp_path: Path
) -> None:
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    second = replace(
        SHAKE,
        current_A=-0.06,
        shake_A=-0.14,
        shake_period_s=0.3,
    )
    machine.start(
        replace(QUICK, runs=(SHAKE, second)),
        arm.sample(),
    )
    recording = recorded(drive(machine, arm, rate_hz), topic)
    if topic == "/current_command":
        write_recording(tmp_path / "shaken", recording)
        recording = read_recording(
            tmp_path / "shaken", nominal_torque_constants={}, joint_order=JOINTS
        )
    cut = cut_runs(recording, joints=JOINTS)
    assert [(run.joint, run.source) for run in cut] == [("joint4", topic)] * 2
    for run, means, times_s in zip(
        cut,
        ((0.04, -0.2), (-0.2, 0.08)),
        ([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], [0.0, 0.15, 0.3, 0.45]),
        strict=True,
    ):
        assert run.duration_s == pytest.approx(0.6)
        assert run.input_times_s == pytest.approx(times_s, abs=1e-6)
        assert run.input_current_A == pytest.approx(means * (len(times_s) // 2), abs=0.0014)
        assert len(run.times_s) == round(0.6 * rate_hz) + 1


def test_the_gripper_counts_in_metres() -> None:
    run = ExcitationRun(
        GRIPPER,
        -0.1,
        0.5,
        {GRIPPER: 0.014},
        max_travel=0.004,
    )
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    machine.start(
        replace(QUICK, runs=(run,)),
        arm.sample(),
    )
    drive(machine, arm, 100.0)
    (outcome,) = machine.outcomes
    assert outcome.ended_by == "travel"
    assert 0.004 <= outcome.travel < 0.005


def test_a_finger_that_meets_nothing_stops_before_its_limit() -> None:
    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    machine.start(load_sequence("paper_gripper", ROBOT), arm.sample())
    drive(machine, arm, 100.0)
    assert machine.phase is Phase.ABORTED
    assert machine.outcomes[-1].ended_by == "limit"
    assert arm.sample().position[GRIPPER] > ROBOT.model.joint(GRIPPER).lower


# ------------------------------------------------------------------------------------------------- all goes wrong


@dataclass
class Bench:
    """A machine in the middle of a run, with joints that are exactly where they should be."""

    machine: ExcitationMachine
    sample: JointSample

    def tick(self, later_s: float = 0.01, age_s: float = 0.0, **change: float) -> Command:
        """One tick with the positions of the last command; ``joint3=0.5`` moves a joint, ``joint3_v=1`` its velocity."""
        now_s = self.sample.time_s + later_s
        position = {
            **self.sample.position,
            **self.machine.command.position,
        }
        velocity = dict.fromkeys(JOINTS, 0.0)
        for name, value in change.items():
            if name.endswith("_v"):
                velocity[name[:-2]] = value
            else:
                position[name] = value
        self.sample = JointSample(now_s - age_s, position, velocity)
        return self.machine.tick(now_s, self.sample)


def bench(
    phase: Phase,
    sequence: ExcitationSequence = QUICK,
    pose: dict[str, float] = HOME,
    guards: Guards | None = None,
):
    machine = ExcitationMachine(ROBOT, guards)
    sample = JointSample(
        5.0,
        dict(pose),
        dict.fromkeys(JOINTS, 0.0),
    )
    machine.start(sequence, sample)
    ready = Bench(machine, sample)
    for _ in range(3000):
        if machine.phase is phase:
            return ready
        ready.tick()
    raise AssertionError(f"never reached {phase}: {machine.message}")


def assert_stopped(
    ready: Bench,
    command: Command,
    ended_by: str,
    words: str,
) -> None:
    machine = ready.machine
    check_command(machine, command, machine.phase)
    assert machine.phase is Phase.ABORTED
    assert not machine.busy
    assert command == machine.command
    assert words in machine.abort_reason
    assert machine.abort_reason in machine.message
    assert "\n" not in machine.message
    assert [(outcome.ended_by, outcome.used) for outcome in machine.outcomes] == [(ended_by, False)]
    # and it stays so, whatever comes
    assert (
        machine.tick(0.0, None)
        == command
        == machine.tick(math.nan, replace(ready.sample, time_s=1e9))
    )


def pushed(
    sequence: ExcitationSequence = QUICK,
    pose: dict[str, float] = HOME,
) -> Bench:
    ready = bench(Phase.PROBE, sequence, pose)
    assert ready.tick().current_A == {"joint3": -0.3}
    return ready


MISHAPS: dict[str, tuple[dict[str, float], str, str]] = {
    "ahead of the time": ({"age_s": -0.2}, "clock", "ahead of the time"),
    "the clock ran back": (
        {"later_s": -0.02, "age_s": -0.03},
        "clock",
        "ran back",
    ),
    "an old sample": ({"later_s": 0.01, "age_s": 0.05}, "clock", "older than"),
    "NaN": ({"joint2": math.nan}, "sample", "position of joint2 is nan"),
    "NaN velocity": ({"joint3_v": math.nan}, "sample", "velocity of joint3 is nan"),
    "a jump": (
        {"joint3": HOME["joint3"] - 0.35},
        "jump",
        "joint3 jumped by 0.35 rad",
    ),
    "too fast": ({"joint3_v": -6.5}, "velocity", "joint3 moves at 6.5 rad/s"),
    "another joint too fast": ({"joint1_v": 6.5}, "velocity", "joint1 moves"),
    "a finger too fast": (
        {"gripper_left_joint_v": 0.08},
        "velocity",
        "gripper_left_joint moves at 7.0",
    ),
    "a held joint": (
        {"joint2": HOME["joint2"] + 0.13},
        "held joint",
        "joint2 gave way by 0.13 rad",
    ),
}


@pytest.mark.parametrize("mishap", list(MISHAPS))
def test_the_current_ends_at_the_very_tick(mishap: str) -> None:
    change, ended_by, words = MISHAPS[mishap]
    ready = pushed()
    seen = {**ready.sample.position}
    command = ready.tick(**change)
    assert_stopped(ready, command, ended_by, words)
    # held where it was last seen for certain
    for name in JOINTS:
        assert command.position[name] in (seen[name], change.get(name))
        assert math.isfinite(command.position[name])


def assert_lost(ready: Bench, command: Command, words: str) -> None:
    """The current is gone at that very tick; the run is given up, but not yet the sequence."""
    machine = ready.machine
    check_command(machine, command, machine.phase)
    assert machine.phase is Phase.BRAKE
    assert not command.current_A
    assert words in machine.message
    assert [(outcome.ended_by, outcome.used) for outcome in machine.outcomes] == [("stale", False)]


def test_a_pause_of_the_loop_ends_the_current_and_the_run_is_repeated_as_it_was() -> None:
    ready = pushed()
    assert_lost(ready, ready.tick(later_s=0.11), "paused for 0.11 s")
    for _ in range(3000):
        command = ready.tick()
        if command.current_A:
            break
    assert command.current_A == {"joint3": -0.3}
    assert ready.machine.attempt == 2
    for _ in range(MOST_LOST_RUNS - 1):
        ready.tick(later_s=0.11)
        while not ready.tick().current_A:
            assert ready.machine.busy
    ready.tick(later_s=0.11)
    assert ready.machine.phase is Phase.ABORTED
    assert "paused" in ready.machine.abort_reason


def test_who_may_pause_for_long_under_a_current_may_without_one() -> None:
    ready = bench(Phase.APPROACH, guards=Guards(stale_after_s=4.0))
    ready.tick(later_s=3.5)
    assert ready.machine.busy
    ready = bench(Phase.APPROACH)
    ready.tick(later_s=1.5)
    assert ready.machine.aborted_by == "stale"


def test_no_sample_any_more() -> None:
    ready = pushed()
    last_s = ready.sample.time_s
    for n in range(1, 11):
        assert ready.machine.tick(last_s + 0.01 * n, None).current_A
    assert_lost(
        ready,
        ready.machine.tick(last_s + 0.11, None),
        "no new joint positions for 0.11 s",
    )
    for n in range(12, 100):
        assert ready.machine.tick(last_s + 0.01 * n, None).current_A == {}
    ready.machine.tick(last_s + 1.02, None)
    assert ready.machine.phase is Phase.ABORTED
    assert "is the driver alive?" in ready.machine.abort_reason


def test_samples_far_apart_lose_the_run_however_far_a_fast_joint_went_meanwhile() -> None:
    """A computer that stood still for a moment is no slipped encoder: at 4 rad/s a joint goes 0.44 rad in 0.11 s."""
    ready = pushed()
    start = ready.sample.position["joint3"]
    assert ready.machine.tick(ready.sample.time_s + 0.06, None).current_A
    position = {**ready.sample.position, "joint3": start - 0.44}
    late = JointSample(
        ready.sample.time_s + 0.11,
        position,
        {
            **ready.sample.velocity,
            "joint3": -4.4,
        },
    )
    command = ready.machine.tick(late.time_s, late)
    assert_lost(ready, command, "two samples are 0.11 s apart")
    assert command.position["joint3"] == start - 0.44, "held where it is now, not where it was"


@pytest.mark.parametrize(
    ("gap_s", "jump", "accepted"),
    [(0.02, 0.29, True), (0.02, 0.31, False), (0.09, 0.5, True), (0.09, 0.6, False)],
)
def test_a_jump_is_what_no_joint_can_do(gap_s: float, jump: float, accepted: bool) -> None:
    ready = pushed()
    moved = {
        **ready.sample.position,
        "joint3": ready.sample.position["joint3"] - jump,
    }
    sample = JointSample(
        ready.sample.time_s + gap_s,
        moved,
        dict.fromkeys(JOINTS, 0.0),
    )
    assert bool(ready.machine.tick(sample.time_s, sample).current_A) is accepted
    assert accepted or ready.machine.outcomes[-1].ended_by == "jump"
    said = (
        f"in {gap_s:.2f} s without a sample"
        if gap_s > 0.05
        else "between two samples: check its encoder"
    )
    assert accepted or said in ready.machine.abort_reason


@pytest.mark.parametrize(("apart_s", "accepted"), [(0.09, True), (0.02, False), (-5.0, False)])
def test_how_far_apart_positions_were_read_counts(apart_s: float, accepted: bool) -> None:
    """They came 9 ms apart, and had been read 90 ms apart by a computer that was busy: a fast joint is no slipped encoder."""
    ready = pushed()
    stamped = replace(ready.sample, time_s=ready.sample.time_s + 0.01, stamp_s=7.0)
    assert ready.machine.tick(stamped.time_s, stamped).current_A
    place = stamped.position["joint3"] - 0.43
    late = replace(
        stamped,
        time_s=stamped.time_s + 0.009,
        position={**stamped.position, "joint3": place},
        stamp_s=7.0 + apart_s,
    )
    assert bool(ready.machine.tick(late.time_s, late).current_A) is accepted
    assert accepted or ready.machine.outcomes[-1].ended_by == "jump"


def test_a_sample_that_is_repeated_grows_stale() -> None:
    ready = pushed()
    frozen = ready.sample
    for n in range(1, 11):
        assert ready.machine.tick(frozen.time_s + 0.01 * n, frozen).current_A
    assert_lost(
        ready,
        ready.machine.tick(frozen.time_s + 0.11, frozen),
        "no new joint positions",
    )


def test_a_sample_that_lacks_a_joint() -> None:
    ready = pushed()
    sample = replace(
        ready.sample,
        time_s=ready.sample.time_s + 0.01,
        position={"joint3": 0.4},
    )
    assert_stopped(
        ready,
        ready.machine.tick(sample.time_s, sample),
        "sample",
        "lacks the position of joint1, joint2",
    )


def test_a_limit_ahead() -> None:
    pose = {**HOME, "joint2": 0.0, "joint3": -1.2}
    ready = pushed(pose=pose)
    limit = ROBOT.model.joint("joint3").lower
    # 0.07 rad left, 0.05 are asked for
    assert ready.tick(joint3=limit + 0.15, joint3_v=-1.0).current_A
    command = ready.tick(joint3=limit + 0.14, joint3_v=-1.2)
    assert_stopped(
        ready, command, "limit", "joint3 was about to reach its limit -1.5: use less current"
    )
    assert command.position["joint3"] == limit + 0.14


def test_a_limit_that_the_load_pulls_to() -> None:
    ready = pushed(pose={**HOME, "joint3": 1.2})
    assert_stopped(
        ready,
        ready.tick(joint3=1.25, joint3_v=1.5),
        "limit",
        "its load pulls it there against the current",
    )


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_moving_away_from_a_limit_is_no_reason_to_stop(way: float) -> None:
    joint = ROBOT.model.joint("joint3")
    near = joint.upper - 0.04 if way < 0.0 else joint.lower + 0.04
    ready = pushed(pose={**HOME, "joint2": -1.0 if way < 0.0 else 0.0, "joint3": near})
    assert ready.tick(joint3=near + 0.01 * way, joint3_v=0.1 * way).current_A
    assert ready.tick(joint3=near + 0.01 * way, joint3_v=-0.1 * way).current_A == {}


def test_the_table_ahead() -> None:
    pose = {
        **HOME,
        "joint2": 0.0,
        "joint3": 0.45,
        "joint4": 0.0,
    }
    low = clearance(ROBOT, pose)
    sequence = replace(QUICK, min_clearance_m=low - 0.03)
    ready = pushed(sequence, pose)
    assert ready.tick(joint3=0.5, joint3_v=0.2).current_A
    assert_stopped(
        ready, ready.tick(joint3=0.51, joint3_v=1.5), "clearance", "above the base's plane"
    )
    rising = pushed(sequence, pose)
    assert_stopped(
        rising, rising.tick(joint3=0.65, joint3_v=-3.0), "clearance", "above the base's plane"
    )
    slow = pushed(sequence, pose)
    assert_stopped(
        slow, slow.tick(joint3=0.65, joint3_v=0.0), "clearance", "above the base's plane"
    )


def test_abort_holds_at_once() -> None:
    ready = pushed()
    ready.tick(joint3=0.35)
    ready.machine.abort("the user asked for it")
    assert ready.machine.command.position["joint3"] == 0.35
    assert_stopped(ready, ready.machine.command, "abort", "the user asked for it")


def test_abort_without_a_sequence_does_nothing() -> None:
    machine = ExcitationMachine(ROBOT)
    machine.abort("nothing")
    assert machine.phase is Phase.IDLE
    assert machine.tick(1.0, None) == Command()
    assert machine.run_number == 0


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.SETTLE, Phase.BRAKE, Phase.RETURN])
def test_a_joint_that_does_not_follow(phase: Phase) -> None:
    sequence = replace(
        QUICK,
        runs=(
            ExcitationRun(
                "joint3",
                -0.3,
                0.2,
                {"joint3": 0.6},
            ),
        ),
        settle_s=1.0,
        brake_s=1.0,
        home=HOME,
    )
    ready = bench(phase, replace(sequence, approach_velocity=0.1))
    goal = ready.machine.command.position["joint1"]
    late = 0
    while ready.machine.busy:
        assert ready.machine.phase is phase
        assert not ready.tick(joint1=goal + 0.16).current_A
        late += 1
    assert 50 <= late <= 52  # 0.5 s
    assert (
        "joint1 does not follow: is something in its way, its load too heavy, or torque off?"
        in ready.machine.abort_reason
    )
    assert all(outcome.used for outcome in ready.machine.outcomes)


def test_a_short_lag_is_forgiven() -> None:
    ready = bench(Phase.SETTLE, replace(QUICK, settle_s=3.0))
    for n in range(200):
        assert not ready.tick(joint1=HOME["joint1"] + (0.16 if n % 40 else 0.0)).current_A
    assert ready.machine.phase is Phase.SETTLE


@pytest.mark.parametrize("late_s", [0.05, 0.2])
def test_a_joint_that_follows_late_is_waited_for(late_s: float) -> None:
    """Behind a slow controller a joint is where its goal was; goals that went on as if it were there were given up after 0.5 s."""
    machine = ExcitationMachine(ROBOT)
    sample = Arm(HOME).sample()
    machine.start(
        replace(
            QUICK,
            runs=(
                ExcitationRun(
                    "joint3",
                    -0.3,
                    0.2,
                    {"joint1": 1.6},
                ),
            ),
            approach_velocity=1.5,
        ),
        sample,
    )
    sent = [HOME] * (1 + round(late_s / 0.01))
    behind_rad = 0.0
    took_s = 0.0
    while machine.phase in (Phase.IDLE, Phase.APPROACH):
        sample = JointSample(
            sample.time_s + 0.01, sent[-1 - round(late_s / 0.01)], dict.fromkeys(JOINTS, 0.0)
        )
        sent.append(machine.tick(sample.time_s, sample).position)
        behind_rad = max(
            behind_rad,
            sent[-1]["joint1"] - sample.position["joint1"],
        )
        took_s += 0.01
    assert machine.phase is Phase.SETTLE, machine.abort_reason
    assert behind_rad < 1.5 * Guards().follow_error_rad
    assert (took_s > 2.0) == (late_s > 0.1), "who follows soon is not waited for"


@pytest.mark.parametrize(
    "unrest",
    [lambda t_s: 0.025 * t_s, lambda t_s: 0.01 * math.sin(20.0 * t_s)],
    ids=["creeps", "shakes"],
)
def test_a_joint_that_never_rests(unrest: Callable[[float], float]) -> None:
    ready = bench(Phase.SETTLE)
    started_s = ready.sample.time_s
    while ready.machine.busy:
        assert not ready.tick(
            joint3=HOME["joint3"] + unrest(ready.sample.time_s - started_s)
        ).current_A
    assert ready.sample.time_s - started_s == pytest.approx(0.3 + 2.0, abs=0.03)
    assert "joint3 does not come to rest" in ready.machine.abort_reason
    assert not ready.machine.outcomes


def test_an_arm_that_is_pushed_and_one_that_is_limp() -> None:
    def push(arm: Arm) -> None:
        arm.external = {"joint2": 8.0} if machine.phase is Phase.PROBE else {}

    machine = ExcitationMachine(ROBOT)
    arm = Arm(HOME)
    machine.start(QUICK, arm.sample())
    drive(machine, arm, 100.0, push)
    assert machine.outcomes[-1].ended_by == "held joint"
    assert "joint2 gave way" in machine.abort_reason

    machine = ExcitationMachine(ROBOT)
    limp = Arm(HOME, friction=1.0)
    limp.STIFFNESS = limp.DAMPING = 0.0
    machine.start(
        replace(
            QUICK,
            runs=(
                ExcitationRun(
                    "joint3",
                    -0.3,
                    0.6,
                    {"joint1": 1.0},
                ),
            ),
        ),
        limp.sample(),
    )
    drive(machine, limp, 100.0)
    assert "joint1 does not follow" in machine.abort_reason
    assert not machine.outcomes


# ---------------------------------------------------------------------------------------------------------- start


def sample_at(**change: float) -> JointSample:
    return JointSample(
        1.0,
        {**HOME, **change},
        dict.fromkeys(JOINTS, 0.0),
    )


def test_what_cannot_start() -> None:
    machine = ExcitationMachine(ROBOT)
    good = sample_at()
    for sample, words in (
        (replace(good, position={"joint1": 0.0}), "lacks the position of joint2"),
        (replace(good, velocity={}), "lacks the velocity of joint1"),
        (sample_at(joint2=math.nan), "position of joint2 is nan"),
        (replace(good, time_s=math.inf), "time stamp inf"),
        (sample_at(joint3=1.6), "joint3 reads 1.6, outside its limits -1.5 .. 1.4"),
        (sample_at(gripper_left_joint=0.4), "gripper_left_joint reads 0.4"),
    ):
        with pytest.raises(ExcitationError, match=words) as caught:
            machine.start(QUICK, sample)
        assert "\n" not in str(caught.value)
        assert machine.phase is Phase.IDLE
    machine.start(QUICK, good)
    with pytest.raises(ExcitationError, match="quick is under way"):
        machine.start(QUICK, good)
    machine.abort("enough")
    machine.start(QUICK, good)
    assert machine.busy
    assert machine.abort_reason == ""
    assert machine.outcomes == []


def lowest_goal(
    sequence: ExcitationSequence,
    pose: dict[str, float],
) -> float:
    """Lowest clearance of all goals of the approach."""
    ready = bench(Phase.SETTLE, sequence, pose)
    machine = ExcitationMachine(ROBOT)
    machine.start(
        sequence,
        JointSample(
            5.0,
            dict(pose),
            dict.fromkeys(JOINTS, 0.0),
        ),
    )
    again = Bench(
        machine,
        JointSample(
            5.0,
            dict(pose),
            dict.fromkeys(JOINTS, 0.0),
        ),
    )
    heights = []
    while machine.phase is Phase.APPROACH:
        heights.append(clearance(ROBOT, again.tick().position))
    assert machine.command == ready.machine.command
    return min(heights)


def test_the_way_leads_over_a_higher_pose_where_the_straight_one_dips() -> None:
    before = {
        **HOME,
        "joint1": 0.0,
        "joint2": 0.3,
        "joint3": -0.1,
        "joint4": -1.0,
    }
    after = {"joint2": -0.1, "joint3": 0.7, "joint4": 1.7}
    straight = [
        clearance(ROBOT, {**before, **{name: before[name] + n / 50 * (goal - before[name]) for name, goal in after.items()}})
        for n in range(51)
    ]  # fmt: skip
    assert min(straight) < 0.03 < min(straight[0], straight[-1])
    sequence = replace(
        QUICK,
        runs=(ExcitationRun("joint3", -0.3, 0.6, after),),
    )
    assert lowest_goal(sequence, before) >= 0.029


def test_an_arm_that_lies_on_the_table_may_only_rise() -> None:
    lying = {
        **HOME,
        "joint2": 1.0,
        "joint3": 0.6,
        "joint4": 0.2,
    }
    assert clearance(ROBOT, lying) < 0.03
    rising = replace(
        QUICK,
        runs=(
            ExcitationRun(
                "joint3",
                -0.3,
                0.6,
                {"joint2": -0.5, "joint3": 0.5, "joint4": 0.0},
            ),
        ),
    )
    assert lowest_goal(rising, lying) >= clearance(ROBOT, lying) - 1e-3
    staying = replace(
        QUICK,
        runs=(ExcitationRun(GRIPPER, -0.1, 0.5),),
    )
    with pytest.raises(ExcitationError, match="higher pose by hand"):
        ExcitationMachine(ROBOT).start(
            staying,
            JointSample(0.0, lying, dict.fromkeys(JOINTS, 0.0)),
        )


def test_the_same_inputs_give_the_same_commands() -> None:
    def commands() -> list[Command]:
        machine = ExcitationMachine(ROBOT)
        arm = Arm(HOME)
        machine.start(load_sequence("paper_wrist", ROBOT), arm.sample())
        return [tick.command for tick in drive(machine, arm, 40.0)]

    assert commands() == commands()


# -------------------------------------------------------------------------------------------------- come what may

DISTURBANCES = st.sampled_from(
    ["none"] * 12
    + ["drift"] * 4
    + ["nan", "jump", "fast", "missing", "late", "back", "abort", "start", "no sample"]
)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(DISTURBANCES, st.sampled_from(JOINTS), st.floats(-1.0, 1.0)),
        min_size=50,
        max_size=120,
    ),
    st.sampled_from([0.01, 0.025]),
)
def test_no_current_but_in_a_run_and_never_above_the_limit(
    steps: list[tuple[str, str, float]], tick_s: float
) -> None:
    run = ExcitationRun(
        "joint3",
        -0.3,
        0.2,
        {},
        0.5,
        0.3,
        2.0,
        0.9,
    )
    sequence = ExcitationSequence(
        "any", "any", (run, replace(run, joint="joint2")), settle_s=0.05, brake_s=0.05
    )
    machine = ExcitationMachine(ROBOT)
    now_s = 3.0
    position = dict(HOME)
    velocity = dict.fromkeys(JOINTS, 0.0)
    machine.start(
        sequence,
        JointSample(now_s, dict(position), dict(velocity)),
    )
    for kind, joint, size in steps:
        now_s += {"late": 0.2, "back": -0.05}.get(
            kind,
            tick_s,
        )
        position.update(machine.command.position)
        if kind == "drift":
            position[joint] += 0.1 * size * ROBOT.drive_trains[joint].transmission
        seen = dict(position)
        speeds = dict(velocity)
        if kind == "nan":
            seen[joint] = math.nan
        elif kind == "jump":
            seen[joint] += 2.0 * size
        elif kind == "fast":
            speeds[joint] = 20.0 * size
        elif kind == "missing":
            del seen[joint]
        elif kind == "abort":
            machine.abort("at random")
        elif kind == "start" and not machine.busy:
            machine.start(sequence, JointSample(now_s, dict(HOME), speeds))
        command = machine.tick(
            now_s, None if kind == "no sample" else JointSample(now_s, seen, speeds)
        )
        check_command(machine, command, machine.phase)
        if kind in ("nan", "missing", "abort", "back", "late"):
            assert not command.current_A
    assert 0.0 <= machine.fraction <= 1.0


def test_random_disturbances_do_meet_a_current() -> None:
    """The test above says something: undisturbed, its sequence is under current within fifty ticks."""
    run = ExcitationRun(
        "joint3",
        -0.3,
        0.2,
        {},
        0.5,
        0.3,
        2.0,
        0.9,
    )
    sequence = ExcitationSequence(
        "any", "any", (run, replace(run, joint="joint2")), settle_s=0.05, brake_s=0.05
    )
    ready = bench(Phase.PROBE, sequence)
    assert ready.sample.time_s - 5.0 < 50 * 0.01 + 0.1


def test_another_robot() -> None:
    """One joint that turns without limits, from a file of its own."""
    robot: Robot = load_robot("pendulum")
    (joint,) = robot.drive_trains
    run = ExcitationRun(joint, 0.1, 0.3, {joint: 0.5})
    machine = ExcitationMachine(robot)
    sequence = ExcitationSequence(
        "swing",
        "any",
        (run,),
        settle_s=0.3,
        min_clearance_m=0.0,
    )
    assert sequence.runs[0].max_travel == 1.0
    machine.start(
        sequence,
        JointSample(0.0, {joint: 0.0}, {joint: 0.0}),
    )
    now_s = 0.0
    command = machine.command
    while machine.busy and now_s < 20.0:
        now_s += 0.025
        place = command.position.get(joint, 0.5)
        command = machine.tick(
            now_s,
            JointSample(now_s, {joint: place}, {joint: 0.0}),
        )
    assert machine.phase is Phase.DONE, machine.message
