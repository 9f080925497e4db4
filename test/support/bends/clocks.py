"""Stamps that are not when the joints were where the message says."""

from __future__ import annotations

import numpy as np

from proprio_ros.records import TimeArray
from support.bends.bend import Right, Rng, bend, between, either_sign, one_of
from support.bends.tape import Stream, Tape

CLOCK = r"clock|stamp|Hz|time (axis|scale)|faster than|slower than"


def stretched(tape: Tape, factor: float) -> Tape:
    """All times since the first are multiplied."""
    begin_ns = tape.begin_ns

    def times(times_ns: TimeArray) -> TimeArray:
        since = (times_ns - begin_ns).astype(np.float64)
        return begin_ns + np.round(factor * since).astype(np.int64)

    return tape.retimed(times)


def _velocities(tape: Tape, kind: str, factor: float) -> Tape:
    """As they were, as the stretched positions' derivative, or left out."""

    def changed(states: Stream) -> Stream:
        velocity = states.values.get("velocity")
        if velocity is None:
            return states
        if kind == "none":
            fields = {name: table for name, table in states.values.items() if name != "velocity"}
            return Stream(**{**vars(states), "values": fields})
        return states.with_values(velocity=velocity / factor if kind == "derived" else velocity)

    return tape.with_states(changed)


@bend(
    "clocks",
    Right(cause=CLOCK),
    factor=between(0.5, 2.0),
    velocity=one_of(("true", "derived", "none")),
)
def clock_at_another_pace(
    tape: Tape,
    rng: Rng,
    factor: float,
    velocity: str,
) -> Tape:
    """All stamps and the recorder's times run fast or slow, as frame / fps of a loop that runs slower."""
    return _velocities(stretched(tape, factor), velocity, factor)


@bend(
    "clocks",
    Right(cause=CLOCK),
    step_s=either_sign(0.3, 5.0),
    at=between(0.25, 0.75),
)
def clock_steps(
    tape: Tape,
    rng: Rng,
    step_s: float,
    at: float,
) -> Tape:
    """Headers and recorder step by some seconds in the middle, as when a time service corrects the clock."""
    return _stepped(tape, step_s, at, recorder=True)


@bend(
    "clocks",
    Right(cause=CLOCK),
    step_s=either_sign(0.3, 5.0),
    at=between(0.25, 0.75),
)
def header_clock_steps(
    tape: Tape,
    rng: Rng,
    step_s: float,
    at: float,
) -> Tape:
    """Headers alone step by some seconds in the middle."""
    return _stepped(tape, step_s, at, recorder=False)


@bend(
    "clocks",
    Right(told=True, cause=CLOCK),
    step_s=either_sign(0.3, 5.0),
    at=between(0.25, 0.75),
)
def recorder_clock_steps(
    tape: Tape,
    rng: Rng,
    step_s: float,
    at: float,
) -> Tape:
    """The recorder's clock alone steps by some seconds in the middle, as on a computer beside the robot."""
    return _stepped(tape, step_s, at, recorder=True, stamps=False)


def _stepped(
    tape: Tape,
    step_s: float,
    at: float,
    recorder: bool,
    stamps: bool = True,
) -> Tape:
    from_ns = tape.begin_ns + int(at * (tape.end_ns - tape.begin_ns))
    step_ns = round(1e9 * step_s)
    return tape.retimed(
        lambda times_ns: np.where(times_ns >= from_ns, times_ns + step_ns, times_ns),
        recorder=recorder,
        stamps=stamps,
    )


@bend(
    "clocks",
    Right(told=True, cause=CLOCK),
    count=one_of((20, 100, 200, 500)),
)
def stamps_of_zero_first(tape: Tape, rng: Rng, count: int) -> Tape:
    """The first messages are stamped and recorded at 0, as before simulated time is heard."""

    def zeros(times_ns: TimeArray) -> TimeArray:
        changed = times_ns.copy()
        changed[:count] = 0
        return changed

    return tape.retimed(zeros)


