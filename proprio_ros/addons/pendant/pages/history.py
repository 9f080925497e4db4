"""History: what was weighed, calibrated and recorded, how the arm changed, and two answers beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from html import escape
from typing import Any

from nicegui import run, ui

from proprio_ros.addons.pendant import results
from proprio_ros.addons.pendant.desk import Desk
from proprio_ros.addons.pendant.kept import Kept, kept, terms
from proprio_ros.addons.pendant.parts import card, draw, heading, select
from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.addons.pendant.words import table
from proprio_ros.quantity import shown, spec_for

NOTHING = "&ndash;"
COMPARED = (
    "verdict",
    "probe",
    "robot",
    "runs",
)
"""Of two answers, as they stand in the file."""


async def show(pendant: Pendant) -> None:
    """Fill the page."""
    desk = await pendant.at_desk()
    with ui.element("div").classes("steps history"):
        await _fill(desk, await run.io_bound(kept, desk.places) or [])


async def _fill(desk: Desk, found: Sequence[Kept]) -> None:
    with card("Kept"):
        heading("What was weighed, calibrated and recorded", 1)
        if not found:
            words = f"Nothing is kept in {desk.places.data} yet: what the wizard or Recordings answers is."
            ui.label(words).classes("small")
            return
        ui.html(_table(desk, found), sanitize=False)
    answers = [each for each in found if each.estimate.get("estimates")]
    if len(answers) > 1:
        with card("Compare"):
            _compare(answers)
    calibrated = [each for each in found if each.calibration]
    if len(calibrated) > 1:
        await _drift(calibrated[::-1])


def _table(desk: Desk, found: Sequence[Kept]) -> str:
    rows = []
    for each in found:
        number, interval = results.number_of(each.estimate)
        said = each.estimate.get("verdict", "")
        page = desk.places.address(each.report)
        link = (
            f'<a class="report" href="{escape(page)}" target="_blank">report</a>'
            if page
            else NOTHING
        )
        rows.append(
            [
                f"{each.when:%Y-%m-%d %H:%M}",
                escape(each.what),
                escape(number) or NOTHING,
                escape(interval.removeprefix("95 % interval ")) or NOTHING,
                results.verdict(said) if said else _kind_of(each),
                link,
            ]
        )
    return table(
        [
            "when",
            "what",
            "answer",
            "95 % interval",
            "",
            "",
        ],
        rows,
    )


def _kind_of(each: Kept) -> str:
    """Of what has no answer."""
    if each.calibration:
        return "calibration"
    return "recording" if each.bag else "batch"


def _compare(answers: Sequence[Kept]) -> None:
    """Two answers beside each other."""
    known = {each.folder.name: each.estimate for each in answers}
    names = {
        name: f"{name}: {results.number_of(estimate)[0] or 'no number'}"
        for name, estimate in known.items()
    }
    chosen = list(names)[:2]

    def choose(place: int, name: str) -> None:
        chosen[place] = name
        both = [known[each] for each in chosen]
        rows = [[escape(title), *map(escape, cells)] for title, cells in _differences(*both)]
        said = f'<p class="state">{escape(_apart(*both))}</p>'
        beside.set_content(table(["", *chosen], rows) + said)

    heading("Compare two answers")
    with ui.element("div").classes("row"):
        for place, label in enumerate(("One", "The other")):
            select(label, names, chosen[place], partial(choose, place))
    beside = ui.html(sanitize=False).props("role=status")
    choose(0, chosen[0])


def _differences(one: dict[str, Any], other: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """What each says, by what it is about."""
    columns = [_compared(one), _compared(other)]
    return [(about, [column[about] for column in columns]) for about in columns[0]]


def _compared(result: dict[str, Any]) -> dict[str, str]:
    """What a result says, by what it is about."""
    number, interval = results.number_of(result)
    calibration = result.get("calibration") or {}
    return {
        "answer": number or "no number",
        "95 % interval": interval.removeprefix("95 % interval "),
        **{key: str(result.get(key, "")) for key in COMPARED},
        "calibration": str(calibration.get("fingerprint", "none"))[:8],
    }


def _apart(one: dict[str, Any], other: dict[str, Any]) -> str:
    """How far apart two answers are, and whether their intervals meet."""
    first = one["estimates"][0]
    second = other["estimates"][0]
    if first["name"] != second["name"] or first["value"] is None or second["value"] is None:
        return "They do not both have a number of the same kind."
    if not isinstance(first["value"], float) or not first.get("ci95") or not second.get("ci95"):
        return ""
    apart = shown(
        first["unit"],
        abs(first["value"] - second["value"]),
        spec=spec_for(first["unit"], first["std"]),
    )
    lows, highs = zip(first["ci95"], second["ci95"], strict=True)
    meet = max(lows) <= min(highs)
    return f"{apart} apart; their intervals {'overlap' if meet else 'do not overlap'}."


async def _drift(calibrated: Sequence[Kept]) -> None:
    """Dry friction of each joint by its calibrations."""
    days = {
        f"{each.when:%Y-%m-%d %H:%M:%S}": await run.io_bound(terms, each.calibration) or {}
        for each in calibrated
    }
    names = sorted({joint for each in days.values() for joint in each})
    rows = [[day, *(_within(each.get(joint)) for joint in names)] for day, each in days.items()]
    curves = {
        joint: [[day, each[joint][0]] for day, each in days.items() if joint in each]
        for joint in names
    }
    with card("How the arm drifts"):
        heading("How the arm drifts")
        title = "Dry friction [N m or N], by calibration"
        draw([{"title": title, "curves": curves, "across": {"type": "category"}}])
        ui.html(table(["calibrated", *names], rows), sanitize=False)


def _within(known: tuple[float, float] | None) -> str:
    return f"{known[0]:.4f} &plusmn;{known[1]:.4f}" if known else NOTHING
