"""The container's sequences on the virtual arm: MuJoCo moves hand, box and sphere, and shares no line with the machine."""

from __future__ import annotations

import numpy as np
import pytest
from support.hand import ROBOT, Hand

from proprio_ros.excitation.machine import ExcitationMachine, Phase
from proprio_ros.excitation.plans import load_sequence
from proprio_ros.probes.container.virtual_object import Container
from proprio_ros.virtual.objects import Payload

pytestmark = pytest.mark.long


def played(
    name: str,
    seed: int,
    sphere_kg: float,
    coulomb: float | None = None,
) -> tuple[ExcitationMachine, list[float]]:
    """The machine at its end, and how far the sphere moved in each push [m]; without mass there is no sphere."""
    full = Container(0.03, sphere_mass_kg=sphere_kg or 0.012)
    hand = Hand(
        seed, full if sphere_kg else Payload(full.mass_kg, inertia_kg_m2=full.inertia), coulomb
    )
    machine = ExcitationMachine(ROBOT)
    sample = hand.sample()
    machine.start(load_sequence(name, ROBOT), sample)
    moved: list[float] = []
    before = Phase.IDLE
    while machine.busy:
        command = machine.tick(hand.time_s, sample)
        if machine.phase is Phase.PROBE and before is not Phase.PROBE:
            hand.spheres.clear()
        elif machine.phase is not Phase.PROBE and before is Phase.PROBE and sphere_kg:
            moved.append(
                float(np.linalg.norm(np.array(hand.spheres) - hand.spheres[0], axis=1).max())
            )
        before = machine.phase
        sample = hand.step(command)
    return machine, moved


# much friction and a heavy rotor, much friction and the lightest rotor, and little friction
@pytest.mark.parametrize(("seed", "coulomb"), [(4, None), (2, None), (3, 0.015)])
@pytest.mark.parametrize("sphere_kg", [0.0, 0.005, 0.06])
def test_a_shaken_hand_stays_where_it_is_and_the_sphere_does_not(
    seed: int, coulomb: float | None, sphere_kg: float
) -> None:
    machine, moved = played("container_shake", seed, sphere_kg, coulomb)
    assert machine.phase is Phase.DONE and all(outcome.used for outcome in machine.outcomes), (
        machine.message
    )
    for outcome in machine.outcomes:
        assert 0.1 <= outcome.travel <= 0.65
    assert all(distance >= 0.005 for distance in moved)
    assert bool(moved) == bool(sphere_kg)


@pytest.mark.parametrize(("seed", "coulomb"), [(1, None), (3, 0.015)])
@pytest.mark.parametrize("sphere_kg", [0.0, 0.06])
def test_a_container_is_lifted_and_lowered_whatever_is_in_it(
    seed: int, coulomb: float | None, sphere_kg: float
) -> None:
    machine, _ = played("container", seed, sphere_kg, coulomb)
    assert machine.phase is Phase.DONE, machine.message
    assert machine.message == "container is done: all 3 runs are good"
    assert max(outcome.attempt for outcome in machine.outcomes) <= 4
    assert all(0.3 <= outcome.travel <= 1.2 for outcome in machine.outcomes if outcome.used)
