"""The bus, in simulated time: what is there, what is lost, what is refused, and the traps of the vendor's library."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import dynamixel_sdk as sdk
import pytest
from support.desk import Desk
from support.simulated_time import SimulatedClock

from proprio_ros.bus.control_table import (
    XM430_W350,
    HardwareError,
    OperatingMode,
    Register,
    servo_model,
)
from proprio_ros.bus.dynamixel import TRIES, BusServo, DynamixelBus, Goal, servos_of
from proprio_ros.bus.port import REPLY_TIMEOUT_S
from proprio_ros.calibration_files.motors import MotorIdentity, other_arm
from proprio_ros.errors import BusError, PortLostError, RobotError
from proprio_ros.robot import load_robot
from proprio_ros.virtual.protocol import crc16
from proprio_ros.virtual.servo import REBOOT_S, VirtualServo

IDS = (11, 12, 13, 14, 15)
JOINTS = {f"joint{servo_id}" for servo_id in IDS}
MODE_5 = OperatingMode.CURRENT_BASED_POSITION


@pytest.fixture
def desk(clock: SimulatedClock) -> Iterator[Desk]:
    with Desk(IDS, clock) as desk:
        for index in range(len(IDS)):
            # none is at 0, which lost data could be taken for
            desk.rotors.angle_rad[index] = 0.2 * (index + 1)
        yield desk


@pytest.fixture(params=[True, False], ids=["fast", "plain"])
def bus(
    request: pytest.FixtureRequest,
    desk: Desk,
) -> Iterator[DynamixelBus]:
    """Open, servos prepared."""
    bus = desk.bus(fast=request.param)
    bus.open()
    bus.handshake()
    assert bus.fast is request.param
    bus.prepare(watchdog_s=0.0, position_d_gain=2000)
    yield bus
    bus.close()


@pytest.fixture
def plain(desk: Desk) -> Iterator[DynamixelBus]:
    """Open, and nothing else done to it."""
    bus = desk.bus()
    bus.open()
    yield bus
    bus.close()


PATIENCE_S = REPLY_TIMEOUT_S


def hang(desk: Desk, *ids: int) -> None:
    with desk.port.lock:
        desk.wire.faults.hang = set(ids)


def plugged(desk: Desk, plugged_in: bool) -> None:
    if plugged_in:
        desk.port.plug()
    else:
        desk.port.unplug()


# --- who is there


def test_a_missing_and_a_wrong_servo_are_both_named(desk: Desk, plain: DynamixelBus) -> None:
    hang(desk, 12)
    desk.servos[14]["model_number"] = 1030
    with pytest.raises(BusError) as caught:
        plain.handshake()
    message = str(caught.value)
    assert "no servo 12 (joint12)" in message
    assert "servo 14 (joint14) is a model number 1030, not a XM430-W350" in message
    assert str(desk.port.path if desk.port else "") in message
    assert "1000000 bit/s" in message
    assert "\n" not in message


def test_old_firmware_is_read_the_plain_way(desk: Desk, plain: DynamixelBus) -> None:
    desk.servos[13]["firmware_version"] = 44
    plain.handshake()
    assert plain.fast is False
    assert set(plain.read_states().states) == JOINTS


def test_whose_arm_it_is(desk: Desk, plain: DynamixelBus) -> None:
    desk.servos[13]["homing_offset"] = -120
    plain.handshake()
    assert plain.motors["joint13"] == MotorIdentity(1020, 13, 46, -120, 0, 10)
    assert other_arm(plain.motors, plain.motors) == ""


def test_the_wrong_baud_rate(desk: Desk) -> None:
    desk.wire.port_baud = 57600
    bus = desk.bus(baud_rate=57600)
    bus.open()
    with pytest.raises(BusError, match=r"at 57600 bit/s: no servo 11 .*baud rate"):
        bus.handshake()
    bus.close()
    with pytest.raises(BusError, match=r"baud rate 1234 is not known.*1000000"):
        desk.bus(baud_rate=1234)


def test_servos_with_other_registers_are_not_read_as_if_they_had_the_same() -> None:
    """One packet asks all of them; the positions of another series stand elsewhere."""
    moved = {**XM430_W350.registers, "present_position": Register(136, 4, writable=False)}
    other = replace(XM430_W350, name="another", registers=moved)
    servos = (BusServo("joint1", 11, XM430_W350), BusServo("joint2", 12, other))
    with pytest.raises(BusError, match=r"joint2 \(another\) has other registers than joint1"):
        DynamixelBus("/dev/null", servos)


def test_servos_of_a_robot() -> None:
    servos = servos_of(load_robot("open_manipulator_x"))
    assert [servo.id for servo in servos] == list(IDS)
    assert servos[2] == BusServo("joint3", 13, XM430_W350)
    with pytest.raises(RobotError, match="its control table is not known"):
        servo_model("AX-12A")


# --- getting ready


def test_prepare_from_the_factory_state(desk: Desk, plain: DynamixelBus) -> None:
    assert {servo["operating_mode"] for servo in desk.servos.values()} == {OperatingMode.POSITION}
    assert {servo["return_delay_time"] for servo in desk.servos.values()} == {250}
    plain.prepare(watchdog_s=0.2, position_d_gain=1234)
    for servo in desk.servos.values():
        assert servo["operating_mode"] == MODE_5
        assert (servo["return_delay_time"], servo["torque_enable"]) == (0, 1)
        assert (servo["bus_watchdog"], servo["position_d_gain"]) == (10, 1234)


class Watched(VirtualServo):
    """Notes every write that the bus lets through."""

    log: list[tuple[str, int]]

    def _set(
        self,
        name: str,
        value: int,
        now_s: float,
    ) -> None:
        self.log.append((name, value))
        super()._set(name, value, now_s)


def test_torque_stays_on_when_the_mode_is_right(desk: Desk, bus: DynamixelBus) -> None:
    for servo in desk.servos.values():
        servo.__class__ = Watched
        servo.log = []  # type: ignore[attr-defined]
    bus.prepare(watchdog_s=0.2, position_d_gain=2000)
    for servo in desk.servos.values():
        assert servo.log == [("bus_watchdog", 10)]  # type: ignore[attr-defined]


def test_prepare_wakes_a_servo_whose_watchdog_tripped(desk: Desk, bus: DynamixelBus) -> None:
    bus.prepare(watchdog_s=0.1, position_d_gain=2000)
    desk.clock.sleep(0.2)
    assert bus.health(11).watchdog_tripped
    bus.prepare(watchdog_s=0.0, position_d_gain=2000)
    assert not bus.health(11).watchdog_tripped
    assert desk.servos[11]["torque_enable"] == 1


def test_prepare_restores_the_answers_of_a_silent_servo(desk: Desk, plain: DynamixelBus) -> None:
    desk.servos[12]["status_return_level"] = 1
    plain.prepare(watchdog_s=0.0, position_d_gain=2000)
    assert desk.servos[12]["status_return_level"] == 2


def test_prepare_reboots_a_servo_with_an_error(desk: Desk, bus: DynamixelBus) -> None:
    with desk.port.lock:
        desk.servos[13].fail(HardwareError.OVERLOAD)
    assert desk.servos[13]["torque_enable"] == 0
    assert bus.health(13).faults == ("overload: the load was too much for too long",)
    bus.prepare(watchdog_s=0.0, position_d_gain=2000)
    assert bus.health(13).faults == ()
    assert desk.servos[13]["torque_enable"] == 1


def test_an_error_that_remains(desk: Desk, bus: DynamixelBus) -> None:
    desk.servos[13].temperature_C = 95.0
    desk.clock.sleep(0.02)
    with pytest.raises(BusError, match=r"servo 13 \(joint13\): overheated.*remains after a reboot"):
        bus.prepare(watchdog_s=0.0, position_d_gain=2000)


def test_a_reboot_whose_answer_is_lost(desk: Desk, bus: DynamixelBus) -> None:
    """The servo boots in silence, so asking again finds nobody for a while."""
    receive = desk.wire.receive
    seen: list[int] = []

    def lossy(data: bytes, now_s: float) -> list:  # type: ignore[type-arg]
        replies = receive(data, now_s)
        if not seen and data[7] == 0x08:
            seen.append(data[4])
            return []
        return replies

    desk.wire.receive = lossy  # type: ignore[method-assign]
    bus.write(11, "led", 1)
    started = desk.clock.now()
    bus.reboot(11)
    assert seen == [11]
    assert desk.clock.now() - started > REBOOT_S
    assert bus.read(11, "led") == 0


def test_reboot_of_a_dead_servo(desk: Desk, bus: DynamixelBus) -> None:
    hang(desk, 11)
    with pytest.raises(BusError, match="no answer"):
        bus.reboot(11, ready_s=0.3)


# --- states


def test_states_are_in_si_and_signed(desk: Desk, bus: DynamixelBus) -> None:
    bus.write_goals({"joint11": Goal(40, -1_000_000)})
    desk.clock.sleep(0.15)
    states = bus.read_states().states
    with desk.port.lock:
        true_rad_s = desk.rotors.velocity_rad_s[0]
        true_rad = desk.rotors.angle_rad[0]
    assert states["joint11"].current_A == pytest.approx(-40 * 0.00269)
    assert true_rad_s < -0.5
    assert states["joint11"].velocity_rad_s == pytest.approx(true_rad_s, rel=0.2)
    assert states["joint11"].angle_rad == pytest.approx(true_rad, abs=0.03)
    for index, servo_id in enumerate(IDS[1:], start=1):
        assert states[f"joint{servo_id}"].angle_rad == pytest.approx(0.2 * (index + 1), abs=0.002)


def test_a_hung_servo_is_missing_and_never_zero(desk: Desk, bus: DynamixelBus) -> None:
    """The vendor's own group read returns 0 for it, which would be a position in the middle of the range."""
    hang(desk, 13)
    for _ in range(5):
        states = bus.read_states().states
        assert "joint13" not in states
        assert set(states) == (set() if bus.fast else {"joint11", "joint12"}), (
            "those behind it wait for it in vain"
        )
        assert all(state.angle_rad > 0.1 for state in states.values())
    hang(desk)
    assert set(bus.read_states().states) == JOINTS


