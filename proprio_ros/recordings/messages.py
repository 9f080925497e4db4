"""The few types of ROS messages that recordings come in, and messages as they come over a wire."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/String": "string data",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/msg/Bool": "bool data",
    "std_msgs/msg/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/msg/MultiArrayLayout": "MultiArrayDimension[] dim\nuint32 data_offset",
    "std_msgs/msg/Float64MultiArray": "MultiArrayLayout layout\nfloat64[] data",
    "std_msgs/msg/Float32MultiArray": "MultiArrayLayout layout\nfloat32[] data",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
    "diagnostic_msgs/msg/DiagnosticStatus": "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\n"
    "string name\nstring message\nstring hardware_id\nKeyValue[] values",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/PointStamped": "std_msgs/Header header\nPoint point",
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    "sensor_msgs/msg/BatteryState": "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\n"
    "float32 charge\nfloat32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n"
    "uint8 power_supply_health\nuint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n"
    "float32[] cell_temperature\nstring location\nstring serial_number",
}
"""The messages of Jazzy that a recording needs; loading the whole distribution's takes ten times as long."""


@lru_cache(maxsize=1)
def message_types() -> Any:
    """The type store of rosbags that knows these types, and no other."""
    store = get_typestore(Stores.EMPTY)
    for name, fields in _DEFINITIONS.items():
        store.register(get_types_from_msg(fields + "\n", name))
    return store


def deserialised(raw: bytes, msgtype: str) -> Any:
    """A message; behind its empty arrays rclpy's serialize_message leaves up to 8 stray bytes, which rosbags refuses."""
    for stray in (0, 4, 8):
        try:
            return message_types().deserialize_cdr(
                raw[: len(raw) - stray],
                msgtype,
            )
        except SerdeError as error:
            if "size mismatch" not in str(error) or stray == 8:
                raise
    raise AssertionError("the last try returns or raises")


def stamp_ns(message: Any) -> int:
    """The stamp in the header of a message [ns]; 0: there is none."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def labels_of(message: Any) -> list[str]:
    """What names the columns of an array: a dimension each, or one dimension with the names joined by commas."""
    return [
        label.strip()
        for label in ",".join(str(each.label) for each in message.layout.dim).split(",")
    ]


class RawMessage(NamedTuple):
    """A message as a raw subscription receives it at a time [ns], in CDR; rclpy's `serialize_message` leaves stray bytes behind."""

    topic: str
    msgtype: str
    time_ns: int
    data: bytes
