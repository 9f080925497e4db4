"""What is wrong with motions beside joints that are misread: gravity from elsewhere, torque that fades, goals no servo heard.

Each is undone in turn as `misread` does it, to several sizes, and what explains the torques far better than anything else is named.
A sentence gives the size that did so among those that were tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from proprio_ros.identification.regression.likelihood import (
    ALL,
    CLEARER,
    EXPLAINED,
    NAMED_AT_MOST,
    SURE,
    Fit,
    Recorded,
    squares_of,
)
from proprio_ros.identification.regression.motion_equations import (
    HOP_SHARE,
    WINDOW_S,
    Rows,
    equations,
)
from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.robot.drives import PositionServo

FINER = 3  # rounds that halve the step between two sizes
SOUGHT_FINELY = 4  # so many of the best explanations
FADES = (-0.15, -0.1, -0.06, -0.03, 0.03, 0.06, 0.1, 0.15)
"""By what share effort per torque is tried to change from the beginning of a recording to its end."""
LATE_S = tuple(0.02 * step for step in (*range(-10, 0), *range(1, 11)))
GAINS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.1, 1.25, 1.4, 1.6, 2.0)
OFFSETS_RAD = (-0.15, -0.08, -0.04, 0.04, 0.08, 0.15)
ENDS = (0.06, 0.12, 0.2, 0.3)
"""Shares of a joint's goals, by their range, that its servo is tried to have cut off."""
TILTS_RAD = (0.1, 0.2, 0.35, 0.6)
DIRECTIONS = 8
ZEROS_RAD = (-0.5, -0.3, -0.15, -0.05, 0.05, 0.15, 0.3, 0.5)
"""A joint that is read from elsewhere turns what gravity does to all before it, as a tilted base does."""
FINEST_TILT_RAD = 0.02
LEAST_TILT_RAD = 0.05
"""A base that is tilted by less is level as most are."""


@dataclass(frozen=True)
class Cause:
    """One explanation, to the size that explains most."""

    kind: str  # of several sizes the best one counts
    words: str
    code: str
    scope: str  # see `likelihood`
    fit: Fit
    size: float = 0.0


@dataclass(frozen=True)
class _Family:
    """One explanation of any size."""

    kind: str
    sizes: tuple[float, ...]  # increasing
    tried: Callable[[float], Iterator[Cause]]

    def finer(self, cause: Cause) -> Cause:
        """The best one about a cause of this family, between the sizes beside it."""
        at = self.sizes.index(cause.size)
        beside = self.sizes[max(at - 1, 0) : at + 2]
        step = float(np.ptp(beside)) / max(len(beside) - 1, 1)
        best = cause
        for _ in range(FINER):
            step *= 0.5
            sizes = (best.size - step, best.size + step)
            near = [each for size in sizes for each in self.tried(size)]
            best = min([best, *near], key=lambda each: each.fit.cost)
        return best


def other_causes(recorded: Recorded) -> tuple[Cause, ...]:
    """Explanations of motions that are far better than none, the best first."""
    found = _best_sizes(recorded, [*_fades(recorded), *_by_goals(recorded)])
    tilted = _tilted(recorded)
    if tilted is not None and tilted.fit.cost < recorded.fit.cost - SURE:
        found += [tilted, *_best_sizes(recorded, list(_zeros(recorded)))]
    return tuple(sorted(found, key=lambda cause: cause.fit.cost))


def _best_sizes(recorded: Recorded, families: Sequence[_Family]) -> list[Cause]:
    """Of each family that is far better than none its best member; those that may be the best of all are sought finely."""
    coarse = []
    for family in families:
        tried = [each for size in family.sizes for each in family.tried(size)]
        best = min(tried, key=lambda cause: cause.fit.cost)
        if best.fit.cost < recorded.fit.cost - SURE:
            coarse.append((best, family))
    coarse.sort(key=lambda pair: pair[0].fit.cost)
    fine = [family.finer(best) for best, family in coarse[:SOUGHT_FINELY]]
    return [*fine, *(best for best, _ in coarse[SOUGHT_FINELY:])]


