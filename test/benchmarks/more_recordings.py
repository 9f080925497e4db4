"""Do more recordings pay? Error and width against how many recordings an arm is known by, and how far these differ.

    python test/benchmarks/more_recordings.py [--arms 8] [--first 31000]    # a quarter of an hour on a core

Arms of six and of four joints in turn, moved by MuJoCo for 12 s a recording (`support/differing.py`). Their torque differs from
recording to recording by 0.2, 1 or 3 %; friction, offsets and zeros differ in proportion (20 %, 10 % of Coulomb friction and 5 mrad
at 3 %). Known are one to five empty recordings, and up to two known loads; a load and nothing are asked, and the load with efforts
that are 5 % larger in what is asked alone. An interval should narrow as far as the arm repeats, and hold.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from results import Results, each_answer, parser_of
from support.arm_in_motion import FOUR, SIX, write_robot
from support.differing import DifferingArm, louder

from proprio_ros.identification.regression.motion_equations import once_each
from proprio_ros.identification.regression.motion_fit import fit_empty, fit_payload
from proprio_ros.identification.regression.torque_scale import scaled_by_references
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot

USUAL_PERCENT = 3.0  # By so much torque differs as `support/differing.py` has it.
PERCENT = (0.2, 1.0, 3.0)
KNOWN = ((1, 0), (1, 1), (2, 0), (3, 0), (3, 1), (5, 0), (5, 2))
SECONDS = 12.0


@dataclass(frozen=True)
class Answer:
    """One mass."""

    row: tuple[float, int, int, str]  # percent, empty recordings, known loads, what is asked
    error: float  # in % of the load, in g of nothing
    half: float  # of the 95 % interval, likewise


@dataclass(frozen=True)
class Recorded:
    """What one arm is known by, and what it is asked."""

    robot: Robot
    empty: list[Motion]
    known: list[tuple[Motion, float]]  # and the load in it [kg]
    asked: dict[str, tuple[float, Motion]]  # with the true mass [kg]


def recorded(seed: int, percent: float) -> Recorded:
    """Of one arm whose torque differs so much from recording to recording."""
    build = (SIX, FOUR)[seed % 2]
    arm = DifferingArm(seed, build, SECONDS, percent / USUAL_PERCENT)
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(write_robot(Path(folder), build=build))
    empty = [arm.recorded(f"empty {n}") for n in range(5)]
    held = [arm.held() for _ in range(3)]
    known = [(arm.recorded("known", each), each[0]) for each in held[:2]]
    load_kg = held[2][0]
    loaded = arm.recorded("asked", held[2])
    asked = {
        "load": (load_kg, loaded),
        "load, efforts 1.05 times": (load_kg, louder(loaded, 1.05)),
        "nothing": (0.0, arm.recorded("asked empty")),
    }
    return Recorded(robot, empty, known, asked)


def answers(seed: int, percent: float) -> Iterator[Answer]:
    """All masses of one arm."""
    arm = recorded(seed, percent)
    with once_each():
        for empties, loads in KNOWN:
            calibration = fit_empty(arm.robot, arm.empty[:empties])
            if loads:
                calibration, _ = scaled_by_references(
                    arm.robot, calibration, arm.known[:loads], None
                )
            for what, (truth_kg, motion) in arm.asked.items():
                fit = fit_payload(arm.robot, [motion], calibration)
                scale = 100.0 / truth_kg if truth_kg else 1e3
                value_kg = max(float(fit.values[0]), 0.0)
                row = (percent, empties, loads, what)
                yield Answer(row, scale * (value_kg - truth_kg), scale * fit.half_width)


def main(arguments: Sequence[str] | None = None) -> None:
    """One row for each spread, set of recordings and question."""
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=8)
    parser.add_argument("--first", type=int, default=31000, help="first seed")
    parser.add_argument("--percent", type=float, nargs="+", default=PERCENT)
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    results.table(
        "more",
        {
            "torque differs by": "{percent:g} %",
            "known": "{empty} empty, {loads} loads",
            "asked": "{what}",
            "hold": "{hold} of {given}",
            "median error": "{error:.2g} {unit}",
            "median half width": "{half:.3g} {unit}",
        },
    )
    seeds = range(options.first, options.first + options.arms)
    found = [
        each for percent in options.percent for seed in seeds for each in answers(seed, percent)
    ]
    for row in dict.fromkeys(each.row for each in found):
        mine = [each for each in found if each.row == row]
        errors = np.array([each.error for each in mine])
        halves = np.array([each.half for each in mine])
        percent, empty, loads, what = row
        results.row(
            "more", percent=percent, empty=empty, loads=loads, what=what, given=len(mine),
            hold=int((np.abs(errors) < halves).sum()), error=float(np.median(np.abs(errors))),
            half=float(np.median(halves)), unit="g" if what == "nothing" else "%", **each_answer(errors, halves),
        )  # fmt: skip
    results.keep()


if __name__ == "__main__":
    main()
