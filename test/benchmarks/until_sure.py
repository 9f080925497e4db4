"""Weighing until sure: how long it takes, how often the target is met, and whether the intervals hold where it stops.

Random robots in MuJoCo (`random_arm.py`, which shares nothing with the package's simulator but the URDF) are calibrated by the
shipped empty-hand sequence alone (none), by further chosen pushes with an empty hand behind it (empty), by the shipped reference
sequence (100 g) behind it (shipped), or by further chosen pushes behind both (chosen).
They weigh objects: once with pushes that are chosen one by one, once with the shipped fixed sequence, repeated until its interval
is as small. Each push is made as the excitation node makes it: it ends after its time or its travel, and is repeated with more
current where it moved too little; ways, rests and brakes take the time that the node takes for them.

    python test/benchmarks/until_sure.py                # 24 robots, 10, 20, 50 and 100 g
    python test/benchmarks/until_sure.py --robots 4 --first 100 --reference chosen
"""

from __future__ import annotations

import json
import multiprocessing.pool
import os
import sys
import time
from argparse import Namespace
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing import Pool
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from coverage import DIAMETER_M, MATCHED, REFERENCE_KG, facts_of
from random_arm import (
    EFFECTS,
    EFFECTS_DEFAULT,
    GRIPPER,
    JOINTS,
    SPREAD,
    HiddenRobot,
    Load,
    ball,
    draw_robot,
    record,
)
from results import Results, each_answer, parser_of

from proprio_ros.errors import ProprioError
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence, Until, load_sequence
from proprio_ros.excitation.ways import approach_s
from proprio_ros.experiment_design.choosing import Decision
from proprio_ros.experiment_design.sequential import Catalogue
from proprio_ros.experiment_design.until import UntilSure, chosen_known
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Z95
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot

MASSES_KG = (0.01, 0.02, 0.05, 0.1)
CALIBRATION_KG, EMPTY_S, REFERENCE_S = 0.3e-3, 60.0, 120.0
"""Half interval that a chosen calibration is to make possible, and the time for it with an empty hand and with the reference."""
FIXED_AT_MOST = 24
AT_HOME = {"joint1": 0.0, "joint2": -1.05, "joint3": 0.35, "joint4": 0.7, GRIPPER: 0.0}


@dataclass
class Bench:
    """A random robot that makes pushes; time goes on as it would."""

    hidden: HiddenRobot
    sequence: ExcitationSequence
    rng: np.random.Generator

    def __post_init__(self) -> None:
        self.pose, self.time_s = dict(AT_HOME), 0.0

    def push(
        self,
        probe: ExcitationRun,
        load: Load | None,
    ) -> list[Run]:
        """A push and its repetitions, as the excitation node would make them."""
        runs: list[Run] = []
        current: float | None = probe.current_A
        start = {
            **self.pose,
            **{k: v for k, v in probe.start.items() if k != GRIPPER},
        }
        while current is not None:
            way = max(abs(start[name] - self.pose[name]) for name in JOINTS)
            self.time_s += float(approach_s(way, self.sequence.approach_velocity))
            self.time_s += self.sequence.settle_s + self.sequence.brake_s
            run = self._record(probe, start, current, probe.duration_s, load)
            travel = np.abs(run.position - start[probe.joint])
            if (travel >= probe.max_travel).any():  # made again, and ended where the node ends it
                ended = float(run.times_s[int(np.argmax(travel >= probe.max_travel))])
                run = self._record(
                    probe,
                    start,
                    current,
                    max(
                        0.025 * round(ended / 0.025),
                        0.1,
                    ),
                    load,
                )
            self.time_s += float(run.duration_s)
            runs.append(run)
            self.pose = {
                **start,
                probe.joint: float(run.position[-1]),
            }
            moved = float(np.abs(run.position - start[probe.joint]).max())
            current = probe.other_current(current) if moved < probe.min_travel else None
        return runs

    def _record(
        self,
        probe: ExcitationRun,
        start: Mapping[str, float],
        current: float,
        duration_s: float,
        load: Load | None,
    ) -> Run:
        recording = record(
            self.hidden, probe.joint, start, current, duration_s, load, self.rng,
            (probe.shake_A, probe.shake_period_s) if probe.shake_A else (0.0, 1.0),
        )  # fmt: skip
        return cut_runs(recording, joints=[*JOINTS, GRIPPER])[0]


