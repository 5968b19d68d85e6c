"""The map of the surface: who sees it, under which angles, how precisely, and where to go again."""

import numpy as np
import pytest

from tiegraph.design.surface import VERDICTS, CoveredSurface, surface_map, weak_places
from tiegraph.design.tuning import SurfaceTuning
from tiegraph.scene.matches import Visibility

TUNING = SurfaceTuning()
FOCAL = 1000.0


def sees(xyz, centres, which):
    """Visibility of points by images; which (N, P) bool."""
    start = np.concatenate([[0], np.cumsum(which.sum(axis=1))])
    return Visibility(start=start, point=np.nonzero(which)[1], xyz=np.asarray(xyz, float), centre=centres)


def wall(width=20.0, seed=0):
    """Points on the wall y = 10."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0, width, 4000), np.full(4000, 10.0), rng.uniform(0, 4, 4000)])


def row(x):
    return np.column_stack([x, np.zeros(len(x)), np.full(len(x), 2.0)])


def test_two_images_measure_a_point_as_well_as_the_normal_case_says():
    xyz, base = wall(0.5), 1.0
    centres = row(np.array([-base / 2, base / 2]) + 0.25)
    found = surface_map(sees(xyz, centres, np.ones((2, len(xyz)), bool)), np.full(2, FOCAL), TUNING)
    near = np.argmin(np.abs(found.xyz[:, 2] - 2))
    depth = 10.0**2 / (base * FOCAL) * np.sqrt(2) * TUNING.image_px  # the normal case of stereo
    assert found.sigma[near] == pytest.approx(depth, rel=0.01)
    assert found.angle_deg[near] == pytest.approx(2 * np.degrees(np.arctan(0.05)), rel=0.02)
    assert np.all(found.images == 2)


def test_more_images_are_more_precise():
    xyz = wall(0.5)
    sigma = []
    for count in (3, 12):
        centres = row(np.linspace(-2, 2, count))
        seen = sees(xyz, centres, np.ones((count, len(xyz)), bool))
        sigma.append(np.median(surface_map(seen, np.full(count, FOCAL), TUNING).sigma))
    assert 1.2 < sigma[0] / sigma[1] < 2.0


def test_each_part_of_a_wall_gets_its_verdict():
    """Seen from the left: by many, by two, by one, and by many that stand in one place."""
    xyz = wall()
    centres = np.concatenate([row(np.linspace(0, 5, 6)), row(np.array([7.0, 9.0])), row(np.array([12.0])),
                              row(np.full(5, 17.5) + np.arange(5) * 0.02)])  # fmt: skip
    part = np.floor(xyz[:, 0] / 5).astype(int)
    owner = np.repeat([0, 1, 2, 3], [6, 2, 1, 5])
    found = surface_map(sees(xyz, centres, owner[:, None] == part), np.full(len(centres), FOCAL), TUNING)
    for number, verdict in enumerate(("well covered", "few images", "one image", "narrow angle")):
        inside = (found.xyz[:, 0] > 5 * number + 1) & (found.xyz[:, 0] < 5 * number + 4)
        assert inside.sum() > 5
        assert {VERDICTS[k] for k in found.verdict[inside]} == {verdict}
    assert sum(found.shares().values()) == pytest.approx(100)
    places = weak_places(found)
    weak = np.concatenate([p.cells for p in places])
    assert np.all(found.verdict[weak] > 0) and len(np.unique(weak)) == len(weak)
    assert all(4 < p.xyz[0] < 21 for p in places)
    table = CoveredSurface(found, places, [f"{k}.jpg" for k in range(len(centres))]).table()
    assert [len(r) for r in table["rows"]] == [len(table["columns"])] * len(places)
    assert int(table["rows"][0][1].removesuffix(".jpg")) >= 6


def test_the_two_faces_of_a_wall_are_covered_apart():
    """Five images on one side, one on the other: not six views at 150 degrees."""
    front = wall(3.0)
    back = front + [0, 0.02, 0]  # in the same box
    xyz = np.concatenate([front, back])
    centres = np.concatenate([row(np.linspace(0, 3, 5)), [[1.5, 20.02, 2.0]]])
    which = np.zeros((6, len(xyz)), bool)
    which[:5, : len(front)] = which[5, len(front) :] = True
    found = surface_map(sees(xyz, centres, which), np.full(6, FOCAL), TUNING)
    assert set(found.images.tolist()) == {5, 1}
    assert found.angle_deg.max() < 30
    assert np.all(np.isinf(found.sigma[found.images == 1]))
    assert np.all(np.isfinite(found.sigma[found.images == 5]))


def test_what_is_not_known_does_not_count():
    xyz = wall(3.0)
    centres = row(np.linspace(0, 3, 5))
    centres[4] = np.nan
    seen = sees(xyz, centres, np.ones((5, len(xyz)), bool))
    focal = np.array([FOCAL, FOCAL, FOCAL, np.nan, FOCAL])
    assert set(surface_map(seen, focal, TUNING).images.tolist()) == {3}
    nothing = surface_map(sees(xyz, centres, np.zeros((5, len(xyz)), bool)), focal, TUNING)
    assert len(nothing) == 0 and weak_places(nothing) == ()
