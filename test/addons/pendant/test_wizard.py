"""The wizard in a real browser, on a virtual arm with its nodes: who closes the page, reloads it or stops leaves the arm held."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.browser import BROWSER
from support.live import Client, running, wait_for
from support.pendant import Shown, pendant
from support.pushes import AWAY, one_push
from support.tab import Browser, Tab, browser

from proprio_ros.nodes.domains import free_domain

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(BROWSER is None, reason="needs Chromium"),
]
MOVES = 0.02  # rad/s; slower is encoders
LONG_S = 600.0
PUSH_A = 0.01
PUSH_S = 20.0
"""Longer than anybody may be silent, and less than the base's friction, so that no limit ends it before."""
PATIENT: dict[str, dict[str, Any]] = {
    "driver": {"reply_timeout": 0.1, "command_timeout": 0.5},
    "excitation": {"stale_after": 4.0},
}
"""Nobody here may take a late message for silence."""


class Desk:
    """A pendant with its virtual arm, a browser, and somebody else who listens to the arm."""

    def __init__(self, shown: Shown, window: Browser, client: Client) -> None:
        self.shown = shown
        self.window = window
        self.client = client

    def wizard(self, title: str) -> Tab:
        """A tab with what is asked for a task."""
        tab = self.window.tab()
        # not by the page of the arm, which draws in three dimensions on a processor here
        tab.open(self.shown.address.replace("/?", "/wizard?"))
        tab.click(title)
        tab.until(
            f"[...document.querySelectorAll('[role=heading]')].some((it) => it.innerText === '{title}')"
        )
        return tab

    def begin(self, tab: Tab) -> None:
        """Confirm, and wait until the arm is pushed."""
        tab.click("Start")
        tab.shows("Keep away from it")
        tab.click("Begin")
        assert wait_for(lambda: self.client.excitation.get("phase") == "probe", LONG_S)

    def is_held(self) -> bool:
        """Whether nothing is under way, and the arm stands under torque."""
        states = self.client.states
        states.clear()
        assert wait_for(lambda: len(states) > 2)
        still = max(map(abs, states[-1].velocity)) < MOVES
        idle = self.client.excitation["busy"] == "false"
        held = all(status.message == "held" for status in self.client.diagnostics[-1].status)
        return still and idle and held


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    folder = tmp_path_factory.mktemp("desk")
    domain = free_domain()
    push = folder / "push.yaml"
    push.write_text(one_push(PUSH_A, PUSH_S, AWAY, "joint1"))
    identifier = {"payload_sequence": str(push)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", domain)
        with (
            running(folder, identifier=identifier, **PATIENT) as (_, arm),
            pendant(folder, ROS_DOMAIN_ID=domain) as shown,
            browser(folder) as window,
        ):
            yield Desk(shown, window, arm)


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
    leaves(tab)
    other.until("!!document.querySelector('.verdict.bad')")
    assert wait_for(desk.is_held)
    statuses = [status.message for status in desk.client.statuses]
    assert any("cancelled" in words or "abort" in words for words in statuses[-8:]), statuses[-8:]
    assert "the browser that held the arm is silent" in desk.shown.told or leaves is presses_space
    other.close()


def test_who_looks_elsewhere_meanwhile_goes_on(desk: Desk) -> None:
    """The other pages are the same page of the browser, which goes on holding the arm."""
    silent = desk.shown.told.count("is silent")
    tab = desk.wizard("Weigh an object")
    desk.begin(tab)
    tab.click("Recordings")
    tab.click("Wizard")
    tab.shows("You hold the arm")
    tab.shows("identifying")  # the whole push was made
    assert desk.shown.told.count("is silent") == silent
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
