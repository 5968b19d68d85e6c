"""The engines with arrays, on a rendered corridor with its truth."""

from __future__ import annotations

import base64

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tiegraph
from tiegraph import arrays
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.geometry import transforms
from worlds import Survey, make_survey


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    return make_survey(tmp_path_factory.mktemp("arrays"), passes=("up",), frames=6, size=(256, 192), seed=3)


def port(survey: Survey) -> tuple[list[str], list[np.ndarray]]:
    """The images of the camera that looks to port, RGB."""
    names = sorted(n for n in survey.cam_from_world if "/cam0/" in n)
    camera = survey.rig.sensors[0].camera
    return names, [survey.world.render(camera, survey.cam_from_world[n])[..., ::-1].copy() for n in names]


@pytest.mark.slow
def test_matches_are_those_of_the_true_poses(survey: Survey) -> None:
    names, images = port(survey)
    camera = survey.rig.sensors[0].camera
    a, b = arrays.features(images[0]), arrays.features(images[1])
    found = arrays.match(a, b, (camera, camera))
    assert 50 < len(found.inliers) <= len(found.tentative) and str(len(found.inliers)) in repr(found)
    relative = survey.cam_from_world[names[1]] @ transforms.invert(survey.cam_from_world[names[0]])
    turned = found.geometry.cam2_from_cam1.rotation.matrix() @ relative[:3, :3].T
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 1
    half = np.zeros(images[0].shape[:2], bool)
    half[:, :128] = True
    kept = arrays.features(images[0], half).keypoints
    assert 10 < len(kept) < len(a) and kept[:, 0].max() <= 128


@pytest.mark.slow
def test_neighbours_are_candidates(survey: Survey) -> None:
    _, images = port(survey)
    for ordered in (True, False):
        pairs = arrays.candidates(images, ordered=ordered, camera=survey.rig.sensors[0].camera)
        assert {(k, k + 1) for k in range(5)} <= set(zip(pairs.i.tolist(), pairs.j.tolist()))
    assert repr(pairs) == f"Pairs({len(pairs)} kept of {len(pairs)})" and "<td>used</td>" in pairs._repr_html_()
    names = tuple("abcdef")
    graph, rows = pairs.to_networkx(names), pairs.to_pandas(names)
    assert set(graph) == set(names) and graph.number_of_edges() == len(rows) == len(pairs)
    assert graph["a"]["b"]["score"] == rows.query("image1 == 'a' and image2 == 'b'").score.item()


@pytest.mark.slow
def test_depth_maps_and_their_cloud_lie_on_the_surface(survey: Survey) -> None:
    names, images = port(survey)
    camera = survey.rig.sensors[0].camera
    k = camera.calibration_matrix()
    use = np.ones(images[0].shape[:2], bool)
    views = [
        arrays.DenseView(n, image[..., ::-1].copy(), use, k, survey.cam_from_world[n])
        for n, image in zip(names, images)
    ]
    maps = [arrays.depth(views[m], [views[m - 1], views[m + 1]], 1.5, 12.0) for m in (1, 2)]
    for m, found in zip((1, 2), maps):
        true = survey.world.depth_m(camera, survey.cam_from_world[names[m]])
        off = np.abs(found.depth_m - true) / found.sigma_m
        known = np.isfinite(off)
        assert known.mean() > 0.4 and 0.1 < np.median(off[known]) < 1.5
    cloud = arrays.fuse_depth(maps, images[1:3])
    true = survey.world.depth_m(camera, survey.cam_from_world[names[1]])
    v, u = np.mgrid[:192, :256] + 0.5
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], axis=-1) * true[..., None]
    surface = transforms.apply(transforms.invert(survey.cam_from_world[names[1]]), rays[np.isfinite(true)])
    judged = arrays.compare_clouds(cloud, surface)
    assert 0.0005 < abs(judged.differences.summary()["spread m"]) < 0.1 and np.ptp(cloud.rgb) > 100
    assert f"{len(cloud)} points" in repr(cloud) and "% with a depth" in repr(maps[0])
    assert all('<img src="data:image/png;base64,' in shown._repr_html_() for shown in (cloud, *maps))
    moved = arrays.compare_clouds(cloud.xyz_m, surface + [0, 0.2, 0])
    assert 0.1 < abs(moved.differences.summary()["median m"] - judged.differences.summary()["median m"]) < 0.3


@pytest.mark.slow
def test_masks_are_learnt_from_the_images_of_a_camera(survey: Survey) -> None:
    _, images = port(survey)
    for image in images:
        image[160:, 64:192] = 40  # a platform that stands still in the image
    classes = arrays.learn_masks(images)
    assert [c.shape for c in classes] == [i.shape[:2] for i in images]
    assert all(0.5 < np.mean(c[:140] == 0) for c in classes)


