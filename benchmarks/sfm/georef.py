"""Georeferencing against truth, on models that ``benchmarks/run.py --keep`` left.

Three ways on the same model: ``frames`` (similarity to one interpolated position a frame, antenna at the camera),
``rows`` (every row of the receiver, lever arm and clock where observable), ``adjusted`` (then the bundle adjustment, if
it stands its check). ``--cases``: bad positions on a set, and a simulated corridor with an outage.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from benchmarks import datasets
from benchmarks.sfm.corridor import Corridor, corridor
from tiegraph.errors import TiegraphError
from tiegraph.geometry.geodesy import geodetic_from_world, world_from_geodetic
from tiegraph.geometry.transforms import umeyama
from tiegraph.pipeline.files import load_npz
from tiegraph.project.settings import Settings
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.control import Control, locate
from tiegraph.scene.gcp import read_gcps
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.covariance import position_sigma
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.shape import SHAPE, Shape
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.fixes import Measurements, PositionRows
from tiegraph.sfm.world.georef import Georeference
from tiegraph.sfm.world.georeferencing import ConstantParameters, georeference_model

WAYS = ("frames", "rows", "adjusted")
SETS = ("canal", "canal_demo", "pandaset", "oppaiyama")


class Survey:
    """A data set with the model, scene and positions of one kept run."""

    def __init__(self, name: str, out: Path, work: Path) -> None:
        self.dataset = datasets.load(name, work)
        self.scene = Scene.from_json((out / "network" / "scene.json").read_text()).measured()
        self.model = pycolmap.Reconstruction(str(out / "sparse" / "0"))
        sparse = Settings().sparse
        rigs = tuple(k + 1 for k, mode in rig_modes(self.scene, sparse.rig).items() if mode == "fixed")
        self.held = ConstantParameters(rigs, believed_cameras(self.scene, sparse))
        shape = out / "sparse" / SHAPE
        self.given = Measurements(self.rows(), self.control(), Shape(**load_npz(shape)) if shape.exists() else None)

    def rows(self) -> PositionRows | None:
        """The receiver's rows in the scene's world."""
        if self.dataset.gnss is None or self.scene.prior != "gnss" or self.scene.origin is None:
            return None
        gnss = read_gnss(self.dataset.gnss)
        place = world_from_geodetic(gnss.lat_lon_height, self.scene.origin)
        return PositionRows(gnss.time_s, place, gnss.sigma_m)

    def control(self) -> Control | None:
        """Surveyed points of the set."""
        path = self.dataset.images.parent / "gcp_list.txt"
        return locate(read_gcps(path), self.scene) if path.exists() else None


def georeferenced(survey: Survey, way: str, given: Measurements) -> tuple[Georeference, Any, float]:
    """Georeference, model in the world, CPU seconds."""
    start = time.process_time()
    if way == "frames":
        settings, given = GeorefSettings(adjust="no", antenna="ignored"), replace(given, rows=None)
    else:
        settings = GeorefSettings(adjust="auto" if way == "adjusted" else "no")
    found, world = georeference_model(survey.model, survey.scene, settings, Tuning(), given, survey.held)
    return found, world, time.process_time() - start


def errors(survey: Survey, found: Georeference, world: Any) -> dict[str, Any]:
    """Distances of projection centres to the truth: after SE3, after Sim3, and as placed; and what was predicted."""
    dataset = survey.dataset
    names = [n for n in dataset.cam_from_world if (i := world.find_image_with_name(n)) is not None and i.has_pose]
    here = np.array([world.find_image_with_name(n).projection_center() for n in names])
    true = np.array([dataset.centres_m()[n] for n in names])
    rigid, free = umeyama(here, true, with_scale=False), umeyama(here, true)
    se3, sim3 = (np.linalg.norm(f(here) - true, axis=1) for f in (rigid, free))
    out: dict[str, Any] = {"images": len(names), "ate_se3_m": _rms(se3), "ate_se3_max_m": float(se3.max())}
    out |= {"ate_sim3_m": _rms(sim3), "scale_off": float(free.scale - 1), "predicted": found.uncertainty.sigma}
    if found.uncertainty.shape is not None:
        out["predicted_inner_m"] = found.uncertainty.shape.sizes()["median"]
        out["actual_inner_m"] = _inner(survey, names, here, true)
    if dataset.truth_origin is not None and found.origin is not None:
        placed = world_from_geodetic(geodetic_from_world(here, found.origin), dataset.truth_origin)
        off = placed - true
        fit = umeyama(placed, true)
        lean = Rotation.from_matrix(fit.rotation).as_rotvec(degrees=True)
        middle = off.mean(axis=0)
        out["actual"] = {
            "position_m": float(np.hypot(middle[0], middle[1])), "height_m": float(abs(middle[2])),
            "yaw_deg": float(abs(lean[2])), "tilt_deg": float(np.hypot(*lean[:2])), "scale": float(abs(fit.scale - 1)),
        }  # fmt: skip
        out["absolute_plan_m"] = _rms(np.linalg.norm(off[:, :2], axis=1))
        out["absolute_height_m"] = _rms(off[:, 2])
    return out


def _inner(survey: Survey, names: list[str], here: np.ndarray, true: np.ndarray) -> float:
    """Median error of the reference cameras by their own Sim3: of the frames, without the rig's extrinsics."""
    scene = survey.scene
    of = np.array([scene.sensor[scene.image_index[n]] == 0 if n in scene.image_index else False for n in names])
    return float(np.median(np.linalg.norm(umeyama(here[of], true[of])(here[of]) - true[of], axis=1)))


