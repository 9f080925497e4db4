"""The calls for scripts and notebooks: the same numbers as the command line, and objects that show themselves."""

from __future__ import annotations

import io
import json
import pickle
import subprocess
import sys
from dataclasses import replace
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recording_bag import write_recording
from threadpoolctl import threadpool_info, threadpool_limits

import proprio_ros
from proprio_ros import calibrate, check, drift, plan, weigh
from proprio_ros.cli import main
from proprio_ros.errors import LONGEST_SENTENCE, ConfigurationError, RecordingError
from proprio_ros.identification.estimate import Estimate, Verdict, no_answer
from proprio_ros.identification.reasons import Reason, of_run
from proprio_ros.pipeline.api import CalibrationResult, Weighing
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay
from proprio_ros.pipeline.request import Options
from proprio_ros.recordings.signals import read_recording
from proprio_ros.records import InputRecord, Recording
from proprio_ros.robot import load_robot
from proprio_ros.threads import one_blas_thread

ROOT = Path(__file__).resolve().parents[2]
BAG = ROOT / "bags" / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
STUCK = ROOT / "bags" / "friction_s00_fixed_random_a_joint3" / "bag_mcap"
EMPTY = [
    folder / "bag_mcap" for folder in sorted((ROOT / "bags").glob("realistic_s00_empty_0[0-5]_*"))
]
BALL = ROOT / "bags" / "realistic_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"
BALL_FACTS = {"shape": "sphere", "size": 0.043}


@pytest.fixture(scope="module")
def result() -> Weighing:
    return weigh(BAG, payload=BALL_FACTS)


@pytest.fixture(scope="module")
def calibration() -> CalibrationResult:
    return calibrate(EMPTY)


# --- loading ---------------------------------------------------------------------------------------------------------


def test_the_package_alone_loads_nothing_heavy() -> None:
    code = (
        "import sys, proprio_ros; assert 'weigh' in dir(proprio_ros); "
        "loaded = {'numpy', 'warp', 'scipy', 'matplotlib', 'pandas', 'rosbags'} & set(sys.modules); assert not loaded, loaded"
    )
    subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        check=True,
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "before",
    [
        "pass",
        "import proprio_ros.pipeline.calibrate",
        "import proprio_ros.cli, proprio_ros.pipeline.check, proprio_ros.pipeline.api",
    ],
)
def test_the_names_are_calls_in_every_order(before: str) -> None:
    code = (
        f"{before}\nfrom proprio_ros import calibrate, check, drift, plan, weigh\n"
        "import proprio_ros, proprio_ros.pipeline.calibrate\n"
        "assert all(type(c).__name__ == 'function' for c in (calibrate, check, drift, plan, weigh, proprio_ros.calibrate))"
    )
    subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        check=True,
    )


def test_no_module_takes_the_name_of_a_call() -> None:
    package = Path(proprio_ros.__file__).parent
    names = {path.stem for path in package.glob("*.py")} | {
        path.name for path in package.iterdir() if path.is_dir()
    }
    assert not names & set(proprio_ros.__all__)
    with pytest.raises(AttributeError, match="no attribute 'weight'"):
        _ = proprio_ros.weight


# --- weigh -----------------------------------------------------------------------------------------------------------


