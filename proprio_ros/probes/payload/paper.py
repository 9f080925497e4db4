"""Profile ``paper``: the identification as the paper does it, to compare with and to see where it stops.

The paper: Chen et al. 2025, arXiv:2410.03920, equations (2) and (5).

One unknown, the mass; the run starts at rest where the first sample is; semi-implicit Euler, the paper's equation (2); the loss,
its equation (5), is the squared error of the last frame; its gradient is exact (the paper's comes from ``wp.Tape``); Adam with
cosine annealing. The schedule moves the mass by at most about ``rate x iterations / 2`` and then stops, wherever it is. So every
start is run twice: with the schedule as stated, and with one long enough to reach the least error; both are shown.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.estimate import (
    Estimate,
    Fit,
    Scan,
    SolverSummary,
    StartPath,
    Value,
    Verdict,
)
from proprio_ros.identification.gates import MISFIT_LIMIT
from proprio_ros.identification.posterior import run_fits
from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.reasons import Reason
from proprio_ros.identification.robot_unknowns import load_unknowns
from proprio_ros.identification.solvers import Solution, adam_descent
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.payload.identify import WeighingOptions, scan_masses, weigh
from proprio_ros.quantity import shown
from proprio_ros.recordings.published import FRAME_S, PROBE_FRAMES
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import JointSimulator
from proprio_ros.sim.payload import PayloadFacts


@dataclass(frozen=True)
class PaperOptions:
    """The paper's setting."""

    substeps: int = 16  # Euler steps per 1/60 s frame, 4 to 64 in the paper
    # iterations, extended_iterations: lengths of the cosine schedule, and of one that is allowed to converge
    iterations: int = 50
    extended_iterations: int = 400
    learning_rate: float = 0.01  # Adam's, at the start [kg per iteration]
    starts_kg: tuple[float, ...] = (0.005, 0.016, 0.05, 0.16, 0.5)  # first guesses
    # loss_time_s, loss_sample: simulated instant that is compared, and index of the sample; default the last's
    loss_time_s: float | None = None
    loss_sample: int | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.substeps <= 1024:
            raise ConfigurationError(
                f"paper.substeps={self.substeps}: choose 1 to 1024 (the paper: 4 to 64)"
            )
        if self.iterations < 1 or self.extended_iterations < 1 or self.learning_rate <= 0.0:
            raise ConfigurationError(
                "paper.iterations, extended_iterations and learning_rate must be positive"
            )
        if not self.starts_kg or min(self.starts_kg) <= 0.0:
            raise ConfigurationError("paper.starts_kg needs at least one positive mass in kg")


