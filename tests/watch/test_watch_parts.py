"""Watch: arriving files, frames and page in parts; `tiegraph watch` on images that are copied one by one."""

import json
import os
import re
import shutil
import time
import urllib.error
import urllib.request
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pycolmap
import pytest

from boat_world import photos
from odometry.odometry_world import images, rig_of, stereo, truth
from said import refused
from tiegraph.api import open_project
from tiegraph.cli.main import main
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.pipeline.pages import PageServer, WatchHandler
from tiegraph.pipeline.watch import KEPT, PAGE, Watched
from tiegraph.pipeline.watchmodel import resect_previews
from tiegraph.project.progress import Reporter
from tiegraph.project.run import Run
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.watch.onsite import Arrivals, Known, page, path_and_ties, place_frames, plan_from_world
from tiegraph.watch.tuning import ArrivalsTuning, ModelTuning, Tuning

SETTLED = ArrivalsTuning(settled_s=0.6, again_s=5.0, tries=3)


@pytest.fixture
def card(tmp_path):
    (tmp_path / "card").mkdir()
    return tmp_path / "card"


def put(card, name, size, time_s=1000):
    path = card / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"x" * size)
    os.utime(path, (time_s, time_s))


def test_a_file_is_handed_out_when_it_has_stopped_growing(card):
    arrivals = Arrivals(card, SETTLED)
    put(card, "a.jpg", 100)
    assert arrivals.look(0.0) == []
    put(card, "a.jpg", 200)
    assert arrivals.look(0.5) == [] and arrivals.look(1.0) == []
    assert arrivals.look(1.2) == ["a.jpg"] and arrivals.waiting() == 1
    arrivals.opened("a.jpg", True, 1.2)
    assert arrivals.look(100.0) == [] and arrivals.waiting() == 0
    put(card, "a.jpg", 200, 1001)  # another picture of the same name
    assert arrivals.look(101.0) == [] and arrivals.look(102.0) == ["a.jpg"]


def test_a_broken_file_is_opened_again_later_and_less_often_then_no_more(card):
    arrivals = Arrivals(card, SETTLED)
    put(card, "a.jpg", 100)
    handed = []
    for now in np.arange(0, 60, 0.5):
        if arrivals.look(now):
            handed.append(now)
            arrivals.opened("a.jpg", False, now)
    assert len(handed) == SETTLED.tries
    assert handed[1] - handed[0] == pytest.approx(5, abs=0.5) and handed[2] - handed[1] == pytest.approx(10, abs=0.5)
    put(card, "a.jpg", 120)
    arrivals.look(200.0)
    assert arrivals.look(201.0) == ["a.jpg"], "it has changed, so it is opened again"


def test_a_card_that_is_pulled_out_is_said_and_comes_back(card, tmp_path):
    arrivals = Arrivals(card, SETTLED)
    assert "empty" in (arrivals.look(0.0) or arrivals.trouble)
    put(card, "DCIM/a.jpg", 100)
    arrivals.look(0.0)
    assert arrivals.look(1.0) == ["DCIM/a.jpg"] and not arrivals.trouble
    arrivals.opened("DCIM/a.jpg", True, 1.0)
    shutil.move(card, tmp_path / "away")
    assert arrivals.look(2.0) == [] and str(card) in arrivals.trouble and "gone" in arrivals.trouble
    shutil.move(tmp_path / "away", card)
    put(card, "DCIM/b.jpg", 100)
    arrivals.look(3.0)
    assert arrivals.look(4.0) == ["DCIM/b.jpg"] and not arrivals.trouble


def test_files_are_handed_out_in_the_order_they_were_written(card):
    arrivals = Arrivals(card, SETTLED)
    for name, time_s in (("b.jpg", 1000), ("a.jpg", 1001), ("c.jpg", 999)):
        put(card, name, 100, time_s)
    arrivals.look(0.0)
    assert arrivals.look(1.0) == ["c.jpg", "b.jpg", "a.jpg"]


IMAGES, POINTS = 5, 300
CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[500, 320, 240])


