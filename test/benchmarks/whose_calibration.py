"""What is said of a recording of one joint by a calibration of another servo, another arm or another gain.

Real servos that were let go (STS3215 at 0.10 m, two repetitions, and STS3250 at 0.15 m) by each other's calibrations of two and
three loads; real servos under their own controllers (STS3215; XL330 at gains of 100 and 400) by the other's and the other gain's;
and both kinds simulated by MuJoCo, machines drawn at random, each asked by the calibration of every other one, and with arm or gain
changed since. Beside them the right pairs: a right one is to be answered and to hold, another one is to be refused.

    python test/benchmarks/whose_calibration.py [--parts real_swings real_driven swings driven] [--machines 6] [--first 900]
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import servos
from real import STS_DRIVE, STS_KG, XL330_DRIVE, XL330_KG, pendulum
from results import Results, each_answer, parser_of
from support import differing
from support.machines import REAL, pendulum_urdf
from support.servo_bag import write

from proprio_ros.calibration_files.one_joint import FEWEST_RUNS, JointCalibration
from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.regression.one_joint_known import learn_joint
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.loading import bag_motion, bag_runs
from proprio_ros.pipeline.request import Options, Request
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.probes.payload.known_joint import identify_known_joint
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

DISC = PayloadFacts(
    shape=PayloadShape.from_inertia_per_mass([0.00255, 0.00255, 0.00255, 0.0, 0.0, 0.0])
)
POINT = PayloadFacts(shape=PayloadShape.of("point", None))
FAR_SIGMAS = 3.0
LET_GO = {"sts3215_release": 0.1, "sts3215_release_again": 0.1, "sts3250_release": 0.15}
"""Recordings of each rig, and its arm [m]."""
ARMS = (0.6, 1.5)
GAINS = (0.5, 0.75, 1.5, 2.0)
KNOWN_KG = (0.5, 0.8, 1.1)
BETWEEN_KG = (0.35, 1.5)
XL330_GAINS = {"kp100": 0.5755, "kp400": 2.302}
"""Duty cycle per rad: gain over 128, 651.9 counts a rad, 885 counts of duty cycle (ROBOTIS e-manual, XL330-M288)."""


@dataclass(frozen=True)
class Answer:
    """To one question."""

    row: str
    right: bool  # whether the calibration is of the joint as it is
    truth_kg: float
    value_kg: float | None  # None where it is withheld
    low_kg: float
    high_kg: float
    code: str  # of the first reason, or of an error

    @property
    def holds(self) -> bool:
        return self.low_kg <= self.truth_kg <= self.high_kg

    @property
    def sigmas(self) -> float:
        """How far off, in standard deviations of the interval."""
        assert self.value_kg is not None
        half = max(
            self.high_kg - self.value_kg,
            self.value_kg - self.low_kg,
        )
        return Z95 * abs(self.value_kg - self.truth_kg) / half


def asked(
    row: str,
    right: bool,
    truth_kg: float,
    ask: Callable[[], Estimate],
) -> Answer:
    """One question and what came out."""
    refused = (None, np.nan, np.nan)
    try:
        estimate = ask()
    except ProprioError as error:
        return Answer(
            row,
            right,
            truth_kg,
            *refused,
            type(error).__name__,
        )
    mass = estimate.values[0]
    code = getattr(estimate.reasons[0], "code", "other") if estimate.reasons else ""
    if not isinstance(mass.value, float):
        return Answer(row, right, truth_kg, *refused, code)
    low, high = mass.ci95
    return Answer(
        row,
        right,
        truth_kg,
        mass.value,
        low,
        high,
        code,
    )


# --- let go ------------------------------------------------------------------------------------------------------------


def swung_calibration(
    robot: Robot,
    known: Sequence[tuple[Run, float]],
) -> Robot:
    """The robot as swings with known loads show it.

    Raises `RecordingError`: They are no calibration.
    """
    learnt = calibrate(
        robot,
        [LoadedRun(run, KnownLoad(kg, DISC)) for run, kg in known],
    )
    if learnt.calibration is None or learnt.verdict.value != "accepted":
        raise RecordingError("; ".join(learnt.reasons))
    return robot.with_calibration(learnt.calibration)


def real_swings(options: Any, folder: Path) -> Iterator[Answer]:
    """Of the real servos that were let go, by every set of two and three loads."""
    drive = "torque_constant_N_m_per_A: {value: 1.0, std: 0.5}"
    robots = {}
    runs = {}
    for rig, arm_m in LET_GO.items():
        robots[rig] = load_robot(pendulum(folder, rig, 0.001, arm_m, drive))
        request = Request(robots[rig], Options())
        for kg in STS_KG:
            (runs[rig, kg],) = bag_runs(
                options.recordings / f"{rig}_{kg:.3f}kg",
                request,
            )
    sets = [known for count in (2, 3) for known in itertools.combinations(STS_KG, count)]
    for rig, known in itertools.product(LET_GO, sets[:: options.every]):
        robot = swung_calibration(
            robots[rig],
            [(runs[rig, kg], kg) for kg in known],
        )
        for (asked_rig, kg), run in runs.items():
            if asked_rig == rig and kg in known:
                continue
            right = LET_GO[asked_rig] == LET_GO[rig]
            row = f"real, let go, {'the same servo' if right else 'another servo and arm'}"
            yield asked(
                row,
                right,
                kg,
                partial(weigh, robot, [run], DISC),
            )


def longer_arm(
    machine: differing.Pendulum,
    load_kg: float,
    times: float,
) -> Run:
    """A swing of the same drive train with an arm so many times as long."""
    usual = differing.ARM_M
    differing.ARM_M = times * usual
    try:
        return machine.released("asked", load_kg)
    finally:
        differing.ARM_M = usual


def swings(options: Any, folder: Path) -> Iterator[Answer]:
    """Of simulated pendulums, by the calibration of each."""
    robot = differing.pendulum_in(folder)
    machines = []
    calibrated = []
    questions = []
    for seed in range(options.first, options.first + options.machines):
        machine = differing.Pendulum(seed)
        known = [(machine.released(f"known {kg}", kg), kg) for kg in KNOWN_KG]
        try:
            calibrated.append(swung_calibration(robot, known))
        except RecordingError as error:
            print(f"pendulum {seed}: {error}", file=sys.stderr)
            continue
        machines.append(machine)
        load_kg = float(machine.rng.uniform(*BETWEEN_KG))
        questions.append((load_kg, machine.released("asked", load_kg)))
    for one, by in enumerate(calibrated):
        for other, (load_kg, run) in enumerate(questions):
            row = "simulated, let go, " + ("the same servo" if one == other else "another servo")
            ask = partial(weigh, by, [run], DISC)
            yield asked(row, one == other, load_kg, ask)
    for machine, by in zip(machines, calibrated, strict=True):
        for times in ARMS:
            load_kg = float(machine.rng.uniform(*BETWEEN_KG))
            run = longer_arm(machine, load_kg, times)
            row = f"simulated, let go, its arm {times:g} times as long"
            yield asked(
                row,
                False,
                load_kg,
                partial(weigh, by, [run], DISC),
            )


# --- under their own controllers ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Driven:
    """A robot file of a servo, and motions as it has them."""

    robot: Robot
    facts: PayloadFacts
    motions: dict[str, tuple[Motion, float]]  # each with its load [kg], by name

    def calibration(self, names: Sequence[str]) -> JointCalibration:
        """By some of them."""
        motions, loads_kg = zip(
            *(self.motions[name] for name in names),
            strict=True,
        )
        return learn_joint(self.robot, motions, loads_kg, self.facts)

    def ask(
        self,
        row: str,
        right: bool,
        name: str,
        by: JointCalibration,
    ) -> Answer:
        """One of them by a calibration."""
        motion, load_kg = self.motions[name]
        return asked(
            row, right, load_kg, lambda: identify_known_joint(self.robot, [motion], by, self.facts)
        )


def servo_file(
    folder: Path,
    name: str,
    driven_by: str,
    delay: str,
) -> Robot:
    """A real servo's, with its law."""
    path = pendulum(folder, name, 0.001, 0.1, "torque_constant_N_m_per_A: {value: 1.0, std: 0.4}")
    motor = f"resistance_ohm: 2.68, back_emf_V_s_per_rad: 1.0, driven_by: {driven_by}, "
    text = path.read_text().replace("motor: {", "motor: {" + motor)
    path.write_text(text.replace("joints:", f"delay_s: {delay}\njoints:"))
    return load_robot(path)


