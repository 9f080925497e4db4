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
from typing import Any

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
    """Blocks squeezed by one gripper until sure, and by the fixed sequence."""
    seed, until = job
    robot = calibrated(seed)
    rng = np.random.default_rng([seed, 5])
    cases = []
    for _ in range(BLOCKS):
        modulus = float(np.exp(rng.uniform(np.log(4e3), np.log(2e5))))
        ratio = float(rng.uniform(0.1, 0.4))
        block = SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=ratio, damping=0.5)
        cases.append(one_block(robot, seed, block, until))
    return cases


def one_block(robot: Robot, seed: int, block: SoftBlock, until: Until) -> Case:
    """A block squeezed until sure, and how long the fixed sequence takes to be as sure.

    Args:
        robot: The gripper, as it was calibrated.
        seed: Of the hidden one.
        block: What is between its fingers.
        until: The target.
    """
    modulus = block.youngs_modulus_Pa
    sequence = replace(load_sequence("block_until", ROBOT), until=until)
    runs, decision, decided, time_s = squeezed(
        robot,
        Hand(seed, block),
        sequence,
    )
    estimate = find_softness(robot, runs, FACTS)
    told = estimate.value("youngs_modulus")
    name = f"robot {seed}, {1e-3 * modulus:.0f} kPa"
    if estimate.verdict.value != "accepted" or not isinstance(told.value, float):
        print(f"{name}: {estimate.verdict.value}: {'; '.join(estimate.reasons)}", file=sys.stderr)
        return refused(modulus, len(runs), time_s, tuple(decided))
    half = half_of(estimate)
    fixed_s, reached = repeat_fixed(robot, Hand(seed, block), half)
    low, high = told.ci95
    case = Case(
        modulus, decision.ended_by, told.value / modulus - 1.0, half, low <= modulus <= high,
        half <= 1.0001 * until.half_interval, len(runs), time_s, fixed_s, reached, tuple(decided),
    )  # fmt: skip
    print(
        f"{name}: {100 * case.error:+.1f} +- {100 * half:.1f} % by {decision.ended_by}, {len(runs)} runs, {time_s:.0f} s, "
        f"fixed {fixed_s:.0f} s",
        file=sys.stderr,
    )
    return case


def refused(modulus: float, runs: int, time_s: float, decided_s: tuple[float, ...]) -> Case:
    """No answer: what would be measured of one is nan."""
    nan = float("nan")
    return Case(modulus, "refused", nan, nan, False, False, runs, time_s, nan, False, decided_s)


def repeat_fixed(robot: Robot, hand: Hand, half: float) -> tuple[float, bool]:
    """Makes the fixed sequence, squeeze by squeeze, until it is as sure or `FIXED_AT_MOST` runs are made.

    Args:
        robot: The gripper, as it was calibrated.
        hand: The hidden one, with the block.
        half: Half interval to reach, as a part of the modulus.

    Returns:
        How long that took [s], and whether it became as sure.
    """
    fixed = load_sequence("softness", ROBOT)
    runs = list[Run]()
    began = hand.time_s
    fixed_s = float("nan")
    while len(runs) < FIXED_AT_MOST:
        for probe in fixed.runs:
            runs += made(replace(fixed, runs=(probe,)), hand)[1]
            fixed_s = hand.time_s - began
            if half_of(find_softness(robot, runs, FACTS)) <= half:
                return fixed_s, True
    return fixed_s, False


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
    answered = [case for case in cases if case.ended_by != "refused"]
    if answered:
        ends = endings(case.ended_by for case in cases)
        results.row("block_until", asked=len(cases), ends=ends, **figures(answered))
    results.keep()


def figures(answered: Sequence[Case]) -> dict[str, Any]:
    """Counts; errors and half intervals in % of the modulus, times in s."""
    errors = [100.0 * case.error for case in answered]
    halves = [100.0 * case.half for case in answered]
    decided_s = np.concatenate([case.decided_s for case in answered])
    return {
        "answered": len(answered),
        "met": sum(case.met for case in answered),
        "half": 100.0 * np.median([case.half for case in answered]),
        "rms": 100.0 * np.sqrt(np.mean([case.error**2 for case in answered])),
        "hold": sum(case.holds for case in answered),
        "time_s": np.median([case.time_s for case in answered]),
        "runs": np.median([case.runs for case in answered]),
        "over_fixed": np.median([case.time_s / case.fixed_s for case in answered]),
        "never": sum(not case.fixed_reached for case in answered),
        "decided_s": np.median(decided_s) if len(decided_s) else 0.0,
        "longest_s": decided_s.max(initial=0.0),
        **each_answer(errors, halves),
    }


if __name__ == "__main__":
    main()
