"""URDF text: the defaults of the format, and what users get wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from support.small_urdf import chain, inertial, joint, link

from proprio_ros.errors import RobotError
from proprio_ros.robot import RobotModel

BAD_URDF = {
    "not XML": ("joint: revolute", "not XML"),
    "empty": ("", "not XML"),
    "another document": ("<mujoco/>", "a <mujoco>, not a <robot>"),
    "xacro": ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>', "xacro"),
    "no links": ("<robot/>", "no <link>"),
    "nameless link": ("<robot><link/></robot>", "a <link> has no name"),
    "no kind": (chain(joint("a", kind="")), "type '' is not supported"),
    "negative mass": (
        inertial(mass="-1"),
        "link one: the mass is negative; state mass, centre and inertia",
    ),
    "NaN mass": (inertial(mass="nan"), "value='nan' of <mass> must be finite"),
    "mass is no number": (inertial(mass="heavy"), "value='heavy' of <mass> is no number"),
    "two masses": (inertial(mass="1 2"), "value of <mass> must be one number, got 2"),
    "infinite inertia": (inertial(ixx="inf"), "ixx='inf' of <inertia> must be finite"),
    "zero inertia": (
        inertial(ixx="0", iyy="0", izz="0"),
        "link one: the inertia about the centre is missing, and is 67 % of the torque at a;",
    ),
    "indefinite": (inertial(ixy="0.02"), "link one: no body has this inertia (a negative moment"),
    "triangle": (
        inertial(izz="0.03"),
        "one above the sum of the other two), and is 17 % of the torque at a",
    ),
    "triangle by products": (inertial(ixx="0.02", ixy="0.009"), "no body has this inertia"),
    "inertia without izz": (
        chain(joint("a")).replace(' izz="0.01"', ""),
        "<inertia> has no izz",
    ),
    "unknown parent": (
        chain(joint("a", parent="bsae")),
        "joint 'a' names an unknown parent link 'bsae'; links: base, one",
    ),
    "unknown child": (chain(joint("a", child="hand")), "unknown child link 'hand'"),
    "no parent": (
        chain(joint("a").replace('<parent link="base"/>', "")),
        "joint 'a': has no <parent link=.../>",
    ),
    "two links of a name": (
        chain(
            joint("a"),
            links=link("base") + link("one") + link("one"),
        ),
        "two links are named 'one'",
    ),
    "two joints of a name": (
        chain(joint("a"), joint("a", "one", "two")),
        "two joints are named 'a'",
    ),
    "two parents": (
        chain(
            joint("a"),
            joint("b", "base", "two"),
            joint("c", "one", "two"),
        ),
        "child of both 'b' and 'c'",
    ),
    "all in a loop": (
        chain(
            joint("a"),
            joint("b", "one", "base"),
            links=link("base") + link("one"),
        ),
        "no link is the root",
    ),
    "loop apart": (
        chain(
            joint("a"),
            joint("b", "two", "three"),
            joint("c", "three", "two"),
        ),
        "joints b, c form a loop",
    ),
    "two roots": (
        chain(
            joint("a"),
            links=link("base") + link("one") + link("world"),
        ),
        "no parent: base, world",
    ),
    "limits crossed": (
        chain(joint("a", limit='<limit lower="1" upper="-1"/>')),
        "above the upper limit",
    ),
    "limit is NaN": (
        chain(joint("a", limit='<limit lower="nan" upper="1"/>')),
        "lower='nan' of <limit> must be finite",
    ),
    "negative effort": (
        chain(joint("a", limit='<limit lower="0" upper="1" effort="-1"/>')),
        "must not be negative",
    ),
    "zero axis": (chain(joint("a", axis="0 0 0")), "joint 'a': the axis is zero"),
    "flat axis": (chain(joint("a", axis="0 1")), "xyz of <axis> must be three numbers, got 2"),
    "NaN axis": (chain(joint("a", axis="0 0 nan")), "must be finite"),
    "mimic without a joint": (chain(joint("a", mimic="<mimic/>")), "<mimic> names no joint"),
    "mimic of fixed": (
        chain(
            joint("a", kind="fixed"),
            joint("b", "one", "two", mimic='<mimic joint="a"/>'),
        ),
        "'b' mimics 'a', which is fixed",
    ),
    "weight of a mountain": (
        inertial(mass="1e300"),
        "value='1e300' of <mass> is over 10000: units are kg, m and rad",
    ),
    "a name that ends a line": (
        chain(joint("a")).replace('"base"', '"ba&#10;accepted 1 g"'),
        "the name 'ba\\naccepted 1 g' of a <link> is not printable",
    ),
    "a name without end": (chain(joint("a" * 300)), "is not printable, or too long"),
    "more links than can be read": (
        chain(*(joint(f"j{n}", "base", f"l{n}") for n in range(300))),
        "has 300 joints, and 256 are the most",
    ),
    "a text without end": ("<robot>" + " " * 2_000_001, "has over 2 MB"),
    "mimics in a circle": (
        chain(
            joint("a", mimic='<mimic joint="b"/>'),
            joint("b", "one", "two", mimic='<mimic joint="a"/>'),
        ),
        "mimic each other in a circle: a -> b -> a",
    ),
}


@pytest.mark.parametrize("mass", ["1e-9", "0", "0.0"])
def test_a_frame_that_an_exporter_gave_a_speck_of_mass_has_none(mass: str) -> None:
    """As in the makers' own file of the SO-101, which is refused otherwise."""
    none = dict.fromkeys(("ixx", "iyy", "izz"), "0")
    (link_one,) = (
        each
        for each in RobotModel.from_urdf_string(inertial(mass=mass, **none)).links
        if each.name == "one"
    )
    assert not link_one.pseudo_inertia.any()


