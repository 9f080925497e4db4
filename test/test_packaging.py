"""What pip, uv and colcon need from the same files, and that every tool finds the code in order."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import setuptools
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import proprio_ros

REPOSITORY = Path(__file__).resolve().parents[1]
BAG = "bags/quantised_s00_fixed_heavy_ball_50g_joint3/bag_mcap"


@pytest.fixture(scope="module")
def arguments() -> dict[str, Any]:
    """What setup.py hands to setuptools."""
    seen: dict[str, Any] = {}
    original = setuptools.setup
    before = Path.cwd()
    setuptools.setup = lambda **given: seen.update(given)
    try:
        os.chdir(REPOSITORY)
        exec(
            compile((REPOSITORY / "setup.py").read_text(), "setup.py", "exec"),
            {"__name__": "setup"},
        )
    finally:
        setuptools.setup = original
        os.chdir(before)
    return seen


def test_versions_agree(arguments: dict[str, Any]) -> None:
    manifest = ElementTree.parse(REPOSITORY / "package.xml").getroot()
    assert manifest.findtext("url", "").startswith("https://")
    assert (
        manifest.get("format") == "3" and manifest.findtext("export/build_type") == "ament_python"
    )
    changelog = (REPOSITORY / "CHANGELOG.rst").read_text()
    newest = re.search(r"^(\d+\.\d+\.\d+) \(", changelog, re.MULTILINE)
    assert newest is not None
    assert {manifest.findtext("version"), arguments["version"], newest[1]} == {
        proprio_ros.__version__
    }


ROSDEP = {
    "python3-matplotlib", "python3-numpy", "python3-pytest", "python3-ruamel.yaml", "python3-scipy", "python3-serial",
}  # fmt: skip
"""Keys of rosdep/python.yaml, and packages that Jazzy has: ros/rosdistro, commit 8468e88ccd."""
RELEASED = {
    "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "dynamixel_sdk", "geometry_msgs", "launch", "launch_ros",
    "lifecycle_msgs", "rcl_interfaces", "rclpy", "robot_state_publisher", "rviz2", "sensor_msgs", "std_msgs", "std_srvs",
    "visualization_msgs",
}  # fmt: skip


def test_rosdep_knows_every_key_and_pip_installs_the_rest(arguments: dict[str, Any]) -> None:
    root = ElementTree.parse(REPOSITORY / "package.xml").getroot()
    keys = {element.text for element in root if element.tag.endswith("_depend")}
    assert keys <= ROSDEP | RELEASED
    apart = {"dynamixel-sdk": "dynamixel_sdk", "pyserial": "python3-serial"}
    names = {Requirement(line).name for line in arguments["install_requires"]}
    lacking = {name for name in names if apart.get(name, f"python3-{name}") not in keys}
    page = (REPOSITORY / "docs" / "pages" / "arm.md").read_text()
    (installed,) = re.findall(r"activate && pip install ([\w -]+)$", page, re.MULTILINE)
    assert set(installed.split()) == lacking


def test_every_data_file_is_installed(arguments: dict[str, Any]) -> None:
    installed = {
        source: target for target, sources in arguments["data_files"] for source in sources
    }
    for folder in ("config", "urdf", "bags"):
        for path in (REPOSITORY / folder).rglob("*"):
            if path.is_file():
                relative = path.relative_to(REPOSITORY)
                assert (
                    installed[relative.as_posix()]
                    == f"share/proprio_ros/{relative.parent.as_posix()}"
                )
    assert (
        installed["proprio_ros/resource/proprio_ros"] == "share/ament_index/resource_index/packages"
    )
    assert installed["package.xml"] == "share/proprio_ros"


def test_a_script_beside_the_clone_imports_the_package(
    arguments: dict[str, Any], tmp_path: Path
) -> None:
    """A clone is a folder of the package's name: Python takes it for a package without code, unless the clone is on the path."""
    setuptools_of = importlib.import_module("setuptools.command.editable_wheel")
    packages = arguments["packages"]
    folder = arguments["package_dir"]
    # as setuptools chooses: a path, and not a finder that comes too late
    assert set(folder) == {""}
    assert setuptools_of._simple_layout(packages, folder, REPOSITORY)
    (tmp_path / "proprio_ros").symlink_to(REPOSITORY)
    (tmp_path / "script.py").write_text("import proprio_ros; print(proprio_ros.__version__)")
    done = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(REPOSITORY)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.strip() == proprio_ros.__version__, done.stderr


def test_entry_points_exist(arguments: dict[str, Any]) -> None:
    for script in arguments["entry_points"]["console_scripts"]:
        name, target = (part.strip() for part in script.split("="))
        module, function = target.split(":")
        assert name.startswith("proprio")
        assert callable(getattr(importlib.import_module(module), function))


def test_dependencies_are_declared_once(arguments: dict[str, Any]) -> None:
    """requires-python in [project] breaks colcon; ROS wheels only come through the extra."""
    project = (REPOSITORY / "pyproject.toml").read_text()
    assert not re.search(r"^(requires-python|dependencies)\s*=", project, re.MULTILINE)
    assert arguments["python_requires"] == ">=3.10"
    assert not any("ros-jazzy" in requirement for requirement in arguments["install_requires"])
    assert all("ros-jazzy" in requirement for requirement in arguments["extras_require"]["ros"])


