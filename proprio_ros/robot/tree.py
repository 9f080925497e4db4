"""The tree of links of a robot, and what is left of it when some of its joints are held.

The base frame is the frame of the root link, and gravity is given in it.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from proprio_ros.errors import RobotError
from proprio_ros.inputs.reading import LONGEST_TEXT
from proprio_ros.robot.geometry import FloatArray, frozen
from proprio_ros.robot.links import Joint, Link
from proprio_ros.robot.urdf import UrdfReader

STANDARD_GRAVITY = (0.0, 0.0, -9.81)  # m/s^2 in the base frame, z up


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """A robot with some joints held: n bodies that move, each everything between one active joint and the next."""

    joint_names: tuple[str, ...]  # active joints, parents before children, length n
    kinds: tuple[str, ...]  # 'revolute' or 'prismatic' of each, length n
    # index of the body that each joint stands on, -1 for the base, shape (n,)
    parents: NDArray[np.int64]
    placement: FloatArray  # parentbody_T_joint at position zero, shape (n, 4, 4)
    axes: FloatArray  # unit axis in each joint's frame, shape (n, 3)
    # of each body about its joint's frame, which moves with the body, shape (n, 4, 4)
    pseudo_inertia: FloatArray
    gravity: FloatArray  # in the base frame [m/s^2], shape (3,)
    # for every link the body that it belongs to (-1 for the base) and body_T_link
    frames: dict[str, tuple[int, FloatArray]]


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Kinematics and inertias of a robot: a tree of links."""

    name: str
    # links, joints: all, parents before children
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    root: str  # name of the root link; its frame is the base frame
    # notes, missing: what was taken for something else than the description states; which masses it lacks, a sentence each
    notes: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()

    @classmethod
    def from_urdf(cls, path: str | Path) -> RobotModel:
        """Read a URDF file; meshes, visuals, transmissions and simulator blocks are ignored.

        Raises `RobotError`: The file is missing or no XML, or it describes no physical tree of links.
        """
        path = Path(path)
        try:
            if path.exists() and not (path.is_file() or path.is_dir()):
                raise RobotError(f"{path}: is no file; give the path of a URDF file")
            with path.open("rb") as stream:
                text = stream.read(LONGEST_TEXT + 1)
        except OSError as error:
            raise RobotError(
                f"{path}: cannot be read ({error.strerror}); give the path of a URDF file"
            ) from error
        return cls(*UrdfReader(text, path.name).read())

    @classmethod
    def from_urdf_string(cls, text: str, source: str = "URDF") -> RobotModel:
        """As `from_urdf`, of text such as the content of ``/robot_description``; messages call it by its source."""
        return cls(*UrdfReader(text, source).read())

    @functools.cached_property
    def independent_joints(self) -> tuple[str, ...]:
        """Names of the joints that have a position of their own, parents before children."""
        return tuple(joint.name for joint in self.joints if joint.independent)

    @functools.cached_property
    def idle_joints(self) -> tuple[str, ...]:
        """Joints with a position of their own that move nothing with mass."""
        beyond = {}
        for link in self.links:
            beyond[link.name] = float(link.pseudo_inertia[3, 3])
        for joint in reversed(self.joints):
            beyond[joint.parent] += beyond[joint.child]
        idle = []
        for name in self.independent_joints:
            child = self.joint(name).child
            if beyond[child] <= 0.0:
                idle.append(name)
        return tuple(idle)

    @functools.cached_property
    def _joints_by_name(self) -> dict[str, Joint]:
        return {joint.name: joint for joint in self.joints}

    @functools.cached_property
    def _joints_by_child(self) -> dict[str, Joint]:
        return {joint.child: joint for joint in self.joints}

    def joint(self, name: str) -> Joint:
        """A joint by name. Raises `RobotError`: There is no such joint."""
        if name not in self._joints_by_name:
            raise RobotError(
                f"{self.name} has no joint {name!r}; its joints: {', '.join(self._joints_by_name) or 'none'}"
            )
        return self._joints_by_name[name]

    def driving(self, joint: Joint) -> tuple[str, float, float]:
        """The independent joint that a moving joint follows, through all its mimics: (name, multiplier, offset)."""
        name = joint.name
        multiplier = 1.0
        offset = 0.0
        while (mimic := self._joints_by_name[name].mimic) is not None:
            name = mimic[0]
            offset += multiplier * mimic[2]
            multiplier *= mimic[1]
        return name, multiplier, offset

    def _position(self, joint: Joint, positions: Mapping[str, float]) -> float:
        if joint.kind == "fixed":
            return 0.0
        name, multiplier, offset = self.driving(joint)
        if name not in positions:
            raise RobotError(
                f"no position of joint {name!r} of {self.name} is known: state it with --set held.{name}=VALUE"
            )
        position = float(positions[name])
        if not math.isfinite(position):
            raise RobotError(
                f"the position of joint {name!r} is {position}; it must be a finite number in rad or m"
            )
        return multiplier * position + offset

    def frame_transform(self, frame: str, positions: Mapping[str, float]) -> FloatArray:
        """Where a link is, by positions of the independent joints between it and the base [rad or m]: base_T_frame, shape (4, 4).

        Raises `RobotError`: The link is unknown, or a position is missing or not finite.
        """
        if frame != self.root and frame not in self._joints_by_child:
            links = ", ".join(link.name for link in self.links)
            raise RobotError(f"{self.name} has no link {frame!r}; its links: {links}")
        result = np.eye(4)
        while frame != self.root:
            joint = self._joints_by_child[frame]
            result = joint.transform(self._position(joint, positions)) @ result
            frame = joint.parent
        return result

    def lock(
        self,
        active: Sequence[str],
        positions: Mapping[str, float],
        gravity: ArrayLike = STANDARD_GRAVITY,
    ) -> ReducedModel:
        """Lock all joints but some, and merge what no longer moves against each other: one body for each active joint.

        Args:
            active: Joints that move, in any order.
            positions: Of all other independent joints [rad or m]. Those of active joints and of joints that follow another, or that
                the robot does not have, are not used. What stands beside the active joints, such as a head, may be left out.
            gravity: In the base frame [m/s^2], shape (3,).

        Raises:
            RobotError: An active joint is unknown, fixed, a follower, followed by another or named twice; a position is
                missing; a body that would move has no mass.
        """
        self._check_active(active)
        gravity = frozen(gravity)
        if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
            raise RobotError(
                "gravity must be three finite numbers in m/s^2, e.g. [0, 0, -9.81] where z is up"
            )
        inertias = {link.name: link.pseudo_inertia for link in self.links}
        matter = self._carrying(active)
        frames: dict[str, tuple[int, FloatArray]] = {self.root: (-1, frozen(np.eye(4)))}
        moving: list[Joint] = []
        parents = []
        placement = []
        bodies = list[FloatArray]()
        for joint in self.joints:
            body, body_from_parent = frames[joint.parent]
            if joint.name in active:
                parents.append(body)
                placement.append(body_from_parent @ joint.origin)
                bodies.append(np.zeros((4, 4)))
                body = len(moving)
                body_from_link = np.eye(4)
                moving.append(joint)
            else:
                beside = body < 0 and joint.name not in matter
                body_from_link = body_from_parent @ self._held(joint, positions, beside)
            frames[joint.child] = (body, frozen(body_from_link))
            if body >= 0:
                bodies[body] += body_from_link @ inertias[joint.child] @ body_from_link.T
        self._check_masses(moving, parents, bodies)
        parents_array = np.array(parents, dtype=np.int64)
        parents_array.setflags(write=False)
        return ReducedModel(
            joint_names=tuple(joint.name for joint in moving),
            kinds=tuple(
                "prismatic" if joint.kind == "prismatic" else "revolute" for joint in moving
            ),
            parents=parents_array,
            placement=frozen(placement),
            axes=frozen([joint.axis for joint in moving]),
            pseudo_inertia=frozen(bodies),
            gravity=gravity,
            frames=frames,
        )

    def _held(self, joint: Joint, positions: Mapping[str, float], beside: bool) -> FloatArray:
        """parent_T_child of a joint that does not move; of one ``beside`` all that move it may be unknown where it stands."""
        unknown = joint.kind != "fixed" and self.driving(joint)[0] not in positions
        at = 0.0 if beside and unknown else self._position(joint, positions)
        return joint.transform(at)

    def carriers(self, joints: Sequence[str]) -> tuple[str, ...]:
        """The joints on which all of some joints stand, as those of a torso, from the base on; none that follows or is followed."""
        followed = {self.driving(joint)[0] for joint in self.joints if joint.mimic is not None}
        carrying = [self._carrying([name]) - {name} for name in joints]
        common = set.intersection(*carrying) - followed if carrying else set()
        return tuple(name for name in self.independent_joints if name in common - {*joints})

    def beside(self, joints: Sequence[str]) -> set[str]:
        """The joints that neither carry some joints nor are carried by them, as of a head: where they stand changes nothing."""
        carrying = self._carrying(joints)
        behind = set(joints)
        links = {self.joint(name).child for name in joints}
        for joint in self.joints:
            if joint.parent in links:
                links.add(joint.child)
                behind.add(joint.name)
        return {*self.independent_joints} - carrying - behind

    def _carrying(self, joints: Sequence[str]) -> set[str]:
        """The joints on which some joints stand, and these."""
        carrying = set()
        for name in joints:
            joint: Joint | None = self.joint(name)
            while joint is not None and joint.name not in carrying:
                carrying.add(joint.name)
                joint = self._joints_by_child.get(joint.parent)
        return carrying

    def _check_active(self, active: Sequence[str]) -> None:
        choices = ", ".join(self.independent_joints) or "none"
        if not active:
            raise RobotError(f"no joint of {self.name} was chosen to move; choose from: {choices}")
        for name in active:
            joint = self.joint(name)
            if joint.kind == "fixed":
                raise RobotError(
                    f"joint {name!r} of {self.name} is fixed and cannot move; choose from: {choices}"
                )
            if joint.mimic is not None:
                raise RobotError(
                    f"joint {name!r} of {self.name} only follows {joint.mimic[0]!r}; choose from: {choices}"
                )
            if list(active).count(name) > 1:
                raise RobotError(
                    f"joint {name!r} of {self.name} was chosen to move twice; name it once"
                )
        for joint in self.joints:
            if joint.mimic is not None and (source := self.driving(joint)[0]) in active:
                raise RobotError(
                    f"joint {source!r} of {self.name} drives {joint.name!r} too, and one motor for two joints is not "
                    "modelled here; choose another joint to move"
                )

    def _check_masses(
        self,
        moving: Sequence[Joint],
        parents: Sequence[int],
        bodies: Sequence[FloatArray],
    ) -> None:
        """Refuse bodies without mass, but those between axes that meet in one place."""
        unknown = {link.name for link in self.links if link.unknown}
        own = [float(pseudo[3, 3]) for pseudo in bodies]
        beyond = own.copy()
        for body in reversed(range(len(bodies))):
            if parents[body] >= 0:
                beyond[parents[body]] += beyond[body]
        for body, joint in enumerate(moving):
            is_lacking = own[body] <= 0.0 and joint.child in unknown
            if is_lacking or beyond[body] <= 0.0:
                raise RobotError(
                    f"nothing that moves with joint {joint.name!r} of {self.name} has mass: "
                    f"give link {joint.child!r} an <inertial>, or hold the joint"
                )

    def fingerprint(self) -> str:
        """SHA-256 of kinematics and inertias, as hex digits: what a calibration depends on, and nothing else.

        Limits, shapes and the order of elements do not enter; neither does the last bit of a number, which may differ
        between machines.
        """

        def digits(values: ArrayLike) -> list[str]:
            numbers = np.ravel(np.asarray(values, dtype=np.float64))
            scale = float(np.abs(numbers).max()) or 1.0
            # adding zero makes a rounded -0 the same as 0
            return [
                f"{scale:.11e}",
                *(f"{value:.12f}" for value in np.round(numbers / scale, 12) + 0.0),
            ]

        joints = sorted(
            [joint.name, joint.kind, joint.parent, joint.child, digits(joint.origin)]
            + ([] if joint.kind == "fixed" else [digits(joint.axis)])
            + ([] if joint.mimic is None else [joint.mimic[0], digits(joint.mimic[1:])])
            for joint in self.joints
        )
        # a mass that the description does not state is none of it
        stated = {link.name: float(link.spread.mass == 0.0) for link in self.links}
        links = sorted(
            [link.name, digits(stated[link.name] * link.pseudo_inertia)] for link in self.links
        )
        return hashlib.sha256(json.dumps([self.root, joints, links]).encode()).hexdigest()
