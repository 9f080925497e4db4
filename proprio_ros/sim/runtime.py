"""One quiet start of Warp, shared by every kernel."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import warp as wp

FLOAT = wp.float64
"""All rollouts run in double precision: on a CPU float32 is no faster, and its gradients are off by up to 0.1 %."""


def start() -> None:
    """Initialise Warp without its banner; safe to call again."""
    wp.config.log_level = wp.LOG_WARNING
    with nullcontext() if _has_cuda_driver() else _native_stderr_closed():
        wp.init()


def _has_cuda_driver() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


@contextmanager
def _native_stderr_closed() -> Iterator[None]:
    """Warp's native code writes to stderr that there is no GPU, every time, and no setting of Warp's silences it.

    A robot PC has none, and it is no problem, so nothing should say so in front of every answer.
    """
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (OSError, ValueError, AttributeError):  # no stderr to silence
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(nowhere)
        os.close(kept)
