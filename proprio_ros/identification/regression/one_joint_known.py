"""Weighing with a joint whose motions with known loads were recorded: what they say of torque, rotor and friction.

In weak form (`weak_form`) the motor's torque, as the robot file makes it of currents, is linear in a few terms of the joint
(`joint_calibration.TERMS`): the true torque of everything that hangs on it, times a scale; inertia of the rotor; viscous friction,
back EMF included; Coulomb friction; gears that lose a share of what they transmit, more of much (those of small servos lose half);
and an offset that each recording has of its own. Known loads tell the terms; with the terms a load is one number.

A few seconds of one motion know their error badly, so nothing formal is used. How much a mass errs is made of: leaving out
stretches of 1 s of the recording itself; leaving out one recording of the calibration at a time; and by how much masses of the
calibration's own recordings, each weighed by the others, err beyond what their stretches explain. Servos warm up: how much Coulomb
friction a recording has, it shows itself, as far as recordings of arms differ. What it does not show goes into the last: the scale
of the torque, and what gears lose of a load, which would take the load's place. A few recordings say little about their spread, so
all of its posterior counts, under a half Cauchy prior (Gelman 2006, Bayesian Analysis 1); and whether it grows with the mass is not
known, so the wider counts.

Constants below that name no source were chosen by hand; `test/benchmarks/real.py` measures how intervals hold with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear, minimize_scalar
from scipy.special import stdtrit

from proprio_ros.calibration_files.one_joint import FEWEST_RUNS, TERMS, JointCalibration
from proprio_ros.calibration_files.own_terms import OwnTerms
from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.identification.estimate import JointFit
from proprio_ros.identification.regression.motion_fit import run_entry
from proprio_ros.identification.regression.motion_prior import URDF_SHARE
from proprio_ros.identification.regression.one_joint_fit import (
    HOP_SHARE,
    WINDOWS_S,
    Carried,
    Hinge,
    Table,
    carried_by,
    rms,
    shown_of,
    stretches_of,
    table_of,
    without,
)
from proprio_ros.identification.regression.recording_variability import (
    PUBLISHED,
    half_width,
    spread_of,
    spread_posterior,
)
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

# A joint that is slower for most of a window creeps, and its friction is not that of one that moves.
CREEP_RAD_S = 0.1
# Of the shares of load friction, for the heaviest load: gears that lose more do not turn back.
LOAD_FRICTION_STD = 0.5
OUTSIDE_SHARE = 0.1
"""What a mass errs, relative, for each factor of e that it lies outside of the loads that were known."""
HEAVIEST = 4.0  # Times the heaviest known load: nothing beyond is looked for.
GRID = 33
ITERATIONS = 4
OWN_ROUNDS = 6  # What gears lose of a load follows the load.
USUAL_SHARE = PUBLISHED["friction"]
"""Of all friction at the motion's speed, by what dry and viscous friction each differ from recording to recording."""
# Of its inertia, and of the load's, by what a rotor seems to differ: none does, but windows do not follow every motion alike.
USUAL_ROTOR = 0.05
USUAL_INERTIA = 0.02
UNKNOWN_KG = 1e6  # Standard deviation of a mass that a recording does not know, in a file.
STRETCHES = "what differs from stretch to stretch"
CALIBRATION = "what the calibration leaves open"
RUNS = "what differs from recording to recording"
ARM = "the arm itself"
PLACE = "place of the payload"
OUTSIDE = "a mass that no known load comes near"


@dataclass(frozen=True)
class KnownJointFit:
    """A mass, and what it errs by."""

    # mass, std: [kg]
    mass: float
    std: float
    quantile: float  # half width of a 95 % interval in standard deviations
    # what puts how much standard deviation on it [kg], by name
    parts: tuple[tuple[str, float], ...]
    stretches: int  # of the recordings
    # rms of the windows' mean torque that is left over [N m]; driven: of the torque itself
    residual: float
    driven: float
    at_the_end: bool  # whether the mass stands at the end of what was looked for
    shown: tuple[JointFit, ...]  # torque over time, for a picture
    own_terms: OwnTerms  # what the recordings show by themselves, see `own_terms`


