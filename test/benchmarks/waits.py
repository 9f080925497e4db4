"""What a user waits for, in seconds of a processor, and the part of it that each stage takes.

Other programs do not count: times are those of the process that answers. Each stands beside what cannot be saved, measured in the
same run: SciPy's own import for a process, a plain copy of the file for reading, the fit alone for a batch. Stages are from one
more call of the same under a profiler, which slows Python and no kernel.
"""

from __future__ import annotations

import json
import math
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import case as cases
from case import BAG, REPOSITORY, Case, Row, Timing
from fresh_process import python
from support.arm_in_motion import SIX, Twin, write_robot
from support.recording_bag import write_recording

from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.recordings.motions import Motion
from proprio_ros.records import JointRecord, Recording

REPEATS = 3
LIQUID = REPOSITORY / "bags" / "contents_liquid_r35_h30_1mPas"
CONTENTS_GOAL_S = 2.0
REPLAY_GOAL_S = 0.4
MOTION_GOALS_S = {55.0: 1.0, 900.0: 10.0, 3600.0: 60.0}
HOUR_GOAL_MB = 400.0
BATCH_GOAL = 1.3
IMPORTS = "importlib._bootstrap>:_find_and_load"
READING = "pipeline/replay.py:read_for"
PROFILED = """
import cProfile, json, pstats, sys, time
from pathlib import Path
from proprio_ros.cli import main
place, *words = sys.argv[1:]
profile = cProfile.Profile(time.process_time)
profile.runcall(main, words)
found = {f"{file}:{name}": times[3] for (file, _, name), times in pstats.Stats(profile).stats.items()}
Path(place).write_text(json.dumps({**found, "all": max(found.values())}))
"""
# by a small process: what a large one starts counts that one's memory as its own
LAUNCHED = """
import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(process.pid, 0)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
process.returncode = os.waitstatus_to_exitcode(status)
sys.exit(process.returncode)
"""
# of one process that has done everything once
EPISODES = """
import json, sys, time
from pathlib import Path
from proprio_ros.addons.fleet.episodes import episodes_of
from proprio_ros.addons.fleet.rows import Job, rows_of
from proprio_ros.pipeline import replay as replaying
from proprio_ros.pipeline.request import Options, request_of
stages = {"reading": 0.0, "fit and verdict": 0.0}

def clocked(name, function):
    def call(*given, **named):
        began = time.process_time()
        try:
            return function(*given, **named)
        finally:
            stages[name] += time.process_time() - began
    return call

from proprio_ros.addons.fleet import rows
rows.read_for = clocked("reading", rows.read_for)
rows.identify = clocked("fit and verdict", rows.identify)
episodes = episodes_of(sys.argv[1:])
for episode in episodes:
    rows_of(episode, Job())
stages = dict.fromkeys(stages, 0.0)
began = time.process_time()
answers = [row for episode in episodes for row in rows_of(episode, Job())]
whole = time.process_time() - began
failed = sum(row["verdict"] == "failed" for row in answers)
print(json.dumps({"whole": whole, "episodes": len(episodes), "failed": failed, **stages}))
"""


@dataclass(frozen=True)
class Spent:
    """What a command took."""

    timing: Timing  # of a processor
    peak_MB: float


def spent(*arguments: str) -> tuple[float, float]:
    """What a fresh interpreter takes: seconds of a processor, and megabytes at most."""
    seconds, kilobytes = map(float, python("-c", LAUNCHED, sys.executable, *arguments).split())
    return seconds, 1.024e-3 * kilobytes


def in_turn(
    commands: Sequence[Sequence[str]],
    repeats: int = REPEATS,
) -> list[Spent]:
    """What some commands take that take turns.

    Args:
        commands: Of Python, each as its words.
        repeats: How often each.
    """
    repeats = 1 if cases.once else repeats
    turns = [[spent(*command) for command in commands] for _ in range(repeats)]
    found = []
    for each in zip(*turns, strict=True):
        seconds = [one[0] for one in each]
        peak_MB = max(one[1] for one in each)
        found.append(Spent(Timing(median(seconds), min(seconds), repeats), peak_MB))
    return found


