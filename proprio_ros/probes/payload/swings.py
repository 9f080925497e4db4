"""From free swings to the mass of what the hand holds: their zero, whose joint they are of, and what their friction leaves open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from proprio_ros.identification import gates, sentences, swings
from proprio_ros.identification.conclude import Conclusion
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.fit import FitResult, known_exactly, solve_load
from proprio_ros.identification.judge import Refusal, not_identifiable, rejected
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun, joints_of, prepare_run
from proprio_ros.identification.run_kinds import ZERO_REPEATS
from proprio_ros.identification.same_joint import (
    LIKELY_ANOTHER,
    TOGETHER,
    OtherJoint,
    compared,
    determined,
    mean_of,
    outside,
    refused,
)
from proprio_ros.identification.swing_friction import TERMS, own_friction, swing_starts
from proprio_ros.identification.unknowns import Role
from proprio_ros.probes.payload.weighed import OPEN_FILE, Weighed, WeighingOptions
from proprio_ros.quantity import shown
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

GYRATION_M = 0.05
"""By what it is said how far a swing's answer leans on the payload's own inertia: a radius of gyration."""
ANY_ZERO_RAD = 0.3  # How far a horn may be put on elsewhere than it was: standard deviation.
# So many times better, and an open zero is believed; less, and the mass may be either.
BETTER_FOLLOWED = 1.5
SWING_ROUNDS = 4  # How often the error of a simulated swing is looked at again.


@dataclass(eq=False)
class WeighedSwings(Weighed):
    """What a fit of free swings says about the mass in the hand."""

    either_kg: float = 0.0  # how far off a mass is that explains them as well
    other: OtherJoint | None = None  # whether they are of another joint

    @property
    def fit(self) -> FitResult:
        return self.opened

    def widen(self) -> None:
        mass = self.assessed.value
        self.count(swings.FRICTION_LAW_SHARE * abs(mass), swings.FRICTION_LAW)
        self.count(self.either_kg, swings.HORN)
        if self.other is not None:
            self.count(self.other.share * abs(mass), swings.WHOSE)

    def unlike_others(self) -> int | None:
        return Conclusion.unlike_others(self)

    def refusals(self) -> Iterator[Refusal]:
        yield from super().refusals()
        if self.robot.calibration is not None:
            joint = self.runs[0].run.joint
            yield from outside(joint, self.assessed.value, _known_kg(self.robot))

    def unlike_pushes(self) -> Iterator[Refusal]:
        yield from ()

    def by_more_fits(self) -> Iterator[Refusal]:
        """A torque constant says nothing here."""
        yield from ()

    def about_runs(self) -> str:
        free = "friction differs from swing to swing, by one factor each"
        if self.known:
            free += "; the joint is that of the calibration, as far as friction shows it"
            if self.other is not None:
                free += f" (another one's with a probability of {100.0 * self.other.probability:.2g} %, which counts)"
            free += ", and arm and known loads are as stated: a shorter arm swings like a lighter load, and nothing here tells; so "
            free += f"with the payload's inertia, of which a radius of gyration of 5 cm is worth about {self._by_inertia()}"
        return free

    def about_file(self) -> str:
        return OPEN_FILE

    def _by_inertia(self) -> str:
        """What it is worth to a swing that the payload is no point about its centre.

        Its moment over all inertia stays, so the mass grows as the inertia that is not the payload's has to make up for.
        """
        run = self.runs[0]
        without = float(run.coefficients.arm[0]) + run.drive.armature.value
        more = (self.assessed.value * GYRATION_M) ** 2 / max(without, 1e-9)
        return shown("kg", more, spec=".0f")


def weigh_swings(
    robot: Robot,
    runs: Sequence[PreparedRun],
    facts: PayloadFacts,
    options: WeighingOptions,
    found: gates.Findings,
    count: int,
) -> Estimate:
    """From free swings; those that are followed worse than the calibration's count for less.

    Args:
        robot: As its file or its calibration states it.
        runs: The swings.
        facts: Of the payload.
        options: Of the solver.
        found: With the notes on them.
        count: How many runs were given.
    """
    options = replace(options, starts_kg=swing_starts(robot, runs[0], facts))
    searched, opened, misfit = _followed(robot, runs, facts, options)
    either_kg = 0.0
    if robot.is_calibrated(joints_of(runs)):
        # a swing shows its own zero: one that was put on anew may explain what nothing else does, or as well another mass
        joint = runs[0].run.joint
        drive = robot.drive_trains[joint]
        anew = replace(drive, zero=replace(drive.zero, std=ANY_ZERO_RAD / ZERO_REPEATS))
        elsewhere = replace(robot, drive_trains={**robot.drive_trains, joint: anew})
        again_searched, again, worse = _followed(elsewhere, runs, facts, options)
        better = (
            opened.problem.robot.swing_error > BETTER_FOLLOWED * again.problem.robot.swing_error
        )
        if not worse and (misfit or better):
            searched = again_searched
            opened = again
            misfit = worse
            off = opened.value_of(("swing_zero", 0))
            found.notes.append(
                f"{joint} swings as if its zero were {off:+.3f} rad off what the file says: was the horn put on anew? The zero was "
                "fitted, too"
            )
        elif not worse:
            either_kg = again.value_of("payload_mass") - opened.value_of("payload_mass")
    other = _other_joint(opened, runs, facts, options)
    against = [] if other is None else list(_of_another_joint(robot, runs, other))
    if misfit:
        against.append(rejected("misfit", "the model does not explain the recording", misfit))
    if not robot.is_calibrated(joints_of(runs)) and not known_exactly(robot, runs):
        # all that moves may be lighter or heavier together: a ridge along which no interval around the best fit holds
        nothing = (
            "a free swing tells gravity moment over inertia, and nothing says what the rotor's inertia is: calibrate with swings "
            "of two known loads (calibrate --reference BAG=KG --reference BAG=KG)"
        )
        against.append(
            not_identifiable("not_calibrated", "a free swing alone does not tell a mass", nothing)
        )
    return WeighedSwings(
        searched,
        opened,
        found,
        count,
        facts,
        options,
        against=against,
        either_kg=either_kg,
        other=other,
    ).estimate()


def _other_joint(
    fit: FitResult, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> OtherJoint | None:
    """Whether swings are of another joint than the calibration's; None where it, or they, show no friction of their own."""
    robot = fit.problem.robot
    if robot.calibration is None or not robot.calibration.own_terms:
        return None
    now = mean_of([own_friction(robot, run.run, facts, options) for run in runs])
    if not determined(now):
        return None
    comparison = compared(robot.calibration.own_terms, now, TOGETHER)
    return OtherJoint.of(comparison, fit.value_of("payload_mass"), _known_kg(robot))


