"""Links and joints as a URDF file states them.

A joint's frame moves with it: the child link's frame is ``parent_T_child(q) = origin @ motion(axis, q)``, as URDF defines
it. Meshes, visuals, transmissions and simulator blocks are ignored.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from proprio_ros.errors import RobotError, one_line
from proprio_ros.inputs.reading import LONGEST_TEXT
from proprio_ros.robot.geometry import (
    FloatArray,
    frozen,
    motion,
    pseudo_inertia,
    rotation_from_rpy,
    transform,
)

JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")
LONGEST_NAME = 255  # characters of the name of a link or a joint
MOST_LINKS = 256
"""Each link that moves with a driven joint has unknowns of its own; a humanoid with two hands has half as many links."""
_LARGEST = {"mass": 1e4, "inertia": 1e5, "xyz": 100.0, "rpy": 100.0}  # kg, kg m^2, m, rad
_NO_MASS_KG, _NO_INERTIA_KG_M2 = 1e-6, 1e-9
"""Exporters of CAD models give frames a billionth of a kilogram, since a simulator wants some mass: such a link has none."""
_ROUNDING = 1e-9  # relative; inertias are printed with eight digits or more


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint of the tree."""

    name: str
    kind: str  # one of `JOINT_KINDS`
    # parent, child: link it stands on, and link it carries
    parent: str
    child: str
    origin: FloatArray  # parent_T_joint at position zero, shape (4, 4)
    axis: FloatArray  # unit axis in the joint frame, shape (3,)
    # lower, upper: smallest and largest position [rad or m], infinite when there is none
    lower: float
    upper: float
    # velocity_limit, effort_limit: [rad/s or m/s] and [N m or N], infinite when there is none
    velocity_limit: float
    effort_limit: float
    # (source joint, multiplier, offset) of a joint that follows another; None for an independent one
    mimic: tuple[str, float, float] | None = None

    @property
    def independent(self) -> bool:
        """Whether the joint has a position of its own."""
        return self.kind != "fixed" and self.mimic is None

    def transform(self, position: float | FloatArray) -> FloatArray:
        """parent_T_child at a position [rad or m], shape (4, 4), or at N of them, shape (N, 4, 4)."""
        return self.origin @ motion(self.kind, self.axis, position)


@dataclass(frozen=True, eq=False)
class Link:
    """One link of the tree; its pseudo-inertia is about its frame, shape (4, 4), zeros when the URDF gives no inertial."""

    name: str
    pseudo_inertia: FloatArray


