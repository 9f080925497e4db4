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
TEN = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (2, 2), (3, 3), (1, 2), (1, 3), (2, 3))
"""Places of the ten inertial parameters in a pseudo-inertia whose first row has mass and mass times centre."""
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
        up = np.array([0.0, 0.0, 0.5 * self.height])
        centre = self.bottom + self.rotation @ up
        beside = np.array([0.002, 0.002, 0.1 * self.height])
        off = np.abs(self.rotation @ beside)
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
            fill,
            share,
            fill - 2.0 / k * np.tanh(0.5 * k * fill),
            GRAVITY * k * np.tanh(k * fill),
        )


def damping_ratio(radius: float, fill: float, viscosity: float) -> float:
    """Of the first mode; kinematic viscosity in m^2/s.

    Args:
        radius: Of the cylinder [m].
        fill: How high the liquid stands [m].
        viscosity: Kinematic [m^2/s].
    """
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
        up = np.array([0.0, 0.0, 0.3 * facts.height])
        centre = facts.bottom + facts.rotation @ up
        beside = np.array([0.2 * facts.radius] * 2 + [0.2 * facts.height])
        off = np.abs(facts.rotation @ beside)
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
    model: str,
    facts: ContentsFacts,
    u: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """What the contents put into the simulator, as analytic functions of their unknowns.

    Args:
        model: One of `MODELS`, but "nothing".
        facts: The container.
        u: The unknowns, each of shape (S,), by name; complex for derivatives.

    Returns:
        The ten inertial parameters of what is rigid, shape (S, 10), and what moves as `sloshing_terms` gives it, shape (S, 5),
        zeros where nothing moves.
    """
    mass = u["contents_mass"]
    nothing = np.zeros_like(mass)
    still = np.stack([nothing] * 5, axis=1)  # (S, 5)
    if model == "rigid":
        com = np.stack([u[f"contents_com_{axis}"] for axis in "xyz"], axis=1)  # (S, 3)
        return inertial_parameters(facts, u, mass, com, nothing + 0.5 * facts.height), still
    area = np.pi * facts.radius**2
    fill = np.sqrt((mass / (u["contents_density"] * area)) ** 2 + LOWEST_FILL_M**2)
    axis = facts.rotation[:, 2]
    if model == "frozen":
        com = facts.bottom + displaced(facts, u) + 0.5 * fill[:, None] * axis
        return inertial_parameters(facts, u, mass, com, fill), still
    slosh = Slosh.of(facts.radius, fill)
    share = slosh.share * u["slosh_share"]
    height = (0.5 * fill - share * slosh.height) / (1.0 - share)
    # the bowl stays where it was said to be: to first order the rest may have its share of the difference
    beside = displaced(facts, u) / (1.0 - share)[:, None]
    com = facts.bottom + beside + height[:, None] * axis
    rigid = inertial_parameters(facts, u, mass * (1.0 - share), com, fill)
    return rigid, sloshing_terms(slosh, mass * share, u)


def displaced(
    facts: ContentsFacts,
    u: Mapping[str, np.ndarray],
) -> np.ndarray:
    """How far across its axis the container stands from where it was said to, as its own centre does [m], shape (S, 3)."""
    axis = facts.rotation[:, 2]
    nothing = np.zeros_like(u["contents_mass"])
    centre = facts.shell.com
    beside = np.stack(
        [u.get(name, at) - at + nothing for name, at in zip(PLACE, centre, strict=True)],
        axis=1,
    )
    return beside - (beside @ axis)[:, None] * axis


def sloshing_terms(
    slosh: Slosh,
    moving: np.ndarray,
    u: Mapping[str, np.ndarray],
) -> np.ndarray:
    """The part that moves across the container's axis.

    Args:
        slosh: The first mode, at fills of shape (S,).
        moving: Mass of the part [kg], shape (S,).
        u: The unknowns, each of shape (S,).

    Returns:
        Mass [kg], height above the bottom [m], and of each kilogram stiffness [1/s^2], damping [1/s] and friction [m/s^2],
        shape (S, 5).
    """
    nothing = np.zeros_like(moving)
    stiffness = slosh.stiffness * u.get("slosh_tuning", 1.0) ** 2
    damping = 2.0 * np.exp(u["slosh_damping_log"]) * np.sqrt(stiffness)
    friction = GRAVITY * u.get("grain_friction", nothing)
    return np.stack(
        [moving, slosh.height + nothing, stiffness, damping, friction],
        axis=1,
    )


