"""ROS 2 bags <-> `Recording`, without ROS: rosbags reads and writes both storages (sqlite3, mcap).

A foreign bag is repaired where the repair is certain, and every repair is noted in `Recording.notes`; where it would be
a guess (what `effort` means, which of two topics to take) the user is asked. Only the topics that are needed are
deserialised, so a bag may hold messages of types that nobody here knows.
"""

from __future__ import annotations

import csv
import shutil
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from lz4.frame import LZ4FrameDecompressor
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, StoragePlugin, Writer, WriterError, storage_mcap
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from proprio_ros.calibration_files.motors import MotorIdentity, Motors
from proprio_ros.errors import ConfigurationError, RecordingError, one_line, printable
from proprio_ros.inputs.forms import FormError, Number, Text, shortly
from proprio_ros.inputs.reading import LONGEST_TABLE, LONGEST_TEXT, finite, json_of, path_problem, text_of, yaml_of
from proprio_ros.records import (
    LOST_AFTER_PERIODS,
    MEASURED_EFFORT,
    ZERO_CURRENT_A,
    BoolArray,
    DriveSignals,
    FloatArray,
    InputRecord,
    JointRecord,
    PointTrack,
    Recording,
    Span,
    TimeArray,
)

_zstd = storage_mcap.zstd  # of the standard library, or its backport

EFFORT_UNITS = ("N.m", "A", "mA", "raw")
"""What `effort` of a foreign bag may mean; the message definition says N m (N for a slide), many drivers differ."""

CURRENT_PER_COUNT_A = 0.00269
"""Unit of Present Current of the XM430-W350: 2.69 mA (ROBOTIS e-manual, control table, register 126) [A]."""

REGISTER, LARGEST_COUNT = 65536, 4096
"""Values of a register of 16 bits, and what no motor's current, duty or load in counts exceeds."""

JOINT_STATE = "sensor_msgs/msg/JointState"
STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
BOOL = "std_msgs/msg/Bool"
BATTERY = "sensor_msgs/msg/BatteryState"
TORQUE_ENABLED = "torque_enabled"
"""Topic that says whether the motors' torque is on."""
TEMPERATURES = "motor_temperatures"
"""Topic of how warm each motor is."""
JOINT_COMMAND, BATTERY_STATE = "joint_command", "battery_state"
"""Topics of the goals of position servos, and of their supply."""
FLOAT_ARRAYS = ("std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float32MultiArray")


@dataclass(frozen=True)
class InputTopic:
    """A topic that says what drove the joints.

    Attributes:
        topic: Its name without a namespace.
        msgtype: `JOINT_STATE`, whose effort counts, or the first of `FLOAT_ARRAYS`.
        unit: Of its numbers, one of `EFFORT_UNITS`.
        joints: Order of numbers that come without names, in the driver's names; empty: the robot's.
    """

    topic: str
    msgtype: str
    unit: str
    joints: tuple[str, ...] = ()

    @property
    def msgtypes(self) -> tuple[str, ...]:
        """Types that can be read alike."""
        return (JOINT_STATE,) if self.msgtype == JOINT_STATE else FLOAT_ARRAYS


@dataclass(frozen=True)
class Conventions:
    """Which topics a driver has, and what they mean; the defaults are those of this package's own driver.

    Attributes:
        driver: What the user called it; empty where nobody said, and the only joint states of any other name are taken, too.
        states: Topic of the joint states, without a namespace.
        inputs: Topics of what drives the joints, without a namespace; the first that a bag has is taken.
        prefix: Before the names of this robot's joints; it is taken off.
        names: The robot's names by those that the driver uses, once the prefix is off.
        radians: What a unit of its positions is [rad]; those of sliding joints, too, are multiplied with it.
    """

    driver: str = ""
    states: str = "joint_states"
    inputs: tuple[InputTopic, ...] = (
        InputTopic("applied_effort", JOINT_STATE, "N.m"),
        InputTopic("current_command", FLOAT_ARRAYS[0], "A"),
    )
    prefix: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    radians: float = 1.0

    def renamed(self, names: Sequence[str]) -> tuple[str, ...]:
        """The robot's names of joints that a driver names."""
        if not self.prefix and not self.names:
            return tuple(str(name) for name in names)
        bare = [str(name).removeprefix(self.prefix) for name in names]
        return tuple(self.names.get(name, name) for name in bare)

    def published(self, name: str) -> str:
        """The driver's name of one of the robot's joints."""
        return self.prefix + next((theirs for theirs, ours in self.names.items() if ours == name), name)

    def input_of(self, msgtype: str) -> InputTopic | None:
        """What a topic of this type means that only the user has named."""
        return next((each for each in self.inputs if msgtype in each.msgtypes), None)


OUR_DRIVER = Conventions()
_STATED = {JOINT_STATE: InputTopic("", JOINT_STATE, "N.m")} | {
    kind: InputTopic("", FLOAT_ARRAYS[0], "A") for kind in FLOAT_ARRAYS
}

MIN_SAMPLES = 5
MOST_ROWS = 200_000
"""Rows of a CSV file: nearly two hours at 30 Hz."""
MOST_MESSAGES = 1_000_000
"""Messages of one topic of a bag: nearly three hours at 100 Hz."""
MOST_BYTES = 500_000_000
"""Bytes of the messages of one topic, together."""
MOST_BYTES_OF_ONE = 200_000
"""Bytes of one message: that of a thousand joints."""
MOST_UNPACKED = 2_000_000_000
"""Bytes of a compressed bag's files, or of one chunk of it, once they are unpacked."""
_NO_TIMES: TimeArray = np.empty(0, dtype=np.int64)
_TOGETHER = 8192  # messages that are decoded at once
IMPLAUSIBLE_POSITION = 50.0
"""No joint of an arm turns 50 rad or slides 50 m: such positions are degrees, millimetres or encoder counts."""

IMPLAUSIBLE_SPEED = 10.0
"""rad/s or m/s: no joint of an arm gets that fast there and back between a few samples; a damaged number does."""

LONGEST_JUMP = 3
"""Samples in a row that may be damaged: more that agree with each other are a slipped encoder."""

GARBAGE_SHARE = 0.05
"""Fewer messages than this with impossible numbers are left out; more have another unit."""

FOREIGN_CLOCK_NS = 500_000_000
"""Header stamps further than this from the recorder's time come from another clock (simulated time, another host)."""


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
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\n"
    "float64[] position\nfloat64[] velocity\nfloat64[] effort",
    "sensor_msgs/msg/BatteryState": "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\n"
    "float32 charge\nfloat32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n"
    "uint8 power_supply_health\nuint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n"
    "float32[] cell_temperature\nstring location\nstring serial_number",
}
"""The messages of Jazzy that a recording needs; loading the whole distribution's takes ten times as long."""


@lru_cache(maxsize=1)
def _types() -> Typestore:
    store = get_typestore(Stores.EMPTY)
    for name, fields in _DEFINITIONS.items():
        store.register(get_types_from_msg(fields + "\n", name))
    return store


# --- opening ---------------------------------------------------------------------------------------------------------


class _Topic(NamedTuple):
    name: str
    msgtype: str
    size: int  # messages


