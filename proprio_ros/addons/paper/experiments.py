"""The experiments: pure functions from a seed to rows of plain values.

A seed draws the hidden robot and its noise. Objects are the paper's as far as it states them; sizes are ours. Whatever is
compared is identified from the same recordings. "Paper's way": one unknown, last frame, semi-implicit Euler, Adam, the robot's
numbers taken as exact; the schedule is long enough to reach the least error, so that the loss is judged and not where it stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from proprio_ros.addons.paper import cases
from proprio_ros.addons.paper.cases import (
    CUBES,
    EDGE_M,
    GAP_M,
    LIFT,
    OBJECTS,
    STARTS_KG,
    Rows,
    box,
    calibrated_robot,
    payload,
)
from proprio_ros.addons.paper.hand import CAMERA_STD_M, HungPayload, known_robot, play
from proprio_ros.addons.paper.hung import Hung, identify_hung
from proprio_ros.addons.paper.searches import landscapes, optimisers
from proprio_ros.addons.paper.speed import speed
from proprio_ros.addons.paper.ways import (
    answered,
    ours,
    paper_cube,
    paper_mass,
    paper_sphere,
    timed,
)
from proprio_ros.errors import ConfigurationError
from proprio_ros.identification.fit import SearchOptions, solve_load
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.solvers import adam_descent
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.container.identify import find_sphere
from proprio_ros.probes.container.problem import SphereTrack
from proprio_ros.probes.container.search import ContainerOptions
from proprio_ros.probes.payload.identify import WeighingOptions, weigh
from proprio_ros.probes.payload.paper import PaperOptions, last_frame_loss
from proprio_ros.probes.softness.identify import find_softness
from proprio_ros.probes.softness.problem import BlockFacts
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.energies import lame
from proprio_ros.sim.payload import PayloadFacts, PayloadShape


def objects(seed: int) -> Rows:
    """Table I: four objects, one lift each; ours also from lift and lowering."""
    known = cases.robots(seed, "empty_hand_elbow")
    rows = []
    trace = {}
    for name in OBJECTS:
        held, facts = payload(name)
        runs = play("payload_elbow", seed, held).runs
        for calibrated, robot in known:
            labels = {"object": name, "calibrated": calibrated, "truth": held.mass_kg}
            theirs = paper_mass(robot, runs[LIFT], facts)
            rows.append(theirs.row(way="paper", runs=1, **labels))
            for used in (runs[:1], runs[:2]):
                identify = partial(weigh, robot, used, facts)
                answer = ours(identify, "payload_mass")
                rows.append(
                    answer.row(
                        way="ours",
                        runs=len(used),
                        **labels,
                    )
                )
                if name == "heavy ball" and len(used) == 1 and answer.value and theirs.value:
                    kept = _lift_trace(
                        robot, runs[LIFT], facts, {"wrong": 0.005, "paper": theirs.value}
                    )
                    # with the friction, torque constant .. that it found together with its mass
                    kept["masses_kg"]["ours"] = answer.value
                    (fit,) = identify().run_fits
                    kept["simulated"]["ours"] = fit.simulated.tolist()
                    trace["calibrated" if calibrated else "stated"] = kept
    return {"rows": rows, "trace": trace}


def _lift_trace(
    robot: Robot,
    run: Run,
    facts: PayloadFacts,
    masses: Mapping[str, float],
) -> Rows:
    """A lift as measured and as simulated with some masses, the drive train as the robot is taken."""
    whole = last_frame_loss(robot, run, facts, PaperOptions()).whole
    q, _, _ = whole.simulate(
        whole.all_values(np.array([[m] for m in masses.values()])),
        whole.estimated,
    )
    used = whole.runs[0].used
    return {
        "times_s": run.times_s[:used].tolist(),
        "measured": run.position[:used].tolist(),
        "masses_kg": dict(masses),
        "simulated": dict(zip(masses, q[:, 0, :used].tolist(), strict=True)),
    }


def starts(seed: int) -> Rows:
    """Table II: where each way ends from each first guess, heavy ball, one lift."""
    held, facts = payload("heavy ball")
    run = play("payload_elbow", seed, held).runs[LIFT]
    options = PaperOptions(starts_kg=STARTS_KG)
    rows: list[Rows] = []
    for calibrated, robot in cases.robots(seed, "empty_hand_elbow"):
        loss = last_frame_loss(robot, run, facts, options)
        for iterations in (15, 400):
            first = np.array(STARTS_KG)[:, None]
            found = adam_descent(loss, first, options.learning_rate, iterations, lower=1e-6)
            ends = zip(
                STARTS_KG,
                found.internal[:, 0].tolist(),
                strict=True,
            )
            rows += _from(f"paper, {iterations} iterations", ends, calibrated, held.mass_kg)
        estimate = weigh(robot, [run], facts, WeighingOptions(starts_kg=STARTS_KG))
        paths = estimate.solver.paths if estimate.solver is not None else ()
        rows += _from("ours", ((path.start, path.end) for path in paths), calibrated, held.mass_kg)
    return {"rows": rows}


def _from(
    way: str,
    ends: Iterable[tuple[float, float]],
    calibrated: bool,
    truth: float,
) -> list[Rows]:
    return [
        {"way": way, "calibrated": calibrated, "start": start, "value": end, "truth": truth}
        for start, end in ends
    ]


def published(folder: Path) -> Rows:
    """The paper's own recording, in its way with the schedule as its setting states it, and in ours.

    Raises `ProprioError`: It is no such recording.
    """
    theirs = replay([folder], Options(profile="paper"))
    ways = (
        [(path.start, path.scheduled, path.end) for path in theirs.solver.paths]
        if theirs.solver is not None
        else []
    )
    estimate = replay([folder], Options())
    return {"paths": ways, "ours": answered(estimate, "payload_mass").__dict__}


def sphere(seed: int) -> Rows:
    """V-B: the sphere's mass from one lift of the wrist, and from three runs beside those of the empty box."""
    held, weighed, open_box = box()
    rolling = play("container", seed, held).runs
    baseline = play("container", seed, held.emptied).runs
    rows = []
    for calibrated, robot in cases.robots(seed, "empty_hand_container"):
        labels = {"calibrated": calibrated, "truth": held.sphere_mass_kg}
        rows.append(
            paper_sphere(robot, rolling[LIFT], weighed).row(
                way="paper, one run",
                **labels,
            )
        )
        for way, runs, facts, empty in (
            ("ours, one run", rolling[:1], weighed, ()),
            ("ours, three runs and the empty box", rolling, open_box, baseline),
        ):
            found = find_sphere(robot, runs, facts, None, empty)
            rows.append(answered(found, "sphere_mass").row(way=way, **labels))
    return {"rows": rows}


