"""Do the intervals of spheres hold? Random robots, boxes and spheres in MuJoCo, calibrated and weighed as a user would.

    python test/benchmarks/spheres.py                      # 60 robots of each kind, each with one sphere
    python test/benchmarks/spheres.py --run-torque 0       # robots whose torque is the same in every run


Every robot makes empty-hand runs and learns itself from them; then it makes the same three runs with an empty box in its hand and
with a sphere in it. The sphere is weighed from each of its runs alone and from the three together, always with the empty box's runs
as the baseline. From run to run torque differs by nothing, by what the robot file states, or by four times that (2 % of what a
joint turns with). Arm and effects are those of ``random_arm.py``; the sphere touches the walls by MuJoCo's law. What the intervals
are compared with is the Cramer-Rao bound as in ``coverage.py``, of the same runs under the same priors. Below the table stands
which source has which share of the variance, as a mean over the answers.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pool
from typing import Any, ClassVar

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import numpy as np
from coverage import MATCHED, run_of, true_values
from random_arm import EFFECTS, EMPTY_PROBES, GRIPPER, HiddenRobot, Load, Probe, draw_robot
from results import Results, each_answer, parser_of

from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.gates import LITTLE_TRAVEL
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun, prepare_run
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.container.identify import find_sphere
from proprio_ros.probes.container.problem import (
    ContainerFacts,
    ContainerProblem,
    container_unknowns,
    sphere_run,
    start_prior,
)
from proprio_ros.quantity import Z95
from proprio_ros.records import FloatArray, Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.payload import PayloadShape
from proprio_ros.sim.sphere import Enclosure

INNER_M, CENTRE_M, RADIUS_M, SHELL_KG = (
    np.array([0.06, 0.04, 0.04]),
    np.array([0.035, 0.0, 0.0]),
    0.01,
    0.03,
)
LIGHTEST_KG = 0.005
HEAVIEST_KG = 0.06
SETTLE_S = 1.0
SYRUP_S = 0.1
STANDS_M_S = 1e-3
FACTS = ContainerFacts(Enclosure("box", INNER_M, RADIUS_M), CENTRE_M)
"""What is stated about the box: the baseline says what it weighs."""
RUN_TORQUE_N_M = (0.0, 0.001, 0.004)


@dataclass(frozen=True)
class Boxed(Load):
    """A closed box in the hand, and what rolls in it.

    Attributes:
        sphere_kg: 0 for nothing.
        friction: between sphere and walls; hardness_s, damping_ratio: MuJoCo's time constant and damping of a touch.
    """

    sphere_kg: float = 0.0
    friction: float = 0.35
    hardness_s: float = 0.001
    damping_ratio: float = 1.0
    step_s: ClassVar[float] = 2e-4

    def add_to(self, spec: Any) -> Any:
        import mujoco

        body = super().add_to(spec)
        if self.sphere_kg == 0.0:
            return body
        spec.option.disableflags = 0
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
        touch = {
            "friction": [self.friction, 0.0, 0.0],
            "solref": [self.hardness_s, self.damping_ratio],
            "condim": 3,
        }
        for axis in range(3):
            for side in (-1.0, 1.0):
                half = INNER_M / 2.0 + 0.01
                place = CENTRE_M.copy()
                half[axis], place[axis] = 0.01, place[axis] + side * (INNER_M[axis] / 2.0 + 0.01)
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    size=half,
                    pos=place,
                    contype=1,
                    conaffinity=0,
                    mass=0.0,
                    **touch,
                )
        sphere = spec.worldbody.add_body(name="sphere")
        sphere.add_freejoint()
        sphere.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS_M, 0, 0], mass=self.sphere_kg, contype=0, conaffinity=1, **touch
        )  # fmt: skip
        return body

    def settle(self, model: Any, data: Any) -> FloatArray:
        import mujoco

        if self.sphere_kg == 0.0:
            return np.zeros(4)
        # into the lowest corner, a little above the walls; nothing bounces yet, and the arm is held
        turn = data.body("load").xmat.reshape(3, 3)
        down = turn.T @ [0.0, 0.0, -1.0]
        corner = CENTRE_M + np.sign(down) * (INNER_M / 2.0 - RADIUS_M - 1e-4)
        corner[1] = CENTRE_M[1]
        start = data.qpos[:4].copy()
        armature = model.dof_armature.copy()
        solref = model.geom_solref.copy()
        model.geom_solref[:, 1] = 1.0
        # beside a very heavy arm a light sphere may get kicks from rounding: then once more, with a lighter one and as if in syrup
        for held, resistance in ((1e6, 0.0), (1e5, 1.0 / SYRUP_S)):
            data.qpos[:4], data.qvel[:] = start, 0.0
            data.qpos[4:7], data.qpos[7:] = (
                data.body("load").xpos + turn @ corner,
                (1.0, 0.0, 0.0, 0.0),
            )
            model.dof_armature[:4] = held
            model.dof_damping[4:7] = self.sphere_kg * resistance
            model.dof_damping[7:10] = self.sphere_kg * RADIUS_M**2 * resistance
            mujoco.mj_step(
                model,
                data,
                nstep=round(SETTLE_S / model.opt.timestep),
            )
            if np.abs(data.qvel[4:7]).max() < STANDS_M_S:
                break
        model.dof_damping[4:10] = 0.0
        model.dof_armature[:], model.geom_solref[:] = armature, solref
        assert np.abs(data.qvel[4:7]).max() < STANDS_M_S, data.qvel
        data.qpos[:4], data.qvel[:], data.time = start, 0.0, 0.0
        lever = np.zeros((3, model.nv))
        mujoco.mj_jac(
            model,
            data,
            lever,
            None,
            data.body("sphere").xpos,
            model.body("load").id,
        )
        return lever[2, :4] * 9.81 * self.sphere_kg


def box(
    sphere_kg: float = 0.0,
    friction: float = 0.35,
    hardness_s: float = 0.001,
    damping_ratio: float = 1.0,
) -> Boxed:
    """A thin box of `SHELL_KG`, and a sphere."""
    spread = np.diag(PayloadShape.hollow("box", INNER_M).second_moment_per_mass)
    inertia = SHELL_KG * (spread.sum() - spread)
    return Boxed(
        SHELL_KG, tuple(CENTRE_M), (*inertia, 0.0, 0.0, 0.0), sphere_kg, friction, hardness_s, damping_ratio
    )  # fmt: skip


def _probe(
    joint: str,
    joint2: float,
    joint3: float,
    joint4: float,
    current_A: float,
) -> Probe:
    return Probe(
        joint,
        {
            "joint1": 0.0,
            "joint2": joint2,
            "joint3": joint3,
            "joint4": joint4,
            GRIPPER: 0.0,
        },
        current_A,
    )


PROBES = (
    # of each, the first that moves the empty box by 0.3 rad
    tuple(
        _probe(
            "joint4",
            -0.6,
            -1.0,
            0.6,
            current,
        )
        for current in (-0.10, -0.12, -0.144, -0.173)
    ),
    tuple(
        _probe(
            "joint4",
            -0.6,
            -0.2,
            0.4,
            current,
        )
        for current in (-0.03, -0.015, 0.0, 0.02)
    ),
    tuple(
        _probe(
            "joint3",
            -0.6,
            -0.4,
            0.0,
            current,
        )
        for current in (-0.10, -0.05, -0.02, 0.02)
    ),
)
"""The sequence ``container``."""


@dataclass(frozen=True)
class Recorded:
    """What one robot recorded: with an empty hand, with the empty box, and with the sphere."""

    hidden: HiddenRobot
    sphere: Boxed
    empty: tuple[Run, ...]
    baseline: tuple[Run, ...]
    rolling: tuple[Run, ...]


def drawn(
    seed: int,
    effects: Collection[str] = EFFECTS,
    run_torque_N_m: float = MATCHED.run_torque,
) -> tuple[np.random.Generator, HiddenRobot, Boxed]:
    """One robot whose torque differs by so much from run to run, its sphere, and the generator that goes on from them."""
    rng = np.random.default_rng([seed, 31])
    hidden = draw_robot(rng, effects, replace(MATCHED, run_torque=run_torque_N_m))
    sphere = box(
        float(np.exp(rng.uniform(np.log(LIGHTEST_KG), np.log(HEAVIEST_KG)))), float(rng.uniform(0.2, 0.5)),
        float(rng.uniform(0.001, 0.003)), float(rng.uniform(0.5, 1.0)),
    )  # fmt: skip
    return rng, hidden, sphere


def recorded(
    seed: int,
    effects: Collection[str] = EFFECTS,
    run_torque_N_m: float = MATCHED.run_torque,
) -> Recorded:
    """One robot's recordings."""
    rng, hidden, sphere = drawn(seed, effects, run_torque_N_m)
    empty = tuple(run_of(probe, hidden, None, rng) for probe in EMPTY_PROBES)
    baseline = []
    rolling = []
    for choices in PROBES:
        for probe in choices:
            run = run_of(probe, hidden, box(), rng)
            if np.ptp(run.position) > LITTLE_TRAVEL:
                break
        baseline.append(run)
        rolling.append(run_of(probe, hidden, sphere, rng))
    return Recorded(
        hidden,
        sphere,
        empty,
        tuple(baseline),
        tuple(rolling),
    )


