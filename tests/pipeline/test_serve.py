"""`tiegraph serve`: files arrive, a run is started, followed and stopped, and nobody else gets in."""

from __future__ import annotations

import http.client
import io
import json
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tiegraph.errors import EngineMissing, InputError
from tiegraph.pipeline.pages import PageServer
from tiegraph.pipeline.serve import OPTIONS, ServeHandler, Session
from tiegraph.report.html import find_browser
from worlds import make_survey


@pytest.fixture
def served(tmp_path: Path) -> Iterator[PageServer]:
    server = PageServer(ServeHandler, Session(tmp_path / "images", tmp_path / "out"))
    server.start()
    yield server
    server.about.close()
    server.close()


def ask(server: PageServer, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, Any]:
    """The answer to a request below the token, unless ``path`` begins with /."""
    host = server.hosts[0]
    kinds = {"POST": "application/json", "PUT": "application/octet-stream"}
    given = {"Host": host, **({"Origin": f"http://{host}", "Content-Type": kinds[method]} if body is not None else {})}
    given.update({k.replace("_", "-"): v for k, v in headers.items()})
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    connection.request(method, path if path.startswith("/") else f"/{server.token}/{path}", body=body, headers=given)
    answer = connection.getresponse()
    data = answer.read()
    connection.close()
    return answer.status, json.loads(data) if "json" in answer.getheader("Content-Type", "") else data


def test_files_are_handed_over_and_nothing_is_overwritten(served: PageServer) -> None:
    images = served.about.images
    assert ask(served, "PUT", "files/up/cam0/%E5%86%99%20a.jpg", b"picture") == (200, {"new": True})
    assert (images / "up" / "cam0" / "写 a.jpg").read_bytes() == b"picture"
    assert ask(served, "PUT", "files/up/cam0/%E5%86%99%20a.jpg", b"picture") == (200, {"new": False})
    status, said = ask(served, "PUT", "files/up/cam0/%E5%86%99%20a.jpg", b"another one")
    assert status == 409 and "another file" in said["error"]
    assert ask(served, "PUT", "files/up/cam0/%E5%86%99%20a.jpg", b"PICTURE")[0] == 409  # as long, but not the same
    assert (images / "up" / "cam0" / "写 a.jpg").read_bytes() == b"picture"
    large = bytes(3 << 20)
    assert ask(served, "PUT", "files/large.tif", large)[0] == 200 and (images / "large.tif").stat().st_size == len(
        large
    )
    assert ask(served, "GET", "state")[1]["files"]["count"] == 2


