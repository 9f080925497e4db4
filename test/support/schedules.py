"""Weighings and pushes in the simulated world while things go wrong as a seed says, and what must be true all the same.

A world is started, makes what it is to make without a fault, and stands: each schedule goes on from there in a process of its
own (`support.forked`), so each begins with a robot that was seen to work. It ends when what went wrong is mended and the next
weighing, or push, has worked.

``python test/support/schedules.py FIRST COUNT`` plays schedules and prints those after which something was not true;
``SEED,SEED,..`` in their place names them. ``--tell`` prints what the nodes log, ``--json FILE`` counts what was played. Their
robot's calibration is kept; ``calibrate`` in the place of seeds has the arm make it anew.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")})
    sys.path.insert(
        0,
        str(Path(__file__).resolve().parents[1]),
    )

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool

from proprio_ros.bus.state import FAR_COUNTS
from proprio_ros.live.session import JOURNAL
from proprio_ros.nodes.messages import labelled
from support.forked import lives
from support.simulated_ros import Network
from support.simulated_world import LINK, NODES, World, world

MASSES_KG = (0.02, 0.05, 0.08)
FAULTY = ("driver", "excitation", "identifier")
JOINTS = ("joint1", "joint2", "joint3", "joint4")
KINDS = (
    "kill", "stall", "restart", "end", "unplug", "overheat", "jump", "drop", "stranger", "call", "transition", "clock", "double",
    "disk", "late",
)  # fmt: skip
THREADS = "threads"
"""Beside those: all threads of a node but the bus cycle are not run. Drawn apart, so that what other seeds say stays as it was."""
OF_PROCESSES = ("kill", "restart", "end", "stall", THREADS)
OF_THREADS = 0.08  # of schedules
BUS_CYCLE = "servo bus"
PLANS = {"push": 0.92, "weigh": 0.07, "pair": 0.01}
"""What is asked for while things go wrong, and how often: a push, a weighing, or a weighing by each of two arms in one world.

A weighing takes as long as four pushes, a pair of arms as ten; what drives and holds the arm is the same in all.
"""
CALIBRATION = Path(__file__).with_name("virtual_arm_1.yaml")
LASTING = ("stall", "unplug", "stranger", "drop", "double", "disk")
STILL_RAD_S = 0.15
SAFE_S = 1.0
"""After the driver or the bus is gone: the watchdog of a servo that pushes takes 0.3 s, and what turned comes to rest."""
NOWHERE_RAD = 0.31415
"""Where nobody but a stranger wants a joint."""
ANSWER_S = 120.0
GONE_S = 3.0
"""Whoever was asked has ended: so long others go on with what it had begun, before somebody comes."""
WELL_S = 30.0
"""Until all is as before once what went wrong is mended: a node that was stalled goes on after 10 s at most."""
SAVED_S = 6.0
"""A recording that a full disk refused is tried again every 5 s."""
LIFT = """
    - {joint: joint3, current_A: -0.45, duration_s: 0.5, start: {joint2: -1.0, joint3: 0.6, joint4: 0.4},
       min_travel: 0.1, max_travel: 0.8, raise_by: 1.2, max_current_A: 0.70}"""
CAREFUL = """
    - {joint: joint3, current_A: -0.36, duration_s: 0.6, start: {joint2: -1.4, joint3: 0.8, joint4: 0.0},
       min_travel: 0.3, max_travel: 0.6, raise_by: 1.15, max_current_A: 0.70}"""
SEQUENCE = "excitation:\n  hand: {hand}\n  settle_s: {settle}\n  brake_s: 0.2\n  approach_velocity: 1.5\n  runs:{runs}\n"
PUSH = SEQUENCE.format(hand="any", settle=0.3, runs=LIFT)
WEIGH = SEQUENCE.format(hand="payload", settle=1.1, runs=CAREFUL)


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong.

    Attributes:
        at_s: After the weighing was asked for.
        kind: What.
        whom: Node, joint or service.
        lasts_s: For how long; of a clock, by how much it is set; of a command, for how long it is held back.
    """

    at_s: float
    kind: str
    whom: str = ""
    lasts_s: float = 0.0

    def __str__(self) -> str:
        return f"{self.at_s:.2f} s: {self.kind} {self.whom} {self.lasts_s:.3g} s"


