"""Clocks that do not go on evenly: seen before any fit in the times of a bag's joint states, and taken out of all of its topics.

A message has two times: its header's stamp and when it was recorded. A time service that sets a clock makes one of them, or both,
jump; before a simulation's `/clock` is heard they are 0. Where one clock is whole it says by how much the other one jumped. Where
both jump the recording is cut: what came before and after is used, and nothing is said of the time between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from proprio_ros.errors import RecordingError
from proprio_ros.recordings.columns import JointColumns
from proprio_ros.recordings.medians import running_median
from proprio_ros.records import BoolArray, FloatArray, TimeArray

LEAST_STEP_NS = 100_000_000
"""What counts as a step; time services set clocks that are 128 ms off or more, and let others run faster."""
MOST_STEPS = 8  # more are no clock that is set, but messages that come late
NEIGHBOURS = 11  # a level is the median of so many messages: single late ones are no step
PERIODS = 5.0  # a clock that is whole goes on within so many periods, or half a step
CUT_NS = 200_000_000
"""What is left between two parts; no window of a motion spans a gap so long."""
# before and behind an overlap: where it begins and ends is known to a few messages
MARGIN_NS = 60_000_000
ROUNDED_STEPS = 2.5
"""The first of rounded times is no further from the second than so many of the usual steps; what a clock is set by is."""
YEAR_NS = 31_557_600 * 10**9
EPOCH_NS = 10**15  # a clock of today is past that, twelve days; one of a simulation is not
FEWEST = 30
COUNTED_NS = 10**9  # between messages whose number is taken for seconds
CROWDED = 0.65
"""Of the usual time that a few messages take, below which two parts of a recording overlap there: each keeps its pace."""
MOST_CUTS = 3  # more are bursts, or pauses
NEAR = 10  # messages over which that is looked at
THERE_AND_BACK = 2.0
"""Where two parts overlap, positions go so many times as far from message to message as to the next of the same part."""
COUNT_RAD = 2e-3  # positions that are so close are the same: a count of a servo's encoder [rad]
SURE_LEAP_NS = 500_000_000  # a shorter gap is one of lost messages


@dataclass(frozen=True)
class Times:
    """When messages came."""

    bag_ns: TimeArray  # when each was recorded, shape (M,)
    stamp_ns: TimeArray  # of its header, 0 where there is none, shape (M,)
    known: BoolArray  # whether these times say when it was, shape (M,)


@dataclass(frozen=True)
class Unset:
    """Times of before a clock was heard."""

    until_ns: int  # all recorded before that [ns]
    stamps_too: bool = False  # whether those without a stamp are left out until then, and no others

    def mended(self, times: Times) -> Times:
        """The same without them."""
        early = times.bag_ns < self.until_ns
        if self.stamps_too:
            early &= times.stamp_ns == 0
        return Times(times.bag_ns, times.stamp_ns, times.known & ~early)


@dataclass(frozen=True)
class StampsStep:
    """Header stamps jump, while the recorder's clock goes on."""

    at_ns: int  # the recorder's time of the first message after it
    by_ns: int

    def mended(self, times: Times) -> Times:
        """The same with stamps as if nothing had happened."""
        after = (times.bag_ns >= self.at_ns) & (times.stamp_ns != 0)
        return Times(
            times.bag_ns,
            np.where(
                after,
                times.stamp_ns - self.by_ns,
                times.stamp_ns,
            ),
            times.known,
        )


@dataclass(frozen=True)
class StampsCount:
    """Header stamps count messages."""

    def mended(self, times: Times) -> Times:
        """The same without stamps: when they were recorded is all that is known."""
        return Times(
            times.bag_ns,
            np.zeros_like(times.stamp_ns),
            times.known,
        )


