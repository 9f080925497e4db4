"""A bus on a serial port of the system, which a pseudo-terminal stands for: who may open it, and what it costs to wait."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.desk import Desk, servos_named

from proprio_ros.bus.dynamixel import DynamixelBus
from proprio_ros.errors import BusError, PortLostError

IDS = (11, 12, 13, 14, 15)
PATIENCE_S = 1.0
"""Servos and bus are one process here, which may not be run for longer than a servo takes."""


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with Desk(IDS, None, tmp_path / "arm") as desk:
        yield desk


@pytest.fixture
def plain(desk: Desk) -> Iterator[DynamixelBus]:
    bus = desk.bus(reply_timeout_s=PATIENCE_S)
    bus.open()
    yield bus
    bus.close()


def test_servos_are_there_until_the_cable_is_pulled_and_again_afterwards(
    desk: Desk, plain: DynamixelBus
) -> None:
    plain.handshake()
    assert len(plain.read_states().states) == len(IDS)
    desk.port.unplug()
    with pytest.raises(PortLostError, match="check the cable"):
        plain.read_states()
    assert not plain.is_open
    with pytest.raises(PortLostError, match="there is no such port"):
        plain.open()
    desk.port.plug()
    plain.open()
    assert plain.ping(11) == 1020


def test_pulled_while_a_reply_is_due(desk: Desk, plain: DynamixelBus) -> None:
    """The wait for the reply must end with it, not spin on a dead descriptor."""
    plain.handshake()
    desk.wire.receive = lambda data, now_s: desk.port._hang_up() or []  # type: ignore[method-assign]
    with pytest.raises(PortLostError):
        plain.read_states()


def test_the_port_belongs_to_one_process(desk: Desk, plain: DynamixelBus) -> None:
    code = (
        "import sys\n"
        "from proprio_ros.bus.control_table import XM430_W350\n"
        "from proprio_ros.bus.dynamixel import BusServo, DynamixelBus\n"
        "from proprio_ros.errors import PortLostError\n"
        "try:\n"
        "    DynamixelBus(sys.argv[1], [BusServo('joint11', 11, XM430_W350)]).open()\n"
        "except PortLostError as error:\n"
        "    print(error)\n"
    )
    other = subprocess.run(
        [
            sys.executable,
            "-c",
            code,
            str(desk.port.path),
        ],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (other.returncode, other.stderr) == (0, "")
    assert other.stdout == f"{desk.port.path}: another program uses it: stop that one first\n"
    plain.handshake()


def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    bus = DynamixelBus(str(tmp_path / "ttyUSB7"), servos_named([11]))
    with pytest.raises(
        PortLostError, match=r"there is no such port; plugged in: .*check the cable"
    ):
        bus.open()


def test_a_port_that_is_not_permitted(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    if os.geteuid() == 0:
        # nothing is forbidden to root: the system's answer has to be played
        def forbidden(path: str, *_: object) -> int:
            raise PermissionError(13, "Permission denied", path)

        monkeypatch.setattr("serial.serialposix.os.open", forbidden)
    else:
        Path(desk.port.path).resolve().chmod(0)
    with pytest.raises(PortLostError, match=r"not permitted: .*usermod -aG dialout"):
        desk.bus().open()


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PortLostError, match="cannot be opened"):
        DynamixelBus(str(tmp_path / "file"), servos_named([11])).open()


def test_it_prints_nothing(
    desk: Desk, plain: DynamixelBus, capfd: pytest.CaptureFixture[str]
) -> None:
    plain.handshake()
    with pytest.raises(BusError):
        plain.write(11, "led", 2)
    desk.port.unplug()
    with pytest.raises(PortLostError):
        plain.read_states()
    assert capfd.readouterr() == ("", "")