@dataclass(frozen=True)
class Case:
    """One object weighed by one robot.

    Attributes:
        error, half: Of the chosen pushes' answer [kg]; holds: whether its interval does; met: whether the target is.
        time_s, fixed_s: Until then, and until the fixed sequence is as sure; fixed_reached: whether it was at all.
        fixed_half: Where it ended [kg].
        decided_s: Longest decision for a push, on the processor's clock.
    """

    mass: float
    reference: str
    ended_by: str
    error: float
    half: float
    holds: bool
    met: bool
    runs: int
    time_s: float
    fixed_s: float
    fixed_reached: bool
    fixed_half: float
    decided_s: float


def calibrated(
    hidden: HiddenRobot,
    reference: str,
    rng: np.random.Generator,
) -> Robot | None:
    """After the shipped empty-hand sequence, and a reference as the shipped sequence has it or as it is chosen."""
    robot = load_robot("open_manipulator_x")
    sequence = load_sequence("empty_hand", robot)
    bench = Bench(hidden, sequence, rng)
    known = [
        LoadedRun(run)
        for probe in sequence.runs
        if probe.joint != GRIPPER
        for run in bench.push(probe, None)
    ]
    weight = ball(REFERENCE_KG, 0.04)
    load = KnownLoad(REFERENCE_KG, facts_of(weight))
    if reference in ("shipped", "chosen"):
        for probe in load_sequence("reference", robot).runs:
            known += [LoadedRun(run, load) for run in bench.push(probe, weight)]
    learnt = calibrate(robot, known)
    if reference in ("empty", "chosen") and learnt.calibration is not None:
        began = bench.time_s
        count = len(known)
        so_far = robot.with_calibration(learnt.calibration)
        empty_s = EMPTY_S if reference == "chosen" else EMPTY_S + REFERENCE_S
        for probe in chosen_known(so_far, 0.0, CALIBRATION_KG, empty_s, sequence):
            known += [LoadedRun(run) for run in bench.push(probe, None)]
        if reference == "chosen":
            for probe in chosen_known(so_far, REFERENCE_KG, CALIBRATION_KG, REFERENCE_S, sequence):
                known += [LoadedRun(run, load) for run in bench.push(probe, weight)]
        print(f"  chosen: {len(known) - count} runs, {bench.time_s - began:.0f} s", file=sys.stderr)
        learnt = calibrate(robot, known)
    if learnt.calibration is None or learnt.verdict.value != "accepted":
        return None
    return robot.with_calibration(learnt.calibration)


@dataclass(frozen=True)
class Asked:
    """A calibrated robot with an object in its hand; its mass in kg."""

    seed: int
    robot: Robot
    hidden: HiddenRobot
    mass: float
    reference: str
    until: Until

    @property
    def load(self) -> Load:
        """The object: a ball."""
        return ball(self.mass, DIAMETER_M)

    @property
    def fixed(self) -> ExcitationSequence:
        """The shipped sequence."""
        return load_sequence("payload", self.robot)

    @property
    def open_end(self) -> ExcitationSequence:
        """The shipped sequence without its pushes: they are chosen."""
        return replace(self.fixed, runs=(), until=self.until)

    def bench(self, sequence: ExcitationSequence, *stream: int) -> Bench:
        """Where pushes are made, with noise of their own for each stream."""
        noise = np.random.default_rng([self.seed, round(1e6 * self.mass), *stream])
        return Bench(self.hidden, sequence, noise)

    def weigh(self, runs: Sequence[Run]) -> Estimate:
        """The object by so many runs."""
        return weigh(self.robot, runs, facts_of(self.load))


@dataclass(frozen=True)
class Chosen:
    """Pushes that were chosen one by one, until sure.

    Attributes:
        chooser: Who chose them.
        decision: The last, by which it ended.
        time_s: The arm's time for them [s].
        decided_s: The processor's longest time for a decision [s].
    """

    chooser: UntilSure
    decision: Decision
    runs: list[Run]
    time_s: float
    decided_s: float


def push_until_sure(asked: Asked) -> Chosen:
    """Chooses pushes one by one until the target is met, or none helps."""

    def whole(made: Sequence[Run]) -> float | None:
        std = asked.weigh(made).value("payload_mass").std
        return None if std is None else Z95 * std

    sequence = asked.open_end
    bench = asked.bench(sequence)
    runs: list[Run] = []
    decided = 0.0
    chooser = UntilSure(asked.robot, facts_of(asked.load), sequence, whole)
    while True:
        began = time.process_time()
        decision = chooser.next(runs, bench.pose, bench.time_s)
        if decision.run is None:
            break
        decided = max(decided, time.process_time() - began)
        runs += bench.push(decision.run, asked.load)
    return Chosen(chooser, decision, runs, bench.time_s, decided)


