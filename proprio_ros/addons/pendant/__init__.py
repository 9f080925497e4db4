"""The pendant: pages in a browser that do what a person does at the arm and with recordings, and nothing that a service does not.

``gate``       every request and socket, before anything else sees it;
``lease``      who may move the arm;
``news``       what the nodes say, with its age; ``listener`` hears it, the only module here that imports ROS;
``calls``      commands of ``proprio`` as processes, one at a time: services, and what is computed from recordings;
``tasks``      what the wizard can have done, and what will move;
``places``     where recordings may lie; ``desk`` those that are chosen; ``kept`` what was answered;
``pendant``    these together;
``words``, ``results``, ``parts``, ``drawing``  what is said, answered and drawn, for all pages;
``frame``      what every page has: navigation, lights, STOP; ``pages`` has a module for each;
``server``     the pages behind the gate.
"""

from __future__ import annotations

from proprio_ros.registry import Addon


def register() -> Addon:
    """The command ``proprio pendant``."""
    return Addon(commands={"pendant": "proprio_ros.addons.pendant.command:add_parser"})
