"""What an effort controller is sent: whole commands, in its order and unit."""

from __future__ import annotations

import pytest

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.effort_controller import EffortController
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence
from proprio_ros.excitation.remote_clock import RemoteClock
from proprio_ros.robot import load_robot

ROBOT = load_robot("open_manipulator_x")
GRIPPER = "gripper_left_joint"
ORDER = ("joint4", GRIPPER, "joint1", "joint3", "joint2")
POSE = {
    "joint1": 0.0,
    "joint2": -0.6,
    "joint3": 0.4,
    "joint4": 0.2,
    GRIPPER: 0.005,
}
TORQUE = {name: drive.nominal_effort_per_current for name, drive in ROBOT.drive_trains.items()}


def held(
    unit: str = "N.m",
    joints: tuple[str, ...] = ORDER,
    rate_hz: float = 500.0,
) -> EffortController:
    controller = EffortController(ROBOT, joints, unit)
    for step in range(200):
        controller.observe(
            1.0 + step / rate_hz,
            {**POSE, "wheel": 3.0},
        )
    controller.begin()
    controller.take(Command(dict(POSE)))
    return controller


def push(joint: str, current_A: float) -> Command:
    return Command(
        {name: q for name, q in POSE.items() if name != joint},
        {joint: current_A},
    )


@pytest.mark.parametrize("joint", ["joint3", GRIPPER])
def test_a_push_has_the_effort_of_its_current_in_its_place(joint: str) -> None:
    torque = held("N.m")
    current = held("A")
    for controller in (torque, current):
        controller.take(push(joint, -0.3))
    by_torque = torque.commands()
    by_current = current.commands()
    assert by_torque[ORDER.index(joint)] == pytest.approx(-0.3 * TORQUE[joint])
    assert by_current[ORDER.index(joint)] == pytest.approx(-0.3)
    for name, newton, ampere in zip(ORDER, by_torque, by_current, strict=True):
        assert newton == pytest.approx(ampere * TORQUE[name])
    assert by_torque[ORDER.index("joint2")] < -0.2, "the others are held"


def test_every_command_is_whole() -> None:
    controller = held()
    for command in (
        Command(),
        Command(dict(POSE)),
        push("joint3", 0.1),
        Command({}, {"joint3": 0.1}),
    ):
        controller.take(command)
        assert len(controller.commands()) == len(ORDER)
    assert len(controller.steady()) == len(controller.release()) == len(ORDER)


def test_the_record_says_what_pushes_and_nothing_else() -> None:
    controller = held("A")
    assert controller.record == dict.fromkeys(ROBOT.drive_trains, 0.0), (
        "as this package's driver says of held joints"
    )
    controller.take(push("joint3", -0.3))
    assert controller.record["joint3"] == pytest.approx(-0.3 * TORQUE["joint3"])
    assert sum(effort != 0.0 for effort in controller.record.values()) == 1
    controller.steady()
    assert not any(controller.record.values()), "who does not see the arm does not push it"


def test_a_push_ends_when_the_arm_is_lost() -> None:
    controller = held()
    controller.take(push("joint3", -0.3))
    for step in range(1, 60):
        controller.observe(
            2.0 + 0.1 * step,
            {**POSE, "joint1": 0.01 * step},
        )
    assert controller.commands() == [0.0] * len(ORDER)
    assert controller.lost
    assert not any(controller.record.values())
    assert controller.steady() == [0.0] * len(ORDER), "also where it was lost before it was held"
    controller.begin()
    assert not controller.lost
    assert any(controller.commands())


def test_a_second_sequence_does_not_drop_what_is_held() -> None:
    controller = held()
    controller.take(Command({**POSE, "joint2": POSE["joint2"] - 0.02}))
    for step in range(100):
        controller.observe(1.4 + 0.002 * step, POSE)
        controller.commands()
    summed = controller.steady()
    controller.begin()
    assert controller.steady() == summed
    controller.release()
    controller.begin()
    assert controller.steady() != summed


def test_before_the_first_sequence_and_after_release_nothing_is_held() -> None:
    controller = EffortController(ROBOT, ORDER, "N.m")
    controller.take(push("joint3", -0.3))
    assert not controller.holding
    assert not any(controller.record.values())
    held_one = held()
    assert held_one.release() == [0.0] * len(ORDER)
    assert not held_one.holding


def test_what_cannot_be_made_is_refused() -> None:
    arm = ("joint1", "joint2", "joint3", "joint4")
    grip = ExcitationSequence(
        "grip",
        "any",
        (ExcitationRun(GRIPPER, 0.1, 0.5),),
    )
    with pytest.raises(
        ExcitationError, match=f"grip moves {GRIPPER}, which the effort controller does not have"
    ):
        held(joints=arm).check(grip)
    lift = ExcitationSequence(
        "lift",
        "any",
        (ExcitationRun("joint3", 0.1, 0.5),),
    )
    held(joints=arm).check(lift)
    with pytest.raises(ExcitationError, match="joint states come 40 times a second"):
        held(rate_hz=40.0).check(lift)
    with pytest.raises(ExcitationError, match="joint states come 0 times a second"):
        EffortController(ROBOT, arm, "A").check(lift)


@pytest.mark.parametrize(
    ("joints", "unit", "words"),
    [
        ((), "A", "controller_joints is empty"),
        (("joint1", "wheel"), "A", "does not drive wheel"),
        (("joint1", "joint1"), "A", "names a joint twice"),
        (("joint1",), "mA", "effort_unit='mA': choose one of N.m, A"),
    ],
)
def test_what_is_stated_wrong_is_named(
    joints: tuple[str, ...],
    unit: str,
    words: str,
) -> None:
    with pytest.raises(ConfigurationError, match=words):
        EffortController(ROBOT, joints, unit)


def test_joint_states_in_bursts_are_refused_and_one_late_one_is_not() -> None:
    lift = ExcitationSequence(
        "lift",
        "any",
        (ExcitationRun("joint3", 0.1, 0.5),),
    )
    controller = held()
    controller.observe(1.45, POSE)
    for step in range(20):
        controller.observe(1.45 + 0.002 * step, POSE)
    controller.check(lift)
    for step in range(500):
        stamp_s = 2.0 + 0.002 * step
        controller.observe(
            stamp_s,
            POSE,
            heard_s=2.0 + 0.04 * (1 + step // 20),
        )
    with pytest.raises(ExcitationError, match="joint states come in bursts"):
        controller.check(lift)


def test_commands_are_stamped_on_the_clock_of_the_joint_states_however_late_these_come() -> None:
    clock = RemoteClock()
    assert clock.at(5) == 5
    late_ms = [
        7,
        3,
        9,
        1,
        12,
        4,
        8,
        15,
    ]
    for step, late in enumerate(late_ms):
        clock.hear(
            10**12 + 2_000_000 * step,
            2_000_000 * step + 1_000_000 * late,
        )
    now_ns = 2_000_000 * 10
    assert clock.at(now_ns) == pytest.approx(10**12 + now_ns - 1_000_000, abs=10_000), (
        "as late as the least late"
    )
    clock.hear(5 * 10**12, now_ns)
    assert clock.at(now_ns) == 5 * 10**12, "a clock that was set"
