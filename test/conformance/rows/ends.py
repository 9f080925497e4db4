"""Recordings that do not go together, and those of which little can be said."""

from __future__ import annotations

from pathlib import Path

from support.known.bases import Files
from support.machines import REAL

from conformance.table import UNREADABLE, Row
from proprio_ros.cli import main as proprio

_SECTION = "H. Recordings that do not go together"
_BY = ("replay", "{loaded}", "--baseline", "{empty}", "--probe", "payload")
_UR10E = ("--robot", "ur10e", "--driver", "ur_current")


def _other_joints(folder: Path, files: Files) -> Files:
    """`amd02_joint1_alone` by `amd02_joint3_alone`, and `models/am_d02.urdf`"""
    robot = folder / "amd.yaml"
    urdf = str(REAL / "models" / "am_d02.urdf")
    proprio(["robot", "new", urdf, "--effort-unit", "N.m", "--output", str(robot), "--json"])
    bags = {"loaded": REAL / "amd02_joint1_alone", "empty": REAL / "amd02_joint3_alone"}
    return {**bags, "robot": robot}


def _other_joints_turned(folder: Path, files: Files) -> Files:
    """`amd02_joint3_alone` by `amd02_joint1_alone`"""
    found = _other_joints(folder, files)
    return {
        **found,
        "loaded": found["empty"],
        "empty": found["loaded"],
    }


def _both_loaded(folder: Path, files: Files) -> Files:
    """`ur10e_loaded_14` by `ur10e_loaded_15`"""
    return {**files, "empty": REAL / "ur10e_loaded_15"}


ROWS = (
    *(
        Row(
            name=f"motions_of_different_joints{turned}",
            section=_SECTION,
            trouble="the two motions move different joints",
            base="ur10e",
            command=(*_BY, "--robot", "{robot}", "--effort-unit", "N.m"),
            make=make,
            verdicts=("rejected", "not_identifiable", UNREADABLE),
            cause=r"joint|move",
            unsaid=r"LinAlg|\d{7,}",
        )
        for turned, make in (("", _other_joints), ("_turned", _other_joints_turned))
    ),
    Row(
        name="a_tool_in_both",
        section=_SECTION,
        trouble="the hand was not empty in the empty recording",
        base="ur10e",
        command=(*_BY, *_UR10E),
        make=_both_loaded,
        verdicts=("rejected", "not_identifiable"),
        cause=r"(hand|recording|baseline).*(empty|held|tool)",
        unsaid=r"check the effort's unit",
    ),
)
