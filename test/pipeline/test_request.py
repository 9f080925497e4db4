"""What is asked is read once and in one place, whoever asks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.pipeline import request as module
from proprio_ros.pipeline.calibrate import plan_excitations, refresh_from_bags
from proprio_ros.pipeline.request import (
    DEFAULT_ROBOT,
    TEXT_ROBOT,
    Options,
    Request,
    facts_of,
    read_request,
    request_of,
    robot_of,
    usable_driver,
)
from proprio_ros.probes import probe_named


def test_all_that_options_name_is_in_the_request() -> None:
    settings = {
        "robot.arm_scale": 1.1,
        "held.joint1": 0.2,
        "payload.frame": "link5",
        "payload.shape": "cube",
        "payload.size": 0.03,
    }
    request = request_of(Options(settings=settings, effort_unit="A"))
    assert (request.robot.name, request.robot.payload_frame) == (DEFAULT_ROBOT, "link5")
    assert request.robot.arm_scale.value == 1.1 and request.overrides == {"arm_scale": 1.1}
    assert request.locked == {"joint1": 0.2} and request.unit == "A" and request.driver is None
    assert (
        request.probe is probe_named("payload") and request.facts.payload.shape_std_relative == 0.0
    )


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"payload.siz": 0.03}, "payload.siz: unknown"),
        ({"held.nothing": 0.1}, "nothing"),
        ({"payload.frame": "nowhere"}, "is no link of open_manipulator_x"),
        ({"robot.arm_scal": 1.0}, "arm_scal"),
    ],
)
def test_what_nothing_understands_is_refused(
    settings: dict[str, object],
    says: str,
) -> None:
    for read in (request_of, read_request):
        with pytest.raises((ConfigurationError, RobotError), match=says):
            read(Options(settings=settings))


def test_the_profile_of_a_driver_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[object] = []
    load = module.load_driver
    monkeypatch.setattr(
        module,
        "load_driver",
        lambda name: read.append(name) or load(name),
    )
    request = request_of(Options(driver="ros2_control"))
    assert (
        request.conventions.driver == "ros2_control" and request.unit == request.driver.effort_unit
    )
    replace(request, options=replace(request.options, span=(0, None))).conventions  # noqa: B018
    assert read == ["ros2_control"]
    # whoever has a robot already gets the profile, too
    assert (
        Request(request.robot, Options(driver="ros2_control", effort_unit="mA")).unit == "mA"
        and len(read) == 2
    )


def test_a_driver_that_says_nothing_of_effort_is_refused_before_anything_is_read(
    tmp_path: Path,
) -> None:
    (tmp_path / "mine.yaml").write_text(
        "title: mine\nextends: ros2_control\nrefused: its effort is a goal\n"
    )
    assert usable_driver(None) is None
    with pytest.raises(ConfigurationError, match=r"mine.yaml: its effort is a goal"):
        usable_driver(tmp_path / "mine.yaml")
    with pytest.raises(ConfigurationError, match=r"mine.yaml: its effort is a goal"):
        request_of(Options(driver=tmp_path / "mine.yaml"))


def test_text_recordings_have_a_robot_of_their_own(tmp_path: Path) -> None:
    for name in ("trajectory.csv", "setting.json"):
        (tmp_path / name).write_text("")
    assert Options().for_recordings([tmp_path]).robot == TEXT_ROBOT
    assert Options(robot="pendulum").for_recordings([tmp_path]).robot == "pendulum"
    assert Options().for_recordings([tmp_path, tmp_path / "bag"]).robot is None


def test_of_a_robot_alone_only_what_is_about_it_is_looked_at() -> None:
    assert (
        robot_of(Options(settings={"robot.arm_scale": 1.1, "liquid.level": 0.1})).arm_scale.value
        == 1.1
    )
    with pytest.raises(RobotError, match="nothing"):
        robot_of(Options(settings={"held.nothing": 0.1}))


def test_facts_alone_need_no_robot() -> None:
    assert facts_of(probe_named("softness").facts, {"block.size": 0.02}).block.length == 0.02
    with pytest.raises(ConfigurationError, match=r"block.siz: unknown"):
        facts_of(probe_named("softness").facts, {"block.siz": 0.02})


def test_settings_that_would_be_without_effect_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"held.joint1: a plan says where every joint is"):
        plan_excitations([0.05], Options(settings={"held.joint1": 0.1}))
    options = Options(calibration=tmp_path / "old.yaml", settings={"robot.arm_scale": 1.1})
    with pytest.raises(
        ConfigurationError, match=r"robot.arm_scale: .*old.yaml says what the robot is"
    ):
        refresh_from_bags(tmp_path / "bag", options)
