"""How old is what the running estimate says, beside programs that keep every core busy?

    python test/benchmarks/old_news.py [--load 15] [--rate 500] [--minutes 10] [--seed 401] [--ordinary]

Processes of their own, over DDS: an arm with torque sensing (`support/sensing_arm.py`, seven joints) that works and picks something
up and puts it down every eight seconds; the identifier with `running:=true`; so many programs that never wait; and whoever
listens. Arm and listener run in real time, as a robot's controller does, so that what is late is the identifier. With
`--ordinary` nobody grants it real time.

How old something is counts from the stamp of the joint state that it rests on until it is heard, and until the next message comes:
what was said last stands so long. A change counts as seen in step where all that was said until then was less than a second old;
how late it is seen counts while the arm moves.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from foreign_load import busy
from idle import cpu_s
from results import Results, parser_of
from running import moving_s
from support.domains import free_domain
from support.sensing_arm import SensingArm, write_sensing_arm

from proprio_ros.identification.regression.motion_fit import fit_empty
from proprio_ros.live.news import WARNED_S, WITHDRAWN_S
from proprio_ros.pipeline.calibrate import write_calibration
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import load_robot

MADE = "motion.npz"
JOINTS = 7
EMPTY_S = 30.0
STAYS_S = 8.0
MASSES_KG = (0.2, 0.5, 1.0, 2.0)
UP_S, FIRST_S = 60.0, 5.0
LOOKED_S = 0.35
"""A warning comes so much later at most: by the period at which it is looked for, and by the way of messages."""
WITHOUT = ["setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice"]


@dataclass(frozen=True)
class Work:
    """What an arm does.

    Attributes:
        motion: Its joint states.
        changes_s: When something comes or goes, from its beginning on.
    """

    motion: Motion
    changes_s: list[float]


@dataclass(frozen=True)
class Said:
    """A message of `~/estimate`.

    Attributes:
        at_s: When it was heard.
        stamp_s: Of the joint state that it rests on.
        determined: Whether it says a mass.
        warned: Whether it says that it is late, and not whether something is held.
        changed: Whether something was picked up or put down just now.
    """

    at_s: float
    stamp_s: float
    determined: bool
    warned: bool
    changed: bool


def make(
    folder: Path,
    seed: int,
    rate_Hz: float,
    minutes: float,
) -> Work:
    """Robot file, calibration and motion of an arm, in a folder."""
    path = write_sensing_arm(folder, JOINTS, seed)
    robot = load_robot(path)
    arm = SensingArm(folder, JOINTS, seed, rate_Hz)
    empty = [arm.work(EMPTY_S, name=f"empty {number}") for number in range(2)]
    write_calibration(folder / "motions.yaml", robot, fit_empty(robot, empty))
    seconds = FIRST_S + 60.0 * minutes
    count = int((seconds - STAYS_S) // STAYS_S)
    loads = [arm.load(mass) for mass in MASSES_KG]
    schedule = []
    for number in range(count):
        at_s = FIRST_S + STAYS_S * (number + arm.rng.uniform(0.0, 0.2))
        held = loads[number // 2 % len(loads)] if number % 2 == 0 else None
        schedule.append((at_s, held))
    motion = arm.work(seconds, schedule)
    changes_s = [at_s for at_s, _ in schedule]
    np.savez(
        folder / MADE,
        names=motion.joints,
        times_s=motion.times_s,
        position=motion.position,
        effort=motion.current_A,
        changes_s=changes_s,
    )
    return Work(motion, changes_s)


def made(folder: Path) -> Work:
    """What `make` has kept."""
    data = np.load(folder / MADE)
    names = tuple(str(name) for name in data["names"])
    motion = Motion(
        "work", names, data["times_s"], data["position"], data["effort"], {}, "measured torque"
    )
    return Work(motion, data["changes_s"].tolist())


def play(file: Path) -> None:
    """The arm, in its process: stamps are those of the computer's clock, which begins when somebody listens."""
    import rclpy
    from sensor_msgs.msg import JointState

    from proprio_ros.clock import run_in_real_time
    from proprio_ros.nodes.messages import joint_state
    from proprio_ros.nodes.middleware import leave_shared_memory
    from proprio_ros.nodes.qos import STREAM

    leave_shared_memory()
    rclpy.init()
    node = rclpy.create_node("arm")
    publisher = node.create_publisher(JointState, "/joint_states", STREAM)
    data = np.load(file)
    names = [str(name) for name in data["names"]]
    times_s = data["times_s"].tolist()
    position = data["position"].tolist()
    effort = data["effort"].tolist()
    run_in_real_time()
    while publisher.get_subscription_count() < 2:  # the identifier and whoever listens
        time.sleep(0.05)
    begun_s = time.monotonic()
    for row, at_s in enumerate(times_s):
        time.sleep(max(0.0, begun_s + at_s - time.monotonic()))
        state = joint_state(
            time.time_ns(),
            names,
            position[row],
            [],
            effort[row],
        )
        publisher.publish(state)
    print("end", flush=True)


