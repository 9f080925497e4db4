"""From one episode to its rows. Pure: the same episode and job give the same rows, in whatever process and order."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from proprio_ros.addons.fleet.episodes import Episode
from proprio_ros.addons.fleet.grasps import Grasp, Grasps
from proprio_ros.errors import ProprioError, RecordingError, RobotError, of_the_machine, one_line
from proprio_ros.identification.estimate import Estimate, Value
from proprio_ros.identification.regression.at_rest import check_carriers
from proprio_ros.identification.together import Meeting
from proprio_ros.pipeline.replay import identify, read_for
from proprio_ros.pipeline.request import Options, Request, request_of
from proprio_ros.probes.base import Online, Recorded
from proprio_ros.recordings.contents import parts_of
from proprio_ros.recordings.datasets import parts_of_episode
from proprio_ros.recordings.motions import Motion
from proprio_ros.recordings.text import is_text_recording
from proprio_ros.records import Span
from proprio_ros.robot import Robot
from proprio_ros.schema import calibration_used, reason_codes
from proprio_ros.threads import one_blas_thread
from proprio_ros.version import __version__

Row = dict[str, Any]

# kinds of rows
EPISODE = "episode"  # a whole one
PART = "part"  # of one that is too long to be answered at once
GRASP = "grasp"  # a stretch in which one thing was held
CHANGED = "changed_midway"  # the reason where it does not stay one thing
FAILED = "failed"  # what could not be read or identified
MACHINE = "machine"
"""Code of a reason that is the computer's; such a row is not kept."""
COLUMNS = {
    "source_name": "text", "source": "text", "episode": "text", "episode_index": "integer", "segment": "integer",
    "segments": "integer", "kind": "text", "recorded_ns": "integer", "start_s": "number", "end_s": "number", "samples": "integer",
    "joints": "texts", "probe": "text", "quantity": "text", "unit": "text", "value": "number", "std": "number", "low": "number",
    "high": "number", "gripper": "number", "verdict": "text", "reasons": "texts", "reason_codes": "texts", "notes": "texts",
    "robot": "text", "calibration": "text", "calibration_sha256": "text", "version": "text", "elapsed_s": "number",
}  # fmt: skip
"""What each column of a row holds."""
MOST_SAMPLES = 30_000
"""Joint states that are answered at once: ten minutes at 50 Hz, half a minute at 1 kHz. Longer motions need no more memory."""
LEAST_BYTES = 8 * MOST_SAMPLES  # a bag that is smaller holds fewer: it need not be looked into


@dataclass(frozen=True)
class Job:
    """What is asked of every episode."""

    options: Options = field(default_factory=Options)  # as for `proprio replay`
    grasps: bool = False  # whether rows of grasps are wanted, too
    # for so long from its first joint state on the hand is known to be empty in every episode: what is asked is what it
    # holds later [s]
    empty_first_s: float = 0.0
    columns_files: tuple[str, ...] = ()  # that say what the columns of tables are

    def fingerprint(self) -> str:
        """Of everything that the rows follow from besides the episodes: options, the files that they name, this version."""
        found = hashlib.sha256(self.as_text().encode())
        options = self.options
        named_by_options = (options.calibration, options.robot, options.driver)
        for named in (*named_by_options, *self.columns_files):
            if named is not None and Path(named).is_file():
                found.update(b"\0" + Path(named).read_bytes())
        return found.hexdigest()[:16]

    def as_text(self) -> str:
        """Options and version as JSON."""
        stated = asdict(self)
        if not self.columns_files:
            del stated["columns_files"]
        return json.dumps({"version": __version__, **stated}, default=str, sort_keys=True)


