"""URDFs as people publish them: what is no body's, or nobody's, is read where it cannot matter, with a note, and refused elsewhere.

One small URDF of each kind that was met among public ones, each as a robot file that is read back.
"""

from __future__ import annotations

import importlib.util
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from support.small_urdf import INERTIAL, chain, joint, link

from proprio_ros.cli import main
from proprio_ros.errors import RobotError
from proprio_ros.identification.coefficients import link_stds
from proprio_ros.identification.regression.motion_equations import Arm
from proprio_ros.identification.regression.motion_prior import file_prior
from proprio_ros.inputs.resources import share_directory
from proprio_ros.pipeline.api import weigh
from proprio_ros.robot import RobotModel, load_robot, with_recorded_torque
from proprio_ros.robot.description import check_masses
from proprio_ros.robot.geometry import inertia_about_origin
from proprio_ros.robot.links import Spread
from proprio_ros.virtual.model import ArmModel
from proprio_ros.virtual.truth import Truth

AR5 = Path(__file__).resolve().parents[3] / "shared" / "recordings_real" / "models" / "ar5.urdf"
GONE = ""
SHAPE = '<visual><geometry><mesh filename="package://nowhere/finger.stl"/></geometry></visual>'
EFFORT = '<limit lower="-1" upper="1" effort="{}" velocity="0"/>'


def body(mass: str, moments: str = "0.01 0.01 0.01", products: str = "0 0 0") -> str:
    xx, yy, zz = moments.split()
    xy, xz, yz = products.split()
    return (
        f'<inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial>'
    )


def placed(text: str, xyz: str) -> str:
    """A joint away from its parent."""
    return text.replace("<parent", f'<origin xyz="{xyz}"/><parent', 1)


def arm(*further: str, hand: str = INERTIAL, **links: str) -> str:
    """Two links of 3 kg and a hand of 1 kg, each 0.4 m away, and what else is stated: joints, and links with their content."""
    joints = [
        joint("a"),
        placed(joint("b", "one", "two", axis="0 1 0"), "0.4 0 0"),
        placed(joint("c", "two", "hand", axis="0 1 0"), "0.4 0 0"),
    ]
    texts = [
        link("base"),
        link("one", body("3")),
        link("two", body("3")),
        link("hand", hand),
    ]
    texts += [link(name, content) for name, content in links.items()]
    return chain(*joints, *further, links="".join(texts))


def fixed(name: str, child: str, parent: str = "hand") -> str:
    return joint(name, parent, child, kind="fixed")


