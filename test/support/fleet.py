"""A fleet's recordings from MuJoCo, with known masses: bags, and data sets in LeRobot's layout.

An arm of four joints under position servos goes along random sines. MuJoCo's own actuators move it and MuJoCo's dry friction slows
it, all in C, so that ten thousand episodes take minutes. The URDF is all that the arm and the robot file share: links, friction,
rotors and torque constants are drawn at random, as in ``identification/arm_in_motion.py``, whose arm it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.motions import Motion
from proprio_ros.records import JointRecord, Recording
from support.arm_in_motion import FOUR, Build, Twin, nominal, urdf, write_robot
from support.recording_bag import write_recording

STEP_S = 0.002
RATE_HZ = 50.0
BEGIN_NS = 1_780_000_000_000_000_000
HELD_AT = np.array([0.015, 0.0, 0.0])
SETTINGS = {"payload.com": [0.015, 0.0, 0.0]}


@dataclass
class Arm:
    """One arm as it really is.

    Args:
        seed: It is drawn from.
        build: How it is built.
        drift: Coulomb friction over that of the first day.
    """

    seed: int
    build: Build = FOUR
    drift: float = 1.0

    def __post_init__(self) -> None:
        self.twin = Twin(self.seed, self.build)
        self._models: dict[float, Any] = {}

    def _model(self, mass_kg: float) -> Any:
        import mujoco

        if mass_kg not in self._models:
            twin = self.twin
            text = urdf(
                twin.masses,
                twin.coms,
                twin.inertias,
                (mass_kg, HELD_AT),
                self.build,
            )
            spec = mujoco.MjSpec.from_string(text)
            spec.compiler.fusestatic = True
            spec.compiler.balanceinertia = True
            for joint in self.build.joints:
                motor = spec.add_actuator()
                motor.name, motor.target, motor.trntype = joint, joint, mujoco.mjtTrn.mjTRN_JOINT
                motor.gainprm[0], motor.biasprm[1], motor.biasprm[2] = 150.0, -150.0, -3.0
                motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
                felt = spec.add_sensor()
                felt.name, felt.type, felt.objname = (
                    f"{joint}_torque",
                    mujoco.mjtSensor.mjSENS_JOINTACTFRC,
                    joint,
                )
                felt.objtype = mujoco.mjtObj.mjOBJ_JOINT
            model = spec.compile()
            model.opt.timestep = STEP_S
            model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
            model.opt.disableflags |= (
                mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
            )
            model.dof_armature[:], model.dof_damping[:] = twin.armature, twin.viscous
            # as it comes, MuJoCo's dry friction is soft: a stuck joint creeps, the more the heavier it is
            model.dof_solref[:], model.dof_solimp[:] = (
                (0.004, 1.0),
                (0.9999, 0.9999, 0.001, 0.5, 2.0),
            )
            if len(self._models) > 64:
                self._models.clear()
            self._models[mass_kg] = model
        return self._models[mass_kg]

    def record(
        self,
        seed: int,
        seconds: float,
        mass_kg: float = 0.0,
        changes: Sequence[tuple[float, float]] = (),
    ) -> Motion:
        """One episode.

        Args:
            seed: Of the motion and the noise.
            seconds: How long.
            mass_kg: In the hand at first.
            changes: When [s] the hand holds how much [kg] from then on.
        """
        import mujoco
        from mujoco import rollout

        build = self.build
        twin = self.twin
        rng = np.random.default_rng([self.seed, seed])
        count = len(build.joints)
        every = round(1.0 / RATE_HZ / STEP_S)
        phase = rng.uniform(
            0,
            2 * np.pi,
            (count, 4),
        )
        speed = rng.uniform(*build.speed, (count, 4))
        size = rng.uniform(*build.size, (count, 4))
        middle = np.array(build.middle)
        coulomb = twin.coulomb * self.drift * (1.0 + 0.05 * rng.standard_normal(count))
        steps = round((seconds + 1.0) / STEP_S)
        times = STEP_S * np.arange(steps)
        sent = middle + sum(
            size[:, n] * np.sin(speed[:, n] * times[:, None] + phase[:, n]) for n in range(4)
        )
        state = np.concatenate([[0.0], sent[0], np.zeros(count)])
        positions = []
        torques = []
        begin = 0
        for at_s, mass, end_s in _stretches(mass_kg, changes, seconds):
            del at_s
            model = self._model(mass)
            model.dof_frictionloss[:] = coulomb
            end = round((1.0 + end_s) / STEP_S)
            found, felt = rollout.rollout(
                model, mujoco.MjData(model), state[None], sent[None, begin:end]
            )
            positions.append(
                np.concatenate([state[None, 1 : 1 + count], found[0, :-1, 1 : 1 + count]])
            )
            torques.append(felt[0])  # of the state that each step begins with
            state = found[0, -1]
            begin = end
        first = round(1.0 / STEP_S)
        position = np.vstack(positions)[first::every]
        torque = np.vstack(torques)[first::every]
        position = position + 1e-4 * rng.standard_normal(position.shape)
        current = torque / (np.array(build.constants) * twin.torque)
        current = current + build.current_noise_A * rng.standard_normal(current.shape)
        times_s = np.arange(len(position)) / RATE_HZ
        return Motion(
            f"{seed}",
            build.joints,
            times_s,
            position,
            current,
            {},
            "measured current",
        )


def _stretches(
    mass_kg: float,
    changes: Sequence[tuple[float, float]],
    seconds: float,
) -> list[tuple[float, float, float]]:
    """Begin, mass in the hand and end of each stretch [s, kg, s]."""
    begins = [(0.0, mass_kg), *changes]
    ends = [at for at, _ in changes] + [seconds]
    return [(at, mass, end) for (at, mass), end in zip(begins, ends, strict=True)]


def write_bag(
    folder: Path,
    motion: Motion,
    begin_ns: int = BEGIN_NS,
    constants: Sequence[float] = FOUR.constants,
) -> Path:
    """A motion as a bag with effort in N m."""
    times_ns = begin_ns + np.rint(1e9 * motion.times_s).astype(np.int64)
    record = JointRecord(
        times_ns, motion.joints, motion.position, effort=motion.current_A * np.array(constants)
    )
    write_recording(folder, Recording(folder.name, record, None))
    return folder


__all__ = ["FOUR", "SETTINGS", "Arm", "nominal", "write_bag", "write_robot"]
