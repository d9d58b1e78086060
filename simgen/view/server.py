"""The server of the page: NiceGUI on 127.0.0.1, for the browser of this machine alone."""

import asyncio
import socket
import webbrowser
from collections.abc import Callable

from nicegui import app, ui
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from simgen.errors import InputError

HOST = "127.0.0.1"


def serve(
    page: Callable[[], None], title: str, announce: Callable[[str], None], open_browser: bool, port: int | None = None
) -> None:
    """Serve a page until an interrupt. Each client gets a page of its own: ``page`` builds it.

    announce : is called with the link once the page can be loaded
    port : by default one that is free

    Raises `InputError` for a port that another program uses.
    """
    port = free_port() if port is None else checked_port(port)
    link = f"http://{HOST}:{port}/"

    async def started() -> None:
        while not await _listens(port):
            await asyncio.sleep(LISTEN_S)
        announce(link)
        if open_browser:
            await asyncio.to_thread(webbrowser.open, link)  # a browser in a terminal would stop the server

    app.on_startup(started)
    # Other web sites must not read the page under a host name of their own.
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    app.add_middleware(SameOrigin, origins=tuple(f"http://{host}:{port}" for host in (HOST, "localhost")))
    ui.run(
        page, host=HOST, port=port, title=title, show=False, reload=False, show_welcome_message=False, tailwind=False,
        reconnect_timeout=RECONNECT_S, favicon=FAVICON,
    )  # fmt: skip


class SameOrigin:
    """Refuses what pages of other web sites ask for, and does not let them show the page in a frame of theirs."""

    def __init__(self, app: ASGIApp, origins: tuple[str, ...]):
        self._app, self._origins = app, origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        origin = Headers(scope=scope).get("origin") if scope["type"] in ("http", "websocket") else None
        if origin is not None and origin not in self._origins:
            await PlainTextResponse("Foreign origin", 403)(scope, receive, send)
            return

        async def send_unframed(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Content-Security-Policy"] = "frame-ancestors 'none'"
            await send(message)

        await self._app(scope, receive, send_unframed)


def checked_port(port: int) -> int:
    """Return a port if it is free; raise `InputError` if not."""
    with socket.socket() as probe:
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise InputError(f"--port {port}: {error.strerror}; allowed: a port that no other program uses") from None
    return port


def free_port() -> int:
    """Find a port of this machine that no other program listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


async def _listens(port: int) -> bool:
    """True once a program listens on a port of this machine."""
    try:
        _, writer = await asyncio.open_connection(HOST, port)
    except OSError:
        return False
    writer.close()
    return True


LISTEN_S = 0.02  # between two looks; the server listens a moment after it has started
RECONNECT_S = 20.0  # after which the page of a lost client ends its work; a busy browser is silent for seconds
FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect y="14" width="32" height="18" rx="3" '
    'fill="#f2b34c"/><circle cx="16" cy="11" r="9" fill="#5c0f3c"/></svg>'
)
