"""Glue of marking: a run and the points of a file, their predicted places in the images, and the file of marks."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import make_origin, middle
from tiegraph.geometry.transforms import Similarity, umeyama
from tiegraph.pipeline.files import checked, load_json, load_model, read_colours, scanned, world_origin
from tiegraph.project.run import Run
from tiegraph.project.stages import write_atomic
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.control import Marks, image_lookup, surveyed_world
from tiegraph.scene.gcp import FileMark, GcpFile, parse_crs_line, read_gcps, read_points
from tiegraph.scene.names import found_by
from tiegraph.scene.rig import prepared_pixel, source_pixel
from tiegraph.scene.scene import Scene
from tiegraph.sfm.world.marks import Target, targets
from tiegraph.targets.marks import seen_in
from tiegraph.text import csv_text

_THREE = 3  # places, for a similarity


class ChangedMeanwhile(InputError):
    """The file of marks was changed by another program since it was read or written here."""


@dataclass
class Marking:
    """Points, images and marks of one session. ``marks``: prepared pixels by (point, image) rows."""

    run: Run
    scene: Scene
    file: GcpFile
    target: Path
    crs: str
    model: Any  # pycolmap.Reconstruction or None
    surveyed: np.ndarray  # (P, 3) in the world of the model if that is placed, else up to a similarity
    placed: bool
    marks: dict[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    written: str = ""  # digest of the file as last known, "" = not there

    @cached_property
    def views(self) -> dict[int, tuple[np.ndarray, pycolmap.Camera]]:
        """Posed images by scene index."""
        if self.model is None:
            return {}
        index = self.scene.image_index
        images = (i for i in self.model.images.values() if i.has_pose and i.name in index)
        return {index[i.name]: (matrix(i.cam_from_world()), i.camera) for i in images}

    def state(self) -> dict[str, Any]:
        """Content of the page: points with their marks, predicted places and residuals; images."""
        found = self._found()
        views, fit = self.views, self._model_from_survey(found)
        points = [self._point(k, found[k], views, fit) for k in range(len(self.file.points))]
        images = [{"name": self.scene.names[k], "posed": k in views} for k in range(len(self.scene))]
        return {
            "points": points, "images": images, "file": str(self.target), "placed": self.placed,
            "posed": len(views), "predicting": fit is not None, "wanted": _THREE,
        }  # fmt: skip

    def set(self, point: int, image: int, xy: tuple[float, float] | None) -> None:
        """Set or remove one mark and write the file. Raises ChangedMeanwhile; InputError for a pixel outside."""
        if not 0 <= point < len(self.file.points) or not 0 <= image < len(self.scene):
            raise InputError("no such point or image")
        if xy is not None:
            height, width = self.pixels(image).shape[:2]
            if not (0 <= xy[0] <= width and 0 <= xy[1] <= height):
                raise InputError(f"({xy[0]:.1f}, {xy[1]:.1f}) lies outside the image of {width} x {height} pixels")
        before = dict(self.marks)
        self.marks.pop((point, image), None)
        if xy is not None:
            self.marks[point, image] = xy
        try:
            self._write()
        except InputError:
            self.marks = before
            raise

    def pixels(self, image: int) -> np.ndarray:
        """(H, W, 3) of a prepared image, BGR."""
        return read_colours(self.run.path("images", self.scene.names[image]))

    def _write(self) -> None:
        if _digest(self.target) != self.written:
            raise ChangedMeanwhile(
                f"{self.target} was changed by another program: nothing was written over it. End, look at the file, "
                "and start again"
            )

        def rendered(image: int) -> bool:
            source = self.scene.sensor_of(image).source
            return source is not None and source.rendered

        marks = []
        for (point, k), xy in sorted(self.marks.items()):
            image = self.scene.names[k] if rendered(k) else self.scene.source_name(k)
            marks.append(
                FileMark(self.file.points[point].name, image, source_pixel(xy, self.scene.sensor_of(k)), line=0)
            )
        make = gcp_csv if self.target.suffix.lower() == ".csv" else odm_text
        write_atomic(self.target, make(self.file, self.crs, marks))
        self.written = _digest(self.target)

    def _found(self) -> list[Target]:
        count, rows = len(self.file.points), sorted(self.marks)
        if self.model is None:
            nowhere = Target(
                place=np.full(3, np.nan),
                covariance=np.full((3, 3), np.nan),
                marks=np.zeros(0, int),
                residual_px=np.zeros((0, 2)),
                why_not="no image has a pose",
            )
            return [nowhere] * count
        marks = Marks(
            point=np.array([p for p, _ in rows], int),
            image=np.array([k for _, k in rows], int),
            xy_px=np.array([self.marks[r] for r in rows], float).reshape(-1, 2),
            line=np.zeros(len(rows), int),
            sigma_px=np.full(len(rows), np.nan),
        )
        return targets(self.model, self.scene, marks, count, self.run.settings.tuning.sfm.world.marks)

    def _model_from_survey(self, found: list[Target]) -> Similarity | None:
        """From surveyed coordinates to the model: by three points that are marked, else by the model's placement."""
        known = [k for k, t in enumerate(found) if not t.why_not]
        if len(known) >= _THREE:
            places = self.surveyed[known]
            spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if len(known) >= _THREE and spread[1] > 0.02 * spread[0]:  # not along one line, about which it could rotate
            return umeyama(self.surveyed[known], np.array([found[k].place for k in known]))
        return Similarity() if self.placed else None

    def _point(
        self, row: int, target: Target, views: dict[int, tuple[np.ndarray, pycolmap.Camera]], fit: Similarity | None
    ) -> dict[str, Any]:
        point = self.file.points[row]
        known = not target.why_not and bool(np.isfinite(target.place).all())
        place = target.place if known else None if fit is None else fit(self.surveyed[row][None])[0]
        predicted = {} if place is None else seen_in(views, place)
        marked = {k: xy for (p, k), xy in self.marks.items() if p == row}
        rows = sorted(self.marks)
        off = {rows[m][1]: np.linalg.norm(r) for m, r in zip(target.marks, target.residual_px)} if known else {}
        apart = None
        if known and fit is not None:
            apart = round(float(np.linalg.norm(fit(self.surveyed[row][None])[0] - target.place) / fit.scale), 4)
        images = [
            {
                "image": k, "predicted": predicted.get(k), "mark": marked.get(k),
                "off_px": round(float(off[k]), 2) if k in off and np.isfinite(off[k]) else None,
            }
            for k in dict.fromkeys([*marked, *predicted])
        ]  # fmt: skip
        residuals = [v for v in off.values() if np.isfinite(v)]
        return {
            "name": point.name, "check": point.check, "xyz": point.xyz, "images": images, "marks": len(marked),
            "rms_px": round(float(np.sqrt(np.mean(np.square(residuals)))), 2) if residuals else None,
            "off_m": apart, "why_not": "" if known else target.why_not,
        }  # fmt: skip


