"""What is read beside a push: zeros, jumps, commands and other objects are asked before a mass is believed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import simulated
from support.bends import pushes as bends

from proprio_ros.errors import RecordingError, RobotError
from proprio_ros.identification.estimate import Estimate, Verdict
from proprio_ros.identification.fit import fit_opened, solve_load
from proprio_ros.identification.judge import Assessment
from proprio_ros.identification.prepared_runs import KnownLoad, prepare_run
from proprio_ros.identification.robot_calibration import LoadedRun, calibrate
from proprio_ros.identification.unknowns import Role
from proprio_ros.pipeline.calibrate import write_calibration
from proprio_ros.pipeline.loading import bag_recording, runs_or_motion
from proprio_ros.pipeline.request import Request
from proprio_ros.probes.payload.identify import WeighingOptions, weigh
from proprio_ros.records import Recording, Run
from proprio_ros.robot import Robot, load_robot

BAGS = Path(__file__).resolve().parents[2] / "bags"
FILE = load_robot("open_manipulator_x")
BALL = BAGS / "realistic_s00_fixed_light_ball_20g_joint3"
HEAVY_BALL = BAGS / "realistic_s00_fixed_heavy_ball_50g_joint3"
CUBE = BAGS / "realistic_s00_fixed_heavy_cube_23g_joint3_x0"
LIGHT_CUBE = BAGS / "realistic_s00_fixed_light_cube_10g_joint3"
LOWERED = BAGS / "realistic_s00_fixed_reference_100g_joint3_x1"


@pytest.fixture(scope="module")
def arm() -> Robot:
    """The arm of the recordings, calibrated with an empty hand and a reference."""
    folders = sorted(BAGS.glob("realistic_s00_empty_*"))
    known = [LoadedRun(run) for folder in folders for run in simulated.runs_of(folder, FILE)]
    for name in simulated.REFERENCES:
        folder = BAGS / f"realistic_s00_{name}"
        load = KnownLoad(0.1, simulated.facts_of(folder))
        known += [LoadedRun(run, load) for run in simulated.runs_of(folder, FILE)]
    calibration = calibrate(FILE, known).calibration
    assert calibration is not None
    return FILE.with_calibration(calibration)


def recorded(folder: Path) -> Recording:
    return bag_recording(simulated.bag_in(folder), Request(FILE))


def runs_in(recording: Recording) -> tuple[Run, ...]:
    return runs_or_motion(recording, Request(FILE)).runs


def asked(
    arm: Robot,
    recording: Recording,
    folder: Path = BALL,
) -> Estimate:
    return weigh(arm, runs_in(recording), simulated.facts_of(folder))


def codes(estimate: Estimate) -> list[str]:
    return [getattr(reason, "code", "other") for reason in estimate.reasons]


# --- zeros --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", ["joint2", "joint3", "joint4"])
@pytest.mark.parametrize("zero_rad", [0.02, -0.02])
def test_a_zero_that_one_pose_does_not_tell_is_counted(
    arm: Robot, joint: str, zero_rad: float
) -> None:
    """As far as it is stated that zeros move: here by 5 mrad, where the file of an arm with absolute encoders says 1."""
    loose = replace(arm, zero_repeat=0.005)
    estimate = asked(
        loose,
        bends.zero_off(recorded(BALL), joint, zero_rad),
    )
    mass = estimate.values[0]
    assert estimate.verdict is Verdict.ACCEPTED
    assert abs(mass.value - 0.02) < 3.0 * mass.std


@pytest.mark.parametrize("folder", [BALL, CUBE, LOWERED])
def test_an_answer_says_how_far_it_leans_on_a_zero(arm: Robot, folder: Path) -> None:
    """Whatever is counted of it, where 20 mrad would move the answer out of its interval."""
    estimate = asked(arm, recorded(folder), folder)
    (said,) = (reason for reason in estimate.reasons if reason.code == "leans_on_zero")
    assert "20 mrad more are -" in said and "counts 1 mrad" in said
    assert "--baseline" in said
    low, high = estimate.values[0].ci95
    lowest, highest = estimate.values[0].if_zeros_moved or (low, high)
    assert f"it is {1e3 * lowest:.1f} to {1e3 * highest:.1f} g" in said
    assert lowest < low and high < highest


@pytest.mark.parametrize("joint", ["joint2", "joint3", "joint4"])
@pytest.mark.parametrize("zero_rad", [0.02, -0.02])
@pytest.mark.parametrize(("folder", "kg"), [(BALL, 0.02), (CUBE, 0.023), (LOWERED, 0.1)])
def test_the_range_for_a_zero_that_moved_holds(
    arm: Robot, folder: Path, kg: float, joint: str, zero_rad: float
) -> None:
    estimate = asked(
        arm,
        bends.zero_off(recorded(folder), joint, zero_rad),
        folder,
    )
    mass = estimate.values[0]
    lowest, highest = mass.if_zeros_moved or mass.ci95
    assert estimate.verdict is not Verdict.ACCEPTED or lowest < kg < highest
    assert mass.if_zeros_moved is None or estimate.as_json()["estimates"][0]["if_zeros_moved"]


def test_zeros_that_are_stated_to_move_as_much_need_no_range(arm: Robot) -> None:
    estimate = asked(replace(arm, zero_repeat=0.01), recorded(BALL))
    assert estimate.values[0].if_zeros_moved is None and "leans_on_zero" not in codes(estimate)


def test_a_zero_that_a_push_half_shows_counts(arm: Robot) -> None:
    """Between two and a half and four standard deviations it is no chance and no certainty."""
    verdicts = []
    for zero_rad in (0.0, 0.03, 0.04):
        bent = bends.zero_off(recorded(LOWERED), "joint3", zero_rad)
        estimate = asked(arm, bent, LOWERED)
        verdicts.append(estimate.verdict)
        mass = estimate.values[0]
        assert mass.value is None or mass.ci95[0] < 0.1 < mass.ci95[1]
    assert verdicts == [Verdict.ACCEPTED, Verdict.TOO_WIDE, Verdict.REJECTED]


@pytest.mark.parametrize("zero_rad", [0.05, -0.05])
def test_a_zero_that_the_push_itself_shows_is_refused(arm: Robot, zero_rad: float) -> None:
    estimate = asked(
        arm,
        bends.zero_off(recorded(LOWERED), "joint3", zero_rad),
        LOWERED,
    )
    assert estimate.verdict is Verdict.REJECTED and "other_zero" in codes(estimate)
    assert any("joint3" in reason for reason in estimate.reasons if reason.code == "other_zero")


def test_an_empty_hand_beside_it_tells_the_zero(arm: Robot) -> None:
    """The zero is the same in both, so that what it puts on the mass is seen in the empty hand."""
    run = runs_in(bends.zero_off(recorded(BALL), "joint3", 0.015))
    facts = simulated.facts_of(BALL)
    names = [f"realistic_s00_empty_0{number}_joint3" for number in range(6)]
    empty = [
        each
        for name in names
        for each in runs_in(bends.zero_off(recorded(BAGS / name), "joint3", 0.015))
    ]
    alone = weigh(arm, run, facts).values[0]
    beside = weigh(arm, run, facts, baseline=empty).values[0]
    assert beside.std < alone.std
    error = abs(beside.value - 0.02)
    assert error < 2.0 * beside.std < 0.5 * abs(alone.value - 0.02)


def test_zeros_that_are_known_to_repeat_cost_nothing(arm: Robot) -> None:
    narrow = asked(replace(arm, zero_repeat=0.0), recorded(BALL)).values[0]
    wide = asked(replace(arm, zero_repeat=0.005), recorded(BALL)).values[0]
    assert narrow.std < 0.5 * wide.std
    as_stated = asked(arm, recorded(BALL)).values[0]
    # a milliradian, beside a robot whose torque differs little from run to run
    assert narrow.std < as_stated.std < 1.3 * narrow.std


@pytest.mark.parametrize("folder", [BALL, HEAVY_BALL, CUBE, LOWERED])
def test_an_answer_says_what_a_clock_that_is_off_would_change(arm: Robot, folder: Path) -> None:
    """Against weighing the same samples with other stamps, by up to one percent."""
    facts = simulated.facts_of(folder)
    (run,) = runs_in(recorded(folder))
    assumptions = weigh(arm, [run], facts).assumptions
    (said,) = (each for each in assumptions if "keep time" in each)
    match = re.search(r"by up to ([0-9.]+) g", said)
    assert match is not None
    per_percent = 1e-3 * float(match[1])
    for part in (0.003, 0.006, 0.01):
        masses = []
        for pace in (1.0 + part, 1.0 - part):
            mass = weigh(arm, [stretched(run, pace)], facts).values[0].value
            assert mass is not None
            masses.append(mass)
        apart = abs(masses[0] - masses[1])
        assert apart == pytest.approx(200.0 * part * per_percent, rel=0.15)


def stretched(run: Run, pace: float) -> Run:
    """The same samples, stamped by a clock that runs so many times as fast."""
    return replace(
        run,
        times_s=pace * run.times_s,
        before_times_s=pace * run.before_times_s,
        input_times_s=pace * run.input_times_s,
        after_times_s=pace * run.after_times_s,
        duration_s=pace * run.duration_s,
    )


def test_an_answer_leans_as_far_as_moving_the_prior_moves_it(arm: Robot) -> None:
    """Against differences, at three recordings and two sizes."""
    for folder in (BALL, CUBE, LOWERED):
        facts = simulated.facts_of(folder)
        (run,) = runs_in(recorded(folder))

        def mass_of(
            robot: Robot,
            run: Run = run,
            facts: object = facts,
        ) -> Assessment:
            prepared = [prepare_run(robot, run, None, facts)]  # type: ignore[arg-type]

            def solve(role: Role, start: object = None) -> object:
                return solve_load(robot, prepared, facts, WeighingOptions(), role, start)  # type: ignore[arg-type]

            return Assessment(fit_opened(solve), "payload_mass")  # type: ignore[arg-type]

        at = mass_of(arm)
        calibration = arm.calibration
        assert calibration is not None
        row = calibration.keys.index(("zero", "joint3"))
        for size in (1e-3, 3e-3):
            masses = []
            for sign in (1.0, -1.0):
                values = calibration.values.copy()
                values[row] += sign * size
                moved = arm.with_calibration(replace(calibration, values=values))
                masses.append(mass_of(moved).value)
            slope = (masses[0] - masses[1]) / (2.0 * size)
            assert at.leans["joint3"] == pytest.approx(slope, rel=0.1)


# --- readings that jump -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", ["joint2", "joint4"])
@pytest.mark.parametrize("step_rad", [0.01, -0.03])
def test_a_held_joint_that_jumps_is_refused_by_name(
    arm: Robot, joint: str, step_rad: float
) -> None:
    estimate = asked(
        arm,
        bends.step(recorded(BALL), joint, step_rad, 0.3),
    )
    assert estimate.values[0].value is None and "position_jumps" in codes(estimate)
    assert any(f"the reading of {joint}, which is held, jumps" in each for each in estimate.reasons)


@pytest.mark.parametrize("other", ["joint1", "joint4"])
@pytest.mark.parametrize("folder", [CUBE, HEAVY_BALL])
def test_held_joints_that_are_exchanged_are_named(arm: Robot, folder: Path, other: str) -> None:
    exchanged = bends.swapped(recorded(folder), "joint2", other)
    estimate = asked(arm, exchanged, folder)
    named = " and ".join(sorted(["joint2", other]))
    assert estimate.values[0].value is None
    assert f"the positions of {named} are exchanged" in estimate.reasons[0]


@pytest.mark.parametrize("at_s", [0.2, 0.4])
@pytest.mark.parametrize("step_rad", [0.01, -0.01])
def test_a_driven_joint_that_jumps_is_refused(arm: Robot, step_rad: float, at_s: float) -> None:
    estimate = asked(
        arm,
        bends.step(recorded(CUBE), "joint3", step_rad, at_s),
        CUBE,
    )
    assert estimate.verdict is Verdict.REJECTED
    assert {"position_jumps", "other_zero", "misfit"} & set(codes(estimate))


@pytest.mark.parametrize(
    ("folder", "step_rad", "at_s"),
    [
        (LOWERED, 0.007, 0.2),
        (LOWERED, 0.01, 0.3),
        (LOWERED, -0.01, 0.4),
        (BALL, -0.007, 0.3),
        (BALL, -0.01, 0.4),
    ],
)
def test_a_jump_of_a_joint_that_goes_fast_is_named(
    arm: Robot, folder: Path, step_rad: float, at_s: float
) -> None:
    """Accepted up to 4.5 standard deviations off where a jump had to be larger than what 8 ms do at that speed."""
    estimate = asked(
        arm,
        bends.step(recorded(folder), "joint3", step_rad, at_s),
        folder,
    )
    assert estimate.verdict is Verdict.REJECTED and "position_jumps" in codes(estimate)
    said = next(reason for reason in estimate.reasons if reason.code == "position_jumps")
    found = re.search(r"about ([+-]\d+) mrad (\d+) ms", said)
    assert found is not None and abs(float(found[1]) - 1e3 * step_rad) < 2.0
    assert abs(1e-3 * float(found[2]) - at_s) < 0.03


@pytest.mark.parametrize("late_s", [0.01, 0.02, -0.01])
def test_a_clock_that_steps_is_told_from_a_jump_or_named_beside_it(
    arm: Robot, late_s: float
) -> None:
    (run,) = runs_in(recorded(LOWERED))
    times_s = np.where(
        run.times_s > 0.2,
        run.times_s + late_s,
        run.times_s,
    )
    estimate = weigh(
        arm,
        [replace(run, times_s=times_s)],
        simulated.facts_of(LOWERED),
    )
    assert estimate.verdict is Verdict.REJECTED
    jumps = [reason for reason in estimate.reasons if reason.code == "position_jumps"]
    assert (not jumps) is (late_s > 0.0)
    assert all("or its clock steps" in reason for reason in jumps)


@pytest.mark.parametrize("at_s", [0.2, 0.4])
@pytest.mark.parametrize("step_rad", [0.003, -0.003])
def test_two_counts_of_an_encoder_are_no_jump(arm: Robot, step_rad: float, at_s: float) -> None:
    """Where chance hardly fails to explain a fit, so small a step would; friction that sticks does the same."""
    estimate = asked(
        arm,
        bends.step(recorded(BALL), "joint3", step_rad, at_s),
    )
    mass = estimate.values[0]
    assert "position_jumps" not in codes(estimate)
    assert estimate.verdict is Verdict.ACCEPTED and abs(mass.value - 0.02) < 3.0 * mass.std


@pytest.mark.parametrize("folder", [BALL, HEAVY_BALL, CUBE, LOWERED])
def test_joints_that_give_way_do_not_jump(arm: Robot, folder: Path) -> None:
    assert "position_jumps" not in codes(asked(arm, recorded(folder), folder))


# --- commands -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.8, 1.25])
@pytest.mark.parametrize(("folder", "noise_A"), [(LOWERED, 0.0), (LOWERED, 0.003), (CUBE, 0.02)])
def test_a_command_that_is_not_what_flowed_is_refused_though_it_never_settles(
    factor: float, folder: Path, noise_A: float
) -> None:
    random = np.random.default_rng(5)
    bent = bends.scaled_command(recorded(folder), factor)
    with pytest.raises(RecordingError, match=r"had [01]\.\d\d times the current"):
        runs_in(bends.noisy_command(bent, noise_A, random))


@pytest.mark.parametrize("factor", [0.55, 0.58])
def test_a_command_of_half_is_no_effort_in_another_unit(factor: float) -> None:
    """Our driver publishes torque; 1 A is 1.8 N m at this motor's nominal constant."""
    with pytest.raises(RecordingError, match=r"joint3 had 1\.[78]\d times the current"):
        runs_in(bends.scaled_command(recorded(BALL), factor))


