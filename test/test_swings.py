"""Free swings: torque is off from a known moment, gravity moves the joint, and positions alone weigh what it holds."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from swings import ROBOT, SPREAD_M2, URDF, as_run, facts, machine_of, released

from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.check import check_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.runs import RELEASE_S, cut_runs
from proprio_ros.recordings.signals import read_recording
from proprio_ros.recordings.topics import BOOL, JOINT_STATE
from proprio_ros.recordings.writer import write_messages
from proprio_ros.records import InputRecord, JointRecord, Recording, Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

START_NS = 1_000_000_000
MASSES_KG = (0.55, 1.0, 0.8)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder = tmp_path_factory.mktemp("swing")
    (folder / "swing.urdf").write_text(URDF)
    (folder / "swing.yaml").write_text(ROBOT)
    return load_robot(folder / "swing.yaml")


@pytest.fixture(scope="module")
def swings() -> list[tuple[np.ndarray, np.ndarray]]:
    """Of one pendulum that an independent simulation let go three times."""
    rng = np.random.default_rng(3)
    return released(
        rng,
        np.array(MASSES_KG),
        {
            **machine_of(rng),
            "coulomb": 0.1,
            "rise": 0.2,
        },
        False,
    )


@pytest.fixture(scope="module")
def runs(swings: list[tuple[np.ndarray, np.ndarray]]) -> list[Run]:
    return [as_run(f"swing {number}", *swing) for number, swing in enumerate(swings)]


def recording(
    stamps_s: np.ndarray,
    position: np.ndarray,
    off_s: float | None,
    inputs: InputRecord | None = None,
) -> Recording:
    times_ns = START_NS + np.rint(1e9 * stamps_s).astype(np.int64)
    off = () if off_s is None else ((START_NS + int(1e9 * off_s), int(times_ns[-1]) + 1),)
    return Recording(
        "bag",
        JointRecord(times_ns, ("pivot",), position[:, None]),
        inputs,
        (),
        off,
    )


def current(
    at_s: Sequence[float],
    values_A: Sequence[float],
) -> InputRecord:
    times_ns = START_NS + np.rint(1e9 * np.array(at_s)).astype(np.int64)
    return InputRecord(
        times_ns,
        ("pivot",),
        np.array(values_A)[:, None],
        "/current_command",
    )


# --- what is a swing ---------------------------------------------------------------------------------------------------


def test_a_swing_begins_after_the_servo_let_go_and_ends_where_it_hangs(
    swings: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    stamps, position = swings[0]
    (run,) = cut_runs(
        recording(stamps, position, 0.1),
        joints=["pivot"],
    )
    assert run.is_free_response and not run.input_current_A.any() and not len(run.before_times_s)
    began_s = 1e-9 * (run.onset_ns - START_NS)
    assert 0.1 + RELEASE_S <= began_s < 0.1 + RELEASE_S + 0.02
    # the second half of the recording hangs still and would only say where friction holds it
    assert (
        began_s + run.duration_s < stamps[-1] - 0.5
        and abs(run.position[-1] - np.median(position[-20:])) < 0.01
    )


def test_a_holding_current_that_ends_is_a_swing_only_where_torque_is_said_to_be_off(
    swings: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    stamps, position = swings[0]
    held = current([0.0, 0.1], [0.4, 0.0])
    (swing,) = cut_runs(
        recording(stamps, position, 0.1, held),
        joints=["pivot"],
    )
    assert swing.is_free_response
    (probe,) = cut_runs(
        recording(stamps, position, None, held),
        joints=["pivot"],
    )
    assert not probe.is_free_response and probe.input_current_A[0] == 0.4


def test_the_rest_after_a_probe_is_no_swing_though_torque_goes_off_later() -> None:
    stamps = np.arange(0.0, 3.0, 0.01)
    position = 0.5 * np.clip(stamps - 0.5, 0.0, 0.6)
    position = np.where(
        stamps > 2.0,
        position * np.cos(6.0 * (stamps - 2.0)),
        position,
    )
    driven = current([0.0, 0.5, 1.1], [0.0, 0.3, 0.0])
    (run,) = cut_runs(
        recording(stamps, position, 2.0, driven),
        joints=["pivot"],
    )
    assert not run.is_free_response and run.duration_s == pytest.approx(0.6)


def test_a_swing_ends_before_torque_comes_back(swings: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """It is said on the recorder's clock: until then the joint may have been caught for some hundredths."""
    stamps, position = swings[0]
    whole = recording(stamps, position, 0.1)
    back_ns = START_NS + 600_000_000
    (run,) = cut_runs(
        replace(
            whole,
            torque_off_ns=(
                (
                    whole.torque_off_ns[0][0],
                    back_ns,
                ),
            ),
        ),
        joints=["pivot"],
    )
    ended_s = 1e-9 * (run.onset_ns - START_NS) + run.duration_s
    assert 0.6 - RELEASE_S - 0.02 < ended_s < 0.6 - RELEASE_S


