"""Every derivative of a rollout with a sphere three ways: forward sensitivities, tape, central differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.plain_laws import states_of, taped_sphere

from proprio_ros.sim.joint import PARAMETERS, JointRun, JointSimulator
from proprio_ros.sim.mixed import MixedSimulator
from proprio_ros.sim.sphere import (
    SPHERE_INDEX,
    SPHERE_PARAMETERS,
    Contact,
    Enclosure,
    SphereRun,
    SphereSimulator,
)

pytestmark = pytest.mark.long
"""Each kernel takes seconds to compile."""

ONE = np.zeros(1, dtype=np.int32)
STEPS = (1e-4, 1e-5, 1e-6, 1e-7)
"""Of a difference, relative to the parameter."""
EVERY = np.eye(len(SPHERE_PARAMETERS))[None]
INNER = {
    "box": [0.06, 0.04, 0.045],
    "cylinder": [0.05, 0.05, 0.06],
    "sphere": [0.05, 0.05, 0.05],
}
CONTACT = Contact.of(400.0, 0.4, 0.35)
BASE = {
    "inertia": 0.02, "gravity_cos": 0.12, "gravity_sin": 0.05, "gravity_constant": 0.03, "torque_constant": 1.78,
    "coulomb": 0.03, "viscous": 0.01, "load_friction": 0.05, "stribeck": 0.4, "stribeck_velocity": 0.3,
    "delay": 0.0043, "q0": -0.7, "v0": 0.3, "carried": 0.03,
    "sphere_mass": 0.03, "stiffness": CONTACT.stiffness, "damping": CONTACT.damping,
    "traction": CONTACT.traction, "friction": CONTACT.friction, "tilt": 0.05,
}  # fmt: skip
# Where the sphere starts, as shares of the room it has: just inside a wall, in the air above it, in the corner of several walls.
# All differ from a kink of the law; those at a wall start deep enough to stay, or to be thrown out.
SCENES = {
    "rolling": {
        "box": (0.3, -0.1, -1.005),
        "cylinder": (0.3, -0.955, 0.2),
        "sphere": (0.3, -0.2, -0.94),
    },
    "bouncing": {
        "box": (0.1, 0.3, -0.4),
        "cylinder": (-0.2, 0.1, 0.3),
        "sphere": (0.3, 0.2, -0.3),
    },
    "corner": {
        "box": (-1.01, 1.02, -1.015),
        "cylinder": (0.7, -0.73, -1.01),
        "sphere": (-0.6, 0.6, -0.55),
    },
    "on a slide": {
        "box": (0.9, 0.2, -0.8),
        "cylinder": (0.5, -0.4, -0.8),
        "sphere": (0.4, 0.3, -0.6),
    },
}
# shape, law and integrator know nothing of each other: every pair is compiled, not every three
KERNELS = [
    ("box", "ramped", "rk4"),
    ("box", "paper", "rk4"),
    ("cylinder", "ramped", "rk4"),
    ("sphere", "paper", "rk4"),
    ("box", "ramped", "semi_implicit"),
    ("cylinder", "paper", "semi_implicit"),
    ("sphere", "ramped", "semi_implicit"),
]
CASES = [
    pytest.param(scene, *kernel, id="-".join((scene, *kernel)))
    for kernel in KERNELS
    for scene in SCENES
]


def unit(*values: float) -> np.ndarray:
    return np.array(values) / np.linalg.norm(values)


def joint_run(seed: int = 1, duration_s: float = 0.3) -> JointRun:
    """Irregular stamps, a square wave, and a supply so weak that it limits the current."""
    times = np.sort(np.random.default_rng(seed).uniform(0.0, duration_s, 12))
    # s; where the kinks of a rollout lie depends on it, and the scenes keep clear of them at this one
    step = 1e-3
    return JointRun(
        times,
        np.array([0.0, 0.1017, 0.2013]),
        np.array([0.35, -0.3, 0.4]),
        supply=(1.9, 2.49, 5.22),
        friction_velocity=0.02,
        step_s=step,
        fine_step_s=step,
        input_load=np.array(
            [
                [0.01, 0.2],
                [-0.02, 0.3],
                [0.015, -0.1],
            ]
        ),
    )


def sphere_run(kind: str, joint: JointRun) -> SphereRun:
    return SphereRun(
        joint,
        kind,
        unit(0.1, 0.95, -0.2),
        np.array([-0.15, 0.01, 0.02]),
        9.81 * unit(0.25, -0.3, -0.9),
    )


def enclosure(shape: str) -> Enclosure:
    return Enclosure(shape, np.array(INNER[shape]), 0.01)


def scene(
    name: str,
    shape: str,
    law: str,
    integrator: str,
) -> tuple[SphereSimulator, np.ndarray]:
    kind = "prismatic" if name == "on a slide" else "revolute"
    inside = enclosure(shape)
    p = np.zeros((1, len(SPHERE_PARAMETERS)))
    for parameter, value in BASE.items():
        p[0, SPHERE_INDEX[parameter]] = value
    if name == "bouncing":
        p[0, SPHERE_INDEX["delay"]] *= -1.0
    start = np.array(SCENES[name][shape]) * inside.room
    p[0, [SPHERE_INDEX[f"start_{axis}"] for axis in "xyz"]] = start
    return SphereSimulator(
        [sphere_run(kind, joint_run())],
        inside,
        law,
        integrator,
    ), p


def differences(
    sim: SphereSimulator,
    p: np.ndarray,
    step: np.ndarray,
) -> np.ndarray:
    """Central differences of second and fourth order of joint and sphere, shape (2, P, T, 4); all in one launch."""
    steps = np.array([-2.0, -1.0, 1.0, 2.0])
    moved = p + steps[:, None, None] * np.diag(step)
    worlds = moved.reshape(-1, len(step))
    q, _, x, *_ = states_of(
        sim,
        np.zeros(len(worlds), dtype=np.int32),
        worlds,
    )
    seen = np.concatenate([q[..., None], x], axis=2)
    far, near, next_, last = seen.reshape(4, len(step), -1, 4)
    second = (next_ - near) / 2.0
    fourth = (far - 8.0 * near + 8.0 * next_ - last) / 12.0
    return np.array([second, fourth]) / step[:, None, None]


@pytest.mark.parametrize(("name", "shape", "law", "integrator"), CASES)
def test_sensitivities_against_central_differences(
    name: str, shape: str, law: str, integrator: str
) -> None:
    """Of the joint's position and of the sphere's, by all 23 parameters.

    A step of the integrator in which a wall is touched, or sliding turns into sticking, is a kink, and with the paper's law a
    jump. The tangent is that of the side on which the rollout is, so of the differences each sample takes the one that straddles
    no kink: over 8 a false tangent meets none of them to 1e-6.
    """
    sim, p = scene(name, shape, law, integrator)
    exact = sensitivities(sim, p)
    size = np.maximum(np.abs(p[0]), 1e-3)
    estimates = [differences(sim, p, step * size) for step in STEPS]
    for row, parameter in enumerate(SPHERE_PARAMETERS):
        steps = [step * size[row] for step in STEPS]
        for what, columns in (("joint", slice(0, 1)), ("sphere", slice(1, 4))):
            wanted = exact[:, columns, row]
            scale = np.abs(wanted).max()
            if parameter == "tilt" and name == "on a slide":
                assert scale == 0.0  # a slide turns nothing
                continue
            assert scale * size[row] > 1e-7, (
                f"{parameter} moves the {what} too little to be checked"
            )
            off = worst_of_best(
                wanted,
                steps,
                [estimate[:, row, :, columns] for estimate in estimates],
            )
            assert off < 1.0, f"{what} by {parameter}: off by {off:.2g} of what is allowed"


def sensitivities(sim: SphereSimulator, p: np.ndarray) -> np.ndarray:
    """Of the joint's position and the sphere's three by every parameter, (T, 4, P)."""
    found = sim.jacobian(ONE, p, EVERY)
    q, _, by_parameter = (array.copy() for array in found)
    x, dx = sim.path(ONE, p, EVERY)
    states = states_of(sim, ONE, p)
    np.testing.assert_allclose(q, states[0], atol=1e-13)
    np.testing.assert_allclose(x, states[2], atol=1e-13)
    return np.concatenate(
        [
            by_parameter[0][:, None, :],
            dx[0],
        ],
        axis=1,
    )


def worst_of_best(
    wanted: np.ndarray,
    steps: list[float],
    estimates: list[np.ndarray],
) -> float:
    """Largest error, of what is allowed, where each sample takes the difference that fits it best.

    Args:
        wanted: the tangent, (T, N).
        steps: of the differences, in the parameter's unit.
        estimates: differences of second and fourth order, (2, T, N) for each step.
    """
    scale = np.abs(wanted).max()
    off = np.full(wanted.shape, np.inf)
    for step, estimate in zip(steps, estimates, strict=True):
        rounding = 2e-15 / step
        if rounding < 2e-5 * scale:
            error = np.abs(estimate - wanted).min(axis=0)
            off = np.minimum(off, error / (1e-6 * scale + rounding))
    return float(off.max())


@pytest.mark.parametrize(("name", "shape", "law", "integrator"), CASES)
def test_tape_against_sensitivities(
    name: str,
    shape: str,
    law: str,
    integrator: str,
) -> None:
    sim, p = scene(name, shape, law, integrator)
    q, _, exact = sim.jacobian(ONE, p, EVERY)
    weights = np.random.default_rng(3).normal(size=q.shape)
    expected = np.einsum("wt,wtd->wd", weights, exact)
    tape = taped_sphere(sim, ONE, p)
    np.testing.assert_allclose(tape.q, q, atol=1e-13)
    gradient = tape.gradient(weights)
    np.testing.assert_allclose(
        gradient,
        expected,
        rtol=1e-10,
        atol=1e-10 * np.abs(expected * p).max(),
    )
    # a second backward pass starts from zero
    np.testing.assert_array_equal(tape.gradient(weights), gradient)


def test_the_supply_limits_the_current_here() -> None:
    """Or the cases above would not have covered it."""
    sim, p = scene("rolling", "box", "ramped", "rk4")
    strong = SphereSimulator(
        [
            sphere_run(
                "revolute",
                replace(joint_run(), supply=(0.0, 2.49, 5.22)),
            )
        ],
        sim.enclosure,
    )
    weakly = states_of(sim, ONE, p)[0]
    strongly = states_of(strong, ONE, p)[0]
    assert np.abs(weakly - strongly).max() > 0.01


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
def test_a_longer_delay_takes_a_sample_under_the_former_current(integrator: str) -> None:
    """Without delay a sample falls on a change of the current; one-sided differences (-3, 4, -1) towards longer delays."""
    _, p = scene("rolling", "box", "ramped", integrator)
    run = replace(
        joint_run(),
        sample_times_s=np.array([0.05, 0.1017, 0.16, 0.2013, 0.25]),
    )
    sim = SphereSimulator(
        [sphere_run("revolute", run)],
        enclosure("box"),
        "ramped",
        integrator,
    )
    column = SPHERE_INDEX["delay"]
    p[0, column] = 0.0
    by_parameter = sim.jacobian(ONE, p, EVERY)[2]
    exact = by_parameter[0, :, column].copy()
    dx = sim.path(ONE, p, EVERY)[1][0, :, :, column]
    step = 1e-7
    moved = np.repeat(p, 3, axis=0)
    moved[:, column] = [0.0, step, 2.0 * step]
    q, _, x, *_ = states_of(
        sim,
        np.zeros(3, dtype=np.int32),
        moved,
    )
    for values, wanted in ((q, exact), (x, dx)):
        now, once, twice = values
        difference = (-3.0 * now + 4.0 * once - twice) / (2.0 * step)
        np.testing.assert_allclose(
            difference,
            wanted,
            atol=3e-6 * np.abs(wanted).max(),
        )
    weights = np.random.default_rng(2).normal(size=(1, 5))
    assert taped_sphere(sim, ONE, p).gradient(weights)[0, column] == pytest.approx(
        (weights[0] * exact).sum(), rel=1e-10
    )


def test_few_directions_equal_all_of_them() -> None:
    """The solver asks for as many directions as it has unknowns: other kernels."""
    sim, p = scene("corner", "cylinder", "ramped", "rk4")
    every = sim.jacobian(ONE, p, EVERY)[2].copy()
    paths = sim.path(ONE, p, EVERY)[1]
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(1, len(SPHERE_PARAMETERS), 5)) * p[0, :, None]
    np.testing.assert_allclose(
        sim.jacobian(ONE, p, directions)[2],
        every @ directions[0],
        rtol=1e-9,
        atol=1e-12,
    )
    np.testing.assert_allclose(
        sim.path(ONE, p, directions)[1],
        paths @ directions[0],
        rtol=1e-9,
        atol=1e-12,
    )


def as_its_own_simulator_says(
    run: JointRun | SphereRun,
    p: np.ndarray,
    window: list[np.ndarray],
) -> None:
    """Angles, speeds and sensitivities of the first samples of one world, (T,), (T,) and (T, P)."""
    if isinstance(run, SphereRun):
        alone = SphereSimulator([run], enclosure("box"))
        width = len(SPHERE_PARAMETERS)
    else:
        alone = JointSimulator([run])
        width = len(PARAMETERS)
        np.testing.assert_array_equal(window[2][:, width:], 0.0)
    expected = alone.jacobian(ONE, p[None, :width], EVERY[:, :width])
    for got, wanted in zip(window, expected, strict=True):
        np.testing.assert_allclose(
            got,
            wanted[0, : len(got)],
            rtol=1e-12,
            atol=1e-13,
        )


def test_runs_with_and_without_a_sphere_share_a_call() -> None:
    """Each world is what its own simulator says of it, in whatever order runs and worlds come, and window by window."""
    _, p = scene("bouncing", "box", "ramped", "rk4")
    long = joint_run(1)
    short = joint_run(2, 0.2)
    plain = replace(short, sample_times_s=short.sample_times_s[:7])
    runs = [
        long,
        sphere_run("revolute", short),
        plain,
        sphere_run("prismatic", long),
    ]
    with_sphere = [isinstance(run, SphereRun) for run in runs]
    special = SphereSimulator(
        [run for run in runs if isinstance(run, SphereRun)],
        enclosure("box"),
    )
    mixed = MixedSimulator(special, [long, plain], with_sphere)
    worlds = np.array(
        [3, 0, 1, 2, 1, 3],
        dtype=np.int32,
    )
    p = np.repeat(p, len(worlds), axis=0)
    p *= np.random.default_rng(4).uniform(
        0.9,
        1.1,
        p.shape,
    )
    directions = np.repeat(EVERY, len(worlds), axis=0)
    for counts in (None, mixed.windows(0.5)):
        used = mixed.sample_counts if counts is None else counts
        found = mixed.jacobian(worlds, p, directions, counts)
        for world, run in enumerate(worlds):
            window = [array[world, : used[run]] for array in found]
            as_its_own_simulator_says(runs[run], p[world], window)
    # a world has the parameters of a sphere, rolling or not
    with pytest.raises(ValueError, match="shape"):
        mixed.jacobian(
            worlds,
            p[:, : len(PARAMETERS)],
            directions[:, : len(PARAMETERS)],
        )
