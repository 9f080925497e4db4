"""A serial port that waits without spinning, says in one line why it cannot be used, and asks for low latency."""

from __future__ import annotations

import contextlib
import os
import select
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import dynamixel_sdk
import serial

from proprio_ros import clock

REPLY_TIMEOUT_S = 0.020
"""How long a reply may take beyond its time on the wire. A timer of 16 ms in an FTDI adapter still fits."""

PORT_FAULTS = (serial.SerialException, OSError, termios.error, TypeError, AttributeError)
"""What pyserial and the SDK raise when a cable is pulled, depending on the moment."""


class SerialLike(Protocol):
    """What a bus needs of a port; reads return what is there and never wait."""

    def read(self, size: int, /) -> bytes: ...

    def write(self, data: bytes, /) -> int | None: ...

    def reset_input_buffer(self) -> None: ...

    def close(self) -> None: ...


class Port(dynamixel_sdk.PortHandler):
    """A port that waits without spinning, on the monotonic clock, and only as long as asked."""

    def __init__(
        self, name: str, reply_timeout_s: float, connect: Callable[[], SerialLike] | None
    ) -> None:
        super().__init__(name)
        self.ser: Any = None
        self.is_open: bool = False
        self.reply_timeout_s = reply_timeout_s
        self._connect = connect

    def setupPort(self, _flag: int) -> bool:
        if self.is_open:
            self.closePort()
        if self._connect is not None:
            self.ser = self._connect()
        else:
            # exclusive: two drivers on one bus would answer each other's servos
            self.ser = serial.Serial(
                self.port_name,
                self.baudrate,
                timeout=0,
                exclusive=True,
            )
        self.is_open = True
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 10_000.0 / self.baudrate
        return True

    def readPort(self, length: int) -> bytes:
        if length <= 0:
            return b""
        data: bytes = self.ser.read(length)
        if not data:
            left_s = max(1e-3 * (self.packet_timeout - self.getTimeSinceStart()), 0.0)
            if self._connect is None:
                select.select(
                    [self.ser.fileno()],
                    [],
                    [],
                    min(left_s, 0.005),
                )
            else:
                clock.sleep(min(left_s, 0.0002))  # not every such port has a descriptor to wait for
            data = self.ser.read(length)
        return data

    def getCurrentTime(self) -> float:
        return 1e3 * clock.now()

    def setPacketTimeout(self, packet_length: int) -> None:
        self.packet_start_time = self.getCurrentTime()
        self.packet_timeout = self.tx_time_per_byte * packet_length + 1e3 * self.reply_timeout_s


def first_line(error: BaseException) -> str:
    """An error in one line of 120 letters at most."""
    return (" ".join(str(error).split()) or type(error).__name__)[:120]


def why_not_open(port: str, error: BaseException) -> str:
    """One sentence on a port that could not be opened, and what to do."""
    number = getattr(error, "errno", None)
    text = first_line(error)
    if not Path(port).exists():
        others = sorted(
            str(path) for pattern in ("ttyUSB*", "ttyACM*") for path in Path("/dev").glob(pattern)
        )
        return f"{port}: there is no such port; plugged in: {', '.join(others) or 'none'}: check the cable, or name another port"
    if number == 13 or "ermission" in text:
        return f"{port}: not permitted: add yourself to the group dialout (sudo usermod -aG dialout $USER) and log in again"
    if number == 11 or "xclusively lock" in text:
        return f"{port}: another program uses it: stop that one first"
    return f"{port}: cannot be opened ({text}): check the cable"


def latency_warnings(port: str, handle: serial.Serial) -> list[str]:
    """Ask for low latency, and say so where the adapter still holds replies back."""
    # not every driver has it, and pyserial raises what it likes; the timer below decides
    with contextlib.suppress(Exception):
        handle.set_low_latency_mode(True)
    timer = (
        Path("/sys/bus/usb-serial/devices") / Path(os.path.realpath(port)).name / "latency_timer"
    )
    try:
        milliseconds = int(timer.read_text())
    except (OSError, ValueError):
        return []
    if milliseconds <= 1:
        return []
    cycles = 1000 // (milliseconds + 4)
    return [
        f"{port}: the adapter's latency timer is {milliseconds} ms, which allows about {cycles} cycles per second: "
        f"echo 1 | sudo tee {timer}"
    ]
