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
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from random_arm import HiddenRobot
from results import Results, each_answer, parser_of
from spheres import FACTS, Boxed, box, drawn
from until_sure import Bench, calibrated, endings

from proprio_ros.errors import ProprioError
from proprio_ros.excitation.plans import ExcitationSequence, Until, load_sequence
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


@dataclass(frozen=True)
class Asked:
    """A calibrated robot with a sphere in its hand.

    Attributes:
        baseline: Its runs with an empty box.
        reference: What it was calibrated with.
    """

    seed: int
    robot: Robot
    hidden: HiddenRobot
    baseline: Sequence[Run]
    sphere: Boxed
    reference: str
    until: Until

    @property
    def sequence(self) -> ExcitationSequence:
        """The pushes to choose from."""
        return replace(load_sequence("container_until", self.robot), until=self.until)

    def bench(self, sequence: ExcitationSequence, stream: int) -> Bench:
        """Where pushes are made, with noise of their own for each stream."""
        noise = np.random.default_rng([self.seed, round(1e6 * self.sphere.sphere_kg), stream])
        return Bench(self.hidden, sequence, noise)

    def find(self, runs: Sequence[Run]) -> Estimate:
        """The sphere by so many runs."""
        return find_sphere(self.robot, runs, FACTS, ContainerOptions(), self.baseline)


@dataclass(frozen=True)
class Chosen:
    """The pushes that were chosen one by one, until sure.

    Attributes:
        time_s: The arm's time for them [s].
        decided_s: The processor's time for each decision [s]; the last one ended it.
        std_kg: What the last decision promised [kg].
    """

    estimate: Estimate
    runs: int
    time_s: float
    decided_s: tuple[float, ...]
    ended_by: str
    std_kg: float


def push_until_sure(asked: Asked) -> Chosen:
    """Chooses pushes one by one until the target is met, or none helps."""
    found: dict[int, Estimate] = {}

    def find(runs: Sequence[Run]) -> Estimate:
        if len(runs) not in found:
            found[len(runs)] = asked.find(runs)
        return found[len(runs)]

    bench = asked.bench(asked.sequence, 2)
    chooser = SphereUntilSure(
        asked.robot,
        FACTS,
        ContainerOptions(),
        asked.sequence,
        asked.baseline,
        lambda runs: half_of(find(runs)),
    )
    runs: list[Run] = []
    decided: list[float] = []
    while True:
        began = time.process_time()
        decision = chooser.next(runs, bench.pose, bench.time_s)
        decided.append(time.process_time() - began)
        if decision.run is None:
            break
        runs += bench.push(decision.run, asked.sphere)
    return Chosen(
        find(runs),
        len(runs),
        bench.time_s,
        tuple(decided),
        decision.ended_by,
        chooser.found.std,
    )


@dataclass(frozen=True)
class Fixed:
    """The fixed sequence, again and again; error and half interval [kg] are nan where it was not asked."""

    time_s: float
    reached: bool
    error: float
    half: float


def repeat_fixed(asked: Asked, std_kg: float, wanted: bool) -> Fixed:
    """Makes the fixed sequence until it is as sure, or `FIXED_AT_MOST` runs are made.

    Args:
        asked: Who makes it, and of what.
        std_kg: The standard deviation to reach [kg].
        wanted: Whether it is made at all.
    """
    fixed = load_sequence("container", asked.robot)
    bench = asked.bench(fixed, 3)
    follower = SphereUntilSure(
        asked.robot, FACTS, ContainerOptions(), asked.sequence, asked.baseline
    )
    made: list[Run] = []
    reached = False
    while wanted and not reached and len(made) < FIXED_AT_MOST:
        for probe in fixed.runs:
            made += bench.push(probe, asked.sphere)
        reached = follower.learn(made).std <= std_kg
    if not made:
        return Fixed(bench.time_s, reached, float("nan"), float("nan"))
    error, half = answer_of(asked.find(made), asked.sphere.sphere_kg)
    return Fixed(bench.time_s, reached, error, half)


def one_case(asked: Asked, with_fixed: bool) -> Case:
    """The sphere by chosen pushes, and by the fixed sequence where that is wanted."""
    mass = asked.sphere.sphere_kg
    chosen = push_until_sure(asked)
    fixed = repeat_fixed(asked, chosen.std_kg, with_fixed)
    error, half = answer_of(chosen.estimate, mass)
    return Case(
        seed=asked.seed,
        mass=mass,
        reference=asked.reference,
        ended_by=chosen.ended_by,
        verdict=chosen.estimate.verdict.value,
        said="; ".join(chosen.estimate.reasons[:2]),
        error=error,
        half=half,
        holds=bool(abs(error) <= half),
        met=bool(half <= asked.until.half_interval * 1.0001),
        runs=chosen.runs,
        time_s=chosen.time_s,
        fixed_s=fixed.time_s,
        fixed_reached=fixed.reached,
        fixed_error=fixed.error,
        fixed_half=fixed.half,
        decided_s=chosen.decided_s[:-1],
        ended_s=chosen.decided_s[-1],
    )


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
                Asked(seed, robot, hidden, baseline, held, reference, until),
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
    results.row(
        "container_until",
        name=name,
        answered=len(answered),
        asked=len(cases),
        **chosen_figures(answered),
        **fixed_figures([case for case in answered if np.isfinite(case.fixed_error)]),
        ends=endings(case.ended_by for case in cases),
    )


def chosen_figures(answered: Sequence[Case]) -> dict[str, Any]:
    """Of the chosen pushes: parts in %, masses in g, times in s."""
    errors_g = [1e3 * case.error for case in answered]
    halves_g = [1e3 * case.half for case in answered]
    decided_s = np.concatenate([case.decided_s for case in answered])
    return {
        "met": 100.0 * np.mean([case.met for case in answered]),
        "half": 1e3 * np.median([case.half for case in answered]),
        "rms": 1e3 * np.sqrt(np.mean([case.error**2 for case in answered])),
        "hold": 100.0 * np.mean([case.holds for case in answered]),
        "pull": Z95 * np.sqrt(np.mean([(case.error / case.half) ** 2 for case in answered])),
        "time_s": np.median([case.time_s for case in answered]),
        "runs": np.median([case.runs for case in answered]),
        "decided_s": np.median(decided_s),
        "longest_s": decided_s.max(initial=0.0),
        "last_s": np.median([case.ended_s for case in answered]),
        **each_answer(errors_g, halves_g),
    }


def fixed_figures(fixed: Sequence[Case]) -> dict[str, Any]:
    """Of the fixed sequence beside them: how often its interval holds [%], and the chosen pushes' time over its own."""
    never = sum(not case.fixed_reached for case in fixed)
    holds = [abs(case.fixed_error) <= case.fixed_half for case in fixed]
    return {
        "fixed_hold": 100.0 * np.mean(holds) if fixed else None,
        "over_fixed": np.median([case.time_s / case.fixed_s for case in fixed]) if fixed else None,
        "never": never,
        "never_words": f" (fixed never there: {never})" if never else "",
    }


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