def test_a_current_that_catches_the_joint_is_no_probe(
    swings: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    stamps, position = swings[0]
    moved = np.interp(0.6, stamps, position), np.interp(0.75, stamps, position)
    assert abs(moved[0] - moved[1]) > 0.05
    off = ((START_NS + 100_000_000, START_NS + 600_000_000),)
    caught = recording(
        stamps, position, 0.1, current([0.0, 0.05, 0.1, 0.6, 0.75], [0.0, 0.01, 0.0, 0.4, 0.0])
    )
    (run,) = cut_runs(
        replace(caught, torque_off_ns=off),
        joints=["pivot"],
    )
    assert run.is_free_response
    later = recording(
        stamps, position, 0.1, current([0.0, 0.05, 0.1, 0.9, 1.05], [0.0, 0.01, 0.0, 0.4, 0.0])
    )
    assert not any(
        run.is_free_response
        for run in cut_runs(replace(later, torque_off_ns=off), joints=["pivot"])
    )


def test_what_no_torque_explains_is_refused_with_the_reason() -> None:
    stamps = np.arange(0.0, 2.0, 0.01)
    still = np.zeros_like(stamps)
    with pytest.raises(RecordingError, match=r"no joint falls by 0\.1 rad"):
        cut_runs(recording(stamps, still, 1.0), joints=["pivot"])
    with pytest.raises(RecordingError, match="only 4 joint states come while it is off"):
        cut_runs(recording(stamps, still, 1.905), joints=["pivot"])
    with pytest.raises(RecordingError, match="holds no input current"):
        cut_runs(
            recording(stamps, np.sin(stamps), None),
            joints=["pivot"],
        )
    both = np.stack(
        [np.sin(stamps), np.cos(stamps)],
        axis=1,
    )
    times_ns = START_NS + np.rint(1e9 * stamps).astype(np.int64)
    record = JointRecord(times_ns, ("pivot", "elbow"), both)
    with pytest.raises(RecordingError, match="pivot, elbow fall at once"):
        cut_runs(
            Recording(
                "bag",
                record,
                None,
                (),
                ((START_NS, int(times_ns[-1])),),
            ),
            joints=["pivot", "elbow"],
        )


@pytest.mark.parametrize("late_s", [0, 3])
def test_a_bag_says_when_torque_is_off(
    tmp_path: Path,
    swings: list[tuple[np.ndarray, np.ndarray]],
    late_s: int,
) -> None:
    """Also where most states were heard late, on a busy computer: no clock differs for that."""
    write_messages(tmp_path / "bag", released_messages(*swings[0], late_s))
    read = read_recording(
        tmp_path / "bag",
        nominal_torque_constants={},
        joint_order=["pivot"],
    )
    assert read.inputs is None and len(read.torque_off_ns) == 1
    assert 0.095 < 1e-9 * (read.torque_off_ns[0][0] - START_NS) < 0.115
    (tmp_path / "swing.urdf").write_text(URDF)
    (tmp_path / "swing.yaml").write_text(ROBOT)
    _, (check,) = check_bags(
        tmp_path / "bag",
        Options(robot=str(tmp_path / "swing.yaml")),
    )
    assert (
        check.usable == 1
        and check.runs[0].is_free_response
        and check.as_json()["runs"][0]["free_swing"] is True
    )
    assert "gravity moment over inertia, without any torque constant" in check.as_text()
    with pytest.raises(
        RecordingError, match="--probe container wants a joint that a current drives"
    ):
        replay(tmp_path / "bag", Options(probe="container", robot=str(tmp_path / "swing.yaml"), settings={
            "container.inner_size": [0.05, 0.05, 0.05], "container.mass": 0.02, "sphere.radius": 0.01,
        }))  # fmt: skip


def released_messages(
    times_s: np.ndarray,
    positions: np.ndarray,
    late_s: int,
) -> list[RawMessage]:
    """Of a joint whose torque goes off after 0.1 s, and whose states are heard late after half of that."""
    types: Any = message_types()
    time, header, state, boolean = (
        types.types[name]
        for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINT_STATE, BOOL)
    )
    messages = []
    for stamp_s, position in zip(times_s, positions, strict=True):
        time_ns = START_NS + round(1e9 * stamp_s)
        stamp = time(
            sec=time_ns // 10**9,
            nanosec=time_ns % 10**9,
        )
        # an effort of a unit that nobody stated beside it
        said = state(
            header(stamp=stamp, frame_id=""),
            ["pivot"],
            np.array([position]),
            np.zeros(1),
            np.array([7.0]),
        )
        enabled = boolean(data=bool(stamp_s < 0.1))
        heard_ns = time_ns + (late_s * 10**9 if stamp_s > 0.05 else 0)
        messages.append(
            RawMessage(
                "/joint_states",
                JOINT_STATE,
                heard_ns,
                bytes(types.serialize_cdr(said, JOINT_STATE)),
            )
        )
        messages.append(
            RawMessage(
                "/torque_enabled",
                BOOL,
                time_ns,
                bytes(types.serialize_cdr(enabled, BOOL)),
            )
        )
    return messages


