"""What a bend of a recording is, and all of them by name."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import support.bends
from support.bends.tape import Tape

Rng = np.random.Generator
Draw = Callable[[Rng, Tape], Any]
"""A parameter of a bend, drawn for a recording."""
Change = Callable[..., Tape]
"""Of a tape, a random generator and parameters by name another tape."""
KINDS = ("clocks", "efforts", "positions", "publishers", "pushes", "servos", "files")


@dataclass(frozen=True)
class Right:
    """What is right about an answer to a bent recording. One that is accepted always has to hold.

    Attributes:
        told: True: nothing stands in the way of an answer, and a refusal is wrong; False: no answer can be right by more than luck;
            None: both are right.
        cause: Regular expression of the words that name the cause in what is said of a refusal.
        codes: Of reasons that name it whatever their words.
    """

    told: bool | None = None
    cause: str = ""
    codes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Bend:
    """One way in which recordings go wrong.

    Attributes:
        kind: One of `KINDS`.
        name: Of its function.
        change: Makes it.
        parameters: What to draw, by name.
        right: Of both the loaded and the empty recording bent alike.
        right_alone: Of the loaded one alone.
        needs: Of what a recording has to be: "motion", "push", "goals" (a servo that a voltage drives); empty: any.
    """

    kind: str
    name: str
    change: Change
    parameters: Mapping[str, Draw]
    right: Right
    right_alone: Right
    needs: str = ""

    @property
    def meaning(self) -> str:
        """What it is, in a sentence."""
        return (self.change.__doc__ or self.name).splitlines()[0].rstrip(".")

    def drawn(
        self,
        rng: Rng,
        tape: Tape,
    ) -> dict[str, Any]:
        """Parameters for a recording."""
        return {name: draw(rng, tape) for name, draw in self.parameters.items()}


BENDS: dict[str, Bend] = {}


def bend(
    kind: str,
    right: Right,
    alone: Right | None = None,
    needs: str = "motion",
    **parameters: Draw,
) -> Callable[[Change], Change]:
    """Add a function to the library of bends, under its name; the arguments are those of `Bend`."""
    assert kind in KINDS, kind

    def added(change: Change) -> Change:
        name = change.__name__
        assert name not in BENDS, name
        BENDS[name] = Bend(
            kind,
            name,
            change,
            parameters,
            right,
            alone or right,
            needs,
        )
        return change

    return added


def all_bends() -> dict[str, Bend]:
    """Every bend by its name, in the order of modules and within them."""
    for module in pkgutil.iter_modules(support.bends.__path__):
        importlib.import_module(f"support.bends.{module.name}")
    return dict(BENDS)


def between(low: float, high: float) -> Draw:
    """Any number of a range, to three digits, so that a row of a table makes it again."""
    return lambda rng, _: float(f"{rng.uniform(low, high):.3g}")


def one_of(choices: Sequence[Any]) -> Draw:
    """One of some values."""
    return lambda rng, _: choices[int(rng.integers(len(choices)))]


def a_joint(rng: Rng, tape: Tape) -> str:
    """One that moves."""
    return str(tape.moving[int(rng.integers(len(tape.moving)))])


def some_joints(rng: Rng, tape: Tape) -> list[str]:
    """Some of those that move, and not all."""
    moving = tape.moving
    count = int(rng.integers(1, max(2, len(moving))))
    chosen = rng.choice(len(moving), count, replace=False)
    return [moving[number] for number in sorted(chosen)]


def either_sign(low: float, high: float) -> Draw:
    """A number whose size is of a range."""

    def draw(rng: Rng, _: Tape) -> float:
        size = rng.uniform(low, high)
        return float(f"{size * rng.choice((-1.0, 1.0)):.3g}")

    return draw
