"""The message package beside this one: that its files agree with each other and with this package, and that it can be built."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from support.message_packages import build

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "proprio_msgs"


def test_the_manifests_agree() -> None:
    ours, theirs = (
        ElementTree.parse(folder / "package.xml").getroot() for folder in (PACKAGE, REPOSITORY)
    )
    for tag in ("version", "license", "maintainer"):
        assert ours.findtext(tag) == theirs.findtext(tag), tag


def test_what_is_defined_is_generated_and_what_it_needs_is_stated() -> None:
    defined = {path.relative_to(PACKAGE).as_posix(): path for path in PACKAGE.glob("*/*.*")}
    recipe = (PACKAGE / "CMakeLists.txt").read_text()
    assert set(re.findall(r'"(\w+/\w+\.\w+)"', recipe)) == set(defined) != set()
    used = {
        name
        for path in defined.values()
        for name in re.findall(r"^(\w+)/\w+", path.read_text(), re.MULTILINE)
    }
    listed = re.search(r"DEPENDENCIES ([\w ]+)\n", recipe)
    assert listed is not None and set(listed[1].split()) == used
    stated = {
        depend.text
        for depend in ElementTree.parse(PACKAGE / "package.xml").getroot().iter("depend")
    }
    assert stated == {*used, "action_msgs"}  # of which every action is made


@pytest.mark.long
def test_the_generators_of_the_wheels_build_it(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    environment = build(PACKAGE, tmp_path / "prefix")
    program = """
from rclpy.serialization import deserialize_message, serialize_message
from proprio_msgs.action import Weigh
from proprio_msgs.msg import ElasticityEstimate, MassEstimate
mass = MassEstimate(probe="payload", final=True, mass=0.5, std=0.25, interval=[0.125, 1.0], reasons=["one", "two"])
assert deserialize_message(serialize_message(mass), MassEstimate) == mass
block = ElasticityEstimate(youngs_modulus=2e5, interval=[1e5, 3e5])
assert deserialize_message(serialize_message(block), ElasticityEstimate) == block
print(*Weigh.Goal.get_fields_and_field_types(), *Weigh.Feedback.get_fields_and_field_types())
"""
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True
    )
    goal = ["target", "sequence", "settings", "half_interval", "at_most_s"]
    feedback = ["phase", "fraction", "mass"]
    assert done.stdout.split() == goal + feedback, done.stderr


@pytest.mark.long
def test_colcon_finds_it_where_it_is_named(tmp_path: Path) -> None:
    """Below a package colcon looks for no other. It is built on a robot PC only: Debian has no generators for it."""
    colcon = shutil.which("colcon")
    if colcon is None:
        pytest.skip("needs colcon")
    source = tmp_path / "src" / "proprio_ros"
    shutil.copytree(PACKAGE, source / "proprio_msgs")
    for name in ("package.xml", "setup.py", "setup.cfg"):
        shutil.copy(REPOSITORY / name, source)
    python = str(Path(sys.executable).parent)
    clean = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "VIRTUAL_ENV")
    }
    clean["PATH"] = os.pathsep.join(
        part for part in clean["PATH"].split(os.pathsep) if part != python
    )
    command = [
        colcon,
        "build",
        "--base-paths",
        str(source),
        str(source / "proprio_msgs"),
    ]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=clean,
        capture_output=True,
        text=True,
    )
    assert ">>> proprio_msgs" in done.stdout, done.stdout + done.stderr
