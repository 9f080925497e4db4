"""A running estimate of the mass in the hand, on arms in MuJoCo that pick something up and put it down again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.arm_in_motion import FOUR, Twin, write_robot

from proprio_ros.calibration_files.motions import MotionCalibration
from proprio_ros.errors import RobotError
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.identification.regression.online import (
    LATEST_STEP_S,
    OnlineEstimate,
    OnlineEstimator,
)
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot

HELD = (0.1, np.array([0.0, 0.0, 0.0]))
PAUSE_S = 1.0
"""Between two motions, where nothing is heard: they do not begin where the one before ended."""


class Case:
    """One arm, its calibration, and a working day: nothing, an object, nothing."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.robot: Robot = load_robot(write_robot(folder, build=FOUR))
        arm = Twin(seed, FOUR)
        self.calibration: MotionCalibration = fit_empty(
            self.robot, [arm.record(f"empty {n}", 20.0) for n in range(2)]
        )
        self.parts = [
            arm.record("before", 8.0),
            arm.record("held", 8.0, HELD),
            arm.record("after", 8.0),
        ]

    def day(self) -> Iterator[tuple[int, float, OnlineEstimate]]:
        """Number of the part, seconds into it, and the estimate, each tenth of a second."""
        weight = OnlineEstimator(self.robot, self.calibration)
        begun_s = 0.0
        for number, part in enumerate(self.parts):
            for time_s, position, current in rows_of(part):
                if weight.add(begun_s + time_s, position, current):
                    estimate = weight.estimate()
                    if estimate is not None:
                        yield number, time_s, estimate
            begun_s += float(part.times_s[-1]) + PAUSE_S


def rows_of(motion: Motion) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    return zip(
        motion.times_s.tolist(),
        motion.position,
        motion.current_A,
        strict=True,
    )


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return Case(tmp_path_factory.mktemp("arm"), 5)


@pytest.mark.long
def test_an_object_is_noticed_weighed_and_missed(case: Case) -> None:
    day = list(case.day())
    for number, mass_kg in enumerate((0.0, HELD[0], 0.0)):
        late = [estimate for part, time_s, estimate in day if part == number and time_s > 4.0]
        assert late and all(abs(estimate.mass_kg - mass_kg) < 0.1 * HELD[0] for estimate in late)
        holds = [estimate.ci95_kg[0] < mass_kg < estimate.ci95_kg[1] for estimate in late]
        assert np.mean(holds) > 0.8
        # a window needs half a second, and its neighbours
        changes = [time_s for part, time_s, estimate in day if part == number and estimate.changed]
        assert not changes if number == 0 else min(changes) < 1.5, (number, changes)
        assert all(time_s < 4.0 for time_s in changes), "nothing changed any more"


@pytest.mark.long
def test_an_arm_at_rest_keeps_its_answer_whatever_its_motors_do(case: Case) -> None:
    weight = OnlineEstimator(case.robot, case.calibration)
    for time_s, position, current in rows_of(case.parts[0]):
        weight.add(time_s, position, current)
    moving = weight.estimate()
    assert moving is not None and moving.resting_since_s is None
    end_s = float(case.parts[0].times_s[-1])
    rng = np.random.default_rng(1)
    for step in range(1, 300):
        # dry friction carries any of this
        weight.add(
            end_s + 0.01 * step, position, 3.0 * current + 0.05 * rng.standard_normal(len(current))
        )
    still = weight.estimate()
    assert (
        still is not None
        and still.resting_since_s is not None
        and end_s - 0.5 < still.resting_since_s < end_s + 0.7
    )
    # windows that began before the arm stood still may have been made since
    for step in range(300, 600):
        weight.add(
            end_s + 0.01 * step,
            position,
            -current,
        )
    later = weight.estimate()
    assert later is not None
    assert (
        replace(
            later,
            time_s=still.time_s,
            changed=still.changed,
        )
        == still
    )


@pytest.mark.long
def test_samples_that_say_nothing_change_nothing(case: Case) -> None:
    usual, disturbed = (OnlineEstimator(case.robot, case.calibration) for _ in range(2))
    for time_s, position, current in rows_of(case.parts[1]):
        usual.add(time_s, position, current)
        disturbed.add(time_s, position, current)
        disturbed.add(time_s, position + 1.0, current)  # the same instant again
        disturbed.add(
            time_s + 1e-4,
            np.full(4, np.nan),
            current,
        )
        disturbed.add(time_s - 0.1, position, 2.0 * current)
    assert usual.estimate() == disturbed.estimate() is not None