@dataclass(frozen=True)
class RecorderSteps:
    """The recorder's clock jumps, while header stamps go on."""

    at_ns: int  # stamp of the first message after it
    by_ns: int
    # when messages before it were recorded, first and last, and those after it [ns]
    before_ns: tuple[int, int]
    after_ns: tuple[int, int]

    def mended(self, times: Times) -> Times:
        """The same, recorded as if nothing had happened; of messages without a stamp it may not be known when they were."""
        stamped = times.stamp_ns != 0
        after = np.where(
            stamped,
            times.stamp_ns >= self.at_ns,
            self._after(times.bag_ns),
        )
        twice = self._twice_ns
        known = times.known
        if twice is not None:
            inside = (times.bag_ns >= twice[0]) & (times.bag_ns <= twice[1])
            known = known & (stamped | ~inside)
        bag_ns = np.where(
            after,
            times.bag_ns - self.by_ns,
            times.bag_ns,
        )
        return Times(bag_ns, times.stamp_ns, known)

    def _after(self, bag_ns: TimeArray) -> BoolArray:
        """Which messages without a stamp were recorded after it, as far as that is known, shape (M,)."""
        if self.after_ns[1] < self.before_ns[0]:
            return bag_ns < (self.after_ns[1] + self.before_ns[0]) // 2
        if self.by_ns > 0:
            return bag_ns > (self.before_ns[1] + self.after_ns[0]) // 2
        return bag_ns > self.before_ns[1]

    @property
    def _twice_ns(self) -> tuple[int, int] | None:
        """The recorder's times that come twice; None: none does."""
        first_ns = max(self.before_ns[0], self.after_ns[0])
        last_ns = min(self.before_ns[1], self.after_ns[1])
        return (first_ns - MARGIN_NS, last_ns + MARGIN_NS) if first_ns <= last_ns else None

    @property
    def cut_ns(self) -> tuple[int, int] | None:
        """From when to when messages without a stamp are not known, as recorded [ns]; None: nowhere."""
        twice = self._twice_ns
        return None if twice is None else (twice[0], twice[1] - self.by_ns)


@dataclass(frozen=True)
class Overlap:
    """Both clocks are set back: what was recorded before and after has the same times."""

    begin_ns: int  # of the times that come twice, as recorded
    end_ns: int

    def mended(self, times: Times) -> Times:
        """The same without those, and a short time in their place."""
        inside = (times.bag_ns >= self.begin_ns) & (times.bag_ns <= self.end_ns)
        by_ns = self.end_ns - self.begin_ns - CUT_NS
        return _moved(
            times,
            times.bag_ns > self.end_ns,
            by_ns,
            times.known & ~inside,
        )

    @property
    def cut_ns(self) -> tuple[int, int]:
        """From when to when nothing is known, as recorded [ns]."""
        return self.begin_ns, self.begin_ns + CUT_NS


@dataclass(frozen=True)
class Leap:
    """Both clocks are set forward or far back: nothing was recorded in between, and nothing happened."""

    last_ns: int  # when the last message of the earlier times was recorded
    first_ns: int  # and the first one of the later times
    # of both parts, when their other ends were
    begin_ns: int
    end_ns: int
    back: bool  # whether the later times were recorded first

    def mended(self, times: Times) -> Times:
        """The same with a short time between the two parts, in the order in which they were recorded."""
        later = times.bag_ns > (self.first_ns + self.last_ns) // 2
        if self.back:
            moved = ~later
            by_ns = self.begin_ns - self.end_ns - CUT_NS
        else:
            moved = later
            by_ns = self.first_ns - self.last_ns - CUT_NS
        return _moved(times, moved, by_ns, times.known)

    @property
    def cut_ns(self) -> tuple[int, int]:
        """The time between the parts, as recorded [ns]."""
        begin_ns = self.end_ns if self.back else self.last_ns
        return begin_ns, begin_ns + CUT_NS


def _moved(
    times: Times,
    rows: BoolArray,
    by_ns: int,
    known: BoolArray,
) -> Times:
    """Times of which some rows, shape (M,), are earlier by so much."""
    stamped = rows & (times.stamp_ns != 0)
    bag_ns = np.where(rows, times.bag_ns - by_ns, times.bag_ns)
    return Times(
        bag_ns,
        np.where(stamped, times.stamp_ns - by_ns, times.stamp_ns),
        known,
    )


