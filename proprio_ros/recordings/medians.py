"""Median and extremes of a few neighbours: as `scipy.ndimage` has them, which takes longer to import than a push to weigh."""

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


def running_extremes(values: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest of each sample and those around it, ``width`` together, shape (T,) each; beyond the ends they come back."""
    low = np.pad(values, (width // 2, width - 1 - width // 2), mode="symmetric")
    high = low
    together = 1
    while together < width:
        on = min(together, width - together)
        low = np.minimum(low[:-on], low[on:])
        high = np.maximum(high[:-on], high[on:])
        together += on
    return low, high