FINGERS = arm(
    placed(joint("f1", "hand", "finger1"), "0.05 0 0"),
    placed(joint("f2", "finger1", "finger2", mimic='<mimic joint="f1"/>'), "0.03 0 0"),
    placed(joint("f3", "finger2", "finger3", mimic='<mimic joint="f2" multiplier="0.5"/>'), "0.03 0 0"),
    finger1=SHAPE,
    finger2=SHAPE,
    finger3=SHAPE,
)  # fmt: skip
WRIST = arm(
    joint("d", "hand", "between"),
    joint("e", "between", "flange", axis="0 1 0"),
    between=GONE,
    flange=body("0.5"),
)
READ: dict[str, tuple[str, str]] = {
    "nothing is wrong": (arm(), ""),
    "impossible, but still": (
        arm(fixed("m", "mast", "base"), mast=body("1", "-0.02 0.05 0.1")),
        "",
    ),
    "a frame of mass 0 with an inertia": (
        arm(fixed("t", "tcp"), tcp=body("0", "1e-6 1e-6 1e-6")),
        "points of their mass, which is below a gram: tcp",
    ),
    "half a gram that cannot be": (
        arm(fixed("t", "tcp"), tcp=body("0.0005", "0 0 0")),
        "points of their mass, which is below a gram: tcp",
    ),
    "half a gram that reaches a metre": (
        arm(fixed("t", "tcp"), tcp=body("0.0005", "0.001 0.001 0.001")),
        "points of their mass, which is below a gram: tcp",
    ),
    "a thin rod": (arm(hand=body("1", "0 0.01 0.01")), ""),
    "a sum that was rounded": (arm(hand=body("1", "0.0123 0.0211 0.0334")), ""),
    "a sum that was rounded to two digits": (arm(hand=body("1", "0.012 0.021 0.034")), "nearest"),
    "noise for an inertia": (
        arm(hand=body("0.1", "-2e-35 0 2e-35")),
        "no inertia about the centre stated, taken as that of a ball as dense as water; at most 0.",
    ),
    "a mass alone": (
        arm(hand='<inertial><origin xyz="0.1 0 0"/><mass value="0.1"/></inertial>'),
        "no inertia about the centre stated",
    ),
    "a triangle inequality broken": (
        arm(hand=body("1", "0.001 0.001 0.01")),
        "no body has the inertia stated, taken as the nearest that one can have; at most 3.4 % of the torque at c: hand",
    ),
    "a negative moment": (arm(hand=body("1", "-0.001 0.005 0.006")), "nearest"),
    "fingers without inertia": (
        FINGERS,
        "no mass stated, taken as slender bodies as dense as water, known to a factor of two; at most 3.3 %",
    ),
    "axes that meet in one place": (WRIST, ""),
    "a wheel without inertia": (arm(joint("w", "base", "wheel"), wheel=SHAPE), "no mass stated"),
    "a frame that turns": (
        arm(joint("r", "hand", "finger"), finger=GONE),
        "left out, since nothing that moves with them has mass: r",
    ),
    "a wheel without limits": (
        arm(joint("w", "base", "wheel", limit='<limit effort="9" velocity="9"/>'), wheel=INERTIAL),
        "beside the arm, only read: w",
    ),
    "an upper limit alone": (
        arm(joint("w", "hand", "jaw", limit='<limit upper="0.5"/>'), jaw=INERTIAL),
        "state current_limit_A of: w",
    ),
    "an effort of nothing": (
        arm(joint("w", "hand", "jaw", limit=EFFORT.format("0")), jaw=INERTIAL),
        "state current_limit_A of: w",
    ),
    "an effort of 50000": (
        arm(joint("w", "hand", "jaw", limit=EFFORT.format("50000")), jaw=INERTIAL),
        "state current_limit_A of: w",
    ),
    "a slide of 10000 N": (
        arm(joint("w", "hand", "jaw", "prismatic", limit=EFFORT.format("10000")), jaw=INERTIAL),
        "",
    ),
    "a floating base": (
        arm(joint("world_joint", "world", "base", "floating"), world=GONE),
        "floating or planar, taken as fixed, so that what it carries must stand upright and still: world_joint",
    ),
    "a mimic of nothing": (
        arm(joint("w", "hand", "jaw", mimic='<mimic joint="index"/>'), jaw=INERTIAL),
        "mimic a joint that is not there, taken as joints of their own: w",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("urdf", "note"),
    READ.values(),
    ids=READ.keys(),
)
def test_it_becomes_a_robot_file_that_is_read_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], urdf: str, note: str
) -> None:
    (tmp_path / "arm.urdf").write_text(urdf)
    output = tmp_path / "new.yaml"
    words = ["robot", "new", str(tmp_path / "arm.urdf"), "--effort-unit", "N.m", "--json"]
    assert main([*words, "--output", str(output)]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any(note in each for each in notes) if note else not notes
    robot = load_robot(output, with_recorded_torque(output, {}))
    assert {"a", "b", "c"} <= set(robot.drive_trains)
    lines = output.read_text().splitlines()
    head = " ".join(line.lstrip("# ") for line in lines)
    for each in robot.model.notes:
        assert each in head
    # as it comes, and with all joints of the arm in motion
    bare = load_robot(tmp_path / "arm.urdf", with_recorded_torque(tmp_path / "arm.urdf", {}))
    assert bare.drive_trains.keys() <= robot.drive_trains.keys()
    others = dict.fromkeys(robot.model.independent_joints, 0.0)
    reduced = robot.model.lock(["a", "b", "c"], others)
    for pseudo in reduced.pseudo_inertia:
        assert np.linalg.eigvalsh(pseudo).min() > -1e-12
    if importlib.util.find_spec("mujoco"):
        ArmModel(robot, Truth({}), 1e-3).compiled(None)


REFUSED = {
    "all links, and what else is wrong": (
        arm(
            joint("d", "hand", "four", limit='<limit lower="1" upper="-1" effort="-2"/>'),
            *(joint(f"x{n}", "four", f"blade{n}") for n in range(30)),
            hand=body("-1"),
            four=body("2", "0.001 0.001 0.1"),
            **{f"blade{n}": SHAPE for n in range(30)},
        ),
        (
            "joint 'd': the lower limit 1.0 is above",
            "limits of velocity and effort must not be negative",
            "link hand: the mass is negative",
            "link four: no body has this inertia",
            ", ".join(f"blade{n}" for n in range(30)) + ": <inertial> is missing",
        ),
    ),
    "numbers that are none": (
        arm(hand=body("heavy"), spare=body("nan")),
        ("value='heavy' of <mass> is no number", "value='nan' of <mass> must be finite"),
    ),
    "the last link of an arm without inertia": (
        arm(hand=SHAPE),
        ("link hand: <inertial> is missing; state mass, centre and inertia",),
    ),
    "a link between without inertia": (
        arm(placed(joint("d", "hand", "four"), "0.2 0 0"), hand=SHAPE, four=INERTIAL),
        ("link hand: <inertial> is missing",),
    ),
    "fingers as heavy as the arm": (
        FINGERS.replace("0.03 0 0", "0.4 0 0"),
        ("links finger1, finger2, finger3: <inertial> is missing, and is more than all of the torque at ",),
    ),
    "an inertia that matters": (
        arm(hand=body("1", "0.1 0.1 1")),
        ("link hand: no body has this inertia", " % of the torque at c"),
    ),
    "a ball that an arm carries": (
        arm(joint("free", "hand", "ball", "floating"), ball=INERTIAL),
        ("joint 'free' carries what is not fixed to 'hand', which moves",),
    ),
    "an arm without any mass": (
        chain(
            joint("a"),
            joint("b", "one", "two"),
            links=link("base") + link("one", SHAPE) + link("two", SHAPE),
        ),
        ("links one, two: <inertial> is missing",),
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("urdf", "messages"),
    REFUSED.values(),
    ids=REFUSED.keys(),
)
def test_where_it_matters_all_is_refused_in_one_line(urdf: str, messages: tuple[str, ...]) -> None:
    with pytest.raises(RobotError) as caught:
        check_masses(RobotModel.from_urdf_string(urdf), "URDF")
    assert "\n" not in str(caught.value)
    for message in messages:
        assert message in str(caught.value)


def test_a_link_without_inertia_can_be_held_and_not_moved() -> None:
    """As a robot file may state it; between axes that meet in one place there is nothing to state."""
    urdf, _ = REFUSED["a link between without inertia"]
    model = RobotModel.from_urdf_string(urdf)
    held = model.lock(["a", "b", "d"], {"c": 0.0})
    assert held.joint_names == ("a", "b", "d")
    with pytest.raises(RobotError, match="nothing that moves with joint 'c' of arm has mass"):
        model.lock(["a", "c", "d"], {"b": 0.0})
    model = RobotModel.from_urdf_string(WRIST)
    reduced = model.lock(["a", "b", "c", "d", "e"], {})
    assert list(reduced.pseudo_inertia[3:, 3, 3]) == [0.0, 0.5]


def test_a_robot_file_wants_the_mass_of_what_its_joints_move(tmp_path: Path) -> None:
    """It counted as nothing. What hangs beside the arm, or before its joints, may weigh what it does."""
    beside = joint("e", "base", "beside")
    links = {"hand": SHAPE, "four": INERTIAL, "beside": SHAPE}
    urdf = arm(placed(joint("d", "hand", "four"), "0.2 0 0"), beside, **links)
    (tmp_path / "arm.urdf").write_text(urdf)
    motor = "{motor: {nominal_torque_constant_N_m_per_A: 1.0}}"

    def stated(*joints: str) -> Path:
        lines = ["name: arm\nurdf: arm.urdf\npayload_frame: four\njoints:"]
        path = tmp_path / f"{'_'.join(joints)}.yaml"
        path.write_text("\n".join([*lines, *(f"  {name}: {motor}" for name in joints)]) + "\n")
        return path

    with pytest.raises(RobotError, match=r"a_b\.yaml: arm\.urdf: link hand: <inertial> is missing"):
        load_robot(stated("a", "b"))
    assert tuple(load_robot(stated("d")).drive_trains) == ("d",)


Body = tuple[float, np.ndarray, np.ndarray, Spread]


def links_of(urdf: str) -> dict[str, Body]:
    """By link its mass, centre, inertia about it, and how far it may lie off."""
    found = {}
    for each in RobotModel.from_urdf_string(urdf).links:
        pseudo = np.array(each.pseudo_inertia)
        mass = float(pseudo[3, 3])
        centre = pseudo[:3, 3] / mass if mass else np.zeros(3)
        pseudo[:3, :3] -= mass * np.outer(centre, centre)
        found[each.name] = (mass, centre, inertia_about_origin(pseudo), each.spread)
    return found


def test_the_nearest_body_keeps_mass_and_centre() -> None:
    """S = diag(0.005, 0.005, -0.004) loses its last moment; the largest of inertia stays 0.01, the others rise to 0.005."""
    mass, centre, inertia, spread = links_of(arm(hand=body("1", "0.001 0.001 0.01")))["hand"]
    assert mass == 1.0
    np.testing.assert_allclose(centre, [0.1, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(inertia, np.diag([0.005, 0.005, 0.01]), atol=1e-15)
    assert spread == Spread(inertia=pytest.approx(0.4))


def test_no_other_body_is_nearer() -> None:
    stated = np.diag([-0.001, 0.005, 0.006])
    stated[0, 1] = stated[1, 0] = 0.002
    stated[1, 2] = stated[2, 1] = 0.001
    text = body("1", "-0.001 0.005 0.006", "0.002 0 0.001")
    _, _, inertia, _ = links_of(arm(hand=text))["hand"]

    def second(of: np.ndarray) -> np.ndarray:
        return 0.5 * np.trace(of) * np.eye(3) - of

    least = np.linalg.norm(second(inertia) - second(stated))
    near = np.linalg.cholesky(second(inertia) + 1e-9 * np.eye(3))
    rng = np.random.default_rng(1)
    for size in np.geomspace(1e-5, 1e-2, 2000):
        root = near + size * rng.normal(size=(3, 3))
        assert np.linalg.norm(root @ root.T - second(stated)) >= least - 1e-9


def test_what_is_taken_has_a_wider_prior(tmp_path: Path) -> None:
    """A finger's mass is known to a factor of two, and so is the body that it belongs to; what is stated stays as it was."""
    (tmp_path / "arm.urdf").write_text(FINGERS)
    path = tmp_path / "arm.urdf"
    robot = load_robot(path, with_recorded_torque(path, {}))
    links = {each.name: each for each in robot.model.links}
    mass = links["finger1"].pseudo_inertia[3, 3]
    # a quarter as thick as long, to the next joint
    assert mass == pytest.approx(1000.0 / 16.0 * 0.03**3)
    wide = link_stds(robot, links["finger1"])["link_mass"]
    assert wide == pytest.approx(math.hypot(1.0, 0.05))
    assert link_stds(robot, links["two"])["link_mass"] == robot.link_mass_std
    joints = ["a", "b", "c"]
    known = {}
    for name, text in (("taken", FINGERS), ("stated", arm())):
        path.write_text(text)
        robot = load_robot(path, with_recorded_torque(path, {}))
        model = Arm.of(robot, joints, dict.fromkeys(robot.model.independent_joints, 0.0))
        covariance = file_prior(robot, model).covariance
        known[name] = math.sqrt(covariance[20, 20])  # mass of the third body
    assert known["taken"] > known["stated"]


def test_a_wheel_turns_without_end_and_one_limit_is_zero() -> None:
    wheel, _ = READ["a wheel without limits"]
    read = RobotModel.from_urdf_string(wheel).joint("w")
    assert read.kind == "continuous"
    assert (read.lower, read.upper) == (-math.inf, math.inf)
    jaw, _ = READ["an upper limit alone"]
    read = RobotModel.from_urdf_string(jaw).joint("w")
    assert (read.kind, read.lower, read.upper) == ("revolute", 0.0, 0.5)
    nothing = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
    read = RobotModel.from_urdf_string(
        arm(joint("w", "hand", "jaw", limit=nothing), jaw=INERTIAL)
    ).joint("w")
    assert read.kind == "revolute"
    assert (read.lower, read.upper) == (-math.inf, math.inf)


def test_an_effort_of_50000_says_nothing_of_friction(tmp_path: Path) -> None:
    """A tenth of it would be more than any arm holds."""
    spreads = []
    for effort in ("0", "50000"):
        limit = EFFORT.format(effort)
        text = arm(joint("w", "hand", "jaw", limit=limit), jaw=INERTIAL)
        (tmp_path / "arm.urdf").write_text(text)
        path = tmp_path / "arm.urdf"
        robot = load_robot(path, with_recorded_torque(path, {}))
        spreads.append(robot.drive_trains["w"].coulomb.std)
    assert spreads[0] == spreads[1] < 10.0


@pytest.mark.skipif(not AR5.exists(), reason="needs the real recordings")
def test_a_tool_frame_of_mass_0_does_not_matter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "ar5.yaml"
    words = ["robot", "new", str(AR5), "--effort-unit", "N.m", "--output", str(output)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert (
        "note: taken as points of their mass, which is below a gram: AR5-5_07R-W4C4A2_tcp" in said
    )
    robot = load_robot(output, with_recorded_torque(output, {}))
    assert len(robot.drive_trains) == 7
    without = AR5.read_text().replace("<tcp/>", "")
    at = without.index('<link name="AR5-5_07R-W4C4A2_tcp">')
    bare = (
        without[:at]
        + '<link name="AR5-5_07R-W4C4A2_tcp"/>'
        + without[without.index("</link>", at) + 7 :]
    )
    assert RobotModel.from_urdf_string(bare).fingerprint() == robot.model.fingerprint()


@pytest.mark.long
@pytest.mark.skipif(not AR5.exists(), reason="needs the real recordings")
def test_a_mended_link_moves_no_answer(tmp_path: Path) -> None:
    """A UR10e with 2.805 kg in its hand, as weighed by the URDF and by one whose second wrist is no body."""
    recordings = AR5.parents[1]
    share = share_directory()
    urdf = (share / "urdf" / "ur10e.urdf").read_text()
    settings = (share / "config" / "robots" / "ur10e.yaml").read_text()
    settings = re.sub(r"(?m)^urdf: .*$", "urdf: ur10e.urdf", settings)
    (tmp_path / "ur10e.yaml").write_text(settings)
    found = []
    for text in (urdf, urdf.replace('izz="0.002005"', 'izz="0.02"')):
        (tmp_path / "ur10e.urdf").write_text(text)
        answer = weigh(
            recordings / "ur10e_loaded_14",
            baseline=recordings / "ur10e_empty_14",
            probe="payload",
            robot=str(tmp_path / "ur10e.yaml"),
            driver="ur_current",
        )
        found.append(answer.values["payload_mass"])
        low, high = found[-1].ci95
        assert low < 2.805 < high
        assert any("URDF: no body" in note for note in answer.estimate.notes) == (text != urdf)
    as_stated, mended = (each.value for each in found)
    assert as_stated != mended
    assert mended == pytest.approx(as_stated, abs=0.01)
