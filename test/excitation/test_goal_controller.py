"""What a position controller is sent, and what the state machine makes of goal steps on virtual servos."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.commands import Command, JointStates
from proprio_ros.excitation.effort_controller import EffortController
from proprio_ros.excitation.goal_controller import LARGEST_SUM_RAD, GoalController
from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence, as_text, load_sequence
from proprio_ros.robot import load_robot
from proprio_ros.virtual.effort_driver import PositionDriver
from proprio_ros.virtual.objects import Payload
from proprio_ros.virtual.truth import Truth

ROBOT = load_robot("so101")
JOINTS = tuple(ROBOT.drive_trains)
ORDER = ("gripper", "elbow_flex", "shoulder_pan", "wrist_roll", "wrist_flex", "shoulder_lift")
POSE = {
    **dict.fromkeys(JOINTS, 0.0),
    "shoulder_lift": -0.4,
    "elbow_flex": 0.2,
    "wrist_flex": 0.3,
    "gripper": 0.2,
}
PUSH = ExcitationRun("elbow_flex", 0.0, 0.4, goal_step=-0.25)
QUICK = ExcitationSequence(
    "quick",
    "any",
    (PUSH,),
    settle_s=0.3,
    brake_s=0.2,
)


def held() -> GoalController:
    controller = GoalController(ROBOT, ORDER)
    controller.observe(1.0, {**POSE, "wheel": 3.0})
    controller.begin()
    return controller


def stepped(step: float) -> Command:
    held = {name: q for name, q in POSE.items() if name != "elbow_flex"}
    return Command(held, stepped={"elbow_flex": POSE["elbow_flex"] + step})


# --------------------------------------------------------------------------------------------------------- what is sent


def test_goals_are_whole_in_the_controllers_order_and_ahead_by_what_gravity_takes() -> None:
    controller = held()
    ahead = dict(zip(ORDER, controller.commands(), strict=True))
    assert ahead["shoulder_pan"] == pytest.approx(0.0, abs=1e-9)
    # 0.45 N m of forearm at 8.9 N m/rad
    assert ahead["elbow_flex"] - POSE["elbow_flex"] == pytest.approx(-0.05, abs=0.015)
    before = controller.commands()
    controller.take(stepped(-0.25))
    moved = np.subtract(controller.commands(), before)
    np.testing.assert_allclose(
        moved, [-0.25 * (name == "elbow_flex") for name in ORDER], atol=1e-12
    )
    for command in (
        Command(),
        Command(dict(POSE)),
        Command({"elbow_flex": math.nan}),
        Command({}, {"elbow_flex": 0.1}),
    ):
        controller.take(command)
        assert len(controller.commands()) == len(ORDER)
        assert np.isfinite(controller.commands()).all()


def test_the_record_is_what_was_sent_and_only_while_it_holds() -> None:
    controller = GoalController(ROBOT, ORDER)
    controller.observe(1.0, POSE)
    assert controller.record == {}, "somebody else may hold the arm elsewhere"
    controller.begin()
    controller.take(stepped(-0.25))
    sent = controller.commands()
    assert controller.record == dict(zip(ORDER, sent, strict=True))
    controller.release()
    assert controller.record == {}


def test_the_holding_command_holds_a_pushed_joint_where_it_was_seen() -> None:
    controller = held()
    still = dict(zip(ORDER, controller.holding_command(), strict=True))
    controller.take(stepped(-0.25))
    controller.observe(1.1, {**POSE, "elbow_flex": 0.1})
    last = dict(zip(ORDER, controller.holding_command(), strict=True))
    assert last["elbow_flex"] - still["elbow_flex"] == pytest.approx(-0.1)
    assert {name: last[name] for name in ORDER if name != "elbow_flex"} == {
        name: still[name] for name in ORDER if name != "elbow_flex"
    }
    # gravity of the other place
    assert controller.steady() == pytest.approx(list(last.values()), abs=0.01)
    assert controller.release() == controller.steady()


def test_what_hangs_in_the_hand_is_summed_up_at_rest_and_not_in_a_push() -> None:
    controller = held()
    sags = {**POSE, "elbow_flex": 0.3}
    for step in range(30):
        controller.observe(1.0 + step / 30.0, sags)
    summed = controller.commands()[1]
    assert summed < POSE["elbow_flex"] - 0.15
    controller.take(stepped(0.1))
    pushed = controller.commands()[1]
    for step in range(30, 60):
        controller.observe(1.0 + step / 30.0, sags)
    assert controller.commands()[1] == pushed
    controller.take(Command(dict(POSE)))
    for step in range(60, 2000):
        controller.observe(1.0 + step / 30.0, sags)
    assert controller.commands()[1] > POSE["elbow_flex"] - LARGEST_SUM_RAD - 0.1, "but no further"


def test_goals_stay_within_limits_and_an_encoder_that_slipped_is_followed() -> None:
    controller = held()
    upper = ROBOT.model.joint("elbow_flex").upper
    controller.take(Command({**POSE, "elbow_flex": upper + 0.2}))
    assert controller.commands()[1] == upper
    slipped = {**POSE, "wrist_flex": 1.0}
    controller.observe(1.1, slipped)
    controller.take_here()
    assert controller.commands()[4] == pytest.approx(1.0, abs=0.05)


def effort_controller() -> EffortController:
    controller = EffortController(ROBOT, ORDER, "N.m")
    for step in range(100):
        controller.observe(0.5 + 0.005 * step, POSE)
    return controller


@pytest.mark.parametrize("controller", [held, effort_controller])
def test_nothing_is_pushed_after_an_encoder_has_slipped(
    controller: Callable[[], GoalController | EffortController],
) -> None:
    """Whoever holds the arm follows what it reads; a sequence after it would push it elsewhere, and be weighed there."""
    made = controller()
    sequence = (
        QUICK
        if isinstance(made, GoalController)
        else replace(QUICK, runs=(ExcitationRun("elbow_flex", 0.2, 0.4),))
    )
    slipped = {**POSE, "wrist_flex": POSE["wrist_flex"] - 0.6}
    for time_s, position in ((1.0, POSE), (1.005, slipped), (1.01, POSE), (1.015, POSE)):
        made.observe(time_s, position)
    made.check(sequence)  # one wrong reading
    for step in range(100):
        made.observe(1.1 + 0.005 * step, slipped)
    with pytest.raises(
        ExcitationError, match=r"the encoder of wrist_flex jumped by -0.60: .* call ~/release"
    ):
        made.check(sequence)
    made.slipped.clear()  # as ~/release does
    made.check(sequence)
    made.observe(2.1, POSE)  # half a second later: somebody may have moved it there
    made.observe(1.0, slipped)  # the clock was set
    # its driver counts turns anew
    made.observe(
        1.005,
        {**slipped, "shoulder_pan": POSE["shoulder_pan"] + math.tau - 0.01},
    )
    assert not made.slipped


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ((), "state the position controller's `joints`"),
        (("joint9",), "does not drive"),
        (("gripper", "gripper"), "twice"),
    ],
)
def test_a_controller_that_cannot_be_is_refused(
    joints: tuple[str, ...],
    words: str,
) -> None:
    with pytest.raises(ConfigurationError, match=words):
        GoalController(ROBOT, joints)


def test_currents_are_for_others_and_goals_not_for_them() -> None:
    with pytest.raises(ExcitationError, match="state goal_step"):
        held().check(replace(QUICK, runs=(ExcitationRun("elbow_flex", -0.3, 0.4),)))
    with pytest.raises(ExcitationError, match="moves elbow_flex, which the position controller"):
        GoalController(ROBOT, ["gripper"]).check(QUICK)
    held().check(QUICK)
    arm = load_robot("open_manipulator_x")
    with pytest.raises(ExcitationError, match="an effort controller does not take"):
        EffortController(arm, ["joint3"], "A").check(
            replace(QUICK, runs=(replace(PUSH, joint="joint3"),))
        )


# ---------------------------------------------------------------------------------------------------------- sequences


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ({"current_A": -0.1}, "a goal_step and a current"),
        ({"shake_A": 0.1}, "a goal_step and a current"),
        ({"goal_step": 15.0}, "it is in rad"),
        ({"start": {"elbow_flex": -1.5}}, "with goal_step: elbow_flex=-1.75 is outside"),
        (
            {"start": {"shoulder_lift": -0.2, "elbow_flex": 0.5}, "goal_step": 0.6},
            "with goal_step: the arm would be",
        ),
    ],
)
def test_steps_that_no_servo_should_make_are_refused(
    tmp_path: Any, run: dict[str, Any], words: str
) -> None:
    given = {
        "joint": "elbow_flex",
        "duration_s": 0.4,
        "goal_step": -0.25,
        **run,
    }
    path = tmp_path / "steps.yaml"
    path.write_text(f"excitation: {{hand: any, min_clearance_m: 0.05, runs: [{given}]}}")
    with pytest.raises(ConfigurationError, match=words):
        load_sequence(path, ROBOT)


def test_a_sequence_of_steps_comes_back_from_its_text() -> None:
    sequence = load_sequence("so101_payload", ROBOT)
    assert all(run.goal_step and not run.is_free_response for run in sequence.runs)
    assert load_sequence(as_text(sequence), ROBOT).runs == sequence.runs


# -------------------------------------------------------------------------------------------------- on virtual servos


class Arm:
    """State machine, controller and virtual servos, 30 times a second on a clock of the test's own."""

    def __init__(
        self,
        sequence: ExcitationSequence = QUICK,
        payload_kg: float = 0.0,
    ) -> None:
        pytest.importorskip("mujoco")
        self.driver = PositionDriver(
            ROBOT,
            Truth.draw(ROBOT, 1),
            joints=ORDER,
            position=POSE,
        )
        if payload_kg:
            self.put_into_hand(payload_kg)
        self.machine = ExcitationMachine(ROBOT)
        self.controller = GoalController(ROBOT, ORDER)
        self.states = JointStates(JOINTS, self.machine.guards.stale_after_s)
        self.time_s = 10.0
        self.goals = [0.0]
        self.sample = self.seen()
        self.machine.start(sequence, self.sample)
        self.controller.begin()

    def put_into_hand(self, mass_kg: float) -> None:
        self.driver.hold(Payload(mass_kg))

    def seen(self) -> Any:
        self.driver.advance(self.time_s)
        positions, _, _ = self.driver.states()
        self.read = dict(zip(self.driver.broadcast, positions, strict=True))
        self.controller.observe(self.time_s, self.read)
        return self.states.add(
            self.time_s,
            list(self.read),
            list(self.read.values()),
        )

    def tick(self, heard: bool = True) -> None:
        self.time_s += 1.0 / 30.0
        if heard:
            self.sample = self.seen()
        self.controller.take(self.machine.tick(self.time_s, self.sample))
        self.goals = self.controller.commands()
        assert self.driver.command(self.time_s, self.goals)

    def until(self, phase: Phase) -> None:
        for _ in range(600):
            if self.machine.phase is phase:
                return
            self.tick()
        raise AssertionError((phase, self.machine.phase, self.machine.message))

    def assert_held(self) -> None:
        for _ in range(60):
            self.tick()
        before = self.driver.arm.position()
        for _ in range(15):
            self.tick()
        after = self.driver.arm.position()
        assert max(abs(after[name] - before[name]) for name in after) < 0.005
        goals = dict(zip(ORDER, self.goals, strict=True))
        assert all(abs(goals[name] - after[name]) < 0.25 for name in after), "near where it is"


