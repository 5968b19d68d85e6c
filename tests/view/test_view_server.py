"""What the server of the page gives, and to nobody else; the page in a real browser."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from tiegraph.api import open_project
from tiegraph.cli.main import main
from tiegraph.errors import EngineMissing
from tiegraph.pipeline.files import CLOUD
from tiegraph.pipeline.pages import PageServer, ViewHandler
from tiegraph.pipeline.view import open_view
from tiegraph.report.html import find_browser
from tiegraph.scene.atomic import MARK
from view.view_world import as_run

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "src" / "tiegraph" / "view"
Ask = Callable[..., tuple[HTTPResponse, bytes]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("view")


@pytest.fixture(scope="module")
def ask(folder: Path) -> Iterator[Ask]:
    """Asks the server of a run: path below the token, headers -> answer and its body; ``token``: another."""
    (folder / "secret.txt").write_text("mine")
    server = PageServer(ViewHandler, as_run(folder))
    server.start()

    def asked(path: str, token: str = f"/{server.token}", **headers: str) -> tuple[HTTPResponse, bytes]:
        connection = HTTPConnection("127.0.0.1", server.server_port, timeout=20)
        sent = {"Host": server.hosts[0], **{n.replace("_", "-"): v for n, v in headers.items()}}
        connection.request("GET", token + path, headers=sent)
        answer = connection.getresponse()
        return answer, answer.read()

    yield asked
    server.close()


@pytest.mark.slow
def test_the_cloud_comes_by_ranges(ask: Ask, folder: Path) -> None:
    data = (folder / CLOUD).read_bytes()
    size = len(data)
    for asked, part in {"0-99": data[:100], "100-": data[100:], "-50": data[-50:], f"7-{size + 9}": data[7:]}.items():
        answer, body = ask(f"/{CLOUD}", Range=f"bytes={asked}")
        first = 0 if asked[0] == "0" else size - len(part)
        assert answer.status == 206 and body == part, asked
        assert answer.headers["Content-Range"] == f"bytes {first}-{first + len(part) - 1}/{size}"
    answer, body = ask(f"/{CLOUD}", Range=f"bytes={size}-")
    assert answer.status == 416 and answer.headers["Content-Range"] == f"bytes */{size}"
    for asked in ("", "bytes=-", "bytes=0-1,5-6", "lines=0-5"):
        answer, body = ask(f"/{CLOUD}", Range=asked)
        assert answer.status == 200 and body == data and answer.headers["Accept-Ranges"] == "bytes"


@pytest.mark.slow
def test_only_what_is_named_is_served(ask: Ask) -> None:
    for path in (
        "/secret.txt", "/../secret.txt", "/images/../secret.txt", "/%2e%2e/secret.txt", "/..%2fsecret.txt",
        f"/{CLOUD}/../secret.txt", "//etc/passwd", "/images/cam/000.png", "/view.js/../page.html",
    ):  # fmt: skip
        answer, body = ask(path)
        assert answer.status == 404 and b"mine" not in body, path
    for path in ("/image?k=4", "/image?k=-1", "/image?k=../secret.txt", "/image", "/mesh?k=0", "/picture?k=0"):
        assert ask(path)[0].status == 400, path
    for path in (
        "/contours",
        "/pick?at=0,0",
        "/pick?at=nan,0,0",
        "/pick?at=0,inf,0",
        "/apart?at=0,0,0&sigma=0,0",
        "/patch?k=0&left=1",
    ):
        assert ask(path)[0].status == 400, path
    answer, body = ask("/pick?at=0,0,3")
    assert answer.status == 400 and b"no point of the cloud is near" in body
    assert json.loads(ask("/apart?at=0,0,0,3,4,0&sigma=0,0")[1])["distance"] == 5
    assert ask("/image?k=0&width=64")[1][:2] == b"\xff\xd8" and ask("/patch?k=0&left=0&top=0")[1][1:4] == b"PNG"


@pytest.mark.slow
def test_other_users_and_other_sites_are_refused(ask: Ask) -> None:
    for path in ("/", f"/{CLOUD}", "/image?k=0"):
        assert ask(path)[0].status == 200
        for token in ("", "/", "/x", "/view.js/.."):
            assert ask(path, token)[0].status == 403, "another user of the machine"
        assert ask(path, Host="evil.example:80")[0].status == 403, "a rebound name"
        assert ask(path, Origin="http://evil.example")[0].status == 403
        for site in ("cross-site", "same-site"):
            assert ask(path, Sec_Fetch_Site=site)[0].status == 403
    assert ask("/", Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate")[0].status == 200, "a link that is followed"
    policy = ask("/")[0].headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'self'; script-src 'self' 'wasm-unsafe-eval'") and "http" not in policy


@pytest.mark.slow
def test_the_page_names_nothing_elsewhere(ask: Ask) -> None:
    page = ask("/")[1].decode()
    assert set(re.findall(r'(?:src|href)="([^"]+)"', page)) == {"view.js", "licences.txt"} and "://" not in page
    for path in ("/view.js", "/laz-perf.wasm", "/licences.txt"):
        assert ask(path)[0].status == 200


def test_the_bundle_is_that_of_its_sources() -> None:
    """`npm ci && npm run build` in web/ makes it anew."""
    web, digest = ROOT / "web", hashlib.sha256()
    for path in (web / "build.mjs", web / "package.json", *sorted((web / "src").iterdir(), key=lambda p: p.name)):
        digest.update(f"{path.relative_to(web).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    script = (SHIPPED / "view.js").read_text()
    assert digest.hexdigest() in script.splitlines()[0], "stale: cd web && npm ci && npm run build"
    assert len(script.encode()) < 1_100_000
    licences = (SHIPPED / "licences.txt").read_text()
    for name in ("three", "copc", "laz-perf"):
        assert name in script.splitlines()[1] and name in licences
    assert "resolved" not in (web / "package-lock.json").read_text()


def test_a_run_without_a_cloud_says_what_makes_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / MARK).parent.mkdir(parents=True)
    (tmp_path / MARK).write_text('{"made by": "tiegraph run", "format": 3}')
    (tmp_path / "tiegraph.toml").write_text(f'[run]\nimages = "{tmp_path}"\n')
    assert main(["view", str(tmp_path), "--no-browser"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"{CLOUD} is not there" in said and "tiegraph cloud" in said


if TYPE_CHECKING:
    from campaign.world import World

SIZE = (1000, 700)


@pytest.mark.slow
def test_a_browser_draws_the_cloud_of_a_run(finished: World, tmp_path: Path) -> None:
    try:
        browser = find_browser()
    except EngineMissing:
        pytest.skip("no browser of the Chromium family on the PATH")
    viewed = open_view(open_project(None, finished.after("report", tmp_path / "run")).as_run())
    said = viewed.layers()
    assert said["ties"] and said["cameras"] and viewed.points > 1000
    for k in range(len(said["sheets"])):
        rows, columns = viewed.mesh(k)[:2]
        assert len(viewed.mesh(k)) == 2 + 3 * rows * columns and viewed.picture(k)[1:4] == b"PNG"
    server = PageServer(ViewHandler, viewed)
    server.start()
    place = ",".join(f"{v:.3f}" for v in viewed.middle)
    shot = tmp_path / "shot.png"
    command = [browser, "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run"]
    command += ["--no-sandbox"] if os.geteuid() == 0 else []
    command += [f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={SIZE[0]},{SIZE[1]}"]
    command += ["--virtual-time-budget=20000", f"--screenshot={shot}", f"{server.url}#{place}"]
    try:
        subprocess.run(command, capture_output=True, timeout=240, check=True)
    finally:
        server.close()
    drawn = cv2.imread(str(shot))[:, 340:]
    off = np.abs(drawn.astype(int) - drawn[5, 5]).max(axis=2) > 20
    assert 0.03 < off.mean() < 0.95 and len(np.unique(drawn[off], axis=0)) > 200
