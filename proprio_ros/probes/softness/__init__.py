"""How soft it is: the elastic moduli of a block between the fingers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from proprio_ros.errors import ConfigurationError
from proprio_ros.inputs.settings import Settings, probe_file
from proprio_ros.kinds import Kind
from proprio_ros.probes import base
from proprio_ros.probes.softness.virtual_object import SoftBlock

if TYPE_CHECKING:
    import numpy as np

    from proprio_ros.excitation.plans import ExcitationSequence
    from proprio_ros.experiment_design.choosing import Chooser
    from proprio_ros.identification.estimate import Estimate
    from proprio_ros.probes.softness.identify import SqueezeOptions
    from proprio_ros.probes.softness.problem import BlockFacts
    from proprio_ros.records import Run
    from proprio_ros.robot import Robot

LIMIT = "largest_squeeze"
GAP_M = 0.0005  # from the fingers to the block of the demo


@dataclass(frozen=True)
class SoftnessJob:
    """One block: what is stated about it, and how to solve."""

    block: BlockFacts
    solving: SqueezeOptions


class Softness(
    base.HasTable[SoftnessJob],
    base.Prepares[SoftnessJob],
    base.Guards[SoftnessJob],
    base.ChoosesNext[SoftnessJob],
    base.Shown[SoftnessJob],
):
    """A soft block between the fingers."""

    name = "softness"
    subject = "block"
    answer = ("youngs_modulus", "Pa")
    numbers = MappingProxyType(
        {name: name for name in ("youngs_modulus", "lame_mu", "lame_lambda")}
    )
    keys = ("block.",)
    unknowns: ClassVar[Mapping[str, Kind]] = {
        "youngs_modulus": Kind("Pa", "Young's modulus"),
        "poissons_ratio": Kind("1", "Poisson's ratio"),
        "lame_mu": Kind("Pa", "Lam\u00e9's mu"),
        "lame_lambda": Kind("Pa", "Lam\u00e9's lambda"),
        "secant_stiffness": Kind("N/m", "secant stiffness"),
        LIMIT: Kind("1", "largest squeeze"),
        "block_relaxation": Kind("s", "relaxation time of the block"),
        "block_loss": Kind("1", "loss of the block"),
        "gap": Kind("m", "closing before the touch", "run"),
    }
    hand = "the block has to be between the fingers"
    default_sequence = "softness"
    virtual_object = SoftBlock
    prepares = "a block: a shape is tabulated once, up to half a minute"
    refusal = "A softness_sequence that may squeeze the block further, as a share of its length, is refused."
    limits = (base.Limit(LIMIT, 0.4, refusal, 0.01, 0.95),)
    asked = (
        base.Asked(
            "block_size",
            "block.size",
            "Size of the block x, y, z [m], x along the squeeze; empty: 0.03 each, a guess: the answer is +-35 %.",
        ),
    )
    example = base.Example(
        flag="modulus", metavar="PA", help="Young's modulus of the block", truth=12e3, lowest=100.0, highest=1e7,
        units="moduli are in Pa, foam has 1e3 to 1e5",
        held=f"block:{{truth:g}},gap={GAP_M:g}",
        now="now a block of 30 mm is between its fingers",
        was="Young's modulus of the virtual block was",
        takes="under a minute",
        sequences={"robot_sequence": "empty_hand_gripper"},
        reference=False,  # nothing that the gripper does moves a weight
        stated=("block.size=0.03",),
    )  # fmt: skip

    def facts(
        self, settings: Settings, solver: str = "lm", profile: str = "default"
    ) -> SoftnessJob:
        """What is stated of the block, and how its moduli are sought.

        Args:
            settings: The user's.
            solver: One of `solvers`.
            profile: One of `profiles`.
        """
        from proprio_ros.probes.softness.facts import block_facts
        from proprio_ros.probes.softness.identify import SqueezeOptions

        defaults = probe_file(self.name, ("block", "solver"))
        block = block_facts(settings, defaults["block"])
        return SoftnessJob(block, settings.options(SqueezeOptions, "solver.", defaults["solver"]))

    def check(
        self,
        robot: Robot,
        facts: SoftnessJob,
        sequence: ExcitationSequence,
        limits: Mapping[str, float],
    ) -> None:
        """Refuse a sequence that drives another joint than a finger's, or may squeeze the block too far.

        Args:
            robot: As its file or its calibration states it.
            facts: Of the block.
            sequence: Whose runs squeeze.
            limits: By name, that of a squeeze among them.

        Raises:
            ConfigurationError: It does.
        """
        joint, *others = {run.joint for run in sequence.runs}
        if others or robot.model.joint(joint).kind != "prismatic":
            raise ConfigurationError(
                f"{sequence.name} drives {', '.join([joint, *others])}: squeeze with a joint that slides a finger"
            )
        squeeze = largest_squeeze(
            robot, joint, max(run.max_travel for run in sequence.runs), facts.block
        )
        if squeeze > limits[LIMIT]:
            raise ConfigurationError(
                f"{sequence.name} may squeeze a block of {1e3 * facts.block.length:g} mm by {100.0 * squeeze:.0f} %, more than "
                f"{LIMIT}={limits[LIMIT]:g}: state its size (settings: block.size=[x,y,z]), lower max_travel in the sequence, or "
                f"raise {LIMIT}"
            )

    def compile(self, robot: Robot, facts: SoftnessJob) -> None:
        from proprio_ros.sim.squeeze import compile_kernels

        super().compile(robot, facts)
        compile_kernels(facts.solving.integrator, rises=robot.friction_rises)

    def prepare(self, robot: Robot, facts: SoftnessJob) -> None:
        """Kernels and the table of the block's response: half a minute for a shape of block whose faces stick, the first time."""
        super().prepare(robot, facts)
        facts.block.table()

    def rebuild_table(self, facts: SoftnessJob) -> tuple[dict[str, Any], str]:
        from proprio_ros.sim.response import kept_at

        block = facts.block
        table = block.table(rebuild=True)
        squeezes = (0.1, 0.2, 0.3)
        ratios = (0.1, 0.3, 0.45)
        # force over E A: what a Young's modulus has to be multiplied with
        phi = [table(squeezes, ratio)[0].tolist() for ratio in ratios]
        content = {
            "file": str(kept_at(table.made_of)), "size_m": block.size.tolist(), "area_m2": block.area, "law": block.law,
            "contact": block.contact, "reach": table.reach, "squeeze": squeezes, "poissons_ratio": ratios, "force_per_E_A": phi,
        }  # fmt: skip
        edges = " x ".join(f"{1e3 * edge:.4g}" for edge in block.size)
        lines = [
            f"block of {edges} mm, faces {block.contact}, law {block.law}, squeezed by up to {100.0 * table.reach:.0f} %",
            "force over E A at a squeeze of"
            + "".join(f"{100.0 * squeeze:8.0f} %" for squeeze in squeezes),
        ]
        for ratio, row in zip(ratios, phi, strict=True):
            lines.append(
                f"  Poisson's ratio {ratio:<12g}" + "".join(f"{value:10.4f}" for value in row)
            )
        return content, "\n".join(lines)

    def chooser(
        self,
        robot: Robot,
        facts: SoftnessJob,
        sequence: ExcitationSequence,
        baseline: Sequence[Run] = (),
    ) -> Chooser:
        """What chooses the squeezes of a block until its modulus is sure.

        Args:
            robot: As its file or its calibration states it.
            facts: Of the block.
            sequence: With an `until`.
            baseline: Closings of the empty gripper, which count where it is asked whether all is sure.
        """
        from proprio_ros.probes.softness.choosing import SqueezesUntilSure
        from proprio_ros.quantity import Z95

        def whole(runs: Sequence[Run]) -> float | None:
            modulus = self.identify(robot, base.Recorded(runs, baseline), facts).value(
                "youngs_modulus"
            )
            if not isinstance(modulus.value, float) or not isinstance(modulus.std, float):
                return None
            return Z95 * modulus.std / modulus.value

        return SqueezesUntilSure(robot, facts.block, facts.solving, sequence, whole)

    def identify(self, robot: Robot, recorded: base.Recorded, facts: SoftnessJob) -> Estimate:
        """Find the block's elastic moduli.

        Args:
            robot: As its file or its calibration states it.
            recorded: Closings on the block, and of the empty gripper.
            facts: Of the block.
        """
        from proprio_ros.probes.softness.identify import find_softness

        return find_softness(robot, recorded.runs, facts.block, facts.solving, recorded.baseline)

    def sections(self, estimate: Estimate) -> list[str]:
        from proprio_ros.probes.softness.figures import sections

        return sections(estimate)

    def remark(self, estimate: Estimate) -> str:
        from proprio_ros.quantity import Z95

        ratio = estimate.value("poissons_ratio")
        if isinstance(ratio.value, float) and isinstance(ratio.std, float):
            return f", Poisson's ratio {ratio.value:.2f} +- {Z95 * ratio.std:.2f}"
        return ", Poisson's ratio not determined"

    def shapes(
        self,
        robot: Robot,
        facts: SoftnessJob,
        estimate: Estimate,
    ) -> base.Shapes | None:
        """The block between the fingers.

        Args:
            robot: Whose fingers hold it.
            facts: Of the block.
            estimate: Whose first run says which joint slides the finger.
        """
        rotation = block_rotation(robot, estimate.run_fits[0].joint)
        return base.Shapes(
            [0.0, 0.0, 0.0],
            [
                base.Body(
                    "box",
                    facts.block.size.tolist(),
                    rotation,
                    0.6,
                )
            ],
        )


