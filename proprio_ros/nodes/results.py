"""What the identifier publishes: its status, estimates, and what they say of the hand, until that stands no longer."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from std_msgs.msg import Bool, Float64
from visualization_msgs.msg import MarkerArray

from proprio_ros.experiment_design.choosing import Decision, words_of
from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.live.answers import as_diagnostics, calibration_as_diagnostics, interval_of
from proprio_ros.live.carrying import Load
from proprio_ros.live.holding import Holding
from proprio_ros.live.job import WEIGH, Job
from proprio_ros.live.news import News
from proprio_ros.live.online_estimator import (
    OnlineFeed,
    late_words,
    online_entries,
    online_words,
    withdrawn_entries,
)
from proprio_ros.live.workspace import Workspace
from proprio_ros.nodes import messages
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.numeric import StampedEstimates
from proprio_ros.nodes.qos import LATCHED
from proprio_ros.pipeline.request import Request
from proprio_ros.probes import all_probes, probe_at_work
from proprio_ros.probes.base import Carried, Carries, Probe, Shown
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import hand_path, zero_pose


class StandingLoad(NamedTuple):
    """What an accepted answer says the hand holds, until something newer is known."""

    robot: Robot  # in whose payload frame it is
    carried: Carried
    words: str  # its mass with the interval


class Results:
    """Publishers of a node, all latched.

    Attributes:
        concluded: Whether a final estimate was published since this was last set to false.
        entries: Keys and values of the last final estimate.
        link: That holds what is identified.
        hear: Called with each sentence, and its keys and values.
        load: What stands of the hand.
        held: The same as a mass with its standard deviation, also by the running estimate.
        held_ns: Stamp of the newest sample that this rests on.
        late: That the running estimate is late, in words; empty: it is not.
    """

    def __init__(self, node: ManagedNode, workspace: Workspace) -> None:
        self._node = node
        self._workspace = workspace
        self.concluded = False
        self.link = ""
        self.entries: Mapping[str, Any] = {}
        self.hear: Callable[[str, Mapping[str, Any]], None] = lambda message, entries: None
        self._stamped = StampedEstimates(node)
        self._holding = Holding(node.values["holding_from"])
        self._told: bool | None = None
        self._held = node.create_publisher(Bool, "~/holding", LATCHED)
        self.load: StandingLoad | None = None
        self.held: Load | None = None
        self.held_ns = 0
        self.late = ""
        # what was published of the hand, and what withdraws it
        self._standing: dict[str, Callable[[], None]] = {}
        self._status = node.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._estimate = node.create_publisher(DiagnosticArray, "~/estimate", LATCHED)
        self._load = node.create_publisher(InertiaStamped, "~/payload", LATCHED)
        self._markers = node.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._planned = node.create_publisher(MarkerArray, "~/next_push", LATCHED)
        self._numbers = {
            name: node.create_publisher(Float64, f"~/{name}", LATCHED)
            for name in dict.fromkeys(topic for probe in all_probes() for topic in probe.numbers)
        }

    @property
    def _calibration(self) -> str:
        return str(self._workspace.calibration or "none")

    def _now_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def tell(
        self,
        doing: str,
        message: str,
        entries: Mapping[str, Any] | None = None,
        level: str = "ok",
    ) -> None:
        """Publish the status.

        Args:
            doing: What is under way, or ``idle``.
            message: A sentence.
            entries: Further keys and values.
            level: ``ok``, ``warning`` or ``error``.
        """
        values = {
            "doing": doing,
            "calibration": self._calibration,
            **(entries or {}),
        }
        self._status.publish(messages.status(level, "identifier", message, values))
        self.hear(message, values)

    def tell_and_log(self, doing: str, message: str) -> None:
        """The same, and a line of the log."""
        self._node.say("info", message)
        self.tell(doing, message)

    def choice(self, robot: Robot, decision: Decision, pose: Mapping[str, float]) -> None:
        """Show what is known after a push, and the way of the hand in the next.

        Args:
            robot: The arm.
            decision: What is known, and the next push.
            pose: Where the arm stands [rad or m].
        """
        push = decision.push
        here = {**zero_pose(robot), **pose}
        path = None
        # fingers that slide move no hand
        if push is not None and robot.model.joint(push.joint).kind != "prismatic":
            path = hand_path(robot, push.joint, push.start, push.travel)
        place = (
            robot.model.frame_transform(robot.payload_frame, here)[:3, 3]
            if path is None
            else path[0]
        )
        frame = self._node.values["frame_prefix"] + robot.model.root
        self._planned.publish(
            messages.planned(
                self._now_ns(),
                frame,
                place,
                words_of(decision),
                path,
            )
        )
        self._standing["choice"] = partial(self._planned.publish, messages.no_markers())

    def publish_estimate(
        self,
        level: str,
        name: str,
        message: str,
        entries: Mapping[str, Any],
        stamp_ns: int | None = None,
    ) -> None:
        """Publish keys and values as they are, and the calibration used.

        Args:
            level: ``ok``, ``warning`` or ``error``.
            name: Of the probe.
            message: The same in words.
            entries: Keys and values.
            stamp_ns: Of the newest sample that they rest on; None: now.
        """
        values = {**entries, "calibration": entries.get("calibration", self._calibration)}
        when_ns = self._now_ns() if stamp_ns is None else stamp_ns
        self._estimate.publish(
            messages.diagnostics(when_ns, [messages.status(level, name, message, values)])
        )
        withdraw = self._stamped.publish(self.link, values, when_ns)
        if withdraw:
            self._standing["stamped"] = withdraw
        self.hear(message, values)

    def failure(self, job: Job) -> None:
        """That there is no estimate, and why, in the place of the last."""
        entries: dict[str, Any] = {
            "probe": job.kind,
            "final": True,
            "verdict": "failed",
            "reason.1": job.message,
        }
        answers = {probe.name: probe.answer for probe in all_probes()} | {
            WEIGH: probe_at_work().answer
        }
        if job.kind in answers:
            entries[answers[job.kind][0]] = "not determined"
        self.entries = entries
        self.publish_estimate("error", job.kind, job.message, entries)

    def final(
        self,
        estimate: Estimate,
        name: str,
        carried: Carried | None = None,
    ) -> None:
        """Publish a final estimate without what it says of the hand.

        Args:
            estimate: What was identified.
            name: As which it is published.
            carried: The load that will be published for it; None: none.
        """
        entries = {**as_diagnostics(estimate), "final": True, "calibration": self._calibration}
        value = estimate.values[0]
        known = estimate.verdict in (Verdict.ACCEPTED, Verdict.TOO_WIDE)
        if (
            known
            and name == probe_at_work().name
            and isinstance(value.value, float)
            and isinstance(value.std, float)
        ):
            entries |= self._hear(value.value, value.std)
        self._conclude(estimate, name, entries | _about_load(carried))

    def calibration(self, estimate: CalibrationEstimate, output: str) -> None:
        """That of the robot; its file ``output`` counts where it was accepted."""
        used = output if estimate.verdict is Verdict.ACCEPTED else self._calibration
        entries = calibration_as_diagnostics(estimate)
        self._conclude(
            estimate,
            "robot",
            {**entries, "final": True, "calibration": used},
        )

    def _conclude(
        self, estimate: Estimate | CalibrationEstimate, name: str, entries: dict[str, Any]
    ) -> None:
        entries |= {
            f"reason.{number}": reason for number, reason in enumerate(estimate.reasons, start=1)
        }
        words = "; ".join(estimate.reasons) or estimate.verdict.value
        self.concluded = True
        self.entries = entries
        self.publish_estimate(
            "ok" if estimate.verdict is Verdict.ACCEPTED else "warning", name, words, entries
        )

    def publish(self, request: Request, estimate: Estimate) -> None:
        """The answer, and where it is accepted its numbers and the load it stands for; how it looks, in amber if it is too wide."""
        probe = request.probe
        robot = request.robot
        facts = request.facts
        self.link = robot.payload_frame
        accepted = estimate.verdict is Verdict.ACCEPTED
        carried = (
            probe.carried(facts, estimate) if accepted and isinstance(probe, Carries) else None
        )
        self.final(estimate, estimate.probe, carried)
        value = estimate.values[0]
        if estimate.verdict not in (Verdict.ACCEPTED, Verdict.TOO_WIDE):
            return
        if not isinstance(value.value, float) or not isinstance(value.std, float):
            return
        now_ns = self._now_ns()
        frame = self._node.values["frame_prefix"] + robot.payload_frame
        values = {
            entry.name: entry.value for entry in estimate.values if isinstance(entry.value, float)
        }
        if accepted:
            self._publish_numbers(probe, values)
        if carried is not None:
            self._publish_load(now_ns, frame, carried)
            self.load = StandingLoad(robot, carried, interval_of(estimate))
            self.held = Load(carried.mass_kg, value.std, carried.com_m)
            self.held_ns = now_ns
            self.late = ""
        shapes = probe.shapes(robot, facts, estimate) if isinstance(probe, Shown) else None
        if shapes is not None:
            self._markers.publish(
                messages.markers(
                    now_ns, frame, shapes, value.value, value.std, value.unit, accepted
                )
            )
            self._standing["markers"] = partial(self._markers.publish, messages.no_markers())

    def running(
        self,
        feed: OnlineFeed,
        news: News,
        behind_s: float,
        link: str,
    ) -> None:
        """Publish what the hand holds now, as far as the estimate is not too old for it.

        Args:
            feed: That made the estimate.
            news: The estimate.
            behind_s: How old it is [s].
            link: That holds what is weighed.
        """
        probe = feed.probe
        estimate = news.estimate
        self.link = link
        self.late = late_words(behind_s)
        words = "; ".join(filter(None, (online_words(estimate), self.late, feed.warning)))
        level = "warning" if self.late or feed.warning else "ok"
        held = max(estimate.mass_kg, 0.0)
        load = feed.load(held) if estimate.known else None
        if self.late:
            self._forget_holding(news.stamp_ns)
            about = self._holding.entries(0)
        else:
            about = self._hear(
                estimate.mass_kg,
                estimate.std_kg,
                news.stamp_ns,
                behind_s,
            )
        entries = {
            **online_entries(feed, estimate, behind_s),
            **_about_load(load),
            **about,
        }
        self.publish_estimate(level, probe.name, words, entries, news.stamp_ns)
        if load is None:
            self._withdraw_load()
            return
        self.load = None  # the hand may hold something else since
        self.held = Load(held, estimate.std_kg, load.com_m)
        self.held_ns = news.stamp_ns
        self._publish_numbers(probe, {probe.answer[0]: held})
        frame = self._node.values["frame_prefix"] + link
        self._publish_load(news.stamp_ns, frame, load)

    def no_news(self, feed: OnlineFeed, why: str) -> None:
        """What the running estimate said stands no longer; ``why`` in a sentence."""
        self.withdraw()
        self.late = ""
        entries = withdrawn_entries(feed, why) | self._holding.entries(0)
        self.publish_estimate("warning", feed.probe.name, why, entries)

    def _hear(
        self,
        mass_kg: float,
        std_kg: float,
        stamp_ns: int | None = None,
        behind_s: float = 0.0,
    ) -> dict[str, Any]:
        """Take an estimate of all that is in the hand; what it says of whether there is something.

        Args:
            mass_kg: What is held.
            std_kg: Its standard deviation.
            stamp_ns: Of the newest sample that it rests on; None: now.
            behind_s: How long ago that was [s].
        """
        # since when is by the node's clock, whatever clock the samples have
        now_ns = self._now_ns() - round(1e9 * behind_s)
        self._holding.hear(now_ns, mass_kg, std_kg)
        self._stamped.holding(
            self.link,
            self._holding,
            now_ns if stamp_ns is None else stamp_ns,
        )
        if self._holding.state not in (None, self._told):
            self._told = self._holding.state
            self._held.publish(Bool(data=self._told))
        return self._holding.entries(now_ns)

    def _forget_holding(self, stamp_ns: int) -> None:
        """It is not known any more whether something is held."""
        if self._holding.state is not None:
            self._holding.forget()
            self._stamped.holding(self.link, self._holding, stamp_ns)

    def _publish_numbers(
        self,
        probe: Probe[Any],
        values: Mapping[str, float],
    ) -> None:
        for topic, name in probe.numbers.items():
            if name in values:
                publish = self._numbers[topic].publish
                publish(messages.number(values[name]))
                self._standing[topic] = partial(publish, messages.number(math.nan))

    def _publish_load(self, now_ns: int, frame: str, carried: Carried) -> None:
        def withdraw() -> None:
            self._load.publish(
                messages.inertia(
                    self._now_ns(),
                    frame,
                    messages.UNKNOWN_LOAD,
                )
            )

        self._load.publish(messages.inertia(now_ns, frame, carried))
        self._standing["load"] = withdraw

    def withdraw(self) -> None:
        """What was published of the hand says nothing about what is in it now; `~/estimate`, which has a stamp, stands."""
        self._forget_holding(self._now_ns())
        self._withdraw_load()

    def _withdraw_load(self) -> None:
        self.load = self.held = None
        while self._standing:
            _, withdraw = self._standing.popitem()
            withdraw()


def _about_load(carried: Carried | None) -> dict[str, Any]:
    """What `~/payload` cannot say of itself."""
    return {} if carried is None else {"inertia": carried.inertia_is}
