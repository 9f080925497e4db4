"""What a virtual robot hides: the numbers that the identification has to find out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.quantity import Quantity
from proprio_ros.robot import DriveTrain, Robot

ALIKE = 0.03
OFF_TOGETHER = 0.3
"""Torque constants of servos of one type, in one arm, differ by the first from each other; and all together from the robot file by
that share of what it leaves open, which allows for other gears and supplies, too."""
# from a command on the bus to the motor's torque
FASTEST_LATENCY_S = 0.002
SLOWEST_LATENCY_S = 0.006


@dataclass(frozen=True)
class JointTruth:
    """One motor with its gears and encoder, at the output shaft; the law is that of `proprio_ros.robot.DriveTrain`."""

    torque_constant: float  # [N m/A]
    coulomb: float = 0.0  # dry friction without load [N m]
    viscous: float = 0.0  # [N m s/rad]
    load_friction: float = 0.0  # part of the motor's torque that adds to the dry friction
    armature: float = 0.0  # [kg m^2]
    zero_rad: float = 0.0  # true position minus reading
    stribeck: float = 0.0  # by how much of itself dry friction is greater at rest
    stribeck_velocity: float = 0.1  # speed at which 1/e of that is left [rad/s]
    # the reading is too large by this times the sine of the position
    once_per_turn_sin_rad: float = 0.0
    once_per_turn_cos_rad: float = 0.0  # and by this times its cosine
    encoder_noise_rad: float = 0.0  # standard deviation of a reading before rounding


@dataclass(frozen=True)
class LinkTruth:
    """How one link departs from the URDF."""

    mass: float = 0.0  # relative, its inertia with it: 0.01 is one per cent too heavy
    # shift of the centre of mass in the link's frame
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: float = 0.0  # relative, about the centre of mass, beyond that of the mass


@dataclass(frozen=True)
class Truth:
    """A virtual robot's hidden numbers."""

    joints: Mapping[str, JointTruth]  # by driven joint
    latency_s: float = 0.0  # from a command to its torque; the servos apply it, the arm does not
    arm_scale: float = 1.0  # all masses of the URDF times this
    # those not named are as in the URDF
    links: Mapping[str, LinkTruth] = field(default_factory=dict)

    @classmethod
    def nominal(cls, robot: Robot) -> Truth:
        """The robot file's values exactly; its encoders make no once-per-turn error."""
        joints = {}
        for name, drive in robot.drive_trains.items():
            terms = {term: getattr(drive, term).value for term in _TERMS}
            joints[name] = JointTruth(
                **terms, zero_rad=drive.zero.value, encoder_noise_rad=drive.encoder_noise
            )
        return cls(
            joints,
            max(robot.delay.value, 0.0),
            robot.arm_scale.value,
        )

    @classmethod
    def draw(
        cls,
        robot: Robot,
        seed: int,
        *,
        links: bool = False,
        stribeck: bool = False,
    ) -> Truth:
        """Draw a robot from what its file leaves open.

        Friction that the file gives as zero with a standard deviation is one-sided: it is drawn uniformly from a part
        of that deviation (Coulomb 0.3 to 0.9, viscous 0.1 to 0.6, with the load 0 to 0.6 of it), so that no joint is
        stuck for good. Everything else is normal, and cut off where it would make no sense. Where voltages drive the
        motors, an arm's torque constants are off together by 0.3 of what the file leaves open, and each by 3 % more.

        Args:
            robot: The arm as its file states it.
            seed: The same seed gives the same motors, whatever else is drawn.
            links: Whether masses, centres and inertias of links, and the scale of all, depart from the URDF.
            stribeck: Whether dry friction is greater at rest.

        Returns:
            The hidden numbers.
        """
        draw = _Draw(robot, seed)
        joints = {
            name: draw.joint(drive, stribeck=stribeck) for name, drive in robot.drive_trains.items()
        }
        latency_s = float(draw.motors.uniform(FASTEST_LATENCY_S, SLOWEST_LATENCY_S))
        if not links:
            return cls(joints, latency_s, robot.arm_scale.value)
        scale = float(draw.bodies.normal(robot.arm_scale.value, robot.arm_scale.std))
        return cls(
            joints,
            latency_s,
            max(scale, 0.5),
            draw.links(),
        )

    def as_json(self) -> str:
        """As the text of a JSON file."""
        return json.dumps(asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str) -> Truth:
        """Read what `as_json` wrote. Raises `ConfigurationError`: It is no JSON, or no truth."""
        try:
            given: dict[str, Any] = json.loads(text)
            joints = {name: JointTruth(**values) for name, values in given.pop("joints").items()}
            links = {}
            for name, values in given.pop("links", {}).items():
                centre = tuple(values["com_m"])
                links[name] = LinkTruth(**{**values, "com_m": centre})
            return cls(joints=joints, links=links, **given)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ConfigurationError(
                f"truth: {error}; write such a file with Truth.draw(robot, seed).as_json()"
            ) from error


