"""Do the squeeze's intervals hold? Random virtual grippers, three blocks each, from the machine's first command to the modulus.

    python test/benchmarks/squeezes.py [--robots 16]        # three minutes

Torque constant, friction, armature, delay and encoder errors are drawn as the robot file says that robots differ, and hidden;
MuJoCo moves the fingers, and the block obeys a law in closed form. The gripper is calibrated on four runs with nothing between
its fingers.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from results import Results, each_answer, parser_of
from support.squeezing import GAP_M, calibrated, squeezed

from proprio_ros.probes.softness.virtual_object import SoftBlock
from proprio_ros.quantity import Z95

BLOCKS = ((8e3, 0.3), (30e3, 0.13), (150e3, 0.4))
FIRST_SEED = 10
"""The tests have those below."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=16)
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    rows: dict[tuple[float, float], list[tuple[float, ...]]] = {block: [] for block in BLOCKS}
    for seed in range(options.first, options.first + options.robots):
        robot = calibrated(seed)
        for modulus, ratio in BLOCKS:
            block = SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=ratio, damping=0.5)
            _, estimate, _ = squeezed(robot, seed, block)
            found = estimate.value("youngs_modulus")
            found_ratio = estimate.value("poissons_ratio")
            if not isinstance(found.value, float) or not isinstance(found.std, float):
                print(
                    f"robot {seed}, {1e-3 * modulus:g} kPa: {estimate.verdict.value}, {'; '.join(estimate.reasons)}"
                )
                continue
            holds = found.ci95[0] <= modulus <= found.ci95[1]
            known = found_ratio.value is not None
            ratio_holds = known and found_ratio.ci95[0] <= ratio <= found_ratio.ci95[1]
            rows[modulus, ratio].append(
                (
                    found.value / modulus - 1.0,
                    Z95 * found.std / found.value,
                    holds,
                    known,
                    ratio_holds,
                )
            )
        print(
            f"robot {seed} of {options.first} to {options.first + options.robots - 1}",
            file=sys.stderr,
        )
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
    for (modulus, ratio), answers in rows.items():
        if answers:
            off, half, held, known_, ratio_held = np.array(answers, dtype=float).T
            results.row(
                "squeezes", kPa=1e-3 * modulus, ratio=ratio, answered=len(answers), asked=options.robots,
                hold=int(held.sum()), rms=100.0 * np.sqrt(np.mean(off**2)), worst=100.0 * np.abs(off).max(),
                half=100.0 * np.median(half), ratio_answered=int(known_.sum()), ratio_hold=int(ratio_held.sum()),
                **each_answer(100.0 * off, 100.0 * half),
            )  # fmt: skip
    results.keep()


if __name__ == "__main__":
    main()
