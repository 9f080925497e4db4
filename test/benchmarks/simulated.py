"""The tables of the validation page that are of simulated recordings: weighing, what is in the box, soft blocks.

    python test/benchmarks/simulated.py                     # all three, with the recordings beside the clone
    python test/benchmarks/simulated.py weighing            # or some of weighing, container, blocks

The tests of the same recordings hold limits; this prints the figures, in g and %. Each recording is asked what its test asks.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np
import test_container as boxes
import test_replay as replays
import test_robot_calibration as calibrations
import test_squeeze as squeezes

from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Z95, Quantity
from proprio_ros.robot import Robot, load_robot

RECORDINGS = Path(__file__).resolve().parents[3] / "shared" / "recordings"
ROBOT = load_robot("open_manipulator_x")
REALISTIC = ("realistic_s00", "realistic_s01")
LEVELS = ("ideal_s00", "quantised_s00", "friction_s00", *REALISTIC, "hard_s00")


class Row:
    """Errors and intervals of one row of a table: of masses in g, of moduli in % of the truth."""

    def __init__(self) -> None:
        self.asked = self.hold = 0
        self.errors: list[float] = []
        self.halves: list[float] = []

    def add(self, estimate: Estimate, name: str, truth: float, scale: float = 1e3) -> None:
        """Count an answer, or that there is none."""
        self.asked += 1
        value = estimate.value(name)
        if isinstance(value.value, float) and isinstance(value.std, float) and value.ci95 is not None:
            self.errors.append(scale * (value.value - truth))
            self.halves.append(scale * Z95 * value.std)
            self.hold += value.ci95[0] <= truth <= value.ci95[1]

    def __add__(self, other: Row) -> Row:
        both = Row()
        both.asked, both.hold = self.asked + other.asked, self.hold + other.hold
        both.errors, both.halves = self.errors + other.errors, self.halves + other.halves
        return both

    def show(self, name: str, each: bool = False) -> None:
        """Print the row; ``each``: with every error."""
        off = np.abs(self.errors or [np.nan])
        print(
            f"{name}: {len(self.errors)} of {self.asked} answered, {self.hold} hold; rms {np.sqrt(np.mean(off**2)):.2f}, "
            f"median {np.median(off):.2f}, worst {off.max():.5f}; half intervals {min(self.halves, default=np.nan):.1f} to "
            f"{max(self.halves, default=np.nan):.1f}" + (f"; {', '.join(f'{e:+.2f}' for e in self.errors)}" if each else ""),
            flush=True,
        )  # fmt: skip


def calibrated_on(runs: list[LoadedRun]) -> Robot:
    """The robot as it learns itself from these runs."""
    learnt = calibrate(ROBOT, runs)
    assert learnt.calibration is not None
    return ROBOT.with_calibration(learnt.calibration)


def objects(level: str) -> list[Path]:
    """The recordings with 10 to 50 g."""
    folders = replays.fixed(RECORDINGS, level)
    return [folder for folder in folders if 0.0099 <= replays.truth_of(folder)["payload"]["mass"] <= 0.0501]


def without_suffix(folders: Iterable[Path]) -> list[Path]:
    """Those that are called ``joint2`` and ``joint3``, and nothing more."""
    return [folder for folder in folders if folder.name.endswith(("_joint2", "_joint3"))]


def replayed(folders: Iterable[Path], known: bool = False) -> Row:
    """Weigh by the robot file, or by the simulator's own drive train."""
    row = Row()
    for folder in folders:
        truth = replays.truth_of(folder)
        estimate = replays.weighed(folder, replays.known_drive_train(truth) if known else None)
        row.add(estimate, "payload_mass", truth["payload"]["mass"])
    return row


def weighing() -> None:
    """Masses of fixed objects."""
    for level in ("ideal_s00", "quantised_s00"):
        replayed(replays.fixed(RECORDINGS, level)).show(level)
    replayed(replays.fixed(RECORDINGS, "friction_s00"), known=True).show("friction_s00, stated")
    for level in (*REALISTIC, "hard_s00"):
        empty = calibrations.empty_runs(RECORDINGS / level, ROBOT)
        for reference in ([], calibrations.reference_runs(RECORDINGS / level, ROBOT)):
            robot = calibrated_on(empty + reference)
            name = f"{level}, calibrated{' with a reference' if reference else ''}"
            for which, folders in (("", objects(level)), (", no suffix", without_suffix(objects(level)))):
                row = Row()
                for folder in folders:
                    estimate = weigh(robot, calibrations.runs_of(folder, robot), calibrations.facts_of(folder))
                    row.add(estimate, "payload_mass", calibrations.truth_of(folder)["payload"]["mass"])
                row.show(name + which)
    for level in ("friction_s00", *REALISTIC, "hard_s00"):
        replayed(replays.fixed(RECORDINGS, level)).show(f"{level}, not calibrated")


def container() -> None:
    """Masses of spheres in a box, by the empty box's recordings as the baseline."""
    for level in LEVELS:
        robot = calibrated_on(calibrations.empty_runs(RECORDINGS / level, ROBOT))
        made = boxes.Level(RECORDINGS / level, "", robot)
        empty, rolling, together = Row(), Row(), Row()
        for folder in made.folders("container_*"):
            mass = boxes.truth_of(folder)["sphere_mass"]
            (rolling if mass else empty).add(made.find([folder]), "sphere_mass", mass)
        for sphere in ("12g", "random"):
            folders = made.folders(f"container_sphere_{sphere}_*")
            together.add(made.find(folders), "sphere_mass", boxes.truth_of(folders[0])["sphere_mass"])
        (empty + rolling).show(level)
        empty.show("    empty", each=True)
        rolling.show("    with a sphere", each=True)
        together.show("    three together", each=True)
    for level in LEVELS:
        made, row = boxes.Level(RECORDINGS / level, "", ROBOT), Row()
        for folder in made.folders("container_sphere_*"):
            row.add(made.find([folder]), "sphere_mass", boxes.truth_of(folder)["sphere_mass"])
        row.show(f"{level}, not calibrated", each=True)


def blocks() -> None:
    """Young's moduli of soft blocks: light, heavy and random."""
    for level in LEVELS:
        closings = calibrations.empty_runs(RECORDINGS / level, ROBOT, "squeeze_empty_*")
        robot = calibrated_on([*calibrations.empty_runs(RECORDINGS / level, ROBOT), *closings])
        row, ratios, stated = Row(), Row(), Row()
        for block in squeezes.BLOCKS:
            folder = RECORDINGS / level / f"squeeze_{block}"
            _, modulus, ratio = squeezes.cube_of(folder)
            estimate = squeezes.squeezed(robot, folder)
            row.add(estimate, "youngs_modulus", modulus, 100.0 / modulus)
            ratios.add(estimate, "poissons_ratio", ratio, 1.0)
            if level == "quantised_s00":
                # the truth is each finger's; both together close by twice as much
                gap = Quantity(2.0 * replays.truth_of(folder)["cube"]["gap"], 1e-5)
                stated.add(squeezes.squeezed(robot, folder, gap=gap), "youngs_modulus", modulus, 100.0 / modulus)
        row.show(level, each=True)
        ratios.show("    Poisson's ratio", each=True)
        if stated.asked:
            stated.show("    with the gap before the touch stated to 0.01 mm", each=True)


def main() -> None:
    tables = {"weighing": weighing, "container": container, "blocks": blocks}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", default=list(tables), help=", ".join(tables))
    for name in parser.parse_args().tables:
        tables[name]()


if __name__ == "__main__":
    main()
