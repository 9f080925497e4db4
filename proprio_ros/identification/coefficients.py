"""The robot with every joint locked but the driven one: inertia and gravity load of what that joint moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from proprio_ros.records import Run
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.robot.links import Link
from proprio_ros.sim.payload import (
    PayloadFacts,
    joint_coefficients,
    pseudo_inertia_basis,
)

LINK_TERMS = (
    "link_mass",
    "link_com_x",
    "link_com_y",
    "link_com_z",
    "link_inertia",
)
"""How a link may differ from the URDF: relative mass, shift of its centre of mass [m], relative inertia about it."""
# central difference over the pose of a locked joint [rad or m]; the error is about 1e-10
POSE_STEP = 1e-5
# a link term that changes less than this at its prior is not worth an unknown [kg m^2 or N m]
NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class Coefficients:
    """Inertia and gravity load of the moving part as functions of the payload and of pose errors."""

    arm: np.ndarray  # without payload, shape (4,)
    payload: np.ndarray  # per payload parameter, shape (4, 10)
    # the H locked joints whose zero matters; then changes per unit of their positions:
    pose: tuple[str, ...] = ()
    arm_by_pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    payload_by_pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 10)))
    # keys of the L link unknowns that matter, as ("link_mass", "link4")
    links: tuple[tuple[str, str], ...] = ()
    # change per unit of each, shape (L, 4)
    arm_by_link: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))

    def per_kg(self, facts: PayloadFacts) -> np.ndarray:
        """Inertia and gravity load of 1 kg in the hand, shape (4,)."""
        result: np.ndarray = self.payload @ facts.per_kg
        return result


def reduced_model(
    robot: Robot,
    run: Run,
    shift: Mapping[str, float],
) -> ReducedModel:
    """The robot with every joint locked but the driven one.

    Args:
        robot: With all its joints.
        run: Which joint was driven, and where the others stood.
        shift: Displaces locked joints [rad or m].
    """
    held = {}
    for name, position in run.held.items():
        held[name] = position + shift.get(name, 0.0)
    return robot.model.lock(
        [run.joint],
        held,
        robot.gravity,
    )


def axis_and_gravity(
    model: ReducedModel,
) -> tuple[np.ndarray, np.ndarray]:
    """Axis of the driven joint, and gravity [m/s^2] where it is at zero, both in its own frame; shapes (3,)."""
    rotation = model.placement[0][:3, :3]
    return model.axes[0], rotation.T @ model.gravity


def link_stds(robot: Robot, link: Link) -> dict[str, float]:
    """Standard deviations of a link's ``LINK_TERMS`` before anything is learnt."""
    spread = link.spread
    mass = math.hypot(robot.link_mass_std, spread.mass)
    place_m = math.hypot(robot.link_com_std, spread.com_m)
    inertia = math.hypot(robot.link_inertia_std, spread.inertia)
    stds = (
        mass,
        *[place_m] * 3,
        inertia,
    )
    return dict(zip(LINK_TERMS, stds, strict=True))


def arm_coefficients(robot: Robot, run: Run, locked: Sequence[str]) -> Coefficients:
    """Of a revolute joint, with what the zeros of these locked joints change.

    Args:
        robot: With the arm's links.
        run: Whose joint was driven, and where it held the others.
        locked: Joints whose zeros may be off.
    """
    links = _by_links(robot, run)
    count = len(locked)
    rows = np.tile(
        [run.held.get(name, 0.0) for name in locked],
        (1 + 2 * count, 1),
    )
    one_each = np.eye(count)
    rows[1:] += POSE_STEP * np.concatenate([one_each, -one_each])
    poses = {name: np.array([position]) for name, position in run.held.items()} | dict(
        zip(locked, rows.T, strict=True)
    )
    arm, payload = at_poses(robot, run.joint, poses)
    by_pose = []
    for each in (arm, payload):
        difference = each[1 : 1 + count] - each[1 + count :]
        by_pose.append(difference / (2.0 * POSE_STEP))
    matters = np.abs(by_pose[0]).max(axis=1, initial=0.0) > 1e-6
    pose = tuple(name for name, does in zip(locked, matters, strict=True) if does)
    return Coefficients(
        arm[0],
        payload[0],
        pose,
        by_pose[0][matters],
        by_pose[1][matters],
        *links,
    )


