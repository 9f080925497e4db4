"""`proprio live` and `proprio call` as a user types them, on a robot that outlives them: what starts, answers, and how it ends."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from support.domains import free_domain
from support.live import UP_S, Client, running, wait_for
from support.marked import MARK, alive
from support.pushes import AWAY, one_push

from proprio_ros.cli.terminal import EXIT_BAD_INPUT, EXIT_INTERRUPTED, EXIT_NO_ANSWER, EXIT_OK
from proprio_ros.inputs.resources import resource

pytestmark = pytest.mark.long

PROPRIO = [sys.executable, "-m", "proprio_ros.cli"]
ELBOW = "joint3"
PUSH_A = -0.28
END_S = 120.0
"""Nodes end one after the other, each within a second on an idle computer."""
PATIENT: dict[str, dict[str, Any]] = {
    "driver": {"reply_timeout": 0.1, "command_timeout": 0.5}, "excitation": {"stale_after": 4.0},
}  # fmt: skip
"""Nobody here may take a late message for silence."""


def checked(printed: str) -> dict[str, Any]:
    """The one object of `--json`, as the schema has it."""
    content = json.loads(printed)
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(content, json.loads(resource("schema", "output").read_text()))
    return dict(content)


def parameter_file(folder: Path, stated: Mapping[str, Mapping[str, Any]]) -> Path:
    """JSON is YAML, too."""
    path = folder / "mine.yaml"
    content = {f"/**/{node}": {"ros__parameters": values} for node, values in stated.items()}
    path.write_text(json.dumps(content))
    return path


@dataclass
class Live:
    """`proprio live`, and the mark that its processes carry in their environment."""

    process: subprocess.Popen[bytes]
    said: Path
    mark: str

    @property
    def told(self) -> str:
        return self.said.read_text()

    def alive(self) -> dict[int, str]:
        """Its processes that are still there, with their command lines."""
        return alive(self.mark)

    def node(self, name: str) -> int:
        """Process of a node."""
        module = f"nodes.{name} "
        found = [pid for pid, words in self.alive().items() if module in words]
        return found[0]

    def end(self, number: int) -> int:
        """Ask for its end; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(END_S)


@dataclass
class Arm:
    """A virtual robot that belongs to nobody, and who listens to it."""

    folder: Path
    client: Client
    lives: list[Live] = field(default_factory=list)

    def push_file(self, duration_s: float) -> str:
        path = self.folder / f"push_{duration_s:g}.yaml"
        path.write_text(one_push(PUSH_A, duration_s, AWAY))
        return str(path)

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def calls(self, *words: str) -> subprocess.CompletedProcess[str]:
        """`proprio call` until it has ended."""
        return subprocess.run([*PROPRIO, "call", *words], capture_output=True, text=True)

    def at_rest(self) -> bool:
        """Whether no motor has current."""
        motors = self.client.motors
        motors.clear()
        assert wait_for(lambda: bool(motors))
        return not any(motors[-1].effort)

    def begin_push(self) -> None:
        """One that goes on until something ends it."""
        assert self.client.set("/excitation", "probe", self.push_file(20.0)).successful
        assert self.calls("run").returncode == EXIT_OK
        self.client.wait_for_phase("probe")
        assert wait_for(lambda: abs(self.client.motor(ELBOW) - PUSH_A) < 0.01)


@contextmanager
def lives(arm: Arm) -> Iterator[Live]:
    """`proprio live` on the robot, up and talking."""
    mark = uuid.uuid4().hex
    said = arm.folder / f"live_{len(arm.lives)}"
    stated = {
        **PATIENT,
        "identifier": {"payload_sequence": arm.push_file(0.6), "calibration": "none"},
    }
    words = ["live", "--port", str(arm.folder / "bus"), "--data-directory", str(arm.data)]
    words += ["--params-file", str(parameter_file(arm.folder, stated))]
    environment = {**os.environ, MARK: mark, "ROS_LOG_DIR": str(arm.folder / "log")}
    with said.open("wb") as stderr:
        process = subprocess.Popen(
            [*PROPRIO, *words],
            stdin=subprocess.DEVNULL,
            stdout=stderr,
            stderr=stderr,
            env=environment,
        )
    live = Live(process, said, mark)
    arm.lives.append(live)
    arm.client.excitation.clear()  # what the one before has said
    try:
        assert wait_for(
            lambda: "[identifier]: ready" in live.told or process.poll() is not None, UP_S
        )
        assert process.poll() is None, live.told
        arm.client.states.clear()
        assert wait_for(lambda: len(arm.client.states) > 10), live.told
        assert wait_for(lambda: arm.client.excitation.get("joint_states") == "true"), live.told
        yield live
    finally:
        for left in live.alive():
            os.kill(left, signal.SIGKILL)
        process.wait(END_S)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    folder = tmp_path_factory.mktemp("live")
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROS_DOMAIN_ID", free_domain())
        with running(folder, "virtual", virtual={"object": 0.05}) as (_, client):
            yield Arm(folder, client)