@dataclass
class Outcome:
    """What came of a schedule; `broken` is empty where all is well.

    Attributes:
        recorded: Of all messages of all bags, so that two may be compared.
    """

    seed: int
    plan: str = ""
    faults: list[Fault] = field(default_factory=list)
    answer: str = ""
    broken: list[str] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    recorded: str = ""
    cpu_s: float = 0.0
    simulated_s: float = 0.0

    def __str__(self) -> str:
        told = "\n  ".join([*self.broken, *self.log])
        return f"seed {self.seed}, {self.plan}: {'; '.join(map(str, self.faults))}\n  {self.answer}\n  {told}"


@dataclass(frozen=True)
class Drawn:
    """What a seed says: plan, masses in the hands, network, faults."""

    plan: str
    masses_kg: tuple[float, float]
    network: Network
    faults: tuple[Fault, ...]


def drawn(seed: int) -> Drawn:
    draw = random.Random(seed)
    plan = draw.choices(list(PLANS), list(PLANS.values()))[0]
    network = Network()
    if draw.random() < 0.4:
        network = Network(
            jitter_s=draw.choice((5e-4, 5e-3, 2e-2)), late=draw.choice((0.0, 0.002)), late_s=draw.choice((0.05, 0.5)),
            lose=draw.choice((0.0, 0.002)),
        )  # fmt: skip
    faults = []
    # a push writes nothing to a disk; and two arms share one, as they do the system's clock and the network
    shared = {"push": ("disk",), "weigh": (), "pair": ("disk", "clock", "double")}[plan]
    kinds = [kind for kind in KINDS if kind not in shared]
    kinds += ["disk"] * 3 if plan == "weigh" else []  # else it would be the rarest
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        kind = draw.choice(kinds)
        whom = draw.choice(FAULTY)
        if kind in ("overheat", "jump", "stranger", "late"):
            whom = draw.choice(JOINTS)
        elif kind == "call":
            whom = draw.choice(
                (
                    "/driver/stop",
                    "/excitation/abort",
                    "/identifier/cancel",
                    "/excitation/run",
                    "/identifier/weigh",
                )
            )
        elif kind in ("unplug", "drop", "clock", "double", "disk"):
            whom = ""
        lasts_s = 10.0 ** draw.uniform(-3.0, 1.0) if kind in LASTING else 0.0
        if kind == "late":
            lasts_s = draw.uniform(0.05, 0.8)
        if kind == "clock":
            lasts_s = draw.choice((-5.0, -0.2, 0.2, 5.0))
        faults.append(
            Fault(
                draw.uniform(0.0, 1.5 if plan == "push" else 4.5),
                kind,
                whom,
                lasts_s,
            )
        )
    masses_kg = draw.choice(MASSES_KG), draw.choice(MASSES_KG)
    faults += of_threads(seed)
    return Drawn(
        plan,
        masses_kg,
        network,
        tuple(sorted(faults, key=lambda fault: fault.at_s)),
    )


def of_threads(seed: int) -> list[Fault]:
    """That threads are not run, where the seed says so."""
    draw = random.Random(f"threads {seed}")
    if draw.random() >= OF_THREADS:
        return []
    whom = draw.choice(FAULTY)
    return [Fault(draw.uniform(0.0, 1.5), THREADS, whom, draw.uniform(0.3, 1.0))]


