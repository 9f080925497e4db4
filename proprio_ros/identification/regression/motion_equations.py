"""What motions say in equations: a row for each window and moving joint, a column for each parameter of payload, arm and friction.

In weak form (`weak_form`): over windows of half a second the mean torque of a motor is that of the arm's bodies, of the rotors, of
friction and of the payload. Offline rows come from a whole motion, online from one window at a time (`running`).
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from proprio_ros.calibration_files.motions import ARM_TERMS, FRICTION_TERMS, TERMS
from proprio_ros.errors import RobotError, TooLittleMotion
from proprio_ros.identification.regression.arm_terms import ArmTerms
from proprio_ros.identification.regression.long_motions import counted_share, kept_windows
from proprio_ros.identification.regression.rigid_body import pseudo_inertia
from proprio_ros.identification.regression.weak_form import (
    Windows,
    across_gaps,
    evenly,
    torque_regressor,
)
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.robot.regressor import PARAMETERS, body_parameters, point_mass

WINDOW_S = 0.5
"""Long enough to average over what encoders and current sensors add, short enough to tell one attitude from the next."""
HOP_SHARE = 0.25
BANDWIDTH_HZ = 6.0
"""Positions are smoothed to this before their velocity is taken: arms follow nothing faster with weight on them."""
SLOW_RAD_S = 0.02
"""Dry friction is smoothed over this; a joint that is slower for most of a window rests on friction, which then does not count."""
STRETCH_S = 2.5
"""Neighbouring windows share an error; stretches so long do not: longer than what friction and controllers keep in memory."""
MIN_STRETCHES = 4
# Of a difference quotient: a torque is nearly linear over it, and its digits are not lost.
ZERO_STEP_RAD = 1e-3
CARRIER_MOVED = 0.004
"""A torso that moves less stands still: three counts of a coarse encoder, and less than 1 % of gravity's torque [rad or m]."""
LEAST_WINDOWS = round(STRETCH_S / (WINDOW_S * HOP_SHARE))
"""A joint that moves in fewer windows of all motions, less than one stretch, leaves no residual that could weigh it."""
RUNS_OF_ITS_OWN = 10_000  # stretches that one run has at most: labels of the next run's start there
_made: ContextVar[dict[bytes, Rows] | None] = ContextVar("made", default=None)


@dataclass(frozen=True)
class Samples:
    """What an arm of n joints did at T equally spaced instants, and the windows over them."""

    windows: Windows
    times_s: FloatArray  # shape (T,)
    period_s: float  # between two of them
    position: FloatArray  # [rad], shape (T, n)
    velocity: FloatArray  # [rad/s], shape (T, n)
    torque: FloatArray  # of the motors [N m], shape (T, n)
    # of what carries the arm and moves, too: positions and velocities in SI units, shape (2, T, c); None: nothing does
    carriers: FloatArray | None = None

    def only(self, kept: NDArray[np.bool_]) -> Samples:
        """Some of its windows, shape (W,), and of its samples those that lie in one."""
        if kept.all():
            return self
        windows, samples = self.windows.only(kept)
        carriers = self.carriers
        return Samples(
            windows,
            self.times_s[samples],
            self.period_s,
            self.position[samples],
            self.velocity[samples],
            self.torque[samples],
            None if carriers is None else carriers[:, samples],
        )

    @property
    def slow(self) -> NDArray[np.bool_]:
        """Whether a joint stands for most of a window, shape (W, n)."""
        return self.windows.share(np.abs(self.velocity) < SLOW_RAD_S) > 0.5


