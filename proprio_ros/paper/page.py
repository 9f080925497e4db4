"""The page: every experiment's rows as tables and figures, each number with its spread over the seeds.

What was not run is not on it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from proprio_ros.inputs.resources import write_in_one_step
from proprio_ros.paper import quoted
from proprio_ros.paper.experiments import CUBES, EVALUATIONS, OBJECTS, STARTS_KG, Rows
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import document, framed, provenance, table

COLORS = ("agreeing", "answer", "current", "measured", "apart")
"""Of series in one plot, classes of the style sheet."""


def write_paper_page(
    found: Mapping[str, Sequence[Rows]], path: Path, command: str, seeds: int, recording: Rows | None = None
) -> None:
    """Write the page.

    Args:
        found: rows of every seed by experiment.
        path: the HTML file.
        command: that makes it again.
        seeds: how many were asked for.
        recording: what ``published`` made of the paper's own recording, where it was given.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    parts = [*paper_parts(found, seeds, recording), *_cost(found), *provenance(command, [], {})]
    write_in_one_step(path, document("The paper, reproduced", parts), "--out")


def paper_parts(found: Mapping[str, Sequence[Rows]], seeds: int, recording: Rows | None = None) -> list[str]:
    """What the page says, as HTML; the documentation takes its tables and figures from here."""
    parts = _head(seeds, recording is not None)
    for name, section in SECTIONS.items():
        if found.get(name):
            parts += section(found[name])
        if name == "starts" and recording is not None:
            parts += _published(recording)
    return parts


def _cost(found: Mapping[str, Sequence[Rows]]) -> list[str]:
    """What all of it took of a processor."""
    lines = [
        [
            name,
            str(len(rows)),
            _over([row.get("cost_s") for row in rows]),
            f"{sum(row.get('cost_s', 0.0) for row in rows):.0f}",
        ]
        for name, rows in found.items()
    ]
    total = sum(row.get("cost_s", 0.0) for rows in found.values() for row in rows)
    if total == 0.0:
        return []
    return [
        '<h2 id="cost">What it costs</h2>',
        f"<p>{total:.0f} s of one processor in all, kernels compiled; two processes share everything but the speed table.</p>",
        _table("cost", ["experiment", "seeds", "each (s)", "all (s)"], lines, (1, 2, 3)),
    ]


def _head(seeds: int, recording: bool) -> list[str]:
    one = (
        "One section is of the paper's own public recording."
        if recording
        else "The paper's own public recording is not in this package: name its folder with --recording."
    )
    return [
        "<h1>The paper, reproduced</h1>",
        f"<p>The experiments of {escape(quoted.AUTHORS)}: <i>{escape(quoted.TITLE)}</i>, ICRA 2025, "
        f"{escape(quoted.ADDRESS)}, in the paper's way and in ours, on the same recordings.</p>",
        "<p><strong>There is no arm here.</strong> The recordings come from MuJoCo: an OpenMANIPULATOR-X whose torque constants, "
        "friction, armature, links, delays and encoder errors are drawn at random for each seed and hidden from every way of "
        "identifying. No number on this page was measured on hardware, except where a row says that it is the paper's. "
        f"{one}</p>",
        f"<p>{seeds} seed{'s' * (seeds != 1)}, each another robot. A &plusmn; b is mean and standard deviation over the seeds; "
        "c (d to e) is the rms or the median of one number from each seed, and the least and the greatest of them. "
        "<em>The paper's way</em>: one unknown, squared error of the last frame, semi-implicit Euler, Adam, every number of the "
        "robot taken as exact. <em>As stated</em>: the robot as its file describes it. <em>Calibrated</em>: after it learnt "
        "itself from runs with an empty hand. "
        "Of the paper&#39;s own numbers those stand here that this package quotes; its tables cell by cell are not available "
        "here.</p>",
    ]


# --- tables ----------------------------------------------------------------------------------------------------------


