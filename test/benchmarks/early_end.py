"""What could ending a push early save? About the most that anybody could, who knew beforehand how each push turns out.

Random robots (in MuJoCo, see `until_sure.py`) weigh objects with chosen pushes until they are sure. Every push is then cut short in
hindsight: of all ends from 0.2 s on that is taken which saves most time, less the time that it takes to learn what was cut off in
later pushes, at the rate at which the whole weighing learns. Whoever decides while a push is under way can only save less.

    python test/benchmarks/early_end.py --robots 8
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pool

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from coverage import DIAMETER_M, facts_of
from random_arm import EFFECTS_DEFAULT, SPREAD, Load, ball, draw_robot
from results import Results, parser_of
from until_sure import MASSES_KG, Bench, calibrated

from proprio_ros.excitation.plans import Until, load_sequence
from proprio_ros.experiment_design.sequential import Known
from proprio_ros.experiment_design.until import UntilSure
from proprio_ros.records import Run
from proprio_ros.robot import Robot

EARLIEST_S = 0.2
STEP_S = 0.1


@dataclass(frozen=True)
class Case:
    """One weighing: what it took, for how long a joint was driven, and what ending pushes early would have saved [s]."""

    time_s: float
    driven_s: float
    saved_s: float
    pushes: int


def cut(run: Run, end_s: float) -> Run:
    """The run, had its current ended earlier."""
    kept = run.times_s <= end_s
    begun = run.input_times_s < end_s
    count = len(run.before_times_s) + int(kept.sum())
    return replace(
        run,
        times_s=run.times_s[kept],
        position=run.position[kept],
        input_times_s=run.input_times_s[begun],
        input_current_A=run.input_current_A[begun],
        duration_s=end_s,
        reported_effort=None if run.reported_effort is None else run.reported_effort[kept],
        held_position={joint: values[:count] for joint, values in run.held_position.items()},
        after_times_s=np.zeros(0),
        after_position=np.zeros(0),
    )


@dataclass(frozen=True)
class Pushed:
    """Pushes that were chosen one by one, and what was known before the first and after each.

    Attributes:
        runs: All runs that they took.
        states: What was known.
        ends: How many runs there were after each push.
        times_s: The arm's time after each push [s].
    """

    chooser: UntilSure
    runs: list[Run]
    states: list[Known]
    ends: list[int]
    times_s: list[float]


def one_robot(job: tuple[int, Until, Sequence[float]]) -> list[Case]:
    """What one robot's pushes would have spared, mass by mass."""
    seed, until, masses = job
    rng = np.random.default_rng(seed)
    hidden = draw_robot(rng, EFFECTS_DEFAULT, SPREAD)
    robot = calibrated(hidden, "shipped", rng)
    if robot is None:
        return []
    cases = []
    for mass in masses:
        sequence = replace(
            load_sequence("payload", robot),
            runs=(),
            until=until,
        )
        noise = np.random.default_rng([seed, round(1e6 * mass)])
        pushed = push_until_sure(robot, Bench(hidden, sequence, noise), ball(mass, DIAMETER_M))
        # after the first push, before which nothing is known and of which nobody would spare anything
        if len(pushed.ends) >= 2:
            made_s = sum(run.duration_s for run in pushed.runs)
            cases.append(Case(pushed.times_s[-1], made_s, spared_s(pushed), len(pushed.ends)))
    return cases


def push_until_sure(robot: Robot, bench: Bench, load: Load) -> Pushed:
    """Chooses pushes one by one until the target is met, or none helps."""
    chooser = UntilSure(robot, facts_of(load), bench.sequence)
    runs: list[Run] = []
    states = [chooser.known]
    ends = []
    times_s = []
    while (decision := chooser.next(runs, bench.pose, bench.time_s)).run is not None:
        if runs:
            states.append(chooser.known)
        runs += bench.push(decision.run, load)
        ends.append(len(runs))
        times_s.append(bench.time_s)
    states.append(chooser.known)
    return Pushed(chooser, runs, states, ends, times_s)


def spared_s(pushed: Pushed) -> float:
    """What the pushes after the first would have spared by ending when that is best [s]."""
    states = pushed.states
    lasted_s = pushed.times_s[-1] - pushed.times_s[0]
    rate = np.log(states[1].std / states[-1].std) / lasted_s
    return sum(spared_by(pushed, number, rate) for number in range(1, len(pushed.ends)))


def spared_by(pushed: Pushed, number: int, rate: float) -> float:
    """What one push would have spared at best [s].

    Args:
        pushed: All pushes.
        number: Which of them.
        rate: By how much the logarithm of the standard deviation falls, all in all [1/s].
    """
    before = pushed.runs[: pushed.ends[number] - 1]
    last = pushed.runs[pushed.ends[number] - 1]
    best = 0.0
    for end_s in np.arange(EARLIEST_S, last.duration_s - 1e-6, STEP_S):
        shorter = [*before, cut(last, float(end_s))]
        std = pushed.chooser.catalogue.known(shorter).std
        lost = max(float(np.log(std / pushed.states[number + 1].std)), 0.0)
        best = max(best, float(last.duration_s - end_s) - lost / max(rate, 1e-6))
    return best


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--first", type=int, default=4000, help="first seed")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
    )
    parser.add_argument(
        "--masses",
        type=float,
        nargs="+",
        default=MASSES_KG,
        help="[kg]",
    )
    parser.add_argument("--half", type=float, default=0.5e-3, help="target [kg]")
    parser.add_argument("--at-most", type=float, default=60.0, help="[s]")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    until = Until(options.half, "kg", options.at_most)
    with Pool(options.jobs) as pool:
        jobs = [
            (seed, until, options.masses)
            for seed in range(options.first, options.first + options.robots)
        ]
        cases = [case for found in pool.imap(one_robot, jobs) for case in found]
    time_s, driven_s, saved_s = (
        np.array([getattr(c, n) for c in cases]) for n in ("time_s", "driven_s", "saved_s")
    )
    results.table(
        "early_end",
        {
            "weighings of two pushes or more": "{weighings}",
            "median pushes": "{pushes:.0f}",
            "median time": "{time_s:.1f} s",
            "of which a joint is driven": "{driven:.0f} %",
            "ending pushes early saves at most, median": "{saved_s:.2f} s",
            "of all time": "{saved:.1f} %",
        },
    )
    if cases:
        results.row(
            "early_end", weighings=len(cases), pushes=np.median([c.pushes for c in cases]), time_s=np.median(time_s),
            driven=100.0 * driven_s.sum() / time_s.sum(), saved_s=np.median(saved_s), saved=100.0 * saved_s.sum() / time_s.sum(),
        )  # fmt: skip
    results.keep()


if __name__ == "__main__":
    main()
