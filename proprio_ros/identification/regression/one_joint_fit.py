"""How a single joint swings what it carries, from any motion under whatever controller.

A joint alone is a pendulum: its torque is that of its inertia J, of gravity on the first moment m of all that it moves, and of
friction. In weak form (`weak_form`) these are a few columns of a linear regression. Torque and motion alone give J / |m|, the
length of the mathematical pendulum that swings alike, which no error of the torque's scale touches; J and m err as that scale does.

One recording of a few seconds knows its own error badly: friction differs from place to place, and the answer depends on the
windows and on whether the torque or the acceleration is taken as what has the error (a torque that a controller made from noisy
positions has its share). So the answer is the mean over such choices, and its variance that among them and that of a jackknife over
stretches of 1 s.

Constants below that name no source were chosen by hand; `test/benchmarks/real.py` measures how intervals hold with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from proprio_ros.errors import RecordingError
from proprio_ros.identification.estimate import JointFit
from proprio_ros.identification.regression.motion_equations import SLOW_RAD_S
from proprio_ros.identification.regression.traces import Explained
from proprio_ros.identification.regression.weak_form import Windows, across_gaps, evenly
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.sim.payload import PayloadFacts

WINDOWS_S = (0.25, 0.5)
HOP_SHARE = 0.125
# Positions and torques are smoothed alike to this; a pendulum on a table swings at 1 Hz.
BANDWIDTH_HZ = 12.0
STRETCH_S = 1.0  # Stretches that are left out together.
MIN_STRETCHES = 4
LOAD_FRICTION_STD = 0.05  # Gears lose part of the torque that they transmit.
LEAST_LENGTH_STD = 0.005
"""Relative; a delay of a few milliseconds between torque and position, which nothing here looks for, is worth this much."""
ITERATIONS = 8
UPRIGHT_SHARE = 0.2  # An axis along which this little of gravity turns anything is upright.


@dataclass(frozen=True)
class OneJointFit:
    """What the motions of one joint say."""

    joint: str  # its name
    # length of the equivalent pendulum [m], inertia [kg m^2], first moment along both directions of `Hinge` [kg m], (4,)
    values: FloatArray
    covariance: FloatArray  # of these, but for the torque's scale, shape (4, 4)
    stretches: int  # number of stretches
    quantile: float  # half width of a 95 % interval in standard deviations
    residual: float  # rms of the windows' mean torque that is left over [N m]
    driven: float  # rms of the mean torque [N m]
    load: float  # rms of the part that inertia and gravity take of it [N m]
    # of the acceleration's variance, that gravity and friction explain without any torque of the motor
    free_share: float
    free_m: float  # length of the pendulum whose free response that would be [m]
    # viscous, coulomb: means over the motions [N m s/rad], [N m]
    viscous: float
    coulomb: float
    one_sign: bool  # whether no sample of the torque has another sign than the others
    # windows, left_over: of each motion, and the torque that is left over in all of them [N m], shape (W,)
    windows: Sequence[Table]
    left_over: FloatArray

    @property
    def std(self) -> FloatArray:
        """Standard deviations, shape (4,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class Hinge:
    """A joint that moves alone, in the frame of its body at position zero."""

    model: ReducedModel  # the robot with its other joints locked
    axis: FloatArray  # unit vector, shape (3,)
    gravity: FloatArray  # [m/s^2], shape (3,)
    directions: FloatArray  # two unit vectors across the axis, and each other, shape (2, 3)

    @property
    def is_upright(self) -> bool:
        """Whether gravity hardly turns the joint."""
        across = self.gravity - (self.gravity @ self.axis) * self.axis
        return bool(np.linalg.norm(across) < UPRIGHT_SHARE * np.linalg.norm(self.gravity))

    def gravity_moments(self, position: FloatArray) -> FloatArray:
        """Torque per first moment along both directions [m/s^2] at some positions [rad], shape (T,) to (T, 2)."""
        axis = self.axis
        gravity = self.gravity
        cosine = np.cos(position)[:, None]
        sine = np.sin(position)[:, None]
        along = axis * (axis @ gravity) * (1.0 - cosine)
        # gravity in the frame of the body, which turned by the position; its torque on a first moment d along the axis: a . (d x g)
        seen = gravity * cosine - np.cross(axis, gravity) * sine + along  # (T, 3)
        return -np.column_stack([np.cross(d, seen) @ axis for d in self.directions])

    @classmethod
    def of(
        cls,
        robot: Robot,
        joint: str,
        motion: Motion,
    ) -> Hinge:
        """Of a motion, whose other joints stood still.

        ``robot``: its geometry; ``joint``: that moves alone; ``motion``: where the other joints stand.
        """
        model = robot.model.lock(
            [joint],
            dict(motion.held),
            robot.gravity,
        )
        axis = model.axes[0]
        least = np.eye(3)[int(np.argmin(np.abs(axis)))]
        first = np.cross(axis, least)
        first /= np.linalg.norm(first)
        gravity = model.placement[0][:3, :3].T @ model.gravity
        directions = np.array([first, np.cross(axis, first)])
        return cls(model, axis, gravity, directions)


@dataclass(frozen=True)
class Carried:
    """What hangs on a joint by robot file and facts, as a `Table` takes it, by column: inertia [kg m^2], first moments [kg m]."""

    arm: FloatArray  # of the URDF's bodies, shape (3,)
    per_kg: FloatArray  # of the payload, shape (3,)
    centre_std_m: float  # how well the payload's place across the axis is known


def carried_by(
    robot: Robot,
    joint: str,
    motion: Motion,
    facts: PayloadFacts,
) -> Carried:
    """Arm and payload about one joint.

    Args:
        robot: Its geometry.
        joint: That moves alone.
        motion: Where the other joints stand.
        facts: Where the payload sits, and how it is spread.
    """
    hinge = Hinge.of(robot, joint, motion)
    directions = hinge.directions
    (bodies,) = hinge.model.pseudo_inertia
    body_from_payload = hinge.model.frames[robot.payload_frame][1]
    turn = body_from_payload[:3, :3]
    lever = directions @ (turn @ facts.com + body_from_payload[:3, 3])
    spread = facts.shape.second_moment_per_mass
    own_axis = turn.T @ hinge.axis
    about_centre = float(np.trace(spread) - own_axis @ spread @ own_axis)
    inertia = float(np.sum((directions @ bodies[:3, :3]) * directions))
    moments = directions @ bodies[:3, 3]
    return Carried(
        arm=robot.arm_scale.value * np.array([inertia, *moments]),
        per_kg=np.array([about_centre + float(lever @ lever), *lever]),
        centre_std_m=float(np.linalg.norm(directions @ turn @ np.diag(facts.com_std))),
    )


def fit_one_joint(
    robot: Robot,
    motions: Sequence[Motion],
    joint: str,
) -> OneJointFit:
    """Fit inertia, first moment and friction of a joint that moves alone.

    Args:
        robot: Its torque constant and geometry.
        motions: With the same load, each with friction of its own.
        joint: That moved.

    Raises `RecordingError`: They are too short, or gravity does not turn the joint.
    """
    hinge = Hinge.of(robot, joint, motions[0])
    if hinge.is_upright:
        raise RecordingError(
            f"{motions[0].name}: {joint} turns about the vertical, where gravity does nothing"
        )
    tables = [
        [table_of(robot, motion, joint, hinge, window_s) for motion in motions]
        for window_s in WINDOWS_S
    ]
    longest = tables[-1]
    stretches = stretches_of(longest)
    if len(stretches) < MIN_STRETCHES:
        raise RecordingError(
            f"{motions[0].name}: {joint} moves for {STRETCH_S * len(stretches):.0f} s without a pause or a gap; record "
            f"{STRETCH_S * MIN_STRETCHES:.0f} s of motion at least, better 15"
        )
    values, covariance = _jackknifed(tables, stretches)
    solution = _by_torque(longest)
    columns = np.vstack([part.columns for part in longest])
    free_share, free_m = _free_response(columns)
    torques = np.concatenate(
        [motion.complete().current_A[:, motion.joints.index(joint)] for motion in motions]
    )
    return OneJointFit(
        joint=joint,
        values=values,
        covariance=covariance,
        stretches=len(stretches),
        quantile=float(stdtrit(len(stretches) - 1, 0.975)),
        residual=rms(solution.residual),
        driven=rms(np.concatenate([part.torque for part in longest])),
        load=rms(columns[:, :3] @ solution.load),
        free_share=free_share,
        free_m=free_m,
        viscous=float(np.mean(solution.friction[:, 0])),
        coulomb=float(np.mean(solution.friction[:, 1])),
        one_sign=bool(np.all(torques >= 0.0) or np.all(torques <= 0.0)),
        windows=longest,
        left_over=solution.residual,
    )


def _jackknifed(
    tables: Sequence[Sequence[Table]], stretches: Sequence[tuple[int, int]]
) -> tuple[FloatArray, FloatArray]:
    """Mean over the ways to take the windows, and its covariance among them and as stretches are left out, (4,) and (4, 4)."""
    choices = _choices(tables)
    values = choices.mean(axis=0)
    moved = []
    for stretch in stretches:
        rest = [without(parts, *stretch) for parts in tables]
        moved.append(_choices(rest).mean(axis=0) - values)
    off = np.array(moved)  # (stretches, 4)
    count = len(stretches)
    covariance = (count - 1) / count * off.T @ off + np.cov(choices.T)
    covariance[0, 0] += (LEAST_LENGTH_STD * values[0]) ** 2
    return values, covariance


def _free_response(columns: FloatArray) -> tuple[float, float]:
    """How much of the acceleration's variance gravity and friction explain alone, and of a pendulum of which length [m]."""
    acceleration = columns[:, 0]
    others = columns[:, 1:]
    alone = np.linalg.lstsq(others, acceleration, rcond=None)[0]
    idle = acceleration - others @ alone
    share = 1.0 - (rms(idle) / max(rms(acceleration), 1e-12)) ** 2
    frequency_squared = float(np.hypot(alone[0], alone[1]))
    return share, 1.0 / max(frequency_squared, 1e-9)


@dataclass(frozen=True)
class Table:
    """Windows of one motion."""

    # mean torque per unit of inertia, two first moments, viscous and Coulomb friction, offset, shape (W, 6)
    columns: FloatArray
    torque: FloatArray  # mean torque of the motor [N m], shape (W,)
    stretch: NDArray[np.int64]  # number of the stretch, shape (W,)
    middle_s: FloatArray  # of each window [s], shape (W,)

    def only(self, kept: NDArray[np.bool_]) -> Table:
        """Some of its windows."""
        return Table(*(getattr(self, field.name)[kept] for field in fields(Table)))


def stretches_of(parts: Sequence[Table]) -> list[tuple[int, int]]:
    """Number of the motion and of the stretch in it, of all."""
    return [
        (number, int(label))
        for number, part in enumerate(parts)
        for label in np.unique(part.stretch)
    ]


def without(parts: Sequence[Table], number: int, label: int) -> list[Table]:
    """All windows but those of one stretch; a motion that has no other is none of them.

    ``parts``: of each motion; ``number``: of the motion; ``label``: of its stretch.
    """
    kept = parts[number].stretch != label
    rest = list(parts)
    rest[number] = parts[number].only(kept)
    if not kept.any():
        del rest[number]
    return rest


def table_of(
    robot: Robot,
    motion: Motion,
    joint: str,
    hinge: Hinge,
    window_s: float,
    slow_rad_s: float = SLOW_RAD_S,
) -> Table:
    """What one motion says in windows of one length.

    Args:
        robot: Its torque constant.
        motion: Of the joint.
        joint: That moves alone.
        hinge: The same in the motion.
        window_s: Length of the windows [s].
        slow_rad_s: A window in which the joint is mostly slower does not count [rad/s].

    Raises `RecordingError`: It does not move for long enough.
    """
    times_s, positions, currents = evenly(motion, [joint], BANDWIDTH_HZ, currents_too=True)
    period_s = float(np.median(np.diff(motion.times_s)))
    position = positions[:, 0]
    velocity = np.gradient(position, period_s)
    width = max(round(window_s / period_s), 4)
    windows = Windows.over(
        len(times_s),
        width,
        max(1, round(HOP_SHARE * width)),
    )
    columns = np.column_stack(
        [
            windows.derivative(velocity, period_s),
            windows.mean(hinge.gravity_moments(position)),
            windows.mean(velocity),
            windows.mean(np.tanh(velocity / slow_rad_s)),
            np.ones(len(windows.starts)),
        ]
    )
    counts = windows.share(np.abs(velocity) < slow_rad_s) < 0.5
    counts &= ~across_gaps(motion, [joint], times_s, windows)[:, 0]
    if counts.sum() <= columns.shape[1]:
        raise RecordingError(
            f"{motion.name}: {joint} does not move for long enough without a pause or a gap"
        )
    torque = robot.drive_trains[joint].torque_constant.value * windows.mean(currents[:, 0])
    middle_s = times_s[windows.starts] + 0.5 * window_s
    stretch = (middle_s / STRETCH_S).astype(np.int64)
    return Table(columns, torque, stretch, middle_s).only(counts)


def _choices(tables: Sequence[Sequence[Table]]) -> FloatArray:
    """The four values by each way to take them, shape (C, 4)."""
    rows = []
    for parts in tables:
        for inertia, *moment in (_by_torque(parts).load, _by_acceleration(parts)):
            rows.append([inertia / np.hypot(*moment), inertia, *moment])
    return np.array(rows)


@dataclass(frozen=True)
class _Solution:
    load: FloatArray  # inertia and two moments, shape (3,)
    friction: FloatArray  # viscous, Coulomb and offset of each motion, shape (motions, 3)
    residual: FloatArray


@dataclass(frozen=True)
class _Stacked:
    """Windows of M motions."""

    load: FloatArray  # columns of inertia and two moments, shape (W, 3)
    friction: FloatArray  # columns of viscous, Coulomb and offset of each motion, shape (W, 3 M)
    torque: FloatArray  # shape (W,)
    motion: NDArray[np.int64]  # number of the motion, shape (W,)

    @classmethod
    def of(cls, parts: Sequence[Table]) -> _Stacked:
        """One after the other."""
        number = motion_numbers(parts)
        columns = np.vstack([part.columns for part in parts])
        friction = np.zeros((len(number), 3 * len(parts)))
        for motion in range(len(parts)):
            mine = number == motion
            friction[mine, 3 * motion : 3 * motion + 3] = columns[mine, 3:]
        torque = np.concatenate([part.torque for part in parts])
        return cls(
            columns[:, :3],
            friction,
            torque,
            number,
        )


def motion_numbers(parts: Sequence[Table]) -> NDArray[np.int64]:
    """Number of the motion of each window of all, shape (W,)."""
    return np.repeat(
        np.arange(len(parts)),
        [len(part.torque) for part in parts],
    )


def _by_torque(parts: Sequence[Table]) -> _Solution:
    """The torque has the error: least squares of it, with gears that lose part of the load's."""
    windows = _Stacked.of(parts)
    load = windows.load
    torque = windows.torque
    direction = windows.friction[:, 1::3].sum(axis=1)
    matrix = np.column_stack([load, windows.friction, np.zeros(len(torque))])
    weight = np.ones(len(torque))
    # the prior of load friction, in the unit of the equations
    prior = np.zeros(matrix.shape[1])
    values = np.zeros(matrix.shape[1])
    for _ in range(ITERATIONS):
        matrix[:, -1] = np.abs(load @ values[:3]) * direction
        noise = max(rms(weight * (torque - matrix @ values)), 1e-12)
        prior[-1] = noise / LOAD_FRICTION_STD
        weighted = np.vstack([matrix * weight[:, None], prior])
        values = np.linalg.lstsq(weighted, np.append(torque * weight, 0.0), rcond=None)[0]
        residual = torque - matrix @ values
        by_motion = [residual[windows.motion == number] for number in range(len(parts))]
        each = np.array([max(rms(of_motion), 1e-12) for of_motion in by_motion])
        weight = (each.min() / each)[windows.motion]
    return _Solution(
        values[:3],
        values[3:-1].reshape(-1, 3),
        residual,
    )


def _by_acceleration(parts: Sequence[Table]) -> FloatArray:
    """The acceleration has the error: inertia and two moments, shape (3,)."""
    windows = _Stacked.of(parts)
    matrix = np.column_stack([windows.torque, windows.load[:, 1:], windows.friction])
    values = np.linalg.lstsq(matrix, windows.load[:, 0], rcond=None)[0]
    return np.array([1.0, *(-values[1:3])]) / values[0]


def shown_of(
    names: Sequence[str],
    joint: str,
    windows: Sequence[Table],
    left_over: FloatArray,
    per_kg: FloatArray,
    mass_kg: float,
    usual: float,
    scale: float = 1.0,
) -> tuple[JointFit, ...]:
    """Torque over time, for a picture.

    Args:
        names: Of the motions.
        joint: Of the only joint.
        windows: Of each motion.
        left_over: Of all of them [N m], shape (W,).
        per_kg: See `Carried`.
        mass_kg: Of the payload.
        usual: See `JointFit`, in true torque.
        scale: The motor's torque and what is left over of it are so many times the true ones.
    """
    by_mass = np.concatenate([part.columns[:, :3] for part in windows]) @ per_kg
    number = motion_numbers(windows)
    explained = Explained(
        middle_s=np.concatenate([part.middle_s for part in windows]),
        motion=number,
        joint=np.zeros_like(number),
        measured=np.concatenate([part.torque for part in windows]) / scale,
        left_over=left_over / scale,
        payload=mass_kg * by_mass,
        by_mass=by_mass,
    )
    return explained.joint_fits(names, [joint], [usual])


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
