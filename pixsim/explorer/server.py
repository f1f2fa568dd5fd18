"""The server of the page, on 127.0.0.1 only, for whoever can read a file that is private to the
user.

Other users see the arguments of a browser, and all ports of a machine share its cookies. So the
browser opens a file of mode 0600, which leads to the page with a token behind "#", where no server
sees it. The page takes it from its address, and sends it as the first message of its WebSocket.
Every request has the Host and the Origin of the page: no other site reaches the server.
"""

from __future__ import annotations

import asyncio
import html
import os
import secrets
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from pixsim.base.errors import PixsimError, invalid
from pixsim.base.locks import remove_leftovers, temporary_folder
from pixsim.explorer.session import PageRequest, Session

_HOST = "127.0.0.1"
FILES = {
    "/": ("page.html", "text/html"),
    "/page.js": ("page.js", "text/javascript"),
    "/page.css": ("page.css", "text/css"),
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self';"
    " img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none';"
    " frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_MAX_MESSAGE_BYTES = 1 << 16
_TIMEOUT_S = 10.0  # of the first request of a connection, and for the token of a page
_MAX_CONNECTIONS = 64  # at once, of whoever: a browser opens six
RELOAD_S = 3.0  # for a page that is loaded again
# Codes of a WebSocket that is closed.
REFUSED = 4403
REPLACED = 4409
_REDIRECT = """<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>pixsim explore</title>
<meta name="referrer" content="no-referrer"><meta http-equiv="refresh" content="0; url={url}">
<p><a href="{url}">pixsim</a>
"""


class _SamePage:
    """Refuse what another host name, or the page of another origin, asks for."""

    def __init__(self, app: ASGIApp, port: int) -> None:
        self.app = app
        self.hosts = [f"{name}:{port}".encode() for name in (_HOST, "localhost")]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            headers = {
                name: [value for key, value in scope["headers"] if key == name]
                for name in (b"host", b"origin")
            }
            host = headers[b"host"]
            origin = headers[b"origin"]
            # A page that a user opens states no origin.
            needs_origin = bool(origin) or scope["type"] == "websocket"
            is_known_host = len(host) == 1 and host[0] in self.hosts
            if not is_known_host or (needs_origin and origin != [b"http://" + host[0]]):
                if scope["type"] == "http":
                    return await Response("another host or origin", 403)(scope, receive, send)
                # Before the socket is accepted, this is an answer 403.
                return await send({"type": "websocket.close", "code": REFUSED})
        await self.app(scope, receive, send)


class _BoundedProtocol(H11Protocol):
    """HTTP of a bounded number of connections, each of which has to ask for something soon: any
    user of the machine can connect, before a token is asked for.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > _MAX_CONNECTIONS:
            transport.abort()
            return
        self.loop.call_later(_TIMEOUT_S, self._close_if_silent)

    def _close_if_silent(self) -> None:
        has_request = bool(self.scope)
        if not has_request:
            self.transport.abort()


class Pages:
    """The open page, and the messages sent to it."""

    def __init__(self, session: Session, token: str) -> None:
        self.session = session
        self.token = token
        self.loop: asyncio.AbstractEventLoop | None = None
        self.open: WebSocket | None = None
        session.send = self.send

    def send(self, message: dict[str, Any]) -> None:
        """Send a message to the page, from any thread; if none is open, nobody needs it."""
        if self.loop is not None and self.open is not None:
            with suppress(Exception):  # whatever a page that is just closed raises
                sending = self.open.send_json(message)
                asyncio.run_coroutine_threadsafe(sending, self.loop).result(_TIMEOUT_S)

    async def file(self, request: Request) -> Response:
        """Return a file of the page."""
        name, media_type = FILES[request.url.path]
        content = (resources.files("pixsim") / "data/explorer" / name).read_bytes()
        return Response(content, media_type=media_type, headers=_HEADERS)

    async def socket(self, page: WebSocket) -> None:
        """Check the token of a page, then pass its requests to the session until it closes."""
        self.loop = asyncio.get_running_loop()
        await page.accept()
        try:
            first = await asyncio.wait_for(page.receive_json(), _TIMEOUT_S)
            token = first.get("token") if isinstance(first, dict) else None
            if not isinstance(token, str) or not self._is_token(token):
                await page.close(REFUSED)
                return
            if self.open is not None:
                with suppress(Exception):  # it may be gone already
                    await self.open.close(REPLACED)
            self.open = page
            await page.send_json(self.session.hello())
            while True:
                try:
                    self.session.ask(PageRequest.of(await page.receive_json()))
                except PixsimError as error:
                    await page.send_json({"error": str(error)})
                except (ValueError, RecursionError) as error:
                    await page.send_json({"error": f"page: got a message that is no JSON: {error}"})
        except (WebSocketDisconnect, TimeoutError, KeyError, ValueError, RecursionError):
            pass  # the page is closed, or sent no token, no text, no JSON at first
        finally:
            if self.open is page:
                self.open = None
                self.loop.call_later(RELOAD_S, self.end_if_closed)

    def _is_token(self, text: str) -> bool:
        """Return whether a text is the token, in a time that does not depend on it."""
        return secrets.compare_digest(text.encode(), self.token.encode())

    def end_if_closed(self) -> None:
        """End the session if no page has been opened again."""
        if self.open is None:
            self.session.end()


@contextmanager
def served(session: Session) -> Iterator[Path]:
    """Serve the page of a session within the block, and give the private file that leads to it."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.bind((_HOST, 0))
    listening.listen(_MAX_CONNECTIONS)  # before anybody learns the address
    port = listening.getsockname()[1]
    token = secrets.token_urlsafe(32)
    pages = Pages(session, token)
    routes = [*(Route(path, pages.file) for path in FILES), WebSocketRoute("/socket", pages.socket)]
    app = _SamePage(Starlette(routes=routes), port)
    options: dict[str, Any] = {
        "log_level": "critical",
        "access_log": False,
        "server_header": False,
        "ws_max_size": _MAX_MESSAGE_BYTES,
        "lifespan": "off",
        "http": _BoundedProtocol,
        "ws": "websockets-sansio",
    }
    server = uvicorn.Server(uvicorn.Config(app, timeout_graceful_shutdown=1, **options))
    thread = threading.Thread(
        target=server.run, args=([listening],), name="pixsim explore", daemon=True
    )
    remove_leftovers(Path(tempfile.gettempdir()))  # tokens of killed servers
    with temporary_folder() as folder:
        path = folder / "pixsim-explore.html"
        number = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with os.fdopen(number, "w", encoding="utf-8") as file:
                file.write(_REDIRECT.format(url=html.escape(f"http://{_HOST}:{port}/#{token}")))
            thread.start()
            yield path
        finally:
            server.should_exit = True
            if thread.is_alive():
                thread.join(_TIMEOUT_S)
            listening.close()


def explore_until_closed(session: Session, opened: Callable[[Path], object] | None = None) -> None:
    """Open the page of a session in the browser, or pass its file to `opened`, and compute what it
    asks for until it is closed.
    """
    with served(session) as file:
        if opened is not None:
            opened(file)
        elif not webbrowser.open(file.as_uri()):
            hint = "--no-browser (opened=print in Python) prints the page's file."
            raise invalid("browser", "none", "a browser that can be opened", hint)
        session.serve()
