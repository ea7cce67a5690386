"""The page and its WebSocket."""

import asyncio
import contextlib
import json
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from lerobot_gloves.drive.board import Board
from lerobot_gloves.drive.desk import Desk
from lerobot_gloves.drive.protocol import LARGEST
from lerobot_gloves.drive.seats import FullError, Seat

PAGE = Path(__file__).parent / "page"
KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
FILES = {"/": "page.html", **{f"/{name}": name for name in ("page.css", "page.js", "steer.js", "draw.js", "study.js")}}
HEADERS = {
    # Nothing from elsewhere, and the token in the address is told nobody.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
POLICY_VIOLATION, TRY_AGAIN_LATER, REPLACED = 1008, 1013, 4000
"""Codes by which a connection is closed."""


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches an address."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Site:
    """What answers a browser.

    Args:
        desk: Where messages go.
        board: Where snapshots come from.
        scene: What a page is told once, when it connects.
        token: What the address must hold; None where only this computer reaches the server.
    """

    def __init__(self, desk: Desk, board: Board, scene: Mapping[str, Any], token: str | None) -> None:
        self._desk, self._board, self._scene, self._token = desk, board, dict(scene), token
        routes = [Route(path, self._page) for path in FILES]
        self.app = Starlette(routes=[*routes, WebSocketRoute("/socket", self._socket)], lifespan=self._lifespan)

    @contextlib.asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        self._board.open()
        yield

    def _refusal(self, connection: HTTPConnection) -> str:
        """Why somebody may not come in, "" if they may.

        A page of another site may open a WebSocket to this computer, and name a host of its own that leads here; the
        browser says where the page is from.
        """
        host, origin = connection.headers.get("host", ""), connection.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return "this page is from another site"
        if self._token is None:
            return "" if is_loopback(urlsplit(f"//{host}").hostname or "") else "ask for localhost"
        given = connection.query_params.get("token", "")
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            return "the address needs ?token=..., as gloves drive printed it"
        return ""

    async def _page(self, request: Request) -> Response:
        file = PAGE / FILES[request.url.path]
        if request.url.path == "/" and (refusal := self._refusal(request)):
            return PlainTextResponse(f"gloves drive: {refusal}\n", 403, HEADERS)
        return Response(file.read_bytes(), headers=HEADERS, media_type=KINDS[file.suffix])

    async def _socket(self, ws: WebSocket) -> None:
        if self._refusal(ws):
            await ws.close(POLICY_VIOLATION)  # before it is accepted: a browser sees a 403
            return
        await ws.accept()
        try:
            seat = self._desk.seats.enter(ws.query_params.get("page", "")[:64])
        except FullError as error:
            await ws.close(TRY_AGAIN_LATER, str(error))
            return
        told = asyncio.create_task(self._tell(ws, seat))
        heard = asyncio.create_task(self._hear(ws, seat))
        try:
            await asyncio.wait({told, heard}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._desk.seats.leave(seat)
            for task in (told, heard):
                task.cancel()
            for result in await asyncio.gather(told, heard, return_exceptions=True):
                # A page that goes away while it is told something is no error.
                if isinstance(result, Exception) and not isinstance(
                    result, WebSocketDisconnect | RuntimeError | OSError
                ):
                    raise result

    async def _hear(self, ws: WebSocket, seat: Seat) -> None:
        while True:
            message = await ws.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            if not self._desk.receive(seat, message.get("bytes") or b"" if text is None else text):
                await ws.close(POLICY_VIOLATION, "too many wrong messages")
                return

    async def _tell(self, ws: WebSocket, seat: Seat) -> None:
        about, state, picture, role = None, None, b"", None
        await ws.send_text(json.dumps({"type": "scene", **self._scene}))
        while not seat.replaced:
            snapshot = await self._board.newer()
            now = {"drives": self._desk.seats.driver is seat, "free": self._desk.seats.driver is None}
            if now != role:
                await ws.send_text(json.dumps({"type": "role", **now}))
                role = now
            if about is None:
                await ws.send_text(json.dumps({"type": "trail", "trail": snapshot.trail}))
            if snapshot.about is not about:
                about = snapshot.about
                await ws.send_text(json.dumps(about))
            if snapshot.state is not state:
                state = snapshot.state
                await ws.send_text(json.dumps(state))
            while seat.lines:
                await ws.send_text(json.dumps({"type": "error", "line": seat.lines.popleft()}))
            if snapshot.picture is not picture:
                picture = snapshot.picture
                await ws.send_bytes(picture)
        await ws.close(REPLACED, "this page has connected anew")


@contextmanager
def serving(site: Site, listener: socket.socket) -> Iterator[None]:
    """Answer browsers in a thread, on a socket that listens."""
    server = uvicorn.Server(
        uvicorn.Config(
            site.app,
            ws_max_size=4 * LARGEST,  # bytes
            ws_ping_interval=2,
            ws_ping_timeout=4,
            ws_per_message_deflate=False,  # pictures are compressed already
            timeout_graceful_shutdown=1,
            log_level="error",
            access_log=False,
        )
    )
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="server", daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.should_exit = True
        thread.join(5)
