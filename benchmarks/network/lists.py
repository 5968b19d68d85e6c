"""One competitor's pair list, in a process of its own: ``python lists.py METHOD --run FOLDER --out list.txt``.

``FOLDER`` is a run folder that ``tiegraph`` has brought to the stage ``preview`` (names, frames, positions, features).
The COLMAP methods are pycolmap's own pair generators with their defaults on a database without features.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import zlib  # noqa: F401  pycolmap must not be the first to load zlib
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import pycolmap

from tiegraph.features.preview import Preview
from tiegraph.network.loose import nearest_images
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.scene import Scene

NEAREST = 40  # images retrieved for each
Pair = tuple[str, str]


def exhaustive(scene: Scene, run: Path) -> list[Pair]:
    """Every two images."""
    return list(combinations(scene.names, 2))


def sequential(scene: Scene, run: Path) -> list[Pair]:
    """COLMAP, sequential, each camera of each pass by itself."""
    out: list[Pair] = []
    label = np.stack([scene.sequence[scene.frame], scene.sensor_key])
    for one in np.unique(label, axis=1).T:
        own = np.flatnonzero((label == one[:, None]).all(axis=0))
        out += _generated(scene, own, False, pycolmap.SequentialPairGenerator, pycolmap.SequentialPairingOptions())
    return out


def sequential_names(scene: Scene, run: Path) -> list[Pair]:
    """COLMAP, sequential, all images in the order of their names, no rig: what its defaults do with folders."""
    everything = np.arange(len(scene))
    return _generated(scene, everything, False, pycolmap.SequentialPairGenerator, pycolmap.SequentialPairingOptions())


def sequential_rig(scene: Scene, run: Path) -> list[Pair]:
    """COLMAP, sequential by name with the rig known and ``expand_rig_images``, each pass by itself."""
    out: list[Pair] = []
    track = scene.sequence[scene.frame]
    options = pycolmap.SequentialPairingOptions(expand_rig_images=True)
    for one in np.unique(track):
        out += _generated(scene, np.flatnonzero(track == one), True, pycolmap.SequentialPairGenerator, options)
    return out


def spatial(scene: Scene, run: Path) -> list[Pair]:
    """COLMAP, spatial: the 50 nearest images within 100 m; the images of a frame share its position prior."""
    everything = np.arange(len(scene))
    return _generated(scene, everything, True, pycolmap.SpatialPairGenerator, pycolmap.SpatialPairingOptions())


def retrieval(scene: Scene, run: Path) -> list[Pair]:
    """The 40 most similar images of each by tiegraph's own vocabulary, learnt on the set."""
    descriptors = []
    for name in scene.names:
        with np.load(run / "preview" / f"{name}.npz") as data:
            descriptors.append(Preview.from_npz(dict(data)).descriptors)
    found, _ = nearest_images(descriptors, NEAREST)
    return [(scene.names[i], scene.names[j]) for i, row in enumerate(found) for j in row if j >= 0]


