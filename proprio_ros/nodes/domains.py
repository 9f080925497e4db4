"""ROS domains in which nobody is heard on this computer: for a demo, and for tests, which must not command others' nodes."""

from __future__ import annotations

import random
import socket
from pathlib import Path

from proprio_ros.errors import ConfigurationError

_FIRST_PORT = 7400
_PORTS = 250
"""Of domain 0, and of each: DDS Interoperability Wire Protocol (RTPS) 2.2, 9.6.1.1."""
DOMAINS = range(1, 102)
"""Those whose ports are not among the ones that Linux hands out for short: 32768 and up."""

_claims: list[socket.socket] = []
"""A name in Linux' abstract namespace is one process's until it ends: those that look at the same time choose differently."""


def free_domain() -> str:
    """A domain in which nobody listens just now, and that nobody else is given until it is given back, or this process ends.

    Raises:
        ConfigurationError: There is none.
    """
    used = _used()
    free = [domain for domain in DOMAINS if domain not in used]
    for domain in random.SystemRandom().sample(free, len(free)):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0proprio_ros domain {domain}")
        except OSError:
            claim.close()
            continue
        _claims.append(claim)
        return str(domain)
    raise ConfigurationError(
        "no ROS domain is free on this computer: end other nodes, or set ROS_DOMAIN_ID"
    )


def claimed() -> int:
    """How many domains this process was given."""
    return len(_claims)


def give_back(but: int = 0) -> None:
    """Give back all domains that this process was given but the first ones."""
    while len(_claims) > but:
        _claims.pop().close()


def _used() -> set[int]:
    """Domains in which somebody listens, by the ports that are open."""
    tables = [Path("/proc/net", name) for name in ("udp", "udp6")]
    rows = [
        row.split()
        for table in tables
        if table.exists()
        for row in table.read_text(encoding="ascii").splitlines()[1:]
    ]
    return {(int(row[1].rpartition(":")[2], 16) - _FIRST_PORT) // _PORTS for row in rows}
