"""The URDF with what a calibration learnt: MuJoCo, which reads it, finds the torques that the calibration has."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.sensing_arm import SensingArm, write_sensing_arm

from proprio_ros.calibration_files.motions import ARM_TERMS
from proprio_ros.errors import RobotError
from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.pipeline.export import learnt_urdf
from proprio_ros.quantity import Quantity
from proprio_ros.robot import Robot, load_robot
from proprio_ros.robot.regressor import carriers, gravity_along, kinematics


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder = tmp_path_factory.mktemp("sensing")
    bare = load_robot(write_sensing_arm(folder, 6, 77))
    arm = SensingArm(folder, 6, 77, 100.0)
    return replace(
        bare,
        motion_calibration=fit_empty(
            bare,
            [arm.work(15.0, name=f"empty {n}") for n in range(2)],
        ),
    )


def test_mujoco_has_the_torques_that_were_learnt(robot: Robot) -> None:
    import mujoco

    known = robot.motion_calibration
    assert known is not None
    learnt = learnt_urdf(robot)
    model = mujoco.MjModel.from_xml_string(learnt.text)
    data = mujoco.MjData(model)
    count = len(known.joints)
    rng = np.random.default_rng(4)
    assert set(learnt.joints) == set(known.joints)
    reduced = robot.model.lock(
        list(known.joints),
        {},
        robot.gravity,
    )
    for pose in rng.uniform(-1.5, 1.5, (3, count)):
        data.qpos[:], data.qvel[:] = pose, 0.0
        mujoco.mj_forward(model, data)
        motion = kinematics(
            reduced,
            pose[None],
            np.zeros((1, count)),
        )
        expected = np.zeros(count)
        for body in range(count):
            own = (
                known.values[10 * body : 10 * body + 10]
                @ gravity_along(reduced, motion, body)[..., 0]
            )
            expected[carriers(reduced, body)] -= own
        assert np.allclose(data.qfrc_bias, expected, atol=1e-4)
    viscous, coulomb = known.values[ARM_TERMS * count :].reshape(3, count)[:2]
    assert np.allclose(model.dof_damping, np.maximum(viscous, 0.0), rtol=1e-4)
    assert np.allclose(model.dof_frictionloss, np.maximum(coulomb, 0.0), rtol=1e-4)


def test_a_body_that_cannot_be_is_refused(robot: Robot) -> None:
    known = robot.motion_calibration
    assert known is not None
    values = known.values.copy()
    values[10] = -1.0
    with pytest.raises(RobotError, match="axis_2 weighs -1 kg by this calibration"):
        learnt_urdf(replace(robot, motion_calibration=replace(known, values=values)))


def test_without_motions_friction_is_that_of_the_drive_trains() -> None:
    import mujoco

    robot = load_robot("open_manipulator_x")
    force = {}
    for name, drive in robot.drive_trains.items():
        force[name] = replace(
            drive,
            coulomb=Quantity(0.06),
            viscous=Quantity(0.02),
        )
    learnt = learnt_urdf(replace(robot, drive_trains=force, arm_scale=Quantity(1.1)))
    model = mujoco.MjModel.from_xml_string(learnt.text)
    bare = mujoco.MjModel.from_xml_string(learnt_urdf(robot).text)
    for name, drive in force.items():
        at = model.jnt_dofadr[model.joint(name).id]
        assert np.isclose(model.dof_frictionloss[at], 0.06 / abs(drive.transmission), rtol=1e-4)
        assert np.isclose(model.dof_damping[at], 0.02 / drive.transmission**2, rtol=1e-4)
    assert np.allclose(
        model.body_mass[1:],
        1.1 * bare.body_mass[1:],
        rtol=1e-6,
    )


def test_the_command_writes_it(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from proprio_ros.cli import main

    output = tmp_path / "learnt.urdf"
    coulomb = "robot.joints.joint1.drive_train.coulomb_N_m=0.05"
    assert main(["robot", "export", "--output", str(output), "--set", coulomb]) == 0
    assert 'friction="0.05"' in output.read_text()
    assert main(["robot", "export", "--output", str(output)]) == 2  # it is there
    assert main(["robot", "export", "--output", str(tmp_path / "learnt.txt")]) == 2
    capsys.readouterr()
