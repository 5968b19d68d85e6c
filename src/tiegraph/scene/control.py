"""Control points in the survey: places in its world, marks as pixels of its prepared images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import (
    ENU,
    Origin,
    geodetic_from_crs,
    geodetic_from_world,
    make_origin,
    middle,
    vertical_note,
    world_from_geodetic,
)
from tiegraph.scene.gcp import FileMark, GcpFile
from tiegraph.scene.gnss.fixes import HEIGHTS_M, beyond
from tiegraph.scene.names import found_by, lookup_of
from tiegraph.scene.rig import AS_IS, EDGE_PX, Copy, file_camera, prepared_pixel, within
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import Columns
from tiegraph.text import some

MIN_MARKS = 2  # of a point that can be triangulated: two rays meet
NEAR_M = 1000.0  # beyond the positions of the survey, where control points still lie
FAR_M = 100_000.0  # farther from the survey's positions than this, the coordinates are of another CRS or axis order
_SHOWN = 3


@dataclass(frozen=True)
class TargetMark:
    """A detected coded target: its name in the file, scene index, pixel of the prepared image."""

    name: str
    image: int
    xy: tuple[float, float]
    sigma_px: float


@dataclass(frozen=True)
class Marks(Columns):
    """M marks: rows of their points and scene indices of their images (M,), xy_px (M, 2) in COLMAP's pixels of the
    prepared image, line (M,) in the file, 0 = detected, sigma_px (M,), NaN = that of a manual mark; file_px
    (M, 2) as in the file, NaN = xy_px, orientation (M,) of the image by EXIF, for marks made in a copy."""

    point: np.ndarray
    image: np.ndarray
    xy_px: np.ndarray
    line: np.ndarray
    sigma_px: np.ndarray
    file_px: np.ndarray | None = None
    orientation: np.ndarray | None = None


@dataclass(frozen=True)
class ScaleBars:
    """B scale bars between marked points: the points' names and marks, rows of their ends (B, 2), length_m, sigma_m
    (B,), check (B,) bool."""

    names: tuple[str, ...]
    marks: Marks
    ends: np.ndarray
    length_m: np.ndarray
    sigma_m: np.ndarray
    check: np.ndarray

    def __len__(self) -> int:
        return len(self.ends)


@dataclass(frozen=True)
class Control:
    """P surveyed points and their marks. Arrays: world_m (P, 3), sigma_m (P, 3), check (P,) bool."""

    names: tuple[str, ...]
    world_m: np.ndarray
    sigma_m: np.ndarray
    check: np.ndarray
    marks: Marks
    origin: Origin | None = None
    notes: tuple[str, ...] = field(default_factory=tuple)

    def __len__(self) -> int:
        return len(self.names)


def locate(
    file: GcpFile,
    scene: Scene,
    crs: str = "auto",
    found: Sequence[TargetMark] = (),
    orientation: Mapping[int, int] | None = None,
    heights_m: tuple[float, float] = HEIGHTS_M,
) -> Control:
    """The points of a file in the scene's world and their marks in its images.

    Without positions in the scene the world is made from the points, in ``crs`` ("auto": the file's own if it is
    projected, else the UTM zone). ``found``: coded targets; a mark in the file precedes a detected one.
    ``orientation``: by EXIF, of images by scene index, 1 if not listed. Marks in images that are not here, or where the
    images were cropped, are left out and noted with file and line, and so are points that keep less than two. Raises
    InputError if no mark is in an image of the survey, if one lies outside its image and in no copy of the images do
    all lie inside (``rig.Copy``), if one image has two marks of a point, if coordinates lie outside their CRS, far
    from the survey, or at heights beyond ``heights_m``.
    """
    notes = list(file.notes)
    marks = _marks_of(file, scene, [p.name for p in file.points], found, notes, orientation)
    origin = scene.origin or _origin_of_points(file, crs)
    world = surveyed_world(file, origin)
    _check_place(file, world, scene)
    high = geodetic_from_world(world, origin)[:, 2]
    for k in np.flatnonzero((high < heights_m[0]) | (high > heights_m[1]))[:1]:
        where = f"{file.path}, line {file.points[k].line}: point {file.points[k].name!r}"
        raise InputError(f"{where}: height {high[k]:.10g} m, {beyond(heights_m)}")
    vertical = vertical_note(file.crs or origin.crs)
    notes.append(f"{file.path.name}: {len(file.points)} points in {file.crs or origin.crs}; {vertical}")
    count = np.bincount(marks.point, minlength=len(file.points))
    own = [p.name not in file.targets for p in file.points]  # notes on targets come from their search
    few = np.flatnonzero((count < MIN_MARKS) & own)
    if len(few):
        names = some((f"{file.points[k].name!r} ({count[k]})" for k in few), _SHOWN)
        notes.append(
            f"{file.path.name}, line {file.points[few[0]].line}: {len(few)} of {len(file.points)} points have less "
            f"than {MIN_MARKS} marks in the survey's images and cannot be used: {names}"
        )
    return Control(
        names=tuple(p.name for p in file.points),
        world_m=world,
        sigma_m=np.array([p.sigma_m for p in file.points], float).reshape(-1, 3),
        check=np.array([p.check for p in file.points], bool),
        marks=marks,
        origin=origin,
        notes=tuple(notes),
    )


def locate_bars(
    file: GcpFile,
    scene: Scene,
    found: Sequence[TargetMark] = (),
    orientation: Mapping[int, int] | None = None,
) -> ScaleBars | None:
    """The scale bars of a file with the marks of their ends; None without any. Raises as ``locate`` for marks.

    Notes on marks come from ``locate`` if the file has points too.
    """
    if not file.bars:
        return None
    names = list(dict.fromkeys(n for b in file.bars for n in b.ends))
    return ScaleBars(
        names=tuple(names),
        marks=_marks_of(file, scene, names, found, [], orientation),
        ends=np.array([[names.index(n) for n in b.ends] for b in file.bars], int),
        length_m=np.array([b.length_m for b in file.bars]),
        sigma_m=np.array([b.sigma_m for b in file.bars]),
        check=np.array([b.check for b in file.bars], bool),
    )


def _marks_of(
    file: GcpFile,
    scene: Scene,
    names: list[str],
    found: Sequence[TargetMark],
    notes: list[str],
    orientation: Mapping[int, int] | None,
) -> Marks:
    """The marks of some names: those of the file, and targets detected in images without a mark in the file."""
    turned = orientation or {}
    given = _marks_in(file, scene, notes, turned) if file.marks else []
    own = [(mark, image, xy) for mark, image, xy in given if mark.name in names]
    taken = {(mark.name, image) for mark, image, _ in own}
    more = [m for m in found if m.name in names and (m.name, m.image) not in taken]
    rows = [(names.index(m.name), k, xy, m.line, np.nan, m.xy, turned.get(k, 1)) for m, k, xy in own]
    rows += [(names.index(m.name), m.image, m.xy, 0, m.sigma_px, (np.nan, np.nan), 1) for m in more]
    point, image, xy, line, sigma, file_px, upright = zip(*rows) if rows else ((),) * 7
    return Marks(
        point=np.array(point, int),
        image=np.array(image, int),
        xy_px=np.array(xy, float).reshape(-1, 2),
        line=np.array(line, int),
        sigma_px=np.array(sigma, float),
        file_px=np.array(file_px, float).reshape(-1, 2),
        orientation=np.array(upright, int),
    )


def _marks_in(
    file: GcpFile, scene: Scene, notes: list[str], turned: Mapping[int, int]
) -> list[tuple[FileMark, int, tuple[float, float]]]:
    """Marks that are in the survey's prepared images, each with its image's scene index and its pixel there."""
    lookup, name = image_lookup(scene), file.of_marks.name
    images = [found_by(lookup, mark.image) for mark in file.marks]
    known = [(mark, image) for mark, image in zip(file.marks, images) if image is not None]
    unknown = [mark for mark, image in zip(file.marks, images) if image is None]
    if not known:
        example = f" (line {unknown[0].line}: {unknown[0].image!r})" if unknown else ""
        option = "--gcp" if file.marks_path is None else "--marks"
        raise InputError(
            f"{option} {file.of_marks}: no mark is in an image of this survey{example}; images are named below the "
            f"image folder, such as {scene.source_name(0)}, or by file name where that is unique"
        )
    for mark in unknown[:_SHOWN]:
        notes.append(f"{name}, line {mark.line}: image {mark.image!r} is not in the survey; mark left out")
    if len(unknown) > _SHOWN:
        notes.append(f"{name}: {len(unknown)} marks in total name images that are not in the survey")
    inside = _check_inside(file, known, scene, turned)
    if not inside:
        notes.append(f"{name}: marks lie outside their images; made in larger or rotated ones, the rays decide")
    marks, cut = [], []
    first: dict[tuple[str, int], FileMark] = {}
    for mark, index in known:
        before = first.setdefault((mark.name, index), mark)
        if before is not mark and before.xy != mark.xy:  # one image by two names
            raise InputError(
                f"{file.of_marks}, line {mark.line}: point {mark.name!r} is marked in {scene.source_name(index)} at "
                f"{mark.xy}, but in line {before.line} at {before.xy}: keep the right one"
            )
        sensor = scene.sensor_of(index)
        xy = prepared_pixel(mark.xy, sensor)
        if before is mark and inside and not within(xy, sensor.camera):
            cut.append(mark)
        elif before is mark:
            marks.append((mark, index, xy))
    if cut:
        notes.append(
            f"{name}, line {cut[0].line}: {len(cut)} marks lie where the images were cropped or undistorted away, the "
            f"first of point {cut[0].name!r} in {cut[0].image!r}; left out"
        )
    return marks


def _check_inside(
    file: GcpFile, marks: Sequence[tuple[FileMark, int]], scene: Scene, turned: Mapping[int, int]
) -> bool:
    """Whether all marks, with scene indices, lie in their images; else they must do so in a copy of these."""
    at = [(mark, k, scene.sensor_of(k)) for mark, k in marks]

    def fit(copy: Copy) -> bool:
        return all(within(copy.pixel(m.xy, s, turned.get(k, 1)), file_camera(s)) for m, k, s in at)

    if fit(AS_IS):
        return True
    out = [(m, k, camera) for m, k, s in at if (camera := file_camera(s)) is not None and not within(m.xy, camera)]
    wide, high = (any(m.xy[i] > (c.width, c.height)[i] + EDGE_PX for m, _, c in out) for i in (0, 1))
    # only marks in larger images leave the image in both directions: not a typing error, not exchanged columns
    sizes = (1.0, file.largest_copy) if wide and high else (1.0,)
    if any(fit(Copy(size, turned=t)) for t in (False, True) for size in sizes):
        return False
    mark, k, camera = out[0]
    exchanged = within(mark.xy[::-1], camera)
    raise InputError(
        f"{file.of_marks}, line {mark.line}: the mark ({mark.xy[0]:g}, {mark.xy[1]:g}) of point {mark.name!r} lies "
        f"outside {scene.source_name(k)}, which has {camera.width} x {camera.height} pixels: "
        + ("columns px and py exchanged?" if exchanged else "marked in an image of another size?")
    )


def image_lookup(scene: Scene) -> dict[str, int]:
    """Scene index by image name and the user's own file name, for ``scene.names.found_by``."""
    sources = [(scene.source_name(k), k) for k in range(len(scene))]
    return lookup_of(sources) | {name: k for k, name in enumerate(scene.names)}


