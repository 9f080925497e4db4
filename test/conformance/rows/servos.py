"""A servo asked by the calibration of another one, and goals that are not what a servo heard."""

from __future__ import annotations

from pathlib import Path

from support.known.asking import REFUSED
from support.machines import REAL

from conformance.table import ACCEPTED, VERDICTS, Bent, Files, Row

_SECTION = "I. Whose servo"
_DRIVEN = "driven_sin_sin_0.535"
_LOADED = ("loaded",)


def _instead(recording: str) -> Row:
    """Another servo's recording, with the calibration of the base."""

    def make(folder: Path, files: Files) -> Files:
        return {**files, "loaded": REAL / recording}

    let_go = "release" in recording
    return Row(
        name=f"asked_for_{recording}",
        section=_SECTION,
        trouble=f"the calibration of an STS3215, and `{recording}`",
        base="let_go_0.741" if let_go else _DRIVEN,
        make=make,
        verdicts=REFUSED,
        cause=r"another|that servo|the servo|not the joint|any load",
    )


def _heard(
    bend: str,
    trouble: str,
    verdicts: tuple[str, ...],
    **parameters: float,
) -> Row:
    """Goals of a real servo that are not what it heard.

    Args:
        bend: Its name.
        trouble: What it is.
        verdicts: That are right.
        parameters: Of the bend.
    """
    joint = {} if bend in ("goals_late", "goals_lead_more") else {"joint": "pendulum"}
    return Row(
        name=f"{bend}_{'_'.join(map(str, parameters.values()))}",
        section=_SECTION,
        trouble=trouble,
        base=_DRIVEN,
        bends=(Bent(bend, {**joint, **parameters}, _LOADED),),
        verdicts=verdicts,
        cause=r"goals|servo",
        said_if=("rejected",),
    )


def _of_arm(
    bend: str,
    trouble: str,
    cause: str,
    verdicts: tuple[str, ...] = REFUSED,
    **parameters: float | str,
) -> Row:
    """Goals of a simulated SO-101 that are not what its servos heard, with the very cause.

    Args:
        bend: Its name.
        trouble: What it is.
        cause: Regular expression that names it.
        verdicts: That are right.
        parameters: Of the bend.
    """
    return Row(
        name=f"so101_{bend}",
        section=_SECTION,
        trouble=trouble,
        base="so101_1",
        bends=(Bent(bend, parameters, _LOADED),),
        verdicts=verdicts,
        codes=("other_torque",) if verdicts == REFUSED else (),
        cause=cause,
        unsaid=r"same driver, unit|in another unit",
    )


ROWS = (
    _of_arm(
        "goals_late", "goals of an arm are stamped early", r"about \d+ ms earlier", late_s=-0.06
    ),
    _of_arm(
        "goals_lead_more",
        "gain or supply of an arm's servos is another",
        r"the servos made about 0\.[78]\d? times .*P gain or supply",
        factor=1.35,
    ),
    _of_arm(
        "goals_clipped",
        "an elbow's servo keeps within limits of its own",
        r"servo of elbow_flex kept within|did not follow the goals as recorded",
        verdicts=VERDICTS,  # windows in which the goals were cut off are left out, or it is refused
        joint="elbow_flex",
        share=0.2,
    ),
    *(
        _instead(recording)
        for recording in (
            "sts3250_release_0.741kg",
            "sts3250_release_1.168kg",
            "xl330_kp100_sin_sin",
            "xl330_kp400_sin_time_square",
        )
    ),
    _heard("goals_clipped", "a servo keeps within limits of its own", REFUSED, share=0.18),
    _heard("goals_logged_clipped", "goals are cut off in the log", REFUSED, share=0.18),
    _heard("goals_offset", "goals count from another zero", (ACCEPTED,), off_rad=0.08),
    _heard("goals_late", "goals are stamped late", REFUSED, late_s=0.08),
    _heard("goals_late", "goals are stamped early", REFUSED, late_s=-0.05),
    _heard("goals_lead_more", "the servo's gain or supply is another", VERDICTS, factor=1.1),
    _heard("goals_lead_more", "the servo's gain or supply is another", REFUSED, factor=1.6),
)
