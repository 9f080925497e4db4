"""The pictures of the sphere in its container: what they show follows from the path, by projections made here in another way."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.pages import read

from proprio_ros.cli.terminal import estimate_as_text
from proprio_ros.identification.estimate import Estimate, Value, Verdict
from proprio_ros.pipeline.replay import replay, write_report
from proprio_ros.pipeline.request import Options
from proprio_ros.probes.container.detail import ContainerDetail, SpherePath
from proprio_ros.probes.container.figures import drawable, moving_figure, path_figure

SVG = "{http://www.w3.org/2000/svg}"
INSIDES = {
    "box": [0.06, 0.03, 0.04],
    "cylinder": [0.05, 0.05, 0.08],
    "sphere": [0.07, 0.07, 0.07],
}


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array(
        [
            [0.0, -z, y],
            [z, 0.0, -x],
            [-y, x, 0.0],
        ]
    )
    once = np.sin(angle) * cross
    twice = (1.0 - np.cos(angle)) * cross @ cross
    return np.eye(3) + once + twice


def rolled(
    shape: str = "box",
    across: tuple[float, float, float] = (0.0, 1.0, 0.0),
    first: np.ndarray | None = None,
    count: int = 25,
    std_m: float = 1e-3,
) -> SpherePath:
    """A sphere that rolls along x while the container turns by 100 degrees about ``across``."""
    times = np.linspace(0.0, 0.6, count)
    position = np.tile([0.0, 0.001, -0.007], (count, 1))
    position[:, 0] = np.linspace(-0.012, 0.008, count)
    axis = np.array(across)
    begin = np.eye(3) if first is None else first
    turns = [begin @ rotation(axis, angle) for angle in np.linspace(0.0, 1.75, count)]
    return SpherePath(
        "run",
        shape,
        np.array(INSIDES[shape]),
        0.008,
        times,
        position,
        np.full((count, 3), std_m),
        np.array(turns),
        axis,
    )


def numbers(text: str) -> np.ndarray:
    return np.array([float(word) for word in re.findall(r"-?[\d.]+(?:e-?\d+)?", text)])


def drawn(
    text: str,
    kind: str,
) -> list[ET.Element]:
    return list(ET.fromstring(text).iter(SVG + kind))


def silhouette(text: str) -> np.ndarray:
    return numbers(drawn(text, "polygon")[0].attrib["points"]).reshape(-1, 2)


def circles_of(path: SpherePath) -> dict[str, list[float]]:
    """Centre and radius as drawn [mm] by the circle's class."""
    found = {}
    for circle in drawn(path_figure(path, 1), "circle"):
        values = [float(circle.attrib[key]) for key in ("cx", "cy", "r")]
        found[circle.get("class", "")] = values
    return found


def test_start_and_end_are_where_the_path_says_in_mm() -> None:
    path = rolled()
    circles = circles_of(path)
    assert len(circles) == 3, "start, end, and those in between"
    # one looks along y: x to the right and z upwards
    assert circles["start"] == [-12.0, -7.0, 8.0]
    assert circles["end"] == [8.0, -7.0, 8.0]
    lifted = replace(
        path,
        position=path.position + np.array([0.0, 0.5, 0.003]),
    )
    assert circles_of(lifted)["start"] == [-12.0, -4.0, 8.0], (
        "z shows, and y, the line of sight, does not"
    )


@pytest.mark.parametrize(
    ("shape", "across", "width", "height"),
    [
        ("box", (0.0, 1.0, 0.0), 60.0, 40.0),
        ("box", (0.0, -1.0, 0.0), 60.0, 40.0),
        ("box", (1.0, 0.0, 0.0), 30.0, 40.0),
        ("box", (0.0, 0.0, 1.0), 60.0, 30.0),
        # turned about z by 45 degrees: both horizontal edges are seen aslant
        ("box", (1.0, 1.0, 0.0), (60.0 + 30.0) / np.sqrt(2.0), 40.0),
        ("cylinder", (0.0, 1.0, 0.0), 50.0, 80.0),
        ("cylinder", (0.0, 0.0, 1.0), 50.0, 50.0),
        # aslant from above: the length and the two round ends, both foreshortened
        ("cylinder", (0.0, 1.0, 1.0), 50.0, (80.0 + 50.0) / np.sqrt(2.0)),
        ("sphere", (0.0, 1.0, 0.0), 70.0, 70.0),
        ("sphere", (0.3, 0.2, -0.9), 70.0, 70.0),
    ],
)
def test_the_inside_as_large_as_it_looks_from_there(
    shape: str,
    across: tuple[float, float, float],
    width: float,
    height: float,
) -> None:
    path = rolled(shape, across)
    for text in (path_figure(path, 1), moving_figure(path, 1)):
        size = np.ptp(silhouette(text), axis=0)
        assert size == pytest.approx([width, height], abs=0.05)
        assert "nan" not in text
        assert "inf" not in text


