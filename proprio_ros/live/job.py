"""One service call that is being worked on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from proprio_ros import clock
from proprio_ros.errors import ProprioError
from proprio_ros.excitation.plans import Until
from proprio_ros.experiment_design.choosing import Decision

ROBOT = "robot"  # the job that calibrates the robot
REFRESH = "refresh"  # the job that brings its calibration up to date
WEIGH = "weigh"  # the job that needs no excitation: whoever moves the arm, moves it


class JobError(ProprioError):
    """Why a job ended without a result, in one sentence.

    Attributes:
        aborted_by: What ended a probe, such as "limit"; empty where none was ended.
    """

    def __init__(self, sentence: str, aborted_by: str = "") -> None:
        super().__init__(sentence)
        self.aborted_by = aborted_by


@dataclass
class Job:
    """A job.

    Attributes:
        kind: `ROBOT`, `WEIGH`, or the name of a probe, with ``_baseline`` behind it where that is recorded.
        service: That was called.
        cancelled, ended: Set when somebody asks for its end, and when that is reached.
        success, message: The answer.
        settings: What is known about the object beside what the node knows, KEY=VALUE; these win.
        sequence: To be made; empty: the parameter's.
        until: Pushes are chosen until then, whatever the sequence says; None: what it says counts.
        bag: The recording; empty: there is none yet.
        entries: Keys and values of its estimate in the end.
        on_end: Called at its end.
        reason: Why no further push was chosen; empty where none was to be.
        decisions: One by one, where pushes were chosen.
    """

    kind: str
    service: str
    cancelled: clock.Event = field(default_factory=clock.event)
    ended: clock.Event = field(default_factory=clock.event)
    success: bool = False
    message: str = ""
    settings: tuple[str, ...] = ()
    sequence: str = ""
    bag: str = ""
    entries: Mapping[str, Any] = field(default_factory=dict)
    on_end: list[Callable[[], None]] = field(default_factory=list)
    reason: str = ""
    until: Until | None = None
    decisions: list[Decision] = field(default_factory=list)
