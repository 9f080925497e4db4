"""What the sequence `free_swing` tells of virtual arms: MuJoCo moves the wrist, which is let go, and a calibration is made of it.

python test/benchmarks/free_swings.py [arms | first seed, seed after the last]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from support import hand as virtual

from proprio_ros.errors import RecordingError
from proprio_ros.excitation.machine import ExcitationMachine
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import JointRecord, Recording

WRIST = "joint4"
KINDS = ("coulomb", "viscous", "armature")


def recorded(seed: int) -> tuple[virtual.Hand, Recording]:
    """An arm, and its joint states while the sequence is made, with the stretches in which no current was commanded."""
    arm, machine = virtual.Hand(seed, None), ExcitationMachine(virtual.ROBOT)
    sample = arm.sample()
    machine.start(load_sequence("free_swing", virtual.ROBOT), sample)
    stamps, rows, limp = [], [], []
    while machine.busy:
        command = machine.tick(arm.time_s, sample)
        stamps.append(round(1e9 * arm.time_s))
        rows.append([sample.position[name] for name in virtual.JOINTS])
        limp.append(command.current_A.get(WRIST) == 0.0)
        sample = arm.step(command)
    edges = np.flatnonzero(np.diff([False, *limp, False])).reshape(-1, 2).tolist()
    off = tuple((stamps[begin], stamps[end]) for begin, end in edges)
    return arm, Recording(f"arm {seed}", JointRecord(np.array(stamps), virtual.JOINTS, np.array(rows)), None, (), off)


def main(given: Sequence[str]) -> None:
    """Print what each arm's calibration says, and how far that is from the truth."""
    virtual.RATE_HZ = 100.0
    for seed in range(*(int(each) for each in given or ["10"])):
        arm, recording = recorded(seed)
        truth = arm.arm.truth.joints[WRIST]
        print(f"{seed}: at rest {truth.coulomb * (1.0 + truth.stribeck):.3f} N m", end="; ")
        try:
            runs = cut_runs(recording, joints=virtual.JOINTS)
        except RecordingError as error:
            print(error, flush=True)
            continue
        learnt = calibrate(virtual.ROBOT, [LoadedRun(run) for run in runs])
        print(f"falls {np.ptp(runs[0].position):.2f} rad, {learnt.verdict.value}", end="")
        for row in learnt.unknowns:
            if row.scope == WRIST and row.kind in KINDS:
                true = getattr(truth, row.kind)
                off = (row.value - true) / row.std
                print(f"; {row.kind} {row.value:.4f} +- {row.std:.4f}, true {true:.4f}, {off:+.1f} sd", end="")
        print(flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
