"""Whether a voltage servo has the gain that it was calibrated with, by how it moved.

A servo's effort is its gain times how far the goal is ahead, and no recording says the gain. Of an arm that stands it scales what
the arm weighs, so a load can hide it. While the arm moves, most of that distance makes up for friction and for the voltage that the
motor itself makes, which the calibration knows and no load does: that is what the torques' scale is taken from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from proprio_ros.identification.judge import Refusal, rejected
from proprio_ros.identification.regression.refusals import noticed_from, times
from proprio_ros.quantity import Z95

LEAST_INFORMATION = 1e-9  # Less is none.
TELLS = 0.15
"""A motion that leaves the scale more open than this says nothing of it. A guess: `test/benchmarks/at_rest.py` measures it."""
LEAST_SCALE = 0.3  # No scale is taken to be smaller.


@dataclass(frozen=True)
class TorqueScale:
    """By how much all torques of an arm are read larger than its calibration knows them, as far as its motion shows that."""

    along: float = 0.0  # what is read beside the calibration, weighted, along what such a part would make of it
    information: float = 0.0  # of that part: one over its variance

    def plus(self, more: TorqueScale, keeps: float = 1.0) -> TorqueScale:
        """With what others say: ``more``; what is here counts with a share, ``keeps``."""
        return TorqueScale(
            keeps * self.along + more.along, keeps * self.information + more.information
        )

    @property
    def relative_error(self) -> float:
        """That part."""
        return self.along / max(self.information, LEAST_INFORMATION)

    @property
    def std(self) -> float:
        return float(max(self.information, LEAST_INFORMATION) ** -0.5)

    @property
    def is_other(self) -> bool:
        """Whether torques are those of another gain."""
        return abs(self.relative_error) > float(noticed_from(self.std))

    @property
    def likely_error(self) -> float:
        """By how much a true torque is another one, where that is likely but too little to be sure of; else 0."""
        if abs(self.relative_error) < Z95 * self.std:
            return 0.0
        return abs(self.relative_error) / max(1.0 + self.relative_error, LEAST_SCALE)

    @property
    def unresolved(self) -> float:
        """By how much it may be another one: what is seen, or what the motion does not tell, if it tells anything."""
        return max(self.likely_error, self.std if self.std < TELLS else 0.0)

    @property
    def precision_words(self) -> str:
        """How well motion shows it, to be put behind a sentence; empty where it does not."""
        return f": motion shows it to {100.0 * self.std:.0f} %" if self.std < TELLS else ""

    @property
    def words(self) -> str:
        """What is wrong where it is that of another gain."""
        larger = times(1.0 + self.relative_error)
        return (
            f"where the arm moved its torques are {larger} what its calibration knows, as with a servo's P gain or "
            "supply that is another one: set those of the calibration, or calibrate again"
        )


NOTHING_SEEN = TorqueScale()


def other_gain(name: str, scale: TorqueScale) -> Iterator[Refusal]:
    """Where the motion shows another gain; ``name``: of the recording."""
    if scale.is_other:
        yield rejected(
            "other_torque",
            "torques are not those of the empty arm",
            f"{name}: {scale.words}",
        )
