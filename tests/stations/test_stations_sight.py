"""A hall of equal bays: its shape repeats, and free space tells one bay from the next."""

import numpy as np
import pytest

from stations.stations_world import hall, scans
from tiegraph.geometry import transforms
from tiegraph.stations.pairs import looked_through
from tiegraph.stations.station import Shot, common_side, station_of
from tiegraph.stations.tuning import Tuning

pytestmark = pytest.mark.slow
_BAY_M = 2.0


@pytest.fixture(scope="module")
def made():
    """Two stations near one end, and the true motion between them about their middles."""
    views = scans(hall(), [[1.2, 0.4, 1.5], [3.1, -0.5, 1.5]])
    shots = [Shot(str(k), v.xyz) for k, v in enumerate(views)]
    side = common_side(shots, Tuning())
    a, b = (station_of(s, side, Tuning()) for s in shots)
    world = [v.world_from_station for v in views]
    return a, b, a.shift @ transforms.invert(world[0]) @ world[1] @ b.shift_back, world[0]


def test_free_space_tells_one_bay_from_the_next(made):
    a, b, true, world = made
    along = np.eye(4)
    along[:3, 3] = -_BAY_M * world[0, :3]  # the hall's x axis in the first station's frame
    assert looked_through(a, b, true) < 0.01
    assert 0.02 < looked_through(a, b, along @ true) < 0.3
