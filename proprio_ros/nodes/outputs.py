"""Where the excitation node's commands go: this package's driver, or an effort or position controller of somebody else's.

The driver holds what is not pushed, and ends a push when it hears nothing. A controller of others does neither, so its output says
at every joint state what holds the joints, and says what it can before it ends.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from collections.abc import Mapping
from typing import Any

from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from proprio_ros import clock
from proprio_ros.errors import ExcitationError
from proprio_ros.excitation.commands import Command
from proprio_ros.excitation.controller_kinds import CONTROLLER_KINDS
from proprio_ros.excitation.controllers import Controller
from proprio_ros.excitation.plans import ExcitationSequence
from proprio_ros.excitation.remote_clock import RemoteClock
from proprio_ros.nodes import messages
from proprio_ros.nodes.command_watchdog import FALLBACK_S, CommandWatchdog
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.robot import Robot

RECORD_PERIOD_S = 0.01  # what is commanded is recorded when it changes, and so often
# a command that is sent later before an update than this is taken by the next
ON_THE_WAY_NS = 500_000
# for so long zeros are said when joints are lost; then whoever takes over is not disturbed
LET_GO_S = 0.3


def controller_of(node: ManagedNode, robot: Robot, topic: str) -> Controller:
    """As the node's parameters state it; the log says what that means for whoever stands beside the arm.

    Args:
        node: Whose parameters they are.
        robot: The arm.
        topic: Where the controller listens.

    Raises:
        ConfigurationError: The parameters do not fit the robot.
    """
    values = node.values
    switches = "this node switches no controllers: activate that one first, and "
    if values["controller_manager"]:
        switches = ""
    controller = CONTROLLER_KINDS[values["command_interface"]].of_parameters(robot, values)
    goes = controller.announced.format(topic=topic)
    node.say("warning", f"{goes}; {switches}{controller.beside} (docs: hardware and safety)")
    return controller


class Output(ABC):
    """Takes what the state machine commands.

    Attributes:
        holds: Whether this node, and nobody else, holds the arm through it.
        controller: Whose commands they are; None: this package's driver's.
    """

    holds = False
    controller: Controller | None = None

    @abstractmethod
    def check(self, sequence: ExcitationSequence) -> None:
        """Whether a sequence can be made now.

        Raises:
            ExcitationError: It cannot.
        """

    @abstractmethod
    def send(self, command: Command, slipped: bool) -> None:
        """A command; ``slipped``: after an encoder has, positions from before are other places."""

    @abstractmethod
    def release(self) -> str:
        """Let go, if it is this that holds the arm; says what was done."""

    @abstractmethod
    def finish(self) -> None:
        """Last words, after which the process may end."""

    @abstractmethod
    def begin(self) -> None:
        """A sequence begins."""

    @abstractmethod
    def hear(self, message: JointState, now_s: float, whole: bool) -> str:
        """A joint state has come.

        Args:
            message: The joint state.
            now_s: When it came, on the node's clock [s].
            whole: Whether all joints of the arm were seen of late.

        Returns:
            Why the arm is not held any more, where it was until now; else an empty string.
        """

    @abstractmethod
    def unheard(self) -> None:
        """No joint states come."""

    @abstractmethod
    def hand_over(self) -> None:
        """Others hold the arm from now on."""

    @abstractmethod
    def close(self) -> None:
        """What it has opened is not needed any more."""


class DriverOutput(Output):
    """Labelled currents and positions to this package's driver."""

    def __init__(self, currents: Any, positions: Any) -> None:
        self._currents = currents
        self._positions = positions
        self._driving = False

    def check(self, sequence: ExcitationSequence) -> None:
        if any(run.goal_step for run in sequence.runs):
            words = "start this node with command_interface:=position, or choose a sequence with currents"
            raise ExcitationError(f"{sequence.name} pushes by steps of goals: {words}")

    def send(self, command: Command, slipped: bool) -> None:
        """Currents first: an empty one ends the push at once, and what is not driven is held."""
        if command.current_A or self._driving:
            self._currents.publish(messages.labelled(command.current_A))
        self._driving = bool(command.current_A)
        # to an encoder that has slipped the last position is another place, and the arm would go there; the driver holds it
        if command.position and not slipped:
            self._positions.publish(messages.labelled(command.position))

    def release(self) -> str:
        return "the driver holds the arm: /driver/torque lets go of it"

    def finish(self) -> None:
        self._currents.wait_for_all_acked(Duration(seconds=FALLBACK_S))

    def begin(self) -> None:
        """The driver holds the arm already."""

    def hear(self, message: JointState, now_s: float, whole: bool) -> str:
        """Nothing: the driver holds the arm by itself.

        Args:
            message: Not used.
            now_s: Not used [s].
            whole: Not used.

        Returns:
            An empty string.
        """
        return ""

    def unheard(self) -> None:
        """The driver ends a push by itself."""

    def hand_over(self) -> None:
        """The driver takes commands only."""

    def close(self) -> None:
        """Publishers are the node's."""


