"""What ``effort`` of joint states means: a torque, a current, or counts of one; where nobody states it, it is not guessed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.signs import Signs
from proprio_ros.quantity import COUNT, EFFORTS, unit_called
from proprio_ros.records import MEASURED_EFFORT, FloatArray, InputRecord, JointRecord, TimeArray

EFFORT_UNITS = tuple(EFFORTS)
CURRENT_PER_COUNT_A = COUNT.in_si


def ampere(
    unit: str,
    per_count_A: float = CURRENT_PER_COUNT_A,
) -> float:
    """Ampere of one of a unit of current, one of `EFFORTS`; a count has the size that its driver says."""
    current = EFFORTS[unit]
    assert current.si == "A", unit
    return per_count_A if current is COUNT else current.in_si


def held(values: FloatArray) -> FloatArray:
    """Each column keeps its last finite value; zero before the first."""
    known = np.isfinite(values)
    last = np.maximum.accumulate(
        np.where(
            known,
            np.arange(len(values))[:, None],
            -1,
        ),
        axis=0,
    )
    return np.where(
        last < 0,
        0.0,
        np.take_along_axis(values, np.maximum(last, 0), axis=0),
    )


def known_or_none(values: FloatArray) -> FloatArray | None:
    """The same with NaN for whatever is not finite; None where nothing is."""
    values = np.where(np.isfinite(values), values, np.nan)
    return None if bool(np.isnan(values).all()) else values


def effort_sign_option(
    joints: Sequence[str],
    wrong: Collection[str],
    turned: Collection[str],
) -> str:
    """The option with which the efforts of some joints count the other way than they did.

    Args:
        joints: All of the arm that have a motor.
        wrong: Those of them whose effort counts the wrong way.
        turned: Those whose effort was multiplied by -1, as was stated.
    """
    signs = {joint: -1 if (joint in turned) != (joint in wrong) else 1 for joint in joints}
    every = 1 if sum(signs.values()) > 0 else -1
    others = [f"{joint}={sign}" for joint, sign in signs.items() if sign != every]
    stated = [] if others and every == 1 and not turned else [str(every)]
    return f"--effort-sign {','.join([*stated, *others])}"


@dataclass(frozen=True)
class Effort:
    """What effort is, as the user states it; an unknown unit is refused (`ConfigurationError`)."""

    unit: str | None  # one of `EFFORT_UNITS`; None: not stated
    # torque constants with which efforts were made of currents, by joint [N m/A or N/A]
    nominal: Mapping[str, float]
    per_count_A: float = CURRENT_PER_COUNT_A  # current of one raw count [A]
    signs: Signs = field(default_factory=Signs)  # by what recorded efforts are multiplied

    def __post_init__(self) -> None:
        if self.unit is not None:
            object.__setattr__(self, "unit", unit_called(self.unit, EFFORTS))
        if self.unit is not None and self.unit not in EFFORT_UNITS:
            raise ConfigurationError(
                f"effort unit {self.unit!r} is not known; choose from {', '.join(EFFORT_UNITS)}"
            )

    def constants(self, names: Sequence[str]) -> FloatArray:
        """Nominal torque constants [N m/A or N/A], NaN where unknown, shape (J,)."""
        known = (self.nominal.get(name, 0.0) for name in names)
        return np.array([float(value) if value > 0.0 else np.nan for value in known])

    def record(
        self,
        times_ns: TimeArray,
        names: tuple[str, ...],
        position: FloatArray,
        velocity: FloatArray | None,
        recorded: FloatArray,
    ) -> JointRecord:
        """Joint states with the effort and the measured current that the recorded effort stands for.

        Args:
            times_ns: Of the joint states [ns], shape (T,).
            names: Of the joints, length J.
            position: [rad or m], shape (T, J).
            velocity: [rad/s or m/s], shape (T, J); None where none was recorded.
            recorded: Efforts in their own unit, not finite where there is none, shape (T, J).

        Returns:
            The joint states.
        """
        signs = np.array(
            [self.signs.of(name) for name in names],
            dtype=np.float64,
        )  # (J,)
        reported = known_or_none(signs * recorded)
        effort = current = None
        if reported is not None and self.unit == "N.m":
            effort = reported
            current = known_or_none(reported / self.constants(names))
        elif reported is not None and self.unit is not None:
            current = reported * ampere(self.unit, self.per_count_A)
        turned = self.signs.turned(names)
        return JointRecord(times_ns, names, position, velocity, effort, current, reported, turned)

    def measured(self, record: JointRecord) -> InputRecord | None:
        """Input from what the motors reported; None where no joint's current is known."""
        if record.current is None or self.unit is None:
            return None
        known = np.asarray(np.isfinite(record.current).any(axis=0))
        names = tuple(name for name, column in zip(record.names, known, strict=True) if column)
        return InputRecord(
            record.times_ns, names, held(record.current[:, known]), MEASURED_EFFORT, self.unit
        )
