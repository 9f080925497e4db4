"""What pushes that have not been made would show, simulated over the longest duration and linearised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Forecast:
    """Of C pushes with T samples each."""

    times_s: np.ndarray  # of the samples, since the current comes on, (T,)
    travel: np.ndarray  # how far from its start, signed, in the unit of a push's travel, (C, T)
    counted: np.ndarray  # how many samples there are until travel or speed ends a push, (C,)
    stds: np.ndarray  # of what is sought, with all samples up to each, (C, T)

    def samples_in(self, push: int, duration_s: float) -> int:
        """How many samples a push has whose current stays on so long."""
        return min(
            int(np.searchsorted(self.times_s, duration_s + 1e-9)),
            int(self.counted[push]),
        )

    def farthest(self, push: int, samples: int) -> float:
        """Where the first samples of a push are farthest from its start, signed."""
        travel = self.travel[push, :samples]
        return float(travel[np.argmax(np.abs(travel))])


def until_broken(holds: np.ndarray) -> np.ndarray:
    """The samples of each row before the first for which a condition does not hold, (C, T)."""
    return np.asarray(np.cumprod(holds, axis=1).astype(bool))


def whitened(
    slopes: np.ndarray,
    velocity: np.ndarray,
    alive: np.ndarray,
    reading_std: np.ndarray,
    stamp_jitter_s: float,
) -> np.ndarray:
    """Sensitivities of the encoder's readings over their standard deviation, (C, T, F); zero where a sample does not count.

    Args:
        slopes: Of the reading by F unknowns, (C, T, F).
        velocity: Of the joint, by which a late stamp is off [rad/s or m/s], (C, T).
        alive: Which samples count, (C, T).
        reading_std: Standard deviation of a reading at rest [rad or m], (C,).
        stamp_jitter_s: Standard deviation of a stamp [s].
    """
    moved = np.where(alive, np.abs(velocity), 0.0) * stamp_jitter_s
    sigma = np.hypot(reading_std[:, None], moved)
    return np.where(
        alive[..., None],
        slopes / sigma[..., None],
        0.0,
    )


def gain_per_s(variance: float, after: float, seconds: float) -> float:
    """Information about what is sought that a push gains for each second that it takes [nat/s].

    Args:
        variance: Before the push, in the square of its unit.
        after: After it, in the same unit.
        seconds: With the way to its start, rest and brake [s].
    """
    return 0.5 * float(np.log(variance / after)) / seconds
