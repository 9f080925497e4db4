"""Weigh a sphere until sure: the pushes of a container, chosen one by one. No ROS here.

After each push all runs so far are fitted together with those of the empty container: robot, shell and sphere. What could be
pushed next is found in two stages. The rigid catalogue, with shell and sphere as one load, says which pushes stay inside all limits
and which of them promise much. In the best of these, as far as the sphere leaves the end in which it rests, it is simulated, all in
one launch, and linearised. A sample counts as long as those up to it tell where the sphere is: after that its bounces are chaos,
and a linearisation that follows them promises the more the less it can be trusted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from proprio_ros.excitation.plans import LEAST_SHAKES, ExcitationSequence
from proprio_ros.experiment_design import candidates
from proprio_ros.experiment_design.choosing import Found, passes, time_of
from proprio_ros.experiment_design.forecast import Forecast, gain_per_s, until_broken, whitened
from proprio_ros.experiment_design.predicted_precision import SharedUnknowns
from proprio_ros.experiment_design.sequential import (
    DURATIONS_S,
    MAX_TRAVEL,
    SHAKE_PERIOD_S,
    UNKNOWN_STD_KG,
    Catalogue,
    Known,
)
from proprio_ros.experiment_design.until import CatalogueChooser
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.gates import LITTLE_TRAVEL, MIN_USED, unusable
from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container.identify import STILL_M
from proprio_ros.probes.container.problem import (
    LEVEL,
    ContainerFacts,
    ContainerProblem,
    sphere_run,
    start_prior,
)
from proprio_ros.probes.container.search import (
    ContainerOptions,
    SphereSearch,
    check_shell,
    fit_empty,
    known_until,
    lost_at,
)
from proprio_ros.quantity import Sought
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import bent_pose
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.sphere import SphereRun

STARTS = 8
"""Start positions of the driven joint: finer than for a rigid load, since the sphere is to leave its end early in a push."""
SIMULATED = 40  # pushes in which the sphere is simulated
TILT_MARGIN = LEVEL
"""rad, beyond that slope: an arm that stands so far off still has the sphere at rest in the same end, and in time."""
# the sphere leaves its end where it would come to rest this share of its least room away
ROLLED_SHARE = 0.5


class _Simulated(NamedTuple):
    """What C pushes would show, as `ContainerProblem.predict` gives it."""

    q: np.ndarray  # of the joint [rad], (C, T)
    v: np.ndarray  # of the joint [rad/s], (C, T)
    dq: np.ndarray  # by F unknowns, (C, T, F)
    x: np.ndarray  # of the sphere in the container [m], (C, T, 3)
    dx: np.ndarray  # by the same, (C, T, 3, F)


@dataclass(frozen=True)
class _SphereForecast(Forecast):
    """Of a joint, in rad, and of the sphere that it moves."""

    rolled: np.ndarray  # how far the sphere is from its start [m], (C, T)
    predictable: np.ndarray  # how many samples there are until its place is lost, (C,)

    def is_worth_looking_at(self, n: int, push: candidates.Push, duration_s: float) -> bool:
        """Whether a push of such a duration is another one than a shorter one, and moves joint and sphere.

        Args:
            n: Of the C pushes.
            push: The same.
            duration_s: Of its current [s].
        """
        least = np.searchsorted(self.times_s, duration_s - 0.15)
        ends_before = duration_s > DURATIONS_S[0] and self.counted[n] < least
        if ends_before or (push.shake_A and duration_s < LEAST_SHAKES * SHAKE_PERIOD_S):
            return False
        samples = self.samples_in(n, duration_s)
        rolls = self.rolled[n, :samples].max() >= STILL_M
        return bool(rolls and abs(self.farthest(n, samples)) >= LITTLE_TRAVEL)

    def std_after(self, n: int, samples: int) -> float:
        """Of the sphere's mass after the first samples of a push, of which those count that come before its place is lost [kg]."""
        last = min(samples, int(self.predictable[n])) - 1
        return float(self.stds[n, last])