Fault = Unset | StampsStep | StampsCount | RecorderSteps | Overlap | Leap


@dataclass(frozen=True)
class ClockFaults:
    """What is wrong with the clocks of a bag, in the order in which it is mended."""

    faults: tuple[Fault, ...] = ()
    notes: tuple[str, ...] = ()  # a sentence on each

    def mended(self, columns: JointColumns) -> JointColumns:
        """Messages in the order of times that go on evenly; those of which nobody knows when they were are left out."""
        if not self.faults:
            return columns
        times = self.times(columns.bag_ns, columns.stamp_ns)
        stamped = times.stamp_ns != 0
        ahead_ns = JointColumns(times.bag_ns, times.stamp_ns, (), {}, []).clock_ns()
        order = np.argsort(
            np.where(stamped, times.stamp_ns, times.bag_ns + ahead_ns), kind="stable"
        )
        rows = order[times.known[order]]
        values = {name: table[rows] for name, table in columns.values.items()}
        return columns._replace(
            bag_ns=times.bag_ns[rows], stamp_ns=times.stamp_ns[rows], values=values
        )

    def then(self, other: ClockFaults) -> ClockFaults:
        """What is wrong by both, the other's in times that this one has mended."""
        return ClockFaults(
            (*self.faults, *other.faults),
            (*self.notes, *other.notes),
        )

    def times(self, bag_ns: TimeArray, stamp_ns: TimeArray) -> Times:
        """Times of messages by this clock, shape (M,) each [ns]."""
        times = Times(
            bag_ns,
            stamp_ns,
            np.ones(len(bag_ns), dtype=bool),
        )
        for fault in self.faults:
            times = fault.mended(times)
        return times

    def cuts_ns(
        self,
        unstamped: bool,
    ) -> tuple[tuple[int, int], ...]:
        """Stretches of which nothing is known, as recorded [ns]; ``unstamped``: of messages without a stamp."""
        kinds = (Overlap, Leap, RecorderSteps) if unstamped else (Overlap, Leap)
        cuts = [fault.cut_ns for fault in self.faults if isinstance(fault, kinds)]
        return tuple(cut for cut in cuts if cut is not None)


def clock_faults_of(where: str, columns: JointColumns) -> ClockFaults:
    """What is wrong with the clocks, by the joint states.

    Args:
        where: Topic, for the notes.
        columns: With positions, in the order of recording.

    Raises:
        RecordingError: All messages have one time.
    """
    if len(columns.bag_ns) >= FEWEST and columns.bag_ns[0] == columns.bag_ns[-1]:
        raise RecordingError(
            f"all {len(columns.bag_ns)} messages were recorded at {1e-9 * columns.bag_ns[0]:g} s: the recorder's clock "
            "stood still; was /clock published (use_sim_time)?",
            where,
        )
    clock = ClockFaults()
    for fault_of in (_unset, _unstamped, _counted, _step_of_one, _steps_of_both, _steps_of_both):
        found = fault_of(clock.mended(columns))
        if found:
            notes = (f"{where}: {note}" for _, note in found)
            clock = ClockFaults(
                (*clock.faults, *(fault for fault, _ in found)),
                (*clock.notes, *notes),
            )
    return clock


def messages_at(
    messages: Sequence[tuple[int, Any]],
    clock: ClockFaults,
) -> list[tuple[int, Any]]:
    """Messages without a stamp at when they were recorded, as far as that is known [ns]."""
    recorded_ns = np.array(
        [time_ns for time_ns, _ in messages],
        dtype=np.int64,
    )
    times = clock.times(recorded_ns, np.zeros_like(recorded_ns))
    return [
        (int(time_ns), message)
        for time_ns, known, (_, message) in zip(times.bag_ns, times.known, messages, strict=True)
        if known
    ]


