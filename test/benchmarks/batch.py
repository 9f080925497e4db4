"""`proprio batch` over ten thousand episodes of an arm in MuJoCo with known masses, on a Ray cluster of two workers.

    python test/benchmarks/batch.py make DIR [--episodes 10000]       # bags and a LeRobot v3 data set, a calibration, the truth
    python test/benchmarks/batch.py ray DIR                           # the whole job: workers killed twice, the driver once
    python test/benchmarks/batch.py throughput DIR                    # one worker against two
    python test/benchmarks/batch.py cost DIR                          # seconds of a processor against length
    python test/benchmarks/batch.py memory DIR                        # one bag of up to a million samples

Each part prints what the page "Many recordings" quotes. Only processes that it started are killed.
"""

from __future__ import annotations

import argparse
import csv
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from support.fleet import FOUR, SETTINGS, Arm, write_bag, write_robot
from support.lerobot_layout import write_data_set

from proprio_ros.addons.fleet.episodes import episodes_of
from proprio_ros.addons.fleet.rows import Job, rows_of
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options

SECONDS = 12.0
BAGS_SHARE = 0.1
BROKEN = 10
MASSES_KG = [0.005 * n for n in range(41)]
COMMAND = [sys.executable, "-m", "proprio_ros.cli", "batch"]


def options(folder: Path) -> list[str]:
    """Of the command line."""
    said = [f"{key}={json.dumps(value)}" for key, value in SETTINGS.items()]
    return [
        "--calibration",
        str(folder / "arm.yaml"),
        "--effort-unit",
        "N.m",
        "--driver",
        "lerobot_any.yaml",
        "--set",
        *said,
    ]


def asked(folder: Path) -> Options:
    """The same for `replay`."""
    return Options(
        calibration=folder / "arm.yaml",
        effort_unit="N.m",
        settings=SETTINGS,
        driver=folder / "lerobot_any.yaml",
    )


def make(
    folder: Path,
    count: int,
    jobs: int,
    seconds: float = SECONDS,
) -> None:
    """Generate everything, with so many processes, each a data set of its own."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "data" / "bags").mkdir(parents=True)
    # joint states of bags under their usual name, and a data set's columns: one profile reads both
    (folder / "lerobot_any.yaml").write_text(
        "title: rad and N m\neffort_unit: N.m\ncolumns: {position_unit: rad}\n"
    )
    _calibrate(folder)
    masses = [float(mass) for mass in np.random.default_rng(1).choice(MASSES_KG, count)]
    edges = [round(count * n / jobs) for n in range(jobs + 1)]
    shares = [
        (folder, f"set_{n}", first, masses[first:end], seconds)
        for n, (first, end) in enumerate(pairwise(edges))
    ]
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        truth = [row for rows in pool.map(make_share, *zip(*shares, strict=True)) for row in rows]
    bags = [Path(path) for path, _ in truth if "#" not in path]
    cut_short(bags[: max(2, BROKEN * count // 10_000)])
    with open(folder / "truth.csv", "w", newline="") as stream:
        csv.writer(stream).writerows([["path", "mass_kg"], *truth])
    others = count - len(bags)
    print(
        f"{count} episodes of {seconds:g} s: {len(bags)} bags, {others} in {jobs} LeRobot v3 data sets"
    )


def _calibrate(folder: Path) -> None:
    """Write the arm's robot file, three recordings of its empty hand, and the calibration by them."""
    arm = Arm(3)
    robot = write_robot(folder, build=FOUR)
    empty = [write_bag(folder / f"empty_{n}", arm.record(10**6 + n, 20.0)) for n in range(3)]
    plain = Options(robot=str(robot), effort_unit="N.m")
    calibrate_from_bags(empty, {}, plain, folder / "arm.yaml", lambda words: None)


def cut_short(bags: Sequence[Path]) -> None:
    """Leaves of each only the first 5,000 bytes."""
    for bag in bags:
        storage = next(bag.glob("*.mcap"))
        storage.write_bytes(storage.read_bytes()[:5000])


