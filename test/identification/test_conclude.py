"""From a fit to the answer: in which order it is widened, refused and put into words, on recordings and a small probe."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from proprio_ros.identification.conclude import Conclusion
from proprio_ros.identification.estimate import SolverSummary, Value, Verdict, WidthLimit
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    fit_both,
    solve_load,
    summary,
    unexplained,
)
from proprio_ros.identification.gates import MISFIT_LIMIT, Findings, RunComparison
from proprio_ros.identification.judge import Guess, Refusal, not_identifiable, positive
from proprio_ros.identification.prepared_runs import prepare_run
from proprio_ros.identification.robot_unknowns import DRIVE_TERMS
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.quantity import Quantity
from proprio_ros.robot import Robot, load_robot
from proprio_ros.schema import reason_codes
from proprio_ros.sim.payload import PayloadFacts

HEAVY = "quantised_s00_fixed_heavy_ball_50g_joint3"
LIGHT = "quantised_s00_fixed_heavy_cube_23g_joint3_x1"
OPTIONS = SearchOptions(starts_kg=(0.005, 0.05))


@dataclass(eq=False)
class Weighed(Conclusion):
    """The smallest probe: a mass, with what a test wants to say about it."""

    own: float = 0.0
    guessed: Sequence[Guess] = ()
    against: Sequence[Refusal] = ()
    half: float | None = None
    wide: WidthLimit | None = None

    probe = "scales"
    name = "payload_mass"
    called = MappingProxyType({"payload_mass": "container_mass"})

    def widen(self) -> None:
        if self.own:
            self.count(-self.own, "spring")

    def comparable(self) -> bool:
        return True

    def compared_with_others(self, outlier: int) -> RunComparison:
        return RunComparison(f"run {outlier} says otherwise", self.half is None, self.half or 0.0)

    def guess(self) -> list[Guess]:
        return list(self.guessed)

    def refusals(self) -> Iterator[Refusal]:
        yield from self.against
        yield from self.misfit()

    def width_limit(self) -> WidthLimit | None:
        return self.wide

    def remarks(self) -> Iterator[str]:
        yield "look twice"

    def solver(self) -> SolverSummary:
        return summary(
            self.nominal,
            self.name,
            OPTIONS.starts_kg,
            1.0,
            1,
            OPTIONS,
            final=self.fit,
        )

    def values(self, withheld: str) -> tuple[Value, ...]:
        return (
            positive(
                self.name,
                "kg",
                self.assessed.value,
                self.assessed.std,
                withheld,
            ),
        )

    def assumptions(self) -> tuple[str, ...]:
        return ("it is rigid",)


def fits_of(robot: Robot, bags: Path, *names: str) -> tuple[FitResult, FitResult]:
    runs = [
        prepare_run(robot, *bag_runs(bags / name / "bag_mcap", Request(robot))) for name in names
    ]
    return fit_both(
        partial(solve_load, robot, runs, PayloadFacts(), OPTIONS),
        unexplained,
    )


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


@pytest.fixture(scope="module")
def fits(
    robot: Robot,
    bags: Path,
) -> tuple[FitResult, FitResult]:
    return fits_of(robot, bags, HEAVY)


@pytest.fixture(scope="module")
def two(
    robot: Robot,
    bags: Path,
) -> tuple[FitResult, FitResult]:
    """Two objects as if they were one, of a robot that is known well: what its file leaves open would explain both."""

    def known(quantity: Quantity) -> Quantity:
        return replace(quantity, std=0.01 * quantity.std)

    drives = {
        name: replace(drive, **{term: known(getattr(drive, term)) for term in DRIVE_TERMS})
        for name, drive in robot.drive_trains.items()
    }
    exact = {
        "arm_scale": known(robot.arm_scale),
        "delay": known(robot.delay),
        "link_mass_std": 0.0,
        "link_com_std": 0.0,
    }
    return fits_of(
        replace(robot, drive_trains=drives, **exact),
        bags,
        HEAVY,
        LIGHT,
    )


def test_an_answer_is_widened_by_what_the_probe_adds_and_by_what_was_guessed(
    fits: tuple[FitResult, FitResult],
) -> None:
    plain = Weighed(*fits, Findings(), 1).estimate()
    std = plain.values[0].std
    assert isinstance(std, float) and plain.verdict is Verdict.ACCEPTED
    guesses = [Guess("a.size", "30 mm", "3 mm", 12.0 * std)]
    wider = Weighed(
        *fits,
        Findings(),
        1,
        own=4.0 * std,
        guessed=guesses,
    ).estimate()
    assert wider.values[0].value == plain.values[0].value
    assert wider.values[0].std == pytest.approx(np.sqrt(1.0 + 16.0 + 144.0) * std)
    assert wider.budget[:2] == (("a.size, guessed", 12.0 * std), ("spring", 4.0 * std))
    assert wider.budget[2:] == plain.budget
    assert wider.assumptions == ("it is rigid", "guessed, not stated: a.size 30 mm")


def test_reasons_come_in_one_order(fits: tuple[FitResult, FitResult]) -> None:
    found = Findings(["seen on the way"], ["a note"])
    guesses = [Guess("a.size", "30 mm", "3 mm", 0.01)]
    estimate = Weighed(
        *fits,
        found,
        3,
        guessed=guesses,
        wide=WidthLimit(1e-3),
    ).estimate()
    assert estimate.verdict is Verdict.TOO_WIDE and estimate.values[0].value is not None
    codes = reason_codes(estimate.reasons)
    assert codes == ["too_wide", "other", "guessed_facts", "other", "not_calibrated"]
    assert estimate.reasons[1] == "seen on the way" and estimate.reasons[3] == "look twice"
    # what the robot's file leaves open, alone
    assert "a.size" not in estimate.reasons[-1] and " g" in estimate.reasons[-1]
    assert estimate.notes == ("a note",) and estimate.runs == 3 and estimate.probe == "scales"


def test_a_refusal_withholds_the_value_and_what_would_be_said_of_it(
    fits: tuple[FitResult, FitResult],
) -> None:
    refusals = [
        not_identifiable("one_sided", "one side at most", f"it is more than {bound}")
        for bound in (1, 2)
    ]
    estimate = Weighed(
        *fits, Findings(["seen on the way"]), 1, against=refusals, wide=WidthLimit(1e-3)
    ).estimate()
    assert estimate.verdict is Verdict.NOT_IDENTIFIABLE
    assert estimate.reasons == ("it is more than 1", "seen on the way")
    assert estimate.values[0].value is None and estimate.values[0].reason == "one side at most"


def test_what_cannot_be_simulated_and_what_is_not_explained_are_refused(
    fits: tuple[FitResult, FitResult],
) -> None:
    nominal, opened = fits
    coarse = Weighed(
        nominal, replace(opened, chi2=2.0 * MISFIT_LIMIT * opened.dof), Findings(), 1
    ).estimate()
    assert coarse.verdict is Verdict.REJECTED and reason_codes(coarse.reasons)[0] == "misfit"
    assert (
        "reduced chi-square 18.0" in coarse.reasons[0]
        or "misses the recording by" in coarse.reasons[0]
    )
    assert "has not been calibrated" in coarse.reasons[1]
    nothing = Weighed(
        nominal,
        replace(opened, chi2=np.inf),
        Findings(),
        1,
        own=1.0,
        guessed=[Guess("a", "b", "c", 1.0)],
    )
    refused = nothing.estimate()
    assert (
        reason_codes(refused.reasons)[0] == "unsimulated"
        and "check the robot file's inertias" in refused.reasons[0]
    )
    assert not nothing.guesses and nothing.comparison is None


def test_runs_that_contradict_each_other_are_refused(two: tuple[FitResult, FitResult]) -> None:
    conclusion = Weighed(*two, Findings(), 2)
    estimate = conclusion.estimate()
    assert conclusion.comparison is not None and estimate.verdict is Verdict.REJECTED
    assert estimate.reasons[0] in {"run 0 says otherwise", "run 1 says otherwise"}
    assert estimate.values[0].reason == "the runs contradict each other"


def test_runs_that_differ_little_widen_the_interval_and_are_named(
    two: tuple[FitResult, FitResult],
) -> None:
    alone, both = (
        Weighed(
            *two,
            Findings(),
            2,
            half=half,
        )
        for half in (0.0, 0.02)
    )
    for conclusion in (alone, both):
        conclusion.estimate()
    assert both.assessed.std == pytest.approx(np.hypot(alone.assessed.std, 0.02))
    assert both.budget == alone.budget
    assert "says otherwise" in next(both.cautions(both.solver()))


def test_unknowns_and_sources_are_shown_as_the_probe_calls_them(
    fits: tuple[FitResult, FitResult],
) -> None:
    estimate = Weighed(*fits, Findings(), 1).estimate()
    assert estimate.unknowns[0].kind == "container_mass" and "viscous" in {
        row.kind for row in estimate.unknowns
    }
    assert not any(source == "payload_mass" for source, _ in estimate.budget)
