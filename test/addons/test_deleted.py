"""Each add-on can be deleted: a copy of the package without it imports, answers as before, and its core's tests pass."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
ADDONS = sorted(
    path.parent.name for path in (REPOSITORY / "proprio_ros" / "addons").glob("*/__init__.py")
)
ALL = "all of them"
BRINGS = {
    "contents": set(),
    "fleet": {"batch"},
    "paper": {"paper"},
    "pendant": {"pendant"},
}
"""Commands of ``proprio`` by add-on."""
CORE = (
    "test/test_records.py",
    "test/probes/test_base.py",
    "test/probes/test_fourth_probe.py",
    "test/pipeline/test_request.py",
    "test/identification/test_problem.py",
    "test/recordings/test_runs.py",
    "test/excitation/test_plans.py",
)
"""Tests of the core that are quick and go through most of its rooms."""
EVERY_MODULE = """
import importlib, pkgutil, proprio_ros
for module in pkgutil.walk_packages(proprio_ros.__path__, "proprio_ros."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
assert importlib.util.find_spec("proprio_ros").origin == "COPY/proprio_ros/__init__.py"
"""


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """A process of Python whose package is that of a folder."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
    )


def commands(folder: Path) -> set[str]:
    """The commands that ``proprio --help`` lists."""
    shown = run(folder, "-m", "proprio_ros.cli", "--help")
    assert shown.returncode == 0, shown.stderr
    return set(re.findall(r"^    ([a-z]+)\b", shown.stdout, re.MULTILINE))


def offline_example(folder: Path) -> list[dict[str, Any]]:
    """What the two commands of README's offline example answer as JSON, without what each time is another."""
    section = (REPOSITORY / "README.md").read_text().split("**Offline**", 1)[1]
    block = re.search(r"```\n(.*?)```", section, re.DOTALL)
    assert block is not None
    answers = []
    for line in block[1].replace("\\\n", " ").splitlines():
        words = []
        for word in shlex.split(line, comments=True)[1:]:
            found = sorted(str(path.relative_to(folder)) for path in folder.glob(word))
            words.extend(found or [word])
        if "--report" in words:
            at = words.index("--report")
            del words[at : at + 2]
        done = run(folder, "-m", "proprio_ros.cli", *words, "--json")
        assert done.returncode == 0, done.stderr
        answer = json.loads(done.stdout)
        answer.pop("timing_s", None)
        answer.pop("calibration", None)  # the fingerprint of a file with its date
        answers.append(answer)
    return answers


def copied(folder: Path, *without: str) -> Path:
    """A copy of the repository with what it needs to run, without some add-ons and their tests."""
    for name in ("proprio_ros", "test"):
        shutil.copytree(
            REPOSITORY / name,
            folder / name,
            ignore=shutil.ignore_patterns("__pycache__", "benchmarks"),
        )
    for name in without:
        shutil.rmtree(folder / "proprio_ros" / "addons" / name)
        shutil.rmtree(folder / "test" / "addons" / name)
    for name in ("README.md", "bags", "config", "docs", "pyproject.toml", "setup.py", "urdf"):
        (folder / name).symlink_to(REPOSITORY / name)
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[set[str], list[dict[str, Any]]]:
    """Commands and answers with all add-ons."""
    folder = copied(tmp_path_factory.mktemp("whole"))
    return commands(folder), offline_example(folder)


def test_each_add_on_is_here() -> None:
    assert set(BRINGS) == set(ADDONS)


@pytest.mark.long
@pytest.mark.parametrize("deleted", [*ADDONS, ALL])
def test_the_rest_works_without(
    deleted: str,
    whole: tuple[set[str], list[dict[str, Any]]],
    tmp_path: Path,
) -> None:
    gone = ADDONS if deleted == ALL else [deleted]
    folder = copied(tmp_path, *gone)
    imported = run(
        folder,
        "-c",
        EVERY_MODULE.replace("COPY", str(folder)),
    )
    assert imported.returncode == 0, imported.stderr
    before, answers = whole
    assert commands(folder) == before - set().union(*(BRINGS[name] for name in gone))
    assert offline_example(folder) == answers
    if deleted == ALL:  # the core alone
        tested = run(
            folder,
            "-m",
            "pytest",
            "-q",
            "-x",
            "-p",
            "no:cacheprovider",
            *CORE,
        )
        assert tested.returncode == 0, tested.stdout[-4000:]
