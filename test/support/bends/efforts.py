"""Efforts that are not what they seem."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from proprio_ros.records import FloatArray
from support.bends.bend import (
    Right,
    Rng,
    a_joint,
    bend,
    between,
    either_sign,
    one_of,
    some_joints,
)
from support.bends.tape import Stream, Tape

EFFORT = r"effort|torque|current|unit|sign|friction"
GONE = r"(effort|torque|current).*(stands? still|stood still|frozen|missing|zero|is 0|drop|was lost|left out)"


def with_efforts(
    tape: Tape,
    change: Callable[[FloatArray, Stream], FloatArray],
) -> Tape:
    """Other efforts in the joint states that have any; ``change`` may write into what it is handed, shape (T, J)."""

    def changed(states: Stream) -> Stream:
        if "effort" not in states.values:
            return states
        return states.with_values(effort=change(states.values["effort"].copy(), states))

    return tape.with_states(changed)


@bend(
    "efforts",
    Right(told=True),
    samples=one_of((1, 3, 5, 10, 15)),
)
def effort_late(tape: Tape, rng: Rng, samples: int) -> Tape:
    """The effort alone comes some samples late, as from a filter or another bus."""

    def late(effort: FloatArray, _: Stream) -> FloatArray:
        effort[samples:] = effort[:-samples].copy()
        return effort

    return with_efforts(tape, late)


@bend(
    "efforts",
    Right(cause=EFFORT),
    joints=some_joints,
    factor=one_of((0.25, 0.5, 0.7, 1.3, 2, 4, 10)),
)
def joints_scaled(
    tape: Tape,
    rng: Rng,
    joints: list[str],
    factor: float,
) -> Tape:
    """The effort of some joints is in another unit, as after a change of firmware."""

    def scaled(effort: FloatArray, states: Stream) -> FloatArray:
        effort[:, [states.column(joint) for joint in joints]] *= factor
        return effort

    return with_efforts(tape, scaled)


@bend(
    "efforts",
    Right(cause=GONE),
    at=between(0.3, 0.8),
)
def effort_frozen(tape: Tape, rng: Rng, at: float) -> Tape:
    """From some moment on the effort stands still, as after a controller was switched."""

    def frozen(effort: FloatArray, _: Stream) -> FloatArray:
        first = int(at * len(effort))
        effort[first:] = effort[first]
        return effort

    return with_efforts(tape, frozen)


@bend(
    "efforts",
    Right(cause=GONE),
    at=between(0.3, 0.8),
    value=one_of((0.0, float("nan"))),
)
def effort_gone(
    tape: Tape,
    rng: Rng,
    at: float,
    value: float,
) -> Tape:
    """From some moment on the effort is 0, or NaN."""

    def gone(effort: FloatArray, _: Stream) -> FloatArray:
        effort[int(at * len(effort)) :] = value
        return effort

    return with_efforts(tape, gone)


@bend(
    "efforts",
    Right(told=True, cause=GONE),
    share=between(0.001, 0.05),
    value=one_of((0.0, float("nan"), 5e-324)),
)
def effort_drops_out(
    tape: Tape,
    rng: Rng,
    share: float,
    value: float,
) -> Tape:
    """Single samples of effort are 0, NaN or a denormal number."""

    def dropped(effort: FloatArray, _: Stream) -> FloatArray:
        effort[rng.random(len(effort)) < share] = value
        return effort

    return with_efforts(tape, dropped)


@bend(
    "efforts",
    Right(told=True),
)
def effort_tared(tape: Tape, rng: Rng) -> Tape:
    """The first sample's effort is subtracted, as of sensors that were tared with the tool on."""
    return with_efforts(tape, lambda effort, _: effort - effort[0])


