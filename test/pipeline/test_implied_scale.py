"""What a reference implies of motors, rotors and the arm is a note, from two standard deviations on a reason, from five a no."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.arm_in_motion import SIX, Twin, write_robot

from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.identification.estimate import UnknownRow, Verdict
from proprio_ros.identification.regression.motion_estimate import calibrate_motions
from proprio_ros.pipeline.calibrate import _with_implied_scale
from proprio_ros.robot import Robot, load_robot

KNOWN = {"torque_constant": (1.8, 0.05), "armature": (0.02, 0.05), "nothing": (0.0, 0.0)}
"""Value in its file, and how well that is known, relative."""


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")  # knows its weight to 2 %


def implied(robot: Robot, kind: str, factor: float) -> CalibrationEstimate:
    """By a reference that is stated too heavy by a factor."""
    stated, relative = KNOWN[kind]
    rows = (
        UnknownRow("arm_scale", "free", 1.0, 0.02, factor, 0.005),
        UnknownRow(
            kind, "free", stated, relative * stated, factor * stated, 0.01 * stated, scope="joint3"
        ),
    )
    answer = CalibrationEstimate(
        robot.name,
        Verdict.ACCEPTED,
        (),
        3,
        None,
        unknowns=rows,
    )
    return _with_implied_scale(answer, robot, swings=kind == "armature")


@pytest.mark.parametrize("kind", ["torque_constant", "armature"])
@pytest.mark.parametrize(
    ("factor", "verdict", "reasons"),
    [
        (0.9, Verdict.REJECTED, 1),
        (0.92, Verdict.ACCEPTED, 1),
        (0.98, Verdict.ACCEPTED, 0),
        (1.02, Verdict.ACCEPTED, 0),
        (1.08, Verdict.ACCEPTED, 1),
        (1.1, Verdict.REJECTED, 1),
    ],
)
def test_a_reference_is_put_against_what_is_known(
    robot: Robot,
    kind: str,
    factor: float,
    verdict: Verdict,
    reasons: int,
) -> None:
    """Of pushes, and of free responses. Torque to 5 % and weight to 2 % together are known to 1.86 %: five times that is 9.3 %."""
    answer = implied(robot, kind, factor)
    assert answer.verdict is verdict and len(answer.reasons) == reasons
    (said,) = answer.reasons or answer.notes
    words = (
        "all motors are"
        if kind == "torque_constant"
        else f"the rotor of joint3 has {0.02 * factor:.3g} kg m^2"
    )
    assert (
        said.startswith(f"your reference says that {words}")
        and f"weighs {factor:.2f} times" in said
    )


def test_nothing_is_implied_where_nothing_was_learnt(robot: Robot) -> None:
    answer = implied(robot, "nothing", 3.0)
    assert answer.verdict is Verdict.ACCEPTED and not answer.reasons and not answer.notes


def test_a_motion_s_reference_is_put_against_what_is_known(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Where it is doubted, masses are as uncertain as it is off, until it has been weighed again."""
    arm = Twin(5, SIX)
    robot = load_robot(write_robot(tmp_path_factory.mktemp("arm"), torque_std=0.1))
    held = (1.5, np.array([0.03, 0.0, 0.05]))
    made = calibrate_motions(
        robot,
        [arm.record("empty", 15.0)],
        [
            (
                arm.record("reference", 15.0, held),
                held[0],
            )
        ],
    )
    assert (
        made.verdict is Verdict.ACCEPTED and made.motion is not None and made.weighable is not None
    )
    std = np.sum(1.0 / np.square([0.1, max(robot.arm_scale.std, 0.02)])) ** -0.5
    found = {}
    for sigmas in (-5.2, -4.8, 0.0, 1.8, 2.2, 4.8, 5.2):
        scale = 1.0 + sigmas * std
        off = replace(
            made,
            motion=replace(made.motion, torque_scale=scale, arm_over_urdf=1.0),
        )
        found[sigmas] = answer = _with_implied_scale(off, robot)
        assert answer.verdict is (Verdict.REJECTED if abs(sigmas) > 5.0 else Verdict.ACCEPTED), (
            sigmas
        )
        assert len(answer.reasons) - len(made.reasons) == (abs(sigmas) > 2.0), sigmas
        if 2.0 < abs(sigmas) < 5.0:
            assert answer.motion is not None and answer.weighable is not None
            reach = scale * (1.0 - np.sign(sigmas) * 1.96 * answer.motion.torque_scale_std)
            assert (
                reach == pytest.approx(1.0, abs=1e-3)
                and "weighed again" in answer.weighable.in_motion
            )
    assert (
        found[0.0].motion is not None
        and found[0.0].motion.torque_scale_std == made.motion.torque_scale_std
    )