def _known_kg(robot: Robot) -> list[float]:
    """The loads of its calibration [kg]."""
    calibration = robot.calibration
    return [] if calibration is None else [float(run["load_kg"]) for run in calibration.runs]


def _of_another_joint(
    robot: Robot,
    runs: Sequence[PreparedRun],
    other: OtherJoint,
) -> Iterator[Refusal]:
    """Where that is too likely."""
    if robot.calibration is not None and other.probability > LIKELY_ANOTHER:
        yield refused(
            runs[0].run.joint,
            TERMS,
            other.comparison,
            robot.calibration.own_terms,
        )


def _followed(
    robot: Robot, runs: Sequence[PreparedRun], facts: PayloadFacts, options: WeighingOptions
) -> tuple[FitResult, FitResult, str]:
    """The first fit of swings, that with the error that they show, and why no swing of this robot explains them, or nothing."""
    known = robot.swing_error
    opened = searched = solve_load(robot, runs, facts, options, Role.ESTIMATED)
    for _ in range(SWING_ROUNDS):
        posterior = Posterior(opened.problem, opened.values)
        error = max(swings.swing_error(posterior), known)
        if error <= 1.05 * robot.swing_error:
            break
        robot = replace(robot, swing_error=error)
        runs = [prepare_run(robot, run.run, run.load, facts) for run in runs]
        opened = solve_load(robot, runs, facts, options, Role.ESTIMATED, start=opened)
    misfit = ""
    share = swings.missed_share(posterior)
    if share > runs[0].kind.most_missed:
        misfit = sentences.swing_missed(share)
    elif known and error > swings.MUCH_WORSE * known:
        misfit = (
            f"misfit: the swing is followed {error / known:.1f} times worse than those of the calibration: is the joint free, was "
            "torque off all the time, and is the object's place and shape as stated?"
        )
    return searched, opened, misfit
