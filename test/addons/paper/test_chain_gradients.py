"""Every derivative of the chain's rollout three ways: forward sensitivities, tape, central differences."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from support.chain_adjoint import pack, rollout, tape_gradient

from proprio_ros.addons.paper.chain import ChainSimulator, inertial_parameters
from proprio_ros.robot import ReducedModel, pseudo_inertia, rotation_from_rpy

pytestmark = pytest.mark.long
"""Each kernel takes seconds to compile."""

TREES = {"1": (-1,), "2": (-1, 0), "3": (-1, 0, 1), "fork": (-1, 0, 0)}
SCALES = {
    "torque_constant": 1.7,
    "coulomb": 0.05,
    "viscous": 0.02,
    "load_friction": 0.05,
    "armature": 0.02,
    "stiffness": 0.3,
    "pi": 1.0,
    "delay": 0.004,
    "q0": 0.6,
    "v0": 0.3,
}
POINTS = 3


def random_model(tree: str) -> ReducedModel:
    """Revolute joints and a slide (the second of three), everything rotated."""
    parents = TREES[tree]
    n = len(parents)
    rng = np.random.default_rng(n)
    placement = np.tile(
        np.eye(4),
        (n, 1, 1),
    )
    bodies = []
    for i in range(n):
        placement[i, :3, :3] = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3))
        placement[i, :3, 3] = rng.uniform(-0.2, 0.2, 3)
        factor = rng.normal(size=(3, 3))
        second = 1e-3 * factor @ factor.T
        bodies.append(
            pseudo_inertia(
                rng.uniform(0.2, 0.6),
                rng.uniform(-0.1, 0.1, 3),
                np.trace(second) * np.eye(3) - second,
            )
        )
    axes = rng.normal(size=(n, 3))
    return ReducedModel(
        joint_names=tuple(f"joint_{i}" for i in range(n)),
        kinds=("revolute", "prismatic", "revolute")[:n] if n == 3 else ("revolute",) * n,
        parents=np.array(parents),
        placement=placement,
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        pseudo_inertia=np.array(bodies),
        gravity=np.array([1.0, 2.0, -9.5]),
        frames={"base": (-1, np.eye(4))},
    )


@cache
def simulator(tree: str, integrator: str, **options: Any) -> ChainSimulator:
    """Two changes of the input, a supply low enough for the back-EMF limit to act, dry friction, samples out of step."""
    n = len(TREES[tree])
    rng = np.random.default_rng(7)
    rng_inputs = np.random.default_rng(8)
    return ChainSimulator(
        random_model(tree),
        np.concatenate([[0.001], np.sort(rng.uniform(0.0, 0.3, 14))]),
        [0.0, 0.1, 0.165],
        rng_inputs.uniform(-0.5, 0.5, (3, n)),
        friction_velocity=0.05,
        supply=[(1.2, 2.49, 5.22)] * n,
        integrator=integrator,
        **{
            "step_s": 1 / 240,
            "fine_step_s": 1 / 960 if integrator == "rk4" else None,
            **options,
        },
    )


def points(sim: ChainSimulator) -> np.ndarray:
    """Three random points; every parameter away from zero, the delay of both signs."""
    rng = np.random.default_rng(3)
    n = len(sim.model.joint_names)
    groups: dict[str, Any] = {
        name: scale * rng.uniform(0.7, 1.3, (POINTS, n))
        for name, scale in SCALES.items()
        if name not in ("pi", "delay")
    }
    groups["q0"] *= rng.choice(
        [-1.0, 1.0],
        (POINTS, n),
    )
    groups["v0"] *= rng.choice(
        [-1.0, 1.0],
        (POINTS, n),
    )
    groups["delay"] = np.array([0.004, -0.003, 0.0005])
    groups["pi"] = inertial_parameters(sim.model.pseudo_inertia) * rng.uniform(
        0.9, 1.1, (POINTS, n, 1)
    )
    return pack(sim, **groups)


def every(p: np.ndarray) -> np.ndarray:
    return np.tile(
        np.eye(p.shape[1]),
        (len(p), 1, 1),
    )


def scale_of(name: str) -> float:
    """A step of 1e-2 of it is small for the rollout."""
    group = name.split("[")[0]
    return 1e-3 if group == "pi" else SCALES[group]


CASES = [(tree, "rk4") for tree in TREES] + [(tree, "semi_implicit") for tree in ("1", "3")]
"""Kernels take seconds to compile, and each property has its turn."""


@pytest.mark.parametrize(("tree", "integrator"), CASES)
def test_sensitivities_against_central_differences(tree: str, integrator: str) -> None:
    """Five-point differences, steps move q by 3e-7: longer ones meet kinks of the supply limit and other step lengths."""
    sim = simulator(tree, integrator)
    p = points(sim)
    q, _, exact = sim.jacobian(p, every(p))
    # two kernels: not every processor rounds them alike
    np.testing.assert_allclose(
        q,
        rollout(sim, p)[0],
        rtol=1e-12,
        atol=1e-14,
    )
    largest = np.abs(exact).max(axis=(1, 2))
    for column, name in enumerate(sim.parameter_names):
        step = 3e-7 / np.maximum(largest[:, column], 3e-5 / scale_of(name))
        moved = np.concatenate([p] * 4)
        moved[:, column] += np.outer([-2.0, -1.0, 1.0, 2.0], step).ravel()
        far_below, below, above, far_above = np.split(
            rollout(sim, moved)[0],
            4,
        )
        difference = (8.0 * (above - below) - (far_above - far_below)) / (
            12.0 * step[:, None, None]
        )
        error = np.abs(difference - exact[..., column]).max(axis=(1, 2))
        assert np.all(error <= 1e-6 * largest[:, column] + 1e-15 / step), (
            name,
            error / largest[:, column],
        )


@pytest.mark.parametrize(("tree", "integrator"), [("2", "rk4"), ("1", "semi_implicit")])
def test_tape_against_sensitivities(tree: str, integrator: str) -> None:
    """Differences have judged them; a tape's kernel takes up to three seconds to compile."""
    sim = simulator(tree, integrator)
    p = points(sim)
    q, _, exact = sim.jacobian(p, every(p))
    weights = np.random.default_rng(1).normal(size=q.shape)
    terms = weights[..., None] * exact
    # the mass of a body whose joint's axis it cannot turn about or slide along adds nothing but rounding
    tolerance = 1e-10 * np.abs(terms).sum(axis=(1, 2)) + 1e-14 * np.abs(exact).max()
    error = np.abs(tape_gradient(sim, p, weights) - terms.sum(axis=(1, 2)))
    assert np.all(error <= tolerance), {
        name: error[:, column]
        for column, name in enumerate(sim.parameter_names)
        if np.any(error > tolerance, axis=0)[column]
    }


