"""What a calibration knows about one arm: values with their full covariance, and where they come from.

It is the section ``calibration`` of a robot file that ``extends`` the robot it was made with:

    extends: open_manipulator_x
    calibrated: true
    model_fingerprint: 5ab1..            # of the URDF; another URDF is refused
    calibration:
      runs: [{name: .., joint: joint3, current_A: -0.3, load_kg: 0.0, samples: 24}, ..]
      residual_scale: 1.02               # residuals over what encoder and stamps explain
      stamp_jitter_s: 0.0003             # standard deviation of the stamps, as the runs show it
      torque_disturbance_N_m: 0.0004     # what differs from run to run
      start_velocity_rad_s: 0.003        # how still the held joint is when its probe begins
      unknowns:
        torque_constant[joint3]: {value: 1.74, std: 0.02, unit: N m/A}
      correlation: |                     # lower triangle, a line per unknown in the order above
        1
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from proprio_ros.errors import RobotError
from proprio_ros.kinds import KINDS, Key, key_of, name_of
from proprio_ros.quantity import Quantity

FloatArray = NDArray[np.float64]
_SMALLEST_EIGENVALUE = 1e-12  # of a correlation matrix: below it, rounding has made it no covariance


@dataclass(frozen=True, eq=False)
class Calibration:
    """The robot as its own recordings show it.

    Attributes:
        keys: Of the unknowns, such as ``("coulomb", "joint3")``, length C.
        values: Shape (C,).
        covariance: Shape (C, C), positive definite.
        residual_scale: Residuals over what encoder and stamps explain.
        stamp_jitter_s: Standard deviation of the stamps.
        torque_disturbance: Standard deviation of a torque that differs from run to run [N m].
        start_velocity: Standard deviation of the velocity at which probes begin [rad/s].
        runs: One mapping per run used: name, joint, current_A, load_kg, samples.
    """

    keys: tuple[Key, ...]
    values: FloatArray
    covariance: FloatArray
    residual_scale: float = 1.0
    stamp_jitter_s: float = 0.0
    torque_disturbance: float = 0.0
    start_velocity: float = 0.01
    runs: tuple[Mapping[str, Any], ...] = ()

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns, such as ``coulomb[joint3]``."""
        return tuple(name_of(key) for key in self.keys)

    @functools.cached_property
    def quantities(self) -> dict[Key, Quantity]:
        """Each unknown by key, with its own standard deviation."""
        stds = np.sqrt(np.diag(self.covariance))
        return {key: Quantity(float(v), float(s)) for key, v, s in zip(self.keys, self.values, stds, strict=True)}

    @functools.cached_property
    def correlation(self) -> FloatArray:
        """Shape (C, C)."""
        stds = np.sqrt(np.diag(self.covariance))
        result: FloatArray = self.covariance / stds[:, None] / stds[None, :]
        return result

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints whose drive trains were calibrated."""
        return tuple(str(key[1]) for key in self.keys if key[0] == "torque_constant")

    def without(self, keys: set[Key]) -> Calibration:
        """The same with some unknowns marginalised out; keys that it does not hold are ignored."""
        keep = [row for row, key in enumerate(self.keys) if key not in keys]
        return replace(
            self,
            keys=tuple(self.keys[row] for row in keep),
            values=self.values[keep],
            covariance=self.covariance[np.ix_(keep, keep)],
        )

    def as_settings(self) -> dict[str, Any]:
        """Plain numbers for the file; the correlations as text, which reads a hundred times faster than as YAML numbers."""
        return {
            "runs": [dict(run) for run in self.runs],
            "residual_scale": _short(self.residual_scale),
            "stamp_jitter_s": _short(self.stamp_jitter_s),
            "torque_disturbance_N_m": _short(self.torque_disturbance),
            "start_velocity_rad_s": _short(self.start_velocity),
            "unknowns": {
                name_of(key): {"value": _short(known.value, 15), "std": _short(known.std, 15), "unit": _unit(key)}
                for key, known in self.quantities.items()
            },
            "correlation": "".join(
                " ".join(f"{c:.12g}" for c in row[: n + 1]) + "\n" for n, row in enumerate(self.correlation)
            ),
        }  # fmt: skip

    @classmethod
    def from_settings(cls, section: Any, where: str) -> Calibration:
        """Read the section of a robot file.

        Raises:
            RobotError: A key is missing, a number is none, or the correlations belong to no covariance.
        """
        if not isinstance(section, Mapping):
            raise RobotError(f"{where}: expected keys and values, got {section!r}; write it with `proprio calibrate`")
        unknowns = _part(section, "unknowns", Mapping, where)
        correlation = [line.split() for line in _part(section, "correlation", str, where).splitlines()]
        runs = _part(section, "runs", list, where)
        keys = tuple(key_of(str(name)) for name in unknowns)
        values, stds = [], []
        for name, entry in unknowns.items():
            if not isinstance(entry, Mapping):
                raise RobotError(f"{where}: unknowns: {name}: expected value, std and unit, got {entry!r}")
            values.append(_number(entry.get("value"), f"{where}: unknowns: {name}: value"))
            stds.append(_number(entry.get("std"), f"{where}: unknowns: {name}: std"))
            if stds[-1] <= 0.0:
                raise RobotError(f"{where}: unknowns: {name}: std must be positive, got {stds[-1]}")
        if not keys or [len(row) for row in correlation] != [n + 1 for n in range(len(keys))]:
            raise RobotError(
                f"{where}: correlation must be the lower triangle of {len(keys)} unknowns, one row each; calibrate again"
            )
        matrix = np.zeros((len(keys), len(keys)))
        for n, row in enumerate(correlation):
            try:
                matrix[n, : n + 1] = [float(c) for c in row]
            except ValueError as error:
                raise RobotError(f"{where}: correlation, line {n + 1}: {error}; calibrate again") from error
        matrix = matrix + np.tril(matrix, -1).T
        if not np.all(np.isfinite(matrix)) or np.abs(np.diag(matrix) - 1.0).max() > 1e-9:
            raise RobotError(f"{where}: correlation must be finite, with ones on its diagonal; calibrate again")
        if np.linalg.eigvalsh(matrix)[0] < _SMALLEST_EIGENVALUE:
            raise RobotError(f"{where}: correlation is not one of any covariance; calibrate again")
        scale = np.array(stds)
        return cls(
            keys,
            np.array(values),
            matrix * scale[:, None] * scale[None, :],
            _number(section.get("residual_scale", 1.0), f"{where}: residual_scale"),
            _number(section.get("stamp_jitter_s", 0.0), f"{where}: stamp_jitter_s"),
            _number(section.get("torque_disturbance_N_m", 0.0), f"{where}: torque_disturbance_N_m"),
            _number(section.get("start_velocity_rad_s", 0.01), f"{where}: start_velocity_rad_s"),
            tuple(runs),
        )


def _unit(key: Key) -> str:
    kind = key if isinstance(key, str) else key[0]
    return KINDS[kind].unit if kind in KINDS else ""


def _part(section: Mapping[str, Any], key: str, kind: type, where: str) -> Any:
    if not isinstance(section.get(key), kind):
        raise RobotError(f"{where}: {key} is missing or no {kind.__name__}; write it with `proprio calibrate`")
    return section[key]


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not np.isfinite(float(value)):
        raise RobotError(f"{where}: expected a finite number, got {value!r}")
    return float(value)


def _short(value: float, digits: int = 12) -> float:
    return float(f"{value:.{digits}g}")
