"""Glue of preview: SIFT of the reduced images; and their matches, for the stages candidates, coarse and design."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph import papers
from tiegraph.features.preview import Preview, PreviewMatch, extract_preview, match_previews
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning, Tuning
from tiegraph.network.sections import LIGHTS, UpLight
from tiegraph.pipeline.files import load_as, load_scene, read_image, read_mask, save_npz, scanned
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.regular import cached_by_file
from tiegraph.scene.scene import Scene


def preview(run: Run) -> Outcome:
    """Low-resolution features and brightness of every image, under its mask."""
    scene, settings, tuning = scanned(run), run.settings.preview, run.settings.tuning.features
    run.make_missing(_preview_item, scene.names, lambda n: preview_path(run.folder, n), run.folder, settings, tuning)
    dim = dim_images(run.folder, scene.names, tuning)
    said = () if not dim else (
        f"{len(dim)} of {len(scene)} images show little contrast, {np.median(list(dim.values())):.1f} grey levels in "
        "the median (most in daylight show 20 and more): it is equalised before feature extraction",
    )  # fmt: skip
    return Outcome({"images": len(scene)}, notes=said)


def dim_images(folder: Path, names: Iterable[str], tuning: Tuning) -> dict[str, float]:
    """Contrast, grey levels, of those of the images that show too little of it."""
    shown = {name: read_preview(folder, name).contrast for name in names}
    return {name: value for name, value in shown.items() if value < tuning.contrast.enough}


def preview_path(folder: Path, name: str) -> Path:
    """The file of an image's preview."""
    return folder / "preview" / f"{name}.npz"


def read_preview(folder: Path, name: str) -> Preview:
    """The preview of an image. Raises UnreadableArtefact."""
    return load_as(preview_path(folder, name), Preview.from_npz)


def _preview_item(name: str, folder: Path, settings: PreviewSettings, tuning: Tuning) -> None:
    found = extract_preview(read_image(folder / "images" / name), read_mask(folder, name), settings, tuning)
    save_npz(preview_path(folder, name), **found.to_npz())


_CHUNK = 2000  # previews, after which the matches are stored: a second to some ten of work


def with_previews(
    pairs: Pairs,
    ties: PreviewMatches,
    folder: Path,
    settings: PreviewSettings,
    tuning: PreviewTuning,
    run_map: Callable[..., list[Any]],
) -> tuple[Pairs, PreviewMatches, int]:
    """The pairs and ties after previews of every kept pair without known ties, and the number of these previews.

    Pairs by order, by a pair list or exhaustive ones come without previews: a method that chooses would
    choose blindly. ``run_map``: map over a pool.
    """
    unknown = (pairs.dropped == 0) & np.isnan(pairs.score) & np.isnan(pairs.overlap)
    rows = np.flatnonzero(unknown & (ties.find(pairs.i, pairs.j) < 0))
    if not len(rows):
        return pairs, ties, 0
    new = previews_of(pairs.where(rows), folder, settings, tuning, run_map)
    score = pairs.score.copy()
    score[rows] = new.known(pairs.i[rows], pairs.j[rows])
    return pairs.with_(score=score), ties | new, len(rows)


def previews_of(
    pairs: Pairs,
    folder: Path,
    settings: PreviewSettings,
    tuning: PreviewTuning,
    run_map: Callable[..., list[Any]],
) -> PreviewMatches:
    """The matches of the previews of all pairs."""
    items = list(zip(pairs.i.tolist(), pairs.j.tolist()))
    found: list[PreviewMatch] = run_map(match_item, items, folder, settings, tuning)
    return PreviewMatches.make(pairs.i, pairs.j, [one.matches for one in found])


