"""Recordings without hardware: an OpenManipulator-X in MuJoCo whose drive train is drawn at random and hidden.

The excitation machine plays the same sequences as on a real arm. Servos hold the joints that are not driven; encoders and currents
come in whole counts, and the supply limits the current at speed. Nothing of the identification's simulator is in it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from proprio_ros.errors import SimulationError
from proprio_ros.excitation.commands import Command, JointSample
from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.probes.container.virtual_object import Container
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.records import InputRecord, JointRecord, PointTrack, Recording, Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.objects import HandObject, Payload, Vector
from proprio_ros.virtual.robot import PARKED
from proprio_ros.virtual.truth import Truth

PERIOD_S = 0.001
RATE_HZ = 40.0
COUNT_RAD, COUNT_A, COUNT_RAD_S = 2.0 * np.pi / 4096, 0.00269, 0.02398
"""XM430-W350: of the encoder, the current and the velocity."""
SUPPLY_V = 12.0
BACK_EMF_V_S = 2.49
RESISTANCE_OHM = 5.22
# what a servo holds its joint with
HOLD_A_PER_RAD = 22.5
HOLD_A_S_PER_RAD = 0.84
# of a camera that sees the sphere, for the experiment that wants one
CAMERA_STD_M = 0.002
CAMERA_HZ = 30.0


@lru_cache(maxsize=1)
def stated_robot() -> Robot:
    """The robot as its file states it, not calibrated."""
    return load_robot("open_manipulator_x")


@dataclass(frozen=True)
class HungPayload(Payload):
    """A payload that moves in the hand: on one slide, or on hinges that all pass through the origin of the payload frame."""

    # in the payload frame, each carried by those before
    axes: tuple[Vector, ...] = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    slides: bool = False  # its one joint is a slide instead of a hinge
    stiffness: float = 0.0  # of a spring about each joint's zero [N m/rad, or N/m]
    damping: float = 0.0  # of each joint [N m s/rad, or N s/m]

    def build(self, mujoco: Any, spec: Any, hand: Any) -> Any:
        body = super().build(mujoco, spec, hand)
        for along in self.axes:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if self.slides else mujoco.mjtJoint.mjJNT_HINGE
            made = body.add_joint(type=kind, axis=along)
            made.stiffness[0], made.damping[0] = self.stiffness, self.damping
        return body


class Played(NamedTuple):
    """What one sequence recorded: a run per excitation, and where a camera saw the sphere in the container."""

    runs: tuple[Run, ...]
    sphere: PointTrack | None


def play(
    name: str,
    seed: int,
    held: HandObject | None,
    exact: bool = False,
    anywhere: bool = False,
) -> Played:
    """Let the robot of a seed play a sequence of ``config/probes``; SimulationError where a run of it was not made.

    With ``exact`` all is known of the robot (``known_robot``), and only its noise is drawn; ``anywhere`` lets a sphere
    lie somewhere on the container's floor when the current comes on, drawn for each run.
    """
    robot = stated_robot()
    joints = tuple(robot.drive_trains)
    scale = np.array([robot.drive_trains[joint].transmission for joint in joints])
    truth = (
        Truth.nominal(known_robot())
        if exact
        else Truth.draw(robot, seed, links=True, stribeck=True)
    )
    arm = VirtualArm(robot, truth, position=PARKED, seed=seed, control_period_s=PERIOD_S)
    arm.hold(held)
    at_start = dict(zip(joints, (arm.shaft_rad() * scale).tolist(), strict=True))
    waiting = deque([Command(at_start)] * round(truth.latency_s / PERIOD_S))
    time_s = 10.0
    machine = ExcitationMachine(robot)
    rows: list[tuple[int, list[float], list[float]]] = []  # stamp [ns], positions, currents
    seen: list[tuple[int, np.ndarray]] = []  # stamp [ns] and place of the sphere

    def sample() -> JointSample:
        position = scale * COUNT_RAD * np.rint(arm.encoder_rad() / COUNT_RAD)
        velocity = scale * COUNT_RAD_S * np.rint(arm.velocity_rad_s() / COUNT_RAD_S)
        by_joint = (
            dict(zip(joints, values.tolist(), strict=True)) for values in (position, velocity)
        )
        return JointSample(time_s, *by_joint)

    now = sample()
    machine.start(load_sequence(name, robot), now)
    ticks = round(1.0 / (RATE_HZ * PERIOD_S))
    places_of_sphere = np.random.default_rng((seed, 8))
    while machine.busy:
        before = machine.phase
        command = machine.tick(time_s, now)
        if (
            anywhere
            and machine.phase is Phase.PROBE
            and before is not Phase.PROBE
            and isinstance(held, Container)
        ):
            held.put_sphere(arm, _on_the_floor(robot, arm.position(), held, places_of_sphere))
        counted = [_counted(command.current_A.get(joint, 0.0)) for joint in joints]
        rows.append((round(1e9 * now.time_s), [now.position[joint] for joint in joints], counted))
        for tick in range(ticks):
            waiting.append(command)
            _drive(arm, waiting.popleft(), joints, scale)
            if isinstance(held, Container):
                at_ns = 1e9 * (time_s + (tick + 1) * PERIOD_S)
                if not seen or at_ns - seen[-1][0] > 1e9 / CAMERA_HZ - 1.0:
                    seen.append((round(at_ns), held.sphere_m(arm)))
        time_s += 1.0 / RATE_HZ
        now = sample()
    if machine.phase is not Phase.DONE:
        raise SimulationError(
            f"{name} of robot {seed} was not played to its end: {machine.message}"
        )
    times, places, currents = map(np.array, zip(*rows, strict=True))
    inputs = InputRecord(times, joints, currents, "/applied_effort")
    runs = cut_runs(
        Recording(name, JointRecord(times, joints, places), inputs), joints=list(joints)
    )
    if not seen:
        return Played(runs, None)
    blur = CAMERA_STD_M * np.random.default_rng((seed, 7)).standard_normal((len(seen), 3))
    instants, true = map(np.array, zip(*seen, strict=True))
    return Played(runs, PointTrack(instants, true + blur))


def _on_the_floor(
    robot: Robot,
    position: dict[str, float],
    held: Container,
    rng: np.random.Generator,
) -> np.ndarray:
    """A place of the sphere on the wall that is lowest, from the container's centre [m], shape (3,)."""
    down = robot.model.frame_transform(robot.payload_frame, position)[:3, :3].T @ robot.gravity
    room = 0.5 * np.array(held.inner_size_m) - held.sphere_radius_m
    place: np.ndarray = room * rng.uniform(-0.9, 0.9, 3)
    floor = int(np.argmax(np.abs(down)))
    place[floor] = np.sign(down[floor]) * room[floor]
    return place


