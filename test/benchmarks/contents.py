"""What is in the container? The probe `contents` asked about recordings of particles, and what these particles are worth.

    python test/benchmarks/contents.py FOLDER --make 61                # make the recordings (half an hour), then judge them
    python test/benchmarks/contents.py FOLDER --make 61 --rigid 100    # and so many more rigid dummies
    python test/benchmarks/contents.py FOLDER                          # judge those that are there
    python test/benchmarks/contents.py --particles                     # frequency and damping at two resolutions, and theory

Each recording is of another random arm, calibrated on its twelve empty-hand runs; the empty container's runs are the baseline
(``filled_arm.py``). A kind is said where its probability, or that of what moves or does not, is `SAID` or more.

"The bound allows" a liquid where no rigid thing comes within `ODDS_NATS` of what the law's liquid of that mass, damped as its
particles are, does to this arm without noise, driven by the currents of the recording.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from contents_bound import short_of
from filled_arm import CONTAINERS, EXCHANGE_S, FILLS_M, VISCOSITIES, all_recorded, cases, dummies
from results import Results, each_answer, parser_of
from support.contents import sloshing, theory_hz

from proprio_ros.addons.contents.models import ContentsFacts, ContentsProblem
from proprio_ros.errors import ProprioError
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import read_for, replay
from proprio_ros.pipeline.request import Options, request_of

KINDS = ("nothing", "rigid", "liquid", "granular")
SAID = 0.95
ODDS_NATS = 3.0
"""Odds of 20 to 1."""
FINER = 1.35
"""So many more cells along each axis for the second resolution."""


@dataclass(frozen=True)
class Answer:
    """What was said about one recording; `why` where it was refused, and `nats` that a rigid thing falls short of a liquid."""

    truth: dict[str, Any]
    values: dict[str, dict[str, Any]]
    verdict: str
    why: str
    nats: float = 0.0

    @property
    def kind(self) -> str:
        return str(self.truth["kind"])

    def number(self, name: str) -> float | None:
        value = self.values.get(name, {}).get("value")
        return float(value) if isinstance(value, (int, float)) else None

    def holds(self, name: str, truth: float) -> bool:
        low, high = self.values[name]["ci95"]
        return bool(low <= truth <= high)

    @property
    def moving(self) -> float | None:
        """Probability that something moves in it."""
        parts = [self.number(f"{kind}_inside") for kind in ("liquid", "granular")]
        return None if None in parts else float(sum(part for part in parts if part is not None))

    @property
    def said(self) -> str | None:
        """The kind, where one is said."""
        return next(
            (kind for kind in KINDS if (self.number(f"{kind}_inside") or 0.0) >= SAID), None
        )

    @property
    def said_moving(self) -> bool | None:
        share = self.moving
        return None if share is None or SAID > share > 1.0 - SAID else share >= SAID


def answers(
    root: Path,
    most: int | None,
    jobs: int,
) -> Iterator[Answer]:
    """Every recording of the folder, asked by so many processes."""
    folders = sorted(path.parent for path in root.glob("[!.]*/truth.json"))[:most]
    truths = [json.loads((folder / "truth.json").read_text()) for folder in folders]
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        yield from (map if jobs == 1 else pool.map)(answer, folders, truths)


def answer(
    folder: Path,
    truth: dict[str, Any],
) -> Answer:
    container = truth["container"]
    settings = {f"contents.{key}": container[key] for key in ("radius", "height", "bottom")}
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "arm.yaml"
        learnt = calibrate_from_bags(
            sorted(folder.glob("empty_*")),
            {},
            output=file,
        )
        if not file.exists():
            return Answer(truth, {}, learnt.verdict.value, "not calibrated")
        options = Options(
            probe="contents",
            settings=settings,
            calibration=file,
            baseline=sorted(folder.glob("baseline_*")),
        )
        runs = sorted(folder.glob("run_*"))
        nats = allowed(runs, options, truth) if truth["kind"] == "liquid" else 0.0
        try:
            said = replay(runs, options).as_json()
        except ProprioError as error:
            return Answer(truth, {}, "error", str(error), nats)
    why = (
        ""
        if said["verdict"] == "accepted"
        else str((said["reason_codes"] or said["reasons"] or [""])[0])
    )
    return Answer(
        truth, {value["name"]: value for value in said["estimates"]}, said["verdict"], why, nats
    )


def allowed(
    bags: Sequence[Path],
    options: Options,
    truth: dict[str, Any],
) -> float:
    """How many nats the best rigid thing falls short of the liquid that is in the container, at best."""
    request = request_of(options.for_recordings(bags))
    robot, recorded = read_for(request, bags)
    facts = request.facts
    inside = truth["contents"]
    assert isinstance(facts, ContentsFacts)
    runs = [
        prepare_run(
            robot,
            run,
            None,
            facts.shell,
        )
        for run in (*recorded.runs, *recorded.baseline)
    ]
    filled = [True] * len(recorded.runs) + [False] * len(recorded.baseline)
    problem = ContentsProblem(robot, runs, facts, filled, "liquid")
    values = problem.base.copy()
    values[problem.index["payload_mass"]] = truth["container"]["mass"]
    values[problem.index["contents_mass"]] = inside["mass"]
    values[problem.index["slosh_damping_log"]] = np.log(inside["damping_ratio"])
    return min(short_of(problem, values, model) for model in ("rigid", "frozen"))


def judged(results: Results, found: Sequence[Answer]) -> None:
    """The goals' figures, kind by kind and over all."""
    results.table(
        "contents",
        {
            "in the container": "{kind}",
            "recordings": "{recordings}",
            "mass answered": "{answered}",
            "interval holds": "{hold}",
            "within 3 g or 3 %": "{near}",
            "rms error, g": "{rms:.1f}",
            "median half interval, g": "{half:.1f}",
            "rigid or moving right, of those with a verdict": "{right} of {said}",
            "moving, of those that the bound allows": "{told} of {allowed}",
            "kind": "{kind_right} of {kind_said}",
            "fill given (h < R)": "{fill_answered} of {fills}",
            "within 10 %": "{fill_near}",
        },
    )
    for kind in (*KINDS, "all"):
        of_kind = [each for each in found if kind in (each.kind, "all")]
        if of_kind:
            results.row("contents", kind=kind, **_figures(of_kind))
    dummies_ = [each for each in found if each.kind == "rigid"]
    wrong = sum((each.number("liquid_inside") or 0.0) > SAID for each in dummies_)
    results.table(
        "dummies", {"rigid dummies": "{rigid}", "called liquid with more than 0.95": "{liquid}"}
    )
    results.row("dummies", rigid=len(dummies_), liquid=wrong)


