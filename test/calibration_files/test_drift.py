"""A calibration ages: what is known of friction and torque constants widens as stated, and a refresh narrows it again."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from proprio_ros.calibration_files.drift import AgeingRates, aged, ageing_note
from proprio_ros.calibration_files.pushes import Calibration, Moment
from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.inputs.forms import FormError
from proprio_ros.pipeline.calibrate import calibrate_from_bags, refresh_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.recordings.messages import RawMessage, message_types
from proprio_ros.recordings.sources import BagSource
from proprio_ros.recordings.topics import FLOAT_ARRAYS
from proprio_ros.recordings.writer import write_messages
from proprio_ros.robot import load_robot

BAGS = Path(__file__).parents[2] / "bags"
NOW_S = 1.76e9
DAY_S = 86400.0
DRIFT = AgeingRates(0.01, 0.02, 0.001, 0.002)
KEYS = (
    ("torque_constant", "joint2"),
    ("coulomb", "joint2"),
    ("torque_constant", "joint3"),
    ("viscous", "joint3"),
    ("armature", "joint3"),
)


def calibration(made: Moment | None) -> Calibration:
    stds = np.array([0.02, 0.003, 0.03, 0.002, 0.001])
    correlation = np.full((5, 5), 0.3) + 0.7 * np.eye(5)
    values = np.array([1.8, 0.05, 1.7, 0.01, 0.012])
    return Calibration(
        KEYS,
        values,
        correlation * stds[:, None] * stds,
        made=made,
    )


def growth(
    hours: float,
    warmer: dict[str, float] | None = None,
) -> np.ndarray:
    """What a covariance grows by, in units of the values."""
    old = calibration(Moment(NOW_S, dict.fromkeys(warmer or {}, 30.0)))
    now = Moment(
        NOW_S + 3600.0 * hours, {joint: 30.0 + degrees for joint, degrees in (warmer or {}).items()}
    )
    later = aged(old, DRIFT, now)
    assert np.array_equal(later.values, old.values)
    return np.asarray((later.covariance - old.covariance) / old.values[:, None] / old.values)


def test_friction_and_torque_constants_widen_as_stated() -> None:
    for hours in (1.0, 100.0):
        grown = growth(hours)
        assert np.sqrt(np.diag(grown)) == pytest.approx(
            np.array([1e-3, 1e-2, 1e-3, 1e-2, 0.0]) * np.sqrt(hours)
        )
        # half of what torque constants do they do together, and friction nothing
        assert grown[0, 2] == pytest.approx(0.5e-6 * hours)
        assert abs(grown - np.diag(np.diag(grown))).sum() == pytest.approx(2.0 * grown[0, 2])


def test_a_motor_that_is_warmer_widens_its_own_joint() -> None:
    beside = growth(1.0, {"joint3": 11.0}) - growth(1.0)
    assert np.sqrt(np.diag(beside)) == pytest.approx([0.0, 0.0, 0.02, 0.2, 0.0])
    # magnets weaken alike: one warmer and one colder go apart
    assert (
        growth(1.0, {"joint2": 11.0, "joint3": -11.0})[0, 2]
        < 0.0
        < growth(1.0, {"joint2": 11.0, "joint3": 11.0})[0, 2]
    )
    assert not (growth(1.0, {"joint3": 1.0}) - growth(1.0)).any(), "motors say whole degrees"


def test_how_often_somebody_looks_does_not_matter() -> None:
    old = calibration(Moment(NOW_S))
    once = aged(old, DRIFT, Moment(NOW_S + 5 * DAY_S))
    twice = aged(
        aged(old, DRIFT, Moment(NOW_S + DAY_S)),
        DRIFT,
        Moment(NOW_S + 5 * DAY_S),
    )
    np.testing.assert_allclose(twice.covariance, once.covariance, rtol=1e-12)
    # recorded before it was calibrated
    before = aged(
        calibration(Moment(NOW_S + 5 * DAY_S)),
        DRIFT,
        Moment(NOW_S),
    )
    np.testing.assert_allclose(before.covariance, once.covariance, rtol=1e-12)


@pytest.mark.parametrize(
    ("then", "now"),
    [
        (None, Moment(NOW_S)),
        (Moment(NOW_S), None),
        (Moment(10.0), Moment(NOW_S)),  # a simulation's clock
        (Moment(NOW_S), Moment(3600.0)),
        (Moment(NOW_S), Moment(NOW_S + 500.0)),  # one session
        (Moment(NOW_S, {"joint3": 30.0}), Moment(NOW_S, {"joint3": 31.0})),
    ],
)
def test_what_is_not_known_to_be_old_stays(then: Moment | None, now: Moment | None) -> None:
    old = calibration(then)
    assert aged(old, DRIFT, now) is old
    assert ageing_note(old, DRIFT, now) == ""


def test_what_ageing_does_is_said() -> None:
    words = ageing_note(
        calibration(Moment(NOW_S, {"joint3": 30.0})), DRIFT, Moment(NOW_S + DAY_S, {"joint3": 41.0})
    )
    assert words.startswith(
        "24 h and a motor 11 K warmer lie between the calibration and this recording: friction counts as uncertain"
    )
    assert "by 21 % and torque constants by 2.1 %" in words


def test_when_it_was_made_is_kept_in_the_file() -> None:
    made = Moment(1760000009.8, {"joint3": 34.25})
    section = calibration(made).as_settings()
    assert Calibration.from_settings(section).made == made
    del section["made"]
    assert Calibration.from_settings(section).made is None
    for wrong in (
        5.0,
        {"time_s": "today"},
        {"time_s": 1.0, "weather": "fine"},
        {"time_s": 1.0, "temperature_C": {"joint3": -400}},
    ):
        with pytest.raises(FormError, match="made: ") as caught:
            Calibration.from_settings({**section, "made": wrong})
        assert "\n" not in str(caught.value)


def test_the_robot_file_states_the_drift() -> None:
    assert load_robot("open_manipulator_x").drift == AgeingRates()
    assert load_robot(
        "open_manipulator_x", {"drift": {"friction_per_K": 0.5}}
    ).drift == AgeingRates(friction_per_K=0.5)
    with pytest.raises(RobotError, match="drift: unknown key 'friction_per_day'"):
        load_robot("open_manipulator_x", {"drift": {"friction_per_day": 0.5}})
    with pytest.raises(RobotError, match="drift: friction_per_K"):
        load_robot("open_manipulator_x", {"drift": {"friction_per_K": -0.5}})


def temperatures(
    celsius: dict[str, float],
    namespace: str = "",
) -> RawMessage:
    """What a driver says."""
    types = message_types()
    dimension, layout = (
        types.types[f"std_msgs/msg/MultiArray{kind}"] for kind in ("Dimension", "Layout")
    )
    dims = [
        dimension(
            ",".join(celsius),
            len(celsius),
            len(celsius),
        )
    ]
    message = types.types[FLOAT_ARRAYS[0]](
        layout(dims, 0),
        np.array(list(celsius.values())),
    )
    return RawMessage(
        f"{namespace}/motor_temperatures",
        FLOAT_ARRAYS[0],
        5,
        bytes(types.serialize_cdr(message, FLOAT_ARRAYS[0])),
    )


def states() -> list[RawMessage]:
    """Of a driver that has nothing else to say."""
    types = message_types()
    names = ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    kind, header, stamp = (types.types[name] for name in names)
    found = []
    for n in range(20):
        at = header(stamp(1_700_000_000, n * 10_000_000), "")
        message = kind(
            at,
            ["joint2", "joint3"],
            *[np.array([0.1, 0.2])] * 3,
        )
        found.append(
            RawMessage(
                "/joint_states",
                names[0],
                n,
                bytes(types.serialize_cdr(message, names[0])),
            )
        )
    return found


def temperatures_in(path: Path) -> dict[str, float]:
    with BagSource(path) as source:
        return source.temperatures(None)


def test_temperatures_are_read_from_a_bag(tmp_path: Path) -> None:
    said_ = [
        temperatures({"joint2": 30.0, "joint3": 34.0}),
        temperatures({"joint2": 31.0}),
        temperatures({"joint2": 99.0}, "/other"),
    ]
    write_messages(tmp_path / "bag", [*states(), *said_])
    assert temperatures_in(tmp_path / "bag") == {"joint2": 30.5, "joint3": 34.0}
    write_messages(tmp_path / "silent", states())
    assert temperatures_in(tmp_path / "silent") == {}


# ---------------------------------------------------------------------------------------------- the whole way, from bags


@pytest.fixture(scope="module")
def yesterday(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration by five empty-hand runs of the elbow, as it would be had they been made a day before."""
    path = tmp_path_factory.mktemp("yesterday") / "calibration.yaml"
    made = calibrate_from_bags(
        [bag_of(f"empty_0{n}_joint3") for n in (0, 1, 2, 4, 5)], {}, output=path
    )
    assert made.verdict.value == "accepted"
    made = f"made: {{time_s: {1760000010.0 - DAY_S}"
    older = re.sub(r"made: {time_s: [0-9.]+", made, path.read_text())
    # who changes a file on purpose deletes its digest
    path.write_text(re.sub(r" *digest: .*\n", "", older))
    return path


