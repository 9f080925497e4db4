"""How soon an arm at work notices what it picks up and puts down, and how well it weighs it.

    python test/benchmarks/running.py [--arms 4] [--first 1] [--sensing 12] [--minutes 5]

Arms with torque sensing (`--sensing`) are drawn at random, of six and seven joints, at 100, 200 and 500 Hz: MuJoCo's inverse
dynamics along moves from pose to pose, noise, friction, drift and scale of each sensor of their own
(`support/sensing_arm.py`). Empty for twice 30 s, which calibrate; then each works ten times with 0.1 to 2 kg for 5 s and
without for 5 s; the rest of its minutes with nothing, and with 1 kg, shows false changes; half a minute goes on 0.8 rad
beside the poses of the calibration. How late a change is noticed counts while the arm moves. The bound is how long somebody
who knew the arm exactly, but for noise and drift of its sensors, would have to look until 6 standard deviations tell 0.1 kg.

Virtual OpenManipulator-X (`--arms`):

Each arm moves from pose to pose under its servos' position controller: empty for twice 30 s, which calibrate it, then for some ten
seconds each with nothing, 50 g, nothing, 20 g (every second arm 100 g) and nothing. An object comes and goes in the middle of a
motion. Half intervals count from 3 s after a change on.
"""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from results import Results, parser_of
from support.sensing_arm import Load, SensingArm, write_sensing_arm
from support.virtual_pick_and_place import Worker
from threadpoolctl import threadpool_limits

from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.identification.regression.online import (
    STEP_SIGMAS,
    OnlineEstimate,
    OnlineEstimator,
)
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot

EMPTY_S, PART_S = 30.0, 10.0
"""How long each motion lasts that calibrates, and each part of a day at least."""
Day = tuple[list[Motion], list[tuple[float, Motion]]]


def work(robot: Robot, seed: int) -> Day:
    """Empty motions, and the parts of a working day with the mass that is held."""
    arm = Worker(robot, seed)
    rng = np.random.default_rng(seed)
    empty = [arm.work(EMPTY_S) for _ in range(2)]
    masses = (0.0, 0.05, 0.0, 0.02 if seed % 2 else 0.1, 0.0)
    return empty, [(mass, arm.work(PART_S + rng.uniform(0.0, 1.0), mass)) for mass in masses]


def watch(
    robot: Robot,
    day: Day,
) -> tuple[np.ndarray, list[float], int, float]:
    """Mass, error and half interval [kg] in rows; how late each change was noticed [s]; false changes; CPU per second of data."""
    empty, parts = day
    weight = OnlineEstimator(
        robot,
        fit_empty(robot, empty),
        held={"gripper_left_joint": 0.0},
    )
    rows = []
    late = []
    false = 0
    samples = 0
    begun_s = time.process_time()
    before = False
    for number, (mass, part) in enumerate(parts):
        noticed = number == 0
        for time_s, position, current in zip(
            part.times_s, part.position, part.current_A, strict=True
        ):
            samples += 1
            estimate = weight.estimate() if weight.add(float(time_s), position, current) else None
            if estimate is None:
                continue
            into_s = float(time_s - part.times_s[0])
            if estimate.changed and not before:
                if noticed:
                    false += 1
                else:
                    late.append(into_s)
                noticed = True
            before = estimate.changed
            if into_s > 3.0:
                rows.append(
                    (
                        mass,
                        estimate.mass_kg - mass,
                        0.5 * (estimate.ci95_kg[1] - estimate.ci95_kg[0]),
                    )
                )
        late += [] if noticed else [np.inf]
    return np.array(rows), late, false, (time.process_time() - begun_s) / (0.01 * samples)


# --- arms with torque sensing ------------------------------------------------------------------------------------------

RATES_HZ = (100.0, 200.0, 500.0)
MASSES_KG = (0.1, 0.2, 0.5, 1.0, 2.0)
SOON_S = 0.5
ELSEWHERE_RAD = 0.8


@dataclass
class Sensed:
    """What arms showed: how late changes were seen [s], by mass; errors and half widths [kg] in rows; false changes, hours, CPU."""

    late: dict[float, list[float]] = field(default_factory=lambda: {mass: [] for mass in MASSES_KG})
    soon: list[tuple[float, float, float]] = field(default_factory=list)
    later: list[tuple[float, float, float]] = field(default_factory=list)
    elsewhere: list[tuple[float, float, float]] = field(default_factory=list)
    known_s: list[float] = field(default_factory=list)
    bound_s: list[float] = field(default_factory=list)
    false: int = 0
    hours: float = 0.0
    cpu: float = 0.0


