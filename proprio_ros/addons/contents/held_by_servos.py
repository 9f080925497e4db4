"""Joints that servos hold shake: encoders show to a count where they went, and hardly how they were accelerated on the way.

What drives them is known, once a fit says how the driven joint moved. A servo holds its joint as a spring and a damper do (its
position gain and the motor's back-EMF), and its gears rub; what they take at rest, before a push, may be anything up to that. Three
numbers of each joint, and that one of each run, are fitted to what its encoder showed; the joint that moved farthest comes first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from proprio_ros.addons.contents.held_kernels import DIRECTIONS, OWN, implicit_rollout
from proprio_ros.identification.locked_joints import Followed, arm_and_payload, joint_torque
from proprio_ros.records import FloatArray, Run
from proprio_ros.robot import DriveTrain, ReducedModel, Robot
from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator
from proprio_ros.sim.payload import PayloadFacts

SERVO = np.log([19.0, 0.045])
"""Stiffness [N m/rad], and damping over it [s]: an XM430-W350 at its factory gain and 12 V."""
# of their logarithms, and of friction's over what is known of it
SPREADS = np.array([0.7, 0.7, 0.5])
# over which dry friction is smoothed: a stuck joint creeps by 0.2 mrad in a shake [rad/s]
FRICTION_VELOCITY = 1e-4
# what changes by less than the latter moves nothing
LEAST_FRICTION_N_M = 0.005
LEAST_TORQUE_N_M = 1e-3
SWEEPS = 2  # over the joints: each moves the others
BEFORE_S = -1.0
STEP = 1e-3  # rad, rad/s, rad/s^2: torques are linear in what a joint gives way by


@dataclass(frozen=True)
class Forced:
    """What moves a held joint in a run."""

    run: JointRun
    # its law as far as it is known, by the names of the simulator's parameters
    known: Mapping[str, float]
    # when its encoder was read [s], and what it showed [rad], before the push, too; both (N,)
    read_s: FloatArray
    shown: FloatArray


def give_way(
    robot: Robot,
    runs: Sequence[Run],
    driven: Sequence[Followed],
    facts: PayloadFacts,
    carried_kg: Sequence[float],
) -> list[dict[str, Followed]]:
    """How held joints move while another moves as a fit has it; only those with a drive train and an encoder do.

    Args:
        robot: The arm.
        runs: R runs.
        driven: The motion of the driven joint in each run, at even instants from 0 on.
        facts: Where what is carried sits.
        carried_kg: Its mass in each run.

    Returns:
        The motions in each run, by joint.
    """
    found: list[dict[str, Followed]] = [{} for _ in runs]
    turning = [name for name in robot.drive_trains if robot.model.joint(name).kind != "prismatic"]
    travels = {
        name: [float(np.ptp(run.held_position.get(name, [0.0]))) for run in runs]
        for name in turning
    }
    farthest_first = sorted(travels, key=lambda name: -max(travels[name]))
    for name in farthest_first * SWEEPS:
        forced: dict[int, Forced] = {}
        for row, run in enumerate(runs):
            if not travels[name][row] > 0.0:  # nor where it is not a number
                continue
            moving = {run.joint: driven[row], **found[row]}
            push = forced_on(robot, run, name, moving, facts, carried_kg[row])
            if push is not None:
                forced[row] = push
        if forced:
            servo = Servo([*forced.values()], robot.drive_trains[name].reading_std)
            for row, motion in zip(forced, servo.motions(), strict=True):
                found[row][name] = motion
    return found


@dataclass(frozen=True)
class Needs:
    """What a held joint needs while others move."""

    load: FloatArray  # where it is held [N m], shape (T,)
    still: float  # before anything moves [N m]
    # the load's mean change by its position, velocity and acceleration, shape (3,)
    slopes: FloatArray


@dataclass(frozen=True)
class HeldJoint:
    """A joint that is held while others move."""

    name: str
    held_at: float  # [rad]
    moving: Mapping[str, Followed]
    model: ReducedModel
    inertias: FloatArray  # of the arm with what it carries

    def torque(self, times_s: FloatArray, further: FloatArray) -> FloatArray:
        """What the joint needs [N m], shape (T,).

        Args:
            times_s: Instants of the others' motion, shape (T,).
            further: How far it is from where it is held, how fast, and how accelerated [rad, rad/s, rad/s^2], shape (3, T).
        """
        motion = []
        for name in self.model.joint_names:
            own = name == self.name
            start = self.held_at if own else self.moving[name].start
            q, v, a = further if own else self.moving[name].at(times_s)
            motion.append((start + q, v, a))
        row = self.model.joint_names.index(self.name)
        return joint_torque(self.model, motion, row, self.inertias)[:, 0]

    def needs(self, times_s: FloatArray) -> Needs:
        """What it needs where it is held, and what giving way changes of that, at instants of the others' motion, shape (T,)."""
        count = len(times_s)
        few = times_s[::10]
        # all in one call: where it is held, before anything moves, and three times at a few instants, where it gives way
        instants = np.concatenate([times_s, [BEFORE_S], few, few, few])
        further = np.zeros((3, len(instants)))
        slopes = further[:, count + 1 :].reshape(3, 3, len(few))
        for n in range(3):
            slopes[n, n] = STEP
        torque = self.torque(instants, further)
        load = torque[:count]
        moved = torque[count + 1 :].reshape(3, len(few))
        return Needs(load, float(torque[count]), np.mean(moved - load[::10], axis=1) / STEP)


