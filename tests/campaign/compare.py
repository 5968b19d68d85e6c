"""Is a run's result the clean run's? One function, one list of how each artefact is compared."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  zlib before pycolmap
from tiegraph.geometry.geodesy import Origin
from tiegraph.pipeline import STAGES

# How far a result may be from the clean run's where an input was changed:
INPUT_POSE_M = 0.3  # a projection centre: three sigmas of a position of this survey
INPUT_CLOUD_SHARE = 0.2  # the number of points, and of the pixels with a depth
_INEXACT_FROM = "report"  # the first stage whose result tells of the run itself, its times
_PAIR_BASE = 2147483647


def owned(folder: Path) -> dict[str, str]:
    """{path below a run folder: the stage that makes it} of every artefact file; temporary files are left out."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_dir() or ".part" in path.name or path.name.endswith(("-shm", "-wal", "-journal")):
            continue
        name = path.relative_to(folder).as_posix()
        for stage in reversed(STAGES):
            if any(name == made or name.startswith(f"{made}/") for made in stage.makes):
                found[name] = stage.name
                break
    return found


def left_over(clean: Path, other: Path, besides: Collection[str] = ()) -> list[str]:
    """Files and folders below run folder ``other`` that the clean run does not have: temporary files, files set aside.
    ``besides``: files of the user; what SQLite keeps beside an open database is not counted, nor is the lock."""
    known = {p.relative_to(clean).as_posix() for p in clean.rglob("*")}
    users = {part.as_posix() for name in besides for part in (Path(name), *Path(name).parents)}
    found = {p.relative_to(other).as_posix() for p in other.rglob("*")} - known - users
    return sorted(n for n in found if not n.endswith(("-shm", "-wal")))


def differences(clean: Path, other: Path, besides: Collection[str] = (), until: str = STAGES[-1].name) -> list[str]:
    """What is different in run folder ``other``, in words; [] = the same survey. ``besides``: files of the user."""
    names = [s.name for s in STAGES]
    order = {n: k for k, n in enumerate(names)}
    last = order[until]
    a = {n: s for n, s in owned(clean).items() if order[s] <= last}
    b = {n: s for n, s in owned(other).items() if order[s] <= last and n not in besides}
    out = [f"{n} is missing" for n in sorted(a.keys() - b.keys())]
    out += [f"{n} is too many" for n in sorted(b.keys() - a.keys())]
    for name in sorted(a.keys() & b.keys()):
        exact = order[a[name]] < order[_INEXACT_FROM]
        check = _check_of(name) if exact else None
        try:
            if check is not None and (text := check(clean / name, other / name)):
                out.append(f"{name}: {text}")
        except Exception as error:  # an artefact that cannot be read is a difference too
            out.append(f"{name}: cannot be read ({type(error).__name__}: {error})")
    return out


def _check_of(name: str) -> Callable[[Path, Path], str]:
    if name.endswith(".npz"):
        return _arrays
    return _database if name.endswith(".db") else _bytes


def _bytes(a: Path, b: Path) -> str:
    return "" if a.read_bytes() == b.read_bytes() else "other bytes"


def _arrays(a: Path, b: Path) -> str:
    with np.load(a) as x, np.load(b) as y:
        if set(x.files) != set(y.files):
            return "other arrays"
        different = [n for n in x.files if x[n].dtype != y[n].dtype or x[n].tobytes() != y[n].tobytes()]
    return f"other values of {', '.join(different)}" if different else ""


def _database(a: Path, b: Path) -> str:
    x, y = _tables(a), _tables(b)
    return "" if x == y else f"other rows ({sum(x.get(k) != v for k, v in y.items())} of {len(y)})"