def inertial_parameters(
    facts: ContentsFacts,
    u: Mapping[str, np.ndarray],
    mass: np.ndarray,
    com: np.ndarray,
    tall: np.ndarray,
) -> np.ndarray:
    """Of what is rigid inside; its inertia is the share ``contents_spread`` of that of a solid cylinder with all of the mass.

    Args:
        facts: The container.
        u: The unknowns, each of shape (S,).
        mass: Of what is rigid [kg], shape (S,).
        com: Its centre in the payload frame [m], shape (S, 3).
        tall: Height of the cylinder [m], shape (S,).

    Returns:
        Mass, mass times centre, and second moments about the frame's origin, shape (S, 10).
    """
    axis = facts.rotation[:, 2]
    along = np.outer(axis, axis)
    level = u["contents_spread"] * facts.radius**2 / 4.0
    up = u["contents_spread"] * tall**2 / 12.0
    across = np.eye(3) - along
    spread = level[:, None, None] * across + up[:, None, None] * along  # (S, 3, 3)
    pseudo = np.zeros(
        (len(mass), 4, 4),
        dtype=np.result_type(mass, com, spread),
    )
    pseudo[:, 0, 0] = mass
    pseudo[:, 0, 1:] = mass[:, None] * com
    squared = com[:, :, None] * com[:, None, :]
    about_origin = mass[:, None, None] * squared
    whole = u["contents_mass"][:, None, None]
    pseudo[:, 1:, 1:] = about_origin + whole * spread
    return np.stack([pseudo[:, row, column] for row, column in TEN], axis=1)


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
    """The cosine between the axes of the joint and the container, and what the law needs of a run's geometry.

    Args:
        robot: The arm.
        run: Whose joint turns the container.
        facts: The container.
    """
    model = reduced_model(robot, run.run, {})
    _, body_from_payload = model.frames[robot.payload_frame]
    axis, gravity = axis_and_gravity(model)
    up = body_from_payload[:3, :3] @ facts.rotation[:, 2]
    bottom = body_from_payload[:3, :3] @ facts.bottom + body_from_payload[:3, 3]
    across = np.cross(axis, up)
    along = across / max(float(np.linalg.norm(across)), 1e-9)
    high = np.cross(along, axis)
    fixed = axis * float(axis @ gravity)
    turning = np.stack([fixed, gravity - fixed, -np.cross(axis, gravity)])
    nothing = JointRun(run.times_s, run.run.input_times_s, run.run.input_current_A)
    return float(axis @ up), SloshRun(
        nothing, float(along @ bottom), float(high @ bottom), turning @ along, turning @ high
    )


@dataclass(frozen=True)
class InsideTerms:
    """`inside_terms` at guesses, and their derivatives by C of the problem's unknowns."""

    rigid: np.ndarray  # (S, 10)
    moving: np.ndarray  # (S, 5)
    columns: np.ndarray  # of the unknowns, (C,)
    by_rigid: np.ndarray  # (C, S, 10)
    by_moving: np.ndarray  # (C, S, 5)


