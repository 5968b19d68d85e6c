"""The page of ``tiegraph serve``, on the loopback, below an address that nobody can guess.

Whoever does not know the token in the address learns nothing here, other users of the machine and other sites in the
browser included; what changes something must also come from this very origin (``pages``). The cloud, once it is opened,
is the page of ``tiegraph view``, which other users of the machine could open too.
"""

import json
import secrets
import threading
from http import HTTPStatus
from importlib.resources import files
from urllib.parse import unquote, urlsplit

from tiegraph.errors import TiegraphError
from tiegraph.pipeline.pages import HTML, Handler, PageServer, ViewServer
from tiegraph.pipeline.serve import Session

_MOST_JSON = 1 << 16  # bytes of what the page asks for
_KINDS = {".png": "image/png", ".jpg": "image/jpeg"}


class ServeServer(PageServer):
    """Serves one survey."""

    def __init__(self, session: Session, port: int = 0) -> None:
        super().__init__(port, _ServeHandler)
        self.session, self.token, self.lock = session, secrets.token_urlsafe(24), threading.Lock()
        self._view: ViewServer | None = None

    def view(self) -> str:
        """Where the cloud is shown, with what the run has made so far. Raises InputError without one."""
        with self.lock:
            viewed = self.session.viewed()
            if self._view is not None:
                self._view.shutdown()
                self._view.server_close()
            self._view = ViewServer(viewed, 0)
            threading.Thread(target=self._view.serve_forever, daemon=True, name="serve-view").start()
            return self._view.url

    @property
    def url(self) -> str:
        """Where the page is, with its token."""
        return f"{super().url}{self.token}/"


class _ServeHandler(Handler):
    server: ServeServer

    def _asked(self, changes: str = "") -> str | None:
        """The path below the token, None if this request is refused; ``changes``: the type of what it sends."""
        if not self._allowed(changes):
            return None
        path = unquote(urlsplit(self.path).path)
        token, slash, rest = path.removeprefix("/").partition("/")
        if not slash or not secrets.compare_digest(token.encode(), self.server.token.encode()):
            self.close_connection = True
            self._refuse(HTTPStatus.FORBIDDEN, "the address lacks its token: open the one that the terminal shows")
            return None
        return rest

    def do_GET(self) -> None:
        """The page, the state, the report or a picture of the run."""
        path = self._asked()
        session = self.server.session
        if path is None:
            return
        if path == "":
            self._send(files("tiegraph.pipeline").joinpath("serve.html").read_bytes(), HTML)
        elif path == "state":
            self._json(session.state())
        elif path == "report.html" and (session.out / path).is_file():
            self._send((session.out / path).read_bytes(), HTML)
        elif path in session.pictures():
            target = session.out / path
            self._send(target.read_bytes(), _KINDS[target.suffix])
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "no such page")

    def do_PUT(self) -> None:
        """A file of the survey, files/<its path below the folder of images>."""
        path = self._asked("application/octet-stream")
        length = self.headers.get("Content-Length", "")
        if path is None:
            return
        self.close_connection = True  # of what is refused the rest is not read
        if not path.startswith("files/") or not length.isdigit():
            self._refuse(HTTPStatus.BAD_REQUEST, "not a file with its length")
            return
        try:
            new = self.server.session.receive(path.removeprefix("files/"), self.rfile, int(length))
        except (TiegraphError, OSError) as error:
            self._refuse(HTTPStatus.CONFLICT, str(error))
            return
        self._json({"new": new})

    def do_POST(self) -> None:
        """Start ({"options": {...}, "until": stage or null}) or stop the run: the state that follows; or show the
        cloud: where that is."""
        path = self._asked("application/json")
        length = self.headers.get("Content-Length", "")
        if path is None:
            return
        if path not in ("start", "stop", "view") or not length.isdigit() or int(length) > _MOST_JSON:
            self.close_connection = True
            self._refuse(HTTPStatus.BAD_REQUEST, "neither start, stop nor view")
            return
        try:
            data = json.loads(self.rfile.read(int(length)) or b"{}")
            if path == "view":
                self._json({"url": self.server.view()})
                return
            if path == "stop":
                self.server.session.stop()
            else:
                options = {str(k): str(v) for k, v in dict(data.get("options", {})).items()}
                self.server.session.start(options, "scan" if data.get("until") == "scan" else None)
            self._json(self.server.session.state())
        except (TypeError, ValueError, AttributeError, TiegraphError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
