"""The emulated bus: the vendor's library talks to it over a pseudo-terminal; timing and faults in memory."""

from __future__ import annotations

import struct
import termios
from collections.abc import Iterator
from pathlib import Path

import dynamixel_sdk as sdk
import pytest
from support.memory_port import MemoryPort
from support.rotors import Rotors
from support.waiting import wait_for
from support.wire import SimulatedPort

from proprio_ros import clock
from proprio_ros.bus.control_table import XM430_W350
from proprio_ros.errors import ConfigurationError
from proprio_ros.virtual.bus import Faults, VirtualBus
from proprio_ros.virtual.port import PtyPort
from proprio_ros.virtual.protocol import BROADCAST_ID, Code, Instruction, Parser, encode_instruction
from proprio_ros.virtual.servo import REBOOT_S, VirtualServo

IDS = (11, 12, 13, 14, 15)
BAUD = 1_000_000


def fast_servos() -> list[VirtualServo]:
    servos = [VirtualServo(XM430_W350, servo_id) for servo_id in IDS]
    for servo in servos:
        servo["baud_rate"] = 3
        servo["return_delay_time"] = 0
    return servos


class Desk:
    """Five servos on a wire in memory, and the vendor's library at its other end, in simulated time."""

    def __init__(self, start_s: float = 0.0) -> None:
        self.servos = fast_servos()
        self.rotors = Rotors(self.servos, start_s)
        self.bus = VirtualBus(self.servos, self.rotors.advance)
        self.handler: sdk.PortHandler = self.opened()
        assert self.handler.openPort()
        assert self.handler.setBaudRate(BAUD)
        self.packets = sdk.PacketHandler(2.0)

    def opened(self) -> sdk.PortHandler:
        return SimulatedPort(self.bus)

    def close(self) -> None:
        self.handler.closePort()

    def read(self, servo_id: int, name: str) -> int:
        register = XM430_W350.registers[name]
        data, result, error = self.packets.readTxRx(
            self.handler, servo_id, register.address, register.size
        )
        assert (result, error & 0x7F) == (sdk.COMM_SUCCESS, 0)
        return register.decode(bytes(data))

    def write(
        self,
        servo_id: int,
        name: str,
        value: int,
    ) -> tuple[int, int]:
        """Result of the communication, and the servo's error."""
        register = XM430_W350.registers[name]
        data = list(register.encode(value))
        result, error = self.packets.writeTxRx(
            self.handler, servo_id, register.address, register.size, data
        )
        return result, error


class PluggedDesk(Desk):
    """The same on a pseudo-terminal, in real time."""

    def __init__(self, link: Path) -> None:
        self.link = link
        super().__init__(clock.now())

    def opened(self) -> sdk.PortHandler:
        self.port = PtyPort(self.bus, self.link)
        return sdk.PortHandler(str(self.port.path))

    def close(self) -> None:
        super().close()
        self.port.close()


@pytest.fixture
def desk() -> Desk:
    return Desk()


@pytest.fixture
def plugged(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[PluggedDesk]:
    # how long the library waits is not what is tested: servos and library are one process, on a machine that may be busy
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 10_000)
    desk = PluggedDesk(tmp_path / "arm")
    yield desk
    desk.close()


# --- the vendor's library


def test_ping(desk: Desk) -> None:
    assert desk.packets.ping(desk.handler, 12) == (1020, sdk.COMM_SUCCESS, 0)
    assert desk.packets.ping(desk.handler, 1)[1] == sdk.COMM_RX_TIMEOUT


def test_broadcast_ping(desk: Desk) -> None:
    found, result = desk.packets.broadcastPing(desk.handler)
    assert result == sdk.COMM_SUCCESS
    assert found == {servo_id: [1020, 46] for servo_id in IDS}


def test_registers_and_their_rules(desk: Desk) -> None:
    good = (sdk.COMM_SUCCESS, 0)
    assert desk.write(11, "current_limit", 400) == good
    assert desk.write(11, "goal_current", 401) == (sdk.COMM_SUCCESS, 6)
    assert desk.write(11, "led", 2) == (sdk.COMM_SUCCESS, 4)
    assert desk.write(11, "present_current", 2) == (sdk.COMM_SUCCESS, 7)
    assert desk.write(11, "torque_enable", 1) == good
    assert desk.write(11, "current_limit", 300) == (sdk.COMM_SUCCESS, 7)
    assert desk.read(11, "current_limit") == 400
    assert desk.packets.write2ByteTxRx(desk.handler, 11, 116, 3) == (sdk.COMM_SUCCESS, 5)
    _, result, error = desk.packets.readTxRx(
        desk.handler,
        11,
        145,
        4,
    )
    assert (result, error) == (sdk.COMM_SUCCESS, 4)


