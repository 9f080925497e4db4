"""Our values as ROS messages. Scalars go through `float()`: Jazzy publishes other types as garbage without a word."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import InertiaStamped, Point
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from visualization_msgs.msg import Marker, MarkerArray

from proprio_ros.probes.base import Carried, Shapes
from proprio_ros.quantity import Z95, shown, spec_for

LEVELS = {
    "ok": DiagnosticStatus.OK,
    "warning": DiagnosticStatus.WARN,
    "error": DiagnosticStatus.ERROR,
}
KINDS = {
    "box": Marker.CUBE,
    "cylinder": Marker.CYLINDER,
    "sphere": Marker.SPHERE,
}
BLUE = (0.1, 0.5, 0.9)
AMBER = (1.0, 0.65, 0.0)
UNKNOWN_LOAD = Carried(
    np.nan,
    [np.nan] * 3,
    np.full((3, 3), np.nan),
)
"""What is published where a load was published before that stands no longer."""
Floats = Sequence[float]


def time_message(time_ns: int) -> Time:
    """A stamp from nanoseconds."""
    seconds, nanoseconds = divmod(int(time_ns), 1_000_000_000)
    return Time(sec=seconds, nanosec=nanoseconds)


def time_ns(stamp: Time) -> int:
    """Nanoseconds from a stamp."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def first_stamp_ns(data: bytes) -> int:
    """Stamp of a serialised message that begins with a header: after four bytes of encapsulation, little-endian as DDS sends it."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def joint_state(
    stamp_ns: int,
    names: Sequence[str],
    position: Floats = (),
    velocity: Floats = (),
    effort: Floats = (),
) -> JointState:
    """A joint state; quantities that are not known stay empty.

    Args:
        stamp_ns: Its stamp [ns].
        names: Joints, shape (J,).
        position: Of these, shape (J,) [rad or m].
        velocity: Of these, shape (J,) [rad/s or m/s].
        effort: Of these, shape (J,) [N m or N].
    """
    message = JointState(name=list(names))
    message.header.stamp = time_message(stamp_ns)
    message.position = list(map(float, position))
    message.velocity = list(map(float, velocity))
    message.effort = list(map(float, effort))
    return message


def labelled(values: Mapping[str, float]) -> Float64MultiArray:
    """Numbers by joint; `layout.dim` names the joints, joined by commas."""
    size = len(values)
    layout = MultiArrayLayout(
        dim=[MultiArrayDimension(label=",".join(values), size=size, stride=size)]
    )
    return Float64MultiArray(
        layout=layout,
        data=list(map(float, values.values())),
    )


def by_joint(
    message: Float64MultiArray,
    order: Sequence[str],
) -> dict[str, float] | str:
    """Numbers by joint: as labelled, else in the given order; a sentence where neither fits. Without numbers nothing is driven."""
    labels = [
        label.strip()
        for dim in message.layout.dim
        for label in dim.label.split(",")
        if label.strip()
    ]
    names = labels or list(order)
    if not message.data:
        return {}
    if len(message.data) != len(names):
        named = f"labelled {', '.join(labels)}" if labels else f"for the joints {', '.join(order)}"
        return f"a command of {len(message.data)} values {named}: give one value for each, or label them in layout.dim"
    if len(set(names)) != len(names):
        return f"a command names a joint twice: {', '.join(names)}"
    return dict(zip(names, map(float, message.data), strict=True))


def number(value: float) -> Float64:
    """A plain number to plot."""
    return Float64(data=float(value))


def text_of(value: Any) -> str:
    """Numbers with all their digits, lists in brackets."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(text_of(entry) for entry in value) + "]"
    return str(value)


def status(
    level: str,
    name: str,
    message: str,
    values: Mapping[str, Any],
    hardware_id: str = "",
) -> DiagnosticStatus:
    """A diagnostic status.

    Args:
        level: ``ok``, ``warning`` or ``error``.
        name: What it is about.
        message: A sentence.
        values: Keys and values.
        hardware_id: Of the hardware; empty: none.
    """
    return DiagnosticStatus(
        level=LEVELS[level],
        name=name,
        message=message,
        hardware_id=hardware_id,
        values=[KeyValue(key=str(key), value=text_of(value)) for key, value in values.items()],
    )


