"""Somebody else's arm behind an effort or position controller on a busy computer, calibrated and weighed from its URDF.

In simulated time, see test/support/foreign_live.py.

python test/benchmarks/foreign_controller.py --seeds 0 20 [--goals --rate 30] [--masses 0.02 0.2 1.0]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 20), metavar=("FIRST", "COUNT"))
    parser.add_argument("--masses", type=float, nargs="+", default=[0.02, 0.2, 1.0], metavar="KG")
    parser.add_argument("--goals", action="store_true")
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument("--data", type=Path)
    given = parser.parse_args()
    from support.foreign_live import foreign

    for seed in range(given.seeds[0], given.seeds[0] + given.seeds[1]):
        folder = (given.data or Path(tempfile.mkdtemp())) / f"seed{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        begun = time.process_time()
        with foreign(folder, seed, given.goals, given.rate) as (client, arm):
            busy, told = arm.busy, {"seed": seed}
            told |= {"delay_ms": round(1e3 * busy.delay_s, 1), "jitter_ms": round(1e3 * busy.jitter_s, 1)}
            for _ in range(3):
                arm.hold(0.0)
                client.clock.sleep(3.0)
                answer = client.asked("/identifier/calibrate_robot")
                print("  robot:", answer.message, flush=True)
                if answer.success:
                    break
            told["robot"] = answer.success
            for mass in given.masses if answer.success else []:
                arm.hold(mass)
                client.clock.sleep(3.0)
                client.estimates.clear()
                for _ in range(3):
                    answer = client.asked("/identifier/calibrate_payload")
                    if answer.success:
                        break
                print("  payload:", answer.message, flush=True)
                if answer.success:
                    final = client.estimates[-1]
                    low, high = json.loads(final["payload_mass.ci95"])
                    told[f"{1e3 * mass:g} g"] = [round(1e3 * x, 1) for x in (low, high)] + [low <= mass <= high]
            log = "\n".join(f"{at:.2f} {name}: {text}" for at, name, _, text in client.world.graph.log)
        told["cpu_s"] = round(time.process_time() - begun, 1)
        (folder / "excitation.log").write_text(log)
        print(json.dumps(told), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
