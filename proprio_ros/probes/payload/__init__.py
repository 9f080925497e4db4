"""What the hand holds: a rigid payload of unknown mass, and its centre of mass where that is open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from proprio_ros.errors import ConfigurationError, RecordingError, TooLittleMotion
from proprio_ros.inputs.settings import Settings, probe_file
from proprio_ros.kinds import Kind
from proprio_ros.probes import base
from proprio_ros.virtual.objects import Payload as VirtualPayload

if TYPE_CHECKING:
    from proprio_ros.excitation.plans import ExcitationSequence
    from proprio_ros.experiment_design.choosing import Chooser
    from proprio_ros.identification.estimate import Estimate
    from proprio_ros.identification.regression.at_rest import StandingEstimator
    from proprio_ros.probes.payload.identify import WeighingOptions
    from proprio_ros.probes.payload.paper import PaperOptions
    from proprio_ros.records import Run
    from proprio_ros.robot import Robot
    from proprio_ros.sim.payload import PayloadFacts

LIVE_STARTS_KG = (0.01, 0.1)  # A live estimate need not find its way from two orders of magnitude.


@dataclass(frozen=True)
class PayloadJob:
    """One weighing: shape and place, how to solve, the paper's setting where its own method was asked for, and keys stated."""

    payload: PayloadFacts
    weighing: WeighingOptions
    paper: PaperOptions | None
    stated: frozenset[str]


