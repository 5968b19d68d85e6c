"""Pictures are PNG of a readable size, and say what is in the table."""

import io

import numpy as np
from boat_world import boat
from PIL import Image

from tiegraph.network.network import estimate_network
from tiegraph.network.pictures import _matrix, matrix_png
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASON_LOOKS, REASONS, Pairs


def opened(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def test_pictures_of_a_survey() -> None:
    world = boat((10, 10), (2.0, 2.0))
    brightness = np.where(np.isin(world.scene.step[world.scene.frame], (4, 5, 6)), 60.0, 150.0)
    network = estimate_network(world.scene, brightness, world.match, NetworkSettings())
    pictures = dict(network.pictures())
    assert set(pictures) == {"matrix", "offsets", "sections"}
    for data in pictures.values():
        image = opened(data)
        assert 300 < image.shape[0] < 4000 and 800 < image.shape[1] < 2000
    blue = np.array([int(REASON_LOOKS["kept"][1][k : k + 2], 16) for k in (1, 3, 5)])
    share = (np.abs(opened(pictures["matrix"]).astype(int) - blue).max(axis=-1) < 8).mean()
    assert 0.02 < share < 0.4


def test_kept_pairs_win_where_cells_are_shared() -> None:
    pairs = Pairs.make(
        [0, 1, 2],
        [2401, 2402, 2403],
        "offsets",
        dropped=np.array([REASONS.index("section"), 0, REASONS.index("section")]),
    )
    cells, step = _matrix(pairs, np.arange(2404), 2404)
    assert step == 3 and cells.shape == (802, 802)
    assert cells[0, 800] == 1 and cells[800, 0] == 1
    assert np.count_nonzero(cells) in (2, 4)


def test_loose_photographs_have_a_matrix() -> None:
    from test_network_design import photos

    assert opened(matrix_png(Pairs.make([0, 1], [1, 2], "exhaustive"), photos(5))).size
