"""The identifier node: asks for a probe, listens, keeps the recording, publishes the estimate.

A job has a thread of its own, so that neither the arm's motion nor the identification ever blocks the executor; a second thread
estimates from what has come so far, where the probe can (a sphere cannot: where it rolls shows only when a run is over). The
recording is written before anything is identified, and what is identified is the recording, by the function that `proprio replay`
calls. Which probes there are, the registry says.

`inputs` is what comes in, `excitation_client` who moves the arm, `results` what goes out, `jobs` and `weighing` what is done
between, and `running` the estimate while the arm works.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import String

from proprio_ros import clock, progress
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.inputs.settings import parse_settings
from proprio_ros.live.deadlines import CANCELLED_S, LOOK_S
from proprio_ros.live.job import WEIGH, Job, JobError
from proprio_ros.live.session import (
    Session,
    as_parameters,
    check_settings,
    prepare_identification,
    recover,
)
from proprio_ros.live.workspace import Workspace
from proprio_ros.nodes.carrying import Carrying
from proprio_ros.nodes.excitation_client import CALL_S, Excitation
from proprio_ros.nodes.inputs import Inputs
from proprio_ros.nodes.interface import jobs
from proprio_ros.nodes.jobs import Jobs
from proprio_ros.nodes.managed_node import IDLE_PAUSE_S, ManagedNode
from proprio_ros.nodes.numeric import ACTION, WeighAction
from proprio_ros.nodes.parameters import value_of
from proprio_ros.nodes.payload_export import HandingOn
from proprio_ros.nodes.process import run_node
from proprio_ros.nodes.qos import LATCHED
from proprio_ros.nodes.results import Results
from proprio_ros.nodes.services import Answer, LongService, once, within
from proprio_ros.nodes.tables import IDENTIFIER
from proprio_ros.nodes.weighing import Weighing
from proprio_ros.probes import all_probes
from proprio_ros.probes.base import HasBaseline
from proprio_ros.robot import LiveDescription
from proprio_ros.robot.live_description import is_topic, topic_of


class IdentifierNode(ManagedNode):
    """Services in, results out.

    Attributes:
        inputs: What comes in.
        workspace: Calibration, baselines, and where recordings are kept.
        results: What is published.
        excitation: The excitation node, as this one sees it.
        weighing: What is done with the motion of an arm at work.
        jobs: All that the services can ask for.
    """

    parameters = IDENTIFIER

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("identifier", **kwargs)
        self._asked = {each.parameter: each.key for probe in all_probes() for each in probe.asked}
        self._baselines = {
            f"{probe.name}_baseline": probe
            for probe in all_probes()
            if isinstance(probe, HasBaseline)
        }
        self._sequences = {
            each.name: each.default for each in self.parameters if each.name.endswith("_sequence")
        }
        self._job: Job | None = None
        self._answer: Answer = lambda success, message: None  # of the job
        self._progress: tuple[str, ...] = ()  # of the excitation node
        self._job_lock = clock.lock()
        self._unsaved: list[Session] = []

    def _busy(self) -> bool:
        return self._job is not None

    @property
    def pause_s(self) -> float:
        return 0.0 if self._busy() else IDLE_PAUSE_S

    def configure(self) -> None:
        # two arms on one network must not take each other's calibration for their own
        data = Path(self.values["data_directory"]).expanduser() / self.get_namespace().strip("/")
        recovered, problems = recover(data)
        for bag in recovered:
            self.say(
                "warning", f"a recording that was cut off when this node was killed is kept: {bag}"
            )
        for problem in problems:
            self.say("error", problem)
        self.inputs = Inputs(self, self._busy)
        self.workspace = Workspace(
            data,
            self.values["robot"],
            self.inputs.stated_topics(),
        )
        workspace = self.workspace
        self.results = Results(self, workspace)
        results = self.results
        carrying = Carrying(self, self.inputs, results)

        def silent() -> bool:
            return self._busy() or bool(self._missing())

        self.weighing = Weighing(
            self,
            workspace,
            self.inputs,
            results,
            carrying,
            silent,
        )
        self.excitation = Excitation(self, self._on_progress)
        self.jobs = Jobs(
            self, workspace, self.inputs, self.excitation, results, self.weighing, self._unsaved
        )
        self._prepared = False
        self._described: LiveDescription | None = None
        if is_topic(self.values["robot"]):
            topic = topic_of(self.values["robot"])
            self._described = described = LiveDescription(self.resolve_topic_name(topic), data)
            self.create_subscription(
                String, topic, partial(self._on_description, described), LATCHED
            )
            results.tell_and_log("starting", described.problem)
        else:
            self._prepare()
        # last: whoever waits for a service then waits for the kernels as well
        self._service_of = jobs()
        for kind, service in self._service_of.items():
            LongService(self, f"~/{service}", partial(self._begin, kind))
        LongService(self, "~/cancel", self._cancel)
        LongService(self, "~/apply", HandingOn(self, results).apply)
        self._action = WeighAction(self, self._begin_job, self._check_job)
        results.hear = self._action.hear
        self.every(5.0, self.jobs.save_again)
        self.every(LOOK_S, self._look_after_job)
        self.add_on_set_parameters_callback(self._on_parameters)

    def _prepare(self) -> None:
        """All that needs the robot."""
        workspace = self.workspace
        stated = parse_settings(value_of(self, "settings"))
        warning = workspace.find_calibration(self.values["calibration"])
        if warning:
            self.say("warning", warning)
        for name, default in self._sequences.items():
            if value_of(self, name) != default:  # not every robot can make every default
                self._check_sequence(name, value_of(self, name))
        started = clock.now()
        with progress.listening(partial(self.results.tell_and_log, "starting")):
            # kernels are compiled here, and never inside a probe
            prepare_identification(replace(workspace.options(), settings=stated))
        for settings in (stated, parse_settings(value_of(self, "reference_settings"))):
            check_settings(replace(workspace.options(), settings=settings))
        self.inputs.open(self.weighing.prepare().drive_trains)
        self._prepared = True
        self.say(
            "info",
            f"ready after {clock.now() - started:.1f} s; calibration: {workspace.calibration or 'none'}",
        )

    def _on_description(self, described: LiveDescription, message: String) -> None:
        """The robot, where its description is a topic; the first that can be used counts."""
        severity, sentence = described.hear(message.data)
        if described.path is not None and not self._prepared:
            self.workspace.robot = str(described.path)
            try:
                self._prepare()
            except ProprioError as error:
                severity, sentence = described.refuse(as_parameters(str(error)))
            else:
                self.say(severity, sentence)
                if self.active:
                    self._start()
                return
        if described.problem:
            self.results.withdraw()
        if sentence:
            self.say(severity, sentence)
            job = self._job
            level = "ok" if severity == "info" else "warning"
            doing = job.kind if job is not None else "idle" if self._prepared else "starting"
            self.results.tell(doing, sentence, level=level)

    def _missing(self) -> str:
        """Why nothing can be done for want of a robot, or an empty string."""
        return "" if self._described is None else self._described.problem

    def activate(self) -> None:
        self.excitation.closing = False
        if self._prepared:
            self._start()

    def _start(self) -> None:
        """Be there for others."""
        self.hear_before_others()
        missing = self._missing()
        running = self.weighing.begin()
        if running:
            self.say("info", running)
        ready = "ready" + f"; {running}" * bool(running)
        self.results.tell(
            "idle",
            missing or ready,
            level="warning" if missing else "ok",
        )

    def cleanup(self) -> None:
        self._action.destroy()

    def deactivate(self) -> None:
        self.excitation.closing = True
        self.weighing.end()
        job = self._job
        if job is not None:
            job.cancelled.set()
            job.ended.wait(CALL_S)
        self.jobs.save_again()

    def _on_parameters(self, parameters: list[RosParameter]) -> SetParametersResult:
        """Facts that cannot be understood, and sequences that cannot be made, are refused when they are stated, with the reason."""
        if not self._prepared:  # without a robot nobody knows; they are looked at when it comes
            return SetParametersResult(successful=True)
        try:
            for parameter in parameters:
                if parameter.name in ("settings", "reference_settings"):
                    facts = parse_settings([pair for pair in parameter.value if pair])
                    check_settings(replace(self.workspace.options(), settings=facts))
                elif parameter.name in self._asked:
                    value = str(parameter.value).strip()
                    facts = parse_settings(
                        [f"{self._asked[parameter.name]}={value}"] if value else []
                    )
                    check_settings(replace(self.workspace.options(), settings=facts))
                elif parameter.name in self._baselines:
                    probe = self._baselines[parameter.name]
                    self.workspace.find_baseline(probe, str(parameter.value))
                elif parameter.name in self._sequences:
                    self._check_sequence(parameter.name, str(parameter.value))
        except ProprioError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _check_sequence(self, parameter: str, name: str) -> None:
        try:
            load_sequence(name, self.workspace.configured({}))
        except ProprioError as error:
            raise ConfigurationError(f"{parameter}: {error}") from error

    def _on_progress(self, words: str, values: dict[str, str]) -> None:
        """The excitation node is busy."""
        job = self._job
        if job is not None:
            entries = {key: values.get(key, "") for key in ("fraction", "phase")}
            self.results.tell(job.kind, words, entries)
            steps = ("sequence", "phase", "run", "attempt", "fraction")
            progress = tuple(values.get(key, "") for key in steps)
            if progress != self._progress:
                self._progress = progress
                job.progress.go_on()

    def _look_after_job(self) -> None:
        """Say what it waits for; one that gets no further for too long is answered, and cancelled."""
        job = self._job
        if job is None or job.given_up:
            return
        why = job.progress.overdue()
        if not why:
            words = job.progress.still()
            if words:
                self.results.tell(job.kind, words)
            return
        job.message = job.given_up = f"{job.service} is {why}; it is cancelled, and the arm held"
        job.cancelled.set()
        self.say("error", job.message)
        self.results.failure(job)
        job.entries = self.results.entries
        self.results.tell(job.kind, job.message, level="error")
        self._answer(False, job.message)

    def _refused(self) -> str:
        """Why no job can be begun now, or an empty string."""
        if not self.active:
            return "the identifier node is not active"
        missing = self._missing()
        if missing:
            return f"not ready: {missing}"
        job = self._job
        if job is None:
            return ""
        if job.given_up:
            waits = job.progress.stage.waits_for
            return f"busy: {job.service} was given up, and still waits for {waits}: wait, or restart this node"
        return f"busy: {job.service} is under way; wait for it, or call ~/cancel"

    def _check_job(self, job: Job) -> None:
        """Whether a job could be begun now.

        Raises:
            JobError: This node is not ready, or busy.
            ProprioError: Its facts or its sequence cannot be understood.
        """
        why = self._refused()
        if why:
            raise JobError(why)
        facts = {**parse_settings(value_of(self, "settings")), **parse_settings(job.settings)}
        check_settings(replace(self.workspace.options(), settings=facts))
        if job.kind != WEIGH:
            job.plan(value_of(self, f"{job.kind}_sequence"), self.workspace.configured({}))

    def _begin(self, kind: str, answer: Answer) -> None:
        self._begin_job(Job(kind, self._service_of[kind]), answer)

    def _begin_job(self, job: Job, answer: Answer) -> None:
        """Begin a job, or answer why there can be none now."""
        why = self._refused()
        if why:
            return answer(False, why)
        self._answer = once(answer)
        job.progress.go_on()
        self._job = job
        clock.thread(
            target=self._work, args=(job, self._answer), name=f"calibrate {job.kind}"
        ).start()
        return None

    def _cancel(self, answer: Answer) -> None:
        with self._job_lock:
            job = self._job
            if job is None:
                return answer(True, "nothing was under way")
            answer = within(self, CANCELLED_S, answer, lambda: _not_ended(job))
            job.on_end.append(lambda: answer(True, f"{job.service} was cancelled; the arm is held"))
        if job.service != ACTION or not self._action.cancel():
            job.cancelled.set()
        return None

    def _work(self, job: Job, answer: Answer) -> None:
        """A job, in its thread: however it ends, it is answered."""
        if not self.hears_first:
            clock.come_after_others()
        level = "error"
        self.results.concluded = False
        try:
            self.results.withdraw()
            job.success, job.message = self.jobs.make(job)
            level = "ok" if job.success else "warning"
        except ProprioError as error:
            job.message = str(error)
        except Exception as error:
            # a defect must be reported, and must not leave the services busy for ever
            job.message = f"a defect in the identification ({type(error).__name__}: {error}); the recording is kept"
            self.get_logger().error(job.message)
        finally:
            self.inputs.session = None
            with self._job_lock:
                self._job = None
            self.say("info" if job.success else "warning", job.message)
            if self.active:
                if not job.success and not self.results.concluded and not job.given_up:
                    self.results.failure(job)
                job.entries = self.results.entries
                self.results.tell("idle", job.message, level=level)
            job.ended.set()
            answer(job.success, job.message)
            for tell in job.on_end:
                tell()


def _not_ended(job: Job) -> str:
    waits = job.progress.stage.waits_for
    return f"{job.service} is cancelled, and has not ended within {CANCELLED_S:g} s: it waits for {waits}"


def main() -> int:
    """Entry point of `proprio_identifier`."""
    return run_node(IdentifierNode)


if __name__ == "__main__":
    raise SystemExit(main())