def _figures(found: Sequence[Answer]) -> dict[str, Any]:
    """A row of the table `contents`: masses in g, counts of recordings otherwise."""
    return {
        "recordings": len(found),
        **_mass_figures(found),
        **_kind_figures(found),
        **_fill_figures(found),
    }


def _mass_figures(found: Sequence[Answer]) -> dict[str, Any]:
    """How often the contents' mass was answered, and how well [g]; near is within 3 g or 3 %."""
    errors = []
    halves = []
    hold = 0
    near = 0
    for each in found:
        value = each.number("contents_mass")
        truth = each.truth["contents"]["mass"]
        if value is not None and each.values["contents_mass"].get("ci95"):
            low, high = each.values["contents_mass"]["ci95"]
            errors.append(1e3 * (value - truth))
            halves.append(500.0 * (high - low))
            hold += each.holds("contents_mass", truth)
            near += abs(value - truth) <= max(0.003, 0.03 * truth)
    return {
        "answered": len(errors),
        "hold": hold,
        "near": near,
        "rms": float(np.sqrt(np.mean(np.square(errors)))) if errors else None,
        "half": float(np.median(halves)) if halves else None,
        **each_answer(errors, halves),
    }


def _kind_figures(found: Sequence[Answer]) -> dict[str, int]:
    """How often it was said that something moves, and what; and how often that was right."""
    moved = [each for each in found if each.said_moving is not None]
    bounded = [each for each in found if each.nats > ODDS_NATS]
    said = [each for each in found if each.said is not None]
    return {
        "said": len(moved),
        "right": sum(each.said_moving == (each.kind in ("liquid", "granular")) for each in moved),
        "allowed": len(bounded),
        "told": sum(each.said_moving is True for each in bounded),
        "kind_said": len(said),
        "kind_right": sum(each.said == each.kind for each in said),
    }


