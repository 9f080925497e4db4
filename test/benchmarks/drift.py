"""How long is a calibration good? Random robots whose friction and torque constants have drifted since.

Each robot (in MuJoCo, see `random_arm.py`) is calibrated by the shipped empty-hand sequence and the shipped reference sequence.
Then friction and torque constants change by hidden amounts, drawn as the robot file states them for the hours and degrees between.
It weighs objects by the shipped payload sequence: with the calibration taken as if nothing had changed, with the calibration aged
(see `proprio_ros/drift.py`), and with the calibration after a refresh, some empty-hand pushes that are chosen for it.

    python test/benchmarks/drift.py                         # 24 robots, a day later
    python test/benchmarks/drift.py --warmer 10 --times 2   # motors 10 K (rms) warmer or colder; drift twice as large as stated
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pool

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from coverage import DIAMETER_M, facts_of
from random_arm import EFFECTS_DEFAULT, JOINTS, SPREAD, HiddenRobot, ball, draw_robot
from results import Results, each_answer, parser_of
from until_sure import Bench, calibrated

from proprio_ros.calibration_files.drift import FRICTION, AgeingRates, aged
from proprio_ros.calibration_files.pushes import Moment
from proprio_ros.errors import ProprioError
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.experiment_design.until import chosen_refresh
from proprio_ros.identification.refresh import refresh
from proprio_ros.identification.robot_calibration import LoadedRun
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot

MASSES_KG = (0.01, 0.02, 0.05, 0.1)
MADE_S = 1.7e9
WARM_C = 35.0
REFRESH_S = 30.0
FRESH = "no drift"
STALE = "as if nothing had changed"
AGED = "aged"
REFRESHED = "after a refresh"


@dataclass(frozen=True)
class Case:
    """One weighing with one state of the calibration: error and half interval [kg], NaN where there is no answer."""

    way: str
    error: float
    half: float
    holds: bool


def drifted(
    hidden: HiddenRobot,
    drift: AgeingRates,
    hours: float,
    warmer_K: Sequence[float],
    rng: np.random.Generator,
) -> HiddenRobot:
    """The robot some time later."""

    def factors(name: str, common: bool) -> np.ndarray:
        by_time = drift.of(name, hours, 0.0)
        by_warmth = [drift.of(name, 0.0, k) * np.sign(k) for k in warmer_K]
        own = rng.standard_normal(4) * by_time + rng.standard_normal(4) * by_warmth
        if not common:
            return np.maximum(1.0 + own, 0.1)
        shared = rng.standard_normal() * by_time + rng.standard_normal() * np.array(by_warmth)
        return 1.0 + np.sqrt(0.5) * (own + shared)

    changed = {
        name: tuple(np.array(getattr(hidden, name)) * factors("friction", False))
        for name in FRICTION
    }
    changed["torque_constant"] = tuple(
        np.array(hidden.torque_constant) * factors("torque_constant", True)
    )
    return replace(hidden, **changed)


def weighings(
    hidden: HiddenRobot,
    robots: dict[str, Robot],
    masses: Sequence[float],
    seed: int,
) -> list[Case]:
    """Objects weighed by the same pushes with several states of the calibration."""
    cases = []
    for mass in masses:
        load = ball(mass, DIAMETER_M)
        facts = facts_of(load)
        robot = next(iter(robots.values()))
        sequence = load_sequence("payload", robot)
        bench = Bench(
            hidden,
            sequence,
            np.random.default_rng([seed, round(1e6 * mass)]),
        )
        runs: list[Run] = [run for probe in sequence.runs for run in bench.push(probe, load)]
        for way, known in robots.items():
            value = weigh(known, runs, facts).value("payload_mass")
            if value.value is None or value.ci95 is None:
                cases.append(
                    Case(
                        way,
                        float("nan"),
                        float("nan"),
                        False,
                    )
                )
                continue
            low, high = value.ci95
            cases.append(
                Case(
                    way,
                    value.value - mass,
                    Z95 * value.std,
                    bool(low <= mass <= high),
                )
            )
    return cases


@dataclass(frozen=True)
class Job:
    """What one robot is asked: hours and true drift as `main` says them, temperature change [K], masses [kg]."""

    seed: int
    reference: str
    hours: float
    warm_K: float
    times: float
    masses: Sequence[float]


@dataclass
class Drifted:
    """What became of one robot.

    Attributes:
        refresh_s: How long the pushes of its refresh took [s].
        pushes: How many they were.
        said: What came of them.
    """

    cases: list[Case]
    refresh_s: float
    pushes: int
    said: str


def one_robot(job: Job) -> Drifted:
    """A robot that is calibrated, drifts, is refreshed, and weighs before and after."""
    rng = np.random.default_rng(job.seed)
    hidden = draw_robot(rng, EFFECTS_DEFAULT, SPREAD)
    fresh = calibrated(hidden, job.reference, rng)
    if fresh is None or fresh.calibration is None:
        return Drifted([], 0.0, 0, "not calibrated")
    warmer_K = rng.standard_normal(4) * job.warm_K
    stale, old = aged_after(fresh, job.hours, warmer_K)
    truth = AgeingRates(**{name: job.times * value for name, value in vars(stale.drift).items()})
    later = drifted(hidden, truth, job.hours, warmer_K.tolist(), rng)
    taken = taken_refresh(stale, old, later, rng)
    robots = {STALE: stale, AGED: old}
    if taken.robot is not None:
        robots[REFRESHED] = taken.robot
    said = taken.said
    cases = weighings(hidden, {FRESH: stale}, job.masses, job.seed)
    try:
        cases += weighings(later, robots, job.masses, job.seed)
    except ProprioError as error:
        said = str(error)
    return Drifted(cases, taken.lasts_s, taken.pushes, said)


@dataclass(frozen=True)
class Refresh:
    """What a refresh took and taught.

    Attributes:
        robot: With what it taught; None where that was refused.
        said: Of it.
        lasts_s: How long its pushes took [s].
        pushes: How many they were.
    """

    robot: Robot | None
    said: str
    lasts_s: float
    pushes: int


def taken_refresh(
    stale: Robot,
    old: Robot,
    later: HiddenRobot,
    rng: np.random.Generator,
) -> Refresh:
    """The pushes that are chosen for a calibration, made by the robot as it is later.

    Args:
        stale: With the calibration as it was made.
        old: With the aged one.
        later: The robot that drifted.
        rng: Draws what its pushes have of their own.
    """
    sequence = load_sequence("empty_hand", stale)
    bench = Bench(later, sequence, rng)
    pushes, _, _ = chosen_refresh(stale, old, REFRESH_S, sequence)
    runs = [LoadedRun(run) for probe in pushes for run in bench.push(probe, None)]
    refreshed, said = after_refresh(old, runs)
    return Refresh(refreshed, said, bench.time_s, len(pushes))


def aged_after(fresh: Robot, hours: float, warmer_K: np.ndarray) -> tuple[Robot, Robot]:
    """With the calibration as it was made, and aged by so many hours and by the motors' change of temperature, (4,)."""
    assert fresh.calibration is not None
    made = Moment(MADE_S, dict.fromkeys(JOINTS, WARM_C))
    warm_C = {joint: WARM_C + more for joint, more in zip(JOINTS, warmer_K, strict=True)}
    now = Moment(MADE_S + 3600.0 * hours, warm_C)
    stale = fresh.with_calibration(replace(fresh.calibration, made=made))
    return stale, stale.with_calibration(aged(stale.calibration, stale.drift, now))


