"""One emulated servo without a bus: its registers, modes, current, and what stops it."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import pytest
from support.rotors import TORQUE_CONSTANT_NM_A, Rotors

from proprio_ros.bus.control_table import XM430_W350, HardwareError, OperatingMode
from proprio_ros.virtual.protocol import ALERT, Error
from proprio_ros.virtual.servo import REBOOT_S, VirtualServo

REGISTERS = XM430_W350.registers
UNIT_A = XM430_W350.current_unit_A
FAR = 1_048_575


class Bench:
    """A servo with its rotor, and a clock that only `run` moves."""

    def __init__(
        self,
        servo: VirtualServo | None = None,
        registers: Mapping[str, int] | None = None,
    ) -> None:
        self.servo = servo or VirtualServo(XM430_W350, 1)
        for name, value in (registers or {}).items():
            self.servo[name] = value
        self.rotors = Rotors([self.servo])

    @property
    def now_s(self) -> float:
        return self.rotors.time_s

    @property
    def current_A(self) -> float:
        return self.rotors.current_A[0]

    def run(self, duration_s: float) -> None:
        self.rotors.advance(self.now_s + duration_s)

    def write(self, name: str, value: int) -> Error:
        register = REGISTERS[name]
        return self.servo.write(
            register.address,
            register.encode(value),
            self.now_s,
        )

    def read(self, name: str) -> int:
        register = REGISTERS[name]
        error, data = self.servo.read(register.address, register.size)
        assert error == Error.NONE
        return register.decode(data)

    def powered(self, mode: OperatingMode) -> Bench:
        """The same, in a mode, with torque on."""
        assert self.write("operating_mode", mode) == Error.NONE
        assert self.write("torque_enable", 1) == Error.NONE
        self.run(0.001)
        return self

    def push(self, goal_current: int, goal_position: int) -> Error:
        """The goal block 102..119 as one write."""
        return self.servo.write(
            102,
            struct.pack(
                "<hiIIi",
                goal_current,
                0,
                0,
                0,
                goal_position,
            ),
            self.now_s,
        )


# --- registers


def test_first_values() -> None:
    bench = Bench()
    assert bench.read("model_number") == 1020
    assert bench.read("id") == 1
    assert bench.read("firmware_version") == 46
    assert {
        name: bench.read(name) for name in REGISTERS if REGISTERS[name].writable and name != "id"
    } == {
        name: register.initial
        for name, register in REGISTERS.items()
        if register.writable and name not in ("id", "goal_pwm", "goal_current")
    } | {"goal_pwm": 885, "goal_current": 1193}


def test_gaps_read_as_zero_and_the_end_is_an_error() -> None:
    servo = Bench().servo
    assert servo.read(13, 7) == (Error.NONE, bytes([2, 0, 0, 0, 0, 0, 0]))
    assert servo.read(37, 2) == (Error.NONE, bytes([885 >> 8, 1193 & 0xFF])), (
        "halves of two registers"
    )
    assert servo.read(146, 2) == (Error.DATA_RANGE, b"")


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("id", 7, Error.NONE),
        ("id", 253, Error.DATA_RANGE),
        ("baud_rate", 8, Error.DATA_RANGE),
        ("operating_mode", 2, Error.DATA_RANGE),
        ("homing_offset", -1_044_480, Error.DATA_RANGE),
        ("present_position", 0, Error.ACCESS),
        ("model_number", 1, Error.ACCESS),
        ("goal_current", -501, Error.DATA_LIMIT),
        ("goal_current", -500, Error.NONE),
        ("goal_position", 4096, Error.DATA_LIMIT),
        ("goal_position", -1, Error.DATA_LIMIT),
        ("goal_position", 4095, Error.NONE),
        ("bus_watchdog", 128, Error.DATA_RANGE),
        ("bus_watchdog", -1, Error.DATA_RANGE),
    ],
)
def test_what_may_be_written(name: str, value: int, error: Error) -> None:
    bench = Bench(registers={"current_limit": 500})
    before = bench.read(name)
    assert bench.write(name, value) == error
    assert bench.read(name) == (before if error else value)


def test_writes_take_whole_registers() -> None:
    servo = Bench().servo
    assert servo.write(116, b"\x00\x01", 0.0) == Error.DATA_LENGTH
    assert servo.write(116, b"", 0.0) == Error.DATA_LENGTH
    assert servo.write(117, b"\x00", 0.0) == Error.ACCESS, "in the middle of a register"
    assert servo.write(14, b"\x00", 0.0) == Error.ACCESS, "not defined"
    # Goal Position is good, Realtime Tick behind it is not: neither is written
    assert (
        servo.write(
            116,
            bytes([0, 1, 0, 0, 9, 9]),
            0.0,
        )
        == Error.ACCESS
    )
    assert servo["goal_position"] == 0


def test_eeprom_is_closed_while_torque_is_on() -> None:
    bench = Bench().powered(OperatingMode.CURRENT)
    assert bench.write("return_delay_time", 0) == Error.ACCESS
    assert bench.write("led", 1) == Error.NONE
    assert bench.write("torque_enable", 0) == Error.NONE
    assert bench.write("return_delay_time", 0) == Error.NONE


# --- measuring


def test_position_is_rounded_to_counts() -> None:
    servo = Bench().servo
    unit = XM430_W350.position_unit_rad
    for angle_rad, counts in [(0.0, 2048), (0.49 * unit, 2048), (0.51 * unit, 2049), (-1.0, 1396)]:
        servo.control(0.0, angle_rad, 0.0)
        assert servo["present_position"] == counts
    servo["homing_offset"] = -2048
    servo.control(0.0, 0.0, 0.0)
    assert servo["present_position"] == 0


def test_velocity_is_averaged_and_tick_wraps() -> None:
    servo = Bench().servo
    for step in range(1, 21):
        servo.control(step * 0.001, 0.0, 1.0)
        if step == 1:
            servo.control(step * 0.001, 0.0, -1.0)
            assert servo["present_velocity"] == 0
    assert servo["present_velocity"] == round(1.0 / XM430_W350.velocity_unit_rad_s) == 42
    assert servo["moving"] == 1
    ticks = []
    for milliseconds in (32766, 32767, 32768, 32769):
        servo.control(milliseconds * 0.001, 0.0, 0.0)
        ticks.append(servo["realtime_tick"])
    assert ticks == [32766, 32767, 0, 1]


def test_reversed_drive_mode_mirrors_everything() -> None:
    plain = Bench()
    reverse = Bench(registers={"drive_mode": 1})
    for bench in (plain, reverse):
        bench.powered(OperatingMode.CURRENT).write("goal_current", 50)
        bench.run(0.1)
    assert reverse.read("present_position") == plain.read("present_position")
    assert reverse.read("present_velocity") == plain.read("present_velocity") > 0
    assert reverse.rotors.angle_rad[0] == -plain.rotors.angle_rad[0] < 0


# --- current


def test_torque_on_starts_with_nothing() -> None:
    bench = Bench()
    bench.rotors.angle_rad[0] = 0.5
    bench.run(0.01)
    bench.write("operating_mode", OperatingMode.CURRENT)
    bench.write("goal_current", 100)
    bench.run(0.01)
    assert bench.current_A == 0.0, "torque is off"
    bench.write("torque_enable", 1)
    bench.run(0.01)
    assert (bench.read("goal_current"), bench.current_A) == (0, 0.0)
    bench.write("torque_enable", 0)
    bench.write("operating_mode", OperatingMode.CURRENT_BASED_POSITION)
    bench.write("torque_enable", 1)
    assert bench.read("goal_current") == 1193
    assert (
        bench.read("goal_position")
        == bench.read("present_position")
        == XM430_W350.counts_of_position(0.5)
    )
    bench.run(0.1)
    assert bench.current_A == 0.0, "it is where it should be"


def test_a_new_mode_starts_from_its_own_values() -> None:
    bench = Bench()
    bench.write("position_p_gain", 300)
    bench.write("profile_velocity", 20)
    bench.write("operating_mode", OperatingMode.EXTENDED_POSITION)
    assert (bench.read("position_p_gain"), bench.read("profile_velocity")) == (800, 0)


def test_current_mode_lets_the_goal_flow() -> None:
    bench = Bench().powered(OperatingMode.CURRENT)
    assert bench.write("goal_current", -37) == Error.NONE
    bench.run(0.001)
    assert bench.current_A == pytest.approx(-37 * UNIT_A, abs=1e-12)
    assert bench.read("present_current") == -37
    # the rotor obeys the plain law of motion: I a = kt i - d v
    bench.run(0.1)
    expected = -TORQUE_CONSTANT_NM_A * 37 * UNIT_A * 0.1**2 / (2 * 0.02)
    assert bench.rotors.angle_rad[0] == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("goal_current", [112, -112])
def test_a_far_goal_position_pushes_with_exactly_the_goal_current(goal_current: int) -> None:
    bench = Bench(registers={"position_d_gain": 2000}).powered(OperatingMode.CURRENT_BASED_POSITION)
    sign = 1 if goal_current > 0 else -1
    assert bench.push(abs(goal_current), sign * FAR) == Error.NONE
    seen = set()
    for _ in range(100):
        bench.run(0.001)
        seen.add(bench.read("present_current"))
    assert seen == {goal_current}
    assert abs(bench.rotors.velocity_rad_s[0]) > 1.0


def test_the_sign_of_the_goal_current_is_no_direction_in_mode_5() -> None:
    bench = Bench().powered(OperatingMode.CURRENT_BASED_POSITION)
    for sign in (1, -1):
        assert bench.push(-112, sign * FAR) == Error.NONE
        bench.run(0.001)
        assert bench.read("present_current") == sign * 112


def test_current_based_position_has_the_manuals_gains() -> None:
    servo = VirtualServo(XM430_W350, 1)
    servo["operating_mode"] = 5
    servo.control(0.001, 0.0, 0.0)
    servo.write(64, b"\x01", 0.001)
    servo.write(
        80,
        struct.pack("<H", 160),
        0.001,
    )  # D = 160 / 16
    servo.write(
        84,
        struct.pack("<H", 256),
        0.001,
    )  # P = 256 / 128
    servo.write(
        116,
        struct.pack("<i", 2048 + 30),
        0.001,
    )
    velocity_rad_s = 2.0 * XM430_W350.position_unit_rad * 1000.0  # 2 counts per ms
    assert servo.control(0.002, 0.0, 0.0) == pytest.approx(60 * UNIT_A)
    assert servo.control(0.003, 0.0, velocity_rad_s) == pytest.approx((60 - 20) * UNIT_A)


@pytest.mark.parametrize("mode", [OperatingMode.POSITION, OperatingMode.EXTENDED_POSITION])
def test_position_modes_reach_the_goal(mode: OperatingMode) -> None:
    bench = Bench().powered(mode)
    assert bench.write("position_d_gain", 1000) == Error.NONE
    assert bench.write("goal_position", 2500) == Error.NONE
    bench.run(2.0)
    assert bench.read("present_position") == pytest.approx(2500, abs=1)
    assert bench.read("moving") == 0


def test_velocity_mode_reaches_the_goal() -> None:
    bench = Bench().powered(OperatingMode.VELOCITY)
    assert bench.write("goal_velocity", -60) == Error.NONE
    bench.run(2.0)
    assert bench.read("present_velocity") == pytest.approx(-60, abs=2)


def test_pwm_mode_is_a_voltage() -> None:
    bench = Bench().powered(OperatingMode.PWM)
    bench.rotors.blocked = True
    assert bench.write("goal_pwm", 100) == Error.NONE
    bench.run(0.002)
    assert bench.current_A == pytest.approx(12.0 * 100 / 885 / 5.22, abs=0.5 * UNIT_A)
    assert bench.read("present_pwm") == pytest.approx(100, abs=1)


def test_the_supply_bounds_the_current_at_speed() -> None:
    servo = Bench().powered(OperatingMode.CURRENT).servo
    servo.write(
        102,
        struct.pack("<h", 300),
        0.002,
    )
    for step, velocity_rad_s in enumerate([0.0, 2.0, 4.0, 4.5, 4.8, 6.0, -6.0]):
        current_A = servo.control(0.003 + step * 0.001, 0.0, velocity_rad_s)
        assert abs(5.22 * current_A + 2.49 * velocity_rad_s) <= 12.0 + 1e-9
        free_A = (12.0 - 2.49 * velocity_rad_s) / 5.22
        assert (
            current_A == pytest.approx(min(300 * UNIT_A, free_A), abs=UNIT_A)
            or velocity_rad_s == -6.0
        )
        assert current_A / UNIT_A == pytest.approx(round(current_A / UNIT_A), abs=1e-9)
        assert servo["present_current"] == round(current_A / UNIT_A)


def test_current_limit_bounds_every_mode() -> None:
    bench = Bench(registers={"current_limit": 50}).powered(OperatingMode.EXTENDED_POSITION)
    bench.rotors.blocked = True
    assert bench.write("goal_position", FAR) == Error.NONE
    bench.run(0.01)
    assert bench.read("present_current") == 50


def test_a_goal_takes_effect_after_the_latency() -> None:
    bench = Bench(VirtualServo(XM430_W350, 1, latency_s=0.008)).powered(OperatingMode.CURRENT)
    bench.write("goal_current", 40)
    bench.run(0.004)
    bench.write("goal_current", 80)
    seen = []
    for _ in range(12):
        bench.run(0.001)
        seen.append(bench.read("present_current"))
    # written at 0 and at 4 ms; the first sample here is at 5 ms
    assert seen == [0] * 3 + [40] * 4 + [80] * 5


# --- what stops it


def test_bus_watchdog_trips_on_time_and_blocks_the_goals() -> None:
    bench = Bench().powered(OperatingMode.CURRENT)
    bench.write("goal_current", 30)
    bench.write("bus_watchdog", 2)
    for _ in range(5):
        bench.run(0.030)
        bench.servo.heard(bench.now_s)
    assert (bench.read("bus_watchdog"), bench.read("present_current")) == (2, 30)
    bench.run(0.039)
    assert (bench.read("bus_watchdog"), bench.read("present_current")) == (2, 30)
    bench.run(0.002)
    assert (bench.read("bus_watchdog"), bench.read("present_current"), bench.current_A) == (
        -1,
        0,
        0.0,
    )
    assert bench.write("goal_current", 30) == Error.DATA_RANGE
    assert bench.push(30, 0) == Error.DATA_RANGE
    assert bench.write("bus_watchdog", 5) == Error.DATA_RANGE
    assert bench.write("led", 1) == Error.NONE
    assert bench.write("bus_watchdog", 0) == Error.NONE
    bench.run(0.01)
    assert bench.current_A == 0.0, "the old goal is gone"
    assert bench.write("goal_current", 25) == Error.NONE
    bench.run(0.01)
    assert bench.read("present_current") == 25


def test_bus_watchdog_needs_torque() -> None:
    bench = Bench()
    bench.write("bus_watchdog", 1)
    bench.run(0.5)
    assert bench.read("bus_watchdog") == 1
    bench.write("torque_enable", 1)
    bench.run(0.015)
    assert bench.read("bus_watchdog") == 1, "the time counts from torque on"
    bench.run(0.010)
    assert bench.read("bus_watchdog") == -1


def test_overheating_shuts_down_until_a_reboot() -> None:
    bench = Bench().powered(OperatingMode.CURRENT)
    bench.write("goal_current", 30)
    bench.run(0.01)
    assert bench.servo.status_error(Error.NONE) == 0
    bench.servo.temperature_C = 81.0
    bench.run(0.001)
    assert bench.read("hardware_error_status") == 1 << HardwareError.OVERHEATING
    assert (bench.read("torque_enable"), bench.current_A) == (0, 0.0)
    assert bench.read("present_temperature") == 81
    assert bench.servo.status_error(Error.ACCESS) == ALERT | Error.ACCESS
    bench.servo.temperature_C = 40.0
    bench.run(0.001)
    assert bench.write("torque_enable", 1) == Error.RESULT_FAIL
    assert bench.servo.status_error(Error.NONE) == ALERT
    bench.servo.reboot(bench.now_s)
    bench.run(REBOOT_S + 0.001)
    assert bench.servo.status_error(Error.NONE) == 0
    assert bench.write("torque_enable", 1) == Error.NONE


def test_shutdown_register_decides_whether_torque_goes_off() -> None:
    bench = Bench(registers={"shutdown": 0}).powered(OperatingMode.CURRENT)
    bench.servo.temperature_C = 90.0
    bench.run(0.001)
    assert (bench.read("torque_enable"), bench.read("hardware_error_status")) == (1, 4)


def test_a_weak_supply_is_reported() -> None:
    bench = Bench()
    bench.servo.supply_voltage_V = 9.0
    bench.run(0.001)
    assert bench.read("present_input_voltage") == 90
    assert bench.read("hardware_error_status") == 1 << HardwareError.INPUT_VOLTAGE


def test_overload_after_some_seconds_of_stall_only() -> None:
    bench = Bench().powered(OperatingMode.CURRENT)
    bench.rotors.blocked = True
    bench.write("goal_current", 300)
    bench.run(8.0)
    assert bench.read("hardware_error_status") == 0, "a modest current may flow for ever"
    bench.write("goal_current", 1193)
    bench.run(4.0)
    assert bench.read("hardware_error_status") == 0
    bench.run(2.0)
    assert bench.read("hardware_error_status") == 1 << HardwareError.OVERLOAD
    assert bench.current_A == 0.0


def test_current_heats_the_servo() -> None:
    bench = Bench().powered(OperatingMode.CURRENT)
    bench.rotors.blocked = True
    bench.write("goal_current", 500)
    start_C = bench.servo.temperature_C
    bench.run(1.0)
    # first-order model: rate = R_th R i^2 / time constant at the start
    assert bench.servo.temperature_C - start_C == pytest.approx(
        4.0 * 5.22 * (500 * UNIT_A) ** 2 / 300.0, rel=0.01
    )


def test_reboot_clears_ram_and_keeps_eeprom() -> None:
    bench = Bench()
    bench.write("return_delay_time", 3)
    bench.powered(OperatingMode.CURRENT)
    bench.write("led", 1)
    bench.write("goal_current", 60)
    bench.run(0.05)
    bench.servo.reboot(bench.now_s)
    assert not bench.servo.awake(bench.now_s + 0.9 * REBOOT_S)
    assert bench.servo.awake(bench.now_s + REBOOT_S)
    bench.run(0.01)
    assert (bench.read("led"), bench.read("torque_enable"), bench.current_A) == (0, 0, 0.0)
    assert (bench.read("return_delay_time"), bench.read("operating_mode")) == (3, 0)
    assert bench.read("realtime_tick") == 10, "its clock starts anew"
