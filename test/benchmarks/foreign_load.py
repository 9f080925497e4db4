"""The arms of `foreign_controller.py` in real time over DDS, beside as many busy programs as are asked for.

Processes of their own: the arm (`foreign_process.py`), excitation, identifier, a client that calls services, and the load. A
calibration and a weighing are asked for three times at most.

python test/benchmarks/foreign_load.py --data DIR [--seeds 0 4] [--load 8] [--goals --rate 30] [--json FILE]
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from foreign_controller import ASKED, MASSES_KG, tell
from results import parser_of
from support.domains import free_domain

REFERENCE_KG = 0.5


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """So many programs that never wait."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def weighed(seed: int, folder: Path, load: int, goals: bool, rate_hz: float, masses_kg: Sequence[float]) -> dict[str, Any]:
    """As `foreign_controller.weighed`, in real time."""
    from std_msgs.msg import Float64
    from support.foreign_arm import ORDER, Busy, write_urdf
    from support.foreign_live import state_servos
    from support.live import running

    from proprio_ros.cli import main as proprio

    robot, begun = folder / "foreign.yaml", time.monotonic()
    assert proprio(["robot", "new", str(write_urdf(folder)), "--output", str(robot), "--effort-unit", "N.m", "--force"]) == 0
    stated = ["payload.com=[0,0,0]", "payload.shape=point"]
    identifier = {
        "robot": robot, "reference_mass": REFERENCE_KG, "reference_wait": 3.0, "settings": stated, "reference_settings": stated,
        "calibration": "none", "live_period": 0.0, "data_directory": folder / "data", "report": False,
    }  # fmt: skip
    output: dict[str, Any] = {"robot": robot, "controller_joints": list(ORDER), "command_interface": "position"}
    if goals:
        state_servos(robot)
    else:
        output |= {"command_interface": "effort", "effort_unit": "N.m"}
    words = ["--seed", str(seed), "--rate", str(rate_hz), *(["--goals"] if goals else [])]
    with contextlib.ExitStack() as ends:
        arm = subprocess.Popen([sys.executable, str(Path(__file__).with_name("foreign_process.py")), *words])
        ends.callback(arm.wait)
        ends.callback(arm.kill)
        ends.enter_context(busy(load))
        nodes = {"excitation": output, "identifier": identifier}
        _, client = ends.enter_context(running(folder, "excitation", "identifier", **nodes))
        for subscription in list(client.node.subscriptions):  # 500 joint states a second are much for a client
            if subscription.topic_name in ("/joint_states", "/applied_effort", "/joint_command"):
                client.node.destroy_subscription(subscription)
        hand = client.node.create_publisher(Float64, "/hand", 1)

        def person() -> None:
            if client.statuses and "put the reference" in client.statuses[-1].message:
                hand.publish(Float64(data=REFERENCE_KG))

        client.node.create_timer(0.2, person)

        def ask(what: str, kg: float) -> tuple[bool, int]:
            for asked in range(1, ASKED + 1):  # noqa: B007
                hand.publish(Float64(data=kg))
                time.sleep(3.0)
                answer = client.call(f"/identifier/calibrate_{what}", 1800.0)
                print(f"  {what}: {answer.message}", flush=True)
                if answer.success:
                    break
            return bool(answer.success), asked

        drawn, (learnt, asked) = Busy.draw(seed), ask("robot", 0.0)
        told: dict[str, Any] = {
            "seed": seed, "goals": goals, "rate_hz": rate_hz, "delay_ms": 1e3 * drawn.delay_s, "jitter_ms": 1e3 * drawn.jitter_s,
            "robot": learnt, "asked": asked, "masses": [],
        }  # fmt: skip
        for kg in masses_kg if learnt else ():
            known, asked = ask("payload", kg)
            one: dict[str, Any] = {"kg": kg, "asked": asked, "known": known}
            if known:
                time.sleep(1.0)
                final = client.estimates[-1]
                low, high = json.loads(final["payload_mass.ci95"])
                one |= {"value": float(final["payload_mass"]), "std": float(final["payload_mass.std"]), "low": low, "high": high}
            told["masses"].append(one)
    return {**told, "cpu_s": round(time.monotonic() - begun, 1)}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 4), metavar=("FIRST", "COUNT"))
    parser.add_argument("--masses", type=float, nargs="+", default=list(MASSES_KG), metavar="KG")
    parser.add_argument("--load", type=int, default=8)
    parser.add_argument("--goals", action="store_true")
    parser.add_argument("--rate", type=float, default=500.0)
    given = parser.parse_args(arguments)
    os.environ.setdefault("ROS_DOMAIN_ID", free_domain())
    found = []
    for seed in range(given.seeds[0], given.seeds[0] + given.seeds[1]):
        folder = given.data / f"seed{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        found.append(weighed(seed, folder, given.load, given.goals, given.rate, given.masses))
        print(json.dumps(found[-1]), flush=True)
    tell(found, __file__, given.json, arguments)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
