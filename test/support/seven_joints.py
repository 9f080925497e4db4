"""An arm of seven joints that is not in the repository: a Panda by the Denavit-Hartenberg parameters, limits and torques that its
maker publishes, with masses, centres and inertias that are only plausible.
"""

from __future__ import annotations

from math import pi
from pathlib import Path

from support.small_urdf import link

# a [m], d [m] and alpha after Craig; lowest and highest position [rad], largest torque [N m] and speed [rad/s]; mass of its
# link [kg] and where that mass sits in its frame [m]
JOINTS = (
    (0.0, 0.333, 0.0, -2.8973, 2.8973, 87, 2.175, 3.1, (0.0, -0.03, -0.12)),
    (
        0.0,
        0.0,
        -pi / 2,
        -1.7628,
        1.7628,
        87,
        2.175,
        3.2,
        (0.0, -0.07, 0.03),
    ),
    (
        0.0,
        0.316,
        pi / 2,
        -2.8973,
        2.8973,
        87,
        2.175,
        2.9,
        (0.04, 0.02, -0.06),
    ),
    (
        0.0825,
        0.0,
        pi / 2,
        -3.0718,
        -0.0698,
        87,
        2.175,
        2.6,
        (-0.04, 0.05, 0.02),
    ),
    (
        -0.0825,
        0.384,
        -pi / 2,
        -2.8973,
        2.8973,
        12,
        2.61,
        3.0,
        (0.0, 0.04, -0.11),
    ),
    (
        0.0,
        0.0,
        pi / 2,
        -0.0175,
        3.7525,
        12,
        2.61,
        1.5,
        (0.05, 0.0, -0.01),
    ),
    (
        0.088,
        0.0,
        pi / 2,
        -2.8973,
        2.8973,
        12,
        2.61,
        0.9,
        (0.0, 0.0, 0.08),
    ),
)
FLANGE_M = 0.107


def urdf() -> str:
    """The arm as text."""
    links = [link("link0")]
    joints = []
    for number, (a, d, alpha, lower, upper, effort, velocity, mass, com) in enumerate(JOINTS, 1):
        moment = 0.004 * mass
        inertia = f'<inertia ixx="{moment}" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"/>'
        where = f'<origin xyz="{com[0]} {com[1]} {com[2]}"/><mass value="{mass}"/>{inertia}'
        links.append(link(f"link{number}", f"<inertial>{where}</inertial>"))
        # Craig: turned about x, then along z of the turned frame
        turned = {0.0: (0.0, d), pi / 2: (-d, 0.0), -pi / 2: (d, 0.0)}
        y, z = turned[alpha]
        limit = f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{velocity}"/>'
        joints.append(
            f'<joint name="joint{number}" type="revolute"><parent link="link{number - 1}"/><child link="link{number}"/>'
            f'<origin xyz="{a} {y} {z}" rpy="{alpha} 0 0"/><axis xyz="0 0 1"/>{limit}</joint>'
        )
    links.append('<link name="flange"/>')
    joints.append(
        '<joint name="flange_joint" type="fixed"><parent link="link7"/><child link="flange"/>'
        f'<origin xyz="0 0 {FLANGE_M}"/></joint>'
    )
    return f'<robot name="seven_joints">{"".join(links)}{"".join(joints)}</robot>'


def write(folder: Path) -> Path:
    """A file with the arm's URDF, which is a robot where efforts are torque."""
    path = folder / "seven_joints.urdf"
    path.write_text(urdf(), encoding="utf-8")
    return path
