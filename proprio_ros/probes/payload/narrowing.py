"""What would narrow a mass that was weighed by pushes, and to what: more pushes like those that were made, or a known load.

Both are foreseen from the answer's own linearisation, at the values that it found. More pushes are those of the recording again,
each with a start, an onset and a torque of its own. A known load is pushed in the same way for a calibration, so what it tells of
the robot is in the prior of the next weighing, whose joints' zeros may be elsewhere again. What else widens the interval stays.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from proprio_ros.identification.estimate import Verdict
from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import KnownLoad, PreparedRun
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import load_unknowns, robot_unknowns
from proprio_ros.identification.unknowns import Role, Unknown, scaled_inverse
from proprio_ros.quantity import Z95, shown, spec_for

if TYPE_CHECKING:
    from proprio_ros.probes.payload.identify import Weighed

WORTH = 0.8  # of its half width, at most, that an interval has to have left for advice to be worth a recording
MOST_TIMES = 3  # nobody repeats a recording more often for a narrower interval


def what_would_narrow(weighed: Weighed, verdict: Verdict) -> tuple[str, ...]:
    """A sentence where more pushes or a known load would narrow the interval, with what it would be then.

    Args:
        weighed: By pushes, with a calibrated robot; of another nothing is said.
        verdict: Of the answer.
    """
    assessed = weighed.assessed
    calibrated = weighed.known and weighed.robot.calibration is not None
    given = verdict in (Verdict.ACCEPTED, Verdict.TOO_WIDE)
    if not calibrated or not given:
        return ()
    now_kg = Z95 * assessed.std
    pushes = sum(run.load is None for run in weighed.runs)
    # as often as it takes, and else as often as anybody would
    for times in range(1, MOST_TIMES + 1):
        repeated_kg = half_width_with_more(weighed, times)
        if repeated_kg <= WORTH * now_kg:
            break
    known_kg = math.inf
    load_kg = _round(assessed.value)
    if assessed.value > now_kg:
        known_kg = half_width_with_known_load(weighed, load_kg)
    if min(repeated_kg, known_kg) > WORTH * now_kg:
        return ()
    spec = spec_for("kg", assessed.std)
    once = times * pushes == 1
    more = f"{times * pushes} more push{'' if once else 'es'} alike"
    by_pushes = f"+-{shown('kg', repeated_kg, spec=spec)}"
    instead = f"instead of +-{shown('kg', now_kg, spec=spec)}"
    if known_kg > repeated_kg:
        return (f"what would narrow it: {more}: then about {by_pushes} {instead}",)
    by_load = f"+-{shown('kg', known_kg, spec=spec)}"
    load = shown("kg", load_kg, spec="g")
    return (
        f"what would narrow it most: a calibration with a known load of about {load}, pushed alike (`proprio calibrate EMPTY .. "
        f"--reference BAG=KG`): then about {by_load} {instead}; {more}: about {by_pushes}",
    )


def half_width_with_more(weighed: Weighed, times: int) -> float:
    """What the interval's half width would be with the pushes of the recording made so many times more [kg].

    Args:
        weighed: As they were.
        times: How often each of them is repeated.
    """
    made = weighed.opened.problem
    rows = [row for row, run in enumerate(made.runs) if run.load is None]
    origins = [*range(len(made.runs)), *rows * times]
    runs = [made.runs[origin] for origin in origins]
    # what a command says otherwise than the motor does is in all pushes of a joint alike
    before = Counter(run.run.joint for run in made.runs)
    after = Counter(run.run.joint for run in runs)
    runs = [
        replace(
            run,
            current_torque_std=run.current_torque_std
            * math.sqrt(after[run.run.joint] / before[run.run.joint]),
        )
        for run in runs
    ]
    robot = made.robot
    unknowns = load_unknowns(robot, runs, made.facts, Role.ESTIMATED, weighed.assessed.value)
    foreseen = _foreseen(weighed, runs, unknowns, origins)
    place = foreseen.problem.column_of(weighed.name)
    return _half_width(weighed, float(foreseen.covariance[place, place]))


def half_width_with_known_load(weighed: Weighed, load_kg: float) -> float:
    """What it would be after a calibration to which the same pushes were added, with a known load in the object's place [kg].

    Args:
        weighed: As they were.
        load_kg: What that load weighs.
    """
    made = weighed.opened.problem
    learnt = _learnt(weighed, KnownLoad(load_kg, weighed.facts))
    at = {learnt.problem.unknowns[row].key: n for n, row in enumerate(learnt.problem.estimated)}
    estimated = made.estimated_unknowns()
    shared = [
        place for place, unknown in enumerate(estimated) if unknown.shared and unknown.key in at
    ]
    taken = [at[estimated[place].key] for place in shared]
    elsewhere = np.array([estimated[place].kind == "zero" for place in shared])
    prior = learnt.covariance[np.ix_(taken, taken)]
    prior = prior + np.diag(weighed.assessed.zero_repeat**2 * elsewhere)
    precision = made.coordinates.prior_precision.copy()
    precision[np.ix_(shared, shared)] = scaled_inverse(prior)
    seen = weighed.assessed.posterior.sensitivity
    variance = scaled_inverse(seen.T @ seen + precision)
    place = weighed.opened.column(weighed.name)
    return _half_width(weighed, float(variance[place, place]))


def _learnt(weighed: Weighed, load: KnownLoad) -> Posterior:
    """What would be known of the robot by the same pushes of a known load, in whose recording the zeros are the calibration's."""
    made = weighed.opened.problem
    rows = [row for row, run in enumerate(made.runs) if run.load is None]
    runs = [replace(made.runs[row], load=load) for row in rows]
    unknowns = robot_unknowns(replace(made.robot, zero_repeat=0.0), runs, Role.ESTIMATED)
    return _foreseen(weighed, runs, unknowns, rows, zero_repeat=0.0)


def _half_width(weighed: Weighed, variance: float) -> float:
    """With another variance of the fit: what else was counted stays."""
    assessed = weighed.assessed
    place = weighed.opened.column(weighed.name)
    counted = assessed.std**2 - float(assessed.posterior.covariance[place, place])
    return Z95 * math.sqrt(max(counted, 0.0) + variance)


def _foreseen(
    weighed: Weighed,
    runs: Sequence[PreparedRun],
    unknowns: Sequence[Unknown],
    origins: Sequence[int],
    **changed: float,
) -> Posterior:
    """What would be known after some runs, at the values that were found.

    Args:
        weighed: Whose values they are.
        runs: That are foreseen.
        unknowns: Of them.
        origins: As which of the recorded runs each of them goes.
        changed: Of the robot.
    """
    fit = weighed.opened
    found = fit.problem.index
    values = []
    for unknown in unknowns:
        key = unknown.key
        if isinstance(unknown.scope, int):
            key = (unknown.kind, origins[unknown.scope])
        values.append(float(fit.values[found[key]]) if key in found else unknown.value)
    problem = Problem(
        replace(fit.problem.robot, **changed),  # type: ignore[arg-type]
        runs,
        fit.problem.facts,
        unknowns,
        weighed.options.integrator,
        weighed.options.step_s,
    )
    return Posterior(problem, np.array(values), weighed.assessed.inflation)


def _round(mass_kg: float) -> float:
    """A mass of one digit near this one [kg]."""
    if mass_kg <= 0.0:
        return 0.0
    digit = 10.0 ** math.floor(math.log10(mass_kg))
    return digit * round(mass_kg / digit)
