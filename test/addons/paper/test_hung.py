"""A payload that moves in the hand: what MuJoCo moves on a joint of its own, and what is identified from the elbow's encoder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.addons.paper.hand import HungPayload, known_robot, play, stated_robot
from proprio_ros.addons.paper.hung import Hung, HungProblem, hung_unknowns, identify_hung
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container.virtual_object import Container
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.records import Run
from proprio_ros.sim.joint import JointSimulator
from proprio_ros.sim.payload import PayloadFacts, PayloadShape
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.objects import Payload
from proprio_ros.virtual.truth import Truth

pytestmark = pytest.mark.long

SHAPE = PayloadShape.of("sphere", 0.04)
COM = np.array([0.0, 0.0, -0.06])
PENDULUM = Hung(
    "universal", np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), COM, SHAPE.second_moment_per_mass
)
SLIDE = Hung(
    "prismatic",
    np.array([1.0, 0.0, 0.0]),
    np.zeros(3),
    SHAPE.second_moment_per_mass,
)


@pytest.fixture(scope="module")
def swinging() -> tuple[Run, ...]:
    """Lift and lowering of a pendulum of 50 g by a robot of which all is known."""
    held = HungPayload(
        0.05,
        (0.0, 0.0, -0.06),
        0.04,
        damping=2.0 * 0.05 * 0.06**2 * 2.0,
    )
    return play("payload_elbow", 3, held, exact=True).runs


def problem(hung: Hung, run: Run) -> HungProblem:
    prepared = prepare_run(known_robot(), run, KnownLoad())
    return HungProblem(
        known_robot(),
        [prepared],
        hung,
        hung_unknowns(
            known_robot(),
            [prepared],
            hung,
        ),
    )


@pytest.mark.parametrize("hung", [SLIDE, PENDULUM], ids=["slide", "universal"])
def test_without_mass_it_is_the_single_joint(
    hung: Hung,
    swinging: tuple[Run, ...],
) -> None:
    """What the driven body feels of inertia and gravity comes through the chain unchanged."""
    ours = problem(hung, swinging[0])
    values = ours.base[None].copy()
    values[0, ours.index["payload_mass"]] = 1e-9
    p, _ = ours.parameters(values, ours.estimated)
    q, _, _ = ours.simulate(values, ours.estimated)
    alone = JointSimulator([replace(ours.simulator.runs[0], input_load=None)])
    width = len(alone.parameters)
    expected, _ = alone.rollout(
        np.zeros(1, dtype=np.int32),
        p[0, :, :width],
    )
    used = ours.runs[0].used
    assert np.ptp(expected[0, :used]) > 0.3
    np.testing.assert_allclose(
        q[0, 0, :used],
        expected[0, :used],
        atol=1e-6,
    )


@pytest.mark.parametrize("hung", [SLIDE, PENDULUM], ids=["slide", "universal"])
def test_sensitivities_against_finite_differences(
    hung: Hung,
    swinging: tuple[Run, ...],
) -> None:
    ours = problem(hung, swinging[0])
    columns = np.array(
        [
            row
            for row, u in enumerate(ours.unknowns)
            if u.kind.startswith("payload_") and u.role is Role.ESTIMATED
        ]
    )
    values = ours.base.copy()
    values[ours.index["payload_start_1", 0]] = 0.01
    _, _, exact = ours.simulate(values[None], columns)
    used = ours.runs[0].used
    for place, column in enumerate(columns):
        step = 1e-4 * max(abs(values[column]), 0.01)
        sides = np.tile(values, (2, 1))
        sides[:, column] += (step, -step)
        q, _, _ = ours.simulate(sides, columns[:1])
        slope = (q[0, 0, :used] - q[1, 0, :used]) / (2.0 * step)
        # across the plane of the motion
        assert np.abs(slope).max() > 0.0 or ours.unknowns[column].kind.endswith("_2")
        np.testing.assert_allclose(
            exact[0, 0, :used, place], slope, atol=1e-3 * max(np.abs(slope).max(), 1e-4)
        )


def test_a_pendulum_is_weighed_on_its_joint_and_not_as_if_it_were_rigid(
    swinging: tuple[Run, ...],
) -> None:
    found = identify_hung(known_robot(), swinging, PENDULUM)
    assert found.verdict == "explained"
    assert found.low <= 0.05 <= found.high
    assert abs(found.value - 0.05) < 0.002
    rigid = (
        weigh(known_robot(), swinging, PayloadFacts(COM, shape=SHAPE)).value("payload_mass").value
    )
    assert rigid is None or abs(rigid - 0.05) > 0.005


def test_the_arm_keeps_its_pose_when_something_that_moves_is_put_into_its_hand() -> None:
    """The payload's joints come among the arm's own in MuJoCo's order."""
    robot = stated_robot()
    arm = VirtualArm(
        robot,
        Truth.nominal(robot),
        position={"joint2": -1.0, "joint3": 0.5, "gripper_left_joint": 0.01},
    )
    before = arm.position()
    for held in (
        HungPayload(0.05, axes=((1.0, 0.0, 0.0),), slides=True, stiffness=20.0),
        Payload(0.05),
        HungPayload(0.02),
    ):
        arm.hold(held)
        assert arm.position() == before


def test_a_sphere_is_put_elsewhere_in_its_box() -> None:
    robot = stated_robot()
    arm = VirtualArm(
        robot, Truth.nominal(robot), position={"joint2": -0.6, "joint3": -1.0, "joint4": 0.6}
    )
    held = Container()
    arm.hold(held)
    place = np.array([0.01, -0.005, -0.002])
    settled = held.sphere_m(arm)
    held.put_sphere(arm, place)
    moved = held.sphere_m(arm)
    assert np.abs(settled - place).max() > 0.005
    np.testing.assert_allclose(moved, place, atol=1e-12)