def calibrated(made: Recorded) -> tuple[Robot, list[PreparedRun]] | None:
    """The robot as it learnt itself, and the runs that it learnt from; None where it refuses to."""
    robot = load_robot("open_manipulator_x")
    learnt = calibrate(
        robot,
        [LoadedRun(run) for run in made.empty],
    )
    if learnt.calibration is None or learnt.verdict.value != "accepted":
        return None
    used = {run["name"] for run in learnt.calibration.runs}
    return robot.with_calibration(learnt.calibration), [
        prepare_run(robot, run, KnownLoad()) for run in made.empty if run.name in used
    ]


def cramer_rao(
    made: Recorded,
    known: Sequence[PreparedRun],
    rolling: Sequence[Run],
) -> float:
    """Smallest standard deviation that any unbiased use of these runs and priors can have [kg].

    Friction and damping of the touch are taken where the priors expect them: MuJoCo's law has others.
    """
    robot = load_robot("open_manipulator_x")
    hidden = made.hidden
    inside = [prepare_run(robot, run, None, FACTS.shell) for run in rolling]
    runs = [
        *inside,
        *(prepare_run(robot, run, None, FACTS.shell) for run in made.baseline),
        *known,
    ]
    rolls = [row < len(inside) for row in range(len(runs))]
    nothing = JointRun(
        np.array([0.1]),
        np.zeros(1),
        np.zeros(1),
    )
    priors = [
        start_prior(sphere_run(robot, run, FACTS, nothing), FACTS, run.rest.value) for run in inside
    ]
    problem = ContainerProblem(
        robot,
        runs,
        FACTS,
        rolls,
        container_unknowns(
            robot,
            runs,
            rolls,
            FACTS,
            priors,
            Role.ESTIMATED,
        ),
    )
    values = true_values(hidden, problem, SHELL_KG)
    values[problem.index["sphere_mass"]] = made.sphere.sphere_kg
    _, v, dq = problem.simulate(
        values[None],
        problem.estimated,
    )
    reading = np.hypot(
        runs[0].drive.encoder_resolution / np.sqrt(12.0),
        hidden.encoder_noise,
    )
    sigma = np.hypot(reading, v[0] * hidden.stamp_jitter_s)
    rows = (dq[0] / sigma[..., None])[problem.weight > 0.0]
    information = rows.T @ rows + problem.coordinates.prior_precision
    return least_std(information, problem.column_of("sphere_mass"))


