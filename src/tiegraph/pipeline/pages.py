"""The pages of ``tiegraph mark`` (images of the survey by number, marks as JSON), of ``tiegraph watch`` (what is known,
as JSON) and of ``tiegraph view`` (a finished run), served on the loopback, and nothing else.

Other users of the machine must neither read nor write here: the path of every address begins with a random token, which
only the terminal shows. (A cookie would go to the servers of other users too: browsers do not tell ports apart.)
Other sites that a browser has open must not either: a request has to name this very server as its host (a name that is
rebound to 127.0.0.1 does not), and what changes something has to be of the right type and from this very origin. What a
browser says to come from another site is refused, unless somebody follows a link there.
"""

import json
import re
import secrets
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote

import cv2
import numpy as np
from PIL import Image

from tiegraph.errors import InputError, TiegraphError
from tiegraph.pipeline.files import CLOUD
from tiegraph.pipeline.mark import ChangedMeanwhile
from tiegraph.watch.onsite import page

_PATCH_PX, _MOST_PATCH_PX, _MOST_WIDTH_PX = 120, 2048, 2048
HTML, _TEXT, _BYTES = "text/html; charset=utf-8", "text/plain; charset=utf-8", "application/octet-stream"
_POLICY = (
    "default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_VIEW_POLICY = (
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'unsafe-inline'; "  # laz-perf is WebAssembly
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_RANGE = re.compile(r"bytes=(\d*)-(\d*)")
_CHUNK = 1 << 20  # bytes of a file sent at once


class PageServer(ThreadingHTTPServer):
    """Serves a page ``about`` a state, a session or a run on 127.0.0.1; port 0 = any that is free. Raises InputError
    for a port that is not available."""

    daemon_threads = True

    def __init__(self, handler: type["Handler"], about: Any, port: int = 0) -> None:
        try:
            super().__init__(("127.0.0.1", port), handler)
        except (OSError, OverflowError) as error:
            raise InputError(f"--port {port}: not available ({error}); give another, or 0 for any") from error
        self.about, self.lock = about, threading.Lock()
        self.token = secrets.token_urlsafe(24)
        # Other users see the arguments of a browser that starts: its address is good for one request.
        self.once = {secrets.token_urlsafe(24): True}

    @property
    def hosts(self) -> tuple[str, str]:
        """Host names by which a browser may call this server."""
        return f"127.0.0.1:{self.server_port}", f"localhost:{self.server_port}"

    @property
    def url(self) -> str:
        """The address of the page, with its token."""
        return f"http://{self.hosts[0]}/{self.token}/"

    def start(self) -> None:
        """Serve the page until ``close``, while this process does something else."""
        every_s = 0.05  # it looks whether it is closed
        threading.Thread(target=self.serve_forever, args=(every_s,), daemon=True, name="page").start()

    def close(self) -> None:
        """End what ``start`` began."""
        self.shutdown()
        self.server_close()

    def serve_until_interrupted(self, browser: bool) -> None:
        """Serve the page, opened in the ``browser`` or not, until Ctrl-C."""
        if browser:
            webbrowser.open(self.url.replace(self.token, next(iter(self.once))))
        try:
            with suppress(KeyboardInterrupt):
                self.serve_forever()
        finally:
            self.server_close()


class Handler(BaseHTTPRequestHandler):
    """What all pages answer alike."""

    server: PageServer
    protocol_version = "HTTP/1.1"
    policy = _POLICY

    def do_GET(self) -> None:
        """What ``_answers`` has for the path: images and rasters go by their numbers in the query."""
        path = self._asked()
        if path is None:
            return
        try:
            answer = self._answers().get(path)
            if answer is None:
                self._refuse(HTTPStatus.NOT_FOUND, "no such page")
            else:
                answer({name: values[-1] for name, values in parse_qs(self.path.partition("?")[2]).items()})
        except (KeyError, IndexError, ValueError, OverflowError, TiegraphError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))

    def _answers(self) -> dict[str, Callable[[dict[str, str]], None]]:
        """What each path below the token is answered by."""
        return {}

    def _asked(self, changes: str = "") -> str | None:
        """The path below the token, None if this request is answered already: refused, or the browser's first, which is
        sent on to the page; ``changes``: the type of what a request sends to change something."""
        hosts = self.server.hosts
        good = self.headers.get("Host", "") in hosts
        if self.headers.get("Sec-Fetch-Mode") != "navigate":
            good &= self.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin")
        origin = self.headers.get("Origin")
        if origin is not None or changes != "":
            good &= origin in [f"http://{h}" for h in hosts]
        if changes:
            good &= self.headers.get("Content-Type", "").partition(";")[0] == changes
        token, slash, path = unquote(self.path.partition("?")[0]).removeprefix("/").partition("/")
        if not good:
            refused = "asked from elsewhere: only this page itself may ask, at 127.0.0.1 or localhost"
        elif slash and secrets.compare_digest(token.encode(), self.server.token.encode()):
            return path
        elif self.server.once.pop(token, False):
            return self._begin(0, _TEXT, HTTPStatus.SEE_OTHER, Location=f"/{self.server.token}/")
        else:
            refused = "the address lacks the token of this page: open the address that the terminal shows"
        self.close_connection = True
        return self._refuse(HTTPStatus.FORBIDDEN, refused)

    def _sent(self, most: int, wrong: str) -> bytes | None:
        """What a request sends, up to so many bytes; None if that is refused as ``wrong``."""
        length = self.headers.get("Content-Length", "")
        if most and length.isdigit() and int(length) <= most:
            return self.rfile.read(int(length))
        self.close_connection = True
        return self._refuse(HTTPStatus.BAD_REQUEST, wrong)

    def _json(self, data: Any) -> None:
        self._send(json.dumps(data, allow_nan=False).encode(), "application/json")

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self._send(json.dumps({"error": text}).encode(), "application/json", status)

    def _send(self, body: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._begin(len(body), kind, status)
        with suppress(ConnectionError):  # the browser has gone
            self.wfile.write(body)

    def _begin(self, length: int, kind: str, status: HTTPStatus = HTTPStatus.OK, **more: str) -> None:
        """Status line and headers; ``more``: of this answer, with _ for -."""
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind), ("Content-Length", str(length)), ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"), ("Content-Security-Policy", self.policy),
            ("X-Frame-Options", "DENY"), ("Referrer-Policy", "same-origin"),
            *((n.replace("_", "-"), v) for n, v in more.items()),
        ):  # fmt: skip
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the terminal is the user's."""


