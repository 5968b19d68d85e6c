"""The cloud as E57, read again by pye57."""

import json
import sys

import numpy as np
import pye57
import pytest

from export_world import ORIGIN, finished
from tiegraph.errors import EngineMissing, InputError
from tiegraph.pipeline import export as glue
from tiegraph.scene.cloudchunks import open_cloud
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.results import Cloud


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A survey with a cloud 400 m wide, and that cloud."""
    found = finished(tmp_path_factory.mktemp("survey"))
    rng = np.random.default_rng(0)
    count = 5000
    cloud = Cloud(
        xyz_m=rng.uniform(-200, 200, (count, 3)),
        rgb=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        normal=np.tile(np.array([0, 0, 1], np.float32), (count, 1)),
        sigma_m=np.full(count, 0.01, np.float32),
        views=np.full(count, 3, np.uint8),
        origin=ORIGIN,
    )
    write_cloud(cloud, found.project.folder / "cloud.laz")
    return found.project, cloud


@pytest.mark.parametrize("scan", [10_000_000, 2000])
def test_the_cloud_comes_back_to_the_millimetre(made, tmp_path, monkeypatch, scan):
    project, cloud = made
    monkeypatch.setattr(glue, "_SCAN", scan)
    assert project.export(tmp_path / "e57", "e57") == len(cloud)
    file = pye57.E57(str(tmp_path / "e57" / "cloud.e57"))
    assert file.scan_count == -(-len(cloud) // scan) and "EPSG:32654" in file.get_header(0)["name"].value()
    scans = [file.read_scan(k, colors=True, ignore_missing_fields=True) for k in range(file.scan_count)]
    xyz, rgb = (
        np.concatenate([np.stack([s[n + c] for c in axes], axis=1) for s in scans])
        for n, axes in (("cartesian", "XYZ"), ("color", ("Red", "Green", "Blue")))
    )
    assert np.abs(xyz - (cloud.xyz_m + ORIGIN.shift_m)).max() < 0.001 and (rgb == cloud.rgb).all()
    said = json.loads((tmp_path / "e57" / "offset.json").read_text())
    assert said["crs"] == "EPSG:32654" and said["crs_from_local"] == np.eye(4).tolist()
    again = np.concatenate([part.xyz for part in open_cloud(tmp_path / "e57" / "cloud.e57").parts()])
    assert np.abs(again - xyz).max() < 1e-9


def test_what_is_missing_is_named(made, tmp_path, monkeypatch):
    project, _ = made
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    with pytest.raises(InputError, match="not empty"):
        project.export(tmp_path / "full", "e57")
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(EngineMissing, match=r"pip install 'tiegraph\[e57\]'"):
        project.export(tmp_path / "none", "e57")
    assert not (tmp_path / "none").exists()
    (project.folder / "cloud.laz").rename(project.folder / "away.laz")
    with pytest.raises(InputError, match=r"cloud.laz is not there yet: run\(until='cloud'\) makes it"):
        project.export(tmp_path / "none", "e57")
    (project.folder / "away.laz").rename(project.folder / "cloud.laz")
