"""Runs made ready for a fit: the usable window, the weight of each sample, where the joint rests, and what it moves.

The encoder shows the true position less the joint's zero and a once-per-turn error, plus rounding, noise and stamp jitter. A
residual is weighted by ``sqrt(resolution^2 / 12 + noise^2 + (velocity x jitter)^2)``. All samples of the used window count, not
only the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.identification.coefficients import (
    Coefficients,
    arm_coefficients,
    slide_coefficients,
)
from proprio_ros.identification.locked_joints import (
    Loads,
    Motion,
    loads_of_yielding,
    locked_motions,
)
from proprio_ros.identification.run_kinds import Push, kind_of
from proprio_ros.quantity import MAD_TO_STD, Quantity
from proprio_ros.records import Run
from proprio_ros.robot import DriveTrain, Robot
from proprio_ros.sim.payload import (
    PayloadFacts,
    payload_parameters,
)

FOLLOWED_SHARE = 0.5
"""Rank correlation of effort and command from which on a motor follows what its command scatters by."""
LATE_S = 0.05  # an effort may be reported so long after its command
FEWEST_NOISY, ALIKE_ROWS = 5, 0.5
"""Rows of a command without which nothing is said of its noise, and the correlation of neighbours from which on it is no noise."""
MIN_SLOW = 3  # slow samples needed to relate reported effort to the command
BY_CHANCE = 2.0
"""Standard deviations by which a motor may seem to deliver another share of its command than in the calibration; more counts."""


@dataclass(frozen=True)
class KnownLoad:
    """What the hand held in a run whose mass [kg] is stated, with its place and shape; the default is nothing."""

    mass: float = 0.0
    facts: PayloadFacts = field(default_factory=PayloadFacts)

    @property
    def inertial_parameters(self) -> np.ndarray:
        """Shape (10,), see ``payload_parameters``."""
        return payload_parameters(
            np.array(self.mass),
            self.facts.com,
            self.facts.shape.second_moment_per_mass,
        )


@dataclass(frozen=True)
class PreparedRun:
    """A run as the fit uses it."""

    run: Run
    used: int  # leading samples inside the usable window
    cut_reason: str  # why later samples are left out, or an empty string
    drive: DriveTrain  # of the driven joint
    coefficients: Coefficients
    sigma: np.ndarray  # standard deviation of each used sample [rad or m], shape (used,)
    rest: Quantity  # start position, from the samples before onset
    # whether the supply may limit the current inside the window, as far as the recording says
    limited: bool
    load: KnownLoad | None = None  # what the hand is known to hold; None: the payload to be weighed
    loads: Loads = field(default_factory=Loads)  # what loads the joint beside its current
    # standard deviation of the motor's torque by what its command says otherwise than the motor did [N m]
    current_torque_std: float = 0.0

    @cached_property
    def kind(self) -> Push:
        return kind_of(self.run)

    @property
    def times_s(self) -> np.ndarray:
        return self.run.times_s[: self.used]

    @property
    def position(self) -> np.ndarray:
        return self.run.position[: self.used]

    @property
    def travel(self) -> float:
        """Signed largest excursion from rest, or from the start of a free swing, inside the used window."""
        excursion = self.position - self.rest.value
        return float(excursion[np.argmax(np.abs(excursion))])

    def weight_at_rest(self, coefficients: np.ndarray) -> float:
        """What gravity puts on the driven joint at the start [N m], of ``coefficients`` of shape (4,)."""
        _, cos, sin, constant = coefficients
        q = self.rest.value
        return float(cos * np.cos(q) + sin * np.sin(q) + constant)

    @property
    def torque_stds(self) -> np.ndarray:
        """What the robot file leaves open of the torque that moves the joint: Coulomb, motor, load friction [N m]."""
        drive = self.drive
        current = float(np.abs(self.run.input_current_A).max())
        motor = drive.torque_constant.value * current
        return np.array(
            [
                drive.coulomb.std,
                drive.torque_constant.std * current,
                drive.load_friction.std * motor,
            ]
        )


def joints_of(runs: Sequence[PreparedRun]) -> tuple[str, ...]:
    """The joints that runs drive, each once."""
    return tuple(dict.fromkeys(run.run.joint for run in runs))


def turning_with(robot: Robot, run: PreparedRun) -> list[tuple[str, float]]:
    """Held joints whose zero turns the hand as the driven joint's does, and by which share."""
    positions = {
        **run.run.held,
        run.run.joint: float(run.position[0]),
    }

    def axis(name: str) -> np.ndarray:
        joint = robot.model.joint(name)
        return robot.model.frame_transform(joint.child, positions)[:3, :3] @ joint.axis

    if robot.model.joint(run.run.joint).kind == "prismatic":
        return []
    driven = axis(run.run.joint)
    turning = [
        name for name in run.coefficients.pose if robot.model.joint(name).kind != "prismatic"
    ]
    shares = [(name, float(axis(name) @ driven)) for name in turning]
    return [(name, share) for name, share in shares if abs(share) > 1e-3]