def _table(
    name: str, header: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int], labels: int = 1
) -> str:
    """A table whose rows can be linked to: by its name and what stands in the first ``labels`` cells."""
    ids = [_slug(name, *row[:labels]) for row in rows]
    return table(header, rows, numbers, ids, labels)


def _slug(*words: str) -> str:
    """Of letters, digits and hyphens."""
    return re.sub(r"[^a-z0-9.]+", "-", " ".join(words).lower().replace("'", "")).strip("-")


def _over(values: Sequence[float | None], scale: float = 1.0, digits: int = 1) -> str:
    """Mean and standard deviation over seeds."""
    known = scale * np.array([value for value in values if value is not None])
    if not len(known):
        return "-"
    middle = f"{known.mean():.{digits}f}"
    return f"{middle} \u00b1 {known.std(ddof=1):.{digits}f}" if len(known) > 1 else middle


def _rms(rows: Sequence[Rows], scale: float, digits: int = 1) -> str:
    """Root mean square of the errors, and the least and the greatest of them."""
    off = [abs(row["value"] - row["truth"]) for row in rows if row["value"] is not None]
    return _ranged(float(np.sqrt(np.mean(np.square(off)))), off, scale, digits) if off else "-"


def _ranged(middle: float, values: Sequence[float], scale: float, digits: int) -> str:
    """A number for many, with the least and the greatest of them."""
    word = f"{scale * middle:.{digits}f}"
    if len(values) < 2:
        return word
    return f"{word} ({scale * min(values):.{digits}f} to {scale * max(values):.{digits}f})"


def _holds(rows: Sequence[Rows]) -> str:
    """How many intervals hold the truth, of those that there are."""
    known = [row for row in rows if row["low"] is not None]
    held = sum(row["low"] <= row["truth"] <= row["high"] for row in known)
    return f"{held} of {len(known)}" if known else "no interval"


def _half(rows: Sequence[Rows], scale: float, digits: int = 1) -> str:
    """Half the width of the intervals: median, least and greatest."""
    known = [0.5 * (row["high"] - row["low"]) for row in rows if row["low"] is not None]
    return "\u00b1" + _ranged(float(np.median(known)), known, scale, digits) if known else "-"


def _verdicts(rows: Sequence[Rows]) -> str:
    words = [row["verdict"].replace("_", " ") for row in rows if row["verdict"]]
    return ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words)) or "gives none"


def _flat(found: Sequence[Rows], **labels: Any) -> list[Rows]:
    """Rows of all seeds that have these labels."""
    every = [row for rows in found for row in rows["rows"]]
    return [row for row in every if all(row[key] == value for key, value in labels.items())]


def _labels(found: Sequence[Rows], key: str) -> list[Any]:
    return list(dict.fromkeys(row[key] for rows in found for row in rows["rows"]))


STATES = ((False, "as stated"), (True, "calibrated"))


