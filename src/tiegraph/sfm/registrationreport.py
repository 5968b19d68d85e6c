"""Images that a reconstruction lost, with the reasons, as tables and remarks; why there is no model at all."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapdatabase import Rows, image_ids
from tiegraph.scene.colmapmodel import BY_RIG, Registration, tracks
from tiegraph.scene.graph import WeaklyTied, named, weakly_tied
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import evenly
from tiegraph.sfm.tuning import MappingTuning, Tuning
from tiegraph.sfm.verified import ViewGraph
from tiegraph.text import some

_NAMED = 5  # frames or groups named in a remark
_PAIRS, _MATCHES, _LEAST = 200, 50, 3  # pairs tested, matches of a pair, fewest pairs for a verdict
_ANY = np.geomspace(0.35, 3.0, 28)  # focal lengths as shares of the longer side: views of 110 to 19 degrees
_NEAR = np.geomspace(1 / 1.3, 1.3, 8)  # factors on a focal length from EXIF or a file


def unregistered(
    scene: Scene, graph: ViewGraph, registered: Sequence[np.ndarray], left_out: Mapping[str, str]
) -> list[tuple[str, str]]:
    """(image name, reason) of each image that is not in the first model.

    ``registered`` holds the scene indices of each model's images, the first model first; ``left_out``: by image
    name, why an image was left out.
    """
    main = np.zeros(len(scene), bool)
    main[registered[0]] = True
    home = graph.component[registered[0]]
    home = home[home >= 0]
    component = np.bincount(home).argmax() if len(home) else -1
    other: dict[int, int] = {}
    for number in range(len(registered) - 1, 0, -1):
        other.update({int(k): number for k in registered[number]})
    out = []
    for k in np.flatnonzero(~main):
        if scene.names[k] in left_out:
            reason = left_out[scene.names[k]]
        elif graph.features[k] == 0:
            reason = "no features (masked, blank or unreadable)"
        elif graph.degree[k] == 0:
            reason = "no verified pair"
        elif int(k) in other:
            reason = f"in model {other[int(k)]}, not joined to the first"
        elif graph.component[k] != component:
            reason = "in another connected part of the view graph, without a model of its own"
        else:
            reason = (
                f"{graph.degree[k]} verified pairs, but neither the mapper nor its matches gave it a reliable place"
            )
        out.append((scene.names[k], reason))
    return out


def weakly_constrained(
    scene: Scene, graph: ViewGraph, found: Registration, weak: Sequence[WeaklyTied], enough: int
) -> list[str]:
    """Sentences on images that have a place in a model but little evidence for it. ``weak``: see ``few_points``."""
    return [*_by_rig(scene, found), *_on_few_points(scene, weak, enough), *_islands(scene, graph, found)]


def few_points(
    model: pycolmap.Reconstruction, scene: Scene, found: Registration, enough: int
) -> tuple[WeaklyTied, ...]:
    """Frames, and groups of frames, that share so few points of a model with all others that the sigma of the others
    does not apply to them. Points seen by two images only do not count: their rays meet at any distance between the
    images."""
    xyz, image, point = tracks(model, scene)
    several = np.bincount(point, minlength=len(xyz))[point] > 2
    image, point = image[several], point[several]
    there = np.zeros(scene.frames, bool)
    there[scene.frame[found.placed]] = True
    return weakly_tied(point, scene.frame[image], there, enough)


def _by_rig(scene: Scene, found: Registration) -> list[str]:
    only = np.flatnonzero(found.by_rig)
    if not len(only):
        return []
    return [
        f"{len(only)} images see fewer than {found.min_points} points of the model: they are not registered; their "
        f"rig or those few points place them ({_named(scene, only)})"
    ]


def _on_few_points(scene: Scene, weak: Sequence[WeaklyTied], enough: int) -> list[str]:
    if not weak:
        return []
    count = sum(len(group.frames) for group in weak)
    said = some([f"{named(group, scene.frame_names)}: {group.points}" for group in weak], _NAMED)
    return [
        f"the place of {count} frame{'s' if count > 1 else ''} rests on fewer than {enough} points that other frames "
        f"see ({said}): the images are blurred or hardly overlap, and their errors may be larger than stated"
    ]


def _islands(scene: Scene, graph: ViewGraph, found: Registration) -> list[str]:
    """Images of one camera and pass that verified pairs tie only to each other: from another place, or behind a gap."""
    out = []
    size = np.bincount(graph.component[graph.component >= 0], minlength=1)
    several = np.array([len(r.sensors) > 1 for r in scene.rigs])[scene.rig[scene.frame]]
    asked = found.registered & (graph.component >= 0) & several
    track = scene.sequence[scene.frame]
    for key in np.unique(np.stack([track, scene.sensor], axis=1)[asked], axis=0):
        own = asked & (track == key[0]) & (scene.sensor == key[1])
        labels, count = np.unique(graph.component[own], return_counts=True)
        for label in labels[(count == size[labels]) & (count < size[labels].max(initial=0))]:
            images = np.flatnonzero(own & (graph.component == label))
            out.append(
                f"{len(images)} images ({_named(scene, images)}) share no verified pair with the rest of their "
                "camera's pass, nor with another camera: only the rig places them, and no match confirms that they "
                "belong there"
            )
    return out


def _named(scene: Scene, images: np.ndarray) -> str:
    return ", ".join(scene.names[int(k)] for k in images[:3]) + (" ..." if len(images) > 3 else "")


def no_model_text(scene: Scene, graph: ViewGraph, why: str) -> str:
    """Counts and remedies for a reconstruction that gave no model."""
    with_features = int(np.sum(graph.features > 0))
    components, usual = graph.components, int(np.median(graph.inliers)) if len(graph.inliers) else 0
    return (
        f"no model: {why}. Of {len(scene)} images {with_features} have features; {len(graph.pairs)} pairs are verified "
        f"with {int(graph.inliers.sum())} matches in all (median {usual} a pair), the largest "
        f"connected part holds {components[0] if components else 0} images. Remedies: look whether images overlap and "
        f"the masks leave enough of them, match more pairs (candidates.sources = exhaustive for a small set), raise "
        f"features.max_features, lower sparse.min_matches"
    )


def camera_notes(reconstruction: pycolmap.Reconstruction, scene: Scene, tuning: Tuning) -> list[str]:
    """Remarks on cameras whose adjusted parameters are impossible for a lens: the model is bent there."""
    names = {k + 1: s.name for k, s in enumerate(scene.all_sensors)}
    notes = []
    for camera_id in sorted({reconstruction.image(i).camera_id for i in reconstruction.reg_image_ids()}):
        camera = reconstruction.camera(camera_id)
        size = max(camera.width, camera.height)
        ratio = camera.mean_focal_length() / size
        off = _moved_px(camera, scene.all_sensors[camera_id - 1].camera) / size
        label = names.get(camera_id, str(camera_id))
        if not tuning.adjust.focal_range[0] <= ratio <= tuning.adjust.focal_range[1]:
            notes.append(
                f"camera {label}: focal length {camera.mean_focal_length():.0f} px is {ratio:.2f} x the image size; "
                "do not trust the model around it; give the calibration and set sparse.refine_intrinsics = no"
            )
        if off > tuning.adjust.max_centre_shift:
            notes.append(
                f"camera {label}: the principal point is {off:.0%} of the image size away from where it was given, or "
                "from the middle of the image"
            )
    return notes


def rig_doubts(
    reconstruction: pycolmap.Reconstruction, scene: Scene, held: Sequence[int], placed: int, tied: int, tuning: Tuning
) -> list[str]:
    """Contradictions between the images and rigs (scene indices) whose extrinsics were held as given.

    Extrinsics that contradict the images leave most of these without a place (``placed`` of ``tied``). Where the lens
    is free, they appear as an impossible principal point instead: both shift the image of a camera as a whole.
    """
    notes, remedy = [], "check order, axes and angles in the rig file, or set sparse.rig = refined or absent"
    names = ", ".join(scene.rigs[k].name for k in held)
    if held and placed < tuning.mapping.clearly_fewer * tied:
        notes.append(
            f"rig {names} was held as given, and only {placed} of {tied} images with ties could be placed: the given "
            f"extrinsics may contradict the images; {remedy}"
        )
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        for key, sensor in enumerate(rig.sensors, start=first + 1):
            turned = _turned_deg(reconstruction.cameras, key, sensor.camera) if index in held else 0.0
            if turned > tuning.mapping.max_turned_deg:
                notes.append(
                    f"camera {sensor.name}: its principal point moved by as much as a rotation of {turned:.1f} deg, "
                    f"while rig {rig.name} was held as given: the extrinsics may contradict the images; {remedy}"
                )
    return notes


def _turned_deg(cameras: Any, key: int, given: pycolmap.Camera | None) -> float:
    """The angle of a camera's principal point from the given one, or from the middle if none is given."""
    if key not in cameras:
        return 0.0
    return float(np.degrees(np.arctan(_moved_px(cameras[key], given) / cameras[key].mean_focal_length())))


