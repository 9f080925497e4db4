"""Locked joints yield: how they moved while another was driven, and what that did to the driven one.

A servo that holds a joint gives way by a few milliradians when a load comes on. That turns and accelerates whatever it carries,
and the driven joint feels it as a torque: 20 mrad of a shoulder below a driven elbow are worth several grams. The encoders
recorded it, so it is no unknown: the readings are smoothed, and the torque follows from the equations of motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from proprio_ros.records import Run
from proprio_ros.robot import DriveTrain, ReducedModel, Robot
from proprio_ros.sim.payload import (
    PayloadFacts,
    pseudo_inertia_basis,
)

# spacing of the accelerations that describe a motion
FINEST_KNOT_S = 0.005
KNOT_S = 0.025
MUCH_FINER, FINER_STEPS = 30.0, 6
"""So much finer than they are said to be readings may be, and so many steps to there are tried."""
MOVED_EVIDENCE = 5.0
"""Natural logarithm of how much more probable the readings must be with a motion than without: else the joint stood still."""
LOCKED_SCALES = np.geomspace(0.02, 10.0, 10)
"""Accelerations [rad/s^2] that a yielding joint is tried with; 0.02 moves it by 1 mrad in 0.3 s."""
DRIVEN_SCALES = np.geomspace(1.0, 300.0, 8)
# where a joint rests is determined from so much of what was recorded before the onset [s]
REST_S = 0.2
# farther from there than this, in counts with their noise, it was still on its way
AWAY_READINGS = 4.0


@dataclass(frozen=True)
class Motion:
    """A smooth motion that starts at rest at time 0."""

    start: float  # position at rest [rad]
    knots_s: np.ndarray  # shape (K,)
    acceleration: np.ndarray  # at the knots, linear between them [rad/s^2], shape (K,)
    evidence: float  # logarithm of how much more probable this motion makes the readings than none

    def at(
        self,
        times_s: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position less the start, velocity and acceleration, each of the shape of the times."""
        position, velocity, hat = _basis(times_s, self.knots_s)
        return (
            position @ self.acceleration,
            velocity @ self.acceleration,
            hat @ self.acceleration,
        )


