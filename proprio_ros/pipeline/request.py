"""What is asked of recordings: what the user states, and all that it names, read once and in one place.

Command line, settings of a script and parameters of a node become `Options`; `request_of` reads what they name. Whoever works on a
recording is handed the `Request`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.inputs.forms import Number
from proprio_ros.inputs.resources import paths_of
from proprio_ros.inputs.settings import Settings, read
from proprio_ros.inputs.signs import EFFORT_SIGN, Signs
from proprio_ros.probes import all_probes, probe_named
from proprio_ros.probes.base import Probe
from proprio_ros.quantity import EFFORTS, unit_called
from proprio_ros.recordings.description import robot_named
from proprio_ros.recordings.drivers import Driver, load_driver
from proprio_ros.recordings.effort import Effort
from proprio_ros.recordings.for_robot import RobotReading
from proprio_ros.recordings.read_options import ReadOptions
from proprio_ros.recordings.sources import effort_unit_in
from proprio_ros.recordings.tables import is_table
from proprio_ros.recordings.text import is_text_recording
from proprio_ros.recordings.topics import OUR_DRIVER, Conventions
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.records import Span
from proprio_ros.robot import Robot, with_recorded_torque
from proprio_ros.robot.fields import CALIBRATIONS

DEFAULT_ROBOT = "open_manipulator_x"
TEXT_ROBOT = "open_manipulator_x_as_published"
"""Robot of a text recording that names none: the description that the paper's public example simulates."""


@dataclass(frozen=True)
class Options:
    """What the user states; see ``proprio replay --help``."""

    probe: str = "payload"
    robot: str | None = None
    # dotted keys of the probe file, ``held.JOINT``, and ``robot.`` keys of the robot file, with plain values
    settings: Mapping[str, Any] = field(default_factory=dict)
    solver: str = "lm"
    device: str = "cpu"  # where a probe's fits from every start are computed, if it can choose
    profile: str = "default"
    calibration: str | Path | None = None  # what ``proprio calibrate`` wrote
    # recordings of the same robot made with the others: with nothing in the hand, or for the probe `container` with the
    # empty container
    baseline: Sequence[str | Path] = ()
    state_topic: str | None = None
    command_topic: str | None = None
    effort_unit: str | None = None
    effort_sign: str | None = None  # as `EFFORT_SIGN` reads it
    # profile of the driver that published; topics and unit that are stated beside it win
    driver: str | Path | None = None
    span: Span | None = None  # the part of each recording that is read; of a baseline all is

    def __post_init__(self) -> None:
        if self.effort_unit is not None:
            object.__setattr__(self, "effort_unit", unit_called(self.effort_unit, EFFORTS))

    def for_recordings(self, paths: Sequence[str | Path]) -> Options:
        """The same with what recordings say by themselves, where nobody states it.

        Where all are texts that is the robot of the paper's public example; where all are tables that say the same, the unit of
        their effort; else each is read by its own headers.
        """
        if self.robot is None and all(map(is_text_recording, paths)):
            return replace(self, robot=TEXT_ROBOT)
        if self.driver is None and self.effort_unit is None:
            beside = filter(is_table, paths_of(self.baseline))
            recordings = [Path(path) for path in (*paths, *beside)]
            return replace(self, effort_unit=effort_unit_in(recordings))
        return self


