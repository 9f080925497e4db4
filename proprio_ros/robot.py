"""A robot as numbers: the tree of links from its URDF, and the drive train of each joint from its YAML file.

Conventions. ``a_T_b`` takes coordinates in frame b to frame a. A joint's frame moves with it: the child link's frame is
``parent_T_child(q) = origin @ motion(axis, q)``, as URDF defines it. The base frame is the frame of the root link, and
gravity is given in it.

Inertia is kept as the 4 x 4 pseudo-inertia ``P = [[Sigma, h], [h^T, m]]``, with the second moments
``Sigma = int r r^T dm`` and the first moments ``h = m c`` about the frame's origin. It moves between frames as
``T P T^T``, adds up over rigidly joined bodies, and belongs to a physical body exactly when it is positive semidefinite
(Wensing, Kim and Slotine, "Linear Matrix Inequalities for Physically-Consistent Inertial Parameter Identification",
RA-L 2018).
"""

from __future__ import annotations

import copy
import difflib
import functools
import hashlib
import itertools
import json
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from proprio_ros.calibration import Calibration
from proprio_ros.errors import RobotError
from proprio_ros.kinds import Key
from proprio_ros.quantity import Quantity
from proprio_ros.resources import resource, resource_names

FloatArray = NDArray[np.float64]

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2 in the base frame, z up."""

JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")
_ROUNDING = 1e-9  # relative; inertias are printed with eight digits or more


def _frozen(values: ArrayLike) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


# ------------------------------------------------------------------------------------------------------------- geometry


def rotation_from_rpy(rpy: ArrayLike) -> FloatArray:
    """Rotation matrix from URDF's roll, pitch and yaw about fixed axes: ``Rz(yaw) Ry(pitch) Rx(roll)``.

    Args:
        rpy: Angles [rad], shape (3,).

    Returns:
        Shape (3, 3).
    """
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64)
    return (
        rotation_about((0.0, 0.0, 1.0), yaw)
        @ rotation_about((0.0, 1.0, 0.0), pitch)
        @ rotation_about((1.0, 0.0, 0.0), roll)
    )


def rotation_about(axis: ArrayLike, angle: float) -> FloatArray:
    """Rotation matrix from a unit axis and an angle [rad] (Rodrigues' formula), shape (3, 3)."""
    x, y, z = np.asarray(axis, dtype=np.float64)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    return rotation


def transform(rotation: ArrayLike, translation: ArrayLike) -> FloatArray:
    """Homogeneous transform from a rotation matrix (3, 3) and a translation [m] (3,), shape (4, 4)."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = translation
    return result


def motion(kind: str, axis: ArrayLike, position: float) -> FloatArray:
    """What a joint adds to its origin when it moves.

    Args:
        kind: One of `JOINT_KINDS`.
        axis: Unit axis in the joint frame, shape (3,).
        position: Joint position [rad, or m for a prismatic joint].

    Returns:
        Transform, shape (4, 4).
    """
    if kind == "prismatic":
        return transform(np.eye(3), np.asarray(axis, dtype=np.float64) * position)
    if kind == "fixed":
        return np.eye(4)
    return transform(rotation_about(axis, position), np.zeros(3))


# -------------------------------------------------------------------------------------------------------------- inertia


def pseudo_inertia(mass: float, com: ArrayLike, inertia_about_com: ArrayLike) -> FloatArray:
    """Pseudo-inertia about a frame's origin.

    Args:
        mass: [kg].
        com: Centre of mass [m], shape (3,).
        inertia_about_com: Rotational inertia about the centre of mass, in the frame's axes [kg m^2], shape (3, 3).

    Returns:
        Shape (4, 4).
    """
    com = np.asarray(com, dtype=np.float64)
    inertia = np.asarray(inertia_about_com, dtype=np.float64)
    result = np.empty((4, 4))
    result[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia + mass * np.outer(com, com)
    result[:3, 3] = result[3, :3] = mass * com
    result[3, 3] = mass
    return result


def inertia_about_origin(pseudo: ArrayLike) -> FloatArray:
    """Rotational inertia about the frame's origin [kg m^2], shape (3, 3), of a pseudo-inertia (4, 4)."""
    second = np.asarray(pseudo, dtype=np.float64)[:3, :3]
    inertia: FloatArray = np.trace(second) * np.eye(3) - second
    return inertia


# ----------------------------------------------------------------------------------------------------------------- tree


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint of the tree.

    Attributes:
        name: Its name in the URDF.
        kind: One of `JOINT_KINDS`.
        parent: Link it stands on.
        child: Link it carries.
        origin: parent_T_joint at position zero, shape (4, 4).
        axis: Unit axis in the joint frame, shape (3,).
        lower: Smallest position [rad or m], -inf when there is none.
        upper: Largest position [rad or m], inf when there is none.
        velocity_limit: [rad/s or m/s], inf when there is none.
        effort_limit: [N m or N], inf when there is none.
        mimic: (source joint, multiplier, offset) of a joint that follows another; None for an independent one.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: FloatArray
    axis: FloatArray
    lower: float
    upper: float
    velocity_limit: float
    effort_limit: float
    mimic: tuple[str, float, float] | None = None

    @property
    def independent(self) -> bool:
        """Whether the joint has a position of its own."""
        return self.kind != "fixed" and self.mimic is None

    def transform(self, position: float) -> FloatArray:
        """parent_T_child at a position [rad or m], shape (4, 4)."""
        result: FloatArray = self.origin @ motion(self.kind, self.axis, position)
        return result


@dataclass(frozen=True, eq=False)
class Link:
    """One link of the tree.

    Attributes:
        name: Its name in the URDF.
        pseudo_inertia: About the link's frame, shape (4, 4); zeros when the URDF gives no inertial.
    """

    name: str
    pseudo_inertia: FloatArray


@dataclass(frozen=True, eq=False)
class ReducedModel:
    """A robot with some joints held: n bodies that move, each everything between one active joint and the next.

    Attributes:
        joint_names: Active joints, parents before children, length n.
        kinds: 'revolute' or 'prismatic' of each, length n.
        parents: Index of the body that each joint stands on, -1 for the base, shape (n,).
        placement: parentbody_T_joint at position zero, shape (n, 4, 4).
        axes: Unit axis in each joint's frame, shape (n, 3).
        pseudo_inertia: Of each body about its joint's frame, which moves with the body, shape (n, 4, 4).
        gravity: In the base frame [m/s^2], shape (3,).
        frames: For every link the body that it belongs to (-1 for the base) and body_T_link.
    """

    joint_names: tuple[str, ...]
    kinds: tuple[str, ...]
    parents: NDArray[np.int64]
    placement: FloatArray
    axes: FloatArray
    pseudo_inertia: FloatArray
    gravity: FloatArray
    frames: dict[str, tuple[int, FloatArray]]


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Kinematics and inertias of a robot: a tree of links.

    Attributes:
        name: The robot's name in the URDF.
        links: All links, parents before children.
        joints: All joints, parents before children.
        root: Name of the root link; its frame is the base frame.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    root: str

    @classmethod
    def from_urdf(cls, path: str | Path) -> RobotModel:
        """Read a URDF file; meshes, visuals, transmissions and simulator blocks are ignored.

        Raises:
            RobotError: The file is missing or no XML, or it describes no physical tree of links.
        """
        path = Path(path)
        try:
            text = path.read_bytes()
        except OSError as error:
            raise RobotError(f"{path}: cannot be read ({error.strerror}); give the path of a URDF file") from error
        return _UrdfReader(text, path.name).model()

    @classmethod
    def from_urdf_string(cls, text: str) -> RobotModel:
        """Read URDF text, such as the content of ``/robot_description``.

        Raises:
            RobotError: As for `from_urdf`.
        """
        return _UrdfReader(text, "URDF").model()

    @functools.cached_property
    def independent_joints(self) -> tuple[str, ...]:
        """Names of the joints that have a position of their own, parents before children."""
        return tuple(joint.name for joint in self.joints if joint.independent)

    @functools.cached_property
    def _joints_by_name(self) -> dict[str, Joint]:
        return {joint.name: joint for joint in self.joints}

    @functools.cached_property
    def _joints_by_child(self) -> dict[str, Joint]:
        return {joint.child: joint for joint in self.joints}

    def joint(self, name: str) -> Joint:
        """A joint by name.

        Raises:
            RobotError: There is no such joint.
        """
        if name not in self._joints_by_name:
            raise RobotError(
                f"{self.name} has no joint {name!r}; its joints: {', '.join(self._joints_by_name) or 'none'}"
            )
        return self._joints_by_name[name]

    def _driving(self, joint: Joint) -> tuple[str, float, float]:
        """The independent joint that a moving joint follows, through all its mimics: (name, multiplier, offset)."""
        name, multiplier, offset = joint.name, 1.0, 0.0
        while (mimic := self._joints_by_name[name].mimic) is not None:
            name = mimic[0]
            offset += multiplier * mimic[2]
            multiplier *= mimic[1]
        return name, multiplier, offset

    def _position(self, joint: Joint, positions: Mapping[str, float]) -> float:
        if joint.kind == "fixed":
            return 0.0
        name, multiplier, offset = self._driving(joint)
        if name not in positions:
            raise RobotError(
                f"no position of joint {name!r} of {self.name} is known: state it with --set held.{name}=VALUE"
            )
        position = float(positions[name])
        if not math.isfinite(position):
            raise RobotError(f"the position of joint {name!r} is {position}; it must be a finite number in rad or m")
        return multiplier * position + offset

    def frame_transform(self, frame: str, positions: Mapping[str, float]) -> FloatArray:
        """Where a link is.

        Args:
            frame: Name of the link.
            positions: Positions of at least the independent joints between base and link [rad or m].

        Returns:
            base_T_frame, shape (4, 4).

        Raises:
            RobotError: The link is unknown, or a position is missing or not finite.
        """
        if frame != self.root and frame not in self._joints_by_child:
            raise RobotError(
                f"{self.name} has no link {frame!r}; its links: {', '.join(link.name for link in self.links)}"
            )
        result = np.eye(4)
        while frame != self.root:
            joint = self._joints_by_child[frame]
            result = joint.transform(self._position(joint, positions)) @ result
            frame = joint.parent
        return result

    def lock(
        self, active: Sequence[str], positions: Mapping[str, float], gravity: ArrayLike = STANDARD_GRAVITY
    ) -> ReducedModel:
        """Hold all joints but some, and merge what no longer moves against each other.

        Args:
            active: Joints that move, in any order.
            positions: Positions of all other independent joints [rad or m]. Those of active joints and of joints that
                follow another, or that the robot does not have, are not used.
            gravity: In the base frame [m/s^2], shape (3,).

        Returns:
            One body for each active joint.

        Raises:
            RobotError: An active joint is unknown, fixed, a follower, followed by another or named twice; a position is
                missing; a body that would move has no mass.
        """
        self._check_active(active)
        gravity = _frozen(gravity)
        if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
            raise RobotError("gravity must be three finite numbers in m/s^2, e.g. [0, 0, -9.81] where z is up")
        inertias = {link.name: link.pseudo_inertia for link in self.links}
        frames: dict[str, tuple[int, FloatArray]] = {self.root: (-1, _frozen(np.eye(4)))}
        moving: list[Joint] = []
        parents: list[int] = []
        placement: list[FloatArray] = []
        bodies: list[FloatArray] = []
        for joint in self.joints:
            body, body_from_parent = frames[joint.parent]
            if joint.name in active:
                parents.append(body)
                placement.append(body_from_parent @ joint.origin)
                bodies.append(np.zeros((4, 4)))
                body, body_from_link = len(moving), np.eye(4)
                moving.append(joint)
            else:
                body_from_link = body_from_parent @ joint.transform(self._position(joint, positions))
            frames[joint.child] = (body, _frozen(body_from_link))
            if body >= 0:
                bodies[body] += body_from_link @ inertias[joint.child] @ body_from_link.T
        for joint, pseudo in zip(moving, bodies, strict=True):
            if pseudo[3, 3] <= 0.0:
                raise RobotError(
                    f"nothing that moves with joint {joint.name!r} of {self.name} has mass: "
                    f"give link {joint.child!r} an <inertial>, or hold the joint"
                )
        parents_array = np.array(parents, dtype=np.int64)
        parents_array.setflags(write=False)
        return ReducedModel(
            joint_names=tuple(joint.name for joint in moving),
            kinds=tuple("prismatic" if joint.kind == "prismatic" else "revolute" for joint in moving),
            parents=parents_array,
            placement=_frozen(placement),
            axes=_frozen([joint.axis for joint in moving]),
            pseudo_inertia=_frozen(bodies),
            gravity=gravity,
            frames=frames,
        )

    def _check_active(self, active: Sequence[str]) -> None:
        choices = ", ".join(self.independent_joints) or "none"
        if not active:
            raise RobotError(f"no joint of {self.name} was chosen to move; choose from: {choices}")
        for name in active:
            joint = self.joint(name)
            if joint.kind == "fixed":
                raise RobotError(f"joint {name!r} of {self.name} is fixed and cannot move; choose from: {choices}")
            if joint.mimic is not None:
                raise RobotError(
                    f"joint {name!r} of {self.name} only follows {joint.mimic[0]!r}; choose from: {choices}"
                )
            if list(active).count(name) > 1:
                raise RobotError(f"joint {name!r} of {self.name} was chosen to move twice; name it once")
        for joint in self.joints:
            if joint.mimic is not None and (source := self._driving(joint)[0]) in active:
                raise RobotError(
                    f"joint {source!r} of {self.name} drives {joint.name!r} too, and one motor for two joints is not "
                    "modelled here; choose another joint to move"
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
            return [f"{scale:.11e}", *(f"{value:.12f}" for value in np.round(numbers / scale, 12) + 0.0)]

        joints = sorted(
            [joint.name, joint.kind, joint.parent, joint.child, digits(joint.origin)]
            + ([] if joint.kind == "fixed" else [digits(joint.axis)])
            + ([] if joint.mimic is None else [joint.mimic[0], digits(joint.mimic[1:])])
            for joint in self.joints
        )
        links = sorted([link.name, digits(link.pseudo_inertia)] for link in self.links)
        return hashlib.sha256(json.dumps([self.root, joints, links]).encode()).hexdigest()


class _UrdfReader:
    """Reads one URDF document; every problem becomes one line that names the file, the element and the remedy."""

    def __init__(self, text: str | bytes, source: str) -> None:
        self._source = source
        try:
            self._robot = ElementTree.fromstring(text)
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise RobotError(f"{source}: not XML ({error}); give a URDF file") from error
        if self._robot.tag != "robot":
            raise RobotError(f"{source}: the document is a <{self._robot.tag}>, not a <robot>; give a URDF file")
        if any("xacro}" in str(element.tag) for element in self._robot.iter()):
            raise RobotError(f"{source}: holds xacro macros; expand it first: xacro {source} > robot.urdf")

    def _fail(self, message: str) -> NoReturn:
        raise RobotError(f"{self._source}: {message}")

    def model(self) -> RobotModel:
        links = self._unique("link", [self._link(element) for element in self._robot.findall("link")])
        if not links:
            self._fail("the robot has no <link>")
        joints = self._unique("joint", [self._joint(element) for element in self._robot.findall("joint")])
        for joint in joints.values():
            for role, name in (("parent", joint.parent), ("child", joint.child)):
                if name not in links:
                    self._fail(f"joint {joint.name!r} names an unknown {role} link {name!r}; links: {', '.join(links)}")
        self._check_mimics(joints)
        root = self._root(links, joints)
        ordered = self._ordered(root, links, joints)
        return RobotModel(
            name=self._robot.get("name") or "robot",
            links=(links[root], *(links[joint.child] for joint in ordered)),
            joints=tuple(ordered),
            root=root,
        )

    def _unique(self, what: str, items: list[Any]) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for item in items:
            if item.name in result:
                self._fail(f"two {what}s are named {item.name!r}; give each a name of its own")
            result[item.name] = item
        return result

    def _name(self, element: ElementTree.Element) -> str:
        name = element.get("name")
        if not name:
            self._fail(f"a <{element.tag}> has no name; give it one")
        return name

    def _numbers(
        self, element: ElementTree.Element, attribute: str, where: str, default: str | None = None
    ) -> list[float]:
        text = element.get(attribute, default)
        if text is None:
            self._fail(f"{where}: <{element.tag}> has no {attribute}; add it")
        try:
            values = [float(part) for part in text.split()]
        except ValueError:
            self._fail(f"{where}: {attribute}={text!r} of <{element.tag}> is no number")
        if not all(math.isfinite(value) for value in values):
            self._fail(f"{where}: {attribute}={text!r} of <{element.tag}> must be finite")
        return values

    def _number(self, element: ElementTree.Element, attribute: str, where: str, default: str | None = None) -> float:
        values = self._numbers(element, attribute, where, default)
        if len(values) != 1:
            self._fail(f"{where}: {attribute} of <{element.tag}> must be one number, got {len(values)}")
        return values[0]

    def _vector(self, element: ElementTree.Element, attribute: str, where: str, default: str) -> FloatArray:
        values = self._numbers(element, attribute, where, default)
        if len(values) != 3:
            self._fail(f"{where}: {attribute} of <{element.tag}> must be three numbers, got {len(values)}")
        return np.array(values)

    def _origin(self, element: ElementTree.Element, where: str) -> FloatArray:
        origin = element.find("origin")
        if origin is None:
            return np.eye(4)
        rotation = rotation_from_rpy(self._vector(origin, "rpy", where, "0 0 0"))
        return transform(rotation, self._vector(origin, "xyz", where, "0 0 0"))

    def _link(self, element: ElementTree.Element) -> Link:
        name = self._name(element)
        where = f"link {name!r}"
        inertial = element.find("inertial")
        if inertial is None:
            return Link(name, _frozen(np.zeros((4, 4))))
        mass_element, inertia_element = inertial.find("mass"), inertial.find("inertia")
        if mass_element is None or inertia_element is None:
            self._fail(f"{where}: <inertial> needs both <mass> and <inertia>; leave it out for a frame without mass")
        mass = self._number(mass_element, "value", where)
        if mass <= 0.0:
            self._fail(f"{where}: mass must be positive, got {mass} kg; leave <inertial> out for a frame without mass")
        xx, xy, xz, yy, yz, zz = (
            self._number(inertia_element, key, where) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        smallest, middle, largest = np.linalg.eigvalsh(inertia)
        if smallest <= 0.0:
            self._fail(
                f"{where}: the inertia is not positive definite (principal moments {smallest:.4g}, {middle:.4g}, "
                f"{largest:.4g} kg m^2): no body has it; take it from the CAD model or a solid of that size"
            )
        if largest > (smallest + middle) * (1.0 + _ROUNDING):
            self._fail(
                f"{where}: the inertia breaks the triangle inequality (principal moments {smallest:.4g}, {middle:.4g}, "
                f"{largest:.4g} kg m^2; none may exceed the sum of the others): no body has it; check units and signs"
            )
        link_from_inertial = self._origin(inertial, where)
        central = pseudo_inertia(mass, np.zeros(3), inertia)
        return Link(name, _frozen(link_from_inertial @ central @ link_from_inertial.T))

    def _joint(self, element: ElementTree.Element) -> Joint:
        name = self._name(element)
        where = f"joint {name!r}"
        kind = element.get("type", "")
        if kind not in JOINT_KINDS:
            self._fail(f"{where}: type {kind!r} is not supported; supported: {', '.join(JOINT_KINDS)}")
        ends = {}
        for role in ("parent", "child"):
            end = element.find(role)
            link = None if end is None else end.get("link")
            if not link:
                self._fail(f"{where}: has no <{role} link=.../>; add it")
            ends[role] = link
        axis = np.array([1.0, 0.0, 0.0])
        axis_element = element.find("axis")
        if axis_element is not None and kind != "fixed":
            axis = self._vector(axis_element, "xyz", where, "1 0 0")
            length = float(np.linalg.norm(axis))
            if length < 1e-9:
                self._fail(f"{where}: the axis is zero; give it a direction, e.g. 0 0 1")
            axis = axis / length
        lower, upper, velocity, effort = self._limits(element, kind, where)
        return Joint(
            name=name,
            kind=kind,
            parent=ends["parent"],
            child=ends["child"],
            origin=_frozen(self._origin(element, where)),
            axis=_frozen(axis),
            lower=lower,
            upper=upper,
            velocity_limit=velocity,
            effort_limit=effort,
            mimic=self._mimic(element, kind, where),
        )

    def _limits(self, element: ElementTree.Element, kind: str, where: str) -> tuple[float, float, float, float]:
        lower, upper, velocity, effort = -math.inf, math.inf, math.inf, math.inf
        limit = element.find("limit")
        if kind in ("revolute", "prismatic"):
            if limit is None or limit.get("lower") is None or limit.get("upper") is None:
                advice = ", or make it continuous" if kind == "revolute" else ""
                self._fail(f"{where}: a {kind} joint needs <limit lower=.. upper=../>; add it{advice}")
            lower, upper = self._number(limit, "lower", where), self._number(limit, "upper", where)
            if lower > upper:
                self._fail(f"{where}: the lower limit {lower} is above the upper limit {upper}; swap them")
        if limit is not None and kind != "fixed":
            if limit.get("velocity") is not None:
                velocity = self._number(limit, "velocity", where)
            if limit.get("effort") is not None:
                effort = self._number(limit, "effort", where)
            if velocity < 0.0 or effort < 0.0:
                self._fail(f"{where}: limits of velocity and effort must not be negative, got {velocity} and {effort}")
        return lower, upper, velocity, effort

    def _mimic(self, element: ElementTree.Element, kind: str, where: str) -> tuple[str, float, float] | None:
        mimic = element.find("mimic")
        if mimic is None or kind == "fixed":
            return None
        source = mimic.get("joint")
        if not source:
            self._fail(f"{where}: <mimic> names no joint; add joint=..")
        return source, self._number(mimic, "multiplier", where, "1"), self._number(mimic, "offset", where, "0")

    def _check_mimics(self, joints: Mapping[str, Joint]) -> None:
        for joint in joints.values():
            seen = [joint.name]
            mimic = joint.mimic
            while mimic is not None:
                source = mimic[0]
                if source not in joints:
                    self._fail(f"joint {seen[-1]!r} mimics an unknown joint {source!r}; joints: {', '.join(joints)}")
                if joints[source].kind == "fixed":
                    self._fail(f"joint {seen[-1]!r} mimics {source!r}, which is fixed; let it mimic a joint that moves")
                if source in seen:
                    self._fail(
                        f"joints mimic each other in a circle: {' -> '.join([*seen, source])}; leave one independent"
                    )
                seen.append(source)
                mimic = joints[source].mimic

    def _root(self, links: Mapping[str, Link], joints: Mapping[str, Joint]) -> str:
        carrier: dict[str, str] = {}
        for joint in joints.values():
            if joint.child in carrier:
                self._fail(
                    f"link {joint.child!r} is the child of both {carrier[joint.child]!r} and {joint.name!r}: "
                    "closed loops are not supported; cut the loop at one joint"
                )
            carrier[joint.child] = joint.name
        roots = [name for name in links if name not in carrier]
        if not roots:
            self._fail(f"the joints form a loop and no link is the root; cut it at one of: {', '.join(joints)}")
        if len(roots) > 1:
            self._fail(f"several links have no parent: {', '.join(roots)}; join them to one root with fixed joints")
        return roots[0]

    def _ordered(self, root: str, links: Mapping[str, Link], joints: Mapping[str, Joint]) -> list[Joint]:
        children: dict[str, list[Joint]] = {name: [] for name in links}
        for joint in joints.values():
            children[joint.parent].append(joint)
        ordered: list[Joint] = []
        waiting = list(reversed(children[root]))
        while waiting:
            joint = waiting.pop()
            ordered.append(joint)
            waiting.extend(reversed(children[joint.child]))
        if len(ordered) < len(joints):
            reached = {joint.name for joint in ordered}
            loop = [name for name in joints if name not in reached]
            self._fail(
                f"joints {', '.join(loop)} form a loop apart from the tree; let one of them start at a link of it"
            )
        return ordered


# --------------------------------------------------------------------------------------------------------- drive trains


@dataclass(frozen=True)
class Motor:
    """What the driver needs to know of a joint's motor.

    Attributes:
        model: Name of the model, empty when it is not driven by this package.
        id: Its number on the bus; None when it is not on one.
        current_limit_A: Largest current that may be commanded [A].
    """

    model: str
    id: int | None
    current_limit_A: float


@dataclass(frozen=True)
class FingerTravel:
    """How far one finger is open at some angles of its motor, as measured: linkages do not open evenly.

    Attributes:
        at_rad: Of the motor's output shaft, rising, length 2 or more.
        open_m: Of one finger, from anywhere [m], rising with the angle.
    """

    at_rad: tuple[float, ...]
    open_m: tuple[float, ...]

    @functools.cached_property
    def coefficients(self) -> tuple[float, float, float]:
        """Travel of the finger by the first three powers of the angle [m/rad, m/rad^2, m/rad^3], by least squares.

        Two measurements give a line, three or four a parabola, more a cubic.
        """
        degree = {2: 1, 3: 2, 4: 2}.get(len(self.at_rad), 3)
        fitted = np.polynomial.Polynomial.fit(self.at_rad, self.open_m, degree).convert().coef
        slopes = [*map(float, fitted[1:]), 0.0, 0.0]
        return slopes[0], slopes[1], slopes[2]

    @property
    def mean_ratio(self) -> float:
        """From the first angle to the last [m/rad]."""
        return (self.open_m[-1] - self.open_m[0]) / (self.at_rad[-1] - self.at_rad[0])

    def ratio_at(self, angle_rad: ArrayLike) -> FloatArray:
        """How far the finger moves per rad at some angles [m/rad]."""
        angle = np.asarray(angle_rad, dtype=np.float64)
        first, second, third = self.coefficients
        ratio: FloatArray = first + angle * (2.0 * second + 3.0 * third * angle)
        return ratio


@dataclass(frozen=True)
class DriveTrain:
    """Motor and gears of a joint, all seen at the motor's output shaft.

    The torque that reaches the joint is ``torque_constant x current - armature x acceleration``, less friction against
    the motion: ``(coulomb + load_friction x |torque|) x (1 + stribeck x exp(-(velocity / stribeck_velocity)^2)) + viscous
    x |velocity|``.

    Attributes:
        torque_constant: [N m/A].
        coulomb: Dry friction [N m].
        viscous: [N m s/rad].
        load_friction: Part of the motor's torque that the gears lose.
        armature: Inertia of rotor and gears [kg m^2].
        zero: True position minus reading [rad].
        nominal_torque_constant: What published efforts were made with [N m/A].
        supply_voltage_V: 0 when the supply does not limit the current.
        back_emf_V_s_per_rad: Voltage that the motor makes per speed.
        resistance_ohm: Of the winding.
        usable_velocity: Faster samples are left out [rad/s].
        encoder_resolution: One count [rad].
        encoder_noise: Standard deviation of a reading, beyond rounding [rad].
        transmission: Joint position per shaft position: 1 when the motor sits in the joint, m/rad for a finger (each of
            two fingers moves this far).
        encoder_once_per_turn: Standard deviation of the sine and of the cosine part of the encoder's once-per-turn
            error, which a magnet off the axis makes [rad].
        stribeck: By how much of itself dry friction is greater at rest.
        stribeck_velocity: Speed at which 1/e of that is left [rad/s].
        finger_travel: What was measured of a finger's travel, for squeezes alone: published positions count with `transmission`.
    """

    torque_constant: Quantity
    coulomb: Quantity
    viscous: Quantity
    load_friction: Quantity
    armature: Quantity
    zero: Quantity
    nominal_torque_constant: float
    supply_voltage_V: float
    back_emf_V_s_per_rad: float
    resistance_ohm: float
    usable_velocity: float
    encoder_resolution: float
    encoder_noise: float
    transmission: float = 1.0
    encoder_once_per_turn: float = 0.0
    stribeck: Quantity = field(default_factory=lambda: Quantity(0.0))
    stribeck_velocity: Quantity = field(default_factory=lambda: Quantity(0.1))
    finger_travel: FingerTravel | None = None

    @property
    def travel_coefficients(self) -> tuple[float, float, float]:
        """What a squeeze takes for the finger's travel, as `FingerTravel.coefficients` are."""
        return (self.transmission, 0.0, 0.0) if self.finger_travel is None else self.finger_travel.coefficients

    @property
    def nominal_effort_per_current(self) -> float:
        """What published efforts are over the motor's current, at the joint: N m per A, N per A where it pushes a slide."""
        return self.nominal_torque_constant / self.transmission


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot with its drive trains, as its YAML file states it.

    Attributes:
        name: Its name.
        model: Tree of links.
        drive_trains: By joint; joints without a motor have none.
        motors: By joint, the same joints.
        delay: From the stamp of a command to torque, less that of a position [s].
        arm_scale: All masses of the model times this.
        stamp_jitter_s: Standard deviation of the stamps.
        onset_jitter_s: Standard deviation of the delay from run to run.
        torque_disturbance: Standard deviation of a torque that is there in one run and not in the next, such as friction
            that is not the same every time [N m].
        start_velocity: Standard deviation of the velocity at which a held joint is when its probe begins [rad/s].
        link_mass_std, link_com_std, link_inertia_std: How far a single link lies off the URDF, beyond `arm_scale`:
            relative mass, each coordinate of its centre of mass [m], relative inertia about it.
        residual_scale: Residuals of a calibration over what encoder and stamps explain.
        calibration: What is known about this very arm, with all correlations; None when the file's numbers stand alone.
        friction_velocity: Coulomb's law is smoothed over this speed [rad/s].
        payload_frame: Link in which objects are held.
        gravity: In the base frame [m/s^2], shape (3,).
        source: The YAML file.
        settings: The YAML file's content with everything it extends merged in; `with_overrides` builds on it.
    """

    name: str
    model: RobotModel
    drive_trains: dict[str, DriveTrain]
    motors: dict[str, Motor]
    delay: Quantity
    arm_scale: Quantity
    stamp_jitter_s: float
    friction_velocity: float
    payload_frame: str
    gravity: FloatArray
    source: Path
    settings: Mapping[str, Any] = field(default_factory=dict, repr=False)
    onset_jitter_s: float = 0.0
    torque_disturbance: float = 0.0
    start_velocity: float = 0.01
    link_mass_std: float = 0.0
    link_com_std: float = 0.0
    link_inertia_std: float = 0.0
    residual_scale: float = 1.0
    calibration: Calibration | None = None

    def is_calibrated(self, joints: Iterable[str] | None = None) -> bool:
        """Whether the numbers come from this very arm, as its file says and as every calibration does.

        Args:
            joints: Whether a calibration has learnt the drive trains of all of these; a file that only says so has learnt none.
        """
        if joints is None:
            return self.calibration is not None or bool(self.settings.get("calibrated"))
        return self.calibration is not None and set(joints) <= set(self.calibration.joints)

    def with_overrides(self, overrides: Mapping[str, Any]) -> Robot:
        """The same robot with some settings replaced.

        Args:
            overrides: By dotted key, such as ``joints.joint3.drive_train.coulomb_N_m``. A number replaces a quantity
                and is known exactly; ``{"std": 0.01}`` changes only what it names.

        Raises:
            RobotError: A key is unknown or a value does not fit it.
        """
        settings = _merged(copy.deepcopy(dict(self.settings)), nested_settings(self.model, overrides))
        settings.pop("calibration", None)
        robot = _robot(settings, self.source, self.model)
        if self.calibration is None:
            return robot
        # what the user states stands beside the calibration and replaces its number
        paths = _override_paths(self.model.independent_joints)
        stated = {_unknown_of(paths[key]) for key in overrides}
        return robot.with_calibration(self.calibration.without(stated))

    def with_calibration(self, calibration: Calibration) -> Robot:
        """The same robot with the numbers of its calibration, and their correlations.

        Raises:
            RobotError: The calibration is of a joint that the robot does not drive.
        """
        foreign = [joint for joint in calibration.joints if joint not in self.drive_trains]
        if foreign:
            raise RobotError(
                f"{self.source.name}: the calibration is of {', '.join(foreign)}, but {self.name} drives "
                f"{', '.join(self.drive_trains)}: calibrate this robot"
            )
        known = calibration.quantities
        drives = {}
        for joint, drive in self.drive_trains.items():
            terms: dict[str, Any] = {term: known.get((term, joint), getattr(drive, term)) for term in _CALIBRATED_TERMS}
            drives[joint] = replace(drive, **terms)
        return replace(
            self,
            drive_trains=drives,
            arm_scale=known.get("arm_scale", self.arm_scale),
            delay=known.get("delay", self.delay),
            torque_disturbance=calibration.torque_disturbance,
            start_velocity=calibration.start_velocity,
            residual_scale=calibration.residual_scale,
            stamp_jitter_s=calibration.stamp_jitter_s,
            calibration=calibration,
        )


# ----------------------------------------------------------------------------------------------------------- YAML files

_REQUIRED = object()


@dataclass(frozen=True)
class _Field:
    """One key of the file: how to read it, and what holds when it is absent."""

    read: Callable[[Any, str], Any]
    default: Any = _REQUIRED


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value:
        raise RobotError(f"{where}: expected a text, got {value!r}")
    return value


def _truth(value: Any, where: str) -> bool:
    if not isinstance(value, bool):
        raise RobotError(f"{where}: expected true or false, got {value!r}")
    return value


def _real(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise RobotError(f"{where}: expected a number, got {value!r}")
    if not math.isfinite(value):
        raise RobotError(f"{where}: expected a finite number, got {value}")
    return float(value)


def _positive(value: Any, where: str) -> float:
    number = _real(value, where)
    if number <= 0.0:
        raise RobotError(f"{where}: must be positive, got {number}")
    return number


def _not_negative(value: Any, where: str) -> float:
    number = _real(value, where)
    if number < 0.0:
        raise RobotError(f"{where}: must not be negative, got {number}")
    return number


def _bus_id(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 252:
        raise RobotError(f"{where}: expected a whole number from 0 to 252, got {value!r}")
    return value


def _vector3(value: Any, where: str) -> FloatArray:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise RobotError(f"{where}: expected three numbers [x, y, z], got {value!r}")
    return _frozen([_real(component, where) for component in value])


def _finger_travel(value: Any, where: str) -> FingerTravel:
    parts = _section(value, {"at_rad": _Field(_rising), "open_m": _Field(_rising)}, where)
    at_rad, open_m = parts["at_rad"], parts["open_m"]
    if len(at_rad) != len(open_m):
        raise RobotError(f"{where}: {len(at_rad)} angles and {len(open_m)} openings; give one opening for each angle")
    if max(map(abs, open_m)) > 1.0:
        raise RobotError(f"{where}: open_m={list(open_m)} is over 1 m: openings are in m, not mm")
    if max(map(abs, at_rad)) > 10.0:
        raise RobotError(f"{where}: at_rad={list(at_rad)} is over a full turn: angles are in rad, not degrees")
    travel = FingerTravel(at_rad, open_m)
    if travel.ratio_at(np.linspace(at_rad[0], at_rad[-1], 101)).min() <= 0.0:
        raise RobotError(f"{where}: by these openings the finger turns back in between; measure them again")
    return travel


def _rising(value: Any, where: str) -> tuple[float, ...]:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) < 2:
        raise RobotError(f"{where}: expected a list of two or more numbers, got {value!r}")
    numbers = tuple(_real(entry, where) for entry in value)
    if any(after <= before for before, after in itertools.pairwise(numbers)):
        raise RobotError(f"{where}: expected rising numbers, got {list(numbers)}")
    return numbers


def _quantity(read: Callable[[Any, str], float]) -> Callable[[Any, str], Quantity]:
    def quantity(value: Any, where: str) -> Quantity:
        if not isinstance(value, Mapping):
            return Quantity(read(value, where), 0.0)
        parts = _section(value, {"value": _Field(read), "std": _Field(_not_negative, 0.0)}, where)
        return Quantity(parts["value"], parts["std"])

    return quantity


_MOTOR = {
    "model": _Field(_text, ""),
    "id": _Field(_bus_id, None),
    "nominal_torque_constant_N_m_per_A": _Field(_positive),
    "supply_voltage_V": _Field(_not_negative, 0.0),
    "back_emf_V_s_per_rad": _Field(_not_negative, 0.0),
    "resistance_ohm": _Field(_not_negative, 0.0),
    "current_limit_A": _Field(_positive, math.inf),
    "encoder_resolution_rad": _Field(_not_negative),
    "encoder_noise_rad": _Field(_not_negative, 0.0),
    "encoder_once_per_turn_rad": _Field(_not_negative, 0.0),
}
_DRIVE_TRAIN = {
    # friction has no default: one that was forgotten would be taken as exactly zero and bias every mass
    "torque_constant_N_m_per_A": _Field(_quantity(_positive)),
    "coulomb_N_m": _Field(_quantity(_not_negative)),
    "viscous_N_m_s_per_rad": _Field(_quantity(_not_negative)),
    "load_friction": _Field(_quantity(_not_negative)),
    "armature_kg_m2": _Field(_quantity(_not_negative)),
    "zero_rad": _Field(_quantity(_real), Quantity(0.0)),
    "stribeck": _Field(_quantity(_not_negative), Quantity(0.0)),
    "stribeck_velocity_rad_s": _Field(_quantity(_positive), Quantity(0.1)),
}
_JOINT = {
    "usable_velocity_rad_s": _Field(_positive, math.inf),
    "transmission_m_per_rad": _Field(_positive, None),
    "finger_travel": _Field(_finger_travel, None),
}
_ROBOT = {
    "name": _Field(_text),
    "payload_frame": _Field(_text),
    "gravity": _Field(_vector3, _frozen(STANDARD_GRAVITY)),
    "arm_scale": _Field(_quantity(_positive), Quantity(1.0)),
    "delay_s": _Field(_quantity(_real), Quantity(0.0)),
    "stamp_jitter_s": _Field(_not_negative, 0.0),
    "onset_jitter_s": _Field(_not_negative, 0.0),
    "torque_disturbance_N_m": _Field(_not_negative, 0.0),
    "start_velocity_rad_s": _Field(_positive, 0.01),
    "link_mass_std": _Field(_not_negative, 0.0),
    "link_com_std_m": _Field(_not_negative, 0.0),
    "link_inertia_std": _Field(_not_negative, 0.0),
    "friction_velocity_rad_s": _Field(_positive, 0.001),
    "calibrated": _Field(_truth, False),
    "model_fingerprint": _Field(_text, None),
    "calibration": _Field(Calibration.from_settings, None),
}
_FILE_ONLY = ("model_fingerprint", "calibration")  # no --set


_CALIBRATED_TERMS = (
    "torque_constant", "coulomb", "viscous", "load_friction", "armature", "zero", "stribeck", "stribeck_velocity",
)  # fmt: skip


def _unknown_of(path: tuple[str, ...]) -> Key:
    """Key of the unknown that a setting states, such as ``("coulomb", "joint3")``; that of no unknown where it states none."""
    name = path[-1]
    for unit in ("_N_m_per_A", "_N_m_s_per_rad", "_N_m", "_kg_m2", "_rad_s", "_rad", "_s"):
        name = name.removesuffix(unit)
    return name if len(path) == 1 else (name, path[1])


def _as_mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RobotError(f"{where}: expected keys and values, got {value!r}")
    return value


def _section(value: Any, fields: Mapping[str, _Field], where: str) -> dict[str, Any]:
    """Read one mapping of the file; unknown and missing keys are refused."""
    given = _as_mapping(value, where)
    for key in given:
        if key not in fields:
            close = difflib.get_close_matches(str(key), fields, n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise RobotError(f"{where}: unknown key {key!r}; {hint}valid keys: {', '.join(fields)}")
    result = {}
    for key, entry in fields.items():
        if key in given:
            result[key] = entry.read(given[key], f"{where}: {key}")
        elif entry.default is _REQUIRED:
            raise RobotError(f"{where}: {key} is missing; state it")
        else:
            result[key] = entry.default
    return result


def _override_paths(joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Every key that may be overridden, as text and as the way to it; a joint's name may itself hold dots."""
    paths: list[tuple[str, ...]] = [(key,) for key in _ROBOT if key not in _FILE_ONLY]
    for joint in joints:
        paths += [("joints", joint, "motor", key) for key in _MOTOR]
        paths += [("joints", joint, "drive_train", key) for key in _DRIVE_TRAIN]
        paths += [("joints", joint, key) for key in _JOINT]
    return {".".join(path): path for path in paths}


def nested_settings(model: RobotModel, overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted settings as the robot file nests them.

    Raises:
        RobotError: A key is unknown.
    """
    paths = _override_paths(model.independent_joints)
    settings: dict[str, Any] = {}
    for key, value in overrides.items():
        if key not in paths:
            raise RobotError(_unknown_override(key, paths, model.independent_joints))
        addition: Any = copy.deepcopy(value)
        for part in reversed(paths[key]):
            addition = {part: addition}
        settings = _merged(settings, addition)
    return settings


def _unknown_override(key: str, paths: Mapping[str, tuple[str, ...]], joints: Sequence[str]) -> str:
    close = difflib.get_close_matches(key, paths, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    top = [path for path in paths if not path.startswith("joints.")]
    return (
        f"unknown robot setting {key!r}; {hint}valid: {', '.join(top)}, "
        f"joints.JOINT.motor.({'|'.join(_MOTOR)}), joints.JOINT.drive_train.({'|'.join(_DRIVE_TRAIN)}), "
        f"joints.JOINT.({'|'.join(_JOINT)}), where JOINT is one of {', '.join(joints)}"
    )


def _merged(base: Any, addition: Any) -> Any:
    """Deep merge: mappings key by key, anything else replaces."""
    if not isinstance(base, Mapping) or not isinstance(addition, Mapping):
        return addition
    result = dict(base)
    for key, value in addition.items():
        result[key] = _merged(result[key], value) if key in result else value
    return result


def _read_settings(path: Path, below: tuple[Path, ...] = ()) -> dict[str, Any]:
    """One YAML file with all that it extends merged in, and the path of its URDF made absolute."""
    if path in below:
        raise RobotError(f"{path}: files extend each other in a circle: {' -> '.join(p.name for p in (*below, path))}")
    try:
        content = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror}); {_choices()}") from error
    except (YAMLError, UnicodeDecodeError) as error:
        raise RobotError(f"{path}: not YAML ({' '.join(str(error).split())})") from error
    settings = dict(_as_mapping(content, path.name))
    if "urdf" in settings:
        settings["urdf"] = str(_urdf_path(_text(settings["urdf"], f"{path.name}: urdf"), path))
    if "extends" in settings:
        base = _read_settings(
            _located(_text(settings.pop("extends"), f"{path.name}: extends"), path.parent), (*below, path)
        )
        if "calibration" in settings:
            base.pop("calibration", None)  # a newer calibration replaces an older one as a whole
        settings = _merged(base, settings)
    return settings


def _urdf_path(text: str, source: Path) -> Path:
    beside = (source.parent / text).resolve()
    if beside.is_file():
        return beside
    if text.removesuffix(".urdf") in resource_names("urdf"):
        return resource("urdf", text)
    raise RobotError(
        f"{source.name}: urdf: there is no {beside}; give a path relative to {source.parent}, or an absolute one"
    )


def _choices() -> str:
    return f"known robots: {', '.join(resource_names('robots'))}; or give the path of a .yaml file"


def _located(name_or_path: str, folder: Path) -> Path:
    """The YAML file that a name or a path (relative to a folder) means."""
    path = folder / name_or_path
    if path.suffix == ".urdf":
        template = resource("robots", "open_manipulator_x")
        raise RobotError(
            f"{name_or_path} is a bare URDF, which says nothing of motors: write {path.with_suffix('.yaml')} "
            f"with 'urdf: {path.name}', payload_frame and joints, starting from {template}"
        )
    if path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise RobotError(f"there is no robot file {path}; {_choices()}")
        return path.resolve()
    if name_or_path not in resource_names("robots"):
        raise RobotError(f"unknown robot {name_or_path!r}; {_choices()}")
    return resource("robots", name_or_path)


def _robot(settings: dict[str, Any], source: Path, model: RobotModel | None = None) -> Robot:
    """A robot from merged settings; the model is read from the URDF unless it is given."""
    file = source.name
    given = _section(
        {key: value for key, value in settings.items() if key not in ("urdf", "joints")},
        # listed for the message about unknown keys; read below
        _ROBOT | {key: _Field(_text, None) for key in ("urdf", "joints", "extends")},
        file,
    )
    if model is None:
        if "urdf" not in settings:
            raise RobotError(f"{file}: urdf is missing; state the robot's URDF file")
        model = RobotModel.from_urdf(settings["urdf"])
    expected = given["model_fingerprint"]
    if expected is not None and expected != model.fingerprint():
        raise RobotError(
            f"{file}: was made with another URDF than {settings.get('urdf')} (model_fingerprint {expected[:12]}.., "
            f"now {model.fingerprint()[:12]}..): calibrate again, or restore the URDF"
        )
    link_names = [link.name for link in model.links]
    if given["payload_frame"] not in link_names:
        raise RobotError(
            f"{file}: payload_frame: {model.name} has no link {given['payload_frame']!r}; "
            f"links: {', '.join(link_names)}"
        )
    drive_trains, motors = {}, {}
    for name, joint_settings in _as_mapping(settings.get("joints", {}), f"{file}: joints").items():
        if name not in model.independent_joints:
            raise RobotError(
                f"{file}: joints: {model.name} has no joint {name!r} that a motor could drive; "
                f"choose from: {', '.join(model.independent_joints)}"
            )
        drive_trains[name], motors[name] = _drive_train(joint_settings, model.joint(name), f"{file}: joints: {name}")
    if not drive_trains:
        raise RobotError(f"{file}: joints is missing or empty; state the drive train of at least one joint")
    calibration = given["calibration"]
    robot = Robot(
        name=given["name"],
        model=model,
        drive_trains=drive_trains,
        motors=motors,
        delay=given["delay_s"],
        arm_scale=given["arm_scale"],
        stamp_jitter_s=given["stamp_jitter_s"],
        onset_jitter_s=given["onset_jitter_s"],
        torque_disturbance=given["torque_disturbance_N_m"],
        start_velocity=given["start_velocity_rad_s"],
        link_mass_std=given["link_mass_std"],
        link_com_std=given["link_com_std_m"],
        link_inertia_std=given["link_inertia_std"],
        friction_velocity=given["friction_velocity_rad_s"],
        payload_frame=given["payload_frame"],
        gravity=given["gravity"],
        source=source,
        settings=settings,
    )
    return robot if calibration is None else robot.with_calibration(calibration)


def _drive_train(settings: Any, joint: Joint, where: str) -> tuple[DriveTrain, Motor]:
    fields = {
        "motor": _Field(lambda value, at: _section(value, _MOTOR, at)),
        "drive_train": _Field(lambda value, at: _section(value, _DRIVE_TRAIN, at)),
    }
    parts = _section(settings, fields | _JOINT, where)
    motor, drive = parts["motor"], parts["drive_train"]
    transmission = parts["transmission_m_per_rad"]
    if joint.kind == "prismatic" and transmission is None:
        raise RobotError(
            f"{where}: transmission_m_per_rad is missing; state how far the joint slides per rad of the motor"
        )
    if joint.kind != "prismatic" and transmission is not None:
        raise RobotError(
            f"{where}: transmission_m_per_rad is for a prismatic joint, but this one is {joint.kind}; remove it"
        )
    travel = parts["finger_travel"]
    if travel is not None and (transmission is None or not 0.5 < travel.mean_ratio / transmission < 2.0):
        nominal = "not there" if transmission is None else f"{1e3 * transmission:g} mm per rad"
        raise RobotError(
            f"{where}: finger_travel opens by {1e3 * travel.mean_ratio:.3g} mm per rad of the motor, transmission_m_per_rad is "
            f"{nominal}: one of them is wrong, or not of one finger"
        )
    if motor["supply_voltage_V"] > 0.0 and motor["resistance_ohm"] == 0.0:
        raise RobotError(
            f"{where}: motor: supply_voltage_V needs resistance_ohm too; state it, or a voltage of 0 for no limit"
        )
    if motor["encoder_resolution_rad"] == 0.0 and motor["encoder_noise_rad"] == 0.0:
        raise RobotError(
            f"{where}: motor: encoder_resolution_rad and encoder_noise_rad are both 0; no encoder is perfect"
        )
    return (
        DriveTrain(
            torque_constant=drive["torque_constant_N_m_per_A"],
            coulomb=drive["coulomb_N_m"],
            viscous=drive["viscous_N_m_s_per_rad"],
            load_friction=drive["load_friction"],
            armature=drive["armature_kg_m2"],
            zero=drive["zero_rad"],
            stribeck=drive["stribeck"],
            stribeck_velocity=drive["stribeck_velocity_rad_s"],
            nominal_torque_constant=motor["nominal_torque_constant_N_m_per_A"],
            supply_voltage_V=motor["supply_voltage_V"],
            back_emf_V_s_per_rad=motor["back_emf_V_s_per_rad"],
            resistance_ohm=motor["resistance_ohm"],
            usable_velocity=parts["usable_velocity_rad_s"],
            encoder_resolution=motor["encoder_resolution_rad"],
            encoder_noise=motor["encoder_noise_rad"],
            encoder_once_per_turn=motor["encoder_once_per_turn_rad"],
            transmission=1.0 if transmission is None else transmission,
            finger_travel=travel,
        ),
        Motor(model=motor["model"], id=motor["id"], current_limit_A=motor["current_limit_A"]),
    )


def load_robot(name_or_path: str | Path) -> Robot:
    """Read a robot.

    Args:
        name_or_path: Name of a robot that comes with the package (a file of ``config/robots`` without its suffix), or
            the path of a YAML file. The keys are explained in ``config/robots/open_manipulator_x.yaml``.

    Raises:
        RobotError: There is no such robot, or its file or its URDF is wrong.
    """
    path = _located(str(name_or_path), Path())
    return _robot(_read_settings(path), path)
