"""The virtual arm against closed forms, against the robot's own kinematics, and in a twin experiment.

Statics: the torque that holds an arm is the derivative of its potential energy, taken here by central differences (steps of
1e-5 rad: errors of 1e-10 N m) of the links' heights. Kinetic energy is ``tr(Tdot P Tdot^T) / 2`` with the pseudo-inertia P.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from proprio_ros.errors import ConfigurationError, SimulationError
from proprio_ros.probes import virtual_object
from proprio_ros.probes.container.virtual_object import Container
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.probes.softness.virtual_object import SoftBlock
from proprio_ros.records import FloatArray, Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.objects import HandObject, Payload
from proprio_ros.virtual.truth import JointTruth, LinkTruth, Truth

GRIPPER = "gripper_left_joint"
POSE = {
    "joint1": 0.4,
    "joint2": -0.9,
    "joint3": 0.7,
    "joint4": 0.3,
    GRIPPER: 0.005,
}
SMOOTH = JointTruth(torque_constant=1.8, armature=0.012, viscous=0.01)
PERIOD_S = 0.001


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


@pytest.fixture(scope="module")
def pendulum() -> Robot:
    return load_robot("pendulum")


def truth_of(robot: Robot, joint: JointTruth, **others: JointTruth) -> Truth:
    return Truth({name: others.get(name, joint) for name in robot.drive_trains})


def held_current(arm: VirtualArm, goal_rad: FloatArray) -> FloatArray:
    """The servos' holding law, from true angles [A]."""
    wanted = 10.6 * (goal_rad - arm.shaft_rad()) - 0.48 * arm.velocity_rad_s()
    return np.clip(wanted, -1.0, 1.0)


def settled(arm: VirtualArm, duration_s: float = 2.0) -> FloatArray:
    """Let the servos hold the arm, and return the currents that they end up with [A]."""
    goal = arm.shaft_rad()
    for _ in range(round(duration_s / PERIOD_S)):
        arm.step(held_current(arm, goal))
    assert np.abs(arm.velocity_rad_s()).max() < 1e-6
    return held_current(arm, goal)


def drive(arm: VirtualArm, current_A: float, duration_s: float) -> None:
    """A constant current into an arm of one joint."""
    for _ in range(round(duration_s / PERIOD_S)):
        arm.step(np.array([current_A]))


def potential(
    robot: Robot,
    position: Mapping[str, float],
    carried: list[tuple[float, tuple[float, float, float]]],
) -> float:
    """Potential energy [J]; carried: masses [kg] and places in the payload frame [m]."""
    energy = 0.0
    for link in robot.model.links:
        first_moment = (
            robot.model.frame_transform(link.name, position) @ link.pseudo_inertia[:, 3]
        )[:3]
        energy -= float(robot.gravity @ first_moment)
    hand = robot.model.frame_transform(robot.payload_frame, position)
    for mass, place in carried:
        energy -= mass * float(robot.gravity @ (hand @ (*place, 1.0))[:3])
    return energy


def holding_torque(
    robot: Robot,
    position: Mapping[str, float],
    carried: list[tuple[float, tuple[float, float, float]]],
) -> FloatArray:
    """Torque at each shaft that balances gravity [N m]."""
    torques = []
    for name, train in robot.drive_trains.items():
        step = 1e-5 * train.transmission
        ends = [
            potential(robot, {**position, name: position[name] + sign * step}, carried)
            for sign in (1.0, -1.0)
        ]
        torques.append((ends[0] - ends[1]) / 2e-5)
    return np.array(torques)


def kinetic(
    robot: Robot,
    position: Mapping[str, float],
    velocity: Mapping[str, float],
) -> float:
    """Kinetic energy of the links [J]."""
    step = 1e-6
    energy = 0.0
    for link in robot.model.links:
        ends = [
            robot.model.frame_transform(
                link.name, {name: position[name] + h * velocity[name] for name in position}
            )
            for h in (step, -step)
        ]
        rate = (ends[0] - ends[1]) / (2.0 * step)
        energy += 0.5 * float(np.trace(rate @ link.pseudo_inertia @ rate.T))
    return energy


# --------------------------------------------------------------------------------------------------------------- statics