@pytest.mark.long
def test_a_clock_that_was_set_back_begins_anew(case: Case) -> None:
    weight = OnlineEstimator(case.robot, case.calibration)
    for time_s, position, current in rows_of(case.parts[1]):
        weight.add(100.0 + time_s, position, current)
    assert weight.estimate() is not None
    weight.add(0.0, position, current)
    assert weight.estimate() is None


@pytest.mark.long
def test_a_pause_of_a_year_takes_no_time(case: Case) -> None:
    weight = OnlineEstimator(case.robot, case.calibration)
    for pause_s in (0.0, 3e7):
        for time_s, position, current in rows_of(case.parts[1]):
            weight.add(pause_s + time_s, position, current)
    estimate = weight.estimate()
    assert estimate is not None and estimate.time_s > 3e7 and abs(estimate.mass_kg - HELD[0]) < 0.01


@pytest.mark.long
def test_samples_come_in_any_rhythm(case: Case) -> None:
    """Half as many, and unevenly spaced, say about the same."""
    masses = []
    for keep in (1, 2):
        weight = OnlineEstimator(case.robot, case.calibration)
        rng = np.random.default_rng(2)
        for row, (time_s, position, current) in enumerate(rows_of(case.parts[1])):
            if row % keep == 0 and rng.uniform() > 0.05:
                weight.add(time_s, position, current)
        estimate = weight.estimate()
        assert estimate is not None
        masses.append(estimate.mass_kg)
    assert abs(masses[0] - masses[1]) < 0.005


@pytest.mark.long
def test_torque_constants_apart_and_friction_by_the_angle_are_known_from_the_calibration(
    tmp_path: Path,
) -> None:
    """Of two joints that carry the same, one motor gives 4 % more than its file says and the other 4 % less."""
    robot = load_robot(write_robot(tmp_path, build=FOUR))
    arm = Twin(5, FOUR)
    arm.torque = arm.torque * np.array([1.0, 1.04, 0.96, 1.0])
    arm.place[:] = 0.3
    known = fit_empty(
        robot,
        [arm.record(f"empty {n}", 20.0) for n in range(2)],
    )
    held = arm.record("held", 10.0, HELD)
    late: dict[str, np.ndarray] = {}
    for name, calibration in (("known", known), ("unknown", without_shares_and_waves(known))):
        weight = OnlineEstimator(robot, calibration)
        rows = []
        for time_s, position, current in rows_of(held):
            if weight.add(time_s, position, current) and time_s > 4.0:
                estimate = weight.estimate()
                assert estimate is not None
                half_kg = estimate.ci95_kg[1] - estimate.mass_kg
        rows.append((estimate.mass_kg - HELD[0], half_kg))
        late[name] = np.array(rows)
    rms_kg = {name: np.sqrt(np.mean(rows[:, 0] ** 2)) for name, rows in late.items()}
    assert rms_kg["known"] < 0.002 and rms_kg["unknown"] > 0.005, rms_kg
    errors, halves = late["known"].T
    assert np.mean(np.abs(errors) < halves) > 0.9


def without_shares_and_waves(known: MotionCalibration) -> MotionCalibration:
    """As if nothing were known of them, and they were nothing."""
    rows = [
        n
        for n, (kind, _) in enumerate(known.keys)
        if kind == "torque_share" or kind.startswith("coulomb_")
    ]
    values = known.values.copy()
    covariance = known.covariance.copy()
    values[rows] = 0.0
    covariance[rows], covariance[:, rows] = 0.0, 0.0
    covariance[rows, rows] = 1e-12
    return replace(known, values=values, covariance=covariance)


@pytest.mark.long
def test_a_calibration_of_another_arm_is_refused(case: Case) -> None:
    other = replace(
        case.calibration,
        joints=("j2", "j1", "j3", "j4"),
    )
    with pytest.raises(RobotError, match="the motion calibration is of j2"):
        OnlineEstimator(case.robot, other)
    assert LATEST_STEP_S > 0.0