@pytest.mark.long
def test_a_step_pushes_and_at_its_end_the_joint_is_held_where_it_is() -> None:
    arm = Arm()
    arm.until(Phase.PROBE)
    before = arm.driver.arm.position()["elbow_flex"]
    arm.until(Phase.BRAKE)
    seen = arm.machine.command.position["elbow_flex"]
    assert seen == pytest.approx(arm.sample.position["elbow_flex"], abs=0.02)
    assert seen < before - 0.1
    arm.until(Phase.DONE)
    assert [(outcome.ended_by, outcome.used) for outcome in arm.machine.outcomes] == [
        ("time", True)
    ]
    arm.assert_held()


@pytest.mark.long
def test_travel_ends_a_step_and_one_that_moves_too_little_is_not_made_again() -> None:
    arm = Arm(
        replace(
            QUICK,
            runs=(
                replace(PUSH, max_travel=0.1),
                replace(
                    PUSH,
                    goal_step=-0.02,
                    min_travel=0.2,
                ),
            ),
        )
    )
    arm.until(Phase.DONE)
    assert [(outcome.ended_by, outcome.used) for outcome in arm.machine.outcomes] == [
        ("travel", True),
        ("time", False),
    ]
    assert "allow a larger goal_step" in arm.machine.message


@pytest.mark.long
def test_an_abort_in_a_step_holds_the_arm_where_it_is() -> None:
    arm = Arm()
    arm.until(Phase.PROBE)
    arm.tick()
    arm.tick()
    arm.machine.abort("by a test")
    assert not arm.machine.command.stepped
    arm.assert_held()