def held_out(found: Georeference) -> dict[str, float]:
    """Held-out positions by the blind similarity: robust root mean square per axis in stated sigmas, and how many."""
    placing = found.placing
    blind = None if placing is None else placing.held_out(bends=False)
    if placing is None or blind is None:
        return {}
    fixes = placing.fixes
    squares = np.sum((blind / fixes.sigma) ** 2, axis=1)[fixes.held]
    return {"held_out": int(fixes.held.sum()), "held_out_sigmas": float(np.sqrt(np.median(squares) / 2.366))}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def measure_set(survey: Survey, ways: tuple[str, ...] = WAYS) -> dict[str, Any]:
    """All ways on one set."""
    out = {}
    for way in ways:
        given = survey.given
        found, world, cpu = georeferenced(survey, way, given)
        row = errors(survey, found, world) | held_out(found)
        row |= {"cpu_s": round(cpu, 1), "adjusted": found.adjusted, "antenna_m": found.antenna_m}
        row |= {
            "clock_s": found.clock_offset_s,
            "accuracy": found.control.accuracy,
            "notes": list(found.findings.notes),
        }
        out[way] = row
    return out


# --- bad positions --------------------------------------------------------------------------------------------------


def bad_cases(survey: Survey, way: str = "adjusted") -> dict[str, Any]:
    """What becomes of a set whose positions are spoilt in one way each."""
    rows = survey.rows()
    assert rows is not None
    out = {}
    for name, spoilt in _spoilt(rows, survey).items():
        scene = survey.scene
        try:
            bad = _with_rows(survey, spoilt)
            found, world, _ = georeferenced(bad, way, replace(survey.given, rows=spoilt, control=None))
            out[name] = errors(bad, found, world) | {"notes": list(found.findings.notes), "adjusted": found.adjusted}
        except TiegraphError as error:
            out[name] = {"error": str(error)}
        survey.scene = scene
    return out


def _spoilt(rows: PositionRows, survey: Survey) -> dict[str, PositionRows]:
    rng = np.random.default_rng(5)
    outliers = rows.position_m.copy()
    bad = rng.random(len(outliers)) < 0.1
    outliers[bad] += 20 * rng.standard_normal((int(bad.sum()), 3))
    half = rows.time_s < np.median(rows.time_s)
    drift = rows.position_m.copy()
    late = (rows.time_s > np.quantile(rows.time_s, 0.15)) & (rows.time_s < np.quantile(rows.time_s, 0.3))
    drift[late] += [1.5, -1.0, 2.0]
    first = PositionRows(*(v[half] for v in (rows.time_s, rows.position_m, rows.sigma_m)))
    return {
        "as it is": rows,
        "10 % gross outliers (20 m)": replace(rows, position_m=outliers),
        "a pass without GNSS": first,
        "multipath: 15 % of the time 2.7 m off, sigma as before": replace(rows, position_m=drift),
        "east and north exchanged": replace(rows, position_m=rows.position_m[:, [1, 0, 2]]),
        "sigma stated ten times too small": replace(rows, sigma_m=rows.sigma_m / 10),
        "clock 0.3 s off": replace(rows, time_s=rows.time_s + 0.3),
    }