@pytest.mark.parametrize("factor", [0.97, 1.0, 1.03])
@pytest.mark.parametrize("folder", [BALL, CUBE, LOWERED])
def test_what_commands_may_differ_from_their_effort_counts(
    arm: Robot, folder: Path, factor: float
) -> None:
    """3 % of the current pass, and are 0.5 to 12 g: they were up to six standard deviations."""
    plain = asked(arm, recorded(folder), folder).values[0]
    bent = bends.scaled_command(recorded(folder), factor)
    mass = asked(arm, bent, folder).values[0]
    assert plain.value is not None and mass.value is not None
    assert abs(mass.value - plain.value) < 2.0 * mass.std
    # 3 % of 40 mA are less than whole counts tell, and less than what is uncertain anyway
    assert (mass.std > 1.2 * plain.std) is (factor != 1.0 and folder != LOWERED)
    assert mass == plain or factor != 1.0


def test_a_motor_that_always_delivers_less_is_weighed_as_before(tmp_path: Path) -> None:
    """Real ones deliver 0.98 to 0.99 of it. The calibration knows by its own recordings, also out of a file."""
    factor = 1.02
    names = [f"realistic_s00_empty_0{number}_joint3" for number in range(6)]
    widths = []
    for calibrated in (1.0, factor):
        runs = [
            run
            for name in names
            for run in runs_in(bends.scaled_command(recorded(BAGS / name), calibrated))
        ]
        calibration = calibrate(FILE, [LoadedRun(run) for run in runs]).calibration
        assert calibration is not None
        share = calibration.delivered["joint3"]
        assert share.value == pytest.approx(1.0 / calibrated, abs=0.004) and 0.0 < share.std < 0.005
        file = tmp_path / f"{calibrated}.yaml"
        write_calibration(file, FILE, calibration)
        pushed = bends.scaled_command(recorded(BALL), factor)
        mass = asked(load_robot(file), pushed).values[0]
        as_calibrated = bends.scaled_command(recorded(BALL), calibrated)
        plain = asked(load_robot(file), as_calibrated).values[0]
        widths.append(mass.std / plain.std)
    assert widths[0] > 1.2 and widths[1] == 1.0


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_only_the_command_has_counts(arm: Robot, seed: int) -> None:
    recording = recorded(CUBE)
    noisy = bends.noisy_command(
        recording,
        0.015,
        np.random.default_rng(seed),
    )
    (run,) = runs_in(noisy)
    facts = simulated.facts_of(CUBE)
    assert prepare_run(arm, runs_in(recording)[0], None, facts).current_torque_std == 0.0
    prepared = prepare_run(arm, replace(run, delivered=None), None, facts)
    # the mean of 24 rows: 15 mA / sqrt(24) at 1.78 N m/A
    expected = 0.015 * 1.78 / np.sqrt(24.0)
    assert prepared.current_torque_std == pytest.approx(expected, rel=0.4)
    assert prepared.run.input_current_A == pytest.approx([run.input_current_A.mean()], rel=1e-6)
    estimate = weigh(arm, [run], facts)
    mass = estimate.values[0]
    assert mass.value is None or abs(mass.value - 0.023) < 3.0 * mass.std


