"""What is said to narrow a weighing by pushes narrows it, to about what is said: more pushes, or a known load."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from support.pushed_arm import Hand

from proprio_ros import calibrate, weigh
from proprio_ros.addons.paper import hand as paper_hand
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.estimate import Verdict
from proprio_ros.pipeline.api import Weighing
from proprio_ros.pipeline.replay import read_for
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.probes.payload.identify import Weighed, WeighingOptions, _leaving_runs_out
from proprio_ros.probes.payload.narrowing import (
    WORTH,
    _round,
    half_width_with_known_load,
    half_width_with_more,
    what_would_narrow,
)
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

BAGS = Path(__file__).resolve().parents[2] / "bags"
EMPTY = sorted(BAGS.glob("realistic_s00_empty_*/bag_mcap"))
CENTRED = {"payload.com": [0.0, 0.0, 0.0]}
AS_REACHED = 0.15  # what is foreseen may be off by so much of what is reached


def bag(name: str) -> Path:
    return BAGS / f"realistic_s00_fixed_{name}" / "bag_mcap"


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the arm of the recordings, by its empty hand."""
    path = tmp_path_factory.mktemp("arm") / "arm.yaml"
    calibrate(EMPTY, robot="open_manipulator_x", output=path)
    return path


def answered(robot: Robot, runs: list[Run], facts: PayloadFacts) -> Weighed:
    attempt = _leaving_runs_out(robot, runs, facts, WeighingOptions(), ())
    assert attempt.weighed is not None
    return attempt.weighed


def read(calibration: Path, *names: str) -> tuple[Robot, list[Run], PayloadFacts]:
    request = request_of(Options("payload", calibration=str(calibration), settings=dict(CENTRED)))
    robot, recorded = read_for(request, [bag(name) for name in names])
    return robot, list(recorded.runs), request.facts.payload


def half_g(answer: Weighing) -> float:
    assert answer.ci95 is not None
    return 500.0 * (answer.ci95[1] - answer.ci95[0])


def said(answer: Weighing) -> list[str]:
    return [note for note in answer.estimate.notes if "what would narrow it" in note]


def test_a_known_load_narrows_an_answer_to_what_was_said(calibration: Path) -> None:
    """The cube by the ball, which a later calibration knows: about as heavy, and pushed by the same current."""
    cube, ball = bag("heavy_cube_23g_joint3"), bag("light_ball_20g_joint3")
    wide = weigh(cube, calibration=calibration, settings=CENTRED)
    (words,) = said(wide)
    assert "a known load of about 20 g, pushed alike" in words
    promised, before, _ = map(float, re.findall(r"\+-([\d.]+) g", words))
    assert before == pytest.approx(half_g(wide), abs=0.06)
    learnt = calibrate(EMPTY, references={ball: 0.02}, robot="open_manipulator_x", settings=CENTRED)
    narrow = weigh(cube, calibration=learnt, settings=CENTRED)
    assert half_g(narrow) == pytest.approx(promised, rel=AS_REACHED)
    assert promised < WORTH * before


def test_a_heavier_load_is_foreseen_as_well(calibration: Path) -> None:
    weighed = answered(*read(calibration, "heavy_ball_50g_joint3"))
    foreseen_kg = half_width_with_known_load(weighed, 0.02)
    reference = {bag("light_ball_20g_joint3"): 0.02}
    learnt = calibrate(EMPTY, references=reference, robot="open_manipulator_x", settings=CENTRED)
    reached = weigh(bag("heavy_ball_50g_joint3"), calibration=learnt, settings=CENTRED)
    assert half_g(reached) == pytest.approx(1e3 * foreseen_kg, rel=AS_REACHED)


@pytest.mark.parametrize("times", [1, 2, 3])
def test_the_same_push_again_tells_what_is_foreseen(calibration: Path, times: int) -> None:
    """With a calibrated arm most of the interval is the calibration's, which no push of the object narrows."""
    robot, runs, facts = read(calibration, "heavy_cube_23g_joint3")
    once = answered(robot, runs, facts)
    foreseen_kg = half_width_with_more(once, times)
    again = [replace(runs[0], name=f"again{number}") for number in range(times)]
    several = answered(robot, [*runs, *again], facts)
    assert Z95 * several.assessed.std == pytest.approx(foreseen_kg, rel=0.03)
    assert 0.8 * Z95 * once.assessed.std < foreseen_kg < Z95 * once.assessed.std


def test_pushes_of_an_arm_that_is_known_narrow_as_foreseen() -> None:
    """Four pushes of MuJoCo's arm, one after the other: each errs by itself."""
    pytest.importorskip("mujoco")
    from proprio_ros.virtual.arm import VirtualArm
    from proprio_ros.virtual.objects import Payload
    from proprio_ros.virtual.robot import PARKED
    from proprio_ros.virtual.truth import Truth

    robot = paper_hand.known_robot()
    arm = VirtualArm(
        robot, Truth.nominal(robot), position=PARKED, seed=1, control_period_s=paper_hand.PERIOD_S
    )
    arm.hold(Payload(0.05))
    hand = Hand(robot, arm)
    sequence = load_sequence("payload_elbow", robot)
    for _ in range(4):
        hand.make(replace(sequence, runs=sequence.runs[:1]))
    facts = PayloadFacts()
    once = answered(robot, hand.runs[:1], facts)
    for count in (2, 3, 4):
        foreseen_kg = half_width_with_more(once, count - 1)
        reached = answered(robot, hand.runs[:count], facts)
        assert Z95 * reached.assessed.std == pytest.approx(foreseen_kg, rel=AS_REACHED)


def test_nothing_is_said_of_an_arm_that_was_not_calibrated() -> None:
    """What to do first is said there: calibrate."""
    answer = weigh(bag("heavy_cube_23g_joint3"), robot="open_manipulator_x", settings=CENTRED)
    assert said(answer) == []


def test_what_is_refused_has_no_width_to_narrow(calibration: Path) -> None:
    weighed = answered(*read(calibration, "heavy_cube_23g_joint3"))
    assert what_would_narrow(weighed, Verdict.ACCEPTED) != ()
    assert what_would_narrow(weighed, Verdict.REJECTED) == ()


def test_loads_are_round() -> None:
    found = {mass: _round(mass) for mass in (-0.1, 0.0207, 0.0262, 0.5, 0.096, 1.4)}
    assert found == pytest.approx(
        {-0.1: 0.0, 0.0207: 0.02, 0.0262: 0.03, 0.5: 0.5, 0.096: 0.1, 1.4: 1.0}
    )