class ControllerOutput(Output):
    """Efforts or goals to a `forward_command_controller`, or another that takes the same.

    Args:
        node: Publishes.
        controller: Whose commands they are.
        commands: Publisher to the controller.
        applied: Publisher of what pushes, or of the goals, for whoever records.
        watchdog: Publishes where this process cannot any more.
    """

    holds = True
    controller: Controller

    def __init__(
        self,
        node: ManagedNode,
        controller: Controller,
        commands: Any,
        applied: Any,
        watchdog: CommandWatchdog,
    ) -> None:
        self._node = node
        self.controller = controller
        self._let_go_at_end = controller.can_let_go and node.values["on_end"] == "zero"
        self._commands = commands
        self._applied = applied
        self._watchdog = watchdog
        self._topic = self._commands.topic_name
        self._clock = RemoteClock()  # of the joint states
        self._heard = False
        self._blind = False
        self._said_ns = clock.now_ns()
        self._recorded: dict[str, float] = {}
        # by when it was sent, on the clock of the joint states
        self._untaken: dict[int, dict[str, float]] = {}
        self._recorded_at_s = -1e9
        self._lost_at_s = -1e9

    def check(self, sequence: ExcitationSequence) -> None:
        if self._node.count_subscribers(self._topic) == 0:
            raise ExcitationError(
                f"nobody listens to {self._topic}: load and activate the controller"
            )
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        # beside this node's own
        if sum(not self._watchdog.is_publisher(info) for info in publishers) > 1:
            raise ExcitationError(
                f"somebody else publishes on {self._topic}, too: end it first, for the last command counts"
            )
        if not self._watchdog.alive:
            raise ExcitationError(
                "the process that holds the arm if this one is killed has ended: start this node again"
            )
        if not self._watchdog.heard:
            raise ExcitationError(
                f"the process that holds a killed node's arm has not found {self._topic} yet: ask again"
            )
        self.controller.check(sequence)

    def begin(self) -> None:
        self.controller.begin()

    def send(self, command: Command, slipped: bool) -> None:
        """What `hear` and `unheard` say from now on."""
        if slipped:
            self.controller.take_here()
        else:
            self.controller.take(command)

    def hear(self, message: JointState, now_s: float, whole: bool) -> str:
        """The controller takes the reading, and is answered while it holds the arm.

        Args:
            message: The joint state.
            now_s: When it came, on the node's clock [s].
            whole: Whether all joints of the arm were seen of late.

        Returns:
            Why the arm is not held any more, where it was until now; else an empty string.
        """
        stamp_ns = messages.time_ns(message.header.stamp)
        now_ns = self._node.get_clock().now().nanoseconds
        self._clock.hear(stamp_ns or now_ns, clock.now_ns())
        stamp_ns = stamp_ns or self._clock.at(clock.now_ns())
        controller = self.controller
        lost = controller.lost
        position = dict(zip(message.name, message.position, strict=False))
        controller.observe(1e-9 * stamp_ns or now_s, position, now_s)
        if self._blind:  # it is not where it was, and would be thrown back
            controller.take_here()
        self._heard = True
        self._blind = False
        self._take_up(stamp_ns)
        if controller.holding:
            self._say(controller.commands() if whole else controller.steady())
            if controller.lost and not lost:
                self._lost_at_s = clock.now()
            elif controller.lost and clock.now() - self._lost_at_s > LET_GO_S:
                self._let_go()
        self._record()
        return "" if lost else controller.lost

    def unheard(self) -> None:
        """What held the arm at last; nobody can do better who does not see it."""
        if self.controller.holding:
            self._blind = True
            self._say(self.controller.steady())
        self._record()
        self._take_up(None)

    def release(self) -> str:
        self.controller.slipped.clear()  # whoever asks has looked at the arm
        if not self.controller.holding:
            return "nothing was held"
        self._let_go()
        return self.controller.let_go

    def hand_over(self) -> None:
        self.controller.release()
        self._watchdog.clear()

    def finish(self) -> None:  # the controller keeps the last command, whatever becomes of us
        if not self.controller.holding:
            return
        last = [0.0] * len(self.controller.joints)
        try:
            if not self._let_go_at_end:
                last = self.controller.steady()
        finally:
            self._say(last)
            self._record()
            self._take_up(None)
            self.controller.holding = False
            for publisher in (self._commands, self._applied):
                publisher.wait_for_all_acked(Duration(seconds=FALLBACK_S))
            self._watchdog.clear()

    def close(self) -> None:
        self._watchdog.close()

    def _say(self, commands: list[float]) -> None:
        # before it is sent: a pause after it would have it sent late
        self._said_ns = clock.now_ns()
        self._commands.publish(Float64MultiArray(data=array("d", commands)))
        if self._watchdog.due:
            zeros = [0.0] * len(commands)
            self._watchdog.update(
                zeros if self._let_go_at_end else self.controller.holding_command()
            )

    def _let_go(self) -> None:
        self._say(self.controller.release())
        self._watchdog.clear()

    def _record(self) -> None:
        """Remember what drives the joints, for whoever records, when it changes and now and then."""
        record = self.controller.record
        now_s = clock.now()
        if not self._heard or not record:
            return  # on whose clock?
        if record != self._recorded or now_s - self._recorded_at_s >= RECORD_PERIOD_S:
            self._recorded = record
            self._recorded_at_s = now_s
            said_ns = self._said_ns if self.controller.holding else clock.now_ns()
            self._untaken[self._clock.at(said_ns)] = record

    def _take_up(self, stamp_ns: int | None) -> None:
        """Publish what was sent, stamped with when the controller took it: its next update, of which a joint state tells.

        Without one, what was sent is stamped as it was.
        """
        if stamp_ns is None:
            for sent_ns, record in self._untaken.items():
                self._publish_applied(sent_ns, record)
            self._untaken.clear()
            return
        taken = [sent_ns for sent_ns in self._untaken if sent_ns + ON_THE_WAY_NS <= stamp_ns]
        records = [self._untaken.pop(sent_ns) for sent_ns in taken]
        if records:  # an update takes the newest command
            self._publish_applied(stamp_ns, records[-1])

    def _publish_applied(self, taken_ns: int, record: Mapping[str, float]) -> None:
        when_ns = taken_ns + round(1e9 * self.controller.late_s)
        values = {self.controller.recorded_as: list(record.values())}
        self._applied.publish(
            messages.joint_state(
                when_ns,
                list(record),
                **values,
            )
        )
