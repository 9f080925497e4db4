"""A robot arm's sense of weight and softness from its own joints.

"The paper", in this package, is

    Peter Yichen Chen, Chao Liu, Pingchuan Ma, John Eastman, Daniela Rus, Dylan Randle, Yuri Ivanov, Wojciech Matusik:
    "Learning Object Properties Using Robot Proprioception via Differentiable Robot-Object Interaction",
    IEEE International Conference on Robotics and Automation (ICRA), 2025. https://arxiv.org/abs/2410.03920

and equation numbers are its own where nothing else is said.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from proprio_ros import registry
from proprio_ros.version import __version__

if TYPE_CHECKING:
    from proprio_ros.pipeline.api import calibrate, check, plan, weigh
    from proprio_ros.pipeline.api import weigh as replay

__all__ = ["__version__", "calibrate", "check", "plan", "replay", "weigh"]
ALIASES = {"replay": "weigh"}
"""Names of a call by which the command line knows it."""


def __getattr__(name: str) -> Any:
    """The calls for scripts and notebooks, loaded with all they need when they are first asked for."""
    if name in __all__:
        return getattr(import_module("proprio_ros.pipeline.api"), ALIASES.get(name, name))
    # what Python itself asks for is nobody's call
    if not name.startswith("_") and name in registry.calls():
        return registry.loaded(registry.calls()[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *registry.calls()})
