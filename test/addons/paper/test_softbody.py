"""The explicit soft body: stress, conservation, closed forms, rest states of the quasi-static solver, and its adjoint."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from proprio_ros.addons.paper.softbody import (
    KEEP,
    SOFT_INDEX,
    SOFT_PARAMETERS,
    SoftBody,
    SoftRollout,
    SoftRun,
)
from proprio_ros.errors import SimulationError
from proprio_ros.sim.energies import LAWS, lame, lame_of_small_strain
from proprio_ros.sim.mesh import box
from proprio_ros.sim.quasistatic import QuasiStatic

pytestmark = pytest.mark.long

EDGE = 0.03
MASS = 0.023
TRAVEL = 0.023
HEAVY = (5097.6, 5430.4)
VALUES = {
    "inertia": 0.005,
    "torque_constant": 1.78,
    "coulomb": 0.01,
    "viscous": 0.01,
    "q0": 0.02,
    "v0": 0.05,
    "gap": -0.0005,
    "lame_mu": HEAVY[0],
    "lame_lambda": HEAVY[1],
    "viscosity": 3.0,
}
FREE = {"coulomb": 0.0, "viscous": 0.0, "viscosity": 0.0}


def parameters(**changes: float) -> np.ndarray:
    return np.array([[{**VALUES, **changes}[name] for name in SOFT_PARAMETERS]])


def body(n: int = 2, **options: str) -> SoftBody:
    return SoftBody(
        box(
            np.full(3, EDGE),
            (n, n, n),
        ),
        MASS,
        TRAVEL,
        **options,
    )


def run(
    frames: int,
    current: float = 0.05,
    substeps: int = 64,
) -> SoftRun:
    return SoftRun(
        np.array([0.0, 0.05]), np.array([current, 0.7 * current]), frames, substeps=substeps
    )


def shaken(
    sim: SoftBody,
    places: float,
    speeds: float,
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    points = sim.mesh.points
    return points + places * rng.normal(size=points.shape), speeds * rng.normal(size=points.shape)


@pytest.mark.parametrize("law", LAWS)
def test_forces_are_those_of_the_energy(law: str) -> None:
    """What one step does to the free nodes, against the forces that numpy finds; one tetrahedron is inside out."""
    sim = body(2, law=law, contact="frictionless")
    start = shaken(sim, 0.2 * EDGE, 0.0)
    assert sim.elastic.least_j(start[0]) < 0.0
    one = SoftRun(
        np.zeros(1),
        np.zeros(1),
        1,
        frame_s=1e-6,
        substeps=1,
    )
    q0 = VALUES["gap"] / TRAVEL  # just touching
    result = sim.rollout(
        one,
        parameters(q0=q0, v0=0.0, viscosity=0.0),
        start=start,
    )
    points = sim._start(parameters(q0=q0, v0=0.0), start)[0][0]
    force = -np.tensordot(HEAVY, sim.elastic.forces(points), axes=1)
    expected = 1e-6 * force / sim.masses[:, None]
    inner = sim._sides == 0.0
    np.testing.assert_allclose(
        result.velocities[0][inner], expected[inner], rtol=1e-9, atol=1e-9 * abs(expected).max()
    )
    np.testing.assert_allclose(
        result.velocities[0][:, 1:], expected[:, 1:], rtol=1e-9, atol=1e-9 * abs(expected).max()
    )
    ends = force[~inner, 0] @ sim._sides[~inner] / 2.0
    inertia = VALUES["inertia"] + TRAVEL**2 / 4.0 * sim.masses[~inner].sum()
    torque = -TRAVEL * ends if TRAVEL * q0 > VALUES["gap"] else 0.0
    assert result.v[0, 0] == pytest.approx(
        1e-6 * (torque - VALUES["coulomb"] * 0.0) / inertia, rel=1e-6, abs=1e-12
    )


def total_energy(
    sim: SoftBody,
    result: object,
    p: np.ndarray,
    inertia: float,
) -> float:
    points = result.points[0]
    speeds = result.velocities[0]
    elastic = sim.elastic.energies(points) @ (
        p[0, SOFT_INDEX["lame_mu"]],
        p[0, SOFT_INDEX["lame_lambda"]],
    )
    moving = 0.5 * inertia * result.v[0, -1] ** 2
    return float(elastic + moving + 0.5 * sim.masses @ (speeds**2).sum(axis=1))


@pytest.mark.parametrize("contact", ["bonded", "frictionless"])
def test_energy_is_kept_as_the_steps_shorten(contact: str) -> None:
    """A gripper without motor or friction bounces on the block: first order in the step, and no drift away."""
    sim = body(2, contact=contact)
    p = parameters(**FREE, torque_constant=0.0, v0=1.0)
    errors = []
    for substeps in (64, 256):
        one = SoftRun(
            np.zeros(1),
            np.zeros(1),
            1,
            frame_s=1e-7,
            substeps=1,
        )
        begin = total_energy(
            sim,
            sim.rollout(one, p),
            p,
            VALUES["inertia"],
        )
        drift = [
            total_energy(
                sim,
                sim.rollout(run(frames, substeps=substeps), p),
                p,
                VALUES["inertia"],
            )
            / begin
            - 1.0
            for frames in (3, 6, 9)
        ]
        errors.append(np.abs(drift).max())
    assert errors[0] < 0.01
    assert errors[1] < 0.35 * errors[0]


def test_viscosity_takes_energy_away() -> None:
    sim = body(2)
    kept, lost = (
        total_energy(sim, sim.rollout(run(4), p), p, VALUES["inertia"])
        for p in (
            parameters(**{**FREE, "viscosity": eta}, torque_constant=0.0, v0=1.0)
            for eta in (0.0, 3.0)
        )
    )
    assert 0.9 * kept < lost < 0.995 * kept


@pytest.mark.parametrize("law", ["log", "smith"])
def test_momentum_along_frictionless_faces(law: str) -> None:
    """Nothing pushes along the faces or turns the block about the squeeze: those three momenta stay."""
    sim = body(3, law=law, contact="frictionless")
    start = shaken(sim, 0.01 * EDGE, 0.05)
    first = SoftRun(
        np.zeros(1),
        np.zeros(1),
        1,
        frame_s=1e-9,
        substeps=1,
    )
    p = parameters(**FREE)
    momenta = []
    for schedule in (first, run(6)):
        result = sim.rollout(schedule, p, start=start)
        x = result.points[0]
        v = result.velocities[0]
        turning = x[:, 1] * v[:, 2] - x[:, 2] * v[:, 1]
        momenta.append(sim.masses @ np.column_stack([v[:, 1:], turning]))
    np.testing.assert_allclose(
        momenta[1],
        momenta[0],
        rtol=1e-6,
    )


def test_small_oscillation_of_a_gripper_on_a_spring() -> None:
    """Hooke's block: J q'' = -travel^2 (E A / L) q, the block's own inertia being 1e-4 of the gripper's."""
    modulus = 1000.0
    sim = SoftBody(
        box(
            np.full(3, EDGE),
            (2, 2, 2),
        ),
        0.01,
        TRAVEL,
        "linear",
        "frictionless",
    )
    mu, lam = lame(modulus, 0.3)
    amplitude = 0.01
    # squeezed in the middle of the swing, so that it stays in touch
    p = parameters(
        **FREE,
        lame_mu=mu,
        lame_lambda=lam,
        q0=0.0,
        v0=amplitude * 10.0,
        gap=-0.1 * EDGE,
        torque_constant=1.0,
    )
    hold = TRAVEL * modulus * EDGE * 0.1  # k_t i that balances the spring there: travel E A s
    schedule = SoftRun(
        np.zeros(1),
        np.array([hold * EDGE]),
        60,
    )
    inertia = VALUES["inertia"]
    omega = TRAVEL * np.sqrt(modulus * EDGE / inertia)
    t = np.arange(1, 61) / 60.0
    # sideways inertia of the block is not there at rest: start where the sides already are
    q = sim.rollout(schedule, p).q[0]
    np.testing.assert_allclose(
        q,
        0.1 / omega * np.sin(omega * t),
        atol=2e-3 * 0.1 / omega,
    )