def test_a_new_id_is_heard(desk: Desk) -> None:
    assert desk.write(11, "id", 21) == (sdk.COMM_SUCCESS, 0)
    assert desk.packets.ping(desk.handler, 21)[1] == sdk.COMM_SUCCESS


def test_header_bytes_in_the_data(desk: Desk) -> None:
    offset = int.from_bytes(b"\xff\xff\xfd\xff", "little", signed=True)
    assert desk.write(13, "homing_offset", offset) == (sdk.COMM_SUCCESS, 0)
    assert desk.servos[2]["homing_offset"] == offset == -131_073
    assert desk.read(13, "homing_offset") == offset
    desk.handler.wait(0.01)
    assert desk.read(13, "present_position") == 2048 + offset


def test_sync_read_and_fast_sync_read_of_five(desk: Desk) -> None:
    desk.rotors.angle_rad = [0.1 * index for index in range(5)]
    for fast in (False, True):
        group = sdk.GroupSyncRead(
            desk.handler,
            desk.packets,
            126,
            10,
        )
        assert all(group.addParam(servo_id) for servo_id in IDS)
        desk.handler.wait(0.01)
        assert (group.fastSyncRead() if fast else group.txRxPacket()) == sdk.COMM_SUCCESS
        positions = [group.getData(servo_id, 132, 4) for servo_id in IDS]
        assert positions == [XM430_W350.counts_of_position(0.1 * index) for index in range(5)]


def test_old_firmware_knows_no_fast_sync_read(desk: Desk) -> None:
    desk.servos[0]["firmware_version"] = 44
    group = sdk.GroupSyncRead(
        desk.handler,
        desk.packets,
        126,
        10,
    )
    assert group.addParam(11)
    assert group.fastSyncRead() == sdk.COMM_RX_TIMEOUT
    assert group.txRxPacket() == sdk.COMM_SUCCESS


def test_sync_write_of_the_goal_block_pushes(desk: Desk) -> None:
    for servo_id in IDS:
        assert desk.write(servo_id, "operating_mode", 5) == (sdk.COMM_SUCCESS, 0)
        assert desk.write(servo_id, "torque_enable", 1) == (sdk.COMM_SUCCESS, 0)
    group = sdk.GroupSyncWrite(
        desk.handler,
        desk.packets,
        102,
        18,
    )
    for index, servo_id in enumerate(IDS):
        far = 1_048_575 if index % 2 else -1_048_575
        assert group.addParam(
            servo_id,
            list(
                struct.pack(
                    "<hiIIi",
                    20 + index,
                    0,
                    0,
                    0,
                    far,
                )
            ),
        )
    assert group.txPacket() == sdk.COMM_SUCCESS
    desk.handler.wait(0.1)
    for index, servo_id in enumerate(IDS):
        sign = 1 if index % 2 else -1
        assert desk.read(servo_id, "present_current") == sign * (20 + index)
        assert sign * desk.read(servo_id, "present_velocity") > 0


def test_status_return_level(desk: Desk) -> None:
    assert desk.write(11, "status_return_level", 1) == (sdk.COMM_SUCCESS, 0)
    assert desk.write(11, "led", 1)[0] == sdk.COMM_RX_TIMEOUT
    assert desk.read(11, "led") == 1
    assert desk.write(11, "status_return_level", 0)[0] == sdk.COMM_RX_TIMEOUT
    assert desk.packets.read1ByteTxRx(desk.handler, 11, 65)[1] == sdk.COMM_RX_TIMEOUT
    assert desk.packets.ping(desk.handler, 11) == (1020, sdk.COMM_SUCCESS, 0)


def test_reboot_is_silent_for_a_while(desk: Desk) -> None:
    assert desk.write(11, "led", 1) == (sdk.COMM_SUCCESS, 0)
    start_s = desk.handler.now_s
    assert desk.packets.reboot(desk.handler, 11) == (sdk.COMM_SUCCESS, 0)
    assert desk.packets.ping(desk.handler, 11)[1] == sdk.COMM_RX_TIMEOUT
    assert desk.packets.ping(desk.handler, 12)[1] == sdk.COMM_SUCCESS
    while desk.packets.ping(desk.handler, 11)[1] != sdk.COMM_SUCCESS:
        assert desk.handler.now_s < start_s + 2.0
    assert desk.handler.now_s - start_s >= REBOOT_S
    assert desk.read(11, "led") == 0


