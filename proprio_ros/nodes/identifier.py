"""The identifier node: asks for a probe, listens, keeps the recording, says what it tells.

A job has a thread of its own, so that neither the arm's motion nor the identification ever blocks the executor; a second thread
weighs what has come so far while a payload is probed (not a sphere: where it rolls shows only when a run is over; nor a block,
which takes several runs). The recording is written before anything is identified, and what is identified is the recording, by the
function that `proprio replay` calls.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import InertiaStamped
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter as RosParameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from proprio_ros.calibrate import calibrate_from_bags
from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.identification.container_problem import ContainerFacts
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.nodes import messages
from proprio_ros.nodes.parameters import ROBOT, Parameter, value_of
from proprio_ros.nodes.runtime import LATCHED, STREAM, Answer, LongService, ManagedNode, run_node
from proprio_ros.quantity import Z95, shown
from proprio_ros.replay import ReplayOptions, replay
from proprio_ros.report import write_calibration_report, write_report
from proprio_ros.robot import Robot
from proprio_ros.session import (
    LiveWeighing,
    Session,
    as_diagnostics,
    block_rotation,
    block_setting,
    check_settings,
    container_setting,
    empty_container_options,
    inertia_tensor,
    keep_result,
    largest_squeeze,
    live_interval,
    prepare_container,
    prepare_identification,
    prepare_squeeze,
    replay_command,
    settings_for,
)
from proprio_ros.settings import parse_settings

if TYPE_CHECKING:
    from proprio_ros.identification.squeeze_problem import BlockFacts

STALE_S = 0.5
READY_S = 4.0
SILENT_S = 3.0
"""The excitation node tells its state ten times a second while it is busy; without a word for so long it is gone."""
CALL_S = 5.0
ABORT_S = 2.0
TAIL_S = 0.3
"""Joint states after the last run that belong to the recording."""
OLD_S = 86400.0
"""A baseline from another day is doubted: nobody remembers what was changed since."""
_SERVICES = {
    "robot": "calibrate_robot",
    "payload": "calibrate_payload",
    "container": "calibrate_container",
    "container_baseline": "record_container_baseline",
    "softness": "calibrate_softness",
}


class JobError(ProprioError):
    """Why a job ended without a result, in one sentence."""


@dataclass
class Job:
    """One service call that is being worked on."""

    kind: str
    cancelled: threading.Event = field(default_factory=threading.Event)
    ended: threading.Event = field(default_factory=threading.Event)
    success: bool = False
    message: str = ""
    on_end: list[Callable[[], None]] = field(default_factory=list)

    @property
    def service(self) -> str:
        return _SERVICES[self.kind]


class IdentifierNode(ManagedNode):
    """Services in, results out."""

    parameters = (
        ROBOT,
        Parameter("calibration", "", "Calibration file; empty: the newest of this robot in data_directory; none: without."),
        Parameter("data_directory", "~/.ros/proprio_ros", "Where recordings, results and calibrations are kept."),
        Parameter("settings", [], "What is known about the object, as with --set: payload.size=0.03, sphere.radius=0.01.",
                  dynamic=True),
        Parameter("robot_sequence", "empty_hand", "Probe sequence of calibrate_robot."),
        Parameter("payload_sequence", "payload", "Probe sequence of calibrate_payload."),
        Parameter("container_sequence", "container",
                  "Probe sequence of calibrate_container and record_container_baseline."),
        Parameter("container_baseline", "",
                  "Bag of the empty container; empty: what record_container_baseline kept last; none: without.", dynamic=True),
        Parameter("softness_sequence", "softness", "Probe sequence of calibrate_softness.", dynamic=True),
        Parameter("largest_squeeze", 0.4,
                  "A softness_sequence that may squeeze the block further, as a share of its length, is refused.", 0.01, 0.95,
                  dynamic=True),
        Parameter("reference_sequence", "reference", "Probe sequence of calibrate_robot with the reference object."),
        Parameter("reference_mass", 0.0, "Mass of a weighed object for calibrate_robot [kg]; 0: none.", 0.0, 5.0, dynamic=True),
        Parameter("reference_settings", [], "The same about the reference object.", dynamic=True),
        Parameter("reference_wait", 10.0, "Time to put the reference object into the hand [s].", 0.0, 600.0, dynamic=True),
        Parameter("excitation_node", "excitation", "Name of the excitation node."),
        Parameter("report", True, "Write the result and an HTML report beside every recording."),
        Parameter("live_period", 0.03, "Pause between live estimates of a payload [s]; 0 turns them off.", 0.0, 10.0),
    )  # fmt: skip

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("identifier", **kwargs)
        self._job: Job | None = None
        self._job_lock = threading.Lock()
        self._closing = False
        self._session: Session | None = None
        self._unsaved: list[Session] = []
        self._live: LiveWeighing | None = None
        self._driven = False
        self._state_at_s = -1e9
        self._excitation: dict[str, str] = {}
        self._excitation_at_s = -1e9

    # --- lifecycle ----------------------------------------------------------------------------------------------------

    def configure(self) -> None:
        self._data = Path(self.values["data_directory"]).expanduser()
        self._calibration = self._find_calibration()
        started = time.monotonic()
        prepare_identification()  # kernels are compiled here, and never inside a probe
        check_settings(replace(self._options("payload"), settings=parse_settings(value_of(self, "settings"))))
        self._live = LiveWeighing(self._options("payload"))
        self.say("info", f"ready after {time.monotonic() - started:.1f} s; calibration: {self._calibration or 'none'}")

        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._estimate = self.create_publisher(DiagnosticArray, "~/estimate", LATCHED)
        self._payload = self.create_publisher(InertiaStamped, "~/payload", LATCHED)
        self._markers = self.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._numbers = {
            name: self.create_publisher(Float64, f"~/{name}", LATCHED)
            for name in ("mass", "lame_mu", "lame_lambda", "youngs_modulus")
        }
        # bytes as they came over the wire: that is what goes into the bag
        for topic, kind in (
            ("joint_states", JointState), ("applied_effort", JointState), ("applied_current", Float64MultiArray),
        ):  # fmt: skip
            listener = self._listener(self.resolve_topic_name(topic), topic, kind)
            self.create_subscription(kind, topic, listener, STREAM, raw=True)
        name = self.values["excitation_node"]
        self.create_subscription(DiagnosticStatus, f"{name}/status", self._on_excitation, LATCHED)
        self._set_probe = self.create_client(SetParameters, f"{name}/set_parameters")
        self._run = self.create_client(Trigger, f"{name}/run")
        self._abort = self.create_client(Trigger, f"{name}/abort")
        for kind_, service in _SERVICES.items():
            LongService(self, f"~/{service}", partial(self._begin, kind_))
        LongService(self, "~/cancel", self._cancel)
        self.every(5.0, self._save_again)
        self.add_on_set_parameters_callback(self._on_parameters)

    def activate(self) -> None:
        self._closing = False
        self._tell("idle", "ready")

    def deactivate(self) -> None:
        self._closing = True
        job = self._job
        if job is not None:
            job.cancelled.set()
            job.ended.wait(CALL_S)
        self._save_again()

    def _on_parameters(self, parameters: list[RosParameter]) -> SetParametersResult:
        """Facts that cannot be understood are refused when they are stated, with the reason."""
        for parameter in parameters:
            if parameter.name in ("settings", "reference_settings"):
                try:
                    facts = parse_settings([pair for pair in parameter.value if pair])
                    options = ReplayOptions(robot=self.values["robot"], settings=facts)
                    check_settings(options) if parameter.name == "settings" else LiveWeighing(options)
                except ProprioError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _find_calibration(self) -> Path | None:
        stated = self.values["calibration"]
        if stated == "none":
            return None
        path = Path(stated).expanduser() if stated else self._newest_calibration()
        # the file behind the link stays what it is, so that a result can be had again
        return path.resolve() if stated or path.exists() else None

    def _newest_calibration(self) -> Path:
        return self._data / f"{Path(self.values['robot']).stem}_calibration.yaml"

    def _newest_baseline(self) -> Path:
        return self._data / f"{Path(self.values['robot']).stem}_container_baseline"

    def _find_baseline(self) -> Path | None:
        """The recording of the empty container, if there is one.

        Raises:
            JobError: One was named that is not there.
        """
        stated = value_of(self, "container_baseline")
        if stated == "none":
            return None
        path = Path(stated).expanduser() if stated else self._newest_baseline()
        if stated and not path.exists():
            raise JobError(f"container_baseline {path}: there is no such recording; name a bag, or leave it empty")
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

    def _options(self, probe: str) -> ReplayOptions:
        return ReplayOptions(
            probe=probe,
            robot=None if self._calibration else self.values["robot"],
            settings=settings_for(probe, parse_settings(value_of(self, "settings"))),
            calibration=self._calibration,
        )

    # --- what comes in ------------------------------------------------------------------------------------------------

    def _listener(self, full_name: str, topic: str, kind: type) -> Callable[[bytes], None]:
        msgtype = "sensor_msgs/msg/JointState" if kind is JointState else "std_msgs/msg/Float64MultiArray"

        def listen(data: bytes) -> None:
            if topic == "joint_states":
                self._state_at_s = time.monotonic()
            session = self._session
            if session is None:
                return
            session.add(full_name, msgtype, self.get_clock().now().nanoseconds, bytes(data))
            live = self._live
            if live is not None and kind is JointState:
                message = deserialize_message(data, JointState)
                stamp = messages.time_ns(message.header.stamp)
                if topic == "joint_states":
                    live.add_state(stamp, message.name, message.position)
                else:
                    live.add_input(stamp, message.name, message.effort)
                    self._driven = any(message.effort)

        return listen

    def _on_excitation(self, message: DiagnosticStatus) -> None:
        self._excitation = messages.values_of(message)
        self._excitation_at_s = time.monotonic()
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
        self._job = job = Job(kind)
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
        try:
            self._await_others()
            works = {
                "robot": self._calibrate, "payload": self._weigh, "container": self._find_sphere,
                "container_baseline": self._record_baseline, "softness": self._squeeze,
            }  # fmt: skip
            job.success, job.message = works[job.kind](job)
            level = "ok" if job.success else "warning"
        except ProprioError as error:
            job.message = str(error)
        except Exception as error:  # a defect must be told, and must not leave the services busy for ever
            job.message = f"a defect in the identification ({type(error).__name__}: {error}); the recording is kept"
            self.get_logger().error(job.message)
        finally:
            self._session = None
            with self._job_lock:
                self._job = None
            self.say("info" if job.success else "warning", job.message)
            if self.active:
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
            elif self._excitation.get("joint_states") != "true":
                missing = f"no joint states reach {self.values['excitation_node']}; are the topics named alike?"
            else:
                return
            if time.monotonic() > deadline:
                raise JobError(f"not ready: {missing}")
            time.sleep(0.05)

    def _weigh(self, job: Job) -> tuple[bool, str]:
        options = self._options("payload")
        self._live = LiveWeighing(options) if self.values["live_period"] > 0.0 else None
        bag = self._record(job, "payload", value_of(self, "payload_sequence"))
        estimate = self._identify(job, bag, options, self._publish)
        told = _interval_of(estimate)
        if not told:
            return False, f"{_refusal_of(estimate)}; recording: {bag}"
        return True, f"payload {told}, {estimate.runs} runs{self._uncalibrated}; recording: {bag}"

    @property
    def _uncalibrated(self) -> str:
        return "" if self._calibration else " (robot not calibrated)"

    def _identify(self, job: Job, bag: Path, options: ReplayOptions, publish: Callable[[Estimate], None]) -> Estimate:
        """What a bag tells: published, then written beside it with a report."""
        self._tell(job.kind, "identifying")
        estimate = replay([bag], options)
        publish(estimate)
        command = replay_command(bag, options)
        sources = [str(path) for path in (bag, *options.baseline)]
        self._keep(lambda: keep_result(bag, estimate, command))
        self._keep(lambda: write_report(estimate, bag.parent / "report.html", command=command, sources=sources))
        return estimate

    def _record_baseline(self, job: Job) -> tuple[bool, str]:
        """The container without its sphere: kept for whatever will roll in it, and weighed, to see that it is empty."""
        options = self._options("container")
        _, facts = container_setting(options)
        self._live = None
        self._tell(job.kind, "the container has to be in the hand without its sphere")
        bag = self._record(job, job.kind, value_of(self, "container_sequence"))
        weighing = empty_container_options(options, facts)
        estimate = self._identify(job, bag, weighing, partial(self._publish_final, name=job.kind))
        if estimate.verdict is Verdict.REJECTED or estimate.fit is None:
            return False, f"not kept: {_refusal_of(estimate)}; is the container empty? recording: {bag}"
        self._keep_as_newest(self._newest_baseline(), bag)
        told = _interval_of(estimate) or f"an untold mass ({'; '.join(estimate.reasons)})"
        return True, f"empty container {told}, {estimate.runs} runs{self._uncalibrated}; kept as the baseline: {bag}"

    def _find_sphere(self, job: Job) -> tuple[bool, str]:
        baseline = self._find_baseline()
        options = replace(self._options("container"), baseline=() if baseline is None else (baseline,))
        robot, facts = container_setting(options)
        if baseline is None and math.isinf(facts.mass_std):
            raise JobError(
                "the empty container has not been recorded: put it into the hand without its sphere and call "
                "~/record_container_baseline, or tell its mass (settings: container.mass=KG)"
            )
        self._prepare(
            job, "a sphere: once on a computer it is compiled, half a minute", lambda: prepare_container(options)
        )
        self._tell(job.kind, "the container has to be in the hand with its sphere")
        bag = self._record(job, job.kind, value_of(self, "container_sequence"))
        estimate = self._identify(job, bag, options, partial(self._publish_sphere, robot=robot, facts=facts))
        against = "" if baseline is None else f"; {self._about_baseline(baseline)}"
        told = _interval_of(estimate)
        if not told:
            return False, f"{_refusal_of(estimate)}{against}; recording: {bag}"
        return True, f"sphere {told}, {estimate.runs} runs{self._uncalibrated}{against}; recording: {bag}"

    def _squeeze(self, job: Job) -> tuple[bool, str]:
        options = self._options("softness")
        robot, facts = block_setting(options)
        joint = self._squeezing_joint(robot, facts)
        self._prepare(job, "a block: a shape is tabulated once, up to half a minute", lambda: prepare_squeeze(options))
        self._tell(job.kind, "the block has to be between the fingers")
        bag = self._record(job, job.kind, value_of(self, "softness_sequence"))
        estimate = self._identify(
            job, bag, options, partial(self._publish_block, robot=robot, facts=facts, joint=joint)
        )
        told = _interval_of(estimate)
        if not told:
            return False, f"{_refusal_of(estimate)}; recording: {bag}"
        ratio = estimate.value("poissons_ratio")
        if isinstance(ratio.value, float) and isinstance(ratio.std, float):
            told += f", Poisson's ratio {ratio.value:.2f} +- {Z95 * ratio.std:.2f}"
        else:
            told += ", Poisson's ratio not told"
        return True, f"block {told}, {estimate.runs} runs{self._uncalibrated}; recording: {bag}"

    def _squeezing_joint(self, robot: Robot, facts: BlockFacts) -> str:
        """The joint that softness_sequence drives.

        Raises:
            JobError: That slides no finger, or could crush the block.
        """
        sequence = load_sequence(value_of(self, "softness_sequence"), robot)
        joint, *others = {run.joint for run in sequence.runs}
        if others or robot.model.joint(joint).kind != "prismatic":
            raise JobError(
                f"{sequence.name} drives {', '.join([joint, *others])}: squeeze with a joint that slides a finger"
            )
        limit = float(value_of(self, "largest_squeeze"))
        squeeze = largest_squeeze(robot, joint, max(run.max_travel for run in sequence.runs), facts)
        if squeeze > limit:
            raise JobError(
                f"{sequence.name} may squeeze a block of {1e3 * facts.length:g} mm by {100.0 * squeeze:.0f} %, more than "
                f"largest_squeeze={limit:g}: state its size (settings: block.size=[x,y,z]), lower max_travel in the sequence, or "
                "raise largest_squeeze"
            )
        return joint

    def _prepare(self, job: Job, what: str, prepare: Callable[[], None]) -> None:
        """Have a simulation ready before anything moves.

        Raises:
            JobError: Cancelled meanwhile.
        """
        self._live = None
        self._tell(job.kind, f"preparing the simulation of {what}")
        prepare()
        if job.cancelled.is_set():
            raise JobError("cancelled")

    def _about_baseline(self, bag: Path) -> str:
        """How old the recording of the empty container is, and whether that is a reason to doubt it."""
        made_s = bag.stat().st_mtime
        age_s = max(time.time() - made_s, 0.0)
        told = f"baseline {_duration(age_s)} old: {bag}"
        if self._calibration is not None and self._calibration.stat().st_mtime > made_s:
            return f"{told} (older than the robot's calibration: record it again if the arm has changed between)"
        return f"{told} (record it again if anything has changed since)" if age_s > OLD_S else told

    def _calibrate(self, job: Job) -> tuple[bool, str]:
        self._live = None
        bag = self._record(job, "robot", value_of(self, "robot_sequence"))
        references: dict[str | Path, float] = {}
        mass = float(value_of(self, "reference_mass"))
        if mass > 0.0:
            wait_s = float(value_of(self, "reference_wait"))
            self._tell(job.kind, f"put the reference object of {mass:g} kg into the hand: going on in {wait_s:g} s")
            if job.cancelled.wait(wait_s):
                raise JobError(f"cancelled before the reference was weighed; recording: {bag}")
            references[self._record(job, "reference", value_of(self, "reference_sequence"))] = mass
        self._tell(job.kind, "identifying the robot")
        output = bag.parent / "calibration.yaml"
        facts = parse_settings(value_of(self, "reference_settings"))
        options = ReplayOptions(robot=self.values["robot"], settings=facts)
        estimate = calibrate_from_bags([bag], references, options, output, lambda text: self._tell(job.kind, text))
        self._publish_calibration(estimate)
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

    def _record(self, job: Job, kind: str, sequence: str) -> Path:
        """Have a sequence made, listen to it, and keep what came; the bag is written however it ends."""
        session = Session(self._data, kind)
        if self._live is not None:
            self._live.reset()
        self._session = session
        failure = ""
        try:
            self._excite(job, sequence)
            time.sleep(TAIL_S)
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

    def _excite(self, job: Job, sequence: str) -> None:
        """Ask the excitation node for a sequence and wait until it has ended well.

        Raises:
            JobError: It was refused, aborted, cancelled, or the node fell silent.
        """
        named = RosParameter("probe", RosParameter.Type.STRING, sequence).to_parameter_msg()
        results = self._call(self._set_probe, SetParameters.Request(parameters=[named])).results
        if not results or not results[0].successful:
            raise JobError(f"the excitation node refuses {sequence!r}: {results[0].reason if results else 'no answer'}")
        begun = time.monotonic()
        answer = self._call(self._run, Trigger.Request())
        if not answer.success:
            raise JobError(f"the excitation node refuses: {answer.message}")
        number = answer.message.split(":")[0].removeprefix("sequence ")
        live = threading.Thread(target=self._weigh_live, args=(job,), name="live estimate", daemon=True)
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
            self._driven = False
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

    def _weigh_live(self, job: Job) -> None:
        """What has come so far, again and again while a joint is driven."""
        live, period_s = self._live, self.values["live_period"]
        if live is None or period_s <= 0.0:
            return
        told_samples = 0
        while self._session is not None and not job.cancelled.is_set():
            if not self._driven:
                time.sleep(0.005)
                continue
            estimate = live.estimate()
            known = None if estimate is None else live_interval(estimate)
            if known is not None and estimate is not None:
                mass, std = known
                samples = sum(len(run.times_s) for run in estimate.run_fits)
                if samples <= told_samples:  # a fast end of a run may be left out
                    continue
                told_samples = samples
                told = {
                    "probe": "payload", "final": False, "samples": samples, "payload_mass": mass, "payload_mass.unit": "kg",
                    "payload_mass.std": std, "payload_mass.ci95": [mass - Z95 * std, mass + Z95 * std],
                }  # fmt: skip
                self._publish_estimate(
                    "ok",
                    "payload",
                    f"live, {samples} samples: {shown('kg', mass, Z95 * std, spec='.1f', between=' +- ')}",
                    told,
                )
            time.sleep(period_s)

    def _publish_estimate(self, level: str, name: str, message: str, told: dict[str, Any]) -> None:
        now = self.get_clock().now().nanoseconds
        self._estimate.publish(messages.diagnostics(now, [messages.status(level, name, message, told)]))

    def _publish_final(self, estimate: Estimate, name: str) -> None:
        accepted = estimate.verdict is Verdict.ACCEPTED
        told = {**as_diagnostics(estimate), "final": True, "calibration": str(self._calibration or "none")}
        told |= {f"reason.{number}": reason for number, reason in enumerate(estimate.reasons, start=1)}
        words = "; ".join(estimate.reasons) or estimate.verdict.value
        self._publish_estimate("ok" if accepted else "warning", name, words, told)

    def _publish(self, estimate: Estimate) -> None:
        self._publish_final(estimate, estimate.probe)
        value = estimate.values[0]
        live = self._live or LiveWeighing(self._options("payload"))
        if (
            estimate.verdict is not Verdict.ACCEPTED
            or not isinstance(value.value, float)
            or not isinstance(value.std, float)
        ):
            return
        now, frame = self.get_clock().now().nanoseconds, live.robot.payload_frame
        com = next((entry.value for entry in estimate.values if entry.name == "payload_com"), None)
        centre = [float(v) for v in (com if isinstance(com, list) and None not in com else live.facts.com)]  # type: ignore[arg-type]
        tensor = inertia_tensor(live.facts, value.value)
        self._payload.publish(messages.inertia(now, frame, value.value, centre, tensor))
        self._numbers["mass"].publish(messages.number(value.value))
        self._markers.publish(messages.payload_markers(now, frame, centre, value.value, value.std))

    def _publish_sphere(self, estimate: Estimate, robot: Robot, facts: ContainerFacts) -> None:
        """All but `~/payload`: something that rolls has no fixed centre of mass, and is no payload to whoever listens there."""
        self._publish_final(estimate, estimate.probe)
        sphere, enclosure = estimate.values[0], facts.enclosure
        if estimate.verdict is not Verdict.ACCEPTED or not isinstance(sphere.value, float):
            return
        assert isinstance(sphere.std, float)
        self._numbers["mass"].publish(messages.number(sphere.value))
        self._markers.publish(
            messages.container_markers(
                self.get_clock().now().nanoseconds, robot.payload_frame, facts.centre.tolist(), facts.rotation,
                enclosure.shape, enclosure.inner_size.tolist(), enclosure.radius, sphere.value, sphere.std,
            )
        )  # fmt: skip

    def _publish_block(self, estimate: Estimate, robot: Robot, facts: BlockFacts, joint: str) -> None:
        self._publish_final(estimate, estimate.probe)
        modulus = estimate.values[0]
        if estimate.verdict is not Verdict.ACCEPTED or not isinstance(modulus.value, float):
            return
        assert isinstance(modulus.std, float)
        for value in estimate.values:
            if value.name in self._numbers and isinstance(value.value, float):
                self._numbers[value.name].publish(messages.number(value.value))
        self._markers.publish(
            messages.block_markers(
                self.get_clock().now().nanoseconds, robot.payload_frame, block_rotation(robot, joint), facts.size.tolist(),
                modulus.value, modulus.std,
            )
        )  # fmt: skip

    def _publish_calibration(self, estimate: CalibrationEstimate) -> None:
        told: dict[str, Any] = {
            "probe": "robot",
            "final": True,
            "verdict": estimate.verdict.value,
            "runs": estimate.runs,
        }
        for row in estimate.unknowns:
            if not row.is_detail:
                told |= {row.name: row.value, f"{row.name}.unit": row.unit, f"{row.name}.std": row.std}
        told |= {f"reason.{number}": reason for number, reason in enumerate(estimate.reasons, start=1)}
        accepted = estimate.verdict is Verdict.ACCEPTED
        words = "; ".join(estimate.reasons) or estimate.verdict.value
        self._publish_estimate("ok" if accepted else "warning", "robot", words, told)

    def _tell(self, doing: str, message: str, told: dict[str, Any] | None = None, level: str = "ok") -> None:
        values = {"doing": doing, "calibration": str(self._calibration or "none"), **(told or {})}
        self._status.publish(messages.status(level, "identifier", message, values))

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


def _interval_of(estimate: Estimate) -> str:
    """The first value in words; empty where it is not told."""
    value = estimate.values[0]
    if estimate.verdict is not Verdict.ACCEPTED or not isinstance(value.value, float) or value.ci95 is None:
        return ""
    number, interval = shown(value.unit, value.value, spec=".1f"), shown(value.unit, *value.ci95, spec=".1f")
    return f"{number}, 95 % interval {interval}"


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
