"""`proprio demo` as a user starts it: what it shows, and that nothing is left behind, however it ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.domains import free_domain
from support.marked import MARK, alive
from support.waiting import wait_for

from proprio_ros.cli.terminal import EXIT_NO_ANSWER, EXIT_OK

pytestmark = pytest.mark.long

LONGEST_S = 3600.0
"""A new machine compiles kernels first, and others may use it; a demo that has ended is noticed at once."""
END_S = 60.0
"""Nodes end one after the other, each within a second on an idle computer."""


@dataclass
class Demo:
    """One demo, and the mark that its processes carry in their environment."""

    process: subprocess.Popen[bytes]
    folder: Path
    mark: str

    @property
    def told(self) -> str:
        return (self.folder / "stderr").read_text()

    @property
    def result(self) -> str:
        return (self.folder / "stdout").read_text()

    def alive(self) -> dict[int, str]:
        """Processes of this demo that are still there, with their command lines."""
        return alive(self.mark)


def start(folder: Path, *more: str) -> Demo:
    folder.mkdir()
    mark = uuid.uuid4().hex
    # demos that run side by side must not hear each other
    environment = {
        **os.environ,
        MARK: mark,
        "ROS_DOMAIN_ID": free_domain(),
    }
    words = [
        sys.executable,
        "-m",
        "proprio_ros.cli",
        "demo",
        "--output",
        str(folder / "demo"),
        *more,
    ]
    with (folder / "stdout").open("wb") as stdout, (folder / "stderr").open("wb") as stderr:
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr, env=environment
        )
    return Demo(process, folder, mark)


def comes(
    demo: Demo,
    ready: Callable[[], object],
) -> bool:
    """Whether the demo gets there before it ends."""
    return wait_for(lambda: ready() or demo.process.poll() is not None, LONGEST_S) and bool(ready())


def end(demo: Demo) -> None:
    """Whatever a test that failed has left behind."""
    for process in demo.alive():
        os.kill(process, signal.SIGKILL)
    demo.process.wait(END_S)


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[Demo]:
    """One at a time: each moves an arm in real time."""
    demo = start(tmp_path / "demo")
    yield demo
    end(demo)


def assert_interrupted(demo: Demo) -> None:
    assert demo.alive()
    demo.process.send_signal(signal.SIGINT)
    assert demo.process.wait(END_S) == 130, demo.told
    assert demo.told.splitlines()[-1] == "proprio: interrupted"
    assert "Traceback" not in demo.told
    assert not demo.alive(), "it waits for its nodes before it goes"
    logs = [log.read_text() for log in (demo.folder / "demo" / "logs").glob("*.log")]
    assert not any("Traceback" in log for log in logs), logs


@pytest.mark.parametrize("after_s", [0.0, 3.0])
def test_interrupted_at_any_time(demo: Demo, after_s: float) -> None:
    # before that Python itself is still starting, and interrupting it is nobody's affair
    assert comes(demo, (demo.folder / "demo").exists), demo.told
    assert not wait_for(lambda: demo.process.poll() is not None, after_s), demo.told
    assert_interrupted(demo)


def test_killed(demo: Demo) -> None:
    assert comes(demo, lambda: len(demo.alive()) >= 5 and "run 1 of" in demo.told), demo.told
    demo.process.kill()
    demo.process.wait(END_S)
    assert wait_for(lambda: not demo.alive(), END_S), demo.alive()


def test_interrupted_while_a_joint_is_pushed(demo: Demo) -> None:
    assert comes(demo, lambda: re.search(r"robot: .* is pushed", demo.told)), demo.told
    assert_interrupted(demo)
    assert list((demo.folder / "demo").glob("*_robot/bag")), "what was recorded is kept"


def test_what_it_shows(demo: Demo) -> None:
    """Of each probe, and how near to the truth: test/world/test_demo.py."""
    assert demo.process.wait(LONGEST_S) in (EXIT_OK, EXIT_NO_ANSWER), demo.result + demo.told
    assert not demo.alive()
    told = [
        "are starting",
        "itself: with nothing in its hand",
        "run 1 of",
        "robot calibrated on",
        "done; the nodes are ending",
    ]
    places = [demo.told.find(words) for words in told]
    assert -1 not in places and places == sorted(places), demo.told
    if demo.process.returncode == EXIT_OK:
        assert re.search(r"payload ([\d.]+) g, 95 % interval", demo.result)
        assert "the virtual hand held" in demo.result
        report = re.search(r"report: (.+)", demo.result)
        assert report
        assert "<svg" in Path(report[1]).read_text()


def test_on_a_new_computer_it_shows_what_it_waits_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "cache"))
    demo = start(tmp_path / "demo")
    try:
        # to the last one: test_start.py
        assert comes(
            demo, lambda: re.search(r"proprio: starting: compiling \d+ of 8 kernels, ", demo.told)
        ), demo.told
        assert_interrupted(demo)
    finally:
        end(demo)