@pytest.mark.parametrize("payload", [None, Payload(0.05), Payload(0.2, com_m=(0.02, -0.01, 0.015))])
@pytest.mark.parametrize("gravity", [[0.0, 0.0, -9.81], [1.5, -2.0, -9.0]])
def test_holding_currents_balance_gravity(
    robot: Robot, payload: Payload | None, gravity: list[float]
) -> None:
    robot = robot.with_overrides({"gravity": gravity})
    arm = VirtualArm(
        robot,
        truth_of(robot, SMOOTH),
        position=POSE,
    )
    arm.hold(payload)
    torque = 1.8 * settled(arm)
    carried = [] if payload is None else [(payload.mass_kg, payload.com_m)]
    # the followers' finger is tied by a constraint that gives way by 1e-4 of its load
    assert torque == pytest.approx(holding_torque(robot, arm.position(), carried), abs=2e-6)


def test_departing_links_shift_the_torque(robot: Robot) -> None:
    link = LinkTruth(mass=0.1, com_m=(0.01, 0.0, 0.0))
    truth = truth_of(robot, SMOOTH)
    torques = []
    for hidden in (truth, replace(truth, arm_scale=1.03), replace(truth, links={"link4": link})):
        arm = VirtualArm(
            robot,
            hidden,
            position={"joint2": -0.5},
        )
        torques.append((1.8 * settled(arm), arm.position()))
    (plain, _), (scaled, there), (departed, here) = torques
    assert scaled == pytest.approx(1.03 * holding_torque(robot, there, []), abs=2e-6)
    # by hand: link4 of 132.7 g lies with its centre 90.9 mm before joint3
    moment = 1.1 * 0.13274562 * (0.09090959 + 0.01) - 0.13274562 * 0.09090959
    tilt = here["joint2"] + here["joint3"]
    added = departed - holding_torque(robot, here, [])
    lever_z = 0.1 * 0.13274562 * 2.2413e-4
    assert added[2] == pytest.approx(
        -9.81 * (moment * math.cos(tilt) + lever_z * math.sin(tilt)), abs=5e-6
    )
    assert np.abs(departed - plain).max() > 0.02


def test_a_resting_sphere_weighs(robot: Robot) -> None:
    arm = VirtualArm(robot, truth_of(robot, SMOOTH))
    box = Container(
        0.03,
        sphere_mass_kg=0.05,
        sphere_radius_m=0.012,
        centre_m=(0.01, 0.0, 0.005),
    )
    arm.hold(box)
    start = box.sphere_m(arm)
    assert start == pytest.approx((0.0, 0.0, -0.008), abs=1e-12)
    torque = 1.8 * settled(arm, 4.0)
    place = box.sphere_m(arm)
    # the hand sags, the sphere rolls to the front and rests on the floor; contacts give way by some 10 um
    assert place == pytest.approx((0.018, 0.0, -0.008), abs=5e-5)
    spot = (0.01 + place[0], place[1], 0.005 + place[2])
    assert torque == pytest.approx(
        holding_torque(
            robot,
            arm.position(),
            [(0.03, box.centre_m), (0.05, spot)],
        ),
        abs=2e-5,
    )


# -------------------------------------------------------------------------------------------------------------- dynamics


def test_friction_holds_below_and_yields_above(pendulum: Robot) -> None:
    sticky = truth_of(pendulum, JointTruth(1.0, coulomb=0.3))
    arm = VirtualArm(pendulum, sticky)
    drive(arm, 0.29, 2.0)
    assert abs(arm.shaft_rad()[0]) < 1e-4
    drive(arm, 0.32, 0.3)
    assert arm.shaft_rad()[0] > 0.02
    # without current it stays where friction beats gravity: 0.589 sin q < 0.3
    arm.set_position({"pivot": 0.5})
    drive(arm, 0.0, 2.0)
    assert arm.shaft_rad()[0] == pytest.approx(0.5, abs=2e-4)
    arm.set_position({"pivot": 0.6})
    drive(arm, 0.0, 0.5)
    assert arm.shaft_rad()[0] < 0.55


def test_friction_grows_with_the_motor_torque(pendulum: Robot) -> None:
    # 0.4 N m against gravity's 0.589 sin q: sticks while |0.4 - 0.589 sin q| < 0.2 x 0.4
    arm = VirtualArm(
        pendulum,
        truth_of(pendulum, JointTruth(1.0, load_friction=0.2)),
    )
    inside = math.asin(0.47 / 0.5886)
    outside = math.asin(0.49 / 0.5886)
    for start, moves in ((inside, False), (outside, True)):
        arm.set_position({"pivot": start})
        drive(arm, 0.4, 0.5)
        assert (abs(arm.shaft_rad()[0] - start) > 1e-3) == moves