@dataclass(frozen=True)
class Arm:
    """An arm whose other joints are locked, and the frame in which a payload counts."""

    model: ReducedModel  # its n joints
    body: int  # number of the body that carries the payload
    # that body's parameters per unit of the payload's in the payload's frame, shape (10, 10)
    from_payload: FloatArray
    reach_m: float  # from the base to the hand along the links
    # its joints behind those that carry it and move meanwhile, c of them; the model itself where none does
    carried: ReducedModel

    @classmethod
    def of(
        cls,
        robot: Robot,
        joints: Sequence[str],
        locked: dict[str, float],
        carriers: Sequence[str] = (),
    ) -> Arm:
        """The arm with its other joints locked.

        Args:
            robot: Its geometry.
            joints: That move.
            locked: Positions of the others [rad or m].
            carriers: Those of the others that carry it and do move: their efforts count for nothing.

        Raises `RobotError`: No joint moves the hand.
        """
        model = robot.model.lock(list(joints), locked, robot.gravity)
        body, body_from_payload = model.frames[robot.payload_frame]
        if body < 0:
            raise RobotError(f"{robot.payload_frame} does not move with any joint of {robot.name}")
        from_payload = []
        for unit in np.eye(PARAMETERS):
            turned = body_from_payload @ pseudo_inertia(unit) @ body_from_payload.T
            from_payload.append(body_parameters(turned))
        links = sum(np.linalg.norm(place[:3, 3]) for place in model.placement)
        reach_m = float(links + np.linalg.norm(body_from_payload[:3, 3]))
        carried = model
        if carriers:
            carried = robot.model.lock([*carriers, *joints], locked, robot.gravity)
        return cls(model, body, np.column_stack(from_payload), reach_m, carried)

    @property
    def carriers(self) -> tuple[str, ...]:
        """What carries it and moves, too."""
        return self.carried.joint_names[: -self.count]

    @property
    def count(self) -> int:
        """Of joints, n."""
        return len(self.model.joint_names)

    @property
    def kg(self) -> float:
        """Mass of all that moves."""
        return float(self.model.pseudo_inertia[:, 3, 3].sum())

    @property
    def bodies(self) -> list[FloatArray]:
        """Parameters of each body as the URDF has them, n of shape (10,)."""
        return [body_parameters(pseudo) for pseudo in self.model.pseudo_inertia]

    @property
    def lengths_m(self) -> list[float]:
        """Size of each body, length n: to the next joint, a tenth of the reach at least."""
        steps = [place[:3, 3] for place in self.model.placement[1:]]
        along = [float(np.linalg.norm(step)) for step in steps]
        return [max(0.1 * self.reach_m, length) for length in (*along, 0.0)]

    def rows(
        self,
        samples: Samples,
        counts: NDArray[np.bool_] | bool = True,
        by_zeros: bool = False,
    ) -> Rows:
        """The rows of windows in which a joint moves.

        Args:
            samples: Of its joints, with W windows over them.
            counts: Which rows are wanted, broadcast to shape (W, n).
            by_zeros: Whether the rows know how they follow the joints' zeros, and the pace of the clock.
        """
        windows = samples.windows
        window, joint = np.nonzero(counts & ~samples.slow)  # (E,)
        regressor = self._torques(samples, window, joint)
        direction = windows.mean(np.tanh(samples.velocity / SLOW_RAD_S))[window, joint]
        zero = np.zeros((len(joint), 0, PARAMETERS * (1 + self.count)))
        of_gravity = regressor
        if by_zeros:
            zero = self._by_zeros(samples, window, joint, regressor)
            still = replace(
                samples,
                velocity=np.zeros_like(samples.velocity),
                carriers=None
                if samples.carriers is None
                else samples.carriers * np.array([1.0, 0.0])[:, None, None],
            )
            of_gravity = self._torques(still, window, joint)
        return Rows(
            start_s=samples.times_s[windows.starts[window]],
            joint=joint,
            design=self._design(samples, window, joint, regressor),
            payload=regressor[:, self.body] @ self.from_payload,
            direction=direction,
            torque=windows.mean(samples.torque)[window, joint],
            zero=zero,
            inertial=self._payload_and_bodies(regressor - of_gravity),
            torque_rate=windows.derivative(samples.torque, samples.period_s)[window, joint],
        )

    def _torques(
        self,
        samples: Samples,
        window: NDArray[np.int64],
        joint: NDArray[np.int64],
        since: int = 0,
    ) -> FloatArray:
        """Mean torque of E windows and joints per unit of the bodies' parameters, from one body on, shape (E, n, 10)."""
        if not len(joint):
            return np.zeros((0, self.count, PARAMETERS))
        position = samples.position
        velocity = samples.velocity
        before = len(self.carriers)
        if samples.carriers is not None:
            position = np.hstack([samples.carriers[0], position])
            velocity = np.hstack([samples.carriers[1], velocity])
        of_all = torque_regressor(
            self.carried,
            position,
            velocity,
            samples.windows,
            samples.period_s,
            before + since,
        )
        return of_all[:, before:, before:][window, joint]

    def _by_zeros(
        self,
        samples: Samples,
        window: NDArray[np.int64],
        joint: NDArray[np.int64],
        regressor: FloatArray,
    ) -> FloatArray:
        """By how much the columns change per radian of each joint's zero, as difference quotients, shape (E, n, 10 + 10 n)."""
        slopes = np.empty((len(joint), self.count, PARAMETERS * (1 + self.count)))
        for turned, shift in enumerate(ZERO_STEP_RAD * np.eye(self.count)):
            # a joint turns the bodies behind it, which have larger numbers
            moved = replace(samples, position=samples.position + shift)
            rise = self._torques(moved, window, joint, turned)
            rise[:, turned:] -= regressor[:, turned:]
            slopes[:, turned] = self._payload_and_bodies(rise / ZERO_STEP_RAD)
        return slopes

    def _design(
        self,
        samples: Samples,
        window: NDArray[np.int64],
        joint: NDArray[np.int64],
        regressor: FloatArray,
    ) -> FloatArray:
        """Mean torque per unit of the arm's terms, see `Rows.design`."""
        windows = samples.windows
        position = samples.position
        own = np.eye(self.count)[joint]
        moving = np.tanh(samples.velocity / SLOW_RAD_S)
        waves = []
        for angle in (position, 2.0 * position):
            waves += [np.sin(angle), np.cos(angle)]
        of_rotors = windows.derivative(samples.velocity, samples.period_s)
        of_joints = [
            *(windows.mean(moving * wave) for wave in waves),
            windows.mean(samples.velocity),
            windows.mean(moving),
        ]
        unfilled = 0.0 * own  # load friction and shares of the torque go with the solution
        return np.hstack(
            [
                regressor.reshape(len(joint), self.count * PARAMETERS),
                own * of_rotors[window, joint, None],
                unfilled,
                unfilled,
                *(own * column[window, joint, None] for column in of_joints),
                own,
            ]
        )

    def _payload_and_bodies(self, regressor: FloatArray) -> FloatArray:
        """Torque per unit of the payload's parameters and the bodies' in turn, shape (E, 10 + 10 n)."""
        bodies = regressor.reshape(len(regressor), self.count * PARAMETERS)
        return np.hstack([regressor[:, self.body] @ self.from_payload, bodies])