# --- what it weighs ----------------------------------------------------------------------------------------------------


def known(
    runs: Sequence[Run],
    masses: Sequence[float],
) -> list[LoadedRun]:
    return [
        LoadedRun(run, KnownLoad(mass, facts())) for run, mass in zip(runs, masses, strict=True)
    ]


@pytest.mark.long
def test_two_known_loads_weigh_a_third(robot: Robot, runs: list[Run]) -> None:
    learnt = calibrate(
        robot,
        known(runs[:2], MASSES_KG[:2]),
    )
    assert learnt.verdict is Verdict.ACCEPTED and learnt.calibration is not None
    assert any("torque constant" in note for note in learnt.notes)
    estimate = weigh(
        robot.with_calibration(learnt.calibration),
        runs[2:],
        facts(),
    )
    value = estimate.values[0]
    assert (
        estimate.verdict is Verdict.ACCEPTED
        and isinstance(value.value, float)
        and isinstance(value.std, float)
    )
    assert value.value == pytest.approx(MASSES_KG[2], rel=0.02)
    assert abs(value.value - MASSES_KG[2]) < 1.96 * value.std < 0.12 * MASSES_KG[2]


@pytest.mark.long
def test_a_swing_far_lighter_than_those_of_its_calibration_is_asked_whose_it_is(
    robot: Robot,
) -> None:
    """Another servo with twice the load, or this one with half: nothing in a swing tells which."""
    rng = np.random.default_rng(3)
    machine = machine_of(rng)
    masses = (0.55, 1.0, 0.2, 0.35)
    light = [
        as_run(f"swing {n}", *swing)
        for n, swing in enumerate(released(rng, np.array(masses), machine, False))
    ]
    learnt = calibrate(
        robot,
        known(light[:2], masses[:2]),
    )
    assert learnt.calibration is not None
    calibrated = robot.with_calibration(learnt.calibration)
    estimate = weigh(calibrated, light[2:3], facts())
    assert estimate.verdict is Verdict.NOT_IDENTIFIABLE and estimate.values[0].value is None
    assert getattr(estimate.reasons[0], "code", "") == "not_covered"
    assert "lighter than 550 g" in estimate.reasons[0] and "another servo" in estimate.reasons[0]
    assert weigh(
        calibrated,
        light[3:],
        facts(),
    ).values[0].value == pytest.approx(masses[3], rel=0.05)


