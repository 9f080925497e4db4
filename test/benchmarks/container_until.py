"""A sphere in a box weighed until sure: how long it takes, how often the target is met, and whether the intervals hold.

Random robots, boxes and spheres in MuJoCo as in `spheres.py`, calibrated as in `until_sure.py`: by the shipped empty-hand sequence
alone, or with the shipped reference behind it. Each makes the fixed sequence `container` with an empty box, then weighs one sphere:
with pushes that are chosen one by one, and with the fixed sequence, repeated until it is as sure. Every fourth robot holds an empty
box once more. Pushes take the time that the excitation node takes for them.

    python test/benchmarks/container_until.py                   # 24 robots
    python test/benchmarks/container_until.py --robots 60 --reference shipped --jobs 1
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing import Pool
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from random_arm import HiddenRobot
from results import Results, each_answer, parser_of
from spheres import FACTS, Boxed, box, drawn
from until_sure import Bench, calibrated, endings

from proprio_ros.errors import ProprioError
from proprio_ros.excitation.plans import Until, load_sequence
from proprio_ros.identification.estimate import Estimate
from proprio_ros.probes.container.choosing import SphereUntilSure
from proprio_ros.probes.container.identify import find_sphere, half_of
from proprio_ros.probes.container.search import ContainerOptions
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot

FIXED_AT_MOST = 12
EMPTY_EVERY = 4
"""Every so manieth robot has an empty box, too."""


@dataclass(frozen=True)
class Case:
    """One sphere weighed by one robot; an empty box where ``mass`` is 0.

    Attributes:
        seed, mass: which robot, and the truth [kg].
        ended_by, verdict: of the chosen pushes, and of their answer; said: its reasons.
        error, half: of that answer [kg], nan where there is none; holds: whether the interval does; met: whether the target is.
        runs, time_s: until then.
        fixed_s: until the fixed sequence is as sure; fixed_reached: whether it was.
        fixed_error, fixed_half: of the fixed sequence's answer [kg], nan where there is none.
        decided_s: of each decision for a push, on the processor's clock; ended_s: of the one that ended it, which looks at all
            guesses once more.
    """

    seed: int
    mass: float
    reference: str
    ended_by: str
    verdict: str
    said: str
    error: float
    half: float
    holds: bool
    met: bool
    runs: int
    time_s: float
    fixed_s: float
    fixed_reached: bool
    fixed_error: float
    fixed_half: float
    decided_s: tuple[float, ...]
    ended_s: float


def answer_of(
    estimate: Estimate,
    mass: float,
) -> tuple[float, float]:
    """Error and half interval of an accepted answer [kg]."""
    value = estimate.value("sphere_mass").value
    half = half_of(estimate)
    return (
        (value - mass, half)
        if isinstance(value, float) and half is not None
        else (float("nan"), float("nan"))
    )


def one_case(
    robot: Robot,
    hidden: HiddenRobot,
    baseline: Sequence[Run],
    sphere: Boxed,
    reference: str,
    until: Until,
    seed: int,
    with_fixed: bool,
) -> Case:
    mass, options = sphere.sphere_kg, ContainerOptions()
    fixed = load_sequence("container", robot)
    sequence = replace(load_sequence("container_until", robot), until=until)

    found: dict[int, Estimate] = {}

    def find(runs: Sequence[Run]) -> Estimate:
        if len(runs) not in found:
            found[len(runs)] = find_sphere(
                robot,
                runs,
                FACTS,
                options,
                baseline,
            )
        return found[len(runs)]

    bench = Bench(
        hidden,
        sequence,
        np.random.default_rng([seed, round(1e6 * mass), 2]),
    )
    chooser = SphereUntilSure(
        robot, FACTS, options, sequence, baseline, lambda runs: half_of(find(runs))
    )
    runs: list[Run] = []
    decided: list[float] = []
    while True:
        began = time.process_time()
        decision = chooser.next(runs, bench.pose, bench.time_s)
        decided.append(time.process_time() - began)
        if decision.run is None:
            break
        runs += bench.push(decision.run, sphere)
    estimate = find(runs)
    error, half = answer_of(estimate, mass)
    # the fixed sequence, again and again
    other = Bench(
        hidden,
        fixed,
        np.random.default_rng([seed, round(1e6 * mass), 3]),
    )
    follower = SphereUntilSure(robot, FACTS, options, sequence, baseline)
    made: list[Run] = []
    reached = False
    found.clear()
    while with_fixed and not reached and len(made) < FIXED_AT_MOST:
        for probe in fixed.runs:
            made += other.push(probe, sphere)
        reached = follower.learn(made).std <= chooser.found.std
    fixed_error, fixed_half = answer_of(find(made), mass) if made else (float("nan"), float("nan"))
    return Case(
        seed, mass, reference, decision.ended_by, estimate.verdict.value, "; ".join(estimate.reasons[:2]), error, half,
        bool(abs(error) <= half), bool(half <= until.half_interval * 1.0001), len(runs), bench.time_s, other.time_s, reached,
        fixed_error, fixed_half, tuple(decided[:-1]), decided[-1],
    )  # fmt: skip


def one_robot(job: tuple[int, str, Until, int]) -> list[Case]:
    seed, reference, until, fixed_every = job
    rng, hidden, sphere = drawn(seed)
    robot = calibrated(hidden, reference, rng)
    if robot is None:
        print(f"seed {seed}: not calibrated", file=sys.stderr, flush=True)
        return []
    sequence = load_sequence("container", robot)
    bench = Bench(hidden, sequence, rng)
    baseline = [run for probe in sequence.runs for run in bench.push(probe, box())]
    cases = []
    for held in (sphere, box()) if seed % EMPTY_EVERY == 0 else (sphere,):
        try:
            case = one_case(
                robot,
                hidden,
                baseline,
                held,
                reference,
                until,
                seed,
                held is sphere and seed % fixed_every == 0,
            )
            cases.append(case)
            print(
                f"seed {seed}, {1e3 * case.mass:.1f} g, {reference}: {case.verdict}, off by {1e3 * case.error:+.2f} +- "
                f"{1e3 * case.half:.2f} g in {case.time_s:.0f} s, fixed {1e3 * case.fixed_error:+.2f} +- "
                f"{1e3 * case.fixed_half:.2f} g in {case.fixed_s:.0f} s, {case.ended_by}; {case.said}",
                file=sys.stderr, flush=True,
            )  # fmt: skip
        except ProprioError as error:
            print(
                f"seed {seed}, {1e3 * held.sphere_kg:.1f} g: {error}", file=sys.stderr, flush=True
            )
    return cases


COLUMNS = {
    "calibration": "{name}",
    "answers": "{answered} of {asked}",
    "target met": "{met:.0f} %",
    "median half interval, g": "{half:.2f}",
    "rms error, g": "{rms:.2f}",
    "interval holds": "{hold:.1f} %",
    "error over std, rms": "{pull:.2f}",
    "fixed: holds": "{fixed_hold:.1f} %",
    "median time, s": "{time_s:.0f}",
    "runs": "{runs:.0f}",
    "time over fixed": "{over_fixed:.2f}{never_words}",
    "decision, median and longest, s of CPU": "{decided_s:.2f}, {longest_s:.2f}",
    "the last, s of CPU": "{last_s:.1f}",
    "ended by": "{ends}",
}


def row(
    results: Results,
    name: str,
    cases: Sequence[Case],
) -> None:
    """One row of the table; none without answers."""
    answered = [case for case in cases if np.isfinite(case.error)]
    if not answered:
        return
    fixed = [case for case in answered if np.isfinite(case.fixed_error)]
    never = sum(not case.fixed_reached for case in fixed)
    decided = np.concatenate([case.decided_s for case in answered])
    results.row(
        "container_until", name=name, answered=len(answered), asked=len(cases),
        met=100.0 * np.mean([c.met for c in answered]), half=1e3 * np.median([c.half for c in answered]),
        rms=1e3 * np.sqrt(np.mean([c.error**2 for c in answered])), hold=100.0 * np.mean([c.holds for c in answered]),
        pull=Z95 * np.sqrt(np.mean([(c.error / c.half) ** 2 for c in answered])),
        fixed_hold=100.0 * np.mean([abs(c.fixed_error) <= c.fixed_half for c in fixed]) if fixed else None,
        time_s=np.median([c.time_s for c in answered]), runs=np.median([c.runs for c in answered]),
        over_fixed=np.median([c.time_s / c.fixed_s for c in fixed]) if fixed else None,
        never=never, never_words=f" (fixed never there: {never})" if never else "",
        decided_s=np.median(decided), longest_s=decided.max(initial=0.0),
        **each_answer([1e3 * c.error for c in answered], [1e3 * c.half for c in answered]),
        last_s=np.median([c.ended_s for c in answered]), ends=endings(case.ended_by for case in cases),
    )  # fmt: skip


def table(
    results: Results,
    cases: Sequence[Case],
    references: Sequence[str],
) -> None:
    results.table("container_until", COLUMNS)
    for reference in references:
        mine = [case for case in cases if case.reference == reference]
        row(
            results,
            f"reference {reference}",
            [case for case in mine if case.mass > 0.0],
        )
        row(
            results,
            f"reference {reference}, empty box",
            [case for case in mine if case.mass == 0.0],
        )
    results.keep()


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=24)
    parser.add_argument("--first", type=int, default=9000, help="first seed")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
    )
    parser.add_argument(
        "--reference", nargs="+", default=["none", "shipped"], choices=["none", "shipped"]
    )
    parser.add_argument("--half", type=float, default=2e-3, help="target [kg]")
    parser.add_argument("--at-most", type=float, default=60.0, help="[s]")
    parser.add_argument(
        "--fixed-every",
        type=int,
        default=1,
        help="make the fixed sequence with every so manieth robot",
    )
    parser.add_argument("--save", type=Path, help="append each case to this file, as JSON")
    parser.add_argument(
        "--table", type=Path, help="print the table of such a file, and simulate nothing"
    )
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    if options.table:
        table(
            results,
            [Case(**json.loads(row)) for row in options.table.read_text().splitlines()],
            options.reference,
        )
        return
    until = Until(options.half, "kg", options.at_most)
    cases: list[Case] = []
    seeds = range(options.first, options.first + options.robots)
    jobs = [
        (seed, reference, until, options.fixed_every)
        for seed in seeds
        for reference in options.reference
    ]
    with Pool(options.jobs) as pool:
        for found in pool.imap_unordered(one_robot, jobs):
            cases += found
            if options.save:
                with options.save.open("a") as file:
                    file.writelines(json.dumps(asdict(case)) + "\n" for case in found)
    table(results, cases, options.reference)


if __name__ == "__main__":
    main()