class ContentsProblem(Problem):
    """Whitened residuals of runs with and without contents in the container, as in ``Problem``, under one of `MODELS`.

    The empty container is the payload of that problem; ``filled`` says which runs have the contents, too.
    """

    def __init__(
        self,
        robot: Robot,
        runs: Sequence[PreparedRun],
        facts: ContentsFacts,
        filled: Sequence[bool],
        model: str,
    ) -> None:
        self.container = facts
        self.filled = np.asarray(filled, dtype=bool)
        self.model = model
        self.inside = inside_unknowns(model, facts)
        self._prepared = tuple(runs)
        self._turns = [turning_with(robot, run) for run in runs]
        self._now: InsideTerms | None = None
        known = load_unknowns(robot, runs, facts.shell, Role.ESTIMATED, facts.mass)
        known[0] = replace(
            known[0], std=facts.mass_std if np.isfinite(facts.mass_std) else MASS_STD_KG
        ).at_role(Role.ESTIMATED)
        super().__init__(
            robot,
            runs,
            facts.shell,
            [*self.inside, *known],
        )

    def with_runs(self, runs: Sequence[PreparedRun]) -> ContentsProblem:
        """The same model of runs whose held joints moved otherwise."""
        return ContentsProblem(self.robot, runs, self.container, self.filled.tolist(), self.model)

    def is_affine(self) -> bool:
        return super().is_affine() and self.model == "nothing"

    def simulator_of(
        self, runs: list[JointRun], integrator: str
    ) -> JointSimulator | MixedSimulator[SloshSimulator]:
        if self.model not in MOVING:
            return JointSimulator(runs, integrator)
        rows = np.flatnonzero(self.filled).tolist()
        moving = [replace(self._geometry(row), joint=runs[row]) for row in rows]
        plain = [runs[row] for row in np.flatnonzero(~self.filled)]
        return MixedSimulator(SloshSimulator(moving, integrator), plain, self.filled, integrator)

    def _geometry(self, row: int) -> SloshRun:
        return container_seen(self.robot, self._prepared[row], self.container)[1]

    def touches(self, unknown: Unknown, row: int) -> bool:
        if any(unknown.key == own.key for own in self.inside):
            return bool(self.filled[row])
        return super().touches(unknown, row)

    def _terms(self, values: np.ndarray) -> InsideTerms:
        """At values (S, N); derivatives are complex steps."""
        names = [*(unknown.kind for unknown in self.inside), *PLACE]
        columns = [self.index[name] for name in names]

        def terms(guesses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            unknowns = dict(zip(names, guesses[:, columns].T, strict=True))
            return inside_terms(self.model, self.container, unknowns)

        # a step along each column, all in one call
        stepped = np.tile(values.astype(complex), (len(columns), 1, 1))  # (C, S, N)
        for n, column in enumerate(columns):
            stepped[n, :, column] += 1j * COMPLEX_STEP
        by_rigid, by_moving = terms(np.concatenate(stepped))
        rigid, moving = terms(values)
        return InsideTerms(
            rigid,
            moving,
            np.array(columns),
            by_rigid.imag.reshape(len(columns), *rigid.shape) / COMPLEX_STEP,
            by_moving.imag.reshape(len(columns), *moving.shape) / COMPLEX_STEP,
        )

    def payload_in(self, row: int, payload: InertialTerms) -> InertialTerms:
        inside = self._now
        if inside is None or not self.filled[row]:
            return payload
        slopes = zip(inside.columns.tolist(), inside.by_rigid, strict=True)
        return payload.plus(inside.rigid, dict(slopes))

    def all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        if not self.inside:
            return super().all_parameters(values)
        inside = self._terms(values)
        self._now = inside
        p, dp = super().all_parameters(values)
        mass = self.index["contents_mass"]
        names = list(self.simulator.parameters)
        carried = names.index("carried")
        sloshes = len(names) == len(SLOSH_PARAMETERS)
        for row in np.flatnonzero(self.filled).tolist():
            p[:, row, carried] += values[:, mass]
            dp[:, row, carried, mass] += 1.0
            if sloshes:
                first = names.index("slosh_mass")
                p[:, row, first : first + 5] = inside.moving
                dp[:, row, first : first + 5, inside.columns] = inside.by_moving
                p[:, row, names.index("settled")] = float(self.model == "liquid")
                tilt = names.index("tilt")
                self._add_tilt(row, values, p[:, row, tilt], dp[:, row, tilt])
        if sloshes:
            p[:, ~self.filled, names.index("slosh_stiffness")] = 1.0
        return p, dp

    def _add_tilt(
        self,
        row: int,
        values: np.ndarray,
        tilt: np.ndarray,
        by_unknown: np.ndarray,
    ) -> None:
        """How far encoders' errors turn the container about the joint's axis, added in place: shapes (S,) and (S, N)."""
        run = self.runs[row].run
        zero = self.index.get(("zero", run.joint))
        if zero is not None:
            tilt += values[:, zero]
            by_unknown[:, zero] += 1.0
        for name, share in self._turns[row]:
            posed = self.shift(name, run.held[name], values)
            tilt += share * posed.shift
            for column, factor in posed.by_unknown:
                by_unknown[:, column] += share * factor

    def held(self, values: np.ndarray) -> list[PreparedRun]:
        """The runs with held joints that give way as their servos let them where all else moves by these unknowns, shape (N,)."""
        p = self.parameters(values[None], self.estimated[:1])[0][0]
        fine = [
            replace(run, sample_times_s=np.arange(0.0, run.sample_times_s[-1] + FINE_S, FINE_S))
            for run in self.simulator.runs
        ]
        q, v, _ = self.simulator_of(fine, "rk4").jacobian(
            np.arange(len(p), dtype=np.int32),
            p,
            np.zeros((*p.shape, 1)),
        )
        driven = [
            Followed(
                run.sample_times_s,
                q[row, : len(run.sample_times_s)],
                v[row, : len(run.sample_times_s)],
            )
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
            loads = loads_of_yielding(
                self.robot,
                run.run,
                others,
                self.facts,
                0.0,
                own,
            )
            found.append(replace(run, loads=loads) if others else run)
        return found

    def path(
        self,
        values: np.ndarray,
    ) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Of each filled run its name, times [s] and how far the moving part is from the container's axis [m]; none is rigid."""
        rows = np.flatnonzero(self.filled)
        if not isinstance(self.simulator, MixedSimulator):
            return []
        p, _ = self.parameters(values[None], self.estimated[:1])
        x = self.simulator.special.path(
            np.arange(len(rows)),
            p[0, rows],
        )
        return [
            (run.run.name, run.times_s, x[n, : run.used])
            for n, run in enumerate(self.runs[row] for row in rows)
        ]
