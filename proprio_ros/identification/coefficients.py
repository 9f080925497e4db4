"""The robot with every joint locked but the driven one: inertia and gravity load of what that joint moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from proprio_ros.records import Run
from proprio_ros.robot import ReducedModel, Robot
from proprio_ros.sim.payload import PayloadFacts, joint_coefficients, pseudo_inertia_basis

LINK_TERMS = ("link_mass", "link_com_x", "link_com_y", "link_com_z", "link_inertia")
"""How a link may differ from the URDF: relative mass, shift of its centre of mass [m], relative inertia about it."""
POSE_STEP = 1e-5  # central difference over the pose of a locked joint [rad or m]; the error is about 1e-10
NEGLIGIBLE = 1e-9  # a link term that changes less than this at its prior is not worth an unknown [kg m^2 or N m]


@dataclass(frozen=True)
class Coefficients:
    """Inertia and gravity load of the moving part as functions of the payload and of pose errors."""

    arm: np.ndarray  # without payload, shape (4,)
    payload: np.ndarray  # per payload parameter, shape (4, 10)
    pose: tuple[str, ...] = ()  # the H locked joints whose zero matters; then changes per unit of their positions:
    arm_by_pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    payload_by_pose: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 10)))
    links: tuple[tuple[str, str], ...] = ()  # keys of the L link unknowns that matter, as ("link_mass", "link4")
    arm_by_link: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))  # change per unit of each, shape (L, 4)

    def per_kg(self, facts: PayloadFacts) -> np.ndarray:
        """Inertia and gravity load of 1 kg in the hand, shape (4,)."""
        result: np.ndarray = self.payload @ facts.per_kg
        return result


def reduced_model(robot: Robot, run: Run, shift: Mapping[str, float]) -> ReducedModel:
    """The robot with every joint locked but the driven one; ``shift`` displaces locked joints [rad or m]."""
    held = {name: position + shift.get(name, 0.0) for name, position in run.held.items()}
    return robot.model.lock([run.joint], held, robot.gravity)


def axis_and_gravity(model: ReducedModel) -> tuple[np.ndarray, np.ndarray]:
    """Axis of the driven joint, and gravity [m/s^2] where it is at zero, both in its own frame; shapes (3,)."""
    return model.axes[0], model.placement[0][:3, :3].T @ model.gravity


def link_stds(robot: Robot) -> dict[str, float]:
    """Standard deviations of ``LINK_TERMS`` before anything is learnt."""
    stds = (robot.link_mass_std, *[robot.link_com_std] * 3, robot.link_inertia_std)
    return dict(zip(LINK_TERMS, stds, strict=True))


def arm_coefficients(robot: Robot, run: Run, locked: Sequence[str]) -> Coefficients:
    """Of a revolute joint, with what the zeros of these locked joints change."""
    arm, payload = _at_shift(robot, run, {})
    arm_by_pose, payload_by_pose = np.zeros((len(locked), 4)), np.zeros((len(locked), 4, 10))
    for row, name in enumerate(locked):
        up, down = (_at_shift(robot, run, {name: sign * POSE_STEP}) for sign in (1.0, -1.0))
        arm_by_pose[row] = (up[0] - down[0]) / (2.0 * POSE_STEP)
        payload_by_pose[row] = (up[1] - down[1]) / (2.0 * POSE_STEP)
    matters = np.abs(arm_by_pose).max(axis=1) > 1e-6
    pose = tuple(name for name, does in zip(locked, matters, strict=True) if does)
    return Coefficients(arm, payload, pose, arm_by_pose[matters], payload_by_pose[matters], *_by_links(robot, run))


def _at_shift(robot: Robot, run: Run, shift: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Of the arm, shape (4,), and per payload parameter, shape (4, 10)."""
    model = reduced_model(robot, run, shift)
    body, body_from_payload = model.frames[robot.payload_frame]
    axis, gravity = axis_and_gravity(model)
    arm = joint_coefficients(model.pseudo_inertia[0], model.kinds[0], axis, gravity)
    if body != 0:  # the joint does not carry the hand
        return arm, np.zeros((4, 10))
    moved = body_from_payload @ pseudo_inertia_basis() @ body_from_payload.T
    return arm, joint_coefficients(moved, model.kinds[0], axis, gravity).T


def _by_links(robot: Robot, run: Run) -> tuple[tuple[tuple[str, str], ...], np.ndarray]:
    """What each link's deviations from the URDF add to the moving part (see ``LINK_TERMS``), where that is noticeable."""
    model = reduced_model(robot, run, {})
    axis, gravity = axis_and_gravity(model)
    stds = link_stds(robot)
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
        of_terms = joint_coefficients(moved, model.kinds[0], axis, gravity)
        for (term, std), row in zip(stds.items(), of_terms, strict=True):
            if np.abs(row).max() * std > NEGLIGIBLE:
                keys.append((term, link.name))
                rows.append(row)
    return tuple(keys), np.array(rows).reshape(-1, 4)


def slide_coefficients(robot: Robot, run: Run) -> Coefficients:
    """Everything that a motor moves along slides, as it seems at the motor's shaft: fingers, and those that mimic them.

    A finger weighs three thousand times less there than the rotor, so neither poses nor link deviations matter.
    """
    per_rad = robot.drive_trains[run.joint].transmission
    position = float(run.position[0])
    mass, load = 0.0, 0.0
    before, after = ({**run.held, run.joint: position + off} for off in (-0.5, 0.5))
    for link in robot.model.links:
        weight = float(link.pseudo_inertia[3, 3])
        if weight > 0.0:
            transform = robot.model.frame_transform
            velocity = (transform(link.name, after) - transform(link.name, before))[:3, 3]
            mass += weight * float(velocity @ velocity)
            load -= weight * float(velocity @ robot.gravity)
    return Coefficients(np.array([mass * per_rad**2, 0.0, 0.0, load * per_rad]), np.zeros((4, 10)))
