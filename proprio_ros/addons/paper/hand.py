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
# one count of an XM430-W350's encoder, current and velocity
COUNT_RAD = 2.0 * np.pi / 4096
COUNT_A = 0.00269
COUNT_RAD_S = 0.02398
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
        """Add the payload and its joints to the model of an arm that is not compiled yet.

        Args:
            mujoco: MuJoCo's module.
            spec: The model.
            hand: The model's body of the payload frame.

        Returns:
            The payload's own body.
        """
        body = super().build(mujoco, spec, hand)
        for along in self.axes:
            kind = mujoco.mjtJoint.mjJNT_SLIDE if self.slides else mujoco.mjtJoint.mjJNT_HINGE
            made = body.add_joint(type=kind, axis=along)
            made.stiffness[0] = self.stiffness
            made.damping[0] = self.damping
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
    """Let the robot of a seed play a sequence.

    Args:
        name: The sequence, of ``config/probes``.
        seed: Draws the robot, its noise, and where a sphere lies.
        held: What is in the hand; None: nothing.
        exact: Whether all is known of the robot (`known_robot`), and only its noise is drawn.
        anywhere: Whether a sphere lies somewhere on the container's floor when the current comes on, drawn for each run.

    Raises:
        SimulationError: A run of it was not made.
    """
    robot = stated_robot()
    truth = (
        Truth.nominal(known_robot())
        if exact
        else Truth.draw(robot, seed, links=True, stribeck=True)
    )
    hand = _MovingHand(robot, truth, seed, held)
    machine = ExcitationMachine(robot)
    machine.start(load_sequence(name, robot), hand.now)
    places_of_sphere = np.random.default_rng((seed, 8))
    while machine.busy:
        before = machine.phase
        command = machine.tick(hand.time_s, hand.now)
        comes_on = machine.phase is Phase.PROBE and before is not Phase.PROBE
        if anywhere and comes_on and isinstance(held, Container):
            place = _on_the_floor(robot, hand.arm.position(), held, places_of_sphere)
            held.put_sphere(hand.arm, place)
        hand.obey(command)
    if machine.phase is not Phase.DONE:
        raise SimulationError(
            f"{name} of robot {seed} was not played to its end: {machine.message}"
        )
    runs = cut_runs(hand.recording(name), joints=list(hand.joints))
    return Played(runs, hand.camera(seed))


class _MovingHand:
    """The arm of a seed in MuJoCo, its driver, which samples it, and a camera that sees a sphere in the hand."""

    def __init__(
        self,
        robot: Robot,
        truth: Truth,
        seed: int,
        held: HandObject | None,
    ) -> None:
        drives = robot.drive_trains
        self.joints = tuple(drives)
        self._scale = np.array([drives[joint].transmission for joint in self.joints])
        self._held = held
        self.arm = VirtualArm(robot, truth, position=PARKED, seed=seed, control_period_s=PERIOD_S)
        self.arm.hold(held)
        at_start = (self.arm.shaft_rad() * self._scale).tolist()
        parked = Command(dict(zip(self.joints, at_start, strict=True)))
        self._waiting = deque([parked] * round(truth.latency_s / PERIOD_S))
        self._rows: list[
            tuple[int, list[float], list[float]]
        ] = []  # stamp [ns], positions, currents
        self._seen: list[tuple[int, np.ndarray]] = []  # stamp [ns] and place of the sphere
        self.time_s = 10.0
        self.now = self._sample()

    def _sample(self) -> JointSample:
        """What the encoders show now, in whole counts."""
        position = self._scale * COUNT_RAD * np.rint(self.arm.encoder_rad() / COUNT_RAD)
        velocity = self._scale * COUNT_RAD_S * np.rint(self.arm.velocity_rad_s() / COUNT_RAD_S)
        return JointSample(
            self.time_s,
            dict(zip(self.joints, position.tolist(), strict=True)),
            dict(zip(self.joints, velocity.tolist(), strict=True)),
        )

    def obey(self, command: Command) -> None:
        """Move on by one sample, which is recorded with the current that was commanded."""
        counted = [_counted(command.current_A.get(joint, 0.0)) for joint in self.joints]
        shown = [self.now.position[joint] for joint in self.joints]
        self._rows.append((round(1e9 * self.now.time_s), shown, counted))
        for tick in range(round(1.0 / (RATE_HZ * PERIOD_S))):
            self._waiting.append(command)
            _drive(self.arm, self._waiting.popleft(), self.joints, self._scale)
            self._look(1e9 * (self.time_s + (tick + 1) * PERIOD_S))
        self.time_s += 1.0 / RATE_HZ
        self.now = self._sample()

    def _look(self, at_ns: float) -> None:
        """The camera sees the sphere, so often in a second."""
        if not isinstance(self._held, Container):
            return
        if not self._seen or at_ns - self._seen[-1][0] > 1e9 / CAMERA_HZ - 1.0:
            self._seen.append((round(at_ns), self._held.sphere_m(self.arm)))

    def recording(self, name: str) -> Recording:
        """All samples so far."""
        times, places, currents = map(np.array, zip(*self._rows, strict=True))
        inputs = InputRecord(times, self.joints, currents, "/applied_effort")
        return Recording(name, JointRecord(times, self.joints, places), inputs)

    def camera(self, seed: int) -> PointTrack | None:
        """Where the camera saw the sphere, with its noise; None where there is none."""
        if not self._seen:
            return None
        rng = np.random.default_rng((seed, 7))
        noise = rng.standard_normal((len(self._seen), 3))
        instants, true = map(np.array, zip(*self._seen, strict=True))
        return PointTrack(instants, true + CAMERA_STD_M * noise)


def _on_the_floor(
    robot: Robot,
    position: dict[str, float],
    held: Container,
    rng: np.random.Generator,
) -> np.ndarray:
    """A place of the sphere on the wall that is lowest, from the container's centre [m], shape (3,)."""
    turned = robot.model.frame_transform(robot.payload_frame, position)[:3, :3]
    down = turned.T @ robot.gravity
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
    least = np.maximum(least, -1.0)
    most = np.minimum(most, 1.0)
    arm.step(np.clip(current, least, most))


@lru_cache(maxsize=4)
def learnt_robot(seed: int, sequence: str) -> Robot | None:
    """The robot of a seed as it learnt itself from a sequence with an empty hand; None where it refused what it learnt."""
    robot = stated_robot()
    estimate = calibrate(
        robot,
        [LoadedRun(run) for run in play(sequence, seed, None).runs],
    )
    return None if estimate.calibration is None else robot.with_calibration(estimate.calibration)
