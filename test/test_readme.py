"""README's commands, done as a newcomer does them: those for the recordings of the repository, and those for another arm with
a URDF of three, six or seven joints that is not in it."""

from __future__ import annotations

import itertools
import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.bends.messages import Bend, bent
from support.drawn_arm import joints_of, write_urdf
from support.moved_arm import record_arm

from proprio_ros.cli import main

README = Path(__file__).resolve().parents[1] / "README.md"
LOAD_KG = 0.8
BAGS = {"EMPTY_BAG": 0.0, "LOADED_BAG": LOAD_KG, "KNOWN_BAG": 0.5}
CONSTANTS = {"yaw": 5.0, "lift": 8.0, "bend": 6.0}
"""By the data sheet, N m/A."""
TRUE = {"yaw": 5.1, "lift": 7.8, "bend": 6.15}
URDF = """<robot name="my_arm">
<link name="base"/>
<link name="column"><inertial><origin xyz="0 0 0.05"/><mass value="2"/>
<inertia ixx="0.006" iyy="0.006" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="upper"><inertial><origin xyz="0.15 0 0"/><mass value="1.5"/>
<inertia ixx="0.002" iyy="0.013" izz="0.013" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0.12 0 0"/><mass value="0.9"/>
<inertia ixx="0.001" iyy="0.006" izz="0.006" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="hand"/>
<joint name="yaw" type="revolute"><parent link="base"/><child link="column"/><origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="40" velocity="3"/></joint>
<joint name="lift" type="revolute"><parent link="column"/><child link="upper"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="40" velocity="3"/></joint>
<joint name="bend" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="40" velocity="3"/></joint>
<joint name="grip" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0.25 0 0"/></joint>
</robot>
"""


def commands(title: str) -> list[list[str]]:
    """Words of the commands of a section, without what a comment says."""
    section = README.read_text().split(title, 1)[1]
    block = re.search(r"```\n(.*?)```", section, re.DOTALL)
    assert block is not None
    lines = block[1].replace("\\\n", " ").splitlines()
    return [shlex.split(line, comments=True) for line in lines]


def test_the_recordings_of_the_repository_give_what_the_readme_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").symlink_to(README.parent / "bags")
    calibrate, replay = commands("**Offline**")
    empty = sorted(str(bag.relative_to(tmp_path)) for bag in tmp_path.glob(calibrate[2]))
    assert len(empty) == 16 and main([*calibrate[1:2], *empty, *calibrate[3:]]) == 0
    capsys.readouterr()
    assert main(replay[1:]) == 0
    found = re.findall(r"payload_mass: (\S+) g .* (\S+) \.\. (\S+) g", capsys.readouterr().out)
    at = replay.index("--calibration")
    assert main([*replay[1:at], *replay[at + 2 :]]) == 3
    (wide,) = re.findall(
        r"payload_mass: (\d+ \.\. \d+) g",
        capsys.readouterr().out,
    )
    (mass, low, high), stated = (
        found[0],
        re.sub(
            r"\s+",
            " ",
            README.read_text(),
        ),
    )
    assert (
        f"says {mass} g, {low} to {high} g; without `--calibration` it says {wide.replace('..', 'to')} g"
        in stated
    )


def test_commands_write_different_files_that_git_does_not_ask_about() -> None:
    written = [
        word
        for title in ("**Offline**", "**Any other arm")
        for words in commands(title)
        for flag, word in itertools.pairwise(words)
        if flag in ("--output", "--report")
    ]
    assert len(written) == len(set(written)) == 4
    if shutil.which("git") is None or not (README.parent / ".git").exists():
        pytest.skip("no clone")
    asked = ["git", "check-ignore", *written]
    ignored = subprocess.run(asked, cwd=README.parent, capture_output=True, text=True).stdout
    assert ignored.split() == written
    tracked = subprocess.run(
        ["git", "ls-files", "-ci", "--exclude-standard"], cwd=README.parent, capture_output=True
    )
    assert tracked.stdout == b"", "what is kept is not ignored"