def test_what_only_some_need_is_an_extra(arguments: dict[str, Any]) -> None:
    needed = {Requirement(line).name for line in arguments["install_requires"]}
    assert not needed & {"cma", "matplotlib", "meshio", "mujoco", "newton", "pyarrow", "ray"}


def pins(name: str) -> dict[str, Version]:
    """Versions of a file of `.ci`, where every line is a name and a version: no address, no path, no option."""
    lines = [
        line
        for line in (REPOSITORY / ".ci" / name).read_text().splitlines()
        if not line.startswith("#")
    ]
    exact = r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.]*"
    assert lines and all(
        re.fullmatch(rf'{exact}(; python_full_version (<|>=) "[0-9.]+")?', line) for line in lines
    )
    needs = [Requirement(line) for line in lines]
    return {
        canonicalize_name(need.name): Version(str(need.specifier).removeprefix("=="))
        for need in needs
        if need.marker is None or need.marker.evaluate()
    }


def test_the_gate_pins_every_dependency_within_its_bounds(arguments: dict[str, Any]) -> None:
    pinned = pins("constraints.txt")
    extras = [line for lines in arguments["extras_require"].values() for line in lines]
    for line in [*arguments["install_requires"], *extras]:
        requirement = Requirement(line)
        assert pinned[canonicalize_name(requirement.name)] in requirement.specifier, line
    for path in (".ci/run", ".ci/lowest"):
        installs = [
            line for line in (REPOSITORY / path).read_text().splitlines() if "pip install" in line
        ]
        assert installs and all(" -c .ci/" in line for line in installs), path


def test_the_lowest_versions_are_those_of_the_lower_bounds(arguments: dict[str, Any]) -> None:
    lowest = pins("lowest.txt")
    extras = arguments["extras_require"]
    lines = list(arguments["install_requires"])
    for name in ("sim", "batch", "report", "cma"):
        lines += extras[name]
    allowed = {requirement.name: requirement.specifier for requirement in map(Requirement, lines)}
    bounds = {
        name: Version(s.version)
        for name, those in allowed.items()
        for s in those
        if s.operator == ">="
    }
    assert lowest == bounds
    # a new major version of these has broken code before
    for name, next_major in (
        ("numpy", "3.0"),
        ("mujoco", "5.0"),
        ("warp-lang", "2.0"),
        ("cma", "5.0"),
        ("rosbags", "0.12"),
    ):
        assert next_major not in allowed[name], name


@pytest.mark.parametrize(
    "command",
    [["ruff", "check", "."], pytest.param(["mypy"], marks=pytest.mark.long)],
    ids=lambda command: command[0],
)
def test_linters(command: list[str]) -> None:
    pytest.importorskip(command[0])
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=REPOSITORY, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.long
def test_colcon_builds_it_and_its_entry_point_runs(tmp_path: Path) -> None:
    """As on a robot PC: build in a workspace, source it, run the installed script on an installed bag."""
    colcon = shutil.which("colcon")
    if colcon is None:
        if os.environ.get("PROPRIO_REQUIRE_COLCON"):
            pytest.fail(
                "colcon is missing: apt-get install colcon python3-colcon-ros python3-ament-package"
            )
        pytest.skip("needs colcon")
    source = tmp_path / "src" / "proprio_ros"
    shutil.copytree(
        REPOSITORY,
        source,
        ignore=shutil.ignore_patterns(".*", "build", "install", "log", "__pycache__", "*.egg-info"),
    )
    clean = {
        key: value
        for key, value in os.environ.items()
        if key not in ("PYTHONPATH", "VIRTUAL_ENV", "LD_LIBRARY_PATH")
    }
    # without the environment of the tests: colcon is the system's
    clean["PATH"] = os.pathsep.join(
        p for p in clean["PATH"].split(os.pathsep) if p != str(Path(sys.executable).parent)
    )
    built = subprocess.run(
        [colcon, "build"], cwd=tmp_path, env=clean, capture_output=True, text=True
    )
    assert built.returncode == 0, built.stdout + built.stderr
    prefix = tmp_path / "install" / "proprio_ros"
    script = prefix / "lib" / "proprio_ros" / "proprio"
    assert script.read_text().startswith("#!/usr/bin/env python3")
    assert (
        prefix / "share" / "ament_index" / "resource_index" / "packages" / "proprio_ros"
    ).is_file()
    shutil.rmtree(tmp_path / "src")  # what runs now has only what was installed
    libraries = next(prefix.glob("lib/python*/site-packages"))
    environment = {
        **clean,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{clean['PATH']}",
        "PYTHONPATH": str(libraries),
    }
    bag = prefix / "share" / "proprio_ros" / BAG
    done = subprocess.run(
        [script, "replay", bag, "--probe", "payload", "--json"],
        cwd=tmp_path, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr  # too wide: the arm is not calibrated
    assert json.loads(done.stdout)["estimates"][0]["value"] == pytest.approx(0.05, abs=1e-3)
    located = subprocess.run(
        ["python3", "-c", "import proprio_ros.inputs.resources as r; print(r.__file__, r.share_directory())"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert located.stdout.split() == [
        str(libraries / "proprio_ros/inputs/resources.py"),
        str(prefix / "share" / "proprio_ros"),
    ]
