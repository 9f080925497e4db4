"""Joint states in which a joint jumps away and back, as damaged numbers do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.noted import count_of
from proprio_ros.records import MIN_SAMPLES, BoolArray, FloatArray, Recording

IMPLAUSIBLE_SPEED = 10.0
"""rad/s or m/s: no joint of an arm gets that fast there and back between a few samples; a damaged number does."""
# samples in a row that may be damaged: more that agree with each other are a slipped encoder
LONGEST_JUMP = 3
MOST_JUMPS = 0.2  # of the joint states may jump there and back: more are another motion's


def without_jumps(recording: Recording, joints: Sequence[str]) -> Recording:
    """Leave out, with a note, joint states in which one of the robot's joints jumps away and back, as damaged numbers would.

    That is all that can be seen of damage in a file without checksums (sqlite3): smaller errors, and those at the ends, cannot.
    """
    record = recording.joints
    position = record.position[:, np.isin(record.names, joints)]
    if len(position) <= MIN_SAMPLES:
        return recording
    intervals_s = 1e-9 * np.diff(record.times_ns)
    kept = ~np.any(_jumped(intervals_s, position), axis=1)
    if kept.all():
        return recording
    jumps = f"in {count_of(~kept)} joint states a joint jumps there and back faster than {IMPLAUSIBLE_SPEED:g} rad/s"
    if np.mean(~kept) > MOST_JUMPS:
        raise RecordingError(
            f"{jumps}: two motions are mixed, as where a clock was set back while it was recorded, or where two "
            "publish joint states",
            recording.name,
        )
    note = f"{jumps}; they were left out: is the file damaged?"
    return replace(
        recording,
        joints=record.kept(kept),
        notes=(*recording.notes, note),
    )


def _jumped(intervals_s: FloatArray, position: FloatArray) -> BoolArray:
    """Which samples, shape (T, J), lie off a way that goes on as if they were not there.

    Args:
        intervals_s: Between samples [s], shape (T - 1,).
        position: [rad or m], shape (T, J).
    """
    # two messages may be stamped at nearly the same time
    allowed = IMPLAUSIBLE_SPEED * np.maximum(intervals_s, np.median(intervals_s))[:, None]
    far = np.abs(np.diff(position, axis=0)) > allowed
    jumped = np.zeros(position.shape, dtype=bool)
    for count in range(1, LONGEST_JUMP + 1):
        # it leaves, and after that many samples it is where it was, as far as it can have moved meanwhile
        near = (count + 1) * allowed[: len(allowed) - count]
        back = np.abs(position[count + 1 :] - position[: -count - 1]) <= near
        gone = far[:-count] & far[count:] & back
        for number in range(1, count + 1):
            jumped[number : number + len(gone)] |= gone
    return jumped