def largest_squeeze(robot: Robot, joint: str, travel_m: float, facts: BlockFacts) -> float:
    """How far a block is squeezed, relative to its length, when a finger that touches it goes on by so much, as published.

    Args:
        robot: As its file or its calibration states it.
        joint: Of the finger.
        travel_m: How far it goes on when it touches the block [m].
        facts: Of the block.
    """
    drive = robot.drive_trains[joint]
    measured = drive.finger_travel
    steepest = (
        1.0
        if measured is None
        else float(measured.ratio_at(measured.at_rad).max()) / drive.transmission
    )
    return facts.fingers * steepest * travel_m / facts.length


def block_rotation(robot: Robot, joint: str) -> np.ndarray:
    """How a block lies between the fingers: its x along the joint's axis; in the payload's frame, shape (3, 3)."""
    import numpy as np

    pose = dict.fromkeys(robot.model.independent_joints, 0.0)
    moved = robot.model.joint(joint)
    hand = robot.model.frame_transform(robot.payload_frame, pose)[:3, :3]
    carrier = robot.model.frame_transform(moved.parent, pose)[:3, :3] @ moved.origin[:3, :3]
    along = hand.T @ carrier @ moved.axis
    across = np.cross(
        along,
        np.eye(3)[np.argmin(np.abs(along))],
    )
    across /= np.linalg.norm(across)
    return np.stack(
        [along, across, np.cross(along, across)],
        axis=1,
    )