def world(noise_px=0.5, step=0.7):
    """A row of photographs of a wall: poses, key points of each (a feature a point), ties of all with all."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-3, 6, POINTS), rng.uniform(-2, 2, POINTS), rng.uniform(8, 12, POINTS)])
    poses = np.stack([transforms.rigid(np.eye(3), [-step * k, 0, 0]) for k in range(IMAGES)])
    seen = [np.asarray(CAMERA.img_from_cam(transforms.apply(p, points))) for p in poses]
    seen = [xy + rng.normal(0, noise_px, xy.shape) for xy in seen]
    i, j = np.triu_indices(IMAGES, 1)
    every = np.stack([np.arange(POINTS)] * 2, axis=1)
    return poses, seen, PreviewMatches.make(i, j, [every] * len(i))


def placed(poses, seen, ties, known):
    scene = photos(IMAGES)
    start = np.where(np.isin(np.arange(IMAGES), known)[:, None, None], poses, np.nan)
    rig = calibrated_rig(scene)
    state = Known(start, [CAMERA] * IMAGES, lambda k: seen[k], [rig])
    frames = [int(scene.frame[k]) for k in range(IMAGES) if k not in known]
    how = partial(resect_previews, size_px=400)
    return place_frames(scene, ties, state, frames, how)


def calibrated_rig(scene):
    (rig,) = scene.rigs
    return replace(rig, sensors=(replace(rig.sensors[0], camera=CAMERA, sensor_from_rig=np.eye(4)),))


def test_frames_are_placed_one_by_one_from_those_before():
    poses, seen, ties = world()
    found = placed(poses, seen, ties, known=[0, 1])
    off = np.linalg.norm(transforms.centre(found) - transforms.centre(poses), axis=1)
    assert np.all(off[:2] == 0) and 1e-6 < off[2:].max() < 0.15


def test_points_without_base_and_ties_of_another_wall_place_nothing():
    poses, seen, ties = world()
    assert np.isnan(placed(poses, seen, ties, known=[0])[1:]).all(), "one image tells no point"
    near, seen_near, _ = world(step=0.03)
    assert np.isnan(placed(near, seen_near, ties, known=[0, 1])[2:]).all(), "nor do two at one place"
    rng = np.random.default_rng(2)
    wrong = [xy if k < 2 else rng.uniform(0, 480, xy.shape) for k, xy in enumerate(seen)]
    assert np.isnan(placed(poses, wrong, ties, known=[0, 1])[2:]).all()


def test_positions_tell_what_is_up_where_cameras_look_down():
    poses = np.stack([transforms.rigid(np.diag([1.0, -1, -1]), [-x, y, 30]) for x in range(4) for y in (0, 5)])
    scene = photos(len(poses))
    there = np.tile(np.eye(4), (len(poses), 1, 1))
    there[:, :3, 3] = 2 * transforms.centre(poses)
    known = scene.with_(world_from_rig=there, position_sigma_m=np.full((len(poses), 3), 0.1), prior="exif")
    plan, scale = plan_from_world(poses, known)
    assert scale == pytest.approx(2) and plan[2, :3] == pytest.approx([0, 0, 2], abs=1e-6)


def test_positions_turn_and_scale_the_plan():
    poses, _, ties = world()
    scene, scale, turn = photos(IMAGES), 7.0, np.radians(30)
    there = np.zeros((scene.frames, 4, 4))
    there[:, :3, :3] = np.eye(3)
    along = scale * 0.7 * np.arange(IMAGES)
    bend = 0.5 * (np.arange(IMAGES) == 2)
    poses[:, 2, 3] -= bend / scale
    local = along + 1j * bend
    world_xy = local * np.exp(1j * turn)
    there[scene.frame, 0, 3], there[scene.frame, 1, 3] = 100 + world_xy.real, 200 + world_xy.imag
    sigma = np.full((scene.frames, 3), 0.1)
    placed_scene = scene.with_(world_from_rig=there, position_sigma_m=sigma, prior="exif")
    plan, found = plan_from_world(poses, placed_scene)
    assert found == pytest.approx(scale, rel=1e-3)
    xyz = transforms.apply(plan, transforms.centre(poses))
    assert xyz[:, 0] == pytest.approx(there[scene.frame, 0, 3], abs=0.05)
    shown = path_and_ties(placed_scene, ties, xyz, np.ones(IMAGES, bool), least=12, most=4)
    assert len(shown["frames"]) == IMAGES and len(shown["ties"]) == 4 and shown["untied"] == []
    none = path_and_ties(placed_scene, PreviewMatches.empty(), xyz, np.ones(IMAGES, bool), least=12, most=4)
    assert none["untied"] == list(scene.names)


@pytest.fixture
def server():
    served = PageServer(WatchHandler, {})
    served.start()
    yield served
    served.close()


def test_the_page_and_its_state_are_served_on_the_loopback(server):
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", server.url)
    assert urllib.request.urlopen(server.url).read() == page(None)
    server.about = {"counts": {"images": 3}}
    assert json.load(urllib.request.urlopen(server.url + "state.json")) == {"counts": {"images": 3}}
    bare = f"http://{server.hosts[0]}/"
    for url, host, said in (
        (f"{server.url}log.txt", None, "404"), (f"{server.url}../watch.npz", None, "404"),
        (server.url, "elsewhere.example", "403"), (bare, None, "403"), (f"{bare}state.json", None, "403"),
    ):  # fmt: skip
        request = urllib.request.Request(url, headers={} if host is None else {"Host": host})
        with pytest.raises(urllib.error.HTTPError, match=said):
            urllib.request.urlopen(request)


def test_a_port_that_is_taken_is_said(server):
    port = server.server_port
    with refused(rf"--port {port}.*another, or 0"):
        PageServer(WatchHandler, {}, port)
    with refused("--port 99999999"):
        PageServer(WatchHandler, {}, 99999999)


def test_a_page_that_is_kept_holds_its_state_and_nothing_from_elsewhere():
    text = page({"folder": "</script><b>", "counts": {}}).decode()
    assert '"folder": "\\u003c/script>' in text
    assert "https:" not in text and "http:" not in text and "src=" not in text and "@import" not in text


FRAMES = 9
AT_ONCE = ArrivalsTuning(settled_s=0)
NO_MODEL = Tuning(arrivals=AT_ONCE, model=ModelTuning(first=10_000))


@pytest.fixture
def site(tmp_path):
    """A card, a run folder beside it, and a rig.toml."""
    (tmp_path / "card").mkdir()
    write_rig_toml(rig_of(stereo()), tmp_path / "rig.toml")
    return tmp_path


def copy(site, frames, cameras=("left", "right")):
    for frame in frames:
        for camera, image in images(stereo(), frame).items():
            if stereo().names[camera] in cameras:
                path = site / "card" / stereo().names[camera] / f"{frame:06d}.png"
                path.parent.mkdir(exist_ok=True)
                cv2.imwrite(str(path), image)


def watched(site, tuning=NO_MODEL, rig="rig.toml"):
    project = open_project(site / "card", site / "out", rig=site / rig)
    return Watched(Run(project.folder, project.inputs, project.settings, "serial", Reporter("quiet")), tuning)


def settle(watch, now):
    """Looks until nothing is new."""
    for k in range(4):
        watch.step(now + k)
    return watch.state()


@pytest.mark.slow
def test_images_get_ties_poses_and_a_surface_and_a_second_run_goes_on(site):
    tuning = Tuning(arrivals=AT_ONCE, model=ModelTuning(first=10, idle_s=0, more=0.2))
    watch = watched(site, tuning)
    copy(site, range(6))
    settle(watch, time.monotonic())
    modelled = _until(watch, lambda: watch.state()["surface"]["cells"])
    assert modelled["counts"] == {"images": 12, "tied": 12, "posed": 12, "broken": 0, "waiting": 0}
    assert modelled["metric"] and modelled["surface"]["of"] == 12
    copy(site, range(6, FRAMES))
    now = time.monotonic()
    watch.step(now)
    state = (watch.step(now + 1), watch.state())[1]
    assert state["counts"]["posed"] > 12, "new frames have poses before there is a model of them"
    by_ties = [f for f in state["frames"] if not f[2]]
    assert by_ties and all(f[4] > "left/000005.png" for f in by_ties)
    here = np.stack([transforms.centre(watch.poses[f"left/{k:06d}.png"]) for k in range(6)])
    there = np.stack([truth(k)[:3, 3] for k in range(6)])
    fit = umeyama(here, there)
    assert 1e-6 < np.abs(fit(here) - there).max() < 0.05
    new = np.stack([transforms.centre(watch.poses[f[4]]) for f in by_ties])
    true = np.stack([truth(int(f[4][-10:-4]))[:3, 3] for f in by_ties])
    assert 1e-6 < np.linalg.norm(fit(new) - true, axis=1).max() < 0.15
    watch.keep()
    assert "left/000008.png" in (site / "out" / PAGE).read_text()
    again = watched(site)
    made = [p.stat().st_mtime_ns for p in sorted((site / "out" / "preview").rglob("*.npz"))]
    for k in range(6):
        again.step(time.monotonic() + k)
    assert again.state()["counts"]["tied"] == 2 * FRAMES
    assert made == [p.stat().st_mtime_ns for p in sorted((site / "out" / "preview").rglob("*.npz"))]
    assert len(again._ties) == len(watch._ties)
    assert sorted(p.name for p in site.iterdir()) == ["card", "out", "rig.toml"]


def _until(watch, there, limit_s=300.0):
    until = time.monotonic() + limit_s
    while time.monotonic() < until:
        if watch.step(time.monotonic()) and there():
            return watch.state()
        time.sleep(0.05)
    raise AssertionError("no model came")


@pytest.mark.slow
def test_broken_images_and_doubles_are_named_and_stop_nothing(site):
    watch = watched(site)
    copy(site, range(2))
    whole = (site / "card" / "left" / "000001.png").read_bytes()
    (site / "card" / "left" / "000002.png").write_bytes(whole[: len(whole) // 2])
    shutil.copy(site / "card" / "left" / "000001.png", site / "card" / "left" / "000003.png")
    state = settle(watch, 0.0)
    assert [name for name, _ in state["broken"]] == ["left/000002.png", "left/000003.png"]
    assert "the same photograph as left/000001.png" in state["broken"][1][1]
    assert state["counts"]["images"] == 4 and state["trouble"] == ""
    copy(site, [2], ["left"])  # the rest of it has come
    os.utime(site / "card" / "left" / "000002.png", (1, 1))
    state = settle(watch, 10.0)
    assert [name for name, _ in state["broken"]] == ["left/000003.png"] and state["counts"]["images"] == 5
    copy(site, [7], ["left"])  # as macOS writes names
    (site / "card" / "left" / "000007.png").rename(site / "card" / "left" / "Bru\u0308cke_000007.png")
    assert settle(watch, 20.0)["counts"]["images"] == 6


@pytest.mark.slow
def test_a_card_that_is_pulled_out_leaves_what_is_known(site):
    watch = watched(site)
    copy(site, range(2))
    before = settle(watch, 0.0)
    shutil.move(site / "card", site / "away")
    assert watch.step(10.0)
    state = watch.state()
    assert "is gone" in state["trouble"] and state["now"] == state["trouble"]
    assert state["counts"] == before["counts"]
    shutil.move(site / "away", site / "card")
    copy(site, [2])
    assert settle(watch, 20.0)["counts"]["images"] == 6 and watch.state()["trouble"] == ""


@pytest.mark.slow
def test_a_rig_that_does_not_fit_is_said_until_it_does(site):
    watch = watched(site)
    for name in ("wide", "tele"):
        (site / "card" / name).mkdir()
        for frame in range(2):
            cv2.imwrite(str(site / "card" / name / f"{frame:06d}.png"), images(stereo(), frame)[0] // 2)
    state = settle(watch, 0.0)
    assert "rig.toml" in state["trouble"] and state["counts"]["images"] == 0
    assert watch.scene is None


@pytest.mark.slow
def test_wrong_inputs_are_refused_before_anything_is_written(site, capsys):
    (site / "bad.toml").write_text("[[rig]]\nnme = 3\n")
    for arguments, said in (
        ([site / "none"], "no such folder"),
        ([site / "card", "--rig", site / "bad.toml"], "bad.toml"),
        ([site / "card", "-o", site / "card" / "out"], "lies in"),
        ([site / "card", "--gnss", site / "no.csv"], "no.csv"),
    ):
        assert main(["watch", *map(str, arguments)]) == 2
        assert said in capsys.readouterr().err
    assert sorted(p.name for p in site.iterdir()) == ["bad.toml", "card", "rig.toml"]


@pytest.mark.slow
def test_interrupting_ends_with_what_is_known(site, capsys, monkeypatch):
    copy(site, range(2))
    step = Watched.step

    def stepped(self, now):
        if len(self.scene or ()) == 4:
            raise KeyboardInterrupt
        return step(self, now)

    monkeypatch.setattr(Watched, "step", stepped)
    assert main(["watch", str(site / "card"), "--rig", str(site / "rig.toml"), "--port", "0", "--json"]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [e["event"] for e in events] == ["watching", *["image"] * 4]
    assert all(0 < e["seconds"] < 60 for e in events[1:])
    assert (site / "card_watch" / KEPT).exists() and (site / "card_watch" / PAGE).exists()
    assert not list((site / "card_watch" / "images").rglob("*.png"))
