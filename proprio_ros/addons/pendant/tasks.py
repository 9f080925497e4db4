"""What the wizard can do: a service each, what has to be in the hand, what is asked, and what will move."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence, load_sequence
from proprio_ros.excitation.ways import Ways
from proprio_ros.probes import all_probes
from proprio_ros.probes.base import HasBaseline
from proprio_ros.robot import Robot

POINTS = 24
"""Of one way."""
Places = list[list[float]]
"""Of the hand in the frame of the root link [m], shape (N, 3)."""
CALIBRATE = "calibrate_robot"
ELBOW = "the elbow alone, which is sooner"
SURE = "chosen ones, until it is known well enough"
PUSHES = {
    CALIBRATE: {
        "empty_hand_elbow": ELBOW,
        "empty_hand_until": "and chosen ones for a minute more",
    },
    "calibrate_payload": {"payload_elbow": ELBOW, "payload_until": SURE},
    "calibrate_container": {"container_until": SURE},
    "calibrate_softness": {"block_until": SURE},
}
"""Other sequences than the one that the identifier is set to, by the service that makes them."""
LACKS = {
    "nominal_torque_constant_N_m_per_A": (
        "torque constant [N m/A]",
        "by which the driver makes an effort of a current, or the data sheet's; 1: efforts are torques",
    ),
    "transmission_m_per_rad": (
        "way per angle of the motor [m/rad]",
        "how far it slides in one turn of the motor, by 6.283",
    ),
    "current_limit_A": (
        "largest current [A]",
        "of the motor's data sheet; only pushes need it",
    ),
}
"""What no URDF says, with its unit, and where to find it."""


@dataclass(frozen=True)
class Fact:
    """Something about the object that nobody but the user knows: lengths, asked in mm."""

    key: str
    label: str
    where: str  # how to find it
    count: int = 3


COM = Fact(
    "payload.com",
    "Centre of mass x, y, z",
    "from the point between the finger tips; empty: not known",
)
FACTS = {
    "calibrate_payload": (COM,),
    "calibrate_container": (
        Fact("container.inner_size", "Inner size x, y, z", "of the box, by a ruler; a cylinder: set it by `proprio call --set`"),
        Fact("container.centre", "Centre of the box x, y, z", "from the point between the finger tips"),
        Fact("sphere.radius", "Radius of the ball", "half of what a calliper says", 1),
    ),
    "calibrate_softness": (Fact("block.size", "Size of the block x, y, z", "y is the way the fingers press",),),
}  # fmt: skip
TITLES = {
    "calibrate_payload": "Weigh an object",
    "calibrate_container": "Weigh a ball in a box",
    "calibrate_softness": "Squeeze a block",
    "calibrate_contents": "What a container holds",
    "record_container_baseline": "Record the empty box",
    "record_contents_baseline": "Record the empty container",
}


@dataclass(frozen=True)
class Task:
    """One service.

    Attributes:
        service: Its name.
        title: What a person wants.
        hand: What has to be in the hand.
        parameters: Of the identifier, that name the sequences it makes; empty: others move the arm, or nobody.
        moves: What moves, where no sequence says so.
    """

    service: str
    title: str
    hand: str
    parameters: tuple[str, ...] = ()
    moves: str = ""

    @property
    def facts(self) -> Sequence[Fact]:
        """What is asked."""
        return FACTS.get(self.service, ())

    @property
    def pushes(self) -> Mapping[str, str]:
        """Sequences that can be chosen, with what they are in words."""
        return PUSHES.get(self.service, {})


def tasks() -> list[Task]:
    """All of them, in the order in which one needs them."""
    empty = "The hand has to be empty."
    found = [
        Task(
            CALIBRATE,
            "Calibrate the arm",
            empty,
            ("robot_sequence", "reference_sequence"),
        ),
        Task(
            "refresh_robot",
            "Refresh the calibration",
            empty,
            moves="One to five chosen pushes.",
        ),
    ]
    for probe in all_probes():
        sequences = (f"{probe.name}_sequence",)
        if isinstance(probe, HasBaseline):
            before = f"record_{probe.name}_baseline"
            title = TITLES.get(before, f"Record the {probe.baseline.noun}")
            found.append(
                Task(
                    before,
                    title,
                    _sentence(probe.baseline.hand),
                    sequences,
                )
            )
        service = f"calibrate_{probe.name}"
        title = TITLES.get(service, f"Identify the {probe.subject}")
        hand = _sentence(probe.hand or "the object has to be in the hand")
        found.append(Task(service, title, hand, sequences))
    still = "Nothing is moved by this: whoever moves the arm, moves it."
    found.append(
        Task(
            "weigh",
            "Weigh the last seconds",
            "The object is in the hand.",
            moves=still,
        )
    )
    return found


def settings_of(task: Task, texts: Mapping[str, str]) -> list[str]:
    """What was typed, in mm, as settings in m.

    Args:
        task: Whose facts they are.
        texts: By key; empty ones state nothing.

    Raises:
        ConfigurationError: Something is no length.
    """
    found = []
    for fact in task.facts:
        text = texts.get(fact.key, "").strip()
        if not text:
            continue
        try:
            values = [1e-3 * float(word) for word in text.replace(",", " ").split()]
        except ValueError:
            values = []
        if len(values) != fact.count:
            numbers = "three numbers" if fact.count > 1 else "one number"
            raise ConfigurationError(f"{fact.label}: write {numbers} in mm, such as 30 20 50")
        rounded = [round(value, 9) for value in values]
        found.append(f"{fact.key}={json.dumps(rounded if fact.count > 1 else rounded[0])}")
    return found


def what_moves(names: Sequence[str], robot: Robot | None) -> str:
    """What sequences will do with an arm, in sentences; what cannot be read here is named."""
    said = []
    if robot is None:
        return f"The arm makes {', then '.join(names)}."
    for name in names:
        try:
            said.append(_moves(load_sequence(name, robot), robot))
        except ProprioError as error:
            said.append(f"{name} cannot be made: {error}.")
    return " ".join(said)


def _moves(plan: ExcitationSequence, robot: Robot) -> str:
    """One sequence."""
    if not plan.runs:
        return f"{plan.name}: pushes are chosen one by one, within the arm's limits."
    travels: dict[str, float] = {}
    for run in plan.runs:
        travels[run.joint] = max(run.max_travel, travels.get(run.joint, 0.0))
    ways = []
    for joint, travel in travels.items():
        slides = robot.model.joint(joint).kind == "prismatic"
        ways.append(f"{joint} by {1e3 * travel:g} mm" if slides else f"{joint} by {travel:g} rad")
    peaks = [abs(run.current_A) + abs(run.shake_A) for run in plan.runs]
    peaks += [run.max_current_A or 0.0 for run in plan.runs]
    more = ", then chosen ones" if plan.until is not None else ""
    count = f"{len(plan.runs)} push{'es' * (len(plan.runs) > 1)}"
    return (
        f"{plan.name}: {count}{more}, {', '.join(ways)} at most, with up to {max(peaks):.2f} A. Before each the arm goes to a "
        "start pose."
    )


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:].rstrip('.')}."


def ways_of(names: Sequence[str], robot: Robot, pose: Mapping[str, float]) -> tuple[Places, Places]:
    """Those of sequences, one after the other; pushes that are chosen as they come are not known yet.

    Args:
        names: Of the sequences.
        robot: The arm.
        pose: Where its joints stand [rad or m].

    Returns:
        The ways to where pushes begin and back, and as far as pushes may take the hand, either way.

    Raises:
        ConfigurationError, ExcitationError: A sequence cannot be read, or no way is free.
    """
    finder = Ways(robot)
    between: Places = []
    pushed: Places = []
    here = {**dict.fromkeys(robot.model.independent_joints, 0.0), **pose}
    for name in names:
        sequence = load_sequence(name, robot).begun_at(here)
        for goal in (*(run.start for run in sequence.runs), sequence.home):
            way = finder.find(
                here,
                {**here, **goal},
                sequence,
                "the next pose",
            )
            times_s = np.linspace(0.0, way.duration_s, POINTS).tolist()
            between += [_place(robot, {**here, **way.at(at_s)}) for at_s in times_s]
            here |= goal
        for run in sequence.runs:
            here |= run.start
            pushed += _pushed(robot, here, run)
    return between, pushed


def _pushed(robot: Robot, begin: Mapping[str, float], run: ExcitationRun) -> Places:
    """By one push, from a pose of all joints [rad or m]."""
    joint = robot.model.joint(run.joint)
    low = max(begin[run.joint] - run.max_travel, joint.lower)
    high = min(begin[run.joint] + run.max_travel, joint.upper)
    positions = np.linspace(low, high, POINTS).tolist()
    return [_place(robot, {**begin, run.joint: at}) for at in positions]


def _place(robot: Robot, pose: Mapping[str, float]) -> list[float]:
    """Of the hand [m]."""
    place = robot.model.frame_transform(robot.payload_frame, pose)
    return [float(each) for each in place[:3, 3]]


def filled(text: str, values: dict[str, float]) -> str:
    """A robot file, as ``proprio robot new`` writes it, with values by key, such as ``joints.NAME.motor.current_limit_A``."""
    for key, value in values.items():
        joint, name = parts_of(key)
        place = re.compile(rf"(\n  {re.escape(joint)}:.*?\n +{name}: )\S+", re.S)
        text = place.sub(rf"\g<1>{value:g}", text, count=1)
    return text


def parts_of(key: str) -> list[str]:
    """Of a key that a robot file lacks: its joint, and what is lacking there."""
    return key.removeprefix("joints.").replace(".motor.", ".").rsplit(".", 1)
