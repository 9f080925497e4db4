"""The identifier node: asks for a probe, listens, keeps the recording, publishes the estimate.

A job has a thread of its own, so that neither the arm's motion nor the identification ever blocks the executor; a second thread
estimates from what has come so far, where the probe can (a sphere cannot: where it rolls shows only when a run is over). The
recording is written before anything is identified, and what is identified is the recording, by the function that `proprio replay`
calls. Which probes there are, the registry says.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RosParameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import Trigger
from threadpoolctl import threadpool_limits
from visualization_msgs.msg import MarkerArray

from proprio_ros import progress
from proprio_ros.bags import EFFORT_UNITS, RawMessage
from proprio_ros.calibrating import calibrate_from_bags
from proprio_ros.errors import ConfigurationError, ProprioError, RecordingError, RobotError
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.identification.running import CENTRE_STD_M, RunningEstimate, RunningWeight
from proprio_ros.motions import MOVED_RAD
from proprio_ros.nodes import messages
from proprio_ros.nodes.parameters import ROBOT, Parameter, value_of
from proprio_ros.nodes.runtime import (
    COMMANDS,
    IDLE_PAUSE_S,
    LATCHED,
    STREAM,
    Answer,
    LongService,
    ManagedNode,
    run_node,
)
from proprio_ros.probes import all_probes, probe_named
from proprio_ros.probes.base import Carried, Probe
from proprio_ros.quantity import Z95, shown, spec_for
from proprio_ros.replay import ReplayOptions, replay, robot_of, write_report
from proprio_ros.report import write_calibration_report
from proprio_ros.robot import Robot, load_robot
from proprio_ros.session import (
    LiveEstimate,
    Session,
    Setting,
    as_diagnostics,
    as_parameters,
    baseline_options,
    check_input,
    check_settings,
    keep_result,
    live_interval,
    prepare_identification,
    recover,
    replay_command,
    setting_of,
    settings_for,
)
from proprio_ros.settings import parse_settings

STALE_S = 0.5
READY_S = 4.0
SILENT_S = 3.0
"""The excitation node publishes its state ten times a second while it is busy; without a word for so long it is gone."""
LEASE_PERIOD_S = 0.1
"""The excitation node ends a sequence when whoever asked for it has been silent for 1.5 s."""
CHECK_S, LONGEST_CHECK_S = 0.3, 2.0
"""What comes in is listened to for so long before a probe; longer where it cannot be read yet."""
CALL_S = 5.0
ABORT_S = 2.0
TAIL_S = 0.3
"""Joint states after the last run that belong to the recording."""
BEHIND_S = 0.2
LATEST_S = 30.0
"""On a busy computer joint states may lie in the queue for so long, while a word of the excitation node comes past them."""
WEIGH = "weigh"
"""The job that needs no excitation: whoever moves the arm, moves it."""
RUNNING_PERIOD_S = 0.1
OLD_S = 86400.0
"""Age of a baseline that is worth a warning: nobody remembers what was changed since."""


def _services() -> dict[str, str]:
    """Kind of job and its service: the robot's, and of each probe one to identify and one to record its baseline."""
    services = {"robot": "calibrate_robot", WEIGH: "weigh"}
    for probe in all_probes():
        services[probe.name] = f"calibrate_{probe.name}"
        if probe.baseline is not None:
            services[f"{probe.name}_baseline"] = f"record_{probe.name}_baseline"
    return services


def _parameters_of(probe: Probe[Any]) -> list[Parameter]:
    """What can be said to the node about a probe."""
    services = f"calibrate_{probe.name}"
    baseline = f"record_{probe.name}_baseline"
    if probe.baseline is not None:
        services += f" and {baseline}"
    parameters = [
        Parameter(f"{probe.name}_sequence", probe.default_sequence, f"Probe sequence of {services}.", dynamic=True)
    ]
    if probe.baseline is not None:
        words = f"Bag of the {probe.baseline.noun}; empty: what {baseline} kept last; none: without."
        parameters.append(Parameter(f"{probe.name}_baseline", "", words, dynamic=True))
    for limit in probe.limits:
        parameters.append(
            Parameter(limit.name, limit.default, limit.description, limit.lowest, limit.highest, dynamic=True)
        )
    return parameters


_NO_MOTIONS = (
    "there is no calibration of motions; record the arm with an empty hand while it works, run `proprio calibrate BAG --output "
    "FILE`, and give that file as the parameter calibration"
)


class JobError(ProprioError):
    """Why a job ended without a result, in one sentence."""


@dataclass
class Job:
    """One service call that is being worked on."""

    kind: str
    service: str
    cancelled: threading.Event = field(default_factory=threading.Event)
    ended: threading.Event = field(default_factory=threading.Event)
    success: bool = False
    message: str = ""
    on_end: list[Callable[[], None]] = field(default_factory=list)