@bend(
    "efforts",
    Right(cause="friction.*(fell|rose|changed)|warm"),
    share=either_sign(0.03, 0.15),
)
def friction_falls(tape: Tape, rng: Rng, share: float) -> Tape:
    """Coulomb friction changes along the recording by a share of each joint's effort, as while motors warm up."""

    def warmed(effort: FloatArray, states: Stream) -> FloatArray:
        position = states.values["position"]
        times_s = 1e-9 * (states.stamp_ns - states.stamp_ns[0])
        apart_s = times_s + 1e-6 * np.arange(len(times_s))
        rising_s = np.maximum.accumulate(apart_s)
        velocity = np.gradient(position, rising_s, axis=0)
        size = share * np.nanstd(effort, axis=0)
        along = np.linspace(0.0, 1.0, len(effort))[:, None]
        return effort - size * along * np.tanh(velocity / 0.02)

    return with_efforts(tape, warmed)


@bend(
    "efforts",
    Right(cause="warm|fell|rose|drift", codes=("other_torque",)),
    share=either_sign(0.03, 0.15),
)
def torque_falls(tape: Tape, rng: Rng, share: float) -> Tape:
    """Effort per torque changes along the recording, as while magnets warm up."""

    def fallen(effort: FloatArray, _: Stream) -> FloatArray:
        return effort * np.linspace(1.0, 1.0 - share, len(effort))[:, None]

    return with_efforts(tape, fallen)


@bend(
    "efforts",
    Right(cause=EFFORT),
    factor=between(0.4, 2.5),
)
def effort_scaled(tape: Tape, rng: Rng, factor: float) -> Tape:
    """All efforts are in another unit."""
    return with_efforts(tape, lambda effort, _: factor * effort)


@bend(
    "efforts",
    Right(told=False, cause=EFFORT),
    joint=a_joint,
)
def effort_reversed(tape: Tape, rng: Rng, joint: str) -> Tape:
    """One joint's effort is counted the other way round."""

    def reversed_(effort: FloatArray, states: Stream) -> FloatArray:
        effort[:, states.column(joint)] *= -1.0
        return effort

    return with_efforts(tape, reversed_)


@bend(
    "efforts",
    Right(cause="friction.*(fell|rose|changed)|warm"),
    current=either_sign(0.05, 0.4),
)
def friction_falls_by_a_current(tape: Tape, rng: Rng, current: float) -> Tape:
    """Coulomb friction of all joints falls along the recording by one number in the effort's unit."""

    def warmed(effort: FloatArray, states: Stream) -> FloatArray:
        times_s = 1e-9 * (states.stamp_ns - states.stamp_ns[0])
        increasing = np.maximum.accumulate(times_s) + 1e-6 * np.arange(len(times_s))
        velocity = np.gradient(
            states.values["position"],
            increasing,
            axis=0,
        )
        along = np.linspace(0.0, 1.0, len(effort))[:, None]
        return effort - current * along * np.tanh(velocity / 0.02)

    return with_efforts(tape, warmed)


@bend(
    "efforts",
    Right(cause="picked up|put down|payload|changed|controller|step"),
    at=between(0.3, 0.7),
    share=either_sign(0.1, 0.5),
)
def effort_steps(
    tape: Tape,
    rng: Rng,
    at: float,
    share: float,
) -> Tape:
    """From some moment on one offset is on each joint's effort, as of another payload set in the controller."""

    def stepped(effort: FloatArray, states: Stream) -> FloatArray:
        late = np.arange(len(effort))[:, None] >= at * len(effort)
        return effort + share * np.nanstd(effort, axis=0) * late

    return with_efforts(tape, stepped)


@bend(
    "efforts",
    Right(told=True),
    cutoff=one_of((2.0, 5.0, 10.0, 20.0)),
)
def effort_filtered(tape: Tape, rng: Rng, cutoff: float) -> Tape:
    """The driver's low-pass of first order is on the effort alone [Hz]."""
    from scipy.signal import butter, lfilter

    def filtered(effort: FloatArray, states: Stream) -> FloatArray:
        period_s = 1e-9 * float(np.median(np.diff(states.stamp_ns)))
        b, a = butter(1, 2.0 * cutoff * period_s)
        first = np.nan_to_num(effort[0])
        result: FloatArray = lfilter(b, a, effort - first, axis=0) + first
        return result

    return with_efforts(tape, filtered)
