"""Numbers and progress for programs: the messages and the action of proprio_msgs.

That package is built beside this one where ROS's generators are. Without it, as after an installation by pip, all here does
nothing, and the services and diagnostics are as they always are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from action_msgs.msg import GoalInfo
from action_msgs.srv import CancelGoal
from rclpy.action import ActionServer, CancelResponse, GoalResponse

from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.excitation.plans import Until
from proprio_ros.live.holding import Holding
from proprio_ros.live.job import WEIGH, Job
from proprio_ros.nodes import messages
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.qos import LATCHED
from proprio_ros.nodes.services import Answer
from proprio_ros.probes import all_probes, probe_at_work
from proprio_ros.probes.base import Probe

try:
    from proprio_msgs.action import Weigh
    from proprio_msgs.msg import ElasticityEstimate, MassEstimate
    from proprio_msgs.msg import Holding as HoldingMessage
except ImportError:
    Weigh = MassEstimate = ElasticityEstimate = HoldingMessage = None

ACTION = "weigh_action"
"""Not the name of the service ``weigh``: ``ros2 service`` and ``ros2 action`` list names without saying which is meant."""
_FIELDS = {"kg": "mass", "Pa": "youngs_modulus"}


def _number(value: Any) -> float:
    return float(value) if isinstance(value, (int, float)) else math.nan


def _numbers(value: Any, count: int) -> list[float]:
    """As many; NaN where one of them is not known."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
        return [math.nan] * count
    return [_number(each) for each in value]


def fill(message: Any, probe: Probe[Any], entries: Mapping[str, Any]) -> Any:
    """Put numbers, verdict and reasons of an answer into a message.

    Args:
        message: Of an estimate, or a `Weigh` result.
        probe: Whose answer it is.
        entries: As in ``~/estimate``.

    Returns:
        The message.
    """
    name, unit = probe.answer
    setattr(message, _FIELDS[unit], _number(entries.get(name)))
    message.std = _number(entries.get(f"{name}.std"))
    message.interval = _numbers(entries.get(f"{name}.ci95"), 2)
    message.verdict = str(entries.get("verdict", ""))
    message.reasons = [str(text) for key, text in entries.items() if key.startswith("reason.")]
    if hasattr(message, "centre"):
        found = _numbers(entries.get(f"{probe.name}_com"), 3)
        message.centre.x, message.centre.y, message.centre.z = found
    return message


class StampedEstimates:
    """``~/mass_estimate``, ``~/elasticity_estimate`` and ``~/holding_estimate``: what ``~/estimate`` says, as numbers."""

    def __init__(self, node: ManagedNode) -> None:
        self._node = node
        self._publishers = {}
        if MassEstimate is None:
            words = f"proprio_msgs is not installed: no ~/{ACTION}, no estimates as messages with numbers"
            node.get_logger().debug(words)
            return
        mass = node.create_publisher(MassEstimate, "~/mass_estimate", LATCHED)
        elasticity = node.create_publisher(ElasticityEstimate, "~/elasticity_estimate", LATCHED)
        self._publishers = {"kg": (mass, MassEstimate), "Pa": (elasticity, ElasticityEstimate)}
        self._held = node.create_publisher(HoldingMessage, "~/holding_estimate", LATCHED)

    def publish(
        self, link: str, entries: Mapping[str, Any], stamp_ns: int
    ) -> Callable[[], None] | None:
        """An estimate of what a link holds, and nothing where the entries of ``~/estimate`` hold none, as those of the robot.

        Args:
            link: That holds it.
            entries: Of ``~/estimate``.
            stamp_ns: Of the newest sample that the estimate rests on.

        Returns: What withdraws it; None where no number of it stands.
        """
        probe = next((each for each in all_probes() if each.answer[0] in entries), None)
        if probe is None or probe.answer[1] not in self._publishers:
            return None
        publisher, kind = self._publishers[probe.answer[1]]

        def send(what: Mapping[str, Any], when_ns: int) -> None:
            message = fill(
                kind(probe=probe.name, final=bool(what.get("final"))),
                probe,
                what,
            )
            publisher.publish(self._headed(message, link, when_ns))

        send(entries, stamp_ns)
        if math.isnan(_number(entries.get(probe.answer[0]))):
            return None
        now = self._node.get_clock().now
        return lambda: send({"verdict": "withdrawn", "final": True}, now().nanoseconds)

    def holding(self, link: str, holding: Holding, stamp_ns: int) -> None:
        """Publish whether a link holds something, as far as that is known.

        Args:
            link: That may hold it.
            holding: What is known.
            stamp_ns: Of the newest sample that this rests on.
        """
        if self._publishers:
            known = {"known": holding.state is not None, "holding": bool(holding.state)}
            since = messages.time_message(holding.since_ns)
            message = HoldingMessage(probability=holding.probability, since=since, **known)
            self._held.publish(self._headed(message, link, stamp_ns))

    def _headed(self, message: Any, link: str, stamp_ns: int) -> Any:
        message.header.stamp = messages.time_message(stamp_ns)
        message.header.frame_id = self._node.values["frame_prefix"] + link if link else ""
        return message


