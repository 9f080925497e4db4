"""What a swing of a joint that was let go shows of its friction by itself: dry and viscous, whatever its calibration says of them.

The moment of gravity over inertia gives the load by the calibration's rotor; dry and viscous friction over inertia, which the decay
of the swing gives, then are torques. Another rotor or arm gives another load, and its friction comes out in the same wrong
proportion, so it is compared with that of the calibration's own swings (`same_joint`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from proprio_ros.calibration_files.own_terms import (
    COULOMB,
    VISCOUS,
    OwnTerms,
)
from proprio_ros.identification.fit import (
    SearchOptions,
    solve_load,
)
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import (
    PreparedRun,
    prepare_run,
)
from proprio_ros.identification.unknowns import Role
from proprio_ros.quantity import Quantity
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.sim.payload import PayloadFacts

TERMS = (COULOMB, VISCOUS)
SWING_STARTS = (0.03, 0.1, 0.3, 0.8, 2.0)
OPEN_SHARE = 10.0  # Standard deviation of friction that is open, in parts of the calibration's.
USUAL_SHARE = 0.12
"""Of all friction at the swing's speed, what dry and viscous friction each differ by from one swing to the next, beside what both
do together. Those of one real servo do by 4 %; of another one dry friction more than doubles with the heaviest of four loads."""


def swing_starts(
    robot: Robot,
    run: PreparedRun,
    facts: PayloadFacts,
) -> tuple[float, ...]:
    """First guesses about the mass that doubles the inertia [kg]: far from it a swing hardly depends on the mass.

    Args:
        robot: Whose joint swings.
        run: Prepared.
        facts: About the load.
    """
    own = float(run.coefficients.arm[0]) + robot.drive_trains[run.run.joint].armature.value
    doubling = own / max(float(run.coefficients.per_kg(facts)[0]), 1e-9)
    return tuple(doubling * share for share in SWING_STARTS)


def own_friction(
    robot: Robot,
    run: Run,
    facts: PayloadFacts,
    options: SearchOptions | None = None,
) -> OwnTerms:
    """Dry and viscous friction of one swing, with a load and friction that are open and all else as calibrated.

    Args:
        robot: Calibrated.
        run: A free response.
        facts: Where the load sits.
        options: How to search; the starts are those of swings.
    """
    loose = _with_open_friction(robot, run.joint)
    prepared = prepare_run(loose, run, None, facts)
    starts = swing_starts(loose, prepared, facts)
    search = replace(options or SearchOptions(), starts_kg=starts)
    fit = solve_load(loose, [prepared], facts, search, Role.ESTIMATED)
    posterior = Posterior(fit.problem, fit.values)
    rows = [
        fit.problem.index["coulomb", run.joint],
        fit.problem.index["viscous", run.joint],
    ]
    values = fit.values[rows]
    std = np.sqrt(np.diag(posterior.whole_covariance())[rows])
    speed = max(
        float(np.sqrt(np.mean(np.square(posterior.velocity)))),
        1e-6,
    )
    whole = values[0] + values[1] * speed
    usual = USUAL_SHARE * whole / np.array([1.0, speed])
    return OwnTerms(values, std, np.maximum(usual, 1e-9))


def friction_of_swings(
    robot: Robot, runs: Sequence[tuple[Run, PayloadFacts]]
) -> tuple[OwnTerms, ...]:
    """`own_friction` of each swing of a calibration with which ``robot`` is calibrated."""
    return tuple(own_friction(robot, run, facts) for run, facts in runs)


def _with_open_friction(robot: Robot, joint: str) -> Robot:
    """The robot with what its calibration says of one joint as exactly known, but for its friction."""
    drive = robot.drive_trains[joint]
    scale = drive.coulomb.value + drive.viscous.value
    wide = OPEN_SHARE * max(scale, drive.coulomb.std, drive.viscous.std, 1e-3)
    loose = replace(
        drive,
        coulomb=Quantity(drive.coulomb.value, wide),
        viscous=Quantity(drive.viscous.value, wide),
        torque_constant=Quantity(drive.torque_constant.value, 0.0),
        armature=Quantity(drive.armature.value, 0.0),
        load_friction=Quantity(drive.load_friction.value, 0.0),
    )
    return replace(
        robot,
        calibration=None,
        drive_trains={**robot.drive_trains, joint: loose},
        friction_spread=0.0,
        arm_scale=Quantity(robot.arm_scale.value, 0.0),
    )
