"""A gantry of three slides whose efforts are forces, in MuJoCo: from its URDF to a mass that holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.arm_in_motion import inertia_matrix
from support.recording_bag import write_recording

from proprio_ros.cli import main
from proprio_ros.errors import RobotError
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.records import JointRecord, Recording
from proprio_ros.robot import load_robot

SLIDES = {"x": ("1 0 0", 30.0), "y": ("0 1 0", 12.0), "z": ("0 0 1", 6.0)}  # axis and mass [kg]
HELD_KG = 2.5
STEP_S = 0.002


def body(mass: float, size: float, place: str = "0 0 0") -> str:
    moment = mass * size**2 / 6.0
    return (
        f'<inertial><origin xyz="{place}"/><mass value="{mass}"/><inertia ixx="{moment}" iyy="{moment}" izz="{moment}" '
        'ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def urdf(heavier: np.ndarray | None = None, held_kg: float = 0.0) -> str:
    parts = ['<link name="base"/>']
    parent = "base"
    factors = np.ones(3) if heavier is None else heavier
    for factor, (name, (axis, mass)) in zip(factors, SLIDES.items(), strict=True):
        parts += [
            f'<link name="{name}_link">{body(factor * mass, 0.2)}</link>',
            f'<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{name}_link"/>'
            f'<origin xyz="0 0.1 -0.1"/><axis xyz="{axis}"/><limit lower="-2" upper="2" effort="400" velocity="3"/></joint>',
        ]
        parent = f"{name}_link"
    held = body(held_kg, 0.1, "0.02 0 -0.05") if held_kg else ""
    parts += [
        f'<link name="tool0">{held}</link><joint name="mount" type="fixed"><parent link="z_link"/><child link="tool0"/>'
        '<origin xyz="0 0 -0.3"/></joint>'
    ]
    return f'<robot name="gantry">{"".join(parts)}</robot>'


class Sines:
    """What the slides are to follow: a sum of four sines each."""

    def __init__(self, rng: np.random.Generator, times_s: np.ndarray) -> None:
        speed = rng.uniform(0.4, 2.2, (3, 4))
        size = rng.uniform(0.05, 0.2, (3, 4))
        angle = speed * times_s[:, None, None] + rng.uniform(0.0, 6.0, (3, 4))
        self.position = (size * np.sin(angle)).sum(-1)  # (T, 3) [m]
        self.velocity = (size * speed * np.cos(angle)).sum(-1)
        self.acceleration = -(size * speed**2 * np.sin(angle)).sum(-1)


def gantry(truth: dict[str, np.ndarray], kg: float) -> Any:
    """With rotors of 2 kg."""
    import mujoco

    spec = mujoco.MjSpec.from_string(urdf(truth["heavier"], kg))
    spec.compiler.fusestatic = True
    model = spec.compile()
    model.opt.timestep = STEP_S
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.dof_armature[:] = 2.0
    return model


def driven(
    model: Any, rng: np.random.Generator, truth: dict[str, np.ndarray]
) -> list[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
    """Time [s], positions, velocities and forces as they are read, 100 times a second from the first second on."""
    import mujoco

    data = mujoco.MjData(model)
    times_s = np.arange(0.0, 21.0, STEP_S)
    goal = Sines(rng, times_s)
    data.qpos[:] = goal.position[0]
    data.qvel[:] = goal.velocity[0]
    full = np.zeros((3, 3))
    rows = []
    mujoco.mj_forward(model, data)
    for step, now_s in enumerate(times_s):
        inertia_matrix(model, data, full)
        back = 225.0 * (goal.position[step] - data.qpos)
        back = back + 30.0 * (goal.velocity[step] - data.qvel)
        force = full @ (goal.acceleration[step] + back) + data.qfrc_bias
        force = force + truth["viscous"] * goal.velocity[step]
        lost = truth["viscous"] * data.qvel + truth["dry"] * np.tanh(data.qvel / 0.02)
        data.qfrc_applied[:] = force - lost
        if now_s >= 1.0 and step % 5 == 0:
            read = truth["scale"] * force + 0.3 * rng.standard_normal(3)
            rows.append((now_s, data.qpos.copy(), data.qvel.copy(), read))
        mujoco.mj_step(model, data)
    return rows


def record(path: Path, rng: np.random.Generator, truth: dict[str, np.ndarray], kg: float) -> None:
    """Write 20 s along sines, with dry and viscous friction, and forces that are read some percent off."""
    rows = driven(gantry(truth, kg), rng, truth)
    stamps_s, at, moving, forces = (np.array(column) for column in zip(*rows, strict=True))
    times_ns = 1_700_000_000_000_000_000 + np.rint(1e9 * stamps_s).astype(np.int64)
    noisy = at + 1e-5 * rng.standard_normal(at.shape)
    joints = JointRecord(times_ns, tuple(SLIDES), noisy, moving, forces)
    write_recording(path, Recording(path.name, joints, None))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gantry")
    (folder / "gantry.urdf").write_text(urdf())
    rng = np.random.default_rng(3)
    truth = {
        "heavier": 1.0 + 0.04 * rng.standard_normal(3),
        "dry": rng.uniform(5.0, 20.0, 3),
        "viscous": rng.uniform(10.0, 40.0, 3),
        "scale": 1.0 + 0.02 * rng.standard_normal(3),
    }
    record(folder / "empty", rng, truth, 0.0)
    record(folder / "loaded", rng, truth, HELD_KG)
    return folder


def test_a_gantry_weighs_what_it_lifts(recorded: Path) -> None:
    """By its robot file as by its URDF alone; where the mass sits, a hand that never turns does not say."""
    file = recorded / "gantry.yaml"
    words = ["robot", "new", str(recorded / "gantry.urdf"), "--effort-unit", "N.m"]
    assert main([*words, "--output", str(file)]) == 0
    for robot in (file, recorded / "gantry.urdf"):
        asked = Options(robot=str(robot), effort_unit="N.m", baseline=[recorded / "empty"])
        answer = replay([recorded / "loaded"], asked)
        mass, centre, *_ = answer.values
        assert answer.verdict.value == "accepted", answer.reasons
        assert mass.ci95[0] < HELD_KG < mass.ci95[1]
        assert mass.ci95[1] - mass.ci95[0] < 0.5 * HELD_KG
        assert centre.value == [None] * 3 and "never turned" in centre.reason


def test_a_slide_by_currents_wants_its_transmission_or_says_that_it_is_one(recorded: Path) -> None:
    """Newton per ampere with a transmission of 1; newton metres per ampere without one would be taken for these."""
    motor = "motor: {nominal_torque_constant_N_m_per_A: 50}"
    head = "name: g\nurdf: gantry.urdf\npayload_frame: tool0\njoints:\n"
    path = recorded / "amperes.yaml"
    path.write_text(head + "".join(f"  {name}: {{{motor}}}\n" for name in SLIDES))
    with pytest.raises(RobotError, match=r"transmission_m_per_rad .* of x, y, z"):
        load_robot(path)
    direct = "transmission_m_per_rad: 1"
    path.write_text(head + "".join(f"  {name}: {{{motor}, {direct}}}\n" for name in SLIDES))
    assert load_robot(path).drive_trains["z"].nominal_effort_per_current == 50.0