class WatchHandler(Handler):
    """The page of a watched folder; about it: the content of ``state.json``."""

    def _answers(self) -> dict[str, Callable[[dict[str, str]], None]]:
        return {"": lambda _: self._send(page(None), HTML), "state.json": lambda _: self._json(self.server.about)}


class MarkHandler(Handler):
    """The page of one session of marking (``Marking``)."""

    def _answers(self) -> dict[str, Callable[[dict[str, str]], None]]:
        return {
            "": lambda _: self._send(files("tiegraph.targets").joinpath("mark.html").read_bytes(), HTML),
            "state": lambda _: self._state(),
            "image": lambda q: self._send(_whole(self._pixels(q), q), "image/jpeg"),
            "size": lambda q: self._json(dict(zip(("height", "width"), self._pixels(q).shape))),
            "patch": lambda q: self._send(_patch(self._pixels(q), q), "image/png"),
        }

    def _state(self) -> None:
        with self.server.lock:
            self._json(self.server.about.state())

    def do_POST(self) -> None:
        """Set a mark, {point, image, xy}, or take it away, xy null; the state that follows."""
        path = self._asked("application/json")
        sent = None if path is None else self._sent(4096 if path == "mark" else 0, "not a mark")
        if sent is None:
            return
        try:
            data = json.loads(sent)
            xy = None if data["xy"] is None else (float(data["xy"][0]), float(data["xy"][1]))
            with self.server.lock:
                self.server.about.set(int(data["point"]), int(data["image"]), xy)
                self._json(self.server.about.state())
        except ChangedMeanwhile as error:
            self._refuse(HTTPStatus.CONFLICT, str(error))
        except (KeyError, TypeError, IndexError, ValueError, OverflowError, TiegraphError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))

    def _pixels(self, query: dict[str, str]) -> np.ndarray:
        image = int(query["k"])
        if not 0 <= image < len(self.server.about.scene):
            raise ValueError("no such image")
        return self.server.about.pixels(image)


