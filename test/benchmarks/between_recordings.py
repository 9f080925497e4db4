"""Do intervals hold where recordings differ from each other as those of real machines do?

    python test/benchmarks/between_recordings.py [--arms 24] [--servos 12] [--pendulums 16] [--jobs 2]    # 6 min on two cores
    python test/benchmarks/between_recordings.py --arms 200 --servos 100 --pendulums 100                 # all; an hour and a half

The protocol, for other tools, too. Machines are drawn at random and moved by MuJoCo (`support/differing.py`). Every recording has
of its own: the torque's scale (3 %: 2.6 % in common, 1.5 % of each joint), friction (20 %), the zero of each joint (5 mrad) and an
offset of its torque (10 % of its Coulomb friction). Nothing of that is told.

* Arms (six joints and 12 kg, four joints and 0.6 kg in turn) move under a computed-torque controller for 12 s in each recording.
  Known are one empty recording, three, one and one with a known load, or three and three. Asked are a load that nobody stated,
  nothing, and both where the middle of the motion is 0.7 rad away in every joint and 1.4 times as fast. "As a minute later" differs
  in a quarter of the friction alone, but all efforts of what is asked are 3, 5 and 10 % larger; the last is over three times as
  much as recordings differ by, and shows where intervals end to hold.
* Arms of three joints with much dry friction, which goes with the place, calibrated by one empty recording; 1 kg and nothing are
  asked where the calibration moved, and 0.7 and 1.2 rad away.
* Servos under their own position law (`servos.py`), two motions with each of three loads known.
* Pendulums that are let go, two loads known; then the same with the horn put on anew, 0.1 to 0.17 rad off.
* Recordings of other people's real machines, where they are at hand, calibrated by others of the same machine or bent on purpose.

An answer holds where its 95 % interval has the truth in it. "Sd" are half widths over 1.96. Widths are medians, in % of what is
held or, of nothing, in g. What was refused is counted by the code of the first reason.
"""

from __future__ import annotations

import itertools
import os
import tempfile
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from real import STS_KG, UR10E_KG, cut, pendulum, ur10e_file
from results import Results, each_answer, parser_of
from scipy.stats import binomtest
from servos import FILE, KNOWN_KG, POINT, Servo
from support.arm_in_motion import FOUR, SIX, THREE, Twin, write_robot
from support.copied_bag import TYPES, copying
from support.differing import (
    FRICTION,
    SPREAD_M2,
    ZERO_RAD,
    DifferingArm,
    Pendulum,
    differs,
    louder,
    pendulum_in,
)
from support.machines import REAL, pendulum_urdf
from support.servo_bag import write

from proprio_ros.errors import ProprioError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.regression.motion_equations import once_each
from proprio_ros.identification.regression.motion_estimate import calibrate_motions
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.quantity import Z95
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

ARM_SECONDS = 12.0
WARMER = (1.03, 1.05, 1.1)
DISC: dict[str, Any] = {
    "payload.com": [0.0, 0.0, 0.0],
    "payload.inertia_per_mass": [SPREAD_M2 + 5e-5] * 3 + [0.0] * 3,
}
"""The discs of the STS3215, as `real.py` states them."""
NOTHING_OFF = ("accepted", "too_wide")


@dataclass(frozen=True)
class Answer:
    """One question and what came out.

    Attributes:
        row: Of the table.
        truth: [kg].
        value, low, high: [kg]; None where it was withheld.
        verdict: In a word.
        code: Of the first reason, or the error's kind.
        asked: In words.
    """

    row: str
    truth: float
    value: float | None
    low: float
    high: float
    verdict: str
    code: str
    asked: str = ""

    @property
    def given(self) -> bool:
        return self.value is not None and self.verdict in NOTHING_OFF

    @property
    def holds(self) -> bool:
        return self.low <= self.truth <= self.high

    @property
    def sigmas(self) -> float:
        """How far off in standard deviations of the interval: towards the truth, since one that ends at nothing is short there."""
        assert self.value is not None
        half = self.high - self.value if self.truth > self.value else self.value - self.low
        # an interval that ends at nothing has no lower half
        half = max(half, self.high - self.value) if self.low == 0.0 else half
        return Z95 * abs(self.value - self.truth) / max(half, 1e-12)