class IdentifierNode(ManagedNode):
    """Services in, results out."""

    parameters = (
        ROBOT,
        Parameter("calibration", "", "Calibration file; empty: the newest of this robot in data_directory; none: without."),
        Parameter("data_directory", "~/.ros/proprio_ros",
                  "Where recordings, results and calibrations are kept; those of a namespace in a folder of its name."),
        Parameter("settings", [], "What is known about the object, as with --set: payload.size=0.03, sphere.radius=0.01.",
                  dynamic=True),
        Parameter("robot_sequence", "empty_hand", "Probe sequence of calibrate_robot."),
        *(parameter for probe in all_probes() for parameter in _parameters_of(probe)),
        Parameter("reference_sequence", "reference", "Probe sequence of calibrate_robot with the reference object."),
        Parameter("reference_mass", 0.0, "Mass of a weighed object for calibrate_robot [kg]; 0: none.", 0.0, 5.0, dynamic=True),
        Parameter("reference_settings", [], "The same about the reference object.", dynamic=True),
        Parameter("reference_wait", 10.0, "Time to put the reference object into the hand [s].", 0.0, 600.0, dynamic=True),
        Parameter("excitation_node", "excitation", "Name of the excitation node."),
        Parameter("state_topic", "", "Topic of the joint states, as with --state-topic; empty: joint_states."),
        Parameter("command_topic", "",
                  "Topic of what drives the joints, as with --command-topic; empty: applied_effort, else current_command."),
        Parameter("effort_unit", "",
                  "What effort of the joint states means where nothing else says what drives the joints: N.m, A, mA or raw."),
        Parameter("frame_prefix", "", "Before the frame of payload and markers, as robot_state_publisher's: arm1/."),
        Parameter("report", True, "Write the result and an HTML report beside every recording."),
        Parameter("weigh_seconds", 15.0, "How much of the latest motion weigh takes [s].", 5.0, 120.0),
        Parameter("running", False,
                  "Estimate the mass in the hand all the time, whatever moves the arm, and publish it ten times a second. Off by "
                  "default, since it takes a tenth of a processor core and replaces what a service published."),
        Parameter("live_period", 0.03, "Pause between estimates while a run is under way [s]; 0 turns them off.", 0.0, 10.0),
    )  # fmt: skip

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("identifier", **kwargs)
        self._sequences = {each.name: each.default for each in self.parameters if each.name.endswith("_sequence")}
        self._job: Job | None = None
        self._job_lock = threading.Lock()
        self._closing = False
        self._topics: dict[str, Any] = {}
        self._joints: list[bytes] = []
        self._motors = b""
        self._session: Session | None = None
        self._unsaved: list[Session] = []
        self._live: LiveEstimate | None = None
        self._heard: list[RawMessage] | None = None
        self._kept: deque[RawMessage] | None = None  # joint states of the last seconds, for weigh
        self._arrived: deque[tuple[int, Any]] | None = None  # joint states that the running estimate has not seen
        self._standing: dict[str, Callable[[], None]] = {}  # what was published of the hand, and what withdraws it
        self._concluded = False
        self._asking = False
        self._driven = False
        self._state_at_s = self._effort_at_s = -1e9
        self._state_stamp_ns = 0
        self._lag_ns = self._least_lag_ns = sys.maxsize  # from a joint state's stamp, of whatever clock, to here
        self._excitation: dict[str, str] = {}
        self._excitation_at_s = self._unfed_at_s = -1e9

    @property
    def pause_s(self) -> float:
        return 0.0 if self._job is not None else IDLE_PAUSE_S

    # --- lifecycle ----------------------------------------------------------------------------------------------------

    def configure(self) -> None:
        if self.values["effort_unit"] not in ("", *EFFORT_UNITS):
            raise ConfigurationError(
                f"parameter effort_unit={self.values['effort_unit']!r}: choose one of {', '.join(EFFORT_UNITS)}"
            )
        # two arms on one network must not take each other's calibration for their own
        self._data = Path(self.values["data_directory"]).expanduser() / self.get_namespace().strip("/")
        recovered, problems = recover(self._data)
        for bag in recovered:
            self.say("warning", f"a recording that was cut off when this node was killed is kept: {bag}")
        for problem in problems:
            self.say("error", problem)
        self._calibration = self._find_calibration()
        for name, default in self._sequences.items():
            if value_of(self, name) != default:  # not every robot can make every default
                self._check_sequence(name, value_of(self, name))
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        started = time.monotonic()
        with progress.listening(partial(self._tell_and_log, "starting")):
            prepare_identification(self._options())  # kernels are compiled here, and never inside a probe
        for given in ("settings", "reference_settings"):
            check_settings(replace(self._options(), settings=parse_settings(value_of(self, given))))
        self.say("info", f"ready after {time.monotonic() - started:.1f} s; calibration: {self._calibration or 'none'}")

        self._estimate = self.create_publisher(DiagnosticArray, "~/estimate", LATCHED)
        self._payload = self.create_publisher(InertiaStamped, "~/payload", LATCHED)
        self._markers = self.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._numbers = {
            name: self.create_publisher(Float64, f"~/{name}", LATCHED)
            for name in dict.fromkeys(topic for probe in all_probes() for topic in probe.numbers)
        }
        # bytes as they came over the wire: that is what goes into the bag
        for role, topic, kind in (
            ("joint_states", self.values["state_topic"] or "joint_states", JointState),
            ("applied_effort", "applied_effort", JointState), ("applied_current", "applied_current", Float64MultiArray),
            ("current_command", "current_command", Float64MultiArray),
        ):  # fmt: skip
            listener = self._listener(self.resolve_topic_name(topic), role, kind)
            skip = partial(self._may_skip, role)
            # joint states at 500 Hz would have a wake-up each, and a node on a busy computer would hear them seconds late
            together = partial(self._takes_all, role)
            self.listen(kind, topic, listener, STREAM, raw=True, only_newest=skip, together=together)
        self._motors_topic = self.resolve_topic_name("motors")
        self.create_subscription(DiagnosticStatus, "motors", self._on_motors, LATCHED, raw=True)
        self._joints = [name.encode() for name in robot_of(self.values["robot"], None).drive_trains]
        self._topics = self._stated_topics()
        self._prepare_weighing()
        if self._topics["command_topic"]:
            self.every(0.5, self._listen_to_command)
        name = self.values["excitation_node"]
        self.create_subscription(DiagnosticStatus, f"{name}/status", self._on_excitation, LATCHED)
        self._set_probe = self.create_client(SetParameters, f"{name}/set_parameters")
        self._run = self.create_client(Trigger, f"{name}/run")
        self._abort = self.create_client(Trigger, f"{name}/abort")
        self._lease = self.create_publisher(Bool, f"{name}/lease", COMMANDS)
        self.every(LEASE_PERIOD_S, self._renew_lease)
        self._service_of = _services()
        for kind_, service in self._service_of.items():
            LongService(self, f"~/{service}", partial(self._begin, kind_))
        LongService(self, "~/cancel", self._cancel)
        self.every(5.0, self._save_again)
        self.add_on_set_parameters_callback(self._on_parameters)

    def activate(self) -> None:
        self._closing = False
        self._tell("idle", "ready")
        if self._running is not None:
            self._arrived = deque(maxlen=5000)
            threading.Thread(
                target=self._weigh_all_the_time, args=(self._running,), name="running estimate", daemon=True
            ).start()

    def deactivate(self) -> None:
        self._closing = True
        self._arrived = None
        job = self._job
        if job is not None:
            job.cancelled.set()
            job.ended.wait(CALL_S)
        self._save_again()

    def _on_parameters(self, parameters: list[RosParameter]) -> SetParametersResult:
        """Facts that cannot be understood, and sequences that cannot be made, are refused when they are stated, with the reason."""
        try:
            for parameter in parameters:
                if parameter.name in ("settings", "reference_settings"):
                    facts = parse_settings([pair for pair in parameter.value if pair])
                    check_settings(ReplayOptions(robot=self.values["robot"], settings=facts))
                elif parameter.name in self._sequences:
                    self._check_sequence(parameter.name, str(parameter.value))
        except ProprioError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_sequence(self, parameter: str, name: str) -> None:
        try:
            load_sequence(name, load_robot(self.values["robot"]))
        except ProprioError as error:
            raise ConfigurationError(f"{parameter}: {error}") from error

    def _find_calibration(self) -> Path | None:
        stated = self.values["calibration"]
        if stated == "none":
            return None
        # the file behind the link stays what it is, so that a result can be had again
        path = (Path(stated).expanduser() if stated else self._newest_calibration()).resolve()
        if not stated and not path.exists():
            return None
        try:
            robot_of(self.values["robot"], path)
        except RobotError as error:
            if stated:
                raise RobotError(as_parameters(str(error))) from error
            self.say("warning", f"goes on without calibration: {as_parameters(str(error))}")
            return None
        return path

    def _newest_calibration(self) -> Path:
        return self._data / f"{Path(self.values['robot']).stem}_calibration.yaml"

    def _newest_baseline(self, probe: Probe[Any]) -> Path:
        return self._data / f"{Path(self.values['robot']).stem}_{probe.name}_baseline"

    def _find_baseline(self, probe: Probe[Any]) -> Path | None:
        """The recording without what is to be identified, if there is one.

        Raises:
            JobError: One was named that is not there.
        """
        if probe.baseline is None:
            return None
        name = f"{probe.name}_baseline"
        stated = value_of(self, name)
        if stated == "none":
            return None
        path = Path(stated).expanduser() if stated else self._newest_baseline(probe)
        if stated and not path.exists():
            raise JobError(f"{name} {path}: there is no such recording; name a bag, or leave it empty")
        return path.resolve() if path.exists() else None

    def _keep_as_newest(self, link: Path, target: Path) -> None:
        """Have the link point to the target, in one step.

        Raises:
            JobError: It cannot be written.
        """
        fresh = link.with_name(f".{link.name}.{os.getpid()}")
        try:
            fresh.symlink_to(target)
            fresh.replace(link)
        except OSError as error:
            raise JobError(
                f"{link} cannot be written ({error.strerror}); what it should point to is {target}"
            ) from error

    def _options(self) -> ReplayOptions:
        robot = None if self._calibration else self.values["robot"]
        return ReplayOptions(robot=robot, calibration=self._calibration, **self._topics)

    def _stated_topics(self) -> dict[str, Any]:
        """What a replay must be told to take the same topics; nothing where they have their usual names."""
        topics: dict[str, Any] = {"effort_unit": self.values["effort_unit"] or None}
        for option, usual in (("state_topic", "joint_states"), ("command_topic", "applied_effort")):
            full = self.resolve_topic_name(self.values[option] or usual)
            topics[option] = full if self.values[option] or not full.endswith(f"/{usual}") else None
        return topics

    def _setting(self, probe: Probe[Any], baseline: Path | None) -> Setting:
        """What a job is about: robot, and what is stated about the object, read once."""
        settings = settings_for(probe, parse_settings(value_of(self, "settings")))
        empty = () if baseline is None else (baseline,)
        return setting_of(replace(self._options(), probe=probe.name, settings=settings, baseline=empty))

    # --- what comes in ------------------------------------------------------------------------------------------------

    def _listener(self, full_name: str, role: str, kind: type) -> Callable[[bytes], None]:
        msgtype = _type_of(kind)

        def listen(data: bytes) -> None:
            now_ns = self.get_clock().now().nanoseconds
            if role == "joint_states":
                self._state_at_s = time.monotonic()
                if any(name in data for name in self._joints):  # others on the topic may have another clock
                    self._state_stamp_ns = messages.first_stamp_ns(data) or now_ns
                    self._lag_ns = now_ns - self._state_stamp_ns
                    self._least_lag_ns = min(self._lag_ns, self._least_lag_ns)
            elif role == "applied_effort":
                self._effort_at_s = time.monotonic()
            session, heard, kept, arrived = self._session, self._heard, self._kept, self._arrived
            if role == "joint_states" and kept is not None:
                kept.append(RawMessage(full_name, msgtype, now_ns, bytes(data)))
                while now_ns - kept[0].time_ns > 1e9 * self.values["weigh_seconds"]:
                    kept.popleft()
            if role == "joint_states" and arrived is not None:
                arrived.append((now_ns, bytes(data)))
            if heard is not None:
                heard.append(RawMessage(full_name, msgtype, now_ns, bytes(data)))
            if session is None:
                return
            session.add(full_name, msgtype, now_ns, bytes(data))
            live = self._live
            if live is not None and role != "applied_current":
                self._add_live(live, role, now_ns, deserialize_message(data, kind))

        return listen

    def _on_motors(self, data: bytes) -> None:
        """Said once, when the driver finds them."""
        self._motors = bytes(data)

    def _told_motors(self) -> list[RawMessage]:
        """What the driver said of its motors; nothing where none of ours runs any more."""
        if not self._motors or not self.count_publishers(self._motors_topic):
            return []
        now_ns = self.get_clock().now().nanoseconds
        return [RawMessage(self._motors_topic, _type_of(DiagnosticStatus), now_ns, self._motors)]

    def _add_live(self, live: LiveEstimate, role: str, now_ns: int, message: Any) -> None:
        if role == "joint_states":
            live.add_state(messages.time_ns(message.header.stamp), message.name, message.position)
        elif role == "applied_effort":
            live.add_input(messages.time_ns(message.header.stamp), message.name, message.effort)
            self._driven = any(message.effort)
        else:
            current_A = messages.by_joint(message, live.joints)
            if not isinstance(current_A, str):
                live.add_command(now_ns, current_A)
                if time.monotonic() - self._effort_at_s > STALE_S:
                    self._driven = any(current_A.values())

    def _listen_to_command(self) -> None:
        """The topic that the user named; its type shows when somebody publishes it."""
        name = self._topics["command_topic"]
        if any(subscription.topic_name == name for subscription in self.subscriptions):
            return
        for role, kind in (("applied_effort", JointState), ("current_command", Float64MultiArray)):
            if _type_of(kind) in dict(self.get_topic_names_and_types()).get(name, []):
                self.listen(kind, str(name), self._listener(str(name), role, kind), STREAM, raw=True)

    def _renew_lease(self) -> None:
        if self._asking:
            self._lease.publish(Bool(data=True))

    def _on_excitation(self, message: DiagnosticStatus) -> None:
        self._excitation = messages.values_of(message)
        self._excitation_at_s = time.monotonic()
        if self._excitation.get("joint_states") != "true":
            self._unfed_at_s = self._excitation_at_s
        job = self._job
        if job is not None and self._excitation.get("busy") == "true":
            values = self._excitation
            self._tell(
                job.kind, message.message, {"fraction": values.get("fraction", ""), "phase": values.get("phase", "")}
            )

    # --- services -----------------------------------------------------------------------------------------------------

    def _begin(self, kind: str, answer: Answer) -> None:
        """Begin a job, or answer why there can be none now."""
        if not self.active:
            return answer(False, "the identifier node is not active")
        if self._job is not None:
            return answer(False, f"busy: {self._job.service} is under way; wait for it, or call ~/cancel")
        self._job = job = Job(kind, self._service_of[kind])
        threading.Thread(target=self._work, args=(job, answer), name=f"calibrate {kind}", daemon=True).start()
        return None

    def _cancel(self, answer: Answer) -> None:
        with self._job_lock:
            job = self._job
            if job is None:
                return answer(True, "nothing was under way")
            job.on_end.append(lambda: answer(True, f"{job.service} was cancelled; the arm is held"))
        job.cancelled.set()
        return None

    # --- the job's thread ---------------------------------------------------------------------------------------------

    def _work(self, job: Job, answer: Answer) -> None:
        level = "error"
        self._concluded = False
        try:
            self._withdraw()
            if job.kind != WEIGH:
                self._await_others()
            job.success, job.message = self._make(job)
            level = "ok" if job.success else "warning"
        except ProprioError as error:
            job.message = str(error)
        except Exception as error:  # a defect must be reported, and must not leave the services busy for ever
            job.message = f"a defect in the identification ({type(error).__name__}: {error}); the recording is kept"
            self.get_logger().error(job.message)
        finally:
            self._session = None
            with self._job_lock:
                self._job = None
            self.say("info" if job.success else "warning", job.message)
            if self.active:
                if not job.success and not self._concluded:
                    self._publish_failure(job)
                self._tell("idle", job.message, level=level)
            job.ended.set()
            answer(job.success, job.message)
            for tell in job.on_end:
                tell()

    def _await_others(self) -> None:
        """Driver and excitation may have come up a moment ago.

        Raises:
            JobError: One of them is not there.
        """
        deadline = time.monotonic() + READY_S
        while True:
            if time.monotonic() - self._state_at_s > STALE_S:
                missing = "no joint states are coming; start the driver and check its bus"
            elif not self._run.service_is_ready() or not self._set_probe.service_is_ready():
                missing = f"there is no {self.values['excitation_node']} node; start it"
            elif self._excitation.get("driver"):
                raise JobError(f"the driver is {self._excitation['driver']}")
            elif self._excitation.get("joint_states") != "true":
                missing = f"no joint states reach {self.values['excitation_node']}; are the topics named alike?"
            else:
                missing = self._missing_input()
            if not missing:
                return
            if time.monotonic() > deadline:
                raise JobError(f"not ready: {missing}")
            time.sleep(0.05)

    def _missing_input(self) -> str:
        """Why a recording would not say what drove the joints, or an empty string."""
        effort, command = self.resolve_topic_name("applied_effort"), self.resolve_topic_name("current_command")
        if time.monotonic() - self._effort_at_s <= STALE_S:
            return ""
        if self.count_publishers(effort):
            return f"nothing comes on {effort}, although it has a publisher"
        named = self._topics["command_topic"]
        if named is not None:
            return "" if self.count_publishers(named) else f"nobody publishes the parameter command_topic, {named}"
        # what the excitation node commands says it as well, where somebody obeys
        others = [info for info in self.get_subscriptions_info_by_topic(command) if info.node_name != self.get_name()]
        if others or self.values["effort_unit"]:
            return ""
        return (
            f"nothing says what drives the joints: nobody publishes {effort} or listens to {command}; start the driver, or "
            "give the parameter command_topic or effort_unit"
        )

    def _make(self, job: Job) -> tuple[bool, str]:
        """Whether a job succeeded, and what there is to say."""
        if job.kind == "robot":
            return self._calibrate(job)
        if job.kind == WEIGH:
            return self._weigh(job)
        name = job.kind.removesuffix("_baseline")
        if name != job.kind and name in self._service_of:
            return self._record_baseline(job, probe_named(name))
        return self._identify_object(job, probe_named(job.kind))

    def _identify_object(self, job: Job, probe: Probe[Any]) -> tuple[bool, str]:
        """Have the runs of a probe made, and identify the object from them."""
        baseline = self._find_baseline(probe)
        setting = self._setting(probe, baseline)
        if baseline is None and probe.baseline is not None and probe.needs_baseline(setting.facts):
            raise JobError(f"the {probe.baseline.noun} has not been recorded: {probe.baseline.missing}")
        sequence = value_of(self, f"{probe.name}_sequence")
        limits = {limit.name: float(value_of(self, limit.name)) for limit in probe.limits}
        if probe.limits:
            probe.check(setting.robot, setting.facts, load_sequence(sequence, setting.robot), limits)
        self._live = LiveEstimate(setting) if probe.live and self.values["live_period"] > 0.0 else None
        if probe.prepares:
            self._tell(job.kind, f"preparing the simulation of {probe.prepares}")
        with progress.listening(partial(self._tell_and_log, job.kind)):
            probe.prepare(setting.robot, setting.facts)
        if job.cancelled.is_set():
            raise JobError("cancelled")
        if probe.hand:
            self._tell(job.kind, probe.hand)
        bag = self._record(job, job.kind, sequence, setting.robot, setting.options)
        estimate = self._identify(job, bag, setting.options, partial(self._publish, setting))
        against = "" if baseline is None else f"; {self._about_baseline(baseline)}"
        answer = _interval_of(estimate)
        if not answer:
            return False, f"{_refusal_of(estimate)}{self._used}{against}; recording: {bag}"
        answer += probe.remark(estimate)
        return True, (f"{probe.subject} {answer}, {estimate.runs} runs{self._used}{against}; recording: {bag}")

    @property
    def _used(self) -> str:
        """With which calibration, as part of an answer."""
        return f"; calibration: {self._calibration}" if self._calibration else " (robot not calibrated)"

    def _identify(self, job: Job, bag: Path, options: ReplayOptions, publish: Callable[[Estimate], None]) -> Estimate:
        """The estimate from a bag: published, then written beside it with a report."""
        self._tell(job.kind, "identifying")
        estimate = replay([bag], options)
        publish(estimate)
        command = replay_command(bag, options)
        sources = [str(path) for path in (bag, *options.baseline)]
        self._keep(lambda: keep_result(bag, estimate, command))
        self._keep(lambda: write_report(estimate, bag.parent / "report.html", command=command, sources=sources))
        return estimate

    # --- weighing while the arm works ---------------------------------------------------------------------------------

    def _prepare_weighing(self) -> None:
        """Keep what weigh needs, and begin to estimate where that is asked for, if the calibration is one of motions."""
        self._kept = None
        self._running: Callable[..., RunningWeight] | None = None
        robot = robot_of(None if self._calibration else self.values["robot"], self._calibration)
        if robot.motion_calibration is None:
            if self.values["running"]:
                self.say("warning", f"the running estimate is off: {_NO_MOTIONS}")
            return
        self._kept = deque()
        if self.values["running"]:
            facts = self._setting(probe_named("payload"), None).facts.payload
            std = float(np.max(facts.com_std)) or CENTRE_STD_M
            make = partial(RunningWeight, robot, robot.motion_calibration, centre_m=facts.com, centre_std_m=std)
            make()  # so that a calibration of another arm is refused now
            others = [name for name in robot.model.independent_joints if name not in robot.motion_calibration.joints]
            self._running, self._others = make, others
            self._per_current = {n: drive.nominal_effort_per_current for n, drive in robot.drive_trains.items()}
            self._hand = self.values["frame_prefix"] + robot.payload_frame
            self._centre = [float(axis) for axis in facts.com]

    def _may_skip(self, role: str) -> bool:
        """Whether only the newest message of a topic matters now."""
        return self._job is None and (self._kept is None or role != "joint_states")

    def _takes_all(self, role: str) -> bool:
        """Whether all that waits of a topic is taken at one wake-up; not where the time of hearing it counts."""
        return self._job is None or role == "joint_states"

    def _measured_unit(self) -> str:
        """What the effort of the joint states is: as stated, or N m where our driver publishes it; empty: nobody says."""
        stated = str(self.values["effort_unit"])
        if stated or time.monotonic() - self._effort_at_s > STALE_S:
            return stated
        # an effort that the excitation node gives an effort controller of somebody else's says nothing of what that driver measures
        return "N.m" if self.count_publishers(self.resolve_topic_name("applied_current")) else ""

    def _weigh(self, job: Job) -> tuple[bool, str]:
        """Weigh by the motion of the last seconds, from a bag, as `proprio replay` would."""
        seconds = self.values["weigh_seconds"]
        if self._kept is None:
            raise JobError(f"not weighed: {_NO_MOTIONS}")
        unit = self._measured_unit()
        if unit in ("", "raw"):
            raise JobError(
                "not weighed: nothing says what the effort of the joint states is; give the parameter effort_unit"
            )
        if time.monotonic() - self._state_at_s > STALE_S:
            raise JobError("not weighed: no joint states are coming; start the driver and check its bus")
        kept = list(self._kept)
        if not self._moved(kept):
            raise JobError(f"not weighed: no joint moved in the last {seconds:g} s; weigh while the arm works")
        setting = self._setting(probe_named("payload"), None)
        options = replace(setting.options, effort_unit=unit)
        session = Session(self._data, WEIGH)
        for message in kept:
            session.add(*message)
        bag, warning = session.save()
        if warning:
            self.say("warning", warning)
        try:
            estimate = self._identify(job, bag, options, partial(self._publish, setting))
        except RecordingError as error:
            raise JobError(f"not weighed: {error}; recording: {bag}") from error
        answer = _interval_of(estimate)
        said = f"the last {seconds:g} s{self._used}; recording: {bag}"
        return (True, f"payload {answer}, {said}") if answer else (False, f"{_refusal_of(estimate)}; {said}")

    def _moved(self, kept: list[RawMessage]) -> bool:
        """Whether any joint of the robot moved in these joint states."""
        least: dict[str, float] = {}
        most: dict[str, float] = {}
        for raw in kept:
            message = deserialize_message(raw.data, JointState)
            for name, position in zip(message.name, message.position, strict=False):
                if math.isfinite(position):
                    least[name], most[name] = (
                        min(position, least.get(name, position)),
                        max(position, most.get(name, position)),
                    )
        return any(most[name] - low > MOVED_RAD for name, low in least.items() if name.encode() in self._joints)

    def _weigh_all_the_time(self, make: Callable[..., RunningWeight]) -> None:
        """The running estimate: in a thread of its own while the node is active."""
        try:
            self._weigh_on(make)
        except Exception as error:  # a defect must be reported, and must not take the services along
            self._arrived = None
            self.say(
                "error", f"the running estimate has ended ({type(error).__name__}: {error}); activate the node again"
            )

    def _weigh_on(self, make: Callable[..., RunningWeight]) -> None:
        """Take what arrived, and publish what it says."""
        arrived = self._arrived
        latest: dict[str, tuple[float, float]] = {}
        published_s = -math.inf
        running: RunningWeight | None = None
        with threadpool_limits(1, user_api="blas"):
            while arrived is not None and arrived is self._arrived:
                if not arrived:
                    time.sleep(0.02)
                    continue
                now_ns, data = arrived.popleft()
                message = deserialize_message(data, JointState)
                unit = self._measured_unit()
                if unit in ("", "raw") or not message.effort:
                    continue
                for name, position, effort in zip(message.name, message.position, message.effort, strict=False):
                    if name in self._per_current:
                        latest[name] = position, _current_A(effort, unit, self._per_current[name])
                if running is None:
                    heard = dict(zip(message.name, message.position, strict=False))
                    running = make(held={name: heard[name] for name in self._others if name in heard})
                if running.joints[0] not in message.name or any(name not in latest for name in running.joints):
                    continue
                time_s = 1e-9 * (messages.time_ns(message.header.stamp) or now_ns)
                rows = [latest[name] for name in running.joints]
                if running.add(time_s, [row[0] for row in rows], [row[1] for row in rows]) and self._job is None:
                    estimate = running.estimate()
                    if estimate is not None and time.monotonic() - published_s >= 0.8 * RUNNING_PERIOD_S:
                        published_s = time.monotonic()
                        behind_s = 1e-9 * (self.get_clock().now().nanoseconds - now_ns)
                        self._publish_running(estimate, behind_s)

    def _publish_running(self, estimate: RunningEstimate, behind_s: float) -> None:
        mass, (low, high) = estimate.mass_kg, estimate.ci95_kg
        entries: dict[str, Any] = {
            "probe": "payload", "running": True, "final": False, "changed": estimate.changed,
            "seconds_since_change": estimate.time_s - estimate.since_s, "seconds_of_motion": estimate.motion_s,
            "seconds_at_rest": 0.0 if estimate.resting_since_s is None else estimate.time_s - estimate.resting_since_s,
            "seconds_behind": behind_s,
            "payload_mass": mass if estimate.known else "not determined", "payload_mass.unit": "kg",
            "payload_mass.std": estimate.std_kg, "payload_mass.ci95": [low, high], "calibration": str(self._calibration or "none"),
        }  # fmt: skip
        words = shown("kg", mass, Z95 * estimate.std_kg, spec=spec_for("kg", estimate.std_kg), between=" +- ")
        words = f"changed just now: {words}" if estimate.changed else words
        self._publish_estimate("ok", "payload", f"running: {words}", entries)
        if not estimate.known:
            return self._withdraw()
        now, held = self.get_clock().now().nanoseconds, max(mass, 0.0)
        self._numbers["mass"].publish(messages.number(held))
        self._standing["mass"] = partial(self._numbers["mass"].publish, messages.number(math.nan))
        self._payload.publish(messages.inertia(now, self._hand, Carried(held, self._centre, np.full((3, 3), math.nan))))
        self._standing["payload"] = partial(self._withdraw_payload, self._hand)
        return None

    def _record_baseline(self, job: Job, probe: Probe[Any]) -> tuple[bool, str]:
        """The hand without what is to be identified: kept for later jobs, and identified, to see that nothing is in it."""
        baseline = probe.baseline
        assert baseline is not None
        setting = self._setting(probe, None)
        self._live = None
        self._tell(job.kind, baseline.hand)
        bag = self._record(job, job.kind, value_of(self, f"{probe.name}_sequence"), setting.robot, setting.options)
        options = baseline_options(setting)
        estimate = self._identify(job, bag, options, partial(self._publish_final, name=job.kind))
        if estimate.verdict is Verdict.REJECTED or estimate.fit is None:
            return False, f"not kept: {_refusal_of(estimate)}{self._used}; {baseline.question} recording: {bag}"
        self._keep_as_newest(self._newest_baseline(probe), bag)
        answer = _interval_of(estimate) or f"a mass that is not determined ({'; '.join(estimate.reasons)})"
        return True, f"{baseline.noun} {answer}, {estimate.runs} runs{self._used}; kept as the baseline: {bag}"

    def _about_baseline(self, bag: Path) -> str:
        """How old a baseline is, and whether that is a reason to record it again."""
        made_s = bag.stat().st_mtime
        age_s = max(time.time() - made_s, 0.0)
        age = f"baseline {_duration(age_s)} old: {bag}"
        if self._calibration is not None and self._calibration.stat().st_mtime > made_s:
            return f"{age} (older than the robot's calibration: record it again if the arm has changed between)"
        return f"{age} (record it again if anything has changed since)" if age_s > OLD_S else age

    def _calibrate(self, job: Job) -> tuple[bool, str]:
        self._live = None
        options = ReplayOptions(robot=self.values["robot"], **self._topics)
        robot = robot_of(options.robot, None)
        bag = self._record(job, "robot", value_of(self, "robot_sequence"), robot, options)
        references: dict[str | Path, float] = {}
        mass = float(value_of(self, "reference_mass"))
        if mass > 0.0:
            wait_s = float(value_of(self, "reference_wait"))
            self._tell(job.kind, f"put the reference object of {mass:g} kg into the hand: going on in {wait_s:g} s")
            if job.cancelled.wait(wait_s):
                raise JobError(f"cancelled before the reference was weighed; recording: {bag}")
            reference = self._record(job, "reference", value_of(self, "reference_sequence"), robot, options)
            references[reference] = mass
        self._tell(job.kind, "identifying the robot")
        output = bag.parent / "calibration.yaml"
        options = replace(options, settings=parse_settings(value_of(self, "reference_settings")))
        # the folder is this session's own
        estimate = calibrate_from_bags(
            [bag], references, options, output, lambda text: self._tell(job.kind, text), force=True
        )
        self._publish_calibration(estimate, output)
        sources = [str(path) for path in (bag, *references)]
        self._keep(lambda: write_calibration_report(estimate, bag.parent / "report.html", sources=sources))
        if estimate.verdict is not Verdict.ACCEPTED:
            return False, f"{estimate.verdict.value}: {'; '.join(estimate.reasons)}; recording: {bag}"
        self._calibration = output
        self._keep_as_newest(self._newest_calibration(), output)
        return True, f"robot calibrated on {len(estimate.run_fits)} of {estimate.runs} runs; calibration: {output}"

    def _keep(self, write: Callable[[], None]) -> None:
        """Write something beside the recording; a full disk costs the page, not the result."""
        if self.values["report"]:
            try:
                write()
            except ProprioError as error:
                self.say("warning", str(error))

    def _record(self, job: Job, kind: str, sequence: str, robot: Robot, options: ReplayOptions) -> Path:
        """Have a sequence made, listen to it, and keep what came; the bag is written however it ends."""
        self._catch_up()
        session = Session(self._data, kind)
        try:
            session.open()
            self._check_input(session.folder, robot, options)
        except RecordingError as error:
            session.discard()
            raise JobError(f"not begun: {as_parameters(str(error))}") from error
        if self._live is not None:
            self._live.reset()
        for told in self._told_motors():
            session.add(*told)
        self._session = session
        failure = ""
        try:
            self._excite(job, sequence)
            self._await_tail()
        except JobError as error:
            failure = str(error)
        finally:
            self._session = None
        try:
            bag, warning = session.save()
        except RecordingError as error:
            if len(session):
                self._unsaved.append(session)
            raise JobError(f"{failure}; {error}" if failure else str(error)) from error
        if warning:
            self.say("warning", warning)
        if failure:
            raise JobError(f"{failure}; recording: {bag}")
        return bag

    def _check_input(self, folder: Path, robot: Robot, options: ReplayOptions) -> None:
        """Whether what comes in can be read, before anything moves.

        Raises:
            RecordingError: It cannot, or the folder cannot be written.
        """
        heard: list[RawMessage] = []
        self._heard = heard
        deadline = time.monotonic() + LONGEST_CHECK_S
        try:
            while True:
                time.sleep(CHECK_S)
                try:
                    notes = check_input(folder, [*heard, *self._told_motors()], robot, options)
                    break
                except RecordingError:
                    if time.monotonic() > deadline:
                        raise
        finally:
            self._heard = None
        for note in notes:
            self.say("info", note)
        if time.monotonic() - self._effort_at_s > STALE_S:
            self.say(
                "warning",
                "no applied_effort: the times at which a current began are those at which its command was heard",
            )

    def _catch_up(self) -> None:
        """Until joint states are heard as soon as ever, so that none from before becomes part of a recording."""
        deadline = time.monotonic() + LATEST_S
        while self._lag_ns - self._least_lag_ns > 1e9 * BEHIND_S:
            if time.monotonic() > deadline:  # a clock was set
                self._least_lag_ns = self._lag_ns
            time.sleep(0.02)

    def _await_tail(self) -> None:
        """Until everything has been heard that was measured up to now, and a little more."""
        now_ns = self.get_clock().now().nanoseconds - self._least_lag_ns
        time.sleep(TAIL_S)
        deadline = time.monotonic() + LATEST_S
        while self._state_stamp_ns < now_ns and time.monotonic() < min(deadline, self._state_at_s + SILENT_S):
            time.sleep(0.02)

    def _excite(self, job: Job, sequence: str) -> None:
        """Ask the excitation node for a sequence and wait until it has ended well.

        Raises:
            JobError: It was refused, aborted, cancelled, or the node fell silent.
        """
        named = RosParameter("probe", RosParameter.Type.STRING, sequence).to_parameter_msg()
        results = self._call(self._set_probe, SetParameters.Request(parameters=[named])).results
        if not results or not results[0].successful:
            raise JobError(f"the excitation node refuses {sequence!r}: {results[0].reason if results else 'no answer'}")
        begun = asked = time.monotonic()
        answer = self._call(self._run, Trigger.Request())
        while not answer.success and time.monotonic() - begun < READY_S:
            if job.cancelled.wait(0.2):
                raise JobError("cancelled")
            # where its status says that no joint states reached it: a pause of the bus, over in a second, and nothing has moved
            if self._unfed_at_s < asked:
                break
            asked = time.monotonic()
            answer = self._call(self._run, Trigger.Request())
        if not answer.success:
            raise JobError(f"the excitation node refuses: {answer.message}")
        number = answer.message.split(":")[0].removeprefix("sequence ")
        self._asking = True
        self._renew_lease()
        live = threading.Thread(target=self._estimate_live, args=(job,), name="live estimate", daemon=True)
        live.start()
        try:
            while True:
                if job.cancelled.wait(0.02):
                    self._stop_excitation(number)
                    raise JobError("cancelled")
                values, heard_s = self._excitation, max(self._excitation_at_s, begun)
                if values.get("sequence") == number and values.get("busy") == "false":
                    break
                if time.monotonic() - heard_s > SILENT_S:
                    raise JobError("the excitation node has fallen silent: the driver holds the arm; restart the node")
        finally:
            self._driven = self._asking = False
            self._lease.publish(Bool(data=False))
        if values.get("phase") == "aborted":
            raise JobError(f"the probe was aborted: {values.get('reason')}")

    def _stop_excitation(self, number: str) -> None:
        """Abort a sequence and see it end; when this node is ending itself, nobody is left to hear the answer."""
        self._abort.call_async(Trigger.Request())
        deadline = time.monotonic() + ABORT_S
        while not self._closing and time.monotonic() < deadline:
            if self._excitation.get("sequence") == number and self._excitation.get("busy") == "false":
                return
            time.sleep(0.01)

    def _call(self, client: Any, request: Any) -> Any:
        """Call a service and wait for its answer, at most `CALL_S`."""
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(CALL_S):
            client.remove_pending_request(future)
            raise JobError(f"{client.srv_name} does not answer: is the excitation node running?")
        return future.result()

    # --- results ------------------------------------------------------------------------------------------------------

    def _estimate_live(self, job: Job) -> None:
        """What has come so far, again and again while a joint is driven."""
        live, period_s = self._live, self.values["live_period"]
        if live is None or period_s <= 0.0:
            return
        published_samples = 0
        name, unit = probe_named(job.kind).answer
        while self._session is not None and not job.cancelled.is_set():
            if not self._driven:
                time.sleep(0.005)
                continue
            estimate = live.estimate()
            known = None if estimate is None else live_interval(estimate)
            if known is not None and estimate is not None:
                value, std = known
                samples = sum(len(run.times_s) for run in estimate.run_fits)
                if samples <= published_samples:  # a fast end of a run may be left out
                    continue
                published_samples = samples
                entries = {
                    "probe": estimate.probe, "final": False, "samples": samples, name: value, f"{name}.unit": unit,
                    f"{name}.std": std, f"{name}.ci95": [value - Z95 * std, value + Z95 * std],
                    "calibration": str(self._calibration or "none"),
                }  # fmt: skip
                words = shown(unit, value, Z95 * std, spec=spec_for(unit, std), between=" +- ")
                self._publish_estimate("ok", estimate.probe, f"live, {samples} samples: {words}", entries)
            time.sleep(period_s)

    def _publish_estimate(self, level: str, name: str, message: str, entries: dict[str, Any]) -> None:
        now = self.get_clock().now().nanoseconds
        self._estimate.publish(messages.diagnostics(now, [messages.status(level, name, message, entries)]))

    def _withdraw(self) -> None:
        """What was published of the hand says nothing about what is in it now; `~/estimate`, which has a stamp, stands."""
        while self._standing:
            _, withdraw = self._standing.popitem()
            withdraw()

    def _publish_failure(self, job: Job) -> None:
        """That there is no estimate, and why, in the place of the last."""
        entries: dict[str, Any] = {"probe": job.kind, "final": True, "verdict": "failed", "reason.1": job.message}
        kind = "payload" if job.kind == WEIGH else job.kind
        if kind in (probe.name for probe in all_probes()):
            entries[probe_named(kind).answer[0]] = "not determined"
        entries["calibration"] = str(self._calibration or "none")
        self._publish_estimate("error", job.kind, job.message, entries)

    def _publish_final(self, estimate: Estimate, name: str) -> None:
        accepted = estimate.verdict is Verdict.ACCEPTED
        entries = {**as_diagnostics(estimate), "final": True, "calibration": str(self._calibration or "none")}
        entries |= {f"reason.{number}": reason for number, reason in enumerate(estimate.reasons, start=1)}
        words = "; ".join(estimate.reasons) or estimate.verdict.value
        self._concluded = True
        self._publish_estimate("ok" if accepted else "warning", name, words, entries)

    def _publish(self, setting: Setting, estimate: Estimate) -> None:
        """The answer, and where it is accepted its numbers and the load it stands for; how it looks, in amber if it is too wide."""
        self._publish_final(estimate, estimate.probe)
        value = estimate.values[0]
        if (
            estimate.verdict not in (Verdict.ACCEPTED, Verdict.TOO_WIDE)
            or not isinstance(value.value, float)
            or not isinstance(value.std, float)
        ):
            return
        probe, robot, facts = setting.probe, setting.robot, setting.facts
        now, frame = self.get_clock().now().nanoseconds, self.values["frame_prefix"] + robot.payload_frame
        accepted = estimate.verdict is Verdict.ACCEPTED
        values = {entry.name: entry.value for entry in estimate.values if isinstance(entry.value, float)}
        for topic, name in probe.numbers.items() if accepted else ():
            if name in values:
                publisher = self._numbers[topic]
                publisher.publish(messages.number(values[name]))
                self._standing[topic] = partial(publisher.publish, messages.number(math.nan))
        carried = probe.carried(robot, facts, estimate) if accepted else None
        if carried is not None:
            self._payload.publish(messages.inertia(now, frame, carried))
            self._standing["payload"] = partial(self._withdraw_payload, frame)
        shapes = probe.shapes(robot, facts, estimate)
        if shapes is not None:
            self._markers.publish(messages.markers(now, frame, shapes, value.value, value.std, value.unit, accepted))
            self._standing["markers"] = partial(self._markers.publish, messages.no_markers())

    def _withdraw_payload(self, frame: str) -> None:
        now = self.get_clock().now().nanoseconds
        self._payload.publish(messages.inertia(now, frame, messages.UNKNOWN_LOAD))

    def _publish_calibration(self, estimate: CalibrationEstimate, output: Path) -> None:
        entries: dict[str, Any] = {
            "probe": "robot",
            "final": True,
            "verdict": estimate.verdict.value,
            "runs": estimate.runs,
        }
        for row in estimate.unknowns:
            if not row.is_detail:
                entries |= {row.name: row.value, f"{row.name}.unit": row.unit, f"{row.name}.std": row.std}
        entries |= {f"reason.{number}": reason for number, reason in enumerate(estimate.reasons, start=1)}
        accepted = estimate.verdict is Verdict.ACCEPTED
        entries["calibration"] = str(output if accepted else self._calibration or "none")
        words = "; ".join(estimate.reasons) or estimate.verdict.value
        self._concluded = True
        self._publish_estimate("ok" if accepted else "warning", "robot", words, entries)

    def _tell(self, doing: str, message: str, entries: dict[str, Any] | None = None, level: str = "ok") -> None:
        values = {"doing": doing, "calibration": str(self._calibration or "none"), **(entries or {})}
        self._status.publish(messages.status(level, "identifier", message, values))

    def _tell_and_log(self, doing: str, message: str) -> None:
        self.say("info", message)
        self._tell(doing, message)

    def _save_again(self) -> None:
        """Recordings that could be written nowhere are tried again until they are on disk."""
        for session in list(self._unsaved):
            try:
                bag, _ = session.save()
            except RecordingError as error:
                self.get_logger().error(f"{session.name}: {error}", throttle_duration_sec=60.0)
                continue
            self._unsaved.remove(session)
            self.say("info", f"the recording of {session.name} is saved now: {bag}")