def identify_as_paper(
    robot: Robot, runs: Sequence[Run], facts: PayloadFacts, options: PaperOptions
) -> Estimate:
    """Identify the mass of one run as the paper does.

    The value is the least-error mass. It carries no interval, because the method has none; the verdict comes from the whole
    trajectory, and from the default profile, whose reasons are repeated.

    Args:
        robot: As its file states it.
        runs: One.
        facts: Where the payload's centre is, and its shape.
        options: Of the paper's search.

    Raises:
        ConfigurationError: More than one run.
        RecordingError: See ``weigh``.
    """
    if len(runs) != 1:
        raise ConfigurationError(
            f"profile paper fits one run at a time, not {len(runs)}: choose one bag, or the default profile"
        )
    run = runs[0]
    honest = weigh(robot, runs, facts, WeighingOptions())
    # the joint did not move, or nothing of the run is usable: there is nothing to fit
    if honest.fit is None:
        return honest
    loss = last_frame_loss(robot, run, facts, options)
    starts = np.array(options.starts_kg)[:, None]
    scheduled = adam_descent(loss, starts, options.learning_rate, options.iterations, lower=1e-6)
    extended = adam_descent(
        loss, starts, options.learning_rate, options.extended_iterations, lower=1e-6
    )
    stopped = scheduled.internal[:, 0]  # where the schedule as stated leaves each start [kg]
    best = float(extended.internal[extended.best, 0])
    whole = loss.whole.all_values(np.array([[best]]))[0]
    fits, rms, expected = run_fits(loss.whole, whole, [loss.prepared])
    whitened = (fits[0].simulated - fits[0].measured) / fits[0].sigma
    fit = Fit(rms, expected, float(np.mean(whitened**2)))
    masses = scan_masses(best)
    mass = Value(
        "payload_mass",
        "kg",
        best,
        reason="least error of the last frame; the method gives no interval",
    )
    misses = fit.reduced_chi2 > MISFIT_LIMIT
    return replace(
        honest,
        verdict=Verdict.REJECTED if misses else honest.verdict,
        reasons=(
            *([_missed(best, fit)] if misses else []),
            *(_without_interval(reason) for reason in honest.reasons),
            f"the schedule of {options.iterations} iterations stops at {shown('kg', *stopped, spec='.1f', between=', ')}; "
            f"the least error is at {shown('kg', best, spec='.1f')}",
        ),
        values=(mass,),
        fit=fit,
        solver=SolverSummary(
            "adam",
            "paper",
            options.iterations,
            _paths(starts[:, 0], stopped, extended, best),
            "semi_implicit",
            loss.step_s,
        ),
        run_fits=fits,
        unknowns=(),
        budget=(),
        scanned=lambda: Scan(
            masses, 1e6 * loss(masses[:, None])[0], "squared error of the last frame (mrad^2)"
        ),
        assumptions=(
            "the mass is the only unknown; torque constant, friction, armature and timing are taken as the robot file states them",
            "the run starts at rest at its first sample",
            f"semi-implicit Euler, {options.substeps} steps per frame; loss: squared error of the frame at {loss.time_s:.3f} s",
            f"Adam, learning rate {options.learning_rate:g} kg, cosine annealing over {options.iterations} iterations "
            f"({options.extended_iterations} for the least error), exact gradient",
        ),
        notes=(),
    )


def _paths(
    starts_kg: np.ndarray, stopped_kg: np.ndarray, extended: Solution, best_kg: float
) -> tuple[StartPath, ...]:
    """Every start's way to the least error that it finds, and where the schedule as stated leaves it."""
    paths = []
    for s, start in enumerate(starts_kg.tolist()):
        found = float(extended.internal[s, 0])
        paths.append(
            StartPath(
                start,
                found,
                float(extended.cost[s]),
                abs(found - best_kg) <= 0.005 * best_kg,
                extended.path[:, s, 0],
                extended.path_cost[:, s],
                scheduled=float(stopped_kg[s]),
            )
        )
    return tuple(paths)


def _missed(mass: float, fit: Fit) -> str:
    """Why a mass [kg] that meets the last frame is no weighing."""
    return (
        f"the mass that meets the last frame ({shown('kg', mass, spec='.1f')}) misses the trajectory by "
        f"{shown('rad', fit.rms, spec='.1f')} rms where the encoder explains "
        f"{shown('rad', fit.expected_rms, spec='.2f')}: the last frame alone is no weighing"
    )


def last_frame_loss(
    robot: Robot, run: Run, facts: PayloadFacts, options: PaperOptions
) -> LastFrame:
    """The paper's loss of a run, as a function of the mass.

    Args:
        robot: As its file states it.
        run: From rest.
        facts: Where the payload's centre is, and its shape.
        options: Which frame is compared, and how many steps it takes.

    Raises:
        ConfigurationError: The loss wants a sample that the run does not have.
        RecordingError: See ``prepare_run``.
    """
    prepared = prepare_run(
        robot,
        replace(
            run,
            before_times_s=np.zeros(0),
            before_position=np.zeros(0),
            held_position={},
        ),
    )
    last = options.loss_sample
    if last is None:
        last = len(run.times_s) - 1
    loss_time = options.loss_time_s
    if loss_time is None:
        loss_time = float(run.times_s[last])
    if not 0 <= last < len(run.times_s) or loss_time <= 0.0:
        raise ConfigurationError(
            f"the loss wants sample {last} at {loss_time} s, but {run.name} has {len(run.times_s)} samples"
        )
    step = FRAME_S / options.substeps
    return LastFrame(
        robot,
        prepared,
        facts,
        step,
        loss_time,
        float(run.position[last]),
    )