@pytest.mark.parametrize("fault", ["drop", "corrupt"])
def test_lost_and_corrupted_answers_are_missing_and_never_wrong(
    desk: Desk, bus: DynamixelBus, fault: str
) -> None:
    setattr(desk.wire.faults, fault, 0.2)
    complete = 0
    for _ in range(60):
        states = bus.read_states().states
        complete += len(states) == len(IDS)
        for joint, state in states.items():
            index = IDS.index(int(joint.removeprefix("joint")))
            assert state.angle_rad == pytest.approx(0.2 * (index + 1), abs=0.002)
    assert 3 < complete < 58
    setattr(desk.wire.faults, fault, 0.0)
    assert [len(bus.read_states().states) for _ in range(3)] == [5, 5, 5], "nothing of it is left"


def test_single_registers_survive_lost_answers(desk: Desk, bus: DynamixelBus) -> None:
    desk.wire.faults.corrupt = 0.1
    values = []
    for _ in range(100):
        try:
            values.append(bus.read(12, "present_position"))
        except BusError as error:
            assert "corrupted" in str(error) or "no answer" in str(error)
    here = XM430_W350.counts_of_position(0.4)
    assert len(values) > 90
    assert all(abs(value - here) <= 1 for value in values)


# as long as what is late, and longer
@pytest.mark.parametrize("next_one", ["led", "homing_offset"])
def test_an_answer_that_comes_late_is_not_the_next_one_s(
    desk: Desk, bus: DynamixelBus, next_one: str
) -> None:
    """The first is given up and asked for again; it comes then, and the second when something else is asked for."""
    receive = desk.wire.receive
    seen = list[bytes]()
    late_s = (PATIENCE_S + 0.004, *[PATIENCE_S - 0.005] * 2)

    def slow(data: bytes, now_s: float) -> list:  # type: ignore[type-arg]
        more_s = late_s[len(seen)] if len(seen) < len(late_s) else 0.0
        seen.append(data)
        return [reply._replace(delay_s=reply.delay_s + more_s) for reply in receive(data, now_s)]

    desk.wire.receive = slow  # type: ignore[method-assign]
    assert bus.read(12, "id") == 12
    assert len(seen) == 2, "it was asked again"
    assert bus.read(12, next_one) == 0


