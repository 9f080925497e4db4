"""What takes long when nodes start is waited for as long as they say how far they are; what cannot start says why in a line."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.domains import free_domain
from support.live import running, wait_for

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.graph import Graph, Patience
from proprio_ros.nodes.messages import values_of


def test_patience_ends_with_silence_and_not_with_time(tmp_path: Path) -> None:
    now = 0.0
    graph = Graph(tmp_path)
    log = tmp_path / "identifier.log"
    patience = Patience(10.0, lambda: now)
    for number in range(100):
        now += 9.0
        with log.open("a") as file:
            file.write(f"compiling {number} of 100\n")
        assert not patience.is_over(graph.said())
    now += 10.0
    assert not patience.is_over(graph.said())
    now += 0.1
    assert patience.is_over(graph.said())


@pytest.mark.long
def test_the_identifier_says_what_it_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    empty = {"WARP_CACHE_PATH": str(tmp_path / "cache")}
    # a pendulum's friction does not rise towards standstill, which saves three kernels
    with running(
        tmp_path,
        "identifier",
        environment=empty,
        identifier={"robot": "pendulum"},
    ) as (
        graph,
        client,
    ):
        log = graph.log("identifier")
        assert all(f"compiling {number} of 5" in log for number in range(1, 6)), log
        assert wait_for(lambda: values_of(client.statuses[-1])["doing"] == "idle")
        told = [
            status.message for status in client.statuses if values_of(status)["doing"] == "starting"
        ]
        assert told
        assert told[-1].startswith("compiling 5 of 5")


@pytest.mark.long
def test_an_identifier_that_can_keep_no_kernels_ends_with_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    (tmp_path / "file").touch()
    with Graph(
        tmp_path / "logs",
        {"WARP_CACHE_PATH": str(tmp_path / "file" / "cache")},
    ) as graph:
        process = graph.start("identifier", {"data_directory": tmp_path, "calibration": "none"})
        assert process.wait(3600.0) == 2
        with pytest.raises(
            ConfigurationError, match=r"identifier node has ended: .*set WARP_CACHE_PATH"
        ):
            graph.check()
        assert "Traceback" not in graph.log("identifier")
