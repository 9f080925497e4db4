"""Every benchmark runs, in as small a form as it has, and keeps what it found; what it finds is judged elsewhere."""

from __future__ import annotations

import importlib
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import gpu
import pytest
from figures import markdown
from results import REPOSITORY

from proprio_ros.identification.together import rules

SHARED = REPOSITORY.parent / "shared"
SMALL: dict[str, tuple[str, ...]] = {
    "at_rest": ("--arms", "1", "--first", "2", "--masses", "0.3", "--seconds", "10"),
    "between_recordings": (
        "--arms=0",
        "--servos=0",
        "--pendulums=1",
        "--first=400",
        "--jobs=1",
        "--real",
    ),
    "block_until": ("--robots", "1", "--at-most", "6", "--jobs", "1"),
    "container_until": (
        "--robots=1",
        "--first=9001",
        "--reference=none",
        "--fixed-every=2",
        "--at-most=10",
        "--jobs=1",
    ),
    "contents": ("--particles", "--at-most", "1"),
    "coverage": ("--robots", "1", "--per-effect", "0", "--jobs", "1"),
    "distorted": ("--count", "2", "--kinds", "publishers", "--bases", "ur10e_nothing"),
    "drift": ("--robots", "1", "--masses", "0.05", "--reference", "none", "--jobs", "1"),
    "early_end": ("--robots", "1", "--masses", "0.05", "--at-most", "20", "--jobs", "1"),
    "free_swings": ("--arms", "1", "--first", "10"),
    "longer": ("--arms", "1", "--minutes", "0.3", "0.5", "--times"),
    "mistakes": (
        "--arms",
        "pushes",
        "--only",
        "*alone*, effort, sign of all joints*",
        "--jobs",
        "1",
    ),
    "more_recordings": ("--arms", "1", "--percent", "1"),
    "mutated_pushes": ("--count", "2", "--first", "3"),
    "motions": ("--arms", "1", "--first", "101", "--seconds", "10"),
    "real": ("--machines", "open_manipulator"),
    "time_axis": ("--step", "1.5", "--sets", "0", "--only", "Panda"),
    "running": (
        "--arms",
        "1",
        "--first",
        "6",
        "--sensing",
        "1",
        "--minutes",
        "0.3",
        "--stays",
        "1",
    ),
    "servos": ("--servos", "1", "--questions", "1"),
    "simulated": (
        "weighing",
        "container",
        "blocks",
        "paper",
        "--robots",
        "quantised_s00",
        "--at-most",
        "1",
    ),
    "so101": ("--arms", "1", "--first", "1", "--seconds", "10"),
    "spheres": ("--robots", "1", "--jobs", "1"),
    "squeezes": ("--robots", "1"),
    "swings": ("--pendulums", "1"),
    "until_sure": (
        "--robots",
        "1",
        "--masses",
        "0.02",
        "--reference",
        "none",
        "--at-most",
        "20",
        "--jobs",
        "1",
    ),
    "whose_calibration": ("--parts", "driven", "--machines", "1"),
}
ELSEWHERE = {
    "against_c", "against_mujoco", "against_scipy", "against_substeps", "bus", "calibrated", "container", "fresh_process",
    # parts of run.py; bus: test/bus/test_cycle.py, where the computer is not shared
    "gpu", "planned", "softness", "waits",
    "answers", "batch", "motion_bound", "random_arm", "run",  # below, and in test_motion_bound.py
    "contents_bound",  # of a law, without recordings: its table is kept
    # minutes a seed: test/excitation/test_late_efforts.py calibrates such an arm
    "foreign_controller",
    "foreign_load",  # in real time and beside a load, for minutes
    "foreign_process",  # a process for whoever tries probes by hand
    # a minute an arm: test/world/test_services.py and test_effort_controller.py ask the same for some masses
    "live",
    # what real processes take while nothing is done: in real time, where the computer is not shared
    "idle",
    "pendant",  # its page in a browser, for minutes: test/addons/pendant clicks through it
    "soak",  # an hour, beside a load
    "softness_live",  # minutes a gripper: test/world asks the same for one
    "old_news",  # beside a load, for minutes: test/world/test_old_news.py asks the same in simulated time
    "first_time", "public_urdfs",  # ask an index of packages, for minutes: test/robot/test_published_urdfs.py has one file a kind
    "case", "figures", "filled_arm", "results", "softness_kernels",  # no benchmarks
}  # fmt: skip
SHORTER: dict[str, dict[str, float]] = {
    "block_until": {"FIXED_AT_MOST": 2, "BLOCKS": 1}, "container_until": {"FIXED_AT_MOST": 2}, "until_sure": {"FIXED_AT_MOST": 2},
    "contents": {"FINER": 0.6}, "running": {"EMPTY_S": 12.0, "PART_S": 4.0},
}  # fmt: skip
"""What a benchmark states of itself: pushes to compare with, blocks a robot squeezes, how fine the second grid is, how
long a working day's parts last."""
NEEDS = {
    "distorted": "recordings_real",
    "mistakes": "recordings",
    "real": "recordings_real",
    "simulated": "recordings",
}