@pytest.fixture(scope="module")
def live(arm: Arm) -> Iterator[Live]:
    """One that several tests call."""
    with lives(arm) as live:
        yield live


def test_the_services_that_answer_are_listed(arm: Arm, live: Live) -> None:
    done = arm.calls("--list", "--json")
    assert done.returncode == EXIT_OK, done.stderr
    listed = checked(done.stdout)
    assert listed["schema"] == "proprio_ros/services/1"
    named = {each["name"]: each for each in listed["services"]}
    assert {
        "calibrate_robot",
        "calibrate_payload",
        "weigh",
        "cancel",
        "run",
        "abort",
        "stop",
        "torque",
    } <= named.keys()
    assert all(each["about"] and each["node_state"] == "active" for each in named.values())
    assert named["run"]["service"] == "/excitation/run"
    shown = arm.calls("--list").stdout
    assert "/identifier (active)\n" in shown
    assert all(re.search(rf"^  {name} +\S", shown, re.MULTILINE) for name in named)


def test_a_weighing_by_words(arm: Arm, live: Live) -> None:
    done = arm.calls("calibrate_payload", "--set", "payload.com=[0,0,0]", "--json")
    answer = checked(done.stdout)
    assert done.returncode == (EXIT_OK if answer["success"] else EXIT_NO_ANSWER), done.stderr
    assert answer["schema"] == "proprio_ros/call/1"
    assert answer["service"] == "/identifier/calibrate_payload"
    assert wait_for(arm.client.final)
    published = arm.client.estimates[-1]
    estimate = answer["estimate"]
    assert estimate["verdict"] == published["verdict"]
    assert answer["success"] == (estimate["verdict"] == "accepted")
    assert estimate["payload_mass.unit"] == "kg"
    told = done.stderr.splitlines()
    assert any(line.startswith("proprio: payload: ") for line in told), told
    (result,) = arm.data.glob("*_payload/estimate.json")
    assert json.loads(result.read_text())["verdict"] == estimate["verdict"]
    assert arm.client.get("/identifier", "settings").string_array_value == ["payload.com=[0,0,0]"]


def test_no_for_an_answer(arm: Arm, live: Live) -> None:
    done = arm.calls("refresh_robot")
    assert done.returncode == EXIT_NO_ANSWER
    assert (
        done.stdout == "there is no calibration to bring up to date: call ~/calibrate_robot first\n"
    )
    refused = arm.calls("weigh", "--set", "payload.colour=red")
    assert refused.returncode == EXIT_BAD_INPUT
    assert refused.stdout == ""
    assert refused.stderr.splitlines()[-1].startswith("proprio: --set: ")


def test_torque_is_switched(arm: Arm, live: Live) -> None:
    assert arm.calls("torque", "false").returncode == EXIT_OK
    assert wait_for(arm.at_rest)
    assert arm.calls("torque", "true").stdout == "held\n"
    assert wait_for(lambda: any(arm.client.motors[-1].effort))
    answer = arm.client.call("/virtual/recover")
    assert answer.success, f"where a fall ends hangs on how long it lasted: {answer.message}"


def test_a_node_that_is_not_there(arm: Arm, live: Live) -> None:
    done = arm.calls("weigh", "--namespace", "nowhere")
    assert done.returncode == EXIT_BAD_INPUT
    *_, last = done.stderr.splitlines()
    assert "there is no identifier node in ROS domain" in last
    assert "namespace nowhere" in last
    assert "start it with proprio live" in last


