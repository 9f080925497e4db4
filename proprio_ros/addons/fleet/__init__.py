"""Many recordings: a pure function from an episode to rows, engines that call it, and parquet files that hold the rows.

``episodes`` lists what there is, ``rows`` answers for one episode, ``store`` keeps rows and knows which episodes are done,
``local`` and ``on_ray`` are the engines, ``job`` ties them together.
"""

from __future__ import annotations

from proprio_ros.registry import Addon


def register() -> Addon:
    """The command ``proprio batch`` and the call ``proprio_ros.drift``."""
    return Addon(
        commands={"batch": "proprio_ros.addons.fleet.command:add_parser"},
        calls={"drift": "proprio_ros.addons.fleet.drift:drift"},
    )
