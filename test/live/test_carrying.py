"""What an arm carries in a pose, against MuJoCo, and whether it can carry a load there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.sensing_arm import SensingArm, write_sensing_arm

from proprio_ros.errors import RobotError
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.live.carrying import Capability, Carrier, Load, way
from proprio_ros.robot import Robot, load_robot

SEED = 91
LOAD = Load(
    1.5,
    0.02,
    (0.03, -0.01, 0.05),
)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, SensingArm]:
    folder = tmp_path_factory.mktemp("sensing")
    return load_robot(write_sensing_arm(folder, 7, SEED)), SensingArm(folder, 7, SEED, 100.0)


def mujoco_bias(
    arm: SensingArm,
    pose: np.ndarray,
    load: Load,
) -> np.ndarray:
    import mujoco

    arm._hold((load.mass_kg, np.array(load.centre_m)) if load.mass_kg else None)
    arm.data.qpos[:] = pose
    arm.data.qvel[:] = 0.0
    mujoco.mj_forward(arm.model, arm.data)
    return arm.data.qfrc_bias.copy()


def named(
    carrier: Carrier,
    pose: np.ndarray,
) -> dict[str, float]:
    return dict(zip(carrier.joints, pose.tolist(), strict=True))


def test_efforts_are_what_mujoco_needs_to_hold_arm_and_load(arm: tuple[Robot, SensingArm]) -> None:
    """With a calibration within its standard deviations, which are less than those of the URDF."""
    robot, real = arm
    known = replace(
        robot,
        motion_calibration=fit_empty(
            robot,
            [real.work(20.0, name=f"empty {n}") for n in range(2)],
        ),
    )
    bare = Carrier(robot)
    calibrated = Carrier(known)
    pulls = []
    stds = []
    for pose in real.middle + np.random.default_rng(5).uniform(-1.0, 1.0, (12, 7)):
        truth = mujoco_bias(real, pose, LOAD) * real.scale  # as its sensors say it
        wide = bare.efforts(named(bare, pose), LOAD)
        found = calibrated.efforts(named(calibrated, pose), LOAD)
        assert np.abs(wide[0] - truth).max() < 6.0
        assert (np.abs(wide[0] - truth) < 4.0 * wide[1] + 0.05).all()
        pulls.append((found[0] - truth) / found[1])
        stds.append(np.stack([found[1], wide[1]]))
    # a weight that no calibration without an object knows: the sensors' scales, of 1 %, act on the load
    assert np.mean(np.abs(pulls) < 2.0) > 0.85, np.round(pulls, 1)
    assert np.mean(stds, axis=0)[0].sum() < 0.5 * np.mean(stds, axis=0)[1].sum()


def test_the_urdf_alone_is_exactly_mujocos(tmp_path: Path) -> None:
    import mujoco

    robot = load_robot(write_sensing_arm(tmp_path, 6, SEED))
    real = SensingArm(tmp_path, 6, SEED)
    nominal = mujoco.MjModel.from_xml_path(str(tmp_path / "sensing.urdf"))
    data = mujoco.MjData(nominal)
    carrier = Carrier(robot)
    for pose in real.rng.uniform(-2.0, 2.0, (3, 6)):
        data.qpos[:] = pose
        mujoco.mj_forward(nominal, data)
        assert np.allclose(
            carrier.efforts(named(carrier, pose), Load(0.0))[0], data.qfrc_bias, atol=1e-5
        )
    with pytest.raises(RobotError, match="the pose lacks axis_2, axis_3"):
        carrier.efforts(
            {"axis_1": 0.0, "axis_4": 0.0, "axis_5": 0.0, "axis_6": 0.0},
            LOAD,
        )


def test_the_heaviest_load_is_where_a_joint_reaches_its_limit(
    arm: tuple[Robot, SensingArm],
) -> None:
    carrier = Carrier(arm[0])
    carrier.limits = np.full(7, 150.0)
    pose = named(carrier, np.zeros(7))  # stretched out
    found = carrier.capability([pose], LOAD)
    assert isinstance(found, Capability)
    assert found.joint == "axis_2"
    assert found.most_kg > 0.0
    for mass_kg, can in ((0.99 * found.most_kg, True), (1.01 * found.most_kg, False)):
        assert carrier.capability([pose], Load(mass_kg, 0.0, LOAD.centre_m)).can is can
    efforts, stds = carrier.efforts(
        pose,
        Load(found.most_kg, 0.0, LOAD.centre_m),
    )
    assert np.isclose(
        np.max(np.abs(efforts) + 1.96 * stds),
        150.0,
        rtol=1e-3,
    )
    # upright it carries more, and on the way there it does not
    upright = pose | {"axis_2": -np.pi / 2}
    assert carrier.capability([upright], LOAD).most_kg > found.most_kg
    assert np.isclose(carrier.capability(way(pose, upright), LOAD).most_kg, found.most_kg)
    assert way(pose, {"axis_2": 1.0})[-1] == pose | {"axis_2": 1.0}
