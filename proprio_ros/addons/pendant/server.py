"""The pages behind the gate, on one port, until somebody ends it."""

from __future__ import annotations

import gc
import secrets
import signal
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, PlainTextResponse, Response
from nicegui import app, ui
from starlette.requests import ClientDisconnect

from proprio_ros.addons.pendant.frame import frame
from proprio_ros.addons.pendant.gate import Gate
from proprio_ros.addons.pendant.lease import SILENCE_S
from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.errors import ConfigurationError, ProprioError
from proprio_ros.inputs.resources import WRITTEN_BY

WATCH_S = 0.5
LONGEST_MESSAGE = 2**20  # bytes, of a socket
HERE = Path(__file__).parent
REFUSED = 403
NOT_THERE = 404
HEAD = 1000  # characters, in which a page says who wrote it
# it draws by scripts of its own, and is not to click here
ALONE = {
    "Content-Security-Policy": "sandbox allow-scripts allow-popups",
    "Cache-Control": "no-store",
}


def serve(pendant: Pendant, host: str, port: int, begin: Callable[[], object]) -> None:
    """Show the pages until SIGINT or SIGTERM.

    Args:
        pendant: What they show.
        host: Address to be found at.
        port: 0: a free one.
        begin: Called when the port is ours.

    Raises:
        ConfigurationError: The address cannot be taken.
    """
    # commands collect no garbage, since they end soon; pages leave some whenever they are closed
    gc.enable()
    door = _bound(host, port)
    token = secrets.token_urlsafe(24)
    config = uvicorn.Config(
        Gate(_site(pendant), token),
        http="h11",
        ws_max_size=LONGEST_MESSAGE,
        log_level="error",
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    # they count before the server listens to them, too: whatever is interrupted there may not pass them on
    signal.signal(signal.SIGINT, server.handle_exit)
    signal.signal(signal.SIGTERM, server.handle_exit)
    begin()
    pendant.open()
    named = f"[{host}]" if ":" in host else host
    pendant.tell(f"open http://{named}:{door.getsockname()[1]}/?token={token}")
    pendant.tell("whoever has this address may move the arm; Ctrl-C ends the pendant")
    server.run(sockets=[door])


def _bound(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server(
            (host, port),
            family=family,
        )
    except OSError as error:
        raise ConfigurationError(
            f"{host} port {port}: {error.strerror or error}; choose another with --host and --port"
        ) from error


def _site(pendant: Pendant) -> FastAPI:
    """The application: pages, and STOP as a request of its own that needs no page to be well."""
    site = FastAPI(openapi_url=None)

    @site.post("/stop")
    async def stop() -> PlainTextResponse:
        return PlainTextResponse(pendant.stop())

    for name in ("pendant.css", "pendant.js"):
        app.add_static_file(local_file=HERE / name, url_path=f"/{name}")
    ui.add_head_html(
        '<link rel="stylesheet" href="/pendant.css"><script defer src="/pendant.js"></script>',
        shared=True,
    )

    _add_requests(site, pendant)
    app.timer(WATCH_S, pendant.watch)
    app.on_shutdown(pendant.close)
    app.config.socket_io_js_transports = ["websocket"]
    ui.run_with(
        site,
        root=partial(frame, pendant),
        title="proprio",
        dark=None,
        tailwind=False,
        language="en-US",
        reconnect_timeout=SILENCE_S,
        show_welcome_message=False,
    )
    return site


def _add_requests(site: FastAPI, pendant: Pendant) -> None:
    """About recordings: a file that is dropped on the page, and pages that answers have."""

    @site.post("/upload")
    async def upload(request: Request, name: str = "") -> PlainTextResponse:
        if pendant.read_only:
            return PlainTextResponse("this pendant only looks (--read-only)", REFUSED)
        length = int(request.headers.get("content-length", -1))
        try:
            kept = await pendant.desk.places.receive(name, length, request.stream())
            pendant.desk.take(kept)
        except ProprioError as error:
            return PlainTextResponse(str(error), REFUSED)
        except ClientDisconnect:
            return PlainTextResponse("", REFUSED)  # nobody is there to read it
        return PlainTextResponse("")

    @site.get("/kept/{number}/{path:path}")
    def kept(number: int, path: str) -> Response:
        places = pendant.desk.places
        roots = list(places.roots.values())
        try:
            page = places.inside(roots[number] / path) if number in range(len(roots)) else None
        except ProprioError as error:
            return PlainTextResponse(str(error), REFUSED)
        if page is None or not _is_ours(page):
            return PlainTextResponse("there is no page of an answer there", NOT_THERE)
        return FileResponse(page, headers=ALONE)


def _is_ours(page: Path) -> bool:
    if page.suffix != ".html" or not page.is_file():
        return False
    with page.open(encoding="utf-8", errors="replace") as stream:
        return WRITTEN_BY in stream.read(HEAD)
