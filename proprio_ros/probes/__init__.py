"""The probes: what can be identified. One line each; a probe's module is loaded when it is asked for."""

from __future__ import annotations

import os
from functools import cache
from typing import Any, cast

from proprio_ros.errors import ConfigurationError
from proprio_ros.probes.base import Online, Probe
from proprio_ros.registry import loaded
from proprio_ros.registry import probes as addon_probes
from proprio_ros.virtual.objects import HandObject, parse_object

PROBES = {
    "payload": "proprio_ros.probes.payload:Payload",
    "container": "proprio_ros.probes.container:Container",
    "softness": "proprio_ros.probes.softness:Softness",
}
"""Module and class of each probe of the core, by name."""

VARIABLE = "PROPRIO_PROBES"
"""Environment variable with probes that live outside this package: ``NAME=module:Class``, separated by commas."""


def registry() -> dict[str, str]:
    """Module and class of each probe, by name: the core's, those of add-ons, those of the environment.

    Raises `ConfigurationError`: The environment variable is not of its form.
    """
    found = {**PROBES, **addon_probes()}
    for line in filter(None, os.environ.get(VARIABLE, "").split(",")):
        name, _, place = line.partition("=")
        if not name.isidentifier() or ":" not in place:
            raise ConfigurationError(f"{VARIABLE}={line}: write NAME=module:Class")
        found[name] = place
    return found


@cache
def _load(place: str) -> Probe[Any]:
    try:
        probe = loaded(place)()
    except (ImportError, AttributeError) as error:
        raise ConfigurationError(f"probe {place}: cannot be loaded ({error})") from error
    assert isinstance(probe, Probe), f"{place} is no Probe"
    return probe


def probe_named(name: str) -> Probe[Any]:
    """A probe by its name. Raises `ConfigurationError`: There is none of that name."""
    places = registry()
    if name not in places:
        raise ConfigurationError(
            f"probe {name!r} is not available; choose one of: {', '.join(places)}"
        )
    return _load(places[name])


def all_probes() -> list[Probe[Any]]:
    """All of them, in the order of the registry."""
    return [_load(place) for place in registry().values()]


def probe_that(kind: type[Any]) -> Any:
    """The first of the registry that has what a class of `base` asks for."""
    return next(probe for probe in all_probes() if isinstance(probe, kind))


def probe_at_work() -> Online[Any]:
    """The one that says what the hand holds while the arm works: the first of the registry that can."""
    return cast("Online[Any]", probe_that(Online))


def virtual_objects() -> list[type[HandObject]]:
    """What a virtual hand can hold, each once."""
    return list(
        dict.fromkeys(
            probe.virtual_object for probe in all_probes() if probe.virtual_object is not None
        )
    )


def virtual_object(text: str) -> HandObject | None:
    """What a user types for an object in a virtual hand; None is an empty hand.

    Raises `ConfigurationError`: No probe's object has that form.
    """
    return parse_object(text, virtual_objects())
