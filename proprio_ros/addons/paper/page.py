"""The page: every experiment's rows as tables and figures, each number with its spread over the seeds.

What was not run is not on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from proprio_ros.addons.paper import quoted
from proprio_ros.addons.paper.cases import CUBES, OBJECTS, STARTS_KG, Rows
from proprio_ros.addons.paper.cells import (
    COLORS,
    STATES,
    flat,
    half,
    holds,
    identified,
    labels,
    linked,
    over,
    rms,
)
from proprio_ros.addons.paper.searches_page import effects, landscapes, optimisers
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.html import framed, provenance, table, write_document

# columns of `identified` for a mass
IN_GRAMS = ("identified (g)", "rms error (g)", "interval (g)", "holds", "verdict")
TIME = Axis("time after the current came on (s)", "s")


def write_paper_page(
    found: Mapping[str, Sequence[Rows]],
    path: Path,
    command: str,
    seeds: int,
    recording: Rows | None = None,
) -> None:
    """Write the page, with the command that makes it again; ConfigurationError where the file cannot be written.

    ``recording`` is what ``published`` made of the paper's own recording, where it was given.

    Args:
        found: Rows of each seed by experiment.
        path: Where the page goes.
        command: The command line that makes it again.
        seeds: How many robots were drawn.
        recording: What ``published`` made of the paper's own recording, where it was given.
    """
    parts = [
        *paper_parts(found, seeds, recording),
        *_cost(found),
        *provenance(command, [], {}),
    ]
    write_document(path, "The paper, reproduced", parts, "--out")


def paper_parts(
    found: Mapping[str, Sequence[Rows]],
    seeds: int,
    recording: Rows | None = None,
) -> list[str]:
    """What the page says, as HTML; the documentation takes its tables and figures from here.

    Args:
        found: Rows of each seed by experiment.
        seeds: How many robots were drawn.
        recording: What ``published`` made of the paper's own recording, where it was given.
    """
    parts = _head(seeds, recording is not None)
    for name, section in SECTIONS.items():
        if found.get(name):
            parts += section(found[name])
        if name == "starts" and recording is not None:
            parts += _published(recording)
    return parts


def _cost(found: Mapping[str, Sequence[Rows]]) -> list[str]:
    """What all of it took of a processor."""
    costs = {name: [row.get("cost_s") or 0.0 for row in rows] for name, rows in found.items()}
    lines = []
    for name, each in costs.items():
        lines.append([name, str(len(each)), over(each), f"{sum(each):.0f}"])
    total = sum(map(sum, costs.values()))
    if total == 0.0:
        return []
    return [
        '<h2 id="cost">What it costs</h2>',
        f"<p>{total:.0f} s of one processor in all, kernels compiled; two processes share everything but the speed table.</p>",
        linked(
            "cost",
            ["experiment", "seeds", "each (s)", "all (s)"],
            lines,
            (1, 2, 3),
        ),
    ]


def _head(seeds: int, recording: bool) -> list[str]:
    one = (
        "The paper's own public recording is not in this package: name its folder with --recording."
    )
    if recording:
        one = "One section is of the paper's own public recording."
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


class _Total(NamedTuple):
    """All rows of one way with a robot in one state."""

    way: str
    state: str
    rows: list[Rows]


def _totals(found: Sequence[Rows]) -> list[_Total]:
    """Of table I; those that have rows."""
    ways = (
        ("paper", 1, "the paper's, one lift"),
        ("ours", 1, "ours, one lift"),
        ("ours", 2, "ours, lift and lower"),
    )
    totals = []
    for calibrated, state in STATES:
        for way, runs, words in ways:
            rows = flat(found, way=way, runs=runs, calibrated=calibrated)
            if rows:
                totals.append(_Total(words, state, rows))
    return totals


def _objects(found: Sequence[Rows]) -> list[str]:
    totals = _totals(found)
    lines = []
    for name, total in product(OBJECTS, totals):
        rows = [row for row in total.rows if row["object"] == name]
        seconds = over([row["seconds"] for row in rows], 1.0, 2)
        true = f"{1e3 * OBJECTS[name][0]:g}"
        lines.append([name, true, total.way, total.state, *identified(rows, 1e3), seconds])
    header = ["object", "true (g)", "way", "robot", *IN_GRAMS, "time (s)"]
    paper = [
        ["errors of the four masses", quoted.MASS_ERRORS],
        ["its time", quoted.TIME],
        ["identified, by object", quoted.MISSING],
    ]
    over_all = [
        [f"{way}, {state}", rms(rows, 1e3), half(rows, 1e3), holds(rows)]
        for way, state, rows in totals
    ]
    return [
        '<h2 id="table-1">Table I: four objects in the hand</h2>',
        "<p>One lift of the elbow, as in the paper, with as much current as it takes; shape and size of the object are stated. The "
        "paper's way may run until it has reached its least error (five starts, 400 iterations), which is what its time is of. "
        "Times are those of a processor, without what else the machine does.</p>",
        linked("table-1", header, lines, (1, 4, 5, 6, 9), 4),
        table(["the paper says", ""], paper, ()),
        "<h3>With and without calibration, one run against lift and lower</h3>",
        linked(
            "all",
            ["way and robot", "rms error (g)", "interval (g)", "holds"],
            over_all,
            (1, 2),
        ),
        framed(_errors_by_way(totals), "A dot is one robot and object."),
        *_figure_4(found),
    ]


def _errors_by_way(totals: Sequence[_Total]) -> str:
    """The error of every mass, a panel for each way."""
    panels = []
    for color, total in zip((*COLORS, "simulated"), totals, strict=False):
        known = [row for row in total.rows if row["value"] is not None]
        if not known:
            continue
        true = np.array([1e3 * row["truth"] for row in known])
        off = np.array([1e3 * (row["value"] - row["truth"]) for row in known])
        name = f"{total.way}, {total.state}"
        series = Series(name, true, off, color, "dots", listed=False)
        panels.append(Panel(f"{name}: error (g)", "g", [series], 80.0, rules=[0.0]))
    return chart(panels, Axis("true mass (g)", "g"), "Error of the mass by way")


def _figure_4(found: Sequence[Rows]) -> list[str]:
    parts = []
    for kind, words in (("stated", "as its file states it"), ("calibrated", "calibrated")):
        trace = next((rows["trace"][kind] for rows in found if kind in rows["trace"]), None)
        if trace is None:
            continue
        times = np.array(trace["times_s"])
        masses = trace["masses_kg"]
        lines = (
            ("wrong", "wrong", "apart"),
            ("paper", "paper's", "answer"),
            ("ours", "ours", "agreeing"),
        )
        series = [
            Series(
                f"{name} {1e3 * masses[key]:.1f} g", times, np.array(trace["simulated"][key]), color
            )
            for key, name, color in lines
        ]
        series.append(
            Series(
                "measured",
                times,
                np.array(trace["measured"]),
                "measured",
                "dots",
                listed=False,
            )
        )
        caption = (
            f"The robot {words}; heavy ball, 50 g, the first seed; dots: measured. With a wrong mass and with the one of the "
            "paper's way simulated from rest and with the robot's numbers as they are; ours with what it found beside the mass."
        )
        drawn = chart([Panel("elbow (rad)", "rad", series, 190.0)], TIME, f"Lift, robot {words}")
        parts.append(framed(drawn, caption))
    return ['<h2 id="figure-4">Figure 4: measured and simulated</h2>', *parts] if parts else []


def _starts(found: Sequence[Rows]) -> list[str]:
    lines = []
    ways = labels(found, "way")
    for start, (calibrated, state) in product(STARTS_KG, STATES):
        rows = [
            row for row in flat(found, calibrated=calibrated) if abs(row["start"] - start) < 1e-9
        ]
        if rows:
            cells = [over([row["value"] for row in rows if row["way"] == way], 1e3) for way in ways]
            lines.append(["0" if start < 1e-5 else f"{1e3 * start:g}", state, *cells])
    return [
        '<h2 id="table-2">Table II: first guesses from 0 to 4.772 kg</h2>',
        "<p>Heavy ball, 50 g, one lift. Masses in g at which each search ends.</p>",
        linked(
            "table-2",
            ["first guess (g)", "robot", *ways],
            lines,
            (0, 2, 3, 4),
            2,
        ),
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
        [
            f"{1e3 * start:g}",
            "-" if scheduled is None else f"{1e3 * scheduled:.1f}",
            f"{1e3 * end:.1f}",
        ]
        for start, scheduled, end in recording["paths"]
    ]
    ours = recording["ours"]
    said = "no value" if ours["value"] is None else f"{1e3 * ours['value']:.1f} g"
    return [
        '<h2 id="recording">The paper\'s own recording</h2>',
        "<p>The heavy ball of 50 g, as the authors published it: positions of the elbow, with the setting of their example. The "
        "schedule of its 15 iterations, and one that reaches the least error of the last frame.</p>",
        linked(
            "recording",
            ["first guess (g)", "the schedule stops at (g)", "least error at (g)"],
            lines,
            (0, 1, 2),
        ),
        f'<p id="recording-ours">The paper: {quoted.STARTS_END}. Ours: {said}, <strong>{escape(ours["verdict"].replace("_", " "))}'
        "</strong>: "
        f"{escape(ours['why'])}. One recording, so no spread.</p>",
    ]


def _sphere(found: Sequence[Rows]) -> list[str]:
    lines = []
    for way, (calibrated, state) in product(labels(found, "way"), STATES):
        rows = flat(found, way=way, calibrated=calibrated)
        if rows:
            lines.append([way, state, *identified(rows, 1e3)])
    truth = 1e3 * flat(found)[0]["truth"]
    return [
        '<h2 id="sphere">V-B: the sphere in the box</h2>',
        f"<p>A sphere of {truth:g} g is free in a closed box of 30 g. With one run the empty box was weighed; with three runs the "
        "empty box makes the same runs. The paper's way has the paper's law of contact and its last frame. The sphere "
        "begins where the box is lowest, as every way knows; where it may lie anywhere: <a href='#extensions'>below</a>.</p>",
        linked(
            "sphere",
            ["way", "robot", *IN_GRAMS],
            lines,
            (2, 3, 4),
            2,
        ),
        f"<p>The paper: {quoted.SPHERE_ERROR} off.</p>",
    ]


def _tracking(found: Sequence[Rows]) -> list[str]:
    words = {
        "joint": "the joint's encoder",
        "camera": "a camera that sees the sphere",
        "both": "both",
    }
    lines = [[name, *identified(flat(found, way=way), 1e3)] for way, name in words.items()]
    return [
        '<h2 id="tracking">V-F: with and without tracking the sphere</h2>',
        "<p>Calibrated robots, three runs and the empty box. The camera sees the sphere 30 times a second to 2 mm.</p>",
        linked("tracking", ["identified from", *IN_GRAMS], lines, (1, 2, 3)),
        f"<p>The paper's numbers: {quoted.MISSING}.</p>",
    ]


def _extensions(found: Sequence[Rows]) -> list[str]:
    titles = {
        "slide": "ball on a slide",
        "universal joint": "ball on a universal joint",
        "sphere": "sphere in the box",
    }
    lines = []
    for part, title in titles.items():
        for way in dict.fromkeys(row["way"] for row in flat(found, part=part)):
            rows = flat(found, part=part, way=way)
            lines.append([title, way, f"{1e3 * rows[0]['truth']:g}", *identified(rows, 1e3)])
    return [
        '<h2 id="extensions">What the paper names and does not show</h2>',
        "<p>Calibrated robots. A ball of 50 g hangs in the hand on a joint of its own: on a slide with a spring, along the hand, "
        "or 60 mm below two hinges; lift and lowering. Spring, damper and where it began are hidden; only the elbow is measured. "
        "The chain simulator identifies the mass together with them; &ldquo;explained&rdquo; says that its fit leaves no more than "
        "the encoder's noise; a spring known to 10 % is one whose frequency with the ball is. The sphere lies "
        "somewhere on the box's floor when the current comes on, elsewhere in each run.</p>",
        linked(
            "extensions",
            ["what", "way", "true (g)", *IN_GRAMS],
            lines,
            (2, 3, 4, 5),
            2,
        ),
        f"<p>{_fails(found)}</p>",
    ]


def _fails(found: Sequence[Rows]) -> str:
    """Where it fails, as far as these rows show it."""
    said = []
    for part, what in (("slide", "slides"), ("universal joint", "swings")):
        rigid = flat(found, part=part, way="as if it were rigid")
        wrong = [
            row
            for row in rigid
            if row["low"] is not None and not row["low"] <= row["truth"] <= row["high"]
        ]
        passed = sum(row["verdict"] == "accepted" for row in wrong)
        refused = sum(row["verdict"] in ("rejected", "not_identifiable") for row in rigid)
        said.append(
            f"A ball that {what} and is weighed as if it were rigid: of {len(rigid)} answers {refused} are refused, {passed} are "
            "accepted with an interval that misses the truth, since friction and torque take up the difference."
        )
    open_spring = flat(found, part="slide", way="on its slide, spring unknown")
    worst = max(1e3 * abs(row["value"] - row["truth"]) for row in open_spring)
    said.append(
        f"Where nothing is known of the spring (20 &plusmn; 8 rad/s) the error reaches {worst:.0f} g and {holds(open_spring)} "
        "intervals hold: a soft spring with a heavier ball moves the elbow almost alike. State the joint, and weigh its spring."
    )
    return " ".join(said)


def _cubes(found: Sequence[Rows]) -> list[str]:
    quantities = (
        ("youngs_modulus", "Young's modulus (kPa)", 1e-3),
        ("poissons_ratio", "Poisson's ratio", 1.0),
    )
    ways = {"paper": "the paper's", "ours": "ours"}
    lines = []
    for name, (quantity, words, scale), (calibrated, state), way in product(
        CUBES, quantities, STATES, ways
    ):
        rows = flat(found, object=name, quantity=quantity, calibrated=calibrated, way=way)
        if rows:
            truth = f"{scale * rows[0]['truth']:.3g}"
            lines.append(
                [
                    name,
                    words,
                    truth,
                    ways[way],
                    state,
                    *identified(rows, scale, 2),
                ]
            )
    header = [
        "cube",
        "of it",
        "true",
        "way",
        "robot",
        "identified",
        "rms error",
        "interval",
        "holds",
        "verdict",
    ]
    said = [[name, f"{mu:g}", f"{lam:g}"] for name, (mu, lam) in quoted.LAME.items()]
    return [
        '<h2 id="cubes">V-C: two soft cubes</h2>',
        "<p>Three squeezes each. The cubes have the moduli that the paper found; their edge, 30 mm, is ours. A virtual block "
        "answers by a law in closed form, and loses a little by damping. The paper's way is explicit elastodynamics of tetrahedra "
        "and the last frame of the last squeeze, from twice the modulus, between a tenth and ten times of that; ours takes all "
        "three. A dash: one that ours does not state, because the squeezes say hardly more of it than its prior.</p>",
        linked("cubes", header, lines, (2, 5, 6, 7), 5),
        table(["the paper found", "mu (Pa)", "lambda (Pa)"], said, (1, 2)),
        *_figure_5(found),
    ]


def _figure_5(found: Sequence[Rows]) -> list[str]:
    parts = []
    for name in CUBES:
        trace = next((rows["trace"][name] for rows in found if name in rows["trace"]), None)
        if trace is None:
            continue
        times = np.array(trace["times_s"])
        moduli = trace["moduli_Pa"]
        series = [
            Series(
                f"{words} {1e-3 * moduli[key]:.1f} kPa",
                times,
                np.array(trace["simulated_mm"][key]),
                color,
            )
            for key, words, color in (
                ("wrong", "wrong", "apart"),
                ("identified", "found", "agreeing"),
            )
        ]
        series.append(
            Series(
                "measured",
                times,
                np.array(trace["measured_mm"]),
                "measured",
                "dots",
            )
        )
        drawn = chart([Panel("finger (mm)", "mm", series, 170.0)], TIME, f"Squeeze of the {name}")
        caption = f"The {name}, last of three squeezes, the first seed; Poisson's ratio and the gap as they are."
        parts.append(framed(drawn, caption))
    return ['<h2 id="figure-5">Figure 5: the squeeze</h2>', *parts] if parts else []


def _speed(found: Sequence[Rows]) -> list[str]:
    lines = []
    for way in labels(found, "way"):
        rows = flat(found, way=way)
        known = rows[0]["value"] is not None
        took = over([row["seconds"] for row in rows], 1e3, 0) if known else rows[0]["why"]
        lines.append(
            [
                way,
                took,
                rms(rows, 1e3, 2),
                half(rows, 1e3) if known else "-",
            ]
        )
    return [
        '<h2 id="speed">Speed</h2>',
        "<p>One recording that comes with the package, a robot without friction in MuJoCo, 50 g at the elbow; five first guesses, "
        "one process, everything loaded and compiled. Unknown are the mass and how the joint began; in the paper's way the mass "
        "only. None but ours states an interval.</p>",
        linked(
            "speed",
            ["way", "time of a processor (ms)", "error (g)", "interval (g)"],
            lines,
            (1, 2, 3),
        ),
        f"<p>The paper: {quoted.TIME}.</p>",
    ]


SECTIONS: dict[str, Callable[[Sequence[Rows]], list[str]]] = {
    "objects": _objects,
    "starts": _starts,
    "sphere": _sphere,
    "tracking": _tracking,
    "cubes": _cubes,
    "extensions": _extensions,
    "optimisers": optimisers,
    "landscapes": landscapes,
    "effects": effects,
    "speed": _speed,
}
"""In the order of the page."""