@pytest.mark.long
def test_a_joint_that_is_too_fast_or_gives_way_ends_it() -> None:
    arm = Arm()
    arm.until(Phase.PROBE)
    arm.machine.guards = replace(arm.machine.guards, max_velocity_rad_s=0.5)
    arm.until(Phase.ABORTED)
    assert arm.machine.aborted_by == "velocity"
    arm.assert_held()
    arm = Arm()
    arm.until(Phase.PROBE)
    arm.put_into_hand(1.0)
    arm.until(Phase.ABORTED)
    assert arm.machine.aborted_by == "held joint"
    assert "gave way" in arm.machine.abort_reason


@pytest.mark.long
def test_lost_joint_states_end_a_step() -> None:
    arm = Arm()
    arm.until(Phase.PROBE)
    arm.tick()
    for _ in range(6):
        arm.tick(heard=False)
    assert arm.machine.phase is Phase.BRAKE
    assert arm.machine.outcomes[-1].ended_by == "stale"
    assert not arm.machine.command.stepped


@pytest.mark.long
def test_a_start_whose_goal_is_no_place_for_the_arm_is_refused_before_anything_moves() -> None:
    low = ROBOT.model.joint("elbow_flex").lower
    arm = Arm()
    arm.machine.abort("by a test")
    for start, step, words in (
        ({"elbow_flex": low + 0.2}, -0.25, "its goal would be -1.74, outside"),
        ({"shoulder_lift": -0.2, "elbow_flex": 0.5}, 0.6, "come too near"),
    ):
        run = replace(PUSH, goal_step=step)
        sample = replace(arm.sample, position={**POSE, **start})
        with pytest.raises(ExcitationError, match=words):
            arm.machine.start(
                replace(QUICK, runs=(run,), min_clearance_m=0.05),
                sample,
            )


@pytest.mark.long
def test_a_load_that_the_urdf_does_not_know_is_carried() -> None:
    arm = Arm(replace(QUICK, settle_s=0.6), payload_kg=0.3)
    arm.until(Phase.DONE)
    assert abs(arm.driver.arm.position()["shoulder_lift"] - POSE["shoulder_lift"]) < 0.05
    arm.assert_held()
