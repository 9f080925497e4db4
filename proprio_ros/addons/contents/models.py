"""What may be in a container: nothing, one rigid thing, a liquid, or grains; each as a least-squares problem of its own.

The first sloshing mode of an upright cylinder of radius R, filled to h, with k = 1.841 / R: w2 = g k tanh(k h), moving share
2 tanh(k h) / (2.39 k h), at h - (2 / k) tanh(k h / 2) above the bottom; the rest is rigid, so that the centre of all is at h / 2
(Abramson, NASA SP-106; Dodge 2000). Damping: Mikishev and Dorozhkin, as Dodge gives it. Bars of the theory are unknowns with
priors: a factor on frequency and moving share, and what of a rigid body's inertia a liquid has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from proprio_ros.addons.contents.detail import MOVING
from proprio_ros.addons.contents.held_by_servos import give_way
from proprio_ros.addons.contents.slosh import SloshRun, SloshSimulator
from proprio_ros.addons.contents.slosh_kernels import GRAVITY, SLOSH_PARAMETERS
from proprio_ros.identification.coefficients import axis_and_gravity, reduced_model
from proprio_ros.identification.locked_joints import Followed, loads_of_yielding
from proprio_ros.identification.moving_part import InertialTerms
from proprio_ros.identification.prepared_runs import PreparedRun, turning_with
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import PAYLOAD_TERMS, load_unknowns
from proprio_ros.identification.unknowns import Role, Unknown
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import JointRun, JointSimulator
from proprio_ros.sim.mixed import MixedSimulator
from proprio_ros.sim.payload import PayloadFacts, PayloadShape

MODELS = {
    "nothing": "nothing",
    "rigid": "rigid",
    "frozen": "rigid",
    "liquid": "liquid",
    "granular": "granular",
}
"""Each is of a kind: what is rigid lies anywhere, or fills the bottom as what flows does, so that lying low tells neither."""
PLACE = PAYLOAD_TERMS[1:4]  # of the empty container's centre
FIRST_MODE = 1.8412  # least root of J1'
LOWEST_FILL_M = 2e-3  # below this a fill is smoothed, so that a search may pass through nothing
LEVEL = 0.3  # cosine between joint's and container's axes up to which the law holds
MASS_STD_KG = 0.3  # of a prior that is the same for all, so wide that it moves nothing
COMPLEX_STEP = 1e-30
FINE_S = 0.0025  # what held joints do is computed at instants so far apart


@dataclass(frozen=True)
class ContentsFacts:
    """What is stated about the container (``config/probes/contents.yaml`` and ``--set``)."""

    radius: float  # radius, height: of its inside [m]
    height: float
    bottom: np.ndarray  # middle of the inside bottom in the payload frame [m], shape (3,)
    # payload_R_container, shape (3, 3)
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    # mass, mass_std: of the empty container [kg]; an infinite standard deviation means not stated
    mass: float = 0.05
    mass_std: float = np.inf
    density: float = 1000.0  # of a liquid [kg/m^3], and its standard deviation
    density_std: float = 150.0

    @cached_property
    def shell(self) -> PayloadFacts:
        """The empty container as a payload; where its centre is, a lid and a thick bottom may shift."""
        walls = PayloadShape.hollow(
            "cylinder",
            np.array([2.0 * self.radius] * 2 + [self.height]),
        )
        centre = self.bottom + self.rotation @ np.array([0.0, 0.0, 0.5 * self.height])
        off = np.abs(self.rotation @ np.array([0.002, 0.002, 0.1 * self.height]))
        return PayloadFacts(centre, off, walls.turned(self.rotation), 0.3)


@dataclass(frozen=True)
class Slosh:
    """The first mode of a filled cylinder; arrays of one shape, or numbers (complex for derivatives)."""

    fill: np.ndarray
    share: np.ndarray
    height: np.ndarray
    stiffness: np.ndarray

    @classmethod
    def of(cls, radius: float, fill: np.ndarray) -> Slosh:
        """For a fill [m]."""
        k = FIRST_MODE / radius
        share = 2.0 * np.tanh(k * fill) / (2.39 * k * fill)
        return cls(
            fill, share, fill - 2.0 / k * np.tanh(0.5 * k * fill), GRAVITY * k * np.tanh(k * fill)
        )


def damping_ratio(radius: float, fill: float, viscosity: float) -> float:
    """Of the first mode; kinematic viscosity in m^2/s."""
    deep = FIRST_MODE * fill / radius
    near = (1.0 - fill / radius) / np.cosh(deep) + 1.0
    return float(
        0.79
        * np.sqrt(viscosity / np.sqrt(radius**3 * GRAVITY))
        * (1.0 + 0.318 / np.sinh(deep) * near)
    )


def inside_unknowns(model: str, facts: ContentsFacts) -> list[Unknown]:
    """What is open about the contents under a model."""
    if model == "nothing":
        return []
    mass = Unknown(
        "contents_mass",
        0.1,
        MASS_STD_KG,
        -0.05 if model == "rigid" else 5e-4,
        5.0,
        asinh_scale=0.005,
    )
    spread = Unknown("contents_spread", 1.0, 0.3, 0.0, 5.0)
    if model == "rigid":
        centre = facts.bottom + facts.rotation @ np.array([0.0, 0.0, 0.3 * facts.height])
        off = np.abs(facts.rotation @ np.array([0.2 * facts.radius] * 2 + [0.2 * facts.height]))
        of_it = zip("xyz", centre.tolist(), off.tolist(), strict=True)
        return [
            mass,
            *(Unknown(f"contents_com_{axis}", at, std, -1.0, 1.0) for axis, at, std in of_it),
            spread,
        ]
    dense = Unknown("contents_density", 1000.0, 500.0, 300.0, 15000.0)
    if model == "frozen":
        return [mass, dense, spread]
    if model == "liquid":
        return [
            mass,
            Unknown("contents_density", facts.density, facts.density_std, 300.0, 15000.0),
            Unknown("slosh_tuning", 1.0, 0.05, 0.5, 2.0),
            Unknown("slosh_share", 1.0, 0.15, 0.0, 2.0),
            Unknown("slosh_damping_log", -3.2, 2.0, -7.0, 0.5),
            Unknown("contents_spread", 0.6, 0.3, 0.0, 5.0),
        ]
    return [
        mass,
        dense,
        Unknown("slosh_share", 0.7, 0.3, 0.0, 2.0),
        Unknown("grain_friction", 0.5, 0.2, 0.15, 1.2),
        Unknown("slosh_damping_log", -1.2, 1.0, -7.0, 0.5),
        spread,
    ]


def inside_terms(
    model: str, facts: ContentsFacts, u: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """What the contents put into the simulator, as analytic functions of their unknowns, each of shape (S,).

    Returns:
        The ten inertial parameters of what is rigid, shape (S, 10); moving mass, its height, stiffness, damping and friction,
        shape (S, 5), zeros of what does not move.
    """
    mass, zero = u["contents_mass"], np.zeros_like(u["contents_mass"])
    area = np.pi * facts.radius**2
    axis = facts.rotation[:, 2]

    def ten(
        part: np.ndarray,
        com: np.ndarray,
        tall: np.ndarray,
    ) -> np.ndarray:
        level = u["contents_spread"] * facts.radius**2 / 4.0
        up = u["contents_spread"] * tall**2 / 12.0
        along = np.outer(axis, axis)
        spread = level[:, None, None] * (np.eye(3) - along) + up[:, None, None] * along
        whole = np.zeros(
            (len(part), 4, 4),
            dtype=np.result_type(part, com, spread),
        )
        whole[:, 0, 0], whole[:, 0, 1:] = part, part[:, None] * com
        whole[:, 1:, 1:] = (
            part[:, None, None] * (com[:, :, None] * com[:, None, :]) + mass[:, None, None] * spread
        )
        rows = [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (2, 2), (3, 3), (1, 2), (1, 3), (2, 3)]
        return np.stack(
            [whole[:, i, j] for i, j in rows],
            axis=1,
        )

    if model == "rigid":
        com = np.stack([u[f"contents_com_{name}"] for name in "xyz"], axis=1)
        return ten(mass, com, zero + 0.5 * facts.height), np.stack([zero] * 5, axis=1)
    fill = np.sqrt((mass / (u["contents_density"] * area)) ** 2 + LOWEST_FILL_M**2)
    # beside where the container was said to stand, as its own centre is
    beside = np.stack(
        [u.get(name, at) - at + zero for name, at in zip(PLACE, facts.shell.com, strict=True)],
        axis=1,
    )
    beside = beside - (beside @ axis)[:, None] * axis
    if model == "frozen":
        return ten(
            mass,
            facts.bottom + beside + 0.5 * fill[:, None] * axis,
            fill,
        ), np.stack([zero] * 5, axis=1)
    slosh = Slosh.of(facts.radius, fill)
    share = slosh.share * u["slosh_share"]
    stiffness = slosh.stiffness * u.get("slosh_tuning", 1.0) ** 2
    friction = GRAVITY * u.get("grain_friction", zero)
    damping = 2.0 * np.exp(u["slosh_damping_log"]) * np.sqrt(stiffness)
    rigid = mass * (1.0 - share)
    height = (0.5 * fill - share * slosh.height) / (1.0 - share)
    # the bowl stays where it was said to be: to first order the rest may have its share of the difference
    place = facts.bottom + beside / (1.0 - share)[:, None] + height[:, None] * axis
    return ten(rigid, place, fill), np.stack(
        [mass * share, slosh.height + zero, stiffness, damping, friction], axis=1
    )


def slosh_of(
    facts: ContentsFacts,
    u: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Fill [m], slosh frequency [Hz] and damping ratio of a liquid, shape (S, 3); of complex unknowns, too."""
    moving = inside_terms("liquid", facts, u)[1]
    fill = np.sqrt(
        (u["contents_mass"] / (u["contents_density"] * np.pi * facts.radius**2)) ** 2
        + LOWEST_FILL_M**2
    )
    return np.stack(
        [
            fill,
            np.sqrt(moving[:, 2]) / (2.0 * np.pi),
            np.exp(u["slosh_damping_log"]),
        ],
        axis=1,
    )