def diagnostics(stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Several statuses with one stamp."""
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = time_message(stamp_ns)
    return message


def values_of(message: DiagnosticStatus) -> dict[str, str]:
    """The key-value pairs of a status."""
    return {pair.key: pair.value for pair in message.values}


def inertia(stamp_ns: int, frame: str, carried: Carried) -> InertiaStamped:
    """A load in its frame.

    Args:
        stamp_ns: Of the newest sample that it rests on [ns].
        frame: In which it is stated.
        carried: The load.
    """
    message = InertiaStamped()
    message.header.stamp = time_message(stamp_ns)
    message.header.frame_id = frame
    message.inertia.m = float(carried.mass_kg)
    message.inertia.com.x, message.inertia.com.y, message.inertia.com.z = map(float, carried.com_m)
    upper = carried.inertia_kg_m2[np.triu_indices(3)].tolist()
    for name, value in zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), upper, strict=True):
        setattr(message.inertia, name, value)
    return message


def no_markers() -> MarkerArray:
    """Whatever was shown before goes."""
    return MarkerArray(markers=[Marker(action=Marker.DELETEALL)])


def _marker(
    header: tuple[str, int, str],
    number_: int,
    kind: int,
    size: Floats,
    colour: Floats,
    place_m: Floats = (0.0, 0.0, 0.0),
    rotation: np.ndarray | None = None,
) -> Marker:
    """One of several of a name space; the header is that, a stamp [ns] and a frame."""
    from scipy.spatial.transform import Rotation  # takes a while, and few nodes show anything

    marker = Marker(
        ns=header[0],
        id=number_,
        type=kind,
        action=Marker.ADD,
    )
    marker.header.stamp = time_message(header[1])
    marker.header.frame_id = header[2]
    position = marker.pose.position
    turn = marker.pose.orientation
    scale = marker.scale
    position.x, position.y, position.z = map(float, place_m)
    turned = Rotation.from_matrix(np.eye(3) if rotation is None else rotation)
    turn.x, turn.y, turn.z, turn.w = turned.as_quat(canonical=True).tolist()
    scale.x, scale.y, scale.z = map(float, size)
    marker.color.r, marker.color.g, marker.color.b, marker.color.a = colour
    return marker


def markers(
    stamp_ns: int,
    frame: str,
    shapes: Shapes,
    value: float,
    std: float,
    unit: str,
    accepted: bool = True,
) -> MarkerArray:
    """Bodies at one place with the value in words above; what was shown before goes.

    Args:
        stamp_ns: Of the message [ns].
        frame: In which the bodies are.
        shapes: The bodies.
        value: What is shown, in ``unit``.
        std: Its standard deviation, in ``unit``.
        unit: Of both.
        accepted: Whether its interval is narrow enough; else it is amber.
    """
    header = ("proprio", stamp_ns, frame)
    colour = BLUE if accepted else AMBER
    spec = spec_for(unit, std)
    made = [
        _marker(
            header,
            n,
            KINDS[body.kind],
            body.size_m,
            (*colour, body.opacity),
            shapes.place_m,
            body.rotation,
        )
        for n, body in enumerate(shapes.bodies)
    ]
    x, y, z = shapes.place_m
    words = _marker(
        header,
        len(made),
        Marker.TEXT_VIEW_FACING,
        (0.0, 0.0, 0.03),
        (*colour, 1.0),
        (x, y, z + 0.06),
    )
    words.text = shown(
        unit,
        value,
        Z95 * std,
        spec=spec,
        between=" +- ",
    )
    if not accepted:
        words.text = shown(
            unit, max(value - Z95 * std, 0.0), value + Z95 * std, spec=spec, between=" to "
        )
    return MarkerArray(markers=[*no_markers().markers, *made, words])


def planned(
    stamp_ns: int,
    frame: str,
    place_m: np.ndarray,
    words: str,
    path_m: np.ndarray | None,
) -> MarkerArray:
    """What is known so far, and the way of the hand in the push that comes next; what was shown before goes.

    Args:
        stamp_ns: Of the message [ns].
        frame: Of the root link.
        place_m: Of the hand in that frame, shape (3,) [m].
        words: What is shown above the hand.
        path_m: Of the hand in that frame, shape (N, 3) [m]; None: no push comes.
    """
    header = ("next push", stamp_ns, frame)
    colour = (*AMBER, 1.0)
    x, y, z = map(float, place_m)
    above = _marker(
        header,
        0,
        Marker.TEXT_VIEW_FACING,
        (0.0, 0.0, 0.025),
        colour,
        (x, y, z + 0.12),
    )
    above.text = words
    array = [*no_markers().markers, above]
    if path_m is not None:
        way = _marker(
            header,
            1,
            Marker.LINE_STRIP,
            (0.004, 0.0, 0.0),
            colour,
        )
        way.points = [Point(x=x, y=y, z=z) for x, y, z in path_m.tolist()]
        # a ball where the push ends
        array += [
            way,
            _marker(
                header,
                2,
                Marker.SPHERE,
                (0.012, 0.012, 0.012),
                colour,
                path_m[-1],
            ),
        ]
    return MarkerArray(markers=array)
