"""The arm behind the virtual servos: current in, shaft angles out, simulated by MuJoCo.

It takes kinematics and inertias from the robot's model and everything else from a `Truth`, and shares no line with the
simulator that the identification uses. Each shaft obeys the law of `proprio_ros.robot.DriveTrain`, with dry friction as
MuJoCo's constraint, so that a joint sticks. A slide and its motor are one: position = transmission x shaft angle, force =
torque / transmission.

Not modelled: the table and any contact but inside what the hand holds, backlash, bending, and the limit that the supply
sets to the current at speed (the servos apply that one).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from proprio_ros.errors import ConfigurationError, SimulationError
from proprio_ros.records import FloatArray
from proprio_ros.robot import Joint, Robot
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.virtual.model import ArmModel
from proprio_ros.virtual.objects import HandObject
from proprio_ros.virtual.truth import Truth

LONGEST_SUBSTEP_S = 0.0005


class VirtualArm:
    """A robot arm without hardware.

    Attributes:
        joints: The driven joints, in the order of the robot file; the columns of all arrays.
        object: What the hand holds; None is nothing.
        mujoco: MuJoCo's module.
        model: The arm with its object in it.
        data: State of `model`.
        finger: Degree of freedom of the driven joint that slides; None: there is none.
        fingers: How many slide with it, itself among them.
        grip_m: Where it was when the object was put into the hand.
    """

    def __init__(
        self,
        robot: Robot,
        truth: Truth,
        *,
        position: Mapping[str, float] | None = None,
        seed: int = 0,
        control_period_s: float = 0.001,
    ) -> None:
        """Build the arm at rest.

        Args:
            robot: The arm as its file states it.
            truth: What it is really like.
            position: True joint positions at the start; where none is given, 0 or the limit next to it [rad or m].
            seed: Of the encoder noise.
            control_period_s: By so much a `step` advances [s].

        Raises:
            ConfigurationError: MuJoCo is missing or refuses the robot, the truth is of another robot, or a position lies
                outside its limits.
        """
        missing = [name for name in robot.drive_trains if name not in truth.joints]
        if missing:
            raise ConfigurationError(
                f"truth: says nothing of {', '.join(missing)} of {robot.name}; use Truth.draw(robot, seed)"
            )
        if not 0.0 < control_period_s < math.inf:
            raise ConfigurationError(
                f"the control period must be positive, got {control_period_s} s"
            )
        self.joints = tuple(robot.drive_trains)
        self.object: HandObject | None = None
        self.truth = truth
        self.robot = robot
        self._rng = np.random.default_rng(seed)
        self._substeps = math.ceil(control_period_s / LONGEST_SUBSTEP_S - 1e-9)
        self._substep_s = control_period_s / self._substeps

        joints = [truth.joints[name] for name in self.joints]

        def columns(*terms: str) -> FloatArray:
            """A row for each term, a column for each joint."""
            rows = [[getattr(joint, term) for joint in joints] for term in terms]
            return np.array(rows, float)

        self._transmission = np.array(
            [robot.drive_trains[name].transmission for name in self.joints]
        )
        drives = columns("torque_constant", "coulomb", "load_friction").T
        encoders = columns(
            "zero_rad", "once_per_turn_sin_rad", "once_per_turn_cos_rad", "encoder_noise_rad"
        ).T
        # as plain numbers: arrays of a few joints take longer to begin with than to compute
        self._drives = drives.tolist()
        self._encoders = encoders.tolist()
        self._drawn: list[list[float]] = []
        self._stribeck, self._stribeck_velocity = columns("stribeck", "stribeck_velocity")
        self._rises = bool(self._stribeck.any())
        self._velocity_before = np.zeros(len(self.joints))  # of the shafts, one substep ago
        self.grip_m = 0.0

        self._models = ArmModel(robot, truth, self._substep_s)
        self.mujoco = self._models.mujoco
        self._build(None)
        self.set_position(zero_pose(robot) | dict(position or {}))

    @property
    def time_s(self) -> float:
        """Time since the arm was built."""
        return float(self.data.time)

    def step(self, current_A: Sequence[float] | FloatArray) -> None:
        """Advance by one control period, all of which the motors' currents [A] flow, one for each joint.

        Raises:
            ConfigurationError: There is not one for each.
            SimulationError: A current, or a velocity after the step, is not finite.
        """
        if len(current_A) != len(self.joints):
            raise ConfigurationError(
                f"expected currents of {', '.join(self.joints)}, got {len(current_A)}"
            )
        if not math.isfinite(sum(current_A)):
            raise SimulationError(
                "the virtual arm was given a current that is not finite; check the servos' law"
            )
        force = self._force
        for current, (constant, coulomb, load), (_, dof, transmission) in zip(
            current_A, self._drives, self._rows, strict=True
        ):
            torque = constant * current
            force[dof] = torque / transmission
            self._friction[dof] = (coulomb + load * abs(torque)) / transmission
        acting = self.object if self.object is not None and self.object.acts else None
        if acting is not None or self._rises:
            driven = force.copy()
            friction = self._friction[self._dofs]
            for _ in range(self._substeps):
                if acting is not None:
                    force[:] = driven
                    acting.act(self, force)
                # the speed amid the step, or a constant over it would make the method first order
                velocity = self.velocity_rad_s()
                amid = 1.5 * velocity - 0.5 * self._velocity_before
                self._velocity_before = velocity
                excess = self._stribeck * np.exp(-((amid / self._stribeck_velocity) ** 2))
                self._friction[self._dofs] = friction * (1.0 + excess)
                self.mujoco.mj_step(self.model, self.data)
        else:
            self.mujoco.mj_step(
                self.model,
                self.data,
                self._substeps,
            )
        if not math.isfinite(self._qvel.dot(self._qvel)):
            raise SimulationError(
                f"the virtual arm diverged at {self.time_s:.3f} s: check that currents are in A, and build the arm anew"
            )

    def shaft_rad(self) -> FloatArray:
        """True angles of the output shafts [rad], shape (J,)."""
        return self._qpos[self._places] / self._transmission

    def velocity_rad_s(self) -> FloatArray:
        """True velocities of the output shafts [rad/s], shape (J,)."""
        return self._qvel[self._dofs] / self._transmission

    def sensed(self) -> tuple[list[float], list[float]]:
        """What the encoders read before they round [rad], with fresh noise each time; true velocities of the shafts [rad/s]."""
        places = self._qpos.tolist()
        velocities = self._qvel.tolist()
        if not self._drawn:
            self._drawn = self._rng.standard_normal((256, len(self.joints))).tolist()[::-1]
        angles = []
        for (place, _, transmission), (zero, sine, cosine, std), noise in zip(
            self._rows, self._encoders, self._drawn.pop(), strict=True
        ):
            true = places[place] / transmission
            angles.append(
                true - zero + sine * math.sin(true) + cosine * math.cos(true) + std * noise
            )
        return angles, [velocities[dof] / transmission for _, dof, transmission in self._rows]

    def encoder_rad(self) -> FloatArray:
        """What the encoders read before they round [rad], shape (J,); every call has fresh noise."""
        return np.array(self.sensed()[0])

    def position(self) -> dict[str, float]:
        """True positions of all joints that have one of their own [rad or m]."""
        return {name: float(self.data.qpos[place]) for name, place in self._place_of.items()}

    def set_position(self, position: Mapping[str, float]) -> None:
        """Put joints elsewhere [rad or m], and everything at rest; joints that are not named stay where they are.

        Raises `ConfigurationError`: A joint is unknown, or its position lies outside its limits.
        """
        for name, value in position.items():
            if name not in self._place_of:
                raise ConfigurationError(
                    f"no joint {name!r} can be placed; choose from: {', '.join(self._place_of)}"
                )
            joint = self.robot.model.joint(name)
            if not joint.lower <= value <= joint.upper or not math.isfinite(value):
                raise ConfigurationError(
                    f"{name} at {value:g}: give a position within {joint.lower:g} .. {joint.upper:g}"
                )
        for name, value in position.items():
            self.data.qpos[self._place_of[name]] = value
        self._follow()
        self.data.qvel[:] = 0.0
        self._velocity_before[:] = 0.0
        if self.object is not None:
            self.object.begin(self)

    def hold(self, held: HandObject | None) -> None:
        """Put an object into the hand, or take it out; the arm goes on as it moves.

        Raises `ConfigurationError`: The robot cannot hold it, or no body has the object's inertia. The arm is as before.
        """
        if held is not None:
            held.check(self)
        before = self.data
        places = self._arm_places
        dofs = self._arm_dofs
        self._build(held)
        self.data.time = before.time
        # what hangs in the hand has joints of its own among the arm's; a sphere's come behind them
        self.data.qpos[self._arm_places] = before.qpos[places]
        self.data.qvel[self._arm_dofs] = before.qvel[dofs]
        if self.finger is not None:
            self.grip_m = self.finger_m()
        if held is not None:
            held.begin(self)

    def finger_m(self) -> float:
        """Position of the driven finger [m]."""
        return float(self.data.qpos[self._place_of[self._finger_joint]])

    def _follow(self) -> None:
        """Put the joints that follow others where they belong."""
        joints = self.robot.model.joint
        places = self.data.qpos

        def position(joint: Joint) -> float:
            if joint.mimic is None:
                return float(places[self._place_of[joint.name]])
            source, multiplier, offset = joint.mimic
            return multiplier * position(joints(source)) + offset

        for joint in self.robot.model.joints:
            if joint.kind != "fixed":
                places[int(self.model.joint(joint.name).qposadr[0])] = position(joint)

    def _build(self, held: HandObject | None) -> None:
        """Take a model with what the hand holds; the arm is at zero then."""
        self.model = self._models.compiled(held)
        self.data = self.mujoco.MjData(self.model)
        self.object = held
        # the memory itself: asking for it takes as long as using it
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._force = self.data.qfrc_applied
        self._friction = self.model.dof_frictionloss
        self._look_up_places()

    def _look_up_places(self) -> None:
        """Where the joints are in the model's arrays: what hangs in the hand has joints of its own among the arm's."""
        robot = self.robot
        moving = [joint for joint in robot.model.joints if joint.kind != "fixed"]
        made = {joint.name: self.model.joint(joint.name) for joint in moving}
        places = {name: int(one.qposadr[0]) for name, one in made.items()}
        dofs = {name: int(one.dofadr[0]) for name, one in made.items()}
        self._place_of = {joint.name: places[joint.name] for joint in moving if not joint.mimic}
        self._places = np.array([places[name] for name in self.joints])
        self._dofs = np.array([dofs[name] for name in self.joints])
        transmission = self._transmission.tolist()
        self._rows = list(
            zip(self._places.tolist(), self._dofs.tolist(), transmission, strict=True)
        )
        self._arm_places = np.array(list(places.values()))
        self._arm_dofs = np.array(list(dofs.values()))
        slides = [name for name in self.joints if robot.model.joint(name).kind == "prismatic"]
        self._finger_joint = slides[0] if slides else ""
        self.finger = dofs.get(self._finger_joint)
        followers = [joint.mimic[0] for joint in moving if joint.mimic is not None]
        self.fingers = 1 + followers.count(self._finger_joint)