def least_std(information: np.ndarray, column: int) -> float:
    """Of one unknown: the root of what the inverse of that information (U, U) has in its column."""
    scale = 1.0 / np.sqrt(np.diag(information))
    inverse = np.linalg.pinv(
        information * scale[:, None] * scale[None, :], rcond=1e-14, hermitian=True
    )
    return float(np.sqrt(inverse[column, column]) * scale[column])


@dataclass(frozen=True)
class Answer:
    """One weighing.

    Attributes:
        run_torque: by so much the robot's torque differs from run to run [N m].
        runs: how many.
        error, std, bound: of the mass, its standard deviation and the least that this can be [kg].
        holds: whether the interval does.
        shares: of the sources of the variance; "widening" is what was added to the fit's own.
    """

    run_torque: float
    runs: int
    error: float
    std: float
    bound: float
    holds: bool
    shares: dict[str, float]


def answer_of(
    run_torque_N_m: float,
    runs: int,
    mass: float,
    estimate: Estimate,
    bound: float,
) -> Answer:
    value = estimate.value("sphere_mass")
    assert isinstance(value.value, float) and isinstance(value.std, float)
    shares: dict[str, float] = {}
    for source, std in estimate.budget:
        kind = source.split("[")[0]
        kind = "widening" if kind == "contact stiffness" else kind
        shares[kind] = shares.get(kind, 0.0) + (std / value.std) ** 2
    # the difference between runs is in the interval and not in the budget
    shares["widening"] = shares.get("widening", 0.0) + 1.0 - sum(shares.values())
    low, high = value.ci95
    return Answer(
        run_torque_N_m,
        runs,
        value.value - mass,
        value.std,
        bound,
        bool(low <= mass <= high),
        shares,
    )


