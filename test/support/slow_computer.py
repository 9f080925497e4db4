"""A running estimate on a computer that is too slow for it, in simulated time; and whether what it says is as old as it says."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from proprio_ros.live.online_estimator import OnlineFeed
from proprio_ros.nodes.messages import joint_state, time_ns, values_of
from proprio_ros.recordings.motions import Motion
from support.listening import HEARD
from support.simulated_live import Client

LOOKED_S = 0.35
"""A warning comes so much later at most: by the period at which it is looked for, and by the way of messages."""


@dataclass
class Digestion:
    """How long the estimate takes for a joint state [s]; `stall_s` comes once on top."""

    cost_s: float = 0.0
    stall_s: float = 0.0


@contextmanager
def slow_computer(client: Client) -> Iterator[Digestion]:
    """Joint states are digested as slowly as is said from now on; whoever hears and publishes is not slowed down."""
    digestion = Digestion()
    usual = OnlineFeed.add

    def add(feed: OnlineFeed, *given: Any) -> Any:
        pause_s = digestion.cost_s + digestion.stall_s
        digestion.stall_s = 0.0
        client.clock.sleep(pause_s)
        return usual(feed, *given)

    OnlineFeed.add = add  # type: ignore[method-assign]
    try:
        yield digestion
    finally:
        OnlineFeed.add = usual  # type: ignore[method-assign]


@dataclass
class Player:
    """Publishes a motion as joint states, at its pace.

    Args:
        client: In whose world.
        motion: Its effort is that of the joint states.
        ahead_s: By how much the clock of the stamps is ahead; may be changed under way.
        pace: Seconds of the motion in a second.
    """

    client: Client
    motion: Motion
    ahead_s: float = 0.0
    pace: float = 1.0
    sent_s: dict[int, float] = field(default_factory=dict)
    """When each was sent, by its stamp."""

    def __post_init__(self) -> None:
        self._publisher = self.client.node.create_publisher(JointState, "/joint_states", 100)
        self._clock = self.client.clock
        self._ended = self._clock.event()
        self.begun_s = self._clock.now()
        self._begun_ns = self.client.node.get_clock().now().nanoseconds
        self._thread = self._clock.thread(
            self._play,
            "arm",
            group="arm",
        )
        self._thread.start()

    def _play(self) -> None:
        motion = self.motion
        rows = zip(
            motion.times_s.tolist(),
            motion.position,
            motion.current_A,
            strict=True,
        )
        for at_s, position, effort in rows:
            due_s = self.begun_s + at_s / self.pace
            if self._ended.wait(max(0.0, due_s - self._clock.now())):
                return
            stamp_ns = self._begun_ns + round(1e9 * (at_s + self.ahead_s))
            self.sent_s[stamp_ns] = self._clock.now()
            state = joint_state(
                stamp_ns,
                motion.joints,
                position.tolist(),
                [],
                effort.tolist(),
            )
            self._publisher.publish(state)

    def stop(self) -> None:
        self._ended.set()
        self._thread.join(5.0)


@dataclass(frozen=True)
class Said:
    """One message of `~/estimate`."""

    at_s: float  # when it was heard
    stamp_ns: int
    level: bytes
    message: str
    values: dict[str, str]

    @property
    def determined(self) -> bool:
        return self.values["payload_mass"] != "not determined"


class Heard:
    """Everything that the running estimate says, and when."""

    def __init__(self, client: Client) -> None:
        self._clock = client.clock
        self.estimates: list[Said] = []
        self.masses: list[float] = []
        self.payloads: list[InertiaStamped] = []
        self.capabilities: list[dict[str, str]] = []
        listen = client.node.create_subscription
        listen(DiagnosticArray, "/identifier/estimate", self._on_estimate, HEARD)
        listen(
            Float64,
            "/identifier/mass",
            lambda said: self.masses.append(said.data),
            HEARD,
        )
        listen(InertiaStamped, "/identifier/payload", self.payloads.append, HEARD)
        listen(DiagnosticStatus, "/identifier/capability", self._on_capability, HEARD)

    def _on_estimate(self, message: DiagnosticArray) -> None:
        (status,) = message.status
        stamp_ns = time_ns(message.header.stamp)
        at_s = self._clock.now()
        said = Said(
            at_s,
            stamp_ns,
            status.level,
            status.message,
            values_of(status),
        )
        if said.values.get("running") == "true":
            self.estimates.append(said)

    def _on_capability(self, status: DiagnosticStatus) -> None:
        self.capabilities.append(values_of(status))

    @property
    def withdrawn(self) -> bool:
        """Whether nothing stands of what the hand holds."""
        return (
            not self.estimates[-1].determined
            and math.isnan(self.masses[-1])
            and math.isnan(self.payloads[-1].inertia.m)
        )

    def dishonest(
        self,
        player: Player,
    ) -> list[tuple[float, str]]:
        """How old what was said had become [s], and what it was, where it says less of that than it should."""
        found = []
        ends_s = [each.at_s for each in self.estimates[1:]] + [self._clock.now()]
        for said, until_s in zip(self.estimates, ends_s, strict=True):
            if not said.determined:
                continue
            age_s = until_s - player.sent_s[said.stamp_ns]
            warned = said.level == DiagnosticStatus.WARN and said.values["holding"] == "unknown"
            if age_s > (3.0 if warned else 1.0) + LOOKED_S:
                found.append((age_s, said.message))
        return found

    def changes_s(self) -> list[float]:
        """When something was said to have been picked up or put down."""
        found = []
        before = "false"
        for said in self.estimates:
            now = said.values.get("changed", before)
            if now == "true" and before == "false":
                found.append(said.at_s)
            before = now
        return found
