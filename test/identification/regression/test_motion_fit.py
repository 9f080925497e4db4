"""Equations and fits of motions against MuJoCo's inverse dynamics: recordings without noise, of arms whose every term is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.arm_in_motion import SIX, nominal, sines, urdf, write_robot

from proprio_ros.calibration_files.motions import term_keys
from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.identification.regression.motion_equations import SLOW_RAD_S, Problem, equations
from proprio_ros.identification.regression.motion_fit import (
    check_torque_constant,
    fit_empty,
    fit_payload,
)
from proprio_ros.identification.regression.one_joint_fit import rms
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, RobotModel, load_robot
from proprio_ros.robot.regressor import body_parameters, point_mass

PERIOD_S = 0.01
Held = tuple[float, np.ndarray]


class Ideal:
    """An arm whose links are drawn at random about the URDF's, with rotors and friction, and no noise of any kind."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        masses, coms, inertias = nominal()
        self.links = (
            masses * rng.uniform(0.9, 1.1, 6),
            coms + rng.normal(0.0, 0.005, coms.shape),
            inertias,
        )
        self.armature = rng.uniform(0.1, 0.5, 6)
        self.viscous = rng.uniform(0.1, 0.5, 6)
        self.coulomb = rng.uniform(0.1, 0.5, 6)

    def terms(self) -> np.ndarray:
        """In the order of `term_keys`; gears lose nothing, and friction does not go with the place."""
        model = RobotModel.from_urdf_string(urdf(*self.links)).lock(
            list(SIX.joints),
            {},
        )
        bodies = [body_parameters(pseudo) for pseudo in model.pseudo_inertia]
        return np.concatenate(
            [*bodies, self.armature, np.zeros(6 * 6), self.viscous, self.coulomb, np.zeros(6)]
        )

    def motion(
        self,
        seconds: float,
        held: Held | None = None,
        phase_s: float = 0.0,
    ) -> Motion:
        import mujoco

        times_s = np.arange(0.0, seconds, PERIOD_S)
        position, velocity, acceleration = sines(times_s + phase_s)
        spec = mujoco.MjSpec.from_string(urdf(*self.links, held))
        spec.compiler.fusestatic = True
        spec.compiler.balanceinertia = True
        model = spec.compile()
        model.opt.disableflags |= (
            mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        )
        model.dof_armature[:] = self.armature
        data = mujoco.MjData(model)
        torque = np.zeros_like(position)
        for row in range(len(times_s)):
            data.qpos[:], data.qvel[:], data.qacc[:] = (
                position[row],
                velocity[row],
                acceleration[row],
            )
            mujoco.mj_inverse(model, data)
            torque[row] = data.qfrc_inverse
        torque += self.viscous * velocity + self.coulomb * np.tanh(velocity / SLOW_RAD_S)
        name = "empty" if held is None else "loaded"
        return Motion(
            name,
            SIX.joints,
            times_s,
            position,
            torque / np.array(SIX.constants),
            {},
            "measured current",
        )


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(write_robot(tmp_path_factory.mktemp("arm")))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_equations_are_mujocos_inverse_dynamics_whatever_the_parameters(
    robot: Robot, seed: int
) -> None:
    """Smoothing, windows and friction that changes its sign within one lie between the two."""
    arm = Ideal(seed)
    rows = equations(
        robot,
        arm.motion(6.0),
        SIX.joints,
    )
    assert rows.design.shape[1] == len(arm.terms()) == len(term_keys(SIX.joints))
    for joint in range(6):
        mine = rows.joint == joint
        off = rows.torque[mine] - rows.design[mine] @ arm.terms()
        assert rms(off) < 0.01 * rms(rows.torque[mine])


@pytest.mark.parametrize(
    ("mass_kg", "x_m"),
    [(0.2, 0.0), (1.0, 0.05), (3.0, -0.1)],
)
def test_a_payload_adds_the_torque_of_its_parameters(
    robot: Robot, mass_kg: float, x_m: float
) -> None:
    arm = Ideal(4)
    centre = np.array([x_m, 0.03, -0.02])
    empty, loaded = (
        equations(
            robot,
            arm.motion(5.0, held),
            SIX.joints,
        )
        for held in (None, (mass_kg, centre))
    )
    ball = point_mass(centre)
    ball[[4, 7, 9]] += 0.4 * 0.05**2  # its own, as `urdf` makes it
    more = loaded.torque - empty.torque
    np.testing.assert_allclose(
        loaded.payload @ (mass_kg * ball), more, atol=0.005 * np.abs(more).max()
    )
    # with its centre stated, one column says it all but for how it is spread
    stated = equations(
        robot,
        arm.motion(5.0, (mass_kg, centre)),
        SIX.joints,
        centre,
    )
    np.testing.assert_allclose(
        mass_kg * stated.payload[:, 0],
        more,
        atol=0.02 * np.abs(more).max(),
    )


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_mass_and_place_are_found_by_what_the_empty_motion_said(robot: Robot, seed: int) -> None:
    arm = Ideal(seed)
    mass_kg = 0.2 * seed
    centre = np.array([0.04, -0.03, 0.02])
    known = fit_empty(
        robot,
        [arm.motion(15.0)],
    )
    fit = fit_payload(
        robot,
        [
            arm.motion(
                12.0,
                (mass_kg, centre),
                phase_s=3.0,
            )
        ],
        known,
    )
    assert abs(fit.values[0] - mass_kg) < min(0.01 * mass_kg, fit.half_width)
    np.testing.assert_allclose(
        fit.values[1:4] / fit.values[0],
        centre,
        atol=0.005,
    )
    assert np.all(np.abs(fit.off["own_scale"][0]) < 0.01)
    nothing = fit_payload(
        robot,
        [arm.motion(12.0, phase_s=3.0)],
        known,
    )
    assert abs(nothing.values[0]) < min(0.003, nothing.half_width)


