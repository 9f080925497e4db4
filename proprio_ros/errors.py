"""The errors that a user can meet, as one tree.

Every message is one line that says what is wrong, which choices are valid, and what to do::

    ProprioError
    +-- RobotError          a URDF or robot file: massless moving link, unknown joint, two roots
    +-- RecordingError      a bag or a record: no joint states, NaN, truncated file, unknown effort unit
    +-- ConfigurationError  an option, a --set or a probe file: unknown key, wrong unit, wrong shape
    +-- SimulationError     a rollout that cannot be trusted: it diverged, or the step count overflows
    +-- BusError            a serial port or a servo: no port, no answer, another model, a hardware error
    |   +-- PortLostError   the port itself is gone: unplugged, or taken away while open
    +-- ExcitationError     an excitation that cannot start, or must not: busy, out of limits, no free way

Messages quote what others wrote: names of folders, topics and joints, whole values of a file. The base class therefore makes every
message printable and short, whatever it quotes.
"""

from __future__ import annotations

from collections.abc import Iterable

LONGEST_SENTENCE = 290
"""Characters of a message; with the command's name before it, it stays below 300."""


def printable(text: str) -> str:
    """The text on one line, with an escape for every character that could move a cursor, end a line or not be encoded."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: str, longest: int = LONGEST_SENTENCE) -> str:
    """A printable text of at most so many characters; what is too much is left out of its middle.

    A sentence begins with where something is wrong and ends with what to do: both are kept.
    """
    if len(text) > 4 * longest:  # nothing is gained by escaping a megabyte first
        text = text[: 2 * longest] + text[-2 * longest :]
    text = printable(text)
    if len(text) <= longest:
        return text
    head = (longest - 5) * 2 // 3
    return f"{text[:head]} ... {text[head + 5 - longest :]}"


class ProprioError(Exception):
    """Base of everything this package raises on purpose; the command line prints it and exits with 2.

    Args:
        message: the sentence; it is made one printable line of at most `LONGEST_SENTENCE` characters.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


class RobotError(ProprioError, ValueError):
    """The robot's description is missing something, or describes no physical robot."""


class RecordingError(ProprioError, ValueError):
    """The recording cannot be read, or does not hold what the probe needs."""


class ConfigurationError(ProprioError, ValueError):
    """An option or a configuration file is wrong."""


class SimulationError(ProprioError, RuntimeError):
    """The simulation left the range in which its numbers mean something."""


class BusError(ProprioError, RuntimeError):
    """A servo does not answer, answers wrongly, or reports a fault."""


class PortLostError(BusError):
    """The serial port cannot be opened, or is gone."""


class ExcitationError(ProprioError, RuntimeError):
    """An excitation that cannot start from here, or must not."""


def some(names: Iterable[str], most: int = 6) -> str:
    """The first of some names, and how many more there are."""
    names = list(names)
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