def said(
    row: str,
    truth: float,
    ask: Callable[[], Estimate],
    asked: str = "",
) -> Answer:
    """An answer, or why there is none."""
    try:
        estimate = ask()
    except ProprioError as error:
        code = "calibration refused" if type(error) is ProprioError else type(error).__name__
        return Answer(
            row,
            truth,
            None,
            np.nan,
            np.nan,
            "error",
            code,
            f"{asked}: {error}",
        )
    mass = estimate.values[0]
    code = getattr(estimate.reasons[0], "code", "other") if estimate.reasons else ""
    low, high = mass.ci95 if isinstance(mass.value, float) else (np.nan, np.nan)
    value = mass.value if isinstance(mass.value, float) else None
    words = f"{asked}: {'; '.join(estimate.reasons)}" if estimate.reasons else asked
    return Answer(
        row,
        truth,
        value,
        low,
        high,
        estimate.verdict.value,
        code,
        words,
    )


def _learnt(
    robot: Robot,
    empty: Sequence[Motion],
    known: Sequence[tuple[Motion, float]] = (),
) -> Robot:
    """The robot with a calibration.

    Raises:
        ProprioError: It is refused.
    """
    estimate = calibrate_motions(robot, empty, known)
    if estimate.motion is None or estimate.verdict.value != "accepted":
        raise ProprioError(f"calibration {estimate.verdict.value}: {'; '.join(estimate.reasons)}")
    return replace(robot, motion_calibration=estimate.motion)


def _learnt_or_error(
    robot: Robot,
    empty: Sequence[Motion],
    known: Sequence[tuple[Motion, float]] = (),
) -> Robot | ProprioError:
    """As `_learnt`, with the error in its place."""
    try:
        return _learnt(robot, empty, known)
    except ProprioError as error:
        return error


@once_each()
def arm_answers(seed: int) -> list[Answer]:
    """One arm's."""
    build = (SIX, FOUR)[seed % 2]
    arm = DifferingArm(seed, build, ARM_SECONDS)
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(write_robot(Path(folder), build=build))
    empty = [arm.recorded(f"empty {n}") for n in range(3)]
    known = _known(arm, 3)
    load = arm.held()
    asked = _asked(arm, load)
    answers = []
    for name, empties, references in (
        ("1 empty", empty[:1], []),
        ("3 empty", empty, []),
        ("1 empty, 1 load", empty[:1], known[:1]),
        ("3 empty, 3 loads", empty, known),
    ):
        calibrated = _learnt_or_error(robot, empties, references)
        for words, (truth, motion) in asked.items():
            answers.append(
                said(f"arm, {name}{words}", truth, _of_motion(calibrated, motion), f"arm {seed}")
            )
    return answers + _warmer_answers(robot, arm, load)


def _warmer_answers(
    robot: Robot,
    arm: DifferingArm,
    load: tuple[float, np.ndarray],
) -> list[Answer]:
    """A recording with a load and one without it from a minute before, the efforts of the first off by as much as `WARMER`."""
    before = arm.recorded("before", alike=True)
    later = arm.recorded("later", load, alike=True)
    return [
        said(
            f"arm, as a minute later, efforts {by:g} times",
            load[0],
            lambda by=by: identify_in_motion(robot, [louder(later, by)], [before], PayloadFacts()),
            f"arm {arm.twin.seed}",
        )
        for by in WARMER
    ]


def _known(arm: DifferingArm, count: int) -> list[tuple[Motion, float]]:
    """So many recordings with a load each, and its mass [kg]."""
    known = []
    for n in range(count):
        held = arm.held()
        known.append((arm.recorded(f"known {n}", held), held[0]))
    return known


