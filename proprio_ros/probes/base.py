"""What a probe is: something that can be identified from how a joint moves, with all that the package needs to know of it.

`Probe` is what every probe has. What only some have are classes that stand on it, such as `HasBaseline`: a probe inherits from
those that it is, and callers ask ``isinstance(probe, HasBaseline)``. The command line reads these classes to parse its arguments,
so what is heavy (simulators, finite elements) is imported in the methods that need it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.settings import Settings
from proprio_ros.kinds import Kind, add_kinds

if TYPE_CHECKING:
    import numpy as np

    from proprio_ros.excitation.plans import ExcitationSequence
    from proprio_ros.experiment_design.choosing import Chooser
    from proprio_ros.identification.estimate import Estimate
    from proprio_ros.identification.regression.at_rest import StandingEstimator
    from proprio_ros.recordings.motions import Motion
    from proprio_ros.recordings.text import TextRecording
    from proprio_ros.records import Run
    from proprio_ros.robot import Robot
    from proprio_ros.sim.payload import PayloadFacts
    from proprio_ros.virtual.objects import HandObject

Facts = TypeVar("Facts")


@dataclass(frozen=True)
class Recorded:
    """What was read."""

    # runs, baseline: of the object, and made with them without it
    runs: Sequence[Run]
    baseline: Sequence[Run] = ()
    sources: Sequence[Path] = ()  # where each run comes from
    text: TextRecording | None = None  # the text recording among them
    # motions, baseline_motions: recordings in which several joints were driven at once; then there are no runs
    motions: Sequence[Motion] = ()
    baseline_motions: Sequence[Motion] = ()


@dataclass(frozen=True)
class Baseline:
    """Runs that are made once, without what is to be identified."""

    noun: str  # what they weigh, such as ``empty container``
    hand: str  # what the user is asked for before them, as a sentence
    question: str  # what to ask where they do not weigh what they should
    missing: str  # what a user does who has none and needs one
    probe: str = "payload"  # what they are identified as


@dataclass(frozen=True)
class Limit:
    """A number that guards a probe; a parameter of the identifier node."""

    name: str
    default: float
    description: str
    lowest: float
    highest: float


@dataclass(frozen=True, kw_only=True)
class Example:
    """What ``proprio demo`` and the launch file show of a probe on a virtual robot."""

    # flag, metavar, help: of the option that states the truth, without its dashes
    flag: str = "mass"
    metavar: str = "KG"
    help: str
    # truth, lowest, highest: where it is not given, and its range, in the unit of the probe's answer
    truth: float
    lowest: float = 1e-6
    highest: float = 2.0
    units: str = "masses are in kg, so 50 g is 0.05"  # what to say about a number outside it
    held: str  # what the virtual hand holds, with ``{truth}`` in it, as `virtual_object` is typed
    # now, was, takes: the sentence when it is in the hand; what the truth is called at the end; how long it takes
    now: str
    was: str
    takes: str
    # the identifier's parameters for a short demo
    sequences: Mapping[str, str] = field(default_factory=dict)
    reference: bool = True  # whether a weight helps the short calibration
    # settings that say what the virtual object is, as a user says it of his
    stated: tuple[str, ...] = ()


@dataclass(frozen=True)
class Asked:
    """A fact that decides the answer, and is a guess where nobody states it: a parameter of the identifier asks for it."""

    parameter: str
    key: str  # the same fact among the settings
    about: str  # what it is, and what the guess costs


@dataclass(frozen=True)
class Carried:
    """A rigid load, as others want to hear of it."""

    mass_kg: float
    com_m: Sequence[float]  # centre of mass in the payload frame, shape (3,)
    inertia_kg_m2: np.ndarray  # about it, shape (3, 3)
    com_guessed: bool = False  # whether nobody stated the centre and nothing showed it
    # where it comes from: ``identified``, ``stated``, or ``assumed`` where nobody said it and no motion showed it
    inertia_is: str = "stated"


@dataclass(frozen=True)
class Body:
    """A body to be shown: ``box``, ``cylinder`` (along z) or ``sphere``; edges or diameters, payload_R_body, opacity (0 to 1)."""

    kind: str
    size_m: Sequence[float]
    rotation: np.ndarray
    opacity: float


@dataclass(frozen=True)
class Shapes:
    """What to show in RViz: bodies around one place in the payload frame [m], shape (3,)."""

    place_m: Sequence[float]
    bodies: Sequence[Body]


class Probe(ABC, Generic[Facts]):
    """One thing that can be identified."""

    name: ClassVar[str]  # on the command line, in file and service names
    subject: ClassVar[str]  # what the answer is about, in a sentence
    answer: ClassVar[tuple[str, str]]  # name and unit of its first value
    # topics of the identifier that are plain numbers, and the value that is published on each
    numbers: ClassVar[Mapping[str, str]] = MappingProxyType({})
    keys: ClassVar[tuple[str, ...]]  # what the settings about its object begin with
    # kinds of unknowns that it brings, by name
    unknowns: ClassVar[Mapping[str, Kind]] = MappingProxyType({})
    # what a virtual hand holds for it; None: nothing
    virtual_object: ClassVar[type[HandObject] | None] = None
    # what the user is asked for before the runs, as a sentence; empty: nothing
    hand: ClassVar[str] = ""
    asked: ClassVar[tuple[Asked, ...]] = ()
    default_sequence: ClassVar[str]  # the runs that are made where none is named
    example: ClassVar[Example | None] = None  # what the demo shows; None: no demo

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Whoever imports anything of a probe can name its unknowns."""
        super().__init_subclass__(**kwargs)
        add_kinds(cls.unknowns)

    @abstractmethod
    def facts(
        self,
        settings: Settings,
        solver: str = "lm",
        profile: str = "default",
    ) -> Facts:
        """What the user says about the object and the search, over the defaults of the probe's file; read once per job.

        Args:
            settings: The user's.
            solver: One of `HasSolvers.solvers`.
            profile: One of `HasSolvers.profiles`.

        Returns:
            What is stated.

        Raises:
            ConfigurationError: A value of the wrong form or unit.
        """

    def compile(self, robot: Robot, facts: Facts) -> None:
        """Compile the kernels that an identification needs on this computer; again it costs nothing."""
        from proprio_ros.sim.joint import compile_kernels

        compile_kernels(rises=robot.friction_rises)

    @abstractmethod
    def identify(self, robot: Robot, recorded: Recorded, facts: Facts) -> Estimate:
        """Identify the object.

        Args:
            robot: As its file or its calibration states it.
            recorded: With runs, or with motions where it is one of `TakesMotions`.
            facts: What is stated of the object.

        Returns:
            The answer; its first value is that of `answer`.

        Raises:
            ConfigurationError, RecordingError: The runs cannot be related to the robot or the object at all.
        """

    def sections(self, estimate: Estimate) -> list[str]:
        """Its own parts of the report, as HTML."""
        return []