def test_what_is_not_emulated_says_so(desk: Desk) -> None:
    assert desk.packets.clearMultiTurn(desk.handler, 11) == (sdk.COMM_SUCCESS, 2)
    assert desk.packets.factoryReset(desk.handler, 11, 0x02) == (sdk.COMM_SUCCESS, 2)


def test_bus_watchdog_over_the_wire(desk: Desk) -> None:
    assert desk.write(11, "operating_mode", 0) == (sdk.COMM_SUCCESS, 0)
    assert desk.write(11, "torque_enable", 1) == (sdk.COMM_SUCCESS, 0)
    assert desk.write(11, "goal_current", 20) == (sdk.COMM_SUCCESS, 0)
    assert desk.write(11, "bus_watchdog", 25) == (sdk.COMM_SUCCESS, 0)  # 0.5 s
    for _ in range(20):  # packets to another servo count, too
        desk.handler.wait(0.03)
        assert desk.packets.ping(desk.handler, 12)[1] == sdk.COMM_SUCCESS
    assert desk.read(11, "bus_watchdog") == 25
    desk.handler.wait(0.55)
    assert desk.read(11, "bus_watchdog") == -1
    assert desk.read(11, "present_current") == 0
    assert desk.write(11, "goal_current", 20) == (sdk.COMM_SUCCESS, 4)
    assert desk.write(11, "bus_watchdog", 0) == (sdk.COMM_SUCCESS, 0)
    assert desk.write(11, "goal_current", 20) == (sdk.COMM_SUCCESS, 0)


def test_an_overheated_servo_raises_the_alert_bit(desk: Desk) -> None:
    desk.servos[0].temperature_C = 85.0
    desk.handler.wait(0.01)
    assert desk.packets.ping(desk.handler, 11) == (1020, sdk.COMM_SUCCESS, 0x80)
    assert desk.read(11, "hardware_error_status") == 4
    assert desk.write(11, "torque_enable", 1) == (sdk.COMM_SUCCESS, 0x81)


# --- the port


def test_the_library_over_a_pseudo_terminal(plugged: PluggedDesk) -> None:
    assert plugged.packets.ping(plugged.handler, 12) == (1020, sdk.COMM_SUCCESS, 0)
    assert plugged.write(13, "led", 1) == (sdk.COMM_SUCCESS, 0)
    assert [plugged.read(servo_id, "led") for servo_id in IDS] == [0, 0, 1, 0, 0]


def test_unplugged_and_plugged_in_again(plugged: PluggedDesk) -> None:
    assert plugged.packets.ping(plugged.handler, 11)[1] == sdk.COMM_SUCCESS
    with plugged.port.lock:
        plugged.servos[0]["led"] = 1
    plugged.port.unplug()
    assert not plugged.port.path.is_symlink()
    # serial.SerialException is an OSError, termios.error is none
    with pytest.raises((OSError, termios.error)):
        plugged.packets.ping(plugged.handler, 11)
    plugged.handler.closePort()
    plugged.port.plug()
    assert plugged.port.path.is_symlink()
    handler = sdk.PortHandler(str(plugged.port.path))
    assert handler.openPort()
    value, result, _ = plugged.packets.read1ByteTxRx(
        handler,
        11,
        65,
    )
    assert (value, result) == (1, sdk.COMM_SUCCESS), "the servos kept their power"
    handler.closePort()
    plugged.handler.openPort()


def test_the_world_keeps_up_while_nobody_talks(plugged: PluggedDesk) -> None:
    begun_s = plugged.rotors.time_s
    assert wait_for(lambda: plugged.rotors.time_s > begun_s + 0.1)


def test_a_client_that_never_reads_does_not_block(plugged: PluggedDesk) -> None:
    ping = encode_instruction(11, Code.PING)
    for _ in range(1000):  # 14 kB of replies, more than a terminal holds
        plugged.handler.ser.write(ping)
    begun_s = plugged.rotors.time_s
    assert wait_for(lambda: plugged.rotors.time_s > begun_s + 0.1)
    assert plugged.packets.ping(plugged.handler, 12)[1] in (sdk.COMM_SUCCESS, sdk.COMM_RX_CORRUPT)
    assert plugged.packets.ping(plugged.handler, 12)[1] == sdk.COMM_SUCCESS


def test_link_over_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm").write_text("precious")
    with pytest.raises(ConfigurationError, match="choose another name"):
        PtyPort(VirtualBus([], lambda _: None), tmp_path / "arm")
    assert (tmp_path / "arm").read_text() == "precious"


