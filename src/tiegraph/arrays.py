"""One function for each engine, with arrays in and objects out: for notebooks and for other programs.

A survey is a folder of images (``tiegraph.open``). These functions take a single step of it without a folder; files
that an engine needs are temporary. Images are (H, W, 3) RGB or (H, W) grey, uint8; pixel coordinates are COLMAP's, (0,
0) is the corner of the first pixel. Settings are those of the stage of the same name.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from tiegraph.api import open_project
from tiegraph.cloud.fuse import Maps, fuse
from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.tuning import Tuning as CloudTuning
from tiegraph.dense.depth import with_normals
from tiegraph.dense.engine import ENGINES, DenseView, installed
from tiegraph.dense.plan import DepthRange
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning as DenseTuning
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.evaluate.clouds.judge import CloudJudgement, Question, judge_cloud
from tiegraph.evaluate.tuning import Tuning as EvaluateTuning
from tiegraph.features.matchblocks import Rules, colmap_options
from tiegraph.features.matchers import Features, matcher
from tiegraph.features.preview import PreviewMatch, extract_preview, match_previews
from tiegraph.features.settings import FeaturesSettings, MatchSettings, PreviewSettings
from tiegraph.features.sift import evened, extract_sift
from tiegraph.features.tuning import Tuning as FeaturesTuning
from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import up_vector
from tiegraph.geometry.transforms import PlacementError, Similarity
from tiegraph.masks.frames import full_size
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import SOURCES, Camera
from tiegraph.masks.tuning import Tuning as MasksTuning
from tiegraph.network.candidates import find_candidates
from tiegraph.network.passes import MatchCache
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning as NetworkTuning
from tiegraph.plugins import chosen
from tiegraph.scan.tuning import Tuning as ScanTuning
from tiegraph.scene.cloudchunks import points_of
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import Cloud, DepthMap
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world.fixes import Measured, Measurements
from tiegraph.sfm.world.georef import of_fit
from tiegraph.sfm.world.similarityfit import NotPlaced, fit_to_world

__all__ = [
    "DenseView",
    "Features",
    "Georeference",
    "Matches",
    "candidates",
    "compare_clouds",
    "depth",
    "features",
    "fuse_depth",
    "georeference",
    "learn_masks",
    "match",
    "reconstruct",
]


def __dir__() -> list[str]:
    """What there is, without what it is made of."""
    return __all__


@dataclass(frozen=True, eq=False)
class Matches:
    """What two images share: ``tentative`` (M, 2) u4 rows of the features of a and b that match, and
    COLMAP's verified two-view ``geometry``."""

    tentative: np.ndarray
    geometry: pycolmap.TwoViewGeometry

    @property
    def inliers(self) -> np.ndarray:
        """(I, 2) u4 verified rows of the features of a and b."""
        return np.asarray(self.geometry.inlier_matches, np.uint32).reshape(-1, 2)

    def __repr__(self) -> str:
        return f"Matches({len(self.inliers)} verified of {len(self.tentative)})"


@dataclass(frozen=True, eq=False)
class Georeference:
    """A model in the world: ``world_from_model``, its covariance ``error``, the N poses there and what was measured.

    cam_from_world (N, 4, 4), NaN = not in the model; sigma_m (N, 3) of their centres by the georeference alone, east,
    north, up; residuals_m (N, 3) model minus measured, NaN = unknown; used (N,) bool: positions that agree.
    ``error.sigma(points)`` gives sigmas of other places. ``notes`` are the remarks of the stage georef.
    """

    world_from_model: Similarity
    error: PlacementError
    cam_from_world: np.ndarray
    sigma_m: np.ndarray
    residuals_m: np.ndarray
    used: np.ndarray
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        known = np.isfinite(self.residuals_m).all(axis=1).sum()
        said = ", ".join(f"{name} {value:.2g}" for name, value in self.error.sigmas().items())
        return (
            f"Georeference(scale {self.world_from_model.scale:.6g}, {self.used.sum()} of {known} used; sigmas: {said})"
        )


def learn_masks(images: Sequence[np.ndarray], settings: MasksSettings | None = None) -> list[np.ndarray]:
    """Class of each pixel (H, W) u1 (``tiegraph.masks.NAMES``; 0 = use) of the images of one camera, in their order
    along the path. Raises InputError for images of different sizes."""
    settings = settings or MasksSettings(source="learnt")
    source = SOURCES["learnt"]
    with tempfile.TemporaryDirectory() as folder:
        paths = _written(images, Path(folder))
        prepared = source.prepare({0: Camera(tuple(paths))}, settings, MasksTuning(), map)
        found = [source.look(p, prepared[0], settings, MasksTuning(), p.name) for p in paths]
    return [full_size(classes, image.shape[:2]) for classes, image in zip(found, images)]


