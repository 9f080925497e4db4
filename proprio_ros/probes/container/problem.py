"""A container with a sphere in it as a least-squares problem: what ``problem.py`` has, and a sphere in some of the runs.

The container's shell is the payload of that problem: rigid, at its place in the hand, of unknown or stated mass, in every run. A
run with a sphere adds the sphere's mass, which all of them share, where it lay when the current came on, and two constants of the
contact that nobody knows: how much of a bounce is lost, and how slippery the walls are.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from proprio_ros.identification.coefficients import axis_and_gravity, reduced_model
from proprio_ros.identification.prepared_runs import PreparedRun, turning_with
from proprio_ros.identification.problem import Problem
from proprio_ros.identification.robot_unknowns import load_unknowns
from proprio_ros.identification.unknowns import Role, Unknown
from proprio_ros.kinds import Key
from proprio_ros.quantity import Quantity
from proprio_ros.robot import Robot
from proprio_ros.sim.joint import JointRun
from proprio_ros.sim.mixed import MixedSimulator
from proprio_ros.sim.payload import PayloadFacts, PayloadShape
from proprio_ros.sim.sphere import (
    SPHERE_INDEX,
    Contact,
    Enclosure,
    SphereRun,
    SphereSimulator,
    paper_contact,
)

LEVEL = 0.03
"""A sphere rolls down any slope; but below this one (1.7 degrees) an arm that is not level may have sloped the other way."""
LIGHTEST_KG = 1e-3
"""Forces of the paper's law do not shrink with the sphere: what is lighter would need shorter steps, and is not looked for."""
RESTING_STD_M = 3e-4
"""How far a sphere at rest may be from where the walls that carry it put it: dust, a dent, a wall that is not flat."""


@dataclass(frozen=True)
class ContainerFacts:
    """What is stated about the container and the sphere (``config/probes/container.yaml`` and ``--set``)."""

    enclosure: Enclosure  # its inside, and the sphere's size
    # of the container in the payload frame [m], shape (3,)
    centre: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # payload_R_container, shape (3, 3)
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    # mass, mass_std: of the shell [kg]; an infinite standard deviation means not stated
    mass: float = 0.03
    mass_std: float = np.inf
    # whether the sphere lay still in the lowest place before the current came on
    settled: bool = True
    # start, start_std: where its centre was instead, in the container's frame [m], shape (3,); None where not stated
    start: np.ndarray | None = None
    start_std: float = 1e-3
    # of the sphere on a wall [rad/s]: hard enough that a touch is short beside the motion
    contact_frequency: float = 400.0
    # damping_ratio, friction, traction, law: of contact, see ``sim/sphere.py`` [1, 1, 1/s]
    damping_ratio: Quantity = field(default_factory=lambda: Quantity(0.4, 0.2))
    friction: Quantity = field(default_factory=lambda: Quantity(0.35, 0.15))
    traction: float = 300.0
    law: str = "ramped"
    # k_e, k_d, k_f: of the law ``paper`` [N/m, N s/m, N s/m], instead of frequency, damping ratio and traction
    k_e: float = 1000.0
    k_d: float = 1.0
    k_f: float = 1.0
    guessed: tuple[str, ...] = ()  # keys of sizes and places that the user did not state

    @property
    def shell(self) -> PayloadFacts:
        """The empty container as a payload."""
        walls = PayloadShape.hollow(self.enclosure.shape, self.enclosure.inner_size)
        return PayloadFacts(
            self.centre,
            np.zeros(3),
            walls.turned(self.rotation),
            0.1,
        )

    def sinks(self, pull: np.ndarray | float) -> np.ndarray | float:
        """How deep a wall lets a sphere of usual mass sink that is pulled into it [m], per pull [m/s^2]."""
        return pull / (self.k_e / 0.01 if self.law == "paper" else self.contact_frequency**2)

    @property
    def contact(self) -> Contact:
        """Constants of a touch at the values that are expected; of the paper's law, with the lightest sphere."""
        if self.law == "paper":
            return paper_contact(
                LIGHTEST_KG,
                self.k_e,
                self.k_d,
                self.k_f,
                self.friction.value,
            )
        return Contact.of(
            self.contact_frequency, self.damping_ratio.value, self.friction.value, self.traction
        )


