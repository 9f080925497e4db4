"""What is said of recordings in which one thing has gone wrong: how far off accepted answers are, whether refusals name the cause.

    python test/benchmarks/distorted.py --count 2000 --first SEED [--jobs 2] [--kinds KIND ...] [--bends NAME ...] [--bases ...]

Each of COUNT questions is drawn: a kind of trouble, a bend of it (`test/support/bends`) with its parameters, a recording of known
truth (`test/support/known/bases.py`: real machines, pushes that ship, arms in MuJoCo that SEED draws), and whether the recording
without a load is bent alike. An answer need not come; one that comes has to hold. Every answer beyond three standard
deviations is listed with what makes it again: ``--first SEED --only NUMBER``. Recordings whose answer is refused as they are,
are left out. ``--all`` prints every answer.
"""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from results import Results, parser_of
from support.bends.bend import KINDS, Bend, all_bends
from support.bends.tape import tape_of
from support.known.asking import ACCEPTED, Outcome, asked, bent_bag
from support.known.bases import BASES, PUSH, Base, drawn

from proprio_ros.quantity import Z95

TOO_WIDE = "too_wide"
FAR = 3.0
"""Beyond so many standard deviations an accepted answer is wrong."""


@dataclass(frozen=True)
class Drawn:
    """One question.

    Attributes:
        number: Among those of a seed.
        bend: Its name.
        parameters: Of it.
        base: Name of the recordings.
        of: Which of them are bent.
    """

    number: int
    bend: str
    parameters: dict[str, Any]
    base: str
    of: tuple[str, ...]

    def __str__(self) -> str:
        parameters = ", ".join(f"{name} {value}" for name, value in self.parameters.items())
        return f"{self.number}: {self.bend} {parameters} in {' and '.join(self.of)} of {self.base}"


@dataclass(frozen=True)
class Answered:
    """One question and what came out."""

    drawn: Drawn
    kind: str
    truth: float
    outcome: Outcome
    cause_named: bool
    lost: bool  # refused, though nothing stood in the way of an answer

    @property
    def accepted(self) -> bool:
        return self.outcome.verdict == ACCEPTED and self.outcome.value is not None

    @property
    def refused(self) -> bool:
        return not self.accepted and self.outcome.verdict != TOO_WIDE

    @property
    def sigmas(self) -> float | None:
        """How far off, in standard deviations of the interval; None where none was given."""
        outcome = self.outcome
        if outcome.value is None or outcome.interval is None:
            return None
        low, high = outcome.interval
        half = max(high - outcome.value, outcome.value - low)
        return float(Z95 * abs(outcome.value - self.truth) / half)

    @property
    def far(self) -> bool:
        """Whether it is more than `FAR` standard deviations off."""
        return (self.sigmas or 0.0) > FAR

    @property
    def said_to_lean(self) -> bool:
        """Whether the interval that is given for zeros that moved holds."""
        moved = self.outcome.if_zeros_moved
        return moved is not None and moved[0] <= self.truth <= moved[1]

    @property
    def holds(self) -> bool:
        interval = self.outcome.interval
        return interval is not None and interval[0] <= self.truth <= interval[1]


@lru_cache(maxsize=4)
def bases(first: int) -> dict[str, Base]:
    """Real and shipped ones that are at hand, and simulated ones that a seed draws."""
    there = [base for base in BASES.values() if not base.missing and _fixed(base)]
    return {base.name: base for base in (*there, *drawn(first))}


def _fixed(base: Base) -> bool:
    """Whether it is a recording, not drawn; of pushes without a calibration little is told."""
    shipped = base.kind == PUSH and base.name.endswith("_calibrated")
    return base.real or shipped


def suited(bend: Bend, base: Base) -> bool:
    """Whether a bend can be made in a recording."""
    return bend.needs in ("", base.kind)


