"""Machines whose recordings differ from each other, in MuJoCo: arms in motion, servos under their own law, pendulums let go.

Every recording has a torque scale of its own (3 %: in common for all joints, and each joint's), friction (20 %), a zero and an
offset of each joint. `benchmarks/between_recordings.py` says what is asked of them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import JointRecord, Recording, Run
from proprio_ros.robot import Robot, load_robot
from support.arm_in_motion import Build, Differs, Twin
from support.machines import pendulum_urdf

SCALE_COMMON, SCALE_OWN = 0.026, 0.015
"""Relative; together 3 %."""
FRICTION, ZERO_RAD, OFFSET_SHARE = 0.2, 0.005, 0.1
"""Friction relative; the offset in parts of the joint's Coulomb friction."""
HORN_RAD = (0.1, 0.17)
"""A horn that was put on anew."""
ELSEWHERE_RAD = 0.7
FASTER = 1.4


def differs(
    rng: np.random.Generator,
    arm: Twin,
    elsewhere: bool = False,
    times: float = 1.0,
) -> Differs:
    """What a recording of an arm has of its own; with ``times`` so many times as much."""
    count = len(arm.build.axes)
    away = np.zeros(count)
    if elsewhere:
        away = ELSEWHERE_RAD * rng.choice((-1.0, 1.0), count)
    return Differs(
        scale=1.0
        + times * SCALE_COMMON * rng.standard_normal()
        + times * SCALE_OWN * rng.standard_normal(count),
        friction=np.clip(
            1.0 + times * FRICTION * rng.standard_normal(count),
            0.3,
            2.0,
        ),
        offset=times * OFFSET_SHARE * arm.coulomb * rng.standard_normal(count),
        zero=times * ZERO_RAD * rng.standard_normal(count),
        elsewhere=away,
        speed=FASTER if elsewhere else 1.0,
    )


class DifferingArm:
    """An arm, and how its recordings are made.

    Args:
        seed: It is drawn from.
        build: What kind of arm it is.
        seconds: Of each recording.
        times: As far as usual do recordings differ.
    """

    def __init__(
        self,
        seed: int,
        build: Build,
        seconds: float,
        times: float = 1.0,
    ) -> None:
        self.twin, self.seconds = Twin(seed, build), seconds
        self.times = times
        self.rng = np.random.default_rng([seed, 29])

    def held(self) -> tuple[float, np.ndarray]:
        """Mass [kg] and centre in the hand [m] of something."""
        build = self.twin.build
        rng = self.rng
        mass = float(np.exp(rng.uniform(*np.log(build.payload_kg))))
        middle = np.array([build.held_m, 0.0, 0.0])
        return mass, middle + 0.5 * build.held_m * rng.standard_normal(3)

    def recorded(
        self,
        name: str,
        held: tuple[float, np.ndarray] | None = None,
        elsewhere: bool = False,
        alike: bool = False,
    ) -> Motion:
        """A recording; with ``alike`` it has only friction of its own, as a minute later."""
        own = differs(self.rng, self.twin, elsewhere, self.times)
        if alike:
            one = np.ones_like(own.scale)
            own = Differs(
                one,
                1.0 + 0.25 * (own.friction - 1.0),
                0.25 * own.offset,
                0.0 * own.zero,
                own.elsewhere,
            )
        return self.twin.record(
            name,
            self.seconds,
            held,
            differs=own,
        )


def louder(motion: Motion, by: float) -> Motion:
    """All efforts so many times as large."""
    return replace(motion, current_A=by * motion.current_A)


# --- pendulums that are let go ----------------------------------------------------------------------------------------