def test_a_call_that_is_interrupted_is_cancelled(arm: Arm, live: Live) -> None:
    client = arm.client
    assert client.set("/identifier", "payload_sequence", arm.push_file(20.0)).successful
    words = [*PROPRIO, "call", "calibrate_payload"]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, text=True, **pipes) as call:
        client.wait_for_phase("probe")
        assert wait_for(lambda: abs(client.motor(ELBOW) - PUSH_A) < 0.01)
        call.send_signal(signal.SIGINT)
        said, told = call.communicate(timeout=END_S)
    assert call.returncode == EXIT_INTERRUPTED, told
    assert said == ""
    assert told.splitlines()[-2:] == [
        "proprio: calibrate_payload was cancelled; the arm is held",
        "proprio: interrupted",
    ]
    client.wait_for_phase("aborted")
    assert any(client.motors[-1].effort), "held"


def test_ctrl_c_ends_all_in_order(arm: Arm, live: Live) -> None:
    """The last test of the shared one: a push is under way."""
    arm.begin_push()
    assert live.end(signal.SIGINT) == EXIT_OK, live.told
    assert live.told.splitlines()[-1] == "proprio: all nodes have ended"
    assert_gone(arm, live)


def test_sigterm_ends_all_in_order(arm: Arm) -> None:
    with lives(arm) as live:
        arm.begin_push()
        assert live.end(signal.SIGTERM) == EXIT_OK, live.told
        assert_gone(arm, live)


def test_a_driver_that_dies_ends_the_rest(arm: Arm) -> None:
    with lives(arm) as live:
        arm.begin_push()
        os.kill(live.node("driver"), signal.SIGKILL)
        assert live.process.wait(END_S) == EXIT_BAD_INPUT, live.told
        last = live.told.splitlines()[-1]
        assert last.startswith("proprio: the driver node has ended (killed by SIGKILL): ")
        assert_gone(arm, live)


def test_an_identifier_that_dies_drops_no_arm(arm: Arm) -> None:
    with lives(arm) as live:
        arm.begin_push()
        os.kill(live.node("identifier"), signal.SIGKILL)
        assert wait_for(lambda: "the identifier node has ended (killed by SIGKILL)" in live.told)
        assert not arm.at_rest(), "the driver goes on"
        assert live.end(signal.SIGTERM) == EXIT_OK, live.told
        assert_gone(arm, live)


def test_no_node_outlives_a_live_that_is_killed(arm: Arm) -> None:
    with lives(arm) as live:
        assert len(live.alive()) >= 4
        live.process.kill()
        assert wait_for(lambda: not live.alive(), END_S), live.alive()
        assert wait_for(arm.at_rest), "the servos' own watchdog, or the driver's last word"


def assert_gone(arm: Arm, live: Live) -> None:
    """No process is left, no motor pushes, and nobody ended by a traceback."""
    assert not live.alive(), "it waits for its nodes before it goes"
    assert wait_for(arm.at_rest)
    assert "Traceback" not in live.told


def test_it_ends_while_nobody_reads_what_it_says(arm: Arm) -> None:
    """A pipe that was full kept it, and its nodes, for ever."""
    said, unread = os.pipe()
    os.set_blocking(unread, False)
    with pytest.raises(BlockingIOError):
        while True:
            os.write(unread, b"\n" * 4096)
    os.set_blocking(unread, True)
    mark = uuid.uuid4().hex
    words = ["live", "--port", str(arm.folder / "bus"), "--data-directory", str(arm.data)]
    process = subprocess.Popen(
        [*PROPRIO, *words],
        stdin=subprocess.DEVNULL,
        stdout=unread,
        stderr=unread,
        env={**os.environ, MARK: mark, "ROS_LOG_DIR": str(arm.folder / "log")},
    )
    try:
        assert wait_for(
            lambda: any("nodes.driver " in words for words in alive(mark).values()), UP_S
        )
        arm.client.states.clear()  # of those before
        assert wait_for(lambda: len(arm.client.states) > 10, UP_S)
        process.send_signal(signal.SIGTERM)
        assert process.wait(END_S) == EXIT_OK
        assert not alive(mark)
    finally:
        process.kill()
        os.close(said)
        os.close(unread)