def candidates(
    images: Sequence[np.ndarray],
    ordered: bool = True,
    camera: pycolmap.Camera | None = None,
    settings: CandidatesSettings | None = None,
) -> Pairs:
    """Pairs of images that may tie, by previews. ``ordered``: the images are a sequence, not loose photographs;
    ``camera``: that of all images, if its focal length is known."""
    tuning, asked = FeaturesTuning(), PreviewSettings()
    previews = [extract_preview(_grey(image), None, asked, tuning) for image in images]
    if not previews:
        raise InputError("no image is given: candidates need two at least")

    known = camera or _guessed((previews[0].width, previews[0].height))

    def matched(pairs: np.ndarray) -> list[PreviewMatch]:
        return [match_previews(previews[i], previews[j], known, known, asked, tuning.preview) for i, j in pairs]

    rig = Rig("camera", (Sensor("camera", known),))
    number = np.arange(len(images))
    order = {"sequence": np.zeros(len(images)), "sequence_index": number} if ordered else {}
    names = [f"{k:06d}" for k in number]
    scene = simple_scene(rig, names, number, np.zeros(len(images)), sequences=("pass",) if ordered else (), **order)
    cache = MatchCache(matched, len(images))
    found = find_candidates(
        scene, cache, settings or CandidatesSettings(), NetworkTuning(), lambda: [p.descriptors for p in previews]
    )
    return found.pairs.kept()


def features(image: np.ndarray, mask: np.ndarray | None = None, settings: FeaturesSettings | None = None) -> Features:
    """SIFT of an image, its contrast evened where it shows too little; ``mask`` (H, W) bool, True = use."""
    gray, tuning = _grey(image), FeaturesTuning()
    found = extract_sift(evened(gray, tuning.contrast), mask, settings or FeaturesSettings(), tuning.sift)
    return Features(*found, size=(gray.shape[1], gray.shape[0]))


def match(
    a: Features,
    b: Features,
    cameras: tuple[pycolmap.Camera, pycolmap.Camera] | None = None,
    settings: MatchSettings | None = None,
) -> Matches:
    """Matches of two images, verified by COLMAP: by an essential matrix if both ``cameras`` have a prior focal length,
    which also gives the pose of b from a (``geometry.cam2_from_cam1``), else by a fundamental matrix or homography.
    Raises InputError and EngineMissing for a plug-in of ``settings.engine`` that fails or is not there."""
    settings = settings or MatchSettings()
    _, verification = colmap_options(Rules(settings, FeaturesTuning().verification))
    verification.compute_relative_pose = cameras is not None
    one, two = cameras or (_guessed(a.size), _guessed(b.size))
    tentative = matcher(settings)(a, b, "a", "b")
    points = [f.keypoints[:, :2].astype(float) for f in (a, b)]
    return Matches(
        tentative, pycolmap.estimate_two_view_geometry(one, points[0], two, points[1], tentative, verification)
    )


def reconstruct(
    images: Sequence[np.ndarray], settings: dict[str, dict] | None = None, **inputs: Any
) -> pycolmap.Reconstruction:
    """The model of the images, named 000000.png and so on, by all stages to ``georef`` in a temporary folder.

    ``settings`` and ``inputs`` as of ``tiegraph.open``; metres only if they tell the scale. Raises ReconstructionError.
    """
    with tempfile.TemporaryDirectory() as folder:
        _written(images, Path(folder) / "images")
        project = open_project(Path(folder) / "images", Path(folder) / "out", settings=settings, **inputs)
        return project.run(until="georef").model()


