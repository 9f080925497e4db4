"""ROS parameters as data: name, default, unit and range, with a description for `ros2 param describe`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterUninitializedException
from rclpy.node import Node

from proprio_ros.errors import ConfigurationError


@dataclass(frozen=True)
class Parameter:
    """One parameter of a node."""

    name: str
    default: Any  # its value where nobody states one; gives the type, too. A list is one of strings
    description: str  # for `ros2 param describe`, with the unit
    # lowest, highest: range of a number, ends included
    lowest: float | None = None
    highest: float | None = None
    dynamic: bool = False  # whether it may be changed while the node runs
    loose: bool = False  # a text that may look like a number: ``-p object:=0.05`` comes as one
    choices: tuple[str, ...] = ()  # all values that there are, beside the default; empty: any

    def check(self, value: Any) -> None:
        """Raises: ConfigurationError: The value is none of the choices."""
        if self.choices and value not in (self.default, *self.choices):
            raise ConfigurationError(
                f"parameter {self.name}={value!r}: choose one of {', '.join(self.choices)}"
            )

    def descriptor(self) -> ParameterDescriptor:
        kind = {"read_only": not self.dynamic, "dynamic_typing": self.loose}
        message = ParameterDescriptor(name=self.name, description=self.description, **kind)
        if self.lowest is not None and self.highest is not None:
            if isinstance(self.default, float):
                low = float(self.lowest)
                high = float(self.highest)
                message.floating_point_range = [
                    FloatingPointRange(from_value=low, to_value=high, step=0.0)
                ]
            else:
                message.integer_range = [
                    IntegerRange(
                        from_value=int(self.lowest),
                        to_value=int(self.highest),
                        step=1,
                    )
                ]
        return message


def declare(node: Node, parameters: Sequence[Parameter]) -> dict[str, Any]:
    """Declare parameters and return their values by name."""
    for parameter in parameters:
        # an empty list would be declared as one of bytes, and could never be set to one of strings
        default = [""] if parameter.default == [] else parameter.default
        node.declare_parameter(parameter.name, default, parameter.descriptor())
    values = {parameter.name: value_of(node, parameter.name) for parameter in parameters}
    return values | {
        parameter.name: str(values[parameter.name]) for parameter in parameters if parameter.loose
    }


def value_of(node: Node, name: str) -> Any:
    """Present value of a parameter; a string array comes as a list, without empty strings: ``[""]`` is an empty one."""
    try:
        value = node.get_parameter(name).value
    except ParameterUninitializedException:
        return []  # `[]` in a parameter file: an empty list without a type is none for rcl
    return [entry for entry in value if entry != ""] if isinstance(value, (list, tuple)) else value


def fields_stated(
    kind: type,
    values: Mapping[str, Any],
) -> dict[str, Any]:
    """Fields of a data class that are parameters, whose names have no unit: ``max_jump`` is ``max_jump_rad``."""
    return {
        field.name: value
        for field in fields(kind)
        for name, value in values.items()
        if re.fullmatch(f"{name}(_m|_s|_C|_rad|_rad_s)?", field.name)
    }


INPUT_TOPICS = {
    "effort": "/forward_effort_controller/commands",
    "position": "/position_controller/commands",
}
"""Where controllers of others usually listen."""
ROBOT = Parameter(
    "robot", "open_manipulator_x", "Robot of config/robots, or the path of a robot file."
)
_ABOUT_AUTOSTART = "Configure and activate at once; false leaves that to a lifecycle manager or `ros2 lifecycle set`."
AUTOSTART = Parameter("autostart", True, _ABOUT_AUTOSTART)
