"""Clocks that step, that are not set and that count; samples that come in bursts, of motions and of pushes."""

from __future__ import annotations

from conformance.table import ACCEPTED, REFUSED, VERDICTS, Bent, Row

_SECTION = "A. The time axis"
_MOTION = "ur10e"
_PUSH = "push_light_ball_20g_joint3_calibrated"


def _one_clock_is_whole(
    kind: str,
    base: str,
) -> tuple[Row, ...]:
    """Troubles that the other clock mends, of a motion or of a push."""
    return (
        Row(
            name=f"{kind}_headers_step_forward",
            section=_SECTION,
            trouble="a time service sets the clock of the headers forward after the drivers have started",
            base=base,
            bends=(
                Bent(
                    "header_clock_steps",
                    {"step_s": 3.2, "at": 0.4},
                ),
            ),
            verdicts=(ACCEPTED,),
            cause=r"header stamps step by \+3.2 s",
            said_if=VERDICTS,
            unsaid="damaged",
        ),
        Row(
            name=f"{kind}_recorder_steps",
            section=_SECTION,
            trouble="the recorder's clock alone is set, forward",
            base=base,
            bends=(
                Bent(
                    "recorder_clock_steps",
                    {"step_s": 2.0, "at": 0.5},
                ),
            ),
            verdicts=(ACCEPTED,),
            cause=r"recorder's clock steps by",
            said_if=VERDICTS,
            unsaid="damaged",
        ),
        Row(
            name=f"{kind}_bursts_of_the_recorder",
            section=_SECTION,
            trouble="messages are recorded ten at a time, under stamps that are even",
            base=base,
            bends=(
                Bent(
                    "bursts_stamped_at_arrival",
                    {"size": 10, "headers": False},
                ),
            ),
            verdicts=(ACCEPTED,),
            unsaid="damaged",
        ),
    )


ROWS = (
    *(
        Row(
            name=f"{base}_stretched_{factor}",
            section=_SECTION,
            trouble=f"a loop runs {factor} times as fast as it stamps; velocities are the driver's own",
            base=base,
            bends=(
                Bent("clock_at_another_pace", {"factor": factor, "velocity": "true"}, ("loaded",)),
            ),
            verdicts=REFUSED,
            cause="time axis is stretched",
        )
        for base in (
            _PUSH,
            "push_heavy_ball_50g_joint3_calibrated",
            "driven_up_and_down_0.535",
        )
        for factor in (0.73, 0.85, 1.2)
    ),
    *(
        row
        for kind, base in (("motion", _MOTION), ("push", _PUSH))
        for row in _one_clock_is_whole(kind, base)
    ),
    Row(
        name="push_headers_step_back",
        section=_SECTION,
        trouble="a time service sets the robot's clock back after the drivers have started",
        base=_PUSH,
        bends=(
            Bent(
                "header_clock_steps",
                {"step_s": -3.2, "at": 0.5},
            ),
        ),
        verdicts=(ACCEPTED,),
        cause=r"header stamps step by -3.2 s",
        said_if=VERDICTS,
        unsaid="damaged",
    ),
    *(
        Row(
            name=f"push_both_step_{way}",
            section=_SECTION,
            trouble=f"both clocks are set {way}",
            base=_PUSH,
            bends=(Bent("clock_steps", {"step_s": step_s, "at": 0.5}),),
            verdicts=VERDICTS,
            cause=r"clock steps?",
            said_if=VERDICTS,
            unsaid="damaged",
        )
        for way, step_s in (("back", -3.2), ("forward", 3.2))
    ),
    Row(
        name="push_bursts",
        section=_SECTION,
        trouble="messages are stamped as they arrive, five at a time",
        base=_PUSH,
        bends=(
            Bent(
                "bursts_stamped_at_arrival",
                {"size": 5, "headers": True},
            ),
        ),
        verdicts=(ACCEPTED,),
        cause=r"come in bursts",
        said_if=VERDICTS,
        unsaid="damaged",
    ),
    Row(
        name="push_row_numbers",
        section=_SECTION,
        trouble="the time is the number of the row",
        base=_PUSH,
        bends=(Bent("row_number_for_a_time", {}),),
        verdicts=REFUSED,
        cause=r"row numbers",
        unsaid="damaged",
    ),
    Row(
        name="push_samples_held",
        section=_SECTION,
        trouble="each reading is published three times",
        base=_PUSH,
        bends=(Bent("samples_held", {"rate": 3}),),
        verdicts=(ACCEPTED,),
        unsaid="damaged",
    ),
    Row(
        name="push_rate_changes",
        section=_SECTION,
        trouble="half as many messages come from the middle on",
        base=_PUSH,
        bends=(
            Bent(
                "rate_changes",
                {"ratio": 2, "at": 0.5},
            ),
        ),
        verdicts=(ACCEPTED,),
        unsaid="damaged",
    ),
    Row(
        name="push_zeros_throughout",
        section=_SECTION,
        trouble="/clock is never heard",
        base=_PUSH,
        bends=(Bent("stamps_of_zero_first", {"count": 500}),),
        verdicts=REFUSED,
        cause=r"clock stood still",
        unsaid="damaged",
    ),
    Row(
        name="motion_polled",
        section=_SECTION,
        trouble="messages are stamped as they arrive, when somebody polls",
        base=_MOTION,
        bends=(
            Bent(
                "stamped_when_polled",
                {"every_ms": 47.0, "scatter": 0.1},
            ),
        ),
        verdicts=(ACCEPTED,),
        cause=r"come in bursts",
        said_if=VERDICTS,
        unsaid="damaged",
    ),
    Row(
        name="motion_positions_held",
        section=_SECTION,
        trouble="positions are read less often than efforts",
        base=_MOTION,
        bends=(
            Bent(
                "one_register_held",
                {"rate": 5, "field": "position"},
            ),
        ),
        verdicts=(ACCEPTED,),
        unsaid="damaged",
    ),
    Row(
        name="motion_efforts_held",
        section=_SECTION,
        trouble="efforts are read less often than positions",
        base=_MOTION,
        bends=(
            Bent(
                "one_register_held",
                {"rate": 5, "field": "effort"},
            ),
        ),
        verdicts=(ACCEPTED,),
        unsaid="damaged",
    ),
)
