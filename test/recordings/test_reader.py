"""Bags of every make, whole or broken, are read, or refused in one clear line."""

from __future__ import annotations

import os
import shutil
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from support.small_bags import (
    JOINT_STATE,
    ONSET_NS,
    STORAGES,
    TYPES,
    Message,
    commands,
    notes,
    positions,
    read,
    refused,
    states,
    times,
    write_bag,
)

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.storage import zstd

BAGS = Path(__file__).parents[2] / "bags"
COMPRESSIONS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": zstd.compress,
    "lz4": lz4.frame.compress,
}


def record(operation: int, content: bytes) -> bytes:
    """Of an MCAP file (mcap.dev/spec)."""
    return struct.pack("<BQ", operation, len(content)) + content


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


class ByHand:
    """An MCAP file as its specification has it, written by hand: no writer leaves out what it may lack.

    Attributes:
        lacks: What it is without: "message indexes", "statistics", "summary" or nothing.
        topics: Topic and type of each channel.
        content: What is written so far.
        indexes: Of its chunks, for the summary.
        counts: Messages by channel.
    """

    def __init__(self, messages: Sequence[Message], compression: str, lacks: str) -> None:
        self.messages = messages
        self.compression = compression
        self.lacks = lacks
        self.topics = list(dict.fromkeys((each.topic, each.msgtype) for each in messages))
        self.content = b"\x89MCAP0\r\n" + record(0x01, text("ros2") + text("by hand"))
        self.indexes = b""
        self.counts = dict.fromkeys(range(len(self.topics)), 0)

    @property
    def kinds(self) -> bytes:
        """Records of the schemas and of the channels."""
        return b"".join(
            record(0x03, struct.pack("<H", n + 1) + text(kind) + text("ros2msg") + text(""))
            + record(0x04, struct.pack("<HH", n, n + 1) + text(topic) + text("cdr") + text(""))
            for n, (topic, kind) in enumerate(self.topics)
        )

    def add_chunk(self, mine: Sequence[Message], begins: bytes) -> None:
        """Some messages behind what their chunk begins with, and the message indexes behind them."""
        inner = begins
        places: dict[int, list[tuple[int, int]]] = {}
        for number, message in enumerate(mine):
            channel = self.topics.index((message.topic, message.msgtype))
            places.setdefault(channel, []).append((message.time_ns, len(inner)))
            self.counts[channel] += 1
            raw = bytes(TYPES.serialize_cdr(message.content, message.msgtype))
            times = (message.time_ns, message.time_ns)
            inner += record(0x05, struct.pack("<HIQQ", channel, number, *times) + raw)
        span = span_of(mine)
        packed = COMPRESSIONS[self.compression](inner)
        head = span + struct.pack("<QI", len(inner), 0)
        head += text(self.compression) + struct.pack("<Q", len(packed))
        at = len(self.content)
        self.content += record(0x06, head + packed)
        where = struct.pack("<QQ", at, len(self.content) - at)
        sizes = text(self.compression) + struct.pack("<QQ", len(packed), len(inner))
        self.indexes += record(0x08, span + where + self._message_indexes(places) + sizes)

    def _message_indexes(self, places: dict[int, list[tuple[int, int]]]) -> bytes:
        """Writes those of a chunk, channel by channel; where they lie, and how long they are, for the chunk's index."""
        begins = len(self.content)
        offsets = b""
        if self.lacks != "message indexes":
            for channel, entries in places.items():
                offsets += struct.pack("<HQ", channel, len(self.content))
                rows = b"".join(struct.pack("<QQ", *entry) for entry in entries)
                self.content += record(0x07, struct.pack("<HI", channel, len(rows)) + rows)
        length = struct.pack("<Q", len(self.content) - begins)
        return struct.pack("<I", len(offsets)) + offsets + length

    def _statistics(self) -> bytes:
        """How many messages there are, in all and of each channel."""
        of_each = b"".join(struct.pack("<HQ", *count) for count in self.counts.items())
        topics = len(self.topics)
        numbers = (len(self.messages), topics, topics, 0, 0, len(self.indexes))
        said = struct.pack("<QHIIII", *numbers) + span_of(self.messages)
        return record(0x0B, said + struct.pack("<I", len(of_each)) + of_each)

    def whole(self) -> bytes:
        """The file, closed."""
        self.content += record(0x0F, bytes(4))
        start = 0
        if self.lacks != "summary":
            start = len(self.content)
            self.content += self.kinds + self.indexes
        if self.lacks == "":
            self.content += self._statistics()
        return self.content + record(0x02, struct.pack("<QQI", start, 0, 0)) + b"\x89MCAP0\r\n"


