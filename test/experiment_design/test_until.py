"""Weighing until sure: what a sequence may ask for, what a push is foreseen to tell, and how it ends on a virtual arm.

The arm is MuJoCo's, driven by the excitation's machine as the nodes drive it; the identification's simulator has no part in it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from support.pushed_arm import Hand
from support.spring_probe import Spring

from proprio_ros.addons.paper import hand as paper_hand
from proprio_ros.errors import ConfigurationError, ExcitationError
from proprio_ros.excitation.commands import JointSample
from proprio_ros.excitation.machine import ExcitationMachine
from proprio_ros.excitation.plans import Until, as_text, check_sequence, load_sequence
from proprio_ros.experiment_design.choosing import Decision
from proprio_ros.experiment_design.until import UntilSure, chosen_known
from proprio_ros.probes.base import chooser_of
from proprio_ros.recordings.runs import cut_runs
from proprio_ros.robot import load_robot

ROBOT = load_robot("open_manipulator_x")
UNTIL = Until(4e-3, "kg", 60.0)
"""What a robot file alone can promise."""


def sequence_file(folder: Path, **until: Any) -> Path:
    path = folder / "sure.yaml"
    path.write_text(yaml.safe_dump({"excitation": {"hand": "payload", "until": until}}))
    return path


@pytest.mark.parametrize(
    ("until", "words"),
    [
        ({"half_interval": 0.3, "unit": "kg"}, "it is in kg, not g"),
        ({"half_interval": 0.0, "unit": "kg"}, "must be above 0"),
        ({"half_interval": "half a gram", "unit": "kg"}, "until.half_interval: expected a number"),
        (
            {"half_interval": 5e-4, "unit": "g"},
            "unit='g' is unknown for hand='payload'; choose 'kg'",
        ),
        ({"half_interval": 5e-4}, "until: lacks unit"),
        ({"half_interval": 5e-4, "unit": "kg", "at_most": 30}, "unknown key at_most"),
        ({"half_interval": 5e-4, "unit": "kg", "at_most_s": 0}, "at_most_s=0 must be above 0 s"),
    ],
)
def test_what_cannot_be_asked_for_is_refused_in_one_line(
    tmp_path: Path, until: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_sequence(sequence_file(tmp_path, **until), ROBOT)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_what_nobody_chooses_for_is_refused(tmp_path: Path) -> None:
    path = sequence_file(tmp_path, half_interval=5e-4, unit="kg")
    path.write_text(path.read_text().replace("hand: payload", "hand: empty"))
    with pytest.raises(ConfigurationError, match="state some under 'runs'"):
        load_sequence(path, ROBOT)
    path.write_text(path.read_text().replace("hand: empty", "hand: block"))
    with pytest.raises(ConfigurationError, match="unknown for hand='block'; choose '1'"):
        load_sequence(path, ROBOT)


def test_the_shipped_sequence_says_what_it_wants() -> None:
    assert load_sequence("payload_until", ROBOT).until == Until(0.5e-3, "kg", 60.0)


def test_a_sequence_goes_to_the_excitation_node_as_text() -> None:
    for name in ("payload", "softness", "container_shake"):
        sequence = load_sequence(name, ROBOT)
        again = load_sequence(as_text(sequence), ROBOT)
        assert replace(again, name=name) == sequence
    with pytest.raises(ConfigurationError, match="must be JSON"):
        load_sequence("{runs: }", ROBOT)
    assert set(json.loads(as_text(load_sequence("payload_until", ROBOT)))["until"]) == {
        "half_interval",
        "unit",
        "at_most_s",
    }


def test_the_machine_cannot_choose() -> None:
    pose = dict.fromkeys(ROBOT.drive_trains, 0.0) | {"joint2": -1.0, "joint3": 0.6}
    with pytest.raises(ExcitationError, match="by the identifier"):
        ExcitationMachine(ROBOT).start(
            load_sequence("payload_until", ROBOT), JointSample(0.0, pose, pose)
        )


def test_only_what_is_weighed_is_chosen_for() -> None:
    sequence = load_sequence("payload_until", ROBOT)
    with pytest.raises(ConfigurationError, match="which the probe spring cannot"):
        chooser_of(Spring(), ROBOT, None, sequence)
    with pytest.raises(ConfigurationError, match="has no `until`"):
        UntilSure(ROBOT, paper_hand_facts(), load_sequence("payload", ROBOT))


def paper_hand_facts() -> Any:
    from proprio_ros.sim.payload import PayloadFacts, PayloadShape

    return PayloadFacts(shape=PayloadShape.of("sphere", 0.04))


class Weighing(Hand):
    """The arm, and a weighing of what it holds."""

    def weigh(
        self,
        until: Until,
    ) -> tuple[UntilSure, list[Decision]]:
        sequence = replace(load_sequence("payload_until", self.robot), until=until)
        chooser = UntilSure(self.robot, paper_hand_facts(), sequence)
        began = self.time_s
        decisions = []
        while not decisions or decisions[-1].run is not None:
            decisions.append(
                chooser.next(
                    self.runs,
                    self.sample().position,
                    self.time_s - began,
                )
            )
            if decisions[-1].run is not None:
                self.make(chooser.sequence_of(decisions[-1].run))
        return chooser, decisions


def hand(
    mass_kg: float,
    position: Mapping[str, float] | None = None,
    coulomb: float | None = None,
) -> Weighing:
    """A robot of which all is known, but perhaps not how much its joints really rub."""
    pytest.importorskip("mujoco")
    from proprio_ros.virtual.arm import VirtualArm
    from proprio_ros.virtual.objects import Payload
    from proprio_ros.virtual.robot import PARKED
    from proprio_ros.virtual.truth import Truth

    robot = paper_hand.known_robot()
    truth = Truth.nominal(robot)
    if coulomb is not None:
        truth = replace(
            truth, joints={n: replace(joint, coulomb=coulomb) for n, joint in truth.joints.items()}
        )
    arm = VirtualArm(
        robot, truth, position=position or PARKED, seed=1, control_period_s=paper_hand.PERIOD_S
    )
    arm.hold(Payload(mass_kg))
    return Weighing(robot, arm)


@pytest.mark.long
def test_it_ends_when_it_is_sure(tmp_path: Path) -> None:
    arm = hand(0.05)
    chooser, decisions = arm.weigh(UNTIL)
    assert decisions[-1].ended_by == "target" and decisions[-1].reason.startswith("sure: +-")
    assert abs(chooser.known.mass - 0.05) < 2e-3 and chooser.half <= UNTIL.half_interval
    assert all(decision.push is not None and decision.others for decision in decisions[:-1])
    # guesses and runs that differ count before the target does, and where there is no answer nothing is sure
    sequence = replace(load_sequence("payload_until", arm.robot), until=UNTIL)
    for answer, ended_by in ((1.5 * UNTIL.half_interval, ""), (None, "misfit")):
        again = UntilSure(
            arm.robot,
            paper_hand_facts(),
            sequence,
            lambda runs, half=answer: half,
        )
        assert again.next(arm.runs, arm.sample().position, 1.0).ended_by == ended_by
    from proprio_ros.report.choices_page import Choice, write_choices

    choices = [
        Choice(
            d.value, d.half, d.promised, d.reason, [push.words for push in d.others], d.decided_s
        )
        for d in decisions
    ]
    write_choices(choices, chooser.sought, UNTIL.half_interval, tmp_path / "choices.html")
    page = (tmp_path / "choices.html").read_text()
    assert (
        page.count('<svg class="chart" role') == 1
        and decisions[-1].reason in page
        and decisions[0].others[0].words in page
    )
    grams = re.search(
        r"<p class=value>([\d.]+) g</p>\s*<p class=interval>mass \+-[\d.]+ g \(95 %\) after (\d+) push",
        page,
    )
    assert grams is not None and float(grams[1]) == pytest.approx(
        1e3 * decisions[-1].value, abs=0.06
    )
    assert int(grams[2]) == len(decisions) - 1


@pytest.mark.long
def test_it_starts_near_a_limit_as_well() -> None:
    limit = ROBOT.model.joint("joint3").lower
    arm = hand(
        0.03,
        {"joint2": -1.0, "joint3": limit + 0.02, "joint4": 0.4},
    )
    chooser, decisions = arm.weigh(UNTIL)
    assert decisions[-1].ended_by == "target" and abs(chooser.known.mass - 0.03) < 2e-3


@pytest.mark.long
def test_a_heavy_object_is_weighed_as_well() -> None:
    chooser, decisions = hand(0.3).weigh(UNTIL)
    assert decisions[-1].ended_by == "target" and abs(chooser.known.mass - 0.3) < 4e-3


@pytest.mark.long
def test_joints_that_stick_are_said_to() -> None:
    arm = hand(0.05, coulomb=0.6)
    _, decisions = arm.weigh(UNTIL)
    assert (
        decisions[-1].ended_by == "stuck"
        and "moved nothing: the joint sticks" in decisions[-1].reason
    )
    assert arm.time_s < 50.0


@pytest.mark.long
def test_it_ends_when_time_is_over_and_when_nothing_is_worth_it() -> None:
    _, decisions = hand(0.05).weigh(Until(1e-6, "kg", 6.0))
    assert decisions[-1].ended_by == "time" and "the 6 s are over" in decisions[-1].reason
    _, decisions = hand(0.05).weigh(Until(5e-4, "kg", 600.0))
    assert (
        decisions[-1].ended_by == "worth" and "a tenth of what is missing" in decisions[-1].reason
    )


@pytest.mark.long
def test_a_push_tells_what_was_foreseen() -> None:
    """On a robot of another simulator, not calibrated: what is known after a push is what its linearisation said before."""
    from random_arm import EFFECTS_DEFAULT, GRIPPER, JOINTS, SPREAD, ball, draw_robot, record

    from proprio_ros.experiment_design.sequential import Catalogue

    rng = np.random.default_rng(5)
    hidden = draw_robot(rng, EFFECTS_DEFAULT, SPREAD)
    catalogue = Catalogue(ROBOT, paper_hand_facts())
    known = catalogue.nothing_known()
    runs = []
    promised: list[tuple[float, float]] = []
    for _ in range(4):
        push = catalogue.rank(known, lambda starts: np.full(len(starts), 2.0))[0]
        foreseen = catalogue.predicted(known, push)
        assert foreseen.std == pytest.approx(push.std, rel=0.02)
        recording = record(
            hidden, push.joint, {**push.start, GRIPPER: 0.0}, push.current_A, push.duration_s, ball(0.05, 0.04), rng,
            (push.shake_A, 0.2),
        )  # fmt: skip
        runs.append(cut_runs(recording, joints=[*JOINTS, GRIPPER])[0])
        known = catalogue.known(runs, known)
        promised.append((push.std, known.std))
    # the first is foreseen for no mass in particular
    assert all(0.6 < after / before < 1.5 for before, after in promised[1:]), promised


@pytest.mark.long
def test_what_a_calibration_should_push_further_can_be_pushed() -> None:
    sequence = load_sequence("empty_hand", ROBOT)
    for load_kg in (0.0, 0.1):
        runs = chosen_known(ROBOT, load_kg, 1e-4, 15.0, sequence)
        assert 3 <= len(runs) <= 8
        check_sequence(replace(sequence, runs=tuple(runs)), ROBOT)
    assert not chosen_known(ROBOT, 0.1, 0.1, 15.0, sequence), "100 g are known to 100 g already"
