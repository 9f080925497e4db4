"""What a recording shows of itself, before any fit: what moves, what is held, and what its publisher did to velocities and efforts.

Only what was recorded is looked at; where the robot's URDF says what torque holds the arm, the effort is compared with that.
Nothing here is fitted on: every finding is a sentence with its numbers, and what to do about it is left to the user.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from proprio_ros.errors import RobotError, some
from proprio_ros.recordings.effort import CURRENT_PER_COUNT_A, EFFORT_UNITS, ampere
from proprio_ros.recordings.motions import MOVED_RAD
from proprio_ros.recordings.pace import Pace, pace_by_velocities
from proprio_ros.records import ZERO_CURRENT_A, FloatArray, JointRecord, Recording
from proprio_ros.robot import ReducedModel, Robot, is_description
from proprio_ros.robot.regressor import body_parameters, carriers, gravity_along, kinematics

MOVED_M = 0.002  # a slide that moves less stands still [m]
LONGEST_LAG_S = 0.15  # of a velocity behind its position; filters of servos take less [s]
LAG_S = 0.015
"""What a lag must reach to be said [s]; a velocity computed from the last two positions lags by half a period."""
SURE_CORRELATION = 0.9
SMOOTHED_S = 0.1  # efforts are compared with gravity over this time [s]
PLAUSIBLE = (0.5, 2.0)
"""Effort over the torque that gravity needs: within it lie an unknown load, gears that lose a part, and a URDF that is 15 % off."""
LEAST_T = 15.0
"""Times its formal standard error that gravity's share of an effort must be: residuals are correlated over seconds."""
LEAST_LOAD = 0.1
"""Of the largest change of gravity's torque on any joint: a wrist that hardly lifts says nothing of units."""
FEW_LEVELS = 5
"""An effort that takes fewer values than this between zeros is a sequence of excitations, and no old reading."""
STALE_SAMPLES = 4  # equal efforts in a row, typically, while the joint moves


@dataclass(frozen=True)
class Finding:
    """One thing that a reader should know."""

    code: str  # what it is, for programs
    sentence: str  # the same for people
    joints: tuple[str, ...] = ()  # that it is about
    # its numbers by joint, in the unit that the sentence names
    values: Mapping[str, float] = field(default_factory=dict)
    as_json = asdict


@dataclass(frozen=True)
class EffortUnit:
    """How the effort would compare with the torque that gravity needs if it were in some unit."""

    unit: str  # as for ``--effort-unit``
    # effort in N m over that torque by joint; 1 where all is as the URDF says
    ratio: Mapping[str, float]
    plausible: bool  # whether their median is within `PLAUSIBLE`
    as_json = asdict


def moving(
    record: JointRecord,
    slides: Sequence[str] = (),
) -> tuple[str, ...]:
    """The joints that do not stand still."""
    spans = np.ptp(record.position, axis=0)
    least = [MOVED_M if name in slides else MOVED_RAD for name in record.names]
    return tuple(
        name for name, span, limit in zip(record.names, spans, least, strict=True) if span > limit
    )


def findings(
    recording: Recording,
    slides: Sequence[str] = (),
) -> tuple[Finding, ...]:
    """All that a recording shows of itself without a robot, efforts in whatever unit the publisher used."""
    record = recording.joints
    moved = moving(record, slides)
    pace = pace_by_velocities(recording)
    stretched = pace is not None and pace.is_off
    by_column = (
        *_still_columns(record, moved),
        *_velocity(record, moved, stretched),
        *_registers(record, moved),
        *_stale(record, moved),
    )
    time_scale = [] if pace is None or not stretched else [_time_scale(pace, moved)]
    return (*_held(recording, moved), *time_scale, *by_column, *_command_as_effort(recording))


def _time_scale(pace: Pace, moved: Sequence[str]) -> Finding:
    """A time axis that is stretched, by joints that moved."""
    return Finding(
        "time_scale",
        pace.sentence,
        tuple(moved),
        dict.fromkeys(moved, pace.scale),
    )


