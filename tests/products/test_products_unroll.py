"""Unrolled surfaces: a tunnel on a bend and a round tower, each with a bulge of 5 cm."""

import re
from dataclasses import replace

import numpy as np
import pytest

import curved_world as world
from curved_world import BELL_M, CHECK, MIDDLE, NOISE_M, PIXEL, SHIFT, Tower, Tunnel
from tiegraph.errors import ReconstructionError
from tiegraph.products import frame as curved
from tiegraph.products.frame import Frame
from tiegraph.products.heights import height_tile, margin
from tiegraph.products.ortho import Images, block_px, draw, gains, ortho_margin, ortho_tile, patch
from tiegraph.products.raster import Place
from tiegraph.products.settings import ProductsSettings
from tiegraph.products.surface import Window, choose
from tiegraph.products.tuning import ChooseTuning, HeightTuning, OrthoTuning

TUNING, HEIGHTS, ORTHO = ChooseTuning(), HeightTuning(), OrthoTuning()
SCENES = {"tunnel": Tunnel(), "wall": Tower()}
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found():
    """The surface and the notes of each."""
    made = {}
    for kind, scene in SCENES.items():
        (surface,), notes = choose(scene.survey(), ProductsSettings(unroll=kind, pixel_m=PIXEL), TUNING)
        made[kind] = surface, " ".join(notes)
    return made


def window_of(surface, scene, wide):
    """Of so many metres round the bulge."""
    u, v, _ = surface.frame.uvw(scene.rolled(*scene.at, 0.0)[None])[0]
    half = round(wide / PIXEL)
    row, column = round((surface.high[1] - v) / PIXEL) - half, round((u - surface.low[0]) / PIXEL) - half
    return Window(row, column, rows=2 * half, columns=2 * half)


def truth(surface, scene, window, step=1):
    """(rows, columns) each: w of the bulge over the fitted surface, s and v of the scene."""
    u, v = np.meshgrid(*surface.places(window, step))
    s, v, w = np.moveaxis(scene.unrolled(surface.frame.in_world(u, v, np.zeros_like(u))), -1, 0)
    return scene.bulge(s, v) - w, s, v


@pytest.mark.parametrize(("radius", "profile"), [(3.0, [1, 1]), (3.0, [0.9, 1.1, 1.0, 1.2, 0.9]), (np.inf, [1, 1])])
def test_the_inverse_of_a_curved_frame_and_its_gradients_are_those_of_the_mapping(radius, profile):
    angle = np.linspace(0, 4, 60)
    climb = 4.0 if radius < 9 else 0.0
    nodes = np.stack([20 * np.cos(angle), 20 * np.sin(angle), climb * angle], axis=-1)
    frame = Frame(np.eye(4), nodes, np.hypot(20, climb) * angle[1], radius, np.array(profile))
    rng = np.random.default_rng(0)
    uvw = rng.uniform([-1, -6, -0.5], [frame.stations[-1] + 1, 6, 1.0], (200, 3))
    np.testing.assert_allclose(frame.uvw(frame.in_world(*uvw.T)), uvw, atol=1e-6)
    uvw = uvw[(uvw[:, 0] > 4) & (uvw[:, 0] < frame.stations[-1] - 4)]
    xyz, step = frame.in_world(*uvw.T), 1e-4
    moved = [(frame.uvw(xyz + d * step) - frame.uvw(xyz - d * step)) / (2 * step) for d in np.eye(3)]
    found = frame.gradients(*uvw.T)
    off = np.abs(np.stack(moved, axis=-1) - found).max(axis=(0, 2))
    rolls = 0.05 if climb else 1e-3  # on a ramp that bends v rolls, and w where the profile is no circle
    assert off[0] < 1e-3 and off[2] < (rolls if len(set(profile)) > 1 else 1e-3) and off[1] < rolls
    assert (np.linalg.det(found) > 0).all()  # right-handed: no raster is mirrored


@pytest.mark.parametrize("kind", SCENES)
def test_the_reference_is_true_to_3_mm_and_does_not_follow_the_bulge(found, kind):
    (surface, notes), scene = found[kind], SCENES[kind]
    rng = np.random.default_rng(1)
    (s0, s1), (v0, v1) = scene.extent
    s, v = rng.uniform(s0 + 0.3, s1 - 0.3, 2000), rng.uniform(v0, v1, 2000)
    u, up, w = surface.frame.uvw(scene.rolled(s, v, np.zeros(2000))).T
    assert 1e-5 < np.abs(w).max() < 0.003 and f"{kind}" in notes and "chosen" not in notes
    assert np.abs(up - v - np.median(up - v)).max() < 0.005
    along = (u - s + s1 / 2) % s1  # u of the tower begins elsewhere
    assert np.ptp((along - np.median(along) + s1 / 2) % s1) < 0.2
    tags = Place(None).frame(surface)
    axis = np.array(tags["axis"])
    level = np.c_[axis[:, 1:], np.zeros(len(axis))][:, :3]
    again = Frame(np.eye(4), level, axis[1, 0], tags["radius"] or np.inf)  # by frame.json alone, as a user would
    np.testing.assert_allclose(again.uvw(surface.frame.in_world(u, up, w)), np.stack([u, up, w], 1), atol=1e-4)
    if kind == "tunnel":
        assert surface.frame.radius == pytest.approx(3.0, abs=0.002) and surface.offset[1] == 0
        assert "tunnel: radius 3 m" in notes
        assert surface.shape[0] * PIXEL == pytest.approx(2 * np.pi * 3, abs=0.05)
    else:
        assert surface.offset[1] == SHIFT[2] and np.median(up - v) == pytest.approx(MIDDLE[2], abs=1e-6)
        assert 25.0 < surface.shape[1] * PIXEL < 25.2 and (np.diff(np.sort(along)) >= 0).all()


