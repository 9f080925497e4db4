"""Pushes of one joint in which something beside the push is wrong: is what is accepted still right?

    python test/benchmarks/mutated_pushes.py                       # 600 mutated pushes, about 6 minutes
    python test/benchmarks/mutated_pushes.py --count 60 --first 9000 --only "zero of the driven joint"

Arms and loads are drawn at random and simulated in MuJoCo (`random_arm.py`); where ``../shared/recordings`` is there, its three
realistic robots are among the arms. Each arm is calibrated with an empty hand, half of them with a reference, too. Every push is
asked as it is, and again with one thing changed. ``--first`` is the first seed; a seed draws arm, load, push and change.
"""

from __future__ import annotations

import functools
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from coverage import REFERENCE_KG, facts_of
from random_arm import (
    EFFECTS,
    EMPTY_PROBES,
    GRIPPER,
    LOADED_PROBES,
    HiddenRobot,
    Load,
    Probe,
    ball,
    draw_robot,
    record,
)
from results import REPOSITORY, Results, each_answer, parser_of
from ruamel.yaml import YAML
from support import simulated
from support.bends import pushes as bends

from proprio_ros.errors import ProprioError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.kinds import name_of
from proprio_ros.pipeline.calibrate import write_calibration
from proprio_ros.pipeline.loading import bag_recording, runs_or_motion
from proprio_ros.pipeline.request import Request
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Z95
from proprio_ros.records import Recording, Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

RECORDINGS = REPOSITORY.parent / "shared" / "recordings"
LEVELS = ("realistic_s00", "realistic_s01", "hard_s00")
MASSES_KG = (0.01, 0.02, 0.05, 0.1)
DIAMETER_M = 0.03
PUSHES_PER_ARM = 12
TURNING = ("joint2", "joint3", "joint4")
FAR_SD = 3.0


@dataclass(frozen=True)
class Push:
    """A recording of one push, with the truth."""

    recording: Recording
    facts: PayloadFacts
    truth_kg: float
    other_kg: float | None = None  # of a second object in the same bag

    def nearest_kg(self, found: Estimate | str) -> float:
        """The truth to which an answer is nearest: where the run of one of two objects is left out, it is the other's."""
        value = None if isinstance(found, str) else found.values[0].value
        truths = [each for each in (self.truth_kg, self.other_kg) if each is not None]
        return truths[0] if value is None else min(truths, key=lambda kg: abs(kg - value))


@dataclass(frozen=True)
class Arm:
    """A calibrated arm, and how its pushes are drawn."""

    robot: Robot
    pushes: Callable[[np.random.Generator], Push]
    """Draws a push."""
    pair: Callable[[np.random.Generator], tuple[Push, Push]]
    """Draws two of two objects that are stated alike, by one probe."""


@dataclass(frozen=True)
class Asked:
    """What a mutated push is asked: by which robot, of which runs."""

    robot: Robot
    runs: tuple[Run, ...]


# --- arms ---------------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=4)
def drawn_arm(seed: int) -> Arm | None:
    """An arm in MuJoCo; None where its calibration was refused."""
    random = np.random.default_rng((seed, 1))
    hidden = draw_robot(random, EFFECTS)
    file = load_robot("open_manipulator_x")
    known = [LoadedRun(_run(file, _recorded(hidden, each, None, random))) for each in EMPTY_PROBES]
    if seed % 2:
        weight = ball(REFERENCE_KG, 0.04)
        load = KnownLoad(REFERENCE_KG, facts_of(weight))
        for each in (LOADED_PROBES[1], LOADED_PROBES[2], LOADED_PROBES[5]):
            known.append(
                LoadedRun(
                    _run(file, _recorded(hidden, each, weight, random)),
                    load,
                )
            )
    learnt = calibrate(file, known)
    if learnt.calibration is None or learnt.verdict.value != "accepted":
        return None

    def pushed(
        probe: Probe,
        kg: float,
        random: np.random.Generator,
    ) -> Push:
        load = ball(kg, DIAMETER_M)
        return Push(
            _recorded(hidden, probe, load, random),
            facts_of(load),
            kg,
        )

    def push(random: np.random.Generator) -> Push:
        probe = LOADED_PROBES[int(random.integers(len(LOADED_PROBES)))]
        return pushed(probe, float(random.choice(MASSES_KG)), random)

    def pair(random: np.random.Generator) -> tuple[Push, Push]:
        probe = LOADED_PROBES[int(random.integers(len(LOADED_PROBES)))]
        kg = signed(random, 0.005, 0.05)
        factor = random.uniform(1.3, 3.0)
        return pushed(probe, abs(kg), random), pushed(
            probe,
            factor * abs(kg),
            random,
        )

    return Arm(file.with_calibration(learnt.calibration), push, pair)


