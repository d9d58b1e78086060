"""The server of the page: NiceGUI on 127.0.0.1, for the browser of this machine alone."""

import asyncio
import socket
import webbrowser
from collections.abc import Callable

from nicegui import app, ui
from starlette.middleware.trustedhost import TrustedHostMiddleware

HOST = "127.0.0.1"


def serve(page: Callable[[], None], title: str, announce: Callable[[str], None], open_browser: bool) -> None:
    """Serve a page until an interrupt. Each client gets a page of its own: ``page`` builds it.

    announce : is called with the link once the page can be loaded
    """
    port = free_port()
    link = f"http://{HOST}:{port}/"

    async def started() -> None:
        while not await _listens(port):
            await asyncio.sleep(LISTEN_S)
        announce(link)
        if open_browser:
            webbrowser.open(link)

    app.on_startup(started)
    # Other web sites must not read the page under a host name of their own.
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    ui.run(
        page, host=HOST, port=port, title=title, show=False, reload=False, show_welcome_message=False, tailwind=False,
        reconnect_timeout=RECONNECT_S, favicon=FAVICON,
    )  # fmt: skip


def free_port() -> int:
    """A port of this machine that no other program listens on."""
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
RECONNECT_S = 3.0  # after which the page of a lost client ends its work
FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect y="14" width="32" height="18" rx="3" '
    'fill="#f2b34c"/><circle cx="16" cy="11" r="9" fill="#5c0f3c"/></svg>'
)
