"""The renderer: nearest point wins, north is up, edges are darkened."""

import numpy as np

from tiegraph.report import cloudview
from tiegraph.report.cloudview import CloudView, by_height, compass, render, standard_views, with_scale_bar

RED, BLUE = [200, 30, 30], [30, 30, 200]


def plate(z: float, half: float, colour: list[int], points: int = 60_000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(int(z * 10))
    xyz = np.column_stack([rng.uniform(-half, half, (points, 2)), np.full(points, z)])
    return xyz, np.tile(np.array(colour, np.uint8), (points, 1))


def test_the_upper_plate_hides_the_lower() -> None:
    (low, low_rgb), (high, high_rgb) = plate(0, 10, RED), plate(2, 4, BLUE)
    for order in (1, -1):
        parts = [(low, low_rgb), (high, high_rgb)][::order]
        picture, scale = render(np.vstack([p for p, _ in parts]), np.vstack([c for _, c in parts]), 0, 90, 300)
        middle, corner = picture[picture.shape[0] // 2, 120], picture[30, 30]
        assert middle[2] > 150 > middle[0] and corner[0] > 150 > corner[2]
        assert 11 < scale < 12


def test_north_is_up_and_east_right() -> None:
    rng = np.random.default_rng(0)
    xyz = np.column_stack([rng.uniform(0, 10, 20_000), rng.uniform(0, 10, 20_000), np.zeros(20_000)])
    rgb = np.where((xyz[:, :1] > 7) & (xyz[:, 1:2] > 7), RED, BLUE).astype(np.uint8)
    picture, _ = render(xyz, rgb, 0, 90, 300)
    red = (picture[..., 0] > 120) & (picture[..., 2] < 80)
    rows, columns = np.nonzero(red)
    assert columns.mean() > 0.7 * picture.shape[1] and rows.mean() < 0.35 * picture.shape[0]


def test_edges_are_darker_than_surfaces() -> None:
    (low, low_rgb), (high, high_rgb) = plate(0, 10, RED), plate(2, 4, RED)
    picture, _ = render(np.vstack([low, high]), np.vstack([low_rgb, high_rgb]), 0, 90, 300)
    row = picture[picture.shape[0] // 2, :, 0].astype(int)
    assert row[25:55].mean() > 180 and row[20:220].min() < 150


def test_three_views_of_a_cloud_without_colour() -> None:
    xyz, _ = plate(1, 10, RED, 5000)
    xyz[0] = 1e6  # a stray point must not shrink the rest
    views = standard_views(xyz, np.zeros((len(xyz), 3), np.uint8), xyz[:5], 400)
    assert [v.name.split()[0] for v in views] == ["Top", "Oblique", "Oblique"]
    assert all(v.px_per_m > 10 for v in views) and all(v.rgb.std() > 1 for v in views)
    assert standard_views(xyz[:0], xyz[:0].astype(np.uint8), xyz[:0], 400) == []


def test_helpers() -> None:
    assert compass(0) == "the east" and compass(-90) == "the south" and compass(450) == "the north"
    diagonal = cloudview.main_axis_deg(np.array([[0, 0, 0], [5.0, 5, 0], [9, 9, 1]]))
    assert abs(diagonal % 180 - 45) < 1e-6
    colours = by_height(np.linspace(0, 5, 100))
    assert colours.shape == (100, 3) and not np.array_equal(colours[0], colours[-1])
    bar = with_scale_bar(CloudView("x", np.full((200, 400, 3), 247, np.uint8), 10.0), "m")
    assert (bar != 247).any() and bar.shape == (200, 400, 3)