def test_another_arm_is_weighed_by_the_commands_of_the_readme(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_arm.urdf").write_text(URDF)
    for seed, (name, kg) in enumerate(BAGS.items()):
        record_arm(
            tmp_path / name,
            tmp_path / "my_arm.urdf",
            TRUE,
            "hand",
            kg,
            seed,
            seconds=15.0,
        )
    ran = commands("**Any other arm")
    assert [words[:2] for words in ran] == [
        ["proprio", word] for word in ["robot", "check", "replay", "calibrate", "replay"]
    ]
    half_widths = []
    for words in ran:
        assert main(words[1:]) == 0, f"{shlex.join(words)}: {capsys.readouterr().err}"
        said = capsys.readouterr().out
        if words[1] == "robot":
            _state(tmp_path / "my_arm.yaml", CONSTANTS)
        if words[1] == "replay":
            assert said.startswith("accepted"), said
            mass, low, high = map(
                float, re.findall(r"payload_mass: (\S+) g .* (\S+) \.\. (\S+) g", said)[0]
            )
            assert low < 1e3 * LOAD_KG < high, said
            half_widths.append(0.5 * (high - low) / mass)
    _mistakes_are_named(tmp_path, capsys)
    # the known weight is worth its recording
    assert (
        half_widths[0] < 0.5
        and half_widths[1] < 0.3
        and abs(mass - 1e3 * LOAD_KG) < 0.05e3 * LOAD_KG
    ), said


def _mistakes_are_named(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """On three joints a payload, friction that helps and constant torques explained anything: no cause was named, or another."""

    def efforts(factor: float, only: str = "") -> Bend:
        def bend(
            topic: str,
            time_ns: int,
            message: Any,
        ) -> tuple[int, Any]:
            column = np.array([only in ("", name) for name in message.name])
            message.effort = np.where(column, factor, 1.0) * message.effort
            return time_ns, message

        return bend

    mistakes = {
        "about 1000 times what the URDF needs": efforts(1000.0), "the effort of all joints has the sign": efforts(-1.0),
        "efforts of lift are counted the other way round": efforts(-1.0, "lift"),
    }  # fmt: skip
    for number, (words, bend) in enumerate(mistakes.items()):
        loaded, empty = (
            str(bent(folder / f"{name}_{number}", bend, folder / name))
            for name in list(BAGS)[1::-1]
        )
        asked = ["replay", loaded, "--probe", "payload", "--effort-unit", "A"]
        for way in (
            ["--robot", "my_arm.yaml", "--baseline", empty],
            ["--calibration", "calibrated.yaml"],
        ):
            assert main([*asked, *way]) == 3
            said = capsys.readouterr().out
            assert said.startswith("rejected") and words in re.sub(r"\s+", " ", said), said


@pytest.mark.parametrize(("count", "unit", "seed"), [(6, "A", 6), (7, "N.m", 14)])
def test_an_arm_that_nobody_has_seen_is_weighed_by_the_five_commands(
    count: int,
    unit: str,
    seed: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Torque constants are off by 3 % each, which was refused with seven joints; links, friction and rotors are off, too."""
    monkeypatch.chdir(tmp_path)
    stated = recorded(
        tmp_path, count, unit, seed, {"EMPTY_BAG": 0.0, "LOADED_BAG": 1.3, "KNOWN_BAG": 0.5}
    )
    masses = []
    for words in commands("**Any other arm"):
        words = [word if word != "A" else unit for word in words]
        words += ["--effort-unit", unit] * (words[1] == "robot" and unit != "A")
        assert main(words[1:]) == 0, f"{shlex.join(words)}: {capsys.readouterr()}"
        said = capsys.readouterr().out
        if words[1] == "robot":
            assert "tool0 is a guess" in said
            _state(tmp_path / "my_arm.yaml", stated if unit == "A" else {})
        if words[1] == "replay":
            masses.append(
                [
                    float(word)
                    for word in re.findall(r"payload_mass: (\S+) g .* (\S+) \.\. (\S+) g", said)[0]
                ]
            )
    assert len(masses) == 2 and all(low < 1300.0 < high for _, low, high in masses), masses
    assert all(
        abs(mass - 1300.0) < 0.05 * 1300.0 and high - low < mass for mass, low, high in masses
    ), masses


@pytest.mark.parametrize(("count", "unit", "seed"), [(3, "A", 41), (6, "N.m", 42)])
def test_a_reference_stops_no_calibration(
    count: int,
    unit: str,
    seed: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One that is too light to tell torque constants was refused as if the recordings were wrong, now and then one of 0.5 kg."""
    monkeypatch.chdir(tmp_path)
    masses = {"EMPTY_BAG": 0.0, "LOADED_BAG": 1.3, "HEAVY_BAG": 0.5, "LIGHT_BAG": 0.03}
    stated = recorded(tmp_path, count, unit, seed, masses)
    effort = ["--effort-unit", unit]
    assert (
        main(
            [
                "robot",
                "new",
                "my_arm.urdf",
                "--output",
                "my_arm.yaml",
                *(effort if unit != "A" else []),
            ]
        )
        == 0
    )
    _state(tmp_path / "my_arm.yaml", stated if unit == "A" else {})
    for name in ("HEAVY_BAG", "LIGHT_BAG"):
        known = f"{name}={masses[name]}"
        robot = ["--robot", "my_arm.yaml", *effort]
        capsys.readouterr()
        assert (
            main(
                [
                    "calibrate",
                    "EMPTY_BAG",
                    "--reference",
                    known,
                    *robot,
                    "--output",
                    f"{name}.yaml",
                    "--json",
                ]
            )
            == 0
        )
        told = json.loads(capsys.readouterr().out)
        assert ("says_too_little" in told["reason_codes"]) == (name == "LIGHT_BAG"), told["reasons"]
        assert not any("your reference" in note for note in told["notes"]) or name == "HEAVY_BAG"
        assert (
            main(
                [
                    "replay",
                    "LOADED_BAG",
                    "--probe",
                    "payload",
                    "--calibration",
                    f"{name}.yaml",
                    *effort,
                    "--json",
                ]
            )
            == 0
        )
        low, high = json.loads(capsys.readouterr().out)["estimates"][0]["ci95"]
        assert low < 1.3 < high, told


def recorded(
    folder: Path,
    count: int,
    unit: str,
    seed: int,
    masses: Mapping[str, float],
) -> dict[str, float]:
    """Bags of an arm that is drawn at random, whose torque constants are off by 3 % each from these, which are stated."""
    urdf = write_urdf(folder / "my_arm.urdf", count, seed)
    random = np.random.default_rng(seed)
    names = joints_of(count)
    drawn = np.round(
        random.uniform(4.0, 9.0, count),
        2,
    )
    stated = {
        name: value if unit == "A" else 1.0
        for name, value in zip(names, drawn.tolist(), strict=True)
    }
    true = {name: value * (1.0 + 0.03 * random.standard_normal()) for name, value in stated.items()}
    for number, (name, kg) in enumerate(masses.items()):
        record_arm(
            folder / name,
            urdf,
            true,
            "tool0",
            kg,
            10 * seed + number,
            robot_seed=seed,
            seconds=15.0,
        )
    return stated


def _state(
    path: Path,
    constants: Mapping[str, float],
) -> None:
    """Fill in what the file marks, and nothing else."""
    lines = path.read_text().splitlines()
    joint = ""
    for number, line in enumerate(lines):
        if (found := re.match(r"  (\w+):  # revolute", line)) is not None:
            joint = found[1]
        if "STATE THIS" in line and "null" in line:
            lines[number] = line.replace(
                "null",
                str(constants[joint]),
                1,
            )
    assert not any("STATE THIS" in line and ": null" in line for line in lines)
    path.write_text("\n".join(lines) + "\n")