def test_a_broken_world_is_reported_on_close(tmp_path: Path) -> None:
    def broken(now_s: float) -> None:
        raise ZeroDivisionError("the world ended")

    port = PtyPort(VirtualBus(fast_servos(), broken), tmp_path / "arm")
    assert wait_for(lambda: not port.path.is_symlink()), "the client notices, too"
    with pytest.raises(ZeroDivisionError, match="the world ended"):
        port.close()


# --- in memory: time on the wire and faults


class Line:
    """A bus in memory whose clock the test moves."""

    def __init__(
        self,
        servos: list[VirtualServo],
        faults: Faults | None = None,
    ) -> None:
        self.now_s = 0.0
        self.rotors = Rotors(servos)
        self.bus = VirtualBus(
            servos,
            self.rotors.advance,
            faults=faults,
        )
        self.port = MemoryPort(self.bus, lambda: self.now_s)

    def ask(
        self,
        servo_id: int,
        code: int,
        params: bytes = b"",
        wait_s: float = 0.1,
    ) -> list[Instruction]:
        """Status packets with a correct CRC that come within a time."""
        self.port.write(encode_instruction(servo_id, code, params))
        self.now_s += wait_s
        packets = Parser().feed(self.port.read(10_000))
        return [packet for packet in packets if isinstance(packet, Instruction)]


def sync_read(
    address: int,
    length: int,
    ids: tuple[int, ...] = IDS,
) -> bytes:
    return struct.pack("<HH", address, length) + bytes(ids)


def test_replies_take_the_time_of_their_bits() -> None:
    # 5 x 10 bytes at 1 Mb/s: request 19 bytes, replies 21 bytes each, 10 us per byte
    for code, delay_s in (
        (Code.SYNC_READ, (19 + 5 * 21) * 1e-5),
        (Code.FAST_SYNC_READ, (19 + 8 + 5 * 14) * 1e-5),
    ):
        line = Line(fast_servos())
        replies = line.bus.receive(
            encode_instruction(BROADCAST_ID, code, sync_read(126, 10)),
            0.0,
        )
        assert replies[-1].delay_s == pytest.approx(delay_s, rel=1e-9)
        assert len(replies) == (5 if code == Code.SYNC_READ else 1)
    # the default return delay is 500 us per servo
    slow = fast_servos()
    for servo in slow:
        servo["return_delay_time"] = 250
    replies = Line(slow).bus.receive(
        encode_instruction(BROADCAST_ID, Code.SYNC_READ, sync_read(126, 10)), 0.0
    )
    assert replies[-1].delay_s == pytest.approx((19 + 5 * 21) * 1e-5 + 5 * 500e-6)


def test_memory_port_delivers_in_time() -> None:
    line = Line(fast_servos())
    line.port.write(encode_instruction(11, Code.PING))  # 10 + 14 bytes: 0.24 ms
    line.now_s = 0.000239
    assert line.port.in_waiting == 0
    line.now_s = 0.000241
    assert line.port.in_waiting == 14
    assert len(line.port.read(4)) == 4
    assert len(line.port.read(100)) == 10


def test_broadcasts_but_ping_are_obeyed_silently() -> None:
    line = Line(fast_servos())
    assert line.ask(BROADCAST_ID, Code.WRITE, bytes([65, 0, 1])) == []
    assert [servo["led"] for servo in line.bus.servos] == [1] * 5
    assert (
        line.ask(
            BROADCAST_ID,
            Code.READ,
            bytes([65, 0, 1, 0]),
        )
        == []
    )
    assert [packet.id for packet in line.ask(BROADCAST_ID, Code.PING)] == list(IDS)
    assert line.ask(BROADCAST_ID, Code.REBOOT) == []
    assert line.ask(BROADCAST_ID, Code.PING) == []


def test_a_silent_servo_silences_those_after_it() -> None:
    line = Line(fast_servos(), Faults(hang={13}))
    answers = line.ask(
        BROADCAST_ID,
        Code.SYNC_READ,
        sync_read(126, 10),
    )
    assert [packet.id for packet in answers] == [11, 12]
    assert line.ask(BROADCAST_ID, Code.FAST_SYNC_READ, sync_read(126, 10)) == [], "it breaks off"
    assert line.ask(13, Code.PING) == []
    line.bus.faults.hang.clear()
    assert len(line.ask(BROADCAST_ID, Code.SYNC_READ, sync_read(126, 10))) == 5


