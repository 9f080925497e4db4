"""Robot files: a robot with its drive trains as YAML states it, what a file extends, and what is overridden."""

from __future__ import annotations

import copy
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from proprio_ros.calibration_files.drift import AgeingRates
from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.calibration_files.one_joint import JointCalibration
from proprio_ros.calibration_files.pushes import TERMS, Calibration, check_complete
from proprio_ros.calibration_files.section import check_digest
from proprio_ros.errors import RobotError, one_line, some
from proprio_ros.inputs.forms import (
    REQUIRED,
    Field,
    FormError,
    Part,
    Text,
    mapping,
    refuse_unknown,
    section,
    shortly,
    under,
)
from proprio_ros.inputs.reading import LONGEST_PATH, path_problem, text_of, yaml_of
from proprio_ros.inputs.resources import resource, resource_names
from proprio_ros.inputs.signs import Signs
from proprio_ros.quantity import Quantity
from proprio_ros.robot.default_priors import RECORDED_TORQUE, DefaultPrior, largest_torque
from proprio_ros.robot.description import (
    PACKAGE,
    check_masses,
    is_bag,
    is_description,
    read_model,
)
from proprio_ros.robot.drive_train import DriveTrain, FingerTravel, Motor
from proprio_ros.robot.fields import (
    CALIBRATIONS,
    DRIVE_TRAIN,
    ELSEWHERE,
    JOINT,
    MOTOR,
    NOMINAL,
    ROBOT,
    merged,
    nested_settings,
    override_paths,
    unknown_of,
    without_unit,
)
from proprio_ros.robot.geometry import FloatArray, frozen
from proprio_ros.robot.hands import arm_joints, hand_link, hands, path_to, tip_of
from proprio_ros.robot.links import Joint
from proprio_ros.robot.tree import RobotModel
from proprio_ros.whole_files import real_path


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot with its drive trains, as its YAML file states it."""

    name: str
    model: RobotModel
    # drive_trains, motors: by joint; joints without a motor, and those beside the arm, have none
    drive_trains: dict[str, DriveTrain]
    motors: dict[str, Motor]
    delay: Quantity  # from the stamp of a command to torque, less that of a position [s]
    arm_scale: Quantity  # all masses of the model times this
    stamp_jitter_s: float  # standard deviation of the stamps
    friction_velocity: float  # Coulomb's law is smoothed over this speed [rad/s]
    payload_frame: str  # link in which objects are held
    gravity: FloatArray  # in the base frame [m/s^2], shape (3,)
    # source, settings: the YAML file, and its content with everything it extends merged in; `with_overrides` builds on it
    source: Path
    settings: Mapping[str, Any] = field(default_factory=dict, repr=False)
    onset_jitter_s: float = 0.0  # standard deviation of the delay from run to run
    # standard deviation of a torque that is there in one run and not in the next, such as friction that is not the same
    # every time [N m]
    torque_disturbance: float = 0.0
    # standard deviation of the velocity at which a locked joint is when its excitation begins [rad/s]
    start_velocity: float = 0.01
    # standard deviation of friction from one free response to the next, relative
    friction_spread: float = 0.15
    # standard deviation of a joint's zero from one recording of the arm to the next [rad]
    zero_repeat: float = 0.0
    # what neighbouring samples of a free response share of the error of its simulation: standard deviation that one
    # sample must have so that independent ones weigh as much [rad]. Calibrations and free responses themselves show it
    swing_error: float = 0.0
    # link_mass_std, link_com_std, link_inertia_std: how far a single link lies off the URDF, beyond `arm_scale`:
    # relative mass, each coordinate of its centre of mass [m], relative inertia about it
    link_mass_std: float = 0.0
    link_com_std: float = 0.0
    link_inertia_std: float = 0.0
    residual_scale: float = 1.0  # residuals of a calibration over what encoder and stamps explain
    # what is known about this very arm, with all correlations; None when the file's numbers stand alone
    calibration: Calibration | None = None
    # what motions with an empty hand say about this very arm; it is for motions alone
    motion_calibration: MotionCalibration | None = None
    # what motions with known loads say about the only joint of this very robot
    joint_calibration: JointCalibration | None = None
    drift: AgeingRates = field(default_factory=AgeingRates)  # how fast a calibration ages
    # where joints stand that a recording lacks [rad or m]
    held: Mapping[str, float] = field(default_factory=dict)
    tip: str | None = None  # last link of the arm; None: every joint with a motor is of the arm
    effort_sign: Signs = field(default_factory=Signs)  # by what measured efforts are multiplied
    # of its drive trains, those of joints between the motors and the hand of whose motors nothing is known: they are followed by
    # their positions, and their efforts count for nothing
    only_read: tuple[str, ...] = ()

    def with_only_read(self, joints: Iterable[str]) -> Robot:
        """The same robot, of which these joints, too, are followed by their positions alone."""
        further = [joint for joint in joints if joint not in self.only_read]
        if not further:
            return self
        drives = {joint: _unknown_drive(self.model, joint) for joint in further}
        return replace(
            self,
            drive_trains={**self.drive_trains, **drives},
            only_read=(*self.only_read, *further),
        )

    def check_efforts_known(self) -> None:
        """Raises: RobotError: A joint is only read, and an estimate needs the effort of every joint of the calibration."""
        if self.only_read:
            raise RobotError(
                f"{self.source.name}: {some(self.only_read)} is only read, and the running estimate needs the effort of each joint "
                "that moves the hand: weigh recordings, or state its motor under joints and calibrate again"
            )

    def is_calibrated(self, joints: Iterable[str] | None = None) -> bool:
        """Whether the numbers come from this very arm, as its file says and as every calibration does.

        Of joints: whether a calibration has learnt the drive trains of all of these; a file that only says so has learnt none.
        """
        if joints is None:
            return self.calibration is not None or bool(self.settings.get("calibrated"))
        return self.calibration is not None and set(joints) <= set(self.calibration.joints)

    @property
    def friction_rises(self) -> bool:
        """Whether dry friction of any joint is, or may turn out to be, greater at rest."""
        return any(
            drive.stribeck.value > 0.0 or drive.stribeck.std > 0.0
            for drive in self.drive_trains.values()
        )

    def with_overrides(self, overrides: Mapping[str, Any]) -> Robot:
        """The same robot with some settings replaced, by dotted key such as ``joints.joint3.drive_train.coulomb_N_m``.

        A number replaces a quantity and is known exactly; ``{"std": 0.01}`` changes only what it names. Raises
        `RobotError`: A key is unknown or a value does not fit it.
        """
        settings = merged(
            copy.deepcopy(dict(self.settings)),
            nested_settings(self.model.independent_joints, overrides),
        )
        settings.pop("calibration", None)
        robot = _robot(settings, self.source, self.model)
        if self.calibration is None:
            return robot
        # what the user states stands beside the calibration and replaces its number
        paths = override_paths(self.model.independent_joints)
        stated = {unknown_of(paths[key]) for key in overrides}
        return robot.with_calibration(self.calibration.without(stated))

    def with_calibration(self, calibration: Calibration) -> Robot:
        """The same robot with the numbers of its calibration, and their correlations.

        Raises `RobotError`: The calibration is of a joint that the robot does not drive.
        """
        foreign = [joint for joint in calibration.joints if joint not in self.drive_trains]
        if foreign:
            raise RobotError(
                f"{self.source.name}: the calibration is of {', '.join(foreign)}, but {self.name} drives "
                f"{', '.join(self.drive_trains)}: calibrate this robot"
            )
        known = calibration.quantities
        drives = {}
        for joint, drive in self.drive_trains.items():
            terms: dict[str, Any] = {
                term: known.get((term, joint), getattr(drive, term)) for term in TERMS
            }
            drives[joint] = replace(drive, **terms)
        noise = (
            "torque_disturbance",
            "start_velocity",
            "swing_error",
            "residual_scale",
            "stamp_jitter_s",
        )
        changes: dict[str, Any] = {name: getattr(calibration, name) for name in noise}
        changes["arm_scale"] = known.get("arm_scale", self.arm_scale)
        changes["delay"] = known.get("delay", self.delay)
        changes |= {
            name: getattr(calibration, name) or getattr(self, name)
            for name in ("friction_spread", "onset_jitter_s")
        }
        return replace(self, drive_trains=drives, calibration=calibration, **changes)


_PATH = Text(longest=LONGEST_PATH)
_CONSTANT = "torque_constant_N_m_per_A"


def _read_settings(
    path: Path,
    below: tuple[Path, ...] = (),
    tip: Any = None,
    frame: Any = None,
) -> dict[str, Any]:
    """One YAML file with all that it extends merged in, and the path of its URDF made absolute.

    Args:
        path: Of the file, or of a description.
        below: Files that extend it.
        tip: Last link of the arm, where one is stated already.
        frame: Where objects are held, where that is stated already.
    """
    if path in below:
        raise RobotError(
            f"{path}: files extend each other in a circle: {' -> '.join(p.name for p in (*below, path))}"
        )
    if is_description(str(path)):
        return bare_settings(
            str(path), *(each if isinstance(each, str) else None for each in (tip, frame))
        )
    try:
        settings = dict(mapping(yaml_of(text_of(path, RobotError))))
        for key in ("urdf", "extends"):
            if key in settings and (key == "extends" or settings[key] is not None):
                with under(key):
                    _PATH.read(settings[key])
    except RobotError as error:
        raise RobotError(f"{error}; {_choices()}") from error
    except FormError as error:
        raise RobotError(f"{path.name}: {error}") from None
    except ValueError as error:
        raise RobotError(f"{path}: not YAML ({error})") from error
    if settings.get("urdf") is not None:
        settings["urdf"] = _urdf_source(settings["urdf"], path)
    if "extends" in settings:
        stated_tip = tip or settings.get("tip")
        below_it = _located(settings.pop("extends"), path.parent)
        stated_frame = frame or settings.get("payload_frame")
        base = _read_settings(below_it, (*below, path), stated_tip, stated_frame)
        if is_description(str(below_it)) and stated_tip is None:
            _without_guess(base, settings)
        settings = _extended(base, settings)
    return settings


def _without_guess(base: dict[str, Any], settings: Mapping[str, Any]) -> None:
    """Which joints are of the arm is guessed from a description alone; those that a file states count."""
    if "joints" in settings:
        base.pop("tip", None)


def _extended(base: dict[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """A file's settings over those that it extends; a newer calibration replaces an older one as a whole."""
    for kind in CALIBRATIONS:
        if kind in settings:
            base.pop(kind, None)
    return merged(base, settings)