@functools.lru_cache(maxsize=8)
def recorded_arm(level: str, reference: bool) -> Arm:
    """One of the robots whose recordings lie beside the clone."""
    file = load_robot("open_manipulator_x")
    known = simulated.empty_runs(RECORDINGS / level, file)
    if reference:
        known += simulated.reference_runs(RECORDINGS / level, file)
    calibration = calibrate(file, known).calibration
    assert calibration is not None
    robot = file.with_calibration(calibration)

    @functools.cache
    def push_in(folder: Path) -> Push:
        recording = bag_recording(simulated.bag_in(folder), Request(robot))
        truth = simulated.truth_of(folder)
        return Push(
            recording,
            simulated.facts_of(folder),
            truth["payload"]["mass"],
        )

    def push(random: np.random.Generator) -> Push:
        folders = [
            folder
            for folder in simulated.fixed(RECORDINGS, level)
            if not (reference and folder.name in simulated.REFERENCES)
        ]
        return push_in(folders[int(random.integers(len(folders)))])

    def pair(random: np.random.Generator) -> tuple[Push, Push]:
        ways = ("joint3", "joint2_x3", "joint3_x1", "joint3_x0")
        way = ways[int(random.integers(len(ways)))]
        names = [f"fixed_{what}_ball_{kg}g_{way}" for what, kg in (("heavy", 50), ("light", 20))]
        if not all((RECORDINGS / level / name).is_dir() for name in names):
            names = [f"fixed_heavy_cube_23g_{way}", f"fixed_random_a_{way}"]
        one, other = (push_in(RECORDINGS / level / name) for name in names)
        return one, replace(other, facts=one.facts)

    return Arm(robot, push, pair)


def _recorded(
    hidden: HiddenRobot,
    probe: Probe,
    load: Load | None,
    random: np.random.Generator,
) -> Recording:
    return record(
        hidden,
        probe.joint,
        probe.start,
        probe.current_A,
        probe.duration_s,
        load,
        random,
    )


def _run(robot: Robot, recording: Recording) -> Run:
    return runs_of(robot, recording)[0]


def runs_of(
    robot: Robot,
    recording: Recording,
) -> tuple[Run, ...]:
    """As `replay` cuts them out; raises `ProprioError` as it does."""
    found = runs_or_motion(recording, Request(robot))
    if found.motions:
        raise ProprioError("a motion, and no push")
    return found.runs


# --- what is wrong ------------------------------------------------------------------------------------------------------


