"""Paper 002: weak pairs, similar images, minimum cuts; its accuracy of a pair: how far the bundle adjustment of its two
images moves the base.
"""

import numpy as np
import pycolmap

from boat_world import boat, photos
from tiegraph import papers
from tiegraph.design.design import METHODS, design
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.papers.fuse2014 import capacities, image_order, two_view
from tiegraph.scene.graph import components
from tiegraph.scene.pairs import Pairs
from tiegraph.sfm.tuning import TwoViewTuning

TUNING = Tuning()
for name in papers.DESIGNS:
    papers.plug_in(papers.DESIGNS, name, METHODS)


def video(count: int = 60, window: int = 6, seed: int = 0, **columns) -> Pairs:
    """Frames of a camera tied to the next ones, fewer matches over longer bases."""
    i = np.repeat(np.arange(count), window)
    j = i + np.tile(np.arange(1, window + 1), count)
    inside = j < count
    rng = np.random.default_rng(seed)
    score = 200.0 - 25 * (j - i) + rng.integers(0, 20, len(i))
    columns = {k: v[inside] for k, v in columns.items()}
    return Pairs.make(i[inside], j[inside], "sequence", score=score[inside], **columns)


def reasons(pairs: Pairs) -> dict[str, int]:
    return pairs.funnel()


def test_weak_pairs_go_first() -> None:
    pairs = video()
    pairs = pairs.with_(score=np.where(np.arange(len(pairs)) % 10 == 3, 24.0, pairs.score))
    pairs = pairs.with_(score=np.where(np.arange(len(pairs)) % 10 == 4, 25.0, pairs.score))  # "less than 25"
    weak = int(np.sum((pairs.score < 25) & (np.arange(len(pairs)) % 10 != 3)))
    found = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING)
    assert reasons(found.pairs)["weak"] == weak + np.sum(np.arange(len(pairs)) % 10 == 3) == found.counts["weak"]


def test_the_cuts_sever_the_video() -> None:
    pairs = video()
    found = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING)
    assert found.counts["pieces_before"] == 1
    assert 2 <= found.counts["pieces"] <= 7  # a part that was severed may hang together through its neighbours
    assert f"{int(found.counts['pieces'])} after" in found.notes[0]
    assert 6 <= found.counts["cut"] <= 6 * 21  # a complete severing of a window of six crosses 21 pairs


def test_each_of_five_parts_is_cut_from_its_first_to_its_last_image() -> None:
    pairs = video()
    kept = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING).pairs.kept()
    for part in np.array_split(np.arange(60), 5):
        inside = kept.where(np.isin(kept.i, part) & np.isin(kept.j, part))
        label = components(inside, 60)
        assert label[part[0]] != label[part[-1]] and len(inside) > 0


def test_the_safe_variant_keeps_it_together() -> None:
    pairs = video()
    found = design(pairs, photos(60), None, DesignSettings(method="fuse2014_safe"), TUNING)
    literal = design(pairs, photos(60), None, DesignSettings(method="fuse2014"), TUNING)
    assert found.counts["pieces"] == 1
    assert len(np.unique(components(found.pairs, 60))) == 1
    back = len(found.pairs.kept()) - len(literal.pairs.kept())
    assert 1 <= back <= literal.counts["pieces"]


def test_a_cut_takes_the_pairs_of_least_capacity() -> None:
    # two triangles on two weak pairs; the cuts of the parts (one or two images each) take what is between them
    i, j = np.array([0, 0, 1, 3, 3, 4, 2, 1]), np.array([1, 2, 2, 4, 5, 5, 3, 4])
    sigma = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 1.0, 1.0])
    pairs = Pairs.make(i, j, "file", score=np.full(8, 100.0), sigma_m=sigma)
    found = design(pairs, photos(6), None, DesignSettings(method="fuse2014"), TUNING).pairs
    dropped = {(int(a), int(b)) for a, b in zip(found.i[found.dropped != 0], found.j[found.dropped != 0])}
    assert {(2, 3), (1, 4)} <= dropped
    assert {(0, 2), (1, 2), (3, 4), (3, 5)} & dropped == set()