def draw(
    number: int,
    first: int,
    bends: dict[str, Bend],
    among: Sequence[Base],
    made: Path,
) -> Drawn:
    """One question, by seed and number.

    Args:
        number: Of it.
        first: The seed.
        bends: To draw from.
        among: Recordings to draw from.
        made: Where recordings are made.
    """
    rng = np.random.default_rng([first, number])
    possible = [bend for bend in bends.values() if any(suited(bend, base) for base in among)]
    kinds = sorted({bend.kind for bend in possible})
    kind = kinds[number % len(kinds)]
    of_kind = [bend for bend in possible if bend.kind == kind]
    bend = of_kind[int(rng.integers(len(of_kind)))]
    fit = [base for base in among if suited(bend, base)]
    # real and simulated ones alike, however many there are of each
    sorts = sorted({base.real for base in fit})
    real = sorts[int(rng.integers(len(sorts)))]
    fit = [base for base in fit if base.real == real]
    base = fit[int(rng.integers(len(fit)))]
    files = base.files(made)
    both = "empty" in files and bool(rng.integers(2))
    parameters = bend.drawn(rng, tape_of(files["loaded"]))
    return Drawn(
        number, bend.name, parameters, base.name, ("loaded", "empty") if both else ("loaded",)
    )


def answer(question: Drawn, first: int, made: Path) -> Answered:
    """Ask it."""
    bend = all_bends()[question.bend]
    base = bases(first)[question.base]
    files = dict(base.files(made))
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(question.of):
            seed = 100_000 * first + 10 * question.number + number
            made_of = [(bend, question.parameters)]
            files[name] = bent_bag(
                files[name],
                Path(folder) / name,
                made_of,
                seed,
            )
        outcome = asked(base.command, files, base.estimate)
    right = bend.right if "empty" in question.of else bend.right_alone
    in_words = bool(right.cause) and re.search(right.cause, outcome.said) is not None
    named = in_words or bool(set(right.codes) & set(outcome.codes))
    given = outcome.value is not None
    return Answered(
        question, bend.kind, base.truth, outcome, named, right.told is True and not given
    )


def told_as_they_are(
    among: Sequence[Base],
    made: Path,
) -> list[Base]:
    """Those whose answer is given where nothing is wrong."""
    there = []
    for base in among:
        outcome = asked(
            base.command,
            base.files(made),
            base.estimate,
        )
        if outcome.verdict == ACCEPTED:
            there.append(base)
        else:
            print(f"left out: {base.name}, {outcome.verdict}")
    return there


def row(
    results: Results,
    name: str,
    answers: Sequence[Answered],
) -> None:
    """One row of the table."""
    accepted = [each for each in answers if each.accepted]
    refused = [each for each in answers if each.refused]
    codes: Counter[str] = Counter()
    for each in refused:
        codes[each.outcome.codes[0] if each.outcome.codes else "unreadable"] += 1
    sigmas = [each.sigmas for each in answers if each.sigmas is not None]
    results.row(
        "distorted",
        kind=name,
        asked=len(answers),
        accepted=len(accepted),
        hold=sum(each.holds for each in accepted),
        wide=len(answers) - len(accepted) - len(refused),
        beyond=sum(each.far for each in answers),
        leaning=sum(each.far and each.said_to_lean for each in answers),
        farthest=max(sigmas, default=None),
        refused=len(refused),
        named=sum(each.cause_named for each in refused),
        lost=sum(each.lost for each in answers),
        codes=", ".join(f"{code} {count}" for code, count in codes.most_common()),
    )


def tables(results: Results, answers: Sequence[Answered]) -> None:
    """All of them."""
    tell_kinds(results, answers)
    tell_bends(results, answers)
    tell_beyond(results, answers)


def tell_kinds(results: Results, answers: Sequence[Answered]) -> None:
    """A row for each kind of mistake that was asked, and one for all."""
    results.table(
        "distorted",
        {
            "kind": "{kind}",
            "asked": "{asked}",
            "accepted": "{accepted}",
            "hold": "{hold}",
            "too wide": "{wide}",
            "beyond 3 sd": "{beyond}",
            "of these within `if_zeros_moved`": "{leaning}",
            "farthest, in sd": "{farthest:.1f}",
            "refused": "{refused}",
            "of them the cause named": "{named}",
            "good ones lost": "{lost}",
            "refused because": "{codes}",
        },
    )
    for kind in KINDS:
        of_kind = [each for each in answers if each.kind == kind]
        if of_kind:
            row(results, kind, of_kind)
    row(results, "all", answers)


