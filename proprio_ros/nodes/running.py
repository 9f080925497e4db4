"""The running estimate: a thread that computes it, and what of it may be said by how old it is."""

from __future__ import annotations

import math
from collections.abc import Callable

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import BatteryState, JointState
from threadpoolctl import threadpool_limits

from proprio_ros import clock
from proprio_ros.identification.regression.online import OnlineEstimate
from proprio_ros.live.news import WARNED_S, WITHDRAWN_S, Arrival, Backlog, News
from proprio_ros.live.online_estimator import OnlineFeed
from proprio_ros.nodes.inputs import Inputs
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.results import Results

RUNNING_PERIOD_S = 0.1
UNFED_S = 2.0
STALLED_S = 0.5
"""Joint states that say nothing for so long, in the beginning and later, are worth a word: no mass stands meanwhile."""
WATCH_S = 0.2
"""So often the thread that hears looks how old the newest estimate is: it does not wait for the one that computes."""
NOTHING_WAITS_S = 0.02
LARGEST_SHARE = 0.3
"""Of one core, where the thread comes before others: three times what it takes on a computer that is not the slowest."""
TOO_BUSY = "the computer is too busy for it: end other programs, or give this one a core of its own"
USELESS = "joint states come, but with gaps, or stamped later than they were measured: have their publisher run in real time"


class Running:
    """What the hand holds now, all the time.

    Args:
        node: That publishes.
        inputs: Hands over what comes in.
        results: Publishes what is known.
        silent: Whether nothing is said for now: a job is under way, or the robot is not what it was.
        link: That holds what is weighed.
    """

    def __init__(
        self,
        node: ManagedNode,
        inputs: Inputs,
        results: Results,
        silent: Callable[[], bool],
        link: str,
    ) -> None:
        self._node = node
        self._inputs = inputs
        self._results = results
        self._silent = silent
        self._link = link
        # of what is known, and said: two threads look after that
        self._lock = clock.lock()
        self._news: News | None = None
        self._changed = False
        self._published_s = -math.inf
        self._late = ""
        node.every(WATCH_S, self._watch)

    def begin(self, feed: OnlineFeed) -> None:
        """Compute from now on, in a thread of its own."""
        self._feed = feed
        self._fed_s = self._taken_s = clock.now()
        self._samples = 0
        self._said = self._late = ""
        self._news = None
        self._inputs.arrived = Backlog()
        clock.thread(target=self._run, name="running estimate").start()

    def end(self) -> None:
        """No more."""
        self._inputs.arrived = None

    def _run(self) -> None:
        backlog = self._inputs.arrived
        # what it has no time for it leaves out, so that others have theirs
        share = clock.Share(LARGEST_SHARE if clock.come_before_others() else 1.0)
        try:
            with threadpool_limits(1, user_api="blas"):
                while backlog is not None and backlog is self._inputs.arrived:
                    begun_s = clock.now()
                    if self._step(backlog):
                        share.computed(clock.now() - begun_s)
                    else:
                        share.rested()
                        clock.sleep(NOTHING_WAITS_S)
        except Exception as error:
            # a defect must be reported, and must not take the services along
            self._inputs.arrived = None
            words = f"the running estimate has ended ({type(error).__name__}: {error}); activate the node again"
            self._node.say("error", words)
            with self._lock:
                self._withdraw(words)

    def _step(self, backlog: Backlog) -> bool:
        """Take what comes next, and publish what it says; whether there was something."""
        arrival = backlog.take(self._feed.needs)
        self._say_how_it_is(arrival)
        if arrival is None:
            return False
        estimate = self._fed(arrival)
        self._taken_s = arrival.sent_s
        if self._feed.samples > self._samples:
            self._samples = self._feed.samples
            self._fed_s = arrival.sent_s
        if estimate is not None:
            with self._lock:
                self._news = News(estimate, arrival.stamp_ns, arrival.sent_s)
                changes = estimate.changed is not self._changed
                self._publish_or_withdraw(at_once=changes)
        return True

    def _fed(self, arrival: Arrival) -> OnlineEstimate | None:
        """The estimate that a message brings, if it brings one."""
        feed = self._feed
        data = arrival.raw.data
        if arrival.role == "battery_state":
            feed.stall.hear_voltage(deserialize_message(data, BatteryState).voltage)
            return None
        message = deserialize_message(data, JointState)
        names = self._inputs.conventions.renamed(message.name)
        time_s = 1e-9 * arrival.stamp_ns
        if arrival.role == "joint_command":
            feed.stall.hear_goals(time_s, names, message.position)
            return None
        unit = self._inputs.measured_unit()
        return feed.add(time_s, names, message.position, message.effort, unit)

    def _watch(self) -> None:
        """Whoever computes may not be run for seconds; what was said last must not stand so long."""
        with self._lock:
            news = self._news
            if news is not None and news.behind_s(clock.now()) >= WARNED_S:
                self._publish_or_withdraw(at_once=True)

    def _publish_or_withdraw(self, at_once: bool) -> None:
        """The newest estimate, if it is due, as what it is by now; nothing where it is too old (`WITHDRAWN_S`)."""
        if self._silent() or self._news is None:
            self._news = None
            return
        behind_s = self._news.behind_s(clock.now())
        if behind_s >= WITHDRAWN_S:
            why = USELESS if clock.now() - self._taken_s < WARNED_S else TOO_BUSY
            words = f"the running estimate is {behind_s:.0f} s behind and withdrawn: {why}"
            self._late = words
            self._withdraw(words)
        elif at_once or clock.now() - self._published_s >= 0.8 * RUNNING_PERIOD_S:
            self._late = ""
            self._published_s = clock.now()
            self._changed = self._news.estimate.changed
            self._results.running(
                self._feed,
                self._news,
                behind_s,
                self._link,
            )

    def _withdraw(self, why: str) -> None:
        if self._news is not None:
            self._results.no_news(self._feed, why)
        self._news = None

    def _say_how_it_is(self, arrival: Arrival | None) -> None:
        """Say once that nothing came for some time to estimate from, or too late, and once that it does again."""
        if self._silent():
            return
        why = self._late
        # what is taken now was sent then; where nothing waits, all has been heard that came before the node's last turn
        reached_s = self._node.turns.begun_s if arrival is None else arrival.sent_s
        if reached_s - self._fed_s > (STALLED_S if self._feed.samples else UNFED_S):
            waits_for = self._feed.waits_for or "no joint states of the arm are coming"
            why = f"the running estimate waits: {waits_for}"
        if why == self._said:
            return
        self._said = why
        with self._lock:
            if why:
                self._node.say("warning", why)
                self._withdraw(why)
                self._results.withdraw()
        ready = f"ready; {self._feed.about}"
        self._results.tell(
            "idle",
            why or ready,
            level="warning" if why else "ok",
        )
