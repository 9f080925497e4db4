"""What is missing is said to be installed as the package itself was: from a clone, a wheel, an index or a workspace."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

from proprio_ros.version import to_install

REPOSITORY = Path(__file__).resolve().parents[1]
REQUIRES = """Metadata-Version: 2.1
Name: proprio_ros
Version: 0.9.0
Requires-Dist: numpy
Requires-Dist: matplotlib>=3.6; extra == "report"
Requires-Dist: ray[data]>=2.40; extra == "ray"
"""


def installed(
    folder: Path, installer: str = "pip", url: str = "", editable: bool = False
) -> PathDistribution:
    """As pip, uv or colcon leave it (PEP 376, PEP 610)."""
    found = folder / "proprio_ros-0.9.0.dist-info"
    found.mkdir()
    (found / "METADATA").write_text(REQUIRES)
    if installer:
        (found / "INSTALLER").write_text(f"{installer}\n")
    if url:
        origin = {"url": url, "dir_info": {"editable": True} if editable else {}}
        (found / "direct_url.json").write_text(json.dumps(origin))
    return PathDistribution(found)


@pytest.mark.parametrize(
    ("how", "ends"),
    [
        ({"url": "file:///home/me/my%20arm", "editable": True}, "-e '/home/me/my arm[report]'"),
        ({"url": "file:///home/me/clone"}, "'/home/me/clone[report]'"),
        ({"url": "file:///home/me/p.whl"}, "'/home/me/p.whl[report]'"),
        ({}, "'proprio_ros[report]'"),
        ({"installer": "uv", "url": "file:///c", "editable": True}, "-e '/c[report]'"),
        ({"installer": ""}, "matplotlib"),
    ],
)
def test_the_hint_is_of_how_it_was_installed(
    how: dict[str, object], ends: str, tmp_path: Path
) -> None:
    words = to_install("report", installed(tmp_path, **how))  # type: ignore[arg-type]
    assert words.endswith(f" install {ends}")
    assert words.startswith("uv pip ") == (how.get("installer") == "uv")


def test_in_the_clone_itself_its_name_is_short(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = installed(tmp_path, url=tmp_path.as_uri(), editable=True)
    assert to_install("report", found).endswith(" install -e '.[report]'")


def test_what_runs_from_its_source_is_installed_from_there() -> None:
    """Whatever lies beside it: `pip install -e` leaves metadata in the clone, without a word on who made it."""
    code = "from proprio_ros.version import to_install; print(to_install('report'))"
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, cwd="/"
    )
    assert "[report]'" in done.stdout, done.stderr
