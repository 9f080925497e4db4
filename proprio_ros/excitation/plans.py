"""Sequences of excitations: which joint is pushed with which current, from where and for how long, as probe files state them.

A servo that knows no current is pushed by a step of its goal instead. A probe file is YAML; its section ``excitation`` is read
here. Keys are the names of the fields below. Positions, velocities and travel count in the unit of the joint: rad for one that
turns, m for one that slides. Currents are in A.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from proprio_ros.errors import ConfigurationError, one_line
from proprio_ros.inputs.reading import finite, yaml_file
from proprio_ros.inputs.resources import resource, resource_names
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import clearance, zero_pose

HANDS = ("empty", "payload", "reference", "container", "block", "any")
"""What should be in the hand: nothing, the object, a weighed reference, a container, a soft block; or no matter what."""
START_MARGIN_RAD = 0.08
"""A start pose stays this far from a joint's limits, so that noise at rest cannot look like running into one."""
LARGEST_CURRENT_A = 10.0  # no servo of this kind takes more: such a number was meant in mA
LARGEST_POSITION_RAD = 7.0  # beyond a full turn: such a number was meant in degrees
FIRST = (
    "empty_hand",
    "payload",
    "reference",
    "empty_hand_elbow",
    "payload_elbow",
    "reference_elbow",
)
"""Sequences that every arm can make: where it has none of their joints, `first.first_sequence` makes them."""
LEAST_CURRENT_A = 0.01  # four counts of an XM430: less is as good as none
SHORTEST_SHAKE_S = 0.08  # three samples at 40 a second
LEAST_SHAKES = 2  # fewer periods are no shaking
UNTIL_UNITS = {"kg": ("payload", "reference", "empty", "any", "container"), "1": ("block",)}
"""Of half an interval, by what the hand holds: a mass, or a share of Young's modulus."""
LARGEST_HALF = {"kg": (0.1, "it is in kg, not g"), "1": (1.0, "it is a share, not in percent")}
LONGEST_UNTIL_S = 600.0
# of a goal, at the shaft: such a number was meant in degrees, or throws the arm
LARGEST_STEP_RAD = 1.0


@dataclass(frozen=True)
class ExcitationRun:
    """One excitation: a push of one joint, or its free response."""

    joint: str  # the joint that the current drives; all others hold their positions
    # Signed; negative lifts the pitch joints of the OpenMANIPULATOR-X. 0 without `shake_A` and `goal_step`: the joint swings freely
    current_A: float
    duration_s: float  # the current is on for at most so long
    # positions of joints before the run [rad or m]; joints not named stay where they are
    start: Mapping[str, float] = field(default_factory=dict)
    # the current ends early when the joint has moved so far either way, and the run is good [rad or m]
    max_travel: float = 1.0
    # a run that moves less is repeated from its start with another current [rad or m]
    min_travel: float = 0.0
    # factor on the current of each repetition. Below 1 the current is eased instead: for a run in which gravity pulls
    # and the current only supports
    raise_by: float = 1.25
    # largest magnitude that raising may reach; None: the current is not raised. Easing needs none
    max_current_A: float | None = None
    # the current is a square wave about `current_A`: this is added to it in the first half of each period and taken
    # from it in the second. It stays as it is when `current_A` is raised or eased. 0: a constant current
    shake_A: float = 0.0
    shake_period_s: float = 0.2  # of that wave
    # instead of a current, for servos that take goals alone: the goal stands so far from where the joint is held [rad
    # or m]. It is never raised
    goal_step: float = 0.0

    @property
    def is_free_response(self) -> bool:
        """Whether the joint is let go of: nothing but gravity and friction moves it."""
        return self.current_A == 0.0 and self.shake_A == 0.0 and self.goal_step == 0.0

    def current_at(self, elapsed_s: float, mean_A: float) -> float:
        """The current so long after it came on [A]; ``mean_A`` is what became of `current_A` in this attempt."""
        second_half = elapsed_s % self.shake_period_s >= 0.5 * self.shake_period_s
        return mean_A - self.shake_A if second_half else mean_A + self.shake_A

    def other_current(self, current_A: float) -> float | None:
        """With which current to repeat a run that moved too little; None: not at all."""
        size = abs(current_A)
        if self.raise_by < 1.0:
            eased = current_A * self.raise_by
            return eased if abs(eased) >= LEAST_CURRENT_A else None
        if self.max_current_A is None or size == 0.0 or size >= self.max_current_A:
            return None
        return math.copysign(min(size * self.raise_by, self.max_current_A), current_A)


