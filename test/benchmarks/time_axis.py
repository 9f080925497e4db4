"""What is said of recordings whose stamps run fast or slow, as those of a recorder whose loop is slower than the rate it stamps by.

    python test/benchmarks/time_axis.py [--first 31] [--sets 10] [--step 0.05] [--jobs 2]

All stamps and times of recording are stretched by 0.5 to 2.0: of what is weighed alone, and of all recordings alike. Real ones are
two pairs of a UR10e with 2.805 kg; arms in MuJoCo are a Panda and an OpenManipulator-X in N m, and SO-101s that record goals and
positions alone, whose masses, links, friction and motors a seed draws. No velocities are recorded, which would show the stretch.
An answer need not come, one that comes has to hold. One row for each factor, and one for each machine.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from results import Results, parser_of
from support.bends.bend import all_bends
from support.known.asking import ACCEPTED, Outcome, asked, bent_bag
from support.known.bases import BASES, Base, Files, ready, so101

from proprio_ros.quantity import Z95

BEND = "clock_at_another_pace"
ALONE, TOGETHER = "loaded alone", "all alike"
FAR = 3.0
"""Beyond so many standard deviations an accepted answer is wrong."""


@dataclass(frozen=True)
class Question:
    """One recording, and how its stamps are stretched."""

    machine: str
    base: Base
    factor: float
    of: str  # `ALONE` or `TOGETHER`


@dataclass(frozen=True)
class Answer:
    """What was said."""

    question: Question
    outcome: Outcome

    @property
    def accepted(self) -> bool:
        return self.outcome.verdict == ACCEPTED and self.outcome.interval is not None

    def __str__(self) -> str:
        question = self.question
        said = f"{self.outcome.verdict} {','.join(self.outcome.codes)}"
        if self.accepted:
            said = f"{self.sigmas:.1f} sd"
        return f"{question.base.name}, times {question.factor:g}, {question.of}: {said}"

    @property
    def interval(self) -> tuple[float, float]:
        assert self.outcome.interval is not None
        return self.outcome.interval

    @property
    def holds(self) -> bool:
        low, high = self.interval
        return low <= self.question.base.truth <= high

    @property
    def half_kg(self) -> float:
        low, high = self.interval
        value = self.outcome.value
        assert value is not None
        return max(high - value, value - low)

    @property
    def sigmas(self) -> float:
        value = self.outcome.value
        assert value is not None
        return float(Z95 * abs(value - self.question.base.truth) / self.half_kg)


def bases(
    first: int,
    sets: int,
) -> Iterator[tuple[str, Base]]:
    """Machines by name, and their recordings."""
    for name in ("ur10e", "ur10e_15"):
        if not BASES[name].missing:
            yield "UR10e (real)", BASES[name]
    yield "Panda", ready("panda", first)
    yield "OpenManipulator-X", ready("open_manipulator_x", first)
    for number in range(sets):
        yield "SO-101", so101(first + number)


def stretched(bag: Path, path: Path, factor: float) -> Path:
    """A bag whose clock ran so many times as slow."""
    bend = all_bends()[BEND]
    return bent_bag(
        bag,
        path,
        [(bend, {"factor": factor, "velocity": "none"})],
        0,
    )


def answer(question: Question, made: Path) -> Answer:
    """Of one question.

    Args:
        question: What is asked.
        made: Where simulated recordings are.
    """
    base = question.base
    files = dict(base.files(made))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files["loaded"] = stretched(
            files["loaded"],
            folder / "loaded",
            question.factor,
        )
        if question.of == TOGETHER and "empty" in files:
            files["empty"] = stretched(
                files["empty"],
                folder / "empty",
                question.factor,
            )
        if question.of == TOGETHER and "calibration" in files:
            calibrated = _calibrated(files, folder, question.factor)
            if isinstance(calibrated, Outcome):
                return Answer(question, calibrated)
            files["calibration"] = calibrated
        return Answer(question, asked(base.command, files))


def _calibrated(
    files: Files,
    folder: Path,
    factor: float,
) -> Path | Outcome:
    """A calibration of an SO-101 by stretched recordings, or what was said instead."""
    from so101 import KNOWN_KG

    beside = files["calibration"].parent
    empty = [
        str(
            stretched(
                beside / each,
                folder / each,
                factor,
            )
        )
        for each in ("a", "b")
    ]
    known = stretched(beside / "known", folder / "known", factor)
    path = folder / "so101.yaml"
    words = ["calibrate", *empty, "--reference", f"{known}={KNOWN_KG}", "--robot", "so101"]
    said = asked(
        [*words, "--set", "payload.com=[0,0,0]", "--output", str(path)],
        {},
    )
    return path if path.exists() else said


COLUMNS = {
    "asked": "{asked}",
    "accepted": "{accepted}",
    "hold": "{hold}",
    "beyond three sd": "{far}",
    "farthest, in sd": "{farthest:.1f}",
    "refused because": "{codes}",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """A row for each factor, and for each machine."""
    parser = parser_of(__doc__)
    parser.add_argument("--first", type=int, default=31, help="first seed")
    parser.add_argument("--sets", type=int, default=10, help="of SO-101")
    parser.add_argument("--step", type=float, default=0.05, help="from factor to factor")
    parser.add_argument("--only", nargs="+", help="machines, or how their names begin")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--made", type=Path, help="where simulated recordings are kept")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    factors = np.round(np.arange(0.5, 2.0 + 1e-9, options.step), 3)
    chosen = tuple(options.only or ("",))
    known = [
        (machine, base)
        for machine, base in bases(options.first, options.sets)
        if machine.startswith(chosen)
    ]
    with tempfile.TemporaryDirectory() as folder:
        answers = answered(known, factors, options.made or Path(folder), options.jobs)
    tell_factors(results, factors, answers)
    tell_machines(results, answers)
    for each in answers:
        if each.accepted and each.sigmas > FAR:
            print(f"beyond three sd: {each}")
    results.keep()


def answered(
    known: Sequence[tuple[str, Base]],
    factors: np.ndarray,
    made: Path,
    jobs: int,
) -> list[Answer]:
    """Every recording asked at every factor, alone and with all others alike.

    Args:
        known: Machines by name, and their recordings.
        factors: Stamped time over true time, (n,).
        made: Where simulated recordings are.
        jobs: How many processes ask.
    """
    for _, base in known:
        base.files(made)
    questions = [
        Question(machine, base, float(factor), of)
        for machine, base in known
        for factor in factors
        for of in (ALONE, TOGETHER)
    ]
    answers = []
    with ProcessPoolExecutor(jobs) as pool:
        for each in pool.map(partial(answer, made=made), questions):
            answers.append(each)
            print(each, flush=True)
    return answers


def tell_factors(results: Results, factors: np.ndarray, answers: Sequence[Answer]) -> None:
    """A row for each factor, and one for all; what is stamped 0.5 times as long took twice as long as its stamps say."""
    results.table("factors", {"true time over stamped": "{name}", **COLUMNS})
    for factor in factors:
        mine = [each for each in answers if each.question.factor == factor]
        row(results, "factors", f"{1.0 / factor:.2f}", mine)
    row(results, "factors", "all", answers)


def tell_machines(results: Results, answers: Sequence[Answer]) -> None:
    """A row for each machine where a recording is stretched alone, and one where all are."""
    results.table(
        "machines",
        {"machine": "{name}", **COLUMNS, "half width": "{half:.3f} times"},
    )
    for machine in dict.fromkeys(each.question.machine for each in answers):
        for of in (ALONE, TOGETHER):
            mine = [
                each
                for each in answers
                if each.question.machine == machine and each.question.of == of
            ]
            row(results, "machines", f"{machine}, {of}", mine, half=widening(mine))


def row(
    results: Results,
    table: str,
    name: str,
    answers: Sequence[Answer],
    half: float | None = None,
) -> None:
    """What became of some answers.

    Args:
        results: Where the row goes.
        table: Of these.
        name: Of the row.
        answers: That it counts.
        half: Width of their intervals over that of the same recording with a right clock, median.
    """
    accepted = [each for each in answers if each.accepted]
    codes = {
        code
        for each in answers
        if not each.accepted
        for code in each.outcome.codes[:1] or [each.outcome.verdict]
    }
    numbers = {
        "asked": len(answers),
        "accepted": len(accepted),
        "hold": sum(each.holds for each in accepted),
        "far": sum(each.sigmas > FAR for each in accepted),
        "farthest": max((each.sigmas for each in accepted), default=None),
        "codes": ", ".join(sorted(codes)),
    }
    results.row(table, name=name, half=half, **numbers)


def widening(answers: Sequence[Answer]) -> float | None:
    """How many times as wide intervals are as those of the same recordings with a right clock, median."""
    right = {
        each.question.base.name: each.half_kg
        for each in answers
        if each.question.factor == 1.0 and each.accepted
    }
    ratios = [
        each.half_kg / right[each.question.base.name]
        for each in answers
        if each.accepted and each.question.base.name in right
    ]
    return float(np.median(ratios)) if ratios else None


if __name__ == "__main__":
    main()
