"""The command line: its contract, its exit codes, one line per mistake."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import proprio_ros
from proprio_ros.cli import main

ROOT = Path(__file__).resolve().parents[1]
BAG = str(ROOT / "bags" / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap")
CUBE = "realistic_s00_fixed_heavy_cube_23g_joint3"
STUCK = str(ROOT / "bags" / "friction_s00_fixed_random_a_joint3" / "bag_mcap")


def test_json_contract(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", BAG, "--probe", "payload", "--json", "--set", "payload.size=0.043"]) == 3
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert {
        "probe",
        "robot",
        "runs",
        "verdict",
        "reasons",
        "estimates",
        "fit",
        "solver",
        "timing_s",
    } <= result.keys()
    assert (result["probe"], result["robot"], result["runs"]) == (
        "payload",
        "open_manipulator_x",
        1,
    )
    assert result["verdict"] == "too_wide" and all(
        isinstance(reason, str) for reason in result["reasons"]
    )
    (mass,) = result["estimates"]
    assert mass["name"] == "payload_mass" and mass["unit"] == "kg"
    assert mass["ci95"][0] <= mass["value"] <= mass["ci95"][1] and mass["std"] > 0.0
    assert {"rms", "expected_rms", "unit", "reduced_chi2"} <= result["fit"].keys() and result[
        "fit"
    ]["unit"] == "rad"
    assert {"name", "profile", "starts", "starts_agreeing", "iterations"} <= result["solver"].keys()
    assert {"read", "load", "solve"} == result["timing_s"].keys()


def test_no_number_for_what_cannot_be_determined(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", STUCK, "--probe", "payload", "--json"]) == 3
    result = json.loads(capsys.readouterr().out)
    assert result["verdict"] == "not_identifiable" and result["fit"] is None
    assert result["estimates"][0]["value"] is None and result["estimates"][0]["reason"]


def test_text_and_report(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    page = tmp_path / "page.html"
    assert main(["replay", BAG, "--probe", "payload", "--report", str(page)]) == 3
    printed = capsys.readouterr()
    assert printed.out.startswith("too_wide") and "95 % interval" in printed.out
    assert f"report written to {page}" in printed.err and page.is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "nowhere: no such bag"),
        ([BAG, "--robot", "panda"], "panda"),
        ([BAG, "--set", "payload.size"], "write KEY=VALUE"),
        ([BAG, "--set", "payload.com=[0,0"], "is not JSON"),
        ([BAG, "--set", "payload.colour=red"], "unknown; valid keys"),
        ([BAG, "--state-topic", "/joints"], "/joint_states"),
        ([BAG, "--command-topic", "/joints"], "/current_command"),
        (
            [BAG, "--calibration", "robot.yaml"],
            "--calibration robot.yaml: there is no such calibration",
        ),
        ([BAG, "--report", "/nowhere/page.html"], "exists and is writable"),
        (
            [BAG, "--set", "payload.size=0.03", "--set", "payload.size=0.04"],
            "--set payload.size: given twice",
        ),
        # the first counts, too
        ([BAG, "--baseline", "nowhere", "--baseline", STUCK], "nowhere: no such bag"),
    ],
)
def test_mistakes_get_one_line(
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    assert main(["replay", *arguments, "--probe", "payload"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("proprio: ") and words in lines[0]


def test_check_says_that_torque_constants_are_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file as `robot new` writes it, before anything is stated there."""
    file = str(tmp_path / "arm.yaml")
    assert main(["robot", "new", str(ROOT / "urdf/open_manipulator_x.urdf"), "--output", file]) == 0
    capsys.readouterr()
    written = Path(file).read_text()
    assert "transmission_m_per_rad: null" in written
    Path(file).write_text(
        written.replace("transmission_m_per_rad: null", "transmission_m_per_rad: 0.01")
    )
    main(["check", BAG, "--robot", file, "--json"])
    said = capsys.readouterr().out
    assert '"no_torque_constants"' in said
    assert "missing: motor.nominal_torque_constant_N_m_per_A of joint1, " in said
    main(["check", BAG, "--json"])
    assert "no_torque_constants" not in capsys.readouterr().out