def after_refresh(old: Robot, runs: Sequence[LoadedRun]) -> tuple[Robot | None, str]:
    """The robot with what the pushes taught, None where that was refused, and what is said of it."""
    if not runs:
        return old, "nothing to do"
    learnt = refresh(old, list(runs))
    said = f"{learnt.verdict.value} {'; '.join(learnt.reasons)}"
    if learnt.calibration is not None and learnt.verdict.value == "accepted":
        return old.with_calibration(learnt.calibration), said
    return None, said


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=24)
    parser.add_argument("--first", type=int, default=3000, help="first seed")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
    )
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument(
        "--warmer",
        type=float,
        default=0.0,
        help="rms of the motors' temperature change, which is known [K]",
    )
    parser.add_argument(
        "--times",
        type=float,
        default=1.0,
        help="the true drift is so many times what the robot file states",
    )
    parser.add_argument("--reference", choices=["none", "shipped"], default="shipped")
    parser.add_argument(
        "--masses",
        type=float,
        nargs="+",
        default=MASSES_KG,
        help="[kg]",
    )
    o = parser.parse_args(arguments)
    results = Results(__file__, o.json, arguments)
    seeds = range(o.first, o.first + o.robots)
    jobs = [Job(seed, o.reference, o.hours, o.warmer, o.times, o.masses) for seed in seeds]
    tell(results, asked(jobs, o.jobs))
    results.keep()


def asked(jobs: Sequence[Job], processes: int) -> list[Drifted]:
    """Every robot, in so many processes; each is told of when it is done."""
    found = []
    with Pool(processes) as pool:
        for job, each in zip(jobs, pool.imap(one_robot, jobs), strict=True):
            print(
                f"  {job.seed}: refresh {each.pushes} pushes, {each.refresh_s:.0f} s, {each.said}",
                file=sys.stderr,
                flush=True,
            )
            found.append(each)
    return found


def tell(results: Results, robots: Sequence[Drifted]) -> None:
    """A row for each state of the calibration."""
    results.table(
        "drift",
        {
            "calibration": "{calibration}",
            "answers": "{answered} of {asked}",
            "interval holds": "{hold:.0f} %",
            "median half interval, g": "{half:.2f}",
            "rms error, g": "{rms:.2f}",
        },
    )
    weighed = [robot for robot in robots if robot.cases]
    cases = [case for robot in weighed for case in robot.cases]
    for way in (FRESH, STALE, AGED, REFRESHED):
        name = way
        if way == REFRESHED and weighed:
            pushes = np.median([robot.pushes for robot in weighed])
            refresh_s = np.median([robot.refresh_s for robot in weighed])
            name = f"{way} (median {pushes:.0f} pushes, {refresh_s:.0f} s)"
        row(results, name, [case for case in cases if case.way == way])


def row(results: Results, name: str, cases: Sequence[Case]) -> None:
    """One row of the table; none without answers."""
    answers = [case for case in cases if np.isfinite(case.error)]
    if not answers:
        return
    errors_g = [1e3 * case.error for case in answers]
    halves_g = [1e3 * case.half for case in answers]
    results.row(
        "drift",
        calibration=name,
        answered=len(answers),
        asked=len(cases),
        hold=100.0 * np.mean([case.holds for case in answers]),
        half=1e3 * np.median([case.half for case in answers]),
        rms=1e3 * np.sqrt(np.mean([case.error**2 for case in answers])),
        **each_answer(errors_g, halves_g),
    )


if __name__ == "__main__":
    main()
