"""One video track of several: OpenCV sees it alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import recording_world as world
from tiegraph.scan.recording import Recording
from tiegraph.scan.recording.tracks import OneVideoTrack, edits, samples, tracks
from tiegraph.scan.videos.video import open_film, recordings_of


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    one, other = world.film(folder / "one.mp4", level=20), world.film(folder / "other.mp4", level=150)
    return world.two_tracks(folder / "VID_20240501_120000_00_001.insv", one, other)


@pytest.mark.parametrize("track, level", [(0, 20), (1, 150), (None, 20)])
def test_frames_of_each_track(two: Path, track: int | None, level: int) -> None:
    with open_film(Recording(two, track)) as opened:
        frames = list(opened.frames())
    assert [stamp for stamp, _ in frames] == pytest.approx(np.arange(20) / 10)
    assert np.all(np.abs([picture.mean() - level - k for k, (_, picture) in enumerate(frames)]) < 6)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize(
    "listed, first, stamp, count",
    [
        ([(2.0, 0)], 0, 0.0, 20),
        ([(0.37, -1), (2.0, 0)], 0, 0.37, 20),  # recorded later than the sound
        ([(0.25, -1), (0.12, -1), (2.0, 0)], 0, 0.37, 20),
        ([(1.5, 0.5)], 5, 0.0, 15),  # cut without encoding it again
        ([(0.3, -1), (1.0, 0.5)], 5, 0.3, 10),
    ],
)
def test_frames_count_as_the_edit_list_shows_them(
    tmp_path: Path, listed: list, first: int, stamp: float, count: int, wide: bool
) -> None:
    path = world.film(tmp_path / "a.mp4")
    with open_film(Recording(path)) as opened:
        whole = [picture.mean() for _, picture in opened.frames()]
    with open_film(Recording(world.edited(path, 0, listed, wide))) as opened:
        frames = list(opened.frames())
    assert [s for s, _ in frames] == pytest.approx(stamp + np.arange(count) / 10, abs=1e-6)
    assert [p.mean() for _, p in frames] == pytest.approx(whole[first : first + count])


def test_telemetry_counts_as_its_own_edit_list_says(tmp_path: Path) -> None:
    path = world.with_telemetry(world.film(tmp_path / "a.mp4"), [b"abcd"] * 4)
    for listed, first in (([(4.0, 0)], 0.0), ([(0.37, -1), (3.0, 1.5)], -1.13)):
        world.edited(path, 1, listed)
        with path.open("rb") as file:
            assert samples(file, tracks(file)[1]).begin_s == pytest.approx(first + np.arange(4))


@pytest.mark.parametrize("rows", [0, 1, 10**9])
def test_broken_edit_lists_do_nothing(tmp_path: Path, rows: int) -> None:
    path = world.edited(world.film(tmp_path / "a.mp4"), 0, [(0.5, -1)])
    data = path.read_bytes()
    at = data.index(b"elst") + 8
    path.write_bytes(data[:at] + rows.to_bytes(4, "big") + data[at + 4 :])
    with path.open("rb") as file:
        assert edits(file, tracks(file)[0])[1] == 0


def test_the_file_is_what_it_was_but_for_one_word(two: Path) -> None:
    data = two.read_bytes()
    places = [data.index(b"trak"), data.rindex(b"trak")]
    with OneVideoTrack(two, 1) as view:
        assert view.read() == data[: places[0]] + b"free" + data[places[0] + 4 :]
        for step in (1, 3, 7, 1000):
            view.seek(0)
            parts = [view.read(step) for _ in range(0, len(data) + step, step)]
            assert b"".join(parts) == data[: places[0]] + b"free" + data[places[0] + 4 :]
        assert view.seek(-10, 2) == len(data) - 10 and view.read(4) == data[-10:-6]
    with OneVideoTrack(two, 0) as view:
        assert view.read() == data[: places[1]] + b"free" + data[places[1] + 4 :]


def test_a_track_in_a_box_of_a_long_size_is_hidden_too(tmp_path: Path, two: Path) -> None:
    data = two.read_bytes()
    moov = dict(world.split(data))[b"moov"]
    boxes = b""
    for kind, inside in world.split(moov):
        long = (1).to_bytes(4, "big") + kind + (16 + len(inside)).to_bytes(8, "big") + inside
        boxes += long if kind == b"trak" else world.box(kind, inside)
    path = tmp_path / "long.insv"
    path.write_bytes(data[: data.rindex(b"moov") - 4] + world.box(b"moov", boxes))
    for track, level in ((0, 20), (1, 150)):
        with open_film(Recording(path, track)) as opened:
            assert abs(next(opened.frames())[1].mean() - level) < 6


def test_which_files_are_two_recordings(tmp_path: Path, two: Path) -> None:
    assert recordings_of(two, "a/shot") == [
        (Recording(two, 0), "a/shot/fisheye0"),
        (Recording(two, 1), "a/shot/fisheye1"),
    ]
    assert Recording(two, 1).name == "VID_20240501_120000_00_001.insv, track 2"
    renamed = tmp_path / "phone.mp4"
    renamed.write_bytes(two.read_bytes())
    assert recordings_of(renamed, "phone") == [(Recording(renamed), "phone")]
    small = world.film(tmp_path / "small.mp4", size=48)
    big = world.film(tmp_path / "big.mp4")
    other = world.two_tracks(tmp_path / "preview.insv", big, small)  # not two lenses: of different sizes
    for path in (other, tmp_path / "none.insv"):
        assert recordings_of(path, "f") == [(Recording(path), "f")]


def test_tracks_of_broken_files(tmp_path: Path, two: Path) -> None:
    path = tmp_path / "broken.insv"
    for data in (b"", b"\0" * 5000, b"\xff" * 5000, two.read_bytes()[:1500], b"\0\0\0\x09moov\0\0\0\0\x08trak"):
        path.write_bytes(data)
        with path.open("rb") as file:
            assert all(t.kind == b"" for t in tracks(file))
        assert recordings_of(path, "f") == [(Recording(path), "f")]
    with two.open("rb") as file:
        assert [(t.kind, t.format) for t in tracks(file)] == [(b"vide", b"mp4v")] * 2
