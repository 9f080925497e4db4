"""Bodies of links: what a URDF states of them, and the nearest possible one where no body is so.

A mass with its inertia is some body's exactly where the second moments about its centre, ``S = trace(I) / 2 E - I``, have no
negative eigenvalue (see `geometry`). The nearest such S, by Frobenius' norm, is S without its negative eigenvalues. What is taken
in place of what a URDF states is a small part of every joint's torque; else the URDF is refused.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from proprio_ros.errors import some
from proprio_ros.robot.geometry import FloatArray, frozen, pseudo_inertia
from proprio_ros.robot.links import Joint, Link, Spread

LARGEST_SHARE = 0.05
"""Of a joint's torque; each link's mass is as uncertain where nothing else is stated (``link_mass_std``)."""
_NO_MASS_KG, _NO_INERTIA_KG_M2 = 1e-6, 1e-9
"""Exporters of CAD models give frames a billionth of a kilogram, since a simulator wants some mass: such a link has none."""
_POINT_KG = 1e-3  # what weighs less is a point, unless it is a possible body
_POINT_REACH_M = 0.1  # and not even then if most of its mass would be farther from its centre
_SAME = 1e-9  # relative; inertias are printed with eight digits or more
_ROUNDING = 1e-4  # of the trace: what three or four digits leave
_NO_SIZE_M2 = 1e-8  # inertia per mass; a tenth of a millimetre is no size of a body
_WATER_KG_M3 = 1000.0  # a machine with all its hollows is about as dense
_SLENDER = 0.25  # thickness of a finger over its length
_NOWHERE_M = 1e-3  # joints this near to each other meet in one place, and need no body between them
_LEAST_FINGER_M = 0.03
_GRAVITY, _BRISK = 9.81, 10.0  # m/s^2, and an acceleration that arms work with [rad/s^2]
_FINGER = re.compile("finger|jaw|knuckle|claw|thumb", re.I)
_MOVES_FINGER = re.compile(f"{_FINGER.pattern}|gripper", re.I)
"""Names of joints: what a joint called gripper moves is a finger, a link called so may be the whole hand."""
_POINTS = "taken as points of their mass, which is below a gram"
_FLAT = "no body has the inertia stated, taken as the nearest that one can have"
_BALL = "no inertia about the centre stated, taken as that of a ball as dense as water"
_MADE = "no mass stated, taken as slender bodies as dense as water, known to a factor of two"
_REFUSED = {
    _FLAT: "no body has this inertia (a negative moment, or one above the sum of the other two)",
    _BALL: "the inertia about the centre is missing",
    _MADE: "<inertial> is missing",
}


@dataclass(frozen=True, eq=False)
class Stated:
    """What a URDF states of a link."""

    name: str
    mass: float | None = None  # [kg]; None: nothing is
    # about the centre of mass, in the frame of `at` [kg m^2], shape (3, 3)
    inertia: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    at: FloatArray = field(default_factory=lambda: np.eye(4))  # link_T_centre, shape (4, 4)
    has_shape: bool = False  # whether it is drawn, or can be touched
    unread: bool = False  # whether its numbers are none, which is said already


@dataclass(frozen=True)
class _Mend:
    """What was taken in place of what is stated."""

    link: str
    how: str
    kg: float = 0.0  # mass that nobody stated
    centre_m: float = 0.0  # from the link's frame to its centre
    moment: float = 0.0  # by which the largest one differs [kg m^2]


@dataclass
class Bodies:
    """Links of a tree with possible bodies."""

    links: dict[str, Link] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # what was taken for what is stated
    # problems, missing: links, by what is wrong; whoever holds what is missing can do without
    problems: dict[str, list[str]] = field(default_factory=dict)
    missing: dict[str, list[str]] = field(default_factory=dict)


def possible_bodies(
    stated: Mapping[str, Stated],
    joints: Sequence[Joint],
    root: str,
) -> Bodies:
    """The body of each link. What never moves relative to the base is not judged: nothing depends on its mass.

    Args:
        stated: By link.
        joints: Parents before children.
        root: Link at which they begin.
    """
    tree = _Tree(joints, root)
    result = Bodies()
    mends: list[_Mend] = []
    for name, each in stated.items():
        if name not in tree.body:
            result.links[name] = _still(each)
        elif each.mass is not None and each.mass < 0.0:
            result.links[name] = _nothing(name)
            result.problems.setdefault("the mass is negative", []).append(name)
        else:
            link, mend = _body(each)
            result.links[name] = link
            if mend is not None:
                mends.append(mend)
    mends += _of_the_bare(tree, stated, result)
    _judge(tree, mends, result)
    for names in result.missing.values():
        for name in names:
            result.links[name] = replace(
                result.links[name],
                unknown=True,
            )
    return result


def _of_the_bare(
    tree: _Tree,
    stated: Mapping[str, Stated],
    result: Bodies,
) -> list[_Mend]:
    """What is taken for bodies without mass; those of an arm are missing.

    Args:
        tree: Of all bodies.
        stated: By link.
        result: Links as far as they are known; what is missing is added.
    """
    mends = []
    bare = tree.without_mass(result.links)
    is_arm = len(bare) < len(set(tree.body.values()))
    for name in bare:
        body = [stated[link] for link in tree.links_of(name)]
        if any(link.unread for link in body):
            continue
        has_shape = any(link.has_shape for link in body)
        made = tree.missing(name, result.links, has_shape) if is_arm else None
        if made is None:
            result.missing.setdefault(_REFUSED[_MADE], []).append(name)
        elif made.kg:
            mends.append(made)
    return mends


def _nothing(name: str) -> Link:
    return Link(name, frozen(np.zeros((4, 4))))


def _still(each: Stated) -> Link:
    """The body of a link that never moves: what is none's is left out."""
    if each.mass is None or not _is_possible(each):
        return _nothing(each.name)
    return _placed(each, each.mass, each.inertia)


