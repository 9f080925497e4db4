"""An arm of any URDF in MuJoCo under a controller, as a bag: what a newcomer records, with a truth that the file does not state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.recordings.writer import write_messages

STEP_S = 0.001


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
    import mujoco

    robot = np.random.default_rng(robot_seed)
    random = np.random.default_rng(seed)
    count = len(constants)
    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.compiler.fusestatic, spec.compiler.balanceinertia = False, True
    spec.option.timestep, spec.option.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = (0.0, 0.0, -9.81)
    spec.option.disableflags = int(
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    )
    for equality in list(spec.equalities):
        spec.delete(equality)
    for joint in list(spec.joints):
        if joint.name not in constants:
            spec.delete(joint)
    for body in spec.bodies[1:]:
        body.mass *= 1.0 + 0.04 * robot.standard_normal()
    if load_kg:
        cube = spec.body(hand).add_body(name="load", explicitinertial=True)
        cube.mass, cube.inertia = load_kg, [load_kg * 0.04**2 / 6.0] * 3
    model = spec.compile()
    data = mujoco.MjData(model)
    dofs = np.array([model.joint(name).dofadr[0] for name in constants])
    model.dof_armature[dofs] = rotor_kg_m2 * robot.uniform(0.5, 1.5, count)
    model.dof_damping[dofs] = friction_N_m * robot.uniform(0.2, 1.0, count)
    model.dof_frictionloss[dofs] = (
        friction_N_m * robot.uniform(0.5, 1.5, count) * random.normal(1.0, 0.03, count)
    )
    phases, speeds = (
        random.uniform(
            0.0,
            2.0 * np.pi,
            (count, 3),
        ),
        random.uniform(0.4, 2.2, (count, 3)),
    )
    sizes, about = (
        random.uniform(0.1, 0.35, (count, 3)),
        np.zeros(count) if middle is None else np.array(middle),
    )

    def wanted(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angle = speeds * t + phases
        return (
            about + (sizes * np.sin(angle)).sum(axis=1),
            (sizes * speeds * np.cos(angle)).sum(axis=1),
            -(sizes * speeds**2 * np.sin(angle)).sum(axis=1),
        )

    data.qpos[dofs], data.qvel[dofs], _ = wanted(0.0)
    inertia = np.zeros((model.nv, model.nv))
    per_effort = np.array(list(constants.values()))
    types: Any = message_types()
    time, header, state = (
        types.types[name]
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    messages = []
    every = round(1.0 / (rate_hz * STEP_S))
    for step in range(round(seconds / STEP_S)):
        position = data.qpos[dofs].copy()
        velocity = data.qvel[dofs].copy()
        goal, speed, acceleration = wanted(step * STEP_S)
        mujoco.mj_forward(model, data)
        if hasattr(data, "qM"):
            mujoco.mj_fullM(model, inertia, data.qM)
        else:
            mujoco.mj_fullM(model, data, inertia)
        pushed = acceleration + 100.0 * (goal - position) + 20.0 * (speed - velocity)
        torque = inertia[np.ix_(dofs, dofs)] @ pushed + data.qfrc_bias[dofs]
        if step % every == 0:
            time_ns = 10**9 + step * round(1e9 * STEP_S)
            stamp = header(
                stamp=time(
                    sec=time_ns // 10**9,
                    nanosec=time_ns % 10**9,
                ),
                frame_id="",
            )
            seen = position + random.normal(0.0, 1e-4, count)
            efforts = (torque + random.normal(0.0, torque_noise, count)) / per_effort
            message = state(stamp, list(constants), seen, velocity, efforts)
            raw = bytes(types.serialize_cdr(message, JOINT_STATE))
            messages.append(RawMessage("/joint_states", JOINT_STATE, time_ns, raw))
        data.qfrc_applied[dofs] = torque
        mujoco.mj_step(model, data)
    write_messages(folder, messages)
    return folder
