"""From images to depth maps on a rendered corridor: errors, their prediction, coverage, masks, scale."""

import cv2
import numpy as np
import pycolmap
import pytest
from dense_world import render, true_model

from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.neighbours import plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.errors import SettingsError

pytestmark = pytest.mark.slow  # the world they share

SETTINGS = DenseSettings()
TUNING = Tuning()
NAMES = [f"up/cam0/{k:06d}.jpg" for k in (1, 2, 3)]


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return render(tmp_path_factory.mktemp("dense"))


@pytest.fixture(scope="module")
def model(survey):
    return true_model(survey)


@pytest.fixture(scope="module")
def made(survey, model):
    plan = plan_images(model, SETTINGS, TUNING.partners)
    names = [n for n in plan.images if "/cam0/" in n]
    first = {n: depth_map(plan.images[n], survey.images, None, SETTINGS, TUNING) for n in names}
    final = {n: confirmed_map(plan.images[n], first[n], first.get, SETTINGS, TUNING) for n in NAMES}
    return plan, first, final


def truth(survey, name):
    sensor = survey.rig.sensors[0]
    depth = survey.world.depth_m(sensor.camera, survey.cam_from_world[name])
    # Pixels on an edge have no single depth.
    low, high = cv2.erode(depth, np.ones((3, 3))), cv2.dilate(depth, np.ones((3, 3)))
    return np.where(high < 1.1 * np.minimum(low, 1e6), depth, np.nan)


def test_depth_errors_are_small_and_predicted(survey, made):
    _, _, final = made
    error = np.concatenate([((final[n][0].depth_m - truth(survey, n)) / truth(survey, n)).ravel() for n in NAMES])
    sigma = np.concatenate([(final[n][0].sigma_m / final[n][0].depth_m).ravel() for n in NAMES])
    known = np.isfinite(error)
    error, sigma = error[known], sigma[known]
    assert 0.0003 < np.median(np.abs(error)) < 0.006
    assert abs(np.median(error)) < 0.002
    assert np.mean(np.abs(error) > 0.05) < 0.02
    actual = np.median(np.abs(error)) * 1.4826
    assert 0.3 < np.median(sigma) / actual < 3


def test_sigma_holds_for_certain_and_uncertain_points_alike(survey, made):
    _, _, final = made
    error = np.concatenate([np.abs(final[n][0].depth_m - truth(survey, n)).ravel() for n in NAMES])
    sigma = np.concatenate([final[n][0].sigma_m.ravel() for n in NAMES])
    known = np.isfinite(error)
    error, sigma = error[known], sigma[known]
    for part in np.array_split(np.argsort(sigma), 3):
        assert 0.3 < 1.4826 * np.median(error[part]) / np.median(sigma[part]) < 3


def test_most_of_the_image_is_covered_by_three_views_or_all_there_are(made):
    _, first, final = made
    for name in NAMES:
        depth, counts = final[name]
        known = np.isfinite(depth.depth_m)
        assert 0.45 < known.mean() < 1
        assert depth.views[known].min() >= 2
        assert counts.two_rays == (depth.views == 2).sum()
        assert counts.two_rays < 0.5 * known.sum()  # five frames only: beside and ahead there is one neighbour
        assert (depth.views[~known] == 0).all()
        assert counts.before == np.isfinite(first[name].depth_m).sum()
        assert counts.before == counts.kept + counts.few_views + counts.seen_through


def test_points_that_two_images_alone_can_see_are_as_exact_as_predicted(survey, made):
    _, _, final = made
    error = np.concatenate([np.abs(final[n][0].depth_m - truth(survey, n))[final[n][0].views == 2] for n in NAMES])
    sigma = np.concatenate([final[n][0].sigma_m[final[n][0].views == 2] for n in NAMES])
    known = np.isfinite(error)
    assert known.sum() > 1000
    assert 0.3 < 1.4826 * np.median(error[known]) / np.median(sigma[known]) < 3
    assert np.mean(error[known] > 5 * sigma[known]) < 0.05


def test_confirmation_removes_errors(survey, made):
    _, first, final = made

    def bad(depth):
        return np.nanmean(np.abs(depth.depth_m / truth(survey, NAMES[1]) - 1)[np.isfinite(depth.depth_m)] > 0.05)

    assert bad(final[NAMES[1]][0]) < bad(first[NAMES[1]])


def test_normals_of_walls_face_the_camera(survey, made):
    depth = made[2][NAMES[1]][0]
    known = np.isfinite(depth.normal).all(axis=-1)
    world = depth.normal[known] @ depth.cam_from_world[:3, :3]
    # Everything in the corridor is a face of an axis-aligned box.
    assert np.median(np.abs(world).max(axis=1)) > 0.97
    height, width = depth.depth_m.shape
    v, u = np.nonzero(known)
    rays = np.c_[u + 0.5, v + 0.5, np.ones(len(u))] @ np.linalg.inv(depth.K).T
    assert (np.sum(rays * depth.normal[known], axis=1) < 0).mean() > 0.99


def test_masked_pixels_get_no_depth_and_give_none(survey, made, tmp_path):
    plan = made[0]
    name = NAMES[1]
    for view in (plan.images[name].view, *plan.images[name].partners):
        mask = np.full((192, 256), 255, np.uint8)
        mask[:, :128] = 0
        path = tmp_path / f"{view.name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)
    depth = depth_map(plan.images[name], survey.images, tmp_path, SETTINGS, TUNING)
    assert np.isnan(depth.depth_m[:, :128]).all()
    assert 0.2 < np.isfinite(depth.depth_m[:, 128:]).mean() < np.isfinite(made[1][name].depth_m[:, 128:]).mean()


def test_the_unit_of_length_does_not_matter(survey, model, made):
    scaled = pycolmap.Reconstruction(model)
    scaled.transform(pycolmap.Sim3d(0.001, pycolmap.Rotation3d(), np.array([5.0, 0, 0])))
    plan = plan_images(scaled, SETTINGS, TUNING.partners)
    name = NAMES[1]
    assert [v.name for v in plan.images[name].partners] == [v.name for v in made[0].images[name].partners]
    small = depth_map(plan.images[name], survey.images, None, SETTINGS, TUNING)
    both = np.isfinite(small.depth_m) & np.isfinite(made[1][name].depth_m)
    assert both.sum() > 0.95 * np.isfinite(made[1][name].depth_m).sum()
    ratio = small.depth_m[both] / made[1][name].depth_m[both]
    assert abs(np.median(ratio) / 0.001 - 1) < 1e-3


def test_plans_travel_to_workers(made):
    import pickle

    plan = made[0].images[NAMES[0]]
    again = pickle.loads(pickle.dumps(plan))
    assert again.view.camera == plan.view.camera
    assert len(pickle.dumps(plan)) < 10_000


def test_unknown_engine_is_refused():
    with pytest.raises(ValueError, match="engine"):
        DenseSettings(engine="magic")
    from tiegraph.dense.engine import ENGINES
    from tiegraph.errors import choose

    with pytest.raises(SettingsError, match="sgbm"):
        choose("dense engine", "sgm", ENGINES)