def _asked(arm: DifferingArm, load: tuple[float, np.ndarray]) -> dict[str, tuple[float, Motion]]:
    """What an arm is asked, by the words of the row: the truth [kg], and the recording."""
    return {
        "": (load[0], arm.recorded("asked", load)),
        ", nothing": (0.0, arm.recorded("asked empty")),
        ", elsewhere and faster": (
            load[0],
            arm.recorded("asked elsewhere", load, elsewhere=True),
        ),
        ", elsewhere, nothing": (0.0, arm.recorded("asked elsewhere empty", elsewhere=True)),
    }


def place_answers(seed: int) -> list[Answer]:
    """One arm's, calibrated in other poses than those that it weighs in."""
    arm, rng = (
        Twin(
            seed,
            THREE,
            teeth=seed % 2 == 1,
        ),
        np.random.default_rng([seed, 32]),
    )
    with tempfile.TemporaryDirectory() as folder:
        robot = load_robot(write_robot(Path(folder), build=THREE))

    def recorded(name: str, load_kg: float, away_rad: float) -> Motion:
        own = replace(
            differs(rng, arm), elsewhere=away_rad * rng.choice((-1.0, 1.0), len(THREE.axes))
        )
        held = (load_kg, np.array([THREE.held_m, 0.0, 0.0])) if load_kg else None
        return arm.record(name, ARM_SECONDS, held, differs=own)

    learnt = _learnt_or_error(robot, [recorded("empty", 0.0, 0.0)])
    return [
        said(
            f"arm of 3 joints, {'where it was calibrated' if not away else f'{away:g} rad away'}{'' if kg else ', nothing'}",
            kg,
            _of_motion(learnt, recorded("asked", kg, away)),
            f"arm {seed}",
        )
        for away in (0.0, 0.7, 1.2)
        for kg in (1.0, 0.0)
    ]


def _of_motion(
    robot: Robot | ProprioError,
    motion: Motion,
) -> Callable[[], Estimate]:
    def ask() -> Estimate:
        if isinstance(robot, ProprioError):
            raise robot
        return identify_in_motion(robot, [motion], [], PayloadFacts())

    return ask


def servo_answers(seed: int) -> list[Answer]:
    """One servo's."""
    random = np.random.default_rng([seed, 31])
    servo = Servo(random)
    usual = dict(vars(servo))

    def moved(load_kg: float) -> dict[str, np.ndarray]:
        warm = float(np.clip(1.0 + FRICTION * random.standard_normal(), 0.3, 2.0))
        servo.torque_constant = usual["torque_constant"] * (1.0 + 0.03 * random.standard_normal())
        for name in ("coulomb_N_m", "lost", "viscous"):
            setattr(servo, name, warm * usual[name])
        rows = servo.moved(load_kg, random, 100.0)
        zero = ZERO_RAD * random.standard_normal()
        return rows | {name: rows[name] - zero for name in ("position", "goal")}

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pendulum_urdf(folder, "servo", 0.01, 0.1)
        (folder / "servo.yaml").write_text(FILE)
        known = {
            write(folder / f"known{n}", moved(kg)): kg
            for n, kg in enumerate((*KNOWN_KG, *KNOWN_KG))
        }
        options = Options(robot=str(folder / "servo.yaml"), settings=POINT)
        output = folder / "known.yaml"
        learnt = _calibrated(known, options, output)
        answers = []
        for number, kg in enumerate(random.uniform(0.2, 1.2, 3)):
            bag = write(folder / f"asked{number}", moved(float(kg)))
            answers.append(
                said(
                    "servo, 6 motions with 3 loads known",
                    float(kg),
                    _of_bag(learnt, bag, POINT),
                    f"servo {seed}",
                )
            )
    return answers


