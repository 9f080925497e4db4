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
from proprio_ros.robot.tree import RobotModel
from proprio_ros.robot.urdf import LONGEST_REFUSAL

# what a source begins with that names a robot of the package robot_descriptions
PACKAGE = "robot_descriptions:"
_BAGS = (".mcap", ".db3")


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


def check_masses(model: RobotModel, source: str) -> None:
    """Refuse a robot that lacks the mass of a link that its arm moves.

    Raises:
        RobotError: That is so; all are named.
    """
    if model.missing:
        raise RobotError(f"{source}: {'; '.join(model.missing)}", longest=LONGEST_REFUSAL)
