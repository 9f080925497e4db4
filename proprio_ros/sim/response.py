"""The fast path: a homogeneous block's force on the fingers, tabulated once, read in a fit.

For one law, one contact and one shape of a homogeneous block, what the finite elements of ``quasistatic.py`` say is exactly

    P = E A phi(s, nu),     s = squeeze / length

with Young's modulus E and Poisson's ratio nu at small strain and A the face's area. ``phi`` is tabulated over s and nu with its
exact derivatives at the nodes and interpolated by bicubic Hermite polynomials, so that its gradient is continuous, too. It is
continued beyond the table by its tangent, and ``reach`` says where that begins.

The table depends on the shape only through the ratios of the edges, and with frictionless faces not even on those. It is built
on an octant of the block (1/8 of the work, the same answer), kept in the user's cache under a hash of the settings and of the
code that made it, and built anew when either has changed.
"""

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from itertools import product
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from proprio_ros.errors import SimulationError
from proprio_ros.sim.energies import check_law, lame, lame_by_poissons_ratio, lame_of_small_strain
from proprio_ros.sim.mesh import TetMesh, box
from proprio_ros.sim.quasistatic import CONTACTS, QuasiStatic
from proprio_ros.whole_files import in_one_step

CELLS = 6
"""Of the octant, along a mean edge: 12 for the block. Its error of E with bonded faces at 30 % squeeze, against second-order
elements: 0.2, 0.9, 1.6 % at nu = 0.13, 0.26, 0.40 (0.1, 0.4, 0.9 % at 5 %)."""
RATIOS = (0.0, 0.48, 13)  # first and last Poisson's ratio of the table, and how many
SQUEEZES = {
    "log": (0.0, 0.6, 25),
    "linear": (0.0, 0.6, 25),
    "smith": (0.0, 0.3, 13),
    "warp_compat": (0.0, 0.3, 13),
}
"""First and last squeeze of the table relative to the length, and how many; the force of the last two laws peaks and drops."""
FARTHEST = (0.0, 0.8, 49)
"""The same for the laws that stand it, with frictionless faces, where every element is squeezed alike."""
_SOURCES = ("mesh.py", "energies.py", "quasistatic.py", "response.py")


