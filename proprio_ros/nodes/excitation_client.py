"""The excitation node as the identifier sees it: asked for sequences, and watched while it makes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from proprio_ros import clock
from proprio_ros.live.job import Job, JobError
from proprio_ros.nodes import messages
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.qos import COMMANDS, LATCHED

READY_S = 4.0
SEEN_S = 12.0
"""Patience with whoever is not there, and from the node's own start on: who uses DDS announces itself every 3 s, and on a busy
computer the first words are lost."""
SILENT_S = 3.0
"""The excitation node publishes its state ten times a second while it is busy; without a word for so long it is gone."""
# the excitation node ends a sequence when whoever asked for it has been silent for 1.5 s
LEASE_PERIOD_S = 0.1
CALL_S = 5.0
ABORT_S = 2.0


class Excitation:
    """Clients and the status of an excitation node; ``on_progress`` is called with each status while it is busy.

    Attributes:
        values: Of its newest status.
        closing: Whether the asking node is ending itself: nobody is left to hear an answer.
    """

    def __init__(
        self,
        node: ManagedNode,
        on_progress: Callable[[str, dict[str, str]], None],
    ) -> None:
        self._on_progress = on_progress
        self.name = str(node.values["excitation_node"])
        self.values: dict[str, str] = {}
        self.closing = False
        self._heard_s = self._unfed_s = -1e9
        self._asking = False
        node.create_subscription(DiagnosticStatus, f"{self.name}/status", self.on_status, LATCHED)
        self.set_probe = node.create_client(SetParameters, f"{self.name}/set_parameters")
        self.run = node.create_client(Trigger, f"{self.name}/run")
        self._abort = node.create_client(Trigger, f"{self.name}/abort")
        self._lease = node.create_publisher(Bool, f"{self.name}/lease", COMMANDS)
        node.every(LEASE_PERIOD_S, self._renew_lease)

    def on_status(self, message: DiagnosticStatus) -> None:
        self.values = messages.values_of(message)
        self._heard_s = clock.now()
        if self.values.get("joint_states") != "true":
            self._unfed_s = self._heard_s
        if self.values.get("busy") == "true":
            self._on_progress(message.message, self.values)

    def _renew_lease(self) -> None:
        if self._asking:
            self._lease.publish(Bool(data=True))

    def missing(self) -> str:
        """Why no sequence can be made yet, or an empty string. Raises `JobError`: Waiting does not help."""
        if not self.run.service_is_ready() or not self.set_probe.service_is_ready():
            return f"there is no {self.name} node; start it"
        if self.values.get("driver"):
            raise JobError(f"the driver is {self.values['driver']}")
        if self.values.get("joint_states") != "true":
            return f"no joint states reach {self.name}; are the topics named alike?"
        return ""

    def make(self, job: Job, sequence: str, begun: Callable[[], None] = lambda: None) -> None:
        """Ask for a sequence and wait until it has ended well.

        Args:
            job: Under which it is done; cancelling it ends the sequence.
            sequence: As the excitation node takes it.
            begun: Is called when the sequence is under way.

        Raises:
            JobError: It was refused, aborted, cancelled, or the node fell silent.
        """
        named = RosParameter("probe", RosParameter.Type.STRING, sequence).to_parameter_msg()
        results = self._call(
            self.set_probe, SetParameters.Request(parameters=[named]), tries=2
        ).results
        if not results or not results[0].successful:
            raise JobError(
                f"the excitation node refuses {sequence!r}: {results[0].reason if results else 'no answer'}"
            )
        begun_s = asked_s = clock.now()
        answer = self._call(self.run, Trigger.Request())
        while not answer.success and clock.now() - begun_s < READY_S:
            if job.cancelled.wait(0.2):
                raise JobError("cancelled")
            # where its status says that no joint states reached it: a pause of the bus, over in a second, and nothing has moved
            if self._unfed_s < asked_s:
                break
            asked_s = clock.now()
            answer = self._call(self.run, Trigger.Request())
        if not answer.success:
            raise JobError(f"the excitation node refuses: {answer.message}")
        number = answer.message.split(":")[0].removeprefix("sequence ")
        self._asking = True
        heard_s = clock.now()
        self._renew_lease()
        begun()
        try:
            while True:
                if job.cancelled.wait(0.02):
                    self._stop(number)
                    raise JobError("cancelled")
                values = self.values
                # one that was started again knows nothing of it, and says so at rest
                if values.get("sequence") == number:
                    heard_s = max(self._heard_s, heard_s)
                    if values.get("busy") == "false":
                        break
                if clock.now() - heard_s > SILENT_S:
                    raise JobError(
                        "the excitation node has fallen silent: the driver holds the arm; restart the node"
                    )
        finally:
            self._asking = False
            self._lease.publish(Bool(data=False))
        if values.get("phase") == "aborted":
            raise JobError(
                f"the probe was aborted: {values.get('reason')}", values.get("aborted_by", "")
            )

    def _stop(self, number: str) -> None:
        """Abort a sequence and see it end."""
        self._abort.call_async(Trigger.Request())
        deadline = clock.now() + ABORT_S
        while not self.closing and clock.now() < deadline:
            if self.values.get("sequence") == number and self.values.get("busy") == "false":
                return
            clock.sleep(0.01)

    def _call(self, client: Any, request: Any, tries: int = 1) -> Any:
        """Call a service and wait for its answer, at most `CALL_S` in all.

        A call just after the start may have been obeyed and its answer lost, where who answers had not yet heard of who asks: what
        may be asked twice is.
        """
        answered = clock.event()
        for _ in range(tries):
            future = client.call_async(request)
            future.add_done_callback(lambda _: answered.set())
            if answered.wait(CALL_S / tries):
                return future.result()
            client.remove_pending_request(future)
        raise JobError(f"{client.srv_name} does not answer: is the excitation node running?")