def _type_of(kind: type) -> str:
    """Such as ``sensor_msgs/msg/JointState``."""
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def _interval_of(estimate: Estimate) -> str:
    """The first value in words; empty where it is not determined."""
    value = estimate.values[0]
    if estimate.verdict is not Verdict.ACCEPTED or not isinstance(value.value, float) or value.ci95 is None:
        return ""
    spec = spec_for(value.unit, value.std if isinstance(value.std, float) else None)
    return f"{shown(value.unit, value.value, spec=spec)}, 95 % interval {shown(value.unit, *value.ci95, spec=spec)}"


def _current_A(effort: float, unit: str, effort_per_current: float) -> float:
    """What flows in a motor by the effort of a joint state."""
    return {"A": 1.0, "mA": 1e-3}.get(unit, 1.0 / effort_per_current) * effort


def _refusal_of(estimate: Estimate) -> str:
    return f"{estimate.verdict.value}: {'; '.join(estimate.reasons) or estimate.values[0].reason}"


def _duration(seconds: float) -> str:
    """In the largest unit of which there are two or more."""
    for unit, size_s in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size_s:
            return f"{seconds / size_s:.0f} {unit}"
    return f"{seconds:.0f} s"


def main() -> int:
    """Entry point of `proprio_identifier`."""
    # the solver's many short calls hand the interpreter's lock over; at the default of 5 ms it would wait for it most of the time
    sys.setswitchinterval(0.0005)
    os.nice(5)  # the servo loop comes first: its stamps are what everything here rests on
    return run_node(IdentifierNode)


if __name__ == "__main__":
    raise SystemExit(main())
