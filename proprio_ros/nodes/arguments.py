"""What is said to a launch file, checked before anything is started."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from proprio_ros.errors import ConfigurationError
from proprio_ros.probes import virtual_object
from proprio_ros.recordings.description import robot_named


def check_arguments(
    robot: str = "",
    params_file: str = "",
    held: str = "",
) -> None:
    """Refuse in one line what the nodes would refuse one after the other, or would start without.

    Args:
        robot: Name or file of the robot; empty: not stated.
        params_file: The user's parameter file; empty: none.
        held: What the virtual hand is to hold; empty: no virtual robot.

    Raises:
        ProprioError: One of these is not there, or not understood.
    """
    if params_file:
        _check_parameters(Path(params_file))
    if robot:
        robot_named(robot)
    if held:
        virtual_object(held)


def _check_parameters(path: Path) -> None:
    """A file that is not there would leave the arm to the default limits without a word."""
    try:
        content = YAML(typ="safe", pure=True).load(path)
    except (OSError, UnicodeDecodeError, YAMLError) as error:
        what = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise ConfigurationError(
            f"params_file {path}: not readable ({what}); nothing was started"
        ) from error
    if not isinstance(content, Mapping) or not all(
        isinstance(section, Mapping) and "ros__parameters" in section
        for section in content.values()
    ):
        raise ConfigurationError(
            f"params_file {path}: states no node's parameters; write '/**/driver:' and below it 'ros__parameters:', as in "
            "config/driver.yaml; nothing was started"
        )
