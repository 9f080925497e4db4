"""An arm of six joints in MuJoCo under a computed-torque controller: the data of `test_motion_fit` and of `benchmarks/motions.py`.

The arm that moves differs from the one in the robot file: links, friction, rotors, torque constants and delays are drawn at random.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.motions import Motion

JOINTS = tuple(f"j{n}" for n in range(1, 7))
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
ORIGINS = ("0 0 0.1", "0 0.05 0.1", "0 0 0.35", "0.1 -0.05 0", "0.2 0 0", "0.08 0 0")
MASSES_KG = (3.0, 4.0, 2.5, 1.0, 0.8, 0.3)
COMS_M = ((0, 0, 0.05), (0, 0, 0.17), (0.05, 0, 0.02), (0.1, 0, 0), (0.04, 0, 0), (0.02, 0, 0))
SIZES_M = (0.1, 0.2, 0.12, 0.1, 0.08, 0.05)
TORQUE_CONSTANT_N_M_PER_A = (10.0, 10.0, 10.0, 5.0, 5.0, 5.0)
RATE_HZ = 100.0
STEP_S = 0.001


def urdf(
    masses: np.ndarray, coms: np.ndarray, inertias: np.ndarray, payload: tuple[float, np.ndarray] | None = None
) -> str:
    """The arm's URDF; a payload (mass [kg], centre in the hand [m]) is a ball in the hand."""
    lines = ['<robot name="twin"><link name="base"/>']
    parent = "base"
    for n, joint in enumerate(JOINTS):
        c, i = coms[n], inertias[n]
        lines.append(
            f'<link name="l{n + 1}"><inertial><origin xyz="{c[0]} {c[1]} {c[2]}"/><mass value="{masses[n]}"/>'
            f'<inertia ixx="{i[0]}" iyy="{i[1]}" izz="{i[2]}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="l{n + 1}"/>'
            f'<origin xyz="{ORIGINS[n]}"/><axis xyz="{AXES[n]}"/>'
            '<limit lower="-3.1" upper="3.1" effort="500" velocity="10"/></joint>'
        )
        parent = f"l{n + 1}"
    inertial = ""
    if payload is not None and payload[0] > 0.0:
        mass, c = payload
        own = 0.4 * mass * 0.05**2
        inertial = (
            f'<inertial><origin xyz="{c[0]} {c[1]} {c[2]}"/><mass value="{mass}"/>'
            f'<inertia ixx="{own}" iyy="{own}" izz="{own}" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
    lines.append(
        f'<link name="hand">{inertial}</link><joint name="grip" type="fixed"><parent link="l6"/><child link="hand"/>'
        '<origin xyz="0.05 0 0"/></joint></robot>'
    )
    return "".join(lines)


def nominal() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses [kg], centres [m] and inertias [kg m^2] of the robot file's arm."""
    masses = np.array(MASSES_KG)
    inertias = (masses * np.array(SIZES_M) ** 2 / 6.0)[:, None] * np.array([1.0, 1.1, 0.9])
    return masses, np.array(COMS_M, dtype=float), inertias


def inertia_matrix(model: Any, data: Any, out: np.ndarray) -> None:
    """MuJoCo changed the order of the arguments."""
    import mujoco

    if hasattr(data, "qM"):
        mujoco.mj_fullM(model, out, data.qM)
    else:
        mujoco.mj_fullM(model, data, out)


def write_robot(folder: Path, torque_std: float = 0.01) -> Path:
    """URDF and robot file of the arm as its maker states it; returns the robot file."""
    (folder / "twin.urdf").write_text(urdf(*nominal()))
    lines = ["name: twin", "urdf: twin.urdf", "payload_frame: hand", "joints:"]
    for joint, constant in zip(JOINTS, TORQUE_CONSTANT_N_M_PER_A, strict=True):
        lines += [
            f"  {joint}:",
            f"    motor: {{nominal_torque_constant_N_m_per_A: {constant}, encoder_resolution_rad: 1.0e-4, encoder_noise_rad: "
            "1.0e-4, current_limit_A: 50.0, supply_voltage_V: 0.0, back_emf_V_s_per_rad: 1.0, resistance_ohm: 1.0}",
            f"    drive_train: {{torque_constant_N_m_per_A: {{value: {constant}, std: {torque_std * constant}}},"
            " coulomb_N_m: {value: 0.0, std: 2.0}, viscous_N_m_s_per_rad: {value: 0.0, std: 2.0},"
            " load_friction: {value: 0.0, std: 0.05}, armature_kg_m2: {value: 0.1, std: 0.2}}",
            "    usable_velocity_rad_s: 10.0",
        ]
    path = folder / "twin.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


@dataclass
class Twin:
    """One arm as it really is, drawn at random."""

    seed: int

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        masses, coms, inertias = nominal()
        self.masses = masses * (1.0 + 0.08 * rng.standard_normal(6))
        self.coms = coms + 0.005 * rng.standard_normal((6, 3))
        self.inertias = inertias * (1.0 + 0.1 * rng.standard_normal((6, 1)))
        self.torque = 1.0 + 0.01 * rng.standard_normal(6)
        self.armature = rng.uniform(0.05, 0.3, 6)
        self.viscous = rng.uniform(0.1, 1.0, 6)
        self.coulomb = rng.uniform(0.2, 1.5, 6) * np.array([1, 1, 1, 0.3, 0.3, 0.3])
        self.gears = rng.uniform(0.0, 0.06, 6)
        self.place = rng.uniform(0.1, 0.3, 6)  # part of Coulomb friction that goes with the angle
        self.delay = int(rng.integers(0, 10))
        self.rng = rng

    def record(self, name: str, seconds: float, payload: tuple[float, np.ndarray] | None = None) -> Motion:
        """A motion along random sines, with the payload in the hand."""
        import mujoco

        spec = mujoco.MjSpec.from_string(urdf(self.masses, self.coms, self.inertias, payload))
        spec.compiler.fusestatic = True
        spec.compiler.balanceinertia = True
        model = spec.compile()
        model.opt.timestep = STEP_S
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        model.dof_armature[:] = self.armature
        data = mujoco.MjData(model)
        rng = self.rng
        phase, speed = rng.uniform(0, 2 * np.pi, (6, 4)), rng.uniform(0.3, 2.2, (6, 4))
        size = rng.uniform(0.1, 0.35, (6, 4))
        middle = np.array([0.0, 0.3, 0.8, 0.0, 0.5, 0.0])
        warm = 1.0 + 0.05 * rng.standard_normal(6)  # friction is not the same twice

        def wanted(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            angle = speed * t + phase
            return (
                middle + (size * np.sin(angle)).sum(1),
                (size * speed * np.cos(angle)).sum(1),
                -(size * speed**2 * np.sin(angle)).sum(1),
            )

        data.qpos[:], data.qvel[:], _ = wanted(0.0)
        constants = np.array(TORQUE_CONSTANT_N_M_PER_A)
        queue = [np.zeros(6)] * (self.delay + 1)
        times, positions, currents = [], [], []
        every = round(1.0 / RATE_HZ / STEP_S)
        full = np.zeros((6, 6))
        mujoco.mj_forward(model, data)
        for step in range(round((seconds + 1.0) / STEP_S)):
            q, qd, qdd = wanted(step * STEP_S)
            inertia_matrix(model, data, full)
            measured = data.qpos + 1e-4 * rng.standard_normal(6)
            command = (
                full @ (qdd + 225.0 * (q - measured) + 30.0 * (qd - data.qvel)) + data.qfrc_bias + self.viscous * qd
            )
            queue.append(command)
            torque = queue.pop(0)
            transmitted = torque - self.viscous * data.qvel
            coulomb = self.coulomb * warm * (1.0 + self.place * np.sin(2.0 * data.qpos))
            direction = np.tanh(data.qvel / 0.01)
            lost = (coulomb + self.gears * np.abs(transmitted)) * direction
            data.qfrc_applied[:] = transmitted - lost
            if step * STEP_S >= 1.0 and step % every == 0:
                times.append(step * STEP_S + 2e-4 * rng.standard_normal())
                positions.append(data.qpos + 1e-4 * rng.standard_normal(6))
                currents.append(torque / (constants * self.torque) + 0.02 * rng.standard_normal(6))
            mujoco.mj_step(model, data)
        times_s = np.array(times)
        return Motion(
            name, JOINTS, times_s - times_s[0], np.array(positions), np.array(currents), {}, "measured current"
        )
