"""The answer: values with intervals, how well the model explains the recording, and what it rests on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from proprio_ros.identification.unknowns import Role
from proprio_ros.kinds import Tag, label_of
from proprio_ros.quantity import (
    Z95,
    shown_unit,
    spec_for,
    written,
)
from proprio_ros.schema import header, reason_codes


class Verdict(str, Enum):
    """What the number is worth."""

    ACCEPTED = "accepted"
    TOO_WIDE = "too_wide"  # the interval is too wide for its share of the value; both are given
    REJECTED = "rejected"  # the model does not explain the recording
    NOT_IDENTIFIABLE = "not_identifiable"  # the recording does not determine it


@dataclass(frozen=True)
class WidthLimit:
    """How wide an answer's 95 % interval may be: half of it may be a share of the value, or the floor where that is more.

    | answer | share | floor | verdict where it is wider |
    | --- | --- | --- | --- |
    | pushes: payload, sphere | `solver.wide_share`, 50 % | `solver.wide_floor_kg`, 5 g | `too_wide`: both ends are given |
    | softness | 50 % | none | `too_wide` |
    | motion of several joints, arm at rest | 50 % | 4 % of the arm's mass | `too_wide` |
    | motion by goals and a servo's law | 20 % | 1 % of the arm's mass | `too_wide` |
    | one joint under a controller | 50 % | none | `not_identifiable`: no mass is stated |
    | calibration by motions, of a light object | 100 % | none | `not_identifiable` |
    | running estimate | 50 % | 10 g | no verdict: it is not known yet |

    A probe of an add-on has its own.
    """

    share: float  # of the value
    floor: float = 0.0  # in its unit; what is nearly nothing has no share to speak of
    verdict: Verdict = Verdict.TOO_WIDE

    def widest(self, value: float) -> float:
        """Half of the widest interval of a value that is allowed, in its unit."""
        return max(self.share * abs(value), self.floor)

    def exceeded_by(self, value: float, half: float) -> bool:
        """Whether half an interval is too wide for its value, both in its unit."""
        return half > self.widest(value)

    def exceeded_as_printed(self, value: float, std: float) -> bool:
        """The same of a quantity that is not negative, whose interval ends at nothing."""
        low, high = not_negative(value, std)
        return self.exceeded_by(max(value, 0.0), 0.5 * (high - low))


WIDEST_SHARE = 0.5  # of its value that half an interval may be, where no setting says otherwise
WIDEST_FLOOR_KG = 0.005  # of the mass of pushes, likewise
LIMIT_OF_ONE_JOINT = WidthLimit(WIDEST_SHARE, verdict=Verdict.NOT_IDENTIFIABLE)
LIMIT_OF_CALIBRATION = WidthLimit(1.0, verdict=Verdict.NOT_IDENTIFIABLE)
LIMIT_WHILE_RUNNING = WidthLimit(WIDEST_SHARE, 0.01)
WIDEST_OF_ARM = 0.04  # of the arm's own mass
WIDEST_SHARE_BY_GOALS = 0.2
WIDEST_OF_ARM_BY_GOALS = 0.01
"""Torques that are made of goals were read up to half wrong where goals came late: what is left as wide as that is no answer."""


def limit_in_motion(arm_kg: float) -> WidthLimit:
    """For a mass weighed by an arm of so many kg, in motion or at rest."""
    return WidthLimit(WIDEST_SHARE, WIDEST_OF_ARM * arm_kg)


def limit_by_goals(arm_kg: float) -> WidthLimit:
    """For a mass weighed by an arm of so many kg whose torques are made of its servos' goals."""
    return WidthLimit(WIDEST_SHARE_BY_GOALS, WIDEST_OF_ARM_BY_GOALS * arm_kg)