def test_stribeck_against_its_equation(pendulum: Robot) -> None:
    hidden = JointTruth(
        1.0, coulomb=0.2, stribeck=0.5, stribeck_velocity=0.12, viscous=0.01, armature=0.02
    )
    arm = VirtualArm(pendulum, truth_of(pendulum, hidden))
    drive(arm, 0.28, 1.0)
    assert abs(arm.shaft_rad()[0]) < 1e-4  # above the sliding friction, below the sticking one

    def rate(
        _: float,
        state: FloatArray,
    ) -> tuple[float, float]:
        q, v = state
        dry = 0.2 * (1.0 + 0.5 * math.exp(-((v / 0.12) ** 2)))
        return v, (0.45 - dry - 0.01 * v - 0.2 * 9.81 * 0.3 * math.sin(q)) / (0.018008 + 0.02)

    arm.set_position({"pivot": 0.0})
    drive(arm, 0.45, 0.2)
    end = solve_ivp(
        rate,
        (0.0, 0.2),
        (0.0, 0.0),
        rtol=1e-9,
        atol=1e-9,
    ).y[:, -1]
    assert arm.shaft_rad()[0] == pytest.approx(end[0], abs=1e-5)
    assert arm.velocity_rad_s()[0] == pytest.approx(end[1], abs=1e-4)


def test_a_current_step_against_the_closed_form(robot: Robot) -> None:
    # joint1 turns about the vertical; a huge armature holds the others, so inertia is constant and gravity does no work
    hidden = JointTruth(
        1.7,
        coulomb=0.05,
        viscous=0.03,
        load_friction=0.04,
        armature=0.015,
    )
    truth = truth_of(
        robot,
        JointTruth(1.7, armature=1e5),
        joint1=hidden,
    )
    arm = VirtualArm(robot, truth, position={"joint2": 0.8})
    pose = arm.position()
    spinning = {name: float(name == "joint1") for name in pose}
    inertia = 2.0 * kinetic(robot, pose, spinning) + 0.015
    torque = 1.7 * 0.2
    push = torque - 0.05 - 0.04 * torque
    for _ in range(400):
        arm.step(np.array([0.2, 0.0, 0.0, 0.0, 0.0]))
    rate = 0.03 / inertia
    velocity = push / 0.03 * (1.0 - math.exp(-rate * 0.4))
    angle = push / 0.03 * (0.4 - (1.0 - math.exp(-rate * 0.4)) / rate)
    assert velocity > 2.0
    assert arm.velocity_rad_s()[0] == pytest.approx(velocity, rel=1e-4)
    assert arm.shaft_rad()[0] == pytest.approx(angle, rel=2e-4)


def test_a_slide_counts_at_the_shaft(robot: Robot) -> None:
    hidden = JointTruth(
        1.7,
        coulomb=0.05,
        viscous=0.02,
        armature=0.01,
    )
    arm = VirtualArm(
        robot,
        truth_of(
            robot,
            JointTruth(1.7, armature=1e5),
            **{GRIPPER: hidden},
        ),
    )
    for _ in range(100):
        arm.step(np.array([0.0, 0.0, 0.0, 0.0, 0.1]))
    inertia = 0.01 + 2.0 * 0.032218127 * 0.01149**2  # motor and both fingers
    push = 0.17 - 0.05
    rate = 0.02 / inertia
    angle = push / 0.02 * (0.1 - (1.0 - math.exp(-rate * 0.1)) / rate)
    assert arm.shaft_rad()[4] == pytest.approx(angle, rel=1e-3)
    assert arm.position()[GRIPPER] == pytest.approx(0.01149 * angle, rel=1e-3)


def test_a_swinging_pendulum_keeps_its_energy(pendulum: Robot) -> None:
    arm = VirtualArm(
        pendulum,
        truth_of(
            pendulum,
            JointTruth(1.0, armature=0.01),
        ),
        position={"pivot": 2.0},
    )
    weight = 0.2 * 9.81 * 0.3
    energies = []
    for _ in range(4000):
        arm.step(np.zeros(1))
        energies.append(
            0.5 * 0.028008 * arm.velocity_rad_s()[0] ** 2 - weight * math.cos(arm.shaft_rad()[0])
        )
    assert np.ptp(energies) < 1e-6 * weight
    assert energies[0] == pytest.approx(-weight * math.cos(2.0), rel=1e-6)


