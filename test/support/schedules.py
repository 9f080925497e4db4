"""Weighings in the simulated world while things go wrong as a seed says, and what must be true all the same.

``python test/support/schedules.py FIRST COUNT`` plays schedules and prints those after which something was not true;
``SEED,SEED,..`` in their place names them.
"""

from __future__ import annotations

import json
import os
import random
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout
from std_srvs.srv import SetBool

from proprio_ros.live.session import JOURNAL
from support.simulated_ros import Network
from support.simulated_world import World, world

MASSES_KG = (0.02, 0.05, 0.08)
NODES = ("driver", "excitation", "identifier")
JOINTS = ("joint1", "joint2", "joint3", "joint4")
KINDS = (
    "kill", "stall", "restart", "end", "unplug", "overheat", "jump", "drop", "stranger", "call", "transition", "clock",
)  # fmt: skip
STILL_RAD_S = 0.15
SAFE_S = 1.0
"""After the driver or the bus is gone: the servos' watchdog takes 0.3 s, and what turned comes to rest."""
ANSWER_S = 120.0
SEQUENCE = """excitation:
  hand: payload
  settle_s: 1.1
  brake_s: 0.3
  approach_velocity: 0.9
  runs:
    - {joint: joint3, current_A: -0.36, duration_s: 0.6, start: {joint2: -1.4, joint3: 0.8, joint4: 0.0},
       min_travel: 0.3, max_travel: 0.6, raise_by: 1.15, max_current_A: 0.70}
    - {joint: joint3, current_A: -0.10, duration_s: 0.6, start: {joint2: -0.6, joint3: -0.4, joint4: 0.0},
       min_travel: 0.3, max_travel: 0.6, raise_by: 0.5}
"""


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong.

    Attributes:
        at_s: After the weighing was asked for.
        kind: What.
        whom: Node or joint.
        lasts_s: For how long.
    """

    at_s: float
    kind: str
    whom: str = ""
    lasts_s: float = 0.0

    def __str__(self) -> str:
        return f"{self.at_s:.2f} s: {self.kind} {self.whom} {self.lasts_s:.3g} s"


@dataclass
class Outcome:
    """What came of a schedule; `broken` is empty where all is well."""

    seed: int
    faults: list[Fault]
    answer: str = ""
    broken: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return f"seed {self.seed}: {'; '.join(map(str, self.faults))}\n  {self.answer}\n  " + "\n  ".join(self.broken)


def drawn(seed: int) -> tuple[float, Network, list[Fault]]:
    """Mass in the hand, network and faults of a seed."""
    draw = random.Random(seed)
    network = Network()
    if draw.random() < 0.4:
        network = Network(
            jitter_s=draw.choice((5e-4, 5e-3, 2e-2)), late=draw.choice((0.0, 0.002)), late_s=draw.choice((0.05, 0.5)),
            lose=draw.choice((0.0, 0.002)),
        )  # fmt: skip
    faults = []
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        kind = draw.choice(KINDS)
        whom = draw.choice(NODES)
        if kind in ("overheat", "jump", "stranger"):
            whom = draw.choice(JOINTS)
        elif kind == "call":
            whom = draw.choice(
                ("/driver/stop", "/excitation/abort", "/identifier/cancel", "/excitation/run", "/identifier/weigh")
            )
        lasts_s = 10.0 ** draw.uniform(-3.0, 1.0) if kind in ("stall", "unplug", "stranger", "drop") else 0.0
        if kind == "clock":
            whom, lasts_s = "", draw.choice((-5.0, -0.2, 0.2, 5.0))
        faults.append(Fault(draw.uniform(0.0, 9.0), kind, whom, lasts_s))
    return draw.choice(MASSES_KG), network, sorted(faults, key=lambda fault: fault.at_s)


class _Schedule:
    def __init__(self, made: World, outcome: Outcome, mass_kg: float) -> None:
        self.world, self.outcome, self.mass_kg = made, outcome, mass_kg
        self.position = made.user.create_publisher(Float64MultiArray, "/position_command", 10)
        self.estimates: list[Any] = []
        self.states: list[Any] = []
        made.user.create_subscription(DiagnosticArray, "/identifier/estimate", self.estimates.append, 10)
        made.user.create_subscription(JointState, "/virtual/motors", self.states.append, 10)

    def broken(self, what: str) -> None:
        self.outcome.broken.append(what)

    def set(self, node: str, name: str, value: Any) -> bool:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        answer = self.world.call(f"/{node}/set_parameters", SetParameters, request, 5.0)
        return answer is not None and answer.results[0].successful

    # --- faults

    def commit(self, fault: Fault) -> None:
        made, clock = self.world, self.world.clock
        process = made.processes.get(fault.whom)
        if fault.kind == "kill" and process is not None:
            process.kill()
        elif fault.kind == "restart" and process is not None:
            process.kill()
            clock.sleep(0.5)
            process.start()
        elif fault.kind == "end" and process is not None:
            process.end()
        elif fault.kind == "stall":
            clock.stall(fault.whom, fault.lasts_s)
        elif fault.kind == "unplug":
            made.arm.port.unplug()
            clock.sleep(min(fault.lasts_s, SAFE_S))
            if fault.lasts_s > SAFE_S:
                self.safe(f"{SAFE_S:g} s after the bus was lost")
                clock.sleep(fault.lasts_s - SAFE_S)
            made.arm.port.plug()
        elif fault.kind in ("overheat", "jump"):
            self.set("virtual", "fault", f"{fault.kind}={fault.whom}")
        elif fault.kind == "drop":
            self.set("virtual", "fault", "drop=0.3")
            clock.sleep(fault.lasts_s)
            self.set("virtual", "fault", "")
        elif fault.kind == "stranger":
            layout = MultiArrayLayout(dim=[MultiArrayDimension(label=fault.whom, size=1, stride=1)])
            until_s = clock.now() + min(fault.lasts_s, 3.0)
            while clock.now() < until_s:
                self.position.publish(Float64MultiArray(layout=layout, data=[0.3]))
                clock.sleep(0.02)
        elif fault.kind == "call":
            made.call(fault.whom, within_s=10.0)
        elif fault.kind == "transition" and process is not None and process.alive and process.node is not None:
            process.ask(lambda node: node.trigger_deactivate())
        elif fault.kind == "clock":
            made.graph.set_by_s += fault.lasts_s

    def heal(self) -> None:
        """What a person does who finds things so."""
        made = self.world
        made.graph.network = Network()
        self.set("virtual", "fault", "")
        made.arm.port.plug()
        for name in NODES:
            process = made.processes[name]
            if not process.alive:
                process.start()
            elif process.node is not None and not process.node.active:
                process.ask(lambda node: node.trigger_activate())
        made.clock.sleep(4.0)
        made.call("/driver/torque", SetBool, SetBool.Request(data=False), 10.0)
        made.arm.park()
        made.call("/driver/torque", SetBool, SetBool.Request(data=True), 10.0)
        made.clock.sleep(1.0)

    # --- what must be true

    def safe(self, why: str) -> None:
        """No motor pushes a joint that turns."""
        made = self.world
        speeds, (_, currents) = made.arm.arm.velocity_rad_s().tolist(), made.arm.truth()
        for (name, current_A), speed in zip(currents.items(), speeds, strict=True):
            if abs(speed) > STILL_RAD_S and abs(current_A) > 0.01:
                self.broken(f"{why}: {name} turns at {speed:.2f} rad/s with {current_A:.3f} A")

    def still(self, why: str) -> None:
        speeds = self.world.arm.arm.velocity_rad_s().tolist()
        if max(map(abs, speeds)) > STILL_RAD_S:
            self.broken(f"{why}: the arm is not held: {[round(speed, 2) for speed in speeds]} rad/s")

    def weigh(self, why: str) -> str:
        """Ask for a weighing; an accepted answer must be right."""
        before = len(self.estimates)
        answer = self.world.call("/identifier/calibrate_payload", within_s=ANSWER_S)
        if answer is None:
            return ""
        if answer.success:
            until_s = self.world.clock.now() + 5.0
            while len(self.estimates) == before and self.world.clock.now() < until_s:
                self.world.clock.sleep(0.05)  # the service's answer may overtake the topic
            status = next(s for message in self.estimates[before:][::-1] for s in message.status)
            values = {each.key: each.value for each in status.values}
            mass, std = (float(values[key]) for key in ("payload_mass", "payload_mass.std"))
            if abs(mass - self.mass_kg) > 3.0 * std:
                self.broken(f"{why}: accepted and wrong: {answer.message}")
        return f"{'accepted' if answer.success else 'not'}: {answer.message}"


def play(seed: int, folder: Path, calibration: Path, tell: bool = False) -> Outcome:
    """Play one schedule.

    Args:
        seed: Of all that is drawn.
        folder: Empty; recordings go there.
        calibration: Of the arm of virtual seed 1.
        tell: Print what the nodes log.
    """
    mass_kg, network, faults = drawn(seed)
    outcome = Outcome(seed, faults)
    sequence = folder / "two_pushes.yaml"
    sequence.write_text(SEQUENCE)
    data = folder / "data"
    nodes = {
        "virtual": {"object": f"{mass_kg}"},
        "identifier": {"calibration": str(calibration), "payload_sequence": str(sequence), "live_period": 0.0},
    }
    with world(data, seed=seed, network=network, nodes=nodes) as made:
        schedule = _Schedule(made, outcome, mass_kg)
        made.clock.sleep(1.5)
        begun_s = made.clock.now()
        answered = made.clock.event()

        def ask() -> None:
            outcome.answer = schedule.weigh("under faults")
            answered.set()

        made.clock.thread(ask, "asking", group="user").start()
        gone = False
        for fault in faults:
            made.clock.sleep(max(begun_s + fault.at_s - made.clock.now(), 0.0))
            schedule.commit(fault)
            gone = gone or (fault.whom == "identifier" and fault.kind in ("kill", "restart", "end"))
            if fault.kind == "kill" and fault.whom == "driver":
                made.clock.sleep(SAFE_S)
                schedule.safe(f"{SAFE_S:g} s after {fault.kind}")
        answered.wait(0.0 if gone else ANSWER_S)
        if not answered.is_set() and not gone:
            outcome.broken.append("no answer came")
        schedule.heal()
        schedule.still("after all was mended")
        last = schedule.weigh("after all was mended")
        if not last.startswith("accepted"):
            outcome.broken.append(f"the next weighing does not work: {last}")
        for process in made.processes.values():
            if not process.alive:
                outcome.broken.append(f"{process.name} has ended by itself")
        for at_s, name, severity, text in made.graph.log:
            if tell:
                print(f"{at_s - begun_s:8.3f} {name} {severity}: {text}")
            if "a defect in" in text:
                outcome.broken.append(f"{at_s - begun_s:.2f} s: {name}: {text}")
    left = list(data.rglob(JOURNAL))
    if left:
        outcome.broken.append(f"recordings that were not saved: {left}")
    return outcome


def calibrated(folder: Path) -> Path:
    """The arm of virtual seed 1 calibrates itself, in the simulated world; returns the file."""
    elbow = {"live_period": 0.0, "robot_sequence": "empty_hand_elbow", "reference_sequence": "reference_elbow"}
    with world(folder, seed=0, nodes={"virtual": {"object": "0.05"}, "identifier": elbow}) as made:
        answer = made.call("/identifier/calibrate_robot")
        assert answer.success, answer.message
        return Path(re.search(r"calibration: (\S+?\.yaml)", answer.message)[1])  # type: ignore[index]


def main(seeds: Sequence[int], tell: bool = False) -> int:
    kinds, failed = Counter[str](), 0
    with tempfile.TemporaryDirectory() as folder:
        calibration = calibrated(Path(folder) / "calibration")
        for seed in seeds:
            each = Path(folder) / str(seed)
            each.mkdir()
            try:
                outcome = play(seed, each, calibration, tell)
            except Exception as error:
                outcome = Outcome(seed, drawn(seed)[2], broken=[f"{type(error).__name__}: {error}"])
            kinds.update(fault.kind for fault in outcome.faults)
            failed += bool(outcome.broken)
            print(outcome if outcome.broken else f"seed {seed}: {outcome.answer[:60]}", flush=True)
    print(json.dumps({"schedules": len(seeds), "failed": failed, "faults": kinds, "cpu_s": os.times().user}))
    return 1 if failed else 0


if __name__ == "__main__":
    if "," in sys.argv[1]:
        raise SystemExit(main([int(word) for word in sys.argv[1].split(",")], len(sys.argv) > 2))
    first, count = int(sys.argv[1]), int(sys.argv[2])
    raise SystemExit(main(range(first, first + count), len(sys.argv) > 3))