def span_of(messages: Sequence[Message]) -> bytes:
    """First and last time [ns]."""
    times_ns = [message.time_ns for message in messages]
    return struct.pack("<QQ", min(times_ns), max(times_ns))


def mcap_of(
    messages: Sequence[Message],
    compression: str,
    lacks: str = "",
    chunk: int = 30,
) -> bytes:
    """A file with so many messages a chunk, and without message indexes, statistics or summary.

    Args:
        messages: In their order.
        compression: Of the chunks, by its name in the specification.
        lacks: What it is without, see `ByHand`.
        chunk: Messages in each.
    """
    file = ByHand(messages, compression, lacks)
    for begin in range(0, len(messages), chunk):
        file.add_chunk(messages[begin : begin + chunk], b"" if begin else file.kinds)
    return file.whole()


@pytest.mark.parametrize("storage", STORAGES)
def test_folder_file_and_folder_without_metadata_give_the_same(
    tmp_path: Path, storage: str
) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands(), storage)
    whole = read(folder)
    (file,) = (path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
    (folder / "metadata.yaml").unlink()
    for path in (file, folder):
        again = read(path)
        assert np.array_equal(again.joints.position, whole.joints.position)
        assert again.inputs is not None and whole.inputs is not None
        assert np.array_equal(again.inputs.current_A, whole.inputs.current_A)


def test_storage_files_without_metadata_are_read_as_one_bag(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    messages = states() + commands()
    for part, half in enumerate((messages[1::2], messages[::2])):
        bag = write_bag(tmp_path / f"part{part}", half)
        shutil.copy(bag / f"part{part}.mcap", folder)
    recording = read(folder)
    assert recording.joints.times_ns.tolist() == times()
    assert recording.notes == ("There is no metadata.yaml; 2 storage files were read as one bag.",)


@pytest.mark.parametrize("storage", STORAGES)
def test_types_that_nobody_knows_are_skipped(tmp_path: Path, storage: str) -> None:
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:
        odd = writer.add_connection(
            "/odd", "odd_msgs/msg/Odd", msgdef="nonsense $$ x", rihs01="RIHS01_0"
        )
        writer.write(odd, ONSET_NS, b"not even CDR")
        for message in states()[:20]:
            if message.time_ns == times()[0]:
                connection = writer.add_connection(message.topic, message.msgtype, typestore=TYPES)
            # rclpy's serialize_message leaves 8 stray bytes behind empty arrays
            raw = bytes(TYPES.serialize_cdr(message.content, message.msgtype)) + bytes(8)
            writer.write(connection, message.time_ns, raw)
    recording = read(tmp_path / "bag")
    assert recording.joints.position.tolist() == [positions(time_ns) for time_ns in times()[:20]]


def test_paths_that_are_no_bag(tmp_path: Path) -> None:
    with refused("no such bag"):
        read(tmp_path / "missing")
    for name, pattern in (
        ("notes.txt", "not a bag"),
        ("old.bag", "ROS 1 bag; convert it with `rosbags-convert`"),
    ):
        (tmp_path / name).write_text("hello")
        with refused(pattern):
            read(tmp_path / name)
    (tmp_path / "folder").mkdir()
    with refused("not a bag: no metadata.yaml"):
        read(tmp_path / "folder")
    write_bag(tmp_path / "outer" / "bag_mcap", states())
    with refused("did you mean one of the bags in it: bag_mcap"):
        read(tmp_path / "outer")
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "metadata.yaml").write_text("rosbag2_bagfile_information: [1")
    with refused("not readable as a ROS 2 bag"):
        read(tmp_path / "meta")


@pytest.mark.parametrize("bare", [False, True], ids=["folder", "file"])
def test_a_truncated_database_is_one_line_wherever_it_is_cut(tmp_path: Path, bare: bool) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands(), "sqlite3")
    file = folder / "bag.db3"
    whole = file.read_bytes()
    for part in np.linspace(0.0, 0.99, 12):
        file.write_bytes(whole[: int(part * len(whole))])
        with refused("not readable as a ROS 2 bag|holds no messages"):
            read(file if bare else folder)


