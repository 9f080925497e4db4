"""What a person sees on a terminal, and that scripts in a pipe see none of it."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from proprio_ros.cli import main
from proprio_ros.cli.completion import SHELLS
from proprio_ros.errors import together

BAGS = Path(__file__).resolve().parents[1] / "bags"
PUSH = str(BAGS / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap")
STUCK = str(BAGS / "friction_s00_fixed_random_a_joint3" / "bag_mcap")
RESULTS = Path(__file__).resolve().parents[1] / "docs" / "pages" / "results.md"
TRY = """
for words in "proprio re" "proprio replay --pro" "proprio replay --probe " "proprio robot new --eff" "proprio check --robot so"; do
    IFS=" " read -ra COMP_WORDS <<< "$words"; [[ $words == *" " ]] && COMP_WORDS+=("")
    COMP_CWORD=$(( ${#COMP_WORDS[@]} - 1 )); _proprio; echo "${COMPREPLY[*]}"
done
"""


def on_terminal(*words: str, columns: int = 90, **environment: str) -> str:
    """What `proprio` writes on a terminal that is so wide."""
    ours, its = pty.openpty()
    fcntl.ioctl(
        its,
        termios.TIOCSWINSZ,
        struct.pack("HHHH", 40, columns, 0, 0),
    )
    inherited = {
        key: value for key, value in os.environ.items() if key not in ("COLUMNS", "NO_COLOR")
    }
    command = [sys.executable, "-m", "proprio_ros.cli", *words]
    with subprocess.Popen(
        command, stdout=its, stderr=its, env={**inherited, "TERM": "xterm", **environment}
    ):
        os.close(its)
        written = b""
        while True:
            try:
                written += os.read(ours, 65536)
            except OSError:  # nobody writes to it any more
                break
    os.close(ours)
    return written.decode().replace("\r\n", "\n")


def test_a_terminal_gets_colours_and_lines_that_fit(capsys: pytest.CaptureFixture[str]) -> None:
    main(["replay", PUSH, "--probe", "payload"])
    piped = capsys.readouterr().out
    assert "\033" not in piped and max(map(len, piped.splitlines())) > 120
    seen = on_terminal("replay", PUSH, "--probe", "payload")
    assert seen.startswith("\033[33mtoo_wide\033[0m  (payload")
    for dull in (
        on_terminal("replay", PUSH, "--probe", "payload", NO_COLOR="1"),
        on_terminal("replay", PUSH, "--probe", "payload", TERM="dumb"),
        re.sub(r"\033\[\d+m", "", seen),
    ):
        assert "\033" not in dull and max(map(len, dull.splitlines())) <= 90
        assert dull.replace("±", "+-").split() == piped.split(), "the words stay"
    assert "±50 %" in seen and "+-" not in seen
    plain = on_terminal("replay", PUSH, "--probe", "payload", PYTHONIOENCODING="ascii")
    assert "+-50 %" in plain


def test_several_answers_are_a_table_and_errors_are_wrapped() -> None:
    seen = on_terminal("check", PUSH, STUCK)
    assert re.search(
        r"^recording +usable +seconds +a light mass to\n(?:\S+ +[01] of 1 .*\n){2}",
        seen,
        re.MULTILINE,
    )
    assert "usable  seconds" not in on_terminal("check", PUSH)
    wrong = on_terminal(
        "check",
        "nowhere_" + "far/" * 5 + "bag",
        PUSH,
        columns=60,
    )
    assert (
        wrong.startswith("\033[31mproprio: \033[0m") and max(map(len, wrong.splitlines()[1:])) <= 60
    )


def test_a_batch_shows_its_answers(tmp_path: Path) -> None:
    words = [
        "batch",
        PUSH,
        STUCK,
        "--out",
        str(tmp_path / "out"),
        "--jobs",
        "1",
    ]
    seen = on_terminal(*words, columns=150)
    assert re.search(
        r"^episode +answer +95 % interval +verdict\n.*bag_mcap +- +- +not_identifiable +stuck",
        seen,
        re.MULTILINE,
    )
    assert re.search(
        r"^\S*bag_mcap +50 g +0 \.\. 131 g +too_wide +too_wide, not_calibrated", seen, re.MULTILINE
    ), seen
    again = subprocess.run(
        [
            sys.executable,
            "-m",
            "proprio_ros.cli",
            *words,
        ],
        capture_output=True,
        text=True,
    )
    assert (
        again.stdout.splitlines()[0] == "2 episodes: 1 not_identifiable, 1 too_wide"
        and "95 %" not in again.stdout
    )


def test_what_is_said_of_several_runs_is_said_once() -> None:
    alone = [
        "x/bag#2: hot",
        "y/bag#1: lost",
        "no run: lost",
        "#1: lost",
        "bag#3 was left out: stuck",
    ]
    assert together(["x/bag#1: lost", "x/bag#2: lost", *alone, "x/bag#10: lost"]) == [
        "x/bag#1, 2, 10: lost",
        *alone,
    ]


def test_json_is_the_same_on_a_terminal() -> None:
    assert (
        json.loads(on_terminal("check", PUSH, STUCK, "--json"))["schema"] == "proprio_ros/check/1"
    )


def test_what_the_documentation_asks_of_json_is_in_it(capsys: pytest.CaptureFixture[str]) -> None:
    programs = re.findall(
        r"^proprio (.+) --json \| jq -r '(.+)'$", RESULTS.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(programs) == 3
    for command, program in programs:
        words = command.replace("BAGS", f"{PUSH} {STUCK}").replace("BAG", PUSH).split()
        main([*words, "--json"])
        printed = capsys.readouterr().out
        for name in re.findall(r"(?<![\w\]])\.(\w+)", program):
            assert f'"{name}": ' in printed, program
        if shutil.which("jq"):
            done = subprocess.run(
                ["jq", "-r", program], input=printed, capture_output=True, text=True
            )
            assert done.returncode == 0 and done.stdout.strip() and "null" not in done.stdout, (
                done.stderr
            )


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_is_completed(
    shell: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in (
        "replay",
        "calibrate",
        "batch",
        "completion",
        "baseline",
        "effort-unit",
        "payload",
        "so101",
        "ros2_control",
    ):
        assert re.search(rf"\b{word}\b", script), word


def test_bash_completes(capsys: pytest.CaptureFixture[str]) -> None:
    main(["completion", "bash"])
    done = subprocess.run(
        [
            "bash",
            "-c",
            capsys.readouterr().out + TRY,
        ],
        capture_output=True,
        text=True,
    )
    expected = [
        "replay",
        "--probe --profile",
        "payload container softness contents",
        "--effort-unit",
        "so101",
    ]
    assert done.stderr == "" and done.stdout.splitlines() == expected