@one_blas_thread
def rows_of(episode: Episode, job: Job) -> list[Row]:
    """All rows of an episode, at least one; whatever goes wrong is a row with its reason."""
    started = time.perf_counter()
    try:
        if episode.problem:
            raise RecordingError(episode.problem)
        request = _request(job)
        rows = _answered(episode, job, request, spans_of(episode, job, request))
        # a cut may go through a push: only motions are answered in parts
        rows = rows or _answered(episode, job, request, [_later(None, job)])
    except Exception as error:  # whatever an episode holds, the job goes on
        known = isinstance(error, ProprioError)
        code = MACHINE if of_the_machine(error) else "unreadable" if known else "unexpected"
        kind = "" if known else f"{code}: {type(error).__name__}: "
        rows = [failed_row(episode, job, one_line(f"{kind}{error}"), code)]
    elapsed = time.perf_counter() - started
    return [
        {**row, "segment": number, "segments": len(rows), "elapsed_s": elapsed}
        for number, row in enumerate(rows)
    ]


def lasting(rows: Sequence[Row]) -> list[Row]:
    """Those of episodes of which no row says that the computer was at fault: the others are asked again next time."""
    undone = {(row["source"], row["episode"]) for row in rows if row["reason_codes"] == [MACHINE]}
    return [row for row in rows if (row["source"], row["episode"]) not in undone]


@one_blas_thread
def rows_of_all(episodes: Sequence[Episode], job: Job) -> list[Row]:
    """The same of some episodes; the threads are limited once, and on a graphics card their fits share a launch."""
    if job.options.device == "cpu":
        return [row for episode in episodes for row in rows_of(episode, job)]
    rows = Meeting().results([partial(rows_of, episode, job) for episode in episodes])
    return [row for of_one in rows for row in of_one]


def spans_of(
    episode: Episode,
    job: Job,
    request: Request,
) -> list[Span | None]:
    """The parts in which an episode is answered; one, unless it is long.

    Args:
        episode: What is answered.
        job: What is asked of it.
        request: How it is read.

    Raises:
        RecordingError: It cannot be read.
    """
    parts: Sequence[Span] = []
    if episode.index is not None:
        parts = parts_of_episode(episode.source, episode.index, MOST_SAMPLES)
    elif not is_text_recording(episode.path) and _bytes_of(Path(episode.path)) >= LEAST_BYTES:
        conventions = request.conventions
        state_topic = job.options.state_topic
        parts = parts_of(
            episode.path, MOST_SAMPLES, state_topic=state_topic, conventions=conventions
        )
    if len(parts) < 2:
        return [_later(None, job)]
    later = [_later(part, job) for part in parts]
    return [part for part in later if part is not None]


def _bytes_of(bag: Path) -> int:
    """Of all its files; 0 where it has gone, which reading it will say."""
    try:
        files = [bag] if bag.is_file() else bag.iterdir()
        return sum(file.stat().st_size for file in files)
    except OSError:
        return 0


def _later(span: Span | None, job: Job) -> Span | None:
    """What of a part, or of all, comes after the hand was empty; None: all of all, or nothing of a part."""
    after_ns = round(1e9 * job.empty_first_s)
    if not after_ns:
        return span
    begin_ns, end_ns = span or (0, None)
    return None if end_ns is not None and end_ns <= after_ns else (max(begin_ns, after_ns), end_ns)


@dataclass(frozen=True)
class _Part:
    """One part of an episode, or all of it, and what was answered."""

    request: Request
    row: Row
    robot: Robot | None = None  # None where the part could not be read
    read: Recorded | None = None

    @property
    def motion(self) -> Motion | None:
        """In which grasps may be looked for."""
        if self.row["kind"] == FAILED or not isinstance(self.request.probe, Online):
            return None
        return self.read.motions[0] if self.read is not None and self.read.motions else None


def _answered(
    episode: Episode,
    job: Job,
    request: Request,
    spans: Sequence[Span | None],
) -> list[Row]:
    """Rows of each part, and of the grasps in all of them; none where one of several parts holds pushes."""
    several = len(spans) > 1
    rows: list[Row] = []
    grasps: Grasps | None = None
    for span in spans:
        part = _answered_part(episode, job, _within(request, span), span, several)
        if part is None:
            return []
        rows.append(_placed(part.row, span, several))
        motion = part.motion if job.grasps else None
        if motion is None or part.robot is None or _leans(part.robot, motion, rows[-1]):
            continue
        if grasps is None and part.robot.motion_calibration is not None:
            grasps = Grasps(part.request, part.robot, motion)
        if grasps is not None:
            grasps.add(motion, 0.0 if span is None else 1e-9 * span[0])
    return rows if grasps is None else _with_grasps(episode, rows, grasps)