Found = Sequence[tuple[Fault, str]]
"""Faults with a note on each."""


def in_order(
    where: str, times_ns: TimeArray, position: FloatArray
) -> tuple[TimeArray, tuple[str, ...]]:
    """Times of samples whose order is known, with a short time in the place of each step of their clock.

    Args:
        where: Recording, for the notes.
        times_ns: As they were written [ns], shape (T,).
        position: Of the joints, shape (T, J).

    Returns: The times [ns], shape (T,), and a note on each step.
    """
    steps = np.diff(times_ns)
    back = np.flatnonzero(steps < -LEAST_STEP_NS)
    if len(back) > MOST_CUTS or len(times_ns) < FEWEST:
        return times_ns, ()
    notes = []
    mended = times_ns.copy()
    for row in back:
        since_s = 1e-9 * (mended[row] - mended[0])
        notes.append(
            f"{where}: the clock steps by {1e-9 * steps[row]:+.3g} s after {since_s:.1f} s: the recording was cut there"
        )
        mended[row + 1 :] += CUT_NS - steps[row]
    for leap, note in _leaps(mended, mended, position):
        times = Times(
            mended,
            np.zeros_like(mended),
            np.ones(len(mended), dtype=bool),
        )
        mended = leap.mended(times).bag_ns
        notes.append(f"{where}: {note}")
    return mended, tuple(notes)


def _unset(columns: JointColumns) -> Found:
    """Messages that were recorded before the recorder's clock was set."""
    times = columns.bag_ns
    if len(times) < FEWEST:
        return ()
    steps = np.diff(times)
    until = 0
    far = np.flatnonzero(steps > YEAR_NS)
    if len(far) and times[far[-1]] < YEAR_NS and far[-1] + 1 < len(times) // 2:
        until = int(far[-1]) + 1
    alike = int(
        np.searchsorted(
            times,
            times[0],
            side="right",
        )
    )
    if times[0] < EPOCH_NS and 3 <= alike < len(times) and not _come_alike(times, alike):
        until = max(until, alike)
    if not until:
        return ()
    note = f"{until} of {len(times)} messages have times of before the clock was set; they were left out"
    return [(Unset(int(times[until])), note)]


def _come_alike(times: TimeArray, first: int) -> bool:
    """Whether later messages have one time in groups as large as the first, at even steps: those times are rounded."""
    changes = np.flatnonzero(np.diff(times)) + 1
    groups = np.diff(np.append(changes, len(times)))
    steps = np.diff(times[np.append(0, changes)])
    return first <= groups.max() and steps[0] <= ROUNDED_STEPS * np.median(steps)


def _unstamped(columns: JointColumns) -> Found:
    """The same of header stamps, where these are of another clock than the recorder's."""
    stamped = columns.stamp_ns != 0
    first = int(np.argmax(stamped))
    if first < 3 or not stamped.any() or abs(columns.clock_ns()) < LEAST_STEP_NS:
        return ()
    note = f"{first} of {len(stamped)} messages have no stamp, before the first that has one; they were left out"
    return [
        (
            Unset(int(columns.bag_ns[first]), stamps_too=True),
            note,
        )
    ]


def _counted(columns: JointColumns) -> Found:
    """Header stamps that are numbers of messages, beside a recorder's clock that is a clock."""
    stamps = columns.stamp_ns
    if len(stamps) < FEWEST or not stamps[1:].all() or not is_counted(np.diff(stamps)):
        return ()
    if is_counted(np.diff(columns.bag_ns)):
        return ()
    return [(StampsCount(), "header stamps are numbers of messages; times of recording were used")]


def is_counted(intervals_ns: TimeArray) -> bool:
    """Whether intervals between times are what a counter makes: one second each, to the nanosecond, shape (T,)."""
    return bool(len(intervals_ns) > 1 and np.all(intervals_ns == COUNTED_NS))