def bag_of(name: str) -> Path:
    return BAGS / f"realistic_s00_{name}" / "bag_mcap"


@pytest.mark.long
def test_yesterdays_calibration_weighs_with_a_wider_interval_and_says_so(
    yesterday: Path, tmp_path: Path
) -> None:
    def weighed(path: Path) -> tuple[float, float, str]:
        estimate = replay(bag_of("fixed_light_ball_20g_joint3"), Options(calibration=path))
        value = estimate.values[0]
        assert isinstance(value.value, float) and value.std is not None
        return value.value, value.std, " ".join(estimate.notes)

    timeless = tmp_path / "timeless.yaml"
    at_once = tmp_path / "at_once.yaml"
    timeless.write_text(re.sub(r"  made: .*\n", "", yesterday.read_text()))
    at_once.write_text(re.sub(r"time_s: [0-9.]+", "time_s: 1760000010.0", yesterday.read_text()))
    mass, std, notes = weighed(timeless)
    assert weighed(at_once) == (mass, std, notes), (
        "right after the calibration nothing changes, to the last bit"
    )
    _, wider, said_ = weighed(yesterday)
    assert 1.05 * std < wider < 3.0 * std
    assert "24 h lie between" in said_ and "24 h" not in notes


@pytest.mark.long
def test_a_refresh_brings_a_calibration_up_to_date(yesterday: Path, tmp_path: Path) -> None:
    output = tmp_path / "new.yaml"
    options = Options(calibration=yesterday)
    with pytest.raises(
        ConfigurationError, match="one of the runs that the calibration was made of"
    ):
        refresh_from_bags(bag_of("empty_04_joint3"), options)
    with pytest.raises(ConfigurationError, match="name the old calibration"):
        refresh_from_bags(bag_of("empty_03_joint3"), Options())
    estimate = refresh_from_bags(bag_of("empty_03_joint3"), options, output)
    assert estimate.verdict.value == "accepted" and estimate.origin["refreshed"] == str(yesterday)
    old = load_robot(yesterday)
    new = load_robot(output)
    assert (
        old.calibration is not None
        and new.calibration is not None
        and new.calibration.made is not None
    )
    assert new.calibration.made.time_s == pytest.approx(1760000010.0, abs=1.0)
    assert [len(robot.calibration.runs) for robot in (old, new) if robot.calibration] == [5, 6]
    assert new.settings["calibrated"] is True and set(new.calibration.keys) == set(
        old.calibration.keys
    )
    before = aged(old.calibration, old.drift, new.calibration.made).quantities
    for key in (("coulomb", "joint3"), ("torque_constant", "joint3")):
        assert new.calibration.quantities[key].std < before[key].std
    stds = [
        replay(bag_of("fixed_light_ball_20g_joint3"), Options(calibration=path)).values[0].std
        for path in (output, yesterday)
    ]
    assert all(isinstance(std, float) for std in stds) and stds[0] < 0.97 * stds[1]  # type: ignore[operator]


