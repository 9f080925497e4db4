"""Do the squeeze's intervals hold? Random virtual grippers, three blocks each, from the machine's first command to the modulus.

    python test/benchmarks/squeezes.py [ROBOTS]        # default 16, three minutes

Torque constant, friction, armature, delay and encoder errors are drawn as the robot file says that robots differ, and hidden;
MuJoCo moves the fingers, and the block obeys a law in closed form. The gripper learns itself on four runs with nothing between
its fingers.
"""

from __future__ import annotations

import sys

import numpy as np
from test_softness import GAP_M, calibrated, squeezed

from proprio_ros.quantity import Z95
from proprio_ros.virtual.objects import SoftBlock

BLOCKS = ((8e3, 0.3), (30e3, 0.13), (150e3, 0.4))
FIRST_SEED = 10
"""The tests have those below."""


def main() -> None:
    robots = int(sys.argv[1]) if len(sys.argv) > 1 else 16
    rows: dict[tuple[float, float], list[tuple[float, ...]]] = {block: [] for block in BLOCKS}
    for seed in range(FIRST_SEED, FIRST_SEED + robots):
        robot = calibrated(seed)
        for modulus, ratio in BLOCKS:
            block = SoftBlock(modulus, gap_m=GAP_M, poissons_ratio=ratio, damping=0.5)
            _, estimate, _ = squeezed(robot, seed, block)
            told, told_ratio = estimate.value("youngs_modulus"), estimate.value("poissons_ratio")
            if not isinstance(told.value, float) or not isinstance(told.std, float):
                print(f"robot {seed}, {1e-3 * modulus:g} kPa: {estimate.verdict.value}, {'; '.join(estimate.reasons)}")
                continue
            holds = told.ci95[0] <= modulus <= told.ci95[1]
            known = told_ratio.value is not None
            ratio_holds = known and told_ratio.ci95[0] <= ratio <= told_ratio.ci95[1]
            rows[modulus, ratio].append(
                (told.value / modulus - 1.0, Z95 * told.std / told.value, holds, known, ratio_holds)
            )
        print(f"robot {seed} of {FIRST_SEED} to {FIRST_SEED + robots - 1}", file=sys.stderr)
    print(
        "| block | answers | interval holds | rms, worst error | median half interval | Poisson's ratio stated, holds |"
    )
    print("|---|---|---|---|---|---|")
    for (modulus, ratio), found in rows.items():
        off, half, holds, known, ratio_holds = np.array(found).T
        print(
            f"| {1e-3 * modulus:g} kPa, {ratio:g} | {len(found)} of {robots} | {holds.sum():.0f} | "
            f"{100 * np.sqrt(np.mean(off**2)):.1f}, {100 * np.abs(off).max():.1f} % | {100 * np.median(half):.0f} % | "
            f"{known.sum():.0f}, {ratio_holds.sum():.0f} |"
        )


if __name__ == "__main__":
    main()