def _with_rows(survey: Survey, rows: PositionRows) -> Survey:
    """The survey whose scene has the positions that these rows give its frames."""
    scene = survey.scene
    at = np.full((scene.frames, 3), np.nan)
    sigma = np.full((scene.frames, 3), np.nan)
    for f, t in enumerate(scene.time_s):
        k = int(np.argmin(np.abs(rows.time_s - t)))
        if abs(rows.time_s[k] - t) < 0.5:
            at[f], sigma[f] = rows.position_m[k], rows.sigma_m[k]
    poses = np.full((scene.frames, 4, 4), np.nan)
    poses[:, :3, 3] = at
    survey.scene = scene.with_(world_from_rig=poses, position_sigma_m=sigma)
    return survey


# --- receivers of known errors ------------------------------------------------------------------------------------


ANTENNA = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]]) @ ([0.93 - 0.06, 0.58, 0.32])  # of the canal's boat, by cam0
# name: stated sigma (m), white and slow errors over it, and how long the latter last (s)
RECEIVERS = {
    "RTK": (0.02, 0.7, 0.7, 60.0),
    "RTK, white": (0.02, 1.0, 0.0, 60.0),
    "float, wanders": (0.35, 0.2, 1.0, 30.0),
    "code, slow": (2.0, 0.2, 1.0, 300.0),
    "three times as bad": (0.02, 2.1, 2.1, 60.0),
    "ten times as good": (5.0, 0.07, 0.07, 60.0),
}


def receivers(survey: Survey, seeds: int) -> dict[str, Any]:
    """Positions with errors of known kind on the true path of the antenna of a canal, with all of what a receiver's
    errors have in common as well (0.7 of the stated sigma): actual errors over the predicted sigmas, root mean square
    over the draws, and the share within one sigma."""
    path = _antenna_path(survey)
    out: dict[str, Any] = {}
    for given in (True, False):
        for name, (sigma_m, white, slow, lasts_s) in RECEIVERS.items():
            ratios = []
            for seed in range(seeds):
                made = _received(path, sigma_m * np.array([1, 1, 1.6]), (white, slow, lasts_s), seed)
                scene = survey.scene
                rigs = tuple(replace(r, antenna_m=tuple(ANTENNA) if given else None) for r in scene.rigs)
                bad = _with_rows(survey, made)
                bad.scene = bad.scene.with_(rigs=rigs)
                found, world, _ = georeferenced(bad, "rows", replace(survey.given, rows=made, control=None))
                survey.scene = scene
                actual = errors(bad, found, world)["actual"] if found.uncertainty.sigma else {}
                ratios.append([v / max(found.uncertainty.sigma[k], 1e-9) for k, v in actual.items()])
            z = np.array([r for r in ratios if r])
            names = ("position_m", "height_m", "yaw_deg", "tilt_deg", "scale")
            out[f"{name}, antenna {'given' if given else 'not given'}"] = {
                "rms": dict(zip(names, np.sqrt(np.mean(z**2, axis=0)).round(2).tolist())), "draws": len(z),
                "within": float(np.mean(z < 1).round(2)),
            }  # fmt: skip
    return out


def _antenna_path(survey: Survey) -> dict[str, np.ndarray]:
    """``time_s`` (G,) of the receiver's rows within passes and the true ``place`` (G, 3) of the antenna, in the scene's
    world."""
    scene, data, rows = survey.scene, survey.dataset, survey.rows()
    at = np.full((scene.frames, 3), np.nan)
    for name, pose in data.cam_from_world.items():
        if name in scene.image_index and "cam0" in name:
            at[scene.frame[scene.image_index[name]]] = (np.linalg.inv(pose) @ [*ANTENNA, 1.0])[:3]
    assert data.truth_origin is not None and scene.origin is not None and rows is not None
    known = np.isfinite(at).all(axis=1)
    at[known] = world_from_geodetic(geodetic_from_world(at[known], data.truth_origin), scene.origin)
    times, places = [], []
    for track in range(len(scene.sequences)):
        own = np.flatnonzero(known & (scene.sequence == track))
        own = own[np.argsort(scene.time_s[own])]
        span = scene.time_s[own]
        inside = rows.time_s[(rows.time_s >= span[0]) & (rows.time_s <= span[-1])]
        times.append(inside)
        places.append(CubicSpline(span, at[own])(inside))
    order = np.argsort(np.concatenate(times))
    return {"time_s": np.concatenate(times)[order], "place": np.concatenate(places)[order]}


