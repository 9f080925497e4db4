"""Weighings one after the other for hours: an answer each, or a refusal with its reason; never silence, and no arm is dropped.

With `--minutes` real nodes over DDS, each in a process of its own, beside so many busy programs that the computer has a load of
`--load`. The arm calibrates itself, and is then asked for a weighing every so many seconds. With `--hours` the same in the
simulated world of `test/support/schedules.py`, where nothing else has the processor.

    python test/benchmarks/soak.py --minutes 60 --every 120 --load 8 --json docs/results/soak.json
    python test/benchmarks/soak.py --hours 24 --every 120 --json docs/results/soak_simulated.json
    python test/benchmarks/soak.py --kept FILE.jsonl --json FILE    # of what such a run has kept with --keep
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from results import Results, parser_of
from support.busy_programs import BusyPrograms

MASSES_KG = (0.02, 0.05, 0.08, 0.035)
PROCESSES = ("virtual", "driver", "excitation", "identifier")
STILL_RAD = 0.1
"""An arm that is held between two weighings moves no further."""
AT_REST_S = 3.0
"""After an answer: until then the last push is braked."""
SILENT_S = 115.0
"""A call that has no answer after so long counts as silent."""
SETTLED = 5
"""After so many weighings all is in memory that is kept once."""
CALIBRATIONS = 4
FOLDER_TEXT = re.compile(r"; recording: \S+|/\S+/")


class Load:
    """As many busy programs as a load of the computer wants beside what others run on it."""

    def __init__(self, load: float) -> None:
        self._load = load
        self._programs = BusyPrograms()
        self._ended = threading.Event()
        self.seen: list[float] = []
        self._thread = threading.Thread(target=self._adapt, daemon=True)

    def __enter__(self) -> Load:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._programs.end_all()

    def _adapt(self) -> None:
        while not self._ended.wait(5.0):
            now = os.getloadavg()[0]
            self.seen.append(now)
            if now < self._load - 0.5 and len(self._programs) < self._load:
                self._programs.begin_one()
            elif now > self._load + 0.5 and self._programs:
                self._programs.end_one()


class Watch:
    """What the arm does meanwhile, by the virtual arm's own word and the driver's.

    Args:
        client: Of the nodes, over DDS.
    """

    def __init__(self, client: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticStatus
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Bool
        from support.live import LATCHED

        self._low = self._high = np.array([])
        self._watched = False
        self.lost_torque = 0
        self.driver: list[str] = []
        node = client.node
        node.create_subscription(JointState, "/virtual/motors", self._on_motors, 10)
        node.create_subscription(Bool, "/torque_enabled", self._on_torque, LATCHED)
        node.create_subscription(DiagnosticStatus, "/driver/status", self._on_driver, LATCHED)

    def _on_motors(self, message: Any) -> None:
        if self._watched:
            position = np.array(message.position)
            known = self._low.size > 0
            self._low = np.minimum(self._low, position) if known else position
            self._high = np.maximum(self._high, position) if known else position

    def _on_torque(self, message: Any) -> None:
        self.lost_torque += not message.data

    def _on_driver(self, message: Any) -> None:
        self.driver.append(message.message)

    def moved_rad(self, rest_s: float) -> float:
        """How far a joint moves in a rest of the arm [s]; NaN where nothing was heard."""
        self._low = self._high = np.array([])
        self._watched = True
        time.sleep(rest_s)
        self._watched = False
        return float(np.max(self._high - self._low)) if self._low.size else float("nan")


def resident_MB(process: int | str) -> float:
    """Memory of a process."""
    text = Path(f"/proc/{process}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+)", text)
    return float(found[1]) / 1024.0 if found else float("nan")


def kind_of(success: bool, words: str) -> str:
    """How a weighing ended, by its sentence."""
    if success:
        return "answered"
    return "aborted" if "aborted" in words else "refused"


def concluded(kg: float, success: bool, words: str, final: dict[str, str]) -> dict[str, Any]:
    """What came of a weighing.

    Args:
        kg: The mass in the hand.
        success: Of the service.
        words: Of the service.
        final: Keys and values of the final estimate; empty: it was not heard.

    Returns:
        How it ended, and the answer with its error and half interval [g] where there is one.
    """
    found: dict[str, Any] = {
        "kg": kg,
        "kind": kind_of(success, words),
        "words": FOLDER_TEXT.sub("", words),
    }
    if success and final:
        low, high = json.loads(str(final["payload_mass.ci95"]))
        found |= {
            "error_g": 1e3 * (float(final["payload_mass"]) - kg),
            "half_g": 0.5e3 * (high - low),
            "holds": bool(low <= kg <= high),
        }
    return found


def one_weighing(client: Any, kg: float) -> dict[str, Any]:
    """Ask for it; silence is ended by a cancel, and whoever answers nothing to that, too, is left alone."""
    assert client.set("/virtual", "object", f"{kg}").successful
    client.estimates.clear()
    asked_s = time.monotonic()
    future = client.begin("/identifier/calibrate_payload")
    if not client.wait_for(future.done, SILENT_S):
        said = client.statuses[-1].message if client.statuses else ""
        client.wait_for(client.begin("/identifier/cancel").done, 60.0)
        found = {"kg": kg, "kind": "silent", "words": f"the last words: {said}"}
    else:
        answer = future.result()
        if answer.success:
            client.wait_for(client.final)
        final = client.estimates[-1] if client.estimates and client.final() else {}
        found = concluded(kg, bool(answer.success), str(answer.message), final)
    return {**found, "took_s": round(time.monotonic() - asked_s, 1)}


def calibrated(client: Any) -> list[str]:
    """Have the arm calibrate itself; the sentences of all tries."""
    said = []
    for _ in range(CALIBRATIONS):
        answer = client.call("/identifier/calibrate_robot", 1800.0)
        said.append(FOLDER_TEXT.sub("", str(answer.message)))
        print(f"calibration: {said[-1]}", flush=True)
        if answer.success:
            return said
    raise SystemExit(f"not calibrated: {said}")


def live(
    folder: Path,
    minutes: float,
    every_s: float,
    load: float,
) -> Iterator[dict[str, Any]]:
    """The weighings of so many minutes by real nodes.

    Args:
        folder: For recordings and logs.
        minutes: For how long weighings are asked for.
        every_s: From one to the next.
        load: Of the computer, as `uptime` says it.

    Yields:
        What came of each.
    """
    from support.domains import free_domain
    from support.live import running

    os.environ.setdefault("ROS_DOMAIN_ID", free_domain())
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    identifier = {
        "data_directory": folder / "data",
        "calibration": "none",
        "reference_mass": 0.1,
        "reference_wait": 0.5,
    }
    # it stands for hardware, which waits for none of the programs beside it
    virtual = {"real_time": True}
    with (
        Load(load) as busy,
        running(folder, virtual=virtual, identifier=identifier) as (graph, client),
    ):
        client.hear_less()
        client._executor.create_task(_hear_no_motors, client)
        calibrations = calibrated(client)
        watch = Watch(client)
        time.sleep(1.0)
        lost = watch.lost_torque
        began_s = time.monotonic()
        for number in range(round(60.0 * minutes / every_s)):
            found = one_weighing(client, MASSES_KG[number % len(MASSES_KG)])
            time.sleep(AT_REST_S)
            due_s = began_s + (number + 1) * every_s
            found["moved_rad"] = watch.moved_rad(max(due_s - time.monotonic(), 5.0))
            found["lost_torque"] = watch.lost_torque - lost
            lost = watch.lost_torque
            found["load"] = round(float(np.mean(busy.seen[-int(every_s / 5.0) :])), 1)
            found["MB"] = {
                name: round(resident_MB(process.pid), 1)
                for name, process in graph.processes.items()
            }
            found["calibrations"] = len(calibrations)
            graph.check()
            yield found


def _hear_no_motors(client: Any) -> None:
    """In the thread that spins: all of an hour would be kept."""
    for subscription in list(client.node.subscriptions):
        if subscription.topic_name in ("/virtual/motors", "/diagnostics"):
            client.node.destroy_subscription(subscription)


def simulated(folder: Path, hours: float, every_s: float) -> Iterator[dict[str, Any]]:
    """The weighings of so many hours in the simulated world.

    Args:
        folder: For recordings; empty.
        hours: Of simulated time.
        every_s: From one weighing to the next, of simulated time.

    Yields:
        What came of each.
    """
    from support.schedules import Side, standing

    broken: list[str] = []
    with standing("weigh", folder) as made:
        side = Side(made, "", broken)
        began_s = made.clock.now()
        number = 0
        while made.clock.now() - began_s < 3600.0 * hours:
            side.mass_kg = MASSES_KG[number % len(MASSES_KG)]
            assert side.set("virtual", "object", f"{side.mass_kg}")
            asked_s = made.clock.now()
            said = side.weigh(f"weighing {number}")
            kind, _, words = said.partition(": ")
            final = dict(side.process("identifier").node.results.entries)
            found = concluded(side.mass_kg, kind == "accepted", words, final)
            if not said:
                found["kind"] = "silent"
            found["took_s"] = round(made.clock.now() - asked_s, 1)
            made.clock.sleep(AT_REST_S)
            before = np.array(list(side.robot.arm.position().values()))
            number += 1
            made.clock.sleep(max(began_s + number * every_s - made.clock.now(), 1.0))
            after = np.array(list(side.robot.arm.position().values()))
            found["moved_rad"] = float(np.max(np.abs(after - before)))
            dropped = [
                name for name, servo in side.robot.servos.items() if servo["bus_watchdog"] < 0
            ]
            found["lost_torque"] = len(dropped)
            found["at_h"] = (made.clock.now() - began_s) / 3600.0
            found["cpu_s"] = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
            found["MB"] = {"all in one process": round(resident_MB("self"), 1)}
            found["broken"] = len(broken)
            yield found
            assert not broken, broken


def tell(results: Results, where: str, found: Sequence[dict[str, Any]]) -> None:
    """The table."""
    results.table(
        "soak",
        {
            "where": "{where}",
            "load": "{load}",
            "weighings": "{asked}",
            "accepted": "{answered}",
            "intervals that hold": "{hold} of {known}",
            "refused, aborted": "{refused}, {aborted}",
            "silent": "{silent}",
            "longest answer": "{longest_s:.0f} s",
            "half interval, median": "{half:.1f} g",
            "arm dropped": "{dropped}",
            "memory, then": "{memory}",
        },
    )
    count = {
        kind: sum(one["kind"] == kind for one in found)
        for kind in ("answered", "refused", "aborted", "silent")
    }
    known = [one for one in found if "holds" in one]
    loads = [one["load"] for one in found if "load" in one]
    results.row(
        "soak", where=where, load=f"{min(loads):.0f} to {max(loads):.0f}" if loads else "none", asked=len(found), **count,
        known=len(known), hold=sum(one["holds"] for one in known), longest_s=max(one["took_s"] for one in found),
        half=float(np.median([one["half_g"] for one in known])) if known else float("nan"),
        dropped=sum(one["moved_rad"] > STILL_RAD or one["lost_torque"] > 0 for one in found), memory=memory_of(found),
        each=[one["words"] for one in found if one["kind"] != "answered"],
    )  # fmt: skip


def memory_of(found: Sequence[dict[str, Any]]) -> str:
    """Of each process, once all is there that is kept once, and at the end [MB]."""
    first = found[min(SETTLED, len(found) - 1)]["MB"]
    last = found[-1]["MB"]
    return "; ".join(f"{name} {first[name]:.0f}, {last[name]:.0f} MB" for name in first)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--every", type=float, default=120.0, metavar="S")
    parser.add_argument("--load", type=float, default=8.0)
    parser.add_argument("--keep", type=Path, metavar="FILE.jsonl", help="each weighing, as it ends")
    parser.add_argument("--kept", type=Path, metavar="FILE.jsonl")
    given = parser.parse_args(arguments)
    results = Results(__file__, given.json, arguments)
    found: list[dict[str, Any]] = []
    folder = Path(tempfile.mkdtemp(prefix="proprio_soak_"))
    print(f"recordings and logs: {folder}", flush=True)
    if given.kept:
        found = [json.loads(line) for line in given.kept.read_text().splitlines()]
        weighings: Iterator[dict[str, Any]] = iter(())
    elif given.hours:
        weighings = simulated(folder, given.hours, given.every)
    else:
        weighings = live(folder, given.minutes, given.every, given.load)
    with contextlib.ExitStack() as ends:
        keep = ends.enter_context(given.keep.open("a")) if given.keep else None
        for one in weighings:
            found.append(one)
            print(json.dumps(one), flush=True)
            if keep is not None:
                keep.write(json.dumps(one) + "\n")
                keep.flush()
    where = (
        f"simulated world, {given.hours:g} h" if given.hours else f"over DDS, {given.minutes:g} min"
    )
    tell(results, where, found)
    results.keep()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
