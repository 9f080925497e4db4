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
from support.arm_in_motion import FOUR, Build, Twin, Way, nominal, urdf, write_robot
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
                _add_servo(spec, joint)
            model = spec.compile()
            model.opt.timestep = STEP_S
            model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
            model.opt.disableflags |= (
                mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
            )
            model.dof_armature[:] = twin.armature
            model.dof_damping[:] = twin.viscous
            # as it comes, MuJoCo's dry friction is soft: a stuck joint creeps, the more the heavier it is
            model.dof_solref[:] = (0.004, 1.0)
            model.dof_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
            if len(self._models) > 64:
                self._models.clear()
            self._models[mass_kg] = model
        return self._models[mass_kg]

    def _moved(
        self,
        sent: np.ndarray,
        coulomb: np.ndarray,
        stretches: Sequence[tuple[float, float]],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions [rad] and the motors' torques [N m] at each step's begin, (S, n) each.

        Args:
            sent: Goals of each step [rad], (S, n).
            coulomb: Dry friction [N m], (n,).
            stretches: Mass in the hand [kg] and end [s] of each; the first second comes before all.
        """
        import mujoco
        from mujoco import rollout

        count = sent.shape[1]
        joints = slice(1, 1 + count)
        state = np.concatenate([[0.0], sent[0], np.zeros(count)])
        positions = []
        torques = []
        begin = 0
        for mass, end_s in stretches:
            model = self._model(mass)
            model.dof_frictionloss[:] = coulomb
            end = round((1.0 + end_s) / STEP_S)
            data = mujoco.MjData(model)
            found, felt = rollout.rollout(model, data, state[None], sent[None, begin:end])
            positions += [state[None, joints], found[0, :-1, joints]]
            torques.append(felt[0])  # of the state that each step begins with
            state = found[0, -1]
            begin = end
        return np.vstack(positions), np.vstack(torques)

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
        build = self.build
        twin = self.twin
        rng = np.random.default_rng([self.seed, seed])
        way = Way.draw(rng, build)
        warm = 1.0 + 0.05 * rng.standard_normal(len(build.joints))
        steps = round((seconds + 1.0) / STEP_S)
        sent = _goals(way, STEP_S * np.arange(steps))
        position, torque = self._moved(
            sent,
            twin.coulomb * self.drift * warm,
            _stretches(mass_kg, changes, seconds),
        )
        every = round(1.0 / RATE_HZ / STEP_S)
        sampled = slice(round(1.0 / STEP_S), None, every)
        position = position[sampled]
        torque = torque[sampled]
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
) -> list[tuple[float, float]]:
    """Mass in the hand [kg] and end [s] of each stretch."""
    masses = [mass_kg, *(mass for _, mass in changes)]
    ends = [*(at for at, _ in changes), seconds]
    return list(zip(masses, ends, strict=True))


def _goals(way: Way, times_s: np.ndarray) -> np.ndarray:
    """Goals of the servos, (S, n); added up sine by sine, as rows of earlier days were."""
    goals = sum(
        way.size[:, n] * np.sin(way.speed[:, n] * times_s[:, None] + way.phase[:, n])
        for n in range(way.size.shape[1])
    )
    return way.middle + goals


def _add_servo(spec: Any, joint: str) -> None:
    """A position servo, and a sensor of its torque."""
    import mujoco

    motor = spec.add_actuator()
    motor.name = joint
    motor.target = joint
    motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    motor.gainprm[0] = 150.0
    motor.biasprm[1] = -150.0
    motor.biasprm[2] = -3.0
    motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    felt = spec.add_sensor()
    felt.name = f"{joint}_torque"
    felt.type = mujoco.mjtSensor.mjSENS_JOINTACTFRC
    felt.objname = joint
    felt.objtype = mujoco.mjtObj.mjOBJ_JOINT


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
