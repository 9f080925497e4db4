"""The tables of the validation page that are of simulated recordings: weighing, spheres, soft blocks.

    python test/benchmarks/simulated.py                     # all of them, with the recordings beside the clone
    python test/benchmarks/simulated.py weighing            # or some of weighing, container, blocks, paper
    python test/benchmarks/simulated.py --robots ideal_s00  # some of the robots alone

The tests of the same recordings hold limits; this prints the figures, in g and %. Each recording is asked what its test asks.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np
from results import REPOSITORY, Results, each_answer, parser_of
from support import simulated

from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Z95, Quantity
from proprio_ros.robot import Robot, load_robot

at_most: int | None = None
"""Of the recordings of each kind; None for all."""
RECORDINGS = REPOSITORY.parent / "shared" / "recordings"
ROBOT = load_robot("open_manipulator_x")
REALISTIC = ("realistic_s00", "realistic_s01")
LEVELS = {
    "ideal_s00": "no noise, no friction",
    "quantised_s00": "12-bit encoder, 2.69 mA current steps",
    "friction_s00": "the same, and Coulomb and viscous friction",
    "realistic_s00": "realistic: friction, torque constant, delay, noise, compliance unknown",
    "realistic_s01": "realistic, another robot",
    "hard_s00": "hard: also backlash, Stribeck, 10 % load friction, 1 ms stamps, lost messages",
}


class Answers:
    """Errors and half intervals of several answers: of masses in g, of moduli in % of the truth."""

    def __init__(self) -> None:
        self.asked = self.hold = 0
        self.errors: list[float] = []
        self.halves: list[float] = []

    def add(
        self,
        estimate: Estimate,
        name: str,
        truth: float,
        scale: float = 1e3,
    ) -> None:
        """Count an answer, or that there is none."""
        self.asked += 1
        value = estimate.value(name)
        if (
            isinstance(value.value, float)
            and isinstance(value.std, float)
            and value.ci95 is not None
        ):
            self.errors.append(scale * (value.value - truth))
            self.halves.append(scale * Z95 * value.std)
            self.hold += value.ci95[0] <= truth <= value.ci95[1]

    def figures(
        self,
        prefix: str = "",
    ) -> dict[str, Any]:
        """Numbers of a row."""
        off = np.abs(self.errors or [np.nan])
        found = {
            "asked": self.asked, "answered": len(self.errors), "hold": int(self.hold),
            "rms": float(np.sqrt(np.mean(off**2))), "median": float(np.median(off)), "worst": float(off.max()),
            "half_from": min(self.halves, default=None), "half_to": max(self.halves, default=None),
            **each_answer(self.errors, self.halves),
        }  # fmt: skip
        return {prefix + key: value for key, value in found.items()}


def calibrated_on(runs: list[LoadedRun]) -> Robot:
    """The robot, calibrated on these runs."""
    learnt = calibrate(ROBOT, runs)
    assert learnt.calibration is not None
    return ROBOT.with_calibration(learnt.calibration)


def weighed(
    folders: Iterable[Any],
    robot: Robot | None = None,
    known: bool = False,
) -> Answers:
    """Masses by a calibrated robot; without one by the robot file, or by the simulator's own drive train."""
    answers = Answers()
    for folder in folders:
        truth = simulated.truth_of(folder)
        if robot is not None:
            estimate = weigh(
                robot,
                simulated.runs_of(folder, robot),
                simulated.facts_of(folder),
            )
        else:
            estimate = simulated.weighed(
                folder, simulated.known_drive_train(truth) if known else None
            )
        answers.add(estimate, "payload_mass", truth["payload"]["mass"])
    return answers


def weighing(results: Results, levels: Sequence[str]) -> None:
    """Masses of fixed objects; of those that want a calibration, of 10 to 50 g."""
    results.table(
        "weighing",
        {
            "recordings": "{recordings}",
            "known of the robot": "{known}",
            "answers": "{answered} of {asked}",
            "interval holds": "{hold}",
            "rms error, g": "{rms:.2f}",
            "median error, g": "{median:.2f}",
            "worst error, g": "{worst:.2f}",
            "half intervals, g": "{half_from:.2f} to {half_to:.2f}",
        },
    )

    def row(level: str, known: str, answers: Answers) -> None:
        results.row(
            "weighing", level=level, recordings=LEVELS[level], known=known, **answers.figures()
        )

    for level in levels:
        folders = simulated.fixed(RECORDINGS, level)[:at_most]
        if level in ("ideal_s00", "quantised_s00"):
            row(level, "robot file", weighed(folders))
            continue
        if level == "friction_s00":
            row(level, "its drive train", weighed(folders, known=True))
        else:
            folders = [
                f for f in folders if 0.0099 <= simulated.truth_of(f)["payload"]["mass"] <= 0.0501
            ]
            empty = simulated.empty_runs(RECORDINGS / level, ROBOT)
            row(level, "calibrated on its empty runs", weighed(folders, calibrated_on(empty)))
            reference = simulated.reference_runs(RECORDINGS / level, ROBOT)
            row(
                level, "and on three with 100 g", weighed(folders, calibrated_on(empty + reference))
            )
        row(
            level,
            "robot file",
            weighed(simulated.fixed(RECORDINGS, level)[:at_most]),
        )


