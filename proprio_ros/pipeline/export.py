"""What a calibration learnt, as a URDF for others: links as their torques weigh, and friction as ``<dynamics>``.

A calibration by motions knows each body, everything between one joint and the next, and not its links one by one. By how much a
body differs from the URDF goes to its heaviest link, the others stay as they were: so the arm's torques are those that were
learnt, in every pose and motion, and whatever stands on the other links finds them in their place.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from proprio_ros.calibration_files.motions import ARM_TERMS
from proprio_ros.errors import RobotError
from proprio_ros.identification.regression.rigid_body import pseudo_inertia
from proprio_ros.records import FloatArray
from proprio_ros.robot import Robot, RobotModel
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


def learnt_urdf(robot: Robot) -> LearntUrdf:
    """The robot's URDF with what its calibration learnt: viscous and Coulomb friction in SI units at the joint, and links.

    Of a calibration by pushes, and of a robot file alone, friction is that of the drive trains, and all masses count `arm_scale`
    times.

    Raises `RobotError`: The URDF is in no file of its own, or what was learnt is no arm.
    """
    path = Path(str(robot.settings.get("urdf", "")))
    if path.suffix != ".urdf" or not path.is_file():
        raise RobotError(
            f"{robot.name}: its URDF is in no .urdf file of its own ({path.name}); write it to one and name that"
        )
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(path.read_bytes(), ElementTree.XMLParser(target=builder))
    calibration = robot.motion_calibration
    friction = {
        name: (
            drive.viscous.value / drive.transmission**2,
            drive.coulomb.value / abs(drive.transmission),
        )
        for name, drive in robot.drive_trains.items()
    }
    if calibration is None:
        scale = robot.arm_scale.value
        bodies = {
            link.name: scale * link.pseudo_inertia
            for link in robot.model.links
            if scale != 1.0 and link.pseudo_inertia[3, 3]
        }
        bent: list[str] = []
    else:
        count = len(calibration.joints)
        own = calibration.torque_scale * calibration.values[ARM_TERMS * count :]
        friction |= {name: (own[n], own[count + n]) for n, name in enumerate(calibration.joints)}
        bodies, bent = _bodies(robot)
    for element in root.findall("link"):
        if (pseudo := bodies.get(str(element.get("name")))) is not None:
            _state_inertia(element, pseudo)
    stated = []
    for element in root.findall("joint"):
        viscous, coulomb = friction.get(
            str(element.get("name")),
            (0.0, 0.0),
        )
        if (viscous, coulomb) != (0.0, 0.0):
            stated.append(str(element.get("name")))
            dynamics = element.find("dynamics")
            dynamics = ElementTree.SubElement(element, "dynamics") if dynamics is None else dynamics
            # no simulator takes friction that drives
            dynamics.set("damping", f"{max(viscous, 0.0):.6g}")
            dynamics.set("friction", f"{max(coulomb, 0.0):.6g}")
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
    RobotModel.from_urdf_string(text, path.name)
    return LearntUrdf(text, tuple(stated), tuple(bodies), tuple(bent))


def _bodies(robot: Robot) -> tuple[dict[str, FloatArray], list[str]]:
    """Pseudo-inertias of the heaviest link of each body, in that link's frame, and the links whose inertia had to give way."""
    calibration = robot.motion_calibration
    assert calibration is not None
    others = [name for name in robot.model.independent_joints if name not in calibration.joints]
    held = zero_pose(robot, others) | {
        name: at for name, at in robot.held.items() if name in others
    }
    model = robot.model.lock(list(calibration.joints), held, robot.gravity)
    masses = {link.name: link.pseudo_inertia for link in robot.model.links}
    found = {}
    bent = []
    for body, joint in enumerate(calibration.joints):
        at = slice(PARAMETERS * body, PARAMETERS * (body + 1))
        learnt = calibration.torque_scale * calibration.values[at]
        if learnt[0] <= 0.0:
            raise RobotError(
                f"what moves with {joint} weighs {learnt[0]:.3g} kg by this calibration; calibrate with more motion"
            )
        change = pseudo_inertia(learnt) - model.pseudo_inertia[body]
        link = max(
            (name for name, (of, _) in model.frames.items() if of == body),
            key=lambda name: masses[name][3, 3],
        )
        back = np.linalg.inv(model.frames[link][1])
        pseudo = masses[link] + back @ change @ back.T
        mass = float(pseudo[3, 3])
        if mass <= 0.0:
            raise RobotError(
                f"{link} would weigh {mass:.3g} kg by this calibration; calibrate with more motion"
            )
        # the torques of gravity stay exactly, and inertia about the centre is that of the nearest body that can be
        about = np.outer(pseudo[:3, 3], pseudo[:3, 3]) / mass
        size, axes = np.linalg.eigh(pseudo[:3, :3] - about)
        if size[0] < (least := mass * LEAST_RADIUS_M**2):
            bent.append(link)
        pseudo[:3, :3] = about + (axes * np.maximum(size, least)) @ axes.T
        found[link] = pseudo
    return found, bent


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