def _objects(found: Sequence[Rows]) -> list[str]:
    header = [
        "object",
        "true (g)",
        "way",
        "robot",
        "identified (g)",
        "rms error (g)",
        "interval (g)",
        "holds",
        "verdict",
        "time (s)",
    ]
    lines, totals = [], []
    for calibrated, state in STATES:
        for way, runs in (("paper", 1), ("ours", 1), ("ours", 2)):
            words = (
                "the paper's, one lift"
                if way == "paper"
                else ("ours, one lift" if runs == 1 else "ours, lift and lower")
            )
            every = _flat(found, way=way, runs=runs, calibrated=calibrated)
            if not every:
                continue
            totals.append((f"{words}, {state}", every))
            for name in OBJECTS:
                rows = [row for row in every if row["object"] == name]
                lines.append(
                    [
                        name, f"{1e3 * OBJECTS[name][0]:g}", words, state, _over([row["value"] for row in rows], 1e3),
                        _rms(rows, 1e3), _half(rows, 1e3), _holds(rows), _verdicts(rows),
                        _over([row["seconds"] for row in rows], 1.0, 2),
                    ]
                )  # fmt: skip
    order = {name: place for place, name in enumerate(OBJECTS)}
    lines.sort(key=lambda line: order[line[0]])
    paper = [
        ["errors of the four masses", quoted.MASS_ERRORS], ["its time", quoted.TIME], ["identified, by object", quoted.MISSING],
    ]  # fmt: skip
    parts = [
        '<h2 id="table-1">Table I: four objects in the hand</h2>',
        "<p>One lift of the elbow, as in the paper, with as much current as it takes; shape and size of the object are stated. The "
        "paper's way may run until it has reached its least error (five starts, 400 iterations), which is what its time is of. "
        "Times are those of a processor, without what else the machine does.</p>",
        _table("table-1", header, lines, (1, 4, 5, 6, 9), 4),
        table(["the paper says", ""], paper, ()),
        "<h3>With and without calibration, one run against lift and lower</h3>",
    ]
    over_all = [[words, _rms(rows, 1e3), _half(rows, 1e3), _holds(rows)] for words, rows in totals]
    parts.append(_table("all", ["way and robot", "rms error (g)", "interval (g)", "holds"], over_all, (1, 2)))
    series = []
    for color, (words, rows) in zip((*COLORS, "simulated"), totals, strict=False):
        known = [row for row in rows if row["value"] is not None]
        if not known:
            continue
        true = np.array([1e3 * row["truth"] for row in known])
        off = np.array([1e3 * (row["value"] - row["truth"]) for row in known])
        series.append(Series(words, true, off, color, "dots", listed=False))
    panels = [Panel(f"{one.name}: error (g)", "g", [one], 80.0, rules=[0.0]) for one in series]
    parts.append(
        framed(chart(panels, Axis("true mass (g)", "g"), "Error of the mass by way"), "A dot is one robot and object.")
    )
    parts += _figure_4(found)
    return parts


def _figure_4(found: Sequence[Rows]) -> list[str]:
    parts = []
    for kind, words in (("stated", "as its file states it"), ("calibrated", "calibrated")):
        trace = next((rows["trace"][kind] for rows in found if kind in rows["trace"]), None)
        if trace is None:
            continue
        times, masses = np.array(trace["times_s"]), trace["masses_kg"]
        names = {"wrong": "wrong", "paper": "paper's", "ours": "ours"}
        series = [
            Series(f"{names[name]} {1e3 * masses[name]:.1f} g", times, np.array(trace["simulated"][name]), color)
            for name, color in (("wrong", "apart"), ("paper", "answer"), ("ours", "agreeing"))
        ]
        series.append(Series("measured", times, np.array(trace["measured"]), "measured", "dots", listed=False))
        caption = (
            f"The robot {words}; heavy ball, 50 g, the first seed; dots: measured. With a wrong mass and with the one of the "
            "paper's way simulated from rest and with the robot's numbers as they are; ours with what it found beside the mass."
        )
        picture = chart(
            [Panel("elbow (rad)", "rad", series, 190.0)],
            Axis("time after the current came on (s)", "s"),
            f"Lift, robot {words}",
        )
        parts.append(framed(picture, caption))
    return ['<h2 id="figure-4">Figure 4: measured and simulated</h2>', *parts] if parts else []