def test_a_read_that_never_came_is_no_zero(desk: Desk, bus: DynamixelBus) -> None:
    hang(desk, 12)
    with pytest.raises(
        BusError, match=r"servo 12 \(joint12\): read present_position: no answer in 3 tries"
    ):
        bus.read(12, "present_position")


def test_the_alert_bit(desk: Desk, bus: DynamixelBus) -> None:
    assert not any(state.alert for state in bus.read_states().states.values())
    with desk.port.lock:
        desk.servos[14].fail(HardwareError.OVERHEATING)
    states = bus.read_states().states
    assert {joint for joint, state in states.items() if state.alert} == {"joint14"}
    assert bus.read(14, "hardware_error_status") == 4, "the bit is no refusal"


def test_health(desk: Desk, bus: DynamixelBus) -> None:
    desk.servos[12].supply_voltage_V = 11.4
    desk.servos[12].temperature_C = 44.0
    desk.clock.sleep(0.02)
    health = bus.health(12)
    assert health.voltage_V == pytest.approx(11.4)
    assert (health.temperature_C, health.faults, health.watchdog_tripped) == (44.0, (), False)


# --- goals


def test_a_corrupted_goal_is_lost_and_the_next_one_arrives(desk: Desk, bus: DynamixelBus) -> None:
    goals = {joint: Goal(25, 2048) for joint in JOINTS}
    desk.wire.faults.corrupt_requests = 1.0
    bus.write_goals(goals)
    desk.clock.sleep(0.01)
    assert all(servo["goal_current"] != 25 for servo in desk.servos.values())
    desk.wire.faults.corrupt_requests = 0.0
    bus.write_goals(goals)
    desk.clock.sleep(0.01)
    assert all(
        (servo["goal_current"], servo["goal_position"]) == (25, 2048)
        for servo in desk.servos.values()
    )


