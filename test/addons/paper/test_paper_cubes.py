"""The paper's two cubes, squeezed by one of the solvers and identified by the other, from five starts over two orders of magnitude.

Explicit elastodynamics of tetrahedra by semi-implicit Euler, the paper's equations (2) and (4), on one side; on the other the
table of the quasi-static finite elements with RK4. They share the energy and the mesh's geometry, and nothing that integrates.
Faces slip, so that every mesh says the same; several currents, as a probe makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import least_squares

from proprio_ros.addons.paper.softbody import SOFT_INDEX, SOFT_PARAMETERS, SoftBody, SoftRun
from proprio_ros.identification.estimate import Verdict
from proprio_ros.probes.softness.identify import SqueezeOptions, find_softness
from proprio_ros.probes.softness.problem import BlockFacts
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.energies import lame
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.mesh import box
from proprio_ros.sim.response import Response, response
from proprio_ros.sim.squeeze import SQUEEZE_INDEX, SQUEEZE_PARAMETERS, SqueezeRun, SqueezeSimulator

EDGE = 0.03
GRIPPER = "gripper_left_joint"
CUBES = {"light": (1694.6, 0.130, 0.010), "heavy": (12824.6, 0.258, 0.023)}
"""Young's modulus [Pa] and Poisson's ratio of the paper's Lame parameters, mass [kg]; its edge is not stated."""
SQUEEZES = (0.12, 0.25, 0.35)
"""Where each current would come to rest."""
DRIVE = {"armature": 0.005, "viscous": 0.02, "torque_constant": 1.78}
FRAME_S = 0.025
FACTORS = np.geomspace(0.1, 10.0, 5)


@pytest.fixture(scope="module")
def robot() -> Robot:
    """A gripper that is known exactly, has no dry friction, and is read to a tenth of a mrad: the solvers differ by that much."""
    gripper = f"joints.{GRIPPER}.drive_train."
    encoder = f"joints.{GRIPPER}.motor.encoder_"
    known = {
        "torque_constant_N_m_per_A": DRIVE["torque_constant"],
        "viscous_N_m_s_per_rad": DRIVE["viscous"],
        "armature_kg_m2": DRIVE["armature"],
        **dict.fromkeys(("coulomb_N_m", "load_friction", "zero_rad", "stribeck"), 0.0),
    }
    rest = {
        "torque_disturbance_N_m": 0.0,
        "onset_jitter_s": 0.0,
        "delay_s": 0.0,
        "stamp_jitter_s": 0.0,
    }
    rest |= {
        f"{encoder}resolution_rad": 0.0,
        f"{encoder}noise_rad": 1e-4,
        f"{encoder}once_per_turn_rad": 0.0,
    }
    return load_robot("open_manipulator_x").with_overrides(
        {**{gripper + key: v for key, v in known.items()}, **rest}
    )


@pytest.fixture(scope="module")
def table() -> Response:
    return response(
        np.full(3, EDGE),
        "log",
        "frictionless",
        far=True,
    )


def travel(robot: Robot) -> float:
    return 2.0 * robot.drive_trains[GRIPPER].transmission


def currents_A(
    robot: Robot,
    table: Response,
    modulus: float,
    ratio: float,
) -> list[float]:
    return [
        travel(robot)
        * modulus
        * EDGE**2
        * float(table(squeeze, ratio)[0])
        / DRIVE["torque_constant"]
        for squeeze in SQUEEZES
    ]


def explicit(
    robot: Robot,
    frames: int,
    current_A: float,
    moduli: np.ndarray,
    mass: float,
    substeps: int,
) -> np.ndarray:
    """Shaft angles at the end of every frame [rad] for some pairs of modulus and ratio, shape (W, frames)."""
    rows = []
    for modulus, ratio in moduli:
        mu, lam = lame(modulus, ratio)
        values = {
            "inertia": DRIVE["armature"], "torque_constant": DRIVE["torque_constant"], "viscous": DRIVE["viscous"],
            "gap": 0.0, "lame_mu": mu, "lame_lambda": lam,
        }  # fmt: skip
        rows.append([values.get(name, 0.0) for name in SOFT_PARAMETERS])
    assert SOFT_INDEX["viscosity"] == len(SOFT_PARAMETERS) - 1
    body = SoftBody(
        box(
            np.full(3, EDGE),
            (2, 2, 2),
        ),
        mass,
        travel(robot),
        contact="frictionless",
    )
    run = SoftRun(
        np.zeros(1),
        np.array([current_A]),
        frames,
        FRAME_S,
        substeps,
    )
    return body.rollout(run, np.array(rows), "starts").q


