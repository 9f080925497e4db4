"""Locked joints yield: how they moved while another was driven, and what that did to the driven one.

A servo that holds a joint gives way by a few milliradians when a load comes on. That turns and accelerates whatever it carries,
and the driven joint feels it as a torque: 20 mrad of a shoulder below a driven elbow are worth several grams. The encoders
recorded it, so it is no unknown: the readings are smoothed, and the torque follows from the equations of motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from proprio_ros.records import Run
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.sim.payload import PayloadFacts, pseudo_inertia_basis

KNOT_S = 0.025  # spacing of the accelerations that describe a motion; the joint states come no faster
SEGMENT_S = 0.0125  # the torque is constant over so long, at its value in the middle; its bends are ten times slower
MOVED_EVIDENCE = 5.0
"""Natural logarithm of how much more probable the readings must be with a motion than without: else the joint stood still."""
LOCKED_SCALES = np.geomspace(0.02, 10.0, 10)
"""Accelerations [rad/s^2] that a yielding joint is tried with; 0.02 moves it by 1 mrad in 0.3 s."""
DRIVEN_SCALES = np.geomspace(1.0, 300.0, 8)


@dataclass(frozen=True)
class Motion:
    """A smooth motion that starts at rest at time 0."""

    start: float  # position at rest [rad]
    knots_s: np.ndarray  # shape (K,)
    acceleration: np.ndarray  # at the knots, linear between them [rad/s^2], shape (K,)
    evidence: float  # logarithm of how much more probable this motion makes the readings than none

    def at(self, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position less the start, velocity and acceleration, each of the shape of the times."""
        position, velocity, hat = _basis(times_s, self.knots_s)
        return position @ self.acceleration, velocity @ self.acceleration, hat @ self.acceleration


