"""The excitation node: makes probe sequences. The driver holds or ends the current by itself when this node falls silent."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

from proprio_ros import clock
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.excitation.commands import Command, JointSample, JointStates
from proprio_ros.excitation.controller_kinds import CONTROLLER_KINDS
from proprio_ros.excitation.guards import Guards
from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.nodes import messages
from proprio_ros.nodes.command_watchdog import FALLBACK_S, CommandWatchdog
from proprio_ros.nodes.managed_node import IDLE_PAUSE_S, ManagedNode
from proprio_ros.nodes.outputs import ControllerOutput, DriverOutput, Output, controller_of
from proprio_ros.nodes.parameters import value_of
from proprio_ros.nodes.process import run_node
from proprio_ros.nodes.qos import COMMANDS, LATCHED, STREAM
from proprio_ros.nodes.services import LongService
from proprio_ros.nodes.switching import SwitchedRuns, switching_of
from proprio_ros.nodes.tables import DEFAULT_PROBE, EXCITATION, INPUT_TOPICS, fields_stated
from proprio_ros.recordings.description import robot_named
from proprio_ros.recordings.topics import APPLIED_EFFORT, CURRENT_COMMAND

# at rest, too: who missed the last word of a sequence waits for the next
STATUS_PERIOD_S = 0.1
REST_PERIOD_S = 1.0
LEASE_S = 1.5
"""Whoever says on ~/lease that it wants the sequence says so ten times a second; without a word for so long it is gone."""
STATES = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
"""Of several publishers on one topic none takes another's place, and 500 a second wait while the node rests."""
# from a current command to the driver's word that it flows: two cycles, and a late one
UNPUSHED_S = 0.1
DRIVER_SILENT_S = 3.0
"""The driver publishes its state every second; a word that is older may be that of a driver that is gone."""
# that a node at rest hears one after the other: timer, joint states, what is applied, torque, driver, lease
STREAMS = 6
HOLD_PAUSE_S = 0.002
"""Between two wake-ups while efforts hold the arm: at 500 joint states a second each would have its own, and take a core."""
BLIND_PATIENCE = 3.0
"""Times `stale_after`: a sequence that is held by efforts waits no longer for joint states, for nobody sees the arm meanwhile."""
LIMP = ("stopped", "released", "inactive")
"""States of the driver in which it takes no commands until somebody has called a service."""


