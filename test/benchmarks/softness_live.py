"""Virtual grippers squeeze blocks through the nodes, by services alone, in the simulated world.

Each gripper's hidden numbers (torque constant, friction, armature, delay, encoder errors) are drawn from what its robot file leaves
open. It calibrates itself by closing and opening with nothing in its hand, and then squeezes three blocks that obey a law in closed
form, once each, with the shipped sequence. Their size is stated; the block in the middle is squeezed once more with `block_size`
left at its default.

    python test/benchmarks/softness_live.py [--seeds 1 16] [--sequence softness] [--json FILE]
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from results import Results, each_answer, parser_of

BLOCKS = ((8e3, 0.3), (30e3, 0.13), (150e3, 0.4))
"""Young's modulus [Pa] and Poisson's ratio, as of `squeezes.py`."""
GAP_M = 0.0005
SIZE = "[0.03,0.03,0.03]"
UNSTATED = BLOCKS[1]
"""The block that is squeezed with its size unstated, too."""


def squeezed(seed: int, sequence: str, folder: Path) -> list[dict[str, Any]]:
    """What came of the blocks of one gripper.

    Args:
        seed: Of the virtual arm.
        sequence: The parameter `softness_sequence`; empty: its default.
        folder: For recordings; empty.

    Returns:
        A squeezed block each.
    """
    from support.simulated_live import running

    facts = {
        "robot_sequence": "empty_hand_gripper",
        "live_period": 0.0,
        "report": False,
    }
    if sequence:
        facts["softness_sequence"] = sequence
    found = []
    with running(folder, virtual={"seed": seed}, identifier=facts) as client:
        client.hear_less()
        robot = client.asked("/identifier/calibrate_robot")
        print(f"gripper {seed}: {robot.message}", file=sys.stderr, flush=True)
        for block, size in (*((block, SIZE) for block in BLOCKS), (UNSTATED, "")):
            one = {"seed": seed, "stated": bool(size), **one_block(client, *block, size)}
            print(json.dumps(one), flush=True)
            found.append(one)
    return found


def one_block(client: Any, modulus: float, ratio: float, size: str) -> dict[str, Any]:
    """What came of one block.

    Args:
        client: Of the nodes; the gripper is calibrated.
        modulus: Young's, of the block [Pa].
        ratio: Poisson's, of the block.
        size: The parameter `block_size`; empty: its default.

    Returns:
        Whether it was answered, in which words, after how long [s]; of an answer, error and half interval as shares of the
        modulus, and whether the interval holds.
    """
    held = f"block:{modulus:g},gap={GAP_M:g},nu={ratio:g}"
    assert client.set("/virtual", "object", held).successful
    assert client.set("/identifier", "block_size", size).successful
    asked_s = client.clock.now()
    answer = client.asked("/identifier/calibrate_softness")
    one: dict[str, Any] = {
        "modulus": modulus,
        "ratio": ratio,
        "answered": bool(answer.success and client.wait_for(client.final)),
        "words": answer.message.partition("; calibration")[0],
        "took_s": client.clock.now() - asked_s,
    }
    if one["answered"]:
        final = client.estimates[-1]
        found = float(final["youngs_modulus"])
        low, high = json.loads(final["youngs_modulus.ci95"])
        one |= {
            "error": found / modulus - 1.0,
            "half": 0.5 * (high - low) / found,
            "holds": bool(low <= modulus <= high),
        }
    return one


def row(results: Results, block: str, asked: Sequence[dict[str, Any]]) -> None:
    """Figures of some blocks."""
    known = [one for one in asked if one["answered"]]
    errors = [100.0 * one["error"] for one in known]
    halves = [100.0 * one["half"] for one in known]
    results.row(
        "softness_live", block=block, asked=len(asked), answered=len(known), hold=sum(one["holds"] for one in known),
        rms=np.sqrt(np.mean(np.square(errors or [np.nan]))), worst=np.max(np.abs(errors or [np.nan])),
        half=np.median(halves or [np.nan]), widest=np.max(halves or [np.nan]), time_s=np.median([one["took_s"] for one in asked]),
        **each_answer(errors, halves),
    )  # fmt: skip


def tell_blocks(results: Results, found: Sequence[dict[str, Any]]) -> None:
    """The table of the blocks whose size was stated."""
    results.table(
        "softness_live",
        {
            "block": "{block}",
            "answered": "{answered} of {asked}",
            "interval holds": "{hold}",
            "rms, worst error": "{rms:.1f}, {worst:.1f} %",
            "half interval: median, widest": "{half:.0f}, {widest:.0f} %",
            "time": "{time_s:.0f} s",
        },
    )
    for modulus, ratio in BLOCKS:
        of_block = [one for one in found if one["modulus"] == modulus]
        row(results, f"{1e-3 * modulus:g} kPa, {ratio:g}", of_block)
    row(results, "all", found)


def tell_sizes(results: Results, found: Sequence[dict[str, Any]]) -> None:
    """The table of what an unstated size costs."""
    results.table(
        "size",
        {
            f"block.size of the block of {1e-3 * UNSTATED[0]:g} kPa": "{size}",
            "answered": "{answered} of {asked}",
            "half interval: median, widest": "{half:.0f}, {widest:.0f} %",
            "time": "{time_s:.0f} s",
        },
    )
    for stated, words in ((True, "stated"), (False, "left at its default")):
        asked = [one for one in found if one["stated"] == stated]
        halves = [100.0 * one["half"] for one in asked if one["answered"]]
        results.row(
            "size",
            size=words,
            asked=len(asked),
            answered=len(halves),
            half=np.median(halves or [np.nan]),
            widest=np.max(halves or [np.nan]),
            time_s=np.median([one["took_s"] for one in asked]),
        )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(1, 16), metavar=("FIRST", "COUNT"))
    parser.add_argument("--sequence", default="", help="the parameter softness_sequence")
    parser.add_argument("--kept", type=Path, nargs="+", help="what such runs have printed")
    given = parser.parse_args(arguments)
    results = Results(__file__, given.json, arguments)
    found: list[dict[str, Any]] = []
    for log in given.kept or ():
        found += [json.loads(line) for line in log.read_text().splitlines() if line[:1] == "{"]
    first, count = given.seeds
    for seed in () if given.kept else range(first, first + count):
        with tempfile.TemporaryDirectory() as folder:
            found += squeezed(seed, given.sequence, Path(folder))
    tell_blocks(results, [one for one in found if one["stated"]])
    tell_sizes(results, [one for one in found if one["modulus"] == UNSTATED[0]])
    results.keep()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
