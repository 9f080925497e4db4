"""One service call that is being worked on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from proprio_ros import clock
from proprio_ros.errors import ProprioError
from proprio_ros.excitation.plans import ExcitationSequence, Until, check_sequence, load_sequence
from proprio_ros.live.deadlines import Progress
from proprio_ros.robot import Robot

if TYPE_CHECKING:
    from proprio_ros.experiment_design.choosing import Decision

ROBOT = "robot"  # the job that calibrates the robot
REFRESH = "refresh"  # the job that brings its calibration up to date
WEIGH = "weigh"  # the job that needs no excitation: whoever moves the arm, moves it


class JobError(ProprioError):
    """Why a job ended without a result, in one sentence."""

    def __init__(self, sentence: str, aborted_by: str = "") -> None:
        super().__init__(sentence)
        # what ended a push, such as "limit"; empty where none was ended
        self.aborted_by = aborted_by


@dataclass
class Job:
    """What was asked by a call, and how far it has come."""

    # `ROBOT`, `WEIGH`, or the name of a probe, with `_baseline` behind it where that is recorded
    kind: str
    service: str  # that was called
    # set when somebody asks for its end ..
    cancelled: clock.Event = field(default_factory=clock.event)
    ended: clock.Event = field(default_factory=clock.event)  # .. and when that is reached
    progress: Progress = field(default_factory=Progress)
    given_up: str = ""  # why it was answered before its end; nothing of it counts then
    repeated: int = 0  # how many sequences were made once more, since joint states had paused
    success: bool = False
    message: str = ""
    # KEY=VALUE, about the object; these win over what the node knows
    settings: tuple[str, ...] = ()
    sequence: str = ""  # to be made; empty: the parameter's
    bag: str = ""  # the recording; empty: there is none yet
    # keys and values of its estimate in the end
    entries: Mapping[str, Any] = field(default_factory=dict)
    on_end: list[Callable[[], None]] = field(default_factory=list)  # called at its end
    reason: str = ""  # why no further push was chosen; empty where none was to be
    # pushes are chosen until then, whatever the sequence says; None: what it says counts
    until: Until | None = None
    decisions: list[Decision] = field(default_factory=list)  # one by one, where pushes were chosen

    def check_wanted(self) -> None:
        """Raises `JobError`: The call has been answered, and nobody waits for what comes of it."""
        if self.given_up:
            raise JobError(self.given_up)

    def plan(self, default: str, robot: Robot) -> ExcitationSequence:
        """The sequence that it makes: the one that was asked for, else a parameter's, and until it is as sure as was asked for.

        Raises `ConfigurationError`: It cannot be made with this robot.
        """
        plan = load_sequence(self.sequence or default, robot)
        if self.until is not None:
            plan = replace(
                plan,
                until=self.until,
                runs=plan.runs if self.sequence else (),
            )
            check_sequence(plan, robot)
        return plan