def _held(recording: Recording, moved: Sequence[str]) -> Iterator[Finding]:
    """Joints that a current holds."""
    inputs = recording.inputs
    if inputs is None or not moved:
        return
    largest = dict(zip(inputs.names, np.abs(inputs.current_A).max(axis=0), strict=True))
    still = [name for name in recording.joints.names if name not in moved]
    if held := tuple(name for name in still if largest.get(name, 0.0) > ZERO_CURRENT_A):
        whose = "its motor gave held it" if len(held) == 1 else "their motors gave held them"
        yield Finding("held", f"{some(held)} stood still: what {whose} and drove nothing", held)


def _still_columns(record: JointRecord, moved: Sequence[str]) -> Iterator[Finding]:
    """Columns of a driver that has no such reading."""
    for quantity in ("velocity", "reported_effort"):
        values = getattr(record, quantity)
        if values is None:
            continue
        constant = {
            name: float(column[np.isfinite(column)][0])
            for name, column in zip(record.names, values.T, strict=True)
            if name in moved
            and np.isfinite(column).any()
            and np.ptp(column[np.isfinite(column)]) == 0.0
        }
        if constant:
            word = quantity.removeprefix("reported_")
            same = (
                f"{next(iter(constant.values())):g}"
                if len(set(constant.values())) == 1
                else "the same"
            )
            sentence = f"the {word} of {some(constant)} is {same} in every message although it moves: it is no reading"
            yield Finding(f"constant_{word}", sentence, tuple(constant), constant)


