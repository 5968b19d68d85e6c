"""Rows of COLMAP's database by SQL: features, matches and verified geometries, read and written in this place only.

COLMAP's own objects (cameras, rigs, frames, images, priors) are written by ``scene.colmaprows``. Ids there are
those of the scene: image_id = scene index + 1; in a database of any origin images go by name (``image_ids``).

The file is in SQLite's WAL mode: what was committed survives the SIGKILL of its writer. ``Rows`` reads without writing
to the file, as COLMAP's own opening does.
"""

import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph import limits
from tiegraph.errors import InputError, TiegraphError, UnreadableArtefact
from tiegraph.scene.atomic import remove, replacing
from tiegraph.scene.colmapmodel import MAX_IMAGES
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

_MADE = ("matches", "two_view_geometries")
_WANTED = "WHERE image_id IN wanted"
# The features of some images, and the others' rows: tables, and which of their rows.
_FEATURES = {
    **dict.fromkeys(("cameras", "rigs", "rig_sensors", "frames", "frame_data", "images"), ""),
    "keypoints": _WANTED,
    "descriptors": _WANTED,
}
# All that a mapper reads besides rigs, frames and priors, and which rows of it some images need.
_MAPPED = {
    "cameras": "",
    "images": _WANTED,
    "keypoints": _WANTED,
    "two_view_geometries": f"WHERE pair_id / {MAX_IMAGES} IN wanted AND pair_id % {MAX_IMAGES} IN wanted",
}

Features = tuple[int, np.ndarray, np.ndarray]


class Rows:
    """A database opened for reading only; ids are COLMAP's. Raises InputError for a file that is not there."""

    def __init__(self, path: Path, any_thread: bool = False) -> None:
        """``any_thread``: the connection may be used by other threads than the one that opened it."""
        if not path.is_file():
            raise InputError(f"database {path} does not exist: run the features stage first")
        uri = f"{path.absolute().as_uri()}?mode=ro"
        self._connection = sqlite3.connect(uri, uri=True, check_same_thread=not any_thread)

    def __enter__(self) -> "Rows":
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def image_names(self) -> dict[int, str]:
        """Names of the images by id."""
        return dict(self._connection.execute("SELECT image_id, name FROM images"))

    def feature_counts(self) -> dict[int, int]:
        """Number of key points by image id."""
        return dict(self._connection.execute("SELECT image_id, rows FROM keypoints"))

    def inlier_counts(self) -> np.ndarray:
        """(P, 3) i8: both image ids and the number of verified matches of each verified pair."""
        found = self._connection.execute("SELECT pair_id, rows FROM two_view_geometries WHERE rows > 0").fetchall()
        return np.array([(*divmod(pair, MAX_IMAGES), count) for pair, count in found], int).reshape(-1, 3)

    def verified(self) -> Iterator[tuple[int, int, np.ndarray]]:
        """Both image ids and the verified matches (K, 2) i8 of each verified pair."""
        query = "SELECT pair_id, rows, data FROM two_view_geometries WHERE rows > 0"
        for pair, rows, data in self._connection.execute(query):
            yield *divmod(pair, MAX_IMAGES), _matches(rows, data)

    def verified_of(self, a: int, b: int) -> np.ndarray:
        """(K, 2) i8 verified matches of two images, in their order; none if there are none."""
        query = "SELECT rows, data FROM two_view_geometries WHERE pair_id = ?"
        row = self._connection.execute(query, (MAX_IMAGES * min(a, b) + max(a, b),)).fetchone()
        matches = _matches(*row) if row and row[0] else np.zeros((0, 2), np.int64)
        return matches if a < b else matches[:, ::-1]

    def keypoints(self) -> Iterator[tuple[int, np.ndarray]]:
        """Image id and key points (K, 2) f8 pixels of each image."""
        for image, *row in self._connection.execute("SELECT image_id, rows, cols, data FROM keypoints"):
            yield image, _points(*row)

    def keypoints_of(self, image: int, columns: int = 2) -> np.ndarray:
        """(K, columns) f8 x, y, scale (pixels), orientation (radians) of an image; none if there are none."""
        query = "SELECT rows, cols, data FROM keypoints WHERE image_id = ?"
        row = self._connection.execute(query, (image,)).fetchone()
        return _points(*row, wanted=columns) if row and row[0] else np.zeros((0, columns))

    def descriptors_of(self, image: int) -> np.ndarray:
        """(K, 128) u1 descriptors of an image; none if there are none."""
        query = "SELECT rows, data FROM descriptors WHERE image_id = ?"
        row = self._connection.execute(query, (image,)).fetchone()
        return np.frombuffer(row[1] if row and row[0] else b"", np.uint8).reshape(-1, 128)

    def cameras(self) -> dict[int, pycolmap.Camera]:
        """Camera of each image by the image's id; images of one camera share it."""
        query = "SELECT camera_id, model, width, height, params, prior_focal_length FROM cameras"
        cameras = {}
        for key, model, width, height, params, prior in self._connection.execute(query):
            model, params = pycolmap.CameraModelId(model), np.frombuffer(params)
            cameras[key] = pycolmap.Camera(camera_id=key, model=model, width=width, height=height, params=params)
            cameras[key].has_prior_focal_length = bool(prior)
        return {k: cameras[c] for k, c in self._connection.execute("SELECT image_id, camera_id FROM images")}