def test_the_numbers_are_those_of_the_command_line(
    result: Weighing, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["--set", "payload.shape=sphere", "--set", "payload.size=0.043"]
    assert main(["replay", str(BAG), "--probe", "payload", *settings, "--json"]) == 3
    printed = json.loads(capsys.readouterr().out)
    ours = json.loads(json.dumps(result.as_json()))
    del printed["timing_s"], ours["timing_s"]
    assert printed == ours and ours["bags"] == [str(BAG)] and ours["calibration"] is None
    (value,) = printed["estimates"]
    assert (result.mass, result.std, list(result.ci95)) == (
        value["value"],
        value["std"],
        value["ci95"],
    )
    assert not result.accepted and result.verdict == "too_wide" and result.unit == "kg"
    assert (
        result.value()
        == result.value("payload_mass")
        == result.values["payload_mass"].value
        == result.mass
    )
    with pytest.raises(KeyError, match="payload_mass"):
        result.value("weight")


@pytest.mark.parametrize(
    "bags", [BAG, str(BAG), [BAG], (str(BAG),)], ids=["Path", "str", "list", "tuple"]
)
def test_one_path_may_stand_alone(bags: object, result: Weighing) -> None:
    assert weigh(bags, payload=BALL_FACTS).mass == result.mass
    assert replay(bags, Options(settings={"payload.size": 0.043})).values[0].value == result.mass
    assert len(check(bags)) == 1


def test_facts_by_section_or_by_dotted_key(result: Weighing) -> None:
    dotted = weigh(
        BAG,
        settings={"payload.shape": "sphere", "payload.size": np.float64(0.043)},
    )
    arrays = weigh(
        BAG,
        payload={**BALL_FACTS, "com": np.zeros(3)},
    )
    assert dotted.mass == result.mass and arrays.mass == pytest.approx(result.mass, rel=1e-9)
    with pytest.raises(TypeError, match="calibratoin="):
        weigh(BAG, calibratoin="arm.yaml")
    with pytest.raises(ConfigurationError, match="unknown; valid keys"):
        weigh(BAG, payload={"colour": "red"})


class NoPath:
    """What says of itself that it is a path."""

    def __fspath__(self) -> int:
        return 3


class NoArray:
    """What cannot become a list."""

    def tolist(self) -> list[float]:
        raise RuntimeError("no list")


HOLDS_ITSELF: list[Any] = []
HOLDS_ITSELF.append(HOLDS_ITSELF)
RIGHT = {
    weigh: (BAG,),
    calibrate: (EMPTY[0],),
    plan: (0.05,),
    check: (BAG,),
    drift: (BAG,),
}
WRONG = [
    b"x",
    1j,
    object(),
    [None],
    [[]],
    [{}],
    {5: 6},
    {None: None},
    np.zeros((2, 2)),
    [b"x"],
    ["a", 5],
    {BAG: "x"},
]
WRONG += [NoPath(), NoArray(), HOLDS_ITSELF]
WORDS = [
    5,
    10**400,
    float("nan"),
    True,
    [],
    ["a"],
    {},
    {"payload.size": 1},
    int,
    iter(["a"]),
]
NO_NUMBERS = [
    "no such",
    "",
    None,
    float("nan"),
    [0.1, True],
]
TEXTS = ("calibration", "robot", "driver", "output", "state_topic", "command_topic", "effort_unit")
ALSO_WRONG: dict[str, list[Any]] = {
    **{name: [None, *WORDS] for name in ("probe", "solver", "profile")},
    **dict.fromkeys(TEXTS, WORDS),
    **{name: [None, 5, True, int, {}, {BAG: 0.1}] for name in ("bags", "baseline")},
    **{name: ["", 5, True, [], ["a"], int] for name in ("settings", "references")},
    "effort_sign": ["", 0, 5, "up", "a=2", [], {}, {"a": 2}, {1: -1}, int],
    "masses": NO_NUMBERS,
    "count": [*NO_NUMBERS, [], -1, 0, 1.5],
    "seconds": [*NO_NUMBERS, [], -1.0],
    "force": [None, 0, 1, "no", [], {}],
    "progress": [
        None,
        5,
        "print",
        [],
        lambda: None,
        NoPath,
    ],
    "payload": [None, 5, "x", []],
}


def _arguments() -> list[tuple[Any, str]]:
    named = [
        (call, name)
        for call in RIGHT
        for name, each in signature(call).parameters.items()
        if each.kind != each.VAR_KEYWORD
    ]
    return named + [(call, "payload") for call in (weigh, calibrate, plan)]


@pytest.mark.parametrize(
    ("call", "name"), _arguments(), ids=lambda each: getattr(each, "__name__", each)
)
def test_arguments_of_wrong_types_are_refused_in_a_line(call: Any, name: str) -> None:
    """Of all calls, each argument; nothing is read before."""
    for value in [*WRONG, *ALSO_WRONG[name]]:
        given = {
            next(iter(signature(call).parameters)): RIGHT[call][0],
            name: value,
        }
        with pytest.raises(ConfigurationError) as refusal:
            call(**given)
        said = str(refusal.value)
        assert (
            said.startswith(f"{name}: ") and said.isprintable() and len(said) <= LONGEST_SENTENCE
        ), value


def test_what_is_like_the_right_type_is_taken(tmp_path: Path, result: Weighing) -> None:
    again = weigh(
        iter([BAG]),
        payload={"shape": "sphere", "size": np.float32(0.043)},
        baseline=(),
    )
    assert again.bags == (str(BAG),) and again.mass == pytest.approx(result.mass, rel=1e-5)
    assert len(plan(np.array([0.05, 0.1], dtype=np.float32), count=np.int64(1))) == 1
    assert len(check((path for path in EMPTY[:2]), settings=None)) == 2


def words_in(figure: Any) -> str:
    """All that is written in a figure, which can be drawn."""
    figure.savefig(io.BytesIO(), format="svg")
    axes = figure.axes
    texts = [
        text.get_text()
        for axis in axes
        for text in [*axis.texts, axis.title, axis.xaxis.label, *axis.get_yticklabels()]
    ]
    return " ".join([*texts, *(axis.get_title(loc="left") for axis in axes)])


def test_no_number_for_what_cannot_be_determined() -> None:
    stuck = weigh(STUCK)
    assert (stuck.mass, stuck.std, stuck.ci95, stuck.accepted) == (None, None, None, False)
    assert [reason.code for reason in stuck.reasons] == ["stuck"] and "not determined" in repr(
        stuck
    )
    assert "joint3 moved only" in words_in(stuck.plot()), "a refusal is shown with its reason"
    html = stuck._repr_html_()
    assert "What to do: push with more current" in html
    assert "no value" in stuck._repr_html_() and len(stuck.to_frame()) == 1


def test_what_has_no_mass_says_so() -> None:
    block = Weighing(
        no_answer("softness", "youngs_modulus", "Pa", "arm", 1, [], []),
        (),
        "",
    )
    assert block.unit == "Pa" and block.value() is None
    with pytest.raises(AttributeError, match=r"softness has no mass; .* youngs_modulus"):
        _ = block.mass
    sphere = Weighing(
        no_answer("container", "sphere_mass", "kg", "arm", 1, [], []),
        (),
        "",
    )
    assert sphere.mass is None


def test_it_shows_itself(result: Weighing, tmp_path: Path) -> None:
    assert (
        "\n" not in repr(result) and "payload_mass" in repr(result) and "(too_wide)" in repr(result)
    )
    html = result._repr_html_()
    assert (
        "#96600c" in html
        and f"best guess {1e3 * result.mass:.0f} g" in html
        and "95 % interval" in html
    )
    hostile: Estimate = replace(
        result.estimate, verdict=Verdict.REJECTED, reasons=("<script>alert(1)</script> & co",)
    )
    html = Weighing(hostile, (), "")._repr_html_()
    assert "<script>" not in html and "&lt;script&gt;" in html and "#b23a48" in html
    page = result.report(tmp_path / "page.html")
    words = page.read_text()
    assert str(BAG) in words and "weigh([" in words and "<svg" in words
    with pytest.raises(ConfigurationError, match=r"page\.html: is there already; force=True"):
        result.report(page)
    page.write_text("")
    assert result.report(page, force=True).read_text() == words


def test_the_plot_shows_what_was_measured(result: Weighing) -> None:
    figure = result.plot()
    (fit,) = result.estimate.run_fits
    above, below = figure.axes
    drawn = {line.get_label(): line.get_ydata() for line in above.lines}
    assert np.array_equal(drawn["measured"], fit.measured) and np.array_equal(
        drawn["simulated"], fit.simulated
    )
    assert "residual" in below.get_ylabel()


def test_a_table_where_pandas_is(result: Weighing, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    (row,) = result.to_frame().to_dict("records")
    assert (row["value"], row["ci95_low"], row["ci95_high"]) == (result.mass, *result.ci95)
    assert (row["name"], row["unit"], row["verdict"]) == ("payload_mass", "kg", "too_wide")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ConfigurationError, match="pip install pandas"):
        result.to_frame()


# --- calibrate, plan -------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_calibration_is_used_as_an_object_or_as_its_file(
    calibration: CalibrationResult, tmp_path: Path
) -> None:
    path = tmp_path / "arm.yaml"
    written = calibrate(EMPTY, output=path)
    assert written.path == path
    assert written.as_json()["output"] == str(path)
    assert calibration.accepted
    assert calibration.as_json()["output"] is None
    assert calibration.calibration is not None
    by_object = weigh(BALL, calibration=calibration, payload=BALL_FACTS)
    by_file = weigh(BALL, calibration=path, payload=BALL_FACTS)
    assert by_object.mass == by_file.mass
    assert abs(by_file.mass - 0.05) < 4e-3
    used = by_file.as_json()["calibration"]
    assert used == written.as_json()["calibration"]
    assert used["name"] == "arm.yaml"
    of_object = by_object.as_json()["calibration"]["fingerprint"]
    assert used["fingerprint"] != of_object or len(used["fingerprint"]) == 64
    named = replay([BALL], Options(robot=str(path))).as_json()["calibration"]
    assert named == used  # also where the calibrated robot was named as the robot


