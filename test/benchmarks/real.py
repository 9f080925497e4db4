"""What is said of the real recordings, in one table: how many are answered, how far off, and how many intervals hold.

    python test/benchmarks/real.py [--recordings ../shared/recordings_real] [--machines ur10e ...] [--bags]

Every answer is one of the command line, asked as a user would: `proprio calibrate`, then `proprio replay`. The recordings are of
other people's machines and not part of this repository; what each holds was weighed by who recorded it. ``--bags`` lists
every answer.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from results import Results, parser_of
from rosbags.highlevel import AnyReader
from support.copied_bag import TYPES, copying
from support.machines import REAL, UR10E_N_M_PER_A, pendulum_urdf

from proprio_ros.cli import main as proprio
from proprio_ros.quantity import Z95

UR10E_KG = 2.805
STS_KG = (0.535, 0.741, 0.969, 1.168)
STS_OBJECT = (
    "--set",
    "payload.com=[0,0,0]",
    "--set",
    "payload.inertia_per_mass=[0.00255,0.00255,0.00255,0,0,0]",
)
DFKI_LENGTH_M = 0.1495 / 0.3055
XL330_KG = 0.490


@dataclass(frozen=True)
class Answer:
    """One question and what came out.

    Attributes:
        row: Of the table.
        asked: In words.
        truth: In the value's unit.
        value, std, low, high: Of the answer; None where it was withheld.
        verdict: As the command line says it, or why it ended without an answer.
    """

    row: str
    asked: str
    truth: float
    value: float | None
    std: float | None
    low: float | None
    high: float | None
    verdict: str

    @property
    def given(self) -> bool:
        return self.value is not None and self.verdict in ("accepted", "too_wide")

    @property
    def holds(self) -> bool:
        return (
            self.low is not None and self.high is not None and self.low <= self.truth <= self.high
        )

    @property
    def sigmas(self) -> float:
        """How far off, in standard deviations of the interval: Student's are wider than a normal distribution's."""
        assert self.value is not None and self.low is not None and self.high is not None
        half = max(
            self.high - self.value,
            self.value - self.low,
        )
        return Z95 * abs(self.value - self.truth) / half


def said(words: Sequence[str]) -> dict[str, Any]:
    """What the command line prints with --json; its error where there is one."""
    out = io.StringIO()
    err = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = proprio([*words, "--json"])
    answer: dict[str, Any] = json.loads(out.getvalue() or "{}")
    return {"exit": code, **answer}


def asked(
    row: str,
    question: str,
    truth: float,
    words: Sequence[str],
    name: str = "payload_mass",
) -> Answer:
    answer = said(["replay", *words, "--probe", "payload"])
    value = next(
        (each for each in answer.get("estimates", []) if each["name"] == name), {"value": None}
    )
    # how a load swings is an answer of its own, whatever is said of the mass
    told = name != "payload_mass" and value["value"] is not None
    verdict = "accepted" if told else answer.get("verdict") or f"exit {answer['exit']}"
    low, high = value.get("ci95") or (None, None)
    return Answer(
        row,
        question,
        truth,
        value["value"],
        value.get("std"),
        low,
        high,
        verdict,
    )


def cut(
    bag: Path,
    folder: Path,
    begin_s: float,
    end_s: float,
) -> Path:
    """The messages of a bag between two times since its first."""
    with copying(bag, folder) as (reader, write):
        first, last = (reader.start_time + int(1e9 * s) for s in (begin_s, end_s))
        for connection, time_ns, raw in reader.messages(start=first, stop=last):
            write(connection, time_ns, raw)
    return folder


def seconds_of(bag: Path) -> float:
    with AnyReader([bag], default_typestore=TYPES) as reader:
        return 1e-9 * reader.duration


def pendulum(
    folder: Path,
    name: str,
    rod_kg: float,
    length_m: float,
    drive: str,
    nominal: float = 1.0,
) -> Path:
    pendulum_urdf(folder, name, rod_kg, length_m)
    path = folder / f"{name}.yaml"
    path.write_text(
        f"name: {name}\nurdf: {name}.urdf\npayload_frame: tip\ngravity: [0.0, 0.0, -9.80496]\njoints:\n  pendulum:\n"
        f"    motor: {{nominal_torque_constant_N_m_per_A: {nominal}, encoder_resolution_rad: 0.0015, encoder_noise_rad: 0.0005}}\n"
        f"    drive_train: {{{drive}}}\n"
    )
    return path


def ur10e_file(real: Path, folder: Path) -> Path:
    """The robot file that a user writes of the URDF and the torque constants."""
    lines = [
        "name: ur10e",
        f"urdf: {real / 'models' / 'ur10e.urdf'}",
        "payload_frame: wrist_3_link",
        "joints:",
    ]
    for joint, constant in UR10E_N_M_PER_A.items():
        motor = f"nominal_torque_constant_N_m_per_A: {constant}, encoder_resolution_rad: 1.0e-5, encoder_noise_rad: 1.0e-5"
        lines += [f"  {joint}:", f"    motor: {{{motor}, current_limit_A: 20.0}}"]
        lines += [
            f"    drive_train: {{torque_constant_N_m_per_A: {constant}}}",
            "    usable_velocity_rad_s: 5.0",
        ]
    robot = folder / "ur10e.yaml"
    robot.write_text("\n".join(lines) + "\n")
    return robot


def ur10e(real: Path, folder: Path) -> Iterator[Answer]:
    robot = ur10e_file(real, folder)
    unit = ("--effort-unit", "A")
    loaded = real / "ur10e_loaded_14"
    empty = [real / f"ur10e_empty_{n}" for n in (12, 14, 15)]
    lasts_s = seconds_of(loaded)
    cuts = [
        cut(loaded, folder / f"cut_{n}", b, b + 15.0)
        for n, b in enumerate((0.0, 10.0, 20.0, 30.0, lasts_s - 15.0))
    ]
    for baseline in empty:
        words = ("--robot", str(robot), *unit, "--baseline", str(baseline))
        yield asked(
            "UR10e, 2.805 kg, `--baseline`",
            baseline.name,
            UR10E_KG,
            [str(loaded), *words],
        )
        for bag in cuts:
            yield asked(
                "the same, 15 s", f"{bag.name}, {baseline.name}", UR10E_KG, [str(bag), *words]
            )
        for other in empty:
            if other != baseline:
                yield asked(
                    "UR10e, nothing, `--baseline`",
                    f"{other.name}, {baseline.name}",
                    0.0,
                    [str(other), *words],
                )
        file = folder / f"{baseline.name}.yaml"
        said(["calibrate", str(baseline), "--robot", str(robot), *unit, "--output", str(file)])
        words = ("--calibration", str(file), *unit)
        yield asked(
            "UR10e, 2.805 kg, calibrated",
            baseline.name,
            UR10E_KG,
            [str(loaded), *words],
        )
        for bag in cuts:
            yield asked(
                "the same, 15 s, calibrated",
                f"{bag.name}, {baseline.name}",
                UR10E_KG,
                [str(bag), *words],
            )
        for other in empty:
            if other != baseline:
                yield asked(
                    "UR10e, nothing, calibrated",
                    f"{other.name}, {baseline.name}",
                    0.0,
                    [str(other), *words],
                )


def open_manipulator(real: Path, folder: Path) -> Iterator[Answer]:
    bag = real / "omx_empty_1"
    half_s = 0.5 * seconds_of(bag)
    halves = [
        cut(
            bag,
            folder / f"half_{n}",
            n * half_s,
            (n + 1) * half_s,
        )
        for n in (0, 1)
    ]
    more = ("--effort-unit", "raw", "--set", "held.gripper_left_joint=0.0")
    for one, other in (halves, halves[::-1]):
        file = folder / f"{one.name}.yaml"
        said(["calibrate", str(one), *more, "--output", str(file)])
        words = ("--calibration", str(file), *more)
        yield asked(
            "OpenManipulator-X, nothing, 10 s",
            one.name,
            0.0,
            [str(other), *words],
        )


def swings(real: Path, folder: Path) -> Iterator[Answer]:
    robot = pendulum(
        folder, "sts3215", 0.001, 0.1, "torque_constant_N_m_per_A: {value: 1.0, std: 0.5}"
    )
    bags = [real / f"sts3215_release_{mass:.3f}kg" for mass in STS_KG]
    for count in (2, 3):
        for known in itertools.combinations(range(len(bags)), count):
            file = folder / f"sts_{'_'.join(map(str, known))}.yaml"
            references = [f"{bags[n]}={STS_KG[n]}" for n in known]
            said(
                [
                    "calibrate",
                    "--reference",
                    *references,
                    "--robot",
                    str(robot),
                    *STS_OBJECT,
                    "--output",
                    str(file),
                ]
            )
            for number in set(range(len(bags))) - set(known):
                words = [
                    str(bags[number]),
                    "--calibration",
                    str(file),
                    *STS_OBJECT,
                ]
                yield asked(
                    f"STS3215 let go, {count} loads known",
                    f"{number} by {known}",
                    STS_KG[number],
                    words,
                )


def controllers(real: Path, folder: Path) -> Iterator[Answer]:
    robot = pendulum(folder, "dfki", 0.13, 0.5, "torque_constant_N_m_per_A: 1.0")
    for name in ("ddp", "direct_collocation", "pd", "energy_shaping", "sac"):
        words = [
            str(real / f"dfki_{name}"),
            "--robot",
            str(robot),
            "--effort-unit",
            "N.m",
        ]
        yield asked(
            "AK80-6, length of the pendulum",
            name,
            DFKI_LENGTH_M,
            words,
            "equivalent_pendulum_length",
        )
        yield asked("AK80-6, mass", name, 0.546, words)
    servo = pendulum(folder, "servo", 0.01, 0.1, "torque_constant_N_m_per_A: 0.36", nominal=0.36)
    for unit in ("raw", "mA", "A", "N.m"):
        for bag in sorted(real.glob("xl330_*")):
            words = [
                str(bag),
                "--robot",
                str(servo),
                "--effort-unit",
                unit,
            ]
            yield asked(
                "XL330, effort is a duty cycle, as any unit", f"{bag.name} {unit}", XL330_KG, words
            )
        for bag in sorted(real.glob("sts3215_*kg")):
            if "release" not in bag.name:
                words = [
                    str(bag),
                    "--robot",
                    str(servo),
                    "--effort-unit",
                    unit,
                ]
                truth = float(bag.name.rpartition("_")[2].removesuffix("kg"))
                yield asked(
                    "STS3215 driven, effort has no sign, as any unit",
                    f"{bag.name} {unit}",
                    truth,
                    words,
                )


XL330_DRIVE = "{kind: duty_cycle, per_count: 0.00112994}"
STS_DRIVE = "{kind: position_servo, gain_per_rad: 2.656, limit: 0.97, goal_speed_rad_s: 5.215}"
"""Its P of 16 times 0.166, goal speed and largest duty cycle: what Rhoban/bam measured of the STS3215."""


@dataclass(frozen=True)
class Setup:
    """Of a recording: the gain or the load it was made with, how the machine moved, and what it held [kg]."""

    setup: str
    motion: str
    kg: float


@dataclass(frozen=True)
class ByVoltage:
    """A servo that knows no current.

    Attributes:
        name: As its recordings begin.
        object_is: Words of the command line that say where the load is.
        drive: Of the robot file: what a command is.
        delay: Of the robot file [s].
        other: What its set-ups differ in.
    """

    name: str
    object_is: tuple[str, ...]
    drive: str
    delay: str
    other: str

    def robot_file(self, folder: Path) -> Path:
        """The pendulum's, with a motor that is driven by a voltage."""
        drive = "torque_constant_N_m_per_A: {value: 1.0, std: 0.4}"
        robot = pendulum(folder, self.name, 0.001, 0.1, drive)
        motor = f"resistance_ohm: 2.68, back_emf_V_s_per_rad: 1.0, driven_by: {self.drive}, "
        text = robot.read_text().replace("motor: {", "motor: {" + motor)
        robot.write_text(text.replace("joints:", f"delay_s: {self.delay}\njoints:"))
        return robot

    def recordings(self, real: Path) -> dict[Path, Setup]:
        """Those in which it is driven."""
        found = {}
        for bag in sorted(real.glob(f"{self.name}_*")):
            if "release" not in bag.name and "lift" not in bag.name:
                rest = bag.name.partition("_")[2]
                if self.name == "xl330":
                    setup, motion = rest.split("_", 1)
                    kg = XL330_KG
                else:
                    motion, setup = rest.rsplit("_", 1)
                    kg = float(setup.removesuffix("kg"))
                found[bag] = Setup(setup, motion, kg)
        return found

    def rows(self) -> Iterator[tuple[str, Callable[[Setup, Setup], bool]]]:
        """Rows of the table: their names, and by which others a recording is known."""
        driven = f"{self.name.upper()} driven"
        yield (
            f"{driven}, motions under {self.other} known",
            lambda one, two: one.setup != two.setup,
        )
        yield f"{driven}, other motions known", lambda one, two: one.motion != two.motion
        yield f"{driven}, all others known", lambda one, two: one != two


