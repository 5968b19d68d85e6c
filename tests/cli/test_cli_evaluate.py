"""`tiegraph evaluate CLOUD REFERENCE`: two files of any format, judged, written, or refused with a remedy."""

import json
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest

from clouds_world import ground
from tiegraph.cli.main import main
from tiegraph.geometry.geodesy import Origin, crs_coordinates, geodetic_from_world, world_from_geodetic
from tiegraph.scene.cloudchunks import Measured, write_measured

NORTH = Origin(lat_deg=35.7, lon_deg=139.7, height_m=37.0, crs="EPSG:32654", shift_m=(382300.0, 3951500.0, 30.0))


def las(path: Path, xyz: np.ndarray, origin: Origin | None = NORTH) -> str:
    write_measured([Measured(xyz, {"height": xyz[:, 2]}, (0.0, 1.0))], path, origin, 0.01)
    return str(path)


@pytest.mark.slow
def test_two_clouds_are_judged_and_written(tmp_path: Path, capsys) -> None:
    cloud = las(tmp_path / "cloud.laz", ground(4000, 0) + [0, 0, 0.1])
    inverse = geodetic_from_world(ground(4000, 1), NORTH)  # the reference counts in the neighbouring zone
    other = Origin(lat_deg=35.7, lon_deg=139.7, height_m=0.0, crs="EPSG:32653", shift_m=(0.0, 0.0, 0.0))
    reference = las(tmp_path / "reference.las", crs_coordinates(world_from_geodetic(inverse, other), other), other)
    out = tmp_path / "judged"
    assert main(["evaluate", cloud, reference, "--distances-m", "0.2", "0.5", "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "fscore_0.5m" in said and "brought from EPSG:32653 into EPSG:32654" in said
    result = json.loads((out / "metrics.json").read_text())
    values = {m["name"]: m["value"] for m in result["metrics"]}
    assert values["m3c2_median"] == pytest.approx(0.1, abs=0.01) and values["fscore_0.5m"] > 99
    made = laspy.read(out / "distances.laz")
    assert np.median(made["distance_m"]) == pytest.approx(values["cloud_to_cloud_median"], abs=1e-3)
    assert np.abs(np.median(made.x) - 382300) < 5 and (out / "m3c2.laz").exists() and (out / "m3c2.png").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud.laz", "judged", "reference.las"]  # no scratch left
    assert main(["evaluate", cloud, reference, "-o", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize(("crs", "said"), [("EPSG:32654", True), ("EPSG:32654+6695", False)])
def test_heights_from_another_level_are_said(tmp_path: Path, capsys, crs: str, said: bool) -> None:
    xyz = np.random.default_rng(0).uniform(0, 20, (400, 3)) + [382300.0, 3951500.0, 0.0]
    files = []
    for name, stated in ("own.las", crs), ("reference.las", "EPSG:32654+6695"):  # above the geoid of Japan
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales, header.offsets = np.full(3, 0.001), np.round(xyz.mean(axis=0))
        header.add_crs(pyproj.CRS(stated))
        cloud = laspy.LasData(header)
        cloud.xyz = xyz
        cloud.write(tmp_path / name)
        files.append(str(tmp_path / name))
    assert main(["evaluate", *files]) == 0
    assert ("heights refer to another level (EPSG:6695)" in capsys.readouterr().out) == said


@pytest.mark.slow
def test_a_registration_is_part_of_the_result(tmp_path: Path, capsys) -> None:
    bumps = [ground(6000, seed) for seed in (0, 1)]
    for one in bumps:
        one[:, 2] += np.sin(one[:, 0]) + np.cos(one[:, 1])
    files = [las(tmp_path / "a.laz", bumps[0] + [0.2, -0.1, 0.3]), las(tmp_path / "b.laz", bumps[1])]
    assert main(["evaluate", *files, "--register", "rigid", "-o", str(tmp_path / "out")]) == 0
    assert "registration of the cloud on the reference" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "metrics.json").read_text())
    rows = {r[0]: r[1:] for r in result["tables"]["registration of the cloud on the reference"]["rows"]}
    assert rows["shift in z at the middle, m"][0] == pytest.approx(-0.3, abs=0.02)
    assert {m["name"]: m["value"] for m in result["metrics"]}["m3c2_median"] == pytest.approx(0, abs=0.01)


def test_what_does_not_meet_is_refused_with_a_remedy(tmp_path: Path, capsys) -> None:
    cloud, reference = las(tmp_path / "a.laz", ground(300, 0)), las(tmp_path / "b.laz", ground(300, 1), None)
    assert main(["evaluate", cloud, reference, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "b.laz: the cloud (x, y, z from (3822" in said and "do not meet: are both in one CRS" in said
    assert main(["evaluate", cloud, las(tmp_path / "one.laz", np.zeros((1, 3)))]) == 2
    assert "one.laz (EPSG:32654 by its header): half of the points" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["evaluate", cloud, cloud, "--distances-m", "-1"]) == 2
    assert "--distances-m -1: give metres above 0" in capsys.readouterr().err
    assert main(["evaluate", cloud, las(tmp_path / "c.laz", ground(300, 1) + 500), "--register", "rigid"]) == 2
    assert "c.laz (EPSG:32654 by its header): only 0 of" in capsys.readouterr().err


def test_constants_of_a_file_reach_the_comparison(tmp_path: Path, capsys) -> None:
    files = [las(tmp_path / "a.laz", ground(2000, 0)), las(tmp_path / "b.laz", ground(2000, 1))]
    (tmp_path / "own.toml").write_text("[tuning.evaluate.m3c2]\nleast_points = 2000\n")
    for name, more, known in (("a", (), True), ("b", ("--tuning", str(tmp_path / "own.toml")), False)):
        assert main(["evaluate", *files, "-o", str(tmp_path / name), *more]) == 0
        metrics = json.loads((tmp_path / name / "metrics.json").read_text())["metrics"]
        assert (next(m["value"] for m in metrics if m["name"] == "m3c2_median") is not None) == known
    assert main(["evaluate", *files, "--tuning", str(tmp_path / "none.toml")]) == 2
    assert "none.toml: not there" in capsys.readouterr().err


def test_a_reference_that_is_cut_short_or_no_cloud_is_named_once(tmp_path: Path, capsys) -> None:
    cloud = las(tmp_path / "a.las", ground(300, 0))
    whole = (tmp_path / "a.las").read_bytes()
    (tmp_path / "cut.las").write_bytes(whole[: len(whole) // 2])
    header = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {a}\n" for a in "xyz")
    (tmp_path / "hole.ply").write_text(f"{header}end_header\nnan 0 0\n")
    for name, why in (("cut.las", "is cut off"), ("hole.ply", "1 points have no coordinates"), ("a.xyz", "convert it")):
        assert main(["evaluate", cloud, str(tmp_path / name)]) == 2
        said = capsys.readouterr().err
        assert why in said and said.count(name) == 1
    assert main(["evaluate", cloud]) == 2
    assert "The cloud that counts as true" in capsys.readouterr().err


def test_a_setting_out_of_range_is_said_without_the_words_of_pydantic(tmp_path: Path, capsys) -> None:
    assert main(["run", str(tmp_path), "--evaluate.reference-origin", "95", "0", "0"]) == 2
    said = capsys.readouterr().err
    assert "evaluate.reference_origin.0 Input should be less than or equal to 90 (given: 95.0)" in said
    assert "pydantic" not in said and "type=" not in said
