"""Servos that take goals alone, standing still: something is put into the hand, and taken out.

The arm is `support.foreign_arm`, behind a position controller of its own; how well other arms are weighed so is for
test/benchmarks/at_rest.py.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")

from std_msgs.msg import Bool
from support.foreign_live import foreign

from proprio_ros.nodes.qos import LATCHED

pytestmark = pytest.mark.long

# of this arm's dry friction the shoulder's and the elbow's carry 0.06 to 0.13 kg (standard deviations)
LEAST_KG = 0.5


@pytest.mark.parametrize(("seed", "rate_hz"), [(0, 100.0), (1, 30.0)])
def test_a_still_servo_says_whether_something_is_held(
    tmp_path: Path, seed: int, rate_hz: float
) -> None:
    with foreign(
        tmp_path,
        seed,
        True,
        rate_hz,
        running=True,
        holding_from=LEAST_KG,
    ) as (
        client,
        arm,
    ):
        holding: list[bool] = []
        client.world.user.create_subscription(
            Bool, "/identifier/holding", lambda said: holding.append(said.data), LATCHED
        )
        answer = client.asked("/identifier/calibrate_robot")
        assert answer.success, answer.message
        # the running estimate has begun, by the calibration that was made just now
        client.clock.sleep(3.0)
        for mass_kg in (0.0, 1.0, 0.0, 0.8, 0.0):
            arm.hold(mass_kg)
            client.clock.sleep(3.0)  # a person takes 1.5 s, and the arm creeps to where it stands
            assert client.wait_for(
                lambda: float(client.estimates[-1]["seconds_at_rest"]) > 1.0, 20.0
            )
            told = client.estimates[-1]
            low, high = json.loads(told["payload_mass.ci95"])
            assert low <= mass_kg <= high and high - low < 1.0, (mass_kg, told)
            assert float(told["seconds_of_motion"]) == 0.0
            assert (told["holding"] == "true") is (mass_kg > 0.0), (mass_kg, told)
        assert holding[-4:] == [True, False, True, False] and len(holding) <= 6, holding
        # an arm that works is weighed by its motion, of the last seconds as well
        answer = client.asked("/identifier/calibrate_payload")
        assert answer.success, answer.message