def test_a_hung_servo_trips_its_watchdog_alone() -> None:
    line = Line(fast_servos())
    line.ask(
        BROADCAST_ID,
        Code.WRITE,
        bytes([64, 0, 1]),
    )
    line.ask(
        BROADCAST_ID,
        Code.WRITE,
        bytes([98, 0, 10]),
    )
    line.bus.faults.hang.add(13)
    for _ in range(5):
        line.ask(11, Code.PING)
    assert [servo["bus_watchdog"] for servo in line.bus.servos] == [10, 10, -1, 10, 10]


def test_the_wrong_baud_rate_is_not_understood() -> None:
    line = Line(fast_servos())
    line.bus.port_baud = 57600
    assert line.ask(11, Code.PING) == []
    line.bus.servos[0]["baud_rate"] = 1
    assert [packet.id for packet in line.ask(BROADCAST_ID, Code.PING)] == [11]


def test_a_damaged_request_is_a_crc_error() -> None:
    line = Line(fast_servos())
    packet = bytearray(
        encode_instruction(
            11,
            Code.WRITE,
            bytes([65, 0, 1]),
        )
    )
    packet[10] ^= 0x01
    replies = line.bus.receive(bytes(packet), 0.0)
    answer = Parser().feed(replies[0].data)[0]
    assert isinstance(answer, Instruction)
    assert answer.params == b"\x03"
    assert line.bus.servos[0]["led"] == 0


def test_an_unfinished_request_is_given_up() -> None:
    line = Line(fast_servos())
    line.port.write(
        encode_instruction(
            11,
            Code.WRITE,
            bytes([65, 0, 1]),
        )[:-4]
    )
    line.now_s += 0.05
    assert [packet.id for packet in line.ask(12, Code.PING)] == [12]


def test_instructions_nobody_knows() -> None:
    line = Line(fast_servos())
    assert line.ask(11, 0x77)[0].params == b"\x02"
    assert line.ask(11, Code.READ, b"\x00")[0].params == b"\x05"
    assert (
        line.ask(BROADCAST_ID, 0x77) == line.ask(BROADCAST_ID, Code.FAST_SYNC_READ, b"\x00") == []
    )
    assert line.ask(BROADCAST_ID, Code.FAST_SYNC_READ, sync_read(126, 65000)) == []


@pytest.mark.long
def test_drop_corrupt_and_delay_happen_as_often_as_asked() -> None:
    counts = {}
    for name, faults in (
        ("drop", Faults(drop=0.3)),
        ("corrupt", Faults(corrupt=0.3)),
        ("corrupt_requests", Faults(corrupt_requests=0.3)),
    ):
        line = Line(fast_servos(), faults)
        counts[name] = sum(
            bool(
                line.ask(
                    11,
                    Code.PING,
                    wait_s=0.02,
                )
            )
            for _ in range(1000)
        )
    # three standard deviations of 1000 draws are 43; damage always spoils the CRC, or what precedes it
    for name, answered in counts.items():
        if name != "corrupt_requests":
            assert abs(answered - 700) < 50, name
    # a damaged request is often answered with a CRC error, so more of them are answered
    assert counts["corrupt_requests"] > 700
    line = Line(fast_servos(), Faults(delay_s=0.02))
    assert line.ask(11, Code.PING, wait_s=0.019) == []
    assert len(line.port.read(100)) == 0
    line.now_s += 0.002
    assert len(line.port.read(100)) == 14


def test_the_same_seed_brings_the_same_faults() -> None:
    def pattern(seed: int) -> list[bool]:
        line = Line(
            fast_servos(),
            Faults(drop=0.5, seed=seed),
        )
        return [bool(line.ask(11, Code.PING)) for _ in range(50)]

    assert pattern(3) == pattern(3) != pattern(4)


def test_faults_reach_the_vendors_library(desk: Desk) -> None:
    desk.bus.faults.drop = 1.0
    assert desk.packets.ping(desk.handler, 11)[1] == sdk.COMM_RX_TIMEOUT
    desk.bus.faults.drop = 0.0
    desk.bus.faults.corrupt = 1.0
    results = {desk.packets.ping(desk.handler, 11)[1] for _ in range(5)}
    assert results
    assert sdk.COMM_SUCCESS not in results
    desk.bus.faults.corrupt = 0.0
    assert desk.packets.ping(desk.handler, 11)[1] == sdk.COMM_SUCCESS


def test_two_servos_with_one_id_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="needs its own ID"):
        VirtualBus(
            [VirtualServo(XM430_W350, 1), VirtualServo(XM430_W350, 1)],
            lambda _: None,
        )
