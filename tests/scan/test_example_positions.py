"""The positions of the example survey: an RTK receiver's, and those of a receiver that never got its ambiguities."""

from pathlib import Path

import numpy as np
import pytest
from scan_worlds import scan

from tiegraph.geometry.geodesy import geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.scan.tuning import Tuning as ScanTuning
from tiegraph.scene.colmapmodel import image_poses, read_model
from tiegraph.scene.gnss import read_gnss
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.fixes import Measurements, PositionRows
from tiegraph.sfm.world.georef import georeference

pytestmark = pytest.mark.slow  # the world they share

RTK, FLOAT = "gnss.csv", "gnss_float.csv"
OUTAGES_S = {RTK: ((36003.6, 36008.4), (36250.6, 36255.4)), FLOAT: ((36003.8, 36007.8), (36251.4, 36255.2))}


@pytest.fixture(scope="module", params=[RTK, FLOAT], ids=["rtk", "float"])
def placed(request, canal: Path):
    """The name of a file, the scene with its positions, and how far it puts the true model from where it is, (N, 3)."""
    name = request.param
    given = {"rig": str(canal / "rig.toml"), "gnss": canal / name, "times": canal / "times.csv"}
    scene = scan(canal / "images", **given)
    model = read_model(canal / "truth" / "colmap")
    gnss = read_gnss(canal / name, ScanTuning().positions.gnss)
    rows = PositionRows(gnss.time_s, world_from_geodetic(gnss.lat_lon_height, scene.origin), gnss.sigma_m)
    found = georeference(model, scene, GeorefSettings(), Tuning().world, Measurements(rows=rows))
    inside = np.linalg.inv(image_poses(model, scene))[:, :3, 3]
    truth = geodetic_from_world(inside, make_origin(35.6965, 139.7695, 37.0, "ENU"))
    return name, scene, found.world_from_model(inside) - world_from_geodetic(truth, scene.origin)


def test_frames_without_a_fix_under_the_bridge_stay_without(placed) -> None:
    name, scene, _ = placed
    known = np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1)
    under = np.any([(first < scene.time_s) & (scene.time_s < last) for first, last in OUTAGES_S[name]], axis=0)
    assert not known[under].any() and known.sum() == 10 and under.sum() == (10 if name == RTK else 8)
    assert name == FLOAT or known[~under].all(), "the poor one ends before the last frames"


def test_the_true_model_is_placed_as_well_as_the_receiver_is_good(placed) -> None:
    name, _, off = placed
    rmse = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert (0.003 < rmse < 0.05) if name == RTK else (0.2 < rmse < 3.0), rmse