@dataclass(frozen=True)
class StartPrior:
    """Where the sphere may be when the current comes on [m], shape (3,), and where a search should start from, shape (G, 3)."""

    mean: np.ndarray
    std: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    guesses: np.ndarray


SIGNALS = ("both", "joint", "camera")


@dataclass(frozen=True)
class SphereTrack:
    """Where a camera saw the sphere during a run: a second signal beside the joint's encoder."""

    times_s: np.ndarray  # since the run's onset, increasing, shape (C,)
    position: np.ndarray  # of the sphere's centre in the container's frame [m], shape (C, 3)
    std: float  # of each coordinate [m]

    def within(self, first_s: float, last_s: float) -> SphereTrack:
        """The part between two instants."""
        inside = (self.times_s >= first_s) & (self.times_s <= last_s)
        return replace(
            self,
            times_s=self.times_s[inside],
            position=self.position[inside],
        )


def start_prior(run: SphereRun, facts: ContainerFacts, position: float) -> StartPrior:
    """What is known about the sphere's start before a run.

    Args:
        run: Its geometry.
        facts: What is stated of container and sphere.
        position: Of the driven joint at the start [rad or m].
    """
    if facts.start is not None:
        return _stated_start(facts, facts.start)
    room = facts.enclosure.room
    gravity = run.gravity_at(position)
    # about as likely at a wall as in the middle
    middle = np.zeros(3)
    anywhere = StartPrior(middle, room.copy(), -room, room.copy(), middle[None])
    prior = anywhere
    free = np.ones(3, dtype=bool)
    if facts.settled and facts.enclosure.shape == "box":
        prior, free = _settled_in_box(anywhere, facts, gravity)
    elif facts.settled:
        prior, free = _settled_on_curved_wall(anywhere, facts, gravity)
    # along the joint's axis the sphere may be anywhere: it makes no difference
    matters = np.ones(3, dtype=bool)
    if run.kind == "revolute":
        matters = np.abs(run.axis) < 0.9
    guesses = [prior.mean]
    for axis in np.flatnonzero(free & matters):
        guesses = [
            np.where(np.arange(3) == axis, share * room, guess)
            for guess in guesses
            for share in (0.0, -0.9, 0.9)
        ]
    return replace(prior, guesses=np.array(guesses))


def _stated_start(facts: ContainerFacts, start: np.ndarray) -> StartPrior:
    """As the user states it; where walls carry the sphere it is a little inside them."""
    room = facts.enclosure.room
    mean = np.asarray(start, dtype=np.float64)
    outside = float(facts.sinks(9.81))
    return StartPrior(
        mean,
        np.full(3, facts.start_std),
        np.minimum(-room - outside, mean),
        np.maximum(room + outside, mean),
        mean[None],
    )


def _settled_in_box(
    anywhere: StartPrior, facts: ContainerFacts, gravity: np.ndarray
) -> tuple[StartPrior, np.ndarray]:
    """At each wall that gravity pulls to; along axes that are about level, (3,), it may be anywhere."""
    level = np.abs(gravity) < LEVEL * float(np.linalg.norm(gravity))
    at_wall = np.sign(gravity) * (facts.enclosure.room + facts.sinks(np.abs(gravity)))
    mean = np.where(level, 0.0, at_wall)
    prior = replace(
        anywhere,
        mean=mean,
        std=np.where(level, anywhere.std, RESTING_STD_M),
        lower=np.minimum(anywhere.lower, mean),
        upper=np.maximum(anywhere.upper, mean),
    )
    return prior, level