def real_driven(options: Any, folder: Path) -> Iterator[Answer]:
    """Of the real servos under their own controllers: each motion by all others, by the other servo's, by the other gain's."""
    taken = {
        name: its
        for name, its in weighed_bags(options.recordings).items()
        if "release" not in name and "lift" not in name
    }
    for name, (law, delay, facts) in laws().items():
        robot = servo_file(folder, name, law, delay)
        request = Request(robot, Options())
        motions = {each: (bag_motion(bag, request), kg) for each, (bag, kg) in taken.items()}
        driven = Driven(robot, facts, motions)
        own = [each for each in motions if each.startswith(name)]
        for each in own:
            rest = [other for other in own if other != each]
            if len(rest) >= FEWEST_RUNS:
                by = driven.calibration(rest)
                yield driven.ask("real, driven, the same servo and gain", True, each, by)
        by = driven.calibration(own)
        for each in motions:
            if each not in own:
                same = each.startswith("xl330") and name.startswith("xl330")
                row = f"real, driven, another {'gain' if same else 'servo'}"
                yield driven.ask(row, False, each, by)


def weighed_bags(recordings: Path) -> dict[str, tuple[Path, float]]:
    """The bags of both servos, and the masses in them [kg]."""
    bags = {}
    for bag in sorted(recordings.glob("xl330_*")):
        bags[bag.name] = (bag, XL330_KG)
    for bag in sorted(recordings.glob("sts3215_*kg")):
        bags[bag.name] = (bag, float(bag.name.rpartition("_")[2].removesuffix("kg")))
    return bags


