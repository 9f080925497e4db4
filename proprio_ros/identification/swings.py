"""Free swings: how well a simulation follows them, counted so that intervals are honest.

What a simulated swing misses is no noise of the encoder but a torque that depends on place, direction and load, and neighbouring
samples share it. Each sample therefore counts with the standard deviation at which independent samples would tell as much:
``rms sqrt((1 + r) / (1 - r))`` with r the correlation of neighbours (an autoregression of first order; Bayley & Hammersley 1946,
J. R. Stat. Soc. Suppl. 8(2)), over the part of the samples that the fit's own unknowns have not used up.

A swing tells the ratio of the gravity moment to the inertia, and friction over inertia. Two known loads, or one of known inertia,
make masses of it: they tell the rotor's inertia.
"""

from __future__ import annotations

import numpy as np

from proprio_ros.identification.posterior import Posterior

# a swing may be followed so many times worse than those of the calibration before it contradicts them
MUCH_WORSE = 6.0
CHANGING = 0.5  # friction that differs by more than this share from swing to swing is no friction
MOST_CORRELATED = 0.95
FRICTION_LAW, FRICTION_LAW_SHARE = "friction_law", 0.015
"""Source of uncertainty, and its standard deviation as a share of the mass: gears follow no law of friction better. Masses of real
servos that were let go came out 1.3 to 1.9 % off with whatever law explained the swings (docs: validation)."""
HORN = "horn_put_on_anew"  # source of uncertainty, too: whether it was put on anew
WHOSE = "another_joint"  # likewise: whether the calibration is of another joint
USUAL_SHARE, USUAL_SAMPLES = 0.01, 16.0
"""What a simulation usually misses of a swing's span, and how many independent samples that word counts as: two swings alone may
be followed better than the next one by chance."""


def swing_error(posterior: Posterior) -> float:
    """See the module [rad]."""
    off = _missed(posterior)
    square = sum(float(part @ part) for part in off)
    near = sum(float(part[1:] @ part[:-1]) for part in off)
    correlation = float(np.clip(near / max(square, 1e-300), 0.0, MOST_CORRELATED))
    samples = len(posterior.residual)
    longer = (1.0 + correlation) / (1.0 - correlation)
    independent = samples / longer
    left = independent - min(float(posterior.leverage().sum()), 0.7 * independent)
    found = square / samples * longer * independent / left
    widest = max(float(np.ptp(run.position)) for run in posterior.problem.runs)
    usual = (USUAL_SHARE * widest) ** 2
    return float(np.sqrt((left * found + USUAL_SAMPLES * usual) / (left + USUAL_SAMPLES)))


def stamp_jitter(posterior: Posterior) -> float:
    """Of the stamps [s]: how much more neighbouring samples differ from each other where the joint is fast."""
    moved = []
    squares = []
    for row, (run, part) in enumerate(
        zip(
            posterior.problem.runs,
            _missed(posterior),
            strict=True,
        )
    ):
        beside = 0.5 * (part[2:] + part[:-2])
        rough = np.sqrt(2.0 / 3.0) * (part[1:-1] - beside)
        moved.append(posterior.velocity[posterior.run == row][1:-1] ** 2)
        squares.append(rough**2 - run.drive.reading_std**2)
    speed2 = np.concatenate(moved)
    square = np.concatenate(squares)
    along = max(float(square @ speed2), 0.0)
    return float(np.sqrt(along / max(float(speed2 @ speed2), 1e-300)))


def missed_share(posterior: Posterior) -> float:
    """The worst run's rms residual over its span."""
    return max(
        float(np.sqrt(np.mean(part**2)) / max(np.ptp(run.position), 1e-9))
        for run, part in zip(
            posterior.problem.runs,
            _missed(posterior),
            strict=True,
        )
    )


def _missed(posterior: Posterior) -> list[np.ndarray]:
    """Residuals of each run [rad]."""
    sigma = np.concatenate([run.sigma for run in posterior.problem.runs])
    off = posterior.residual * sigma
    return [off[posterior.run == row] for row in range(len(posterior.problem.runs))]