def _starts(found: Sequence[Rows]) -> list[str]:
    lines = []
    ways = _labels(found, "way")
    for start in STARTS_KG:
        for calibrated, state in STATES:
            cells = []
            for way in ways:
                rows = [row for row in _flat(found, way=way, calibrated=calibrated) if abs(row["start"] - start) < 1e-9]
                cells.append(_over([row["value"] for row in rows], 1e3))
            if any(cell != "-" for cell in cells):
                lines.append(["0" if start < 1e-5 else f"{1e3 * start:g}", state, *cells])
    return [
        '<h2 id="table-2">Table II: first guesses from 0 to 4.772 kg</h2>',
        "<p>Heavy ball, 50 g, one lift. Masses in g at which each search ends.</p>",
        _table("table-2", ["first guess (g)", "robot", *ways], lines, (0, 2, 3, 4), 2),
        f"<p>The paper says {quoted.STARTS_END} for this object; its cells are {quoted.MISSING}.</p>",
        "<p>Why some fail: one iteration of Adam moves the mass by about its learning rate of 10 g, and cosine annealing lets a "
        "schedule of 15 iterations move it by about 80 g and one of 400 by about 2 kg in all. A guess farther off cannot arrive, "
        "whatever the loss is, and the short schedule stops wherever it is. Where the searches agree on another mass than 50 g, "
        "the robot's numbers are wrong, and no search mends that: compare the rows of the calibrated robot. Ours then moves "
        "friction, torque and the rest, too; where its ends differ, one lift does not tell them from the mass, and its verdict is "
        "&ldquo;too wide&rdquo;.</p>",
    ]


def _published(recording: Rows) -> list[str]:
    lines = [
        [f"{1e3 * start:g}", "-" if scheduled is None else f"{1e3 * scheduled:.1f}", f"{1e3 * end:.1f}"]
        for start, scheduled, end in recording["paths"]
    ]
    ours = recording["ours"]
    said = "no value" if ours["value"] is None else f"{1e3 * ours['value']:.1f} g"
    return [
        '<h2 id="recording">The paper\'s own recording</h2>',
        "<p>The heavy ball of 50 g, as the authors published it: positions of the elbow, with the setting of their example. The "
        "schedule of its 15 iterations, and one that reaches the least error of the last frame.</p>",
        _table("recording", ["first guess (g)", "the schedule stops at (g)", "least error at (g)"], lines, (0, 1, 2)),
        f'<p id="recording-ours">The paper: {quoted.STARTS_END}. Ours: {said}, <strong>{escape(ours["verdict"].replace("_", " "))}'
        "</strong>: "
        f"{escape(ours['why'])}. One recording, so no spread.</p>",
    ]


def _sphere(found: Sequence[Rows]) -> list[str]:
    lines = []
    for way in _labels(found, "way"):
        for calibrated, state in STATES:
            rows = _flat(found, way=way, calibrated=calibrated)
            if rows:
                lines.append(
                    [
                        way, state, _over([row["value"] for row in rows], 1e3), _rms(rows, 1e3), _half(rows, 1e3),
                        _holds(rows), _verdicts(rows),
                    ]
                )  # fmt: skip
    truth = 1e3 * _flat(found)[0]["truth"]
    return [
        '<h2 id="sphere">V-B: the sphere in the box</h2>',
        f"<p>A sphere of {truth:g} g is free in a closed box of 30 g. With one run the empty box was weighed; with three runs the "
        "empty box makes the same runs. The paper's way has the paper's law of contact and its last frame. The sphere "
        "begins where the box is lowest, as everyone is told; where it may lie anywhere: <a href='#extensions'>below</a>.</p>",
        _table(
            "sphere",
            ["way", "robot", "identified (g)", "rms error (g)", "interval (g)", "holds", "verdict"],
            lines,
            (2, 3, 4),
            2,
        ),
        f"<p>The paper: {quoted.SPHERE_ERROR} off.</p>",
    ]


def _tracking(found: Sequence[Rows]) -> list[str]:
    words = {"joint": "the joint's encoder", "camera": "a camera that sees the sphere", "both": "both"}
    lines = []
    for way, name in words.items():
        rows = _flat(found, way=way)
        lines.append(
            [
                name,
                _over([row["value"] for row in rows], 1e3),
                _rms(rows, 1e3),
                _half(rows, 1e3),
                _holds(rows),
                _verdicts(rows),
            ]
        )
    return [
        '<h2 id="tracking">V-F: with and without tracking the sphere</h2>',
        "<p>Calibrated robots, three runs and the empty box. The camera sees the sphere 30 times a second to 2 mm.</p>",
        _table(
            "tracking",
            ["identified from", "identified (g)", "rms error (g)", "interval (g)", "holds", "verdict"],
            lines,
            (1, 2, 3),
        ),
        f"<p>The paper's numbers: {quoted.MISSING}.</p>",
    ]


