"""What is in the box: the mass of a sphere that rolls in a closed container."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.settings import Settings, probe_file
from proprio_ros.kinds import Kind
from proprio_ros.probes import base
from proprio_ros.probes.container.virtual_object import Container as VirtualContainer

if TYPE_CHECKING:
    from proprio_ros.excitation.plans import ExcitationSequence
    from proprio_ros.experiment_design.choosing import Chooser
    from proprio_ros.identification.estimate import Estimate
    from proprio_ros.probes.container.problem import ContainerFacts
    from proprio_ros.probes.container.search import ContainerOptions
    from proprio_ros.records import Run
    from proprio_ros.robot import Robot


@dataclass(frozen=True)
class ContainerJob:
    """One container: what is stated about it, how to solve, topic or CSV file with places of the sphere, and their std [m]."""

    container: ContainerFacts
    solving: ContainerOptions
    camera: str | None
    camera_std: float


class Container(
    base.HasBaseline[ContainerJob],
    base.Prepares[ContainerJob],
    base.Guards[ContainerJob],
    base.ChoosesNext[ContainerJob],
    base.Shown[ContainerJob],
):
    """A closed container with a sphere in it."""

    name = "container"
    subject = "sphere"
    answer = ("sphere_mass", "kg")
    numbers = MappingProxyType({"mass": "sphere_mass", "sphere_mass": "sphere_mass"})
    keys = ("container.", "sphere.", "contact.")
    unknowns: ClassVar[Mapping[str, Kind]] = {
        "container_mass": Kind("kg", "container mass"),
        "sphere_mass": Kind("kg", "sphere mass"),
        **{f"sphere_{axis}": Kind("m", f"start of the sphere, {axis}", "run") for axis in "xyz"},
        "contact_damping": Kind("1", "damping ratio of a touch"),
        "contact_friction": Kind("1", "friction between sphere and walls"),
    }
    hand = "the container has to be in the hand with its sphere"
    default_sequence = "container"
    virtual_object = VirtualContainer
    prepares = "a sphere: once on a computer it is compiled, half a minute"
    baseline = base.Baseline(
        noun="empty container",
        hand="the container has to be in the hand without its sphere",
        question="is the container empty?",
        missing="put it into the hand without its sphere and call ~/record_container_baseline, or state its mass (settings: "
        "container.mass=KG)",
    )
    example = base.Example(
        help="of the sphere in it", truth=0.012, held="container:0.03,sphere={truth:g}",
        now="now there is a sphere in the container", was="the sphere in the virtual container weighed", takes="two minutes",
        sequences={"robot_sequence": "empty_hand_container"},  # the wrist moves it, too
        stated=("container.inner_size=[0.06,0.04,0.04]", "container.centre=[0.035,0,0]", "sphere.radius=0.01"),
    )  # fmt: skip

    def facts(
        self, settings: Settings, solver: str = "lm", profile: str = "default"
    ) -> ContainerJob:
        """What is stated of container and sphere, and how the sphere is sought.

        Args:
            settings: The user's.
            solver: One of `solvers`.
            profile: One of `profiles`.
        """
        from proprio_ros.probes.container.facts import FORMS, container_facts
        from proprio_ros.probes.container.search import ContainerOptions

        defaults = probe_file(self.name, ("container", "sphere", "contact", "solver"))
        container = container_facts(settings, defaults)
        solving = settings.options(ContainerOptions, "solver.", defaults["solver"])
        camera, std = (
            settings.take(f"sphere.{key}", defaults["sphere"].get(key), FORMS[f"sphere.{key}"])
            for key in ("camera", "camera_std")
        )
        return ContainerJob(container, solving, camera, std)

    def check_live(self, facts: ContainerJob) -> None:
        if facts.camera is not None:
            raise ConfigurationError(
                "sphere.camera: the identifier records no camera; record its topic beside it and give both to `proprio replay`"
            )

    def needs_baseline(self, facts: ContainerJob) -> bool:
        return facts.container.mass_std == float("inf")

    def baseline_settings(self, facts: ContainerJob) -> dict[str, object]:
        from proprio_ros.probes.payload.facts import settings_of

        return settings_of(facts.container.shell)

    def compile(self, robot: Robot, facts: ContainerJob) -> None:
        from proprio_ros.sim.sphere import compile_kernels

        super().compile(robot, facts)
        shape = facts.container.enclosure.shape
        law = facts.container.law
        compile_kernels(shape, law, facts.solving.integrator, rises=robot.friction_rises)

    def chooser(
        self,
        robot: Robot,
        facts: ContainerJob,
        sequence: ExcitationSequence,
        baseline: Sequence[Run] = (),
    ) -> Chooser:
        """What chooses the pushes of a container until its sphere's mass is sure.

        Args:
            robot: As its file or its calibration states it.
            facts: Of container and sphere.
            sequence: With an `until`.
            baseline: Runs with the empty container.
        """
        from proprio_ros.probes.container.choosing import SphereUntilSure
        from proprio_ros.probes.container.identify import find_sphere, half_of

        def whole(runs: Sequence[Run]) -> float | None:
            return half_of(find_sphere(robot, runs, facts.container, facts.solving, baseline))

        return SphereUntilSure(robot, facts.container, facts.solving, sequence, baseline, whole)

    def identify(self, robot: Robot, recorded: base.Recorded, facts: ContainerJob) -> Estimate:
        """Find the sphere's mass.

        Args:
            robot: As its file or its calibration states it.
            recorded: Runs, and those of the empty container.
            facts: Of container and sphere.
        """
        from proprio_ros.probes.container.facts import track_of
        from proprio_ros.probes.container.identify import find_sphere

        sources = zip(recorded.runs, recorded.sources, strict=True)
        tracks = [track_of(run, source, facts.camera, facts.camera_std) for run, source in sources]
        return find_sphere(
            robot, recorded.runs, facts.container, facts.solving, recorded.baseline, tracks
        )

    def sections(self, estimate: Estimate) -> list[str]:
        from proprio_ros.probes.container.figures import sections

        return sections(estimate)

    def shapes(
        self,
        robot: Robot,
        facts: ContainerJob,
        estimate: Estimate,
    ) -> base.Shapes | None:
        """The container, with a sphere in its middle.

        Args:
            robot: Not used.
            facts: Of container and sphere.
            estimate: Not used, wherever the sphere was.
        """
        import numpy as np

        container = facts.container
        enclosure = facts.container.enclosure
        sphere = base.Body(
            "sphere",
            [2.0 * enclosure.radius] * 3,
            np.eye(3),
            0.9,
        )
        walls = base.Body(
            enclosure.shape,
            enclosure.inner_size.tolist(),
            container.rotation,
            0.25,
        )
        return base.Shapes(container.centre.tolist(), [sphere, walls])
