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
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear, minimize_scalar
from scipy.special import stdtrit

from proprio_ros.calibration_files.one_joint import FEWEST_RUNS, TERMS, JointCalibration
from proprio_ros.calibration_files.own_terms import OwnTerms
from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.identification.estimate import JointFit
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
USUAL_ROTOR, USUAL_INERTIA = 0.05, 0.02
"""Of its inertia, and of the load's, by what a rotor seems to differ: none does, but windows do not follow every motion alike."""
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
    """What one motion says, once for each length of the windows. Raises `RecordingError`: It does not move for long enough."""
    hinge = Hinge.of(robot, joint, motion)
    return tuple(
        table_of(robot, motion, joint, hinge, window_s, CREEP_RAD_S) for window_s in WINDOWS_S
    )


def _design(table: Table, load: FloatArray, share: float) -> FloatArray:
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
    """The terms that motions with known loads show, shape (6,), and rms of the torque that is left over, in true torque [N m].

    ``tables``: of each motion, by the length of the windows; ``loads_kg``: of each; ``carried``: what hangs on the joint.
    """
    found = []
    left = []
    heaviest = max(float(np.abs(part.columns[:, :3] @ (carried.arm + kg * carried.per_kg)).max()) for parts, kg in
                   zip(tables, loads_kg, strict=True) for part in parts)  # fmt: skip
    # none of the terms can be negative, and an offset can
    lowest = np.concatenate([np.zeros(len(TERMS)), np.full(len(tables), -np.inf)])
    parts: tuple[Table, ...]
    for parts in zip(*tables, strict=True):
        values = np.array([1.0, *np.zeros(len(TERMS) - 1)])
        for _ in range(ITERATIONS):
            rows = []
            rights = []
            for number, (part, kg) in enumerate(zip(parts, loads_kg, strict=True)):
                # each recording counts alike, however long
                weight = 1.0 / np.sqrt(len(part.torque))
                offsets = np.zeros((len(part.torque), len(parts)))
                offsets[:, number] = 1.0
                design = _design(part, carried.arm + kg * carried.per_kg, values[0])
                rows.append(weight * np.hstack([design, offsets]))
                rights.append(weight * part.torque)
            matrix = np.vstack(rows)
            right = np.concatenate(rights)
            prior = np.zeros((2, matrix.shape[1]))
            noise = float(np.sqrt(np.mean(np.square(right - matrix[:, : len(values)] @ values))))
            prior[0, 4], prior[1, 5] = (
                noise / LOAD_FRICTION_STD,
                noise * heaviest / LOAD_FRICTION_STD,
            )
            # as small as it can be: the bounded search then costs nothing
            stacked = np.column_stack([np.vstack([matrix, prior]), np.append(right, [0.0, 0.0])])
            root = np.asarray(np.linalg.qr(stacked, mode="r"))
            solution = lsq_linear(
                root[:, :-1], root[:, -1], bounds=(lowest, np.inf), method="bvls"
            ).x
            values = solution[: len(TERMS)]
        found.append(values)
        left.append(
            float(np.sqrt(np.sum(np.square(right - matrix @ solution)) / len(parts)))
            / max(abs(values[0]), 1e-9)
        )
    return np.mean(found, axis=0), float(np.mean(left))


def _left_over(
    parts: Sequence[Table], terms: FloatArray, carried: Carried, mass: float, noise: float
) -> list[tuple[FloatArray, float]]:
    """Of each motion the torque beside the terms' with a mass, less an offset and a change of Coulomb friction of its own [N m].

    With it comes how improbable that change is, in squares of what windows leave over, whose rms is ``noise`` [N m].
    """
    load = carried.arm + mass * carried.per_kg
    found = []
    prior = max((noise / PUBLISHED["friction"]) ** 2 / HOP_SHARE, 1e-18)  # windows overlap
    for part in parts:
        design = _design(part, load, terms[0])
        residual, friction = (
            each - each.mean() for each in (part.torque - design @ terms, design[:, 3] * terms[3])
        )
        change = float(friction @ residual) / (float(friction @ friction) + prior)
        found.append((residual - change * friction, prior * change**2))
    return found