def tell_bends(results: Results, answers: Sequence[Answered]) -> None:
    """A row for each way to bend a recording."""
    results.table(
        "bends",
        {
            "bend": "{bend}",
            "asked": "{asked}",
            "accepted": "{accepted}",
            "hold": "{hold}",
            "beyond 3 sd": "{beyond}",
            "refused": "{refused}",
            "of them the cause named": "{named}",
            "good ones lost": "{lost}",
        },
    )
    for name in sorted({each.drawn.bend for each in answers}):
        mine = [each for each in answers if each.drawn.bend == name]
        refused = [each for each in mine if each.refused]
        results.row(
            "bends",
            bend=name,
            asked=len(mine),
            accepted=sum(each.accepted for each in mine),
            hold=sum(each.accepted and each.holds for each in mine),
            beyond=sum(each.far for each in mine),
            refused=len(refused),
            named=sum(each.cause_named for each in refused),
            lost=sum(each.lost for each in mine),
        )


def tell_beyond(results: Results, answers: Sequence[Answered]) -> None:
    """Each answer that lies more than three standard deviations off."""
    results.table(
        "beyond",
        {
            "question": "{question}",
            "truth": "{truth:.4g}",
            "answer": "{value:.4g} ({low:.4g} to {high:.4g})",
            "in sd": "{sigmas:.1f}",
            "verdict": "{verdict}",
        },
    )
    for each in answers:
        if each.far and each.outcome.interval is not None:
            low, high = each.outcome.interval
            results.row(
                "beyond",
                question=str(each.drawn),
                truth=each.truth,
                value=each.outcome.value,
                low=low,
                high=high,
                sigmas=each.sigmas,
                verdict=each.outcome.verdict,
            )


def printed(each: Answered) -> str:
    """A line about one answer."""
    outcome = each.outcome
    number = "" if outcome.value is None else f" {outcome.value:.4g} {outcome.interval}"
    marks = " ".join(
        word
        for word, there in (
            ("BEYOND", each.far),
            ("MISSES", each.accepted and not each.holds),
            ("LOST", each.lost),
            ("UNNAMED", each.refused and not each.cause_named),
        )
        if there
    )
    codes = ",".join(outcome.codes)
    return f"{marks or 'right'} | {each.drawn} | {each.truth:.4g} | {outcome.verdict}{number} | {codes} | {outcome.said[:600]}"


def asked_all(
    questions: Sequence[Drawn],
    first: int,
    made: Path,
    jobs: int,
) -> Iterator[Answered]:
    """Every answer, in the order of the questions."""
    ask = partial(answer, first=first, made=made)
    if jobs == 1:
        yield from map(ask, questions)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(ask, questions, chunksize=4)


def chosen_bends(kinds: Sequence[str], names: Sequence[str] | None) -> dict[str, Bend]:
    """Bends of some kinds by name, all of them or those that are named."""
    bends = {name: bend for name, bend in all_bends().items() if bend.kind in kinds}
    if names is None:
        return bends
    return {name: bend for name, bend in bends.items() if name in names}


def bases_for(bends: dict[str, Bend], begin: Sequence[str], first: int) -> list[Base]:
    """Recordings whose names begin in one of some ways, and which one of the bends suits.

    Args:
        bends: By name.
        begin: How names may begin.
        first: Seed of the arms.
    """
    named = [base for base in bases(first).values() if base.name.startswith(tuple(begin))]
    return [base for base in named if any(suited(bend, base) for bend in bends.values())]


def main(arguments: Sequence[str] | None = None) -> None:
    """Ask, and keep the tables."""
    parser = parser_of((__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=1, help="seed of questions and arms")
    parser.add_argument("--only", type=int, nargs="+", help="numbers of questions")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument(
        "--kinds",
        nargs="+",
        choices=KINDS,
        default=list(KINDS),
    )
    parser.add_argument("--bends", nargs="+", help="default: all of the kinds")
    parser.add_argument("--bases", nargs="+", help="names, or how they begin; default: all")
    parser.add_argument("--made", type=Path, help="folder that keeps simulated recordings")
    parser.add_argument("--all", action="store_true", help="print every answer")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    bends = chosen_bends(options.kinds, options.bends)
    among = bases_for(bends, options.bases or ("",), options.first)
    with tempfile.TemporaryDirectory() as scratch:
        made = options.made or Path(scratch)
        made = made / str(options.first)
        among = told_as_they_are(among, made)
        numbers = options.only or range(options.count)
        questions = [draw(number, options.first, bends, among, made) for number in numbers]
        answers = []
        for each in asked_all(questions, options.first, made, options.jobs):
            answers.append(each)
            line = printed(each)
            if options.all or not line.startswith("right"):
                print(line, flush=True)
    tables(results, answers)
    results.keep()


if __name__ == "__main__":
    main()