def _calibrated(
    known: Mapping[Path, float],
    options: Options,
    output: Path,
    empty: Sequence[Path] = (),
) -> Path | str:
    """The file, or why there is none."""
    if output.is_file():
        return output
    try:
        learnt = calibrate_from_bags(
            [str(bag) for bag in empty],
            {str(bag): kg for bag, kg in known.items()},
            options,
            output,
        )
    except ProprioError as error:
        return str(error)
    return (
        output
        if output.is_file()
        else f"calibration {learnt.verdict.value}: {'; '.join(learnt.reasons)}"
    )


def _of_bag(
    learnt: Path | str, bag: Path, settings: Mapping[str, Any] | None = None, **more: Any
) -> Callable[[], Estimate]:
    def ask() -> Estimate:
        if isinstance(learnt, str):
            raise ProprioError(learnt)
        return replay(
            bag,
            Options(calibration=learnt, settings=settings or {}, **more),
        )

    return ask


def pendulum_answers(seed: int) -> list[Answer]:
    """One pendulum's."""
    facts = PayloadFacts(shape=PayloadShape.from_inertia_per_mass([SPREAD_M2] * 3 + [0.0] * 3))
    machine = Pendulum(seed)
    with tempfile.TemporaryDirectory() as folder:
        robot = pendulum_in(Path(folder))
    masses = machine.rng.uniform(0.45, 1.3, 3)
    while abs(masses[0] - masses[1]) < 0.2:
        masses[:2] = machine.rng.uniform(0.45, 1.3, 2)
    first, second, third = map(float, masses)
    known = [
        LoadedRun(machine.released(f"known {kg:.3f}", kg), KnownLoad(kg, facts))
        for kg in (first, second)
    ]
    learnt = calibrate(robot, known)
    answers = []
    for row, horn in (("pendulum, 2 loads known", False), ("pendulum, the horn put on anew", True)):
        run = machine.released("asked", third, horn)

        def ask(run: Any = run) -> Estimate:
            if learnt.calibration is None or learnt.verdict.value != "accepted":
                raise ProprioError("; ".join(learnt.reasons))
            return weigh(robot.with_calibration(learnt.calibration), [run], facts)

        answers.append(said(row, third, ask, f"pendulum {seed}"))
    return answers


# --- recordings of real machines --------------------------------------------------------------------------------------


def bent(
    bag: Path,
    folder: Path,
    effort: float = 1.0,
    zero_rad: float = 0.0,
    joint: str = "",
) -> Path:
    """A bag with every effort so many times as large, and positions so much larger: every one, or those of a joint."""
    if folder.is_dir():
        return folder
    with copying(bag, folder) as (reader, write):
        for connection, time_ns, raw in reader.messages():
            if connection.msgtype.endswith("JointState"):
                message = TYPES.deserialize_cdr(raw, connection.msgtype)
                message.effort = effort * message.effort
                message.position = message.position + zero_rad * np.array(
                    [joint in ("", name) for name in message.name]
                )
                raw = bytes(TYPES.serialize_cdr(message, connection.msgtype))
            write(connection, time_ns, raw)
    return folder


