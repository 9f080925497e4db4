"""The median of a few neighbours: as `scipy.ndimage` has it, which takes longer to import than a push takes to weigh."""

from __future__ import annotations

import numpy as np


def running_median(
    values: np.ndarray,
    width: int,
    beyond: str = "edge",
) -> np.ndarray:
    """Median of each sample and those around it.

    Args:
        values: Shape (T,).
        width: How many together; an odd number.
        beyond: What is beyond the ends, of `numpy.pad`: "edge" repeats the last sample, "reflect" goes back from it.

    Returns:
        Shape (T,).
    """
    middle = width // 2
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(values, middle, mode=beyond),  # type: ignore[call-overload]
        width,
    )
    return np.partition(around, middle, axis=-1)[:, middle]
