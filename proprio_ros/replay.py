"""From bags on disk to an estimate: the one function that the command line, a script and the identifier node share."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from proprio_ros.bags import TextRecording, is_text_recording, read_recording, read_text_recording
from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.paper import FRAME_S, PaperOptions, weigh_as_paper
from proprio_ros.identification.weighing import WeighingOptions, weigh
from proprio_ros.records import Run
from proprio_ros.resources import resource
from proprio_ros.robot import Robot, load_robot
from proprio_ros.runs import cut_runs
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

PROBES = ("payload",)
PROFILES = ("default", "paper")
DEFAULT_ROBOT = "open_manipulator_x"
TEXT_ROBOT = "open_manipulator_x_as_published"
"""Robot of a text recording that names none: the description that the paper's public example simulates."""

PAPER_PROBE_FRAMES = 36
"""The paper's elbow probe lasts 0.6 s: 36 frames. Its recording goes on for longer, without saying what the motor did then."""

_Options = TypeVar("_Options", WeighingOptions, PaperOptions)


@dataclass(frozen=True)
class ReplayOptions:
    """Everything that ``proprio replay`` can be told; see its ``--help``.

    Attributes:
        settings: dotted keys of the probe file, ``held.JOINT``, and ``robot.`` keys of the robot file, with plain values.
        calibration: what ``proprio calibrate`` wrote.
        baseline: recordings of the same robot with nothing in the hand, made with the others.
    """

    probe: str = "payload"
    robot: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    solver: str = "lm"
    profile: str = "default"
    calibration: str | Path | None = None
    baseline: Sequence[str | Path] = ()
    state_topic: str | None = None
    command_topic: str | None = None
    effort_unit: str | None = None


def replay(paths: Sequence[str | Path], options: ReplayOptions | None = None) -> Estimate:
    """Identify what the probe names from one or more recordings of the same object.

    Args:
        paths: bags (folders or files, either storage) or text recordings; all runs in all of them give one estimate.
        options: probe, robot and settings.

    Raises:
        ConfigurationError, RobotError, RecordingError: with one line that says what is wrong and what to do.
    """
    options = options or ReplayOptions()
    started = time.perf_counter()
    if options.probe not in PROBES:
        raise ConfigurationError(f"probe {options.probe!r} is not available; choose one of: {', '.join(PROBES)}")
    if options.profile not in PROFILES:
        raise ConfigurationError(f"profile {options.profile!r} is unknown; choose one of: {', '.join(PROFILES)}")
    if not paths:
        raise ConfigurationError("no recording given: name at least one bag")
    settings = Settings(options.settings)
    texts = [Path(path) for path in paths if is_text_recording(path)]
    robot_name = options.robot or (TEXT_ROBOT if len(texts) == len(paths) else None)
    robot = configured_robot(robot_name, options.calibration, settings)
    held = held_positions(robot, settings)
    probe = probe_file(options.probe)
    facts = payload_facts(settings, probe["payload"])
    weighing = replace(_options(WeighingOptions, settings, "solver.", probe["solver"]), solver=options.solver)
    paper = _options(PaperOptions, settings, "paper.", probe["paper"])

    loaded = time.perf_counter()
    runs: list[Run] = []
    baseline = [run for path in options.baseline for run in bag_runs(Path(path), robot, options, held)]
    for path in paths:
        if Path(path) in texts:
            text = read_text_recording(path)
            robot = _text_robot(robot, text)
            runs.append(_text_run(robot, text, held))
            paper = _text_paper(paper, text, settings)
        else:
            runs.extend(bag_runs(Path(path), robot, options, held))
    settings.refuse_rest()
    read = time.perf_counter()
    if options.profile == "paper":
        estimate = weigh_as_paper(robot, runs, facts, paper)
    else:
        estimate = weigh(robot, runs, facts, weighing, baseline)
    solved = time.perf_counter()
    timing = {"load": loaded - started, "read": read - loaded, "solve": solved - read}
    return replace(estimate, timing_s=timing)


