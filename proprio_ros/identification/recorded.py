"""What was recorded of each run, for those who want to see it before any fit."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from proprio_ros.errors import RobotError
from proprio_ros.identification.estimate import (
    HeldView,
    RecordedRun,
)
from proprio_ros.identification.prepared_runs import at_the_shaft
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import (
    links_in,
    side_plane,
    side_view,
)

POSES, AROUND = (
    6,
    60,
)  # of an arm in motion that are drawn; points of an outline
BEFORE_SHARE = 0.3  # so much of a run's duration is shown of what came before it


def recorded_run(robot: Robot, run: Run, baseline: bool = False) -> RecordedRun:
    """A run as a page shows it.

    Args:
        robot: Whose joint moved.
        run: As recorded.
        baseline: Whether it was made without what is to be identified.
    """
    shown = run.before_times_s >= -BEFORE_SHARE * run.duration_s
    position = np.concatenate([run.before_position[shown], run.position])
    seen = at_the_shaft(robot, run)
    slides = seen is run and robot.model.joint(run.joint).kind == "prismatic"
    arm = np.zeros((2, 0, 2, 2))
    driven = np.zeros((2, 2))
    if len(position):
        ends = (float(position[0]), float(position[-1]))
        poses = [{**run.held, run.joint: end} for end in ends]
        # locked joints that nobody recorded: the fit asks for those that matter to it
        with suppress(RobotError):
            arm, driven = side_view(robot, run.joint, poses)
    return RecordedRun(
        run.name,
        run.joint,
        run.source,
        "m" if slides else "rad",
        np.concatenate([run.before_times_s[shown], run.times_s]),
        np.concatenate([seen.before_position[shown], seen.position]),
        run.input_times_s,
        run.input_current_A,
        run.duration_s,
        arm,
        driven,
        baseline,
    )


def held_views(
    robot: Robot,
    motion: Motion,
    load: tuple[float, Sequence[float], np.ndarray] | None,
    inertia_is: str = "",
    within_m: Sequence[float] | None = None,
) -> tuple[HeldView, ...]:
    """An arm in motion and what it held, from the side and from above.

    Args:
        robot: Whose joints moved.
        motion: The arm is drawn where the hand is farthest out, and fainter at other instants.
        load: Mass [kg], centre in the payload's frame [m], shape (3,), and inertia about it [kg m^2], shape (3, 3).
        inertia_is: Where the inertia is from.
        within_m: Half 95 % intervals of the centre [m], shape (3,), where it was identified.

    Returns: nothing where a position is not known.
    """
    try:
        poses = _poses_of(motion)
        hands = [robot.model.frame_transform(robot.payload_frame, pose) for pose in poses]
        right, up = side_plane(robot, motion.joints[0], poses[0])
        places = [hand[:3, 3] for hand in hands]
        out = [float(np.linalg.norm(at - up * (up @ at))) for at in places]
        far = int(np.argmax(out))
        drawn = [*poses[:: AROUND // (POSES - 1)], poses[far]]
        sides = [
            ("from the side", np.array([right, up])),
            (
                "from above",
                np.array([right, np.cross(up, right)]),
            ),
        ]
        sides = sides[: len(motion.joints)]  # of one joint the side along its axis shows all
        links = [links_in(robot, plane, drawn) for _, plane in sides]
    except RobotError:  # locked joints that nobody recorded
        return ()
    views = []
    for (side, plane), arm in zip(sides, links, strict=True):
        view = HeldView(side, arm, plane @ hands[far][:3, 3])
        if load is not None and load[0] > 0.0:  # nothing has no body
            view = _with_body(
                view,
                plane @ hands[far][:3, :3],
                load,
                inertia_is,
                within_m,
            )
        views.append(view)
    return tuple(views)


def _poses_of(motion: Motion) -> list[dict[str, float]]:
    """All joints [rad or m] at instants spread evenly over a motion."""
    rows = [int(row) for row in np.linspace(0, len(motion.times_s) - 1, AROUND)]
    return [
        {
            **motion.held,
            **{joint: float(position[row]) for joint, position in motion.beside.items()},
            **dict(
                zip(
                    motion.joints,
                    motion.position[row].tolist(),
                    strict=True,
                )
            ),
        }
        for row in rows
    ]


def _with_body(
    view: HeldView,
    seen: np.ndarray,
    load: tuple[float, Sequence[float], np.ndarray],
    inertia_is: str,
    within_m: Sequence[float] | None,
) -> HeldView:
    """A view with the load in it; ``seen`` takes a vector in the payload's frame to the plane, shape (2, 3)."""
    mass, centre_m, inertia = load
    centre = view.hand + seen @ np.asarray(centre_m)
    # that of an ellipsoid along one of its half axes is a fifth of their square
    spread = 5.0 * (0.5 * np.trace(inertia) * np.eye(3) - inertia) / mass
    within = None
    if within_m is not None:
        within = _outline(centre, seen @ np.diag(np.square(within_m)) @ seen.T)
    body = _outline(centre, seen @ spread @ seen.T)
    return replace(
        view,
        centre=centre,
        within=within,
        body=body,
        inertia_is=inertia_is,
    )


def _outline(centre: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Of the ellipse ``x^T shape^-1 x = 1`` about a centre, shape (K, 2)."""
    squares, axes = np.linalg.eigh(shape)
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND)
    unit = np.array([np.cos(angle), np.sin(angle)])
    halves = np.sqrt(np.maximum(squares, 0.0))
    return np.asarray(centre + (axes * halves @ unit).T)
