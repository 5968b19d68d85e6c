"""Marking in the browser: predictions against truth, the file that is written, and a server that serves nobody else."""

from __future__ import annotations

import json
from http.client import HTTPConnection
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from targets.targets_world import EAST, NORTH, PLACES, survey, table
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.pipeline.mark import ChangedMeanwhile, Marking, open_marking
from tiegraph.pipeline.pages import MarkHandler, PageServer
from tiegraph.project.settings import Settings
from tiegraph.scene.gcp import read_gcps

pytestmark = pytest.mark.slow
NAMES = ["A", "B", "C", "D", "E 5"]
TRUE = np.array(list(PLACES.values()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mark")
    survey(folder, "# crs: EPSG:32654\nname,x,y,z\nA,1,2,3\n")
    return folder


def opened(folder: Path, tmp_path: Path, name: str = "gcp_list.txt", crs: str = "# crs: EPSG:32654\n") -> Marking:
    rows = "".join(f"{n},{EAST + x:.5f},{NORTH + y:.5f},{z:.5f}\n" for n, (x, y, z) in zip(NAMES, TRUE))
    (tmp_path / "points.csv").write_text(f"{crs}name,x,y,z\n{rows}")
    run = SimpleNamespace(path=folder.joinpath, settings=Settings())
    return open_marking(run, tmp_path / "points.csv", tmp_path / name)  # type: ignore[arg-type]


def pixel(session: Marking, image: int, point: int) -> tuple[float, float]:
    """Where an image truly sees a point."""
    world = table()
    x, y = np.ravel(world.camera.img_from_cam(transforms.apply(world.poses[image], TRUE[point])))
    return float(x), float(y)


def test_after_three_points_the_rest_is_predicted_and_marks_become_a_file(folder: Path, tmp_path: Path) -> None:
    session = opened(folder, tmp_path)
    state = session.state()
    assert not state["predicting"] and state["posed"] == 8 and all(not p["images"] for p in state["points"])
    rng = np.random.default_rng(0)
    for point in range(3):
        for image in (0, 2, 4):
            x, y = pixel(session, image, point) + 0.3 * rng.standard_normal(2)
            session.set(point, image, (float(x), float(y)))
    state = session.state()
    assert state["predicting"] and len(state["points"][3]["images"]) == 8
    off = [np.subtract(r["predicted"], pixel(session, r["image"], 3)) for r in state["points"][3]["images"]]
    assert 0.02 < np.abs(off).max() < 2
    first = state["points"][0]
    assert first["marks"] == 3 and 0.01 < first["rms_px"] < 0.6 and 0 < first["off_m"] < 0.003
    session.set(0, 0, tuple(np.add(pixel(session, 0, 0), (6.0, 0.0))))
    worse = {r["image"]: r["off_px"] for r in session.state()["points"][0]["images"]}
    assert 1 < worse[0] < 6 and session.state()["points"][0]["rms_px"] > 1, "a residual after each mark"
    session.set(0, 0, None)
    found = read_gcps(tmp_path / "gcp_list.txt")
    assert found.crs == "EPSG:32654" and len(found.marks) == 8 and found.marks[0].image == "002.png"
    assert found.marks[0].xy == pytest.approx(session.marks[0, 2], abs=6e-4)
    again = opened(folder, tmp_path)
    assert again.marks.keys() == session.marks.keys(), "gone on with"


def test_a_file_that_was_changed_meanwhile_is_not_written_over(folder: Path, tmp_path: Path) -> None:
    session = opened(folder, tmp_path)
    session.set(0, 0, (10.0, 20.0))
    (tmp_path / "gcp_list.txt").write_text("mine\n")
    with pytest.raises(ChangedMeanwhile, match="changed by another program"):
        session.set(0, 1, (10.0, 20.0))
    assert (tmp_path / "gcp_list.txt").read_text() == "mine\n" and (0, 1) not in session.marks


def test_what_a_gcp_list_cannot_hold_a_csv_can(folder: Path, tmp_path: Path) -> None:
    session = opened(folder, tmp_path)
    with pytest.raises(InputError, match="'E 5' has blanks.* ends in .csv"):
        session.set(4, 0, (5.0, 6.0))
    assert not session.marks and not (tmp_path / "gcp_list.txt").exists()
    session = opened(folder, tmp_path, "marks.csv")
    session.set(4, 0, (5.0, 6.0))
    found = read_gcps(tmp_path / "marks.csv")
    assert len(found.points) == 5 and found.marks[0].name == "E 5" and found.marks[0].xy == (5.0, 6.0)


def test_files_that_cannot_be_marked_say_why(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the CRS of its coordinates is unknown"):
        opened(folder, tmp_path, crs="")
    (tmp_path / "gcp_list.txt").write_text(f"EPSG:32654\n{EAST} {NORTH} 3 1 1 000.png other\n")
    with pytest.raises(InputError, match=r"gcp_list.txt, line 2: point 'other' is not among those of this session"):
        opened(folder, tmp_path)


def test_the_server_serves_this_page_and_nobody_else(folder: Path, tmp_path: Path) -> None:
    server = PageServer(MarkHandler, opened(folder, tmp_path))
    server.start()
    host = f"127.0.0.1:{server.server_port}"

    def ask(
        method: str, path: str, body: object = None, token: str = server.token, **headers: str
    ) -> tuple[int, bytes]:
        connection = HTTPConnection("127.0.0.1", server.server_port, timeout=20)
        sent = {"Host": host, **{n.replace("_", "-"): v for n, v in headers.items()}}
        connection.request(method, f"/{token}{path}", None if body is None else json.dumps(body), sent)
        answer = connection.getresponse()
        return answer.status, answer.read()

    try:
        status, page = ask("GET", "/")
        assert status == 200 and b"Marking control points" in page and b"http" not in page.replace(b"<!doctype", b"")
        assert ask("GET", "/state")[0] == 200
        assert ask("GET", "/state", Host="evil.example:80")[0] == 403, "a rebound name"
        assert ask("GET", "/state", Origin="http://evil.example")[0] == 403
        good = {"Origin": f"http://{host}", "Content_Type": "application/json"}
        mark = {"point": 0, "image": 1, "xy": [5.25, 6.5]}
        for token in ("", "x", server.token[1:]):
            assert ask("GET", "/state", token=token)[0] == ask("GET", "/image?k=0", token=token)[0] == 403
            assert ask("POST", "/mark", mark, token, **good)[0] == 403
        assert ask("POST", "/mark", mark, Content_Type="application/json")[0] == 403, "no origin"
        assert ask("POST", "/mark", mark, Origin=f"http://{host}", Content_Type="text/plain")[0] == 403, "a form"
        status, state = ask("POST", "/mark", mark, **good)
        assert status == 200 and json.loads(state)["points"][0]["images"][0]["mark"] == [5.25, 6.5]
        for wrong in ({"image": 99}, {"image": -1}, {"xy": [1e9, 0]}, {"xy": [1]}):
            assert ask("POST", "/mark", mark | wrong, **good)[0] == 400, wrong
        assert ask("POST", "/mark", {"point": 0}, **good)[0] == 400
        elsewhere = ("/../points.csv", "/images/000.png", "/patch?k=../../points.csv&left=0&top=0")
        for path in (*elsewhere, "/image?k=8", "/patch?k=0"):
            assert ask("GET", path)[0] in (400, 404), path
        status, patch = ask("GET", "/patch?k=0&left=-10&top=20&size=40")
        pixels = cv2.imdecode(np.frombuffer(patch, np.uint8), cv2.IMREAD_COLOR)
        truth = cv2.imread(str(folder / "images/000.png"))
        assert pixels.shape == (40, 40, 3) and (pixels[:, :10] == 0).all()
        np.testing.assert_array_equal(pixels[:, 10:], truth[20:60, :30])
        (tmp_path / "gcp_list.txt").write_text("mine\n")
        status, said = ask("POST", "/mark", mark, **good)
        assert status == 409 and b"changed by another program" in said
    finally:
        server.close()
