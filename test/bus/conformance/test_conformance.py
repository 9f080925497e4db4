"""What a real servo and an emulated one must both do: one suite over memory, a pseudo-terminal, and hardware.

``pytest test/bus/conformance --hardware-port /dev/ttyUSB0 [--hardware-ids 11,12] [--hardware-moves]`` runs it on hardware. Torque
goes off, so support the arm first; nothing moves a motor without ``--hardware-moves``. Registers are put back at the end.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import dynamixel_sdk as sdk
import pytest
from support.desk import Desk, servos_named
from support.simulated_port import simulated

from proprio_ros import clock
from proprio_ros.bus.control_table import BUS_WATCHDOG_TRIPPED, XM430_W350, OperatingMode
from proprio_ros.bus.dynamixel import ALERT, DynamixelBus, Goal
from proprio_ros.errors import BusError

REGISTERS = XM430_W350.registers
KEPT = ("return_delay_time", "drive_mode", "operating_mode", "homing_offset", "current_limit")
# error numbers of Protocol 2.0
RANGE = 4
LENGTH = 5
LIMIT = 6
ACCESS = 7
FAR = 1_000_000
PUSH = 30  # counts, 81 mA


@dataclass
class Bench:
    """Servos that are to be tested.

    Attributes:
        bus: Open; the first servo is the one that the tests of a single servo use.
        id: Of that servo.
        another: Makes a second bus to the same servos, for when the first is closed; says whether it may use Fast Sync Read.
        wait: Lets time pass for the servos.
        moves: Whether the first servo may turn.
    """

    bus: DynamixelBus
    another: Callable[[bool], DynamixelBus]
    wait: Callable[[float], None]
    moves: bool

    @property
    def id(self) -> int:
        return self.bus.servos[0].id

    def read(self, register: str) -> int:
        return self.bus.read(self.id, register)

    def write(self, register: str, value: int) -> None:
        self.bus.write(self.id, register, value)

    def raw_write(
        self,
        register: str,
        data: bytes,
    ) -> tuple[int, int]:
        """Result of the vendor's library, and the error number in the answer."""
        address = REGISTERS[register].address
        packets = sdk.PacketHandler(2.0)
        result, error = self._tried(
            lambda port: packets.writeTxRx(port, self.id, address, len(data), list(data))
        )
        return result, error & ~ALERT

    def raw_read(
        self,
        address: int,
        length: int,
    ) -> tuple[bytes, int, int]:
        """Data, result and error number."""
        packets = sdk.PacketHandler(2.0)
        data, result, error = self._tried(
            lambda port: packets.readTxRx(port, self.id, address, length)
        )
        return bytes(data), result, error & ~ALERT

    def _tried(
        self,
        exchange: Callable[[Any], Any],
    ) -> Any:
        return self.bus._guarded(exchange)

    def refusal(self, register: str, value: int) -> int:
        """Number of the error with which a write is refused; 0 when it is not."""
        result, error = self.raw_write(
            register,
            REGISTERS[register].encode(value),
        )
        assert result == sdk.COMM_SUCCESS
        return error

    def without_current(self) -> None:
        """Torque on, in current mode, with a current of zero."""
        self.write("torque_enable", 0)
        self.write("operating_mode", OperatingMode.CURRENT)
        self.write("goal_current", 0)
        self.write("torque_enable", 1)
        self.write("goal_current", 0)


@pytest.fixture(params=["memory", "hardware"])
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    if request.param == "hardware":
        option = request.config.getoption
        port = option("--hardware-port")
        if port is None:
            pytest.skip("needs --hardware-port")
        servos = servos_named([int(word) for word in option("--hardware-ids").split(",")])

        def hardware(fast: bool) -> DynamixelBus:
            return DynamixelBus(port, servos, option("--hardware-baud"), fast_sync_read=fast)

        yield from opened(hardware, option("--hardware-moves"))
        return
    with (
        simulated() as time_of_the_test,
        Desk(
            (11, 12),
            time_of_the_test,
        ) as desk,
    ):
        yield from opened(lambda fast: desk.bus(fast=fast), True)


