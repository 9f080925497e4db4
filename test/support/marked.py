"""Processes that carry a mark in their environment: what is left of a program that starts others."""

from __future__ import annotations

from pathlib import Path

MARK = "PROPRIO_TEST_MARK"


def alive(mark: str) -> dict[int, str]:
    """Those that are still there, by number, with their command lines."""
    found = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (process / "environ").read_bytes():
                words = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                found[int(process.name)] = words
        except OSError:  # it has ended meanwhile
            continue
    return found