def _settled_on_curved_wall(
    anywhere: StartPrior, facts: ContainerFacts, gravity: np.ndarray
) -> tuple[StartPrior, np.ndarray]:
    """Where gravity pulls it to on the rim of a cylinder or inside a ball, and at an end of a cylinder; else anywhere, (3,)."""
    room = facts.enclosure.room
    weight = float(np.linalg.norm(gravity))
    is_cylinder = facts.enclosure.shape == "cylinder"
    prior = copy.deepcopy(anywhere)
    free = np.ones(3, dtype=bool)
    round_axes = [0, 1] if is_cylinder else [0, 1, 2]
    pull = float(np.linalg.norm(gravity[round_axes]))
    if pull > LEVEL * weight:
        reach = room[0] + facts.sinks(pull)
        prior.mean[round_axes] = reach * gravity[round_axes] / pull
        prior.std[round_axes] = RESTING_STD_M
        prior.lower[round_axes] = -reach
        prior.upper[round_axes] = reach
        free[round_axes] = False
    if is_cylinder and abs(gravity[2]) > LEVEL * weight:
        sunk = facts.sinks(abs(gravity[2]))
        end = np.sign(gravity[2]) * (room[2] + sunk)
        prior.mean[2] = end
        prior.std[2] = RESTING_STD_M
        prior.lower[2] = min(prior.lower[2], end)
        prior.upper[2] = max(prior.upper[2], end)
        free[2] = False
    return prior, free


def sphere_run(robot: Robot, run: PreparedRun, facts: ContainerFacts, joint: JointRun) -> SphereRun:
    """The geometry of a run: joint axis and gravity as the container sees them.

    Args:
        robot: As its file or its calibration states it.
        run: Prepared.
        facts: Where the container is in the hand, and how it is turned.
        joint: The run as the simulator takes it.
    """
    model = reduced_model(robot, run.run, {})
    _, body_from_payload = model.frames[robot.payload_frame]
    axis, gravity = axis_and_gravity(model)
    turned = body_from_payload[:3, :3] @ facts.rotation
    centre = body_from_payload[:3, :3] @ facts.centre + body_from_payload[:3, 3]
    return SphereRun(
        joint,
        model.kinds[0],
        turned.T @ axis,
        -turned.T @ centre,
        turned.T @ gravity,
    )


def container_unknowns(
    robot: Robot,
    runs: Sequence[PreparedRun],
    rolling: Sequence[bool],
    facts: ContainerFacts,
    priors: Sequence[StartPrior],
    drive_role: Role,
) -> list[Unknown]:
    """All unknowns: those of a weighing with the shell as its payload, and the sphere's.

    Args:
        robot: Whose drive trains move the runs.
        runs: R of them.
        rolling: Which of them have a sphere, length R.
        facts: What is stated of container and sphere.
        priors: Of the sphere's start in each of the runs that have one.
        drive_role: What the recording may move of the robot and of the contact.
    """
    unknowns = load_unknowns(robot, runs, facts.shell, drive_role, facts.mass)
    unknowns[0] = replace(unknowns[0], std=facts.mass_std).at_role(Role.ESTIMATED)
    lightest = LIGHTEST_KG if facts.law == "paper" else -0.2
    unknowns.append(
        Unknown(
            "sphere_mass",
            0.01,
            np.inf,
            lightest,
            5.0,
            asinh_scale=0.002,
        )
    )
    # the paper's law has a damping constant of its own
    damping = Quantity(facts.damping_ratio.value) if facts.law == "paper" else facts.damping_ratio
    for kind, known in (("contact_damping", damping), ("contact_friction", facts.friction)):
        unknowns.append(
            Unknown(kind, known.value, known.std, min(0.02, known.value), 2.0).at_role(drive_role)
        )
    for row, prior in zip(np.flatnonzero(rolling).tolist(), priors, strict=True):
        bounds = [prior.mean, prior.std, prior.lower, prior.upper]
        ranges = np.stack(bounds, axis=1).tolist()
        unknowns += [
            Unknown(f"sphere_{axis}", *known, scope=row).at_role(Role.ESTIMATED)
            for axis, known in zip("xyz", ranges, strict=True)
        ]
    return unknowns