def robot_of(name: str | None, calibration: str | Path | None) -> Robot:
    """The robot of a name or file, with its calibration where there is one.

    Raises:
        RobotError: either cannot be read, or the calibration is of another robot.
    """
    if calibration is None:
        return load_robot(name or DEFAULT_ROBOT)
    if Path(calibration).suffix not in (".yaml", ".yml"):
        raise RobotError(
            f"--calibration {calibration}: expected the .yaml file that `proprio calibrate --output` wrote"
        )
    robot = load_robot(calibration)
    if robot.calibration is None:
        raise RobotError(
            f"--calibration {calibration}: holds no calibration; write it with `proprio calibrate --output`"
        )
    if name is not None:
        asked = load_robot(name)
        if asked.model.fingerprint() != robot.model.fingerprint():
            raise RobotError(
                f"--calibration {calibration} is of {robot.name}, whose URDF is not that of --robot {name}: calibrate that robot"
            )
    return robot


def configured_robot(name: str | None, calibration: str | Path | None, settings: Settings) -> Robot:
    """The robot as the user's ``robot.`` settings and ``payload.frame`` have it.

    Raises:
        ConfigurationError, RobotError: a setting does not fit it, or as for `robot_of`.
    """
    overrides = settings.take_prefix("robot.")
    robot = robot_of(name, calibration)
    if overrides:
        robot = robot.with_overrides(overrides)
    frame = settings.take("payload.frame", None)
    if frame is not None:
        links = [link.name for link in robot.model.links]
        if frame not in links:
            raise ConfigurationError(f"payload.frame={frame!r} is no link of {robot.name}; it has: {', '.join(links)}")
        robot = replace(robot, payload_frame=str(frame))
    return robot


def held_positions(robot: Robot, settings: Settings) -> dict[str, float]:
    """The user's ``held.JOINT`` settings."""
    held = {name: _number(f"held.{name}", value) for name, value in settings.take_prefix("held.").items()}
    for name in held:
        robot.model.joint(name)
    return held


def bag_runs(path: Path, robot: Robot, options: ReplayOptions, held: Mapping[str, float]) -> tuple[Run, ...]:
    """The runs of one bag, named after it."""
    joints = list(robot.drive_trains)
    recording = read_recording(
        path,
        state_topic=options.state_topic,
        command_topic=options.command_topic,
        effort_unit=options.effort_unit,
        nominal_torque_constants={n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()},
        joint_order=joints,
    )
    # a bag's folder is often called after its storage, so the folder above tells which one it is
    name = "/".join(path.resolve().parts[-2:])
    runs = cut_runs(replace(recording, name=name), held=held, joints=joints)
    return tuple(replace(run, notes=(*recording.notes, *run.notes)) for run in runs)


def _text_robot(robot: Robot, text: TextRecording) -> Robot:
    """The robot with what the recording's own setting states: armature, and the torque that the current stands for."""
    prefix = f"joints.{text.joint}.drive_train."
    changes: dict[str, Any] = {}
    current = _text_current(text)
    nominal = abs(float(text.setting["torque_N_m"]) / current)
    if text.joint in robot.drive_trains:
        changes[f"{prefix}torque_constant_N_m_per_A"] = {
            "value": nominal, "std": robot.drive_trains[text.joint].torque_constant.std,
        }  # fmt: skip
        if "armature_kg_m2" in text.setting:
            changes[f"{prefix}armature_kg_m2"] = {
                "value": float(text.setting["armature_kg_m2"]), "std": robot.drive_trains[text.joint].armature.std,
            }  # fmt: skip
    robot = robot.with_overrides(changes)
    if "gravity_m_s2" in text.setting:
        robot = replace(robot, gravity=np.array([0.0, 0.0, -float(text.setting["gravity_m_s2"])]))
    return robot


