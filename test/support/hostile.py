"""Requests that have to end in a refusal, of every kind, for a pendant that runs."""

from __future__ import annotations

import itertools
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import urlsplit

from support.pendant import Shown

PATHS = ("/", "/wizard", "/stop", "/report", "/pendant.js")
SOCKET = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket&client_id=1"
UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}
HOSTS = (
    *("evil.example", "evil.example:8690", "127.0.0.1.evil.example", "localhost.evil.example"),
    *("127.0.0.1@evil.example", "evil.example#127.0.0.1", "", " ", "127.0.0.1, evil.example"),
    *("[::1", "robot.local.evil.example", "xn--lcalhost-b1a", "0x7f.1.example", "localhost."),
)
ORIGINS = (
    *("http://evil.example", "https://evil.example", "null", "", "file://", "http://127.0.0.1"),
    *("http://localhost:1", "http://127.0.0.1.evil.example", "http://evil.example/127.0.0.1"),
    *("http://evil.example#", "chrome-extension://abcdef", "http://[::1]"),
)
METHODS = ("PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "PROPFIND", "STOP", "get")
BYTES = (
    *(b"\0" * 64, b"GET", b"GET /", b"GET / HTTP/9.9\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"),
    *(b"POST /stop HTTP/1.1\r\n\r\n", b"GET /../../etc/passwd HTTP/1.1\r\nHost: x\r\n\r\n", b"\r\n" * 50),
    *(b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: -1\r\n\r\n"),
    *(b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: x\r\n\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"),
)  # fmt: skip

CUT_OFF = ("malformed", "huge")
"""What the server may hang up on."""
EARLIER = "q5pY1Zk3mD0aT7vQe2sWcX9uRb6LhN4G"
"""As a pendant has it that was started before, and as long."""


@dataclass(frozen=True)
class Hostile:
    """One request."""

    kind: str
    sent: bytes


def request(
    method: str,
    path: str,
    headers: dict[str, str],
    more: tuple[tuple[str, str], ...] = (),
) -> bytes:
    """As it goes over the wire; a header may come twice."""
    lines = [f"{method} {path} HTTP/1.1"]
    lines += [f"{name}: {value}" for name, value in [*headers.items(), *more]]
    if "Upgrade" not in headers:
        lines.append("Connection: close")
    return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1", "replace")


def hostile(shown: Shown) -> list[Hostile]:
    """All of them."""
    host = urlsplit(shown.base).netloc
    good = {"Host": host, "Cookie": shown.cookie, "Origin": shown.base}
    return [
        *without_token(host, shown),
        *replayed(host, shown),
        *from_elsewhere(good),
        *to_another_name(good, host),
        *otherwise_wrong(good),
    ]


def without_token(host: str, shown: Shown) -> Iterator[Hostile]:
    token = shown.token
    wrong = (
        *("", "x", token[:-1], f"{token}x", token.swapcase(), token[::-1], "A" * 4000),
        *(f'"{token}', f"{token}; proprio_pendant={token}", "\xff\xfe", "null", "undefined"),
    )
    for cookie, path, method in itertools.product(wrong, PATHS, ("GET", "POST")):
        headers = {"Host": host, "Origin": shown.base, "Cookie": f"proprio_pendant={cookie}"}
        yield Hostile("wrong token", request(method, path, headers))
    for given, path in itertools.product(wrong[:4], PATHS):
        yield Hostile("wrong token", request("GET", f"{path}?token={given}", {"Host": host}))
    for path in PATHS:
        asked = request("POST", f"{path}?token={token}", {"Host": host, "Origin": shown.base})
        yield Hostile("token in the address", asked)
    for cookie in wrong:
        headers = {"Host": host, "Origin": shown.base, "Cookie": f"proprio_pendant={cookie}"}
        yield Hostile("wrong token", request("GET", SOCKET, {**headers, **UPGRADE}))
    shown_token = request(
        "GET", f"{SOCKET}&token={token}", {"Host": host, "Origin": shown.base, **UPGRADE}
    )
    yield Hostile("token in the address", shown_token)


def replayed(host: str, shown: Shown) -> Iterator[Hostile]:
    """What somebody did at a pendant that was there before."""
    headers = {"Host": host, "Origin": shown.base, "Cookie": f"proprio_pendant={EARLIER}"}
    for path, method in itertools.product(PATHS, ("GET", "POST")):
        yield Hostile("replayed", request(method, path, headers))
    for path in PATHS:
        yield Hostile("replayed", request("GET", f"{path}?token={EARLIER}", {"Host": host}))
    yield Hostile("replayed", request("GET", SOCKET, {**headers, **UPGRADE}))


def from_elsewhere(good: dict[str, str]) -> Iterator[Hostile]:
    for origin, path, method in itertools.product(ORIGINS, PATHS, ("GET", "POST")):
        if origin or method == "POST":
            yield Hostile("other origin", request(method, path, {**good, "Origin": origin}))
    for origin in ORIGINS:
        asked = request("GET", SOCKET, {**good, "Origin": origin, **UPGRADE})
        yield Hostile("other origin", asked)
    silent = {name: value for name, value in good.items() if name != "Origin"}
    for path in PATHS:
        yield Hostile("no origin, or two", request("POST", path, silent))
        twice = (("Origin", "http://evil.example"),)
        yield Hostile("no origin, or two", request("POST", path, good, twice))
    yield Hostile("no origin, or two", request("GET", SOCKET, {**silent, **UPGRADE}))


def to_another_name(good: dict[str, str], host: str) -> Iterator[Hostile]:
    for name, path in itertools.product(HOSTS, PATHS):
        as_theirs = {**good, "Host": name, "Origin": f"http://{name}"}
        yield Hostile("other host", request("GET", path, as_theirs))
        yield Hostile("other host", request("POST", path, as_theirs))
    for name in HOSTS:
        as_theirs = {**good, "Host": name, "Origin": f"http://{name}", **UPGRADE}
        yield Hostile("other host", request("GET", SOCKET, as_theirs))
    for path in PATHS:
        twice = (("Host", "evil.example"),)
        yield Hostile("other host", request("GET", path, good, twice))


def otherwise_wrong(good: dict[str, str]) -> Iterator[Hostile]:
    for method, path in itertools.product(METHODS, PATHS):
        yield Hostile("method", request(method, path, good))
    for path in PATHS:
        yield Hostile("huge", request("GET", f"{path}?{'x' * 5000}", good))
        yield Hostile("huge", request("GET", path, {**good, "X": "y" * 200_000}))
    for sent in BYTES:
        yield Hostile("malformed", sent)
    for path in (
        "/../pendant.py",
        "/%2e%2e/etc/passwd",
        "/report/../../x",
        "/_nicegui/../x",
        "//evil.example/x",
    ):
        yield Hostile("other file", request("GET", path, {"Host": good["Host"]}))


def status_of(shown: Shown, sent: bytes) -> int:
    """Status of the answer; 0: the connection was closed without one."""
    parts = urlsplit(shown.base)
    with socket.create_connection((parts.hostname, parts.port), 60.0) as wire:
        try:
            wire.sendall(sent)
            if not sent.endswith(b"\r\n\r\n"):
                wire.shutdown(socket.SHUT_WR)  # no more of it comes
            first = wire.makefile("rb").readline()
        except OSError:
            return 0
    words = first.split()
    return int(words[1]) if len(words) > 1 else 0


def is_refused(each: Hostile, status: int) -> bool:
    """Whether that status says so."""
    return 400 <= status < 500 or (status == 0 and each.kind in CUT_OFF)
