"""Which nodes are started together, with which parameters, and what becomes of all when one ends.

`calibration.launch.py`, `proprio live` and `proprio demo` start what is said here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.resources import resource
from proprio_ros.nodes.arguments import Stated
from proprio_ros.nodes.tables import NODES
from proprio_ros.probes import all_probes, virtual_object
from proprio_ros.probes.base import HasBaseline
from proprio_ros.recordings.description import robot_named

RELEASE_S = 15.0
"""From asking nodes to end until they are made to: a job that is under way is ended and its recording written before."""


@dataclass(frozen=True)
class Start:
    """One node that is started: its parameter files, and what is stated over them."""

    node: str
    files: Sequence[str]
    parameters: Mapping[str, Any]


def starts(stated: Stated) -> list[Start]:
    """What the arguments start, in this order.

    Args:
        stated: The arguments.

    Returns:
        The nodes; all of them are in the arguments' namespace.

    Raises:
        ProprioError: One of the arguments is not understood, or names a file that is not there.
    """
    check_arguments(stated["robot"], stated.params_file, stated.held)
    own = [stated.params_file] if stated.params_file else []
    found = []
    for node, texts in _stated_of_nodes(stated).items():
        files = [str(resource("parameters", node)), *own]
        found.append(Start(node, files, _typed(node, texts)))
    return found


def ends_all(node: str) -> bool:
    """Whether the end of a node ends all others, too.

    Nothing can be weighed without the driver; started anew it would take hold of an arm that nobody expects to move. Any other
    may be started again, and the driver holds the arm meanwhile: an identifier that dies must not drop it.

    Args:
        node: Its name.
    """
    return node in ("driver", "virtual")


def services_for(held: str) -> list[str]:
    """Names of the services to call for what the virtual hand holds; without one, for a payload."""
    kind = held.partition(":")[0].strip()
    theirs = (
        probe
        for probe in all_probes()
        if probe.virtual_object is not None and probe.virtual_object.kind == kind
    )
    probe = next(theirs, all_probes()[0])
    baseline = [f"record_{probe.name}_baseline"] if isinstance(probe, HasBaseline) else []
    return [*baseline, f"calibrate_{probe.name}"]


def _stated_of_nodes(stated: Stated) -> dict[str, dict[str, str]]:
    """By node, what the arguments state of its parameters; empty texts state nothing."""
    namespace = stated.namespace
    robot = stated["robot"]
    found = {
        "driver": {"robot": robot, "port": stated.port, "rate": stated["rate"]},
        "excitation": {"robot": robot},
        "identifier": {
            "robot": robot,
            "data_directory": stated.data_directory,
            "reference_mass": stated.reference_mass,
            "reference_wait": "1.0" if stated.virtual else "",
            "frame_prefix": f"{namespace}/" if namespace else "",
        },
    }
    if not stated.virtual:
        return found
    # whoever has no weight has none to put into the hand either
    weighs = _number("reference_mass", stated.reference_mass, float) > 0.0
    virtual = {
        "robot": robot,
        "link": stated.port,
        "object": stated["object"],
        "seed": stated["seed"],
        "reference": stated.reference_mass if weighs else "",
    }
    return {"virtual": virtual, **found}


def _typed(node: str, texts: Mapping[str, str]) -> dict[str, Any]:
    """Texts as values of the parameters' types."""
    kinds = {parameter.name: type(parameter.default) for parameter in NODES[node]}
    return {
        name: text if kinds[name] is str else _number(name, text, kinds[name])
        for name, text in texts.items()
        if text
    }


def _number(name: str, text: str, kind: type) -> Any:
    try:
        return kind(text)
    except ValueError as error:
        what = "a whole number" if kind is int else "a number"
        raise ConfigurationError(f"{name} {text!r}: must be {what}; nothing was started") from error


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