def test_a_falling_arm_keeps_its_energy(robot: Robot) -> None:
    start = {
        "joint1": 0.3,
        "joint2": -0.5,
        "joint3": 0.2,
        "joint4": 0.4,
    }
    arm = VirtualArm(
        robot,
        truth_of(robot, JointTruth(1.8, armature=0.01)),
        position=start,
    )
    before = potential(robot, arm.position(), [])
    for _ in range(200):
        arm.step(np.array([0.1, 0.0, 0.0, 0.0, 0.0]))
    speed = dict(zip(arm.joints, arm.velocity_rad_s(), strict=True))
    joint_speed = {
        name: rate * robot.drive_trains[name].transmission for name, rate in speed.items()
    }
    now = potential(robot, arm.position(), []) + kinetic(
        robot,
        arm.position(),
        joint_speed,
    )
    now += 0.5 * 0.01 * sum(rate**2 for rate in speed.values())
    work = 1.8 * 0.1 * (arm.position()["joint1"] - 0.3)
    assert max(map(abs, speed.values())) > 1.0
    assert now == pytest.approx(before + work, abs=1e-5)


@pytest.mark.parametrize("current_A", [1.0, -1.0])
def test_limits_hold(robot: Robot, current_A: float) -> None:
    arm = VirtualArm(
        robot,
        Truth.draw(robot, 3),
        position={"joint3": 0.5},
    )
    worst = 0.0
    for _ in range(1500):
        arm.step(np.array([0.0, 0.0, current_A, 0.0, 0.5 * current_A]))
        for name, value in arm.position().items():
            joint = robot.model.joint(name)
            over = (
                max(joint.lower - value, value - joint.upper)
                / robot.drive_trains[name].transmission
            )
            worst = max(worst, over)
    at = arm.position()
    end = robot.model.joint("joint3").upper if current_A > 0 else robot.model.joint("joint3").lower
    assert at["joint3"] == pytest.approx(end, abs=0.005)
    assert worst < 0.05


# --------------------------------------------------------------------------------------------------------------- objects


@pytest.mark.parametrize("held", [Payload(0.1), Container(), SoftBlock(12000.0), None])
def test_a_swap_keeps_the_motion(robot: Robot, held: HandObject | None) -> None:
    arm = VirtualArm(
        robot,
        Truth.draw(robot, 5),
        position=POSE,
    )
    for first in (None, Container(), Payload(0.02)):
        arm.hold(first)
        for _ in range(20):
            arm.step(np.array([0.1, 0.2, -0.3, 0.1, 0.1]))
        before = arm.shaft_rad(), arm.velocity_rad_s(), arm.time_s
        arm.hold(held)
        assert arm.object == held
        assert arm.shaft_rad() == pytest.approx(before[0], abs=0.0)
        assert arm.velocity_rad_s() == pytest.approx(before[1], abs=0.0)
        assert arm.time_s == before[2]
    assert np.abs(arm.velocity_rad_s()).max() > 0.1