def signed(
    random: np.random.Generator,
    low: float,
    high: float,
) -> float:
    """A size between two, even in its logarithm, of either sign."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))) * random.choice((-1.0, 1.0)))


def driven_of(push: Push) -> str:
    inputs = push.recording.inputs
    assert inputs is not None
    return inputs.names[int(np.abs(inputs.current_A).max(axis=0).argmax())]


def held_of(push: Push, random: np.random.Generator) -> str:
    """A joint that is held and turns the hand against gravity."""
    others = [name for name in TURNING if name != driven_of(push)]
    return others[int(random.integers(len(others)))]


def of_recording(
    bend: Callable[[Push, np.random.Generator], Recording],
) -> Callable[[Arm, np.random.Generator], tuple[Asked, Push]]:
    def asked(
        arm: Arm,
        random: np.random.Generator,
    ) -> tuple[Asked, Push]:
        push = arm.pushes(random)
        return Asked(
            arm.robot,
            runs_of(arm.robot, bend(push, random)),
        ), push

    return asked


def zero_of_driven(push: Push, random: np.random.Generator) -> Recording:
    return bends.zero_off(
        push.recording,
        driven_of(push),
        signed(random, 0.005, 0.1),
    )


def zero_of_held(push: Push, random: np.random.Generator) -> Recording:
    return bends.zero_off(
        push.recording,
        held_of(push, random),
        signed(random, 0.005, 0.1),
    )


def held_elsewhere(push: Push, random: np.random.Generator) -> Recording:
    return bends.zero_off(
        push.recording,
        held_of(push, random),
        signed(random, 0.2, 1.5),
    )


def step_of_driven(push: Push, random: np.random.Generator) -> Recording:
    at_s = random.uniform(0.05, 0.55)
    return bends.step(
        push.recording,
        driven_of(push),
        signed(random, 0.005, 0.05),
        at_s,
    )


def step_of_held(push: Push, random: np.random.Generator) -> Recording:
    at_s = random.uniform(0.05, 0.55)
    return bends.step(
        push.recording,
        held_of(push, random),
        signed(random, 0.005, 0.05),
        at_s,
    )


def scaled(push: Push, random: np.random.Generator) -> Recording:
    factor = np.exp(signed(random, np.log(1.05), np.log(2.0)))
    return bends.scaled_command(push.recording, factor)


def noisy(push: Push, random: np.random.Generator) -> Recording:
    std_A = random.uniform(0.002, 0.02)
    return bends.noisy_command(push.recording, std_A, random)


def scaled_and_noisy(push: Push, random: np.random.Generator) -> Recording:
    return bends.noisy_command(
        replace(push, recording=scaled(push, random)).recording,
        random.uniform(0.002, 0.02),
        random,
    )


def swapped(push: Push, random: np.random.Generator) -> Recording:
    return bends.swapped(
        push.recording,
        driven_of(push),
        held_of(push, random),
    )


def other_command(push: Push, random: np.random.Generator) -> Recording:
    return bends.command_of(push.recording, held_of(push, random))


def no_finger(push: Push, random: np.random.Generator) -> Recording:
    return bends.without_joint(push.recording, GRIPPER)


def merged(
    arm: Arm,
    random: np.random.Generator,
) -> tuple[Asked, Push]:
    """All that the calibration knows of one joint, or of two, is another arm's, by its file."""
    asked, push = merged_in_memory(arm, random)
    assert arm.robot.calibration is not None and asked.robot.calibration is not None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "merged.yaml"
        write_calibration(file, load_robot("open_manipulator_x"), arm.robot.calibration)
        yaml = YAML()
        content = yaml.load(file.read_text())
        unknowns = content["calibration"]["unknowns"]
        for key, known in asked.robot.calibration.quantities.items():
            unknowns[name_of(key)].update(
                value=known.value,
                std=known.std,
            )
        with file.open("w") as stream:
            yaml.dump(content, stream)
        return replace(asked, robot=load_robot(file)), push


def merged_in_memory(
    arm: Arm,
    random: np.random.Generator,
) -> tuple[Asked, Push]:
    """The same where no file says what was written."""
    other = None
    while other is None:
        other = drawn_arm(int(random.integers(10**6)))
    assert arm.robot.calibration is not None and other.robot.calibration is not None
    calibration = arm.robot.calibration
    for joint in random.choice(
        TURNING,
        int(random.integers(1, 3)),
        replace=False,
    ).tolist():
        calibration = bends.merged(calibration, other.robot.calibration, joint)
    file = load_robot("open_manipulator_x")
    push = arm.pushes(random)
    robot = file.with_calibration(calibration)
    return Asked(robot, runs_of(robot, push.recording)), push


def two_objects(
    arm: Arm,
    random: np.random.Generator,
) -> tuple[Asked, Push]:
    """Two runs of one bag, each of another object: no answer is right of both, and the nearer counts."""
    one, other = arm.pair(random)
    runs = tuple(
        replace(run, name=f"bag#{number}")
        for number, push in enumerate((one, other), start=1)
        for run in runs_of(arm.robot, push.recording)
    )
    return Asked(arm.robot, runs), replace(one, other_kg=other.truth_kg)


