"""Robot files of machines that others recorded, and of a pendulum on a table, as a user would write them."""

from __future__ import annotations

from pathlib import Path

REAL = Path(__file__).resolve().parents[3] / "shared" / "recordings_real"
"""Not part of this repository: what needs it is skipped without."""
UR10E_N_M_PER_A = {
    "shoulder_pan_joint": 11.976,
    "shoulder_lift_joint": 11.976,
    "elbow_joint": 9.838,
    "wrist_1_joint": 10.75,
    "wrist_2_joint": 10.67,
    "wrist_3_joint": 10.70,
}
"""By its controller: the torque over the current that it wants at rest."""
_PENDULUM = """<robot name="{name}"><link name="base"/>
<joint name="pendulum" type="continuous"><parent link="base"/><child link="rod"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit velocity="30" effort="20"/></joint>
<link name="rod"><inertial><origin xyz="0 0 {centre}"/><mass value="{mass}"/>
<inertia ixx="{inertia}" iyy="{inertia}" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="to_tip" type="fixed"><parent link="rod"/><child link="tip"/><origin xyz="0 0 {tip}"/></joint><link name="tip"/></robot>
"""


def pendulum_urdf(
    folder: Path,
    name: str,
    rod_kg: float,
    length_m: float,
) -> Path:
    """A rod that hangs from ``pendulum`` and ends in ``tip``."""
    inertia = rod_kg * length_m**2 / 12.0
    urdf = _PENDULUM.format(
        name=name, mass=rod_kg, centre=-0.5 * length_m, tip=-length_m, inertia=inertia
    )
    path = folder / f"{name}.urdf"
    path.write_text(urdf)
    return path
