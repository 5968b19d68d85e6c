"""Open Photogrammetry Format 1.0 (Pix4D's specification): a project with its cameras, their poses and its tracks.

Cameras look along -z with y up; the angles omega, phi, kappa are of R_x R_y R_z from the camera to the world. Inside a
rig cameras look along z with y down. Pixels count from the corner of the first one. The world is the "canonical" frame,
to which ``base_to_canonical`` leads from the CRS by the shift (and by exchanging axes that the CRS calls north and
east). Tracks are glTF about their middle.
"""

import hashlib
import itertools
import json
import uuid
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import PIL.Image
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.__version__ import __version__
from tiegraph.export.survey import Survey, write_json, write_offset
from tiegraph.geometry.geodesy import ENU, Origin, parse_crs
from tiegraph.geometry.transforms import invert
from tiegraph.scene import gltf
from tiegraph.scene.colmapmodel import matrix

FILE = "project.opf"
_TRACKS = "tracks"
_AXES = np.diag([1.0, -1.0, -1.0, 1.0])  # of a camera
_NO_TIME = "1970-01-01T00:00:00"  # the format asks for a time; without a zone
_UNKNOWN = 1.0  # micrometres of a pixel, pixels of a feature: the format asks for both


def opf(survey: Survey, target: Path) -> int:
    """``project.opf`` and what it names; the number of images."""
    images = survey.images()
    files = {
        "scene_reference_frame": ("scene-reference-frame", _frame(survey.origin, survey.unit)),
        "camera_list": (
            "camera-list",
            {"cameras": [{"id": _id(i.name), "uri": quote(f"images/{i.name}")} for i in images]},
        ),
        "input_cameras": ("input-cameras", _inputs(survey, images, target)),
        "calibration": ("calibrated-cameras", _calibrated(survey, images)),
    }
    needs = {"input_cameras": ("camera_list",), "calibration": ("input_cameras", "scene_reference_frame")}
    items: list[dict[str, Any]] = []
    for kind, (name, data) in files.items():
        form = {"format": f"application/opf-{name}+json"}
        write_json(target / f"{name}.json", {**form, "version": "1.0", **data})
        sources = [{"id": _uuid(other), "type": other} for other in needs.get(kind, ())]
        items.append({"id": _uuid(kind), "type": kind, "resources": [{"uri": f"{name}.json", **form}]})
        items[-1]["sources"] = sources
    if survey.model.points3D:
        _write_tracks(survey.model, target)
        items[-1]["resources"] += [
            {"uri": f"{_TRACKS}.gltf", "format": "model/gltf+json"},
            {"uri": f"{_TRACKS}.bin", "format": "application/gltf-buffer+bin"},
        ]
    project = {"format": "application/opf-project+json", "version": "1.0", "id": _uuid("project"), "name": "tiegraph",
               "description": "", "generator": {"name": "tiegraph", "version": __version__}}  # fmt: skip
    write_json(target / FILE, {**project, "items": items})
    write_offset(survey, target)
    return len(images)


def _id(name: str) -> int:
    """The number of 64 bits of what has a name."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "big")


def _uuid(name: str) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"tiegraph {name}"))


def _frame(origin: Origin | None, unit: str) -> dict:
    shift, swap = (0.0, 0.0, 0.0) if origin is None else origin.shift_m, False
    if origin is None or origin.crs == ENU:
        length = 'LENGTHUNIT["metre",1]' if unit == "m" else 'LENGTHUNIT["unknown",1]'
        axes = ",".join(f'AXIS["{name}",{name}]' for name in ("east", "north", "up"))
        definition = f'ENGCRS["Survey",EDATUM["Survey"],CS[Cartesian,3],{axes},{length}]'
    else:
        crs = parse_crs(origin.crs)
        definition, swap = crs.to_wkt(), crs.axis_info[0].direction.lower() == "north"
    away = [-float(v) for v in shift]
    return {
        "crs": {"definition": definition},
        "base_to_canonical": {"scale": [1.0, 1.0, 1.0], "shift": away, "swap_xy": swap},
    }


def _captures(survey: Survey, images: Sequence[pycolmap.Image]) -> list[list[pycolmap.Image]]:
    """The images of each frame, that of the rig's reference first; images of a frame without it stand alone."""
    out = []
    for frame, own in itertools.groupby(sorted(images, key=lambda i: (i.frame_id, i.name)), key=lambda i: i.frame_id):
        reference = survey.model.rig(survey.model.frame(frame).rig_id).ref_sensor_id.id
        group = sorted(own, key=lambda i: i.camera_id != reference)
        out += [group] if group[0].camera_id == reference else [[image] for image in group]
    return out


