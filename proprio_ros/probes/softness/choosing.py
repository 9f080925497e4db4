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
from proprio_ros.experiment_design.predicted_precision import SharedUnknowns
from proprio_ros.experiment_design.sequential import FASTEST
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.gates import MIN_USED, UNMOVED_RAD
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.softness.identify import SqueezeOptions, SqueezeSearch, fit_squeezes
from proprio_ros.probes.softness.problem import BlockFacts
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
        self._facts, self._options = facts, options
        self._first = sequence.runs[0]
        self._farthest_m = max(run.max_travel for run in sequence.runs)
        stated = [run.max_current_A for run in sequence.runs if run.max_current_A is not None]
        self._limit_A = min(
            [robot.motors[self._first.joint].current_limit_A, *([max(stated)] if stated else [])]
        )
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
        drive = self._usable[0].drive
        towards = float(np.sign(self._first.current_A))
        rubs_A = (drive.coulomb.value + 0.5 * drive.coulomb.std) / drive.torque_constant.value
        least = min(
            max(LEAST_BEYOND * rubs_A, 0.5 * abs(self._first.current_A)),
            self._limit_A,
        )
        currents = [
            towards * size
            for size in np.geomspace(least, self._limit_A, CURRENTS).round(3).tolist()
        ]
        longest_s = max(DURATIONS_S)
        still = prepare_run(
            self.robot,
            still_run(
                joint,
                start,
                currents[0],
                longest_s,
            ),
            KnownLoad(),
            past_fast=True,
        )
        made = [
            replace(still, run=replace(still.run, input_current_A=np.array([current])))
            for current in currents
        ]
        seconds = float(time_of(self.robot, self._sequence, pose)([start])[0])
        return best_first(self._promised(currents, made, start, seconds), target_std)

    def _promised(
        self,
        currents: Sequence[float],
        runs: Sequence[PreparedRun],
        start: dict[str, float],
        beside_s: float,
    ) -> list[Push]:
        """What squeezes from one start would tell of the modulus, each with every duration in which the fingers move far enough."""
        fit = self._fit
        robot = self.robot
        facts = self._facts
        options = self._options
        assert fit is not None
        problem = SqueezeSearch(robot, tuple(runs), (True,) * len(runs), facts, options).problem(
            Role.FREE
        )
        found = list(zip(fit.problem.unknowns, fit.values.tolist(), strict=True))
        gap = float(np.mean([value for unknown, value in found if unknown.kind == "gap"]))
        known = {unknown.key: value for unknown, value in found if unknown.shared}
        values = np.array(
            [gap if u.kind == "gap" else known.get(u.key, u.value) for u in problem.unknowns]
        )
        with np.errstate(over="ignore", invalid="ignore"):
            q, v, dq = problem.simulate(values[None], problem.free)
        q = q[0]
        v = v[0]
        dq = dq[0]
        drive = runs[0].drive
        rest = runs[0].rest.value
        per_rad = abs(drive.transmission)
        travel = np.abs(q - rest) * per_rad
        alive = np.isfinite(q) & np.isfinite(dq).all(axis=2) & (np.abs(v) < FASTEST)
        # it ends at the sample where it is seen to have gone so far
        alive &= np.concatenate(
            [
                np.ones((len(runs), 1), bool),
                travel[:, :-1] < self._farthest_m,
            ],
            axis=1,
        )
        alive = np.cumprod(alive, axis=1).astype(bool)
        sigma = np.hypot(
            runs[0].sigma[0],
            np.where(alive, np.abs(v), 0.0) * robot.stamp_jitter_s,
        )
        times = runs[0].times_s
        columns, variance = self._shared.columns_of(problem)
        at = np.searchsorted(problem.free, columns)
        rows = np.stack([dq[run][:, own] for run, own in enumerate(at)])
        rows = np.where(
            alive[..., None],
            rows / sigma[..., None],
            0.0,
        )
        stds, _ = self._shared.stds_along(rows, variance, self._covariance, "youngs_modulus")
        place = self._shared.at["youngs_modulus"]
        now = self._covariance[place, place]
        pushes: list[Push] = []
        for duration in DURATIONS_S:
            for c, current in enumerate(currents):
                last = min(
                    int(np.searchsorted(times, duration + 1e-9)),
                    int(alive[c].sum()),
                )
                # what its travel ends before is the same push
                if last < MIN_USED or (
                    duration > DURATIONS_S[0] and times[last - 1] <= DURATIONS_S[0]
                ):
                    continue
                gone = (q[c, :last] - rest) * drive.transmission
                if np.abs(gone).max() < self._first.min_travel:
                    continue
                lasts = beside_s + float(times[last - 1])
                std = float(stds[c, last - 1])
                gain = 0.5 * float(np.log(now / max(std**2, 1e-6 * now))) / lasts
                ends = float(gone[np.argmax(np.abs(gone))])
                pushes.append(
                    Push(
                        self._first.joint,
                        start,
                        current,
                        0.0,
                        duration,
                        lasts,
                        std,
                        gain,
                        ends,
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
