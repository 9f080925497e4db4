"""What schedules found, as a file of `docs/results`: ``python test/support/schedule_results.py FILE FIRST:COUNTED,COUNTED.. ..``.

COUNTED are what ``schedules.py`` wrote with ``--json``, of seeds in a row from FIRST on; all are added up. In the place of
FIRST:COUNTED a file that was made so before counts as well.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import sys
from collections import Counter
from pathlib import Path
from typing import Any

PLANS = {
    "push": "a push is asked for",
    "weigh": "a weighing is asked for",
    "pair": "two arms weigh in one world; one of them is disturbed",
}
KINDS = {
    "kill": "a node is killed", "stall": "a node is not run for 1 ms to 10 s", "restart": "a node is killed and started again",
    "end": "a node is asked to end", "unplug": "the bus is unplugged for 1 ms to 10 s", "overheat": "a motor is too hot",
    "jump": "an encoder slips", "drop": "servos' answers are lost for 1 ms to 10 s",
    "stranger": "somebody else commands positions", "call": "somebody calls a service",
    "transition": "a node is deactivated", "clock": "the system's clock is set",
    "double": "messages are doubled and overtaken for 1 ms to 10 s", "disk": "the disk is full for 1 ms to 10 s",
    "threads": "threads of a node but the bus cycle are not run for 0.3 to 1 s",
    "late": "a command is held back for 50 to 800 ms while torque is switched off and on",
}  # fmt: skip


def tables(counted: list[dict[str, Any]]) -> dict[str, Any]:
    sums: dict[str, Counter[str]] = {}
    for key in ("plans", "faults", "cpu_s", "simulated_s"):
        sums[key] = Counter()
        for each in counted:
            sums[key].update(each[key])
    plans = []
    for plan, words in PLANS.items():
        count = sums["plans"][plan]
        plans.append(
            {
                "plan": words,
                "schedules": count,
                "cpu": sums["cpu_s"][plan] / count,
                "simulated": sums["simulated_s"][plan] / count,
            }
        )
    count = sums["plans"].total()
    plans.append(
        {
            "plan": "all",
            "schedules": count,
            "cpu": sums["cpu_s"].total() / count,
            "simulated": sums["simulated_s"].total() / count,
        }
    )
    columns = {
        "what is asked for": "{plan}",
        "schedules": "{schedules}",
        "processor time of one": "{cpu:.2f} s",
        "simulated time of one": "{simulated:.1f} s",
    }
    kinds = [{"kind": words, "faults": sums["faults"][kind]} for kind, words in KINDS.items()]
    failed = sum(len(each["failed"]) for each in counted)
    kinds.append({"kind": "schedules after which something was not true", "faults": failed})
    return {
        "plans": {"columns": columns, "rows": plans},
        "kinds": {
            "columns": {"what goes wrong": "{kind}", "how often": "{faults}"},
            "rows": kinds,
        },
    }


def known(results: dict[str, Any]) -> dict[str, Any]:
    """What a file of results counts, as `schedules.py` would have it; of those that failed, how many."""
    by_plan = {row["plan"]: row for row in results["tables"]["plans"]["rows"]}
    rows = {plan: by_plan[words] for plan, words in PLANS.items() if words in by_plan}
    faults = results["tables"]["kinds"]["rows"]
    by_kind = {row["kind"]: row["faults"] for row in faults}
    return {
        "plans": {plan: row["schedules"] for plan, row in rows.items()},
        "faults": {kind: by_kind[words] for kind, words in KINDS.items() if words in by_kind},
        "failed": [0] * faults[-1]["faults"],
        "commit": results["commit"],
        "cpu_s": {plan: row["cpu"] * row["schedules"] for plan, row in rows.items()},
        "simulated_s": {plan: row["simulated"] * row["schedules"] for plan, row in rows.items()},
    }


def main(file: Path, rows: list[str]) -> None:
    counted: list[dict[str, Any]] = []
    ranges: list[str] = []
    for row in rows:
        first, _, paths = row.partition(":")
        if not paths:
            before = json.loads(Path(row).read_text())
            ranges.append(before["command"].partition("schedules.py ")[2])
            counted.append(known(before))
            continue
        of_row = [json.loads(Path(path).read_text()) for path in paths.split(",")]
        ranges.append(f"{first} {sum(each['schedules'] for each in of_row)}")
        counted += of_row
    content = {
        "command": f"python test/support/schedules.py {', then '.join(ranges)}",
        "commit": ", ".join(dict.fromkeys(", ".join(each["commit"] for each in counted).split(", "))),
        "machine": {"platform": platform.platform(), "python": platform.python_version(), "cores": os.cpu_count(),},
        "date": datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d"), "tables": tables(counted),
    }  # fmt: skip
    file.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main(
        Path(sys.argv[1]),
        sys.argv[2:],
    )
