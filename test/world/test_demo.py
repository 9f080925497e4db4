"""What `proprio demo` shows of each probe, in the simulated world; how its processes end is in test/nodes/test_demo.py."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.simulated_demo import demonstrated

from proprio_ros.probes import probe_named

pytestmark = pytest.mark.long

SHOWN = {
    "payload": (0.05, r"payload ([\d.]+) g, 95 % interval ([\d.]+) \.\. ([\d.]+) g", 1e-3, 4e-3, "<svg"),
    "container": (0.02, r"sphere ([\d.]+) g, 95 % interval ([\d.]+) \.\. ([\d.]+) g", 1e-3, 4e-3, "sphere"),
    "softness": (3e4, r"block ([\d.]+) kPa, 95 % interval ([\d.]+) \.\. ([\d.]+) kPa", 1e3, 2e4, "Both Lamé parameters together"),
}  # fmt: skip


@pytest.mark.parametrize("probe", SHOWN)
def test_what_it_shows(probe: str, tmp_path: Path) -> None:
    truth, words, unit, widest, on_the_page = SHOWN[probe]
    told: list[str] = []
    with demonstrated() as demo:
        shown = demo(
            probe_named(probe),
            truth,
            folder=tmp_path / "demo",
            tell=told.append,
        )
    assert shown.accepted, (shown.sentence, told)
    found = re.match(words, shown.sentence)
    assert found, shown.sentence
    value, low, high = (unit * float(each) for each in found.groups())
    assert abs(value - truth) < high - low < widest, shown
    assert shown.value == pytest.approx(value, rel=0.02)
    assert shown.truth == truth
    assert on_the_page in shown.report.read_text()
    if probe == "container":
        empty = re.search(r"empty container ([\d.]+) g", "\n".join(told))
        assert empty and abs(float(empty[1]) - 30.0) < 2.0, told