def forced_on(
    robot: Robot,
    run: Run,
    name: str,
    moving: Mapping[str, Followed],
    facts: PayloadFacts,
    carried_kg: float,
) -> Forced | None:
    """What others that move do to a held joint.

    Args:
        robot: The arm.
        run: What was recorded.
        name: The held joint.
        moving: Motions of all joints that move, at even instants from 0 on.
        facts: Where what is carried sits.
        carried_kg: Its mass.

    Returns:
        None where they do nothing to it.
    """
    others = {each: motion for each, motion in moving.items() if each != name}
    model = robot.model.lock([*others, name], run.held, robot.gravity)
    parts = arm_and_payload(robot, model, facts)
    inertias = np.tensordot([1.0, carried_kg], parts, axes=1)[None]
    joint = HeldJoint(name, run.held[name], others, model, inertias)
    times_s = next(iter(others.values())).times_s
    middle_s = times_s + 0.5 * times_s[1]
    needs = joint.needs(middle_s)
    # nor where a fit that failed says how the driven joint moved
    load = needs.load - needs.still
    if not np.ptp(np.append(load, 0.0)) >= LEAST_TORQUE_N_M:
        return None
    known = known_law(robot.drive_trains[name], needs)
    nothing = np.zeros(len(times_s))
    forced = JointRun(
        times_s,
        times_s,
        nothing,
        (0.0, 0.0, 1.0),
        FRICTION_VELOCITY,
        input_load=np.stack([load, nothing], axis=1),
    )
    read_s = np.concatenate([run.before_times_s, run.times_s])
    seen = read_s <= times_s[-1]
    return Forced(forced, known, read_s[seen], run.held_position[name][seen])


def known_law(drive: DriveTrain, needs: Needs) -> dict[str, float]:
    """The law of a held joint without its servo, by the names of the simulator's parameters."""
    spring, damper, inertia = needs.slopes.tolist()
    friction = drive.coulomb.value + drive.load_friction.value * abs(needs.still)
    return {
        "inertia": inertia + drive.armature.value,
        "gravity_sin": spring,
        "viscous": damper + drive.viscous.value,
        "coulomb": max(friction, LEAST_FRICTION_N_M),
        "stribeck": drive.stribeck.value,
        "stribeck_velocity": drive.stribeck_velocity.value,
    }


class HeldSimulator(JointSimulator):
    """Rolls out joints that servos hold, which stick, by implicit steps; their first `OWN` directions are kept free."""

    tangent_sizes = (DIRECTIONS,)

    def kernel_of(self, size: int, stribeck: bool) -> Any:
        return implicit_rollout(stribeck)

    def usual_kernels(self) -> list[Any]:
        return [implicit_rollout(stribeck) for stribeck in (False, True)]