def real_swings(
    real: Path,
    folder: Path,
    every: int = 1,
) -> Iterator[Answer]:
    """``every``: which sets of known loads are taken: each, every second."""
    drive = "torque_constant_N_m_per_A: {value: 1.0, std: 0.5}"
    machines = {
        "sts3215_release": pendulum(folder, "sts3215", 0.001, 0.1, drive),
        "sts3250_release": pendulum(folder, "sts3250", 0.001, 0.15, drive),
    }

    def learnt(
        which: str,
        known: Sequence[float],
    ) -> Path | str:
        robot = machines[which.replace("_again", "")]
        bags = {real / f"{which}_{kg:.3f}kg": kg for kg in known}
        output = folder / f"{which}_{'_'.join(map(str, known))}.yaml"
        return _calibrated(
            bags,
            Options(robot=str(robot), settings=DISC),
            output,
        )

    first = "sts3215_release"
    again = "sts3215_release_again"
    other = "sts3250_release"
    sets = [known for count in (2, 3) for known in itertools.combinations(STS_KG, count)]
    for known in sets[::every]:
        for kg in sorted(set(STS_KG) - set(known)):
            for row, by, asked in (
                ("real STS3215 let go, another repetition", first, again),
                ("real STS3215 let go, the same repetition", first, first),
                ("real STS3215 let go, known by another repetition", again, first),
                ("real STS3250 let go", other, other),
            ):
                bag = real / f"{asked}_{kg:.3f}kg"
                yield said(
                    row,
                    kg,
                    _of_bag(learnt(by, known), bag, DISC),
                    f"{kg} by {known}",
                )
    known = STS_KG[:1] + STS_KG[3:]
    for kg in STS_KG[1:3]:
        for by, asked in ((first, other), (other, first)):
            bag = real / f"{asked}_{kg:.3f}kg"
            yield said(
                "real, let go, known is another servo and arm",
                kg,
                _of_bag(learnt(by, known), bag, DISC),
                asked,
            )
        for number, zero in enumerate((-0.17, -0.1, 0.1, 0.17)):
            bag = bent(real / f"{first}_{kg:.3f}kg", folder / f"horn_{kg}_{number}", zero_rad=zero)
            row = "real STS3215 let go, the horn put on anew"
            yield said(
                row,
                kg,
                _of_bag(
                    learnt(first, known),
                    bag,
                    DISC,
                ),
                f"{kg} kg, {zero:+.2f} rad",
            )


def real_ur10e(real: Path, folder: Path) -> Iterator[Answer]:
    """By each of three empty recordings, one after the other."""
    robot = str(ur10e_file(real, folder))
    unit = {"effort_unit": "A"}
    empty = {n: real / f"ur10e_empty_{n}" for n in (12, 14, 15)}
    loaded = {n: real / f"ur10e_loaded_{n}" for n in (14, 15)}

    def baseline(
        bag: Path,
        by: Path,
    ) -> Callable[[], Estimate]:
        return lambda: replay(
            bag,
            Options(
                robot=robot,
                baseline=[str(by)],
                **unit,
            ),
        )  # type: ignore[arg-type]

    pieces = {n: _pieces(bag, folder / f"piece_{n}") for n, bag in loaded.items()}
    for n, by in empty.items():
        for bag in [*loaded.values(), *pieces[14], *pieces[15]]:
            yield said("real UR10e, 1 empty", UR10E_KG, baseline(bag, by), f"{bag.name} by {n}")
        for k, bag in empty.items():
            if k != n:
                yield said("real UR10e, 1 empty, nothing", 0.0, baseline(bag, by), f"{k} by {n}")
        for k, bag in loaded.items():
            for row, wrong, how in _wrong_ur10e(bag, k, folder):
                yield said(row, UR10E_KG, baseline(wrong, by), f"{k} by {n}, {how}")
        for k, other in ((14, 15), (15, 14)):
            file = folder / f"ur10e_{n}_{k}.yaml"
            learnt = _calibrated(
                {loaded[k]: UR10E_KG},
                Options(robot=robot, **unit),
                file,
                [by],
            )  # type: ignore[arg-type]
            for bag in (loaded[other], *pieces[other]):
                row = "real UR10e, 1 empty, 1 load"
                yield said(
                    row,
                    UR10E_KG,
                    _of_bag(learnt, bag, **unit),
                    f"{bag.name} by empty {n}, loaded {k}",
                )


def _pieces(bag: Path, folder: Path) -> list[Path]:
    """The first three quarters of a minute in three bags, whose names begin with the folder's."""
    return [
        cut(bag, folder.with_name(f"{folder.name}_{k}"), 15.0 * k, 15.0 * k + 15.0)
        for k in range(3)
    ]