def _extensions(found: Sequence[Rows]) -> list[str]:
    titles = {"slide": "ball on a slide", "universal joint": "ball on a universal joint", "sphere": "sphere in the box"}
    lines = []
    for part, title in titles.items():
        for way in dict.fromkeys(row["way"] for row in _flat(found, part=part)):
            rows = _flat(found, part=part, way=way)
            lines.append(
                [
                    title, way, f"{1e3 * rows[0]['truth']:g}", _over([row["value"] for row in rows], 1e3), _rms(rows, 1e3),
                    _half(rows, 1e3), _holds(rows), _verdicts(rows),
                ]
            )  # fmt: skip
    header = ["what", "way", "true (g)", "identified (g)", "rms error (g)", "interval (g)", "holds", "verdict"]
    return [
        '<h2 id="extensions">What the paper names and does not show</h2>',
        "<p>Calibrated robots. A ball of 50 g hangs in the hand on a joint of its own: on a slide with a spring, along the hand, "
        "or 60 mm below two hinges; lift and lowering. Spring, damper and where it began are hidden; only the elbow is measured. "
        "The chain simulator identifies the mass together with them; &ldquo;explained&rdquo; says that its fit leaves no more than "
        "the encoder's noise; a spring known to 10 % is one whose frequency with the ball is. The sphere lies "
        "somewhere on the box's floor when the current comes on, elsewhere in each run.</p>",
        _table("extensions", header, lines, (2, 3, 4, 5), 2),
        f"<p>{_fails(found)}</p>",
    ]


def _fails(found: Sequence[Rows]) -> str:
    """Where it fails, as far as these rows show it."""
    said = []
    for part, what in (("slide", "slides"), ("universal joint", "swings")):
        rigid = _flat(found, part=part, way="as if it were rigid")
        wrong = [row for row in rigid if row["low"] is not None and not row["low"] <= row["truth"] <= row["high"]]
        passed = sum(row["verdict"] == "accepted" for row in wrong)
        refused = sum(row["verdict"] in ("rejected", "not_identifiable") for row in rigid)
        said.append(
            f"A ball that {what} and is weighed as if it were rigid: of {len(rigid)} answers {refused} are refused, {passed} are "
            "accepted with an interval that misses the truth, since friction and torque take up the difference."
        )
    open_spring = _flat(found, part="slide", way="on its slide, spring unknown")
    worst = max(1e3 * abs(row["value"] - row["truth"]) for row in open_spring)
    held = _holds(open_spring)
    said.append(
        f"Where nothing is known of the spring (20 &plusmn; 8 rad/s) the error reaches {worst:.0f} g and {held} intervals hold: a "
        "soft spring with a heavier ball moves the elbow almost alike. State the joint, and weigh its spring."
    )
    return " ".join(said)


