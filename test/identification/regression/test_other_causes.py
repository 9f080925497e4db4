"""A base that is tilted, a zero that moved, and torque that fades are named, each by the torques of an arm in MuJoCo."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.arm_in_motion import SIX, write_robot
from support.differing import DifferingArm

from proprio_ros.identification.regression.causes import one_mistake
from proprio_ros.identification.regression.likelihood import Recorded
from proprio_ros.identification.regression.other_causes import other_causes
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot

pytest.importorskip("mujoco")
GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(write_robot(tmp_path_factory.mktemp("arm"), build=SIX))


@pytest.fixture(scope="module")
def motions() -> tuple[Motion, Motion]:
    arm = DifferingArm(7, SIX, 40.0)
    held = arm.held()
    empty = arm.recorded("empty", alike=True)
    return arm.recorded("loaded", held, alike=True), empty


@pytest.mark.parametrize("axis", [0, 1])
def test_a_base_that_is_tilted(robot: Robot, motions: tuple[Motion, Motion], axis: int) -> None:
    loaded, empty = motions
    tilt = Rotation.from_rotvec(np.radians(10.0) * np.eye(3)[axis])
    found = one_mistake(replace(robot, gravity=tilt.apply(GRAVITY)), [loaded], [empty])
    assert found is not None
    shown = re.search(r"--set robot\.gravity=\[([^]]*)\] states it", found.words)
    assert shown is not None, found.words
    pulled = np.array([float(value) for value in shown[1].split(",")])
    assert np.degrees(np.arccos(pulled @ GRAVITY / 9.81**2)) < 2.0


def test_a_zero_that_moved_is_no_tilt(robot: Robot, motions: tuple[Motion, Motion]) -> None:
    loaded, empty = motions
    turned = np.eye(6)[1]
    bent = [replace(each, position=each.position + 0.3 * turned) for each in (loaded, empty)]
    found = one_mistake(robot, bent[:1], bent[1:])
    assert found is None or found.code == "other_zero", found


@pytest.mark.parametrize("share", [-0.08, 0.08])
def test_torque_that_fades(robot: Robot, motions: tuple[Motion, Motion], share: float) -> None:
    loaded, empty = motions
    along = loaded.times_s[:, None] / loaded.times_s[-1]
    faded = replace(loaded, current_A=loaded.current_A * (1.0 + share * along))
    recorded = Recorded.of(robot, [faded], [empty])
    assert recorded is not None
    best, *_ = other_causes(recorded)
    assert best.kind == "fades" and best.scope == "loaded"
    assert abs(best.size - share) < 0.02
    assert ("rose" if share > 0.0 else "fell") in best.words


def test_nothing_is_found_where_nothing_is_wrong(
    robot: Robot, motions: tuple[Motion, Motion]
) -> None:
    loaded, empty = motions
    recorded = Recorded.of(robot, [loaded], [empty])
    assert recorded is not None and other_causes(recorded) == ()
