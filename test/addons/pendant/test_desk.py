"""What the desk of recordings computes is what the commands answer: the same numbers and reasons, kept where history looks."""

from __future__ import annotations

import asyncio
import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from proprio_ros.addons.pendant.calls import Job
from proprio_ros.addons.pendant.desk import ASKED, BESIDE, EMPTY, KNOWN, Desk
from proprio_ros.addons.pendant.kept import calibrations, kept, terms
from proprio_ros.addons.pendant.places import Places
from proprio_ros.addons.pendant.results import answered, number_of
from proprio_ros.errors import ConfigurationError

BAGS = Path(__file__).resolve().parents[3] / "bags"
CUBE = "realistic_s00_fixed_heavy_cube_23g_joint3"
EMPTIES = [f"realistic_s00_empty_0{number}_joint3" for number in range(6)]
REFERENCE = "realistic_s00_fixed_reference_100g_joint3_x1"


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Desk:
    begun = tmp_path / "begun"
    for name in (CUBE, REFERENCE, *EMPTIES):
        shutil.copytree(BAGS / name / "bag_mcap", begun / name)
    monkeypatch.chdir(begun)
    return Desk(Places(begun, tmp_path / "data"), lambda _: None)


def choose(desk: Desk, name: str, role: str) -> None:
    desk.choose(desk.places.begun / name)
    desk.chosen[name].role = role


def ended(desk: Desk, begin: str) -> Job:
    """A job from its begin to its end."""

    async def whole() -> Job:
        getattr(desk, begin)()
        job = desk.jobs.under_way
        assert job is not None
        with pytest.raises(ConfigurationError, match="wait for it"):
            desk.begin_answer()
        while desk.jobs.under_way is not None:
            await asyncio.sleep(0.05)
        return job

    choose(desk, CUBE, ASKED) if not desk.chosen else None
    return asyncio.run(whole())


def typed(command: str) -> dict[str, object]:
    """What the last of the commands prints, typed by hand."""
    words = shlex.split(command.rpartition(" && ")[2])
    at = words.index("--report")
    done = subprocess.run(
        [sys.executable, "-m", "proprio_ros.cli", *words[1:at], *words[at + 2 :], "--json"],
        capture_output=True,
        text=True,
    )
    return dict(json.loads(done.stdout))


def test_a_look_is_what_check_says(desk: Desk) -> None:
    choose(desk, CUBE, ASKED)
    job = ended(desk, "begin_look")
    done = subprocess.run(
        [sys.executable, "-m", "proprio_ros.cli", *shlex.split(job.command)[1:], "--json"],
        capture_output=True,
        text=True,
    )
    found = desk.chosen[CUBE]
    assert json.loads(done.stdout)["bags"] == [found.found]
    position, *_, current = found.signals
    assert position["title"] == "position [rad or m]" and "input current" in current["title"]
    values = [value for _, value in current["curves"]["joint3"]]
    assert min(values) == pytest.approx(-0.301, abs=0.003)  # as the bag's README states


def test_an_answer_is_what_replay_says_and_is_kept(desk: Desk) -> None:
    job = ended(desk, "begin_answer")
    (step,) = job.steps
    (found,) = kept(desk.places)
    again = typed(job.command)
    for key in ("verdict", "estimates", "reasons", "reason_codes"):
        assert step.answer[key] == again[key] == found.estimate[key]
    assert found.report is not None and "<svg" in found.report.read_text()
    number, interval = number_of(step.answer)
    shown = answered(step)
    assert number in shown and interval in shown and "What to do: " in shown


@pytest.mark.long
def test_empty_hands_calibrate_first(desk: Desk) -> None:
    for name in EMPTIES:
        choose(desk, name, EMPTY)
    choose(desk, REFERENCE, KNOWN)
    desk.chosen[REFERENCE].known_g = 100.0
    choose(desk, CUBE, ASKED)
    job = ended(desk, "begin_answer")
    learnt, asked = job.steps
    assert learnt.kind == "calibrate" and learnt.answer["verdict"] == "accepted"
    assert f"--reference {REFERENCE}=0.1" in job.command
    again = typed(job.command)
    assert asked.answer["estimates"] == again["estimates"]
    low, high = again["estimates"][0]["ci95"]  # type: ignore[index]
    assert low < 0.023 < high
    (found,) = kept(desk.places)
    assert found.calibration is not None
    assert calibrations(desk.places) == [found.calibration]
    assert set(terms(found.calibration)) > {"joint2", "joint3"}


def test_what_cannot_be_asked_is_said(desk: Desk) -> None:
    with pytest.raises(ConfigurationError, match="choose a recording"):
        desk.begin_answer()
    choose(desk, REFERENCE, KNOWN)
    with pytest.raises(ConfigurationError, match="choose a recording"):
        desk.begin_answer()
    choose(desk, CUBE, ASKED)
    with pytest.raises(ConfigurationError, match="beside recordings of the empty hand"):
        desk.begin_answer()
    choose(desk, EMPTIES[0], EMPTY)
    with pytest.raises(ConfigurationError, match="how heavy"):
        desk.begin_answer()
    desk.chosen[REFERENCE].role = BESIDE
    for facts, says in (("payload.shape", "KEY=VALUE"), ("a='b", "facts: ")):
        desk.asked.facts = facts
        with pytest.raises(ConfigurationError, match=says):
            desk.begin_answer()
    desk.asked.facts = ""
    desk.asked.calibration = "c.yaml"
    with pytest.raises(ConfigurationError, match="call them baseline"):
        desk.begin_answer()
    assert not desk.places.data.exists()


def test_nothing_that_is_typed_or_named_becomes_an_option(desk: Desk) -> None:
    odd = desk.places.begun / "--force"
    shutil.copytree(desk.places.begun / CUBE, odd)
    desk.choose(odd)
    assert list(desk.chosen) == ["./--force"]
    desk.asked.facts = "--robot=panda"
    assert desk.asked.words() == ["--set=--robot=panda"]
    job = ended(desk, "begin_answer")
    assert "robot" in job.steps[0].answer["error"]


def test_what_a_command_refuses_is_shown(desk: Desk) -> None:
    desk.asked.facts = "payload.shape=pancake"
    job = ended(desk, "begin_answer")
    assert "pancake" in answered(job.steps[0])
    assert not list(desk.places.data.iterdir())


def test_a_cancelled_job_ends(desk: Desk) -> None:
    choose(desk, CUBE, ASKED)

    async def whole() -> Job:
        desk.begin_answer()
        job = desk.jobs.under_way
        assert job is not None
        job.cancel()
        while desk.jobs.under_way is not None:
            await asyncio.sleep(0.05)
        return job

    job = asyncio.run(whole())
    assert "verdict" not in job.steps[0].answer
    assert not list(desk.places.data.iterdir())


def test_a_batch_has_a_row_a_recording(desk: Desk) -> None:
    pytest.importorskip("pyarrow")
    pytest.importorskip("proprio_ros.addons.fleet")
    for name in EMPTIES[1:]:
        shutil.rmtree(desk.places.begun / name)

    async def whole() -> Job:
        desk.begin_batch(desk.places.begun)
        job = desk.jobs.under_way
        assert job is not None
        while desk.jobs.under_way is not None:
            await asyncio.sleep(0.05)
        return job

    (step,) = asyncio.run(whole()).steps
    shown = answered(step)
    assert shown.count("<tr>") == 1 + 3, shown
    assert CUBE in shown
    (found,) = kept(desk.places)
    assert found.report == step.report