@dataclass(frozen=True)
class Until:
    """When a sequence whose further pushes are chosen by what came out so far has an end."""

    # of what is identified: half of its 95 % interval is to be so small [unit]
    half_interval: float
    # of that, as `UNTIL_UNITS` has it: "kg" for a mass, "1" for a share of a block's modulus
    unit: str
    at_most_s: float = 60.0  # from the beginning; no push is begun that would not be over by then


@dataclass(frozen=True)
class ExcitationSequence:
    """Runs in the order in which they are made."""

    name: str  # of the file, without its suffix
    hand: str  # what should be in the hand, one of `HANDS`
    # at least one; with `until` there may be none: then the first is chosen, too
    runs: tuple[ExcitationRun, ...]
    # further pushes are chosen until this is reached; None: there are none
    until: Until | None = None
    description: str = ""
    # peak speed on the way to a start pose, at the motor's shaft [rad/s]
    approach_velocity: float = 0.8
    settle_s: float = 1.2  # rest before each run; the identification uses up to 1 s of it
    brake_s: float = 0.4  # the joint is held so long after its run before it goes anywhere
    # where to go at the end [rad or m]; empty: stay
    home: Mapping[str, float] = field(default_factory=dict)
    # joints that go back, before each run and at the end, to where they stood when the sequence began: the fingers
    # beside a block that was put between them
    from_here: tuple[str, ...] = ()
    # nothing that can be lowered comes closer to the base's plane than this
    min_clearance_m: float = 0.03

    def begun_at(self, pose: Mapping[str, float]) -> ExcitationSequence:
        """The sequence with numbers for the joints of `from_here`, begun at a pose of all joints [rad or m]."""
        here = {name: pose[name] for name in self.from_here}
        runs = tuple(replace(run, start={**here, **run.start}) for run in self.runs)
        return replace(self, runs=runs, home={**here, **self.home}) if here else self


def sequence_names() -> tuple[str, ...]:
    """Names of the package's probe files that have an excitation section, sorted."""
    return tuple(
        name
        for name in resource_names("probes")
        if "excitation" in _content(resource("probes", name))
    )


def as_text(sequence: ExcitationSequence) -> str:
    """A sequence as JSON, which `load_sequence` reads."""
    section = {
        key: value for key, value in asdict(sequence).items() if key != "name" and value is not None
    }
    section["runs"] = [
        {key: v for key, v in run.items() if v is not None} for run in section["runs"]
    ]
    return json.dumps(section)


def load_sequence(
    name_or_path: str | Path, robot: Robot, held_kg: float = 0.0
) -> ExcitationSequence:
    """Read the section ``excitation`` of a probe file and check it against the robot.

    Args:
        name_or_path: One of `sequence_names`, the path of a YAML file, or the section itself as JSON, in braces. Those of `FIRST`
            are made from the URDF of an arm that has none of their joints.
        robot: The arm that is to make the runs.
        held_kg: What is known to be in the hand; pushes of sequences that are made here are stronger by what carries it.

    Raises:
        ConfigurationError: The file is missing or not readable, a key is unknown or missing, a value has the wrong type or
            unit, or the robot cannot make the runs.
    """
    text = str(name_or_path)
    if text.startswith("{"):  # from a program, which chose it
        sequence = _sequence(_inline(text), "chosen", robot, "chosen")
    else:
        sequence = _from_file(name_or_path, robot, held_kg)
    check_sequence(sequence, robot)
    return sequence