def tables_of(
    robot: Robot,
    motion: Motion,
    joint: str,
) -> tuple[Table, ...]:
    """What one motion says, once for each length of the windows.

    ``robot``: its torque constant and geometry; ``motion``: of the joint; ``joint``: that moves alone.

    Raises `RecordingError`: It does not move for long enough.
    """
    hinge = Hinge.of(robot, joint, motion)
    return tuple(
        table_of(
            robot,
            motion,
            joint,
            hinge,
            window_s,
            CREEP_RAD_S,
        )
        for window_s in WINDOWS_S
    )


def _design(
    table: Table,
    load: FloatArray,
    share: float,
) -> FloatArray:
    """A column per term, shape (W, 6); those of load friction are taken ``share`` times."""
    true = table.columns[:, :3] @ load
    direction = table.columns[:, 4]
    lost = share * np.abs(true) * direction
    return np.column_stack(
        [true, table.columns[:, 0], table.columns[:, 3], direction, lost, lost * np.abs(true)]
    )


def terms_of(
    tables: Sequence[Sequence[Table]], loads_kg: Sequence[float], carried: Carried
) -> tuple[FloatArray, float]:
    """The terms that motions with known loads show, and what they leave over.

    Args:
        tables: Of each motion, by the length of the windows.
        loads_kg: Of each motion [kg].
        carried: What hangs on the joint.

    Returns: Shape (6,), and rms of the torque that is left over, in true torque [N m].
    """
    heaviest = 0.0
    for parts, kg in zip(tables, loads_kg, strict=True):
        load = carried.arm + kg * carried.per_kg
        for part in parts:
            torque = part.columns[:, :3] @ load
            heaviest = max(heaviest, float(np.abs(torque).max()))
    by_window = [
        _bounded_terms(parts, loads_kg, carried, heaviest) for parts in zip(*tables, strict=True)
    ]
    terms = [found for found, _ in by_window]
    left_over = [left for _, left in by_window]
    return np.mean(terms, axis=0), float(np.mean(left_over))


def _bounded_terms(
    parts: Sequence[Table], loads_kg: Sequence[float], carried: Carried, heaviest: float
) -> tuple[FloatArray, float]:
    """The same in one length of windows, by bounded least squares: ``heaviest`` is the largest torque of gravity [N m]."""
    # none of the terms can be negative, and an offset can
    lowest = np.full(
        len(TERMS) + len(parts),
        -np.inf,
    )
    lowest[: len(TERMS)] = 0.0
    values = np.array([1.0, *np.zeros(len(TERMS) - 1)])
    # each recording counts alike, however long
    weights = [1.0 / np.sqrt(len(part.torque)) for part in parts]
    right = np.concatenate(
        [weight * part.torque for weight, part in zip(weights, parts, strict=True)]
    )
    for _ in range(ITERATIONS):
        rows = []
        for number, (part, kg) in enumerate(zip(parts, loads_kg, strict=True)):
            design = _design(
                part,
                carried.arm + kg * carried.per_kg,
                values[0],
            )
            rows.append(weights[number] * _with_offsets(design, number, len(parts)))
        matrix = np.vstack(rows)  # (W, 6 + M)
        prior = np.zeros((2, matrix.shape[1]))
        noise = rms(right - matrix[:, : len(values)] @ values)
        prior[0, 4] = noise / LOAD_FRICTION_STD
        prior[1, 5] = noise * heaviest / LOAD_FRICTION_STD
        # as small as it can be: the bounded search then costs nothing
        rows_and_prior = np.vstack([matrix, prior])
        stacked = np.column_stack([rows_and_prior, np.append(right, [0.0, 0.0])])
        root = np.asarray(np.linalg.qr(stacked, mode="r"))
        found = lsq_linear(
            root[:, :-1],
            root[:, -1],
            bounds=(lowest, np.inf),
            method="bvls",
        )
        values = found.x[: len(TERMS)]
    squares = np.sum(np.square(right - matrix @ found.x))
    return values, float(np.sqrt(squares / len(parts))) / max(abs(values[0]), 1e-9)