def told_by(
    weight: OnlineEstimator, motion: Motion, begun_s: float
) -> Iterator[tuple[float, OnlineEstimate]]:
    """When each estimate came, in seconds of the motion."""
    for time_s, position, effort in zip(
        motion.times_s.tolist(), motion.position, motion.current_A, strict=True
    ):
        if (
            weight.add(begun_s + time_s, position, effort)
            and (estimate := weight.estimate()) is not None
        ):
            yield time_s, estimate


def bound_s(arm: SensingArm, mass_kg: float = 0.1) -> float:
    """Median over poses of the time until a step shows by `STEP_SIGMAS`, where only noise and drift are unknown [s]."""
    weight = [arm.weight_per_kg() for _ in range(50)]
    told = []
    gains = np.array([1.0 - np.exp(-2.0 / arm.rate_Hz / arm.drift_s)]) * arm.drift**2
    keeps = np.exp(-1.0 / arm.rate_Hz / arm.drift_s)
    settled = arm.drift**2
    for _ in range(2000):
        variance = keeps**2 * settled + gains[0]
        settled = variance * arm.noise**2 / (variance + arm.noise**2)
    for per_kg in weight:
        variance = settled
        answer = np.zeros(arm.joints)
        information = 0.0
        samples = 0
        while samples < 20000 and information <= STEP_SIGMAS**2:
            variance = keeps**2 * variance + gains[0]
            spread = variance + arm.noise**2
            innovation = mass_kg * per_kg - keeps * answer
            answer = keeps * answer + variance / spread * innovation
            information += float(np.sum(innovation**2 / spread))
            samples += 1
            variance = variance * arm.noise**2 / spread
        told.append(samples / arm.rate_Hz)
    return float(np.median(told))


def moving_s(motion: Motion, since_s: float, until_s: float) -> float:
    """How long the arm moved between two instants [s]; at rest friction may carry anything."""
    inside = (motion.times_s >= since_s) & (motion.times_s <= until_s)
    speed = np.abs(
        np.gradient(
            motion.position,
            motion.times_s,
            axis=0,
        )
    ).max(axis=1)
    return float(np.mean(speed[inside] > 0.1) * (until_s - since_s))


Changes = list[tuple[float, Load | None]]
"""When what the arm carries changes, in seconds of a motion, and to what; None is an empty hand."""


@dataclass
class Part:
    """A part of an arm's working day.

    Attributes:
        motion: As it was recorded.
        changes: What was taken and laid down in it.
        rows: Where mass, error and half width [kg] of its estimates go.
    """

    motion: Motion
    changes: Changes
    rows: list[tuple[float, float, float]]


def sense(seed: int, minutes: float, stays_s: float) -> Sensed:
    """One arm, from calibration to the end of its minutes.

    Args:
        seed: Draws the arm and what it does.
        minutes: How long it works [min].
        stays_s: How long it carries each load [s].
    """
    shown = Sensed()
    joints = 6 + seed % 2
    rate_Hz = RATES_HZ[seed % len(RATES_HZ)]
    with tempfile.TemporaryDirectory() as name:
        robot = load_robot(write_sensing_arm(Path(name), joints, seed))
        arm = SensingArm(Path(name), joints, seed, rate_Hz)
        shown.bound_s.append(bound_s(arm))
        empty = [arm.work(30.0, name=f"empty {n}") for n in range(2)]
        weight = OnlineEstimator(robot, fit_empty(robot, empty))
        begun_s = 0.0
        cpu_s = 0.0
        told_s = 0.0
        parts = working_day(arm, minutes, stays_s, shown)
        for part in parts:
            began = time.process_time()
            follow(part, weight, begun_s, shown)
            lasts_s = float(part.motion.times_s[-1])
            begun_s += lasts_s + 1.0
            told_s += lasts_s
            cpu_s += time.process_time() - began
        count_unseen(shown, len(parts[0].changes))
    shown.hours = told_s / 3600.0
    shown.cpu = cpu_s / told_s
    return shown