@contextlib.contextmanager
def once_each() -> Iterator[None]:
    """While this lasts, `equations` of a motion are made once: a weighing asks for the same ones four or five times."""
    made = _made.get()
    token = _made.set({} if made is None else made)
    try:
        yield
    finally:
        _made.reset(token)


def _of_motion(
    arm: Arm,
    motion: Motion,
    constants: FloatArray,
    by_zeros: bool,
) -> Rows:
    """The rows of one motion by motors of these torque constants [N m/A], shape (n,)."""
    names = arm.model.joint_names
    before = len(arm.carriers)
    times_s, position, current = evenly(motion, arm.carried.joint_names, BANDWIDTH_HZ)
    period_s = float(times_s[1] - times_s[0])
    velocity = np.gradient(position, period_s, axis=0)
    carriers = np.stack([position[:, :before], velocity[:, :before]]) if before else None
    width = round(WINDOW_S / period_s)
    windows = Windows.over(
        len(times_s),
        width,
        max(1, round(HOP_SHARE * width)),
    )
    gaps = across_gaps(motion, names, times_s, windows)
    counts = np.isin(names, motion.moved)[None, :] & ~gaps
    samples = Samples(
        windows,
        times_s,
        period_s,
        position[:, before:],
        velocity[:, before:],
        current[:, before:] * constants,
        carriers,
    )
    kept = kept_windows(counts & ~samples.slow, stretches_at(times_s[windows.starts]))
    return arm.rows(samples.only(kept), counts[kept], by_zeros=by_zeros)


