"""The container's sequences on the virtual arm: MuJoCo moves hand, box and sphere, and shares no line with the machine."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from proprio_ros.excitation.machine import Command, ExcitationMachine, JointSample, Phase
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.records import FloatArray
from proprio_ros.robot import load_robot
from proprio_ros.virtual.arm import VirtualArm
from proprio_ros.virtual.objects import Container, HandObject, Payload
from proprio_ros.virtual.robot import PARKED
from proprio_ros.virtual.truth import Truth

ROBOT = load_robot("open_manipulator_x")
JOINTS = tuple(ROBOT.drive_trains)
SCALE = {name: ROBOT.drive_trains[name].transmission for name in JOINTS}
PERIOD_S, RATE_HZ = 0.001, 40.0
COUNT_RAD, COUNT_A, VELOCITY_COUNT_RAD_S = 0.001534, 0.00269, 0.02398
SUPPLY_V, BACK_EMF_V_S, RESISTANCE_OHM = 12.0, 2.49, 5.22


class Hand:
    """A virtual arm whose joints are held by their servos, or driven, after the truth's latency."""

    def __init__(self, seed: int, held: HandObject, coulomb: float | None) -> None:
        truth = Truth.draw(ROBOT, seed, links=True, stribeck=True)
        if coulomb is not None:
            joints = {name: replace(joint, coulomb=coulomb) for name, joint in truth.joints.items()}
            truth = replace(truth, joints=joints)
        self.arm = VirtualArm(ROBOT, truth, position=PARKED, seed=seed, control_period_s=PERIOD_S)
        self.arm.hold(held)
        self.time_s = 10.0
        self.spheres: list[FloatArray] = []
        goals = dict(zip(JOINTS, (self.arm.shaft_rad() * list(SCALE.values())).tolist(), strict=True))
        self.waiting = deque([Command(goals)] * round(truth.latency_s / PERIOD_S))

    def sample(self) -> JointSample:
        angles = (COUNT_RAD * np.rint(self.arm.encoder_rad() / COUNT_RAD)).tolist()
        speeds = (VELOCITY_COUNT_RAD_S * np.rint(self.arm.velocity_rad_s() / VELOCITY_COUNT_RAD_S)).tolist()
        position = {name: SCALE[name] * angle for name, angle in zip(JOINTS, angles, strict=True)}
        velocity = {name: SCALE[name] * speed for name, speed in zip(JOINTS, speeds, strict=True)}
        return JointSample(self.time_s, position, velocity)

    def step(self, command: Command) -> JointSample:
        for _ in range(round(1.0 / (RATE_HZ * PERIOD_S))):
            self.waiting.append(command)
            now = self.waiting.popleft()
            angles, speeds = self.arm.encoder_rad(), self.arm.velocity_rad_s()
            current = np.empty(len(JOINTS))
            for row, name in enumerate(JOINTS):
                if name in now.current_A:
                    current[row] = COUNT_A * round(now.current_A[name] / COUNT_A)
                else:
                    current[row] = 22.5 * (now.position[name] / SCALE[name] - angles[row]) - 0.84 * speeds[row]
            least, most = ((volts - BACK_EMF_V_S * speeds) / RESISTANCE_OHM for volts in (-SUPPLY_V, SUPPLY_V))
            self.arm.step(np.clip(current, np.maximum(least, -1.0), np.minimum(most, 1.0)))
            sphere = self.arm.sphere_m()
            if sphere is not None:
                self.spheres.append(sphere)
        self.time_s += 1.0 / RATE_HZ
        return self.sample()


def played(
    name: str, seed: int, sphere_kg: float, coulomb: float | None = None
) -> tuple[ExcitationMachine, list[float]]:
    """The machine at its end, and how far the sphere moved in each push [m]; without mass there is no sphere."""
    full = Container(0.03, sphere_mass_kg=sphere_kg or 0.012)
    hand = Hand(seed, full if sphere_kg else Payload(full.mass_kg, inertia_kg_m2=full.inertia), coulomb)
    machine, sample = ExcitationMachine(ROBOT), hand.sample()
    machine.start(load_sequence(name, ROBOT), sample)
    moved: list[float] = []
    before = Phase.IDLE
    while machine.busy:
        command = machine.tick(hand.time_s, sample)
        if machine.phase is Phase.PROBE and before is not Phase.PROBE:
            hand.spheres.clear()
        elif machine.phase is not Phase.PROBE and before is Phase.PROBE and sphere_kg:
            moved.append(float(np.linalg.norm(np.array(hand.spheres) - hand.spheres[0], axis=1).max()))
        before = machine.phase
        sample = hand.step(command)
    return machine, moved


# much friction and a heavy rotor, much friction and the lightest rotor, and little friction
@pytest.mark.parametrize(("seed", "coulomb"), [(4, None), (2, None), (3, 0.015)])
@pytest.mark.parametrize("sphere_kg", [0.0, 0.005, 0.06])
def test_a_shaken_hand_stays_where_it_is_and_the_sphere_does_not(
    seed: int, coulomb: float | None, sphere_kg: float
) -> None:
    machine, moved = played("container_shake", seed, sphere_kg, coulomb)
    assert machine.phase is Phase.DONE and all(outcome.used for outcome in machine.outcomes), machine.message
    for outcome in machine.outcomes:
        assert 0.1 <= outcome.travel <= 0.65
    assert all(distance >= 0.005 for distance in moved) and bool(moved) == bool(sphere_kg)


@pytest.mark.parametrize(("seed", "coulomb"), [(1, None), (3, 0.015)])
@pytest.mark.parametrize("sphere_kg", [0.0, 0.06])
def test_a_container_is_lifted_and_lowered_whatever_is_in_it(
    seed: int, coulomb: float | None, sphere_kg: float
) -> None:
    machine, _ = played("container", seed, sphere_kg, coulomb)
    assert machine.phase is Phase.DONE, machine.message
    assert machine.message == "container is done: all 3 runs are good"
    assert max(outcome.attempt for outcome in machine.outcomes) <= 4
    assert all(0.3 <= outcome.travel <= 1.2 for outcome in machine.outcomes if outcome.used)
