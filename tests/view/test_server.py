"""The server of the pages: who can reach it, and what it gives away."""

import asyncio
import http.client
import re
import socket

import psutil
import pytest

from simgen.errors import InputError
from simgen.view import server
from view.served import Served, served

SECRETS = (b"root:", b'"zarr_format"', b"import ", b"SECRET")


@pytest.fixture(scope="module")
def page(whole) -> Served:
    (whole.path.parent / "secret.txt").write_text("SECRET")
    with served(whole.path) as page:
        yield page


def answer(page: Served, path: str, **headers: str) -> tuple[int, bytes, http.client.HTTPMessage]:
    """Status, body and headers; the path goes out as it is."""
    connection = http.client.HTTPConnection(server.HOST, page.port, timeout=60)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response.status, body, response.headers


def test_the_announced_page_can_be_loaded_at_once(page):
    status, body, headers = answer(page, "/")
    assert status == 200 and b"<title>d.zarr - simgen</title>" in body
    assert headers["Content-Type"].startswith("text/html")


def test_nothing_but_this_machine_is_listened_to(page):
    listening = {each.laddr.ip for each in psutil.Process(page.pid).net_connections() if each.status == "LISTEN"}
    assert listening == {"127.0.0.1"}
    addresses = {
        each.address for own in psutil.net_if_addrs().values() for each in own if each.family == socket.AF_INET
    }
    for address in addresses - {"127.0.0.1"}:
        with pytest.raises(OSError):
            socket.create_connection((address, page.port), timeout=5)


@pytest.mark.parametrize("path", ["/", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"])
@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "192.0.2.1"])
def test_another_host_name_is_refused(page, path, host):
    status, body, _ = answer(page, path, Host=f"{host}:{page.port}")
    assert (status, body) == (400, b"Invalid host header")
    assert answer(page, path, Host=f"localhost:{page.port}")[0] == 200


@pytest.mark.parametrize("path", ["/", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"])
def test_another_site_may_neither_read_nor_frame_the_page(page, path):
    status, body, headers = answer(page, path, Origin="http://evil.example")
    assert (status, body) == (403, b"Foreign origin") and "Access-Control-Allow-Origin" not in headers
    status, _, headers = answer(page, path, Origin=f"http://127.0.0.1:{page.port}")
    assert status == 200 and headers["Content-Security-Policy"] == "frame-ancestors 'none'"


def test_a_port_in_use_is_refused():
    with socket.socket() as other:
        other.bind((server.HOST, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"--port {port}: Address already in use; allowed: a port that no other"):
            server.checked_port(port)
    assert server.checked_port(port) == port


def test_no_file_is_served(page, whole):
    """Paths that leave a folder of the server's own files, and names of files beside and in the dataset."""
    own = sorted(set(re.findall(r"/_nicegui/[\w./-]*/", answer(page, "/")[1].decode())))
    assert len(own) > 2
    ups = ["../" * 12, "%2e%2e/" * 12, "..%2f" * 12, "/"]
    files = ["etc/passwd", str(whole.path / "zarr.json").lstrip("/")]
    paths = [f"{folder}{up}{file}" for folder in ["/", *own] for up in ups for file in files]
    paths += [f"{folder}{up}{file}" for folder in ["/", *own] for up in ("../", "%2e%2e/", "..%2f")
              for file in ("__init__.py", "nicegui.py")]  # fmt: skip
    paths += ["/etc/passwd", "/zarr.json", "/d.zarr/zarr.json", "/digit/zarr.json", "/../secret.txt", "/secret.txt"]
    for path in paths:
        status, body, headers = answer(page, path)
        is_page = status == 200 and b"<title>d.zarr - simgen</title>" in body
        assert is_page or status in (400, 403, 404), (path, status, body[:200])
        if not is_page:
            assert not any(secret in body for secret in SECRETS), (path, body[:200])
        assert headers["Content-Type"].startswith(("text/html", "application/json", "text/plain")), path


def test_a_free_port_can_be_listened_to():
    port = server.free_port()
    with socket.socket() as own:
        own.bind((server.HOST, port))
        own.listen()


@pytest.fixture
def serving(monkeypatch):
    """Call `serve` without a server: what it asks for, what it does once it has started, and what it says."""
    started, options, announced = [], [], []
    monkeypatch.setattr(server.app, "on_startup", started.append)
    monkeypatch.setattr(server.app, "add_middleware", lambda *_, **__: None)
    monkeypatch.setattr(server.ui, "run", lambda page, **given: options.append(given))

    def serve(open_browser: bool):
        server.serve(lambda: None, "d.zarr - simgen", announced.append, open_browser)
        return options[-1], started[-1], announced

    return serve


@pytest.mark.parametrize("wanted", [True, False])
def test_a_browser_is_opened_where_it_is_wanted(serving, monkeypatch, wanted):
    opened = []
    monkeypatch.setattr(server.webbrowser, "open", opened.append)
    options, started, announced = serving(wanted)
    with socket.create_server((server.HOST, options["port"])):
        asyncio.run(started())
    assert announced == [f"http://127.0.0.1:{options['port']}/"]
    assert opened == (announced if wanted else [])
    assert (options["host"], options["title"]) == ("127.0.0.1", "d.zarr - simgen")


def test_nothing_is_announced_before_the_server_listens(serving):
    options, started, announced = serving(False)

    async def listen_late() -> None:
        announcing = asyncio.create_task(started())
        await asyncio.sleep(5 * server.LISTEN_S)
        assert announced == []
        with socket.create_server((server.HOST, options["port"])):
            await announcing

    asyncio.run(listen_late())
    assert len(announced) == 1
