"""Spatial parts of the report: maps, static views of the cloud, the interactive view."""

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from markupsafe import Markup
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.geometry.align import PlacementError
from tiegraph.geometry.gravity import levelled
from tiegraph.report import cloudview, formatting, maps
from tiegraph.report.cloudview import Scale, inliers, shown_colours, standard_views, with_scale_bar
from tiegraph.report.runfolder import RunFolder, some_of
from tiegraph.report.settings import ReportSettings
from tiegraph.report.tables import receipt_tables, section_name
from tiegraph.report.texts import t
from tiegraph.report.thumbnails import file_uri, jpeg, rgb_of, thumbnail
from tiegraph.scene.sorting import evenly
from tiegraph.text import round_below

log = logging.getLogger(__name__)
_MOST = 1_000_000  # points of a file that are read
_NEAR = 3.0  # a point has the value of a measured one within this distance, in spacings of these
_FILES = {  # of measured distances: their name in the view, and whether they have a sign
    "evaluate/distances.laz": ("distance to the reference cloud", False),
    "passes/differences.laz": ("one pass against the other", True),
}
VIEW_PX = 1400  # width of the static views
_IMAGES, _PICTURES = 5000, 90  # that the interactive view names, and shows
_CELLS = 84  # of the overlap map, across
_ELLIPSES = 12  # places with an error ellipse
_OVERLAP = ((2, "#c8442b"), (3, "#e69f00"), (4, "#f0e08c"), (6, "#7fb8d0"), (10, "#0b4f6c"))  # from so many images


@dataclass(frozen=True, eq=False)
class Scenery:
    """Common data of all maps and views, upright: passes, given positions (K, 3), points (N, 3) with colours, and
    how many images see each (0 = not known)."""

    tracks: list[maps.Track]
    given: np.ndarray
    xyz: np.ndarray
    rgb: np.ndarray
    views: np.ndarray
    path: np.ndarray  # (K, 3) places of the images
    unit: str
    north: bool  # +y is north

    @property
    def place(self) -> maps.Place:
        """The extent of the maps."""
        return maps.place_of(self.tracks, self.given, self.xyz, self.unit)


def scenery(run: RunFolder) -> Scenery | None:
    """None without a model."""
    if run.scene is None or run.model is None or not run.model.placed.any():
        return None
    upright = np.eye(3)
    if not run.world:
        upright = levelled(transforms.invert(run.model.world_from_camera), run.scene.frame)[:3, :3]
    placed = run.georeferenced or bool((run.world or {}).get("placed"))
    found = maps.tracks(run.scene, maps.frame_positions(run.scene, run.model.centres @ upright.T))
    prior = run.scene.world_from_rig[:, :3, 3]
    if not placed:  # prior positions are in another frame than the model
        found = [maps.Track(track.name, track.positions, track.missing[:0]) for track in found]
    xyz, rgb = (run.cloud.xyz, run.cloud.rgb) if run.cloud is not None else run.model.sample
    return Scenery(
        tracks=found,
        given=prior[np.isfinite(prior[:, 0])] if placed else np.zeros((0, 3)),
        xyz=xyz @ upright.T,
        rgb=rgb,
        views=run.cloud.views if run.cloud is not None else np.zeros(len(xyz)),
        path=run.model.centres[run.model.placed] @ upright.T,
        unit="m" if run.metric else t("units"),
        north=run.georeferenced,
    )


def survey_map(seen: Scenery) -> Markup:
    """The survey area: the passes over the cloud from above."""
    place, rising = seen.place, np.argsort(seen.xyz[:, 2], kind="stable")
    colours = shown_colours(seen.xyz, seen.rgb)
    backdrop = maps.raster(place, seen.xyz[rising], colours[rising]) if len(rising) else ""
    return maps.survey_map(place, seen.tracks, seen.given, backdrop, seen.north)


