"""A box with a sphere on a one-joint arm in MuJoCo, whose law of contact is another than ours, and recordings of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.probes.container.problem import ContainerFacts
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.sphere import Enclosure

CASES = 24
INNER = np.array([0.06, 0.04, 0.04])
RADIUS = 0.01
SHELL_KG = 0.03
REACH_M = 0.16
ARM_KG = 0.25
ARM_AT_M = 0.07
ARM_INERTIA = 2e-4
ARMATURE = 0.012
TORQUE_CONSTANT = 1.78
VISCOUS = 0.01
COUNT_RAD = 2.0 * np.pi / 4096.0
NOISE_RAD = 0.0003
RATE_HZ = 40.0
DURATION_S = 0.6
FIRST_GUESS_KG = 0.03
"""What the current is chosen for: nobody knows the sphere before it is weighed."""

URDF = f"""<robot name="arm">
  <link name="base"/>
  <joint name="wrist" type="revolute">
    <parent link="base"/><child link="forearm"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="20" effort="4"/>
  </joint>
  <link name="forearm"><inertial>
    <origin xyz="{ARM_AT_M} 0 0"/><mass value="{ARM_KG}"/>
    <inertia ixx="{ARM_INERTIA}" ixy="0" ixz="0" iyy="{ARM_INERTIA}" iyz="0" izz="{ARM_INERTIA}"/>
  </inertial></link>
  <joint name="grip" type="fixed"><parent link="forearm"/><child link="hand"/><origin xyz="{REACH_M} 0 0"/></joint>
  <link name="hand"/>
</robot>"""
ROBOT = f"""
name: arm
urdf: arm.urdf
payload_frame: hand
start_velocity_rad_s: 1.0e-4
arm_scale: 1.0
link_mass_std: 0.0
link_com_std_m: 0.0
link_inertia_std: 0.0
delay_s: 0.0
onset_jitter_s: 0.0
stamp_jitter_s: 0.0
torque_disturbance_N_m: 0.0
joints:
  wrist:
    motor:
      nominal_torque_constant_N_m_per_A: {TORQUE_CONSTANT}
      encoder_resolution_rad: {COUNT_RAD}
      encoder_noise_rad: {NOISE_RAD}
      encoder_once_per_turn_rad: 0.0
    drive_train:
      torque_constant_N_m_per_A: {TORQUE_CONSTANT}
      coulomb_N_m: 0.0
      viscous_N_m_s_per_rad: {VISCOUS}
      load_friction: 0.0
      armature_kg_m2: {ARMATURE}
      zero_rad: 0.0
      stribeck: 0.0
      stribeck_velocity_rad_s: 0.1
"""


@dataclass(frozen=True)
class Case:
    """One probe of one sphere.

    Attributes:
        mass_kg, friction: of the sphere; hardness_s: MuJoCo's time constant of a touch.
        start_rad: of the joint, which then moves down.
        damping_ratio: of MuJoCo's touch; 1 does not bounce.
        times_s, current_A: the command.
    """

    name: str
    mass_kg: float
    friction: float
    hardness_s: float
    start_rad: float
    times_s: np.ndarray
    current_A: np.ndarray
    damping_ratio: float = 1.0


def draw(seed: int) -> list[Case]:
    """Half of them are lowered with a constant current, half shaken five times a second about what holds the hand."""
    rng = np.random.default_rng(seed)
    at_the_hand = (SHELL_KG + FIRST_GUESS_KG) * REACH_M
    holding = -9.81 * (ARM_KG * ARM_AT_M + at_the_hand) / TORQUE_CONSTANT
    lightest, heaviest = np.log([0.005, 0.06])
    cases = []
    for row in range(CASES):
        mass = float(np.exp(rng.uniform(lightest, heaviest)))
        friction = float(rng.uniform(0.2, 0.5))
        hardness = float(rng.uniform(0.0015, 0.003))
        if row % 2 == 0:
            name = "tilt"
            start = float(rng.uniform(-0.3, -0.2))
            times = np.zeros(1)
            current = np.array([holding + rng.uniform(0.06, 0.09)])
        else:
            name = "shake"
            start = float(rng.uniform(-0.12, -0.04))
            swing = rng.uniform(0.14, 0.22)
            times = 0.1 * np.arange(6)
            current = holding + swing * np.where(
                np.arange(6) % 2 == 0,
                1.0,
                -1.0,
            )
        cases.append(
            Case(
                f"{name}{row}",
                mass,
                friction,
                hardness,
                start,
                times,
                current,
            )
        )
    return cases


def recorded(
    case: Case,
    seed: int,
    duration_s: float = DURATION_S,
) -> tuple[Run, np.ndarray]:
    """What the encoder shows of an arm of MuJoCo's: the sphere settles for 1 s while the joint is held, then the current comes.

    Returns:
        The run, and where the sphere's centre was in the container's frame at its samples [m], shape (K, 3).
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(_scene(case))
    data = mujoco.MjData(model)
    _settle(model, data, case)
    sample = round(1e4 / RATE_HZ)
    starts = np.round(1e4 * case.times_s).astype(int)
    shown = []
    rolled = []
    for step in range(round(1e4 * duration_s)):
        piece = np.searchsorted(starts, step, side="right") - 1
        data.qfrc_applied[0] = TORQUE_CONSTANT * case.current_A[piece]
        mujoco.mj_step(model, data)
        if (step + 1) % sample == 0:
            shown.append(data.qpos[0])
            rolled.append(_in_the_container(data.qpos))
    rng = np.random.default_rng([seed, int(case.name.strip("tilshake"))])
    angle = np.concatenate([np.full(20, case.start_rad), shown])
    noisy = angle + NOISE_RAD * rng.normal(size=len(angle))
    reading = COUNT_RAD * np.round(noisy / COUNT_RAD)
    run = Run(
        name=case.name,
        joint="wrist",
        onset_ns=0,
        times_s=np.arange(1, len(shown) + 1) / RATE_HZ,
        position=reading[20:],
        before_times_s=np.arange(-20, 0) / RATE_HZ,
        before_position=reading[:20],
        held={},
        held_span={},
        input_times_s=case.times_s,
        input_current_A=case.current_A,
        duration_s=duration_s,
        source="command",
    )
    return run, np.array(rolled)