class TakesMotions(Probe[Facts]):
    """Motions of several joints at once, or under a controller, determine it, too, and so do free swings."""


class HasSolvers(Probe[Facts]):
    """More than one way to its answer: solvers, profiles and devices that ``replay`` may be asked for."""

    solvers: ClassVar[tuple[str, ...]] = ("lm",)
    profiles: ClassVar[tuple[str, ...]] = ("default",)
    devices: ClassVar[tuple[str, ...]] = ("cpu",)


class HasBaseline(Probe[Facts]):
    """Runs without the object are made first."""

    baseline: ClassVar[Baseline]

    @abstractmethod
    def needs_baseline(self, facts: Facts) -> bool:
        """Whether nothing can be identified without one."""

    @abstractmethod
    def baseline_settings(self, facts: Facts) -> dict[str, object]:
        """What is stated about the hand without the object, as settings of the probe ``baseline.probe``."""


class Prepares(Probe[Facts]):
    """What takes long is computed before the arm moves; ``prepares`` says whose simulation, in words."""

    prepares: ClassVar[str]

    def prepare(self, robot: Robot, facts: Facts) -> None:
        """Compile and tabulate what an identification needs.

        Raises:
            ConfigurationError: Compiled kernels cannot be kept.
            SimulationError: The object cannot be simulated.
        """
        self.compile(robot, facts)


class Guards(Probe[Facts]):
    """Something is refused before the arm moves; ``limits`` are the numbers that guard the object."""

    limits: ClassVar[tuple[Limit, ...]] = ()

    def check_live(self, facts: Facts) -> None:
        """Whether the nodes can do what the facts ask for. Raises `ConfigurationError`: They cannot; with what to do instead."""

    def check(
        self, robot: Robot, facts: Facts, sequence: ExcitationSequence, limits: Mapping[str, float]
    ) -> None:
        """Whether a sequence may be made with this object.

        Args:
            robot: As its file or its calibration states it.
            facts: What is stated of the object.
            sequence: Whose runs are to be made.
            limits: The numbers that guard the object, by the names of `limits`.

        Raises:
            ConfigurationError: Its runs say nothing about the object, or could break it.
        """