def _leans(robot: Robot, motion: Motion, row: Row) -> bool:
    """Whether what carries the arm leans over, or a joint is only read: a running estimate knows neither, and finds no grasps."""
    try:
        robot.check_efforts_known()
        check_carriers(robot, [motion], motion.joints)
    except (RecordingError, RobotError) as error:
        row["notes"] = [*(row["notes"] or ()), f"no grasps are looked for: {error}"]
        return True
    return False


def _answered_part(
    episode: Episode, job: Job, request: Request, span: Span | None, several: bool
) -> _Part | None:
    """Read one part and answer; a row of what is wrong where it cannot be read, None for one of several that holds pushes.

    Args:
        episode: Whose part it is.
        job: What is asked.
        request: Within the part.
        span: From when to when [ns]; None for all of it, of which a mistake is raised.
        several: Whether the episode has more parts.

    Raises:
        ProprioError: The machine is at fault, or there are no parts.
    """
    robot: Robot | None = None
    read: Recorded | None = None
    try:
        robot, read = read_for(request, [episode.path])
        if several and read.runs:
            return None
        row = _whole(episode, request, read, identify(request, robot, read, [episode.path]))
    except ProprioError as error:
        if span is None or of_the_machine(error):
            raise
        row = failed_row(episode, job, str(error), "unreadable")
    return _Part(request, row, robot, read)


def _placed(row: Row, span: Span | None, several: bool) -> Row:
    """A row with the place of its part."""
    if span is not None:
        row |= _place(row, span)
    if several and row["kind"] == EPISODE:
        row["kind"] = PART
    return row


def _with_change(row: Row, grasps: Sequence[Row]) -> Row:
    """The row of a whole episode that is rejected as one load, where several were weighed in it: that comes first, and no unit."""
    loads = [grasp for grasp in grasps if grasp["verdict"] == "accepted"]
    codes = list(row["reason_codes"] or ())
    whole = row["kind"] == EPISODE and row["verdict"] == "rejected"
    if not whole or len(loads) < 2 or CHANGED in codes[:1]:
        return row
    sentence = f"its load changes: {len(loads)} stretches with one load each are weighed in rows of their own"
    return {
        **row,
        "reasons": [sentence, *(row["reasons"] or ())],
        "reason_codes": [CHANGED, *codes],
    }


def _within(request: Request, span: Span | None) -> Request:
    """The same for a part of a recording."""
    if span is None:
        return request
    return replace(request, options=replace(request.options, span=span))


def _with_grasps(episode: Episode, rows: Sequence[Row], grasps: Grasps) -> list[Row]:
    """The rows of an episode's parts, and a row of each stretch with one load."""
    whole = next(row for row in rows if row["kind"] != FAILED)
    used = calibration_used(grasps.robot.source)
    found = [_of_grasp(episode, whole, grasp, used) for grasp in grasps.found()]
    return [*(_with_change(row, found) for row in rows), *found]


def _place(row: Row, span: Span) -> Row:
    """From when to when a part goes, as ``--span`` takes it."""
    begin_s = 1e-9 * span[0]
    if span[1] is not None:
        return {"start_s": begin_s, "end_s": 1e-9 * span[1]}
    return {
        "start_s": begin_s,
        "end_s": None if row["end_s"] is None else begin_s + row["end_s"],
    }


def _request(job: Job) -> Request:
    """Read once for all episodes of a job that this process gets."""
    text = job.as_text()
    if text not in _READ:
        _READ.clear()
        _READ[text] = request_of(job.options)
    return _READ[text]


_READ: dict[str, Request] = {}


