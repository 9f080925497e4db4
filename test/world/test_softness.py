"""How soft is it, in the simulated world: the gripper learns itself, then squeezes blocks that obey a law in closed form."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from std_msgs.msg import Float64
from support.listening import HEARD, replayed_alike
from support.simulated_live import Client, running
from visualization_msgs.msg import Marker, MarkerArray

from proprio_ros.inputs.resources import resource
from proprio_ros.quantity import shown, spec_for

pytestmark = pytest.mark.long

GRIPPER = "gripper_left_joint"
GAP_M = 0.0005
BLOCKS = ((12e3, 0.25), (60e3, 0.13))


def block(modulus_Pa: float, ratio: float = 0.25) -> str:
    return f"block:{modulus_Pa:g},gap={GAP_M:g},nu={ratio:g}"


@dataclass
class Calibrated:
    """The nodes after the gripper was closed and opened with nothing between its fingers."""

    client: Client
    data: Path
    numbers: dict[str, list[float]]
    markers: list[MarkerArray]
    robot: Any

    def said(self, name: str) -> list[float]:
        """What was published of a number; what stood before is withdrawn by a NaN."""
        return [value for value in self.numbers[name] if math.isfinite(value)]

    def folders(self) -> list[Path]:
        return sorted(self.data.glob("2*_softness"))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Calibrated]:
    folder = tmp_path_factory.mktemp("softness")
    sequence = yaml.safe_load(resource("probes", "block_until").read_text())
    sequence["excitation"]["until"] |= {"half_interval": 0.02, "at_most_s": 15}
    # it tells less than a whole one, so that others are worth it
    sequence["excitation"]["runs"][0]["duration_s"] = 0.5
    (folder / "block.yaml").write_text(yaml.safe_dump(sequence))
    with running(
        folder,
        virtual={"object": block(*BLOCKS[0])},
        identifier={"robot_sequence": "empty_hand_gripper", "settings": ["block.size=0.03"]},
    ) as client:
        numbers: dict[str, list[float]] = {
            name: [] for name in ("youngs_modulus", "lame_mu", "lame_lambda")
        }
        for name, heard in numbers.items():
            client.node.create_subscription(
                Float64,
                f"/identifier/{name}",
                lambda message, heard=heard: heard.append(message.data),
                HEARD,
            )
        markers: list[MarkerArray] = []
        client.node.create_subscription(MarkerArray, "/identifier/markers", markers.append, HEARD)
        yield Calibrated(
            client, folder / "data", numbers, markers, client.asked("/identifier/calibrate_robot")
        )


def test_the_gripper_learns_itself(arm: Calibrated) -> None:
    assert arm.robot.success, arm.robot.message
    assert arm.client.wait_for(arm.client.final)
    told = arm.client.estimates[-1]
    assert float(told[f"coulomb[{GRIPPER}].std"]) < 0.01, "the file's own word is 0.08"


@pytest.mark.parametrize(("modulus", "ratio"), BLOCKS)
def test_blocks_are_distinguished(arm: Calibrated, modulus: float, ratio: float) -> None:
    """Within their intervals, which the torque constant makes 10 % wide; the fingers end where they began."""
    client = arm.client
    began = client.position(GRIPPER)
    answer = squeeze(arm, block(modulus, ratio))
    final = client.estimates[-1]
    assert final["probe"] == "softness"
    assert final["final"] == "true"
    assert final["verdict"] == "accepted"
    assert client.wait_for(lambda: bool(arm.said("youngs_modulus")))
    check_modulus(arm, final, modulus)
    told_words = words_of_modulus(final)
    assert f"block {told_words}, 95 % interval" in answer
    assert float(final["lame_mu"]) == arm.said("lame_mu")[-1]
    # what is not determined is not published either
    assert (final["lame_lambda"] == "not determined") == (not arm.said("lame_lambda"))
    assert 0.05 < float(final["largest_squeeze"]) < 0.45
    assert client.wait_for(lambda: abs(client.position(GRIPPER) - began) < 0.001), (
        "the fingers let go"
    )
    check_drawn(arm.markers[-1], told_words.split()[0])
    assert not client.masses
    assert not client.payloads


def squeeze(arm: Calibrated, held: str) -> str:
    """Puts a block between the fingers and has it squeezed until its estimate is final; the service's answer."""
    client = arm.client
    assert client.set("/virtual", "object", held).successful
    arm.markers.clear()
    for heard in arm.numbers.values():
        heard.clear()
    answer = client.asked("/identifier/calibrate_softness")
    assert answer.success, answer.message
    assert client.wait_for(
        lambda: bool(arm.said("lame_mu") and arm.markers and len(arm.markers[-1].markers) > 1)
    )
    assert client.wait_for(client.final)
    return str(answer.message)


def check_modulus(arm: Calibrated, final: dict[str, str], modulus: float) -> None:
    """What is published is what the estimate says, near the truth [Pa]."""
    told = arm.said("youngs_modulus")[-1]
    assert float(final["youngs_modulus"]) == told
    assert final["youngs_modulus.unit"] == "Pa"
    low, high = json.loads(final["youngs_modulus.ci95"])
    assert abs(told - modulus) < 0.2 * modulus
    assert abs(told - modulus) < 2.0 * (high - low)