def _text_current(text: TextRecording) -> float:
    """Current whose sign is the torque's [A]."""
    stated = float(text.setting.get("current_A_by_the_paper", 0.0)) or 1.0
    return float(np.copysign(stated, float(text.setting["torque_N_m"])))


def _text_run(robot: Robot, text: TextRecording, held: Mapping[str, float]) -> Run:
    pose = {name: float(value) for name, value in text.setting["start_pose_rad"].items()}
    start = pose.pop(text.joint)
    gripper = {name: 0.0 for name in robot.model.independent_joints if name != text.joint and name not in pose}
    others = {**gripper, **pose, **held}
    used = text.times_s <= PAPER_PROBE_FRAMES * FRAME_S + 1e-6
    return Run(
        name=text.name,
        joint=text.joint,
        onset_ns=0,
        times_s=text.times_s[used],
        position=start + text.relative_position[used],
        before_times_s=np.zeros(0),
        before_position=np.zeros(0),
        held=others,
        held_span=dict.fromkeys(others, 0.0),
        input_times_s=np.zeros(1),
        input_current_A=np.array([_text_current(text)]),
        duration_s=float(text.times_s[used][-1]),
        source="the torque in setting.json",
        notes=(
            *(f"{name} is not in the recording and was taken as 0" for name in gripper),
            *(
                [f"{(~used).sum()} samples after the probe of {PAPER_PROBE_FRAMES} frames were left out"]
                * (not used.all())
            ),
        ),
    )


def _text_paper(paper: PaperOptions, text: TextRecording, settings: Settings) -> PaperOptions:
    """The setting in which the authors fitted this recording; what the user stated himself stays."""
    simulation = text.setting.get("simulation", {})
    stated = settings.taken
    changes: dict[str, Any] = {}
    if "substeps" in simulation and "paper.substeps" not in stated:
        changes["substeps"] = int(simulation["substeps"])
    fit = text.setting.get("fit", {})
    if "start_mass_kg" in fit and "paper.starts_kg" not in stated:
        # the starts of the paper's Table II below 1 kg, the recording's own first
        changes["starts_kg"] = tuple(sorted({float(fit["start_mass_kg"]), 0.001, 0.005, 0.095, 0.191}))
    if "optimizer" in fit and "paper.iterations" not in stated:
        changes["iterations"] = 15
    if "loss" in fit and "paper.loss_sample" not in stated:
        # the authors keep the states before each step, so the last one they compare lies one substep before
        # frame 36; it meets sample 35
        substeps = changes.get("substeps", paper.substeps)
        changes["loss_time_s"], changes["loss_sample"] = (
            (PAPER_PROBE_FRAMES - 1 / substeps) * FRAME_S,
            PAPER_PROBE_FRAMES - 1,
        )
    return replace(paper, **changes)


# --- settings ------------------------------------------------------------------------------------------------------


class Settings:
    """The user's ``--set`` keys, each taken once; what nobody took is an error that lists what there is."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._left = dict(given)
        self._known: list[str] = ["held.JOINT", "robot.KEY.OF.ROBOT.FILE"]
        self.taken: set[str] = set()

    def take(self, key: str, default: Any) -> Any:
        """The user's value, or the default."""
        self._known.append(key)
        if key in self._left:
            self.taken.add(key)
            return self._left.pop(key)
        return default

    def take_prefix(self, prefix: str) -> dict[str, Any]:
        """All keys under a prefix, without it."""
        found = {key: self._left.pop(key) for key in list(self._left) if key.startswith(prefix)}
        self.taken.update(found)
        return {key[len(prefix) :]: value for key, value in found.items()}

    def refuse_rest(self) -> None:
        """Raises: ConfigurationError: a key that nothing understands."""
        if self._left:
            raise ConfigurationError(
                f"--set {', '.join(sorted(self._left))}: unknown; valid keys: {', '.join(sorted(self._known))}"
            )


