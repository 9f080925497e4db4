"""Who can find the nodes: programs on this computer, and others only where the user says so."""

from __future__ import annotations

import os

import pytest

pytest.importorskip("rclpy")

from proprio_ros.nodes import middleware

SET_BY_THE_USER = [
    {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
    {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"},
    {"ROS_STATIC_PEERS": "192.168.1.7"},
    {"ROS_LOCALHOST_ONLY": "0"},
    {"CYCLONEDDS_URI": "file:///etc/cyclone.xml"},
    {"FASTRTPS_DEFAULT_PROFILES_FILE": "/etc/fastdds.xml"},
]


@pytest.fixture(autouse=True)
def nothing_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*middleware.RANGE_SET_BY, "FASTDDS_BUILTIN_TRANSPORTS"):
        monkeypatch.setenv(name, "")  # so that what a test makes of it is undone
        monkeypatch.delenv(name)


def test_by_default_nobody_on_the_network_finds_a_node() -> None:
    middleware.stay_on_this_machine()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    middleware.leave_shared_memory()
    assert os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"].endswith("localhost_udp.xml")


@pytest.mark.parametrize("environment", SET_BY_THE_USER)
def test_what_the_user_has_set_counts(
    environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    middleware.stay_on_this_machine()
    assert {
        name: os.environ[name] for name in middleware.RANGE_SET_BY if name in os.environ
    } == environment


def test_peers_that_are_stated_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """rmw reads them with this range only, not with the one that our own profile needs."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_STATIC_PEERS", "192.168.1.7")
    middleware.stay_on_this_machine()
    middleware.leave_shared_memory()
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in os.environ
