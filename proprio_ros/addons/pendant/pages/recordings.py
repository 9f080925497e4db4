"""Recordings: choose some, look into them, say what the hand holds in each, and have the answer."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from nicegui import run, ui
from nicegui.events import GenericEventArguments

from proprio_ros.addons.pendant import results
from proprio_ros.addons.pendant.calls import Job
from proprio_ros.addons.pendant.desk import KNOWN, ROLES, Chosen, Desk, batches
from proprio_ros.addons.pendant.kept import calibrations
from proprio_ros.addons.pendant.parts import (
    READS_S,
    Progress,
    attempt,
    card,
    draw,
    drop,
    heading,
    refuse,
    select,
)
from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.addons.pendant.places import TAKEN, UPLOADS, Entry
from proprio_ros.errors import ProprioError
from proprio_ros.inputs.resources import resource_names
from proprio_ros.probes import all_probes

UNITS = ("N.m", "A", "mA", "raw")
SHOWS = (
    "setTimeout(() => document.querySelector('.progress').scrollIntoView({block: 'center'}), 700)"
)
DRAGS = "(event) => event.dataTransfer.setData('text/plain', %s)"
DROPS = "(event) => { event.preventDefault(); emit(event.dataTransfer.getData('text/plain')); }"


async def show(pendant: Pendant) -> None:
    """Fill the page."""
    desk = await pendant.at_desk()
    with ui.element("div").classes("offline"):
        _Browser(pendant, card("Choose"))
        with ui.element("div").classes("steps"):
            chosen = card("Chosen recordings")
            asked = card("What is asked")
            fill = partial(_ask, pendant, asked)
            await fill()
            _Outcome(desk, fill)
    _Chosen(pendant, chosen)


class _Browser:
    """Folders and what they hold."""

    def __init__(self, pendant: Pendant, place: ui.element) -> None:
        self._desk = pendant.desk
        self._reads_only = pendant.read_only
        self._folder = self._desk.places.begun
        with place:
            heading("Choose", 1)
            roots = {str(path): name for name, path in self._desk.places.roots.items()}
            select("Folder", roots, str(self._folder), self._go)
            self._where = ui.label().classes("command")
            self._list = ui.element("ul").classes("entries")
            if batches() and not self._reads_only:
                ui.button("Batch over this folder", on_click=self._batch).props("outline no-caps")
            if not self._reads_only:
                hint = f"{', '.join(TAKEN[:2])}, .csv, .parquet; kept in {UPLOADS}"
                drop("Drop a recording, or choose a file", hint, TAKEN)
        ui.timer(0.0, self._show, once=True)

    async def _go(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        await self._show()

    async def _show(self) -> None:
        places = self._desk.places
        try:
            found = await run.io_bound(places.entries, self._folder)
        except ProprioError as error:
            refuse(str(error))
            found = []
        self._where.set_text(str(self._folder))
        self._list.clear()
        with self._list:
            if self._folder not in places.roots.values():
                self._row("Up", "one folder", partial(self._go, self._folder.parent))
            for entry in found or []:
                act = partial(self._go, entry.path) if entry.opens else partial(self._choose, entry)
                self._row(entry.name, entry.kind, act)
            if not found:
                ui.label("Nothing that could be opened.").classes("small")

    def _row(self, name: str, kind: str, act: Callable[[], Any]) -> None:
        with ui.element("li"):
            button = ui.button(on_click=act).props("flat no-caps dense align=left")
            with button:
                ui.label(name).classes("name")
                ui.label(kind).classes("small")

    def _choose(self, entry: Entry) -> None:
        attempt(partial(self._desk.choose, entry.path))

    def _batch(self) -> None:
        attempt(partial(self._desk.begin_batch, self._folder))
        ui.run_javascript(SHOWS)


class _Chosen:
    """Recordings on the desk."""

    def __init__(self, pendant: Pendant, place: ui.element) -> None:
        self._desk = pendant.desk
        self._rows: dict[str, _Row] = {}
        with place:
            heading("Recordings")
            self._none = ui.label("None is chosen yet: choose a bag, a table or an episode.")
            self._none.classes("small")
            self._none.set_visibility(False)
            with ui.element("div").classes("row") as self._roles:
                for role, words in ROLES.items():
                    zone = ui.label(f"Drag here: {words}").classes("drop small")
                    zone.on("drop", partial(self._give, role), js_handler=DROPS)
                    zone.on("dragover", js_handler="(event) => event.preventDefault()")
            self._place = ui.element("div")
        ui.timer(READS_S, self._read, immediate=True)

    def _give(self, role: str, event: GenericEventArguments) -> None:
        each = self._desk.chosen.get(event.args)
        if each is not None:
            each.role = role

    def _read(self) -> None:
        desk = self._desk
        if desk.jobs.under_way is None:
            attempt(desk.begin_look)
        self._none.set_visibility(not desk.chosen)
        self._roles.set_visibility(bool(desk.chosen))
        for name, row in list(self._rows.items()):
            if desk.chosen.get(name) is not row.each or row.is_old:
                self._rows.pop(name).place.delete()
        for place, (name, each) in enumerate(desk.chosen.items()):
            if name not in self._rows:
                with self._place:
                    self._rows[name] = _Row(desk, name, each)
                self._rows[name].place.move(target_index=place)
            self._rows[name].read()


class _Row:
    """What is in one recording, and in the hand; its boxes keep the focus while it is looked into."""

    def __init__(self, desk: Desk, name: str, each: Chosen) -> None:
        self.each = each
        self._role = each.role
        self._found: Mapping[str, Any] | None = None
        with ui.element("div").classes("chosen") as self.place:
            self.place.props(f'draggable=true role=group aria-label="{escape(name)}"')
            self.place.on("dragstart", js_handler=DRAGS % json.dumps(name))
            with ui.element("div").classes("head"):
                ui.label(name).classes("name")
                leave = ui.button("Leave out", on_click=partial(desk.leave, name))
                leave.props(f'flat dense no-caps aria-label="Leave out {escape(name)}"')
            with ui.element("div").classes("row"):
                select("In the hand", ROLES, each.role, self._give_role)
                self._mass = ui.number("Mass [g]", value=each.known_g, min=0.0, max=50000.0)
                self._mass.on_value_change(lambda event: setattr(each, "known_g", event.value))
                self._usable = ui.label().classes("small").props("role=status")
            self._inside = ui.expansion("What is in it", on_value_change=self._draw)
            self._inside.classes("looked")

    @property
    def is_old(self) -> bool:
        """Whether another browser has said something else."""
        return self._role != self.each.role

    def _give_role(self, role: str) -> None:
        self._role = role
        self.each.role = role

    def read(self) -> None:
        """Show what is new."""
        found = self.each.found
        self._mass.set_visibility(self._role == KNOWN)
        self._inside.set_visibility(bool(found))
        usable = f"{found['usable_runs']} usable" if found else "is looked into ..."
        self._usable.set_text(usable)
        if found is not self._found:
            self._found = found
            self._inside.clear()
            with self._inside:
                ui.html(results.checked(found), sanitize=False)
            self._draw()

    def _draw(self) -> None:
        """Signals, when it is opened first."""
        drawn = [
            child for child in self._inside.default_slot.children if isinstance(child, ui.echart)
        ]
        if self._inside.value and not drawn:
            with self._inside:
                draw(self.each.signals)


async def _ask(pendant: Pendant, place: ui.element) -> None:
    """What is stated besides."""
    desk = pendant.desk
    asked = desk.asked
    found = await run.io_bound(calibrations, desk.places)
    known = {desk.shown(path): f"{path.parent.name}/{path.name}" for path in found or []}
    drivers = {name: name for name in resource_names("drivers")}
    place.clear()
    with place:
        heading("What is asked")
        with ui.element("div").classes("row"):
            for label, key, options in (
                ("Quantity", "probe", {probe.name: probe.name for probe in all_probes()}),
                (
                    "Robot",
                    "robot",
                    {"": "open_manipulator_x, or the calibration's", **desk.robots()},
                ),
                ("Calibration", "calibration", {"": "none, or by the recordings above", **known}),
                ("Driver", "driver", {"": "not stated", **drivers}),
                (
                    "Unit of effort",
                    "effort_unit",
                    {"": "by the driver", **{unit: unit for unit in UNITS}},
                ),
            ):
                select(label, options, getattr(asked, key), partial(_state, desk, key))
        facts = ui.input("Facts about the object", value=asked.facts)
        facts.props(
            'outlined dense hint="KEY=VALUE, such as payload.shape=sphere payload.com=[0,0,0.01]"'
        )
        facts.on_value_change(lambda event: setattr(asked, "facts", event.value or ""))
        if not pendant.read_only:
            ui.button("Answer", on_click=partial(_answer, desk)).props("no-caps size=lg")


def _answer(desk: Desk) -> None:
    before = desk.jobs.latest
    attempt(desk.begin_answer)
    if desk.jobs.latest is not before:
        ui.run_javascript(SHOWS)


def _state(desk: Desk, key: str, value: str) -> None:
    """What changes how recordings are read has them looked into anew."""
    setattr(desk.asked, key, value)
    if key in ("robot", "driver", "effort_unit"):
        for each in desk.chosen.values():
            each.found = {}


class _Outcome:
    """The latest job, as every page sees it."""

    def __init__(self, desk: Desk, learnt: Callable[[], Awaitable[None]]) -> None:
        self._desk = desk
        self._learnt = learnt  # called when there may be a new calibration
        self._progress = Progress("Answer")
        self._progress.bar.props("indeterminate")
        with self._progress.card:
            self._cancel = ui.button("Cancel", on_click=self._end).props("outline no-caps")
        ui.timer(READS_S, self._read, immediate=True)

    def _end(self) -> None:
        job = self._desk.jobs.under_way
        if job is not None:
            job.cancel()

    async def _read(self) -> None:
        job = self._desk.jobs.latest
        runs = self._desk.jobs.under_way is not None
        self._cancel.set_visibility(runs)
        title = job.service if job is not None else ""
        doing = "is being cancelled" if job is not None and job.cancelled else "at work"
        changed = self._progress.read(job, title, doing, runs)
        if job is not None and changed and not runs:
            with self._progress.answer:
                self._show(job)
            if job.steps[0].kind == "calibrate":
                await self._learnt()

    def _show(self, job: Job) -> None:
        if job.cancelled:
            ui.label("Cancelled.").classes("state")
            return
        for step in job.steps:
            if step.answer and not (step.kind == "check" and "error" not in step.answer):
                ui.html(results.answered(step), sanitize=False)
                page = self._desk.places.address(step.report)
                if page:
                    ui.link("Report", page, new_tab=True).classes("report")
