"""The squeeze on the virtual arm, from the machine's first command to the modulus; the block obeys a law in closed form.

MuJoCo moves the fingers, and nothing of the identification's simulator is in it. Real time and the bus are left out: what they
add is in test/nodes.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.hand import ROBOT, Hand
from support.squeezing import EDGE_M, GAP_M, GRIPPER, calibrated, made, played, squeezed

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.machine import Phase
from proprio_ros.excitation.plans import Until, check_sequence, load_sequence
from proprio_ros.experiment_design.choosing import Decision
from proprio_ros.identification.estimate import Verdict
from proprio_ros.probes import probe_named
from proprio_ros.probes.softness import SoftnessJob
from proprio_ros.probes.softness.choosing import thrown_back
from proprio_ros.probes.softness.identify import SqueezeOptions, find_softness
from proprio_ros.probes.softness.problem import BlockFacts
from proprio_ros.probes.softness.virtual_object import SoftBlock
from proprio_ros.records import Run
from proprio_ros.robot import Robot


@pytest.mark.parametrize(
    "modulus",
    [1.5e3, pytest.param(100e3, marks=pytest.mark.long), pytest.param(1e6, marks=pytest.mark.long)],
)
def test_fingers_neither_crush_nor_stay(modulus: float) -> None:
    """From foam to hard rubber, with a gripper of little friction: 45 % is never reached, and the block is let go."""
    hand = Hand(
        3,
        SoftBlock(modulus, gap_m=GAP_M),
        coulomb=0.015,
    )
    began = hand.arm.position()[GRIPPER]
    machine, _, closed = played("softness", hand)
    assert machine.phase is Phase.DONE, machine.message
    assert 2.0 * (closed - GAP_M) / EDGE_M < 0.45
    assert abs(hand.arm.position()[GRIPPER] - began) < 0.0005
    if modulus <= 1e5:
        assert machine.message == "softness is done: all 3 runs are good"


@pytest.mark.long
@pytest.mark.parametrize("seed", [2])
def test_moduli_within_their_intervals(seed: int) -> None:
    """Hidden torque constant, friction, armature, delay and encoder error; three squeezes of each of two blocks."""
    robot = calibrated(seed)
    for modulus, ratio in ((8e3, 0.3), (150e3, 0.4)):
        block = SoftBlock(
            modulus,
            gap_m=GAP_M,
            poissons_ratio=ratio,
            damping=0.5,
        )
        machine, estimate, _ = squeezed(robot, seed, block)
        assert estimate.verdict is Verdict.ACCEPTED, (machine.message, estimate.reasons)
        told = estimate.value("youngs_modulus")
        assert told.ci95[0] <= modulus <= told.ci95[1], (modulus, told)
        assert told.value == pytest.approx(modulus, rel=0.15)
        told_ratio = estimate.value("poissons_ratio")
        if told_ratio.value is not None:
            assert told_ratio.ci95[0] - 0.02 <= ratio <= told_ratio.ci95[1] + 0.02


@pytest.mark.long
def test_a_missing_block_is_reported() -> None:
    robot = calibrated(1)
    machine, runs, _ = played("softness", Hand(1, None))
    assert machine.phase is Phase.DONE
    estimate = find_softness(
        robot,
        runs,
        BlockFacts(np.full(3, EDGE_M)),
    )
    assert estimate.verdict is Verdict.NOT_IDENTIFIABLE
    assert estimate.value("youngs_modulus").value is None
    assert "is it between the fingers" in estimate.reasons[0]


def until_sure(
    robot: Robot,
    hand: Hand,
    until: Until,
    name: str = "block_until",
) -> tuple[tuple[Run, ...], list[Decision]]:
    """The runs of a block that is squeezed until sure, and what was decided after each."""
    sequence = replace(load_sequence(name, ROBOT), until=until)
    chooser = probe_named("softness").chooser(
        robot,
        SoftnessJob(
            BlockFacts(np.full(3, EDGE_M)),
            SqueezeOptions(),
        ),
        sequence,
    )
    began = hand.time_s
    decisions = []
    machine, runs, _ = made(
        replace(sequence, until=None),
        hand,
    )
    assert machine.phase is Phase.DONE, machine.message
    while True:
        decisions.append(
            chooser.next(
                runs,
                hand.sample().position,
                hand.time_s - began,
            )
        )
        if decisions[-1].run is None:
            return runs, decisions
        machine, more, closed = made(
            chooser.sequence_of(decisions[-1].run),
            hand,
        )
        assert machine.phase is Phase.DONE, machine.message
        assert 2.0 * (closed - GAP_M) / EDGE_M < 0.45, (
            "no squeeze goes farther than the sequence says"
        )
        runs += more


@pytest.mark.long
@pytest.mark.parametrize(("modulus", "half"), [(8e3, 0.2), (60e3, 0.12)])
def test_a_block_is_squeezed_until_it_is_sure(modulus: float, half: float) -> None:
    robot = calibrated(2)
    hand = Hand(
        2,
        SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=0.3, damping=0.5),
    )
    began = hand.arm.position()[GRIPPER]
    runs, decisions = until_sure(
        robot,
        hand,
        Until(half, "1", 40.0),
    )
    assert decisions[-1].ended_by == "target" and decisions[-1].reason.startswith("sure: +-"), (
        decisions[-1].reason
    )
    assert abs(hand.arm.position()[GRIPPER] - began) < 0.0005, "the fingers let go"
    told = find_softness(robot, runs, BlockFacts(np.full(3, EDGE_M))).value("youngs_modulus")
    assert told.ci95[0] <= modulus <= told.ci95[1]
    assert told.std is not None
    assert 1.96 * told.std <= 1.0001 * half * told.value
    # what a squeeze told is what it promised
    promises = [(before.promised, after.half) for before, after in pairwise(decisions)]
    assert promises and all(0.6 < reached / promised < 1.6 for promised, reached in promises), (
        promises
    )


@pytest.mark.long
def test_without_a_block_no_squeeze_is_sure() -> None:
    robot = calibrated(1)
    runs, decisions = until_sure(
        robot,
        Hand(1, None),
        Until(0.1, "1", 20.0),
    )
    assert decisions[-1].ended_by in ("worth", "time", "nothing"), decisions[-1].reason
    assert (
        find_softness(robot, runs, BlockFacts(np.full(3, EDGE_M))).verdict
        is Verdict.NOT_IDENTIFIABLE
    )


def test_no_squeeze_is_chosen_that_a_block_throws_back_faster_than_the_supply_turns_the_motor() -> (
    None
):
    drive = ROBOT.drive_trains[GRIPPER]
    no_load = drive.supply_voltage_V / drive.back_emf_V_s_per_rad
    velocity = no_load * np.array([[-0.9, 0.9, 0.0], [-0.9, 1.1, 0.0], [-0.9, 0.9, 1.1]])
    alive = np.array([[True, True, True], [True, True, True], [True, True, False]])
    assert thrown_back(velocity, alive, drive).tolist() == [False, True, False]
    unlimited = replace(drive, supply_voltage_V=0.0)
    assert not thrown_back(velocity, alive, unlimited).any()


def test_the_first_squeeze_is_stated() -> None:
    sequence = load_sequence("block_until", ROBOT)
    assert sequence.until == Until(0.2, "1", 30.0)
    with pytest.raises(
        ConfigurationError, match="follows from the first squeeze; state it under 'runs'"
    ):
        check_sequence(replace(sequence, runs=()), ROBOT)
    with pytest.raises(ConfigurationError, match="it is a share, not in percent"):
        check_sequence(replace(sequence, until=Until(10.0, "1")), ROBOT)


@pytest.mark.long
@pytest.mark.parametrize("seed", [12, 13])
def test_what_a_block_loses_is_not_taken_for_friction(seed: int) -> None:
    """A stiff block throws the fingers back with a tenth less than it took: without that in the law it was 12 and 17 % too soft."""
    modulus = 150e3
    block = SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=0.4, loss=0.1)
    _, estimate, _ = squeezed(calibrated(seed), seed, block)
    found = estimate.value("youngs_modulus")
    assert estimate.verdict is Verdict.ACCEPTED, estimate.reasons
    assert found.ci95[0] <= modulus <= found.ci95[1], found


@pytest.mark.long
def test_squeezes_that_let_go_tell_friction_under_load_from_torque() -> None:
    """Closings alone leave a soft block +-14 %: its force scales as the torque less what the gears lose of it."""
    modulus = 30e3
    robot = calibrated(11)
    hand = Hand(11, SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=0.13))
    sequence = load_sequence("softness", ROBOT)
    _, closings, _ = made(replace(sequence, until=None), hand)
    facts = BlockFacts(np.full(3, EDGE_M))
    before = find_softness(robot, closings, facts).value("youngs_modulus")
    assert sequence.until is not None
    runs, decisions = until_sure(robot, hand, sequence.until, "softness")
    assert any(each.push is not None and each.push.shake_A != 0.0 for each in decisions)
    after = find_softness(robot, runs, facts).value("youngs_modulus")
    assert after.ci95[0] <= modulus <= after.ci95[1]
    assert after.std < 0.85 * before.std
