"""The page and its data, for browsers of this machine alone."""

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError

LOOPBACK = "127.0.0.1"
_PAGE = Path(__file__).with_name("page.html")
_HOLE = "/*STATE*/null"  # in the page; a page that is kept has its data here and asks nobody


class PageServer:
    """Serves ``/`` and ``/state.json`` on the loopback until ``close``; ``port`` 0 = any that is free.

    Raises InputError for a port that cannot be had.
    """

    def __init__(self, port: int) -> None:
        self._state = b"{}"
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                server._answer(self)

            def log_message(self, format: str, *args: Any) -> None:
                """Requests are no news."""

        try:
            self._http = ThreadingHTTPServer((LOOPBACK, port), Handler)
        except (OSError, OverflowError) as error:
            raise InputError(f"--port {port}: cannot be had ({error}); give another, or 0 for any") from error
        self._http.daemon_threads = True
        self._thread = threading.Thread(target=self._http.serve_forever, daemon=True, name="watch-page")
        self._thread.start()

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://{LOOPBACK}:{self._http.server_address[1]}/"

    def show(self, state: dict[str, Any]) -> None:
        """What ``/state.json`` says from now on."""
        self._state = json.dumps(state, separators=(",", ":")).encode()

    def close(self) -> None:
        """End it."""
        self._http.shutdown()
        self._http.server_close()

    def _answer(self, request: BaseHTTPRequestHandler) -> None:
        known = {"/": (page(None), "text/html; charset=utf-8"), "/state.json": (self._state, "application/json")}
        # A page from elsewhere whose name was made to lead here is not answered.
        ours = request.headers.get("Host", "").partition(":")[0] in (LOOPBACK, "localhost")
        body, kind = known.get(request.path.partition("?")[0], (b"", "")) if ours else (b"", "")
        try:
            request.send_response(200 if body else 404)
            request.send_header("Content-Type", kind or "text/plain")
            request.send_header("Content-Length", str(len(body)))
            request.send_header("Cache-Control", "no-store")
            request.end_headers()
            request.wfile.write(body)
        except OSError:  # the browser has gone
            pass


def page(state: dict[str, Any] | None) -> bytes:
    """The page; with a state, one that shows it without a server."""
    text = _PAGE.read_text(encoding="utf-8")
    if state is not None:
        text = text.replace(_HOLE, json.dumps(state).replace("<", "\\u003c"))
    return text.encode()
