"""Weighing while the arm works: whoever moves it, moves it, and the identifier listens."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import BatteryState, JointState
from threadpoolctl import threadpool_limits

from proprio_ros import clock
from proprio_ros.errors import RecordingError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.inputs.settings import parse_settings
from proprio_ros.live.answers import interval_of, refusal_of
from proprio_ros.live.job import WEIGH, Job, JobError
from proprio_ros.live.online_estimator import NO_MOTIONS, OnlineFeed, any_moved
from proprio_ros.live.session import Session
from proprio_ros.live.workspace import Workspace
from proprio_ros.nodes import messages
from proprio_ros.nodes.carrying import Carrying
from proprio_ros.nodes.inputs import Inputs
from proprio_ros.nodes.parameters import value_of
from proprio_ros.nodes.results import Results
from proprio_ros.nodes.runtime import ManagedNode
from proprio_ros.pipeline.request import Options
from proprio_ros.probes import probe_at_work
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.robot import Robot

RUNNING_PERIOD_S = 0.1
UNFED_S, STALLED_S = 2.0, 0.5
"""Joint states that say nothing for so long, in the beginning and later, are worth a word: no mass stands meanwhile."""

Identify = Callable[[Job, Path, Options, Callable[[Estimate], None]], Estimate]
"""From a bag to its estimate; see `Jobs.identify`."""


class Weighing:
    """What the hand held in the last seconds, on request; what it holds now, all the time where that is asked for.

    While ``silent`` says so, the running estimate only listens: a job is under way, or the robot is not what it was.
    """

    def __init__(
        self,
        node: ManagedNode,
        workspace: Workspace,
        inputs: Inputs,
        results: Results,
        carrying: Carrying,
        silent: Callable[[], bool],
    ) -> None:
        self._node, self._workspace, self._inputs, self._carrying = (
            node,
            workspace,
            inputs,
            carrying,
        )
        self._results, self._silent = results, silent
        self._make_feed: Callable[[], OnlineFeed] | None = None

    def prepare(self) -> Robot:
        """The robot; keep what weighing needs, have the running estimate ready where it is asked for, and what joints carry.

        Raises `ConfigurationError`, `RobotError`: What is stated does not fit, or the calibration is of another arm.
        """
        self._inputs.kept = self._make_feed = None
        asked = bool(self._node.values["running"])
        stated = parse_settings(value_of(self._node, "settings"))
        self._robot: Robot = self._workspace.configured(stated)
        self._carrying.use(self._robot)
        off = "" if self._robot.motion_calibration is not None else NO_MOTIONS
        if not off:
            self._inputs.kept = deque()
        if asked and off:
            self._node.say("warning", f"the running estimate is off: {off}")
        elif asked:
            probe = probe_at_work()
            request = self._workspace.request(probe, stated, None)
            self._make_feed = partial(
                OnlineFeed, probe, request.robot, request.facts, request.locked
            )
            self._make_feed()  # so that a calibration of another arm is refused now
            self._link = request.robot.payload_frame
        return self._robot

    def weigh(self, job: Job, identify: Identify) -> tuple[bool, str]:
        """Weigh by the motion of the last seconds, from a bag, as `proprio replay` would."""
        seconds = self._node.values["weigh_seconds"]
        if self._inputs.kept is None:
            raise JobError(f"not weighed: {NO_MOTIONS}")
        # a published effort of motors that a voltage drives is no current
        by_voltage = set(self._robot.drive_trains) == set(voltage_driven(self._robot))
        unit = None if by_voltage else self._inputs.measured_unit()
        if unit == "":
            words = "nothing says what the effort of the joint states is; give the parameter driver or effort_unit"
            raise JobError(f"not weighed: {words}")
        if not self._inputs.has_states:
            raise JobError(
                "not weighed: no joint states are coming; start the driver and check its bus"
            )
        kept = list(self._inputs.kept)
        renamed = self._inputs.conventions.renamed
        of_states = [
            raw for raw in kept if raw.msgtype == JOINT_STATE and raw.topic != self._inputs.by_goals
        ]
        states = (deserialize_message(raw.data, JointState) for raw in of_states)
        if not any_moved(
            ((renamed(state.name), state.position) for state in states), self._robot.drive_trains
        ):
            raise JobError(
                f"not weighed: no joint moved in the last {seconds:g} s; weigh while the arm works"
            )
        stated = {
            **parse_settings(value_of(self._node, "settings")),
            **parse_settings(job.settings),
        }
        request = self._workspace.request(probe_at_work(), stated, None)
        options = replace(request.options, effort_unit=unit)
        session = Session(self._workspace.data, WEIGH)
        for message in kept:
            session.add(*message)
        bag, warning = session.save()
        job.bag = str(bag)
        if warning:
            self._node.say("warning", warning)
        try:
            estimate = identify(job, bag, options, partial(self._results.publish, request))
        except RecordingError as error:
            raise JobError(f"not weighed: {error}; recording: {bag}") from error
        answer = interval_of(estimate)
        said = f"the last {seconds:g} s{self._workspace.used}; recording: {bag}"
        if answer:
            return True, f"{request.probe.subject} {answer}, {said}"
        return False, f"{refusal_of(estimate)}; {said}"

    def begin(self) -> str:
        """Begin the running estimate, in a thread of its own; returns what to say of it, empty where there is none."""
        if self._make_feed is None:
            return ""
        feed = self._make_feed()
        self._inputs.arrived = deque(maxlen=5000)
        clock.thread(target=self._run, args=(feed,), name="running estimate").start()
        return feed.about

    def end(self) -> None:
        """End it."""
        self._inputs.arrived = None

    def _run(self, feed: OnlineFeed) -> None:
        clock.come_after_others()
        try:
            self._weigh_on(feed)
        except (
            Exception
        ) as error:  # a defect must be reported, and must not take the services along
            self._inputs.arrived = None
            words = f"the running estimate has ended ({type(error).__name__}: {error}); activate the node again"
            self._node.say("error", words)

    def _weigh_on(self, feed: OnlineFeed) -> None:
        """Take what arrived, and publish what it says."""
        arrived = self._inputs.arrived
        renamed = self._inputs.conventions.renamed
        published_s = -math.inf
        fed_s = clock.now()
        samples = 0
        said = ""
        changed = False
        with threadpool_limits(1, user_api="blas"):
            while arrived is not None and arrived is self._inputs.arrived:
                said = self._say_whether_fed(feed, fed_s, said)
                if not arrived:
                    clock.sleep(0.02)
                    continue
                role, raw = arrived.popleft()
                now_ns = raw.time_ns
                if role == "battery_state":
                    feed.stall.hear_voltage(deserialize_message(raw.data, BatteryState).voltage)
                    continue
                message = deserialize_message(raw.data, JointState)
                time_s = 1e-9 * (messages.time_ns(message.header.stamp) or now_ns)
                if role == "joint_command":
                    feed.stall.hear_goals(time_s, renamed(message.name), message.position)
                    continue
                unit = self._inputs.measured_unit()
                estimate = feed.add(
                    time_s, renamed(message.name), message.position, message.effort, unit
                )
                if feed.samples > samples:
                    samples = feed.samples
                    fed_s = clock.now()
                if estimate is None or self._silent():
                    continue
                if (
                    clock.now() - published_s >= 0.8 * RUNNING_PERIOD_S
                    or estimate.changed is not changed
                ):
                    published_s = clock.now()
                    changed = estimate.changed
                    behind_s = 1e-9 * (self._node.get_clock().now().nanoseconds - now_ns)
                    self._results.running(feed, estimate, self._link, behind_s)

    def _say_whether_fed(self, feed: OnlineFeed, fed_s: float, said: str) -> str:
        """Say once that nothing came for some time to estimate from, and once that it does again; returns what stands."""
        if self._silent():
            return said
        why = ""
        if clock.now() - fed_s > (STALLED_S if feed.samples else UNFED_S):
            why = f"the running estimate waits: {feed.waits_for or 'no joint states of the arm are coming'}"
        if why == said:
            return said
        if why:
            self._node.say("warning", why)
            self._results.withdraw()
        self._results.tell("idle", why or f"ready; {feed.about}", level="warning" if why else "ok")
        return why