def _from_file(name_or_path: str | Path, robot: Robot, held_kg: float) -> ExcitationSequence:
    text = str(name_or_path)
    given = Path(text).expanduser()
    is_path = isinstance(name_or_path, Path) or "/" in text or given.suffix in (".yaml", ".yml")
    path = given if is_path else resource("probes", text)
    content = _content(path)
    if "excitation" not in content:
        words = f"has no section 'excitation'; probe files with one: {', '.join(sequence_names()) or 'none'}; or add it"
        raise ConfigurationError(f"{path.name}: {words}")
    section = _whole(content["excitation"], path)
    if not is_path and path.stem in FIRST:
        pushed = {run["joint"] for run in section["runs"]}
        if pushed.isdisjoint(robot.drive_trains):
            # which is written in the words of this file
            from proprio_ros.excitation.first import first_sequence

            return first_sequence(robot, section["hand"], held_kg)
    return _sequence(section, path.stem, robot, f"{path.name}: excitation")


def largest_current_A(robot: Robot, joint: str) -> float:
    """That may be commanded, by the robot file, and by the effort that the URDF allows."""
    most = robot.model.joint(joint).effort_limit / abs(
        robot.drive_trains[joint].nominal_effort_per_current
    )
    return min(robot.motors[joint].current_limit_A, most if most > 0.0 else math.inf)


def push_unit(robot: Robot, joint: str) -> str:
    """What the currents of a sequence are: of a joint whose torque constant is stated as 1, torques."""
    if robot.drive_trains[joint].nominal_torque_constant != 1.0:
        return "A"
    return "N" if robot.model.joint(joint).kind == "prismatic" else "N m"


def margin(robot: Robot, joint: str, margin_rad: float) -> float:
    """A distance at the motor's shaft in the unit of the joint.

    Args:
        robot: The arm.
        joint: A driven joint.
        margin_rad: The distance at the shaft [rad].

    Returns:
        The same at the joint [rad or m].
    """
    return margin_rad * abs(robot.drive_trains[joint].transmission)


def check_sequence(sequence: ExcitationSequence, robot: Robot) -> None:
    """Whether the robot can make these runs at all.

    Raises:
        ConfigurationError: No run, an unknown joint, a current above the motor's limit, a pose outside the joints' limits
            or too low above the base's plane.
    """
    problem = next(_of_sequence(sequence, robot), "")
    if problem:
        raise ConfigurationError(f"{sequence.name}: {problem}")


def _of_sequence(sequence: ExcitationSequence, robot: Robot) -> Iterator[str]:
    if not sequence.runs and sequence.until is None:
        yield "has no run; state at least one under 'runs'"
    if sequence.until is not None:
        yield from (f"until: {words}" for words in _of_until(sequence.until, sequence))
    if sequence.hand not in HANDS:
        yield f"hand={sequence.hand!r} is unknown; choose from: {', '.join(HANDS)}"
    yield from _of_times(sequence)
    for name in sequence.from_here:
        if name not in robot.drive_trains:
            yield f"from_here: {name!r} is no driven joint; {_drives(robot)}"
    yield from (f"home: {words}" for words in _of_pose(sequence.home, {}, sequence, robot))
    pose: dict[str, float] = {}
    for number, run in enumerate(sequence.runs, 1):
        pose |= run.start
        for words in _of_run_from(run, pose, sequence, robot):
            yield f"run {number} ({run.joint}): {words}"
    swings = [run.is_free_response for run in sequence.runs]
    if any(swings) and not all(swings):
        others = "others are driven by a current"
        why = "what they tell is not computed together; make a sequence of each"
        first = swings.index(True) + 1
        yield f"run {first} swings freely (current_A is 0) and {others}: {why}"


def _drives(robot: Robot) -> str:
    return f"{robot.name} drives {', '.join(robot.drive_trains)}"


def _of_times(sequence: ExcitationSequence) -> Iterator[str]:
    for key in ("approach_velocity", "settle_s", "brake_s", "min_clearance_m"):
        value = getattr(sequence, key)
        zero = key == "approach_velocity" and value == 0.0
        if not math.isfinite(value) or value < 0.0 or zero:
            yield f"{key}={value} must be a positive number"


