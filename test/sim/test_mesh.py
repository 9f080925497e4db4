"""Meshes of the block: they fill the box, have no cracks, and bad input is named."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError
from proprio_ros.sim.mesh import TetMesh, box, read_mesh

SIZES = [
    ((0.03, 0.03, 0.03), (1, 1, 1)),
    ((0.03, 0.02, 0.05), (2, 3, 4)),
    ((1.0, 2.0, 0.7), (4, 4, 3)),
]


def outward_areas(mesh: TetMesh) -> np.ndarray:
    """Normals of the surface's triangles, as long as their areas [m^2], shape (F, 3)."""
    corners = mesh.points[mesh.surface]
    one_edge = corners[:, 1] - corners[:, 0]
    other_edge = corners[:, 2] - corners[:, 0]
    return np.cross(one_edge, other_edge) / 2.0


@pytest.mark.parametrize(("size", "cells"), SIZES)
def test_the_tetrahedra_fill_the_box_without_cracks(
    size: tuple[float, ...],
    cells: tuple[int, int, int],
) -> None:
    mesh = box(np.array(size), cells)
    assert len(mesh.tets) == 5 * np.prod(cells)
    assert mesh.volumes.min() > 0.0
    assert mesh.volumes.sum() == pytest.approx(np.prod(size), rel=1e-12)
    # a crack would have its two sides in the surface
    area = np.linalg.norm(outward_areas(mesh), axis=1).sum()
    x, y, z = size
    whole = 2 * (x * y + y * z + z * x)
    assert area == pytest.approx(whole, rel=1e-12)
    assert mesh.area == pytest.approx(y * z)
    assert mesh.end_area(False) == pytest.approx(y * z)
    assert mesh.end_area(True) == pytest.approx(y * z)
    shares = np.bincount(mesh.cells, mesh.volumes)
    np.testing.assert_allclose(
        shares,
        np.prod(size) / np.prod(cells),
        rtol=1e-9,
    )


def test_the_parity_alternates() -> None:
    """Without it the neighbours of an inner face would be cut along different diagonals, and both sides would be surface."""
    mesh = box(
        np.ones(3),
        (3, 2, 2),
    )
    assert len(mesh.surface) == 2 * 2 * (3 * 2 + 2 * 2 + 2 * 3)


def test_an_even_box_is_its_mirror_image() -> None:
    mesh = box(
        np.array([0.03, 0.02, 0.05]),
        (4, 2, 2),
    )
    places = np.round(mesh.points, 9)
    number = {tuple(key): at for at, key in enumerate(places.tolist())}
    # no -0.0
    mirrored = np.round(mesh.points * [-1.0, 1.0, 1.0], 9) + 0.0
    swap = np.array([number[tuple(key)] for key in mirrored.tolist()])
    assert {frozenset(tet) for tet in mesh.tets.tolist()} == {
        frozenset(tet) for tet in swap[mesh.tets].tolist()
    }


def test_linear_functions_are_exact() -> None:
    mesh = box(
        np.array([0.03, 0.02, 0.05]),
        (2, 3, 1),
    )
    slope = np.array(
        [
            [1.0, 2.0, -0.5],
            [0.3, 0.7, 0.1],
            [0.0, -0.4, 1.2],
        ]
    )
    moved = mesh.points @ slope.T
    gradient = np.einsum(
        "mka,mkb->mab",
        moved[mesh.tets],
        mesh.gradients,
    )
    np.testing.assert_allclose(
        gradient,
        np.broadcast_to(slope, gradient.shape),
        atol=1e-12,
    )


@pytest.mark.parametrize(
    ("size", "cells", "says"),
    [
        ((0.03, 0.0, 0.03), (2, 2, 2), "above zero"),
        ((0.03, np.nan, 0.03), (2, 2, 2), "above zero"),
        ((0.03, 0.03), (2, 2, 2), "three edges"),
        ((0.03, 0.03, 0.03), (2, 0, 2), "whole numbers"),
        ((0.03, 0.03, 0.03), (2, 2.5, 2), "whole numbers"),
        ((0.03, 0.03, 0.03), (2, 1000, 2), "from 1 to"),
        ((1.0, 1.0, 0.001), (1, 1, 1), "regular"),
    ],
)
def test_bad_boxes(
    size: tuple[float, ...],
    cells: tuple[int, int, int],
    says: str,
) -> None:
    with pytest.raises(ConfigurationError, match=says):
        box(np.array(size), cells)


