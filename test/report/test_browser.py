"""The pages in a real browser: wide and narrow, dark, printed, under a pointer; skipped where there is none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import servos
import swings
from support.arm_in_motion import SIX, Twin, write_robot
from support.browser import DARK, MEASURE, PAPER_PX, Look, Style, brightness, on_paper
from support.fleet import write_bag
from support.machines import pendulum_urdf
from support.paper_rows import synthetic
from support.servo_bag import write

from proprio_ros.addons.paper.page import write_paper_page
from proprio_ros.identification.prepared_runs import KnownLoad
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import replay, write_report
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.payload.identify import weigh
from proprio_ros.quantity import Sought
from proprio_ros.report import write_calibration_report
from proprio_ros.report.choices_page import Choice, write_choices
from proprio_ros.robot import load_robot

pytestmark = pytest.mark.long

LONG_NAME = "a_folder_" * 20 + "<script>document.title = 'run'</script>"
POINT = """
const chart = document.querySelector("svg.chart"), box = chart.getBoundingClientRect(), run = RUN;
const x = (time) => { const d = chart.dataset, share = (time - d.x0) / (d.x1 - d.x0);
  return box.left + (74 + share * 552) / 640 * box.width; };
const fire = (type, time) =>
  chart.dispatchEvent(new PointerEvent(type, { clientX: x(time), clientY: box.top + 40, bubbles: true }));