@lru_cache(maxsize=1)
def known_robot() -> Robot:
    """A robot whose file says exactly what it is like: friction as of a usual one, everything else nominal."""
    robot = stated_robot()
    exact: dict[str, Any] = {"arm_scale": 1.0, "delay_s": 0.004}
    for joint, drive in robot.drive_trains.items():
        exact |= {
            f"joints.{joint}.drive_train.coulomb_N_m": 0.05,
            f"joints.{joint}.drive_train.viscous_N_m_s_per_rad": 0.01,
            f"joints.{joint}.drive_train.torque_constant_N_m_per_A": drive.torque_constant.value,
            f"joints.{joint}.drive_train.armature_kg_m2": drive.armature.value,
        }
    return robot.with_overrides(exact)


def _counted(current_A: float) -> float:
    return COUNT_A * round(current_A / COUNT_A)


def _drive(
    arm: VirtualArm,
    command: Command,
    joints: tuple[str, ...],
    scale: np.ndarray,
) -> None:
    """One control period: the driven joint's current, and the servos of the others."""
    angles = arm.encoder_rad()
    speeds = arm.velocity_rad_s()
    current = np.empty(len(joints))
    for row, joint in enumerate(joints):
        if joint in command.current_A:
            current[row] = _counted(command.current_A[joint])
        else:
            off = command.position[joint] / scale[row] - angles[row]
            current[row] = HOLD_A_PER_RAD * off - HOLD_A_S_PER_RAD * speeds[row]
    least, most = (
        (volts - BACK_EMF_V_S * speeds) / RESISTANCE_OHM for volts in (-SUPPLY_V, SUPPLY_V)
    )
    arm.step(np.clip(current, np.maximum(least, -1.0), np.minimum(most, 1.0)))


@lru_cache(maxsize=4)
def learnt_robot(seed: int, sequence: str) -> Robot | None:
    """The robot of a seed as it learnt itself from a sequence with an empty hand; None where it refused what it learnt."""
    robot = stated_robot()
    estimate = calibrate(
        robot,
        [LoadedRun(run) for run in play(sequence, seed, None).runs],
    )
    return None if estimate.calibration is None else robot.with_calibration(estimate.calibration)