def not_negative(
    value: float,
    std: float,
    quantile: float = Z95,
) -> tuple[float, float]:
    """The 95 % interval of a quantity that cannot be negative: its lower end is cut off at 0, its upper end stays.

    An estimate below nothing says what one at nothing does, and no more: its posterior, cut off there, would be the
    narrower the less likely it is.

    Args:
        value: That was found.
        std: Its standard deviation.
        quantile: Half the width of a 95 % interval in standard deviations.
    """
    half = quantile * std
    return max(value - half, 0.0), max(value, 0.0) + half


@dataclass(frozen=True)
class Value:
    """One estimated quantity; numbers are ``None`` where they cannot be determined, and ``reason`` says why."""

    name: str
    unit: str
    value: float | list[float | None] | None
    std: float | list[float | None] | None = None
    ci95: Any = None
    reason: str = ""
    # the interval if a joint's zero moved since the calibration by as much as may go unseen; None where that changes little
    if_zeros_moved: list[float] | None = None

    @property
    def label(self) -> str:
        """For people: ``Young's modulus``."""
        return label_of(self.name)

    @property
    def parts(self) -> list[Value]:
        """Of a vector or a tensor, each as a value of its own; a number as it is."""
        if not isinstance(self.value, list):
            return [self]
        axes = {
            3: ("x", "y", "z"),
            6: ("xx", "xy", "xz", "yy", "yz", "zz"),
        }.get(len(self.value), range(len(self.value)))
        stds = self.std if isinstance(self.std, list) else [None] * len(self.value)
        ends = self.ci95 if isinstance(self.ci95, list) else [None] * len(self.value)
        return [
            Value(
                f"{self.label}, {axis}",
                self.unit,
                value,
                std,
                end,
                "" if value is not None else self.reason,
            )
            for axis, value, std, end in zip(axes, self.value, stds, ends, strict=True)
        ]

    @property
    def known(self) -> bool:
        """Whether there is any number."""
        return any(part.value is not None for part in self.parts)

    def in_words(self) -> str:
        """Numbers with as many digits as they are known to, in the unit that a reader wants; by axis where some are withheld."""
        factor, unit = shown_unit(self.unit)
        numbers = {
            part.name.rpartition(" ")[2]: written(
                factor * part.value,  # type: ignore[operator]
                spec_for(self.unit, part.std),  # type: ignore[arg-type]
            )
            for part in self.parts
            if part.value is not None
        }
        if len(numbers) == len(self.parts):
            return f"[{', '.join(numbers.values())}] {unit}"
        return f"{', '.join(f'{axis} {words}' for axis, words in numbers.items())} {unit}"

    def as_json(self) -> dict[str, Any]:
        return picked(
            self,
            "name",
            "value",
            "std",
            "ci95",
            "unit",
            *(["reason"] if self.reason else []),
            *(["if_zeros_moved"] if self.if_zeros_moved is not None else []),
        )


@dataclass(frozen=True)
class Fit:
    """How well the simulation follows the recording over the samples used."""

    rms: float
    expected_rms: float
    reduced_chi2: float
    unit: str = "rad"
    condition: float = float("nan")

    def as_json(self) -> dict[str, Any]:
        return picked(
            self,
            "rms",
            "expected_rms",
            "unit",
            "reduced_chi2",
            "condition",
        )


@dataclass(frozen=True)
class RunFit:
    """One run as recorded and as simulated at the estimate; over the used window where nothing else is said, shape (K,)."""

    name: str
    joint: str
    source: str
    current_A: float
    times_s: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    sigma: np.ndarray
    left_out_times_s: np.ndarray  # samples after the window, which did not count
    left_out: np.ndarray
    travel: float


@dataclass(frozen=True)
class RecordedRun:
    """One run as it was recorded, whether a fit could use it or not."""

    name: str
    joint: str
    source: str
    # of the positions, rad or m; a slide that a motor turns is seen from its shaft [rad], as in a fit
    unit: str
    times_s: np.ndarray  # before and while the current flowed, shape (K,); it came on at time 0
    position: np.ndarray
    # each current holds from its time on, shape (C,); the last until `duration_s`
    input_times_s: np.ndarray
    input_current_A: np.ndarray
    duration_s: float
    # the links from the side at the start and at the end, each a line from joint to joint, to the right and up [m],
    # shape (2, L, 2, 2); no line where the position of a joint is not known
    arm: np.ndarray
    driven: np.ndarray  # place of the driven joint at the start and at the end, shape (2, 2)
    baseline: bool = False  # whether it was made without what is to be identified


