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


def one_robot(
    job: tuple[int, str, float, float, float, Sequence[float]],
) -> tuple[list[Case], float, int, str]:
    seed, reference, hours, warm_K, times, masses = job
    rng = np.random.default_rng(seed)
    hidden = draw_robot(rng, EFFECTS_DEFAULT, SPREAD)
    fresh = calibrated(hidden, reference, rng)
    if fresh is None or fresh.calibration is None:
        return [], 0.0, 0, "not calibrated"
    warmer_K = rng.standard_normal(4) * warm_K
    made = Moment(MADE_S, dict.fromkeys(JOINTS, WARM_C))
    now = Moment(
        MADE_S + 3600.0 * hours, {j: WARM_C + k for j, k in zip(JOINTS, warmer_K, strict=True)}
    )
    stale = fresh.with_calibration(replace(fresh.calibration, made=made))
    stated = stale.drift
    truth = AgeingRates(**{name: times * value for name, value in vars(stated).items()})
    later = drifted(hidden, truth, hours, warmer_K.tolist(), rng)
    old = stale.with_calibration(aged(stale.calibration, stated, now))
    robots = {STALE: stale, AGED: old}
    sequence = load_sequence("empty_hand", fresh)
    bench = Bench(later, sequence, rng)
    pushes, _, _ = chosen_refresh(stale, old, REFRESH_S, sequence)
    learnt = (
        refresh(old, [LoadedRun(run) for probe in pushes for run in bench.push(probe, None)])
        if pushes
        else None
    )
    said = (
        "nothing to do" if learnt is None else f"{learnt.verdict.value} {'; '.join(learnt.reasons)}"
    )
    if learnt is None:
        robots[REFRESHED] = old
    elif learnt.calibration is not None and learnt.verdict.value == "accepted":
        robots[REFRESHED] = old.with_calibration(learnt.calibration)
    cases = weighings(hidden, {FRESH: stale}, masses, seed)
    try:
        cases += weighings(later, robots, masses, seed)
    except ProprioError as error:
        return cases, bench.time_s, len(pushes), str(error)
    return cases, bench.time_s, len(pushes), said


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
    jobs = [
        (s, o.reference, o.hours, o.warmer, o.times, o.masses)
        for s in range(o.first, o.first + o.robots)
    ]
    cases: list[Case] = []
    times = []
    counts = []
    with Pool(o.jobs) as pool:
        for seed, (found, time_s, count, said) in zip(
            range(o.first, o.first + o.robots), pool.imap(one_robot, jobs), strict=True
        ):
            print(
                f"  {seed}: refresh {count} pushes, {time_s:.0f} s, {said}",
                file=sys.stderr,
                flush=True,
            )
            cases += found
            if found:
                times.append(time_s)
                counts.append(count)
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
    for way in (FRESH, STALE, AGED, REFRESHED):
        of = [case for case in cases if case.way == way]
        answers = [case for case in of if np.isfinite(case.error)]
        if answers:
            name = way
            if way == REFRESHED:
                name = f"{way} (median {np.median(counts):.0f} pushes, {np.median(times):.0f} s)"
            results.row(
                "drift", calibration=name, answered=len(answers), asked=len(of),
                hold=100.0 * np.mean([c.holds for c in answers]), half=1e3 * np.median([c.half for c in answers]),
                rms=1e3 * np.sqrt(np.mean([c.error**2 for c in answers])),
                **each_answer([1e3 * c.error for c in answers], [1e3 * c.half for c in answers]),
            )  # fmt: skip
    results.keep()


if __name__ == "__main__":
    main()
