"""Recordings that are chosen, what is in the hand in each, and the commands that answer what is asked; the same for all pages."""

from __future__ import annotations

import json
import math
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from proprio_ros import registry
from proprio_ros.addons.pendant.calls import Calls, Job, Step
from proprio_ros.addons.pendant.places import DESCRIPTION, Places
from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.resources import resource_names, write_in_one_step

ASKED = "asked"
EMPTY = "empty"
KNOWN = "known"
BESIDE = "beside"
ROLES = {
    ASKED: "what it holds is asked",
    EMPTY: "the hand is empty",
    KNOWN: "it holds a known mass",
    BESIDE: "baseline, without the object",
}
"""What is in the hand in a recording."""
MOST_CHOSEN = 60
ESTIMATE = "estimate.json"
REPORT = "report.html"
BATCH = "batch.html"
CALIBRATION = "calibration.yaml"


@dataclass
class Chosen:
    """A recording that was chosen."""

    role: str = ASKED
    known_g: float | None = None  # the mass in the hand, where it is known
    # what `looking` says of it; empty: it was not looked at yet
    found: dict[str, Any] = field(default_factory=dict)
    signals: list[dict[str, Any]] = field(default_factory=list)


@dataclass
class Asked:
    """What is stated besides; empty: nothing."""

    probe: str = "payload"
    robot: str = ""
    calibration: str = ""
    driver: str = ""
    effort_unit: str = ""
    facts: str = ""  # KEY=VALUE, as for ``--set``

    def robots(self) -> list[str]:
        """Options that say which arm it is, without a calibration."""
        return ["--robot", self.robot] if self.robot else []

    def arm(self) -> list[str]:
        """Options that say which arm it is, by its calibration where one is stated."""
        return ["--calibration", self.calibration] if self.calibration else self.robots()

    def read(self) -> list[str]:
        """Options that say how recordings are to be read."""
        stated = {"--driver": self.driver, "--effort-unit": self.effort_unit}
        return [word for key, value in stated.items() if value for word in (key, value)]

    def words(self) -> list[str]:
        """The same, and facts about the object. Raises `ConfigurationError`: These are none."""
        try:
            facts = shlex.split(self.facts)
        except ValueError as error:
            raise ConfigurationError(f"facts: {error}") from error
        found = self.read()
        for fact in facts:
            if "=" not in fact:
                raise ConfigurationError(
                    f"facts: {fact[:60]!r}: write KEY=VALUE, a space between two"
                )
            found.append(f"--set={fact}")
        return found


