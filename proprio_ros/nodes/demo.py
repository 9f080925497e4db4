"""`proprio demo`: a virtual robot and three nodes in processes of their own, one calibration, one object, the result.

What the object is, the probe says; where it has a baseline, that is recorded first.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.arguments import Stated
from proprio_ros.nodes.calling import SILENCE_S, Caller
from proprio_ros.nodes.domains import heard_in, unused_domain
from proprio_ros.nodes.graph import Graph
from proprio_ros.nodes.starting import starts
from proprio_ros.probes.base import Example, HasBaseline, Probe

NOT_READY_S = 60.0  # between nodes that are all up: a node that the others do not see yet
REFERENCE_KG = 0.1
_interrupted = threading.Event()


@dataclass(frozen=True)
class DemoResult:
    """What the demo showed."""

    accepted: bool  # whether the robot and the object were identified
    sentence: str  # the service's own words
    # value, truth: the probe's answer, in its SI unit, None where not determined; and what it should have been
    value: float | None
    ci95: str  # its interval, as published
    truth: float
    report: Path | None  # the HTML page
    elapsed_s: float  # from start to result


def demo(
    probe: Probe[Any],
    truth: float,
    *,
    folder: Path = Path("proprio_demo"),
    seed: int = 1,
    robot: str = "open_manipulator_x",
    full: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> DemoResult:
    """Weigh an object, or squeeze it, with a virtual arm that first weighs itself.

    Args:
        probe: What is identified; it has an example.
        truth: What it should find, in the unit of its answer.
        folder: For recordings, calibration, report and the nodes' logs.
        seed: Draws the arm's hidden numbers.
        robot: Its name or file.
        full: All joints, as on a real arm, instead of those that the example needs.
        tell: Called with what is going on, a sentence at a time.

    Raises:
        ConfigurationError: A node ended or did not come up; with its own words.
        KeyboardInterrupt: Asked to end (SIGINT, SIGTERM); no process is left behind.
    """
    started = time.monotonic()
    example = probe.example
    assert example is not None, f"{probe.name} has no example"
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    # a domain of its own: another arm's driver on this network must not hear our commands, nor we its states
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    _interrupted.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    domain = _domain()
    _obey_interrupt()
    with Graph(folder / "logs") as graph:
        weighs = _start(
            graph,
            example,
            {"robot": robot, "seed": str(seed)},
            truth,
            folder,
            full,
        )
        tell(
            f"virtual robot, driver, excitation and identifier are starting; watch them with ROS_DOMAIN_ID={domain}"
        )
        with contextlib.closing(_Demonstrator(graph, tell)) as demonstrator:
            _obey_interrupt()
            demonstrator.wait_until_ready()
            accepted, sentence = demonstrator.identify(probe, example, weighs)
            final = demonstrator.final_estimate(probe.name) if accepted else {}
            elapsed = time.monotonic() - started
            tell("done; the nodes are ending")
    name, _ = probe.answer
    value = float(final[name]) if name in final else None
    reports = sorted(folder.glob(f"*_{probe.name}/report.html"))
    report = reports[-1] if accepted and reports else None
    return DemoResult(
        accepted, sentence, value, final.get(f"{name}.ci95", ""), truth, report, elapsed
    )


def _domain() -> str:
    """The ROS domain. Raises: ConfigurationError: others are in the one that the user states."""
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    if not domain:
        domain = os.environ["ROS_DOMAIN_ID"] = unused_domain()
        return domain
    heard = heard_in(domain)
    if heard:
        raise ConfigurationError(
            f"ROS_DOMAIN_ID={domain}: others are found there ({', '.join(heard[:4])}): leave it out, or state another one"
        )
    return domain


def _start(
    graph: Graph,
    example: Example,
    robot: dict[str, str],
    truth: float,
    folder: Path,
    full: bool,
) -> bool:
    """Start the nodes; whether the robot is calibrated with a weight, too."""
    weighs = full or example.reference
    stated = Stated(
        {
            **robot,
            "virtual": "true",
            "port": str(folder / "bus"),
            "object": example.held.format(truth=truth),
            "data_directory": str(folder),
            "reference_mass": str(REFERENCE_KG if weighs else 0.0),
        }
    )
    # the virtual robot's helper is quick
    own: dict[str, Any] = {"calibration": "none", "reference_wait": 0.5}
    if example.stated:
        own["settings"] = list(example.stated)
    if not full:
        own |= {"reference_sequence": "reference_elbow", **example.sequences}
    for start in starts(stated):
        more = own if start.node == "identifier" else {}
        graph.start(start.node, {**start.parameters, **more}, files=start.files)
    return weighs


def _interrupt(_number: int, _frame: Any) -> None:
    # raised here, it could land inside a library's callback that swallows it, or after a process was made and before anybody
    # knows of it; it is looked for where it can be obeyed. A second Ctrl-C changes nothing: the nodes end in order
    _interrupted.set()


def _obey_interrupt() -> None:
    """Raises: KeyboardInterrupt: somebody wants this to end."""
    if _interrupted.is_set():
        raise KeyboardInterrupt


class _Demonstrator:
    """Calls services and listens, in this process."""

    def __init__(
        self,
        graph: Graph,
        tell: Callable[[str], None],
    ) -> None:
        self._graph = graph
        self._tell = tell
        self._caller = Caller("proprio_demo", tell, self._each_turn, graph.said)
        self.close = self._caller.close

    def _each_turn(self) -> None:
        _obey_interrupt()
        self._graph.check()

    def wait_until_ready(self) -> None:
        """Wait until a calibration would be accepted: services there, joint states coming."""
        states = threading.Event()
        subscription = self._caller.node.create_subscription(
            JointState, "/joint_states", lambda _: states.set(), 1
        )
        names = ("/identifier/calibrate_robot", "/excitation/run")
        services = {name: self._caller.node.create_client(Trigger, name) for name in names}

        def missing() -> list[str]:
            absent = [name for name, service in services.items() if not service.service_is_ready()]
            return absent if states.is_set() else ["/joint_states", *absent]

        ready = self._caller.spin_until(lambda: not missing())
        self._caller.node.destroy_subscription(subscription)
        if not ready:
            lacks = f"no {', no '.join(missing())}, and not a word for {SILENCE_S:g} s"
            raise ConfigurationError(f"the nodes did not come up: {lacks}; see {self._graph.logs}")

    def call(self, name: str) -> tuple[bool, str]:
        """Call a service and wait for its word."""
        client = self._caller.node.create_client(Trigger, name)
        if not self._caller.spin_until(client.service_is_ready, 30.0):
            raise ConfigurationError(f"{name} is not there; see {self._graph.logs}")
        future = client.call_async(Trigger.Request())
        if not self._caller.spin_until(future.done):
            words = f"{name} gave no answer, and not a word for {SILENCE_S:g} s"
            raise ConfigurationError(f"{words}; see {self._graph.logs}")
        answer = future.result()
        return bool(answer.success), str(answer.message)

    def identify(
        self,
        probe: Probe[Any],
        example: Example,
        weighs: bool,
    ) -> tuple[bool, str]:
        """Calibrate the robot, record a baseline where the probe wants one, and identify the object.

        Args:
            probe: What is identified.
            example: The object.
            weighs: Whether the robot is calibrated with a weight, too.

        Returns:
            Success and sentence of the last service.
        """
        weight = f", then with a weight of {1e3 * REFERENCE_KG:.0f} g" if weighs else ""
        self._tell(
            f"the robot {'weighs' if weighs else 'learns'} itself: with nothing in its hand{weight}"
        )
        asked = time.monotonic()
        accepted, sentence = self.call("/identifier/calibrate_robot")
        # a slow computer
        while sentence.startswith("not ready") and time.monotonic() - asked < NOT_READY_S:
            accepted, sentence = self.call("/identifier/calibrate_robot")
        self._tell(sentence)
        if accepted and isinstance(probe, HasBaseline):
            self._tell(f"now an {probe.baseline.noun} is in its hand")
            accepted, sentence = self.call(f"/identifier/record_{probe.name}_baseline")
            self._tell(sentence)
        if accepted:
            self._tell(example.now)
            accepted, sentence = self.call(f"/identifier/calibrate_{probe.name}")
        return accepted, sentence

    def final_estimate(self, probe: str) -> dict[str, str]:
        """The last word of the identifier on its topic, which may come a moment after the service's answer."""
        self._caller.spin_until(lambda: probe in self._caller.final, 10.0)
        return self._caller.final.get(probe, {})
