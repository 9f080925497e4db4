"""One calibration as it happened: the messages that came in, the bag they become, and what that bag says.

The bag is written before anything is identified, and what is identified is the bag: replaying it later runs the same function on
the same bytes, so it gives the same numbers. No ROS here; the identifier node only hands the bytes in.
"""

from __future__ import annotations

import json
import shlex
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from proprio_ros.bags import RawMessage, write_messages
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError
from proprio_ros.identification.container import ContainerOptions
from proprio_ros.identification.container_problem import ContainerFacts
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.weighing import WeighingOptions, weigh
from proprio_ros.records import InputRecord, JointRecord, Recording
from proprio_ros.replay import (
    ReplayOptions,
    Settings,
    block_facts,
    configured_robot,
    container_facts,
    held_positions,
    payload_facts,
    probe_file,
)
from proprio_ros.resources import write_in_one_step
from proprio_ros.robot import Robot
from proprio_ros.runs import cut_runs
from proprio_ros.sim.joint import compile_kernels
from proprio_ros.sim.payload import PayloadFacts
from proprio_ros.sim.sphere import compile_kernels as compile_sphere_kernels

if TYPE_CHECKING:
    from proprio_ros.identification.squeeze_problem import BlockFacts

_Facts = TypeVar("_Facts")

LIVE_STARTS_KG = (0.01, 0.1)
"""A live estimate need not find its way from two orders of magnitude."""
_FACTS = {"payload": ("payload.",), "container": ("container.", "sphere.", "contact."), "softness": ("block.",)}
"""What the keys about a probe's object begin with; `payload.frame` is where every object sits."""


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
    return [Path(tempfile.gettempdir()) / "proprio_recordings", Path("/dev/shm/proprio_recordings")]


def prepare_identification() -> None:
    """Compile and load all kernels that a weighing or a calibration may need, so that none is compiled in a probe."""
    compile_kernels()


def prepare_container(options: ReplayOptions) -> None:
    """The same for the container that the settings describe: some 15 s once on a computer, under a second later.

    Raises:
        ConfigurationError, RobotError, SimulationError: In one line, what is wrong with the options.
    """
    _, facts = container_setting(options)
    integrator = str(options.settings.get("solver.integrator", ContainerOptions.integrator))
    compile_sphere_kernels(facts.enclosure.shape, facts.law, integrator)