fire("pointermove", run.time);
const tip = document.querySelector(".tip"), words = tip.textContent, shown = !tip.hidden;
const labels = () => [...chart.querySelectorAll(".ticks text")].map((text) => text.textContent);
const before = labels();
fire("pointerdown", 0.2); fire("pointerup", 0.3);
const near = labels(), zoomed = chart.querySelector("svg.plot").getAttribute("viewBox");
chart.dispatchEvent(new MouseEvent("dblclick", { bubbles: true }));
const again = labels();
fire("pointerleave", 0.2);
return { words, shown, before, near, zoomed, again, gone: tip.hidden };
"""


@pytest.fixture(scope="module")
def pages(
    bags: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Path]:
    """Every page that the tool writes, with names as long as folders may be; one of each way of weighing and calibrating."""
    folder = tmp_path_factory.mktemp("pages")
    weighed = replay([bags / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"])
    fit = weighed.run_fits[0]
    run = weighed.recorded[0]
    named = replace(
        weighed,
        run_fits=(replace(fit, name=LONG_NAME),),
        recorded=(replace(run, name=LONG_NAME), run),
    )
    write_report(
        named, folder / "payload.html", command=f"proprio replay {LONG_NAME}", sources=[LONG_NAME]
    )
    options = Options(
        probe="softness",
        settings={"block.size": 0.03},
        baseline=[bags / f"realistic_s00_squeeze_empty_{n}" / "bag_mcap" for n in (0, 1)],
    )
    soft = replay([bags / "realistic_s00_squeeze_heavy" / "bag_mcap"], options)
    write_report(soft, folder / "softness.html", command="proprio replay", sources=[LONG_NAME])
    empty = [
        *sorted(bags.glob("realistic_s00_empty_0[0-5]_*")),
        bags / "friction_s00_fixed_random_a_joint3",
    ]
    calibration = calibrate_from_bags([each / "bag_mcap" for each in empty], {})
    write_calibration_report(calibration, folder / "calibration.html", sources=[LONG_NAME])
    options = Options(
        probe="container",
        baseline=[bags / "realistic_s00_container_no_sphere_joint4_100mA" / "bag_mcap"],
    )
    box = replay([bags / "realistic_s00_container_sphere_12g_joint4_100mA" / "bag_mcap"], options)
    write_report(box, folder / "container.html", command="proprio replay", sources=[LONG_NAME])
    _contents_page(folder, bags / "contents_liquid_r35_h30_1mPas")
    _motion_pages(folder)
    _swing_pages(folder)
    _servo_pages(folder)
    choices = [
        Choice(
            0.05,
            half,
            0.5 * half,
            "joint3 -300 mA for 0.6 s, a lift",
            ["joint2 +200 mA for 1 s", "joint4"],
            0.02,
        )
        for half in (0.05, 0.004, 0.001)
    ]
    write_choices(choices, Sought("payload_mass", "kg"), 0.002, folder / "choices.html")
    write_paper_page(synthetic(), folder / "paper.html", f"proprio paper --out {LONG_NAME}", 2)
    return {path.stem: path for path in folder.glob("*.html")}


def _contents_page(folder: Path, bottle: Path) -> None:
    """Of what is in a bottle."""
    settings = {
        "contents.radius": 0.035,
        "contents.height": 0.1,
        "contents.bottom": [0.015, 0.0, -0.04],
    }
    options = Options(
        probe="contents", baseline=[bottle / f"baseline_{n}" for n in (0, 3)], settings=settings
    )
    inside = replay([bottle / f"run_{n}" for n in (0, 3)], options)
    write_report(inside, folder / "contents.html", command="proprio replay", sources=[LONG_NAME])


def _motion_pages(folder: Path) -> None:
    """A payload weighed while six joints move, and the calibration of that arm, with the first of their names a long one."""
    pytest.importorskip("mujoco")
    arm = Twin(11)
    robot = write_robot(folder)
    recorded = [
        arm.record(
            "bar",
            12.0,
            (2.0, np.array([0.05, 0.03, -0.02])),
            (0.25, 0.25, 0.02),
        )
    ]
    recorded += [arm.record(name, 12.0) for name in ("empty", "again")]
    bar, *empty = (
        write_bag(folder / motion.name, motion, constants=SIX.constants) for motion in recorded
    )
    options = Options(
        robot=str(robot),
        effort_unit="N.m",
        baseline=empty[:1],
    )
    weighed = replay([bar], options)
    named = tuple(
        replace(fit, name=LONG_NAME, joint=f"left_arm_shoulder_{fit.joint}")
        for fit in weighed.joint_fits
    )
    write_report(
        replace(weighed, joint_fits=named),
        folder / "motion.html",
        command=f"proprio replay {LONG_NAME}",
    )
    learnt = calibrate_from_bags(
        empty,
        {},
        replace(options, baseline=[]),
    )
    write_calibration_report(learnt, folder / "motion_calibration.html", sources=[LONG_NAME])


def _swing_pages(folder: Path) -> None:
    """A payload on a servo that is let go, and what two known ones told of that servo."""
    (folder / "swing.urdf").write_text(swings.URDF)
    (folder / "swing.yaml").write_text(swings.ROBOT)
    robot = load_robot(folder / "swing.yaml")
    rng = np.random.default_rng(3)
    masses = (0.55, 1.0, 0.8)
    let_go = swings.released(
        rng,
        np.array(masses),
        {
            **swings.machine_of(rng),
            "coulomb": 0.1,
            "rise": 0.2,
        },
        False,
    )
    runs = [swings.as_run(f"{number} {LONG_NAME}", *swing) for number, swing in enumerate(let_go)]
    known = [LoadedRun(runs[n], KnownLoad(masses[n], swings.facts())) for n in (0, 1)]
    learnt = calibrate(robot, known)
    assert learnt.calibration is not None
    write_calibration_report(learnt, folder / "swing_calibration.html", sources=[LONG_NAME])
    weighed = weigh(
        robot.with_calibration(learnt.calibration),
        runs[2:],
        swings.facts(),
    )
    write_report(weighed, folder / "swing.html", command=f"proprio replay {LONG_NAME}")


def _servo_pages(folder: Path) -> None:
    """The same of a servo under its own controller, of which goals and positions are recorded."""
    pytest.importorskip("mujoco")
    random = np.random.default_rng(2)
    servo = servos.Servo(random)
    output = folder / "known.yaml"
    pendulum_urdf(folder, "servo", servos.ROD_KG, servos.ARM_M)
    (folder / "servo.yaml").write_text(servos.FILE)
    masses = (*servos.KNOWN_KG, *servos.KNOWN_KG, 0.6)
    *known, bag = (
        write(folder / f"servo_{n}", servo.moved(kg, random, 50.0)) for n, kg in enumerate(masses)
    )
    references = dict(zip(known, masses, strict=False))
    options = Options(
        robot=str(folder / "servo.yaml"),
        settings=servos.POINT,
    )
    learnt = calibrate_from_bags([], references, options, output)
    write_calibration_report(learnt, folder / "servo_calibration.html", sources=[LONG_NAME])
    weighed = replay(
        [bag],
        Options(calibration=output, settings=servos.POINT),
    )
    write_report(weighed, folder / "servo.html", command=f"proprio replay {LONG_NAME}")


NAMES = [
    "payload",
    "softness",
    "calibration",
    "container",
    "motion",
    "motion_calibration",
    "choices",
    "paper",
]
NAMES += ["contents", "swing", "swing_calibration", "servo", "servo_calibration"]


WAYS: dict[int | str, tuple[int, Style]] = {
    1400: (1400, str),
    400: (400, str),
    "paper": (PAPER_PX, on_paper),
}
Bright = dict[tuple[str, int | str], dict[str, Any]]


@pytest.fixture(scope="module")
def bright(
    pages: dict[str, Path],
    look: Look,
) -> Bright:
    """What is measured on each page: by width, and on paper."""
    seen = look.frames(
        MEASURE,
        [(pages[name], *way) for name in NAMES for way in WAYS.values()],
    )
    return dict(zip(((name, way) for name in NAMES for way in WAYS), seen, strict=True))


@pytest.fixture(scope="module")
def dark(
    pages: dict[str, Path],
    look: Look,
) -> dict[str, dict[str, Any]]:
    """The same where the reader wants dark pages."""
    return dict(
        zip(
            NAMES,
            look.frames(
                MEASURE,
                [(pages[name], 1400, str) for name in NAMES],
                DARK,
            ),
            strict=True,
        )
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("width", [1400, 400])
def test_nothing_is_wider_than_the_window(bright: Bright, name: str, width: int) -> None:
    seen = bright[name, width]
    assert seen["width"] == width and seen["scroll"] <= width
    assert seen["smallest"] > 9.0, "px: what stands at the axes can be read"
    assert seen["title"] != "run"
    assert seen["unsigned"] == [], "what scrolls casts a shadow where it goes on"
    assert width == 400 or seen["clipped"] == 0, "a wide window shows every column"


@pytest.mark.parametrize("name", NAMES)
def test_bright_on_dark_where_the_reader_wants_that(
    bright: Bright,
    dark: dict[str, dict[str, Any]],
    name: str,
) -> None:
    light = bright[name, 1400]
    night = dark[name]
    assert brightness(light["paper"]) > 0.95 and brightness(night["paper"]) < 0.15
    assert max(map(brightness, light["inks"])) < 0.7
    assert min(map(brightness, night["inks"])) > 0.4, "no ink is left from the bright page"


@pytest.mark.parametrize("name", NAMES)
def test_on_paper_the_verdict_and_every_column_can_be_read(bright: Bright, name: str) -> None:
    seen = bright[name, "paper"]
    ink, ground, border = seen["verdict"]
    if name not in ("choices", "paper"):  # they judge nothing
        assert brightness(ink) < 0.1 and brightness(ground) == 1.0 and brightness(border) < 0.1
    assert seen["clipped"] == 0 and seen["scroll"] <= PAPER_PX
    assert seen["broken"] == [], "headers break between words"


def test_values_under_the_pointer_and_a_closer_look(
    pages: dict[str, Path], look: Look, bags: Path
) -> None:
    run = replay([bags / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"]).run_fits[0]
    time_s = float(run.times_s[10])
    seen = look(
        pages["payload"],
        POINT.replace("RUN", json.dumps({"time": time_s})),
    )
    assert seen["shown"] and seen["gone"]
    time, *lines = seen["words"].replace("\N{MINUS SIGN}", "-").splitlines()
    words = {}
    for line in lines:
        name, said = line.split(": ")
        words[name] = said.split()
    assert float(time.split()[0]) == pytest.approx(time_s, abs=2e-3)
    measured, unit = words["measured"]
    assert unit == "rad"
    assert float(measured) == pytest.approx(run.measured[10], abs=3e-3)
    assert float(words["simulated"][0]) == pytest.approx(run.simulated[10], abs=3e-3)
    assert float(words["current"][0]) == pytest.approx(-0.301, abs=1e-3)
    assert seen["again"] == seen["before"] != seen["near"]
    near = [float(label) for label in seen["near"]]
    assert near == pytest.approx([0.2, 0.22, 0.24, 0.26, 0.28, 0.3], abs=1e-9)
    begin, _, length, _ = map(float, seen["zoomed"].split())
    assert 0.0 < begin < begin + length < 552.0


def test_pushes_and_iterations_are_whole_numbers_at_the_axis(
    pages: dict[str, Path], look: Look
) -> None:
    words = 'return [...document.querySelectorAll(".chart > .ticks text")].map((text) => text.textContent)'
    assert look(pages["choices"], words) == ["1", "2"]
    assert "<p class=value>50.0 g</p>" in pages["choices"].read_text()


def test_held_out_runs_whose_names_end_alike_have_a_bar_each(
    pages: dict[str, Path], look: Look
) -> None:
    words = 'return document.querySelector("svg[aria-label^=Held-out]").textContent.match(/\\u2026[^\\u2026]*script>/g).length'
    assert look(pages["swing_calibration"], words) == 2


def test_the_policy_lets_the_page_s_own_script_run_and_no_other(
    pages: dict[str, Path], look: Look, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.html"
    copy.write_text(
        pages["payload"]
        .read_text()
        .replace("</h1>", "</h1><script>document.title = 'run'</script>", 1)
    )
    shown = look.shown(copy)
    assert 'class="tip"' in shown and "<title>run</title>" not in shown