def sure(
    causes: Sequence[Cause],
    rival: float,
) -> tuple[Cause, ...]:
    """The best explanation, and one that is not told from it; none where another is as good.

    Args:
        causes: The best first.
        rival: The cost of the best explanation that is none of these.
    """
    if not causes or causes[0].fit.unexplained_of_all > EXPLAINED:
        return ()
    alike = [each for each in causes if each.fit.cost < causes[0].fit.cost + CLEARER]
    beaten = rival < causes[0].fit.cost + CLEARER
    return () if beaten or len(alike) > NAMED_AT_MOST else tuple(alike)


# --- torque that fades --------------------------------------------------------------------------------------------------


def _fades(recorded: Recorded) -> Iterator[_Family]:
    """Effort per torque that changes along each recording, as while motors warm up."""

    def tried(share: float) -> Iterator[Cause]:
        mended = []
        for rows, squares in zip(recorded.rows, recorded.squares, strict=True):
            span_s = max(float(np.ptp(rows.start_s)), 1e-9)
            factor = 1.0 + share * ((rows.start_s - rows.start_s.min()) / span_s - 0.5)
            log_scale = HOP_SHARE * float(np.log(factor).sum())
            mended.append(squares.with_torque(rows, rows.torque / factor, log_scale))
        way = "rose" if share > 0.0 else "fell"
        words = (
            f"effort per torque {way} by about {100.0 * abs(share):.0f} % along the recording, as while motors warm up: let the "
            "arm warm up first"
        )
        for scope, fit in recorded.without(mended).items():
            yield Cause("fades", words, "changed_along", scope, fit, share)

    if not recorded.motions[0].made_of_goals:
        yield _Family("fades", FADES, tried)


# --- goals that the servos did not hear ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Servo:
    """A joint whose torque is made of the distance to its goal."""

    number: int  # of its column
    name: str
    drive: PositionServo
    stall_A: float  # at a duty cycle of 1
    N_m_per_A: float

    def goal(self, motion: Motion) -> FloatArray:
        """Where it was sent by its current [rad], shape (T,); at its limit, where that begins."""
        duty = motion.current_A[:, self.number] / self.stall_A
        distance = duty / self.drive.gain_per_rad
        distance += self.drive.dead_band_rad * np.sign(distance)
        return motion.position[:, self.number] + distance

    def torque(self, motion: Motion, goal: FloatArray) -> FloatArray:
        """That goals make [N m], shape (T,)."""
        distance = goal - motion.position[:, self.number]
        beyond = np.maximum(np.abs(distance) - self.drive.dead_band_rad, 0.0)
        duty = self.drive.gain_per_rad * np.sign(distance) * beyond
        limit = self.drive.limit
        return self.N_m_per_A * self.stall_A * np.clip(duty, -limit, limit)


def _servos(robot: Robot, motion: Motion) -> list[_Servo]:
    """The joints of a motion that goals drive."""
    if not motion.made_of_goals:
        return []
    found = []
    driven = voltage_driven(robot)
    for number, name in enumerate(motion.joints):
        train = robot.drive_trains[name]
        if name not in driven or not isinstance(train.driven_by, PositionServo):
            continue
        if train.supply_voltage_V <= 0.0:
            continue
        stall_A = train.supply_voltage_V / train.resistance_ohm
        constant = train.torque_constant.value
        found.append(_Servo(number, name, train.driven_by, stall_A, constant))
    return found


def _by_goals(recorded: Recorded) -> Iterator[_Family]:
    """Goals that are late, cut off or counted from elsewhere, and servos with another gain or supply."""
    servos = _servos(recorded.robot, recorded.motions[0])
    if not servos:
        return
    yield _late(recorded, servos)
    yield _other_gain(recorded, servos, "the servos")
    for servo in servos:
        yield _other_gain(recorded, [servo], f"the servo of {servo.name}")
        yield _offset(recorded, servo)
        for lower, upper in ((0.0, 1.0), (1.0, 0.0), (0.5, 0.5)):
            yield _cut_off(recorded, servo, lower, upper)


def _late(recorded: Recorded, servos: Sequence[_Servo]) -> _Family:
    """Goals that are stamped later, or earlier, than they were heard."""

    def tried(late_s: float) -> Iterator[Cause]:
        changes = []
        for motion in recorded.motions:
            times_s = motion.times_s
            goals = {
                each: np.interp(times_s + late_s, times_s, each.goal(motion)) for each in servos
            }
            changes.append({each.number: each.torque(motion, goal) for each, goal in goals.items()})
        way = "later" if late_s > 0.0 else "earlier"
        words = (
            f"goals are stamped about {1e3 * abs(late_s):.0f} ms {way} than the servos heard them"
        )
        yield from _with_torques("late", late_s, words, recorded, changes)

    return _Family("late", LATE_S, tried)


