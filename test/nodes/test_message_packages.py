"""That the helper builds packages which really go over DDS: a message, a service and an action, between two processes."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from support import message_packages
from support.live import LATCHED, wait_for
from support.message_packages import build

pytestmark = pytest.mark.long

PACKAGE = {
    "package.xml": '<package format="3"><name>three_msgs</name><version>0.1.0</version><depend>std_msgs</depend></package>',
    "msg/Mass.msg": "std_msgs/Header header\nfloat64 mass  # kg\nfloat64[2] interval\nstring[] reasons\n",
    "srv/SetPayload.srv": "float32 mass\nfloat32[3] center_of_gravity\n---\nbool success\n",
    "action/Count.action": "int32 to\n---\nMass mass\n---\nfloat32 fraction\n",
}
SERVER = """
import rclpy
from rclpy.action import ActionServer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from three_msgs.action import Count
from three_msgs.msg import Mass
from three_msgs.srv import SetPayload

rclpy.init()
node = Node("server")

def set_payload(request, response):
    response.success = request.mass == 2.5 and list(request.center_of_gravity) == [0.5, 0.25, 0.125]
    return response

def count(goal):
    for each in range(goal.request.to):
        goal.publish_feedback(Count.Feedback(fraction=(each + 1) / goal.request.to))
    goal.succeed()
    return Count.Result(mass=Mass(mass=1.5, interval=[1.0, 2.0], reasons=["one", "two"]))

latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(Mass, "/mass", latched).publish(Mass(mass=float("nan"), reasons=["none"]))
services = node.create_service(SetPayload, "/set_payload", set_payload), ActionServer(node, Count, "/count", count)
rclpy.spin(node)
"""


@pytest.fixture
def environment(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[dict[str, str]]:
    """Of a process that has the package; this one has it, too."""
    for path, text in PACKAGE.items():
        (tmp_path / "three_msgs" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "three_msgs" / path).write_text(text)
    built = build(tmp_path / "three_msgs", tmp_path / "prefix")
    monkeypatch.syspath_prepend(str(tmp_path / "prefix" / "site-packages"))
    yield built
    for name in [name for name in sys.modules if name.split(".")[0] == "three_msgs"]:
        monkeypatch.delitem(sys.modules, name)


@dataclass
class Talk:
    """A client, and the server that it talks with over DDS in another process."""

    server: subprocess.Popen[bytes]
    node: Any
    executor: SingleThreadedExecutor

    def spun_until(self, ready: Callable[[], Any]) -> bool:
        """Whether it became so within a minute."""

        def once() -> bool:
            assert self.server.poll() is None, "the server has ended"
            self.executor.spin_once(timeout_sec=0.05)
            return bool(ready())

        return wait_for(once, 60.0)


@pytest.fixture
def talk(environment: dict[str, str]) -> Iterator[Talk]:
    server = subprocess.Popen(
        [sys.executable, "-c", SERVER],
        env=environment,
    )
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("client", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield Talk(server, node, executor)
    server.kill()
    server.wait()
    executor.shutdown(timeout_sec=1.0)
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_built_package_goes_over_dds(talk: Talk) -> None:
    kinds = {
        name: importlib.import_module(f"three_msgs.{name}") for name in ("msg", "srv", "action")
    }
    masses: list[Any] = []
    talk.node.create_subscription(
        kinds["msg"].Mass,
        "/mass",
        masses.append,
        LATCHED,
    )
    assert talk.spun_until(lambda: masses)
    assert masses[0].mass != masses[0].mass
    assert list(masses[0].reasons) == ["none"]

    payload = kinds["srv"].SetPayload
    client = talk.node.create_client(payload, "/set_payload")
    assert talk.spun_until(client.service_is_ready)
    answer = client.call_async(payload.Request(mass=2.5, center_of_gravity=[0.5, 0.25, 0.125]))
    assert talk.spun_until(answer.done)
    assert answer.result().success

    count = kinds["action"].Count
    heard: list[float] = []
    action = ActionClient(talk.node, count, "/count")
    assert talk.spun_until(action.server_is_ready)
    sent = action.send_goal_async(
        count.Goal(to=3), lambda message: heard.append(message.feedback.fraction)
    )
    assert talk.spun_until(sent.done)
    assert sent.result().accepted
    result = sent.result().get_result_async()
    assert talk.spun_until(result.done)
    mass = result.result().result.mass
    assert (mass.mass, list(mass.interval), list(mass.reasons)) == (
        1.5,
        [1.0, 2.0],
        ["one", "two"],
    )


def test_what_does_not_compile_is_said(tmp_path: Path) -> None:
    (tmp_path / "bad_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "bad_msgs" / "package.xml").write_text(
        PACKAGE["package.xml"].replace("three", "bad")
    )
    (tmp_path / "bad_msgs" / "msg" / "Bad.msg").write_text("no_such_msgs/Thing thing\n")
    with pytest.raises(RuntimeError, match=r"(?s)bad_msgs.*no_such_msgs"):
        build(tmp_path / "bad_msgs", tmp_path / "prefix")


def test_without_a_compiler_it_skips_and_fails_in_the_gate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_packages.shutil, "which", lambda name: None)
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match=r"g\+\+"):
        build(tmp_path, tmp_path / "prefix")
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match=r"g\+\+"):
        build(tmp_path, tmp_path / "prefix")