def _mass(
    parts: Sequence[Table],
    terms: FloatArray,
    carried: Carried,
    reach_kg: tuple[float, float],
    noise: float,
) -> float:
    """The mass that leaves least over [kg]."""

    def cost(mass: float) -> float:
        return sum(
            float(left @ left) + more
            for left, more in _left_over(parts, terms, carried, mass, noise)
        )

    grid = np.linspace(*reach_kg, GRID)
    best = int(np.argmin([cost(float(mass)) for mass in grid]))
    low = grid[max(best - 1, 0)]
    high = grid[min(best + 1, GRID - 1)]
    return float(
        minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-5}).x
    )


def _by_stretches(
    tables: Sequence[Sequence[Table]],
    terms: FloatArray,
    carried: Carried,
    reach_kg: tuple[float, float],
    noise: float,
) -> tuple[float, float, int]:
    """Mass [kg], the variance that stretches and windows put on it [kg^2], and the number of stretches."""
    by_window = list(zip(*tables, strict=True))
    masses = [_mass(parts, terms, carried, reach_kg, noise) for parts in by_window]
    mass = float(np.mean(masses))
    moved = []
    for stretch in stretches_of(by_window[0]):
        rest = [
            [part for part in without(parts, *stretch) if len(part.torque) > 2]
            for parts in by_window
        ]
        if all(rest):
            moved.append(
                float(np.mean([_mass(parts, terms, carried, reach_kg, noise) for parts in rest]))
                - mass
            )
    count = len(moved)
    scatter = (count - 1) / count * float(np.sum(np.square(moved))) if count > 1 else np.inf
    return mass, scatter + float(np.var(masses, ddof=1)), count


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
    by_window = list(zip(*tables, strict=True))
    whole = np.array([_own(parts, terms, carried, start_kg) for parts in by_window])
    values = whole.mean(axis=0)
    moved = []
    for stretch in stretches_of(by_window[0]):
        rest = [
            [part for part in without(parts, *stretch) if len(part.torque) > len(TERMS)]
            for parts in by_window
        ]
        if all(rest):
            left = [_own(parts, terms, carried, start_kg) for parts in rest]
            moved.append(np.mean(left, axis=0) - values)
    count = len(moved)
    scatter = np.full(len(values), np.inf)
    if count > 1:
        scatter = (count - 1) / count * np.square(moved).sum(axis=0)
    std = np.sqrt(scatter + whole.var(axis=0, ddof=1))
    speeds = np.concatenate([part.columns[:, 3] for part in by_window[0]])
    usual = _usual(
        terms,
        rms(speeds),
        float((carried.arm + start_kg * carried.per_kg)[0]),
    )
    return OwnTerms(values, std, usual)


def _own(
    parts: Sequence[Table], terms: FloatArray, carried: Carried, start_kg: float
) -> FloatArray:
    """Rotor, viscous and dry friction in one length of windows, shape (3,)."""
    mass = start_kg
    solution = np.zeros(len(TERMS) - 2)
    for _ in range(OWN_ROUNDS):
        rows = []
        rights = []
        for number, part in enumerate(parts):
            design = _design(part, carried.arm + mass * carried.per_kg, terms[0])
            arm = terms[0] * (part.columns[:, :3] @ carried.arm)
            per_kg = terms[0] * (part.columns[:, :3] @ carried.per_kg)
            offsets = np.zeros((len(part.torque), len(parts)))
            offsets[:, number] = 1.0
            rows.append(np.column_stack([per_kg, design[:, 1:4], offsets]))
            rights.append(part.torque - arm - design[:, 4:] @ terms[4:])
        solution = np.linalg.lstsq(np.vstack(rows), np.concatenate(rights), rcond=None)[0]
        mass = float(np.clip(solution[0], -HEAVIEST * abs(start_kg), HEAVIEST * abs(start_kg)))
    return solution[1:4]