@pytest.mark.long
def test_a_calibration_is_shown(calibration: CalibrationResult, tmp_path: Path) -> None:
    """As a table, a picture, a page and in words."""
    frame = calibration.to_frame()
    assert {"name", "value", "std", "prior"} <= set(frame.columns)
    assert len(frame) == len(calibration.estimate.unknowns)
    assert "joint3" in words_in(calibration.plot())
    for words in ("weighs ", "accepted"):
        assert words in calibration._repr_html_()
    assert "\n" not in repr(calibration)
    page = calibration.report(tmp_path / "page.html").read_text()
    assert "calibrate([" in page
    assert str(EMPTY[0]) in page
    with pytest.raises(ConfigurationError, match="is there already"):
        calibration.report(tmp_path / "page.html")


def test_a_calibration_that_failed_cannot_be_used() -> None:
    failed = calibrate(STUCK)
    assert failed.path is None and failed.calibration is None and not failed.accepted
    assert (
        "no run can be used" in words_in(failed.plot())
        and "no run can be used" in failed._repr_html_()
    )
    with pytest.raises(
        ConfigurationError, match="not_identifiable and cannot be used: no run can be used"
    ):
        weigh(BALL, calibration=failed)


@pytest.mark.long
def test_plans_are_a_list(calibration: CalibrationResult) -> None:
    plans = plan(0.05, calibration=calibration, count=2)
    assert len(plans) == 2 and plans[0].std_kg[0] <= plans[1].std_kg[0] and plans[0] in list(plans)
    frame = plans.to_frame()
    assert (
        list(frame["joint"]) == [entry.joint for entry in plans]
        and plans.as_json()["calibrated"] is True
    )
    with pytest.raises(ConfigurationError, match="must be positive"):
        plan([])
    html = plans._repr_html_()
    assert (
        html.count("<tr>") == 3
        and "0.05 kg" in html
        and f"± {1.96e3 * plans[0].std_kg[0]:.1f}"[:4] in html
    )
    assert plans[0].joint in words_in(plans.plot())