BY_VOLTAGE = (
    ByVoltage("xl330", ("--set", "payload.com=[0,0,0]"), XL330_DRIVE, "0.0", "another gain"),
    ByVoltage("sts3215", STS_OBJECT, STS_DRIVE, "{value: 0.02, std: 0.02}", "another load"),
)


def by_voltage(real: Path, folder: Path) -> Iterator[Answer]:
    """Servos that know no current, each motion weighed by others of the same machine with known loads."""
    for servo in BY_VOLTAGE:
        robot = servo.robot_file(folder)
        bags = servo.recordings(real)
        for row, known_by in servo.rows():
            written: dict[tuple[Path, ...], Path] = {}
            for bag, its in bags.items():
                known = tuple(each for each, of in bags.items() if known_by(its, of))
                if known not in written:
                    written[known] = folder / f"{servo.name}_{len(written)}_{len(known)}.yaml"
                    references = [
                        word
                        for each in known
                        for word in ("--reference", f"{each}={bags[each].kg}")
                    ]
                    words = ["--robot", str(robot), *servo.object_is]
                    output = ["--output", str(written[known]), "--force"]
                    said(["calibrate", *references, *words, *output])
                words = [str(bag), "--calibration", str(written[known]), *servo.object_is]
                yield asked(row, f"{bag.name} by {len(known)}", its.kg, words)