def _second_moments(inertia: FloatArray) -> FloatArray:
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def _is_possible(each: Stated) -> bool:
    if each.mass is None or each.mass <= 0.0:
        return False
    smallest, middle, largest = np.linalg.eigvalsh(each.inertia)
    most = (smallest + middle) * (1.0 + _SAME)
    return bool(smallest > 0.0 and largest <= most)


def _body(each: Stated) -> tuple[Link, _Mend | None]:
    """The body of a link that moves, and what was taken for what is stated; its mass is not negative."""
    mass = each.mass or 0.0
    largest = float(np.abs(each.inertia).max())
    if each.mass is None or (mass <= _NO_MASS_KG and largest <= _NO_INERTIA_KG_M2):
        return _nothing(each.name), None
    is_speck = mass < _POINT_KG
    # of a body at that distance from its centre everywhere
    farthest = 2.0 * mass * _POINT_REACH_M**2
    far = float(np.trace(each.inertia)) > farthest
    if _is_possible(each) and not (is_speck and far):
        return _placed(each, mass, each.inertia), None
    if is_speck:
        point = _placed(
            each,
            mass,
            np.zeros((3, 3)),
        )
        return point, _Mend(each.name, _POINTS)
    return _mended(each, mass)


def _mended(each: Stated, mass: float) -> tuple[Link, _Mend | None]:
    """Of a body of a gram or more that cannot be."""
    trace = float(np.trace(each.inertia))
    second = _second_moments(each.inertia)
    size, axes = np.linalg.eigh(second)
    no_size = _NO_SIZE_M2 * mass
    if abs(trace) <= no_size and size.max() <= no_size:
        return _ball(each, mass)
    kept = np.maximum(size, 0.0)
    nearest_second = (axes * kept) @ axes.T
    nearest = _inertia_of(nearest_second)
    if -size[0] <= _ROUNDING * trace:
        return _placed(each, mass, nearest), None
    moment = _largest_moment(nearest - each.inertia)
    whole = max(_largest_moment(nearest), moment)
    flat = _placed(
        each,
        mass,
        nearest,
        Spread(inertia=moment / whole),
    )
    return flat, _mend(each, _FLAT, moment)


def _ball(each: Stated, mass: float) -> tuple[Link, _Mend]:
    """A ball as dense as water at the place that is stated."""
    volume_m3 = mass / _WATER_KG_M3
    radius_m = (3.0 * volume_m3 / (4.0 * np.pi)) ** (1.0 / 3.0)
    moment = 0.4 * mass * radius_m**2
    ball = _placed(
        each,
        mass,
        moment * np.eye(3),
        Spread(inertia=1.0),
    )
    return ball, _mend(each, _BALL, moment)


