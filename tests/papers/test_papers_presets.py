"""The presets of the papers by the receipts of runs; paper 002: weak pairs, cuts and the accuracy of a pair."""

import json
import re
from dataclasses import replace
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
from benchmarks.papers.measure import RESULTS
from benchmarks.papers.ours import LEVELLED, STEPS, ours

from boat_world import boat, photos, ring
from network_steps import context_of
from tiegraph import papers
from tiegraph.design.design import METHODS, design
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import up_vector
from tiegraph.masks.sources import SOURCES
from tiegraph.network.passes import find_passes
from tiegraph.network.rigcheck import check_rigs
from tiegraph.network.sections import UpLight, find_sections
from tiegraph.papers.fuse2014 import capacities, image_order, two_view
from tiegraph.papers.meguro2025 import bright_share, brightness_counts, light
from tiegraph.project.settings import Settings, merged, preset
from tiegraph.scene.graph import components
from tiegraph.scene.pairs import Pairs

DEFAULT = Settings()
# setting: of a paper, of the default
SWITCHES = {
    "coarse.method": ("off", "mapper"),
    "design.method": ("all", "hybrid"),
    "sparse.rig": ("absent", "auto"),
    "sparse.mapper": ("incremental", "auto"),
    "sparse.use_positions": (False, True),
    "sparse.covariance_frames": (0, 3000),
    "georef.adjust": ("no", "auto"),
    "georef.antenna": ("ignored", "auto"),
    "refine.geometry": ("off", "auto"),
    "tuning.network.rig.frames": (0, 16),
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


@pytest.mark.slow
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


PAGES = Path(__file__).parents[2] / "docs" / "papers"


@pytest.mark.parametrize("paper", ["000", "001", "002", "003", "004"])
def test_what_a_page_names_exists(paper: str) -> None:
    names = re.findall(r"`([a-z_0-9.]+):([A-Za-z_0-9]+)`", (PAGES / f"{paper}.md").read_text())
    assert len(names) >= 10
    lost = [f"{module}:{name}" for module, name in names if not hasattr(import_module(f"tiegraph.{module}"), name)]
    assert not lost


ROWS = [r for r in json.loads(RESULTS.read_text())["runs"] if "ours" in r]
RUNS = {"columns": ["mapper"], "rows": [["incremental", "absent", "none", "", 1]]}


def receipts(**changed: dict) -> dict:
    """Those of a paper's recipe, with other values of some."""
    plain = {
        "candidates": {"notes": ["up runs back along down"]},
        "coarse": {"settings": {"method": "off"}},
        "design": {"settings": {"method": "all"}},
        "sparse": {"counts": {}, "tables": {"runs": RUNS, "models": {}}, "notes": []},
        "georef": {"settings": {"antenna": "ignored", "adjust": "no"}, "notes": [], "tables": {}},
    }
    return {stage: {**said, **changed.get(stage, {})} for stage, said in plain.items()}


@pytest.mark.parametrize(
    "step, changed",
    [
        ("rig check", {"candidates": {"notes": ["rig boat: the images agree with its sense of rotation"]}}),
        ("coarse model", {"coarse": {"settings": {"method": "mapper"}}}),
        ("choice of pairs", {"design": {"settings": {"method": "hybrid"}}}),
        ("final adjustment", {"sparse": {"notes": ["final robust adjustment: 0.3 -> 0.2 px"]}}),
        ("checks of frames, rig and lenses", {"sparse": {"tables": {"runs": RUNS, "rig diagnostics": {}}}}),
        ("sigmas of the model", {"sparse": {"counts": {"position_sigma_median": 0.1}}}),
        ("lever arm", {"georef": {"settings": {"antenna": "auto", "adjust": "no"}}}),
        ("adjustment with positions", {"georef": {"settings": {"antenna": "ignored", "adjust": "auto"}}}),
        (LEVELLED, {"georef": {"notes": ["levelled by the upward direction of the ring"]}}),
        ("models joined by matches",
         {"georef": {"tables": {"models in one world": {"rows": [["sparse/1", 35, "matches"]]}}}}),
        ("rig, positions or a second try of the mapper",
         {"sparse": {"tables": {"runs": {"rows": [["global", "absent", "none", "", 1]]}}}}),
    ],
)  # fmt: skip
def test_each_step_of_ours_shows_in_the_receipts(step: str, changed: dict) -> None:
    assert ours(receipts()) == [] and step in STEPS
    filled = receipts(**changed)
    for stage, said in receipts().items():
        filled[stage] = {**said, **filled[stage]}
    assert ours(filled) == [step]


@pytest.mark.parametrize("method", ["conventional", "meguro2024", "meguro2025"])
def test_nothing_of_ours_acted_in_a_recipe(method: str) -> None:
    rows = [r for r in ROWS if r["method"] == method]
    assert rows and all(r["status"] == "done" for r in rows), "python -m benchmarks.papers 000 001 --run"
    allowed = {LEVELLED} if method == "meguro2025" else set()
    assert all(set(r["ours"]) <= allowed for r in rows)


TUNING = Tuning()
for name in papers.DESIGNS:
    papers.plug_in(papers.DESIGNS, name, METHODS)


def video(count: int = 60, window: int = 6, seed: int = 0, **columns) -> Pairs:
    """Frames of a camera tied to the next ones, fewer matches over longer bases."""
    i = np.repeat(np.arange(count), window)
    j = i + np.tile(np.arange(1, window + 1), count)
    inside = j < count
    rng = np.random.default_rng(seed)
    score = 200.0 - 25 * (j - i) + rng.integers(0, 20, len(i))
    columns = {k: v[inside] for k, v in columns.items()}
    return Pairs.make(i[inside], j[inside], "sequence", score=score[inside], **columns)


def reasons(pairs: Pairs) -> dict[str, int]:
    return pairs.funnel()


def test_weak_pairs_go_first() -> None:
    pairs = video()
    pairs = pairs.with_(score=np.where(np.arange(len(pairs)) % 10 == 3, 24.0, pairs.score))
    pairs = pairs.with_(score=np.where(np.arange(len(pairs)) % 10 == 4, 25.0, pairs.score))  # "less than 25"
    weak = int(np.sum((pairs.score < 25) & (np.arange(len(pairs)) % 10 != 3)))
    found = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING)
    assert reasons(found.pairs)["weak"] == weak + np.sum(np.arange(len(pairs)) % 10 == 3) == found.counts["weak"]