def test_a_way_that_turns_back_is_cut_too() -> None:
    pairs = Pairs.make([0, 1, 1], [2, 2, 3], "file", score=np.full(3, 100.0), sigma_m=np.array([0.1, 1.0, 0.1]))
    found = design(pairs, photos(4), None, DesignSettings(method="fuse2014"), TUNING).pairs
    assert [(int(a), int(b)) for a, b in zip(found.i[found.dropped != 0], found.j[found.dropped != 0])] == [(1, 2)]


def test_images_are_in_order_of_pass_step_and_camera() -> None:
    scene = boat((3, 3), (2.0, 2.0)).scene
    order = image_order(scene)
    frame = scene.frame[order]
    found = list(zip(scene.sequence[frame], scene.sequence_index[frame], scene.sensor_key[order]))
    assert found == sorted(found) and len({step for _, step, _ in found}) == 3 < len(scene)


def test_similar_images_lose_all_their_pairs() -> None:
    pairs = video(20, 3)
    ratio = np.full(len(pairs), 30.0)
    ratio[(pairs.i == 7) & (pairs.j == 8)] = 501.0
    ratio[(pairs.i == 14) & (pairs.j == 15)] = 500.0  # "more than 500"
    found = design(pairs.with_(h_over_b=ratio), photos(20), None, DesignSettings(method="fuse2014"), TUNING)
    touches = (pairs.i == 8) | (pairs.j == 8)
    assert found.counts["similar"] == np.sum(touches)
    assert np.all(found.pairs.dropped[touches] != 0)
    safe = design(pairs.with_(h_over_b=ratio), photos(20), None, DesignSettings(method="fuse2014_safe"), TUNING)
    assert np.sum(safe.pairs.dropped[touches] == 0) >= 1


def test_capacity_is_the_known_accuracy_else_matches_and_base() -> None:
    pairs = Pairs.make([0, 0, 1], [1, 2, 2], "file", sigma_m=np.array([0.1, 0.2, np.nan]))
    value = capacities(pairs, np.array([100.0, 100.0, 50.0]))
    assert np.allclose(value[:2], [100.0, 25.0])
    assert 10 < value[2] < 60
    by_base = capacities(pairs.with_(sigma_m=np.full(3, np.nan), h_over_b=np.array([10.0, 20, 10])), np.full(3, 80.0))
    assert np.allclose(by_base / by_base[0], [1, 0.25, 1])


CAMERA = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])


def matches(base: float, noise_px: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of 80 points 8 to 12 away, seen from two places ``base`` apart across the view."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-4, -3, 8), (4, 3, 12), (80, 3))
    second = transforms.rigid(np.eye(3), np.array([-base, 0, 0]))
    moved = xyz @ second[:3, :3].T + second[:3, 3]
    return tuple(np.asarray(CAMERA.img_from_cam(x)) + rng.normal(0, noise_px, (80, 2)) for x in (xyz, moved))  # type: ignore[return-value]


def test_good_matches_hardly_move_and_the_range_is_in_bases() -> None:
    found = two_view(*matches(2.0, 0.0), CAMERA, CAMERA, TwoViewTuning())
    assert found is not None
    assert found[0] < 1e-3 and 4.5 < found[1] < 6.0  # about 10.5 / 2


def test_noise_and_short_bases_move_more() -> None:
    def moved(base: float, noise: float) -> float:
        found = [two_view(*matches(base, noise, s), CAMERA, CAMERA, TwoViewTuning()) for s in range(7)]
        return float(np.median([f[0] for f in found if f is not None]))

    good, noisy, short = moved(2.0, 0.3), moved(2.0, 1.5), moved(0.3, 0.3)
    assert 1e-5 < good < noisy < 1.5 and good < short


def test_too_few_matches_give_nothing() -> None:
    a, b = matches(1.0, 0.2)
    assert two_view(a[:7], b[:7], CAMERA, CAMERA, TwoViewTuning()) is None