def _text(values: np.ndarray) -> str:
    return " ".join(map(str, values))


def _walls() -> str:
    """Six boxes around the sphere's room."""
    side = INNER / 2.0
    thick = 0.05
    found = ""
    for axis in range(3):
        along = np.arange(3) == axis
        size = np.where(along, thick / 2.0, side + thick)
        for way in (-1.0, 1.0):
            away = np.where(along, way * (side + thick / 2.0), 0.0)
            place = away + REACH_M * np.eye(3)[0]
            found += (
                '<geom type="box" mass="0" contype="1" conaffinity="0"'
                f' size="{_text(size)}" pos="{_text(place)}"/>'
            )
    return found


def _scene(case: Case) -> str:
    """The arm, its box and the sphere."""
    # a thin shell: each pair of walls at its place, spread over its area
    areas = np.prod(INNER) / INNER
    others = areas.sum() - areas
    spread = SHELL_KG * INNER**2 * (areas / 4.0 + others / 12.0) / areas.sum()
    about = _text(spread.sum() - spread)
    spin = 0.4 * case.mass_kg * RADIUS**2
    return f"""<mujoco>
      <option timestep="1e-4" integrator="implicitfast" gravity="0 0 -9.81" cone="elliptic"/>
      <default><geom condim="3" friction="{case.friction} 0 0" solref="{case.hardness_s} 1"/></default>
      <worldbody>
        <body name="arm">
          <joint name="wrist" type="hinge" axis="0 1 0" armature="{ARMATURE}" damping="{VISCOUS}"/>
          <inertial pos="{ARM_AT_M} 0 0" mass="{ARM_KG}" diaginertia="{ARM_INERTIA} {ARM_INERTIA} {ARM_INERTIA}"/>
          <body><inertial pos="{REACH_M} 0 0" mass="{SHELL_KG}" diaginertia="{about}"/>{_walls()}</body>
        </body>
        <body name="ball"><freejoint/><inertial pos="0 0 0" mass="{case.mass_kg}" diaginertia="{spin} {spin} {spin}"/>
          <geom type="sphere" size="{RADIUS}" mass="0" contype="0" conaffinity="1"/></body>
      </worldbody></mujoco>"""


def _in_the_container(qpos: np.ndarray) -> tuple[float, float, float]:
    """Where the sphere's centre is [m]."""
    cos = np.cos(qpos[0])
    sin = np.sin(qpos[0])
    x, y, z = qpos[1:4]
    return cos * x - sin * z - REACH_M, y, sin * x + cos * z


def _settle(model: Any, data: Any, case: Case) -> None:
    """The sphere comes to rest while the joint is held."""
    import mujoco

    room = INNER / 2.0 - RADIUS
    inside = (REACH_M - room[0] + 1e-4, 0.0, -room[2] + 1e-4)
    cos = np.cos(case.start_rad)
    sin = np.sin(case.start_rad)
    data.qpos[0] = case.start_rad
    data.qpos[1:8] = (
        cos * inside[0] + sin * inside[2],
        0.0,
        cos * inside[2] - sin * inside[0],
        1.0,
        0.0,
        0.0,
        0.0,
    )
    model.dof_armature[0] = 1e6  # held
    model.geom_solref[:, 1] = 1.0  # and nothing bounces yet
    for _ in range(10_000):
        mujoco.mj_step(model, data)
    model.dof_armature[0] = ARMATURE
    model.geom_solref[:, 1] = case.damping_ratio
    data.qpos[0] = case.start_rad
    data.qvel[0] = 0.0
    assert np.abs(data.qvel[1:4]).max() < 1e-3, data.qvel


def known_robot(folder: Path) -> Robot:
    """The same arm as the package sees it: a drive train that is known exactly."""
    (folder / "arm.urdf").write_text(URDF)
    (folder / "arm.yaml").write_text(ROBOT)
    return load_robot(folder / "arm.yaml")


FACTS = ContainerFacts(
    Enclosure("box", INNER, RADIUS),
    mass=SHELL_KG,
    mass_std=0.0,
)
"""What is stated about the box."""