class Side:
    """One arm with its nodes, what is asked of it, and what must be true of it.

    Args:
        made: The world that it is in.
        space: Namespace of its nodes; empty: none.
        broken: Takes what is not true.
    """

    def __init__(
        self,
        made: World,
        space: str,
        broken: list[str],
    ) -> None:
        self.world, self.space, self.mass_kg = made, f"/{space}" if space else "", 0.0
        self._broken = broken
        self.position = made.user.create_publisher(
            Float64MultiArray, f"{self.space}/position_command", 10
        )

    def broken(self, what: str) -> None:
        self._broken.append(f"{self.space[1:]} {what}".strip())

    def process(self, name: str) -> Any:
        return self.world.processes.get(f"{self.space[1:]}/{name}" if self.space else name)

    def call(self, service: str, *rest: Any, **more: Any) -> Any:
        return self.world.call(f"{self.space}{service}", *rest, **more)

    @property
    def robot(self) -> Any:
        return self.process("virtual").node._robot

    def set(
        self,
        node: str,
        name: str,
        value: Any,
    ) -> bool:
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        answer = self.call(f"/{node}/set_parameters", SetParameters, request, 5.0)
        return answer is not None and answer.results[0].successful

    # --- faults

    def commit(self, fault: Fault) -> None:
        made = self.world
        clock = self.world.clock
        process = self.process(fault.whom)
        if fault.kind in OF_PROCESSES:
            self.disturb(process, fault)
        elif fault.kind == "unplug":
            self.robot.port.unplug()
            clock.sleep(min(fault.lasts_s, SAFE_S))
            if fault.lasts_s > SAFE_S:
                self.safe(f"{SAFE_S:g} s after the bus was lost")
                clock.sleep(fault.lasts_s - SAFE_S)
            self.robot.port.plug()
        elif fault.kind in ("overheat", "jump"):
            self.set("virtual", "fault", f"{fault.kind}={fault.whom}")
        elif fault.kind == "drop":
            self.set("virtual", "fault", "drop=0.3")
            clock.sleep(fault.lasts_s)
            self.set("virtual", "fault", "")
        elif fault.kind == "stranger":
            until_s = clock.now() + min(fault.lasts_s, 3.0)
            while clock.now() < until_s:
                self.position.publish(labelled({fault.whom: 0.3}))
                clock.sleep(0.02)
        elif fault.kind == "late":
            self.command_late(fault)
        elif fault.kind == "call":
            self.call(fault.whom, within_s=10.0)
        elif fault.kind == "transition" and process.alive and process.node is not None:
            process.ask(lambda node: node.trigger_deactivate())
            clock.sleep(0.1)
        elif fault.kind == "clock":
            made.graph.set_by_s += fault.lasts_s
        elif fault.kind == "double":
            before = made.graph.network
            made.graph.network = Network(jitter_s=5e-3, double=0.3, reorder=0.3)
            clock.sleep(fault.lasts_s)
            made.graph.network = before
        elif fault.kind == "disk":
            disk_is_full(True)
            clock.sleep(fault.lasts_s)
            disk_is_full(False)

    def disturb(self, process: Any, fault: Fault) -> None:
        """A process is killed, ended, or not run."""
        clock = self.world.clock
        if fault.kind == "end":
            process.end()
        elif fault.kind == "stall":
            clock.stall(process.name, fault.lasts_s)
        elif fault.kind == THREADS:
            self.stall_threads(process, fault.lasts_s)
        else:
            process.kill()
        if fault.kind == "restart":
            clock.sleep(0.5)
            process.start()
        elif fault.kind == "kill" and fault.whom == "driver":
            clock.sleep(SAFE_S)
            self.safe(f"{SAFE_S:g} s after {fault.kind}")

    def stall_threads(self, process: Any, lasts_s: float) -> None:
        """No thread of a node but the bus cycle is run, and one of the driver's has what they share: nothing is dropped."""
        clock = self.world.clock
        driver = self.process("driver")
        well = self.cycles()
        if well and process is driver:
            lock = driver.node._driver._lock

            def have() -> None:
                with lock:
                    clock.sleep(lasts_s)

            clock.thread(have, "asks", group="user").start()
        clock.stall(process.name, lasts_s, BUS_CYCLE)
        clock.sleep(lasts_s)
        stopped = [name for name, servo in self.robot.servos.items() if servo["bus_watchdog"] < 0]
        if well and stopped and self.cycles():
            self.broken(f"threads that were not run dropped {', '.join(stopped)}")

    def cycles(self) -> bool:
        """Whether the bus cycle holds the arm."""
        node = self.process("driver").node
        if node is None or node._driver is None or not self.process("driver").alive:
            return False
        cycle = [
            actor for actor in self.world.clock.actors if actor.name == BUS_CYCLE and not actor.done
        ]
        late = any(actor.stalled_until_s > self.world.clock._now_s for actor in cycle)
        return node._driver.state.value == "running" and not late

    def command_late(self, fault: Fault) -> None:
        """A command is held back while somebody switches torque off and on, and comes, if it does, to an arm held anew."""
        made = self.world
        sent_s = self.world.clock.now()
        driver = self.process("driver").node
        before, made.graph.network = made.graph.network, Network(delay_s=fault.lasts_s)
        self.position.publish(labelled({fault.whom: NOWHERE_RAD}))
        made.graph.network = before
        switched = [
            self.call("/driver/torque", SetBool, SetBool.Request(data=on), 10.0)
            for on in (False, True)
        ]
        held_s = made.clock.now()
        made.clock.sleep(max(sent_s + fault.lasts_s + 0.1 - held_s, 0.0))
        joint = (
            None if driver is None or driver._driver is None else driver._driver._joints[fault.whom]
        )
        if all(answer is not None and answer.success for answer in switched) and joint is not None:
            if joint.target_rad == NOWHERE_RAD:
                self.broken(
                    f"a command that was sent {held_s - sent_s:.2f} s before torque was on moves {fault.whom}"
                )

    def heal(self) -> None:
        """What a person does who finds things so."""
        made = self.world
        self.set("virtual", "fault", "")
        self.robot.port.plug()
        for name in FAULTY:
            process = self.process(name)
            if not process.alive:
                process.start()
        self.recover(held=False)
        self.call(
            "/driver/torque",
            SetBool,
            SetBool.Request(data=False),
            10.0,
        )
        self.robot.park()
        # what was sent before may come after this
        self.call(
            "/driver/torque",
            SetBool,
            SetBool.Request(data=True),
            10.0,
        )
        made.clock.sleep(0.3)
        self.recover()

    def recover(self, held: bool = True) -> None:
        """Until all is as before; whoever was deactivated is activated. ``held``: torque has been switched on again, too."""
        clock = self.world.clock
        unwell = self.unwell(held)
        until_s = clock.now() + WELL_S
        while unwell and clock.now() < until_s:
            for process in map(self.process, FAULTY):
                if process.node is not None and process.node._ros_state == "inactive":
                    process.ask(lambda node: node.trigger_activate())
            clock.sleep(0.1)
            unwell = self.unwell(held)
        if unwell:
            self.broken(f"{WELL_S:g} s after all was mended: {unwell}")

    def unwell(self, held: bool) -> str:
        """Why nothing can be asked of it yet, or an empty string."""
        for name in FAULTY:
            process = self.process(name)
            if process.node is None or not process.node.active:
                return f"the {name} is not active"
            if self.world.clock.stalled(process.name):
                return f"the {name} is stalled"
        driver = self.process("driver").node._driver
        excitation = self.process("excitation").node._machine
        blocked = held and (
            driver.state.value != "running"
            or any(joint.blocked for joint in driver._joints.values())
        )
        if driver.state.value == "disconnected" or blocked:
            return f"the driver is {driver.state.value}: {driver.reason}"
        if excitation.busy or self.process("identifier").node._busy():
            return "the last one is still under way"
        return ""

    # --- what is asked for, and what must be true

    def safe(self, why: str) -> None:
        """No motor pushes a joint that turns; one that holds a place, as its servo does for 2 s, may turn about it."""
        speeds, (_, currents) = self.robot.arm.velocity_rad_s().tolist(), self.robot.truth()
        for (name, current_A), speed in zip(currents.items(), speeds, strict=True):
            servo = self.robot.servos[name]
            ahead = abs(servo["goal_position"] - servo["present_position"])
            if ahead > FAR_COUNTS / 2 and abs(speed) > STILL_RAD_S and abs(current_A) > 0.01:
                self.broken(f"{why}: {name} turns at {speed:.2f} rad/s with {current_A:.3f} A")

    def still(self, why: str) -> None:
        speeds = self.robot.arm.velocity_rad_s().tolist()
        if max(map(abs, speeds)) > STILL_RAD_S:
            self.broken(
                f"{why}: the arm is not held: {[round(speed, 2) for speed in speeds]} rad/s"
            )

    def push(self, why: str) -> str:
        """Ask for a push, and wait for its end."""
        process = self.process("excitation")
        answer = self.call("/excitation/run", within_s=10.0)
        if answer is None or not answer.success:
            return "" if answer is None else f"not: {answer.message}"
        machine = process.node._machine
        until_s = self.world.clock.now() + ANSWER_S
        while (
            machine.busy
            and process.alive
            and process.node is not None
            and process.node._machine is machine
        ):
            if self.world.clock.now() > until_s:
                self.broken(f"{why}: a push does not end")
                return ""
            self.world.clock.sleep(0.05)
        good = sum(outcome.used for outcome in machine.outcomes)
        words = f"{machine.phase.value}, {good} good runs"
        return f"accepted: {words}" if machine.phase.value == "done" and good else f"not: {words}"

    def weigh(self, why: str) -> str:
        """Ask for a weighing; an accepted answer must be right."""
        answer = self.call("/identifier/calibrate_payload", within_s=ANSWER_S)
        if answer is None:
            return ""
        if answer.success:
            # what it published; the network may have lost that
            values = self.process("identifier").node.results.entries
            mass, std = (float(values[key]) for key in ("payload_mass", "payload_mass.std"))
            if abs(mass - self.mass_kg) > 3.0 * std:
                self.broken(f"{why}: accepted and wrong: {answer.message}")
        return f"{'accepted' if answer.success else 'not'}: {answer.message}"