class Payload(
    base.HasSolvers[PayloadJob],
    base.TakesMotions[PayloadJob],
    base.Online[PayloadJob],
    base.EstimatesLive[PayloadJob],
    base.ChoosesNext[PayloadJob],
    base.Shown[PayloadJob],
):
    """A rigid payload."""

    name = "payload"
    subject = "payload"
    answer = ("payload_mass", "kg")
    numbers = MappingProxyType({"mass": "payload_mass"})
    keys = ("payload.", "paper.")
    unknowns = MappingProxyType(
        {"equivalent_pendulum_length": Kind("m", "length of the equivalent pendulum")}
    )
    default_sequence = "payload"
    virtual_object = VirtualPayload
    solvers = ("lm", "adam", "cma")
    profiles = ("default", "paper")
    devices = ("cpu", "cuda")
    example = base.Example(
        help="of the object in the virtual hand", truth=0.05, held="{truth:g}",
        now="now something is in its hand", was="the virtual hand held", takes="under a minute",
        sequences={"robot_sequence": "empty_hand_elbow", "payload_sequence": "payload_elbow"}, stated=("payload.com=[0,0,0]",),
    )  # fmt: skip

    def facts(
        self,
        settings: Settings,
        solver: str = "lm",
        profile: str = "default",
    ) -> PayloadJob:
        """What is stated of the payload, and how it is weighed.

        Args:
            settings: The user's.
            solver: One of `solvers`.
            profile: One of `profiles`.
        """
        from proprio_ros.probes.payload.facts import payload_facts
        from proprio_ros.probes.payload.identify import WeighingOptions
        from proprio_ros.probes.payload.paper import PaperOptions

        defaults = probe_file(self.name, ("payload", "solver", "paper"))
        payload = payload_facts(settings, defaults["payload"])
        weighing = replace(
            settings.options(WeighingOptions, "solver.", defaults["solver"]), solver=solver
        )
        if profile == "paper" and weighing.device != "cpu":
            raise ConfigurationError(
                f"--device {weighing.device} is not there for --profile paper; leave it out"
            )
        paper = settings.options(PaperOptions, "paper.", defaults["paper"])
        return PayloadJob(
            payload, weighing, paper if profile == "paper" else None, frozenset(settings.taken)
        )

    def reference(self, settings: Settings) -> PayloadFacts:
        from proprio_ros.probes.payload.facts import payload_facts

        return payload_facts(settings, probe_file(self.name, ("payload",))["payload"])

    def identify(self, robot: Robot, recorded: base.Recorded, facts: PayloadJob) -> Estimate:
        """Weigh what runs or motions hold, or as the paper does where that was asked for.

        Args:
            robot: As its file or its calibration states it.
            recorded: With runs or motions.
            facts: Of the payload.
        """
        if recorded.motions:
            return self._identify_motions(robot, recorded, facts)
        from proprio_ros.probes.payload.identify import weigh_with_advice
        from proprio_ros.probes.payload.paper import as_published, identify_as_paper

        if facts.paper is None:
            return weigh_with_advice(
                robot, recorded.runs, facts.payload, facts.weighing, recorded.baseline
            )
        swings = [run.name for run in recorded.runs if run.is_free_response]
        if swings:
            raise RecordingError(
                f"{swings[0]} is a free swing; the paper's method wants a joint that a current drives"
            )
        text = recorded.text
        setting = (
            facts.paper if text is None else as_published(facts.paper, text.setting, facts.stated)
        )
        return identify_as_paper(robot, recorded.runs, facts.payload, setting)

    def _identify_motions(
        self, robot: Robot, recorded: base.Recorded, facts: PayloadJob
    ) -> Estimate:
        """Weigh what motions hold, by what is known of the arm: its joint, a baseline, a calibration."""
        from proprio_ros.probes.payload.known_joint import identify_known_joint
        from proprio_ros.probes.payload.moving import identify_in_motion
        from proprio_ros.probes.payload.one_joint import identify_one_joint
        from proprio_ros.probes.payload.standing import identify_standing

        motions = recorded.motions
        baseline = recorded.baseline_motions
        if facts.paper is not None:
            raise RecordingError(
                f"{motions[0].name}: is a motion under a controller; the paper's method wants a joint driven from rest"
            )
        if robot.joint_calibration is not None:
            if baseline:
                why = "a joint that was calibrated with known loads takes no --baseline"
                raise RecordingError(f"{baseline[0].name}: {why}")
            return identify_known_joint(robot, motions, robot.joint_calibration, facts.payload)
        if len(motions[0].joints) == 1:
            return identify_one_joint(robot, motions, baseline, facts.payload)
        asked = robot, motions, baseline, facts.payload, "payload.com" in facts.stated
        try:
            return identify_in_motion(*asked)
        except TooLittleMotion:
            if robot.motion_calibration is None:
                raise
            return identify_standing(*asked, robot.motion_calibration)

    def identify_so_far(
        self,
        robot: Robot,
        runs: Sequence[Run],
        facts: PayloadJob,
    ) -> Estimate:
        """Weigh what the runs so far hold, from fewer guesses.

        Args:
            robot: As its file or its calibration states it.
            runs: So far.
            facts: Of the payload.
        """
        from proprio_ros.probes.payload.identify import weigh

        return weigh(robot, runs, facts.payload, replace(facts.weighing, starts_kg=LIVE_STARTS_KG))

    def chooser(
        self,
        robot: Robot,
        facts: PayloadJob,
        sequence: ExcitationSequence,
        baseline: Sequence[Run] = (),
    ) -> Chooser:
        """What chooses the pushes of a weighing until it is sure.

        Args:
            robot: As its file or its calibration states it.
            facts: Of the payload.
            sequence: With an `until`.
            baseline: Not used: the payload alone is sought.
        """
        from proprio_ros.experiment_design.until import UntilSure
        from proprio_ros.quantity import Z95

        def whole(runs: Sequence[Run]) -> float | None:
            std = self.identify_so_far(robot, runs, facts).values[0].std
            return Z95 * std if isinstance(std, float) else None

        return UntilSure(robot, facts.payload, sequence, whole)

    def running(
        self,
        robot: Robot,
        facts: PayloadJob,
        held: dict[str, float],
    ) -> StandingEstimator:
        """What estimates the payload while the arm moves.

        Args:
            robot: With a calibration of motions.
            facts: Where the payload's centre is.
            held: Positions of joints that are not recorded [rad or m].
        """
        from proprio_ros.identification.regression.at_rest import StandingEstimator
        from proprio_ros.identification.regression.online import CENTRE_STD_M

        assert robot.motion_calibration is not None
        centre_m = [float(axis) for axis in facts.payload.com]
        std_m = float(max(facts.payload.com_std)) or CENTRE_STD_M
        return StandingEstimator(
            robot, robot.motion_calibration, centre_m=centre_m, centre_std_m=std_m, held=held
        )

    def load(self, facts: PayloadJob, mass_kg: float) -> base.Carried:
        from proprio_ros.probes.payload.facts import inertia_tensor

        payload = facts.payload
        source = "assumed" if payload.shape_std_relative > 0.0 else "stated"
        centre_m = [float(axis) for axis in payload.com]
        return base.Carried(
            mass_kg, centre_m, inertia_tensor(payload, mass_kg), payload.com_guessed, source
        )

    def carried(self, facts: PayloadJob, estimate: Estimate) -> base.Carried | None:
        import numpy as np

        mass = estimate.values[0].value
        if not isinstance(mass, float):
            return None
        load = self.load(facts, mass)
        centre = self._found_centre(estimate)
        if centre is not None:
            load = replace(load, com_m=centre, com_guessed=False)
        found = next(
            (value.value for value in estimate.values if value.name == "payload_inertia"), None
        )
        if not isinstance(found, list) or None in found:
            return load
        xx, xy, xz, yy, yz, zz = found
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return replace(load, inertia_kg_m2=tensor, inertia_is="identified")

    def shapes(
        self,
        robot: Robot,
        facts: PayloadJob,
        estimate: Estimate,
    ) -> base.Shapes | None:
        """The ball of water that weighs as much; None without a mass.

        Args:
            robot: Whose hand holds it.
            facts: Of the payload.
            estimate: Its mass and, where it was found, its centre.
        """
        import numpy as np

        mass = estimate.values[0].value
        if not isinstance(mass, float):
            return None
        # the ball of water that weighs as much
        size = max(
            (6.0 * max(mass, 1e-4) / (1000.0 * np.pi)) ** (1.0 / 3.0),
            0.01,
        )
        centre = self._found_centre(estimate) or [float(axis) for axis in facts.payload.com]
        return base.Shapes(
            centre,
            [
                base.Body(
                    "sphere",
                    [size] * 3,
                    np.eye(3),
                    0.7,
                )
            ],
        )

    @staticmethod
    def _found_centre(estimate: Estimate) -> list[float] | None:
        """Centre of mass [m], where all three of its coordinates were identified."""
        found = next(
            (value.value for value in estimate.values if value.name == "payload_com"), None
        )
        known = [axis for axis in found if axis is not None] if isinstance(found, list) else []
        return known if len(known) == 3 else None
