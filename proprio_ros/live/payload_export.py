"""What a robot's own controller is told of the load that was weighed, in the controller's frame and units.

Each maker has a service of its own. What the fields mean:

- ``ur``: `ur_msgs/srv/SetPayload`: all that hangs at the flange, the tool with it; centre in the frame of the flange [m]. Newer
  drivers also take an inertia about that centre; zeros mean that none is stated.
- ``franka``: `franka_msgs/srv/SetLoad`: the load beyond the end effector that is configured at the controller; centre in the frame
  of the flange [m], inertia about the centre, column by column.
- ``xarm``: `xarm_msgs/srv/SetTcpLoad`: all that hangs at the flange; centre in the frame of the flange [mm].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.probes.base import Carried
from proprio_ros.robot import Robot

# by how much a transform between two links that are one body may differ between two poses [m, 1]
RIGID = 1e-9


@dataclass(frozen=True)
class Controller:
    """A maker's way to be told."""

    package: str  # of the service's messages
    kind: str  # the service's type
    service: str  # its usual name
    links: tuple[str, ...]  # names that the flange has in the maker's URDFs
    with_tool: bool  # whether it wants the tool, too
    fill: Callable[[Any, Carried], None]  # writes a load into a request
    refusal: Callable[[Any], str]  # why a response says no, or an empty string


def load_at(robot: Robot, carried: Carried, link: str) -> Carried:
    """A load in the frame of another link.

    Args:
        robot: The arm.
        carried: The load, in the robot's payload frame.
        link: The other link.

    Returns:
        The same load in that link's frame.

    Raises:
        RobotError: There is no such link.
        ConfigurationError: A joint lies between the two links.
    """
    model = robot.model

    def seen(position: float) -> np.ndarray:
        pose = dict.fromkeys(model.independent_joints, position)
        away = model.frame_transform(robot.payload_frame, pose)
        return np.asarray(np.linalg.solve(model.frame_transform(link, pose), away))

    transform = seen(0.0)
    if np.abs(transform - seen(0.1)).max() > RIGID:
        moves = f"{link} moves against {robot.payload_frame}, in which objects are held"
        raise ConfigurationError(f"hand_on_link: {moves}; state a link that does not")
    turn = transform[:3, :3]
    centre = turn @ np.asarray(carried.com_m, float) + transform[:3, 3]
    return replace(
        carried, com_m=centre.tolist(), inertia_kg_m2=turn @ carried.inertia_kg_m2 @ turn.T
    )


def together(load: Carried, tool: Sequence[float]) -> Carried:
    """Load and tool (its mass and centre of mass: kg, m, m, m) as one body, all in the frame of the flange.

    Its inertia is not known where the tool has a mass: nobody states that of a tool.
    """
    tool_kg = tool[0]
    centre = np.asarray(tool[1:], float)
    if tool_kg == 0.0:
        return load
    mass = load.mass_kg + tool_kg
    com = (load.mass_kg * np.asarray(load.com_m, float) + tool_kg * centre) / mass
    return replace(
        load,
        mass_kg=mass,
        com_m=com.tolist(),
        inertia_kg_m2=np.full((3, 3), math.nan),
    )


def check_tool(controller: str, tool: Sequence[float]) -> tuple[float, ...]:
    """The tool that the controller is to know beside the load, as it is stated: nothing, or mass [kg] and centre of mass [m].

    Raises `ConfigurationError`: It is missing where the controller wants it, or is no mass and centre.
    """
    if not len(tool):
        if CONTROLLERS[controller].with_tool:
            wanted = f"{controller} wants to know all that hangs at its flange"
            state = "state mass [kg] and centre of mass [m] of the empty gripper in the frame of the flange"
            raise ConfigurationError(
                f"hand_on_tool: {wanted}: {state}, [0.0, 0.0, 0.0, 0.0] if there is none"
            )
        return (0.0, 0.0, 0.0, 0.0)
    values = tuple(float(value) for value in tool)
    if (
        len(values) != 4
        or not all(map(math.isfinite, values))
        or values[0] < 0.0
        or max(map(abs, values[1:])) > 2.0
    ):
        state = "state four numbers, the mass [kg] and the centre of mass in the frame of the flange [m]"
        raise ConfigurationError(f"hand_on_tool={list(tool)}: {state}")
    return values


def _inertia(load: Carried) -> np.ndarray:
    """Zeros where it is not known, only assumed: controllers then make do with mass and centre."""
    known = load.inertia_is != "assumed" and np.isfinite(load.inertia_kg_m2).all()
    return load.inertia_kg_m2 if known else np.zeros((3, 3))


def _fill_ur(request: Any, load: Carried) -> None:
    request.mass = float(load.mass_kg)
    centre = request.center_of_gravity
    inertia = _inertia(load)
    centre.x, centre.y, centre.z = (float(value) for value in load.com_m)
    if hasattr(request, "ixx"):  # newer drivers
        for axes in ("xx", "yy", "zz", "xy", "xz", "yz"):
            row, column = map("xyz".index, axes)
            setattr(request, f"i{axes}", float(inertia[row, column]))


def _fill_franka(request: Any, load: Carried) -> None:
    request.mass = float(load.mass_kg)
    request.center_of_mass = [float(value) for value in load.com_m]
    request.load_inertia = _inertia(load).ravel(order="F").tolist()


def _fill_xarm(request: Any, load: Carried) -> None:
    request.weight = float(load.mass_kg)
    request.center_of_gravity = [1000.0 * float(value) for value in load.com_m]


CONTROLLERS = {
    "ur": Controller(
        "ur_msgs", "SetPayload", "/io_and_status_controller/set_payload", ("tool0",), True, _fill_ur,
        lambda response: "" if response.success else "no reason given",
    ),
    "franka": Controller(
        "franka_msgs", "SetLoad", "/service_server/set_load", ("fr3_link8", "fer_link8", "panda_link8"), False, _fill_franka,
        lambda response: "" if response.success else response.error or "no reason given",
    ),
    "xarm": Controller(
        "xarm_msgs", "SetTcpLoad", "/xarm/set_tcp_load", ("link_eef",), True, _fill_xarm,
        lambda response: "" if response.ret == 0 else f"code {response.ret}, {response.message or 'no reason given'}",
    ),
}  # fmt: skip
"""By name, as the parameter `hand_on` takes it."""
