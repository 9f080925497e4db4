"""The next push, chosen by what is known after those before: sequential design of a weighing.

What the runs so far say of object and robot is one Gaussian, as every weighing has it. A catalogue of pushes (start poses, joints,
currents, square waves, durations) is simulated at the mass found so far, all in one launch, and linearised; what each would take
from the variance of the mass follows in closed form. The push with the largest expected gain of information about the mass per
second is the next (Chaloner & Verdinelli 1995, Statistical Science 10(3), on D_s-optimality; one step ahead), time on the way
included.

An expected gain depends on where the arm is pushed, not on what came out there, so that stopping by it does not select for
small errors (in a linear Gaussian model the width of an interval is independent of its error; Berger & Wolpert 1988, sec. 4.2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from proprio_ros.experiment_design.candidates import (
    CLEARANCE_M,
    LIMIT_MARGIN,
    PUSHES,
    Push,
    TimeOf,
    best_first,
    candidate_joints,
    currents_beyond,
    expected_coulomb,
    locked_poses,
    start_positions,
    still_run,
)
from proprio_ros.experiment_design.forecast import until_broken, whitened
from proprio_ros.experiment_design.predicted_precision import (
    SharedUnknowns,
)
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    solve_load,
)
from proprio_ros.identification.gates import (
    LITTLE_TRAVEL,
    MIN_USED,
    unusable,
)
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    prepare_run,
)
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import (
    PAYLOAD_TERMS,
    load_unknowns,
)
from proprio_ros.identification.run_kinds import RIPPLE_TERMS
from proprio_ros.identification.unknowns import Role
from proprio_ros.quantity import Quantity
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import bent_pose, clearance
from proprio_ros.sim.joint import INDEX, JointRun, JointSimulator
from proprio_ros.sim.payload import PayloadFacts

STARTS, POSES = 6, 3
"""Start positions of a driven joint, and positions of each locked joint that matters, over their ranges."""
DURATIONS_S = (0.3, 0.5, 0.7)
SHAKE_PERIOD_S = 0.2
# amplitude of a square wave, as a part of the current beyond balance and friction
SHAKE_OF_PUSH = 0.5
MAX_TRAVEL = 0.6  # rad, at which a push ends
# the excitation's guards look so far ahead; what would end a run there is no candidate
LOOKAHEAD_S = 0.08
FASTEST = 5.5  # rad/s, below the speed at which the excitation ends a sequence
STEP_S = 1.0 / 120.0
UNKNOWN_KG = (
    0.0,
    0.12,
)  # what a hand may hold before anything is known
PATH_RAD = tuple(float(q) for q in np.linspace(-1.05, 1.05, 8))
"""From a start, where the height above the base's plane is looked at."""
UNKNOWN_STD_KG = 0.1
OWN = ("q0", "v0", "onset", "disturbance")
WORTH = 0.1  # a push that promises less than this part of what is missing is not made


@dataclass(frozen=True)
class Known:
    """What the runs so far say."""

    mass: float  # of the object [kg]
    std: float  # of the mass; before any run `UNKNOWN_STD_KG`
    covariance: np.ndarray  # of all shared unknowns of a catalogue and the mass, shape (F, F)
    runs: int  # that could be used
    fit: FitResult | None = None  # of them
    prepared: tuple[PreparedRun, ...] = ()  # all runs, as the fit takes them
    # where a part of the mass is sought, the covariance of that part with all unknowns, shape (F,), and its variance
    # [kg^2]; None: all of the mass is sought
    towards: tuple[np.ndarray, float] | None = None


@dataclass(frozen=True)
class _Place:
    """Where pushes begin, and the simulator's parameters as they follow from the mass."""

    prepared: PreparedRun
    start: dict[str, float]  # of all joints
    p: np.ndarray  # with nothing in the hand, shape (P,)
    p_per_kg: np.ndarray
    dp: np.ndarray  # by the shared unknowns, then the run's own, shape (P, F + 4)
    dp_per_kg: np.ndarray
    own_variance: np.ndarray  # of the run's own unknowns, shape (4,)
    heights: np.ndarray  # above the base's plane along `PATH_RAD` [m]

    def lowest_m(self, reach: np.ndarray) -> float:
        """The lowest point between two ends (2,) [rad from the start]: there, and where the height was looked at between them."""
        off = np.array(PATH_RAD)
        passed = (off > reach[0]) & (off < reach[1])
        between = np.where(passed, self.heights, np.inf)
        at_ends = np.interp(reach, PATH_RAD, self.heights)
        return min(float(between.min()), float(at_ends.min()))


