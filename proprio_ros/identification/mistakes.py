"""Mistakes that are made in recordings: each is undone in turn, and the one without which a model explains a recording is named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import pi
from typing import TypeVar

from proprio_ros.records import Run

APART_RAD = 0.1
"""Joints that are held closer to each other than this may be exchanged, and nothing shows it."""
_T = TypeVar("_T")
FACTORS = (0.001, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0)


@dataclass(frozen=True)
class Mistake:
    """The sentence that names it, and what it multiplied torque and angle by."""

    words: str
    torque: float = 1.0
    angle: float = 1.0

    def undone(self, run: Run) -> Run:
        """The run without it."""
        angles = {name: getattr(run, name) / self.angle for name in ("position", "before_position")}
        return replace(
            run,
            input_current_A=run.input_current_A / self.torque,
            **angles,
        )


@dataclass(frozen=True)
class Exchanged(Mistake):
    """Positions of two joints that were held."""

    joints: tuple[str, str] = ("", "")

    def undone(self, run: Run) -> Run:
        return replace(
            run,
            held=self._exchanged(run.held),
            held_span=self._exchanged(run.held_span),
            held_position=self._exchanged(run.held_position),
        )

    def _exchanged(self, values: Mapping[str, _T]) -> dict[str, _T]:
        one, other = self.joints
        names = {one: other, other: one}
        return {name: values[names.get(name, name)] for name in values}


def of_held(runs: Sequence[Run]) -> Iterator[Mistake]:
    """Those of the joints that were held, in every run, while others were pushed."""
    held = [name for name in runs[0].held if all(name in run.held_position for run in runs)]
    for one, other in combinations(held, 2):
        if any(abs(run.held[one] - run.held[other]) > APART_RAD for run in runs):
            words = f"the positions of {one} and {other} are exchanged"
            yield Exchanged(words, joints=(one, other))


def of_joint(
    name: str,
    quantity: str,
    needs: str,
) -> Iterator[Mistake]:
    """Those of a joint called ``name``, whose torque was recorded as a ``quantity``; ``needs`` stands after "times what"."""
    turned = f"the {quantity} or the angle of {name} has the sign of an axis that is turned round in the URDF"
    yield from (Mistake(turned, *signs) for signs in ((-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)))
    for factor in FACTORS:
        said = f"the {quantity} of {name} is about {factor:g} times what {needs}"
        yield Mistake(
            f"{said}: it has another unit or torque constant",
            factor,
        )


def of_all_joints() -> Iterator[Mistake]:
    """Those that a publisher makes of all joints at once."""
    sign = "the effort of all joints has the sign of the torque that gravity makes, not of what holds against it"
    yield Mistake(
        f"{sign}: its publisher counts it the other way round",
        -1.0,
    )
    yield Mistake(
        "the positions of all joints are in degrees: convert them to rad",
        angle=180.0 / pi,
    )
    for factor in FACTORS:
        unit = "it is in another unit (--effort-unit)"
        yield Mistake(
            f"the effort of all joints is about {factor:g} times what the URDF needs: {unit}",
            factor,
        )