# --- check -----------------------------------------------------------------------------------------------------------


def recorded(bag: Path) -> Recording:
    drives = load_robot("open_manipulator_x").drive_trains
    nominal = {name: drive.nominal_effort_per_current for name, drive in drives.items()}
    return read_recording(
        bag, effort_unit="N.m", nominal_torque_constants=nominal, joint_order=list(drives)
    )


def test_what_is_in_a_bag() -> None:
    (good,) = check(BAG)
    assert good.state_topic == "/joint_states" and (good.input, good.input_unit) == (
        "/current_command",
        "A",
    )
    assert set(good.joints) >= {
        "joint1",
        "joint2",
        "joint3",
        "joint4",
    } and good.rate_Hz == pytest.approx(40.0, rel=0.02)
    assert (
        good.gaps == 0
        and not good.problem
        and {name for name, _, _ in good.topics} >= {"/joint_states"}
    )
    (run,) = good.runs
    assert (
        run.joint == "joint3"
        and run.current_A == pytest.approx(-0.301, abs=2e-3)
        and not run.problem
    )
    assert (
        run.duration_s == pytest.approx(0.6, abs=0.03)
        and run.name == weigh(BAG).estimate.run_fits[0].name
    )
    both = check([BAG, STUCK])
    assert "not usable: joint3 moved only" in both._repr_html_().replace(
        str(STUCK), ""
    ) and "usable" in words_in(both.plot())
    assert (
        both.usable == 1 and "moved only" in both[1].runs[0].problem and len(both.to_frame()) == 2
    )


def test_lost_messages_are_counted(tmp_path: Path) -> None:
    whole = recorded(BAG)
    kept = np.delete(
        np.arange(len(whole.joints.times_ns)),
        [3, 4, 5, 20, 21],
    )
    joints = replace(
        whole.joints,
        **{
            name: None if (values := getattr(whole.joints, name)) is None else values[kept]
            for name in ("times_ns", "position", "velocity", "effort", "current", "reported_effort")
        },
    )
    write_recording(tmp_path / "lost", replace(whole, joints=joints))
    (found,) = check(tmp_path / "lost")
    assert found.gaps == 2 and found.longest_gap_s == pytest.approx(0.1, abs=0.01)


