"""`~/apply` with the real services of ur_msgs, franka_msgs and xarm_msgs: built here by their published definitions."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger
from support.domains import free_domain
from support.message_packages import build
from support.waiting import SOON_S

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.live.payload_export import CONTROLLERS
from proprio_ros.live.session import live_request
from proprio_ros.nodes import identifier
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.base import Carried

pytestmark = pytest.mark.long

BAGS = Path(__file__).resolve().parents[2] / "bags"
MANIFEST = """<package format="3"><name>{name}</name><version>1.0.0</version><description>d</description>
<maintainer email="a@b.cc">m</maintainer><license>BSD</license><depend>geometry_msgs</depend></package>"""
SERVICES = {
    "ur_msgs": (
        "SetPayload",
        "float32 mass\ngeometry_msgs/Vector3 center_of_gravity\n---\nbool success\n",
    ),
    "franka_msgs": (
        "SetLoad",
        "float64 mass\nfloat64[3] center_of_mass\nfloat64[9] load_inertia\n---\nbool success\nstring error\n",
    ),
    "xarm_msgs": (
        "SetTcpLoad",
        "float32 weight\nfloat32[] center_of_gravity\n---\nint32 ret\nstring message\n",
    ),
}
LOAD = Carried(
    0.5,
    [0.01, 0.02, 0.03],
    np.diag([1e-3, 2e-3, 3e-3]),
)


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """The three services, by package."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        for package, (name, text) in SERVICES.items():
            folder = tmp_path_factory.mktemp(package)
            source = folder / package
            prefix = folder / "prefix"
            (source / "srv").mkdir(parents=True)
            (source / "package.xml").write_text(MANIFEST.format(name=package))
            (source / "srv" / f"{name}.srv").write_text(text)
            build(source, prefix)
            patch.syspath_prepend(str(prefix / "site-packages"))
            found[package] = getattr(importlib.import_module(f"{package}.srv"), name)
        yield found
    for name in [name for name in sys.modules if name.split(".")[0] in SERVICES]:
        del sys.modules[name]


def test_what_is_told_fits_the_makers_messages(kinds: dict[str, Any]) -> None:
    requests = {
        name: kinds[controller.package].Request() for name, controller in CONTROLLERS.items()
    }
    for name, controller in CONTROLLERS.items():
        controller.fill(requests[name], LOAD)
    assert requests["ur"].mass == 0.5
    assert requests["ur"].center_of_gravity.z == 0.03
    np.testing.assert_allclose(
        requests["franka"].load_inertia, [1e-3, 0, 0, 0, 2e-3, 0, 0, 0, 3e-3]
    )
    np.testing.assert_allclose(
        requests["xarm"].center_of_gravity,
        [10.0, 20.0, 30.0],
        rtol=1e-6,
    )
    for name, controller in CONTROLLERS.items():
        # a response as it comes by default: the first two have not taken it, and code 0 is taken
        assert bool(controller.refusal(kinds[controller.package].Response())) == (name != "xarm")


@dataclass
class Stage:
    """The identifier, and a controller that hears, all in this process.

    Attributes:
        node: the identifier.
        heard: what the controller was told.
        success: what it answers.
    """

    node: Any
    client: Any
    executor: Any
    heard: list[Any] = field(default_factory=list)
    success: bool = True

    def apply(self) -> tuple[bool, str]:
        future = self.client.call_async(Trigger.Request())
        self.executor.spin_until_future_complete(future, SOON_S)
        assert future.done(), "no answer"
        return bool(future.result().success), str(future.result().message)


