"""ROS domains for tests: one that no other test session on this computer uses, nor anybody else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from proprio_ros.nodes import domains
from proprio_ros.nodes.domains import free_domain, unused_domain

__all__ = ["free_domain", "given_back", "unused_domain"]


@contextmanager
def given_back() -> Iterator[None]:
    """Those taken meanwhile are free again afterwards: there are 101, and three sessions at once used them up."""
    before = domains.claimed()
    yield
    domains.give_back(before)