@pytest.mark.parametrize("bare", [False, True], ids=["folder", "file"])
@pytest.mark.parametrize("compression", list(COMPRESSIONS))
def test_of_a_truncated_file_what_is_whole_is_read_and_it_is_said(
    tmp_path: Path, bare: bool, compression: str
) -> None:
    messages = sorted(
        states() + commands(),
        key=lambda message: message.time_ns,
    )
    folder = write_bag(tmp_path / "bag", messages)
    file = folder / "bag.mcap"
    whole = mcap_of(messages, compression)
    file.write_bytes(whole)
    everything = read(folder).joints.position
    counts = []
    for part in np.linspace(0.0, 0.999, 15):
        file.write_bytes(whole[: int(part * len(whole))])
        try:
            recording = read(file if bare else folder)
        except RecordingError as error:
            assert "\n" not in str(error)
            counts.append(0)
            continue
        found = recording.joints.position
        assert np.array_equal(found, everything[: len(found)])
        assert "bag.mcap breaks off, as of a recorder that was killed" in notes(recording)
        counts.append(len(found))
    assert counts == sorted(counts) and counts[0] == 0
    assert counts[-1] == len(everything)  # only the index is lost
    # of a chunk that breaks off the beginning is read, but for compressed ones as small as here
    assert len(set(counts)) > (4 if compression else 8) - 1


@pytest.mark.parametrize("compression", list(COMPRESSIONS))
@pytest.mark.parametrize("lacks", ["message indexes", "summary", "statistics"])
def test_chunks_without_an_index_are_read(tmp_path: Path, compression: str, lacks: str) -> None:
    messages = sorted(
        states() + commands(),
        key=lambda message: message.time_ns,
    )
    (tmp_path / "bag.mcap").write_bytes(mcap_of(messages, compression, lacks))
    recording = read(tmp_path / "bag.mcap")
    assert recording.joints.position.tolist() == [positions(time_ns) for time_ns in times()]
    assert recording.inputs is not None and recording.notes == ()


def test_messages_without_an_index_need_not_be_in_order(tmp_path: Path) -> None:
    messages = states() + commands()
    (tmp_path / "bag.mcap").write_bytes(mcap_of(messages[::-1], "", "summary"))
    recording = read(tmp_path / "bag.mcap")
    assert recording.joints.position.tolist() == [positions(time_ns) for time_ns in times()]


