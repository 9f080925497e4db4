"""A virtual gripper that makes sequences: on nothing, to calibrate itself, and on a block."""

from __future__ import annotations

import numpy as np

from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.excitation.plans import ExcitationSequence, load_sequence
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.probes.softness.identify import find_softness
from proprio_ros.probes.softness.problem import BlockFacts
from proprio_ros.probes.softness.virtual_object import SoftBlock
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import InputRecord, JointRecord, Recording, Run
from proprio_ros.robot import Robot
from support.hand import COUNT_A, JOINTS, ROBOT, Hand

GRIPPER = "gripper_left_joint"
EDGE_M = 0.03
GAP_M = 0.0005


def played(
    name: str,
    hand: Hand,
) -> tuple[ExcitationMachine, tuple[Run, ...], float]:
    """A shipped sequence, made."""
    return made(load_sequence(name, ROBOT), hand)


def made(
    sequence: ExcitationSequence, hand: Hand
) -> tuple[ExcitationMachine, tuple[Run, ...], float]:
    """The machine at its end, the runs of the recording, and how far the fingers closed from where they began [m]."""
    machine = ExcitationMachine(ROBOT)
    sample = hand.sample()
    machine.start(sequence, sample)
    began = closed = hand.arm.position()[GRIPPER]
    times = []
    places = []
    currents = []
    while machine.busy:
        command = machine.tick(hand.time_s, sample)
        times.append(round(1e9 * sample.time_s))
        places.append([sample.position[joint] for joint in JOINTS])
        # the driver's echo at every sample, in steps of the servo
        currents.append(
            [COUNT_A * round(command.current_A.get(joint, 0.0) / COUNT_A) for joint in JOINTS]
        )
        sample = hand.step(command)
        closed = min(closed, hand.arm.position()[GRIPPER])
    stamps = np.array(times)
    inputs = InputRecord(stamps, JOINTS, np.array(currents), "/applied_effort")
    runs = cut_runs(
        Recording(
            sequence.name,
            JointRecord(stamps, JOINTS, np.array(places)),
            inputs,
        ),
        joints=list(JOINTS),
    )
    return machine, runs, began - closed


def calibrated(seed: int) -> Robot:
    """The robot after its gripper was closed and opened with nothing between the fingers."""
    machine, runs, _ = played("empty_hand_gripper", Hand(seed, None))
    assert machine.phase is Phase.DONE and "all 4 runs are good" in machine.message, machine.message
    estimate = calibrate(ROBOT, [LoadedRun(run) for run in runs])
    assert estimate.calibration is not None, estimate.reasons
    return ROBOT.with_calibration(estimate.calibration)


def squeezed(
    robot: Robot, seed: int, block: SoftBlock
) -> tuple[ExcitationMachine, Estimate, float]:
    hand = Hand(seed, block)
    machine, runs, closed = played("softness", hand)
    assert machine.phase is Phase.DONE, machine.message
    return (
        machine,
        find_softness(
            robot,
            runs,
            BlockFacts(np.full(3, EDGE_M)),
        ),
        closed,
    )
