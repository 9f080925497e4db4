"""The enclosed sphere: one driven joint that carries a container with a sphere rolling in it, coupled by contact both ways.

The second interaction of the paper (Chen et al. 2025, arXiv:2410.03920), with its equation (1) for the joint. The sphere is
a rigid body of its own with three coordinates and a spin; the walls push it with penalty forces, and what they give to it they
take from the joint. The equations and both laws of contact, ``ramped`` (default) and ``paper``, are in docs/pages/how_it_works.md.
All vectors are in the container's frame, whose origin is its centre; forces of contact are *per kilogram of the sphere*.

Departures from the paper. Its damping sets in at once when a wall is touched and can pull the sphere back, which puts false
minima into the mass; ours is ramped with depth and never pulls. Its constants k_e, k_d, k_f are newtons; as ours stand for no
material but for "hard", they are given per kilogram (k = omega^2, c = 2 zeta omega): the steps that they need then do not shorten
with the sphere, its motion in a container that moves as given does not depend on its mass, and a mass of 0 is as good as any
other. ``paper_contact`` turns the paper's constants into these.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from proprio_ros.errors import SimulationError
from proprio_ros.sim import runtime
from proprio_ros.sim.joint import (
    JointRun,
    JointSimulator,
    harmless,
    kinds_of_kernel,
    plain_kernel,
)
from proprio_ros.sim.joint_kernels import VEC3
from proprio_ros.sim.rollout_kernels import Law, rollout
from proprio_ros.sim.runtime import FLOAT
from proprio_ros.sim.sphere_kernels import (
    SPHERE_PARAMETERS,
    SphereData,
    sphere_law,
)

SPHERE_INDEX = {name: row for row, name in enumerate(SPHERE_PARAMETERS)}
SHAPES = ("box", "cylinder", "sphere")
LAWS = ("ramped", "paper")
# more directions than the last go in several launches: see ``sphere_kernels.py``
_SIZES = (1, 8, 16)


@dataclass(frozen=True)
class Enclosure:
    """The inside of a container and the sphere's size. Raises `SimulationError`: Unknown shape, or a sphere that does not fit."""

    shape: str  # ``"box"``, ``"cylinder"`` (axis along z) or ``"sphere"``
    # [m] box: [x, y, z]; cylinder: [diameter, diameter, length]; sphere: three times its diameter; shape (3,)
    inner_size: np.ndarray
    radius: float  # of the sphere inside [m]
    inertia_factor: float = 0.4  # kappa; 0.4 for a solid ball, 2/3 for a hollow one
    ramp_depth: float = 5e-4  # d_0 of the default law [m]

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise SimulationError(
                f"container.shape={self.shape!r} is unknown: choose one of {', '.join(SHAPES)}"
            )
        if not 0.0 < self.radius < float(np.min(self.inner_size)) / 2.0:
            raise SimulationError(
                f"a sphere of radius {1e3 * self.radius:g} mm does not fit into {(1e3 * self.inner_size).tolist()} mm"
            )

    @property
    def room(self) -> np.ndarray:
        """How far the sphere's centre can go from the container's along each axis [m], shape (3,)."""
        return 0.5 * np.asarray(self.inner_size, dtype=np.float64) - self.radius


