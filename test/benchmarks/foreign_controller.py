"""Somebody else's arm behind an effort or position controller on a busy computer, calibrated and weighed from its URDF.

In simulated time, see test/support/foreign_live.py. A calibration and a weighing are asked for three times at most.

python test/benchmarks/foreign_controller.py --seeds 0 20 [--goals --rate 30] [--masses 0.02 0.2 1.0] [--json FILE]
python test/benchmarks/foreign_controller.py --seeds 0 20 --goals --rate 100 --masses 0.2 0.5 1.0 --stiffness 1 2 4 8 12 16
python test/benchmarks/foreign_controller.py --told LOG.. --json FILE     # of what such runs have printed
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from results import Results, each_answer, parser_of
from support.foreign_arm import STIFFNESS_PER_RAD

ASKED = 3
MASSES_KG = (0.02, 0.2, 1.0)


def asked(
    once: Callable[[str, float], bool],
    newest: Callable[[], Mapping[str, str]],
    masses_kg: Sequence[float],
) -> dict[str, Any]:
    """How often one arm was asked to calibrate itself and to weigh, and the answers; ``once`` asks for one with a mass [kg]."""

    def often(
        what: str,
        kg: float,
    ) -> tuple[bool, int]:
        count = 0
        known = False
        while not known and count < ASKED:
            count = count + 1
            known = once(what, kg)
        return known, count

    learnt, count = often("robot", 0.0)
    told: dict[str, Any] = {
        "robot": learnt,
        "asked": count,
        "masses": [],
    }
    for kg in masses_kg if learnt else ():
        known, count = often("payload", kg)
        one: dict[str, Any] = {
            "kg": kg,
            "asked": count,
            "known": known,
        }
        if known:
            final = newest()
            low, high = json.loads(final["payload_mass.ci95"])
            one |= {
                "value": float(final["payload_mass"]),
                "std": float(final["payload_mass.std"]),
                "low": low,
                "high": high,
            }
        told["masses"].append(one)
    return told


def about(
    seed: int,
    goals: bool,
    rate_hz: float,
    busy: Any,
) -> dict[str, Any]:
    """Which arm, and how its computer is busy (`support.foreign_arm.Busy`)."""
    delays_ms = {
        "delay_ms": 1e3 * busy.delay_s,
        "jitter_ms": 1e3 * busy.jitter_s,
    }
    return {"seed": seed, "goals": goals, "rate_hz": rate_hz, **delays_ms}


def weighed(
    seed: int,
    folder: Path,
    goals: bool,
    rate_hz: float,
    masses_kg: Sequence[float],
    stiffness_per_rad: float,
) -> dict[str, Any]:
    """What came of one arm: how often it was asked to calibrate itself, and of each mass the answer and how often it was asked."""
    from support.foreign_live import foreign

    begun = time.process_time()
    with foreign(folder, seed, goals, rate_hz, stiffness_per_rad=stiffness_per_rad) as (
        client,
        arm,
    ):

        def once(what: str, kg: float) -> bool:
            arm.hold(kg)
            client.clock.sleep(3.0)
            client.estimates.clear()
            answer = client.asked(f"/identifier/calibrate_{what}")
            print(f"  {what}: {answer.message}", flush=True)
            return bool(answer.success) and client.wait_for(client.final)

        told = asked(once, lambda: client.estimates[-1], masses_kg)
        busy = arm.busy
        log = "\n".join(f"{at:.2f} {name}: {text}" for at, name, _, text in client.world.graph.log)
    (folder / "excitation.log").write_text(log)
    return {
        **about(seed, goals, rate_hz, busy),
        "stiffness_per_rad": stiffness_per_rad,
        **told,
        "cpu_s": round(time.process_time() - begun, 1),
    }


def again(asked: int) -> str:
    """How often it was asked for, where that was more than once."""
    return f", asked {asked} times" if asked > 1 else ""


def cell(
    masses: Sequence[dict[str, Any]],
    kg: float,
) -> str:
    """The answer and its interval in g."""
    of = [one for one in masses if one["kg"] == kg]
    if not of:
        return "-"
    (one,) = of
    if not one["known"]:
        return f"refused{again(one['asked'])}"
    low, value, high = (1e3 * one[name] for name in ("low", "value", "high"))
    return f"{value:.1f} ({low:.1f} to {high:.1f}){again(one['asked'])}"


def held(known: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How many intervals hold, and how far off the farthest answer is, in its standard deviations."""
    farthest = max((abs(one["value"] - one["kg"]) / one["std"] for one in known), default=0.0)
    return {
        "hold": sum(one["low"] <= one["kg"] <= one["high"] for one in known),
        "farthest": farthest,
        **each_answer(
            [1e3 * (one["value"] - one["kg"]) for one in known],
            [1e3 * (one["high"] - one["value"]) for one in known],
        ),
    }