def _other_gain(recorded: Recorded, servos: Sequence[_Servo], which: str) -> _Family:
    """Servos that make more or less of the distance to their goals; ``which``: in words."""
    numbers = [servo.number for servo in servos]
    kind = f"gain of {which}"

    def tried(gain: float) -> Iterator[Cause]:
        factor = np.ones(recorded.fitting.count)
        factor[numbers] = gain
        mended = [each.louder(1.0 / factor) for each in recorded.squares]
        words = (
            f"{which} made about {gain:.2g} times the torque of the distance to the goals that was stated, as of another P gain or "
            "supply"
        )
        for scope, fit in recorded.without(mended).items():
            yield Cause(kind, words, "other_torque", scope, fit, gain)

    return _Family(kind, GAINS, tried)


def _offset(recorded: Recorded, servo: _Servo) -> _Family:
    """Goals that are counted from another zero than positions."""
    kind = f"offset of {servo.name}"

    def tried(off_rad: float) -> Iterator[Cause]:
        words = f"goals of {servo.name} are counted from another zero than its positions, about {off_rad:+.2f} rad from there"
        changes = [
            {servo.number: servo.torque(motion, servo.goal(motion) - off_rad)}
            for motion in recorded.motions
        ]
        yield from _with_torques(kind, off_rad, words, recorded, changes)

    return _Family(kind, OFFSETS_RAD, tried)


def _cut_off(
    recorded: Recorded,
    servo: _Servo,
    lower: float,
    upper: float,
) -> _Family:
    """A servo that keeps within ends of its own, and a log with the goals beyond.

    Args:
        recorded: The motions.
        servo: The joint's.
        lower: Share of what is cut off that is cut off at the lower end.
        upper: The same at the upper end.
    """
    kind = f"ends of {servo.name}"
    goals = [servo.goal(motion) for motion in recorded.motions]
    low = min(float(goal.min()) for goal in goals)
    high = max(float(goal.max()) for goal in goals)

    def tried(share: float) -> Iterator[Cause]:
        cut = share * (high - low)
        first = low + lower * cut
        last = high - upper * cut
        changes = [
            {servo.number: servo.torque(motion, np.clip(goal, first, last))}
            for motion, goal in zip(recorded.motions, goals, strict=True)
        ]
        words = f"the servo of {servo.name} kept within about {first:.2f} to {last:.2f} rad, and the goals are recorded uncut"
        yield from _with_torques(kind, share, words, recorded, changes)

    return _Family(kind, ENDS, tried)


def _with_torques(
    kind: str,
    size: float,
    words: str,
    recorded: Recorded,
    changes: Sequence[dict[int, FloatArray]],
) -> Iterator[Cause]:
    """Other torques of some joints.

    Args:
        kind: Of the cause.
        size: Of it.
        words: Of it.
        recorded: The motions.
        changes: Of each motion the torque [N m], shape (T,), by the number of the joint.
    """
    mended = []
    for number, change in enumerate(changes):
        motion = recorded.motions[number]
        rows = recorded.rows[number]
        torque = rows.torque.copy()
        for joint, instead in change.items():
            name = motion.joints[joint]
            constant = recorded.robot.drive_trains[name].torque_constant.value
            more = instead - constant * motion.current_A[:, joint]
            mine = rows.joint == joint
            torque[mine] += _means(motion.times_s, more, rows.start_s[mine])
        mended.append(recorded.squares[number].with_torque(rows, torque))
    for scope, fit in recorded.without(mended).items():
        yield Cause(kind, words, "other_torque", scope, fit, size)


