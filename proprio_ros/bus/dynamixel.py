"""Dynamixel servos over a serial port: `dynamixel_sdk`, without its traps.

The SDK (4.1.0) spins on the port while a reply is due, waits 34 ms of wall-clock time for a dead servo, returns 0 for data
that never came, stays "in use" after an exception, and lets whatever the port raises through. `Port` and `DynamixelBus` turn
that into: sleeping waits on the monotonic clock, a time limit of the caller's choice, values only where there are values, and
`BusError` in one line. One thread owns a bus; nothing here is thread-safe.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import dynamixel_sdk

from proprio_ros import clock
from proprio_ros.bus import control_table
from proprio_ros.bus.port import (
    PORT_FAULTS,
    REPLY_TIMEOUT_S,
    Port,
    SerialLike,
    first_line,
    latency_warnings,
    why_not_open,
)
from proprio_ros.calibration_files.motors import MotorIdentity, Motors
from proprio_ros.errors import BusError, PortLostError, RobotError
from proprio_ros.robot import Robot

TRIES = 3  # a read or write is tried so often before the servo counts as not answering
ALERT = 0x80  # bit of a status packet's error byte: see Hardware Error Status
_STATUS_WORDS = {
    1: "failed to process the instruction",
    2: "does not know the instruction",
    3: "received a corrupted packet",
    4: "refuses the value as out of range",
    5: "refuses the length of the data",
    6: "refuses the value as beyond its limit",
    7: "refuses access to the register (EEPROM is writable only while torque is off)",
}
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class BusServo:
    """A servo that should be on the bus: the joint that it drives, its number there, and its control table."""

    joint: str
    id: int
    model: control_table.ServoModel


def servos_of(robot: Robot) -> tuple[BusServo, ...]:
    """The servos that a robot file names, in its order.

    Raises `RobotError`: A motor has no id or an unknown model, or two share an id.
    """
    servos = []
    for joint, motor in robot.motors.items():
        if motor.id is None or not motor.model:
            raise RobotError(
                f"{robot.name}: joints.{joint}.motor needs model and id to be driven; state them in {robot.source.name}"
            )
        servos.append(
            BusServo(
                joint,
                motor.id,
                control_table.servo_model(motor.model),
            )
        )
    ids = [servo.id for servo in servos]
    if len(set(ids)) != len(ids):
        raise RobotError(
            f"{robot.name}: two motors share an id ({ids}); every servo on a bus needs one of its own"
        )
    return tuple(servos)


def _table_of_all(servos: Sequence[BusServo]) -> Mapping[str, control_table.Register]:
    """The control table that all servos of a bus share, since one packet asks all of them for the same registers.

    Raises `BusError`: One has its registers elsewhere.
    """
    first, *others = servos
    for servo in others:
        if servo.model.registers != first.model.registers:
            raise BusError(
                f"{servo.joint} ({servo.model.name}) has other registers than {first.joint} ({first.model.name}): servos on one "
                "bus must share a control table"
            )
    return first.model.registers


class ServoState(NamedTuple):
    """What one servo reported, in SI; ``alert``: whether it has a hardware error."""

    angle_rad: float
    velocity_rad_s: float
    current_A: float
    alert: bool


class Reading(NamedTuple):
    """One round of the bus."""

    # when the request had left: servos sample when they hear it; on the monotonic clock
    sampled_at_s: float
    # by joint; servos that did not answer, or not intact, are missing
    states: Mapping[str, ServoState]
    # to the last answer; one that is unusually long may mean that the request was late
    round_trip_s: float = 0.0


class ServoHealth(NamedTuple):
    """How a servo is: with one sentence per hardware error, and whether its watchdog has stopped it."""

    temperature_C: float
    voltage_V: float
    faults: tuple[str, ...]
    watchdog_tripped: bool


class Goal(NamedTuple):
    """What one servo in current-based position mode is commanded.

    A far goal position makes the current exactly +-`current_A`, without leaving the mode and so without dropping the arm.
    """

    current_counts: int
    position_counts: int


class DynamixelBus:
    """The servos that should be there of one arm on one port, such as /dev/ttyUSB0, at one of `BAUD_RATES`.

    Fast Sync Read is used where it may be, and every servo's firmware knows it; ``connect`` makes another port than the
    serial one of that name, which is asked for bytes again and again.

    Attributes:
        fast: Whether all servos answer in one packet (Fast Sync Read); known after `handshake`.
        warnings: On the port, since it was opened.
        motors: What the servos said of themselves in `handshake`, by joint.

    Raises:
        BusError: The baud rate is unknown. From every method: A servo does not answer, or refuses; the message names it.
        PortLostError: From every method: The port is gone.
    """

    def __init__(
        self,
        port: str,
        servos: Sequence[BusServo],
        baud_rate: int = 1_000_000,
        reply_timeout_s: float = REPLY_TIMEOUT_S,
        fast_sync_read: bool = True,
        connect: Callable[[], SerialLike] | None = None,
    ) -> None:
        if baud_rate not in control_table.BAUD_RATES.values():
            known = ", ".join(map(str, control_table.BAUD_RATES.values()))
            raise BusError(f"baud rate {baud_rate} is not known to the servos; choose from {known}")
        self.port_name = port
        self.baud_rate = baud_rate
        self.servos = tuple(servos)
        self.warnings: list[str] = []
        self.motors: Motors = {}
        self._by_id = {servo.id: servo for servo in self.servos}
        self._reply_timeout_s = reply_timeout_s
        self._connect = connect
        self._want_fast = fast_sync_read
        self.fast = False
        self._port: Port | None = None
        self._packets = dynamixel_sdk.PacketHandler(2.0)
        # ROS 2 Jazzy ships 4.0.5, which has no fast option
        self._sdk_is_fast = "fast_option" in inspect.signature(self._packets.syncReadTx).parameters
        table = _table_of_all(self.servos)
        self._state_start = table["present_current"].address
        self._state_length = table["present_position"].end - self._state_start
        self._goal_start = table["goal_current"].address
        self._goal_length = table["goal_position"].end - self._goal_start

    @property
    def is_open(self) -> bool:
        return self._port is not None

    def open(self) -> None:
        """Open the port alone for this process.

        Raises `PortLostError`: It is not there, not permitted, or in use; the message says which.
        """
        self.close()
        port = Port(self.port_name, self._reply_timeout_s, self._connect)
        try:
            opened = port.setBaudRate(self.baud_rate)
        except PORT_FAULTS as error:
            raise PortLostError(why_not_open(self.port_name, error)) from error
        if not opened:
            raise PortLostError(
                f"{self.port_name}: cannot be set to {self.baud_rate} bit/s; choose a baud rate that the adapter knows"
            )
        self._port = port
        self.warnings = latency_warnings(self.port_name, port.ser)

    def close(self) -> None:
        """Close the port; whatever it answers, it is closed afterwards."""
        port = self._port
        self._port = None
        if port is not None and port.ser is not None:
            with contextlib.suppress(*PORT_FAULTS):  # it may be gone, which is what was asked for
                port.ser.close()

    def _guarded(self, action: Callable[[Any], _Result]) -> _Result:
        """Run one exchange; a port that breaks under it becomes `PortLostError`."""
        port = self._port
        if port is None:
            raise PortLostError(f"{self.port_name}: not open")
        # an exception or a lost reply leaves it set, and every later call would be refused
        port.is_using = False
        try:
            return action(port)
        except PORT_FAULTS as error:
            self.close()
            raise PortLostError(
                f"{self.port_name}: the port is gone ({first_line(error)}): check the cable"
            ) from error

    def _settle(self, wait_s: float = 0.002) -> None:
        """After a lost reply: whatever still comes belongs to the past."""
        clock.sleep(wait_s)
        self._guarded(lambda port: port.clearPort())

    def ping(self, servo_id: int) -> int:
        """Model number of a servo."""
        return int(
            self._tried(
                servo_id,
                "ping",
                lambda port: self._packets.ping(port, servo_id),
            )
        )

    def read(self, servo_id: int, register: str) -> int:
        """Value of a register, sign included."""
        entry = self._by_id[servo_id].model.registers[register]
        arguments = servo_id, entry.address, entry.size

        def exchange(port: Any) -> tuple[Any, int, int]:
            data, result, error = self._packets.readTxRx(port, *arguments)
            late = (
                result == dynamixel_sdk.COMM_SUCCESS
                and not error & ~ALERT
                and len(data) != entry.size
            )
            # late: it answers something before
            return data, dynamixel_sdk.COMM_RX_CORRUPT if late else result, error

        return entry.decode(bytes(self._tried(servo_id, f"read {register}", exchange)))

    def write(self, servo_id: int, register: str, value: int) -> None:
        """Write a register and wait for the servo's answer.

        Args:
            servo_id: Of the servo.
            register: Name of the register.
            value: What is written, in the register's unit.

        Raises:
            BusError: The servo does not answer, or refuses.
        """
        entry = self._by_id[servo_id].model.registers[register]
        arguments = servo_id, entry.address, entry.size, list(entry.encode(value))
        what = f"write {register} = {value}"
        self._tried(
            servo_id,
            what,
            lambda port: (None, *self._packets.writeTxRx(port, *arguments)),
        )

    def _tried(
        self,
        servo_id: int,
        what: str,
        exchange: Callable[[Any], tuple[Any, int, int]],
    ) -> Any:
        """Repeat an exchange that was lost on the wire; the servo's own refusal is final. Returns its data."""
        result = error = 0
        for number in range(TRIES):
            try:
                data, result, error = self._guarded(exchange)
            except IndexError:  # the SDK trusts the length of a reply
                result = dynamixel_sdk.COMM_RX_CORRUPT
            refused = error & ~ALERT
            if result == dynamixel_sdk.COMM_SUCCESS and refused != 3:
                if refused:
                    raise BusError(
                        f"{self._called(servo_id)}: {what}: it {_STATUS_WORDS.get(refused, 'refuses')}"
                    )
                # this may be a late answer to the try before, and its own be taken for the next request's
                if number:
                    self._settle(self._reply_timeout_s)
                return data
            self._settle()
        raise BusError(f"{self._called(servo_id)}: {what}: {self._lost_words(result)}")

    def _called(self, servo_id: int) -> str:
        servo = self._by_id.get(servo_id)
        return f"servo {servo_id} ({servo.joint})" if servo else f"servo {servo_id}"

    def _lost_words(self, result: int) -> str:
        if result == dynamixel_sdk.COMM_RX_TIMEOUT:
            return f"no answer in {TRIES} tries at {self.baud_rate} bit/s: check power, cable, id and baud rate"
        if result == dynamixel_sdk.COMM_RX_CORRUPT or result == dynamixel_sdk.COMM_SUCCESS:
            return f"only corrupted packets in {TRIES} tries: check cable, ground and baud rate"
        return f"the packet could not be sent ({result})"

    def handshake(self) -> None:
        """Check that every servo is there and of the model that the robot file states; an error names all that are not."""
        wrong = []
        slow = False
        motors: dict[str, MotorIdentity] = {}
        for servo in self.servos:
            try:
                number = self.ping(servo.id)
            except PortLostError:
                raise
            except BusError:
                wrong.append(f"no servo {servo.id} ({servo.joint})")
                continue
            if number != servo.model.number:
                wrong.append(
                    f"servo {servo.id} ({servo.joint}) is a {control_table.model_name(number)}, not a {servo.model.name}"
                )
                continue
            registers = ("firmware_version", "homing_offset", "drive_mode", "moving_threshold")
            motors[servo.joint] = MotorIdentity(
                number, servo.id, *(self.read(servo.id, name) for name in registers)
            )
            slow |= motors[servo.joint].firmware < servo.model.fast_sync_read_firmware
        if wrong:
            missing = any(words.startswith("no") for words in wrong)
            advice = (
                "check power, cables, ids and baud rate" if missing else "correct the robot file"
            )
            raise BusError(
                f"{self.port_name} at {self.baud_rate} bit/s: {'; '.join(wrong)}: {advice}"
            )
        self.motors = motors
        self.fast = self._want_fast and self._sdk_is_fast and not slow

    def prepare(self, *, watchdog_s: float, position_d_gain: int) -> None:
        """Put every servo into current-based position mode with torque on, holding where it is.

        A servo with a hardware error is rebooted first, one whose watchdog tripped is woken. Where the mode has to change, torque
        is off for the few milliseconds that this takes (EEPROM). Return delay is set to zero. A servo stops by itself when the bus
        is silent for as long as its watchdog says [s], 0: never; its own D gain of 0 lets a held joint ring.
        """
        for servo in self.servos:
            if self.read(servo.id, "hardware_error_status"):
                self.reboot(servo.id)
            self._set(servo, "bus_watchdog", 0)
            self._set(servo, "status_return_level", 2)
            wanted = {
                "return_delay_time": 0,
                "operating_mode": int(control_table.OperatingMode.CURRENT_BASED_POSITION),
            }
            if any(self.read(servo.id, name) != value for name, value in wanted.items()):
                self.write(servo.id, "torque_enable", 0)
                for name, value in wanted.items():
                    self._set(servo, name, value)
            self._set(servo, "position_d_gain", position_d_gain)
            if self.read(servo.id, "torque_enable") == 0:
                self.write(servo.id, "torque_enable", 1)
            self.set_watchdog(servo.id, watchdog_s)

    def set_watchdog(self, servo_id: int, watchdog_s: float) -> None:
        """Have a servo stop by itself when the bus is silent for so long; 0: never."""
        units = round(watchdog_s / control_table.BUS_WATCHDOG_UNIT_S)
        self.write(servo_id, "bus_watchdog", min(max(units, 1), 127) if watchdog_s > 0.0 else 0)

    def has_stopped(self, servo_id: int) -> bool:
        """Whether its watchdog has stopped a servo."""
        return self.read(servo_id, "bus_watchdog") == control_table.BUS_WATCHDOG_TRIPPED

    def _set(self, servo: BusServo, register: str, value: int) -> None:
        """Write what differs: EEPROM wears out, and a write costs as much as a read."""
        if self.read(servo.id, register) != value:
            self.write(servo.id, register, value)

    def release(self) -> tuple[str, ...]:
        """Current to zero and torque off on every servo that can still be reached; returns what could not be done."""
        left: list[str] = []
        for servo in self.servos:
            try:
                self.write(servo.id, "torque_enable", 0)
            except PortLostError as error:
                return (*left, str(error))
            except BusError as error:
                left.append(str(error))
        return tuple(left)

    def reboot(self, servo_id: int, ready_s: float = 2.0) -> None:
        """Reboot a servo, which clears its hardware error, and wait until it answers.

        Raises `BusError`: It does not come back, or its error is still there.
        """

        def exchange(port: Any) -> tuple[None, int, int]:
            result, error = self._packets.reboot(port, servo_id)
            return None, result, error & ALERT

        try:
            self._tried(servo_id, "reboot", exchange)
        except PortLostError:
            raise
        except BusError:
            # its answer may be what was lost, and now it boots in silence; what it says afterwards counts
            pass
        deadline = clock.now() + ready_s
        while True:
            clock.sleep(0.1)
            try:
                status = self.read(servo_id, "hardware_error_status")
            except PortLostError:
                raise
            except BusError:
                if clock.now() > deadline:
                    raise
                continue
            if status:
                faults = "; ".join(control_table.hardware_errors(status))
                raise BusError(f"{self._called(servo_id)}: {faults}: it remains after a reboot")
            return

    def health(self, servo_id: int) -> ServoHealth:
        """Temperature, voltage, hardware errors and watchdog of a servo."""
        model = self._by_id[servo_id].model
        return ServoHealth(
            float(self.read(servo_id, "present_temperature")),
            self.read(servo_id, "present_input_voltage") * model.voltage_unit_V,
            control_table.hardware_errors(self._twice(servo_id, "hardware_error_status")),
            self.has_stopped(servo_id),
        )

    def _twice(self, servo_id: int, register: str) -> int:
        """Bits that are set in two readings: an answer that came too late for its own request may be taken for this one's."""
        value = self.read(servo_id, register)
        return value & self.read(servo_id, register) if value else 0

    def read_states(self) -> Reading:
        """Current, velocity and position of all servos, in one exchange (registers 126 to 135).

        A servo that does not answer is missing in the result.
        """
        ids = [servo.id for servo in self.servos]
        arguments = [
            self._state_start,
            self._state_length,
            ids,
            len(ids),
            *([self.fast] if self._sdk_is_fast else []),
        ]
        asked_at_s = clock.now()
        result = self._guarded(lambda port: self._packets.syncReadTx(port, *arguments))
        sampled_at_s = clock.now()
        if result != dynamixel_sdk.COMM_SUCCESS:
            return Reading(sampled_at_s, {})
        blocks = self._guarded(self._receive_fast if self.fast else self._receive_each)
        round_trip_s = clock.now() - asked_at_s
        if len(blocks) < len(ids):
            self._settle()
        states = {
            self._by_id[i].joint: self._state(i, error, data) for i, (error, data) in blocks.items()
        }
        return Reading(sampled_at_s, states, round_trip_s)

    def _receive_each(self, port: Any) -> dict[int, tuple[int, bytes]]:
        # the SDK's own group read stops at the first servo that is silent and then calls every value 0
        blocks: dict[int, tuple[int, bytes]] = {}
        for servo in self.servos:
            try:
                data, result, error = self._packets.readRx(
                    port,
                    servo.id,
                    self._state_length,
                )
            except IndexError:
                continue
            if result == dynamixel_sdk.COMM_SUCCESS and len(data) == self._state_length:
                blocks[servo.id] = (error, bytes(data))
            elif result == dynamixel_sdk.COMM_RX_TIMEOUT:
                break  # the ones behind it wait for it in vain
        return blocks

    def _receive_fast(self, port: Any) -> dict[int, tuple[int, bytes]]:
        part = self._state_length + 4  # error, id, data, CRC
        whole = part * len(self.servos)
        try:
            data, result, _ = self._packets.fastSyncReadRx(
                port,
                dynamixel_sdk.BROADCAST_ID,
                whole,
            )
        except IndexError:
            return {}
        if result != dynamixel_sdk.COMM_SUCCESS or len(data) < whole - 2:
            return {}
        parts = [
            data[start : start + 2 + self._state_length] for start in range(0, whole - 2, part)
        ]
        return {
            servo_id: (error, bytes(state))
            for error, servo_id, *state in parts
            if servo_id in self._by_id
        }

    def _state(self, servo_id: int, error: int, data: bytes) -> ServoState:
        model = self._by_id[servo_id].model

        def counts(name: str) -> int:
            register = model.registers[name]
            start = register.address - self._state_start
            return register.decode(data[start : start + register.size])

        return ServoState(
            angle_rad=model.angle_rad(counts("present_position")),
            velocity_rad_s=model.velocity_rad_s(counts("present_velocity")),
            current_A=model.current_A(counts("present_current")),
            alert=bool(error & ALERT),
        )

    def write_goals(self, goals: Mapping[str, Goal]) -> None:
        """Current limit and goal position of some joints, in one packet (registers 102 to 119).

        Nobody answers a sync write, so a corrupted one is lost without a word: write the goals in every cycle.
        """
        param: list[int] = []
        for servo in self.servos:
            if servo.joint in goals:
                goal = goals[servo.joint]
                table = servo.model.registers
                first = table["goal_current"].encode(goal.current_counts)
                last = table["goal_position"].encode(goal.position_counts)
                # velocity and profile: 0
                between = bytes(self._goal_length - len(first) - len(last))
                param += (servo.id, *first, *between, *last)
        if param:
            self._guarded(
                lambda port: self._packets.syncWriteTxOnly(
                    port, self._goal_start, self._goal_length, param, len(param)
                )
            )
