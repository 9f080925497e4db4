"""Runs, robot and what the hand rigidly carries as a least-squares problem: whitened residuals and their exact Jacobian out.

The observation model: the encoder shows ``x(t - delay) + a cos x + b sin x``, the true position less the joint's zero and a
once-per-turn error of the encoder, plus rounding, noise and stamp jitter. A residual is weighted by
``sqrt(resolution^2 / 12 + noise^2 + (velocity x jitter)^2)``. All samples of the used window count, not only the last.

A run carries an unknown rigid load or a known one (nothing, a weighed reference), so one problem serves a weighing, a calibration,
and both together; probes add what else is in the hand. Whatever is unknown reaches the simulator through its eleven parameters
per run: with many unknowns the simulator's tangents are taken by those, and the chain rule does the rest.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.identification.locked_joints import Motion, held_motions, loads_of_yielding
from proprio_ros.identification.unknowns import Coordinates, Role, Unknown
from proprio_ros.kinds import KINDS, Key, Scope
from proprio_ros.quantity import Quantity
from proprio_ros.records import MEASURED_EFFORT, Run
from proprio_ros.robot import DriveTrain, ReducedModel, Robot
from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator
from proprio_ros.sim.mixed import MixedSimulator
from proprio_ros.sim.payload import (
    PayloadFacts,
    joint_coefficients,
    payload_parameters,
    payload_parameters_by_com,
    pseudo_inertia_basis,
)

PAYLOAD_TERMS = ("payload_mass", "payload_com_x", "payload_com_y", "payload_com_z", "shape_scale")
DRIVE_TERMS = ("torque_constant", "coulomb", "viscous", "load_friction", "armature", "stribeck", "stribeck_velocity")
"""Fields of a ``DriveTrain`` that are unknowns of the driven joint."""
SLOWEST_STRIBECK = 0.02
"""rad/s: a bump of friction narrower than this is over within a sample of any probe."""
RIPPLE_TERMS = ("ripple_cos", "ripple_sin")
"""The encoder's once-per-turn error: a magnet that sits off its axis adds ``a cos q + b sin q`` to the reading [rad]."""
LINK_TERMS = ("link_mass", "link_com_x", "link_com_y", "link_com_z", "link_inertia")
"""How a link may differ from the URDF: relative mass, shift of its centre of mass [m], relative inertia about it."""
REST_S = 0.2
"""Where a joint rests is determined from so much of what was recorded before the onset [s]."""
AWAY_READINGS = 4.0
"""Farther from there than this, in counts with their noise, it was still on its way."""
START_STD, START_VELOCITY_STD = 0.1, 2.0
"""How far off a free swing's first reading, and the slope of its first samples, may be: next to nothing is assumed [rad, rad/s]."""
SLOPE_S = 0.08
"""Over which that slope is taken [s]."""
FIRST_SWING_ERROR = 0.02
"""What is taken for the error of a simulated swing until the swing shows it [rad]."""
SLOW = 0.1
"""Below this speed the direction of a swing is not read off its samples for certain [rad/s]."""
NOT_IN_A_SWING = ("torque_constant", "delay")
"""Without a current, nothing depends on these."""
RISE = ("stribeck", "stribeck_velocity")
"""How dry friction rises towards standstill."""
KEPT_IN_A_SWING = ("zero", *RIPPLE_TERMS, *RISE)
"""Of the swinging joint, what stays where the file has it: its effect is the same in every swing of the joint, so that what is
learnt from the swings takes it in, while as unknowns they would bend to whatever friction no law follows. What another rise would
have made of the rest is in a calibration's covariance; the next swing of the joint, whose rise is the same, is fitted given it."""
COMMON_SHARE = 0.5
"""Of the variance of torque constants, what motors of one kind have in common before anything is learnt: a maker's number is off
for all of them, and each differs from it. If each erred on its own alone, several joints together would tell the arm's weight from
that number better than anybody knows it."""
MIN_SLOW = 3
"""Slow samples needed to relate reported effort to the command."""
_POSE_STEP = 1e-5  # rad or m, central difference over the pose of a held joint (numpy only, error about 1e-10)
_GRAVITY_ROWS = slice(0, 4)
_NEGLIGIBLE = 1e-9  # kg m^2 or N m: a link term that changes less than this at its prior is not worth an unknown


@dataclass(frozen=True)
class Coefficients:
    """Inertia and gravity load of the moving part as functions of the payload and of pose errors.

    Attributes:
        arm: without payload, shape (4,).
        payload: per payload parameter, shape (4, 10).
        pose: names of the held joints whose zero matters.
        arm_by_pose: shape (H, 4); payload_by_pose: shape (H, 4, 10): change per unit of the held joint's position.
        links: keys of the link unknowns that matter, e.g. ``("link_mass", "link4")``, length L.
        arm_by_link: change per unit of each, shape (L, 4).
    """

    arm: np.ndarray
    payload: np.ndarray
    pose: tuple[str, ...]
    arm_by_pose: np.ndarray
    payload_by_pose: np.ndarray
    links: tuple[tuple[str, str], ...]
    arm_by_link: np.ndarray


@dataclass(frozen=True)
class KnownLoad:
    """What the hand held in a run whose mass is stated; the default is nothing.

    Attributes:
        mass: [kg].
        facts: its place and shape.
    """

    mass: float = 0.0
    facts: PayloadFacts = field(default_factory=PayloadFacts)


@dataclass(frozen=True)
class PreparedRun:
    """A run as the fit uses it.

    Attributes:
        run: as recorded.
        used: number of leading samples inside the usable window.
        cut_reason: why later samples are left out, or an empty string.
        hit_limit: whether that is because the joint reached its limit.
        drive: drive train of the driven joint.
        coefficients: see ``Coefficients``.
        sigma: standard deviation of each used sample [rad or m], shape (used,).
        rest: start position from the samples before onset.
        limited: whether the supply may limit the current inside the window, as far as the recording says.
        load: what the hand is known to hold; None means the payload to be weighed.
        yielding: names of held joints that gave way; yielding_times_s, yielding_load: see ``loads_of_yielding``. In a free swing it
            is the load that each kilogram's weight puts on the gears, with the sign of the velocity, see ``_weight_on_gears``.
        arm_as_payload: payload that would load the gears as the arm does [kg]; only known of free swings.
    """

    run: Run
    used: int
    cut_reason: str
    hit_limit: bool
    drive: DriveTrain
    coefficients: Coefficients
    sigma: np.ndarray
    rest: Quantity
    limited: bool
    load: KnownLoad | None = None
    yielding: tuple[str, ...] = ()
    yielding_times_s: np.ndarray | None = None
    yielding_load: np.ndarray | None = None
    arm_as_payload: float = 0.0

    @property
    def times_s(self) -> np.ndarray:
        return self.run.times_s[: self.used]

    @property
    def position(self) -> np.ndarray:
        return self.run.position[: self.used]

    @property
    def start_velocity(self) -> float:
        """Slope of the first samples [rad/s]: with what a free swing about begins."""
        first = max(int(np.searchsorted(self.times_s, SLOPE_S)), 3)
        return float(np.polyfit(self.times_s[:first], self.position[:first], 1)[0])

    @property
    def travel(self) -> float:
        """Signed largest excursion from rest, or from the start of a free swing, inside the used window."""
        excursion = self.position - self.rest.value
        return float(excursion[np.argmax(np.abs(excursion))])


