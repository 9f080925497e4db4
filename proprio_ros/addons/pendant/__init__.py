"""The pendant: pages in a browser that do what a person does at the arm and with recordings, and nothing that a service does not.

``gate``       every request and socket, before anything else sees it;
``lease``      who may move the arm;
``news``       what the nodes say, with its age; ``listener`` hears it, the only module here that imports ROS;
``calls``      ``proprio call`` as a process, one at a time;
``places``     where recordings may lie; ``desk`` those that are chosen; ``jobs`` commands about them as processes, one at a time;
``pendant``    these together;
``frame``      what every page has: navigation, lights, STOP; ``pages`` has a module for each;
``server``     the pages behind the gate.
"""

from __future__ import annotations

from proprio_ros.registry import Addon


def register() -> Addon:
    """The command ``proprio pendant``."""
    return Addon(commands={"pendant": "proprio_ros.addons.pendant.command:add_parser"})
