"""Shape and place of a payload, from the user's settings and the probe's file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.settings import Settings, number, vector
from proprio_ros.sim.payload import PayloadFacts, PayloadShape


def payload_facts(settings: Settings, defaults: Mapping[str, Any]) -> PayloadFacts:
    """Shape and place of the payload, the user's words before the probe file's.

    Raises:
        ConfigurationError: a value of the wrong form, or a size that cannot be in metres.
    """
    com = vector("payload.com", settings.take("payload.com", defaults["com"]))
    if np.any(np.abs(com) > 1.0):
        raise ConfigurationError(f"payload.com={com.tolist()} is over 1 m away from the hand: lengths are in m")
    com_std = vector("payload.com_std", settings.take("payload.com_std", defaults["com_std"]))
    if np.any(com_std < 0.0):
        raise ConfigurationError("payload.com_std must not be negative")
    name = settings.take("payload.shape", None)
    size = settings.take("payload.size", None)
    per_mass = settings.take("payload.inertia_per_mass", None)
    size_std = number(
        "payload.size_std_relative", settings.take("payload.size_std_relative", defaults["size_std_relative"])
    )
    if per_mass is not None:
        if name is not None or size is not None:
            raise ConfigurationError("give payload.inertia_per_mass, or payload.shape and payload.size, not both")
        return PayloadFacts(com, com_std, PayloadShape.from_inertia_per_mass(per_mass), 0.0)
    if name is None and size is not None:
        name = "sphere" if np.ndim(size) == 0 else "box"
    shape_name = str(name if name is not None else defaults["shape"])
    if size is None and shape_name != "point":
        # a shape without its size is a guess, and so is the probe file's ball
        edge = float(defaults["size"])
        guess: dict[str, Any] = {"sphere": edge, "cube": edge, "box": [edge] * 3, "cylinder": [edge, edge]}
        shape = PayloadShape.of(shape_name, guess.get(shape_name))
        return PayloadFacts(com, com_std, shape, size_std)
    return PayloadFacts(com, com_std, PayloadShape.of(shape_name, size), 0.0)


def inertia_tensor(facts: PayloadFacts, mass_kg: float) -> np.ndarray:
    """Inertia about the payload's centre of mass [kg m^2], shape (3, 3).

    NaN where its shape was not stated, since one joint's motion does not determine it.
    """
    if facts.shape_std_relative > 0.0:
        return np.full((3, 3), np.nan)
    return mass_kg * rotational_inertia(facts.shape.second_moment_per_mass)


def rotational_inertia(second_moment: np.ndarray) -> np.ndarray:
    """From the integral of r r^T dm to that of r^2 - r r^T, shape (3, 3)."""
    tensor: np.ndarray = np.trace(second_moment) * np.eye(3) - second_moment
    return tensor
