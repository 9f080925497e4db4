"""One calibration as it happened: the messages that came in, the bag they become, and what that bag says.

The bag is written before anything is identified, and what is identified is the bag: replaying it later runs the same function on
the same bytes, so it gives the same numbers. No ROS here; the identifier node only hands the bytes in.
"""

from __future__ import annotations

import json
import os
import shlex
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.bags import RawMessage, write_messages
from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.probes import all_probes, probe_named
from proprio_ros.probes.base import Probe
from proprio_ros.records import InputRecord, JointRecord, Recording
from proprio_ros.replay import ReplayOptions, configured_robot, held_positions, probe_asked_for
from proprio_ros.resources import private_folder, write_in_one_step
from proprio_ros.robot import Robot
from proprio_ros.runs import cut_runs
from proprio_ros.settings import Settings
from proprio_ros.sim.joint import compile_kernels


class Session:
    """The messages of one calibration.

    Args:
        root: Folder below which the session's own folder is made.
        kind: Such as ``payload``; part of the folder's name.
        now: Time of its beginning; default the present.
    """

    def __init__(self, root: Path, kind: str, now: datetime | None = None) -> None:
        stamp = (now or datetime.now(timezone.utc)).strftime("%Y%m%d_%H%M%S_%f")[:-3]
        self.name = f"{stamp}_{kind}"
        self.folder = root / self.name
        self.bag: Path | None = None
        self._messages: list[RawMessage] = []
        self._lock = threading.Lock()

    def add(self, topic: str, msgtype: str, time_ns: int, data: bytes) -> None:
        """Keep one message; from any thread."""
        with self._lock:
            self._messages.append(RawMessage(topic, msgtype, time_ns, data))

    def __len__(self) -> int:
        return len(self._messages)

    def save(self) -> tuple[Path, str]:
        """Write the bag, where that is not possible into a temporary folder, so that nothing is lost on a full disk.

        Returns:
            The bag, and a sentence when it is not where it should be.

        Raises:
            RecordingError: It can be written nowhere; the messages are kept, and it can be tried again.
        """
        with self._lock:
            messages = list(self._messages)
        if not messages:
            raise RecordingError("no joint states came in: is the driver running, and are the topics named right?")
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
            self.folder, self.bag = folder, folder / "bag"
            return self.bag, f"the recording is in {folder}, because of this: {problem}" if problem else ""
        raise RecordingError(
            f"the recording can be written nowhere ({problem}): free some room; it is kept in memory meanwhile"
        )


def _elsewhere() -> list[Path]:
    """Folders of this user alone, on the disk and in memory."""
    name = f"proprio_recordings_{os.getuid()}"
    return [Path(tempfile.gettempdir()) / name, Path("/dev/shm") / name]


def prepare_identification() -> None:
    """Compile and load all kernels that a weighing or a calibration may need, so that none is compiled in a probe."""
    compile_kernels()


