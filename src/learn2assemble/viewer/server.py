"""Show a report in the browser through a server that only this machine can reach."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

from learn2assemble.errors import InputError

HOST = "127.0.0.1"


class _Quiet(SimpleHTTPRequestHandler):
    """Serves files without writing a line for every request."""

    def log_message(self, format: str, *args: object) -> None:
        pass


def open_server(path: Path, port: int = 0) -> tuple[ThreadingHTTPServer, str]:
    """A server of the folder of ``path``, not yet running, and the address of the page.

    Raises:
        InputError: for a page that does not exist or a port that cannot be used.
    """
    path = path.resolve()
    if not path.is_file():
        raise InputError("page", str(path), "an existing view.html")
    if not 0 <= port <= 65535:
        raise InputError("port", port, "0 (any free port) to 65535")
    handler = partial(_Quiet, directory=str(path.parent))
    try:
        server = ThreadingHTTPServer((HOST, port), handler)
    except OSError as error:
        raise InputError("port", port, f"a free port ({error.strerror})") from None
    return server, f"http://{HOST}:{server.server_address[1]}/{quote(path.name)}"


def serve(
    path: Path,
    port: int = 0,
    open_browser: bool = True,
    report: Callable[[str], object] | None = None,
) -> str:
    """Serve the folder of ``path`` on 127.0.0.1 until interrupted, and return the address.

    Args:
        path: the page, e.g. ``view.html``.
        port: 0 takes any free port.
        open_browser: open the page in the default browser.
        report: called once with the address, before the first request is answered.

    Raises:
        InputError: for a page that does not exist or a port that cannot be used.
    """
    server, address = open_server(path, port)
    with server:
        if report is not None:
            report(address)
        if open_browser:
            webbrowser.open(address)
        with suppress(KeyboardInterrupt):  # The way to stop it.
            server.serve_forever()
    return address
