"""Liquids and grains in an upright cylinder as particles (`contents.c`), which know nothing of this package.

Frame: origin amid the cylinder's bottom, z along its axis. A step takes gravity and the motion of that frame, and gives the mean
force and moment (about the origin) on the cylinder.
"""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

Array = np.ndarray
SOURCE = Path(__file__).with_name("contents.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-c")
GRAVITY = 9.81
KG_M3 = 1000.0
GRAIN_STEP_S = 5e-5
FASTER = 1.3  # than the contents slosh


@dataclass(frozen=True)
class Cylinder:
    """Inner radius and height [m]."""

    radius: float
    height: float


class Contents(Protocol):
    """What is in a container; `kg` in all."""

    kg: float

    def step(
        self,
        gravity: Array,
        acceleration: Array,
        angular: Array,
        turning: Array,
        seconds: float,
    ) -> Array:
        """Force [N] and moment [N m] on the cylinder, shape (6,); acceleration of the origin, angular acceleration and velocity."""
        ...

    def moments(self) -> tuple[Array, Array]:
        """Centre of mass [m], shape (3,), and inertia about the origin [kg m^2], shape (3, 3)."""
        ...


@functools.cache
def library() -> ctypes.CDLL:
    """`contents.c`, compiled."""
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "contents.o"
        built = Path(folder) / "contents.so"
        subprocess.run(
            [
                "gcc",
                *FLAGS,
                str(SOURCE),
                "-o",
                str(part),
            ],
            check=True,
        )
        # linked without -ffast-math, which has whoever loads it lose his subnormal numbers, in all that he computes
        subprocess.run(
            [
                "gcc",
                "-shared",
                str(part),
                "-o",
                str(built),
                "-lm",
            ],
            check=True,
        )
        found = ctypes.CDLL(str(built))
    pointer = ctypes.c_void_p
    real = ctypes.c_double
    whole = ctypes.c_int
    for name, takes, gives in (
        ("liquid_new", (whole, pointer, real, real, whole, real, real), pointer),
        ("liquid_step", (pointer, pointer, real, real, pointer), None),
        ("liquid_free", (pointer,), None),
        ("grains_new", (whole, pointer, real, real, real, real, pointer), pointer),
        ("grains_step", (pointer, pointer, real, whole, pointer), None),
        ("grains_free", (pointer,), None),
        *(
            (f"{kind}_{what}", (pointer,), pointer)
            for kind in ("liquid", "grains")
            for what in ("places", "velocities")
        ),
        ("liquid_gradients", (pointer,), pointer),
    ):
        getattr(found, name).argtypes, getattr(found, name).restype = takes, gives
    return found


