"""The pictures of a result's page: each run with its current and the arm, the search, the misfit, and sources of uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from proprio_ros.identification.estimate import Estimate, RecordedRun, RunFit, StartPath
from proprio_ros.identification.fit import source_label
from proprio_ros.quantity import Z95, shown, shown_unit, spec_for
from proprio_ros.records import TORQUE_OFF
from proprio_ros.report.chart import Axis, Panel, Series, chart
from proprio_ros.report.figures import TIME
from proprio_ros.report.html import bars, percent

SHOWN_SOURCES = 8
HIGHEST_CHI2 = 15.0  # of a profile that is shown: the 95 % interval ends at 3.8


def run_figure(fit: RunFit | None, recorded: RecordedRun | None, number: int) -> str:
    """Position, current, and where there is a fit its residual, below each other over time.

    Args:
        fit: Of the run, where there is one.
        recorded: The run, where it is known.
        number: Of the run on the page.
    """
    unit = "rad" if recorded is None or fit is not None else recorded.unit
    if fit is None:
        assert recorded is not None
        traces = [Series("recorded", recorded.times_s, recorded.position, "measured", "dots")]
    else:
        times = fit.left_out_times_s
        places = fit.left_out
        if recorded is not None and recorded.unit == unit:
            early = recorded.times_s < 0.0
            times = np.append(recorded.times_s[early], times)
            places = np.append(recorded.position[early], places)
        traces = [
            Series("not fitted", times, places, "left-out", "dots", bool(len(times))),
            Series("measured", fit.times_s, fit.measured, "measured", "dots"),
            Series("simulated", fit.times_s, fit.simulated, "simulated"),
        ]
    panels = [Panel(f"position ({unit})", unit, traces, 170.0)]
    free = TORQUE_OFF in (
        fit.source if fit is not None else "",
        recorded.source if recorded is not None else "",
    )
    if recorded is not None and not free:
        panels.append(
            Panel(
                "input current (A)",
                "A",
                [_current(recorded)],
                70.0,
                rules=[0.0],
            )
        )
    if fit is not None:
        residual = 1e3 * (fit.simulated - fit.measured)
        sigma = 2e3 * fit.sigma
        off = Series("simulated less measured", fit.times_s, residual, "simulated", listed=False)
        title = "residual (mrad); band: two standard deviations"
        panels.append(
            Panel(
                title,
                "mrad",
                [off],
                90.0,
                (fit.times_s, -sigma, sigma),
                rules=[0.0],
            )
        )
    fitted = "measured and simulated position, input current and residual"
    alone = "recorded position and input current"
    return chart(
        panels, Axis(TIME[free], "s"), f"Run {number}: {fitted if fit else alone} over time"
    )


def _current(run: RecordedRun) -> Series:
    """From before it came on until after it went off."""
    inside = run.input_times_s < run.duration_s
    times = np.array([run.times_s.min(initial=0.0), *run.input_times_s[inside], run.duration_s])
    current = np.array([0.0, *run.input_current_A[inside], 0.0])
    return Series("current", times, current, "current", "steps", False)


def arm_figure(run: RecordedRun, number: int) -> str:
    """The arm from the side at the start (dotted) and at the end of a run."""
    picture = ArmPicture.around(run.arm.reshape(-1, 2))
    picture.ground()
    for links, joint, style in zip(run.arm, run.driven, ("start", "end"), strict=True):
        picture.links(links, style, joint)
    return picture.svg(f"Run {number}: the arm from the side at the start and at the end")


@dataclass
class ArmPicture:
    """An arm in a plane, to scale."""

    # low, high: corners of what is shown [m], shape (2,)
    low: np.ndarray
    high: np.ndarray
    scale: float  # units of the picture per metre
    body: list[str] = field(default_factory=list)  # what is drawn
    WIDTH = 300.0
    MARGIN = 18.0
    BELOW = 44.0

    @classmethod
    def around(cls, points: np.ndarray, closer: bool = False) -> ArmPicture:
        """With room for some points, shape (N, 2), and unless it is from ``closer`` for the base; 3 cm at least, for a scale."""
        low = points.min(axis=0)
        high = points.max(axis=0)
        if not closer:
            low = np.minimum(low, 0.0)
            high = np.maximum(high, 0.0)
        return cls(
            low,
            high,
            (cls.WIDTH - 2.0 * cls.MARGIN) / max(float((high - low).max()), 0.03),
        )

    def ground(self) -> None:
        """The floor, at the height of the base."""
        floor = self.MARGIN + self.scale * self.high[1]
        self.body.append(
            f'<path class="ground" d="M{self.MARGIN / 2:.1f},{floor:.1f}H{self.WIDTH - self.MARGIN / 2:.1f}"/>'
        )

    def place(self, point: np.ndarray) -> str:
        """Of a point [m]."""
        left = self.MARGIN + 0.5 * (
            self.WIDTH - 2.0 * self.MARGIN - self.scale * float((self.high - self.low)[0])
        )
        across = self.scale * (point[0] - self.low[0])
        down = self.scale * (self.high[1] - point[1])
        return f"{left + across:.1f},{self.MARGIN + down:.1f}"

    def links(
        self,
        links: np.ndarray,
        style: str,
        joint: np.ndarray | None = None,
    ) -> None:
        """Lines from joint to joint, and a ring about one joint.

        Args:
            links: Both ends of each, (L, 2, 2).
            style: Class of the style sheet.
            joint: About which a ring is drawn.
        """
        lines = dict.fromkeys(
            f"M{a}L{b}"
            for a, b in ((self.place(link[0]), self.place(link[1])) for link in links)
            if a != b
        )
        self.body.append(f'<path class="{style}" d="{"".join(lines)}"/>')
        if joint is not None:
            x, y = self.place(joint).split(",")
            self.body.append(f'<circle class="{style}" cx="{x}" cy="{y}" r="5"/>')

    def outline(self, points: np.ndarray, style: str) -> None:
        """A closed curve, shape (K, 2)."""
        self.body.append(
            f'<path class="{style}" d="M{"L".join(self.place(point) for point in points)}Z"/>'
        )

    def cross(self, point: np.ndarray) -> None:
        """A mark."""
        x, y = map(float, self.place(point).split(","))
        self.body.append(
            f'<path class="cross" d="M{x - 5:.1f},{y:.1f}h10M{x:.1f},{y - 5:.1f}v10"/>'
        )

    def svg(self, name: str) -> str:
        """With a bar for its scale; ``name`` is for those who cannot see it."""
        height = self.scale * float((self.high - self.low)[1]) + 2.0 * self.MARGIN + self.BELOW
        length = next(
            bar
            for bar in (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.0)
            if self.scale * bar < 0.35 * self.WIDTH
        )
        bottom = height - 12.0
        bar = self.scale * length
        ruler = (
            f'<path class="ground" style="stroke:var(--ink)" d="M{self.MARGIN:.1f},{bottom:.1f}h{bar:.1f}"/>'
            f'<text x="{self.MARGIN + bar + 8.0:.1f}" y="{bottom + 4.0:.1f}">{100.0 * length:g} cm</text>'
        )
        return (
            f'<svg class="arm" role="img" aria-label="{name}" viewBox="0 0 {self.WIDTH:g} {height:.0f}">'
            f"{''.join(self.body)}{ruler}</svg>"
        )


def convergence_figure(estimate: Estimate) -> str:
    """What every start came to over the iterations; where another fit gave the answer, that one, too."""
    factor, unit = shown_unit(estimate.values[0].unit)
    solver = estimate.solver
    assert solver is not None

    def curve(
        path: StartPath,
        begin: int,
        name: str,
        color: str,
        listed: bool,
    ) -> Series:
        """What one start came to over the iterations, in the unit that is shown.

        Args:
            path: Of the start [kg or Pa].
            begin: Iteration at which it starts.
            name: Of the curve.
            color: What it stands for: ``agreeing``, ``apart`` or ``answer``.
            listed: Whether the legend has it.

        Returns:
            The curve.
        """
        values = factor * np.maximum(path.values, 1e-6)
        return Series(
            name,
            begin + np.arange(len(values)),
            values,
            color,
            listed=listed,
        )

    first = [path.agrees for path in solver.paths].index(True) if solver.starts_agreeing else -1
    series = [
        curve(
            path,
            0,
            f"start at {factor * path.start:.3g} {unit}",
            "agreeing" if path.agrees else "apart",
            False,
        )
        for path in solver.paths
    ]
    if first >= 0 and solver.refined:
        one = series[first]
        series[first] = Series(
            "robot as stated",
            one.x,
            one.y,
            one.color,
        )
    begin = max(len(path.values) for path in solver.paths) - 1
    series += [
        curve(path, begin, "all open", "answer", n == 0) for n, path in enumerate(solver.refined)
    ]
    verticals = [begin] if solver.refined else []
    stops = [path.scheduled for path in solver.paths if path.scheduled is not None]
    if stops:
        at = np.full(
            len(stops),
            solver.iterations,
        )
        values = factor * np.array(stops)
        series.append(Series("where the schedule stops", at, values, "answer", "dots"))
        verticals = [solver.iterations]
    answer = estimate.values[0].value
    name = estimate.values[0].label
    rules = [factor * answer] if isinstance(answer, float) and answer > 0.0 else []
    panel = Panel(
        f"{name} ({unit})", unit, series, 210.0, rules=rules, verticals=verticals, log=True
    )
    return chart(
        [panel], Axis("iteration", "iterations", whole=True), f"Iterations of the search: {name}"
    )


def scan_figure(estimate: Estimate) -> str:
    """The cost over what was searched for, with the value and its interval."""
    factor, unit = shown_unit(estimate.values[0].unit)
    scan = estimate.scan
    value = estimate.values[0]
    assert scan is not None
    x = factor * scan.values
    log = scan.level is None  # the paper's loss spans orders of magnitude
    spans = []
    verticals = []
    if isinstance(value.value, float):
        verticals = [factor * value.value]
        if value.ci95 is not None:
            spans = [
                (
                    factor * max(value.ci95[0], scan.values[0]),
                    factor * min(value.ci95[1], scan.values[-1]),
                )
            ]
    cost = np.maximum(scan.cost, 1e-4) if log else scan.cost
    series = [Series(scan.measure, x, cost, "measured", listed=False)]
    rules = [] if scan.level is None else [scan.level]
    highest = np.inf if scan.level is None else HIGHEST_CHI2
    panel = Panel(
        scan.measure,
        "",
        series,
        190.0,
        None,
        spans,
        rules,
        verticals,
        log,
        highest,
    )
    axis = Axis(f"{value.label} ({unit})", unit, log=log)
    return chart([panel], axis, f"Misfit of the simulation over the {value.label}")


def budget_figure(estimate: Estimate) -> str:
    """Where the uncertainty of the answer comes from, as bars; what adds nothing is left out."""
    unit = estimate.values[0].unit
    most = max((std for _, std in estimate.budget), default=0.0)
    budget = [(source, std) for source, std in estimate.budget if std > 1e-3 * most]
    first = SHOWN_SOURCES + (len(budget) == SHOWN_SOURCES + 1)  # one alone is shown by its name
    sources = [(source_label(source), std) for source, std in budget[:first]]
    rest = budget[first:]
    if rest:
        variance = sum(std**2 for _, std in rest)
        sources.append((f"{len(rest)} others", float(np.sqrt(variance))))
    whole = sum(std**2 for _, std in sources) or 1.0
    return bars([
        (label, std, f"{shown(unit, std, spec=spec_for(unit, std / Z95))}, {percent(std**2 / whole)}") for label, std in sources
    ])  # fmt: skip


def paired(estimate: Estimate) -> Sequence[tuple[RunFit | None, RecordedRun | None]]:
    """Every recorded run with its fit, None where no fit could use it; fits come in the order of their runs."""
    fits = list(estimate.run_fits)
    pairs = []
    for run in estimate.recorded:
        used = bool(fits) and (fits[0].name, fits[0].joint) == (run.name, run.joint)
        if used:  # bags in folders of one name are of one name
            fitted = np.append(fits[0].times_s, fits[0].left_out_times_s)
            used = np.array_equal(run.times_s[run.times_s >= 0.0], fitted)
        pairs.append((fits.pop(0) if used else None, run))
    return [*pairs, *((fit, None) for fit in fits)]
