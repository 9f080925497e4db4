"""An arm of any URDF in MuJoCo under a controller, as a bag: what a newcomer records, with a truth that the file does not state."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.recordings.writer import write_messages
from support.arm_in_motion import inertia_matrix

STEP_S = 0.001


@dataclass(frozen=True)
class Goals:
    """Three sines for each joint about a middle: what the controller asks for, all of N joints."""

    phases: np.ndarray
    speeds: np.ndarray
    sizes: np.ndarray
    middle: np.ndarray

    @classmethod
    def draw(cls, random: np.random.Generator, middle: np.ndarray) -> Goals:
        shape = (len(middle), 3)
        phases = random.uniform(0.0, 2.0 * np.pi, shape)
        speeds = random.uniform(0.4, 2.2, shape)
        sizes = random.uniform(0.1, 0.35, shape)
        return cls(phases, speeds, sizes, middle)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration."""
        angle = self.speeds * t + self.phases
        swings = self.sizes * np.sin(angle)
        rates = self.sizes * self.speeds * np.cos(angle)
        bends = -self.sizes * self.speeds**2 * np.sin(angle)
        return (
            self.middle + swings.sum(axis=1),
            rates.sum(axis=1),
            bends.sum(axis=1),
        )


class JointStates:
    """Messages of ``/joint_states`` as a bag stores them."""

    def __init__(self, joints: Sequence[str]) -> None:
        self.joints = list(joints)
        self.messages: list[RawMessage] = []
        self._types: Any = message_types()
        self._time = self._types.types["builtin_interfaces/msg/Time"]
        self._header = self._types.types["std_msgs/msg/Header"]
        self._state = self._types.types[JOINT_STATE]

    def add(self, time_ns: int, *values: np.ndarray) -> None:
        """One more: positions, velocities and efforts, as the topic has them."""
        time = self._time(sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        header = self._header(stamp=time, frame_id="")
        message = self._state(header, self.joints, *values)
        raw = bytes(self._types.serialize_cdr(message, JOINT_STATE))
        self.messages.append(RawMessage("/joint_states", JOINT_STATE, time_ns, raw))


def _model_of(
    urdf: Path,
    joints: Sequence[str],
    hand: str,
    load_kg: float,
    robot: np.random.Generator,
) -> Any:
    """The arm with a load and with links that are not what its file says; other joints do not move.

    Args:
        urdf: Of the arm.
        joints: That move.
        hand: Link that holds the load.
        load_kg: Of the load.
        robot: Draws the links' masses.
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    spec.option.timestep = STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = (0.0, 0.0, -9.81)
    spec.option.disableflags = int(
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    )
    for equality in list(spec.equalities):
        spec.delete(equality)
    for joint in list(spec.joints):
        if joint.name not in joints:
            spec.delete(joint)
    for body in spec.bodies[1:]:
        body.mass *= 1.0 + 0.04 * robot.standard_normal()
    if load_kg:
        cube = spec.body(hand).add_body(name="load", explicitinertial=True)
        cube.mass = load_kg
        cube.inertia = [load_kg * 0.04**2 / 6.0] * 3
    return spec.compile()


@dataclass(frozen=True)
class _Moved:
    """An arm in MuJoCo whose driven joints follow goals by computed torque.

    Attributes:
        dofs: Of the driven joints.
        inertia: Of all joints, where it is written to, (nv, nv).
    """

    model: Any
    data: Any
    dofs: np.ndarray
    inertia: np.ndarray

    @classmethod
    def of(cls, model: Any, joints: Iterable[str]) -> _Moved:
        """At rest, with those joints driven."""
        import mujoco

        dofs = np.array([model.joint(name).dofadr[0] for name in joints])
        return cls(model, mujoco.MjData(model), dofs, np.zeros((model.nv, model.nv)))

    def draw_drive_trains(
        self,
        robot: np.random.Generator,
        rotor_kg_m2: float,
        friction_N_m: float,
        today: np.ndarray,
    ) -> None:
        """Rotors, viscous and dry friction of the driven joints.

        Args:
            robot: Draws them.
            rotor_kg_m2: About which rotors are drawn.
            friction_N_m: About which friction is drawn.
            today: Dry friction of this motion over the arm's, (n,).
        """
        count = len(self.dofs)
        model = self.model
        model.dof_armature[self.dofs] = rotor_kg_m2 * robot.uniform(0.5, 1.5, count)
        model.dof_damping[self.dofs] = friction_N_m * robot.uniform(0.2, 1.0, count)
        dry = friction_N_m * robot.uniform(0.5, 1.5, count)
        model.dof_frictionloss[self.dofs] = dry * today

    def torque_to(
        self, goal: np.ndarray, speed: np.ndarray, acceleration: np.ndarray
    ) -> np.ndarray:
        """What the driven joints need now [N m], (n,), for a goal's angles, speeds and accelerations."""
        import mujoco

        data = self.data
        dofs = self.dofs
        mujoco.mj_forward(self.model, data)
        inertia_matrix(self.model, data, self.inertia)
        behind = goal - data.qpos[dofs]
        slower = speed - data.qvel[dofs]
        pushed = acceleration + 100.0 * behind + 20.0 * slower
        torque: np.ndarray = self.inertia[np.ix_(dofs, dofs)] @ pushed + data.qfrc_bias[dofs]
        return torque

    def step(self, torque: np.ndarray) -> None:
        """Moves by one step."""
        import mujoco

        self.data.qfrc_applied[self.dofs] = torque
        mujoco.mj_step(self.model, self.data)


def record_arm(
    folder: Path,
    urdf: Path,
    constants: Mapping[str, float],
    hand: str,
    load_kg: float,
    seed: int,
    *,
    robot_seed: int = 0,
    seconds: float = 20.0,
    rate_hz: float = 100.0,
    middle: Sequence[float] | None = None,
    friction_N_m: float = 0.3,
    rotor_kg_m2: float = 0.05,
    torque_noise: float = 0.02,
) -> Path:
    """A bag of ``/joint_states`` (positions, velocities, efforts) of one motion along random sines.

    Args:
        folder: Where the bag goes.
        urdf: As its maker states it; links, friction and rotors of the arm that moves differ, by ``robot_seed``.
        constants: True N m per unit of effort, by joint; other joints are held.
        hand: Link that holds the load, a cube of 4 cm.
        load_kg: 0 is an empty hand.
        seed: Of the motion.
        seconds, rate_hz: Of the recording.
        middle: Positions that the motion goes about [rad].
        friction_N_m, rotor_kg_m2: About which the joints' are drawn.
        torque_noise: Of the sensor [N m], standard deviation.
    """
    robot = np.random.default_rng(robot_seed)
    random = np.random.default_rng(seed)
    count = len(constants)
    arm = _Moved.of(_model_of(urdf, list(constants), hand, load_kg, robot), constants)
    arm.draw_drive_trains(robot, rotor_kg_m2, friction_N_m, random.normal(1.0, 0.03, count))
    goals = Goals.draw(random, np.zeros(count) if middle is None else np.array(middle))
    data = arm.data
    dofs = arm.dofs
    data.qpos[dofs], data.qvel[dofs], _ = goals.at(0.0)
    per_effort = np.array(list(constants.values()))
    states = JointStates(list(constants))
    every = round(1.0 / (rate_hz * STEP_S))
    for step in range(round(seconds / STEP_S)):
        torque = arm.torque_to(*goals.at(step * STEP_S))
        if step % every == 0:
            time_ns = 10**9 + step * round(1e9 * STEP_S)
            seen = data.qpos[dofs] + random.normal(0.0, 1e-4, count)
            efforts = (torque + random.normal(0.0, torque_noise, count)) / per_effort
            states.add(time_ns, seen, data.qvel[dofs].copy(), efforts)
        arm.step(torque)
    write_messages(folder, states.messages)
    return folder