@dataclass(frozen=True)
class _Excursion:
    """Where C pushes take their joint until they end, with as much ahead as the excitation's guards look."""

    low: np.ndarray  # lowest and highest position, (C,) [rad]
    high: np.ndarray
    fastest: np.ndarray  # (C,) [rad/s]
    travel: np.ndarray  # farthest from the start, (C,) [rad]
    samples: np.ndarray  # (C,)

    @classmethod
    def of(cls, start: np.ndarray, q: np.ndarray, v: np.ndarray) -> _Excursion:
        """From simulated pushes; what is no number goes far.

        Args:
            start: Where the joint begins, shape (C,) [rad].
            q: Positions, shape (C, T) [rad].
            v: Velocities, shape (C, T) [rad/s].

        Returns:
            What each push reaches until it is as far from its start as the guards let it go.
        """
        q = np.where(np.isfinite(q), q, 1e3)
        v = np.where(np.isfinite(v), v, 1e3)
        off = q - start[:, None]
        # until it has gone so far, and the sample at which that is seen
        before = np.ones((len(start), 1), bool)
        near = np.abs(off) < MAX_TRAVEL
        under_way = np.concatenate([before, near[:, :-1]], axis=1)
        under_way = np.cumprod(under_way, axis=1).astype(bool)
        ahead = np.where(
            under_way,
            q + v * LOOKAHEAD_S,
            start[:, None],
        )
        here = np.where(under_way, q, start[:, None])
        return cls(
            np.minimum(ahead, here).min(axis=1),
            np.maximum(ahead, here).max(axis=1),
            np.where(under_way, np.abs(v), 0.0).max(axis=1),
            np.abs(np.where(under_way, off, 0.0)).max(axis=1),
            under_way.sum(axis=1),
        )


class _Candidate(NamedTuple):
    """A push of a catalogue before anything is known of it: from where, with which current and square wave [A]."""

    place: _Place
    current_A: float
    shake_A: float


class _Rows(NamedTuple):
    """What the encoder would show of C pushes."""

    shared: np.ndarray  # whitened sensitivities by the shared unknowns, shape (C, T, F)
    own: np.ndarray  # the same by the run's own in units of their priors, shape (C, T, 4)
    times_s: np.ndarray  # of the samples, shape (T,)
    counted: np.ndarray  # how many of them count, shape (C,)
    travel: np.ndarray  # how far the joint goes meanwhile [rad], shape (C,)


