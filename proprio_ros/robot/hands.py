"""Which link of a robot is its hand, and which of its joints are the arm that moves it.

Joints behind which nothing else hangs are driven for the hand alone. A torso that carries another arm or a head, too, has a motor
that holds all of them: what that motor does says little of one hand, so such joints are only read. Wheels, heads and other arms are
no part of the arm at all.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from proprio_ros.errors import RobotError, some
from proprio_ros.robot.links import Joint
from proprio_ros.robot.tree import RobotModel

_TOOLS = ("tcp", r"(^|_)(eef?|end_?effector|grasp)", "tool", "hand", "flange", "gripper")
"""What fixed frames of tools are called, those nearest to the object first."""
_CERTAIN_TOOLS = 3
"""So many of them name a place in which things are held; the others name a part of the arm."""
_FINGER = re.compile("finger|jaw|knuckle|claw|thumb", re.I)
_SENSOR = re.compile(
    r"(^|_)(ft|imu|range)(_|$)|sensor|accelero|gyro|camera|optical|lidar|laser|depth|color|infra",
    re.I,
)
_NO_ARM = re.compile("hip|knee|ankle|foot|toe|leg|wheel|caster|head|neck", re.I)
FEWEST_JOINTS = 3
"""Of an arm, behind the place where it branches off: heads have two, wheels one or two."""


def hand_link(model: RobotModel, tip: str | None = None) -> str:
    """A guess at the link in which objects are held: a tool frame fixed to the arm's last body, else the last link of that body.

    The last body is that of the tip, where one is stated, and the tip itself where it is called as tools are. Else it is the one
    before the tree branches into fingers, or before a joint that is a finger by its name; never a finger, nor a sensor.

    Raises `RobotError`: The robot has several hands, or the tip is none.
    """
    tree = _Bodies(model)
    if tip is None:
        body = _only(tree, model)
    else:
        path = tree.path(_known(model, tip))
        if tree.rank(tip) < _CERTAIN_TOOLS and path == tree.before_fingers(path):
            return tip
        body = _end(tree, path, tip)
    return tree.hand(body)


def hands(model: RobotModel) -> tuple[str, ...]:
    """The hands of a robot, one of each of its arms; legs and the like only where it has nothing else."""
    tree = _Bodies(model)
    ends = list(tree.ends())
    arms = [end for end in ends if not any(map(_NO_ARM.search, _names(tree, end)))]
    return tuple(map(tree.hand, arms or ends))


def arm_joints(model: RobotModel, tip: str) -> tuple[str, ...]:
    """The joints whose motors hold what is in the hand and nothing else, from the base on; no fingers.

    Raises `RobotError`: There is no such link, or no joint moves it.
    """
    tree = _Bodies(model)
    path = tree.path(_known(model, tip))
    _end(tree, path, tip)
    path = tree.before_fingers(path)
    first = 0
    for passed, joint in enumerate(path[:-1], start=1):
        beside = [each for each in tree.moving[joint.child] if each not in path]
        if passed < tree.beyond[joint.child] and any(map(tree.is_limb, beside)):
            first = passed
    return tuple(joint.name for joint in path[first:] if joint.independent)


def path_to(model: RobotModel, link: str) -> tuple[str, ...]:
    """The joints that move a link and have a position of their own, from the base on.

    Raises `RobotError`: There is no such link.
    """
    path = _Bodies(model).path(_known(model, link))
    return tuple(joint.name for joint in path if joint.independent)


def tip_of(model: RobotModel) -> str | None:
    """The hand of a robot that has joints beside its arm, such as wheels and a head; None: whatever moves is of the arm.

    Raises `RobotError`: It has several hands.
    """
    tree = _Bodies(model)
    body = _only(tree, model)
    of_hand = set(tree.path(body))
    behind = {body}
    for joint in model.joints:
        if joint.kind != "fixed" and tree.body(joint.parent) in behind:
            behind.add(joint.child)
            of_hand.add(joint)
    beside = [joint for joint in model.joints if joint.independent and joint not in of_hand]
    return tree.hand(body) if beside and len(tree.path(body)) > 1 else None


def _known(model: RobotModel, link: str) -> str:
    links = [each.name for each in model.links]
    if link not in links:
        raise RobotError(
            f"tip: {model.name} has no link {link!r}; its hands: {some(hands(model))}; its links: {', '.join(links)}"
        )
    return link


def _only(tree: _Bodies, model: RobotModel) -> str:
    """The body of the only hand. Raises `RobotError`: There are several; they are named."""
    choices = hands(model)
    if len(choices) > 1:
        raise RobotError(
            f"{model.name} has several hands: {', '.join(choices)}: say which holds the object, --tip {choices[0]} "
            f"(`proprio robot new`) or --set robot.tip={choices[0]}"
        )
    return tree.body(choices[0])


def _end(tree: _Bodies, path: tuple[Joint, ...], tip: str) -> str:
    """The last body before fingers. Raises `RobotError`: There is none that moves."""
    own = tree.before_fingers(path)
    if not own:
        raise RobotError(
            f"tip: no joint of an arm moves {tip}: name the last link of the arm, where its hand is"
        )
    return own[-1].child


def _names(tree: _Bodies, body: str) -> list[str]:
    return [*tree.links(body), *(joint.name for joint in tree.path(body))]


class _Bodies:
    """Links that are fixed to each other, each body called by its first link."""

    def __init__(self, model: RobotModel) -> None:
        self._root = model.root
        self._depth = {model.root: 0}
        self._body = {model.root: model.root}
        self._carrier: dict[str, Joint] = {}  # the joint that moves a body
        self.moving: dict[str, list[Joint]] = {
            model.root: []
        }  # joints that move, by the body before
        for joint in model.joints:
            self._depth[joint.child] = self._depth[joint.parent] + 1
            fixed = joint.kind == "fixed"
            self._body[joint.child] = self._body[joint.parent] if fixed else joint.child
            if not fixed:
                self.moving[self._body[joint.parent]].append(joint)
                self.moving[joint.child] = []
                self._carrier[joint.child] = joint
        # the most joints that move by themselves behind a body, one behind the other
        self.beyond: dict[str, int] = {}
        for name in reversed(self.moving):
            self.beyond[name] = max(map(self.reach, self.moving[name]), default=0)
        self._turns = any(joint.kind in ("revolute", "continuous") for joint in model.joints)

    def body(self, link: str) -> str:
        """That a link is a part of."""
        return self._body[link]

    def reach(self, joint: Joint) -> int:
        """Joints that move by themselves from this one on, one behind the other."""
        return joint.independent + self.beyond[joint.child]

    def path(self, link: str) -> tuple[Joint, ...]:
        """The joints that move a link, from the base on."""
        joints = []
        body = self._body[link]
        while body != self._root:
            joints.append(self._carrier[body])
            body = self._body[joints[-1].parent]
        return tuple(reversed(joints))

    def before_fingers(self, path: tuple[Joint, ...]) -> tuple[Joint, ...]:
        """Those of a path that are no fingers by their names; all of it where nothing else is there."""
        count = len(path)
        while count and self._is_called_finger(path[count - 1]):
            count -= 1
        return path[:count] or path

    def ends(self) -> Iterator[str]:
        """The last body of each limb that is long enough for an arm, or of the longest one."""
        waiting = [(self._root, 0)]
        while waiting:
            body, passed = waiting.pop()
            moving = self._without_sensors(self.moving[body])
            longest = max(moving, key=self.reach, default=None)
            branches = passed >= self.beyond[body] and self._forks(moving, longest)
            if longest is None or branches or not longest.independent or self.is_finger(longest):
                yield body
                continue
            least = max(FEWEST_JOINTS, self.reach(longest) // 2)
            limbs = [each for each in moving if each is longest or self.reach(each) >= least]
            waiting += [
                (each.child, passed + 1)
                for each in reversed(limbs)
                if each.independent and not self.is_finger(each)
            ]

    def is_limb(self, joint: Joint) -> bool:
        """Whether something hangs there that moves by itself in more than one way, and is called neither finger nor camera."""
        beside = self.is_finger(joint) or self._is_called_sensor(joint)
        return self.reach(joint) > 1 and not beside

    def _forks(self, moving: list[Joint], longest: Joint | None) -> bool:
        """Whether a body moves several others, as a palm does fingers, and not an arm that goes on with something small beside."""
        if longest is None or self.reach(longest) < FEWEST_JOINTS:
            return len(moving) > 1
        return sum(2 * self.reach(each) > self.reach(longest) for each in moving) > 1

    def _without_sensors(self, moving: list[Joint]) -> list[Joint]:
        """The joints without those that only turn a camera or the like, which hang beside an arm or at its end."""
        no_sensors = [each for each in moving if not self._is_called_sensor(each)]
        return [each for each in no_sensors if not self._is_sensor(each)] or no_sensors

    def _is_called_sensor(self, joint: Joint) -> bool:
        return any(_SENSOR.search(name) for name in (joint.child, joint.name))

    def _is_sensor(self, joint: Joint) -> bool:
        """By its name, or where one or two joints end in a sensor and no tool, as of a camera that pans and tilts."""
        if self._is_called_sensor(joint):
            return True
        behind = [joint.child]
        for body in behind:
            behind += [each.child for each in self.moving[body]]
        links = [link for body in behind for link in self.links(body)]
        return (
            self.reach(joint) < FEWEST_JOINTS
            and any(map(_SENSOR.search, links))
            and not any(self.tools(body) for body in behind)
        )

    def links(self, body: str) -> list[str]:
        """Of a body, the last one first; of those as far away, the first."""
        links = [link for link in self._body if self._body[link] == body]
        return sorted(links, key=lambda link: -self._depth[link])

    def rank(self, link: str) -> int:
        """How sure it is by its name that a link is a tool's, 0 the surest; as many as there are names where it is none."""
        if _SENSOR.search(link):
            return len(_TOOLS)
        ranks = (number for number, form in enumerate(_TOOLS) if re.search(form, link, re.I))
        return next(ranks, len(_TOOLS))

    def tools(self, body: str) -> list[str]:
        """Tool frames of a body, the one nearest to the object first."""
        found = [
            (-self.rank(link), self._depth[link], link)
            for link in self.links(body)
            if link != body and self.rank(link) < len(_TOOLS)
        ]
        return [link for _, _, link in sorted(found, reverse=True)]

    def hand(self, body: str) -> str:
        """Where a body probably holds things: a tool frame, else its last link that is no sensor and no finger."""
        links = self.links(body)
        plain = [link for link in links if not _SENSOR.search(link) and not _FINGER.search(link)]
        return (self.tools(body) or plain or links)[0]

    def is_finger(self, joint: Joint) -> bool:
        """By its name, or as the last slide of an arm that turns with no tool beyond it."""
        if self._is_called_finger(joint) or re.search("gripper", joint.name, re.I):
            return True
        is_last = not self.beyond[joint.child] and joint.kind == "prismatic"
        return is_last and self._turns and not self.tools(joint.child)

    def _is_called_finger(self, joint: Joint) -> bool:
        return any(_FINGER.search(name) for name in (joint.child, joint.name))
