"""The stage products on the smallest survey: rasters that open, tiles that stay, errors that are named."""

import csv
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

import tiegraph
from products_world import CHECK, MAP, colour, in_box
from test_plugins import install
from tiegraph.errors import ReconstructionError, SettingsError
from tiegraph.pipeline import products as glue
from tiegraph.pipeline.files import CLOUD, world_origin
from tiegraph.products.ortho import draw, ortho_tile
from tiegraph.products.raster import Place
from tiegraph.products.surface import Window
from tiegraph.products.tuning import Tuning
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import merged
from tiegraph.scene.copc import copc_box, write_copc

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

pytestmark = pytest.mark.slow


def run_of(folder, **settings):
    return Run(folder, Inputs(folder / "images"), merged({"products": settings}), pool="serial")


def values(folder):
    """The pixels of all rasters below a folder."""
    out = {}
    for path in sorted(folder.rglob("*.tif")):
        with rasterio.open(path) as raster:
            out[path.relative_to(folder).as_posix()] = raster.read()
    return out


@pytest.fixture(scope="module")
def made(finished, tmp_path_factory):
    """A run folder after products."""
    return finished.after("products", tmp_path_factory.mktemp("made") / "run")


def test_a_whole_run_makes_elevations_of_its_walls(made):
    receipt = json.loads((made / "receipts" / "products.json").read_text())
    assert receipt["counts"]["surfaces"] >= 1 and "look sideways" in receipt["notes"][0]
    for folder in (p for p in (made / "products").iterdir()):
        frame = json.loads((folder / "frame.json").read_text())
        with rasterio.open(folder / "dsm.tif") as raster:
            w, known = raster.read(1), raster.read_masks(1) > 0
            assert raster.shape == tuple(frame["size"][::-1]) and raster.tags()["accuracy"].startswith(
                "accuracy predicted"
            )
            v, u = np.nonzero(known)
            uv = np.stack(raster.xy(v, u))
        assert known.mean() > 0.05
        # each pixel has a point of the cloud, where the raster's matrix puts it; others may be behind it
        origin = world_origin(made)
        xyz = copc_box(made / "cloud.copc.laz", origin, np.full(3, -1e4), np.full(3, 1e4)).xyz_m + np.array(
            origin.shift_m
        )
        uvw = np.c_[xyz, np.ones(len(xyz))] @ np.array(frame["surface_from_crs"]).T
        near = np.abs(uvw[:, None, :2] - uv.T[None, ::50]).max(-1) < frame["pixel"] / 2
        at, of = np.nonzero(near)
        off = np.full(of.max() + 1, np.inf)
        np.minimum.at(off, of, np.abs(uvw[at, 2] - w[v, u][::50][of]))
        assert np.median(off[np.unique(of)]) < 0.05 and len(np.unique(of)) > 20
        names = {"dsm.tif", "sigma.tif", "hillshade.tif", "ortho.tif", "source.tif", "source.csv", "frame.json"} | {
            "overview.jpg",
            "dsm.jpg",
        }
        assert {p.name for p in folder.iterdir()} == names
        with rasterio.open(folder / "ortho.tif") as raster:
            alpha = raster.read(4)
        with rasterio.open(folder / "source.tif") as raster:
            source = raster.read(1)
        assert ((alpha > 0) == (source > 0)).all() and (alpha > 0)[known].mean() > 0.7 and not alpha[~known].any()
        listed = dict(csv.reader((folder / "source.csv").open()))
        used = {listed[str(k)] for k in np.unique(source) if k}
        assert len(used) > 1 and all((made / "images" / name).exists() for name in used)
    assert not (made / "products" / ".tiles").exists()
    given = tiegraph.open(out=made).products()
    assert sorted(given) == sorted(p.name for p in (made / "products").iterdir())
    assert sorted(given["elevation1"]) == ["dsm", "hillshade", "ortho", "sigma", "source"]
    assert all(path.suffix == ".tif" and path.is_file() for path in given["elevation1"].values())


