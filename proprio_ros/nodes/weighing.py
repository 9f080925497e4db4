"""Weighing while the arm works: whoever moves it, moves it, and the identifier listens."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from proprio_ros.errors import RecordingError
from proprio_ros.identification.estimate import Estimate
from proprio_ros.inputs.settings import parse_settings
from proprio_ros.live.answers import interval_of, refusal_of
from proprio_ros.live.deadlines import SAVING
from proprio_ros.live.job import WEIGH, Job, JobError
from proprio_ros.live.online_estimator import NO_MOTIONS, OnlineFeed, any_moved
from proprio_ros.live.session import Session
from proprio_ros.live.workspace import Workspace
from proprio_ros.nodes.carrying import Carrying
from proprio_ros.nodes.inputs import Inputs
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.parameters import value_of
from proprio_ros.nodes.results import Results
from proprio_ros.nodes.running import Running
from proprio_ros.pipeline.request import Options
from proprio_ros.probes import probe_at_work
from proprio_ros.recordings.messages import RawMessage
from proprio_ros.recordings.topics import JOINT_STATE
from proprio_ros.recordings.voltage import voltage_driven
from proprio_ros.robot import Robot

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
        self._node = node
        self._workspace = workspace
        self._inputs = inputs
        self._results = results
        self._carrying = carrying
        self._silent = silent
        self._make_feed: Callable[[], OnlineFeed] | None = None
        self._running: Running | None = None

    def prepare(self) -> Robot:
        """The robot; keep what weighing needs, have the running estimate ready where it is asked for, and what joints carry.

        Raises `ConfigurationError`, `RobotError`: What is stated does not fit, or the calibration is of another arm.
        """
        self._inputs.kept = None
        self._make_feed = None
        self._running = None
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
                OnlineFeed,
                probe,
                request.robot,
                request.facts,
                request.locked,
                request.effort_sign,
            )
            self._make_feed()  # so that a calibration of another arm is refused now
            link = request.robot.payload_frame
            self._running = Running(
                self._node,
                self._inputs,
                self._results,
                self._silent,
                link,
            )
        return self._robot

    def weigh(self, job: Job, identify: Identify) -> tuple[bool, str]:
        """Weigh by the motion of the last seconds, from a bag, as `proprio replay` would.

        Args:
            job: Under which it is done.
            identify: From the bag to its estimate.

        Returns:
            Whether the mass is known, and a sentence.

        Raises:
            JobError: It cannot be weighed.
        """
        unit = self._unit()
        kept = self._kept_motion()
        settings = parse_settings(value_of(self._node, "settings"))
        stated = {**settings, **parse_settings(job.settings)}
        request = self._workspace.request(probe_at_work(), stated, None)
        options = replace(request.options, effort_unit=unit)
        job.progress.enter(SAVING)
        session = Session(self._workspace.data, WEIGH)
        for message in kept:
            session.add(*message)
        bag, warning = session.save()
        job.bag = str(bag)
        if warning:
            self._node.say("warning", warning)
        try:
            estimate = identify(
                job,
                bag,
                options,
                partial(self._results.publish, request),
            )
        except RecordingError as error:
            raise JobError(f"not weighed: {error}; recording: {bag}") from error
        answer = interval_of(estimate)
        seconds = self._node.values["weigh_seconds"]
        by = f"the last {seconds:g} s{self._workspace.used}; recording: {bag}"
        if answer:
            return True, f"{request.probe.subject} {answer}, {by}"
        return False, f"{refusal_of(estimate)}; {by}"

    def _unit(self) -> str | None:
        """What the effort of the joint states is; None where a published effort of motors that a voltage drives is no current."""
        if self._inputs.kept is None:
            raise JobError(f"not weighed: {NO_MOTIONS}")
        if set(self._robot.drive_trains) == set(voltage_driven(self._robot)):
            return None
        unit = self._inputs.measured_unit()
        if unit == "":
            words = "nothing says what the effort of the joint states is; give the parameter driver or effort_unit"
            raise JobError(f"not weighed: {words}")
        return unit

    def _kept_motion(self) -> list[RawMessage]:
        """The messages of the last seconds, in which a joint moved."""
        if not self._inputs.has_states:
            words = "no joint states are coming; start the driver and check its bus"
            raise JobError(f"not weighed: {words}")
        kept = list(self._inputs.kept or ())
        states = []
        for raw in kept:
            if raw.msgtype == JOINT_STATE and raw.topic != self._inputs.by_goals:
                state = deserialize_message(raw.data, JointState)
                names = self._inputs.conventions.renamed(state.name)
                states.append((names, state.position))
        if not any_moved(states, self._robot.drive_trains):
            seconds = self._node.values["weigh_seconds"]
            words = f"no joint moved in the last {seconds:g} s; weigh while the arm works"
            raise JobError(f"not weighed: {words}")
        return kept

    def begin(self) -> str:
        """Begin the running estimate, in a thread of its own; returns what to say of it, empty where there is none."""
        if self._make_feed is None:
            return ""
        assert self._running is not None
        feed = self._make_feed()
        self._running.begin(feed)
        return feed.about

    def end(self) -> None:
        """End it."""
        if self._running is not None:
            self._running.end()