def words_of_modulus(final: dict[str, str]) -> str:
    """As a person reads it."""
    spec = spec_for("Pa", float(final["youngs_modulus.std"]))
    return shown("Pa", float(final["youngs_modulus"]), spec=spec)


def check_drawn(markers: MarkerArray, number: str) -> None:
    """A cube between the fingers, with its modulus beside it."""
    drawn = {marker.type: marker for marker in markers.markers if marker.action == Marker.ADD}
    cube = drawn[Marker.CUBE]
    assert cube.header.frame_id == "end_effector_link"
    assert cube.scale.x == 0.03
    assert drawn[Marker.TEXT_VIEW_FACING].text.startswith(number)


def test_a_block_is_squeezed_until_it_is_sure(arm: Calibrated) -> None:
    """As sure as can be in 15 s: the squeezes after the first are chosen, and the fingers let go after each."""
    client = arm.client
    assert client.set("/virtual", "object", block(20e3)).successful
    assert client.set(
        "/identifier", "softness_sequence", str(arm.data.parent / "block.yaml")
    ).successful
    began = client.position(GRIPPER)
    answer = client.asked("/identifier/calibrate_softness")
    assert client.set("/identifier", "softness_sequence", "softness").successful
    assert answer.success and (
        "no push promises" in answer.message or "s are over" in answer.message
    ), answer.message
    if "no push promises" in answer.message:
        assert "; what is left is mostly calibration: " in answer.message, answer.message
    # where no further squeeze is worth it after the first, none is made
    assert client.excitation["probe"] == "chosen" or "after 1 run " in answer.message
    final = client.estimates[-1]
    low, high = json.loads(final["youngs_modulus.ci95"])
    told = float(final["youngs_modulus"])
    assert final["verdict"] == "accepted"
    assert abs(told - 20e3) < high - low
    assert client.wait_for(lambda: abs(client.position(GRIPPER) - began) < 0.001)
    assert "Pushes, one by one" in (arm.folders()[-1] / "choices.html").read_text()


def test_no_squeeze_goes_too_far(arm: Calibrated) -> None:
    """What really happened to the block, by the virtual robot's own word: 40 % at most, of any softness."""
    client = arm.client
    assert client.set("/virtual", "object", block(1.5e3)).successful
    began = client.position(GRIPPER)
    first = len(client.motors)
    answer = client.call("/identifier/calibrate_softness")
    assert answer.message
    closed = began - min(m.position[list(m.name).index(GRIPPER)] for m in client.motors[first:])
    assert 2.0 * (closed - GAP_M) / 0.03 < 0.45, "two fingers, a block of 30 mm"
    known = len(arm.folders())
    for name, value, reason in (
        ("softness_sequence", "paper_gripper", "may squeeze a block of 30 mm by 167 %"),
        ("softness_sequence", "payload", "squeeze with a joint that slides a finger"),
    ):
        if not client.set("/identifier", name, value).successful:
            pytest.fail(f"{name} must be changeable while the node runs")
        answer = client.call("/identifier/calibrate_softness")
        assert not answer.success
        assert reason in answer.message
        assert "\n" not in answer.message
    assert client.set("/identifier", "softness_sequence", "softness").successful
    assert client.set("/identifier", "settings", ["block.size=0.01"]).successful
    answer = client.call("/identifier/calibrate_softness")
    assert not answer.success
    assert "largest_squeeze=0.4" in answer.message
    refused = client.set("/identifier", "settings", ["block.hardness=1"])
    assert not refused.successful
    assert "unknown" in refused.reason
    assert client.set(
        "/identifier", "settings", ["block.size=0.03", "payload.size=0.03"]
    ).successful
    assert len(arm.folders()) == known, "nothing moved"


def test_cancelled_in_the_middle_of_a_squeeze(arm: Calibrated) -> None:
    client = arm.client
    future = client.begin("/identifier/calibrate_softness")
    client.wait_for_phase("probe", 600.0)
    answer = client.call("/identifier/cancel")
    assert answer.success, answer.message
    assert not client.answer(future).success
    assert client.wait_for(lambda: client.excitation.get("busy") == "false")
    # held where it is: the current that flows in the gripper is the holder's, and it does not go on closing
    heard = len(client.motors)
    assert client.wait_for(lambda: len(client.motors) > heard + 25), (
        "half a second: the position may be heard after the status"
    )
    place = client.position(GRIPPER)
    assert not client.wait_for(lambda: client.position(GRIPPER) < place - 0.002, 1.0)
    assert list((arm.folders()[-1] / "bag").glob("*.mcap")), "what was recorded is kept"


def test_replaying_the_bag_gives_the_same_numbers_bit_for_bit(arm: Calibrated) -> None:
    told = [each for each in arm.folders() if (each / "estimate.json").is_file()]
    folder = next(each for each in told if '"accepted"' in (each / "estimate.json").read_text())
    assert replayed_alike(folder / "estimate.json")["probe"] == "softness"
    assert "Both Lamé parameters" in (folder / "report.html").read_text()
