"""Runs with something that moves by itself in the hand, and runs without, behind the face of one simulator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from proprio_ros.sim.joint import JointRun, JointSimulator

_Special = TypeVar("_Special", bound=JointSimulator)


class MixedSimulator(Generic[_Special]):
    """Worlds of runs with an object go to its simulator, the others to the joint's.

    Parameter vectors are those of the object's simulator for every world; the joint's come first in them.
    ``with_object`` says which of all runs, shape (R,), are those of the special simulator; they and the plain ones keep
    their order.
    """

    def __init__(
        self,
        special: _Special,
        plain: Sequence[JointRun],
        with_object: Sequence[bool] | np.ndarray,
        integrator: str = "rk4",
    ) -> None:
        self.special = special
        self.plain = JointSimulator(plain, integrator) if plain else None
        self.with_object = np.asarray(with_object, dtype=bool)
        self.parameters = special.parameters
        own = iter(special.runs)
        others = iter(plain)
        self.runs = tuple(next(own) if has else next(others) for has in self.with_object)
        has = self.with_object
        self._local = np.where(has, np.cumsum(has), np.cumsum(~has)).astype(np.int32) - 1
        self.sample_counts = np.array(
            [len(run.sample_times_s) for run in self.runs], dtype=np.int32
        )
        self.sample_counts.setflags(write=False)

    def windows(self, fraction: float) -> np.ndarray:
        """As ``JointSimulator.windows``."""
        counts = np.empty(len(self.runs), dtype=np.int32)
        for part, mine in self._parts():
            counts[mine] = part.windows(fraction)
        return counts

    def jacobian(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As ``JointSimulator.jacobian``, each world by the simulator of its run.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters of each world in the order of the object's simulator, shape (W, P).
            dp: D tangent directions of each world in parameter space, shape (W, P, D).
            counts: Only the first ``counts[r]`` samples of run r are computed, shape (R,); default all.

        Returns:
            q (W, T), v (W, T), dq (W, T, D).
        """
        if self.plain is None:
            return self.special.jacobian(world_run, p, dp, counts)
        counts = self.sample_counts if counts is None else counts
        shape = (len(world_run), int(self.sample_counts.max()))
        q = np.zeros(shape)
        v = np.zeros(shape)
        dq = np.zeros((*shape, dp.shape[2]))
        for part, mine in self._parts():
            rows = np.flatnonzero(mine[world_run])
            if len(rows):
                width = len(part.parameters)
                along = dp[rows, :width]
                # an empty hand has fewer parameters than what moves in another: it is looked at along its own, and then chained
                chained = part is self.plain and dp.shape[2] > width
                given = np.tile(np.eye(width), (len(rows), 1, 1)) if chained else along
                *states, slopes = part.jacobian(
                    self._local[world_run[rows]], p[rows, :width], given, counts[mine]
                )
                for whole, own in zip(
                    (q, v, dq), (*states, slopes @ along if chained else slopes), strict=True
                ):
                    whole[rows, : own.shape[1]] = own
        return q, v, dq

    def _parts(self) -> list[tuple[JointSimulator, np.ndarray]]:
        parts: list[tuple[JointSimulator, np.ndarray]] = [(self.special, self.with_object)]
        return parts if self.plain is None else [*parts, (self.plain, ~self.with_object)]