def disk_is_full(full: bool) -> None:
    """No file of this process may grow beyond what a journal has after a moment; elsewhere it says EFBIG, as a disk ENOSPC."""
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096 if full else hard, hard))


class Schedule:
    """One life of a world that stands.

    Args:
        made: That world.
        seed: Of all that is drawn.
        digest: Whether to look into what was recorded.
    """

    def __init__(
        self,
        made: World,
        seed: int,
        digest: bool = False,
    ) -> None:
        self.world, self.digest, self.drawn = made, digest, drawn(seed)
        self.outcome = Outcome(
            seed,
            self.drawn.plan,
            list(self.drawn.faults),
        )
        spaces = ("left", "right") if self.drawn.plan == "pair" else ("",)
        self.sides = [Side(made, space, self.outcome.broken) for space in spaces]

    def ask(self, side: Side, why: str) -> str:
        return side.push(why) if self.drawn.plan == "push" else side.weigh(why)

    def play(self) -> Outcome:
        made = self.world
        clock = self.world.clock
        outcome = self.outcome
        began_s = clock.now()
        logged = len(made.graph.log)
        for side, mass_kg in zip(self.sides, self.drawn.masses_kg, strict=False):
            side.mass_kg = mass_kg
            side.set("virtual", "object", f"{mass_kg}")
        made.graph.network = self.drawn.network
        asked = [(clock.event(), list[str]()) for _ in self.sides]

        def begin(
            side: Side,
            answered: Any,
            said: list[str],
        ) -> None:
            said.append(self.ask(side, "under faults"))
            answered.set()

        for side, (answered, said) in zip(self.sides, asked, strict=True):
            clock.thread(begin, "asking", (side, answered, said), group="user").start()
        self.go_wrong(self.sides[0])
        for side, (answered, _) in zip(self.sides, asked, strict=True):
            answered.wait(GONE_S if self.gone(side) else ANSWER_S)
        made.graph.network = Network()
        if self.drawn.network.late:  # what was sent before comes before what is sent from now on
            clock.sleep(self.drawn.network.late_s)
        for side in self.sides:
            side.heal()
            side.still("after all was mended")
        for side, (answered, said) in zip(self.sides, asked, strict=True):
            self.works_again(side, answered, said)
        outcome.answer = " | ".join(said[0] if said else "" for _, said in asked)
        self.look_back(began_s, logged)
        outcome.simulated_s = clock.now() - began_s
        return outcome

    def works_again(self, side: Side, answered: Any, said: list[str]) -> None:
        """After all was mended an arm answers, and what was not touched has worked all along.

        Args:
            side: The arm.
            answered: Is set once it has answered what was asked under faults.
            said: Those answers.
        """
        answered.wait(0.0 if self.gone(side) else 1.0)
        if not answered.is_set() and not self.gone(side):
            side.broken("no answer came")
        last = self.ask(side, "after all was mended")
        if not last.startswith("accepted"):
            side.broken(f"the next one does not work: {last}")
        # what is late by 0.5 s ends a push of either arm
        spared = side is not self.sides[0] and not self.drawn.network.late
        if spared and not (said and said[0].startswith("accepted")):
            side.broken(f"was not touched, and did not work: {said}")

    def go_wrong(self, side: Side) -> None:
        clock = self.world.clock
        begun_s = self.world.clock.now()
        for fault in self.drawn.faults:
            clock.sleep(max(begun_s + fault.at_s - clock.now(), 0.0))
            side.commit(fault)

    def gone(self, side: Side) -> bool:
        """Whether whoever was asked has ended, and so never answers."""
        of = "excitation" if self.drawn.plan == "push" else "identifier"
        ended = [
            fault
            for fault in self.drawn.faults
            if fault.whom == of and fault.kind in ("kill", "restart", "end")
        ]
        return side is self.sides[0] and bool(ended)

    def look_back(self, began_s: float, logged: int) -> None:
        """What nodes have done, said and kept meanwhile."""
        made = self.world
        broken = self.outcome.broken
        broken += [
            f"{process.name} has ended by itself"
            for process in made.processes.values()
            if not process.alive
        ]
        told = [
            (at_s - began_s, name, severity, text)
            for at_s, name, severity, text in made.graph.log[logged:]
        ]
        broken += [
            f"{at_s:.2f} s: {name}: {text}" for at_s, name, _, text in told if "a defect in" in text
        ]
        self.outcome.log = [
            f"{at_s:8.3f} {name} {severity}: {text}" for at_s, name, severity, text in told
        ]
        for side in self.sides:
            until_s = made.clock.now() + SAVED_S
            while side.process("identifier").node._unsaved and made.clock.now() < until_s:
                made.clock.sleep(0.1)
            if unsaved := side.process("identifier").node._unsaved:
                broken.append(
                    f"recordings that are only in memory: {[each.name for each in unsaved]}"
                )
        if left := [str(path) for path in Path().rglob(JOURNAL)]:
            broken.append(f"recordings that were not saved: {left}")
        if self.digest:
            self.outcome.recorded = digest_of(Path())


