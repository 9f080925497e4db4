"""What a node prints waits for nobody; a wiring test, of which no time is asserted."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("rclpy")

LOGS = """
import os, threading
from rclpy.logging import get_logger
from proprio_ros.nodes.printing import without_waiting

def runs(go):
    go.wait()
    os.write(1, b"all threads are run\\n")

go = threading.Event()
other = threading.Thread(target=runs, args=(go,), daemon=True)
other.start()
with without_waiting():
    logger = get_logger("speaks")
    for _ in range(6000):
        logger.warning("x" * 400)
    go.set()
    other.join()
    os.write(1, b"it goes on\\n")
    input()
    logger.warning("the last words")
"""


def test_whoever_logs_does_not_wait_for_a_terminal_that_stands_still() -> None:
    """2.4 MB into a pipe that nobody reads, which takes 64 kB: without the thread the first of it would never be done."""
    process = subprocess.Popen(
        [sys.executable, "-c", LOGS],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == b"all threads are run\n"
        assert process.stdout.readline() == b"it goes on\n"
        _, printed = process.communicate(b"\n", timeout=60)
        assert printed.count(b"x" * 400) > 100, "what was kept comes when somebody reads"
        assert process.returncode == 0
    finally:
        process.kill()
