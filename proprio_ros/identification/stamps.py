"""Whether the stamps of the input fit the motion, which says itself when a push began and when it ended.

A joint that sticks may begin late, but none begins before its push. And a joint that moves where its current pushes it slows down
once that has ended, whether it then coasts or is braked. Where the stamps say otherwise by more than the delay may be, the input is
not what drove the samples beside it, and no fit of them means anything: friction and armature bend to it, and so does the mass.
"""

from __future__ import annotations

import numpy as np

from proprio_ros.identification import sentences
from proprio_ros.identification.fit import FitResult
from proprio_ros.identification.locked_joints import rests_from
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.identification.reasons import Reason
from proprio_ros.records import MEASURED_EFFORT
from proprio_ros.sim.joint import INDEX

STDS = 3.0
"""So many standard deviations the delay may be from what is known of it, but at least half a period of the joint states."""
SURE = 16.0
"""How much worse (chi-square, four standard deviations) the latest onset that the stamps allow must explain the beginning."""
BEGINS_RAD = 0.1  # the beginning of a push ends here ..
BEGINS_S = 0.2
""".. or after so long: so far, its acceleration changes little and steadily. A load that a push hardly moves takes 0.4 s for that
way, and by then gravity, friction and joints that yield have changed its acceleration otherwise than any cubic."""
RESTED_S = 0.5  # of the rest before it, so much is looked at
GRID_S = 0.004  # onsets are looked for at instants so far apart
FORETELL_S = 0.25  # so much of the motion before the end of a push foretells how it would go on
# a slower joint may stop and stick where its push ends, which looks as if nothing had changed
MOVING_RAD_S = 0.5
SHARE = 0.75
"""A change of acceleration that is below this part of what the end of the current makes, by three standard deviations, is none."""
MIN_BEYOND = 2  # samples beyond the end that it takes to see that


def stamps_off(fit: FitResult) -> list[Reason]:
    """A sentence for each run of a fit whose input is stamped otherwise than its joint moved."""
    problem = fit.problem
    robot = problem.robot
    every, _ = problem.parameters(fit.values[None], np.zeros(0, dtype=int))
    parameters = every[0]
    found: list[Reason] = []
    for run, row in zip(problem.runs, parameters, strict=True):
        # where nothing was commanded, or it comes in one message with the positions
        if "delay" in run.kind.unneeded or run.run.source == MEASURED_EFFORT:
            continue
        # what is shaken inside a container pushes back at any time
        if len(run.run.input_times_s) > 1:
            continue
        # fingers meet something, which pushes back, too
        if robot.model.joint(run.run.joint).kind == "prismatic":
            continue
        period = float(np.median(np.diff(run.run.times_s)))
        spread = max(
            STDS * float(np.hypot(robot.delay.std, run.kind.repeats(robot, run)["onset"])),
            0.5 * period,
        )
        change = (
            -row[INDEX["torque_constant"]]
            * float(run.run.input_current_A[-1])
            / row[INDEX["inertia"]]
        )
        # what begins before it is said to, ends before it is said to
        begun_s = moves_before(
            run,
            robot.delay.value - spread,
            robot.stamp_jitter_s,
        )
        of = (run.run.name, run.run.joint, run.run.source)
        if begun_s is not None:
            found.append(sentences.moved_before(*of, -begun_s))
            continue
        driven_s = driven_beyond(
            run,
            robot.delay.value + spread,
            change,
            robot.stamp_jitter_s,
        )
        if driven_s is not None:
            found.append(sentences.driven_beyond(*of, driven_s))
    return found