def test_every_benchmark_has_a_small_form() -> None:
    names = {
        path.stem
        for path in Path(__file__).parent.glob("*.py")
        if not path.stem.startswith("test_")
    }
    assert names == SMALL.keys() | ELSEWHERE


def ran(
    name: str,
    words: tuple[str, ...],
    file: Path,
) -> dict[str, Any]:
    """What a benchmark keeps."""
    importlib.import_module(name).main([*words, "--json", str(file)])
    kept: dict[str, Any] = json.loads(file.read_text())
    assert (
        kept["command"].startswith(f"python test/benchmarks/{name}.py {words[0]}")
        and str(file) not in kept["command"]
    )
    return kept


@pytest.mark.long
@pytest.mark.parametrize("name", SMALL)
def test_a_benchmark_runs(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("mujoco")
    from support import hand

    # a benchmark has another; the tests after it have their own again
    monkeypatch.setattr(hand, "RATE_HZ", hand.RATE_HZ)
    for constant, value in SHORTER.get(name, {}).items():
        monkeypatch.setattr(importlib.import_module(name), constant, value)
    if name in NEEDS and not (SHARED / NEEDS[name]).is_dir():
        pytest.skip(f"needs {SHARED / NEEDS[name]}")
    kept = ran(name, SMALL[name], tmp_path / f"{name}.json")
    assert any(table["rows"] for table in kept["tables"].values())
    for table in kept["tables"].values():
        assert len(markdown(table).splitlines()) == 2 + len(table["rows"])


@pytest.mark.long
@pytest.mark.parametrize(
    "part",
    ["mujoco", "scipy", "substeps", "c", "calibrated", "container", "fresh", "plan", "softness"],
)
def test_a_part_of_the_comparison_runs(part: str, tmp_path: Path) -> None:
    """To its last row; goals of time may be missed on a busy computer, and are no matter here."""
    pytest.importorskip("mujoco")
    kept = ran("run", (part, "--once"), tmp_path / "run.json")
    assert len(kept["tables"]["ours"]["rows"]) == 2 and kept["tables"][part]["rows"]
    assert not [row for row in kept["tables"][part]["rows"] if row["ratio"] == "void"]


@pytest.mark.long
def test_answers_are_compared(tmp_path: Path) -> None:
    from answers import compare, write

    folder = tmp_path / "bags"
    folder.mkdir()
    name = "quantised_s00_fixed_heavy_ball_50g_joint3"
    shutil.copytree(REPOSITORY / "bags" / name, folder / name)
    for number in (1, 2):
        write(tmp_path / f"{number}.json", [folder])
    assert len(json.loads((tmp_path / "1.json").read_text())) == 1
    assert compare(tmp_path / "1.json", tmp_path / "2.json", numbers=False) == 0


@pytest.mark.long
def test_a_simulated_arm_s_step_is_judged(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    from random_arm import main

    main(robots=1)
    assert "a stuck joint creeps" in capsys.readouterr().out


@pytest.mark.long
def test_episodes_are_made_and_judged(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("pyarrow")
    import batch

    folder = tmp_path / "episodes"
    batch.main(["make", str(folder), "--episodes", "4", "--jobs", "1"])
    assert batch.batch(
        folder,
        [str(folder / "data")],
        folder / "out",
        "--jobs",
        "1",
    ).wait() in (
        0,
        3,
    )
    batch.compare(folder, folder / "out", replayed=1)
    assert "1 of them by `replay` one by one: 0 differ in any bit" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["real", "answers"])
def test_a_benchmark_starts_by_itself(name: str) -> None:
    """Without what pytest puts on the path."""
    script = REPOSITORY / "test" / "benchmarks" / f"{name}.py"
    done = subprocess.run(
        [sys.executable, script, "--help"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_fits_on_a_card_go_as_far_as_those_of_a_weighing() -> None:
    """The benchmark runs where the package is not installed, and has their rules written down."""
    assert rules() == gpu.RULES
