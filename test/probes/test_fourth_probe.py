"""A fourth probe costs a law, a class and a line: this one lives beside this test, and no file of the package knows it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from proprio_ros.cli import main
from proprio_ros.pipeline.replay import ReplayOptions, replay, write_report
from proprio_ros.probes import PROBES, all_probes, probe_named

TEST = Path(__file__).resolve().parents[1]
LINE = "spring=support.spring_probe:Spring"
BAGS = [f"realistic_s00_empty_{number}_joint3/bag_mcap" for number in ("00", "01", "02")]


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The line: here in the environment, for the package's own it stands in ``probes/__init__.py``."""
    monkeypatch.setenv("PROPRIO_PROBES", LINE)
    monkeypatch.syspath_prepend(str(TEST))
    path = os.pathsep.join(filter(None, [str(TEST), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("PYTHONPATH", path)  # of the nodes' processes


def test_it_is_in_the_registry_behind_the_others(registered: None) -> None:
    assert [probe.name for probe in all_probes()] == [*PROBES, "spring"]
    assert probe_named("spring").answer == ("spring_stiffness", "N m/rad")


@pytest.mark.long
def test_a_recording_is_replayed_with_it(registered: None, bags: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There is no spring at this arm: 0 lies in the interval, which the calibration makes narrow."""
    code = main(["replay", *(str(bags / bag) for bag in BAGS), "--probe", "spring", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert code == 0 and said["probe"] == "spring", said
    (spring,) = said["estimates"]
    assert spring["unit"] == "N m/rad" and spring["ci95"][0] < 0.0 < spring["ci95"][1]


def test_the_law_bends_the_trajectory_as_its_tangent_says(registered: None) -> None:
    import numpy as np
    from support.spring_probe import STIFFNESS, SpringSimulator

    from proprio_ros.sim.joint import INDEX, JointRun

    run = JointRun(np.linspace(0.05, 0.6, 12), np.zeros(1), np.array([0.1]))
    simulator = SpringSimulator([run])
    p = SpringSimulator.harmless[None].copy()
    p[0, INDEX["inertia"]], p[0, INDEX["torque_constant"]] = 0.05, 1.8
    direction = np.zeros((1, len(SpringSimulator.parameters), 1))
    direction[0, STIFFNESS] = 1.0
    for stiffness in (0.0, 0.3, 1.2):
        p[0, STIFFNESS] = stiffness
        q, _, dq = (array.copy() for array in simulator.jacobian(np.zeros(1, dtype=np.int32), p, direction))
        step = 1e-5
        high, low = (
            simulator.jacobian(np.zeros(1, dtype=np.int32), p + sign * step * direction[..., 0], direction)[0].copy()
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(dq[..., 0], (high - low) / (2.0 * step), rtol=1e-6, atol=1e-9)
        if stiffness > 0.0:  # constant torque on a spring: x = tau / k (1 - cos(w t))
            turn = np.sqrt(stiffness / 0.05)
            np.testing.assert_allclose(q[0], 0.18 / stiffness * (1.0 - np.cos(turn * run.sample_times_s)), rtol=1e-6)


@pytest.mark.long
def test_its_part_is_in_the_report(registered: None, bags: Path, tmp_path: Path) -> None:
    estimate = replay([bags / BAGS[0]], ReplayOptions(probe="spring"))
    write_report(estimate, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "<h2>The spring</h2>" in page and "stiffness of the spring" in page


def test_the_command_line_offers_it(registered: None, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("replay", "demo"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert "spring" in capsys.readouterr().out
    assert main(["demo", "--probe", "spring", "--stiffness", "20"]) == 2
    assert "stiffness is in N m/rad" in capsys.readouterr().err
    assert main(["demo", "--probe", "spring", "--mass", "0.1"]) == 2
    assert "--mass says nothing about --probe spring" in capsys.readouterr().err


@pytest.mark.long
def test_the_identifier_has_a_service_for_it(registered: None) -> None:
    """In a process of its own, as the node is."""
    pytest.importorskip("rclpy")
    code = (
        "from proprio_ros.nodes.identifier import IdentifierNode\n"
        "from proprio_ros.nodes.identifier_parameters import services\n"
        "names = [parameter.name for parameter in IdentifierNode.parameters]\n"
        "print(services()['spring'], 'spring_sequence' in names)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.split() == ["calibrate_spring", "True"]


@pytest.mark.long
def test_the_demo_shows_it(registered: None, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Real nodes: the arm calibrates itself, pushes with nothing in its hand, and finds that there is no spring."""
    pytest.importorskip("rclpy")
    pytest.importorskip("mujoco")
    words = [sys.executable, "-m", "proprio_ros.cli", "demo", "--probe", "spring", "--output", str(tmp_path / "demo")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=3600.0)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("spring ") and "the virtual arm's spring was 0.0 N m/rad" in done.stdout
    (page,) = (tmp_path / "demo").glob("*_spring/report.html")
    assert "<h2>The spring</h2>" in page.read_text()
