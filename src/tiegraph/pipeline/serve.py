"""Glue of serving: one survey in the browser: its files arrive, a scan says what they are, a run is followed, stopped
and gone on with. The run is a process of its own, the same that the terminal would start.

Nobody else gets in (``pages``). The cloud, once it is opened, is the page of ``tiegraph view``.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from importlib.resources import files
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError, SettingsError, TiegraphError
from tiegraph.pipeline import STAGES
from tiegraph.pipeline.files import CLOUD
from tiegraph.pipeline.pages import HTML, Handler, PageServer, ViewHandler
from tiegraph.pipeline.scan import describe
from tiegraph.pipeline.view import open_view
from tiegraph.project.folder import SETTINGS
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import SETTING_OF, merged, read_file
from tiegraph.project.stages import Receipts
from tiegraph.scene.atomic import replacing
from tiegraph.scene.names import inside
from tiegraph.scene.scene import Scene
from tiegraph.text import counted

_CHUNK = 1 << 20  # bytes of an upload read at once
_ROOM = 1 << 28  # bytes of the disk that uploads leave free
# What the page may set: the option of `tiegraph run`, and whether it may be the name of a file that was handed over.
OPTIONS = {
    "rig": True, "camera": True, "gnss": True, "times": True, "gcp": True, "marks": True, "trajectory": True,
    "start": True, "scan.crs": False, "scan.layout": False, "preset": False, "tolerance": False,
}  # fmt: skip
_ONLY_FILES = ("gnss", "times", "gcp", "marks", "start")
_MOST_JSON = 1 << 16  # bytes of what the page asks for
_KINDS = {".png": "image/png", ".jpg": "image/jpeg", ".html": HTML}
_PICTURES = ("candidates", "network", "coarse", "design", "products", "evaluate")


class Session:
    """A folder of images that may still grow, its run folder, and the process that works on them, if one does."""

    def __init__(self, images: Path, out: Path) -> None:
        self.images, self.out = images, out
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._lines: list[str] = []
        self._stages: dict[str, dict[str, Any]] = {}
        self._asked = _asked_before(images, out)
        self._stopped = False
        self._view: PageServer | None = None
        images.mkdir(parents=True, exist_ok=True)

    def receive(self, name: str, source: BufferedIOBase, length: int) -> bool:
        """Write a file of so many bytes below the folder of images; False if the same is there already.

        Raises InputError for a name that leads elsewhere, for another file of that name, for a file that ends early and
        for one that the disk has no room for."""
        target = inside(self.images, name)
        if target.exists():
            if target.is_file() and target.stat().st_size == length and _same(source, length, target):
                return False
            raise InputError(f"{name}: another file of this name is there already; it is kept. Rename yours")
        if length > shutil.disk_usage(self.images).free - _ROOM:
            raise InputError(f"{name}: {length / 1e9:.2g} GB have no room on the disk; free some space")
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as temporary, open(temporary, "wb") as file:
            if _copy(source, length, file.write) < length:
                raise InputError(f"{name}: the connection ended before the file did; hand it over again")
        return True

    def start(self, options: dict[str, str], until: str | None) -> None:
        """Start `tiegraph run` with these options; ``until``: the last stage. Raises InputError for an option that
        cannot be set here, for a file that was not handed over, and while a run goes on."""
        words = [word for name, value in options.items() if value for word in self._option(name, value)]
        command = [sys.executable, "-m", "tiegraph.cli.main", "run", str(self.images), "-o", str(self.out), "--json"]
        with self._lock:
            if self.running:
                raise InputError("a run goes on: stop it first")
            forget = [w for n in self._asked if not options.get(n) for w in ("--unset", ".".join(_STORED.get(n, (n,))))]
            self._asked = {n: v for n, v in options.items() if v}
            self._lines, self._stages, self._stopped = [], {}, False
            self._process = subprocess.Popen(
                [*command, *words, *forget, *([] if until is None else ["--until", until])],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True,
                encoding="utf-8", errors="replace", start_new_session=True,
            )  # fmt: skip
            threading.Thread(target=self._listen, args=(self._process,), daemon=True, name="serve-run").start()

    def _option(self, name: str, value: str) -> list[str]:
        if name not in OPTIONS:
            raise InputError(f"{name} cannot be set here: give it to `tiegraph run` in a terminal")
        if OPTIONS[name]:
            with suppress(InputError):
                if (path := inside(self.images, value)).exists():
                    return [f"--{name}", str(path)]
            if name in _ONLY_FILES:
                raise InputError(f"{name}: {value} was not handed over; drop the file on the page first")
        if value.startswith("-") or "/" in value or os.sep in value:
            raise InputError(f"{name}: {value!r} is neither a file that was handed over nor a value")
        return [f"--{name}", value]

    def stop(self) -> None:
        """End the run as Ctrl-C does: finished items are kept."""
        with self._lock:
            if self._process is not None and self.running:
                self._stopped = True
                self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End the run and wait for it."""
        self.stop()
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(30)

    @property
    def running(self) -> bool:
        """Whether a run goes on."""
        return self._process is not None and self._process.poll() is None

    def _listen(self, process: "subprocess.Popen[str]") -> None:
        assert process.stdout is not None
        for line in process.stdout:
            try:
                event = json.loads(line)
                self._stages.setdefault(event["stage"], {}).update(event)
            except (ValueError, TypeError, KeyError):
                if line.strip() and not line.startswith("{"):
                    self._lines = [*self._lines, line.rstrip()][-200:]

    def state(self) -> dict[str, Any]:
        """All that the page shows."""
        with self._lock:
            process, stages, lines = self._process, dict(self._stages), list(self._lines)
        code, receipts = None if process is None else process.poll(), Receipts(self.out)
        return {
            "images": str(self.images), "out": str(self.out), "files": self._files(), "running": process is not None
            and code is None, "code": code, "stopped": self._stopped, "asked": self._asked, "lines": lines,
            "stages": [{"stage": s.name, **_told(receipts.read(s.name) | stages.get(s.name, {}))} for s in STAGES],
            "found": self._found(), "pictures": self.pictures(),
            **{n: (self.out / f).is_file() for n, f in (("report", "report.html"), ("cloud", CLOUD))},
        }  # fmt: skip

    def view(self) -> str:
        """Where ``tiegraph view`` shows the cloud, with what the run has made so far. Raises InputError without one."""
        viewed = open_view(Run(self.out, Inputs(self.images), merged()))
        if self._view is not None:
            self._view.close()
        self._view = PageServer(ViewHandler, viewed)
        self._view.start()
        return self._view.url

    def _files(self) -> dict[str, Any]:
        """How many files were handed over, and those that an option may name."""
        names = [p.relative_to(self.images).as_posix() for p in self.images.rglob("*") if p.is_file()]
        others = [n for n in names if Path(n).suffix.lower() in _TABLES]
        return {"count": len(names), "tables": sorted(others)[:100]}

    def _found(self) -> dict[str, Any] | None:
        """What the scan found: lines, and places of frames on a plan; None before there is a scan."""
        try:
            scene = Scene.from_json((self.out / "scene.json").read_text())
        except (OSError, ValueError, TiegraphError):
            return None
        place = scene.world_from_rig[:, :2, 3]
        known = np.flatnonzero(np.isfinite(place).all(axis=1))
        known = known[:: max(len(known) // 3000, 1)]  # drawn on the map
        places = [[round(float(x), 2), round(float(y), 2), int(scene.sequence[k])] for k, (x, y) in
                  zip(known, place[known])]  # fmt: skip
        return {"lines": describe(scene), "places": places, "passes": list(scene.sequences)}

    def pictures(self) -> list[str]:
        """Pictures of the run, by their path below its folder."""
        found = [p for folder in _PICTURES for p in (self.out / folder).rglob("*") if p.suffix in (".png", ".jpg")]
        return [p.relative_to(self.out).as_posix() for p in sorted(found) if p.is_file()][:60]


# Where tiegraph.toml has what is no input of a run
_STORED = {"scan.crs": ("scan", "crs"), "scan.layout": ("scan", "layout"),
           **{n: SETTING_OF[n] for n in ("gcp", "marks", "tolerance")}}  # fmt: skip
_TABLES = (
    ".csv", ".txt", ".toml", ".json", ".yaml", ".yml", ".xml", ".nmea", ".pos", ".gpx", ".kml", ".kmz", ".mrk", ".tum",
    ".sbet", ".out",
)  # fmt: skip


def _told(event: dict[str, Any]) -> dict[str, Any]:
    kind = {"started": "runs", "finished": "done", "skipped": "up to date", "lost": "nothing came of it"}
    counts = counted(event.get("counts", {}))
    said = {"is": kind.get(event.get("event", ""), ""), "seconds": event.get("seconds"), "counts": counts}
    warnings = [event["why"]] if "why" in event else list(event.get("contradictions", ()))
    return {**said, "warnings": warnings, "notes": list(event.get("notes", ()))}


def _asked_before(images: Path, out: Path) -> dict[str, str]:
    """The options that an earlier run of the folder was given, as the page names them."""
    try:
        stored = read_file(out / SETTINGS)
    except SettingsError:
        return {}
    values = {name: stored.get(section, {}).get(key) for name, (section, key) in _STORED.items()}
    values |= {name: stored.get("run", {}).get(name) for name in OPTIONS if name not in values}
    return {n: Path(str(v)).relative_to(images).as_posix() if Path(str(v)).is_relative_to(images) else str(v)
            for n, v in values.items() if v not in (None, "")}  # fmt: skip


def _copy(source: BufferedIOBase, length: int, write: Callable[[bytes], Any]) -> int:
    done = 0
    while done < length and (part := source.read(min(_CHUNK, length - done))):
        write(part)
        done += len(part)
    return done


def _same(source: BufferedIOBase, length: int, path: Path) -> bool:
    """Whether so many bytes are those of a file."""
    differing: list[bytes] = []
    with open(path, "rb") as own:
        done = _copy(source, length, lambda part: own.read(len(part)) == part or differing.append(b""))
    return done == length and not differing


class ServeHandler(Handler):
    """The page of one survey (``Session``)."""

    def _answers(self) -> dict[str, Callable[[dict[str, str]], None]]:
        session, page = self.server.about, files("tiegraph.pipeline").joinpath("serve.html")
        made = {name: session.out / name for name in ("report.html", *session.pictures())}
        return {
            "": lambda _: self._send(page.read_bytes(), HTML),
            "state": lambda _: self._json(session.state()),
            **{name: partial(self._made, path) for name, path in made.items() if path.is_file()},
        }

    def _made(self, path: Path, _: dict[str, str]) -> None:
        self._send(path.read_bytes(), _KINDS[path.suffix])

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
            new = self.server.about.receive(path.removeprefix("files/"), self.rfile, int(length))
        except (TiegraphError, OSError) as error:
            self._refuse(HTTPStatus.CONFLICT, str(error))
            return
        self._json({"new": new})

    def do_POST(self) -> None:
        """Start ({"options": {...}, "until": stage or null}) or stop the run: the state; or show the cloud: where."""
        path = self._asked("application/json")
        most = _MOST_JSON if path in ("start", "stop", "view") else 0
        sent = None if path is None else self._sent(most, "neither start, stop nor view")
        if sent is None:
            return
        try:
            data, session = json.loads(sent or b"{}"), self.server.about
            if path == "view":
                with self.server.lock:
                    self._json({"url": session.view()})
                return
            if path == "stop":
                session.stop()
            else:
                options = {str(k): str(v) for k, v in dict(data.get("options", {})).items()}
                session.start(options, "scan" if data.get("until") == "scan" else None)
            self._json(session.state())
        except (TypeError, ValueError, AttributeError, TiegraphError) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
