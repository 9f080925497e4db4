"""The pendant's own node: small questions to nodes that have only just begun."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from support.domains import free_domain
from support.live import UP_S

from proprio_ros.addons.pendant import listener
from proprio_ros.addons.pendant.news import News

LATER_S = 0.5


@contextmanager
def begins_later(answers_after_s: float) -> Iterator[None]:
    """An identifier that comes up after a while, and answers after another."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor(context=context)
    ended = threading.Event()

    def live() -> None:
        ended.wait(LATER_S)
        node = Node("identifier", context=context)
        node.declare_parameter("robot", "an_arm")
        ended.wait(answers_after_s)
        executor.add_node(node)
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.05)
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize("answers_after_s", [0.0, 1.0])
def test_a_node_that_has_just_begun_is_waited_for(
    answers_after_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that answers when it has been asked several times."""
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    # whoever waits longer on a busy computer waits for nothing
    monkeypatch.setattr(listener, "ANSWER_S", UP_S)
    monkeypatch.setattr(listener, "AGAIN_S", 0.1)
    heard = listener.Listener(News(), "")
    try:
        with begins_later(answers_after_s):
            assert heard.parameters("robot") == {"robot": "an_arm"}
    finally:
        heard.close()


def test_nobody_answers_where_nobody_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    monkeypatch.setattr(listener, "ANSWER_S", 0.1)
    heard = listener.Listener(News(), "")
    try:
        assert heard.parameters("robot") is None
        assert "start the nodes" in heard.state({"robot": "an_arm"})
        assert heard.stop() == []
    finally:
        heard.close()
