"""ROS domains for tests: one that no other test session on this computer uses."""

from __future__ import annotations

import random
from pathlib import Path

_FIRST_PORT, _PORTS = 7400, 250
"""Of domain 0, and of each: DDS Interoperability Wire Protocol (RTPS) 2.2, 9.6.1.1."""

_given: set[int] = set()


def free_domain() -> str:
    """A domain in which nobody listens just now, and that was not given before."""
    rows = [row.split() for name in ("udp", "udp6") for row in Path("/proc/net", name).read_text().splitlines()[1:]]
    used = {(int(row[1].split(":")[1], 16) - _FIRST_PORT) // _PORTS for row in rows}
    domain = random.SystemRandom().choice([domain for domain in range(1, 102) if domain not in used | _given])
    _given.add(domain)
    return str(domain)