def _with_offsets(
    columns: FloatArray,
    number: int,
    motions: int,
) -> FloatArray:
    """Columns of one motion, and of each motion's offset, shape (W, K) to (W, K + M)."""
    offsets = np.zeros((len(columns), motions))
    offsets[:, number] = 1.0
    return np.hstack([columns, offsets])


@dataclass(frozen=True)
class _Weighing:
    """How a mass is looked for by known terms of the joint."""

    carried: Carried
    reach_kg: tuple[float, float]  # between which masses [kg]
    noise: float  # rms of what windows leave over [N m]

    def left_over(
        self, parts: Sequence[Table], terms: FloatArray, mass: float
    ) -> list[tuple[FloatArray, float]]:
        """Of each motion the torque beside the terms' with a mass, less an offset and a change of friction of its own [N m].

        ``parts``: windows of each motion; ``terms``: see `TERMS`, shape (6,); ``mass``: of the payload [kg].

        With it comes how improbable that change of Coulomb friction is, in squares of what windows leave over.
        """
        load = self.carried.arm + mass * self.carried.per_kg
        found = []
        # windows overlap
        prior = max((self.noise / PUBLISHED["friction"]) ** 2 / HOP_SHARE, 1e-18)
        for part in parts:
            design = _design(part, load, terms[0])
            residual = _about_mean(part.torque - design @ terms)
            friction = _about_mean(design[:, 3] * terms[3])
            change = float(friction @ residual) / (float(friction @ friction) + prior)
            found.append((residual - change * friction, prior * change**2))
        return found

    def mass(
        self,
        parts: Sequence[Table],
        terms: FloatArray,
    ) -> float:
        """The one that leaves least over [kg]."""

        def cost(mass: float) -> float:
            return sum(
                float(left @ left) + more for left, more in self.left_over(parts, terms, mass)
            )

        grid = np.linspace(*self.reach_kg, GRID)
        best = int(np.argmin([cost(float(mass)) for mass in grid]))
        bounds = grid[max(best - 1, 0)], grid[min(best + 1, GRID - 1)]
        options = {"xatol": 1e-5}
        return float(minimize_scalar(cost, bounds=bounds, method="bounded", options=options).x)

    def by_stretches(
        self,
        tables: Sequence[Sequence[Table]],
        terms: FloatArray,
    ) -> _Jackknife:
        """Mass of motions, by the length of the windows, and its variance."""
        return _Jackknife.of(tables, lambda parts: self.mass(parts, terms), least=2)


def _about_mean(values: FloatArray) -> FloatArray:
    result: FloatArray = values - values.mean()
    return result


@dataclass(frozen=True)
class _Jackknife:
    """What windows of several lengths say, and how that moves where stretches are left out."""

    values: FloatArray  # mean over the lengths, shape () or (K,)
    variance: FloatArray  # among lengths and stretches; infinite of fewer than two stretches
    stretches: int

    @classmethod
    def of(
        cls,
        tables: Sequence[Sequence[Table]],
        answer: Callable[[Sequence[Table]], FloatArray | float],
        least: int,
    ) -> _Jackknife:
        """By an answer to windows of one length.

        Args:
            tables: Of each motion, by the length of the windows.
            answer: Of windows of all motions, of one length, shape () or (K,).
            least: A motion of which no more windows are left counts as none.
        """
        by_window = list(zip(*tables, strict=True))
        choices = np.array([answer(parts) for parts in by_window])
        values = choices.mean(axis=0)
        moved = []
        for stretch in stretches_of(by_window[0]):
            rest = [
                [part for part in without(parts, *stretch) if len(part.torque) > least]
                for parts in by_window
            ]
            if all(rest):
                left = np.array([answer(parts) for parts in rest])
                moved.append(left.mean(axis=0) - values)
        count = len(moved)
        scatter = np.inf
        if count > 1:
            scatter = (count - 1) / count * np.square(moved).sum(axis=0)
        return cls(
            values,
            scatter + choices.var(axis=0, ddof=1),
            count,
        )


