"""Pushes that could be made: of which joints, from where, with which currents, and inside which limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.identification.coefficients import at_poses
from proprio_ros.identification.prepared_runs import (
    KnownLoad,
    PreparedRun,
    prepare_run,
)
from proprio_ros.identification.problem import Problem
from proprio_ros.quantity import shown
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import (
    bent_pose,
    clearance,
    zero_pose,
)
from proprio_ros.sim.payload import PayloadFacts

RATE_HZ = 40.0
CLEARANCE_M = 0.03
"""Nothing may come closer to the base's plane than this; the grasped object hangs below the hand's frame."""
LIMIT_MARGIN = 0.05  # left before a joint's limit [rad]
WIDEST = 1.5  # the range searched of a joint without limits [rad]
MOST_LOOKED_AT = 1024  # poses in which a joint may carry the hand
MOST_POSES = 100_000  # of a grid
# torque beyond balance and friction, relative to the largest gravity load at that pose
PUSHES = (0.1, 0.2, 0.4)
TimeOf = Callable[[Sequence[Mapping[str, float]]], np.ndarray]
"""Seconds that S pushes take beside their durations, shape (S,), by the positions of all joints at their starts."""


@dataclass(frozen=True)
class Push:
    """A push that could be made, as in a sequence."""

    joint: str
    start: Mapping[str, float]  # of all joints that matter [rad]
    current_A: float
    shake_A: float
    duration_s: float
    time_s: float  # with the way to its start, rest and brake
    std: float  # of the mass after it, as predicted [kg]
    gain: float  # information about the mass per second [nat/s]
    travel: float  # where it goes: signed, as predicted [rad]

    @property
    def words(self) -> str:
        """What it is, for people."""
        shake = f" +-{shown('A', self.shake_A, spec='.0f')}" if self.shake_A else ""
        start = ", ".join(
            f"{name} {position:+.2f}" for name, position in self.start.items() if position
        )
        return f"{self.joint} {shown('A', self.current_A, spec='+.0f')}{shake} from ({start})"


def best_first(pushes: Sequence[Push], target_std: float) -> list[Push]:
    """Pushes that reach the target, the quickest first, then the others by what they gain per second."""
    return sorted(
        pushes,
        key=lambda push: (0, push.time_s) if push.std <= target_std else (1, -push.gain),
    )


def still_run(
    joint: str,
    pose: Mapping[str, float],
    current_A: float,
    duration_s: float,
) -> Run:
    """A run as it would be recorded, standing still.

    Args:
        joint: The driven one.
        pose: Where all joints stand [rad or m].
        current_A: Constant from the start [A].
        duration_s: Of the run [s].
    """
    count = round(duration_s * RATE_HZ)
    held = {name: position for name, position in pose.items() if name != joint}
    return Run(
        name=f"{joint} {shown('A', current_A, spec='+.0f')}",
        joint=joint,
        onset_ns=0,
        times_s=np.arange(1, count + 1) / RATE_HZ,
        position=np.full(count, pose[joint]),
        before_times_s=-np.arange(10, 0, -1) / RATE_HZ,
        before_position=np.full(10, pose[joint]),
        held=held,
        held_span=dict.fromkeys(held, 0.0),
        input_times_s=np.zeros(1),
        input_current_A=np.array([current_A]),
        duration_s=duration_s,
        source="plan",
    )


def candidate_joints(robot: Robot) -> list[str]:
    """Driven joints that carry the hand against gravity somewhere."""
    found = []
    model = robot.model
    rest = zero_pose(robot)
    mimics = [joint for joint in model.joints if joint.mimic is not None]
    followed = {model.driving(joint)[0] for joint in mimics}
    for name in robot.drive_trains:
        if model.joint(name).kind == "prismatic" or name in followed:
            continue
        ends = {
            each: start_positions(robot, each, 2)
            for each in (name, *joints_that_matter(robot, name))
        }
        poses = [rest | places for places in itertools.islice(shuffled(ends), MOST_LOOKED_AT)]
        poses = [pose for pose in poses if clearance(robot, pose) >= CLEARANCE_M]
        if not poses:
            continue
        _, payload = at_poses(
            robot,
            name,
            {held: np.array([pose[held] for pose in poses]) for held in poses[0]},
        )
        if np.abs(payload[:, 1:3]).max() > 1e-3:
            found.append(name)
    return found


def start_positions(robot: Robot, joint: str, count: int) -> list[float]:
    """Positions of a joint inside its limits, evenly over what is searched of them [rad].

    Args:
        robot: Whose joint.
        joint: Its name.
        count: How many positions.
    """
    limits = robot.model.joint(joint)
    lower = max(limits.lower, -WIDEST)
    upper = min(limits.upper, WIDEST)
    margin = min(2.0 * LIMIT_MARGIN, 0.1 * (upper - lower))
    places = np.linspace(lower + margin, upper - margin, count)
    return [round(float(q), 2) for q in places]


def joints_that_matter(robot: Robot, joint: str) -> list[str]:
    """Locked joints with a motor whose positions change what a driven joint carries."""
    matters = prepare_run(
        robot,
        still_run(joint, bent_pose(robot), 0.0, 0.1),
        KnownLoad(),
    ).coefficients.pose
    return [name for name in matters if name in robot.drive_trains]


def shuffled(
    axes: Mapping[str, Sequence[float]],
) -> Iterator[dict[str, float]]:
    """Places of a grid, by the positions along each of its axes, always in the same order; some of them where they are many."""
    sizes = [len(axis) for axis in axes.values()]
    rng = np.random.default_rng(0)
    if math.prod(sizes) <= MOST_POSES:
        places = np.stack(
            np.unravel_index(rng.permutation(math.prod(sizes)), sizes),
            axis=1,
        )
    else:
        places = rng.integers(sizes, size=(MOST_POSES, len(sizes)))
    for row in places.tolist():
        positions = [axis[at] for axis, at in zip(axes.values(), row, strict=True)]
        yield dict(zip(axes, positions, strict=True))


def locked_poses(
    robot: Robot,
    joint: str,
    count: int,
) -> list[dict[str, float]]:
    """Poses over a grid of the locked joints that matter to the driven one; all others are at zero.

    Args:
        robot: Whose joints.
        joint: The driven one.
        count: Positions of each locked joint.
    """
    rest = zero_pose(robot)
    others = joints_that_matter(robot, joint)
    grids = [start_positions(robot, name, count) for name in others]
    return [
        rest | dict(zip(others, positions, strict=True)) for positions in itertools.product(*grids)
    ]


def start_poses(
    robot: Robot,
    joint: str,
    starts: int,
    locked: int,
) -> list[dict[str, float]]:
    """Start poses over a grid of the driven joint and of those that matter to it, high enough above the base's plane.

    Args:
        robot: Whose joints.
        joint: The driven one.
        starts: Positions of the driven joint.
        locked: Positions of each locked joint that matters.
    """
    poses = locked_poses(robot, joint, locked)
    whole = []
    for q in start_positions(robot, joint, starts):
        whole += [pose | {joint: q} for pose in poses]
    return [pose for pose in whole if clearance(robot, pose) >= CLEARANCE_M]


def expected_coulomb(problem: Problem, joint: str) -> float:
    """Dry friction [N m]; what the file leaves open is half as large as it may be: none at all would make every plan too bold."""
    coulomb = problem.unknowns[problem.index["coulomb", joint]]
    return coulomb.value + 0.5 * coulomb.std * (coulomb.value < coulomb.std)


def currents_beyond(
    run: PreparedRun,
    facts: PayloadFacts,
    masses_kg: Sequence[float],
) -> Iterator[tuple[float, float, float]]:
    """Currents that move the joint of a standing run one way or the other, by a little and by more, with any mass in the hand.

    Args:
        run: Of a joint that stands still.
        facts: About the object.
        masses_kg: What the hand may hold [kg].

    Yields:
        One of ``PUSHES``, the current that it takes [A], and the largest gravity load [N m].
    """
    drive = run.drive
    per_kg = run.coefficients.per_kg(facts)
    q = run.rest.value
    loads = [run.coefficients.arm + mass * per_kg for mass in masses_kg]
    balance = []
    for g in loads:
        turning = g[1] * np.cos(q) + g[2] * np.sin(q)
        balance.append(turning + g[3])
    # a robot that was not calibrated may rub by as much as its file leaves open
    dry = drive.coulomb.value + 0.5 * drive.coulomb.std
    largest = max(_largest_load(g) for g in loads)
    edges = {1.0: max(balance), -1.0: min(balance)}
    for sign, edge in edges.items():
        for push in PUSHES:
            beyond = dry + drive.load_friction.value * abs(edge) + push * largest
            yield (
                push,
                round(
                    (edge + sign * beyond) / drive.torque_constant.value,
                    3,
                ),
                largest,
            )


def _largest_load(load: np.ndarray) -> float:
    """Of gravity at any angle of the joint, from the four coefficients of its moving part [N m]."""
    return float(np.hypot(load[1], load[2])) + abs(load[3])