def container(results: Results, levels: Sequence[str]) -> None:
    """Masses of spheres in a box, by the empty box's recordings as the baseline."""
    results.table(
        "container",
        {
            "recordings": "{recordings}",
            "answers": "{answered} of {asked}",
            "interval holds": "{hold}",
            "rms error, g": "{rms:.2f}",
            "worst error, g": "{worst:.2f}",
            "half intervals, g": "{half_from:.1f} to {half_to:.1f}",
            "an empty box, worst, g": "{empty_worst:.2f}",
            "three together: error, g": "{together_words}",
            "holds": "{together_hold} of {together_asked}",
        },
    )
    results.table(
        "container, not calibrated",
        {
            "recordings": "{recordings}",
            "answers": "{answered} of {asked}",
            "interval holds": "{hold}",
            "rms error, g": "{rms:.2f}",
            "worst error, g": "{worst:.2f}",
        },
    )
    for level in levels:
        for robot in (calibrated_on(simulated.empty_runs(RECORDINGS / level, ROBOT)), ROBOT):
            boxes = simulated.Boxes(RECORDINGS / level, "", robot)
            single = Answers()
            empty = Answers()
            together = Answers()
            here = {"level": level, "recordings": LEVELS[level]}
            if robot is ROBOT:
                for folder in boxes.folders("container_sphere_*")[:at_most]:
                    mass = simulated.truth_of(folder)["container"]["sphere_mass"]
                    single.add(boxes.find([folder]), "sphere_mass", mass)
                results.row("container, not calibrated", **here, **single.figures())
                continue
            for folder in boxes.folders("container_*")[:at_most]:
                mass = simulated.truth_of(folder)["container"]["sphere_mass"]
                estimate = boxes.find([folder])
                for answers in (single,) if mass else (single, empty):
                    answers.add(estimate, "sphere_mass", mass)
            for sphere in ("12g", "random"):
                folders = boxes.folders(f"container_sphere_{sphere}_*")[:at_most]
                mass = simulated.truth_of(folders[0])["container"]["sphere_mass"]
                together.add(boxes.find(folders), "sphere_mass", mass)
            results.row(
                "container", **here, **single.figures(), **empty.figures("empty_"), **together.figures("together_"),
                together_words=", ".join(f"{error:+.2f}" for error in together.errors),
            )  # fmt: skip


def blocks(results: Results, levels: Sequence[str]) -> None:
    """Young's moduli of soft blocks: light, heavy and random."""
    results.table(
        "blocks",
        {
            "recordings": "{recordings}",
            "error of the light, the heavy, the random block": "{words} %",
            "interval holds": "{hold} of {asked}",
            "half intervals": "{half_from:.0f} to {half_to:.0f} %",
            "Poisson's ratio identified, holds": "{ratio_answered}, {ratio_hold}",
        },
    )
    for level in levels:
        closings = simulated.empty_runs(RECORDINGS / level, ROBOT, "squeeze_empty_*")
        robot = calibrated_on([*simulated.empty_runs(RECORDINGS / level, ROBOT), *closings])
        for stated in (False, True) if level == "quantised_s00" else (False,):
            answers = Answers()
            ratios = Answers()
            for block in simulated.BLOCKS:
                folder = RECORDINGS / level / f"squeeze_{block}"
                _, modulus, ratio = simulated.cube_of(folder)
                # the truth is each finger's; both together close by twice as much
                gap = Quantity(
                    2.0 * simulated.truth_of(folder)["cube"]["gap"],
                    1e-5,
                )
                estimate = simulated.squeezed(
                    robot,
                    folder,
                    **({"gap": gap} if stated else {}),
                )
                answers.add(estimate, "youngs_modulus", modulus, 100.0 / modulus)
                ratios.add(estimate, "poissons_ratio", ratio, 1.0)
            results.row(
                "blocks", level=level, recordings=LEVELS[level] + ("; the gap before the touch stated to 0.01 mm" * stated),
                words=", ".join(f"{error:+.1f}" for error in answers.errors), **answers.figures(), **ratios.figures("ratio_"),
            )  # fmt: skip


def paper(results: Results, levels: Sequence[str]) -> None:
    """The recording that the paper's authors published, by our settings and by theirs."""
    columns = {
        "settings": "{profile}",
        "verdict": "{verdict}",
        "least error at": "{ends} g",
        "their schedule stops at": "{stops} g",
        "first reason": "{reason}",
    }
    results.table("paper", columns)
    for profile in ("default", "paper"):
        estimate = replay([RECORDINGS / "paper_heavy_ball"], Options(profile=profile))
        paths = estimate.solver.paths if profile == "paper" else ()
        results.row(
            "paper", profile=profile, verdict=estimate.verdict.value, reason=str(estimate.reasons[0]),
            ends=", ".join(f"{1e3 * path.end:.1f}" for path in paths) or None,
            stops=", ".join(f"{1e3 * path.scheduled:.0f}" for path in paths) or None,
        )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    tables = {
        "weighing": weighing,
        "container": container,
        "blocks": blocks,
        "paper": paper,
    }
    parser = parser_of(__doc__)
    parser.add_argument(
        "tables",
        nargs="*",
        default=list(tables),
        help=", ".join(tables),
    )
    parser.add_argument(
        "--robots", nargs="+", default=list(LEVELS), choices=list(LEVELS), help="default: all"
    )
    parser.add_argument("--at-most", type=int, help="of the recordings of each kind; default: all")
    options = parser.parse_args(arguments)
    global at_most
    at_most = options.at_most
    results = Results(__file__, options.json, arguments)
    for name in options.tables:
        tables[name](results, options.robots)
    results.keep()


if __name__ == "__main__":
    main()