def _step_of_one(columns: JointColumns) -> Found:
    """Steps of one clock, beside the other."""
    stamped = columns.stamp_ns != 0
    if stamped.sum() < FEWEST:
        return ()
    bag_ns = columns.bag_ns[stamped]
    stamp_ns = columns.stamp_ns[stamped]
    by_bag = _steps(bag_ns, stamp_ns)
    by_stamp = _steps(stamp_ns, bag_ns)
    candidates = [each for each in (by_bag, by_stamp) if each is not None and each.whole]
    if not candidates:
        return ()
    best = min(candidates, key=lambda each: each.jumps)
    found: list[tuple[Fault, str]] = []
    for step in best.steps:
        since_s = 1e-9 * (step.at_ns - best.begin_ns)
        size = f"{1e-9 * step.by_ns:+.3g} s after {since_s:.1f} s"
        if best is by_bag:
            note = f"header stamps step by {size}, and the recorder's clock does not: the step was taken out"
            found.append((StampsStep(step.at_ns, step.by_ns), note))
        else:
            note = (
                f"the recorder's clock steps by {size}, and header stamps do not: these were used"
            )
            found.append((step, note))
    return found


@dataclass(frozen=True)
class _Steps:
    """Steps of one clock in the order of another, as if it were the recorder's."""

    steps: tuple[RecorderSteps, ...]
    begin_ns: int
    jumps: int  # how often neighbours are a step apart, in all
    whole: bool  # whether the ordering clock goes on as ever at each step


@dataclass(frozen=True)
class _Beside:
    """Times of one clock in the order of another, all [ns], shape (M,) each."""

    ordered: TimeArray  # of the clock that orders
    other: TimeArray
    ahead: TimeArray  # how far the other one is ahead, since the first message
    level: TimeArray  # the same without single late messages

    @classmethod
    def of(cls, order_ns: TimeArray, other_ns: TimeArray) -> _Beside | None:
        """None where no two neighbours are a step apart."""
        order = np.argsort(order_ns, kind="stable")
        ordered = order_ns[order]
        other = other_ns[order]
        ahead = other - ordered
        ahead -= ahead[0]
        if not np.any(np.abs(np.diff(ahead)) > LEAST_STEP_NS):
            return None
        level = running_median(ahead, NEIGHBOURS)
        return cls(ordered, other, ahead, level)

    @property
    def jumps(self) -> int:
        """How often neighbours are a step apart."""
        return int(np.sum(np.abs(np.diff(self.ahead)) > LEAST_STEP_NS))

    def bounds(self) -> list[int]:
        """Rows between which the level stays: the first, those behind each step, and the number of messages."""
        rows = np.flatnonzero(np.abs(np.diff(self.level)) > LEAST_STEP_NS) + 1
        return [
            0,
            *(int(row) for row in rows),
            len(self.level),
        ]


def _steps(order_ns: TimeArray, other_ns: TimeArray) -> _Steps | None:
    """Steps of the other clock, in the order of the first; None where there are none, or what is no step."""
    beside = _Beside.of(order_ns, other_ns)
    if beside is None:
        return None
    bounds = beside.bounds()
    if not 0 < len(bounds) - 2 <= MOST_STEPS:
        return None
    medians = [_median(beside.level[begin:end]) for begin, end in pairwise(bounds)]
    period_ns = float(np.median(np.diff(beside.ordered)))
    steps: list[RecorderSteps] = []
    taken_ns = 0
    whole = True
    for number, levels_ns in enumerate(pairwise(medians)):
        by_ns = levels_ns[1] - levels_ns[0]
        row = _step_row(beside, bounds[number + 1], *levels_ns)
        if row is None:
            continue
        gap_ns = float(beside.ordered[row] - beside.ordered[row - 1])
        whole &= gap_ns < max(PERIODS * period_ns, 0.5 * abs(by_ns))
        # as they are once the steps before are taken out
        before = beside.other[min(bounds[number], row - 1) : row] - taken_ns
        after = beside.other[row : max(bounds[number + 2], row + 1)] - taken_ns
        steps.append(
            RecorderSteps(
                int(beside.ordered[row]),
                by_ns,
                _ends(before),
                _ends(after),
            )
        )
        taken_ns += by_ns
    if not steps:
        return None
    return _Steps(
        tuple(steps),
        int(beside.ordered[0]),
        beside.jumps,
        whole,
    )