@dataclass(frozen=True)
class Response:
    """phi over a grid."""

    made_of: str  # settings and a hash of the code, one line of JSON
    # squeeze, ratio: relative to the length, and Poisson's, evenly spaced from 0; shapes (S,) and (N,)
    squeeze: np.ndarray
    ratio: np.ndarray
    # phi, its derivative by s, by nu, and by both, each multiplied by the spacing of what it is by; shape (S, N, 4)
    nodes: np.ndarray

    @property
    def reach(self) -> float:
        """Largest squeeze of the table, relative to the length."""
        return float(self.squeeze[-1])

    @cached_property
    def grid(self) -> np.ndarray:
        """First and spacing of s, first and spacing of nu, for the kernels; shape (4,)."""
        (s0, s1), (n0, n1) = self.squeeze[:2], self.ratio[:2]
        return np.array([s0, s1 - s0, n0, n1 - n0])

    def __call__(
        self, squeeze: ArrayLike, ratio: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """phi, dphi/ds and dphi/dnu; arguments are broadcast."""
        s, nu = np.broadcast_arrays(
            np.asarray(squeeze, dtype=np.float64), np.asarray(ratio, dtype=np.float64)
        )
        at_s, rows, by_s, beyond_s = self._place(s, 0)
        at_nu, columns, by_nu, beyond_nu = self._place(nu, 1)
        phi, slope, slope_nu, both = np.zeros((4, *s.shape))
        for i, j in product((0, 1), repeat=2):
            node = self.nodes[rows + i, columns + j]
            for b, a in product((0, 1), repeat=2):
                corner = node[..., a + 2 * b]
                phi += corner * at_s[i][a] * at_nu[j][b]
                slope += corner * by_s[i][a] * at_nu[j][b]
                slope_nu += corner * at_s[i][a] * by_nu[j][b]
                both += corner * by_s[i][a] * by_nu[j][b]
        # beyond the table's end it goes on straight
        beyond = phi + slope * beyond_s + slope_nu * beyond_nu + both * beyond_s * beyond_nu
        return beyond, slope + both * beyond_nu, slope_nu + both * beyond_s

    def _place(
        self,
        value: np.ndarray,
        axis: int,
    ) -> tuple[list, np.ndarray, list, np.ndarray]:
        first, step = self.grid[2 * axis : 2 * axis + 2]
        last = self.nodes.shape[axis] - 1
        inside = np.clip(value, first, first + last * step)
        cell = np.minimum(
            ((inside - first) / step).astype(np.int64),
            last - 1,
        )
        t = (inside - first) / step - cell
        basis = [
            [
                (1 + 2 * t) * (1 - t) ** 2,
                t * (1 - t) ** 2,
            ],
            [
                t**2 * (3 - 2 * t),
                t**2 * (t - 1),
            ],
        ]
        by_t = [
            [
                6 * t * (t - 1),
                (1 - t) * (1 - 3 * t),
            ],
            [6 * t * (1 - t), t * (3 * t - 2)],
        ]
        return basis, cell, [[part / step for part in pair] for pair in by_t], value - inside


def build(
    size: np.ndarray,
    law: str = "log",
    contact: str = "bonded",
    cells: int = CELLS,
    far: bool = False,
) -> Response:
    """Compute a table for a block; half a minute for bonded faces.

    Args:
        size: Edges [m], x along the squeeze, shape (3,); only their ratios matter.
        law: Of the material.
        contact: With the fingers.
        cells: Of an octant, along a mean edge.
        far: As `FARTHEST` says, where that can be; tables of one simulator must reach equally far.

    Raises:
        SimulationError: Unknown law or contact, or a block of such a shape cannot be squeezed that far.
        ConfigurationError: No box.
    """
    made_of = _made_of(size, law, contact, cells, far)
    settings = json.loads(made_of)
    edges = np.array([1.0, *settings["sides"]])
    mesh = box(
        0.5 * edges,
        tuple(settings["cells"]),
        corner=np.zeros(3),
    )
    return _tabulate(
        QuasiStatic(mesh, law, contact, octant=True), float(edges[1] * edges[2]), 1.0, made_of
    )


def _tabulate(solver: QuasiStatic, area: float, length: float, made_of: str) -> Response:
    law = solver.elastic.law
    squeeze = np.linspace(*json.loads(made_of)["squeezes"])
    ratio = np.linspace(*RATIOS)
    nodes = np.zeros((len(squeeze), len(ratio), 4))
    for column, nu in enumerate(ratio):
        curve = solver.curve(
            length * squeeze,
            *lame_of_small_strain(law, *lame(1.0, nu)),
        )
        by_mu, by_lambda = lame_of_small_strain(law, *lame_by_poissons_ratio(nu))
        by_nu = curve.by_mu * by_mu + curve.by_lambda * by_lambda
        nodes[:, column, :3] = (
            np.stack([curve.force, length * curve.by_squeeze, by_nu], axis=1) / area
        )
    nodes[..., 3] = CubicSpline(
        ratio,
        nodes[..., 1],
        axis=1,
    )(
        ratio,
        1,
    )
    ratio_step = ratio[1] - ratio[0]
    nodes *= np.array([1.0, squeeze[1], ratio_step, squeeze[1] * ratio_step])
    return Response(made_of, squeeze, ratio, nodes)


def response(
    size: np.ndarray,
    law: str = "log",
    contact: str = "bonded",
    rebuild: bool = False,
    far: bool = False,
) -> Response:
    """As `build`: from the cache, or built and put there.

    Args:
        size: Edges [m], x along the squeeze, shape (3,).
        law: Of the material.
        contact: With the fingers.
        rebuild: Whether it is built anew.
        far: As for `build`.
    """
    made_of = _made_of(size, law, contact, CELLS, far)
    return _kept(made_of, rebuild, lambda: build(size, law, contact, CELLS, far))


def response_of_mesh(
    mesh: TetMesh, law: str = "log", contact: str = "bonded", rebuild: bool = False
) -> Response:
    """As `response`, for a whole block that is no box; minutes for a thousand nodes.

    Args:
        mesh: Of the block, of its own ``length`` and ``area``.
        law: Of the material.
        contact: With the fingers.
        rebuild: Whether it is built anew.
    """
    solver = QuasiStatic(mesh, law, contact)
    content = b"".join(
        np.ascontiguousarray(part).tobytes() for part in (mesh.points, mesh.tets, mesh.cells)
    )
    settings = {
        "law": law,
        "contact": contact,
        "mesh": hashlib.sha256(content).hexdigest(),
    }
    made_of = json.dumps(settings | _common(SQUEEZES[law]), sort_keys=True)
    return _kept(
        made_of,
        rebuild,
        lambda: _tabulate(solver, mesh.area, mesh.length, made_of),
    )


def kept_at(made_of: str) -> Path:
    """Where the table that is made of this is kept."""
    return cache_folder() / f"response-{hashlib.sha256(made_of.encode()).hexdigest()[:16]}.npz"


def _kept(
    made_of: str,
    rebuild: bool,
    make: Callable[[], Response],
) -> Response:
    path = kept_at(made_of)
    table = None if rebuild else _load(path, made_of)
    if table is None:
        _store(path, table := make())
    return table


def cache_folder() -> Path:
    """Where tables are kept: ``$XDG_CACHE_HOME/proprio_ros``, or ``~/.cache/proprio_ros``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "proprio_ros"


def _made_of(
    size: np.ndarray,
    law: str,
    contact: str,
    cells: int,
    far: bool,
) -> str:
    check_law(law)
    if contact not in CONTACTS:
        raise SimulationError(f"unknown contact {contact!r}: choose one of {', '.join(CONTACTS)}")
    size = box(size, (1, 1, 1)).size  # refuses what is no box
    if contact == "frictionless":
        # the state is homogeneous: every shape and every mesh says the same
        sides = [1.0, 1.0]
        counts = [1, 1, 1]
    else:
        sides = np.round(size[1:] / size[0], 6).tolist()
        edges = np.array([1.0, *sides])
        # even numbers: a block of twice as many cells is then exactly what the octant is an eighth of
        halves = np.round(0.5 * cells * edges / np.prod(edges) ** (1 / 3))
        counts = (2 * np.clip(halves, 1, 2 * cells)).astype(int).tolist()
    squeezes = (
        FARTHEST if far and contact == "frictionless" and SQUEEZES[law][1] > 0.5 else SQUEEZES[law]
    )
    settings = {"law": law, "contact": contact, "sides": sides, "cells": counts}
    return json.dumps(settings | _common(squeezes), sort_keys=True)


def _common(squeezes: tuple[float, float, int]) -> dict[str, object]:
    return {"squeezes": squeezes, "ratios": RATIOS, "code": _code_hash()}


@cache
def _code_hash() -> str:
    folder = Path(__file__).resolve().parent
    return hashlib.sha256(b"".join((folder / name).read_bytes() for name in _SOURCES)).hexdigest()


def _load(path: Path, made_of: str) -> Response | None:
    """None where there is no such file, or it is damaged, or made of something else."""
    try:
        with np.load(path) as stored:
            table = Response(
                str(stored["made_of"]), stored["squeeze"], stored["ratio"], stored["nodes"]
            )
            whole = str(stored["digest"]) == _digest(table)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
    return table if whole and table.made_of == made_of else None


def _digest(table: Response) -> str:
    content = b"".join(
        np.ascontiguousarray(part).tobytes() for part in (table.squeeze, table.ratio, table.nodes)
    )
    return hashlib.sha256(table.made_of.encode() + content).hexdigest()


def _store(path: Path, table: Response) -> None:
    """Whole or not at all; where the cache cannot be written, the table is built anew next time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with in_one_step(path) as stream:
            np.savez(stream, digest=_digest(table), **asdict(table))
    except OSError:
        return