def one_robot(job: tuple[int, tuple[str, ...], float]) -> tuple[list[Answer], list[str]]:
    """The answers of one robot, and why the others were refused."""
    seed, effects, run_torque_N_m = job
    made = recorded(seed, effects, run_torque_N_m)
    learnt = calibrated(made)
    if learnt is None:
        return [], ["not calibrated"] * 4
    robot, known = learnt
    answers = []
    refused = []
    for runs in [*[(run,) for run in made.rolling], made.rolling]:
        estimate = find_sphere(robot, runs, FACTS, None, made.baseline)
        if estimate.verdict.value != "accepted":
            refused.append(getattr(estimate.reasons[0], "code", "other"))
            continue
        bound = cramer_rao(made, known, runs)
        answers.append(
            answer_of(
                run_torque_N_m,
                len(runs),
                made.sphere.sphere_kg,
                estimate,
                bound,
            )
        )
    return answers, refused


def row(
    results: Results,
    run_torque_N_m: float,
    name: str,
    answers: Sequence[Answer],
    asked: int,
) -> None:
    """One row of the table; none without answers."""
    if not answers:
        return
    error, std, bound = (
        np.array([getattr(a, key) for a in answers]) for key in ("error", "std", "bound")
    )
    hits = float(np.mean([a.holds for a in answers]))
    margin = Z95 * np.sqrt(max(hits * (1.0 - hits), 1e-4) / len(answers))
    results.row(
        "spheres", torque=1e3 * run_torque_N_m, runs=name, answered=len(answers), asked=asked, hold=100.0 * hits,
        margin=100.0 * margin, rms=1e3 * np.sqrt(np.mean(error**2)), half=1e3 * Z95 * np.median(std),
        bound=1e3 * Z95 * np.median(bound), **each_answer(1e3 * error, 1e3 * Z95 * std),
    )  # fmt: skip


def rows_of_kind(
    results: Results,
    run_torque_N_m: float,
    answers: Sequence[Answer],
    robots: int,
) -> None:
    """Of robots whose torque differs alike: each run alone, and three together."""
    alone = [each for each in answers if each.runs == 1]
    together = [each for each in answers if each.runs > 1]
    row(results, run_torque_N_m, "one", alone, 3 * robots)
    row(results, run_torque_N_m, "three together", together, robots)


def stated(arguments: Sequence[str] | None) -> argparse.Namespace:
    """What the command line says."""
    parser = parser_of(__doc__)
    parser.add_argument("--robots", type=int, default=60)
    parser.add_argument("--first", type=int, default=2000, help="first seed")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
    )
    parser.add_argument(
        "--without", nargs="*", default=[], choices=EFFECTS, help="effects that are absent"
    )
    parser.add_argument(
        "--run-torque",
        type=float,
        nargs="+",
        default=RUN_TORQUE_N_M,
        help="by so much the torque of robots differs from run to run [N m]",
    )
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    options = stated(arguments)
    results = Results(__file__, options.json, arguments)
    effects = tuple(effect for effect in EFFECTS if effect not in options.without)
    answers: list[Answer] = []
    refused: Counter[str] = Counter()
    seeds = range(options.first, options.first + options.robots)
    jobs = [(seed, effects, torque_N_m) for torque_N_m in options.run_torque for seed in seeds]
    with Pool(options.jobs) as pool:
        for found, why in pool.imap_unordered(one_robot, jobs):
            answers += found
            refused.update(why)
    results.table(
        "spheres",
        {
            "torque differs by, mN m": "{torque:g}",
            "runs": "{runs}",
            "answers": "{answered} of {asked}",
            "interval holds": "{hold:.1f} ± {margin:.1f} %",
            "rms error, g": "{rms:.2f}",
            "median half interval, g": "{half:.2f}",
            "the bound's, g": "{bound:.2f}",
        },
    )
    for torque_N_m in options.run_torque:
        of_kind = [each for each in answers if each.run_torque == torque_N_m]
        rows_of_kind(results, torque_N_m, of_kind, options.robots)
    shares: Counter[str] = Counter()
    for answer in answers:
        shares.update(answer.shares)
    results.table("shares of the variance", {"source": "{source}", "share": "{share:.1f} %"})
    for source, share in shares.most_common(7):
        results.row(
            "shares of the variance",
            source=source,
            share=100.0 * share / len(answers),
        )
    print(f"refused: {dict(refused)}")
    results.keep()


if __name__ == "__main__":
    main()
