"""README's commands and those of the page about arms, as they stand, in a fresh clone with an environment of its own.

The libraries are those of the environment that runs the tests; `.ci/run` installs them by README's command.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
import time
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from sensor_msgs.msg import JointState
from support.bends.messages import messages_of
from support.documents import README, REPOSITORY, page, text_of
from support.domains import free_domain
from support.drawn_arm import joints_of, write_urdf
from support.live import Client
from support.moved_arm import record_arm
from support.waiting import wait_for

from proprio_ros.cli.terminal import EXIT_NO_ANSWER, EXIT_OK
from proprio_ros.nodes.interface import services
from proprio_ros.nodes.messages import joint_state, time_ns
from proprio_ros.nodes.qos import STREAM

pytestmark = pytest.mark.long

LONGEST_S = 3600.0
"""A new machine compiles kernels first, and others may use it."""
END_S = 120.0
LIVE = re.compile(r"^\S*proprio live\b")
CALLING = ("another_robot", "payload", "until_sure", "calibrate_and_plan")
"""Pages whose calls are to be answered by the arm of README's example, too."""
CALL = re.compile(r"^\S*proprio call\b")


def commands(text: str, after: str) -> list[str]:
    """Those of the first block after some words, without comments, as a shell takes them."""
    block = re.search(r"```\n(.*?)```", text.split(after, 1)[1], re.DOTALL)
    assert block is not None
    lines = block[1].replace("\\\n", " ").splitlines()
    return [re.sub(r"\s+# .*$", "", line) for line in lines]


@dataclass
class Clone:
    """A copy of what the repository holds, with its own environment and home."""

    folder: Path
    environment: dict[str, str]

    def run(self, command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["bash", "-c", command],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
        )

    @contextmanager
    def live(self, command: str) -> Iterator[Path]:
        """`proprio live` in another terminal, until Ctrl-C; what it says."""
        with self.running(command) as said:
            yield said
        assert said.read_text().splitlines()[-1] == "proprio: all nodes have ended"

    @contextmanager
    def running(self, command: str) -> Iterator[Path]:
        """A program in another terminal, until Ctrl-C; what it says."""
        said = self.folder / "said"
        with said.open("wb") as stream:
            process = subprocess.Popen(
                ["bash", "-c", f"exec {command}"],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
            )
        try:
            yield said
            process.send_signal(signal.SIGINT)
            assert process.wait(END_S) == EXIT_OK, said.read_text()
        finally:
            process.kill()
            process.wait()


def copy_repository(folder: Path) -> None:
    """What git would put into a clone, as it is here."""
    listed = subprocess.run(
        ["git", "ls-files", "-coz", "--exclude-standard"],
        cwd=REPOSITORY,
        capture_output=True,
    )
    if listed.returncode != 0:
        pytest.skip("needs git, and the repository")
    for name in filter(None, listed.stdout.decode().split("\0")):
        source = REPOSITORY / name
        if source.is_file():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)


def make_environment(folder: Path) -> None:
    """An environment of Python that has the libraries of this one, and no proprio_ros."""
    venv.create(folder, symlinks=True)
    paths = {"base": str(folder), "platbase": str(folder)}
    own = Path(sysconfig.get_path("purelib", vars=paths))
    # a line names a folder, whose own files of this kind are left alone: one of them leads to the package that runs the tests
    libraries = dict.fromkeys(path for path in sys.path if path.endswith("-packages"))
    installed = Path(sysconfig.get_path("purelib"))
    ros = [path.read_text() for path in installed.glob("ros_*.pth")]
    (own / "libraries.pth").write_text("\n".join([*libraries, *ros]))


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Clone:
    top = tmp_path_factory.mktemp("fresh")
    folder = top / "clone"
    copy_repository(folder)
    make_environment(folder / ".venv")
    home = top / "home"
    home.mkdir()
    # kernels that are compiled already
    (home / ".cache").symlink_to(Path.home() / ".cache")
    environment = {
        **os.environ,
        "HOME": str(home),
        "PATH": f"{folder / '.venv' / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "ROS_DOMAIN_ID": free_domain(),
        "TMPDIR": str(top),
    }
    environment.pop("PYTHONPATH", None)
    clone = Clone(folder, environment)
    pip = f"{sys.executable} -m pip --python .venv/bin/python"
    done = clone.run(f"{pip} install -q --no-deps -e .")
    if "No matching distribution found for setuptools" in done.stderr:
        pytest.skip("needs a package index, for setuptools")
    assert done.returncode == 0, done.stderr
    where = clone.run("cd / && python -c 'import proprio_ros; print(proprio_ros.__file__)'")
    assert where.stdout.strip() == str(folder / "proprio_ros" / "__init__.py"), where.stderr
    return clone


def test_the_offline_commands_of_readme(clone: Clone) -> None:
    calibrate, replay = commands(text_of(README), "**Offline**")
    done = clone.run(calibrate)
    assert done.returncode == EXIT_OK, done.stderr
    written = re.search(r"--output (\S+)", calibrate)
    assert written is not None
    assert (clone.folder / written[1]).is_file()
    done = clone.run(replay)
    assert done.returncode == EXIT_OK, done.stderr
    assert done.stdout.startswith("accepted")


def calls_of(*pages: str) -> list[str]:
    """All calls on some pages, each once, without comments."""
    found = re.findall(r"^(proprio call [^#\n]+)", "\n".join(map(page, pages)), re.MULTILINE)
    return list(dict.fromkeys(each.strip() for each in found))


def answers(clone: Clone, command: str) -> None:
    """That a service answers, yes or no, with a sentence."""
    done = clone.run(command)
    assert done.returncode in (EXIT_OK, EXIT_NO_ANSWER), f"{command}: {done.stderr}"
    assert done.stdout, command