def overlap_map(seen: Scenery) -> Markup | None:
    """The number of images that see the surface, cell by cell; None if the cloud has none."""
    if not (seen.views > 0).any():
        return None
    place = seen.place
    middle, value = maps.median_cells(place, seen.xyz, seen.views, _CELLS)
    low = [k for k, _ in _OVERLAP]
    colours = np.array([rgb_of(c) for _, c in _OVERLAP], np.uint8)
    step = np.clip(np.searchsorted(low, value, side="right") - 1, 0, None)
    key = [(t("{} images", f"{a}–{b - 1}" if b - a > 1 else a), c) for (a, c), (b, _) in zip(_OVERLAP, _OVERLAP[1:])]
    key.append((t("{} and more", _OVERLAP[-1][0]), _OVERLAP[-1][1]))
    picture = maps.raster(place, middle, colours[step], _CELLS)
    return maps.drawn_map(place, picture, key, t("Overlap: images that see the surface"), seen.north)


def ellipse_map(run: RunFolder, seen: Scenery) -> tuple[Markup, str] | None:
    """Error ellipses of the placement along the path and their enlargement; None if nothing is known."""
    told = (run.world or {}).get("placement_error")
    if told is None or not len(seen.path):
        return None
    place, way = seen.place, np.concatenate([track.seen for track in seen.tracks])
    axis = np.linalg.svd(way - way.mean(axis=0), full_matrices=False)[2][0]  # along which most of it lies
    at = way[np.argsort(way @ axis)][evenly(len(way), _ELLIPSES)]
    flat = PlacementError.from_dict(told).covariances(at)[:, :2, :2]
    largest = float(np.sqrt(np.linalg.eigvalsh(flat).max()))
    if not largest > 0:
        return None
    factor = round_below(0.06 * float(place.high[0] - place.low[0]) / largest)
    drawn = [maps.ellipse(place, p, c, factor) for p, c in zip(at, flat)]
    return maps.survey_map(place, seen.tracks, seen.given[:0], "", seen.north, drawn), f"{factor:g}"


def views(run: RunFolder, seen: Scenery) -> list[tuple[str, str]]:
    """(name, data URI) of the static views of the cloud."""
    if run.cloud is None:
        return []
    drawn = standard_views(seen.xyz, seen.rgb, seen.path, VIEW_PX, seen.north)
    return [(t(v.name), jpeg(with_scale_bar(v, seen.unit))) for v in drawn]


def product_views(run: RunFolder) -> list[tuple[str, str]]:
    """(name, data URI) of the orthophoto, the surface model and the terrain of each surface."""
    texts = {
        "overview.jpg": "True orthophoto: {}",
        "dsm.jpg": "Surface model: {}",
        "dtm.jpg": "Terrain and contour lines: {}",
    }
    folders = sorted(p for p in (run.path / "products").glob("*") if p.is_dir())
    found = [(t(text, p.name), file_uri(p / name)) for p in folders for name, text in texts.items()]
    return [(text, uri) for text, uri in found if uri is not None]


def viewer_part(run: RunFolder, seen: Scenery, settings: ReportSettings) -> dict[str, Any]:
    """Data and script of the interactive view."""
    most = settings.viewer_points
    rows = np.sort(np.random.default_rng(0).permutation(len(seen.xyz))[:most])
    extras = viewer_extras(run, seen, rows)
    data = cloudview.viewer_data(seen.xyz[rows], seen.rgb[rows], seen.tracks, most, seen.unit, extras)
    if data is None:
        return {"viewer": None, "viewer_script": ""}
    return {"viewer": json.dumps(data).replace("<", "\\u003c"), "viewer_script": cloudview.viewer_script()}


def viewer_extras(run: RunFolder, seen: Scenery, rows: np.ndarray) -> cloudview.ViewerExtras:
    """Of some points: sigma, measured distances, section; coordinates of the CRS; and the images, an even part of them
    with a small picture."""
    assert run.scene is not None and run.model is not None
    placed = np.flatnonzero(run.model.placed)[:_IMAGES]
    pictured = set(placed[np.linspace(0, len(placed) - 1, min(len(placed), _PICTURES)).astype(int)].tolist())
    shown = []
    for at, k in zip(seen.path, placed):
        made = thumbnail(run.path / "images" / run.scene.names[k], Path(), width=200) if int(k) in pictured else None
        shown.append((run.scene.names[k], at, str(made[0]) if made else ""))
    scales = {}
    if run.cloud is not None:
        xyz = run.cloud.xyz[rows]
        scales[t("sigma of a point")] = Scale(run.cloud.sigma_m[rows])
        scales |= {**distance_scales(run, xyz), **section_scale(run, xyz)}
    axes = ("E", "N", "H") if seen.north else ("x", "y", "z")
    return cloudview.ViewerExtras(scales=scales, offset=run.shift.tolist(), axes=axes, images=shown, north=seen.north)