class WeighAction:
    """The services that weigh, as an action: facts and sequence with the goal, progress meanwhile, numbers at the end.

    The goal is kept and executed when the job has ended: a callback that waited would keep a processor busy; see `LongService`.

    ``node``: that offers it; ``begin``: begins a job or answers why there can be none; ``check``: raises
    `ProprioError`, with the reason, where there can be no such job now.
    """

    def __init__(
        self,
        node: ManagedNode,
        begin: Callable[[Job, Answer], None],
        check: Callable[[Job], None],
    ) -> None:
        self._node = node
        self._begin = begin
        self._check = check
        self._goal: Any = None
        self._job: Job | None = None
        self._server = None
        if Weigh is not None:
            self._server = ActionServer(
                node,
                Weigh,
                f"~/{ACTION}",
                lambda goal: Weigh.Result(),
                goal_callback=self._on_goal,
                handle_accepted_callback=self._on_accepted,
                cancel_callback=self._on_cancel,
            )
            self._canceller = node.create_client(CancelGoal, f"~/{ACTION}/_action/cancel_goal")

    def destroy(self) -> None:
        """Offer it no more."""
        if self._server is not None:
            self._node.destroy_client(self._canceller)
            self._server.destroy()

    def cancel(self) -> bool:
        """Ask for the goal's end as its own client would, so that it ends as cancelled; False where that cannot be asked."""
        goal = self._goal
        if goal is None or not self._canceller.service_is_ready():
            return False
        self._canceller.call_async(CancelGoal.Request(goal_info=GoalInfo(goal_id=goal.goal_id)))
        return True

    def _on_goal(self, request: Any) -> GoalResponse:
        try:
            self._check(self._asked(request)[1])
        except ProprioError as error:  # a client hears no more than that it was refused
            self._node.say("warning", f"~/{ACTION} is refused: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _asked(self, request: Any) -> tuple[Probe[Any], Job]:
        """What a goal asks for. Raises `ConfigurationError`: There is no such weighing."""
        target = request.target or probe_at_work().name
        weighing = {each.name: each for each in all_probes() if each.answer[1] == "kg"} | {
            WEIGH: probe_at_work()
        }
        probe = weighing.get(target)
        if probe is None:
            raise ConfigurationError(f"target {target!r}: give one of {', '.join(weighing)}")
        job = Job(
            target,
            ACTION,
            settings=tuple(request.settings),
            sequence=request.sequence,
        )
        if request.half_interval != 0.0:
            job.until = Until(
                request.half_interval,
                "kg",
                request.at_most_s or Until.at_most_s,
            )
        if target == WEIGH and (job.sequence or job.until):
            raise ConfigurationError(
                f"target {WEIGH!r} makes no sequence: leave it empty, and half_interval at 0"
            )
        return probe, job

    def _on_accepted(self, goal: Any) -> None:
        probe, job = self._asked(goal.request)
        self._feedback = Weigh.Feedback(mass=math.nan)
        self._probe = probe
        self._job = job
        self._goal = goal

        def answer(success: bool, message: str) -> None:
            self._goal = self._job = None
            job.success = success
            job.message = message
            self._end(goal, probe, job)

        return self._begin(job, answer)

    def _on_cancel(self, goal: Any) -> CancelResponse:
        job = self._job
        if job is not None:
            job.cancelled.set()
        return CancelResponse.REJECT if job is None else CancelResponse.ACCEPT

    def hear(self, message: str, entries: Mapping[str, Any]) -> None:
        """What the identifier published on ``~/status`` or ``~/estimate``: progress of the job, or how its estimate goes."""
        goal = self._goal
        if goal is None or entries.get("doing") == "idle":
            return
        name = self._probe.answer[0]
        if name in entries:
            if entries.get("final"):
                return
            self._feedback.mass = _number(entries[name])
        else:
            self._feedback.phase = str(entries.get("phase") or message)
            self._feedback.fraction = float(entries.get("fraction") or self._feedback.fraction)
        goal.publish_feedback(self._feedback)

    def _end(
        self,
        goal: Any,
        probe: Probe[Any],
        job: Job,
    ) -> None:
        """The result, from any thread; the executor sends it."""

        def execute(_goal: Any) -> Any:
            if job.success:
                goal.succeed()
            elif goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
            entries = job.entries or {"verdict": "failed", "reason.1": job.message}
            return fill(
                Weigh.Result(bag=job.bag, message=job.message),
                probe,
                entries,
            )

        if self._node.executor is not None:  # else this node is ending
            goal.execute(execute)