class Listener:
    """Whoever listens: everything that is said, and when."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
        from sensor_msgs.msg import JointState
        from support.listening import HEARD

        from proprio_ros.nodes.qos import STREAM

        rclpy.init()
        self.said: list[Said] = []
        self.first_s: float | None = None
        self.ready = False
        self._node = rclpy.create_node("listener")
        listen = self._node.create_subscription
        listen(DiagnosticArray, "/identifier/estimate", self._on_estimate, HEARD)
        listen(DiagnosticStatus, "/identifier/status", self._on_status, HEARD)
        # all else of it is the identifier's
        self._states = listen(
            JointState,
            "/joint_states",
            self._on_first,
            STREAM,
            raw=True,
        )

    def spin(self, seconds: float) -> None:
        """Listen for so long."""
        import rclpy

        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0:
            rclpy.spin_once(self._node, timeout_sec=left_s)

    def _on_first(self, data: bytes) -> None:
        from proprio_ros.nodes.messages import first_stamp_ns

        if self.first_s is None:
            self.first_s = 1e-9 * first_stamp_ns(data)

    def _on_status(self, message: object) -> None:
        self.ready |= message.message.startswith("ready")  # type: ignore[attr-defined]

    def _on_estimate(self, message: object) -> None:
        from diagnostic_msgs.msg import DiagnosticStatus

        from proprio_ros.nodes.messages import time_ns, values_of

        (status,) = message.status  # type: ignore[attr-defined]
        values = values_of(status)
        late = status.level != DiagnosticStatus.OK and values["holding"] == "unknown"
        said = Said(
            1e-9 * time.time_ns(),
            1e-9 * time_ns(message.header.stamp),  # type: ignore[attr-defined]
            values["payload_mass"] != "not determined" or values.get("verdict") is None,
            late,
            values.get("changed") == "true",
        )
        self.said.append(said)


def seen_s(
    said: list[Said],
    work: Work,
    first_s: float,
) -> tuple[list[float], int]:
    """How late each change was seen in step, in seconds in which the arm moved; and how many were seen, in step or not."""
    found = []
    seen = 0
    for number, change_s in enumerate(work.changes_s):
        ends_s = first_s + (
            work.changes_s[number + 1] if number + 1 < len(work.changes_s) else change_s + STAYS_S
        )
        since_s = first_s + change_s
        those = [each for each in said if since_s <= each.at_s < ends_s]
        first = next((n for n, each in enumerate(those) if each.changed), None)
        if first is None:
            continue
        seen += 1
        if all(each.at_s - each.stamp_s < WARNED_S for each in those[: first + 1]):
            found.append(
                moving_s(
                    work.motion,
                    change_s,
                    those[first].at_s - first_s,
                )
            )
    return found, seen


def figures(
    said: list[Said],
    work: Work,
    first_s: float,
    ends_s: float,
) -> dict[str, float]:
    """What they heard, as numbers."""
    known = [each for each in said if each.determined]
    ages_s = np.array([each.at_s - each.stamp_s for each in known])
    unwarned = np.array([not each.warned for each in known])
    until_s = np.array([each.at_s for each in said[1:]] + [ends_s])
    stood_s = [
        until - each.stamp_s for each, until in zip(said, until_s, strict=True) if each.determined
    ]
    stood = np.array(stood_s)
    late_s, seen = seen_s(said, work, first_s)
    return {
        "messages": len(said),
        "median_s": float(np.median(ages_s)),
        "often_s": float(np.quantile(ages_s, 0.99)),
        "most_s": float(ages_s.max()),
        "warned": int((~unwarned).sum()),
        "withdrawn": len(said) - len(known),
        "over_warned": int((unwarned & (ages_s > WARNED_S)).sum()),
        "over_withdrawn": int((ages_s > WITHDRAWN_S).sum()),
        "stood_unwarned_s": float(stood[unwarned].max()),
        "stood_s": float(stood.max()),
        "changes": len(work.changes_s),
        "seen": seen,
        "in_step": len(late_s),
        "late_s": float(np.median(late_s)) if late_s else float("nan"),
    }


@contextlib.contextmanager
def process(words: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A program, ended with the block."""
    program = subprocess.Popen(words)
    try:
        yield program
    finally:
        program.terminate()
        program.wait()


