"""A payload that moves in the hand on a joint of its own, a slide or a universal joint: its mass from the driven joint's encoder.

The paper names these interactions and shows neither. No probe weighs such a payload; here the problem of ``identification``
gets the chain simulator in the place of the single joint's. What the payload does on its joint is not measured: how fast it
slides to and fro and how soon that dies out is unknown, and so is where it began, about its place of rest.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from proprio_ros.addons.paper.chain import ChainSimulator, attach_payload_joint, inertial_parameters
from proprio_ros.addons.paper.ways import Answer
from proprio_ros.identification import solvers
from proprio_ros.identification.coefficients import axis_and_gravity, reduced_model
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.moving_part import InertialTerms
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import robot_unknowns
from proprio_ros.identification.unknowns import Role, Unknown
from proprio_ros.kinds import Kind, add_kinds
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import ReducedModel, Robot, pseudo_inertia, rotation_about
from proprio_ros.sim.joint import JointRun, samples_within
from proprio_ros.sim.joint_kernels import PARAMETERS
from proprio_ros.sim.payload import joint_coefficients

STARTS_KG = (0.005, 0.016, 0.05, 0.16, 0.5)
# how fast the payload's own motion dies out [1/s]: expected, and standard deviation
DECAY = (2.5, 2.0)
AWAY = (-1.0, 0.0, 1.0)
"""Frequencies of a slide that a search starts from, in standard deviations from what is expected."""
START_STD = {"prismatic": (0.004, 0.1), "universal": (0.1, 1.0)}
"""How far a payload may be from its place of rest when the current comes on, and how fast: m and m/s, rad and rad/s."""
NOT_IN_A_CHAIN = ("stribeck", "stribeck_velocity", "disturbance")
"""Of the driven joint, what the chain simulator does not have."""

add_kinds(
    {
        "payload_frequency": Kind("rad/s", "frequency of the payload on its joint"),
        "payload_decay": Kind("1/s", "decay of the payload's own motion"),
        **{
            f"payload_start_{n}": Kind("m, rad", f"start of the payload on its joint {n}", "run")
            for n in (1, 2)
        },
        **{
            f"payload_speed_{n}": Kind(
                "m/s, rad/s", f"speed of the payload on its joint {n}", "run"
            )
            for n in (1, 2)
        },
    }
)


@dataclass(frozen=True)
class Hung:
    """What is stated about a payload and its joint."""

    kind: str  # ``"prismatic"`` or ``"universal"``
    axes: np.ndarray  # of its joint in the payload frame, shape (3,) or (2, 3)
    com: np.ndarray  # centre of mass with the joint at zero, in the payload frame [m], shape (3,)
    second_moment_per_mass: np.ndarray  # see ``PayloadShape``, shape (3, 3)
    # of a slide [rad/s]: expected, and standard deviation
    frequency: tuple[float, float] = (20.0, 8.0)

    @property
    def joints(self) -> int:
        return 1 if self.kind == "prismatic" else 2

    @property
    def pseudo_per_kg(self) -> np.ndarray:
        """Pseudo-inertia of a kilogram of it about the payload frame, shape (4, 4)."""
        spread = self.second_moment_per_mass
        return pseudo_inertia(
            1.0,
            self.com,
            np.trace(spread) * np.eye(3) - spread,
        )

    @property
    def inertia_per_kg(self) -> float:
        """Against its joint: 1, or about the hinges as if it were a pendulum [m^2]."""
        return 1.0 if self.kind == "prismatic" else float(self.com @ self.com)

    def at_rest(self, gravity: np.ndarray, frequency: float) -> np.ndarray:
        """Where it hangs still, shape (J,), under gravity in the payload frame [m/s^2]; a slide's frequency [rad/s]."""
        if self.kind == "prismatic":
            return np.array([float(self.axes @ gravity) / frequency**2])

        def height(angles: np.ndarray) -> float:
            turned = rotation_about(self.axes[0], angles[0]) @ rotation_about(
                self.axes[1], angles[1]
            )
            return -float(gravity @ turned @ self.com)

        return minimize(height, np.zeros(2)).x


