"""How often do the 95 % intervals hold? Random robots and objects in MuJoCo, calibrated and weighed as a user would.

Every robot makes empty-hand runs, half of them also runs with a 100 g reference; then it weighs one object of each mass. An
interval is compared with the truth, and its width with the Cramer-Rao bound: the inverse of the expected information of the same
runs, at the simulator's true values, under the same priors (van Trees 1968, sec. 2.4).

With one effect alone, the robot file knows that the others are absent, so that its interval is that effect's.

    python test/benchmarks/coverage.py                    # 500 robots with all effects, 60 with each effect alone; about 15 min
    python test/benchmarks/coverage.py --robots 20 --per-effect 0
"""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from multiprocessing import Pool

# one process per core, so no threads
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np
from random_arm import (
    EFFECTS,
    EMPTY_PROBES,
    GRIPPER,
    JOINTS,
    LINKS,
    LOADED_PROBES,
    SPREAD,
    HiddenRobot,
    Load,
    Probe,
    Spread,
    ball,
    draw_robot,
    record,
)
from results import Results, each_answer, parser_of

from proprio_ros.errors import ProprioError
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.identification.robot_unknowns import load_unknowns
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Z95
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

MASSES_KG = (0.01, 0.02, 0.05, 0.1)
REFERENCE_KG = 0.1
DIAMETER_M = 0.03
ALWAYS = ("quantised", "encoder_noise")
MATCHED = Spread(
    torque_constant=(0.0, 0.05),
    link_mass=(0.02, 0.01),
    armature=(0.004, 0.024),
    once_per_turn=(0.0, 0.002),
)
"""Robots drawn as the robot file says that they differ; friction and delay are uniform inside what it allows."""


OPEN = {
    "torque_constant": "torque_constant_N_m_per_A",
    "armature": "armature_kg_m2",
    "coulomb": "coulomb_N_m",
    "viscous": "viscous_N_m_s_per_rad",
    "load_friction": "load_friction",
    "stribeck": "stribeck",
    "zero": "zero_rad",
}
"""What the robot file leaves open of every drive train because of an effect."""
OPEN_OF_ALL = {
    "delay": ("delay_s",),
    "link_mass": ("arm_scale", "link_mass_std"),
    "link_shape": ("link_com_std_m", "link_inertia_std"),
    "run_torque": ("torque_disturbance_N_m",),
    "onset": ("onset_jitter_s",),
}


def robot_knowing(effects: Collection[str]) -> Robot:
    """The robot file of somebody who knows which effects are absent: what they would make uncertain is known exactly."""
    robot = load_robot("open_manipulator_x")
    changes: dict[str, object] = {}
    for effect, keys in OPEN_OF_ALL.items():
        if effect not in effects:
            for key in keys:
                changes[key] = (
                    0.0 if key.endswith(("std", "std_m", "jitter_s", "N_m")) else {"std": 0.0}
                )
    for joint in JOINTS:
        for effect, key in OPEN.items():
            if effect not in effects:
                changes[f"joints.{joint}.drive_train.{key}"] = {"std": 0.0}
        if "stribeck" not in effects:
            changes[f"joints.{joint}.drive_train.stribeck_velocity_rad_s"] = {"std": 0.0}
        if "once_per_turn" not in effects:
            changes[f"joints.{joint}.motor.encoder_once_per_turn_rad"] = 0.0
    return robot.with_overrides(changes)


@dataclass(frozen=True)
class Answer:
    """One weighing: error and standard deviation [kg], the bound on the latter, and whether the interval holds."""

    mass: float
    joint: str
    reference: bool
    error: float
    std: float
    bound: float
    holds: bool


def run_of(
    probe: Probe,
    hidden: HiddenRobot,
    load: Load | None,
    rng: np.random.Generator,
) -> Run:
    recording = record(
        hidden, probe.joint, probe.start, probe.current_A, probe.duration_s, load, rng
    )
    return cut_runs(recording, joints=[*JOINTS, GRIPPER])[0]


def facts_of(load: Load) -> PayloadFacts:
    return PayloadFacts(
        com=np.array(load.offset),
        shape=PayloadShape.from_inertia_per_mass([v / load.mass for v in load.inertia]),
    )


