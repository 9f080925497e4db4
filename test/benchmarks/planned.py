"""How soon `proprio plan` has a plan, and what a longer search is worth."""

from __future__ import annotations

import json
import resource
import tempfile
from pathlib import Path

import case as cases
from case import Case, Row, measure
from fresh_process import python
from support import seven_joints

from proprio_ros.quantity import Z95

GOAL_S = 5.0
MASS_KG = 0.05
SECONDS = (0.0, 3.0, 30.0)


def rows(case: Case) -> list[Row]:
    """Fresh processes that search for so long."""
    with tempfile.TemporaryDirectory() as folder:
        seven = Path(folder) / "seven.yaml"
        urdf = seven_joints.write(Path(folder))
        python(
            "-m",
            "proprio_ros.cli",
            "robot",
            "new",
            str(urdf),
            "--effort-unit",
            "N.m",
            "--output",
            str(seven),
        )
        return [
            row
            for robot, words in (
                ("open_manipulator_x", "four joints"),
                ("so101", "six"),
                (str(seven), "seven"),
            )
            for row in _searches(robot, words)
        ]


def _searches(robot: str, words: str) -> list[Row]:
    found = []
    for seconds in SECONDS[:1] if cases.once else SECONDS:
        limits = "--count", "1", "--seconds", str(seconds)
        command = (
            "-m",
            "proprio_ros.cli",
            "plan",
            "--mass",
            str(MASS_KG),
            "--robot",
            robot,
            *limits,
            "--json",
        )
        outputs: list[str] = []
        first = seconds == 0.0
        before = _cpu_s()
        timing = measure(
            lambda: outputs.append(python(*command)),  # noqa: B023
            repeats=3 if first else 1,
            warm_up=0,
        )
        cpu_s = (_cpu_s() - before) / timing.repeats
        (plan,) = json.loads(outputs[-1])["plans"]
        goal = f"{cpu_s:.1f} s of CPU" + f" (goal <= {GOAL_S:g} s)" * first
        what = f"proprio plan, fresh process, {words}: " + (
            "first plan" if first else f"--seconds {seconds:g}"
        )
        note = f"{plan['joint']} {plan['kind']}, +-{1e3 * Z95 * plan['std_kg'][0]:.1f} g at 50 g"
        found.append(
            Row(
                what,
                timing,
                goal,
                cpu_s <= GOAL_S if first else None,
                note,
            )
        )
    return found


def _cpu_s() -> float:
    """Of all processes that have been waited for: other programs do not count [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
