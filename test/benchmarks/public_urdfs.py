"""URDFs as people publish them, each made a robot file and read back: ``python test/benchmarks/public_urdfs.py``.

The URDFs are those of three packages on PyPI, installed into a temporary folder, or found in one that is given; without either the
benchmark is skipped. A robot that is asked which hand is meant gets a file for each, by ``--tip``. A file counts as read back where
it is loaded for recorded torque as it stands, and, written for currents, once what it marks is stated.

What moves is then compared with what others make of the same text: the efforts that hold the robot in three random poses and the
inertia about each joint by MuJoCo, where it takes the URDF, and the sum of the masses that move by a few lines over the XML.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from results import Results, parser_of

from proprio_ros.cli import main as proprio
from proprio_ros.errors import ProprioError
from proprio_ros.robot import Robot, RobotModel, load_robot, with_recorded_torque
from proprio_ros.robot.hands import hands
from proprio_ros.robot.loads import Loads

PACKAGES = {
    "example-robot-data": "cmeel.prefix",
    "hello-robot-stretch-urdf": "stretch_urdf",
    "dexmate-urdf": "dexmate_urdf",
}
"""By its name on PyPI, the folder in which a package has its URDFs."""
NO_ARM = ("no joint of it moves", "has no <link>")
UNSEEN_KG = 1e-3  # what links weigh that this package takes as frames
COLUMNS = {
    "package": "{package}",
    "URDFs": "{urdfs}",
    "without a joint that moves": "{no_arm}",
    "robot file read back": "{read} of {arms}",
    "files, one a hand": "{files}",
    "with a note": "{noted}",
    "MuJoCo takes": "{compared}",
    "farthest from MuJoCo": "{apart:.1g}",
    "masses agree": "{same_mass} of {read}",
}
REFUSED = {"URDF": "{urdf}", "refused": "{why}"}


class Answer(NamedTuple):
    """What became of one URDF."""

    why: str = ""  # it is refused
    notes: tuple[str, ...] = ()
    files: int = 0  # one a hand, where there are several
    apart: float | None = None  # largest difference from MuJoCo, relative
    same_mass: bool = False


def installed(folder: Path) -> bool:
    """Install the packages; whether they could be had."""
    words = ["-m", "pip", "install", "--quiet", "--no-deps", "--target", str(folder), *PACKAGES]
    done = subprocess.run([sys.executable, *words], check=False, stderr=subprocess.DEVNULL)
    return done.returncode == 0


def urdfs_of(folder: Path, package: str) -> list[Path]:
    """All URDFs of a package."""
    places = [place for place in folder.rglob(PACKAGES[package]) if place.is_dir()]
    return sorted(path for place in places for path in place.rglob("*.urdf"))


def asked(*words: str) -> dict[str, Any]:
    """The JSON of a command, with `exit_code`."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = proprio([*words, "--json"])
    answer: dict[str, Any] = json.loads(out.getvalue())
    return {**answer, "exit_code": code}


def filled_in(text: str) -> str:
    """A file with what it marks as to be stated."""
    text = re.sub(r"(nominal_torque_constant_N_m_per_A): null", r"\1: 2.0", text)
    return re.sub(r"(transmission_m_per_rad): null", r"\1: 0.01", text)


def answer_to(urdf: Path, folder: Path) -> Answer:
    """What becomes of a URDF.

    Raises `ProprioError`: A file was written that is refused.
    """
    output = folder / "robot.yaml"
    new = ["robot", "new", str(urdf), "--output", str(output), "--force"]
    first = asked(*new)
    tips: list[list[str]] = [[]]
    if "several hands" in first.get("error", ""):
        tips = [["--tip", hand] for hand in hands(RobotModel.from_urdf(urdf))]
    for tip in tips:
        answer = asked(*new, *tip)
        if answer["exit_code"]:
            return Answer(why=answer["error"])
        output.write_text(filled_in(output.read_text()))
        load_robot(output)
        asked(*new, *tip, "--effort-unit", "N.m")
        robot = load_robot(output, with_recorded_torque(output, {}))
    text = urdf.read_text(encoding="utf-8")
    return Answer(
        notes=robot.model.notes,
        files=len(tips),
        apart=apart_from_mujoco(robot, text),
        same_mass=agrees_in_mass(robot, text),
    )


def bare(text: str) -> ElementTree.Element:
    """The document without what needs meshes, or a simulator."""
    root = ElementTree.fromstring(text)
    for element in list(root.iter()):
        for part in list(element):
            if part.tag in ("visual", "collision", "gazebo", "transmission", "mujoco"):
                element.remove(part)
    return root