def _wrong_ur10e(
    bag: Path,
    number: int,
    folder: Path,
) -> Iterator[tuple[str, Path, str]]:
    """A recording bent on purpose in each way: the row of the table, the bag, and how in words.

    Args:
        bag: The recording.
        number: Of it.
        folder: Where the bent ones go.
    """
    for by_times in (0.9, 0.95, 0.97, *WARMER):
        wrong = bent(bag, folder / f"louder_{number}_{by_times}", effort=by_times)
        yield "real UR10e, efforts 3, 5, 10 % off", wrong, f"{by_times}"
    for joint, zero in itertools.product(
        ("shoulder_lift_joint", "elbow_joint"), (0.02, -0.15, 0.3)
    ):
        wrong = bent(bag, folder / f"{joint}_{number}_{zero}", zero_rad=zero, joint=joint)
        row = "real UR10e, a joint's zero 0.02, 0.15, 0.3 rad off"
        yield row, wrong, f"{joint} {zero:+g}"


def real_kuka(real: Path, folder: Path) -> Iterator[Answer]:
    """As it comes, and with the last joint struck from the file."""
    names = [f"lwr_{n}_joint" for n in range(7)]
    for row, joints in (
        ("real KUKA LWR4+, nothing", names),
        ("real KUKA LWR4+, nothing, without its last joint", names[:-1]),
    ):
        lines = [
            "name: kuka",
            f"urdf: {real / 'models' / 'kuka_lwr4.urdf'}",
            "payload_frame: lwr_7_link",
            "joints:",
        ]
        for joint in joints:
            motor = "nominal_torque_constant_N_m_per_A: 1.0, encoder_resolution_rad: 1.0e-5, encoder_noise_rad: 1.0e-5"
            lines += [f"  {joint}:", f"    motor: {{{motor}, current_limit_A: 300.0}}"]
            lines += [
                "    drive_train: {torque_constant_N_m_per_A: 1.0}",
                "    usable_velocity_rad_s: 5.0",
            ]
        robot = folder / f"kuka{len(joints)}.yaml"
        robot.write_text("\n".join(lines) + "\n")
        for asked, by in ((1, 3), (3, 1)):
            options = Options(
                robot=str(robot), baseline=[str(real / f"kuka_lwr4_empty_{by}")], effort_unit="N.m",
                settings={} if len(joints) == 7 else {f"held.{names[-1]}": 0.0},
            )  # fmt: skip
            bag = real / f"kuka_lwr4_empty_{asked}"
            yield said(
                row, 0.0, lambda options=options, bag=bag: replay(bag, options), f"{asked} by {by}"
            )


MACHINES = {each.__name__: each for each in (real_swings, real_ur10e, real_kuka)}


def real_answers(
    name: str, recordings: Path, at_most: int | None = None, **of_it: int
) -> list[Answer]:
    # of a machine each recording is asked of many times
    with tempfile.TemporaryDirectory() as folder, once_each():
        return list(
            itertools.islice(
                MACHINES[name](
                    recordings,
                    Path(folder),
                    **of_it,
                ),
                at_most,
            )
        )


# --- the table --------------------------------------------------------------------------------------------------------


def figures(
    row: str,
    answers: Sequence[Answer],
) -> dict[str, Any]:
    """Numbers of a row."""
    given = [answer for answer in answers if answer.given]
    codes = Counter(answer.code for answer in answers if not answer.given)
    of_nothing = not any(answer.truth for answer in answers)
    return {
        "row": row,
        "questions": len(answers),
        "accepted": sum(answer.verdict == "accepted" for answer in given),
        "too_wide": sum(answer.verdict == "too_wide" for answer in given),
        **_held(given),
        **_apart(given, of_nothing),
        "refused": len(answers) - len(given),
        "codes": ", ".join(f"{code} {count}" for code, count in codes.most_common(3)),
    }


def _held(given: Sequence[Answer]) -> dict[str, Any]:
    """How many intervals hold, and how far off in standard deviations the values are."""
    held = sum(answer.holds for answer in given)
    found: dict[str, Any] = {
        "hold": held,
        "given": len(given),
        "share": None,
        "rms": None,
        "worst": None,
    }
    if given:
        low, high = binomtest(held, len(given)).proportion_ci(method="wilson")
        share = 100.0 * held / len(given)
        found["share"] = f"{share:.0f} % ({100.0 * low:.0f} to {100.0 * high:.0f})"
        sigmas = np.array([answer.sigmas for answer in given])
        found["rms"] = float(np.sqrt(np.mean(sigmas**2)))
        found["worst"] = float(sigmas.max())
    return found