def test_what_must_be_stated_is_said(tmp_path: Path) -> None:
    write_recording(tmp_path / "effort", replace(recorded(BAG), inputs=None))
    (found,) = check(tmp_path / "effort")
    assert (
        "--effort-unit" in found.problem
        and found.input == "measured effort"
        and "--effort-unit" in found.input_unit
    )
    assert found.rate_Hz > 30.0 and found.runs == ()
    (stated,) = check(tmp_path / "effort", effort_unit="N.m")
    assert stated.input_unit == "N.m" and stated.usable == 1
    (topic,) = refused = check(BAG, state_topic="/joints")
    assert "is not in the bag" in refused._repr_html_() and "not in the" in " ".join(
        words_in(refused.plot()).split()
    )
    assert "--state-topic /joints is not in the bag" in topic.problem and topic.topics
    still = recorded(BAG)
    inputs = InputRecord(
        still.inputs.times_ns, still.inputs.names, 0.0 * still.inputs.current_A, "/current_command"
    )
    write_recording(tmp_path / "still", replace(still, inputs=inputs))
    assert "no joint was driven" in check(tmp_path / "still")[0].problem


def test_the_command_check(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(BAG), str(STUCK)]) == 0
    words = capsys.readouterr().out
    assert (
        "1 of 1 run usable" in words
        and "0 of 1 run usable" in words
        and "/current_command" in words
    )
    assert main(["check", str(STUCK)]) == 3
    assert main(["check", "nowhere"]) == 2
    with pytest.raises(RecordingError, match="no such bag"):
        check("nowhere")


def test_check_takes_the_settings_of_replay(capsys: pytest.CaptureFixture[str]) -> None:
    frame = (
        "--set",
        "payload.frame=link5",
        "--set",
        "payload.com=[0,0,0.01]",
        "--set",
        "held.joint1=0.1",
    )
    assert main(["check", str(BAG), *frame]) == 0
    drive = "robot.joints.joint3.motor.current_limit_A"
    (limited,) = check(BAG, settings={drive: 0.01})
    assert "limited to 10 mA" in " ".join(limited.runs[0].notes)
    capsys.readouterr()
    assert main(["check", str(BAG), "--set", f"{drive}=0.01"]) == 0
    assert "limited to 10 mA" in capsys.readouterr().out
    assert main(["check", str(BAG), "--set", "heldd.joint1=0.1"]) == 2
    assert "heldd.joint1" in capsys.readouterr().err


def test_a_text_recording_is_checked_too(recordings: Path) -> None:
    folder = recordings / "paper_heavy_ball"
    if not folder.is_dir():
        pytest.skip(f"needs {folder}")
    checks = check(folder)
    assert (
        checks.usable == 1
        and checks.robot == weigh(folder).estimate.robot
        and checks[0].input_unit == "N m"
    )


# --- threads and reasons ---------------------------------------------------------------------------------------------


def blas_threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_a_calibration_from_a_script_has_one_thread() -> None:
    seen = []
    with threadpool_limits(2, user_api="blas"):
        calibrate_from_bags(
            EMPTY[:2],
            {},
            progress=lambda _: seen.append(blas_threads()),
        )
        assert blas_threads() == {2}
    assert seen and all(threads == {1} for threads in seen)


def test_the_limit_is_lifted_whatever_happens() -> None:
    @one_blas_thread
    def inner() -> set[int]:
        return blas_threads()

    @one_blas_thread
    def outer() -> None:
        assert inner() == blas_threads() == {1}
        raise ConfigurationError("wrong")

    with threadpool_limits(2, user_api="blas"):
        with pytest.raises(ConfigurationError):
            outer()
        assert blas_threads() == {2}


def test_a_reason_is_a_sentence_with_a_code() -> None:
    reason = Reason("stuck", "joint3 did not move")
    again = pickle.loads(pickle.dumps(reason))
    assert (
        reason == "joint3 did not move" == again
        and again.code == "stuck"
        and json.dumps(reason)[0] == '"'
    )
    prefixed = of_run("bag", reason)
    assert prefixed == "bag: joint3 did not move" and prefixed.code == "stuck"
    assert of_run("bag", "plain").code == "other"
