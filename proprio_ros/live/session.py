"""One calibration as it happened: the messages that came in, the bag they become, and what that bag says.

The bag is written before anything is identified, and what is identified is the bag: replaying it later runs the same function on
the same bytes, so it gives the same numbers. No ROS here; the identifier node only hands the bytes in.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import re
import shlex
import shutil
import struct
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from proprio_ros import clock
from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.inputs.resources import paths_of, private_folder, write_in_one_step
from proprio_ros.inputs.settings import Settings
from proprio_ros.pipeline.loading import bag_runs, standing
from proprio_ros.pipeline.request import Options, Request, read_request, request_of, robot_of
from proprio_ros.probes import all_probes
from proprio_ros.probes.base import EstimatesLive, Guards, HasBaseline, Probe
from proprio_ros.recordings.for_robot import motors_notes
from proprio_ros.recordings.messages import RawMessage
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.recordings.sources import BagSource
from proprio_ros.recordings.topics import APPLIED_EFFORT, CURRENT_COMMAND
from proprio_ros.recordings.writer import write_messages
from proprio_ros.records import InputRecord, JointRecord, Recording, Run
from proprio_ros.sim.joint import compile_kernels

JOURNAL = "messages.journal"
"""What came in so far, beside the bag that it becomes; it is there while a recording is under way, and after a crash."""
_RECORD = struct.Struct("<qHHI")  # time [ns], and lengths of topic, type and data, which follow


class Session:
    """The messages of one calibration, in a folder of its own, whose name says when it began and of what kind it is.

    Each is written as it comes, so that a process that is killed loses none (see `recover`), and becomes part of the bag at the
    end: the index of an MCAP file is written last.

    Args:
        root: Folder below which it is.
        kind: What is recorded, as part of the folder's name.
        now: When it began; None: now.
    """

    def __init__(self, root: Path, kind: str, now: datetime | None = None) -> None:
        stamp = (now or datetime.now(timezone.utc)).strftime("%Y%m%d_%H%M%S_%f")[:-3]
        self.name = f"{stamp}_{kind}"
        self.folder = root / self.name
        self.bag: Path | None = None
        self._messages: list[RawMessage] = []
        self._journal: BinaryIO | None = None
        self._lock = clock.lock()

    def open(self) -> None:
        """Make the folder and begin to write; without it the messages are in memory until `save`.

        Raises `RecordingError`: It cannot be written.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._journal = (self.folder / JOURNAL).open("xb", buffering=0)
            # the kernel lets go of it when we are gone, killed or not
            fcntl.flock(self._journal, fcntl.LOCK_EX)
        except OSError as error:
            self.discard()
            raise unwritable(self.folder.parent, error) from error

    def add(self, topic: str, msgtype: str, time_ns: int, data: bytes) -> None:
        """Keep one message; from any thread.

        Args:
            topic: On which it came.
            msgtype: Its type, as ``sensor_msgs/msg/JointState``.
            time_ns: When it came [ns].
            data: The message, serialized.
        """
        with self._lock:
            self._messages.append(
                RawMessage(
                    topic,
                    msgtype,
                    time_ns,
                    data,
                )
            )
            if self._journal is not None:
                self._write(
                    self._journal,
                    topic.encode(),
                    msgtype.encode(),
                    time_ns,
                    data,
                )

    def _write(
        self, journal: BinaryIO, topic: bytes, msgtype: bytes, time_ns: int, data: bytes
    ) -> None:
        head = _RECORD.pack(
            time_ns,
            len(topic),
            len(msgtype),
            len(data),
        )
        record = head + topic + msgtype + data
        try:
            complete = journal.write(record) == len(record)
        except OSError:
            complete = False
        if not complete:  # a full disk: `save` finds another place, and says so
            journal.close()
            self._journal = None

    def __len__(self) -> int:
        return len(self._messages)

    def save(self) -> tuple[Path, str]:
        """Write the bag, where that is not possible into a temporary folder, so that nothing is lost on a full disk.

        Returns: The bag, and a sentence when it is not where it should be.

        Raises `RecordingError`: It can be written nowhere; the messages are kept, and it can be tried again.
        """
        with self._lock:
            messages = list(self._messages)
        if not messages:
            self.discard()
            raise RecordingError(
                "no joint states came in: is the driver running, and are the topics named right?"
            )
        problem = ""
        for parent in (self.folder.parent, *_elsewhere()):
            folder = parent / self.name
            try:
                if parent != self.folder.parent:
                    private_folder(parent)  # these lie where every user may write
                folder.mkdir(parents=True, exist_ok=True)
                write_messages(folder / "bag", messages)
            except (OSError, RecordingError) as error:
                problem = problem or str(error)
                continue
            self.discard()
            self.folder = folder
            self.bag = folder / "bag"
            if problem:
                problem = f"the recording is in {folder}, because of this: {problem}"
            return self.bag, problem
        remedy = "free some room; it is kept in memory meanwhile"
        raise RecordingError(f"the recording can be written nowhere ({problem}): {remedy}")

    def discard(self) -> None:
        """Take away what was written as it came, and the folder where nothing else is in it."""
        with self._lock:
            journal = self._journal
            self._journal = None
        if journal is not None:
            journal.close()
        with contextlib.suppress(OSError):
            (self.folder / JOURNAL).unlink()
        with contextlib.suppress(OSError):
            self.folder.rmdir()