def make_share(
    folder: Path,
    name: str,
    first: int,
    masses: Sequence[float],
    seconds: float,
) -> list[tuple[str, float]]:
    """Some of the episodes: a tenth as bags, the rest as a data set; paths and masses."""
    arm = Arm(3)
    bags = round(BAGS_SHARE * len(masses))
    motions = (arm.record(first + n, seconds, mass) for n, mass in enumerate(masses))
    truth = []
    for n in range(bags):
        path = write_bag(folder / "data" / "bags" / f"{first + n:05d}", next(motions))
        truth.append((str(path.resolve()), masses[n]))
    place = write_data_set(
        folder / "data" / name,
        motions,
        FOUR.constants,
        rate_hz=50.0,
    )
    return truth + [(f"{place.resolve()}#{n}", mass) for n, mass in enumerate(masses[bags:])]


def rows_in(out: Path) -> Any:
    """All rows."""
    from pyarrow import dataset

    return dataset.dataset(out / "rows", partitioning="hive").to_table().to_pandas()


def compare(
    folder: Path,
    out: Path,
    replayed: int = 60,
) -> None:
    """All rows there, masses against the truth, and numbers against `replay` one by one."""
    rows = rows_in(out)
    with open(folder / "truth.csv") as stream:
        truth = {row["path"]: float(row["mass_kg"]) for row in csv.DictReader(stream)}
    joined = np.where(
        rows["episode_index"].notna(),
        "#",
        "/",
    )
    rows["path"] = rows["source"].astype(str) + joined + rows["episode"].astype(str)
    twice = int(rows.duplicated(["path", "segment"]).sum())
    print(
        f"{len(rows)} rows of {len(truth)} episodes, {twice} twice, {len(set(truth) - set(rows['path']))} lost"
    )
    print(rows["verdict"].value_counts().to_dict())
    good = rows[rows["verdict"] == "accepted"]
    error = good["value"] - good["path"].map(truth)
    held = (good["low"] <= good["path"].map(truth)) & (good["path"].map(truth) <= good["high"])
    print(
        f"rms error {1e3 * np.sqrt(np.mean(error**2)):.2f} g, the 95 % interval holds the mass in {100 * held.mean():.1f} %"
    )
    chosen = good.sample(
        min(replayed, len(good)),
        random_state=1,
    )
    other = 0
    for _, row in chosen.iterrows():
        value = replay(row["path"], asked(folder)).values[0]
        assert value.ci95 is not None
        other += (value.value, value.std, *value.ci95) != (
            row["value"],
            row["std"],
            row["low"],
            row["high"],
        )
    print(f"{len(chosen)} of them by `replay` one by one: {other} differ in any bit")


@contextmanager
def cluster(workers: int) -> Iterator[str]:
    """A Ray cluster on this machine with so many worker processes."""
    from ray.cluster_utils import Cluster

    # Ray makes its workers nicer than all else, by 15: beside other work they would not be served
    os.environ.update(RAY_USAGE_STATS_ENABLED="0", RAY_worker_niceness="0")
    nodes = Cluster(
        initialize_head=True, head_node_args={"num_cpus": workers, "include_dashboard": False}
    )
    try:
        yield str(nodes.address)
    finally:
        nodes.shutdown()


def batch(folder: Path, sources: list[str], out: Path, *more: str) -> subprocess.Popen[bytes]:
    """Start the command."""
    return subprocess.Popen(
        [
            *COMMAND,
            *sources,
            "--out",
            str(out),
            *options(folder),
            *more,
        ],
        cwd=folder,
    )


