"""From bags on disk to an estimate: the one function that the command line, a script and the identifier node share."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from proprio_ros.bags import (
    TextRecording,
    is_text_recording,
    read_point_file,
    read_points,
    read_recording,
    read_text_recording,
)
from proprio_ros.errors import ConfigurationError, RobotError, SimulationError
from proprio_ros.identification.container import ContainerOptions, find_sphere
from proprio_ros.identification.container_problem import ContainerFacts, SphereTrack
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.paper import FRAME_S, PaperOptions, weigh_as_paper
from proprio_ros.identification.weighing import WeighingOptions, weigh
from proprio_ros.quantity import Quantity
from proprio_ros.records import Run
from proprio_ros.resources import resource
from proprio_ros.robot import Robot, load_robot, rotation_from_rpy
from proprio_ros.runs import cut_runs
from proprio_ros.sim.payload import PayloadFacts, PayloadShape
from proprio_ros.sim.sphere import LAWS, Enclosure

if TYPE_CHECKING:
    from proprio_ros.identification.squeeze_problem import BlockFacts
    from proprio_ros.sim.response import Response

PROBES = ("payload", "container", "softness")
PROFILES = ("default", "paper")
DEFAULT_ROBOT = "open_manipulator_x"
TEXT_ROBOT = "open_manipulator_x_as_published"
"""Robot of a text recording that names none: the description that the paper's public example simulates."""

PAPER_PROBE_FRAMES = 36
"""The paper's elbow probe lasts 0.6 s: 36 frames. Its recording goes on for longer, without saying what the motor did then."""

_Options = TypeVar("_Options")
_SECTIONS = {
    "payload": {"payload", "solver", "paper"},
    "container": {"container", "sphere", "contact", "solver"},
    "softness": {"block", "solver"},
}


