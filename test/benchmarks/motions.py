"""How well arms drawn at random weigh what they carry while several joints move: coverage, error and width, in MuJoCo.

    python test/benchmarks/motions.py [--joints 6] [--arms 60] [--first 100] [--seconds 20] [--calibrated] [--empty]

Each arm of six joints (``--joints 4``: a small one in slow motion) runs random sines under a computed-torque controller, once empty
and once with a payload of 0.1 to 2 kg (20 to 200 g; each fourth with nothing). Links are off the URDF by 8 % (2 %), torque
constants by 1 %; friction depends on place, load and run; current and position are noisy, and the torque is late.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "identification"))

from arm_in_motion import FOUR, SIX, Twin, write_robot

from proprio_ros.identification.motion_fit import fit_motions
from proprio_ros.identification.motion_prior import fit_calibrated, fit_empty
from proprio_ros.robot import load_robot


def main() -> None:
    """Print one line per arm, and the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=60)
    parser.add_argument("--first", type=int, default=100, help="seed of the first arm")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each motion")
    parser.add_argument("--joints", type=int, choices=(4, 6), default=6)
    parser.add_argument(
        "--calibrated", action="store_true", help="with what `proprio calibrate` makes of the empty one"
    )
    parser.add_argument("--empty", action="store_true", help="weigh a third motion, with nothing in the hand")
    options = parser.parse_args()
    build = SIX if options.joints == 6 else FOUR
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(write_robot(Path(folder), build=build))
    errors, halves, seconds = [], [], []
    for seed in range(options.first, options.first + options.arms):
        arm = Twin(seed, build)
        mass, _ = held = arm.payload(np.random.default_rng(10_000 + seed))
        empty, loaded = arm.record("empty", options.seconds), arm.record("loaded", options.seconds, held)
        if options.empty:
            mass, loaded = 0.0, arm.record("empty again", options.seconds)
        begun_s = time.process_time()
        if options.calibrated:
            fit = fit_calibrated(robot, [loaded], fit_empty(robot, [empty]))
        else:
            fit = fit_motions(robot, [loaded], [empty])
        seconds.append(time.process_time() - begun_s)
        errors.append(float(fit.values[0]) - mass)
        halves.append(fit.quantile * float(fit.std[0]))
        print(
            f"{seed}: {1e3 * mass:6.0f} g, error {1e3 * errors[-1]:+6.1f} g, half interval {1e3 * halves[-1]:5.1f} g",
            flush=True,
        )
    error, half = np.array(errors), np.array(halves)
    holds = np.abs(error) < half
    spread = 1.96 * np.sqrt(holds.mean() * (1.0 - holds.mean()) / len(holds))
    print(
        f"{len(error)} arms: interval holds {100.0 * holds.mean():.1f} +- {100.0 * spread:.1f} %, rms error "
        f"{1e3 * np.sqrt(np.mean(error**2)):.1f} g, median half interval {1e3 * np.median(half):.1f} g; "
        f"{np.median(seconds):.2f} s of CPU each"
    )


if __name__ == "__main__":
    main()