def at_poses(
    robot: Robot, driven: str, poses: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """What one joint moves in N poses at once.

    Args:
        robot: As `ReducedModel` has it with every joint locked but the driven one.
        driven: A joint that no other one follows.
        poses: Positions of all other independent joints [rad or m], each of shape (N,), or (1,) where it is the same in all.

    Returns: Inertia and gravity load of the arm, shape (N, 4), and per payload parameter, shape (N, 4, 10).
    """
    model = robot.model
    count = max(map(len, poses.values()), default=1)
    pseudo = np.zeros((1, 4, 4))
    at = np.eye(4)[None]
    inertias = {link.name: link.pseudo_inertia for link in model.links}
    frames = {model.root: at}
    moves = {model.root: False}
    joint = model.joint(driven)
    for each in model.joints:
        at = frames[each.parent]
        moves[each.child] = moves[each.parent] or each is joint
        if each is joint:
            gravity = robot.gravity @ (at @ each.origin)[:, :3, :3]
            at = np.eye(4)[None]
        elif each.kind == "fixed":
            at = at @ each.origin
        else:
            name, multiplier, offset = model.driving(each)
            at = at @ each.transform(multiplier * poses[name] + offset)
        frames[each.child] = at
        if moves[each.child]:
            pseudo = pseudo + at @ inertias[each.child] @ at.transpose(0, 2, 1)
    arm = np.broadcast_to(
        joint_coefficients(pseudo, joint.kind, joint.axis, gravity),
        (count, 4),
    )
    if not moves[robot.payload_frame]:
        return arm, np.zeros((count, 4, 10))
    at = frames[robot.payload_frame][:, None]
    moved = at @ pseudo_inertia_basis() @ at.transpose(0, 1, 3, 2)
    payload = joint_coefficients(
        moved,
        joint.kind,
        joint.axis,
        gravity[:, None],
    )
    payload = payload.transpose(0, 2, 1)
    return arm, np.broadcast_to(payload, (count, 4, 10))


def _by_links(
    robot: Robot,
    run: Run,
) -> tuple[tuple[tuple[str, str], ...], np.ndarray]:
    """What each link's deviations from the URDF add to the moving part (see ``LINK_TERMS``), where that is noticeable."""
    model = reduced_model(robot, run, {})
    axis, gravity = axis_and_gravity(model)
    links = [
        link
        for link in robot.model.links
        if model.frames[link.name][0] == 0 and link.pseudo_inertia[3, 3] != 0.0
    ]
    frames = np.array([model.frames[link.name][1] for link in links])
    at = frames[:, None]
    changes = _link_changes(np.array([link.pseudo_inertia for link in links]))
    moved = at @ changes @ at.transpose(0, 1, 3, 2)
    rows = joint_coefficients(moved, model.kinds[0], axis, gravity)  # (L, K, 4)
    stds = np.array([[*link_stds(robot, link).values()] for link in links])
    stds = stds.reshape(-1, len(LINK_TERMS))
    largest = np.abs(rows).max(axis=2)
    seen = largest * stds > NEGLIGIBLE
    keys: list[tuple[str, str]] = []
    for link, of_link in zip(links, seen, strict=True):
        terms = [term for term, is_seen in zip(LINK_TERMS, of_link, strict=True) if is_seen]
        keys += [(term, link.name) for term in terms]
    return tuple(keys), rows[seen]


def _link_changes(pseudo: np.ndarray) -> np.ndarray:
    """Derivatives of links' pseudo-inertias (L, 4, 4) by the ``LINK_TERMS``, shape (L, K, 4, 4)."""
    mass = pseudo[:, 3:, 3:]
    com = pseudo[:, :3, 3:] / pseudo[:, 3:, 3:]
    changes = np.zeros((len(pseudo), len(LINK_TERMS), 4, 4))
    changes[:, 0] = pseudo
    for term, direction in enumerate(np.eye(3)[:, :, None], start=1):
        across = com @ direction.T
        both = across + across.transpose(0, 2, 1)
        changes[:, term, :3, :3] = mass * both
        changes[:, term, :3, 3:] = mass * direction
        changes[:, term, 3:, :3] = mass * direction.T
    about_centre = mass * (com @ com.transpose(0, 2, 1))
    changes[:, -1, :3, :3] = pseudo[:, :3, :3] - about_centre
    return changes


def slide_coefficients(robot: Robot, run: Run) -> Coefficients:
    """Everything that a motor moves along slides, as it seems at the motor's shaft: fingers, and those that mimic them.

    A finger weighs three thousand times less there than the rotor, so neither poses nor link deviations matter.
    """
    per_rad = robot.drive_trains[run.joint].transmission
    position = float(run.position[0])
    mass = 0.0
    load = 0.0
    before = {**run.held, run.joint: position - 0.5}
    after = {**run.held, run.joint: position + 0.5}
    for link in robot.model.links:
        weight = float(link.pseudo_inertia[3, 3])
        if weight > 0.0:
            transform = robot.model.frame_transform
            moved = transform(link.name, after) - transform(link.name, before)
            velocity = moved[:3, 3]
            mass += weight * float(velocity @ velocity)
            load -= weight * float(velocity @ robot.gravity)
    return Coefficients(
        np.array([mass * per_rad**2, 0.0, 0.0, load * per_rad]),
        np.zeros((4, 10)),
    )