def _of_run_from(
    run: ExcitationRun,
    pose: Mapping[str, float],
    sequence: ExcitationSequence,
    robot: Robot,
) -> Iterator[str]:
    """Of a run and the pose that it starts from, as far as that is stated [rad or m]."""
    if run.joint not in robot.drive_trains:
        yield f"no such driven joint; {_drives(robot)}"
    yield from _of_run(run, robot)
    yield from _of_pose(run.start, pose, sequence, robot)
    if run.goal_step and run.joint in pose:
        stepped = {run.joint: pose[run.joint] + run.goal_step}
        for words in _of_pose(stepped, pose, sequence, robot):
            yield f"with goal_step: {words}"


def _of_until(until: Until, sequence: ExcitationSequence) -> Iterator[str]:
    units = [unit for unit, hands in UNTIL_UNITS.items() if sequence.hand in hands]
    if until.unit not in units:
        choices = " or ".join(repr(unit) for unit in units) or "none: leave `until` out"
        yield f"unit={until.unit!r} is unknown for hand={sequence.hand!r}; choose {choices}"
    largest, meant = LARGEST_HALF[until.unit]
    if not 0.0 < until.half_interval <= largest:
        yield f"half_interval={until.half_interval:g} must be above 0 and {largest:g} at most; {meant}"
    if not 0.0 < until.at_most_s <= LONGEST_UNTIL_S:
        yield f"at_most_s={until.at_most_s:g} must be above 0 s, and {LONGEST_UNTIL_S:g} s at most"
    if sequence.hand == "empty" and not sequence.runs:
        yield "what else to push with an empty hand follows from what the first runs say; state some under 'runs'"
    if sequence.hand == "block" and not sequence.runs:
        yield "with which current to squeeze a block follows from the first squeeze; state it under 'runs'"
    if any(run.is_free_response for run in sequence.runs):
        yield "free swings are not chosen; leave `until` out"


def _of_run(run: ExcitationRun, robot: Robot) -> Iterator[str]:
    if run.goal_step != 0.0:
        yield from _of_step(run, robot)
    yield from _of_current(run, robot)
    if not 0.0 < run.duration_s <= 60.0:
        yield f"duration_s={run.duration_s:g} must be above 0 s, and 60 s at most"
    if not 0.0 <= run.min_travel < run.max_travel:
        yield f"min_travel={run.min_travel:g} must not be negative, and below max_travel={run.max_travel:g}"
    if run.is_free_response and run.max_current_A:
        yield f"{_SWINGS} has no max_current_A"
    elif run.is_free_response and robot.model.joint(run.joint).kind == "prismatic":
        yield f"{_SWINGS} needs a joint that turns, and {run.joint} slides"
    if not (0.0 < run.raise_by <= 0.95 or 1.05 <= run.raise_by < 10.0):
        yield f"raise_by={run.raise_by:g} must be 1.05 or more to raise the current, or 0 to 0.95 to ease it"
    if run.shake_A != 0.0:
        yield from _of_shake(run, robot)


_SWINGS = "current_A is 0, which lets the joint swing freely: that"


def _of_step(run: ExcitationRun, robot: Robot) -> Iterator[str]:
    if run.current_A or run.shake_A or run.max_current_A:
        yield "has a goal_step and a current: a servo is pushed by one or the other"
    largest = margin(robot, run.joint, LARGEST_STEP_RAD)
    if not abs(run.goal_step) <= largest:
        yield f"goal_step={run.goal_step:g} must be {largest:.3g} at most, either way; it is in rad (m for a slide)"