@dataclass(frozen=True, eq=False)
class Request:
    """What is asked, as it was read; many recordings can share it.

    Raises `ConfigurationError`: There is no such driver, or it is wrong.
    """

    robot: Robot  # with its calibration, as the settings have it
    # what the user stated; the topics, unit and span of them hold for each recording
    options: Options = field(default_factory=Options)
    facts: Any = None  # what is stated about the object; the probe knows their form
    # positions that are stated of joints that were not recorded [rad or m]
    locked: Mapping[str, float] = field(default_factory=dict)
    # dotted settings of the robot file that are in force
    overrides: Mapping[str, Any] = field(default_factory=dict)
    # profile of the driver that published; read here, where only the options name it
    driver: Driver | None = None

    def __post_init__(self) -> None:
        if self.driver is None and self.options.driver is not None:
            object.__setattr__(self, "driver", load_driver(self.options.driver))

    @property
    def probe(self) -> Probe[Any]:
        """What is to be identified."""
        return probe_named(self.options.probe)

    @property
    def conventions(self) -> Conventions:
        """Of the driver that published."""
        return OUR_DRIVER if self.driver is None else self.driver.conventions

    @property
    def unit(self) -> str | None:
        """What effort is, as the user says or else the profile."""
        return _unit(self.options, self.driver)

    @property
    def effort_sign(self) -> Signs:
        """Which way efforts count: as the user says, else the robot file, else the profile.

        Raises `ConfigurationError`: What the user says is no sign, or of a joint that the robot does not have.
        """
        stated = _stated_sign(self.options, self.robot)
        published = Signs() if self.driver is None else self.driver.effort_sign
        return stated.over(self.robot.effort_sign).over(published)

    @property
    def effort_per_current(self) -> dict[str, float]:
        """What published efforts of each joint are made with [N m/A or N/A]."""
        return {
            name: drive.nominal_effort_per_current
            for name, drive in self.robot.drive_trains.items()
        }

    @property
    def reading(self) -> RobotReading:
        """How recordings are read. Raises `ConfigurationError`: The unit or the sign of the effort is unknown."""
        robot = self.robot
        stated = self.options
        joints = {name: robot.model.joint(name) for name in robot.model.independent_joints}
        options = ReadOptions(
            Effort(self.unit, self.effort_per_current, signs=self.effort_sign),
            list(robot.drive_trains),
            self.conventions,
            stated.state_topic,
            stated.command_topic,
            stated.span,
            states_only=len(voltage_driven(robot)) == len(robot.drive_trains),
            columns=None if self.driver is None else self.driver.columns,
            limits={name: (joint.lower, joint.upper) for name, joint in joints.items()},
        )
        return RobotReading(robot, self.driver, options)


def request_of(options: Options) -> Request:
    """Read what is asked about an object; raises as `read_request` does."""
    probe = probe_asked_for(options)
    if options.device != "cpu":
        options = replace(options, settings={**options.settings, "solver.device": options.device})
    return read_request(
        options, lambda settings: probe.facts(settings, options.solver, options.profile)
    )


def read_request(
    options: Options, facts: Callable[[Settings], Any] = lambda settings: None
) -> Request:
    """Read what is asked; ``facts`` takes what is stated about the object from the settings, and what it leaves is refused.

    Raises `ConfigurationError`, `RobotError`: In one line, what is wrong with it.
    """
    driver = usable_driver(options.driver)
    settings = Settings(options.settings)
    robot, overrides = _configured(options, settings, _unit(options, driver))
    _stated_sign(options, robot)
    locked = _locked(robot, settings)
    stated = facts(settings)
    settings.refuse_rest()
    return Request(robot, options, stated, locked, overrides, driver)


def facts_of(
    facts: Callable[[Settings], Any],
    settings: Mapping[str, Any],
) -> Any:
    """What is stated about an object, where no robot is asked for.

    Raises `ConfigurationError`: A setting is unknown, or of the wrong form.
    """
    given = Settings(settings)
    stated = facts(given)
    given.refuse_rest()
    return stated


def probe_asked_for(options: Options) -> Probe[Any]:
    """The probe that the options name; ConfigurationError: there is none, or it lacks their solver, profile or device."""
    probe = probe_named(options.probe)
    for flag, given, default in (
        ("solver", options.solver, "lm"),
        ("profile", options.profile, "default"),
        ("device", options.device, "cpu"),
    ):
        there = {each.name: getattr(each, f"{flag}s", (default,)) for each in all_probes()}
        having = [name for name, choices in there.items() if given in choices]
        if not having:
            choices = dict.fromkeys(choice for each in there.values() for choice in each)
            raise ConfigurationError(
                f"{flag} {given!r} is unknown; choose one of: {', '.join(choices)}"
            )
        if probe.name not in having:
            raise ConfigurationError(
                f"--{flag} {given} is only there for --probe {', '.join(having)}; leave it out"
            )
    return probe


def usable_driver(name: str | Path | None) -> Driver | None:
    """The profile of a driver, where one is stated.

    Raises `ConfigurationError`: There is none of that name, it is wrong, or nothing can be weighed with what it publishes.
    """
    driver = None if name is None else load_driver(name)
    if driver is not None and driver.refused:
        raise ConfigurationError(f"--driver {driver.name}: {driver.refused}")
    return driver


