"""What a fit is worth: the first refusal counts, unknowns and stamps speak too, and an interval is what it was widened to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.fit import (
    FitResult,
    SearchOptions,
    fit_both,
    solve_load,
    unexplained,
)
from proprio_ros.identification.judge import (
    ACCEPTED,
    FAR,
    Assessment,
    Guess,
    Refusal,
    WidthLimit,
    guessed,
    judge,
    not_identifiable,
    not_negative,
    positive,
    rejected,
    too_wide,
    unsteady,
)
from proprio_ros.identification.prepared_runs import PreparedRun, prepare_run
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.loading import bag_runs
from proprio_ros.pipeline.request import Request
from proprio_ros.quantity import Z95
from proprio_ros.records import Run
from proprio_ros.robot import Robot, load_robot
from proprio_ros.schema import reason_codes
from proprio_ros.sim.payload import PayloadFacts

NAME = "payload_mass"
MISFIT = rejected(
    "misfit", "the model does not explain the recording", "it does not", "look at the gears"
)
OPEN = not_identifiable("one_sided", "one side at most", "it may be anything")
WIDE = Refusal(Verdict.TOO_WIDE, "", ("from 0 to 100 g",))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("open_manipulator_x")


@pytest.fixture(scope="module")
def lift(bags: Path, robot: Robot) -> Run:
    """50 g, by an arm that was never calibrated."""
    (run,) = bag_runs(
        bags / "quantised_s00_fixed_heavy_ball_50g_joint3" / "bag_mcap", Request(robot)
    )
    return run


def weighed(robot: Robot, run: Run) -> FitResult:
    runs = [prepare_run(robot, run)]

    def solve(role: Role, start: FitResult | None = None) -> FitResult:
        return solve_load(
            robot,
            runs,
            PayloadFacts(),
            SearchOptions(),
            role,
            start,
        )

    return fit_both(solve, unexplained)[1]


@pytest.fixture(scope="module")
def fit(robot: Robot, lift: Run) -> FitResult:
    return weighed(robot, lift)


def far_off(fit: FitResult) -> Assessment:
    """A fit that is said to have ended six standard deviations from what the file says of the viscous friction."""
    values = fit.values.copy()
    row = fit.problem.index["viscous", "joint3"]
    values[row] = fit.problem.unknowns[row].value + 6.0 * fit.problem.unknowns[row].std
    return Assessment(replace(fit, values=values), NAME)


# --- the verdict ------------------------------------------------------------------------------------------------------


def test_nothing_against_an_answer_is_an_accepted_one(fit: FitResult) -> None:
    assert judge([]) == ACCEPTED == judge([], Assessment(fit, NAME))
    assert ACCEPTED.verdict is Verdict.ACCEPTED and not ACCEPTED.withheld and not ACCEPTED.reasons


@pytest.mark.parametrize("first", [MISFIT, OPEN, WIDE])
def test_the_first_refusal_counts_and_no_other_is_computed(first: Refusal, fit: FitResult) -> None:
    def refusals() -> Iterator[Refusal]:
        yield first
        raise AssertionError("the second refusal was asked for")

    assert judge(refusals()) == first == judge(refusals(), Assessment(fit, NAME))


@pytest.mark.parametrize("weaker", [ACCEPTED, OPEN, WIDE])
def test_unknowns_far_from_their_priors_reject_what_else_would_stand(
    weaker: Refusal, fit: FitResult
) -> None:
    refusal = judge([weaker], far_off(fit))
    assert (
        refusal.verdict is Verdict.REJECTED and reason_codes(refusal.reasons)[0] == "far_from_prior"
    )
    assert (
        "viscous[joint3]" in refusal.reasons[0] and "6.0 standard deviations" in refusal.reasons[0]
    )
    assert refusal.withheld and not set(weaker.reasons) & set(refusal.reasons) and FAR < 6.0


def test_of_a_rejected_recording_they_are_said_moreover(fit: FitResult) -> None:
    refusal = judge([MISFIT], far_off(fit))
    assert refusal.verdict is Verdict.REJECTED and refusal.withheld == MISFIT.withheld
    assert refusal.reasons[:2] == MISFIT.reasons and refusal.reasons[2].startswith(
        "moreover, viscous[joint3]"
    )


@pytest.mark.parametrize("other", [ACCEPTED, MISFIT, WIDE])
def test_stamps_that_do_not_fit_come_before_all_else(
    other: Refusal, robot: Robot, lift: Run
) -> None:
    # the joint moves 150 ms before the current that is said to drive it
    times_s = np.concatenate([lift.before_times_s, lift.times_s]) - 0.15
    position = np.concatenate([lift.before_position, lift.position])
    during = times_s >= 0.0
    late = replace(
        lift,
        times_s=times_s[during],
        position=position[during],
        before_times_s=times_s[~during],
        before_position=position[~during],
        reported_effort=None,
    )
    refusal = judge(
        [other],
        Assessment(weighed(robot, late), NAME),
    )
    assert refusal.verdict is Verdict.REJECTED and "stamped" in refusal.withheld
    codes = reason_codes(refusal.reasons)
    assert codes[0] == "stamps_off" and ("misfit" in codes) is (other is MISFIT)
    assert not set(WIDE.reasons) & set(refusal.reasons)


def test_a_fit_that_could_not_be_simulated_is_not_asked_about_its_unknowns(fit: FitResult) -> None:
    nothing = replace(far_off(fit).fit, chi2=np.inf)
    assert judge([OPEN], Assessment(nothing, NAME)) == OPEN


# --- the interval -----------------------------------------------------------------------------------------------------


def test_independent_uncertainties_add_in_squares(fit: FitResult) -> None:
    assessed = Assessment(fit, NAME)
    own = assessed.std
    assessed.widen(3.0 * own)
    assessed.widen(-4.0 * own)
    assert assessed.std == pytest.approx(np.sqrt(26.0) * own)
    assert assessed.value == fit.values[fit.problem.index[NAME]]


def test_residuals_coarser_than_the_encoder_widen_the_interval_as_far_as_nothing_else_is_known(
    fit: FitResult,
) -> None:
    coarse = replace(fit, chi2=4.0 * fit.dof)
    assert Assessment(coarse, NAME).inflation == pytest.approx(4.0)
    assert Assessment(coarse, NAME).std > Assessment(fit, NAME).std
    assert Assessment(replace(fit, chi2=0.25 * fit.dof), NAME).inflation == 1.0


def test_a_wide_interval_is_a_verdict_that_keeps_the_value(fit: FitResult) -> None:
    assessed = Assessment(fit, NAME)
    mass = assessed.value
    width_limit = WidthLimit(0.5, 0.005)
    assessed.widen(mass)  # then it may as well be nothing
    (refusal,) = too_wide(
        assessed,
        width_limit,
        [("torque_constant[joint3]", mass)],
    )
    assert refusal.verdict is Verdict.TOO_WIDE and not refusal.withheld
    (sentence,) = refusal.reasons
    assert (
        sentence.startswith("anything from 0 ..")
        and "+-50 % of the value and than +-5 g" in sentence
    )
    assert "because of torque constant, joint3" in sentence and "calibrate the robot" in sentence
    assert list(too_wide(assessed, WidthLimit(3.0), [])) == []


def test_a_quantity_that_is_not_negative() -> None:
    inside = positive("payload_mass", "kg", 0.05, 0.01)
    assert (inside.value, inside.std) == (0.05, 0.01)
    assert inside.ci95 == pytest.approx([0.05 - Z95 * 0.01, 0.05 + Z95 * 0.01])
    assert positive("payload_mass", "kg", 0.05, 0.01, quantile=3.0).ci95 == pytest.approx(
        [0.02, 0.08]
    )
    empty = positive("payload_mass", "kg", -0.001, 0.002)
    # what is estimated below nothing is known no better than what is estimated at nothing
    assert empty.value == 0.0 and empty.ci95 == pytest.approx([0.0, Z95 * 0.002])
    assert positive("payload_mass", "kg", -0.05, 0.01).ci95 == pytest.approx([0.0, Z95 * 0.01])


@pytest.mark.parametrize("value", [-3.0, -1.0, 0.0, 0.3, 1.0, 1.9])
def test_an_interval_near_nothing_holds_95_percent_of_what_is_left(value: float) -> None:
    low, high = not_negative(value, 1.0)
    assert low == 0.0 and high >= Z95
    assert norm.cdf(high - value) - norm.cdf(-value) >= 0.95 * norm.cdf(value)


def test_an_interval_far_from_nothing_is_not_cut_off() -> None:
    assert not_negative(2.0, 1.0) == pytest.approx((2.0 - Z95, 2.0 + Z95))


def test_a_quantity_ends_where_it_must_or_is_withheld() -> None:
    assert positive("poissons_ratio", "1", 0.4, 0.1, highest=0.47).ci95[1] == 0.47
    withheld = positive("payload_mass", "kg", 0.05, 0.01, "more than one mass")
    assert (withheld.value, withheld.std, withheld.ci95, withheld.reason) == (
        None,
        None,
        None,
        "more than one mass",
    )


def test_guesses_are_named_with_what_they_cost_together() -> None:
    sentence = guessed(
        [
            Guess("a.size", "30 mm", "3 mm", 0.003),
            Guess("b.place", "here", "5 mm", 0.004),
        ],
        0.05,
    )
    assert "a.size (30 mm, +- 3 mm), b.place (here, +- 5 mm)" in sentence
    assert (
        "(std 10 %)" in sentence
        and "--set a.size=.." in sentence
        and sentence.code == "guessed_facts"
    )
    assert "std" not in guessed([Guess("a.size", "30 mm", "3 mm", 0.003)], 0.0)


# --- a busy computer --------------------------------------------------------------------------------------------------


def at_times(
    robot: Robot,
    run: Run,
    times_s: np.ndarray,
) -> PreparedRun:
    return prepare_run(
        robot,
        replace(
            run,
            times_s=times_s,
            duration_s=1.0,
            after_times_s=np.zeros(0),
            after_position=np.zeros(0),
        ),
    )


def test_a_pause_is_said_before_uneven_stamps(robot: Robot, lift: Run) -> None:
    step_s = float(np.median(np.diff(lift.times_s)))
    even = lift.times_s[0] + step_s * np.arange(len(lift.times_s))
    assert unsteady([at_times(robot, lift, even)]) == []
    uneven = even + 0.3 * step_s * (np.arange(len(even)) % 2)
    (scatters,) = unsteady([at_times(robot, lift, uneven)])
    assert scatters.code == "uneven" and f"scatter by {1e3 * 0.3 * step_s:.1f} ms" in scatters
    pause_s = 0.1
    paused = np.where(
        np.arange(len(even)) < len(even) // 2,
        uneven,
        uneven + pause_s,
    )
    (pauses,) = unsteady([at_times(robot, lift, uneven), at_times(robot, lift, paused)])
    assert pauses.code == "paused" and f"pause for {1e3 * np.diff(paused).max():.0f} ms" in pauses