def main(arguments: Sequence[str] | None = None) -> None:
    machines = {
        each.__name__: each for each in (ur10e, open_manipulator, swings, controllers, by_voltage)
    }
    parser = parser_of((__doc__ or "").splitlines()[0])
    parser.add_argument("--recordings", type=Path, default=REAL)
    parser.add_argument(
        "--machines", nargs="+", default=list(machines), choices=list(machines), help="default: all"
    )
    parser.add_argument("--bags", action="store_true", help="list every answer")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    results.table(
        "real",
        {
            "asked": "{asked}",
            "questions": "{questions}",
            "accepted": "{accepted}",
            "too wide": "{too_wide}",
            "refused": "{refused}",
            "intervals that hold": "{held}",
            "largest error": "{worst}",
            "farthest, in sd": "{farthest:.1f}",
        },
    )
    answers: list[Answer] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in options.machines:
            of_machine = []
            for answer in machines[name](options.recordings, Path(folder)):
                of_machine.append(answer)
                if options.bags:
                    shown = (
                        "-"
                        if answer.value is None
                        else f"{answer.value:.4f} ({answer.low:.4f} .. {answer.high:.4f})"
                    )
                    print(
                        f"{answer.row}: {answer.asked}: {shown} for {answer.truth:.4f}, {answer.verdict}",
                        file=sys.stderr,
                    )
            for row in dict.fromkeys(answer.row for answer in of_machine):
                results.row(
                    "real",
                    **_figures(
                        row,
                        [answer for answer in of_machine if answer.row == row],
                    ),
                )
            answers += of_machine
    results.row("real", **_figures("all", answers))
    results.keep()