@dataclass(frozen=True)
class Fixed:
    """The fixed sequence, again and again: until when [s], whether it became as sure, and half its interval [kg]."""

    time_s: float
    reached: bool
    half: float


def repeat_fixed(asked: Asked, catalogue: Catalogue, half: float) -> Fixed:
    """Makes the fixed sequence until it is as sure, or `FIXED_AT_MOST` runs are made.

    Args:
        asked: Who makes it, and of what.
        catalogue: Says how sure runs make.
        half: Half interval to reach [kg].
    """
    bench = asked.bench(asked.fixed, 1)
    made: list[Run] = []
    after: list[tuple[int, float]] = []
    state, fixed_half = None, float("inf")

    def half_after(count: int) -> float:
        nonlocal state
        state = catalogue.known(
            made[:count],
            state if count == len(made) else None,
        )
        return Z95 * state.std

    pushes = asked.fixed.runs
    while fixed_half > half and len(made) < FIXED_AT_MOST:
        for probe in pushes:
            made += bench.push(probe, asked.load)
            after.append((len(made), bench.time_s))
        fixed_half = half_after(len(made))
    fixed_s = bench.time_s
    if fixed_half <= half:  # perhaps one or two pushes before
        for count, at_s in after[-2 : -len(pushes) - 1 : -1]:
            if count == 0 or half_after(count) > half:
                break
            fixed_s = at_s
    return Fixed(fixed_s, fixed_half <= half, fixed_half)


def one_case(asked: Asked) -> Case:
    """The object by chosen pushes, and how long the fixed sequence takes to be as sure."""
    chosen = push_until_sure(asked)
    estimate = asked.weigh(chosen.runs) if chosen.runs else None
    value = None if estimate is None else estimate.value("payload_mass")
    if value is None or value.value is None:
        said = (
            chosen.decision.reason
            if estimate is None
            else f"{estimate.verdict.value}: {'; '.join(estimate.reasons)}"
        )
        name = f"seed {asked.seed}, {1e3 * asked.mass:.0f} g, {asked.reference}"
        print(f"  {name}: {said}", file=sys.stderr)
        return refused(asked, chosen)
    low, high = value.ci95
    half = Z95 * value.std
    fixed = repeat_fixed(asked, chosen.chooser.catalogue, half)
    return Case(
        mass=asked.mass,
        reference=asked.reference,
        ended_by=chosen.decision.ended_by,
        error=value.value - asked.mass,
        half=half,
        holds=bool(low <= asked.mass <= high),
        met=half <= asked.until.half_interval * 1.0001,
        runs=len(chosen.runs),
        time_s=chosen.time_s,
        fixed_s=fixed.time_s,
        fixed_reached=fixed.reached,
        fixed_half=fixed.half,
        decided_s=chosen.decided_s,
    )


def refused(asked: Asked, chosen: Chosen) -> Case:
    """No answer: what would be measured of one is nan."""
    nan = float("nan")
    return Case(
        mass=asked.mass,
        reference=asked.reference,
        ended_by="refused",
        error=nan,
        half=nan,
        holds=False,
        met=False,
        runs=len(chosen.runs),
        time_s=chosen.time_s,
        fixed_s=nan,
        fixed_reached=False,
        fixed_half=nan,
        decided_s=chosen.decided_s,
    )


def one_robot(job: tuple[int, str, bool, bool, Until, Sequence[float]]) -> list[Case]:
    seed, reference, gentle, stribeck, until, masses = job
    rng = np.random.default_rng(seed)
    hidden = draw_robot(
        rng, EFFECTS if stribeck else EFFECTS_DEFAULT, SPREAD if gentle else MATCHED
    )
    robot = calibrated(hidden, reference, rng)
    if robot is None:
        return []
    cases = []
    for mass in masses:
        try:
            cases.append(one_case(Asked(seed, robot, hidden, mass, reference, until)))
        except ProprioError as error:
            print(f"seed {seed}, {mass} kg: {error}", file=sys.stderr)
    return cases


