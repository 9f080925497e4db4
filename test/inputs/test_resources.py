"""Where the package finds its own files: in the source tree, and as pip and colcon install them."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.resources import (
    private_folder,
    resource,
    resource_names,
    share_directory,
    write_in_one_step,
)

REPOSITORY = Path(__file__).resolve().parents[2]


def test_resources_of_the_source_tree() -> None:
    assert share_directory() == REPOSITORY
    assert (
        resource("urdf", "pendulum")
        == resource("urdf", "pendulum.urdf")
        == REPOSITORY / "urdf" / "pendulum.urdf"
    )
    assert {"open_manipulator_x", "pendulum"} <= set(resource_names("robots"))
    with pytest.raises(
        ConfigurationError, match=r"no 'scara' among the robots; there are: .*open_manipulator_x"
    ):
        resource("robots", "scara")


@pytest.mark.parametrize("installed", ["lib/python3/site-packages", "elsewhere"])
def test_resources_of_an_installation(tmp_path: Path, installed: str) -> None:
    """As pip and colcon lay files out, and as a sourced workspace names them where code and data lie apart."""
    package = tmp_path / installed / "proprio_ros"
    (package / "inputs").mkdir(parents=True)
    for name in (
        "__init__.py",
        "version.py",
        "registry.py",
        "errors.py",
        "whole_files.py",
        "inputs/__init__.py",
        "inputs/resources.py",
    ):
        shutil.copy(REPOSITORY / "proprio_ros" / name, package / name)
    prefix = tmp_path if installed.startswith("lib") else tmp_path / "prefix"
    share = prefix / "share" / "proprio_ros" / "config" / "robots"
    share.mkdir(parents=True)
    shutil.copy(REPOSITORY / "config" / "robots" / "open_manipulator_x.yaml", share)
    answer = subprocess.run(
        [
            sys.executable,
            "-c",
            "from proprio_ros.inputs.resources import resource; print(resource('robots', 'open_manipulator_x'))",
        ],
        env=os.environ | {"PYTHONPATH": str(package.parent), "AMENT_PREFIX_PATH": str(prefix)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(answer.stdout.strip()) == share / "open_manipulator_x.yaml"


# --- files of the user -----------------------------------------------------------------------------------------------


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_a_new_file_has_the_mode_that_the_umask_leaves(
    tmp_path: Path, umask: int, mode: int
) -> None:
    before = os.umask(umask)
    try:
        write_in_one_step(tmp_path / "page.html", "text", "--report")
    finally:
        os.umask(before)
    assert mode_of(tmp_path / "page.html") == mode
    assert os.listdir(tmp_path) == ["page.html"]


def test_a_replaced_file_keeps_its_mode_and_a_link_its_place(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    link = tmp_path / "link.html"
    page.write_text("old")
    page.chmod(0o640)
    link.symlink_to(page)
    write_in_one_step(link, "new", "--report")
    assert link.is_symlink()
    assert page.read_text() == "new"
    assert mode_of(page) == 0o640


def test_nothing_but_a_file_is_replaced(tmp_path: Path) -> None:
    """A pipe is written into, a folder refused; a rename would have put a file in the place of either."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(ConfigurationError, match="cannot be written"):
        write_in_one_step(pipe, "nobody reads", "--report")
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_in_one_step(pipe, "some text", "--report")
    assert os.read(reader, 100) == b"some text"
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    os.close(reader)
    with pytest.raises(ConfigurationError, match="directory"):
        write_in_one_step(tmp_path, "text", "--report")


def test_a_private_folder_is_no_link_and_nobody_elses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_to_all = tmp_path / "there"
    open_to_all.mkdir(mode=0o777)
    assert (
        mode_of(private_folder(open_to_all)) == 0o700
        and mode_of(private_folder(tmp_path / "new")) == 0o700
    )
    (tmp_path / "link").symlink_to(open_to_all)
    with pytest.raises(OSError, match="not a folder of this user"):
        private_folder(tmp_path / "link")
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    with pytest.raises(OSError, match="not a folder of this user"):
        private_folder(open_to_all)