def opened(
    another: Callable[[bool], DynamixelBus],
    moves: bool,
) -> Iterator[Bench]:
    bus = another(True)
    bus.open()
    bus.handshake()
    bench = Bench(bus, another, clock.sleep, moves)
    for servo in bus.servos:
        bus.write(servo.id, "bus_watchdog", 0)
        bus.write(servo.id, "torque_enable", 0)
    kept = {name: bench.read(name) for name in KEPT}
    yield bench
    if not bus.is_open:
        bus.open()
    bench.raw_write("status_return_level", b"\x02")
    bench.write("bus_watchdog", 0)
    bench.write("torque_enable", 0)
    bench.write("led", 0)
    for name, value in kept.items():
        if bench.read(name) != value:
            bench.write(name, value)
    bus.close()


@pytest.fixture
def turning(bench: Bench) -> Bench:
    """The same, for tests that turn the first servo."""
    if not bench.moves:
        pytest.skip("needs --hardware-moves")
    return bench


# --- registers


def test_ping_gives_the_model(bench: Bench) -> None:
    assert bench.bus.ping(bench.id) == bench.read("model_number") == XM430_W350.number
    assert bench.read("id") == bench.id
    assert bench.read("firmware_version") > 0


@pytest.mark.parametrize("name", REGISTERS)
def test_every_register_is_there(bench: Bench, name: str) -> None:
    register = REGISTERS[name]
    data, result, error = bench.raw_read(register.address, register.size)
    assert (result, error, len(data)) == (sdk.COMM_SUCCESS, 0, register.size)
    if register.writable and name != "bus_watchdog":
        assert register.lowest <= register.decode(data) <= register.highest


def test_the_registers_lie_where_the_table_says(bench: Bench) -> None:
    block, result, error = bench.raw_read(0, 64)
    assert (result, error, len(block)) == (sdk.COMM_SUCCESS, 0, 64)
    found = {
        name: register.decode(block[register.address : register.address + register.size])
        for name, register in REGISTERS.items()
        if register.eeprom
    }
    assert found == {name: bench.read(name) for name in found}


def test_values_out_of_range_and_beyond_a_limit(bench: Bench) -> None:
    bench.write("current_limit", 100)
    assert bench.refusal("goal_current", 100) == bench.refusal("goal_current", -100) == 0
    assert bench.refusal("goal_current", 101) == bench.refusal("goal_current", -101) == LIMIT
    assert bench.read("goal_current") == -100
    bench.write("goal_current", 0)
    assert bench.refusal("led", 2) == RANGE
    assert bench.refusal("operating_mode", 2) == RANGE
    assert bench.read("led") == 0


def test_read_only(bench: Bench) -> None:
    assert bench.refusal("present_input_voltage", 100) == ACCESS
    assert bench.refusal("model_number", 1) == ACCESS
    with pytest.raises(BusError, match="refuses access"):
        bench.write("present_temperature", 20)


def test_part_of_a_register_is_refused(bench: Bench) -> None:
    assert bench.raw_write("homing_offset", b"\x01\x00") == (sdk.COMM_SUCCESS, LENGTH)


def test_eeprom_is_locked_while_torque_is_on(bench: Bench) -> None:
    delay = bench.read("return_delay_time")
    bench.without_current()
    assert bench.read("torque_enable") == 1
    assert bench.refusal("return_delay_time", (delay + 1) % 255) == ACCESS
    assert bench.refusal("operating_mode", OperatingMode.POSITION) == ACCESS
    assert (bench.read("return_delay_time"), bench.read("operating_mode")) == (
        delay,
        OperatingMode.CURRENT,
    )
    assert bench.refusal("led", 1) == 0, "RAM is not"
    bench.write("torque_enable", 0)
    assert bench.read("torque_enable") == 0
    assert bench.refusal("operating_mode", OperatingMode.POSITION) == 0
    assert bench.read("operating_mode") == OperatingMode.POSITION


