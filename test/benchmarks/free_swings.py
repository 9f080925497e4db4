"""What a calibration makes of the sequence `free_swing` on virtual arms: MuJoCo moves the wrist, which is let go.

python test/benchmarks/free_swings.py [--arms 10] [--first 0]
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from results import Results, parser_of
from support import hand as virtual

from proprio_ros.errors import RecordingError
from proprio_ros.excitation.machine import ExcitationMachine
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.quantity import Z95
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import JointRecord, Recording

WRIST = "joint4"
KINDS = ("coulomb", "viscous", "armature")


def recorded(seed: int) -> tuple[virtual.Hand, Recording]:
    """An arm, and its joint states while the sequence is made, with the stretches in which no current was commanded."""
    arm = virtual.Hand(seed, None)
    machine = ExcitationMachine(virtual.ROBOT)
    sample = arm.sample()
    machine.start(load_sequence("free_swing", virtual.ROBOT), sample)
    stamps = []
    rows = []
    limp = []
    while machine.busy:
        command = machine.tick(arm.time_s, sample)
        stamps.append(round(1e9 * arm.time_s))
        rows.append([sample.position[name] for name in virtual.JOINTS])
        limp.append(command.current_A.get(WRIST) == 0.0)
        sample = arm.step(command)
    edges = np.flatnonzero(np.diff([False, *limp, False])).reshape(-1, 2).tolist()
    off = tuple((stamps[begin], stamps[end]) for begin, end in edges)
    return arm, Recording(
        f"arm {seed}",
        JointRecord(
            np.array(stamps),
            virtual.JOINTS,
            np.array(rows),
        ),
        None,
        (),
        off,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what each arm's calibration gives, and how far that is from the truth; then one row for each unknown."""
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    virtual.RATE_HZ = 100.0
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    for seed in range(options.first, options.first + options.arms):
        arm, recording = recorded(seed)
        truth = arm.arm.truth.joints[WRIST]
        print(f"{seed}: at rest {truth.coulomb * (1.0 + truth.stribeck):.3f} N m", end="; ")
        try:
            runs = cut_runs(recording, joints=virtual.JOINTS)
        except RecordingError as error:
            print(error, flush=True)
            continue
        learnt = calibrate(
            virtual.ROBOT,
            [LoadedRun(run) for run in runs],
        )
        print(f"falls {np.ptp(runs[0].position):.2f} rad, {learnt.verdict.value}", end="")
        for row in learnt.unknowns:
            if row.scope == WRIST and row.kind in KINDS:
                true = getattr(truth, row.kind)
                off = (row.value - true) / row.std
                print(
                    f"; {row.kind} {row.value:.4f} +- {row.std:.4f}, true {true:.4f}, {off:+.1f} sd",
                    end="",
                )
                if learnt.verdict.value == "accepted":
                    found[row.kind].append((off, row.std))
        print(flush=True)
    results.table(
        "free_swings",
        {
            "unknown": "{unknown}",
            "accepted calibrations": "{accepted} of {asked}",
            "95 % intervals that hold": "{hold}",
            "farthest, in sd": "{farthest:.1f}",
            "standard deviation, median (of all)": "{std:.2g} ({std_from:.2g} to {std_to:.2g})",
        },
    )
    for kind, rows in found.items():
        if rows:
            pull, std = np.abs(np.array(rows)).T
            results.row(
                "free_swings", unknown=kind, accepted=len(rows), asked=options.arms, hold=int(np.sum(pull < Z95)),
                farthest=pull.max(), std=np.median(std), std_from=std.min(), std_to=std.max(),
            )  # fmt: skip
    results.keep()


if __name__ == "__main__":
    main()