@dataclass(frozen=True)
class _Seen:
    """A track beside the samples of its run: ``row`` of all, ``rolling_row`` of those with a sphere; see ``_between``."""

    row: int
    rolling_row: int
    track: SphereTrack
    between: np.ndarray


@dataclass(frozen=True)
class _Paths:
    """Where G guesses have the spheres of K rolling runs."""

    x: np.ndarray  # [m], (G, K, T, 3)
    dx: (
        np.ndarray
    )  # by the F unknowns, or by the P parameters of the simulator, (G, K, T, 3, F or P)
    dp: np.ndarray | None  # of those by the unknowns, (G, R, P, F); None: `dx` is by the unknowns

    def slopes(self, guess: int, seen: _Seen, last: int) -> np.ndarray:
        """By the unknowns, (last, 3, F).

        Args:
            guess: Its number.
            seen: Whose run it is.
            last: How many samples.
        """
        slopes = self.dx[guess, seen.rolling_row, :last]
        return slopes if self.dp is None else slopes @ self.dp[guess, seen.row]


def _between(known_s: np.ndarray, wanted_s: np.ndarray) -> np.ndarray:
    """What takes values at some instants to others between them, shape (C, K): a cubic spline."""
    # half of a second to import, and few runs have a camera
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(known_s, np.eye(len(known_s)))(wanted_s))


