"""Squeezing until sure: how long it takes, how often the target is met, and whether the intervals hold where it stops.

Random virtual grippers (MuJoCo, hidden torque constant, friction, armature, delay and encoder errors) learn themselves on four runs
with nothing between their fingers. Each squeezes two blocks that obey a law in closed form: with currents that are chosen one by
one, and by the shipped sequence `softness`, again and again until its answer is as sure.

    python test/benchmarks/block_until.py                   # 12 robots, 24 blocks
    python test/benchmarks/block_until.py --robots 4 --first 300 --half 0.15
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pool

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from results import Results, each_answer, parser_of
from support.hand import ROBOT, Hand
from support.squeezing import EDGE_M, GAP_M, calibrated, made
from until_sure import endings

from proprio_ros.excitation.plans import ExcitationSequence, Until, load_sequence
from proprio_ros.experiment_design.choosing import Decision
from proprio_ros.identification.estimate import Estimate
from proprio_ros.probes import probe_named
from proprio_ros.probes.softness import SoftnessJob
from proprio_ros.probes.softness.identify import SqueezeOptions, find_softness
from proprio_ros.probes.softness.problem import BlockFacts
from proprio_ros.probes.softness.virtual_object import SoftBlock
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot

FIXED_AT_MOST = 12
"""Squeezes of the fixed sequence."""
BLOCKS = 2
"""That each robot squeezes."""
FACTS = BlockFacts(np.full(3, EDGE_M))


@dataclass(frozen=True)
class Case:
    """One block squeezed by one robot.

    Attributes:
        error, half: Of the answer, as shares of the modulus; holds: whether its interval does; met: whether the target is.
        time_s, fixed_s: Until then, and until the fixed sequence is as sure; fixed_reached: whether it was at all.
        decided_s: What decisions for a squeeze took on the processor's clock.
    """

    modulus: float
    ended_by: str
    error: float
    half: float
    holds: bool
    met: bool
    runs: int
    time_s: float
    fixed_s: float
    fixed_reached: bool
    decided_s: tuple[float, ...]


def squeezed(
    robot: Robot, hand: Hand, sequence: ExcitationSequence
) -> tuple[list[Run], Decision, list[float], float]:
    """The runs of a block that is squeezed until sure, how it ended, what deciding took, and how long it lasted [s]."""
    chooser = probe_named("softness").chooser(
        robot,
        SoftnessJob(FACTS, SqueezeOptions()),
        sequence,
    )
    began = hand.time_s
    decided = []
    runs = list(made(replace(sequence, until=None), hand)[1])
    while True:
        before = time.process_time()
        decision = chooser.next(
            runs,
            hand.sample().position,
            hand.time_s - began,
        )
        if decision.run is None:
            return runs, decision, decided, hand.time_s - began
        decided.append(time.process_time() - before)
        runs += made(chooser.sequence_of(decision.run), hand)[1]


def half_of(estimate: Estimate) -> float:
    """Half of the 95 % interval of the modulus, as a share of it; infinite where there is no answer."""
    told = estimate.value("youngs_modulus")
    if not isinstance(told.value, float) or not isinstance(told.std, float):
        return float("inf")
    return Z95 * told.std / told.value


def one_robot(job: tuple[int, Until]) -> list[Case]:
    seed, until = job
    robot = calibrated(seed)
    rng = np.random.default_rng([seed, 5])
    sequence = replace(load_sequence("block_until", ROBOT), until=until)
    cases = []
    for _ in range(BLOCKS):
        modulus = float(np.exp(rng.uniform(np.log(4e3), np.log(2e5))))
        ratio = float(rng.uniform(0.1, 0.4))
        block = SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=ratio, damping=0.5)
        runs, decision, decided, time_s = squeezed(
            robot,
            Hand(seed, block),
            sequence,
        )
        estimate = find_softness(robot, runs, FACTS)
        half = half_of(estimate)
        told = estimate.value("youngs_modulus")
        answered = estimate.verdict.value == "accepted" and isinstance(told.value, float)
        name = f"robot {seed}, {1e-3 * modulus:.0f} kPa"
        if not answered or not isinstance(told.value, float):
            print(
                f"{name}: {estimate.verdict.value}: {'; '.join(estimate.reasons)}", file=sys.stderr
            )
            nan = float("nan")
            cases.append(
                Case(
                    modulus,
                    "refused",
                    nan,
                    nan,
                    False,
                    False,
                    len(runs),
                    time_s,
                    nan,
                    False,
                    tuple(decided),
                )
            )
            continue
        other = Hand(seed, block)
        fixed = load_sequence("softness", ROBOT)
        fixed_runs = list[Run]()
        reached = False
        began = other.time_s
        fixed_s = float("nan")
        while not reached and len(fixed_runs) < FIXED_AT_MOST:
            for probe in fixed.runs:
                fixed_runs += made(replace(fixed, runs=(probe,)), other)[1]
                fixed_s = other.time_s - began
                reached = half_of(find_softness(robot, fixed_runs, FACTS)) <= half
                if reached:
                    break
        low, high = told.ci95
        cases.append(
            Case(
                modulus, decision.ended_by, told.value / modulus - 1.0, half, low <= modulus <= high,
                half <= 1.0001 * until.half_interval, len(runs), time_s, fixed_s, reached, tuple(decided),
            )
        )  # fmt: skip
        print(
            f"{name}: {100 * cases[-1].error:+.1f} +- {100 * half:.1f} % by {decision.ended_by}, {len(runs)} runs, {time_s:.0f} s, "
            f"fixed {fixed_s:.0f} s",
            file=sys.stderr,
        )
    return cases


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--first", type=int, default=200, help="first seed")
    parser.add_argument(
        "--half", type=float, default=0.2, help="half interval asked for, as a share of the modulus"
    )
    parser.add_argument("--at-most", type=float, default=30.0, help="[s]")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    until = Until(options.half, "1", options.at_most)
    seeds = range(options.first, options.first + options.robots)
    with Pool(options.jobs) as pool:
        cases = [
            case
            for found in pool.imap(one_robot, [(seed, until) for seed in seeds])
            for case in found
        ]
    answered = [case for case in cases if case.ended_by != "refused"]
    results.table(
        "block_until",
        {
            "answers": "{answered} of {asked}",
            "target met": "{met}",
            "median half interval": "{half:.1f} %",
            "rms error": "{rms:.1f} %",
            "interval holds": "{hold}",
            "median time": "{time_s:.0f} s",
            "runs": "{runs:.0f}",
            "time over fixed": "{over_fixed:.2f} (fixed never there: {never})",
            "decided in, median, largest": "{decided_s:.2f} s, {longest_s:.1f} s",
            "ended by": "{ends}",
        },
    )
    if answered:
        decided = np.concatenate([case.decided_s for case in answered])
        results.row(
            "block_until", answered=len(answered), asked=len(cases), met=sum(c.met for c in answered),
            half=100.0 * np.median([c.half for c in answered]), hold=sum(c.holds for c in answered),
            rms=100.0 * np.sqrt(np.mean([c.error**2 for c in answered])), time_s=np.median([c.time_s for c in answered]),
            runs=np.median([c.runs for c in answered]), over_fixed=np.median([c.time_s / c.fixed_s for c in answered]),
            never=sum(not c.fixed_reached for c in answered), decided_s=np.median(decided) if len(decided) else 0.0,
            longest_s=decided.max(initial=0.0), ends=endings(case.ended_by for case in cases),
            **each_answer([100.0 * c.error for c in answered], [100.0 * c.half for c in answered]),
        )  # fmt: skip
    results.keep()


if __name__ == "__main__":
    main()