def test_header_bytes_within_the_data(bench: Bench) -> None:
    """A homing offset of FF FF FD FF has to be stuffed in both directions."""
    before = bench.read("present_position")
    offset = REGISTERS["homing_offset"].decode(b"\xff\xff\xfd\xff")
    kept = bench.read("homing_offset")
    bench.write("homing_offset", offset)
    assert bench.read("homing_offset") == offset
    bench.wait(0.02)
    assert bench.read("present_position") - before == pytest.approx(offset - kept, abs=3)


# --- who answers, and when


def test_status_return_levels(bench: Bench) -> None:
    bench.raw_write("status_return_level", b"\x01")  # whether this one is answered is not laid down
    bench.wait(0.03)
    assert bench.read("status_return_level") == 1
    assert bench.raw_write("led", b"\x01")[0] == sdk.COMM_RX_TIMEOUT
    assert bench.read("led") == 1, "obeyed in silence"
    bench.raw_write("status_return_level", b"\x00")
    bench.wait(0.03)
    assert bench.raw_read(REGISTERS["led"].address, 1)[1] == sdk.COMM_RX_TIMEOUT
    assert bench.bus.ping(bench.id) == XM430_W350.number
    bench.raw_write("status_return_level", b"\x02")
    bench.wait(0.03)
    bench.write("led", 0)


def test_return_delay(bench: Bench) -> None:
    def exchange_s() -> float:
        times = []
        for _ in range(60):
            started = clock.now()
            bench.read("led")
            times.append(clock.now() - started)
        return statistics.median(times)

    bench.write("return_delay_time", 0)
    fast_s = exchange_s()
    bench.write("return_delay_time", 250)
    assert 0.2e-3 < exchange_s() - fast_s < 1.5e-3, (
        "500 us by the manual; adapters round to milliseconds"
    )


def test_sync_read_and_fast_sync_read_agree(bench: Bench) -> None:
    bench.bus.close()
    readings = []
    for fast in (False, True):
        bus = bench.another(fast)
        bus.open()
        bus.handshake()
        old = any(bus.read(servo.id, "firmware_version") < 45 for servo in bus.servos)
        assert bus.fast is (fast and not old)
        readings.append(bus.read_states().states)
        single = {servo.joint: bus.read(servo.id, "present_position") for servo in bus.servos}
        bus.close()
    plain, quick = readings
    assert set(plain) == set(quick) == set(single)
    for joint, counts in single.items():
        unit = XM430_W350.position_unit_rad
        assert plain[joint].angle_rad == pytest.approx(XM430_W350.angle_rad(counts), abs=3 * unit)
        assert quick[joint].angle_rad == pytest.approx(XM430_W350.angle_rad(counts), abs=3 * unit)
        assert plain[joint].current_A == quick[joint].current_A == 0.0


def test_a_sync_write_of_the_goals_arrives(bench: Bench) -> None:
    for servo in bench.bus.servos:
        bench.bus.write(servo.id, "profile_velocity", 7)
    position = bench.read("present_position")
    bench.bus.write_goals({servo.joint: Goal(17, position) for servo in bench.bus.servos})
    for servo in bench.bus.servos:
        assert bench.bus.read(servo.id, "goal_current") == 17
        assert bench.bus.read(servo.id, "profile_velocity") == 0, "it lies between the two goals"
    bench.bus.write_goals({servo.joint: Goal(0, position) for servo in bench.bus.servos})
    assert bench.read("goal_current") == 0


# --- what a servo does by itself


