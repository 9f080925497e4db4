"""Hostile requests end in a refusal, and none moves the arm: a table of them, generated from kinds, against a pendant that runs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

pytest.importorskip("nicegui")
pytest.importorskip("rclpy")

from support.hostile import SOCKET, UPGRADE, hostile, is_refused, request, status_of
from support.pendant import Shown, pendant


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    with pendant(tmp_path_factory.mktemp("pendant")) as shown:
        yield shown


def test_hostile_requests_are_refused(shown: Shown) -> None:
    before = shown.told
    requests = hostile(shown)
    assert len(requests) >= 500
    through = {}
    for each in requests:
        status = status_of(shown, each.sent)
        if not is_refused(each, status):
            through[each] = status
    assert not through, through
    assert shown.told == before, "something was stopped, called or went wrong"
    status, _ = shown.page("/wizard")
    assert status == 200, "it goes on for who may"


def test_the_right_one_passes(shown: Shown) -> None:
    """Else the table would say nothing."""
    good = {"Host": urlsplit(shown.base).netloc, "Cookie": shown.cookie, "Origin": shown.base}
    assert status_of(shown, request("GET", "/", good)) == 200
    assert status_of(shown, request("GET", SOCKET, {**good, **UPGRADE})) == 101
    assert status_of(shown, request("POST", "/stop", good)) == 200
    assert "nobody is there" in shown.told


@pytest.mark.parametrize(
    "packet",
    [
        *("", "9", "42", "42[", "42[]", '42["event"]', '42["event", null]', '42["event", {}]', "x" * 100_000),
        '42["event", {"client_id": "1", "id": 1, "listener_id": "1", "args": []}]',
        '42["javascript_response", {"client_id": "1", "request_id": "1", "result": true}]',
        '42["handshake", {"client_id": "1", "tab_id": "1", "document_id": "1"}]',
        "x" * 3_000_000,
    ],
    ids=lambda packet: packet[:40] or "empty",
)  # fmt: skip
def test_nonsense_on_a_socket_does_nothing(shown: Shown, packet: str) -> None:
    """Of one who has the token: a page that was replayed, or broken."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    before = shown.told.count("proprio call")
    address = f"ws{shown.base.removeprefix('http')}{SOCKET}"
    headers = {"Cookie": shown.cookie}
    with connect(address, origin=shown.base, additional_headers=headers, max_size=None) as wire:
        assert json.loads(str(wire.recv())[1:])["sid"]
        try:
            wire.send("40")
            wire.send(packet)
            wire.send("2")
            wire.recv()
        except ConnectionClosed:
            pass  # as good an answer as any
    assert shown.told.count("proprio call") == before
    assert shown.page("/")[0] == 200
