"""Dynamixel servos as data: registers, ranges, modes and units; only here is it known what a count is worth.

Addresses, sizes, ranges and first values: ROBOTIS e-manual, XM430-W350, "Control Table". Driver and emulated servo both read
this table; what checks it is the conformance suite on hardware and the vectors of the manual (test/bus).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from proprio_ros.errors import RobotError

EEPROM_END = 64
"""Registers below this address keep their value without power, and are writable only while torque is off."""
BUS_WATCHDOG_UNIT_S = 0.020
BUS_WATCHDOG_TRIPPED = -1
RETURN_DELAY_UNIT_S = 2e-6
BAUD_RATES: Mapping[int, int] = {
    0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000, 7: 4_500_000,
}  # fmt: skip
"""Value of the register Baud Rate -> bits per second."""


class OperatingMode(IntEnum):
    """Values of the register Operating Mode."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


class HardwareError(IntEnum):
    """Bits of Hardware Error Status, and of Shutdown; cleared by a reboot only."""

    INPUT_VOLTAGE = 0
    OVERHEATING = 2
    ENCODER = 3
    ELECTRICAL_SHOCK = 4
    OVERLOAD = 5


HARDWARE_ERROR_WORDS: Mapping[HardwareError, str] = {
    HardwareError.INPUT_VOLTAGE: "input voltage out of range: check the supply",
    HardwareError.OVERHEATING: "overheated: let it cool down",
    HardwareError.ENCODER: "encoder fault: have the servo repaired",
    HardwareError.ELECTRICAL_SHOCK: "electrical shock or too little power: check supply and cables",
    HardwareError.OVERLOAD: "overload: the load was too much for too long",
}


def hardware_errors(status: int) -> tuple[str, ...]:
    """Sentences for the bits of a Hardware Error Status."""
    return tuple(words for bit, words in HARDWARE_ERROR_WORDS.items() if status >> bit & 1)


@dataclass(frozen=True)
class Register:
    """One entry of the control table."""

    address: int  # of its first byte
    size: int  # bytes, little endian
    initial: int = 0  # value after a factory reset (EEPROM) or power-up (RAM)
    lowest: int = 0  # may be written
    highest: int = 0  # may be written
    writable: bool = True
    signed: bool = False
    limit: str | None = None  # name of the register that bounds the absolute value

    @property
    def end(self) -> int:
        """Address of the first byte behind it."""
        return self.address + self.size

    @property
    def eeprom(self) -> bool:
        return self.address < EEPROM_END

    def decode(self, data: bytes) -> int:
        """Number in the register's bytes."""
        return int.from_bytes(data, "little", signed=self.signed)

    def encode(self, value: int) -> bytes:
        """Bytes of a number; one that is out of range wraps like the servo's own."""
        return (int(value) & ((1 << (8 * self.size)) - 1)).to_bytes(
            self.size,
            "little",
        )


def _read_only(
    address: int,
    size: int,
    initial: int = 0,
    signed: bool = False,
) -> Register:
    return Register(address, size, initial, writable=False, signed=signed)


_FAR = 1_048_575  # 256 turns: range of Goal Position in the extended and the current-based mode

