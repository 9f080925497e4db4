"""The user's KEY=VALUE settings: how they are read, checked, and laid over the defaults of a probe's file.

They come from the command line's ``--set`` and from the identifier's parameter ``settings``. Importing this must stay cheap: the
command line does so before it knows what is asked for.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from proprio_ros.errors import ConfigurationError, one_line
from proprio_ros.inputs.forms import (
    Choice,
    Form,
    FormError,
    Number,
    Numbers,
    Perhaps,
    Whole,
    shortly,
)
from proprio_ros.inputs.reading import LONGEST_VALUE, json_of, yaml_file
from proprio_ros.inputs.resources import resource

_Options = TypeVar("_Options")


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """Settings by dotted key; values are JSON, or bare words. Raises `ConfigurationError`: A pair is not of that form."""
    settings: dict[str, Any] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not separator or not key:
            raise ConfigurationError(f"--set {pair}: write KEY=VALUE, e.g. --set payload.size=0.03")
        if len(text) > LONGEST_VALUE:
            raise ConfigurationError(f"--set {key}: its value has over {LONGEST_VALUE} characters")
        try:
            settings[key] = json_of(text)
        except ValueError as error:
            if text[:1] in '[{"' or not text:
                why = error if "nested" in str(error) else "e.g. [0,0,0.01] or 0.03"
                raise ConfigurationError(
                    f"--set {one_line(pair, 100)}: {shortly(text)} is not JSON, {why}"
                ) from None
            settings[key] = text  # a bare word such as cube
    return settings


_MASS = Number(unit="kg", lowest=0.0, highest=20.0, open=True)
SEARCH: dict[str, Form] = {
    "solver.starts_kg": Numbers(
        "first guesses", _MASS, most=20, example="at least one positive mass in kg"
    ),
    "solver.starts_Pa": Numbers(
        "first guesses",
        Number(unit="Pa", lowest=1.0, highest=1e10),
        example="at least one positive modulus in Pa",
    ),
    "solver.integrator": Choice(
        "semi_implicit: the paper's equation (2)", ("rk4", "semi_implicit")
    ),
    "solver.device": Choice(
        "where fits from every start are computed; cuda is a graphics card", ("cpu", "cuda")
    ),
    # a run of a second takes 1e4 steps of the shortest; at the longest, no integrator knows what an arm does
    "solver.step_s": Number("longest step of the simulation", "s", 1e-4, 0.02),
    "solver.widest_relative": Number(
        "half width of the widest 95 % interval that is an answer, over the value",
        "",
        0.0,
        10.0,
        open=True,
    ),
    "solver.wide_share": Number(
        "an interval wider than +- this share of the value is too wide", "", 0.0, 100.0, open=True
    ),
    "solver.wide_floor_kg": Number("but not where it is narrower than +- this", "kg", 0.0, 10.0),
    "solver.signals": Choice(
        "what runs that a camera saw are fitted to", ("both", "joint", "camera")
    ),
    "paper.substeps": Whole("Euler steps per 1/60 s frame, 4 to 64 in the paper", "", 1, 1024),
    "paper.iterations": Whole("length of the cosine schedule", "", 1, 10_000),
    "paper.extended_iterations": Whole(
        "of the schedule that is allowed to converge", "", 1, 10_000
    ),
    "paper.learning_rate": Number("Adam's, at the start", "kg", 0.0, 10.0, open=True),
    "paper.starts_kg": Numbers(
        "first guesses", _MASS, most=20, example="at least one positive mass in kg"
    ),
    "paper.loss_time_s": Perhaps(
        "simulated instant that is compared; null: the last sample's",
        Number(unit="s", lowest=0.0, highest=60.0),
    ),
    "paper.loss_sample": Perhaps(
        "number of the sample it is compared with; null: the last", Whole(lowest=-1e6, highest=1e6)
    ),
}
"""Forms of how a probe searches; what is stated about an object is in the ``facts.py`` of its probe."""


class Settings:
    """The user's keys, each taken once; what nobody took is an error that lists what there is.

    Attributes:
        taken: Keys that the user stated and that something understood.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._left = dict(given)
        self._known: list[str] = ["held.JOINT", "robot.KEY.OF.ROBOT.FILE"]
        self.taken: set[str] = set()

    @property
    def left(self) -> frozenset[str]:
        """Keys that nothing has taken yet."""
        return frozenset(self._left)

    def take(
        self,
        key: str,
        default: Any,
        form: Form | None = None,
    ) -> Any:
        """The user's value, or the default; as the form reads it, where there is one (see `read`).

        Args:
            key: Dotted.
            default: Where the user says nothing.
            form: As which the value is read, where there is one.
        """
        self._known.append(key)
        if key in self._left:
            self.taken.add(key)
        value = self._left.pop(key, default)
        return value if form is None else read(key, value, form)

    def take_prefix(self, prefix: str) -> dict[str, Any]:
        """All keys under a prefix, without it."""
        found = {key: self._left.pop(key) for key in list(self._left) if key.startswith(prefix)}
        self.taken.update(found)
        return {key[len(prefix) :]: value for key, value in found.items()}

    def options(
        self,
        kind: Callable[..., _Options],
        prefix: str,
        defaults: Mapping[str, Any],
    ) -> _Options:
        """The options of a solver from the keys under a prefix.

        Raises `ConfigurationError`: A value of the wrong form.

        Args:
            kind: The data class.
            prefix: Such as ``solver.``; `SEARCH` has the forms of its keys.
            defaults: Of the probe's file, before those of the class.

        Raises:
            ConfigurationError: A value of the wrong form.
        """
        values: dict[str, Any] = {}
        for entry in fields(kind):  # type: ignore[arg-type]
            if entry.name != "solver":  # the command line has a flag for it
                key = prefix + entry.name
                values[entry.name] = self.take(
                    key, defaults.get(entry.name, entry.default), SEARCH.get(key)
                )
        return kind(**values)

    def refuse_rest(self) -> None:
        """Raises: ConfigurationError: A key that nothing understands."""
        if self._left:
            names = sorted(self._left)
            # the nearest first, since the list may be longer than a sentence
            own = names[0].partition(".")[0] + "."
            close = difflib.get_close_matches(
                names[0][:100],
                self._known,
                n=1,
            )
            known = sorted(
                set(self._known),
                key=lambda key: (key not in close, not key.startswith(own), key),
            )
            raise ConfigurationError(
                f"--set {one_line(', '.join(names), 60)}: unknown; valid keys: {', '.join(known)}"
            )


def probe_file(
    name: str,
    sections: Sequence[str] = (),
) -> dict[str, Any]:
    """What the file of a probe in ``config/probes`` says; refuses one that is not readable, or lacks one of these sections."""
    path: Path = resource("probes", name)
    content = yaml_file(path, ConfigurationError)
    if not isinstance(content, dict) or not all(
        isinstance(content.get(section), dict) for section in sections
    ):
        raise ConfigurationError(f"{path}: needs the sections {', '.join(sorted(sections))}")
    return content


def read(key: str, value: Any, form: Form) -> Any:
    """A value as its form reads it; raises a `ConfigurationError` where it is none of that form.

    Args:
        key: For messages.
        value: As the user or a file states it.
        form: That it must have.
    """
    try:
        return form.read(value)
    except FormError as error:
        raise ConfigurationError(f"{key}: {error}") from None