def _origin_of_points(file: GcpFile, crs: str) -> Origin:
    import pyproj

    if file.crs is None:
        if crs in ("auto", ENU):
            raise InputError(
                f"--gcp {file.path}: the CRS of its coordinates is unknown, and the survey has no positions: "
                "begin the file with a line '# EPSG:n', or set --scan.crs"
            )
        own = crs
    else:
        own = file.crs
    keep = own.startswith("EPSG") and pyproj.CRS.from_user_input(own).is_projected
    chosen = own if crs == "auto" and keep else crs
    llh = _geodetic(np.array([p.xyz for p in file.points], float), own, file)
    return make_origin(*middle(llh), chosen)


def _geodetic(xyz: np.ndarray, crs: str, file: GcpFile) -> np.ndarray:
    """(N, 3) lat, lon, ellipsoidal height of file coordinates."""
    if file.geographic:
        lat, lon = xyz[:, 0], xyz[:, 1]
        bad = np.flatnonzero((np.abs(lat) > 90) | (np.abs(lon) > 360))
        if len(bad):
            where = f"{file.path}, line {file.points[bad[0]].line}"
            raise InputError(f"{where}: latitude {lat[bad[0]]:g}, longitude {lon[bad[0]]:g}: exchanged?")
        if file.crs == "EPSG:4979":
            return xyz
        xyz = xyz[:, [1, 0, 2]]
    out = geodetic_from_crs(xyz, crs)
    bad = np.flatnonzero(~np.isfinite(out).all(axis=1))
    if len(bad):
        point = file.points[bad[0]]
        raise InputError(
            f"{file.path}, line {point.line}: {point.xyz} lies outside {crs}: wrong CRS or exchanged axes?"
        )
    return out


