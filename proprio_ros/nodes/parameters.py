"""ROS parameters: what `tables` states of them is declared to rclpy, and read back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterUninitializedException
from rclpy.node import Node

from proprio_ros.nodes.tables import Parameter


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """What `ros2 param describe` shows."""
    kind = {"read_only": not parameter.dynamic, "dynamic_typing": parameter.loose}
    message = ParameterDescriptor(name=parameter.name, description=parameter.description, **kind)
    if parameter.lowest is not None and parameter.highest is not None:
        if isinstance(parameter.default, float):
            low = float(parameter.lowest)
            high = float(parameter.highest)
            message.floating_point_range = [
                FloatingPointRange(from_value=low, to_value=high, step=0.0)
            ]
        else:
            message.integer_range = [
                IntegerRange(
                    from_value=int(parameter.lowest),
                    to_value=int(parameter.highest),
                    step=1,
                )
            ]
    return message


def declare(node: Node, parameters: Sequence[Parameter]) -> dict[str, Any]:
    """Declare parameters and return their values by name."""
    for parameter in parameters:
        # an empty list would be declared as one of bytes, and could never be set to one of strings
        default = [""] if parameter.default == [] else parameter.default
        node.declare_parameter(parameter.name, default, descriptor(parameter))
    values = {
        parameter.name: parameter.as_known(value_of(node, parameter.name))
        for parameter in parameters
    }
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