def _matches(rows: int, data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.uint32).reshape(rows, 2).astype(np.int64)


def _points(rows: int, columns: int, data: bytes | None, wanted: int = 2) -> np.ndarray:
    return np.frombuffer(data or b"", np.float32).reshape(rows, columns or 2)[:, :wanted].astype(float)


def image_ids(path: Path, scene: Scene) -> dict[int, int]:
    """Image ids of a database by scene index; images go by name."""
    with Rows(path) as rows:
        names = rows.image_names()
    return {scene.image_index[name]: image_id for image_id, name in names.items() if name in scene.image_index}


def pair_ids(pairs: Pairs) -> np.ndarray:
    """(P,) COLMAP's ids of pairs of scene indices."""
    return (pairs.i.astype(np.int64) + 1) * MAX_IMAGES + pairs.j + 1


def write_features(path: Path, batch: Sequence[Features]) -> None:
    """Write (scene index, keypoints (K, 4) f4, descriptors (K, 128) u1) of several images in one transaction.

    Images written before are replaced. Raises InputError when the disk is full; images of earlier batches stay.
    """
    keypoints, descriptors = [], []
    sift = int(pycolmap.FeatureExtractorType.SIFT)
    for index, points, vectors in batch:
        points, vectors = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(vectors)
        if points.ndim != 2 or points.shape[1] != 4 or vectors.shape != (len(points), 128) or vectors.dtype != np.uint8:
            raise ValueError(f"image {index}: keypoints {points.shape}, descriptors {vectors.shape} {vectors.dtype}")
        keypoints.append((index + 1, len(points), 4, points.tobytes()))
        descriptors.append((index + 1, sift, len(points), 128, vectors.tobytes()))
    with transaction(path) as cursor:
        cursor.executemany("INSERT OR REPLACE INTO keypoints (image_id, rows, cols, data) VALUES (?,?,?,?)", keypoints)
        cursor.executemany(
            "INSERT OR REPLACE INTO descriptors (image_id, type, rows, cols, data) VALUES (?,?,?,?,?)", descriptors
        )


def feature_counts(path: Path) -> dict[int, int]:
    """Number of features (also 0) by scene index, of the images whose key points and descriptors are in and agree."""
    with _opened(path) as connection:
        rows = connection.execute(
            "SELECT k.image_id - 1, k.rows FROM keypoints k JOIN descriptors d USING (image_id) WHERE k.rows = d.rows"
        )
        return dict(rows.fetchall())


def lost_features(path: Path, scene: Scene, wanted: Iterable[int]) -> list[tuple[str, str]]:
    """(image name, reason) of the wanted images without features in the database, or with none found."""
    counts = feature_counts(path)
    blank = "no features were found (blank, blurred or fully masked image)"
    lost = [k for k in sorted(wanted) if not counts.get(k)]
    return [(scene.names[k], blank if k in counts else "no features were written") for k in lost]


def clear_matches(path: Path) -> None:
    """Delete all matches and two-view geometries; features stay."""
    with transaction(path) as cursor:
        cursor.execute("DELETE FROM matches")
        cursor.execute("DELETE FROM two_view_geometries")


def write_anew(path: Path) -> None:
    """Write the file again as if its rows had come in order: equal rows make equal bytes, whatever the order
    in which COLMAP's threads finished, interruptions, and deleted rows.

    No log is left beside it. Raises InputError when the disk has no room for the second copy, and TiegraphError when
    another program reads the file; it then stays unchanged.
    """
    with replacing(path) as temporary:
        with _opened(path) as connection:
            # Otherwise the log would stay, and be applied to the new file.
            connection.execute("PRAGMA journal_mode = DELETE")
            connection.execute("VACUUM INTO ?", (str(temporary),))
        with _opened(temporary) as connection:
            connection.execute("PRAGMA schema_version = 1")  # it counts how often this was done


def keep_finished(path: Path, pairs: Pairs) -> np.ndarray:
    """Delete the rows of pairs that are not wanted or half written; (P,) bool: which of the pairs exist."""
    asked = pair_ids(pairs)
    with transaction(path) as cursor:
        there = {table: {row[0] for row in cursor.execute(f"SELECT pair_id FROM {table}")} for table in _MADE}
        finished = set.intersection(*there.values(), set(asked.tolist()))
        for table, found in there.items():
            cursor.executemany(f"DELETE FROM {table} WHERE pair_id = ?", [(k,) for k in sorted(found - finished)])
    return np.array([k in finished for k in asked.tolist()], bool)


def strike(path: Path, configuration: int) -> None:
    """Remove the verified matches of pairs whose geometry is of this kind."""
    with transaction(path) as cursor:
        cursor.execute("UPDATE two_view_geometries SET rows = 0, data = NULL WHERE config = ?", (configuration,))


