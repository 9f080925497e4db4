"""Weighing a sphere until sure: which pushes are looked at, what they are foreseen to tell, and how it ends on a virtual arm.

The arm, the box and the sphere are MuJoCo's, driven by the excitation's machine as the nodes drive them; the identification's
simulator and its law of contact have no part in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from proprio_ros.addons.paper import hand as paper_hand
from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.plans import Until, check_sequence, load_sequence
from proprio_ros.experiment_design.candidates import Push
from proprio_ros.experiment_design.choosing import Decision
from proprio_ros.identification.estimate import Estimate
from proprio_ros.identification.gates import LITTLE_TRAVEL
from proprio_ros.inputs.settings import Settings, parse_settings
from proprio_ros.probes import probe_named
from proprio_ros.probes.container.choosing import SphereUntilSure
from proprio_ros.probes.container.identify import find_sphere, half_of
from proprio_ros.probes.container.problem import start_prior
from proprio_ros.probes.container.virtual_object import Container
from proprio_ros.robot import load_robot
from proprio_ros.virtual.objects import Payload

ROBOT = load_robot("open_manipulator_x")
PROBE = probe_named("container")
BOX = [
    "container.inner_size=[0.06,0.04,0.04]",
    "container.centre=[0.035,0,0]",
    "sphere.radius=0.01",
]
SHELL_KG = 0.03
JOB = PROBE.facts(
    Settings(parse_settings([*BOX, f"container.mass={SHELL_KG}", "container.mass_std=1e-4"]))
)
UNTIL = Until(1e-3, "kg", 60.0)
BENT = {"joint1": 0.0, "joint2": -1.0, "joint3": 0.6, "joint4": 0.4, "gripper_left_joint": 0.0}


@pytest.fixture(scope="module")
def chooser() -> SphereUntilSure:
    PROBE.prepare(ROBOT, JOB)
    made = PROBE.chooser(ROBOT, JOB, load_sequence("container_until", ROBOT))
    assert isinstance(made, SphereUntilSure)
    return made


def test_the_shipped_sequence_says_what_it_wants() -> None:
    sequence = load_sequence("container_until", ROBOT)
    assert (
        sequence.until == Until(2e-3, "kg", 60.0)
        and sequence.hand == "container"
        and not sequence.runs
    )


def test_a_shell_that_nobody_knows_is_refused() -> None:
    job = PROBE.facts(Settings(parse_settings(BOX)))
    with pytest.raises(ConfigurationError, match="cannot be separated from the container"):
        PROBE.chooser(ROBOT, job, load_sequence("container_until", ROBOT))


def test_every_push_rolls_the_sphere_out_of_a_known_end(chooser: SphereUntilSure) -> None:
    pushes = chooser.ranked(BENT, 0.0)
    kinds = {(push.joint, push.travel > 0.0) for push in pushes}
    assert len(pushes) >= 8
    assert len(kinds) >= 3
    gains = [push.gain for push in pushes]
    assert gains == sorted(gains, reverse=True)
    for push in pushes:
        geometry = chooser._geometry(chooser.catalogue.still(push))
        begins = push.start[push.joint]
        there = start_prior(geometry, JOB.container, begins)
        gone = start_prior(geometry, JOB.container, begins + push.travel)
        assert len(there.guesses) == 1, "where it lies is known"
        assert np.linalg.norm(geometry.across @ (gone.mean - there.mean)) > 5e-3, (
            "and it would not stay there"
        )
        assert abs(push.travel) >= LITTLE_TRAVEL and push.time_s > push.duration_s
        check_sequence(chooser.sequence_of(chooser.run_of(push)), ROBOT)


def sensitivities(
    chooser: SphereUntilSure,
    pushes: Sequence[Push],
    samples: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened slopes of each push's first samples, and the variances of what is each push's own.

    Args:
        chooser: Of the pushes.
        pushes: P of them.
        samples: How many tell something.

    Returns:
        Slopes (P, T, U), what all pushes share first; variances (P, U - shared).
    """
    problem = chooser._problem([chooser.catalogue.standing(push) for push in pushes])
    values = problem.base.copy()
    values[problem.index["sphere_mass"]] = 0.02
    _, _, dq = problem.simulate(values[None], problem.estimated)
    free = problem.estimated_unknowns()
    in_common = [f for f, u in enumerate(free) if u.shared]
    places = [chooser._shared.at[free[f].key] for f in in_common]
    rows = []
    variances = []
    for run, of_push in enumerate(dq[0]):
        own = [f for f, u in enumerate(free) if not u.shared and u.scope == run]
        common = np.zeros((len(of_push), len(chooser._shared.keys)))
        common[:, places] = of_push[:, in_common]
        rows.append(np.hstack([common, of_push[:, own]]))
        variances.append([free[f].std ** 2 for f in own])
    weight = np.zeros(len(rows[0]))
    weight[:samples] = 1.0 / problem.runs[0].sigma[0]
    return np.array(rows) * weight[:, None], np.array(variances)