def own_terms(
    tables: Sequence[Sequence[Table]],
    terms: FloatArray,
    carried: Carried,
    start_kg: float,
) -> OwnTerms:
    """What motions show of rotor, viscous and dry friction by themselves: the load is open, and all else as ``terms`` have it.

    Args:
        tables: Of each motion, by the length of the windows.
        terms: See `TERMS`, shape (6,).
        carried: What hangs on the joint.
        start_kg: A load near that of the motions.
    """
    found = _Jackknife.of(
        tables, lambda parts: _own(parts, terms, carried, start_kg), least=len(TERMS)
    )
    speeds = np.concatenate([parts[0].columns[:, 3] for parts in tables])
    inertia = float((carried.arm + start_kg * carried.per_kg)[0])
    usual = _usual(terms, rms(speeds), inertia)
    return OwnTerms(
        found.values,
        np.sqrt(found.variance),
        usual,
    )


def _own(
    parts: Sequence[Table], terms: FloatArray, carried: Carried, start_kg: float
) -> FloatArray:
    """Rotor, viscous and dry friction in one length of windows, shape (3,)."""
    mass = start_kg
    heaviest = HEAVIEST * abs(start_kg)
    solution = np.zeros(len(TERMS) - 2)
    for _ in range(OWN_ROUNDS):
        rows = []
        rights = []
        for number, part in enumerate(parts):
            design = _design(
                part,
                carried.arm + mass * carried.per_kg,
                terms[0],
            )
            arm = terms[0] * (part.columns[:, :3] @ carried.arm)
            per_kg = terms[0] * (part.columns[:, :3] @ carried.per_kg)
            columns = np.column_stack([per_kg, design[:, 1:4]])
            rows.append(_with_offsets(columns, number, len(parts)))
            rights.append(part.torque - arm - design[:, 4:] @ terms[4:])
        matrix = np.vstack(rows)
        solution = np.linalg.lstsq(matrix, np.concatenate(rights), rcond=None)[0]
        mass = float(np.clip(solution[0], -heaviest, heaviest))
    return solution[1:4]


def _usual(
    terms: FloatArray,
    speed_rad_s: float,
    inertia: float,
) -> FloatArray:
    """By how much rotor, viscous and dry friction differ from one recording to the next, shape (3,)."""
    scale, armature, viscous, coulomb = terms[:4]
    speed = max(speed_rad_s, 1e-6)
    friction = coulomb + viscous * speed
    rotor = USUAL_ROTOR * armature + USUAL_INERTIA * scale * inertia
    return np.maximum([rotor, USUAL_SHARE * friction / speed, USUAL_SHARE * friction], 1e-9)


def reach_of(loads_kg: FloatArray) -> tuple[float, float]:
    """Between which masses is looked [kg]."""
    heaviest = float(loads_kg.max())
    return -0.5 * heaviest, HEAVIEST * heaviest


def learn_joint(
    robot: Robot, motions: Sequence[Motion], loads_kg: Sequence[float], facts: PayloadFacts
) -> JointCalibration:
    """What motions with known loads say about their joint.

    Args:
        robot: Of one joint that turns.
        motions: Three or more.
        loads_kg: What was held in each; 0 is an empty hand.
        facts: Where the loads sat.

    Raises `RecordingError`: There are too few, or one is of no use.
    """
    (joint,) = motions[0].joints
    if len(motions) < FEWEST_RUNS:
        raise RecordingError(
            f"{motions[0].name}: {len(motions)} motions of one joint do not say by how much friction differs from one to the "
            f"next: calibrate with {FEWEST_RUNS} at least, better 6, with known loads (--reference BAG=KG)"
        )
    carried = carried_by(robot, joint, motions[0], facts)
    tables = [tables_of(robot, motion, joint) for motion in motions]
    loads = np.asarray(loads_kg, dtype=np.float64)
    values, residual = terms_of(tables, loads.tolist(), carried)
    weighing = _Weighing(
        carried,
        reach_of(loads),
        residual * abs(values[0]),
    )
    without = []
    runs = []
    own = []
    for number, motion in enumerate(motions):
        kg = float(loads[number])
        others = tables[:number] + tables[number + 1 :]
        terms, _ = terms_of(
            others,
            np.delete(loads, number).tolist(),
            carried,
        )
        read = weighing.by_stretches([tables[number]], terms)
        without.append(terms)
        entry = run_entry(motion, kg)
        entry["read_kg"] = float(read.values)
        entry["std_kg"] = min(float(np.sqrt(read.variance)), UNKNOWN_KG)
        runs.append(entry)
        own.append(own_terms([tables[number]], values, carried, kg or float(loads.max())))
    learnt = JointCalibration(
        joint=joint,
        torque_constant=robot.drive_trains[joint].torque_constant.value,
        values=values,
        without=np.array(without),
        spread=0.0,
        residual=residual,
        runs=tuple(runs),
        own_terms=tuple(own),
        driven_by=law_of(robot, joint),
    )
    return replace(learnt, spread=spread_of(_spread_by(learnt)))


