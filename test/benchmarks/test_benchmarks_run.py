"""The comparisons compare the same thing. Times are never tested: run ``python test/benchmarks/run.py`` for them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest


@pytest.fixture(scope="module")
def case() -> Any:
    """The recording, solved by ourselves."""
    from case import load

    return load()


@pytest.mark.long
def test_our_answer_is_the_recording_s_mass(case: Any) -> None:
    assert case.mass == pytest.approx(0.05, abs=5e-4)


@pytest.mark.long
def test_scipy_finds_our_mass(case: Any) -> None:
    from against_scipy import identify
    from case import AGREEMENT_KG

    masses, _ = identify(case)()
    assert np.abs(masses - case.mass).max() < AGREEMENT_KG


@pytest.mark.long
def test_plain_c_computes_our_numbers(case: Any, tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    from against_c import EQUAL, CPass, difference, hard_parameters, hard_run
    from case import STARTS_KG

    from proprio_ros.sim.joint import JointSimulator

    run = hard_run(case.problem.simulator.runs[0])
    p, dp = hard_parameters(*case.parameters(np.array(STARTS_KG)))
    ours = JointSimulator([run]).jacobian(
        np.zeros(len(p), dtype=np.int32),
        p,
        dp,
    )
    assert difference(ours, CPass(run, p, dp, str(tmp_path))()) < EQUAL


@pytest.mark.long
def test_plain_c_computes_our_numbers_with_a_sphere(tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    from container import EQUAL, SpherePass, apart, easy_and_hard, pose, share_in_contact
    from support.plain_laws import states_of

    from proprio_ros.sim.sphere import SphereSimulator

    box = pose()
    for _, run, p in easy_and_hard(box):
        simulator = SphereSimulator([run], box.facts.enclosure)
        ours = states_of(
            simulator,
            np.zeros(len(p), dtype=np.int32),
            p,
        )
        assert apart(ours, SpherePass(simulator, p, str(tmp_path))()) < EQUAL
        assert share_in_contact(simulator, p) > 0.9


@pytest.mark.long
def test_a_sphere_in_mujoco_is_ours() -> None:
    """The same joint and box, another law of contact: positions agree, and so do the masses that both find."""
    pytest.importorskip("mujoco")
    from container import AGREEMENT, SPHERE_KG, MujocoFit, by_mujoco, pose

    box = pose(by_mujoco, mass_alone=True)
    p, _ = box.parameters([SPHERE_KG])
    times_s = box.run.joint.sample_times_s
    ours, _ = box.problem.simulator.special.rollout(
        np.zeros(1, dtype=np.int32),
        p,
    )
    assert np.abs(ours[0] - by_mujoco(box, times_s)).max() < 2e-3 < 0.01 * np.ptp(ours)
    answer = box.solve()
    masses, costs, _ = MujocoFit(box, 2.5e-3, "RK4")()
    for mass in (box.masses(answer.internal)[answer.best], masses[int(np.argmin(costs))]):
        assert mass == pytest.approx(SPHERE_KG, rel=AGREEMENT)


def test_void_without_agreement(case: Any) -> None:
    from case import compare
    from run import figures

    good = compare(
        "x",
        lambda: (np.array([case.mass]), case.mass),
        0.0,
        case,
        repeats=1,
    )
    assert good.passed and figures(good)["goal"] == "met"
    wrong = compare(
        "x",
        lambda: (np.array([0.07]), 0.07),
        0.0,
        case,
        repeats=1,
    )
    assert wrong.passed is False and wrong.ratio == "void" and figures(wrong)["goal"] == "missed"


@pytest.mark.long
def test_a_soft_block_launched_per_substep_moves_as_ours() -> None:
    from softness import EQUAL, OnePerSubstep, PerSubstep, difference, explicit_case, fused

    body, run, p = explicit_case(2, frames=3)
    ours = fused(body, run, p)
    for way in (PerSubstep, OnePerSubstep):
        theirs = way(body, run, p)
        assert difference(ours, theirs()) < EQUAL
        assert difference(ours, theirs()) < EQUAL  # and again


@pytest.mark.long
def test_both_fits_of_a_soft_block_find_the_truth() -> None:
    from softness import Fit

    fit = Fit()
    np.testing.assert_allclose(
        fit.ours(),
        fit.truth,
        rtol=1e-5,
    )
    np.testing.assert_allclose(
        fit.scipy(),
        fit.truth,
        rtol=5e-3,
    )


@pytest.mark.long
def test_the_coverage_of_two_robots() -> None:
    """The bound of Cramer and Rao is what an interval can be at best: ours is near it, and errors are of its size."""
    from coverage import EFFECTS, MATCHED, one_robot

    answers = []
    for seed in (2, 3):
        found, refused, asked = one_robot((seed, EFFECTS, MATCHED))
        assert len(found) + refused == asked
        answers += found
    assert {answer.reference for answer in answers} == {False, True} and len(answers) >= 4
    ratio = np.array([answer.std / answer.bound for answer in answers])
    assert np.all((ratio > 0.7) & (ratio < 1.5))
    assert np.all([abs(answer.error) < 4.5 * answer.std for answer in answers])


@pytest.mark.long
def test_an_arm_that_records_goals_and_positions_alone() -> None:
    """An SO-101 in MuJoCo under its own position law, 30 Hz: a fixed draw, answered near the truth."""
    pytest.importorskip("mujoco")
    from so101 import weighed

    from proprio_ros.identification.estimate import Verdict

    for kg, estimate in weighed(1, 30.0, 25.0, (0.0, 0.1)):
        assert estimate.verdict is Verdict.ACCEPTED, estimate.reasons
        mass = estimate.values[0]
        assert abs(mass.value - kg) < max(4.0 * mass.std, 0.002) and mass.std < 0.006


@pytest.mark.long
def test_a_servo_drawn_at_random() -> None:
    pytest.importorskip("mujoco")
    from servos import asked

    ((truth, value, std, _),) = asked(0, 100.0, questions=1)
    assert value is not None and abs(value - truth) < 4.0 * std and std < 0.1 * truth


@pytest.mark.long
def test_mutated_pushes_of_one_arm(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    from mutated_pushes import main

    main(["--count", "4", "--first", "11", "--only", "step of a held joint", "command scaled"])
    rows = [line.split("|") for line in capsys.readouterr().out.splitlines() if "|" in line]
    beyond = {row[1].strip(): row[4].strip() for row in rows}
    for kind in ("step of a held joint", "command scaled", "nothing"):
        assert beyond[kind] == "0"