def moves_before(run: PreparedRun, least_s: float, jitter_s: float) -> float | None:
    """The latest onset that explains how a push begins, where that is earlier than it may be; else None.

    The joint rests, and from its onset on goes as ``a u^2 + b u^3``. Friction that falls with speed lets an onset seem later than
    it was, never earlier.

    Args:
        run: That was pushed.
        least_s: The earliest onset that the stamps allow, counted from the onset of the input [s].
        jitter_s: How far stamps scatter [s].
    """
    since = run.run.before_times_s >= least_s - RESTED_S
    since[
        : rests_from(
            run.run.before_times_s,
            run.run.before_position,
            run.drive,
        )
    ] = False
    times_s = np.concatenate([run.run.before_times_s[since], run.times_s])
    position = np.concatenate([run.run.before_position[since], run.position])
    away = np.abs(position - np.median(position[:3])) > BEGINS_RAD
    count = int(np.argmax(away)) if away.any() else len(times_s)
    count = min(count, int(np.searchsorted(times_s, least_s + BEGINS_S)))
    times_s = times_s[:count]
    position = position[:count]
    if count < 7:
        return None
    weight = 1.0 / _sigma(run, times_s, position, jitter_s)
    # two samples of rest, and three of motion; the earliest onset that is allowed is tried itself
    onsets = np.arange(
        least_s - GRID_S * np.floor((least_s - times_s[1]) / GRID_S),
        times_s[-3],
        GRID_S,
    )
    if not len(onsets):
        return None
    since_s = np.maximum(times_s - onsets[:, None], 0.0)
    basis, upper = np.linalg.qr(
        np.stack(
            [np.ones_like(since_s), since_s**3, since_s**2],
            axis=2,
        )
        * weight[:, None]
    )
    seen = (position - position[0]) * weight
    along = seen @ basis
    # what first moves the other way is a joint that creeps at rest
    falls = along[:, 2] / upper[:, 2, 2] * seen[-1] < 0.0
    along[falls, 2] = 0.0
    chi2 = seen @ seen - np.sum(along**2, axis=1)
    best = float(chi2.min())
    good = onsets[chi2 <= best + SURE * max(best / (count - 5), 1.0)]
    return float(good[-1]) if good[-1] < least_s else None


def driven_beyond(
    run: PreparedRun,
    most_s: float,
    change: float,
    jitter_s: float,
) -> float | None:
    """How long after its stated end a current still drives the joint, where that is later than it may; else None [s].

    The motion before the end is followed by a cubic, and so is what comes after, up to where the joint is braked. Had the current
    ended where it must have at the latest, the acceleration would have changed there, by ``change`` or more. A joint that yields to
    a load says nothing: a brake works the other way than the end of its current.

    Args:
        run: A push.
        most_s: The latest that the stamps allow [s], counted from the end of the input.
        change: Of the acceleration by the end of the current, at least [rad/s^2]; 0: nothing can be said.
        jitter_s: Of the stamps.
    """
    if run.cut_reason:  # a stop, a motor without voltage
        return None
    end_s = run.run.duration_s + most_s
    times_s = np.concatenate([run.run.times_s, run.run.after_times_s])
    late = times_s > end_s - FORETELL_S
    position = np.concatenate([run.run.position, run.run.after_position])[late]
    times_s = times_s[late]
    ahead = int(np.searchsorted(times_s, end_s, side="right"))
    if ahead < 7:
        return None
    weight = 1.0 / _sigma(run, times_s, position, jitter_s)
    u = (times_s - end_s) / FORETELL_S
    smooth = np.stack(
        [np.ones_like(u), u, u**2, u**3],
        axis=1,
    )
    bend = 0.5 * np.maximum(times_s - end_s, 0.0)[:, None] ** 2
    chi2, values, _ = _fitted(
        smooth[:ahead],
        position[:ahead],
        weight[:ahead],
    )
    scatter = max(chi2 / (ahead - 4), 1.0)
    if values[1] / FORETELL_S * -np.sign(change) < MOVING_RAD_S:
        return None
    for count in range(ahead + MIN_BEYOND, len(times_s) + 1):
        columns = np.concatenate(
            [smooth[:count], bend[:count]],
            axis=1,
        )
        chi2, values, stds = _fitted(columns, position[:count], weight[:count])
        if chi2 / scatter > count - 5 + SURE:
            return None
        most = np.sign(change) * values[-1] + 3.0 * np.sqrt(scatter) * stds[-1]
        if most < SHARE * abs(change):
            return float(times_s[count - 1]) - run.run.duration_s
    return None


def _sigma(
    run: PreparedRun,
    times_s: np.ndarray,
    position: np.ndarray,
    jitter_s: float,
) -> np.ndarray:
    return np.hypot(
        max(run.drive.reading_std, 1e-9),
        np.gradient(position, times_s) * jitter_s,
    )


def _fitted(
    columns: np.ndarray, position: np.ndarray, weight: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Chi-square of a linear least-squares fit, its values, and their standard deviations."""
    length = np.linalg.norm(columns * weight[:, None], axis=0)
    scaled = columns * weight[:, None] / length
    values, _, _, _ = np.linalg.lstsq(
        scaled,
        position * weight,
        rcond=None,
    )
    residual = scaled @ values - position * weight
    covariance = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    stds = np.sqrt(np.diag(covariance))
    return (
        float(residual @ residual),
        values / length,
        stds / length,
    )
