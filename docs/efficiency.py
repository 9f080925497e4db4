"""Whether intervals fit, of every row that benchmarks kept and that has a truth: how many hold, and what they cost.

*Efficiency* is the 95 % half width over 1.96 times the rms error: 1 is what is needed, below 1 intervals lie, above 1.5 they waste.
Widths differ from answer to answer. So each error counts in half widths of its own answer, where a file has both; else the median
half width counts over the rms error. Interval and value of what is nothing end at nothing: half of the errors are then 0, and
intervals that fit have an efficiency of 1.4.

``python docs/generate.py`` writes all rows, worst first, into ``results/efficiency.md``, and a summary into a page (`figures`).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import figures
import numpy as np
from scipy.stats import binomtest

Z95 = statistics.NormalDist().inv_cdf(0.975)
NOTE = "<!-- written by docs/generate.py from the results: change those instead -->"
NEEDED = (1.0, 1.5)
MANY = 40  # Answers from which on an efficiency is known to a sixth.
ANSWERS = ("given", "answered", "answers")
LABELS: Mapping[str, str] = {
    "at_rest.rest": "{what}, {held}",
    "between_recordings.between": "{row}",
    "contents.contents": "{kind}",
    "contents_earlier_seeds.contents": "{kind}, earlier seeds",
    "contents_other_seeds.contents": "{kind}, other seeds",
    "coverage.coverage": "{robots}",
    "foreign.all": "currents",
    "foreign_stiff.all": "goals, servos of six stiffnesses",
    "foreign_load.all": "currents, as the load says",
    "foreign_load_goals_30.all": "goals at 30 Hz, as the load says",
    "live.live": "{way}, {held}",
    "more_recordings.more": "torque {percent:g} %, {empty} empty, {loads} loads, {what}",
    "real.real": "{asked}",
    "running.sensing": "arm {arm}",
    "running.running": "arm {arm}, payload",
    "servos.servos": "{servos} servos",
    "simulated.weighing": "push, {level}, {known}",
    "simulated.container": "sphere, {level}",
    "simulated.container, not calibrated": "sphere, {level}, not calibrated",
    "simulated.blocks": "block, {recordings}",
    "so101.so101": "{held}",
    "so101_differ.so101": "{held}, recordings differ as published",
    "softness_live.softness_live": "live, {block}",
    "spheres.spheres": "torque {torque:g} mN m, {runs}",
    "squeezes.squeezes": "{kPa:g} kPa, {ratio:g}",
    "whose_calibration_driven.pairs": "{pair}",
    "whose_calibration_real_swings.pairs": "{pair}",
    "whose_calibration_swings.pairs": "{pair}",
}
"""Tables whose rows have a truth, and what a row is called. Recordings that something is wrong with are in other tables."""
PARTS: Mapping[str, Mapping[str, str]] = {
    "container": {"": "", "empty_": ", nothing", "together_": ", three together"},
    "blocks": {"": "", "ratio_": ", Poisson's ratio"},
    "sensing": {
        "soon_": ", half a second after a change",
        "later_": ", later",
        "elsewhere_": ", elsewhere",
    },
    "running": {"empty_": ", nothing", "held_": ", held"},
}
"""Of tables whose rows have several kinds of answers, the beginning of the numbers' names, and what they are called."""
SHARES = ("coverage", "sensing", "running", "servos", "spheres")
"""Tables that count in percent how many intervals hold."""


@dataclass(frozen=True)
class Fit:
    """Of one row, whether its intervals fit."""

    benchmark: str
    row: str
    answers: int | None  # None: the file does not say of how many
    hold: float  # share, 0 to 1
    efficiency: float | None  # None: the file has no errors

    @property
    def worse_than_needed(self) -> float:
        """By what factor it is outside of `NEEDED`; 1 within, 0 where nothing is known."""
        if self.efficiency is None:
            return 0.0
        least, most = NEEDED
        return max(least / max(self.efficiency, 1e-3), self.efficiency / most, 1.0)

    def cells(self) -> list[str]:
        """Of its row."""
        held = f"{100.0 * self.hold:.0f} %"
        if self.answers:
            count = round(self.hold * self.answers)
            low, high = binomtest(count, self.answers).proportion_ci(method="wilson")
            held = f"{held} ({100.0 * low:.0f} to {100.0 * high:.0f})"
        return [self.benchmark, self.row, f"{self.answers or '-'}", held, _shown(self.efficiency)]