def _at(values: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


class _Particles:
    """Places and velocities of particles that are all alike; views of what the program works on."""

    handle: int
    kg: float
    x: Array
    v: Array

    def _view(self, kind: str, count: int) -> None:
        def view(what: str) -> Array:
            at = getattr(library(), f"{kind}_{what}")(self.handle)
            numbers = (ctypes.c_double * (3 * count)).from_address(at)
            return np.ctypeslib.as_array(numbers).reshape(count, 3)

        self.x = view("places")
        self.v = view("velocities")

    def moments(self) -> tuple[Array, Array]:
        second = self.x.T @ self.x
        inertia = np.trace(second) * np.eye(3) - second
        return self.x.mean(axis=0), self.kg / len(self.x) * inertia


class Liquid(_Particles):
    """A liquid, at rest.

    Args:
        cylinder: What it is in.
        fill: How high it stands [m].
        viscosity: [Pa s].
        layers: Cells over the cylinder's height: the resolution.
        tilt: Of the surface, along x [rad].
    """

    def __init__(
        self,
        cylinder: Cylinder,
        fill: float,
        viscosity: float,
        layers: int,
        tilt: float = 0.0,
    ) -> None:
        rng = np.random.default_rng(7)
        cell = cylinder.height / layers
        tall = max(2, round(2.0 * fill / cell))
        wide = 2 * int(np.ceil(cylinder.radius / cell))
        grid = np.stack(
            np.meshgrid(
                *[np.arange(-wide, wide) + 0.5] * 2,
                np.arange(tall) + 0.5,
                indexing="ij",
            ),
            axis=-1,
        )
        x = (
            grid.reshape(-1, 3)
            + 0.3
            * rng.uniform(
                -0.5,
                0.5,
                (grid.size // 3, 3),
            )
        ) * (
            0.5 * cell,
            0.5 * cell,
            fill / tall,
        )
        inside = np.hypot(x[:, 0], x[:, 1]) < cylinder.radius
        x = np.ascontiguousarray(x[inside])
        # a tilted surface over water as dense as before, but for terms of second order
        slope = np.tan(tilt) / fill
        x[:, 2] *= 1.0 + slope * x[:, 0]
        from_the_wall = cylinder.radius**2 - x[:, 1] ** 2 - x[:, 0] ** 2
        x[:, 0] += 0.5 * slope * from_the_wall
        self.kg = KG_M3 * np.pi * cylinder.radius**2 * fill
        each = self.kg / len(x)
        self.handle = library().liquid_new(
            len(x), _at(x), cylinder.radius, cylinder.height, layers, viscosity / KG_M3, each
        )
        self._view("liquid", len(x))

    def __del__(self) -> None:
        library().liquid_free(self.handle)

    def step(
        self,
        gravity: Array,
        acceleration: Array,
        angular: Array,
        turning: Array,
        seconds: float,
    ) -> Array:
        frame = np.concatenate([gravity, acceleration, angular, turning])
        out = np.zeros(6)
        library().liquid_step(
            self.handle,
            _at(frame),
            seconds,
            KG_M3,
            _at(out),
        )
        return out


class Grains(_Particles):
    """Spheres, poured in and at rest; at least 100 of them fill the cylinder about as high as ``fill`` [m].

    Args:
        diameter: [m].
        density: Of a sphere [kg/m^3].
        friction: Coefficient.
    """

    def __init__(
        self,
        cylinder: Cylinder,
        fill: float,
        diameter: float,
        density: float,
        friction: float,
        seed: int = 0,
    ) -> None:
        rng = np.random.default_rng(seed)
        self.cylinder = cylinder
        self.diameter = diameter
        volume = np.pi * diameter**3 / 6.0
        count = round(0.58 * np.pi * cylinder.radius**2 * fill / volume)
        x = self._stacked(count)
        x[:, :2] += rng.uniform(-0.005, 0.005, (count, 2)) * diameter
        each = density * volume
        touch = np.array([each * 5e6, 0.2, friction, 0.02])  # a touch lasts some 1.4 ms
        self.kg = count * each
        self.handle = library().grains_new(
            count,
            _at(np.ascontiguousarray(x)),
            cylinder.radius,
            2.0 * cylinder.height,
            0.5 * diameter,
            each,
            _at(touch),
        )
        self._view("grains", count)
        self._shaken_down()

    def _stacked(self, count: int) -> Array:
        """Places of spheres layer by layer on a square lattice [m], shape (count, 3)."""
        ball = 0.5 * self.diameter
        pitch = 1.02 * self.diameter
        reach = self.cylinder.radius - ball
        wide = int(reach / pitch)
        steps = np.arange(-wide, wide + 1)
        flat = pitch * np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        flat = flat[np.hypot(flat[:, 0], flat[:, 1]) < reach]
        layers = []
        for n in range(-(-count // len(flat))):
            height = np.full(len(flat), ball + pitch * n)
            layers.append(np.column_stack([flat, height]))
        return np.concatenate(layers)[:count]

    def _shaken_down(self) -> None:
        """Shaken for a while, then left alone until nothing moves."""
        none = np.zeros(3)
        down = np.array([0.0, 0.0, -GRAVITY])
        for n in range(30):
            shake = 3.0 * np.sin(2.0 * np.pi * 0.3 * n) * np.array([1.0, 0.6, 0.0])
            self.step(down, shake, none, none, 0.01)
        for _ in range(30):
            self.step(down, none, none, none, 0.01)
            self.v *= 0.5
        self.v[:] = 0.0

    def __del__(self) -> None:
        library().grains_free(self.handle)

    @property
    def fill(self) -> float:
        """How high they stand: twice the height of their centre [m]."""
        return 2.0 * float(self.x[:, 2].mean())

    def step(
        self,
        gravity: Array,
        acceleration: Array,
        angular: Array,
        turning: Array,
        seconds: float,
    ) -> Array:
        frame = np.concatenate([gravity, acceleration, angular, turning])
        out = np.zeros(6)
        library().grains_step(
            self.handle, _at(frame), GRAIN_STEP_S, round(seconds / GRAIN_STEP_S), _at(out)
        )
        return out


def theory_hz(radius: float, fill: float) -> float:
    """First sloshing mode of a perfect liquid in an upright cylinder (Lamb, Hydrodynamics, 191)."""
    k = 1.8412 / radius
    omega = np.sqrt(GRAVITY * k * np.tanh(k * fill))
    return float(omega / (2.0 * np.pi))


def shake_period_s(hz: float) -> float:
    """Of a shake for what sloshes so often: waves stay small, and half of it is whole cycles of a driver of 40 Hz.

    Slower shakes show more of a liquid, and as much of how held joints give way.
    """
    return 0.05 * round(20.0 / (FASTER * hz))


def ring(
    contents: Contents,
    centre: Callable[[], float],
    seconds: float,
    step_s: float,
) -> tuple[Array, Array]:
    """Times [s] and places of the centre of mass along x [m] while the cylinder stands still."""
    none = np.zeros(3)
    down = np.array([0.0, 0.0, -GRAVITY])
    places = []
    for _ in range(round(seconds / step_s)):
        contents.step(down, none, none, none, step_s)
        places.append(centre())
    return step_s * np.arange(1, len(places) + 1), np.array(places)


def fitted_ring(
    times_s: Array,
    places: Array,
    first_hz: float,
) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of a damped oscillation; the ratio is 1 where it does not oscillate."""
    from scipy.optimize import least_squares

    def shape(p: Array) -> Array:
        wave = np.exp(-p[1] * times_s)[:, None] * np.column_stack(
            [np.cos(p[0] * times_s), np.sin(p[0] * times_s)]
        )
        parts: Array = wave @ np.linalg.lstsq(wave, places, rcond=None)[0] - places
        return 1e3 * parts

    omega = 2.0 * np.pi * first_hz
    found = min(
        (
            least_squares(shape, [omega * f, omega * z])
            for f in (0.7, 0.95, 1.05)
            for z in (0.02, 0.3, 0.8)
        ),
        key=lambda r: r.cost,
    )
    turning = abs(float(found.x[0]))
    decay = float(found.x[1])
    return turning / (2.0 * np.pi), float(decay / np.hypot(turning, decay))


def sloshing(
    cylinder: Cylinder,
    fill: float,
    viscosity: float,
    layers: int,
    step_s: float,
    tilt: float = 0.06,
) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of the liquid's first mode, let go with a tilted surface."""
    liquid = Liquid(cylinder, fill, viscosity, layers, tilt)
    times_s, places = ring(
        liquid,
        lambda: float(liquid.x[:, 0].mean()),
        1.5,
        step_s,
    )
    return fitted_ring(times_s, places, theory_hz(cylinder.radius, fill))
