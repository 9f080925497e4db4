"""Shape and place of a container: from the user's settings and the probe's file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from proprio_ros.addons.contents.models import ContentsFacts
from proprio_ros.inputs.forms import Form, Number, Numbers, Perhaps
from proprio_ros.inputs.settings import Settings
from proprio_ros.robot import rotation_from_rpy

_LENGTH = "lengths are in m, so 35 mm is 0.035"
_NEAR_HAND = Number(
    unit="m", lowest=-1.0, highest=1.0, hint="over 1 m away from the hand: lengths are in m"
)
FORMS: dict[str, Form] = {
    "contents.radius": Number(
        "of the inside of the upright cylinder", "m", 0.002, 0.5, hint=_LENGTH
    ),
    "contents.height": Number("of its inside", "m", 0.005, 1.0, hint=_LENGTH),
    "contents.bottom": Numbers(
        "middle of the inside bottom in `payload.frame`", _NEAR_HAND, 3, example="[x, y, z] in m"
    ),
    "contents.rpy": Numbers(
        "how the cylinder is turned against that frame",
        Number(unit="rad", lowest=-7.0, highest=7.0),
        3,
        example="three angles in rad",
    ),
    "contents.mass": Perhaps(
        "of the empty container; null: not known, so `--baseline` is needed",
        Number(unit="kg", lowest=0.0, highest=10.0, hint="masses are in kg"),
    ),
    "contents.mass_std": Number(
        "of the scales; counts only where the mass is stated", "kg", 0.0, 10.0
    ),
    "contents.density": Number("of a liquid", "kg/m^3", 300.0, 15000.0, hint="water is 1000"),
    "contents.density_std": Number("how well it is known", "kg/m^3", 1.0, 5000.0),
}
"""What may be stated about a container and its contents."""


def contents_facts(settings: Settings, defaults: Mapping[str, Any]) -> ContentsFacts:
    """The user's words before the section ``contents`` of the probe's file.

    Raises `ConfigurationError`: A value of the wrong form or unit.
    """
    said = {
        key.removeprefix("contents."): settings.take(
            key, defaults.get(key.removeprefix("contents.")), form
        )
        for key, form in FORMS.items()
    }
    mass = said.pop("mass")
    std = said.pop("mass_std")
    known = (0.05, np.inf) if mass is None else (mass, std)
    rotation = rotation_from_rpy(said.pop("rpy"))
    bottom = np.array(said.pop("bottom"))
    return ContentsFacts(
        bottom=bottom,
        rotation=rotation,
        mass=known[0],
        mass_std=known[1],
        **said,
    )
