"""The arm behind the virtual servos: current in, shaft angles out, simulated by MuJoCo.

It takes kinematics and inertias from the robot's model and everything else from a `Truth`, and shares no line with the
simulator that the identification uses. Each shaft obeys the law of `proprio_ros.robot.DriveTrain`, with dry friction as
MuJoCo's constraint, so that a joint sticks. A slide and its motor are one: position = transmission x shaft angle, force =
torque / transmission.

Not modelled: the table and any contact but that of a sphere with its container, backlash, bending, and the limit that the supply
sets to the current at speed (the servos apply that one).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError, SimulationError
from proprio_ros.records import FloatArray
from proprio_ros.robot import Joint, Robot
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.virtual.objects import Container, HandObject, HungPayload, Payload, SoftBlock
from proprio_ros.virtual.truth import LinkTruth, Truth

LONGEST_SUBSTEP_S = 0.0005
STICKING_SOLREF = (0.001, 1.0)
STICKING_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""MuJoCo's constraints are soft: with these a stuck joint creeps at 1e-4 of its acceleration times half a millisecond."""
SOLVER_TOLERANCE = 1e-14
LIMIT_SOLREF = (0.004, 1.0)
CONTACT_SOLREF = (0.002, 1.0)
WALL_M = 0.05
"""Walls are this thick to the outside, so that a fast sphere cannot pass them in one step."""
LEVEL = 0.02
"""A floor that is tilted less than this holds the sphere in its middle [rad]."""