def at_the_shaft(robot: Robot, run: Run) -> Run:
    """The same run as the motor's shaft sees it [rad]: what a slide's positions are divided by its transmission."""
    drive = robot.drive_trains.get(run.joint)
    if drive is None or drive.transmission == 1.0:
        return run
    positions = ("position", "before_position", "after_position")
    return replace(
        run,
        **{name: getattr(run, name) / drive.transmission for name in positions},
    )


def prepare_run(
    robot: Robot,
    run: Run,
    load: KnownLoad | None = None,
    facts: PayloadFacts | None = None,
    past_fast: bool = False,
) -> PreparedRun:
    """Choose the usable window, weigh the samples, and reduce the robot to the driven joint.

    Args:
        robot: Of the recording.
        run: As recorded.
        load: What the hand is known to hold; None: the payload to be weighed.
        facts: Where the payload sits, for what yielding joints do with it; default at the payload frame.
        past_fast: Whether samples count from where the joint runs so fast that the supply may limit the current. That is then
            simulated with the supply's nominal numbers: for motions that are fast for a moment and informative mostly after it.

    Raises:
        RecordingError: A joint the robot has is missing from the recording, the driven joint has no drive train, or the load to
            be weighed does not move with it.
    """
    run, coefficients, motions = _reduced(robot, run)
    if (load is None or load.mass > 0.0) and not coefficients.payload.any():
        still = f"{run.joint} was driven but does not move {robot.payload_frame}"
        raise RecordingError(f"{run.name}: {still}: probe a joint between the base and it")
    drive = robot.drive_trains[run.joint]
    joint = robot.model.joint(run.joint)
    run, command_std_A = _steadied(at_the_shaft(robot, run), drive)
    # noise of a command shows in the share that was delivered, too: it counts once, by the larger of the two
    command_std_A = max(command_std_A, _undelivered_A(robot, run))
    velocity = np.gradient(run.position, run.times_s)
    followed = _followed(run, velocity, drive)
    lower = joint.lower / drive.transmission
    upper = joint.upper / drive.transmission
    counted = np.ones_like(followed) if past_fast else followed
    used, reason = _usable_window(
        run,
        velocity,
        counted,
        drive,
        lower,
        upper,
    )
    # of nothing it does not matter where it is
    held = load.facts if load is not None and load.mass > 0.0 else facts or PayloadFacts()
    kind = kind_of(run)
    loads = kind.loads(run, coefficients, held)
    if motions:
        loads = loads_of_yielding(
            robot,
            run,
            motions,
            held,
            drive.reading_std,
        )
    return PreparedRun(
        run,
        used,
        reason,
        drive,
        coefficients,
        _sigma(robot, run, velocity[:used]),
        kind.rest(robot, run),
        limited=not followed[1:used].all(),
        load=load,
        loads=loads,
        current_torque_std=drive.torque_constant.value * command_std_A,
    )


