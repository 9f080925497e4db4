"""The table of the block's response: against the finite elements between its nodes, and its life in the cache."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from proprio_ros.errors import ConfigurationError, SimulationError
from proprio_ros.sim import response as module
from proprio_ros.sim.energies import lame, lame_of_small_strain
from proprio_ros.sim.mesh import TetMesh, box
from proprio_ros.sim.quasistatic import QuasiStatic
from proprio_ros.sim.response import Response, build, cache_folder, response, response_of_mesh
from proprio_ros.sim.response_kernels import tabulated
from proprio_ros.sim.runtime import FLOAT

CUBE = np.full(3, 0.03)
SLAB = np.array([0.02, 0.03, 0.04])


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.fixture(scope="module")
def coarse() -> Response:
    return build(CUBE, cells=2)


@pytest.mark.parametrize(
    "law",
    [
        "smith",
        pytest.param("log", marks=pytest.mark.long),
        pytest.param("linear", marks=pytest.mark.long),
        pytest.param("warp_compat", marks=pytest.mark.long),
    ],
)
def test_between_the_nodes_it_is_the_finite_elements(law: str) -> None:
    """Force to 2e-4 and stiffness to 1e-2, at places in the middle of the table's cells."""
    table = build(SLAB, law, cells=2)
    counts = tuple(2 * n for n in json.loads(table.made_of)["cells"])
    solver = QuasiStatic(box(SLAB, counts), law)
    area = SLAB[1] * SLAB[2]
    squeeze = np.array([0.0375, 0.1125, 0.2625])
    for nu in (0.02, 0.26, 0.42):
        curve = solver.curve(
            squeeze * SLAB[0],
            *lame_of_small_strain(law, *lame(5e3, nu)),
        )
        phi, slope, _ = table(squeeze, nu)
        np.testing.assert_allclose(
            5e3 * area * phi,
            curve.force,
            rtol=2e-4,
        )
        np.testing.assert_allclose(
            5e3 * area / SLAB[0] * slope,
            curve.by_squeeze,
            rtol=1e-2,
        )


@pytest.mark.long
def test_its_gradient_is_that_of_its_values(coarse: Response) -> None:
    rng = np.random.default_rng(0)
    # also beyond the table
    s = rng.uniform(0.0, 0.75, 400)
    nu = rng.uniform(-0.1, 0.6, 400)
    step = 1e-6
    _, by_s, by_nu = coarse(s, nu)

    def values(further: float, stiffer: float) -> np.ndarray:
        return coarse(s + further, nu + stiffer)[0]

    np.testing.assert_allclose(
        (values(step, 0.0) - values(-step, 0.0)) / (2 * step),
        by_s,
        atol=2e-5,
    )
    np.testing.assert_allclose(
        (values(0.0, step) - values(0.0, -step)) / (2 * step),
        by_nu,
        atol=2e-5,
    )
    np.testing.assert_allclose(
        coarse(0.0, nu)[0],
        0.0,
        atol=1e-12,
    )
    # the gradient has no jumps
    for edge in coarse.squeeze[1:]:
        below = coarse(edge - 1e-9, nu)
        above = coarse(edge + 1e-9, nu)
        np.testing.assert_allclose(
            below[1],
            above[1],
            atol=1e-6,
        )


@wp.kernel(module="unique")
def _read(
    s: wp.array(dtype=FLOAT),
    nu: wp.array(dtype=FLOAT),
    grid: wp.array(dtype=FLOAT),
    nodes: wp.array3d(dtype=wp.types.vector(length=4, dtype=FLOAT)),
    out: wp.array2d(dtype=FLOAT),
):
    k = wp.tid()
    phi, by_s, by_nu = tabulated(
        s[k],
        nu[k],
        1,
        grid,
        nodes,
    )
    out[0, k] = phi
    out[1, k] = by_s
    out[2, k] = by_nu


