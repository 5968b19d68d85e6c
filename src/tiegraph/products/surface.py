"""A reference surface: its frame (u, v, w) and the raster over (u, v), and the windows of that raster.

Those of a survey are chosen: a map where its cameras look down, walls where they look sideways; curved ones if they
are asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.products import frame as curved
from tiegraph.products.frame import Frame
from tiegraph.products.settings import ProductsSettings
from tiegraph.products.tuning import ChooseTuning
from tiegraph.scene.graph import parts
from tiegraph.scene.results import Cloud
from tiegraph.scene.sorting import evenly
from tiegraph.text import round_above

NODATA = -9999.0
MAP, UNDERSIDE = "map", "underside"
_SERIES = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)  # of sizes of pixels
_FEWEST = 10  # points on a reference plane at least
_FITTED = 5000  # points by which a curved one is found
_EDGE = 33  # places along an edge of a window of a curved surface


@dataclass(frozen=True)
class Window:
    """A part of a raster: first row and column, rows and columns, in pixels; it may lie beyond the raster."""

    row: int
    column: int
    rows: int
    columns: int

    def grown(self, margin: int) -> "Window":
        """The same with a margin all round."""
        return Window(
            self.row - margin, self.column - margin, rows=self.rows + 2 * margin, columns=self.columns + 2 * margin
        )


@dataclass(frozen=True, eq=False)
class Surface:
    """A frame, the corners (3,) of its box in (u, v, w), the edge of a pixel in world units (0 = not chosen yet), and
    the share of the points that it has (NaN = not found by its points).

    Files have (u, v, w) plus ``offset`` (3,): for a map the shift to its CRS, for a wall its height. There the
    corners in u and v are whole pixels; row 0 lies at the largest v. A surface seen from below has w downwards, and
    heights in its files, from ``zero``.
    """

    name: str
    frame: Frame
    low: np.ndarray
    high: np.ndarray
    pixel_m: float = 0.0
    share: float = float("nan")
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    zero: str = ""

    @property
    def from_below(self) -> bool:
        """Whether it is seen from below."""
        return self.name.startswith(UNDERSIDE)

    @property
    def level(self) -> bool:
        """Whether it lies in the CRS, as a map."""
        return self.name == MAP or self.from_below

    @property
    def file_from_uvw(self) -> np.ndarray:
        """(4, 4) from (u, v, w) to the coordinates of the files."""
        return transforms.rigid(np.diag([1.0, 1.0, -1.0 if self.from_below else 1.0]), self.offset)

    def heights(self, w: np.ndarray) -> np.ndarray:
        """w (...) as the files have it."""
        turn, shift = self.file_from_uvw[2, 2:].astype(np.float32)
        return turn * w + shift

    def w(self, heights: np.ndarray) -> np.ndarray:
        """The inverse of ``heights``."""
        turn, shift = self.file_from_uvw[2, 2:].astype(np.float32)
        return turn * (heights - shift)

    @property
    def axes(self) -> tuple[str, ...]:
        """The directions of u, v and w in words."""
        if self.level:
            return "east", "north", f"up{self.zero and f' from {self.zero}'}"
        if self.frame.tube:
            return "along the axis", "round from the crown", "towards the axis"
        return "along the wall", "up", "out of the wall"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its rasters."""
        columns, rows = np.round((self.high - self.low)[:2] / self.pixel_m).astype(int)
        return int(rows), int(columns)

    def windows(self, size: int) -> list[Window]:
        """Tiles of ``size`` pixels, those at the border smaller."""
        rows, columns = self.shape
        starts = [(r, c) for r in range(0, rows, size) for c in range(0, columns, size)]
        return [Window(r, c, rows=min(size, rows - r), columns=min(size, columns - c)) for r, c in starts]

    def places(self, window: Window, step: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """u (columns,) and v (rows,) of the centres of a window's pixels, or of blocks of ``step`` pixels."""
        columns, rows = np.arange(0, window.columns, step), np.arange(0, window.rows, step)
        u = self.low[0] + (window.column + columns + step / 2) * self.pixel_m
        return u, self.high[1] - (window.row + rows + step / 2) * self.pixel_m

    def box(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) in the world of the box along its axes around a window, for all w of the surface."""
        share = np.linspace(0, 1, 2 if self.frame.nodes is None else _EDGE)
        u = self.low[0] + (window.column + share * window.columns) * self.pixel_m
        v = self.high[1] - (window.row + share * window.rows) * self.pixel_m
        xyz = self.frame.in_world(*np.meshgrid(u, v, [self.low[2], self.high[2]]))
        beyond = 0.0 if len(share) == 2 else np.abs(np.diff(xyz, axis=1)).max() + np.abs(np.diff(xyz, axis=0)).max()
        return xyz.min(axis=(0, 1, 2)) - beyond, xyz.max(axis=(0, 1, 2)) + beyond

    def above(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) in the world of all that lies above and below a window of a map, or beyond the border there."""
        low, high = self.box(window)
        first = window.column == 0, window.row + window.rows == self.shape[0], True
        last = window.column + window.columns == self.shape[1], window.row == 0, True
        return np.where(first, -np.inf, low), np.where(last, np.inf, high)


def project(camera: Pinhole, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixel coordinates x, y (...) of world points (..., 3), and their depths (...); NaN where not in the image."""
    xy, z = camera.project(xyz)
    outside = ~camera.inside(xy)
    x, y = np.moveaxis(xy, -1, 0)
    for values in (x, y, z):
        values[outside] = np.nan
    return x, y, z


# --- the choice -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Survey:
    """Data for the choice: a sample of the cloud, the images, the points' spacing, the shift (3,) from the world to
    the CRS, the path (F, 3) of the cameras in its order, and the height of the water if it is known; lengths in
    ``unit`` (m, or units of a model without scale)."""

    sample: Cloud
    views: Sequence[Pinhole]
    spacing: float
    shift: np.ndarray
    unit: str = "m"
    path: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    water: float | None = None

    @property
    def centres(self) -> np.ndarray:
        """(N, 3) projection centres."""
        return transforms.centre(np.array([v.cam_from_world for v in self.views]))

    @property
    def looking(self) -> np.ndarray:
        """(N, 3) directions of the optical axes."""
        return np.array([v.cam_from_world[2, :3] for v in self.views])


def choose(survey: Survey, settings: ProductsSettings, tuning: ChooseTuning) -> tuple[list[Surface], list[str]]:
    """The surfaces whose rasters are made, and remarks with reasons. Raises ReconstructionError for a reference plane
    on which no points lie, and where no curved one fits the path and the points."""
    if settings.make == "none":
        return [], ["nothing is made, by products.make"]
    down = -float(survey.looking[:, 2].mean())
    sideways = float(np.mean(np.abs(survey.looking[:, 2]) < np.sin(np.radians(tuning.sideways_deg))))
    auto = settings.make == "auto"
    wants_map = settings.make in ("map", "both") or (auto and down >= tuning.down)
    given = settings.plane is not None and settings.make != "map"
    wants_walls = settings.make in ("elevations", "both") or (auto and sideways >= tuning.least_sideways)
    found = []
    if wants_map:
        low, high = survey.sample.xyz_m[:, 2].min(), survey.sample.xyz_m[:, 2].max()
        beyond, out = high - low, np.array([np.inf, np.inf])  # a sample lacks the highest
        found.append(
            Surface(MAP, Frame(np.eye(4)), low=np.append(-out, low - beyond), high=np.append(out, high + beyond))
        )
    if settings.unroll is not None:
        found += _unrolled(survey, settings.unroll, tuning)
    elif given:
        found.append(_given(survey, settings.plane, tuning))  # type: ignore[arg-type]
    elif wants_walls:
        found += walls(survey, tuning)
    if (auto and settings.unroll is None) or settings.make == "undersides":
        found += undersides(survey, tuning)
    lean = f"{abs(np.degrees(np.arcsin(down))):.0f} deg {'down' if down > 0 else 'up'}"
    looks = f"{sideways:.0%} of the cameras look sideways, all on average {lean}"
    if not found:
        no_wall = f", and no vertical plane has {tuning.least_share:.0%} of the points" if wants_walls else ""
        return [], [f"no raster is made: {looks}{no_wall}; products.make = map makes one nevertheless"]
    planes = ", ".join(s.name for s in found if s.frame.nodes is None)
    why = [f"chosen by the view directions ({looks}): {planes}"] if auto and planes else []
    if settings.unroll is not None and settings.plane is not None:
        why.append("products.plane has no effect beside products.unroll")
    made = [_trimmed(s, survey, settings, tuning) for s in found]
    shares = [f"{s.name}: {s.share:.0%} of the points" for s in made if np.isfinite(s.share)]
    for s in (s for s in made if s.frame.tube):
        least, most = f"{s.frame.around[1].min():.4g}", f"{s.frame.around[1].max():.4g}"
        shares.append(f"{s.name}: radius {least}{f' to {most}' if least != most else ''} {survey.unit}")
    sizes = [f"{s.name}: {s.shape[1]} x {s.shape[0]} pixels of {s.pixel_m:g} {survey.unit}" for s in made]
    return made, [*why, *shares, *sizes]


def walls(survey: Survey, tuning: ChooseTuning) -> list[Surface]:
    """The largest vertical planes of the points, each tried with the point and normal of one of them."""
    xyz, normal = survey.sample.xyz_m, survey.sample.normal
    free = np.abs(normal[:, 2]) < np.sin(np.radians(tuning.upright_deg))  # False for NaN too
    found: list[Surface] = []
    while len(found) < tuning.walls and free.sum() >= _FEWEST:
        at = np.flatnonzero(free)
        tried = np.random.default_rng(0).permutation(at)[:400]  # planes that are tried for each wall
        planes = [_plane(xyz[k], normal[k]) for k in tried]
        near = [_near(survey, Frame(plane), tuning.flatness) for plane in planes]
        votes = [np.count_nonzero(_on(xyz[at], normal[at], p, n, tuning)) for p, n in zip(planes, near)]
        best = int(np.argmax(votes))
        plane, within = planes[best], near[best]
        for _ in range(5):  # times a plane is fitted to the points near it
            on = at[_on(xyz[at], normal[at], plane, within, tuning)]
            plane = _fitted(xyz[on], plane)
        share = len(on) / len(xyz)
        if share < tuning.least_share:
            break
        deep = within / tuning.flatness * tuning.reach
        low, high = np.array([-np.inf, -np.inf, -deep]), np.array([np.inf, np.inf, deep])
        name = f"elevation{len(found) + 1}"
        found.append(Surface(name, Frame(plane), low=low, high=high, share=share))
        free[at] &= np.abs(transforms.apply(plane, xyz[at])[:, 2]) > deep
    return found


def undersides(survey: Survey, tuning: ChooseTuning) -> list[Surface]:
    """What hangs over cameras, such as the deck of a bridge or a ceiling, from below: a surface for each connected part
    that has enough of all such points, the largest first. Parts are cells in plan as wide as the points hang high."""
    xyz, cameras = survey.sample.xyz_m, survey.centres
    nearest = cKDTree(cameras[:, :2]).query(xyz[:, :2])[1]
    high = xyz[:, 2] - cameras[nearest, 2]
    hangs = (survey.sample.normal[:, 2] < -np.cos(np.radians(tuning.upright_deg))) & (high > 0)
    if hangs.sum() < _FEWEST:
        return []
    own, size = xyz[hangs], np.median(high[hangs])
    cells, of = np.unique(np.floor(own[:, :2] / size), axis=0, return_inverse=True)
    tree = cKDTree(cells)
    one, other = tree.query_pairs(1, p=np.inf, output_type="ndarray").T
    joined = parts(one, other, len(cells))
    below = tree.query(np.floor(cameras[:, :2] / size), distance_upper_bound=0.5)[1]
    part, passed = joined[of.ravel()], np.append(joined, -1)[below]  # -1: of places without a cell
    count = np.bincount(part)
    found = []
    for k in sorted(set(passed[passed >= 0]), key=lambda k: -count[k]):
        if count[k] < tuning.least_share * len(own):
            break
        (left, right), (lower, upper), (_, top) = (_ends(values) for values in own[part == k].T)
        camera = float(np.median(cameras[passed == k, 2]))
        found.append(
            Surface(
                f"{UNDERSIDE}{len(found) + 1}",
                Frame(np.diag([1.0, 1.0, -1.0, 1.0])),
                low=np.array([left, lower, -top - size]),
                high=np.array([right, upper, -camera]),
                share=float(count[k] / len(xyz)),
                zero="" if survey.water is None else "the water",
            )
        )
    return found


def _plane(point: np.ndarray, outwards: np.ndarray) -> np.ndarray:
    """surface_from_world of the vertical plane through a point (3,), w along a direction (3,)."""
    w = np.array([outwards[0], outwards[1], 0.0]) / np.hypot(outwards[0], outwards[1])
    axes = np.stack([np.cross([0.0, 0.0, 1.0], w), [0.0, 0.0, 1.0], w])
    return transforms.rigid(axes, -axes @ (np.asarray(point, float) * [1, 1, 0]))  # v is the height


def _near(survey: Survey, frame: Frame, share: float) -> float:
    """A share of the median distance from a surface of the cameras in front that look at it, or else of all."""
    uvw = frame.uvw(survey.centres)
    away, towards = uvw[:, 2], frame.gradients(*uvw.T)[:, 2]
    front = away[(away > 0) & (np.sum(survey.looking * towards, axis=1) < 0)]
    return share * float(np.median(front if len(front) else np.abs(away)))


def _on(xyz: np.ndarray, normal: np.ndarray, plane: np.ndarray, within: float, tuning: ChooseTuning) -> np.ndarray:
    along = normal @ plane[2, :3] > np.cos(np.radians(tuning.upright_deg))
    return along & (np.abs(xyz @ plane[2, :3] + plane[2, 3]) < within)


def _fitted(xyz: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """The vertical plane of least squares through points (M, 3), facing as another one does."""
    middle = xyz.mean(axis=0)
    flat = (xyz - middle)[:, :2]
    across = np.linalg.eigh(flat.T @ flat)[1][:, 0]
    return _plane(middle, across * np.sign(across @ plane[2, :2] or 1.0))


def _given(survey: Survey, ends: tuple[float, float, float, float], tuning: ChooseTuning) -> Surface:
    """The plane through two places of the CRS, the first one at the left."""
    left, right = (np.array(e) - survey.shift[:2] for e in (ends[:2], ends[2:]))
    along = right - left
    said = f"products.plane = {', '.join(f'{e:.10g}' for e in ends)}"
    if not np.hypot(*along) > 0:
        raise ReconstructionError(f"{said}: its two ends are one place; give the left and the right end of a wall")
    plane = _plane(np.array([*left, 0.0]), np.array([along[1], -along[0], 0.0]))
    deep = _near(survey, Frame(plane), tuning.reach)
    start = float(plane[0, :2] @ left + plane[0, 3])
    low, high = np.array([start, -np.inf, -deep]), np.array([start + np.hypot(*along), np.inf, deep])
    found = Surface("elevation1", Frame(plane), low=low, high=high)
    if np.count_nonzero(_inside(found, survey.sample)) < _FEWEST:
        low, high = (
            v[:2] + survey.shift[:2] for v in (survey.sample.xyz_m.min(axis=0), survey.sample.xyz_m.max(axis=0))
        )
        raise ReconstructionError(
            f"{said}: no points of the cloud lie within {deep:.3g} {survey.unit} of this plane between its ends; the "
            f"cloud reaches from {low[0]:.2f} to {high[0]:.2f} east and from {low[1]:.2f} to {high[1]:.2f} north"
        )
    return found


def _unrolled(survey: Survey, kind: str, tuning: ChooseTuning) -> list[Surface]:
    """The curved surfaces of a kind along the path, the largest first."""
    cloud = survey.sample.where(evenly(len(survey.sample), _FITTED))
    fits = (
        curved.walls(survey.path, cloud, tuning)
        if kind == "wall"
        else curved.tunnel(survey.path, cloud, tuning, circle=kind == "tunnel")
    )
    found = []
    for k, (frame, share) in enumerate(fits, 1):
        _, axes, bend = frame.axis(frame.stations)
        turns = np.sum(bend * axes[:, 1], axis=1) if not frame.tube else np.zeros(1)
        deep, ends = _near(survey, frame, tuning.reach), frame.around[2][[0, -1]] if frame.tube else [-np.inf, np.inf]
        room = [min(deep, curved.TIGHTEST / max(1e-9, (sign * turns).max())) for sign in (-1, 1)]
        low, high = np.array([0.0, ends[0], -room[0]]), np.array([frame.stations[-1], ends[1], room[1]])
        found.append(Surface(kind if frame.tube else f"{kind}{k}", frame, low=low, high=high, share=share))
    return found


def _inside(surface: Surface, cloud: Cloud) -> np.ndarray:
    uvw = surface.frame.uvw(cloud.xyz_m)
    return np.all((uvw >= surface.low) & (uvw <= surface.high), axis=1)


def _ends(values: np.ndarray) -> tuple[float, float]:
    """The least and the greatest of values as far as they follow each other: strays lie beyond a gap of a twentieth of
    the range of the middle 99 %."""
    ordered = np.sort(values)
    low, high = np.quantile(ordered, [0.005, 0.995])
    gap = np.diff(ordered) > (high - low) / 20
    before, behind = np.flatnonzero(gap & (ordered[1:] <= low)), np.flatnonzero(gap & (ordered[:-1] >= high))
    return ordered[before[-1] + 1 if len(before) else 0], ordered[behind[0] if len(behind) else -1]


def _trimmed(surface: Surface, survey: Survey, settings: ProductsSettings, tuning: ChooseTuning) -> Surface:
    """The surface with the size of its pixels, and a box of whole pixels around the points that images resolve, without
    strays."""
    own = survey.sample.xyz_m[_inside(surface, survey.sample)]
    own = own[evenly(len(own), 10_000)]  # points of a surface for its extent and the resolution of the images
    sizes = np.full(len(own), np.nan)  # of a pixel of the nearest image that sees a point
    for view in survey.views:
        sizes = np.fmin(sizes, project(view, own)[2] / view.focal)
    gsd = float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 0.0
    pixel = settings.pixel_m or round_above(max(gsd, survey.spacing / 2), _SERIES)
    near = sizes <= tuning.coarsest * pixel
    if settings.pixel_m and gsd and not near.any():
        best = float(np.nanmin(sizes))
        raise ReconstructionError(
            f"products.pixel_m = {pixel:g}: no image resolves {surface.name} better than by {best:.2g} {survey.unit}; "
            f"give {round_above(best / tuning.coarsest, _SERIES):g} or more, or leave it out"
        )
    uv = surface.frame.uvw(own[near] if near.any() else own)[:, :2]
    low, high = np.transpose([_ends(values) for values in uv.T])
    low = np.where(np.isfinite(surface.low), surface.low, np.append(low, 0.0))  # given limits are kept
    high = np.where(np.isfinite(surface.high), surface.high, np.append(high, 0.0))
    frame, offset = surface.frame, survey.shift
    if surface.from_below and survey.water is not None:
        offset = np.append(offset[:2], -survey.water)
    if not surface.level:  # u counts from the left end, v is the height, or counts from the crown
        offset = np.array([0.0, 0.0 if frame.tube else survey.shift[2], 0.0])
        from_left = transforms.rigid(np.eye(3), np.array([-low[0], 0, 0]))
        frame = replace(frame, surface_from_world=from_left @ frame.surface_from_world)
        low, high = low - [low[0], 0, 0], high - [low[0], 0, 0]
    low[:2] = np.floor((low + offset)[:2] / pixel + 1e-6) * pixel - offset[:2]
    high[:2] = np.ceil((high + offset)[:2] / pixel - 1e-6) * pixel - offset[:2]
    return replace(surface, frame=frame, low=low, high=high, pixel_m=pixel, offset=offset)