def settings_for(probe: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What concerns a probe; what is stated about another probe's object is left out."""
    foreign = tuple(start for other, starts in _FACTS.items() if other != probe for start in starts)
    return {key: value for key, value in settings.items() if key == "payload.frame" or not key.startswith(foreign)}


def check_settings(options: ReplayOptions) -> None:
    """Look at settings that may be about a payload, a container, a block, or several of them.

    Raises:
        ConfigurationError, RobotError: In one line, what is wrong with them.
    """

    def read(settings: Settings) -> None:
        _payload(settings)
        _recorded_container(settings)
        # finite elements take a second to import, which a node that starts beside a driver should not spend on nothing
        if any(key.startswith(_FACTS["softness"]) for key in options.settings):
            _block(settings)

    _setting(options, read)


def container_setting(options: ReplayOptions) -> tuple[Robot, ContainerFacts]:
    """The robot and the container as the options have them.

    Raises:
        ConfigurationError, RobotError: In one line, what is wrong with them.
    """
    return _setting(options, _recorded_container)


def _setting(options: ReplayOptions, read: Callable[[Settings], _Facts]) -> tuple[Robot, _Facts]:
    """The robot, and what `read` takes from the settings; whatever then is left is refused."""
    settings = Settings(options.settings)
    robot = configured_robot(options.robot, options.calibration, settings)
    held_positions(robot, settings)
    settings.take_prefix("solver.")
    facts = read(settings)
    settings.refuse_rest()
    return robot, facts


def _payload(settings: Settings) -> PayloadFacts:
    return payload_facts(settings, probe_file("payload")["payload"])


def _block(settings: Settings) -> BlockFacts:
    return block_facts(settings, probe_file("softness")["block"])


def _recorded_container(settings: Settings) -> ContainerFacts:
    if settings.take("sphere.camera", None) is not None:
        raise ConfigurationError(
            "sphere.camera: the identifier records no camera; record its topic beside it and give both to `proprio replay`"
        )
    return container_facts(settings, probe_file("container"))


def block_setting(options: ReplayOptions) -> tuple[Robot, BlockFacts]:
    """The robot and the block as the options have them.

    Raises:
        ConfigurationError, RobotError: In one line, what is wrong with them.
    """
    return _setting(options, _block)


def prepare_squeeze(options: ReplayOptions) -> None:
    """Kernels and the table of the block's response, so that neither is made in a probe: half a minute for a shape of block whose
    faces stick, the first time.

    Raises:
        ConfigurationError, RobotError, SimulationError: In one line, what is wrong with the options.
    """
    # finite elements bring half of SciPy along, which the other probes need not wait for
    from proprio_ros.identification.squeeze import SqueezeOptions
    from proprio_ros.sim.squeeze import compile_kernels as compile_squeeze_kernels

    _, facts = block_setting(options)
    integrator = str(options.settings.get("solver.integrator", SqueezeOptions.integrator))
    compile_squeeze_kernels(facts.table(), integrator)


def largest_squeeze(robot: Robot, joint: str, travel_m: float, facts: BlockFacts) -> float:
    """How far a block is squeezed, relative to its length, when a finger that touches it goes on by `travel_m`.

    Args:
        robot: Whose `joint` slides the finger.
        joint: Of the probe.
        travel_m: As positions are published.
        facts: Of the block.
    """
    drive = robot.drive_trains[joint]
    measured = drive.finger_travel
    steepest = 1.0 if measured is None else float(measured.ratio_at(measured.at_rad).max()) / drive.transmission
    return facts.fingers * steepest * travel_m / facts.length


def block_rotation(robot: Robot, joint: str) -> np.ndarray:
    """How a block lies between the fingers: its x along the joint's axis; in the payload's frame, shape (3, 3)."""
    pose = dict.fromkeys(robot.model.independent_joints, 0.0)
    moved = robot.model.joint(joint)
    hand = robot.model.frame_transform(robot.payload_frame, pose)[:3, :3]
    carrier = robot.model.frame_transform(moved.parent, pose)[:3, :3] @ moved.origin[:3, :3]
    along = hand.T @ carrier @ moved.axis
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    return np.stack([along, across, np.cross(along, across)], axis=1)


def empty_container_options(options: ReplayOptions, facts: ContainerFacts) -> ReplayOptions:
    """How the empty container is weighed: as a payload of its shape at its place.

    Args:
        options: Of the probe `container`.
        facts: What they say about it.
    """
    left_out = (*_FACTS["container"], "solver.")
    settings = {key: value for key, value in options.settings.items() if not key.startswith(left_out)}
    shell = facts.shell
    per_mass = rotational_inertia(shell.shape.second_moment_per_mass)
    settings |= {
        "payload.com": shell.com.tolist(),
        "payload.inertia_per_mass": [
            float(per_mass[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        ],
    }
    return replace(options, probe="payload", settings=settings, baseline=())


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


class LiveWeighing:
    """An estimate from what has come so far; its interval shrinks as the probe goes on.

    `add_state` and `add_input` may be called from another thread than `estimate`.

    Args:
        options: As for the bag that will be identified afterwards.

    Raises:
        ConfigurationError, RobotError: In one line, what is wrong with the options.
    """

    def __init__(self, options: ReplayOptions) -> None:
        self.robot, self.facts = _setting(options, _payload)
        self._weighing = replace(WeighingOptions(), starts_kg=LIVE_STARTS_KG)
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
            drives = self.robot.drive_trains
            constants = np.array([drives[n].nominal_effort_per_current if n in drives else 1.0 for n in names])
            current = np.array([row[1] for row in inputs]).reshape(-1, len(names)) / constants
            source = InputRecord(np.array([row[0] for row in inputs]), names, current, "/applied_effort")
            runs = cut_runs(Recording("live", record, source), joints=list(drives))
            return weigh(self.robot, runs, self.facts, self._weighing)
        except ProprioError:
            return None  # not enough yet; what is wrong for good is told by the identification of the bag


def live_interval(estimate: Estimate) -> tuple[float, float] | None:
    """Mass and standard deviation as far as the run has come, also where a verdict would still withhold them [kg]."""
    for row in estimate.unknowns:
        if row.kind == "payload_mass" and np.isfinite(row.std):
            return float(row.value), float(row.std)
    return None


def as_diagnostics(estimate: Estimate) -> dict[str, Any]:
    """What a message about an estimate tells, key by key."""
    told: dict[str, Any] = {"probe": estimate.probe, "verdict": estimate.verdict.value, "robot": estimate.robot}
    for value in estimate.values:
        told[value.name] = "not told" if value.value is None else value.value
        told[f"{value.name}.unit"] = value.unit
        if value.std is not None:
            told[f"{value.name}.std"] = value.std
        if value.ci95 is not None:
            told[f"{value.name}.ci95"] = list(value.ci95)
    return told


def inertia_tensor(facts: PayloadFacts, mass_kg: float) -> np.ndarray:
    """Inertia about the payload's centre of mass [kg m^2], shape (3, 3); NaN where its shape was not stated, since one joint's
    motion does not tell it."""
    if facts.shape_std_relative > 0.0:
        return np.full((3, 3), np.nan)
    return mass_kg * rotational_inertia(facts.shape.second_moment_per_mass)


def rotational_inertia(second_moment: np.ndarray) -> np.ndarray:
    """From the integral of r r^T dm to that of r^2 - r r^T, shape (3, 3)."""
    tensor: np.ndarray = np.trace(second_moment) * np.eye(3) - second_moment
    return tensor
