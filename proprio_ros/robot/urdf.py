"""Links and joints as a URDF file states them; meshes, visuals, transmissions and simulator blocks are ignored.

What is wrong with elements is collected, so that one message names all of it.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np

from proprio_ros.errors import RobotError, one_line, some
from proprio_ros.inputs.reading import LONGEST_TEXT
from proprio_ros.robot.bodies import Stated, possible_bodies
from proprio_ros.robot.geometry import FloatArray, frozen, rotation_from_rpy, transform
from proprio_ros.robot.links import JOINT_KINDS, Joint, Link

LONGEST_NAME = 255  # characters of the name of a link or a joint
MOST_LINKS = 256
"""Each link that moves with a driven joint has unknowns of its own; a humanoid with two hands has half as many links."""
_LARGEST = {"mass": 1e4, "inertia": 1e5, "xyz": 100.0, "rpy": 100.0}  # kg, kg m^2, m, rad
LONGEST_REFUSAL = 4000  # characters; whoever mends a description wants the name of every link
MOST_EFFORT = 1e3
"""No motor of an arm that is weighed with turns a joint with more [N m]; whoever writes more has stated no limit."""
_FREE = ("floating", "planar")
"""Joints without a motor, by which a robot stands somewhere in its world."""


class _ElementError(Exception):
    """What is wrong with one element."""


def _wrong(message: str) -> NoReturn:
    raise _ElementError(message)


def _by_link(problems: Mapping[str, Sequence[str]]) -> list[str]:
    """A sentence a problem, with the names of its links; the last one says what to do."""
    sentences = [
        f"link{'s' * (len(names) > 1)} {', '.join(names)}: {problem}"
        for problem, names in problems.items()
    ]
    if sentences:
        sentences.append("state mass, centre and inertia of each, as of its solid")
    return sentences


class UrdfReader:
    """Reads one URDF document; every problem becomes one line (`RobotError`) that names the source, the element and the remedy."""

    def __init__(self, text: str | bytes, source: str) -> None:
        self._source = source
        self._problems: list[str] = []
        self._notes: list[str] = []
        self._free: set[str] = set()
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
        self._problems.append(message)
        self._refuse()

    def _refuse(self) -> NoReturn:
        """Refuse the document, with all that is wrong so far."""
        raise RobotError(
            f"{self._source}: {'; '.join(dict.fromkeys(self._problems))}",
            longest=LONGEST_REFUSAL,
        )

    def read(
        self,
    ) -> tuple[str, tuple[Link, ...], tuple[Joint, ...], str, tuple[str, ...], tuple[str, ...]]:
        """What a `RobotModel` is made of.

        Raises `RobotError`: The document describes no physical tree of links; it names all that is wrong.
        """
        for tag in ("link", "joint"):
            count = len(self._robot.findall(tag))
            if count > MOST_LINKS:
                self._fail(
                    f"has {count} {tag}s, and {MOST_LINKS} are the most that can be read: leave out what never moves"
                )
        stated = self._unique("link", self._link)
        if not stated:
            self._fail("the robot has no <link>")
        joints = self._unique("joint", self._joint)
        self._check_ends(joints, stated)
        joints = self._freed(joints)
        self._check_mimics(joints)
        root = self._root(stated, joints)
        ordered = self._ordered(root, joints)
        self._check_free(ordered)
        bodies = possible_bodies(stated, ordered, root)
        self._problems += _by_link(bodies.problems)
        missing = _by_link(bodies.missing)
        if self._problems:
            self._problems += missing
            self._refuse()
        links = [bodies.links[root]]
        for joint in ordered:
            links.append(bodies.links[joint.child])
        name = self._robot.get("name") or "robot"
        return (
            one_line(name, LONGEST_NAME),
            tuple(links),
            tuple(ordered),
            root,
            (*self._notes, *bodies.notes),
            tuple(missing),
        )

    def _check_ends(
        self,
        joints: Mapping[str, Joint],
        links: Mapping[str, Stated],
    ) -> None:
        before = len(self._problems)
        for joint in joints.values():
            for role, name in (("parent", joint.parent), ("child", joint.child)):
                if name not in links:
                    self._problems.append(
                        f"joint {joint.name!r} names an unknown {role} link {name!r}; links: {some(links)}"
                    )
        if len(self._problems) > before:
            self._refuse()

    def _check_free(self, joints: Sequence[Joint]) -> None:
        """Take joints by which a robot stands in its world as fixed, and refuse those that an arm would carry."""
        moving: set[str] = set()
        for joint in joints:
            if joint.name in self._free and joint.parent in moving:
                self._problems.append(
                    f"joint {joint.name!r} carries what is not fixed to {joint.parent!r}, which moves; make it fixed or leave "
                    "it out"
                )
            if joint.kind != "fixed" or joint.parent in moving:
                moving.add(joint.child)
        if self._free:
            free = [joint.name for joint in joints if joint.name in self._free]
            self._notes.append(
                f"floating or planar, taken as fixed, so that what it carries must stand upright and still: {some(free)}"
            )

    def _unique(
        self,
        tag: str,
        read: Callable[[ElementTree.Element], Any],
    ) -> dict[str, Any]:
        items = []
        for element in self._robot.findall(tag):
            try:
                items.append(read(element))
            except _ElementError as error:
                self._problems.append(str(error))
        if len(items) < len(self._robot.findall(tag)):
            self._refuse()
        result = {item.name: item for item in items}
        counts = Counter(item.name for item in items)
        twice = [repr(name) for name, count in counts.items() if count > 1]
        if twice:
            self._problems.append(
                f"two {tag}s are named {some(twice)}; give each a name of its own"
            )
        return result

    def _name(self, element: ElementTree.Element) -> str:
        name = element.get("name")
        if not name:
            _wrong(f"a <{element.tag}> has no name; give it one")
        if not name.isprintable() or len(name) > LONGEST_NAME:
            _wrong(
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
            _wrong(f"{where}: <{element.tag}> has no {attribute}; add it")
        try:
            values = [float(part) for part in text.split()]
        except ValueError:
            _wrong(f"{where}: {attribute}={text!r} of <{element.tag}> is no number")
        if not all(math.isfinite(value) for value in values):
            _wrong(f"{where}: {attribute}={text!r} of <{element.tag}> must be finite")
        largest = _LARGEST.get(element.tag, _LARGEST.get(attribute, math.inf))
        if max(map(abs, values), default=0.0) > largest:
            _wrong(
                f"{where}: {attribute}={text!r} of <{element.tag}> is over {largest:g}: units are kg, m and rad"
            )
        if len(values) != count:
            needed = "one number" if count == 1 else "three numbers"
            _wrong(f"{where}: {attribute} of <{element.tag}> must be {needed}, got {len(values)}")
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

    def _link(self, element: ElementTree.Element) -> Stated:
        name = self._name(element)
        try:
            return self._stated(element, name)
        except _ElementError as error:
            self._problems.append(str(error))
            return Stated(name, unread=True)

    def _stated(self, element: ElementTree.Element, name: str) -> Stated:
        where = f"link {name!r}"
        inertial = element.find("inertial")
        shapes = element.findall("visual") + element.findall("collision")
        has_shape = any(shape.find("geometry") is not None for shape in shapes)
        mass_element = None if inertial is None else inertial.find("mass")
        if inertial is None or mass_element is None:
            return Stated(name, has_shape=has_shape)
        inertia_element = inertial.find("inertia")
        inertia = np.zeros((3, 3))
        if inertia_element is not None:
            inertia = self._inertia(inertia_element, where)
        return Stated(
            name,
            self._number(mass_element, "value", where),
            inertia,
            self._origin(inertial, where),
            has_shape,
        )

    def _inertia(self, element: ElementTree.Element, where: str) -> FloatArray:
        """About the centre of mass, (3, 3)."""
        rows = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
        return np.array([[self._number(element, key, where) for key in row] for row in rows])

    def _joint(self, element: ElementTree.Element) -> Joint:
        name = self._name(element)
        where = f"joint {name!r}"
        kind = element.get("type", "")
        if kind in _FREE:
            self._free.add(name)
            kind = "fixed"
        if kind not in JOINT_KINDS:
            _wrong(f"{where}: type {kind!r} is not supported; supported: {', '.join(JOINT_KINDS)}")
        ends = {}
        for role in ("parent", "child"):
            end = element.find(role)
            link = None if end is None else end.get("link")
            if not link:
                _wrong(f"{where}: has no <{role} link=.../>; add it")
            ends[role] = link
        axis = np.array([1.0, 0.0, 0.0])
        axis_element = element.find("axis")
        if axis_element is not None and kind != "fixed":
            axis = np.array(self._numbers(axis_element, "xyz", where, "1 0 0"))
            length = float(np.linalg.norm(axis))
            if length < 1e-9:
                _wrong(f"{where}: the axis is zero; give it a direction, e.g. 0 0 1")
            axis = axis / length
        limit = element.find("limit")
        lower, upper = self._range(limit, kind, where)
        if kind == "revolute" and (limit is None or {"lower", "upper"}.isdisjoint(limit.keys())):
            kind = "continuous"
        velocity, effort = self._rates(limit, kind, where)
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

    def _range(
        self,
        limit: ElementTree.Element | None,
        kind: str,
        where: str,
    ) -> tuple[float, float]:
        """Smallest and largest position; of two limits, one that is left out is zero, by the format, and two zeros are none."""
        stated = limit is not None and not {"lower", "upper"}.isdisjoint(limit.keys())
        if kind not in ("revolute", "prismatic") or limit is None or not stated:
            return -math.inf, math.inf
        lower = self._number(limit, "lower", where, "0")
        upper = self._number(limit, "upper", where, "0")
        if lower == upper == 0.0:
            return -math.inf, math.inf
        if lower > upper:
            self._problems.append(
                f"{where}: the lower limit {lower} is above the upper limit {upper}; swap them"
            )
        return lower, upper

    def _rates(
        self,
        limit: ElementTree.Element | None,
        kind: str,
        where: str,
    ) -> tuple[float, float]:
        """Limits of velocity and effort; no motor moves nothing at all: many exporters write 0 where nobody has stated a limit."""
        if limit is None or kind == "fixed":
            return math.inf, math.inf
        velocity = self._number(limit, "velocity", where, "0")
        effort = self._number(limit, "effort", where, "0")
        if velocity < 0.0 or effort < 0.0:
            self._problems.append(
                f"{where}: limits of velocity and effort must not be negative, got {velocity} and {effort}"
            )
        if kind != "prismatic" and effort > MOST_EFFORT:
            effort = math.inf
        return velocity or math.inf, effort or math.inf

    def _mimic(
        self,
        element: ElementTree.Element,
        kind: str,
        where: str,
    ) -> tuple[str, float, float] | None:
        mimic = element.find("mimic")
        if mimic is None or kind == "fixed":
            return None
        source = mimic.get("joint")
        if not source:
            _wrong(f"{where}: <mimic> names no joint; add joint=..")
        return (
            source,
            self._number(mimic, "multiplier", where, "1"),
            self._number(mimic, "offset", where, "0"),
        )

    def _check_mimics(self, joints: Mapping[str, Joint]) -> None:
        before = len(self._problems)
        for joint in joints.values():
            seen = [joint.name]
            mimic = joint.mimic
            while mimic is not None:
                source = mimic[0]
                if joints[source].kind == "fixed":
                    self._problems.append(
                        f"joint {seen[-1]!r} mimics {source!r}, which is fixed; let it mimic a joint that moves"
                    )
                if source in seen:
                    circle = " -> ".join([*seen, source])
                    self._problems.append(
                        f"joints mimic each other in a circle: {circle}; leave one independent"
                    )
                    break
                seen.append(source)
                mimic = joints[source].mimic
        if len(self._problems) > before:
            self._refuse()

    def _freed(self, joints: dict[str, Joint]) -> dict[str, Joint]:
        """With joints of their own where what they mimic is in no part of the document, as simulators take them."""
        alone = [
            j.name for j in joints.values() if j.mimic is not None and j.mimic[0] not in joints
        ]
        if alone:
            self._notes.append(
                f"mimic a joint that is not there, taken as joints of their own: {some(alone)}"
            )
        return joints | {name: replace(joints[name], mimic=None) for name in alone}

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