def tell_of_stiffnesses(
    results: Results,
    found: Sequence[dict[str, Any]],
    masses: int,
) -> None:
    """A row for each stiffness of position servos, by which so many masses were asked for."""
    results.table("stiffnesses", {
        "largest torques per rad": "{servo:g}", "arms": "{arms}", "calibrated": "{calibrated}",
        "answered at the first try": "{first} of {asked}",
        "intervals that hold": "{hold}", "half width at 500 g, median": "{half_g:.0f} g",
    })  # fmt: skip
    for servo in sorted({each["stiffness_per_rad"] for each in found}):
        mine = [each for each in found if each["stiffness_per_rad"] == servo]
        weighed = [one for each in mine for one in each["masses"]]
        known = [one for one in weighed if one["known"]]
        halves_g = [1e3 * (one["high"] - one["value"]) for one in known if one["kg"] == 0.5]
        results.row(
            "stiffnesses",
            servo=servo,
            arms=len(mine),
            calibrated=sum(each["robot"] for each in mine),
            first=sum(one["known"] and one["asked"] == 1 for one in weighed),
            asked=masses * len(mine),
            half_g=median(halves_g) if halves_g else math.nan,
            hold=held(known)["hold"],
        )


def tell(
    found: Sequence[dict[str, Any]],
    script: str,
    kept: Path | None,
    arguments: Sequence[str] | None,
) -> None:
    """Tables of what came of some arms."""
    results = Results(script, kept, arguments)
    masses_kg = list(dict.fromkeys(one["kg"] for each in found for one in each["masses"]))
    columns = {
        "seed": "{seed}",
        "efforts come late by": "{delay_ms:.0f} +- {jitter_ms:.0f} ms",
        "calibrated": "{calibrated}",
    }
    results.table(
        "arms",
        {
            **columns,
            **{f"{1e3 * kg:g} g": f"{{m{number}}}" for number, kg in enumerate(masses_kg)},
        },
    )
    for each in sorted(found, key=lambda each: each["delay_ms"]):
        row = {name: each[name] for name in ("seed", "delay_ms")} | {
            "jitter_ms": 0.5 * each["jitter_ms"]
        }
        calibrated = ("yes" if each["robot"] else "no") + again(each["asked"])
        cells = {f"m{number}": cell(each["masses"], kg) for number, kg in enumerate(masses_kg)}
        results.row("arms", **row, calibrated=calibrated, **cells)
    known = [one for each in found for one in each["masses"] if one["known"]]
    whole = {
        "arms": len(found),
        "calibrated": sum(each["robot"] for each in found),
        "answers": len(known),
    }
    whole["asked"] = len(found) * len(masses_kg)
    whole |= held(known)
    results.table("all", {
        "arms": "{arms}", "calibrated": "{calibrated}", "masses answered": "{answers} of {asked}",
        "intervals that hold": "{hold}", "farthest, in sd": "{farthest:.1f}",
    })  # fmt: skip
    results.row("all", **whole)
    if len({each.get("stiffness_per_rad") for each in found}) > 1:
        tell_of_stiffnesses(results, found, len(masses_kg))
    results.keep()


def logged(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """What came of the arms that some logs tell of."""
    lines = [
        line
        for path in paths
        for line in path.read_text().splitlines()
        if line.startswith('{"seed"')
    ]
    return list(map(json.loads, lines))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--seeds",
        type=int,
        nargs=2,
        default=(0, 20),
        metavar=("FIRST", "COUNT"),
    )
    parser.add_argument(
        "--masses",
        type=float,
        nargs="+",
        default=list(MASSES_KG),
        metavar="KG",
    )
    parser.add_argument("--goals", action="store_true")
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument(
        "--stiffness",
        type=float,
        nargs="+",
        default=[STIFFNESS_PER_RAD],
        metavar="PER_RAD",
    )
    parser.add_argument("--data", type=Path)
    parser.add_argument("--told", type=Path, nargs="+", metavar="LOG")
    given = parser.parse_args(arguments)
    found = logged(given.told or ())
    for seed in () if given.told else range(given.seeds[0], given.seeds[0] + given.seeds[1]):
        stiffness_per_rad = given.stiffness[seed % len(given.stiffness)]
        folder = (given.data or Path(tempfile.mkdtemp())) / f"seed{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        found.append(
            weighed(
                seed,
                folder,
                given.goals,
                given.rate,
                given.masses,
                stiffness_per_rad,
            )
        )
        print(json.dumps(found[-1]), flush=True)
    tell(found, __file__, given.json, arguments)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