def vlad(scene: Scene, run: Path) -> list[Pair]:
    """The 40 most similar images of each by VLAD of the previews' SIFT (Jegou 2010), 64 centres learnt on the set."""
    words = [_descriptors(run, name) for name in scene.names]
    centres = _centres(np.concatenate(words)[:: max(1, sum(map(len, words)) // 100_000)], 64)
    rows = np.stack([_vlad(w, centres) for w in words])
    out = []
    for k, row in enumerate(rows):
        cosine = rows @ row
        cosine[k] = -np.inf
        out += [(scene.names[k], scene.names[j]) for j in np.argsort(-cosine)[:NEAREST]]
    return out


METHODS: dict[str, Callable[[Scene, Path], list[Pair]]] = {
    "exhaustive": exhaustive,
    "sequential": sequential,
    "sequential_names": sequential_names,
    "sequential_rig": sequential_rig,
    "spatial": spatial,
    "vlad": vlad,
    "retrieval": retrieval,
}
NEED_PREVIEWS = ("vlad", "retrieval")


def _descriptors(run: Path, name: str) -> np.ndarray:
    with np.load(run / "preview" / f"{name}.npz") as data:
        return Preview.from_npz(dict(data)).descriptors.astype(np.float32) / 512


def _centres(x: np.ndarray, count: int, rounds: int = 15) -> np.ndarray:
    """k-means of unit vectors (K, 128), started at every so many-th."""
    centres = x[:: max(1, len(x) // count)][:count].copy()
    for _ in range(rounds):
        own = _closest(x, centres)
        total = np.bincount(own, minlength=len(centres))
        for axis in range(x.shape[1]):
            centres[:, axis] = np.bincount(own, x[:, axis], minlength=len(centres)) / np.maximum(total, 1)
    return centres


def _closest(x: np.ndarray, centres: np.ndarray) -> np.ndarray:
    return (x @ centres.T - 0.5 * np.sum(centres**2, axis=1)).argmax(axis=1)


def _vlad(x: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Residuals summed by centre, each centre's of length 1, signed square root, whole of length 1 (C * 128,)."""
    own = _closest(x, centres)
    out = np.zeros_like(centres)
    np.add.at(out, own, x - centres[own])
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    out = np.sign(out) * np.sqrt(np.abs(out))
    return (out / max(float(np.linalg.norm(out)), 1e-9)).ravel()


def _generated(scene: Scene, own: np.ndarray, with_rig: bool, generator: type, options: object) -> list[Pair]:
    """What a generator of pycolmap makes of some images (K,) of the scene."""
    part = _part(scene, own)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "database.db"
        create_database(path, part if with_rig else _apart(part))
        with pycolmap.Database.open(str(path)) as database:
            if generator is pycolmap.SpatialPairGenerator:
                _write_priors(database, part)
            pairs = generator(options, database).all_pairs()
            names = {image.image_id: image.name for image in database.read_all_images()}
    return [(names[a], names[b]) for a, b in pairs]


def _apart(scene: Scene) -> Scene:
    """The scene with rigs of unknown extrinsics: no two images share a frame."""
    rigs = [replace(r, sensors=tuple(replace(s, sensor_from_rig=None) for s in r.sensors)) for r in scene.rigs]
    return scene.with_(rigs=tuple(rigs))


def _write_priors(database: pycolmap.Database, scene: Scene) -> None:
    """The frame's position for each of its images, as COLMAP would take it from their EXIF."""
    database.clear_pose_priors()
    measured = scene.measured().world_from_rig[scene.frame, :3, 3]
    for k in np.flatnonzero(np.isfinite(measured).all(axis=1)):
        prior = pycolmap.PosePrior()
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, int(scene.sensor_key[k]) + 1)
        prior.corr_data_id = pycolmap.data_t(sensor, int(k) + 1)
        prior.position = measured[k]
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        database.write_pose_prior(prior)


def _part(scene: Scene, own: np.ndarray) -> Scene:
    """The scene of some images (K,), in order."""
    frames, frame = np.unique(scene.frame[own], return_inverse=True)
    columns = ("rig", "sequence", "sequence_index", "time_s", "world_from_rig", "position_sigma_m", "section")
    return scene.with_(
        names=tuple(scene.names[k] for k in own),
        sources=tuple(scene.sources[k] for k in own) if scene.sources else (),
        frame=frame,
        sensor=scene.sensor[own],
        **{name: getattr(scene, name)[frames] for name in columns},
    )


def main() -> None:
    """Write the list: two names a line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("method", choices=sorted(METHODS))
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    scene = Scene.from_json((given.run / "scene.json").read_text())
    pairs = METHODS[given.method](scene, given.run)
    given.out.write_text("".join(f"{a} {b}\n" for a, b in sorted({(min(p), max(p)) for p in pairs})))


if __name__ == "__main__":
    main()
