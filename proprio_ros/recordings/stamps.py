"""When the messages of a topic were sent, and in which order: one way for joint states and for what drives them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from proprio_ros.recordings.arrivals import of_bursts
from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.noted import Noted
from proprio_ros.records import TimeArray


def times_of(columns: JointColumns, noted: Noted) -> TimeArray:
    """Header stamps; where there are none, the recorder's time on the same clock; shape (M,) [ns]."""
    missing = columns.stamp_ns == 0
    noted.count(missing, "messages have no header stamp; their time of recording was used")
    return np.where(
        missing,
        columns.bag_ns + columns.clock_ns(),
        columns.stamp_ns,
    )


def order_of(times_ns: TimeArray, noted: Noted) -> NDArray[np.intp]:
    """Rows in the order of time, shape (M,)."""
    late = np.diff(times_ns, prepend=times_ns[:1]) < 0
    noted.count(late, "stamps go back in time; the messages were sorted")
    return np.argsort(times_ns, kind="stable")


def sent_at(times_ns: TimeArray, noted: Noted) -> TimeArray:
    """Times of messages in their order, shape (M,) [ns]; those that came in bursts when they were sent.

    Raises:
        RecordingError: When that was nobody knows.
    """
    arrivals = of_bursts(times_ns)
    if arrivals is None:
        return times_ns
    bursts = (
        f"{arrivals.moved} of {len(times_ns)} messages come in bursts, stamped when they arrived"
    )
    rate = f"{1.0 / arrivals.period_s:.0f} Hz"
    if not arrivals.steady:
        raise noted.error(
            f": {bursts}, at no steady rate (about {rate}): when each was sent nobody knows; let the driver stamp each "
            "as it is read"
        )
    noted.note(f"{bursts}; they were taken to be sent evenly, at {rate}.")
    return arrivals.times_ns