def unwritable(folder: Path, error: Exception) -> RecordingError:
    """Why nothing is begun."""
    reason = getattr(error, "strerror", None) or str(error)
    remedy = "free some room, or name another folder with --data-directory"
    return RecordingError(f"{folder} cannot be written ({reason}): {remedy}")


def read_journal(path: Path) -> list[RawMessage]:
    """What a journal holds; a last record that was cut off is left out."""
    data = path.read_bytes()
    messages = []
    at = 0
    while at + _RECORD.size <= len(data):
        time_ns, topic, msgtype, size = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        names = at + topic + msgtype
        end = at + topic + msgtype + size
        if end > len(data):
            break
        called = data[at : at + topic].decode()
        of_type = data[at + topic : names].decode()
        messages.append(
            RawMessage(
                called,
                of_type,
                time_ns,
                data[names:end],
            )
        )
        at = end
    return messages


def recover(root: Path) -> tuple[list[Path], list[str]]:
    """Make bags of what was being recorded below a root by processes that are gone.

    Returns: The bags, and a sentence about each that could not be written; it is tried again the next time.
    """
    bags = []
    problems = []
    for path in sorted(root.glob(f"*/{JOURNAL}")):
        bag = path.parent / "bag"
        try:
            with path.open("rb") as journal:
                fcntl.flock(journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
                messages = read_journal(path)
                if messages and not (bag / "metadata.yaml").exists():  # rosbags writes it last
                    shutil.rmtree(bag, ignore_errors=True)
                    write_messages(bag, messages)
                    bags.append(bag)
                path.unlink()
            if not messages:
                path.parent.rmdir()
        except BlockingIOError:
            continue  # somebody writes it just now
        except (OSError, ValueError, RecordingError) as error:
            problems.append(f"{path}: what was recorded could not be recovered ({error})")
    return bags, problems


def _elsewhere() -> list[Path]:
    """Folders of this user alone, on the disk and in memory."""
    name = f"proprio_recordings_{os.getuid()}"
    return [Path(tempfile.gettempdir()) / name, Path("/dev/shm") / name]


def prepare_identification(options: Options) -> None:
    """Compile and load all kernels that weighings and calibrations of a robot may need, so that no excitation waits for one.

    Raises `ConfigurationError`, `RobotError`: The robot cannot be read, or compiled kernels cannot be kept.
    """
    compile_kernels(rises=robot_of(options).friction_rises)


def settings_for(probe: Probe[Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """What concerns a probe; what is stated about another probe's object is left out."""
    foreign: tuple[str, ...] = ()
    for other in all_probes():
        if other.name != probe.name:
            foreign += tuple(other.keys)

    def concerns(key: str) -> bool:
        return key == "payload.frame" or not key.startswith(foreign)

    return {key: value for key, value in settings.items() if concerns(key)}


def _concerned(probe: Probe[Any], settings: Settings) -> bool:
    """Whether a setting is about a probe's object."""
    return any(key.startswith(probe.keys) for key in settings.left)


def check_settings(options: Options) -> None:
    """Look at settings that may be about the objects of several probes.

    Raises `ConfigurationError`, `RobotError`: In one line, what is wrong with them, or that the nodes cannot do it.
    """

    def take(settings: Settings) -> None:
        settings.take_prefix("solver.")
        # finite elements take a second to import, which a node that starts beside a driver should not spend on nothing
        concerned = [probe for probe in all_probes() if _concerned(probe, settings)]
        for probe in concerned:
            facts = probe.facts(settings)
            if isinstance(probe, Guards):
                probe.check_live(facts)
        if settings.left:
            for probe in all_probes():  # so that the refusal can list every key there is
                if probe not in concerned:
                    probe.facts(settings)

    read_request(options, take)


def live_request(options: Options) -> Request:
    """What the options ask of a live job; what is wrong with them is raised as by `request_of`."""
    request = request_of(options)
    if isinstance(request.probe, Guards):
        request.probe.check_live(request.facts)
    return request


def baseline_runs(request: Request) -> list[Run]:
    """The runs of the baseline, as the identification of the object will read them. Raises `RecordingError`: One cannot be read."""
    runs: list[Run] = []
    for path in paths_of(request.options.baseline):
        runs += bag_runs(Path(path), request)
    return runs


def baseline_options(request: Request) -> Options:
    """How the hand without the object is identified: as what the probe's baseline says it is."""
    probe = request.probe
    options = request.options
    assert isinstance(probe, HasBaseline)
    left_out = (*probe.keys, "solver.")
    settings = {
        key: value for key, value in options.settings.items() if not key.startswith(left_out)
    }
    settings |= probe.baseline_settings(request.facts)
    return replace(
        options,
        probe=probe.baseline.probe,
        settings=settings,
        baseline=(),
    )


def check_input(
    folder: Path,
    messages: Sequence[RawMessage],
    request: Request,
) -> tuple[str, ...]:
    """Read what comes in at rest as it will be read after the excitation, so that a refusal comes before anything moves.

    Args:
        folder: Where the recording will be; a bag is written there, and taken away.
        messages: Some tenths of a second of all topics.
        request: With which the recording will be identified; its robot should be in them.

    Returns:
        The repairs that reading it takes, one sentence each.

    Raises:
        RecordingError: The folder cannot be written, or the messages cannot be read, or are of another robot.
    """
    bag = folder / "check"
    try:
        write_messages(bag, messages)
    except (OSError, RecordingError) as error:
        raise unwritable(folder.parent, error) from error
    robot = request.robot
    options = request.options
    command = options.command_topic
    heard = any(message.topic == command for message in messages)
    asked = replace(
        request.reading.options,
        # at rest nothing says what it means, and nothing asks
        effort=replace(request.reading.options.effort, unit=request.unit or "raw"),
        command_topic=command if heard else None,
        span=None,
        fits_names=False,  # live, joints are heard by the names that a profile states
        states_only=False,
    )
    try:
        with BagSource(bag) as source:
            recording = source.recording(asked)
            about_motors = motors_notes(source, robot, options.state_topic)
    except RecordingError as error:
        raise RecordingError(error.about(bag)) from error
    finally:
        shutil.rmtree(bag, ignore_errors=True)
    if not set(recording.joints.names) & set(robot.drive_trains):
        recorded = ", ".join(recording.joints.names)
        known = ", ".join(robot.drive_trains)
        remedy = "name the robot with --robot, or their topic with --state-topic"
        raise RecordingError(
            f"the joint states are of {recorded}, and {robot.name} has {known}: {remedy}"
        )
    return recording.notes + about_motors


def as_parameters(sentence: str) -> str:
    """The same with options of the command line called what they are called in a node."""
    sentence = sentence.replace("--set ", "the parameter settings with ")
    known = r"--(robot|driver|calibration|data-directory|[a-z]+-topic|effort-unit|effort-sign)\b"
    return re.sub(known, lambda found: f"the parameter {found[1].replace('-', '_')}", sentence)


def keep_result(bag: Path, estimate: Estimate, command: str) -> None:
    """Write `estimate.json` beside a bag: the result, and the command that gives it again.

    Args:
        bag: The recording.
        estimate: What it says.
        command: The command line that gives the same numbers again.

    Raises:
        ConfigurationError: It cannot be written.
    """
    content = {**estimate.as_json(), "command": command}
    text = json.dumps(content, indent=1) + "\n"
    write_in_one_step(bag.parent / "estimate.json", text, "the result")


def replay_command(bag: Path, options: Options) -> str:
    """The command line that gives the same numbers again."""
    words = [
        "proprio",
        "replay",
        str(bag),
        "--probe",
        options.probe,
    ]
    for name in (
        "robot",
        "calibration",
        "driver",
        "state_topic",
        "command_topic",
        "effort_unit",
        "effort_sign",
    ):
        if getattr(options, name):
            words += [f"--{name.replace('_', '-')}", str(getattr(options, name))]
    if options.baseline:
        words += ["--baseline", *(str(path) for path in options.baseline)]
    for key, value in options.settings.items():
        words += ["--set", f"{key}={value if isinstance(value, str) else json.dumps(value)}"]
    return shlex.join(words)


class LiveEstimate:
    """An estimate from what has come so far; its interval shrinks as the excitation goes on.

    The request is that of the bag that will be identified afterwards. `add_state` and `add_input` may be called from another
    thread than `estimate`.
    """

    def __init__(self, request: Request) -> None:
        self._request = request
        self.joints = tuple(request.robot.drive_trains)
        self._lock = clock.lock()
        self.reset()

    def reset(self) -> None:
        """Forget everything that came."""
        with self._lock:
            self._states: list[tuple[int, dict[str, float]]] = []
            self._inputs: list[tuple[int, dict[str, float]]] = []
            self._commands: list[tuple[int, dict[str, float]]] = []
            self._newest_ns: dict[tuple[str, ...], int] = {}
            self._weighed = 0

    def add_state(self, stamp_ns: int, names: Sequence[str], position: Sequence[float]) -> None:
        """Take one joint state, of some or all joints; others than the robot's, and what is no number, are passed over.

        Args:
            stamp_ns: Its stamp [ns].
            names: Joints, shape (J,).
            position: Of these, shape (J,) [rad or m].
        """
        row = self._row(names, position)
        with self._lock:
            key = tuple(names)  # arm and gripper may come from two publishers, each with a clock
            if row and stamp_ns > self._newest_ns.get(key, -1):
                self._newest_ns[key] = stamp_ns
                self._states.append((stamp_ns, row))

    def add_input(self, stamp_ns: int, names: Sequence[str], effort: Sequence[float]) -> None:
        """Take one applied effort.

        Args:
            stamp_ns: Its stamp [ns].
            names: Joints, shape (J,).
            effort: Of these, shape (J,) [N m or N].
        """
        drives = self._request.robot.drive_trains
        row = {
            name: value / drives[name].nominal_effort_per_current
            for name, value in self._row(names, effort).items()
        }
        with self._lock:
            if row and (not self._inputs or stamp_ns > self._inputs[-1][0]):
                self._inputs.append((stamp_ns, row))

    def add_command(self, time_ns: int, current_A: Mapping[str, float]) -> None:
        """One current command; joints that it does not name are held. It counts where no applied effort comes."""
        row = self._row(tuple(current_A), tuple(current_A.values()))
        with self._lock:
            if not self._commands or time_ns > self._commands[-1][0]:
                self._commands.append((time_ns, row))

    def _row(self, names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
        row = {}
        for name, value in zip(names, values, strict=False):
            if name in self._request.robot.drive_trains:
                row[name] = float(value)
        return {name: value for name, value in row.items() if math.isfinite(value)}

    def position(self) -> dict[str, float]:
        """Where every joint was last seen [rad or m]."""
        with self._lock:
            return {
                name: position for _, row in self._states[-50:] for name, position in row.items()
            }

    def runs(self) -> tuple[Run, ...]:
        """All runs so far, the one under way included; none where nothing can be cut out yet."""
        with self._lock:
            applied = bool(self._inputs)
            states = list(self._states)
            inputs = list(self._inputs or self._commands)
        if not inputs or not states:
            return ()
        drives = self.joints
        current = np.array([[row.get(name, 0.0) for name in drives] for _, row in inputs])
        driven = {name for name, column in zip(drives, current.T, strict=True) if column.any()}
        try:
            record = self._joint_record(states, driven)
            topic = f"/{APPLIED_EFFORT if applied else CURRENT_COMMAND}"
            times_ns = np.array([time_ns for time_ns, _ in inputs])
            source = InputRecord(times_ns, drives, current, topic)
            held = standing(self._request, record.names)
            return cut_runs(
                Recording("live", record, source),
                held=held,
                joints=drives,
            )
        except ProprioError:
            # not enough yet; what is wrong for good is reported by the identification of the bag
            return ()

    def _joint_record(
        self, states: Sequence[tuple[int, dict[str, float]]], driven: set[str]
    ) -> JointRecord:
        """As from a bag: a row for each message that has the driven joints; what others report in between is held."""
        latest: dict[str, float] = {}
        for _, row in reversed(states):
            latest |= row
        names = tuple(name for name in self.joints if name in latest)
        rows: dict[int, list[float]] = {}
        newest_ns = -1
        for stamp_ns, row in states:
            latest |= row
            if driven <= row.keys() and stamp_ns > newest_ns:
                rows[stamp_ns] = [latest[name] for name in names]
                newest_ns = stamp_ns
        positions = np.array(list(rows.values())).reshape(-1, len(names))  # (T, J)
        return JointRecord(
            np.array(list(rows)),
            names,
            positions,
        )

    def estimate(self) -> Estimate | None:
        """The estimate of all runs so far; None before there is one, or when nothing new came."""
        with self._lock:
            count = len(self._states)
            driven = bool(self._inputs or self._commands)
        if count == self._weighed or not driven:
            return None
        self._weighed = count
        runs = self.runs()
        request = self._request
        try:
            if not runs or not isinstance(request.probe, EstimatesLive):
                return None
            return request.probe.identify_so_far(
                request.robot,
                runs,
                request.facts,
            )
        except ProprioError:
            return None
