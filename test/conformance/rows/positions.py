"""Positions, zeros and eras of firmware."""

from __future__ import annotations

import math

from conformance.table import ACCEPTED, Bent, Row

_SECTION = "C. Positions, zeros, eras"
_WRIST = "wrist_2_joint"
_LOADED = ("loaded",)
_TOLD = (ACCEPTED, "too_wide")

ROWS = (
    *(
        Row(
            name=f"sign_bit_{bits}_not_decoded",
            section=_SECTION,
            trouble=f"negative counts have their sign in bit {bits}, which nobody decoded",
            base="ur10e",
            bends=(Bent("sign_bit_not_decoded", {"joint": "shoulder_pan_joint", "bits": bits}),),
            cause=r"sign",
            unsaid=r"is the file damaged|wrap around must be unwrapped",
        )
        for bits in (11, 15)
    ),
    Row(
        name="wrist_reversed",
        section=_SECTION,
        trouble="a joint's direction was flipped between two versions of a driver",
        base="ur10e",
        bends=(Bent("joint_reversed", {"joint": _WRIST}),),
        cause=rf"{_WRIST}.*(reversed|other way|sign|direction)",
        said_if=("accepted", "too_wide", "rejected", "not_identifiable", "unreadable"),
    ),
    Row(
        name="shoulder_reversed_loaded_alone",
        section=_SECTION,
        trouble="the same of a shoulder in the loaded recording alone",
        base="ur10e",
        bends=(Bent("joint_reversed", {"joint": "shoulder_lift_joint"}, _LOADED),),
        verdicts=("rejected", "not_identifiable"),
        cause=r"shoulder_lift_joint.*(reversed|other way|sign|direction|read .* off)",
    ),
    Row(
        name="elbow_put_on_anew",
        section=_SECTION,
        trouble="a horn was put on anew between the two recordings: 0.3 rad",
        base="ur10e",
        bends=(
            Bent(
                "joint_zero_off",
                {"joint": "elbow_joint", "zero_rad": 0.3},
                _LOADED,
            ),
        ),
        verdicts=("rejected", "not_identifiable"),
        codes=("other_zero",),
        cause=r"elbow_joint is read",
    ),
    Row(
        name="play_of_a_degree",
        section=_SECTION,
        trouble="one degree of play at each gear",
        base="ur10e",
        bends=(
            Bent(
                "all_joints_have_play",
                {"gear_rad": math.radians(1.0)},
            ),
        ),
    ),
    *(
        Row(
            name=f"wraps_{name}",
            section=_SECTION,
            trouble=f"a continuous joint wraps in mid-motion, {words}",
            base="ur10e",
            bends=(Bent("joint_wraps", {"joint": "shoulder_pan_joint", "low_rad": low}),),
            verdicts=(ACCEPTED,),
            narrow=0.25,
        )
        for name, low, words in (
            ("at_pi", -math.pi, "-pi to pi"),
            ("at_2_pi", 0.0, "0 to 2 pi"),
            ("at_3_pi_half", -0.5 * math.pi, "-pi/2 to 3 pi/2"),
        )
    ),
    Row(
        name="gripper_in_micrometres",
        section=_SECTION,
        trouble="a gripper in mm x 10,000 stands beside joints in rad",
        base="ur10e",
        bends=(Bent("another_column_in_another_unit", {"value": 440_000.0}),),
        verdicts=(ACCEPTED,),
        narrow=0.25,
    ),
)