def test_bad_meshes() -> None:
    good = box(
        np.ones(3),
        (1, 1, 1),
    )
    alone = np.arange(2)
    far = np.concatenate([good.points, good.points + 5.0])
    twice = np.concatenate([good.tets, good.tets + 8])
    cases = [
        (
            good.points,
            good.tets[:, [0, 1, 3, 2]],
            good.cells,
            "inside out",
        ),
        (good.points, good.tets + 1, good.cells, "no node"),
        (
            np.concatenate([good.points, [[9.0, 9.0, 9.0]]]),
            good.tets,
            good.cells,
            "belong to no tetrahedron",
        ),
        (
            far,
            twice,
            np.tile(good.cells, 2),
            "2 pieces",
        ),
        (
            np.tile(good.points, (2, 1)),
            twice,
            np.tile(good.cells, 2),
            "same place",
        ),
        (good.points, good.tets, alone, "one cell number"),
        (
            good.points * np.nan,
            good.tets,
            good.cells,
            "finite",
        ),
    ]
    for points, tets, cells, says in cases:
        with pytest.raises(ConfigurationError, match=says):
            TetMesh(points, tets, cells)


@pytest.mark.parametrize("suffix", [".vtk", ".msh", ".vtu"])
def test_a_mesh_comes_back_from_a_file(tmp_path: Path, suffix: str) -> None:
    meshio = pytest.importorskip("meshio")
    mesh = box(
        np.array([30.0, 20.0, 25.0]),
        (2, 2, 2),
    )
    upside_down = mesh.tets[:, [1, 0, 2, 3]]
    path = tmp_path / f"block{suffix}"
    meshio.write(
        path,
        meshio.Mesh(mesh.points, [("tetra", upside_down)]),
    )
    again = read_mesh(path, scale=1e-3)
    np.testing.assert_allclose(again.size, [0.03, 0.02, 0.025])
    assert again.volumes.sum() == pytest.approx(1.5e-5)
    assert again.volumes.min() > 0.0 and again.cell_count == len(again.tets)


def test_without_meshio_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(ConfigurationError, match=r"meshio: .*\[mesh\]"):
        read_mesh(tmp_path / "block.vtk")


def test_bad_mesh_files(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    meshio = pytest.importorskip("meshio")
    with pytest.raises(ConfigurationError, match="no such mesh file"):
        read_mesh(tmp_path / "none.vtk")
    broken = tmp_path / "broken.vtk"
    broken.write_text("no mesh")
    with pytest.raises(
        ConfigurationError, match=r"broken\.vtk: meshio cannot read .*(?i:vtk|header|data)"
    ):
        read_mesh(broken)
    assert capfd.readouterr() == ("", "")
    flat = tmp_path / "flat.vtk"
    meshio.write(
        flat,
        meshio.Mesh(
            np.eye(3),
            [
                (
                    "triangle",
                    np.array([[0, 1, 2]]),
                )
            ],
        ),
    )
    with pytest.raises(ConfigurationError, match=r"no tetrahedra \(but triangle\)"):
        read_mesh(flat)
    tip = tmp_path / "tip.vtk"
    points = np.array(
        [
            [0.0, 0, 0],
            [0, 1, 0],
            [0, 0, 1],
            [1, 0.3, 0.3],
        ]
    )
    meshio.write(
        tip,
        meshio.Mesh(
            points,
            [
                (
                    "tetra",
                    np.array([[0, 1, 2, 3]]),
                )
            ],
        ),
    )
    with pytest.raises(ConfigurationError, match="highest x"):
        read_mesh(tip)


def test_the_surface_seen_from_outside_encloses_the_volume() -> None:
    """Gauss: a third of the flux of x through the outward triangles."""
    cube = box(
        np.array([0.03, 0.02, 0.01]),
        (2, 3, 2),
    )
    middles = cube.points[cube.surface].mean(axis=1)
    flux = (middles * outward_areas(cube)).sum()
    assert flux / 3.0 == pytest.approx(6e-6, rel=1e-12)
    faces = {tuple(sorted(face)) for face in cube.surface.tolist()}
    squares = 2 * (2 * 3 + 3 * 2 + 2 * 2)
    assert len(faces) == 2 * squares