def _cubes(found: Sequence[Rows]) -> list[str]:
    lines = []
    for name in CUBES:
        for quantity, words, scale in (
            ("youngs_modulus", "Young's modulus (kPa)", 1e-3),
            ("poissons_ratio", "Poisson's ratio", 1.0),
        ):
            for calibrated, state in STATES:
                for way in ("paper", "ours"):
                    rows = _flat(found, object=name, quantity=quantity, calibrated=calibrated, way=way)
                    if not rows:
                        continue
                    truth = f"{scale * rows[0]['truth']:.3g}"
                    lines.append(
                        [
                            name, words, truth, "the paper's" if way == "paper" else way, state,
                            _over([row["value"] for row in rows], scale, 2), _rms(rows, scale, 2), _half(rows, scale, 2),
                            _holds(rows), _verdicts(rows),
                        ]
                    )  # fmt: skip
    header = ["cube", "of it", "true", "way", "robot", "identified", "rms error", "interval", "holds", "verdict"]
    said = [[name, f"{mu:g}", f"{lam:g}"] for name, (mu, lam) in quoted.LAME.items()]
    return [
        '<h2 id="cubes">V-C: two soft cubes</h2>',
        "<p>Three squeezes each. The cubes have the moduli that the paper found; their edge, 30 mm, is ours. A virtual block "
        "answers by a law in closed form, and loses a little by damping. The paper's way is explicit elastodynamics of tetrahedra "
        "and the last frame of the last squeeze, from twice the modulus, between a tenth and ten times of that; ours takes all "
        "three. A dash: one that ours does not state, because the squeezes say hardly more of it than its prior.</p>",
        _table("cubes", header, lines, (2, 5, 6, 7), 5),
        table(["the paper found", "mu (Pa)", "lambda (Pa)"], said, (1, 2)),
        *_figure_5(found),
    ]


def _figure_5(found: Sequence[Rows]) -> list[str]:
    parts = []
    for name in CUBES:
        trace = next((rows["trace"][name] for rows in found if name in rows["trace"]), None)
        if trace is None:
            continue
        times, moduli = np.array(trace["times_s"]), trace["moduli_Pa"]
        series = [
            Series(f"{words} {1e-3 * moduli[key]:.1f} kPa", times, np.array(trace["simulated_mm"][key]), color)
            for key, words, color in (("wrong", "wrong", "apart"), ("identified", "found", "agreeing"))
        ]
        series.append(Series("measured", times, np.array(trace["measured_mm"]), "measured", "dots"))
        picture = chart(
            [Panel("finger (mm)", "mm", series, 170.0)],
            Axis("time after the current came on (s)", "s"),
            f"Squeeze of the {name}",
        )
        parts.append(
            framed(
                picture, f"The {name}, last of three squeezes, the first seed; Poisson's ratio and the gap as they are."
            )
        )
    return ['<h2 id="figure-5">Figure 5: the squeeze</h2>', *parts] if parts else []


# --- figures of the searches and of the cost -------------------------------------------------------------------------


def _optimisers(found: Sequence[Rows]) -> list[str]:
    names = _labels(found, "search")
    steps = np.arange(1, EVALUATIONS + 1)
    instants = np.geomspace(1e-4, max(row["seconds"][-1] for row in _flat(found)), 60)
    by_step, by_time, lines = [], [], []
    for name, color in zip(names, COLORS, strict=False):
        rows = _flat(found, search=name)
        stepped = np.array([_held(np.arange(1, len(row["cost"]) + 1), row["cost"], steps) for row in rows])
        timed = np.array([_held(row["seconds"], row["cost"], instants) for row in rows])
        by_step.append(_banded(name, steps, stepped, color))
        by_time.append(_banded(name, instants, timed, color))
        reached = [next((n + 1 for n, cost in enumerate(row["cost"]) if cost < 1.1), None) for row in rows]
        ends = [row["cost"][-1] for row in rows]
        good = [float(n) for n in reached if n is not None]
        lines.append(
            [
                name,
                f"{len(good)} of {len(rows)}",
                _over(good, 1.0, 0),
                _ranged(float(np.median(ends)), ends, 1.0, 2),
                _over([row["seconds"][-1] for row in rows], 1e3, 0),
            ]
        )
    caption = "Median over the seeds, and from the least to the greatest; 1 is the least that any search found."
    return [
        '<h2 id="figure-6">Figure 6: gradients against none</h2>',
        "<p>The same lift of the heavy ball and the same first guess, between 2 and 500 g, for every search; unknown are the mass, "
        f"and where and how fast the joint began. Each may simulate {EVALUATIONS} times. Cost is that of all samples, over "
        "the least; time is that of a processor.</p>",
        framed(chart(by_step, Axis("simulations", "", log=True), "Cost over simulations"), caption),
        framed(chart(by_time, Axis("time (s)", "s", log=True), "Cost over time"), caption),
        _table(
            "figure-6",
            [
                "search",
                "within 10 % of the least",
                "simulations to there",
                "median cost at the end",
                "time in all (ms)",
            ],
            lines,
            (2, 3, 4),
        ),
    ]


