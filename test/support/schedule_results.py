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
    "late": "a command is held back for 50 to 800 ms while torque is switched off and on",
}  # fmt: skip


def tables(counted: list[dict[str, Any]]) -> dict[str, Any]:
    sums: dict[str, Counter[str]] = {}
    for key in ("plans", "faults", "cpu_s", "simulated_s"):
        sums[key] = Counter()
        for each in counted:
            sums[key].update(each[key])
    plans = [
        {"plan": words, "schedules": sums["plans"][plan], "cpu": sums["cpu_s"][plan] / sums["plans"][plan],
         "simulated": sums["simulated_s"][plan] / sums["plans"][plan]}
        for plan, words in PLANS.items()
    ]  # fmt: skip
    whole = {"plan": "all", "schedules": sums["plans"].total()}
    plans.append(
        whole
        | {key: sums[f"{key}_s"].total() / sums["plans"].total() for key in ("cpu", "simulated")}
    )
    said = {"plan": "what is asked for", "schedules": "schedules"}
    columns = {said["plan"]: "{plan}", said["schedules"]: "{schedules}", "processor time of one": "{cpu:.2f} s",
               "simulated time of one": "{simulated:.1f} s"}  # fmt: skip
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
    plans, kinds = ({words: key for key, words in names.items()} for names in (PLANS, KINDS))
    rows = [row for row in results["tables"]["plans"]["rows"] if row["plan"] in plans]
    faults = results["tables"]["kinds"]["rows"]
    return {
        "plans": {plans[row["plan"]]: row["schedules"] for row in rows},
        "faults": {kinds[row["kind"]]: row["faults"] for row in faults if row["kind"] in kinds},
        "failed": [0] * faults[-1]["faults"], "commit": results["commit"],
        "cpu_s": {plans[row["plan"]]: row["cpu"] * row["schedules"] for row in rows},
        "simulated_s": {plans[row["plan"]]: row["simulated"] * row["schedules"] for row in rows},
    }  # fmt: skip


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