@pytest.mark.slow
@pytest.mark.usefixtures("children_are_functions")
def test_a_model_of_arrays(survey: Survey) -> None:
    _, images = port(survey)
    model = arrays.reconstruct(images, pool="serial")
    assert model.num_reg_images() == 6 and sorted(i.name for i in model.images.values())[0] == "000000.png"
    shown = model._repr_html_()
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(shown.split("base64,")[1].split('"')[0]), np.uint8), 1)
    red, white = ((picture == colour).all(axis=2).sum() for colour in ((0, 0, 255), (255, 255, 255)))
    drawn = picture.shape[0] * picture.shape[1] - white - red
    assert 3 <= red <= 6 and 0.2 * model.num_points3D() < drawn <= model.num_points3D()
    assert f"num_points3D={model.num_points3D()}" in shown and "<img" not in tiegraph.Model()._repr_html_()


def measured(seed: int, times: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Poses of 16 cameras in a model and in the world, positions that err by ``times`` their sigmas, the sigmas."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (16, 3)) * [30, 20, 5]
    there = transforms.rigid(Rotation.random(16, random_state=seed).as_matrix(), places)
    turn = Rotation.from_euler("xyz", [0.6, 0.3, -1.0]).as_matrix()
    model = transforms.rigid(turn.T @ there[:, :3, :3], (places - [10, 20, 3]) @ turn / 2.5)
    sigma = np.tile([0.05, 0.05, 0.1], (16, 1))
    positions = places + times * sigma * rng.standard_normal((16, 3))
    return transforms.invert(model), transforms.invert(there), positions, sigma


@pytest.mark.slow
@pytest.mark.parametrize("times", [1.0, 3.0])
def test_errors_of_a_georeference_are_those_that_its_sigmas_say(times: float) -> None:
    ratios, scales = [], []
    for seed in range(4):
        model, there, positions, sigma = measured(seed, times)
        found = arrays.georeference(model, positions, sigma)
        off = transforms.centre(found.cam_from_world) - transforms.centre(there)
        ratios.append(np.sqrt(np.mean((off / found.sigma_m) ** 2)))
        scales.append((found.world_from_model.scale / 2.5 - 1) / found.error.sigmas()["scale"])
        assert np.abs(found.cam_from_world[:, :3, :3] - there[:, :3, :3]).max() < 0.02 * times
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 2 and 0.5 < np.sqrt(np.mean(np.square(scales))) < 2


@pytest.mark.slow
def test_wrong_and_unknown_positions_are_left_out() -> None:
    model, there, positions, sigma = measured(3)
    positions[0] += 5
    positions[1] = model[2] = np.nan
    found = arrays.georeference(model, positions, sigma[:, 0])
    assert not found.used[:3].any() and found.used.sum() >= 11
    assert np.isnan(found.residuals_m[1:3]).all() and np.isnan(found.sigma_m[2]).all()
    assert 4 < np.linalg.norm(found.residuals_m[0]) < 10
    off = transforms.centre(found.cam_from_world[3:]) - transforms.centre(there[3:])
    assert 0.001 < np.abs(off).max() < 0.15
    assert f"{found.used.sum()} of 14 used; sigmas: position_m 0.0" in repr(found)
    with pytest.raises(ReconstructionError, match="2 registered frames have a prior position, 3 are needed"):
        arrays.georeference(model[3:5], positions[3:5], 0.1)


def test_bad_arrays_are_named() -> None:
    for wrong, said in (
        ((np.eye(4), np.zeros((4, 3)), 1.0), r"got \(4, 4\) and \(4, 3\)"),
        ((np.tile(np.eye(4), (3, 1, 1)), np.zeros((3, 3)), np.ones(2)), r"sigmas \(2,\)"),
        ((np.tile(np.eye(4), (3, 1, 1)), np.zeros((3, 3)), 0.0), "above 0"),
    ):
        with pytest.raises(InputError, match=said):
            arrays.georeference(*wrong)
    with pytest.raises(InputError, match=r"\(4, 4, 2\) float64"):
        arrays.features(np.zeros((4, 4, 2)))
    with pytest.raises(InputError, match="no image"):
        arrays.candidates([])
    with pytest.raises(InputError, match="0 < near < far"):
        arrays.depth(None, [], 2.0, 1.0)  # type: ignore[arg-type]


def test_what_the_package_shows() -> None:
    assert set(dir(tiegraph)) == set(tiegraph.__all__) and "arrays" in dir(tiegraph)
    assert all(hasattr(tiegraph, name) for name in tiegraph.__all__)
    assert dir(arrays) == sorted(arrays.__all__) and all(hasattr(arrays, name) for name in arrays.__all__)
