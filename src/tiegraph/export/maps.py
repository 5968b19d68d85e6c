"""Maps for GIS: cameras, what they see in plan, and the tie graph; GeoJSON in WGS84, GeoPackage in the CRS with styles.

A GeoPackage is written by GDAL (pyogrio) from the same features.
"""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from numpy.linalg import norm

from tiegraph.errors import InputError
from tiegraph.export.survey import Survey
from tiegraph.geometry.geodesy import ENU, Origin, crs_coordinates, geodetic_from_world, parse_crs
from tiegraph.geometry.transforms import invert
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.vectors import Layer, collection, feature, gdal, style, write_layer, write_styles

FILE = "survey.gpkg"
_BLUE = "27,108,168,255"
STYLES = {
    "cameras": style(
        "SimpleMarker",
        1.0,
        {"name": "arrow", "color": _BLUE, "outline_color": "255,255,255,255", "size": "4", "size_unit": "MM"},
        by=("angle", "&quot;heading_deg&quot;"),
    ),
    "views": style(
        "SimpleFill",
        0.5,
        {"color": "27,108,168,20", "outline_color": _BLUE, "outline_width": "0.15", "outline_width_unit": "MM"},
    ),
    "ties": style(
        "SimpleLine",
        0.6,
        {"line_color": "242,166,90,255", "line_width": "0.3", "line_width_unit": "MM"},
        by=("outlineWidth", "min(1.5, 0.1 + &quot;matches&quot; / 400.0)"),
    ),
}


def geojson(survey: Survey, target: Path) -> int:
    """``cameras.geojson``, ``views.geojson``, ``ties.geojson``, in degrees and metres above the ellipsoid; the number
    of cameras. Raises InputError for a world that is not on the Earth."""
    origin = _on_earth(survey)
    layers = _layers(survey, lambda xyz: _degrees(xyz, origin))
    for name, features in layers.items():
        (target / f"{name}.geojson").write_text(collection(features), encoding="utf-8")
    return len(layers["cameras"])


def gpkg(survey: Survey, target: Path) -> int:
    """``survey.gpkg`` with the same layers in the CRS (a world without one: in degrees), and their styles; the number
    of cameras. Raises EngineMissing without pyogrio, InputError for a world that is not on the Earth."""
    origin = _on_earth(survey)
    raw = gdal("--to gpkg", "--to geojson needs nothing")
    free = origin.crs.upper() == ENU
    layers = _layers(survey, lambda xyz: _degrees(xyz, origin) if free else crs_coordinates(xyz, origin))
    crs = "EPSG:4979" if free else parse_crs(origin.crs).to_wkt()
    path = target / FILE
    for name, features in layers.items():
        if features:
            write_layer(raw, path, name, features, crs)
    write_styles(raw, path, {name: STYLES[name] for name, features in layers.items() if features})
    return len(layers["cameras"])


def _on_earth(survey: Survey) -> Origin:
    if survey.origin is None:
        text = "the world is not on the Earth, and a map needs that: give positions (--gnss) or control points (--gcp)"
        raise InputError(text)
    return survey.origin


def _degrees(xyz: np.ndarray, origin: Origin) -> np.ndarray:
    """(N, 3) longitude, latitude, height of world metres (N, 3), to a tenth of a millimetre."""
    lat, lon, height = geodetic_from_world(xyz, origin).T
    return np.round(np.stack([lon, lat, height], axis=-1), 9)


def _layers(survey: Survey, placed: Callable[[np.ndarray], np.ndarray]) -> dict[str, Layer]:
    """Features by layer; ``placed`` takes world metres (N, 3) to the coordinates of the map."""
    scene, images, cameras, views = survey.scene, survey.images(), [], []
    centres = np.array([i.projection_center() for i in images]).reshape(-1, 3)
    sigmas = np.full(len(images), np.nan) if survey.error is None else norm(survey.error.sigma(centres), axis=1)
    for image, centre, place, sigma in zip(images, centres, placed(centres), sigmas):
        index = survey.index(image)
        frame = int(scene.frame[index])
        pose = invert(matrix(image.cam_from_world()))
        east, north, up = pose[:3, 2]
        number = int(scene.sequence[frame])
        said = {
            "name": image.name,
            "camera": scene.sensor_of(index).name,
            "pass": scene.sequences[number] if number >= 0 else None,
            "frame": frame,
            "time_s": _number(scene.time_s[frame], 6),
            "sigma_m": _number(sigma, 4),
            "heading_deg": _number(np.degrees(np.arctan2(east, north)) % 360, 3),
            "pitch_deg": _number(np.degrees(np.arcsin(np.clip(up, -1, 1))), 3),
            "points": image.num_points3D,
        }
        cameras.append(feature("Point", place, said))
        seen = np.array([survey.model.points3D[p.point3D_id].xyz for p in image.get_observation_points2D()])
        if len(seen):
            away = float(np.median((seen - centre) @ pose[:3, 2]))
            ring = placed(
                _outline(survey.model.cameras[image.camera_id], pose, away, norm(seen - centre, axis=1).max())
            )
            views.append(feature("Polygon", ring[None], {"name": image.name, "distance_m": _number(away, 3)}))
    at = {survey.names.get(i.name, i.name): c for i, c in zip(images, placed(centres))}
    known = [(a, b, n) for a, b, n in survey.ties if a in at and b in at]
    ties = [feature("LineString", np.stack([at[a], at[b]]), {"a": a, "b": b, "matches": n}) for a, b, n in known]
    return {"ties": ties, "views": views, "cameras": cameras}


def _outline(camera: pycolmap.Camera, pose: np.ndarray, away: float, most: float) -> np.ndarray:
    """What a camera with its pose (4, 4) in the world sees in plan, (N, 3) a closed ring of world metres: the hull of
    its centre and of the image's corners ``away`` along the optical axis, but at most ``most`` from the centre."""
    width, height = camera.width, camera.height
    corners = np.array([[0.0, 0.0], [width, 0], [width, height], [0, height]])
    rays = np.asarray(camera.cam_from_img(corners), float)
    rays = np.column_stack([rays, np.ones(4)])[np.isfinite(rays).all(axis=1)]
    rays *= np.minimum(away, most / norm(rays, axis=1, keepdims=True))
    xyz = np.vstack([np.zeros(3), rays]) @ pose[:3, :3].T + pose[:3, 3]
    ring = cv2.convexHull((xyz[:, :2] - pose[:2, 3]).astype(np.float32), returnPoints=False)[::-1, 0]
    return xyz[np.r_[ring, ring[0]]]


def _number(value: float, digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None