def _step_row(
    beside: _Beside,
    jump: int,
    before_ns: int,
    after_ns: int,
) -> int | None:
    """The first row behind a step between two levels; None where it is none: what comes late once and catches up."""
    by_ns = after_ns - before_ns
    at_once_ns = int(beside.level[jump] - beside.level[jump - 1])
    if abs(by_ns) < LEAST_STEP_NS or abs(by_ns - at_once_ns) > 0.25 * abs(by_ns):
        return None
    return _edge(
        beside.ahead,
        jump,
        (before_ns + after_ns) // 2,
        after_ns > before_ns,
    )


def _ends(times_ns: TimeArray) -> tuple[int, int]:
    return int(times_ns.min()), int(times_ns.max())


def _median(values: TimeArray) -> int:
    return int(np.sort(values)[len(values) // 2])


def _edge(
    ahead: TimeArray,
    row: int,
    middle: int,
    rises: bool,
) -> int:
    """The first row behind a step, near the one that the smoothed level shows."""
    near = range(
        max(row - NEIGHBOURS, 1),
        min(row + NEIGHBOURS, len(ahead)),
    )
    for candidate in near:
        if (ahead[candidate] > middle) == rises and (ahead[candidate - 1] > middle) != rises:
            return candidate
    return row


def _steps_of_both(columns: JointColumns) -> Found:
    """Steps of both clocks at once, which show in how densely messages come and in where the joints are."""
    given = np.isfinite(columns.values["position"])
    usual = given.mean(axis=0) > 0.5  # others are in messages of their own
    rows = np.flatnonzero(given[:, usual].all(axis=1))
    if not usual.any() or len(rows) < FEWEST:
        return ()
    order = rows[np.argsort(columns.bag_ns[rows], kind="stable")]
    times = columns.bag_ns[order]
    position = columns.values["position"][np.ix_(order, usual)]
    if _at_one_place(position):
        return ()
    stamps = columns.stamp_ns[order]
    beside = stamps if stamps.all() else times
    return _overlaps(times, position) or _leaps(times, beside, position)


def _at_one_place(position: FloatArray) -> bool:
    """Whether positions come back to one and the same again and again, as where a second publisher says nothing else."""
    _, which, counts = np.unique(
        position,
        axis=0,
        return_inverse=True,
        return_counts=True,
    )
    there = which.ravel() == counts.argmax()
    visits = int(np.sum(np.diff(there.astype(int)) > 0))
    moved = float(np.ptp(position, axis=0).max())
    away = np.abs(np.diff(position, axis=0)).max(axis=1) > 0.1 * moved
    return visits >= FEWEST and int(np.sum(away & (np.diff(there.astype(int)) != 0))) >= FEWEST


def _overlaps(times: TimeArray, position: FloatArray) -> Found:
    """Times that come twice: messages are as dense as of two parts, between which positions go there and back."""
    near = min(NEAR, len(times) // 8)
    took = (times[near:] - times[:-near]).astype(np.float64)
    # what few messages take outside of an overlap, however long that is
    usual = float(np.percentile(took, 95))
    crowded = np.concatenate(
        [
            took < CROWDED * usual,
            np.zeros(near, dtype=bool),
        ]
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[False], crowded, [False]]).astype(int)))
    found: list[tuple[Fault, str]] = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        first = max(int(begin) - 2, 0)
        last = min(int(end) + near, len(times) - 1)
        if last - first < 2 * near or not _two_parts(position, first, last, near):
            continue
        begin_ns = int(times[first]) - MARGIN_NS
        end_ns = int(times[last]) + MARGIN_NS
        lost = int(np.sum((times >= begin_ns) & (times <= end_ns)))
        since_s = 1e-9 * (times[last] - times[0])
        size_s = 1e-9 * (times[last] - times[first])
        note = (
            f"stamps and the recorder's clock step back by about {size_s:.2g} s after {since_s:.1f} s: the recording was cut "
            f"there, and {lost} of {len(times)} messages whose times come twice were left out"
        )
        found.append((Overlap(begin_ns, end_ns), note))
    # the last first, so that those before it keep their times
    return found[::-1] if len(found) <= MOST_CUTS else ()