def _made_once(
    arm: Arm,
    motion: Motion,
    constants: FloatArray,
    by_zeros: bool,
) -> Rows:
    """The same rows, or those that were made before of the same numbers."""
    made = _made.get()
    if made is None:
        return _of_motion(arm, motion, constants, by_zeros)
    model = arm.model
    of_arm = (
        model.joint_names,
        model.parents,
        model.placement,
        model.axes,
        model.gravity,
        arm.body,
        arm.from_payload,
        constants,
    )
    of_motion = (motion.joints, motion.moved, motion.times_s, motion.position, motion.current_A)
    of_carriers = [(name, motion.beside[name]) for name in arm.carriers]
    key = _digest((by_zeros, of_arm, of_motion, of_carriers))
    if key not in made:
        made[key] = _of_motion(arm, motion, constants, by_zeros)
    return made[key]


def _digest(numbers: object) -> bytes:
    """Of numbers that need not be written down once more to be compared."""
    arrays: list[pickle.PickleBuffer] = []
    words = pickle.dumps(numbers, protocol=5, buffer_callback=arrays.append)
    digest = hashlib.sha256(words)
    for array in arrays:
        digest.update(array.raw())
    return digest.digest()


def own_terms(count: int) -> int:
    """What each motion has of its own.

    Friction, offset, scale and zero of each of ``count`` joints, a scale in common, and its clock: pace and lag.
    """
    return 5 * count + 3


def sizes(mass_kg: float, length_m: float) -> list[float]:
    """Standard deviations of a body's parameters from those of its mass, and its size."""
    return [
        mass_kg,
        *[mass_kg * length_m] * 3,
        *[mass_kg * length_m**2] * 6,
    ]


@dataclass(frozen=True)
class Rows:
    """Linear equations of one motion: E rows, of a window and a joint each."""

    start_s: FloatArray  # when the window begins, shape (E,)
    joint: NDArray[np.int64]  # number of the joint, shape (E,)
    # mean torque per unit of the arm's terms in the order of `term_keys`; load friction and shares of the torque are
    # zero, since they go with the solution; shape (E, 20 n)
    design: FloatArray
    payload: FloatArray  # per unit of the payload's parameters, in its frame, shape (E, 10)
    direction: FloatArray  # mean of the joint's direction of motion, -1 to 1, shape (E,)
    torque: FloatArray  # mean motor torque [N m], shape (E,)
    # by how much the columns of the payload's parameters and the bodies' change per radian of each joint's zero, shape
    # (E, n, 10 + 10 n); of no joint where nobody asked
    zero: FloatArray
    # what of the columns of the payload's parameters and the bodies' is not gravity's: it goes with the square of the clock's
    # pace, shape (E, 10 + 10 n); zero where nobody asked
    inertial: FloatArray
    torque_rate: FloatArray  # mean of the motor torque's time derivative [N m/s], shape (E,)

    @classmethod
    def together(cls, parts: Sequence[Rows]) -> Rows:
        """Of several motions or windows, one after the other."""
        if len(parts) == 1:
            return parts[0]
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def only(self, kept: NDArray[np.bool_]) -> Rows:
        """Some of them, by a truth value for each, shape (E,)."""
        if kept.all():
            return self
        return Rows(*(getattr(self, field.name)[kept] for field in fields(self)))

    def with_mass_at(self, centre_m: FloatArray) -> Rows:
        """With the payload's mass at a point of its frame [m], shape (3,), from which its other parameters say how it differs."""
        point = point_mass(centre_m)
        payload = self.payload.copy()
        zero = self.zero.copy()
        inertial = self.inertial.copy()
        payload[:, 0] = self.payload @ point
        zero[:, :, 0] = self.zero[:, :, :PARAMETERS] @ point
        inertial[:, 0] = self.inertial[:, :PARAMETERS] @ point
        return replace(
            self,
            payload=payload,
            zero=zero,
            inertial=inertial,
        )

    @property
    def stretch(self) -> NDArray[np.int64]:
        """Number of the stretch that the window's middle lies in, shape (E,)."""
        return stretches_at(self.start_s)


