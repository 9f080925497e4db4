"""Estimates as messages with numbers, and weighing as an action: what proprio_msgs adds, with that package built for the test."""

from __future__ import annotations

import importlib
import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from support.domains import free_domain
from support.live import LATCHED, Client, running, wait_for
from support.message_packages import build

from proprio_ros.errors import ConfigurationError
from proprio_ros.excitation.plans import Until
from proprio_ros.live.job import Job
from proprio_ros.nodes import numeric
from proprio_ros.nodes.numeric import WeighAction, fill
from proprio_ros.probes import probe_named

REPOSITORY = Path(__file__).resolve().parents[2]


def blank(**more: Any) -> Any:
    return SimpleNamespace(centre=SimpleNamespace(), **more)


def test_what_is_not_known_is_not_a_number() -> None:
    entries = {
        "payload_mass": 0.5,
        "payload_mass.std": 0.25,
        "payload_mass.ci95": [0.0, 1.0],
        "payload_com": [0.1, 0.2, 0.3],
        "verdict": "too_wide",
        "reason.1": "one",
        "reason.2": "two",
    }
    filled = fill(blank(), probe_named("payload"), entries)
    assert (filled.mass, filled.std, filled.interval, filled.verdict) == (
        0.5,
        0.25,
        [0.0, 1.0],
        "too_wide",
    )
    assert filled.reasons == ["one", "two"]
    assert vars(filled.centre) == {
        "x": 0.1,
        "y": 0.2,
        "z": 0.3,
    }
    unknown = {
        "payload_mass": "not determined",
        "payload_com": [0.1, None, 0.3],
        "verdict": "failed",
    }
    filled = fill(blank(), probe_named("payload"), unknown)
    nowhere = (filled.mass, filled.std, *filled.interval, filled.centre.y)
    assert all(map(math.isnan, nowhere))
    block = fill(
        SimpleNamespace(),
        probe_named("softness"),
        {"youngs_modulus": 2e5},
    )
    assert block.youngs_modulus == 2e5
    assert not hasattr(block, "mass")
    assert block.reasons == []


def asked(
    target: str,
    sequence: str = "",
    half_interval: float = 0.0,
) -> Any:
    return SimpleNamespace(
        target=target, sequence=sequence, settings=[], half_interval=half_interval, at_most_s=0.0
    )


def test_a_goal_may_say_how_sure_it_wants_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[Job] = []
    monkeypatch.setattr(numeric, "Weigh", SimpleNamespace(Feedback=SimpleNamespace))
    action: Any = WeighAction.__new__(WeighAction)
    action._begin = lambda job, answer: begun.append(job)
    for half_interval in (0.0, 5e-4):
        action._on_accepted(SimpleNamespace(request=asked("payload", half_interval=half_interval)))
    assert [job.until for job in begun] == [None, Until(5e-4, "kg", 60.0)]


def test_a_target_that_has_no_mass_is_refused() -> None:
    action: Any = WeighAction.__new__(WeighAction)
    for target, sequence in (("softness", ""), ("elephant", "")):
        with pytest.raises(
            ConfigurationError, match="give one of payload, container, contents, weigh"
        ):
            action._asked(asked(target, sequence))
    for goal in (asked("weigh", "payload"), asked("weigh", "", half_interval=1e-3)):
        with pytest.raises(
            ConfigurationError, match="makes no sequence: leave it empty, and half_interval at 0"
        ):
            action._asked(goal)


class Weighing:
    """A client of the action, and what it has heard."""

    def __init__(self, client: Client, weigh: Any, estimate: Any) -> None:
        self.client = client
        self.weigh = weigh
        self.masses: list[Any] = []
        self.feedback: list[Any] = []
        client.node.create_subscription(
            estimate, "/identifier/mass_estimate", self.masses.append, LATCHED
        )
        self.action = ActionClient(client.node, weigh, "/identifier/weigh_action")
        assert wait_for(self.action.server_is_ready, 60.0)

    def send(self, **goal: Any) -> Any:
        self.feedback.clear()
        sent = self.action.send_goal_async(
            self.weigh.Goal(**goal), lambda message: self.feedback.append(message.feedback)
        )
        return self.client.answer(sent, 60.0)

    def begun(self, **goal: Any) -> Any:
        """A goal that is on its way."""
        found = self.send(sequence="payload_elbow", **goal)
        assert found.accepted
        assert wait_for(lambda: bool(self.feedback), 120.0), self.client.statuses
        return found

    def withdrawn(self) -> bool:
        return any(each.verdict == "withdrawn" and math.isnan(each.mass) for each in self.masses)


