"""The surveys of the bench: small, with truth; and the faults that each can be given."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import datasets
from benchmarks.confront import rendered
from benchmarks.confront.faults import (
    APART_S,
    EVERYTHING,
    FAULTS,
    STRANGERS,
    Fault,
    Wronged,
    amplitudes,
    apart,
    strangers,
)
from benchmarks.confront.given import Given, Picture, of_dataset, read_positions
from benchmarks.sfm.georef import ANTENNA
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama

# Of the truth itself. Strecha and KITTI: what another program's model says too (benchmarks/sfm/README.md, agree.py);
# PandaSet: how well the images fit its poses (0.019 m), which agree with its GNSS to 4 cm.
_TRUTH = {
    "fountain-P11": (0.003, 0.02), "Herz-Jesus-P8": (0.005, 0.02), "Herz-Jesus-P25": (0.007, 0.02),
    "kitti_stereo": (0.017, 0.6), "pandaset": (0.02, 0.1),
}  # fmt: skip
_RENDERED = {"boat": ("boat", 8), "vehicle": ("vehicle", 12), "tiny": ("boat", 4)}
PIECE = 30
# A receiver with fixed ambiguities whose antenna is measured, so that place and height can be judged: set:rtk
_ANTENNA_M = {"boat": (0.0, 0.0, 0.0), "vehicle": (0.0, 0.0, 0.0), "canal_demo": tuple(ANTENNA.tolist())}


def names() -> list[str]:
    """All sets: rendered ones, those of ``datasets.py``, and PandaSet in pieces of 30 frames."""
    pieces = [f"pandaset:{k}" for k in (0, 10, 20)]
    return [
        *_RENDERED,
        "canal_demo",
        *(f"{name}:rtk" for name in _ANTENNA_M),
        *pieces,
        "kitti_stereo",
        "kitti_stereo:20",
        "fountain-P11",
        "Herz-Jesus-P8",
        "Herz-Jesus-P25",
    ]


def load(name: str, work: Path) -> Given:
    """The clean survey. Raises InputError where a data set is not there, ValueError for an unknown name."""
    if name not in names():
        raise ValueError(f"unknown set {name!r}: {', '.join(names())}")
    base, _, piece = name.partition(":")
    if base in _RENDERED:
        given = rendered.survey(work / "rendered" / base, *_RENDERED[base])
        return with_antenna(given, base) if piece else given
    dataset = datasets.load(base, work / "datasets")
    given = of_dataset(dataset, _focal_px(base))
    sigma_m, sigma_deg = _TRUTH.get(base, (0.0, 0.0))
    given = replace(given, truth=replace(given.truth, sigma_m=sigma_m, sigma_deg=sigma_deg))
    if piece == "rtk":
        rtk = read_positions(datasets.data_root() / base / "sensors" / "gnss_rtk.csv")
        return with_antenna(replace(given, positions=rtk), base)
    if base == "pandaset":
        given = cut(_anchored(given), int(piece), PIECE)
    elif piece:
        given = cut(given, 0, int(piece))
    return given


def with_antenna(given: Given, name: str) -> Given:
    """The survey with its antenna in the rig file."""
    assert given.rig is not None
    return replace(given, rig=replace(given.rig, antenna_m=_ANTENNA_M[name]))


def _focal_px(name: str) -> dict[str, float]:
    if not name.startswith("canal"):
        return {}
    data = json.loads((datasets.data_root() / name / "gt" / "intrinsics.json").read_text())
    return {camera: (k["fx"] + k["fy"]) / 2 for camera, k in data.items()}


def _anchored(given: Given) -> Given:
    """The truth put on the Earth by the clean positions, which it agrees with (rigidly, with its own scale)."""
    p, truth = given.positions, given.truth
    assert p is not None
    stamps = [(n, t) for n, t in given.times.items() if p.time_s[0] <= t <= p.time_s[-1]]
    at = np.stack([np.interp([t for _, t in stamps], p.time_s, p.enu_m[:, k]) for k in range(3)], axis=1)
    own = np.stack([transforms.centre(truth.cam_from_world[n]) for n, _ in stamps])
    # Its up is up already, and a straight track would leave the roll about it to chance.
    fit = umeyama(own * [1, 1, 0], at * [1, 1, 0], with_scale=False)
    fit = replace(fit, translation=fit.translation + [0, 0, float(np.mean(at[:, 2] - own[:, 2]))])
    back = transforms.invert(fit.matrix)
    return replace(
        given,
        truth=replace(truth, cam_from_world={n: t @ back for n, t in truth.cam_from_world.items()}, origin=p.origin),
    )


def cut(given: Given, first: int, count: int) -> Given:
    """Some of the frames; the receiver's rows to a second before and after."""
    frames = set(given.in_order()[first : first + count])
    keep = [n for n in given.images if given.frame_of(n) in frames]
    times = {n: t for n, t in given.times.items() if n in keep}
    positions = given.positions
    if positions is not None and times:
        near = (positions.time_s > min(times.values()) - 1) & (positions.time_s < max(times.values()) + 1)
        positions = replace(
            positions, time_s=positions.time_s[near], enu_m=positions.enu_m[near], sigma_m=positions.sigma_m[near]
        )
    truth = replace(given.truth, cam_from_world={n: given.truth.cam_from_world[n] for n in keep})
    return replace(given, images={n: given.images[n] for n in keep}, truth=truth, times=times, positions=positions)