def reduced_model(robot: Robot, run: Run, shift: Mapping[str, float]) -> ReducedModel:
    """The robot with every joint locked but the driven one; ``shift`` displaces held joints [rad or m]."""
    held = {name: position + shift.get(name, 0.0) for name, position in run.held.items()}
    return robot.model.lock([run.joint], held, robot.gravity)


def _coefficients(robot: Robot, run: Run, shift: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    model = reduced_model(robot, run, shift)
    body, body_from_payload = model.frames[robot.payload_frame]
    axis, gravity = axis_and_gravity(model)
    arm = joint_coefficients(model.pseudo_inertia[0], model.kinds[0], axis, gravity)
    if body != 0:  # the joint does not carry the hand
        return arm, np.zeros((4, 10))
    moved = body_from_payload @ pseudo_inertia_basis() @ body_from_payload.T
    return arm, joint_coefficients(moved, model.kinds[0], axis, gravity).T


def axis_and_gravity(model: ReducedModel) -> tuple[np.ndarray, np.ndarray]:
    """Axis of the driven joint, and gravity [m/s^2] where it is at zero, both in its own frame; shapes (3,)."""
    return model.axes[0], model.placement[0][:3, :3].T @ model.gravity


def _link_coefficients(robot: Robot, run: Run) -> tuple[tuple[tuple[str, str], ...], np.ndarray]:
    """What each link's deviations from the URDF add to the moving part (see ``LINK_TERMS``), where that is noticeable."""
    model = reduced_model(robot, run, {})
    axis, gravity = axis_and_gravity(model)
    stds = _link_stds(robot)
    keys: list[tuple[str, str]] = []
    rows: list[np.ndarray] = []
    for link in robot.model.links:
        body, body_from_link = model.frames[link.name]
        mass = float(link.pseudo_inertia[3, 3])
        if body != 0 or mass == 0.0:
            continue
        com = link.pseudo_inertia[:3, 3] / mass
        central = np.zeros((4, 4))
        central[:3, :3] = link.pseudo_inertia[:3, :3] - mass * np.outer(com, com)
        changes = [link.pseudo_inertia]
        for direction in np.eye(3):
            shifted = np.zeros((4, 4))
            shifted[:3, :3] = mass * (np.outer(com, direction) + np.outer(direction, com))
            shifted[:3, 3] = shifted[3, :3] = mass * direction
            changes.append(shifted)
        moved = body_from_link @ np.array([*changes, central]) @ body_from_link.T
        for term, std, row in zip(
            LINK_TERMS, stds, joint_coefficients(moved, model.kinds[0], axis, gravity), strict=True
        ):
            if np.abs(row).max() * std > _NEGLIGIBLE:
                keys.append((term, link.name))
                rows.append(row)
    return tuple(keys), np.array(rows).reshape(-1, 4)


def _link_stds(robot: Robot) -> tuple[float, ...]:
    return (robot.link_mass_std, *[robot.link_com_std] * 3, robot.link_inertia_std)


def _arm_coefficients(robot: Robot, run: Run, held: Sequence[str]) -> Coefficients:
    arm, payload = _coefficients(robot, run, {})
    arm_by_pose, payload_by_pose = np.zeros((len(held), 4)), np.zeros((len(held), 4, 10))
    for row, name in enumerate(held):
        up, down = (_coefficients(robot, run, {name: sign * _POSE_STEP}) for sign in (1.0, -1.0))
        arm_by_pose[row] = (up[0] - down[0]) / (2.0 * _POSE_STEP)
        payload_by_pose[row] = (up[1] - down[1]) / (2.0 * _POSE_STEP)
    matters = np.abs(arm_by_pose).max(axis=1) > 1e-6
    return Coefficients(
        arm,
        payload,
        tuple(n for n, m in zip(held, matters, strict=True) if m),
        arm_by_pose[matters],
        payload_by_pose[matters],
        *_link_coefficients(robot, run),
    )


def _slide_coefficients(robot: Robot, run: Run) -> Coefficients:
    """Everything that a motor moves along slides, as it seems at the motor's shaft: fingers, and those that mimic them.

    A finger weighs three thousand times less there than the rotor, so neither poses nor link deviations matter.
    """
    per_rad = robot.drive_trains[run.joint].transmission
    positions = {**run.held, run.joint: float(run.position[0])}
    mass, load = 0.0, 0.0
    for link in robot.model.links:
        weight = float(link.pseudo_inertia[3, 3])
        if weight > 0.0:
            ends = [
                robot.model.frame_transform(link.name, {**positions, run.joint: positions[run.joint] + sign * 0.5})
                for sign in (-1.0, 1.0)
            ]
            velocity = (ends[1] - ends[0])[:3, 3]
            mass += weight * float(velocity @ velocity)
            load -= weight * float(velocity @ robot.gravity)
    arm = np.array([mass * per_rad**2, 0.0, 0.0, load * per_rad])
    empty = np.zeros((0, 4))
    return Coefficients(arm, np.zeros((4, 10)), (), empty, np.zeros((0, 4, 10)), (), empty)


def joints_of(runs: Sequence[PreparedRun]) -> tuple[str, ...]:
    """The joints that runs drive, each once."""
    return tuple(dict.fromkeys(run.run.joint for run in runs))


def at_the_shaft(robot: Robot, run: Run) -> Run:
    """The same run as the motor's shaft sees it [rad]: what a slide's positions are divided by its transmission."""
    drive = robot.drive_trains.get(run.joint)
    if drive is None or drive.transmission == 1.0:
        return run
    return replace(
        run,
        position=run.position / drive.transmission,
        before_position=run.before_position / drive.transmission,
        after_position=run.after_position / drive.transmission,
    )


def prepare_run(
    robot: Robot, run: Run, load: KnownLoad | None = None, facts: PayloadFacts | None = None, past_fast: bool = False
) -> PreparedRun:
    """Choose the usable window, weigh the samples, and reduce the robot to the driven joint.

    Args:
        robot: of the recording.
        run: as recorded.
        load: what the hand is known to hold; None means the payload to be weighed.
        facts: where the payload sits, for what yielding joints do with it; default at the payload frame.
        past_fast: whether samples count from where the joint runs so fast that the supply may limit the current. That is then
            simulated with the supply's nominal numbers: for motions that are fast for a moment and informative mostly after it.

    Raises:
        RecordingError: a joint the robot has is missing from the recording, the driven joint has no drive train, or the load to
            be weighed does not move with it.
    """
    if run.joint not in robot.drive_trains:
        known = ", ".join(robot.drive_trains)
        raise RecordingError(
            f"{run.name}: {run.joint} was driven, but {robot.name} has no drive train for it (it has: {known})"
        )
    missing = [j for j in robot.model.independent_joints if j != run.joint and j not in run.held]
    if missing:
        raise RecordingError(
            f"{run.name}: no position of {', '.join(missing)} in the recording; state it with --set held.{missing[0]}=VALUE"
        )
    drive = robot.drive_trains[run.joint]
    joint = robot.model.joint(run.joint)
    motions: dict[str, Motion] = {}
    if joint.kind == "prismatic":
        coefficients = _slide_coefficients(robot, run)
    else:
        others = [n for n in robot.model.independent_joints if n != run.joint]
        coefficients = _arm_coefficients(robot, run, others)
        motions = {} if run.free else held_motions(robot, run, coefficients.pose)
        if motions:
            starts = {name: motion.start for name, motion in motions.items()}
            run = replace(run, held={**run.held, **starts})
            coefficients = _arm_coefficients(robot, run, others)
    if (load is None or load.mass > 0.0) and not coefficients.payload.any():
        raise RecordingError(
            f"{run.name}: {run.joint} was driven but does not move {robot.payload_frame}: probe a joint between the base and it"
        )
    run = at_the_shaft(robot, run)
    velocity = np.gradient(run.position, run.times_s)
    followed = _followed(run, velocity, drive)
    lower, upper = joint.lower / drive.transmission, joint.upper / drive.transmission
    counted = np.ones_like(followed) if past_fast or run.free else followed
    used, reason, hit_limit = _usable_window(run, velocity, counted, drive, lower, upper)
    reading = robot.residual_scale * float(np.hypot(drive.encoder_resolution / np.sqrt(12.0), drive.encoder_noise))
    jitter = robot.stamp_jitter_s
    if robot.calibration is None:
        # random errors of the stamps show in their intervals, sqrt(2) times; stamps like clockwork have none. What a calibration
        # learnt from residuals holds as it is: whatever makes them grow with speed is in it, and not in the intervals.
        jitter = min(jitter, float(np.std(np.diff(run.times_s))) / np.sqrt(2.0))
    sigma = np.hypot(reading, velocity[:used] * jitter)
    if run.free:
        sigma = np.hypot(sigma, robot.swing_error or FIRST_SWING_ERROR)
    resting = _at_rest(run, drive)
    if run.free:
        rest = Quantity(float(run.position[0]), START_STD)
    elif len(resting):
        # at rest the rounding error repeats, so only the noise averages out
        noise = drive.encoder_noise / np.sqrt(len(resting))
        rest = Quantity(float(np.mean(resting)), float(np.hypot(drive.encoder_resolution / np.sqrt(12.0), noise)))
    else:
        rest = Quantity(float(run.position[0]), 3.0 * reading)
    yielding_times_s = yielding_load = None
    if motions:
        noise = float(np.hypot(drive.encoder_resolution / np.sqrt(12.0), drive.encoder_noise))
        where = load.facts if load is not None else facts or PayloadFacts()
        yielding_times_s, yielding_load = loads_of_yielding(robot, run, motions, where, noise)
    arm_as_payload = 0.0
    if run.free and coefficients.payload.any():
        facts_of_it = load.facts if load is not None and load.mass > 0.0 else facts or PayloadFacts()
        arm_as_payload, per_kg = _weight_on_gears(run, coefficients, facts_of_it)
        yielding_times_s, yielding_load = run.times_s, np.stack([np.zeros_like(per_kg), per_kg], axis=1)
    return PreparedRun(
        run,
        used,
        reason,
        hit_limit,
        drive,
        coefficients,
        sigma,
        rest,
        limited=not run.free and not followed[1:used].all(),
        load=load,
        yielding=tuple(motions),
        yielding_times_s=yielding_times_s,
        yielding_load=yielding_load,
        arm_as_payload=arm_as_payload,
    )


def _weight_on_gears(run: Run, coefficients: Coefficients, facts: PayloadFacts) -> tuple[float, np.ndarray]:
    """What friction that grows with the load acts on in a free swing.

    With no current the gears carry the weight, and lose part of it in the direction of motion. Where the joint is and which way it
    goes is read off the recording, so that this friction is a known load times one unknown.

    Returns:
        the payload [kg] that weighs on the joint as the arm does, and the size of the moment of 1 kg with the sign of the
        velocity at each sample [N m/kg], shape (K,).
    """
    per_mass = payload_parameters(np.ones(1), facts.com[None], facts.shape.second_moment_per_mass)[0]
    _, cos, sin, constant = coefficients.payload @ per_mass
    arm = float(np.hypot(coefficients.arm[1], coefficients.arm[2]))
    width = max(round(SLOPE_S / float(np.median(np.diff(run.times_s)))) | 1, 3)
    smooth = np.convolve(np.pad(run.position, width // 2, mode="edge"), np.full(width, 1.0 / width), "valid")
    side = np.tanh(np.gradient(smooth, run.times_s) / SLOW)
    moment = np.abs(cos * np.cos(run.position) + sin * np.sin(run.position) + constant)
    return arm / max(float(np.hypot(cos, sin)), 1e-12), moment * side


def _followed(run: Run, velocity: np.ndarray, drive: DriveTrain) -> np.ndarray:
    """At which samples the motor reported the commanded current, shape (K,); False where nothing was reported.

    The reported effort is compared with the command in its own unit: what the two have to do with each other is read off the
    slow samples, where the supply limits nothing.
    """
    blind = np.zeros(len(run.times_s), dtype=bool)
    if run.reported_effort is None:
        return blind
    command = run.input_current_A[np.searchsorted(run.input_times_s, run.times_s, side="left").clip(1) - 1]
    slow = (np.abs(velocity) < 0.5 * drive.usable_velocity) & (command != 0.0) & np.isfinite(run.reported_effort)
    slow &= run.times_s > run.times_s[0]  # the first report may be older than the command
    if slow.sum() < MIN_SLOW or np.median(run.reported_effort[slow] / command[slow]) <= 0.0:
        return blind
    unit = float(np.median(run.reported_effort[slow] / command[slow]))
    off = np.abs(run.reported_effort / unit - command)
    noise = 1.4826 * float(np.median(off[slow]))
    return off <= np.maximum(0.05 * np.abs(command), 4.0 * noise)


def _at_rest(run: Run, drive: DriveTrain) -> np.ndarray:
    """Positions before the onset from where the joint had come to rest; all of them where it had not.

    A recording holds up to a second of what was before, and a probe may settle for less after its way there.
    """
    position = run.before_position
    last = position[run.before_times_s >= -REST_S]
    if len(last) == 0:
        return position
    off = np.abs(position - np.median(last)) > AWAY_READINGS * float(
        np.hypot(drive.encoder_resolution, drive.encoder_noise)
    )
    if off[-len(last) :].any() or not off.any():
        return position
    return position[np.flatnonzero(off)[-1] + 1 :]


def _usable_window(
    run: Run, velocity: np.ndarray, followed: np.ndarray, drive: DriveTrain, lower: float, upper: float
) -> tuple[int, str, bool]:
    """Samples before the joint meets its limit, or runs so fast that the supply may no longer drive the current.

    A fast sample still counts while the motor itself reports the commanded current. Returns how many samples are usable, why no
    more, and whether the limit is the reason.
    """
    count = len(run.times_s)
    # how close to the limit a reading is no longer certain to be short of it
    margin = 3.0 * float(np.hypot(drive.zero.std, drive.encoder_resolution))
    before = np.concatenate([[run.position[0]], run.position[:-1]])
    step = np.diff(run.position, prepend=run.position[0])
    # where the sample would be at the speed of the last interval: an impact may hide between two samples
    expected = before + np.concatenate([[0.0], step[:-1]])
    furthest, nearest = np.maximum(run.position, expected), np.minimum(run.position, expected)
    beyond = (furthest > upper - margin) | (nearest < lower + margin)
    # a joint that starts at a limit and leaves it is free to move
    stopped = np.flatnonzero(beyond & (np.abs(run.position - run.position[0]) > margin))
    fast = np.flatnonzero((np.abs(velocity) > drive.usable_velocity) & ~followed)
    limit = int(stopped[0]) if len(stopped) else count
    speed = int(fast[0]) if len(fast) else count
    if limit < count and limit <= speed:
        return limit, f"{run.joint} reached its limit {run.times_s[limit]:.3f} s after the start", True
    if speed < count:
        why = (
            "the supply may no longer drive the commanded current"
            if run.reported_effort is None
            else "the motor did not report the commanded current"
        )
        reason = (
            f"{run.joint} passed {drive.usable_velocity:g} rad/s {run.times_s[speed]:.3f} s after the start and {why}"
        )
        return speed, reason, False
    return count, "", False


def load_unknowns(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, drive_role: Role, start_mass_kg: float
) -> list[Unknown]:
    """All unknowns of a weighing: the payload, what is open about the robot, and each run's start.

    Args:
        robot: of the runs.
        runs: weighed together.
        facts: what is stated about the payload.
        drive_role: ``FROZEN`` keeps the robot at its file's values, ``FREE`` lets the recording move them under their priors.
        start_mass_kg: the payload's, from which a fit starts [kg].
    """
    unknowns = [Unknown("payload_mass", start_mass_kg, np.inf, -0.5, 20.0, asinh_scale=0.005)]
    for axis, name in enumerate("xyz"):
        spread = float(facts.com_std[axis])
        unknowns.append(Unknown(f"payload_com_{name}", float(facts.com[axis]), spread, -1.0, 1.0).at_role(Role.FREE))
    unknowns.append(Unknown("shape_scale", 1.0, facts.shape_std_relative, 0.0, 10.0).at_role(drive_role))
    return [*unknowns, *robot_unknowns(robot, runs, drive_role)]


def robot_unknowns(robot: Robot, runs: Sequence[PreparedRun], drive_role: Role) -> list[Unknown]:
    """What is open about the robot in these runs, shared and of each run on its own.

    Values and standard deviations are those of the robot file, or of its calibration where that knows an unknown.
    """
    shared = [
        _from_quantity("arm_scale", None, robot.arm_scale, lower=0.1),
        _from_quantity("delay", None, robot.delay, lower=-0.1, upper=0.1),
    ]
    for name in joints_of(runs):
        drive = robot.drive_trains[name]
        for kind in DRIVE_TERMS:
            lower = SLOWEST_STRIBECK if kind == "stribeck_velocity" else 0.0
            shared.append(_from_quantity(kind, name, getattr(drive, kind), lower=lower))
    for name in dict.fromkeys(name for run in runs for name in (run.run.joint, *run.coefficients.pose)):
        moved = robot.drive_trains.get(name)
        if moved is not None and moved.transmission == 1.0:
            # a held joint's reading is rounded the same way in every sample
            std = float(np.hypot(moved.zero.std, moved.encoder_resolution / np.sqrt(12.0)))
            shared.append(_from_quantity("zero", name, Quantity(moved.zero.value, std)))
            for kind in RIPPLE_TERMS:
                shared.append(_from_quantity(kind, name, Quantity(0.0, moved.encoder_once_per_turn)))
    stds = dict(zip(LINK_TERMS, _link_stds(robot), strict=True))
    for kind, link in dict.fromkeys(key for run in runs for key in run.coefficients.links):
        shared.append(_from_quantity(kind, link, Quantity(0.0, stds[kind])))
    known = {} if robot.calibration is None else robot.calibration.quantities
    unknowns = [
        _from_quantity(u.kind, u.scope, known[u.key], u.lower, u.upper) if u.key in known else u for u in shared
    ]
    unknowns = [u.at_role(drive_role) for u in unknowns]
    for row, run in enumerate(runs):
        unknowns.append(Unknown("q0", run.rest.value, run.rest.std, scope=row))
        if run.run.free:
            unknowns.append(Unknown("v0", run.start_velocity, START_VELOCITY_STD, scope=row))
            change = Unknown("friction_change", 0.0, robot.friction_spread, -0.9, scope=row)
            unknowns.append(change.at_role(drive_role))
        else:
            unknowns.append(Unknown("v0", 0.0, robot.start_velocity, scope=row))
        unknowns.append(Unknown("onset", 0.0, onset_std(robot, run), -0.1, 0.1, scope=row).at_role(drive_role))
        # a swing's friction differs, not a torque that pushes one way: that would take the place of the weight
        disturbance = 0.0 if run.run.free else robot.torque_disturbance
        unknowns.append(Unknown("disturbance", 0.0, disturbance, scope=row).at_role(drive_role))
    return unknowns


def onset_std(robot: Robot, run: PreparedRun) -> float:
    """How the delay differs from run to run; where the input is measured effort, its onset is only known to one period."""
    if run.run.free:  # no command begins it
        return 0.0
    period = float(np.median(np.diff(run.run.times_s))) if run.run.source == MEASURED_EFFORT else 0.0
    return float(np.hypot(robot.onset_jitter_s, period / 2.0))


def _from_quantity(
    kind: str, scope: Scope, quantity: Quantity, lower: float = -np.inf, upper: float = np.inf
) -> Unknown:
    return Unknown(kind, float(np.clip(quantity.value, lower, upper)), quantity.std, lower, upper, scope=scope)


def _of_one_kind(robot: Robot, free: Sequence[Unknown]) -> tuple[list[Key], np.ndarray]:
    """Keys and prior covariance of the torque constants among some unknowns; motors of one kind err together in part."""
    constants = [unknown for unknown in free if unknown.kind == "torque_constant"]
    kinds = [robot.drive_trains[str(unknown.scope)].nominal_effort_per_current for unknown in constants]
    std = np.array([unknown.std for unknown in constants])
    alike = np.array([[one == other for other in kinds] for one in kinds], dtype=float).reshape(len(std), len(std))
    shares = COMMON_SHARE * alike + (1.0 - COMMON_SHARE) * np.eye(len(std))
    return [unknown.key for unknown in constants], shares * np.outer(std, std)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


class Problem:
    """The whitened residuals of all runs as a function of the unknowns, for many guesses at once.

    Args:
        robot: its supply, friction smoothing and jitter.
        runs: prepared runs, sharing the payload and the drive trains.
        facts: what is stated about the payload.
        unknowns: from ``load_unknowns``, or ``robot_unknowns`` where every run's load is known.
        integrator: ``"rk4"`` or ``"semi_implicit"``.
        step_s: longest integration step; default 1/240 s.
    """

    def __init__(
        self,
        robot: Robot,
        runs: Sequence[PreparedRun],
        facts: PayloadFacts,
        unknowns: Sequence[Unknown],
        integrator: str = "rk4",
        step_s: float = 1.0 / 240.0,
    ) -> None:
        self.robot = robot
        self.runs = tuple(runs)
        self.facts = facts
        self.unknowns = tuple(unknowns)
        self.index: dict[Key, int] = {u.key: row for row, u in enumerate(unknowns)}
        self.free = np.array([row for row, u in enumerate(unknowns) if u.role is Role.FREE])
        calibration = robot.calibration
        if calibration is not None and calibration.swing_error > 0.0:
            calibration = calibration.given({(kind, run.run.joint) for run in runs if run.run.free for kind in RISE})
        free = [unknowns[row] for row in self.free]
        belong = _of_one_kind(robot, free) if calibration is None else (calibration.keys, calibration.covariance)
        self.coordinates = Coordinates(free, belong)
        self.base = np.array([u.value for u in unknowns])
        self.simulator = self._simulator([self._joint_run(run, step_s) for run in runs], integrator)
        width = int(self.simulator.sample_counts.max())
        self.measured = np.zeros((len(runs), width))
        self.weight = np.zeros((len(runs), width))
        for row, run in enumerate(runs):
            self.measured[row, : run.used] = run.position
            self.weight[row, : run.used] = 1.0 / run.sigma
        # which parameters depend on the unknowns non-linearly: then the tangents must follow the guess
        bent = {*PAYLOAD_TERMS[1:], "zero", "arm_scale", *RIPPLE_TERMS, "friction_change"}
        kinds = {u.kind for u in free}
        self._affine = kinds.isdisjoint(bent) and not kinds.issuperset({"torque_constant", "disturbance"})
        self._ripple = [
            (-1, -1) if run.run.free else tuple(self.index.get((kind, run.run.joint), -1) for kind in RIPPLE_TERMS)
            for run in self.runs
        ]
        self._ripples = not kinds.isdisjoint(RIPPLE_TERMS) or any(
            self.base[row] != 0.0 for pair in self._ripple for row in pair if row >= 0
        )
        self._affine_maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._world_runs: dict[int, np.ndarray] = {}
        self._identities: dict[int, np.ndarray] = {}

    @functools.cached_property
    def _touching(self) -> list[np.ndarray]:
        """Which free unknowns can change anything in each run; a problem that is only looked ahead with does without."""
        free = [self.unknowns[row] for row in self.free]
        return [np.flatnonzero([self._touches(u, row) for u in free]) for row in range(len(self.runs))]

    def _simulator(self, runs: list[JointRun], integrator: str) -> JointSimulator | MixedSimulator[Any]:
        return JointSimulator(runs, integrator)

    def _touches(self, unknown: Unknown, row: int) -> bool:
        """Whether an unknown can change anything in a run: its joints, its links, its own start, and what all share."""
        run, owner = self.runs[row], unknown.scope
        if unknown.kind in PAYLOAD_TERMS:
            return run.load is None
        kept = unknown.kind in KEPT_IN_A_SWING and owner == run.run.joint
        if run.run.free and (kept or unknown.kind in NOT_IN_A_SWING):
            return False
        match KINDS[unknown.kind].of:
            case "run":
                return owner == row
            case "joint":
                return owner == run.run.joint or owner in run.coefficients.pose
            case "link":
                return unknown.key in run.coefficients.links
        return True

    def _joint_run(self, run: PreparedRun, step_s: float) -> JointRun:
        drive = run.drive
        motor = float(np.abs(run.run.input_current_A).max()) * drive.torque_constant.value
        friction = self._reach(("coulomb", run.run.joint)) + self._reach(("load_friction", run.run.joint)) * motor
        friction *= 1.0 + self.unknowns[self.index["stribeck", run.run.joint]].value
        # near standstill Coulomb's law turns over within friction_velocity: the step must resolve v_s J / f_c
        lightest = float(run.coefficients.arm[0]) + 0.5 * drive.armature.value
        fine = self.robot.friction_velocity * lightest / friction if friction > 0.0 else step_s
        input_times_s, input_current_A, input_load = self._inputs(run)
        return JointRun(
            run.times_s,
            input_times_s,
            input_current_A,
            # where the motor reported the commanded current throughout, no nominal supply may overrule it
            (drive.supply_voltage_V if run.limited else 0.0, drive.back_emf_V_s_per_rad, drive.resistance_ohm),
            self.robot.friction_velocity,
            step_s,
            float(np.clip(fine, 5e-5, step_s)),
            input_load,
        )

    def _inputs(self, run: PreparedRun) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Current, and the load of yielding joints: stamped when they were read, so it is earlier by the delay."""
        times_s, current_A = run.run.input_times_s, run.run.input_current_A
        if run.yielding_times_s is None or run.yielding_load is None:
            return times_s, current_A, None
        begins = run.yielding_times_s - self.robot.delay.value
        begins[0] = min(begins[0], 0.0)
        union = np.union1d(times_s, begins[begins > 0.0])
        current = current_A[np.searchsorted(times_s, union, side="right") - 1]
        return union, current, run.yielding_load[np.searchsorted(begins, union, side="right") - 1]

    def _reach(self, key: Key) -> float:
        """How large an unknown may get during the fit: its value, and two standard deviations more where it moves."""
        unknown = self.unknowns[self.index[key]]
        return unknown.value + (2.0 * unknown.std if unknown.role is Role.FREE else 0.0)

    def parameters(self, values: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulator parameters of every guess and run, and their derivative by chosen unknowns.

        Args:
            values: all unknowns of each guess, shape (S, N).
            columns: which unknowns to differentiate by, shape (F,).

        Returns:
            p (S, R, P) and dp (S, R, P, F).
        """
        p, dp = self._all_parameters(values)
        return p, dp[..., columns]

    def _all_parameters(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As ``parameters``, by every unknown."""
        guesses, width = len(values), len(self.simulator.parameters)
        p = np.zeros((guesses, len(self.runs), width))
        dp = np.zeros((guesses, len(self.runs), width, len(self.unknowns)))
        at = self.index
        payload = self._payload(values) if "payload_mass" in at else None
        arm_scale = values[:, at["arm_scale"]]
        for row, run in enumerate(self.runs):
            c = run.coefficients
            joint = run.run.joint
            arm, lever = np.tile(c.arm, (guesses, 1)), np.tile(c.payload, (guesses, 1, 1))
            shifts = [self._shift(name, run.run.held[name], values) for name in c.pose]
            for h, (shift, _) in enumerate(shifts):
                # the joint stands at its reading plus its zero, less the encoder's error
                arm = arm + shift[:, None] * c.arm_by_pose[h]
                lever = lever + shift[:, None, None] * c.payload_by_pose[h]
            g = arm_scale[:, None] * arm
            d = np.zeros((guesses, 4, len(self.unknowns)))
            d[:, :, at["arm_scale"]] = arm
            links = [at[key] for key in c.links]
            g += values[:, links] @ c.arm_by_link
            d[:, :, links] += c.arm_by_link.T
            if run.load is None:
                assert payload is not None
                carried, by_unknown = payload
                for column, change in by_unknown.items():
                    d[:, :, column] = np.einsum("sij,sj->si", lever, change)
            else:
                carried = np.tile(_inertial_parameters(run.load), (guesses, 1))
            g += np.einsum("sij,sj->si", lever, carried)
            for h, (_, by_zero) in enumerate(shifts):
                change = arm_scale[:, None] * c.arm_by_pose[h] + carried @ c.payload_by_pose[h].T
                for column, factor in by_zero:
                    d[:, :, column] += factor * change
            zero_row = at.get(("zero", joint))
            if zero_row is not None:
                z = np.full(guesses, self.base[zero_row]) if run.run.free else values[:, zero_row]
                cos, sin = np.cos(z), np.sin(z)
                ga, gb = g[:, 1].copy(), g[:, 2].copy()
                da, db = d[:, 1].copy(), d[:, 2].copy()
                g[:, 1], g[:, 2] = ga * cos + gb * sin, gb * cos - ga * sin
                d[:, 1] = da * cos[:, None] + db * sin[:, None]
                d[:, 2] = db * cos[:, None] - da * sin[:, None]
                if not run.run.free:
                    d[:, 1, zero_row] += g[:, 2]
                    d[:, 2, zero_row] -= g[:, 1]
            p[:, row, _GRAVITY_ROWS] = g
            dp[:, row, _GRAVITY_ROWS] = d
            direct: dict[Key, tuple[str, float]] = {
                (kind, joint): (kind, 1.0) for kind in DRIVE_TERMS if kind != "armature"
            }
            direct |= {
                ("armature", joint): ("inertia", 1.0),
                "delay": ("delay", 1.0),
                ("onset", row): ("delay", 1.0),
                ("q0", row): ("q0", 1.0),
                ("v0", row): ("v0", 1.0),
            }
            if run.run.free:
                for kind in RISE:
                    p[:, row, INDEX[kind]] = self.base[at[kind, joint]]
                left_out = (*NOT_IN_A_SWING, *KEPT_IN_A_SWING)
                direct = {key: to for key, to in direct.items() if to[0] not in left_out}
            for key, (parameter, sign) in direct.items():
                p[:, row, INDEX[parameter]] += sign * values[:, at[key]]
                dp[:, row, INDEX[parameter], at[key]] = sign
            self._disturb(row, p, dp, values)
            if run.run.free:
                self._change_friction(row, p, dp, values)
            elif run.load is None:
                p[:, row, INDEX["carried"]] = values[:, at["payload_mass"]]
                dp[:, row, INDEX["carried"], at["payload_mass"]] = 1.0
            else:
                p[:, row, INDEX["carried"]] = run.load.mass
            self._start_reading(row, p, dp, values)
        return p, dp

    def _disturb(self, row: int, p: np.ndarray, dp: np.ndarray, values: np.ndarray) -> None:
        """The torque that only this run has is stated at the torque constant that was known before, and goes with what it is.

        Motion tells torques only relative to each other. If this one were a number of its own, every run would pull all of them
        together (torque constants, the arm's weight) to lower values, where its own is more probable: half of the gradient of the
        logarithm of its variance, which the most probable values of all unknowns leave out, is missing then (MacKay 1999, Neural
        Computation 11, 1035). Sixty empty-hand runs so made everything 2 % lighter.
        """
        run, at = self.runs[row], self.index
        constant, disturbance = at["torque_constant", run.run.joint], at["disturbance", row]
        stated = run.drive.torque_constant.value
        factor = values[:, constant] / stated
        to = INDEX["gravity_constant"]
        p[:, row, to] -= factor * values[:, disturbance]
        dp[:, row, to, disturbance] = -factor
        dp[:, row, to, constant] -= values[:, disturbance] / stated

    def _change_friction(self, row: int, p: np.ndarray, dp: np.ndarray, values: np.ndarray) -> None:
        """Warm gears, fresh grease: all friction of a swing is the joint's times the same factor.

        The gears carry no motor's torque but the weight, and lose the same part of it; ``carried`` is what they lose per moment
        of a kilogram.
        """
        at, joint = self.index, self.runs[row].run.joint
        change = at["friction_change", row]
        factor = 1.0 + values[:, change]
        for kind in ("coulomb", "viscous"):
            p[:, row, INDEX[kind]] *= factor
            dp[:, row, INDEX[kind], at[kind, joint]] = factor
            dp[:, row, INDEX[kind], change] = values[:, at[kind, joint]]
        run, load_friction = self.runs[row], at["load_friction", joint]
        mass = run.arm_as_payload + (values[:, at["payload_mass"]] if run.load is None else run.load.mass)
        lost, carried = values[:, load_friction], INDEX["carried"]
        p[:, row, carried] = factor * lost * mass
        dp[:, row, carried, load_friction] = factor * mass
        dp[:, row, carried, change] = lost * mass
        if run.load is None:
            dp[:, row, carried, at["payload_mass"]] = factor * lost

    def _payload(self, values: np.ndarray) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Inertial parameters of the payload, shape (S, 10), and their derivative by each of its unknowns."""
        at = self.index
        guesses = len(values)
        mass = values[:, at["payload_mass"]]
        com = values[:, [at[f"payload_com_{axis}"] for axis in "xyz"]]
        scale = values[:, at["shape_scale"]]
        spread = self.facts.shape.second_moment_per_mass
        per_spread = payload_parameters(np.ones(guesses), np.zeros((guesses, 3)), spread)
        per_spread[:, 0] = 0.0
        per_mass = payload_parameters(np.ones(guesses), com, np.zeros((3, 3))) + scale[:, None] * per_spread
        by_com = payload_parameters_by_com(mass, com)
        changes = {at["payload_mass"]: per_mass, at["shape_scale"]: mass[:, None] * per_spread}
        changes |= {at[f"payload_com_{name}"]: by_com[:, :, axis] for axis, name in enumerate("xyz")}
        return mass[:, None] * per_mass, changes

    def _shift(self, name: str, reading: float, values: np.ndarray) -> tuple[np.ndarray, list[tuple[int, float]]]:
        """True position less reading of a held joint, shape (S,), and what it changes with."""
        terms = [("zero", 1.0), ("ripple_cos", -np.cos(reading)), ("ripple_sin", -np.sin(reading))]
        present = [(self.index[kind, name], float(factor)) for kind, factor in terms if (kind, name) in self.index]
        return sum((values[:, row] * factor for row, factor in present), np.zeros(len(values))), present

    def _start_reading(self, row: int, p: np.ndarray, dp: np.ndarray, values: np.ndarray) -> None:
        """``q0`` is what the encoder shows at the start; the simulator wants it without the encoder's error."""
        cos_row, sin_row = self._ripple[row]
        if not self._ripples or cos_row < 0:
            return
        a, b = values[:, cos_row], values[:, sin_row]
        start = INDEX["q0"]
        q = p[:, row, start].copy()
        cos, sin = np.cos(q), np.sin(q)
        p[:, row, start] = q - a * cos - b * sin
        dp[:, row, start, self.index["q0", row]] = 1.0 + a * sin - b * cos
        dp[:, row, start, cos_row] = -cos
        dp[:, row, start, sin_row] = -sin

    def _observe(
        self, row: int, values: np.ndarray, q: np.ndarray, dq: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the encoder of one run shows of positions (S, T), and its derivative (S, T, F); may change its arguments."""
        cos_row, sin_row = self._ripple[row]
        if cos_row < 0:
            return q, dq
        a, b = values[:, cos_row, None], values[:, sin_row, None]
        cos, sin = np.cos(q), np.sin(q)
        dq = dq * (1.0 - a * sin + b * cos)[..., None]
        for unknown, wave in ((cos_row, cos), (sin_row, sin)):
            dq[..., columns == unknown] += wave[..., None]
        q += a * cos + b * sin
        return q, dq

    def load_per_mass(self, run: PreparedRun) -> float:
        """Gravity load of 1 kg in the hand on the driven joint at the run's start [N m/kg]."""
        return self.weight_at_rest(run, self.per_kg(run))

    def per_kg(self, run: PreparedRun) -> np.ndarray:
        """Inertia and gravity load of 1 kg in the hand, shape (4,); see ``Coefficients``."""
        per_mass = payload_parameters(np.ones(1), self.facts.com[None], self.facts.shape.second_moment_per_mass)[0]
        per_kg: np.ndarray = run.coefficients.payload @ per_mass
        return per_kg

    @staticmethod
    def weight_at_rest(run: PreparedRun, coefficients: np.ndarray) -> float:
        """What gravity puts on the driven joint at the run's start [N m], of ``coefficients`` of shape (4,)."""
        _, cos, sin, constant = coefficients
        return float(cos * np.cos(run.rest.value) + sin * np.sin(run.rest.value) + constant)

    def torque_stds(self, run: PreparedRun) -> np.ndarray:
        """What the robot file leaves open of the torque that holds the joint: Coulomb, motor, load friction [N m]."""
        drive = run.drive
        current = float(np.abs(run.run.input_current_A).max())
        motor = drive.torque_constant.value * current
        return np.array([drive.coulomb.std, drive.torque_constant.std * current, drive.load_friction.std * motor])

    def all_values(self, free_values: np.ndarray) -> np.ndarray:
        """Every unknown of each guess, shape (S, N), from the free ones, shape (S, F)."""
        values = np.tile(self.base, (len(free_values), 1))
        values[:, self.free] = free_values
        return values

    def _kernel_parameters(self, free_values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (W, P) of every world, a guess's runs side by side, and their tangents (W, P, F).

        Where the parameters are affine in what is free, the tangents never change: they are handed out as one read-only array,
        which the simulator copies once.
        """
        guesses = len(free_values)
        if not self._affine:
            p, dp = self.parameters(self.all_values(free_values), self.free)
            return p.reshape(-1, p.shape[-1]), dp.reshape(-1, *dp.shape[2:])
        if guesses not in self._affine_maps:
            origin = self.all_values(np.zeros((1, len(self.free))))
            offset, slope = (array[0] for array in self.parameters(origin, self.free))
            self._affine_maps[guesses] = (offset, _read_only(np.tile(slope, (guesses, 1, 1))))
        offset, tangents = self._affine_maps[guesses]
        slope = tangents[: len(self.runs)]
        p = offset + np.tensordot(free_values, slope, axes=(1, 2))
        return p.reshape(-1, p.shape[-1]), tangents

    def _worlds(self, guesses: int) -> np.ndarray:
        if guesses not in self._world_runs:
            self._world_runs[guesses] = _read_only(np.tile(np.arange(len(self.runs), dtype=np.int32), guesses))
        return self._world_runs[guesses]

    def _identity(self, worlds: int) -> np.ndarray:
        """Tangent directions along the simulator's own parameters, shape (W, P, P)."""
        if worlds not in self._identities:
            self._identities[worlds] = _read_only(np.tile(np.eye(len(self.simulator.parameters)), (worlds, 1, 1)))
        return self._identities[worlds]

    def linearise(
        self, internal: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cost, gradient and Gauss-Newton matrix in solver coordinates, priors included.

        Args:
            internal: guesses in solver coordinates, shape (S, F).
            counts: leading samples to use per run, shape (R,); default all.

        Returns:
            cost (S,) = half the squared norm of the whitened residuals, gradient (S, F), matrix (S, F, F). A guess whose
            rollout diverged, or whose moving part would have no inertia, has an infinite cost and zero gradient.
        """
        coordinates = self.coordinates
        physical = coordinates.physical(internal)
        slope = coordinates.slope(internal)
        guesses, size = internal.shape
        p, dp = self._kernel_parameters(physical)
        runs = len(self.runs)
        counts = self.simulator.sample_counts if counts is None else counts
        values = self.all_values(physical) if self._ripples else physical
        off = physical - coordinates.prior_mean
        pull = off @ coordinates.prior_precision
        cost = 0.5 * np.einsum("sf,sf->s", off, pull)
        gradient = pull.copy()
        matrix = np.tile(coordinates.prior_precision, (guesses, 1, 1))
        with np.errstate(over="ignore", invalid="ignore"):
            direct = size <= len(self.simulator.parameters)
            if direct:
                q, _, dq = self.simulator.jacobian(self._worlds(guesses), p, dp, counts)
            else:
                q, _, dq = self.simulator.jacobian(self._worlds(guesses), p, self._identity(len(p)), counts)
            q, dq = q.reshape(guesses, runs, -1), dq.reshape(guesses, runs, -1, dq.shape[-1])
            dp = dp.reshape(guesses, runs, *dp.shape[1:])
            # run by run: a run is touched by few of many unknowns
            for row in range(runs):
                columns, count = self._touching[row], int(counts[row])
                shown, slopes = q[:, row, :count], dq[:, row, :count]
                slopes = slopes[:, :, columns] if direct else slopes @ dp[:, row][:, :, columns]
                if self._ripples:
                    shown, slopes = self._observe(row, values, shown.copy(), slopes, self.free[columns])
                weight = self.weight[row, :count]
                residual = (shown - self.measured[row, :count]) * weight
                slopes = slopes * weight[:, None]
                across = slopes.transpose(0, 2, 1)
                cost += 0.5 * np.einsum("st,st->s", residual, residual)
                gradient[:, columns] += (across @ residual[..., None])[..., 0]
                matrix[:, columns[:, None], columns] += across @ slopes
        gradient = gradient * slope
        matrix = matrix * slope[:, :, None] * slope[:, None, :]
        massless = (p[:, INDEX["inertia"]] <= 0.0).reshape(guesses, runs).any(axis=1)
        bad = massless | ~(np.isfinite(cost) & np.isfinite(matrix).all(axis=(1, 2)))
        if bad.any():
            cost[bad], gradient[bad] = np.inf, 0.0
            matrix[bad] = np.eye(size)
        return cost, gradient, matrix

    @property
    def samples(self) -> int:
        """How many numbers were measured."""
        return int(np.count_nonzero(self.weight))

    def other_information(self, values: np.ndarray) -> np.ndarray:
        """Information of other signals than the encoder's on the free unknowns at given values, shape (F, F): none here."""
        return np.zeros((len(self.free), len(self.free)))

    def simulate(self, values: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the encoder shows, velocities, and sensitivities by chosen unknowns at given values of all of them.

        Args:
            values: of all unknowns, shape (S, N).
            columns: of the chosen ones, shape (F,).

        Returns:
            q (S, R, T), v (S, R, T), dq (S, R, T, F), copies.
        """
        p, dp = self.parameters(values, columns)
        guesses, runs = len(values), len(self.runs)
        worlds, p, dp = self._worlds(guesses), p.reshape(-1, p.shape[-1]), dp.reshape(-1, *dp.shape[2:])
        with np.errstate(over="ignore", invalid="ignore"):
            if len(columns) <= len(self.simulator.parameters):
                q, v, dq = self.simulator.jacobian(worlds, p, dp)
                dq = dq.copy()
            else:
                q, v, dq = self.simulator.jacobian(worlds, p, self._identity(len(p)))
                dq = dq @ dp
        q, v, dq = (
            q.reshape(guesses, runs, -1).copy(),
            v.reshape(guesses, runs, -1).copy(),
            dq.reshape(guesses, runs, -1, len(columns)),
        )
        if self._ripples:
            for row in range(runs):
                q[:, row], dq[:, row] = self._observe(row, values, q[:, row], dq[:, row], columns)
        return q, v, dq


def _inertial_parameters(load: KnownLoad) -> np.ndarray:
    """The ten inertial parameters of a known load, shape (10,)."""
    facts = load.facts
    return payload_parameters(np.array(load.mass), facts.com, facts.shape.second_moment_per_mass)