@pytest.mark.parametrize(
    "name", ["../a.jpg", "up/../../a.jpg", "%2e%2e/a.jpg", "/etc/a.jpg", "a%00.jpg", "a\\b.jpg", ""]
)
def test_no_file_leaves_the_folder(served: PageServer, name: str, tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    status, said = ask(served, "PUT", f"files/{name}", b"picture")
    assert status == 409 and "image name" in said["error"] and sorted(tmp_path.rglob("*")) == before


def test_files_that_end_early_or_have_no_room_leave_nothing(tmp_path: Path) -> None:
    session = Session(tmp_path / "images", tmp_path / "out")
    with pytest.raises(InputError, match=r"a.jpg: the connection ended"):
        session.receive("a.jpg", io.BytesIO(b"half"), 8)
    with pytest.raises(InputError, match=r"a.jpg: .* no room"):
        session.receive("a.jpg", io.BytesIO(b"half"), 1 << 60)
    assert list(session.images.iterdir()) == []


def test_nobody_else_gets_in(served: PageServer) -> None:
    token = served.token
    assert ask(served, "GET", "")[0] == 200 and ask(served, "GET", "state")[0] == 200
    for path in ("/", "/state", f"/{token}", f"/{token[:-1]}/state", "/x/state", "//x", f"/{token}x/", "/%ff/", "/[/"):
        status, said = ask(served, "GET", path)
        assert status == 403 and "open the address that the terminal shows" in said["error"] and token not in str(said)
    assert ask(served, "POST", "/stop", b"{}")[0] == ask(served, "PUT", "/files/a.jpg", b"picture")[0] == 403
    assert ask(served, "GET", "state", Host=served.hosts[1])[0] == 200, "localhost"
    for wrong in ({"Host": "evil.example"}, {"Host": "127.0.0.1"}, {"Host": ""}, {"Origin": "http://evil.example"}):
        status, said = ask(served, "GET", "state", **wrong)
        assert status == 403 and "asked from elsewhere" in said["error"]
    start = b'{"options": {}, "until": "scan"}'
    for bad in ({"Origin": "http://evil.example"}, {"Content_Type": "text/plain"}, {"Host": "evil.example"}):
        assert ask(served, "POST", "start", start, **bad)[0] == 403
        assert ask(served, "PUT", "files/a.jpg", b"picture", **bad)[0] == 403
    assert ask(served, "POST", "start", b"{" * 100_000)[0] == 400
    for path in ("../../etc/passwd", "design/../../images/a.jpg", "receipts/scan.json", "tiegraph.toml"):
        assert ask(served, "GET", path)[0] == 404
    assert not served.about.running and list(served.about.images.iterdir()) == []


def test_the_address_that_a_browser_is_started_with_opens_the_page_once(
    served: PageServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr(served, "serve_forever", lambda: None)
    monkeypatch.setattr(served, "server_close", lambda: None)
    served.serve_until_interrupted(browser=True)
    assert len(opened) == 1 and served.token not in opened[0], "other users see the arguments of a process"
    page = (Path(__file__).parents[2] / "src" / "tiegraph" / "pipeline" / "serve.html").read_bytes()
    with urllib.request.urlopen(opened[0]) as answer:
        assert answer.url == served.url and answer.read() == page
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(opened[0])


@pytest.mark.parametrize(
    "options, said",
    [
        ({"pool": "dask:tcp://x"}, "pool cannot be set here"),
        ({"gnss": "track.csv"}, "track.csv was not handed over"),
        ({"rig": "--help"}, "neither a file"),
        ({"rig": "/etc/passwd"}, "neither a file"),
        ({"preset": "../x"}, "neither a file"),
    ],
)
def test_options_that_are_not_the_pages_are_refused(served: PageServer, options: dict[str, str], said: str) -> None:
    status, answer = ask(served, "POST", "start", json.dumps({"options": options}).encode())
    assert status == 400 and said in answer["error"] and not served.about.running


def until(served: PageServer, what: Any, seconds: float = 240) -> dict[str, Any]:
    """The first state that is so."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        state = ask(served, "GET", "state")[1]
        if what(state):
            return state
        time.sleep(0.2)
    raise AssertionError(state)


@pytest.mark.slow
def test_a_survey_from_its_images_to_a_stage_and_on(served: PageServer, tmp_path: Path) -> None:
    survey = make_survey(tmp_path / "own", passes=("up",), frames=4, size=(256, 192))
    for path in sorted(survey.images.rglob("*.jpg")):
        name = path.relative_to(survey.images).as_posix()
        assert ask(served, "PUT", f"files/{name}", path.read_bytes())[0] == 200
    asked = {"options": {"preset": "fast"}, "until": "scan"}
    assert ask(served, "POST", "start", json.dumps(asked).encode())[0] == 200
    state = until(served, lambda s: not s["running"])
    assert state["code"] == 0 and state["found"]["lines"][0].startswith("8 images in 4 frames")
    assert {s["stage"]: s["is"] for s in state["stages"]}["scan"] == "done"
    assert ask(served, "POST", "start", b'{"options": {"preset": "fast"}}')[0] == 200
    assert ask(served, "POST", "start", b"{}")[1]["error"].startswith("a run goes on")
    until(served, lambda s: any(p["stage"] == "preview" and p["is"] == "done" for p in s["stages"]))
    assert ask(served, "POST", "stop", b"{}")[0] == 200
    state = until(served, lambda s: not s["running"])
    assert Session(served.about.images, tmp_path / "out").state()["asked"] == {"preset": "fast"}
    assert state["stopped"] and "run the same command again" in state["lines"][-1]
    assert not state["report"] and (tmp_path / "out" / "receipts" / "preview.json").exists()


def test_the_page_names_the_options_that_there_are() -> None:
    page = (Path(__file__).parents[2] / "src" / "tiegraph" / "pipeline" / "serve.html").read_text()
    named = {line.split('"')[1] for line in page.replace("], [", "],\n[").splitlines() if line.strip().startswith('["')}
    assert len(named) > 8 and named <= set(OPTIONS)


@pytest.mark.slow
def test_a_browser_shows_what_was_found(served: PageServer, tmp_path: Path) -> None:
    try:
        browser = find_browser()
    except EngineMissing:
        pytest.skip("no browser")
    survey = make_survey(served.about.images, passes=("up",), frames=3, size=(160, 120))
    assert ask(served, "POST", "start", b'{"options": {"rig": "ring:2"}, "until": "scan"}')[0] == 200
    until(served, lambda s: not s["running"])
    words = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'browser'}"]
    asked = [browser, *words, "--virtual-time-budget=4000", "--dump-dom", served.url]
    page = subprocess.run(asked, capture_output=True, text=True, timeout=120).stdout
    assert f"6 files in {survey.images}" in page and "6 images in 3 frames; passes: up" in page
    assert "no positions are known" in page and "done in" in page and 'id="start" disabled' not in page
