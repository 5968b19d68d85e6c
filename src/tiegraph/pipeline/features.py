"""Glue of the engine ``features``: SIFT of reduced images (preview) and their matches, for the stages candidates,
coarse and design; SIFT of the images into the database (features), the listed pairs matched and verified (match).
"""

from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np

from tiegraph import papers
from tiegraph.child import cores
from tiegraph.errors import ReconstructionError
from tiegraph.features.matchblocks import Rules, Side, colmap_matches, match_pairs
from tiegraph.features.matchers import on_gpu
from tiegraph.features.preview import Preview, PreviewMatch, extract_preview, match_previews
from tiegraph.features.settings import FeaturesSettings, PreviewSettings
from tiegraph.features.sift import extract_image, network
from tiegraph.features.tuning import PreviewTuning, Tuning
from tiegraph.network.sections import LIGHTS, UpLight
from tiegraph.pipeline import files
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scene import colmapdatabase as database
from tiegraph.scene.atomic import cached_by_file, claim
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.scene import Scene
from tiegraph.text import some


def preview(run: Run) -> Outcome:
    """Low-resolution features and brightness of every image, under its mask."""
    scene, settings, tuning = files.scanned(run), run.settings.preview, run.settings.tuning.features
    if run.settings.features.model is not None:
        network(run.settings.features.model)  # one that cannot be used is refused before the work
    run.make_missing(_preview_item, scene.names, lambda n: preview_path(run.folder, n), run.folder, settings, tuning)
    told = dim_told(run.folder, scene.names, tuning)
    said = (f"{told}: it is equalised before feature extraction",) if told else ()
    return Outcome({"images": len(scene)}, notes=said)


def dim_images(folder: Path, names: Iterable[str], tuning: Tuning) -> dict[str, float]:
    """Contrast, grey levels, of those of the images that show too little of it."""
    shown = {name: read_preview(folder, name).contrast for name in names}
    return {name: value for name, value in shown.items() if value < tuning.contrast.enough}


def dim_told(folder: Path, names: Collection[str], tuning: Tuning) -> str:
    """How many of the images show too little contrast, and how little; "" if none does."""
    dim = dim_images(folder, names, tuning)
    return "" if not dim else (
        f"{len(dim)} of {len(names)} images show little contrast, {np.median(list(dim.values())):.1f} grey levels in "
        "the median (most in daylight show 20 and more)"
    )  # fmt: skip


def with_contrast(error: ReconstructionError, run: Run, scene: Scene) -> ReconstructionError:
    """The error, which names too little contrast of the images as a cause if they have it."""
    told = dim_told(run.folder, scene.names, run.settings.tuning.features)
    return ReconstructionError(f"{error}. {told}: give more light, or go nearer") if told else error


def preview_path(folder: Path, name: str) -> Path:
    """The file of an image's preview."""
    return folder / "preview" / f"{name}.npz"


def read_preview(folder: Path, name: str) -> Preview:
    """The preview of an image. Raises UnreadableArtefact."""
    return files.load_as(preview_path(folder, name), Preview.from_npz)


def _preview_item(name: str, folder: Path, settings: PreviewSettings, tuning: Tuning) -> None:
    found = extract_preview(files.read_image(folder / "images" / name), files.read_mask(folder, name), settings, tuning)
    files.save_npz(preview_path(folder, name), **found.to_npz())


_CHUNK = 2000  # previews, after which the matches are stored: a second to some ten of work


def with_previews(run: Run, pairs: Pairs, ties: PreviewMatches) -> tuple[Pairs, PreviewMatches, int]:
    """The pairs and ties after previews of every kept pair without known ties, and the number of these previews.

    Pairs by order, by a list or exhaustive ones come without previews: a method that chooses would be blind.
    """
    unknown = (pairs.dropped == 0) & np.isnan(pairs.score) & np.isnan(pairs.overlap)
    rows = np.flatnonzero(unknown & (ties.find(pairs.i, pairs.j) < 0))
    if not len(rows):
        return pairs, ties, 0
    new = previews_of(run, pairs.where(rows))
    score = pairs.score.copy()
    score[rows] = new.known(pairs.i[rows], pairs.j[rows])
    return pairs.with_(score=score), ties | new, len(rows)


def previews_of(run: Run, pairs: Pairs) -> PreviewMatches:
    """The matches of the previews of all pairs."""
    items, settings = zip(pairs.i.tolist(), pairs.j.tolist()), run.settings
    found = run.map(match_item, items, run.folder, settings.preview, settings.tuning.features.preview)
    return PreviewMatches.make(pairs.i, pairs.j, [one.matches for one in found])