def test_the_live_commands(clone: Clone) -> None:
    """Readme's, and on the same arm those of its page: each starts, answers and ends, without `ros2`."""
    live, weigh = commands(text_of(README), "**Live**")
    assert LIVE.match(live)
    with clone.live(live) as said:
        assert wait_for(lambda: "[identifier]: ready" in said.read_text(), LONGEST_S)
        done = clone.run(weigh)
        assert done.returncode in (EXIT_OK, EXIT_NO_ANSWER), done.stderr
        assert done.stdout, done.stderr
        of_page = [line for line in commands(page("arm"), "Then in another terminal") if line]
        assert len(of_page) == 4
        for command in of_page:
            assert CALL.match(command), command
            if command in weigh:  # it takes the longest, and was done
                continue
            answers(clone, command)
        for command in calls_of(*CALLING):
            if command.split()[2] not in " ".join([weigh, *of_page]):
                answers(clone, command)
    kept = clone.environment["HOME"]
    assert list(Path(kept).glob(".ros/proprio_ros/virtual_default/*_payload/bag"))


def test_live_on_an_arm_that_is_not_plugged_in_and_on_a_virtual_one(clone: Clone) -> None:
    on_arm, virtual = commands(page("arm"), "## The three nodes")
    port = re.search(r"--port (\S+)", on_arm)
    assert port is not None
    if not Path(port[1]).exists():
        with clone.live(on_arm) as said:
            words = f"{port[1]}: there is no such port"
            assert wait_for(lambda: words in said.read_text(), LONGEST_S), said.read_text()
    with clone.live(virtual) as said:
        assert wait_for(lambda: "a virtual open_manipulator_x at" in said.read_text(), LONGEST_S)


@pytest.mark.parametrize(
    "name",
    ["proprio", "proprio_driver", "proprio_excitation", "proprio_identifier", "proprio_virtual"],
)
def test_every_program_that_is_installed_explains_itself(clone: Clone, name: str) -> None:
    done = clone.run(f"{name} --help")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: {name} ")


def test_an_arm_at_work_is_weighed_by_the_commands_of_its_page(
    clone: Clone, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the arm's own driver would publish is that of a simulated arm, whose recordings calibrate it."""
    text = page("weigh_at_work")
    _record, calibrate = commands(text, "## Calibrate once")
    (identify,) = commands(text, "give the identifier that file")
    weigh, _of_ros = commands(text, "## Weigh the last seconds")
    constants = dict.fromkeys(joints_of(3), 6.0)
    urdf = write_urdf(clone.folder / "my_arm.urdf", 3, 5)
    for number, (name, kg, seconds) in enumerate(
        [("EMPTY_1", 0.0, 20.0), ("EMPTY_2", 0.0, 20.0), ("AT_WORK", 1.0, 60.0)]
    ):
        record_arm(clone.folder / name, urdf, constants, "tool0", kg, number, seconds=seconds)
    assert clone.run("proprio robot new my_arm.urdf --output my_arm.yaml").returncode == EXIT_OK
    robot = clone.folder / "my_arm.yaml"
    lines = [
        line.replace("null", "6.0", 1) if "STATE THIS" in line else line
        for line in robot.read_text().splitlines()
    ]
    robot.write_text("\n".join(lines) + "\n")
    done = clone.run(calibrate.replace("BAG [BAG ...]", "EMPTY_1 EMPTY_2"))
    assert done.returncode == EXIT_OK, done.stderr + done.stdout
    monkeypatch.setenv("ROS_DOMAIN_ID", clone.environment["ROS_DOMAIN_ID"])
    with clone.running(identify) as said:
        assert wait_for(lambda: "[identifier]: ready" in said.read_text(), LONGEST_S)
        with publishing(clone.folder / "AT_WORK") as published:
            assert wait_for(lambda: len(published) > 1800, LONGEST_S)
            done = clone.run(weigh)
    assert done.returncode in (EXIT_OK, EXIT_NO_ANSWER), done.stderr
    assert "recording: " in done.stdout, "it was weighed, whatever the answer"


@contextmanager
def publishing(bag: Path) -> Iterator[list[int]]:
    """Joint states of a bag, at their pace, stamped anew; those that were published."""
    client = Client()
    published: list[int] = []
    ended = threading.Event()
    recorded = [message for topic, _, _, message in messages_of(bag) if topic == "/joint_states"]
    stamps = [time_ns(each.header.stamp) for each in recorded]
    publisher = client.node.create_publisher(JointState, "/joint_states", STREAM)

    def publish() -> None:
        begun_ns = time.time_ns()
        for stamp_ns, message in zip(stamps, recorded, strict=True):
            due_ns = begun_ns + stamp_ns - stamps[0]
            if ended.wait(max(1e-9 * (due_ns - time.time_ns()), 0.0)):
                return
            values = (message.position, message.velocity, message.effort)
            position, velocity, effort = (each.tolist() for each in values)
            publisher.publish(joint_state(due_ns, list(message.name), position, velocity, effort))
            published.append(due_ns)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield published
    finally:
        ended.set()
        thread.join()
        client.close()


def test_what_the_pages_call_is_a_service() -> None:
    for name in ("arm", "weigh_at_work", *CALLING):
        assert calls_of(name), f"{name}: without `ros2`, too"
        called = re.findall(r"^proprio call ([a-z_]+)", page(name), re.MULTILINE)
        called += re.findall(r"ros2 service call /\w+/([a-z_]+) ", page(name))
        assert called
        assert set(called) <= services().keys()