def _means(times_s: FloatArray, values: FloatArray, start_s: FloatArray) -> FloatArray:
    """Of values over windows that begin at some times."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(times_s)
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    ends = np.interp(start_s + WINDOW_S, times_s, integral)
    result: FloatArray = (ends - np.interp(start_s, times_s, integral)) / WINDOW_S
    return result


# --- gravity from elsewhere ---------------------------------------------------------------------------------------------


class _ByGravity:
    """Squares of motions by where gravity pulls: columns are linear in it, so squares are sums over pairs of its axes."""

    def __init__(self, recorded: Recorded) -> None:
        self.recorded = recorded
        self.pairs = [self._pairs(motion) for motion in recorded.motions]

    def _pairs(self, motion: Motion) -> FloatArray:
        """Products of columns without gravity and by each of its axes, shape (4, 4, n, K, K)."""
        robot = self.recorded.robot
        still = _columns(robot, motion, np.zeros(3))
        axes = [_columns(robot, motion, axis) for axis in np.eye(3)]
        parts = [still.values, *(axis.values - still.values for axis in axes)]
        count = self.recorded.fitting.count
        of_joint = [still.joint == joint for joint in range(count)]
        return np.array(
            [[[one[mine].T @ other[mine] for mine in of_joint] for other in parts] for one in parts]
        )

    def fit(self, gravity: FloatArray) -> Fit:
        """With gravity of all motions as given [m/s^2], shape (3,)."""
        along = np.concatenate([[1.0], gravity])
        factors = np.outer(along, along)
        squares = [
            replace(each, products=np.tensordot(factors, pairs, 2))
            for each, pairs in zip(self.recorded.squares, self.pairs, strict=True)
        ]
        return self.recorded.fitting.fit(squares)


@dataclass(frozen=True)
class _Columns:
    """Columns of a motion's equations, the torque the last."""

    values: FloatArray  # shape (E, K)
    joint: NDArray[np.int64]  # of each row, shape (E,)


def _columns(robot: Robot, motion: Motion, gravity: FloatArray) -> _Columns:
    rows: Rows = equations(
        replace(robot, gravity=gravity),
        motion,
        motion.joints,
        by_zeros=False,
    )
    values = np.column_stack([rows.payload, rows.design, rows.torque])
    return _Columns(values, rows.joint)


def _tilted(recorded: Recorded) -> Cause | None:
    """A base that stands otherwise than the robot file says: the tilt that explains most, sought in ever smaller steps."""
    stated = recorded.robot.gravity.copy()  # SciPy turns no array that is read-only
    by_gravity = _ByGravity(recorded)
    across = np.linalg.svd(stated[None] / np.linalg.norm(stated))[2][1:]
    turns = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ways = np.column_stack([np.cos(turns), np.sin(turns)])

    def pulled(tilt: FloatArray) -> FloatArray:
        result: FloatArray = Rotation.from_rotvec(tilt @ across).apply(stated)
        return result

    centre = np.zeros(2)
    best = recorded.fit
    for step in TILTS_RAD:
        for tilt in step * ways:
            fit = by_gravity.fit(pulled(tilt))
            if fit.cost < best.cost:
                centre = tilt
                best = fit
    if not centre.any():
        return None
    step = 0.5 * TILTS_RAD[0]
    while step > FINEST_TILT_RAD / 2.0:
        near = [(by_gravity.fit(pulled(tilt)), tilt) for tilt in centre + step * ways]
        fit, tilt = min(near, key=lambda each: each[0].cost)
        if fit.cost < best.cost:
            centre = tilt
            best = fit
        else:
            step *= 0.5
    angle = float(np.linalg.norm(centre))
    if angle < LEAST_TILT_RAD:
        return None
    shown = ",".join(f"{value:.2f}" for value in pulled(centre))
    words = (
        f"torques are those of an arm on which gravity pulls along [{shown}] m/s^2 of the base, {np.degrees(angle):.0f} degrees "
        "from where the robot file has it. Where the base is mounted so, --set "
        f"robot.gravity=[{shown}] states it"
    )
    return Cause("tilt", words, "misfit", ALL, best)


def _zeros(recorded: Recorded) -> Iterator[_Family]:
    """Joints that are read from elsewhere, one at a time."""
    names = recorded.motions[0].joints
    for number in range(len(names)):
        yield _zero(recorded, number)


def _zero(recorded: Recorded, number: int) -> _Family:
    name = recorded.motions[0].joints[number]
    kind = f"zero of {name}"

    def tried(off_rad: float) -> Iterator[Cause]:
        off = off_rad * np.eye(recorded.fitting.count)[number]
        mended = [
            squares_of(recorded.robot, replace(motion, position=motion.position - off))
            for motion in recorded.motions
        ]
        words = f"{name} is read about {off_rad:+.2f} rad off from where its URDF has it, as after its zero was set anew"
        for scope, fit in recorded.without(mended).items():
            yield Cause(kind, words, "other_zero", scope, fit, off_rad)

    return _Family(kind, ZEROS_RAD, tried)
