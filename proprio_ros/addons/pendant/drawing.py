"""The arm in three dimensions: bars from joint to joint, where the joint states say that they are.

A robot here has no meshes: what is drawn is what is computed with, the frames of its URDF and the centres of its last bodies.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from nicegui import ui
from nicegui.elements.scene import Scene

from proprio_ros.addons.pendant.tasks import Places
from proprio_ros.addons.pendant.words import Body
from proprio_ros.robot import RobotModel

BAR = "#8a97a8"
JOINT = "#2a7f9e"
HAND = "#c7772a"
GROUND = "#eceff3"
SLIM = 0.03
"""Radius of a bar, of the arm's reach."""
HELD = "#3f8f5f"
GREY = [0.35, 0.39, 0.45]
ORANGE = [0.8, 0.4, 0.05]
POINT_M = 0.006
SEEN = 1e-3
"""What moves less is not seen [rad or m]."""
Ends = list[tuple[np.ndarray, bool]]


def ends_of(model: RobotModel) -> dict[str, Ends]:
    """By link, where its bars end in its own frame [m], shape (3,), and whether there is a joint that moves."""
    found: dict[str, Ends] = {link.name: [] for link in model.links}
    for joint in model.joints:
        found[joint.parent].append((joint.origin[:3, 3], joint.kind != "fixed"))
    for link in model.links:
        mass = float(link.pseudo_inertia[3, 3])
        if not found[link.name] and mass > 0.0:
            found[link.name].append((2.0 * link.pseudo_inertia[:3, 3] / mass, False))
    return found


def along(way: np.ndarray) -> np.ndarray:
    """A rotation that turns y, along which cylinders are made, to a way, shape (3, 3)."""
    to = way / np.linalg.norm(way)
    aside = np.cross(to, np.eye(3)[np.argmin(np.abs(to))])
    aside /= np.linalg.norm(aside)
    return np.column_stack(
        [
            np.cross(to, aside),
            to,
            aside,
        ]
    )


class Drawing:
    """An arm in a scene.

    Args:
        model: The arm.
        hand: Link that holds what is weighed.
    """

    def __init__(self, model: RobotModel, hand: str) -> None:
        self._model = model
        self._shown: dict[str, float] = {}
        self._body: Body | None = None
        ends = ends_of(model)
        reach = float(sum(np.linalg.norm(joint.origin[:3, 3]) for joint in model.joints)) or 1.0
        self.scene = _scene(reach)
        # the library goes on drawing what is no longer there
        self.scene.on("init", js_handler=f"() => endWhenGone({self.scene.id})")
        self._groups = {}
        with self.scene:
            for link in model.links:
                with self.scene.group() as group:
                    self._groups[link.name] = group
                    for at, turns in ends[link.name]:
                        _bar(self.scene, at, SLIM * reach, turns)
                    if link.name == hand:
                        self.scene.sphere(1.6 * SLIM * reach).material(HAND)
                        self._held = self.scene.sphere(1.0).material(HELD, opacity=0.6)
                        self._held.visible(False)

    def show(self, positions: Mapping[str, float]) -> None:
        """Where the joints are now [rad or m]; those that are not known stand at zero."""
        pose = {**dict.fromkeys(self._model.independent_joints, 0.0), **positions}
        if self._shown and all(abs(pose[name] - at) < SEEN for name, at in self._shown.items()):
            return
        self._shown = {name: pose[name] for name in self._model.independent_joints}
        for name, group in self._groups.items():
            place = self._model.frame_transform(name, pose)
            group.move(*place[:3, 3].tolist())
            group.rotate_R(place[:3, :3].tolist())

    def hold(self, body: Body | None) -> None:
        """Draw what is in the hand; None: nothing."""
        if body == self._body:
            return
        self._body = body
        self._held.visible(body is not None)
        if body is not None:
            self._held.move(*body.centre_m)
            self._held.scale(*body.half_m)

    def way(self, places: Places, colour: list[float]) -> None:
        """Draw where the hand will go."""
        with self.scene:
            self.scene.point_cloud(places, [colour] * len(places), POINT_M)


def _scene(reach: float) -> Scene:
    scene = ui.scene(
        width=720, height=460, grid=(4.0 * reach, 24), fps=15, background_color=GROUND
    ).classes("scene")
    scene.props('role="img" aria-label="The arm, as its joints stand now"')
    scene.move_camera(
        x=0.5 * reach,
        y=-0.85 * reach,
        z=0.6 * reach,
        look_at_x=0.1 * reach,
        look_at_z=0.25 * reach,
        duration=0.0,
    )
    return scene


def _bar(scene: Scene, at: np.ndarray, radius_m: float, turns: bool) -> None:
    """From the link's own origin to a point in its frame."""
    length = float(np.linalg.norm(at))
    if length > radius_m:
        bar = scene.cylinder(radius_m, radius_m, length, 16).material(BAR)
        bar.move(*(0.5 * at).tolist()).rotate_R(along(at).tolist())
    if turns:
        scene.sphere(1.5 * radius_m).move(*at.tolist()).material(JOINT)