class _Bag:
    """The open files of one bag."""

    def __init__(self, path: Path, files: Sequence[Path], readers: list[Reader]) -> None:
        self.path = path
        self.notes: list[str] = []
        self._readers = readers
        self._between: tuple[int | None, int | None] = None, None  # recorder's times that are read [ns]
        if len(files) > 1:
            self.notes.append(f"There is no metadata.yaml; {len(files)} storage files were read as one bag.")
        for log in sorted(path.glob("*.db3-wal")) if path.is_dir() else [path.with_name(f"{path.name}-wal")]:
            if log.exists() and log.stat().st_size:
                self.notes.append(
                    f"{log.name} may hold messages that were not read; merge it with"
                    f" `sqlite3 {log.name[:-4]} 'PRAGMA wal_checkpoint'`."
                )
        counts: dict[tuple[str, str], int] = {}
        for reader in readers:
            for connection in reader.connections:
                key = (connection.topic, connection.msgtype)
                counts[key] = counts.get(key, 0) + connection.msgcount
        self.topics = [_Topic(name, msgtype, count) for (name, msgtype), count in sorted(counts.items())]

    def cut(self, states: _Topic, span: Span | None) -> None:
        """Read only a part from now on, of every topic.

        Raises:
            RecordingError: The part is behind the last joint state.
        """
        if span is None:
            return
        first_ns = min(self._recorded_ns(states))
        self._between = first_ns + span[0] if span[0] else None, None if span[1] is None else first_ns + span[1]
        if next(self._read(states), None) is None:
            until = "its end" if span[1] is None else f"{1e-9 * span[1]:g} s"
            raise RecordingError(f"{self.path}: no joint states between {1e-9 * span[0]:g} s and {until}")

    def _recorded_ns(self, topic: _Topic) -> Iterator[int]:
        """The recorder's time of the first message in each file [ns]."""
        for reader, wanted in self._wanted(topic):
            for _, time_ns, _ in reader.messages(connections=wanted):
                yield time_ns
                break

    def parts(self, states: _Topic, most: int) -> list[Span]:
        """Where to cut so that no part has more than so many joint states, and all about as many; one part where none has more."""
        count = -(-states.size // most)
        if count < 2:
            return [(0, None)]
        size, begins, last_ns = -(-states.size // count), list[int](), 0
        try:
            for number, message in enumerate(_in_order(self._read(states))):
                last_ns = message[0]
                if number % size == 0:
                    begins.append(last_ns)
        except _OutOfOrder:  # files of one bag that overlap
            times = sorted(time_ns for time_ns, _ in self._read(states))
            begins, last_ns = times[::size], times[-1]
        ends = sorted({begin_ns - begins[0] for begin_ns in begins})
        return list(zip(ends, [*ends[1:], last_ns - begins[0] + 1], strict=True))

    def messages(self, topic: _Topic) -> list[tuple[int, Any]]:
        """Recorder's time [ns] and message, of one topic, in the order of time; at least one, unless the bag was cut."""
        return [(time_ns, _deserialise(raw, topic.msgtype)) for time_ns, raw in self._raw(topic)]

    def _wanted(self, topic: _Topic) -> Iterator[tuple[Reader, list[Connection]]]:
        """The files that have a topic, with its connections."""
        for reader in self._readers:
            wanted = [c for c in reader.connections if (c.topic, c.msgtype) == (topic.name, topic.msgtype)]
            if not wanted:
                continue  # rosbags reads every topic when it is given none
            for connection in wanted:
                _require_cdr(self.path, connection)
            yield reader, wanted

    def _read(self, topic: _Topic) -> Iterator[tuple[int, bytes]]:
        """Recorder's time [ns] and message as it was recorded, file by file."""
        start_ns, stop_ns = self._between
        for reader, wanted in self._wanted(topic):
            for _, time_ns, raw in reader.messages(connections=wanted, start=start_ns, stop=stop_ns):
                yield time_ns, bytes(raw)

    def _limited(self, topic: _Topic, most: int | None = None) -> Iterator[tuple[int, bytes]]:
        """The same, of at most so many bytes each, at least one unless the bag was cut."""
        most, size, count = most or MOST_BYTES_OF_ONE, 0, 0
        for time_ns, raw in self._read(topic):
            size += len(raw)
            if len(raw) > most or size > MOST_BYTES or count == MOST_MESSAGES:
                raise RecordingError(
                    f"{self.path}: {one_line(topic.name, 60)} holds more than is read: {MOST_MESSAGES} messages, "
                    f"{MOST_BYTES / 1e6:g} MB together and {most / 1e3:g} kB each; cut the bag with `ros2 bag convert`, or give a "
                    "part of it, --span FROM:TO"
                )
            count += 1
            yield time_ns, raw
        if self._between != (None, None):
            return
        if not count:
            raise RecordingError(f"{self.path}: {topic.name} should hold {topic.size} messages but holds none")
        if count < topic.size:
            self.notes.append(f"{topic.name}: the bag promises {topic.size} messages but holds {count}.")

    def _raw(self, topic: _Topic, most: int | None = None) -> list[tuple[int, bytes]]:
        """All of them in the order of time."""
        return sorted(self._limited(topic, most), key=lambda message: message[0])

    def rows(self, topic: _Topic) -> list[_Rows]:
        """Joint states or arrays in the order of time; neighbours that differ only in their numbers come together."""
        try:
            found = list(_in_rows(_in_order(self._limited(topic)), topic.msgtype))
        except _OutOfOrder:  # files of one bag that overlap
            found = list(_in_rows(self._raw(topic), topic.msgtype))
        if not found:
            raise RecordingError(f"{self.path}: {topic.name} holds no messages in this part of the recording")
        return found


class _OutOfOrder(Exception):
    """Messages do not come in the order of time."""


def _in_order(messages: Iterable[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    """The same messages; Raises `_OutOfOrder` where one is earlier than that before it."""
    last_ns: int | None = None
    for message in messages:
        if last_ns is not None and message[0] < last_ns:
            raise _OutOfOrder
        last_ns = message[0]
        yield message


def _in_rows(messages: Iterable[tuple[int, bytes]], msgtype: str) -> Iterator[_Rows]:
    """Numbers of messages in the order of time; no more than `_TOGETHER` messages are held as they were recorded."""
    coming, waiting = iter(messages), list[tuple[int, bytes]]()
    while True:
        waiting += islice(coming, _TOGETHER - len(waiting))
        if not waiting:
            return
        first = _deserialise(waiting[0][1], msgtype)
        numbers = _numbers_of(first)
        layout = _layout(waiting[0][1], first, numbers)
        count, stamps, values = 1, None, {key: np.asarray(data, np.float64)[None] for key, data in numbers.items()}
        if layout is not None:
            count, stamps, values = layout.read([raw for _, raw in waiting])
        elif hasattr(first, "header"):
            stamps = np.array([first.header.stamp.sec * 1_000_000_000 + first.header.stamp.nanosec])
        times = np.array([time_ns for time_ns, _ in waiting[:count]], dtype=np.int64)
        yield _Rows(times, np.zeros_like(times) if stamps is None else stamps, first, values)
        del waiting[:count]


class _Rows(NamedTuple):
    """Messages that differ only in their numbers."""

    bag_ns: TimeArray  # (M,)
    stamp_ns: TimeArray  # (M,), 0 where there is none
    message: Any  # the first of them
    values: dict[str, FloatArray]  # (M, length of the field)


def _numbers_of(message: Any) -> dict[str, Any]:
    """The fields that are arrays of numbers, in their order."""
    names = ("position", "velocity", "effort") if hasattr(message, "header") else ("data",)
    return {name: getattr(message, name) for name in names}


class _Layout(NamedTuple):
    """Where the numbers lie in the bytes of a message (CDR, little-endian)."""

    stamp: int | None
    numbers: dict[str, tuple[int, int, str]]  # offset, length in bytes, type

    def read(self, raws: Sequence[bytes]) -> tuple[int, TimeArray | None, dict[str, FloatArray]]:
        """How many of the messages from the first on differ only in their numbers; their stamps and their numbers."""
        length = len(raws[0])
        count = next((n for n, raw in enumerate(raws) if len(raw) != length), len(raws))
        table = np.frombuffer(b"".join(raws[:count]), np.uint8).reshape(count, length)
        same = np.ones(length, dtype=bool)
        for offset, size, _ in self.numbers.values():
            same[offset : offset + size] = False
        if self.stamp is not None:
            same[self.stamp : self.stamp + 8] = False
        unlike = np.flatnonzero(_any(table[:, same] != table[0, same], axis=1))
        table = table[: int(unlike[0]) if len(unlike) else count]
        stamps = None
        if self.stamp is not None:
            seconds, nanoseconds = (
                table[:, at : at + 4].copy().view(kind)[:, 0].astype(np.int64)
                for at, kind in ((self.stamp, "<i4"), (self.stamp + 4, "<u4"))
            )
            stamps = seconds * 1_000_000_000 + nanoseconds
        values = {
            name: table[:, at : at + size].copy().view(kind).astype(np.float64).reshape(len(table), -1)
            for name, (at, size, kind) in self.numbers.items()
        }
        return len(table), stamps, values


def _layout(raw: bytes, message: Any, numbers: Mapping[str, Any]) -> _Layout | None:
    """Where the numbers of a message lie; None where that is not what the deserialiser says."""
    if raw[:2] != b"\0\1":
        return None
    at = 4  # behind the header, from where alignment counts

    def skip(size: int, align: int = 4) -> int:
        nonlocal at
        start = at + (4 - at) % align
        at = start + size
        return start

    def skip_text(text: str) -> None:
        skip(4)
        skip(len(text.encode()) + 1, 1)

    stamp = None
    if hasattr(message, "header"):
        stamp = skip(8)
        skip_text(message.header.frame_id)
        skip(4)
        for name in message.name:
            skip_text(name)
    else:
        skip(4)
        for dimension in message.layout.dim:
            skip_text(dimension.label)
            skip(8)
        skip(4)
    places = {}
    for key, values in numbers.items():
        skip(4)
        kind = np.dtype(np.asarray(values).dtype).newbyteorder("<")
        start = skip(values.nbytes, kind.itemsize) if len(values) else at
        places[key] = (start, values.nbytes, kind.str)
    layout = _Layout(stamp, places)
    if at > len(raw):
        return None
    _, stamps, found = layout.read([raw])
    fits = all(np.array_equal(found[key][0], np.asarray(values), equal_nan=True) for key, values in numbers.items())
    if stamps is not None:
        fits = fits and int(stamps[0]) == message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    return layout if fits else None


def _require_cdr(path: Path, connection: Connection) -> None:
    encoding = connection.ext.serialization_format if isinstance(connection.ext, ConnectionExtRosbag2) else "ros1"
    if encoding != "cdr":
        raise RecordingError(
            f"{path}: topic {connection.topic} is serialised as {encoding!r}; only 'cdr' can be read: record it with a"
            " DDS middleware or convert it with `ros2 bag convert`"
        )


def _deserialise(raw: bytes, msgtype: str) -> Any:
    """Bytes from rclpy's serialize_message have up to 8 stray ones behind empty arrays, which rosbags refuses."""
    for stray in (0, 4, 8):
        try:
            return _types().deserialize_cdr(raw[: len(raw) - stray], msgtype)
        except SerdeError as error:
            if "size mismatch" not in str(error) or stray == 8:
                raise
    raise AssertionError("the last try returns or raises")


@contextmanager
def _open(path: Path) -> Iterator[_Bag]:
    """Open a bag; whatever rosbags raises, then or while reading, becomes one line."""
    files = _files(path)
    _check_unpacked(path)
    try:
        with ExitStack() as stack:
            yield _Bag(path, files, [stack.enter_context(Reader(file)) for file in files])
    except RecordingError:
        raise
    # rosbags lets sqlite, zstd, struct, YAML, KeyError and AssertionError through, depending on which byte is wrong
    except Exception as error:
        reason = " ".join(str(error).split()).rstrip(".")[:200] or type(error).__name__
        if "erialization format" in reason:
            advice = "only 'cdr' can be read"
        elif "checksum" in reason:
            advice = "the file has changed since it was written: copy it again, or record it again"
        else:
            advice = "if the recorder was killed, try `ros2 bag reindex` or `mcap recover` on it"
        raise RecordingError(f"{path}: not readable as a ROS 2 bag ({reason}); {advice}") from error


def _files(path: Path) -> list[Path]:
    """What to hand to rosbags: the folder when it has metadata, else its storage files."""
    problem = path_problem(path)
    if problem:
        raise RecordingError(f"{one_line(str(path), 100)}: {problem}")
    if not path.exists():
        raise RecordingError(f"{path}: no such bag; give a bag folder, or a .mcap or .db3 file")
    if path.is_file():
        if path.suffix == ".bag":
            raise RecordingError(f"{path}: a ROS 1 bag; convert it with `rosbags-convert` and give the ROS 2 bag")
        if path.suffix not in (".mcap", ".db3"):
            raise RecordingError(f"{path}: not a bag; give a bag folder, or a .mcap or .db3 file")
        return [path]
    if (path / "metadata.yaml").exists():
        return [path]
    for suffix in (".mcap", ".db3"):
        files = sorted(path.glob(f"*{suffix}"))
        if files:
            return files
    inner = sorted(metadata.parent.name for metadata in path.glob("*/metadata.yaml"))
    hint = f"; did you mean one of the bags in it: {_few(inner)}?" if inner else "; give a bag folder or file"
    raise RecordingError(f"{path}: not a bag: no metadata.yaml and no .mcap or .db3 file in it{hint}")


def _check_unpacked(path: Path) -> None:
    """Refuse what would fill the disk or the memory before rosbags unpacks it."""
    if not path.is_dir():
        return
    if (path / "metadata.yaml").exists():
        text = text_of(path / "metadata.yaml", RecordingError)
        if "&" in text or len(text) > 50_000:  # a recorder writes no anchors; rosbags would follow them
            try:
                yaml_of(text)
            except ValueError as error:
                raise RecordingError(f"{path}: not readable as a ROS 2 bag (metadata.yaml: {error})") from error
    for file in path.glob("*.zstd"):
        size = 0
        with suppress(OSError, _zstd.ZstdError, EOFError), _zstd.open(file, "rb") as stream:
            while size <= MOST_UNPACKED and (data := stream.read(1 << 20)):
                size += len(data)
        if size > MOST_UNPACKED:
            raise RecordingError(f"{file}: unpacks to over {MOST_UNPACKED / 1e9:g} GB, the most that is read")


def _unzstd(data: bytes, size: int = MOST_BYTES_OF_ONE) -> bytes:
    """At most the given number of bytes, and one more."""
    return bytes(_zstd.ZstdDecompressor().decompress(data, max_length=min(size, MOST_UNPACKED) + 1))


def _unlz4(data: bytes, size: int) -> bytes:
    return bytes(LZ4FrameDecompressor().decompress(data, max_length=min(size, MOST_UNPACKED) + 1))


class _Zstd:
    """What rosbags uses of zstd for whole files and single messages, with a limit on the latter."""

    open = staticmethod(_zstd.open)
    decompress = staticmethod(_unzstd)
    ZstdError = _zstd.ZstdError


# rosbags unpacks whatever it is given; a kilobyte of zstd can stand for gigabytes
storage_mcap.DECOMPRESSORS.update(zstd=_unzstd, lz4=_unlz4)
rosbag2_reader.zstd = _Zstd


# --- topics ----------------------------------------------------------------------------------------------------------


def _few(words: Sequence[str]) -> str:
    shown = ", ".join(words[:8])
    return f"{shown} and {len(words) - 8} more" if len(words) > 8 else shown or "none"


def _listed(topics: Sequence[_Topic]) -> str:
    return _few([f"{topic.name} ({topic.msgtype.replace('/msg/', '/')})" for topic in topics])


def _called(topics: Sequence[_Topic], name: str, namespace: str = "") -> list[_Topic]:
    """Topics of this name: the one in the namespace, else the one at the root, else those of any namespace."""
    for full_name in (f"{namespace}/{name}", f"/{name}"):
        exact = [topic for topic in topics if topic.name == full_name]
        if exact:
            return exact
    return [topic for topic in topics if topic.name.endswith(f"/{name}")]


def _chosen(bag: _Bag, name: str, msgtypes: Sequence[str], option: str) -> _Topic:
    """The topic that the user named."""
    found = [topic for topic in bag.topics if topic.name in (name, f"/{name}")]
    fitting = [topic for topic in found if topic.msgtype in msgtypes]
    if not fitting:
        choices = [topic for topic in bag.topics if topic.msgtype in msgtypes]
        what = f"is {found[0].msgtype}" if found else "is not in the bag"
        raise RecordingError(f"{bag.path}: {option} {name} {what}; choose from: {_listed(choices)}")
    if fitting[0].size == 0:
        raise RecordingError(f"{bag.path}: {option} {name} holds no messages")
    return fitting[0]


def _state_topic(
    bag: _Bag, name: str | None, command_name: str | None, conventions: Conventions = OUR_DRIVER
) -> _Topic:
    if name is not None:
        return _chosen(bag, name, [JOINT_STATE], "--state-topic")
    if not any(topic.size for topic in bag.topics):
        raise RecordingError(f"{bag.path}: the bag holds no messages; record it again with `ros2 bag record`")
    typed = [topic for topic in bag.topics if topic.msgtype == JOINT_STATE]
    if not typed:
        raise RecordingError(
            f"{bag.path}: no JointState topic in the bag; it holds: {_listed(bag.topics)}; record /joint_states"
        )
    filled = [topic for topic in typed if topic.size]
    if not filled:
        raise RecordingError(f"{bag.path}: no joint states: {_listed(typed)} holds no messages")
    candidates = _called(filled, conventions.states)
    if not candidates and conventions.driver:
        raise RecordingError(
            f"{bag.path}: no joint states on {conventions.states}, where --driver {conventions.driver} has them; choose with "
            f"--state-topic from: {_listed(filled)}"
        )
    candidates = candidates or [
        topic
        for topic in filled
        if not topic.name.endswith("/applied_effort") and topic.name not in (command_name, f"/{command_name}")
    ]
    if len(candidates) != 1:
        raise RecordingError(f"{bag.path}: which joint states? choose with --state-topic from: {_listed(filled)}")
    return candidates[0]


def _input_topic(
    bag: _Bag, name: str | None, state: _Topic, conventions: Conventions = OUR_DRIVER
) -> tuple[_Topic, InputTopic] | None:
    """The topic of what drove the joints, and what it means."""
    if name is not None:
        topic = _chosen(bag, name, [JOINT_STATE, *FLOAT_ARRAYS], "--command-topic")
        return topic, conventions.input_of(topic.msgtype) or _STATED[topic.msgtype]
    namespace = state.name.removesuffix(f"/{conventions.states}")
    if namespace == state.name:  # the user named another topic
        namespace = state.name.rpartition("/")[0]
    for usual in conventions.inputs:
        filled = [topic for topic in bag.topics if topic.size and topic.msgtype in usual.msgtypes]
        candidates = [topic for topic in _called(filled, usual.topic, namespace) if topic != state]
        if len(candidates) > 1:
            raise RecordingError(f"{bag.path}: which input? choose with --command-topic from: {_listed(candidates)}")
        if candidates:
            return candidates[0], usual
    return None


def _torque_off(bag: _Bag, state: _Topic, columns: _Columns, notes: list[str]) -> tuple[tuple[int, int], ...]:
    """When torque was off, on the clock of the joint states, until the last of these."""
    namespace = state.name.rpartition("/")[0]
    candidates = _called([t for t in bag.topics if t.size and t.msgtype == BOOL], TORQUE_ENABLED, namespace)
    if len(candidates) != 1:
        if candidates:
            notes.append(f"{_listed(candidates)} may all say when torque is off; none of them was used.")
        return ()
    messages = bag.messages(candidates[0])
    last_ns = int(_times(columns, state, []).max())
    # the state heard soonest: on a busy computer most of them may come seconds late, and no clock differs for that
    ahead_ns = (columns.stamp_ns - columns.bag_ns)[columns.stamp_ns != 0]
    clock_ns = int(ahead_ns.max()) if ahead_ns.size else 0
    shift_ns = clock_ns if abs(clock_ns) > FOREIGN_CLOCK_NS else 0
    stretches: list[tuple[int, int]] = []
    off_ns: int | None = None
    for time_ns, message in messages:
        if not message.data and off_ns is None:
            off_ns = time_ns + shift_ns
        elif message.data and off_ns is not None:
            stretches.append((off_ns, time_ns + shift_ns))
            off_ns = None
    if off_ns is not None and off_ns < last_ns:
        stretches.append((off_ns, last_ns))
    return tuple(stretches)


# --- messages to columns ---------------------------------------------------------------------------------------------


class _Columns(NamedTuple):
    """Messages as columns by joint, rows in the order of recording."""

    bag_ns: TimeArray  # (M,)
    stamp_ns: TimeArray  # (M,), 0 where the header has no stamp
    names: tuple[str, ...]
    values: dict[str, FloatArray]  # quantity -> (M, J); NaN: not in the message, inf: in it, but NaN or infinite
    notes: list[str]


def _joint_state_columns(
    bag: _Bag, topic: _Topic, quantities: Sequence[str], conventions: Conventions = OUR_DRIVER
) -> _Columns:
    """Columns of a JointState topic; the first quantity must be there in every message."""
    rows = bag.rows(topic)
    named = [conventions.renamed(part.message.name) for part in rows]
    names = tuple(dict.fromkeys(name for part in named for name in part))
    theirs: dict[str, str] = {}
    for part, own in zip(rows, named, strict=True):
        for name, other in zip(own, part.message.name, strict=True):
            if theirs.setdefault(name, other) != other:
                raise RecordingError(
                    f"{bag.path}: {topic.name}: {theirs[name]} and {other} would both be {name}; state joint_names of --driver "
                    f"{conventions.driver} otherwise"
                )
    index = {name: column for column, name in enumerate(names)}
    bag_ns = np.concatenate([part.bag_ns for part in rows])
    values = {quantity: np.full((len(bag_ns), len(names)), np.nan) for quantity in quantities}
    orders = set()
    row = 0
    for part, own in zip(rows, named, strict=True):
        columns = [index[name] for name in own]
        if len(set(columns)) != len(columns):
            raise RecordingError(f"{bag.path}: {topic.name} names a joint twice in message {row + 1}")
        orders.add(tuple(columns))
        for quantity in quantities:
            data = part.values[quantity]
            length = data.shape[1]
            if length != len(columns) and (length or quantity == quantities[0]):
                raise RecordingError(
                    f"{bag.path}: {topic.name} has {len(columns)} names but {length} values of {quantity} in message"
                    f" {row + 1}; every joint needs one"
                )
            if length:
                values[quantity][row : row + len(data), columns] = _marked(data)
        row += len(part.bag_ns)
    notes = []
    if len({frozenset(order) for order in orders}) < len(orders):
        notes.append(f"{topic.name}: the order of the joints changes between messages; they were matched by name.")
    for quantity in {"position", "velocity"} & values.keys():
        values[quantity] *= conventions.radians
    return _Columns(bag_ns, np.concatenate([part.stamp_ns for part in rows]), names, values, notes)


def _marked(values: FloatArray) -> FloatArray:
    return np.where(np.isfinite(values), values, np.inf)


def _array_columns(
    bag: _Bag,
    topic: _Topic,
    means: InputTopic,
    joint_order: Sequence[str],
    recorded: Sequence[str],
    conventions: Conventions,
) -> _Columns:
    """Columns of a Float64MultiArray of what drives the joints.

    A message means what it means to the driver: it drives the joints it names and holds the others; one without numbers ends
    the push.
    """
    parts = bag.rows(topic)
    notes: dict[str, None] = {}
    stated = conventions.renamed(means.joints)
    labelled: list[Sequence[str]] = []
    for part in parts:
        if not len(part.message.data):
            labelled.append(())
            continue
        labels = _labels(bag, topic, part.message, {*joint_order, *recorded}, conventions)
        if labels is None and stated:
            if len(part.message.data) != len(stated):
                raise RecordingError(
                    f"{bag.path}: {topic.name} has {len(part.message.data)} values but --driver {conventions.driver} names "
                    f"{len(stated)} joints ({', '.join(stated)}); state its controller's joints in a file of your own"
                )
            labels = stated
        if labels is None:
            labels = _unlabelled(bag, topic, len(part.message.data), joint_order, recorded, conventions)
            if len(labels) < len(joint_order) or means not in OUR_DRIVER.inputs:
                notes[f"{topic.name} is unlabelled; it was read as the recorded joints {', '.join(labels)}."] = None
        labelled.append(labels)
    names = tuple(dict.fromkeys(name for labels in labelled for name in labels))
    times_ns = np.concatenate([part.bag_ns for part in parts])
    current = np.zeros((len(times_ns), len(names)))
    row = 0
    for part, named in zip(parts, labelled, strict=True):
        if named:
            columns = [names.index(label) for label in named]
            current[row : row + len(part.bag_ns), columns] = _marked(part.values["data"])
        row += len(part.bag_ns)
    return _Columns(times_ns, np.zeros_like(times_ns), names, {"current": current}, list(notes))


def _labels(
    bag: _Bag, topic: _Topic, message: Any, known: set[str], conventions: Conventions
) -> tuple[str, ...] | None:
    """Joint names of a message's columns: a dimension each, or one dimension with the names joined by commas."""
    dimensions = [str(dimension.label) for dimension in message.layout.dim]
    labels = conventions.renamed([label.strip() for label in ",".join(dimensions).split(",")])
    if not any(labels) or (len(labels) != len(message.data) and known.isdisjoint(labels)):
        return None  # no labels, or some that describe the dimensions ("currents") and not the columns
    if len(labels) != len(message.data) or len(set(labels)) != len(labels) or not all(labels):
        raise RecordingError(
            f"{bag.path}: {topic.name} has {len(message.data)} values but is labelled {', '.join(labels)};"
            " layout.dim must name every joint once"
        )
    return labels


def _unlabelled(
    bag: _Bag,
    topic: _Topic,
    length: int,
    joint_order: Sequence[str],
    recorded: Sequence[str],
    conventions: Conventions,
) -> tuple[str, ...]:
    for order in (tuple(joint_order), tuple(joint for joint in joint_order if joint in recorded)):
        if length == len(order):
            return order
    advice = "label the columns in layout.dim, or choose another input with --command-topic"
    if conventions.driver:
        advice = f"state the joints of its controller in a --driver file of your own (extends: {conventions.driver})"
    raise RecordingError(
        f"{bag.path}: {topic.name} has {length} values but the robot has {len(joint_order)} joints"
        f" ({', '.join(joint_order)}); {advice}"
    )


# --- columns to records ----------------------------------------------------------------------------------------------


def _any(mask: BoolArray, axis: int) -> BoolArray:
    return np.asarray(mask.any(axis=axis))


def _all(mask: BoolArray, axis: int) -> BoolArray:
    return np.asarray(mask.all(axis=axis))


def _of(mask: BoolArray) -> str:
    return f"{int(mask.sum())} of {mask.size}"


def _clock(columns: _Columns) -> int:
    """How far the header stamps are ahead of the recorder's time [ns], 0 without any stamp."""
    ahead = np.sort((columns.stamp_ns - columns.bag_ns)[columns.stamp_ns != 0])
    return int(ahead[ahead.size // 2]) if ahead.size else 0  # np.median would round it to 256 ns


def _times(columns: _Columns, topic: _Topic, notes: list[str]) -> TimeArray:
    """Header stamps; where there are none, the recorder's time on the same clock."""
    missing = columns.stamp_ns == 0
    if missing.any():
        notes.append(f"{topic.name}: {_of(missing)} messages have no header stamp; their time of recording was used.")
    return np.where(missing, columns.bag_ns + _clock(columns), columns.stamp_ns)


def _sorted(times: TimeArray, topic: _Topic, notes: list[str]) -> TimeArray:
    """Order of the rows in time."""
    late = np.diff(times, prepend=times[:1]) < 0
    if late.any():
        notes.append(f"{topic.name}: {_of(late)} stamps go back in time; the messages were sorted.")
    return np.argsort(times, kind="stable")


def _note_gaps(times: TimeArray, topic: _Topic, notes: list[str]) -> None:
    gaps = np.diff(times)
    lost = gaps > LOST_AFTER_PERIODS * np.median(gaps) if gaps.size else np.zeros(0, dtype=bool)
    if lost.any():
        notes.append(
            f"{topic.name}: messages were lost: {int(lost.sum())} gaps of more than {LOST_AFTER_PERIODS:g} periods"
            f" ({np.median(gaps) / 1e6:.1f} ms), the longest {gaps.max() / 1e6:.0f} ms."
        )


def _state_rows(
    path: Path, topic: _Topic, columns: _Columns, driven: Sequence[str], expected: Sequence[str], notes: list[str]
) -> tuple[TimeArray, tuple[str, ...], dict[str, FloatArray]]:
    """One row per usable message in the order of time, one column per joint that has a position.

    Joints may be spread over several messages (arm and gripper from two publishers). The rows are then the messages
    that have the driven joint; what others report in between is interpolated, since a held joint hardly moves, while
    an interpolated sample of a driven joint would pretend to be a measurement.
    """
    times = _times(columns, topic, notes)
    order = _sorted(times, topic, notes)
    times = times[order]
    usable = _any(np.isfinite(columns.values["position"]), axis=0)
    never = [name for name, column in zip(columns.names, usable, strict=True) if not column]
    if never:
        notes.append(f"{topic.name}: {', '.join(never)} never has a finite position and was left out.")
    names = tuple(name for name, column in zip(columns.names, usable, strict=True) if column)
    values = {quantity: table[np.ix_(order, usable)] for quantity, table in columns.values.items()}
    position = values["position"]
    garbage = _garbage(values, np.isin(names, expected))
    if garbage.any():
        position[garbage] = np.nan
        notes.append(f"{topic.name}: {_of(garbage)} messages hold numbers that no joint can have and were left out.")
    given = np.isfinite(position)
    if not names:
        raise RecordingError(f"{path}: {topic.name} has no finite position in {len(times)} messages; check the driver")

    needed = np.isin(names, driven)
    if not needed.any():
        needed[int(np.argmax(given.sum(axis=0)))] = True
    base = _all(given[:, needed], axis=1)
    if base.any():
        needed |= given[base].mean(axis=0) > 0.5
    rows = _all(given[:, needed], axis=1)
    broken = ~rows & _any(np.isinf(position[:, needed]), axis=1)
    if broken.any():
        notes.append(f"{topic.name}: {_of(broken)} messages have NaN or infinite positions and were left out.")
    partial = ~rows & ~broken & _any(given[:, needed], axis=1)
    if partial.any():
        notes.append(f"{topic.name}: {_of(partial)} messages lack some of the joints and were left out.")
    for column in np.flatnonzero(~_all(given[rows], axis=0)):
        known = given[:, column]
        known_times, first = np.unique(times[known] - times[0], return_index=True)
        position[rows, column] = np.interp(times[rows] - times[0], known_times, position[known, column][first])
        notes.append(f"{topic.name}: {names[column]} is in {_of(known)} messages; between them it was interpolated.")
    rows[rows] = _first_of_equal(times[rows], topic, notes)
    if int(rows.sum()) < MIN_SAMPLES:
        raise RecordingError(
            f"{path}: only {_of(rows)} messages of {topic.name} are usable, at least {MIN_SAMPLES} are needed"
            f" ({' '.join(notes) or 'the recording is too short'})"
        )
    _note_gaps(times[rows], topic, notes)
    return times[rows], names, {quantity: table[rows] for quantity, table in values.items()}


def _garbage(values: Mapping[str, FloatArray], joints: BoolArray) -> BoolArray:
    """Messages with numbers from unwritten memory in one of the joints' columns, shape (T,); none where they are not few.

    Where many are far off, the unit is wrong instead, and the reader has to be told that.
    """
    bad = np.zeros(len(values["position"]), dtype=bool)
    for quantity, limit in (("position", IMPLAUSIBLE_POSITION), ("velocity", 1e6), ("effort", 1e9)):
        if quantity in values:
            bad |= _any(np.abs(values[quantity][:, joints]) > limit, axis=1)
    return bad if bad.mean() < GARBAGE_SHARE else np.zeros_like(bad)


def _first_of_equal(times: TimeArray, topic: _Topic, notes: list[str]) -> BoolArray:
    repeated: BoolArray = np.diff(times, prepend=times[:1] - 1) == 0
    if repeated.any():
        notes.append(f"{topic.name}: {_of(repeated)} stamps are repeated; the first message of each was kept.")
    return ~repeated


def _check_positions(path: Path, names: Sequence[str], position: FloatArray, expected: Sequence[str]) -> None:
    for name, values in zip(names, position.T, strict=True):
        # joints that are not the robot's may be wheels, which do turn that far
        if name in expected and np.abs(values).max() > IMPLAUSIBLE_POSITION:
            worst = values[np.argmax(np.abs(values))]
            raise RecordingError(
                f"{path}: {name} stands at {worst:.6g}, which is no angle in rad nor a length in m; the publisher seems"
                " to use degrees, millimetres or encoder counts: convert the positions to rad and m"
            )


def _known_or_none(values: FloatArray) -> FloatArray | None:
    values = np.where(np.isfinite(values), values, np.nan)
    return None if bool(np.isnan(values).all()) else values


def _held(values: FloatArray) -> FloatArray:
    """Each column keeps its last finite value; zero before the first."""
    known = np.isfinite(values)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values))[:, None], -1), axis=0)
    return np.where(last < 0, 0.0, np.take_along_axis(values, np.maximum(last, 0), axis=0))


def _torque_constants(names: Sequence[str], nominal: Mapping[str, float]) -> FloatArray:
    """Nominal torque constants [N m/A or N/A], NaN where unknown, shape (J,)."""
    return np.array([float(nominal[name]) if nominal.get(name, 0.0) > 0.0 else np.nan for name in names])


def _commands(
    bag: _Bag,
    topic: _Topic,
    means: InputTopic,
    conventions: Conventions,
    clock_ns: int,
    nominal: Mapping[str, float],
    joint_order: Sequence[str],
    recorded: Sequence[str],
    per_count_A: float,
    notes: list[str],
) -> InputRecord:
    """Input from a command topic; clock_ns is how far the joint states' stamps are ahead of the recorder's time."""
    if topic.msgtype == JOINT_STATE:
        columns = _joint_state_columns(bag, topic, ["effort"], conventions)
        times, effort = _times(columns, topic, notes), columns.values["effort"]
    else:
        columns = _array_columns(bag, topic, means, joint_order, recorded, conventions)
        times, effort = columns.bag_ns, columns.values["current"]
    if means.unit == "N.m":
        constants = _torque_constants(columns.names, nominal)
        unknown = np.flatnonzero(np.isnan(constants) & _any(np.nan_to_num(effort) != 0.0, axis=0))
        if unknown.size:
            raise RecordingError(
                f"{bag.path}: {topic.name} has effort on {columns.names[unknown[0]]}, whose nominal torque constant is"
                f" not known; the robot has one for {', '.join(nominal) or 'no joint'}: add it to the robot's file"
            )
        current = effort / np.where(np.isnan(constants), 1.0, constants)
    else:
        current = effort * ampere(means.unit, per_count_A)
    if not columns.stamp_ns.any() and abs(clock_ns) > FOREIGN_CLOCK_NS:
        times = times + clock_ns
        notes.append(
            f"{topic.name}: its times were moved by {clock_ns * 1e-9:.3f} s, since the stamps of the joint states come"
            " from another clock than the recorder's."
        )
    notes += columns.notes
    broken = _any(np.isinf(current), axis=1)
    if broken.any():
        notes.append(f"{topic.name}: {_of(broken)} messages have NaN or infinite values; the last finite one was held.")
    order = _sorted(times, topic, notes)
    times, current = times[order], _held(current[order])
    latest = np.diff(times, append=times[-1] + 1) > 0
    if not latest.all():
        notes.append(f"{topic.name}: {_of(~latest)} stamps are repeated; the last message of each was kept.")
    return InputRecord(times[latest], columns.names, current[latest], printable(topic.name), means.unit)


def _signed(names: Sequence[str], effort: FloatArray, notes: list[str]) -> FloatArray:
    """The same with negative counts of a 16-bit register that were read as unsigned, and lie far above all others."""
    negative = (effort >= REGISTER - LARGEST_COUNT) & (effort < REGISTER)
    with np.errstate(invalid="ignore"):
        others = np.abs(np.where(negative, 0.0, effort))
        whole = np.isnan(effort) | (effort == np.round(effort))
    columns = _any(negative, axis=0) & _all(np.isnan(others) | (others <= LARGEST_COUNT), axis=0) & _all(whole, axis=0)
    if not columns.any():
        return effort
    which = ", ".join(name for name, column in zip(names, columns, strict=True) if column)
    notes.append(
        f"effort of {which}: {_of(negative & columns)} values of {REGISTER - LARGEST_COUNT} and more beside small ones are "
        f"negative numbers of a 16-bit register that was read as unsigned; {REGISTER} was subtracted from them."
    )
    result: FloatArray = np.where(negative & columns, effort - REGISTER, effort)
    return result


def ampere(unit: str, per_count_A: float = CURRENT_PER_COUNT_A) -> float:
    """Ampere of one of a unit of current."""
    return {"A": 1.0, "mA": 1e-3, "raw": per_count_A}[unit]


def _effort_and_current(
    names: Sequence[str], recorded: FloatArray, unit: str | None, nominal: Mapping[str, float], per_count_A: float
) -> tuple[FloatArray | None, FloatArray | None]:
    """Effort [N m or N] and measured current [A] out of what a bag calls effort; None where the unit does not say."""
    effort = _known_or_none(recorded)
    if effort is None or unit is None:
        return None, None
    if unit == "N.m":
        return effort, _known_or_none(effort / _torque_constants(names, nominal))
    return None, effort * ampere(unit, per_count_A)


def _measured(
    path: Path, topic: _Topic, record: JointRecord, has_effort: bool, unit: str | None, conventions: Conventions
) -> InputRecord | None:
    """Input from what the motors reported, when no command was recorded."""
    if not has_effort:
        return None
    if unit is None:
        usual = " or ".join(f"/{each.topic}" for each in conventions.inputs) or "input"
        raise RecordingError(
            f"{path}: no {usual} in the bag, and what the effort of {topic.name} means is"
            f" not stated; state it with --effort-unit {'|'.join(EFFORT_UNITS)}, or name the input with --command-topic"
        )
    if record.current is None:
        raise RecordingError(
            f"{path}: the effort of {topic.name} cannot be turned into current: the robot has a nominal torque constant"
            f" for none of {', '.join(record.names)}; choose the robot with --robot"
        )
    known = _any(np.isfinite(record.current), axis=0)
    names = tuple(name for name, column in zip(record.names, known, strict=True) if column)
    return InputRecord(record.times_ns, names, _held(record.current[:, known]), MEASURED_EFFORT, unit)


def read_recording(
    path: str | Path,
    *,
    state_topic: str | None = None,
    command_topic: str | None = None,
    effort_unit: str | None = None,
    nominal_torque_constants: Mapping[str, float],
    joint_order: Sequence[str],
    current_per_count_A: float = CURRENT_PER_COUNT_A,
    states_only: bool = False,
    conventions: Conventions = OUR_DRIVER,
    span: Span | None = None,
) -> Recording:
    """Read joint states and input currents from a ROS 2 bag.

    The input comes from /applied_effort, else from /current_command, else from measured effort; of another driver from the topics
    that its conventions name, else from measured effort.

    Args:
        path: Bag folder (with or without metadata.yaml), or one .mcap or .db3 file.
        state_topic: Topic of the joint states; None takes /joint_states, also under a namespace, else the only one.
        command_topic: Topic of the input: sensor_msgs/JointState with effort = commanded current x nominal torque
            constant [N m or N], or std_msgs/Float64MultiArray of currents [A]; None looks for the usual ones. Where the conventions
            have an input of that type, its unit and its order of joints hold.
        effort_unit: What effort of the joint states means: 'N.m', 'A', 'mA' or 'raw'; None: not stated, never guessed.
        nominal_torque_constants: By joint; the ones with which effort was published [N m/A or N/A].
        joint_order: Joints in the order of an unlabelled current command.
        current_per_count_A: Current of one raw count [A].
        states_only: Whether to leave the input out, whatever there is of it.
        conventions: Of the driver that published.
        span: The part that is read, by the recorder's times; None: all. A command that was given before it is not known.

    Returns:
        The recording, on the clock of the joint states' header stamps. `joints.effort` is set only for effort_unit
        'N.m' and `joints.current` only where effort_unit says which; `inputs` is None when nothing about the input was
        recorded, or only an effort of an unstated unit beside a known stretch without torque (see `torque_off_ns`).

    Raises:
        RecordingError: The bag cannot be read, or does not hold what is needed.
        ConfigurationError: Unknown effort_unit.
    """
    path = Path(path)
    if effort_unit is not None and effort_unit not in EFFORT_UNITS:
        raise ConfigurationError(f"effort unit {effort_unit!r} is not known; choose from {', '.join(EFFORT_UNITS)}")
    notes: list[str] = []
    with _open(path) as bag:
        state = _state_topic(bag, state_topic, command_topic, conventions)
        bag.cut(state, span)
        command = None if states_only else _input_topic(bag, command_topic, state, conventions)
        columns = _joint_state_columns(bag, state, ["position", "velocity", "effort"], conventions)
        notes += columns.notes
        inputs = None
        if command is not None and command[0] != state:
            inputs = _commands(
                bag,
                *command,
                conventions,
                _clock(columns),
                nominal_torque_constants,
                joint_order,
                columns.names,
                current_per_count_A,
                notes,
            )
        torque_off = _torque_off(bag, state, columns, notes)
        notes = bag.notes + notes
    driven: list[str] = []
    if inputs is not None:
        used = _any(np.abs(inputs.current_A) > ZERO_CURRENT_A, axis=0)
        driven = [name for name, column in zip(inputs.names, used, strict=True) if column]
    expected = [*joint_order, *driven]
    times, names, values = _state_rows(path, state, columns, driven, expected, notes)
    _check_positions(path, names, values["position"], expected)
    values["effort"] = _signed(names, values["effort"], notes)
    effort, current = _effort_and_current(
        names, values["effort"], effort_unit, nominal_torque_constants, current_per_count_A
    )
    reported = _known_or_none(values["effort"])
    record = JointRecord(
        times, names, values["position"], _known_or_none(values["velocity"]), effort, current, reported
    )
    # zero current needs no unit
    if inputs is None and not states_only and not (torque_off and effort_unit is None):
        inputs = _measured(path, state, record, reported is not None, effort_unit, conventions)
    return Recording(path.resolve().name, record, inputs, tuple(notes), torque_off)


def parts_of(
    path: str | Path, most: int, *, state_topic: str | None = None, conventions: Conventions = OUR_DRIVER
) -> list[Span]:
    """Parts of a bag with about as many joint states each, of which none has more than ``most``.

    Args:
        path: The bag.
        most: Joint states of a part.
        state_topic: As for `read_recording`.
        conventions: As for `read_recording`.

    Returns:
        From the first joint state to the last, without a gap.

    Raises:
        RecordingError: The bag cannot be read.
    """
    with _open(Path(path)) as bag:
        return bag.parts(_state_topic(bag, state_topic, None, conventions), most)


def read_drive_signals(
    path: str | Path,
    state_topic: str | None = None,
    conventions: Conventions = OUR_DRIVER,
    span: Span | None = None,
) -> DriveSignals:
    """Read goals (positions of /joint_command) and supply voltage (/battery_state), as far as they are there.

    Args:
        path: The bag.
        state_topic: As for `read_recording`.
        conventions: As for `read_recording`; goals have the names and units of the joint states.
        span: As for `read_recording`.

    Raises:
        RecordingError: The bag cannot be read, or several topics may be meant.
    """
    with _open(Path(path)) as bag:
        state = _state_topic(bag, state_topic, None, conventions)
        bag.cut(state, span)
        namespace = state.name.rpartition("/")[0]

        def found(name: str, msgtype: str) -> _Topic | None:
            filled = [topic for topic in bag.topics if topic.size and topic.msgtype == msgtype and topic != state]
            topics = _called(filled, name, namespace)
            if len(topics) > 1:
                raise RecordingError(f"{path}: which {name}? {_listed(topics)}: record one of them")
            return topics[0] if topics else None

        goal, battery = found(JOINT_COMMAND, JOINT_STATE), found(BATTERY_STATE, BATTERY)
        if goal is None and battery is None:
            return DriveSignals(_NO_TIMES, (), np.empty((0, 0)), _NO_TIMES, np.empty(0))
        ahead_ns = _clock(_joint_state_columns(bag, state, ["position"], conventions))
        goal_ns, names, goals = _NO_TIMES, tuple[str, ...](), np.empty((0, 0))
        if goal is not None:
            columns = _joint_state_columns(bag, goal, ["position"], conventions)
            goal_ns = np.where(columns.stamp_ns == 0, columns.bag_ns + ahead_ns, columns.stamp_ns)
            order = np.argsort(goal_ns, kind="stable")
            goals = np.where(np.isfinite(columns.values["position"]), columns.values["position"], np.nan)[order]
            goal_ns, names = goal_ns[order], columns.names
        times, volts = [], []
        for time_ns, message in [] if battery is None else bag.messages(battery):
            stamp = message.header.stamp
            stamp_ns = stamp.sec * 10**9 + stamp.nanosec
            if np.isfinite(message.voltage) and message.voltage > 0.0:
                times.append(stamp_ns or time_ns + ahead_ns)
                volts.append(float(message.voltage))
    order = np.argsort(np.array(times, dtype=np.int64), kind="stable")
    voltage_ns = np.array(times, dtype=np.int64)[order]
    return DriveSignals(goal_ns, names, goals, voltage_ns, np.array(volts, dtype=np.float64)[order])


def without_jumps(recording: Recording, joints: Sequence[str]) -> Recording:
    """Leave out, with a note, joint states in which a joint jumps away and back, as damaged numbers would.

    That is all that can be seen of damage in a file without checksums (sqlite3): smaller errors, and those at the ends, cannot.

    Args:
        recording: As it was read.
        joints: Those of the robot; others may be wheels.
    """
    record = recording.joints
    position = record.position[:, np.isin(record.names, joints)]
    if len(position) <= MIN_SAMPLES:
        return recording
    intervals = 1e-9 * np.diff(record.times_ns)
    # two messages may be stamped at nearly the same time
    allowed = IMPLAUSIBLE_SPEED * np.maximum(intervals, np.median(intervals))[:, None]
    far = np.abs(np.diff(position, axis=0)) > allowed
    jumped = np.zeros(position.shape, dtype=bool)
    for count in range(1, LONGEST_JUMP + 1):
        # it leaves, and after that many samples it is where it was, as far as it can have moved meanwhile
        returned = np.abs(position[count + 1 :] - position[: -count - 1]) <= allowed[: len(allowed) - count] * (
            count + 1
        )
        gone = far[: len(far) - count] & far[count:] & returned
        for number in range(1, count + 1):
            jumped[number : number + len(gone)] |= gone
    kept = ~_any(jumped, axis=1)
    if kept.all():
        return recording
    note = (
        f"in {_of(~kept)} joint states a joint jumps there and back faster than {IMPLAUSIBLE_SPEED:g} rad/s; they were left "
        "out: is the file damaged?"
    )
    columns: dict[str, Any] = {
        quantity: None if values is None else values[kept]
        for quantity in ("position", "velocity", "effort", "current", "reported_effort")
        for values in [getattr(record, quantity)]
    }
    joint_states = replace(record, times_ns=record.times_ns[kept], **columns)
    return replace(recording, joints=joint_states, notes=(*recording.notes, note))


@dataclass(frozen=True)
class Contents:
    """What a bag holds, before a message of it is read.

    Attributes:
        topics: Name, type and number of messages of each.
        states: Topic of the joint states; None where `problem` says why none was chosen.
        inputs: Topic of the input; None where there is none but the measured effort.
        problem: Why a topic cannot be chosen, in one line, or an empty string.
    """

    topics: tuple[tuple[str, str, int], ...]
    states: str | None
    inputs: str | None
    problem: str = ""


def look_into(
    path: str | Path,
    state_topic: str | None = None,
    command_topic: str | None = None,
    conventions: Conventions = OUR_DRIVER,
) -> Contents:
    """List a bag's topics, and say which ones `read_recording` takes.

    Raises:
        RecordingError: It is no bag, or cannot be opened.
    """
    with _open(Path(path)) as bag:
        topics = tuple((one_line(topic.name), one_line(topic.msgtype), topic.size) for topic in bag.topics)
        try:
            state = _state_topic(bag, state_topic, command_topic, conventions)
        except RecordingError as error:
            return Contents(topics, None, None, str(error))
        try:
            inputs = _input_topic(bag, command_topic, state, conventions)
        except RecordingError as error:
            return Contents(topics, one_line(state.name), None, str(error))
    chosen = None if inputs is None or inputs[0] == state else one_line(inputs[0].name)
    return Contents(topics, one_line(state.name), chosen)


def read_motors(path: str | Path, state_topic: str | None = None) -> Motors:
    """The motors of the arm whose joint states a bag holds, as its driver told them on ``motors``; empty where it did not.

    Args:
        path: The bag.
        state_topic: Of the joint states.

    Raises:
        RecordingError: The bag cannot be read.
    """
    with _open(Path(path)) as bag:
        try:
            namespace = _state_topic(bag, state_topic, None).name.rpartition("/")[0]
        except RecordingError:
            return {}
        topics = [t for t in bag.topics if t.size and (t.name, t.msgtype) == (f"{namespace}/motors", STATUS)]
        entries = [entry for topic in topics for _, message in bag.messages(topic) for entry in message.values]
    motors = {one_line(str(entry.key)): MotorIdentity.from_text(str(entry.value)) for entry in entries}
    return {joint: motor for joint, motor in motors.items() if motor is not None}


def read_temperatures(path: str | Path, state_topic: str | None = None) -> dict[str, float]:
    """How warm the motors were on average, as the driver of a bag's joint states said on ``motor_temperatures`` [deg C].

    Returns:
        By joint; empty where it did not.

    Raises:
        RecordingError: The bag cannot be read.
    """
    heard: dict[str, list[float]] = {}
    with _open(Path(path)) as bag:
        try:
            namespace = _state_topic(bag, state_topic, None).name.rpartition("/")[0]
        except RecordingError:
            return {}
        wanted = (f"{namespace}/{TEMPERATURES}", FLOAT_ARRAYS[0])
        for topic in (t for t in bag.topics if t.size and (t.name, t.msgtype) == wanted):
            for _, message in bag.messages(topic):
                labels = ",".join(str(dimension.label) for dimension in message.layout.dim).split(",")
                for joint, value in zip(labels, message.data, strict=False):
                    if joint and -273.0 < value < 1000.0:
                        heard.setdefault(one_line(joint), []).append(float(value))
    return {joint: float(np.mean(values)) for joint, values in heard.items()}


def read_description(path: str | Path) -> str:
    """The URDF that a robot's driver published on ``/robot_description`` and the recorder kept.

    Args:
        path: The bag.

    Raises:
        RecordingError: The bag cannot be read, or holds no description, or several that differ.
    """
    with _open(Path(path)) as bag:
        typed = [topic for topic in bag.topics if topic.msgtype == "std_msgs/msg/String" and topic.size]
        topics = _called(typed, "robot_description")
        if not topics:
            raise RecordingError(
                f"{path}: no /robot_description (std_msgs/String) in the bag; it holds: {_listed(bag.topics)}; give a URDF file"
            )
        texts = {
            str(_deserialise(raw, topic.msgtype).data) for topic in topics for _, raw in bag._raw(topic, LONGEST_TEXT)
        }
    if len(texts) > 1:
        raise RecordingError(f"{path}: {len(texts)} descriptions that differ on {_listed(topics)}; give a URDF file")
    return texts.pop()


def read_points(path: str | Path, topic: str) -> PointTrack:
    """Read where something was seen from a topic of geometry_msgs/PointStamped.

    Args:
        path: The bag.
        topic: Name of the topic; its stamps are on the clock of the joint states'.

    Raises:
        RecordingError: The bag cannot be read, holds no such topic, or a point is not finite or not stamped.
    """
    with _open(Path(path)) as bag:
        chosen = _chosen(bag, topic, ["geometry_msgs/msg/PointStamped"], "sphere.camera")
        messages = [message for _, message in bag.messages(chosen)]
    stamps = np.array([10**9 * int(m.header.stamp.sec) + int(m.header.stamp.nanosec) for m in messages], dtype=np.int64)
    if not stamps.all():
        raise RecordingError(
            f"{path}: {topic} holds points without a stamp: they cannot be laid beside the joint states"
        )
    points = np.array([[m.point.x, m.point.y, m.point.z] for m in messages])
    return _track(stamps, points)


def read_point_file(path: str | Path) -> PointTrack:
    """Read where something was seen from a CSV file with the header ``stamp_ns,x,y,z``: clock of the joint states [ns], and m.

    Raises:
        RecordingError: The file is missing or malformed.
    """
    header, table = _csv_table(Path(path), "stamp_ns,x,y,z")
    if header != ["stamp_ns", "x", "y", "z"]:
        raise RecordingError(f"{path}: the header must be stamp_ns,x,y,z, got {','.join(header)}")
    try:
        stamps = np.array([int(row[0]) for row in table], dtype=np.int64)
        points = np.array([[float(cell) for cell in row[1:]] for row in table]).reshape(-1, 3)
    except (ValueError, OverflowError) as error:
        raise RecordingError(f"{path}: needs rows of a whole number of ns and three numbers in m ({error})") from error
    return _track(stamps, points)


def _track(stamps: TimeArray, points: FloatArray) -> PointTrack:
    order = np.argsort(stamps, kind="stable")
    stamps, points = stamps[order], points[order]
    first = np.diff(stamps, prepend=stamps[:1] - 1) > 0  # seen twice at one instant is seen once
    return PointTrack(stamps[first], points[first])


def _csv_table(file: Path, form: str) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a CSV file, all cells as text."""
    text = text_of(file, RecordingError, LONGEST_TABLE)
    try:
        header, *rows = [row for row in csv.reader(text.splitlines()) if row]
    except (ValueError, csv.Error) as error:
        raise RecordingError(f"{file}: not a table of numbers under the header {form} ({error})") from error
    if len(rows) > MOST_ROWS:
        raise RecordingError(f"{file}: has {len(rows)} rows, and {MOST_ROWS} are the most that are read: cut it")
    return [cell.strip() for cell in header], rows


# --- writing ---------------------------------------------------------------------------------------------------------


def write_recording(path: str | Path, recording: Recording, storage: str = "mcap") -> None:
    """Write /joint_states (position, velocity, effort) and, if there is an input, /current_command with labels.

    Reading it back with effort_unit 'N.m' gives the same arrays, bit by bit.

    Args:
        path: Folder to make; it must not exist.
        recording: What to write.
        storage: 'mcap' or 'sqlite3'.

    Raises:
        RecordingError: The folder exists or cannot be written.
        ConfigurationError: Unknown storage.
    """
    plugin = _storage_plugin(storage)
    types = _types()
    record, inputs = recording.joints, recording.inputs
    try:
        with Writer(Path(path), version=9, storage_plugin=plugin) as writer:
            rows: list[tuple[int, Connection, Any]] = []
            if inputs is not None:
                commands = writer.add_connection("/current_command", FLOAT_ARRAYS[0], typestore=types)
                rows += [
                    (int(time_ns), commands, _float_array(types, inputs.names, current))
                    for time_ns, current in zip(inputs.times_ns, inputs.current_A, strict=True)
                ]
            states = writer.add_connection("/joint_states", JOINT_STATE, typestore=types)
            rows += [
                (int(time_ns), states, _joint_state(types, record, row)) for row, time_ns in enumerate(record.times_ns)
            ]
            for time_ns, connection, message in sorted(rows, key=lambda row: row[0]):
                writer.write(connection, time_ns, types.serialize_cdr(message, connection.msgtype))
        _add_checksums(Path(path))
    except (WriterError, OSError) as error:
        raise RecordingError(f"{path}: cannot be written ({error}); give a new folder") from error


class RawMessage(NamedTuple):
    """A message as it came over the wire.

    Attributes:
        time_ns: When it was received [ns].
        data: Its CDR bytes; of a raw subscription, not of rclpy's `serialize_message`, which leaves stray bytes behind.
    """

    topic: str
    msgtype: str
    time_ns: int
    data: bytes


def write_messages(path: str | Path, messages: Sequence[RawMessage], storage: str = "mcap") -> None:
    """Write messages to a new bag as they came, byte by byte.

    Args:
        path: Folder to make; it must not exist. Nothing is left of it when writing fails.
        messages: Of the types in which recordings come: JointState, Float64MultiArray and DiagnosticStatus.
        storage: 'mcap' or 'sqlite3'.

    Raises:
        RecordingError: The folder exists or cannot be written, as on a full disk.
        ConfigurationError: Unknown storage.
    """
    path, plugin = Path(path), _storage_plugin(storage)
    existed = path.exists()
    try:
        with Writer(path, version=9, storage_plugin=plugin) as writer:
            kinds = sorted({(message.topic, message.msgtype) for message in messages})
            connections = {kind: writer.add_connection(*kind, typestore=_types()) for kind in kinds}
            for message in sorted(messages, key=lambda message: message.time_ns):
                writer.write(connections[message.topic, message.msgtype], message.time_ns, message.data)
        _add_checksums(path)
    except (WriterError, OSError) as error:
        if not existed:
            shutil.rmtree(path, ignore_errors=True)
        raise RecordingError(f"{path}: cannot be written ({error}); give a new folder on a disk with room") from error


def _add_checksums(path: Path) -> None:
    """Give each chunk of a new MCAP bag its CRC-32, which rosbags leaves out but checks when it reads.

    Records: an opcode, a length of 8 bytes, the content; that of a chunk (opcode 6): two times and a size of 8 bytes each, the CRC,
    the compression's name (none here) and the records with a length before each (mcap.dev/spec, Chunk).
    """
    for file in path.glob("*.mcap"):
        with file.open("r+b") as stream:
            content = stream.read()
            at = len(_MCAP_MAGIC)
            while at < len(content) - len(_MCAP_MAGIC):
                length = int.from_bytes(content[at + 1 : at + 9], "little")
                if content[at] == _MCAP_CHUNK:
                    records = content[at + 9 + 40 : at + 9 + length]
                    stream.seek(at + 9 + 24)
                    stream.write(zlib.crc32(records).to_bytes(4, "little"))
                at += 9 + length


_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_CHUNK = 6


def _storage_plugin(storage: str) -> StoragePlugin:
    plugins = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
    if storage not in plugins:
        raise ConfigurationError(f"bag storage {storage!r} is not known; choose from {', '.join(plugins)}")
    return plugins[storage]


def _joint_state(types: Typestore, record: JointRecord, row: int) -> Any:
    time, header, state = (
        types.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE)
    )
    seconds, nanoseconds = divmod(int(record.times_ns[row]), 1_000_000_000)
    empty = np.zeros(0)
    return state(
        header=header(stamp=time(sec=seconds, nanosec=nanoseconds), frame_id=""),
        name=list(record.names),
        position=record.position[row],
        velocity=empty if record.velocity is None else record.velocity[row],
        effort=empty if record.effort is None else record.effort[row],
    )


def _float_array(types: Typestore, names: Sequence[str], values: FloatArray) -> Any:
    dimension, layout, array = (
        types.types[f"std_msgs/msg/{name}"] for name in ("MultiArrayDimension", "MultiArrayLayout", "Float64MultiArray")
    )
    return array(
        layout=layout(dim=[dimension(label=",".join(names), size=len(names), stride=len(names))], data_offset=0),
        data=values,
    )


# --- plain-text recordings -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TextRecording:
    """The motion of one joint as text, with the setting in which it was made.

    Attributes:
        name: Name of the folder.
        joint: The joint that moved.
        times_s: Sampling instants [s], strictly increasing, shape (T,).
        relative_position: Position of the joint minus its start pose [rad], shape (T,).
        setting: What setting.json says: `moving_joint`, `torque_N_m`, `start_pose_rad` by joint, and whatever else.
    """

    name: str
    joint: str
    times_s: FloatArray
    relative_position: FloatArray
    setting: dict[str, Any]


def is_text_recording(path: str | Path) -> bool:
    """Whether a path is a folder with trajectory.csv and setting.json."""
    return not path_problem(path) and all((Path(path) / name).is_file() for name in ("trajectory.csv", "setting.json"))


def read_text_recording(path: str | Path) -> TextRecording:
    """Read a folder with trajectory.csv (columns `time_s,<joint>_relative_rad`) and setting.json.

    Args:
        path: The folder.

    Returns:
        The recording; numbers that setting.json gives under the keys of `_SETTING_NUMBERS` are checked.

    Raises:
        RecordingError: A file is missing or malformed, or a needed key of the setting is.
    """
    path = Path(path)
    if not is_text_recording(path):
        raise RecordingError(f"{path}: not a text recording; it needs trajectory.csv and setting.json")
    setting = _setting(path / "setting.json")
    joint = setting["moving_joint"]
    file = path / "trajectory.csv"
    expected = ["time_s", f"{joint}_relative_rad"]
    header, rows = _csv_table(file, ",".join(expected))
    try:
        table = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise RecordingError(
            f"{file}: not a table of numbers under the header {','.join(expected)} ({error})"
        ) from error
    if header != expected:
        raise RecordingError(f"{file}: the header must be {','.join(expected)}, got {','.join(header)}")
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < MIN_SAMPLES or not np.isfinite(table).all():
        raise RecordingError(f"{file}: needs at least {MIN_SAMPLES} rows of two finite numbers")
    if not bool(np.all(np.diff(table[:, 0]) > 0)):
        raise RecordingError(f"{file}: time_s must increase from row to row")
    table.setflags(write=False)
    return TextRecording(path.resolve().name, joint, table[:, 0], table[:, 1], setting)


_SETTING_NUMBERS = {
    "torque_N_m": Number("that drives the joint", "N m", -1e3, 1e3),
    "true_mass_kg": Number("of the object", "kg", 0.0, 1e3),
    "armature_kg_m2": Number("of the joint", "kg m^2", 0.0, 100.0),
    "gravity_m_s2": Number("downwards", "m/s^2", -100.0, 100.0),
}
_POSITION = Number("of a joint", "rad", -IMPLAUSIBLE_POSITION, IMPLAUSIBLE_POSITION)


def _setting(file: Path) -> dict[str, Any]:
    text = text_of(file, RecordingError)
    try:
        setting = json_of(text)
    except ValueError as error:
        raise RecordingError(f"{file}: not readable as JSON ({error})") from error
    needed = ("moving_joint", "torque_N_m", "start_pose_rad")
    missing = [key for key in needed if not isinstance(setting, dict) or key not in setting]
    if missing:
        raise RecordingError(f"{file}: {', '.join(missing)} missing; it must be an object with {', '.join(needed)}")
    try:
        Text(what="text").read(setting["moving_joint"])
    except FormError as error:
        raise RecordingError(f"{file}: moving_joint must be a name: {error}") from error
    pose = setting["start_pose_rad"]
    numbers = {key: setting[key] for key in _SETTING_NUMBERS if key in setting}
    if not isinstance(pose, dict) or setting["moving_joint"] not in pose:
        raise RecordingError(
            f"{file}: start_pose_rad must give a position for each joint, {setting['moving_joint']!r} too"
        )
    numbers |= {f"start_pose_rad.{joint}": value for joint, value in pose.items()}
    for key, value in numbers.items():
        if finite(value) is None:
            raise RecordingError(f"{file}: {key} must be a number, got {shortly(value)}")
        try:
            _SETTING_NUMBERS.get(key, _POSITION).read(value)
        except FormError as error:
            raise RecordingError(f"{file}: {key}: {error}") from error
    return dict(setting)