def true_values(
    hidden: HiddenRobot,
    problem: Problem,
    mass: float,
) -> np.ndarray:
    """The simulator's numbers for every unknown; what differs from run to run stays at its mean."""
    values = problem.base.copy()
    for row, unknown in enumerate(problem.unknowns):
        kind = unknown.kind
        owner = unknown.scope
        if owner in JOINTS:
            j = JOINTS.index(owner)
            wave = hidden.once_per_turn[j]
            truth = {
                "ripple_cos": wave * np.sin(hidden.phase[j]),
                "ripple_sin": wave * np.cos(hidden.phase[j]),
            }
            values[row] = truth[kind] if kind in truth else getattr(hidden, kind)[j]
        elif owner in LINKS:
            n = LINKS.index(owner)
            shift = dict(
                zip(("link_com_x", "link_com_y", "link_com_z"), hidden.link_com[n], strict=True)
            )
            truth = {
                "link_mass": hidden.link_mass_scale[n] - 1.0,
                "link_inertia": hidden.link_inertia_scale[n] - 1.0,
            }
            values[row] = {**truth, **shift}[kind]
        elif kind == "payload_mass":
            values[row] = mass
        elif kind == "delay":
            values[row] = hidden.delay_s
    return np.clip(
        values,
        [u.lower for u in problem.unknowns],
        [u.upper for u in problem.unknowns],
    )


def cramer_rao(
    robot: Robot,
    hidden: HiddenRobot,
    known: Sequence[PreparedRun],
    run: Run,
    load: Load,
    jitter_s: float,
) -> float:
    """Smallest standard deviation that any unbiased use of these runs and priors can have [kg]."""
    facts = facts_of(load)
    runs = [*known, prepare_run(robot, run, None, facts)]
    problem = Problem(
        robot,
        runs,
        facts,
        load_unknowns(robot, runs, facts, Role.ESTIMATED, load.mass),
    )
    values = true_values(hidden, problem, load.mass)
    _, v, dq = problem.simulate(
        values[None],
        problem.estimated,
    )
    reading = np.hypot(
        runs[0].drive.encoder_resolution / np.sqrt(12.0),
        hidden.encoder_noise,
    )
    sigma = np.hypot(reading, v[0] * jitter_s)
    rows = (dq[0] / sigma[..., None])[problem.weight > 0.0]
    information = rows.T @ rows + problem.coordinates.prior_precision
    scale = 1.0 / np.sqrt(np.diag(information))
    inverse = np.linalg.pinv(
        information * scale[:, None] * scale[None, :], rcond=1e-14, hermitian=True
    )
    return float(np.sqrt(inverse[0, 0]) * scale[0])


@dataclass(frozen=True)
class Calibrated:
    """A robot, and the runs by which it was calibrated.

    Attributes:
        file: The robot before, as its file describes it.
        reference: Whether a known weight was pushed, too.
    """

    file: Robot
    robot: Robot
    kept: list[PreparedRun]
    reference: bool


def one_robot(job: tuple[int, tuple[str, ...], Spread]) -> tuple[list[Answer], int, int]:
    """Answers of one robot, how many weighings were refused, and how many intervals were asked for."""
    seed, effects, spread = job
    rng = np.random.default_rng(seed)
    hidden = draw_robot(rng, effects, spread)
    calibrated = calibration_of(hidden, effects, rng, reference=seed % 2 == 1)
    if calibrated is None:
        return [], len(MASSES_KG), len(MASSES_KG)
    answers: list[Answer] = []
    for mass in MASSES_KG:
        try:
            answer = weighed(calibrated, hidden, mass, rng)
        except ProprioError as error:
            raise RuntimeError(f"seed {seed}, {mass} kg: {error}") from error
        if answer is not None:
            answers.append(answer)
    return answers, len(MASSES_KG) - len(answers), len(MASSES_KG)


def calibration_of(
    hidden: HiddenRobot,
    effects: tuple[str, ...],
    rng: np.random.Generator,
    *,
    reference: bool,
) -> Calibrated | None:
    """A robot calibrated by pushes of its empty hand; None where the calibration is refused.

    Args:
        hidden: The true robot.
        effects: What of it is open; where nothing is, nothing is calibrated.
        rng: Draws noise.
        reference: Whether a known weight is pushed, too.
    """
    robot = robot_knowing(effects)
    known = [LoadedRun(run_of(probe, hidden, None, rng)) for probe in EMPTY_PROBES]
    if reference:
        weight = ball(REFERENCE_KG, 0.04)
        load = KnownLoad(REFERENCE_KG, facts_of(weight))
        for probe in (LOADED_PROBES[1], LOADED_PROBES[2], LOADED_PROBES[5]):
            known.append(LoadedRun(run_of(probe, hidden, weight, rng), load))
    if set(effects).isdisjoint({*OPEN, *OPEN_OF_ALL, "once_per_turn"} - {"run_torque", "onset"}):
        return Calibrated(robot, robot, [], reference)
    learnt = calibrate(robot, known)
    if learnt.calibration is None or learnt.verdict.value != "accepted":
        return None
    used = {run["name"] for run in learnt.calibration.runs}
    kept = [prepare_run(robot, each.run, each.load) for each in known if each.run.name in used]
    return Calibrated(robot, robot.with_calibration(learnt.calibration), kept, reference)


