"""Squeeze until sure: with which current a block is squeezed next.

The sequence's own first squeeze says roughly how soft the block is. After each squeeze all are fitted, gripper and block together;
currents up to what the sequence and the motor allow are then simulated at the modulus found, each until its travel ends it. What
each would take from the variance of the modulus follows from its sensitivities.

Some let go again: half of the time with the current that squeezes, half with one that only holds the block, twice. Friction turns
round with the motion, so they tell the part that rises with the load from the torque constant, which no closing can; what a block
itself loses (`block.loss`) shows at once where it pushes the fingers back against little current.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.plans import LEAST_SHAKES, ExcitationRun, ExcitationSequence
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
from proprio_ros.robot.drive_train import DriveTrain
from proprio_ros.robot.kinematics import zero_pose

CURRENTS = 10
DURATIONS_S = (0.6, 1.0)
PRESSED_S = (0.25, 0.4)
"""For how long a squeeze that lets go again presses, before it lets go for as long."""
HOLDING_A = 0.012
"""What holds a block that is let go [A]: no block falls, and no recording is cut."""
LETS_GO = (0.2, 0.75)
"""Which share of the farthest travel the fingers have made when a squeeze lets go."""
LEAST_BEYOND = 1.2  # the smallest current, over what friction takes of it
UNKNOWN_SHARE = 3.0
"""How far off a modulus may be that no squeeze has told, as a share of it: so that the variance is finite."""
RAISE_BY = 1.4


@dataclass(frozen=True)
class _Squeeze:
    """A current that could be tried; with ``shake_A`` it lets go again, as an `ExcitationRun` says."""

    current_A: float
    shake_A: float
    period_s: float
    durations_s: tuple[float, ...]  # for each of which it may be on; the least at first

    @property
    def least_s(self) -> float:
        """The shortest of the durations."""
        return self.durations_s[0]

    def of(self, run: Run) -> Run:
        """A run with this as its input."""
        if self.shake_A == 0.0:
            return replace(
                run, input_times_s=np.zeros(1), input_current_A=np.array([self.current_A])
            )
        halves = range(2 * LEAST_SHAKES)
        times_s = np.array([0.5 * self.period_s * half for half in halves])
        waves = [self.shake_A if half % 2 == 0 else -self.shake_A for half in halves]
        currents_A = np.array([self.current_A + wave for wave in waves])
        return replace(run, input_times_s=times_s, input_current_A=currents_A)


class SqueezesUntilSure(Chooser):
    """One block whose squeezes are chosen one by one; the runs of the sequence say which joint squeezes, and how far at most.

    Raises `ConfigurationError`: The sequence has no `until`, or no run of its own.
    """

    # the torque constant alone leaves +-9.9 %, so the last steps to 10 % are long
    least_share = 0.02
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
        beside_s = float(time_of(self.robot, self._sequence, pose)([start])[0])
        constant = [_Squeeze(each, 0.0, 0.0, DURATIONS_S) for each in self._currents()]
        forecast = self._forecast(self._fit, self._runs_of(constant, start))
        pushes = self._promised(constant, forecast, start, beside_s)
        letting_go = self._letting_go(constant, forecast)
        if letting_go:
            forecast = self._forecast(self._fit, self._runs_of(letting_go, start))
            pushes += self._promised(letting_go, forecast, start, beside_s)
        return best_first(pushes, target_std)

    def _runs_of(
        self, squeezes: Sequence[_Squeeze], start: Mapping[str, float]
    ) -> list[PreparedRun]:
        """As long as the longest of them, standing still."""
        longest_s = max(max(squeeze.durations_s) for squeeze in squeezes)
        still = prepare_run(
            self.robot,
            still_run(self._first.joint, start, squeezes[0].current_A, longest_s),
            KnownLoad(),
            past_fast=True,
        )
        return [replace(still, run=squeeze.of(still.run)) for squeeze in squeezes]

    def _letting_go(self, constant: Sequence[_Squeeze], forecast: Forecast) -> list[_Squeeze]:
        """Squeezes that let go once the fingers have come some of their way, and not so far that they run on to its end."""
        found = []
        for row, squeeze in enumerate(constant):
            for pressed_s in PRESSED_S:
                last = forecast.samples_in(row, pressed_s)
                travel_m = abs(forecast.travel[row, last - 1]) if last else 0.0
                if not LETS_GO[0] <= travel_m / self._farthest_m <= LETS_GO[1]:
                    continue
                mean_A = 0.5 * (squeeze.current_A + np.copysign(HOLDING_A, squeeze.current_A))
                period_s = 2.0 * pressed_s
                durations_s = (LEAST_SHAKES * period_s,)
                found.append(_Squeeze(mean_A, squeeze.current_A - mean_A, period_s, durations_s))
        return found

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
        """The samples up to which a squeeze stays inside the limits; it ends at the one where it is seen to have gone too far.

        Of a squeeze that is `thrown_back` none is left.
        """
        drive = self._usable[0].drive
        transmission = drive.transmission
        close_enough = np.abs(away) * abs(transmission) < self._farthest_m
        holds = np.isfinite(away) & np.isfinite(slopes).all(axis=2) & (np.abs(velocity) < FASTEST)
        holds[:, 1:] &= close_enough[:, :-1]
        alive = until_broken(holds)
        alive[thrown_back(velocity, alive, drive)] = False
        return alive

    def _promised(
        self,
        squeezes: Sequence[_Squeeze],
        forecast: Forecast,
        start: dict[str, float],
        beside_s: float,
    ) -> list[Push]:
        """Squeezes from one start, with every duration in which the fingers move far enough."""
        place = self._shared.at["youngs_modulus"]
        now = self._covariance[place, place]
        pushes: list[Push] = []
        for c, squeeze in enumerate(squeezes):
            for duration in squeeze.durations_s:
                last = forecast.samples_in(c, duration)
                if last < MIN_USED:
                    continue
                ends_s = float(forecast.times_s[last - 1])
                # what its travel ends before is the same push
                if duration > squeeze.least_s and ends_s <= squeeze.least_s:
                    continue
                travel = forecast.farthest(c, last)
                if abs(travel) < self._first.min_travel:
                    continue
                std = float(forecast.stds[c, last - 1])
                seconds = beside_s + ends_s
                gain = gain_per_s(now, max(std**2, 1e-6 * now), seconds)
                pushes.append(
                    Push(
                        self._first.joint,
                        start,
                        squeeze.current_A,
                        squeeze.shake_A,
                        duration,
                        seconds,
                        std,
                        gain,
                        travel,
                    )
                )
        return pushes

    def run_of(self, push: Push) -> ExcitationRun:
        start = {push.joint: push.start[push.joint]}
        run = replace(
            self._first,
            max_travel=self._farthest_m,
            raise_by=RAISE_BY,
            current_A=push.current_A,
            duration_s=push.duration_s,
            start=start,
        )
        if push.shake_A == 0.0:
            return replace(run, max_current_A=self._limit_A)
        period_s = push.duration_s / LEAST_SHAKES
        return replace(run, max_current_A=None, shake_A=push.shake_A, shake_period_s=period_s)

    def sequence_of(self, run: ExcitationRun) -> ExcitationSequence:
        """A sequence of one squeeze, after which the fingers let go."""
        return replace(
            alone(self._sequence, run),
            from_here=(),
            home=dict(run.start),
        )


def thrown_back(velocity: np.ndarray, alive: np.ndarray, drive: DriveTrain) -> np.ndarray:
    """Which squeezes a stiff block throws back faster than the supply turns the motor, shape (C,).

    The block drives the motor then, and no law here says which current flows.

    Args:
        velocity: Of the motor's shaft [rad/s], shape (C, T).
        alive: Which samples will be recorded, shape (C, T).
        drive: Of the gripper; a supply of 0 V limits nothing.
    """
    back_V = drive.back_emf_V_s_per_rad * np.abs(velocity)
    if drive.supply_voltage_V == 0.0:
        return np.zeros(len(velocity), bool)
    return np.asarray((alive & (back_V > drive.supply_voltage_V)).any(axis=1))


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
