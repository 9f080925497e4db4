"""Controllers are switched for a sequence and back after every end of it, by the service of ros2_control as it is published."""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

import rclpy
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from support.domains import free_domain
from support.live import Client, comes_up, running, wait_for
from support.message_packages import build

from proprio_ros.nodes import excitation
from proprio_ros.nodes.excitation import ExcitationNode
from proprio_ros.nodes.graph import Graph
from proprio_ros.nodes.switching import Controllers, SwitchedRuns, own_controller

pytestmark = pytest.mark.long

PACKAGE = "controller_manager_msgs"
MANIFEST = f"""<package format="3"><name>{PACKAGE}</name><version>1.0.0</version><description>d</description>
<maintainer email="a@b.cc">m</maintainer><license>BSD</license><depend>builtin_interfaces</depend></package>"""
SWITCH = """string[] activate_controllers
string[] deactivate_controllers
int32 strictness
int32 BEST_EFFORT=1
int32 STRICT=2
bool activate_asap
builtin_interfaces/Duration timeout
---
bool ok
string message
"""
OURS = "position_controller"
THEIRS = "joint_trajectory_controller"
ORDER = ["gripper", "elbow_flex", "shoulder_pan", "wrist_roll", "wrist_flex", "shoulder_lift"]
ARM: dict[str, Any] = {"robot": "so101", "controller_joints": ORDER}
PROBE = """
excitation:
  hand: any
  settle_s: 0.2
  brake_s: 0.1
  approach_velocity: 1.2
  runs:
    - {joint: elbow_flex, goal_step: -0.25, duration_s: %g, start: {shoulder_lift: -0.2}}
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimpleNamespace]:
    """The service's class, and the environment in which nodes find it."""
    folder = tmp_path_factory.mktemp(PACKAGE)
    source = folder / PACKAGE
    prefix = folder / "prefix"
    (source / "srv").mkdir(parents=True)
    (source / "package.xml").write_text(MANIFEST)
    (source / "srv" / "SwitchController.srv").write_text(SWITCH)
    environment = build(source, prefix)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(prefix / "site-packages"))
        yield SimpleNamespace(
            kind=importlib.import_module(f"{PACKAGE}.srv").SwitchController, environment=environment
        )
    for name in [name for name in sys.modules if name.split(".")[0] == PACKAGE]:
        del sys.modules[name]


class Manager:
    """In controller_manager's place: two controllers, of which one has the joints; strict."""

    def __init__(self, client: Client, kind: Any) -> None:
        self.active = THEIRS
        self.refuses = ""
        self.heard = list[Any]()
        client.node.create_service(kind, "/controller_manager/switch_controller", self._switch)

    def _switch(self, request: Any, response: Any) -> Any:
        self.heard.append(request)
        wanted = (list(request.activate_controllers), list(request.deactivate_controllers))
        possible = ([THEIRS], [OURS]) if self.active == OURS else ([OURS], [THEIRS])
        response.ok = not self.refuses and request.strictness == 2 and wanted == possible
        response.message = self.refuses or f"{self.active} is active"
        if response.ok:
            self.active = wanted[0][0]
        return response


@dataclass(frozen=True)
class Lent:
    """An arm whose joints another controller has, and which is lent for a sequence.

    Attributes:
        endless: A probe that ends only when somebody ends it.
    """

    graph: Graph
    client: Client
    manager: Manager
    endless: Path

    def sees_the_arm(self) -> bool:
        """Whether the excitation node hears joint states."""
        return self.client.excitation.get("joint_states") == "true"

    def run(self) -> None:
        """Starts a sequence, which takes the joints."""
        answer = self.client.call("/excitation/run")
        assert answer.success, answer.message
        assert self.manager.active == OURS

    def is_given_back(self, after: str) -> None:
        """Waits until the other controller has the joints again."""
        assert wait_for(lambda: self.manager.active == THEIRS), after