def another_machine(**changes: float) -> list[Run]:
    """Two swings of another pendulum than that of the fixture, in one thing or more."""
    rng = np.random.default_rng(3)
    machine = {**machine_of(rng), "coulomb": 0.1, "rise": 0.2}
    machine = {name: value * changes.get(name, 1.0) for name, value in machine.items()}
    swung = released(
        rng,
        np.array([0.7, 0.9]),
        machine,
        False,
    )
    return [as_run(f"other {number}", *swing) for number, swing in enumerate(swung)]


@pytest.mark.long
@pytest.mark.parametrize(
    "changes", [{"coulomb": 3.0}, {"armature": 0.2}, {"armature": 0.2, "coulomb": 0.3}], ids=str
)
def test_another_joint_than_the_one_that_was_calibrated_is_named(
    robot: Robot,
    runs: list[Run],
    changes: dict[str, float],
) -> None:
    learnt = calibrate(
        robot,
        known(runs[:2], MASSES_KG[:2]),
    )
    assert learnt.calibration is not None and len(learnt.calibration.own_terms) == 2
    calibrated = robot.with_calibration(learnt.calibration)
    same = weigh(calibrated, another_machine(), facts())
    assert same.verdict is Verdict.ACCEPTED, same.reasons
    for run in another_machine(**changes):
        estimate = weigh(calibrated, [run], facts())
        assert estimate.values[0].value is None
        codes = [getattr(reason, "code", "") for reason in estimate.reasons]
        assert codes[0] in ("another_joint", "not_covered")


@pytest.mark.long
def test_how_far_a_swing_leans_on_the_payload_s_inertia_is_said(
    robot: Robot,
    runs: list[Run],
) -> None:
    """A disc of 5 cm that is called a point weighs so much less, and nothing in the swing shows it."""
    learnt = calibrate(robot, known(runs[:2], MASSES_KG[:2]))
    assert learnt.calibration is not None
    calibrated = robot.with_calibration(learnt.calibration)
    point = PayloadFacts(shape=PayloadShape.from_inertia_per_mass([1e-7] * 3 + [0.0] * 3))
    answers = [weigh(calibrated, runs[2:], each) for each in (facts(), point)]
    disc_kg, point_kg = (float(each.values[0].value or 0.0) for each in answers)
    said = []
    for each in answers:
        found = re.search(r"5 cm is worth about (\d+) g", " ".join(each.assumptions))
        assert found is not None
        said.append(float(found[1]))
    # to first order, about either answer
    assert pytest.approx(0.05**2) == SPREAD_M2
    assert said[1] < 1e3 * (disc_kg - point_kg) < said[0] < 2.0 * said[1]


@pytest.mark.long
def test_an_older_calibration_does_not_say_whose_it_is(robot: Robot, runs: list[Run]) -> None:
    learnt = calibrate(
        robot,
        known(runs[:2], MASSES_KG[:2]),
    )
    assert learnt.calibration is not None
    older = replace(learnt.calibration, own_terms=())
    now, then = (
        weigh(
            robot.with_calibration(each),
            runs[2:],
            facts(),
        )
        .values[0]
        .value
        for each in (learnt.calibration, older)
    )
    assert now == then is not None