@pytest.mark.parametrize(
    ("urdf", "message"),
    BAD_URDF.values(),
    ids=BAD_URDF.keys(),
)
def test_bad_urdf_is_refused_in_one_line(urdf: str, message: str) -> None:
    with pytest.raises(RobotError) as caught:
        RobotModel.from_urdf_string(urdf)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_urdf_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"arm\.urdf: cannot be read \(No such file"):
        RobotModel.from_urdf(tmp_path / "arm.urdf")


def test_rounded_inertia_on_the_edge_is_accepted() -> None:
    """A thin disc has izz = ixx + iyy exactly; sums in other digits may be off in the last one."""
    RobotModel.from_urdf_string(inertial(ixx="0.1", iyy="0.2", izz="0.30000000000000004"))


def test_defaults_of_the_format() -> None:
    model = RobotModel.from_urdf_string(
        chain(joint("a", kind="continuous", limit="").replace('<axis xyz="0 0 1"/>', ""))
    )
    turning = model.joint("a")
    np.testing.assert_array_equal(turning.axis, [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(turning.origin, np.eye(4))
    assert (turning.lower, turning.upper) == (-math.inf, math.inf)
    assert (turning.velocity_limit, turning.effort_limit) == (math.inf, math.inf)
    assert model.lock(["a"], {}).kinds == ("revolute",)


@pytest.mark.parametrize("effort", ["0", "0.0", "-0.0"])
def test_a_limit_of_nothing_is_none_that_was_stated(effort: str) -> None:
    """As many exporters write it; a motor that may do nothing moves nothing."""
    limit = f'<limit lower="-1" upper="1" effort="{effort}" velocity="{effort}"/>'
    (read,) = RobotModel.from_urdf_string(chain(joint("a", limit=limit))).joints
    assert (read.velocity_limit, read.effort_limit) == (math.inf, math.inf)
    assert (read.lower, read.upper) == (-1.0, 1.0)


def test_axis_is_made_a_unit_vector() -> None:
    np.testing.assert_allclose(
        RobotModel.from_urdf_string(chain(joint("a", axis="0 3 4"))).joint("a").axis, [0, 0.6, 0.8]
    )