def test_every_end_of_a_sequence_gives_the_arm_back(
    built: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    short = tmp_path / "short.yaml"
    endless = tmp_path / "long.yaml"
    short.write_text(PROBE % 0.2)
    endless.write_text(PROBE % 30.0)
    virtual = {"interface": "position_controller", "state_rate": 50.0, **ARM}
    output = {
        "command_interface": "position", "probe": short, "controller_manager": "/controller_manager",
        "deactivate_controllers": [THEIRS], **ARM,
    }  # fmt: skip
    environment = {"PYTHONPATH": built.environment["PYTHONPATH"]}
    with running(
        tmp_path,
        "virtual",
        "excitation",
        environment=environment,
        virtual=virtual,
        excitation=output,
    ) as (graph, client):
        assert wait_for(lambda: client.excitation.get("joint_states") == "true")
        assert "controller_manager running?" in client.call("/excitation/run").message
        lent = Lent(graph, client, Manager(client, built.kind), endless)
        check_done(lent)
        check_refused(lent)
        check_aborted_and_released(lent)
        check_ended_by(lent, signal.SIGKILL)
        client.excitation.clear()
        graph.start("excitation", {**output, "probe": endless})
        assert comes_up(graph, lambda: client.excitation.get("phase") == "idle")
        check_ended_by(lent, signal.SIGINT)


def check_done(lent: Lent) -> None:
    """A sequence that comes to its end."""
    lent.run()
    assert lent.client.excitation["busy"] == "true"
    lent.client.wait_for_phase("done")
    lent.is_given_back("done")
    assert len(lent.manager.heard) == 2


def check_refused(lent: Lent) -> None:
    """A sequence that the controller manager does not switch for."""
    lent.manager.refuses = "a joint is on fire"
    answer = lent.client.call("/excitation/run")
    assert not answer.success
    assert "refused: a joint is on fire" in answer.message
    assert lent.client.excitation["phase"] == "done"
    assert lent.manager.active == THEIRS
    lent.manager.refuses = ""


def check_aborted_and_released(lent: Lent) -> None:
    """A sequence that is aborted, and one that is asked for while the arm is given back."""
    client = lent.client
    assert client.set("/excitation", "probe", str(lent.endless)).successful
    assert client.call("/excitation/run").success
    client.wait_for_phase("probe")
    client.call("/excitation/abort")
    # asked for while it is switched back: it waits for that
    assert client.call("/excitation/run").success
    assert lent.manager.active == OURS
    switched = [request.activate_controllers[0] for request in lent.manager.heard[-2:]]
    assert switched == [THEIRS, OURS]
    client.wait_for_phase("probe")
    assert THEIRS in client.call("/excitation/release").message
    lent.is_given_back("released")


def check_ended_by(lent: Lent, number: signal.Signals) -> None:
    """A sequence whose node is ended by a signal."""
    assert wait_for(lent.sees_the_arm)
    lent.run()
    lent.client.wait_for_phase("probe")
    node = lent.graph.processes["excitation"]
    node.send_signal(number)
    lent.is_given_back(number.name)
    node.wait(timeout=10.0)


def test_without_the_messages_the_node_says_so_and_works(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    monkeypatch.setitem(sys.modules, PACKAGE, None)
    monkeypatch.setitem(sys.modules, f"{PACKAGE}.srv", None)
    said: list[str] = []
    monkeypatch.setattr(
        ExcitationNode,
        "say",
        lambda self, severity, words: said.append(words),
    )
    monkeypatch.setattr(ExcitationNode, "urgent", False)
    watchdog = SimpleNamespace(
        alive=True,
        due=True,
        heard=True,
        close=lambda: None,
        clear=lambda: None,
        update=lambda _: None,
    )
    monkeypatch.setattr(excitation, "CommandWatchdog", lambda *_given: watchdog)
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    given = {"command_interface": "position", "controller_manager": "/controller_manager", **ARM}
    node: Any = ExcitationNode(
        context=context,
        parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
    )
    try:
        node.trigger_configure()
        node.trigger_activate()
        assert node.active
        assert [
            words for words in said if "controllers are not switched, for the messages of" in words
        ]
        response = node._on_run(Trigger.Request(), Trigger.Response())
        assert "no joint states" in response.message, "it works as without"
    finally:
        node.finish()
        node.destroy_node()
        rclpy.shutdown(context=context)


class Fake:
    """Node, switch, watchdog and output in one, which remember what they were asked for."""

    def __init__(self) -> None:
        self.done: list[str] = []
        self.engaged = self.pending = self.busy = self.switched = False
        self.controllers = Controllers("/controller_manager", OURS, (THEIRS,))
        self.then: Any = None

    def ask(self, engage: bool, then: Any) -> None:
        self.done.append("engage" if engage else "back")
        self.pending = self.switched = True
        self.then = then
        self.wanted = engage

    def answer(
        self,
        why: str = "",
        known: bool = True,
    ) -> None:
        self.pending = False
        self.switched = self.wanted != bool(why) if known else True
        self.then(why)

    def begin(self) -> None:
        self.done.append("hold")

    def hand_over(self) -> None:
        self.done.append("hand over")

    def refused(self) -> str:
        return ""

    def begin_run(self) -> tuple[bool, str]:
        self.busy = True
        return True, "begun"

    def say(self, severity: str, message: str) -> None:
        self.done.append(severity)


def staged() -> tuple[Fake, SwitchedRuns, list[tuple[bool, str]]]:
    fake = Fake()
    answers = list[tuple[bool, str]]()
    switch: Any = type("Switch", (), {
        "controllers": fake.controllers, "ask": staticmethod(fake.ask),
        "pending": property(lambda _: fake.pending), "engaged": property(lambda _: fake.switched),
    })()  # fmt: skip
    return fake, SwitchedRuns(fake, switch, fake, fake), answers


def test_the_arm_is_held_from_before_the_switch_until_it_is_switched_back() -> None:
    fake, runs, answers = staged()
    runs.run(lambda *given: answers.append(given))
    assert fake.done == ["hold", "engage"]
    assert fake.engaged
    assert not answers
    fake.answer()
    assert answers == [(True, "begun")]
    fake.busy = False
    runs.back()
    runs.back()
    assert fake.done == ["hold", "engage", "back"], "asked once"
    fake.answer("no such controller")
    assert fake.done[-1] == "error" and fake.engaged, "it goes on holding, and is spoken for"
    assert THEIRS in runs.release()
    fake.answer()
    assert fake.done[-4:] == ["error", "back", "info", "hand over"]
    assert not fake.engaged


def test_nothing_begins_where_the_switch_is_refused_and_one_that_is_not_answered_is_taken_back() -> (
    None
):
    fake, runs, answers = staged()
    runs.run(lambda *given: answers.append(given))
    fake.answer("refused")
    assert answers == [(False, "the controllers were not switched: refused")]
    assert fake.done == ["hold", "engage", "hand over"]
    assert not fake.busy
    runs.run(lambda *given: answers.append(given))
    fake.answer("no answer", known=False)
    assert fake.done[-1] == "back"
    assert fake.engaged
    assert not fake.busy


def test_a_controllers_name_is_that_of_its_topic() -> None:
    assert own_controller("/position_controller/commands") == "position_controller"
    assert own_controller("/left/forward_effort_controller/commands") == "forward_effort_controller"
    assert own_controller("commands") == ""
    assert Controllers("/cm", "a", ("b",)).service == "/cm/switch_controller"