@dataclass(frozen=True)
class Followed:
    """A motion that is known at instants, from rest at the first."""

    times_s: np.ndarray  # shape (T,)
    position: np.ndarray  # [rad]
    velocity: np.ndarray  # [rad/s]

    @property
    def start(self) -> float:
        return float(self.position[0])

    @cached_property
    def acceleration(self) -> np.ndarray:
        return np.gradient(self.velocity, self.times_s)

    def at(
        self,
        times_s: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `Motion.at`."""
        known = (
            self.position - self.start,
            self.velocity,
            self.acceleration,
        )
        position, velocity, acceleration = (
            np.interp(times_s, self.times_s, each, left=0.0) for each in known
        )
        return position, velocity, acceleration


def _basis(
    times_s: np.ndarray,
    knots_s: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What one unit of acceleration at each knot does to position, velocity and acceleration; shapes (T, K)."""
    step = knots_s[1] - knots_s[0]
    left = (
        times_s[:, None]
        - np.concatenate([[knots_s[0] - step], knots_s, [knots_s[-1] + step]])[None, :]
    )

    def hats(order: int) -> np.ndarray:
        # a hat is three ramps; each integral of a ramp raises its power
        ramp = np.maximum(left, 0.0) ** order / float(math.factorial(order))
        hat = ramp[:, :-2] - 2.0 * ramp[:, 1:-1] + ramp[:, 2:]
        return hat / step

    acceleration = hats(1)
    velocity = hats(2)
    position = hats(3)
    # the motion starts at time 0: the first hat's rise before it has not happened
    since = np.maximum(times_s, 0.0)
    velocity[:, 0] -= 0.5 * step
    position[:, 0] -= step**2 / 6.0 + 0.5 * step * since
    for part in (acceleration, velocity, position):
        part[times_s < 0.0] = 0.0
    return position, velocity, acceleration


def smooth(
    times_s: np.ndarray,
    position: np.ndarray,
    sigma: float,
    scales: np.ndarray,
) -> Motion:
    """The motion that readings show: acceleration as a random walk, how large by the evidence (Kimeldorf & Wahba 1970).

    Readings may be finer than they are said to be, down to their rounding: how fine they are, the evidence decides, too.

    Args:
        times_s: Increasing; before 0 the joint is at rest, shape (T,).
        position: Readings [rad], shape (T,).
        sigma: Standard deviation of a reading at most [rad].
        scales: Accelerations that the walk reaches by the end, to be tried [rad/s^2].
    """
    knots = _knots(times_s)
    shape, _, _ = _basis(times_s, knots)
    # a walk from a free start: covariance of its values at the knots, for scale 1
    walk = np.minimum.outer(knots, knots) + knots[-1]
    walk = np.linalg.cholesky(walk / (2.0 * knots[-1]))
    # where the joint rests is not known beforehand
    off = position - np.mean(position)
    spread = shape @ walk
    left, size, right = np.linalg.svd(
        spread - spread.mean(axis=0),
        full_matrices=False,
    )
    along = left.T @ off  # (K,)
    noise = _noises(position, sigma)[:, None] ** 2  # (N, 1)
    variance = noise[..., None] + (scales[:, None] * size) ** 2  # (N, S, K)
    evidence, still = _evidence(off, along, noise, variance)
    fine, best = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
    steps = scales[best] ** 2 * size * along / variance[fine, best]
    acceleration = walk @ (right.T @ steps)
    start = float(np.mean(position)) - float(np.mean(shape @ acceleration))
    return Motion(
        start,
        knots,
        acceleration,
        float(evidence[fine, best] - still.max()),
    )


def _evidence(
    off: np.ndarray, along: np.ndarray, noise: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithm of how probable readings are, but for a constant.

    Args:
        off: Readings less their mean [rad], shape (T,).
        along: The same in the directions that a motion has, shape (K,).
        noise: Variances of a reading to be tried [rad^2], shape (N, 1).
        variance: Of each direction with each noise and scale, shape (N, S, K).

    Returns: with a motion of each scale, shape (N, S), and without any, shape (N, 1).
    """
    across = max(float(off @ off - along @ along), 0.0)
    more = len(off) - 1 - len(along)
    moving = -0.5 * (
        np.sum(along**2 / variance + np.log(variance), axis=2)
        + across / noise
        + more * np.log(noise)
    )
    squares = along @ along + across
    return moving, -0.5 * (squares / noise + (len(along) + more) * np.log(noise))


def _noises(position: np.ndarray, sigma: float) -> np.ndarray:
    """Standard deviations of a reading to be tried, from its rounding up to ``sigma`` [rad], shape (N,)."""
    finest = max(_rounding(position), sigma / MUCH_FINER)
    noise = np.unique(np.append(np.geomspace(finest, sigma, FINER_STEPS), sigma))
    return noise[noise <= sigma]


def _knots(times_s: np.ndarray) -> np.ndarray:
    """Where accelerations are, twice as far apart as readings, as far as that makes sense."""
    apart = float(
        np.clip(
            2.0 * np.median(np.diff(times_s)),
            FINEST_KNOT_S,
            KNOT_S,
        )
    )
    end = float(times_s[-1])
    return np.linspace(
        0.0,
        max(end, apart),
        max(int(np.ceil(end / apart)), 1) + 1,
    )


def _rounding(position: np.ndarray) -> float:
    """Standard deviation of the error of rounding to counts, as the smallest step between readings says [rad]."""
    steps = np.diff(np.sort(position))
    steps = steps[steps > 1e-9]
    return float(steps.min()) / math.sqrt(12.0) if len(steps) else 0.0


def rests_from(
    before_times_s: np.ndarray,
    before: np.ndarray,
    drive: DriveTrain,
) -> int:
    """Row of what was recorded before the onset from which on a joint had come to rest; the first where it had not.

    A recording holds up to a second of it, and an excitation may settle for less after its way there, or a held joint slip.

    Args:
        before_times_s: Before the onset, shape (T,).
        before: Readings then [rad], shape (T,).
        drive: With the encoder of the joint.
    """
    last = before[before_times_s >= -REST_S]
    if len(last) == 0:
        return 0
    reading = float(np.hypot(drive.encoder_resolution, drive.encoder_noise))
    if (steps := np.abs(np.diff(before))).any():  # an encoder that is finer than it is said to be
        least = steps[steps > 0.0].min()
        seen = float(np.hypot(least, np.median(steps)))
        reading = min(reading, max(seen, reading / MUCH_FINER))
    off = np.abs(before - np.median(last)) > AWAY_READINGS * reading
    if off[-len(last) :].any() or not off.any():
        return 0
    return int(np.flatnonzero(off)[-1]) + 1


def locked_motions(
    robot: Robot, run: Run, joints: tuple[str, ...]
) -> tuple[dict[str, float], dict[str, Motion]]:
    """Where locked joints stood, of those that moved, and the motions of those that moved during the run beyond their noise.

    Args:
        robot: Whose joints.
        run: With the readings of the locked joints.
        joints: Those that matter.
    """
    stood = {}
    found = {}
    times_s = np.concatenate([run.before_times_s, run.times_s])
    for name in joints:
        drive = robot.drive_trains.get(name)
        readings = run.held_position.get(name)
        if (
            drive is None
            or readings is None
            or np.ptp(readings) == 0.0
            or robot.model.joint(name).kind == "prismatic"
        ):
            continue
        rests = rests_from(
            run.before_times_s,
            readings[: len(run.before_times_s)],
            drive,
        )
        stood[name] = float(np.mean(readings[rests:]))
        motion = smooth(
            times_s[rests:],
            readings[rests:],
            drive.reading_std,
            LOCKED_SCALES,
        )
        if motion.evidence > MOVED_EVIDENCE:
            stood[name], found[name] = motion.start, motion
    return stood, found


NONE = np.zeros(0)


class Loads(NamedTuple):
    """What loads a joint beside its current, see `loads_of_yielding`.

    In a free swing it is the load that each kilogram's weight puts on the gears, with the sign of the velocity.
    """

    # times_s, load: instants from which on each holds [s], shape (S,), and loads, shape (S, 2)
    times_s: np.ndarray = NONE
    load: np.ndarray = NONE
    # payload that would load the gears as the arm does [kg]; only known of free swings
    arm_as_payload: float = 0.0


def loads_of_yielding(
    robot: Robot,
    run: Run,
    motions: Mapping[str, Motion | Followed],
    facts: PayloadFacts,
    noise: float,
    own: Followed | None = None,
) -> Loads:
    """Load that yielding joints, whose motions are given, put on the driven one, beside what it carries when they stand still.

    The driven joint's own motion enters weakly.

    Args:
        robot: With the arm's masses.
        run: Whose joint was driven.
        motions: Of the joints that yield, by name.
        facts: About the payload.
        noise: Standard deviation of the driven joint's readings [rad], which are smoothed for its own motion.
        own: That motion at even instants, where it is known.

    Returns:
        Instants from which each value holds [s], shape (S,), the first 0; with an empty hand [N m] and per kilogram of payload
        [N m/kg], shape (S, 2).
    """
    held = {
        **run.held,
        **{name: motion.start for name, motion in motions.items()},
    }
    model = robot.model.lock(
        [run.joint, *motions],
        held,
        robot.gravity,
    )
    rests = rests_from(
        run.before_times_s,
        run.before_position,
        robot.drive_trains[run.joint],
    )
    times_s = np.concatenate([run.before_times_s, run.times_s])[rests:]
    driven = own or smooth(
        times_s,
        np.concatenate([run.before_position, run.position])[rests:],
        noise,
        DRIVEN_SCALES,
    )
    # the torque is constant over half of what is between two knots, at its value in the middle; its bends are ten times slower
    segment_s = (
        float(driven.times_s[1]) if isinstance(driven, Followed) else 0.5 * float(driven.knots_s[1])
    )
    begins = np.arange(
        0.0,
        float(run.times_s[-1]),
        segment_s,
    )
    rest = np.zeros(len(begins))
    still = []
    moving = []
    for name in model.joint_names:
        motion = driven if name == run.joint else motions[name]
        away, velocity, acceleration = motion.at(begins + 0.5 * segment_s)
        moving.append((motion.start + away, velocity, acceleration))
        still.append(moving[-1] if name == run.joint else (rest + motion.start, rest, rest))
    inertias = arm_and_payload(robot, model, facts)
    row = model.joint_names.index(run.joint)
    in_motion = joint_torque(model, moving, row, inertias)
    return Loads(begins, in_motion - joint_torque(model, still, row, inertias))


def arm_and_payload(robot: Robot, model: ReducedModel, facts: PayloadFacts) -> np.ndarray:
    """Pseudo-inertias of the arm's moving bodies, and of each kilogram of payload, shape (2, n, 4, 4).

    Args:
        robot: Whose hand holds the payload.
        model: The moving bodies.
        facts: About the payload.
    """
    body, body_from_payload = model.frames[robot.payload_frame]
    payload = np.zeros_like(model.pseudo_inertia)
    if body >= 0:
        unit = np.tensordot(facts.per_kg, pseudo_inertia_basis(), axes=1)
        payload[body] = body_from_payload @ unit @ body_from_payload.T
    return np.array([model.pseudo_inertia, payload])


@dataclass(frozen=True)
class _Body:
    """A body's homogeneous transform over time with its derivatives, shape (T, 4, 4) each."""

    place: np.ndarray
    speed: np.ndarray
    rate: np.ndarray  # second derivative
    # derivative by the joint whose torque is sought; None: that joint does not move it
    varied: np.ndarray | None

    def on(self, parent: _Body) -> _Body:
        """What stands so on a parent, as seen from where the parent is seen from."""
        varied = None
        if self.varied is not None:
            varied = parent.place @ self.varied
        elif parent.varied is not None:
            varied = parent.varied @ self.place
        return _Body(
            parent.place @ self.place,
            parent.speed @ self.place + parent.place @ self.speed,
            parent.rate @ self.place + 2.0 * (parent.speed @ self.speed) + parent.place @ self.rate,
            varied,
        )


def joint_torque(
    model: ReducedModel,
    motion: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    joint: int,
    inertias: np.ndarray,
) -> np.ndarray:
    """Torque that a joint needs for a motion of all joints (d'Alembert's principle over homogeneous transforms).

    With T a body's transform, P its pseudo-inertia and g gravity as a transform's last column, the torque on joint i is the sum
    over bodies of ``trace(dT/dq_i  P  (T'' - g)^T)``.

    Args:
        model: The moving bodies and their joints.
        motion: Position, velocity and acceleration of each joint over time, each of shape (T,).
        joint: Place of the joint.
        inertias: Sets of pseudo-inertias, one of each body, shape (I, n, 4, 4).

    Returns: the torque [N m], shape (T, I).
    """
    gravity = np.zeros((4, 4))
    gravity[:3, 3] = model.gravity
    torque = np.zeros((len(motion[0][0]), len(inertias)))
    bodies: list[_Body] = []
    for n, (q, v, a) in enumerate(motion):
        generator, moved = _joint_transform(
            model.kinds[n],
            model.axes[n],
            q,
        )
        # generator and motion commute
        local = model.placement[n] @ moved
        by_q = local @ generator
        first = v[:, None, None] * by_q
        turning = (v**2)[:, None, None] * (by_q @ generator)
        second = a[:, None, None] * by_q + turning
        body = _Body(local, first, second, by_q if n == joint else None)
        if model.parents[n] >= 0:
            body = body.on(bodies[int(model.parents[n])])
        bodies.append(body)
        if body.varied is None:
            continue
        work = body.varied.swapaxes(1, 2) @ (body.rate - gravity)
        work = work.reshape(-1, 16)
        torque += work @ inertias[:, n].reshape(-1, 16).T
    return torque


def _joint_transform(kind: str, axis: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Generator (4, 4) of a joint's motion along or about its axis (3,), and its transform at positions (T,), shape (T, 4, 4)."""
    generator = np.zeros((4, 4))
    if kind == "prismatic":
        generator[:3, 3] = axis
        return generator, np.eye(4) + q[:, None, None] * generator
    x, y, z = axis
    generator[:3, :3] = [
        [0.0, -z, y],
        [z, 0.0, -x],
        [-y, x, 0.0],
    ]
    squared = generator @ generator  # Rodrigues
    return generator, (
        np.eye(4)
        + np.sin(q)[:, None, None] * generator
        + (1.0 - np.cos(q))[:, None, None] * squared
    )
