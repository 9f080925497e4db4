"""What pushes and shakes can tell of a container's contents at best: the Cramer-Rao bound, before any recording.

    python test/benchmarks/contents_bound.py --json docs/results/contents_bound.json

The contents are a liquid in an upright cylinder, the arm an OpenMANIPULATOR-X as its calibration on the sample bags knows it,
or one with a UR5e's links and gears whose friction is known to 2 % and torque to 0.5 %. All that is open of the arm moves, too.
Beside the standard deviations of fill (from the motion alone, without its density), slosh frequency and damping stands how many
nats the best rigid thing falls short of the liquid where there is no noise: 3 are odds of 20 to 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from results import Results, parser_of
from support.contents import shake_period_s

from proprio_ros.addons.contents.models import ContentsFacts, ContentsProblem, Slosh, damping_ratio
from proprio_ros.identification import solvers
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.quantity import Quantity
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot

BAGS = Path(__file__).resolve().parents[2] / "bags"
RADII_M = (0.02, 0.035, 0.05)
MASSES_KG = (0.05, 0.15, 0.5)
WATER = 1e-6  # kinematic viscosity [m^2/s]
SETS = ("pushes", "and shaken")
COLUMNS = {
    "arm": "{arm}", "runs": "{runs}", "radius": "{radius_mm:g} mm", "water": "{g:g} g", "fill": "{fill_mm:.0f} mm",
    "sloshes at": "{hz:.1f} Hz",
    "mass": "± {mass_std_g:.1f} g", "fill, from motion alone": "± {fill_std_mm:.0f} mm", "frequency": "± {hz_std:.2f} Hz",
    "damping, within a factor": "{damping}", "liquid over rigid": "{nats:.1f} nats",
}  # fmt: skip
"""Standard deviations; a damping that is known no better than to a factor of 20 is not known."""


@dataclass(frozen=True)
class Push:
    """A run: which way it goes [rad], and the amplitude of its shaking [A]."""

    joint: str
    start: dict[str, float]
    travel: float
    duration_s: float = 0.6
    shake_A: float = 0.0


@dataclass(frozen=True)
class Arm:
    """An arm, its pushes, and how often its joints are read [1/s]."""

    name: str
    robot: Robot
    pushes: tuple[Push, ...]
    rate: float


def open_manipulator() -> Arm:
    """Calibrated with the sample bags of an empty hand."""
    robot = load_robot("open_manipulator_x")
    runs = [
        LoadedRun(run)
        for bag in sorted(BAGS.glob("realistic_s00_empty_*/bag_mcap"))
        for run in bag_runs(bag, request_of(Options()))
    ]
    calibration = calibrate(robot, runs).calibration
    assert calibration is not None

    def push(joint: str, three: Sequence[float], *rest: float) -> Push:
        names = ("joint2", "joint3", "joint4")
        return Push(
            joint,
            {
                "joint1": 0.0,
                "gripper_left_joint": 0.0,
                **dict(zip(names, three, strict=True)),
            },
            *rest,
        )

    pushes = (
        push("joint3", (-0.9, 0.3, 0.6), -0.6),
        push("joint3", (-0.6, -0.4, 1.0), 0.6),
        push("joint4", (-0.6, -0.2, 0.8), -0.7),
        push("joint3", (0.15, 1.2, -1.35), -0.2, 2.5, 0.12),
    )
    return Arm("OpenMANIPULATOR-X", robot.with_calibration(calibration), pushes, 40.0)


def like_ur() -> Arm:
    """Gears of 1:101: rotor and friction seen at the output hide what a hand holds."""
    robot = load_robot("ur5e")
    gears = {"wrist": (9.29, 1.5, 1.0, 0.3), "large": (9.838, 5.0, 4.0, 1.8)}
    trains = {}
    for name, drive in robot.drive_trains.items():
        torque, dry, viscous, rotor = gears["wrist" if name.startswith("wrist") else "large"]
        trains[name] = replace(
            drive, torque_constant=Quantity(torque, 0.005 * torque), coulomb=Quantity(dry, 0.02 * dry),
            viscous=Quantity(viscous, 0.02 * viscous), armature=Quantity(rotor, 0.02 * rotor), load_friction=Quantity(0.03, 0.005),
            stribeck=Quantity(0.2, 0.05), zero=Quantity(0.0, 0.001), encoder_resolution=1e-4, encoder_noise=2e-5,
            supply_voltage_V=0.0,
        )  # fmt: skip
    pose = dict.fromkeys(robot.model.independent_joints, 0.0)
    pose |= {"shoulder_lift_joint": -1.2, "elbow_joint": 1.4, "wrist_1_joint": -0.2}
    pushes = (
        Push("elbow_joint", pose, -0.5),
        Push("elbow_joint", pose, 0.5),
        Push("wrist_1_joint", pose, -0.6),
        Push("wrist_1_joint", pose, -0.2, 0.9, 0.4),
    )
    return Arm("UR5e's links and gears", replace(robot, drive_trains=trains), pushes, 125.0)


def facts_of(
    arm: Arm,
    push: Push,
    radius: float,
    fill: float,
) -> ContentsFacts:
    """A container that stands upright in the hand at the start of a push."""
    world_R_hand = arm.robot.model.frame_transform(arm.robot.payload_frame, push.start)[:3, :3]
    turned = world_R_hand.T
    bottom = turned @ np.array([0.02, 0.0, -0.04])
    return ContentsFacts(radius, max(1.5 * fill, 0.08), bottom, turned)


def bare(
    arm: Arm,
    push: Push,
    hz: float,
    current_A: float,
) -> Run:
    """A run whose positions are still to come."""
    half = 0.5 * shake_period_s(hz) if push.shake_A else push.duration_s
    switches = np.arange(0.0, push.duration_s - 1e-9, half)
    currents = current_A + push.shake_A * np.where(
        np.arange(len(switches)) % 2,
        -1.0,
        1.0,
    )
    times_s = np.arange(1, int(push.duration_s * arm.rate)) / arm.rate
    held = {name: at for name, at in push.start.items() if name != push.joint}
    at = push.start[push.joint]
    before_s = -np.arange(40, 0, -1) / arm.rate
    still = dict.fromkeys(held, 0.0)
    moving = at + push.travel * (times_s / push.duration_s) ** 2
    return Run(
        push.joint, push.joint, 0, times_s, moving, before_s, np.full(40, at), held, still, switches, currents, push.duration_s,
        "/applied_effort",
    )  # fmt: skip


def truth_of(
    problem: ContentsProblem,
    kg: float,
    fill: float,
    facts: ContentsFacts,
) -> np.ndarray:
    """Values of all unknowns: water, as the theory has it."""
    values = problem.base.copy()
    values[problem.index["contents_mass"]] = kg
    values[problem.index["slosh_damping_log"]] = np.log(damping_ratio(facts.radius, fill, WATER))
    return values


def driven(
    arm: Arm,
    push: Push,
    facts: ContentsFacts,
    kg: float,
    fill: float,
) -> PreparedRun | None:
    """The push with the current that moves the contents as far as it says; None where 10 A do not."""
    hz = float(np.sqrt(Slosh.of(facts.radius, np.array(fill)).stiffness)) / (2.0 * np.pi)
    low = -10.0
    high = 10.0
    period_s = shake_period_s(hz) if push.shake_A else 1e-3
    for _ in range(22):
        current = 0.5 * (low + high)
        run = prepare_run(
            arm.robot,
            bare(arm, push, hz, current),
            None,
            facts.shell,
        )
        problem = ContentsProblem(
            arm.robot,
            [run],
            facts,
            [True],
            "liquid",
        )
        shown = problem.simulate(truth_of(problem, kg, fill, facts)[None], problem.estimated[:1])[
            0
        ][0, 0]
        # of a shaken one where it is on average in the end
        moved = (
            float(shown[: run.used][run.times_s > run.times_s[-1] - period_s].mean())
            - push.start[push.joint]
        )
        low, high = (current, high) if moved < push.travel else (low, current)
    if abs(moved - push.travel) > 0.25:
        return None
    whole = replace(
        run.run,
        position=shown[: run.used],
        times_s=run.times_s,
    )
    return prepare_run(arm.robot, whole, None, facts.shell)


def bound(
    arm: Arm,
    pushes: Sequence[Push],
    radius: float,
    kg: float,
) -> dict[str, object] | None:
    """What the pushes tell, with an empty container known to 1 g; None where the arm cannot make them."""
    fill = kg / (1000.0 * np.pi * radius**2)
    facts = replace(
        facts_of(arm, pushes[0], radius, fill),
        mass=0.05,
        mass_std=0.001,
    )
    runs = [driven(arm, push, facts, kg, fill) for push in pushes]
    if any(run is None for run in runs):
        return None
    made = [run for run in runs if run is not None]
    problem = ContentsProblem(
        arm.robot,
        made,
        facts,
        [True] * len(made),
        "liquid",
    )
    values = truth_of(problem, kg, fill, facts)
    std = standard_deviations(problem, values)
    hz = float(np.sqrt(Slosh.of(radius, np.array(fill)).stiffness)) / (2.0 * np.pi)
    factor = float(np.exp(min(std["slosh_damping_log"], 20.0)))
    return {
        "arm": arm.name,
        "radius_mm": 1e3 * radius,
        "g": 1e3 * kg,
        "fill_mm": 1e3 * fill,
        "hz": hz,
        "mass_std_g": 1e3 * std["contents_mass"],
        "fill_std_mm": fill * std["contents_density"],
        "hz_std": hz * std["slosh_tuning"],
        "damping": f"{factor:.1f}" if factor < 20.0 else "-",
        "nats": short_of(problem, values, "rigid"),
    }


def standard_deviations(problem: ContentsProblem, values: np.ndarray) -> dict[str, float]:
    """Of the contents' unknowns by their names, in the problem's units, where next to nothing is known before."""
    found = Posterior(problem, values)
    names = ("contents_density", "slosh_tuning", "slosh_damping_log")
    loose = problem.coordinates.prior_precision.copy()
    for name in names:
        place = problem.column_of(name)
        loose[place, place] *= 1e-4  # a hundred times as wide
    information = found.sensitivity.T @ found.sensitivity + loose
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
    std = np.sqrt(np.diag(covariance))
    return {name: float(std[problem.column_of(name)]) for name in (*names, "contents_mass")}


def short_of(
    problem: ContentsProblem,
    values: np.ndarray,
    model: str,
) -> float:
    """By how many nats a model's best fit falls short of what a problem has at its values, shape (N,), without noise."""
    other = ContentsProblem(
        problem.robot,
        problem.runs,
        problem.container,
        problem.filled,
        model,
    )
    shown = problem.simulate(values[None], problem.estimated[:1])[0][0]
    other.measured = np.where(other.weight > 0.0, shown, 0.0)
    start = other.base.copy()
    for name in ("contents_mass", "payload_mass"):
        start[other.index[name]] = values[problem.index[name]]
    ends = solvers.levenberg_marquardt(
        other, other.coordinates.internal(start[None, other.estimated]), None, iterations=40
    )
    return float(ends.cost.min())


def rows() -> Iterator[dict[str, object]]:
    """Both arms, every container, without and with the shaken run."""
    for arm in (open_manipulator(), like_ur()):
        for radius in RADII_M:
            for kg in MASSES_KG:
                if kg / (1000.0 * np.pi * radius**2) > 0.2:
                    continue  # no such container fits a hand
                for what, pushes in zip(
                    SETS,
                    (arm.pushes[:3], arm.pushes),
                    strict=True,
                ):
                    found = bound(arm, pushes, radius, kg)
                    if found is not None:
                        yield {**found, "runs": what}


def main() -> None:
    arguments = parser_of(__doc__).parse_args()
    results = Results(__file__, arguments.json)
    results.table("bound", COLUMNS)
    for row in rows():
        results.row("bound", **row)
    results.keep()


if __name__ == "__main__":
    main()