KINDS: dict[str, Callable[[Arm, np.random.Generator], tuple[Asked, Push]]] = {
    "zero of the driven joint": of_recording(zero_of_driven),
    "zero of a held joint": of_recording(zero_of_held),
    "step of the driven joint": of_recording(step_of_driven),
    "step of a held joint": of_recording(step_of_held),
    "command scaled": of_recording(scaled),
    "command noisy": of_recording(noisy),
    "command scaled and noisy": of_recording(scaled_and_noisy),
    "merged calibrations": merged,
    "two objects": two_objects,
    "held joint elsewhere": of_recording(held_elsewhere),
    "columns of two joints swapped": of_recording(swapped),
    "command of another joint": of_recording(other_command),
    "finger missing": of_recording(no_finger),
    "merged calibrations, digest deleted": merged_in_memory,
}


# --- what is answered ---------------------------------------------------------------------------------------------------


@dataclass
class Tally:
    """Answers of one kind."""

    asked: int = 0
    accepted: int = 0
    hold: int = 0
    far: int = 0
    # of those that are far, how many give an interval for zeros that moved, which holds
    moved: int = 0
    farthest: float = 0.0
    codes: dict[str, int] | None = None
    errors: list[float] = field(default_factory=list)  # [g]
    halves: list[float] = field(default_factory=list)  # [g]

    def add(
        self,
        estimate: Estimate | str,
        truth_kg: float,
    ) -> float | None:
        """By how many standard deviations an accepted answer is off; None where there is none."""
        self.asked += 1
        self.codes = self.codes or {}
        if isinstance(estimate, str) or estimate.verdict.value != "accepted":
            code = estimate if isinstance(estimate, str) else estimate.reasons[0].code
            self.codes[code] = self.codes.get(code, 0) + 1
            return None
        mass = estimate.values[0]
        low, high = mass.ci95
        off = abs(mass.value - truth_kg) / (max(high - mass.value, mass.value - low) / Z95)
        self.accepted += 1
        self.errors.append(1e3 * (mass.value - truth_kg))
        self.halves.append(1e3 * max(high - mass.value, mass.value - low))
        self.hold += low <= truth_kg <= high
        self.far += off > FAR_SD
        lowest, highest = mass.if_zeros_moved or (low, high)
        self.moved += off > FAR_SD and lowest <= truth_kg <= highest
        self.farthest = max(self.farthest, off)
        return float(off)

    def row(self, kind: str) -> dict[str, object]:
        codes = sorted(
            (self.codes or {}).items(),
            key=lambda entry: -entry[1],
        )
        refused = ", ".join(f"{code} {count}" for code, count in codes)
        return {
            "kind": kind, "asked": self.asked, "accepted": self.accepted, "hold": self.hold,
            "far": self.far, "moved": self.moved, "farthest": self.farthest, "codes": refused,
            **each_answer(self.errors, self.halves),
        }  # fmt: skip


def answer(asked: Asked, facts: PayloadFacts) -> Estimate | str:
    """The answer, or why there is none."""
    try:
        return weigh(asked.robot, asked.runs, facts)
    except ProprioError as error:
        return type(error).__name__


