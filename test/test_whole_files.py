"""What is written is whole or not there, however the process ends; and what cannot be written is one sentence and one object."""

from __future__ import annotations

import errno
import json
import os
import signal
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from proprio_ros import cli
from proprio_ros.cli import main
from proprio_ros.errors import ComputerError, ConfigurationError, RecordingError, of_the_machine
from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.whole_files import in_one_step, leave_nothing_unfinished

BAGS = Path(__file__).resolve().parents[1] / "bags"
PUSH = str(BAGS / "realistic_s00_fixed_light_ball_20g_joint3" / "bag_mcap")
ASKED = ["--probe=payload", "--set=payload.shape=sphere", "--set=payload.size=0.0272"]


@pytest.mark.parametrize("ended_by", [KeyboardInterrupt, SystemExit, OSError, MemoryError])
def test_a_write_that_is_interrupted_leaves_what_was_there(
    tmp_path: Path, ended_by: type[BaseException]
) -> None:
    path = tmp_path / "page.html"
    path.write_text("before")
    path.chmod(0o640)
    with pytest.raises(ended_by), in_one_step(path) as stream:
        stream.write(b"half")
        assert len(list(tmp_path.iterdir())) == 2
        raise ended_by
    assert [each.name for each in tmp_path.iterdir()] == ["page.html"]
    assert path.read_text() == "before"
    write_in_one_step(path, "after \udc80", "--report")
    assert path.read_bytes() == b"after \\udc80" and stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_process_that_ends_at_once_takes_what_it_was_writing_along(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), in_one_step(tmp_path / "rows") as stream:
        stream.write(b"half")
        leave_nothing_unfinished()
        assert not list(tmp_path.iterdir())


@pytest.fixture
def handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    ("number", "code", "words"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "ended by SIGTERM")],
)
@pytest.mark.usefixtures("handlers")
def test_a_signal_in_mid_write_leaves_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    code: int,
    words: str,
) -> None:
    def command(*_: object) -> int:
        with in_one_step(tmp_path / "report.html") as stream:
            stream.write(b"half")
            signal.raise_signal(number)
        return 0

    parser = SimpleNamespace(parse_args=lambda _: SimpleNamespace(command=command))
    monkeypatch.setattr(cli, "make_parser", lambda: parser)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, cli._terminate)
    assert main(["replay", "--json"]) == code
    printed = capsys.readouterr()
    assert printed.err == f"proprio: {words}\n" and not list(tmp_path.iterdir())
    assert json.loads(printed.out)["exit_code"] == code


@pytest.mark.parametrize("words", [["check", PUSH], ["check", PUSH, "--json"], ["check", "no"]])
def test_an_answer_onto_a_full_disk_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: list[str],
) -> None:
    if not os.path.exists("/dev/full"):
        pytest.skip("needs /dev/full")
    full = open("/dev/full", "w")  # noqa: SIM115 (its closing fails, too)
    monkeypatch.setattr(sys, "stdout", full)
    assert main(words) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line == (
        "proprio: no: no such bag; give a bag folder, or a .mcap or .db3 file"
        if words[-1] == "no"
        else "proprio: the answer cannot be printed: No space left on device"
    )
    os.dup2(
        os.open(os.devnull, os.O_WRONLY),
        full.fileno(),
    )


@pytest.mark.parametrize("command", ["replay", "calibrate"])
def test_a_report_that_cannot_be_written_is_one_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    """Nobody reads the pipe, which shows only once there is something to write."""
    report = tmp_path / "pipe.html"
    os.mkfifo(report)
    words = [command, PUSH, "--json", f"--report={report}"]
    words += ASKED if command == "replay" else ["--output", str(tmp_path / "arm.yaml")]
    assert main(words) == 2
    printed = capsys.readouterr()
    answer: dict[str, Any] = json.loads(printed.out)
    assert answer["exit_code"] == 2 and "cannot be written" in answer["error"]
    assert printed.err.splitlines()[-1] == f"proprio: {answer['error']}"


def test_a_computer_without_memory_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("proprio_ros.pipeline.check.check_bags", full)
    assert main(["check", PUSH, "--json"]) == 2
    printed = capsys.readouterr()
    assert "not enough memory" in json.loads(printed.out)["error"]
    assert len(printed.err.splitlines()) == 1


def test_what_the_computer_did_is_told_from_what_it_was_given() -> None:
    def led_to(reason: BaseException) -> RecordingError:
        try:
            raise RecordingError("cannot be read") from reason
        except RecordingError as error:
            return error

    for number in (errno.ENOSPC, errno.EACCES, errno.EIO, errno.EROFS, errno.EMFILE):
        assert of_the_machine(led_to(OSError(number, os.strerror(number))))
    assert of_the_machine(led_to(MemoryError())) and of_the_machine(ComputerError("full"))
    for number in (errno.ENOENT, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG):
        assert not of_the_machine(led_to(OSError(number, os.strerror(number))))
    for error in (ValueError(), KeyError("x"), OSError("of no number"), ConfigurationError("x")):
        assert not of_the_machine(led_to(error))
    assert not of_the_machine(None)