class Servo:
    """A servo that holds its joint in R runs. Its 3 + R numbers, those of the runs last, are in units of their priors.

    ``sigma``: standard deviation of a reading [rad].
    """

    def __init__(self, forced: Sequence[Forced], sigma: float) -> None:
        self._simulator = HeldSimulator([each.run for each in forced])
        self._sigma = sigma
        self._forced = tuple(forced)
        known = [[each.known.get(name, 0.0) for name in INDEX] for each in forced]
        self._known = np.array(known)  # (R, P)
        self._last: tuple[FloatArray, tuple[FloatArray, ...]] | None = None

    def _law(self, z: FloatArray) -> FloatArray:
        """The joint's parameters in each run, shape (R, P), analytic in the numbers."""
        stiffness, lag_s = np.exp(SERVO + SPREADS[:2] * z[:2])
        p = self._known.astype(z.dtype)
        coulomb = INDEX["coulomb"]
        friction = self._known[:, coulomb] * np.exp(SPREADS[2] * z[2])
        p[:, INDEX["gravity_sin"]] += stiffness
        p[:, INDEX["viscous"]] += stiffness * lag_s
        p[:, coulomb] = friction
        p[:, INDEX["gravity_constant"]] = -friction * np.tanh(z[3:])
        return p

    def along(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Parameters (R, P), and what four numbers change of them behind the `OWN` free directions, shape (R, P, D).

        The four are the three of the servo and a run's own; those of other runs change nothing of it.
        """
        nothing = np.zeros((OWN, len(z)))
        ways = [*nothing, *np.eye(len(z))[:3], np.arange(len(z)) >= 3]
        slopes = [self._law(z + 1e-30j * way).imag / 1e-30 for way in ways]
        return self._law(z), np.stack(slopes, axis=2)

    def shaken(self, z: FloatArray) -> tuple[FloatArray, ...]:
        """Positions less those at rest, velocities, shape (R, T), and the positions' change by the four, (R, T, 4)."""
        if self._last is None or not np.array_equal(self._last[0], z):
            rows = np.arange(len(self._known), dtype=np.int32)
            q, v, slopes = self._simulator.jacobian(rows, *self.along(z))
            self._last = z.copy(), (q.copy(), v.copy(), slopes[..., OWN:].copy())
        return self._last[1]

    def _seen(self, row: int, q: FloatArray) -> FloatArray:
        """What of positions (T, ...) the encoder read, shape (N, ...)."""
        times_s = self._simulator.runs[row].sample_times_s
        columns = [
            np.interp(self._forced[row].read_s, times_s, each[: len(times_s)])
            for each in q.reshape(len(q), -1).T
        ]
        return np.stack(columns, axis=1).reshape(-1, *q.shape[1:])

    def residual(self, z: FloatArray) -> FloatArray:
        """Of all readings, then of the priors, in standard deviations. Where a joint rests, the readings' mean says."""
        positions = self.shaken(z)[0]
        seen = [self._seen(row, q) for row, q in enumerate(positions)]
        off = [each - forced.shown for each, forced in zip(seen, self._forced, strict=True)]
        readings = [(each - each.mean()) / self._sigma for each in off]
        return np.concatenate([*readings, z])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """The residual's derivative."""
        _, _, slopes = self.shaken(z)
        readings = []
        for row, slope in enumerate(slopes):
            seen = self._seen(row, slope)
            whole = np.zeros((len(seen), len(z)))
            whole[:, [0, 1, 2, 3 + row]] = (seen - seen.mean(axis=0)) / self._sigma
            readings.append(whole)
        return np.concatenate([*readings, np.eye(len(z))])

    def motions(self) -> list[Followed]:
        """How the joint moved in each run, by the numbers that follow the readings best."""
        start = np.zeros(3 + len(self._known))
        best = least_squares(
            self.residual,
            start,
            self.jacobian,
            method="lm",
            xtol=1e-3,
            ftol=1e-3,
        ).x
        positions, velocities, _ = self.shaken(best)
        found = []
        for row, run in enumerate(self._simulator.runs):
            q = positions[row]
            times_s = run.sample_times_s
            rest = float(np.mean(self._forced[row].shown - self._seen(row, q)))
            count = len(times_s)
            motion = Followed(times_s, rest + q[:count], velocities[row][:count])
            found.append(motion)
        return found
