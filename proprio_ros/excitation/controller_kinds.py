"""Whose commands the excitation node can give beside this package's driver: controllers of others, by `command_interface`.

Another kind is a subclass of `Controller` in a file of its own, and stands here. Where such a controller listens, what the node's
parameters and its log say of it, and what a recording has of it, follow from that class.
"""

from __future__ import annotations

from proprio_ros.excitation.controllers import Controller
from proprio_ros.excitation.effort_controller import EffortController
from proprio_ros.excitation.goal_controller import GoalController

CONTROLLER_KINDS: dict[str, type[Controller]] = {
    each.kind: each for each in (EffortController, GoalController)
}