def shares(
    words: Sequence[str],
    stages: Mapping[str, str],
) -> str:
    """The part of each stage, in words.

    Args:
        words: Of the command line.
        stages: Names by the function that is the stage, as ``file:function``.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "profile.json"
        python("-c", PROFILED, str(place), *words)
        found = json.loads(place.read_text())
    parts = []
    for function, name in stages.items():
        taken = sum(time for key, time in found.items() if key.endswith(function))
        parts.append(f"{name} {100.0 * taken / found['all']:.0f} %")
    return ", ".join(parts)


def goal_row(
    what: str,
    spent: Spent,
    goal_s: float,
    note: str,
    goal_MB: float = math.inf,
) -> Row:
    """A row whose fastest is to be within a goal.

    Args:
        what: Was timed.
        spent: On it.
        goal_s: Seconds of a processor.
        note: Stages.
        goal_MB: Of memory at most.
    """
    ratio = f"{spent.timing.fastest:.2f} s of a processor (goal <= {goal_s:g} s)"
    if math.isfinite(goal_MB):
        ratio += f", {spent.peak_MB:.0f} MB (goal <= {goal_MB:g} MB)"
    within = spent.timing.fastest <= goal_s and spent.peak_MB <= goal_MB
    return Row(what, spent.timing, ratio, within, note)


def _replay_rows() -> Iterator[Row]:
    words = ("replay", str(BAG), "--probe", "payload", "--json")
    ours, warp, scipy = in_turn(
        [
            ("-m", "proprio_ros.cli", *words),
            ("-c", "import gc; gc.disable(); import warp"),
            ("-c", "import gc; gc.disable(); import scipy.stats"),
        ],
        5,
    )
    stages = {
        READING: "reading",
        "pipeline/replay.py:identify": "weighing",
        IMPORTS: "imports, within these and before",
    }
    beside = f"{ours.timing.fastest / warp.timing.fastest:.2f} times the import of Warp"
    note = f"{beside}; {shares(words, stages)}"
    yield goal_row("proprio replay, fresh process, warm kernels", ours, REPLAY_GOAL_S, note)
    yield Row("  import warp, and numpy", warp.timing)
    yield Row("  import scipy.stats, which it does without", scipy.timing)


def _contents_rows(folder: Path) -> Iterator[Row]:
    truth = json.loads((LIQUID / "truth.json").read_text())["container"]
    file = folder / "arm.yaml"
    calibrate_from_bags(sorted(LIQUID.glob("empty_*")), {}, output=file)
    words = ["replay", *map(str, sorted(LIQUID.glob("run_*"))), "--probe", "contents", "--json"]
    words += [
        "--calibration",
        str(file),
        "--baseline",
        *map(str, sorted(LIQUID.glob("baseline_*"))),
    ]
    for key in ("radius", "height", "bottom"):
        words += ["--set", f"contents.{key}={json.dumps(truth[key])}"]
    bare = "import gc; gc.disable(); import warp, scipy.optimize, scipy.special"
    ours, imports = in_turn([("-m", "proprio_ros.cli", *words), ("-c", bare)])
    stages = {
        READING: "reading",
        "contents/identify.py:searched": "searches of five models",
        "contents/models.py:held": "locked joints",
        "sim/joint.py:__call__": "in kernels, of all these",
        IMPORTS: "imports, within these and before",
    }
    yield goal_row("contents, eight runs", ours, CONTENTS_GOAL_S, shares(words, stages))
    yield Row("  import of Warp and what it uses of SciPy", imports.timing)


def bag_of(
    folder: Path,
    motion: Motion,
    lasts_s: float,
) -> Path:
    """The beginning of a motion as a bag.

    Args:
        folder: In which it is made.
        motion: Of the arm `SIX`.
        lasts_s: How much of it.
    """
    rows = motion.times_s <= lasts_s
    times_ns = (1e9 * motion.times_s[rows]).astype("int64") + 1_760_000_000_000_000_000
    effort = motion.current_A[rows] * SIX.constants
    states = JointRecord(times_ns, motion.joints, motion.position[rows], effort=effort)
    place = folder / f"{motion.name}_{lasts_s:g}"
    write_recording(place, Recording(motion.name, states, None))
    return place


def _motion_rows(folder: Path) -> Iterator[Row]:
    arm = Twin(1, SIX)
    robot = write_robot(folder)
    longest_s = min(MOTION_GOALS_S) if cases.once else max(MOTION_GOALS_S)
    empty = bag_of(folder, arm.record("empty", 55.0), 55.0)
    loaded = arm.record("loaded", longest_s, (0.5, (0.0, 0.0, 0.05)))
    stages = {
        "recordings/signals.py:hear": "reading",
        "recordings/runs.py:cut_runs": "looking for pushes",
        "regression/time_axis.py:with_time_axes": "clock",
        "payload/moving.py:_weighing": "weighing",
        IMPORTS: "imports, within these and before",
    }
    for lasts_s, goal_s in MOTION_GOALS_S.items():
        if lasts_s > longest_s:
            continue
        bag = bag_of(folder, loaded, lasts_s)
        words = ["replay", str(bag), "--baseline", str(empty), "--robot", str(robot)]
        words += ["--effort-unit", "N.m", "--probe", "payload", "--json"]
        copying = f"import shutil; shutil.copytree({str(bag)!r}, {str(folder / 'copy')!r}, dirs_exist_ok=True)"
        repeats = REPEATS if goal_s < 2.0 else 1
        ours, copied = in_turn([("-m", "proprio_ros.cli", *words), ("-c", copying)], repeats)
        what = f"a motion of {lasts_s:g} s, six joints"
        goal_MB = HOUR_GOAL_MB if lasts_s == max(MOTION_GOALS_S) else math.inf
        yield goal_row(what, ours, goal_s, shares(words, stages), goal_MB)
        yield Row("  a plain copy of the bag, by Python", copied.timing)


def _batch_rows() -> Iterator[Row]:
    bags = REPOSITORY / "bags"
    pushes = sorted(map(str, bags.glob("*_fixed_*/bag_*")))
    turns = [
        json.loads(python("-c", EPISODES, *pushes)) for _ in range(1 if cases.once else REPEATS)
    ]
    each = [turn["whole"] / turn["episodes"] for turn in turns]
    best = min(turns, key=lambda turn: turn["whole"])
    ratio = best["whole"] / best["fit and verdict"]
    parts = [
        f"{name} {100.0 * best[name] / best['whole']:.0f} %"
        for name in ("reading", "fit and verdict")
    ]
    yield Row(
        "batch, an episode of a push, one core",
        Timing(median(each), min(each), len(each)),
        f"{ratio:.2f} of fit and verdict (goal <= {BATCH_GOAL:g})",
        ratio <= BATCH_GOAL,
        f"{', '.join(parts)}, of {best['episodes']} pushes; {best['failed']} failed",
    )


def _first_row(folder: Path) -> Row:
    """Kernels of a weighing, none of them compiled before."""
    cache = folder / "kernels"
    script = (
        "import os, sys; os.environ['WARP_CACHE_PATH'] = sys.argv[1]; from proprio_ros.cli import main; "
        "main(['warmup', '--probe', 'payload'])"
    )
    shutil.rmtree(cache, ignore_errors=True)
    used, _ = spent("-c", script, str(cache))
    again, _ = spent("-c", script, str(cache))
    count = len(list(cache.rglob("*.o")))
    return Row(
        "first start: kernels of a weighing compiled",
        Timing(used, used, 1),
        note=f"{count} kernels; {again:.2f} s of a processor once they are there",
    )


def rows(case: Case) -> Iterator[Row]:
    """All of them; the benchmark's own recording is that of the first."""
    yield from _replay_rows()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        yield from _contents_rows(folder)
        yield from _motion_rows(folder)
        yield from _batch_rows()
        yield _first_row(folder)
