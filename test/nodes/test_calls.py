"""What a user types to call a service, before any node is asked."""

from __future__ import annotations

import os

import pytest

pytest.importorskip("rclpy")

from proprio_ros.errors import ConfigurationError
from proprio_ros.nodes.call import to_call
from proprio_ros.nodes.live import Voice


@pytest.mark.parametrize(
    "typed", ["weigh", "identifier/weigh", "/identifier/weigh", "/arm1/identifier/weigh", "arm1/identifier/weigh"]
)  # fmt: skip
def test_a_service_by_its_name_or_its_path(typed: str) -> None:
    asked = to_call(typed, namespace="arm1" if "arm1" not in typed else "")
    assert asked.path == "/arm1/identifier/weigh"
    assert to_call(typed, namespace="arm1").path == asked.path


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("/arm2/identifier/weigh", "is in namespace arm2, and --namespace says arm1"),
        ("/arm1/driver/weigh", "is /arm1/identifier/weigh meant"),
        ("/arm1/weigh", "is /arm1/identifier/weigh meant"),
        ("wiegh", "is weigh meant"),
    ],
)
def test_what_is_none_is_refused_with_what_may_be_meant(typed: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said) as caught:
        to_call(typed, namespace="arm1")
    assert "\n" not in str(caught.value)


def test_what_nobody_reads_keeps_nobody() -> None:
    """A pipe that is full; all is said once somebody reads."""
    source, sink = os.pipe()
    voice = Voice()
    with os.fdopen(sink, "w") as stream:
        say = voice.of(lambda line: print(line, file=stream, flush=True))
        for _ in range(200):
            say("x" * 999)
        assert not voice.has_finished(0.0), "more than a pipe takes"
        left = 200_000
        while left:
            left -= len(os.read(source, 4096))
        assert voice.has_finished(60.0)
    os.close(source)


def test_a_pipe_that_was_closed_is_said_where_it_matters() -> None:
    def closed(line: str) -> None:
        raise BrokenPipeError

    voice = Voice()
    voice.of(closed)("a line")
    assert voice.has_finished(60.0)
    with pytest.raises(BrokenPipeError):
        voice.check()