def georeference(cam_from_world: np.ndarray, position_m: np.ndarray, sigma_m: np.ndarray | float) -> Georeference:
    """The similarity from a model to measured positions of its cameras, robust, with sigmas.

    cam_from_world (N, 4, 4) poses in model units; position_m (N, 3) of the camera centres, metres, z up; sigma_m, one
    standard deviation, of all, (N,) or (N, 3). NaN = unknown. The errors are taken as independent; where the residuals
    show them to be larger than stated, the sigmas follow. Raises InputError for arrays that do not fit together,
    ReconstructionError with the reason where the positions do not place the model. The model keeps its shape: the
    stage georef also adjusts it. Source: docstring of ``tiegraph.sfm.world``.
    """
    count = len(cam_from_world)
    if np.shape(cam_from_world) != (count, 4, 4) or np.shape(position_m) != (count, 3):
        shapes = f"{np.shape(cam_from_world)} and {np.shape(position_m)}"
        raise InputError(f"poses (N, 4, 4) and positions (N, 3) are needed, got {shapes}")
    try:
        sigma = np.broadcast_to(sigma_m if np.ndim(sigma_m) != 1 else np.asarray(sigma_m)[:, None], (count, 3))
    except ValueError:
        raise InputError(f"sigmas {np.shape(sigma_m)}: one, (N,) or (N, 3) is needed, N = {count}") from None
    if np.any(sigma <= 0):
        raise InputError(f"a sigma of {np.nanmin(sigma):g} m: it must be above 0")
    number = np.arange(count)
    there = transforms.rigid(np.full((count, 3, 3), np.nan), np.asarray(position_m, float))
    scene = simple_scene(
        Rig("camera", (Sensor("camera"),)), [f"{k:06d}" for k in number], number, np.zeros(count),
        world_from_rig=there, position_sigma_m=sigma, prior="trajectory",
    )  # fmt: skip
    tuning, poses = WorldTuning(), np.asarray(cam_from_world, float)
    up = up_vector(poses, number, tuning.up)
    placing = fit_to_world(
        Measured(images=poses, up=up, scene=scene, settings=GeorefSettings(), given=Measurements(), tuning=tuning)
    )
    if isinstance(placing, NotPlaced):
        raise ReconstructionError(placing.why)
    found, error = of_fit(placing), placing.fit.error
    similarity, centres = found.world_from_model, placing.fit.similarity(transforms.centre(poses))
    world = transforms.rigid(similarity.rotation @ np.swapaxes(poses[:, :3, :3], 1, 2), centres)
    return Georeference(
        world_from_model=similarity,
        error=error,
        cam_from_world=transforms.invert(world),
        sigma_m=error.sigma(centres),
        residuals_m=found.residuals.frames_m,
        used=found.residuals.inlier,
        notes=found.findings.notes,
    )


def depth(
    reference: DenseView,
    partners: Sequence[DenseView],
    near: float,
    far: float,
    settings: DenseSettings | None = None,
) -> DepthMap:
    """Depth map of an undistorted image from its partners, with sigma and normals, between the depths ``near`` and
    ``far`` in world units. Raises InputError unless 0 < near < far."""
    if not 0 < near < far:
        raise InputError(f"depths from {near:g} to {far:g} are no range: 0 < near < far is needed")
    settings = settings or DenseSettings()
    engine = chosen("dense", installed(settings.engine)[0], ENGINES)
    return with_normals(engine(reference, partners, DepthRange(near, far), settings, DenseTuning()))


def fuse_depth(
    maps: Sequence[DepthMap],
    images: Sequence[np.ndarray] | None = None,
    settings: CloudSettings | None = None,
) -> Cloud:
    """One cloud of depth maps, coloured by their ``images`` (H, W, 3) RGB. Raises ReconstructionError."""
    named = {f"{k}": k for k in range(len(maps))}
    colours: Callable[[str], np.ndarray] | None = None if images is None else lambda name: images[named[name]]
    with tempfile.TemporaryDirectory() as folder:
        source = Maps(lambda name: maps[named[name]], colours)
        return fuse(list(named), source, Path(folder), settings or CloudSettings(), CloudTuning()).cloud()


def compare_clouds(
    cloud: np.ndarray | Cloud, reference: np.ndarray | Cloud, question: Question | None = None
) -> CloudJudgement:
    """A cloud against a reference, (N, 3) in one frame and metres: accuracy and completeness by nearest points, and
    signed differences with their significance by M3C2. Raises InputError for clouds that do not meet."""
    one, two = (c.xyz_m if isinstance(c, Cloud) else c for c in (cloud, reference))
    with tempfile.TemporaryDirectory() as folder:
        return judge_cloud(
            points_of(one), points_of(two, "the reference"), Path(folder), question or Question(), EvaluateTuning()
        )


def _guessed(size: tuple[int, int]) -> pycolmap.Camera:
    """A camera of unknown focal length, as scan guesses it."""
    focal = ScanTuning().rig.camera.guessed_focal * max(size)
    return pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", focal, *size)


def _grey(image: np.ndarray) -> np.ndarray:
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InputError(f"an image is (H, W, 3) RGB or (H, W) grey, uint8; this one is {image.shape} {image.dtype}")
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def _written(images: Sequence[np.ndarray], folder: Path) -> list[Path]:
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{k:06d}.png" for k in range(len(images))]
    for path, image in zip(paths, images):
        _grey(image)
        path.write_bytes(cv2.imencode(".png", image if image.ndim == 2 else image[..., ::-1])[1].tobytes())
    return paths
