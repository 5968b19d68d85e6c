"""Images without a base: the cause is said, and no model is made of them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import Sightings, drawn, sighted, write_database
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene
from tiegraph.sfm.database import ViewGraph
from tiegraph.sfm.start.turning import no_base
from tiegraph.sfm.tuning import MappingTuning

_WIDTH, _FOCAL = 1600, 1400.0


def _survey(folder: Path, step_m: float, turn_deg: float, flat: bool) -> tuple[Path, Scene]:
    """Photographs of a camera with a bent lens that steps and turns before points 8 to 30 m off, or all 20 m off."""
    rng = np.random.default_rng(1)
    given, true = (
        pycolmap.Camera(model=model, width=_WIDTH, height=1200, params=params)
        for model, params in (
            ("SIMPLE_PINHOLE", [1920.0, 800.0, 600.0]), ("SIMPLE_RADIAL", [_FOCAL, 800.0, 600.0, -0.03])
        )
    )  # fmt: skip
    depth = np.full(4000, 20.0) if flat else rng.uniform(8, 30, 4000)
    world = np.c_[rng.uniform(-2, 2, (4000, 2)), np.ones(4000)] * depth[:, None]

    def pose_at(number: float) -> np.ndarray:
        turn = Rotation.from_euler("y", turn_deg * number, degrees=True).as_matrix()
        return transforms.invert(transforms.rigid(turn, np.array([-step_m * number, 0.0, 0.0])))

    def sight(number: int, _: int) -> Sightings:
        return sighted(true, [transforms.invert(pose_at(number))] * 3, world, rng, far=np.inf, noise_px=0.5)

    model, scene = drawn(Rig("one", (Sensor("camera", given, np.eye(4)),)), np.arange(8.0), pose_at, world, sight)
    write_database(model, folder / "database.db", reach=8)
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
