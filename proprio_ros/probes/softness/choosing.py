"""Squeeze until sure: with which current a block is squeezed next.

The sequence's own first squeeze says roughly how soft the block is. After each squeeze all are fitted, gripper and block together;
currents up to what the sequence and the motor allow are then simulated at the modulus found, each until its travel ends it. What
each would take from the variance of the modulus follows from its sensitivities.

Square waves are left out. They promise more, since friction turns round with them; but how a block loses energy when it is squeezed
fast is not what the law of a squeeze says, and squeezes with waves of half the force were not explained.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.plans import ExcitationRun, ExcitationSequence
from proprio_ros.experiment_design.candidates import Push, best_first, still_run
from proprio_ros.experiment_design.choosing import Chooser, Found, alone, time_of
from proprio_ros.experiment_design.forecast import Forecast, gain_per_s, until_broken, whitened
from proprio_ros.experiment_design.predicted_precision import SharedUnknowns
from proprio_ros.experiment_design.sequential import FASTEST
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.gates import MIN_USED, UNMOVED_RAD
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.softness.identify import SqueezeOptions, SqueezeSearch, fit_squeezes
from proprio_ros.probes.softness.problem import BlockFacts, SqueezeProblem
from proprio_ros.quantity import Sought
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import zero_pose

CURRENTS = 10
DURATIONS_S = (0.6, 1.0)
LEAST_BEYOND = 1.2  # the smallest current, over what friction takes of it
UNKNOWN_SHARE = 3.0
"""How far off a modulus may be that no squeeze has told, as a share of it: so that the variance is finite."""
RAISE_BY = 1.4


class SqueezesUntilSure(Chooser):
    """One block whose squeezes are chosen one by one; the runs of the sequence say which joint squeezes, and how far at most.

    Raises `ConfigurationError`: The sequence has no `until`, or no run of its own.
    """

    no_push = "no current moves the fingers far enough inside their limits: is the block between them, and are they free to move?"

    def __init__(
        self,
        robot: Robot,
        facts: BlockFacts,
        options: SqueezeOptions,
        sequence: ExcitationSequence,
        whole: Callable[[Sequence[Run]], float | None] | None = None,
    ) -> None:
        super().__init__(
            robot,
            sequence,
            Sought("youngs_modulus", "Pa", share=True, label="Young's modulus"),
            whole,
        )
        if not sequence.runs:
            raise ConfigurationError(f"{sequence.name}: state a first squeeze under 'runs'")
        self._facts = facts
        self._options = options
        self._first = sequence.runs[0]
        self._farthest_m = max(run.max_travel for run in sequence.runs)
        stated = [run.max_current_A for run in sequence.runs if run.max_current_A is not None]
        motor = robot.motors[self._first.joint]
        self._limit_A = min(motor.current_limit_A, max(stated, default=np.inf))
        self._usable: list[PreparedRun] = []
        self._heard = 0
        self._fit: FitResult | None = None
        self._began: float | None = None

    def learn(self, runs: Sequence[Run]) -> Found:
        for run in runs[self._heard :]:
            prepared = prepare_run(self.robot, run, KnownLoad(), past_fast=True)
            if prepared.used >= MIN_USED and abs(prepared.travel) >= UNMOVED_RAD:
                self._usable.append(prepared)
        self._heard = len(runs)
        if not self._usable:
            return self._found
        self._fit = fit_squeezes(
            self.robot,
            self._usable,
            self._facts,
            self._options,
            self._fit,
        )
        modulus = float(self._fit.values[self._fit.problem.index["youngs_modulus"]])
        self._shared = SharedUnknowns(self._fit.problem)
        at = self._shared.at["youngs_modulus"]
        self._shared.prior[at, at] += (UNKNOWN_SHARE * modulus) ** -2
        self._covariance = self._shared.covariance_after(self._fit)
        return Found(
            modulus,
            float(np.sqrt(self._covariance[at, at])),
            len(self._usable),
            self._fit.reduced_chi2,
        )

    def ranked(
        self,
        pose: Mapping[str, float],
        target_std: float,
    ) -> list[Push]:
        if self._fit is None:
            return []
        joint = self._first.joint
        if self._began is None:
            self._began = float(pose[joint])
        start = {**zero_pose(self.robot), **pose, joint: self._began}
        currents_A = self._currents()
        still = prepare_run(
            self.robot,
            still_run(joint, start, currents_A[0], max(DURATIONS_S)),
            KnownLoad(),
            past_fast=True,
        )
        squeezes = [
            replace(still, run=replace(still.run, input_current_A=np.array([current])))
            for current in currents_A
        ]
        beside_s = float(time_of(self.robot, self._sequence, pose)([start])[0])
        forecast = self._forecast(self._fit, squeezes)
        return best_first(self._promised(currents_A, forecast, start, beside_s), target_std)

    def _currents(self) -> list[float]:
        """What could be squeezed with, from a little beyond friction to the limit [A]."""
        drive = self._usable[0].drive
        towards = float(np.sign(self._first.current_A))
        rubs_A = (drive.coulomb.value + 0.5 * drive.coulomb.std) / drive.torque_constant.value
        least_A = min(
            max(LEAST_BEYOND * rubs_A, 0.5 * abs(self._first.current_A)),
            self._limit_A,
        )
        sizes = np.geomspace(least_A, self._limit_A, CURRENTS).round(3)
        return [towards * size for size in sizes.tolist()]

    def _forecast(self, fit: FitResult, runs: Sequence[PreparedRun]) -> Forecast:
        """What squeezes from one start would show, at the modulus found, (C, T)."""
        search = SqueezeSearch(
            self.robot, tuple(runs), (True,) * len(runs), self._facts, self._options
        )
        problem = search.problem(Role.ESTIMATED)
        with np.errstate(over="ignore", invalid="ignore"):
            q, v, dq = problem.simulate(_carried_over(fit, problem)[None], problem.estimated)
        velocity = v[0]  # (C, T)
        slopes = dq[0]  # by the estimated unknowns, (C, T, F)
        away = q[0] - runs[0].rest.value
        alive = self._alive(away, velocity, slopes)
        columns, variance = self._shared.columns_of(problem)
        at = np.searchsorted(problem.estimated, columns)
        by_unknown = np.stack([slopes[run][:, own] for run, own in enumerate(at)])
        reading_std = np.array([run.sigma[0] for run in runs])
        rows = whitened(by_unknown, velocity, alive, reading_std, self.robot.stamp_jitter_s)
        stds, _ = self._shared.stds_along(rows, variance, self._covariance, "youngs_modulus")
        return Forecast(
            runs[0].times_s,
            away * runs[0].drive.transmission,
            alive.sum(axis=1),
            stds,
        )

    def _alive(self, away: np.ndarray, velocity: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """The samples up to which a squeeze stays inside the limits; it ends at the one where it is seen to have gone too far."""
        transmission = self._usable[0].drive.transmission
        close_enough = np.abs(away) * abs(transmission) < self._farthest_m
        holds = np.isfinite(away) & np.isfinite(slopes).all(axis=2) & (np.abs(velocity) < FASTEST)
        holds[:, 1:] &= close_enough[:, :-1]
        return until_broken(holds)

    def _promised(
        self,
        currents_A: Sequence[float],
        forecast: Forecast,
        start: dict[str, float],
        beside_s: float,
    ) -> list[Push]:
        """Squeezes from one start, with every duration in which the fingers move far enough."""
        place = self._shared.at["youngs_modulus"]
        now = self._covariance[place, place]
        pushes: list[Push] = []
        for duration in DURATIONS_S:
            for c, current in enumerate(currents_A):
                last = forecast.samples_in(c, duration)
                if last < MIN_USED:
                    continue
                ends_s = float(forecast.times_s[last - 1])
                # what its travel ends before is the same push
                if duration > DURATIONS_S[0] and ends_s <= DURATIONS_S[0]:
                    continue
                travel = forecast.farthest(c, last)
                if abs(travel) < self._first.min_travel:
                    continue
                std = float(forecast.stds[c, last - 1])
                seconds = beside_s + ends_s
                pushes.append(
                    Push(
                        self._first.joint,
                        start,
                        current,
                        0.0,
                        duration,
                        seconds,
                        std,
                        gain_per_s(now, max(std**2, 1e-6 * now), seconds),
                        travel,
                    )
                )
        return pushes

    def run_of(self, push: Push) -> ExcitationRun:
        start = {push.joint: push.start[push.joint]}
        first = replace(
            self._first, max_travel=self._farthest_m, max_current_A=self._limit_A, raise_by=RAISE_BY
        )
        return replace(first, current_A=push.current_A, duration_s=push.duration_s, start=start)

    def sequence_of(self, run: ExcitationRun) -> ExcitationSequence:
        """A sequence of one squeeze, after which the fingers let go."""
        return replace(
            alone(self._sequence, run),
            from_here=(),
            home=dict(run.start),
        )


def _carried_over(fit: FitResult, problem: SqueezeProblem) -> np.ndarray:
    """Values of the unknowns of squeezes that have not been made: what all runs share, and the mean gap, (N,)."""
    found = list(zip(fit.problem.unknowns, fit.values.tolist(), strict=True))
    gap = float(np.mean([value for unknown, value in found if unknown.kind == "gap"]))
    shared = {unknown.key: value for unknown, value in found if unknown.shared}
    return np.array(
        [
            gap if unknown.kind == "gap" else shared.get(unknown.key, unknown.value)
            for unknown in problem.unknowns
        ]
    )