def _urdf_source(text: str, source: Path) -> str:
    """Where the description lies that a robot file names: an absolute path, or a name of the package robot_descriptions."""
    if text.startswith(PACKAGE):
        return text
    beside = source.parent / text
    problem = path_problem(beside)
    if problem:
        raise RobotError(f"{source.name}: urdf: {one_line(text, 60)} {problem}")
    beside = real_path(beside)
    if beside.is_file() or (beside.is_dir() and is_bag(beside)):
        return str(beside)
    if text.removesuffix(".urdf") in resource_names("urdf"):
        return str(resource("urdf", text))
    raise RobotError(
        f"{source.name}: urdf: there is no {beside}; give a path relative to {source.parent}, or an absolute one"
    )


def _choices() -> str:
    return f"known robots: {', '.join(resource_names('robots'))}; or give the path of a .yaml file"


def _located(name_or_path: str, folder: Path) -> Path:
    """The YAML file that a name or a path (relative to a folder) means."""
    path = folder / name_or_path
    problem = path_problem(path) or (
        "" if path.name.isprintable() else "holds characters that are not printable"
    )
    if problem:
        raise RobotError(f"robot {one_line(name_or_path, 60)} {problem}; {_choices()}")
    if name_or_path.startswith(PACKAGE):
        return Path(name_or_path)
    if is_description(name_or_path) or path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise RobotError(
                f"there is no {'URDF' if is_description(name_or_path) else 'robot file'} {path}; {_choices()}"
            )
        return real_path(path)
    if name_or_path not in resource_names("robots"):
        raise RobotError(f"unknown robot {name_or_path!r}; {_choices()}")
    return resource("robots", name_or_path)


