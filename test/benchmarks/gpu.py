"""Ten thousand five-start fits of pushes in one launch, on a graphics card beside the same on the processor.

    python test/benchmarks/gpu.py pushes.npz --prepare          # here: reads bags/, with and without a calibration
    python test/benchmarks/gpu.py pushes.npz --json FILE        # where the card is: numpy, scipy, PyYAML, Warp and this repository

Each fit is a push of ``bags/`` with noise of its own, drawn from its samples' standard deviations. The processor has one thread per
core, each with its share of the fits. ``--device cpu`` goes through it all without a card.
"""

from __future__ import annotations

import os
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import warp as wp
from results import Results, parser_of

from proprio_ros.errors import ConfigurationError
from proprio_ros.sim import runtime
from proprio_ros.sim.descent import AffineFit, Descended, Descents, Rules
from proprio_ros.sim.joint import JointRun

if TYPE_CHECKING:
    from case import Case, Row

FITS = 10_000
GOAL_S = 2.0
EQUAL = 1e-9
REPEATS = 3
RULES = Rules(
    windows=(0.25, 0.5, 0.75, 1.0),
    window_iterations=3,
    iterations=30,
    tolerance=1e-4,
    persistent=True,
    idle_gain=1e-6,
    largest_curvature=1e100,
)
"""Those of a weighing's first fit."""
OF_RUNS = tuple(field.name for field in fields(JointRun))
OF_FITS = tuple(field.name for field in fields(AffineFit) if field.name != "runs")


# ------------------------------------------------------------------------------------------------------ The pushes, as numbers


def prepare(file: Path) -> int:
    """Keep the first fits of all pushes of ``bags/`` in a file; returns how many."""
    from calibrated import BAGS, empty_runs

    from proprio_ros.identification.fit import SearchOptions, first_problem
    from proprio_ros.identification.gates import Findings, admitted
    from proprio_ros.identification.prepared_runs import prepare_run
    from proprio_ros.identification.robot_calibration import calibrate
    from proprio_ros.identification.together import affine_fit
    from proprio_ros.identification.unknowns import Role
    from proprio_ros.pipeline.loading import bag_runs
    from proprio_ros.pipeline.request import DEFAULT_ROBOT, Request
    from proprio_ros.robot import load_robot
    from proprio_ros.sim.payload import PayloadFacts

    stated = load_robot(DEFAULT_ROBOT)
    calibration = calibrate(stated, empty_runs(stated)).calibration
    assert calibration is not None
    kept: dict[str, np.ndarray] = {}
    number = 0
    # the calibration is of the arm that made the realistic recordings
    for robot, arm in ((stated, "*"), (stated.with_calibration(calibration), "realistic_s00")):
        folders = [*BAGS.glob(f"{arm}_fixed_*/bag_*"), *BAGS.glob(f"{arm}_empty_??_*/bag_*")]
        for bag in sorted(folders):
            runs = [prepare_run(robot, run) for run in bag_runs(bag, Request(robot))]
            if not all(admitted(robot, run, Findings()) for run in runs):
                continue
            problem, starts = first_problem(
                robot, runs, PayloadFacts(), SearchOptions(), Role.FIXED
            )
            fit = affine_fit(problem, starts)
            for name in OF_FITS:
                kept[f"{number}/{name}"] = np.asarray(getattr(fit, name))
            (run,) = fit.runs
            for name in OF_RUNS:
                value = getattr(run, name)
                if value is not None:
                    kept[f"{number}/run/{name}"] = np.asarray(value)
            number += 1
    np.savez_compressed(file, allow_pickle=False, **kept)
    return number


def kept_in(file: Path) -> list[AffineFit]:
    """The fits of a file."""
    found = []
    with np.load(file) as kept:
        names = set(kept.files)
        while f"{len(found)}/starts" in names:
            own = f"{len(found)}/"
            run = {}
            for name in OF_RUNS:
                if f"{own}run/{name}" in names:
                    value = kept[f"{own}run/{name}"]
                    run[name] = value if value.ndim else float(value)
            run["supply"] = tuple(run["supply"].tolist())
            given = {name: kept[own + name] for name in OF_FITS}
            found.append(AffineFit(runs=(JointRun(**run),), **given))
    return found


def many(pushes: Sequence[AffineFit], count: int) -> list[AffineFit]:
    """So many fits, each a push with noise of its own."""
    rng = np.random.default_rng(1)
    found = []
    for number in range(count):
        push = pushes[number % len(pushes)]
        noise = rng.standard_normal(push.measured[0].shape) / push.weight[0]
        found.append(replace(push, measured=[push.measured[0] + noise]))
    return found


