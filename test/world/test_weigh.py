"""Weighing while the arm works: nobody excites anything, the arm moves from pose to pose under its servos' position controllers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from support.listening import replayed_alike
from support.recording_bag import write_recording
from support.simulated_live import Client, running
from support.virtual_pick_and_place import HIGHEST, LOWEST

from proprio_ros.nodes.messages import labelled, time_ns, values_of
from proprio_ros.nodes.qos import COMMANDS, LATCHED
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.request import Options
from proprio_ros.records import JointRecord, Recording
from proprio_ros.robot import load_robot
from proprio_ros.virtual.truth import Truth

pytestmark = pytest.mark.long

JOINTS = ("joint1", "joint2", "joint3", "joint4")
HIGH = HIGHEST - np.array([0.0, 0.25, 0.3, 0.3])
"""The driver keeps the hand above the table."""
LATEST_S = 20.0


class Work:
    """Moves the arm from pose to pose until it is told to stop."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._clock = client.clock
        self._ended = self._clock.event()
        self._thread = self._clock.thread(
            self._move,
            "work",
            group="work",
        )
        self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        self._thread.join(5.0)

    def _move(self) -> None:
        rng = np.random.default_rng(7)
        here = np.array([self._client.position(joint) for joint in JOINTS])
        while not self._ended.is_set():
            goal = rng.uniform(LOWEST, HIGH)
            takes_s = rng.uniform(0.9, 1.4)
            begun_s = self._clock.now()
            while not self._ended.is_set() and self._clock.now() < begun_s + takes_s + 0.3:
                share = min(
                    (self._clock.now() - begun_s) / takes_s,
                    1.0,
                )
                wanted = here + (goal - here) * (10 * share**3 - 15 * share**4 + 6 * share**5)
                self._client.positions.publish(
                    labelled(dict(zip(JOINTS, wanted.tolist(), strict=True)))
                )
                self._clock.sleep(0.01)
            here = goal


def bag_of(client: Client, path: Path) -> Path:
    """What `ros2 bag record /joint_states` would have kept."""
    states = list(client.states)
    names = tuple(states[0].name)
    recording = Recording(
        "empty",
        JointRecord(
            np.array([time_ns(state.header.stamp) for state in states]),
            names,
            np.array([state.position for state in states]),
            effort=np.array([state.effort for state in states]),
        ),
        None,
    )
    write_recording(path, recording)
    return path


def test_something_picked_up_while_the_arm_works_is_noticed_and_weighed(tmp_path: Path) -> None:
    robot = load_robot("open_manipulator_x")
    drawn = Truth.draw(robot, 3, links=True)
    # nobody has measured the torque constants, so a mass errs as they do: here they are what the file says
    joints = {
        name: replace(joint, torque_constant=robot.drive_trains[name].torque_constant.value)
        for name, joint in drawn.joints.items()
    }
    (tmp_path / "truth.json").write_text(replace(drawn, joints=joints).as_json())
    virtual: dict[str, Any] = {"truth": tmp_path / "truth.json"}
    with running(tmp_path, "virtual", "driver", virtual=virtual) as client:
        work = Work(client)
        try:
            client.clock.sleep(1.0)
            client.states.clear()
            client.clock.sleep(22.0)
            empty = bag_of(client, tmp_path / "empty")
            calibration = tmp_path / "motions.yaml"
            calibrated = calibrate_from_bags(
                [empty],
                {},
                Options(effort_unit="N.m"),
                calibration,
            )
            assert calibration.exists(), calibrated.reasons
            client.world.start(
                "identifier",
                {
                    "calibration": calibration,
                    "report": True,
                    "running": True,
                    "weigh_seconds": 12.0,
                    "gravity_effort_rate": 20.0,
                },
            )

            def newest() -> dict[str, str]:
                return next(
                    (told for told in reversed(client.estimates) if told.get("running") == "true"),
                    {},
                )

            def weighs(mass_kg: float) -> bool:
                return (
                    bool(client.masses)
                    and abs(client.masses[-1] - mass_kg) < 0.005
                    and newest()["changed"] == "false"
                )

            holding: list[bool] = []
            client.world.user.create_subscription(
                Bool, "/identifier/holding", lambda said: holding.append(said.data), LATCHED
            )
            assert client.wait_for(newest), client.log("identifier")
            assert client.wait_for(
                lambda: float(newest()["seconds_of_motion"]) > 3.0 and weighs(0.0), LATEST_S
            ), newest()
            begun = len(client.estimates)
            assert client.set("/virtual", "object", "0.05").successful
            picked_s = client.clock.now()
            assert client.wait_for(
                lambda: any(told.get("changed") == "true" for told in client.estimates[begun:]),
                LATEST_S,
            ), newest()
            assert client.wait_for(lambda: weighs(0.05), LATEST_S), newest()
            assert holding == [False, True] and newest()["holding"] == "true", newest()
            efforts: list[JointState] = []
            capabilities: list[dict[str, str]] = []
            client.world.user.create_subscription(
                JointState, "/identifier/gravity_effort", efforts.append, COMMANDS
            )
            client.world.user.create_subscription(
                DiagnosticStatus,
                "/identifier/capability",
                lambda said: capabilities.append(values_of(said)),
                COMMANDS,
            )
            asks = client.world.user.create_publisher(JointState, "/identifier/carry_to", COMMANDS)
            assert client.wait_for(lambda: len(efforts) > 3 and bool(capabilities)), client.log(
                "identifier"
            )
            assert capabilities[-1]["can_carry"] == "true"
            assert list(efforts[-1].name) == list(efforts[0].name)
            asks.publish(JointState(name=["joint2"], position=[1.4]))
            assert client.wait_for(lambda: capabilities[-1]["where"] == "to the goal"), capabilities
            assert float(capabilities[-1]["most"]) > 0.05 and capabilities[-1]["joint"] in JOINTS, (
                capabilities[-1]
            )
            asks.publish(JointState(name=["elbow"], position=[1.4]))
            assert client.wait_for(lambda: capabilities[-1]["can_carry"] == "unknown"), capabilities
            client.clock.sleep(max(0.0, 14.0 - (client.clock.now() - picked_s)))
            answer = client.call("/identifier/weigh")
            assert answer.success, answer.message
            live = replayed_alike(
                Path(answer.message.split("recording: ")[1]).parent / "estimate.json"
            )
            told = live["estimates"][0]
            assert abs(told["value"] - 0.05) < 0.005, told
            begun = len(client.estimates)
            assert client.set("/virtual", "object", "none").successful
            assert client.wait_for(
                lambda: any(told.get("changed") == "true" for told in client.estimates[begun:]),
                LATEST_S,
            ), newest()
            assert client.wait_for(lambda: weighs(0.0), LATEST_S), newest()
            # the service began anew, and found what it is asked for
            assert (
                holding == [False, True, False] and float(newest()["holding.probability"]) < 0.01
            ), newest()
        finally:
            work.stop()
        rests = len(client.estimates)
        assert client.wait_for(
            lambda: len(client.estimates) > rests + 15 and float(newest()["seconds_at_rest"]) > 0.5
        )
        kept = newest()["payload_mass"]
        client.clock.sleep(1.0)
        assert newest()["payload_mass"] == kept, "an arm at rest keeps its answer"