class Matcher:
    """Matches previews over the pool. Finished matches are kept below the run folder until the stage is done, so that a
    killed stage continues there."""

    def __init__(self, run: Run, folder: str) -> None:
        self._run, self._folder = run, run.path(folder)
        self._chunks, self._asked = 0, 0
        self._before: dict[tuple[int, int], PreviewMatch] = {}
        for path in sorted(self._folder.glob("*.npz")):
            self._before.update(files.load_as(path, _from_arrays))
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
            files.save_npz(self._folder / f"{self._chunks:06d}.npz", **_to_arrays(found))
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
    assert a is not None and b is not None  # of every sensor, by scan
    one, other = (preview_of(folder, scene.names[k]) for k in pair)
    return match_previews(one, other, a, b, settings, tuning)


def up_light(run: Run, scene: Scene) -> UpLight:
    """Content of the up cameras' images: by the method of ``network.sections``, else by previews, masks and EXIF."""
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
    sky = 1.0 - float(files.read_mask(folder, name).mean()) if up else float("nan")
    return preview_of(folder, name).brightness, sky


@cached_by_file(2, lambda folder: folder / "scene.json")
def scene_of(folder: Path) -> Scene:
    """The scene of a run folder, as scanned."""
    return files.load_scene(folder / "scene.json")


# Of about 110 kB each, in every worker; reading one costs a fifteenth of matching it
@cached_by_file(512, preview_path)
def preview_of(folder: Path, name: str) -> Preview:
    """The preview of an image."""
    return read_preview(folder, name)


_SLAB_IMAGES = 16  # images a worker extracts before their features are written: bounds memory and what a kill loses


def features(run: Run) -> Outcome:
    """SIFT of every image under its mask, into COLMAP's database."""
    scene, path = files.scanned(run), run.path("database.db")
    if not path.exists():
        claim(path)
        create_database(path, scene.measured())
    there = database.feature_counts(path)
    todo = [(k, n) for k, n in enumerate(scene.names) if k not in there]
    run.reporter.total(len(scene), len(there))
    step, tuning = _SLAB_IMAGES * run.workers, run.settings.tuning.features
    for start in range(0, len(todo), step):
        found = run.map(_features_item, todo[start : start + step], run.folder, run.settings.features, tuning)
        for first in range(0, len(found), _SLAB_IMAGES):  # the same transactions with any number of workers
            database.write_features(path, found[first : first + _SLAB_IMAGES])
    counts = np.array(list(database.feature_counts(path).values()))
    lost = database.lost_features(path, scene, range(len(scene)))
    out = {"images": len(scene), "features": int(counts.sum()), "median_features": float(np.median(counts))}
    return Outcome(out, dropped=tuple(lost))


def _features_item(
    item: tuple[int, str], folder: Path, settings: FeaturesSettings, tuning: Tuning
) -> database.Features:
    index, name = item
    return index, *extract_image(folder / "images" / name, files.mask_path(folder, name), settings, tuning)


def forget_matches(folder: Path) -> None:
    """Clear the rows of match in the shared database."""
    if (folder / "database.db").exists():
        database.clear_matches(folder / "database.db")


def match(run: Run) -> Outcome:
    """Match and verify exactly the listed pairs."""

    def progress(done: int, total: int) -> None:
        run.reporter.total(total, done)

    scene = files.checked(run)
    asked = files.pairs_of(run, "pairs.npz")
    side = Side(run.workers, run.map_untold) if run.distributed else Side(min(run.workers, cores()))
    rules = Rules(run.settings.match, run.settings.tuning.features.verification)
    try:
        pairs, report = match_pairs(run.path("database.db"), scene, asked, rules, run.log, progress, side)
    except ReconstructionError as error:
        raise with_contrast(error, run, scene) from None
    files.save_npz(run.path("match.npz"), **pairs.to_npz())
    alone = np.flatnonzero(pairs.degree(len(scene)) == 0)
    notes = ["matched by COLMAP on a GPU"] if on_gpu() and colmap_matches(run.settings.match) else []
    if len(alone):
        notes.insert(0, f"{len(alone)} images have no verified pair: {some((scene.names[k] for k in alone), 5)}")
    kinds = {"columns": ["two-view geometry", "pairs"], "rows": [[k, n] for k, n in report.configurations.items()]}
    counts = {n: getattr(report, n) for n in ("asked", "matched", "verified", "matches", "inliers")}
    return Outcome(counts, dropped=report.lost, notes=tuple(notes), tables={"two-view geometries": kinds})