@dataclass(frozen=True)
class ReplayOptions:
    """Everything that ``proprio replay`` can be told; see its ``--help``.

    Attributes:
        settings: dotted keys of the probe file, ``held.JOINT``, and ``robot.`` keys of the robot file, with plain values.
        calibration: what ``proprio calibrate`` wrote.
        baseline: recordings of the same robot made with the others: with nothing in the hand, or for the probe `container` with the
            empty container.
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
    identify = {"payload": _payload, "container": _container, "softness": _softness}[options.probe](options, settings)

    loaded = time.perf_counter()
    runs: list[Run] = []
    sources: list[Path] = []  # of each run
    baseline = [run for path in options.baseline for run in bag_runs(Path(path), robot, options, held)]
    text: TextRecording | None = None
    for path in paths:
        if Path(path) in texts:
            text = read_text_recording(path)
            robot = _text_robot(robot, text)
            runs.append(_text_run(robot, text, held))
        else:
            runs.extend(bag_runs(Path(path), robot, options, held))
        sources.extend([Path(path)] * (len(runs) - len(sources)))
    settings.refuse_rest()
    read = time.perf_counter()
    estimate = identify(robot, _Recorded(runs, baseline, text, sources))
    solved = time.perf_counter()
    timing = {"load": loaded - started, "read": read - loaded, "solve": solved - read}
    return replace(estimate, timing_s=timing)


@dataclass(frozen=True)
class _Recorded:
    """What was read.

    Attributes:
        runs, baseline: of the object, and made with them without it.
        text: the text recording among them.
        sources: where each run comes from.
    """

    runs: Sequence[Run]
    baseline: Sequence[Run]
    text: TextRecording | None
    sources: Sequence[Path]


_Identify = Callable[[Robot, _Recorded], Estimate]


def _payload(options: ReplayOptions, settings: Settings) -> _Identify:
    probe = probe_file("payload")
    facts = payload_facts(settings, probe["payload"])
    weighing = replace(_options(WeighingOptions, settings, "solver.", probe["solver"]), solver=options.solver)
    paper = _options(PaperOptions, settings, "paper.", probe["paper"])

    def identify(robot: Robot, recorded: _Recorded) -> Estimate:
        if options.profile == "paper":
            stated = paper if recorded.text is None else _text_paper(paper, recorded.text, settings)
            return weigh_as_paper(robot, recorded.runs, facts, stated)
        return weigh(robot, recorded.runs, facts, weighing, recorded.baseline)

    return identify


def _refuse_payloads_own(options: ReplayOptions) -> None:
    for given, default, flag in ((options.solver, "lm", "--solver"), (options.profile, "default", "--profile")):
        if given != default:
            raise ConfigurationError(f"{flag} {given} is only there for --probe payload; leave it out")


def _softness(options: ReplayOptions, settings: Settings) -> _Identify:
    # finite elements bring half of SciPy along, which the other probes need not wait for
    from proprio_ros.identification.squeeze import SqueezeOptions, find_softness

    _refuse_payloads_own(options)
    probe = probe_file("softness")
    facts = block_facts(settings, probe["block"])
    solving = _options(SqueezeOptions, settings, "solver.", probe["solver"])

    def identify(robot: Robot, recorded: _Recorded) -> Estimate:
        return find_softness(robot, recorded.runs, facts, solving, recorded.baseline)

    return identify


def _container(options: ReplayOptions, settings: Settings) -> _Identify:
    _refuse_payloads_own(options)
    probe = probe_file("container")
    facts = container_facts(settings, probe)
    solving = _options(ContainerOptions, settings, "solver.", probe["solver"])
    camera = settings.take("sphere.camera", probe["sphere"].get("camera"))
    if camera is not None and not isinstance(camera, str):
        raise ConfigurationError(f"sphere.camera={camera!r} must be a topic (with a slash in front) or a CSV file")
    camera_std = _not_negative(
        "sphere.camera_std", settings.take("sphere.camera_std", probe["sphere"].get("camera_std"))
    )
    if camera_std == 0.0:
        raise ConfigurationError("sphere.camera_std must be above 0 m")

    def identify(robot: Robot, recorded: _Recorded) -> Estimate:
        sources = zip(recorded.runs, recorded.sources, strict=True)
        tracks = [_track(run, source, camera, camera_std) for run, source in sources]
        return find_sphere(robot, recorded.runs, facts, solving, recorded.baseline, tracks)

    return identify


def _track(run: Run, source: Path, camera: str | None, std: float) -> SphereTrack | None:
    """What the camera saw during a run; a name that starts with a slash is a topic, unless there is such a file."""
    if camera is None:
        return None
    topic = camera.startswith("/") and not Path(camera).is_file()
    track = read_points(source, camera) if topic else read_point_file(camera)
    times_s, position = track.of_run(run)
    if not len(times_s):
        raise ConfigurationError(
            f"sphere.camera={camera}: saw nothing while {run.name} was recorded: its stamps must be on the clock of the joint "
            "states"
        )
    return SphereTrack(times_s, position, std)


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


def container_facts(settings: Settings, defaults: Mapping[str, Any]) -> ContainerFacts:
    """Size and place of the container and the sphere, the user's words before the probe file's.

    Args:
        defaults: the sections ``container``, ``sphere`` and ``contact`` of the probe file.

    Raises:
        ConfigurationError: a value of the wrong form or unit, or a sphere that does not fit.
    """

    def take(key: str) -> Any:
        section, name = key.split(".")
        return settings.take(key, defaults[section].get(name))

    shape = take("container.shape")
    size = take("container.inner_size")
    if shape == "cylinder" and isinstance(size, list) and len(size) == 2:
        size = [size[0], size[0], size[1]]
    elif shape == "sphere" and isinstance(size, (int, float)):
        size = [size, size, size]
    inner_size = _vector("container.inner_size", size)
    alike = {"cylinder": 2, "sphere": 3}.get(str(shape), 1)
    if np.ptp(inner_size[:alike]) > 0.0:
        form = "[diameter, length]" if shape == "cylinder" else "one diameter"
        raise ConfigurationError(f"container.inner_size={size!r} does not fit a {shape}: give {form} in m")
    radius = _number("sphere.radius", take("sphere.radius"))
    if np.any(inner_size <= 0.0) or radius <= 0.0:
        raise ConfigurationError("container.inner_size and sphere.radius must be positive lengths in m")
    if np.any(inner_size > 1.0):
        raise ConfigurationError(
            f"container.inner_size={inner_size.tolist()} is over 1 m: lengths are in m, so 60 mm is 0.06"
        )
    centre = _vector("container.centre", take("container.centre"))
    if np.any(np.abs(centre) > 1.0):
        raise ConfigurationError(f"container.centre={centre.tolist()} is over 1 m away from the hand: lengths are in m")
    mass = take("container.mass")
    mass_std = _not_negative("container.mass_std", take("container.mass_std"))
    if mass is not None and _not_negative("container.mass", mass) > 10.0:
        raise ConfigurationError(f"container.mass={mass:g} is too heavy for a hand: masses are in kg")
    start = take("sphere.start")
    settled, hollow = (_yes_or_no(key, take(key)) for key in ("sphere.settled", "sphere.hollow"))
    start_std = _not_negative("sphere.start_std", take("sphere.start_std"))
    contact = {
        key: take(f"contact.{key}") for key in ("damping_ratio", "damping_ratio_std", "friction", "friction_std")
    }
    spread = {key: _not_negative(f"contact.{key}", value) for key, value in contact.items()}
    frequency = _number("contact.frequency", take("contact.frequency"))
    traction = _number("contact.traction", take("contact.traction"))
    if not 50.0 <= frequency <= 5000.0 or not 10.0 <= traction <= 5000.0:
        raise ConfigurationError(
            f"contact.frequency={frequency:g} rad/s and contact.traction={traction:g} 1/s must lie between 50 and 5000, 10 and 5000"
        )
    constants = [_not_negative(f"contact.{key}", take(f"contact.{key}")) for key in ("k_e", "k_d", "k_f")]
    if constants[0] == 0.0:
        raise ConfigurationError("contact.k_e must be above 0 N/m")
    law = take("contact.law")
    if law not in LAWS:
        raise ConfigurationError(f"contact.law={law!r} is unknown: choose one of {', '.join(LAWS)}")
    try:
        enclosure = Enclosure(str(shape), inner_size, radius, 2.0 / 3.0 if hollow else 0.4)
    except SimulationError as error:
        raise ConfigurationError(f"{error}: check container.inner_size and sphere.radius") from error
    place = None if start is None else _vector("sphere.start", start)
    if place is not None and np.any(np.abs(place) > enclosure.room + 1e-3):
        raise ConfigurationError(
            f"sphere.start={place.tolist()} is outside the container: the sphere's centre can only go "
            f"{(1e3 * enclosure.room).tolist()} mm from the middle"
        )
    return ContainerFacts(
        enclosure,
        centre,
        rotation_from_rpy(_vector("container.rpy", take("container.rpy"))),
        0.03 if mass is None else float(mass),
        np.inf if mass is None else mass_std,
        settled,
        place,
        start_std,
        frequency,
        Quantity(spread["damping_ratio"], spread["damping_ratio_std"]),
        Quantity(spread["friction"], spread["friction_std"]),
        traction,
        law,
        *constants,
    )


def block_facts(settings: Settings, defaults: Mapping[str, Any]) -> BlockFacts:
    """Size of the soft block and how it is held, the user's words before the probe file's.

    Args:
        defaults: the section ``block`` of the probe file.

    Raises:
        ConfigurationError: a value of the wrong form or unit.
    """
    from proprio_ros.identification.squeeze_problem import HIGHEST_RATIO, BlockFacts
    from proprio_ros.sim.energies import LAWS as LAWS_OF_ELASTICITY
    from proprio_ros.sim.mesh import read_mesh
    from proprio_ros.sim.quasistatic import CONTACTS

    def take(name: str) -> Any:
        return settings.take(f"block.{name}", defaults.get(name))

    path, scale = take("mesh"), _number("block.mesh_scale", take("mesh_scale"))
    if path is not None and not isinstance(path, str):
        raise ConfigurationError(f"block.mesh={path!r} must be the name of a file with tetrahedra")
    if scale <= 0.0:
        raise ConfigurationError(
            f"block.mesh_scale={scale:g} must be above 0: metres per unit of the mesh, 0.001 for mm"
        )
    mesh = None if path is None else read_mesh(Path(path).expanduser(), scale)
    size = take("size")
    if mesh is not None:
        size = mesh.size.tolist()
        if max(size) > 0.5:
            raise ConfigurationError(
                f"block.mesh={path}: is {max(size):g} m long; if it is in mm, state block.mesh_scale=0.001"
            )
    size = _vector("block.size", [size] * 3 if isinstance(size, (int, float)) and not isinstance(size, bool) else size)
    if np.any(size <= 0.0) or np.any(size > 0.5):
        raise ConfigurationError(f"block.size={size.tolist()} must be lengths in m above 0, so 30 mm is 0.03")
    law, contact = take("law"), take("contact")
    for key, given, choices in (("law", law, LAWS_OF_ELASTICITY), ("contact", contact, CONTACTS)):
        if given not in choices:
            raise ConfigurationError(f"block.{key}={given!r} is unknown: choose one of {', '.join(choices)}")
    fingers = _number("block.fingers", take("fingers"))
    if fingers not in (1.0, 2.0):
        raise ConfigurationError(f"block.fingers={fingers:g}: one finger moves, or two")
    take("mass")  # a block's weight changes its squeeze by less than a thousandth; told or not, it is not used
    ratio = Quantity(_not_negative("block.poissons_ratio", take("poissons_ratio")), _std(take, "poissons_ratio_std"))
    if ratio.value > HIGHEST_RATIO:
        raise ConfigurationError(f"block.poissons_ratio={ratio.value:g} must lie between 0 and {HIGHEST_RATIO}")
    return BlockFacts(
        size,
        law,
        contact,
        int(fingers),
        Quantity(_number("block.gap", take("gap")), _std(take, "gap_std")),
        ratio,
        Quantity(_not_negative("block.relaxation_s", take("relaxation_s")), _std(take, "relaxation_std_s")),
        mesh,
    )


def rebuild_table(options: ReplayOptions) -> tuple[BlockFacts, Response, Path]:
    """Compute a block's response anew, whatever the cache has.

    Args:
        options: whose settings describe the block.

    Returns:
        The block, its table, and where that is kept.

    Raises:
        ConfigurationError, SimulationError: in one line, what is wrong with the block.
    """
    from proprio_ros.sim.response import kept_at

    settings = Settings(options.settings)
    facts = block_facts(settings, probe_file("softness")["block"])
    settings.refuse_rest()
    table = facts.table(rebuild=True)
    return facts, table, kept_at(table.made_of)


def _std(take: Callable[[str], Any], name: str) -> float:
    return _not_negative(f"block.{name}", take(name))


def probe_file(probe: str) -> dict[str, Any]:
    path = resource("probes", probe)
    try:
        content = YAML(typ="safe", pure=True).load(path)
    except (OSError, YAMLError) as error:
        raise ConfigurationError(f"{path}: not readable as YAML ({str(error).splitlines()[0]})") from error
    needed = _SECTIONS[probe]
    if not isinstance(content, dict) or not all(isinstance(content.get(section), dict) for section in needed):
        raise ConfigurationError(f"{path}: needs the sections {', '.join(sorted(needed))}")
    return content


def _options(kind: Callable[..., _Options], settings: Settings, prefix: str, defaults: Mapping[str, Any]) -> _Options:
    values: dict[str, Any] = {}
    for entry in fields(kind):  # type: ignore[arg-type]
        if entry.name == "solver":
            continue
        value = settings.take(prefix + entry.name, defaults.get(entry.name, entry.default))
        if entry.name in ("starts_kg", "starts_Pa"):
            value = tuple(_numbers(prefix + entry.name, value))
            if not value or min(value) <= 0.0:
                what = "mass in kg" if entry.name == "starts_kg" else "modulus in Pa"
                raise ConfigurationError(f"{prefix}{entry.name} needs at least one positive {what}")
        elif entry.name not in ("integrator", "signals") and value is not None:
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


def _not_negative(key: str, value: Any) -> float:
    number = _number(key, value)
    if number < 0.0:
        raise ConfigurationError(f"{key}={value!r} must not be negative")
    return number


def _yes_or_no(key: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ConfigurationError(f"{key}={value!r} must be true or false")
    return value


def _numbers(key: str, value: Any) -> list[float]:
    if not isinstance(value, (list, tuple)):
        raise ConfigurationError(f"{key}={value!r} must be a list of numbers")
    return [_number(key, entry) for entry in value]


def _vector(key: str, value: Any) -> np.ndarray:
    numbers = _numbers(key, value)
    if len(numbers) != 3:
        raise ConfigurationError(f"{key}={value!r} must be [x, y, z] in m")
    return np.array(numbers)