@pytest.mark.parametrize("size", [2**31, 2**40, 2**60, 2**63, 2**64 - 1])
@pytest.mark.parametrize("lacks", ["", "summary"])
def test_a_chunk_that_claims_to_be_huge_is_one_sentence(
    tmp_path: Path, size: int, lacks: str
) -> None:
    content = bytearray(mcap_of(states(), "", lacks))
    chunk = content.index(
        b"\x06",
        9 + int.from_bytes(content[9:17], "little"),
    )
    for field in (chunk + 1, chunk + 9 + 16):  # the record's length, and what it unpacks to
        changed = content.copy()
        changed[field : field + 8] = size.to_bytes(8, "little")
        (tmp_path / "bag.mcap").write_bytes(changed)
        try:
            read(tmp_path / "bag.mcap")
        except RecordingError as error:
            assert "MemoryError" not in str(error) and "not readable as a ROS 2 bag" in str(error)
        else:
            assert not lacks  # the index says how long it is


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("ending", [".zstd", ".zst"])
def test_compressed_files_without_metadata_are_read(
    tmp_path: Path, storage: str, ending: str
) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands(), storage)
    whole = read(folder)
    (file,) = (path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
    packed = file.with_name(file.name + ending)
    packed.write_bytes(zstd.compress(file.read_bytes()))
    file.unlink()
    (folder / "metadata.yaml").unlink()
    for path in (folder, packed):
        assert np.array_equal(read(path).joints.position, whole.joints.position)


def test_a_compressed_file_that_is_cut_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    messages = sorted(
        states() + commands(),
        key=lambda message: message.time_ns,
    )
    packed = tmp_path / "bag.mcap.zstd"
    content = mcap_of(messages, "", chunk=20)
    frames = b"".join(zstd.compress(content[at : at + 2000]) for at in range(0, len(content), 2000))
    packed.write_bytes(frames[: int(0.7 * len(frames))])
    recording = read(packed)
    found = recording.joints.position.tolist()
    assert 10 < len(found) < len(times())
    assert found == [positions(time_ns) for time_ns in times()[: len(found)]]
    assert "bag.mcap breaks off" in notes(recording)
    packed.write_bytes(b"nothing of the kind")
    with refused("not readable as a ROS 2 bag"):
        read(packed)


def test_a_recorder_that_was_killed_leaves_its_last_file_uncompressed(tmp_path: Path) -> None:
    messages = sorted(
        states() + commands(),
        key=lambda message: message.time_ns,
    )
    parts = [
        mcap_of(messages[:40], ""),
        mcap_of(messages[40:], "", "summary"),
    ]
    (tmp_path / "bag_0.mcap.zstd").write_bytes(zstd.compress(parts[0]))
    (tmp_path / "bag_1.mcap").write_bytes(parts[1])
    (tmp_path / "bag_1.mcap.zstd").write_bytes(zstd.compress(parts[1])[:100])
    assert read(tmp_path).joints.times_ns.tolist() == times()


def test_metadata_of_thousands_of_topics_is_not_needed(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", states())
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text() + "".join(f"topic_{n}: 1\n" for n in range(25_000)))
    recording = read(folder)
    assert len(recording.joints.times_ns) == len(times())
    assert "lists thousands of topics" in notes(recording)
    metadata.write_text("x: [1")
    assert len(read(folder).joints.times_ns) == len(times())


@pytest.mark.parametrize("name", ["bag.mcap", "bag.db3", "bag.mcap.zstd", "bag.txt"])
def test_a_pipe_is_no_bag_and_is_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with refused("a pipe, a socket or a device, and no file"):
        read(tmp_path / name)
    if name != "bag.txt":
        with refused("a pipe, a socket or a device, and no file"):
            read(tmp_path)
        (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
        with refused("a pipe, a socket or a device, and no file"):
            read(tmp_path)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.data())
def test_flipped_bytes_are_read_or_refused_and_never_crash(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    source = (
        BAGS
        / "friction_s00_fixed_heavy_ball_50g_joint3"
        / data.draw(st.sampled_from(["bag_mcap", "bag_sqlite3"]))
    )
    folder = tmp_path_factory.mktemp("flipped") / "bag"
    shutil.copytree(source, folder)
    file = data.draw(st.sampled_from(sorted(folder.iterdir())))
    content = bytearray(file.read_bytes())
    for place in data.draw(
        st.lists(
            st.integers(0, len(content) - 1),
            min_size=1,
            max_size=20,
        )
    ):
        content[place] = data.draw(st.integers(0, 255))
    file.write_bytes(content)
    try:
        read(folder)
    except RecordingError as error:
        assert "\n" not in str(error)


def test_a_bag_that_holds_less_than_its_metadata_promises(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands())
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 41", "message_count: 50"))
    assert "/joint_states: the bag promises 50 messages but holds 41." in read(folder).notes
    metadata.write_text(
        metadata.read_text().replace("name: /current_command", "name: /applied/current_command")
    )
    with refused("/applied/current_command should hold 50 messages but holds none"):
        read(folder)


def test_a_write_ahead_log_that_was_not_merged_is_reported(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", states() + commands(), "sqlite3")
    (folder / "bag.db3-wal").write_bytes(b"pages")
    assert "bag.db3-wal may hold messages" in notes(read(folder))
    assert "bag.db3-wal may hold messages" in notes(read(folder / "bag.db3"))


def test_another_serialisation_is_refused(tmp_path: Path) -> None:
    with Writer(
        tmp_path / "bag",
        version=9,
        storage_plugin=StoragePlugin.MCAP,
    ) as writer:
        connection = writer.add_connection(
            "/joint_states", JOINT_STATE, typestore=TYPES, serialization_format="json"
        )
        writer.write(connection, ONSET_NS, b"{}")
    with refused("only 'cdr' can be read"):
        read(tmp_path / "bag")
    with refused("/joint_states is serialised as 'json'; only 'cdr' can be read"):
        read(tmp_path / "bag" / "bag.mcap")


@pytest.mark.parametrize(
    ("folder", "pattern"),
    [
        ("sqlite_empty", "holds no messages"),
        ("sqlite_wrong_rmw", "only 'cdr' can be read"),
        ("mcap_wrong_rmw", "only 'cdr' can be read"),
        ("sqlite_cdr", "no JointState topic in the bag; it holds: /array_topic"),
        ("mcap_cdr", "no JointState topic in the bag; it holds: /array_topic"),
        ("mcap_service_events", "no JointState topic"),
        ("sqlite_split5", r"no JointState topic.*AAA \(std_msgs/String\)"),
        ("mcap_split5", r"no JointState topic.*AAA \(std_msgs/String\)"),
        ("mcap_no_metadata_3files", r"no JointState topic.*/chatter"),
        ("sqlite_talker", "no JointState topic.*/topic"),
    ],
)
def test_bags_of_rosbag2s_own_tests(shared: Path, folder: str, pattern: str) -> None:
    path = shared / "recordings_real" / "edge_bags" / folder
    if not path.exists():
        pytest.skip("the odd bags are not here")
    with refused(pattern):
        read(path)