def _apart(given: Sequence[Answer], of_nothing: bool) -> dict[str, Any]:
    """Errors and half widths: in g where nothing is held, else in % of what is, without those of nothing."""
    errors = []
    halves = []
    for answer in given:
        assert answer.value is not None
        above = answer.high - answer.value
        off = answer.value - answer.truth
        if of_nothing:
            errors.append(1e3 * off)
            halves.append(1e3 * above)
        elif answer.truth:
            errors.append(off * (100.0 / answer.truth))
            halves.append(100.0 * max(above, answer.value - answer.low) / answer.truth)
    unit = "g" if of_nothing else "%"
    return {
        "error": f"{np.sqrt(np.mean(np.square(errors))):.3g} {unit}" if errors else None,
        "half": f"{np.median(halves):.3g} {unit}" if halves else None,
        **each_answer(errors, halves),
    }


def answers_of(task: tuple[str, Any]) -> list[Answer]:
    """One machine's."""
    kind, what = task
    of: dict[str, Callable[[Any], list[Answer]]] = {
        "arm": arm_answers,
        "place": place_answers,
        "servo": servo_answers,
        "pendulum": pendulum_answers,
        "real": lambda where: real_answers(*where),
    }
    return of[kind](what)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, a row for each kind of question."""
    options = _parser().parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    with get_context("spawn").Pool(options.jobs) as pool:
        found = list(itertools.chain(*pool.map(answers_of, _tasks(options), chunksize=1)))
    results.table(
        "between",
        {
            "asked": "{row}",
            "questions": "{questions}",
            "answered": "{accepted}",
            "too wide": "{too_wide}",
            "hold": "{hold} of {given}: {share}",
            "rms, worst, in sd": "{rms:.1f}, {worst:.1f}",
            "rms error": "{error}",
            "half width": "{half}",
            "refused": "{refused}",
            "mostly because": "{codes}",
        },
    )
    rows = dict.fromkeys(answer.row for answer in sorted(found, key=lambda answer: answer.row))
    for row in rows:
        of_row = [answer for answer in found if answer.row == row]
        results.row("between", **figures(row, of_row))
        if options.answers:
            _list(of_row)
    results.row("between", **figures("all", found))
    results.keep()


def _parser() -> ArgumentParser:
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=24)
    parser.add_argument("--servos", type=int, default=12)
    parser.add_argument("--pendulums", type=int, default=16)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument(
        "--real", nargs="*", default=list(MACHINES), choices=list(MACHINES), help="default: all"
    )
    parser.add_argument("--recordings", type=Path, default=REAL)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--answers", action="store_true", help="list every answer")
    return parser


def _tasks(options: Namespace) -> list[tuple[str, Any]]:
    """What to ask `answers_of`: the real machines, and so many seeds of each kind that is simulated."""
    tasks: list[tuple[str, Any]] = []
    if options.recordings.is_dir():
        tasks += [("real", (name, options.recordings)) for name in options.real]
    for kind, count in (
        ("arm", options.arms),
        ("place", options.arms),
        ("servo", options.servos),
        ("pendulum", options.pendulums),
    ):
        tasks += [(kind, seed) for seed in range(options.first, options.first + count)]
    return tasks


def _list(answers: Sequence[Answer]) -> None:
    """Print each in a line."""
    for answer in answers:
        told = "-"
        if answer.value is not None:
            told = f"{answer.value:.4f} ({answer.low:.4f} .. {answer.high:.4f})"
        print(f"    {answer.truth:.4f}: {told}, {answer.verdict}; {answer.asked}"[:400])


if __name__ == "__main__":
    main()