def test_goals_of_some_joints_leave_the_others_alone(desk: Desk, bus: DynamixelBus) -> None:
    before = desk.servos[12]["goal_position"]
    bus.write_goals({"joint11": Goal(11, 2000), "joint15": Goal(15, 2100)})
    desk.clock.sleep(0.01)
    assert (desk.servos[11]["goal_current"], desk.servos[15]["goal_position"]) == (11, 2100)
    assert (desk.servos[12]["goal_current"], desk.servos[12]["goal_position"]) == (1193, before)


def test_a_refusal_says_why(bus: DynamixelBus) -> None:
    with pytest.raises(
        BusError, match=r"servo 11 \(joint11\): write operating_mode = 0: it refuses access.*torque"
    ):
        bus.write(11, "operating_mode", 0)
    with pytest.raises(BusError, match="write led = 2: it refuses the value as out of range"):
        bus.write(11, "led", 2)


def test_release_with_a_dead_servo(desk: Desk, bus: DynamixelBus) -> None:
    hang(desk, 12)
    problems = bus.release()
    assert len(problems) == 1
    assert "servo 12" in problems[0]
    assert [servo["torque_enable"] for servo in desk.servos.values()] == [0, 1, 0, 0, 0]


# --- the port


CALLS: dict[str, Callable[[DynamixelBus], object]] = {
    "ping": lambda bus: bus.ping(11),
    "read": lambda bus: bus.read(11, "led"),
    "write": lambda bus: bus.write(11, "led", 1),
    "handshake": lambda bus: bus.handshake(),
    "prepare": lambda bus: bus.prepare(watchdog_s=0.2, position_d_gain=0),
    "reboot": lambda bus: bus.reboot(11),
    "health": lambda bus: bus.health(11),
    "read_states": lambda bus: bus.read_states(),
    "write_goals": lambda bus: bus.write_goals({"joint11": Goal(0, 2048)}),
}


@pytest.mark.parametrize("call", CALLS)
def test_an_unplugged_port(desk: Desk, plain: DynamixelBus, call: str) -> None:
    CALLS[call](plain)
    plugged(desk, False)
    with pytest.raises(PortLostError) as caught:
        CALLS[call](plain)
    assert "\n" not in str(caught.value)
    assert "check the cable" in str(caught.value)
    assert not plain.is_open
    with pytest.raises(PortLostError, match="not open"):
        CALLS[call](plain)
    with pytest.raises(PortLostError, match="there is no such port"):
        plain.open()
    plugged(desk, True)
    plain.open()
    CALLS[call](plain)


def test_release_of_an_unplugged_port_says_so(desk: Desk, plain: DynamixelBus) -> None:
    plugged(desk, False)
    (problem,) = plain.release()
    assert "the port is gone" in problem


