"""How soon a virtual OpenManipulator-X at work notices what it picks up and puts down, and how well it weighs it.

    python test/benchmarks/running.py [--arms 4] [--first 1]

Each arm moves from pose to pose under its servos' position controller: empty for twice 30 s, which calibrate it, then for some ten
seconds each with nothing, 50 g, nothing, 20 g (every second arm 100 g) and nothing. An object comes and goes in the middle of a
motion. Half intervals count from 3 s after a change on.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from results import Results, parser_of
from support.virtual_pick_and_place import Worker
from threadpoolctl import threadpool_limits

from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.identification.regression.online import OnlineEstimator
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
    weight = OnlineEstimator(robot, fit_empty(robot, empty), held={"gripper_left_joint": 0.0})
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


def main(arguments: Sequence[str] | None = None) -> None:
    """One row per arm, and the figures of all."""
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--first", type=int, default=1, help="seed of the first arm")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
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
    results.keep()


def _figures(watched: Sequence[tuple[np.ndarray, list[float], int, float]]) -> dict[str, float]:
    rows = np.concatenate([each[0] for each in watched])
    lates = np.concatenate([each[1] for each in watched])
    figures = {
        "changes": len(lates), "noticed": int(np.isfinite(lates).sum()), "late_s": float(lates[np.isfinite(lates)].max()),
        "false": sum(each[2] for each in watched), "cpu": max(each[3] for each in watched),
    }  # fmt: skip
    for name, those in (("empty", rows[rows[:, 0] == 0.0]), ("held", rows[rows[:, 0] > 0.0])):
        figures |= {
            f"{name}_rms": float(1e3 * np.sqrt(np.mean(those[:, 1] ** 2))),
            f"{name}_half": float(1e3 * np.mean(those[:, 2])),
            f"{name}_hold": float(100.0 * np.mean(np.abs(those[:, 1]) < those[:, 2])),
        }
    return figures


if __name__ == "__main__":
    main()