def _row(
    episode: Episode, probe: str, kind: str, verdict: str, used: Mapping[str, str], **known: Any
) -> Row:
    """All columns; those of which nothing is known are empty."""
    empty: Row = {"text": "", "texts": [], "integer": None, "number": None}
    return {name: empty[form] for name, form in COLUMNS.items()} | {
        "source_name": source_name(episode.source),
        "source": episode.source,
        "episode": episode.name,
        "episode_index": episode.index,
        "kind": kind,
        "samples": 0,
        "probe": probe,
        "verdict": verdict,
        "calibration": used.get("name"),
        "calibration_sha256": used.get("fingerprint"),
        "version": __version__,
        **known,
    }


def failed_row(episode: Episode, job: Job, reason: str, code: str) -> Row:
    """The row of an episode that has no answer.

    Args:
        episode: What could not be answered.
        job: What was asked of it.
        reason: The sentence that says why.
        code: The reason's code.
    """
    robot = "" if job.options.robot is None else Path(job.options.robot).stem
    why = {"reasons": [reason], "reason_codes": [code], "robot": robot}
    alone = {"segment": 0, "segments": 1, "elapsed_s": 0.0}
    return _row(
        episode,
        job.options.probe,
        FAILED,
        "failed",
        {},
        **why,
        **alone,
    )


def _whole(episode: Episode, request: Request, read: Recorded, estimate: Estimate) -> Row:
    answer = next(
        (value for value in estimate.values if value.name == request.probe.answer[0]),
        estimate.values[0],
    )
    why = {
        "reasons": [str(reason) for reason in estimate.reasons],
        "reason_codes": reason_codes(estimate.reasons),
    }
    about = {
        **_span(episode, read),
        **_numbers(answer),
        "notes": list(estimate.notes),
        "robot": estimate.robot,
    }
    used = estimate.origin["calibration"] or {}
    return _row(
        episode,
        estimate.probe,
        EPISODE,
        estimate.verdict.value,
        used,
        **about,
        **why,
    )


def _numbers(value: Value) -> Row:
    number = value.value if isinstance(value.value, float) else None
    std = value.std if isinstance(value.std, float) else None
    low, high = value.ci95 if value.ci95 is not None and number is not None else (None, None)
    return {
        "quantity": value.name,
        "unit": value.unit,
        "value": number,
        "std": std,
        "low": low,
        "high": high,
    }


def _span(episode: Episode, read: Recorded) -> Row:
    """When, and which joints: of a motion since its first sample, of runs since the first onset."""
    if read.motions:
        motion = read.motions[0]
        recorded_ns = motion.begin_ns if episode.index is None else 0
        end_s = motion.times_s[-1]
        samples = len(motion.times_s)
        joints = list(motion.moved)
    elif read.runs:
        recorded_ns = min(run.onset_ns for run in read.runs)
        end_s = max(1e-9 * (run.onset_ns - recorded_ns) + run.duration_s for run in read.runs)
        samples = sum(len(run.times_s) for run in read.runs)
        joints = list(dict.fromkeys(run.joint for run in read.runs))
    else:
        return {}
    when = {"recorded_ns": recorded_ns or None, "start_s": 0.0, "end_s": float(end_s)}
    return {**when, "samples": samples, "joints": joints}


def _of_grasp(
    episode: Episode,
    whole: Row,
    grasp: Grasp,
    used: Mapping[str, str],
) -> Row:
    verdict = "accepted" if grasp.known else "too_wide"
    low, high = grasp.ci95_kg
    as_whole = {
        name: whole[name] for name in ("recorded_ns", "joints", "quantity", "unit", "robot")
    }
    when = {name: getattr(grasp, name) for name in ("start_s", "end_s", "samples", "gripper")}
    held = {
        "value": grasp.mass_kg,
        "std": grasp.std_kg,
        "low": low,
        "high": high,
    }
    why = {"reasons": [grasp.what], "reason_codes": [grasp.code]}
    return _row(
        episode,
        whole["probe"],
        GRASP,
        verdict,
        used,
        **as_whole,
        **when,
        **held,
        **why,
    )


def source_name(source: str) -> str:
    """A short name of a source for the partition: its folder's, and where it lies."""
    plain = (
        "".join(c if c.isalnum() or c in "-_." else "_" for c in Path(source).name)[:60] or "root"
    )
    return f"{plain}-{hashlib.sha256(source.encode()).hexdigest()[:6]}"
