"""Whether a longer recording ends worse than a shorter one: answers, widths, processor time and memory, from a minute to an hour.

    python test/benchmarks/longer.py    # the table of the docs; half an hour, most of it in the simulator

The UR10e of `../shared/recordings_real`, loaded and empty, is played several times over, with stamps as a recorder gives them that
was paused for a second while the arm went back. Simulated arms (`support/arm_in_motion`) move along random sines for as long as the
longest of ``--minutes``, loaded and empty; the shorter recordings are its beginnings. Each question is a `proprio replay` of
its own, with a baseline as long as the recording; seconds are the processor's, memory is the largest that the process held.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from real import UR10E_KG, ur10e_file
from results import REPOSITORY, Results, parser_of
from rosbags.highlevel import AnyReader
from support.arm_in_motion import SIX, Twin, write_robot
from support.copied_bag import TYPES, copying
from support.machines import REAL
from support.recording_bag import write_recording

from proprio_ros.recordings.motions import Motion
from proprio_ros.records import JointRecord, Recording

LOADED, EMPTY = "ur10e_loaded_14", "ur10e_empty_14"
PAUSE_S = 1.0


@dataclass(frozen=True)
class Question:
    """What is asked of one recording and its baseline."""

    arm: str
    truth_kg: float
    loaded: Path
    empty: Path
    robot: Path
    unit: str


def repeated(
    bag: Path,
    folder: Path,
    times: int,
) -> Path:
    """A bag of joint states and commands several times over, header stamps included."""
    with copying(bag, folder) as (reader, write):
        period_ns = reader.duration + int(1e9 * PAUSE_S)
        messages = [
            (connection, time_ns, TYPES.deserialize_cdr(raw, connection.msgtype))
            for connection, time_ns, raw in reader.messages()
        ]
        for number in range(times):
            for connection, time_ns, message in messages:
                if number and hasattr(message, "header"):
                    stamp = message.header.stamp
                    later_ns = stamp.sec * 1_000_000_000 + stamp.nanosec + period_ns
                    stamp.sec, stamp.nanosec = divmod(later_ns, 1_000_000_000)
                raw = bytes(TYPES.serialize_cdr(message, connection.msgtype))
                write(connection, time_ns + number * period_ns, raw)
    return folder


def of_ur10e(folder: Path, times: Sequence[int]) -> Iterator[Question]:
    """The real pair, so many times over."""
    if not REAL.is_dir():
        return
    robot = ur10e_file(REAL, folder)
    for count in times:
        loaded, empty = (
            repeated(REAL / name, folder / f"{name}_{count}", count) for name in (LOADED, EMPTY)
        )
        yield Question("UR10e, played again and again", UR10E_KG, loaded, empty, robot, "A")


def of_simulated(
    folder: Path,
    seed: int,
    minutes: Sequence[float],
) -> Iterator[Question]:
    """The beginnings of one long motion, so many minutes each."""
    arm = Twin(seed, SIX)
    robot = write_robot(folder)
    held = arm.payload(np.random.default_rng(10_000 + seed))
    longest_s = 60.0 * max(minutes)
    empty = arm.record("empty", longest_s)
    loaded = arm.record("loaded", longest_s, held)
    for lasts in minutes:
        bags = [
            written(folder / f"{motion.name}_{seed}_{lasts:g}", motion, 60.0 * lasts)
            for motion in (loaded, empty)
        ]
        yield Question(f"simulated, number {seed}", held[0], *bags, robot, "N.m")


def written(
    folder: Path,
    motion: Motion,
    lasts_s: float,
) -> Path:
    """The beginning of a motion as a bag."""
    rows = motion.times_s <= lasts_s
    times_ns = (1e9 * motion.times_s[rows]).astype(np.int64) + 1_760_000_000_000_000_000
    effort = motion.current_A[rows] * np.array(SIX.constants)
    states = JointRecord(times_ns, motion.joints, motion.position[rows], effort=effort)
    write_recording(folder, Recording(motion.name, states, None))
    return folder


def answered(question: Question) -> dict[str, Any]:
    """What a process of its own says, and what it took."""
    words = ["replay", str(question.loaded), "--baseline", str(question.empty), "--json"]
    words += ["--robot", str(question.robot), "--effort-unit", question.unit]
    environment = {
        **os.environ,
        "PYTHONPATH": str(REPOSITORY),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "proprio_ros.cli", *words, "--probe", "payload"],
            stdout=out,
            env=environment,
        )
        _, _, used = os.wait4(process.pid, 0)
        out.seek(0)
        answer = json.loads(out.read())
    (mass,) = (each for each in answer["estimates"] if each["name"] == "payload_mass")
    low, high = mass["ci95"] or (None, None)
    told = low is not None
    return {
        "truth": 1e3 * question.truth_kg,
        "verdict": answer["verdict"],
        "value": 1e3 * mass["value"] if told else None,
        "low": 1e3 * low if told else None,
        "high": 1e3 * high if told else None,
        "held": "yes" if told and low <= question.truth_kg <= high else "no",
        "seconds": used.ru_utime + used.ru_stime,
        "memory_MB": used.ru_maxrss / 1024.0,
    }


def minutes_of(bag: Path) -> float:
    """How long it lasts."""
    with AnyReader([bag], default_typestore=TYPES) as reader:
        return float(reader.duration) / 60e9


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each recording, the shortest of each arm first."""
    parser = parser_of(__doc__)
    parser.add_argument("--arms", type=int, default=3, help="simulated")
    parser.add_argument("--first", type=int, default=7001, help="seed of the first arm")
    parser.add_argument("--minutes", type=float, nargs="+", default=[1.0, 10.0, 60.0])
    parser.add_argument("--times", type=int, nargs="*", default=[1, 4, 16, 64])
    options = parser.parse_args(arguments)
    results = Results(__file__, options.json, arguments)
    results.table(
        "longer",
        {
            "arm": "{arm}",
            "minutes": "{minutes:.3g}",
            "holds, g": "{truth:.0f}",
            "answer, g": "{value:.0f} ({low:.0f} to {high:.0f})",
            "verdict": "{verdict}",
            "interval holds": "{held}",
            "width over that of the shorter one": "{over:.2f}",
            "processor, s": "{seconds:.1f}",
            "memory, MB": "{memory_MB:.0f}",
        },
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        questions = [of_ur10e(folder, options.times)]
        for seed in range(options.first, options.first + options.arms):
            questions.append(of_simulated(folder, seed, options.minutes))
        for of_one_arm in questions:
            shorter: float | None = None
            for question in of_one_arm:
                found = answered(question)
                width = None if found["low"] is None else found["high"] - found["low"]
                results.row(
                    "longer",
                    arm=question.arm,
                    minutes=minutes_of(question.loaded),
                    over=width / shorter if width and shorter else None,
                    **found,
                )
                shorter = width
    results.keep()


if __name__ == "__main__":
    main()
