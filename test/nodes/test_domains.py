"""Whether a ROS domain is in use is heard before it is taken; a wiring test, of which no time is asserted."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy")

import rclpy
from support.domains import free_domain, given_back

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes import demo, domains
from proprio_ros.nodes import live as live_nodes


@pytest.fixture
def used(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A domain with a driver in it, and one that hears it, however busy the computer is."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(domains, "LISTEN_S", 60.0)
    with given_back():
        domain = free_domain()
        context = rclpy.Context()
        context.init(domain_id=int(domain))
        node = rclpy.create_node("driver", namespace="arm", context=context)
        yield domain
        node.destroy_node()
        context.try_shutdown()


def test_another_program_is_heard(used: str) -> None:
    assert domains.heard_in(used) == ["/arm/driver"]


def test_nobody_is_heard_where_nobody_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(domains, "LISTEN_S", 0.5)
    with given_back():
        assert domains.heard_in(free_domain()) == []


def test_a_domain_in_which_somebody_is_heard_is_not_taken(
    used: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who is on another computer has no port open on this one."""
    drawn = iter([used, "77"])
    heard = {used: ["/arm/driver"], "77": []}
    monkeypatch.setattr(domains, "free_domain", lambda: next(drawn))
    monkeypatch.setattr(domains, "heard_in", heard.get)
    assert domains.unused_domain() == "77"


def test_the_demo_does_not_begin_beside_others(used: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", used)
    words = f"ROS_DOMAIN_ID={used}: others are found there \\(/arm/driver\\): leave it out"
    with pytest.raises(ConfigurationError, match=words):
        demo._domain()


def test_a_virtual_arm_does_not_begin_beside_nodes_of_its_names(
    used: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", used)
    nodes = ["virtual", "driver"]
    words = f"^/arm/driver run in ROS domain {used} already: end them, or state ROS_DOMAIN_ID="
    with pytest.raises(ConfigurationError, match=words):
        live_nodes._refuse_a_mixture(nodes, "arm")
    live_nodes._refuse_a_mixture(nodes, "another_arm")