def test_an_impossible_object_changes_nothing(robot: Robot) -> None:
    arm = VirtualArm(robot, Truth.nominal(robot))
    arm.hold(Payload(0.05))
    impossible = Payload(0.05, inertia_kg_m2=(1e-5, 1e-5, 9e-5, 0.0, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match="MuJoCo refuses"):
        arm.hold(impossible)
    assert arm.object == Payload(0.05)
    arm.step(np.zeros(5))


def test_a_sphere_rolls_down_a_slope(robot: Robot) -> None:
    # a slope that counts as level when the sphere is put down; rolling takes 2/7 of the acceleration
    arm = VirtualArm(
        robot,
        truth_of(
            robot,
            JointTruth(1.8, armature=1e5),
        ),
        position={"joint4": 0.019},
    )
    box = Container()
    arm.hold(box)
    for _ in range(400):
        arm.step(np.zeros(5))
    place = box.sphere_m(arm)
    assert place[0] == pytest.approx(0.5 * 5.0 / 7.0 * 9.81 * math.sin(0.019) * 0.4**2, rel=0.02)


def test_a_point_in_the_hand(robot: Robot) -> None:
    arm = VirtualArm(robot, truth_of(robot, SMOOTH))
    arm.hold(Payload(0.1, size_m=0.0))
    assert 1.8 * settled(arm) == pytest.approx(
        holding_torque(
            robot,
            arm.position(),
            [(0.1, (0.0, 0.0, 0.0))],
        ),
        abs=2e-6,
    )


def test_a_shaken_sphere_stays_inside(robot: Robot) -> None:
    box = Container()
    arm = VirtualArm(
        robot, truth_of(robot, SMOOTH), position={"joint2": -1.2, "joint3": 0.6, "joint4": 0.6}
    )
    arm.hold(box)
    goal = arm.shaft_rad()
    places = []
    for k in range(6000):
        # first it is rocked, then thrown about
        shake = (
            (0.3 * math.sin(0.02 * k), 0.8 * math.sin(0.008 * k))
            if k < 4000
            else (math.sin(0.05 * k),) * 2
        )
        arm.step(held_current(arm, goal + np.array([shake[0], 0.0, 0.0, shake[1], 0.0])))
        places.append(box.sphere_m(arm))
    inside = np.array(places)
    room = 0.5 * np.array(box.inner_size_m) - box.sphere_radius_m
    # walls give way: measured 0.6 mm where the sphere hits them
    assert (np.abs(inside) < room + 0.001).all()
    assert np.ptp(inside[:4000, 0]) > 0.034  # it did roll from end to end
    assert np.ptp(inside[:4000, 1]) > 0.015
    assert inside[4000:, 2].max() > 0.0  # and did leave the floor


def test_a_block_is_compressed_by_its_law(robot: Robot) -> None:
    block = SoftBlock(
        12000.0,
        (0.025, 0.03, 0.02),
        damping=200.0,
        gap_m=0.003,
        poissons_ratio=0.3,
    )
    arm = VirtualArm(
        robot,
        truth_of(
            robot,
            JointTruth(1.8, armature=0.012),
        ),
        position={GRIPPER: 0.015},
    )
    arm.hold(block)
    current_A = -0.03
    for _ in range(6000):
        currents = held_current(arm, np.zeros(5))
        currents[4] = current_A
        arm.step(currents)
    assert abs(arm.velocity_rad_s()[4]) < 1e-6
    travel = 0.015 - arm.position()[GRIPPER]
    compression = 2.0 * (travel - 0.003)
    strain = compression / 0.025
    assert strain > 0.1
    # the side faces carry nothing: the stretch across them solves the law's other component
    mu = 12000.0 / 2.6
    lam = 12000.0 * 0.3 / (1.3 * 0.4)
    stretch = 1.0 - strain
    across = brentq(
        lambda l2: mu * (l2 - 1.0 / l2) + lam * np.log(stretch * l2**2) / l2, 1.0, 2.0, xtol=1e-14
    )
    force = (
        0.03
        * 0.02
        * -(mu * (stretch - 1.0 / stretch) + lam * np.log(stretch * across**2) / stretch)
    )
    # the motor's work 1.8 i d(shaft) is the force's work on both sides, force d(compression)
    assert 1.8 * -current_A == pytest.approx(2.0 * 0.01149 * force, rel=1e-4)


def test_a_block_never_pulls() -> None:
    block = SoftBlock(
        1e4,
        (0.02, 0.03, 0.03),
        damping=10.0,
        poissons_ratio=0.0,
    )
    # without a Poisson's ratio the sides stay as they are
    elastic = 0.5e4 * 0.03 * 0.03 * (1.0 / 0.9 - 0.9)
    assert block.force_N(0.002, 0.0) == pytest.approx(elastic)
    assert block.force_N(0.002, 0.01) == pytest.approx(elastic + 0.1)
    assert block.force_N(0.002, -1.0) == 0.0
    assert block.force_N(0.03, 0.0) == block.force_N(0.1, 0.0) < 1e3, "no block is infinitely hard"
    assert block.force_N(-0.001, 1.0) == 0.0


def test_a_block_needs_a_gripper(pendulum: Robot) -> None:
    with pytest.raises(ConfigurationError, match="finger"):
        VirtualArm(pendulum, Truth.nominal(pendulum)).hold(SoftBlock(1e4))


def test_the_walls_of_a_container() -> None:
    # a cubic shell of edge a: m a^2 5/18 about each axis
    box = Container(
        0.036,
        (0.06, 0.06, 0.06),
        sphere_radius_m=0.01,
    )
    assert box.inertia == pytest.approx((0.036 * 0.06**2 * 5 / 18,) * 3 + (0.0,) * 3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", None),
        (" none ", None),
        ("0.05", Payload(0.05)),
        ("payload:0.05", Payload(0.05)),
        ("payload:0.05, size=0.03, com=[0.01, 0, 0]", Payload(0.05, (0.01, 0.0, 0.0), 0.03)),
        (
            "container:0.03,sphere=0.011,inner=[0.06,0.05,0.04],radius=0.01",
            Container(0.03, (0.06, 0.05, 0.04), sphere_mass_kg=0.011, sphere_radius_m=0.01),
        ),
        (
            "block:12000,size=[0.03,0.02,0.03],gap=0.004,nu=0.1",
            SoftBlock(12000.0, (0.03, 0.02, 0.03), gap_m=0.004, poissons_ratio=0.1),
        ),
    ],
)
def test_objects_as_users_type_them(text: str, expected: HandObject | None) -> None:
    assert virtual_object(text) == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("50", "masses are in kg"),
        ("-0.05", "masses are in kg"),
        ("payload:", "mass= must be a number"),
        ("payload:nan", "must be a number"),
        ("9" * 400, "must be a number"),
        ("brick:1", "unknown kind 'brick'"),
        ("payload:0.05,colour=3", "unknown key 'colour'"),
        ("payload:0.05,size", "no key=value"),
        ("payload:0.05,size=30", "lengths are in m"),
        ("payload:0.05,com=[1,2]", "3 numbers in brackets"),
        ("payload:0.05,size=0.03,size=0.02", "given twice"),
        ("container:0.03,radius=0.03", "does not fit"),
        ("block:0.1", "in Pa"),
        ("block:12000,gap=-0.001", "lengths are in m"),
        ("block:12000,nu=0.5", "below 0.5"),
    ],
)
def test_wrong_objects_are_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        virtual_object(text)
    message = str(caught.value)
    assert said in message
    assert "valid: none | 0.05" in message
    assert "\n" not in message


