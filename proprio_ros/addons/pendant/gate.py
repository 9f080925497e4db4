"""Who may come in: every request and every socket passes here before anything else of the pendant sees it.

The arm moves at a click, so no page of another site may make a browser click. A token, which the terminal alone showed, says that
somebody may; ``Host`` has to be a number, or this computer's own name, which no stranger can have a name server say; and what can
change something has to come from a page of ours, which its ``Origin`` says.
"""

from __future__ import annotations

import hmac
import ipaddress
import socket
from urllib.parse import parse_qs, urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "proprio_pendant"
METHODS = ("GET", "HEAD", "POST")
REFUSED = 403
LONGEST_QUERY = 4096  # bytes
# scripts of the library are made as it runs; nothing is loaded from elsewhere, and nobody may put our pages into his
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; connect-src 'self'; "
    "frame-ancestors 'none'; form-action 'self'; base-uri 'none'"
)
HEADERS = (
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"content-security-policy", POLICY.encode()),
)


class Gate:
    """An ASGI application before another: what may not come in gets one sentence, and `app` never hears of it."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self.app = app
        self._token = token
        self._names = {"localhost", socket.gethostname().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        why = self._refusal(scope)
        if why and scope["type"] == "websocket":
            await send(
                {
                    "type": "websocket.close",
                    "code": 1008,
                    "reason": why,
                }
            )
        elif why:
            await _answer(send, REFUSED, f"{why}\n")
        elif self._shown(scope):
            cookie = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Lax"
            await _answer(
                send,
                303,
                "",
                (b"location", scope["path"].encode()),
                (b"set-cookie", cookie.encode()),
            )
        else:
            await self.app(
                scope,
                receive,
                _with_headers(send),
            )

    def _refusal(self, scope: Scope) -> str:
        """Why this may not come in; empty: it may."""
        hosts = _values(scope, b"host")
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return "refused: name this computer by its address"
        is_socket = scope["type"] == "websocket"
        if not is_socket and scope["method"] not in METHODS:
            return "refused: no such method"
        if len(scope["query_string"]) > LONGEST_QUERY:
            return "refused: the address is too long"
        origins = _values(scope, b"origin")
        # a browser says where a page is from wherever something can be changed
        asked = is_socket or scope["method"] == "POST"
        if len(origins) > 1 or (asked and not origins):
            return "refused: no page of the pendant asks"
        if origins and urlsplit(origins[0]).netloc != hosts[0]:
            return "refused: a page of another site asks"
        if not self._known(scope) and not self._shown(scope):
            return "refused: open the address that `proprio pendant` has shown in its terminal"
        return ""

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
            ipaddress.ip_address(name)
        except ValueError:
            return host.rpartition(":")[0].lower() in self._names or host.lower() in self._names
        return True

    def _known(self, scope: Scope) -> bool:
        """Whether it has the cookie."""
        pairs = [
            pair.strip()
            for line in _values(
                scope,
                b"cookie",
            )
            for pair in line.split(";")
        ]
        found = [pair.partition("=")[2] for pair in pairs if pair.startswith(f"{COOKIE}=")]
        return len(found) == 1 and self._is_token(found[0])

    def _shown(self, scope: Scope) -> bool:
        """Whether it has the token in its address: the one that the terminal showed, opened as a page."""
        if scope["type"] != "http" or scope["method"] != "GET":
            return False
        given = parse_qs(scope["query_string"].decode("latin-1")).get(
            "token",
            [],
        )
        return len(given) == 1 and self._is_token(given[0])

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(
            text.encode(),
            self._token.encode(),
        )


def _values(scope: Scope, name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]


async def _answer(send: Send, status: int, text: str, *headers: tuple[bytes, bytes]) -> None:
    """A short answer of our own."""
    whole = [
        (b"content-type", b"text/plain; charset=utf-8"),
        *HEADERS,
        *headers,
    ]
    await send(
        {
            "type": "http.response.start",
            "status": status,
            "headers": whole,
        }
    )
    await send({"type": "http.response.body", "body": text.encode()})


def _with_headers(send: Send) -> Send:
    """Answers of the pages say to the browser whom they trust."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message["headers"], *HEADERS]}
        await send(message)

    return sent