def _without_interval(reason: str) -> str:
    """A reason of the default profile; where that speaks of its interval, it is said whose interval that is."""
    match getattr(reason, "code", "other"):
        case "not_calibrated":
            return Reason(
                "not_calibrated",
                "the robot has not been calibrated: the method takes its file's numbers as exact",
            )
        case "coarse_fit" | "guessed_facts" | "too_wide" as code:
            return Reason(code, f"default profile: {reason}")
    return reason


def as_published(
    paper: PaperOptions, setting: Mapping[str, Any], stated: Container[str]
) -> PaperOptions:
    """The setting that came with a recording of the authors, in which they fitted it.

    Args:
        paper: The setting without it.
        setting: Sections `simulation` and `fit` of the recording's file.
        stated: Keys that the user stated, whose values stay.
    """
    simulation = setting.get("simulation", {})
    changes: dict[str, Any] = {}
    if "substeps" in simulation and "paper.substeps" not in stated:
        changes["substeps"] = int(simulation["substeps"])
    fit = setting.get("fit", {})
    if "start_mass_kg" in fit and "paper.starts_kg" not in stated:
        # the starts of the paper's Table II below 1 kg, the recording's own first
        changes["starts_kg"] = tuple(
            sorted({float(fit["start_mass_kg"]), 0.001, 0.005, 0.095, 0.191})
        )
    if "optimizer" in fit and "paper.iterations" not in stated:
        changes["iterations"] = 15
    if "loss" in fit and "paper.loss_sample" not in stated:
        # the authors keep the states before each step, so the last one they compare lies one substep before
        # frame 36; it meets sample 35
        substeps = changes.get("substeps", paper.substeps)
        changes |= {
            "loss_time_s": (PROBE_FRAMES - 1 / substeps) * FRAME_S,
            "loss_sample": PROBE_FRAMES - 1,
        }
    return replace(paper, **changes)


class LastFrame:
    """Equation (5): squared error of one frame, and its gradient, for all starts at once.

    Attributes:
        prepared: The run, from rest at its first sample.
        step_s, time_s: Of semi-implicit Euler, and the simulated instant that is compared.
        whole: The same robot and run with all samples, to see how the rest of the trajectory fits.
    """

    def __init__(
        self,
        robot: Robot,
        run: PreparedRun,
        facts: PayloadFacts,
        step_s: float,
        time_s: float,
        target: float,
    ) -> None:
        self._target = target
        self.prepared = run
        self.step_s = step_s
        self.time_s = time_s
        last = replace(
            run.run,
            times_s=np.array([time_s]),
            position=np.array([target]),
        )
        at_rest = replace(
            run,
            run=last,
            used=1,
            sigma=run.sigma[-1:],
        )
        # nothing but the mass is unknown: everything else keeps the value of the robot file
        unknowns = [
            u if u.kind == "payload_mass" else replace(u, role=Role.FIXED)
            for u in load_unknowns(robot, [run], facts, Role.FIXED, 0.05)
        ]
        self._problem = Problem(robot, [at_rest], facts, unknowns, "semi_implicit", step_s)
        self.whole = Problem(robot, [run], facts, unknowns, "semi_implicit", step_s)
        self._mass = np.array([self._problem.index["payload_mass"]])

    def __call__(
        self,
        mass: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Loss (S,) and gradient (S, 1) at masses (S, 1)."""
        problem = self._problem
        p, dp = problem.parameters(problem.all_values(mass), self._mass)
        assert isinstance(problem.simulator, JointSimulator)
        q, _, dq = problem.simulator.jacobian(
            np.zeros(
                len(mass),
                dtype=np.int32,
            ),
            p[:, 0],
            dp[:, 0],
        )
        error = q[:, :1] - self._target
        return error[:, 0] ** 2, 2.0 * error * dq[:, 0]
