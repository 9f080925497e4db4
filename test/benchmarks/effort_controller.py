"""A robot behind a controller of somebody else's, calibrated and then asked for masses by services alone, in real time.

Nodes in processes of their own: a virtual arm that takes and keeps efforts as `forward_command_controller` does (joint states at
500 Hz in the order of the alphabet, with two foreign joints and without velocities), the excitation node, which holds it, and the
identifier. A probe that was interrupted is asked for again; a rejected one is not, and counts. With ``--so101`` it is an SO-101
under its servos' own position law, behind a position controller: goals and positions alone, 30 times a second (``--rate``).

    python test/benchmarks/effort_controller.py --data DIR [--seed 1] [--masses 0.02 0.05 0.08 0.12 0.15]
    python test/benchmarks/effort_controller.py --data DIR --so101 [--seed 1] [--rate 30]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from support.domains import free_domain

INTERRUPTED = ("aborted", "refuses", "not ready", "fallen silent")
ATTEMPTS = 5
SEQUENCES = {"robot": "empty_hand", "reference": "reference", "payload": "payload"}
ORDER = ["joint3", "gripper_left_joint", "joint1", "joint4", "joint2"]
SO101 = ["gripper", "elbow_flex", "shoulder_pan", "wrist_roll", "wrist_flex", "shoulder_lift"]


def asked(client: Any, service: str) -> tuple[Any, int]:
    """The answer, and how often it was asked for."""
    attempts = 0
    while True:
        attempts += 1
        answer = client.call(service, 1800.0)
        interrupted = not answer.success and any(words in answer.message.split(";")[0] for words in INTERRUPTED)
        if not interrupted or attempts == ATTEMPTS:
            return answer, attempts
        print(f"  interrupted: {answer.message}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder for recordings, calibration and logs")
    parser.add_argument("--seed", type=int, default=1, help="of the arm's hidden numbers")
    parser.add_argument("--masses", type=float, nargs="+", metavar="KG")
    parser.add_argument("--so101", action="store_true")
    parser.add_argument("--rate", type=float, default=30.0, help="of the SO-101's joint states [Hz]")
    parser.add_argument("--unit", choices=("A", "N.m"), default="A")
    parser.add_argument("--calibration", default="none")
    given = parser.parse_args(arguments)
    masses = given.masses or ([0.0, 0.05, 0.1, 0.2] if given.so101 else [0.02, 0.05, 0.08, 0.12, 0.15])
    os.environ.setdefault("ROS_DOMAIN_ID", free_domain())
    from support.live import replayed_alike, running, wait_for, warm_up

    warm_up("payload")
    given.data.mkdir(parents=True, exist_ok=True)
    stated = ["payload.com=[0,0,0]", "payload.shape=point"]
    facts = {
        "settings": stated, "reference_settings": stated, "reference_mass": 0.1, "reference_wait": 1.0,
        "calibration": given.calibration, "data_directory": given.data / "data",
    }  # fmt: skip
    controller = {"controller_joints": ORDER, "effort_unit": given.unit}
    driver = {"interface": "effort_controller", "seed": given.seed, **controller}
    output = {"command_interface": "effort", **controller}
    if given.so101:
        arm = {"robot": "so101", "controller_joints": SO101}
        driver = {"interface": "position_controller", "seed": given.seed, "state_rate": given.rate, **arm}
        output = {"command_interface": "position", **arm}
        facts |= {"robot": "so101", **{f"{kind}_sequence": f"so101_{name}" for kind, name in SEQUENCES.items()}}
    with running(given.data, "virtual", "excitation", "identifier", virtual=driver, excitation=output, identifier=facts) as (
        _,
        client,
    ):
        for subscription in list(client.node.subscriptions):  # 500 joint states a second are much for a test's client
            if subscription.topic_name in ("/joint_states", "/applied_effort"):
                client.node.destroy_subscription(subscription)
        if given.calibration == "none":
            begun = time.monotonic()
            answer, attempts = asked(client, "/identifier/calibrate_robot")
            print(f"robot: {answer.message} ({attempts} asked, {time.monotonic() - begun:.0f} s)", flush=True)
            if not answer.success:
                return 1
        worst_g, held = 0.0, list[bool]()
        for mass in masses:
            assert client.set("/virtual", "object", mass or "none").successful
            client.masses.clear()
            begun = time.monotonic()
            answer, attempts = asked(client, "/identifier/calibrate_payload")
            took = f"({attempts} asked, {time.monotonic() - begun:.0f} s)"
            if not answer.success:
                worst_g = float("inf")
                print(f"{1e3 * mass:6.1f} g: {answer.message} {took}", flush=True)
                continue
            assert wait_for(lambda: bool(client.masses), 5.0)
            error_g = 1e3 * (client.masses[-1] - mass)
            worst_g = max(worst_g, abs(error_g))
            low, high = json.loads(client.estimates[-1]["payload_mass.ci95"])
            held.append(low <= mass <= high)
            print(f"{1e3 * mass:6.1f} g: {error_g:+.2f} g; {answer.message} {took}", flush=True)
    print(f"largest error {worst_g:.2f} g; {sum(held)} of {len(masses)} intervals hold")
    if not (all(held) and len(held) == len(masses)) if given.so101 else worst_g > 1.5:
        return 1
    replayed_alike(sorted((given.data / "data").glob("*_payload/estimate.json"))[-1])
    print("the last recording, replayed, gave the same numbers bit for bit")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