def _reduced(
    robot: Robot,
    run: Run,
) -> tuple[Run, Coefficients, dict[str, Motion]]:
    """What the driven joint moves, how locked joints gave way meanwhile, and the run with them where they were at its start."""
    if run.joint not in robot.drive_trains:
        known = f"{robot.name} has no drive train for it (it has: {', '.join(robot.drive_trains)})"
        raise RecordingError(f"{run.name}: {run.joint} was driven, but {known}")
    others = [name for name in robot.model.independent_joints if name != run.joint]
    missing = [name for name in others if name not in run.held]
    if missing:
        cure = f"state it with --set held.{missing[0]}=VALUE"
        raise RecordingError(
            f"{run.name}: no position of {', '.join(missing)} in the recording; {cure}"
        )
    if robot.model.joint(run.joint).kind == "prismatic":
        return run, slide_coefficients(robot, run), {}
    coefficients = arm_coefficients(robot, run, others)
    stood, motions = locked_motions(robot, run, kind_of(run).yielding(coefficients.pose))
    # the recorded mean counts a slip on the way to where a joint was held
    if any(stood[name] != run.held[name] for name in stood):
        run = replace(run, held={**run.held, **stood})
        coefficients = arm_coefficients(robot, run, others)
    return run, coefficients, motions


def _sigma(robot: Robot, run: Run, velocity: np.ndarray) -> np.ndarray:
    """Standard deviations of readings at these velocities, shape (K,)."""
    jitter = robot.stamp_jitter_s
    if robot.calibration is None:
        # random errors of the stamps show in their intervals, sqrt(2) times; stamps like clockwork have none. What a calibration
        # learnt from residuals holds as it is: whatever makes them grow with speed is in it, and not in the intervals.
        jitter = min(
            jitter,
            float(np.std(np.diff(run.times_s))) / np.sqrt(2.0),
        )
    reading = robot.residual_scale * robot.drive_trains[run.joint].reading_std
    sigma: np.ndarray = np.hypot(reading, velocity * jitter)
    return np.hypot(sigma, kind_of(run).model_error(robot))


def _undelivered_A(robot: Robot, run: Run) -> float:
    """What the motor delivered more or less of its command than in the calibration, where that is beyond chance [A].

    A motor that always delivers a little less has a torque constant that is less by as much. Without a calibration the torque
    constant is open by more than that.
    """
    if run.delivered is None or robot.calibration is None:
        return 0.0
    usual = robot.calibration.delivered.get(run.joint, Quantity(1.0))
    off = abs(run.delivered.value - usual.value)
    if off < BY_CHANCE * float(np.hypot(run.delivered.std, usual.std)):
        return 0.0
    return off * float(np.abs(run.input_current_A).max())


def _steadied(run: Run, drive: DriveTrain) -> tuple[Run, float]:
    """The run with the mean of a command whose noise the motor did not follow, and that mean's standard deviation [A].

    A command that scatters from row to row while the motor reports a steady current was recorded with an error of its own in every
    row. A run without efforts, or whose effort follows, comes back as it is, with 0.
    """
    if run.reported_effort is None or len(run.input_current_A) < FEWEST_NOISY:
        return run, 0.0
    at = np.searchsorted(run.input_times_s, run.times_s, side="right") - 1
    command = run.input_current_A[at.clip(0)]
    speed = np.abs(np.gradient(run.position, run.times_s))
    # a joint that is fast is not driven by what is commanded
    seen = np.isfinite(run.reported_effort) & (speed < drive.usable_velocity)
    seen &= run.times_s > run.times_s[0]
    mean = float(command[seen].mean()) if seen.any() else 0.0
    reported = float(run.reported_effort[seen].mean()) if seen.any() else 0.0
    if mean == 0.0 or reported == 0.0:
        return run, 0.0
    scatter = float(command[seen].std())
    effort = run.reported_effort[seen] * np.sign(mean * reported)
    followed = max(
        rank_correlation(command[seen][: len(effort) - late], effort[late:])
        for late in range(_samples_late(run, len(effort)))
    )
    off = run.input_current_A - run.input_current_A.mean()
    alike = float(off[1:] @ off[:-1]) / float(off @ off)
    # an excitation that alternates goes on for some rows each way
    if followed > FOLLOWED_SHARE or alike > ALIKE_ROWS:
        return run, 0.0
    lasts_s = np.diff(np.append(run.input_times_s, run.duration_s))
    level = float(run.input_current_A @ lasts_s) / float(lasts_s.sum())
    milliampere = f"{1e3 * scatter:.0f} mA"
    note = (
        f"its command scatters by {milliampere}, which the effort does not show: its mean is taken"
    )
    steady = replace(
        run,
        input_times_s=np.zeros(1),
        input_current_A=np.array([level]),
        notes=(*run.notes, note),
    )
    return steady, scatter / float(np.sqrt(len(off)))