class UrdfReader:
    """Reads one URDF document; every problem becomes one line (`RobotError`) that names the source, the element and the remedy."""

    def __init__(self, text: str | bytes, source: str) -> None:
        self._source = source
        if len(text) > LONGEST_TEXT:
            raise RobotError(
                f"{source}: has over {LONGEST_TEXT / 1e6:g} MB; give a URDF file, whose meshes lie beside it"
            )
        try:
            self._robot = ElementTree.fromstring(text)
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise RobotError(f"{source}: not XML ({error}); give a URDF file") from error
        if self._robot.tag != "robot":
            raise RobotError(
                f"{source}: the document is a <{self._robot.tag}>, not a <robot>; give a URDF file"
            )
        if any("xacro}" in str(element.tag) for element in self._robot.iter()):
            raise RobotError(
                f"{source}: holds xacro macros; expand it first: xacro {source} > robot.urdf"
            )

    def _fail(self, message: str) -> NoReturn:
        raise RobotError(f"{self._source}: {message}")

    def read(self) -> tuple[str, tuple[Link, ...], tuple[Joint, ...], str]:
        """Name of the robot, its links and joints, parents before children, and the name of the root link.

        Raises `RobotError`: The document describes no physical tree of links.
        """
        for tag in ("link", "joint"):
            count = len(self._robot.findall(tag))
            if count > MOST_LINKS:
                self._fail(
                    f"has {count} {tag}s, and {MOST_LINKS} are the most that can be read: leave out what never moves"
                )
        links = self._unique("link", self._link)
        if not links:
            self._fail("the robot has no <link>")
        joints = self._unique("joint", self._joint)
        for joint in joints.values():
            for role, name in (("parent", joint.parent), ("child", joint.child)):
                if name not in links:
                    self._fail(
                        f"joint {joint.name!r} names an unknown {role} link {name!r}; links: {', '.join(links)}"
                    )
        self._check_mimics(joints)
        root = self._root(links, joints)
        ordered = self._ordered(root, joints)
        name = one_line(self._robot.get("name") or "robot", LONGEST_NAME)
        return (
            name,
            (
                links[root],
                *(links[joint.child] for joint in ordered),
            ),
            tuple(ordered),
            root,
        )

    def _unique(
        self,
        tag: str,
        read: Callable[[ElementTree.Element], Any],
    ) -> dict[str, Any]:
        items = [read(element) for element in self._robot.findall(tag)]
        result = {item.name: item for item in items}
        for name, count in Counter(item.name for item in items).items():
            if count > 1:
                self._fail(f"two {tag}s are named {name!r}; give each a name of its own")
        return result

    def _name(self, element: ElementTree.Element) -> str:
        name = element.get("name")
        if not name:
            self._fail(f"a <{element.tag}> has no name; give it one")
        if not name.isprintable() or len(name) > LONGEST_NAME:
            self._fail(
                f"the name '{one_line(name, 60)}' of a <{element.tag}> is not printable, or too long"
            )
        return name

    def _numbers(
        self,
        element: ElementTree.Element,
        attribute: str,
        where: str,
        default: str | None = None,
        count: int = 3,
    ) -> list[float]:
        """So many numbers of an attribute."""
        text = element.get(attribute, default)
        if text is None:
            self._fail(f"{where}: <{element.tag}> has no {attribute}; add it")
        try:
            values = [float(part) for part in text.split()]
        except ValueError:
            self._fail(f"{where}: {attribute}={text!r} of <{element.tag}> is no number")
        if not all(math.isfinite(value) for value in values):
            self._fail(f"{where}: {attribute}={text!r} of <{element.tag}> must be finite")
        largest = _LARGEST.get(element.tag, _LARGEST.get(attribute, math.inf))
        if max(map(abs, values), default=0.0) > largest:
            self._fail(
                f"{where}: {attribute}={text!r} of <{element.tag}> is over {largest:g}: units are kg, m and rad"
            )
        if len(values) != count:
            needed = "one number" if count == 1 else "three numbers"
            self._fail(
                f"{where}: {attribute} of <{element.tag}> must be {needed}, got {len(values)}"
            )
        return values

    def _number(
        self,
        element: ElementTree.Element,
        attribute: str,
        where: str,
        default: str | None = None,
    ) -> float:
        return self._numbers(element, attribute, where, default, 1)[0]

    def _origin(self, element: ElementTree.Element, where: str) -> FloatArray:
        origin = element.find("origin")
        if origin is None:
            return np.eye(4)
        rotation = rotation_from_rpy(self._numbers(origin, "rpy", where, "0 0 0"))
        return transform(rotation, self._numbers(origin, "xyz", where, "0 0 0"))

    def _link(self, element: ElementTree.Element) -> Link:
        name = self._name(element)
        where = f"link {name!r}"
        inertial = element.find("inertial")
        if inertial is None:
            return Link(name, frozen(np.zeros((4, 4))))
        mass_element = inertial.find("mass")
        inertia_element = inertial.find("inertia")
        if mass_element is None or inertia_element is None:
            self._fail(
                f"{where}: <inertial> needs both <mass> and <inertia>; leave it out for a frame without mass"
            )
        mass = self._number(mass_element, "value", where)
        inertia = self._inertia(inertia_element, where)
        if 0.0 <= mass <= _NO_MASS_KG and np.abs(inertia).max() <= _NO_INERTIA_KG_M2:
            return Link(name, frozen(np.zeros((4, 4))))
        if mass <= 0.0:
            self._fail(
                f"{where}: mass must be positive, got {mass} kg; leave <inertial> out for a frame without mass"
            )
        self._check_moments(inertia, where)
        link_from_inertial = self._origin(inertial, where)
        central = pseudo_inertia(mass, np.zeros(3), inertia)
        return Link(name, frozen(link_from_inertial @ central @ link_from_inertial.T))

    def _inertia(self, element: ElementTree.Element, where: str) -> FloatArray:
        """About the centre of mass, (3, 3)."""
        rows = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
        return np.array([[self._number(element, key, where) for key in row] for row in rows])

    def _check_moments(self, inertia: FloatArray, where: str) -> None:
        """Refuse an inertia that no body has."""
        smallest, middle, largest = np.linalg.eigvalsh(inertia)
        moments = f"principal moments {smallest:.4g}, {middle:.4g}, {largest:.4g} kg m^2"
        if smallest <= 0.0:
            self._fail(
                f"{where}: the inertia is not positive definite ({moments}): no body has it; take it from the CAD model or a "
                "solid of that size"
            )
        if largest > (smallest + middle) * (1.0 + _ROUNDING):
            self._fail(
                f"{where}: the inertia breaks the triangle inequality ({moments}; none may exceed the sum of the others): no "
                "body has it; check units and signs"
            )

    def _joint(self, element: ElementTree.Element) -> Joint:
        name = self._name(element)
        where = f"joint {name!r}"
        kind = element.get("type", "")
        if kind not in JOINT_KINDS:
            self._fail(
                f"{where}: type {kind!r} is not supported; supported: {', '.join(JOINT_KINDS)}"
            )
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
            axis = np.array(self._numbers(axis_element, "xyz", where, "1 0 0"))
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
            origin=frozen(self._origin(element, where)),
            axis=frozen(axis),
            lower=lower,
            upper=upper,
            velocity_limit=velocity,
            effort_limit=effort,
            mimic=self._mimic(element, kind, where),
        )

    def _limits(
        self, element: ElementTree.Element, kind: str, where: str
    ) -> tuple[float, float, float, float]:
        lower = -math.inf
        upper = math.inf
        velocity = math.inf
        effort = math.inf
        limit = element.find("limit")
        if kind in ("revolute", "prismatic"):
            if limit is None or limit.get("lower") is None or limit.get("upper") is None:
                advice = ", or make it continuous" if kind == "revolute" else ""
                self._fail(
                    f"{where}: a {kind} joint needs <limit lower=.. upper=../>; add it{advice}"
                )
            lower = self._number(limit, "lower", where)
            upper = self._number(limit, "upper", where)
            if lower > upper:
                self._fail(
                    f"{where}: the lower limit {lower} is above the upper limit {upper}; swap them"
                )
        if limit is not None and kind != "fixed":
            if limit.get("velocity") is not None:
                velocity = self._number(limit, "velocity", where)
            if limit.get("effort") is not None:
                effort = self._number(limit, "effort", where)
            if velocity < 0.0 or effort < 0.0:
                self._fail(
                    f"{where}: limits of velocity and effort must not be negative, got {velocity} and {effort}"
                )
        # no motor moves nothing at all: many exporters write 0 where nobody has stated a limit
        return lower, upper, velocity or math.inf, effort or math.inf

    def _mimic(
        self, element: ElementTree.Element, kind: str, where: str
    ) -> tuple[str, float, float] | None:
        mimic = element.find("mimic")
        if mimic is None or kind == "fixed":
            return None
        source = mimic.get("joint")
        if not source:
            self._fail(f"{where}: <mimic> names no joint; add joint=..")
        return (
            source,
            self._number(mimic, "multiplier", where, "1"),
            self._number(mimic, "offset", where, "0"),
        )

    def _check_mimics(self, joints: Mapping[str, Joint]) -> None:
        for joint in joints.values():
            seen = [joint.name]
            mimic = joint.mimic
            while mimic is not None:
                source = mimic[0]
                if source not in joints:
                    self._fail(
                        f"joint {seen[-1]!r} mimics an unknown joint {source!r}; joints: {', '.join(joints)}"
                    )
                if joints[source].kind == "fixed":
                    self._fail(
                        f"joint {seen[-1]!r} mimics {source!r}, which is fixed; let it mimic a joint that moves"
                    )
                if source in seen:
                    circle = " -> ".join([*seen, source])
                    self._fail(
                        f"joints mimic each other in a circle: {circle}; leave one independent"
                    )
                seen.append(source)
                mimic = joints[source].mimic

    def _root(
        self,
        links: Mapping[str, Link],
        joints: Mapping[str, Joint],
    ) -> str:
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
            self._fail(
                f"the joints form a loop and no link is the root; cut it at one of: {', '.join(joints)}"
            )
        if len(roots) > 1:
            self._fail(
                f"several links have no parent: {', '.join(roots)}; join them to one root with fixed joints"
            )
        return roots[0]

    def _ordered(
        self,
        root: str,
        joints: Mapping[str, Joint],
    ) -> list[Joint]:
        children: dict[str, list[Joint]] = defaultdict(list)
        for joint in reversed(list(joints.values())):
            children[joint.parent].append(joint)
        ordered = []
        waiting = [*children[root]]
        while waiting:
            ordered.append(waiting.pop())
            waiting += children[ordered[-1].child]
        loop = [name for name, joint in joints.items() if joint not in ordered]
        if loop:
            self._fail(
                f"joints {', '.join(loop)} form a loop apart from the tree; let one of them start at a link of it"
            )
        return ordered