def test_one_sample_after_the_other_tells_what_all_tell_together(chooser: SphereUntilSure) -> None:
    """The filter against all samples of a run at once."""
    pushes = [replace(push, duration_s=0.5) for push in chooser.ranked(BENT, 0.0)[:6]]
    shared = chooser._shared
    covariance = chooser._covariance
    rows, variance = sensitivities(chooser, pushes, 20)
    at = shared.at["sphere_mass"]
    seen = np.zeros((*rows.shape[:2], 3, rows.shape[2]))
    seen[:, :, 0, at] = 1.0
    stds, spreads = shared.stds_along(rows, variance, covariance, "sphere_mass", seen)
    for run, whitened in enumerate(rows):
        before = block_diag(covariance, np.diag(variance[run]))
        along = whitened @ before
        innovation = along @ whitened.T + np.eye(len(along))
        after = before - along.T @ np.linalg.solve(innovation, along)
        assert stds[run, -1] == pytest.approx(np.sqrt(after[at, at]), rel=1e-5)
    assert np.all(np.diff(stds, axis=1) <= 1e-9)
    assert spreads == pytest.approx(stds)


@dataclass
class Weighed:
    """A weighing on the virtual arm: every decision, what each push promised and what was known after it [kg], and the answer."""

    decisions: list[Decision]
    promised: list[tuple[float, float]]
    answer: Estimate

    @property
    def ended_by(self) -> str:
        return self.decisions[-1].ended_by


def weighed(
    held: Container | Payload,
    until: Until = UNTIL,
    empty: Payload | None = None,
) -> Weighed:
    """Weigh what is held until sure, after runs with the empty container, or with its mass stated where there are none."""
    pytest.importorskip("mujoco")
    from support.pushed_arm import Hand

    from proprio_ros.virtual.arm import VirtualArm
    from proprio_ros.virtual.robot import PARKED
    from proprio_ros.virtual.truth import Truth

    robot = paper_hand.known_robot()
    arm = VirtualArm(
        robot, Truth.nominal(robot), position=PARKED, seed=1, control_period_s=paper_hand.PERIOD_S
    )
    hand = Hand(robot, arm)
    job = JOB if empty is None else PROBE.facts(Settings(parse_settings(BOX)))
    if empty is not None:
        arm.hold(empty)
        hand.make(load_sequence("container", robot))
    baseline, hand.runs = hand.runs, []
    arm.hold(held)
    sequence = replace(load_sequence("container_until", robot), until=until)
    PROBE.prepare(robot, job)
    chooser = PROBE.chooser(robot, job, sequence, baseline)
    began = hand.time_s
    decisions = []
    promised = []
    while not decisions or decisions[-1].run is not None:
        decisions.append(
            chooser.next(
                hand.runs,
                hand.sample().position,
                hand.time_s - began,
            )
        )
        if len(decisions) > 1:
            push = decisions[-2].push
            assert push is not None
            promised.append((push.std, chooser.found.std))
        if (run := decisions[-1].run) is not None:
            hand.make(chooser.sequence_of(run))
    return Weighed(
        decisions,
        promised,
        find_sphere(
            robot,
            hand.runs,
            job.container,
            job.solving,
            baseline,
        ),
    )


@pytest.mark.long
def test_it_ends_when_the_sphere_is_sure() -> None:
    box = Container(SHELL_KG, sphere_mass_kg=0.012)
    it = weighed(
        box,
        Until(1.5e-3, "kg", 60.0),
        box.emptied,
    )
    half = half_of(it.answer)
    mass = it.answer.value("sphere_mass").value
    assert it.ended_by == "target" and it.decisions[-1].reason.startswith("sure: +-")
    assert (
        half is not None
        and half <= 1.5e-3
        and isinstance(mass, float)
        and abs(mass - 0.012) <= half
    )


@pytest.mark.long
def test_a_push_tells_what_was_foreseen() -> None:
    """On the arm of another simulator: what is known after a push is what its linearisation said before."""
    it = weighed(
        Container(SHELL_KG, sphere_mass_kg=0.03),
        Until(1e-4, "kg", 60.0),
    )
    assert it.ended_by == "worth" and "a tenth of what is missing" in it.decisions[-1].reason
    # the first is foreseen for no mass in particular
    ratios = [after / before for before, after in it.promised]
    assert len(ratios) >= 3
    assert 0.5 < ratios[0] < 2.0
    assert all(0.8 < ratio < 1.25 for ratio in ratios[1:]), it.promised


@pytest.mark.long
def test_an_empty_container_is_found_to_be_empty() -> None:
    it = weighed(
        Container(SHELL_KG).emptied,
        Until(3e-3, "kg", 60.0),
    )
    half = half_of(it.answer)
    mass = it.answer.value("sphere_mass").value
    assert it.ended_by == "target"
    assert half is None or (isinstance(mass, float) and mass <= half)