class HungSimulator:
    """The chain simulator behind the face of ``JointSimulator``: a run's joint and the payload's, of which only the first is seen.

    Parameters are those of ``JointSimulator`` and, at the end, the payload's mass, stiffness and damping of its joint, and where
    and how fast it begins.
    """

    def __init__(
        self,
        models: Sequence[ReducedModel],
        runs: Sequence[JointRun],
        hung: Hung,
        frame: str,
    ) -> None:
        self.runs = tuple(runs)
        self.sample_counts = np.array(
            [len(run.sample_times_s) for run in runs],
            dtype=np.int32,
        )
        starts = [f"{what}_{n + 1}" for what in ("start", "speed") for n in range(hung.joints)]
        self.parameters = (*PARAMETERS, "mass", "stiffness", "damping", *starts)
        self._chains: list[tuple[ChainSimulator, np.ndarray]] = []
        for model, run in zip(models, runs, strict=True):
            whole = attach_payload_joint(model, frame, hung.kind, hung.axes, hung.pseudo_per_kg)
            others = [0.0] * hung.joints
            current = np.array([[ampere, *others] for ampere in run.input_current_A])
            supply = np.array([run.supply, *([(0.0, 0.0, 1.0)] * hung.joints)])
            chain = ChainSimulator(
                whole, run.sample_times_s, run.input_times_s, current, friction_velocity=run.friction_velocity,
                supply=supply, step_s=run.step_s, fine_step_s=run.fine_step_s,
            )  # fmt: skip
            self._chains.append((chain, self._map(chain, model, hung)))

    def windows(self, fraction: float) -> np.ndarray:
        """As of ``JointSimulator``: how many samples of each run lie in the first part of its time, shape (R,)."""
        of_runs = [
            samples_within(run.sample_times_s[None], self.sample_counts[row : row + 1], fraction)
            for row, run in enumerate(self.runs)
        ]
        return np.concatenate(of_runs)

    def _map(self, chain: ChainSimulator, model: ReducedModel, hung: Hung) -> np.ndarray:
        """From our parameters to the chain's, shape (C, P)."""
        at = {name: row for row, name in enumerate(self.parameters)}
        first = {group: columns.start for group, columns in chain.columns.items()}
        by = np.zeros((len(chain.parameter_names), len(self.parameters)))
        for group in (
            "torque_constant",
            "coulomb",
            "viscous",
            "load_friction",
            "q0",
            "v0",
            "delay",
        ):
            by[first[group], at[group]] = 1.0
        # of the bodies before the payload's joint only what the driven joint feels matters: inertia, and a moment of gravity
        by[first["armature"], at["inertia"]] = 1.0
        axis, gravity = axis_and_gravity(model)
        across = np.linalg.svd(axis[None])[2][1:]
        felt = []
        for direction in across:
            moment = np.zeros((4, 4))
            moment[:3, 3] = moment[3, :3] = direction
            felt.append(joint_coefficients(moment, model.kinds[0], axis, gravity)[1:3])
        moments = across.T @ np.linalg.inv(np.array(felt).T)
        pi = first["pi"]
        by[pi + 1 : pi + 4, [at["gravity_cos"], at["gravity_sin"]]] = moments
        last = chain.columns["pi"].stop
        by[last - 10 : last, at["mass"]] = inertial_parameters(hung.pseudo_per_kg)
        for n in range(1, hung.joints + 1):
            for group, name in (
                ("stiffness", ""),
                ("viscous", "damping"),
                ("q0", f"start_{n}"),
                ("v0", f"speed_{n}"),
            ):
                by[first[group] + n, at[name or group]] = 1.0
        return by

    def jacobian(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As ``JointSimulator.jacobian``; all samples are computed whatever the ``counts``.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters, shape (W, P).
            dp: Directions, shape (W, P, D).
            counts: Ignored.
        """
        shape = (len(world_run), int(self.sample_counts.max()))
        q = np.zeros(shape)
        v = np.zeros(shape)
        dq = np.zeros((*shape, dp.shape[2]))
        for row, (chain, by) in enumerate(self._chains):
            mine = np.flatnonzero(world_run == row)
            if len(mine):
                seen, _, slopes = chain.jacobian(
                    p[mine] @ by.T,
                    by @ dp[mine],
                )
                count = seen.shape[1]
                q[mine, :count] = seen[..., 0]
                dq[mine, :count] = slopes[:, :, 0]
        return q, v, dq


class HungProblem(Problem):
    """Whitened residuals of runs, prepared as with an empty hand, with a payload on a joint of its own."""

    def __init__(
        self,
        robot: Robot,
        runs: Sequence[PreparedRun],
        hung: Hung,
        unknowns: Sequence[Unknown],
    ) -> None:
        self.hung = hung
        self._prepared = tuple(runs)
        self._gravity = []  # as the hand feels it before each run [m/s^2], shape (3,)
        for run in runs:
            pose = {**run.run.held, run.run.joint: run.rest.value}
            self._gravity.append(
                robot.model.frame_transform(robot.payload_frame, pose)[:3, :3].T @ robot.gravity
            )
        super().__init__(robot, runs, KnownLoad().facts, unknowns)

    def is_affine(self) -> bool:
        return False  # stiffness and damping are products of two unknowns

    def simulator_of(self, runs: list[JointRun], integrator: str) -> HungSimulator:  # type: ignore[override]
        models = [reduced_model(self.robot, run.run, {}) for run in self._prepared]
        return HungSimulator(models, runs, self.hung, self.robot.payload_frame)

    def touches(self, unknown: Unknown, row: int) -> bool:
        return unknown.kind == "payload_mass" or super().touches(unknown, row)

    def payload(self, values: np.ndarray) -> InertialTerms:
        # it is not part of the driven body
        return InertialTerms(np.zeros((len(values), 10)), {})

    def all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        p, dp = super().all_parameters(values)
        at = self.index
        to = {name: column for column, name in enumerate(self.simulator.parameters)}
        mass = values[:, at["payload_mass"]]
        decay = values[:, at["payload_decay"]]
        frequency = values[:, at["payload_frequency"]]
        slides = self.hung.kind == "prismatic"
        inertia = self.hung.inertia_per_kg
        for row, gravity in enumerate(self._gravity):
            p[:, row, to["mass"]] = mass
            dp[:, row, to["mass"], at["payload_mass"]] = 1.0
            p[:, row, to["damping"]] = 2.0 * inertia * mass * decay
            dp[:, row, to["damping"], at["payload_mass"]] = 2.0 * inertia * decay
            dp[:, row, to["damping"], at["payload_decay"]] = 2.0 * inertia * mass
            if slides:
                p[:, row, to["stiffness"]] = mass * frequency**2
                dp[:, row, to["stiffness"], at["payload_mass"]] = frequency**2
                dp[:, row, to["stiffness"], at["payload_frequency"]] = 2.0 * mass * frequency
            for n, resting in enumerate(self.hung.at_rest(gravity, 1.0), start=1):
                for what in ("start", "speed"):
                    column = to[f"{what}_{n}"]
                    own = at[f"payload_{what}_{n}", row]
                    p[:, row, column] = values[:, own]
                    dp[:, row, column, own] = 1.0
                p[:, row, to[f"start_{n}"]] += resting / frequency**2 if slides else resting
                if slides:
                    dp[:, row, to[f"start_{n}"], at["payload_frequency"]] = (
                        -2.0 * resting / frequency**3
                    )
        return p, dp


def hung_unknowns(
    robot: Robot,
    runs: Sequence[PreparedRun],
    hung: Hung,
) -> list[Unknown]:
    """The payload's mass, what its joint does, where it began in each run, and what is open about the robot.

    Args:
        robot: The arm.
        runs: R runs.
        hung: The payload and its joint.
    """
    slides = hung.kind == "prismatic"
    unknowns = [
        Unknown("payload_mass", 0.05, np.inf, 1e-4, 20.0, asinh_scale=0.005),
        Unknown(
            "payload_frequency",
            *hung.frequency,
            5.0,
            60.0,
            role=Role.ESTIMATED if slides else Role.FIXED,
        ),
        Unknown("payload_decay", *DECAY, 0.0, 50.0),
    ]
    start_std, speed_std = START_STD[hung.kind]
    for row, n in product(range(len(runs)), range(1, hung.joints + 1)):
        unknowns.append(Unknown(f"payload_start_{n}", 0.0, start_std, scope=row))
        unknowns.append(Unknown(f"payload_speed_{n}", 0.0, speed_std, scope=row))
    return unknowns + [
        replace(u, value=0.0 if u.kind == "stribeck" else u.value, role=Role.FIXED)
        if u.kind in NOT_IN_A_CHAIN
        else u
        for u in robot_unknowns(robot, runs, Role.ESTIMATED)
    ]


def identify_hung(robot: Robot, runs: Sequence[Run], hung: Hung) -> Answer:
    """The mass [kg] of a payload on a joint of its own, from runs of a calibrated robot's joint from rest.

    Its interval is widened where the fit is worse than the encoder explains, which the verdict says.

    Args:
        robot: The arm, calibrated.
        runs: Of a joint from rest, with the payload in the hand.
        hung: The payload and its joint.
    """
    began = time.process_time()
    prepared = [prepare_run(robot, run, KnownLoad()) for run in runs]
    problem = HungProblem(robot, prepared, hung, hung_unknowns(robot, prepared, hung))
    coordinates = problem.coordinates
    slides = hung.kind == "prismatic"
    guesses = np.array(list(product(STARTS_KG, AWAY if slides else (0.0,))))
    starts = np.tile(coordinates.prior_mean, (len(guesses), 1))
    starts[:, 0] = guesses[:, 0]
    if slides:
        starts[:, 1] += guesses[:, 1] * hung.frequency[1]
    solution = solvers.levenberg_marquardt(
        problem, coordinates.internal(starts), problem.simulator.windows
    )
    fit = FitResult.of(problem, solution)
    covariance = Posterior(problem, fit.values, max(1.0, fit.reduced_chi2)).whole_covariance()
    at = problem.index["payload_mass"]
    mass = float(fit.values[at])
    reach = Z95 * float(np.sqrt(covariance[at, at]))
    verdict = "explained" if fit.explains else "not explained"
    return Answer(
        mass,
        mass - reach,
        mass + reach,
        time.process_time() - began,
        verdict,
    )