@pytest.mark.parametrize("seed", range(3))
def test_noise_counts_where_the_joint_ends_up_too_fast_to_be_driven(arm: Robot, seed: int) -> None:
    """What the supply no longer drives is no noise that the motor followed."""
    (run,) = runs_in(
        bends.noisy_command(
            recorded(BALL),
            0.015,
            np.random.default_rng(seed),
        )
    )
    assert run.reported_effort is not None
    facts = simulated.facts_of(BALL)
    run = replace(run, delivered=None)
    before = prepare_run(arm, run, None, facts)
    # the last three samples are as fast as 12 V allow, with half of the effort
    position = run.position.copy()
    way = np.sign(position[-4] - position[0])
    position[-3:] = position[-4] + way * 0.12 * np.arange(1, 4)
    effort = run.reported_effort.copy()
    effort[-3:] *= (0.8, 0.5, 0.2)
    fast = prepare_run(
        arm,
        replace(run, position=position, reported_effort=effort),
        None,
        facts,
    )
    assert fast.cut_reason and len(fast.run.input_current_A) == 1
    assert fast.current_torque_std == pytest.approx(before.current_torque_std, rel=0.3)


# --- other objects and calibrations -------------------------------------------------------------------------------------


def test_two_objects_in_one_bag_are_refused_with_both_masses(arm: Robot) -> None:
    runs = [
        replace(run, name=f"bag#{number}")
        for number, folder in enumerate((BALL, LIGHT_CUBE), start=1)
        for run in runs_in(recorded(folder))
    ]
    estimate = weigh(arm, runs, simulated.facts_of(BALL))
    assert estimate.verdict is Verdict.REJECTED and "runs_contradict" in codes(estimate)
    said = next(reason for reason in estimate.reasons if reason.code == "runs_contradict")
    assert said.count(" g") == 2