def _of_current(run: ExcitationRun, robot: Robot) -> Iterator[str]:
    largest = max(abs(run.current_A), run.max_current_A or 0.0) + abs(run.shake_A)
    unit = push_unit(robot, run.joint)
    most = largest_current_A(robot, run.joint)
    if not math.isfinite(run.current_A + run.shake_A) or largest > max(LARGEST_CURRENT_A, most):
        yield f"{largest:g} {unit} is too much for a servo: currents are in A, not mA"
    limit = robot.motors[run.joint].current_limit_A
    if largest > limit:
        pushed = f"{largest:g} {unit} with shake_A" if run.shake_A != 0.0 else f"{largest:g} {unit}"
        remedy = "lower it, or current_limit_A in the robot file"
        yield f"{pushed} is above the motor's limit of {limit:g} {unit}; {remedy}"
    if run.max_current_A is not None and not abs(run.current_A) <= run.max_current_A:
        yield f"max_current_A={run.max_current_A:g} is a magnitude and must not be below that of {run.current_A:g} {unit}"


def _of_shake(run: ExcitationRun, robot: Robot) -> Iterator[str]:
    longest_s = run.duration_s / LEAST_SHAKES
    if not SHORTEST_SHAKE_S <= run.shake_period_s <= longest_s:
        range_s = f"from {SHORTEST_SHAKE_S:g} s to {longest_s:g} s"
        why = f"so that {LEAST_SHAKES} periods fit into duration_s={run.duration_s:g}"
        yield f"shake_period_s={run.shake_period_s:g} must be {range_s}, {why}; it is in s, not ms"
    unit = push_unit(robot, run.joint)
    mean_A: float | None = run.current_A
    while mean_A is not None:  # in every attempt that raising or easing can lead to
        least_A = min(abs(mean_A + run.shake_A), abs(mean_A - run.shake_A))
        if least_A < LEAST_CURRENT_A:
            half = f"the current is {least_A:.3g} {unit} for half of each period"
            keep = f"keep both halves at {LEAST_CURRENT_A:g} {unit} or more"
            yield (
                f"with shake_A={run.shake_A:g} about {mean_A:g} {unit} {half}, and a recording would be cut there; {keep}: "
                "change shake_A, current_A, raise_by or max_current_A"
            )
        mean_A = run.other_current(mean_A)


def _of_pose(
    stated: Mapping[str, float],
    known: Mapping[str, float],
    sequence: ExcitationSequence,
    robot: Robot,
) -> Iterator[str]:
    """Limits of the joints stated; and the height of the pose, where the joints that are not known yet are at zero."""
    for name, position in stated.items():
        if name not in robot.drive_trains:
            yield f"{name!r} is no driven joint; {_drives(robot)}"
        joint = robot.model.joint(name)
        spare = margin(robot, name, START_MARGIN_RAD)
        low = joint.lower + spare
        high = joint.upper - spare
        believable = math.isfinite(position) and abs(position) <= LARGEST_POSITION_RAD
        if not believable or not low <= position <= high:
            unit, other = ("m", "mm") if joint.kind == "prismatic" else ("rad", "degrees")
            limits = f"{low:.4g} .. {high:.4g} {unit} (limits less a margin)"
            yield f"{name}={position:g} is outside {limits}; positions are in {unit}, not {other}"
    height = clearance(robot, {**zero_pose(robot), **known, **stated}) if stated else math.inf
    if height < sequence.min_clearance_m:
        where = f"{100 * height:.1f} cm above the base's plane"
        least = f"min_clearance_m={sequence.min_clearance_m:g}"
        yield f"the arm would be {where}, less than {least}; choose a higher pose"


