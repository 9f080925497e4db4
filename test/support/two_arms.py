"""A robot with wheels, a torso, a head and two hands in MuJoCo: 25 joints in one message, of which one arm holds something.

Its arms differ from its URDF: masses, friction and what efforts say are drawn from a seed. Joints that hold still yield a little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.records import JointRecord, Recording
from support.arm_in_motion import inertia_matrix
from support.recording_bag import write_recording

SIDES = ("left", "right")
WHEELS = tuple(f"{place}_wheel_joint" for place in ("fl", "fr", "rl", "rr"))
TORSO = ("torso_lift_joint", "torso_pitch_joint", "torso_yaw_joint")
HEAD = ("head_pan_joint", "head_tilt_joint")
ARM = tuple(f"arm_{number}_joint" for number in range(1, 8))
# of the arm: axis, origin in the link before [m], mass [kg], where it sits [m], size of the link [m]
ARM_LINKS = (
    ("0 1 0", "0 {side} 0.35", 1.8, "0 {out} -0.02", 0.1),
    ("1 0 0", "0 {out} 0", 1.5, "0 0 -0.1", 0.12),
    ("0 0 1", "0 0 -0.15", 1.2, "0 0 -0.05", 0.1),
    ("0 1 0", "0.02 0 -0.13", 1.0, "0 0.01 -0.08", 0.1),
    ("0 0 1", "-0.02 0 -0.14", 0.7, "0 0 -0.05", 0.08),
    ("0 1 0", "0 0 -0.11", 0.5, "0 0.01 -0.02", 0.06),
    ("1 0 0", "0 0 -0.05", 0.3, "0 0 -0.03", 0.05),
)
EFFORT = (60, 60, 40, 40, 12, 12, 8)  # its motors can give [N m]
FRICTION = np.array([1.5, 1.5, 1.0, 1.0, 0.4, 0.4, 0.3])  # at most, dry [N m]
MIDDLE = np.array([-0.5, 0.4, 0.2, -1.2, 0.1, -0.3, 0.2])  # that an arm moves about [rad]
RATE_HZ = 100.0
STEP_S = 0.002
SLOW_RAD_S = 0.02  # dry friction is smoothed over this


def _link(name: str, mass: float, centre: str, size: float) -> str:
    moment = mass * size**2 / 6.0
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
        f'<inertia ixx="{moment}" iyy="{1.1 * moment}" izz="{0.9 * moment}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(
    name: str,
    parent: str,
    child: str,
    origin: str,
    axis: str,
    kind: str = "revolute",
    limit: str = 'lower="-3" upper="3" effort="80" velocity="5"',
    mimic: str = "",
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{origin}"/>'
        f'<axis xyz="{axis}"/><limit {limit}/>{mimic}</joint>'
    )


def _fixed(parent: str, child: str, origin: str) -> str:
    return (
        f'<link name="{child}"/><joint name="{child}_mount" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}"/></joint>'
    )


def _arm(side: str, held: float, heavier: Sequence[float]) -> list[str]:
    out = 1.0 if side == "left" else -1.0
    parent = "torso"
    parts = []
    for number, (axis, origin, mass, centre, size) in enumerate(ARM_LINKS):
        places = {"side": 0.15 * out, "out": 0.06 * out}
        name = f"{side}_arm_{number + 1}"
        turn = f'lower="-3" upper="3" effort="{EFFORT[number]}" velocity="5"'
        parts += [
            _link(f"{name}_link", mass * heavier[number], centre.format(**places), size),
            _joint(
                f"{name}_joint", parent, f"{name}_link", origin.format(**places), axis, limit=turn
            ),
        ]
        parent = f"{name}_link"
    slide = 'lower="0" upper="0.04" effort="20" velocity="0.2"'
    follows = f'<mimic joint="{side}_finger_joint"/>'
    for finger, y, mimic in (("finger", 1, ""), ("other_finger", -1, follows)):
        parts += [
            _link(f"{side}_{finger}_link", 0.03, "0 0 -0.02", 0.03),
            _joint(f"{side}_{finger}_joint", parent, f"{side}_{finger}_link", f"0 {0.01 * y} -0.06", f"0 {y} 0",
                   "prismatic", slide, mimic),
        ]  # fmt: skip
    parts += [_fixed(parent, f"{side}_tool0", "0 0 -0.1")]
    parts += [_fixed(f"{side}_tool0", f"{side}_camera_link", "0.05 0 0")]
    if held:
        parts += [
            _link("held", held, "0.01 0.02 -0.03", 0.05),
            _joint("grasp", f"{side}_tool0", "held", "0 0 0", "1 0 0", "fixed"),
        ]
    return parts


def urdf(
    held_kg: Mapping[str, float] | None = None,
    heavier: Mapping[str, Sequence[float]] | None = None,
) -> str:
    """As its maker publishes it; what hands hold by side, and links that weigh so many times as much, are of the true robot."""
    parts = [
        '<link name="base"/>',
        _link("torso_base", 8.0, "0 0 0.1", 0.3),
        _link("torso_bend", 4.0, "0 0 0.1", 0.2),
        _link("torso", 9.0, "0.02 0 0.2", 0.3),
        _link("neck", 0.5, "0 0 0.02", 0.05),
        _link("face", 1.5, "0.03 0 0.05", 0.15),
    ]
    for number, wheel in enumerate(WHEELS):
        link = wheel.replace("joint", "link")
        parts += [
            _link(link, 1.0, "0 0 0", 0.1),
            _joint(wheel, "base", link, f"{0.2 - 0.4 * (number // 2)} {0.2 - 0.4 * (number % 2)} 0.1", "0 1 0",
                   "continuous", 'effort="10" velocity="20"'),
        ]  # fmt: skip
    lift = 'lower="0" upper="0.4" effort="900" velocity="0.2"'
    parts += [
        _joint(TORSO[0], "base", "torso_base", "0 0 0.3", "0 0 1", "prismatic", lift),
        _joint(TORSO[1], "torso_base", "torso_bend", "0 0 0.1", "0 1 0"),
        _joint(TORSO[2], "torso_bend", "torso", "0 0 0.2", "0 0 1"),
        _joint(HEAD[0], "torso", "neck", "0 0 0.45", "0 0 1"),
        _joint(HEAD[1], "neck", "face", "0 0 0.05", "0 1 0"),
        _fixed("face", "head_camera_optical_frame", "0.08 0 0.05"),
    ]  # fmt: skip
    for side in SIDES:
        parts += _arm(side, (held_kg or {}).get(side, 0.0), (heavier or {}).get(side, [1.0] * 7))
    return f'<robot name="two_arms">{"".join(parts)}</robot>'


def write_urdf(folder: Path) -> Path:
    path = folder / "two_arms.urdf"
    path.write_text(urdf(), encoding="utf-8")
    return path


@dataclass
class TwoArms:
    """One robot as it really is."""

    seed: int
    heavier: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        self.heavier = {side: 1.0 + 0.04 * rng.standard_normal(7) for side in SIDES}
        self.dry = {side: FRICTION * rng.uniform(0.4, 1.0, 7) for side in SIDES}
        self.viscous = FRICTION * rng.uniform(0.1, 0.4, 7)
        self.scale = 1.0 + 0.02 * rng.standard_normal(7)  # what efforts say over the torque
        self.rng = rng

    def record(
        self,
        path: Path,
        moving: str,
        held_kg: float,
        torso: Mapping[str, float] | None = None,
        swings: Mapping[str, float] | None = None,
        seconds: float = 16.0,
    ) -> None:
        """Write a bag in which one arm moves, its hand empty or not, and wheels and head turn.

        Args:
            path: Of the bag.
            moving: Side of the arm.
            held_kg: What its hand holds.
            torso: Where joints of the torso stand [rad or m].
            swings: How far they swing about that [rad or m].
            seconds: How long.
        """
        import mujoco

        spec = mujoco.MjSpec.from_string(urdf({moving: held_kg}, self.heavier))
        spec.compiler.fusestatic = True
        spec.compiler.balanceinertia = True
        model = spec.compile()
        model.opt.timestep = STEP_S
        model.opt.disableflags |= (
            mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        )
        data = mujoco.MjData(model)
        names = [
            mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, number)
            for number in range(model.njnt)
        ]
        arm = [names.index(f"{moving}_{joint}") for joint in ARM]
        model.dof_armature[:] = 0.05
        friction = np.zeros((2, len(names)))  # dry and viscous
        for side in SIDES:
            columns = [names.index(f"{side}_{joint}") for joint in ARM]
            friction[:, columns] = self.dry[side], self.viscous
        wanted = self._wanted(names, arm, torso or {}, swings or {}, seconds)
        rows = self._simulated(mujoco, model, data, wanted, friction)
        self._write(path, names, rows, arm)

    def _wanted(
        self,
        names: Sequence[str],
        arm: Sequence[int],
        torso: Mapping[str, float],
        swings: Mapping[str, float],
        seconds: float,
    ) -> np.ndarray:
        """Position, velocity and acceleration of all joints at each step, shape (3, S, J)."""
        times_s = np.arange(round((seconds + 1.0) / STEP_S)) * STEP_S
        wanted = np.zeros((3, len(times_s), len(names)))
        rest: dict[str, float] = {}
        for side in SIDES:
            for joint, middle in zip(ARM, MIDDLE, strict=True):
                rest[f"{side}_{joint}"] = middle
            rest[f"{side}_finger_joint"] = 0.02
            rest[f"{side}_other_finger_joint"] = 0.02
        rest.update(torso)

        def add(column: int, size: float, speed: float, phase: float) -> None:
            angle = speed * times_s + phase
            wanted[0, :, column] += size * np.sin(angle)
            wanted[1, :, column] += size * speed * np.cos(angle)
            wanted[2, :, column] -= size * speed**2 * np.sin(angle)

        for column, name in enumerate(names):
            wanted[0, :, column] = rest.get(name, 0.0)
            if name in WHEELS:
                wanted[0, :, column] = 8.0 * times_s
                wanted[1, :, column] = 8.0
            elif name in HEAD or name in swings:
                speed = self.rng.uniform(0.8, 1.6)
                phase = self.rng.uniform(0.0, 6.0)
                add(column, swings.get(name, 0.4), speed, phase)
        for column in arm:
            for _ in range(4):
                size = self.rng.uniform(0.1, 0.3)
                speed = self.rng.uniform(0.4, 2.2)
                phase = self.rng.uniform(0.0, 6.0)
                add(column, size, speed, phase)
        return wanted

    def _simulated(
        self,
        mujoco: Any,
        model: Any,
        data: Any,
        wanted: np.ndarray,
        friction: np.ndarray,
    ) -> list[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
        """Time [s], positions, velocities and the motors' efforts of every sample."""
        full = np.zeros((model.nv, model.nv))
        data.qpos[:] = wanted[0, 0]
        data.qvel[:] = wanted[1, 0]
        every = round(1.0 / RATE_HZ / STEP_S)
        rows = []
        mujoco.mj_forward(model, data)
        for step in range(wanted.shape[1]):
            position, velocity, acceleration = wanted[:, step]
            inertia_matrix(model, data, full)
            measured = data.qpos + 1e-4 * self.rng.standard_normal(model.nq)
            asked = acceleration + 225.0 * (position - measured) + 30.0 * (velocity - data.qvel)
            dry, viscous = friction
            effort = full @ asked + data.qfrc_bias + viscous * velocity
            data.qfrc_applied[:] = (
                effort - viscous * data.qvel - dry * np.tanh(data.qvel / SLOW_RAD_S)
            )
            if step * STEP_S >= 1.0 and step % every == 0:
                rows.append(
                    (step * STEP_S, data.qpos.copy(), data.qvel.copy(), effort.copy()),
                )
            mujoco.mj_step(model, data)
        return rows

    def _write(
        self,
        path: Path,
        names: Sequence[str],
        rows: Sequence[tuple[float, np.ndarray, np.ndarray, np.ndarray]],
        arm: Sequence[int],
    ) -> None:
        """The bag, in the order of the alphabet as a broadcaster has it; followers are not published."""
        columns_of_rows = zip(*rows, strict=True)
        times_s, position, velocity, effort = (np.array(each) for each in columns_of_rows)
        effort[:, arm] *= self.scale
        effort += 0.02 * self.rng.standard_normal(effort.shape)
        position += 1e-4 * self.rng.standard_normal(position.shape)
        published = sorted(name for name in names if "other_finger" not in name)
        columns = [names.index(name) for name in published]
        times_ns = 1_700_000_000_000_000_000 + np.rint(1e9 * times_s).astype(np.int64)
        record = JointRecord(
            times_ns,
            tuple(published),
            position[:, columns],
            velocity[:, columns],
            effort[:, columns],
        )
        write_recording(path, Recording(path.name, record, None))