class ExcitationNode(ManagedNode):
    """Joint states in, current and position commands out, by the state machine."""

    parameters = EXCITATION

    urgent = True

    @property
    def real_time(self) -> bool:
        return bool(self.values["real_time"]) and self._falls_unheard

    @property
    def _falls_unheard(self) -> bool:
        """Whether the arm comes down without this node; this package's driver holds it where it is."""
        kind = CONTROLLER_KINDS.get(self.values["command_interface"])
        return kind is not None and kind.falls_unheard

    @property
    def pause_s(self) -> float:
        if not self.active:
            return IDLE_PAUSE_S
        return HOLD_PAUSE_S if self._output.holds else 0.0 if self._machine.busy else IDLE_PAUSE_S

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("excitation", **kwargs)
        self._sample: JointSample | None = None
        self._leased_at_s: float | None = None
        self._driver_state = self._driver_words = ""
        self._driver_at_s = -math.inf
        self._switched: SwitchedRuns | None = None
        self._unpushed_since_s: float | None = None
        self._torque_enabled: bool | None = None  # None: the driver does not say
        self._count = 0
        self._published_at_s = -math.inf
        self._published: tuple[Any, ...] = ()

    def configure(self) -> None:
        self._robot = robot_named(self.values["robot"])
        interface = self.values["command_interface"]
        ours = interface == "driver"
        if ours and self.values["controller_manager"]:
            kinds = " or ".join(CONTROLLER_KINDS)
            raise ConfigurationError(
                f"controller_manager is for command_interface:={kinds}: leave it out"
            )
        guards = Guards(**fields_stated(Guards, self.values))
        if self._falls_unheard:
            guards = replace(guards, patience_s=BLIND_PATIENCE * guards.stale_after_s)
        self._machine = ExcitationMachine(self._robot, guards)
        self._joint_states = JointStates(self._machine.joints, self.values["stale_after"])
        if value_of(self, "probe") != DEFAULT_PROBE:  # not every robot can make the default
            load_sequence(value_of(self, "probe"), self._robot)
        self.add_on_set_parameters_callback(self._on_parameters)
        self._output: Output
        if ours:
            currents = self.create_publisher(Float64MultiArray, CURRENT_COMMAND, COMMANDS)
            self._output = DriverOutput(
                currents, self.create_publisher(Float64MultiArray, "position_command", COMMANDS)
            )
        else:
            self._output = self._controller_output(interface)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self.listen(
            JointState,
            "joint_states",
            self._on_joint_state,
            STATES,
            together=lambda: not (ours and self._machine.busy),
        )
        if ours:  # else this node says itself what it commands
            self.listen(JointState, APPLIED_EFFORT, self._on_applied_effort, COMMANDS)
        self.create_subscription(Bool, "~/lease", self._on_lease, COMMANDS)
        self.create_subscription(Bool, "torque_enabled", self._on_torque_enabled, LATCHED)
        self.create_subscription(DiagnosticStatus, "driver/status", self._on_driver, LATCHED)
        if self._switched is None:
            self.create_service(Trigger, "~/run", self._on_run)
        else:
            LongService(self, "~/run", self._switched.run)
        self.create_service(Trigger, "~/abort", self._on_abort)
        self.create_service(Trigger, "~/release", self._on_release)
        self.every(0.02, self._on_timer)

    def activate(self) -> None:
        self._tell()

    def deactivate(self) -> None:
        try:
            if self._machine.busy:
                self._abort("the excitation node was told to end")
                # the process ends after this, and takes with it what was not yet sent
                self._status.wait_for_all_acked(Duration(seconds=FALLBACK_S))
        finally:
            try:
                self._output.finish()
            finally:
                self._hand_back()

    def cleanup(self) -> None:
        self._output.close()
        self._switched = None
        self.remove_on_set_parameters_callback(self._on_parameters)

    def _controller_output(self, interface: str) -> Output:
        topic = self.values["input_topic"] or INPUT_TOPICS[interface]
        commands = self.create_publisher(Float64MultiArray, topic, COMMANDS)
        controller = controller_of(self, self._robot, topic)
        applied = self.create_publisher(JointState, controller.recorded_on, STREAM)
        with suppress(ProprioError):  # an arm that is held waits for nothing that takes long
            load_sequence(DEFAULT_PROBE, self._robot)
        switching = switching_of(self, commands.topic_name)
        watchdog = CommandWatchdog(
            commands.topic_name,
            None if switching is None else switching.controllers,
            self.real_time,
        )
        output = ControllerOutput(self, controller, commands, applied, watchdog)
        if switching is not None:
            self._switched = SwitchedRuns(self, switching, watchdog, output)
        return output

    def _on_parameters(self, parameters: list[RosParameter]) -> SetParametersResult:
        """A probe that cannot be made is refused when it is named, with the reason."""
        try:
            for named in (parameter for parameter in parameters if parameter.name == "probe"):
                load_sequence(str(named.value), self._robot)
        except ProprioError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_joint_state(self, message: JointState) -> None:
        now = self.now_s()
        sample = self._joint_states.add(
            now,
            message.name,
            message.position,
            message.velocity,
            1e-9 * messages.time_ns(message.header.stamp),
        )
        if sample is not None:
            self._sample = sample
            self._tick(now)
        if self.active and any(name in self._machine.joints for name in message.name):
            lost = self._output.hear(message, now, whole=sample is not None)
            if lost:
                remedy = (
                    "check sign and unit of the efforts, what it carries, and who else moves it"
                )
                if "paused" in lost:
                    remedy = "keep this computer free, or run this node beside controller_manager with real-time priority"
                self.say("error", f"the arm is let go: {lost}; {remedy}")
                self._abort(f"the arm was let go: {lost}")

    def _on_lease(self, message: Bool) -> None:
        self._leased_at_s = clock.now() if message.data else None

    def _on_torque_enabled(self, message: Bool) -> None:
        self._torque_enabled = message.data

    def _on_applied_effort(self, message: JointState) -> None:
        """The driver may refuse to push, or end a push: a limit, a hot motor, a fault. Nobody else would notice here."""
        machine = self._machine
        if machine.sequence is None or machine.phase is not Phase.PROBE or any(message.effort):
            self._unpushed_since_s = None
            return
        run = machine.sequence.runs[machine.run_number - 1]
        if run.is_free_response and not self._torque_enabled:  # no effort is what was asked for
            self._unpushed_since_s = None
            return
        now = self.now_s()
        if self._unpushed_since_s is None:
            self._unpushed_since_s = now
        elif now - self._unpushed_since_s > UNPUSHED_S:
            words = f"the driver does not {'let go of' if run.is_free_response else 'push'} {run.joint}, or has ended it"
            self._abort(f"{words}: its log and /diagnostics say why", aloud=True)

    def _on_driver(self, message: DiagnosticStatus) -> None:
        """An arm that was let go of falls: what it does then is no fault of the probe, and nobody should look for one there."""
        self._driver_state = messages.values_of(message).get("state", "")
        self._driver_words = message.message
        self._driver_at_s = clock.now()
        if self._machine.busy and self._limp:
            self._abort(f"the driver was {self._limp}", aloud=True)
        self._tell_when_due()

    @property
    def _limp(self) -> str:
        """State and words of a driver that takes no commands; empty where it does, or where it does not say."""
        known = clock.now() - self._driver_at_s < DRIVER_SILENT_S
        return (
            f"{self._driver_state}: {self._driver_words}"
            if known and self._driver_state in LIMP
            else ""
        )

    def _on_timer(self) -> None:
        """Joint states drive the machine; this only notices when they stop coming, or whoever asked for the sequence is gone."""
        now = self.now_s()
        # whoever asked runs in real time, whatever the simulation's does
        if self._leased_at_s is not None and clock.now() - self._leased_at_s > LEASE_S:
            self._leased_at_s = None
            if self._machine.busy:
                words = "whoever asked for the sequence has fallen silent: is the identifier node alive?"
                self._abort(words, aloud=True)
        if (
            self._sample is None
            or abs(now - self._sample.time_s) > 0.5 * self.values["stale_after"]
        ):
            self._tick(now)
        if self.active and not self._fresh:
            self._output.unheard()
        self._tell_when_due()

    def _tick(self, now: float) -> None:
        machine = self._machine
        if not machine.busy:
            return
        if self._output.controller is not None:
            machine.pace = self._output.controller.pace
        command = machine.tick(now, self._sample)
        self._send(command)
        if not machine.busy:
            self._hand_back()
        if machine.phase is Phase.ABORTED:
            self.say("error", f"aborted: {machine.abort_reason}")
        elif machine.phase is Phase.DONE:
            self.say("info", machine.message)
        self._tell_when_due()

    def _abort(self, reason: str, aloud: bool = False) -> None:
        self._machine.abort(reason)
        self._send(self._machine.command)
        self._hand_back()
        self._tell()
        if aloud:
            self.say("error", f"aborted: {self._machine.abort_reason}")

    def _send(self, command: Command) -> None:
        self._output.send(command, slipped=self._machine.aborted_by == "jump")

    def _hand_back(self) -> None:
        """However a sequence ended, controllers are what they were."""
        if self._switched is not None:
            self._switched.back()

    @property
    def busy(self) -> bool:
        """Whether a sequence is under way."""
        return self._machine.busy

    def refused(self) -> str:
        """Why no sequence can begin now, or an empty string."""
        if not self.active:
            return "the excitation node is not active"
        machine = self._machine
        if machine.busy:
            assert machine.sequence is not None
            run = f"run {machine.run_number} of {machine.runs}"
            return f"{machine.sequence.name} is under way ({run}): wait for its end, or abort it"
        if self._limp:
            return f"the driver is {self._limp}"
        if self.now_s() == 0.0:
            return "use_sim_time is set, and no time comes on /clock: start the simulation, or set it to false"
        if not self._fresh:
            self._tell()  # `joint_states` says the same to a program
            return "no joint states are coming: start the driver, and check its bus and the topic joint_states"
        try:
            sequence = load_sequence(value_of(self, "probe"), self._robot)
            self._output.check(sequence)
        except ProprioError as error:
            return str(error)
        if any(run.is_free_response for run in sequence.runs) and self._torque_enabled is None:
            nobody = f"nobody says on {self.resolve_topic_name('torque_enabled')} when a joint is let go of"
            use = "a recording of free swings is of no use without; start proprio_ros' driver"
            return f"{sequence.name}: {nobody}, and {use}"
        return ""

    def _on_run(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self.begin_run()
        return response

    def begin_run(self) -> tuple[bool, str]:
        """Begin the sequence now; whether it has begun, and what there is to say."""
        why = self.refused()
        if why:
            return False, why
        assert self._sample is not None
        try:
            controller = self._output.controller
            held_kg = 0.0 if controller is None else controller.held_kg
            sequence = load_sequence(value_of(self, "probe"), self._robot, held_kg)
            self._machine.start(sequence, self._sample)
            self._output.begin()
        except ProprioError as error:
            return False, str(error)
        self._count += 1
        self._tell()
        # the count says to whoever listens to ~/status which sequence a status belongs to
        return True, f"sequence {self._count}: {sequence.name}, {self._machine.runs} runs"

    def _on_abort(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        response.message = "nothing was under way"
        if self._machine.busy:
            self._abort("by ~/abort")
            response.message = "aborted; the arm is held"
        return response

    def _on_release(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        if self._machine.busy:
            self._abort("by ~/release")
        held = (
            self._switched
            if self._switched is not None and self._switched.engaged
            else self._output
        )
        response.success = True
        response.message = held.release()
        return response

    def _tell_when_due(self) -> None:
        """By the clock on the wall: who listens must hear that we are alive, though a simulation may pause."""
        due = clock.now() - self._published_at_s >= (
            STATUS_PERIOD_S if self._machine.busy else REST_PERIOD_S
        )
        if self.active and (due or self._state() != self._published):
            self._tell()

    @property
    def _fresh(self) -> bool:
        """Whether joint states are coming."""
        sample = self._sample
        # a sample from the future is of a simulation that was set back since; at rest, joint states wait for their turn
        patience_s = self.values["stale_after"] + STREAMS * self.pause_s
        return sample is not None and abs(self.now_s() - sample.time_s) <= patience_s

    def _state(self) -> tuple[Any, ...]:
        """What is published as soon as it changes."""
        machine = self._machine
        return (
            machine.phase,
            machine.run_number,
            machine.attempt,
            self._count,
            self._fresh,
            self._limp,
        )

    def _tell(self) -> None:
        machine = self._machine
        sequence = self._machine.sequence
        self._published = self._state()
        self._published_at_s = clock.now()
        values = {
            "sequence": self._count,
            "phase": machine.phase.value,
            "joint_states": self._fresh,
            "driver": self._limp,
            "busy": machine.busy,
            "probe": sequence.name if sequence else "",
            "hand": sequence.hand if sequence else "any",
            "run": machine.run_number,
            "runs": machine.runs,
            "attempt": machine.attempt,
            "fraction": round(machine.fraction, 4),
            "good_runs": sum(outcome.used for outcome in machine.outcomes),
            "reason": machine.abort_reason,
            "aborted_by": machine.aborted_by,
        }
        level = "error" if machine.phase is Phase.ABORTED else "ok"
        self._status.publish(
            messages.status(
                level,
                "excitation",
                machine.message,
                values,
            )
        )


def main() -> int:
    """Entry point of `proprio_excitation`."""
    return run_node(ExcitationNode)


if __name__ == "__main__":
    raise SystemExit(main())