def laws() -> dict[str, tuple[str, str, Any]]:
    """What drives each servo, its delay in words [s], and the shape of its loads."""
    found = {
        "xl330": (XL330_DRIVE, "0.0", POINT),
        "sts3215": (STS_DRIVE, "0.02", DISC),
    }
    for gain, per_rad in XL330_GAINS.items():
        drive = f"{{kind: position_servo, gain_per_rad: {per_rad}}}"
        found[f"xl330_{gain}"] = (drive, "0.0", POINT)
    return found


def moved(servo: servos.Servo, load_kg: float, rng: np.random.Generator, **changed: float) -> Any:
    """A simulated servo's motion, with its arm or gain so many times as large."""
    usual = {"ARM_M": servos.ARM_M, "GAIN": servos.GAIN}
    for name, times in changed.items():
        setattr(servos, name, times * usual[name])
    try:
        return servo.moved(load_kg, rng, 100.0)
    finally:
        for name, value in usual.items():
            setattr(servos, name, value)


THE_SAME = "the same servo and gain"


def driven(options: Any, folder: Path) -> Iterator[Answer]:
    """Of simulated servos, by the calibration of each."""
    pendulum_urdf(folder, "servo", servos.ROD_KG, servos.ARM_M)
    (folder / "servo.yaml").write_text(servos.FILE)
    robot = load_robot(folder / "servo.yaml")
    numbers = itertools.count()

    def motions(by: Robot, machine: Machine, names: Iterable[str]) -> Driven:
        """Some motions of a machine, as that robot reads them."""
        read = {}
        for name in names:
            rows, kg = machine.rows[name]
            bag = write(folder / f"bag{next(numbers)}", rows)
            read[name] = (bag_motion(bag, Request(by, Options())), kg)
        return Driven(by, POINT, read)

    machines = [
        machine_of(robot, seed) for seed in range(options.first, options.first + options.machines)
    ]
    for machine in machines:
        own = motions(machine.robot, machine, machine.rows)
        by = own.calibration([name for name in own.motions if name.startswith("known")])
        for name in own.motions:
            if not name.startswith("known"):
                yield own.ask(f"simulated, driven, {name}", name == THE_SAME, name, by)
        for other in machines:
            if other is not machine:
                alien = motions(machine.robot, other, [THE_SAME])
                yield alien.ask("simulated, driven, another servo", False, THE_SAME, by)