def bare_settings(source: str, tip: str | None = None, frame: str | None = None) -> dict[str, Any]:
    """What a description alone says: motors of its arm of which nothing is known, of slides only where they move the hand.

    Args:
        source: As in `read_model`.
        tip: Last link of the arm; None: of the only one.
        frame: Where objects are held; of several hands that one is meant.

    Raises `RobotError`: It is no physical tree, or has several hands.
    """
    model = read_model(source)
    check_masses(model, Path(source).name)
    tip = tip or _tip_for(model, frame)
    joints = model.independent_joints if tip is None else arm_joints(model, tip)
    frame = hand_link(model, tip)
    moving = path_to(model, frame)
    settings = {
        "name": model.name,
        "urdf": source,
        "payload_frame": frame,
        "joints": {
            name: {}
            for name in joints
            if (model.joint(name).kind != "prismatic" or name in moving)
            and name not in model.idle_joints
        },
    }
    return settings if tip is None else {**settings, "tip": tip}


def _tip_for(model: RobotModel, frame: str | None) -> str | None:
    """As `tip_of` says; of several hands the one where objects are held. Raises `RobotError`: None of them is stated."""
    try:
        return tip_of(model)
    except RobotError:
        if frame not in {link.name for link in model.links}:
            raise
        return frame