COLUMNS = {
    "calibration, mass": "{name}",
    "answers": "{answered} of {asked}",
    "target met": "{met:.0f} %",
    "median half interval, g": "{half:.2f}",
    "rms error, g": "{rms:.2f}",
    "interval holds": "{hold:.1f} %",
    "median time, s": "{time_s:.0f}",
    "runs": "{runs:.0f}",
    "time over fixed": "{over_fixed:.2f}{never_words}",
    "slowest decision, ms": "{decided_ms:.0f}",
    "ended by": "{ends}",
}


def row(
    results: Results,
    name: str,
    cases: Sequence[Case],
) -> None:
    """One row of the table; none without answers."""
    answered = [c for c in cases if c.ended_by != "refused"]
    if not answered:
        return
    error_g = 1e3 * np.array([c.error for c in answered])
    half_g = 1e3 * np.array([c.half for c in answered])
    time_s = np.array([c.time_s for c in answered])
    fixed_s = np.array([c.fixed_s for c in answered])
    never = sum(not c.fixed_reached for c in answered)
    results.row(
        "until_sure",
        name=name,
        answered=len(answered),
        asked=len(cases),
        met=100.0 * np.mean([c.met for c in answered]),
        half=np.median(half_g),
        rms=np.sqrt(np.mean(error_g**2)),
        hold=100.0 * np.mean([c.holds for c in answered]),
        time_s=np.median(time_s),
        runs=np.median([c.runs for c in answered]),
        over_fixed=np.median(time_s / fixed_s),
        never=never,
        never_words=f" (fixed never there: {never})" if never else "",
        decided_ms=1e3 * max(c.decided_s for c in answered),
        ends=endings(case.ended_by for case in cases),
        **each_answer(error_g, half_g),
    )


def endings(ended_by: Iterable[str]) -> str:
    """How often each came about, in words."""
    return ", ".join(f"{by} {count}" for by, count in Counter(ended_by).most_common())


def table(
    results: Results,
    reference: str,
    cases: Sequence[Case],
) -> None:
    """The rows of one way to calibrate."""
    row(results, f"reference {reference}", cases)
    for mass in sorted({case.mass for case in cases}):
        row(
            results,
            f"reference {reference}, {1e3 * mass:.0f} g",
            [case for case in cases if case.mass == mass],
        )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=24)
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
    )
    parser.add_argument(
        "--matched", action="store_true", help="robots that differ as much as the robot file allows"
    )
    parser.add_argument(
        "--stribeck", action="store_true", help="friction rises towards standstill, too"
    )
    parser.add_argument(
        "--masses",
        type=float,
        nargs="+",
        default=MASSES_KG,
        help="[kg]",
    )
    parser.add_argument(
        "--half-of-them", action="store_true", help="every second mass, in turn: half the time"
    )
    parser.add_argument("--save", type=Path, help="append each case to this file, as JSON")
    parser.add_argument(
        "--table", type=Path, help="print the table of such a file, and simulate nothing"
    )
    parser.add_argument("--reference", nargs="+", default=["none", "empty", "shipped", "chosen"])
    parser.add_argument("--half", type=float, default=0.5e-3, help="target [kg]")
    parser.add_argument("--at-most", type=float, default=60.0, help="[s]")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    results.table("until_sure", COLUMNS)
    if options.table:
        lines = [Case(**json.loads(row)) for row in options.table.read_text().splitlines()]
        for reference in options.reference:
            table(
                results,
                reference,
                [case for case in lines if case.reference == reference],
            )
    else:
        with Pool(options.jobs) as pool:
            for reference in options.reference:
                table(results, reference, weighed(pool, reference, options))
    results.keep()


def weighed(pool: multiprocessing.pool.Pool, reference: str, options: Namespace) -> list[Case]:
    """The cases of all robots that are calibrated in one way; kept in a file where that is asked for."""
    until = Until(options.half, "kg", options.at_most)
    jobs = [
        (
            seed,
            reference,
            not options.matched,
            options.stribeck,
            until,
            masses_of(seed, options.masses, options.half_of_them),
        )
        for seed in range(options.first, options.first + options.robots)
    ]
    cases = []
    for found in pool.imap_unordered(one_robot, jobs):
        cases += found
        if options.save:
            with options.save.open("a") as file:
                file.writelines(json.dumps(asdict(case)) + "\n" for case in found)
    return cases


def masses_of(seed: int, masses: Sequence[float], half_of_them: bool) -> Sequence[float]:
    """All masses [kg], or every second one: these of one robot and the others of the next."""
    return masses[seed % 2 :: 2] if half_of_them else masses


if __name__ == "__main__":
    main()
