"""`ForeignArm` in the simulated world, with the nodes that calibrate and weigh it, by services alone and from its URDF alone."""

from __future__ import annotations

import contextlib
import math
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from proprio_ros.cli import main as proprio
from proprio_ros.nodes.messages import values_of
from support.foreign_arm import (
    BROADCAST,
    ORDER,
    STIFFNESS_PER_RAD,
    Busy,
    ForeignArm,
    state_servos,
    write_urdf,
)
from support.simulated_live import Client
from support.simulated_world import World, world

REFERENCE_KG = 0.5


class ForeignProcess:
    """Its threads: one takes commands, one says joint states."""

    def __init__(
        self,
        made: World,
        arm: ForeignArm,
        rate_hz: float,
    ) -> None:
        self.arm, self._clock, self._rate_hz = arm, made.clock, rate_hz
        self.node = made.somebody("foreign")
        self._states = self.node.create_publisher(JointState, "/joint_states", 1)
        topic = (
            "/position_controller/commands" if arm.goals else "/forward_effort_controller/commands"
        )
        self.node.create_subscription(Float64MultiArray, topic, self._take, 1)
        self._clock.thread(self._say, "foreign states", group="foreign").start()

    def _take(self, message: Float64MultiArray) -> None:
        now_s = self._clock._now_s
        if (until_s := self.arm.stalled(now_s, "commands")) > now_s:
            self._clock.sleep(until_s - now_s)
        self.arm.command(
            self._clock._now_s,
            list(message.data),
        )

    def _say(self) -> None:
        next_s = self._clock._now_s
        nothing = array("d", [math.nan] * len(BROADCAST))
        while True:
            next_s = max(next_s + 1.0 / self._rate_hz, self._clock._now_s)
            self._clock.sleep(next_s - self._clock._now_s)
            now_s = self._clock._now_s
            if (until_s := self.arm.stalled(now_s, "states")) > now_s:
                self._clock.sleep(until_s - now_s)
            self.arm.advance(self._clock._now_s)
            message = JointState(
                name=list(BROADCAST),
                position=self.arm.positions(),
                velocity=nothing,
                effort=nothing,
            )
            message.header.stamp = self.node.get_clock().now().to_msg()
            self._states.publish(message)


def nodes_of(
    folder: Path,
    goals: bool,
    stiffness_per_rad: float = STIFFNESS_PER_RAD,
    **facts: Any,
) -> dict[str, dict[str, Any]]:
    """Parameters of excitation and identifier, by the arm's URDF alone; ``facts`` are further ones of the identifier."""
    robot = folder / "foreign.yaml"
    urdf = write_urdf(folder)
    assert (
        proprio(
            ["robot", "new", str(urdf), "--output", str(robot), "--effort-unit", "N.m", "--force"]
        )
        == 0
    )
    if goals:
        state_servos(robot, stiffness_per_rad)
    stated = ["payload.com=[0,0,0]", "payload.shape=point"]
    identifier = {
        "calibration": "none", "robot": robot, "reference_mass": REFERENCE_KG, "reference_wait": 3.0, "settings": stated,
        "reference_settings": stated, "live_period": 0.0, **facts,
    }  # fmt: skip
    output: dict[str, Any] = {
        "robot": robot,
        "controller_joints": list(ORDER),
        "command_interface": "position",
    }
    if not goals:
        output |= {"command_interface": "effort", "effort_unit": "N.m"}
    return {"excitation": output, "identifier": identifier}


@contextlib.contextmanager
def foreign(
    folder: Path,
    seed: int,
    goals: bool = False,
    rate_hz: float = 500.0,
    busy: Busy | None = None,
    stiffness_per_rad: float = STIFFNESS_PER_RAD,
    **facts: Any,
) -> Iterator[tuple[Client, ForeignArm]]:
    """The arm, excitation and identifier; in its hand is what the identifier asks for, and what `ForeignArm.hold` was told."""
    with world(
        folder / "data",
        seed=seed,
        nodes=nodes_of(folder, goals, stiffness_per_rad, **facts),
        only=("excitation", "identifier"),
    ) as made:
        arm = ForeignArm(seed, goals, busy, stiffness_per_rad)
        process = ForeignProcess(made, arm, rate_hz)
        client = Client(made)
        client.hear_less()
        assert client.wait_for(lambda: client.excitation.get("phase") == "idle"), client.log(
            "excitation"
        )
        assert client.wait_for(
            lambda: client.statuses and values_of(client.statuses[-1])["doing"] != "starting"
        )
        assert process.node is not None

        def person() -> None:
            while True:
                made.clock.sleep(0.1)
                said = client.statuses[-1].message if client.statuses else ""
                if "put the reference" in said:
                    arm.hold(REFERENCE_KG)

        made.clock.thread(person, "person", group="user").start()
        yield client, arm
