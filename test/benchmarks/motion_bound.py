"""The smallest interval that any method could give what a random arm holds: the Cramer-Rao bound of `motions.py`.

Independent of the package: it takes the simulator's own laws and true motions, not the package's regressor, windows or weights. At
each sample and joint the current says the motor's torque

    tau = T + viscous v,    T (1 - gears s sgn T) = x + coulomb warm (1 + place sin 2 q) s,    s = tanh(v / 0.01)

where x is what bodies and rotors need, linear in ten parameters of each (Newton's and Euler's equations). It is read as
``y = tau / (1 + delta) + noise``, delta being the torque constant's error. Unknown are the payload's ten parameters, the links'
masses, centres and inertias, and of each joint rotor, gears, viscous friction, its dependence on place, delta, and Coulomb
friction in either motion. With the slopes A of y by all of them at the truth, the current's noise sigma, and the precision P of the
priors, the information is ``sum A^T A / sigma^2 + P``, and no method has a smaller mean squared error of the mass than its inverse
says (van Trees 1968, Detection, Estimation, and Modulation Theory I, sec. 2.4).

Priors: friction, rotors and torque constants as the robot file has them; links, and friction that differs from motion to motion
and from place to place, as the simulator draws them; the payload within a tenth of the arm's reach, as the package takes it.

The bound is rather too small than too large: stamps count as on their grid, the shape of the friction's law as known, and
positions as exact. Their noise, propagated as that of accelerations, would raise the bound by 0.1 to 0.3 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solveh_banded
from support.arm_in_motion import RATE_HZ, Truth, Twin

GRAVITY = np.array([0.0, 0.0, -9.81])
WITHIN = 0.1
"""Of the arm's reach: one standard deviation of where the payload is, as `motion_prior.HELD_WITHIN` has it."""
POSITION_NOISE_RAD = 1e-4
JOINT_KINDS = ("armature", "gears", "viscous", "place", "delta")


def _numbers(words: str) -> np.ndarray:
    return np.array([float(word) for word in words.split()])


