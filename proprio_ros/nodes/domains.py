"""ROS domains in which nobody is heard on this computer: for a demo, and for tests, which must not command others' nodes."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from pathlib import Path

from proprio_ros.errors import ConfigurationError

_FIRST_PORT = 7400
_PORTS = 250
"""Of domain 0, and of each: DDS Interoperability Wire Protocol (RTPS) 2.2, 9.6.1.1."""
DOMAINS = range(1, 102)
"""Those whose ports are not among the ones that Linux hands out for short: 32768 and up."""

LISTEN_S = 1.5
"""Whoever uses DDS answers a newcomer at once, and says again every 3 s that it is there."""
_LOOK_S = 0.05
_NAMES_S = 0.3  # between the first node's name and the others'
_SEARCHES = 20

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


def unused_domain() -> str:
    """A free domain in which no node is heard either, such as one in a container or on another computer.

    Raises:
        ConfigurationError: There is none.
    """
    for _ in range(_SEARCHES):
        domain = free_domain()
        if not heard_in(domain):
            return domain
    raise ConfigurationError(
        "nodes are heard in every ROS domain that was tried: end them, or set ROS_DOMAIN_ID"
    )


def heard_in(domain: str) -> list[str]:
    """Full names of nodes that are heard in a domain.

    Raises:
        ConfigurationError: Nobody can be heard, with the middleware's words.
    """
    command = [sys.executable, "-m", "proprio_ros.nodes.domains", str(LISTEN_S)]
    # a session of its own: Ctrl-C is for whoever asks, and the listener ends soon by itself
    listener = subprocess.run(
        command,
        env={**os.environ, "ROS_DOMAIN_ID": domain},
        capture_output=True,
        text=True,
        start_new_session=True,
    )
    if listener.returncode:
        words = listener.stderr.strip().splitlines() or ["without a word"]
        raise ConfigurationError(f"cannot listen in ROS domain {domain}: {words[-1]}")
    return listener.stdout.split()


def _listen(listen_s: float) -> list[str]:
    """In a process of its own, which has its own middleware: the nodes that are heard."""
    import rclpy

    from proprio_ros.nodes import middleware

    middleware.prepare()
    rclpy.init(args=[])
    node = rclpy.create_node(f"listens_{os.getpid()}", enable_rosout=False)
    ends_s = time.monotonic() + listen_s
    names: list[str] = []
    while time.monotonic() < ends_s:
        time.sleep(_LOOK_S)
        heard = node.get_node_names_and_namespaces()
        others = [f"{space.rstrip('/')}/{name}" for name, space in heard if name != node.get_name()]
        if others and not names:
            ends_s = time.monotonic() + _NAMES_S
        names = others
    rclpy.shutdown()
    return names


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


if __name__ == "__main__":
    sys.stdout.write(" ".join(_listen(float(sys.argv[1]))))