# ----------------------------------------------------------------------------------------------------------------- Measuring


def timed(
    fits: Sequence[AffineFit], device: str, repeats: int
) -> tuple[dict[str, float], list[Descended]]:
    """Seconds of the first call with what is compiled, of setting up, and of the fits; and what these found.

    Args:
        fits: All that are fitted in one launch.
        device: Where.
        repeats: How often the fits are timed.
    """
    began = time.perf_counter()
    Descents(fits[:1], RULES, device).run()
    first = time.perf_counter() - began
    began = time.perf_counter()
    descents = Descents(fits, RULES, device)
    wp.synchronize_device(device)
    set_up = time.perf_counter() - began
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        found = descents.run()
        times.append(time.perf_counter() - began)
    return {
        "first_s": first,
        "set_up_s": set_up,
        "fits_s": min(times),
        "fits_again_s": times,
    }, found


def on_all_cores(fits: Sequence[AffineFit]) -> tuple[float, list[Descended]]:
    """Seconds that all cores together take, and what they find."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    # small shares, so that no core waits long for another
    shares = [fits[start : start + 50] for start in range(0, len(fits), 50)]
    ready = [Descents(share, RULES, "cpu") for share in shares]
    began = time.perf_counter()
    with ThreadPoolExecutor(cores) as pool:
        found = list(pool.map(Descents.run, ready))
    return time.perf_counter() - began, [each for share in found for each in share]


def physical(fit: AffineFit, internal: np.ndarray) -> np.ndarray:
    """Unknowns of solver coordinates (..., F)."""
    curved = fit.scale > 0.0
    return np.where(curved, fit.scale * np.sinh(np.where(curved, internal, 0.0)), internal)


def apart(
    fits: Sequence[AffineFit], ours: Sequence[Descended], theirs: Sequence[Descended]
) -> dict[str, Any]:
    """How far what two devices found lies apart, start by start: relative to each number, or to its prior's standard deviation
    where that is larger; how many fits took another path; and how many never arrived and are left out."""
    unknowns = []
    best = []
    costs = []
    longest = RULES.window_iterations * (len(RULES.windows) - 1) + RULES.iterations
    endless = 0
    for fit, one, other in zip(fits, ours, theirs, strict=True):
        x = physical(fit, one.internal)
        y = physical(fit, other.internal)
        if max(one.iterations, other.iterations) == longest:
            endless += 1  # stopped on its way, where rounding leads
            continue
        precision = np.diag(fit.prior_precision)
        prior = np.where(
            precision > 0.0, 1.0 / np.sqrt(np.where(precision > 0.0, precision, 1.0)), 0.0
        )
        off = np.abs(x - y) / np.maximum(np.maximum(np.abs(x), prior), 1e-12)
        at = int(np.argmin(one.cost))
        unknowns.append(off.max())
        best.append(off[at].max())
        costs.append((np.abs(one.cost - other.cost) / np.maximum(one.cost, 1e-6))[at])
    paths = sum(one.iterations != other.iterations for one, other in zip(ours, theirs, strict=True))
    return {
        "best_start_unknowns": largest(best),
        "all_starts_unknowns": largest(unknowns),
        "best_start_cost": largest(costs),
        "fits_with_other_iterations": paths,
        "fits_left_out": endless,
    }


def largest(values: Sequence[float]) -> dict[str, float]:
    """Of differences: the largest, the median, and how many are over what counts as equal."""
    all_values = np.asarray(values)
    return {
        "largest": float(all_values.max()),
        "median": float(np.median(all_values)),
        "over_1e-9": int((all_values > EQUAL).sum()),
    }


def one_pass(fits: Sequence[AffineFit], device: str) -> dict[str, float]:
    """Largest relative difference of cost, slopes and curvatures at the starts: the law and its tangents alone, no descent."""
    ours = Descents(fits, RULES, "cpu").linearise()
    theirs = Descents(fits, RULES, device).linearise()
    found = {}
    for name, one, other in zip(("cost", "gradient", "matrix"), ours, theirs, strict=True):
        size = np.abs(one).reshape(len(one), -1).max(axis=1)
        off = np.abs(one - other).reshape(len(one), -1).max(axis=1)
        found[name] = float((off / np.maximum(size, 1e-12)).max())
    return found


def measured(file: Path, count: int, device: str, compared: int) -> dict[str, Any]:
    """Everything, as numbers.

    Args:
        file: What `prepare` kept.
        count: How many fits.
        device: A graphics card.
        compared: How many of them the processor fits, too.
    """
    pushes = kept_in(file)
    fits = many(pushes, count)
    times, theirs = timed(fits, device, REPEATS)
    alone, _ = timed(fits[: min(200, count)], "cpu", 1)
    cores_s, ours = on_all_cores(fits[:compared])
    return {
        "pushes": len(pushes),
        "fits": count,
        "starts": len(fits[0].starts),
        "unknowns": len(fits[0].lower),
        "device": wp.get_device(device).name,
        "warp": wp.__version__,
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "on_device": times,
        "one_core": {**alone, "fits": min(200, count)},
        "all_cores": {"fits_s": cores_s, "fits": compared},
        "first_pass": one_pass(fits[: min(1000, count)], device),
        "apart": apart(fits[:compared], ours, theirs[:compared]),
        "goal_met": times["fits_s"] <= GOAL_S,
    }


def rows(_: Case) -> list[Row]:
    """What a fit in one launch costs on one core, and the comparison where there is a card."""
    import case as cases

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "pushes.npz")
        prepare(file)
        fits = many(kept_in(file), 20 if cases.once else 500)
        one_launch = Descents(fits, RULES)
        alone = cases.measure(one_launch.run, repeats=3, warm_up=0)
        each = f"{1e3 * alone.median / len(fits):.1f} ms each"
        found = [cases.Row(f"{len(fits)} five-start fits in one launch, one core", alone, each)]
        what = f"{FITS} five-start fits in one launch, graphics card"
        try:
            device = runtime.device_named("cuda")
        except ConfigurationError:
            return [*found, cases.Row(what, note="skipped: no CUDA device")]
        there = measured(file, FITS, device, FITS)
    fits_s = there["on_device"]["fits_s"]
    timing = cases.Timing(statistics.median(there["on_device"]["fits_again_s"]), fits_s, REPEATS)
    note = f"{there['device']}; unknowns differ by {there['apart']['best_start_unknowns']['largest']:.0e}"
    ratio = f"{fits_s:.2f} s (goal <= {GOAL_S:g})"
    return [*found, cases.Row(what, timing, ratio, there["goal_met"], note)]


def keep(found: dict[str, Any], file: Path | None, arguments: Sequence[str] | None) -> None:
    """Print a table of what was measured, and keep it for the page of speed.

    Args:
        found: What `measured` returns.
        file: A JSON file; None: nowhere.
        arguments: Of the command line.
    """
    results = Results(__file__, file, arguments)
    columns = {
        "where": "{where}",
        "fits": "{fits}",
        "all fits": "{fits_s:.2f} s",
        "each": "{each_us:.0f} us",
        "set-up, once": "{set_up_s:.2f} s",
    }
    apart_by = found["apart"]["best_start_unknowns"]
    on_device = found["on_device"]
    one_core = found["one_core"]
    results.table("fits", columns)
    for where, fits, times in (
        (found["device"], found["fits"], on_device),
        (f"{found['cores']} cores", found["all_cores"]["fits"], found["all_cores"]),
        ("one core", one_core["fits"], one_core),
    ):
        fits_s = times["fits_s"]
        results.row(
            "fits",
            where=where,
            fits=fits,
            fits_s=fits_s,
            each_us=1e6 * fits_s / fits,
            set_up_s=times.get("set_up_s"),
        )
    results.table(
        "apart",
        {
            "fits on both": "{fits}",
            "first slopes differ by": "{slopes:.0e}",
            "unknowns, median": "{median:.0e}",
            "> 1e-9": "{over} fits",
            "not compared": "{left_out} fits",
        },
    )
    results.row(
        "apart",
        fits=found["all_cores"]["fits"],
        median=apart_by["median"],
        over=apart_by["over_1e-9"],
        largest=apart_by["largest"],
        left_out=found["apart"]["fits_left_out"],
        slopes=found["first_pass"]["gradient"],
    )
    results.keep()


def main(arguments: Sequence[str] | None = None) -> int:
    """Prepare, or measure and print."""
    parser = parser_of(__doc__)
    parser.add_argument("file", type=Path, help="of the pushes")
    parser.add_argument("--prepare", action="store_true", help="write it from bags/")
    parser.add_argument("--fits", type=int, default=FITS)
    parser.add_argument("--compared", type=int, help="fits that the processor does, too (all)")
    parser.add_argument("--device", default="cuda")
    options = parser.parse_args(arguments)
    if options.prepare:
        print(f"{prepare(options.file)} fits of pushes kept in {options.file}")
        return 0
    try:
        device = runtime.device_named(options.device)
    except ConfigurationError as error:
        raise SystemExit(str(error)) from error
    compared = min(options.compared or options.fits, options.fits)
    keep(measured(options.file, options.fits, device, compared), options.json, arguments)
    return 0


if __name__ == "__main__":
    sys.exit(main())