def weighed(
    calibrated: Calibrated,
    hidden: HiddenRobot,
    mass: float,
    rng: np.random.Generator,
) -> Answer | None:
    """An object weighed by one push, beside the smallest standard deviation there is; None where it is refused.

    Args:
        calibrated: What is known of the robot.
        hidden: The true one.
        mass: Of the object [kg].
        rng: Draws the push and its noise.
    """
    probe = LOADED_PROBES[int(rng.integers(len(LOADED_PROBES)))]
    load = ball(mass, DIAMETER_M)
    run = run_of(probe, hidden, load, rng)
    value = weigh(calibrated.robot, [run], facts_of(load)).value("payload_mass")
    if value.value is None:
        return None
    low, high = value.ci95
    bound = cramer_rao(calibrated.file, hidden, calibrated.kept, run, load, hidden.stamp_jitter_s)
    return Answer(
        mass,
        probe.joint,
        calibrated.reference,
        value.value - mass,
        value.std,
        bound,
        bool(low <= mass <= high),
    )


def survey(
    results: Results,
    name: str,
    seeds: range,
    effects: Collection[str],
    jobs: int,
    spread: Spread,
) -> list[Answer]:
    """Weigh with many robots; one row on all of them."""
    with Pool(jobs) as pool:
        found_of = pool.imap_unordered(
            one_robot, [(seed, tuple(effects), spread) for seed in seeds], chunksize=2
        )
        answers = []
        refused = 0
        asked = 0
        for done, (found, no, of) in enumerate(found_of, start=1):
            answers += found
            refused += no
            asked += of
            if sys.stderr.isatty():
                print(f"\r{name}: {done} of {len(seeds)} robots", end="", file=sys.stderr)
    if sys.stderr.isatty():
        print("\r", end="", file=sys.stderr)
    row(results, name, answers, asked)
    return answers


def row(
    results: Results,
    name: str,
    answers: Sequence[Answer],
    asked: int | None = None,
) -> None:
    """One row of the table; none without answers."""
    if not answers:
        return
    error = np.array([a.error for a in answers])
    std = np.array([a.std for a in answers])
    bound = np.array([a.bound for a in answers])
    hits = float(np.mean([a.holds for a in answers]))
    margin = Z95 * np.sqrt(max(hits * (1.0 - hits), 1e-4) / len(answers))
    results.row(
        "coverage", robots=name, answered=len(answers), asked=asked, of="" if asked is None else f" of {asked}",
        hold=100.0 * hits, margin=100.0 * margin, rms=1e3 * np.sqrt(np.mean(error**2)), median=1e3 * np.median(np.abs(error)),
        half=1e3 * Z95 * np.median(std), over=np.median(std / bound), **each_answer(1e3 * error, 1e3 * Z95 * std),
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--robots", type=int, default=500, help="with all effects; 0 leaves them out"
    )
    parser.add_argument(
        "--per-effect", type=int, default=60, help="with each effect alone; 0 leaves them out"
    )
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
    )
    parser.add_argument(
        "--gentle", action="store_true", help="robots that differ less than the robot file allows"
    )
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    spread = SPREAD if options.gentle else MATCHED
    results.table(
        "coverage",
        {
            "robots": "{robots}",
            "answers": "{answered}{of}",
            "interval holds": "{hold:.1f} ± {margin:.1f} %",
            "rms error, g": "{rms:.2f}",
            "median error, g": "{median:.2f}",
            "median half interval, g": "{half:.2f}",
            "over bound": "{over:.2f}",
        },
    )
    if options.robots:
        seeds = range(options.first, options.first + options.robots)
        answers = survey(
            results, f"{options.robots}, all effects", seeds, EFFECTS, options.jobs, spread
        )
        for reference in (False, True):
            words = (
                f"with a {1e3 * REFERENCE_KG:.0f} g reference"
                if reference
                else "without a reference"
            )
            row(
                results,
                words,
                [a for a in answers if a.reference == reference],
            )
        for mass in MASSES_KG:
            row(
                results,
                f"{1e3 * mass:.0f} g",
                [a for a in answers if a.mass == mass],
            )
        for joint in sorted({a.joint for a in answers}):
            row(
                results,
                joint,
                [a for a in answers if a.joint == joint],
            )
    for effect in EFFECTS if options.per_effect else ():
        if effect not in ALWAYS:
            survey(
                results, effect, range(options.per_effect), (*ALWAYS, effect), options.jobs, spread
            )
    results.keep()


if __name__ == "__main__":
    main()
