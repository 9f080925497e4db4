"""The driver node: the servos' bus as topics. A thread of its own owns the bus, so that no callback delays a cycle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from proprio_ros import clock
from proprio_ros.bus.driver import ArmDriver, DriverSettings
from proprio_ros.bus.dynamixel import DynamixelBus, servos_of
from proprio_ros.bus.state import LATE_NS, OUTDATED, ArmSample, BusState, Senders
from proprio_ros.calibration_files.motors import Motors
from proprio_ros.clock import Pacer, StampClock
from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes import messages
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.process import run_node
from proprio_ros.nodes.qos import FROM_MANY, LATCHED, STREAM
from proprio_ros.nodes.tables import DRIVER, fields_stated
from proprio_ros.recordings.description import robot_named
from proprio_ros.recordings.topics import APPLIED_EFFORT, CURRENT_COMMAND, TEMPERATURES

LATE_S = 0.005  # a cycle that begins later than this is reported in the diagnostics
# the system's clock has been set when it moved by more than this within a second
CLOCK_JUMP_S = 0.05


class DriverNode(ManagedNode):
    """Publishes what the servos report, and passes commands on to them, inside the limits."""

    parameters = DRIVER
    urgent = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("driver", **kwargs)
        self._driver: ArmDriver | None = None
        self._thread: clock.Thread | None = None
        self._ended = clock.event()
        self._hold_at_end = False
        self._told = ""
        self._published_motors: Motors = {}

    @property
    def pause_s(self) -> float:
        return 0.001

    @property
    def real_time(self) -> bool:
        return bool(self.values["real_time"])

    def configure(self) -> None:
        values = self.values
        robot = robot_named(values["robot"])
        servos = servos_of(robot)
        self._order = tuple(values["joints"]) or tuple(servo.joint for servo in servos)
        unknown = [name for name in self._order if name not in robot.motors]
        if unknown:
            words = (
                f"{robot.name} has no motor at {unknown[0]!r}; it has: {', '.join(robot.motors)}"
            )
            raise ConfigurationError(f"parameter joints: {words}")
        port = values["port"]
        baud_rate = values["baud_rate"]
        timeout_s = values["reply_timeout"]
        bus = DynamixelBus(port, servos, baud_rate, timeout_s, values["fast_sync_read"])
        settings = DriverSettings(
            **fields_stated(DriverSettings, values), reconnect_s=values["reconnect_period"]
        )
        self._driver = ArmDriver(robot, bus, settings, self.say)
        self._effort_per_current = {
            n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()
        }
        # /diagnostics is one topic for all arms
        self.diagnosed = f"{self.get_namespace()}/driver".lstrip("/")
        self._hardware_id = f"{robot.name} on {values['port']}"
        self._states = self.create_publisher(JointState, "joint_states", STREAM)
        self._effort = self.create_publisher(JointState, APPLIED_EFFORT, STREAM)
        self._current = self.create_publisher(Float64MultiArray, "applied_current", STREAM)
        self._torque = self.create_publisher(Bool, "torque_enabled", LATCHED)
        self._told_limp: bool | None = None
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._published_motors = {}  # a new publisher has said nothing yet
        self._motors = self.create_publisher(DiagnosticStatus, "motors", LATCHED)
        self._temperatures = self.create_publisher(Float64MultiArray, TEMPERATURES, LATCHED)
        self._senders = {CURRENT_COMMAND: Senders(), "position_command": Senders()}
        self._system = StampClock()
        self._set = (0.0, 0)
        self.create_subscription(Float64MultiArray, CURRENT_COMMAND, self._on_current, FROM_MANY)
        self.create_subscription(
            Float64MultiArray, "position_command", self._on_position, FROM_MANY
        )
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(SetBool, "~/torque", self._on_torque)
        self.every(1.0, self._each_second)

    def activate(self) -> None:
        self._pacer = Pacer(1.0 / self.values["rate"])
        self._stamps = StampClock()
        if self._thread is None:
            self._hold_at_end = self.values["on_shutdown"] == "hold"
            self._ended.clear()
            self._thread = clock.thread(target=self._loop, name="servo bus")
            self._thread.start()

    def deactivate(self) -> None:
        """Nothing is driven or published any more, but the arm is held and watched on: whoever asks for this may not see it."""
        if self._driver is not None:
            self._driver.hold()

    def cleanup(self) -> None:
        self._end(hold=True)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        # anyone on the network can ask for it; `on_shutdown` is for the end of the process
        self._end(hold=True)
        return super().on_shutdown(state)

    def finish(self) -> None:
        self._ended.set()  # first: a driver that ends is not one that somebody could activate again
        super().finish()
        self._end(hold=self.values["on_shutdown"] == "hold")

    def _end(self, hold: bool) -> None:
        """End the bus thread, with the arm held by its servos alone, or released."""
        self._hold_at_end = hold
        self._ended.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
            self._thread = None

    def _loop(self) -> None:
        driver = self._driver
        assert driver is not None
        try:
            while not self._ended.is_set():
                self._pacer.wait()
                sample = driver.cycle()
                if self._state_of(driver) != self._told and not self._ended.is_set():
                    self._tell(driver)
                if sample is not None and self.active:
                    self._publish(driver, sample)
                elif driver.state is BusState.DISCONNECTED:
                    self._ended.wait(0.02)
        except Exception as error:  # a defect must not leave a motor pushing
            self.say(
                "error", f"the servo loop failed ({type(error).__name__}: {error}); current zero"
            )
            raise
        finally:
            driver.close(hold=self._hold_at_end)

    def _publish(self, driver: ArmDriver, sample: ArmSample) -> None:
        if self._stamps.offset_ns is None:
            self._stamps.look(
                self.get_clock().now().nanoseconds,
                clock.now(),
            )
        stamp = self._stamps.stamp_ns(sample.sampled_at_s)
        names = driver.joints
        measured = [sample.current_A[name] * self._effort_per_current[name] for name in names]
        applied = [sample.commanded_A[name] * self._effort_per_current[name] for name in names]
        position = [sample.position[n] for n in names]
        velocity = [sample.velocity[n] for n in names]
        # what drives the joints from this instant on goes first: a listener then has it when the state comes
        limp = driver.limp
        if limp != self._told_limp:
            self._told_limp = limp
            self._torque.publish(Bool(data=not limp))
        self._effort.publish(messages.joint_state(stamp, names, effort=applied))
        self._states.publish(
            messages.joint_state(
                stamp,
                names,
                position,
                velocity,
                measured,
            )
        )
        self._current.publish(messages.labelled(sample.commanded_A))

    # each logs for itself, since a place in the code is throttled, not a sentence

    def _on_current(self, message: Float64MultiArray, info: dict[str, Any]) -> None:
        reason = self._obey(message, info, CURRENT_COMMAND, ArmDriver.command_currents)
        if reason:
            self.get_logger().error(
                f"{CURRENT_COMMAND} refused: {reason}", throttle_duration_sec=1.0
            )

    def _on_position(self, message: Float64MultiArray, info: dict[str, Any]) -> None:
        reason = self._obey(message, info, "position_command", ArmDriver.command_positions)
        if reason:
            self.get_logger().error(
                f"position_command refused: {reason}", throttle_duration_sec=1.0
            )

    def _obey(
        self,
        message: Float64MultiArray,
        info: dict[str, Any],
        topic: str,
        command: Callable[..., str],
    ) -> str:
        """Pass a command on; returns why it was refused, or an empty string."""
        looks = (len(message.data), *(dim.label for dim in message.layout.dim))
        sent_ns = info.get("source_timestamp") or None
        senders = self._senders[topic]
        sender = senders.of(info.get("publication_sequence_number"), looks, sent_ns)
        # a newer one has been obeyed
        if self._driver is None or not self.active or sender == OUTDATED:
            return ""
        now_ns = self.get_clock().now().nanoseconds
        waited_ns = round(1e9 * self.turns.waited_s())
        late_s = (
            senders.late_s(sender, now_ns - sent_ns, self._was_set_ns(now_ns), waited_ns)
            if sent_ns
            else 0.0
        )
        values = messages.by_joint(message, self._order)
        return values if isinstance(values, str) else command(self._driver, values, sender, late_s)

    def _was_set_ns(self, now_ns: int) -> int:
        """By how much the system's clock, which says ``now_ns``, was set within the last second [ns]."""
        here_s = clock.now()
        moved_s = self._system.look(now_ns, here_s)
        if abs(moved_s) > CLOCK_JUMP_S:
            self._set = here_s, round(1e9 * moved_s)
        elif self._set[1] and here_s - self._set[0] > 1e-9 * LATE_NS:
            for senders in self._senders.values():
                senders.clock_was_set(self._set[1])
            self._set = here_s, 0
        return self._set[1]

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._driver is not None and self._thread is not None:  # active or not: the arm is held
            self._driver.stop()
            response.success = True
            response.message = self._named("current zero; ~/torque true holds the arm again")
        else:
            response.success = True
            response.message = "the driver does not hold the bus, and drives nothing"
        return response

    def _on_torque(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        driver = self._driver
        if driver is None or not self.active or driver.state is BusState.DISCONNECTED:
            reason = (
                driver.reason if driver is not None and self.active else "the driver is not active"
            )
            response.success = False
            response.message = f"not possible: {reason}"
            return response
        driver.set_torque(request.data)
        wanted = BusState.RUNNING if request.data else BusState.RELEASED
        obeyed = driver.await_torque(5.0)  # a servo with a fault is rebooted first
        response.success = obeyed and driver.state is wanted
        done = "held" if request.data else "torque is off"
        response.message = done if response.success else self._named(driver.reason)
        return response

    def _each_second(self) -> None:
        driver = self._driver
        if driver is None or self._thread is None:
            return
        if self.active and "driven" not in driver.modes.values():
            moved_s = self._stamps.look(
                self.get_clock().now().nanoseconds,
                clock.now(),
            )
            if abs(moved_s) > CLOCK_JUMP_S:
                self.say(
                    "warning",
                    f"the system's clock was set by {moved_s:+.3f} s; stamps follow it from here on",
                )
        self._tell(driver)

    def _named(self, words: str) -> str:
        """The node's own services by their full names: whoever reads it elsewhere can call them."""
        return words.replace("~/", f"{self.get_fully_qualified_name()}/")

    def _state_of(self, driver: ArmDriver) -> str:
        """What is published as soon as it changes."""
        return str(driver.state.value) if self.active else "inactive"

    def _tell(self, driver: ArmDriver) -> None:
        self._told = self._state_of(driver)
        statuses = self._statuses(driver)
        self._status.publish(statuses[0])
        motors = driver.bus.motors
        if motors != self._published_motors:
            self._published_motors = motors
            values = {joint: motor.as_text() for joint, motor in motors.items()}
            name = f"{self.diagnosed}: motors"
            self._motors.publish(
                messages.status("ok", name, "whose arm this is", values, self._hardware_id)
            )
        self._diagnostics.publish(
            messages.diagnostics(self.get_clock().now().nanoseconds, statuses)
        )
        if driver.health:
            self._temperatures.publish(
                messages.labelled({n: h.temperature_C for n, h in driver.health.items()})
            )

    def _statuses(self, driver: ArmDriver) -> list[DiagnosticStatus]:
        late = list(self._pacer.lateness_s)
        statistics = driver.statistics
        running = driver.state is BusState.RUNNING and self.active and not driver.slipped
        state = self._state_of(driver)
        reason = (
            driver.reason if state != "inactive" else "the node is not active; activate it to go on"
        )
        values = {
            "state": state,
            "rate [Hz]": self.values["rate"],
            "cycles": statistics.cycles,
            "incomplete": statistics.incomplete,
            "untimely": statistics.untimely,
            "asked again": statistics.retries,
            "refused commands": statistics.refused_commands,
            f"cycles later than {1e3 * LATE_S:.0f} ms": sum(value > LATE_S for value in late),
            "latest [ms]": 1e3 * max(late, default=0.0),
        }
        level = (
            "ok" if running else "warning" if driver.state is not BusState.DISCONNECTED else "error"
        )
        entries: list[tuple[str, str, str, dict[str, Any]]] = [
            (level, "servo bus", self._named(reason), values)
        ]
        modes = driver.modes
        for name, health in list(driver.health.items()):
            hot = health.temperature_C >= self.values["max_temperature"]
            words = "; ".join(health.faults) or ("too hot to be driven" if hot else modes[name])
            level = "error" if health.faults else "warning" if hot else "ok"
            values = {
                "mode": modes[name],
                "temperature [C]": health.temperature_C,
                "voltage [V]": health.voltage_V,
            }
            entries.append((level, name, words, values))
        named = self.diagnosed
        where = self._hardware_id
        return [
            messages.status(level, f"{named}: {of}", words, about, where)
            for level, of, words, about in entries
        ]


def main() -> int:
    """Entry point of `proprio_driver`."""
    return run_node(DriverNode)


if __name__ == "__main__":
    raise SystemExit(main())