def payload_facts(settings: Settings, defaults: Mapping[str, Any]) -> PayloadFacts:
    """Shape and place of the payload, the user's words before the probe file's.

    Raises:
        ConfigurationError: a value of the wrong form, or a size that cannot be in metres.
    """
    com = _vector("payload.com", settings.take("payload.com", defaults["com"]))
    if np.any(np.abs(com) > 1.0):
        raise ConfigurationError(f"payload.com={com.tolist()} is over 1 m away from the hand: lengths are in m")
    com_std = _vector("payload.com_std", settings.take("payload.com_std", defaults["com_std"]))
    if np.any(com_std < 0.0):
        raise ConfigurationError("payload.com_std must not be negative")
    name = settings.take("payload.shape", None)
    size = settings.take("payload.size", None)
    per_mass = settings.take("payload.inertia_per_mass", None)
    doubt = _number(
        "payload.size_std_relative", settings.take("payload.size_std_relative", defaults["size_std_relative"])
    )
    if per_mass is not None:
        if name is not None or size is not None:
            raise ConfigurationError("give payload.inertia_per_mass, or payload.shape and payload.size, not both")
        return PayloadFacts(com, com_std, PayloadShape.from_inertia_per_mass(per_mass), 0.0)
    if name is None and size is not None:
        name = "sphere" if np.ndim(size) == 0 else "box"
    shape_name = str(name if name is not None else defaults["shape"])
    if size is None and shape_name != "point":
        # a shape without its size is a guess, and so is the probe file's ball
        edge = float(defaults["size"])
        guess: dict[str, Any] = {"sphere": edge, "cube": edge, "box": [edge] * 3, "cylinder": [edge, edge]}
        shape = PayloadShape.of(shape_name, guess.get(shape_name))
        return PayloadFacts(com, com_std, shape, doubt)
    return PayloadFacts(com, com_std, PayloadShape.of(shape_name, size), 0.0)


def probe_file(probe: str) -> dict[str, Any]:
    path = resource("probes", probe)
    try:
        content = YAML(typ="safe", pure=True).load(path)
    except (OSError, YAMLError) as error:
        raise ConfigurationError(f"{path}: not readable as YAML ({str(error).splitlines()[0]})") from error
    if not isinstance(content, dict) or not {"payload", "solver", "paper"} <= set(content):
        raise ConfigurationError(f"{path}: needs the sections payload, solver and paper")
    return content


def _options(kind: Callable[..., _Options], settings: Settings, prefix: str, defaults: Mapping[str, Any]) -> _Options:
    values: dict[str, Any] = {}
    for entry in fields(kind):  # type: ignore[arg-type]
        if entry.name == "solver":
            continue
        value = settings.take(prefix + entry.name, defaults.get(entry.name, entry.default))
        if entry.name == "starts_kg":
            value = tuple(_numbers(prefix + entry.name, value))
            if not value or min(value) <= 0.0:
                raise ConfigurationError(f"{prefix}{entry.name} needs at least one positive mass in kg")
        elif entry.name != "integrator" and value is not None:
            value = _number(prefix + entry.name, value)
            if isinstance(entry.default, int) or "int" in str(entry.type):
                if value != int(value):
                    raise ConfigurationError(f"{prefix}{entry.name}={value} must be a whole number")
                value = int(value)
        values[entry.name] = value
    return kind(**values)


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise ConfigurationError(f"{key}={value!r} must be a number")
    return float(value)


def _numbers(key: str, value: Any) -> list[float]:
    if not isinstance(value, (list, tuple)):
        raise ConfigurationError(f"{key}={value!r} must be a list of numbers")
    return [_number(key, entry) for entry in value]


def _vector(key: str, value: Any) -> np.ndarray:
    numbers = _numbers(key, value)
    if len(numbers) != 3:
        raise ConfigurationError(f"{key}={value!r} must be [x, y, z] in m")
    return np.array(numbers)
