"""More than one publisher of joint states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from support.bends.bend import Right, Rng, bend, between, one_of
from support.bends.tape import Stream, Tape

PUBLISHERS = r"publish|zeros|copies|twice|second|repeated"


def _beside(states: Stream, lag_ns: int) -> Stream:
    """The same messages, recorded earlier or later."""
    return replace(states, bag_ns=states.bag_ns + lag_ns)


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
    lag_us=one_of((-50, 50)),
    effort=one_of((True, False)),
)
def zeros_with_the_same_stamps(
    tape: Tape,
    rng: Rng,
    lag_us: int,
    effort: bool,
) -> Tape:
    """A second publisher sends zeros with the same stamps, before or after each message, with or without effort."""
    copy = _beside(tape.states, 1000 * lag_us)
    zeros = np.zeros_like(copy.values["position"])
    values = {"position": zeros, "effort": zeros} if effort else {"position": zeros}
    return tape.and_stream(replace(copy, values=values))


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
    rate=one_of((2, 5, 10)),
    at=between(0.2, 0.8),
)
def zeros_at_times_of_its_own(
    tape: Tape,
    rng: Rng,
    rate: int,
    at: float,
) -> Tape:
    """A second publisher sends zeros, less often and with stamps between the others'."""
    states = tape.states
    chosen = states.kept(np.arange(len(states.bag_ns)) % rate == 0)
    shift_ns = int(at * np.median(np.diff(states.bag_ns)))
    zeros = np.zeros_like(chosen.values["position"])
    other = replace(
        chosen,
        bag_ns=chosen.bag_ns + shift_ns,
        stamp_ns=chosen.stamp_ns + shift_ns,
        values={"position": zeros},
    )
    return tape.and_stream(other)


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
    samples=one_of((1, 5, 20)),
)
def stale_copies(tape: Tape, rng: Rng, samples: int) -> Tape:
    """A second publisher repeats what it heard some samples ago, with stamps of now."""
    states = tape.states
    late = {name: table[:-samples] for name, table in states.values.items()}
    shift_ns = int(0.5 * np.median(np.diff(states.bag_ns)))
    other = replace(
        states,
        bag_ns=states.bag_ns[samples:] + shift_ns,
        stamp_ns=states.stamp_ns[samples:] + shift_ns,
        values=late,
    )
    return tape.and_stream(other)


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS + "|twice"),
)
def every_message_twice(tape: Tape, rng: Rng) -> Tape:
    """Each message comes twice, as from two bridges."""
    return tape.and_stream(_beside(tape.states, 30_000))


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
)
def lists_doubled(tape: Tape, rng: Rng) -> Tape:
    """A relay appends what it heard to its own list: every joint stands twice in each message."""

    def doubled(states: Stream) -> Stream:
        tables = states.values.items()
        values = {name: np.hstack([table, table]) for name, table in tables}
        return replace(states, names=states.names * 2, values=values)

    return tape.with_states(doubled)


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
    order=one_of(("reversed", "rotated")),
)
def copies_in_another_order(tape: Tape, rng: Rng, order: str) -> Tape:
    """A second publisher repeats positions alone, its joints in another order."""
    states = tape.states
    columns = np.arange(len(states.names))
    columns = columns[::-1] if order == "reversed" else np.roll(columns, 1)
    other = replace(
        states,
        names=tuple(states.names[column] for column in columns),
        values={"position": states.values["position"][:, columns]},
        bag_ns=states.bag_ns + 40_000,
    )
    return tape.and_stream(other)


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
    rate=one_of((1, 2, 10)),
)
def another_pose(tape: Tape, rng: Rng, rate: int) -> Tape:
    """A second publisher says one pose all the time, with velocity and effort of 0."""
    states = tape.states
    chosen = states.kept(np.arange(len(states.bag_ns)) % rate == 0)
    shape = chosen.values["position"].shape
    pose = np.tile(
        np.round(
            rng.uniform(-2.0, 2.0, shape[1]),
            2,
        ),
        (shape[0], 1),
    )
    values = {
        "position": pose,
        "velocity": np.zeros(shape),
        "effort": np.zeros(shape),
    }
    shift_ns = int(0.2 * np.median(np.diff(states.bag_ns)))
    other = replace(
        chosen,
        bag_ns=chosen.bag_ns + shift_ns,
        stamp_ns=chosen.stamp_ns + shift_ns,
        values=values,
    )
    return tape.and_stream(other)


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
    second=one_of(("same", "zeros", "nothing")),
    first=one_of((True, False)),
)
def doubled_list(
    tape: Tape,
    rng: Rng,
    second: str,
    first: bool,
) -> Tape:
    """Each message names all joints twice, the second time the same, with zeros or with NaN, or the other way round."""

    def doubled(states: Stream) -> Stream:
        values = {}
        for name, table in states.values.items():
            other = {
                "same": table,
                "zeros": 0.0 * table,
                "nothing": np.full(table.shape, np.nan),
            }
            both = [other[second], table] if first else [table, other[second]]
            values[name] = np.hstack(both)
        return replace(states, names=states.names * 2, values=values)

    return tape.with_states(doubled)


