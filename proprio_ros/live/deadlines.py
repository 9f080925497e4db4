"""How long a job may get no further, and for what it waits then: whoever calls a service has an answer within a stated time.

A job goes through stages. Where one gets no further for as long as is stated here, the job is given up: the call is answered, with
what was waited for. Until then the status says the same again and again, so that nobody takes a busy computer for a dead one.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from proprio_ros import clock

LOOK_S = 1.0  # between two looks at a job
REPEAT_S = 10.0  # so often the status says what is waited for
CANCELLED_S = 20.0  # a call of ~/cancel is answered by then, whether the job has ended or not


@dataclass(frozen=True)
class Stage:
    """Of a job."""

    waits_for: str
    at_most_s: float  # without getting any further; in `PREPARING` for all kernels together


CHECKING = Stage("driver and excitation node", 30.0)
PREPARING = Stage("kernels and tables; those that are done are kept, so call again", 300.0)
MOVING = Stage("the arm, by the excitation node", 30.0)
CHOOSING = Stage("the choice of the next push", 60.0)
SAVING = Stage("the disk", 60.0)
HANDLING = Stage("the reference object", 30.0)
IDENTIFYING = Stage("the identification", 300.0)
STAGES = (CHECKING, PREPARING, HANDLING, MOVING, CHOOSING, SAVING, IDENTIFYING)
"""In the order in which a job goes through them. With 15 programs beside it on two cores a job has a ninth of a core: 300 s are 30
of its own, of which a kernel takes 3 and an identification 5."""


@dataclass
class Progress:
    """Of one job; threads that make it say how far they are, another one looks."""

    stage: Stage = CHECKING
    heard_s: float = field(default_factory=clock.now)  # when it got any further
    more_s: float = 0.0  # that somebody asked to wait for
    _repeated_s: float = field(default_factory=clock.now)

    def enter(self, stage: Stage, more_s: float = 0.0) -> None:
        """The next stage begins; it may take so much longer."""
        self.stage = stage
        self.more_s = more_s
        self.go_on()

    def go_on(self) -> None:
        """It has got further."""
        self.heard_s = self._repeated_s = clock.now()

    @property
    def at_most_s(self) -> float:
        """It may get no further for so long."""
        return self.stage.at_most_s + self.more_s

    def overdue(self) -> str:
        """Why it is given up, or an empty string."""
        if clock.now() - self.heard_s <= self.at_most_s:
            return ""
        return f"given up: for {self.at_most_s:g} s it has waited for {self.stage.waits_for}"

    def still(self) -> str:
        """What is waited for, where that is due to be said again; else empty."""
        now_s = clock.now()
        if now_s - self._repeated_s < REPEAT_S:
            return ""
        self._repeated_s = now_s
        waited_s = now_s - self.heard_s
        return (
            f"waiting for {self.stage.waits_for}: {waited_s:.0f} s of at most {self.at_most_s:g} s"
        )
