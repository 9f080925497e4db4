"""Free swings on the virtual arm: MuJoCo moves the hand, and shares no line with what foretells and catches its swing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from support.hand import JOINTS, PERIOD_S, RATE_HZ, ROBOT, Hand

from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation import machine as machine_module
from proprio_ros.excitation.commands import Command, JointSample
from proprio_ros.excitation.guards import Guards, free_swing
from proprio_ros.excitation.machine import (
    CAUGHT_RAD_S,
    LET_GO_S,
    LONGEST_CATCH_S,
    ExcitationMachine,
    Phase,
)
from proprio_ros.excitation.plans import (
    LEAST_CURRENT_A,
    ExcitationRun,
    ExcitationSequence,
    load_sequence,
)
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.recordings.runs import MOVING_SPAN, cut_runs
from proprio_ros.records import InputRecord, JointRecord, Recording

WRIST = "joint4"
SEQUENCE = load_sequence("free_swing", ROBOT)
ONCE = replace(
    SEQUENCE,
    runs=(
        replace(
            SEQUENCE.runs[0],
            duration_s=1.5,
        ),
    ),
    settle_s=0.3,
)
LOOSE_N_M = 0.01
"""Coulomb friction of an arm whose wrist swings to and fro for some seconds."""


@dataclass(frozen=True)
class Tick:
    phase: Phase
    command: Command
    sample: JointSample
    true_rad_s: float  # speed of the wrist


def swung(
    sequence: ExcitationSequence = ONCE,
    coulomb: float | None = LOOSE_N_M,
    guards: Guards | None = None,
    seed: int = 1,
    meddle: Callable[
        [ExcitationMachine, JointSample], JointSample | None
    ] = lambda machine, sample: sample,
) -> tuple[ExcitationMachine, list[Tick], Hand]:
    """The machine at its end, and half a second more; the arm stands at the first start already."""
    hand = Hand(seed, None, coulomb)
    hand.arm.set_position(sequence.runs[0].start)
    here = hand.sample().position
    hand.waiting = type(hand.waiting)([Command(dict(here))] * len(hand.waiting))
    machine = ExcitationMachine(ROBOT, guards)
    sample = hand.sample()
    machine.start(sequence, sample)
    ticks: list[Tick] = []
    after = 20
    while machine.busy or after:
        after -= not machine.busy
        command = machine.tick(hand.time_s, meddle(machine, sample))
        assert not command.position.keys() & command.current_A.keys()
        assert command.position.keys() | command.current_A.keys() == set(JOINTS)
        assert bool(command.current_A) == (machine.phase in (Phase.PROBE, Phase.CATCH))
        assert all(
            abs(current) <= ROBOT.motors[WRIST].current_limit_A
            for current in command.current_A.values()
        )
        ticks.append(
            Tick(
                machine.phase,
                command,
                sample,
                float(hand.arm.velocity_rad_s()[JOINTS.index(WRIST)]),
            )
        )
        sample = hand.step(command)
    return machine, ticks, hand


def assert_held_at_last(machine: ExcitationMachine, ticks: list[Tick]) -> None:
    """All joints have a place, and stand there."""
    assert not machine.busy
    assert ticks[-1].command == Command(dict(machine.command.position))
    assert abs(ticks[-1].true_rad_s) < 0.02
    for name, goal in machine.command.position.items():
        assert ticks[-1].sample.position[name] == pytest.approx(goal, abs=0.05), name


def last_of(ticks: list[Tick], phase: Phase) -> Tick:
    return next(tick for tick in reversed(ticks) if tick.phase is phase)


# --- what is foretold ----------------------------------------------------------------------------------------------------


def test_gravity_and_inertia_are_those_of_another_simulator() -> None:
    """Of a wrist without friction, from rest: its acceleration, and where it turns back."""
    hand = Hand(1, None, 0.0)
    truth = hand.arm.truth
    joint = replace(
        truth.joints[WRIST],
        viscous=0.0,
        load_friction=0.0,
        stribeck=0.0,
    )
    hand.arm.truth = truth = replace(
        truth, joints={**truth.joints, WRIST: joint}, links={}, arm_scale=ROBOT.arm_scale.value
    )
    arm = type(hand.arm)(
        ROBOT,
        truth,
        position=SEQUENCE.runs[0].start,
        control_period_s=PERIOD_S,
    )
    start = SEQUENCE.runs[0].start[WRIST]
    swing = free_swing(
        ROBOT, WRIST, {name: arm.position()[name] for name in ROBOT.model.independent_joints}
    )
    row = JOINTS.index(WRIST)
    goals = arm.shaft_rad()
    turned = start
    fastest = 0.0
    for _ in range(2000):
        current = np.clip(
            200.0 * (goals - arm.shaft_rad()) - 10.0 * arm.velocity_rad_s(), -20.0, 20.0
        )
        current[row] = 0.0
        arm.step(current)
        turned = max(turned, arm.shaft_rad()[row])
        fastest = max(fastest, arm.velocity_rad_s()[row])
    assert turned == pytest.approx(swing.way(start)[-1], abs=0.02)
    assert fastest == pytest.approx(
        swing.speed_at(
            swing.rest,
            start,
            joint.armature,
        ),
        rel=0.02,
    )


def test_a_swing_that_would_leave_the_limits_is_refused_before_anything_moves() -> None:
    def refused(
        words: str,
        start: dict[str, float],
        joint: str = WRIST,
        guards: Guards | None = None,
        **more: float,
    ) -> None:
        run = ExcitationRun(joint, 0.0, 2.0, start)
        machine = ExcitationMachine(ROBOT, guards)
        with pytest.raises(ExcitationError, match=words):
            machine.start(
                replace(ONCE, runs=(run,), **more),
                Hand(1, None).sample(),
            )
        assert machine.phase is Phase.IDLE
        assert not machine.command.current_A

    high = {"joint2": 0.0, "joint3": 0.42}
    refused(
        r"would hang at 2\.66 rad, outside -1\.65 \.\. 1\.92 ",
        {"joint2": -0.6, "joint3": -0.4, WRIST: 0.6},
    )
    refused(r"may swing past .* start nearer to where it hangs", {**high, WRIST: 0.4})
    refused(
        r"gravity pulls with 0\.0\d+ N m, and its friction is probably 0\.064 N m",
        {**high, WRIST: 1.0},
    )
    refused(
        r"would come .* cm above the base's plane", {**high, WRIST: 0.62}, min_clearance_m=0.029
    )
    refused(
        r"may reach \d\.\d rad/s",
        {**high, WRIST: 0.62},
        guards=Guards(max_velocity_rad_s=2.0),
    )
    refused("gravity does not move joint1", high, "joint1")


def test_a_stronger_friction_that_is_known_is_refused_and_a_weaker_one_is_not() -> None:
    run = ExcitationRun(
        WRIST,
        0.0,
        2.0,
        {"joint2": 0.0, "joint3": 0.42, WRIST: 0.9},
    )
    for coulomb, words in ((0.06, "friction is probably 0.06 N m"), (0.02, "")):
        robot = ROBOT.with_overrides(
            {f"joints.{WRIST}.drive_train.coulomb_N_m": {"value": coulomb, "std": 0.001}}
        )
        machine = ExcitationMachine(robot)
        sequence = replace(ONCE, runs=(run,))
        if words:
            with pytest.raises(ExcitationError, match=words):
                machine.start(sequence, Hand(1, None).sample())
        else:
            machine.start(sequence, Hand(1, None).sample())
            assert machine.busy


def test_swings_and_pushes_are_sequences_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    swing = "{joint: joint4, current_A: 0, duration_s: 2.0}"
    for lines, words in (
        (
            [swing, "{joint: joint4, current_A: -0.1, duration_s: 0.6}"],
            "run 1 swings freely .* make a sequence of each",
        ),
        (
            ["{joint: joint4, current_A: 0, duration_s: 2.0, max_current_A: 0.1}"],
            "has no max_current_A",
        ),
        (
            ["{joint: gripper_left_joint, current_A: 0, duration_s: 2.0}"],
            "gripper_left_joint slides",
        ),
    ):
        path.write_text(
            "excitation:\n  hand: any\n  runs:\n" + "".join(f"    - {line}\n" for line in lines)
        )
        with pytest.raises(ConfigurationError, match=words):
            load_sequence(path, ROBOT)


# --- how it goes ---------------------------------------------------------------------------------------------------------


def test_a_swing_lets_go_with_next_to_nothing_and_all_others_are_held() -> None:
    machine, ticks, _ = swung()
    assert machine.phase is Phase.DONE
    assert machine.message == "free_swing is done: all 1 runs are good"
    (outcome,) = machine.outcomes
    assert (
        outcome.ended_by == "time"
        and outcome.used
        and outcome.current_A == 0.0
        and outcome.travel > 0.7
    ), outcome
    currents = [tick.command.current_A[WRIST] for tick in ticks if tick.phase is Phase.PROBE]
    opening = round(LET_GO_S * RATE_HZ)
    # against gravity: the driver lets go only of what it has driven
    assert currents[:opening] == [-LEAST_CURRENT_A] * opening
    assert not any(currents[opening:])
    assert len(currents) == round(1.5 * RATE_HZ)
    held = [tick.command.position for tick in ticks if tick.phase is Phase.PROBE]
    assert all(goals == held[0] and WRIST not in goals for goals in held)
    assert_held_at_last(machine, ticks)


LONG = pytest.mark.long


@pytest.mark.parametrize(
    "duration_s", [0.5, *(pytest.param(s, marks=LONG) for s in (0.35, 0.65, 0.8, 1.1))]
)
def test_a_joint_is_caught_without_a_jerk_wherever_it_is(duration_s: float) -> None:
    """In full fall, at the turn, on the way back: no torque jumps, and the position servo takes over a joint that stands."""
    machine, ticks, _ = swung(replace(ONCE, runs=(replace(ONCE.runs[0], duration_s=duration_s),)))
    assert machine.phase is Phase.DONE
    catch = [tick for tick in ticks if tick.phase is Phase.CATCH]
    after = ticks[ticks.index(catch[-1]) + 1]
    assert 2 <= len(catch) <= LONGEST_CATCH_S * RATE_HZ
    assert abs(after.true_rad_s) < 2.0 * CAUGHT_RAD_S
    assert abs(catch[0].command.current_A[WRIST]) < 1e-9
    speeds = [abs(tick.true_rad_s) for tick in catch]
    # gravity goes on for the one or two cycles that the catch takes to come
    assert max(speeds) < speeds[0] + 0.3
    # held where it stopped, and it stays there
    end = after.command.position[WRIST]
    places = [tick.sample.position[WRIST] for tick in ticks[ticks.index(after) + 2 :]]
    assert max(abs(place - end) for place in places) < 0.03
    assert_held_at_last(machine, ticks)


def test_a_stuck_joint_is_not_said_to_have_swung() -> None:
    machine, ticks, _ = swung(coulomb=0.12)
    assert machine.phase is Phase.DONE
    assert "run 1 moved too little" in machine.message
    assert not machine.outcomes[0].used
    assert len(machine.outcomes) == 1
    assert_held_at_last(machine, ticks)


# --- what goes wrong -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ended_by", "guards", "least_m"),
    [
        ("velocity", Guards(max_velocity_rad_s=1.2), 0.02),
        ("limit", Guards(limit_margin_rad=0.5), 0.02),
        ("clearance", Guards(), 0.034),
    ],
)
def test_a_guard_catches_the_joint_and_ends_the_sequence(
    ended_by: str, guards: Guards, least_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a hand that is not as the machine takes it to be: what it foretells is switched off."""
    monkeypatch.setattr(machine_module, "check_free_response", lambda *_: None)
    sequence = replace(ONCE, min_clearance_m=least_m, approach_velocity=0.6)
    machine, ticks, _ = swung(sequence, guards=guards)
    assert machine.phase is Phase.ABORTED
    assert machine.aborted_by == ended_by
    assert [(outcome.ended_by, outcome.used) for outcome in machine.outcomes] == [(ended_by, False)]
    catch = [tick for tick in ticks if tick.phase is Phase.CATCH]
    assert len(catch) >= 2
    assert abs(catch[0].command.current_A[WRIST]) < 1e-9
    assert abs(ticks[ticks.index(catch[-1]) + 1].true_rad_s) < 2.0 * CAUGHT_RAD_S
    assert_held_at_last(machine, ticks)
    limits = ROBOT.model.joint(WRIST)
    assert limits.lower < min(tick.sample.position[WRIST] for tick in ticks)
    assert max(tick.sample.position[WRIST] for tick in ticks) < limits.upper


