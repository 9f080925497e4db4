"""How much a long motion counts: what a model lacks does not shrink with the data, and a longer recording shows it again.

Residuals of one stretch have nothing to do with those of the next, so far as friction and controllers forget within one. But
what the model lacks is a torque that depends on place, direction and warmth, and an arm comes back to these: after a minute of
motion it has been at most places where it ever will be, and more of the same says again what was said. So the variance of a mean
over S stretches has a part that falls as 1 / S and a part that does not, and a recording counts as so many stretches as have that
variance if they were independent, `counting`. A recording without that limit would end surer than its model is right, and be
refused by tests that believe it.

What counts no more need not be kept: of each joint the equations of `MOST_STRETCHES` are, from all along the recording.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from proprio_ros.records import BoolArray, FloatArray

INDEPENDENT_STRETCHES = 24
"""A minute: so many stretches of a recording count in full. Until then an arm goes to places where it has not been."""
COMES_AGAIN = 0.5
"""Share of what is left over of a minute that is left over of every other one, too: a guess, since no recording shows it."""
MOST_STRETCHES = 96
"""Of each joint so many are kept, four minutes: all of a longer recording would make what is left over count a tenth less."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def counting(stretches: FloatArray) -> FloatArray:
    """As how many independent stretches recordings of so many count, at least 1 each; of any shape."""
    beyond = np.minimum(INDEPENDENT_STRETCHES / stretches, 1.0)
    most = INDEPENDENT_STRETCHES / (COMES_AGAIN + (1.0 - COMES_AGAIN) * beyond)
    return np.where(stretches > INDEPENDENT_STRETCHES, most, stretches)


def kept_windows(moves: BoolArray, stretch: NDArray[np.int64]) -> BoolArray:
    """Windows of a recording whose equations are kept.

    Args:
        moves: Whether a joint moves in a window, shape (W, n).
        stretch: Number of each window's stretch, shape (W,).

    Returns: Shape (W,); all of them where no joint moves in more than `MOST_STRETCHES`.
    """
    of_joints = [np.unique(stretch[of_joint]) for of_joint in moves.T]
    if max(len(stretches) for stretches in of_joints) <= MOST_STRETCHES:
        return np.ones(len(stretch), dtype=bool)
    chosen = np.empty(0, np.int64)
    for stretches in of_joints:
        known = np.isin(stretches, chosen)
        more = _spread(stretches[~known], MOST_STRETCHES - int(known.sum()))
        chosen = np.concatenate([chosen, more])
    kept: BoolArray = np.isin(stretch, chosen)
    return kept


def _spread(stretches: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """So many of some, one of each of as many equal parts; all where there are fewer."""
    if len(stretches) <= count:
        return stretches
    part = np.arange(max(count, 0))
    # each at another place of its part: of a motion that repeats itself equal steps might meet the same phase again and again
    places = (part + part * GOLDEN % 1.0) * (len(stretches) / max(count, 1))
    return stretches[places.astype(np.int64)]


def counted_share(
    motion: NDArray[np.int64], joint: NDArray[np.int64], stretch: NDArray[np.int64]
) -> FloatArray:
    """As what share of itself each equation counts, by the stretches that its joint has in its motion, shape (E,).

    ``motion``, ``joint``, ``stretch``: numbers of each equation's, shape (E,).
    """
    share = np.ones(len(joint))
    for number in np.unique(motion):
        for moved in np.unique(joint[motion == number]):
            mine = (motion == number) & (joint == moved)
            stretches = float(len(np.unique(stretch[mine])))
            share[mine] = counting(np.array(stretches)) / stretches
    return share