def match_counts(path: Path, pairs: Pairs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matches, verified matches and kind of geometry (P,) of each pair; -1 = it is not there."""
    with _opened(path) as connection:
        matches = dict(connection.execute("SELECT pair_id, rows FROM matches"))
        rows = {
            pair: more for pair, *more in connection.execute("SELECT pair_id, rows, config FROM two_view_geometries")
        }
    asked = pair_ids(pairs).tolist()
    verified = np.array([rows.get(pair, (-1, -1)) for pair in asked], np.int64).reshape(-1, 2)
    return np.array([matches.get(pair, -1) for pair in asked], np.int64), verified[:, 0], verified[:, 1]


@contextmanager
def _new(path: Path, source: Path, tables: Mapping[str, str], images: Iterable[int]) -> Iterator[sqlite3.Connection]:
    """A new database, in one transaction, with rows of another one: of some tables, each by a condition, as far as it
    concerns images of some ids (``wanted``)."""
    remove(path)
    pycolmap.Database.open(path).close()
    connection = sqlite3.connect(path, isolation_level=None)
    try:
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute("ATTACH ? AS source", (str(source),))
        connection.execute("BEGIN")
        connection.execute("CREATE TEMP TABLE wanted (image_id INTEGER PRIMARY KEY)")
        connection.executemany("INSERT INTO wanted VALUES (?)", [(k,) for k in images])
        for table, which in tables.items():
            names = _columns(connection, table)
            connection.execute(f"INSERT INTO {table} ({names}) SELECT {names} FROM source.{table} {which}")
        yield connection
        connection.execute("COMMIT")
    finally:
        connection.close()


def copy_features(source: Path, path: Path, images: np.ndarray, alias: str) -> None:
    """A new database with the features of some images (scene indices), named ``alias`` and their id."""
    with _new(path, source, _FEATURES, [int(k) + 1 for k in images]) as connection:
        connection.execute("UPDATE images SET name = ? || image_id", (alias,))


def take_matches(path: Path, block: Path) -> None:
    """Write all matches and geometries of another database into this one. Raises as ``explained``, for the database
    at fault."""
    with _opened(block) as connection:
        rows = {table: connection.execute(f"SELECT * FROM {table}").fetchall() for table in _MADE}
        names = {table: _columns(connection, table) for table in _MADE}
    with transaction(path) as cursor:
        for table in _MADE:
            values = ", ".join("?" * (names[table].count(",") + 1))
            cursor.executemany(f"INSERT INTO {table} ({names[table]}) VALUES ({values})", rows[table])


def _columns(connection: sqlite3.Connection, table: str) -> str:
    return ", ".join(row[1] for row in connection.execute(f"PRAGMA main.table_info({table})"))


def copy_verified(source: Path, path: Path, names: set[str] | None, refused: Sequence[tuple[str, str]]) -> None:
    """A new database with all that a mapper reads of another one besides rigs, frames and priors.

    ``names``: of the images to copy, None = all; ``refused``: names of pairs whose verified matches stay behind.
    Descriptors and raw matches, most of the bytes, stay behind too.
    """
    with Rows(source) as rows:
        wanted = [k for k, name in rows.image_names().items() if names is None or name in names]
    with _new(path, source, dict.fromkeys(_MAPPED, "") if names is None else _MAPPED, wanted) as connection:
        there = {name: image_id for image_id, name in connection.execute("SELECT image_id, name FROM images")}
        gone = [sorted(there.get(name, 0) for name in pair) for pair in refused]
        connection.executemany(
            "DELETE FROM two_view_geometries WHERE pair_id = ?", [(MAX_IMAGES * low + high,) for low, high in gone]
        )


@contextmanager
def transaction(path: Path) -> Iterator[sqlite3.Cursor]:
    """A cursor in one write transaction: committed at the end, undone by any error. SQLite's errors are explained."""
    with _opened(path) as connection:
        cursor = connection.cursor()
        cursor.execute("BEGIN IMMEDIATE")
        try:
            yield cursor
            cursor.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                cursor.execute("ROLLBACK")
            raise


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    if not path.is_file():
        raise InputError(f"database {path} does not exist: run the features stage first")
    try:
        connection = sqlite3.connect(path, timeout=60.0, isolation_level=None)
        try:
            connection.execute("PRAGMA synchronous=NORMAL")
            yield connection
        finally:
            connection.close()
    except sqlite3.Error as error:
        raise explained(path, error) from error


def explained(path: Path, error: Exception) -> TiegraphError:
    """Explanation of an error of SQLite or COLMAP at a database, with the remedy."""
    text = str(error)
    told = limits.explained(error, path.parent) or limits.explained_text(text, path.parent)
    if told is not None:
        return type(told)(f"{path} cannot be written: {told}")
    if any(word in text for word in ("disk I/O", "factory", "readonly", "unable to open")):  # all that COLMAP reports
        return InputError(f"{path} cannot be written ({text}): is the disk full or the folder read-only?")
    if "locked" in text:
        return TiegraphError(f"{path} is in use by another program ({text}): close it and run again")
    if "malformed" in text or "not a database" in text:
        return UnreadableArtefact(path, text)
    return TiegraphError(f"{path}: {text}")