def soak(
    folder: Path,
    work: Work,
    load: int,
    ordinary: bool,
) -> dict[str, float]:
    """The whole of it, in real time."""
    from proprio_ros.clock import run_in_real_time

    listener = Listener()
    given = {
        "robot": folder / "sensing.yaml", "calibration": folder / "motions.yaml", "data_directory": folder / "data",
        "effort_unit": "N.m", "running": "true", "report": "false", "holding_from": 0.1,
    }  # fmt: skip
    stated = [word for key, value in given.items() for word in ("-p", f"{key}:={value}")]
    identifier = [sys.executable, "-m", "proprio_ros.nodes.identifier", "--ros-args", *stated]
    with contextlib.ExitStack() as ends:
        node = ends.enter_context(process([*WITHOUT * ordinary, *identifier]))
        end_s = time.monotonic() + UP_S
        while not listener.ready and time.monotonic() < end_s:
            listener.spin(0.1)
        assert listener.ready, "the identifier does not come up"
        ends.enter_context(busy(load))
        play_it = [sys.executable, __file__, "--play", str(folder / MADE)]
        arm = ends.enter_context(process(play_it))
        # not before: a program that starts computes for longer than the kernel lets those in real time
        run_in_real_time()
        before_s = cpu_s(node.pid)
        while arm.poll() is None:
            listener.spin(0.5)
        ended_s = time.time()
        used_s = cpu_s(node.pid) - before_s
    assert listener.first_s is not None
    # until then nothing has been learnt
    said = [each for each in listener.said if each.at_s > listener.first_s + 0.5 * FIRST_S]
    found = figures(said, work, listener.first_s, ended_s)
    return found | {"core": used_s / (ended_s - listener.first_s)}


def main(arguments: list[str] | None = None) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--load", type=int, default=15, help="programs that never wait")
    parser.add_argument("--rate", type=float, default=500.0, help="of the joint states [1/s]")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=401, help="of the arm")
    parser.add_argument("--ordinary", action="store_true", help="nobody grants real time")
    parser.add_argument("--folder", type=Path, help="where the arm is kept, or was")
    parser.add_argument("--make", action="store_true", help="make it, and no more")
    parser.add_argument("--play", type=Path, help="be the arm, of this file")
    options = parser.parse_args(arguments)
    if options.play:
        play(options.play)
        return
    os.environ.setdefault("ROS_DOMAIN_ID", free_domain())
    results = Results(__file__, options.json, arguments)
    results.table(
        "old_news",
        {
            "beside": "{load} busy programs, {rate:g} Hz, {minutes:g} min{how}",
            "messages": "{messages}",
            "how old: median, 99 %, most": "{median_s:.2f}, {often_s:.2f}, {most_s:.2f} s",
            "warned; withdrawn": "{warned}; {withdrawn}",
            "over 1 s without a warning": "{over_warned}",
            "over 3 s and not withdrawn": "{over_withdrawn}",
            "stood at most, unwarned; at all": "{stood_unwarned_s:.2f}; {stood_s:.2f} s",
            "changes seen; in step, median": "{seen} of {changes}; {in_step}, {late_s:.2f} s",
            "of a core": "{core:.2f}",
        },
    )
    with tempfile.TemporaryDirectory() as name:
        folder = options.folder or Path(name)
        if (folder / MADE).exists():
            work = made(folder)
        else:
            folder.mkdir(parents=True, exist_ok=True)
            work = make(folder, options.seed, options.rate, options.minutes)
        if options.make:
            return
        found = soak(folder, work, options.load, options.ordinary)
    how = ", without real time" * options.ordinary
    results.row(
        "old_news", load=options.load, rate=options.rate, minutes=options.minutes, how=how, **found
    )
    results.keep()


if __name__ == "__main__":
    main()
