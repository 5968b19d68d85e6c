"""`tiegraph watch` on rendered images that are copied one by one: ties, poses, surface, and what goes wrong."""

import json
import os
import shutil
import time

import cv2
import numpy as np
import pytest

from odometry.odometry_world import images, rig_of, stereo, truth
from tiegraph.api import open_project
from tiegraph.cli.main import main
from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.pipeline.watch import KEPT, PAGE, Watched
from tiegraph.project.progress import Reporter
from tiegraph.project.run import Run
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.watch.tuning import ArrivalsTuning, ModelTuning, Tuning

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


def test_a_rig_that_does_not_fit_is_said_until_it_does(site):
    watch = watched(site)
    for name in ("wide", "tele"):
        (site / "card" / name).mkdir()
        for frame in range(2):
            cv2.imwrite(str(site / "card" / name / f"{frame:06d}.png"), images(stereo(), frame)[0] // 2)
    state = settle(watch, 0.0)
    assert "rig.toml" in state["trouble"] and state["counts"]["images"] == 0
    assert watch.scene is None


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