def _received(
    path: Mapping[str, np.ndarray],
    sigma: np.ndarray,
    kind: tuple[float, float, float],
    seed: int,
    common: float = 0.7,
) -> PositionRows:
    """Rows of a receiver on a path (``time_s`` (G,), ``place`` (G, 3)) with errors of a kind."""
    time_s, place, rng, (white, slow, lasts_s) = path["time_s"], path["place"], np.random.default_rng(seed), kind
    z = rng.standard_normal(place.shape)
    for k in range(1, len(z)):
        keeps = np.exp(-(time_s[k] - time_s[k - 1]) / lasts_s)
        z[k] = keeps * z[k - 1] + np.sqrt(1 - keeps**2) * z[k]
    off = white * rng.standard_normal(place.shape) + slow * z + max(white, slow, 0.7) * common * rng.standard_normal(3)
    return PositionRows(time_s, place + sigma * off, np.tile(sigma, (len(place), 1)))


# --- simulated corridor ---------------------------------------------------------------------------------------------


def outage(length_m: float, gap_m: float, radial: float, seed: int) -> dict[str, Any]:
    """A corridor without positions over ``gap_m`` in its middle: error in the gap, over its length."""
    made = corridor(length_m, radial=radial, seed=seed)
    model = final_adjustment(made.model, [1], range(1, 5), tuning=Tuning().adjust).model
    sigma = position_sigma(model, (), (), tuning=Tuning())
    shape = Shape.of(model, sigma, made.scene)
    rows = receiver_rows(made, gap_m, seed)
    scene = with_positions(made.scene, rows)
    s = np.arange(len(made.truth)) * 2.0
    inside = np.abs(s - length_m / 2) < gap_m / 2
    out: dict[str, Any] = {"length_m": length_m, "gap_m": gap_m, "radial": radial, "seed": seed}
    out["images_alone_m"] = (
        None if shape is None else round(shape.sizes()["median"], 4)
    )  # the model is metric by its rig
    for way, adjust in (("similarity", "no"), ("adjusted", "yes")):
        settings = GeorefSettings(adjust=adjust)
        start = time.process_time()
        found, world = georeference_model(
            model, scene, settings, Tuning(), Measurements(rows, shape=shape), ConstantParameters((1,), range(1, 5))
        )
        place = frame_poses(image_poses(world, scene), scene)[:, :3, 3]
        off = np.linalg.norm(place - made.truth[:, :3, 3], axis=1)
        row = {"rms_m": _rms(off), "worst_in_gap_m": float(off[inside].max()), "cpu_s": time.process_time() - start}
        row |= _in_plan(found, place, made.truth[:, :3, 3], inside)
        row["drift"] = row["worst_in_gap_m"] / gap_m
        out[way] = {n: round(v, 5) for n, v in row.items()} | {"predicted_m": found.uncertainty.sigma.get("position_m")}
    return out


def receiver_rows(
    made: Corridor,
    gap_m: float,
    seed: int,
    sigma_m: float = 0.02,
    *,
    white: float = 1.0,
    slow: float = 0.0,
    lasting: np.ndarray | float = 0.0,
) -> PositionRows:
    """Rows at 5 Hz beside a gap; errors over the stated sigma, of which the slow ones last a minute, and metres (3,)
    that all share."""
    time_s, place = made.scene.time_s, made.truth[:, :3, 3]
    fine = np.arange(time_s[0], time_s[-1], 0.2)
    at = np.stack([np.interp(fine, time_s, place[:, k]) for k in range(3)], axis=1)
    s, sigma = 1.5 * fine, np.tile([sigma_m, sigma_m, 2 * sigma_m], (len(fine), 1))
    open_sky = np.abs(s - s[-1] / 2) >= gap_m / 2
    path = {"time_s": fine, "place": at}
    noise = _received(path, sigma[0], (white, slow, 60.0), seed + 100, common=0.0).position_m - at + lasting
    return PositionRows(fine[open_sky], (at + noise)[open_sky], sigma[open_sky])


def _in_plan(found: Georeference, place: np.ndarray, true: np.ndarray, inside: np.ndarray) -> dict[str, float]:
    """Errors and stated sigmas of frames an axis in plan (root mean square), in the gap and beside it."""
    known, frames = found.uncertainty, np.arange(len(place))
    if known.error is None or known.shape is None:
        return {}
    own = np.sqrt(np.sum(known.shape.at(frames) ** 2, axis=2))
    both = {"error": (place - true)[:, :2], "sigma": np.hypot(known.error.sigma(place), own)[:, :2]}
    rows = {"in_gap": inside, "beside": ~inside}
    return {f"plan_{n}_{w}_m": float(np.sqrt(np.mean(v[r] ** 2))) for n, v in both.items() for w, r in rows.items()}