def digest_of(folder: Path) -> str:
    """Of all messages of all bags below a folder, in the order of their folders' names.

    The middleware leaves bytes between two fields as they were in memory: each message is read and written anew, with zeros there.
    """
    from proprio_ros.recordings.messages import deserialised, message_types
    from proprio_ros.recordings.reader import open_bag

    types = message_types()
    found = hashlib.sha256()
    for path in sorted(folder.rglob("bag")):
        with open_bag(path) as bag:
            for topic in bag.topics.all:
                for time_ns, data in bag._read(topic):
                    whole = types.serialize_cdr(
                        deserialised(data, topic.msgtype),
                        topic.msgtype,
                    )
                    found.update(f"{topic.name} {time_ns}".encode() + bytes(whole))
    return found.hexdigest()


@contextlib.contextmanager
def standing(plan: str, folder: Path) -> Iterator[World]:
    """A world in which what the plan asks for, one of `PLANS`, has worked, without a fault; ``folder``: empty."""
    push = folder / "push.yaml"
    weigh = folder / "weigh.yaml"
    push.write_text(PUSH)
    weigh.write_text(WEIGH)
    nodes: dict[str, dict[str, Any]] = {
        "virtual": {"object": "0.05"},
        "driver": {"rate": 50.0 if plan == "weigh" else 40.0},
        "excitation": {"probe": str(push)},
        "identifier": {
            "calibration": str(CALIBRATION),
            "payload_sequence": str(weigh),
            "live_period": 0.0,
        },
    }
    spaces = ("left", "right") if plan == "pair" else ("",)
    before = Path.cwd()
    os.chdir(folder)
    try:
        # where a process of its own goes, its recordings go
        with world(
            Path("data"),
            nodes=nodes,
            only=(),
            coarse=True,
        ) as made:
            for space in spaces:
                for name in NODES:
                    link = {
                        "virtual": {"link": f"{LINK}{space}"},
                        "driver": {"port": f"{LINK}{space}"},
                    }.get(name, {})
                    made.start(
                        name,
                        {
                            **nodes[name],
                            **link,
                        },
                        space,
                        f"{space}/{name}" if space else name,
                    )
            made.clock.sleep(1.0)
            broken: list[str] = []
            for side in (Side(made, space, broken) for space in spaces):
                side.mass_kg = 0.05
                answer = (
                    side.push("at the beginning")
                    if plan == "push"
                    else side.weigh("at the beginning")
                )
                assert answer.startswith("accepted") and not broken, (
                    f"{answer} {broken} {made.graph.log}"
                )
                # from where the next one begins: to go there first takes as long as a push
                side.heal()
                made.clock.sleep(0.5)
            yield made
    finally:
        os.chdir(before)