# ----------------------------------------------------------------------------------------------------- truth and encoders


@pytest.fixture(scope="module")
def truths(robot: Robot) -> list[Truth]:
    """Two hundred hidden arms."""
    return [Truth.draw(robot, seed, links=True) for seed in range(200)]


@pytest.mark.parametrize(
    ("term", "low", "high"),
    [("coulomb", 0.024, 0.072), ("viscous", 0.0015, 0.009), ("load_friction", 0.0, 0.03)],
)
def test_drawn_frictions_fill_their_range(
    truths: list[Truth], term: str, low: float, high: float
) -> None:
    values = [getattr(joint, term) for truth in truths for joint in truth.joints.values()]
    assert low <= min(values) < low + 0.1 * (high - low)
    assert high - 0.1 * (high - low) < max(values) <= high


@pytest.mark.parametrize(
    ("term", "spread"),
    [("torque_constant", 0.09), ("zero_rad", 0.005), ("once_per_turn_cos_rad", 0.001)],
)
def test_drawn_drives_scatter(truths: list[Truth], term: str, spread: float) -> None:
    values = [getattr(joint, term) for truth in truths for joint in truth.joints.values()]
    assert np.std(values) == pytest.approx(spread, rel=0.1)


def test_drawn_truths(truths: list[Truth]) -> None:
    joints = [joint for truth in truths for joint in truth.joints.values()]
    assert min(joint.armature for joint in joints) == pytest.approx(0.4 * 0.012)
    assert all(joint.stribeck == 0.0 for joint in joints)
    assert all(0.002 <= truth.latency_s <= 0.006 for truth in truths)
    assert np.std([truth.arm_scale for truth in truths]) == pytest.approx(0.02, rel=0.15)
    assert np.std([truth.links["link4"].mass for truth in truths]) == pytest.approx(0.01, rel=0.15)


def test_known_friction_is_drawn_about_its_value(robot: Robot) -> None:
    robot = robot.with_overrides(
        {"joints.joint3.drive_train.coulomb_N_m": {"value": 0.085, "std": 0.01}}
    )
    values = [Truth.draw(robot, seed).joints["joint3"].coulomb for seed in range(300)]
    assert np.mean(values) == pytest.approx(0.085, abs=0.002)
    assert np.std(values) == pytest.approx(0.01, rel=0.15)


