"""What is read beside a push of one joint: positions, commands and efforts that are not what they seem."""

from __future__ import annotations

import numpy as np

from proprio_ros.records import FloatArray
from support.bends.bend import Draw, Right, Rng, bend, between, either_sign, one_of
from support.bends.tape import Stream, Tape

COMMANDS = "/current_command"
ZERO = r"zero|read from elsewhere|reads|stands elsewhere|off from|step|jump|slip"
COMMANDED = r"command|current"


def _recorded_joint(rng: Rng, tape: Tape) -> str:
    """Any that turns, whether it is driven or held."""
    turning = [name for name in tape.states.names if "gripper" not in name]
    return turning[int(rng.integers(len(turning)))]


def _arm(count: int) -> Draw:
    return one_of([f"joint{number}" for number in range(1, count + 1)])


def _shifted(
    tape: Tape,
    joint: str,
    by_rad: float,
    from_share: float,
) -> Tape:
    def changed(states: Stream) -> Stream:
        if joint not in states.names:
            return states
        position = states.values["position"].copy()
        late = np.arange(len(position)) >= from_share * len(position)
        position[:, states.column(joint)] += by_rad * late
        return states.with_values(position=position)

    return tape.with_states(changed)


@bend(
    "pushes",
    Right(cause=ZERO),
    needs="push",
    joint=_recorded_joint,
    zero_rad=either_sign(0.01, 0.15),
)
def push_zero_off(
    tape: Tape,
    rng: Rng,
    joint: str,
    zero_rad: float,
) -> Tape:
    """One joint is read from elsewhere in a push."""
    return _shifted(tape, joint, zero_rad, 0.0)


@bend(
    "pushes",
    Right(cause=ZERO),
    needs="push",
    joint=_recorded_joint,
    step_rad=either_sign(0.005, 0.05),
    at=between(0.1, 0.9),
)
def push_joint_steps(
    tape: Tape,
    rng: Rng,
    joint: str,
    step_rad: float,
    at: float,
) -> Tape:
    """One joint's reading steps in the middle of a push."""
    return _shifted(tape, joint, step_rad, at)


def _commands(tape: Tape, change: FloatArray | float) -> Tape:
    return tape.with_topic(
        COMMANDS, lambda stream: stream.with_values(data=stream.values["data"] * change)
    )


@bend(
    "pushes",
    Right(cause=COMMANDED),
    needs="push",
    factor=one_of((0.5, 0.7, 0.8, 0.9, 1.1, 1.25, 1.5, 2.0)),
)
def push_command_scaled(tape: Tape, rng: Rng, factor: float) -> Tape:
    """What is recorded as commanded is not what the motor was given."""
    return _commands(tape, factor)


@bend(
    "pushes",
    Right(cause=COMMANDED),
    needs="push",
    factor=one_of((0.5, 0.8, 1.25, 2.0)),
    std_A=between(0.002, 0.02),
)
def push_command_scaled_and_noisy(
    tape: Tape,
    rng: Rng,
    factor: float,
    std_A: float,
) -> Tape:
    """The same, with noise on the command, so that it never settles."""

    def changed(stream: Stream) -> Stream:
        data = factor * stream.values["data"]
        noise = std_A * rng.standard_normal(data.shape) * (data != 0.0)
        return stream.with_values(data=data + noise)

    return tape.with_topic(COMMANDS, changed)


@bend(
    "pushes",
    Right(),
    needs="push",
    std_A=between(0.002, 0.02),
)
def push_command_noisy(tape: Tape, rng: Rng, std_A: float) -> Tape:
    """The command that is recorded has noise that the motor never saw."""

    def changed(stream: Stream) -> Stream:
        data = stream.values["data"]
        return stream.with_values(
            data=data + std_A * rng.standard_normal(data.shape) * (data != 0.0)
        )

    return tape.with_topic(COMMANDS, changed)


@bend(
    "pushes",
    Right(cause=COMMANDED + "|stamp|clock|delay"),
    needs="push",
    late_s=either_sign(0.02, 0.15),
)
def push_command_late(tape: Tape, rng: Rng, late_s: float) -> Tape:
    """The command is recorded later or earlier than it was given."""
    late_ns = round(1e9 * late_s)

    def changed(stream: Stream) -> Stream:
        times_ns = stream.bag_ns + late_ns
        return Stream(**{**vars(stream), "bag_ns": times_ns, "stamp_ns": times_ns})

    return tape.with_topic(COMMANDS, changed)


@bend(
    "pushes",
    Right(cause=r"clock|stamp|Hz"),
    needs="push",
    factor=between(0.7, 1.4),
)
def push_clock_at_another_pace(tape: Tape, rng: Rng, factor: float) -> Tape:
    """All stamps and the recorder's times of a push run fast or slow."""
    from support.bends.clocks import stretched

    return stretched(tape, factor)


@bend(
    "pushes",
    Right(cause=r"step|jump|clock|stamp|order|exchanged"),
    needs="push",
    joint=_arm(4),
    other=_arm(4),
)
def push_joints_exchanged(
    tape: Tape,
    rng: Rng,
    joint: str,
    other: str,
) -> Tape:
    """The positions of two joints are exchanged."""

    def changed(states: Stream) -> Stream:
        position = states.values["position"].copy()
        one = states.column(joint)
        another = states.column(other)
        position[:, [one, another]] = position[:, [another, one]]
        return states.with_values(position=position)

    return tape.with_states(changed)