@dataclass(frozen=True)
class JointFit:
    """One joint of a motion under a controller: mean torque over windows, as recorded and as arm, friction and payload make it."""

    name: str  # of the recording
    joint: str
    times_s: np.ndarray  # middle of each window that is shown [s], shape (K,)
    measured: np.ndarray  # [N m], shape (K,)
    explained: np.ndarray  # [N m], shape (K,)
    payload: np.ndarray  # what the payload makes of the explained torque [N m], shape (K,)
    # left_over, usual: rms of what is not explained, and of the same where the load was known [N m]
    left_over: float
    usual: float
    # which share of what all joints and motions know of the mass came in each part of the recording, shape (B,)
    told: np.ndarray
    part_s: float  # length of such a part [s]


@dataclass(frozen=True)
class HeldView:
    """The arm in poses of a motion and what it held in the last of them, seen in a plane [m]."""

    side: str  # from where, in words
    arm: np.ndarray  # the links, each a line from joint to joint, shape (P, L, 2, 2)
    hand: np.ndarray  # where the object is attached, in the last pose, shape (2,)
    centre: np.ndarray | None = None  # its centre of mass, shape (2,); None where no mass is stated
    # outline of the 95 % interval of the centre, shape (K, 2); None where nothing was identified of it
    within: np.ndarray | None = None
    # outline of the homogeneous ellipsoid of the same mass and inertia, shape (K, 2); None as for `centre`
    body: np.ndarray | None = None
    inertia_is: str = ""  # ``identified``, ``stated`` or ``assumed``


@dataclass(frozen=True)
class StartPath:
    """What one start did: what was searched for (kg, or Pa) after each iteration, and the cost."""

    start: float
    end: float
    cost: float
    agrees: bool
    values: np.ndarray
    path_cost: np.ndarray
    scheduled: float | None = None  # profile `paper`: where the authors' schedule stops


@dataclass(frozen=True)
class SolverSummary:
    """Which solver ran, and whether its starts agree."""

    name: str
    profile: str
    iterations: int
    paths: tuple[StartPath, ...]  # of the search from every start
    integrator: str
    step_s: float
    # of the fit that began at their ends and gave the answer, where one did
    refined: tuple[StartPath, ...] = ()

    @property
    def starts_agreeing(self) -> int:
        return sum(path.agrees for path in self.paths)

    def as_json(self) -> dict[str, Any]:
        record = picked(
            self,
            "name",
            "profile",
            "starts_agreeing",
            "iterations",
            "integrator",
            "step_s",
        )
        record["starts"] = len(self.paths)
        if any(path.scheduled is not None for path in self.paths):
            results = [
                {
                    "start_kg": p.start,
                    "scheduled_kg": p.scheduled,
                    "least_error_kg": p.end,
                }
                for p in self.paths
            ]
            record["start_results"] = results
        return record


@dataclass(frozen=True)
class UnknownRow(Tag):
    """One unknown in the table of the report."""

    role: str
    prior: float
    prior_std: float
    value: float
    std: float

    @property
    def pull(self) -> float | None:
        """How many of the prior's standard deviations the value lies from it; None: no prior, or not fitted."""
        if self.role != Role.ESTIMATED.value or not 0.0 < self.prior_std < np.inf:
            return None
        return (self.value - self.prior) / self.prior_std

    def as_json(self) -> dict[str, Any]:
        return picked(
            self,
            "name",
            "unit",
            "role",
            "prior",
            "prior_std",
            "value",
            "std",
            "pull",
        )