def test_a_joint_that_is_caught_too_late_is_held_at_its_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing brakes it: the catch commands the current, and the motor gives none."""
    monkeypatch.setattr(machine_module, "check_free_response", lambda *_: None)
    monkeypatch.setattr("proprio_ros.excitation.machine.CATCH_TIME_S", 1e9)
    start = {"joint2": 0.0, "joint3": 0.42, WRIST: 0.1}
    run = replace(ONCE.runs[0], start=start)
    machine, ticks, _ = swung(
        replace(
            ONCE,
            runs=(run,),
            approach_velocity=0.6,
        ),
        guards=Guards(limit_margin_rad=0.3),
    )
    assert machine.phase is Phase.ABORTED
    assert machine.aborted_by == "limit"
    assert_held_at_last(machine, ticks)


def at(
    seconds: float,
    phase: Phase = Phase.PROBE,
) -> Callable[[ExcitationMachine], bool]:
    """Once, so long after a phase began."""
    seen = [0]

    def now(machine: ExcitationMachine) -> bool:
        seen[0] += machine.phase is phase
        return seen[0] == round(seconds * RATE_HZ)

    return now


@pytest.mark.parametrize("phase", [Phase.PROBE, Phase.CATCH])
@pytest.mark.parametrize(
    "mishap",
    ["abort", "jump", *(pytest.param(m, marks=LONG) for m in ("sample", "held joint", "clock"))],
)
def test_what_makes_positions_unknown_or_an_abort_holds_at_once(mishap: str, phase: Phase) -> None:
    sequence = replace(
        ONCE,
        runs=(
            replace(
                ONCE.runs[0],
                duration_s=0.5,
            ),
        ),
    )
    due = at(0.4 if phase is Phase.PROBE else 0.05, phase)
    done: list[bool] = []

    def meddle(machine: ExcitationMachine, sample: JointSample) -> JointSample:
        if done or not due(machine):
            return sample
        done.append(True)
        if mishap == "abort":
            machine.abort("by hand")
            return sample
        if mishap == "clock":
            return replace(sample, time_s=sample.time_s - 1.0)
        change = {
            "jump": (WRIST, 1.0),
            "sample": (WRIST, float("nan")),
            "held joint": ("joint3", 0.2),
        }[mishap]
        return replace(
            sample,
            position={
                **sample.position,
                change[0]: sample.position[change[0]] + change[1],
            },
        )

    machine, ticks, _ = swung(sequence, meddle=meddle)
    assert done
    assert machine.phase is Phase.ABORTED
    assert machine.aborted_by == mishap
    first = next(tick for tick in ticks if tick.phase is Phase.ABORTED)
    assert not first.command.current_A
    assert set(first.command.position) == set(JOINTS)
    assert not any(tick.command.current_A for tick in ticks[ticks.index(first) :])
    if mishap not in ("jump", "held joint"):
        assert_held_at_last(machine, ticks)


@pytest.mark.long
def test_a_lost_bus_in_a_swing_holds_it_and_it_is_made_again() -> None:
    due = at(0.4)
    lost = [0]

    def meddle(machine: ExcitationMachine, sample: JointSample) -> JointSample | None:
        lost[0] += bool(lost[0]) or due(machine)
        return None if 0 < lost[0] <= 8 else sample

    machine, ticks, _ = swung(meddle=meddle)
    assert machine.phase is Phase.DONE
    assert [(outcome.ended_by, outcome.used) for outcome in machine.outcomes] == [
        ("stale", False),
        ("time", True),
    ]
    silent = next(tick for tick in ticks if tick.phase is Phase.BRAKE)
    assert not silent.command.current_A
    assert_held_at_last(machine, ticks)


def test_a_bus_that_stays_away_ends_it_held() -> None:
    due = at(0.4)
    lost = [0]

    def meddle(machine: ExcitationMachine, sample: JointSample) -> JointSample | None:
        lost[0] += bool(lost[0]) or due(machine)
        return None if lost[0] else sample

    machine, ticks, _ = swung(meddle=meddle)
    assert machine.phase is Phase.ABORTED
    assert machine.aborted_by == "stale"
    assert not machine.command.current_A
    assert set(machine.command.position) == set(JOINTS)
    assert all(not tick.command.current_A for tick in ticks[-20:])


def test_a_pause_while_it_is_caught_holds_it_and_costs_nothing() -> None:
    due = at(0.05, Phase.CATCH)
    lost = [0]

    def meddle(machine: ExcitationMachine, sample: JointSample) -> JointSample | None:
        lost[0] += bool(lost[0]) or due(machine)
        return None if 0 < lost[0] <= 8 else sample

    machine, ticks, _ = swung(
        replace(
            ONCE,
            runs=(
                replace(
                    ONCE.runs[0],
                    duration_s=0.5,
                ),
            ),
        ),
        meddle=meddle,
    )
    assert machine.phase is Phase.DONE
    assert [outcome.used for outcome in machine.outcomes] == [True]
    assert_held_at_last(machine, ticks)


# --- what it tells -------------------------------------------------------------------------------------------------------


def recorded(ticks: list[Tick]) -> Recording:
    """What a recorder gets of our driver: joint states, what it drives them with, and when a joint is without torque."""
    stamps = np.array([round(1e9 * tick.sample.time_s) for tick in ticks])
    positions = np.array([[tick.sample.position[name] for name in JOINTS] for tick in ticks])
    applied = np.array(
        [[tick.command.current_A.get(name, 0.0) for name in JOINTS] for tick in ticks]
    )
    off: list[tuple[int, int]] = []
    begin = None
    for stamp, tick in zip(stamps.tolist(), ticks, strict=True):
        limp = tick.command.current_A.get(WRIST) == 0.0
        if limp and begin is None:
            begin = stamp
        elif not limp and begin is not None:
            off.append((begin, stamp))
            begin = None
    inputs = InputRecord(stamps, JOINTS, applied, "/applied_effort")
    return Recording(
        "bag",
        JointRecord(stamps, JOINTS, positions),
        inputs,
        (),
        tuple(off),
    )


def test_what_lets_go_and_what_catches_are_no_probes() -> None:
    short = replace(ONCE.runs[0], duration_s=0.5)
    _, ticks, _ = swung(replace(ONCE, runs=(short,)))
    recording = recorded(ticks)
    caught = [tick.sample.position[WRIST] for tick in ticks if tick.phase is Phase.CATCH]
    assert caught[0] + 2.0 * MOVING_SPAN < max(caught), (
        "it is moved by a current while it is caught"
    )
    runs = cut_runs(recording, joints=JOINTS)
    assert [(run.joint, run.is_free_response) for run in runs] == [(WRIST, True)]
    began = next(tick.sample for tick in ticks if tick.phase is Phase.PROBE)
    assert 0.09 < 1e-9 * runs[0].onset_ns - began.time_s < 0.16
    assert runs[0].duration_s < 0.5
    # without the word that torque is off, a zero current may as well be that of a joint that is held
    assert not any(
        run.is_free_response
        for run in cut_runs(replace(recording, torque_off_ns=()), joints=JOINTS)
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "seed", [0, 2, 11], ids=["rises by 0.7 at rest", "falls by 0.14 rad", "search that stops early"]
)
def test_swings_of_a_virtual_arm_tell_its_friction_and_its_rotor(seed: int) -> None:
    """The joint's friction rises towards standstill as the file does not say; nothing that is stated may be wrong for that.

    Two and a half standard deviations: the rise of the first is 2.3 of the file's off. Before the rise counted, its viscous
    friction was 5.7 off; the third's rotor was twice too heavy, where the search had not arrived.
    """
    machine, ticks, hand = swung(
        SEQUENCE,
        coulomb=None,
        seed=seed,
    )
    assert machine.phase is Phase.DONE
    assert all(outcome.used for outcome in machine.outcomes)
    learnt = calibrate(
        ROBOT,
        [LoadedRun(run) for run in cut_runs(recorded(ticks), joints=JOINTS)],
    )
    assert learnt.verdict.value == "accepted"
    assert len(learnt.run_fits) == 4
    truth = hand.arm.truth.joints[WRIST]
    found = {row.kind: row for row in learnt.unknowns if row.scope == WRIST}
    for kind in ("coulomb", "viscous", "armature"):
        row = found[kind]
        assert abs(row.value - getattr(truth, kind)) < 2.5 * row.std, kind
    for kind in ("coulomb", "armature"):
        assert 3.0 * found[kind].std < 0.75 * found[kind].prior_std, kind
