"""The page of a payload that was weighed while several joints moved: all that the page of a push has, for each joint."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from support.arm_in_motion import SIX, Twin, write_robot
from support.fleet import write_bag
from support.pages import curves, read

from proprio_ros import calibrate, weigh
from proprio_ros.cli.terminal import estimate_as_text
from proprio_ros.identification.estimate import Estimate, Value
from proprio_ros.identification.recorded import held_views
from proprio_ros.pipeline.api import Weighing
from proprio_ros.pipeline.replay import write_report
from proprio_ros.recordings.motions import Motion
from proprio_ros.report.motion_sections import held_figure
from proprio_ros.robot import load_robot

CENTRE_M = np.array([0.05, 0.03, -0.02])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("twin")


@pytest.fixture(scope="module")
def loaded() -> tuple[Motion, Motion]:
    """A bar of 2 kg, long along z, and the same arm with an empty hand."""
    arm = Twin(11)
    return arm.record(
        "bar",
        12.0,
        (2.0, CENTRE_M),
        (0.25, 0.25, 0.02),
    ), arm.record("empty", 12.0)


@pytest.fixture(scope="module")
def weighed(
    folder: Path,
    loaded: tuple[Motion, Motion],
) -> Weighing:
    bar, empty = (
        write_bag(folder / motion.name, motion, constants=SIX.constants) for motion in loaded
    )
    return weigh(
        bar,
        baseline=empty,
        robot=write_robot(folder),
        effort_unit="N.m",
    )


@pytest.fixture(scope="module")
def estimate(weighed: Weighing) -> Estimate:
    return weighed.estimate


def test_what_is_drawn_is_what_was_recorded_and_fitted(
    estimate: Estimate, loaded: tuple[Motion, Motion], tmp_path: Path
) -> None:
    assert [fit.joint for fit in estimate.joint_fits] == list(SIX.joints)
    for fit in estimate.joint_fits:
        column = SIX.joints.index(fit.joint)
        torque = SIX.constants[column] * loaded[0].current_A[:, column]
        near = [torque[np.abs(loaded[0].times_s - at) < 0.25].mean() for at in fit.times_s]
        assert np.std(fit.measured - near) < 0.2 * np.std(near), (
            "windows of half a second at their times"
        )
        off = fit.measured - fit.explained
        assert np.sqrt(np.mean(off**2)) == pytest.approx(fit.left_over, rel=0.1)
        assert fit.left_over < 0.15 * np.sqrt(np.mean(fit.measured**2))
        assert len(fit.times_s) <= 240 and fit.told.min() >= 0.0
    assert sum(fit.told.sum() for fit in estimate.joint_fits) == pytest.approx(1.0)
    assert {"joint_fits", "held_views"}.isdisjoint(estimate.as_json()), "series are for pictures"
    write_report(estimate, tmp_path / "page.html")
    drawn = curves((tmp_path / "page.html").read_text(), "explained")
    assert len(drawn) == 6
    most = max(
        estimate.joint_fits,
        key=lambda fit: fit.told.sum(),
    )
    assert drawn[0] == pytest.approx(
        np.stack([most.times_s, most.explained], axis=1), abs=2e-3 * np.ptp(most.explained)
    )


def test_the_torque_of_the_payload_is_apart(estimate: Estimate, folder: Path) -> None:
    """Joint 2 lifts it: what the payload makes of its torque is gravity on it, while nothing accelerates."""
    robot = load_robot(folder / "twin.yaml")
    lift = estimate.joint_fits[1]
    mass = estimate.value("payload_mass").value
    reach = np.abs(lift.payload).max()
    assert 0.3 * mass * 9.81 < reach < 1.5 * mass * 9.81 * 0.9, "its lever is between 0.3 and 0.9 m"
    assert robot.payload_frame == "hand"


def test_the_page_has_everything(estimate: Estimate, tmp_path: Path) -> None:
    write_report(estimate, tmp_path / "page.html", command="proprio replay BAG")
    reader, text = read(tmp_path / "page.html")
    for heading in (
        "Arm and payload",
        "Which joints and which seconds told the mass",
        "Measured against explained",
        "Where the uncertainty comes from",
        "Values and intervals",
    ):
        assert heading in text
    assert [reader.classes.count(kind) for kind in ("chart", "plot", "arm", "strip")] == [
        6,
        12,
        4,
        6,
    ]
    headlines = re.findall(r"<p class=\"value[^>]*>([^<]*)<", (tmp_path / "page.html").read_text())
    assert len(headlines) == 2 and headlines[1].endswith(" mm"), (
        "mass and centre; the inertia is in the table"
    )
    assert "?" not in text and "kg m^2" not in text
    inertia = estimate.value("payload_inertia")
    for name, value in zip(
        ("xx", "xy", "xz", "yy", "yz", "zz"),
        inertia.value,
        strict=True,
    ):
        assert (f"inertia, {name}" in text) or value is None
    assert (
        "centre of mass of the payload, y" in text
        and (tmp_path / "page.html").stat().st_size < 180_000
    )


def test_what_is_withheld_is_said_in_words(estimate: Estimate, tmp_path: Path) -> None:
    none = [None] * 6
    withheld = Value(
        "payload_inertia", "kg m^2", none, none, none, "too little is held to say how it is spread"
    )
    write_report(
        replace(
            estimate,
            values=(*estimate.values[:2], withheld),
        ),
        tmp_path / "page.html",
    )
    _, text = read(tmp_path / "page.html")
    assert "?" not in text and "payload inertia: too little is held to say how it is spread" in text


def test_a_terminal_has_the_digits_of_the_page(estimate: Estimate) -> None:
    centre = estimate.value("payload_com")
    some = replace(
        estimate.value("payload_inertia"), value=[0.25, None, None, 0.5, None, None], std=[0.01] * 6
    )
    assert re.fullmatch(r"\[(-?\d+\.\d(, )?){3}\] mm", centre.in_words())
    assert some.in_words() == "xx 0.250, yy 0.500 kg m^2"
    for value, words in ((centre, centre.in_words()), (some, some.in_words())):
        assert f"{value.name}: {words}" in estimate_as_text(
            replace(estimate, values=(*estimate.values[:1], value))
        )


def test_the_page_of_a_calibration_shows_what_the_arm_explains(
    folder: Path, loaded: tuple[Motion, Motion], tmp_path: Path
) -> None:
    bag = write_bag(
        folder / "learnt",
        loaded[1],
        constants=SIX.constants,
    )
    learnt = calibrate(bag, robot=write_robot(folder), effort_unit="N.m")
    fits = learnt.estimate.joint_fits
    assert [fit.joint for fit in fits] == list(SIX.joints) and not any(
        fit.payload.any() for fit in fits
    )
    for fit in fits:
        assert fit.left_over < 0.15 * np.sqrt(np.mean(fit.measured**2))
    assert "joint_fits" not in learnt.as_json()
    reader, text = read(learnt.report(tmp_path / "page.html"))
    assert [reader.classes.count(kind) for kind in ("chart", "plot")] == [6, 12]
    assert (
        "by the arm and its friction as they were identified" in text and "of the mass" not in text
    )
    assert "torque beyond what its constant says" in text and "Every shared unknown" in text
    drawn = curves((tmp_path / "page.html").read_text(), "measured")
    lift = np.stack(
        [fits[1].times_s, fits[1].measured],
        axis=1,
    )
    assert drawn[1] == pytest.approx(lift, abs=2e-3 * np.ptp(fits[1].measured))


def test_a_notebook_plots_it(weighed: Weighing) -> None:
    assert weighed.accepted
    figure = weighed.plot()
    assert len(figure.axes) == 12 and figure.axes[0].get_ylabel() == "torque (N m)"


def test_the_ellipsoid_is_the_homogeneous_one(tmp_path: Path) -> None:
    """Half axes of 3, 2 and 1 cm along those of the hand, seen along two of them."""
    robot = load_robot(write_robot(tmp_path))
    half = np.array([0.03, 0.02, 0.01])
    mass = 2.0
    square = half**2
    inertia = mass / 5.0 * np.diag(square.sum() - square)
    still = Motion(
        "still", SIX.joints, np.arange(80.0), np.zeros((80, 6)), np.zeros((80, 6)), {}, ""
    )
    side, above = held_views(
        robot,
        still,
        (mass, CENTRE_M, inertia),
        "stated",
        0.5 * half,
    )
    assert (
        held_views(
            robot,
            still,
            (0.0, CENTRE_M, inertia),
            "assumed",
            0.5 * half,
        )[0].body
        is None
    ), "nothing has no body"
    assert (side.side, above.side) == ("from the side", "from above")
    for view, axes in ((side, [0, 2]), (above, [0, 1])):
        assert view.centre - view.hand == pytest.approx(CENTRE_M[axes])
        assert 0.5 * np.ptp(view.body, axis=0) == pytest.approx(half[axes], rel=5e-3)
        assert 0.5 * np.ptp(view.within, axis=0) == pytest.approx(0.5 * half[axes], rel=5e-3)
        assert np.abs(view.arm[-1] - view.hand).min() < 1e-9, "the arm ends in the hand"
        assert "NaN" not in held_figure(view) and held_figure(view).count("<circle") == 1
    bare = held_views(
        robot,
        replace(
            still,
            joints=SIX.joints[:5],
            position=np.zeros((80, 5)),
        ),
        None,
    )
    assert bare == (), "nobody knows where the last joint stood"