def tracking(seed: int) -> Rows:
    """V-F: from the joint, from a camera that sees the sphere, and from both."""
    held, _, facts = box()
    played = play("container", seed, held)
    baseline = play("container", seed, held.emptied).runs
    robot = calibrated_robot(seed, "empty_hand_container")
    assert played.sphere is not None
    tracks = [SphereTrack(*played.sphere.of_run(run), CAMERA_STD_M) for run in played.runs]
    rows = []
    for signals in ("joint", "camera", "both"):
        estimate = find_sphere(
            robot, played.runs, facts, ContainerOptions(signals=signals), baseline, tracks
        )
        rows.append(
            answered(estimate, "sphere_mass").row(
                way=signals,
                truth=held.sphere_mass_kg,
            )
        )
    return {"rows": rows}


# a ball on a slide, or below two hinges
HUNG_KG = 0.050
HUNG_SIZE_M = 0.045
PENDULUM_M = 0.06


def extensions(seed: int) -> Rows:
    """A payload on a slide and on a universal joint, and a sphere that lies anywhere in its box; calibrated robots."""
    return {"rows": [*_hung(seed), *_anywhere(seed)]}


class _Hanging(NamedTuple):
    """A ball that moves in the hand: what is in it, and what each way of identifying it knows."""

    part: str
    held: HungPayload
    ways: Sequence[tuple[str, Hung]]


def _hung(seed: int) -> list[Rows]:
    """Lift and lowering of a ball that moves in the hand, as if it were rigid and on its joint; the joint's numbers are hidden."""
    robot = calibrated_robot(seed, "empty_hand_elbow")
    rows = []
    for part, held, ways in _hanging(seed):
        runs = play("payload_elbow", seed, held).runs
        labels = {"part": part, "truth": HUNG_KG}
        facts = PayloadFacts(np.array(held.com_m), shape=PayloadShape.of("sphere", HUNG_SIZE_M))
        rigid = answered(weigh(robot, runs, facts), "payload_mass")
        rows.append(rigid.row(way="as if it were rigid", **labels))
        for way, hung in ways:
            rows.append(identify_hung(robot, runs, hung).row(way=way, **labels))
    return rows