def _inline(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        words = f"a sequence that begins with a brace must be JSON: {one_line(str(error), 80)}"
        raise ConfigurationError(words) from error


def _content(path: Path) -> Mapping[str, Any]:
    content = yaml_file(path, ConfigurationError)
    if not isinstance(content, Mapping):
        raise ConfigurationError(
            f"{path}: holds no sections; a probe file starts with 'excitation:'"
        )
    return content


def _whole(section: Any, path: Path) -> Any:
    """A section with what it takes from the one that it names under ``like``, which the package ships."""
    if not isinstance(section, Mapping) or "like" not in section:
        return section
    like = section["like"]
    base: Mapping[str, Any] = {"like": like}
    if like in sequence_names():
        base = _content(resource("probes", like))["excitation"]
    if "like" in base:
        named = one_line(repr(like), 60)
        words = "name one of the package's sequences"
        raise ConfigurationError(f"{path.name}: excitation.like={named}: {words}")
    own = {key: value for key, value in section.items() if key != "like"}
    return {**base, **own}


def _sequence(section: Any, name: str, robot: Robot, where: str) -> ExcitationSequence:
    if isinstance(section, Mapping) and "until" in section:
        section = {"runs": [], **section}  # there need be no runs of one's own
    values = _values(
        section,
        ExcitationSequence,
        where,
        own=("runs", "from_here", "until"),
    )
    if "from_here" in values:
        names = values["from_here"]
        if not isinstance(names, list) or not all(isinstance(each, str) for each in names):
            raise ConfigurationError(f"{where}.from_here: expected a list of joints, got {names!r}")
        values["from_here"] = tuple(names)
    if "until" in values:
        values["until"] = Until(**_values(values["until"], Until, f"{where}.until"))
    runs = values["runs"]
    if not isinstance(runs, list) or not (runs or "until" in values):
        raise ConfigurationError(
            f"{where}.runs: expected a list of runs, each with joint, current_A and duration_s"
        )
    values["runs"] = tuple(
        _run(run, robot, f"{where}.runs[{number}]") for number, run in enumerate(runs, 1)
    )
    return ExcitationSequence(name=name, **values)


def _run(section: Any, robot: Robot, where: str) -> ExcitationRun:
    if isinstance(section, Mapping) and "goal_step" in section:
        section = {"current_A": 0.0, **section}
    run = ExcitationRun(**_values(section, ExcitationRun, where))
    if "max_travel" not in section and run.joint in robot.drive_trains:
        # the default counts at the shaft, too: a finger cannot move 1 m
        return replace(run, max_travel=margin(robot, run.joint, ExcitationRun.max_travel))
    return run


_TEXTS = {
    "hand": "a text",
    "description": "a text",
    "unit": "a text",
    "joint": "the name of a joint",
}
_POSES = ("start", "home")


def _values(
    section: Any,
    kind: type,
    where: str,
    own: Sequence[str] = (),
) -> dict[str, Any]:
    """A section's entries for a data class, less its name: texts, poses, and numbers; those of its ``own`` as they are.

    Raises `ConfigurationError`: An entry is unknown, missing though it has no default, or none of these.
    """
    entries = {entry.name: entry for entry in fields(kind) if entry.name != "name"}
    choices = ", ".join(entries)
    if not isinstance(section, Mapping):
        words = f"expected keys and values, got {section!r}; keys: {choices}"
        raise ConfigurationError(f"{where}: {words}")
    unknown = [str(key) for key in section if key not in entries]
    if unknown:
        words = f"unknown key {', '.join(unknown)}; valid keys: {choices}"
        raise ConfigurationError(f"{where}: {words}")
    required = [
        name
        for name, entry in entries.items()
        if entry.default is MISSING and entry.default_factory is MISSING
    ]
    missing = [name for name in required if name not in section]
    if missing:
        raise ConfigurationError(f"{where}: lacks {', '.join(missing)}; valid keys: {choices}")
    values = dict(section)
    for key, value in section.items():
        if key in _TEXTS:
            if not isinstance(value, str):
                words = f"expected {_TEXTS[key]}, got {one_line(repr(value), 60)}"
                raise ConfigurationError(f"{where}.{key}: {words}")
        elif key in _POSES:
            values[key] = _pose(value, f"{where}.{key}")
        elif key not in own:
            values[key] = _number(value, f"{where}.{key}")
    return values


def _number(value: Any, where: str) -> float:
    number = finite(value)
    if number is None:
        raise ConfigurationError(f"{where}: expected a number, got {one_line(repr(value), 60)}")
    return number


def _pose(value: Any, where: str) -> dict[str, float]:
    if not isinstance(value, Mapping):
        words = f"expected joints and their positions, such as {{joint3: 0.6}}, got {value!r}"
        raise ConfigurationError(f"{where}: {words}")
    return {str(joint): _number(position, f"{where}.{joint}") for joint, position in value.items()}
