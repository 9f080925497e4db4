"""Which way efforts count, in every form in which it is stated."""

from __future__ import annotations

import pytest

from proprio_ros.inputs.forms import FormError
from proprio_ros.inputs.signs import EFFORT_SIGN, Signs


@pytest.mark.parametrize(
    ("stated", "elbow", "wrist"),
    [
        (-1, -1, -1),
        (1, 1, 1),
        ("-1", -1, -1),
        ({"elbow": -1}, -1, 1),
        ("elbow=-1", -1, 1),
        ("-1,elbow=1", 1, -1),
        ("elbow=-1, wrist=+1", -1, 1),
    ],
)
def test_all_joints_or_joint_by_joint(stated: object, elbow: int, wrist: int) -> None:
    signs = EFFORT_SIGN.read(stated)
    assert (signs.of("elbow"), signs.of("wrist")) == (elbow, wrist)
    again = EFFORT_SIGN.read(str(signs))
    assert (again.of("elbow"), again.of("wrist")) == (elbow, wrist)


@pytest.mark.parametrize(
    "stated",
    [
        0,
        2,
        -1.5,
        "",
        "x",
        "elbow",
        "elbow=2",
        "a=-1,a=1",
        "-1,1,1",
        "1,-1",
        True,
        None,
        [1],
        {"a": "b"},
        {},
    ],
)
def test_anything_else_is_refused(stated: object) -> None:
    with pytest.raises(FormError):
        EFFORT_SIGN.read(stated)


def test_what_is_stated_nearer_wins() -> None:
    """A number states all joints; a joint that is named states itself, and leaves the others as they were."""
    profile = Signs(-1)
    assert Signs().over(profile).of("elbow") == -1
    assert Signs(1).over(profile).of("elbow") == 1
    one = EFFORT_SIGN.read("elbow=1").over(profile)
    assert (one.of("elbow"), one.of("wrist")) == (1, -1)
    assert one.turned(["elbow", "wrist"]) == ("wrist",)