def test_weigh_is_another_name_of_replay(capsys: pytest.CaptureFixture[str]) -> None:
    assert proprio_ros.replay is proprio_ros.weigh
    said = []
    for verb in ("replay", "weigh"):
        assert main([verb, STUCK, "--probe", "payload"]) == 3
        said.append(capsys.readouterr().out)
    assert said[0] == said[1]


@pytest.mark.parametrize(
    "flag", ["--robot", "--calibration", "--report", "--effort-unit", "--solver", "--probe"]
)
def test_an_option_that_takes_one_value_is_given_once(
    flag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    value = {"--effort-unit": "A", "--solver": "lm", "--probe": "payload"}.get(
        flag,
        "one",
    )
    with pytest.raises(SystemExit) as refused:
        main(["replay", BAG, "--probe", "payload", flag, value, flag, value])
    told = capsys.readouterr().err.splitlines()
    assert refused.value.code == 2 and told[-1].endswith(
        f"argument {flag}: given twice; give it once"
    )


def test_a_unit_that_was_not_needed_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["replay", BAG, "--probe", "payload"], ["check", BAG]):
        assert main([*arguments, "--effort-unit", "A"]) in (0, 3)
        said = capsys.readouterr().out
        assert "--effort-unit A was not used: the current is that of /current_command" in said
        main(arguments)
        assert "--effort-unit" not in capsys.readouterr().out


def test_the_papers_profile_speaks_of_no_interval_of_its_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    main(
        [
            "replay",
            str(ROOT / "bags" / CUBE / "bag_mcap"),
            "--probe",
            "payload",
            "--profile",
            "paper",
            "--json",
        ]
    )
    result = json.loads(capsys.readouterr().out)
    assert result["estimates"][0]["ci95"] is None and "not_calibrated" in result["reason_codes"]
    assert not any("interval" in reason for reason in result["reasons"])


def test_a_weighing_loads_nothing_that_it_does_not_use() -> None:
    code = (
        "import sys; from proprio_ros.cli import main; main(['replay', sys.argv[1], '--probe', 'payload', '--json']); "
        "unused = {'scipy', 'matplotlib', 'mujoco', 'pyarrow', 'dynamixel_sdk', 'proprio_ros.nodes.graph', "
        "'proprio_ros.report', 'proprio_ros.sim.descent'} & set(sys.modules); assert not unused, unused"
    )
    subprocess.run([sys.executable, "-c", code, BAG], cwd=ROOT, check=True, capture_output=True)


def test_the_installed_command() -> None:
    """As a process: results on stdout, the rest on stderr, a reader that goes away is no error."""
    command = [
        sys.executable,
        "-m",
        "proprio_ros.cli",
        "replay",
        BAG,
        "--probe",
        "payload",
        "--json",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 3 and json.loads(done.stdout)["verdict"] == "too_wide"
    assert "CUDA" not in done.stderr  # that there is no GPU is no news
    bad = subprocess.run(
        [
            *command[:3],
            "replay",
            BAG,
            "--probe",
            "weight",
        ],
        capture_output=True,
        text=True,
    )
    assert bad.returncode == 2 and not bad.stdout and "payload" in bad.stderr
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    assert "Traceback" not in process.stderr.read()
    process.wait()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--probe", "softness", "--mass", "0.1"], "--mass says nothing about --probe softness"),
        (["--modulus", "12000"], "--modulus says nothing about --probe payload"),
        (["--probe", "softness", "--modulus", "12"], "moduli are in Pa"),
        (["--mass", "50"], "masses are in kg"),
    ],
)
def test_a_demo_of_something_else_is_refused(
    words: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    assert main(["demo", *words, "--output", str(tmp_path / "demo")]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1 and not (tmp_path / "demo").exists()