def _inputs(survey: Survey, images: Sequence[pycolmap.Image], target: Path) -> dict:
    depth, sensors = {}, []
    for key, first in {image.camera_id: image for image in reversed(images)}.items():
        with PIL.Image.open(target / "images" / first.name) as picture:
            bands, most = picture.getbands(), 65535 if picture.mode.startswith("I") else 255
        depth[key] = {"pixel_type": "uint8" if most == 255 else "uint16", "pixel_range": {"min": 0, "max": most}}
        camera = survey.model.camera(key)
        sensors.append({
            "id": key,
            "name": survey.scene.sensor_of(survey.index(first)).name,
            "bands": [{"name": band, "weight": 1 / len(bands)} for band in bands],
            "image_size_px": [camera.width, camera.height],
            "pixel_size_um": _UNKNOWN,
            "internals": _internals(camera),
            "shutter_type": "global",
        })  # fmt: skip
    captures = []
    for group in _captures(survey, images):
        time_s = survey.scene.time_s[survey.scene.frame[survey.index(group[0])]]
        captures.append({
            "id": _id(f"capture {group[0].name}"),
            "reference_camera_id": _id(group[0].name),
            "rig_model_source": "user" if len(group) > 1 else "not_applicable",
            "time": _NO_TIME if np.isnan(time_s) else datetime.fromtimestamp(time_s, timezone.utc).isoformat(),
            "cameras": [{"id": _id(i.name), "sensor_id": i.camera_id, "model_source": "user", **depth[i.camera_id]}
                        for i in group],
        })  # fmt: skip
    return {"sensors": sorted(sensors, key=lambda s: s["id"]), "captures": captures}


def _internals(camera: pycolmap.Camera) -> dict:
    k1, k2, p1, p2 = [*map(float, camera.params[4:]), *[0.0] * 4][:4]  # a pinhole has none
    return {
        "type": "perspective",
        "principal_point_px": [camera.principal_point_x, camera.principal_point_y],
        "focal_length_px": camera.mean_focal_length(),
        "radial_distortion": [k1, k2, 0.0],
        "tangential_distortion": [p1, p2],
    }


def _calibrated(survey: Survey, images: Sequence[pycolmap.Image]) -> dict:
    poses = {image.name: invert(matrix(image.cam_from_world())) for image in images}
    beside: dict[int, dict] = {}
    for first, *rest in _captures(survey, images):
        for image in rest:
            relative = invert(poses[first.name]) @ poses[image.name]
            said = {"translation": relative[:3, 3].tolist(), "rotation_angles_deg": _angles(relative)}
            beside.setdefault(image.camera_id, {"rig_relatives": said})
    return {
        "sensors": [
            {"id": key, "internals": _internals(survey.model.camera(key)), **beside.get(key, {})}
            for key in sorted({image.camera_id for image in images})
        ],
        "cameras": [
            {
                "id": _id(image.name),
                "sensor_id": image.camera_id,
                "position": poses[image.name][:3, 3].tolist(),
                "orientation_deg": _angles(poses[image.name] @ _AXES),
            }
            for image in images
        ],
    }


def _angles(pose: np.ndarray) -> list[float]:
    """The angles of R_x R_y R_z in degrees."""
    return Rotation.from_matrix(pose[:3, :3]).as_euler("XYZ", degrees=True).tolist()


def _write_tracks(model: pycolmap.Reconstruction, target: Path) -> None:
    """The points of the model with their colours and where images see them."""
    points = [model.points3D[k] for k in sorted(model.points3D)]
    count = np.array([len(p.track.elements) for p in points])
    seen = [(model.image(e.image_id), e.point2D_idx) for p in points for e in p.track.elements]
    camera = {image.image_id: k for k, image in enumerate({i.image_id: i for i, _ in seen}.values())}
    xyz, rgb = np.array([p.xyz for p in points]), np.array([p.color for p in points], np.uint8)
    middle = (xyz.min(axis=0) + xyz.max(axis=0)) / 2
    ranges = (np.cumsum(count) - count).astype("<u8") | (count.astype("<u8") << np.uint64(40))  # 40 and 24 bits
    arrays = gltf.Arrays()
    attributes = {
        "POSITION": arrays.places((xyz - middle).astype("<f4")),
        "COLOR_0": arrays.add(np.column_stack([rgb, np.full(len(rgb), 255, np.uint8)]), normalized=True),
    }
    matches = {
        "cameraUids": [_id(model.image(k).name) for k in camera],
        "cameraIds": arrays.add(np.array([camera[i.image_id] for i, _ in seen], "<u4")),
        "pointIndexRanges": arrays.add(ranges.view("<u4").reshape(-1, 2)),
        "imagePoints": {
            "pixelCoordinates": arrays.add(np.array([i.points2D[n].xy for i, n in seen], "<f4")),
            "featureIds": arrays.add(np.array([(n, 0) for _, n in seen], "<u4")),
            "scales": arrays.add(np.full(len(seen), _UNKNOWN, "<f4")),
        },
    }
    primitive = {
        "attributes": attributes,
        "mode": 0,
        "material": 0,
        "extensions": {"OPF_mesh_primitive_matches": matches},
    }
    said = gltf.document([primitive], middle.tolist(), extensions={"OPF_asset_version": {"version": "1.0"}})
    said["extensionsUsed"] += ["OPF_asset_version", "OPF_mesh_primitive_matches"]
    said |= {"extensionsRequired": ["KHR_materials_unlit"], "materials": [gltf.unlit()]}
    (target / f"{_TRACKS}.gltf").write_text(
        json.dumps({**said, **arrays.described(f"{_TRACKS}.bin")}), encoding="utf-8"
    )
    (target / f"{_TRACKS}.bin").write_bytes(b"".join(arrays.blobs))
