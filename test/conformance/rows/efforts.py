"""Efforts that are not what they seem."""

from __future__ import annotations

from conformance.table import ACCEPTED, UNREADABLE, VERDICTS, Bent, Row

_SECTION = "B. Effort that is not what it seems"
_FIRST_THREE = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
_LOADED = ("loaded",)
_BOTH = ("loaded", "empty")
_TOLD = (ACCEPTED, "too_wide")
_REFUSED = ("rejected", "not_identifiable")
_STOOD = r"effort.*(stands still|stood still|frozen|from .* s on|zero|is 0)"
_PICKED = r"picked up"

ROWS = (
    Row(
        name="three_joints_times_4",
        section=_SECTION,
        trouble="firmware scales joints 1 to 3 by 4",
        base="ur10e",
        bends=(
            Bent(
                "joints_scaled",
                {"joints": _FIRST_THREE, "factor": 4},
            ),
        ),
        verdicts=_REFUSED,
        codes=("arm_unlike_urdf", "other_torque"),
        cause=r"\b(4(\.\d)?|3\.[5-9]\d?) times|by 4\b|x 4\b|0?\.25",
    ),
    Row(
        name="three_joints_times_4_loaded_alone",
        section=_SECTION,
        trouble="the same in the loaded recording alone",
        base="ur10e",
        bends=(
            Bent(
                "joints_scaled",
                {"joints": _FIRST_THREE, "factor": 4},
                _LOADED,
            ),
        ),
        verdicts=_REFUSED,
        codes=("arm_unlike_urdf", "other_torque"),
        cause=r"\b(4(\.\d)?|3\.[5-9]\d?) times|by 4\b|x 4\b|0?\.25",
    ),
    *(
        Row(
            name=f"{words}_halved",
            section=_SECTION,
            trouble=f"firmware halves {words.replace('_', ' ')}, with the load and without it",
            base="ur10e",
            bends=(Bent("joints_scaled", {"joints": joints, "factor": 0.5}),),
            verdicts=_REFUSED,
            codes=("misfit", "other_torque"),
            cause="unit",
        )
        for words, joints in (
            ("elbow_and_two_wrists", ["elbow_joint", "wrist_1_joint", "wrist_2_joint"]),
            ("two_wrists", ["wrist_1_joint", "wrist_2_joint"]),
        )
    ),
    *(
        Row(
            name=f"effort_{how}_from_60_percent{'' if len(of) > 1 else '_loaded_alone'}",
            section=_SECTION,
            trouble=f"after a controller was switched, the effort {words} from 60 % of the recording on",
            base="ur10e",
            bends=(Bent(*bent, of),),
            verdicts=_TOLD,
            cause=_STOOD,
            said_if=VERDICTS,
            unsaid=_PICKED,
        )
        for how, words, bent in (
            ("frozen", "stands still", ("effort_frozen", {"at": 0.6})),
            ("zero", "is 0", ("effort_gone", {"at": 0.6, "value": 0.0})),
            ("missing", "is NaN", ("effort_gone", {"at": 0.6, "value": float("nan")})),
        )
        for of in (_BOTH, _LOADED)
    ),
    Row(
        name="effort_drops_out",
        section=_SECTION,
        trouble="single samples of effort, 2 % of them, are 0",
        base="ur10e",
        bends=(
            Bent(
                "effort_drops_out",
                {"share": 0.02, "value": 0.0},
            ),
        ),
        verdicts=(ACCEPTED,),
        narrow=0.3,
    ),
    Row(
        name="effort_has_denormals",
        section=_SECTION,
        trouble="single samples of effort, 2 % of them, are denormal numbers of unwritten memory",
        base="ur10e",
        bends=(
            Bent(
                "effort_drops_out",
                {"share": 0.02, "value": 5e-324},
            ),
        ),
        verdicts=(ACCEPTED,),
        narrow=0.3,
    ),
    Row(
        name="tared",
        section=_SECTION,
        trouble="the sensors were tared with the tool on",
        base="ur10e",
        bends=(Bent("effort_tared"),),
        verdicts=(ACCEPTED,),
        narrow=0.25,
    ),
    Row(
        name="friction_falls",
        section=_SECTION,
        trouble="the motors warm up within a recording: friction falls by 0.24 A",
        base="ur10e",
        bends=(Bent("friction_falls_by_a_current", {"current": 0.24}),),
        cause=r"friction.*(fell|changed|along)|warm",
        unsaid=r"held firmly|picked up",
    ),
    Row(
        name="torque_falls",
        section=_SECTION,
        trouble="the motors warm up within a recording: torque falls by 6 %",
        base="ur10e",
        bends=(Bent("torque_falls", {"share": -0.06}),),
        cause=r"torque.*(fell|rose|changed|along)|warm",
        unsaid=r"held firmly|picked up",
    ),
    Row(
        name="torque_without_gravity",
        section=_SECTION,
        trouble="the driver publishes torque without gravity, and the user says so",
        base="ur10e",
        command=(
            "replay",
            "{loaded}",
            "--baseline",
            "{empty}",
            "--probe",
            "payload",
            "--robot",
            "ur10e",
            "--driver",
            "ur_torque",
        ),
        verdicts=(UNREADABLE,),
        cause=r"payload.*controller|lacks what holds the arm",
    ),
)