def with_positions(scene: Scene, rows: PositionRows) -> Scene:
    poses = np.full((scene.frames, 4, 4), np.nan)
    sigma = np.full((scene.frames, 3), np.nan)
    for f, t in enumerate(scene.time_s):
        k = int(np.argmin(np.abs(rows.time_s - t)))
        if abs(rows.time_s[k] - t) < 0.3:
            poses[f, :3, 3], sigma[f] = rows.position_m[k], rows.sigma_m[k]
    return scene.with_(world_from_rig=poses, position_sigma_m=sigma, prior="gnss")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=Path, default=Path(), help="folder with <set>-tiegraph-0/out or <set>/out")
    parser.add_argument("--sets", nargs="*", default=list(SETS))
    parser.add_argument("--ways", nargs="*", default=list(WAYS))
    parser.add_argument("--cases", nargs="*", default=[], help="bad, outage, receivers")
    parser.add_argument(
        "--corridor", type=float, nargs=2, default=(400.0, 100.0), help="length and gap of an outage, m"
    )
    parser.add_argument("--seeds", type=int, default=2, help="of the corridor, of receivers")
    parser.add_argument("--bad-way", default="adjusted", help="way of the bad cases: rows or adjusted")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    results: dict[str, Any] = json.loads(options.out.read_text()) if options.out and options.out.exists() else {}
    with tempfile.TemporaryDirectory() as work:
        for name in options.sets:
            found = [
                p for p in (options.runs / f"{name}-tiegraph-0" / "out", options.runs / name / "out") if p.is_dir()
            ]
            survey = Survey(name, found[0], Path(work))
            results.setdefault("sets", {}).setdefault(name, {}).update(measure_set(survey, tuple(options.ways)))
            if "receivers" in options.cases and name.startswith("canal"):
                results.setdefault("receivers", {})[name] = receivers(survey, options.seeds)
            if "bad" in options.cases and survey.rows() is not None:
                results.setdefault("bad", {})[name] = bad_cases(survey, options.bad_way)
    if "outage" in options.cases:
        results["outage"] = [outage(*options.corridor, r, seed) for r in (0.0, 0.005) for seed in range(options.seeds)]
    text = json.dumps(results, indent=1, default=float)
    if options.out:
        options.out.write_text(text + "\n")
    print(table(results))  # noqa: T201


def table(results: dict[str, Any]) -> str:
    """The figures in lines."""
    lines = []
    for name, ways in results.get("sets", {}).items():
        for way, r in ways.items():
            plan, height = (r.get(f"absolute_{n}_m", float("nan")) for n in ("plan", "height"))
            lines.append(
                f"{name:11s} {way:9s} SE3 {r['ate_se3_m']:.4f} max {r['ate_se3_max_m']:.3f} Sim3 {r['ate_sim3_m']:.4f} "
                f"plan {plan:.3f} height {height:.3f} held-out {r.get('held_out_sigmas', float('nan')):.2f} sigma, "
                f"CPU {r['cpu_s']} s, adjusted {r['adjusted']}"
            )
            for key, actual in (r.get("actual") or {}).items():
                lines.append(f"{'':21s} {key}: predicted {r['predicted'][key]:.4f} actual {actual:.4f}")
    for name, cases in results.get("bad", {}).items():
        for case, r in cases.items():
            done = f"SE3 {r['ate_se3_m']:.4f}, plan {r.get('absolute_plan_m', 0):.3f}" if "error" not in r else ""
            lines.append(f"{name}: {case}: " + (r.get("error") or f"{done}, adjusted {r['adjusted']}"))
    for name, kinds in results.get("receivers", {}).items():
        lines += [f"{name}: {kind}: {r['rms']}, {r['within']:.0%} within a sigma" for kind, r in kinds.items()]
    for r in results.get("outage", []):
        head = f"outage {r['gap_m']} m of {r['length_m']} m, radial {r['radial']}, seed {r['seed']}: "
        worst = {w: r[w] for w in ("similarity", "adjusted")}
        lines.append(
            head + "; ".join(f"{w} {v['worst_in_gap_m']:.3f} m = {100 * v['drift']:.3f} %" for w, v in worst.items())
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
