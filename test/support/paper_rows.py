"""What the experiments of the paper return, without their computing."""

from __future__ import annotations

from proprio_ros.addons.paper import cases
from proprio_ros.addons.paper.store import Rows


def synthetic() -> dict[str, list[Rows]]:
    """Rows as the experiments return them, of two seeds."""
    found: dict[str, list[Rows]] = {name: [] for name in ("objects", "starts")}
    for seed, off in enumerate((-0.001, 0.002)):
        rows = []
        for name, (mass, _, _) in cases.OBJECTS.items():
            for way, low, high in (("paper", None, None), ("ours", mass - 0.003, mass + 0.003)):
                rows.append(
                    {
                        "object": name, "calibrated": True, "truth": mass, "way": way, "runs": 1, "value": mass + off,
                        "low": low, "high": high, "seconds": 0.1, "verdict": "" if low is None else "accepted", "why": "",
                    }
                )  # fmt: skip
        found["objects"].append(
            {
                "rows": rows,
                "trace": {},
                "seed": seed,
            }
        )
        ends = [
            {"way": "ours", "calibrated": False, "start": start, "value": 0.05 + off, "truth": 0.05}
            for start in cases.STARTS_KG
        ]
        found["starts"].append({"rows": ends, "seed": seed})
    return found
