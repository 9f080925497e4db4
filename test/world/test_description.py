"""The robot comes from /robot_description: waited for, refused where it is none, used, and not exchanged under way."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from support.arm_in_motion import FOUR, Twin, write_robot
from support.listening import HEARD, LATCHED, replayed_alike
from support.simulated_live import Client
from support.simulated_world import world

from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.nodes.messages import joint_state, values_of
from proprio_ros.pipeline.calibrate import write_calibration
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import load_robot

pytestmark = pytest.mark.long

HELD_KG = 0.1


class Arm:
    """Publishes a motion as joint states, at its pace: effort is current."""

    def __init__(self, client: Client, motion: Motion) -> None:
        self._publisher = client.node.create_publisher(JointState, "/arm/joint_states", 100)
        self._motion = motion
        self._clock = client.clock
        self._stamp = client.node.get_clock().now().nanoseconds
        self._ended = self._clock.event()
        self._thread = self._clock.thread(
            self._play,
            "arm",
            group="arm",
        )
        self._thread.start()

    def _play(self) -> None:
        motion = self._motion
        begun_s = self._clock.now()
        begun_ns = self._stamp
        for at_s, position, current in zip(
            motion.times_s, motion.position, motion.current_A, strict=True
        ):
            if self._ended.wait(max(0.0, begun_s + at_s - self._clock.now())):
                return
            stamp_ns = begun_ns + round(1e9 * at_s)
            self._publisher.publish(
                joint_state(
                    stamp_ns,
                    motion.joints,
                    position,
                    [],
                    current,
                )
            )

    def stop(self) -> None:
        self._ended.set()
        self._thread.join(5.0)


class Described:
    """An identifier that learns its robot from a topic, and what it says.

    Attributes:
        told: What it was doing, and its words, status by status.
        estimates: As they were published.
    """

    def __init__(self, client: Client, urdf: str) -> None:
        self.client = client
        self.urdf = urdf
        self.told: list[tuple[str, str]] = []
        self.estimates: list[dict[str, str]] = []
        listen = client.node.create_subscription
        listen(DiagnosticStatus, "/arm/identifier/status", self._on_status, HEARD)
        listen(DiagnosticArray, "/arm/identifier/estimate", self._on_estimate, HEARD)
        self._publisher = client.node.create_publisher(String, "/arm/robot_description", LATCHED)

    def _on_status(self, message: DiagnosticStatus) -> None:
        self.told.append((values_of(message)["doing"], message.message))

    def _on_estimate(self, message: DiagnosticArray) -> None:
        self.estimates.append(values_of(message.status[0]))

    def describe(self, urdf: str) -> None:
        """Publishes a description."""
        self._publisher.publish(String(data=urdf))

    def says(self, words: str) -> bool:
        """Whether it does, sooner or later."""
        return self.client.wait_for(lambda: any(words in message for _, message in list(self.told)))

    def is_ready(self, words: str = "ready") -> bool:
        """Whether it comes to say so."""
        return self.client.wait_for(lambda: self.told[-1][1].startswith(words))

    def weigh(self) -> Any:
        """The service's answer."""
        return self.client.call("/arm/identifier/weigh")


def test_the_robot_is_that_of_the_topic(tmp_path: Path) -> None:
    robot = load_robot(write_robot(tmp_path, build=FOUR))
    twin = Twin(5, FOUR)
    learnt = fit_empty(
        robot,
        [twin.record(f"empty {number}", 20.0) for number in range(2)],
    )
    calibration = tmp_path / "motions.yaml"
    write_calibration(calibration, robot, learnt)
    held = twin.record("held", 180.0, (HELD_KG, [0.0, 0.0, 0.0]))
    with world(tmp_path / "data", only=()) as made:
        parameters = {
            "robot": "robot_description", "report": True, "calibration": calibration, "effort_unit": "A",
            "weigh_seconds": 12.0, "running": True,
        }  # fmt: skip
        made.start("identifier", parameters, namespace="arm")
        identifier = Described(Client(made), (tmp_path / "twin.urdf").read_text())
        check_waited_for(identifier)
        with moved(identifier, held):
            check_weighed(identifier)
        # a driver that measures nothing: what stood is withdrawn, and why is said
        assert identifier.says(
            "the running estimate waits: no joint states of the arm are coming"
        ), identifier.told
        with moved(identifier, replace(held, current_A=np.full_like(held.current_A, np.nan))):
            assert identifier.says("the joint states carry no measured effort of j1, j2, j3, j4"), (
                identifier.told
            )
        with moved(identifier, held):
            assert identifier.is_ready("ready; the running estimate"), identifier.told
            check_not_exchanged(identifier)


@contextmanager
def moved(identifier: Described, motion: Motion) -> Iterator[None]:
    """The arm reports a motion meanwhile."""
    arm = Arm(identifier.client, motion)
    try:
        yield
    finally:
        arm.stop()


def check_waited_for(identifier: Described) -> None:
    """Nothing is weighed before there is a robot, and what is no description is none."""
    client = identifier.client
    told = identifier.told
    assert client.wait_for(lambda: bool(told)), client.log("identifier")
    assert identifier.says("waits for /arm/robot_description"), told
    answer = identifier.weigh()
    assert not answer.success
    assert "not ready: waits for /arm/robot_description" in answer.message
    identifier.describe("no description")
    assert identifier.says("not XML"), told
    assert told[-1][0] == "starting"
    assert "waits for another" in told[-1][1]
    identifier.describe(identifier.urdf)
    assert identifier.is_ready(), (told, client.log("identifier"))


def check_weighed(identifier: Described) -> None:
    """The running estimate and the service weigh, and a replay of the recording says the same."""
    client = identifier.client
    assert client.wait_for(
        lambda: any(each.get("running") == "true" for each in list(identifier.estimates))
    ), identifier.told
    client.clock.sleep(13.0)
    answer = identifier.weigh()
    assert answer.success, answer.message
    live = replayed_alike(Path(answer.message.split("recording: ")[1]).parent / "estimate.json")
    value = live["estimates"][0]
    low, high = value["ci95"]
    assert abs(value["value"] - HELD_KG) < 0.02, value
    assert low < HELD_KG < high, value


def check_not_exchanged(identifier: Described) -> None:
    """Another robot on the topic ends all estimates, until the first one is there again."""
    client = identifier.client
    identifier.describe(identifier.urdf.replace('mass value="', 'mass value="1'))
    assert identifier.says("/arm/robot_description has changed"), identifier.told
    client.clock.sleep(2.0)
    count = len(identifier.estimates)
    answer = identifier.weigh()
    assert not answer.success, answer.message
    assert "has changed" in answer.message
    client.clock.sleep(1.0)
    assert len(identifier.estimates) == count, (
        "nothing is estimated with a model that holds no more"
    )
    identifier.describe(identifier.urdf)
    assert identifier.says("the robot is that of /arm/robot_description"), identifier.told
    assert client.wait_for(lambda: len(identifier.estimates) > count), "it goes on"
