"""ROS domains for tests: one that no other test session on this computer uses."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_FIRST_PORT, _PORTS = 7400, 250
"""Of domain 0, and of each: DDS Interoperability Wire Protocol (RTPS) 2.2, 9.6.1.1."""

_claims: list[socket.socket] = []
"""A name in Linux' abstract namespace is one process's until it ends: sessions that look at the same time choose differently."""


def free_domain() -> str:
    """A domain in which nobody listens just now, and that is given to nobody else until it is given back, or this process ends."""
    rows = [
        row.split()
        for name in ("udp", "udp6")
        for row in Path("/proc/net", name).read_text().splitlines()[1:]
    ]
    used = {(int(row[1].split(":")[1], 16) - _FIRST_PORT) // _PORTS for row in rows}
    free = [domain for domain in range(1, 102) if domain not in used]
    for domain in random.SystemRandom().sample(free, len(free)):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0proprio_ros test domain {domain}")
        except OSError:
            claim.close()
            continue
        _claims.append(claim)
        return str(domain)
    raise RuntimeError("no ROS domain is free")


@contextmanager
def given_back() -> Iterator[None]:
    """Those taken meanwhile are free again afterwards: there are 101, and three sessions at once used them up."""
    before = len(_claims)
    yield
    while len(_claims) > before:
        _claims.pop().close()
