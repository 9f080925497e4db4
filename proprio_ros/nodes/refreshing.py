"""The calibration in use, brought up to date by some chosen pushes with an empty hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from proprio_ros.errors import ProprioError
from proprio_ros.excitation.plans import as_text, load_sequence
from proprio_ros.experiment_design.until import chosen_refresh
from proprio_ros.identification.estimate import Verdict
from proprio_ros.live.job import Job, JobError
from proprio_ros.live.workspace import Workspace
from proprio_ros.nodes.inputs import Inputs
from proprio_ros.nodes.results import Results
from proprio_ros.pipeline.calibrate import refresh_from_bags
from proprio_ros.pipeline.replay import aged_robot
from proprio_ros.pipeline.request import Request, robot_of
from proprio_ros.quantity import shown
from proprio_ros.report import write_calibration_report

REFRESH_S = 30.0  # all pushes of a refresh take so long at most; what they leave open a whole calibration has to learn


def refresh_robot(
    job: Job,
    workspace: Workspace,
    inputs: Inputs,
    results: Results,
    ways: str,
    record: Callable[[Job, str, str, Request], Path],
    keep: Callable[[Callable[[], None]], None],
) -> tuple[bool, str]:
    """Choose, make and identify the pushes; the outcome takes the place of the calibration.

    Args:
        job: That asks for it.
        workspace: Whose calibration it is.
        inputs: Say what time it is, and how warm the motors are.
        results: Where the outcome goes.
        ways: Sequence whose ways, rest and brake count.
        record: Has a sequence made and gives the recording.
        keep: Writes something beside it.

    Raises:
        JobError: There is nothing to bring up to date.
    """
    if workspace.calibration is None:
        raise JobError("there is no calibration to bring up to date: call ~/calibrate_robot first")
    inputs.live, options = None, workspace.options()
    fresh = robot_of(options)
    learnt = fresh.calibration
    if learnt is None or not learnt.driven:
        raise JobError(
            f"{workspace.calibration} was not made of driven runs: call ~/calibrate_robot with robot_sequence empty_hand"
        )
    if learnt.made is None:
        raise JobError(
            f"{workspace.calibration} does not say when it was made, so nobody knows how old it is: call ~/calibrate_robot"
        )
    old = aged_robot(fresh, inputs.moment())
    if old is fresh:
        return (
            True,
            f"up to date: made less than ten minutes ago, or by another clock; calibration: {workspace.calibration}",
        )
    results.tell(job.kind, "choosing the pushes that bring the calibration up to date")
    sequence = load_sequence(ways, fresh)
    runs, then, now = chosen_refresh(fresh, old, REFRESH_S, sequence)
    worth = f"{shown('kg', then, spec='.2f')} when it was made, {shown('kg', now, spec='.2f')} by now"
    if not runs:
        return (
            True,
            f"up to date: a weighing of 30 g would be as sure as +-{worth}; calibration: {workspace.calibration}",
        )
    if job.cancelled.is_set():
        raise JobError("cancelled")
    results.tell_and_log(
        job.kind, f"pushes with an empty hand: {len(runs)}; a weighing of 30 g was as sure as +-{worth}"
    )
    # after them the arm stays where it is
    bag = record(
        job, job.kind, as_text(replace(sequence, runs=tuple(runs), until=None, home={})), Request(fresh, options)
    )
    results.tell(job.kind, "identifying what has changed")
    output = bag.parent / "calibration.yaml"
    try:
        estimate = refresh_from_bags(bag, options, output, partial(results.tell, job.kind), force=True)
    except ProprioError as error:
        raise JobError(f"{error}; recording: {bag}") from error
    results.calibration(estimate, str(output))
    keep(lambda: write_calibration_report(estimate, bag.parent / "report.html", sources=[str(bag)]))
    if estimate.verdict is not Verdict.ACCEPTED:
        return False, f"{estimate.verdict.value}: {'; '.join(estimate.reasons)}; recording: {bag}"
    stays = workspace.keep_calibration(output)
    said = f"calibration brought up to date by {len(estimate.run_fits)} of {estimate.runs} runs; calibration: {output}"
    return True, f"{said}; {stays}" if stays else said