def settings_for(probe: Probe[Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """What concerns a probe; what is stated about another probe's object is left out."""
    foreign = tuple(start for other in all_probes() if other.name != probe.name for start in other.keys)
    return {key: value for key, value in settings.items() if key == "payload.frame" or not key.startswith(foreign)}


def check_settings(options: ReplayOptions) -> None:
    """Look at settings that may be about the objects of several probes.

    Raises:
        ConfigurationError, RobotError: In one line, what is wrong with them.
    """
    settings = Settings(options.settings)
    robot_of_settings(options, settings)
    settings.take_prefix("solver.")
    # finite elements take a second to import, which a node that starts beside a driver should not spend on nothing
    concerned = [probe for probe in all_probes() if any(key.startswith(probe.keys) for key in settings.left)]
    for probe in concerned:
        probe.check_live(probe.facts(settings))
    if settings.left:
        for probe in all_probes():  # so that the refusal can list every key there is
            if probe not in concerned:
                probe.facts(settings)
    settings.refuse_rest()


@dataclass(frozen=True)
class Setting:
    """What a job is about, read once.

    Attributes:
        probe: what is identified.
        robot: as the options have it.
        facts: what is stated about the object; the probe knows their form.
        options: with which the bag will be identified.
    """

    probe: Probe[Any]
    robot: Robot
    facts: Any
    options: ReplayOptions


def setting_of(options: ReplayOptions) -> Setting:
    """Robot, object and search as the options have them, for a live job.

    Raises:
        ConfigurationError, RobotError: In one line, what is wrong with them.
    """
    probe = probe_asked_for(options)
    settings = Settings(options.settings)
    robot = robot_of_settings(options, settings)
    facts = probe.facts(settings, options.solver, options.profile)
    settings.refuse_rest()
    probe.check_live(facts)
    return Setting(probe, robot, facts, options)


def robot_of_settings(options: ReplayOptions, settings: Settings) -> Robot:
    """The robot, with what the settings say of it."""
    robot = configured_robot(options.robot, options.calibration, settings)
    held_positions(robot, settings)
    return robot


def baseline_options(setting: Setting) -> ReplayOptions:
    """How the hand without the object is identified: as what the probe's baseline says it is."""
    probe, options = setting.probe, setting.options
    assert probe.baseline is not None
    left_out = (*probe.keys, "solver.")
    settings = {key: value for key, value in options.settings.items() if not key.startswith(left_out)}
    settings |= probe.baseline_settings(setting.facts)
    return replace(options, probe=probe.baseline.probe, settings=settings, baseline=())


def keep_result(bag: Path, estimate: Estimate, command: str) -> None:
    """Write `estimate.json` beside a bag: the result, and the command that gives it again.

    Raises:
        ConfigurationError: It cannot be written.
    """
    content = {**estimate.as_json(), "command": command}
    write_in_one_step(bag.parent / "estimate.json", json.dumps(content, indent=1) + "\n", "the result")


def replay_command(bag: Path, options: ReplayOptions) -> str:
    """The command line that gives the same numbers again."""
    words = ["proprio", "replay", str(bag), "--probe", options.probe]
    if options.robot:
        words += ["--robot", options.robot]
    if options.calibration:
        words += ["--calibration", str(options.calibration)]
    if options.baseline:
        words += ["--baseline", *(str(path) for path in options.baseline)]
    for key, value in options.settings.items():
        words += ["--set", f"{key}={value if isinstance(value, str) else json.dumps(value)}"]
    return shlex.join(words)


class LiveEstimate:
    """An estimate from what has come so far; its interval shrinks as the probe goes on.

    `add_state` and `add_input` may be called from another thread than `estimate`.

    Args:
        setting: As for the bag that will be identified afterwards; of a probe that is `live`.
    """

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        self._lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        """Forget everything that came."""
        with self._lock:
            self._names: tuple[str, ...] = ()
            self._states: list[tuple[int, tuple[float, ...]]] = []
            self._inputs: list[tuple[int, tuple[float, ...]]] = []
            self._weighed = 0

    def add_state(self, stamp_ns: int, names: Sequence[str], position: Sequence[float]) -> None:
        """One joint state; others than the first's joints, or out of order, are passed over."""
        self._add(self._states, stamp_ns, names, position)

    def add_input(self, stamp_ns: int, names: Sequence[str], effort: Sequence[float]) -> None:
        """One applied effort [N m or N] of the same joints."""
        self._add(self._inputs, stamp_ns, names, effort)

    def _add(
        self, rows: list[tuple[int, tuple[float, ...]]], stamp_ns: int, names: Sequence[str], values: Sequence[float]
    ) -> None:
        row = tuple(float(value) for value in values)
        with self._lock:
            self._names = self._names or tuple(names)
            usable = tuple(names) == self._names and len(row) == len(self._names) and bool(np.all(np.isfinite(row)))
            if usable and (not rows or stamp_ns > rows[-1][0]):
                rows.append((stamp_ns, row))

    def estimate(self) -> Estimate | None:
        """The estimate of all runs so far, the one under way included; None before there is one, or when nothing new came."""
        with self._lock:
            states, inputs, names = list(self._states), list(self._inputs), self._names
        if len(states) == self._weighed or not inputs:
            return None
        self._weighed = len(states)
        try:
            record = JointRecord(
                np.array([row[0] for row in states]),
                names,
                np.array([row[1] for row in states]).reshape(-1, len(names)),
            )
            setting = self._setting
            drives = setting.robot.drive_trains
            constants = np.array([drives[n].nominal_effort_per_current if n in drives else 1.0 for n in names])
            current = np.array([row[1] for row in inputs]).reshape(-1, len(names)) / constants
            source = InputRecord(np.array([row[0] for row in inputs]), names, current, "/applied_effort")
            runs = cut_runs(Recording("live", record, source), joints=list(drives))
            return setting.probe.identify_so_far(setting.robot, runs, setting.facts)
        except ProprioError:
            return None  # not enough yet; what is wrong for good is reported by the identification of the bag


def live_interval(estimate: Estimate) -> tuple[float, float] | None:
    """What is searched for and its standard deviation as far as the run has come, also where a verdict still withholds them."""
    name, _ = probe_named(estimate.probe).answer
    for row in estimate.unknowns:
        if row.name == name and np.isfinite(row.std):
            return float(row.value), float(row.std)
    return None


def as_diagnostics(estimate: Estimate) -> dict[str, Any]:
    """Keys and values of a diagnostics message about an estimate."""
    entries: dict[str, Any] = {"probe": estimate.probe, "verdict": estimate.verdict.value, "robot": estimate.robot}
    for value in estimate.values:
        entries[value.name] = "not determined" if value.value is None else value.value
        entries[f"{value.name}.unit"] = value.unit
        if value.std is not None:
            entries[f"{value.name}.std"] = value.std
        if value.ci95 is not None:
            entries[f"{value.name}.ci95"] = list(value.ci95)
    return entries
