"""Where a robot's description comes from: a URDF file, a bag that holds ``/robot_description``, or the package robot_descriptions.

The last one has the URDFs of some hundred robots and is not installed with this package.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path

from proprio_ros.errors import RobotError, one_line, some
from proprio_ros.inputs.reading import path_problem
from proprio_ros.robot.tree import RobotModel
from proprio_ros.robot.urdf import Joint

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
    depth = {model.root: 0}
    body = {model.root: model.root}
    moving: dict[str, list[Joint]] = {model.root: []}  # by body, which its first link names
    for joint in model.joints:
        depth[joint.child] = depth[joint.parent] + 1
        body[joint.child] = body[joint.parent] if joint.kind == "fixed" else joint.child
        if joint.kind != "fixed":
            moving[body[joint.parent]].append(joint)
            moving[joint.child] = []
    beyond: dict[str, int] = {}  # the most joints that move by themselves, one behind the other
    for name in reversed(moving):
        beyond[name] = max(
            (each.independent + beyond[each.child] for each in moving[name]), default=0
        )

    def tools(of: str) -> list[tuple[int, int, str]]:
        names = [link for link in body if body[link] == of]
        ranks = {
            link: next((n for n, form in enumerate(_TOOLS) if re.search(form, link, re.I)), -1)
            for link in names
        }
        return [
            (-rank, depth[link], link) for link, rank in ranks.items() if rank >= 0 and link != of
        ]

    hand = model.root
    before = 0
    while moving[hand]:
        joint = max(
            moving[hand],
            key=lambda each: each.independent + beyond[each.child],
        )
        branches = len(moving[hand]) > 1 and before >= beyond[hand]
        finger = (
            _FINGER.search(joint.child)
            or _FINGER.search(joint.name)
            or re.search("gripper", joint.name, re.I)
        )
        last = not beyond[joint.child] and joint.kind == "prismatic" and not tools(joint.child)
        if branches or finger or last or not joint.independent:
            break
        hand = joint.child
        before = before + 1
    if found := tools(hand):
        return max(found)[2]
    return max((link for link in body if body[link] == hand), key=lambda link: depth[link])


def check_masses(model: RobotModel, source: str) -> None:
    """Raises: RobotError: Some joints move nothing that has mass; all are named."""
    mass = {link.name: float(link.pseudo_inertia[3, 3]) for link in model.links}
    carried = {joint.child: mass[joint.child] for joint in model.joints if joint.independent}
    body = {link: link for link in carried}
    for joint in model.joints:
        if not joint.independent and joint.parent in body:
            body[joint.child] = body[joint.parent]
            carried[body[joint.parent]] += mass[joint.child]
    bare = [name for name, total in carried.items() if total <= 0.0]
    if bare:
        raise RobotError(
            f"{source}: no <inertial> in links that move: {some(bare)}; state mass, centre and inertia of each"
        )