def container_seen(
    robot: Robot,
    run: PreparedRun,
    facts: ContentsFacts,
) -> tuple[float, SloshRun]:
    """The cosine between the axes of the joint and the container, and what the law needs of a run's geometry."""
    model = reduced_model(robot, run.run, {})
    _, body_from_payload = model.frames[robot.payload_frame]
    axis, gravity = axis_and_gravity(model)
    up = body_from_payload[:3, :3] @ facts.rotation[:, 2]
    bottom = body_from_payload[:3, :3] @ facts.bottom + body_from_payload[:3, 3]
    along = np.cross(axis, up) / max(float(np.linalg.norm(np.cross(axis, up))), 1e-9)
    high = np.cross(along, axis)
    fixed = axis * float(axis @ gravity)
    turning = np.stack([fixed, gravity - fixed, -np.cross(axis, gravity)])
    nothing = JointRun(run.times_s, run.run.input_times_s, run.run.input_current_A)
    return float(axis @ up), SloshRun(
        nothing, float(along @ bottom), float(high @ bottom), turning @ along, turning @ high
    )


class ContentsProblem(Problem):
    """Whitened residuals of runs with and without contents in the container, as in ``Problem``, under one of `MODELS`.

    The empty container is the payload of that problem; ``filled`` says which runs have the contents, too.
    """

    def __init__(
        self, robot: Robot, runs: Sequence[PreparedRun], facts: ContentsFacts, filled: Sequence[bool], model: str
    ,) -> None:  # fmt: skip
        self.container, self.filled, self.model = facts, np.asarray(filled, dtype=bool), model
        self.inside = inside_unknowns(model, facts)
        self._prepared, self._turns = tuple(runs), [turning_with(robot, run) for run in runs]
        self._now: tuple[np.ndarray, ...] = ()
        known = load_unknowns(robot, runs, facts.shell, Role.FREE, facts.mass)
        known[0] = replace(
            known[0], std=facts.mass_std if np.isfinite(facts.mass_std) else MASS_STD_KG
        ).at_role(Role.FREE)
        super().__init__(
            robot,
            runs,
            facts.shell,
            [*self.inside, *known],
        )

    def is_affine(self) -> bool:
        return super().is_affine() and self.model == "nothing"

    def simulator_of(
        self, runs: list[JointRun], integrator: str
    ) -> JointSimulator | MixedSimulator[SloshSimulator]:
        if self.model not in MOVING:
            return JointSimulator(runs, integrator)
        rows = np.flatnonzero(self.filled).tolist()
        moving = [
            replace(container_seen(self.robot, self._prepared[r], self.container)[1], joint=runs[r])
            for r in rows
        ]
        plain = [runs[row] for row in np.flatnonzero(~self.filled)]
        return MixedSimulator(SloshSimulator(moving, integrator), plain, self.filled, integrator)

    def touches(self, unknown: Unknown, row: int) -> bool:
        if any(unknown.key == own.key for own in self.inside):
            return bool(self.filled[row])
        return super().touches(unknown, row)

    def _terms(self, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """`inside_terms` at values (S, N), and their derivatives by each of the contents' unknowns, by complex steps."""
        names = [*(unknown.kind for unknown in self.inside), *PLACE]
        columns = [self.index[name] for name in names]
        found = inside_terms(
            self.model, self.container, dict(zip(names, values[:, columns].T, strict=True))
        )
        slopes = []
        for row in columns:
            shifted = values.astype(complex)
            shifted[:, row] += 1j * COMPLEX_STEP
            changed = inside_terms(
                self.model, self.container, dict(zip(names, shifted[:, columns].T, strict=True))
            )
            slopes.append([part.imag / COMPLEX_STEP for part in changed])
        return (
            *found,
            np.array(columns),
            *(np.array([slope[n] for slope in slopes]) for n in (0, 1)),
        )

    def payload_in(self, row: int, payload: InertialTerms) -> InertialTerms:
        if not self.inside or not self.filled[row]:
            return payload
        ten, _, columns, by_ten, _ = self._now
        return payload.plus(ten, dict(zip(columns.tolist(), by_ten, strict=True)))

    def all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        if not self.inside:
            return super().all_parameters(values)
        self._now = self._terms(values)
        p, dp = super().all_parameters(values)
        _, moving, columns, _, by_moving = self._now
        mass = self.index["contents_mass"]
        names = list(self.simulator.parameters)
        first = names.index("slosh_mass") if len(names) == len(SLOSH_PARAMETERS) else 0
        for row in np.flatnonzero(self.filled).tolist():
            p[:, row, names.index("carried")] += values[:, mass]
            dp[:, row, names.index("carried"), mass] += 1.0
            if not first:
                continue
            p[:, row, first : first + 5] = moving
            dp[:, row, first : first + 5, columns] = by_moving
            p[:, row, names.index("settled")] = float(self.model == "liquid")
            tilt = names.index("tilt")
            zero = self.index.get(("zero", self.runs[row].run.joint))
            if zero is not None:
                p[:, row, tilt] += values[:, zero]
                dp[:, row, tilt, zero] += 1.0
            for name, share in self._turns[row]:
                posed = self.shift(
                    name,
                    self.runs[row].run.held[name],
                    values,
                )
                p[:, row, tilt] += share * posed.shift
                for column, factor in posed.by_unknown:
                    dp[:, row, tilt, column] += share * factor
        if first:
            p[:, ~self.filled, first + 2] = 1.0
        return p, dp

    def held(self, values: np.ndarray) -> list[PreparedRun]:
        """The runs with held joints that give way as their servos let them where all else moves by these unknowns, shape (N,)."""
        p = self.parameters(values[None], self.free[:1])[0][0]
        fine = [
            replace(run, sample_times_s=np.arange(0.0, run.sample_times_s[-1] + FINE_S, FINE_S))
            for run in self.simulator.runs
        ]
        q, v, _ = self.simulator_of(fine, "rk4").jacobian(
            np.arange(len(p), dtype=np.int32), p, np.zeros((*p.shape, 1))
        )
        driven = [
            Followed(run.sample_times_s, *(each[row, : len(run.sample_times_s)] for each in (q, v)))
            for row, run in enumerate(fine)
        ]
        inside = values[self.index["contents_mass"]] if self.inside else 0.0
        runs = [run.run for run in self.runs]
        motions = give_way(
            self.robot,
            runs,
            driven,
            self.facts,
            values[self.index["payload_mass"]] + inside * self.filled,
        )
        found = []
        for run, own, others in zip(self.runs, driven, motions, strict=True):
            times_s, load = loads_of_yielding(
                self.robot,
                run.run,
                others,
                self.facts,
                0.0,
                own,
            )
            found.append(
                replace(run, yielding_times_s=times_s, yielding_load=load) if others else run
            )
        return found

    def path(
        self,
        values: np.ndarray,
    ) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Of each filled run its name, times [s] and how far the moving part is from the container's axis [m]; none is rigid."""
        rows = np.flatnonzero(self.filled)
        if not isinstance(self.simulator, MixedSimulator):
            return []
        p, _ = self.parameters(values[None], self.free[:1])
        x = self.simulator.special.path(
            np.arange(len(rows)),
            p[0, rows],
        )
        return [
            (run.run.name, run.times_s, x[n, : run.used])
            for n, run in enumerate(self.runs[row] for row in rows)
        ]
