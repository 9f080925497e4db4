"""What a node prints waits for nobody: a terminal that stands still, or a disk that is busy, must not keep a driver from its bus.

rclpy keeps the interpreter's lock while it logs. Whoever logs into a pipe that nobody reads, or a terminal after Ctrl-S, keeps
all threads of its process from running, the one among them that feeds the servos' watchdogs.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import threading
from collections.abc import Iterator

STDERR = 2
KEPT_BYTES = 1 << 20
"""What nobody has read yet; what comes on top is lost."""
LAST_WORDS_S = 1.0
"""At the end so long is waited for whoever reads."""
_CHUNK = 1 << 16


@contextlib.contextmanager
def without_waiting() -> Iterator[None]:
    """Lead what this process prints as errors through a pipe that a thread of its own empties, outside the interpreter's lock."""
    if os.isatty(STDERR):
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    outside = os.dup(STDERR)
    end, beginning = os.pipe()
    with contextlib.suppress(OSError):  # a system may allow less
        fcntl.fcntl(beginning, fcntl.F_SETPIPE_SZ, KEPT_BYTES)
    os.set_blocking(beginning, False)
    os.dup2(beginning, STDERR)
    os.close(beginning)
    thread = threading.Thread(target=_pass_on, args=(end, outside), name="prints", daemon=True)
    thread.start()
    try:
        yield
    finally:
        # the pipe's last writer is gone with this, and the thread ends when it has passed on all
        os.dup2(outside, STDERR)
        thread.join(LAST_WORDS_S)


def _pass_on(end: int, outside: int) -> None:
    while words := os.read(end, _CHUNK):
        # nobody is there to read them any more
        with contextlib.suppress(OSError):
            while words:
                words = words[os.write(outside, words) :]