class SphereUntilSure(CatalogueChooser):
    """One weighing of a sphere whose pushes are chosen one by one; the catalogue has shell and sphere as one rigid load.

    Raises:
        ConfigurationError: The sequence has no `until`, or neither a baseline nor the shell's mass is given.
        RecordingError: A run of the baseline cannot be related to the robot at all.
    """

    def __init__(
        self,
        robot: Robot,
        facts: ContainerFacts,
        options: ContainerOptions,
        sequence: ExcitationSequence,
        baseline: Sequence[Run] = (),
        whole: Callable[[Sequence[Run]], float | None] | None = None,
    ) -> None:
        super().__init__(
            robot,
            sequence,
            Sought("sphere_mass", "kg", label="sphere's mass"),
            whole,
        )
        check_shell(facts, baseline)
        # of each joint in each pose of the others
        self._turning: dict[tuple[object, ...], SphereRun] = {}
        # where it comes to rest, whatever is stated about where it was in the sample recordings
        self._resting = replace(facts, start=None, settled=True)
        joints = candidates.candidate_joints(robot)
        search = SphereSearch(robot, facts, options)
        for prepared in [prepare_run(robot, run, None, facts.shell) for run in baseline]:
            if not unusable(prepared):
                search = search.added(prepared, False)
        weighed = fit_empty(robot, search.runs, facts, options) if search.runs else None
        if weighed is not None:
            facts = replace(facts, mass=weighed.value_of("payload_mass"))
        self._search = replace(search, facts=facts)
        self._before_any_run(joints)
        if weighed is not None:
            self._believe(weighed)
        self._fit: FitResult | None = None
        self._taken = 0
        self.catalogue = Catalogue(robot, facts.shell, joints, STARTS, self._can_roll)
        # a rigid load is shell and sphere together
        self._as_rigid = np.eye(len(self._shared.keys))[
            [self._shared.at[key] for key in self.catalogue.keys]
        ]
        self._as_rigid[self.catalogue.at["payload_mass"], self._shared.at["sphere_mass"]] = 1.0
        self._found = Found(float(np.mean(self._unknown_kg)), UNKNOWN_STD_KG)

    def _before_any_run(self, joints: Sequence[str]) -> None:
        """The unknowns that all pushes of these joints share, and their priors."""
        robot = self.robot
        rest = bent_pose(robot)
        shell = self._search.facts.shell
        longest_s = max(DURATIONS_S)
        still = [candidates.still_run(joint, rest, 0.01, longest_s) for joint in joints]
        every = self._problem([prepare_run(robot, run, None, shell) for run in still])
        self._shared = SharedUnknowns(every)
        # what is not known at all leaves nothing to be inverted
        for mass in ("payload_mass", "sphere_mass"):
            at = self._shared.at[mass]
            self._shared.prior[at, at] += UNKNOWN_STD_KG**-2
        rows = [every.index[key] for key in self._shared.keys]
        self._values = dict(zip(self._shared.keys, every.base[rows].tolist(), strict=True))
        for joint in joints:
            self._values["coulomb", joint] = candidates.expected_coulomb(every, joint)
        self._covariance = np.linalg.inv(self._shared.prior)

    def learn(self, runs: Sequence[Run]) -> Found:
        new = [
            prepare_run(self.robot, run, None, self._search.facts.shell)
            for run in runs[self._taken :]
        ]
        self._taken = len(runs)
        usable = [run for run in new if not unusable(run)]
        for run in usable:
            self._search = self._search.added(run, True)
        if usable:
            self._fit = self._fitted(self._fit)
            self._cut_what_is_lost()
        if self._fit is None:
            return replace(self._found, runs=0)
        self._believe(self._fit)
        at = self._shared.at["sphere_mass"]
        mass = self._values["sphere_mass"]
        std = float(np.sqrt(self._covariance[at, at]))
        return Found(mass, std, sum(self._search.rolling), self._fit.reduced_chi2)

    def _fitted(self, before: FitResult | None) -> FitResult:
        """All runs together, from where those before ended."""
        if before is not None:
            fit = self._search.solve(Role.ESTIMATED, before, rough=True)
            if fit.explains or not before.explains:
                return fit
        # the first run, or one that shows that the valley found so far was a wrong one
        _, whole = self._search.fits()
        return whole if before is None or whole.chi2 < fit.chi2 else fit

    def _cut_what_is_lost(self) -> None:
        """Leave out what comes after the sphere's place is lost."""
        assert self._fit is not None
        cut = lost_at(self._fit)
        if not cut:
            return
        self._search, lost = self._search.before_lost(cut)
        if not any(self._search.rolling):
            self._fit = None
        else:  # runs have moved up where some were lost, so that what was their own is no start
            self._fit = self._fitted(None if lost else self._fit)

    def _believe(self, fit: FitResult) -> None:
        index = fit.problem.index
        for key in self._shared.keys:
            if key in index:
                self._values[key] = float(fit.values[index[key]])
        self._covariance = self._shared.covariance_after(fit)

    def ranked(
        self,
        pose: Mapping[str, float],
        target_std: float,
    ) -> list[candidates.Push]:
        beside = time_of(self.robot, self._sequence, pose)
        low, high = self._unknown_kg
        sphere = self._found.value if self._found.runs else float(np.mean((low, high)))
        shell = self._values["payload_mass"]
        ranked = self.catalogue.rank(
            self._known_as_rigid(shell + sphere),
            beside,
            target_std,
            (shell + low, shell + high),
            durations_s=DURATIONS_S[-1:],
        )
        chosen: list[candidates.Push] = []
        blocked: list[candidates.Push] = []
        ways: dict[tuple[object, ...], bool] = {}
        for push in ranked:
            if not self._rolls(push):
                continue
            begins = (push.joint, *push.start.values())
            if begins not in ways:  # from a folded arm there are few
                ways[begins] = passes(
                    self._machine,
                    self.sequence_of(self.run_of(push)),
                    pose,
                )
            (chosen if ways[begins] else blocked).append(push)
            if len(chosen) == SIMULATED:
                break
        if not chosen:
            return blocked
        return candidates.best_first(self.promised(chosen, sphere, beside), target_std)

    def _known_as_rigid(self, mass: float) -> Known:
        """What is known, with shell and sphere as one rigid load of so much [kg], of which the sphere is sought."""
        at = self._shared.at["sphere_mass"]
        across = self._as_rigid @ self._covariance[:, at]
        return Known(
            mass,
            self._found.std,
            self._as_rigid @ self._covariance @ self._as_rigid.T,
            self._found.runs,
            towards=(across, float(self._covariance[at, at])),
        )

    def promised(
        self, pushes: Sequence[candidates.Push], sphere_kg: float, time_beside: candidates.TimeOf
    ) -> list[candidates.Push]:
        """Pushes of the catalogue, with every duration in which joint and sphere move far enough.

        Args:
            pushes: To be simulated.
            sphere_kg: What the sphere is taken to weigh [kg].
            time_beside: How long a push takes beside itself, as in `Catalogue.rank`.

        Returns:
            With what each would tell of the sphere's mass.
        """
        forecast = self._forecast(pushes, sphere_kg)
        at = self._shared.at["sphere_mass"]
        now = self._covariance[at, at]
        beside_s = time_beside([push.start for push in pushes])
        found: list[candidates.Push] = []
        for n, push in enumerate(pushes):
            if forecast.predictable[n] < MIN_USED:
                continue
            for duration in DURATIONS_S:
                if not forecast.is_worth_looking_at(n, push, duration):
                    continue
                last = forecast.samples_in(n, duration)
                std = forecast.std_after(n, last)
                seconds = float(beside_s[n] + forecast.times_s[last - 1])
                found.append(
                    replace(
                        push,
                        duration_s=duration,
                        time_s=seconds,
                        std=std,
                        gain=gain_per_s(now, max(std**2, 1e-12), seconds),
                        travel=forecast.farthest(n, last),
                    )
                )
        return found

    def _forecast(self, pushes: Sequence[candidates.Push], sphere_kg: float) -> _SphereForecast:
        """What pushes would show with a sphere of such a mass [kg], all in one launch."""
        problem = self._problem([self.catalogue.standing(push) for push in pushes])
        columns, variance = self._shared.columns_of(problem)
        seen = self._simulated(problem, columns, sphere_kg)
        off = seen.q - np.array([run.rest.value for run in problem.runs])[:, None]
        fastest = np.array([run.drive.usable_velocity for run in problem.runs])
        alive = until_broken(_usable(seen, off, fastest[:, None]))
        reading_std = np.array([run.sigma[0] for run in problem.runs])
        rows = whitened(seen.dq, seen.v, alive, reading_std, self.robot.stamp_jitter_s)
        # what the container sees of the sphere across the joint's axis, (C, 3, 3)
        across = np.array([run.across for run in problem.simulator.special.sphere_runs])
        places = np.where(alive[..., None, None], across[:, None] @ seen.dx, 0.0)
        stds, spreads = self._shared.stds_along(
            rows, variance, self._covariance, "sphere_mass", places
        )
        counted = alive.sum(axis=1)
        facts = self._search.facts
        moved = np.einsum("rij,rtj->rti", across, seen.x - seen.x[:, :1])
        return _SphereForecast(
            self.catalogue.still(pushes[0]).times_s,
            off,
            counted,
            stds,
            np.linalg.norm(moved, axis=2),
            np.minimum([known_until(each, facts) for each in spreads], counted),
        )

    def _simulated(
        self, problem: ContainerProblem, columns: np.ndarray, sphere_kg: float
    ) -> _Simulated:
        """Joint and sphere at the values found so far, by the unknowns that matter to each run."""
        known = self._values | {"sphere_mass": sphere_kg}
        unknowns = problem.unknowns
        values = np.array([known.get(unknown.key, unknown.value) for unknown in unknowns])
        seen = _Simulated(*problem.predict(values, columns))
        # of joints that none of the runs drives
        lacks = [place for place, key in enumerate(self._shared.keys) if key not in problem.index]
        seen.dq[..., lacks] = 0.0
        seen.dx[..., lacks] = 0.0
        return seen

    def _problem(self, runs: Sequence[PreparedRun]) -> ContainerProblem:
        """Runs that have not been made as a problem."""
        every = (True,) * len(runs)
        search = replace(
            self._search,
            runs=tuple(runs),
            rolling=every,
            tracks=(None,) * len(runs),
        )
        return search.problem(Role.ESTIMATED)[0]

    def _geometry(self, run: PreparedRun) -> SphereRun:
        key = run.run.joint, tuple(run.run.held.items())
        if key not in self._turning:
            nothing = JointRun(run.times_s, np.zeros(1), np.zeros(1))
            self._turning[key] = sphere_run(self.robot, run, self._resting, nothing)
        return self._turning[key]

    def _can_roll(self, still: PreparedRun, position: float) -> bool:
        """Whether the sphere rests in a known end where the joint stands, and a push can roll it out of there."""
        run = self._geometry(still)
        tilted = [
            start_prior(run, self._resting, position + tilt)
            for tilt in (-TILT_MARGIN, 0.0, TILT_MARGIN)
        ]
        if any(len(prior.guesses) > 1 for prior in tilted):
            return False
        if self._apart(run, position - TILT_MARGIN, position + TILT_MARGIN):
            return False
        return any(
            self._apart(run, position, position + travel) for travel in (-MAX_TRAVEL, MAX_TRAVEL)
        )

    def _rolls(self, push: candidates.Push) -> bool:
        """Whether a push turns the container so far that the sphere leaves the end in which it rests."""
        still = self.catalogue.still(push)
        return self._apart(
            self._geometry(still),
            still.rest.value,
            still.rest.value + push.travel,
        )

    def _apart(self, run: SphereRun, one: float, other: float) -> bool:
        """Whether the sphere comes to rest elsewhere with the joint at another position."""
        places = [start_prior(run, self._resting, position).mean for position in (one, other)]
        moved = float(np.linalg.norm(run.across @ (places[1] - places[0])))
        return moved > ROLLED_SHARE * float(self._search.facts.enclosure.room.min())


def _usable(seen: _Simulated, off: np.ndarray, fastest: np.ndarray) -> np.ndarray:
    """Where joint and sphere are known, and the joint neither too fast nor too far, shape (C, T).

    Args:
        seen: Joint and sphere.
        off: How far joints have moved [rad or m], shape (C, T).
        fastest: Speeds that joints may have [rad/s or m/s], shape (C, 1).
    """
    known = np.isfinite(seen.q) & np.isfinite(seen.x).all(axis=2)
    return known & (np.abs(seen.v) < fastest) & (np.abs(off) < MAX_TRAVEL)
