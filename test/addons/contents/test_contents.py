"""What is inside a container: models of the contents, their derivatives, and answers on recordings of MuJoCo's arm."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from proprio_ros.addons.contents import models
from proprio_ros.addons.contents.detail import KINDS_INSIDE
from proprio_ros.addons.contents.identify import ContentsFound, find_contents, weighted
from proprio_ros.addons.contents.models import (
    ContentsFacts,
    Slosh,
    damping_ratio,
    inside_terms,
    inside_unknowns,
)
from proprio_ros.errors import ConfigurationError, RecordingError
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.pipeline.calibrate import calibrate_from_bags
from proprio_ros.pipeline.replay import read_for, replay
from proprio_ros.pipeline.request import Options, request_of
from proprio_ros.probes import probe_named, virtual_object

FACTS = ContentsFacts(
    0.035,
    0.1,
    np.array([0.015, 0.0, -0.04]),
)
SETTINGS: dict[str, Any] = {
    "contents.radius": 0.035,
    "contents.height": 0.1,
    "contents.bottom": [0.015, 0.0, -0.04],
}


def test_the_first_mode_is_that_of_the_books() -> None:
    slosh = Slosh.of(0.035, np.array(0.06))
    water = 1000.0 * np.pi * 0.035**2 * 0.06
    assert np.sqrt(slosh.stiffness) / (2.0 * np.pi) == pytest.approx(3.6, abs=0.02)
    assert 1e3 * water == pytest.approx(
        231.0, abs=0.5
    ) and 1e3 * water * slosh.share == pytest.approx(61.0, abs=1.0)
    # Abramson: R / (2.2 h) tanh(1.84 h / R); all of a shallow liquid's motion is at its bottom
    for fill in (0.02, 0.06, 0.1):
        assert Slosh.of(0.035, np.array(fill)).share == pytest.approx(
            0.035 / 2.2 / fill * np.tanh(1.84 * fill / 0.035), rel=0.01
        )
    assert Slosh.of(0.035, np.array(1e-4)).height == pytest.approx(0.0, abs=1e-5)
    # Mikishev and Dorozhkin, deep water: 0.79 over the root of R^1.5 g^0.5 / nu
    assert damping_ratio(0.035, 0.2, 1e-6) == pytest.approx(
        0.79 * np.sqrt(1e-6 / np.sqrt(0.035**3 * 9.81)), rel=1e-3
    )


@pytest.mark.parametrize("model", [*models.MODELS][1:])
def test_slopes_of_the_models_are_differences(model: str) -> None:
    unknowns = inside_unknowns(model, FACTS)
    for kg in (0.02, 0.1, 0.3):
        at = {u.kind: np.array([kg if u.kind == "contents_mass" else u.value]) for u in unknowns}
        at |= {
            name: np.array([value + 0.1 * kg])
            for name, value in zip(models.PLACE, FACTS.shell.com, strict=True)
        }
        for kind in [*at]:
            step = 1e-6 * max(abs(float(at[kind][0])), 0.01)

            def shifted(
                by: complex,
                name: str = kind,
                at: dict[str, np.ndarray] = at,
            ) -> tuple[np.ndarray, ...]:
                return inside_terms(
                    model,
                    FACTS,
                    {**at, name: at[name] + by},
                )

            for exact, up, down in zip(
                shifted(1e-30j),
                shifted(step),
                shifted(-step),
                strict=True,
            ):
                slope = (up - down) / (2.0 * step)
                np.testing.assert_allclose(
                    exact.imag / 1e-30, slope, rtol=1e-5, atol=1e-7 * max(1.0, np.abs(slope).max())
                )


def test_probabilities_are_the_evidences() -> None:
    kinds = np.array(["nothing", "rigid", "liquid", "granular"])
    well = np.full(4, True)
    badly = np.full(4, False)
    np.testing.assert_allclose(
        weighted(
            np.log([0.0001, 0.4, 0.5, 0.0999]),
            kinds,
            well,
        ),
        [0.0001, 0.4, 0.5, 0.0999],
    )
    # what moves as little as a rigid thing cannot be told from one
    np.testing.assert_allclose(
        weighted(
            np.log([1e-9, 0.98, 0.01, 0.01]),
            kinds,
            well,
        ),
        [0, 0.9, 0.05, 0.05],
        atol=1e-6,
    )
    # but that nothing is there can be told
    np.testing.assert_allclose(
        weighted(
            np.log([0.98, 0.015, 0.004, 0.001]),
            kinds,
            well,
        ),
        [0.98, 0.015, 0.004, 0.001],
        atol=1e-6,
    )
    # what is rigid and explains nothing is not said to be rigid
    np.testing.assert_allclose(
        weighted(
            np.log([1e-9, 0.98, 0.01, 0.01]),
            kinds,
            badly,
        ),
        [0, 0.5, 0.25, 0.25],
        atol=1e-6,
    )
    # what is rigid may be out of the question beside what moves, in the digits that numbers have
    np.testing.assert_allclose(
        weighted(
            np.array([-1e5, -5e3, 0.0, -9e3]),
            kinds,
            well,
        ),
        [0.0, 0.0, 1.0, 0.0],
    )
    np.testing.assert_allclose(
        weighted(
            np.array([0.0, -1.0, -5e3, -6e3]),
            kinds,
            badly,
        ).sum(),
        1.0,
    )
    # what grains explain friction may; but where they explain more than a liquid does, it is none
    np.testing.assert_allclose(
        weighted(
            np.array([-1e5, -45.0, -15.0, 0.0]),
            kinds,
            well,
        ),
        [0.0, 0.1, 0.0, 0.9],
        atol=1e-6,
    )


def test_all_of_a_liquid_weighs_where_it_is() -> None:
    """Rigid and moving part together: its mass, with its centre at half of its height."""
    unknowns = {
        u.kind: np.array([0.2 if u.kind == "contents_mass" else u.value])
        for u in inside_unknowns("liquid", FACTS)
    }
    ten, moving = inside_terms("liquid", FACTS, unknowns)
    fill = 0.2 / (1000.0 * np.pi * 0.035**2)
    assert ten[0, 0] + moving[0, 0] == pytest.approx(0.2)
    height = ten[0, 3] + moving[0, 0] * (FACTS.bottom[2] + moving[0, 1])
    assert height == pytest.approx(0.2 * (FACTS.bottom[2] + 0.5 * fill), rel=2e-3)
    # where the container stands 3 mm beside what was stated, all of it is there; how high it stands is another matter
    beside = {
        name: np.array([at + 0.003])
        for name, at in zip(
            models.PLACE,
            FACTS.shell.com,
            strict=True,
        )
    }
    for model in ("frozen", "liquid"):
        at = {
            u.kind: np.array([0.2 if u.kind == "contents_mass" else u.value])
            for u in inside_unknowns(model, FACTS)
        }
        moved = inside_terms(model, FACTS, at | beside)[0] - inside_terms(model, FACTS, at)[0]
        np.testing.assert_allclose(
            moved[0, 1:4],
            0.2 * np.array([0.003, 0.003, 0.0]),
            atol=1e-12,
        )


def test_a_liquid_that_moves_otherwise_stands_as_high_as_its_mass_says() -> None:
    unknowns = inside_unknowns("liquid", FACTS)
    values = np.array([unknown.value for unknown in unknowns])
    problem = SimpleNamespace(unknowns=unknowns)
    nothing: Any = SimpleNamespace(
        kind=lambda: "liquid", fit=SimpleNamespace(explains=False, values=values, problem=problem,), facts=FACTS,
        of_liquid=(np.zeros(3), np.zeros(3)), assessed=SimpleNamespace(value=0.1, std=0.002, covariance=np.eye(len(values)),),
    )  # fmt: skip
    said = {value.name: value for value in ContentsFound.liquid_values(nothing, "")}
    fill = 0.1 / (1000.0 * np.pi * 0.035**2)
    assert said["fill"].value == pytest.approx(fill) and said["fill"].std == pytest.approx(
        fill * np.hypot(0.02, 0.15)
    )
    assert all(
        said[name].value is None and "small waves" in said[name].reason
        for name in ("slosh_frequency", "viscosity")
    )
    nothing.assessed.value = 0.3  # 78 mm to 12: more than a tenth of a container's height of 100
    assert next(ContentsFound.liquid_values(nothing, "")).value is None
    nothing.assessed.value, values[[unknown.kind for unknown in unknowns].index("slosh_tuning")] = (
        0.1,
        1.16,
    )
    assert all(
        value.value is None and "contents.radius" in value.reason
        for value in ContentsFound.liquid_values(nothing, "")
    )


@pytest.mark.long
def test_a_liquid_in_another_cylinder_than_was_stated_has_no_fill(
    bags: Path, tmp_path: Path
) -> None:
    """Stated 10 mm wider than it is, 30 mm were 18 (13 to 24): the frequency says what the mass does not."""
    folder = bags / "contents_liquid_r35_h30_1mPas"
    file = tmp_path / "arm.yaml"
    calibrate_from_bags(
        sorted(folder.glob("empty_*")),
        {},
        output=file,
    )
    settings = SETTINGS | {"contents.radius": 0.045}
    baseline = sorted(folder.glob("baseline_*"))
    options = Options(
        probe="contents",
        settings=settings,
        calibration=file,
        baseline=baseline,
    )
    found = replay(sorted(folder.glob("run_*")), options)
    assert found.verdict.value == "accepted"
    assert found.value("liquid_inside").value > 0.95
    assert found.value("fill").value is None
    assert "contents.radius" in found.value("fill").reason


def test_a_virtual_hand_can_hold_it() -> None:
    held = virtual_object("filled:0.05,liquid=0.2")
    assert held is not None and held.emptied is not None
    with pytest.raises(ConfigurationError, match="the cylinder is full with 385 g"):
        virtual_object("filled:0.05,liquid=0.5")


def test_its_settings_are_read() -> None:
    from proprio_ros.inputs.settings import Settings

    facts = probe_named("contents").facts(
        Settings({"contents.radius": 0.04, "contents.mass": 0.06})
    )
    assert (
        facts.radius == 0.04
        and facts.mass == 0.06
        and not probe_named("contents").needs_baseline(facts)
    )
    with pytest.raises(ConfigurationError, match=r"35 mm is 0\.035"):
        probe_named("contents").facts(Settings({"contents.radius": 35.0}))


@pytest.mark.long
@pytest.mark.parametrize("model", [*models.MODELS][1:])
def test_slopes_of_a_recording_s_problem_are_differences(bags: Path, model: str) -> None:
    """By what is inside, and by where the container stands."""
    problem = problem_of_two(bags / "contents_liquid_r35_h30_1mPas", model)
    rows = [
        problem.index[name]
        for name in [*(unknown.kind for unknown in problem.inside), *models.PLACE, "payload_mass"]
    ]
    for kg, beside in ((0.05, -0.004), (0.12, 0.0), (0.25, 0.006)):
        values = problem.base.copy()
        values[[problem.index[name] for name in ("contents_mass", "payload_mass")]] = kg, 0.04
        values[[problem.index[name] for name in models.PLACE]] += beside
        check_slopes(problem, values, rows)


def problem_of_two(folder: Path, model: str) -> models.ContentsProblem:
    """Two runs of a container, of which the second is said to be empty."""
    options = Options(probe="contents", settings=SETTINGS)
    paths = [folder / "run_0", folder / "run_2"]
    request = request_of(options.for_recordings(paths))
    robot, recorded = read_for(request, paths)
    facts = request.facts
    assert isinstance(facts, ContentsFacts)
    runs = [prepare_run(robot, run, None, facts.shell) for run in recorded.runs]
    return models.ContentsProblem(robot, runs, facts, [True, False], model)


def check_slopes(
    problem: models.ContentsProblem,
    values: np.ndarray,
    rows: list[int],
) -> None:
    """Of both runs, by each of some unknowns: those that are computed are central differences.

    Args:
        problem: Of two runs.
        values: Of all its unknowns.
        rows: Places of some of them.
    """
    step = 1e-5
    exact = problem.simulate(values[None], np.array(rows))[2][0]
    steps = step * np.eye(len(values))
    moved = np.array([values + side * steps[row] for row in rows for side in (1.0, -1.0)])
    shown = problem.simulate(moved, np.array(rows[:1]))[0]
    for n, name in enumerate(rows):
        slope = (shown[2 * n] - shown[2 * n + 1]) / (2.0 * step)
        for run in range(2):
            used = problem.weight[run] > 0.0
            largest = max(
                float(np.abs(slope[run][used]).max()),
                1e-6,
            )
            off = float(np.abs(exact[run, ..., n][used] - slope[run][used]).max())
            assert off < 2e-3 * largest, (problem.unknowns[name].kind, run, off, largest)


@pytest.mark.long
def test_the_virtual_arm_s_liquid_is_weighed_and_an_empty_one_is_empty() -> None:
    """MuJoCo's pendulum, of which this law is no copy; the demo's own object, so no truth of real liquids."""
    pytest.importorskip("mujoco")
    from support.hand import ROBOT, Hand
    from support.squeezing import made, played

    _, first, _ = played("empty_hand_container", Hand(1, None))
    calibration = calibrate(ROBOT, [LoadedRun(run) for run in first]).calibration
    assert calibration is not None
    robot = ROBOT.with_calibration(calibration)
    sequence = load_sequence("contents_shake", ROBOT)
    filled = virtual_object("filled:0.05,liquid=0.15")
    assert filled is not None
    assert "all 4 runs are good" in played("contents", Hand(1, filled))[0].message
    runs, empty = (made(sequence, Hand(1, held))[1] for held in (filled, filled.emptied))
    found = find_contents(robot, runs, FACTS, empty)
    assert found.verdict.value == "accepted", found.reasons
    mass = found.value("contents_mass")
    liquid = found.value("liquid_inside").value
    assert mass.ci95[0] < 0.15 < mass.ci95[1]
    assert 1.96 * mass.std < 0.02
    assert isinstance(liquid, float) and liquid > 0.95
    without = find_contents(robot, empty, FACTS, empty)
    assert (
        without.value("nothing_inside").value > 0.95
        and without.value("contents_mass").value < 0.003
    )
    lying = replace(
        FACTS,
        rotation=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    )
    with pytest.raises(RecordingError, match="about its own axis"):
        find_contents(robot, runs, lying, empty)
    with pytest.raises(ConfigurationError, match="the empty container is not known"):
        find_contents(robot, runs, FACTS)
    assert tuple(found.detail.probabilities) == KINDS_INSIDE
    page = "".join(probe_named("contents").sections(found))
    assert "What is inside" in page


@pytest.mark.long
def test_a_heavy_dummy_is_no_liquid(bags: Path) -> None:
    """Its shake moves the held joints: after one pass of how they give way it was a liquid at 0.999999, after four it is none."""
    pytest.importorskip("mujoco")
    import contents

    folder = bags / "contents_rigid_r45_h59"
    truth = json.loads((folder / "truth.json").read_text())
    found = contents.answer(folder, truth)
    assert found.verdict == "accepted"
    assert found.said is None
    assert found.number("rigid_inside") > 0.5
    assert found.holds("contents_mass", truth["contents"]["mass"])