def robot_of(options: Options) -> Robot:
    """The robot alone, with its calibration, as the settings about it have it; what else they say is not looked at.

    Raises `ConfigurationError`, `RobotError`: A setting does not fit it, it cannot be read, or the calibration is of another robot.
    """
    settings = Settings(options.settings)
    driver = None if options.driver is None else load_driver(options.driver)
    robot, _ = _configured(options, settings, _unit(options, driver))
    _locked(robot, settings)
    return robot


def _unit(options: Options, driver: Driver | None) -> str | None:
    return options.effort_unit or (None if driver is None else driver.effort_unit)


def _stated_sign(options: Options, robot: Robot) -> Signs:
    """Raises `ConfigurationError`: It is no sign, or of a joint that the robot does not have."""
    if options.effort_sign is None:
        return Signs()
    signs = read("--effort-sign", options.effort_sign, EFFORT_SIGN)
    joints = robot.model.independent_joints
    for name in signs.joints:
        if name not in joints:
            raise ConfigurationError(
                f"--effort-sign: {robot.name} has no joint {name!r}; it has {', '.join(joints)}"
            )
    return signs


def _locked(robot: Robot, settings: Settings) -> dict[str, float]:
    """The user's ``held.JOINT`` settings [rad or m]; they are taken out."""
    locked = {
        name: read(f"held.{name}", value, Number())
        for name, value in settings.take_prefix("held.").items()
    }
    for name in locked:
        robot.model.joint(name)
    return locked


def _configured(
    options: Options, settings: Settings, unit: str | None
) -> tuple[Robot, dict[str, Any]]:
    """The robot as ``robot.`` settings and ``payload.frame`` have it, and the former; both are taken out.

    Where torque was recorded, a URDF alone is enough.
    """
    overrides = settings.take_prefix("robot.")
    if options.calibration is not None:
        robot = _calibrated(options.calibration, options.robot, overrides)
    else:
        name = options.robot or DEFAULT_ROBOT
        if unit == "N.m":
            overrides = with_recorded_torque(name, overrides)
        robot = robot_named(name, overrides)
    frame = settings.take("payload.frame", None)
    if frame is not None:
        links = [link.name for link in robot.model.links]
        if frame not in links:
            raise ConfigurationError(
                f"payload.frame={frame!r} is no link of {robot.name}; it has: {', '.join(links)}"
            )
        robot = replace(robot, payload_frame=str(frame))
    if (
        "gravity" in overrides
        and not options.baseline
        and any(getattr(robot, each) is not None for each in CALIBRATIONS)
    ):
        made = robot_named(options.calibration or options.robot or DEFAULT_ROBOT).gravity
        if np.linalg.norm(made - robot.gravity) > 0.05:  # m/s^2, 0.3 degrees
            raise ConfigurationError(
                f"robot.gravity={robot.gravity.tolist()}: the calibration was made where it is {made.tolist()}, and a recording of "
                "the load alone does not tell which holds: leave it out, calibrate the arm as it is mounted now, or add a "
                "recording of it with an empty hand (--baseline)"
            )
    return robot, overrides


def _calibrated(
    calibration: str | Path,
    name: str | None,
    overrides: Mapping[str, Any],
) -> Robot:
    """The robot of a calibration, which must be the one that is named, if any is."""
    given = f"--calibration {calibration}"
    if Path(calibration).suffix not in (".yaml", ".yml"):
        raise RobotError("expected the .yaml file that `proprio calibrate --output` wrote", given)
    if not Path(calibration).exists():
        written = "`proprio calibrate EMPTY_BAG .. --output FILE.yaml` writes one"
        raise RobotError(f"there is no such calibration; {written}", given)
    robot = robot_named(calibration, overrides)
    if (
        robot.calibration is None
        and robot.motion_calibration is None
        and robot.joint_calibration is None
    ):
        raise RobotError("holds no calibration; write it with `proprio calibrate --output`", given)
    if name is not None:
        asked = robot_named(name, with_recorded_torque(name, {}))
        if asked.model.fingerprint() != robot.model.fingerprint():
            other = f"whose URDF is not that of --robot {name}: calibrate that robot"
            raise RobotError(f"{given} is of {robot.name}, {other}")
    return robot
