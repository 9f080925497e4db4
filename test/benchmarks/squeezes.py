"""Do the squeeze's intervals hold? Random virtual grippers, three blocks each, from the machine's first command to the modulus.

    python test/benchmarks/squeezes.py [--robots 16]        # three minutes

Torque constant, friction, armature, delay and encoder errors are drawn as the robot file says that robots differ, and hidden;
MuJoCo moves the fingers, and the block obeys a law in closed form. The gripper is calibrated on four runs with nothing between
its fingers.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from results import Results, each_answer, parser_of
from support.squeezing import GAP_M, calibrated, squeezed

from proprio_ros.probes.softness.virtual_object import SoftBlock
from proprio_ros.quantity import Z95
from proprio_ros.robot import Robot

BLOCKS = ((8e3, 0.3), (30e3, 0.13), (150e3, 0.4))
FIRST_SEED = 10
"""The tests have those below."""


@dataclass(frozen=True)
class Squeezed:
    """One answer: error and half interval as parts of the modulus, and whether Poisson's ratio was told and holds."""

    off: float
    half: float
    holds: bool
    ratio_known: bool
    ratio_holds: bool


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=16)
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    found: dict[tuple[float, float], list[Squeezed]] = {block: [] for block in BLOCKS}
    for seed in range(options.first, options.first + options.robots):
        robot = calibrated(seed)
        for modulus, ratio in BLOCKS:
            each = squeeze(robot, seed, modulus, ratio)
            if each is not None:
                found[modulus, ratio].append(each)
        print(
            f"robot {seed} of {options.first} to {options.first + options.robots - 1}",
            file=sys.stderr,
        )
    tell(results, found, options.robots)
    results.keep()


def squeeze(robot: Robot, seed: int, modulus: float, ratio: float) -> Squeezed | None:
    """A block squeezed by a calibrated gripper; a refusal is printed, and is None.

    Args:
        robot: The gripper, as it was calibrated.
        seed: Of the hidden one.
        modulus: The block's [Pa].
        ratio: Poisson's, of the block.
    """
    block = SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=ratio, damping=0.5)
    _, estimate, _ = squeezed(robot, seed, block)
    told = estimate.value("youngs_modulus")
    told_ratio = estimate.value("poissons_ratio")
    if not isinstance(told.value, float) or not isinstance(told.std, float):
        print(
            f"robot {seed}, {1e-3 * modulus:g} kPa: {estimate.verdict.value}, {'; '.join(estimate.reasons)}"
        )
        return None
    known = told_ratio.value is not None
    return Squeezed(
        off=told.value / modulus - 1.0,
        half=Z95 * told.std / told.value,
        holds=told.ci95[0] <= modulus <= told.ci95[1],
        ratio_known=known,
        ratio_holds=known and told_ratio.ci95[0] <= ratio <= told_ratio.ci95[1],
    )


def tell(
    results: Results,
    found: Mapping[tuple[float, float], Sequence[Squeezed]],
    robots: int,
) -> None:
    """A row for each block.

    Args:
        results: Has the table.
        found: The answers, by modulus [Pa] and Poisson's ratio.
        robots: How many were asked.
    """
    results.table(
        "squeezes",
        {
            "block": "{kPa:g} kPa, {ratio:g}",
            "answers": "{answered} of {asked}",
            "interval holds": "{hold}",
            "rms, worst error": "{rms:.1f}, {worst:.1f} %",
            "median half interval": "{half:.0f} %",
            "Poisson's ratio identified, holds": "{ratio_answered}, {ratio_hold}",
        },
    )
    for (modulus, ratio), answers in found.items():
        if not answers:
            continue
        off = np.array([each.off for each in answers])
        half = np.array([each.half for each in answers])
        results.row(
            "squeezes",
            kPa=1e-3 * modulus,
            ratio=ratio,
            answered=len(answers),
            asked=robots,
            hold=sum(each.holds for each in answers),
            rms=100.0 * np.sqrt(np.mean(off**2)),
            worst=100.0 * np.abs(off).max(),
            half=100.0 * np.median(half),
            ratio_answered=sum(each.ratio_known for each in answers),
            ratio_hold=sum(each.ratio_holds for each in answers),
            **each_answer(100.0 * off, 100.0 * half),
        )


if __name__ == "__main__":
    main()