def _fill_figures(found: Sequence[Answer]) -> dict[str, int]:
    """How often the fill of a shallow liquid was answered, and how often within 10 % of the container's height."""
    shallow = [
        each
        for each in found
        if each.kind == "liquid"
        and each.truth["contents"]["fill"] < each.truth["container"]["radius"]
    ]
    answered = 0
    near = 0
    for each in shallow:
        fill = each.number("fill")
        if fill is not None:
            off = abs(fill - each.truth["contents"]["fill"])
            answered += 1
            near += off <= 0.1 * each.truth["container"]["height"]
    return {"fills": len(shallow), "fill_answered": answered, "fill_near": near}


def particles(results: Results, most: int | None) -> None:
    """What the liquid is worth: each container half full, let go with a tilted surface, at two resolutions."""
    results.table(
        "particles",
        {
            "inner radius, fill, mm": "{radius_mm:g}, {fill_mm:g}",
            "viscosity, mPa s": "{mPas:g}",
            "theory, Hz": "{theory:.2f}",
            "as recorded, Hz": "{hz:.2f}",
            "finer, Hz": "{finer_hz:.2f}",
            "apart": "{apart:+.1f} %",
            "damping ratio": "{damping:.3f}",
            "finer": "{finer_damping:.3f}",
        },
    )
    picked = [
        (n, fill, v) for n, fills in enumerate(FILLS_M) for fill in fills[1:2] for v in VISCOSITIES
    ]
    for number, fill, viscosity in picked[:most]:
        container = CONTAINERS[number]
        hz, damping = sloshing(
            container.cylinder,
            fill,
            viscosity,
            container.layers,
            EXCHANGE_S,
        )
        finer = sloshing(
            container.cylinder, fill, viscosity, round(FINER * container.layers), EXCHANGE_S
        )
        results.row(
            "particles", radius_mm=1e3 * container.radius, fill_mm=1e3 * fill, mPas=1e3 * viscosity,
            theory=theory_hz(container.radius, fill), hz=hz, finer_hz=finer[0], apart=100.0 * (finer[0] / hz - 1.0),
            damping=damping, finer_damping=finer[1],
        )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "folder", nargs="?", type=Path, help="with recordings; none: nothing is judged"
    )
    parser.add_argument(
        "--make", type=int, default=0, help="so many recordings, unless they are there"
    )
    parser.add_argument("--rigid", type=int, default=0, help="so many rigid dummies more")
    parser.add_argument("--first", type=int, default=500, help="first seed of what is made")
    parser.add_argument("--at-most", type=int, help="so many are judged; default: all")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--particles", action="store_true", help="judge the particles, too")
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    if options.folder is not None:
        made = [
            *cases()[: options.make],
            *dummies(options.rigid, options.first),
        ]
        for truth in all_recorded(options.folder, options.first, made):
            print(f"made {truth['name']}", flush=True)
        found = []
        for each in answers(options.folder, options.at_most, options.jobs):
            found.append(each)
            mass = each.values.get("contents_mass", {}).get("ci95"), each.truth["contents"]["mass"]
            print(
                each.truth["name"],
                each.verdict,
                each.why,
                each.said,
                each.moving,
                f"{each.nats:.1f} nats",
                *mass,
                flush=True,
            )
        judged(results, found)
    if options.particles:
        particles(results, options.at_most)
    results.keep()


if __name__ == "__main__":
    main()
