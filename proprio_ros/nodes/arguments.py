"""What can be said to `calibration.launch.py` and to `proprio live`: the same arguments, and what each means for the nodes."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from proprio_ros.errors import ConfigurationError


@dataclass(frozen=True)
class Argument:
    """One of them, which can be left out."""

    default: str
    about: str


ARGUMENTS = {
    "virtual": Argument("false", "Start a virtual robot, and drive it."),
    "robot": Argument("", "Robot of config/robots, or a robot file. Empty: as in the parameter files."),
    "port": Argument("", "Serial port of the servo bus; of a virtual robot the path under which its bus appears. Empty: as in the "
                     "parameter files (/dev/ttyUSB0); of a virtual robot one in the folder for temporary files."),
    "rate": Argument("", "Cycles per second of the driver [Hz]. Empty: as in the parameter files (100)."),
    "object": Argument("0.05", "What the virtual hand holds in a probe: a mass [kg], payload:.., container:.., block:.., or none."),
    "seed": Argument("", "Draws the virtual arm's hidden numbers. Empty: as in the parameter files (1)."),
    "reference_mass": Argument("", "Mass of a weighed object that you put into the hand when calibrate_robot asks for it [kg]; 0: "
                               "none. Empty: as in the parameter files (0); of a virtual robot 0.1, and its helper does it."),
    "data_directory": Argument("", "Where recordings, results and calibrations are kept. Empty: as in the parameter files; of a "
                               "virtual robot a folder of its own, so that no real arm is weighed with its calibration."),
    "params_file": Argument("", "A parameter file of yours; counts over the package's, not over arguments."),
    "namespace": Argument("", "Of all nodes, for several arms on one network; frames begin with it, too."),
}  # fmt: skip
"""By name; texts, as they are typed."""


def checked_namespace(text: str) -> str:
    """Without slashes at its ends. Raises: ConfigurationError: ROS takes no such name."""
    namespace = text.strip("/")
    parts = namespace.split("/") if namespace else []
    if not all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", part) for part in parts):
        raise ConfigurationError(
            f"namespace {text!r}: letters, digits and _, and no digit first, with / between parts"
        )
    return namespace


class Stated:
    """What the arguments state; empty: nothing.

    Args:
        texts: By name; one that is not there has its default.
    """

    def __init__(self, texts: Mapping[str, str]) -> None:
        self._texts = {name: argument.default for name, argument in ARGUMENTS.items()} | dict(texts)

    def __getitem__(self, name: str) -> str:
        return self._texts[name]

    @property
    def namespace(self) -> str:
        """Without slashes at its ends. Raises: ConfigurationError: ROS takes no such name."""
        return checked_namespace(self["namespace"])

    @property
    def virtual(self) -> bool:
        """Whether the robot is a virtual one."""
        return self["virtual"] == "true"

    @property
    def held(self) -> str:
        """By the virtual hand."""
        return self["object"] if self.virtual else ""

    @property
    def port(self) -> str:
        """Of the servo bus, where it is known here."""
        if self["port"] or not self.virtual:
            return self["port"]
        name = "_".join(["proprio_virtual", *self.namespace.split("/")])
        return str(Path(tempfile.gettempdir()) / name.rstrip("_"))

    @property
    def reference_mass(self) -> str:
        """Of the weighed object [kg]."""
        return self["reference_mass"] or ("0.1" if self.virtual else "")

    @property
    def data_directory(self) -> str:
        """Where recordings, results and calibrations are kept."""
        if self["data_directory"] or not self.virtual:
            return self["data_directory"]
        return f"~/.ros/proprio_ros/virtual_{self['seed'] or 'default'}"

    @property
    def params_file(self) -> str:
        """The user's parameter file."""
        stated = self["params_file"]
        return str(Path(stated).expanduser()) if stated else ""
