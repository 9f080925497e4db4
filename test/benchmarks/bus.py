"""How fast the driver's loop runs, and how punctually: ``python test/benchmarks/run.py bus``, or this file alone.

Five emulated servos at 1 Mb/s, whose bytes take their time on the wire, run in a process of their own, as real ones do. Two
processes on two cores; other work at the same time shows up as lateness.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from case import REPOSITORY, Case, Row, Timing

from proprio_ros.bus.driver import ArmDriver, DriverSettings
from proprio_ros.bus.dynamixel import DynamixelBus, servos_of
from proprio_ros.bus.state import BusState
from proprio_ros.clock import Pacer, run_in_real_time
from proprio_ros.robot import load_robot

GOAL_HZ = 150.0
LATE_S = 0.005
GOAL_LATE = 0.001  # of the cycles
DURATION_S = 60.0
WORLD = """
import sys
from pathlib import Path
from proprio_ros.clock import run_in_real_time
from proprio_ros.robot import load_robot
from proprio_ros.virtual.robot import VirtualRobot
from proprio_ros.virtual.truth import Truth
robot = load_robot("open_manipulator_x")
virtual = VirtualRobot(robot, Truth.draw(robot, 1), link=Path(sys.argv[1]))
run_in_real_time()  # servos do not wait for other programs
print("ready", flush=True)
sys.stdin.read()
virtual.close()
"""


def connected(port: Path, fast: bool) -> ArmDriver:
    """A driver that holds the arm.

    Raises:
        SystemExit: It cannot.
    """
    robot = load_robot("open_manipulator_x")
    driver = ArmDriver(
        robot,
        DynamixelBus(
            str(port),
            servos_of(robot),
            fast_sync_read=fast,
        ),
        DriverSettings(),
    )
    driver.cycle()
    if driver.state is not BusState.RUNNING or driver.bus.fast is not fast:
        raise SystemExit(f"the driver does not run: {driver.reason}")
    return driver


def free_running(
    port: Path,
    fast: bool,
    cycles: int = 1000,
) -> Row:
    """Cycles without a pause: read all, write all goals, and now and then a temperature."""
    driver = connected(port, fast)
    times = []
    for _ in range(cycles):
        started = time.perf_counter()
        driver.cycle()
        times.append(time.perf_counter() - started)
    driver.close()
    rate = cycles / sum(times)
    statistics = driver.statistics
    return Row(
        f"driver cycle, {'fast sync read' if fast else 'sync read'} and sync write of five servos, 1 Mb/s",
        Timing(
            float(np.median(times)),
            min(times),
            cycles,
        ),
        f"{rate:.0f} Hz (goal >= {GOAL_HZ:g} Hz)",
        rate >= GOAL_HZ,
        f"99.9 %: {1e3 * float(np.quantile(times, 0.999)):.1f} ms; {statistics.incomplete} incomplete, "
        f"{statistics.untimely} untimely",
    )


def paced(port: Path, rate_Hz: float, duration_s: float) -> Row:
    """Cycles at a fixed rate: how late they begin."""
    driver = connected(port, True)
    pacer = Pacer(1.0 / rate_Hz)
    spent = []
    intact = 0
    for _ in range(round(duration_s * rate_Hz)):
        pacer.wait()
        started = time.perf_counter()
        intact += driver.cycle() is not None
        spent.append(time.perf_counter() - started)
    driver.close()
    late = np.array(pacer.lateness_s)
    share = float(np.mean(late > LATE_S))
    return Row(
        f"driver loop at {rate_Hz:g} Hz for {duration_s:g} s",
        Timing(
            float(np.median(spent)),
            min(spent),
            len(spent),
        ),
        f"{100 * share:.2f} % late (goal <= {100 * GOAL_LATE:g} %)",
        share <= GOAL_LATE,
        f"late by more than {1e3 * LATE_S:g} ms; median {1e3 * float(np.median(late)):.2f}, 99.9 % "
        f"{1e3 * float(np.quantile(late, 0.999)):.2f}, worst {1e3 * float(late.max()):.1f} ms; {intact} of {len(spent)} samples",
    )


def rows(
    case: Case | None = None,
    duration_s: float = DURATION_S,
) -> list[Row]:
    """All of it, about two minutes; nothing here needs the recording."""
    with tempfile.TemporaryDirectory() as folder:
        port = Path(folder) / "arm"
        world = subprocess.Popen(
            [sys.executable, "-c", WORLD, str(port)],
            cwd=REPOSITORY,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert world.stdin is not None and world.stdout is not None
        try:
            if world.stdout.readline() != "ready\n":
                raise SystemExit("the virtual robot did not start")
            # in a thread of its own, as real-time scheduling belongs to a thread: what runs afterwards must not have it
            with ThreadPoolExecutor(1) as loop:
                granted = loop.submit(run_in_real_time).result()
                found = [loop.submit(free_running, port, fast).result() for fast in (False, True)]
                found += [
                    loop.submit(paced, port, rate_Hz, duration_s).result()
                    for rate_Hz in (40.0, 100.0)
                ]
        finally:
            world.stdin.close()
            world.wait(timeout=10)
    return [*found, Row(f"real-time scheduling: {'granted' if granted else 'not granted'}")]


if __name__ == "__main__":
    for row in rows(duration_s=float(sys.argv[1]) if len(sys.argv) > 1 else DURATION_S):
        median = f"{1e3 * row.timing.median:.2f} ms" if row.timing else ""
        print(f"{row.what:<76} {median:>9}  {row.ratio:<30} {row.note}".rstrip(), flush=True)
