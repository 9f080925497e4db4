"""Joints that servos hold shake: encoders show to a count where they went, and hardly how they were accelerated on the way.

What drives them is known, once a fit says how the driven joint moved. A servo holds its joint as a spring and a damper do (its
position gain and the motor's back-EMF), and its gears rub; what they take at rest, before a push, may be anything up to that. Three
numbers of each joint, and that one of each run, are fitted to what its encoder showed; the joint that moved farthest comes first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from proprio_ros.identification.locked_joints import Followed, arm_and_payload, joint_torque
from proprio_ros.records import FloatArray, Run
from proprio_ros.robot import Robot
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
STEP = 1e-3  # rad, rad/s, rad/s^2: torques are linear in what a joint gives way by
Forced = tuple[JointRun, Mapping[str, float], FloatArray, FloatArray]
"""What moves a held joint, its law as far as it is known, and times [s] and what its encoder showed [rad], before the push, too."""


def give_way(
    robot: Robot,
    runs: Sequence[Run],
    driven: Sequence[Followed],
    facts: PayloadFacts,
    carried_kg: Sequence[float],
) -> list[dict[str, Followed]]:
    """How held joints move in each run, by joint, while another moves as a fit has it, at even instants from 0 on.

    Only joints with drive trains and an encoder do; ``facts``: where what is carried sits.
    """
    found: list[dict[str, Followed]] = [{} for _ in runs]
    turning = [name for name in robot.drive_trains if robot.model.joint(name).kind != "prismatic"]
    travels = {
        name: [float(np.ptp(run.held_position.get(name, [0.0]))) for run in runs]
        for name in turning
    }
    for name in sorted(travels, key=lambda name: -max(travels[name])) * SWEEPS:
        forced: dict[int, Forced] = {}
        for row, run in enumerate(runs):
            moving = {run.joint: driven[row], **found[row]}
            if travels[name][row] > 0.0 and (
                push := forced_on(robot, run, name, moving, facts, carried_kg[row])
            ):
                forced[row] = push
        if forced:
            servo = Servo([*forced.values()], robot.drive_trains[name].reading_std)
            for row, motion in zip(forced, servo.motions(), strict=True):
                found[row][name] = motion
    return found


def forced_on(
    robot: Robot,
    run: Run,
    name: str,
    moving: Mapping[str, Followed],
    facts: PayloadFacts,
    carried_kg: float,
) -> Forced | None:
    """What others that move do to a held joint; None where that is nothing."""
    moving = {each: motion for each, motion in moving.items() if each != name}
    model = robot.model.lock(
        [*moving, name],
        run.held,
        robot.gravity,
    )
    inertias = np.tensordot([1.0, carried_kg], arm_and_payload(robot, model, facts), axes=1)[None]
    times_s = next(iter(moving.values())).times_s
    drive = robot.drive_trains[name]

    def torque(
        times_s: FloatArray,
        more: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> FloatArray:
        """What the joint needs that stands where it is held, or is so much further, faster, and accelerated."""
        motion = []
        for each in model.joint_names:
            start, parts = (
                (run.held[name], more)
                if each == name
                else (moving[each].start, moving[each].at(times_s))
            )
            q, v, a = (np.zeros(len(times_s)) + part for part in parts)
            motion.append((start + q, v, a))
        return joint_torque(model, motion, model.joint_names.index(name), inertias)[:, 0]

    middle_s = times_s + 0.5 * times_s[1]
    none = np.zeros(len(times_s))
    load = torque(middle_s)
    still = float(torque(np.array([-1.0]))[0])
    # nor where a fit that failed says how the driven joint moved
    if not np.ptp([*load, still]) >= LEAST_TORQUE_N_M:
        return None
    spring, damper, inertia = (
        float(np.mean(torque(middle_s[::10], more) - load[::10])) / STEP
        for more in STEP * np.eye(3)
    )
    rubs = max(
        drive.coulomb.value + drive.load_friction.value * abs(still),
        LEAST_FRICTION_N_M,
    )
    known = {
        "inertia": inertia + drive.armature.value, "gravity_sin": spring, "viscous": damper + drive.viscous.value,
        "coulomb": rubs, "stribeck": drive.stribeck.value, "stribeck_velocity": drive.stribeck_velocity.value,
    }  # fmt: skip
    fine_s = float(np.clip(FRICTION_VELOCITY * known["inertia"] / rubs, 2e-5, times_s[1]))
    loads = np.stack([load - still, none], axis=1)
    one = JointRun(
        times_s, times_s, none, (0.0, 0.0, 1.0), FRICTION_VELOCITY, times_s[1], fine_s, loads
    )
    read_s = np.concatenate([run.before_times_s, run.times_s])
    return one, known, read_s[read_s <= times_s[-1]], run.held_position[name][read_s <= times_s[-1]]


class Servo:
    """A servo that holds its joint in R runs. Its 3 + R numbers, those of the runs last, are in units of their priors.

    ``sigma``: standard deviation of a reading [rad].
    """

    def __init__(self, forced: Sequence[Forced], sigma: float) -> None:
        self._simulator, self._sigma = JointSimulator([run for run, *_ in forced]), sigma
        self._known = np.array(
            [[known.get(name, 0.0) for name in INDEX] for _, known, *_ in forced]
        )
        self._read = [(read_s, shown) for *_, read_s, shown in forced]
        self._last: tuple[FloatArray, tuple[FloatArray, ...]] | None = None

    def _law(self, z: FloatArray) -> FloatArray:
        """The joint's parameters in each run, shape (R, P), analytic in the numbers."""
        stiffness, lag_s = np.exp(SERVO + SPREADS[:2] * z[:2])
        p = self._known.astype(z.dtype)
        friction = self._known[:, INDEX["coulomb"]] * np.exp(SPREADS[2] * z[2])
        p[:, INDEX["gravity_sin"]] += stiffness
        p[:, INDEX["viscous"]] += stiffness * lag_s
        p[:, INDEX["coulomb"]], p[:, INDEX["gravity_constant"]] = (
            friction,
            -friction * np.tanh(z[3:]),
        )
        return p

    def _shaken(self, z: FloatArray) -> tuple[FloatArray, ...]:
        """Positions less those at rest, velocities, shape (R, T), and what the numbers change of the positions, (R, T, 3 + R)."""
        if self._last is None or not np.array_equal(self._last[0], z):
            dp = np.stack(
                [self._law(z + 1e-30j * unit).imag / 1e-30 for unit in np.eye(len(z))], axis=2
            )
            found = self._simulator.jacobian(
                np.arange(len(dp), dtype=np.int32),
                self._law(z),
                dp,
            )
            self._last = z.copy(), tuple(each.copy() for each in found)
        return self._last[1]

    def _seen(self, row: int, q: FloatArray) -> FloatArray:
        """What of positions (T, ...) the encoder read, shape (N, ...)."""
        times_s = self._simulator.runs[row].sample_times_s
        columns = [
            np.interp(self._read[row][0], times_s, each[: len(times_s)])
            for each in q.reshape(len(q), -1).T
        ]
        return np.stack(columns, axis=1).reshape(
            -1,
            *q.shape[1:],
        )

    def residual(self, z: FloatArray) -> FloatArray:
        """Of all readings, then of the priors, in standard deviations. Where a joint rests, the readings' mean says."""
        off = [
            self._seen(row, q) - shown
            for row, (q, (_, shown)) in enumerate(zip(self._shaken(z)[0], self._read, strict=True))
        ]
        return np.concatenate([*((each - each.mean()) / self._sigma for each in off), z])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """The residual's derivative."""
        seen = [self._seen(row, slopes) for row, slopes in enumerate(self._shaken(z)[2])]
        return np.concatenate(
            [*((each - each.mean(axis=0)) / self._sigma for each in seen), np.eye(len(z))]
        )

    def motions(self) -> list[Followed]:
        """How the joint moved in each run, by the numbers that follow the readings best."""
        start = np.zeros(3 + len(self._known))
        best = least_squares(
            self.residual, start, self.jacobian, method="lm", xtol=1e-3, ftol=1e-3
        ).x
        found = []
        for row, (run, q, v) in enumerate(
            zip(self._simulator.runs, *self._shaken(best)[:2], strict=True)
        ):
            count = len(run.sample_times_s)
            rest = float(np.mean(self._read[row][1] - self._seen(row, q)))
            found.append(
                Followed(
                    run.sample_times_s,
                    rest + q[:count],
                    v[:count],
                )
            )
        return found