def test_the_bus_watchdog(bench: Bench) -> None:
    bench.without_current()
    bench.write("bus_watchdog", 15)
    for _ in range(5):
        bench.wait(0.1)
        assert bench.read("bus_watchdog") == 15, "300 ms without a packet have not passed"
    bench.wait(0.5)
    assert bench.read("bus_watchdog") == BUS_WATCHDOG_TRIPPED
    assert bench.refusal("goal_current", 0) == RANGE
    assert bench.refusal("bus_watchdog", 0) == 0
    assert bench.read("bus_watchdog") == 0
    assert bench.refusal("goal_current", 0) == 0


def test_the_bus_watchdog_is_off_without_torque(bench: Bench) -> None:
    bench.write("bus_watchdog", 1)
    bench.wait(0.2)
    assert bench.read("bus_watchdog") == 1


def test_a_reboot_clears_ram_and_keeps_eeprom(bench: Bench) -> None:
    delay = 100 if bench.read("return_delay_time") != 100 else 101
    bench.write("return_delay_time", delay)
    bench.without_current()
    bench.write("led", 1)
    bench.write("position_d_gain", 123)
    bench.bus.reboot(bench.id)
    assert (bench.read("led"), bench.read("torque_enable")) == (0, 0)
    assert bench.read("position_d_gain") == REGISTERS["position_d_gain"].initial
    assert (bench.read("return_delay_time"), bench.read("operating_mode")) == (
        delay,
        OperatingMode.CURRENT,
    )


def test_the_realtime_tick_counts_milliseconds_and_wraps(bench: Bench) -> None:
    first = bench.read("realtime_tick")
    assert 0 <= first < 32768
    bench.wait(0.5)
    second = bench.read("realtime_tick")
    assert (second - first) % 32768 == pytest.approx(500, abs=100)
    to_wrap_ms = 32768 - second
    bench.wait(1e-3 * to_wrap_ms + 0.5)
    assert 450 <= bench.read("realtime_tick") < 3000, (
        "emulated servos need a moment for half a minute"
    )


# --- with motion


def test_current_mode_drives_with_the_goal_current(turning: Bench) -> None:
    turning.without_current()
    for goal in (PUSH, -PUSH):
        turning.write("goal_current", goal)
        turning.wait(0.05)
        assert turning.read("present_current") == pytest.approx(goal, abs=3)
    turning.write("goal_current", 0)
    turning.wait(0.05)
    assert turning.read("present_current") == pytest.approx(0, abs=3)


def test_a_far_goal_position_drives_with_the_goal_current(turning: Bench) -> None:
    """How the driver pushes without leaving the mode that holds."""
    turning.write("torque_enable", 0)
    turning.write("operating_mode", OperatingMode.CURRENT_BASED_POSITION)
    turning.write("torque_enable", 1)
    joint = turning.bus.servos[0].joint
    here = turning.read("present_position")
    for sign in (1, -1):
        turning.bus.write_goals({joint: Goal(PUSH, here + sign * FAR)})
        assert turning.read("goal_position") == here + sign * FAR
        turning.wait(0.05)
        assert turning.read("present_current") == pytest.approx(sign * PUSH, abs=3)
    turning.bus.write_goals({joint: Goal(0, here)})
    turning.wait(0.05)
    assert turning.read("present_current") == pytest.approx(0, abs=3)


def test_the_units_of_position_and_velocity_agree(turning: Bench) -> None:
    turning.without_current()
    turning.write("goal_current", PUSH)
    turning.wait(0.3)
    joint = turning.bus.servos[0].joint
    turning.write("goal_current", 0)
    samples = []
    for _ in range(20):
        tick = turning.read("realtime_tick")
        samples.append((tick, turning.bus.read_states().states[joint]))
        turning.wait(0.01)
    passed_s = 1e-3 * ((samples[-1][0] - samples[0][0]) % 32768)
    travel_rad = samples[-1][1].angle_rad - samples[0][1].angle_rad
    mean_rad_s = statistics.fmean(state.velocity_rad_s for _, state in samples)
    assert travel_rad > 0.02, "it has to turn for this test"
    assert mean_rad_s == pytest.approx(travel_rad / passed_s, rel=0.15)