@pytest.mark.parametrize("contact", ["bonded", "frictionless"])
@pytest.mark.parametrize("law", LAWS)
def test_it_comes_to_rest_where_the_quasi_static_solver_says(law: str, contact: str) -> None:
    sim = body(2, law=law, contact=contact)
    mu, lam = lame_of_small_strain(law, *HEAVY)
    torque = 0.06
    p = parameters(
        lame_mu=mu,
        lame_lambda=lam,
        coulomb=0.0,
        viscous=0.06,
        torque_constant=torque,
        viscosity=3.0,
    )
    q = sim.rollout(
        SoftRun(
            np.zeros(1),
            np.ones(1),
            240,
            substeps=48,
        ),
        p,
    ).q[0]
    assert abs(q[-1] - q[-20]) < 1e-8
    squeeze = TRAVEL * q[-1] - VALUES["gap"]
    force = (
        QuasiStatic(sim.mesh, law, contact)
        .curve(
            [squeeze],
            mu,
            lam,
        )
        .force[0]
    )
    assert squeeze > 0.1 * EDGE
    assert torque == pytest.approx(TRAVEL * force, rel=1e-6)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("contact", ["bonded", "frictionless"])
@pytest.mark.parametrize("seed", range(3))
def test_adjoint_against_central_differences(law: str, contact: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sim = body(2, law=law, contact=contact)
    p = parameters() * rng.uniform(0.8, 1.2, (1, len(SOFT_PARAMETERS)))
    schedule = run(8, current=0.08)
    weights = rng.normal(size=(1, schedule.frames))
    result = sim.rollout(schedule, p)
    gradient = result.gradient(weights)[0]
    for name, row in SOFT_INDEX.items():
        step = 1e-5 * abs(p[0, row])
        up = p.copy()
        down = p.copy()
        up[0, row] += step
        down[0, row] -= step
        difference = (
            (sim.rollout(schedule, up).q - sim.rollout(schedule, down).q) * weights
        ).sum() / (2 * step)
        assert gradient[row] == pytest.approx(
            difference,
            rel=2e-6,
            abs=1e-9 / abs(p[0, row]),
        ), name
    # the second backward pass of a rollout, and one that computes the states again
    np.testing.assert_array_equal(result.gradient(weights)[0], gradient)
    np.testing.assert_allclose(
        sim.rollout(schedule, p, "starts").gradient(weights)[0], gradient, rtol=1e-12
    )


@pytest.mark.parametrize("law", ["log", "smith", "warp_compat"])
def test_a_block_that_is_inside_out_unfolds(law: str) -> None:
    """Its middle node starts beyond a face of the block, so that elements are inverted, and finds back."""
    sim = body(2, law=law)
    points = sim.mesh.points.copy()
    (middle,) = np.flatnonzero(np.abs(points).max(axis=1) < 1e-9)
    points[middle] = [0.002, 0.7 * EDGE, 0.003]
    assert sim.elastic.least_j(points) < -0.3
    p = parameters(viscosity=20.0, q0=0.0, v0=0.0, gap=1.0)  # never touched
    end = sim.rollout(
        run(60, substeps=512),
        p,
        start=(points, np.zeros_like(points)),
    ).points[0]
    np.testing.assert_allclose(
        end,
        sim.mesh.points,
        atol=1e-5 * EDGE,
    )


def test_worlds_do_not_mix() -> None:
    sim = body(2)
    p = np.concatenate([parameters(), parameters(lame_mu=8000.0), parameters(gap=0.001)])
    weights = np.random.default_rng(0).normal(size=(3, 6))
    together = sim.rollout(run(6), p)
    gradient = together.gradient(weights)
    for world in range(3):
        alone = sim.rollout(
            run(6),
            p[world : world + 1],
        )
        np.testing.assert_array_equal(
            alone.q[0],
            together.q[world],
        )
        np.testing.assert_allclose(
            alone.gradient(weights[world : world + 1])[0], gradient[world], rtol=1e-12
        )


def test_the_block_rests_until_it_is_touched() -> None:
    """Free flight J w' = k_t i - f_v w before, and then slower."""
    p = parameters(q0=0.0, v0=0.2, gap=0.003, coulomb=0.0, viscous=0.0, torque_constant=0.0)
    q = body(2).rollout(run(60), p).q[0]
    touch = 0.003 / TRAVEL / 0.2 * 60  # frames
    before = np.arange(1, 61) < touch
    np.testing.assert_allclose(
        q[before],
        0.2 * np.arange(1, 61)[before] / 60.0,
        rtol=1e-9,
    )
    assert q[-1] < 0.9 * 0.2


MEMORY = """
import resource
import numpy as np
from proprio_ros.sim.mesh import box
from proprio_ros.addons.paper.softbody import SOFT_PARAMETERS, SoftBody, SoftRun
sim = SoftBody(box(np.full(3, 0.03), (8, 8, 8)), 0.023, 0.023)
p = np.array([[0.005, 1.78, 0.05, 0.01, 0.02, 0.05, 0.0005, 5097.6, 5430.4, 0.0]])
result = sim.rollout(SoftRun(np.zeros(1), np.array([0.1]), 60), p, {keep!r})
gradient = result.gradient(np.ones((1, 60)))
assert np.isfinite(gradient).all() and (gradient[0, 7:9] != 0.0).all()
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, result.bytes)
"""


@pytest.mark.parametrize("keep", KEEP)
def test_a_second_of_eight_cells_fits_into_a_gibibyte(keep: str) -> None:
    """3840 steps of 2560 tetrahedra with gradients, all of the process."""
    root = str(Path(__file__).resolve().parents[3])
    code = f"import sys; sys.path.insert(0, {root!r})" + MEMORY.replace("{keep!r}", repr(keep))
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    peak_kib, kept = (int(word) for word in done.stdout.split())
    assert peak_kib < 2**20
    assert kept < (8e6 if keep == "starts" else 4e8)


def test_what_cannot_be_simulated() -> None:
    sim = body(2)
    with pytest.raises(SimulationError, match=r"too long.* take \d+ substeps"):
        sim.rollout(run(2), parameters(lame_lambda=1e8))
    with pytest.raises(SimulationError, match="no solid"):
        sim.rollout(run(2), parameters(lame_mu=-1.0))
    with pytest.raises(SimulationError, match="finite"):
        sim.rollout(run(2), parameters(gap=np.nan))
    with pytest.raises(SimulationError, match="choose one of states"):
        sim.rollout(run(2), parameters(), keep="all")
    with pytest.raises(SimulationError, match="choose one of bonded"):
        body(1, contact="sticky")
    with pytest.raises(SimulationError, match="above 0"):
        SoftBody(
            box(np.ones(3), (1, 1, 1)),
            0.0,
            1.0,
        )


@pytest.mark.parametrize("contact", ["bonded", "frictionless"])
def test_the_longest_step_is_where_it_becomes_unstable(contact: str) -> None:
    """A tiny disturbance grows beyond it and does not below; with lambda and viscosity it is a lower bound."""
    sim = body(3, contact=contact)
    mu, lam = HEAVY
    for bulk, eta, factor, grows in (
        (0.0, 0.0, 0.98, 0),
        (0.0, 0.0, 1.03, 1),
        (lam, 0.0, 0.98, 0),
        (lam, 3.0, 0.98, 0),
    ):
        frame_s = 300 * factor * sim.most_step_s(mu, bulk, eta)
        schedule = SoftRun(
            np.zeros(1),
            np.zeros(1),
            4,
            frame_s,
            substeps=300,
        )
        p = parameters(
            lame_lambda=bulk,
            viscosity=eta,
            q0=0.0,
            v0=0.0,
            gap=1.0,
        )  # never touched
        try:
            end = SoftRollout(
                sim,
                schedule,
                p,
                "starts",
                shaken(sim, 1e-12, 0.0),
            ).points[0]
        except SimulationError:
            end = np.full_like(sim.mesh.points, np.inf)
        assert (np.abs(end - sim.mesh.points).max() > 1e-9) == grows