def test_a_seed_gives_the_same_motors_whatever_else_is_drawn(robot: Robot) -> None:
    plain = Truth.draw(robot, 7)
    full = Truth.draw(
        robot,
        7,
        links=True,
        stribeck=True,
    )
    assert full != plain == Truth.draw(robot, 7) != Truth.draw(robot, 8)
    assert all(joint.stribeck > 0.0 for joint in full.joints.values())
    without = {name: replace(joint, stribeck=0.0) for name, joint in full.joints.items()}
    assert without == plain.joints
    assert full.latency_s == plain.latency_s


def test_truth_in_a_file(robot: Robot) -> None:
    truth = Truth.draw(
        robot,
        2,
        links=True,
        stribeck=True,
    )
    assert Truth.from_json(truth.as_json()) == truth
    for wrong in ("{", "[]", "{}", '{"joints": {"joint1": {"colour": 1}}}'):
        with pytest.raises(ConfigurationError, match="truth: "):
            Truth.from_json(wrong)


def test_encoders(robot: Robot) -> None:
    hidden = JointTruth(
        1.8, zero_rad=0.02, once_per_turn_sin_rad=0.003, once_per_turn_cos_rad=-0.002
    )
    arm = VirtualArm(
        robot,
        truth_of(robot, hidden),
        position=POSE,
    )
    true = arm.shaft_rad()
    assert true[4] == pytest.approx(0.005 / 0.01149)
    assert arm.encoder_rad() == pytest.approx(
        true - 0.02 + 0.003 * np.sin(true) - 0.002 * np.cos(true), abs=1e-12
    )
    noisy = VirtualArm(
        robot,
        truth_of(
            robot,
            replace(hidden, encoder_noise_rad=0.001),
        ),
        position=POSE,
    )
    noise = np.array([noisy.encoder_rad() for _ in range(2000)]) - arm.encoder_rad()
    assert np.std(noise, axis=0) == pytest.approx(0.001, rel=0.1)
    assert np.mean(noise, axis=0) == pytest.approx(0.0, abs=1e-4)


def test_the_same_seed_gives_the_same_world(robot: Robot) -> None:
    def readings(seed: int) -> FloatArray:
        arm = VirtualArm(
            robot,
            Truth.draw(
                robot,
                1,
                links=True,
                stribeck=True,
            ),
            position=POSE,
            seed=seed,
        )
        arm.hold(Container())
        rows = []
        for k in range(300):
            arm.step(np.array([0.1, -0.1, 0.2, 0.0, 0.1]) * math.sin(0.03 * k))
            rows.append(arm.encoder_rad())
        return np.array(rows)

    first = readings(4)
    assert np.array_equal(first, readings(4))
    assert not np.array_equal(first, readings(5))


# ------------------------------------------------------------------------------------------------------- mistakes and time


def test_mistakes_are_refused(robot: Robot, pendulum: Robot) -> None:
    nominal = Truth.nominal(robot)
    with pytest.raises(ConfigurationError, match="says nothing of joint1"):
        VirtualArm(robot, Truth.nominal(pendulum))
    with pytest.raises(ConfigurationError, match="joint2 at 2: "):
        VirtualArm(robot, nominal, position={"joint2": 2.0})
    with pytest.raises(ConfigurationError, match="joint3 at nan"):
        VirtualArm(robot, nominal, position={"joint3": math.nan})
    with pytest.raises(ConfigurationError, match="no joint 'elbow'"):
        VirtualArm(robot, nominal, position={"elbow": 0.0})
    with pytest.raises(ConfigurationError, match="control period"):
        VirtualArm(robot, nominal, control_period_s=0.0)
    arm = VirtualArm(robot, nominal)
    with pytest.raises(ConfigurationError, match="expected currents of joint1, joint2"):
        arm.step(np.zeros(4))
    with pytest.raises(SimulationError, match="not finite"):
        arm.step(np.array([0.0, math.nan, 0.0, 0.0, 0.0]))


def test_without_mujoco_one_is_told_what_to_install(
    pendulum: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ConfigurationError, match="install the extra sim"):
        VirtualArm(pendulum, Truth.nominal(pendulum))