def law_of(robot: Robot, joint: str) -> dict[str, Any]:
    """What makes a joint's currents of goals and duty cycles, as the robot file states it; nothing where a current drives it."""
    drive = robot.drive_trains[joint]
    if drive.driven_by is None:
        return {}
    numbers = {**asdict(drive.driven_by), "resistance_ohm": drive.resistance_ohm}
    finite = {name: value for name, value in numbers.items() if np.isfinite(value)}
    return {"kind": drive.driven_by.kind, **finite}


def check_law(robot: Robot, calibration: JointCalibration) -> None:
    """That the robot file still has the law by which the calibration's currents were made.

    Raises `RobotError`: It has another one.
    """
    joint = calibration.joint
    now = law_of(robot, joint)
    then = calibration.driven_by
    if not then:
        return
    for key in dict.fromkeys([*then, *now]):
        if now.get(key) != then.get(key):
            raise RobotError(
                f"{robot.source.name}: {key} of what drives {joint} (driven_by) is {now.get(key, 'not stated')}, but it was "
                f"calibrated with {then.get(key, 'none')}: state it as it was, or calibrate again"
            )


def _spread_by(
    calibration: JointCalibration,
    mass: float | None = None,
) -> FloatArray:
    """The posterior of how far its recordings differ, relative to each load, or all to one mass [kg]."""
    loaded = [run for run in calibration.runs if float(run["load_kg"]) > 0.0]
    loads = np.array([float(run["load_kg"]) for run in loaded])
    errors = np.array([float(run["read_kg"]) for run in loaded]) - loads
    stds = np.array([float(run["std_kg"]) for run in loaded])
    scale = loads if mass is None else mass
    return spread_posterior(errors / scale, np.square(stds / scale))


def identify_by_joint(
    robot: Robot, motions: Sequence[Motion], calibration: JointCalibration, facts: PayloadFacts
) -> KnownJointFit:
    """The mass that all motions share.

    Args:
        robot: Of one joint that turns.
        motions: At least one.
        calibration: Of the same joint.
        facts: Where the payload sits.

    Raises `RecordingError`: A motion is of no use.
    """
    joint = calibration.joint
    carried = carried_by(robot, joint, motions[0], facts)
    tables = [tables_of(robot, motion, joint) for motion in motions]
    reach_kg = reach_of(calibration.loads_kg)
    scale = max(abs(calibration.values[0]), 1e-9)
    noise = calibration.residual * abs(float(calibration.values[0]))
    weighing = _Weighing(carried, reach_kg, noise)
    found = weighing.by_stretches(tables, calibration.values)
    mass = float(found.values)
    budget = _Budget.of(weighing, tables, calibration, found)
    longest = [parts[-1] for parts in tables]
    left_over = np.concatenate(
        [left for left, _ in weighing.left_over(longest, calibration.values, mass)]
    )
    return KnownJointFit(
        mass=mass,
        std=budget.std,
        quantile=budget.quantile,
        parts=budget.stds,
        stretches=found.stretches,
        residual=rms(left_over) / scale,
        driven=rms(np.concatenate([part.torque for part in longest])) / scale,
        at_the_end=not reach_kg[0] + 1e-3 < mass < reach_kg[1] - 1e-3,
        shown=shown_of(
            [motion.name for motion in motions],
            joint,
            longest,
            left_over,
            carried.per_kg,
            mass,
            usual=calibration.residual,
            scale=scale,
        ),
        own_terms=own_terms(tables, calibration.values, carried, mass),
    )


