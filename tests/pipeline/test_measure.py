"""Profiles and volumes of a finished map, by the command line: files that open, errors that are named."""

import csv
import json
import xml.etree.ElementTree as xml

import numpy as np
import pyproj
import pytest

import terrain_world as world
from tiegraph.cli.main import main

EAST, NORTH, UP = 388800.0, 3951200.0, 40.0  # of the lower left corner of the map
SHAPE = (100, 120)
BOX = [(5, 4), (15, 4), (15, 14), (5, 14)]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder whose map is a slanted plane, seen in all but a corner."""
    x, y = world.places(SHAPE)
    w = (0.1 * x + 0.2 * y).astype(np.float32)
    w[:20, :20] = np.nan
    sigma = np.where(np.isfinite(w), np.float32(0.02), np.nan)
    folder = tmp_path_factory.mktemp("measure") / "run"
    return world.as_run(folder, dsm=w, sigma=sigma, dtm=w, dtm_sigma=sigma)


def ring(vertices, shift=(EAST, NORTH)):
    return [[a + shift[0], b + shift[1]] for a, b in (*vertices, vertices[0])]


def polygon(path, coordinates, crs="EPSG:32654"):
    """A GeoJSON file of a polygon in a CRS ("" = as RFC 7946 has it)."""
    data = {"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}}]}
    data["features"][0]["geometry"] = {"type": "Polygon", "coordinates": [coordinates]}
    if crs:
        data["crs"] = {"type": "name", "properties": {"name": crs}}
    path.write_text(json.dumps(data))
    return path


def measured(run, tmp_path, *more, file=None):
    file = file or polygon(tmp_path / "heap.geojson", ring(BOX))
    out = tmp_path / "volume.json"
    out.unlink(missing_ok=True)
    assert main(["volume", str(run), "--polygon", str(file), "-o", str(out), *more]) == 0
    return json.loads(out.read_text())["polygons"]


def refusal(capsys, *arguments):
    assert main([str(a) for a in arguments]) == 2
    return capsys.readouterr().err


@pytest.mark.slow
def test_a_profile_is_exact_on_a_plane(run, tmp_path):
    out = tmp_path / "profile.csv"
    places = [f"{EAST + 2},{NORTH + 1}", f"{EAST + 20.3},{NORTH + 11.7}", f"{EAST + 10},{NORTH + 18}"]
    assert main(["profile", str(run), "--line", *places, "-o", str(out)]) == 0
    rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(out.open())]
    x, y = np.array([(r["east_m"] - EAST, r["north_m"] - NORTH) for r in rows]).T
    w = 0.1 * x + 0.2 * y + UP
    np.testing.assert_allclose([r["dsm_m"] for r in rows], w, atol=2e-4)
    np.testing.assert_allclose([r["dtm_m"] for r in rows], w, atol=2e-4)
    assert {r["dsm_sigma_m"] for r in rows} == {0.02}
    length = np.hypot(18.3, 10.7) + np.hypot(10.3, 6.3)
    assert rows[-1]["distance_m"] == pytest.approx(length, abs=1e-3) and len(rows) >= length / world.PIXEL
    assert np.hypot(x - 20.3, y - 11.7).min() < 1e-3  # a vertex is a row
    svg = out.with_suffix(".svg").read_bytes()
    assert xml.fromstring(svg).tag.endswith("svg") and b"2026" not in svg
    assert main(["profile", str(run), "--line", *places, "-o", str(tmp_path / "again.csv")]) == 0
    assert (tmp_path / "again.svg").read_bytes() == svg


def test_a_profile_says_nothing_where_nothing_was_seen(run, tmp_path):
    line = tmp_path / "line.geojson"
    ends = [[EAST - 1, NORTH + 19], [EAST + 10, NORTH + 19]]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32654"}}
    line.write_text(json.dumps({"type": "LineString", "coordinates": ends, "crs": crs}))
    out = tmp_path / "profile.csv"
    assert main(["profile", str(run), "--line", str(line), "-o", str(out)]) == 0
    known = {float(r["distance_m"]) for r in csv.DictReader(out.open()) if r["dsm_m"]}
    assert min(known) == pytest.approx(1 + 4, abs=0.5)


def test_volumes_over_a_level_are_those_of_the_plane(run, tmp_path, capsys):
    (found,) = measured(run, tmp_path, "--base", "40")
    assert found["area"] == pytest.approx(100) and found["seen"] == 1 and found["unit"] == "m"
    assert found["net"]["value"] == pytest.approx((0.1 * 10 + 0.2 * 9) * 100, rel=1e-3) == found["cut"]["value"]
    text = capsys.readouterr().out
    assert (
        "cut 280.0" in text
        and "m3" in text
        and "base: level at 40.000" in text
        and "accuracy of the survey in the world" in text
    )
    (found,) = measured(run, tmp_path, "--surface", "dtm")
    assert abs(found["net"]["value"]) < 0.01 and "slope 22.4%" in found["base"]
    (found,) = measured(run, tmp_path, "--base", str(run))
    assert abs(found["net"]["value"]) < 0.02 < found["net"]["sigma"]


def test_a_polygon_may_be_in_degrees_a_table_a_geopackage_or_a_drawing(run, tmp_path):
    to_degrees = pyproj.Transformer.from_crs(32654, 4326, always_xy=True)
    degrees = [list(to_degrees.transform(*place)) for place in ring(BOX)]
    files = [polygon(tmp_path / "degrees.geojson", degrees, crs="")]
    table = tmp_path / "table.csv"
    table.write_text("east,north\n" + "".join(f"{a},{b}\n" for a, b in ring(BOX)))
    files.append(table)
    raw = pytest.importorskip("pyogrio.raw")
    two = tmp_path / "two.gpkg"
    meta, _, shapes, _ = raw.read(polygon(tmp_path / "a.geojson", ring(BOX)))
    raw.write(two, np.array([*shapes, *shapes]), [], [], driver="GPKG", geometry_type="Polygon", crs=meta["crs"])
    files.append(two)
    drawing = tmp_path / "drawing.dxf"  # which has no CRS, and closed lines for polygons
    line = {"type": "LineString", "coordinates": ring(BOX)}
    meta, _, shapes, _ = raw.read(json.dumps({"type": "Feature", "properties": {}, "geometry": line}).encode())
    raw.write(drawing, shapes, [], [], driver="DXF", geometry_type="LineString", crs="EPSG:32654")
    files.append(drawing)
    counted = []
    for file in files:
        found = measured(run, tmp_path, "--base", "40", file=file)
        counted.append(len(found))
        assert [f["cut"]["value"] for f in found] == pytest.approx([280] * len(found), rel=1e-3)
    assert counted == [1, 1, 2, 1]


def test_what_cannot_be_measured_is_said_with_its_remedy(run, tmp_path, capsys):
    def volume(vertices, *more, crs="EPSG:32654", shift=(EAST, NORTH)):
        file = polygon(tmp_path / "p.geojson", ring(vertices, shift), crs)
        return refusal(capsys, "volume", run, "--polygon", file, *more)

    assert "crosses itself" in volume([(5, 5), (15, 15), (15, 5), (5, 15)])
    outside = volume([(5, 5), (50, 5), (5, 15)])
    assert "lies outside: the map reaches from 388800.00 to 388824.00 east" in outside
    assert "WGS 84 / UTM zone 10N" in (other := volume(BOX, crs="EPSG:32610")) and "save it in that CRS" in other
    assert "heights are known on" in volume([(0.2, 16.2), (3.8, 16.2), (3.8, 19.8), (0.2, 19.8)], "--base", "40")
    assert "no ground was seen" in volume([(0.2, 17.9), (1.8, 17.9), (1.8, 19.8), (0.2, 19.8)])
    assert "give plane, lowest, a height" in volume(BOX, "--base", "plan")
    (tmp_path / "empty.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    assert "has no polygon" in refusal(capsys, "volume", run, "--polygon", tmp_path / "empty.geojson")
    assert "is no file" in refusal(capsys, "volume", run, "--polygon", tmp_path / "none.gpkg")
    out = ("-o", tmp_path / "p.csv")
    assert "lies outside" in refusal(capsys, "profile", run, "--line", "-3,4", "-5,6", *out)
    assert "give two places" in refusal(capsys, "profile", run, "--line", "3,4", *out)
    assert not (tmp_path / "p.csv").exists()


def test_a_run_without_a_map_says_how_to_make_one(tmp_path, capsys):
    folder = world.as_run(tmp_path / "run")
    (folder / "products" / "map" / "dsm.tif").unlink()
    file = polygon(tmp_path / "p.geojson", ring(BOX))
    for arguments in (("profile", folder, "--line", "0,0", "1,1"), ("volume", folder, "--polygon", file)):
        assert "--products.make map" in refusal(capsys, *arguments)


def test_lengths_without_scale_are_in_units(tmp_path, capsys):
    folder = world.as_run(tmp_path / "run", origin=None, scale="none")
    table = tmp_path / "p.csv"
    table.write_text("\n".join(f"{a + 100},{b + 200}" for a, b in [(20, 20), (29, 20), (29, 26)]))
    assert main(["volume", str(folder), "--polygon", str(table), "--base", "-5"]) == 0
    assert "units3" in capsys.readouterr().out
    out = tmp_path / "profile.csv"
    assert main(["profile", str(folder), "--line", "110,210", "120,210", "-o", str(out)]) == 0
    assert out.read_text().startswith("distance_units,") and csv.DictReader(out.open()).__next__()["dtm_units"] == ""