def _shown(efficiency: float | None) -> str:
    if efficiency is None:
        return "-"
    return "> 100" if efficiency > 100.0 else f"{efficiency:.2f}"


def of_answers(errors: Sequence[float], half_intervals: Sequence[float]) -> float | None:
    """Efficiency by each answer's error and half width, in the same unit; None where no answer errs."""
    rms = float(np.sqrt(np.mean(np.square(np.divide(errors, half_intervals)))))
    return 1.0 / (Z95 * rms) if rms > 0.0 else None


def _efficiency(row: Mapping[str, Any], part: str) -> float | None:
    """Of one kind of answers of a row: by each of them, by the rms in their own standard deviations, or by what all have."""
    errors = row.get(f"{part}errors")
    halves = row.get(f"{part}half_intervals")
    if errors and halves:
        return of_answers(errors, halves)
    rms, half = row.get(f"{part}rms"), row.get(f"{part}half")
    if isinstance(half, str):  # between_recordings: its rms is in standard deviations
        return 1.0 / rms if rms else None
    if half is None and row.get(f"{part}half_from"):
        half = math.sqrt(row[f"{part}half_from"] * row[f"{part}half_to"])
    return half / (Z95 * rms) if rms and half and not math.isnan(half) else None


def fits_of(name: str, row: Mapping[str, Any]) -> Iterator[Fit]:
    """Of one row of a table, see `LABELS`."""
    file, _, table = name.partition(".")
    for part, words in PARTS.get(table, {"": ""}).items():
        counts = [row[f"{part}{key}"] for key in ANSWERS if row.get(f"{part}{key}") is not None]
        if table == "sensing":
            counts = [row["noticed"]]
        answers = counts[0] if counts else None
        hold = row.get(f"{part}hold")
        if hold is None or answers == 0 or math.isnan(hold):
            continue
        share = hold / 100.0 if table in SHARES else hold / (answers or 1)
        called = LABELS[name].format(**row) + words
        yield Fit(file, called, answers, share, _efficiency(row, part))


def every_fit() -> list[Fit]:
    """Of every row, worst first; sums over rows of different kinds are left out."""
    found: list[Fit] = []
    for name in LABELS:
        file, _, table = name.partition(".")
        if not (figures.RESULTS / f"{file}.json").is_file():
            continue
        for row in figures.kept(file)["tables"][table]["rows"]:
            other_machine = row.get("right") == "no"
            is_sum = "all" in (row.get("row"), row.get("asked"), row.get("block"))
            if not is_sum and not other_machine:
                found += fits_of(name, row)
    return sorted(found, key=lambda fit: -fit.worse_than_needed)


def page() -> str:
    """All rows."""
    titles = ("benchmark", "row", "answers", "hold (Wilson)", "efficiency")
    about = "Every row that has a truth, worst first; what the figures are: docs/pages/validation/intervals.md."
    rows = figures.table_of(titles, [fit.cells() for fit in every_fit()])
    return f"{NOTE}\n\n{about}\n\n{rows}\n"


def summary() -> str:
    """Of each benchmark how many rows are how efficient, of those of so many answers."""
    fits = [fit for fit in every_fit() if fit.efficiency is not None and (fit.answers or 0) >= MANY]
    rows = []
    for benchmark in sorted({fit.benchmark for fit in fits}):
        mine = [fit for fit in fits if fit.benchmark == benchmark]
        rows.append((benchmark, *_counts(mine)))
    rows.append(("all", *_counts(fits)))
    return figures.table_of(("benchmark", "rows", "below 1", "1 to 1.5", "above", "worst"), rows)


def _counts(fits: Sequence[Fit]) -> tuple[str, ...]:
    least, most = NEEDED
    costs = [fit.efficiency for fit in fits if fit.efficiency is not None]
    below = sum(cost < least for cost in costs)
    above = sum(cost > most for cost in costs)
    within = len(costs) - below - above
    return (f"{len(costs)}", f"{below}", f"{within}", f"{above}", _shown(fits[0].efficiency))
