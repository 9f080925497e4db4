"""Recordings of simulated robots in `shared/recordings` and `bags`: the truth beside each, what of it is stated, what is asked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.robot_calibration import LoadedRun
from proprio_ros.inputs.settings import Settings, probe_file
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes.container.facts import container_facts
from proprio_ros.probes.container.identify import find_sphere
from proprio_ros.probes.payload.facts import payload_facts
from proprio_ros.probes.softness.identify import find_softness
from proprio_ros.probes.softness.problem import BlockFacts
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.energies import young
from proprio_ros.sim.payload import PayloadFacts

REFERENCES = (
    "fixed_reference_100g_joint3_x1",
    "fixed_reference_100g_joint2_x2",
    "fixed_reference_100g_joint2_x3",
)
BLOCKS = ("light", "heavy", "random")


def truth_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "truth.json").read_text())


def bag_in(folder: Path) -> Path:
    return next(iter(sorted(folder.glob("bag_*"))))


def runs_of(
    folder: Path,
    robot: Robot,
) -> tuple[Run, ...]:
    return bag_runs(bag_in(folder), Request(robot))


def fixed(recordings: Path, level: str) -> list[Path]:
    """Those with a fixed object in the hand."""
    return sorted((recordings / level).glob("fixed_*"))


def empty_runs(
    level: Path,
    robot: Robot,
    pattern: str = "empty_*",
) -> list[LoadedRun]:
    return [
        LoadedRun(run) for folder in sorted(level.glob(pattern)) for run in runs_of(folder, robot)
    ]


def reference_runs(level: Path, robot: Robot) -> list[LoadedRun]:
    """Runs with the reference of 100 g."""
    return [
        LoadedRun(run, KnownLoad(0.1, facts_of(level / name)))
        for name in REFERENCES
        for run in runs_of(level / name, robot)
    ]


# --- fixed objects ------------------------------------------------------------------------------------------------------


def stated(truth: Mapping[str, Any]) -> dict[str, Any]:
    """What is stated to a fit: where the object sits and its shape, not its mass."""
    payload = truth["payload"]
    if not payload or payload["mass"] == 0.0:
        return {"payload.shape": "point"}
    return {
        "payload.com": payload["offset"],
        "payload.inertia_per_mass": [value / payload["mass"] for value in payload["inertia"]],
    }


def facts_of(folder: Path) -> PayloadFacts:
    """The same as facts."""
    return payload_facts(
        Settings(stated(truth_of(folder))),
        probe_file("payload")["payload"],
    )


def known_drive_train(truth: Mapping[str, Any]) -> dict[str, Any]:
    """The simulator's drive train, put into the robot file as exactly known."""
    exact = (
        "delay_s",
        "onset_jitter_s",
        "torque_disturbance_N_m",
        "link_mass_std",
        "link_com_std_m",
        "link_inertia_std",
    )
    settings: dict[str, Any] = {f"robot.{key}": 0.0 for key in exact} | {"robot.arm_scale": 1.0}
    for joint, values in truth["joints"].items():
        if joint == "gripper_left_joint":
            continue
        prefix = f"robot.joints.{joint}.drive_train."
        settings |= {
            prefix + "torque_constant_N_m_per_A": values["kt"],
            prefix + "coulomb_N_m": values["coulomb"],
            prefix + "viscous_N_m_s_per_rad": values["viscous"],
            prefix + "load_friction": values["load_friction"],
            prefix + "armature_kg_m2": values["armature"],
            prefix + "zero_rad": 0.0,
            f"robot.joints.{joint}.motor.encoder_once_per_turn_rad": 0.0,
        }
    return settings


def weighed(folder: Path, extra: Mapping[str, Any] | None = None, **options: Any) -> Estimate:
    settings = {
        **stated(truth_of(folder)),
        **(extra or {}),
    }
    return replay(
        [bag_in(folder)],
        Options(settings=settings, **options),
    )


# --- spheres and blocks -------------------------------------------------------------------------------------------------


def stated_of_box(folder: Path) -> dict[str, Any]:
    """What is stated to a fit: geometry, no mass."""
    truth = truth_of(folder)["container"]
    return {
        "container.inner_size": [2.0 * half for half in truth["inner_half"]],
        "container.centre": truth["centre"],
        "sphere.radius": truth["sphere_radius"],
    }


@dataclass
class Boxes:
    """Recordings of one calibrated robot with a box in its hand; each is read once."""

    folder: Path
    prefix: str
    robot: Robot
    known: dict[Path, tuple[Run, ...]] = field(default_factory=dict)

    def runs(self, folder: Path) -> tuple[Run, ...]:
        """Of one recording."""
        if folder not in self.known:
            self.known[folder] = runs_of(folder, self.robot)
        return self.known[folder]

    def folders(self, pattern: str) -> list[Path]:
        return sorted(self.folder.glob(f"{self.prefix}{pattern}"))

    def baseline(self, but: str = "") -> list[Run]:
        return [
            run
            for folder in self.folders("container_no_sphere_*")
            if folder.name != but
            for run in self.runs(folder)
        ]

    def find(self, folders: list[Path], **settings: Any) -> Estimate:
        facts = container_facts(
            Settings({**stated_of_box(folders[0]), **settings}), probe_file("container")
        )
        runs = [run for folder in folders for run in self.runs(folder)]
        return find_sphere(
            self.robot,
            runs,
            facts,
            None,
            self.baseline(folders[0].name),
        )


def cube_of(folder: Path) -> tuple[float, float, float]:
    """Edge [m], Young's modulus [Pa], Poisson's ratio."""
    cube = truth_of(folder)["cube"]
    return cube["side"], *young(
        cube["k_mu"],
        cube["k_lambda"],
    )


def squeezed(robot: Robot, folder: Path, **facts: Any) -> Estimate:
    return find_softness(
        robot,
        runs_of(folder, robot),
        BlockFacts(
            np.full(3, cube_of(folder)[0]),
            **facts,
        ),
    )