@pytest.mark.parametrize("kind", SCENES)
def test_the_bulge_has_its_place_and_height_and_errors_are_those_that_sigma_states(found, kind):
    surface, scene = found[kind][0], SCENES[kind]
    window = window_of(surface, scene, 1.6)
    low, high = surface.box(window.grown(margin(HEIGHTS)))
    cloud = scene.cloud(0.012, noise=0.5 * NOISE_M, around=2.4)
    near = cloud.where(((cloud.xyz_m >= low) & (cloud.xyz_m <= high)).all(axis=1))
    w, sigma = height_tile(near, surface, window, HEIGHTS)
    right, s, v = truth(surface, scene, window)
    known, bulge = np.isfinite(w), scene.bulge(s, v)
    assert known.mean() > 0.98
    assert 0.5 < np.sqrt(np.mean(((w - right) / sigma)[known] ** 2)) < 2
    moves = [bulge * (at - x) / BELL_M**2 for x, at in zip(scene.at, (s, v))]
    shape = np.stack([bulge, *moves, np.ones_like(s)], axis=-1)[known]
    higher, *moved, _ = np.linalg.lstsq(shape, w[known], rcond=None)[0]
    assert higher == pytest.approx(1, abs=0.08) and 1e-5 < np.hypot(*moved) < 0.03  # of 5 cm; metres


@pytest.mark.parametrize("kind", SCENES)
def test_edges_of_the_orthophoto_are_within_a_pixel(found, kind):
    surface, scene = found[kind][0], SCENES[kind]
    window = window_of(surface, scene, 1.0)
    places = scene.path(301)
    nearest = np.linalg.norm(places - scene.rolled(*scene.at, 0.0), axis=1).argmin()
    centres = places[[max(0, nearest - 15), nearest, nearest + 15]]
    views = [world.look(f"{k}.jpg", p, scene.rolled(*scene.at, 0.0)) for k, p in enumerate(centres)]

    def heights(part, step=1):
        u, v = np.meshgrid(*surface.places(part, step))
        inside = (u > surface.low[0]) & (u < surface.high[0]) & (v > surface.low[1]) & (v < surface.high[1])
        return np.where(inside, truth(surface, scene, part, step)[0], np.nan).astype(np.float32)

    rgb = [scene.picture(view) for view in views]
    buffers = [draw(v, surface, heights, np.ones(v.size[::-1], bool), None, ORTHO) for v in views]
    patches = [patch(v, b, p, surface, heights, block_px(3), ORTHO) for v, b, p in zip(views, buffers, rgb)]
    images = Images(views, buffers.__getitem__, rgb.__getitem__, gains(patches))
    w = heights(window.grown(ortho_margin(ORTHO)))
    rgba, source = ortho_tile(surface, window, w, np.full(w.shape, NOISE_M), images, ORTHO)
    assert (source > 0).mean() > 0.98
    _, s, v = truth(surface, scene, window)
    for line, across, light in ((s, v, rgba[0].astype(float)), (v.T, s.T, rgba[0].T.astype(float))):
        edges = []
        for row in np.flatnonzero(np.abs(np.median(across, axis=1) / CHECK % 1 - 0.5) < 0.3):
            level = (light[row] - 60) / 140 - 0.5
            at = np.flatnonzero(np.diff(np.sign(level)) != 0)
            edges += list(line[row, at] + level[at] / (level[at] - level[at + 1]) * (line[row, at + 1] - line[row, at]))
        error = np.abs(np.array(edges) / CHECK - np.round(np.array(edges) / CHECK)) * CHECK / PIXEL
        assert len(edges) > 50 and 0.01 < np.percentile(error, 95) < 1.0


def test_a_flat_floor_does_not_move_the_axis():
    cloud = Tunnel().cloud(0.3)
    xyz = cloud.xyz_m.copy()
    xyz[:, 2] = np.maximum(xyz[:, 2], MIDDLE[2] - 2.0)
    ((frame, share),) = curved.tunnel(Tunnel().path(), replace(cloud, xyz_m=xyz), TUNING)
    assert frame.radius == pytest.approx(3.0, abs=0.01) and 0.6 < share < 0.9