@dataclass(frozen=True)
class Scan:
    """Cost against what was searched for."""

    values: np.ndarray  # of what was searched for [kg, or Pa], shape (M,)
    cost: np.ndarray
    measure: str  # what the cost is, in words
    # cost at the ends of the 95 % interval; None where the cost says nothing about it
    level: float | None = None


class Detail(Protocol):
    """What only one probe's answers have."""

    def as_json(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class Estimate:
    """The result of one identification, the same object live and offline."""

    probe: str
    robot: str
    verdict: Verdict
    reasons: tuple[str, ...]
    values: tuple[Value, ...]
    fit: Fit | None
    solver: SolverSummary | None
    runs: int
    run_fits: tuple[RunFit, ...] = ()
    recorded: tuple[RecordedRun, ...] = ()  # every run, those that no fit could use among them
    joint_fits: tuple[JointFit, ...] = ()  # of motions, where runs have `run_fits`
    held_views: tuple[HeldView, ...] = ()
    unknowns: tuple[UnknownRow, ...] = ()
    # (source, standard deviation it puts on the first value, in its unit)
    budget: tuple[tuple[str, float], ...] = ()
    # makes `scan`: a page draws it, and it takes a third of the time of an answer
    scanned: Callable[[], Scan] | None = None
    detail: Detail | None = None  # what only one probe's answers have
    assumptions: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    timing_s: dict[str, float] = field(default_factory=dict)
    # bags, baseline and calibration, as `as_json` gives them
    origin: dict[str, Any] = field(default_factory=dict)

    def value(self, name: str) -> Value:
        """The value called ``name``; KeyError lists what there is."""
        named = {value.name: value for value in self.values}
        if name not in named:
            raise KeyError(f"no {name} among {list(named)}")
        return named[name]

    @cached_property
    def scan(self) -> Scan | None:
        """Cost against what was searched for, made when it is asked for."""
        return None if self.scanned is None else self.scanned()

    @property
    def interval_first(self) -> bool:
        """Whether a reader should see the interval before the number."""
        return self.verdict is Verdict.TOO_WIDE

    def as_json(self) -> dict[str, Any]:
        """The contract's object; numbers are plain floats, what is not a number is null."""
        record = {
            **header("estimate"),
            "bags": [],
            "baseline": [],
            "calibration": None,
            **self.origin,
        }
        record |= picked(self, "probe", "robot", "runs", "verdict", "reasons")
        record |= {
            "reason_codes": reason_codes(self.reasons),
            "estimates": self.values,
        }
        if self.detail is not None:
            record |= self.detail.as_json()
        record |= picked(self, "fit", "solver", "unknowns")
        budget = [
            {
                "source": source,
                "std": std,
                "unit": self.values[0].unit,
            }
            for source, std in self.budget
        ]
        return plain(
            {
                **record,
                "uncertainty_budget": budget,
                **picked(self, "assumptions", "notes", "timing_s"),
            }
        )


def no_answer(
    probe: str,
    name: str,
    unit: str,
    robot: str,
    runs: int,
    reasons: Sequence[str],
    notes: Sequence[str],
) -> Estimate:
    """What is said where no run can be used: the value is not determined, and the reasons are the runs' own.

    Args:
        probe: Its name.
        name: Of the value.
        unit: Of the value.
        robot: Its name.
        runs: How many were given.
        reasons: Why none can be used.
        notes: What else was found.
    """
    values = (
        Value(
            name,
            unit,
            None,
            reason="no run of this recording determines it",
        ),
    )
    verdict = Verdict.NOT_IDENTIFIABLE
    return Estimate(
        probe,
        robot,
        verdict,
        tuple(reasons),
        values,
        None,
        None,
        runs,
        notes=tuple(notes),
    )


def picked(of: Any, *names: str) -> dict[str, Any]:
    """Some attributes of an object, by their names."""
    return {name: getattr(of, name) for name in names}


def plain(value: Any) -> Any:
    """For JSON, which has no NaN, no numpy, no enumerations and no objects of ours: what a reader of the contract expects."""
    if hasattr(value, "as_json"):
        return plain(value.as_json())
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value
