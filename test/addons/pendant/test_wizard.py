"""The wizard in a real browser, on a virtual arm with its nodes: who closes the page, reloads it or stops leaves the arm held."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.browser import BROWSER
from support.live import wait_for
from support.pendant import LONG_S, Desk, at_the_arm
from support.pushes import AWAY, one_push
from support.tab import Tab

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(BROWSER is None, reason="needs Chromium"),
]
SILENT = "the browser that held the arm is silent"
PUSH_A = 0.01
PUSH_S = 20.0
"""Longer than anybody may be silent, and less than the base's friction, so that no limit ends it before."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    folder = tmp_path_factory.mktemp("desk")
    push = folder / "push.yaml"
    push.write_text(one_push(PUSH_A, PUSH_S, AWAY, "joint1"))
    with at_the_arm(folder, payload_sequence=str(push)) as desk:
        yield desk


def closes(tab: Tab) -> None:
    tab.close()


def reloads(tab: Tab) -> None:
    tab.call("Page.reload")


def loses_the_network(tab: Tab) -> None:
    tab.does("window.socket.io.engine.close(), window.socket.connect = () => {}, true")
    tab.call(
        "Network.emulateNetworkConditions",
        offline=True,
        latency=0,
        downloadThroughput=0,
        uploadThroughput=0,
    )


def presses_space(tab: Tab) -> None:
    tab.press(" ", "Space", " ")
    tab.click("Give up")
    tab.shows("Nobody holds the arm")
    tab.close()


@pytest.mark.parametrize("leaves", [closes, reloads, loses_the_network, presses_space])
def test_whoever_leaves_in_mid_probe_leaves_the_arm_held(
    desk: Desk, leaves: Callable[[Tab], Any]
) -> None:
    other = desk.wizard("Weigh an object")
    tab = desk.wizard("Weigh an object")
    desk.begin(tab)
    other.shows("Another browser holds the arm")
    other.click("Start")
    other.shows("another browser holds the arm; it is free when")
    other.until("!document.querySelector('.verdict')")  # that of the call before
    before = len(desk.client.statuses)
    silent = desk.shown.told.count(SILENT)
    leaves(tab)
    other.until("!!document.querySelector('.verdict.bad')")
    assert wait_for(desk.is_held)
    statuses = [status.message for status in desk.client.statuses[before:]]
    assert any("cancelled" in words or "abort" in words for words in statuses), statuses
    assert desk.shown.told.count(SILENT) == silent + (leaves is not presses_space)
    other.close()


def test_who_looks_elsewhere_meanwhile_goes_on(desk: Desk) -> None:
    """The other pages are the same page of the browser, which goes on holding the arm."""
    silent = desk.shown.told.count(SILENT)
    stopped = desk.shown.told.count("stopped")
    tab = desk.wizard("Weigh an object")
    desk.begin(tab)
    tab.until("!document.querySelector('.verdict')")  # that of the call before
    tab.click("Recordings")
    tab.click("Wizard")
    tab.shows("You hold the arm")
    assert wait_for(lambda: tab.does("!!document.querySelector('.verdict')"), LONG_S)
    assert desk.shown.told.count(SILENT) == silent
    assert desk.shown.told.count("stopped") == stopped, "the whole push was made"
    assert wait_for(desk.is_held)
    presses_space(tab)


def test_a_number_that_is_none_is_said_before_anything_moves(desk: Desk) -> None:
    tab = desk.wizard("Weigh an object")
    tab.does("document.querySelector('input').focus()")
    for letter in "abc":
        tab.press(letter, f"Key{letter.upper()}", letter)
    tab.click("Start")
    tab.shows("write three numbers in mm")
    assert desk.client.excitation["busy"] == "false"
    tab.close()