class ViewHandler(Handler):
    """The page of one finished run (``Viewed``)."""

    policy = _VIEW_POLICY

    def _answers(self) -> dict[str, Callable[[dict[str, str]], None]]:
        viewed, page = self.server.about, files("tiegraph.view")
        return {
            "": lambda _: self._send(page.joinpath("page.html").read_bytes(), HTML),
            "view.js": lambda _: self._send(page.joinpath("view.js").read_bytes(), "text/javascript"),
            "laz-perf.wasm": lambda _: self._send(page.joinpath("laz-perf.wasm").read_bytes(), "application/wasm"),
            "licences.txt": lambda _: self._send(page.joinpath("licences.txt").read_bytes(), _TEXT),
            CLOUD: lambda _: self._file(viewed.run.path(CLOUD)),
            "layers.json": lambda _: self._json(viewed.layers()),
            "pick": lambda q: self._json(viewed.pick(_numbers(q["at"], 3))),
            "apart": lambda q: self._json(viewed.apart(_numbers(q["at"], 6).reshape(2, 3), _numbers(q["sigma"], 2))),
            "image": lambda q: self._send(_whole(viewed.pixels(int(q["k"])), q), "image/jpeg"),
            "patch": lambda q: self._send(_patch(viewed.pixels(int(q["k"])), q), "image/png"),
            "mesh": lambda q: self._send(viewed.mesh(int(q["k"])).tobytes(), _BYTES),
            "picture": lambda q: self._send(viewed.picture(int(q["k"])), "image/png"),
            "contours": lambda _: self._send(viewed.contours().tobytes(), _BYTES),
        }

    def _file(self, path: Path) -> None:
        """A file, or the range of bytes that is asked for (206); several ranges: all of it, as the standard allows."""
        size = path.stat().st_size
        asked = _RANGE.fullmatch(self.headers.get("Range", ""))
        first, last, more, status = 0, size - 1, {"Accept_Ranges": "bytes"}, HTTPStatus.OK
        if asked is not None and any(asked.groups()):
            head, tail = asked.groups()
            first = int(head) if head else max(size - int(tail), 0)
            last = min(int(tail), size - 1) if head and tail else size - 1
            if first > last:
                self._begin(0, _BYTES, HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, Content_Range=f"bytes */{size}")
                return
            status, more = HTTPStatus.PARTIAL_CONTENT, {**more, "Content_Range": f"bytes {first}-{last}/{size}"}
        self._begin(last - first + 1, _BYTES, status, **more)
        with suppress(ConnectionError), open(path, "rb") as file:
            file.seek(first)
            for start in range(first, last + 1, _CHUNK):
                self.wfile.write(file.read(min(_CHUNK, last + 1 - start)))


def _numbers(text: str, count: int) -> np.ndarray:
    """So many numbers with commas between. Raises ValueError for what is none."""
    found = np.array([float(word) for word in text.split(",")])
    if len(found) != count or not np.isfinite(found).all():
        raise ValueError(f"not {count} numbers")
    return found


def _whole(pixels: np.ndarray, query: dict[str, str]) -> bytes:
    """An image (H, W, 3) as JPEG, ``width`` pixels along its longer side at most."""
    factor = min(1.0, min(int(query.get("width", 1400)), _MOST_WIDTH_PX) / max(pixels.shape[:2]))
    small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else pixels
    return cv2.imencode(".jpg", small)[1].tobytes()


def _patch(pixels: np.ndarray, query: dict[str, str]) -> bytes:
    """``size`` square pixels from (left, top) of an image (H, W, 3) as PNG; black beyond it."""
    left, top = int(query["left"]), int(query["top"])
    size = min(max(int(query.get("size", _PATCH_PX)), 1), _MOST_PATCH_PX)
    cut = Image.fromarray(pixels).crop((left, top, left + size, top + size))
    return cv2.imencode(".png", np.asarray(cut))[1].tobytes()
