"""Every call is answered within a stated time, with its cause, whoever is not run: the driver, or what computes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from diagnostic_msgs.msg import DiagnosticStatus
from support.listening import HEARD
from support.schedules import Side, standing

from proprio_ros.live.deadlines import CANCELLED_S, IDENTIFYING, LOOK_S, REPEAT_S

pytestmark = pytest.mark.long

WEIGH = "/identifier/calibrate_payload"
LONG_S = 1000.0


class Asked:
    """A call in a thread of its own, whose answer may be late."""

    def __init__(self, made: Any, service: str) -> None:
        self.answer: Any = None
        self.took_s = 0.0
        self._made = made
        self._service = service
        self._answered = made.clock.event()
        made.clock.thread(self._call, "asks", group="user").start()

    def _call(self) -> None:
        began_s = self._made.clock.now()
        self.answer = self._made.call(self._service, within_s=LONG_S)
        self.took_s = self._made.clock.now() - began_s
        self._answered.set()

    def wait(self) -> Any:
        assert self._answered.wait(LONG_S)
        assert self.answer is not None, "silent"
        return self.answer


class Arm:
    """That has been weighed once, with the phases and sentences that its nodes say."""

    def __init__(self, made: Any) -> None:
        self.made = made
        self.broken: list[str] = []
        self.side = Side(made, "", self.broken)
        self.said: list[str] = []
        listens = made.somebody("listens")
        listens.create_subscription(
            DiagnosticStatus, "/identifier/status", lambda it: self.said.append(it.message), HEARD
        )

    @property
    def machine(self) -> Any:
        return self.side.process("excitation").node._machine

    def until(self, phase: str) -> None:
        for _ in range(10_000):
            if self.machine.phase.value == phase:
                return
            self.made.clock.sleep(0.01)
        pytest.fail(f"no {phase}: {self.said[-3:]}")


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Arm]:
    with standing("weigh", tmp_path) as made:
        yield Arm(made)


def test_a_pause_of_the_bus_costs_a_second_try(arm: Arm) -> None:
    """Joint states stay away for longer than the machine waits: nothing is wrong with arm or object."""
    asked = Asked(arm.made, WEIGH)
    arm.until("approach")
    arm.made.clock.stall("driver", 1.6)
    answer = asked.wait()
    assert answer.success, answer.message
    assert any(said.startswith("once more: the probe was aborted: no new") for said in arm.said)
    assert not arm.broken


def test_a_driver_that_is_not_run_is_the_cause_that_is_answered(arm: Arm) -> None:
    asked = Asked(arm.made, WEIGH)
    arm.until("settle")
    arm.made.clock.stall("driver", 60.0)
    answer = asked.wait()
    assert not answer.success
    assert "no new joint positions" in answer.message
    assert "is the driver alive?" in answer.message
    assert asked.took_s < 20.0


def test_an_excitation_node_that_is_not_run_is_the_cause_that_is_answered(arm: Arm) -> None:
    asked = Asked(arm.made, WEIGH)
    arm.until("settle")
    arm.made.clock.stall("excitation", 60.0)
    answer = asked.wait()
    assert not answer.success
    assert "the excitation node has fallen silent" in answer.message
    assert asked.took_s < 20.0


def test_an_identification_that_does_not_end_is_given_up(arm: Arm) -> None:
    """It says all the time what it waits for, is answered in time, and what comes of it later counts no more."""
    made = arm.made
    node = arm.side.process("identifier").node
    goes_on = made.clock.event()
    write = node.jobs._keep

    def hang(keep: Any) -> None:
        goes_on.wait(LONG_S)
        write(keep)

    node.jobs._keep = hang
    asked = Asked(made, WEIGH)
    answer = asked.wait()
    assert not answer.success
    waited = f"for {IDENTIFYING.at_most_s:g} s it has waited for {IDENTIFYING.waits_for}"
    assert (
        answer.message
        == f"calibrate_payload is given up: {waited}; it is cancelled, and the arm held"
    )
    assert asked.took_s < IDENTIFYING.at_most_s + 2.0 * LOOK_S + 15.0, "the sequence takes 5 s"
    waits = [said for said in arm.said if said.startswith("waiting for the identification: ")]
    assert len(waits) >= IDENTIFYING.at_most_s / REPEAT_S - 2
    busy = made.call(WEIGH)
    assert not busy.success
    assert "was given up, and still waits for the identification" in busy.message
    cancelled = Asked(made, "/identifier/cancel")
    assert not cancelled.wait().success
    assert "has not ended within" in cancelled.answer.message
    assert cancelled.took_s < CANCELLED_S + 1.0
    goes_on.set()
    node.jobs._keep = write
    made.clock.sleep(1.0)
    answer = made.call(WEIGH)
    assert answer.success, answer.message
    assert not arm.broken
