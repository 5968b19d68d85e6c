"""Previews matched, for the stages network and design."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph import papers
from tiegraph.features.preview import Preview, PreviewMatch, match_previews
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning
from tiegraph.network.sections.light import LIGHTS, UpLight
from tiegraph.pipeline.files import load_scene, read_mask
from tiegraph.pipeline.preview import preview_path, read_preview
from tiegraph.project.run import Run
from tiegraph.scene.filecache import cached_by_file
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Ties

_CACHED_PREVIEWS = 512  # of about 110 kB each, in every worker; reading one costs a fifteenth of matching it


def with_previews(
    pairs: Pairs,
    ties: Ties,
    folder: Path,
    settings: PreviewSettings,
    tuning: PreviewTuning,
    run_map: Callable[..., list[Any]],
) -> tuple[Pairs, Ties, int]:
    """The pairs and ties after previews of every kept pair of which nothing is known, and how many these were.

    Pairs by order, by a pair list or of everybody with everybody come without previews: a method that chooses would
    choose blind. ``run_map``: map over a pool.
    """
    unknown = (pairs.dropped == 0) & np.isnan(pairs.score) & np.isnan(pairs.overlap)
    rows = np.flatnonzero(unknown & (ties.find(pairs.i, pairs.j) < 0))
    items = list(zip(pairs.i[rows].tolist(), pairs.j[rows].tolist()))
    found: list[PreviewMatch] = run_map(match_item, items, folder, settings, tuning)
    if not found:
        return pairs, ties, 0
    score = pairs.score.copy()
    score[rows] = [one.inliers for one in found]
    new = Ties.make(pairs.i[rows], pairs.j[rows], [one.matches for one in found])
    return pairs.with_(score=score), ties | new, len(rows)


def match_item(pair: tuple[int, int], folder: Path, settings: PreviewSettings, tuning: PreviewTuning) -> PreviewMatch:
    """The previews of two images matched."""
    scene = scene_of(folder)
    a, b = (scene.sensor_of(k).camera for k in pair)  # a guessed focal length serves as well
    one, other = (preview_of(folder, scene.names[k]) for k in pair)
    return match_previews(one, other, a, b, settings, tuning)


def up_light(run: Run, scene: Scene) -> UpLight:
    """What the up cameras show: by the way that ``network.sections`` names, else by the previews and the masks."""
    way = run.settings.network.sections
    papers.plug_in(papers.LIGHTS, way, LIGHTS)
    if way in LIGHTS:
        return LIGHTS[way](scene, run.path("images"), run.map)
    return UpLight(*np.array(run.map(_light_of, list(scene.names), run.folder)).reshape(-1, 2).T)


def _light_of(name: str, folder: Path) -> tuple[float, float]:
    """Mean grey of an image, and the share of an up camera's picture that its mask leaves out (sky)."""
    scene = scene_of(folder)
    up = scene.sensor_of(scene.image_index[name]).role == "up"
    return preview_of(folder, name).brightness, 1.0 - float(read_mask(folder, name).mean()) if up else float("nan")


@cached_by_file(2, lambda folder: folder / "scene.json")
def scene_of(folder: Path) -> Scene:
    """The scene of a run folder, as scanned."""
    return load_scene(folder / "scene.json")


@cached_by_file(_CACHED_PREVIEWS, preview_path)
def preview_of(folder: Path, name: str) -> Preview:
    """The preview of an image."""
    return read_preview(folder, name)
