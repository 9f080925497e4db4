"""Parts of the pendant, without browser and nodes: lease, news and their words, facts that are typed, what will move, answers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.pushes import AWAY, one_push

from proprio_ros.addons.pendant import words
from proprio_ros.addons.pendant.calls import Call
from proprio_ros.addons.pendant.lease import SILENCE_S, Lease
from proprio_ros.addons.pendant.news import CURVE_S, Held, News, Said, curve_of
from proprio_ros.addons.pendant.results import answer, figures_of, folder_of, report_of
from proprio_ros.addons.pendant.tasks import LACKS, filled, settings_of, tasks, ways_of, what_moves
from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.interface import services
from proprio_ros.robot import load_robot
from proprio_ros.robot.new_file import new_robot_file

REPOSITORY = Path(__file__).resolve().parents[3]


class Hand:
    """A clock that is set by hand [s]."""

    def __init__(self) -> None:
        self.at_s = 100.0

    def __call__(self) -> float:
        return self.at_s


def estimate(mass: float, low: float, high: float, **more: str) -> Said:
    values = {
        "payload_mass": repr(mass),
        "payload_mass.unit": "kg",
        "payload_mass.std": repr((high - low) / 3.92),
        "payload_mass.ci95": f"[{low}, {high}]",
        **more,
    }
    return Said(0, "payload", "", values)


def test_one_page_holds_the_arm_until_it_is_silent() -> None:
    clock = Hand()
    lease = Lease(clock)
    assert lease.holder == ""
    assert lease.take("a") and lease.holder == "a"
    assert not lease.take("b")
    clock.at_s += SILENCE_S
    lease.hear("b")
    assert lease.holder == "a"
    lease.hear("a")
    clock.at_s += SILENCE_S + 0.1
    assert lease.holder == ""
    lease.hear("a")
    assert lease.holder == "", "it does not come back by talking"
    assert lease.take("b") and not lease.take("a")
    lease.give_up("a")
    assert lease.holder == "b"
    lease.give_up("b")
    assert lease.take("a")


def test_old_news_is_old() -> None:
    clock = Hand()
    news = News(clock)
    assert "never" in words.lights(news)
    news.hear_states(["joint1"], [0.5], [])
    assert not news.is_old("states") and 'class="old"' not in words.joints(news)
    clock.at_s += 5.0
    assert news.is_old("states") and 'class="old"' in words.joints(news)
    assert "5 s ago" in words.lights(news)
    news.hear_estimate(estimate(0.05, 0.045, 0.055, running="true", final="false"))
    assert 'class="number"' in words.hand(news)
    clock.at_s += 3.0
    assert 'class="number old"' in words.hand(news) and "3 s ago" in words.hand(news)


def test_the_curve_has_the_last_minute_and_an_answer_stands() -> None:
    clock = Hand()
    news = News(clock)
    for mass in (0.05, 0.051):
        news.hear_estimate(estimate(mass, mass - 0.01, mass + 0.01, final="false"))
        clock.at_s += 40.0
    assert [point.mass_kg for point in news.points] == [0.051]
    news.hear_estimate(estimate(0.052, 0.05, 0.054, final="true"))
    clock.at_s += 2.0 * CURVE_S
    assert [(point.mass_kg, point.at_s - clock.at_s) for point in news.points] == [
        (0.052, -CURVE_S),
        (0.052, 0.0),
    ]
    news.hear_estimate(Said(1, "payload", "", {"verdict": "failed", "final": "true"}))
    assert news.points == [] or news.points[-1].at_s < clock.at_s
    news.hear_estimate(estimate(float("nan"), 0.0, 1.0))
    assert all(np.isfinite(point.mass_kg) for point in news.curve)


def test_numbers_have_the_digits_that_are_known() -> None:
    values = estimate(0.0503, 0.0495, 0.0511).values
    assert words.answer_of(values) == ("50.30 g", "95 % interval 49.50 .. 51.10 g")
    assert words.answer_of({"payload_mass": "not determined"}) == ("", "")
    assert words.answer_of({"a": 1.0, "a.ci95": [1.0, float("inf")]}) == ("", "")


def test_warnings_come_worst_first_and_go_when_they_are_old() -> None:
    clock = Hand()
    news = News(clock)
    news.hear("driver", Said(1, "driver", "a servo is warm", {}))
    news.hear("identifier", Said(2, "identifier", "<b>no bus</b>", {}))
    assert news.warnings == ["<b>no bus</b>", "a servo is warm"]
    assert "&lt;b&gt;" in words.warnings(news)
    clock.at_s += 60.0
    assert news.warnings == ["<b>no bus</b>"]


def test_every_task_is_a_service_of_the_nodes() -> None:
    known = services()
    found = tasks()
    assert {task.service for task in found} <= set(known)
    assert len({task.title for task in found}) == len(found)
    others = {"cancel", "apply", "run", "abort", "release", "stop", "torque", "recover"}
    assert set(known) - {task.service for task in found} <= others


def test_what_is_typed_in_mm_is_stated_in_m() -> None:
    (ball,) = [task for task in tasks() if task.service == "calibrate_container"]
    typed = {"container.inner_size": "30, 20 50", "sphere.radius": " 12.5 ", "container.centre": ""}
    assert settings_of(ball, typed) == [
        "container.inner_size=[0.03, 0.02, 0.05]",
        "sphere.radius=0.0125",
    ]
    for wrong in ("30", "a b c", "1 2 3 4", "30x20x50"):
        with pytest.raises(ConfigurationError, match="three numbers in mm"):
            settings_of(ball, {"container.inner_size": wrong})


def test_what_will_move_is_said_before() -> None:
    robot = load_robot("open_manipulator_x")
    said = what_moves(["payload"], robot)
    assert "3 pushes, joint3 by 0.6 rad, joint2 by 0.6 rad at most, with up to 0.70 A" in said
    said = what_moves(["empty_hand", "payload_until"], robot)
    assert "gripper_left_joint by" in said and " mm" in said and "chosen" in said
    assert "nothing_like_it cannot be made" in what_moves(["nothing_like_it"], robot)
    assert what_moves(["a", "b"], None) == "The arm makes a, then b."


def test_an_answer_has_reasons_with_remedies(tmp_path: Path) -> None:
    call = Call("calibrate_payload")
    bag = tmp_path / "a job" / "bag"
    bag.mkdir(parents=True)
    (bag.parent / "estimate.json").write_text(json.dumps({"reason_codes": ["stuck"]}))
    values = dict(estimate(0.05, 0.045, 0.055, verdict="too_wide").values)
    message = f"too wide; calibration: /x/y.yaml; recording: {bag}"
    call.answer = {
        "success": False,
        "message": message,
        "estimate": {**values, "reason.1": "joint3 <hardly> moved"},
    }
    shown = answer(call)
    assert "too wide" in shown and "What to do" in shown and "&lt;hardly&gt;" in shown
    assert folder_of(message) == bag.parent and report_of(call) is None
    (bag.parent / "report.html").write_text("page")
    assert report_of(call) == bag.parent / "report.html"
    call.answer = {"success": False, "message": "busy: weigh is under way"}
    assert "busy: weigh is under way" in answer(call) and report_of(call) is None


def test_a_call_says_how_far_it_is() -> None:
    call = Call("calibrate_payload", ["payload.com=[0, 0, 0]"], "arm1")
    assert (
        call.command
        == "proprio call calibrate_payload --set 'payload.com=[0, 0, 0]' --namespace arm1"
    )
    assert call.progress is None
    call.said += ["payload: run 2 of 3: moving", "live, 28 samples: 50.0 +- 2.7 g"]
    assert call.progress == (2, 3)


def test_a_way_is_drawn_as_the_arm_turns(tmp_path: Path) -> None:
    """A push of the first joint turns the hand about the vertical, as far either way as it may go."""
    robot = load_robot("open_manipulator_x")
    file = tmp_path / "push.yaml"
    file.write_text(one_push(0.1, 1.0, AWAY, "joint1"))
    between, pushed = ways_of([str(file)], robot, {"joint1": 0.3, "joint2": -0.4})
    places = np.array(pushed)
    axis = robot.model.joint("joint1").origin[:2, 3]
    away = places[:, :2] - axis
    assert np.ptp(places[:, 2]) < 1e-9 and np.ptp(np.hypot(*away.T)) < 1e-9
    angles = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    assert np.ptp(angles) == pytest.approx(3.0)  # 1.5 rad either way
    assert angles.mean() == pytest.approx(0.3)
    way = np.array(between)
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() < 0.03, "without a jump"
    assert np.linalg.norm(places - way[-1], axis=1).min() < 0.02, "to where the push begins"
    assert ways_of(["payload_until"], robot, {})[1] == []


def test_a_push_is_drawn_by_the_joint_that_went_farthest() -> None:
    clock = Hand()
    news = News(clock)

    def phase(name: str) -> None:
        news.hear("excitation", Said(0, "excitation", "", {"phase": name}))

    for push in range(2):
        phase("settle")
        news.hear_states(["joint2", "joint3"], [0.1, 0.5], [])
        phase("probe")
        for step in range(4):
            clock.at_s += 0.01
            news.hear_states(["joint2", "joint3"], [0.1 + 0.001 * step, 0.5 - 0.1 * step], [])
        assert news.pushing and len(news.pushes) == push + 1
    joint, way = curve_of(news.pushes[1])
    assert joint == "joint3"
    assert way == [[0.0, 0.5], [0.01, 0.4], [0.02, 0.3], [0.03, 0.2]]


def test_a_body_is_as_wide_as_its_centre_is_uncertain() -> None:
    news = News(Hand())
    assert words.body(news) is None
    news.hear("payload", Held(0.05, (0.001, 0.0, 0.02)))
    news.hear_estimate(estimate(0.05, 0.045, 0.055, final="true"))
    ball = words.body(news)
    assert ball is not None and not ball.known and "ball of water" in words.hand(news)
    volume_m3 = 4.0 / 3.0 * np.pi * np.prod(ball.half_m)
    assert volume_m3 == pytest.approx(0.05 / 1000.0)
    intervals = "[[-0.002, 0.004], [-0.001, 0.001], [0.015, 0.025]]"
    more = {"payload_com": "[0.001, 0.0, 0.02]", "payload_com.ci95": intervals}
    news.hear_estimate(estimate(0.05, 0.045, 0.055, final="true", **more))
    found = words.body(news)
    assert found is not None and found.known
    assert found.half_m == pytest.approx([0.003, 0.001, 0.005])
    assert "1.0 ±3.0, 0.0 ±1.0, 20.0 ±5.0 mm" in words.hand(news)
    news.hear("holding", False)
    assert words.body(news) is None
    news.hear("holding", True)
    news.hear("payload", Held(float("nan"), (0.0, 0.0, 0.0)))
    assert words.body(news) is None, "it was withdrawn"


@pytest.mark.parametrize("name", ["so101", "panda", "ur5e", "vx300s", "pendulum"])
def test_what_a_urdf_does_not_say_is_written_where_it_belongs(name: str, tmp_path: Path) -> None:
    output = tmp_path / f"{name}.yaml"
    new = new_robot_file(str(REPOSITORY / "urdf" / f"{name}.urdf"), output)
    limits = [f"joints.{joint}.motor.current_limit_A" for joint in new.unlimited]
    keys = [*new.to_state, *limits]
    assert {key.rpartition(".")[2] for key in keys} <= set(LACKS)
    values = {key: 0.5 + 0.001 * number for number, key in enumerate(keys)}
    output.write_text(filled(new.text, values))
    robot = load_robot(output)
    for key, value in values.items():
        joint = key.split(".")[1]
        if key.endswith("nominal_torque_constant_N_m_per_A"):
            assert robot.drive_trains[joint].nominal_torque_constant == value
        elif key.endswith("current_limit_A"):
            assert robot.motors[joint].current_limit_A == value
        else:
            assert robot.drive_trains[joint].transmission == value
    # and once more, since something was typed wrongly
    output.write_text(filled(output.read_text(), {keys[0]: 0.7}))
    assert load_robot(output).drive_trains[keys[0].split(".")[1]].nominal_torque_constant == 0.7


def test_curves_of_runs_are_those_of_the_page(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    run = '<figure><svg class="chart" role="img" aria-label="Run 1: x"><svg></svg></svg></figure>'
    page.write_text(f'<p>a</p>{run}<figure><svg class="chart" aria-label="Misfit"></svg></figure>')
    assert figures_of(page) == run.removeprefix("<figure>").removesuffix("</figure>")
    assert figures_of(None) == ""