def faults_of(name: str, given: Given, work: Path) -> dict[str, Fault]:
    """The table of faults with those that need other pictures: ``apart`` (between two, or rendered), ``stranger``."""
    more = {"stranger": Fault(STRANGERS, strangers(_elsewhere(name, work)), "images", EVERYTHING)}
    make = _apart(name, work)
    return {**FAULTS, **more, **({"apart": Fault(APART_S, make, "time", EVERYTHING)} if make else {})}


def _apart(name: str, work: Path) -> Callable[[Given, float], Wronged | None] | None:
    if name.partition(":")[0] in _RENDERED:
        return partial(_rendered_apart, name, work)
    if name.startswith("kitti"):
        return _kitti_apart
    return None


def _words(late: dict[str, float]) -> str:
    return "cameras fire apart, ms: " + ", ".join(f"{n} {1000 * s:+.0f}" for n, s in late.items())


def _rendered_apart(name: str, work: Path, given: Given, size: float) -> Wronged:
    kind, frames = _RENDERED[name.partition(":")[0]]
    assert given.rig is not None
    late = amplitudes([s.folder for s in given.rig.sensors], size)
    folder = work / "rendered" / f"{name.replace(':', '-')}-{1000 * size:.0f}ms"
    return Wronged(rendered.fired_apart(given, folder, kind, frames, late), _words(late), {})


def _kitti_apart(given: Given, size: float) -> Wronged:
    """Ten frames a second."""
    stamps = {n: int(Path(n).stem) / 10 for n in given.images}
    late = {"image_l": 0.0, "image_r": size}
    return Wronged(apart(given, late, stamps), _words(late), {})


def _elsewhere(name: str, work: Path) -> list[Picture]:
    """Pictures of another place, of a camera with the same size of image."""
    if name.partition(":")[0] in _RENDERED:
        other = rendered.survey(work / "rendered" / "elsewhere", "boat", 4, seed=5)
        return list(other.images.values())
    twin = {
        "canal_demo": "canal",
        "fountain-P11": "Herz-Jesus-P8",
        "Herz-Jesus-P8": "fountain-P11",
        "Herz-Jesus-P25": "fountain-P11",
    }
    if name not in twin:
        return []
    folder = datasets.data_root() / ("canal" if name == "canal_demo" else f"strecha/{twin[name]}") / "images"
    return [Picture(p) for p in sorted(folder.rglob("*.jpg"))[3:40:5]] if folder.is_dir() else []