def test_what_is_kept_of_images_and_tiles_is_not_made_again(made, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(made, folder, symlinks=True)
    for name in ("ortho.tif", "source.tif"):
        (folder / "products" / "elevation1" / name).unlink()
    drawn = []
    monkeypatch.setattr(glue.ortho, "draw", lambda *args: drawn.append(args[0].name) or right(*args))
    monkeypatch.setattr(glue.ortho, "ortho_tile", stop)
    right = draw
    with pytest.raises(KeyboardInterrupt):
        glue.products(run_of(folder))
    assert len(drawn) == len(set(drawn)) > 0
    first = list(drawn)
    monkeypatch.setattr(glue.ortho, "ortho_tile", ortho_tile)
    glue.products(run_of(folder))
    assert drawn == first and values(folder / "products").keys() == values(made / "products").keys()


def stop(*args):
    raise KeyboardInterrupt


def test_finished_tiles_stay_when_a_later_one_fails(made, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(made, folder, symlinks=True)
    before = values(folder / "products")
    shutil.rmtree(folder / "products")
    monkeypatch.setattr(glue, "TILE", 48)
    done = []

    def failing(*args):
        if len(done) == 5:
            raise OSError(28, "No space left on device")
        done.append(args[2])
        return right(*args)

    right = glue.height_tile
    monkeypatch.setattr(glue, "height_tile", failing)
    with pytest.raises(OSError):
        glue.products(run_of(folder))
    tiles = {p: p.stat().st_mtime_ns for p in (folder / "products" / ".tiles").rglob("heights*.npz")}
    assert len(tiles) == 5
    monkeypatch.setattr(glue, "height_tile", right)
    glue.products(run_of(folder))
    assert tiles == {p: p.stat().st_mtime_ns for p in tiles}
    after = values(folder / "products")
    assert after.keys() == before.keys()
    for name in before:
        np.testing.assert_allclose(after[name], before[name], atol=1e-5 if after[name].dtype == np.float32 else 3)
    stamps = {p: p.stat().st_mtime_ns for p in folder.rglob("*.tif")}
    glue.products(run_of(folder))
    assert stamps == {p: p.stat().st_mtime_ns for p in stamps}


def test_a_plane_without_points_says_so(made, tmp_path):
    with pytest.raises(ReconstructionError, match="no points of the cloud lie within"):
        glue.products(run_of(made, plane=(0.0, 0.0, 10.0, 0.0)))


def test_a_wall_along_the_path_is_unrolled_with_the_same_files(made, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(made, folder, symlinks=True)
    shutil.rmtree(folder / "products")
    outcome = glue.products(run_of(folder, unroll="wall"))
    wall = folder / "products" / "wall1"
    assert outcome.counts["surfaces"] == len(list(wall.parent.glob("wall*"))) and "wall1: " in " ".join(outcome.notes)
    assert {p.name for p in wall.iterdir()} == {p.name for p in (made / "products" / "elevation1").iterdir()}
    frame = json.loads((wall / "frame.json").read_text())
    axis = np.array(frame["axis"])
    assert axis.shape[1] == 3 and frame["radius"] is None and "surface_from_crs" not in frame
    np.testing.assert_allclose(np.linalg.norm(np.diff(axis[:, 1:], axis=0), axis=1), np.diff(axis[:, 0]), rtol=0.01)
    with rasterio.open(wall / "dsm.tif") as raster, rasterio.open(wall / "ortho.tif") as ortho:
        w, known = raster.read(1), raster.read_masks(1) > 0
        assert json.loads(raster.tags()["axis"]) == frame["axis"] and raster.units == ("m",)
        assert known.mean() > 0.05 and (ortho.read(4) > 0)[known].mean() > 0.7
    assert 1e-4 < np.median(np.abs(w[known])) < 0.05  # the walls of this survey are plane


class Pictures:
    """The images of a synthetic map, as ``pipeline.dense.Pictures``."""

    views = MAP.views()

    def picture(self, k):
        rgb = MAP.picture(self.views[k])
        return rgb, np.ones(rgb.shape[:2], bool)


@pytest.mark.parametrize(("objects_m", "least", "most"), [(4.0, 0.99, 1.0), (0.4, 0.0, 0.1)])
def test_the_orthophoto_of_a_map_is_drawn_where_its_surface_is_only_interpolated(tmp_path, objects_m, least, most):
    centre, radius = np.array([1.5, 4.4]), 0.7  # of a tree in which nothing was matched
    cloud = MAP.cloud(0.02)
    cloud = cloud.where(np.linalg.norm(cloud.xyz_m[:, :2] - centre, axis=1) > radius)
    write_copc(lambda: iter([cloud]), tmp_path / CLOUD, 0.02, tmp_path)
    about = {"tuning": Tuning(), "tile": 64, "objects_m": objects_m, "pictures": Pictures()}
    work = glue._Work(tmp_path, MAP.surface, Place(None, "m", ""), **about)
    for step in work.steps():
        for item in step.todo():
            step.make(item)
        step.finish()
    whole = Window(0, 0, *MAP.surface.shape)
    u, v = np.meshgrid(*MAP.surface.places(whole))
    inside = np.hypot(u - centre[0], v - centre[1]) < radius - 0.2
    with rasterio.open(work.path("ortho.tif")) as raster:
        rgba = raster.read()
    assert np.isnan(work.heights(whole)[inside]).all()  # the surface model does not say that it is known
    assert least <= (rgba[3] > 0)[inside].mean() <= most
    drawn = inside & (rgba[3] > 0) & (np.abs(u / CHECK % 1 - 0.5) < 0.35) & (np.abs(v / CHECK % 1 - 0.5) < 0.35)
    off = np.abs(rgba[:3].transpose(1, 2, 0).astype(int) - colour(u, v, in_box(u, v))).max(axis=-1)
    assert not least or np.percentile(off[drawn], 95) < 25
    assert (rgba[3] > 0)[~np.isnan(work.heights(whole))].mean() > 0.95


def test_a_path_without_motion_is_an_error_that_says_so(made, monkeypatch):
    monkeypatch.setattr(glue, "_path", lambda *_: np.zeros((9, 3)))
    with pytest.raises(ReconstructionError, match="extends over 0, .* leave out products.unroll"):
        glue.products(run_of(made, unroll="wall"))


def test_a_plugin_makes_a_product_of_each_surface(made, tmp_path, monkeypatch):
    example = Path(__file__).parents[2] / "examples" / "plugin"
    groups = tomllib.loads((example / "pyproject.toml").read_text())["project"]["entry-points"]
    install(tmp_path, groups)
    for folder in (tmp_path, example):
        monkeypatch.syspath_prepend(folder)
    folder = tmp_path / "run"
    shutil.copytree(made, folder, symlinks=True)
    assert not list(folder.rglob("slope"))
    tiegraph.open(out=folder, pool="serial", settings={"products": {"extra": ["slope"]}}).run("products")
    surfaces = [p for p in (folder / "products").iterdir() if p.is_dir()]
    listed = json.loads((folder / "receipts" / "files" / "products.json").read_text())
    for surface in surfaces:
        with rasterio.open(surface / "slope" / "slope.tif") as raster, rasterio.open(surface / "dsm.tif") as heights:
            slope, known = raster.read(1), heights.read_masks(1) > 0
            assert raster.transform == heights.transform and raster.crs == heights.crs
        inner = known[1:-1, 1:-1] & known[:-2, 1:-1] & known[2:, 1:-1] & known[1:-1, :-2] & known[1:-1, 2:]
        assert inner.any() and ((slope[1:-1, 1:-1] >= 0) == inner).all() and slope.max() < 90
        assert f"products/{surface.name}/slope/slope.tif" in listed
    assert json.loads((folder / "receipts" / "products.json").read_text())["software"]["tiegraph-caption"] == "0.1.0"
    with pytest.raises(SettingsError, match="products.extra.*installed plug-ins: slope"):
        merged({"products": {"extra": ["slopes"]}})
