"""Serial arms drawn at random, as URDF: what a newcomer brings, which no file of the repository describes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

AXES = {3: "zyy", 6: "zyyxyx", 7: "zyzyzyx"}
"""Axis of each joint in its parent's frame, by the number of joints."""
VECTOR = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def joints_of(count: int) -> list[str]:
    """Names, from the base on."""
    return [f"axis_{number}" for number in range(1, count + 1)]


def write_urdf(path: Path, count: int, seed: int) -> Path:
    """An arm of so many joints, whose links are rods along x that get shorter and lighter towards ``tool0``."""
    random = np.random.default_rng(seed)
    parts = ['<link name="base"/>']
    parent = "base"
    reach = 0.0
    for number, (name, axis) in enumerate(
        zip(
            joints_of(count),
            AXES[count],
            strict=True,
        )
    ):
        share = 1.0 - 0.75 * number / count
        mass = 3.0 * share * random.uniform(0.7, 1.3)
        length = share * random.uniform(0.1, 0.3)
        radius = 0.05 * share
        along = 0.5 * mass * radius**2
        across = mass * (3.0 * radius**2 + length**2) / 12.0
        where = f"{0.5 * length:.5f} {random.uniform(-0.01, 0.01):.5f} {random.uniform(-0.01, 0.01):.5f}"
        inertia = f'<inertia ixx="{along:.7f}" iyy="{across:.7f}" izz="{across:.7f}" ixy="0" ixz="0" iyz="0"/>'
        parts += [
            f'<link name="body_{number}"><inertial><origin xyz="{where}"/><mass value="{mass:.5f}"/>{inertia}</inertial></link>',
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="body_{number}"/>'
            f'<origin xyz="{reach:.5f} 0 {0.0 if number else 0.1}"/><axis xyz="{VECTOR[axis]}"/>'
            '<limit lower="-3" upper="3" effort="60" velocity="4"/></joint>',
        ]
        parent = f"body_{number}"
        reach = length
    parts += [
        f'<link name="tool0"/><joint name="mount" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
        f'<origin xyz="{reach:.5f} 0 0"/></joint>'
    ]
    path.write_text(f'<robot name="drawn_{count}">{"".join(parts)}</robot>', encoding="utf-8")
    return path
