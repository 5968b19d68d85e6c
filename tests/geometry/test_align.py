import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.geometry.align import Similarity, robust_umeyama, umeyama


def world(seed=0, n=40):
    rng = np.random.default_rng(seed)
    truth = Similarity(2.5, Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3) * 10)
    source = rng.normal(size=(n, 3)) * 5
    return truth, source, rng


def test_exact_recovery_with_and_without_scale():
    truth, source, _ = world()
    fit = umeyama(source, truth(source))
    assert abs(fit.scale - 2.5) < 1e-12
    np.testing.assert_allclose(fit.matrix, truth.matrix, atol=1e-9)
    rigid = umeyama(source, Similarity(1.0, truth.rotation, truth.translation)(source), with_scale=False)
    np.testing.assert_allclose(rigid.rotation, truth.rotation, atol=1e-9)
    assert rigid.scale == 1.0


def test_never_a_mirror():
    rng = np.random.default_rng(1)
    source = rng.normal(size=(10, 3))
    fit = umeyama(source, source * [1, 1, -1])
    assert np.linalg.det(fit.rotation) > 0.99


def test_robust_fit_ignores_gross_errors_and_is_as_good_as_its_noise():
    truth, source, rng = world(3, 60)
    target = truth(source) + rng.normal(size=source.shape) * 0.1
    target[:15] += rng.normal(size=(15, 3)) * 30
    fit, inliers = robust_umeyama(source, target, 0.2)
    assert inliers[:15].sum() <= 1 and inliers[15:].sum() >= 42
    error = np.linalg.norm(fit(source) - truth(source), axis=1)
    assert 1e-3 < np.sqrt(np.mean(error**2)) < 0.1
    plain = np.linalg.norm(umeyama(source, target)(source) - truth(source), axis=1)
    assert np.mean(plain) > 10 * np.mean(error)


def test_too_few_points():
    with pytest.raises(ValueError, match="at least 3 points, got 2"):
        umeyama(np.zeros((2, 3)), np.zeros((2, 3)))
