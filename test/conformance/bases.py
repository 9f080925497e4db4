"""Recordings that rows bend: what they are, how they are asked, and what is true of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from support.machines import REAL

BAGS = Path(__file__).resolve().parents[2] / "bags"
Files = Mapping[str, Path]
"""Of each word in braces of a command the path that stands there."""


@dataclass(frozen=True)
class Base:
    """Recordings whose truth is known.

    Attributes:
        name: Of it in rows.
        about: What it is, for the page.
        command: Words of the command line; those in braces are of `files`.
        files: Makes or finds the files; those it makes go into the folder.
        estimate: Name of the value that is asked for.
        truth: Of that value, SI.
        real: A recording that does not ship with this package: rows that need it are skipped without.
    """

    name: str
    about: str
    command: tuple[str, ...]
    files: Callable[[Path], Files]
    truth: float
    estimate: str = "payload_mass"
    real: bool = False

    @property
    def missing(self) -> bool:
        """Whether its recordings are not at hand."""
        return self.real and not REAL.is_dir()


def _real(**names: str) -> Callable[[Path], Files]:
    return lambda folder: {name: REAL / bag for name, bag in names.items()}


def _bag(folder: Path) -> Path:
    return sorted(folder.glob("bag_*"))[0]


def _shipped(**names: str) -> Callable[[Path], Files]:
    return lambda folder: {name: _bag(BAGS / bag) for name, bag in names.items()}


_UR10E = ("--probe", "payload", "--robot", "ur10e", "--driver", "ur_current")
_BY_BASELINE = ("replay", "{loaded}", "--baseline", "{empty}")
_BALL = (
    "--set",
    "payload.com=[0,0,0]",
    "--set",
    "payload.shape=sphere",
    "--set",
    "payload.size=0.03",
)

BASES = {
    base.name: base
    for base in (
        Base(
            name="ur10e",
            about="a real UR10e with 2.805 kg in motion, 50 s, against its empty hand; currents in A",
            command=(*_BY_BASELINE, *_UR10E),
            files=_real(loaded="ur10e_loaded_14", empty="ur10e_empty_14"),
            truth=2.805,
            real=True,
        ),
        Base(
            name="ur10e_15",
            about="the same arm a minute later",
            command=(*_BY_BASELINE, *_UR10E),
            files=_real(loaded="ur10e_loaded_15", empty="ur10e_empty_15"),
            truth=2.805,
            real=True,
        ),
        Base(
            name="ur10e_nothing",
            about="the same arm with nothing in the hand, against another recording without",
            command=(*_BY_BASELINE, *_UR10E),
            files=_real(loaded="ur10e_empty_15", empty="ur10e_empty_14"),
            truth=0.0,
            real=True,
        ),
        Base(
            name="push_20g",
            about="a simulated OpenManipulator-X with a ball of 20 g, one joint pushed from rest; uncalibrated",
            command=("replay", "{loaded}", "--probe", "payload", *_BALL),
            files=_shipped(loaded="realistic_s00_fixed_light_ball_20g_joint3"),
            truth=0.02,
        ),
    )
}