@dataclass(frozen=True)
class Machine:
    """A simulated servo.

    Attributes:
        robot: What is known of it, with its own delay.
        rows: Motions with known loads, and with it as it is or changed; and their masses [kg].
    """

    robot: Robot
    rows: dict[str, tuple[Any, float]]


def machine_of(robot: Robot, seed: int) -> Machine:
    """A servo drawn at random, and its motions."""
    rng = np.random.default_rng([seed, 57])
    servo = servos.Servo(rng)
    delay = replace(robot.delay, value=servo.delay_s, std=0.0)
    rows = {
        f"known {n}": (moved(servo, kg, rng), kg)
        for n, kg in enumerate((*servos.KNOWN_KG, *servos.KNOWN_KG))
    }
    changes: dict[str, dict[str, float]] = {
        THE_SAME: {},
        **{f"its gain {times:g} times as large": {"GAIN": times} for times in GAINS},
        **{f"its arm {times:g} times as long": {"ARM_M": times} for times in ARMS},
    }
    for name, changed in changes.items():
        kg = float(rng.uniform(0.2, 1.2))
        rows[name] = (moved(servo, kg, rng, **changed), kg)
    return Machine(replace(robot, delay=delay), rows)


PARTS = {each.__name__: each for each in (real_swings, real_driven, swings, driven)}


def figures(
    row: str,
    answers: Sequence[Answer],
) -> dict[str, Any]:
    """Numbers of a row."""
    given = [answer for answer in answers if answer.value_kg is not None]
    codes = Counter(answer.code for answer in answers if answer.value_kg is None)
    said = ", ".join(f"{code} {count}" for code, count in codes.most_common())
    return {
        "pair": row,
        "right": "yes" if answers[0].right else "no",
        "questions": len(answers),
        "answered": len(given),
        "hold": sum(answer.holds for answer in given),
        "far": sum(answer.sigmas > FAR_SIGMAS for answer in given),
        "farthest": max((answer.sigmas for answer in given), default=None),
        "codes": said or "none",
        **each_answer(
            [1e3 * (answer.value_kg - answer.truth_kg) for answer in given],
            [1e3 * (answer.high_kg - answer.value_kg) for answer in given],
        ),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """One row for each kind of pair."""
    parser = parser_of(__doc__)
    parser.add_argument("--recordings", type=Path, default=REAL)
    parser.add_argument(
        "--parts",
        nargs="+",
        default=list(PARTS),
        choices=list(PARTS),
    )
    parser.add_argument("--machines", type=int, default=6, help="simulated ones of each kind")
    parser.add_argument("--first", type=int, default=900, help="first seed")
    parser.add_argument("--every", type=int, default=1, help="which sets of known loads are taken")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    results.table(
        "pairs",
        {
            "recording of": "{pair}",
            "right": "{right}",
            "questions": "{questions}",
            "answered": "{answered}",
            "intervals that hold": "{hold}",
            "more than 3 sd off": "{far}",
            "farthest, in sd": "{farthest:.1f}",
            "refused as": "{codes}",
        },
    )
    for name in options.parts:
        with tempfile.TemporaryDirectory() as folder:
            answers = list(PARTS[name](options, Path(folder)))
        for row in dict.fromkeys(answer.row for answer in answers):
            its = [answer for answer in answers if answer.row == row]
            results.row("pairs", **figures(row, its))
    results.keep()


if __name__ == "__main__":
    main()