@pytest.mark.long
def test_kernels_read_the_same(coarse: Response) -> None:
    rng = np.random.default_rng(1)
    s = rng.uniform(-0.05, 0.75, 300)
    nu = rng.uniform(-0.1, 0.6, 300)
    s[:2], nu[:2] = [0.0, 0.6], [0.0, 0.48]
    out = wp.zeros((3, 300), dtype=FLOAT)
    parts = (s, nu, coarse.grid)
    given = [wp.array(part, dtype=FLOAT) for part in parts]
    nodes = wp.array(
        np.stack([0.0 * coarse.nodes, coarse.nodes]),
        dtype=wp.types.vector(length=4, dtype=FLOAT),
    )
    wp.launch(
        _read,
        dim=300,
        inputs=[*given, nodes],
        outputs=[out],
    )
    np.testing.assert_allclose(
        out.numpy(),
        coarse(s, nu),
        rtol=1e-11,
        atol=1e-11,
    )


@pytest.mark.long
def test_frictionless_faces_need_one_table_for_all_shapes() -> None:
    first = response(CUBE, contact="frictionless")
    second = response(SLAB, contact="frictionless")
    assert first.made_of == second.made_of
    assert len(list(cache_folder().iterdir())) == 1
    # closed form of Hooke's slope
    assert first(0.0, 0.3)[1] == pytest.approx(1.0, rel=1e-9)


def test_a_block_that_is_no_box(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frustum: its table is its own finite elements, and another mesh has another."""
    monkeypatch.setattr(
        module,
        "SQUEEZES",
        {"log": (0.0, 0.3, 7)},
    )
    monkeypatch.setattr(module, "RATIOS", (0.1, 0.4, 4))
    cube = box(CUBE, (3, 3, 3))
    narrower = 1.0 - 0.4 * (cube.points[:, :1] / CUBE[0] + 0.5)
    factors = np.hstack([np.ones_like(narrower), narrower, narrower])
    mesh = TetMesh(
        cube.points * factors,
        cube.tets,
        cube.cells,
    )
    table = response_of_mesh(mesh)
    mu, lam = lame(3000.0, 0.23)
    curve = QuasiStatic(mesh).curve(
        np.array([0.13 * CUBE[0]]),
        mu,
        lam,
    )
    force = 3000.0 * mesh.area * table(0.13, 0.23)[0]
    assert force == pytest.approx(curve.force[0], rel=1e-3)
    assert response_of_mesh(cube)(0.13, 0.23)[0] > 1.02 * table(0.13, 0.23)[0]
    assert len(list(cache_folder().iterdir())) == 2
    assert response_of_mesh(mesh).made_of == table.made_of
    assert len(list(cache_folder().iterdir())) == 2


def test_the_cache_is_used_and_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RATIOS", (0.0, 0.48, 2))
    built = []
    original = module.build
    monkeypatch.setattr(
        module,
        "build",
        lambda *given: built.append(given) or original(*given),
    )

    def get(**options: object) -> Response:
        return response(CUBE, contact="frictionless", **options)

    first = get()
    np.testing.assert_array_equal(get().nodes, first.nodes)
    assert len(built) == 1
    get(rebuild=True)
    assert len(built) == 2
    (path,) = cache_folder().iterdir()
    content = path.read_bytes()
    for damaged in (b"", content[: len(content) // 2], b"no table"):
        path.write_bytes(damaged)
        np.testing.assert_array_equal(get().nodes, first.nodes)
    assert len(built) == 5
    # numbers that were changed by hand
    np.savez(
        path,
        made_of=first.made_of,
        squeeze=first.squeeze,
        ratio=first.ratio,
        nodes=2 * first.nodes,
        digest="x",
    )
    np.testing.assert_array_equal(get().nodes, first.nodes)
    # other code makes another table
    monkeypatch.setattr(module, "_code_hash", lambda: "other")
    get()
    assert len(built) == 7 and len(list(cache_folder().iterdir())) == 2


def test_a_cache_that_cannot_be_written_is_no_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert response(CUBE, contact="frictionless").reach == pytest.approx(0.6)


def test_bad_requests() -> None:
    with pytest.raises(SimulationError, match="choose one of bonded"):
        response(CUBE, contact="glued")
    with pytest.raises(SimulationError, match="choose one of log"):
        response(CUBE, law="rubber")
    with pytest.raises(ConfigurationError, match=r"block\.size"):
        response(np.array([0.03, -0.03, 0.03]))
