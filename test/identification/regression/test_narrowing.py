"""What is said to narrow an interval narrows it, to about what is said."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.drawn_arm import joints_of, write_urdf
from support.moved_arm import record_arm

from proprio_ros import calibrate, weigh
from proprio_ros.cli import main
from proprio_ros.identification.regression.narrowing import _handy
from proprio_ros.identification.regression.refusals import unlike_urdf
from proprio_ros.pipeline.api import Weighing

COUNT = 6
SEED = 23
LOAD_KG = 1.3
MASSES = {"empty": 0.0, "loaded": LOAD_KG, "known": 2.0, "light": 0.3}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Recordings of an arm by MuJoCo whose torque constants are 4 % above those that a file would state, known to 15 %."""
    folder = tmp_path_factory.mktemp("arm")
    urdf = write_urdf(folder / "arm.urdf", COUNT, SEED)
    torque = ["--effort-unit", "N.m"]
    assert main(["robot", "new", str(urdf), "--output", str(folder / "arm.yaml"), *torque]) == 0
    constants = dict.fromkeys(joints_of(COUNT), 1.04)
    for number, (name, kg) in enumerate(MASSES.items()):
        record_arm(
            folder / name, urdf, constants, "tool0", kg, number, robot_seed=SEED, seconds=20.0
        )
    yield folder


def weighed(folder: Path, **by: object) -> Weighing:
    return weigh(folder / "loaded", robot=folder / "arm.yaml", effort_unit="Nm", **by)  # type: ignore[arg-type]


def said(answer: Weighing) -> list[str]:
    return [note for note in answer.estimate.notes if "what would narrow it" in note]


def half_width_g(answer: Weighing) -> float:
    assert answer.ci95 is not None
    return 500.0 * (answer.ci95[1] - answer.ci95[0])


def with_reference(folder: Path, name: str) -> Weighing:
    learnt = calibrate(
        folder / "empty",
        references={folder / name: MASSES[name]},
        robot=folder / "arm.yaml",
        effort_unit="N.m",
    )
    return weigh(folder / "loaded", calibration=learnt, effort_unit="N.m")


def test_a_known_load_narrows_an_answer_to_what_was_said(arm: Path) -> None:
    wide = weighed(arm, baseline=arm / "empty")
    (words,) = said(wide)
    assert "a known load of about 2000 g, moved alike" in words
    (promised, before) = map(float, re.findall(r"\+-(\d+) g", words))
    assert before == pytest.approx(half_width_g(wide), abs=1.0)
    narrow = with_reference(arm, "known")
    assert narrow.ci95 is not None
    assert narrow.ci95[0] < LOAD_KG < narrow.ci95[1]
    assert 0.5 * promised < half_width_g(narrow) < 1.3 * promised < 0.8 * half_width_g(wide)
    assert said(narrow) == [], "nothing that is worth another recording"


def test_a_heavier_load_instead_of_a_light_one(arm: Path) -> None:
    answer = with_reference(arm, "light")
    assert all("a known load of about 2000 g instead of 300 g" in words for words in said(answer))
    assert len(said(answer)) == 1


def test_loads_are_round_and_no_lighter() -> None:
    found = {mass: _handy(mass) for mass in (0.043, 0.5, 1.0, 1.01, 2.805, 9.3)}
    assert found == pytest.approx(
        {0.043: 0.05, 0.5: 0.5, 1.0: 1.0, 1.01: 2.0, 2.805: 3.0, 9.3: 10.0}
    )


@pytest.mark.parametrize(
    ("factor", "first"),
    [(1.6, "is a tool or hand mounted in both"), (0.6, "has the URDF a hand"), (9.0, "check the")],
)
def test_a_tool_is_asked_for_before_unit_and_urdf(factor: float, first: str) -> None:
    (refusal,) = unlike_urdf(factor, None)  # type: ignore[arg-type]
    (sentence,) = refusal.reasons
    _, _, rest = sentence.partition("off by as much: ")
    assert rest.startswith(first)
    assert "check the effort's unit" in rest