_X_SERIES: dict[str, Register] = {
    "model_number": _read_only(0, 2),
    "model_information": _read_only(2, 4),
    "firmware_version": _read_only(6, 1, 46),
    "id": Register(7, 1, 1, 0, 252),
    "baud_rate": Register(8, 1, 1, 0, 7),
    "return_delay_time": Register(9, 1, 250, 0, 254),
    "drive_mode": Register(10, 1, 0, 0, 13),
    "operating_mode": Register(11, 1, 3, 0, 16),
    "secondary_id": Register(12, 1, 255, 0, 255),
    "protocol_version": Register(13, 1, 2, 1, 2),
    "homing_offset": Register(20, 4, 0, -1_044_479, 1_044_479, signed=True),
    "moving_threshold": Register(24, 4, 10, 0, 1023),
    "temperature_limit": Register(31, 1, 80, 0, 100),
    "max_voltage_limit": Register(32, 2, 160, 95, 160),
    "min_voltage_limit": Register(34, 2, 95, 95, 160),
    "pwm_limit": Register(36, 2, 885, 0, 885),
    "current_limit": Register(38, 2, 1193, 0, 1193),
    "acceleration_limit": Register(40, 4, 32767, 0, 32767),
    "velocity_limit": Register(44, 4, 350, 0, 1023),
    "max_position_limit": Register(48, 4, 4095, 0, 4095),
    "min_position_limit": Register(52, 4, 0, 0, 4095),
    "shutdown": Register(63, 1, 0x34, 0, 0x3D),
    "torque_enable": Register(64, 1, 0, 0, 1),
    "led": Register(65, 1, 0, 0, 1),
    "status_return_level": Register(68, 1, 2, 0, 2),
    "registered_instruction": _read_only(69, 1),
    "hardware_error_status": _read_only(70, 1),
    "velocity_i_gain": Register(76, 2, 1920, 0, 16383),
    "velocity_p_gain": Register(78, 2, 100, 0, 16383),
    "position_d_gain": Register(80, 2, 0, 0, 16383),
    "position_i_gain": Register(82, 2, 0, 0, 16383),
    "position_p_gain": Register(84, 2, 800, 0, 16383),
    "feedforward_2nd_gain": Register(88, 2, 0, 0, 16383),
    "feedforward_1st_gain": Register(90, 2, 0, 0, 16383),
    "bus_watchdog": Register(98, 1, 0, 0, 127, signed=True),
    "goal_pwm": Register(100, 2, 0, -885, 885, signed=True, limit="pwm_limit"),
    "goal_current": Register(102, 2, 0, -1193, 1193, signed=True, limit="current_limit"),
    "goal_velocity": Register(104, 4, 0, -1023, 1023, signed=True, limit="velocity_limit"),
    "profile_acceleration": Register(108, 4, 0, 0, 32767),
    "profile_velocity": Register(112, 4, 0, 0, 32767),
    "goal_position": Register(116, 4, 0, -_FAR, _FAR, signed=True),
    "realtime_tick": _read_only(120, 2),
    "moving": _read_only(122, 1),
    "moving_status": _read_only(123, 1),
    "present_pwm": _read_only(124, 2, signed=True),
    "present_current": _read_only(126, 2, signed=True),
    "present_velocity": _read_only(128, 4, signed=True),
    "present_position": _read_only(132, 4, signed=True),
    "velocity_trajectory": _read_only(136, 4, signed=True),
    "position_trajectory": _read_only(140, 4, signed=True),
    "present_input_voltage": _read_only(144, 2, 120),
    "present_temperature": _read_only(146, 1, 30),
}


@dataclass(frozen=True)
class ServoModel:
    """A servo's control table with the units of its numbers."""

    name: str  # as the robot file calls it
    number: int  # its Model Number
    current_unit_A: float  # of one count
    velocity_unit_rad_s: float  # of one count
    position_unit_rad: float  # of one count
    position_zero: int  # count at which the shaft's angle is 0
    voltage_unit_V: float  # of one count of Present Input Voltage
    position_p_divisor: float = 128.0  # gain = register / divisor (e-manual, "Position PID Gain")
    position_d_divisor: float = 16.0
    fast_sync_read_firmware: int = 45  # first firmware that knows Fast Sync Read
    registers: Mapping[str, Register] = field(default_factory=lambda: _X_SERIES, repr=False)

    def counts_of_current(self, current_A: float) -> int:
        """Nearest current that can be commanded [counts]."""
        return round(current_A / self.current_unit_A)

    def counts_of_position(self, angle_rad: float) -> int:
        """Nearest position that can be commanded [counts]."""
        return self.position_zero + round(angle_rad / self.position_unit_rad)

    def angle_rad(self, counts: int) -> float:
        return (counts - self.position_zero) * self.position_unit_rad

    def velocity_rad_s(self, counts: int) -> float:
        return counts * self.velocity_unit_rad_s

    def current_A(self, counts: int) -> float:
        """What a register of current says, goal or present."""
        return counts * self.current_unit_A


_RPM = 2.0 * math.pi / 60.0
XM430_W350 = ServoModel(
    name="XM430-W350",
    number=1020,
    current_unit_A=0.00269,
    velocity_unit_rad_s=0.229 * _RPM,
    position_unit_rad=2.0 * math.pi / 4096,
    position_zero=2048,
    voltage_unit_V=0.1,
)
MODELS: Mapping[str, ServoModel] = {model.name: model for model in (XM430_W350,)}


def servo_model(name: str) -> ServoModel:
    """The model that a robot file names. Raises `RobotError`: Its control table is not known."""
    if name not in MODELS:
        raise RobotError(
            f"motor model {name!r}: its control table is not known; known: {', '.join(MODELS)}: add it to bus/control_table.py"
        )
    return MODELS[name]


def model_name(number: int) -> str:
    """Name of a model number, for messages."""
    return next(
        (model.name for model in MODELS.values() if model.number == number),
        f"model number {number}",
    )
