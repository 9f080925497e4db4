"""What a calibration learnt, as a URDF for others: links as their torques weigh, and friction as ``<dynamics>``.

A calibration by motions knows each body, everything between one joint and the next, and not its links one by one. By how much a
body differs from the URDF goes to its heaviest link, the others stay as they were: so the arm's torques are those that were
learnt, in every pose and motion, and whatever stands on the other links finds them in their place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from proprio_ros.calibration_files.motions import ARM_TERMS
from proprio_ros.errors import RobotError
from proprio_ros.identification.regression.rigid_body import pseudo_inertia
from proprio_ros.records import FloatArray
from proprio_ros.robot import ReducedModel, Robot, RobotModel
from proprio_ros.robot.kinematics import zero_pose
from proprio_ros.robot.regressor import PARAMETERS

LEAST_RADIUS_M = 1e-3
"""Nothing is thinner in any direction: the least root of the mean square of its points' distance from its centre."""


class LearntUrdf(NamedTuple):
    """The text, joints and links that it states friction and inertia of, and links whose inertia gave way to be that of a body."""

    text: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    bent: tuple[str, ...]


@dataclass(frozen=True)
class _Friction:
    """Of a joint, in SI units."""

    viscous: float = 0.0
    coulomb: float = 0.0


def learnt_urdf(robot: Robot) -> LearntUrdf:
    """The robot's URDF with what its calibration learnt: viscous and Coulomb friction in SI units at the joint, and links.

    Of a calibration by pushes, and of a robot file alone, friction is that of the drive trains, and all masses count `arm_scale`
    times.

    Raises `RobotError`: The URDF is in no file of its own, or what was learnt is no arm.
    """
    path = Path(str(robot.settings.get("urdf", "")))
    if path.suffix != ".urdf" or not path.is_file():
        raise RobotError(
            f"its URDF is in no .urdf file of its own ({path.name}); write it to one and name that",
            robot.name,
        )
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(path.read_bytes(), ElementTree.XMLParser(target=builder))
    bodies, bent = _bodies(robot)
    for element in root.findall("link"):
        pseudo = bodies.get(str(element.get("name")))
        if pseudo is not None:
            _state_inertia(element, pseudo)
    stated = _state_friction(root, _friction(robot))
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
    RobotModel.from_urdf_string(text, path.name)
    return LearntUrdf(text, tuple(stated), tuple(bodies), tuple(bent))


def _friction(robot: Robot) -> dict[str, _Friction]:
    """Of each joint, as its drive train has it, or as motions learnt it."""
    friction = {}
    for name, drive in robot.drive_trains.items():
        viscous = drive.viscous.value / drive.transmission**2
        coulomb = drive.coulomb.value / abs(drive.transmission)
        friction[name] = _Friction(viscous, coulomb)
    calibration = robot.motion_calibration
    if calibration is None:
        return friction
    count = len(calibration.joints)
    own = calibration.torque_scale * calibration.values[ARM_TERMS * count :]
    for number, name in enumerate(calibration.joints):
        friction[name] = _Friction(own[number], own[count + number])
    return friction


def _state_friction(
    root: ElementTree.Element,
    friction: Mapping[str, _Friction],
) -> list[str]:
    """Write friction into the joints of a URDF; returns their names."""
    stated = []
    for element in root.findall("joint"):
        name = str(element.get("name"))
        own = friction.get(name, _Friction())
        if own == _Friction():
            continue
        stated.append(name)
        dynamics = element.find("dynamics")
        if dynamics is None:
            dynamics = ElementTree.SubElement(element, "dynamics")
        # no simulator takes friction that drives
        dynamics.set("damping", f"{max(own.viscous, 0.0):.6g}")
        dynamics.set("friction", f"{max(own.coulomb, 0.0):.6g}")
    return stated