def surveyed_world(file: GcpFile, origin: Origin) -> np.ndarray:
    """(P, 3) a file's points in the world of an origin. Raises InputError for coordinates outside their CRS."""
    xyz = np.array([p.xyz for p in file.points], float).reshape(-1, 3)
    crs = file.crs or origin.crs
    if crs == origin.crs:
        return xyz - np.asarray(origin.shift_m)
    return world_from_geodetic(_geodetic(xyz, crs, file), origin)


def _check_place(file: GcpFile, world: np.ndarray, scene: Scene) -> None:
    """Points must lie near the survey's positions; the error tells if exchanged axes would bring them there, even over
    short distances: plane coordinates of a country lie about the origin of its zone."""
    prior = scene.world_from_rig[:, :3, 3]
    prior = prior[np.isfinite(prior).all(axis=1)]
    if scene.origin is None or not len(prior):
        return
    middle = np.median(prior, axis=0)
    away = np.linalg.norm(world[:, :2] - middle[:2], axis=1)
    reach = NEAR_M + float(np.max(np.linalg.norm(prior[:, :2] - middle[:2], axis=1)))
    far = np.flatnonzero(away > reach)
    if not len(far):
        return
    point = file.points[far[0]]
    swapped = (point.xyz[1], point.xyz[0], point.xyz[2])
    hint = ": wrong CRS in the file?" if away[far[0]] > FAR_M else ""
    try:
        turned = surveyed_world(replace(file, points=(replace(point, xyz=swapped),)), scene.origin)
        if np.linalg.norm(turned[0, :2] - middle[:2]) < (reach if away[far[0]] < FAR_M else FAR_M):
            hint = f": its first two coordinates are exchanged ({'lon, lat' if file.geographic else 'north, east'})"
    except InputError:
        pass
    if not hint:
        return
    raise InputError(
        f"{file.path}, line {point.line}: point {point.name!r} lies {away[far[0]] / 1000:.0f} km from the survey's "
        f"positions{hint}"
    )
