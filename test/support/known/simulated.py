"""Simulated arms whose truth their files do not state, as bags: made in MuJoCo once in a folder, and found there again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proprio_ros.inputs.resources import share_directory
from proprio_ros.robot import load_robot
from support.arm_in_motion import FOUR, SIX, THREE, Build, Twin, write_robot
from support.fleet import write_bag
from support.moved_arm import record_arm

Files = Mapping[str, Path]
BUILDS: Mapping[str, Build] = {
    "six": SIX,
    "four": FOUR,
    "three": THREE,
}
SECONDS = {"six": 20.0, "four": 30.0, "three": 20.0}


@dataclass(frozen=True)
class Ready:
    """An arm with a ready file, in N m.

    Attributes:
        load_kg: Lightest and heaviest that it is given.
        middle: Positions that its motion goes about [rad]; None: all zero.
        friction_N_m, rotor_kg_m2: About which the joints' are drawn.
        torque_noise_N_m: Of the sensors, standard deviation.
    """

    load_kg: tuple[float, float]
    middle: Sequence[float] | None
    friction_N_m: float
    rotor_kg_m2: float
    torque_noise_N_m: float = 0.02


READY: Mapping[str, Ready] = {
    "ur5e": Ready((0.3, 3.0), (0.0, -1.2, 1.4, -0.5, 0.5, 0.0), 0.5, 0.05),
    "panda": Ready((0.2, 2.0), (0.0, -0.4, 0.0, -1.8, 0.0, 1.6, 0.7), 0.3, 0.05),
    "gen3": Ready((0.2, 2.0), (0.0, 0.4, 0.0, 1.4, 0.0, 0.8, 0.0), 0.3, 0.02),
    "openarm": Ready((0.2, 1.0), None, 0.1, 0.01),
    "open_manipulator_x": Ready((0.03, 0.25), None, 0.06, 0.012, 0.005),
}


def twin_mass(build: str, seed: int) -> float:
    """What the arm of a seed holds [kg]; each fourth holds nothing."""
    rng = np.random.default_rng([seed, 2])
    mass_kg, _ = Twin(seed, BUILDS[build]).payload(rng)
    return mass_kg


def twin(folder: Path, build: str, seed: int) -> Files:
    """Files `robot`, `loaded` and `empty` of an arm drawn by a seed."""
    place = folder / f"{build}_{seed}"
    files = {name: place / name for name in ("loaded", "empty")}
    robot = place / "twin.yaml"
    if not files["loaded"].exists():
        place.mkdir(parents=True, exist_ok=True)
        arm = Twin(seed, BUILDS[build])
        load = arm.payload(np.random.default_rng([seed, 2]))
        write_robot(place, build=arm.build)
        for name, held in (("empty", None), ("loaded", load)):
            motion = arm.record(name, SECONDS[build], held)
            write_bag(files[name], motion, constants=arm.build.constants)
    return {**files, "robot": robot}


def ready_mass(arm: str, seed: int) -> float:
    """What the arm of a seed holds [kg]; each fourth holds nothing."""
    low, high = READY[arm].load_kg
    if seed % 4 == 0:
        return 0.0
    rng = np.random.default_rng([seed, 3])
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def ready(folder: Path, arm: str, seed: int) -> Files:
    """Files `loaded` and `empty` of an arm with a ready file, whose links, friction and rotors are drawn by a seed."""
    place = folder / f"{arm}_{seed}"
    files = {name: place / name for name in ("loaded", "empty")}
    robot = load_robot(arm)
    of = READY[arm]
    turning = [each for each in robot.drive_trains if robot.model.joint(each).kind != "prismatic"]
    loads = {"empty": 0.0, "loaded": ready_mass(arm, seed)}
    for number, (name, load_kg) in enumerate(loads.items()):
        if not files[name].exists():
            record_arm(
                files[name],
                share_directory() / "urdf" / f"{arm}.urdf",
                dict.fromkeys(turning, 1.0),
                robot.payload_frame,
                load_kg,
                10 * seed + number,
                robot_seed=seed,
                middle=of.middle,
                friction_N_m=of.friction_N_m,
                rotor_kg_m2=of.rotor_kg_m2,
                torque_noise=of.torque_noise_N_m,
            )
    return files


def so101_mass(seed: int) -> float:
    """What the arm of a seed holds [kg]."""
    rng = np.random.default_rng([seed, 4])
    return float(rng.choice((0.0, 0.05, 0.1, 0.2)))


def so101(folder: Path, seed: int) -> Files:
    """Files `loaded` and `calibration` of an SO-101 that records goals and positions alone, its servos drawn by a seed."""
    import so101 as benchmark

    from proprio_ros.pipeline.calibrate import calibrate_from_bags
    from proprio_ros.pipeline.request import Options

    place = folder / f"so101_{seed}"
    files = {"loaded": place / "loaded", "calibration": place / "so101.yaml"}
    if not files["loaded"].exists():
        place.mkdir(parents=True, exist_ok=True)
        random = np.random.default_rng(seed)
        arm = benchmark.Arm(random)

        def bag(name: str, load_kg: float) -> Path:
            return benchmark.write(
                place / name,
                arm.moved(load_kg, random, 30.0, 40.0),
            )

        empty = [bag("a", 0.0), bag("b", 0.0)]
        known = {bag("known", benchmark.KNOWN_KG): benchmark.KNOWN_KG}
        options = Options(robot="so101", settings=benchmark.SETTINGS)
        calibrate_from_bags(empty, known, options, files["calibration"])
        bag("loaded", so101_mass(seed))
    return files