class VirtualArm:
    """A robot arm without hardware.

    Attributes:
        joints: The driven joints, in the order of the robot file; the columns of all arrays.
        object: What the hand holds; None is nothing.
        truth: The hidden numbers.
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
            robot: Its model, gravity and transmissions.
            truth: Its hidden numbers.
            position: True joint positions at the start [rad or m]; 0, or the limit next to it, where none is given.
            seed: Of the encoder noise.
            control_period_s: What one `step` advances.

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
            raise ConfigurationError(f"the control period must be positive, got {control_period_s} s")
        self.joints = tuple(robot.drive_trains)
        self.object: HandObject | None = None
        self.truth = truth
        self._robot = robot
        self._rng = np.random.default_rng(seed)
        self._substeps = math.ceil(control_period_s / LONGEST_SUBSTEP_S - 1e-9)
        self._substep_s = control_period_s / self._substeps

        def column(term: str) -> FloatArray:
            return np.array([getattr(truth.joints[name], term) for name in self.joints], dtype=np.float64)

        self._transmission = np.array([robot.drive_trains[name].transmission for name in self.joints])
        self._torque_constant, self._zero = column("torque_constant"), column("zero_rad")
        self._coulomb, self._load_friction = column("coulomb"), column("load_friction")
        self._stribeck, self._stribeck_velocity = column("stribeck"), column("stribeck_velocity")
        self._turn_sin, self._turn_cos = column("once_per_turn_sin_rad"), column("once_per_turn_cos_rad")
        self._encoder_noise = column("encoder_noise_rad")
        self._rises = bool(self._stribeck.any())
        self._velocity_before = np.zeros(len(self.joints))  # of the shafts, one substep ago
        self._touch_m = 0.0  # where the driven finger touches the block

        self._mujoco = import_mujoco()
        self._build(None)
        start = zero_pose(robot)
        self.set_position(start | dict(position or {}))

    @property
    def time_s(self) -> float:
        """Time since the arm was built."""
        return float(self._data.time)

    def step(self, current_A: FloatArray) -> None:
        """Advance by one control period.

        Args:
            current_A: Motor currents that flow all that time, shape (J,).

        Raises:
            ConfigurationError: The shape is wrong.
            SimulationError: A current, or a velocity after the step, is not finite.
        """
        current = np.asarray(current_A, dtype=np.float64)
        if current.shape != self._torque_constant.shape:
            raise ConfigurationError(f"expected currents of {', '.join(self.joints)}, got shape {current.shape}")
        if not math.isfinite(current.sum()):
            raise SimulationError("the virtual arm was given a current that is not finite; check the servos' law")
        torque = self._torque_constant * current
        force = self._data.qfrc_applied
        force[self._dofs] = torque / self._transmission
        friction = (self._coulomb + self._load_friction * np.abs(torque)) / self._transmission
        if isinstance(self.object, SoftBlock) or self._rises:
            push = force[self._finger] if isinstance(self.object, SoftBlock) else 0.0
            for _ in range(self._substeps):
                if isinstance(self.object, SoftBlock):
                    force[self._finger] = push + self._reaction(self.object)
                # the speed amid the step, or a constant over it would make the method first order
                velocity = self._data.qvel[self._dofs] / self._transmission
                amid = 1.5 * velocity - 0.5 * self._velocity_before
                self._velocity_before = velocity
                excess = self._stribeck * np.exp(-((amid / self._stribeck_velocity) ** 2))
                self._model.dof_frictionloss[self._dofs] = friction * (1.0 + excess)
                self._mujoco.mj_step(self._model, self._data)
        else:
            self._model.dof_frictionloss[self._dofs] = friction
            self._mujoco.mj_step(self._model, self._data, self._substeps)
        if not math.isfinite(self._data.qvel.sum()):
            raise SimulationError(
                f"the virtual arm diverged at {self.time_s:.3f} s: check that currents are in A, and build the arm anew"
            )

    def shaft_rad(self) -> FloatArray:
        """True angles of the output shafts [rad], shape (J,)."""
        angle: FloatArray = self._data.qpos[self._places] / self._transmission
        return angle

    def velocity_rad_s(self) -> FloatArray:
        """True velocities of the output shafts [rad/s], shape (J,)."""
        velocity: FloatArray = self._data.qvel[self._dofs] / self._transmission
        return velocity

    def encoder_rad(self) -> FloatArray:
        """What the encoders read before they round [rad], shape (J,); every call has fresh noise."""
        true = self.shaft_rad()
        reading: FloatArray = true - self._zero + self._turn_sin * np.sin(true) + self._turn_cos * np.cos(true)
        reading += self._encoder_noise * self._rng.standard_normal(len(reading))
        return reading

    def position(self) -> dict[str, float]:
        """True positions of all joints that have one of their own [rad or m]."""
        return {name: float(self._data.qpos[place]) for name, place in self._place_of.items()}

    def set_position(self, position: Mapping[str, float]) -> None:
        """Put joints elsewhere [rad or m], and everything at rest; joints that are not named stay where they are.

        Raises:
            ConfigurationError: A joint is unknown, or its position lies outside its limits.
        """
        for name, value in position.items():
            if name not in self._place_of:
                raise ConfigurationError(f"no joint {name!r} can be placed; choose from: {', '.join(self._place_of)}")
            joint = self._robot.model.joint(name)
            if not joint.lower <= value <= joint.upper or not math.isfinite(value):
                raise ConfigurationError(
                    f"{name} at {value:g}: give a position within {joint.lower:g} .. {joint.upper:g}"
                )
        for name, value in position.items():
            self._data.qpos[self._place_of[name]] = value
        self._follow()
        self._data.qvel[:] = 0.0
        self._velocity_before[:] = 0.0
        self._place_sphere()

    def hold(self, held: HandObject | None) -> None:
        """Put an object into the hand, or take it out; the arm goes on as it moves.

        A sphere begins at rest where its container is lowest; a block lies between the fingers where they are now.

        Raises:
            ConfigurationError: The robot has no gripper for a block, or no body has the object's inertia. The arm is as before.
        """
        if isinstance(held, SoftBlock) and self._finger is None:
            raise ConfigurationError(
                f"{self._robot.name} drives no sliding finger that could press a block; hold a payload instead"
            )
        before, places, dofs = self._data, self._arm_places, self._arm_dofs
        self._build(held)
        self._data.time = before.time
        # what hangs in the hand has joints of its own among the arm's; a sphere's come behind them
        self._data.qpos[self._arm_places] = before.qpos[places]
        self._data.qvel[self._arm_dofs] = before.qvel[dofs]
        if isinstance(held, SoftBlock):
            self._touch_m = float(self._data.qpos[self._place_of[self._finger_joint]]) - held.gap_m
        self._place_sphere()

    def put_sphere(self, inside_m: FloatArray) -> None:
        """Put the sphere elsewhere in its container, moving with it.

        Args:
            inside_m: Its centre from the container's [m], shape (3,).
        """
        if isinstance(self.object, Container):
            self._put_sphere(np.asarray(inside_m, dtype=np.float64))

    def sphere_m(self) -> FloatArray | None:
        """Where the sphere's centre is in the container, from the container's centre [m], shape (3,); None without one."""
        if not isinstance(self.object, Container):
            return None
        self._mujoco.mj_kinematics(self._model, self._data)
        box, ball = self._data.body(_CONTAINER), self._data.body(_SPHERE)
        inside: FloatArray = box.xmat.reshape(3, 3).T @ (ball.xpos - box.xpos)
        return inside

    def _reaction(self, block: SoftBlock) -> float:
        """What the block does to the driven finger, with what the followers pass on [N]; positive opens."""
        closed = self._touch_m - float(self._data.qpos[self._place_of[self._finger_joint]])
        rate = -float(self._data.qvel[self._finger])
        return self._fingers * block.force_N(self._fingers * closed, self._fingers * rate)

    def _follow(self) -> None:
        """Put the joints that follow others where they belong."""
        joints, places = self._robot.model.joint, self._data.qpos

        def position(joint: Joint) -> float:
            if joint.mimic is None:
                return float(places[self._place_of[joint.name]])
            source, multiplier, offset = joint.mimic
            return multiplier * position(joints(source)) + offset

        for joint in self._robot.model.joints:
            if joint.kind != "fixed":
                places[int(self._model.joint(joint.name).qposadr[0])] = position(joint)

    def _place_sphere(self) -> None:
        """Put the sphere to rest at the container's lowest place."""
        if not isinstance(self.object, Container):
            return
        box = self._data.body(_CONTAINER)
        self._mujoco.mj_forward(self._model, self._data)
        axes = box.xmat.reshape(3, 3)
        down = axes.T @ self._robot.gravity / max(float(np.linalg.norm(self._robot.gravity)), 1e-9)
        room = 0.5 * np.array(self.object.inner_size_m) - self.object.sphere_radius_m
        self._put_sphere(np.where(np.abs(down) > LEVEL, np.sign(down), 0.0) * room)

    def _put_sphere(self, inside: FloatArray) -> None:
        """Put the sphere to a place in the container [m], shape (3,), carried along by it."""
        box = self._data.body(_CONTAINER)
        self._mujoco.mj_forward(self._model, self._data)
        offset = box.xmat.reshape(3, 3) @ inside
        speed = np.zeros(6)  # angular, then linear, in the base frame
        kind = self._mujoco.mjtObj.mjOBJ_XBODY
        self._mujoco.mj_objectVelocity(self._model, self._data, kind, box.id, speed, 0)
        self._data.qpos[self._moving :] = (*(box.xpos + offset), 1.0, 0.0, 0.0, 0.0)
        self._data.qvel[self._moving :] = (*(speed[3:] + np.cross(speed[:3], offset)), 0.0, 0.0, 0.0)

    # ---------------------------------------------------------------------------------------------------------- building

    def _build(self, held: HandObject | None) -> None:
        """Compile the model with what the hand holds; the arm is at zero then."""
        mujoco, robot = self._mujoco, self._robot
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.timestep = self._substep_s
        # second order and more: a first-order method would be half a step ahead of the true motion
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.gravity = robot.gravity
        # the default counts relative to the mean inertia, which a geared slide of 90 kg makes large: joints would stick
        spec.option.tolerance = SOLVER_TOLERANCE
        # an arm that diverged must not silently begin anew at zero
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        links = {link.name: link for link in robot.model.links}
        bodies = {robot.model.root: spec.worldbody.add_body(name=robot.model.root)}
        for joint in robot.model.joints:
            body = bodies[joint.parent].add_body(name=joint.child, pos=joint.origin[:3, 3])
            mujoco.mju_mat2Quat(body.quat, np.ascontiguousarray(joint.origin[:3, :3]).ravel())
            bodies[joint.child] = body
            self._add_inertia(body, links[joint.child].pseudo_inertia, self.truth.links.get(joint.child, LinkTruth()))
            if joint.kind != "fixed":
                self._add_joint(spec, body, joint)
        self._add_object(spec, bodies[robot.payload_frame], held)
        try:
            model = spec.compile()
        except ValueError as error:
            raise ConfigurationError(
                f"{robot.name}: MuJoCo refuses it ({' '.join(str(error).split())}); correct the URDF or the object"
            ) from error
        self._model, self._data, self.object = model, mujoco.MjData(model), held

        moving = [joint for joint in robot.model.joints if joint.kind != "fixed"]
        self._place_of = {
            joint.name: int(self._model.joint(joint.name).qposadr[0]) for joint in moving if not joint.mimic
        }
        self._places = np.array([self._place_of[name] for name in self.joints])
        self._dofs = np.array([int(self._model.joint(name).dofadr[0]) for name in self.joints])
        self._moving = len(moving)
        self._arm_places = np.array([int(self._model.joint(joint.name).qposadr[0]) for joint in moving])
        self._arm_dofs = np.array([int(self._model.joint(joint.name).dofadr[0]) for joint in moving])
        slides = [name for name in self.joints if robot.model.joint(name).kind == "prismatic"]
        self._finger_joint = slides[0] if slides else ""
        self._finger = int(self._model.joint(slides[0]).dofadr[0]) if slides else None
        self._fingers = 1 + sum(joint.mimic is not None and joint.mimic[0] == self._finger_joint for joint in moving)

    def _add_inertia(self, body: Any, pseudo: FloatArray, departure: LinkTruth) -> None:
        mass = float(pseudo[3, 3])
        if mass <= 0.0:
            return
        com = pseudo[:3, 3] / mass
        second = pseudo[:3, :3] - mass * np.outer(com, com)
        inertia = np.trace(second) * np.eye(3) - second
        scale = self.truth.arm_scale * (1.0 + departure.mass)
        _set_inertia(body, scale * mass, com + departure.com_m, scale * (1.0 + departure.inertia) * inertia)

    def _add_joint(self, spec: Any, body: Any, joint: Joint) -> None:
        mujoco = self._mujoco
        slides = joint.kind == "prismatic"
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        made = body.add_joint(name=joint.name, type=kind, axis=joint.axis)
        made.solref_friction, made.solimp_friction = STICKING_SOLREF, STICKING_SOLIMP
        if joint.mimic is not None:
            source, multiplier, offset = joint.mimic
            tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=joint.name, name2=source)
            tie.objtype = mujoco.mjtObj.mjOBJ_JOINT
            tie.data[:5] = (offset, multiplier, 0.0, 0.0, 0.0)
            tie.solref, tie.solimp = STICKING_SOLREF, STICKING_SOLIMP
            return
        made.limited = math.isfinite(joint.lower) and math.isfinite(joint.upper)
        if made.limited:
            made.range = (joint.lower, joint.upper)
        made.solref_limit = LIMIT_SOLREF
        if joint.name in self.truth.joints:
            drive, transmission = self.truth.joints[joint.name], self._robot.drive_trains[joint.name].transmission
            made.armature = drive.armature / transmission**2
            made.damping[0] = drive.viscous / transmission**2

    def _add_object(self, spec: Any, hand: Any, held: HandObject | None) -> None:
        mujoco = self._mujoco
        if isinstance(held, Payload):
            body = hand.add_body(name=_PAYLOAD)
            _set_inertia(body, held.mass_kg, held.com_m, _matrix(held.inertia))
            if isinstance(held, HungPayload):
                kind = mujoco.mjtJoint.mjJNT_SLIDE if held.slides else mujoco.mjtJoint.mjJNT_HINGE
                for along in held.axes:
                    made = body.add_joint(type=kind, axis=along)
                    made.stiffness[0], made.damping[0] = held.stiffness, held.damping
        if isinstance(held, Container):
            box = hand.add_body(name=_CONTAINER, pos=held.centre_m)
            _set_inertia(box, held.mass_kg, (0.0, 0.0, 0.0), _matrix(held.inertia))
            half = 0.5 * np.array(held.inner_size_m)
            touching = {"condim": 3, "friction": (held.friction, 0.0, 0.0), "solref": CONTACT_SOLREF, "mass": 0.0}
            for axis in range(3):
                for side in (-1.0, 1.0):
                    centre, size = np.zeros(3), half + WALL_M
                    size[axis], centre[axis] = 0.5 * WALL_M, side * (half[axis] + 0.5 * WALL_M)
                    # walls meet the sphere, and nothing else anything
                    box.add_geom(
                        type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=centre, contype=1, conaffinity=0, **touching
                    )
            ball = spec.worldbody.add_body(name=_SPHERE)
            ball.add_freejoint()
            inertia = 0.4 * held.sphere_mass_kg * held.sphere_radius_m**2
            _set_inertia(ball, held.sphere_mass_kg, (0.0, 0.0, 0.0), inertia * np.eye(3))
            ball.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=(held.sphere_radius_m, 0.0, 0.0),
                contype=0,
                conaffinity=1,
                **touching,
            )


_PAYLOAD, _CONTAINER, _SPHERE = "held/payload", "held/container", "held/sphere"


def import_mujoco() -> Any:
    """MuJoCo's module.

    Raises:
        ConfigurationError: It is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ConfigurationError("a virtual arm needs MuJoCo: install the extra sim, e.g. proprio_ros[sim]") from error
    return mujoco


def _matrix(inertia: tuple[float, float, float, float, float, float]) -> FloatArray:
    xx, yy, zz, xy, xz, yz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _set_inertia(body: Any, mass: float, com: Any, inertia: FloatArray) -> None:
    """Give a body its inertia about its centre of mass."""
    body.explicitinertial = True
    body.mass, body.ipos = mass, np.asarray(com, dtype=np.float64)
    # a flat body is the edge of what is physical, and rounding must not push it over; a point has no inertia at all
    inertia = inertia + (1e-9 * np.trace(inertia) + 1e-12) * np.eye(3)
    xx, yy, zz = np.diag(inertia)
    body.fullinertia = (xx, yy, zz, inertia[0, 1], inertia[0, 2], inertia[1, 2])
