"""README's commands, done as a newcomer does them: those for the recordings of the repository, and those for another arm with
a URDF of three joints and nothing else."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
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
    (wide,) = re.findall(r"payload_mass: (\d+ \.\. \d+) g", capsys.readouterr().out)
    (mass, low, high), stated = found[0], re.sub(r"\s+", " ", README.read_text())
    assert f"says {mass} g, {low} to {high} g; without `--calibration` it says {wide.replace('..', 'to')} g" in stated


@pytest.mark.long
def test_another_arm_is_weighed_by_the_commands_of_the_readme(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_arm.urdf").write_text(URDF)
    for seed, (name, kg) in enumerate(BAGS.items()):
        record_arm(tmp_path / name, tmp_path / "my_arm.urdf", TRUE, "hand", kg, seed, seconds=15.0)
    ran = commands("**Any other arm")
    assert [words[:2] for words in ran] == [
        ["proprio", word] for word in ["robot", "check", "replay", "calibrate", "replay"]
    ]
    half_widths = []
    for words in ran:
        assert main(words[1:]) == 0, f"{shlex.join(words)}: {capsys.readouterr().err}"
        said = capsys.readouterr().out
        if words[1] == "robot":
            _state(tmp_path / "my_arm.yaml")
        if words[1] == "replay":
            assert said.startswith("accepted"), said
            mass, low, high = map(float, re.findall(r"payload_mass: (\S+) g .* (\S+) \.\. (\S+) g", said)[0])
            assert low < 1e3 * LOAD_KG < high, said
            half_widths.append(0.5 * (high - low) / mass)
    # the known weight is worth its recording
    assert half_widths[0] < 0.5 and half_widths[1] < 0.3 and abs(mass - 1e3 * LOAD_KG) < 0.05e3 * LOAD_KG, said


def _state(path: Path) -> None:
    """Fill in what the file marks, and nothing else."""
    lines, joint = path.read_text().splitlines(), ""
    for number, line in enumerate(lines):
        if (found := re.match(r"  (\w+):  # revolute", line)) is not None:
            joint = found[1]
        if "STATE THIS" in line and "null" in line:
            lines[number] = line.replace("null", str(CONSTANTS[joint]), 1)
    assert not any("STATE THIS" in line and ": null" in line for line in lines)
    path.write_text("\n".join(lines) + "\n")