def test_friction_and_torques_are_those_of_the_arm(robot: Robot) -> None:
    """Single masses are not determined by torques; friction and what a motion needs are."""
    arm = Ideal(8)
    known = fit_empty(
        robot,
        [
            arm.motion(20.0),
            arm.motion(20.0, phase_s=40.0),
        ],
    )
    values = dict(zip(known.keys, known.values, strict=True))
    for n, joint in enumerate(SIX.joints):
        assert values["viscous", joint] == pytest.approx(arm.viscous[n], abs=0.03)
        assert values["coulomb", joint] == pytest.approx(arm.coulomb[n], abs=0.03)
        assert abs(values["load_friction", joint]) < 0.01
    # another motion of the same arm needs the torques that the calibration says
    rows = equations(
        robot,
        arm.motion(6.0, phase_s=80.0),
        SIX.joints,
    )
    off = rows.torque - rows.design @ known.values
    assert rms(off) < 0.01 * rms(rows.torque)


@pytest.mark.parametrize(
    "by",
    [(0.96, 1.0, 1.04), (1.03, 0.97), (1.02, 0.99, 0.98, 1.01)],
)
def test_a_calibration_is_the_mean_of_recordings_whose_torque_differs(
    robot: Robot, by: tuple[float, ...]
) -> None:
    """Not a compromise between them, which would be an arm that no recording is of."""
    arm = Ideal(9)
    mass_kg = 0.5
    centre = np.array([0.04, -0.03, 0.02])
    motions = [arm.motion(12.0, phase_s=20.0 * n) for n in range(len(by))]
    known = fit_empty(
        robot, [replace(m, current_A=k * m.current_A) for m, k in zip(motions, by, strict=True)]
    )
    rows = equations(
        robot,
        arm.motion(6.0, phase_s=90.0),
        SIX.joints,
    )
    off = rows.torque - rows.design @ known.values
    assert rms(off) < 0.01 * rms(rows.torque)
    fit = fit_payload(
        robot,
        [
            arm.motion(
                12.0,
                (mass_kg, centre),
                phase_s=3.0,
            )
        ],
        known,
    )
    assert abs(fit.values[0] - mass_kg) < min(0.02 * mass_kg, fit.half_width)


def test_halves_and_loaded_parts_of_a_problem_are_its_equations(robot: Robot) -> None:
    arm = Ideal(9)
    parts = [
        equations(
            robot,
            arm.motion(
                11.0,
                (0.5, np.zeros(3)),
            ),
            SIX.joints,
        )
    ]
    parts.append(
        equations(
            robot,
            arm.motion(6.0),
            SIX.joints,
        )
    )
    problem = Problem.of(parts, 1)
    assert problem.matrix.shape == (
        sum(len(part.joint) for part in parts),
        10 + 17 * 6 + 2 * (5 * 6 + 3),
    )
    assert not problem.matrix[~problem.carrying, :10].any()
    early = problem.only(problem.carrying & (problem.stretch < 2))
    np.testing.assert_array_equal(
        early.torque,
        parts[0].torque[parts[0].stretch < 2],
    )
    assert problem.stretches_of(problem.carrying, "loaded", 15.0) >= 4
    with pytest.raises(
        RecordingError,
        match=r"empty: only \d+ s of motion can be used; record 10 s at least, better 50",
    ):
        problem.stretches_of(~problem.carrying, "empty", 50.0)


def test_another_torque_constant_than_the_calibration_s_is_refused(robot: Robot) -> None:
    check_torque_constant(
        robot,
        "j1",
        SIX.constants[0],
        "motions were",
    )
    with pytest.raises(
        RobotError, match="j1 is 10 N m/A, but motions were calibrated with 9: calibrate again"
    ):
        check_torque_constant(robot, "j1", 9.0, "motions were")


def test_a_hand_that_no_joint_moves_is_refused(tmp_path: Path) -> None:
    path = write_robot(tmp_path)
    path.write_text(path.read_text().replace("payload_frame: hand", "payload_frame: base"))
    with pytest.raises(RobotError, match="base"):
        equations(
            load_robot(path),
            Ideal(1).motion(4.0),
            SIX.joints,
        )