def check_that_all_say_the_same(
    final: dict[str, str],
    result: Any,
    stamped: Any,
) -> None:
    """The identifier's estimate, the action's result, and the estimate with a stamp."""
    # a computer that is busy elsewhere records nothing of use
    if final["payload_mass"] == "not determined":
        assert math.isnan(result.mass)
        assert math.isnan(stamped.mass)
    else:
        assert float(final["payload_mass"]) == result.mass == stamped.mass
        interval = json.loads(final["payload_mass.ci95"])
        assert interval == list(result.interval) == list(stamped.interval)
    assert final["verdict"] == result.verdict == stamped.verdict
    reasons = [final[key] for key in final if key.startswith("reason.")]
    assert reasons == list(result.reasons) == list(stamped.reasons)


def check_a_weighing(weighing: Weighing) -> None:
    client = weighing.client
    goal = weighing.begun(settings=["payload.shape=cube", "payload.size=0.03"])
    another = weighing.action.send_goal_async(weighing.weigh.Goal())
    assert not client.answer(another, 60.0).accepted, "one at a time"
    ended = client.answer(goal.get_result_async(), 600.0)
    result = ended.result
    # the arm is not calibrated, so what the verdict is, is the identification's business; here, that all say the same
    assert (ended.status == GoalStatus.STATUS_SUCCEEDED) == (result.verdict == "accepted")
    assert wait_for(lambda: bool(weighing.masses) and weighing.masses[-1].final, 60.0)
    assert wait_for(client.final, 60.0)
    stamped = weighing.masses[-1]
    check_that_all_say_the_same(client.estimates[-1], result, stamped)
    assert stamped.header.frame_id == "end_effector_link"
    assert stamped.header.stamp.sec > 0
    assert Path(result.bag).is_dir()
    assert result.bag in result.message
    kept = json.loads((Path(result.bag).parent / "estimate.json").read_text())
    assert "payload.size=0.03" in kept["command"], "what the goal stated counted"
    assert weighing.feedback[-1].fraction > 0.0


def check_two_ways_to_cancel(weighing: Weighing) -> None:
    """What stood is withdrawn, and the next job may come."""
    client = weighing.client
    goal = weighing.begun()
    assert wait_for(weighing.withdrawn, 60.0)
    client.answer(goal.cancel_goal_async(), 60.0)
    ended = client.answer(goal.get_result_async(), 60.0)
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert "cancelled" in ended.result.message
    assert ended.result.verdict == "failed"
    assert math.isnan(ended.result.mass)
    # by the service that ends any job, too
    goal = weighing.begun()
    assert client.call("/identifier/cancel").success
    ended = client.answer(goal.get_result_async(), 60.0)
    assert ended.status == GoalStatus.STATUS_CANCELED


@pytest.mark.long
def test_weighing_as_an_action(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", free_domain())
    built = build(REPOSITORY / "proprio_msgs", tmp_path / "prefix")
    monkeypatch.syspath_prepend(str(tmp_path / "prefix" / "site-packages"))
    for name in [name for name in sys.modules if name.split(".")[0] == "proprio_msgs"]:
        monkeypatch.delitem(sys.modules, name)
    weigh: Any = importlib.import_module("proprio_msgs.action").Weigh
    kind: Any = importlib.import_module("proprio_msgs.msg").MassEstimate
    with running(
        tmp_path, virtual={"object": 0.05}, environment={"PYTHONPATH": built["PYTHONPATH"]}
    ) as (_, client):
        weighing = Weighing(client, weigh, kind)
        check_a_weighing(weighing)
        check_two_ways_to_cancel(weighing)
        # what cannot be begun is refused, and the reason stands in the node's log
        wrong: tuple[dict[str, Any], ...] = (
            {"sequence": "no_such_sequence"},
            {"target": "elephant"},
            {"settings": ["payload.siz=0.03"]},
            {"half_interval": math.nan},
            {"target": "weigh", "sequence": "payload"},
        )
        assert not any(weighing.send(**each).accepted for each in wrong)
