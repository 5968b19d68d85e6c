"""Glue of watch: previews of new images, the pairs that their order proposes, their matches, and poses by them."""

from pathlib import Path

import numpy as np

from tiegraph.features.preview import extract_preview, match_previews
from tiegraph.network.passes import MatchCache, find_passes, loose_images
from tiegraph.network.sources import Context, sequence
from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.resect import resect
from tiegraph.odometry.tuning import PoseTuning
from tiegraph.pipeline.files import read_image, save_npz
from tiegraph.pipeline.preview import preview_path
from tiegraph.pipeline.previews import preview_of
from tiegraph.project.settings import Settings
from tiegraph.scan.scan import prepare_image
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.watch.tuning import FramesTuning

_PREPARED = "images"  # only while their preview is made


def make_preview(scene: Scene, image: int, source: Path, folder: Path, settings: Settings) -> None:
    """The preview of an image into the run folder. Raises InputError for a file that can no longer be read."""
    name = scene.names[image]
    prepared = folder / _PREPARED / name
    prepare_image(source, prepared, scene.sensor_of(image), settings.scan)
    try:
        made = extract_preview(read_image(prepared), None, settings.preview, settings.tuning.features)
    finally:
        prepared.unlink(missing_ok=True)
    save_npz(preview_path(folder, name), **made.to_npz())


def neighbours(scene: Scene, steps: int, settings: Settings) -> np.ndarray:
    """(P, 2) pairs i < j by order: in passes of the own and neighbouring cameras, of loose photographs by name."""
    asked = settings.candidates.model_copy(update={"sequence_frames": steps, "sequence_cameras": True})
    nothing = MatchCache(lambda pairs: [], len(scene))
    context = Context(scene, find_passes(scene), nothing, settings=asked, tuning=settings.tuning.network)
    pairs = sequence(context).pairs
    loose = loose_images(scene)
    by_name = [np.column_stack([loose[:-step], loose[step:]]) for step in range(1, steps + 1)]
    return np.concatenate([np.column_stack([pairs.i, pairs.j]), *by_name]).astype(int)


def matched(pairs: np.ndarray, scene: Scene, folder: Path, settings: Settings) -> PreviewMatches:
    """The preview matches of image pairs (P, 2), i < j."""
    found = []
    for a, b in pairs.tolist():
        previews = preview_of(folder, scene.names[a]), preview_of(folder, scene.names[b])
        cameras = scene.sensor_of(a).camera, scene.sensor_of(b).camera
        how = settings.preview, settings.tuning.features.preview
        found.append(match_previews(*previews, *cameras, *how).matches)
    return PreviewMatches.make(pairs[:, 0], pairs[:, 1], found)


def resect_previews(
    rig: Rig, sensor: np.ndarray, xy: np.ndarray, points: np.ndarray, size_px: int, tuning: FramesTuning
) -> np.ndarray | None:
    """rig_from_world (4, 4) by the odometry's resection, with the precision of previews of ``size_px``; None if there
    is none. sensor (K,), xy (K, 2) full pixels, points (K, 3)."""
    known = {
        k: (s.name, s.camera, s.sensor_from_rig)
        for k, s in enumerate(rig.sensors)
        if s.camera is not None and s.sensor_from_rig is not None
    }
    use = np.isin(sensor, list(known))
    if not use.any():
        return None
    names, models, mounted = zip(*known.values())
    reduced = max(1.0, max(np.sqrt(c.width * c.height / 0.75) for c in models) / size_px)  # as extract_preview
    limit = tuning.inlier_small_px * reduced
    asked = PoseTuning(inlier_px=limit, first_px=4 * limit, least_points=tuning.least_points)
    camera = np.searchsorted(list(known), sensor[use])
    found = resect(Cameras(names, models, np.stack(mounted)), camera, xy[use], points[use], None, asked)
    return None if found is None else found.rig_from_world