class ContainerProblem(Problem):
    """Whitened residuals of runs with and without a sphere in the container, as in ``Problem``.

    Args:
        robot, runs, facts, integrator, step_s: As there.
        rolling: Which runs have a sphere, length R; at least one.
        unknowns: Those of ``container_unknowns``.
        tracks: What a camera saw in each run, length R; None is nothing.
        signals: ``"both"``, or which one of ``SIGNALS`` a run that has both is fitted to.
    """

    simulator: MixedSimulator[SphereSimulator]

    def __init__(
        self,
        robot: Robot,
        runs: Sequence[PreparedRun],
        facts: ContainerFacts,
        rolling: Sequence[bool],
        unknowns: Sequence[Unknown],
        integrator: str = "rk4",
        step_s: float = 1.0 / 240.0,
        tracks: Sequence[SphereTrack | None] = (),
        signals: str = "both",
    ) -> None:
        self.container = facts
        self.rolling = np.asarray(rolling, dtype=bool)
        self._rolling_runs = tuple(runs)
        self._turns = [turning_with(robot, run) for run in runs]
        super().__init__(robot, runs, facts.shell, unknowns, integrator, step_s)
        self._seen: list[_Seen] = []
        for row, track in enumerate(tracks):
            if track is None or not self.rolling[row] or signals == "joint":
                continue
            times_s = runs[row].times_s
            inside = track.within(times_s[0], times_s[-1])
            rolling_row = int(self.rolling[:row].sum())
            self._seen.append(
                _Seen(
                    row,
                    rolling_row,
                    inside,
                    _between(times_s, inside.times_s),
                )
            )
            if signals == "camera":
                self.weight[row] = 0.0

    def is_affine(self) -> bool:
        # the constants of the paper's law go with one over the mass
        return super().is_affine() and self.container.law != "paper"

    @property
    def samples(self) -> int:
        return super().samples + sum(seen.track.position.size for seen in self._seen)

    @property
    def contact_step_s(self) -> float:
        """The longest step of a run with a sphere [s]."""
        return min(
            run.step_s
            for run, rolls in zip(self.simulator.runs, self.rolling, strict=True)
            if rolls
        )

    def simulator_of(
        self, runs: list[JointRun], integrator: str
    ) -> MixedSimulator[SphereSimulator]:
        step_s = self.container.contact.step_s(self.container.enclosure.inertia_factor, integrator)
        rolling: list[SphereRun] = []
        for row in np.flatnonzero(self.rolling):
            run = runs[row]
            joint = replace(
                run, step_s=min(run.step_s, step_s), fine_step_s=min(run.fine_step_s, step_s)
            )
            rolling.append(
                sphere_run(
                    self.robot,
                    self._rolling_runs[row],
                    self.container,
                    joint,
                )
            )
        special = SphereSimulator(rolling, self.container.enclosure, self.container.law, integrator)
        return MixedSimulator(
            special, [runs[row] for row in np.flatnonzero(~self.rolling)], self.rolling, integrator
        )

    def touches(self, unknown: Unknown, row: int) -> bool:
        if unknown.kind in ("sphere_mass", "contact_damping", "contact_friction"):
            return bool(self.rolling[row])
        return super().touches(unknown, row)

    def all_parameters(
        self,
        values: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        p, dp = super().all_parameters(values)
        at = self.index
        to = SPHERE_INDEX
        facts = self.container
        mass = values[:, at["sphere_mass"]]
        for row in np.flatnonzero(self.rolling).tolist():
            direct: list[tuple[Key, str]] = [
                ("sphere_mass", "sphere_mass"),
                ("sphere_mass", "carried"),
            ]
            direct += [
                ("contact_friction", "friction"),
                (("zero", self.runs[row].run.joint), "tilt"),
            ]
            direct += [((f"sphere_{axis}", row), f"start_{axis}") for axis in "xyz"]
            for key, parameter in direct:
                if key in at:  # the zero may be known
                    p[:, row, to[parameter]] += values[:, at[key]]
                    dp[:, row, to[parameter], at[key]] += 1.0
            for name, share in self._turns[row]:
                posed = self.shift(
                    name,
                    self.runs[row].run.held[name],
                    values,
                )
                p[:, row, to["tilt"]] += share * posed.shift
                for column, factor in posed.by_unknown:
                    dp[:, row, to["tilt"], column] += share * factor
            if facts.law == "paper":
                for constant, parameter in (
                    (facts.k_e, "stiffness"),
                    (facts.k_d, "damping"),
                    (facts.k_f, "traction"),
                ):
                    p[:, row, to[parameter]] = constant / mass
                    dp[:, row, to[parameter], at["sphere_mass"]] = -constant / mass**2
            else:
                damping = 2.0 * facts.contact_frequency
                p[:, row, to["damping"]] = damping * values[:, at["contact_damping"]]
                dp[:, row, to["damping"], at["contact_damping"]] = damping
                p[:, row, to["stiffness"]] = facts.contact_frequency**2
                p[:, row, to["traction"]] = facts.traction
        return p, dp

    def linearise(
        self, internal: np.ndarray, counts: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cost, gradient, matrix = super().linearise(internal, counts)
        if not self._seen:
            return cost, gradient, matrix
        paths = self._last_paths(internal)
        slope = self.coordinates.slope(internal)
        simulable = np.flatnonzero(np.isfinite(cost)).tolist()
        for seen in self._seen:
            # of a window that grows only what has been passed counts
            last = self.runs[seen.row].used if counts is None else int(counts[seen.row])
            between, places = self._passed(seen, last)
            for guess in simulable:
                simulated = paths.x[guess, seen.rolling_row, :last].reshape(last, 3)
                residual = (between @ simulated - places).ravel() / seen.track.std
                slopes = paths.slopes(guess, seen, last)
                by = np.einsum("ck,kif->cif", between, slopes) * slope[guess]
                by = by.reshape(-1, internal.shape[1]) / seen.track.std
                cost[guess] += 0.5 * float(residual @ residual)
                gradient[guess] += by.T @ residual
                matrix[guess] += by.T @ by
        return cost, gradient, matrix

    def _last_paths(self, internal: np.ndarray) -> _Paths:
        """Of the spheres in what was simulated last, at the solver's coordinates (G, F)."""
        guesses, size = internal.shape
        width = len(self.simulator.parameters)
        direct = size <= width
        x, dx = self.simulator.special.last_path(size if direct else width)
        dp = None
        if not direct:
            _, dp = self.kernel_parameters(self.coordinates.physical(internal))
            dp = dp.reshape(guesses, len(self.runs), width, size)
        return _Paths(
            x.reshape(guesses, -1, *x.shape[1:]), dx.reshape(guesses, -1, *dx.shape[1:]), dp
        )

    def _passed(self, seen: _Seen, last: int) -> tuple[np.ndarray, np.ndarray]:
        """What takes the first samples of a run to the instants of a track up to there, (C, last), and the places seen, (C, 3)."""
        run = self.runs[seen.row]
        passed = seen.track.times_s <= run.times_s[last - 1]
        between = seen.between[passed]
        if last < run.used:
            between = _between(run.times_s[:last], seen.track.times_s[passed])
        return between, seen.track.position[passed]

    def other_information(self, values: np.ndarray) -> np.ndarray:
        information = super().other_information(values)
        if self._seen:
            paths = self.path(values, self.estimated)
            for seen in self._seen:
                by = np.einsum("ck,kif->cif", seen.between, paths[seen.rolling_row][1]).reshape(
                    -1, len(self.estimated)
                )
                information += by.T @ by / seen.track.std**2
        return information

    def camera_rms(self, values: np.ndarray) -> float:
        """How far the simulated sphere is from where the camera saw it, per coordinate [m]; NaN without a camera."""
        if not self._seen:
            return float("nan")
        paths = self.path(values, self.estimated[:1])
        off = [
            seen.between @ paths[seen.rolling_row][0] - seen.track.position for seen in self._seen
        ]
        return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))

    def predict(
        self,
        values: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """What runs that have not been made would show, all of them with a sphere, in one launch.

        ``values``: of all unknowns, shape (N,); ``columns``: of those that matter to each run, shape (R, F).

        Returns:
            q, v (R, T) and dq (R, T, F) of what the encoder shows; x (R, T, 3) [m] and dx (R, T, 3, F) of the sphere in the
            container.
        """
        p, every = self.all_parameters(values[None])
        runs = len(self.runs)
        width = len(self.simulator.parameters)
        dp = np.take_along_axis(
            every[0],
            columns[:, None, :],
            axis=2,
        )
        with np.errstate(over="ignore", invalid="ignore"):
            q, v, by_p = self.simulator.jacobian(
                self.worlds(1),
                p[0],
                self.identity(runs),
            )
            x, dx = self.simulator.special.last_path(width)
            dq = by_p @ dp
            dx = dx @ dp[:, None]
        q = q.copy()
        v = v.copy()
        x = x.copy()
        if self.ripples:
            for row in range(runs):
                shown, slopes = self.observe(
                    row, values[None], q[None, row], dq[None, row], columns[row]
                )
                q[row], dq[row] = shown[0], slopes[0]
        return q, v, dq, x, dx

    def path(
        self,
        values: np.ndarray,
        columns: np.ndarray,
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Where the sphere is in the container in each run that has one, and how that changes with chosen unknowns (F,).

        Returns: x (K, 3) [m] and dx (K, 3, F) at the used samples of each rolling run.
        """
        p, dp = self.parameters(values[None], columns)
        rows = np.flatnonzero(self.rolling)
        every = np.tile(
            np.eye(len(self.simulator.parameters)),
            (len(rows), 1, 1),
        )
        x, by_parameter = self.simulator.special.path(
            np.arange(len(rows)),
            p[0, rows],
            every,
        )
        dx = np.einsum("rtkp,rpf->rtkf", by_parameter, dp[0, rows])
        return [
            (x[n, : self.runs[row].used], dx[n, : self.runs[row].used])
            for n, row in enumerate(rows)
        ]