def test_the_cuts_sever_the_video() -> None:
    pairs = video()
    found = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING)
    assert found.counts["pieces_before"] == 1
    assert 2 <= found.counts["pieces"] <= 7  # a part that was severed may hang together through its neighbours
    assert f"{int(found.counts['pieces'])} after" in found.notes[0]
    assert 6 <= found.counts["cut"] <= 6 * 21  # a complete severing of a window of six crosses 21 pairs


def test_each_of_five_parts_is_cut_from_its_first_to_its_last_image() -> None:
    pairs = video()
    kept = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING).pairs.kept()
    for part in np.array_split(np.arange(60), 5):
        inside = kept.where(np.isin(kept.i, part) & np.isin(kept.j, part))
        label = components(inside, 60)
        assert label[part[0]] != label[part[-1]] and len(inside) > 0


def test_the_safe_variant_keeps_it_together() -> None:
    pairs = video()
    found = design(pairs, photos(60), None, DesignSettings(method="fuse2014_safe"), TUNING)
    literal = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING)
    assert found.counts["pieces"] == 1
    assert len(np.unique(components(found.pairs, 60))) == 1
    back = len(found.pairs.kept()) - len(literal.pairs.kept())
    assert 1 <= back <= literal.counts["pieces"]


def test_a_cut_takes_the_pairs_of_least_capacity() -> None:
    # two triangles on two weak pairs; the cuts of the parts (one or two images each) take what is between them
    i, j = np.array([0, 0, 1, 3, 3, 4, 2, 1]), np.array([1, 2, 2, 4, 5, 5, 3, 4])
    sigma = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 1.0, 1.0])
    pairs = Pairs.make(i, j, "file", score=np.full(8, 100.0), sigma_m=sigma)
    found = design(pairs, photos(6), None, DesignSettings(method="fuse2014"), TUNING).pairs
    dropped = {(int(a), int(b)) for a, b in zip(found.i[found.dropped != 0], found.j[found.dropped != 0])}
    assert {(2, 3), (1, 4)} <= dropped
    assert {(0, 2), (1, 2), (3, 4), (3, 5)} & dropped == set()