def test_corners_of_a_box_and_roundness_of_the_others() -> None:
    box = silhouette(path_figure(rolled("box"), 1))
    corners = {(-30, -20), (-30, 20), (30, -20), (30, 20)}
    assert len(box) == 4
    assert set(map(tuple, box)) == corners
    sphere = silhouette(path_figure(rolled("sphere"), 1))
    assert np.linalg.norm(sphere, axis=1) == pytest.approx(35.0, abs=0.02)


def axes_by_gravity(path: SpherePath) -> np.ndarray:
    """Right and up in the world for one who stands upright and looks along the joint's axis, shape (2, 3)."""
    along = path.world_from_container[0] @ path.across / np.linalg.norm(path.across)
    right = np.cross(along, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, along)])


@pytest.mark.parametrize("seed", range(2, 8))
def test_in_the_moving_picture_everything_is_where_it_was_in_the_world(seed: int) -> None:
    """The sphere's place, turned as the page turns it, is its place in the world as seen by one who looks along the joint."""
    rng = np.random.default_rng(seed)
    across = rng.normal(size=3)
    path = rolled(
        ("box", "cylinder", "sphere")[seed % 3],
        tuple(across),
        rotation(
            rng.normal(size=3),
            rng.uniform(0, 6),
        ),
    )
    [turn] = drawn(moving_figure(path, 1), "animateTransform")
    moves = {
        a.attrib["attributeName"]: numbers(a.attrib["values"])
        for a in drawn(moving_figure(path, 1), "animate")
    }
    angle = np.radians(numbers(turn.attrib["values"]))
    x = moves["cx"]
    y = moves["cy"]
    page = np.stack(
        [
            np.cos(angle) * x - np.sin(angle) * y,
            np.sin(angle) * x + np.cos(angle) * y,
        ],
        axis=1,
    )
    world = (
        1e3
        * np.einsum("kij,kj->ki", path.world_from_container, path.position)
        @ axes_by_gravity(path).T
    )
    assert page[:-1] == pytest.approx(world, abs=0.02)
    assert page[-1] == pytest.approx(page[-2]), "it rests before it starts again"


def test_the_moving_picture_takes_five_times_as_long() -> None:
    text = moving_figure(rolled(), 1)
    keys = numbers(drawn(text, "animateTransform")[0].attrib["keyTimes"])
    assert keys[0] == 0.0
    assert keys[-1] == 1.0
    assert (np.diff(keys) > 0.0).all()
    animated = [*drawn(text, "animate"), *drawn(text, "animateTransform")]
    assert {each.attrib["dur"] for each in animated} == {"4.00s"}
    assert keys[:-1] * 4.0 == pytest.approx(5.0 * rolled().times_s, abs=1e-3)
    for moving in drawn(text, "animate"):
        values = moving.attrib["values"].split(";")
        assert len(numbers(moving.attrib["keyTimes"])) == len(values)


def test_the_clock_shows_one_time_at_a_time() -> None:
    path = rolled()
    texts = drawn(moving_figure(path, 1), "text")
    clock = [text for text in texts if text.get("visibility")]
    assert [text.text for text in clock] == [f"{time:.2f} s" for time in path.times_s]
    for share in np.linspace(0.001, 0.999, 300):
        shown = []
        for text in clock:
            change = text[0].attrib
            row = np.searchsorted(numbers(change["keyTimes"]), share, side="right") - 1
            if change["values"].split(";")[row] == "visible":
                shown.append(float(text.text.split()[0]))
        (time,) = shown
        true = min(share * 4.0 / 5.0, 0.6)
        assert true - 0.032 < time <= true + 0.006


def arrows(text: str) -> np.ndarray:
    """From tail to tip of every arrow, upwards counted positive, shape (N, 2)."""
    groups = [group for group in drawn(text, "g") if group.get("class") == "gravity"]
    shafts = [
        numbers(path.attrib["d"]).reshape(2, 2)
        for group in groups
        for path in group.iter(SVG + "path")
    ]
    return np.array([np.diff(shaft, axis=0)[0] * [1.0, -1.0] for shaft in shafts])


def test_gravity_at_the_start_and_the_end() -> None:
    path = rolled()
    start, end = arrows(path_figure(path, 1))
    assert start / np.linalg.norm(start) == pytest.approx([0.0, -1.0], abs=1e-3)
    # the container turned by 1.75 rad about y, so in it gravity turned back by as much
    back = [np.sin(1.75), -np.cos(1.75)]
    assert end / np.linalg.norm(end) == pytest.approx(back, abs=1e-3)
    moving = arrows(moving_figure(path, 1))
    assert moving.shape == (1, 2)
    assert moving[0][1] < 0.0


def test_a_joint_that_stands_upright_has_gravity_along_the_line_of_sight() -> None:
    path = rolled(across=(0.0, 0.0, 1.0))
    for text in (path_figure(path, 1), moving_figure(path, 1)):
        assert len(arrows(text)) == 0
        assert "along the line of sight" in text
        assert "nan" not in text
    turning = drawn(moving_figure(path, 1), "animateTransform")[0]
    angles = numbers(turning.attrib["values"])
    turned = abs(angles[-1] - angles[0])
    assert turned == pytest.approx(np.degrees(1.75), abs=0.02)