@pytest.mark.long
@pytest.mark.parametrize("cube", CUBES)
def test_explicit_squeezes_identified_by_the_quasi_static_solver(
    robot: Robot, table: Response, cube: str
) -> None:
    modulus, ratio, mass = CUBES[cube]
    start_m = 0.01
    before_s = np.arange(-20, 0) * FRAME_S
    runs = []
    for number, current_A in enumerate(currents_A(robot, table, modulus, ratio)):
        q = explicit(
            robot,
            40,
            current_A,
            np.array([[modulus, ratio]]),
            mass,
            128,
        )[0]
        runs.append(
            Run(
                name=f"squeeze {number}",
                joint=GRIPPER,
                onset_ns=0,
                times_s=np.arange(1, 41) * FRAME_S,
                position=start_m - 0.5 * travel(robot) * q,  # a finger's place falls as it closes
                before_times_s=before_s,
                before_position=np.full(len(before_s), start_m),
                held=dict.fromkeys(("joint1", "joint2", "joint3", "joint4"), 0.0),
                held_span=dict.fromkeys(("joint1", "joint2", "joint3", "joint4"), 0.0),
                input_times_s=np.zeros(1),
                input_current_A=np.array([-current_A]),
                duration_s=1.0,
                source="the explicit solver",
            )
        )
    starts = tuple((modulus * FACTORS).tolist())
    estimate = find_softness(
        robot, runs, BlockFacts(np.full(3, EDGE)), SqueezeOptions(starts_Pa=starts)
    )
    assert estimate.verdict is Verdict.ACCEPTED, estimate.reasons
    assert estimate.solver is not None
    assert estimate.solver.starts_agreeing == 5
    told = estimate.value("youngs_modulus")
    told_ratio = estimate.value("poissons_ratio")
    # by how much the solvers differ, which no interval knows
    assert told.value == pytest.approx(modulus, rel=0.005)
    assert told_ratio.value == pytest.approx(ratio, abs=0.02)


FRAMES = 40


def quasi_static(
    robot: Robot,
    table: Response,
    current_A: float,
    modulus: float,
    ratio: float,
) -> np.ndarray:
    """Shaft angles at the end of every frame by the table and RK4 [rad], shape (frames,).

    Args:
        robot: Whose gripper it is.
        table: Of the block.
        current_A: Of its motor.
        modulus: Young's [Pa].
        ratio: Poisson's.
    """
    p = np.zeros((1, len(SQUEEZE_PARAMETERS)))
    values = {
        "inertia": DRIVE["armature"],
        "torque_constant": DRIVE["torque_constant"],
        "viscous": DRIVE["viscous"],
        "youngs_modulus": modulus,
        "poissons_ratio": ratio,
    }
    for name, value in values.items():
        p[0, SQUEEZE_INDEX[name]] = value
    times_s = np.arange(1, FRAMES + 1) * FRAME_S
    joint = JointRun(
        times_s, np.zeros(1), np.array([current_A]), step_s=1 / 960, fine_step_s=1 / 960
    )
    run = SqueezeRun(joint, EDGE, EDGE**2, travel(robot), table)
    angles: np.ndarray = SqueezeSimulator([run]).rollout(np.zeros(1, dtype=np.int32), p)[0][0]
    return angles


@dataclass(frozen=True)
class ExplicitFit:
    """Fits the explicit solver to squeezes; a point is the logarithm of Young's modulus, and Poisson's ratio.

    Attributes:
        robot: Whose gripper it is.
        pushed: Current of each squeeze [A].
        recorded: Angles of all of them [rad], (N,).
        mass: Of the cube [kg].
        substeps: Of a frame.
    """

    robot: Robot
    pushed: Sequence[float]
    recorded: np.ndarray
    mass: float
    substeps: int

    def simulated(self, points: np.ndarray) -> np.ndarray:
        """Angles of all squeezes [rad], (W, N), at points (W, 2)."""
        moduli = np.stack([np.exp(points[:, 0]), points[:, 1]], axis=1)
        angles = [
            explicit(self.robot, FRAMES, current_A, moduli, self.mass, self.substeps)
            for current_A in self.pushed
        ]
        return np.hstack(angles)

    def residual(self, point: np.ndarray) -> np.ndarray:
        """In mrad, (N,)."""
        return (self.simulated(point[None])[0] - self.recorded) / 1e-3

    def jacobian(self, point: np.ndarray) -> np.ndarray:
        """Of the residual by central differences, (N, 2)."""
        step = 1e-4
        around = point + step * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        q = self.simulated(around)
        return (q[:2] - q[2:]).T / (2.0 * step * 1e-3)


@pytest.mark.long
@pytest.mark.parametrize("cube", CUBES)
def test_quasi_static_squeezes_identified_by_the_explicit_solver(
    robot: Robot, table: Response, cube: str
) -> None:
    modulus, ratio, mass = CUBES[cube]
    # short enough steps for ten times the modulus
    substeps = {"light": 96, "heavy": 192}[cube]
    pushed = currents_A(robot, table, modulus, ratio)[::2]
    recorded = [quasi_static(robot, table, current_A, modulus, ratio) for current_A in pushed]
    fit = ExplicitFit(robot, pushed, np.hstack(recorded), mass, substeps)
    bounds = ([np.log(modulus * 0.05), 0.0], [np.log(modulus * 20.0), 0.45])
    for factor in FACTORS:
        found = least_squares(
            fit.residual,
            np.array([np.log(modulus * factor), 0.3]),
            fit.jacobian,
            bounds,
            x_scale=np.array([1.0, 0.3]),
            xtol=1e-6,
            max_nfev=40,
        )
        assert np.exp(found.x[0]) == pytest.approx(modulus, rel=0.01), factor
        assert found.x[1] == pytest.approx(ratio, abs=0.02), factor