@pytest.mark.parametrize("control_period_s", [0.001, 0.0007, 0.002])
def test_a_step_takes_one_control_period(pendulum: Robot, control_period_s: float) -> None:
    arm = VirtualArm(
        pendulum,
        Truth.nominal(pendulum),
        control_period_s=control_period_s,
    )
    for _ in range(100):
        arm.step(np.zeros(1))
    assert arm.time_s == pytest.approx(100 * control_period_s, rel=1e-12)


# -------------------------------------------------------------------------------------------------------- twin experiment


TWIN_JOINTS = ("joint1", "joint2", "joint3", "joint4", GRIPPER)


def test_the_identification_finds_the_mass_when_the_truth_is_stated(robot: Robot) -> None:
    nominal = Truth.nominal(robot)
    truth = replace(
        nominal,
        joints={
            name: replace(
                joint, coulomb=0.05, viscous=0.008, load_friction=0.02, encoder_noise_rad=0.0
            )
            for name, joint in nominal.joints.items()
        },
    )
    arm = VirtualArm(
        robot,
        truth,
        position={"joint2": -1.4, "joint3": 0.8},
    )
    arm.hold(Payload(0.05))
    run = pushed_elbow(arm, current_A=-0.36, push_s=0.5)
    assert np.ptp(run.position) > 0.3
    estimate = weigh(robot.with_overrides(stated(truth)), [run])
    assert estimate.value("payload_mass").value == pytest.approx(0.05, abs=0.0003)


def stated(truth: Truth) -> dict[str, float]:
    """A robot file's values that say what is true, and that nothing else is open."""
    told: dict[str, float] = {
        "arm_scale": 1.0,
        "delay_s": 0.0,
        "link_mass_std": 0.0,
        "link_com_std_m": 0.0,
        "link_inertia_std": 0.0,
        "onset_jitter_s": 0.0,
        "stamp_jitter_s": 0.0,
    }
    for name in TWIN_JOINTS:
        drive_train = f"joints.{name}.drive_train"
        hidden = truth.joints[name]
        told |= {
            f"{drive_train}.torque_constant_N_m_per_A": hidden.torque_constant,
            f"{drive_train}.coulomb_N_m": hidden.coulomb,
            f"{drive_train}.viscous_N_m_s_per_rad": hidden.viscous,
            f"{drive_train}.load_friction": hidden.load_friction,
            f"{drive_train}.armature_kg_m2": hidden.armature,
            f"{drive_train}.zero_rad": 0.0,
            f"{drive_train}.stribeck": 0.0,
            f"joints.{name}.motor.encoder_once_per_turn_rad": 0.0,
        }
    return told


def pushed_elbow(arm: VirtualArm, current_A: float, push_s: float) -> Run:
    """A second at rest and a push of joint3, as a run without noise.

    Args:
        arm: The twin.
        current_A: Of the push [A].
        push_s: How long it lasts [s].
    """
    goal = arm.shaft_rad()
    before_s = 1.0
    times = []
    rows = []
    for k in range(round((before_s + push_s) / PERIOD_S) + 1):
        if k % 10 == 0:
            times.append(k * PERIOD_S - before_s)
            rows.append(arm.shaft_rad())
        currents = held_current(arm, goal)
        if k >= round(before_s / PERIOD_S):
            currents[2] = current_A
        arm.step(currents)
    seconds = np.round(np.array(times), 9)
    shafts = np.array(rows)
    after = seconds >= 0.0
    others = {
        name: shafts[:, column]
        for column, name in enumerate(TWIN_JOINTS)
        if name not in ("joint3", GRIPPER)
    }
    others[GRIPPER] = 0.01149 * shafts[:, 4]
    order = np.concatenate([np.flatnonzero(~after), np.flatnonzero(after)])
    return Run(
        name="twin",
        joint="joint3",
        onset_ns=0,
        times_s=seconds[after],
        position=shafts[after, 2],
        before_times_s=seconds[~after],
        before_position=shafts[~after, 2],
        held={name: float(values.mean()) for name, values in others.items()},
        held_span={name: float(np.ptp(values)) for name, values in others.items()},
        input_times_s=np.array([0.0]),
        input_current_A=np.array([current_A]),
        duration_s=push_s,
        source="command",
        held_position={name: values[order] for name, values in others.items()},
    )