def test_every_parameter_matters() -> None:
    """Zero equals zero proves nothing."""
    sim = simulator("3", "rk4")
    p = points(sim)
    largest = np.abs(sim.jacobian(p, every(p))[2]).max(axis=(0, 1, 2))
    silent = {
        name
        for name, size in zip(
            sim.parameter_names,
            largest,
            strict=True,
        )
        if size < 1e-9
    }
    # the first body turns about an axis through its frame's origin, so its mass as such does nothing
    assert silent == {"pi[joint_0][0]"}


def test_directions_in_blocks_equal_one_at_a_time() -> None:
    """Nineteen directions fill two blocks of eight and part of a third; one alone has a kernel of its own."""
    sim = simulator("2", "rk4")
    p = points(sim)
    directions = np.random.default_rng(1).normal(size=(*p.shape, 19))
    directions[:, sim.columns["pi"], ::2] = 0.0  # the inertia of no body, which takes a shorter way
    q, _, together = sim.jacobian(p, directions)
    for column in range(19):
        alone_q, _, alone = sim.jacobian(
            p,
            directions[..., column : column + 1],
        )
        np.testing.assert_allclose(alone_q, q, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(
            together[..., column], alone[..., 0], rtol=1e-12, atol=1e-12 * np.abs(alone).max()
        )


def test_worlds_do_not_touch_each_other() -> None:
    sim = simulator("2", "rk4")
    p = points(sim)
    weights = np.random.default_rng(1).normal(size=rollout(sim, p)[0].shape)
    gradient = tape_gradient(sim, p, weights)
    for world in range(POINTS):
        alone = slice(world, world + 1)
        np.testing.assert_array_equal(
            sim.jacobian(p[alone], every(p)[alone])[2], sim.jacobian(p, every(p))[2][alone]
        )
        np.testing.assert_array_equal(
            tape_gradient(sim, p[alone], weights[alone]),
            gradient[alone],
        )


def test_payload_mass_is_a_direction_in_pi() -> None:
    """Mass and centre of mass of a payload in the last link, against a model that is built anew."""
    sim = simulator("2", "rk4")
    base = points(sim)[:1]

    def with_payload(mass: float, height: float) -> np.ndarray:
        p = base.copy()
        pseudo = pseudo_inertia(
            mass,
            (0.02, 0.0, height),
            mass * 1e-4 * np.eye(3),
        )
        p[0, sim.columns["pi"].stop - 10 : sim.columns["pi"].stop] += inertial_parameters(pseudo)
        return p

    step = 1e-5
    sides = [
        (
            with_payload(0.05 + step, 0.08),
            with_payload(0.05 - step, 0.08),
        )
    ]
    sides += [
        (
            with_payload(0.05, 0.08 + step),
            with_payload(0.05, 0.08 - step),
        )
    ]
    directions = np.stack(
        [(above - below) / (2.0 * step) for above, below in sides],
        axis=-1,
    )
    exact = sim.jacobian(with_payload(0.05, 0.08), directions)[2]
    for column, (above, below) in enumerate(sides):
        difference = (rollout(sim, above)[0] - rollout(sim, below)[0]) / (2.0 * step)
        scale = np.abs(exact[..., column]).max()
        assert scale > 1e-3
        np.testing.assert_allclose(
            difference,
            exact[..., column],
            atol=1e-6 * scale,
        )


def test_delay_of_a_sample_on_a_change_of_the_input() -> None:
    """Without delay a sample may fall on a change of the input; a longer delay takes it under the former input.

    One-sided differences (-3, 4, -1) towards longer delays, and the tape, must see the same.
    """
    n = 2
    sim = ChainSimulator(
        random_model("2"),
        [0.05, 0.1, 0.13, 0.2],
        [0.0, 0.1],
        [[1.0] * n, [-2.0] * n],
        friction_velocity=0.05,
        step_s=1 / 240,
    )
    p = points(sim)[:1]
    delay = sim.columns["delay"]
    p[:, delay] = 0.0
    direction = np.zeros((1, p.shape[1], 1))
    direction[:, delay] = 1.0
    q, _, exact = sim.jacobian(p, direction)
    step = 1e-6
    moved = np.repeat(p, 2, axis=0)
    moved[:, delay] = np.array([[step], [2.0 * step]])
    once, twice = rollout(sim, moved)[0]
    difference = (-3.0 * q[0] + 4.0 * once - twice) / (2.0 * step)
    np.testing.assert_allclose(
        difference,
        exact[0, ..., 0],
        atol=1e-6 * np.abs(exact).max(),
    )
    weights = np.random.default_rng(2).normal(size=q.shape)
    expected = (weights * exact[..., 0]).sum()
    np.testing.assert_allclose(
        tape_gradient(sim, p, weights)[0, delay],
        expected,
        rtol=1e-10,
    )
