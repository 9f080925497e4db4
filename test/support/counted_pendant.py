"""`proprio pendant`, which says at a signal what it has: ``python -m support.counted_pendant FILE SPEED pendant ..``

At SIGUSR1 a line is added to FILE: tasks, clients, threads, joint states that were taken, and pictures that were drawn. With a
SPEED other than 1 it waits so many times shorter, and hears what a `TalkingArm` says instead of topics; its time goes by those.
"""

from __future__ import annotations

import asyncio
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import Client, core

from proprio_ros.addons.pendant import listener, pendant
from proprio_ros.addons.pendant.drawing import Drawing
from proprio_ros.addons.pendant.news import News
from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.cli import run
from proprio_ros.robot import Robot, load_robot
from support.talking_arm import TalkingArm

LOOKS_EACH_S = 20.0
"""So often the pendant takes what is newest."""
counts: Counter[str] = Counter()


def count(kind: type, method: str) -> None:
    """How often a method is called."""
    plain = getattr(kind, method)

    def counted(*given: Any) -> Any:
        counts[method] += 1
        return plain(*given)

    setattr(kind, method, counted)


def tell(file: Path) -> None:
    """What there is now."""
    if core.loop is None:
        return  # it has not begun
    there = [len(asyncio.all_tasks(core.loop)), len(Client.instances), threading.active_count()]
    with file.open("a") as stream:
        print(*there, counts["hear_states"], counts["show"], file=stream)


def hear_faster(speed: float) -> None:
    """Wait so many times shorter, and hear somebody who talks as fast."""
    talks = TalkingArm()

    def take(subscription: Any, heard: Callable[[Any], None]) -> None:
        message = talks.newest(subscription.topic_name)
        if message is not None:
            heard(message)

    async def robot(_: Pendant) -> Robot:
        return load_robot("open_manipulator_x")

    listener._take_newest = take
    Pendant.robot = robot  # type: ignore[method-assign]
    listener.LOOK_S /= speed
    listener.PUSHED_S /= speed
    pendant.News = lambda: News(lambda: counts["hear_states"] / LOOKS_EACH_S)  # type: ignore[assignment, misc]


def main() -> None:
    told = Path(sys.argv[1])
    speed = float(sys.argv[2])
    del sys.argv[1:3]
    count(News, "hear_states")
    count(Drawing, "show")
    if speed != 1.0:
        hear_faster(speed)
    signal.signal(signal.SIGUSR1, lambda *_: tell(told))
    run()


if __name__ == "__main__":
    main()