@pytest.fixture
def stage(
    kinds: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Stage]:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    # nothing is identified by the node
    monkeypatch.setattr(identifier, "prepare_identification", lambda *given: None)
    words = {
        "data_directory": tmp_path,
        "hand_on": "ur",
        "hand_on_link": "link5",
        "hand_on_tool": "0.2, 0.0, 0.0, 0.05",
    }
    context = rclpy.Context()
    arguments = [word for name, value in words.items() for word in ("-p", f"{name}:={value}")]
    rclpy.init(args=["--ros-args", *arguments], context=context)
    node = identifier.IdentifierNode(context=context)
    node.configure()
    other = rclpy.create_node("controller", context=context, use_global_arguments=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    executor.add_node(other)
    staged = Stage(
        node,
        other.create_client(Trigger, "/identifier/apply"),
        executor,
    )

    def set_payload(request: Any, response: Any) -> Any:
        staged.heard.append(request)
        response.success = staged.success
        return response

    assert staged.client.wait_for_service(SOON_S)
    staged.serve = lambda: other.create_service(  # type: ignore[attr-defined]
        kinds["ur_msgs"], "/io_and_status_controller/set_payload", set_payload
    )
    yield staged
    executor.shutdown(timeout_sec=1.0)
    node.destroy_node()
    other.destroy_node()
    context.try_shutdown()


def test_an_accepted_load_is_handed_on_when_asked_and_nothing_else_ever(
    stage: Stage, tmp_path: Path
) -> None:
    success, said = stage.apply()
    assert not success
    assert "no accepted answer stands" in said
    # bags of this repository, an arm that weighed itself and a cube
    stated = {
        "payload.com": [0.0, 0.0, 0.0],
        "payload.shape": "cube",
        "payload.size": 0.03,
    }
    empty = [
        bag
        for joint in (2, 3)
        for bag in sorted(BAGS.glob(f"realistic_s00_empty_*_joint{joint}/bag*"))
    ]
    learnt = calibrate_from_bags(
        empty,
        {},
        Options(),
        tmp_path / "arm.yaml",
    )
    assert learnt.verdict is Verdict.ACCEPTED, learnt.reasons
    options = Options(
        probe="payload",
        calibration=tmp_path / "arm.yaml",
        settings=stated,
    )
    setting = live_request(options)
    estimate = replay(BAGS / "realistic_s00_fixed_heavy_cube_23g_joint3" / "bag_mcap", options)
    assert estimate.verdict is Verdict.ACCEPTED, estimate.reasons
    stage.node.results.publish(setting, estimate)
    success, said = stage.apply()
    assert not success
    assert "/io_and_status_controller/set_payload is not there" in said
    stage.serve()  # type: ignore[attr-defined]
    success, said = stage.apply()
    assert success, said
    mass = estimate.values[0].value
    (request,) = stage.heard
    assert request.mass == pytest.approx(mass + 0.2, rel=1e-6)
    grasp = setting.robot.model.frame_transform(
        "end_effector_link", dict.fromkeys(setting.robot.model.independent_joints, 0.0)
    )
    flange = setting.robot.model.frame_transform(
        "link5", dict.fromkeys(setting.robot.model.independent_joints, 0.0)
    )
    away = np.linalg.solve(flange, grasp)[:3, 3]
    told = request.center_of_gravity
    np.testing.assert_allclose(
        [told.x, told.y, told.z],
        (mass * away + 0.2 * np.array([0.0, 0.0, 0.05])) / (mass + 0.2),
        atol=1e-9,
    )
    assert "with the tool" in said
    assert "95 % interval" in said
    stage.success = False
    success, said = stage.apply()
    assert not success
    assert "refused" in said
    # a refusal in its place stands for nothing
    stage.success = True
    stage.node.results.withdraw()
    assert not stage.apply()[0]
    assert len(stage.heard) == 2


def test_without_its_messages_or_its_tool_a_controller_is_refused_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    monkeypatch.setattr(identifier, "prepare_identification", lambda *given: None)
    monkeypatch.setitem(sys.modules, "franka_msgs", None)  # as if nobody had built it
    monkeypatch.setitem(sys.modules, "franka_msgs.srv", None)
    cases = {
        "hand_on:=kuka": "choose one of none, ur, franka, xarm",
        "hand_on:=ur": "wants to know all that hangs at its flange",
        "hand_on:=franka": "the messages of franka_msgs are not there",
    }
    for word, said in cases.items():
        context = rclpy.Context()
        rclpy.init(
            args=["--ros-args", "-p", f"data_directory:={tmp_path}", "-p", word], context=context
        )
        node = identifier.IdentifierNode(context=context)
        try:
            with pytest.raises(ConfigurationError, match=said):
                node.configure()
        finally:
            node.destroy_node()
            context.try_shutdown()