def _mend(each: Stated, how: str, moment: float) -> _Mend:
    """Of a body whose mass and place are as stated, by its largest moment that is another one [kg m^2]."""
    return _Mend(
        each.name,
        how,
        centre_m=_length(each.at[:3, 3]),
        moment=moment,
    )


def _inertia_of(second: FloatArray) -> FloatArray:
    return np.trace(second) * np.eye(3) - second


def _largest_moment(inertia: FloatArray) -> float:
    """By its size, of whatever sign."""
    moments = np.linalg.eigvalsh(inertia)
    return float(np.abs(moments).max())


def _length(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))


def _placed(
    each: Stated,
    mass: float,
    inertia: FloatArray,
    spread: Spread | None = None,
) -> Link:
    """A body at the place that is stated.

    Args:
        each: What is.
        mass: [kg].
        inertia: About its centre [kg m^2], shape (3, 3).
        spread: How far it may lie off; None: no farther than other links.
    """
    central = pseudo_inertia(
        mass,
        np.zeros(3),
        inertia,
    )
    about_frame = each.at @ central @ each.at.T
    return Link(
        each.name,
        frozen(about_frame),
        spread or Spread(),
    )


def _finger(made: _Mend, middle: FloatArray) -> Link:
    pseudo = pseudo_inertia(
        made.kg,
        middle,
        made.moment * np.eye(3),
    )
    known = Spread(
        mass=1.0,
        com_m=_length(middle),
        inertia=1.0,
    )
    return Link(made.link, frozen(pseudo), known)


class _Tree:
    """Bodies of links that are fixed to each other, each called by its first link; those of the base are left out."""

    def __init__(self, joints: Sequence[Joint], root: str) -> None:
        self.carrier = {joint.child: joint for joint in joints}
        self.body: dict[str, str] = {}
        self._at: dict[str, FloatArray] = {}  # body_T_link
        self._behind: dict[str, list[Joint]] = defaultdict(list)  # joints that a body carries
        for joint in joints:
            child = joint.child
            before = self.body.get(joint.parent)
            if joint.kind != "fixed":
                self.body[child] = child
                self._at[child] = np.eye(4)
                self._behind[before or root].append(joint)
            elif before is not None:
                self.body[child] = before
                self._at[child] = self._at[joint.parent] @ joint.origin

    def links_of(self, body: str) -> list[str]:
        """All links of a body."""
        return [link for link, of in self.body.items() if of == body]

    def without_mass(self, links: Mapping[str, Link]) -> list[str]:
        """Bodies that have none."""
        kg: dict[str, float] = defaultdict(float)
        for link, body in self.body.items():
            pseudo = links[link].pseudo_inertia
            kg[body] += float(pseudo[3, 3])
        bare = []
        for body, mass in kg.items():
            if mass <= 0.0:
                bare.append(body)
        return bare

    def up(self, link: str) -> Iterator[tuple[str, float]]:
        """Joints that move a link, and how far from each it is along the links at most [m]."""
        away_m = 0.0
        while link in self.carrier:
            joint = self.carrier[link]
            if joint.kind != "fixed":
                yield joint.name, away_m
            away_m += _length(joint.origin[:3, 3])
            link = joint.parent

    def middle(self, body: str) -> FloatArray:
        """Halfway to the farthest joint that a body carries, in its own frame [m], shape (3,)."""
        ends = [np.zeros(3)]
        for joint in self._behind[body]:
            at = self._at[joint.parent] @ joint.origin
            ends.append(at[:3, 3])
        return 0.5 * max(ends, key=_length)

    def missing(
        self,
        body: str,
        links: Mapping[str, Link],
        has_shape: bool,
    ) -> _Mend | None:
        """What to take for a body of which nothing is stated; None: it is part of an arm, so that nobody can know.

        Args:
            body: Called by its first link.
            links: As far as they are known.
            has_shape: Whether there is something of it to be seen.
        """
        middle_m = _length(self.middle(body))
        is_nowhere = middle_m < 0.5 * _NOWHERE_M and not has_shape
        carries = self._beyond(body, links) > 0.0
        if carries:
            return _Mend(body, _MADE) if is_nowhere else None
        joint = self.carrier[body]
        is_called_so = _FINGER.search(joint.child) or _MOVES_FINGER.search(joint.name)
        is_finger = bool(is_called_so) or joint.mimic is not None
        is_last = not self._behind[body]
        is_wheel = is_last and joint.parent not in self.body
        if not (is_finger or is_wheel):
            return None
        if is_nowhere:
            return _Mend(body, _MADE)
        length_m = 2.0 * middle_m
        if is_last:
            # about as long as the part before it
            length_m = max(_length(joint.origin[:3, 3]), _LEAST_FINGER_M)
        thickness_m = _SLENDER * length_m
        kg = _WATER_KG_M3 * length_m * thickness_m**2
        return _Mend(
            body,
            _MADE,
            kg=kg,
            centre_m=middle_m,
            moment=kg * length_m**2 / 12.0,
        )

    def _beyond(self, body: str, links: Mapping[str, Link]) -> float:
        """Mass of what a body carries on joints of its own [kg]."""
        total = 0.0
        for joint in self._behind[body]:
            for link in self.links_of(joint.child):
                pseudo = links[link].pseudo_inertia
                total += float(pseudo[3, 3])
            total += self._beyond(joint.child, links)
        return total