def arm_of(seed: int, with_recordings: bool) -> Arm | None:
    """The arm of a seed; every fifth is a recorded one where these are there."""
    if with_recordings and seed % 5 == 0:
        return recorded_arm(
            LEVELS[seed // 5 % 3],
            bool(seed % 2),
        )
    return drawn_arm(seed)


def cases(
    first: int, count: int, kinds: Sequence[str], with_recordings: bool
) -> Iterator[tuple[str, Arm, np.random.Generator]]:
    """Kind, arm and what draws the rest."""
    made = 0
    group = 0
    while made < count:
        arm = arm_of(first + group, with_recordings)
        for number in range(PUSHES_PER_ARM if arm is not None else 0):
            random = np.random.default_rng((first + group, 2, number))
            yield kinds[made % len(kinds)], arm, random
            made += 1
        group += 1


def main(arguments: Sequence[str] | None = None) -> None:
    """One row for each kind, and one for the pushes as they were."""
    parser = parser_of(__doc__)
    parser.add_argument("--count", type=int, default=600, help="of mutated pushes")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=list(KINDS),
        default=list(KINDS)[:-1],
    )
    parser.add_argument("--show", action="store_true", help="print every answer that is far off")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    tallies = {kind: Tally() for kind in options.only}
    unmutated = Tally()
    halves_g = []
    for kind, arm, random in cases(
        options.first,
        options.count,
        options.only,
        RECORDINGS.is_dir(),
    ):
        state = random.bit_generator.state
        found, push = ask_mutated(kind, arm, random)
        random.bit_generator.state = state
        if kind != "two objects":
            push = push if kind.startswith("merged") and push else arm.pushes(random)
            half_g = ask_unmutated(arm, push, unmutated)
            if half_g is not None:
                halves_g.append(half_g)
        judge(found, push, tallies[kind], kind if options.show else None)
    tell(results, tallies, unmutated, float(np.median(halves_g or [np.nan])))
    results.keep()


def ask_mutated(
    kind: str, arm: Arm, random: np.random.Generator
) -> tuple[Estimate | str, Push | None]:
    """Weighs by pushes of which something is wrong.

    Args:
        kind: What is wrong.
        arm: Who pushes.
        random: Draws the pushes, and how they are changed.

    Returns:
        The answer, or why there is none; and the pushes, None where they cannot be made.
    """
    push = None
    try:
        asked, push = KINDS[kind](arm, random)
        return answer(asked, push.facts), push
    except ProprioError as error:
        return getattr(error, "code", type(error).__name__), push


def ask_unmutated(arm: Arm, push: Push, tally: Tally) -> float | None:
    """Weighs by the same pushes as they were; half the answer's interval [g], None without an answer."""
    asked = Asked(arm.robot, runs_of(arm.robot, push.recording))
    plain = answer(asked, push.facts)
    if tally.add(plain, push.truth_kg) is None:
        return None
    low, high = plain.values[0].ci95
    return 0.5e3 * (high - low)


def judge(found: Estimate | str, push: Push | None, tally: Tally, shown_as: str | None) -> None:
    """Counts an answer.

    Args:
        found: The answer, or why there is none.
        push: By which it was weighed.
        tally: Counts it.
        shown_as: The kind, where an answer that is far off is to be printed.
    """
    truth_kg = push.nearest_kg(found) if push is not None else 0.0
    off = tally.add(found, truth_kg)
    if shown_as is not None and off is not None and off > FAR_SD:
        value = found.values[0]
        print(
            f"{shown_as}: {1e3 * value.value:.1f} +- {1e3 * value.std:.1f} g of {1e3 * truth_kg:.1f} g, "
            f"{off:.1f} sd, {push.recording.name}, {[r.code for r in found.reasons]}"
        )


def tell(
    results: Results,
    tallies: Mapping[str, Tally],
    unmutated: Tally,
    half_g: float,
) -> None:
    """A row for each kind, one for all, and one for the pushes as they were.

    Args:
        results: Has the table.
        tallies: By kind.
        unmutated: Of the pushes as they were.
        half_g: Their median half interval [g].
    """
    results.table(
        "mutated pushes",
        {
            "what is wrong": "{kind}",
            "accepted": "{accepted} of {asked}",
            "interval holds": "{hold}",
            "beyond 3 sd": "{far}",
            "of these within `if_zeros_moved`": "{moved}",
            "farthest, sd": "{farthest:.1f}",
            "refused because": "{codes}",
        },
    )
    whole = Tally()
    for kind, tally in tallies.items():
        results.row("mutated pushes", **tally.row(kind))
        for name in ("asked", "accepted", "hold", "far", "moved", "errors", "halves"):
            setattr(
                whole,
                name,
                getattr(whole, name) + getattr(tally, name),
            )
        whole.farthest = max(whole.farthest, tally.farthest)
    results.row("mutated pushes", **whole.row("all"))
    results.row("mutated pushes", **unmutated.row("nothing"), half_g=half_g)
    print(f"median half interval of the pushes as they were: {half_g:.2f} g")


if __name__ == "__main__":
    main()
