"""Where the package finds its own files: in the source tree, and as pip and colcon install them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.resources import resource, resource_names, share_directory

REPOSITORY = Path(__file__).resolve().parents[1]


def test_resources_of_the_source_tree() -> None:
    assert share_directory() == REPOSITORY
    assert resource("urdf", "pendulum") == resource("urdf", "pendulum.urdf") == REPOSITORY / "urdf" / "pendulum.urdf"
    assert {"open_manipulator_x", "pendulum"} <= set(resource_names("robots"))
    with pytest.raises(ConfigurationError, match=r"no 'scara' among the robots; there are: .*open_manipulator_x"):
        resource("robots", "scara")


@pytest.mark.parametrize("installed", ["lib/python3/site-packages", "elsewhere"])
def test_resources_of_an_installation(tmp_path: Path, installed: str) -> None:
    """As pip and colcon lay files out, and as a sourced workspace names them where code and data lie apart."""
    package = tmp_path / installed / "proprio_ros"
    package.mkdir(parents=True)
    for name in ("__init__.py", "errors.py", "resources.py"):
        shutil.copy(REPOSITORY / "proprio_ros" / name, package)
    prefix = tmp_path if installed.startswith("lib") else tmp_path / "prefix"
    share = prefix / "share" / "proprio_ros" / "config" / "robots"
    share.mkdir(parents=True)
    shutil.copy(REPOSITORY / "config" / "robots" / "open_manipulator_x.yaml", share)
    answer = subprocess.run(
        [
            sys.executable,
            "-c",
            "from proprio_ros.resources import resource; print(resource('robots', 'open_manipulator_x'))",
        ],
        env=os.environ | {"PYTHONPATH": str(package.parent), "AMENT_PREFIX_PATH": str(prefix)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(answer.stdout.strip()) == share / "open_manipulator_x.yaml"