def working_day(arm: SensingArm, minutes: float, stays_s: float, shown: Sensed) -> list[Part]:
    """Loads taken and laid down, a rest with none, and one of 1 kg: here and elsewhere.

    Args:
        arm: Who works.
        minutes: How long in all [min].
        stays_s: How long each load is carried [s].
        shown: Where the parts' estimates go.
    """
    loads = [arm.load(mass) for mass in MASSES_KG * 2]
    schedule: Changes = []
    for n in range(2 * len(loads)):
        begins_s = stays_s * (n + 1) + arm.rng.uniform(0.0, 1.0)
        schedule.append((begins_s, loads[n // 2] if n % 2 == 0 else None))
    rest_s = max(60.0 * minutes - stays_s * 22 - 30.0, 20.0)
    handling = arm.work(stays_s * 22, schedule)
    at_rest = arm.work(0.5 * rest_s)
    one: Changes = [(0.0, arm.load(1.0))]
    carrying = arm.work(0.5 * rest_s, one)
    away = arm.work(30.0, one, elsewhere=ELSEWHERE_RAD)
    return [
        Part(handling, schedule, shown.later),
        Part(at_rest, [], shown.later),
        Part(carrying, one, shown.later),
        Part(away, one, shown.elsewhere),
    ]


def follow(part: Part, weight: OnlineEstimator, begun_s: float, shown: Sensed) -> None:
    """Tells the estimator a part, and keeps what it says of each change and of each mass.

    Args:
        part: The motion, and what changed in it.
        weight: The estimator.
        begun_s: When the part begins, on the estimator's clock [s].
        shown: What is kept.
    """
    events: Changes = [(0.0, None), *part.changes]
    held = None
    noticed = True
    known = True
    before = False
    last = 0.0
    for time_s, estimate in told_by(weight, part.motion, begun_s):
        while events and time_s >= events[0][0]:
            since_s, held = events.pop(0)
            known = False
            noticed = since_s == 0.0
        mass = held[0] if held else 0.0
        half = 0.5 * (estimate.ci95_kg[1] - estimate.ci95_kg[0])
        if estimate.changed and not before:
            if noticed and time_s > 2.0:
                shown.false += 1
            elif not noticed:
                late_s = moving_s(part.motion, since_s, time_s)
                shown.late[max(mass, last)].append(late_s)
            noticed = True
        before = estimate.changed
        row = (mass, estimate.mass_kg - mass, half)
        if not known and since_s > 0.0 and noticed and estimate.motion_s >= SOON_S:
            shown.soon.append(row)
            shown.known_s.append(time_s - since_s)
            known = True
        if time_s - since_s > 3.0:
            part.rows.append(row)
        last = mass or last


def count_unseen(shown: Sensed, changes: int) -> None:
    """Changes that were never seen are infinitely late."""
    seen = sum(len(late) for late in shown.late.values())
    shown.late[MASSES_KG[0]] += [np.inf] * (changes - seen)


def together(every: Sequence[Sensed]) -> Sensed:
    """As one."""
    whole = Sensed()
    for each in every:
        for mass, late in each.late.items():
            whole.late[mass] += late
        for name in ("soon", "later", "elsewhere", "known_s", "bound_s"):
            getattr(whole, name).extend(getattr(each, name))
        whole.false, whole.hours, whole.cpu = (
            whole.false + each.false,
            whole.hours + each.hours,
            max(whole.cpu, each.cpu),
        )
    return whole


def sensed_figures(shown: Sensed) -> dict[str, float]:
    lates = np.concatenate([np.array(late) for late in shown.late.values()])
    seen = lates[np.isfinite(lates)]
    figures = {
        "changes": len(lates), "noticed": len(seen), "late_s": float(np.median(seen)), "most_s": float(seen.max()),
        "within": float(100.0 * np.mean(lates <= 0.2)), "false": shown.false, "hours": shown.hours, "cpu": shown.cpu,
        "bound_s": float(np.mean(shown.bound_s)), "known_s": float(np.median(shown.known_s)),
    }  # fmt: skip
    for name in ("soon", "later", "elsewhere"):
        rows = np.array(getattr(shown, name))
        figures |= {
            f"{name}_rms": float(1e3 * np.sqrt(np.mean(rows[:, 1] ** 2))),
            f"{name}_half": float(1e3 * np.mean(rows[:, 2])),
            f"{name}_hold": float(100.0 * np.mean(np.abs(rows[:, 1]) < rows[:, 2])),
        }
    return figures


def sensing(results: Results, options: Namespace) -> None:
    """The table of arms with torque sensing."""
    results.table(
        "sensing",
        {
            "arm": "{arm}",
            "changes noticed; median, latest": "{noticed} of {changes}; {late_s:.2f}, {most_s:.2f} s",
            "within 0.2 s": "{within:.0f} %",
            "bound for 0.1 kg": "{bound_s:.3f} s",
            "false ones": "{false} in {hours:.2f} h",
            "after 0.5 s of motion: rms error, mean half interval, g; holds": "{soon_rms:.0f}, {soon_half:.0f}; {soon_hold:.0f} %",
            "from 3 s on": "{later_rms:.0f}, {later_half:.0f}; {later_hold:.0f} %",
            "at other poses": "{elsewhere_rms:.0f}, {elsewhere_half:.0f}; {elsewhere_hold:.0f} %",
            "of a core": "{cpu:.3f}",
        },
    )
    every = []
    for seed in range(options.first, options.first + options.sensing):
        with threadpool_limits(1, user_api="blas"):
            every.append(sense(seed, options.minutes, options.stays))
        name = f"{seed}, {6 + seed % 2} joints, {RATES_HZ[seed % len(RATES_HZ)]:.0f} Hz"
        results.row(
            "sensing",
            arm=name,
            **sensed_figures(every[-1]),
        )
    whole = together(every)
    results.row("sensing", arm="all", **sensed_figures(whole))
    results.table(
        "late",
        {
            "mass": "{mass:g} kg",
            "changes": "{changes}",
            "median": "{median_s:.2f} s",
            "95 %": "{most_s:.2f} s",
        },
    )
    for mass, late in whole.late.items():
        seen = np.array(late)
        results.row(
            "late",
            mass=mass,
            changes=len(seen),
            median_s=float(np.median(seen)),
            most_s=float(np.quantile(seen, 0.95, method="lower")),
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """One row per arm, and the figures of all."""
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--first", type=int, default=1, help="seed of the first arm")
    parser.add_argument("--sensing", type=int, default=12, help="arms with torque sensing")
    parser.add_argument("--minutes", type=float, default=5.0, help="that each of them works")
    parser.add_argument(
        "--stays", type=float, default=5.0, help="how long each holds something, and nothing [s]"
    )
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    if options.sensing:
        sensing(results, options)
    if options.arms:
        servos(results, options)
    results.keep()


def servos(results: Results, options: Namespace) -> None:
    """The table of virtual arms."""
    results.table(
        "running",
        {
            "arm": "{arm}",
            "changes noticed, after at most": "{noticed} of {changes}, {late_s:.2f} s",
            "false ones": "{false}",
            "nothing held: rms error, mean half interval, g; holds": "{empty_rms:.1f}, {empty_half:.1f}; {empty_hold:.0f} %",
            "an object: rms error, mean half interval, g; holds": "{held_rms:.1f}, {held_half:.1f}; {held_hold:.0f} %",
            "of a core": "{cpu:.3f}",
        },
    )
    robot = load_robot("open_manipulator_x")
    every: list[tuple[np.ndarray, list[float], int, float]] = []
    for seed in range(options.first, options.first + options.arms):
        day = work(robot, seed)
        with threadpool_limits(1, user_api="blas"):
            watched = watch(robot, day)
        every.append(watched)
        results.row("running", arm=f"{seed}", **_figures([watched]))
    results.row("running", arm="all", **_figures(every))


def _figures(watched: Sequence[tuple[np.ndarray, list[float], int, float]]) -> dict[str, float]:
    rows = np.concatenate([each[0] for each in watched])
    lates = np.concatenate([each[1] for each in watched])
    noticed = lates[np.isfinite(lates)]
    figures = {
        "changes": len(lates),
        "noticed": len(noticed),
        "late_s": float(noticed.max()),
        "false": sum(each[2] for each in watched),
        "cpu": max(each[3] for each in watched),
    }
    for name, those in (("empty", rows[:, 0] == 0.0), ("held", rows[:, 0] > 0.0)):
        _, error_kg, half_kg = rows[those].T
        figures[f"{name}_rms"] = float(1e3 * np.sqrt(np.mean(error_kg**2)))
        figures[f"{name}_half"] = float(1e3 * np.mean(half_kg))
        figures[f"{name}_hold"] = float(100.0 * np.mean(np.abs(error_kg) < half_kg))
    return figures


if __name__ == "__main__":
    main()