@dataclass(frozen=True)
class Contact:
    """Constants of the law of contact, per kilogram of the sphere."""

    stiffness: float  # [1/s^2]
    damping: float  # [1/s]
    traction: float  # [1/s]
    friction: float  # its coefficient

    @classmethod
    def of(
        cls,
        frequency: float,
        damping_ratio: float,
        friction: float,
        traction: float = 300.0,
    ) -> "Contact":
        """From the oscillation of a sphere on its contact.

        Args:
            frequency: Angular frequency [rad/s].
            damping_ratio: Of that oscillation.
            friction: Its coefficient.
            traction: Per kilogram of the sphere [1/s].

        Returns:
            The law's constants per kilogram of the sphere.
        """
        return cls(
            frequency**2,
            2.0 * damping_ratio * frequency,
            traction,
            friction,
        )

    def step_s(self, inertia_factor: float, integrator: str = "rk4") -> float:
        """Longest step that resolves a touch and is stable while the sphere slips [s].

        A bounce lasts pi / omega; five steps or more go into it. A sphere that slips loses its slip at k_f (1 + 1 / kappa); RK4 is
        stable up to 2.78 over that and Euler up to 2, and in a corner several walls add up.
        """
        slipping = self.traction * (1.0 + 1.0 / inertia_factor) + self.damping
        bounce, slip = (0.6, 2.0) if integrator == "rk4" else (0.4, 0.9)
        return float(min(bounce / np.sqrt(self.stiffness), slip / slipping))


def paper_contact(
    mass: float,
    k_e: float = 1000.0,
    k_d: float = 1.0,
    k_f: float = 1.0,
    friction: float = 0.3,
) -> "Contact":
    """The paper's constants for a sphere.

    Args:
        mass: Of the sphere [kg].
        k_e: Stiffness [N/m].
        k_d: Damping [N s/m].
        k_f: Traction [N s/m].
        friction: Coefficient.
    """
    return Contact(k_e / mass, k_d / mass, k_f / mass, friction)


