"""Where a robot's description comes from: a URDF file, a bag that holds ``/robot_description``, or the package robot_descriptions.

The last one has the URDFs of some hundred robots and is not installed with this package.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path

from proprio_ros.errors import RobotError, one_line
from proprio_ros.inputs.reading import path_problem
from proprio_ros.robot.links import Joint
from proprio_ros.robot.tree import RobotModel
from proprio_ros.robot.urdf import LONGEST_REFUSAL

# what a source begins with that names a robot of the package robot_descriptions
PACKAGE = "robot_descriptions:"
_BAGS = (".mcap", ".db3")
_TOOLS = ("tcp", r"(^|_)(eef?|end_?effector|grasp)", "tool", "hand", "flange", "gripper")
"""What fixed frames of tools are called, those nearest to the object first."""
_FINGER = re.compile("finger|jaw|knuckle|claw|thumb", re.I)


def is_description(text: str) -> bool:
    """Whether a source names a description alone, which says nothing of motors."""
    return text.startswith(PACKAGE) or Path(text).suffix in (".urdf", ".xacro")


def is_bag(path: Path) -> bool:
    """Whether a path may be a bag: a folder, or a file of one."""
    return path.suffix in _BAGS or path.is_dir()


def read_model(
    source: str,
    of_bag: Callable[[Path], str] | None = None,
) -> RobotModel:
    """The tree of links that a source, a path or ``robot_descriptions:NAME``, describes.

    What takes a description out of a bag raises what it likes; without it, a bag is refused.

    Raises `RobotError`: There is no such description, or it is no physical tree.
    """
    if source.startswith(PACKAGE):
        return RobotModel.from_urdf(_packaged(source.removeprefix(PACKAGE)))
    path = Path(source)
    problem = path_problem(path)
    if problem:
        raise RobotError(f"{one_line(source, 60)}: {problem}")
    if is_bag(path):
        if of_bag is None:
            raise RobotError(
                f"{path}: is a bag, which only a reader of bags can take a description from"
            )
        return RobotModel.from_urdf_string(of_bag(path), f"/robot_description of {path.name}")
    if path.suffix == ".xacro":
        urdf = f"{path.name.split('.')[0]}.urdf"
        raise RobotError(f"{path.name}: holds xacro macros; expand it first: xacro {path} > {urdf}")
    return RobotModel.from_urdf(path)


def _packaged(name: str) -> Path:
    """The URDF of a robot of the package robot_descriptions, which may fetch it."""
    where = f"{PACKAGE}{one_line(name, 60)}"
    if not re.fullmatch(r"[A-Za-z0-9_]{1,100}", name):
        raise RobotError(f"{where}: no name of a description, such as {PACKAGE}ur10e")
    try:
        importlib.import_module("robot_descriptions")
    except ImportError as error:
        raise RobotError(
            f"{where}: the package is not installed: pip install robot_descriptions, or give a .urdf file"
        ) from error
    module = f"robot_descriptions.{name.removesuffix('_description')}_description"
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise RobotError(f"{where}: needs {error.name}, which is not installed") from error
        raise RobotError(
            f"{where}: the package has no such description; `python -m robot_descriptions list` names them"
        ) from error
    except Exception as error:
        # it clones a repository when it is imported: git and the network fail as they like
        raise RobotError(f"{where}: cannot be fetched ({one_line(str(error), 120)})") from error
    path = getattr(found, "URDF_PATH", None)
    if not path:
        raise RobotError(
            f"{where}: has no URDF there; take another description of that robot, or give a .urdf file"
        )
    return Path(path)


def hand_link(model: RobotModel) -> str:
    """A guess at the link in which objects are held: a tool frame fixed to the arm's last body, else the last link of that body.

    The last body is the one before the tree branches into fingers, or before a joint that is a finger by its name; never a finger.
    """
    tree = _Bodies(model)
    hand = model.root
    passed = 0
    while tree.moving[hand]:
        joint = max(tree.moving[hand], key=tree.reach)
        branches = len(tree.moving[hand]) > 1 and passed >= tree.beyond[hand]
        if branches or not joint.independent or tree.is_finger(joint):
            break
        hand = joint.child
        passed += 1
    links = tree.tools(hand) or tree.links(hand)
    return links[0]


class _Bodies:
    """Links that are fixed to each other, each body called by its first link."""

    def __init__(self, model: RobotModel) -> None:
        self._depth = {model.root: 0}
        self._body = {model.root: model.root}
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
        # the most joints that move by themselves behind a body, one behind the other
        self.beyond: dict[str, int] = {}
        for name in reversed(self.moving):
            self.beyond[name] = max(map(self.reach, self.moving[name]), default=0)

    def reach(self, joint: Joint) -> int:
        """Joints that move by themselves from this one on, one behind the other."""
        return joint.independent + self.beyond[joint.child]

    def links(self, body: str) -> list[str]:
        """Of a body, the last one first; of those as far away, the first."""
        links = [link for link in self._body if self._body[link] == body]
        return sorted(links, key=lambda link: -self._depth[link])

    def tools(self, body: str) -> list[str]:
        """Tool frames of a body, the one nearest to the object first."""
        found = []
        for link in self.links(body):
            ranks = [n for n, form in enumerate(_TOOLS) if re.search(form, link, re.I)]
            if ranks and link != body:
                found.append((-ranks[0], self._depth[link], link))
        return [link for _, _, link in sorted(found, reverse=True)]

    def is_finger(self, joint: Joint) -> bool:
        """By its name, or as the last slide with no tool beyond it."""
        names = (joint.child, joint.name)
        if any(_FINGER.search(name) for name in names):
            return True
        if re.search("gripper", joint.name, re.I):
            return True
        is_last = not self.beyond[joint.child] and joint.kind == "prismatic"
        return is_last and not self.tools(joint.child)


def check_masses(model: RobotModel, source: str) -> None:
    """Refuse a robot that lacks the mass of a link that its arm moves.

    Raises:
        RobotError: That is so; all are named.
    """
    if model.missing:
        raise RobotError(f"{source}: {'; '.join(model.missing)}", longest=LONGEST_REFUSAL)