def _held(x: Any, cost: Sequence[float], grid: np.ndarray) -> np.ndarray:
    """Best cost so far at the places of a grid; the first before it is known."""
    at = np.clip(np.searchsorted(np.asarray(x), grid, side="right") - 1, 0, len(cost) - 1)
    best: np.ndarray = np.asarray(cost)[at]
    return best


def _banded(name: str, x: np.ndarray, values: np.ndarray, color: str) -> Panel:
    values = np.minimum(values, 1e9)
    median = Series(name, x, np.median(values, axis=0), color, listed=False)
    ends = [Series("", x, end, "left-out") for end in (values.min(axis=0), values.max(axis=0))]
    return Panel(f"{name}: cost over the least", "", [*ends, median] if len(values) > 1 else [median], 80.0, log=True)


def _landscapes(found: Sequence[Rows]) -> list[str]:
    units = {"payload": ("mass (g)", "g", 1e3, False), "sphere": ("mass of the sphere (g)", "g", 1e3, False)}
    units["squeeze"] = ("Young's modulus (kPa)", "kPa", 1e-3, True)
    titles = {"payload": "heavy ball", "sphere": "sphere in the box", "squeeze": "heavy cube"}
    parts, lines = [], []
    for row in found[0]["rows"]:
        words, unit, scale, log = units[row["experiment"]]
        every = _flat(found, experiment=row["experiment"])
        least = [[scale * one["x"][int(np.argmin(one[key]))] for one in every] for key in ("last", "all")]
        lines.append(
            [f"{titles[row['experiment']]} ({unit})", f"{scale * row['truth']:.3g}", *(_over(x) for x in least)]
        )
        x = scale * np.array(row["x"])
        panels = []
        for key, title, color in (("last", "last frame", "answer"), ("all", "all samples, mean", "agreeing")):
            cost = Series(title, x, np.maximum(1e6 * np.array(row[key]), 1e-3), color, listed=False)
            panels.append(
                Panel(f"{title} (mrad\u00b2)", "mrad\u00b2", [cost], 110.0, verticals=[scale * row["truth"]], log=True)
            )
        what = titles[row["experiment"]]
        parts.append(
            framed(chart(panels, Axis(words, unit, log), f"Cost, {what}"), f"{what}; the red line is the truth.")
        )
    return [
        '<h2 id="figure-7">Figure 7: what the cost looks like</h2>',
        "<p>Squared error of the position over what is searched for, calibrated robots: of the last frame, "
        "which the paper descends, and of all samples. The least lies beside the truth by as much as the robot's numbers "
        "are off. The figures are of the first seed.</p>",
        _table("figure-7", ["what", "true", "last frame least at", "all samples least at"], lines, (1, 2, 3)),
        *parts,
    ]


