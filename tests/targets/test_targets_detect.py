"""Targets in rendered images against where the true camera projects their middles, and what is said of odd ones."""

import numpy as np
import pytest

from calibrate.board_world import OVERSAMPLING, Renderer, Texture, camera
from targets.targets_world import PLACES, picture, printed, table
from tiegraph.geometry import transforms
from tiegraph.scene.targets import Target, count_of, target_of
from tiegraph.targets.detect import centre_of, find_targets
from tiegraph.targets.marks import likely_family, marks_of
from tiegraph.targets.tuning import Tuning

TUNING = Tuning()
FAMILY = "apriltag_36h11"


def test_names_of_targets_and_of_none():
    assert target_of("tag36h11:12") == target_of("DICT_APRILTAG_36h11: 12") == Target(FAMILY, 12)
    assert target_of("AprilTag 36h11:012") == Target(FAMILY, 12) and Target(FAMILY, 12).name == "tag36h11:12"
    assert target_of("4x4_50:7") == target_of("aruco_4X4_50:7") == Target("4x4_50", 7)
    assert target_of("mip_36h12:1") == Target("aruco_mip_36h12", 1) and target_of("original:1") is not None
    for name in ("P1", "GCP:3", "tag36h12:4", "tag36h11", "36:12", "tag36h11:-1"):
        assert target_of(name) is None, name
    assert count_of("4x4_50") == 50 and count_of(FAMILY) == 587


@pytest.mark.slow
def test_middles_are_found_to_hundredths_of_a_pixel_and_their_sigma_says_so():
    world, off, sigmas = table(4), [], []
    for k in range(4):
        seen = find_targets(picture(world, k, world.places), [FAMILY], TUNING)
        assert [s.target.name for s in seen] == sorted(PLACES, key=lambda n: int(n[9:]))
        for one in seen:
            there = np.ravel(world.camera.img_from_cam(transforms.apply(world.poses[k], world.places[one.target.name])))
            off.append(centre_of(one.corners, world.camera) - there)
            sigmas.append(one.sigma_px / np.sqrt(2))
    rms = float(np.sqrt(np.mean(np.square(off))))
    assert 0.005 < rms < 0.06
    assert 0.5 < rms / np.median(sigmas) < 2, "the sigma is that of the errors"
    assert np.abs(np.mean(off, axis=0)).max() < 0.03


@pytest.mark.slow
def test_the_middle_of_a_large_target_is_free_of_the_lens():
    lens = camera("OPENCV", [500, 500, 320, 240, -0.3, 0.08, 0, 0], (640, 480))
    tag = printed("tag36h11:5")
    per_metre = len(tag) / 0.2
    place = np.array([[per_metre, 0, (len(tag) - 1) / 2], [0, per_metre, (len(tag) - 1) / 2], [0, 0, 1]])
    render, known, crossing = Renderer(lens, Texture(tag, place)), [], []
    assert OVERSAMPLING >= 2
    for x, y in ((-0.22, -0.13), (0.23, -0.12), (0.22, 0.14)):
        pose = transforms.rigid(np.eye(3), np.array([x, y, 0.5]))
        (one,) = find_targets(render(pose, 1.0, np.random.default_rng(0)), [FAMILY], TUNING)
        true = np.ravel(lens.img_from_cam(pose[:3, 3]))
        known.append(np.linalg.norm(centre_of(one.corners, lens) - true))
        crossing.append(np.linalg.norm(centre_of(one.corners, None) - true))
    assert 0.005 < max(known) < 0.15 < 0.3 < min(crossing)


def test_a_target_printed_twice_is_not_used_and_what_is_missing_is_said():
    world = table(3)
    twice = {**world.places, "tag36h11:3#2": np.array([0.0, -0.25, 0.0])}
    pictures = [picture(world, 0, twice), picture(world, 1, world.places), picture(world, 2, {})]
    seen = {k: find_targets(p, [FAMILY], TUNING) for k, p in enumerate(pictures)}
    named = {n: target_of(n) for n in ("tag36h11:3", "tag36h11:7", "tag36h11:99")}
    found = marks_of(seen, named, lambda k: world.camera, world.names)
    assert {(m.name, m.image) for m in found.marks} == {("tag36h11:7", 0), ("tag36h11:7", 1)}
    said = "; ".join(found.notes)
    assert "target tag36h11:3 is seen at two places of 000.png: printed twice? It is not used" in said
    assert "target tag36h11:99 is seen in none of 3 images" in said
    assert "not named in the file: tag36h11:12 (2 images), tag36h11:20 (2 images), tag36h11:31 (2 images)" in said
    seven = {"tag36h11:7": named["tag36h11:7"]}
    alone = marks_of({0: seen[1]}, seven, lambda k: None, world.names).notes[0]
    assert alone == "target tag36h11:7 is seen in one image only, 000.png: two are needed for a place"


def test_the_family_that_is_there_is_told():
    world = table(1)
    seen = find_targets(picture(world, 0, world.places), [FAMILY, "apriltag_25h9"], TUNING)
    assert likely_family(seen) == "tag36h11 (seen 5 times)"
    small = find_targets(picture(world, 0, {f"4x4_50:{k}": p for k, p in enumerate(world.places.values())}),
                         ["4x4_1000"], TUNING)  # fmt: skip
    assert likely_family(small).startswith("4x4_50 ") and likely_family([]) == ""
