"""Requests about recordings: a file that is dropped on the page, and pages that answers have."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, PlainTextResponse, Response
from starlette.requests import ClientDisconnect

from proprio_ros.addons.pendant.pendant import Pendant
from proprio_ros.addons.pendant.places import Places
from proprio_ros.errors import ProprioError
from proprio_ros.inputs.resources import WRITTEN_BY

REFUSED = 403
NOT_THERE = 404
HEAD = 1000  # characters, in which a page says who wrote it
# it draws by scripts of its own, and is not to click here
ALONE = {
    "Content-Security-Policy": "sandbox allow-scripts allow-popups",
    "Cache-Control": "no-store",
}


def add_requests(site: FastAPI, pendant: Pendant) -> None:
    """Answer them."""

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


def address_of(page: Path, places: Places) -> str:
    """Where a browser finds a page that an answer has; empty: it is not there."""
    for number, root in enumerate(places.roots.values()):
        if page.is_relative_to(root) and page.is_file():
            return f"/kept/{number}/{quote(str(page.relative_to(root)))}"
    return ""