def _effects(found: Sequence[Rows]) -> list[str]:
    kinds = {
        "torque": ("torque taken too high by (%)", "%", 100.0, False),
        "friction": ("friction that the model leaves out (N m)", "N m", 1.0, False),
        "armature": ("armature taken too high by (%)", "%", 100.0, False),
    }
    parts, lines = [], []
    for effect, (words, unit, scale, log) in kinds.items():
        x, errors = _errors(found, effect)
        parts.append(
            framed(chart([_error_panel(scale * x, errors)], Axis(words, unit, log), f"Error of the mass over {effect}"))
        )
        per = {
            "torque": ("1 % of torque", 0.01),
            "friction": ("0.01 N m of friction", 0.01),
            "armature": ("10 % of armature", 0.1),
        }[effect]
        slopes = [1e3 * per[1] * float(np.polyfit(x, each, 1)[0]) for each in errors]
        lines.append([per[0], _over(slopes, 1.0, 2)])
    panels = []
    for integrator, words in (("semi_implicit", "semi-implicit Euler"), ("rk4", "RK4")):
        x, errors = _errors(found, integrator)
        panels.append(_error_panel(x, errors, words))
        for steps in (1, 4, 16, 64):
            at = errors[:, list(x).index(steps)]
            lines.append([f"{words}, {steps} step{'s' * (steps > 1)} per frame", _over(at.tolist(), 1e3, 2)])
    parts.append(
        framed(chart(panels, Axis("steps per frame of 1/60 s", "", log=True), "Error of the mass over substeps"))
    )
    return [
        '<h2 id="effects">What the paper leaves out</h2>',
        "<p>A robot of which all is known but one thing, one lift of the heavy ball, all samples fitted. Line: mean over the "
        "seeds, which here draw only the encoder's noise; grey: the least and the greatest.</p>",
        _table("effects", ["what is wrong", "moves the mass by (g)"], lines, (1,)),
        *parts,
    ]


def _errors(found: Sequence[Rows], effect: str) -> tuple[np.ndarray, np.ndarray]:
    """Amounts (K,) and errors of the mass [kg], shape (seeds, K)."""
    amounts = list(dict.fromkeys(row["amount"] for row in _flat(found, effect=effect)))
    return np.array(amounts, dtype=np.float64), np.array(
        [[row["error"] for row in rows["rows"] if row["effect"] == effect] for rows in found]
    )


def _error_panel(x: np.ndarray, errors: np.ndarray, words: str = "") -> Panel:
    errors = 1e3 * errors
    ends = [Series("", x, end, "left-out") for end in (errors.min(axis=0), errors.max(axis=0))]
    mean = Series("mean", x, errors.mean(axis=0), "answer", listed=False)
    return Panel(f"{words + ': ' if words else ''}error of the mass (g)", "g", [*ends, mean], 130.0, rules=[0.0])


def _speed(found: Sequence[Rows]) -> list[str]:
    lines = []
    for way in _labels(found, "way"):
        rows = _flat(found, way=way)
        lines.append(
            [
                way,
                _over([row["seconds"] for row in rows], 1e3, 0) if rows[0]["value"] is not None else rows[0]["why"],
                _rms(rows, 1e3, 2),
                _half(rows, 1e3) if rows[0]["value"] is not None else "-",
            ]
        )
    return [
        '<h2 id="speed">Speed</h2>',
        "<p>One recording that comes with the package, a robot without friction in MuJoCo, 50 g at the elbow; five first guesses, "
        "one process, everything loaded and compiled. Unknown are the mass and how the joint began; in the paper's way the mass "
        "only. None but ours states an interval. Newton: <code>SolverFeatherstone</code> with the paper's way's step, gradient "
        "through <code>wp.Tape</code>, L-BFGS-B; its steps and their adjoints are recorded once for a recording, then played "
        "again.</p>",
        _table("speed", ["way", "time of a processor (ms)", "error (g)", "interval (g)"], lines, (1, 2, 3)),
        f"<p>The paper: {quoted.TIME}.</p>",
    ]


SECTIONS: dict[str, Callable[[Sequence[Rows]], list[str]]] = {
    "objects": _objects,
    "starts": _starts,
    "sphere": _sphere,
    "tracking": _tracking,
    "cubes": _cubes,
    "extensions": _extensions,
    "optimisers": _optimisers,
    "landscapes": _landscapes,
    "effects": _effects,
    "speed": _speed,
}
"""In the order of the page."""
