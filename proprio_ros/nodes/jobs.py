"""The work behind the identifier's services: sequences are asked for, recorded and identified. It runs in the thread of a job.

The recording is written before anything is identified, and what is identified is the recording, by the function that `proprio
replay` calls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from proprio_ros import clock, progress
from proprio_ros.errors import ProprioError, RecordingError
from proprio_ros.excitation.plans import ExcitationSequence, as_text, load_sequence
from proprio_ros.experiment_design.choosing import Chooser, Decision
from proprio_ros.experiment_design.until import chosen_known, chosen_refresh
from proprio_ros.identification.calibration_estimate import CalibrationEstimate
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.inputs.settings import parse_settings
from proprio_ros.live.answers import interval_of, limited_by, live_answer, refusal_of
from proprio_ros.live.deadlines import (
    CHECKING,
    CHOOSING,
    HANDLING,
    IDENTIFYING,
    MOVING,
    PREPARING,
    SAVING,
)
from proprio_ros.live.job import REFRESH, ROBOT, WEIGH, Job, JobError
from proprio_ros.live.session import (
    LiveEstimate,
    Session,
    as_parameters,
    baseline_options,
    baseline_runs,
    check_input,
    keep_result,
    replay_command,
)
from proprio_ros.live.workspace import Workspace
from proprio_ros.nodes.excitation_client import READY_S, SEEN_S, Excitation
from proprio_ros.nodes.inputs import Inputs
from proprio_ros.nodes.managed_node import ManagedNode
from proprio_ros.nodes.parameters import value_of
from proprio_ros.nodes.results import Results
from proprio_ros.nodes.weighing import Weighing
from proprio_ros.pipeline.calibrate import calibrate_from_bags, refresh_from_bags
from proprio_ros.pipeline.replay import aged_robot, replay, write_report
from proprio_ros.pipeline.request import Options, Request, robot_of
from proprio_ros.probes import all_probes, probe_named
from proprio_ros.probes.base import (
    EstimatesLive,
    Guards,
    HasBaseline,
    Prepares,
    Probe,
    Shown,
    chooser_of,
)
from proprio_ros.quantity import shown
from proprio_ros.recordings.messages import RawMessage
from proprio_ros.records import Run
from proprio_ros.report import write_calibration_report
from proprio_ros.report.choices_page import Choice, write_choices
from proprio_ros.schema import reason_codes

CHECK_S = 0.3
LONGEST_CHECK_S = 2.0
"""What comes in is listened to for so long before a probe; longer where it cannot be read yet."""
# all pushes of a refresh take so long at most; what they leave open a whole calibration has to learn
REFRESH_S = 30.0
# a run has ended when the excitation node says so; what was measured of it may still be on its way
HEARD_S = 1.0
PAUSED = "stale"  # what ends a sequence whose joint states do not come
REPEATED_AT_MOST = 3  # sequences of a job
SPOILS = "paused"  # the reason where they came, with a pause in a push
AT_AN_END = ("limit", "clearance")
AT_AN_END_TRIES = 2
"""Where the arm ends when the object is heavier than was thought: it sags, or the current does not hold it. So often another push
is chosen then."""


def _choice(decision: Decision) -> Choice:
    """As its page shows it."""
    words = [
        f"{push.words}: {decision.said_of(push)} in {push.time_s:.1f} s" for push in decision.others
    ]
    chosen = decision.reason if decision.push is None else decision.push.words
    return Choice(
        decision.value, decision.half, decision.promised, chosen, words, decision.decided_s
    )


def _paused(estimate: Estimate) -> bool:
    """Whether nothing explains the runs, and joint states paused in one: that says nothing of the object."""
    rejected = estimate.verdict is Verdict.REJECTED
    return rejected and SPOILS in reason_codes(estimate.reasons)


@dataclass(frozen=True)
class _Task:
    """An object that is to be identified, and how."""

    probe: Probe[Any]
    request: Request
    baseline: Path | None  # recording of the hand without the object
    sequence: str  # as the excitation node takes it
    plan: ExcitationSequence  # the same, read


class Jobs:
    """All that the services can ask for; ``unsaved`` are recordings that could be written nowhere so far."""

    def __init__(
        self,
        node: ManagedNode,
        workspace: Workspace,
        inputs: Inputs,
        excitation: Excitation,
        results: Results,
        weighing: Weighing,
        unsaved: list[Session],
    ) -> None:
        self._node = node
        self._workspace = workspace
        self._inputs = inputs
        self._excitation = excitation
        self._results = results
        self._weighing = weighing
        self._unsaved = unsaved

    def _value(self, name: str) -> Any:
        return value_of(self._node, name)

    def _teller(self, job: Job) -> Callable[[str], None]:
        """What says how far a job is."""

        def tell(words: str) -> None:
            job.progress.go_on()
            self._results.tell(job.kind, words)

        return tell

    def make(self, job: Job) -> tuple[bool, str]:
        """Whether a job succeeded, and what there is to say; raises ProprioError where it ended without a result."""
        if job.kind == WEIGH:
            return self._weighing.weigh(job, self.identify)
        self.await_others(job)
        if job.kind == ROBOT:
            return self._calibrate(job)
        if job.kind == REFRESH:
            return self._refresh(job)
        for probe in all_probes():
            if isinstance(probe, HasBaseline) and job.kind == f"{probe.name}_baseline":
                return self._record_baseline(job, probe)
        return self._identify_object(job, probe_named(job.kind))

    def await_others(self, job: Job) -> None:
        """Driver and excitation may have come up a moment ago; raises JobError where one is not there, or the job is cancelled."""
        deadline = max(clock.now() + READY_S, self._node.begun_s + SEEN_S)
        while True:
            missing = "no joint states are coming; start the driver and check its bus"
            if self._inputs.has_states:
                missing = self._excitation.missing() or self._inputs.missing()
            if not missing:
                return
            if clock.now() > deadline:
                raise JobError(f"not ready: {missing}")
            if job.cancelled.wait(0.05):
                raise JobError("cancelled")

    def _identify_object(self, job: Job, probe: Probe[Any]) -> tuple[bool, str]:
        """Have the runs of a probe made, and identify the object from them."""
        task = self._task(job, probe)
        self._say_what_is_guessed(task)
        self._prepare(job, task)
        bag, estimate = self._pushed(job, task)
        while _paused(estimate) and self._may_repeat(job):
            self._say_again(job, f"{refusal_of(estimate)}; recording: {bag}")
            bag, estimate = self._pushed(job, task)
        by = f"; {job.reason}" if job.reason else ""
        if job.decisions and job.decisions[-1].ended_by == "worth":
            limit = limited_by(estimate)
            by += f"; {limit}" if limit else ""
        by += self._workspace.used
        if task.baseline is not None:
            by += f"; {self._workspace.about_baseline(task.baseline)}"
        answer = interval_of(estimate)
        if not answer:
            return False, f"{refusal_of(estimate)}{by}; recording: {bag}"
        if isinstance(probe, Shown):
            answer += probe.remark(estimate)
        return True, f"{probe.subject} {answer}, {estimate.runs} runs{by}; recording: {bag}"

    def _pushed(self, job: Job, task: _Task) -> tuple[Path, Estimate]:
        """Have the runs of an object made once, and identify it: the recording, and what it says."""
        request = task.request
        probe = task.probe
        until = task.plan.until
        chooser = None
        if until is not None:
            self._results.tell(job.kind, "simulating what could be pushed")
            runs = baseline_runs(request)
            chooser = chooser_of(
                probe,
                request.robot,
                request.facts,
                task.plan,
                runs,
            )
            job.decisions.clear()
            job.reason = ""
        if probe.hand:
            self._results.tell(job.kind, probe.hand)
        bag = self.record(
            job,
            job.kind,
            task.sequence,
            request,
            chooser,
        )

        def publish(estimate: Estimate) -> None:
            if not (_paused(estimate) and self._may_repeat(job)):
                self._results.publish(request, estimate)

        try:
            estimate = self.identify(job, bag, request.options, publish)
        except RecordingError as error:
            raise JobError(f"{job.reason or error}; recording: {bag}") from error
        if chooser is not None and until is not None:
            sought = chooser.sought
            choices = list(map(_choice, job.decisions))
            self._keep(
                lambda: write_choices(
                    choices, sought, until.half_interval, bag.parent / "choices.html"
                )
            )
        return bag, estimate

    def _task(self, job: Job, probe: Probe[Any]) -> _Task:
        """What is to be pushed and identified.

        Raises:
            ProprioError: It is refused: a baseline is missing, or the object could break.
        """
        baseline = None
        if isinstance(probe, HasBaseline):
            baseline = self._workspace.find_baseline(probe, self._value(f"{probe.name}_baseline"))
        stated = {
            **self._asked(probe),
            **parse_settings(self._value("settings")),
            **parse_settings(job.settings),
        }
        request = self._workspace.request(probe, stated, baseline)
        request = replace(request, robot=aged_robot(request.robot, self._inputs.moment()))
        self._results.link = request.robot.payload_frame
        if baseline is None and isinstance(probe, HasBaseline):
            if probe.needs_baseline(request.facts):
                missing = f"the {probe.baseline.noun} has not been recorded"
                raise JobError(f"{missing}: {probe.baseline.missing}")
        sequence = job.sequence or self._value(f"{probe.name}_sequence")
        plan = job.plan(sequence, request.robot)
        if isinstance(probe, Guards):
            limits = {limit.name: float(self._value(limit.name)) for limit in probe.limits}
            probe.check(request.robot, request.facts, plan, limits)
        return _Task(probe, request, baseline, sequence, plan)

    def _asked(self, probe: Probe[Any]) -> dict[str, Any]:
        """Facts that a probe asks for by parameters of their own, where they are stated."""
        values = {each.key: str(self._value(each.parameter)).strip() for each in probe.asked}
        return parse_settings([f"{key}={value}" for key, value in values.items() if value])

    def _say_what_is_guessed(self, task: _Task) -> None:
        """Before the arm moves: the user may know."""
        for each in task.probe.asked:
            if each.key not in task.request.options.settings:
                self._node.say("warning", f"parameter {each.parameter} is empty. {each.about}")

    def _prepare(self, job: Job, task: _Task) -> None:
        """Compile what the identification needs, before anything moves."""
        probe = task.probe
        request = task.request
        job.progress.enter(PREPARING)
        goes_along = isinstance(probe, EstimatesLive) and self._node.values["live_period"] > 0.0
        live = task.plan.until is not None or goes_along
        self._inputs.live = LiveEstimate(request) if live else None
        if isinstance(probe, Prepares):
            self._results.tell(job.kind, f"preparing the simulation of {probe.prepares}")
        prepare = probe.prepare if isinstance(probe, Prepares) else probe.compile
        with progress.listening(partial(self._results.tell_and_log, job.kind)):
            prepare(request.robot, request.facts)
        job.check_wanted()
        if job.cancelled.is_set():
            raise JobError("cancelled")

    def _record_baseline(
        self,
        job: Job,
        probe: HasBaseline[Any],
    ) -> tuple[bool, str]:
        """The hand without what is to be identified: kept for later jobs, and identified, to see that nothing is in it."""
        baseline = probe.baseline
        used = self._workspace.used
        request = self._workspace.request(
            probe,
            parse_settings(self._value("settings")),
            None,
        )
        self._inputs.live = None
        self._results.link = request.robot.payload_frame
        self._results.tell(job.kind, baseline.hand)
        sequence = self._value(f"{probe.name}_sequence")
        plan = load_sequence(sequence, request.robot)
        if plan.until is not None:  # there is nothing that pushes could be chosen for
            sequence = as_text(replace(plan, until=None)) if plan.runs else probe.default_sequence
        bag = self.record(job, job.kind, sequence, request)
        options = baseline_options(request)
        estimate = self.identify(
            job,
            bag,
            options,
            partial(self._results.final, name=job.kind),
        )
        if estimate.verdict is Verdict.REJECTED or estimate.fit is None:
            return (
                False,
                f"not kept: {refusal_of(estimate)}{used}; {baseline.question} recording: {bag}",
            )
        self._workspace.keep_baseline(probe, bag)
        answer = (
            interval_of(estimate)
            or f"a mass that is not determined ({'; '.join(estimate.reasons)})"
        )
        return (
            True,
            f"{baseline.noun} {answer}, {estimate.runs} runs{used}; kept as the baseline; recording: {bag}",
        )

    def _calibrate(self, job: Job) -> tuple[bool, str]:
        """The robot, with an empty hand and perhaps a weighed object."""
        self._inputs.live = None
        tell = self._teller(job)
        options = replace(
            self._workspace.options(),
            robot=self._workspace.robot,
            calibration=None,
        )
        request = Request(robot_of(options), options)
        sequence = self._value("robot_sequence")
        bag = self.record(job, ROBOT, sequence, request)
        empty: list[str | Path] = [bag]
        references: dict[str | Path, float] = {}
        chosen = self._chosen(job, sequence, request, empty, references, 0.0)
        if chosen:
            empty.append(self.record(job, ROBOT, chosen, request))
        mass = float(self._value("reference_mass"))
        if mass > 0.0:
            wait_s = float(self._value("reference_wait"))
            job.progress.enter(HANDLING, wait_s)
            tell(f"put the reference object of {mass:g} kg into the hand: going on in {wait_s:g} s")
            if job.cancelled.wait(wait_s):
                raise JobError(f"cancelled before the reference was weighed; recording: {bag}")
            sequence = self._value("reference_sequence")
            if load_sequence(sequence, request.robot).runs:
                references[self.record(job, "reference", sequence, request)] = mass
            chosen = self._chosen(job, sequence, request, empty, references, mass)
            if chosen:
                references[self.record(job, "reference", chosen, request)] = mass
        job.progress.enter(IDENTIFYING)
        tell("identifying the robot")
        output = bag.parent / "calibration.yaml"
        options = replace(options, settings=parse_settings(self._value("reference_settings")))
        estimate = calibrate_from_bags(empty, references, options, output, tell, force=True)
        job.check_wanted()
        on = (
            f"{len(estimate.run_fits)} of {estimate.runs} runs"
            if estimate.run_fits
            else f"{estimate.runs} motions"
        )
        return self._calibrated(
            estimate, output, bag, (*empty, *references), f"robot calibrated on {on}"
        )

    def _refresh(self, job: Job) -> tuple[bool, str]:
        """The calibration in use, brought up to date by some chosen pushes with an empty hand."""
        used = self._workspace.calibration
        tell = self._teller(job)
        if used is None:
            raise JobError(
                "there is no calibration to bring up to date: call ~/calibrate_robot first"
            )
        self._inputs.live = None
        options = self._workspace.options()
        fresh = robot_of(options)
        learnt = fresh.calibration
        if learnt is None or not learnt.driven:
            raise JobError(
                f"{used} was not made of driven runs: call ~/calibrate_robot with robot_sequence empty_hand"
            )
        if learnt.made is None:
            words = "does not say when it was made, so nobody knows how old it is: call ~/calibrate_robot"
            raise JobError(f"{used} {words}")
        old = aged_robot(fresh, self._inputs.moment())
        if old is fresh:
            return (
                True,
                f"up to date: made less than ten minutes ago, or by another clock; calibration: {used}",
            )
        job.progress.enter(IDENTIFYING)
        tell("choosing the pushes that bring the calibration up to date")
        plan = load_sequence(self._value("robot_sequence"), fresh)
        runs, then, now = chosen_refresh(fresh, old, REFRESH_S, plan)
        worth = f"{shown('kg', then, spec='.2f')} when it was made, {shown('kg', now, spec='.2f')} by now"
        if not runs:
            return (
                True,
                f"up to date: a weighing of 30 g would be as sure as +-{worth}; calibration: {used}",
            )
        if job.cancelled.is_set():
            raise JobError("cancelled")
        sentence = (
            f"pushes with an empty hand: {len(runs)}; a weighing of 30 g was as sure as +-{worth}"
        )
        self._results.tell_and_log(job.kind, sentence)
        # after them the arm stays where it is
        chosen = as_text(
            replace(
                plan,
                runs=tuple(runs),
                until=None,
                home={},
            )
        )
        bag = self.record(
            job,
            job.kind,
            chosen,
            Request(fresh, options),
        )
        job.progress.enter(IDENTIFYING)
        tell("identifying what has changed")
        output = bag.parent / "calibration.yaml"
        try:
            estimate = refresh_from_bags(bag, options, output, tell, force=True)
        except ProprioError as error:
            raise JobError(f"{error}; recording: {bag}") from error
        sentence = (
            f"calibration brought up to date by {len(estimate.run_fits)} of {estimate.runs} runs"
        )
        job.check_wanted()
        return self._calibrated(estimate, output, bag, (bag,), sentence)

    def _calibrated(
        self,
        estimate: CalibrationEstimate,
        output: Path,
        bag: Path,
        sources: Sequence[str | Path],
        sentence: str,
    ) -> tuple[bool, str]:
        """A calibration is published, and takes the place of the one in use where it was accepted."""
        self._results.calibration(estimate, str(output))
        names = [str(path) for path in sources]
        self._keep(
            lambda: write_calibration_report(estimate, bag.parent / "report.html", sources=names)
        )
        if estimate.verdict is not Verdict.ACCEPTED:
            return (
                False,
                f"{estimate.verdict.value}: {'; '.join(estimate.reasons)}; recording: {bag}",
            )
        stays = self._workspace.keep_calibration(output)
        if not stays:
            self._weighing.prepare()
            self._weighing.begin()
        return True, f"{sentence}; calibration: {output}" + f"; {stays}" * bool(stays)

    def _chosen(
        self,
        job: Job,
        sequence: str,
        request: Request,
        empty: list[Any],
        references: dict[Any, float],
        mass_kg: float,
    ) -> str:
        """Pushes that a sequence with `until` wants beside its own: chosen by what was recorded so far; empty: none."""
        plan = load_sequence(sequence, request.robot)
        if plan.until is None:
            return ""
        job.progress.enter(IDENTIFYING)
        self._results.tell(job.kind, "choosing further pushes")
        stated = parse_settings(self._value("reference_settings") if references else [])
        so_far = calibrate_from_bags(empty, references, replace(request.options, settings=stated))
        if so_far.calibration is None or so_far.verdict is Verdict.REJECTED:
            return ""  # the whole calibration will say why
        known = request.robot.with_calibration(so_far.calibration)
        runs = chosen_known(
            known,
            mass_kg,
            plan.until.half_interval,
            plan.until.at_most_s,
            plan,
        )
        self._node.say(
            "info", f"{len(runs)} further pushes with {mass_kg:g} kg in the hand were chosen"
        )
        return as_text(replace(plan, runs=tuple(runs), until=None)) if runs else ""

    def identify(
        self,
        job: Job,
        bag: Path,
        options: Options,
        publish: Callable[[Estimate], None],
    ) -> Estimate:
        """Identify from a bag; the estimate is published, then written beside it with a report.

        Args:
            job: Under which it is done.
            bag: The recording.
            options: As of `proprio replay`.
            publish: Is called with the estimate.

        Returns:
            The estimate.
        """
        job.progress.enter(IDENTIFYING)
        self._results.tell(job.kind, "identifying")
        estimate = replay([bag], options)
        job.check_wanted()
        publish(estimate)
        command = replay_command(bag, options)
        sources = [str(path) for path in (bag, *options.baseline)]
        self._keep(lambda: keep_result(bag, estimate, command))
        self._keep(
            lambda: write_report(
                estimate, bag.parent / "report.html", command=command, sources=sources
            )
        )
        return estimate

    def _keep(self, write: Callable[[], None]) -> None:
        """Write something beside the recording; a full disk costs the page, not the result."""
        if self._node.values["report"]:
            try:
                write()
            except ProprioError as error:
                self._node.say("warning", str(error))

    def _estimate_live(self, job: Job) -> None:
        """What has come so far, again and again while a joint is driven."""
        inputs = self._inputs
        live = self._inputs.live
        period_s = self._node.values["live_period"]
        if live is None or period_s <= 0.0:
            return
        clock.come_after_others()
        published_samples = 0
        while inputs.session is not None and not job.cancelled.is_set():
            # what lets go of a joint and what catches it are no probes
            if not inputs.driven or inputs.swings:
                clock.sleep(0.005)
                continue
            estimate = live.estimate()
            answer = None if estimate is None else live_answer(estimate)
            if estimate is not None and answer is not None:
                samples, words, entries = answer
                if samples <= published_samples:  # a fast end of a run may be left out
                    continue
                published_samples = samples
                self._results.publish_estimate("ok", estimate.probe, words, entries)
            clock.sleep(period_s)

    def record(
        self,
        job: Job,
        kind: str,
        sequence: str,
        request: Request,
        chooser: Chooser | None = None,
    ) -> Path:
        """As `_record`; where a busy computer let joint states pause, which says nothing of the arm, once more.

        Args:
            job: Under which it is done.
            kind: Part of the recording's name.
            sequence: As the excitation node takes it.
            request: With which the recording will be identified.
            chooser: Chooses further pushes; None: there are none.

        Returns:
            The bag.

        Raises:
            JobError: The sequence did not end well, or the bag cannot be written.
        """
        try:
            return self._record(job, kind, sequence, request, chooser)
        except JobError as error:
            if error.aborted_by != PAUSED or not self._may_repeat(job):
                raise
            self._say_again(job, str(error))
            try:
                self.await_others(job)
            except JobError:
                raise error from None
        return self.record(job, kind, sequence, request, chooser)

    @staticmethod
    def _may_repeat(job: Job) -> bool:
        """Whether a sequence may be made once more: so often a busy computer is forgiven, and not for ever."""
        return job.repeated < REPEATED_AT_MOST and not job.cancelled.is_set()

    def _say_again(self, job: Job, why: str) -> None:
        """The arm moves once more, and who stands beside it knows why."""
        job.repeated += 1
        self._node.say("warning", f"{why}; the sequence is made once more")
        self._results.tell(job.kind, f"once more: {why}", level="warning")

    def _record(
        self,
        job: Job,
        kind: str,
        sequence: str,
        request: Request,
        chooser: Chooser | None,
    ) -> Path:
        """Have a sequence made, listen to it, and keep what came, as `record` does; the bag is written however it ends."""
        inputs = self._inputs
        job.progress.enter(CHECKING)
        inputs.catch_up()
        session = Session(self._workspace.data, kind)
        try:
            session.open()
            self._check_input(session.folder, request)
        except RecordingError as error:
            session.discard()
            raise JobError(f"not begun: {as_parameters(str(error))}") from error
        inputs.swings = False
        if inputs.live is not None:
            inputs.live.reset()
        for message in inputs.published_motors():
            session.add(*message)
        inputs.session = session
        failure = ""
        aborted_by = ""
        job.progress.enter(MOVING)
        try:
            self._excite(job, sequence, chooser)
            inputs.await_tail()
        except JobError as error:
            failure = str(error)
            aborted_by = error.aborted_by
        finally:
            inputs.session = None
        job.progress.enter(SAVING)
        try:
            bag, warning = session.save()
        except RecordingError as error:
            if len(session):
                self._unsaved.append(session)
            raise JobError(f"{failure}; {error}" if failure else str(error)) from error
        job.bag = str(bag)
        if warning:
            self._node.say("warning", warning)
        if failure:
            raise JobError(f"{failure}; recording: {bag}", aborted_by)
        return bag

    def _excite(
        self,
        job: Job,
        sequence: str,
        chooser: Chooser | None = None,
    ) -> None:
        """Have the arm moved, and estimate meanwhile."""
        estimate = partial(clock.thread, self._estimate_live, "live estimate", (job,))
        try:
            if chooser is None:
                self._excitation.make(
                    job,
                    sequence,
                    lambda: estimate().start(),
                )
            else:
                self._choose(job, sequence, chooser)
        finally:
            self._inputs.driven = False

    def _choose(self, job: Job, sequence: str, chooser: Chooser) -> None:
        """The sequence's own runs, then one push after the other as they are chosen.

        There is no estimate while a push is under way: with every run it would take longer, and deciding waits for it.
        """
        live = self._inputs.live
        began = clock.now()
        tries = AT_AN_END_TRIES
        assert live is not None
        runs: Sequence[Run] = ()
        if chooser.first_runs:
            self._excitation.make(job, sequence)
            runs = self._heard_runs(live, 0)
        self._await_position(live)
        while True:
            job.progress.enter(CHOOSING)
            with threadpool_limits(1, user_api="blas"), clock.urgently():
                decision = chooser.next(
                    runs,
                    live.position(),
                    clock.now() - began,
                )
            entries = {f"choice.{key}": value for key, value in decision.as_entries().items()}
            self._results.tell(job.kind, decision.reason, entries)
            self._node.say(
                "info", f"{decision.reason} (decided in {1e3 * decision.decided_s:.0f} ms)"
            )
            job.decisions.append(decision)
            self._results.choice(chooser.robot, decision, live.position())
            if decision.run is None:
                job.reason = decision.reason
                return
            chosen = as_text(chooser.sequence_of(decision.run))
            job.progress.enter(MOVING)
            try:
                self._excitation.make(job, chosen)
            except JobError as error:
                if error.aborted_by in AT_AN_END and tries > 0:
                    tries = tries - 1
                    runs = self._heard_runs(live, len(runs))
                    chooser.leave_out(decision)
                    self._node.say("info", f"{error}; another push is chosen")
                    continue
                if job.cancelled.is_set() or not runs:
                    raise
                # what was recorded says something all the same
                job.reason = f"no further push: {error}"
                return
            runs = self._heard_runs(live, len(runs))

    @staticmethod
    def _await_position(live: LiveEstimate) -> None:
        """Until it is known where all joints are: a recording begins with nothing heard."""
        deadline = clock.now() + HEARD_S
        while silent := sorted(set(live.joints) - set(live.position())):
            if clock.now() > deadline:
                raise JobError(
                    f"no joint states of {', '.join(silent)} come in: without them no push can be chosen"
                )
            clock.sleep(0.005)

    def _heard_runs(self, live: LiveEstimate, before: int) -> Sequence[Run]:
        """All runs, once more have been heard than before."""
        deadline = clock.now() + HEARD_S
        while len(runs := live.runs()) <= before and clock.now() < deadline:
            clock.sleep(0.02)
        return runs

    def _check_input(self, folder: Path, request: Request) -> None:
        """Whether what comes in can be read, before anything moves.

        Raises `RecordingError`: It cannot, or the folder cannot be written.
        """
        heard: list[RawMessage] = []
        self._inputs.heard = heard
        deadline = clock.now() + LONGEST_CHECK_S
        notes = None
        try:
            while notes is None:
                clock.sleep(CHECK_S)
                try:
                    notes = check_input(
                        folder,
                        [*heard, *self._inputs.published_motors()],
                        request,
                    )
                except RecordingError:
                    if clock.now() > deadline:
                        raise
        finally:
            self._inputs.heard = None
        for note in notes:
            self._node.say("info", note)
        if not self._inputs.has_effort and not self._inputs.by_goals:
            self._node.say(
                "warning",
                "no applied_effort: the times at which a current began are those at which its command was heard",
            )

    def save_again(self) -> None:
        """Recordings that could be written nowhere are tried again until they are on disk."""
        for session in list(self._unsaved):
            try:
                bag, _ = session.save()
                self._unsaved.remove(session)
                self._node.say("info", f"the recording of {session.name} is saved now: {bag}")
            except RecordingError as error:
                self._node.get_logger().error(
                    f"{session.name}: {error}", throttle_duration_sec=60.0
                )
