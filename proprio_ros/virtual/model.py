"""MuJoCo's model of an arm with what its hand holds.

Links and joints come from the robot's model, and all that a `Truth` changes from that.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from proprio_ros.errors import ConfigurationError
from proprio_ros.records import FloatArray
from proprio_ros.robot import Joint, Robot, RobotModel
from proprio_ros.virtual.objects import HandObject, set_inertia
from proprio_ros.virtual.truth import LinkTruth, Truth

STICKING_SOLREF = (0.001, 1.0)
STICKING_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""MuJoCo's constraints are soft: with these a stuck joint creeps at 1e-4 of its acceleration times half a millisecond."""
SOLVER_TOLERANCE = 1e-14
"""The default counts relative to the mean inertia, which a geared slide of 90 kg makes large: joints would stick."""
LIMIT_SOLREF = (0.004, 1.0)
SPECK_KG = 1e-9  # MuJoCo wants some mass of all that moves


def _without_mass(model: RobotModel) -> list[str]:
    """Links on joints that move, which have no mass, nor has anything that is fixed to them."""
    kg = {link.name: float(link.pseudo_inertia[3, 3]) for link in model.links}
    for joint in reversed(model.joints):
        if joint.kind == "fixed":
            kg[joint.parent] += kg[joint.child]
    return [
        joint.child for joint in model.joints if joint.kind != "fixed" and kg[joint.child] <= 0.0
    ]


def import_mujoco() -> Any:
    """MuJoCo's module. Raises `ConfigurationError`: It is not installed."""
    try:
        import mujoco
    except ImportError as error:
        raise ConfigurationError(
            "a virtual arm needs MuJoCo: install the extra sim, e.g. proprio_ros[sim]"
        ) from error
    return mujoco


class ArmModel:
    """Makes models of one arm.

    Args:
        robot: The arm as its file states it.
        truth: What it is really like.
        substep_s: Time step of the simulation [s].
    """

    def __init__(self, robot: Robot, truth: Truth, substep_s: float) -> None:
        self.mujoco = import_mujoco()
        self._robot = robot
        self._truth = truth
        self._substep_s = substep_s

    def compiled(self, held: HandObject | None) -> Any:
        """The model with what the hand holds.

        Raises:
            ConfigurationError: MuJoCo refuses it.
        """
        spec = self.mujoco.MjSpec()
        self._set_options(spec)
        hand = self._add_arm(spec)
        if held is not None:
            held.build(self.mujoco, spec, hand)
        try:
            return spec.compile()
        except ValueError as error:
            why = " ".join(str(error).split())
            raise ConfigurationError(
                f"{self._robot.name}: MuJoCo refuses it ({why}); correct the URDF or the object"
            ) from error

    def _set_options(self, spec: Any) -> None:
        mujoco = self.mujoco
        spec.compiler.degree = False
        spec.option.timestep = self._substep_s
        # second order and more: a first-order method would be half a step ahead of the true motion
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.gravity = self._robot.gravity
        spec.option.tolerance = SOLVER_TOLERANCE
        # an arm that diverged must not silently begin anew at zero
        no_reset = mujoco.mjtDisableBit.mjDSBL_AUTORESET
        # to look for joints that press on nothing costs a tenth
        no_islands = mujoco.mjtDisableBit.mjDSBL_ISLAND
        spec.option.disableflags = int(no_reset | no_islands)

    def _add_arm(self, spec: Any) -> Any:
        """Links and joints; returns the body of the hand."""
        robot = self._robot
        links = {link.name: link for link in robot.model.links}
        root = robot.model.root
        # MuJoCo has a body of this name already
        base = spec.worldbody if root == "world" else spec.worldbody.add_body(name=root)
        bodies = {root: base}
        for joint in robot.model.joints:
            body = bodies[joint.parent].add_body(name=joint.child, pos=joint.origin[:3, 3])
            turn = np.ascontiguousarray(joint.origin[:3, :3])
            self.mujoco.mju_mat2Quat(body.quat, turn.ravel())
            bodies[joint.child] = body
            departure = self._truth.links.get(joint.child, LinkTruth())
            self._add_inertia(
                body,
                links[joint.child].pseudo_inertia,
                departure,
            )
            if joint.kind != "fixed":
                self._add_joint(spec, body, joint)
        for name in _without_mass(robot.model):
            set_inertia(bodies[name], SPECK_KG, np.zeros(3), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        return bodies[robot.payload_frame]

    def _add_inertia(self, body: Any, pseudo: FloatArray, departure: LinkTruth) -> None:
        mass = float(pseudo[3, 3])
        if mass <= 0.0:
            return
        com = pseudo[:3, 3] / mass
        second = pseudo[:3, :3] - mass * np.outer(com, com)
        inertia = np.trace(second) * np.eye(3) - second
        scale = self._truth.arm_scale * (1.0 + departure.mass)
        inertia *= scale * (1.0 + departure.inertia)
        six = (*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2])
        set_inertia(body, scale * mass, com + departure.com_m, six)

    def _add_joint(self, spec: Any, body: Any, joint: Joint) -> None:
        mujoco = self.mujoco
        slides = joint.kind == "prismatic"
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        made = body.add_joint(
            name=joint.name,
            type=kind,
            axis=joint.axis,
        )
        made.solref_friction = STICKING_SOLREF
        made.solimp_friction = STICKING_SOLIMP
        if joint.mimic is not None:
            source, multiplier, offset = joint.mimic
            kind = mujoco.mjtEq.mjEQ_JOINT
            tie = spec.add_equality(
                type=kind,
                name1=joint.name,
                name2=source,
            )
            tie.objtype = mujoco.mjtObj.mjOBJ_JOINT
            tie.data[:5] = (offset, multiplier, 0.0, 0.0, 0.0)
            tie.solref = STICKING_SOLREF
            tie.solimp = STICKING_SOLIMP
            return
        made.limited = math.isfinite(joint.lower) and math.isfinite(joint.upper)
        if made.limited:
            made.range = (joint.lower, joint.upper)
        made.solref_limit = LIMIT_SOLREF
        if joint.name in self._truth.joints:
            drive = self._truth.joints[joint.name]
            transmission = self._robot.drive_trains[joint.name].transmission
            made.armature = drive.armature / transmission**2
            made.damping[0] = drive.viscous / transmission**2
