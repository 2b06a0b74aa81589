"""Show a page in the browser through a server that only this machine can reach."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, urlsplit

from learn2assemble.errors import InputError

HOST = "127.0.0.1"
_NAMES = (HOST, "localhost")


class PageServer(ThreadingHTTPServer):
    """Serves one file, and only to requests that name this machine.

    The name is checked because any web page can have its own name resolve to this machine and
    read what a server there answers (DNS rebinding).
    """

    daemon_threads = True

    def __init__(self, page: Path, port: int) -> None:
        super().__init__((HOST, port), _Handler)
        self.page = page
        self.address: str = f"http://{HOST}:{self.server_port}/{quote(page.name)}"


class _Handler(BaseHTTPRequestHandler):
    server: PageServer  # pyright: ignore[reportIncompatibleVariableOverride]
    timeout = 30

    def do_GET(self) -> None:
        page, content = self.server.page, None
        here = {f"{name}:{self.server.server_port}" for name in _NAMES}
        if self.headers.get("Host", "").lower() not in here:
            self.send_error(HTTPStatus.FORBIDDEN, "Only for this machine")
            return
        if urlsplit(self.path).path in ("/", "/" + quote(page.name)) and not page.is_symlink():
            with suppress(OSError):
                content = page.read_bytes()
        if content is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def handle(self) -> None:
        with suppress(ConnectionError):  # A browser that leaves early is no fault of the server.
            super().handle()

    def finish(self) -> None:
        with suppress(ConnectionError):
            super().finish()

    do_HEAD = do_GET

    def log_message(self, format: str, *args: object) -> None:
        """No line for every request."""


def open_server(path: Path, port: int = 0) -> PageServer:
    """A server of the page ``path`` alone, not yet running.

    Raises:
        InputError: for a page that does not exist or is a link, or a port that cannot be used.
    """
    if path.is_symlink() or not path.is_file():
        raise InputError("page", str(path), "an existing view.html that is not a link")
    if not 0 <= port <= 65535:
        raise InputError("port", port, "0 (any free port) to 65535")
    try:
        return PageServer(path.resolve(), port)
    except OSError as error:
        raise InputError("port", port, f"a free port ({error.strerror})") from None


def serve(
    path: Path,
    port: int = 0,
    open_browser: bool = True,
    report: Callable[[str], object] | None = None,
) -> str:
    """Serve the page ``path`` on 127.0.0.1 until interrupted, and return the address.

    Args:
        path: the page, e.g. ``view.html``.
        port: 0 takes any free port.
        open_browser: open the page in the default browser.
        report: called once with the address, before the first request is answered.

    Raises:
        InputError: for a page that does not exist or is a link, or a port that cannot be used.
    """
    with open_server(path, port) as server:
        if report is not None:
            report(server.address)
        if open_browser:
            webbrowser.open(server.address)
        with suppress(KeyboardInterrupt):  # The way to stop it.
            server.serve_forever()
    return server.address
