"""The experiments of the paper (Chen et al. 2025, arXiv:2410.03920) again, on recordings of a simulated arm, as one page.

``hand``         an OpenManipulator-X in MuJoCo with a hidden drive train, which makes the recordings;
``ways``         the paper's way of identifying and the others that are compared, each as one call;
``experiments``  pure functions from a seed to rows;
``store``        one file per experiment and seed, so that a run that was stopped goes on;
``page``         tables and figures; ``quoted`` what the paper itself says, as far as it is available here.
"""

from __future__ import annotations

from proprio_ros.registry import Addon


def register() -> Addon:
    """The command ``proprio paper``."""
    return Addon(commands={"paper": "proprio_ros.addons.paper.command:add_parser"})