def _basis(times_s: np.ndarray, knots_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What one unit of acceleration at each knot does to position, velocity and acceleration; shapes (T, K)."""
    step = knots_s[1] - knots_s[0]
    left = times_s[:, None] - np.concatenate([[knots_s[0] - step], knots_s, [knots_s[-1] + step]])[None, :]

    def hats(order: int) -> np.ndarray:
        # a hat is three ramps; each integral of a ramp raises its power
        ramp = np.maximum(left, 0.0) ** order / float(math.factorial(order))
        return (ramp[:, :-2] - 2.0 * ramp[:, 1:-1] + ramp[:, 2:]) / step

    acceleration, velocity, position = hats(1), hats(2), hats(3)
    # the motion starts at time 0: the first hat's rise before it has not happened
    since = np.maximum(times_s, 0.0)
    velocity[:, 0] -= 0.5 * step
    position[:, 0] -= step**2 / 6.0 + 0.5 * step * since
    for part in (acceleration, velocity, position):
        part[times_s < 0.0] = 0.0
    return position, velocity, acceleration


def smooth(times_s: np.ndarray, position: np.ndarray, sigma: float, scales: np.ndarray) -> Motion:
    """The motion that readings show: acceleration as a random walk, how large by the evidence (Kimeldorf & Wahba 1970).

    Args:
        times_s: Increasing; before 0 the joint is at rest, shape (T,).
        position: Readings [rad], shape (T,).
        sigma: Standard deviation of a reading [rad].
        scales: Accelerations that the walk reaches by the end, to be tried [rad/s^2].
    """
    end = float(times_s[-1])
    count = max(int(np.ceil(end / KNOT_S)), 1) + 1
    knots = np.linspace(0.0, max(end, KNOT_S), count)
    shape, _, _ = _basis(times_s, knots)
    # a walk from a free start: covariance of its values at the knots, for scale 1
    walk = (np.minimum.outer(knots, knots) + knots[-1]) / (2.0 * knots[-1])
    middle = float(np.mean(position))
    off = position - middle
    ones = np.ones((len(off), len(off))) * np.pi**2  # where the joint rests is not known beforehand
    noise = sigma**2 * np.eye(len(off))

    def evidence(covariance: np.ndarray) -> tuple[float, np.ndarray]:
        factor = np.linalg.cholesky(covariance)
        solved = np.linalg.solve(covariance, off)
        return float(-0.5 * off @ solved - np.log(np.diag(factor)).sum()), solved

    still, _ = evidence(noise + ones)
    spread = shape @ walk @ shape.T
    tried = [(*evidence(noise + ones + scale**2 * spread), scale) for scale in scales]
    best, solved, scale = max(tried, key=lambda entry: entry[0])
    start = middle + float(np.pi**2 * solved.sum())
    return Motion(start, knots, scale**2 * (walk @ (shape.T @ solved)), best - still)


def locked_motions(robot: Robot, run: Run, joints: tuple[str, ...]) -> dict[str, Motion]:
    """Motions of those locked joints that moved during the run beyond their encoder's noise."""
    found = {}
    times_s = np.concatenate([run.before_times_s, run.times_s])
    for name in joints:
        drive, readings = robot.drive_trains.get(name), run.held_position.get(name)
        if drive is None or readings is None or np.ptp(readings) == 0.0 or robot.model.joint(name).kind == "prismatic":
            continue
        motion = smooth(times_s, readings, drive.reading_std, LOCKED_SCALES)
        if motion.evidence > MOVED_EVIDENCE:
            found[name] = motion
    return found


def loads_of_yielding(
    robot: Robot, run: Run, motions: Mapping[str, Motion], facts: PayloadFacts, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Load that yielding joints, whose motions are given, put on the driven one, beside what it carries when they stand still.

    The driven joint's own motion, which enters weakly, is its smoothed reading with ``noise`` as standard deviation [rad].

    Returns:
        Instants from which each value holds [s], shape (S,), the first 0; with an empty hand [N m] and per kilogram of payload
        [N m/kg], shape (S, 2).
    """
    held = {**run.held, **{name: motion.start for name, motion in motions.items()}}
    model = robot.model.lock([run.joint, *motions], held, robot.gravity)
    times_s = np.concatenate([run.before_times_s, run.times_s])
    driven = smooth(times_s, np.concatenate([run.before_position, run.position]), noise, DRIVEN_SCALES)
    begins = np.arange(0.0, float(run.times_s[-1]), SEGMENT_S)
    rest = np.zeros(len(begins))
    still, moving = [], []
    for name in model.joint_names:
        motion = driven if name == run.joint else motions[name]
        away, velocity, acceleration = motion.at(begins + 0.5 * SEGMENT_S)
        moving.append((motion.start + away, velocity, acceleration))
        still.append(moving[-1] if name == run.joint else (rest + motion.start, rest, rest))
    body, body_from_payload = model.frames[robot.payload_frame]
    payload = np.zeros_like(model.pseudo_inertia)
    if body >= 0:
        unit = np.tensordot(facts.per_kg, pseudo_inertia_basis(), axes=1)
        payload[body] = body_from_payload @ unit @ body_from_payload.T
    inertias = np.array([model.pseudo_inertia, payload])
    row = model.joint_names.index(run.joint)
    return begins, joint_torque(model, moving, row, inertias) - joint_torque(model, still, row, inertias)


def joint_torque(
    model: ReducedModel, motion: list[tuple[np.ndarray, np.ndarray, np.ndarray]], joint: int, inertias: np.ndarray
) -> np.ndarray:
    """Torque that a joint needs for a motion of all joints (d'Alembert's principle over homogeneous transforms), shape (T, I).

    With T a body's transform, P its pseudo-inertia and g gravity as a transform's last column, the torque on joint i is the sum
    over bodies of ``trace(dT/dq_i  P  (T'' - g)^T)``.

    ``model``: the moving bodies and their joints; ``motion``: position, velocity and acceleration of each joint over
    time, each of shape (T,); ``joint``: place of the joint; ``inertias``: sets of pseudo-inertias, one of each body,
    shape (I, n, 4, 4).
    """
    gravity = np.zeros((4, 4))
    gravity[:3, 3] = model.gravity
    ground, zero = np.eye(4), np.zeros((4, 4))
    torque = np.zeros((len(motion[0][0]), len(inertias)))
    bodies: list[tuple[np.ndarray, ...]] = []
    for n, (q, v, a) in enumerate(motion):
        generator = np.zeros((4, 4))
        if model.kinds[n] == "prismatic":
            generator[:3, 3] = model.axes[n]
            moved = np.eye(4) + q[:, None, None] * generator
        else:
            x, y, z = model.axes[n]
            generator[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
            squared = generator @ generator
            moved = np.eye(4) + np.sin(q)[:, None, None] * generator + (1.0 - np.cos(q))[:, None, None] * squared
        # generator and motion commute
        local = model.placement[n] @ moved
        by_q = local @ generator
        first = v[:, None, None] * by_q
        second = a[:, None, None] * by_q + (v**2)[:, None, None] * (by_q @ generator)
        parent = int(model.parents[n])
        place, speed, rate, varied = bodies[parent] if parent >= 0 else (ground, zero, zero, zero)
        here = (
            place @ local,
            speed @ local + place @ first,
            rate @ local + 2.0 * (speed @ first) + place @ second,
            varied @ local + (place @ by_q if n == joint else 0.0),
        )
        bodies.append(here)
        torque += np.einsum("tab,ibc,tac->ti", here[3], inertias[:, n], here[2] - gravity, optimize=True)
    return torque
