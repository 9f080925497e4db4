"""Weigh until sure: the pushes of a weighing, chosen one by one, and those of a calibration, chosen beforehand. No ROS here.

After each push the runs so far are fitted, robot and object together; `Catalogue` ranks what could be pushed next from where the
arm stands. When it ends is the same for all that is identified: see `choosing.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from proprio_ros.excitation.machine import ExcitationMachine
from proprio_ros.excitation.plans import (
    ExcitationRun,
    ExcitationSequence,
)
from proprio_ros.experiment_design import sequential
from proprio_ros.experiment_design.candidates import Push
from proprio_ros.experiment_design.choosing import (
    Chooser,
    Found,
    Whole,
    alone,
    passes,
    time_of,
)
from proprio_ros.quantity import Z95, Sought
from proprio_ros.records import Run
from proprio_ros.robot import Robot
from proprio_ros.robot.kinematics import bent_pose
from proprio_ros.sim.payload import PayloadFacts

MOVES = 0.12  # rad: a push that moves less is repeated with more current
RAISE_BY = 1.2
EASE_BY = 0.6
# what may be in the hand is taken to be so many times more after a push that moved nothing
HEAVIER = 2.5
WEIGHED_KG, LIGHT_KG, WEIGHED_PUSHES = 0.03, 0.01, 6
"""For the sake of which a reference is pushed, and an empty hand: an object, and the pushes with it. What is light is told by an
empty hand better than by a reference: by 24 pushes of either, the half interval of 10 g falls from 0.91 to 0.55 and to 0.77 g."""


class CatalogueChooser(Chooser):
    """One whose pushes come from a catalogue of what can be done with a rigid load."""

    catalogue: sequential.Catalogue
    _unknown_kg = sequential.UNKNOWN_KG  # what the hand may hold while no run says it

    def run_of(self, push: Push) -> ExcitationRun:
        return run_of(push, self.robot)

    def stood_still(self) -> None:
        if self._found.runs:
            return
        _, high = self._unknown_kg
        supported = self._last is not None and self._last.current_A * self._last.travel < 0.0
        # what did not sink is lighter than was thought, what did not rise is heavier, or the joint sticks
        self._unknown_kg = (0.0, high / HEAVIER) if supported else (0.5 * high, HEAVIER * high)


class UntilSure(CatalogueChooser):
    """One weighing whose pushes are chosen one by one; `Chooser` has what it takes and raises."""

    def __init__(
        self,
        robot: Robot,
        facts: PayloadFacts,
        sequence: ExcitationSequence,
        whole: Whole | None = None,
    ) -> None:
        super().__init__(
            robot,
            sequence,
            Sought("mass", "kg"),
            whole,
        )
        self.catalogue = sequential.Catalogue(robot, facts)
        self.known = self.catalogue.nothing_known()
        self._found = Found(self.known.mass, self.known.std)

    def learn(self, runs: Sequence[Run]) -> Found:
        self.known = known = self.catalogue.known(runs, self.known)
        return Found(
            known.mass,
            known.std,
            known.runs,
            0.0 if known.fit is None else known.fit.reduced_chi2,
        )

    def ranked(
        self,
        pose: Mapping[str, float],
        target_std: float,
    ) -> list[Push]:
        beside = time_of(self.robot, self._sequence, pose)
        return self.catalogue.rank(
            self.known,
            beside,
            target_std,
            self._unknown_kg,
        )


def run_of(push: Push, robot: Robot) -> ExcitationRun:
    """A push as a run of a sequence."""
    # the fingers hold what they hold
    turning = [name for name in robot.drive_trains if robot.model.joint(name).kind != "prismatic"]
    start = {name: position for name, position in push.start.items() if name in turning}
    limit = robot.motors[push.joint].current_limit_A - abs(push.shake_A)
    steady = push.shake_A == 0.0
    eased = push.current_A * push.travel < 0.0  # the current only supports what gravity pulls
    return ExcitationRun(
        push.joint,
        push.current_A,
        push.duration_s,
        start,
        max_travel=sequential.MAX_TRAVEL,
        min_travel=MOVES if steady else 0.0,
        raise_by=EASE_BY if eased else RAISE_BY,
        max_current_A=min(limit, abs(push.current_A) * RAISE_BY**2)
        if steady and not eased
        else None,
        shake_A=push.shake_A,
        shake_period_s=sequential.SHAKE_PERIOD_S,
    )


def chosen_known(
    robot: Robot,
    reference_kg: float,
    half_interval: float,
    at_most_s: float,
    sequence: ExcitationSequence,
) -> list[ExcitationRun]:
    """Pushes with a known load in the hand after which a weighing is to be as sure as asked; all chosen beforehand.

    What they would tell follows from where the arm is pushed, so that nothing of them need be recorded before the next
    is chosen. Asked is a half interval [kg] of weighings of `WEIGHED_KG` afterwards, of `LIGHT_KG` where the hand is
    empty (a reference of 0 kg), by `WEIGHED_PUSHES` pushes of their own; ways, rest and brake are the sequence's.

    Args:
        robot: Whose joints.
        reference_kg: In the hand [kg].
        half_interval: That is asked for [kg].
        at_most_s: How long the pushes may take [s].
        sequence: Its ways, rest and brake count.
    """
    weighed_kg = WEIGHED_KG if reference_kg > 0.0 else LIGHT_KG
    catalogue = sequential.Catalogue(robot)
    known, _ = _predicted_weighing(catalogue, weighed_kg, sequence)
    return _chosen(
        catalogue,
        known,
        half_interval,
        at_most_s,
        sequence,
        reference_kg,
    )


def chosen_refresh(
    fresh: Robot,
    aged: Robot,
    at_most_s: float,
    sequence: ExcitationSequence,
) -> tuple[list[ExcitationRun], float, float]:
    """Pushes with an empty hand after which a weighing is nearly as sure as with the calibration when it was made.

    Args:
        fresh: The robot as it was calibrated.
        aged: With what is left of the calibration (see `drift`).
        at_most_s: How long the pushes may take [s].
        sequence: Its ways, rest and brake count.

    Returns:
        The pushes, none where a tenth at most is missing; half the 95 % interval of a predicted weighing of `WEIGHED_KG` when the
        calibration was made, and by now [kg].
    """
    catalogue = sequential.Catalogue(fresh)
    then, pushes = _predicted_weighing(catalogue, WEIGHED_KG, sequence)
    # of the same weighing: where it is pushed does not depend on how well the robot is known
    catalogue = sequential.Catalogue(aged)
    known = replace(catalogue.nothing_known(), mass=WEIGHED_KG)
    for push in pushes:
        known = catalogue.predicted(known, push)
    half = Z95 * then.std
    now = Z95 * known.std
    return (
        _chosen(
            catalogue,
            known,
            (1.0 + sequential.WORTH) * half,
            at_most_s,
            sequence,
            0.0,
        ),
        half,
        now,
    )


def _predicted_weighing(
    catalogue: sequential.Catalogue,
    weighed_kg: float,
    sequence: ExcitationSequence,
) -> tuple[sequential.Known, list[Push]]:
    """What will be known after a weighing, and its pushes: without its own noise nothing would be worth learning."""
    robot = catalogue.robot
    known = replace(catalogue.nothing_known(), mass=weighed_kg)
    pushes = []
    for _ in range(WEIGHED_PUSHES):
        pushes.append(
            max(
                catalogue.rank(
                    known,
                    time_of(robot, sequence, bent_pose(robot)),
                ),
                key=lambda p: p.gain,
            )
        )
        known = catalogue.predicted(known, pushes[-1])
    return known, pushes


def _chosen(
    catalogue: sequential.Catalogue,
    known: sequential.Known,
    half_interval: float,
    at_most_s: float,
    sequence: ExcitationSequence,
    load_kg: float,
) -> list[ExcitationRun]:
    """Pushes with a known load, one after the other, for the sake of a predicted weighing."""
    robot = catalogue.robot
    machine = ExcitationMachine(catalogue.robot)
    here = bent_pose(robot)
    elapsed_s = 0.0
    for run in sequence.runs:
        here |= run.start
    chosen: list[ExcitationRun] = []
    while Z95 * known.std > half_interval:
        ranked = catalogue.rank(
            known,
            time_of(robot, sequence, here),
            half_interval / Z95,
            load_kg=load_kg,
        )
        for push in ranked:
            run = run_of(push, robot)
            if elapsed_s + push.time_s <= at_most_s and passes(machine, alone(sequence, run), here):
                break
        else:
            break
        elapsed_s += push.time_s
        known = catalogue.predicted(known, push, load_kg)
        # where it ends
        here = {
            **push.start,
            push.joint: push.start[push.joint] + push.travel,
        }
        chosen.append(run)
    return chosen
