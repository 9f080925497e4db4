"""Motors that warm up along a recording are followed and named, a payload that changes at once is refused with its time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.arm_in_motion import SIX, Twin, write_robot

from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.probes.payload.moving import identify_in_motion
from proprio_ros.recordings.motions import Motion
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts

pytest.importorskip("mujoco")
LOAD_KG = 1.5
PAYLOAD = (LOAD_KG, np.array([0.03, 0.0, 0.05]))
SECONDS = 30.0


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_robot(write_robot(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(5, SIX)


@pytest.fixture(scope="module")
def motions(twin: Twin) -> tuple[Motion, Motion]:
    return twin.record(
        "loaded",
        SECONDS,
        PAYLOAD,
    ), twin.record("empty", SECONDS)


def weighed(
    robot: Robot,
    loaded: Motion,
    empty: Motion,
) -> Estimate:
    return identify_in_motion(
        robot,
        [loaded],
        [empty],
        PayloadFacts(),
    )


def off_in_sds(answer: Estimate) -> float:
    mass = answer.values[0]
    assert isinstance(mass.value, float) and isinstance(mass.std, float)
    return abs(mass.value - LOAD_KG) / mass.std


def warmed(
    motion: Motion,
    friction: float,
    torque: float,
) -> Motion:
    """Friction that falls by a share of what each joint's effort is, and torque per effort, along the recording."""
    along = motion.times_s[:, None] / motion.times_s[-1]
    velocity = np.gradient(
        motion.position,
        motion.times_s,
        axis=0,
    )
    size = friction * motion.current_A.std(axis=0)
    less_friction = size * along * np.tanh(velocity / 0.02)
    current = (1.0 - torque * along) * motion.current_A - less_friction
    return replace(motion, current_A=current)


@pytest.mark.parametrize(
    ("friction", "torque"),
    [
        (0.15, 0.0),
        (-0.15, 0.0),
        (0.4, 0.0),
        (0.0, 0.06),
        (0.0, -0.06),
    ],
)
def test_motors_that_warm_up_are_followed(
    robot: Robot,
    motions: tuple[Motion, Motion],
    friction: float,
    torque: float,
) -> None:
    loaded, empty = motions
    right = weighed(robot, loaded, empty)
    answer = weighed(
        robot,
        warmed(loaded, friction, torque),
        empty,
    )
    assert answer.verdict is Verdict.ACCEPTED, answer.reasons
    assert off_in_sds(answer) < 3.0
    what = "effort per torque" if torque else "friction"
    way = "fell" if friction + torque > 0.0 else "rose"
    assert any(what in note and way in note and "warm up" in note for note in answer.notes)
    if torque:  # nobody knows which torque the empty hand's was
        assert answer.values[0].std > right.values[0].std  # type: ignore[operator]


def test_nothing_changes_along_a_recording_of_warm_motors(
    robot: Robot, motions: tuple[Motion, Motion]
) -> None:
    answer = weighed(robot, *motions)
    assert answer.verdict is Verdict.ACCEPTED
    assert not any("along the recording" in note for note in answer.notes)


def spliced(
    first: Motion,
    second: Motion,
    at_s: float,
) -> Motion:
    """One recording until some moment, and from then on another one, half a second later."""
    before = first.times_s < at_s
    after = second.times_s >= at_s
    return replace(
        first,
        times_s=np.concatenate([first.times_s[before], second.times_s[after] + 0.5]),
        position=np.concatenate([first.position[before], second.position[after]]),
        current_A=np.concatenate([first.current_A[before], second.current_A[after]]),
    )


@pytest.mark.parametrize("at_s", [8.0, 15.0, 22.0])
@pytest.mark.parametrize("picked_up", [True, False])
def test_a_payload_that_changes_is_refused_with_its_time(
    robot: Robot,
    twin: Twin,
    motions: tuple[Motion, Motion],
    at_s: float,
    picked_up: bool,
) -> None:
    loaded, empty = motions
    other = twin.record("another empty one", SECONDS)
    changing = spliced(other, loaded, at_s) if picked_up else spliced(loaded, other, at_s)
    answer = weighed(robot, changing, empty)
    assert answer.verdict is Verdict.REJECTED
    reason = answer.reasons[0]
    assert reason.code == "changed_midway"
    words = reason.split()
    assert abs(float(words[words.index("about") + 1]) - at_s) < 2.0
    assert ("more" if picked_up else "less") in reason
    change_kg = 1e-3 * float(words[words.index("holds") + 1])
    assert abs(change_kg - LOAD_KG) < 0.3 * LOAD_KG
