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
                smooth = 10 * share**3 - 15 * share**4 + 6 * share**5
                wanted = here + (goal - here) * smooth
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


def write_truth(path: Path) -> None:
    """Of an arm whose torque constants are what the file says: nobody has measured them, and a mass errs as they do."""
    robot = load_robot("open_manipulator_x")
    drawn = Truth.draw(robot, 3, links=True)
    joints = {
        name: replace(joint, torque_constant=robot.drive_trains[name].torque_constant.value)
        for name, joint in drawn.joints.items()
    }
    path.write_text(replace(drawn, joints=joints).as_json())


def calibrate(client: Client, folder: Path) -> Path:
    """By 22 s of work with an empty hand."""
    client.clock.sleep(1.0)
    client.states.clear()
    client.clock.sleep(22.0)
    calibration = folder / "motions.yaml"
    calibrated = calibrate_from_bags(
        [bag_of(client, folder / "empty")],
        {},
        Options(effort_unit="N.m"),
        calibration,
    )
    assert calibration.exists(), calibrated.reasons
    return calibration


class Listener:
    """What the identifier says of the load while the arm works."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.holding: list[bool] = []
        client.world.user.create_subscription(
            Bool, "/identifier/holding", lambda said: self.holding.append(said.data), LATCHED
        )

    def newest(self) -> dict[str, str]:
        for told in reversed(self.client.estimates):
            if told.get("running") == "true":
                return told
        return {}

    def weighs(self, mass_kg: float) -> bool:
        masses = self.client.masses
        near = bool(masses) and abs(masses[-1] - mass_kg) < 0.005
        return near and self.newest()["changed"] == "false"

    def await_first(self) -> None:
        """An empty hand, by a few seconds of motion."""
        client = self.client
        assert client.wait_for(self.newest), client.log("identifier")

        def weighed() -> bool:
            moved_s = float(self.newest()["seconds_of_motion"])
            return moved_s > 3.0 and self.weighs(0.0)

        assert client.wait_for(weighed, LATEST_S), self.newest()

    def await_change(self, held: str, mass_kg: float) -> None:
        """The hand holds something else: a change is said, and then what is held."""
        client = self.client
        begun = len(client.estimates)
        assert client.set("/virtual", "object", held).successful

        def changed() -> bool:
            return any(told.get("changed") == "true" for told in client.estimates[begun:])

        assert client.wait_for(changed, LATEST_S), self.newest()
        assert client.wait_for(lambda: self.weighs(mass_kg), LATEST_S), self.newest()


def check_what_it_can_carry(client: Client) -> None:
    """Gravity's efforts with the load, and whether a pose can be reached with it."""
    efforts: list[JointState] = []
    capabilities: list[dict[str, str]] = []
    user = client.world.user
    user.create_subscription(JointState, "/identifier/gravity_effort", efforts.append, COMMANDS)
    user.create_subscription(
        DiagnosticStatus,
        "/identifier/capability",
        lambda said: capabilities.append(values_of(said)),
        COMMANDS,
    )
    asks = user.create_publisher(JointState, "/identifier/carry_to", COMMANDS)
    assert client.wait_for(lambda: len(efforts) > 3 and bool(capabilities)), client.log(
        "identifier"
    )
    assert capabilities[-1]["can_carry"] == "true"
    assert list(efforts[-1].name) == list(efforts[0].name)
    asks.publish(JointState(name=["joint2"], position=[1.4]))
    assert client.wait_for(lambda: capabilities[-1]["where"] == "to the goal"), capabilities
    to_the_goal = capabilities[-1]
    assert float(to_the_goal["most"]) > 0.05, to_the_goal
    assert to_the_goal["joint"] in JOINTS, to_the_goal
    asks.publish(JointState(name=["elbow"], position=[1.4]))
    assert client.wait_for(lambda: capabilities[-1]["can_carry"] == "unknown"), capabilities


def check_the_service(client: Client) -> None:
    """It weighs by the last seconds, as a replay of what it recorded does."""
    answer = client.call("/identifier/weigh")
    assert answer.success, answer.message
    recording = Path(answer.message.split("recording: ")[1])
    live = replayed_alike(recording.parent / "estimate.json")
    told = live["estimates"][0]
    assert abs(told["value"] - 0.05) < 0.005, told


def test_something_picked_up_while_the_arm_works_is_noticed_and_weighed(tmp_path: Path) -> None:
    write_truth(tmp_path / "truth.json")
    virtual: dict[str, Any] = {"truth": tmp_path / "truth.json"}
    with running(tmp_path, "virtual", "driver", virtual=virtual) as client:
        work = Work(client)
        try:
            identifier = {
                "calibration": calibrate(client, tmp_path),
                "report": True,
                "running": True,
                "weigh_seconds": 12.0,
                "gravity_effort_rate": 20.0,
            }
            client.world.start("identifier", identifier)
            heard = Listener(client)
            heard.await_first()
            picked_s = client.clock.now()
            heard.await_change("0.05", 0.05)
            assert heard.holding == [False, True]
            assert heard.newest()["holding"] == "true"
            check_what_it_can_carry(client)
            client.clock.sleep(max(0.0, 14.0 - (client.clock.now() - picked_s)))
            check_the_service(client)
            # the service began anew, and found what it is asked for
            heard.await_change("none", 0.0)
            assert heard.holding == [False, True, False]
            assert float(heard.newest()["holding.probability"]) < 0.01
        finally:
            work.stop()
        rests = len(client.estimates)
        assert client.wait_for(
            lambda: (
                len(client.estimates) > rests + 15
                and float(heard.newest()["seconds_at_rest"]) > 0.5
            )
        )
        kept = heard.newest()["payload_mass"]
        client.clock.sleep(1.0)
        assert heard.newest()["payload_mass"] == kept, "an arm at rest keeps its answer"
