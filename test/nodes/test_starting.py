"""What the launch file, `proprio live` and `proprio demo` start: one decision, of the same arguments; and domains that are free."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from proprio_ros.cli.parser import make_parser
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.inputs.resources import resource
from proprio_ros.nodes import domains
from proprio_ros.nodes.arguments import ARGUMENTS, Stated
from proprio_ros.nodes.starting import ends_all, services_for, starts
from proprio_ros.nodes.tables import NODES


def started(**texts: str) -> dict[str, dict[str, Any]]:
    """Parameters by node."""
    return {start.node: dict(start.parameters) for start in starts(Stated(texts))}


def test_without_arguments_the_parameter_files_count() -> None:
    assert started() == {"driver": {}, "excitation": {}, "identifier": {}}
    for start in starts(Stated({})):
        assert list(start.files) == [str(resource("parameters", start.node))]


def test_a_virtual_robot_comes_first_and_has_a_helper() -> None:
    found = started(virtual="true", object="0.02", seed="7", namespace="/arm1/", port="/tmp/bus")
    assert list(found) == ["virtual", "driver", "excitation", "identifier"]
    assert found["virtual"] == {"link": "/tmp/bus", "object": "0.02", "seed": 7, "reference": 0.1}
    assert found["driver"] == {"port": "/tmp/bus"}
    assert found["identifier"] == {
        "data_directory": "~/.ros/proprio_ros/virtual_7",
        "reference_mass": 0.1,
        "reference_wait": 1.0,
        "frame_prefix": "arm1/",
    }
    weightless = started(virtual="true", reference_mass="0")
    assert "reference" not in weightless["virtual"]
    assert weightless["identifier"]["reference_mass"] == 0.0


def test_of_a_real_one_only_what_is_stated_is_passed_on(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("/**/driver:\n  ros__parameters:\n    rate: 50.0\n")
    found = started(robot="pendulum", rate="200", object="0.02", params_file=str(mine))
    assert found["driver"] == {"robot": "pendulum", "rate": 200.0}
    assert found["identifier"] == {"robot": "pendulum"}
    for start in starts(Stated({"params_file": str(mine)})):
        assert list(start.files)[1:] == [str(mine)]


@pytest.mark.parametrize(
    "texts", [{}, {"virtual": "true", "rate": "40", "seed": "3", "robot": "pendulum"}]
)
def test_what_is_stated_is_a_parameter_of_its_type(texts: dict[str, str]) -> None:
    for node, parameters in started(**texts).items():
        defaults = {parameter.name: parameter.default for parameter in NODES[node]}
        for name, value in parameters.items():
            assert type(value) is type(defaults[name]), (node, name)


@pytest.mark.parametrize(
    ("texts", "reason"),
    [
        ({"rate": "fast"}, "rate 'fast': must be a number; nothing was started"),
        ({"virtual": "true", "seed": "0.5"}, "seed '0.5': must be a whole number"),
        ({"virtual": "true", "reference_mass": "100g"}, "reference_mass '100g': must be a number"),
        ({"virtual": "true", "object": "50g"}, "object '50g': mass=50g must be a number"),
        ({"robot": "nonsense"}, "unknown robot 'nonsense'"),
    ],
)
def test_what_is_not_understood_is_refused_before_anything_starts(
    texts: dict[str, str], reason: str
) -> None:
    with pytest.raises(ProprioError) as caught:
        starts(Stated(texts))
    assert str(caught.value).startswith(reason)


@pytest.mark.parametrize("namespace", ["a-b", "/1x", "arm 1", "arm//left"])
def test_a_namespace_that_ros_does_not_take_is_refused(namespace: str) -> None:
    with pytest.raises(ProprioError, match="letters, digits and _"):
        starts(Stated({"namespace": namespace}))


def test_whose_end_ends_the_rest() -> None:
    assert ends_all("driver")
    assert ends_all("virtual")
    assert not ends_all("identifier"), "the driver holds the arm meanwhile"
    assert not ends_all("excitation")


def test_what_to_call_follows_from_what_the_hand_holds() -> None:
    assert services_for("") == ["calibrate_payload"]
    assert services_for("0.05") == ["calibrate_payload"]
    assert services_for("container:0.03,sphere=0.012") == [
        "record_container_baseline",
        "calibrate_container",
    ]


def test_live_takes_the_arguments_of_the_launch_file() -> None:
    words = ["live", "--virtual"]
    words += [word for name in ARGUMENTS if name != "virtual" for word in (f"--{name}", "7")]
    given = make_parser().parse_args(words)
    assert {name: getattr(given, name) for name in ARGUMENTS} == {
        name: "true" if name == "virtual" else "7" for name in ARGUMENTS
    }
    hyphens = make_parser().parse_args(["live", "--data-directory", "x", "--reference-mass", "0"])
    assert (hyphens.data_directory, hyphens.reference_mass) == ("x", "0")


def test_a_domain_in_which_somebody_listens_is_not_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(domains, "DOMAINS", range(40, 43))
    before = domains.claimed()
    taken = []
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
            # the first participant of a domain is met here
            somebody.bind(("127.0.0.1", 7400 + 250 * 41 + 10))
            while True:
                try:
                    taken.append(domains.free_domain())
                except ConfigurationError as error:
                    assert "no ROS domain is free" in str(error)
                    break
    finally:
        domains.give_back(before)
    assert "41" not in taken
    assert len(taken) == len(set(taken)), "none is given twice"


def test_texts_reach_a_node_as_texts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that is called 2024, or one with a blank, is no number and not two words."""
    pytest.importorskip("rclpy")
    graph = pytest.importorskip("proprio_ros.nodes.graph")
    words: list[str] = []
    monkeypatch.setattr(graph.subprocess, "Popen", lambda given, **_: words.extend(given))
    stated = {
        "data_directory": Path("2024"),
        "settings": ["payload.com=[0,0,0]"],
        "rate": 1e-5,
        "report": True,
    }
    graph.Graph(tmp_path).start("identifier", stated, "arm1", ["file.yaml"])
    rules = dict(word.split(":=", 1) for word in words if ":=" in word)
    assert rules.pop("__ns") == "/arm1"
    read = {name: json.loads(text) for name, text in rules.items()}
    assert read == {**stated, "data_directory": "2024"}
    assert words[words.index("--params-file") + 1] == "file.yaml"