def _hanging(seed: int) -> tuple[_Hanging, _Hanging]:
    """A ball on a spring and a pendulum, whose numbers a seed draws."""
    rng = np.random.default_rng((seed, 15))
    frequency = rng.uniform(14.0, 26.0)
    decay = rng.uniform(1.5, 4.0)
    stated = 1.0 + 0.1 * rng.standard_normal()
    spread = PayloadShape.of("sphere", HUNG_SIZE_M).second_moment_per_mass
    across = HUNG_KG * HUNG_SIZE_M**2 / 10.0
    ball: Any = {
        "mass_kg": HUNG_KG,
        "inertia_kg_m2": (across, across, across, 0.0, 0.0, 0.0),
    }
    slid = HungPayload(
        **ball,
        axes=((1.0, 0.0, 0.0),),
        slides=True,
        stiffness=HUNG_KG * frequency**2,
        damping=2.0 * HUNG_KG * decay,
    )
    below = (0.0, 0.0, -PENDULUM_M)
    swung = HungPayload(
        **ball,
        com_m=below,
        damping=2.0 * HUNG_KG * PENDULUM_M**2 * decay,
    )
    spring = Hung("prismatic", np.array(slid.axes[0]), np.zeros(3), spread)
    known = replace(spring, frequency=(stated * frequency, 0.1 * stated * frequency))
    pendulum = Hung("universal", np.array(swung.axes), np.array(below), spread)
    on_slide = (
        ("on its slide, spring known to 10 %", known),
        ("on its slide, spring unknown", spring),
    )
    return (
        _Hanging("slide", slid, on_slide),
        _Hanging("universal joint", swung, (("on its universal joint", pendulum),)),
    )


def _anywhere(seed: int) -> list[Rows]:
    """The sphere when nobody knows where in its box it begins."""
    held, weighed, open_box = box()
    robot = calibrated_robot(seed, "empty_hand_container")
    runs = play("container", seed, held, anywhere=True).runs
    baseline = play("container", seed, held.emptied).runs
    labels = {"part": "sphere", "truth": held.sphere_mass_kg}
    words = "the paper's, one run, taken to lie where the box is lowest"
    rows = [
        paper_sphere(robot, runs[LIFT], weighed).row(
            way=words,
            **labels,
        )
    ]
    for way, facts in (
        ("ours, three runs and the empty box, taken to lie where it is lowest", open_box),
        ("ours, the same, start unknown", replace(open_box, settled=False)),
    ):
        estimate = find_sphere(robot, runs, facts, None, baseline)
        rows.append(answered(estimate, "sphere_mass").row(way=way, **labels))
    return rows


def cubes(seed: int) -> Rows:
    """V-C: Young's modulus and Poisson's ratio of two cubes from three squeezes; the paper's way from the last of them."""
    rows = []
    trace = {}
    known = cases.robots(seed, "empty_hand_gripper")
    for name, (modulus, ratio) in CUBES.items():
        runs = play("softness", seed, cases.soft_cube(name)).runs
        for calibrated, robot in known:
            own, value = _cube_both_ways(robot, runs, name)
            rows += [{**row, "object": name, "calibrated": calibrated} for row in own]
            if calibrated and isinstance(value, float):
                moduli = {"wrong": 4.0 * modulus, "identified": value}
                trace[name] = _squeeze_trace(robot, runs[-1], moduli, ratio)
    return {"rows": rows, "trace": trace}