def cloud_facts(run: RunFolder) -> dict[str, Any] | None:
    """Facts about the cloud."""
    c = run.cloud
    if c is None:
        return None
    rows = [(t("file"), f"{c.name}, {formatting.size(c.bytes)}"), (t("points"), formatting.count(c.count))]
    if c.views.any():
        rows.append((t("images that saw a point, median"), formatting.number(float(np.median(c.views)), 2)))
    return {"facts": rows, "tables": receipt_tables(run, "dense", "cloud"), "notes": run.notes("dense", "cloud")}


def gsd(run: RunFolder) -> tuple[float, float, float] | None:
    """Size of a pixel on the surface, in units of the world: of the nearest tenth of the images, half, nine in ten."""
    known = run.model.observed.gsd[np.isfinite(run.model.observed.gsd)] if run.model is not None else np.zeros(0)
    if not len(known):
        return None
    low, middle, high = np.quantile(known, [0.1, 0.5, 0.9]).tolist()
    return low, middle, high


def points_inside(seen: Scenery) -> np.ndarray:
    """Size (3,) of the box of the points but a few strays."""
    kept = seen.xyz[inliers(seen.xyz)]
    return np.ptp(kept, axis=0) if len(kept) else np.zeros(3)


def distance_scales(run: RunFolder, xyz: np.ndarray) -> dict[str, Scale]:
    """Distances measured near points (N, 3) of the world, by name; those of existing files."""
    out = {}
    for name, (text, signed) in _FILES.items():
        path = run.path / name
        if path.exists() and len(xyz):
            try:
                at, values = _measured(path)
            except Exception as error:  # laspy raises what it meets
                log.warning("report: %s cannot be read and is left out: %s", path, error)
                continue
            if len(at) > 1:
                out[t(text)] = Scale(_nearest(at - run.shift, values, xyz), signed=signed)
    return out


def _measured(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points (K, 3) of the CRS and their ``distance_m`` (K,), every n-th of a large file."""
    parts = [(np.zeros((0, 3)), np.zeros(0))]
    with laspy.open(path) as reader:
        for part in some_of(reader, _MOST):
            parts.append((np.column_stack([part.x, part.y, part.z]), np.asarray(part["distance_m"], float)))
    xyz, values = (np.concatenate(column) for column in zip(*parts))
    return xyz[np.isfinite(values)], values[np.isfinite(values)]


def _nearest(at: np.ndarray, values: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """(N,) the value of the nearest measured point, NaN where none is near."""
    tree = cKDTree(at)
    reach = _NEAR * float(np.median(tree.query(at[:: max(1, len(at) // 5000)], k=2)[0][:, 1]))
    row = tree.query(xyz, distance_upper_bound=max(reach, 1e-9))[1]
    return np.append(values, np.nan)[row]  # one beyond the last where there is none


def section_scale(run: RunFolder, xyz: np.ndarray) -> dict[str, Scale]:
    """The section that points (N, 3) lie in, that of the nearest camera; {} where there are not several."""
    assert run.scene is not None and run.model is not None
    placed = np.flatnonzero(run.model.placed)
    numbers, of_camera = np.unique(run.scene.section[run.scene.frame[placed]], return_inverse=True)
    if len(numbers) < 2 or not len(xyz):
        return {}
    names = tuple(section_name(run, int(k)) for k in numbers)
    nearest = cKDTree(run.model.centres[placed]).query(xyz)[1]
    return {t("section"): Scale(of_camera[nearest].astype(float), names=names)}