def test_a_way_that_turns_back_is_cut_too() -> None:
    pairs = Pairs.make([0, 1, 1], [2, 2, 3], "file", score=np.full(3, 100.0), sigma_m=np.array([0.1, 1.0, 0.1]))
    found = design(pairs, photos(4), None, DesignSettings(method="fuse2014"), TUNING).pairs
    assert [(int(a), int(b)) for a, b in zip(found.i[found.dropped != 0], found.j[found.dropped != 0])] == [(1, 2)]


def test_images_are_in_order_of_pass_step_and_camera() -> None:
    scene = boat((3, 3), (2.0, 2.0)).scene
    order = image_order(scene)
    frame = scene.frame[order]
    found = list(zip(scene.sequence[frame], scene.sequence_index[frame], scene.sensor_key[order]))
    assert found == sorted(found) and len({step for _, step, _ in found}) == 3 < len(scene)


def test_similar_images_lose_all_their_pairs() -> None:
    pairs = video(20, 3)
    ratio = np.full(len(pairs), 30.0)
    ratio[(pairs.i == 7) & (pairs.j == 8)] = 501.0
    ratio[(pairs.i == 14) & (pairs.j == 15)] = 500.0  # "more than 500"
    found = design(pairs.with_(h_over_b=ratio), photos(20), None, DesignSettings(method="fuse2014"), TUNING)
    touches = (pairs.i == 8) | (pairs.j == 8)
    assert found.counts["similar"] == np.sum(touches)
    assert np.all(found.pairs.dropped[touches] != 0)
    safe = design(pairs.with_(h_over_b=ratio), photos(20), None, DesignSettings(method="fuse2014_safe"), TUNING)
    assert np.sum(safe.pairs.dropped[touches] == 0) >= 1


def test_capacity_is_the_known_accuracy_else_matches_and_base() -> None:
    pairs = Pairs.make([0, 0, 1], [1, 2, 2], "file", sigma_m=np.array([0.1, 0.2, np.nan]))
    value = capacities(pairs, np.array([100.0, 100.0, 50.0]))
    assert np.allclose(value[:2], [100.0, 25.0])
    assert 10 < value[2] < 60
    by_base = capacities(pairs.with_(sigma_m=np.full(3, np.nan), h_over_b=np.array([10.0, 20, 10])), np.full(3, 80.0))
    assert np.allclose(by_base / by_base[0], [1, 0.25, 1])


CAMERA = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])


def matches(base: float, noise_px: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of 80 points 8 to 12 away, seen from two places ``base`` apart across the view."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-4, -3, 8), (4, 3, 12), (80, 3))
    second = transforms.rigid(np.eye(3), np.array([-base, 0, 0]))
    moved = xyz @ second[:3, :3].T + second[:3, 3]
    return tuple(np.asarray(CAMERA.img_from_cam(x)) + rng.normal(0, noise_px, (80, 2)) for x in (xyz, moved))  # type: ignore[return-value]


def test_good_matches_hardly_move_and_the_range_is_in_bases() -> None:
    found = two_view(*matches(2.0, 0.0), CAMERA, CAMERA, 2.5)
    assert found is not None
    assert found[0] < 1e-3 and 4.5 < found[1] < 6.0  # about 10.5 / 2


@pytest.mark.slow
def test_noise_and_short_bases_move_more() -> None:
    def moved(base: float, noise: float) -> float:
        found = [two_view(*matches(base, noise, s), CAMERA, CAMERA, 2.5) for s in range(7)]
        return float(np.median([f[0] for f in found if f is not None]))

    good, noisy, short = moved(2.0, 0.3), moved(2.0, 1.5), moved(0.3, 0.3)
    assert 1e-5 < good < noisy < 1.5 and good < short


def test_too_few_matches_give_nothing() -> None:
    a, b = matches(1.0, 0.2)
    assert two_view(a[:7], b[:7], CAMERA, CAMERA, 2.5) is None
