"""OpenSfM's dataset: ``reconstruction.json`` in east, north, up about ``reference_lla.json``.

Its lengths count in the longer side of an image, its pixels from the middle of the image; a shot's rotation (an
angle-axis vector) and translation are those of camera_from_world.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.export.lens import FISHEYE
from tiegraph.export.survey import Survey, write_json, write_offset
from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.geometry.geodesy import ENU, Origin, geodetic_from_world, world_from_geodetic
from tiegraph.scene.colmapmodel import matrix, model_centres, sim3d

_STEP_M = 100.0  # between places that tell how the axes of the CRS lie: the Earth is flat to a millimetre there
_TERMS = {FISHEYE: ("k1", "k2", "k3", "k4"), "OPENCV": ("k1", "k2", "p1", "p2")}


def opensfm(survey: Survey, target: Path) -> int:
    """Write the reconstruction and its place on the Earth, if the world is there; the number of shots."""
    local_from_world, model = Similarity(), pycolmap.Reconstruction(survey.model)
    data: dict[str, Any] = {}
    if survey.origin is not None:
        local_from_world, place = _level(model_centres(model).mean(axis=0), survey.origin)
        model.transform(sim3d(local_from_world))
        data["reference_lla"] = {"latitude": place.lat_deg, "longitude": place.lon_deg, "altitude": place.height_m}
        write_json(target / "reference_lla.json", data["reference_lla"])
    data["cameras"] = {f"camera {key}": _camera(camera) for key, camera in sorted(model.cameras.items())}
    data["shots"] = {i.name: _shot(survey, model.image(i.image_id)) for i in survey.images()}
    points = sorted(model.points3D.items())
    data["points"] = {str(k): {"coordinates": p.xyz.tolist(), "color": p.color.tolist()} for k, p in points}
    write_json(target / "reconstruction.json", [data])
    write_json(target / "camera_models.json", data["cameras"])
    (target / "tracks.csv").write_text("\n".join(_tracks(survey, model)) + "\n", encoding="utf-8")
    write_offset(survey, target, local_from_world.inverse())
    return len(data["shots"])


def _tracks(survey: Survey, model: pycolmap.Reconstruction) -> Iterator[str]:
    """Lines of ``tracks.csv``, from which its dense matcher takes the range of depths: image, point, key point, x, y,
    size (not known here), colour, classes (none)."""
    yield "OPENSFM_TRACKS_VERSION_v2"
    for image in survey.images():
        camera = model.camera(image.camera_id)
        longer, middle = max(camera.width, camera.height), np.array([camera.width, camera.height]) / 2
        for number, point in enumerate(image.points2D):
            if point.has_point3D():
                x, y = (point.xy - middle) / longer
                colour = model.points3D[point.point3D_id].color
                yield "\t".join(map(str, (image.name, point.point3D_id, number, x, y, 1 / longer, *colour, -1, -1)))


def _level(middle: np.ndarray, origin: Origin) -> tuple[Similarity, Origin]:
    """From the world to east, north, up about a place of it (3,), by a rigid motion; and that place.

    The axes of a CRS are turned against these by the convergence of its meridians."""
    lat, lon, height = geodetic_from_world(middle[None], origin)[0]
    place = Origin(lat_deg=float(lat), lon_deg=float(lon), height_m=float(height), crs=ENU)
    around = middle + _STEP_M * np.concatenate([np.eye(3), -np.eye(3)])
    return umeyama(around, world_from_geodetic(geodetic_from_world(around, origin), place), with_scale=False), place


def _camera(camera: pycolmap.Camera) -> dict[str, Any]:
    fx, fy, cx, cy, *rest = (float(v) for v in camera.params)
    longer = max(camera.width, camera.height)
    return {
        "projection_type": "fisheye_opencv" if camera.model_name == FISHEYE else "brown",
        "width": camera.width,
        "height": camera.height,
        "focal_x": fx / longer,
        "focal_y": fy / longer,
        "c_x": (cx - camera.width / 2) / longer,
        "c_y": (cy - camera.height / 2) / longer,
        **dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), 0.0),
        **dict(zip(_TERMS.get(camera.model_name, ()), rest)),
    }


def _shot(survey: Survey, image: pycolmap.Image) -> dict[str, Any]:
    pose, time_s = matrix(image.cam_from_world()), survey.scene.time_s[survey.scene.frame[survey.index(image)]]
    shot: dict[str, Any] = {
        "rotation": Rotation.from_matrix(pose[:3, :3]).as_rotvec().tolist(),
        "translation": pose[:3, 3].tolist(),
        "camera": f"camera {image.camera_id}",
        "orientation": 1,
    }
    return shot if np.isnan(time_s) else {**shot, "capture_time": float(time_s)}