def _stated(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Without keys that are null: those are left out, as a new robot file leaves them."""

    def kept(value: Any, depth: int) -> Any:
        if not isinstance(value, Mapping) or depth == 0:
            return value
        stated = {key: inner for key, inner in value.items() if inner is not None}
        return {key: kept(inner, depth - 1) for key, inner in stated.items()}

    joints = settings.get("joints")
    result = {key: value for key, value in settings.items() if value is not None}
    if isinstance(joints, Mapping):
        result["joints"] = {
            name: {} if joint is None else kept(joint, 2) for name, joint in joints.items()
        }
    return result


def _part(settings: Any, key: str) -> Mapping[str, Any]:
    part = settings.get(key) if isinstance(settings, Mapping) else None
    return part if isinstance(part, Mapping) else {}


def _check_stated(
    settings: Mapping[str, Any],
    source: Path,
    model: RobotModel,
) -> None:
    """Raises: FormError: Keys are mistyped, which comes first, or missing; it names all at once."""
    refuse_unknown(settings, ROBOT | ELSEWHERE)
    for name, joint in _part(settings, "joints").items():
        if not isinstance(name, str):
            raise FormError(
                f"joints: {shortly(name)} is no text; put a name that looks like a number in quotes"
            )
        for key, fields in (("motor", MOTOR), ("drive_train", DRIVE_TRAIN)):
            with under("joints", name, key):
                refuse_unknown(_part(joint, key), fields)
    missing = [
        key for key, entry in ROBOT.items() if entry.default is REQUIRED and key not in settings
    ]
    without = _joints_without(settings, model)
    missing += [f"{key} of {_few(joints)}" for key, joints in without.items()]
    if not missing:
        return
    words = "; ".join(missing)
    if is_description(str(source)):
        raise FormError(
            f"states no {words}: --set robot.joints.JOINT.KEY=VALUE, or `proprio robot new`, or "
            "--effort-unit N.m where torque was recorded"
        )
    nobody = ", or leave out joints that nobody drives" if without else ""
    torque = ""
    if any(key.startswith("transmission") for key in without):
        torque = "; or `proprio robot new --effort-unit N.m`, where torque was recorded"
    raise FormError(f"missing: {words}; state each{nobody}{torque}")


def _joints_without(settings: Mapping[str, Any], model: RobotModel) -> dict[str, list[str]]:
    """By a key that each joint must have, in words, the joints that do not state it."""
    without: dict[str, list[str]] = defaultdict(list)
    forces = _of_forces(settings, model)
    for name, joint in _part(settings, "joints").items():
        if NOMINAL not in _part(joint, "motor") and _CONSTANT not in _part(joint, "drive_train"):
            without[f"motor.{NOMINAL}"].append(name)
        slides = name in model.independent_joints and model.joint(name).kind == "prismatic"
        if name in forces:
            continue
        if slides and isinstance(joint, Mapping) and "transmission_m_per_rad" not in joint:
            without["transmission_m_per_rad (slide per rad of the motor)"].append(name)
    return without


def _of_the_arm(settings: dict[str, Any], model: RobotModel) -> dict[str, Any]:
    """The same without joints beside the arm, where it is said which link is its last: whatever drives those, they are only read.

    Raises: FormError: None of the joints moves that link, or objects are held elsewhere.
    """
    tip = settings.get("tip")
    stated = settings.get("joints")
    frame = settings.get("payload_frame")
    links = [link.name for link in model.links]
    if not isinstance(tip, str) or not isinstance(stated, Mapping):
        return settings
    if tip not in links:
        raise FormError(
            f"tip: {model.name} has no link {tip!r}; its hands: {', '.join(hands(model))}"
        )
    of_arm = path_to(model, tip)
    if not of_arm:
        raise FormError(f"tip: no joint moves {tip}; the hands are {', '.join(hands(model))}")
    if frame in links and not set(of_arm) <= set(path_to(model, frame)):
        hand = hand_link(model, tip)
        raise FormError(
            f"payload_frame: {frame} is not moved by the arm that ends at {tip}; state {hand}, or a link that is fixed to it"
        )
    kept = {
        name: joint
        for name, joint in stated.items()
        if name not in model.independent_joints
        or name in of_arm
        or of_arm[-1] in path_to(model, model.joint(name).child)
    }
    if not kept:
        raise FormError(
            f"tip: no joint of joints moves {tip}; state {_few(arm_joints(model, tip))}"
        )
    return {**settings, "joints": kept}


def _of_forces(settings: Mapping[str, Any], model: RobotModel) -> set[str]:
    """The joints that move the hand and whose efforts are forces or torques as recorded: they have no motor's shaft."""
    frame = settings.get("payload_frame")
    if not any(link.name == frame for link in model.links):
        return set()
    joints = _part(settings, "joints")
    return {
        name
        for name in path_to(model, str(frame))
        if _part(joints.get(name), "motor").get(NOMINAL) == 1
    }


def _few(names: Sequence[str], longest: int = 60) -> str:
    """As many names as fit, and how many more there are."""
    count = len(names)
    while count > 1 and len(", ".join(names[:count])) > longest:
        count -= 1
    return ", ".join(names[:count]) + (
        f" and {len(names) - count} more" if count < len(names) else ""
    )


def _robot(
    settings: dict[str, Any],
    source: Path,
    model: RobotModel | None = None,
) -> Robot:
    """A robot from merged settings; None: they name no URDF. Refuses what is wrong, or of another URDF."""
    settings = _stated(settings)
    try:
        arm = settings if model is None else _of_the_arm(settings, model)
        if model is not None:
            _check_stated(arm, source, model)
        # urdf and joints are listed for the message about unknown keys
        own = {key: value for key, value in settings.items() if key not in ("urdf", "joints")}
        given = section(own, ROBOT | ELSEWHERE)
        if model is None:
            raise FormError("urdf is missing; state the robot's URDF file")
        _check_model(given, model, settings.get("urdf"))
        drive_trains, motors = _drive_trains(arm.get("joints", {}), model)
        _refuse_missing(model, drive_trains, settings.get("urdf"))
        robot = _assembled(given, model, drive_trains, motors, source, settings)
        if given["calibration"] is None:
            _check_digests(settings)
            return robot
        calibrated = robot.with_calibration(given["calibration"])
        stds = {"link_mass": robot.link_mass_std, "link_inertia": robot.link_inertia_std}
        stds |= {f"link_com_{axis}": robot.link_com_std for axis in "xyz"}
        priors = {kind: Quantity(0.0, std) for kind, std in stds.items()} | {
            "arm_scale": robot.arm_scale
        }
        with under("calibration"):
            check_complete(
                given["calibration"], [link.name for link in model.links], drive_trains, priors
            )
        # last: what is wrong with a number is said by its name
        _check_digests(settings)
    except FormError as error:
        raise RobotError(f"{source.name}: {error}") from None
    return calibrated


def _check_digests(settings: Mapping[str, Any]) -> None:
    """Raises: FormError: A calibration was changed after it was written."""
    for key in CALIBRATIONS:
        if isinstance(settings.get(key), Mapping):
            with under(key):
                check_digest(settings[key])


def _check_model(
    given: Mapping[str, Any],
    model: RobotModel,
    urdf: Any,
) -> None:
    """Raises: FormError: Calibrations are of another URDF than the file's, or it lacks the link in which objects are held."""
    expected = given["model_fingerprint"]
    if expected is None and any(given[key] is not None for key in CALIBRATIONS):
        raise FormError(
            "model_fingerprint is missing: which URDF the calibration was made with cannot be checked; write it again "
            "with `proprio calibrate`"
        )
    if expected is not None and expected != model.fingerprint():
        raise FormError(
            f"was made with another URDF than {urdf} (model_fingerprint {expected[:12]}.., "
            f"now {model.fingerprint()[:12]}..): calibrate again, or restore the URDF"
        )
    for name in given["held"]:
        model.joint(name)
    for name in given["effort_sign"].joints:
        if name not in model.independent_joints:
            known = ", ".join(model.independent_joints)
            raise FormError(f"effort_sign: {model.name} has no joint {name!r}; it has {known}")
    links = [link.name for link in model.links]
    frame = given["payload_frame"]
    if frame not in links:
        raise FormError(
            f"payload_frame: {model.name} has no link {frame!r}; links: {', '.join(links)}"
        )


def _refuse_missing(model: RobotModel, driven: Iterable[str], urdf: Any) -> None:
    """Raises: FormError: The URDF lacks the mass of a link that a driven joint moves: it would count as nothing."""
    moved = {*driven}
    lacking = [
        link.name for link in model.links if link.unknown and moved & {*path_to(model, link.name)}
    ]
    if lacking:
        raise FormError(
            f"{Path(str(urdf)).name}: link{'s' * (len(lacking) > 1)} {some(lacking)}: <inertial> is missing; state mass, centre "
            "and inertia there"
        )


def _drive_trains(
    joints: Any,
    model: RobotModel,
) -> tuple[dict[str, DriveTrain], dict[str, Motor]]:
    """Drive trains and motors by joint."""
    drive_trains = {}
    motors = {}
    with under("joints"):
        for name, settings in mapping(joints).items():
            if name not in model.independent_joints:
                raise FormError(
                    f"{model.name} has no joint {name!r} that a motor could drive; "
                    f"choose from: {', '.join(model.independent_joints)}"
                )
            with under(name):
                drive_trains[name], motors[name] = _drive_train(settings, model, name)
    if not drive_trains:
        raise FormError("joints is missing or empty; state the drive train of at least one joint")
    return drive_trains, motors


_RENAMED = {
    "delay_s": "delay",
    "torque_disturbance_N_m": "torque_disturbance",
    "start_velocity_rad_s": "start_velocity",
    "link_com_std_m": "link_com_std",
    "zero_repeat_rad": "zero_repeat",
    "friction_velocity_rad_s": "friction_velocity",
}
"""Attributes of a `Robot` by their keys; others are called as their key."""
_NOT_OF_ROBOT = ("calibrated", "model_fingerprint", "calibration")
"""Keys that are no attributes, or that a calibration adds."""


def _assembled(
    given: Mapping[str, Any],
    model: RobotModel,
    drive_trains: dict[str, DriveTrain],
    motors: dict[str, Motor],
    source: Path,
    settings: Mapping[str, Any],
) -> Robot:
    """The robot without its calibration from excitations."""
    stated = {_RENAMED.get(key, key): given[key] for key in ROBOT if key not in _NOT_OF_ROBOT}
    disturbance, motion, of_joint = (
        stated[key] for key in ("torque_disturbance", *CALIBRATIONS[1:])
    )
    if isinstance(disturbance, DefaultPrior):
        # of the weakest joint: what differs from run to run goes with friction
        weakest = min(
            largest_torque(model, name, drive.transmission) for name, drive in drive_trains.items()
        )
        disturbance = disturbance.at(0.0, weakest).std
    drives = f"but {given['name']} drives {', '.join(drive_trains)}: calibrate this robot"
    only_read: list[str] = []
    if motion is not None:
        motion = replace(motion, fingerprint=given["model_fingerprint"])
        only_read = [joint for joint in motion.joints if joint not in drive_trains]
        foreign = {*only_read} - {*path_to(model, given["payload_frame"])}
        if foreign:
            raise FormError(f"motion_calibration: is of {', '.join(sorted(foreign))}, {drives}")
    if of_joint is not None and [of_joint.joint] != list(drive_trains):
        raise FormError(f"joint_calibration: is of {of_joint.joint}, {drives}")
    stated |= {
        "torque_disturbance": disturbance,
        "motion_calibration": motion,
        "gravity": frozen(given["gravity"]),
    }
    robot = Robot(
        model=model,
        drive_trains=drive_trains,
        motors=motors,
        source=source,
        settings=settings,
        **stated,
    )
    return robot.with_only_read(only_read)


def _unknown_drive(model: RobotModel, name: str) -> DriveTrain:
    """Of a joint whose motor nobody stated: no effort of it counts, so that its torque constant is of no consequence."""
    exactly = {"drive_train": {_CONSTANT: 1.0}}
    slides = model.joint(name).kind == "prismatic"
    settings = {**exactly, "transmission_m_per_rad": 1.0} if slides else exactly
    return _drive_train(settings, model, name)[0]


def _drive_train(
    settings: Any,
    model: RobotModel,
    name: str,
) -> tuple[DriveTrain, Motor]:
    joint = model.joint(name)
    fields = {
        "motor": Field(Part(by=lambda value: section(value, MOTOR))),
        "drive_train": Field(
            Part(by=lambda value: section(value, DRIVE_TRAIN)),
            {},
        ),
    }
    settings = mapping(settings)
    stated = _part(settings, "drive_train").get(_CONSTANT)
    if stated is not None and NOMINAL not in _part(settings, "motor"):
        # who states the torque constant alone publishes no efforts that another one was made with
        value = stated.get("value") if isinstance(stated, Mapping) else stated
        settings = merged(settings, {"motor": {NOMINAL: value}})
    parts = section(settings, fields | JOINT)
    motor = parts["motor"]
    transmission = parts["transmission_m_per_rad"]
    _check_travel(joint, transmission, parts["finger_travel"])
    _check_motor(joint, motor)
    largest = largest_torque(model, name, transmission or 1.0)
    drive = {}
    for key, value in (parts["drive_train"] or section({}, DRIVE_TRAIN)).items():
        known = value.at(motor[NOMINAL], largest) if isinstance(value, DefaultPrior) else value
        drive[without_unit(key)] = known
    return (
        DriveTrain(
            **drive,
            supply_voltage_V=motor["supply_voltage_V"],
            back_emf_V_s_per_rad=motor["back_emf_V_s_per_rad"],
            resistance_ohm=motor["resistance_ohm"],
            driven_by=motor["driven_by"],
            nominal_torque_constant=motor[NOMINAL],
            usable_velocity=parts["usable_velocity_rad_s"],
            encoder_resolution=motor["encoder_resolution_rad"],
            encoder_noise=motor["encoder_noise_rad"],
            encoder_once_per_turn=motor["encoder_once_per_turn_rad"],
            transmission=1.0 if transmission is None else transmission,
            finger_travel=parts["finger_travel"],
        ),
        Motor(motor["model"], motor["id"], motor["current_limit_A"]),
    )


def _check_travel(joint: Joint, transmission: float | None, travel: FingerTravel | None) -> None:
    """Refuse a slide's keys at a joint that turns, and a transmission that the fingers' travel does not show."""
    if joint.kind != "prismatic" and transmission is not None:
        raise FormError(
            f"transmission_m_per_rad is for a prismatic joint, but this one is {joint.kind}; remove it"
        )
    if travel is None:
        return
    if transmission is None or not 0.5 < travel.mean_ratio / transmission < 2.0:
        nominal = "not there" if transmission is None else f"{1e3 * transmission:g} mm per rad"
        raise FormError(
            f"finger_travel opens by {1e3 * travel.mean_ratio:.3g} mm per rad of the motor, transmission_m_per_rad is "
            f"{nominal}: one of them is wrong, or not of one finger"
        )


def _check_motor(joint: Joint, motor: Mapping[str, Any]) -> None:
    """Refuse keys of a motor that do not go together."""
    driven_by = motor["driven_by"]
    if motor["supply_voltage_V"] > 0.0 and motor["resistance_ohm"] == 0.0:
        raise FormError(
            "motor: supply_voltage_V needs resistance_ohm too; state it, or a voltage of 0 for no limit"
        )
    if driven_by is not None and joint.kind == "prismatic":
        raise FormError(
            "motor: driven_by is for a joint that turns, but this one slides; remove it"
        )
    if driven_by is not None and motor["resistance_ohm"] == 0.0:
        need = f"motor: driven_by {driven_by.kind} needs resistance_ohm too, to make a current of a voltage"
        raise FormError(f"{need}; state it")
    if motor["encoder_resolution_rad"] == 0.0 and motor["encoder_noise_rad"] == 0.0:
        raise FormError(
            "motor: encoder_resolution_rad and encoder_noise_rad are both 0; no encoder is perfect"
        )


def load_robot(
    name_or_path: str | Path,
    overrides: Mapping[str, Any] | None = None,
    of_bag: Callable[[Path], str] | None = None,
) -> Robot:
    """Read a robot.

    Args:
        name_or_path: Name of a robot that comes with the package (a file of ``config/robots`` without its suffix), or
            the path of a YAML file, whose keys are explained in ``config/robots/open_manipulator_x.yaml``; or a description
            alone (a URDF file, or ``robot_descriptions:NAME``), whose torque constants the overrides must state.
        overrides: As for `Robot.with_overrides`; they may state what a file leaves open.
        of_bag: As for `read_model`.

    Raises `RobotError`: There is no such robot, or its file or its URDF is wrong.
    """
    path = _located(str(name_or_path), Path())
    settings = _read_settings(
        path,
        tip=(overrides or {}).get("tip"),
        frame=(overrides or {}).get("payload_frame"),
    )
    model = None if settings.get("urdf") is None else read_model(settings["urdf"], of_bag)
    if not overrides or model is None or settings.get("calibration") is not None:
        robot = _robot(settings, path, model)
        return robot.with_overrides(overrides) if overrides else robot
    return _robot(
        merged(settings, nested_settings(model.independent_joints, overrides)), path, model
    )


def with_recorded_torque(
    name_or_path: str | Path,
    overrides: Mapping[str, Any],
) -> dict[str, Any]:
    """Overrides for a robot whose motors' torque was recorded, so that no torque constant is needed.

    Torque then counts as current of 1 N m/A, known to a tenth, at joints whose torque constant nobody states, or only as that 1.
    What the user states beside that stays, and what a calibration learnt.
    """
    settings = _read_settings(
        _located(str(name_or_path), Path()),
        tip=overrides.get("tip"),
        frame=overrides.get("payload_frame"),
    )
    if any(settings.get(section) is not None for section in CALIBRATIONS) or not isinstance(
        settings.get("joints"), Mapping
    ):
        return dict(overrides)
    unit: dict[str, Any] = {}
    for name, stated in settings["joints"].items():
        nominal = f"joints.{name}.motor.{NOMINAL}"
        constant = f"joints.{name}.drive_train.{_CONSTANT}"
        open_yet = (
            _part(stated, "motor").get(NOMINAL) in (None, 1)
            and _part(stated, "drive_train").get(_CONSTANT) is None
        )
        if open_yet and nominal not in overrides and constant not in overrides:
            unit |= {nominal: 1.0, constant: dict(RECORDED_TORQUE)}
    return unit | dict(overrides)