ARM_M = 0.1
GRAVITY = 9.81
SPREAD_M2 = 0.0025
ROD_KG = 0.03
COUNT_RAD = 2.0 * np.pi / 4096.0
PERIOD_S = 0.01
STEP_S = 5e-4
RELEASED_S = 0.1
LASTS_S = 4.0
_SWING = """<mujoco><option timestep="{step}" gravity="0 0 -{gravity}" integrator="implicitfast"/><worldbody><body>
<joint name="j" type="hinge" axis="0 1 0" armature="{armature}" damping="{viscous}" frictionloss="{dry}"/>
<inertial pos="0 0 {centre}" mass="{mass}" diaginertia="{about} {about} 1e-6"/></body></worldbody></mujoco>"""
_FILE = """name: swing
urdf: swing.urdf
payload_frame: tip
gravity: [0.0, 0.0, -9.81]
joints:
  pendulum:
    motor: {nominal_torque_constant_N_m_per_A: 1.0, encoder_resolution_rad: 0.00153398, encoder_noise_rad: 0.0005}
    drive_train:
      torque_constant_N_m_per_A: 1.0
      coulomb_N_m: {value: 0.1, std: 0.2}
      viscous_N_m_s_per_rad: {value: 0.0, std: 0.1}
      load_friction: {value: 0.0, std: 0.1}
      armature_kg_m2: {value: 0.02, std: 0.02}
"""


def pendulum_in(folder: Path) -> Robot:
    """A pendulum whose drive train is open."""
    pendulum_urdf(folder, "swing", ROD_KG, ARM_M)
    (folder / "swing.yaml").write_text(_FILE)
    return load_robot(folder / "swing.yaml")


class Pendulum:
    """A pendulum with a random drive train."""

    def __init__(self, seed: int) -> None:
        rng = self.rng = np.random.default_rng([seed, 30])
        logarithm = rng.uniform(np.log(0.005), np.log(0.04))
        self.armature = float(np.exp(logarithm))
        self.dry = rng.uniform(0.04, 0.2)
        self.viscous = rng.uniform(0.0, 0.03)
        self.lost = rng.uniform(0.0, 0.1)

    def _swing(
        self,
        load_kg: float,
        warm: float,
        start_rad: float,
    ) -> np.ndarray:
        """Angles of a swing from rest at each step of the simulation [rad].

        Args:
            load_kg: At the end of the rod.
            warm: Friction over that of the drive train.
            start_rad: From which it swings.
        """
        import mujoco

        mass = load_kg + ROD_KG
        moment = (load_kg + 0.5 * ROD_KG) * ARM_M
        about_axis = load_kg * (ARM_M**2 + SPREAD_M2) + ROD_KG * ARM_M**2 / 3.0
        centre = moment / mass
        text = _SWING.format(
            step=STEP_S,
            gravity=GRAVITY,
            armature=self.armature,
            viscous=warm * self.viscous,
            dry=warm * self.dry,
            mass=mass,
            centre=-centre,
            about=max(about_axis - mass * centre**2, 1e-7),
        )
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.qpos[0] = start_rad
        track = [start_rad]
        for _ in range(round(LASTS_S / STEP_S)):
            load = abs(moment * GRAVITY * np.sin(data.qpos[0]))
            model.dof_frictionloss[0] = warm * (self.dry + self.lost * load)
            mujoco.mj_step(model, data)
            track.append(float(data.qpos[0]))
        return np.array(track)

    def released(
        self,
        name: str,
        load_kg: float,
        horn: bool = False,
    ) -> Run:
        """A swing, cut out as from a bag that says when torque went off."""
        rng = self.rng
        warm = float(np.clip(1.0 + FRICTION * rng.standard_normal(), 0.3, 2.0))
        zero = (
            rng.choice((-1.0, 1.0)) * rng.uniform(*HORN_RAD)
            if horn
            else ZERO_RAD * rng.standard_normal()
        )
        path = self._swing(load_kg, warm, -rng.uniform(1.2, 1.6))
        jitter_s = 3e-4 * rng.standard_normal(round(LASTS_S / PERIOD_S))
        stamps_s = np.arange(0.0, LASTS_S, PERIOD_S) + jitter_s
        step = np.rint((stamps_s - RELEASED_S) / STEP_S).astype(int)
        there = path[np.clip(step, 0, len(path) - 1)]
        seen = there - zero + 5e-4 * rng.standard_normal(len(there))
        reading = COUNT_RAD * np.rint(seen / COUNT_RAD)
        times_ns = 1_000_000_000 + np.rint(1e9 * stamps_s).astype(np.int64)
        off = (int(1_000_000_000 + 1e9 * RELEASED_S), int(times_ns[-1]) + 1)
        joints = JointRecord(times_ns, ("pendulum",), reading[:, None])
        return cut_runs(
            Recording(
                name,
                joints,
                None,
                (),
                (off,),
            ),
            joints=["pendulum"],
        )[0]
