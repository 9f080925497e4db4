"""The errors that a user can meet, as one tree.

Every message is one line that says what is wrong, which choices are valid, and what to do. Messages quote what others wrote: names
of folders, topics and joints, whole values of a file. The base class therefore makes every message printable and short, whatever it
quotes.
"""

from __future__ import annotations

import errno
from collections.abc import Iterable

# Characters of a message; with the command's name before it, it stays below 300.
LONGEST_SENTENCE = 290
LONGEST_WORD = 60  # of a message that is cut; what is longer may be cut inside


def printable(text: str) -> str:
    """The text on one line, with an escape for every character that could move a cursor, end a line or not be encoded."""
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text
    )


def one_line(text: str, longest: int = LONGEST_SENTENCE) -> str:
    """A printable text of at most so many characters; what is too much is left out of its middle.

    A sentence begins with where something is wrong and ends with what to do: both are kept.
    """
    if len(text) > 4 * longest:  # nothing is gained by escaping a megabyte first
        text = text[: 2 * longest] + text[-2 * longest :]
    text = printable(text)
    if len(text) <= longest:
        return text
    begin = (longest - 5) * 2 // 3
    head = text[:begin]
    tail = text[begin + 5 - longest :]
    # no word is cut, and no name of a list, unless it is longer than any name
    if text[begin] != " " and " " in head[-LONGEST_WORD:]:
        head = head[: head.rindex(" ")]
    if text[begin + 4 - longest] != " " and " " in tail[:LONGEST_WORD]:
        tail = tail[tail.index(" ") + 1 :]
    return f"{head.rstrip()} ... {tail.lstrip()}"


class ProprioError(Exception):
    """Base of everything this package raises on purpose; the command line prints it, one printable line, and exits with 2.

    Attributes:
        subject: What it is about, as a path or the name of a recording; empty where only the sentence says it.
        words: The sentence without its subject.
    """

    def __init__(
        self,
        message: object = "",
        subject: object = "",
        longest: int = LONGEST_SENTENCE,
    ) -> None:
        """Of a sentence.

        Args:
            message: The sentence.
            subject: What it is about, where the sentence does not say it.
            longest: Characters of it; what is longer is left out of its middle.
        """
        self.subject = str(subject)
        self.words = one_line(str(message), longest)
        super().__init__(one_line(f"{subject}: {message}", longest) if self.subject else self.words)

    def about(self, subject: object) -> str:
        """What is said of a subject, without its name; the whole line where it is about another one."""
        return self.words if self.subject == str(subject) else str(self)


class RobotError(ProprioError, ValueError):
    """A URDF or robot file is missing something, or describes no physical robot: a massless moving link, two roots."""


class RecordingError(ProprioError, ValueError):
    """A recording cannot be read, or does not hold what is needed: no joint states, NaN, an unknown effort unit."""


class TooLittleMotion(RecordingError):
    """Joints of a recording stand, or move for too short, for a regression of what it says by itself."""


class ConfigurationError(ProprioError, ValueError):
    """An option, a setting or a probe file is wrong: an unknown key, a wrong unit, a wrong shape."""


class ComputerError(ConfigurationError):
    """The computer lacks what the work needs, whatever is asked: a folder that can be written, space."""


class SimulationError(ProprioError, RuntimeError):
    """A rollout cannot be trusted: it diverged, or the number of steps overflows."""


class BusError(ProprioError, RuntimeError):
    """A servo does not answer, answers wrongly, is of another model, or reports a fault."""


class PortLostError(BusError):
    """The serial port cannot be opened, or is gone: unplugged, or taken away while open."""


class ExcitationError(ProprioError, RuntimeError):
    """An excitation that cannot start from here, or must not: busy, out of limits, no free way."""


_MACHINES = {
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EMFILE, errno.ENFILE,
    errno.ENOMEM, errno.EAGAIN, errno.ESTALE, errno.ETIMEDOUT,
}  # fmt: skip


def of_the_machine(error: BaseException | None) -> bool:
    """Whether the computer is what is wrong, and not what it was given: memory, space, a folder that cannot be written.

    The same again may go well tomorrow. It is looked for in all that led to the error.
    """
    while error is not None:
        if isinstance(error, (MemoryError, ComputerError)) or (
            isinstance(error, OSError) and error.errno in _MACHINES
        ):
            return True
        error = error.__cause__
    return False


def some(names: Iterable[str], most: int = 6) -> str:
    """The first of some names, and how many more there are."""
    names = list(names)
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def together(sentences: Iterable[str]) -> list[str]:
    """Sentences about runs, with what is said of several as one: ``bag#1, 2, 5: ...``."""
    said: dict[tuple[str, str], list[str]] = {}
    for sentence in sentences:
        name, _, words = sentence.partition(": ")
        bag, _, number = name.rpartition("#")
        said.setdefault((bag, words) if bag and number.isdigit() else ("", sentence), []).append(
            number
        )
    return [
        f"{bag}#{', '.join(numbers)}: {words}" if bag else words
        for (bag, words), numbers in said.items()
    ]
