"""The payload interaction: what the hand holds, as inertial parameters of the link that holds it.

The payload of the paper (Chen et al. 2025, arXiv:2410.03920) is a rigid body on a fixed joint at the hand; its mass enters the
equation of motion (1) through the inertia and the gravity load of everything outboard of the probed joint. Both are linear in
the ten inertial parameters, so the map from mass to the coefficients of ``joint.py`` is exact and its derivative is a constant.

Two departures: the payload's own inertia follows from its shape and size (the paper's objects are small, but at 0.1 % of the
joint's inertia it is already 0.1 g), and the centre of mass may lie off the hand's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from proprio_ros.errors import ConfigurationError

_FORMS = {
    "sphere": ("its diameter", 1),
    "cube": ("its edge", 1),
    "box": ("[x, y, z]", 3),
    "cylinder": ("[diameter, length]", 2),
}
"""What is stated of a solid of each shape, and how many numbers that are."""
SHAPES = ("point", *_FORMS)
_SECOND_MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class PayloadShape:
    """How a payload's mass is spread about its centre of mass."""

    # integral of r r^T dm / m about the centre of mass in the payload frame [m^2], shape (3, 3)
    second_moment_per_mass: np.ndarray
    description: str  # the words it was made from, for the report

    @classmethod
    def of(
        cls,
        shape: str,
        size: float | Sequence[float] | None,
    ) -> PayloadShape:
        """Uniform solid of one of ``SHAPES`` and the given outer size [m]; a cylinder's axis is along z, a point has no size.

        Raises `ConfigurationError`: Unknown shape, or a size that does not fit it.
        """
        if shape not in SHAPES:
            raise ConfigurationError(
                f"payload.shape={shape!r} is unknown: choose one of {', '.join(SHAPES)}"
            )
        if shape == "point":
            return cls(np.zeros((3, 3)), "a point mass")
        form, wanted = _FORMS[shape]
        try:
            numbers = np.atleast_1d(np.asarray(size, dtype=np.float64)).ravel()
        except (TypeError, ValueError):
            numbers = np.array([])
        sound = np.all(np.isfinite(numbers)) and not np.any(numbers <= 0.0)
        if len(numbers) != wanted or not sound:
            raise ConfigurationError(
                f"payload.size={size!r} does not fit a {shape}: give {form} in m, e.g. 0.03 for 30 mm"
            )
        if np.any(numbers > 1.0):
            raise ConfigurationError(
                f"payload.size={size!r} is over 1 m: lengths are in m, so 30 mm is 0.03"
            )
        if shape == "box":
            spread = numbers**2 / 12.0
        elif shape == "cylinder":
            spread = np.array(
                [
                    numbers[0] ** 2 / 16.0,
                    numbers[0] ** 2 / 16.0,
                    numbers[1] ** 2 / 12.0,
                ]
            )
        else:
            spread = np.full(
                3,
                numbers[0] ** 2 / (20.0 if shape == "sphere" else 12.0),
            )
        text = " x ".join(f"{1e3 * n:g}" for n in numbers)
        return cls(np.diag(spread), f"a solid {shape}, {text} mm")

    @classmethod
    def hollow(cls, shape: str, inner_size: np.ndarray) -> PayloadShape:
        """A closed box, cylinder (axis along z) or sphere of inner size (3,) [m], whose thin walls are equally thick everywhere."""
        side = np.asarray(inner_size, dtype=np.float64)
        if shape == "sphere":
            spread = side**2 / 12.0
        elif shape == "cylinder":
            radius = side[0] / 2.0
            length = side[2]
            # areas over pi
            mantle = 2.0 * radius * length
            lids = 2.0 * radius**2
            across = (mantle * radius**2 / 2.0 + lids * radius**2 / 4.0) / (mantle + lids)
            along = (mantle * length**2 / 12.0 + lids * length**2 / 4.0) / (mantle + lids)
            spread = np.array([across, across, along])
        else:
            areas = np.prod(side) / side  # of a wall across each axis
            # along an axis the two walls across it lie at its ends, the other four are spread over it
            total = areas.sum()
            spread = side**2 * (areas / 4.0 + (total - areas) / 12.0) / total
        text = " x ".join(f"{1e3 * n:g}" for n in side)
        return cls(np.diag(spread), f"a closed {shape}, {text} mm inside")

    def turned(self, rotation: np.ndarray) -> PayloadShape:
        """The same body after a rotation, shape (3, 3)."""
        return PayloadShape(
            rotation @ self.second_moment_per_mass @ rotation.T,
            self.description,
        )

    @classmethod
    def from_inertia_per_mass(cls, values: Sequence[float]) -> PayloadShape:
        """From [ixx, iyy, izz, ixy, ixz, iyz] / m about the centre of mass [m^2], measured or drawn.

        Raises `ConfigurationError`: Wrong length, or no physical body.
        """
        numbers = np.asarray(values, dtype=np.float64).ravel()
        if numbers.shape != (6,) or not np.all(np.isfinite(numbers)):
            raise ConfigurationError(
                "payload.inertia_per_mass needs [ixx, iyy, izz, ixy, ixz, iyz] in m^2"
            )
        xx, yy, zz, xy, xz, yz = numbers
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        spread = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        if np.linalg.eigvalsh(spread)[0] < -1e-9 * max(np.trace(inertia), 1e-12):
            raise ConfigurationError(
                "payload.inertia_per_mass belongs to no physical body (triangle inequality)"
            )
        return cls(spread, "the inertia per mass that was given")


