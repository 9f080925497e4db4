"""How well arms drawn at random weigh what they carry while several joints move: coverage, error and width, in MuJoCo.

    python test/benchmarks/motions.py [--joints 6] [--arms 60] [--first 100] [--seconds 20] [--baseline] [--empty] [--teeth]
    python test/benchmarks/motions.py --first 5000 --arms 100 --loaded-seconds 15    # the table of the docs; 10 min

Each arm of six joints (``--joints 4``: a small one in slow motion) runs random sines under a computed-torque controller, once empty
and once with a payload of 0.1 to 2 kg (20 to 200 g; each fourth with nothing). Links are off the URDF by 8 % (2 %), torque
constants by 1 %; friction depends on place, load and run; current and position are noisy, and the torque is late.

"Over bound" is the median of the interval's half width over 1.96 times the smallest standard deviation that any method could have
of the same motions (`motion_bound`, which says what it takes for known). The interval of the coverage is Wilson's (1927, Journal
of the American Statistical Association 22).
"""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from motion_bound import bound
from results import Results, each_answer, parser_of
from scipy.stats import binomtest
from support.arm_in_motion import FOUR, SIX, Twin, write_robot

from proprio_ros.identification.regression.motion_fit import fit_empty, fit_payload
from proprio_ros.quantity import Z95
from proprio_ros.robot import Robot, load_robot


def row(
    results: Results,
    name: str,
    answers: np.ndarray,
) -> None:
    """One row of the table, of answers (mass, error, half width, bound in kg) in rows."""
    _, error, half, least = answers.T
    hits = int(np.sum(np.abs(error) < half))
    low, high = binomtest(hits, len(error)).proportion_ci(method="wilson")
    results.row(
        "motions", arms=name, answers=len(error), hold=100.0 * hits / len(error), low=100.0 * low, high=100.0 * high,
        rms=1e3 * np.sqrt(np.mean(error**2)), bound=1e3 * np.sqrt(np.mean(least**2)), half=1e3 * np.median(half),
        over=np.median(half / (Z95 * least)), farthest=Z95 * np.max(np.abs(error) / half),
        **each_answer(1e3 * error, 1e3 * half),
    )  # fmt: skip


@dataclass(frozen=True)
class Weighed:
    """One arm's answer: error, half interval, and the smallest standard deviation there is [kg].

    Attributes:
        cpu_s: The processor's time for it [s].
    """

    mass: float
    error: float
    half: float
    least: float
    cpu_s: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line per arm, and the figures of all."""
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=60)
    parser.add_argument("--first", type=int, default=100, help="seed of the first arm")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each motion")
    parser.add_argument(
        "--loaded-seconds", type=float, help="of the motion that is weighed, where it is shorter"
    )
    parser.add_argument(
        "--joints",
        type=int,
        choices=(4, 6),
        default=6,
    )
    parser.add_argument(
        "--teeth",
        action="store_true",
        help="friction goes with the place by a law of gears, see `Twin`",
    )
    parser.add_argument(
        "--baseline", action="store_true", help="one more empty motion counts in the weighing"
    )
    parser.add_argument(
        "--empty", action="store_true", help="weigh a third motion, with nothing in the hand"
    )
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    build = SIX if options.joints == 6 else FOUR
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(write_robot(Path(folder), build=build))
    found = []
    for seed in range(options.first, options.first + options.arms):
        arm = Twin(seed, build, teeth=options.teeth)
        each = weigh(robot, arm, options)
        found.append(each)
        print(
            f"{seed}: {1e3 * each.mass:6.0f} g, error {1e3 * each.error:+6.1f} g, half interval {1e3 * each.half:5.1f} g, "
            f"{each.half / (Z95 * each.least):.2f} of the smallest",
            flush=True,
        )
    tell(results, found, build.payload_kg)
    print(f"{np.median([each.cpu_s for each in found]):.2f} s of CPU each")
    results.keep()


def weigh(robot: Robot, arm: Twin, options: Namespace) -> Weighed:
    """Records an empty motion and a loaded one, and weighs what is held beside what could be known at best.

    Args:
        robot: What is known of the arm.
        arm: Who moves.
        options: How long, whether anything is held, and whether one more empty motion counts.
    """
    loaded_s = options.loaded_seconds or options.seconds
    mass, centre = held = arm.payload(np.random.default_rng(10_000 + arm.seed))
    empty = arm.record("empty", options.seconds)
    loaded = arm.record("loaded", loaded_s, held)
    if options.empty:
        mass = 0.0
        loaded = arm.record("empty again", loaded_s)
    more = [arm.record("baseline", loaded_s)] if options.baseline else []
    begun_s = time.process_time()
    fit = fit_payload(robot, [loaded], fit_empty(robot, [empty]), empty=more)
    cpu_s = time.process_time() - begun_s
    truths = [arm.truths[motion.name] for motion in (empty, loaded, *more)]
    least = bound(arm, truths[0], truths[1], mass, centre, more=truths[2:])
    error = float(fit.values[0]) - mass
    return Weighed(mass, error, fit.quantile * float(fit.std[0]), least, cpu_s)


def tell(results: Results, found: Sequence[Weighed], payload_kg: tuple[float, float]) -> None:
    """A row for all, and one for each range of masses [kg]."""
    results.table(
        "motions",
        {
            "arms": "{arms}",
            "answers": "{answers}",
            "interval holds": "{hold:.0f} % ({low:.0f} to {high:.0f})",
            "rms error, g": "{rms:.1f}",
            "rms bound, g": "{bound:.1f}",
            "median half interval, g": "{half:.1f}",
            "over bound": "{over:.2f}",
            "farthest, in sd": "{farthest:.1f}",
        },
    )
    answers = np.array([(each.mass, each.error, each.half, each.least) for each in found])
    mass = answers[:, 0]
    row(results, "all", answers)
    middle_kg = float(np.sqrt(np.prod(payload_kg)))
    for name, those in (
        ("nothing held", mass == 0.0),
        (f"up to {1e3 * middle_kg:.0f} g", (mass > 0.0) & (mass <= middle_kg)),
        (f"up to {1e3 * payload_kg[1]:.0f} g", mass > middle_kg),
    ):
        if those.any():
            row(results, name, answers[those])


if __name__ == "__main__":
    main()