@pytest.mark.long
def test_a_calibration_that_no_longer_fits_is_said(yesterday: Path, tmp_path: Path) -> None:
    """Friction three times what it was: no drift as it is stated."""
    content = yaml.safe_load(yesterday.read_text())
    content["calibration"]["unknowns"]["coulomb[joint3]"]["value"] *= 3.0
    content["calibration"]["unknowns"]["coulomb[joint3]"]["std"] = 1e-4
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(yaml.safe_dump(content))
    estimate = refresh_from_bags(
        bag_of("empty_03_joint3"), Options(calibration=wrong), tmp_path / "new.yaml"
    )
    assert estimate.verdict.value == "rejected" and not (tmp_path / "new.yaml").exists()
    assert "no longer fits, not even with the drift" in " ".join(estimate.reasons)


@pytest.mark.long
def test_the_command_line_refreshes_into_another_folder(
    yesterday: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from proprio_ros.cli import main

    robot = tmp_path / "mine" / "mine.yaml"
    robot.parent.mkdir()
    robot.write_text("extends: open_manipulator_x\nname: mine\n")
    old = tmp_path / "mine" / "old.yaml"
    old.write_text(
        yesterday.read_text().replace("extends: open_manipulator_x", "extends: mine.yaml")
    )
    (tmp_path / "elsewhere").mkdir()
    new = tmp_path / "elsewhere" / "new.yaml"
    words = [
        "calibrate",
        str(bag_of("empty_03_joint3")),
        "--refresh",
        str(old),
        "--output",
        str(new),
    ]
    assert main(words) == 0 and load_robot(new).name == "mine"
    assert (
        main([*words, "--force", "--reference", f"{bag_of('fixed_reference_100g_joint3_x1')}=0.1"])
        == 2
    )
    assert "--refresh takes runs with an empty hand" in capsys.readouterr().err
    shutil.rmtree(old.parent)
    with pytest.raises(RobotError, match="there is no robot file"):
        load_robot(new)


@pytest.mark.long
def test_pushes_are_chosen_until_it_is_nearly_as_good_as_new(yesterday: Path) -> None:
    from proprio_ros.excitation.plans import check_sequence, load_sequence
    from proprio_ros.experiment_design.until import chosen_refresh
    from proprio_ros.pipeline.replay import aged_robot

    fresh = load_robot(yesterday)
    assert fresh.calibration is not None and fresh.calibration.made is not None
    sequence = load_sequence("empty_hand", fresh)
    made_s = fresh.calibration.made.time_s
    runs, then, now = chosen_refresh(
        fresh,
        aged_robot(
            fresh,
            Moment(made_s + 30.0 * DAY_S),
        ),
        30.0,
        sequence,
    )
    assert now > 1.1 * then and 1 <= len(runs) <= 8
    check_sequence(replace(sequence, runs=tuple(runs)), fresh)
    assert aged_robot(fresh, Moment(made_s + 60.0)) is fresh


def test_the_benchmark_draws_what_is_stated() -> None:
    from drift import drifted
    from random_arm import HiddenRobot

    rng = np.random.default_rng(1)
    hidden = HiddenRobot(coulomb=(0.05,) * 4)
    warmer = [0.0, 11.0, -11.0, 0.0]
    drawn = [drifted(hidden, DRIFT, 25.0, warmer, rng) for _ in range(2000)]
    constants = np.array([robot.torque_constant for robot in drawn]) / hidden.torque_constant[0]
    friction = np.array([robot.coulomb for robot in drawn]) / 0.05
    grown = growth(25.0, {"joint2": 11.0, "joint3": -11.0})
    # joint2 and joint3 are the second and the third
    assert np.cov(constants[:, 1], constants[:, 2]) == pytest.approx(
        grown[np.ix_([0, 2], [0, 2])], rel=0.1
    )
    assert np.std(friction[:, 1]) == pytest.approx(np.sqrt(grown[1, 1]), rel=0.1)
