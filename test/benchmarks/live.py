"""Virtual arms weighed through the nodes, by services alone, in the simulated world.

Each arm's hidden numbers (torque constants, friction, armature, delay, encoder errors) are drawn from what its robot file leaves
open. It calibrates itself and then weighs: through this package's driver, with and without a reference object, and with links
that differ from the URDF; through a controller of somebody else's that takes efforts (joint states at 500 Hz in the order of the
alphabet, with two foreign joints and without velocities); and an SO-101 under its servos' own position law, by steps of goals,
with positions alone 30 times a second. What is not answered is asked for three times at most.

    python test/benchmarks/live.py [--seeds 1 3] [--ways "effort controller, A"] [--json FILE]
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from foreign_controller import asked, held
from results import Results, parser_of

BUS = ("virtual", "driver", "excitation", "identifier")
TOPICS = ("virtual", "excitation", "identifier")
FIVE_KG = (0.01, 0.02, 0.023, 0.05, 0.1)
HEAVIER_KG = (0.02, 0.05, 0.08, 0.12, 0.15)
SO101_KG = (0.0, 0.05, 0.1, 0.2)
STATED = ["payload.com=[0,0,0]", "payload.shape=point"]
REFERENCE = {"reference_mass": 0.1, "reference_wait": 1.0, "reference_settings": STATED}
ORDER = ["joint3", "gripper_left_joint", "joint1", "joint4", "joint2"]
SO101 = {
    "robot": "so101",
    "controller_joints": [
        "gripper",
        "elbow_flex",
        "shoulder_pan",
        "wrist_roll",
        "wrist_flex",
        "shoulder_lift",
    ],
}


@dataclass(frozen=True)
class Way:
    """How an arm is driven and calibrated: which nodes there are, with which parameters, and what is put into its hand [kg]."""

    nodes: tuple[str, ...] = BUS
    masses_kg: tuple[float, ...] = FIVE_KG
    virtual: Mapping[str, Any] = field(default_factory=dict)
    excitation: Mapping[str, Any] = field(default_factory=dict)
    identifier: Mapping[str, Any] = field(default_factory=lambda: REFERENCE)


def efforts(unit: str) -> Way:
    """Through a controller that takes efforts in this unit."""
    controller = {"controller_joints": ORDER, "effort_unit": unit}
    virtual = {"interface": "effort_controller", **controller}
    return Way(TOPICS, HEAVIER_KG, virtual, {"command_interface": "effort", **controller})


_SO101_SEQUENCES = {f"{kind}_sequence": f"so101_{name}" for kind, name in
                    (("robot", "empty_hand"), ("reference", "reference"), ("payload", "payload"))}  # fmt: skip
WAYS = {
    "driver; empty hand only": Way(identifier={}),
    "driver; and a reference of 100 g": Way(),
    "driver; and links that differ from the URDF": Way(virtual={"links": True}),
    "effort controller, A": efforts("A"),
    "effort controller, N m": efforts("N.m"),
    "SO-101, goals at 30 Hz": Way(
        TOPICS,
        SO101_KG,
        {"interface": "position_controller", "state_rate": 30.0, **SO101},
        {"command_interface": "position", **SO101},
        {"robot": "so101", **REFERENCE, **_SO101_SEQUENCES},
    ),
}


def weighed(
    way: Way,
    seed: int,
    folder: Path,
) -> dict[str, Any]:
    """What came of one arm, as `foreign_controller.asked` has it."""
    from support.simulated_live import running

    facts = {
        "settings": STATED,
        "live_period": 0.0,
        "report": False,
        **way.identifier,
    }
    parameters = {
        "virtual": {"seed": seed, **way.virtual},
        "excitation": dict(way.excitation),
        "identifier": facts,
    }
    with running(folder, *way.nodes, **parameters) as client:
        client.hear_less()

        def once(what: str, kg: float) -> bool:
            assert client.set("/virtual", "object", f"{kg}" if kg else "none").successful
            answer = client.asked(f"/identifier/calibrate_{what}")
            print(f"  {what} {1e3 * kg:g} g: {answer.message}", flush=True)
            return bool(answer.success) and client.wait_for(client.final)

        return asked(
            once,
            lambda: client.estimates[-1],
            way.masses_kg,
        )


def row(
    results: Results,
    way: str,
    mass: str,
    asked_for: Sequence[dict[str, Any]],
) -> None:
    """Figures of some answers, each with its truth."""
    known = [one for one in asked_for if one["known"]]
    off_g = 1e3 * np.array([one["value"] - one["kg"] for one in known] or [math.nan])
    results.row(
        "live", way=way, held=mass, asked=len(asked_for), answered=len(known), again=sum(one["asked"] > 1 for one in asked_for),
        rms=np.sqrt(np.mean(off_g**2)), worst=np.abs(off_g).max(),
        half=np.median([0.5e3 * (one["high"] - one["low"]) for one in known] or [math.nan]), **held(known),
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--seeds",
        type=int,
        nargs=2,
        default=(1, 3),
        metavar=("FIRST", "COUNT"),
    )
    parser.add_argument(
        "--ways",
        nargs="+",
        default=list(WAYS),
        choices=WAYS,
        metavar="WAY",
    )
    given = parser.parse_args(arguments)
    results = Results(__file__, given.json, arguments)
    first, count = given.seeds
    found: dict[str, list[dict[str, Any]]] = {}
    for way in given.ways:
        how = WAYS[way]
        for seed in range(first, first + count):
            with tempfile.TemporaryDirectory() as folder:
                told = weighed(how, seed, Path(folder))
            print(
                f"{way}, arm {seed}: {'' if told['robot'] else 'not '}calibrated, asked {told['asked']} times",
                flush=True,
            )
            unasked = [{"kg": kg, "asked": 0, "known": False} for kg in how.masses_kg]
            found.setdefault(way, []).extend(told["masses"] or unasked)
    results.table(
        "live",
        {
            "through; calibrated with": "{way}",
            "held": "{held}",
            "answered": "{answered} of {asked}",
            "asked again": "{again}",
            "error rms, worst": "{rms:.2f}, {worst:.2f} g",
            "median half interval": "{half:.2f} g",
            "intervals that hold": "{hold} of {answered}",
            "farthest, in sd": "{farthest:.1f}",
        },
    )
    for way, answers in found.items():
        for kg in WAYS[way].masses_kg:
            row(
                results,
                way,
                f"{1e3 * kg:g} g" if kg else "nothing",
                [one for one in answers if one["kg"] == kg],
            )
        row(results, way, "all", answers)
    results.keep()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