@bend(
    "publishers",
    Right(told=True, cause=PUBLISHERS),
    rate=one_of((1, 3, 10)),
    arm=one_of(("zeros", "late")),
    samples=one_of((1, 10)),
)
def gripper_names_the_arm(
    tape: Tape,
    rng: Rng,
    rate: int,
    arm: str,
    samples: int,
) -> Tape:
    """The gripper's driver publishes the arm's joints, too: zeros, or what it heard some samples ago."""
    states = tape.states
    rows = np.arange(samples, len(states.bag_ns), rate)
    chosen = states.kept(np.isin(np.arange(len(states.bag_ns)), rows))
    heard = states.values["position"][rows - samples]
    finger = 0.02 + 0.01 * np.sin(1e-9 * (chosen.bag_ns - states.bag_ns[0]))
    position = np.column_stack([heard if arm == "late" else 0.0 * heard, finger])
    shift_ns = int(0.3 * np.median(np.diff(states.bag_ns)))
    other = replace(
        chosen,
        names=(*states.names, "a_finger"),
        bag_ns=chosen.bag_ns + shift_ns,
        stamp_ns=chosen.stamp_ns + shift_ns,
        values={"position": position, "effort": np.zeros_like(position)},
    )
    return tape.and_stream(other)


@bend(
    "publishers",
    Right(told=True),
    times=one_of((1, 2, 5)),
)
def gripper_publishes_more_often(tape: Tape, rng: Rng, times: int) -> Tape:
    """The gripper's driver publishes its finger on the arm's topic, so many messages for each of the arm's."""
    states = tape.states
    period_ns = int(np.median(np.diff(states.bag_ns)))
    every_ns = period_ns // times
    count = (tape.end_ns - tape.begin_ns) // every_ns
    times_ns = tape.begin_ns + every_ns // 3 + every_ns * np.arange(count)
    finger = 0.02 + 0.01 * np.sin(1e-9 * (times_ns - tape.begin_ns))[:, None]
    other = replace(
        states,
        names=("a_finger",),
        bag_ns=times_ns,
        stamp_ns=times_ns + states.stamp_ns[0] - states.bag_ns[0],
        values={"position": finger, "effort": np.zeros_like(finger)},
    )
    return tape.and_stream(other)


@bend(
    "publishers",
    Right(told=False, cause="publishers"),
    rate=one_of((1, 2)),
)
def another_arm(tape: Tape, rng: Rng, rate: int) -> Tape:
    """A second arm's driver, or somebody's sliders, publishes the same joints elsewhere, with efforts of its own."""
    states = tape.states
    chosen = states.kept(np.arange(len(states.bag_ns)) % rate == 0)
    shape = chosen.values["position"].shape
    times_s = 1e-9 * (chosen.bag_ns - states.bag_ns[0])[:, None]
    position = 1.0 + 0.5 * np.sin(
        0.3 * times_s
        + rng.uniform(
            0.0,
            6.0,
            shape[1],
        )
    )
    shift_ns = int(0.3 * np.median(np.diff(states.bag_ns)))
    other = replace(
        chosen,
        bag_ns=chosen.bag_ns + shift_ns,
        stamp_ns=chosen.stamp_ns + shift_ns,
        values={"position": position, "effort": 0.1 * position},
    )
    return tape.and_stream(other)
