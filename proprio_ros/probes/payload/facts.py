"""Shape and place of a payload, from the user's settings and the probe's file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.forms import Choice, Form, Number, Numbers
from proprio_ros.inputs.settings import Settings, read
from proprio_ros.sim.payload import SHAPES, PayloadFacts, PayloadShape

_PLACE = "[x, y, z] in m"
_NEAR_HAND = Number(
    unit="m", lowest=-1.0, highest=1.0, hint="over 1 m away from the hand: lengths are in m"
)
_LENGTH = Number(unit="m", lowest=0.0, highest=1.0, hint="lengths are in m")
FORMS: dict[str, Form] = {
    "payload.com": Numbers("centre of mass in `payload.frame`", _NEAR_HAND, 3, example=_PLACE),
    "payload.com_std": Numbers(
        "how far the true centre may lie from it; above 0 it is estimated, too",
        _LENGTH,
        3,
        example=_PLACE,
    ),
    "payload.shape": Choice("of uniform density", SHAPES),
    "payload.size_std_relative": Number(
        "of the mass's spread (size squared); counts only while shape and size are not stated",
        "",
        0.0,
        10.0,
    ),
    "payload.inertia_per_mass": Numbers(
        "about the centre of mass; instead of shape and size",
        Number(unit="m^2", lowest=-1.0, highest=1.0),
        6,
        example="[ixx, iyy, izz, ixy, ixz, iyz] in m^2",
    ),
}
"""What may be stated about a payload; `payload.size` has the form that its shape needs."""
_SIZE = Number(
    unit="m", lowest=0.0, highest=1.0, open=True, hint="lengths are in m, so 30 mm is 0.03"
)


def payload_facts(settings: Settings, defaults: Mapping[str, Any]) -> PayloadFacts:
    """Shape and place of the payload, the user's words before the probe file's.

    Raises `ConfigurationError`: A value of the wrong form, or a size that cannot be in metres.
    """

    def take(key: str, default: Any) -> Any:
        return settings.take(
            key, default, None if default is None and key not in settings.left else FORMS[key]
        )

    guessed = not {"payload.com", "payload.com_std"} & set(settings.left)
    com = np.array(take("payload.com", defaults["com"]))
    com_std = np.array(take("payload.com_std", defaults["com_std"]))
    name = take("payload.shape", None)
    size = settings.take("payload.size", None)
    per_mass = take("payload.inertia_per_mass", None)
    size_std = take("payload.size_std_relative", defaults["size_std_relative"])
    if per_mass is not None:
        if name is not None or size is not None:
            raise ConfigurationError(
                "give payload.inertia_per_mass, or payload.shape and payload.size, not both"
            )
        return PayloadFacts(
            com, com_std, PayloadShape.from_inertia_per_mass(per_mass), 0.0, guessed
        )
    if name is None and size is not None:
        name = "box" if isinstance(size, list) else "sphere"
    shape_name = (
        name
        if name is not None
        else read("payload.shape", defaults["shape"], FORMS["payload.shape"])
    )
    if size is None and shape_name != "point":
        # a shape without its size is a guess, and so is the probe file's ball
        edge = read("payload.size", defaults["size"], _SIZE)
        guess: dict[str, Any] = {
            "sphere": edge,
            "cube": edge,
            "box": [edge] * 3,
            "cylinder": [edge, edge],
        }
        shape = PayloadShape.of(shape_name, guess.get(shape_name))
        return PayloadFacts(com, com_std, shape, size_std, guessed)
    if shape_name != "point":
        size = read(
            "payload.size", size, Numbers("", _SIZE, most=3) if isinstance(size, list) else _SIZE
        )
    return PayloadFacts(com, com_std, PayloadShape.of(shape_name, size), 0.0, guessed)


def inertia_tensor(facts: PayloadFacts, mass_kg: float) -> np.ndarray:
    """Inertia about the payload's centre of mass [kg m^2], shape (3, 3): as stated, else the probe file's guess."""
    return mass_kg * rotational_inertia(facts.shape.second_moment_per_mass)


def settings_of(shell: PayloadFacts) -> dict[str, object]:
    """What is stated of a load, as settings of the payload probe."""
    per_mass = rotational_inertia(shell.shape.second_moment_per_mass)
    rows = [0, 1, 2, 0, 0, 1]
    columns = [0, 1, 2, 1, 2, 2]
    six = per_mass[rows, columns].tolist()
    return {"payload.com": shell.com.tolist(), "payload.inertia_per_mass": six}


def rotational_inertia(second_moment: np.ndarray) -> np.ndarray:
    """From the integral of r r^T dm to that of r^2 - r r^T, shape (3, 3)."""
    return np.asarray(np.trace(second_moment) * np.eye(3) - second_moment)