def _moved_px(camera: pycolmap.Camera, given: pycolmap.Camera | None) -> float:
    """The distance of a camera's principal point from the given one, or from the middle if none is given."""
    x, y = (camera.width / 2, camera.height / 2)
    if given is not None:
        x, y = given.principal_point_x, given.principal_point_y
    return float(np.hypot(camera.principal_point_x - x, camera.principal_point_y - y))


def models_table(models: Sequence[Any]) -> dict:
    """Table of the models (``mapper.Model``), most images first."""
    rows = [
        [k, m.registered, len(m.images) - m.registered, m.frames, m.points, round(m.reprojection_px, 3),
         round(m.track_length, 2)]
        for k, m in enumerate(models)
    ]  # fmt: skip
    columns = ["model", "registered", BY_RIG, "frames", "points", "reprojection px", "track length"]
    return {"columns": columns, "rows": rows}


def ran_off(model: pycolmap.Reconstruction, scene: Scene, most: float) -> str | None:
    """A text on the first camera whose focal length is more than ``most`` times longer or shorter than the given one;
    None if there is none."""
    for key, sensor in enumerate(scene.all_sensors, start=1):
        given = sensor.camera
        if given is None or not given.has_prior_focal_length or key not in model.cameras:
            continue
        found_px, given_px = model.cameras[key].mean_focal_length(), given.mean_focal_length()
        if not 1 / most < found_px / given_px < most:
            return (
                f"focal length of {sensor.name}: the images make it {found_px:.0f} px, but {given_px:.0f} px are given"
            )
    return None