@dataclass(frozen=True)
class SphereRun:
    """One rollout with a sphere."""

    # what drives the joint, and where it is looked at. Its ``step_s`` should not be above ``Contact.step_s``
    joint: JointRun
    kind: str  # ``"revolute"`` or ``"prismatic"``
    axis: np.ndarray  # of the joint, in the container's frame, shape (3,)
    joint_origin: np.ndarray  # a point on the axis, in the container's frame [m], shape (3,)
    gravity: np.ndarray  # at joint position 0, in the container's frame [m/s^2], shape (3,)

    def gravity_terms(
        self,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Constant, cos and sin parts of gravity in the container's frame as the joint turns [m/s^2] (Rodrigues)."""
        if self.kind == "prismatic":
            return self.gravity, np.zeros(3), np.zeros(3)
        along = self.axis * float(self.axis @ self.gravity)
        return (
            along,
            self.gravity - along,
            -np.cross(self.axis, self.gravity),
        )

    @property
    def across(self) -> np.ndarray:
        """Takes a place to what matters of it, shape (3, 3): along the joint's axis the sphere may be anywhere."""
        return np.eye(3) - (np.outer(self.axis, self.axis) if self.kind == "revolute" else 0.0)

    def gravity_at(self, q: float) -> np.ndarray:
        """Gravity in the container's frame at a joint position [m/s^2], shape (3,)."""
        constant, cos, sin = self.gravity_terms()
        return constant + cos * np.cos(q) + sin * np.sin(q)


class SphereSimulator(JointSimulator):
    """Rolls out many worlds (guesses) of one or more runs, each with a sphere in its container.

    Parameter vectors have the order of ``SPHERE_PARAMETERS``, the law of contact is one of ``LAWS`` (else
    SimulationError), and the enclosure is the same in all runs; everything else is as in ``JointSimulator``.
    """

    parameters = SPHERE_PARAMETERS
    harmless = harmless(SPHERE_PARAMETERS)
    tangent_sizes = _SIZES

    def __init__(
        self,
        runs: Sequence[SphereRun],
        enclosure: Enclosure,
        law: str = "ramped",
        integrator: str = "rk4",
    ) -> None:
        if law not in LAWS:
            raise SimulationError(
                f"unknown law of contact {law!r}: choose one of {', '.join(LAWS)}"
            )
        super().__init__([run.joint for run in runs], integrator)
        self.sphere_runs = tuple(runs)
        self.enclosure = enclosure
        self.law = law
        sphere = [
            enclosure.radius,
            enclosure.inertia_factor,
            enclosure.ramp_depth,
        ]
        inside = [
            *(0.5 * np.asarray(enclosure.inner_size, dtype=np.float64)),
            *sphere,
        ]
        places = [
            [
                *run.axis,
                *run.joint_origin,
                run.kind == "revolute",
                *np.ravel(run.gravity_terms()),
            ]
            for run in runs
        ]
        geometry = np.array([[*place, *inside] for place in places])
        self._geometry = self._array(geometry)
        self._last: tuple[np.ndarray, ...] = ()

    def last_path(self, directions: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the sphere was in the last ``jacobian``: x (W, T, 3) [m], dx (W, T, 3, D); overwritten by the next."""
        return self._last[3], self._last[4][..., :directions]

    def path(
        self, world_run: np.ndarray, p: np.ndarray, dp: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where the sphere's centre is in the container at the sample instants, as for ``jacobian``.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters, shape (W, P).
            dp: Tangent directions, shape (W, P, D).

        Returns: x (W, T, 3) [m], dx (W, T, 3, D), copies.
        """
        self.launch(
            np.asarray(world_run, dtype=np.int32),
            p,
            dp,
            None,
        )
        x, dx = self.last_path(dp.shape[2])
        return x.copy(), dx.copy()

    def launch(
        self,
        world_run: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        counts: np.ndarray | None,
    ) -> tuple[np.ndarray, ...]:
        """As ``JointSimulator.launch``, with the sphere's path; more directions than one launch takes go in several.

        Args:
            world_run: Run of each world, shape (W,).
            p: Parameters, shape (W, P).
            dp: Tangent directions, shape (W, P, D).
            counts: Samples of each run that are computed, shape (R,); None is all.

        Returns:
            q (W, T), v (W, T), dq (W, T, D), and the sphere's x (W, T, 3) [m], dx (W, T, 3, D); D may be padded.
        """
        most = self.tangent_sizes[-1]
        if dp.shape[2] <= most:
            self._last = super().launch(world_run, p, dp, counts)
        else:
            one = super().launch
            begins = range(0, dp.shape[2], most)
            blocks = [dp[:, :, at : at + most] for at in begins]
            found = []
            for block in blocks:
                found.append([each.copy() for each in one(world_run, p, block, counts)])
            q, v, _, x, _ = found[0]
            dq = np.concatenate([each[2] for each in found], axis=-1)
            dx = np.concatenate([each[4] for each in found], axis=-1)
            self._last = q, v, dq, x, dx
        lost = ~np.isfinite(p).all(axis=1)
        if lost.any():
            self._last[3][lost] = np.nan
        return self._last

    def law_of(self, size: int, stribeck: bool) -> Law:
        return sphere_law(size, stribeck, self.enclosure.shape, self.law)

    def law_data(self) -> Any:
        data = SphereData()
        data.constants = self._constants
        data.geometry = self._geometry
        return data

    def output_arrays(self, worlds: int, size: int) -> list[wp.array]:
        mat = wp.types.matrix(shape=(3, size), dtype=FLOAT)
        shape = (worlds, self._width)
        return [
            *super().output_arrays(worlds, size),
            self._zeros(shape, VEC3),
            self._zeros(shape, mat),
        ]


def compile_kernels(
    shape: str = "box",
    law: str = "ramped",
    integrator: str = "rk4",
    *,
    rises: bool = True,
) -> None:
    """As ``joint.compile_kernels``, for fits with a sphere in a container of one shape and a law of contact.

    Args:
        shape: Of the container.
        law: Of contact.
        integrator: One of ``INTEGRATORS``.
        rises: Whether friction may rise towards standstill.
    """
    # of the two launches with all directions either may have that of the rise
    kinds = dict.fromkeys([*kinds_of_kernel(_SIZES, rises), (_SIZES[-2], True)])
    kernels = [rollout(sphere_law(*kind, shape, law), integrator) for kind in kinds]
    runtime.load(
        [
            *kernels,
            plain_kernel(len(SPHERE_PARAMETERS), integrator),
        ],
        "cpu",
    )