@bend(
    "clocks",
    Right(told=False, cause=r"row number|numbers? of rows|count|index|1 s apart|steps of 1"),
)
def row_number_for_a_time(tape: Tape, rng: Rng) -> Tape:
    """The first stamp is 0 s, the second 1 s, and so on."""

    def numbered(times_ns: TimeArray) -> TimeArray:
        rows = np.arange(len(times_ns), dtype=np.int64)
        return 10**9 * (1 + rows)

    return tape.retimed(numbered)


@bend(
    "clocks",
    Right(cause=CLOCK),
    size=one_of((5, 10, 20, 50)),
    headers=one_of((True, False)),
)
def bursts_stamped_at_arrival(
    tape: Tape,
    rng: Rng,
    size: int,
    headers: bool,
) -> Tape:
    """Messages come in bursts: the recorder, or also the header, has the time at which a burst arrived."""

    def arrived(times_ns: TimeArray) -> TimeArray:
        last = np.minimum(
            np.arange(len(times_ns)) // size * size + size - 1,
            len(times_ns) - 1,
        )
        within = np.arange(len(times_ns)) % size
        return times_ns[last] + 20_000 * within

    return tape.retimed(arrived, stamps=headers)


@bend(
    "clocks",
    Right(cause=CLOCK),
    every_ms=between(15.0, 200.0),
    scatter=between(0.0, 0.3),
)
def stamped_when_polled(
    tape: Tape,
    rng: Rng,
    every_ms: float,
    scatter: float,
) -> Tape:
    """Somebody looks every so often, hands on all that has come since, and stamps it then."""
    lasts_s = 1e-9 * (tape.end_ns - tape.begin_ns) + 2.0
    enough = int(3e3 * lasts_s / every_ms)
    between_s = 1e-3 * every_ms * (1.0 + scatter * rng.normal(size=enough))
    since_s = np.cumsum(np.maximum(between_s, 1e-4))
    polls_ns = tape.begin_ns - 10**9 + np.round(1e9 * since_s).astype(np.int64)

    def polled(times_ns: TimeArray) -> TimeArray:
        return polls_ns[np.minimum(np.searchsorted(polls_ns, times_ns), len(polls_ns) - 1)]

    return tape.retimed(polled)


@bend(
    "clocks",
    Right(),
    rate=one_of((2, 3, 5)),
    field=one_of(("position", "effort")),
)
def one_register_held(
    tape: Tape,
    rng: Rng,
    rate: int,
    field: str,
) -> Tape:
    """Positions or efforts alone are read less often than they are published."""

    def held(states: Stream) -> Stream:
        if field not in states.values:
            return states
        rows = np.arange(len(states.bag_ns)) // rate * rate
        return states.with_values(**{field: states.values[field][rows]})

    return tape.with_states(held)


@bend("clocks", Right(), rate=one_of((2, 3, 5, 10)))
def samples_held(tape: Tape, rng: Rng, rate: int) -> Tape:
    """Registers are read less often than they are published: each reading comes several times, with new stamps."""

    def held(states: Stream) -> Stream:
        rows = np.arange(len(states.bag_ns)) // rate * rate
        values = {name: table[rows] for name, table in states.values.items()}
        return states.with_values(**values)

    return tape.with_states(held)


@bend(
    "clocks",
    Right(),
    ratio=one_of((2, 3, 4)),
    at=between(0.3, 0.7),
)
def rate_changes(
    tape: Tape,
    rng: Rng,
    ratio: int,
    at: float,
) -> Tape:
    """From some moment on messages come less often."""

    def thinned(stream: Stream) -> Stream:
        number = np.arange(len(stream.bag_ns))
        late = number >= at * len(number)
        return stream.kept(~late | (number % ratio == 0))

    return Tape(
        tuple(thinned(each) for each in tape.streams),
        tape.others,
    )
