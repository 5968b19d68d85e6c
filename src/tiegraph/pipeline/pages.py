"""The pages of ``tiegraph mark`` (images of the survey by number, marks as JSON) and of ``tiegraph watch`` (its state,
as JSON), served on the loopback, and nothing else.

Other sites open in a browser must neither read nor write here: a request has to name this very server as its host
(a name rebound to 127.0.0.1 does not), and a request that changes data has to be JSON from this very origin.
"""

import json
import threading
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np

from tiegraph.errors import InputError, TiegraphError
from tiegraph.pipeline.mark import ChangedMeanwhile, Marking
from tiegraph.watch.view import page

_PATCH_PX, _MOST_PATCH_PX, _MOST_WIDTH_PX = 120, 2048, 2048
_HTML = "text/html; charset=utf-8"
_POLICY = (
    "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class PageServer(ThreadingHTTPServer):
    """Serves a page on 127.0.0.1; port 0 = any that is free. Raises InputError for a port that is not available."""

    daemon_threads = True

    def __init__(self, port: int, handler: type["_Handler"]) -> None:
        try:
            super().__init__(("127.0.0.1", port), handler)
        except (OSError, OverflowError) as error:
            raise InputError(f"--port {port}: not available ({error}); give another, or 0 for any") from error

    @property
    def hosts(self) -> tuple[str, str]:
        """Host names by which a browser may call this server."""
        return f"127.0.0.1:{self.server_port}", f"localhost:{self.server_port}"

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://{self.hosts[0]}/"


class _Handler(BaseHTTPRequestHandler):
    """Common answers of both pages."""

    server: PageServer
    protocol_version = "HTTP/1.1"

    def _allowed(self, changes: bool = False) -> bool:
        hosts = self.server.hosts
        good = self.headers.get("Host", "") in hosts
        origin = self.headers.get("Origin")
        if origin is not None or changes:
            good &= origin in [f"http://{h}" for h in hosts]
        if changes:
            good &= self.headers.get("Content-Type", "").partition(";")[0] == "application/json"
        if not good:
            self.close_connection = True
            self._refuse(HTTPStatus.FORBIDDEN, "asked from elsewhere")
        return good

    def _json(self, data: Any) -> None:
        self._send(json.dumps(data, allow_nan=False).encode(), "application/json")

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self._send(json.dumps({"error": text}).encode(), "application/json", status)

    def _send(self, body: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind), ("Content-Length", str(len(body))), ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"), ("Content-Security-Policy", _POLICY), ("X-Frame-Options", "DENY"),
        ):  # fmt: skip
            self.send_header(name, value)
        self.end_headers()
        with suppress(ConnectionError):  # the browser has gone
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal is the user's."""


class WatchServer(PageServer):
    """Serves the page of a watched folder until ``close``."""

    def __init__(self, port: int) -> None:
        super().__init__(port, _WatchHandler)
        self.state = b"{}"
        threading.Thread(target=self.serve_forever, daemon=True, name="watch-page").start()

    def show(self, state: dict[str, Any]) -> None:
        """The content of ``/state.json`` from now on."""
        self.state = json.dumps(state, separators=(",", ":")).encode()

    def close(self) -> None:
        """End it."""
        self.shutdown()
        self.server_close()


class _WatchHandler(_Handler):
    server: WatchServer

    def do_GET(self) -> None:
        """The page or the state."""
        if not self._allowed():
            return
        asked = self.path.partition("?")[0]
        if asked == "/":
            self._send(page(None), _HTML)
        elif asked == "/state.json":
            self._send(self.server.state, "application/json")
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "no such page")


class MarkServer(PageServer):
    """Serves one session of marking."""

    def __init__(self, session: Marking, port: int = 0) -> None:
        super().__init__(port, _MarkHandler)
        self.session, self.lock = session, threading.Lock()


class _MarkHandler(_Handler):
    server: MarkServer

    def do_GET(self) -> None:
        """The page, the state, an image or a part of one."""
        if not self._allowed():
            return
        asked = urlsplit(self.path)
        query = {name: values[-1] for name, values in parse_qs(asked.query).items()}
        try:
            if asked.path == "/":
                self._send(files("tiegraph.targets").joinpath("mark.html").read_bytes(), _HTML)
            elif asked.path == "/state":
                with self.server.lock:
                    self._json(self.server.session.state())
            elif asked.path == "/image":
                self._send(self._whole(query), "image/jpeg")
            elif asked.path == "/size":
                height, width = self._pixels(query).shape[:2]
                self._json({"width": width, "height": height})
            elif asked.path == "/patch":
                self._send(self._patch(query), "image/png")
            else:
                self._refuse(HTTPStatus.NOT_FOUND, "no such page")
        except (KeyError, ValueError, OverflowError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))

    def do_POST(self) -> None:
        """Set a mark, {point, image, xy}, or remove it, xy null; the state that follows."""
        if not self._allowed(changes=True):
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > 4096 or urlsplit(self.path).path != "/mark":  # bytes of a mark
            self.close_connection = True
            self._refuse(HTTPStatus.BAD_REQUEST, "not a mark")
            return
        try:
            data = json.loads(self.rfile.read(int(length)))
            xy = None if data["xy"] is None else (float(data["xy"][0]), float(data["xy"][1]))
            with self.server.lock:
                self.server.session.set(int(data["point"]), int(data["image"]), xy)
                self._json(self.server.session.state())
        except ChangedMeanwhile as error:
            self._refuse(HTTPStatus.CONFLICT, str(error))
        except (KeyError, TypeError, IndexError, ValueError, OverflowError, TiegraphError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))

    def _pixels(self, query: dict[str, str]) -> np.ndarray:
        image = int(query["k"])
        if not 0 <= image < len(self.server.session.scene):
            raise ValueError("no such image")
        return self.server.session.pixels(image)

    def _whole(self, query: dict[str, str]) -> bytes:
        pixels = self._pixels(query)
        factor = min(1.0, min(int(query.get("width", 1400)), _MOST_WIDTH_PX) / max(pixels.shape[:2]))
        small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else pixels
        return cv2.imencode(".jpg", small)[1].tobytes()

    def _patch(self, query: dict[str, str]) -> bytes:
        """``size`` square pixels from (left, top); black beyond the image."""
        pixels, left, top = self._pixels(query), int(query["left"]), int(query["top"])
        size = min(max(int(query.get("size", _PATCH_PX)), 1), _MOST_PATCH_PX)
        out = np.zeros((size, size, 3), np.uint8)
        height, width = pixels.shape[:2]
        y0, y1, x0, x1 = max(top, 0), min(top + size, height), max(left, 0), min(left + size, width)
        if y0 < y1 and x0 < x1:
            out[y0 - top : y1 - top, x0 - left : x1 - left] = pixels[y0:y1, x0:x1]
        return cv2.imencode(".png", out)[1].tobytes()
