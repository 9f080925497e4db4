"""URDFs that people have, and arms that are not as their URDF says."""

from __future__ import annotations

import re
from pathlib import Path

from support.known.bases import Files
from support.machines import REAL

from conformance.table import ACCEPTED, Row
from proprio_ros.inputs.resources import share_directory

_SECTION = "F. URDFs that people have"
_NEW = ("robot", "new", "{urdf}", "--effort-unit", "N.m", "--output", "{output}")
_BASE = "push_light_ball_20g_joint3"  # whose own files are not looked at


def _panda() -> str:
    return (share_directory() / "urdf" / "panda.urdf").read_text(encoding="utf-8")


def _written(folder: Path, urdf: str) -> Files:
    path = folder / "arm.urdf"
    path.write_text(urdf, encoding="utf-8")
    return {"urdf": path, "output": folder / "arm.yaml"}


def _no_limits(folder: Path, files: Files) -> Files:
    """`effort="0" velocity="0"` on all joints of `urdf/panda.urdf` but the last"""
    urdf = re.sub(r'(effort|velocity)="[^"]*"', r'\1="0"', _panda(), count=12)
    return _written(folder, urdf)


def _with_link(inertial: str) -> str:
    """The Panda with a link more, on its last one."""
    link = (
        f'<link name="an_antenna">{inertial}</link><joint name="to_antenna" type="fixed">'
        '<parent link="panda_link8"/><child link="an_antenna"/></joint></robot>'
    )
    return _panda().replace("</robot>", link)


def _antenna(folder: Path, files: Files) -> Files:
    """`urdf/panda.urdf` with an antenna of 1 mg whose inertia has a rounding error"""
    inertia = '<inertia ixx="1e-12" iyy="-1e-19" izz="1e-12" ixy="0" ixz="0" iyz="0"/>'
    return _written(folder, _with_link(f'<inertial><mass value="1e-6"/>{inertia}</inertial>'))


def _sticker(folder: Path, files: Files) -> Files:
    """`urdf/panda.urdf` with a sticker that has a mass and no inertia"""
    return _written(folder, _with_link('<inertial><mass value="0.0001"/></inertial>'))


def _tool_frame(folder: Path, files: Files) -> Files:
    """`models/ar5.urdf` as published: a tool frame of mass 0 with an inertia of 1e-6"""
    return {"urdf": REAL / "models" / "ar5.urdf", "output": folder / "arm.yaml"}


def _heavier_hand(folder: Path, files: Files) -> Files:
    """0.7 kg more on the last link of the URDF, as of a hand that is not mounted"""
    share = share_directory()
    urdf = (share / "urdf" / "ur10e.urdf").read_text(encoding="utf-8")
    before, last, after = urdf.partition('<link name="wrist_3_link"')

    def heavier(found: re.Match[str]) -> str:
        return f'<mass value="{float(found[1]) + 0.7}"'

    after = re.sub(r'<mass value="([^"]+)"', heavier, after, count=1)
    (folder / "ur10e.urdf").write_text(before + last + after, encoding="utf-8")
    robot = (share / "config" / "robots" / "ur10e.yaml").read_text(encoding="utf-8")
    path = folder / "ur10e.yaml"
    path.write_text(
        re.sub(r"(?m)^urdf: .*$", "urdf: ur10e.urdf", robot),
        encoding="utf-8",
    )
    return {**files, "robot": path}


ROWS = (
    Row(
        name="limits_of_zero",
        section=_SECTION,
        trouble="the URDF says effort 0 and velocity 0",
        base=_BASE,
        command=_NEW,
        make=_no_limits,
        verdicts=(ACCEPTED,),
        cause=r"limit|effort|velocity",
        said_if=(ACCEPTED,),
    ),
    Row(
        name="antenna_of_a_milligram",
        section=_SECTION,
        trouble="a body of 1 mg has an inertia with a rounding error",
        base=_BASE,
        command=_NEW,
        make=_antenna,
        verdicts=(ACCEPTED,),
    ),
    Row(
        name="sticker_without_inertia",
        section=_SECTION,
        trouble="a body of 0.1 g has no inertia",
        base=_BASE,
        command=_NEW,
        make=_sticker,
        verdicts=(ACCEPTED,),
    ),
    Row(
        name="tool_frame_with_inertia",
        section=_SECTION,
        trouble="a tool frame of mass 0 has an inertia",
        base="ur10e",
        command=_NEW,
        make=_tool_frame,
        verdicts=(ACCEPTED,),
    ),
    Row(
        name="hand_not_mounted",
        section=_SECTION,
        trouble="the URDF has a hand of 0.7 kg that is not mounted",
        base="ur10e",
        command=(
            "replay",
            "{loaded}",
            "--baseline",
            "{empty}",
            "--probe",
            "payload",
            "--robot",
            "{robot}",
            "--driver",
            "ur_current",
        ),
        make=_heavier_hand,
        verdicts=(ACCEPTED, "too_wide"),
        cause=r"weighs (0\.9\d*|1\.00) times what its URDF says",
        said_if=(ACCEPTED,),
    ),
)
