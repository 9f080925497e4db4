"""What the nodes say, the newest of each with its age. No ROS: `listener` writes here what it hears, pages read it."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from time import monotonic
from typing import Any

CURVE_S = 60.0
"""So much of the mass is kept."""
MOST_PUSHES = 60
MOST_SAMPLES = 2000
"""Of a push."""
OLD_S = {
    "states": 1.0,
    "running": 1.0,
    "excitation": 6.0,
    "driver": 6.0,
    "diagnostics": 6.0,
}
"""From then on news is old. What is not here is said once and stands until it is said anew."""


@dataclass(frozen=True)
class Said:
    """A diagnostic status: a sentence with its keys and values."""

    level: int  # 0 OK, 1 warning, 2 error
    name: str
    message: str
    values: Mapping[str, str]


NOTHING = Said(0, "", "", {})


@dataclass(frozen=True)
class Held:
    """A body in the hand, in the frame of the link that holds it.

    Attributes:
        mass_kg: Its mass.
        centre_m: Of its mass, shape (3,).
    """

    mass_kg: float
    centre_m: tuple[float, ...]


Push = list[tuple[float, dict[str, float]]]
"""By a clock [s], all joints while one is pushed [rad or m]."""


def curve_of(push: Push) -> tuple[str, list[list[float]]]:
    """The joint that went farthest, and its way: times from the begin [s], positions [rad or m]."""
    begin_s, first = push[0]

    def travel(name: str) -> float:
        return max(abs(pose[name] - first[name]) for _, pose in push)

    joint = max(first, key=travel)
    return joint, [[round(at_s - begin_s, 3), round(pose[joint], 5)] for at_s, pose in push]


@dataclass(frozen=True)
class Point:
    """A mass at some time, with its interval."""

    at_s: float
    mass_kg: float
    low_kg: float
    high_kg: float


@dataclass
class News:
    """By a clock [s]; each entry is written as a whole.

    Attributes:
        positions: Of joints [rad or m].
        efforts: Of joints [N m or N], where they are published.
        entries: Newest of what is said, by what it is about.
        curve: The mass in the last minute.
        pushes: Of the call that is under way, or was last; also the one that is being made.
        nodes: Those that are in the namespace, by their own names.
    """

    now: Callable[[], float] = monotonic
    positions: dict[str, float] = field(default_factory=dict)
    efforts: dict[str, float] = field(default_factory=dict)
    entries: dict[str, Any] = field(default_factory=dict)
    curve: deque[Point] = field(default_factory=deque)
    pushes: deque[Push] = field(default_factory=partial(deque, maxlen=MOST_PUSHES))
    nodes: frozenset[str] = frozenset()
    _heard_s: dict[str, float] = field(default_factory=dict)
    _pushed: bool = False  # when the joint states came before

    def hear(self, about: str, entry: Any = None) -> None:
        """Something new is known about this."""
        self.entries[about] = entry
        self._heard_s[about] = self.now()

    def age_s(self, about: str) -> float:
        """How long ago that was; infinite: never."""
        return self.now() - self._heard_s.get(about, -math.inf)

    def is_old(self, about: str) -> bool:
        """Whether it was never heard, or too long ago."""
        return self.age_s(about) > OLD_S.get(about, math.inf)

    def hear_states(self, names: list[str], positions: list[float], efforts: list[float]) -> None:
        """Joint states.

        Args:
            names: Of the joints.
            positions: Of these [rad or m]; not a number where a joint has none.
            efforts: Of these [N m or N]; empty: there are none.
        """
        known = zip(names, positions, strict=False)
        self.positions.update((name, at) for name, at in known if math.isfinite(at))
        self.efforts.update(zip(names, efforts, strict=False))
        self.hear("states")
        if self.pushing:
            if not self._pushed:
                self.pushes.append([])
            if len(self.pushes[-1]) < MOST_SAMPLES:
                self.pushes[-1].append((self.now(), dict(self.positions)))
        self._pushed = self.pushing

    def hear_estimate(self, said: Said, late_s: float = 0.0) -> None:
        """What the identifier estimates, also of a run under way; a mass goes to the curve.

        Args:
            said: Keys and values.
            late_s: How long ago it was said [s]: who comes later hears the last of them.
        """
        self.hear("estimate", said)
        self._heard_s["estimate"] -= late_s
        if said.values.get("running") == "true":
            self.hear("running")
        point = _point(self._heard_s["estimate"], said.values)
        if point is None:
            return
        self.curve.append(point)
        while self.curve[0].at_s < point.at_s - CURVE_S:
            self.curve.popleft()

    def said(self, about: str) -> Said:
        """The newest sentence about this, with its keys and values; an empty one: there is none."""
        entry = self.entries.get(about)
        return entry if isinstance(entry, Said) else NOTHING

    def claims(self, what: str) -> bool:
        """Whether the newest estimate says that it is so: ``running``, made anew all the time, or ``final``."""
        return self.said("estimate").values.get(what) == "true"

    @property
    def pushing(self) -> bool:
        """Whether a joint is pushed now."""
        return self.said("excitation").values.get("phase") == "probe"

    @property
    def points(self) -> list[Point]:
        """The curve, as seen now: a mass that was weighed stands until something else is said."""
        now_s = self.now()
        found = [point for point in self.curve if now_s - point.at_s < CURVE_S]
        if self.curve and self.claims("final"):
            newest = self.curve[-1]
            if newest.at_s == self._heard_s["estimate"]:
                if not found:
                    found = [replace(newest, at_s=now_s - CURVE_S)]
                found.append(replace(newest, at_s=now_s))
        return found

    @property
    def warnings(self) -> list[str]:
        """What is wrong now, in words, worst first."""
        found = [
            self.said(about)
            for about in self.entries
            if self.said(about).level > 0 and not self.is_old(about)
        ]
        found += [each for each in self.diagnostics if each.level > 0]
        ordered = sorted(found, key=lambda said: -said.level)
        # who wants all of a refusal reads its answer in the wizard
        heads = dict.fromkeys(said.message.partition("; ")[0] for said in ordered)
        return [head for head in heads if not any(head in each and head != each for each in heads)]

    @property
    def diagnostics(self) -> list[Said]:
        """The bus, and each servo, as far as they are not old."""
        return [] if self.is_old("diagnostics") else list(self.entries["diagnostics"])


def _point(at_s: float, values: Mapping[str, str]) -> Point | None:
    """The mass that keys and values state; None: they state none."""
    name = next((key for key in values if values.get(f"{key}.unit") == "kg"), "")
    try:
        mass = float(values[name])
        low, high = map(float, json.loads(values[f"{name}.ci95"]))
    except (KeyError, ValueError, TypeError):
        return None
    if not all(map(math.isfinite, (mass, low, high))):
        return None
    return Point(at_s, mass, low, high)
