"""Tetrahedral meshes of the block that is squeezed: boxes of cells cut into tetrahedra, or a mesh from a file.

The squeeze is along x. A box is divided into hexahedral cells and each cell into five tetrahedra: one over the four corners whose
node indices have an even sum, and one at each of the other four. Seen from the cell, this split alternates from neighbour to
neighbour, so that both sides of a face are cut along the same diagonal; without it the mesh has cracks and is too soft.
Where the cells along an axis are even in number, the mesh is its own mirror image, and an octant of it has the same solution.
"""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.reading import path_problem
from proprio_ros.version import to_install

# cells along one axis; 64^3 are 1.3 million tetrahedra, far more than is ever needed
MAX_CELLS = 64
MIN_QUALITY = 0.05
"""Smallest mean ratio of a tetrahedron (1 is regular, 0 is flat); a cell of a box has 0.84 where it is a cube."""
_FLAT = 1e-6  # of the length: nodes that near to an end belong to it
# faces of a tetrahedron, outward
_TET_CORNERS = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])


@dataclass(frozen=True)
class TetMesh:
    """A solid out of tetrahedra. Raises `ConfigurationError`: Not a sound mesh; the message says where."""

    points: np.ndarray  # reference positions [m], shape (N, 3); x along the squeeze
    tets: np.ndarray  # corners of each tetrahedron, positively oriented, shape (M, 4)
    # number of the cell that each tetrahedron belongs to, shape (M,); the change of volume is shared within a cell
    cells: np.ndarray

    def __post_init__(self) -> None:
        points = self.points
        tets = self.tets
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ConfigurationError("the mesh's points must be finite numbers in rows of x, y, z")
        if (
            tets.ndim != 2
            or tets.shape[1] != 4
            or len(tets) == 0
            or self.cells.shape != (len(tets),)
        ):
            raise ConfigurationError(
                "the mesh needs tetrahedra: rows of four node numbers, and one cell number for each"
            )
        if tets.min() < 0 or tets.max() >= len(points):
            raise ConfigurationError(
                f"a tetrahedron has a corner that is no node: numbers go from 0 to {len(points) - 1}"
            )
        unused = len(points) - len(np.unique(tets))
        if unused:
            raise ConfigurationError(
                f"{unused} nodes of the mesh belong to no tetrahedron: remove them"
            )
        worst = int(np.argmin(self.quality))
        if not self.quality[worst] >= MIN_QUALITY:
            raise ConfigurationError(
                f"tetrahedron {worst} is inside out, or flatter than can be computed with (quality "
                f"{self.quality[worst]:.2g}, at least {MIN_QUALITY} is needed): mesh the block anew with more regular elements"
            )
        places = np.round(points / (_FLAT * self.length)).astype(np.int64)
        if len(np.unique(places, axis=0)) < len(points):
            raise ConfigurationError(
                "two nodes of the mesh lie in the same place, a crack: merge duplicate nodes"
            )
        if self._faces[1].max() > 2:
            raise ConfigurationError(
                "a face of the mesh belongs to more than two tetrahedra: tetrahedra overlap"
            )
        edges = tets[:, [0, 1, 2]].ravel(), tets[:, [1, 2, 3]].ravel()
        graph = coo_matrix(
            (np.ones(len(edges[0])), edges),
            shape=(len(points), len(points)),
        )
        pieces = connected_components(graph, directed=False)[0]
        if pieces > 1:
            raise ConfigurationError(f"the mesh is in {pieces} pieces: the block must be one")

    @cached_property
    def gradients(self) -> np.ndarray:
        """Of the four linear shape functions of each tetrahedron [1/m], shape (M, 4, 3); F = sum of x_k (x) gradient k."""
        corners = self.points[self.tets]
        inverse = np.linalg.inv(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
        return np.concatenate(
            [-inverse.sum(axis=1, keepdims=True), inverse],
            axis=1,
        )

    @cached_property
    def volumes(self) -> np.ndarray:
        """Of each tetrahedron [m^3], shape (M,)."""
        return _volumes(self.points, self.tets)

    @cached_property
    def quality(self) -> np.ndarray:
        """Mean ratio 12 (3 V)^(2/3) / sum of squared edges; negative where inside out; shape (M,)."""
        corners = self.points[self.tets]
        first, second = np.triu_indices(4, 1)
        edges = ((corners[:, first] - corners[:, second]) ** 2).sum(axis=(1, 2))
        ratio = 12.0 * np.abs(3.0 * self.volumes) ** (2.0 / 3.0) / np.where(edges > 0.0, edges, 1.0)
        return np.sign(self.volumes) * ratio

    @cached_property
    def cell_count(self) -> int:
        """How many cells there are."""
        return int(self.cells.max()) + 1

    @cached_property
    def low(self) -> np.ndarray:
        """Smallest coordinates [m], shape (3,)."""
        return self.points.min(axis=0)

    @cached_property
    def size(self) -> np.ndarray:
        """Extent along each axis [m], shape (3,)."""
        return np.ptp(self.points, axis=0)

    @property
    def length(self) -> float:
        """Extent along the squeeze [m]."""
        return float(self.size[0])

    @cached_property
    def area(self) -> float:
        """Mean cross-section: volume over length [m^2]; that of a box's face."""
        return float(self.volumes.sum()) / self.length

    def end(self, axis: int, high: bool) -> np.ndarray:
        """Numbers of the nodes that lie at one end of an axis, shape (K,)."""
        place = self.low[axis] + (self.size[axis] if high else 0.0)
        return np.flatnonzero(np.abs(self.points[:, axis] - place) <= _FLAT * self.length)

    @cached_property
    def _faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Each triangle once, counter-clockwise seen from one of its tetrahedra, and how many it has."""
        faces = self.tets[:, _TET_CORNERS].reshape(-1, 3)
        _, first, counts = np.unique(
            np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
        )
        return faces[first], counts

    @cached_property
    def surface(self) -> np.ndarray:
        """Triangles that belong to one tetrahedron only: corners, counter-clockwise seen from outside, shape (B, 3)."""
        faces, counts = self._faces
        return faces[counts == 1]

    def end_area(self, high: bool) -> float:
        """Of the flat face that a finger pushes [m^2]; 0 where the solid ends in an edge or a tip."""
        flat = np.isin(self.surface, self.end(0, high)).all(axis=1)
        first, second, third = self.points[self.surface[flat]].swapaxes(0, 1)
        return float(np.linalg.norm(np.cross(second - first, third - first), axis=1).sum() / 2)


def _volumes(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    corners = points[tets]
    return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0)


def _oriented(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The same tetrahedra, none inside out."""
    flipped = _volumes(points, tets) < 0.0
    tets = tets.copy()
    tets[flipped] = tets[flipped][:, [0, 1, 3, 2]]
    return tets


def box(
    size: np.ndarray,
    cells: tuple[int, int, int],
    corner: np.ndarray | None = None,
) -> TetMesh:
    """A box of cells, each split into five tetrahedra with alternating parity.

    Args:
        size: Edges [m], shape (3,).
        cells: How many along each axis.
        corner: Where the corner with the smallest coordinates lies [m], shape (3,); default: the box's centre is the origin.

    Raises `ConfigurationError`: A size or number that makes no mesh.
    """
    size = np.asarray(size, dtype=np.float64)
    _refuse_no_box(size, cells)
    corner = -0.5 * size if corner is None else np.asarray(corner, dtype=np.float64)
    nodes = np.array([int(n) + 1 for n in cells])
    points = corner + _places(nodes) / (nodes - 1.0) * size
    strides = np.array([nodes[1] * nodes[2], nodes[2], 1])
    origins = _places(nodes - 1)  # of the cells, (C, 3)
    tets = np.empty((len(origins), 5, 4), dtype=np.int64)
    for parity in (0, 1):
        mine = origins.sum(axis=1) % 2 == parity
        corners = origins[mine][:, None, None, :] + _tetrahedra_of_cell(parity)
        tets[mine] = corners @ strides
    cell_of_tet = np.repeat(np.arange(len(origins)), 5)
    return TetMesh(points, _oriented(points, tets.reshape(-1, 4)), cell_of_tet)


def _refuse_no_box(size: np.ndarray, cells: tuple[int, int, int]) -> None:
    """Raise ConfigurationError: A size or number that makes no mesh."""
    if size.shape != (3,) or not np.isfinite(size).all() or (size <= 0.0).any():
        raise ConfigurationError(
            f"block.size={size.tolist()} is no box: give three edges above zero, in metres"
        )
    if len(cells) != 3 or any(int(n) != n or not 1 <= n <= MAX_CELLS for n in cells):
        raise ConfigurationError(
            f"a block cannot have {list(cells)} cells: give three whole numbers from 1 to {MAX_CELLS}"
        )


def _places(counts: np.ndarray) -> np.ndarray:
    """Indices of a grid with so many along each axis, the last one fastest, shape (N, 3)."""
    return np.array(list(product(*map(range, counts))))


def _tetrahedra_of_cell(parity: int) -> np.ndarray:
    """The five of a cell, by the corners of the unit cube, shape (5, 4, 3): one inside, and one at each corner that it leaves."""
    corners = _places(np.array([2, 2, 2]))
    inner = corners.sum(axis=1) % 2 == parity
    split = [corners[inner]]
    for tip in corners[~inner]:
        neighbours = np.abs(tip - np.eye(3, dtype=np.int64))  # along each axis
        split.append(np.vstack([tip, neighbours]))
    return np.array(split)


def read_mesh(path: Path, scale: float = 1.0) -> TetMesh:
    """A solid from a file in any format that meshio reads (.msh of Gmsh, .vtk, .vtu, .inp, .mesh ...).

    Its tetrahedra of first order are used; where the ends along x are not flat, fingers have nothing to push. Every tetrahedron is
    a cell of its own, so a Poisson's ratio of 0.4 or more needs a fine mesh. ``scale``: metres per unit of length in the file.

    Raises `ConfigurationError`: No such file, meshio is missing, or what it reads is no sound mesh.
    """
    try:
        import meshio
    except ImportError as error:
        raise ConfigurationError(
            f"a block from a mesh file needs the package meshio: {to_install('mesh')}, or give block.size"
        ) from error
    if path_problem(path) or not Path(path).is_file():
        raise ConfigurationError(f"{path}: no such mesh file")
    printed = io.StringIO()  # stdout is for the result, and what is refused is refused in one line
    try:
        with redirect_stdout(printed), redirect_stderr(printed):
            found = meshio.read(path)
    except (Exception, SystemExit) as error:
        # what a reader raises over a broken file is the reader's own choice
        why = printed.getvalue().strip().split("\n")[0] or error or type(error).__name__
        raise ConfigurationError(f"{path}: meshio cannot read this mesh ({why})") from error
    tets = [block.data for block in found.cells if block.type == "tetra"]
    if not tets:
        kinds = ", ".join(sorted({block.type for block in found.cells})) or "nothing"
        raise ConfigurationError(
            f"{path}: holds no tetrahedra (but {kinds}): mesh the block's inside, with first order"
        )
    corners = np.concatenate(tets).astype(np.int64)
    if corners.min() < 0 or corners.max() >= len(found.points):
        raise ConfigurationError(
            f"{path}: a tetrahedron has a corner that is no node: numbers go from 0 to {len(found.points) - 1}"
        )
    used, numbers = np.unique(corners, return_inverse=True)
    points = scale * np.asarray(found.points, dtype=np.float64)[used]
    corners = numbers.reshape(corners.shape)
    try:
        mesh = TetMesh(
            points,
            _oriented(points, corners),
            np.arange(len(corners)),
        )
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    for high, name in ((False, "lowest"), (True, "highest")):
        if mesh.end_area(high) == 0.0:
            raise ConfigurationError(
                f"{path}: has no flat face at its {name} x for a finger to push: turn the block"
            )
    return mesh