def _samples_late(run: Run, samples: int) -> int:
    """How many samples an effort may come after its command, and one; half of them are left to be compared."""
    period_s = float(np.median(np.diff(run.times_s)))
    return 1 + min(int(LATE_S / period_s), samples // 2)


def rank_correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's, shape (K,) each, which single outliers hardly change; 0 where one of the two stands still."""
    first = _ranks(one)
    second = _ranks(other)
    size = float(np.linalg.norm(first)) * float(np.linalg.norm(second))
    return float(first @ second) / size if size > 0.0 else 0.0


def _ranks(values: np.ndarray) -> np.ndarray:
    """About their mean; equal values share one, shape (K,)."""
    _, which, counts = np.unique(
        values,
        return_inverse=True,
        return_counts=True,
    )
    last = np.cumsum(counts)
    return (last - 0.5 * (counts - 1) - 0.5 * (len(values) + 1))[which]


def _followed(run: Run, velocity: np.ndarray, drive: DriveTrain) -> np.ndarray:
    """At which samples the motor reported the commanded current, shape (K,); False where nothing was reported, though commanded.

    The reported effort is compared with the command in its own unit: what the two have to do with each other is read off the
    slow samples, where the supply limits nothing.
    """
    blind = np.zeros(len(run.times_s), dtype=bool)
    if not run.input_current_A.any():
        return ~blind
    if run.reported_effort is None:
        return blind
    command = run.input_current_A[
        np.searchsorted(run.input_times_s, run.times_s, side="left").clip(1) - 1
    ]
    slow = (
        (np.abs(velocity) < 0.5 * drive.usable_velocity)
        & (command != 0.0)
        & np.isfinite(run.reported_effort)
    )
    slow &= run.times_s > run.times_s[0]  # the first report may be older than the command
    if slow.sum() < MIN_SLOW or np.median(run.reported_effort[slow] / command[slow]) <= 0.0:
        return blind
    unit = float(np.median(run.reported_effort[slow] / command[slow]))
    off = np.abs(run.reported_effort / unit - command)
    noise = MAD_TO_STD * float(np.median(off[slow]))
    return off <= np.maximum(0.05 * np.abs(command), 4.0 * noise)


def _usable_window(
    run: Run,
    velocity: np.ndarray,
    followed: np.ndarray,
    drive: DriveTrain,
    lower: float,
    upper: float,
) -> tuple[int, str]:
    """How many samples come before the joint meets its limit, or runs so fast that the supply may no longer drive the current.

    A fast sample still counts while the motor itself reports the commanded current. The second value is why no more are usable.
    """
    count = len(run.times_s)
    # how close to the limit a reading is no longer certain to be short of it
    margin = 3.0 * float(np.hypot(drive.zero.std, drive.encoder_resolution))
    first = run.position[:1]
    before = np.concatenate([first, run.position[:-1]])
    step = np.diff(run.position, prepend=run.position[0])
    # where the sample would be at the speed of the last interval: an impact may hide between two samples
    expected = before + np.concatenate([[0.0], step[:-1]])
    furthest = np.maximum(run.position, expected)
    nearest = np.minimum(run.position, expected)
    beyond = (furthest > upper - margin) | (nearest < lower + margin)
    # a joint that starts at a limit and leaves it is free to move
    moved = np.abs(run.position - run.position[0]) > margin
    stopped = np.flatnonzero(beyond & moved)
    fast = np.flatnonzero((np.abs(velocity) > drive.usable_velocity) & ~followed)
    limit = int(stopped[0]) if len(stopped) else count
    speed = int(fast[0]) if len(fast) else count
    if limit < count and limit <= speed:
        return (
            limit,
            f"{run.joint} reached its limit {run.times_s[limit]:.3f} s after the start",
        )
    if speed < count:
        why = "the motor did not report the commanded current"
        if run.reported_effort is None:
            why = "the supply may no longer drive the commanded current"
        passed = f"{run.joint} passed {drive.usable_velocity:g} rad/s {run.times_s[speed]:.3f} s after the start"
        return speed, f"{passed} and {why}"
    return count, ""