def test_one_object_in_one_bag_is_told(arm: Robot) -> None:
    folders = (CUBE, BAGS / "realistic_s00_fixed_heavy_cube_23g_joint3")
    runs = [
        replace(run, name=f"bag#{number}")
        for number, folder in enumerate(folders, start=1)
        for run in runs_in(recorded(folder))
    ]
    estimate = weigh(arm, runs, simulated.facts_of(CUBE))
    low, high = estimate.values[0].ci95
    assert estimate.verdict is Verdict.ACCEPTED and low < 0.023 < high


def test_a_calibration_that_was_edited_says_so(arm: Robot, tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    assert arm.calibration is not None
    write_calibration(file, FILE, arm.calibration)
    assert load_robot(file).calibration is not None
    whole = file.read_text()
    value = arm.calibration.quantities["coulomb", "joint3"].value
    edited = whole.replace(
        f"value: {value:.6f}"[:14],
        f"value: {0.9 * value:.6f}"[:14],
        1,
    )
    assert edited != whole
    file.write_text(edited)
    with pytest.raises(
        RobotError, match=r"changed after it was written.*deletes the line `digest`"
    ):
        load_robot(file)
    file.write_text("\n".join(line for line in edited.splitlines() if "digest:" not in line))
    assert load_robot(file).calibration is not None


def test_a_calibration_that_another_program_laid_out_anew_is_the_same(
    arm: Robot, tmp_path: Path
) -> None:
    from ruamel.yaml import YAML

    file = tmp_path / "arm.yaml"
    assert arm.calibration is not None
    write_calibration(file, FILE, arm.calibration)
    plain = YAML(typ="safe")
    content = plain.load(file.read_text())
    with file.open("w") as stream:
        plain.dump(content, stream)
    assert load_robot(file).calibration is not None


@pytest.mark.parametrize(("folder", "kg"), [(HEAVY_BALL, 0.05), (CUBE, 0.023)])
def test_more_pushes_make_no_less_of_a_command_that_is_off_in_all_of_them(
    arm: Robot, folder: Path, kg: float
) -> None:
    """Four pushes as one recording has them, with 3 % more commanded than flowed."""
    (run,) = runs_in(bends.scaled_command(recorded(folder), 1.03))
    pushes = [replace(run, name=f"push#{number}") for number in range(4)]
    mass = weigh(arm, pushes, simulated.facts_of(folder)).values[0]
    assert mass.ci95[0] < kg < mass.ci95[1]