@pytest.mark.long
def test_friction_that_rises_otherwise_at_rest_counts_in_all_but_the_next_swing(
    robot: Robot, runs: list[Run]
) -> None:
    """How friction rises is not learnt from swings: what else they say is wider by that, and moves with it."""
    answers = []
    for std in (0.3, 1e-9):
        stated = robot.with_overrides(
            {"joints.pivot.drive_train.stribeck": {"value": 0.0, "std": std}}
        )
        learnt = calibrate(
            stated,
            known(runs[:2], MASSES_KG[:2]),
        )
        assert learnt.calibration is not None
        answers.append(
            (
                learnt.calibration,
                weigh(
                    stated.with_calibration(learnt.calibration),
                    runs[2:],
                    facts(),
                ),
            )
        )
    (calibration, estimate), (fixed, given) = answers
    viscous = ("viscous", "pivot")
    rise = ("stribeck", "pivot")
    assert calibration.quantities[viscous].std > 1.05 * fixed.quantities[viscous].std
    at = calibration.keys.index(viscous)
    by = calibration.keys.index(rise)
    assert abs(calibration.correlation[at, by]) > 0.2
    # the joint is the same, and so is its rise: the next swing of it is fitted given the rise, and is as certain as before
    assert estimate.values[0].value == pytest.approx(given.values[0].value, rel=1e-4)
    assert estimate.values[0].std == pytest.approx(given.values[0].std, rel=1e-2)


@pytest.mark.long
def test_the_torque_constant_does_not_matter(robot: Robot, runs: list[Run]) -> None:
    answers = []
    for constant in (1.0, {"value": 4.0, "std": 1.0}):
        stated = robot.with_overrides(
            {"joints.pivot.drive_train.torque_constant_N_m_per_A": constant}
        )
        learnt = calibrate(
            stated,
            known(runs[:2], MASSES_KG[:2]),
        )
        assert learnt.calibration is not None
        calibrated = stated.with_calibration(learnt.calibration)
        assert calibrated.is_calibrated(["pivot"])
        estimate = weigh(calibrated, runs[2:], facts())
        assert not any("torque" in source for source, _ in estimate.budget)
        answers.append(estimate.values[0].value)
    assert answers[0] == pytest.approx(answers[1], rel=1e-6)


@pytest.mark.long
def test_loads_that_are_not_as_stated_are_no_calibration(robot: Robot, runs: list[Run]) -> None:
    learnt = calibrate(
        robot,
        known(runs[:2], (MASSES_KG[0], 0.3)),
    )
    assert learnt.verdict is not Verdict.ACCEPTED


def test_without_a_calibration_a_swing_tells_no_mass(robot: Robot, runs: list[Run]) -> None:
    """With priors around zero the fit goes to a mass of nothing, and its interval is as narrow as it is wrong."""
    estimate = weigh(robot, runs[2:], facts())
    assert estimate.verdict is Verdict.NOT_IDENTIFIABLE and estimate.values[0].value is None
    assert any("gravity moment over inertia" in reason for reason in estimate.reasons)


def test_swings_and_driven_probes_are_given_apart(robot: Robot, runs: list[Run]) -> None:
    driven = replace(
        runs[1], name="driven", source="/current_command", input_current_A=np.array([0.3])
    )
    with pytest.raises(RecordingError, match="give them apart"):
        weigh(robot, [runs[0], driven], facts())
    with pytest.raises(RecordingError, match="give them apart"):
        calibrate(
            robot,
            known([runs[0], driven], MASSES_KG[:2]),
        )


# --- real servos -------------------------------------------------------------------------------------------------------

REAL_KG = (0.535, 0.741, 0.969, 1.168)
REAL: dict[str, Any] = {
    "payload.com": [0.0, 0.0, 0.0],
    "payload.inertia_per_mass": [0.00255, 0.00255, 0.00255, 0.0, 0.0, 0.0],
}


