"""Which arm: the one that the nodes work with, one that is ready, or a URDF whose robot file is asked for what it lacks."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from proprio_ros.addons.pendant.calls import Job
from proprio_ros.addons.pendant.parts import READS_S, attempt, drop, heading, select
from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.addons.pendant.places import DESCRIPTION
from proprio_ros.addons.pendant.tasks import LACKS, filled, parts_of
from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.robot import load_robot


class WhichArm:
    """What is asked before the nodes work with another arm.

    Args:
        pendant: Whose arm it is.
        place: To be filled.
    """

    def __init__(self, pendant: Pendant, place: ui.element) -> None:
        self._pendant = pendant
        self._place = place
        self._job: Job | None = None
        self._asked: dict[str, ui.number] = {}

    async def show(self) -> None:
        """Fill the place."""
        self._place.clear()
        with self._place:
            heading("Which arm", 1)
            inner = ui.element("div").classes("steps")
        found = await self._pendant.robot()
        if inner.is_deleted:
            return  # something else was clicked meanwhile
        with inner:
            name = found.name if found else "an arm that no node names"
            ui.label(f"The nodes work with {name}.").classes("hand-words")
            ready = {"": "choose ...", **self._pendant.desk.robots()}
            select(
                "Another that is ready",
                ready,
                "",
                self._choose,
            )
            if not self._pendant.read_only:
                drop("Drop a URDF, or choose a file", f"{DESCRIPTION}: of any arm", (DESCRIPTION,))
            self._form = ui.element("div").classes("steps").props("role=status")
            ui.timer(READS_S, self._read)

    def _choose(self, name: str) -> None:
        self._form.clear()
        if name:
            with self._form:
                ui.label("Start the nodes with it:")
                ui.label(f"proprio live --robot {name}").classes("command")

    def _read(self) -> None:
        jobs = self._pendant.desk.jobs
        job = jobs.latest
        if job is None or job is self._job or jobs.under_way or job.steps[0].kind != "robot":
            return
        self._job = job
        self._form.clear()
        with self._form:
            self._ask(job.steps[0].answer)

    def _ask(self, new: dict[str, Any]) -> None:
        """What a new file lacks."""
        if "to_state" not in new:
            ui.label(str(new["message"]))
            return
        limits = [f"joints.{joint}.motor.current_limit_A" for joint in new["no_effort_limit"]]
        ui.label(f"{new['robot']}: what its URDF does not say").classes("hand-words")
        path = Path(new["output"])
        frame = f"Objects are held in {new['payload_frame']}"
        ui.label(f"{frame}: a guess; another: payload_frame in {path}")
        self._asked = {}
        for key in (*new["to_state"], *limits):
            joint, name = parts_of(key)
            label, where = LACKS[name]
            self._asked[key] = ui.number(f"{joint}: {label}").props(f'outlined hint="{where}"')
        write = partial(attempt, partial(self._write, path))
        ui.button("Write the robot file", on_click=write).props("no-caps size=lg")

    def _write(self, path: Path) -> None:
        values = {key: float(it.value) for key, it in self._asked.items() if it.value is not None}
        text = filled(path.read_text(encoding="utf-8"), values)
        write_in_one_step(path, text, "the robot file")
        load_robot(path)
        self._choose(str(path))