def apart_from_mujoco(robot: Robot, text: str) -> float | None:
    """Largest difference of efforts and inertias, in parts of the largest; None: MuJoCo refuses the URDF."""
    import mujoco

    root = bare(text)
    compiler = {"fusestatic": "false", "balanceinertia": "false", "discardvisual": "true"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", compiler)
    try:
        theirs = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except ValueError:
        return None
    if theirs.nv != sum(joint.kind != "fixed" for joint in robot.model.joints):
        return None  # it takes a base that floats as one that moves
    theirs.opt.gravity[:] = robot.gravity
    ours = Loads(robot)
    rng = np.random.default_rng(1)
    apart = []
    for _ in range(3):
        pose = {name: float(rng.uniform(-1.0, 1.0)) for name in ours.joints}
        load = ours.at(pose)
        gravity, inertia = by_mujoco(robot, theirs, pose)
        for mine, other in ((load.gravity, gravity), (load.inertia, inertia)):
            values = np.array([*mine.values()])
            difference = np.abs(values - other).max()
            # where all axes are upright, nothing is held
            apart.append(float(difference / (np.abs(other).max() or 1.0)))
    return max(apart)


def by_mujoco(
    robot: Robot,
    theirs: Any,
    pose: Mapping[str, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Efforts of the independent joints that hold a pose, and the inertia that each moves, with those that follow it."""
    import mujoco

    data = mujoco.MjData(theirs)
    follows = np.zeros((theirs.nv, len(pose)))
    for joint in robot.model.joints:
        if joint.kind != "fixed":
            name, multiplier, offset = robot.model.driving(joint)
            there = theirs.joint(joint.name)
            data.qpos[there.qposadr[0]] = multiplier * pose[name] + offset
            follows[there.dofadr[0], list(pose).index(name)] = multiplier
    mujoco.mj_forward(theirs, data)
    inertia = []
    for moved in follows.T:
        momentum = np.zeros(theirs.nv)
        mujoco.mj_mulM(theirs, data, momentum, moved)
        inertia.append(float(moved @ momentum))
    return follows.T @ data.qfrc_bias, np.array(inertia)


def agrees_in_mass(robot: Robot, text: str) -> bool:
    """Whether what moves weighs what the document says, by the document alone; what nobody states is left out."""
    root = ElementTree.fromstring(text)
    carrier = {}
    for joint in root.findall("joint"):
        carrier[joint.find("child").get("link")] = joint  # type: ignore[union-attr]

    def moves(link: str | None) -> bool:
        while link in carrier:
            joint = carrier[link]
            if joint.get("type") not in ("fixed", "floating", "planar"):
                return True
            link = joint.find("parent").get("link")  # type: ignore[union-attr]
        return False

    stated = 0.0
    for link in root.findall("link"):
        mass = link.find("inertial/mass")
        if mass is not None and moves(link.get("name")):
            stated += float(mass.get("value", "0"))
    ours = 0.0
    for each in robot.model.links:
        if moves(each.name) and each.spread.mass == 0.0:
            ours += float(each.pseudo_inertia[3, 3])
    return abs(ours - stated) < UNSEEN_KG


def one_package(
    package: str, urdfs: list[Path], scratch: Path
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Counts of a package's row, and what is refused."""
    count: Counter[str] = Counter()
    apart = []
    refused = []
    for urdf in urdfs:
        try:
            answer = answer_to(urdf, scratch)
        except ProprioError as error:
            answer = Answer(why=f"a file was written and refused: {error}")
        if answer.why:
            no_arm = any(words in answer.why for words in NO_ARM)
            count["no_arm"] += no_arm
            count["refused"] += not no_arm
            refused += [] if no_arm else [(urdf.name, answer.why)]
            continue
        count["read"] += 1
        count["files"] += answer.files
        count["noted"] += bool(answer.notes)
        count["same_mass"] += answer.same_mass
        if answer.apart is not None:
            apart.append(answer.apart)
    kinds = ("no_arm", "refused", "read", "files", "noted", "same_mass")
    row = {key: count[key] for key in kinds}
    arms = len(urdfs) - row["no_arm"]
    farthest = max(apart, default=None)
    counts = {"urdfs": len(urdfs), "arms": arms, "compared": len(apart), "apart": farthest}
    return {"package": package, **counts, **row}, refused


def main() -> int:
    """Print and keep; 1 where fewer become a file that is read back than the goal."""
    parser = parser_of(__doc__)
    parser.add_argument("--packages", type=Path, metavar="FOLDER", help="where they are installed")
    parser.add_argument("--goal", type=int, default=100, help="how many must be read back")
    options: argparse.Namespace = parser.parse_args()
    results = Results(__file__, options.json)
    results.table("urdfs", COLUMNS)
    refused: list[tuple[str, str]] = []
    rows = []
    results.file = options.json and options.json.resolve()
    packages = options.packages and options.packages.resolve()
    with tempfile.TemporaryDirectory() as place:
        os.chdir(place)  # MuJoCo writes its log where it is
        folder = packages or Path(place) / "packages"
        if packages is None and not installed(folder):
            print(f"skipped: {', '.join(PACKAGES)} cannot be installed")
            return 0
        for package in PACKAGES:
            row, why = one_package(package, urdfs_of(folder, package), Path(place))
            results.row("urdfs", **row)
            rows.append(row)
            refused += why
    added = (
        "urdfs",
        "no_arm",
        "arms",
        "refused",
        "read",
        "files",
        "noted",
        "same_mass",
        "compared",
    )
    total = {key: sum(row[key] for row in rows) for key in added}
    farthest = [row["apart"] for row in rows if row["apart"] is not None]
    apart = max(farthest, default=None)
    results.row("urdfs", package="all", apart=apart, **total)
    results.table("refused", REFUSED)
    for name, why in refused:
        results.row("refused", urdf=name, why=why)
    results.keep()
    return 0 if total["read"] >= options.goal else 1


if __name__ == "__main__":
    sys.exit(main())