class ChoosesNext(Probe[Facts]):
    """Somebody chooses its pushes, one by one."""

    @abstractmethod
    def chooser(
        self,
        robot: Robot,
        facts: Facts,
        sequence: ExcitationSequence,
        baseline: Sequence[Run] = (),
    ) -> Chooser:
        """Who chooses the pushes of a sequence that has `until`, with what is in the hand.

        Args:
            robot: As its file or its calibration states it.
            facts: What is stated of the object.
            sequence: With an `until`.
            baseline: Runs without the object.

        Returns:
            Who chooses.

        Raises:
            ConfigurationError: Nobody can, for this sequence.
        """


class EstimatesLive(Probe[Facts]):
    """There is an estimate while a run is under way."""

    @abstractmethod
    def identify_so_far(
        self,
        robot: Robot,
        runs: Sequence[Run],
        facts: Facts,
    ) -> Estimate:
        """An early answer from runs of which the last is still under way.

        Args:
            robot: As its file or its calibration states it.
            runs: So far.
            facts: What is stated of the object.

        Returns:
            The answer; its first value is that of `answer`.
        """


class Carries(Probe[Facts]):
    """The answer is a rigid load, as a weighed reference is, with which a robot is calibrated."""

    @abstractmethod
    def reference(self, settings: Settings) -> PayloadFacts:
        """Shape and place of a reference, as far as they are stated.

        Raises `ConfigurationError`: A value of the wrong form or unit.
        """

    @abstractmethod
    def load(self, facts: Facts, mass_kg: float) -> Carried:
        """The load of that mass as far as the facts say it."""

    @abstractmethod
    def carried(self, facts: Facts, estimate: Estimate) -> Carried | None:
        """The load that an accepted answer stands for; None: no mass is determined."""


class HasTable(Probe[Facts]):
    """It reads a simulation from a table, which ``proprio table`` makes anew."""

    @abstractmethod
    def rebuild_table(self, facts: Facts) -> tuple[dict[str, Any], str]:
        """Compute the table of an object anew, whatever the cache has: what it is as JSON, and for the terminal.

        Raises `ConfigurationError`, `SimulationError`: In one line, what is wrong with the object.
        """


class Online(Carries[Facts]):
    """It says what the hand holds while the arm works, without runs of its own."""

    @abstractmethod
    def running(
        self,
        robot: Robot,
        facts: Facts,
        held: dict[str, float],
    ) -> StandingEstimator:
        """An estimate that goes along with the arm's work.

        Args:
            robot: With a calibration of motions.
            facts: What is stated of the object.
            held: Positions of joints without a calibration of motions [rad or m].

        Returns:
            What estimates.

        Raises:
            RobotError: The calibration is of another arm.
        """


class Shown(Probe[Facts]):
    """An accepted answer has a shape in RViz, and perhaps something to say beside its interval."""

    @abstractmethod
    def shapes(self, robot: Robot, facts: Facts, estimate: Estimate) -> Shapes | None:
        """How it looks.

        Args:
            robot: As its file or its calibration states it.
            facts: What is stated of the object.
            estimate: The accepted answer.

        Returns:
            The bodies; None: nothing is determined that could be shown.
        """

    def remark(self, estimate: Estimate) -> str:
        """What is said after the interval; begins with a comma."""
        return ""


def chooser_of(
    probe: Probe[Any],
    robot: Robot,
    facts: Any,
    sequence: ExcitationSequence,
    baseline: Sequence[Run] = (),
) -> Chooser:
    """As `ChoosesNext.chooser`, for any probe.

    Args:
        probe: Whose object is in the hand.
        robot: As its file or its calibration states it.
        facts: What is stated of the object.
        sequence: With an `until`.
        baseline: Runs without the object.

    Returns:
        Who chooses.

    Raises:
        ConfigurationError: Nobody can choose, for this probe or this sequence.
    """
    if not isinstance(probe, ChoosesNext):
        raise ConfigurationError(
            f"{sequence.name}: its pushes are to be chosen one by one (until), which the probe {probe.name} cannot; take "
            f"{probe.default_sequence}, or another sequence without `until`"
        )
    return probe.chooser(robot, facts, sequence, baseline)