def test_the_band_is_two_standard_deviations_and_only_where_it_shows() -> None:
    path = rolled()
    path = replace(
        path,
        std=path.std * [1.0, 500.0, 2.0],
    )
    ellipses = drawn(path_figure(path, 1), "ellipse")
    assert len(ellipses) == len(path.times_s)
    sizes = [float(ellipses[0].attrib[key]) for key in ("rx", "ry")]
    turn = numbers(ellipses[0].attrib["transform"])[2]
    assert sizes == [4.0, 2.0] and abs(turn) == pytest.approx(90.0), (
        "longest upwards, along z; y is the line of sight"
    )
    assert not drawn(path_figure(rolled(std_m=1e-6), 1), "ellipse")
    flat = replace(
        path,
        std=path.std * [1.0, 1.0, 0.0],
    )
    for ellipse in drawn(path_figure(flat, 1), "ellipse"):
        assert float(ellipse.attrib["ry"]) > 0.0, "without width it would vanish"


def test_samples_that_are_no_numbers_are_left_out() -> None:
    path = rolled()
    position = path.position.copy()
    position[5:] = np.nan
    shown = drawable(
        replace(
            path,
            position=position,
            std=np.full_like(path.std, np.nan),
        )
    )
    assert shown is not None and len(shown.times_s) == 5
    for text in (path_figure(shown, 1), moving_figure(shown, 1)):
        assert "nan" not in text
    assert drawable(replace(path, position=np.full_like(position, np.nan))) is None
    one = drawable(
        replace(
            path,
            position=np.where(
                np.arange(25)[:, None] == 3,
                path.position,
                np.nan,
            ),
        )
    )
    assert one is not None and "nan" not in path_figure(one, 1) + moving_figure(one, 1)


def test_long_runs_are_thinned_and_keep_their_ends() -> None:
    path = rolled(count=3000)
    shown = drawable(path)
    assert shown is not None
    assert len(shown.times_s) <= 120
    for end in (0, -1):
        assert (shown.position[end] == path.position[end]).all()
    assert shown.moved == path.moved
    assert len(path_figure(shown, 1)) + len(moving_figure(shown, 1)) < 50_000


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    """A container with three rolling runs and three of the baseline, about the plots of a weighing."""
    root = Path(__file__).resolve().parents[2] / "bags"
    weighed = replay([root / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap"], Options())
    return replace(
        weighed,
        verdict=Verdict.ACCEPTED,
        probe="container",
        runs=3,
        values=(
            Value("sphere_mass", "kg", 0.01189, 0.00065, [0.01062, 0.01317]),
            Value("container_mass", "kg", 0.03027, 0.0009, [0.02851, 0.03203]),
        ),
        unknowns=(),  # those of a payload
        run_fits=weighed.run_fits * 6,
        detail=ContainerDetail(
            tuple(replace(rolled(shape), run=f"tilted <{shape}>") for shape in INSIDES)
        ),
    )


def test_the_page_of_three_runs(estimate: Estimate, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    write_report(estimate, page)
    reader, text = read(page)
    assert page.stat().st_size < 300_000
    assert reader.classes.count("chart") == 6 + 2
    assert reader.classes.count("arm") == 1
    assert reader.classes.count("sphere") == 3 * 2
    assert "container in the hand of open_manipulator_x, 3 runs" in text
    for words in (
        "11.9 g sphere mass, 95 % interval 10.6 to 13.2 g",
        "30.3 g container mass",
        "Misfit over sphere mass",
    ):
        assert words in text
    assert "payload mass" not in text and text.count("sphere mass (g)") == 2, "in the plots, too"
    for shape in INSIDES:
        assert f"tilted <{shape}>" in text
    assert "moved by up to 20.0 mm" in text
    ids = re.findall(r'\bid="([^"]+)"', page.read_text())
    assert [i for i in ids if i.startswith("sphere-time")] == [
        f"sphere-time-{n}" for n in (1, 2, 3)
    ]
    pointed_at = re.findall(r'(?:xlink:href="#|url\(#)([^")]+)', page.read_text())
    assert pointed_at and set(pointed_at) <= set(ids)
    pictures = reader.tags.count("svg") - reader.classes.count("plot")
    assert page.read_text().count('role="img" aria-label="') == pictures


def test_a_page_without_a_path_says_nothing_of_it(estimate: Estimate, tmp_path: Path) -> None:
    lost = replace(
        rolled(),
        position=np.full((25, 3), np.nan),
    )
    for paths in ((), (lost,)):
        write_report(replace(estimate, detail=ContainerDetail(paths)), tmp_path / "page.html")
        assert "Where the sphere was" not in read(tmp_path / "page.html")[1]


def test_the_result_on_the_command_line_is_in_grams(estimate: Estimate) -> None:
    lines = estimate_as_text(estimate).splitlines()
    assert lines[0] == "accepted  (container, open_manipulator_x, 3 runs)"
    assert lines[1] == "  sphere_mass: 11.9 g   95 % interval 10.6 .. 13.2 g"
    assert lines[2] == "  container_mass: 30.3 g   95 % interval 28.5 .. 32.0 g"
