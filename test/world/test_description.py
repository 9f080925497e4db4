"""The robot comes from /robot_description: waited for, refused where it is none, used, and not exchanged under way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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


def test_the_robot_is_that_of_the_topic(tmp_path: Path) -> None:
    robot = load_robot(write_robot(tmp_path, build=FOUR))
    twin = Twin(5, FOUR)
    learnt = fit_empty(
        robot,
        [twin.record(f"empty {number}", 20.0) for number in range(2)],
    )
    calibration = tmp_path / "motions.yaml"
    write_calibration(calibration, robot, learnt)
    held = twin.record(
        "held",
        180.0,
        (HELD_KG, [0.0, 0.0, 0.0]),
    )
    text = (tmp_path / "twin.urdf").read_text()
    with world(tmp_path / "data", only=()) as made:
        parameters = {
            "robot": "robot_description", "report": True, "calibration": calibration, "effort_unit": "A",
            "weigh_seconds": 12.0, "running": True,
        }  # fmt: skip
        made.start("identifier", parameters, namespace="arm")
        client = Client(made)
        told: list[tuple[str, str]] = []
        listen = client.node.create_subscription

        def on_status(message: DiagnosticStatus) -> None:
            told.append((values_of(message)["doing"], message.message))

        estimates: list[dict[str, str]] = []
        listen(DiagnosticStatus, "/arm/identifier/status", on_status, HEARD)
        listen(
            DiagnosticArray,
            "/arm/identifier/estimate",
            lambda m: estimates.append(values_of(m.status[0])),
            HEARD,
        )
        publisher = client.node.create_publisher(String, "/arm/robot_description", LATCHED)

        def says(words: str) -> bool:
            return client.wait_for(lambda: any(words in message for _, message in list(told)))

        arm = None
        try:
            assert client.wait_for(lambda: bool(told)), client.log("identifier")
            assert says("waits for /arm/robot_description"), told
            answer = client.call("/arm/identifier/weigh")
            assert not answer.success
            assert "not ready: waits for /arm/robot_description" in answer.message
            publisher.publish(String(data="no description"))
            assert says("not XML"), told
            assert told[-1][0] == "starting"
            assert "waits for another" in told[-1][1]
            publisher.publish(String(data=text))
            assert client.wait_for(lambda: told[-1][1].startswith("ready")), (
                told,
                client.log("identifier"),
            )
            arm = Arm(client, held)
            assert client.wait_for(
                lambda: any(each.get("running") == "true" for each in list(estimates))
            ), told
            client.clock.sleep(13.0)
            answer = client.call("/arm/identifier/weigh")
            assert answer.success, answer.message
            live = replayed_alike(
                Path(answer.message.split("recording: ")[1]).parent / "estimate.json"
            )
            value = live["estimates"][0]
            low, high = value["ci95"]
            assert abs(value["value"] - HELD_KG) < 0.02 and low < HELD_KG < high, value

            # a driver that measures nothing: what stood is withdrawn, and why is said
            arm.stop()
            assert says("the running estimate waits: no joint states of the arm are coming"), told
            silent = replace(
                held,
                current_A=np.full_like(held.current_A, np.nan),
            )
            arm = Arm(client, silent)
            assert says("the joint states carry no measured effort of j1, j2, j3, j4"), told
            arm.stop()
            arm = Arm(client, held)
            assert client.wait_for(lambda: told[-1][1].startswith("ready; the running estimate")), (
                told
            )

            publisher.publish(String(data=text.replace('mass value="', 'mass value="1')))
            assert says("/arm/robot_description has changed"), told
            client.clock.sleep(2.0)
            count = len(estimates)
            answer = client.call("/arm/identifier/weigh")
            assert not answer.success and "has changed" in answer.message, answer.message
            client.clock.sleep(1.0)
            assert len(estimates) == count, "nothing is estimated with a model that holds no more"
            publisher.publish(String(data=text))
            assert says("the robot is that of /arm/robot_description"), told
            assert client.wait_for(lambda: len(estimates) > count), "it goes on"
        finally:
            if arm is not None:
                arm.stop()