def box(angle):
    """Distance of a box culvert, 5 m wide, from 2 m below its axis to 2.6 m above it."""
    x, y = np.sin(angle), np.cos(angle)
    return 1 / np.maximum(np.abs(x) / 2.5, np.maximum(y / 2.6, -y / 2.0))


def horseshoe(angle):
    """Distance of a tunnel of radius 3 m with a floor 2 m below its axis."""
    return np.minimum(3.0, np.where(np.cos(angle) < 0, 2.0 / np.maximum(-np.cos(angle), 1e-9), 3.0))


@pytest.mark.parametrize("shape", [box, horseshoe])
def test_the_profile_of_a_tube_that_is_no_circle_is_found_and_unrolled(shape):
    tube = Tunnel(bend=60.0, length=40.0)
    cloud = tube.cloud(0.25)
    s, v, w = tube.unrolled(cloud.xyz_m).T
    angle, bulge = v / tube.radius, tube.bulge(s, v)
    cloud = replace(cloud, xyz_m=tube.rolled(s, v, tube.radius - shape(angle) + w))
    ((circle, few),) = curved.tunnel(tube.path(), cloud, TUNING)
    survey = replace(tube.survey(), sample=cloud)
    (surface,), notes = choose(survey, ProductsSettings(unroll="profile", pixel_m=PIXEL), TUNING)
    assert surface.share > 0.97 > few + 0.2
    assert re.search(r"profile: radius (1\.9|2\.)\d+ to 3\.\d+ m", " ".join(notes))
    tags = Place(None).frame(surface)
    axis, profile = np.array(tags["axis"]), np.array(tags["profile"]) / tags["radius"]
    frame = Frame(np.eye(4), axis[:, 1:], axis[1, 0], tags["radius"], profile)  # by frame.json alone, as a user would
    u, along, off = frame.uvw(cloud.xyz_m).T
    assert 0.5 * NOISE_M < np.median(np.abs(off - bulge)) < 1.2 * NOISE_M
    on = bulge > 0.6 * world.BULGE_M
    assert np.median(off[on] / bulge[on]) == pytest.approx(1, abs=0.25)
    turn = np.linspace(-np.pi, np.pi, 9999)
    length = np.hypot(*np.diff(shape(turn) * [np.sin(turn), np.cos(turn)])).sum()
    assert surface.shape[0] * PIXEL == pytest.approx(length, rel=0.01)
    np.testing.assert_allclose(frame.in_world(u, along, off), cloud.xyz_m, atol=1e-6)


def test_a_wall_along_a_path_that_does_not_go_round_ends_where_its_points_do():
    bank = Tower(radius=30.0, high=3.0)
    cloud = bank.cloud(0.4)
    behind = replace(cloud, normal=-cloud.normal).where(np.arange(0, len(cloud), 3))  # as seen from the other side
    both = type(cloud).concatenate([cloud, behind])
    ((frame, share),) = curved.walls(bank.path(turns=0.4), both.where(bank.unrolled(both.xyz_m)[:, 0] < 80), TUNING)
    w = frame.uvw(bank.rolled(np.linspace(1, 79, 99), np.ones(99), np.zeros(99)))[:, 2]
    assert np.abs(w).max() < 0.005 and 0.7 < share < 0.8 and frame.stations[-1] == pytest.approx(80, abs=0.3)


ROUND, CLOUD, FEW = Tunnel(), Tunnel().cloud(0.3), Tunnel().cloud(0.9)
TIGHT, LOOP = Tunnel(bend=3.8, length=11.0), Tunnel(bend=12.0, length=95.0)


@pytest.mark.parametrize(
    ("path", "cloud", "said"),
    [
        (ROUND.path()[:2], CLOUD, "extends over 1.* and the surface is .* away from it; a longer path is needed"),
        (np.repeat(ROUND.path()[:1], 50, axis=0), CLOUD, "extends over 0"),
        (np.r_[ROUND.path(), ROUND.path()[::-1] + 0.5], CLOUD, "comes back to itself.*a folder of its own"),
        (TIGHT.path(), TIGHT.cloud(0.2), "bends with a radius of .*would overlap itself"),
        (LOOP.path(99), LOOP.cloud(0.5), "comes back to itself"),
        (ROUND.path(), replace(FEW, xyz_m=FEW.xyz_m + np.random.default_rng(0).normal(0, 4, (len(FEW), 3))),
         "of the points, not more than 10%"),
    ],
    ids=["too short", "no motion", "there and back", "a tight bend", "a ring", "no tube"],
)  # fmt: skip
def test_what_cannot_be_unrolled_says_why_and_what_to_do(path, cloud, said):
    with pytest.raises(ReconstructionError, match=f"nothing can be unrolled: .*{said}.*leave out products.unroll"):
        curved.tunnel(path, cloud, TUNING)


def test_where_no_wall_stands_beside_the_path_says_so():
    tower = Tower().cloud(0.3)
    with pytest.raises(ReconstructionError, match="neither side of the path has a wall with 10%"):
        curved.walls(Tower().path(), replace(tower, normal=-tower.normal), TUNING)
