"""A fourth probe brings a law, an unknown, an object, a baseline and a sequence of its own, and costs the package no line."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from proprio_ros.cli import main
from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.kinds import KINDS
from proprio_ros.pipeline.replay import replay, write_report
from proprio_ros.pipeline.request import Options
from proprio_ros.probes import PROBES, all_probes, probe_named, virtual_object

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
    names = [probe.name for probe in all_probes()]
    assert names[: len(PROBES)] == list(PROBES) and names[-1] == "spring"
    assert probe_named("spring").answer == ("spring_stiffness", "N m/rad")
    assert KINDS["spring_stiffness"].label == "stiffness of the spring"


def test_no_file_of_the_package_knows_it() -> None:
    package = TEST.parent / "proprio_ros"
    assert not [
        path
        for path in package.rglob("*.py")
        if re.search("spring_(stiffness|probe)", path.read_text())
    ]


def test_a_virtual_hand_can_hold_its_object(registered: None) -> None:
    from support.spring_probe import VirtualSpring

    assert virtual_object("spring:0.4") == VirtualSpring(0.4)
    for text, said in (
        ("spring:-1", "a spring pulls back"),
        ("brick:1", "| spring:0.4 (kg, m, Pa)"),
    ):
        with pytest.raises(ConfigurationError, match=re.escape(said)):
            virtual_object(text)


def test_the_virtual_arm_and_its_sequence_show_the_spring(registered: None) -> None:
    """MuJoCo's spring, of which the identification's law knows nothing; a baseline makes the answer narrower."""
    pytest.importorskip("mujoco")
    from support.hand import ROBOT, Hand
    from support.spring_probe import Spring, VirtualSpring, find_spring
    from support.squeezing import made, played

    _, empty, _ = played("empty_hand_elbow", Hand(1, None))
    calibration = calibrate(ROBOT, [LoadedRun(run) for run in empty]).calibration
    assert calibration is not None
    sequence = load_sequence(Spring.default_sequence, ROBOT)
    runs, baseline = (made(sequence, Hand(1, held))[1] for held in (VirtualSpring(0.4), None))
    robot = ROBOT.with_calibration(calibration)
    widths = []
    for without in ((), baseline):
        estimate = find_spring(robot, runs, 1.0, without)
        assert estimate.values[0].ci95 is not None, estimate.reasons
        low, high = estimate.values[0].ci95
        assert low < 0.4 < high, (low, high)
        widths.append(high - low)
    assert widths[1] < widths[0] < 0.1


@pytest.mark.long
def test_a_recording_is_replayed_with_it(
    registered: None, bags: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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

    run = JointRun(
        np.linspace(0.05, 0.6, 12),
        np.zeros(1),
        np.array([0.1]),
    )
    simulator = SpringSimulator([run])
    p = SpringSimulator.harmless[None].copy()
    p[0, INDEX["inertia"]], p[0, INDEX["torque_constant"]] = 0.05, 1.8
    direction = np.zeros((1, len(SpringSimulator.parameters), 1))
    direction[0, STIFFNESS] = 1.0
    for stiffness in (0.0, 0.3, 1.2):
        p[0, STIFFNESS] = stiffness
        q, _, dq = (
            array.copy()
            for array in simulator.jacobian(
                np.zeros(1, dtype=np.int32),
                p,
                direction,
            )
        )
        step = 1e-5
        high, low = (
            simulator.jacobian(
                np.zeros(1, dtype=np.int32), p + sign * step * direction[..., 0], direction
            )[0].copy()
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(
            dq[..., 0],
            (high - low) / (2.0 * step),
            rtol=1e-6,
            atol=1e-9,
        )
        if stiffness > 0.0:  # constant torque on a spring: x = tau / k (1 - cos(w t))
            turn = np.sqrt(stiffness / 0.05)
            np.testing.assert_allclose(
                q[0], 0.18 / stiffness * (1.0 - np.cos(turn * run.sample_times_s)), rtol=1e-6
            )


@pytest.mark.long
def test_its_part_is_in_the_report(registered: None, bags: Path, tmp_path: Path) -> None:
    estimate = replay(
        [bags / BAGS[0]],
        Options(probe="spring"),
    )
    write_report(estimate, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "<h2>The spring</h2>" in page and "stiffness of the spring" in page


def test_the_command_line_offers_it(
    registered: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
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
    """In a process of its own, as the node is; and one for its baseline."""
    pytest.importorskip("rclpy")
    code = (
        "from proprio_ros.nodes.identifier import IdentifierNode, jobs\n"
        "names = [parameter.name for parameter in IdentifierNode.parameters]\n"
        "print(jobs()['spring'], jobs()['spring_baseline'], {'spring_sequence', 'spring_baseline'} <= set(names))"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert said.split() == ["calibrate_spring", "record_spring_baseline", "True"]


@pytest.mark.long
def test_the_demo_shows_it(registered: None, tmp_path: Path) -> None:
    """In simulated time: the arm calibrates itself, makes the baseline, pushes against the spring and finds how stiff it is."""
    pytest.importorskip("rclpy")
    pytest.importorskip("mujoco")
    code = (
        "import sys\n"
        "from support.simulated_demo import demonstrated\n"
        "import proprio_ros.nodes.demo\n"
        "from proprio_ros.cli import main\n"
        "with demonstrated() as demo:\n"
        "    proprio_ros.nodes.demo.demo = demo\n"
        "    code = main(['demo', '--probe', 'spring', '--output', sys.argv[1]])\n"
        "sys.exit(code)"
    )
    # a process of its own: the nodes' parameters are those of the probes that were there when they were imported
    words = [sys.executable, "-c", code, str(tmp_path / "demo")]
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = re.match(r"spring ([0-9.]+) N m/rad, 95 % interval", done.stdout)
    assert found is not None and "the virtual arm's spring was 0.4 N m/rad" in done.stdout, (
        done.stdout
    )
    assert abs(float(found[1]) - 0.4) < 0.05 and "baseline" in done.stdout, done.stdout
    assert "now an arm without its spring is in its hand" in done.stderr
    (page,) = (tmp_path / "demo").glob("*_spring/report.html")
    assert "<h2>The spring</h2>" in page.read_text()