def played(
    seeds: Sequence[int],
    folder: Path,
    digest: bool = False,
    together: int = 2,
) -> Iterator[Outcome]:
    """Play schedules: those of a plan together, each from a world of that plan that stands."""

    def live(made: World, seed: int) -> Outcome:
        outcome = Schedule(made, seed, digest).play()
        outcome.cpu_s = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])  # since it was forked
        return outcome

    for plan in PLANS:
        of_plan = [seed for seed in seeds if drawn(seed).plan == plan]
        if not of_plan:
            continue
        (folder / plan).mkdir()
        with standing(plan, folder / plan) as made:
            for seed, outcome in lives(made, of_plan, folder / plan, live, together):
                if isinstance(outcome, str):
                    outcome = Outcome(
                        seed,
                        plan,
                        list(drawn(seed).faults),
                        broken=[outcome],
                    )
                yield outcome


def calibrate(folder: Path) -> None:
    """The arm of virtual seed 1 calibrates itself, in the simulated world, and the file is kept."""
    elbow = {
        "live_period": 0.0,
        "robot_sequence": "empty_hand_elbow",
        "reference_sequence": "reference_elbow",
    }
    with world(
        folder,
        seed=0,
        nodes={"virtual": {"object": "0.05"}, "identifier": elbow},
    ) as made:
        answer = made.call("/identifier/calibrate_robot")
        assert answer.success, answer.message
        shutil.copyfile(
            re.search(r"calibration: (\S+?\.yaml)", answer.message)[1],
            CALIBRATION,
        )  # type: ignore[index]