_TERMS = (
    "torque_constant",
    "coulomb",
    "viscous",
    "load_friction",
    "armature",
    "stribeck",
    "stribeck_velocity",
)


class _Draw:
    """Draws of one robot, from streams that do not depend on what else is drawn."""

    def __init__(self, robot: Robot, seed: int) -> None:
        self._robot = robot
        self.motors = np.random.default_rng((seed, 0))
        self.bodies = np.random.default_rng((seed, 1))
        self._excess = np.random.default_rng((seed, 2))
        # by how much all torque constants are off, in standard deviations
        self._together = float(np.random.default_rng((seed, 3)).normal())

    def joint(self, drive: DriveTrain, *, stribeck: bool) -> JointTruth:
        """One motor; the order of the draws is part of what a seed means."""
        excess = abs(float(self._excess.normal(drive.stribeck.value, drive.stribeck.std)))
        slowest = drive.stribeck_velocity
        excess_velocity = float(self._excess.normal(slowest.value, slowest.std))
        armature = drive.armature
        return JointTruth(
            torque_constant=self._torque_constant(drive),
            coulomb=self._friction(drive.coulomb, 0.3, 0.9),
            viscous=self._friction(drive.viscous, 0.1, 0.6),
            load_friction=self._friction(drive.load_friction, 0.0, 0.6),
            armature=max(self._normal(armature.value, armature.std), 0.4 * armature.value),
            zero_rad=self._normal(drive.zero.value, drive.zero.std),
            stribeck=excess if stribeck else 0.0,
            stribeck_velocity=max(excess_velocity, 0.3 * slowest.value),
            once_per_turn_sin_rad=self._normal(0.0, drive.encoder_once_per_turn),
            once_per_turn_cos_rad=self._normal(0.0, drive.encoder_once_per_turn),
            encoder_noise_rad=drive.encoder_noise,
        )

    def _normal(self, mean: float, std: float) -> float:
        return float(self.motors.normal(mean, std))

    def _torque_constant(self, drive: DriveTrain) -> float:
        constant = drive.torque_constant
        least = 0.5 * constant.value
        if drive.driven_by is None:
            return max(self._normal(constant.value, constant.std), least)
        mean = max(constant.value + OFF_TOGETHER * self._together * constant.std, least)
        return max(self._normal(mean, ALIKE * constant.value), least)

    def _friction(self, known: Quantity, low: float, high: float) -> float:
        if known.value > 0.0:
            return max(self._normal(known.value, known.std), 0.0)
        return float(self.motors.uniform(low, high)) * float(known.std)

    def links(self) -> dict[str, LinkTruth]:
        """All links that have a mass."""
        robot = self._robot
        departures = {}
        for link in robot.model.links:
            if link.pseudo_inertia[3, 3] > 0.0:
                x, y, z = self.bodies.normal(0.0, robot.link_com_std, 3).tolist()
                mass = float(self.bodies.normal(0.0, robot.link_mass_std))
                inertia = float(self.bodies.normal(0.0, robot.link_inertia_std))
                departures[link.name] = LinkTruth(
                    mass=max(mass, -0.5), com_m=(x, y, z), inertia=max(inertia, -0.5)
                )
        return departures
