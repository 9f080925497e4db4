"""What is inside: liquid, grains or one rigid thing in an upright cylinder, and how full it is."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

from proprio_ros.addons.contents.detail import UNKNOWNS
from proprio_ros.addons.contents.virtual_object import Filled
from proprio_ros.inputs.settings import Settings, probe_file
from proprio_ros.kinds import Kind
from proprio_ros.probes import base

if TYPE_CHECKING:
    from proprio_ros.addons.contents.models import ContentsFacts
    from proprio_ros.identification.estimate import Estimate
    from proprio_ros.robot import Robot


class Contents(base.HasBaseline["ContentsFacts"], base.Prepares["ContentsFacts"]):
    """An upright cylinder with something in it."""

    name = "contents"
    subject = "contents"
    answer = ("contents_mass", "kg")
    numbers = MappingProxyType(
        {"mass": "contents_mass", "fill": "fill", "liquid_inside": "liquid_inside"}
    )
    keys = ("contents.",)
    unknowns: ClassVar[Mapping[str, Kind]] = UNKNOWNS
    hand = "the filled container has to be upright in the hand"
    default_sequence = "contents"
    virtual_object = Filled
    prepares = "sloshing: once on a computer it is compiled, half a minute"
    baseline = base.Baseline(
        noun="empty container",
        hand="the container has to be in the hand with nothing in it",
        question="is the container empty?",
        missing="put it into the hand empty and call ~/record_contents_baseline, or state its mass (settings: contents.mass=KG)",
    )
    example = base.Example(
        help="of the liquid in it",
        truth=0.15,
        lowest=0.01,
        highest=0.5,
        held="filled:0.05,liquid={truth:g}",
        now="now there is a liquid in the container",
        was="the liquid in the virtual container weighed",
        takes="two minutes",
        sequences={"robot_sequence": "empty_hand_container"},
        stated=(
            "contents.radius=0.035",
            "contents.height=0.1",
            "contents.bottom=[0.015,0,-0.04]",
        ),
    )

    def facts(
        self, settings: Settings, solver: str = "lm", profile: str = "default"
    ) -> ContentsFacts:
        """What is stated of the container.

        Args:
            settings: The user's.
            solver: Not used: there is one.
            profile: Not used: there is one.

        Returns:
            Shape and mass of the container, over the defaults of the probe's file.

        Raises:
            ConfigurationError: A value of the wrong form or unit.
        """
        from proprio_ros.addons.contents.facts import contents_facts

        return contents_facts(settings, probe_file(self.name, ("contents",))["contents"])

    def needs_baseline(self, facts: ContentsFacts) -> bool:
        return facts.mass_std == float("inf")

    def baseline_settings(self, facts: ContentsFacts) -> dict[str, object]:
        from proprio_ros.probes.payload.facts import settings_of

        return settings_of(facts.shell)

    def compile(self, robot: Robot, facts: ContentsFacts) -> None:
        from proprio_ros.addons.contents.slosh import compile_kernels

        super().compile(robot, facts)
        compile_kernels(rises=robot.friction_rises)

    def identify(self, robot: Robot, recorded: base.Recorded, facts: ContentsFacts) -> Estimate:
        """Find what is in the container.

        Args:
            robot: As its file or its calibration states it.
            recorded: Runs, and those of the empty container.
            facts: Of the container.

        Returns:
            The mass of the contents first.

        Raises:
            ConfigurationError: Neither a baseline nor the container's mass.
            RecordingError: A run cannot be related to the robot, or does not move the container across its axis.
        """
        from proprio_ros.addons.contents.identify import find_contents

        return find_contents(robot, recorded.runs, facts, recorded.baseline)

    def sections(self, estimate: Estimate) -> list[str]:
        from proprio_ros.addons.contents.figures import sections

        return sections(estimate)
