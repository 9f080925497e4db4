"""The virtual robot as a process, and the person beside it, who puts into the hand what a probe asks for."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import CallbackGroup
from rclpy.parameter import Parameter as RosParameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from proprio_ros import clock
from proprio_ros.clock import Pacer
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.nodes import messages
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.process import run_node
from proprio_ros.nodes.qos import FROM_MANY, LATCHED, STREAM
from proprio_ros.nodes.services import Answer, LongService, call, when_there
from proprio_ros.nodes.tables import CONTROLLERS, VIRTUAL
from proprio_ros.probes import virtual_object
from proprio_ros.recordings.description import robot_named
from proprio_ros.virtual.effort_driver import DRIVERS, EffortDriver
from proprio_ros.virtual.model import import_mujoco
from proprio_ros.virtual.objects import Payload
from proprio_ros.virtual.robot import VirtualRobot
from proprio_ros.virtual.truth import Truth

SWITCHED_S = 10.0  # the driver answers within 5 s


class _Polled(CallbackGroup):
    """Of a subscription that no executor waits for: whoever has it looks into it."""

    def can_execute(self, entity: Any) -> bool:
        return False

    beginning_execution = can_execute

    def ending_execution(self, entity: Any) -> None:
        pass


class VirtualNode(ManagedNode):
    """Opens a pseudo-terminal with servos and an arm behind it; or is an arm with a controller, as in `ros2_control`."""

    parameters = VIRTUAL

    urgent = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("virtual", **kwargs)
        self._robot: VirtualRobot | EffortDriver | None = None
        self._thread: clock.Thread | None = None
        self._hand = "any"
        self._content_is_out = False

    @property
    def real_time(self) -> bool:
        # hardware waits for no program; but ten virtual arms in real time would leave nothing to anybody
        return bool(self.values["real_time"])

    def configure(self) -> None:
        import_mujoco()  # takes a second, which none of the nodes has once it is active
        robot = robot_named(self.values["robot"])
        self._object = virtual_object(self.values["object"])
        self._reference = Payload(self.values["reference"])
        if self.values["truth"]:
            try:
                truth = Truth.from_json(Path(self.values["truth"]).read_text(encoding="utf-8"))
            except OSError as error:
                raise ConfigurationError(
                    f"truth {self.values['truth']}: cannot be read ({error.strerror})"
                ) from error
        elif self.values["seed"] < 0:
            truth = Truth.nominal(robot)
        else:
            truth = Truth.draw(
                robot,
                self.values["seed"],
                links=self.values["links"],
            )
        self._model = robot
        self._truth = truth
        self.add_on_set_parameters_callback(self._on_parameters)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._motors = self.create_publisher(JointState, "~/motors", 10)
        self.every(0.02, self._publish_motors)
        for interface, usual in CONTROLLERS.items():
            if interface == self.values["interface"]:
                topic = self.values["input_topic"] or usual
                self._states = self.create_publisher(JointState, "joint_states", STREAM)
                self._commands = self.create_subscription(
                    Float64MultiArray, topic, lambda _: None, FROM_MANY, callback_group=_Polled()
                )
        self.create_subscription(
            DiagnosticStatus, "excitation/status", self._on_excitation, LATCHED
        )
        self.create_subscription(
            DiagnosticStatus, "identifier/status", self._on_identifier, LATCHED
        )
        self._torque = self.create_client(SetBool, "driver/torque")
        LongService(self, "~/recover", self._recover)

    def activate(self) -> None:
        seed = max(self.values["seed"], 0)
        if self.values["interface"] == "bus":
            self._robot = VirtualRobot(
                self._model, self._truth, link=Path(self.values["link"]), seed=seed
            )
            where = self.values["link"]
        else:
            driver = DRIVERS[self.values["interface"]]
            self._robot = driver.of_parameters(self._model, self._truth, self.values, seed)
            where = f"{self._commands.topic_name} for {', '.join(self._robot.joints)}"
            # a thread: an executor's wake-ups at every period and command would take a core
            self._thread = clock.thread(
                target=self._broadcast, args=(self._robot,), name="joint states"
            )
            self._thread.start()
        self._fill_hand()
        self.say("info", f"a virtual {self.values['robot']} at {where}")

    def deactivate(self) -> None:
        if self._robot is not None:
            self._robot.close()
            self._robot = None
        if self._thread is not None:
            self._thread.join(timeout=1.0)
            self._thread = None

    def cleanup(self) -> None:
        self.remove_on_set_parameters_callback(self._on_parameters)

    def _recover(self, answer: Answer) -> None:
        """What a person does with an arm that has fallen: torque off, up to where it was at first, torque on."""
        robot = self._robot
        if not isinstance(robot, VirtualRobot):
            answer(
                False,
                "only a virtual arm behind the servo bus is lifted; this one is held by its controller",
            )
            return

        def end(response: Any, why: str) -> None:
            held = response is not None and response.success
            done = "the arm is held in its first pose"
            answer(held, done if held else why or response.message)

        def lift(response: Any, why: str) -> None:
            if response is None or not response.success:
                answer(False, why or response.message)
                return
            robot.park()
            call(self, self._torque, SetBool.Request(data=True), SWITCHED_S, end)

        def switch_off(there: bool) -> None:
            if there:
                call(self, self._torque, SetBool.Request(data=False), SWITCHED_S, lift)
            else:
                answer(False, "there is no driver that holds it then: start one, and call again")

        when_there(self, self._torque, switch_off)

    def _on_excitation(self, message: DiagnosticStatus) -> None:
        """What a person beside a real arm would do when a sequence begins."""
        values = messages.values_of(message)
        hand = values.get("hand", "any")
        if values.get("busy") == "true" and hand != self._hand:
            self._hand = hand
            self._fill_hand()

    def _on_identifier(self, message: DiagnosticStatus) -> None:
        """A baseline is recorded with the same sequence as what it is for; the identifier's status says which it is, to anybody."""
        out = messages.values_of(message).get("doing", "").endswith("_baseline")
        if out != self._content_is_out:
            self._content_is_out = out
            self._fill_hand()

    def _publish_motors(self) -> None:
        """What is really going on: true positions [rad or m], and as effort the current in each motor [A]."""
        if self._robot is not None and self.active:
            position, current = self._robot.truth()
            now = self.get_clock().now().nanoseconds
            true = [position[name] for name in current]
            self._motors.publish(
                messages.joint_state(
                    now,
                    list(current),
                    true,
                    effort=list(current.values()),
                )
            )

    def _broadcast(self, driver: EffortDriver) -> None:
        """As a controller manager: read, take what was commanded since, write, again and again while the node is active."""
        pacer = Pacer(1.0 / self.values["state_rate"])
        message = JointState(name=list(driver.broadcast))
        warned = False
        while self._robot is driver:
            pacer.wait()
            now_s = clock.now()
            stamp_ns = self.get_clock().now().nanoseconds
            driver.advance(now_s)
            with self._commands.handle:
                while (
                    taken := self._commands.handle.take_message(Float64MultiArray, False)
                ) is not None:
                    if not driver.command(now_s, taken[0].data) and not warned:
                        warned = True
                        self.say(
                            "warning", f"a command of {len(taken[0].data)} numbers was ignored"
                        )
            message.header.stamp = messages.time_message(stamp_ns)
            # arrays are taken as they are; lists are looked through, number by number
            message.position, message.velocity, message.effort = (
                array("d", each) for each in driver.states()
            )
            self._states.publish(message)

    def _fill_hand(self) -> None:
        if self._robot is None:
            return
        thing = {"empty": None, "reference": self._reference}.get(
            self._hand,
            self._object,
        )
        if self._content_is_out and thing is not None:
            thing = thing.emptied
        self._robot.hold(thing)
        held = "nothing" if thing is None else str(thing)
        self._status.publish(
            messages.status("ok", "virtual robot", f"the hand holds {held}", {"hand": self._hand})
        )

    def _on_parameters(self, parameters: list[RosParameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name == "object":
                    self._object = virtual_object(str(parameter.value))
                elif parameter.name == "reference":
                    self._reference = Payload(float(parameter.value))
                elif parameter.name == "fault" and self._robot is not None:
                    self._robot.set_fault(str(parameter.value))
        except ProprioError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._fill_hand()
        return SetParametersResult(successful=True)


def main() -> int:
    """Entry point of `proprio_virtual`."""
    return run_node(VirtualNode)


if __name__ == "__main__":
    raise SystemExit(main())