def _judge(tree: _Tree, mends: Sequence[_Mend], result: Bodies) -> None:
    """Note what was taken for what is stated, with its part of a joint's torque; where that is too much, it is refused."""
    load = _torques(tree, result.links)
    taken = {mend.link: _shares(tree, mend, load) for mend in mends}
    total = _added(taken.values())
    for how in dict.fromkeys(mend.how for mend in mends):
        alike = [mend for mend in mends if mend.how == how]
        names = [mend.link for mend in alike]
        parts = _added(taken[name] for name in names)
        where = max(
            parts,
            key=lambda joint: parts[joint],
            default="",
        )
        share = parts[where]
        part = f"{_percent(share)} of the torque at {where}"
        too_much = [name for name in names if _matters(taken[name], total)]
        if too_much:
            kind = result.missing if how == _MADE else result.problems
            kind[f"{_REFUSED[how]}, and is {part}"] = too_much
            continue
        at_most = f"; at most {part}" if share else ""
        result.notes.append(f"{how}{at_most}: {some(names)}")
        if how == _MADE:
            for mend in alike:
                middle = tree.middle(mend.link)
                result.links[mend.link] = _finger(mend, middle)


def _shares(
    tree: _Tree,
    mend: _Mend,
    load: Mapping[str, float],
) -> dict[str, float]:
    """What was taken in parts of each joint's torque.

    Args:
        tree: Of all bodies.
        mend: What was taken.
        load: Torque by joint [N m].
    """
    shares = {}
    for joint, away_m in tree.up(mend.link):
        if load[joint] > 0.0:
            torque = _torque(
                mend.kg,
                away_m + mend.centre_m,
                mend.moment,
            )
            shares[joint] = torque / load[joint]
    return shares


def _torques(tree: _Tree, links: Mapping[str, Link]) -> dict[str, float]:
    """By joint, of all that it moves, stretched out level and accelerated briskly [N m]."""
    load: dict[str, float] = defaultdict(float)
    for name, link in links.items():
        pseudo = link.pseudo_inertia
        mass = float(pseudo[3, 3])
        if mass <= 0.0:
            continue
        centre_m = _length(pseudo[:3, 3]) / mass
        about_frame = float(np.trace(pseudo[:3, :3]))
        moment = about_frame - mass * centre_m**2
        for joint, away_m in tree.up(name):
            load[joint] += _torque(
                mass,
                away_m + centre_m,
                moment,
            )
    return load


def _added(shares: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Shares by joint, added up; zero where there are none."""
    total: dict[str, float] = defaultdict(float)
    for each in shares:
        for joint, share in each.items():
            total[joint] += share
    return total


def _torque(kg: float, away_m: float, moment: float) -> float:
    """About a level axis so far away, held and accelerated [N m]."""
    inertia = moment + kg * away_m**2
    return _GRAVITY * kg * away_m + _BRISK * inertia


def _matters(taken: Mapping[str, float], total: Mapping[str, float]) -> bool:
    """Whether a link has a part in what is too much at a joint; a hundredth of it is none."""
    for joint, share in taken.items():
        is_part = share > 0.01 * total[joint]
        if is_part and total[joint] > LARGEST_SHARE:
            return True
    return False


def _percent(share: float) -> str:
    if share >= 1.0:
        return "more than all"
    return f"{100.0 * share:.2g} %"