def test_pulled_while_a_reply_is_due(desk: Desk, bus: DynamixelBus) -> None:
    """The wait for the reply must end with it, not spin on a dead descriptor."""
    hang(desk, *IDS)

    def pull() -> None:
        desk.clock.sleep(0.5 * PATIENCE_S)
        plugged(desk, False)

    desk.clock.thread(pull, "cable").start()
    started = desk.clock.now()
    with pytest.raises(PortLostError):
        bus.read_states()
    assert desk.clock.now() - started < PATIENCE_S


# --- the vendor's library


def test_it_prints_nothing(
    desk: Desk, bus: DynamixelBus, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BusError):
        bus.write(11, "led", 2)
    hang(desk, *IDS)
    with pytest.raises(BusError):
        bus.handshake()
    bus.read_states()
    plugged(desk, False)
    with pytest.raises(PortLostError):
        bus.read_states()
    assert capfd.readouterr() == ("", "")


def test_an_exchange_that_was_torn_apart_does_not_block_the_port(bus: DynamixelBus) -> None:
    """The library leaves the port marked as in use after an exception, and then refuses everything."""

    def torn(port: object) -> int:
        port.is_using = True  # type: ignore[attr-defined]
        raise IndexError("list index out of range")

    with pytest.raises(IndexError):
        bus._guarded(torn)
    assert bus.ping(11) == 1020
    assert set(bus.read_states().states) == JOINTS


def test_a_reply_that_is_shorter_than_it_says(desk: Desk, plain: DynamixelBus) -> None:
    """With a correct checksum: the library trusts the length and reaches beyond the end."""
    head = bytes.fromhex("fffffd000b030055")
    short = head + crc16(head).to_bytes(2, "little")
    whole = desk.wire.receive

    def receive(data: bytes, now_s: float) -> list:  # type: ignore[type-arg]
        return [reply._replace(data=short + bytes(8)) for reply in whole(data, now_s)]

    desk.wire.receive = receive  # type: ignore[method-assign]
    with pytest.raises(BusError):
        plain.read(11, "present_position")
    assert plain.read_states().states == {}


# --- time


def test_a_dead_servo_costs_its_timeout(desk: Desk, bus: DynamixelBus) -> None:
    hang(desk, *IDS)
    for _ in range(10):
        started = desk.clock.now()
        assert bus.read_states().states == {}
        assert PATIENCE_S < desk.clock.now() - started < 1.5 * PATIENCE_S
    started = desk.clock.now()
    with pytest.raises(BusError):
        bus.read(12, "led")
    assert TRIES * PATIENCE_S < desk.clock.now() - started < 2 * TRIES * PATIENCE_S


def test_steps_of_the_system_clock(
    desk: Desk, bus: DynamixelBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = time.time
    shift = [0.0]
    step = [0.0]
    steps = [0]

    def jumping() -> float:
        """Another hour whenever somebody looks."""
        if steps[0] > 0:
            steps[0] -= 1
            shift[0] += step[0]
        return real() + shift[0]

    monkeypatch.setattr(time, "time", jumping)
    for step[0] in (3600.0, -3600.0):
        steps[0] = 100
        assert [len(bus.read_states().states) for _ in range(5)] == [5] * 5
        assert bus.read(11, "led") == 0
    hang(desk, *IDS)
    for step[0] in (3600.0, -3600.0):
        steps[0] = 100
        started = desk.clock.now()
        assert bus.read_states().states == {}
        assert PATIENCE_S < desk.clock.now() - started < 2.0 * PATIENCE_S, "nor an hour"


def test_a_late_answer_is_not_taken_for_the_next(desk: Desk, bus: DynamixelBus) -> None:
    """Nothing in an answer says what was asked: what came after its time has to be thrown away."""
    desk.wire.faults.delay_s = 4.0 * PATIENCE_S  # after the third try
    with pytest.raises(BusError):
        bus.read(11, "present_position")
    desk.wire.faults.delay_s = 0.0
    desk.clock.sleep(4.0 * PATIENCE_S + 0.02)
    assert bus.read(12, "present_position") == pytest.approx(
        XM430_W350.counts_of_position(0.4), abs=1
    )
    assert bus.read(11, "present_temperature") == 30


def test_the_version_of_the_library_with_fast_sync_read_is_used() -> None:
    """Else the tests named "fast" above would test the same as the plain ones."""
    assert hasattr(sdk.PacketHandler(2.0), "fastSyncReadRx")
