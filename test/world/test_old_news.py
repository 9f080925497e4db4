"""A running estimate on a computer that is too slow for it: what was is never said as what is."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from diagnostic_msgs.msg import DiagnosticStatus
from support.sensing_arm import SensingArm, write_sensing_arm
from support.simulated_live import Client
from support.simulated_world import world
from support.slow_computer import LOOKED_S, Digestion, Heard, Player, slow_computer

from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.live.news import WARNED_S, WITHDRAWN_S
from proprio_ros.pipeline.calibrate import write_calibration
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import load_robot

pytestmark = pytest.mark.long

RATE_HZ = 200.0
MASS_KG = 1.0
TAKEN_S = 6.0
LEFT_S = 18.0
ENDS_S = 30.0
KEEPS_UP_S = 0.15
"""A node that has nothing to do pauses for 20 ms after each callback, of which there are some."""


@dataclass(frozen=True)
class Arm:
    """Files of an arm, and half a minute in which it takes something and puts it down."""

    robot: Path
    calibration: Path
    motion: Motion


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Arm:
    folder = tmp_path_factory.mktemp("sensing")
    robot = write_sensing_arm(folder, 6, 212)
    made = SensingArm(folder, 6, 212, RATE_HZ)
    known = fit_empty(
        load_robot(robot),
        [made.work(16.0, name=f"empty {n}") for n in range(2)],
    )
    calibration = folder / "motions.yaml"
    write_calibration(calibration, load_robot(robot), known)
    loads = [
        (TAKEN_S, made.load(MASS_KG)),
        (LEFT_S, None),
    ]
    return Arm(robot, calibration, made.work(ENDS_S, loads))


@contextlib.contextmanager
def working(
    folder: Path, arm: Arm, pace: float = 1.0
) -> Iterator[tuple[Client, Player, Heard, Digestion]]:
    """The arm at work, and the identifier."""
    with world(folder / "data", only=()) as made:
        parameters = {
            "robot": arm.robot, "calibration": arm.calibration, "effort_unit": "N.m", "running": True,
            "gravity_effort_rate": 20.0, "holding_from": 0.5 * MASS_KG,
        }  # fmt: skip
        made.start("identifier", parameters)
        client = Client(made)
        heard = Heard(client)
        assert client.wait_for(lambda: client.statuses and "ready" in client.statuses[-1].message)
        with slow_computer(client) as digestion:
            player = Player(client, arm.motion, pace=pace)
            yield client, player, heard, digestion
        player.stop()
        client.assert_well()


def until(client: Client, player: Player, at_s: float) -> None:
    """Wait until so much of the motion was played."""
    client.clock.sleep(max(0.0, player.begun_s + at_s / player.pace - client.clock.now()))


def test_in_step_it_carries_the_stamp_of_the_newest_joint_state(tmp_path: Path, arm: Arm) -> None:
    with working(tmp_path, arm) as (client, player, heard, _):
        until(client, player, TAKEN_S + 6.0)
        assert len(heard.estimates) > 80
        for said in heard.estimates:
            assert said.at_s - player.sent_s[said.stamp_ns] < KEEPS_UP_S
            assert said.level == DiagnosticStatus.OK
            assert float(said.values["seconds_behind"]) < KEEPS_UP_S
        (changed_s,) = heard.changes_s()
        assert 0.0 < changed_s - player.begun_s - TAKEN_S < 0.25
        assert heard.estimates[-1].values["holding"] == "true"
        stamps = [load.header.stamp for load in heard.payloads]
        assert {stamp.sec * 10**9 + stamp.nanosec for stamp in stamps} <= player.sent_s.keys()
        assert abs(float(heard.capabilities[-1]["stamp"]) - 1e-9 * max(player.sent_s)) < 1.0


@pytest.mark.parametrize("cost_s", [0.007, 0.02])
def test_samples_are_left_out_by_a_computer_that_takes_too_long_for_all(
    tmp_path: Path, arm: Arm, cost_s: float
) -> None:
    """At 200 Hz, of which it digests 143 and 50."""
    with working(tmp_path, arm) as (client, player, heard, digestion):
        digestion.cost_s = cost_s
        until(client, player, ENDS_S)
        assert not heard.dishonest(player)
        behind_s = [float(said.values["seconds_behind"]) for said in heard.estimates]
        assert max(behind_s) < WARNED_S, max(behind_s)
        taken_s, left_s = heard.changes_s()
        assert 0.0 < taken_s - player.begun_s - TAKEN_S < 1.5
        assert 0.0 < left_s - player.begun_s - LEFT_S < 1.5
        # what was put down is not held any more
        assert heard.estimates[-1].values["holding"] == "false"


@pytest.mark.parametrize("cost_s", [0.05, 0.2])
def test_what_is_late_says_so(tmp_path: Path, arm: Arm, cost_s: float) -> None:
    """At 200 Hz it digests 20, and 5, a second."""
    with working(tmp_path, arm) as (client, player, heard, digestion):
        until(client, player, 3.0)
        digestion.cost_s = cost_s
        until(client, player, ENDS_S - 4.0)
        assert not heard.dishonest(player)
        late = [said for said in heard.estimates if said.level == DiagnosticStatus.WARN]
        assert late, "it was late"
        digestion.cost_s = 0.0
        client.clock.sleep(1.0)
        # it has caught up
        assert client.clock.now() - player.sent_s[heard.estimates[-1].stamp_ns] < 2.0 * KEEPS_UP_S
        assert heard.estimates[-1].level == DiagnosticStatus.OK
        assert not heard.dishonest(player)


def test_a_computer_that_stands_still_has_it_withdrawn(tmp_path: Path, arm: Arm) -> None:
    """Something is held when it stops, and was put down when it goes on."""
    with working(tmp_path, arm) as (client, player, heard, digestion):
        until(client, player, LEFT_S - 1.0)
        assert heard.estimates[-1].values["holding"] == "true"
        assert not heard.withdrawn
        digestion.stall_s = 6.0
        client.clock.sleep(0.5 * (WARNED_S + WITHDRAWN_S))
        late = heard.estimates[-1]
        assert late.level == DiagnosticStatus.WARN
        assert late.values["holding"] == "unknown"
        assert "s behind" in late.message
        assert late.determined
        client.clock.sleep(0.5 * (WITHDRAWN_S - WARNED_S) + LOOKED_S)
        late = heard.estimates[-1]
        assert heard.withdrawn
        assert "withdrawn: the computer is too busy" in late.message
        assert late.values["holding"] == "unknown"
        assert late.values["reason.1"] == late.message
        assert heard.capabilities[-1]["can_carry"] == "unknown"
        client.clock.sleep(6.0 - WITHDRAWN_S - LOOKED_S + 1.0)
        now = heard.estimates[-1]
        assert client.clock.now() - player.sent_s[now.stamp_ns] < 2.0 * KEEPS_UP_S
        assert now.level == DiagnosticStatus.OK
        until(client, player, ENDS_S)
        assert heard.estimates[-1].values["holding"] == "false"
        assert not heard.dishonest(player)


def test_an_arm_that_says_nothing_any_more_holds_nothing_for_ever(tmp_path: Path, arm: Arm) -> None:
    with working(tmp_path, arm) as (client, player, heard, _):
        until(client, player, TAKEN_S + 4.0)
        assert heard.estimates[-1].values["holding"] == "true"
        player.stop()
        client.clock.sleep(WARNED_S)
        said = heard.estimates[-1]
        assert heard.withdrawn
        assert said.values["holding"] == "unknown"
        assert "no joint states of the arm are coming" in said.message
        assert heard.capabilities[-1]["can_carry"] == "unknown"
        client.clock.sleep(10.0)
        assert heard.estimates[-1] is said


@pytest.mark.parametrize("ahead_s", [-3600.0, 3600.0])
def test_stamps_of_another_clock_are_not_late(tmp_path: Path, arm: Arm, ahead_s: float) -> None:
    with working(tmp_path, arm) as (client, player, heard, _):
        player.ahead_s = ahead_s
        until(client, player, TAKEN_S)
        of_that_clock = [said for said in heard.estimates if said.at_s > player.begun_s + 1.0]
        assert len(of_that_clock) > 30
        assert all(said.level == DiagnosticStatus.OK for said in of_that_clock)


@pytest.mark.parametrize("pace", [2.0, 0.5])
def test_a_recording_that_is_played_faster_or_slower_is_not_late(
    tmp_path: Path, arm: Arm, pace: float
) -> None:
    with working(tmp_path, arm, pace) as (client, player, heard, _):
        until(client, player, LEFT_S)
        assert len(heard.estimates) > 50
        assert all(said.level == DiagnosticStatus.OK for said in heard.estimates)


@pytest.mark.parametrize("step_s", [-5.0, 5.0])
def test_a_clock_that_is_set_makes_nothing_late(tmp_path: Path, arm: Arm, step_s: float) -> None:
    """That of the computer, or that of the stamps."""
    with working(tmp_path, arm) as (client, player, heard, _):
        until(client, player, 4.0)
        client.world.graph.set_by_s += step_s
        until(client, player, 8.0)
        player.ahead_s += step_s
        until(client, player, 12.0)
        assert not np.any([said.level == DiagnosticStatus.WARN for said in heard.estimates])
        assert client.clock.now() - heard.estimates[-1].at_s < 0.5
