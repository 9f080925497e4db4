"""Without the packages of its extras the program gives the same answers; who asks for one of them reads one sentence."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
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


def proprio(
    folder: Path,
    *words: str,
    blocked: bool = True,
) -> subprocess.CompletedProcess[str]:
    """A command as a process of its own, with or without the packages of the extras."""
    program = ["-c", BLOCKED] if blocked else ["-m", "proprio_ros.cli"]
    return subprocess.run(
        [sys.executable, *program, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
    )


def answer(folder: Path, *words: str, blocked: bool) -> dict[str, Any]:
    """The object of ``--json``, without what it took, and without the fingerprint of a file that has its date in it."""
    found = json.loads(proprio(folder, *words, "--json", blocked=blocked).stdout)
    found.pop("timing_s", None)
    found.pop("calibration", None)
    return found


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