@pytest.mark.parametrize(
    "calibrating",
    [
        (0, 3),
        *(
            pytest.param(c, marks=pytest.mark.long)
            for c in itertools.combinations(range(4), 2)
            if c != (0, 3)
        ),
        *(pytest.param(c, marks=pytest.mark.long) for c in itertools.combinations(range(4), 3)),
    ],
    ids=str,
)
def test_a_real_servo_that_lets_go_weighs(
    shared: Path, tmp_path: Path, calibrating: tuple[int, ...]
) -> None:
    bags = [shared / "recordings_real" / f"sts3215_release_{mass:.3f}kg" for mass in REAL_KG]
    if not bags[0].exists():
        pytest.skip("needs the real recordings")
    (tmp_path / "swing.urdf").write_text(
        URDF.replace('value="0.03"', 'value="0.001"').replace("1e-5", "1e-7")
    )
    file = tmp_path / "swing.yaml"
    file.write_text(ROBOT.replace("pivot:", "pendulum:") + "gravity: [0.0, 0.0, -9.80496]\n")
    (tmp_path / "swing.urdf").write_text(
        (tmp_path / "swing.urdf").read_text().replace('"pivot"', '"pendulum"')
    )
    output = tmp_path / "calibrated.yaml"
    options = Options(robot=str(file), settings=dict(REAL))
    learnt = calibrate_from_bags(
        [],
        {bags[n]: REAL_KG[n] for n in calibrating},
        options,
        output,
    )
    assert learnt.verdict is Verdict.ACCEPTED
    for number in set(range(4)) - set(calibrating):
        asked = Options(calibration=output, settings=dict(REAL))
        value = replay(bags[number], asked).values[0]
        assert isinstance(value.value, float) and isinstance(value.std, float)
        assert value.value == pytest.approx(REAL_KG[number], rel=0.05)
        assert abs(value.value - REAL_KG[number]) < 1.96 * value.std < 0.1 * REAL_KG[number]


@pytest.mark.parametrize(
    ("calibrated", "asked"),
    [("sts3215_release", "sts3250_release"), ("sts3250_release", "sts3215_release")],
)
def test_a_real_servo_by_another_one_s_calibration_is_named(
    shared: Path, tmp_path: Path, calibrated: str, asked: str
) -> None:
    folder = shared / "recordings_real"
    if not folder.exists():
        pytest.skip("needs the real recordings")
    length_m = 0.15 if "3250" in calibrated else 0.1
    (tmp_path / "swing.urdf").write_text(
        URDF.replace('value="0.03"', 'value="0.001"')
        .replace("1e-5", "1e-7")
        .replace('"pivot"', '"pendulum"')
        .replace('xyz="0 0 -0.1"', f'xyz="0 0 -{length_m}"')
    )
    file = tmp_path / "swing.yaml"
    file.write_text(ROBOT.replace("pivot:", "pendulum:") + "gravity: [0.0, 0.0, -9.80496]\n")
    output = tmp_path / "calibrated.yaml"
    references = {folder / f"{calibrated}_{kg:.3f}kg": kg for kg in (REAL_KG[0], REAL_KG[2])}
    learnt = calibrate_from_bags(
        [],
        references,
        Options(
            robot=str(file),
            settings=dict(REAL),
        ),
        output,
    )
    assert learnt.verdict is Verdict.ACCEPTED
    for kg in REAL_KG:
        bag = folder / f"{asked}_{kg:.3f}kg"
        estimate = replay(
            bag,
            Options(calibration=output, settings=dict(REAL)),
        )
        assert estimate.values[0].value is None
        assert getattr(estimate.reasons[0], "code", "") == "another_joint"


def test_the_same_swing_is_not_given_twice(shared: Path, tmp_path: Path) -> None:
    bag = shared / "recordings_real" / "sts3215_release_0.535kg"
    if not bag.exists():
        pytest.skip("needs the real recordings")
    with pytest.raises(ConfigurationError, match="name each recording once"):
        replay([bag, bag], Options(robot="pendulum"))