def _bodies(robot: Robot) -> tuple[dict[str, FloatArray], list[str]]:
    """Pseudo-inertias of links that weigh otherwise than in the URDF, and those whose inertia had to give way."""
    calibration = robot.motion_calibration
    scale = robot.arm_scale.value
    stated = {link.name: link.pseudo_inertia for link in robot.model.links}
    if calibration is None:
        scaled = {name: scale * pseudo for name, pseudo in stated.items() if pseudo[3, 3]}
        return (scaled if scale != 1.0 else {}), []
    others = [name for name in robot.model.independent_joints if name not in calibration.joints]
    held = {
        **zero_pose(robot, others),
        **{name: at for name, at in robot.held.items() if name in others},
    }
    model = robot.model.lock(list(calibration.joints), held, robot.gravity)
    found = {}
    bent = []
    for body, joint in enumerate(calibration.joints):
        at = slice(PARAMETERS * body, PARAMETERS * (body + 1))
        learnt = calibration.torque_scale * calibration.values[at]
        if learnt[0] <= 0.0:
            raise RobotError(
                f"what moves with {joint} weighs {learnt[0]:.3g} kg by this calibration; calibrate with more motion"
            )
        link, pseudo = _heaviest_link(model, body, pseudo_inertia(learnt), stated)
        found[link], gave_way = _possible(pseudo)
        bent += [link] * gave_way
    return found, bent


def _heaviest_link(
    model: ReducedModel,
    body: int,
    learnt: FloatArray,
    stated: Mapping[str, FloatArray],
) -> tuple[str, FloatArray]:
    """The heaviest link of a body, and its pseudo-inertia once it has all by which the body differs from the URDF.

    Args:
        model: Bodies by the URDF.
        body: Its number.
        learnt: Pseudo-inertia of the body, in its own frame, shape (4, 4).
        stated: Pseudo-inertias of links by the URDF, each in its own frame.

    Raises:
        RobotError: It would weigh nothing.
    """
    links = [name for name, (of, _) in model.frames.items() if of == body]
    link = max(links, key=lambda name: stated[name][3, 3])
    link_T_body = np.linalg.inv(model.frames[link][1])
    change = learnt - model.pseudo_inertia[body]
    pseudo = stated[link] + link_T_body @ change @ link_T_body.T
    if pseudo[3, 3] <= 0.0:
        raise RobotError(
            f"{link} would weigh {pseudo[3, 3]:.3g} kg by this calibration; calibrate with more motion"
        )
    return link, pseudo


def _possible(pseudo: FloatArray) -> tuple[FloatArray, bool]:
    """A pseudo-inertia, shape (4, 4), that a body can have, and whether the inertia about its centre had to give way for it.

    The torques of gravity stay exactly, and inertia about the centre is that of the nearest body that can be.
    """
    mass = float(pseudo[3, 3])
    about = np.outer(pseudo[:3, 3], pseudo[:3, 3]) / mass
    size, axes = np.linalg.eigh(pseudo[:3, :3] - about)
    least = mass * LEAST_RADIUS_M**2
    possible = pseudo.copy()
    spread = (axes * np.maximum(size, least)) @ axes.T
    possible[:3, :3] = about + spread
    return possible, bool(size[0] < least)


def _state_inertia(element: ElementTree.Element, pseudo: FloatArray) -> None:
    """Write a body in the place of what a link has."""
    mass = float(pseudo[3, 3])
    centre = pseudo[:3, 3] / pseudo[3, 3]
    spread = pseudo[:3, :3] - mass * np.outer(centre, centre)
    inertia = np.trace(spread) * np.eye(3) - spread
    for old in element.findall("inertial"):
        element.remove(old)
    inertial = ElementTree.SubElement(element, "inertial")
    ElementTree.SubElement(
        inertial, "origin", xyz=" ".join(f"{axis:.9g}" for axis in centre), rpy="0 0 0"
    )
    ElementTree.SubElement(inertial, "mass", value=f"{mass:.9g}")
    names = {
        f"i{'xyz'[row]}{'xyz'[column]}": f"{inertia[row, column]:.9g}"
        for row in range(3)
        for column in range(row, 3)
    }
    ElementTree.SubElement(inertial, "inertia", names)
