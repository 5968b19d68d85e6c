"""Maps for GIS, opened by PROJ, GDAL and a JSON schema."""

import json
import sqlite3
import xml.etree.ElementTree as xml

import numpy as np
import pyproj
import pytest

from export_world import FRAMES, ORIGIN, finished
from tiegraph.errors import EngineMissing, InputError
from tiegraph.export import maps
from tiegraph.geometry.geodesy import Origin

POSITION = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
SHAPES = [
    {"properties": {"type": {"const": "Point"}, "coordinates": POSITION}},
    {
        "properties": {
            "type": {"const": "LineString"},
            "coordinates": {"type": "array", "items": POSITION, "minItems": 2},
        }
    },
]
FEATURE = {
    "required": ["type", "geometry", "properties"],
    "properties": {"type": {"const": "Feature"}, "geometry": {"oneOf": SHAPES}, "properties": {"type": "object"}},
}
SCHEMA = {  # RFC 7946, as far as these layers go
    "type": "object",
    "required": ["type", "features"],
    "properties": {"type": {"const": "FeatureCollection"}, "features": {"type": "array", "items": FEATURE}},
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return finished(tmp_path_factory.mktemp("survey"))


def layer(folder, name) -> list[dict]:
    import jsonschema

    data = json.loads((folder / f"{name}.geojson").read_text())
    jsonschema.validate(data, SCHEMA)
    return data["features"]


def check_cameras(made, rows):
    """Rows of (place in the CRS, properties)."""
    assert len(rows) == len(made.model.images) == 4 * FRAMES
    for place, said in rows:
        image = made.model.find_image_with_name(said["name"])
        assert np.abs(place - ORIGIN.shift_m - image.projection_center()).max() < 1e-3
        axis = image.cam_from_world().rotation.matrix()[2]
        heading, pitch = np.radians([said["heading_deg"], said["pitch_deg"]])
        told = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)])
        assert np.abs(told - axis).max() < 1e-4
        frame = int(made.scene.frame[made.scene.image_index[said["name"]]])
        assert said["time_s"] == pytest.approx(made.scene.time_s[frame]) and said["points"] == image.num_points3D
        assert (said["pass"], said["camera"]) == tuple(said["name"].split("/")[:2])
        assert 0.034 < said["sigma_m"] < 0.036  # three times two centimetres


def test_geojson_is_in_degrees_and_leads_back_to_the_crs(made, tmp_path):
    assert made.project.export(tmp_path / "out", "geojson") == 4 * FRAMES
    to_crs = pyproj.Transformer.from_crs("EPSG:4326", ORIGIN.crs, always_xy=True)
    cameras = layer(tmp_path / "out", "cameras")
    check_cameras(made, [(np.array(to_crs.transform(*f["geometry"]["coordinates"])), f["properties"]) for f in cameras])
    views = layer(tmp_path / "out", "views")
    assert len(views) == len(cameras)
    for view in views:
        start, end = (np.array(to_crs.transform(*c)) for c in view["geometry"]["coordinates"])
        axis = made.model.find_image_with_name(view["properties"]["name"]).cam_from_world().rotation.matrix()[2]
        assert np.abs((end - start) - view["properties"]["distance_m"] * axis).max() < 2e-3
    ties = layer(tmp_path / "out", "ties")
    assert [t["properties"]["matches"] for t in ties] == [50, 20, 10]
    assert (ties[0]["properties"]["a"], ties[0]["properties"]["b"]) == made.scene.names[:2]
    at = {f["properties"]["name"]: f["geometry"]["coordinates"] for f in cameras}
    assert all(t["geometry"]["coordinates"] == [at[t["properties"][k]] for k in "ab"] for t in ties)


@pytest.mark.slow
def test_gpkg_is_in_the_crs_and_has_styles(made, tmp_path):
    raw = pytest.importorskip("pyogrio.raw")
    assert made.project.export(tmp_path / "out", "gpkg") == 4 * FRAMES
    path = tmp_path / "out" / maps.FILE
    meta, _, shapes, columns = raw.read(path, layer="cameras")
    assert pyproj.CRS.from_user_input(meta["crs"]) == pyproj.CRS.from_user_input(ORIGIN.crs)
    places = [np.frombuffer(shape[5:29], "<f8") for shape in shapes]  # WKB of a point with height
    names = list(meta["fields"])
    check_cameras(made, [(p, dict(zip(names, row))) for p, row in zip(places, zip(*columns))])
    meta, _, shapes, columns = raw.read(path, layer="ties")
    assert dict(zip(meta["fields"], columns))["matches"].tolist() == [50, 20, 10]
    with sqlite3.connect(path) as data:
        rows = data.execute(
            "SELECT f_table_name, f_geometry_column, styleQML, useAsDefault FROM layer_styles"
        ).fetchall()
        geometry = dict(data.execute("SELECT table_name, column_name FROM gpkg_geometry_columns").fetchall())
    assert {row[0] for row in rows} == set(geometry) == {"cameras", "views", "ties"}
    for name, column, style, default in rows:
        assert column == geometry[name] and default == 1
        root = xml.fromstring(style.split("\n", 1)[1])
        assert root.tag == "qgis" and root.find("renderer-v2/symbols/symbol/layer") is not None


@pytest.mark.slow
def test_a_world_without_crs_is_in_degrees_too(tmp_path):
    made = finished(tmp_path, origin=Origin(35.0, 139.0, 12.0))
    made.project.export(tmp_path / "map", "geojson")
    zero = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    for feature in layer(tmp_path / "map", "cameras"):
        centre = made.model.find_image_with_name(feature["properties"]["name"]).projection_center()
        there = np.array(zero.transform(*feature["geometry"]["coordinates"]))
        assert np.linalg.norm(there - zero.transform(139.0, 35.0, 12.0)) == pytest.approx(
            np.linalg.norm(centre), abs=1e-3
        )


@pytest.mark.slow
def test_what_a_map_refuses(tmp_path, monkeypatch, made):
    free = finished(tmp_path, origin=None)
    for name in ("geojson", "gpkg"):
        with pytest.raises(InputError, match="not on the Earth"):
            free.project.export(tmp_path / name, name)
    monkeypatch.setitem(__import__("sys").modules, "pyogrio", None)
    with pytest.raises(EngineMissing, match="pip install"):
        made.project.export(tmp_path / "none", "gpkg")
    assert not (tmp_path / "none").exists()
