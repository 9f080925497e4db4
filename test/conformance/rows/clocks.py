"""The time axis."""

from __future__ import annotations

from conformance.table import ACCEPTED, UNREADABLE, VERDICTS, Bent, Row

_SECTION = "A. The time axis"
_CLOCK = r"clock|stamp|time axis|time scale|Hz"
_DAMAGED = r"is the file damaged"
_LOADED = ("loaded",)
_TOLD = (ACCEPTED, "too_wide")


def _pace(
    factor: float,
    velocity: str,
    of: tuple[str, ...] = ("loaded", "empty"),
) -> Bent:
    return Bent("clock_at_another_pace", {"factor": factor, "velocity": velocity}, of)


ROWS = (
    Row(
        name="as_it_is",
        section=_SECTION,
        trouble="nothing is wrong",
        base="ur10e",
        verdicts=(ACCEPTED,),
        narrow=0.25,
    ),
    *(
        Row(
            name=f"pace_{factor}_{velocity}",
            section=_SECTION,
            trouble=f"a recorder stamps frame / fps, and its loop runs {factor} times as fast; {words}",
            base="ur10e",
            bends=(_pace(factor, velocity),),
            cause=_CLOCK,
            said_if=VERDICTS,
        )
        for factor in (0.5, 0.7, 0.73, 0.83, 1.3)
        for velocity, words in (
            ("none", "positions and efforts alone"),
            ("true", "the velocities are the driver's own"),
        )
    ),
    *(
        Row(
            name=f"pace_{factor}_loaded_alone",
            section=_SECTION,
            trouble=f"the same of the loaded recording alone, {factor} times as fast",
            base="ur10e",
            bends=(_pace(factor, "none", _LOADED),),
            cause=_CLOCK,
            said_if=VERDICTS,
        )
        for factor in (0.73, 1.4)
    ),
    Row(
        name="clock_stepped_back",
        section=_SECTION,
        trouble="a time service steps the clock back by 3.2 s in the middle, after the drivers have started",
        base="ur10e",
        bends=(
            Bent(
                "clock_steps",
                {"step_s": -3.2, "at": 0.5},
            ),
        ),
        verdicts=_TOLD,
        cause=r"clock|step",
        said_if=VERDICTS,
        unsaid=_DAMAGED,
        narrow=0.4,
    ),
    Row(
        name="clock_stepped_forward",
        section=_SECTION,
        trouble="the clock steps forward by 4 s, in the loaded recording alone",
        base="ur10e",
        bends=(
            Bent(
                "clock_steps",
                {"step_s": 4.0, "at": 0.4},
                _LOADED,
            ),
        ),
        verdicts=_TOLD,
        cause=r"clock|step|gap",
        said_if=VERDICTS,
        narrow=0.4,
    ),
    Row(
        name="header_clock_stepped",
        section=_SECTION,
        trouble="the clock of the headers alone steps by -3.2 s in the middle; the recorder's is whole",
        base="ur10e",
        bends=(
            Bent(
                "header_clock_steps",
                {"step_s": -3.2, "at": 0.5},
            ),
        ),
        verdicts=_TOLD,
        cause=r"clock|step",
        said_if=VERDICTS,
        unsaid=r"% (too )?(fast|slow)|" + _DAMAGED,
        narrow=0.4,
    ),
    Row(
        name="zeros_before_the_clock",
        section=_SECTION,
        trouble="time is 0 until /clock is heard: the first 200 messages are stamped and recorded at 0",
        base="ur10e",
        bends=(Bent("stamps_of_zero_first", {"count": 200}),),
        verdicts=(ACCEPTED,),
        cause=r"clock|stamp|time",
        said_if=VERDICTS,
        unsaid=r"lie in gaps",
        narrow=0.25,
    ),
    Row(
        name="effort_30_ms_late",
        section=_SECTION,
        trouble="the effort's own filter or bus is 3 samples behind",
        base="ur10e",
        bends=(Bent("effort_late", {"samples": 3}),),
        verdicts=(ACCEPTED,),
        cause=r"late|behind|lag",
        said_if=VERDICTS,
        narrow=0.36,
    ),
    Row(
        name="effort_100_ms_late",
        section=_SECTION,
        trouble="the effort's own filter or bus is 10 samples behind",
        base="ur10e",
        bends=(Bent("effort_late", {"samples": 10}),),
        cause=r"late|behind|lag",
        said_if=VERDICTS,
        unsaid=r"held firmly",
    ),
    Row(
        name="row_number_for_a_time",
        section=_SECTION,
        trouble="the time is the row's number: stamps 0, 1, 2 .. s",
        base="ur10e",
        bends=(Bent("row_number_for_a_time"),),
        verdicts=(UNREADABLE,),
        cause=r"row|number|count|index",
    ),
    Row(
        name="bursts",
        section=_SECTION,
        trouble="messages come in bursts of 20 and are stamped as a burst arrives",
        base="ur10e",
        bends=(
            Bent(
                "bursts_stamped_at_arrival",
                {"size": 20, "headers": True},
            ),
        ),
        cause=r"burst|stamp|arriv|clock",
        unsaid=_DAMAGED,
    ),
    Row(
        name="held_at_a_fifth",
        section=_SECTION,
        trouble="registers are read at a fifth of the rate at which they are published",
        base="ur10e",
        bends=(Bent("samples_held", {"rate": 5}),),
        verdicts=_TOLD,
    ),
    Row(
        name="rate_changes",
        section=_SECTION,
        trouble="from the middle on every third message is left",
        base="ur10e",
        bends=(
            Bent(
                "rate_changes",
                {"ratio": 3, "at": 0.5},
            ),
        ),
        verdicts=_TOLD,
    ),
)
