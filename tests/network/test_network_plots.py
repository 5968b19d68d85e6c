"""What a network is written as: bases and sigmas of pairs, pictures of a readable size."""

import csv
import io
import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pycolmap
import pytest
from matplotlib.figure import Figure
from PIL import Image

from boat_world import World, boat, photos, ring
from network_steps import Steps, network_of
from tiegraph.network.map import _aggregated, _joined, _layout
from tiegraph.network.network import metres_per_unit, with_bases
from tiegraph.network.passes import find_passes
from tiegraph.network.plots import _matrix, map_png, matrix_png, sections_png, weak_pairs
from tiegraph.network.sections import UpLight, find_sections
from tiegraph.network.tuning import Tuning
from tiegraph.pipeline import network as glue
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.figures import png
from tiegraph.scene.matches import PreviewMatches, Visibility
from tiegraph.scene.pairs import REASON_LOOKS, REASONS, Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

RED, ORANGE = (192, 57, 43), (213, 94, 0)
TUNING = Tuning()


def opened(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def share_of(data: bytes, colour: tuple, reach: int = 8) -> float:
    return float((np.abs(opened(data).astype(int) - np.array(colour)).max(axis=-1) < reach).mean())


@lru_cache(maxsize=1)
def surveyed() -> tuple[World, Steps]:
    world = boat((8, 8), (3.0, 3.0), ring(4))
    brightness = np.where(np.isin(world.step, (3, 4, 5)), 60.0, 150.0)
    return world, network_of(world.scene, world.match, light=brightness)


def positions(world: World) -> np.ndarray:
    out = np.full((world.scene.frames, 3), np.nan)
    out[world.scene.frame] = world.world_from_sensor[:, :3, 3]
    return out


@pytest.mark.slow
def test_pictures_of_a_survey() -> None:
    _, network = surveyed()
    pictures = dict(network.pictures())
    assert {"matrix", "offsets", "sections"} <= set(pictures)
    for data in pictures.values():
        image = opened(data)
        assert 300 < image.shape[0] < 4000 and 800 < image.shape[1] < 2000
    blue = tuple(int(REASON_LOOKS["kept"][1][k : k + 2], 16) for k in (1, 3, 5))
    assert 0.02 < share_of(pictures["matrix"], blue) < 0.4


def test_kept_pairs_win_where_cells_are_shared() -> None:
    dropped = np.array([REASONS.index("section"), 0, REASONS.index("section")])
    pairs = Pairs.make([0, 1, 2], [2401, 2402, 2403], "offsets", dropped=dropped)
    cells, step = _matrix(pairs, np.arange(2404), 2404)
    assert step == 3 and cells.shape == (802, 802) and cells[0, 800] == 1 and cells[800, 0] == 1
    assert np.count_nonzero(cells) in (2, 4)


def test_maps_without_positions_say_so_and_loose_photographs_have_a_matrix() -> None:
    pairs = Pairs.make([0, 1, 2, 3], [1, 2, 3, 4], "exhaustive")
    assert opened(matrix_png(pairs, photos(5))).size
    assert share_of(map_png(pairs, None, photos(7)), RED) > 1e-4  # it says that there are no positions
    world, _ = surveyed()
    assert share_of(map_png(Pairs.empty(), None, world.scene), RED) > 1e-4


def test_photographs_stand_by_the_strength_of_their_ties_and_each_time_alike() -> None:
    scene = photos(8)
    i, j = np.triu_indices(8, 1)
    alike = Pairs.make(i, j, "exhaustive")  # the layout is open then
    first, second = (_layout(alike, None, scene)[0] for _ in range(2))
    assert np.isfinite(first).all() and np.array_equal(first, second)
    facade = Pairs.make(i, j, "exhaustive", score=400.0 / 4.0 ** (j - i))
    along = _layout(facade, None, scene)[0][:, 0]
    assert (np.diff(along) > 0).all() or (np.diff(along) < 0).all()


@pytest.mark.slow
def test_the_map_shows_kinds_and_weak_links() -> None:
    world, network = surveyed()
    plain = map_png(network.pairs, positions(world), network.scene)
    kept = network.pairs.kept()
    ends = [int(np.flatnonzero((world.scene.frame == f) & (world.scene.sensor == 0))[0]) for f in (0, 7)]
    weak = map_png(network.pairs, positions(world), network.scene, weak=[(ends[0], ends[1])])
    assert share_of(plain, ORANGE, 60) > 0.001
    assert share_of(weak, RED, 40) > share_of(plain, RED, 40) + 2e-4
    side = {kind: _aggregated(kept, network.scene, _joined(positions(world)[:, :2], network.scene), kind).pairs
            for kind in ("same camera", "across cameras", "across passes")}  # fmt: skip
    inside = int(np.sum(network.scene.frame[kept.i] == network.scene.frame[kept.j]))
    assert sum(side.values()) + inside == len(kept) and min(side.values()) > 0


def test_frames_without_a_position_lie_between_their_neighbours() -> None:
    world, _ = surveyed()
    at = positions(world)
    at[[0, 3]] = np.nan
    place, said = _layout(Pairs.empty(), at, world.scene)
    assert said == "" and np.isnan(place[0]).all()
    assert np.allclose(place[3], positions(world)[3, :2], atol=0.01)


def test_many_frames_become_runs() -> None:
    scene = boat((1200, 900), (0.5, 0.7)).scene
    rank = np.stack([scene.sequence_index, scene.sequence], axis=1).astype(float)
    nodes = _joined(rank, scene)
    assert nodes.frames == 7 and 295 <= len(nodes.place) <= 302
    first = int(np.flatnonzero((scene.sequence_index == 0) & (scene.sequence == 0))[0])
    assert np.allclose(nodes.place[nodes.of_frame[first]], [3.0, 0.0])


def test_weak_links_are_read_from_the_table() -> None:
    names = surveyed()[0].scene.names
    rows = [["single link", f"{names[3]} - {names[40]}", 2, 1], ["joint", names[2], 1, 1], ["camera", "cam0", 4, 0]]
    assert weak_pairs({"columns": [], "rows": rows}, surveyed()[0].scene).tolist() == [[3, 40]]
    assert weak_pairs({}, surveyed()[0].scene).shape == (0, 2)


def test_sections_show_every_cue() -> None:
    world, network = surveyed()
    under = np.isin(world.step, (3, 4, 5))
    light = UpLight(np.where(under, 60.0, 150.0), np.where(under, 0.1, 0.8))
    found = find_sections(world.scene, find_passes(world.scene), light, TUNING.sections)
    image = opened(sections_png(world.scene.with_(section=found.of_frame), found.sections, found.cues))
    one = opened(sections_png(world.scene.with_(section=found.of_frame), found.sections, found.cues[:1]))
    assert image.shape[0] > one.shape[0] + 150


def test_names_are_no_formulas() -> None:
    figure = Figure(figsize=(2, 2), layout="constrained")
    axes = figure.add_subplot(title="$\\frac{$", ylabel="x^$_$^{{")
    axes.set_xticks([0, 1], ["$\\frac{$", "戻り"])
    axes.plot([0, 1], label="$\\frac{$")
    axes.legend(title="$\\frac{$")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert png(figure)[1:4] == b"PNG"


FOCAL_PX, UNIT_M = 500.0, 4.0  # a unit of the model is 4 m
CAMERA = pycolmap.Camera.create_from_model_name(0, "SIMPLE_PINHOLE", FOCAL_PX, 640, 480)


def wall(sigma_m: float = 0.02) -> tuple[Scene, Visibility]:
    """Four images along x, 2 units apart, that look at a wall 10 units away; first and last share no point."""
    centre = np.stack([2.0 * np.arange(4), np.zeros(4), np.zeros(4)], axis=1)
    wall = np.stack([np.linspace(-3, 9, 121), np.zeros(121), np.full(121, 10.0)], axis=1)
    seen = [np.flatnonzero(np.abs(wall[:, 0] - x) < 2.5) for x in centre[:, 0]]
    start = np.r_[0, np.cumsum([len(s) for s in seen])]
    poses = np.tile(np.eye(4), (4, 1, 1))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    poses[:, :3, 3] = UNIT_M * centre @ turn.T + [5, 6, 7]
    poses[3] = np.nan  # under the bridge
    rig = Rig("camera", (Sensor("camera", camera=CAMERA),))
    scene = simple_scene(
        rig, [f"{k}.jpg" for k in range(4)], np.arange(4), np.zeros(4), world_from_rig=poses, prior="gnss",
        position_sigma_m=np.where(np.isfinite(poses[:, :3, 3]), sigma_m, np.nan),
    )  # fmt: skip
    return scene, Visibility(start, np.concatenate(seen), wall, centre)


def test_base_distance_over_base_and_sigma_of_pairs():
    scene, visibility = wall()
    pairs = Pairs.make([0, 0, 0, 2], [1, 2, 3, 3], "sequence", score=np.array([100.0, 25, 25, np.nan]))
    found = with_bases(pairs, scene, visibility)
    assert metres_per_unit(scene.measured(), visibility.centre) == pytest.approx(UNIT_M)
    assert found.baseline_m == pytest.approx([8, 16, 24, 8], rel=1e-5), "the fourth image has no position"
    assert found.h_over_b[[0, 1, 3]] == pytest.approx([10.1 / 2, 10.1 / 4, 10.1 / 2], rel=0.02)
    assert np.isnan(found.h_over_b[2]) and np.isnan(found.sigma_m[2:]).all(), "no common point, no matches"
    assert found.sigma_m[:2] == pytest.approx([40.4 / FOCAL_PX / 10, 40.4 / FOCAL_PX / 5], rel=0.02)
    known = with_bases(pairs.with_(baseline_m=np.full(4, 9.0)), scene, visibility)
    assert np.all(known.baseline_m == 9.0), "known by poses"


def test_without_positions_that_tell_the_scale_only_the_ratio_is_known():
    pairs = Pairs.make([0], [1], "sequence", score=np.array([100.0]))
    scene, visibility = wall(sigma_m=50.0)
    nowhere = scene.with_(world_from_rig=np.full((4, 4, 4), np.nan))
    for uncertain in (scene, nowhere, replace(scene, prior="odometry")):
        found = with_bases(pairs, uncertain, visibility)
        assert np.isnan([found.baseline_m[0], found.sigma_m[0]]).all() and np.isfinite(found.h_over_b[0])


def test_the_stage_network_writes_them(tmp_path, monkeypatch):
    scene, visibility = wall()
    pairs = Pairs.make([0, 1], [1, 2], "sequence", score=np.array([100.0, 100.0]))
    (tmp_path / "coarse").mkdir()
    (tmp_path / "coarse" / "scene.json").write_text(scene.to_json())
    np.savez(tmp_path / "coarse.npz", **pairs.to_npz())
    np.savez(tmp_path / "coarse" / "matches.npz", **PreviewMatches.empty().to_npz())
    np.savez(tmp_path / "coarse" / "visibility.npz", **visibility.to_npz())
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, 3] = -visibility.centre
    np.savez(tmp_path / "coarse" / "model.npz", cam_from_world=poses)
    monkeypatch.setattr(glue, "up_light", lambda run, scene: UpLight(np.full(len(scene), 99.0)))
    glue.network(Run(tmp_path, Inputs(tmp_path), Settings(), "serial"))
    with (tmp_path / "network.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert float(row["h_over_b"]) == pytest.approx(10.1 / 2, rel=0.02) and float(row["baseline_m"]) == 8
    assert float(row["sigma_m"]) == pytest.approx(40.4 / FOCAL_PX / 10, rel=0.02)
    with np.load(tmp_path / "network.npz") as stored:
        assert np.isfinite(stored["h_over_b"]).all()