class Catalogue:
    """All pushes of a robot with an object in its hand, prepared once; see `Catalogue.rank`.

    Joints may be driven that carry the hand against gravity, or those named, from so many positions over their range;
    ``suits`` says whether a push may begin where the driven joint stands at a position [rad] in the pose of a run.
    """

    def __init__(
        self,
        robot: Robot,
        facts: PayloadFacts | None = None,
        joints: Sequence[str] | None = None,
        starts: int = STARTS,
        suits: Callable[[PreparedRun, float], bool] | None = None,
    ) -> None:
        self.robot = robot
        self.facts = facts or PayloadFacts()
        self._starts = starts
        self._suits = suits
        self.joints = tuple(joints or candidate_joints(robot))
        rest = bent_pose(robot)
        first = [self._still(joint, rest) for joint in self.joints]
        every = Problem(
            robot,
            first,
            self.facts,
            self._unknowns(first),
        )
        self._shared = SharedUnknowns(every)
        self.keys = self._shared.keys
        self.at = self._shared.at
        mass = self.at["payload_mass"]
        self._shared.prior[mass, mass] += UNKNOWN_STD_KG**-2
        self._places = [place for joint in self.joints for place in self._places_of(joint)]

    def _unknowns(self, runs: Sequence[PreparedRun]) -> list:
        return load_unknowns(
            self.robot,
            runs,
            self.facts,
            Role.ESTIMATED,
            0.03,
        )

    def _still(self, joint: str, pose: Mapping[str, float]) -> PreparedRun:
        return prepare_run(
            self.robot,
            still_run(
                joint,
                pose,
                0.01,
                max(DURATIONS_S),
            ),
            None,
            self.facts,
        )

    def _places_of(self, joint: str) -> list[_Place]:
        found: list[_Place] = []
        for pose in locked_poses(self.robot, joint, POSES):
            starts = start_positions(self.robot, joint, self._starts)
            clear = {q: clearance(self.robot, pose | {joint: q}) for q in starts}
            starts = [q for q in starts if clear[q] >= CLEARANCE_M]
            if starts:
                still = self._still(joint, pose | {joint: starts[0]})
                starts = [q for q in starts if self._suits is None or self._suits(still, q)]
            if starts:
                found += self._places_from(still, pose, starts)
        return found

    def _places_from(
        self,
        still: PreparedRun,
        pose: dict[str, float],
        starts: Sequence[float],
    ) -> list[_Place]:
        """Of one joint in one pose of the others."""
        runs = [_standing_at(still, q) for q in starts]
        joint = still.run.joint
        problem = Problem(
            self.robot,
            runs,
            self.facts,
            self._unknowns(runs),
        )
        values = np.tile(problem.base, (2, 1))
        values[:, problem.index["payload_mass"]] = 0.0, 1.0
        values[:, problem.index["coulomb", joint]] = expected_coulomb(problem, joint)
        found = []
        for row, (run, q) in enumerate(zip(runs, starts, strict=True)):
            p, slopes = self._at_two_masses(problem, values, row)
            heights = [clearance(self.robot, {**pose, joint: q + off}) for off in PATH_RAD]
            own = [problem.unknowns[problem.index[kind, row]] for kind in OWN]
            found.append(
                _Place(
                    run,
                    {**pose, joint: q},
                    p[0],
                    p[1] - p[0],
                    slopes[0],
                    slopes[1] - slopes[0],
                    np.array([unknown.std**2 for unknown in own]),
                    np.array(heights),
                )
            )
        return found

    def _at_two_masses(
        self, problem: Problem, values: np.ndarray, row: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """A run's parameters (2, P) at two guesses (2, N), and their derivatives by shared unknowns and its own (2, P, F + 4)."""
        keys = [key for key in self.keys if key in problem.index]
        columns = [problem.index[key] for key in keys]
        columns += [problem.index[kind, row] for kind in OWN]
        p, dp = problem.parameters(values, np.array(columns))
        of_run = dp[:, row]
        slopes = np.zeros((2, p.shape[-1], len(self.keys) + len(OWN)))
        slopes[..., [self.at[key] for key in keys]] = of_run[..., : len(keys)]
        slopes[..., len(self.keys) :] = of_run[..., len(keys) :]
        return p[:, row], slopes

    def nothing_known(self) -> Known:
        """Before the first run."""
        return Known(
            0.5 * sum(UNKNOWN_KG),
            UNKNOWN_STD_KG,
            np.linalg.inv(self._shared.prior),
            0,
        )

    def known(
        self,
        runs: Sequence[Run],
        before: Known | None = None,
    ) -> Known:
        """What the runs so far say, robot and object together; the fit starts where that of the same ``before`` the last ended."""
        prepared = () if before is None else before.prepared
        prepared += tuple(
            prepare_run(self.robot, run, None, self.facts) for run in runs[len(prepared) :]
        )
        usable = [run for run in prepared if run.run.joint in self.joints and not unusable(run)]
        if not usable:
            return replace(self.nothing_known(), prepared=prepared)
        start = None
        if before is not None and before.fit is not None:
            start = replace(
                before.fit,
                values=before.fit.values_of(self._unknowns(usable)),
            )
        fit = solve_load(
            self.robot,
            usable,
            self.facts,
            SearchOptions(),
            Role.ESTIMATED,
            start=start,
            rough=True,
        )
        covariance = self._shared.covariance_after(fit)
        place = self.at["payload_mass"]
        std = float(np.sqrt(covariance[place, place]))
        return Known(
            fit.value_of("payload_mass"),
            std,
            covariance,
            len(usable),
            fit,
            prepared,
        )

    def predicted(
        self,
        known: Known,
        push: Push,
        load_kg: float | None = None,
    ) -> Known:
        """What would be known after a push of this catalogue, to first order; ``load_kg`` as in `rank`."""
        made = [_Candidate(self._place_of(push), push.current_A, push.shake_A)]
        mass = known.mass if load_kg is None else load_kg
        rows = self._rows(
            self._simulator(made),
            np.zeros(1, int),
            made,
            mass,
            load_kg is not None,
        )
        used = rows.times_s <= push.duration_s + 1e-9
        shared = rows.shared[0][used]
        own = rows.own[0][used]
        along = shared @ known.covariance
        noise = np.eye(int(used.sum()))
        within = along @ shared.T + own @ own.T + noise
        covariance = known.covariance - along.T @ np.linalg.solve(within, along)
        at = self.at["payload_mass"]
        std = float(np.sqrt(max(covariance[at, at], 0.0)))
        return replace(
            known,
            covariance=covariance,
            std=std,
            runs=known.runs + 1,
        )

    def still(self, push: Push) -> PreparedRun:
        """Where a push of this catalogue begins, as a run in which nothing moves."""
        return self._place_of(push).prepared

    def standing(self, push: Push) -> PreparedRun:
        """The same with the current of the push, over the longest duration."""
        still = self.still(push)
        times_s, currents_A = _input_of(push.current_A, push.shake_A)
        return replace(
            still,
            run=replace(
                still.run,
                input_times_s=times_s,
                input_current_A=currents_A,
            ),
        )

    def _place_of(self, push: Push) -> _Place:
        return next(
            p for p in self._places if p.prepared.run.joint == push.joint and p.start == push.start
        )

    def rank(
        self,
        known: Known,
        time_of: TimeOf,
        target_std: float = 0.0,
        unknown_kg: tuple[float, float] = UNKNOWN_KG,
        load_kg: float | None = None,
        durations_s: Sequence[float] = DURATIONS_S,
    ) -> list[Push]:
        """Pushes inside all limits, best first.

        Args:
            known: So far.
            time_of: How long pushes take beside their durations.
            target_std: Of the mass [kg]; among pushes that reach it the quickest is best.
            unknown_kg: What the hand may hold while no run says it [kg].
            load_kg: What is known to be in the hand [kg]: pushes that tell of the robot, for the sake of a mass that `known` has
                been predicted to be weighed; None: the object.
            durations_s: Of `DURATIONS_S`, ascending.
        """
        if load_kg is not None:
            known = replace(known, mass=load_kg)
        low, high = (
            (
                known.mass - 2.0 * known.std,
                known.mass + 2.0 * known.std,
            )
            if known.runs
            else unknown_kg
        )
        low = max(low, 0.0) if load_kg is None else load_kg
        high = max(high, 1e-3) if load_kg is None else load_kg
        candidates = self._candidates(low, high)
        if not candidates:
            return []
        simulator = self._simulator(candidates)
        mean = float(np.clip(known.mass, low, high))
        fits = self._fitting(
            simulator,
            candidates,
            (low, high) if high - low > 0.004 else (mean,),
        )
        chosen = np.flatnonzero(fits)
        if not len(chosen):
            return []
        candidates = [candidates[c] for c in chosen]
        rows = self._rows(
            simulator,
            chosen,
            candidates,
            mean,
            load_kg is not None,
        )
        return best_first(
            self._scored(known, candidates, rows, time_of, durations_s),
            target_std,
        )

    def _candidates(self, low: float, high: float) -> list[_Candidate]:
        """All pushes that suit masses from low to high [kg]."""
        found = []
        for place in self._places:
            run = place.prepared
            limit = self.robot.motors[run.run.joint].current_limit_A
            constant = run.drive.torque_constant.value
            for push, current, largest in currents_beyond(run, self.facts, (low, high)):
                wave = round(SHAKE_OF_PUSH * push * largest / constant, 3)
                for shake in (0.0, wave) if push == PUSHES[-1] else (0.0,):
                    if (
                        abs(current) + shake <= limit
                        and min(
                            abs(current - shake),
                            abs(current + shake),
                        )
                        > 0.01
                    ):
                        found.append(_Candidate(place, current, shake))
        return found

    def _simulator(self, candidates: Sequence[_Candidate]) -> JointSimulator:
        runs = []
        for place, current, shake in candidates:
            drive = place.prepared.drive
            run = place.prepared.run
            times, given = _input_of(current, shake)
            friction = (
                drive.coulomb.value
                + drive.load_friction.value * abs(current) * drive.torque_constant.value
            )
            lightest = float(place.prepared.coefficients.arm[0]) + 0.5 * drive.armature.value
            fine = float(
                np.clip(
                    self.robot.friction_velocity * lightest / max(friction, 1e-6),
                    2e-4,
                    STEP_S,
                )
            )
            no_supply = 0.0, 0.0, 1.0
            runs.append(
                JointRun(
                    run.times_s,
                    times,
                    given,
                    no_supply,
                    self.robot.friction_velocity,
                    STEP_S,
                    fine,
                )
            )
        return JointSimulator(runs)

    def _fitting(
        self,
        simulator: JointSimulator,
        candidates: Sequence[_Candidate],
        masses: Sequence[float],
    ) -> np.ndarray:
        """Which pushes stay inside all limits with each of the masses, shape (C,)."""
        places = [each.place for each in candidates]
        start = np.array([place.prepared.rest.value for place in places])
        joints = [self.robot.model.joint(place.prepared.run.joint) for place in places]
        lower = np.array([joint.lower for joint in joints]) + LIMIT_MARGIN
        upper = np.array([joint.upper for joint in joints]) - LIMIT_MARGIN
        fits = np.ones(len(places), dtype=bool)
        reach = np.zeros((len(places), 2))  # from the start, with any of the masses
        worlds = np.arange(len(places), dtype=np.int32)
        no_tangents = np.zeros((len(places), len(INDEX), 1))
        for mass in masses:
            with np.errstate(over="ignore", invalid="ignore"):
                q, v, _ = simulator.jacobian(
                    worlds,
                    _parameters_at(places, mass),
                    no_tangents,
                )
            way = _Excursion.of(start, q, v)
            reach[:, 0] = np.minimum(reach[:, 0], way.low - start)
            reach[:, 1] = np.maximum(reach[:, 1], way.high - start)
            fits &= (way.low > lower) & (way.high < upper) & (way.fastest < FASTEST)
            fits &= (way.travel >= LITTLE_TRAVEL) & (way.samples >= 2 * MIN_USED)
        for row in np.flatnonzero(fits):
            fits[row] = places[row].lowest_m(reach[row]) >= CLEARANCE_M
        return fits

    def _rows(
        self,
        simulator: JointSimulator,
        worlds: np.ndarray,
        candidates: Sequence[_Candidate],
        mass: float,
        is_known: bool,
    ) -> _Rows:
        """Of candidates that are some of a simulator's worlds, with a mass in the hand [kg]."""
        places = [each.place for each in candidates]
        with np.errstate(over="ignore", invalid="ignore"):
            q, v, by_p = simulator.jacobian(
                worlds.astype(np.int32),
                _parameters_at(places, mass),
                np.tile(np.eye(len(INDEX)), (len(places), 1, 1)),
            )
        start = np.array([place.prepared.rest.value for place in places])
        off = q - start[:, None]
        usable = np.array([place.prepared.drive.usable_velocity for place in places])
        within = np.isfinite(q) & (np.abs(v) < usable[:, None]) & (np.abs(off) < MAX_TRAVEL)
        alive = until_broken(within)
        slopes = by_p @ np.array([place.dp + mass * place.dp_per_kg for place in places])
        self._add_ripples(slopes, places, q)
        reading = np.array([place.prepared.sigma[0] for place in places])
        slopes = whitened(slopes, v, alive, reading, self.robot.stamp_jitter_s)
        size = len(self.keys)
        if is_known:
            known = [at for key, at in self.at.items() if key in PAYLOAD_TERMS]
            slopes[..., known] = 0.0
        own_std = np.sqrt(np.array([place.own_variance for place in places]))
        return _Rows(
            slopes[..., :size],
            slopes[..., size:] * own_std[:, None, :],
            places[0].prepared.run.times_s,
            alive.sum(axis=1),
            _farthest(np.where(alive, off, 0.0)),
        )

    def _add_ripples(
        self,
        slopes: np.ndarray,
        places: Sequence[_Place],
        q: np.ndarray,
    ) -> None:
        """The encoder's once-per-turn error at positions (C, T) in sensitivities (C, T, F + 4), which change."""
        for row, place in enumerate(places):
            for kind, wave in zip(RIPPLE_TERMS, (np.cos, np.sin), strict=True):
                at = self.at.get((kind, place.prepared.run.joint))
                if at is not None:
                    slopes[row, :, at] += wave(q[row])

    def _scored(
        self,
        known: Known,
        candidates: Sequence[_Candidate],
        rows: _Rows,
        time_of: TimeOf,
        durations_s: Sequence[float],
    ) -> list[Push]:
        """What each candidate would tell of the mass, with every duration that its travel does not end before."""
        own = rows.own
        times = rows.times_s
        within = rows.shared @ known.covariance @ rows.shared.transpose(
            0, 2, 1
        ) + own @ own.transpose(0, 2, 1)
        mass = self.at["payload_mass"]
        across, now = known.towards or (
            known.covariance[:, mass],
            known.covariance[mass, mass],
        )
        pulled = rows.shared @ across
        beside = time_of([each.place.start for each in candidates])
        found: list[Push] = []
        for duration in durations_s:
            used = times <= duration + 1e-9
            block = within[:, used][:, :, used]
            after = _variance_after(now, block, pulled[:, used])
            # a push that travel ends before is the same push
            longer = rows.counted >= np.searchsorted(times, duration - 0.15)
            counts = np.isfinite(after) & (longer | (duration == durations_s[0]))
            lasts = np.minimum(
                rows.counted / max(len(times), 1) * times[-1],
                duration,
            )
            for c in np.flatnonzero(counts).tolist():
                seconds = float(beside[c] + lasts[c])
                found.append(
                    Push(
                        candidates[c].place.prepared.run.joint,
                        candidates[c].place.start,
                        float(candidates[c].current_A),
                        float(candidates[c].shake_A),
                        duration,
                        seconds,
                        float(np.sqrt(after[c])),
                        0.5 * float(np.log(now / after[c])) / seconds,
                        float(rows.travel[c]),
                    )
                )
        return found


def _farthest(off: np.ndarray) -> np.ndarray:
    """The largest of offsets (C, T) either way, with its sign, shape (C,)."""
    up = off.max(axis=1)
    down = off.min(axis=1)
    return np.where(up > -down, up, down)


def _parameters_at(places: Sequence[_Place], mass: float) -> np.ndarray:
    """The simulator's parameters with a mass [kg] in the hand, shape (C, P)."""
    return np.array([place.p + mass * place.p_per_kg for place in places])


def _variance_after(now: float, within: np.ndarray, pulled: np.ndarray) -> np.ndarray:
    """Variance of the mass after each of C pushes, by the rule of a linear Gaussian model.

    Args:
        now: Before them [kg^2].
        within: Covariance of the whitened samples without their own noise, shape (C, T, T).
        pulled: Covariance of the samples with the mass, shape (C, T).
    """
    block = within + np.eye(within.shape[1])
    taken = np.einsum(
        "ct,ct->c",
        pulled,
        np.linalg.solve(block, pulled[..., None])[..., 0],
    )
    return np.maximum(now - taken, 1e-12)


def _standing_at(still: PreparedRun, position: float) -> PreparedRun:
    """The same run with the driven joint elsewhere [rad]."""
    elsewhere = {
        name: np.full_like(getattr(still.run, name), position)
        for name in ("position", "before_position")
    }
    return replace(
        still,
        run=replace(still.run, **elsewhere),
        rest=Quantity(position, still.rest.std),
    )


def _input_of(
    current_A: float,
    shake_A: float,
) -> tuple[np.ndarray, np.ndarray]:
    """When the current of a push changes [s], and to what [A]."""
    if not shake_A:
        return np.zeros(1), np.array([current_A])
    times_s = np.arange(0.0, max(DURATIONS_S), 0.5 * SHAKE_PERIOD_S)
    square = 1.0 - 2.0 * (np.arange(len(times_s)) % 2)
    return times_s, current_A + shake_A * square
