"""How soon a virtual OpenManipulator-X at work notices what it picks up and puts down, and how well it weighs it.

    python test/benchmarks/running.py [--arms 4] [--first 1]

Each arm moves from pose to pose under its servos' position controller: empty for twice 30 s, which calibrate it, then for some ten
seconds each with nothing, 50 g, nothing, 20 g (every second arm 100 g) and nothing. An object comes and goes in the middle of a
motion. Half intervals count from 3 s after a change on.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from support.virtual_pick_and_place import Worker
from threadpoolctl import threadpool_limits

from proprio_ros.identification.regression.motion_prior import fit_empty
from proprio_ros.identification.regression.running import RunningWeight
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot

Day = tuple[list[Motion], list[tuple[float, Motion]]]


def work(robot: Robot, seed: int) -> Day:
    """Empty motions, and the parts of a working day with the mass that is held."""
    arm, rng = Worker(robot, seed), np.random.default_rng(seed)
    empty = [arm.work(30.0) for _ in range(2)]
    masses = (0.0, 0.05, 0.0, 0.02 if seed % 2 else 0.1, 0.0)
    return empty, [(mass, arm.work(10.0 + rng.uniform(0.0, 1.0), mass)) for mass in masses]


def watch(robot: Robot, day: Day) -> tuple[np.ndarray, list[float], int, float]:
    """Mass, error and half interval [kg] in rows; how late each change was noticed [s]; false changes; CPU per second of data."""
    empty, parts = day
    weight = RunningWeight(robot, fit_empty(robot, empty), held={"gripper_left_joint": 0.0})
    rows, late, false, samples, begun_s = [], [], 0, 0, time.process_time()
    before = False
    for number, (mass, part) in enumerate(parts):
        noticed = number == 0
        for time_s, position, current in zip(part.times_s, part.position, part.current_A, strict=True):
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
                rows.append((mass, estimate.mass_kg - mass, 0.5 * (estimate.ci95_kg[1] - estimate.ci95_kg[0])))
        late += [] if noticed else [np.inf]
    return np.array(rows), late, false, (time.process_time() - begun_s) / (0.01 * samples)


def main() -> None:
    """Print one line per arm, and the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--first", type=int, default=1, help="seed of the first arm")
    options = parser.parse_args()
    robot = load_robot("open_manipulator_x")
    every, lates = [], []
    for seed in range(options.first, options.first + options.arms):
        day = work(robot, seed)
        with threadpool_limits(1, user_api="blas"):
            rows, late, false, cpu = watch(robot, day)
        every.append(rows)
        lates += late
        print(
            f"{seed}: {_figures(rows)}; noticed after {max(late):.2f} s at most, {false} false; {cpu:.3f} of a core",
            flush=True,
        )
    print(f"{options.arms} arms: {_figures(np.concatenate(every))}; noticed after {max(lates):.2f} s at most")


def _figures(rows: np.ndarray) -> str:
    words = []
    for name, those in (("nothing held", rows[rows[:, 0] == 0.0]), ("an object", rows[rows[:, 0] > 0.0])):
        holds = np.mean(np.abs(those[:, 1]) < those[:, 2])
        rms, half = 1e3 * np.sqrt(np.mean(those[:, 1] ** 2)), 1e3 * np.mean(those[:, 2])
        words.append(f"{name}: rms error {rms:.1f} g, half interval {half:.1f} g, holds {100.0 * holds:.0f} %")
    return "; ".join(words)


if __name__ == "__main__":
    main()
