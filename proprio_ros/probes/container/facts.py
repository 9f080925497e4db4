"""Size and place of a container and the sphere in it, from the user's settings and the probe's file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError, SimulationError
from proprio_ros.probes.container.problem import ContainerFacts
from proprio_ros.quantity import Quantity
from proprio_ros.robot import rotation_from_rpy
from proprio_ros.settings import Settings, not_negative, number, vector, yes_or_no
from proprio_ros.sim.sphere import LAWS, Enclosure

DECIDING = ("container.inner_size", "container.centre", "sphere.radius")
"""Facts without a safe default: those of the probe file are the sample recordings'."""


def container_facts(settings: Settings, defaults: Mapping[str, Any]) -> ContainerFacts:
    """Size and place of the container and the sphere, the user's words before the probe file's.

    Args:
        settings: of the user.
        defaults: the sections ``container``, ``sphere`` and ``contact`` of the probe file.

    Raises:
        ConfigurationError: a value of the wrong form or unit, or a sphere that does not fit.
    """

    def take(key: str) -> Any:
        section, name = key.split(".")
        return settings.take(key, defaults[section].get(name))

    shape = take("container.shape")
    size = take("container.inner_size")
    if shape == "cylinder" and isinstance(size, list) and len(size) == 2:
        size = [size[0], size[0], size[1]]
    elif shape == "sphere" and isinstance(size, (int, float)):
        size = [size, size, size]
    inner_size = vector("container.inner_size", size)
    alike = {"cylinder": 2, "sphere": 3}.get(str(shape), 1)
    if np.ptp(inner_size[:alike]) > 0.0:
        form = "[diameter, length]" if shape == "cylinder" else "one diameter"
        raise ConfigurationError(f"container.inner_size={size!r} does not fit a {shape}: give {form} in m")
    radius = number("sphere.radius", take("sphere.radius"))
    if np.any(inner_size <= 0.0) or radius <= 0.0:
        raise ConfigurationError("container.inner_size and sphere.radius must be positive lengths in m")
    if np.any(inner_size > 1.0):
        raise ConfigurationError(
            f"container.inner_size={inner_size.tolist()} is over 1 m: lengths are in m, so 60 mm is 0.06"
        )
    centre = vector("container.centre", take("container.centre"))
    if np.any(np.abs(centre) > 1.0):
        raise ConfigurationError(f"container.centre={centre.tolist()} is over 1 m away from the hand: lengths are in m")
    mass = take("container.mass")
    mass_std = not_negative("container.mass_std", take("container.mass_std"))
    if mass is not None and not_negative("container.mass", mass) > 10.0:
        raise ConfigurationError(f"container.mass={mass:g} is too heavy for a hand: masses are in kg")
    start = take("sphere.start")
    settled, hollow = (yes_or_no(key, take(key)) for key in ("sphere.settled", "sphere.hollow"))
    start_std = not_negative("sphere.start_std", take("sphere.start_std"))
    contact = {
        key: take(f"contact.{key}") for key in ("damping_ratio", "damping_ratio_std", "friction", "friction_std")
    }
    spread = {key: not_negative(f"contact.{key}", value) for key, value in contact.items()}
    frequency = number("contact.frequency", take("contact.frequency"))
    traction = number("contact.traction", take("contact.traction"))
    if not 50.0 <= frequency <= 5000.0 or not 10.0 <= traction <= 5000.0:
        raise ConfigurationError(
            f"contact.frequency={frequency:g} rad/s and contact.traction={traction:g} 1/s must lie between 50 and 5000, 10 and 5000"
        )
    k_e, k_d, k_f = (not_negative(f"contact.{key}", take(f"contact.{key}")) for key in ("k_e", "k_d", "k_f"))
    if k_e == 0.0:
        raise ConfigurationError("contact.k_e must be above 0 N/m")
    law = take("contact.law")
    if law not in LAWS:
        raise ConfigurationError(f"contact.law={law!r} is unknown: choose one of {', '.join(LAWS)}")
    try:
        enclosure = Enclosure(str(shape), inner_size, radius, 2.0 / 3.0 if hollow else 0.4)
    except SimulationError as error:
        raise ConfigurationError(f"{error}: check container.inner_size and sphere.radius") from error
    place = None if start is None else vector("sphere.start", start)
    if place is not None and np.any(np.abs(place) > enclosure.room + 1e-3):
        raise ConfigurationError(
            f"sphere.start={place.tolist()} is outside the container: the sphere's centre can only go "
            f"{(1e3 * enclosure.room).tolist()} mm from the middle"
        )
    return ContainerFacts(
        enclosure,
        centre,
        rotation_from_rpy(vector("container.rpy", take("container.rpy"))),
        0.03 if mass is None else float(mass),
        np.inf if mass is None else mass_std,
        settled,
        place,
        start_std,
        frequency,
        Quantity(spread["damping_ratio"], spread["damping_ratio_std"]),
        Quantity(spread["friction"], spread["friction_std"]),
        traction,
        law,
        k_e,
        k_d,
        k_f,
        tuple(key for key in DECIDING if key not in settings.taken),
    )