def no_base(database: Path, pairs: np.ndarray, scene: Scene, tuning: MappingTuning) -> str:
    """Why none of the verified pairs (P, 2), scene indices, gives depth, in words; "" if some do, or if the cameras
    of a rig are apart.

    A pure rotation with a wrong focal length looks like a translation: points on a sphere, cameras on a circle, sigmas
    of a thousandth. So the pairs are tested, with one focal length for all, whether rotations alone explain them
    (Hartley and Zisserman, 13.3: x' = K R K^-1 x).
    """
    own = pairs[scene.sensor[pairs[:, 0]] == scene.sensor[pairs[:, 1]]]
    if len(own) < _LEAST or any(len(r.sensors) > 1 and not r.stitched() for r in scene.rigs):
        return ""
    ids = image_ids(database, scene)
    with Rows(database) as rows:
        cameras = rows.cameras()
        looked = [(ids[a], ids[b]) for a, b in own[evenly(len(own), _PAIRS)].tolist()]
        xy = np.stack([_parts_of_side(rows, cameras, pair) for pair in looked])
    given = cameras[looked[0][0]]
    focal = given.mean_focal_length() / max(given.width, given.height)
    tried = focal * _NEAR if given.has_prior_focal_length else _ANY
    off, turn_deg = (np.stack(part) for part in zip(*(_turned(xy, f) for f in tried)))
    best = int(np.argmin(np.median(off, axis=1)))
    fits = off[best] < tuning.turned_off
    if fits.mean() < tuning.turned_share:
        return ""
    which = f"{int(fits.sum())} of {len(fits)} pairs"
    if tried[best] * np.median(np.radians(turn_deg[best])) < tuning.turned_off:  # a rotation without visible motion
        return (
            f"nothing moves between the images in {which}: most matches are on parts that do not move relative to the "
            "camera, such as the background behind a turntable or a window in front of the lens: mask them "
            "(masks.folder), or take the photographs in front of a plain background"
        )
    return (
        f"the camera rotated on the spot: a rotation alone explains {which} (focal length {tried[best]:.2f} times the "
        "longer side of the image); without a base there is no depth: take the photographs from different places"
    )


def _parts_of_side(rows: Rows, cameras: Mapping[int, pycolmap.Camera], pair: tuple[int, int]) -> np.ndarray:
    """(2, _MATCHES, 2) key points of a pair from the middle of their images, as shares of the longer side."""
    matches = rows.verified_of(*pair)
    some = matches[np.linspace(0, len(matches) - 1, _MATCHES).round().astype(int)]
    sizes = [np.array([cameras[k].width, cameras[k].height]) for k in pair]
    return np.stack([(rows.keypoints_of(k)[m] - s / 2) / s.max() for k, m, s in zip(pair, some.T, sizes)])


def _turned(xy: np.ndarray, focal: float) -> tuple[np.ndarray, np.ndarray]:
    """(P,) medians of the residuals of pure rotations for key points (P, 2, M, 2), and (P,) degrees of these
    rotations."""
    rays = np.concatenate([xy, np.full((*xy.shape[:3], 1), focal)], axis=3)
    rays /= np.linalg.norm(rays, axis=3, keepdims=True)
    weight = np.ones(rays.shape[:1] + rays.shape[2:3])
    off, turn = weight, np.eye(3)
    for _ in range(3):  # robust by repeated weighting
        u, _, vt = np.linalg.svd(np.einsum("pmi,pm,pmj->pij", rays[:, 1], weight, rays[:, 0]))
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        turn = u @ vt
        seen = rays[:, 0] @ turn.transpose(0, 2, 1)
        off = np.linalg.norm(focal * seen[..., :2] / seen[..., 2:] - xy[:, 1], axis=2)
        weight = 1 / np.maximum(off, 1e-3)
    return np.median(off, axis=1), transforms.angle_deg(turn, np.eye(3))
