"""Goals that are not what the servo heard: what drives such a joint is its gain times goal less position."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from proprio_ros.records import FloatArray
from support.bends.bend import Right, Rng, a_joint, bend, between, either_sign
from support.bends.tape import Stream, Tape

GOALS = "/joint_command"
_NAMED = r"goal|servo|delay|explain|offset|P gain|gain and"


def with_goals(
    tape: Tape,
    change: Callable[[Stream], FloatArray],
) -> Tape:
    """Other goals, shape (T, J)."""

    def changed(goals: Stream) -> Stream:
        return goals.with_values(position=change(goals))

    return tape.with_topic(GOALS, changed)


def _beyond_ends(
    tape: Tape,
    joint: str,
    share: float,
    change: Callable[[FloatArray, float, float], FloatArray],
) -> Tape:
    """Other goals of a joint, by its goals, their middle, and how far from it their ends are, a share of the range cut off."""

    def changed(goals: Stream) -> FloatArray:
        position = goals.values["position"].copy()
        column = goals.column(joint)
        mine = position[:, column]
        middle = 0.5 * (mine.max() + mine.min())
        end = 0.5 * (1.0 - share) * np.ptp(mine)
        position[:, column] = change(mine, middle, end)
        return position

    return with_goals(tape, changed)


@bend(
    "servos",
    Right(None, _NAMED),
    needs="goals",
    joint=a_joint,
    share=between(0.05, 0.3),
)
def goals_clipped(tape: Tape, rng: Rng, joint: str, share: float) -> Tape:
    """A joint's servo keeps within limits of its own, and the log has the goals that it was asked for."""

    def asked(mine: FloatArray, middle: float, end: float) -> FloatArray:
        # what was heard stays; what was asked went beyond its ends
        beyond = np.clip(np.abs(mine - middle) - end, 0.0, None)
        return mine + np.sign(mine - middle) * beyond

    return _beyond_ends(tape, joint, share, asked)


@bend(
    "servos",
    Right(None, _NAMED),
    needs="goals",
    joint=a_joint,
    share=between(0.05, 0.3),
)
def goals_logged_clipped(tape: Tape, rng: Rng, joint: str, share: float) -> Tape:
    """A log cuts a joint's goals off at its own limits, and the servo heard them whole."""

    def cut(mine: FloatArray, middle: float, end: float) -> FloatArray:
        return np.clip(mine, middle - end, middle + end)

    return _beyond_ends(tape, joint, share, cut)


@bend(
    "servos",
    Right(None, _NAMED),
    needs="goals",
    joint=a_joint,
    off_rad=either_sign(0.01, 0.15),
)
def goals_offset(tape: Tape, rng: Rng, joint: str, off_rad: float) -> Tape:
    """A joint's goals are counted from another zero than its positions."""

    def shifted(goals: Stream) -> FloatArray:
        position = goals.values["position"].copy()
        position[:, goals.column(joint)] += off_rad
        return position

    return with_goals(tape, shifted)


@bend("servos", Right(None, _NAMED), needs="goals", late_s=either_sign(0.01, 0.15))
def goals_late(tape: Tape, rng: Rng, late_s: float) -> Tape:
    """Goals are stamped so much later than the servos heard them."""

    def late(goals: Stream) -> FloatArray:
        seconds = 1e-9 * (goals.stamp_ns - goals.stamp_ns[0]).astype(np.float64)
        position = goals.values["position"]
        return np.column_stack(
            [np.interp(seconds - late_s, seconds, column) for column in position.T]
        )

    return with_goals(tape, late)


@bend("servos", Right(None, _NAMED), needs="goals", factor=between(0.6, 1.6))
def goals_lead_more(tape: Tape, rng: Rng, factor: float) -> Tape:
    """Goals lead their positions by more, or less, than the servos heard: another gain, or a supply of 7.4 V for 12."""

    def led(goals: Stream) -> FloatArray:
        states = tape.states
        position = goals.values["position"]
        columns = []
        for number, joint in enumerate(goals.names):
            mine = states.values["position"][:, states.column(joint)]
            near = np.interp(goals.stamp_ns, states.stamp_ns, mine)
            columns.append(near + factor * (position[:, number] - near))
        return np.column_stack(columns)

    return with_goals(tape, led)
