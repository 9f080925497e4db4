"""The wizard: choose what to do, say what is asked, confirm once that the arm may move, and read the answer."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from functools import partial
from html import escape

from nicegui import Client, ui

from proprio_ros.addons.pendant.drawing import GREY, ORANGE, Drawing
from proprio_ros.addons.pendant.news import curve_of
from proprio_ros.addons.pendant.pages.which_arm import WhichArm
from proprio_ros.addons.pendant.parts import (
    READS_S,
    Progress,
    card,
    draw,
    heading,
    refuse,
    select,
)
from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.addons.pendant.results import answer, figures_of, report_of
from proprio_ros.addons.pendant.tasks import (
    CALIBRATE,
    Task,
    settings_of,
    tasks,
    ways_of,
    what_moves,
)
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.robot import Robot

GRAMS = 1e-3  # kg


def show(pendant: Pendant) -> None:
    """Fill the page."""
    found = tasks()
    with ui.element("div").classes("wizard"):
        choices = ui.element("nav").classes("tasks").props('aria-label="What to do"')
        with ui.element("div").classes("steps"):
            asked = card("Task")
            _Progress(pendant, {task.service: task.title for task in found})
    forms = _Forms(pendant, asked, ui.context.client)
    with choices:
        arm = WhichArm(pendant, asked)
        ui.button("Which arm", on_click=arm.show).props("flat no-caps")
        for task in found:
            button = ui.button(task.title, on_click=partial(forms.show, task))
            button.props("flat no-caps")
    forms.show(found[0])


class _Forms:
    """What is asked before a task is begun."""

    def __init__(self, pendant: Pendant, place: ui.element, client: Client) -> None:
        self._pendant = pendant
        self._place = place
        self._client = client
        self._texts: dict[str, ui.input] = {}
        self._pushes = ""  # a sequence; empty: as the identifier is set
        self._reference: ui.number | None = None

    def show(self, task: Task) -> None:
        """Ask for what this task needs."""
        self._texts = {}
        self._pushes = ""
        self._reference = None
        self._place.clear()
        with self._place:
            heading(task.title, 1)
            ui.label(task.hand).classes("hand-words")
            for fact in task.facts:
                field = ui.input(f"{fact.label} [mm]").props(
                    f'hint="{escape(fact.where)}" outlined'
                )
                self._texts[fact.key] = field
            if task.service == CALIBRATE:
                where = "from scales; put it in when the arm asks for it; empty: none"
                self._reference = ui.number("Weighed reference [g]", min=0.0, max=5000.0)
                self._reference.props(f'hint="{where}" outlined')
            if task.pushes:
                choices = {"": "as the identifier is set", **task.pushes}
                select("Pushes", choices, "", self._choose)
            start = ui.button("Start", on_click=partial(self._ask, task)).props("no-caps size=lg")
            start.set_enabled(not self._pendant.read_only)

    def _choose(self, name: str) -> None:
        self._pushes = name

    async def _ask(self, task: Task) -> None:
        """Say what will move, and begin when that is confirmed."""
        try:
            settings = settings_of(
                task, {key: str(it.value or "") for key, it in self._texts.items()}
            )
            why = self._pendant.may(self._client.id)
            if why:
                raise ConfigurationError(why)
            sequences = await self._sequences(task)
        except ConfigurationError as error:
            refuse(str(error))
            return
        robot = await self._pendant.robot()
        with ui.dialog() as dialog, ui.card().classes("confirm"):
            dialog.on("hide", dialog.delete)
            ui.label("The arm will move" if task.parameters else task.title).classes("title")
            ui.label(task.hand).classes("hand-words")
            ui.label(task.moves or what_moves(sequences, robot))
            if robot is not None:
                await self._draw(sequences, robot)
            ui.label("Keep away from it. STOP, or the space bar, ends it; the arm is then held.")
            with ui.row():
                begin = ui.button("Begin", on_click=lambda: dialog.submit(True))
                begin.props("no-caps size=lg")
                wait = ui.button("Not yet", on_click=lambda: dialog.submit(False))
                wait.props("flat no-caps")
        if await dialog:
            await self._begin(task, settings)

    async def _draw(self, sequences: list[str], robot: Robot) -> None:
        """The arm as it stands, and where its hand will go."""
        pose = dict(self._pendant.news.positions)
        try:
            between, pushed = await asyncio.to_thread(ways_of, sequences, robot, pose)
        except ProprioError as error:
            ui.label(f"Its ways cannot be drawn: {error}")
            return
        if pushed:
            drawing = Drawing(robot.model, robot.payload_frame)
            drawing.show(pose)
            drawing.way(between, GREY)
            drawing.way(pushed, ORANGE)
            ui.label("Orange: as far as pushes may take the hand. Grey: on the way there.")

    async def _sequences(self, task: Task) -> list[str]:
        """What the identifier would have made."""
        names = await self._pendant.parameters(*task.parameters, "reference_mass")
        if names is None:
            raise ConfigurationError("the identifier does not answer; start it: proprio live")
        sequences = [str(names[parameter]) for parameter in task.parameters]
        if self._pushes:
            sequences = self._chosen(task)
        weighs = self._stated_reference(float(names["reference_mass"]))
        if task.service == CALIBRATE and not weighs:
            del sequences[1:]
        return sequences

    def _chosen(self, task: Task) -> list[str]:
        """A sequence for each parameter: the reference is pushed as the empty hand is."""
        reference = self._pushes.replace("empty_hand", "reference")
        return [self._pushes, reference][: len(task.parameters)]

    def _stated_reference(self, otherwise_kg: float) -> float:
        """Mass of the reference [kg]; what the identifier has where nothing is typed."""
        typed = self._reference.value if self._reference is not None else None
        return otherwise_kg if typed is None else GRAMS * float(typed)

    async def _begin(self, task: Task, settings: list[str]) -> None:
        """State what the task needs, call its service, and put back what was stated for it alone."""
        page = self._client.id
        stated: dict[str, object] = {}
        if self._reference is not None and self._reference.value is not None:
            stated["reference_mass"] = self._stated_reference(0.0)
        before: dict[str, object] = {}
        if self._pushes:
            before = await self._pendant.parameters(*task.parameters) or {}
            stated |= dict(zip(task.parameters, self._chosen(task), strict=True))
        try:
            why = await self._pendant.state(page, stated) if stated else ""
            if why:
                raise ConfigurationError(why)
            call = self._pendant.begin(page, task.service, settings)
        except ConfigurationError as error:
            refuse(str(error))
            return
        if before:
            call.then = lambda: self._pendant.put_back(before)


class _Progress:
    """The latest call, as every page sees it."""

    def __init__(self, pendant: Pendant, titles: Mapping[str, str]) -> None:
        self._pendant = pendant
        self._titles = titles
        self._drawn = 0  # pushes
        self._progress = Progress("Progress")
        with self._progress.card:
            self._curves = ui.element("div")
            self._figures = ui.html().classes("figures")
        ui.timer(READS_S, self._read, immediate=True)

    async def _read(self) -> None:
        call = self._pendant.calls.latest
        if call is None:
            self._progress.read(None)
            return
        runs = call.progress
        number, of = runs or (0, 0)
        doing = f"run {number} of {of}" if runs else "preparing"
        if call.cancelled:
            doing = "stopping; the arm is held"
        title = self._titles.get(call.service, call.service)
        changed = self._progress.read(call, title, doing, call.under_way)
        self._progress.bar.set_value((number - 0.5) / of if of else 0.0)
        self._draw()
        if changed:
            desk = await self._pendant.at_desk()
            page = report_of(call)
            figures = figures_of(page)
            self._figures.set_content(figures)
            self._curves.set_visibility(not figures)
            with self._progress.answer:
                ui.html("" if call.under_way else answer(call))
                address = desk.places.address(page)
                if address:
                    ui.link("Report", address, new_tab=True).classes("report")

    def _draw(self) -> None:
        """The way of each push that is over; what is simulated of it comes with the answer."""
        news = self._pendant.news
        over = list(news.pushes)[: len(news.pushes) - news.pushing]
        if len(over) == self._drawn:
            return
        self._drawn = len(over)
        self._curves.clear()
        curves = [curve_of(push) for push in over]
        named = {f"{n} {joint}": way for n, (joint, way) in enumerate(curves, 1)}
        if named:
            with self._curves:
                draw([{"title": "Measured in each run [rad or m]", "curves": named}])