def counted(
    outcomes: Iterable[Outcome],
    tell: bool,
) -> dict[str, Any]:
    """Print what is broken as it comes; how often there was what."""
    kinds = Counter[str]()
    plans = Counter[str]()
    failed = list[int]()
    recorded = dict[int, str]()
    cpu_s = Counter[str]()
    simulated_s = Counter[str]()
    for outcome in outcomes:
        kinds.update(fault.kind for fault in outcome.faults)
        plans[outcome.plan] += 1
        cpu_s[outcome.plan] += outcome.cpu_s  # type: ignore[assignment]
        simulated_s[outcome.plan] += outcome.simulated_s  # type: ignore[assignment]
        if outcome.broken:
            failed.append(outcome.seed)
        if outcome.recorded:
            recorded[outcome.seed] = outcome.recorded
        if not tell:
            outcome.log.clear()
        if outcome.broken or tell:
            print(outcome, flush=True)
    here = Path(__file__).parent
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=here, capture_output=True, text=True
    )
    return {
        "commit": commit.stdout.strip(), "schedules": plans.total(), "plans": plans, "faults": kinds, "failed": sorted(failed),
        "cpu_s": {plan: round(spent_s, 1) for plan, spent_s in cpu_s.items()},
        "simulated_s": {plan: round(spent_s, 1) for plan, spent_s in simulated_s.items()}, "recorded": recorded,
    }  # fmt: skip


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", help="the first, or several with commas; or `calibrate`")
    parser.add_argument("count", nargs="?", type=int, default=1)
    parser.add_argument("--tell", action="store_true")
    parser.add_argument("--digest", action="store_true", help="of all that was recorded, by seed")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--together", type=int, default=2)
    stated = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        if stated.seeds == "calibrate":
            calibrate(Path(folder))
            return 0
        numbers = [int(word) for word in stated.seeds.split(",")]
        seeds = numbers if len(numbers) > 1 else range(numbers[0], numbers[0] + stated.count)
        found = counted(
            played(seeds, Path(folder), stated.digest, stated.together),
            stated.tell,
        )
    print(json.dumps(found))
    if stated.json:
        stated.json.write_text(json.dumps(found, indent=1) + "\n")
    return 1 if found["failed"] else 0


if __name__ == "__main__":
    # the order in which sets are gone through is part of a schedule
    if os.environ.get("PYTHONHASHSEED") != "0":
        os.execve(
            sys.executable, [sys.executable, *sys.argv], {**os.environ, "PYTHONHASHSEED": "0"}
        )
    raise SystemExit(main())
