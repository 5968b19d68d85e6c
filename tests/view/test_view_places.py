"""Picks against a cloud and cameras with known truth, and what the page draws: heights, colours, contour lines."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest

import terrain_world as world
from tiegraph.errors import EngineMissing
from tiegraph.geometry import transforms
from tiegraph.pipeline.view import Viewed
from tiegraph.products import raster
from tiegraph.products.raster import Place
from tiegraph.products.terrain import Line
from tiegraph.scene.pairs import Pairs
from tiegraph.view.layers import (
    Known,
    cameras,
    coordinates,
    distance_sigma,
    hidden,
    mesh,
    nearest,
    sigmas,
    strung,
    ties,
    tinted,
)
from view.view_world import COUNT, HIGH, KNOWN, NAMES, ORIGIN, K, as_run, cloud, poses


@pytest.fixture(scope="module")
def viewed(tmp_path_factory: pytest.TempPathFactory) -> Viewed:
    return as_run(tmp_path_factory.mktemp("view"))


@pytest.mark.slow
def test_a_pick_is_the_point_of_the_cloud_with_its_sigma(viewed: Viewed) -> None:
    truth = cloud()
    for row in (0, 17, COUNT - 1):
        xyz = truth.xyz_m[row]
        local = np.float32(xyz + ORIGIN.shift_m - viewed.middle).astype(float)  # as a graphics card has it
        found = viewed.pick(local)
        np.testing.assert_allclose(found["xyz"], xyz + ORIGIN.shift_m, atol=1e-3)
        np.testing.assert_allclose(found["local"], xyz + ORIGIN.shift_m - viewed.middle, atol=1e-3)
        assert found["crs"] == "EPSG:32654" and found["views"] == truth.views[row]
        about = found["sigma"]
        placed = KNOWN.placed.sigma(xyz)[0]
        assert about["point"] == pytest.approx(truth.sigma_m[row], rel=1e-6)
        assert about["placed"] == pytest.approx(placed)
        assert about["world"] == pytest.approx(np.sqrt((placed**2).sum() + 0.004**2 + truth.sigma_m[row] ** 2))
        for seen in found["images"]:
            assert seen["image"] != 3, "it looks to the sky"
            there = K @ transforms.apply(poses()[seen["image"]], xyz)
            np.testing.assert_allclose(seen["xy"], there[:2] / there[2], atol=1e-6)
            assert seen["hidden"] == (seen["image"] == 1)
    with pytest.raises(ValueError, match="no point of the cloud is near"):
        viewed.pick(np.array([0.0, 0.0, 3.0]))


def test_sigmas_say_what_is_not_known() -> None:
    place = np.array([1.0, 2.0, 3.0])
    found = sigmas(place, float("nan"), Known())
    assert set(found.values()) == {None}
    found = sigmas(place, 0.03, Known(inside=0.04))
    assert found["shape"] == pytest.approx(0.05) and found["world"] is None


def test_a_distance_is_as_good_as_its_ends_the_shape_and_the_scale() -> None:
    known = Known(scale=1e-3, between=np.array([[10.0, 0.02], [100.0, 0.05]]))
    ends = np.array([0.03, 0.04])
    assert distance_sigma(5.0, 0 * ends, known) == pytest.approx(np.hypot(0.01, 0.005))
    assert distance_sigma(0.0, ends, known) == pytest.approx(0.05)
    assert distance_sigma(5.0, ends, Known()) is None


def test_coordinates_are_those_of_the_crs_and_of_the_earth() -> None:
    place = np.array([10.0, 20.0, 3.0])
    found = coordinates(place, ORIGIN)
    assert found["xyz"] == [388710.0, 3951020.0, 43.0] and found["geodetic"][2] == pytest.approx(43)
    assert found["geodetic"][:2] == pytest.approx([35.7, 139.77], abs=0.02)
    assert coordinates(place, None) == {"crs": None, "xyz": [10.0, 20.0, 3.0], "geodetic": None}
    assert nearest(cloud().where(np.zeros(COUNT, bool)), place) is None


def test_what_a_depth_map_does_not_show_hides_nothing() -> None:
    depth = np.full((240, 320), np.nan, np.float32)
    place = np.array([98.0, 200.0, 0.0])
    assert hidden(place, depth, K, poses()[0]) is None
    depth[119:122, 159:162] = HIGH
    assert hidden(place, depth, K, poses()[0]) is False
    assert hidden(place - [0, 0, 1], depth, K, poses()[0]) is True
    assert hidden(place + [50, 0, 0], depth, K, poses()[0]) is None and hidden(place, depth, K, poses()[3]) is None


def test_cameras_have_their_corners_and_ties_their_rows() -> None:
    camera = pycolmap.Camera(model="PINHOLE", width=320, height=240, params=[200, 200, 160, 120])
    (found, *_) = cameras(NAMES, [(p, camera) for p in poses()], np.array([1.0, 0.0, 0.0]))
    assert found["at"] == pytest.approx([99, 200, HIGH])
    ray = np.array([-160, 120, -200]) / np.linalg.norm([160, 120, 200])  # of the upper left corner, looking down
    assert found["corners"][0] == pytest.approx(ray)
    wide = pycolmap.Camera(model="OPENCV_FISHEYE", width=320, height=240, params=[60, 60, 160, 120, 0, 0, 0, 0])
    assert np.isfinite(cameras(["a"], [(poses()[0], wide)], np.zeros(3))[0]["corners"]).all()
    i, j = np.array([0, 0, 1, 2]), np.array([1, 2, 3, 3])
    pairs = Pairs.make(i, j, "sequence", inliers=np.array([90, 40, 50, 60]), dropped=np.array([0, 0, 0, 1]))
    assert ties(pairs, {0: 0, 1: 1, 2: 5}) == [[0, 5, 40], [0, 1, 90]]


def test_rasters_lie_where_the_crs_has_them() -> None:
    frame = {
        "surface_from_crs": np.eye(4).tolist(), "pixel": 0.5, "size": [8, 4], "upper_left_uv": [100.0, 50.0],
    }  # fmt: skip
    w = np.array([[1.0, 2.0], [3.0, np.nan]])
    found = mesh(w, frame, np.array([100.0, 40.0, 0.0]))
    assert found[0, 0].tolist() == [1.0, 9.5, 1.0] and found[0, 1].tolist() == [3.0, 9.5, 2.0]
    assert found[1, 0].tolist() == [1.0, 8.5, 3.0] and np.isnan(found[1, 1, 2])
    colours = tinted(w, np.full((2, 2), 255, np.uint8))
    assert colours[..., 3].tolist() == [[255, 255], [255, 0]] and (colours[0, 0] != colours[1, 0]).any()
    line = np.array([[100.0, 40, 1], [101, 40, 1]])
    assert np.isnan(strung([line, line], line[0])[[2, 5]]).all() and len(strung([], line[0])) == 0


SHAPE = (100, 120)
LINE = np.array([[388805.0, 3951205.0], [388810.0, 3951206.0], [388812.0, 3951210.0]])


def opened(folder: Path) -> Viewed:
    x, y = world.places(SHAPE)
    w = (0.1 * x + 0.2 * y).astype(np.float32)
    w[:20, :20] = np.nan
    world.as_run(folder, dsm=w, sigma=np.where(np.isfinite(w), np.float32(0.02), np.nan))
    told = Place(world.ORIGIN).described(world.surface(*SHAPE))
    (folder / "products" / "map" / "frame.json").write_text(json.dumps(told))
    run: Any = SimpleNamespace(path=folder.joinpath, folder=folder)
    box = np.array([[388800.0, 3951200.0, 40.0], [388824.0, 3951220.0, 46.0]])
    return Viewed(run=run, origin=world.ORIGIN, unit="m", box=box, points=1, images={}, known=Known())


@pytest.mark.slow
def test_a_surface_model_lies_on_its_plane(tmp_path: Path) -> None:
    viewed = opened(tmp_path / "run")
    assert [sheet.name for sheet in viewed.sheets] == ["map: surface model"]
    numbers = viewed.mesh(0)
    assert numbers[:2].tolist() == list(SHAPE)
    east, north, up = (numbers[2:].reshape(*SHAPE, 3) + viewed.middle).transpose(2, 0, 1) - [
        [[388800]],
        [[3951200]],
        [[40]],
    ]
    assert np.isnan(up[:20, :20]).all() and np.isfinite(up).sum() == SHAPE[0] * SHAPE[1] - 400
    known = np.isfinite(up)
    np.testing.assert_allclose(up[known], (0.1 * east + 0.2 * north)[known], atol=1e-3)
    drawn = cv2.imdecode(np.frombuffer(viewed.picture(0), np.uint8), cv2.IMREAD_UNCHANGED)
    assert (drawn[:20, :20, 3] == 0).all() and (drawn[20:, 20:, 3] == 255).all()


@pytest.mark.parametrize("kind", ["gpkg", "geojson"])
@pytest.mark.slow
def test_contour_lines_keep_place_and_height(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    viewed = opened(tmp_path / "run")
    with pytest.raises(ValueError, match="no contour lines"):
        viewed.contours()
    if kind == "gpkg":
        pytest.importorskip("pyogrio")
    else:

        def missing(*_: str) -> None:
            raise EngineMissing("pyogrio")

        monkeypatch.setattr(raster, "gdal", missing)
    lines = [Line(w, LINE, sigma=0.1, index=False) for w in (41.0, 42.5)]
    path = tmp_path / "run" / "products" / "map" / "contours.gpkg"
    assert raster.write_lines(path, lines, world.surface(*SHAPE), Place(world.ORIGIN)) == f"contours.{kind}"
    found = viewed.contours() + viewed.middle
    assert len(found) == 8 and np.isnan(found[[3, 7]]).all()
    for part, line in zip((found[:3], found[4:7]), lines):
        np.testing.assert_allclose(part, np.c_[LINE, np.full(3, line.w)], atol=1e-3)
