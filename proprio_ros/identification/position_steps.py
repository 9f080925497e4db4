"""A reading that jumps and stays off: an encoder that slipped, a wrap, a zero that was set while the arm was pushed.

What a held joint reads is taken for what it did, and a jump of a driven one bends friction and mass. A body does neither: a held
joint gives way smoothly once its load is there, and a driven one would need a torque that no motor has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from proprio_ros.identification.posterior import Posterior
from proprio_ros.identification.prepared_runs import PreparedRun
from proprio_ros.records import BoolArray

NEAR = 3
"""So many readings to each side say how a joint goes on without a jump."""
YIELDS_S = 0.05  # a held joint gives way that fast when the current comes on
# A driven joint that loses so much of its speed within some readings is stopped, by more than weight and friction can.
STOPS_SHARE = 0.4
FAST_QUANTILE = 0.95  # of its speeds, beyond what one reading that is off makes
JUMP_STDS = 8.0
"""Standard deviations of a reading that a joint may seem to jump: held ones of simulated servos that give way, with friction that
sticks and backlash among them, moved by at most 4.6 from one reading to the next. A driven one that sticks and slips, read in whole
counts of its encoder, seemed to by 3."""
FEWEST = 2  # readings to each side of a jump of the driven joint


def held_jump(run: PreparedRun) -> str:
    """A sentence about the largest jump of a joint that is held and matters; empty where there is none."""
    times_s = np.concatenate([run.run.before_times_s, run.run.times_s])
    brakes = _brakes(run)
    worst = JUMP_STDS * run.drive.reading_std
    said = ""
    for name in run.kind.yielding(run.coefficients.pose):
        readings = run.run.held_position.get(name)
        if readings is None or len(readings) < 2 * NEAR + 2:
            continue
        jumps = _jumps(readings)
        jumps[(times_s[1:] < YIELDS_S) | brakes] = 0.0
        row = int(np.argmax(np.abs(jumps)))
        if abs(jumps[row]) > worst:
            worst = float(abs(jumps[row]))
            by = f"jumps by {1e3 * jumps[row]:+.0f} mrad within {1e3 * (times_s[row + 1] - times_s[row]):.0f} ms"
            said = f"the reading of {name}, which is held, {by}, {times_s[row + 1]:.2f} s after the start"
    return said


def _brakes(run: PreparedRun) -> BoolArray:
    """Between which readings the driven joint stops hard, shape (T - 1,): a joint that is held gives way to that.

    A run ends before its arm is stopped, but for one whose commands are stamped late.
    """
    times_s = np.concatenate([run.run.before_times_s, run.run.times_s])
    position = np.concatenate([run.run.before_position, run.run.position])
    apart_s = np.maximum(np.diff(times_s), 1e-6)
    speed = np.abs(np.diff(position) / apart_s)
    fastest = float(np.quantile(speed, FAST_QUANTILE))
    brakes = np.zeros(len(speed), dtype=bool)
    for row in range(NEAR, len(speed) - NEAR + 1):
        before = float(np.median(speed[row - NEAR : row]))
        after = float(np.median(speed[row : row + NEAR]))
        brakes[row] = before - after > STOPS_SHARE * fastest
    return brakes


def _jumps(readings: np.ndarray) -> np.ndarray:
    """By what each reading is off the one before for good, beyond how fast the joint goes there, shape (T - 1,); 0 at the ends."""
    steps = np.diff(readings)
    jumps = np.zeros(len(steps))
    for row in range(NEAR, len(steps) - NEAR + 1):
        before = steps[row - NEAR : row]
        beside = np.concatenate([before, steps[row + 1 : row + NEAR]])
        at_once = steps[row] - float(np.median(beside))
        after = readings[row + 1 : row + 1 + NEAR].mean()
        stays = float(after - readings[row + 1 - NEAR : row + 1].mean())
        if at_once * stays > 0.0:
            jumps[row] = np.sign(stays) * min(abs(at_once), abs(stays))
    return jumps


@dataclass(frozen=True)
class _Step:
    """By how much something is off from a sample on, and the part of chi-square that this explains."""

    size: float
    gain: float
    run: PreparedRun | None = None
    at_s: float = 0.0


def driven_jump(posterior: Posterior, chi2: float, explained: float) -> str:
    """A sentence about a jump of a driven joint without which chance explains a fit that it does not with it; else empty.

    A score test: what the residuals have of a step at each reading, over the information that no unknown of the fit takes. Where
    chi-square is hardly beyond chance, any small step brings it back: only one is named that is as large against a reading as a
    held joint's has to be, and as sure. Where a clock that steps explains more, it is not named: then readings differ by how fast
    the joint goes. Both look nearly alike, so the sentence names both.

    Args:
        posterior: Of the fit, without inflation.
        chi2: Of the fit.
        explained: Chi-square up to which chance explains it.
    """
    readings = _Step(0.0, max(chi2 - explained, JUMP_STDS**2))
    clock_gain = 0.0
    for number, run in enumerate(posterior.problem.runs):
        own = np.flatnonzero(posterior.run == number)
        speed = np.gradient(
            run.position[: run.used],
            run.times_s[: run.used],
        )
        for count in range(FEWEST, run.used - FEWEST + 1):
            from_here = np.arange(run.used) >= count
            off = np.zeros(len(posterior.residual))
            off[own] = from_here / run.sigma
            late = np.zeros(len(posterior.residual))
            late[own] = from_here * speed / run.sigma
            clock_gain = max(clock_gain, _step(posterior, late).gain)
            found = _step(posterior, off)
            large = abs(found.size) > JUMP_STDS * run.drive.reading_std
            if large and found.gain > readings.gain:
                readings = replace(found, run=run, at_s=float(run.times_s[count]))
    if readings.run is None or clock_gain > readings.gain:
        return ""
    run = readings.run
    size = f"{1e3 * readings.size:+.0f} mrad {1e3 * readings.at_s:.0f} ms after its start"
    return f"{run.run.name}: the reading of {run.run.joint} jumps by about {size}, or its clock steps there"


def _step(posterior: Posterior, seen: np.ndarray) -> _Step:
    """Of what the residuals see so, per unit, shape (N,)."""
    across = posterior.sensitivity.T @ seen
    information = float(seen @ seen - across @ posterior.covariance @ across)
    if information <= 0.0:
        return _Step(0.0, 0.0)
    size = float(seen @ posterior.residual - across @ posterior.step) / information
    return _Step(size, size**2 * information)
