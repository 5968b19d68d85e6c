"""Maps of a run as the page draws them: heights, colours and contour lines where the CRS has them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

import terrain_world as world
from tiegraph.errors import EngineMissing
from tiegraph.pipeline import terrain
from tiegraph.pipeline.view import Viewed
from tiegraph.products.raster import Place
from tiegraph.products.terrain import Line
from tiegraph.view.layers import Known

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

        monkeypatch.setattr(terrain, "gdal", missing)
    lines = [Line(w, LINE, sigma=0.1, index=False) for w in (41.0, 42.5)]
    path = tmp_path / "run" / "products" / "map" / "contours.gpkg"
    assert terrain._write_lines(path, lines, world.surface(*SHAPE), Place(world.ORIGIN)) == f"contours.{kind}"
    found = viewed.contours() + viewed.middle
    assert len(found) == 8 and np.isnan(found[[3, 7]]).all()
    for part, line in zip((found[:3], found[4:7]), lines):
        np.testing.assert_allclose(part, np.c_[LINE, np.full(3, line.w)], atol=1e-3)