@dataclass(frozen=True)
class _Budget:
    """What a mass errs by."""

    variances: Mapping[str, float]  # by cause [kg^2]
    std: float  # of all together [kg]
    quantile: float  # half width of a 95 % interval in standard deviations

    @property
    def stds(self) -> tuple[tuple[str, float], ...]:
        """What each cause puts on the mass, as a standard deviation [kg]."""
        return tuple((name, float(np.sqrt(part))) for name, part in self.variances.items())

    @classmethod
    def of(
        cls,
        weighing: _Weighing,
        tables: Sequence[Sequence[Table]],
        calibration: JointCalibration,
        found: _Jackknife,
    ) -> _Budget:
        """The budget of a mass that was found in some motions.

        Args:
            weighing: How the mass was looked for.
            tables: Of each motion, by the length of the windows.
            calibration: Of the joint.
            found: The mass and its variance among stretches [kg, kg^2], shape ().

        Returns:
            Its variance by cause, and the width of its interval.
        """
        mass = float(found.values)
        variances = {
            STRETCHES: float(found.variance),
            CALIBRATION: _by_calibration(
                weighing,
                list(zip(*tables, strict=True)),
                calibration,
            ),
            **_by_place(calibration, weighing.carried, mass),
        }
        rest = max(sum(variances.values()), 1e-18)
        freedom = [
            (variances[STRETCHES], max(found.stretches - 1, 1)),
            (variances[CALIBRATION], len(calibration.without) - 1),
        ]
        half, spread_kg = _by_recordings(calibration, mass, rest, freedom)
        variances[RUNS] = spread_kg**2
        std = float(np.sqrt(rest + variances[RUNS]))
        quantile = half / std if np.isfinite(half) else float(stdtrit(1, 0.975))
        return cls(variances, std, quantile)


def _by_calibration(
    weighing: _Weighing, by_window: Sequence[Sequence[Table]], calibration: JointCalibration
) -> float:
    """Variance of the mass as recordings of the calibration are left out [kg^2], a jackknife."""
    by_others = [
        [weighing.mass(parts, terms) for parts in by_window] for terms in calibration.without
    ]
    others = np.mean(by_others, axis=1)
    count = len(others)
    squares = np.square(others - others.mean())
    return (count - 1) / count * float(np.sum(squares))


def _by_place(calibration: JointCalibration, carried: Carried, mass: float) -> dict[str, float]:
    """Variances of the mass [kg^2] by what arm and payload are taken to be, and by how far it lies outside of the known loads."""
    held = calibration.loads_kg[calibration.loads_kg > 0.0]
    lever = max(float(np.linalg.norm(carried.per_kg[1:])), 1e-6)
    # an arm that is not as its URDF says was taken for a load, and cancels where the loads were the same
    arm_kg = URDF_SHARE * float(np.linalg.norm(carried.arm[1:])) / lever
    outside = max(
        np.log(max(mass, 1e-9) / held.max()),
        np.log(held.min() / max(mass, 1e-9)),
        0.0,
    )
    return {
        ARM: (arm_kg * (1.0 - mass / float(held.mean()))) ** 2,
        PLACE: (mass * carried.centre_std_m / lever) ** 2,
        OUTSIDE: (OUTSIDE_SHARE * outside * mass) ** 2,
    }


def _by_recordings(
    calibration: JointCalibration,
    mass: float,
    rest: float,
    freedom: Sequence[tuple[float, float]],
) -> tuple[float, float]:
    """Half width of the interval with what differs between recordings, and that as a standard deviation [kg].

    Args:
        calibration: Whose recordings show how far they differ.
        mass: That was found [kg].
        rest: Variance of everything else [kg^2].
        freedom: See `half_width`.
    """
    usual_kg = float(calibration.loads_kg[calibration.loads_kg > 0.0].mean())
    halves = []
    spreads_kg = []
    # what differs is a share of the load, as that of gears, or of its own, as dry friction is
    for posterior, scale_kg in (
        (_spread_by(calibration), abs(mass)),
        (_spread_by(calibration, usual_kg), usual_kg),
    ):
        finite = np.isfinite(rest)
        halves.append(half_width(posterior, scale_kg, rest, freedom) if finite else np.inf)
        spreads_kg.append(spread_of(posterior) * scale_kg)
    return max(halves), max(spreads_kg)
