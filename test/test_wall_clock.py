"""Who else has the processor decides nothing: only tests of wiring know the clock on the wall, and none tries twice."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
TEST = REPOSITORY / "test"
TIMES = {
    "sleep",
    "monotonic",
    "monotonic_ns",
    "perf_counter",
    "perf_counter_ns",
    "process_time",
    "thread_time",
}
ALARMS = {
    "signal.alarm",
    "signal.setitimer",
    "threading.Timer",
    "faulthandler.dump_traceback_later",
}
HELPERS = {"live.py", "pendant.py", "tab.py", "waiting.py"}
"""In test/support, for tests of wiring."""


def wiring() -> set[Path]:
    """The files that .ci/run names."""
    (listed,) = re.findall(
        r"^wiring=\((.*?)^\)$", (REPOSITORY / ".ci" / "run").read_text(), re.MULTILINE | re.DOTALL
    )
    return {REPOSITORY / name for name in listed.split()}


@cache
def trees() -> list[tuple[Path, ast.Module]]:
    """What is tested with, but for benchmarks: those measure time."""
    paths = [
        path for path in sorted(TEST.rglob("*.py")) if not path.is_relative_to(TEST / "benchmarks")
    ]
    return [(path, ast.parse(path.read_text(encoding="utf-8"))) for path in paths]


def dotted(called: ast.expr) -> str:
    """``name`` or ``module.name``, else nothing."""
    if isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name):
        return f"{called.value.id}.{called.attr}"
    return called.id if isinstance(called, ast.Name) else ""


def looks_at_the_clock(tree: ast.Module) -> list[str]:
    """Lines that wait for time, read it, or limit how long something may take."""
    found = []
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "time"
        ):
            if node.attr in TIMES:
                found.append(f"{node.lineno}: time.{node.attr}")
        elif isinstance(node, ast.ImportFrom):
            names = {each.name for each in node.names}
            alarms = any(f"{node.module}.{name}" in ALARMS for name in names)
            if (
                node.module == "time"
                or node.module == "support.live"
                or {"wait_for"} & names
                or alarms
            ):
                found.append(f"{node.lineno}: from {node.module}")
        elif isinstance(node, ast.Call):
            called = dotted(node.func)
            if called.startswith("subprocess.") and any(
                each.arg == "timeout" for each in node.keywords
            ):
                found.append(f"{node.lineno}: {called} with a timeout")
            elif called in ALARMS:
                found.append(f"{node.lineno}: {called}")
    return found


OUTCOMES = re.compile(r"answer|result|success|accepted|verdict|returncode")


def tries_again(tree: ast.Module) -> list[str]:
    """Loops that do the same again until it turns out well."""
    found = []
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.For)
            and isinstance(node.target, ast.Name)
            and node.target.id == "_"
        ):
            for inner in ast.walk(node):
                leaves = isinstance(inner, ast.If) and any(
                    isinstance(each, ast.Break | ast.Return) for each in inner.body
                )
                caught = isinstance(inner, ast.Try) and "AssertionError" in ast.unparse(inner)
                if caught or (leaves and OUTCOMES.search(ast.unparse(inner.test))):
                    found.append(f"{inner.lineno}: in the loop of line {node.lineno}")
        elif isinstance(node, ast.Call) and dotted(node.func) == "any":
            for inner in ast.walk(node):
                if (
                    isinstance(inner, ast.comprehension)
                    and isinstance(inner.target, ast.Name)
                    and inner.target.id == "_"
                ):
                    found.append(f"{node.lineno}: any of several tries")
    return found


def test_only_wiring_looks_at_the_clock_on_the_wall() -> None:
    allowed = wiring()
    assert allowed and all(path.exists() for path in allowed)
    for path, tree in trees():
        helper = path.parent == TEST / "support" and path.name in HELPERS
        if path not in allowed and not helper:
            assert not looks_at_the_clock(tree), (
                f"{path.relative_to(REPOSITORY)}: take simulated time (test/support), or wire"
            )


def test_nothing_is_tried_twice() -> None:
    for path, tree in trees():
        assert path.name == Path(__file__).name or not tries_again(tree), path.relative_to(
            REPOSITORY
        )


def test_both_are_found_where_they_are() -> None:
    found = looks_at_the_clock(
        ast.parse("import time\ntime.sleep(1.0)\nsubprocess.run([], timeout=3)")
    )
    assert sorted(found) == ["2: time.sleep", "3: subprocess.run with a timeout"]
    for line in (
        "signal.alarm(9)",
        "signal.setitimer(signal.ITIMER_PROF, 9.0)",
        "from signal import setitimer",
    ):
        assert looks_at_the_clock(ast.parse(line)), line
    again = "for _ in range(3):\n    answer = call()\n    if answer.success:\n        break\n"
    assert tries_again(ast.parse(again))
    assert tries_again(ast.parse("any(well() for _ in range(3))"))
    assert not tries_again(ast.parse("for _ in range(3):\n    step()\n"))
