"""What add-ons bring. Each is a folder of ``proprio_ros/addons`` that can be deleted; no other file of the core names that place.

The ``__init__.py`` of an add-on has a function ``register()`` without arguments that returns an `Addon`. What it brings is given
as the place of an object, ``"module:attribute"``, and loaded when it is asked for, so that nothing waits for what it does not use.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any

FOLDER = "proprio_ros.addons"


@dataclass(frozen=True)
class Addon:
    """What one add-on brings, each the place of an object by its name."""

    probes: Mapping[str, str] = field(default_factory=dict)
    """Classes that stand on `proprio_ros.probes.base.Probe`."""
    commands: Mapping[str, str] = field(default_factory=dict)
    """Commands of ``proprio``: functions that take ``add_parser`` and add the command's parser."""
    calls: Mapping[str, str] = field(default_factory=dict)
    """Functions for scripts, ``proprio_ros.NAME``."""


@cache
def addons() -> tuple[Addon, ...]:
    """What is there, in the order of the folders' names."""
    try:
        folder = import_module(FOLDER)
    except ModuleNotFoundError:
        return ()
    names = sorted(module.name for module in pkgutil.iter_modules(folder.__path__))
    return tuple(import_module(f"{FOLDER}.{name}").register() for name in names)


def probes() -> dict[str, str]:
    """Places of the add-ons' probes by name."""
    return {name: place for addon in addons() for name, place in addon.probes.items()}


def commands() -> dict[str, str]:
    """Places of the add-ons' commands by name."""
    return {name: place for addon in addons() for name, place in addon.commands.items()}


def calls() -> dict[str, str]:
    """Places of the add-ons' functions for scripts by name."""
    return {name: place for addon in addons() for name, place in addon.calls.items()}


def loaded(place: str) -> Any:
    """The object at a place, ``"module:attribute"``."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
