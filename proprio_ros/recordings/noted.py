"""What is said of a topic: repairs, each in a sentence, and why it is of no use."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from proprio_ros.errors import RecordingError
from proprio_ros.records import BoolArray


def count_of(mask: BoolArray) -> str:
    """How many of the rows are marked, in words."""
    return f"{int(mask.sum())} of {mask.size}"


@dataclass(frozen=True)
class Noted:
    """A topic of a bag, and what was repaired of its messages, a sentence each."""

    path: Path  # of the bag
    topic: str
    notes: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return f"{self.path}: {self.topic}"

    def error(self, words: str) -> RecordingError:
        """What is wrong with the topic; the words go on behind its name."""
        return RecordingError(f"{self.topic}{words}", self.path)

    def note(self, sentence: str) -> None:
        """Add a sentence about the topic."""
        self.notes.append(f"{self.topic}: {sentence}")

    def count(self, mask: BoolArray, what: str) -> None:
        """Add how many rows were repaired or left out, where there are any."""
        if mask.any():
            self.note(f"{count_of(mask)} {what}.")
