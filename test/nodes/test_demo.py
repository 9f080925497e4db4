"""`proprio demo` as a user starts it, ended at any moment; no process stays behind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).parent))

from live import wait_for

ENDS_WITHIN_S = 15.0


def start(folder: Path, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "proprio_ros.cli", "demo", "--output", str(folder), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def processes(folder: Path) -> list[int]:
    """Processes of ours whose command line, environment or open log names this folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            words = (entry / "cmdline").read_bytes()
            log = os.readlink(entry / "fd" / "1")
        except OSError:
            continue
        if b"proprio_ros" in words and (str(folder).encode() in words or log.startswith(str(folder))):
            found.append(int(entry.name))
    return found


def test_the_demo_weighs_an_object_and_leaves_nothing_behind(tmp_path: Path) -> None:
    started = time.monotonic()
    demo = start(tmp_path / "demo", "--mass", "0.03", "--seed", "7")
    output, progress = demo.communicate(timeout=150.0)
    elapsed_s = time.monotonic() - started
    assert demo.returncode == 0, output + progress
    match = re.search(r"payload ([\d.]+) g, 95 % interval ([\d.]+) \.\. ([\d.]+) g", output)
    assert match, output
    mass, low, high = (float(number) for number in match.groups())
    assert abs(mass - 30.0) < 2.0 and high - low < 8.0
    assert "the virtual hand held 30.0 g" in output
    report = re.search(r"^report: (.*)$", output, re.MULTILINE)
    assert report and Path(report.group(1)).read_text().startswith("<!")
    assert "live," in progress and "weighs itself" in progress
    assert "Traceback" not in progress + "".join(log.read_text() for log in (tmp_path / "demo" / "logs").iterdir())
    assert processes(tmp_path) == []
    assert elapsed_s < 60.0


@pytest.mark.parametrize(
    "moment",
    ["driver.log", "held where they are", "moving to the start pose", "is pushed with", "now something is in its hand"],
)
def test_ctrl_c_at_any_moment_leaves_no_process_behind(tmp_path: Path, moment: str) -> None:
    folder = tmp_path / "demo"
    demo = start(folder)
    seen: list[str] = []
    assert demo.stderr is not None
    if moment == "driver.log":  # while the nodes still import
        assert wait_for((folder / "logs" / "driver.log").exists, 30.0)
    elif moment == "held where they are":
        log = folder / "logs" / "driver.log"
        assert wait_for(lambda: log.exists() and moment in log.read_text(), 60.0)
    else:
        for line in demo.stderr:
            seen.append(line)
            if moment in line:
                break
    assert len(processes(folder)) >= (1 if moment == "driver.log" else 4), "".join(seen)
    demo.send_signal(signal.SIGINT)
    told = time.monotonic()
    _, rest = demo.communicate(timeout=ENDS_WITHIN_S)
    assert demo.returncode == 130, "".join(seen) + rest
    assert time.monotonic() - told < ENDS_WITHIN_S
    assert "Traceback" not in "".join(seen) + rest
    assert processes(folder) == []


def test_a_demo_that_is_killed_leaves_no_process_behind(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    demo = start(folder)
    log = folder / "logs" / "driver.log"
    assert wait_for(lambda: log.exists() and "held where they are" in log.read_text(), 60.0)
    assert len(processes(folder)) >= 4
    demo.kill()
    demo.communicate()
    assert wait_for(lambda: processes(folder) == [], ENDS_WITHIN_S), (
        "the kernel tells the nodes that their parent is gone"
    )


def test_a_mass_that_cannot_be_in_kg_is_refused() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "proprio_ros.cli", "demo", "--mass", "50"], capture_output=True, text=True, timeout=30
    )
    assert run.returncode == 2 and "masses are in kg" in run.stderr and "Traceback" not in run.stderr
