"""Images without a base: the cause is said, and no model is made of them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.sfm.database import ViewGraph
from tiegraph.sfm.start.turning import no_base
from tiegraph.sfm.tuning import MappingTuning

_WIDTH, _HEIGHT, _FOCAL, _COUNT = 1600, 1200, 1400.0, 8


def _survey(folder: Path, step_m: float, turn_deg: float, flat: bool) -> tuple[Path, Scene]:
    """Photographs of a camera with a bent lens that steps and turns before points 8 to 30 m off, or all 20 m off."""
    rng = np.random.default_rng(1)
    given = pycolmap.Camera(model="SIMPLE_PINHOLE", width=_WIDTH, height=_HEIGHT, params=[1920.0, 800.0, 600.0])
    true = pycolmap.Camera(model="SIMPLE_RADIAL", width=_WIDTH, height=_HEIGHT, params=[_FOCAL, 800.0, 600.0, -0.03])
    scene = simple_scene(
        Rig("one", (Sensor("camera", given),)),
        [f"{k}.jpg" for k in range(_COUNT)],
        np.arange(_COUNT),
        np.zeros(_COUNT, int),
    )
    depth = np.full(4000, 20.0) if flat else rng.uniform(8, 30, 4000)
    world = np.c_[rng.uniform(-2, 2, (4000, 2)), np.ones(4000)] * depth[:, None]
    create_database(folder / "database.db", scene)
    with pycolmap.Database.open(folder / "database.db") as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        seen = []
        for k in range(_COUNT):
            turn = Rotation.from_euler("y", turn_deg * k, degrees=True).as_matrix()
            local = transforms.apply(transforms.rigid(turn, np.array([-step_m * k, 0.0, 0.0])), world)
            local = np.where(local[:, 2:] > 1, local, np.nan)
            xy = np.asarray(true.img_from_cam(np.nan_to_num(local, nan=-1.0))) + rng.normal(0, 0.5, (len(world), 2))
            inside = (local[:, 2] > 1) & (xy > 0).all(axis=1) & (xy < [_WIDTH, _HEIGHT]).all(axis=1)
            seen.append(np.flatnonzero(inside))
            database.write_keypoints(ids[f"{k}.jpg"], xy[inside].astype(np.float32))
        for a in range(_COUNT):
            for b in range(a + 1, _COUNT):
                _, first, second = np.intersect1d(seen[a], seen[b], return_indices=True)
                if len(first) >= 15:
                    geometry = pycolmap.TwoViewGeometry(config=2, inlier_matches=np.c_[first, second].astype(np.uint32))
                    database.write_two_view_geometry(ids[f"{a}.jpg"], ids[f"{b}.jpg"], geometry)
    return folder / "database.db", scene


@pytest.mark.parametrize(
    ("step_m", "turn_deg", "flat", "said"),
    [
        (0.0, 7.0, False, "turned on the spot"),
        (0.0, 0.0, False, "nothing moves between the images"),
        (0.5, 7.0, False, ""),
        (1.5, 0.0, True, ""),  # a flight over a plane
        (0.2, 3.0, False, ""),
    ],
)
def test_a_turn_on_the_spot_is_told_from_steps(
    tmp_path: Path, step_m: float, turn_deg: float, flat: bool, said: str
) -> None:
    database, scene = _survey(tmp_path, step_m, turn_deg, flat)
    found = no_base(database, ViewGraph(database, scene, 15).pairs, scene, MappingTuning())
    assert said in found and bool(said) == bool(found)
    if turn_deg and said:
        times = re.search(r"focal length ([\d.]+) times", found)
        assert times is not None and float(times[1]) == pytest.approx(_FOCAL / _WIDTH, rel=0.1)
