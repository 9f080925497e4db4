"""The version of the package, the same in `package.xml`, `setup.py` and `CITATION.cff`; and how it was installed.

What is missing is installed in the same way.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlparse

if TYPE_CHECKING:
    from importlib.metadata import Distribution

__version__ = "0.9.0"

SOURCE = Path(__file__).resolve().parents[1]


def to_install(extra: str, of: Distribution | None = None) -> str:
    """The command that installs what an extra needs: from the clone, from the wheel, or into a workspace's environment.

    Args:
        extra: Of ``setup.py``; several with commas between them.
        of: What was installed; None: what runs here.

    Returns:
        Such as ``pip install -e '.[report]'``.
    """
    found = _running() if of is None else of
    installer = "" if found is None else (found.read_text("INSTALLER") or "").strip()
    if found is not None and not installer:
        # colcon and `setup.py install` leave no name: extras of theirs are packages of the environment that ROS runs in
        return f"{_pip('')} install {' '.join(_packages(found, extra.split(',')))}"
    if found is None:
        editable, place = True, str(SOURCE)
    else:
        editable, place = _origin(found)
    if place and Path(place) == Path.cwd():
        place = "."
    flag = "-e " if editable else ""
    return f"{_pip(installer)} install {flag}'{place or 'proprio_ros'}[{extra}]'"


def _running() -> Distribution | None:
    """What was installed of this copy; None where it runs from its source without having been."""
    from importlib.metadata import distributions

    every = list(distributions(name="proprio_ros"))
    # what a build leaves beside the source is no installation
    beside = (SOURCE / "setup.py").exists()
    elsewhere = [
        found for found in every if not beside or Path(str(found.locate_file(""))) != SOURCE
    ]
    by_name = [found for found in elsewhere if found.read_text("INSTALLER")]
    return next(iter([*by_name, *elsewhere]), None)


def _origin(found: Distribution) -> tuple[bool, str]:
    """Whether it is installed as editable, and from which folder or file; empty: from an index (PEP 610)."""
    try:
        origin = json.loads(found.read_text("direct_url.json") or "{}")
    except ValueError:
        origin = {}
    place = urlparse(origin.get("url", ""))
    editable = bool(origin.get("dir_info", {}).get("editable"))
    return editable, unquote(place.path) if place.scheme == "file" else ""


def _packages(found: Distribution, extras: list[str]) -> list[str]:
    """Names of the packages that extras are made of."""
    names = []
    for line in found.requires or []:
        name = re.match(r"[\w.-]+", line)
        if name and any(re.search(rf"extra == ['\"]{extra}['\"]", line) for extra in extras):
            names.append(name[0])
    return names or extras


def _pip(installer: str) -> str:
    """The pip of this Python, as a shell in this folder finds it."""
    if installer == "uv":
        return "uv pip"
    mine = Path(sys.prefix) / "bin" / "pip"
    first = shutil.which("pip")
    if not mine.exists() or (first is not None and Path(first) == mine):
        return "pip"
    return os.path.relpath(mine) if mine.is_relative_to(Path.cwd()) else str(mine)