def _usual(terms: FloatArray, speed_rad_s: float, inertia: float) -> FloatArray:
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
    everyone = range(len(motions))
    without = np.array(
        [
            terms_of(tables[:n] + tables[n + 1 :], np.delete(loads, n).tolist(), carried)[0]
            for n in everyone
        ]
    )
    read = [
        _by_stretches([tables[n]], without[n], carried, reach_of(loads), residual * abs(values[0]))
        for n in everyone
    ]
    runs = tuple(
        {"name": motion.name, "duration_s": float(motion.times_s[-1]), "load_kg": float(kg), "read_kg": mass,
         "std_kg": min(float(np.sqrt(variance)), 1e6)}
        for motion, kg, (mass, variance, _) in zip(motions, loads, read, strict=True)
    )  # fmt: skip
    constant = robot.drive_trains[joint].torque_constant.value
    own = tuple(
        own_terms([each], values, carried, float(kg) or float(loads.max()))
        for each, kg in zip(tables, loads, strict=True)
    )
    law = law_of(robot, joint)
    learnt = JointCalibration(joint, constant, values, without, 0.0, residual, runs, own, law)
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


def _spread_by(calibration: JointCalibration, mass: float | None = None) -> FloatArray:
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

    ``robot``: of one joint that turns; ``motions``: at least one; ``calibration``: of the same joint; ``facts``: where
    the payload sits.

    Raises `RecordingError`: A motion is of no use.
    """
    joint = calibration.joint
    carried = carried_by(robot, joint, motions[0], facts)
    tables = [tables_of(robot, motion, joint) for motion in motions]
    loads = calibration.loads_kg
    reach_kg = reach_of(loads)
    noise = calibration.residual * abs(float(calibration.values[0]))
    mass, by_stretches, stretches = _by_stretches(
        tables, calibration.values, carried, reach_kg, noise
    )
    by_window = list(zip(*tables, strict=True))
    by_others = [
        [_mass(parts, terms, carried, reach_kg, noise) for parts in by_window]
        for terms in calibration.without
    ]
    others = np.mean(by_others, axis=1)
    count = len(others)
    by_calibration = (count - 1) / count * float(np.sum(np.square(others - others.mean())))
    lever = float(np.linalg.norm(carried.per_kg[1:]))
    held = loads[loads > 0.0]
    # an arm that is not as its URDF says was taken for a load, and cancels where the loads were the same
    arm_kg = URDF_SHARE * float(np.linalg.norm(carried.arm[1:])) / max(lever, 1e-6)
    outside = max(
        np.log(max(mass, 1e-9) / held.max()),
        np.log(held.min() / max(mass, 1e-9)),
        0.0,
    )
    variances = {
        STRETCHES: by_stretches,
        CALIBRATION: by_calibration,
        ARM: (arm_kg * (1.0 - mass / float(held.mean()))) ** 2,
        PLACE: (mass * carried.centre_std_m / max(lever, 1e-6)) ** 2,
        OUTSIDE: (OUTSIDE_SHARE * outside * mass) ** 2,
    }
    rest = max(sum(variances.values()), 1e-18)
    freedom = [
        (by_stretches, max(stretches - 1, 1)),
        (by_calibration, count - 1),
    ]
    half = 0.0
    spread_kg = 0.0
    usual_kg = float(held.mean())
    # what differs is a share of the load, as that of gears, or of its own, as dry friction is
    for posterior, times in (
        (_spread_by(calibration), abs(mass)),
        (_spread_by(calibration, usual_kg), usual_kg),
    ):
        half = (
            max(half, half_width(posterior, times, rest, freedom)) if np.isfinite(rest) else np.inf
        )
        spread_kg = max(spread_kg, spread_of(posterior) * times)
    variances[RUNS] = spread_kg**2
    std = float(np.sqrt(rest + variances[RUNS]))
    longest = by_window[-1]
    scale = max(abs(calibration.values[0]), 1e-9)
    left_over = np.concatenate(
        [left for left, _ in _left_over(longest, calibration.values, carried, mass, noise)]
    )
    names = [motion.name for motion in motions]
    return KnownJointFit(
        mass,
        std,
        half / std if np.isfinite(half) else float(stdtrit(1, 0.975)),
        tuple((name, float(np.sqrt(variance))) for name, variance in variances.items()),
        stretches,
        rms(left_over) / scale,
        rms(np.concatenate([part.torque for part in longest])) / scale,
        not reach_kg[0] + 1e-3 < mass < reach_kg[1] - 1e-3,
        shown_of(
            names, joint, longest, left_over, carried.per_kg, mass, calibration.residual, scale
        ),
        own_terms(tables, calibration.values, carried, mass),
    )