def stretches_at(start_s: FloatArray) -> NDArray[np.int64]:
    """Numbers of the stretches in which windows have their middles that start at these times [s]."""
    middle_s = start_s + 0.5 * WINDOW_S
    stretches: NDArray[np.int64] = (middle_s / STRETCH_S).astype(np.int64)
    return stretches


def weighable(parts: Sequence[Rows]) -> list[Rows]:
    """The rows without those of joints that have fewer than `LEAST_WINDOWS` in all parts together.

    As many unknowns as rows explain whatever was read: nothing is left over, and such a joint would outweigh all others.
    """
    together = np.concatenate([part.joint for part in parts])
    if not len(together):
        return list(parts)
    enough = np.bincount(together) >= LEAST_WINDOWS
    return [part.only(enough[part.joint]) for part in parts]


def equations(
    robot: Robot,
    motion: Motion,
    joints: Sequence[str],
    centre_m: FloatArray | None = None,
    by_zeros: bool = True,
) -> Rows:
    """What one motion says.

    Args:
        robot: Its torque constants and geometry.
        motion: Of these joints.
        joints: Whose terms are the columns.
        centre_m: Where the payload's mass sits: its other parameters are then how it differs from a point there, shape (3,).
        by_zeros: Whether they know how they follow the joints' zeros and the clock's pace, which takes most of the time.

    Raises `RecordingError`: It is too short, or too fast for its rate.
    """
    arm = Arm.of(robot, joints, dict(motion.held), moving_carriers(robot, motion, joints))
    drives = [robot.drive_trains[name] for name in arm.model.joint_names]
    constants = np.array([drive.torque_constant.value for drive in drives])
    rows = _made_once(arm, motion, constants, by_zeros)
    if not len(rows.joint):
        raise TooLittleMotion(
            f"{motion.name}: no joint moves for long enough without a pause or a gap"
        )
    return rows if centre_m is None else rows.with_mass_at(centre_m)


def moving_carriers(
    robot: Robot,
    motion: Motion,
    joints: Sequence[str],
) -> tuple[str, ...]:
    """Joints that carry an arm and moved meanwhile, as those of a torso: their positions count, whoever drives them.

    Args:
        robot: Its geometry.
        motion: Of the arm.
        joints: Of the arm.
    """
    moved = (name for name in robot.model.carriers(joints) if name in motion.beside)
    return tuple(name for name in moved if np.ptp(motion.beside[name]) > CARRIER_MOVED)


def fill_drives(
    matrix: FloatArray,
    values: FloatArray,
    rows: Rows | Problem,
    terms: ArmTerms,
    beside: FloatArray | float = 0.0,
) -> None:
    """Fill the columns that go with a solution: gears lose a share of what they transmit, a motor is off by a share of its torque.

    Args:
        matrix: Of payload, where it has one, and of the arm's terms as in `Rows.design`; changed in place, shape (E, U).
        values: The solution, shape (U,).
        rows: Whose matrix it is.
        terms: Where the arm's terms stand in it.
        beside: Torque that the matrix has no column of [N m], shape (E,).
    """
    bodies = slice(0, terms.bodies.stop)  # the payload's before them, where there is one
    own = np.eye(terms.count)[rows.joint]
    transmitted = np.abs(matrix[:, bodies] @ values[bodies] + beside)
    matrix[:, terms.load_friction] = own * (transmitted * rows.direction)[:, None]
    # not the measured torque: its noise would make every share too small
    matrix[:, terms.torque_shares] = 0.0
    matrix[:, terms.torque_shares] = -own * (matrix @ values + beside)[:, None]