def evenly(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times, shape (T,), and values, shape (T, ...), at equal distances, by interpolation; between gaps the longest stretch."""
    period_s = float(np.median(np.diff(times_s)))
    cuts = [
        0,
        *(np.flatnonzero(np.diff(times_s) > max(0.1, 5.0 * period_s)) + 1),
        len(times_s),
    ]
    start, end = max(
        itertools.pairwise(cuts),
        key=lambda part: part[1] - part[0],
    )
    own = times_s[start:end]
    inside = values[start:end].reshape(end - start, -1)
    even = np.arange(
        own[0],
        own[-1] + 0.5 * period_s,
        period_s,
    )
    columns = np.column_stack([np.interp(even, own, column) for column in inside.T])
    return even, columns.reshape(len(even), *values.shape[1:])


def velocity_lag_s(
    times_s: FloatArray, position: FloatArray, velocity: FloatArray
) -> tuple[float, float] | None:
    """How far a recorded velocity is behind the derivative of its position, and how many times as large it is; all of shape (T,).

    Returns: Lag [s] (ahead is negative) and ratio; None where the two hardly agree at any lag.
    """
    even, both = evenly(times_s, np.column_stack([position, velocity]))
    period_s = float(even[1] - even[0])
    most = round(LONGEST_LAG_S / period_s)
    # both are smoothed alike, so that counts of the encoder do not decide
    width = max(3, round(0.05 / period_s) | 1)
    smooth = np.ones(width) / width
    derivative = np.convolve(
        np.gradient(both[:, 0], period_s),
        smooth,
        "same",
    )
    reported = np.convolve(both[:, 1], smooth, "same")
    if most < 1 or len(even) < 8 * most + 2 * width or not derivative.any() or not reported.any():
        return None
    inner = slice(2 * most, len(even) - 2 * most)
    late = reported[inner] - reported[inner].mean()
    lags = np.arange(-most, most + 1)
    agreement = np.zeros(len(lags))
    for row, lag in enumerate(lags):
        early = derivative[inner.start - lag : inner.stop - lag]
        early = early - early.mean()
        scale = np.sqrt((early @ early) * (late @ late))
        agreement[row] = early @ late / scale if scale > 0.0 else 0.0
    best = int(np.argmax(agreement))
    if agreement[best] < SURE_CORRELATION:
        return None
    shift = 0.0
    if 0 < best < len(lags) - 1:
        below, at, above = agreement[best - 1 : best + 2]
        bend = below - 2.0 * at + above
        shift = 0.5 * (below - above) / bend if bend < 0.0 else 0.0
    early = derivative[inner.start - lags[best] : inner.stop - lags[best]]
    return float((lags[best] + shift) * period_s), float(
        (early @ reported[inner]) / (early @ early)
    )


def _times_s(record: JointRecord) -> FloatArray:
    return 1e-9 * (record.times_ns - record.times_ns[0]).astype(np.float64)


def _velocity(
    record: JointRecord,
    moved: Sequence[str],
    stretched: bool,
) -> Iterator[Finding]:
    """Velocities that lag, or of another unit; of a stretched time axis they have none of their own to be blamed for."""
    if record.velocity is None:
        return
    times_s = _times_s(record)
    lags = {}
    ratios = {}
    for name in moved:
        column = record.column(name)
        known = np.isfinite(record.velocity[:, column])
        if known.sum() < 50 or np.ptp(record.velocity[known, column]) == 0.0:
            continue
        seen = velocity_lag_s(
            times_s[known], record.position[known, column], record.velocity[known, column]
        )
        if seen is not None:
            lags[name], ratios[name] = seen
    period_s = float(np.median(np.diff(times_s)))
    if late := {name: 1e3 * lag for name, lag in lags.items() if lag > max(LAG_S, 1.2 * period_s)}:
        sentence = (
            f"the velocity of {some(late)} lags its position by {_span(late, '.0f')} ms: a filter of the driver or the servo; "
            "positions alone are used"
        )
        yield Finding("velocity_lags", sentence, tuple(late), late)
    other = {name: ratio for name, ratio in ratios.items() if not 0.8 < ratio < 1.25}
    if other and not stretched:
        sentence = (
            f"the velocity of {some(other)} is {_span(other, '.3g')} times the derivative of its position: "
            "another unit (rpm are 9.55 times rad/s, degrees/s 57.3 times), or another joint's; positions alone are used"
        )
        yield Finding("velocity_scale", sentence, tuple(other), other)


def _span(values: Mapping[str, float], spec: str) -> str:
    """Smallest and largest, or the one where they print alike."""
    least = format(min(values.values()), spec)
    most = format(max(values.values()), spec)
    return least if least == most else f"{least} to {most}"


def _registers(record: JointRecord, moved: Sequence[str]) -> Iterator[Finding]:
    """Efforts that a driver took for unsigned: a register of 16 bits below zero, or a magnitude without its sign."""
    if record.reported_effort is None:
        return
    wrapped = {}
    unsigned = []
    highest = 0.0
    for name, effort, position in zip(
        record.names, record.reported_effort.T, record.position.T, strict=True
    ):
        known = effort[np.isfinite(effort)]
        if not len(known) or known.min() < 0.0 or np.ptp(known) == 0.0:
            continue
        whole = bool(np.all(known == np.round(known)))
        high = known[known > 32767.0]
        if (
            whole
            and len(high)
            and known.max() < 65536.0
            and np.all((known < 20000.0) | (known > 45000.0))
        ):
            wrapped[name] = float(high.min())
            highest = max(highest, float(known.max()))
        elif name in moved:
            step = np.diff(position)
            way = np.sign(step[step != 0.0])
            # a magnitude comes down to zero where the sign would change; what only ever lifts need not
            both_ways = len(way) > 20 and 0.2 < np.mean(way > 0) < 0.8
            if both_ways and known.min() < 0.05 * known.max():
                unsigned.append(name)
    if wrapped:
        value = min(wrapped.values())
        sentence = (
            f"the effort of {some(wrapped)} holds numbers from {value:.0f} to {highest:.0f}, as an unsigned register "
            f"of 16 bits does below zero ({value:.0f} is {value - 65536.0:.0f}): let the driver read it as signed"
        )
        yield Finding("unsigned_register", sentence, tuple(wrapped), wrapped)
    if unsigned:
        sentence = (
            f"the effort of {some(unsigned)} is never negative although it moves both ways: it may be a magnitude without "
            "its sign, of which no torque can be made"
        )
        yield Finding("effort_without_sign", sentence, tuple(unsigned))


def _stale(record: JointRecord, moved: Sequence[str]) -> Iterator[Finding]:
    """Efforts that are read more seldom than they are published."""
    if record.reported_effort is None:
        return
    times_s = _times_s(record)
    slow = {}
    for name in moved:
        column = record.column(name)
        effort = record.reported_effort[:, column]
        position = record.position[:, column]
        if not np.isfinite(effort).all() or np.ptp(effort) == 0.0:
            continue
        starts = np.flatnonzero(np.concatenate([[True], np.diff(effort) != 0.0]))
        ends = np.append(starts[1:], len(effort))
        # zero is a motor that is off; a controller at its limit repeats that, among many other values
        least = effort.min()
        most = effort.max()
        many = len(np.unique(effort)) > 20
        seen = [
            (end - start, len(np.unique(position[start:end])))
            for start, end in zip(starts, ends, strict=True)
            if effort[start] != 0.0 and not (many and effort[start] in (least, most))
        ]
        if len(seen) < FEW_LEVELS:  # an excitation's constant current, read without noise
            continue
        lengths, places = np.array(seen).T
        typical = int(np.sort(np.repeat(lengths, lengths))[lengths.sum() // 2])
        # as long as it moves on meanwhile
        if typical >= STALE_SAMPLES and places[lengths >= typical].mean() > 0.5 * STALE_SAMPLES:
            slow[name] = typical * float(np.median(np.diff(times_s)))
    if slow:
        sentence = (
            f"the effort of {some(slow)} stays the same for {_span(slow, '.2g')} s at a time while it moves, at "
            f"{1.0 / float(np.median(np.diff(times_s))):.0f} joint states a second: old readings are repeated"
        )
        yield Finding("effort_stale", sentence, tuple(slow), slow)


def _command_as_effort(recording: Recording) -> Iterator[Finding]:
    """An effort that is the command again, up to a factor and a delay of a cycle, says nothing of what flowed."""
    record = recording.joints
    inputs = recording.inputs
    if inputs is None or inputs.measured or record.reported_effort is None:
        return
    row = np.clip(
        np.searchsorted(inputs.times_ns, record.times_ns, side="right") - 1,
        0,
        None,
    )
    same = []
    for name in record.names:
        if name not in inputs.names:
            continue
        effort = record.reported_effort[:, record.column(name)]
        command = inputs.current_A[:, inputs.column(name)]
        if not np.isfinite(effort).all() or np.ptp(command) == 0.0 or len(np.unique(command)) < 10:
            continue
        for given in (command[row], command[np.clip(row - 1, 0, None)]):
            factor = float(given @ effort) / max(float(given @ given), 1e-300)
            if np.abs(effort - factor * given).max() < 1e-5 * np.abs(effort).max():
                same.append(name)
                break
    if same:
        sentence = (
            f"the effort of {some(same)} is the command again: it was not measured, and a motor follows its "
            "command late and not quite"
        )
        yield Finding("effort_is_command", sentence, tuple(same))


def gravity_torque(model: ReducedModel, position: FloatArray) -> FloatArray:
    """Torque at each revolute joint that holds the arm at positions [rad]; both of shape (T, n) [N m]."""
    motion = kinematics(model, position, np.zeros_like(position))
    torque = np.zeros_like(position)
    for body, pseudo in enumerate(model.pseudo_inertia):
        force = np.tensordot(body_parameters(pseudo), gravity_along(model, motion, body), 1)
        torque[:, carriers(model, body)] -= force.T
    return torque


def effort_per_torque(recording: Recording, robot: Robot) -> dict[str, float]:
    """Effort per N m that gravity needs, of every joint that moves enough against it, in the publisher's unit.

    Friction of either direction, inertia and an offset are fitted beside it, on means over `SMOOTHED_S`.
    """
    record = recording.joints
    slides = [joint.name for joint in robot.model.joints if joint.kind == "prismatic"]
    turning = [name for name in robot.model.independent_joints if name not in slides]
    # what is behind a joint that was not recorded would be somewhere else
    if record.reported_effort is None or not turning or not set(turning) <= set(record.names):
        return {}
    held = {
        name: float(record.position[:, record.column(name)].mean())
        for name in slides
        if name in record.names
    }
    model = robot.model.lock(
        turning,
        {**dict.fromkeys(slides, 0.0), **held},
        robot.gravity,
    )
    columns = [record.column(name) for name in model.joint_names]
    values = np.stack(
        [record.position[:, columns], record.reported_effort[:, columns]],
        axis=2,
    )
    known = np.isfinite(values).all(axis=(1, 2))
    if known.sum() < 50:
        return {}
    times_s, even = evenly(_times_s(record)[known], values[known])
    period_s = float(times_s[1] - times_s[0])
    width = max(1, round(SMOOTHED_S / period_s))
    count = len(times_s) // width
    if count < 20:
        return {}
    binned = even[: count * width].reshape(count, width, len(columns), 2).mean(axis=1)
    position = binned[:, :, 0]
    effort = binned[:, :, 1]
    step_s = width * period_s
    velocity = np.gradient(position, step_s, axis=0)
    acceleration = np.gradient(velocity, step_s, axis=0)
    torque = gravity_torque(model, position)
    found = {}
    moved = moving(record)
    for column, name in enumerate(model.joint_names):
        load = torque[:, column]
        speed = velocity[:, column]
        seen = effort[:, column]
        if name not in moved or np.ptp(seen) == 0.0:
            continue
        matrix = np.column_stack(
            [load, np.tanh(speed / 0.02), speed, acceleration[:, column], np.ones(count)]
        )
        size = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
        matrix /= size
        solution, _, rank, _ = np.linalg.lstsq(matrix, seen, rcond=1e-8)
        if rank < matrix.shape[1] or np.ptp(load) < LEAST_LOAD * np.ptp(torque, axis=0).max():
            continue
        residual = seen - matrix @ solution
        inverse = np.linalg.inv(matrix.T @ matrix)
        error = float(np.sqrt(residual @ residual / (count - matrix.shape[1]) * inverse[0, 0]))
        if abs(solution[0]) > LEAST_T * error:
            found[name] = float(solution[0] / size[0])
    return found


def effort_units(
    per_torque: Mapping[str, float], constants: Mapping[str, float], per_count_A: float
) -> tuple[EffortUnit, ...]:
    """How plausible each unit is that effort may be in, by `effort_per_torque`, torque constants [N m/A] and current per count."""
    result = []
    for unit in EFFORT_UNITS:
        ratio = dict(per_torque)
        if unit != "N.m":
            of_one_A = {name: value for name, value in per_torque.items() if name in constants}
            ratio = {
                name: value * (ampere(unit, per_count_A) * constants[name])
                for name, value in of_one_A.items()
            }
        if ratio:
            middle = float(np.median(list(ratio.values())))
            result.append(
                EffortUnit(
                    unit,
                    ratio,
                    PLAUSIBLE[0] <= middle <= PLAUSIBLE[1],
                )
            )
    return tuple(result)


def plausible_units(
    recording: Recording, robot: Robot, without: Collection[str] = ()
) -> tuple[dict[str, float], tuple[EffortUnit, ...]]:
    """How the effort compares with what gravity needs, in whatever unit it may be.

    Args:
        recording: With efforts.
        robot: Its URDF says what gravity needs, and its file the torque constants.
        without: Joints whose effort is of no use.

    Returns:
        Effort over what gravity needs, by joint, and how plausible units are by it.
    """
    try:
        per_torque = effort_per_torque(recording, robot)
    except RobotError:  # a body without mass, as of a robot whose file leaves that joint out
        return {}, ()
    per_torque = {name: value for name, value in per_torque.items() if name not in without}
    if not per_torque:
        return {}, ()
    stated = {} if is_description(str(robot.source)) else robot.drive_trains
    constants = {name: drive.torque_constant.value for name, drive in stated.items()}
    return per_torque, effort_units(per_torque, constants, CURRENT_PER_COUNT_A)