def _figures(
    name: str,
    answers: Sequence[Answer],
) -> dict[str, Any]:
    """Numbers of a row: errors and half intervals in % of the truth, or in g where it is nothing."""
    given = [answer for answer in answers if answer.given]
    wide = sum(answer.verdict == "too_wide" for answer in given)
    hold = sum(answer.holds for answer in given)
    relative = all(answer.truth for answer in answers)
    comparable = relative or not any(answer.truth for answer in answers)
    compared = given if comparable else []
    errors, halves = _apart(compared, relative)
    return {
        "asked": name,
        "questions": len(answers),
        "accepted": len(given) - wide,
        "too_wide": wide,
        "refused": len(answers) - len(given),
        "given": len(given),
        "hold": hold,
        "held": f"{hold} of {len(given)}" if given else None,
        "worst": _largest(errors, compared, relative) if comparable else "",
        "farthest": max((answer.sigmas for answer in given), default=None),
        "errors": errors,
        "half_intervals": halves,
    }


def _apart(given: Sequence[Answer], relative: bool) -> tuple[list[float], list[float]]:
    """Errors and half intervals: ``relative`` in % of the truth, else in g (or mm)."""
    errors = []
    halves = []
    for answer in given:
        assert answer.value is not None and answer.low is not None and answer.high is not None
        scale = 100.0 / answer.truth if relative else 1e3
        errors.append(scale * (answer.value - answer.truth))
        halves.append(scale * max(answer.high - answer.value, answer.value - answer.low))
    return errors, halves


def _largest(
    errors: Sequence[float],
    given: Sequence[Answer],
    relative: bool,
) -> str | None:
    """In words, the error of the answer that is farthest off in kg (or m); None where there is none."""
    if not errors:
        return None

    def off(row: int) -> float:
        return abs(errors[row] * given[row].truth if relative else errors[row])

    far = abs(errors[max(range(len(errors)), key=off)])
    return f"{far:.1f} %" if relative else f"{far:.0f} g"


if __name__ == "__main__":
    main()
