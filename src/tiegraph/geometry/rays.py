"""Rays: unit vectors in a camera's frame, and how far off epipolar planes they lie."""

import numpy as np


def unit_rays(plane: np.ndarray) -> np.ndarray:
    """(K, 3) unit vectors of places (K, 2) on the plane z = 1 in front of a camera; NaN stays."""
    rays = np.column_stack([plane, np.ones(len(plane))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def off_plane(way: np.ndarray, ray: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(K,) sine of the angle between a second ray and the epipolar plane of a first one and of the way to its camera.

    way, ray (K, 3): from the first centre to the second, and the first ray; normal (K, 3): first ray x second ray, both
    of unit length in the axes of ``way``.
    """
    across = np.maximum(np.linalg.norm(cross(way, ray), axis=1), 1e-12)
    return np.abs(np.sum(way * normal, axis=1)) / across


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Row-wise cross product (K, 3); several times faster than NumPy's."""
    out = np.empty(a.shape)
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


def normal_matrices(ray: np.ndarray, weight: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """(G, 3, 3) normal matrices of points that rays meet at: the sum of weight (I - ray rayT) over each point's rays.

    ray (K, 3) unit; weight (K,): one over the squared sigma across the ray, at the point; group (K,): the ray's point.
    The inverse is the point's covariance.
    """
    products = np.bincount(group, weight, groups)[:, None, None] * np.eye(3)
    for a in range(3):
        for b in range(a, 3):
            off = np.bincount(group, weight * ray[:, a] * ray[:, b], groups)
            products[:, a, b] -= off
            if a != b:
                products[:, b, a] -= off
    return np.asarray(products)