def open_marking(run: Run, points: Path | None, target: Path) -> Marking:
    """A session over a run folder that has been scanned. Marks in ``target`` are kept.

    Raises InputError for a file without points or CRS, and a target with points which are not among them.
    """
    given = points or run.settings.georef.gcp
    if given is None:
        raise InputError("--points FILE: name, x, y, z of each point (# crs: EPSG:n in the first line)")
    file = read_points(given)
    scene = checked(run) if run.path("network", "scene.json").exists() else scanned(run)
    world = run.path("world.json")
    origin = world_origin(run.folder) if world.exists() else None
    placed = origin is not None and bool(load_json(world).get("placed"))
    crs = file.crs or (origin.crs if origin is not None else scene.origin.crs if scene.origin is not None else None)
    if crs is None:
        raise InputError(f"--points {given}: the CRS of its coordinates is unknown: begin it with # crs: EPSG:n")
    parse_crs_line(crs, str(given))
    folder = next((f for f in (run.path("sparse", "world"), run.path("sparse", "0")) if f.exists()), None)
    if origin is None:
        xyz = np.array([p.xyz for p in file.points])
        here = make_origin(*middle(xyz)) if file.geographic else None
        surveyed = xyz - xyz.mean(axis=0) if here is None else surveyed_world(file, here)
    else:
        surveyed = surveyed_world(file, origin)
    session = Marking(
        run=run, scene=scene, file=file, target=target, crs=crs, surveyed=surveyed, placed=placed,
        model=None if folder is None else load_model(folder),
    )  # fmt: skip
    _go_on(session, file)
    return session


def _go_on(session: Marking, given: GcpFile) -> None:
    """Read the marks of the target file, or those of the points' own file if there is none yet."""
    session.written = _digest(session.target)
    if session.written:
        given = read_gcps(session.target)
        if given.bars:
            raise InputError(f"{session.target} contains scale bars, which would be lost: give another -o")
    names = {p.name: k for k, p in enumerate(session.file.points)}
    lookup = image_lookup(session.scene)
    for mark in given.marks:
        image = found_by(lookup, mark.image)
        if mark.name not in names or image is None:
            what = f"point {mark.name!r}" if mark.name not in names else f"image {mark.image!r}"
            raise InputError(
                f"{session.target if session.written else given.path}, line {mark.line}: {what} is not among those of "
                "this session and would be lost: give another -o"
            )
        session.marks[names[mark.name], image] = prepared_pixel(mark.xy, session.scene.sensor_of(image))


def _digest(path: Path) -> str:
    return hashlib.blake2b(path.read_bytes()).hexdigest() if path.exists() else ""


def odm_text(file: GcpFile, crs: str, marks: Sequence[FileMark]) -> str:
    """A gcp_list.txt: a row a mark, check points with the word ``check``. Raises InputError for names with blanks."""
    rows = [crs]
    points = {p.name: p for p in file.points}
    for mark in marks:
        point = points[mark.name]
        bad = next((n for n in (mark.name, mark.image) if not n or len(n.split()) != 1), None)
        if bad is not None:
            raise InputError(f"{bad!r} has blanks, not possible in a gcp_list.txt: give -o a name that ends in .csv")
        x, y, z = (point.xyz[k] for k in ((1, 0, 2) if file.geographic else (0, 1, 2)))
        place = f"{x:.10g} {y:.10g} {z:.6g}" if file.geographic else f"{x:.4f} {y:.4f} {z:.4f}"
        role = " check" if point.check else ""
        rows.append(f"{place} {mark.xy[0]:.3f} {mark.xy[1]:.3f} {mark.image} {mark.name}{role}")
    return "\n".join(rows) + "\n"


def gcp_csv(file: GcpFile, crs: str, marks: Sequence[FileMark]) -> str:
    """A CSV with a table of points and a table of marks."""
    heads = ["name", *(("lat", "lon", "height") if file.geographic else "xyz"), "sigma_xy", "sigma_z", "role"]
    points = (
        [p.name, *(repr(v) for v in p.xyz), p.sigma_m[0], p.sigma_m[2], "check" if p.check else "gcp"]
        for p in file.points
    )
    placed = ([m.name, m.image, f"{m.xy[0]:.3f}", f"{m.xy[1]:.3f}"] for m in marks)
    return f"# crs: {crs}\n{csv_text(heads, points)}{csv_text(['name', 'image', 'px', 'py'], placed)}"