@dataclass(frozen=True)
class Problem:
    """Equations of all motions; unknowns are the payload's ten, the arm's 17 n, and each motion's own, 5 n + 3."""

    # shape (E, U); columns of gears, torque constants, scales, zeros and clocks are filled while it is solved
    matrix: FloatArray
    # torque, joint, direction: of each equation, see `Rows`
    torque: FloatArray
    joint: NDArray[np.int64]
    stretch: NDArray[np.int64]  # of each, labelled apart from motion to motion, shape (E,)
    direction: FloatArray
    motion: NDArray[np.int64]  # number of its motion, shape (E,)
    by_mass: FloatArray  # mean torque per kilogram at the payload's place, held or not, shape (E,)
    # zero, inertial: see `Rows`, with nothing of the payload where none is held
    zero: FloatArray
    inertial: FloatArray
    torque_rate: FloatArray  # see `Rows`
    start_s: FloatArray  # when each equation's window begins in its motion [s], shape (E,)
    counted: FloatArray  # as what share of itself each counts, see `long_motions`, shape (E,)
    loaded: int  # so many motions, the first ones, hold the payload
    count: int  # of joints, n
    late_share: float = 0.0  # of all windows, that were left out since their goals came late

    @classmethod
    def of(
        cls,
        parts: Sequence[Rows],
        loaded: int,
    ) -> Problem:
        """All motions together, ``loaded`` of them with the payload."""
        count = parts[0].design.shape[1] // TERMS
        shared = ARM_TERMS * count
        friction = len(FRICTION_TERMS) * count
        own = own_terms(count)
        matrix = []
        for number, part in enumerate(parts):
            of_motion = np.zeros((len(part.joint), own * len(parts)))
            of_motion[:, own * number : own * number + friction] = part.design[:, shared:]
            payload = part.payload if number < loaded else np.zeros_like(part.payload)
            matrix.append(np.hstack([payload, part.design[:, :shared], of_motion]))
        rows = Rows.together(parts)
        motion = np.repeat(
            np.arange(len(parts)),
            [len(part.joint) for part in parts],
        )
        stretch = rows.stretch + RUNS_OF_ITS_OWN * motion
        zero = rows.zero
        inertial = rows.inertial
        if loaded < len(parts):
            zero = zero.copy()
            inertial = inertial.copy()
            zero[motion >= loaded, :, :PARAMETERS] = 0.0
            inertial[motion >= loaded, :PARAMETERS] = 0.0
        return cls(
            matrix=np.vstack(matrix),
            torque=rows.torque,
            joint=rows.joint,
            stretch=stretch,
            direction=rows.direction,
            motion=motion,
            by_mass=rows.payload[:, 0],
            zero=zero,
            inertial=inertial,
            torque_rate=rows.torque_rate,
            start_s=rows.start_s,
            counted=counted_share(motion, rows.joint, stretch),
            loaded=loaded,
            count=count,
        )

    def only(self, kept: NDArray[np.bool_]) -> Problem:
        """Some of its equations."""
        if kept.all():
            return self
        arrays = {
            field.name: getattr(self, field.name)[kept]
            for field in fields(self)
            if field.name not in ("loaded", "count", "late_share")
        }
        return replace(self, **arrays)

    @property
    def motions(self) -> int:
        """How many there are."""
        shared = PARAMETERS + ARM_TERMS * self.count
        return (self.matrix.shape[1] - shared) // own_terms(self.count)

    def own(
        self,
        number: int,
        of: int = 0,
    ) -> slice:
        """Where the own terms of a motion stand among the unknowns, from the one numbered ``of`` on."""
        first = PARAMETERS + ARM_TERMS * self.count + number * own_terms(self.count)
        return slice(first + of, first + own_terms(self.count))

    def fill_own(self, matrix: FloatArray, values: FloatArray) -> None:
        """Fill the columns of what each motion has of its own beside friction, which go with a solution.

        Args:
            matrix: As `matrix`; changed in place, shape (E, U).
            values: The solution, shape (U,).
        """
        count = self.count
        bodies = slice(0, PARAMETERS * (1 + count))
        by_zero = self.zero @ values[bodies]
        by_pace = self._by_pace(values)
        torque = matrix @ values
        own_shares = -np.eye(count)[self.joint] * torque[:, None]
        shares = np.column_stack([own_shares, by_zero, -torque, by_pace, -self.torque_rate])
        for number in range(self.motions):
            rows = self.motion == number
            matrix[rows, self.own(number, len(FRICTION_TERMS) * count)] = shares[rows]

    def _by_pace(self, values: FloatArray) -> FloatArray:
        """Torque of a solution per unit of how much larger all accelerations are than the clock has them [N m], shape (E,).

        Inertia goes with acceleration, viscous friction with velocity, and so with its square root.
        """
        count = self.count
        rotors = ArmTerms(count, PARAMETERS).rotors
        bodies = slice(0, rotors.start)  # the payload before them
        torque = self.inertial @ values[bodies] + self.matrix[:, rotors] @ values[rotors]
        for number in range(self.motions):
            first = self.own(number).start
            viscous = slice(first, first + count)
            torque += 0.5 * self.matrix[:, viscous] @ values[viscous]
        return torque

    @property
    def carrying(self) -> NDArray[np.bool_]:
        """Which equations are of motions with the payload, shape (E,)."""
        return self.motion < self.loaded

    def stretches_of(
        self,
        kept: NDArray[np.bool_],
        name: str,
        better_s: float,
        least: int = MIN_STRETCHES,
    ) -> int:
        """How many stretches some of its equations have.

        Args:
            kept: Which equations, shape (E,).
            name: Of a motion, for the sentence.
            better_s: So long a motion would be better [s].
            least: Stretches that there have to be.

        Raises `TooLittleMotion`: There are fewer.
        """
        stretches = len(np.unique(self.stretch[kept]))
        if stretches < least:
            raise TooLittleMotion(
                f"{name}: only {STRETCH_S * stretches:.0f} s of motion can be used; record {STRETCH_S * MIN_STRETCHES:.0f} s at "
                f"least, better {better_s:.0f}, with all joints moving"
            )
        return stretches

    def rms_by_joint(
        self,
        values: FloatArray,
        kept: NDArray[np.bool_],
    ) -> FloatArray:
        """Of some equations' values, by joint, shape (n,); NaN of joints without a value."""
        mine = [values[kept & (self.joint == number)] for number in range(self.count)]
        return np.array(
            [np.sqrt(np.mean(of_joint**2)) if len(of_joint) else np.nan for of_joint in mine]
        )


def problem_of(
    robot: Robot,
    motions: Sequence[Motion],
    joints: Sequence[str],
    loaded: int,
    centre_m: FloatArray | None = None,
) -> Problem:
    """The equations of all motions, but for joints that move too little to leave a residual.

    Args:
        robot: Its torque constants and geometry.
        motions: Of these joints.
        joints: Whose terms are the columns.
        loaded: So many motions, the first ones, hold the payload.
        centre_m: Where the payload's mass sits, see `equations`, shape (3,).

    Raises:
        RecordingError: A motion is too short, or too fast for its rate.
    """
    parts = [equations(robot, motion, joints, centre_m) for motion in motions]
    return Problem.of(weighable(parts), loaded)