def _cross(v: np.ndarray) -> np.ndarray:
    result = np.zeros((*v.shape[:-1], 3, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return result - np.swapaxes(result, -1, -2)


def _times_inertia(v: np.ndarray) -> np.ndarray:
    """I v per unit of Ixx, Ixy, Ixz, Iyy, Iyz, Izz, shape (T, 3, 6)."""
    result = np.zeros((len(v), 3, 6))
    for column, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        result[:, i, column] = v[:, j]
        result[:, j, column] = v[:, i]
    return result


def _wrench(
    turn: np.ndarray,
    spin: np.ndarray,
    spin_rate: np.ndarray,
    fall: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment about a body's origin, in the world, per unit of its ten parameters, (T, 3, 10) each.

    Args:
        turn: From the body's frame to the world's, (T, 3, 3).
        spin: Its angular velocity [rad/s], (T, 3).
        spin_rate: Its angular acceleration [rad/s2], (T, 3).
        fall: Acceleration of its origin, less gravity [m/s2], (T, 3).
    """
    back = np.swapaxes(turn, 1, 2)
    w, dw, a = ((back @ v[..., None])[..., 0] for v in (spin, spin_rate, fall))
    force = np.zeros((len(turn), 3, 10))
    moment = np.zeros((len(turn), 3, 10))
    force[:, :, 0] = a
    force[:, :, 1:4] = _cross(dw) + _cross(w) @ _cross(w)
    moment[:, :, 1:4] = -_cross(a)
    moment[:, :, 4:] = _times_inertia(dw) + _cross(w) @ _times_inertia(w)
    return turn @ force, turn @ moment


@dataclass(frozen=True)
class Frame:
    """A frame that is fixed to a body, at T times.

    Attributes:
        turn: From it to the world, (T, 3, 3).
        spin: Angular velocity [rad/s], (T, 3).
        spin_rate: Angular acceleration [rad/s2], (T, 3).
        origin: [m], (T, 3).
        fall: Acceleration of the origin, less gravity [m/s2], (T, 3).
    """

    turn: np.ndarray
    spin: np.ndarray
    spin_rate: np.ndarray
    origin: np.ndarray
    fall: np.ndarray

    @classmethod
    def of_base(cls, count: int, gravity: np.ndarray) -> Frame:
        """At rest, so many times."""
        none = np.zeros((count, 3))
        turn = np.broadcast_to(np.eye(3), (count, 3, 3))
        return cls(turn, none, none, none, none - gravity)

    def moved_by(self, place: np.ndarray) -> Frame:
        """Fixed to the same body, with the origin at a place in this frame [m], (3,)."""
        arm_of = self.turn @ place
        swung = np.cross(self.spin_rate, arm_of)
        drawn_in = np.cross(self.spin, np.cross(self.spin, arm_of))
        return replace(self, origin=self.origin + arm_of, fall=self.fall + swung + drawn_in)

    def turned_by(
        self,
        direction: np.ndarray,
        angle: np.ndarray,
        speed: np.ndarray,
        acceleration: np.ndarray,
    ) -> Frame:
        """Of the body behind a hinge in the origin.

        Args:
            direction: Of its axis in this frame, (3,).
            angle: [rad], (T,).
            speed: [rad/s], (T,).
            acceleration: [rad/s2], (T,).
        """
        axis = self.turn @ direction
        cross = _cross(direction)
        q = angle[:, None, None]
        turn = np.eye(3) + np.sin(q) * cross + (1.0 - np.cos(q)) * cross @ cross
        rate = axis * speed[:, None]
        spin_rate = self.spin_rate + axis * acceleration[:, None] + np.cross(self.spin, rate)
        return replace(self, turn=self.turn @ turn, spin=self.spin + rate, spin_rate=spin_rate)


def torque_of_bodies(
    arm: Twin,
    position: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    gravity: np.ndarray = GRAVITY,
) -> np.ndarray:
    """Torque at every joint per unit of the ten parameters of the payload and of every link, shape (T, n, 10 (1 + n)).

    Parameters of a body: mass, first moments, inertia about its frame's origin (xx, xy, xz, yy, yz, zz).
    """
    count, joints = position.shape
    frame = Frame.of_base(count, gravity)
    axes = []
    origins = []
    result = np.zeros((count, joints, 10 * (1 + joints)))
    for body in range(joints + 1):
        if body < joints:
            frame = frame.moved_by(_numbers(arm.build.origins[body]))
            direction = _numbers(arm.build.axes[body])
            axes.append(frame.turn @ direction)
            origins.append(frame.origin)
            frame = frame.turned_by(
                direction, position[:, body], velocity[:, body], acceleration[:, body]
            )
        else:
            frame = frame.moved_by(_numbers(arm.build.grip))
        force, moment = _wrench(frame.turn, frame.spin, frame.spin_rate, frame.fall)
        at = 10 * (body + 1) if body < joints else 0
        for joint in range(len(axes)):
            about = moment + _cross(frame.origin - origins[joint]) @ force
            result[:, joint, at : at + 10] = (axes[joint][:, None] @ about)[:, 0]
    return result


def parameters(
    mass: float,
    centre: np.ndarray,
    inertia: np.ndarray,
) -> np.ndarray:
    """The ten parameters of a body whose inertia about its centre is diagonal, shape (3,)."""
    about = np.diag(inertia) + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], mass * centre, about[np.triu_indices(3)]])


@dataclass
class Model:
    """What the sensors read of some motions as a function of all unknowns.

    The unknowns are the payload's ten parameters; of each link the share by which its mass is off, its centre's shift [m] and the
    share by which its inertia is off; of each joint `JOINT_KINDS`; and Coulomb friction [N m] of each joint in each motion.

    Attributes:
        arm: Its truth.
        motions: Truth of each motion, and whether it was with the payload.
        payload: Its true parameters, shape (10,).
    """

    arm: Twin
    motions: Sequence[tuple[Truth, bool]]
    payload: np.ndarray

    def __post_init__(self) -> None:
        arm = self.arm
        joints = len(self.arm.build.axes)
        self.joints = joints
        self.regressors = [
            torque_of_bodies(arm, motion.position, motion.velocity, motion.acceleration)
            for motion, _ in self.motions
        ]
        self.truth = np.concatenate(
            [
                self.payload,
                np.zeros(5 * joints),
                arm.armature, arm.gears, arm.viscous, arm.place, arm.torque - 1.0,
                *(arm.coulomb * motion.warm for motion, _ in self.motions),
            ]
        )  # fmt: skip

    def bodies(self, unknowns: np.ndarray) -> np.ndarray:
        """Parameters of payload and links, shape (10 (1 + n),)."""
        arm = self.arm
        off = unknowns[10 : 10 + 5 * self.joints].reshape(
            self.joints,
            5,
        )
        links = [
            parameters(
                arm.masses[n] * (1.0 + o[0]), arm.coms[n] + o[1:4], arm.inertias[n] * (1.0 + o[4])
            )
            for n, o in enumerate(off)
        ]
        return np.concatenate([unknowns[:10], *links])

    def _by_joint(
        self,
        unknowns: np.ndarray,
    ) -> dict[str, np.ndarray]:
        rest = unknowns[10 + 5 * self.joints :].reshape(
            -1,
            self.joints,
        )
        return {
            **dict(zip(JOINT_KINDS, rest, strict=False)),
            "coulomb": rest[len(JOINT_KINDS) :],
        }

    def _motors(
        self,
        unknowns: np.ndarray,
    ) -> Iterator[tuple[np.ndarray, ...]]:
        """Of each motion: torque that passes the gears, by how much it follows what bodies need, and slip."""
        of = self._by_joint(unknowns)
        bodies = self.bodies(unknowns)
        for number, (motion, loaded) in enumerate(self.motions):
            held = bodies.copy()
            held[:10] *= loaded
            slip = np.tanh(motion.velocity / 0.01)
            coulomb = of["coulomb"][number] * (1.0 + of["place"] * self.arm.wave(motion.position))
            needed = (
                self.regressors[number] @ held
                + of["armature"] * motion.acceleration
                + coulomb * slip
            )
            gain = 1.0 / (1.0 - of["gears"] * slip * np.sign(needed))
            yield gain * needed, gain, slip

    def read(
        self,
        unknowns: np.ndarray,
    ) -> list[np.ndarray]:
        """Torque that each motion's currents say without noise [N m], each of shape (T, n)."""
        of = self._by_joint(unknowns)
        return [
            (passed + of["viscous"] * motion.velocity) / (1.0 + of["delta"])
            for (motion, _), (passed, _, _) in zip(
                self.motions, self._motors(unknowns), strict=True
            )
        ]

    def slopes(self) -> list[np.ndarray]:
        """Of `read` by every unknown at the truth, each of shape (T n, U)."""
        by_bodies = self._by_bodies()
        motors = zip(self._motors(self.truth), self.read(self.truth), strict=True)
        return [
            self._slopes_of(number, *passed, read, by_bodies)
            for number, (passed, read) in enumerate(motors)
        ]

    def _by_bodies(self) -> np.ndarray:
        """Parameters of payload and links by the first unknowns, those of `bodies`, shape (10 (1 + n), 10 + 5 n)."""
        step = 1e-6
        start = 10 + 5 * self.joints
        steps = step * np.eye(len(self.truth))[:start]
        changes = [self.bodies(self.truth + d) - self.bodies(self.truth - d) for d in steps]
        result: np.ndarray = np.array(changes).T / (2.0 * step)
        return result

    def _slopes_of(
        self,
        number: int,
        passed: np.ndarray,
        gain: np.ndarray,
        slip: np.ndarray,
        read: np.ndarray,
        by_bodies: np.ndarray,
    ) -> np.ndarray:
        """Of what is read of one motion by every unknown at the truth, shape (T n, U).

        Args:
            number: Of the motion.
            passed, gain, slip: As `_motors` has them, (T, n).
            read: As `read` has it, (T, n).
            by_bodies: As `_by_bodies` has them.
        """
        motion, loaded = self.motions[number]
        joints = self.joints
        of = self._by_joint(self.truth)
        wave = self.arm.wave(motion.position)
        start = by_bodies.shape[1]
        rows = np.zeros((len(wave), joints, len(self.truth)))
        rows[:, :, :start] = gain[..., None] * (self.regressors[number] @ by_bodies)
        rows[:, :, :10] *= loaded
        columns = {
            "armature": gain * motion.acceleration,
            "gears": gain * np.abs(passed) * slip,
            "viscous": motion.velocity,
            "place": gain * slip * of["coulomb"][number] * wave,
            "delta": -read,
        }
        own = [
            *(columns[kind] for kind in JOINT_KINDS),
            *(np.zeros_like(wave) for _ in self.motions),
        ]
        own[len(JOINT_KINDS) + number] = gain * slip * (1.0 + of["place"] * wave)
        for kind, column in enumerate(own):
            for joint in range(joints):
                rows[:, joint, start + kind * joints + joint] = column[:, joint]
        rows /= (1.0 + of["delta"])[:, None]
        return rows.reshape(-1, len(self.truth))

    def prior_precision(
        self,
        payload_std: np.ndarray,
        torque_std: float = 0.01,
    ) -> np.ndarray:
        """Inverse covariance of the unknowns before any motion, shape (U, U)."""
        joints = self.joints
        build = self.arm.build
        links = np.tile(
            [build.link_share, *[build.shift_m] * 3, 0.1],
            joints,
        )
        # load friction, rotor and viscous friction as `write_robot` states them, place as `Twin` draws it
        by_joint = {
            "armature": 0.2,
            "gears": 0.05,
            "viscous": 2.0,
            "place": 0.2 / np.sqrt(12.0),
            "delta": torque_std,
        }
        each = [np.full(joints, by_joint[kind]) for kind in JOINT_KINDS]
        start = 10 + 5 * joints + len(JOINT_KINDS) * joints
        precision = np.zeros((len(self.truth), len(self.truth)))
        precision[range(start), range(start)] = np.concatenate([payload_std, links, *each]) ** -2.0
        count = len(self.motions)
        for joint in range(joints):
            at = start + joint + joints * np.arange(count)
            # one Coulomb friction of the arm, 2 N m, and 5 % of it from motion to motion
            own = np.eye(count) * (0.05 * self.arm.coulomb[joint]) ** 2
            precision[np.ix_(at, at)] = np.linalg.inv(2.0**2 + own)
        return precision

    @property
    def noise(self) -> np.ndarray:
        """Standard deviation of the torque that the currents say [N m], shape (n,)."""
        return self.arm.build.current_noise_A * np.array(self.arm.build.constants)

    def _with_positions(
        self,
        number: int,
        rows: np.ndarray,
    ) -> np.ndarray:
        """The slopes over the covariance of the noise where positions are noisy, too, shape (T n, U).

        An acceleration from positions is their second difference, and its noise a torque by the joints' inertia matrix.
        """
        motion = self.motions[number][0]
        joints = self.joints
        count = len(motion.position)
        period_s = 1.0 / RATE_HZ
        inertia = np.zeros((count, joints, joints))
        held = self.bodies(self.truth)
        held[:10] *= self.motions[number][1]
        still = np.zeros_like(motion.position)
        for joint in range(joints):
            unit = still + np.eye(joints)[joint]
            inertia[:, :, joint] = (
                torque_of_bodies(self.arm, motion.position, still, unit, 0.0 * GRAVITY) @ held
            )
        inertia += np.diag(self.arm.armature)
        band = np.zeros((3 * joints, count * joints))
        for lag, share in enumerate((6.0, -4.0, 1.0)):
            block = (
                POSITION_NOISE_RAD**2
                / period_s**4
                * share
                * inertia[lag:]
                @ np.swapaxes(inertia[: count - lag], 1, 2)
            )
            for i in range(joints):
                for j in range(joints):
                    if (below := lag * joints + i - j) >= 0:
                        band[below, j : (count - lag) * joints : joints] += block[:, i, j]
        band[0] += np.tile(self.noise**2, count)
        result: np.ndarray = solveh_banded(band, rows, lower=True)
        return result

    def covariance(
        self,
        positions: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of the unknowns after all motions, whose square roots are the bounds, and the priors' precision, both (U, U).

        Args:
            positions: Their noise counts, too.
        """
        information = np.zeros((len(self.truth), len(self.truth)))
        for number, rows in enumerate(self.slopes()):
            white = np.tile(self.noise**-2.0, len(rows) // self.joints)[:, None] * rows
            information += rows.T @ (self._with_positions(number, rows) if positions else white)
        build = self.arm.build
        length_m = WITHIN * sum(
            np.linalg.norm(_numbers(words)) for words in (*build.origins[1:], build.grip)
        )
        size = np.array([*[length_m] * 3, *[length_m**2] * 6])
        heavy_kg = self.payload[0]
        for _ in range(5):
            # something light has little first moment and inertia, wherever in the hand it sits
            std = np.array([sum(build.masses_kg), *np.maximum(heavy_kg, 1e-6) * size])
            precision = self.prior_precision(std)
            total = information + precision
            scale = 1.0 / np.sqrt(np.diag(total))
            covariance = np.linalg.inv(total * scale[:, None] * scale) * scale[:, None] * scale
            heavy_kg = self.payload[0] + np.sqrt(covariance[0, 0])
        return covariance, precision


def bound(
    arm: Twin,
    without: Truth,
    loaded: Truth,
    mass: float,
    centre: np.ndarray,
    positions: bool = False,
    more: Sequence[Truth] = (),
) -> float:
    """Smallest standard deviation of the mass [kg] that motions of an arm allow, one with a ball in the hand, the others empty."""
    ball = parameters(
        mass,
        centre,
        np.full(3, 0.4 * mass * 0.05**2),
    )
    motions = [
        (loaded, True),
        *((motion, False) for motion in (without, *more)),
    ]
    covariance, _ = Model(arm, motions, ball).covariance(positions)
    return float(np.sqrt(covariance[0, 0]))
