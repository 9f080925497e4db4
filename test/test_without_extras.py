"""Without the packages of its extras the program gives the same answers; who asks for one of them reads one sentence."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
BAGS = REPOSITORY / "bags"
EXTRAS = ("cma", "matplotlib", "meshio", "mujoco", "newton", "pandas", "pyarrow", "ray")
# a module whose place in `sys.modules` is None cannot be imported
BLOCKED = f"""
import sys
for name in {EXTRAS}:
    sys.modules[name] = None
from proprio_ros.cli import run
run()
"""
LIFT = str(BAGS / "quantised_s00_fixed_heavy_ball_50g_joint3/bag_mcap")
EMPTY = [str(bag) for bag in sorted(BAGS.glob("realistic_s00_empty_*/bag_mcap"))]


def run(
    words: list[str | Path],
    folder: Path,
    environment: dict[str, str],
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)


def proprio(
    folder: Path,
    *words: str,
    blocked: bool = True,
) -> subprocess.CompletedProcess[str]:
    """A command as a process of its own, with or without the packages of the extras."""
    program = ["-c", BLOCKED] if blocked else ["-m", "proprio_ros.cli"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    return run([sys.executable, *program, *words], folder, environment)


def answer_of(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """The object of ``--json``, without what it took, and without the fingerprint of a file that has its date in it."""
    found = json.loads(done.stdout)
    found.pop("timing_s", None)
    found.pop("calibration", None)
    return found


def answer(folder: Path, *words: str, blocked: bool) -> dict[str, Any]:
    return answer_of(proprio(folder, *words, "--json", blocked=blocked))


# of the fresh environment: no code of the clone, and no package of who tests
ALONE = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Programs of an environment that has nothing but ``pip install .``, in the versions that the tests run with."""
    folder = tmp_path_factory.mktemp("fresh")
    run([sys.executable, "-m", "venv", "there"], folder, ALONE).check_returncode()
    programs = folder / "there" / "bin"
    install: list[str | Path] = [programs / "python", "-m", "pip", "install"]
    asked = run([*install, "--dry-run", "--no-deps", "numpy"], folder, ALONE)
    if asked.returncode != 0:
        pytest.skip("no package index is reached: pip finds no numpy")
    # a build writes into its source
    shutil.copytree(
        REPOSITORY,
        folder / "source",
        ignore=shutil.ignore_patterns(".*", "build", "__pycache__", "*.egg-info"),
    )
    versions = {each.metadata["Name"]: each.version for each in distributions()}
    versions.pop("proprio_ros", None)
    constraints = folder / "constraints.txt"
    constraints.write_text("\n".join(f"{name}=={version}" for name, version in versions.items()))
    done = run([*install, "./source", "-c", constraints], folder, ALONE)
    assert done.returncode == 0, done.stderr
    yield programs
    shutil.rmtree(folder)


@pytest.mark.long
def test_pip_brings_no_package_of_an_extra(fresh: Path, tmp_path: Path) -> None:
    listed = run([fresh / "python", "-m", "pip", "list", "--format", "json"], tmp_path, ALONE)
    names = {each["name"].lower() for each in json.loads(listed.stdout)}
    assert {"numpy", "warp-lang"} <= names
    assert not names & set(EXTRAS)


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ("replay", LIFT, "--probe", "payload"),
        ("calibrate", *EMPTY, "--output", "arm.yaml", "--force"),
    ],
    ids=lambda words: words[0],
)
def test_what_pip_installed_gives_the_same_json(
    fresh: Path,
    tmp_path: Path,
    words: tuple[str, ...],
) -> None:
    installed = run([fresh / "proprio", *words, "--json"], tmp_path, ALONE)
    assert installed.stdout, installed.stderr
    assert answer_of(installed) == answer(tmp_path, *words, blocked=False)


def test_replay_gives_the_same_json(tmp_path: Path) -> None:
    words = ("replay", LIFT, "--probe", "payload")
    without = answer(tmp_path, *words, blocked=True)
    assert without["estimates"][0]["value"] == pytest.approx(0.05, abs=1e-3)
    assert without == answer(tmp_path, *words, blocked=False)


@pytest.mark.long
def test_calibrate_gives_the_same_json(tmp_path: Path) -> None:
    words = ("calibrate", *EMPTY, "--output", "arm.yaml")
    without = answer(tmp_path, *words, blocked=True)
    assert without["verdict"] == "accepted"
    assert without == answer(tmp_path, *words, "--force", blocked=False)


@pytest.mark.parametrize(
    ("words", "package", "extra"),
    [
        (("replay", LIFT, "--probe", "payload", "--report", "page.html"), "matplotlib", "report"),
        (("replay", LIFT, "--probe", "payload", "--solver", "cma"), "cma", "cma"),
        (("paper", "--out", "again", "--only", "optimisers"), "cma", "cma"),
        (("batch", LIFT, "--out", "rows"), "pyarrow", "batch"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else value,
)
def test_one_sentence_says_what_to_install(
    tmp_path: Path,
    words: tuple[str, ...],
    package: str,
    extra: str,
) -> None:
    refused = proprio(tmp_path, *words)
    assert refused.returncode == 2 and refused.stdout == ""
    sentence = refused.stderr.splitlines()[-1]
    assert sentence.startswith("proprio: ") and package in sentence
    assert re.search(rf"pip install -e '[^']*\[{extra}\]'", sentence)
    assert "Traceback" not in refused.stderr