class Desk:
    """What is worked on.

    Args:
        places: That may be looked into.
        tell: Called with what goes on, a sentence at a time.

    Attributes:
        chosen: Recordings by their paths, in the order in which they were chosen.
        asked: What is stated besides.
    """

    def __init__(self, places: Places, tell: Callable[[str], None]) -> None:
        self.places = places
        self.jobs: Calls[Job] = Calls(tell)
        self.chosen: dict[str, Chosen] = {}
        self.asked = Asked()

    def shown(self, path: Path) -> str:
        """A path as one types it where the pendant was started; never one that looks like an option."""
        if not path.is_relative_to(self.places.begun):
            return str(path)
        typed = os.path.relpath(path, self.places.begun)
        return f"./{typed}" if typed.startswith("-") else typed

    def choose(self, path: Path) -> None:
        """Put a recording on the desk. Raises `ConfigurationError`: It may not be, or there are too many."""
        name = self.shown(self.places.recording(path))
        if len(self.chosen) >= MOST_CHOSEN:
            raise ConfigurationError(f"{MOST_CHOSEN} recordings are chosen; a batch takes more")
        self.chosen.setdefault(name, Chosen())

    def take(self, path: Path) -> None:
        """What was uploaded: a recording is chosen, a URDF gets a robot file. Raises `ConfigurationError`: It cannot be."""
        if path.suffix.lower() != DESCRIPTION:
            self.choose(path)
            return
        output = self.places.robots / f"{path.stem}.yaml"
        output.parent.mkdir(parents=True, exist_ok=True)
        words = [
            "robot",
            "new",
            self.shown(path),
            "--output",
            str(output),
        ]
        self.jobs.begin(Job("Robot file", [Step(words)]))

    def robots(self) -> dict[str, str]:
        """Arms that are ready: those of the package, and files that were made here."""
        made = sorted(self.places.robots.glob("*.yaml"))
        return {name: name for name in resource_names("robots")} | {
            str(path): path.name for path in made
        }

    def leave(self, name: str) -> None:
        """Take one away."""
        self.chosen.pop(name, None)

    def begin_look(self) -> None:
        """Check what was not looked at, as ``proprio check`` does. Raises `ConfigurationError`: Nothing can begin now."""
        names = [name for name, each in self.chosen.items() if not each.found]
        if not names:
            return
        asked = self.asked
        given = {
            "bags": names,
            "robot": asked.robot or None,
            "driver": asked.driver or None,
            "effort_unit": asked.effort_unit or None,
        }
        words = ["check", *names, *asked.robots(), *asked.read()]
        self.jobs.begin(
            Job(
                "Look into recordings",
                [Step(words)],
                partial(self._looked, names),
                json.dumps(given),
            )
        )

    def _looked(self, names: Sequence[str], job: Job) -> None:
        answer = job.steps[0].answer
        checks = {check["bag"]: check for check in answer.get("bags", ())}
        unread = {"problem": str(answer.get("error") or "it was not looked into"), "usable_runs": 0}
        for name in names:
            each = self.chosen.get(name)
            if each is not None:
                each.found = checks.get(name, unread)
                each.signals = answer.get("signals", {}).get(name, [])

    def begin_answer(self) -> None:
        """Calibrate where recordings say how, and answer where some are asked. Raises `ConfigurationError`: It cannot begin."""
        named = self._by_role()
        asked = self.asked
        if not named[ASKED] and not named[EMPTY]:
            raise ConfigurationError("choose a recording, and say what is in the hand")
        learns = bool(named[EMPTY])
        if named[KNOWN] and not learns:
            raise ConfigurationError(
                "a known mass calibrates beside recordings of the empty hand: choose some"
            )
        if learns and asked.calibration:
            raise ConfigurationError(
                "a calibration is stated, and recordings of the empty hand make another: state none, or call them baseline"
            )
        folder = self._folder(asked.probe if named[ASKED] else "robot")
        steps = []
        if learns:
            steps.append(self._calibration(named, folder))
        if named[ASKED]:
            steps.append(self._replay(named, folder, learns))
        title = "Answer" if named[ASKED] else "Calibration"
        self._begin(Job(title, steps, partial(_keep, folder)), folder)

    def _by_role(self) -> Mapping[str, list[str]]:
        return {
            role: [name for name, each in self.chosen.items() if each.role == role]
            for role in ROLES
        }

    def _calibration(self, named: Mapping[str, list[str]], folder: Path) -> Step:
        page = folder / (f"calibration_{REPORT}" if named[ASKED] else REPORT)
        known = []
        for name in named[KNOWN]:
            grams = self.chosen[name].known_g
            if grams is None or not math.isfinite(grams) or grams <= 0.0:
                raise ConfigurationError(f"{name}: how heavy is it? State its mass in g")
            known.append(f"{name}={1e-3 * grams:g}")
        words = ["calibrate", *named[EMPTY], *["--reference"] * bool(known), *known]
        kept = ["--output", self.shown(folder / CALIBRATION), "--report", self.shown(page)]
        return Step([*words, *kept, *self.asked.robots(), *self.asked.words()], page)

    def _replay(self, named: Mapping[str, list[str]], folder: Path, learns: bool) -> Step:
        page = folder / REPORT
        words = ["replay", *named[ASKED], "--probe", self.asked.probe]
        if named[BESIDE]:
            words += ["--baseline", *named[BESIDE]]
        learnt = ["--calibration", self.shown(folder / CALIBRATION)]
        words += learnt if learns else self.asked.arm()
        return Step([*words, "--report", self.shown(page), *self.asked.words()], page)

    def begin_batch(self, folder: Path) -> None:
        """Answer all recordings below a folder. Raises `ConfigurationError`: It cannot begin."""
        source = self.shown(self.places.recording(folder))
        out = self._folder("batch")
        words = [
            "batch",
            source,
            "--out",
            self.shown(out),
            "--probe",
            self.asked.probe,
        ]
        step = Step([*words, *self.asked.arm(), *self.asked.words()], out / BATCH)
        self._begin(Job(f"Batch over {folder.name}", [step]), out)

    def _folder(self, what: str) -> Path:
        """For an answer, called as the nodes call theirs."""
        stamp = datetime.now().strftime("%Y%m%d_%H%M%S_%f")[:-3]
        return self.places.data / f"{stamp}_{what}"

    def _begin(self, job: Job, folder: Path) -> None:
        """With a folder for what it writes. Raises `ConfigurationError`: It cannot be made, or something is under way."""
        self.jobs.check_free()
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise ConfigurationError(
                f"{folder}: {error.strerror}; answers are kept there"
            ) from error
        self.jobs.begin(job)


def batches() -> bool:
    """Whether there is a ``proprio batch``."""
    return "batch" in registry.commands()


def _keep(folder: Path, job: Job) -> None:
    """Write the answer where history finds it, as the nodes do."""
    answer = job.steps[-1].answer
    if answer.get("verdict") and job.steps[-1].kind == "replay":
        content = {key: value for key, value in answer.items() if key not in ("success", "message")}
        kept = {**content, "command": job.command}
        write_in_one_step(folder / ESTIMATE, json.dumps(kept, indent=1) + "\n", "the result")
    if not any(folder.iterdir()):
        folder.rmdir()  # nothing came of it