def _two_parts(
    position: FloatArray,
    first: int,
    last: int,
    near: int,
) -> bool:
    """Whether rows first..last are of two parts, of which one ends there where the other one begins here."""
    inside = position[first : last + 1]
    over_one = np.abs(np.diff(inside, axis=0)).max(axis=1)
    # of two parts that come by turns, or nearly, one of the next three goes on from here
    count = len(inside) - 3
    after = []
    for ahead in (1, 2, 3):
        on = inside[ahead : ahead + count] - inside[:-3]
        after.append(np.abs(on).max(axis=1))
    goes_on = np.min(after, axis=0)
    steps = np.abs(np.diff(position, axis=0)).max(axis=1)
    outside = np.concatenate(
        [
            steps[:first],
            steps[last:],
            [0.0],
        ]
    )
    fast = float(np.percentile(outside, 95))
    there_and_back = THERE_AND_BACK * float(goes_on.mean())
    if float(over_one.mean()) < max(there_and_back, 1.5 * fast):
        return False
    starts = position[max(first - near, 0) : first + near]
    ends = position[last - near : last + near]
    apart = np.abs(starts[:, None] - ends[None]).max(axis=2)
    return bool(apart.min() <= max(3.0 * fast, COUNT_RAD))


def _leaps(times: TimeArray, stamps: TimeArray, position: FloatArray) -> Found:
    """Times in which nothing was recorded and nothing happened: the joints move before and after, and stand where they stood."""
    steps = np.diff(times)
    fast = np.percentile(
        np.abs(np.diff(position, axis=0)),
        95,
        axis=0,
    )
    long_ns = max(
        float(SURE_LEAP_NS),
        20.0 * float(np.median(steps)),
    )
    found: list[tuple[Fault, str]] = []
    # a recorder that was held up, or a simulation that paused, is one clock alone
    for row in np.flatnonzero((steps > long_ns) & (np.diff(stamps) > 0.8 * steps)):
        early = position[: row + 1]
        late = position[row + 1 :]
        if _goes_on(early, late, fast):
            by_ns = int(steps[row])
            since_ns = int(times[row] - times[0])
            back = False
        elif _goes_on(late, early, fast) and not found:
            by_ns = int(times[0] - times[-1])
            since_ns = int(times[-1] - times[row + 1])
            back = True
        else:
            continue
        note = (
            f"stamps and the recorder's clock step by {1e-9 * by_ns:+.3g} s after {1e-9 * since_ns:.1f} s, while the joints go "
            "on as if nothing had happened: the recording was cut there"
        )
        leap = Leap(
            int(times[row]),
            int(times[row + 1]),
            int(times[0]),
            int(times[-1]),
            back,
        )
        found.append((leap, note))
    return found[::-1] if len(found) <= MOST_CUTS else ()


def _goes_on(before: FloatArray, after: FloatArray, fast: FloatArray) -> bool:
    """Whether joints move where one part ends and another begins, shape (T, J), and are at the same place there."""
    steps = [
        np.diff(before[-NEAR - 1 :], axis=0),
        np.diff(after[: NEAR + 1], axis=0),
    ]
    beside = np.abs(np.vstack(steps))
    if not len(beside):
        return False
    moving = np.median(beside, axis=0) > 0.1 * fast
    close = np.abs(after[0] - before[-1]) <= 3.0 * fast + COUNT_RAD
    return bool(moving.any() and np.all(close))