def _tables(path: Path) -> dict:
    """Key points by image, matches and verified geometry by pair of images."""
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as base:
        names = dict(base.execute("select image_id, name from images"))
        out = {("keypoints", names[k]): v for k, *v in base.execute("select * from keypoints")}
        for table in ("matches", "two_view_geometries"):
            for pair, *rest in base.execute(f"select * from {table}"):
                ids = (names.get(pair // _PAIR_BASE, pair), names.get(pair % _PAIR_BASE, pair))
                out[(table, *ids)] = rest
    return out


def summary(folder: Path, until: str = STAGES[-1].name) -> dict:
    """What a survey came to: {"images", "centres": {name: latitude, longitude, height or model place}, "points",
    "depths", "metrics"} as far as the stages up to ``until`` made it."""
    order = {s.name: k for k, s in enumerate(STAGES)}
    out: dict = {}
    if order[until] >= order["georef"]:
        out["centres"], out["span"] = _centres(folder)
    if order[until] >= order["dense"]:
        out["depths"] = sum(_pixels(p) for p in sorted((folder / "depth").rglob("*.npz")))
    if order[until] >= order["cloud"]:
        import laspy

        with laspy.open(folder / "cloud.laz") as cloud:
            out["points"] = cloud.header.point_count
    if order[until] >= order["evaluate"]:
        out["metrics"] = json.loads((folder / "metrics.json").read_text())
    if order[until] >= order["report"]:
        out["report"] = (folder / "report.html").stat().st_size > 10000
    return out


def stated_sigma(folder: Path) -> float:
    """How well the run itself says that positions in the world are known, in metres."""
    path = folder / "receipts" / "georef.json"
    counts = json.loads(path.read_text()).get("counts", {}) if path.exists() else {}
    return float(counts.get("sigma_position_m", 0.0))


def _pixels(path: Path) -> int:
    with np.load(path) as data:
        return sum(int(np.isfinite(data[n]).sum()) for n in data.files if "depth" in n)


def _centres(folder: Path) -> tuple[dict[str, np.ndarray], float]:
    """({image: projection centre (3,) in metres east, north, up about the clean survey's place}, length of the survey
    in the units of its coordinate system: a wrong system shows there only)."""
    import pycolmap

    import worlds
    from tiegraph.geometry.geodesy import geodetic_from_world, world_from_geodetic

    model = pycolmap.Reconstruction(str(folder / "sparse" / "world"))
    found = {i.name: i.projection_center() for i in model.images.values() if i.has_pose}
    span = _span(found) if found else 0.0
    origin = json.loads((folder / "world.json").read_text()).get("origin")
    if not origin or not found:
        return found, span
    place = Origin(origin["lat_deg"], origin["lon_deg"], origin["height_m"], origin["crs"], tuple(origin["shift_m"]))
    centres = world_from_geodetic(geodetic_from_world(np.stack(list(found.values())), place), worlds.ORIGIN)
    return dict(zip(found, centres)), span


def outcome_differences(
    clean: dict, other: dict, pose_m: float, share: float, without: Collection[str] = ()
) -> list[str]:
    """How two summaries differ beyond the tolerances, in words; ``without``: images that the other cannot have."""
    out = []
    a = {n: c for n, c in clean.get("centres", {}).items() if n not in without}
    b = other.get("centres", {})
    if not a.keys() <= b.keys() or (not without and len(a) != len(b)):
        out.append(f"{len(b)} images in the model instead of {len(a)}")
    elif a:
        shift = max(float(np.linalg.norm(a[n] - b[n])) for n in a)
        if not shift <= pose_m:
            out.append(f"the poses differ by {shift:.3g} m")
        if not without and not abs(other["span"] - clean["span"]) <= max(2 * pose_m, 0.01 * clean["span"]):
            out.append(f"the survey is {other['span']:.3f} long instead of {clean['span']:.3f}")
    for name in ("points", "depths"):
        if name in clean and not abs(other[name] - clean[name]) <= share * clean[name]:
            out.append(f"{other[name]} {name} instead of {clean[name]}")
    if clean.get("report") != other.get("report"):
        out.append("the report is empty")
    if "metrics" in clean and set(clean["metrics"]) != set(other["metrics"]):
        out.append(f"other metrics: {sorted(set(clean['metrics']) ^ set(other['metrics']))}")
    return out


def _span(centres: dict[str, np.ndarray]) -> float:
    places = np.stack(list(centres.values()))
    return float(np.linalg.norm(places[:, None] - places[None], axis=2).max())
