"""The presets of the papers: what a paper did not have is off in them, and on by default."""

import json
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from boat_world import boat, ring
from network_steps import context_of
from tiegraph import papers
from tiegraph.geometry.gravity import up_vector
from tiegraph.masks.sources import SOURCES
from tiegraph.network.passes import find_passes
from tiegraph.network.rigcheck import check_rigs
from tiegraph.network.sections import UpLight, find_sections
from tiegraph.papers.meguro2025 import bright_share, brightness_counts, light
from tiegraph.project.settings import Settings, merged, preset

DEFAULT = Settings()
# setting: of a paper, of the default
SWITCHES = {
    "coarse.method": ("off", "mapper"),
    "design.method": ("all", "hybrid"),
    "filter.method": ("off", "auto"),
    "sparse.rig": ("absent", "auto"),
    "sparse.mapper": ("incremental", "auto"),
    "sparse.use_positions": (False, True),
    "sparse.covariance_frames": (0, 3000),
    "georef.adjust": ("no", "auto"),
    "georef.antenna": ("ignored", "auto"),
    "refine.geometry": ("off", "auto"),
    "tuning.network.rig.check.frames": (0, 16),
    "tuning.sfm.adjust.iterations": (0, 30),
    "tuning.sfm.placement.ties.trials": (0, 2000),
    "tuning.sfm.world.fixes.rows_per_frame": (0, 5),
    "tuning.sfm.mapping.min_model_images": (10, 3),
}


def value(settings: Settings, name: str) -> Any:
    return reduce(getattr, name.split("."), settings)


@pytest.mark.parametrize("name", papers.PRESETS)
@pytest.mark.parametrize("switch", SWITCHES)
def test_what_a_paper_did_not_have_is_off(name: str, switch: str) -> None:
    paper, default = SWITCHES[switch]
    assert value(merged(preset(name)), switch) == paper != default
    if not isinstance(default, int) or isinstance(default, bool):
        assert value(DEFAULT, switch) == default
    else:
        assert value(DEFAULT, switch) > 0


@pytest.mark.parametrize("name", ["default", *papers.PRESETS])
def test_cameras_tell_what_is_up_where_the_paper_has_optical_axes(name: str) -> None:
    """Paper 001 corrects poses by "the fixed baseline and optical axis"; the others have no such step."""
    settings = merged(preset(name))
    upright, poses = settings.tuning.sfm.world.up, np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, :3] = [[[c, 0, s], [0, 1, 0], [-s, 0, c]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    assert (up_vector(poses, np.zeros(4, int), upright) is not None) == (name in ("default", "meguro2025"))
    assert settings.scan.max_gap_s == (60.0 if name == "meguro2025" else 3.0)


@pytest.mark.parametrize(
    "name, masks, sections, offsets",
    [("conventional", "none", "off", None), ("meguro2024",) * 2 + ("off", 1), ("meguro2025",) * 3 + (0,)],
)
def test_each_paper_has_its_own_masks_sections_and_offsets(name, masks, sections, offsets) -> None:
    settings = merged(preset(name))
    assert (settings.masks.source, settings.network.sections) == (masks, sections)
    assert "auto" in DEFAULT.candidates.sources and "auto" not in settings.candidates.sources
    if offsets is None:
        assert settings.candidates.sources == ("exhaustive",)
    else:
        assert settings.candidates.offsets == "constant" and settings.candidates.offset_best == offsets


@pytest.mark.parametrize("name", ["default", "meguro2024", "meguro2025"])
def test_the_rig_is_checked_by_default_and_believed_by_the_papers(name: str) -> None:
    world, mirror = boat((10, 10), (2.0, 2.0)), np.diag([-1.0, 1, 1, 1])
    sensors = tuple(replace(s, sensor_from_rig=mirror @ s.sensor_from_rig @ mirror) for s in ring().sensors)
    scene = world.scene.with_(rigs=(replace(ring(), sensors=sensors),))
    settings = merged(preset(name))
    checked, _ = check_rigs(context_of(scene, world.match, settings.candidates, settings.tuning.network))
    assert (checked.rigs[0] is scene.rigs[0]) == (name != "default")


def test_a_recipe_is_plugged_in_by_its_name_only() -> None:
    point: dict[str, Any] = {}
    papers.plug_in(papers.MASKS, "learnt", point)
    assert not point and "learnt" in SOURCES
    papers.plug_in(papers.MASKS, "meguro2024", point)
    assert set(point) == {"meguro2024"}


def test_a_blue_sky_as_grey_as_a_deck_is_bright(tmp_path: Path) -> None:
    """Grey values of both are equal; that of the deck moves with the exposure."""
    sky, deck = np.uint8([200, 105, 70]), np.uint8([100, 101, 101])
    images = []
    for k, share in enumerate((0.9, 0.8, 0.3, 0.1, 0.0, 0.9)):
        image = np.full((60, 80, 3), deck, np.uint8)
        image[: round(60 * share)] = sky
        images.append(tmp_path / f"{k}.png")
        cv2.imwrite(str(images[-1]), image)
    grey = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE).mean() for p in images]
    assert np.ptp(grey) < 5
    found = bright_share(np.array([brightness_counts(p) for p in images]))
    assert np.allclose(found, [0.9, 0.8, 0.3, 0.1, 0.0, 0.9], atol=0.01)


def test_light_is_that_of_up_cameras_alone(tmp_path: Path) -> None:
    scene = boat((3,), (2.0,)).scene
    up = np.array([scene.sensor_of(k).role == "up" for k in range(len(scene))])
    for k in np.flatnonzero(up):
        path = tmp_path / scene.names[k]
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((40, 40, 3), 40 * (k % 5) + 20, np.uint8))
    found = light(scene, tmp_path, lambda function, items: [function(p) for p in items])
    assert found.sky_share is not None
    assert np.isfinite(found.sky_share[up]).all() and np.isnan(found.sky_share[~up]).all()
    assert np.isnan(found.brightness).all() and found.measure != UpLight(found.brightness).measure


def test_the_bridge_of_canal_demo_is_found(data_root: Path) -> None:
    """Every frame as the truth has it, by the brightness of pixels; by the mean grey value of images none."""
    folder = data_root / "canal_demo"
    scene = boat((10, 10), (2.0, 2.0)).scene
    tuning, passes = DEFAULT.tuning.network.sections, find_passes(scene)
    share, grey, under = (np.full(len(scene), np.nan) for _ in range(3))
    frames = json.loads((folder / "gt" / "meta.json").read_text())["frames"]
    files = [folder / "images" / f["name"] / "cam5" / f"{f['frame']}.jpg" for f in frames]
    bright = bright_share(np.array([brightness_counts(p) for p in files]))
    for p, name in zip(passes, ("up", "down")):
        own = np.array([k for k, f in enumerate(frames) if f["name"] == name])
        up = [k for k in range(len(scene)) if scene.sensor_of(k).role == "up" and scene.frame[k] in p.frames]
        share[up] = bright[own]
        grey[up] = [cv2.imread(str(files[k]), cv2.IMREAD_GRAYSCALE).mean() for k in own]
        under[up] = [bool(frames[k]["under"]) for k in own]
    by_frame = np.array([np.nanmax(under[scene.frame == f]) for f in range(scene.frames)])
    found = find_sections(scene, passes, UpLight(np.full(len(scene), np.nan), share), tuning)
    kinds = np.array([s.kind for s in found.sections])
    assert np.array_equal(kinds[found.of_frame] == "bridge", by_frame == 1)
    assert len(find_sections(scene, passes, UpLight(grey), tuning).sections) == 1