@dataclass(frozen=True)
class PayloadFacts:
    """What is stated about the object before its mass is known (``config/probes/payload.yaml`` and ``--set``)."""

    # centre of mass in the payload frame [m], shape (3,)
    com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # how far the true centre may lie from it [m], shape (3,); 0 means known
    com_std: np.ndarray = field(default_factory=lambda: np.zeros(3))
    # spread of the mass
    shape: PayloadShape = field(default_factory=lambda: PayloadShape.of("point", None))
    # relative uncertainty of that spread (a guessed size is not a measured one)
    shape_std_relative: float = 0.0
    com_guessed: bool = False  # whether nobody stated where it is

    @property
    def per_kg(self) -> np.ndarray:
        """Inertial parameters of 1 kg of it, shape (10,)."""
        return payload_parameters(
            np.array(1.0),
            self.com,
            self.shape.second_moment_per_mass,
        )


def payload_parameters(
    mass: np.ndarray,
    com: np.ndarray,
    second_moment_per_mass: np.ndarray,
) -> np.ndarray:
    """The ten inertial parameters (m, m c, second moments) of payloads, linear in the mass [kg], shape (...,).

    Args:
        mass: Of each [kg], shape (...,).
        com: Centres of mass [m], shape (..., 3).
        second_moment_per_mass: About them, shape (3, 3) [m^2].

    Returns:
        shape (..., 10): m, hx, hy, hz, Sxx, Syy, Szz, Sxy, Sxz, Syz, the entries of the pseudo-inertia about the payload frame.
    """
    out = np.empty((*mass.shape, 10))
    out[..., 0] = mass
    out[..., 1:4] = mass[..., None] * com
    for column, (i, j) in enumerate(_SECOND_MOMENTS):
        about_frame = second_moment_per_mass[i, j] + com[..., i] * com[..., j]
        out[..., 4 + column] = mass * about_frame
    return out


def payload_parameters_by_com(mass: np.ndarray, com: np.ndarray) -> np.ndarray:
    """Derivative of ``payload_parameters`` by the centre of mass, shape (..., 10, 3)."""
    out = np.zeros((*mass.shape, 10, 3))
    for axis in range(3):
        out[..., 1 + axis, axis] = mass
    for column, (i, j) in enumerate(_SECOND_MOMENTS):
        out[..., 4 + column, i] += mass * com[..., j]
        out[..., 4 + column, j] += mass * com[..., i]
    return out


def pseudo_inertia_basis() -> np.ndarray:
    """The 4x4 pseudo-inertia that each of the ten parameters stands for, shape (10, 4, 4)."""
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for axis in range(3):
        basis[1 + axis, axis, 3] = basis[1 + axis, 3, axis] = 1.0
    for column, (i, j) in enumerate(_SECOND_MOMENTS):
        basis[4 + column, i, j] = basis[4 + column, j, i] = 1.0
    return basis


def joint_coefficients(
    pseudo_inertia: np.ndarray,
    kind: str,
    axis: np.ndarray,
    gravity: np.ndarray,
) -> np.ndarray:
    """Inertia and gravity load that a body puts on the one joint it moves with (``joint.py``'s first four parameters).

    With h the first moment, a the axis and g gravity in the joint's frame at q = 0, the torque that holds a revolute joint is
    ``-a . (R(q) h x g)``, and R(q) h = h_par + cos q h_perp + sin q (a x h). A slide carries ``-m a . g``.

    ``pseudo_inertia``: in the joint's frame, shape (..., 4, 4); ``kind``: ``"revolute"`` or ``"prismatic"``; ``axis``:
    unit vector in the joint's frame, shape (3,); ``gravity``: gravity in the joint's frame at q = 0 [m/s^2], shape
    (3,), or (..., 3) where it differs.

    Returns: shape (..., 4): inertia about (mass along) the axis, and the cosine, sine and constant part of the gravity load.
    """
    out = np.zeros(
        (
            *np.broadcast_shapes(pseudo_inertia.shape[:-2], gravity.shape[:-1]),
            4,
        )
    )
    mass = pseudo_inertia[..., 3, 3]
    if kind == "prismatic":
        out[..., 0] = mass
        out[..., 3] = -mass * (gravity @ axis)
        return out
    second = pseudo_inertia[..., :3, :3]
    first = pseudo_inertia[..., :3, 3]
    out[..., 0] = np.trace(second, axis1=-2, axis2=-1) - np.einsum(
        "i,...ij,j->...", axis, second, axis
    )
    x, y, z = axis
    # a x v is v @ turned; what the part along the axis adds to the triple products is nothing
    turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    level = gravity @ turned
    out[..., 1] = (first * level).sum(axis=-1)
    out[..., 2] = -(first * (level @ turned)).sum(axis=-1)
    return out
