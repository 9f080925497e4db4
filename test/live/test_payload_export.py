"""What a controller is told: frames against a transform done by hand, both bodies together against MuJoCo, units and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from proprio_ros.errors import ConfigurationError, RobotError
from proprio_ros.live.payload_export import CONTROLLERS, check_tool, load_at, together
from proprio_ros.probes.base import Carried
from proprio_ros.robot import Robot, load_robot

# the flange looks along y of the rod; the tip, which holds, is 0.1 m along the flange's z, a quarter turn further
URDF = """<robot name="arm"><link name="base"/>
<joint name="elbow" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="3" effort="5"/></joint>
<link name="rod"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="to_tool0" type="fixed"><parent link="rod"/><child link="tool0"/>
<origin xyz="0 0 0.3" rpy="-1.5707963267948966 0 0"/></joint>
<link name="tool0"/>
<joint name="to_tip" type="fixed"><parent link="tool0"/><child link="tip"/>
<origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/></joint>
<link name="tip"/></robot>
"""
LOAD = Carried(
    0.5,
    [0.01, 0.02, 0.03],
    np.diag([1e-3, 2e-3, 3e-3]),
)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    (tmp_path / "arm.urdf").write_text(URDF)
    return load_robot(
        tmp_path / "arm.urdf",
        {"payload_frame": "tip", "joints.elbow.motor.nominal_torque_constant_N_m_per_A": 1.0},
    )


def test_the_flange_sees_the_load_turned_and_shifted(robot: Robot) -> None:
    load = load_at(robot, LOAD, "tool0")
    # x of the tip is y of the flange, y of the tip is its -x
    assert np.allclose(load.com_m, [-0.02, 0.01, 0.13], atol=1e-12)
    assert np.allclose(
        load.inertia_kg_m2,
        np.diag([2e-3, 1e-3, 3e-3]),
        atol=1e-12,
    )
    assert load.mass_kg == 0.5


def test_a_link_that_moves_against_the_hand_is_refused(robot: Robot) -> None:
    with pytest.raises(ConfigurationError, match="hand_on_link: base moves against tip"):
        load_at(robot, LOAD, "base")
    with pytest.raises(RobotError, match="no link 'flange'"):
        load_at(robot, LOAD, "flange")


def test_load_and_tool_are_one_body() -> None:
    """Against MuJoCo, which puts two masses of one body together itself."""
    mujoco = pytest.importorskip("mujoco")
    tool = (0.9, 0.0, 0.01, 0.06)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><freejoint/>
        <geom type="sphere" size=".01" mass="{LOAD.mass_kg}" pos="{" ".join(map(str, LOAD.com_m))}"/>
        <geom type="sphere" size=".01" mass="{tool[0]}" pos="{" ".join(map(str, tool[1:]))}"/></body></worldbody></mujoco>"""
    )
    body = together(LOAD, tool)
    assert body.mass_kg == pytest.approx(model.body_mass[1])
    assert np.allclose(body.com_m, model.body_ipos[1])
    assert np.isnan(body.inertia_kg_m2).all(), "that of the tool is not known"
    assert together(LOAD, (0.0, 0.0, 0.0, 0.0)) is LOAD


def test_units_and_fields_of_the_makers() -> None:
    request = SimpleNamespace(
        mass=0.0,
        center_of_gravity=SimpleNamespace(x=0.0, y=0.0, z=0.0),
    )
    CONTROLLERS["ur"].fill(request, LOAD)
    assert (request.mass, vars(request.center_of_gravity)) == (
        0.5,
        {"x": 0.01, "y": 0.02, "z": 0.03},
    )
    newer = SimpleNamespace(
        ixx=0.0, iyy=0.0, izz=0.0, ixy=0.0, ixz=0.0, iyz=0.0, transition_time=0.0, **vars(request)
    )
    CONTROLLERS["ur"].fill(newer, LOAD)
    assert (newer.ixx, newer.iyy, newer.izz, newer.ixy) == (1e-3, 2e-3, 3e-3, 0.0)
    skew = Carried(
        0.5,
        LOAD.com_m,
        np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]]),
    )
    franka = SimpleNamespace()
    CONTROLLERS["franka"].fill(franka, skew)
    assert franka.load_inertia == [1.0, 0.1, 0.2, 0.1, 2.0, 0.3, 0.2, 0.3, 3.0]
    assert franka.center_of_mass == [0.01, 0.02, 0.03]
    CONTROLLERS["franka"].fill(
        franka,
        Carried(
            0.5,
            LOAD.com_m,
            np.full((3, 3), np.nan),
        ),
    )
    assert franka.load_inertia == [0.0] * 9, "a NaN must not reach a controller"
    CONTROLLERS["franka"].fill(franka, replace(LOAD, inertia_is="assumed"))
    assert franka.load_inertia == [0.0] * 9, "nor what nobody knows"
    xarm = SimpleNamespace()
    CONTROLLERS["xarm"].fill(xarm, LOAD)
    assert xarm.weight == 0.5 and xarm.center_of_gravity == pytest.approx([10.0, 20.0, 30.0]), (
        "kg and mm"
    )


def test_a_controller_that_wants_the_tool_gets_no_guess_of_it() -> None:
    for name in ("ur", "xarm"):
        with pytest.raises(
            ConfigurationError, match=r"hand_on_tool: .* wants to know all that hangs at its flange"
        ):
            check_tool(name, [])
    assert check_tool("franka", []) == (0.0, 0.0, 0.0, 0.0)
    assert check_tool("ur", [0.9, 0, 0, 0.06]) == (0.9, 0.0, 0.0, 0.06)
    for wrong in ([0.9], [-0.9, 0, 0, 0.06], [float("nan"), 0, 0, 0], [0.9, 0, 0, 60.0]):
        with pytest.raises(ConfigurationError, match="state four numbers"):
            check_tool("ur", wrong)


def test_what_a_response_means() -> None:
    assert CONTROLLERS["ur"].refusal(SimpleNamespace(success=True)) == ""
    assert CONTROLLERS["ur"].refusal(SimpleNamespace(success=False)) == "no reason given"
    assert CONTROLLERS["franka"].refusal(SimpleNamespace(success=False, error="moving")) == "moving"
    assert CONTROLLERS["xarm"].refusal(SimpleNamespace(ret=0, message="")) == ""
    assert (
        CONTROLLERS["xarm"].refusal(SimpleNamespace(ret=9, message="not ready"))
        == "code 9, not ready"
    )