def descendants() -> dict[int, list[int]]:
    """Processes that this one started, and itself, each with the ticks of a processor that it and its ended children took."""
    stats: dict[int, list[int]] = {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            stats[int(place.name)] = [
                int(word) for word in (place / "stat").read_text().rpartition(")")[2].split()[1:16]
            ]
        except (OSError, ValueError):
            continue
    mine = {os.getpid()}
    grown = True
    while grown:
        more = {process for process, words in stats.items() if words[0] in mine} - mine
        mine |= more
        grown = bool(more)
    return {process: stats[process][10:14] for process in mine if process in stats}


def busy_workers() -> list[int]:
    """Processes of Ray that work on a batch, of those that this process started."""
    found = []
    for process in descendants():
        try:
            name = Path(f"/proc/{process}/cmdline").read_bytes()
        except OSError:
            continue
        if name.startswith(b"ray::") and b"IDLE" not in name and b"MapBatches" in name:
            found.append(process)
    return found


def spent_s() -> float:
    """Seconds of a processor that all of them took so far."""
    return sum(map(sum, descendants().values())) / os.sysconf("SC_CLK_TCK")


def count_done(out: Path) -> int:
    """Files of rows."""
    return len(list((out / "rows").glob("*/*.parquet")))


def run_ray(folder: Path) -> None:
    """The whole job with two workers: a worker is killed twice, then the driver, then it is resumed."""
    out = folder / "out_ray"
    shutil.rmtree(out, ignore_errors=True)
    with cluster(2) as address:
        begun = time.monotonic()
        job = batch(
            folder,
            [str(folder / "data")],
            out,
            "--engine",
            "ray",
            "--address",
            address,
        )
        with open(folder / "truth.csv") as stream:
            files = (sum(1 for _ in stream) - 1) / 64
        for at in (0.15 * files, 0.35 * files):
            while count_done(out) < at and job.poll() is None:
                time.sleep(0.2)
            victims = busy_workers()
            print(
                f"{time.monotonic() - begun:.0f} s, {count_done(out)} files: killing worker {victims[:1]}",
                flush=True,
            )
            for process in victims[:1]:
                os.kill(process, signal.SIGKILL)
        while count_done(out) < 0.6 * files and job.poll() is None:
            time.sleep(0.2)
        print(
            f"{time.monotonic() - begun:.0f} s, {count_done(out)} files: killing the driver",
            flush=True,
        )
        job.kill()
        job.wait()
        time.sleep(5.0)
        code = batch(
            folder, [str(folder / "data")], out, "--engine", "ray", "--address", address
        ).wait()
        print(f"resumed: exit code {code}, {time.monotonic() - begun:.0f} s in all")
    compare(folder, out)


def throughput(folder: Path, engine: str, source: str) -> None:
    """Episodes per second of one worker and of two, on the same episodes, and seconds of a processor for each.

    From the start of the command to its end, and between the first file of rows and the last: starting the command, Ray and the
    workers costs the same however long the job is.
    """
    count = len(episodes_of([folder / source]))
    rates: list[tuple[float, float]] = []
    for workers in (1, 2):
        out = folder / f"out_{workers}"
        shutil.rmtree(out, ignore_errors=True)
        with cluster(workers) if engine == "ray" else nullcontext("") as address:
            time.sleep(5.0)  # Ray starts workers ahead
            more = (
                ["--engine", "ray", "--address", address]
                if engine == "ray"
                else ["--jobs", str(workers)]
            )
            begun = time.time()
            before = spent_s()
            batch(folder, [str(folder / source)], out, *more).wait()
            wall_s = time.time() - begun
            used_s = spent_s() - before
        files = sorted(
            (file.stat().st_mtime, len(rows_of_file(file)))
            for file in (out / "rows").glob("*/*.parquet")
        )
        # what was there with the first file was done before it
        running_s = files[-1][0] - files[0][0]
        after = sum(size for _, size in files[1:])
        rates.append((count / wall_s, after / running_s))
        print(
            f"{workers} workers: {count} episodes in {wall_s:.1f} s, {rates[-1][0]:.1f} per second, {rates[-1][1]:.1f} between the "
            f"first file (after {files[0][0] - begun:.1f} s) and the last; "
            f"{1e3 * used_s / count:.1f} ms of a processor each",
            flush=True,
        )
    print(
        f"two workers: {rates[1][0] / rates[0][0]:.2f} times one, {rates[1][1] / rates[0][1]:.2f} times between the first file and "
        f"the last; load average {os.getloadavg()[0]:.1f}"
    )


def rows_of_file(file: Path) -> Any:
    """Names of the episodes in one file."""
    import pyarrow.parquet as pq

    return pq.ParquetFile(file).read(columns=["episode"])


def cost(folder: Path) -> None:
    """Seconds of a processor per episode against its length, by the function that the engines call; the middle of five."""
    print("| length, s | samples | bag, s | data set, s |")
    print("|---|---|---|---|")
    arm = Arm(3)
    job = Job(asked(folder))
    for seconds in (12.0, 30.0, 60.0, 120.0, 600.0):
        place = folder / "cost"
        shutil.rmtree(place, ignore_errors=True)
        motion = arm.record(5, seconds, 0.1)
        write_bag(place / "bag", motion)
        write_data_set(place / "set", [motion], FOUR.constants, rate_hz=50.0)
        spent = []
        for source in ("bag", "set"):
            (episode,) = episodes_of([place / source])
            times = []
            for _ in range(6):
                begun = time.process_time()
                (row,) = rows_of(episode, job)
                times.append(time.process_time() - begun)
                assert row["verdict"] == "accepted", row["reasons"]
            spent.append(float(np.median(times[1:])))
        print(
            f"| {seconds:g} | {len(motion.times_s)} | {spent[0]:.3f} | {spent[1]:.3f} |", flush=True
        )


def memory(
    folder: Path,
    sizes: Sequence[int] = (1_000, 10_000, 100_000, 1_000_000),
) -> None:
    """Largest memory of any process, and time, of `proprio batch` with one process on one bag, against its samples."""
    print("| samples | minutes at 50 Hz | rows | s of a processor | MB at most |")
    print("|---|---|---|---|---|")
    for samples in sizes:
        path = folder / f"long_{samples}"
        out = folder / f"out_long_{samples}"
        for old in (path, out):
            shutil.rmtree(old, ignore_errors=True)
        made = multiprocessing.get_context("spawn").Process(
            target=write_long,
            args=(path, samples),
        )
        made.start()
        made.join()
        job = batch(
            folder,
            [str(path)],
            out,
            "--jobs",
            "1",
        )
        _, status, used = os.wait4(job.pid, 0)  # of it and of all that it waited for
        job.returncode = os.waitstatus_to_exitcode(status)
        rows = rows_in(out)
        print(
            f"| {samples} | {samples / 3000:.0f} | {len(rows)}, {int((rows['verdict'] == 'accepted').sum())} accepted | "
            f"{used.ru_utime + used.ru_stime:.1f} | {used.ru_maxrss / 1024:.0f} |",
            flush=True,
        )
        for old in (path, out):
            shutil.rmtree(old)


def write_long(path: Path, samples: int) -> None:
    """One long bag with 100 g in the hand."""
    write_bag(
        path,
        Arm(3).record(7, samples / 50.0, 0.1),
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Do one part."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("make", "ray", "compare", "throughput", "cost", "memory"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--episodes", type=int)
    parser.add_argument("--samples", type=int, help="of the part memory: this many alone")
    parser.add_argument("--jobs", type=int, default=2, help="processes that make episodes")
    parser.add_argument(
        "--engine", default="ray", choices=("ray", "local"), help="of the part throughput"
    )
    parser.add_argument(
        "--source",
        default="data",
        help="of the part throughput: below the folder, such as data/set_0",
    )
    given = parser.parse_args(arguments)
    folder = given.folder.resolve()
    if given.part == "make":
        make(folder, given.episodes or 10_000, given.jobs)
    elif given.part == "ray":
        run_ray(folder)
    elif given.part == "compare":
        compare(folder, folder / "out_ray")
    elif given.part == "throughput":
        throughput(folder, given.engine, given.source)
    elif given.part == "cost":
        cost(folder)
    else:
        memory(
            folder,
            [given.samples] if given.samples else (1_000, 10_000, 100_000, 1_000_000),
        )


if __name__ == "__main__":
    main()