class Matcher:
    """Matches previews over the pool. Finished matches are kept below the run folder until the stage is done, so that a
    killed stage continues there."""

    def __init__(self, run: Run, folder: str) -> None:
        self._run, self._folder = run, run.path(folder)
        self._chunks, self._asked = 0, 0
        self._before: dict[tuple[int, int], PreviewMatch] = {}
        for path in sorted(self._folder.glob("*.npz")):
            self._before.update(load_as(path, _from_arrays))
            self._chunks = int(path.stem)

    def __call__(self, pairs: np.ndarray) -> list[PreviewMatch]:
        """The matches of image pairs (P, 2)."""
        asked = [(int(i), int(j)) for i, j in pairs]
        todo = [pair for pair in asked if pair not in self._before]
        self._asked += len(asked)
        self._run.reporter.total(self._asked, self._asked - len(todo))
        made: dict[tuple[int, int], PreviewMatch] = {}
        settings, tuning = self._run.settings.preview, self._run.settings.tuning.features.preview
        for first in range(0, len(todo), _CHUNK):
            part = todo[first : first + _CHUNK]
            found = dict(zip(part, self._run.map(match_item, part, self._run.folder, settings, tuning)))
            self._chunks += 1
            save_npz(self._folder / f"{self._chunks:06d}.npz", **_to_arrays(found))
            made |= found
        return [made.get(pair) or self._before[pair] for pair in asked]


def _to_arrays(made: dict[tuple[int, int], PreviewMatch]) -> dict[str, np.ndarray]:
    found = list(made.values())
    nowhere, still = np.full((3, 3), np.nan), np.full(2, np.nan)
    return {
        "pairs": np.array(list(made), np.int32).reshape(-1, 2),
        "inliers": np.array([one.inliers for one in found], np.int32),
        "rotation": np.array([nowhere if one.rotation is None else one.rotation for one in found]).reshape(-1, 3, 3),
        "shift": np.array([still if one.shift is None else one.shift for one in found], np.float64).reshape(-1, 2),
        "ends": np.cumsum([len(one.matches) for one in found]).astype(np.int64),
        "matches": np.concatenate([np.zeros((0, 2), np.uint16), *[one.matches for one in found]]),
    }


def _from_arrays(data: dict[str, np.ndarray]) -> dict[tuple[int, int], PreviewMatch]:
    """Inverse of ``_to_arrays``."""
    matches = np.split(data["matches"], data["ends"][:-1])
    out = {}
    for k, (i, j) in enumerate(data["pairs"].tolist()):
        rotation, shift = data["rotation"][k], data["shift"][k]
        out[i, j] = PreviewMatch(
            inliers=int(data["inliers"][k]),
            rotation=rotation if np.isfinite(rotation).all() else None,
            shift=shift if np.isfinite(shift).all() else None,
            matches=matches[k],
        )
    return out


def match_item(pair: tuple[int, int], folder: Path, settings: PreviewSettings, tuning: PreviewTuning) -> PreviewMatch:
    """The previews of two images matched."""
    scene = scene_of(folder)
    a, b = (scene.sensor_of(k).camera for k in pair)  # a guessed focal length serves as well
    one, other = (preview_of(folder, scene.names[k]) for k in pair)
    return match_previews(one, other, a, b, settings, tuning)


def up_light(run: Run, scene: Scene) -> UpLight:
    """Content of the up cameras' images: by the method that ``network.sections`` names, else by previews, masks and
    EXIF."""
    way = run.settings.network.sections
    papers.plug_in(papers.LIGHTS, way, LIGHTS)
    if way in LIGHTS:
        return LIGHTS[way](scene, run.path("images"), run.map)
    grey, sky = np.array(run.map(_light_of, scene.names, run.folder)).reshape(-1, 2).T
    return UpLight(grey, sky, scene.exposure)


def _light_of(name: str, folder: Path) -> tuple[float, float]:
    """Mean grey of an image, and the share of an up camera's picture that its mask leaves out (sky)."""
    scene = scene_of(folder)
    up = scene.sensor_of(scene.image_index[name]).role == "up"
    return preview_of(folder, name).brightness, 1.0 - float(read_mask(folder, name).mean()) if up else float("nan")


@cached_by_file(2, lambda folder: folder / "scene.json")
def scene_of(folder: Path) -> Scene:
    """The scene of a run folder, as scanned."""
    return load_scene(folder / "scene.json")


# Of about 110 kB each, in every worker; reading one costs a fifteenth of matching it
@cached_by_file(512, preview_path)
def preview_of(folder: Path, name: str) -> Preview:
    """The preview of an image."""
    return read_preview(folder, name)