def _cube_both_ways(
    robot: Robot,
    runs: Sequence[Run],
    name: str,
) -> tuple[list[Rows], Any]:
    """Rows of one cube, by the paper's way and ours, and the modulus [Pa] that ours gives."""
    modulus, ratio = CUBES[name]
    first = lame(2.0 * modulus, 0.3)
    theirs = paper_cube(robot, runs[-1], EDGE_M, 2.0 * GAP_M, OBJECTS[name][0], first)
    rows = [theirs.row(way="paper", quantity="youngs_modulus", truth=modulus)]
    facts = BlockFacts(np.full(3, EDGE_M))
    estimate, seconds = timed(partial(find_softness, robot, runs, facts))
    for quantity, truth in (("youngs_modulus", modulus), ("poissons_ratio", ratio)):
        answer = answered(estimate, quantity, seconds)
        rows.append(answer.row(way="ours", quantity=quantity, truth=truth))
    return rows, estimate.value("youngs_modulus").value


def _squeeze_trace(
    robot: Robot,
    run: Run,
    moduli: Mapping[str, float],
    ratio: float,
) -> Rows:
    """The last squeeze as measured and as simulated with some moduli."""
    problem, q = cases.squeezed(
        robot,
        run,
        list(moduli.values()),
        ratio,
    )
    prepared = problem.runs[0]
    scale = 1e3 * prepared.drive.transmission
    return {
        "times_s": prepared.times_s.tolist(),
        "measured_mm": (scale * prepared.position).tolist(),
        "moduli_Pa": dict(moduli),
        "simulated_mm": dict(zip(moduli, (scale * q).tolist(), strict=True)),
    }


EFFECTS: Mapping[str, tuple[float, ...]] = {
    "torque": (-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04),
    "friction": (0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    "armature": (-0.5, -0.25, 0.0, 0.25, 0.5),
}
"""What the model is wrong by: relative torque, unmodelled Coulomb friction [N m], relative armature."""
SUBSTEPS = (1, 2, 4, 8, 16, 32, 64)  # per frame of 1/60 s


def effects(seed: int) -> Rows:
    """The mass of the heavy ball when one thing about a robot that is known otherwise is wrong: all samples, one lift."""
    held, facts = payload("heavy ball")
    robot = known_robot()
    run = play("payload_elbow", seed, held, exact=True).runs[LIFT]
    joint = f"joints.{run.joint}.drive_train."
    drive = robot.drive_trains[run.joint]

    def found(
        changed: Robot,
        integrator: str = "rk4",
        step_s: float = 1.0 / 240.0,
    ) -> float:
        """The mass that the lift shows with a changed model.

        Args:
            changed: The robot as the model has it.
            integrator: ``rk4`` or ``semi_implicit``.
            step_s: Of the integration [s].

        Returns:
            The mass [kg].
        """
        options = SearchOptions(integrator=integrator, step_s=step_s)
        fit = solve_load(
            changed, [prepare_run(changed, run, None, facts)], facts, options, Role.FIXED
        )
        return float(fit.values[fit.problem.index["payload_mass"]])

    rows = []
    for effect, amounts in EFFECTS.items():
        for amount in amounts:
            key, value = {
                "torque": (
                    "torque_constant_N_m_per_A",
                    drive.torque_constant.value * (1.0 + amount),
                ),
                "armature": ("armature_kg_m2", drive.armature.value * (1.0 + amount)),
                # the real joint rubs by so much more than the model says
                "friction": ("coulomb_N_m", drive.coulomb.value - amount),
            }[effect]
            mass = found(robot.with_overrides({joint + key: {"value": value, "std": 0.0}}))
            rows.append({"effect": effect, "amount": amount, "error": mass - held.mass_kg})
    for integrator in ("semi_implicit", "rk4"):
        for substeps in SUBSTEPS:
            mass = found(robot, integrator, 1.0 / 60.0 / substeps)
            rows.append({"effect": integrator, "amount": substeps, "error": mass - held.mass_kg})
    return {"rows": rows}


@dataclass(frozen=True)
class Experiment:
    """One of them."""

    run: Callable[[int], Rows]  # seed -> rows
    seeds: int = 1000  # at most so many; the others would show the same again
    alone: bool = False  # nothing else may run meanwhile, because it takes times


_MANY = (objects, starts, sphere, cubes, optimisers, landscapes, tracking, extensions, effects)
EXPERIMENTS = {run.__name__: Experiment(run) for run in _MANY} | {
    "speed": Experiment(speed, seeds=3, alone=True)
}


def experiment(name: str) -> Experiment:
    """The one of that name. Raises `ConfigurationError`: There is none."""
    if name not in EXPERIMENTS:
        raise ConfigurationError(f"--only {name}: choose from {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]
