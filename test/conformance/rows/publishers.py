"""Who else publishes."""

from __future__ import annotations

from conformance.table import ACCEPTED, VERDICTS, Bent, Row

_SECTION = "D. Who else publishes"
_SAID = r"publish|zeros|copies|copy|twice|another source"

ROWS = (
    *(
        Row(
            name=f"zeros_{when}_each_message",
            section=_SECTION,
            trouble=f"a joint_state_publisher sends zeros with the same stamps, {when} each message",
            base="ur10e",
            bends=(Bent("zeros_with_the_same_stamps", {"lag_us": lag, "effort": effort}),),
            verdicts=(ACCEPTED,),
            cause=_SAID,
            said_if=VERDICTS,
            unsaid=r"no input current|is the file damaged",
            narrow=0.25,
        )
        for when, lag, effort in (("before", -50, False), ("after", 50, True))
    ),
    Row(
        name="zeros_between",
        section=_SECTION,
        trouble="it sends them at times of its own, ten times less often",
        base="ur10e",
        bends=(
            Bent(
                "zeros_at_times_of_its_own",
                {"rate": 10, "at": 0.5},
            ),
        ),
        verdicts=(ACCEPTED,),
        cause=_SAID,
        said_if=VERDICTS,
        unsaid=r"is the file damaged",
        narrow=0.25,
    ),
    Row(
        name="gripper_more_often",
        section=_SECTION,
        trouble="a gripper's driver publishes its finger on the arm's topic, twice as often",
        base="ur10e",
        bends=(Bent("gripper_publishes_more_often", {"times": 2}),),
        verdicts=(ACCEPTED,),
        narrow=0.25,
    ),
    Row(
        name="stale_copies",
        section=_SECTION,
        trouble="a relay repeats what it heard five samples ago, with stamps of now",
        base="ur10e",
        bends=(Bent("stale_copies", {"samples": 5}),),
        verdicts=(ACCEPTED,),
        cause=_SAID,
        said_if=VERDICTS,
        narrow=0.3,
    ),
    Row(
        name="every_message_twice",
        section=_SECTION,
        trouble="two bridges: each message comes twice",
        base="ur10e",
        bends=(Bent("every_message_twice"),),
        verdicts=(ACCEPTED,),
        cause=r"stamps are repeated|" + _SAID,
        said_if=VERDICTS,
        narrow=0.25,
    ),
    Row(
        name="lists_doubled",
        section=_SECTION,
        trouble="a relay appends what it heard to its own list: every joint stands twice in each message",
        base="ur10e",
        bends=(Bent("lists_doubled"),),
        verdicts=(ACCEPTED,),
        cause=r"named twice|" + _SAID,
        said_if=VERDICTS,
        narrow=0.25,
    ),
    Row(
        name="copies_in_another_order",
        section=_SECTION,
        trouble="a second publisher repeats positions alone, its joints in another order",
        base="ur10e",
        bends=(Bent("copies_in_another_order", {"order": "reversed"}),),
        verdicts=(ACCEPTED,),
        cause=r"stamps are repeated|lack some|" + _SAID,
        said_if=VERDICTS,
        narrow=0.25,
    ),
    Row(
        name="mounted_on_a_wall",
        section=_SECTION,
        trouble="the arm hangs from the ceiling, and the file says that it stands",
        base="ur10e",
        more=("--set", "robot.gravity=[0,0,9.81]"),
        verdicts=("rejected", "not_identifiable"),
        cause=r"gravity|mounted",
    ),
    Row(
        name="tilted_by_10_degrees",
        section=_SECTION,
        trouble="the arm is tilted by 10 degrees, and the file does not say so",
        base="ur10e",
        more=("--set", "robot.gravity=[1.7035,0,-9.661]"),
        cause=r"gravity|tilt|mounted",
    ),
)
