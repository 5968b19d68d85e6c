"""Videos: sharpest pictures, times, alignment of two; 360 cameras before stitching are two cameras."""

from __future__ import annotations

import struct
from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scan_worlds import data, picture, scan

import recording_world as world
import tiegraph
from recording_world import created
from said import refused, says
from tiegraph.api import Project
from tiegraph.scan.recording import Recording
from tiegraph.scan.settings import ScanSettings, video_offsets
from tiegraph.scan.tuning import Tuning
from tiegraph.scan.videos.video import (
    OpenVideo,
    Pictures,
    nearest,
    picture_folders,
    sharpest,
    take_pictures,
)
from tiegraph.scan.videos.videooffset import Film, MotionCurve, films_together, find_offset, motion_curve, offsets_given
from tiegraph.scan.videos.videotime import VideoClock, by_subtitles, video_clock
from tiegraph.scene.exif import Exif, Taken, exif_of, read_exif
from tiegraph.scene.images import find_videos, has_images
from video_world import Shake, film, pictures


def seconds_of(path: Path, seconds: int, sharp: int = 3, seed: int = 0) -> Path:
    """Ten pictures a second; each second's picture ``sharp`` alone is not blurred, and as bright as its second."""
    texture = np.random.default_rng(seed).integers(0, 120, (240, 320, 3), dtype=np.uint8)
    numbers = range(10 * seconds)
    pictures = (texture if n % 10 == sharp else cv2.GaussianBlur(texture, (0, 0), 2 + n % 10 / 10) for n in numbers)
    return film(
        path, (np.clip(p.astype(int) + 10 * (n // 10), 0, 255).astype(np.uint8) for n, p in enumerate(pictures))
    )


def take(video: Path, folder: Path, per_second: float) -> Pictures:
    return take_pictures(Recording(video), folder, sharpest(per_second), VideoClock())


@pytest.mark.slow
def test_the_sharpest_of_each_second_is_taken_in_order(tmp_path: Path) -> None:
    video = seconds_of(tmp_path / "river.avi", 6)
    taken = take(video, tmp_path / "out" / "river", 1.0)
    assert taken.said == "river.avi: 6 pictures, the sharpest of every 1 s"
    assert np.allclose(taken.stamps_s, 0.3 + np.arange(6), atol=1e-6) and taken.numbers == tuple(range(6))
    files = sorted((tmp_path / "out" / "river").glob("*.jpg"))
    assert [f.name for f in files] == [f"river_{k:06d}.jpg" for k in range(6)]
    pictures = [cv2.imread(str(f)).astype(float) for f in files]
    assert np.allclose(np.diff([p.mean() for p in pictures]), 10, atol=1.5)
    blurred = cv2.GaussianBlur(pictures[0], (0, 0), 2)
    assert all(p.std() > 1.5 * blurred.std() for p in pictures)
    before = files[0].stat().st_mtime_ns
    assert take(video, tmp_path / "out" / "river", 1.0) == taken and files[0].stat().st_mtime_ns == before


@pytest.mark.slow
def test_videos_are_passes_not_cameras(tmp_path: Path) -> None:
    for k, name in enumerate(("morning.avi", "noon.avi")):
        seconds_of(tmp_path / "in" / name, 20, seed=k)
    videos = find_videos(tmp_path / "in")
    assert find_videos(videos[1]) == [videos[1]]  # one may be given alone
    for video, folder in zip(videos, picture_folders([v.name for v in videos])):
        take(video, tmp_path / "out" / folder, 1.0)
    scene = scan(tmp_path / "out", video=True)
    assert (len(scene), scene.sequences, len(scene.all_sensors)) == (40, ("morning", "noon"), 1)


@pytest.mark.slow
def test_a_video_is_a_sequence_however_short(tmp_path: Path) -> None:
    take(seconds_of(tmp_path / "in" / "walk.avi", 3), tmp_path / "out" / "walk", 1.0)
    scene = scan(tmp_path / "out", video=True)
    assert (len(scene), scene.sequences, scene.guessed) == (3, ("walk",), ())
    assert scene.sequence.tolist() == [0, 0, 0] and np.allclose(scene.time_s, [0.3, 1.3, 2.3], atol=1e-5)
    assert scan(tmp_path / "out").sequences == ()  # of three photographs nobody knows


@pytest.mark.slow
def test_videos_of_different_cameras_are_sequences_of_rigs_of_their_own(tmp_path: Path) -> None:
    take(seconds_of(tmp_path / "in" / "boat.avi", 3), tmp_path / "out" / "boat", 1.0)
    for k in range(3):
        picture(tmp_path / "out" / "phone" / f"phone_{k:06d}.jpg", (100, 60))
    scene = scan(tmp_path / "out", video=True)
    assert (scene.sequences, len(scene.rigs), scene.frames) == (("boat", "phone"), 2, 6)
    assert sorted(zip(scene.sequence.tolist(), scene.rig.tolist())) == [*[(0, 0)] * 3, *[(1, 1)] * 3]


def test_what_is_no_video_is_said(tmp_path: Path) -> None:
    broken = tmp_path / "in" / "a.mp4"
    broken.parent.mkdir()
    broken.write_bytes(b"no video at all" * 100)
    assert "a.mp4 cannot be decoded" in take(broken, tmp_path / "out" / "a", 2.0).said
    assert not has_images(tmp_path / "out") and find_videos(tmp_path / "in") == [broken]
    assert picture_folders(["x/a.mp4", "x/a.mov", "x/b.mp4"]) == ["x/a_mp4", "x/a_mov", "x/b"]


def test_a_video_that_is_cut_off_says_so(tmp_path):
    rng = np.random.default_rng(3)
    whole = film(tmp_path / "whole.avi", (rng.integers(0, 255, (64, 96, 3), np.uint8) for _ in range(40)))
    assert "could be decoded" not in take(whole, tmp_path / "a", 2.0).said
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert "of its 40 frames could be decoded: is the file cut off?" in take(cut, tmp_path / "b", 2.0).said


class Stamped:
    """A capture that gives pictures with any stamps (ms)."""

    def __init__(self, stamps_ms: list[float], fps: float = 10.0) -> None:
        self.stamps_ms, self.fps, self.at = stamps_ms, fps, -1

    def isOpened(self) -> bool:
        return True

    def get(self, key: int) -> float:
        known = {cv2.CAP_PROP_FPS: self.fps, cv2.CAP_PROP_FRAME_COUNT: float(len(self.stamps_ms))}
        return known.get(key, self.stamps_ms[max(self.at, 0)])

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.at += 1
        return (True, np.zeros((4, 4, 3), np.uint8)) if self.at < len(self.stamps_ms) else (False, None)


@pytest.mark.parametrize(
    "stamps_ms, expected, unstamped",
    [([0, 40, 150, 190], [0, 0.04, 0.15, 0.19], 0), ([0, 0, 0, 0], [0, 0.1, 0.2, 0.3], 3),
     ([0, 100, 50, 300], [0, 0.1, 0.2, 0.3], 1)],
)  # fmt: skip
def test_stamps_are_the_containers_and_missing_ones_follow_the_rate(stamps_ms, expected, unstamped) -> None:
    video = OpenVideo(Stamped(stamps_ms))
    assert np.allclose([stamp for stamp, _ in video.frames()], expected)
    assert video.unstamped == unstamped
    said = Stamped(stamps_ms, fps=0.0)
    assert list(OpenVideo(said).frames()) == []


def test_the_frames_nearest_to_instants_are_taken() -> None:
    frames = [(k / 10, np.full((2, 2, 3), k, np.uint8)) for k in range(10)]
    found = list(nearest((3, 4, 5, 8), (-0.04, 0.33, 0.37, 0.99), 0.075).pick(iter(frames)))
    assert [(n, f[0]) for n, f in found] == [(3, 0.0), (4, 0.3), (5, 0.4)]  # 0.99 is 0.09 after the last
    assert [n for n, _ in nearest((1,), (0.9,), 0.01).pick(iter(frames))] == [1]


START = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc).timestamp()

# As DJI's Air 2S (a fraction in two parts), Mini 3 Pro (no date), Mavic Pro (satellites), Matrice 300 (height) write.
NEW = """1
00:00:00,000 --> 00:00:00,100
<font size="36">SrtCnt : 1, DiffTime : 100ms
2024-05-01 12:00:00,774,808
[iso : 100] [focal_len : 240] [latitude: 41.424724] [longitude: -2.234156] [rel_alt: 1.300 abs_alt: 132.860] </font>

2
00:00:00,100 --> 00:00:02,000
<font size="36">SrtCnt : 2, DiffTime : 100ms
2024-05-01 12:00:00,874,808
[iso : 100] [focal_len : 240] [latitude: 41.424730] [longtitude: -2.234166] [altitude: 133.5] </font>
"""
DATELESS = "1\n00:00:00,000 --> 00:00:00,033\n[latitude: 59.0000] [longitude: 18.0000] [rel_alt: 1.0 abs_alt: 100.0]\n"
OLD = """1
00:00:00,000 --> 00:00:01,000
HOME(131.1660,-25.2088) 2017.07.29 15:18:50
GPS(131.1660,-25.2089,14) BAROMETER:0.5

2
00:00:01,000 --> 00:00:02,000
HOME(131.1660,-25.2088) 2017.07.29 15:18:51
GPS(131.1661,-25.2088,14) BAROMETER:1.0
"""
MATRICE = "1\n00:00:00,000 --> 00:00:01,000\n2022.06.21 16:06:17\nGPS(36.6146,-6.1120,12.5M) BAROMETER:0.3M\n"
NO_FIX = "1\n00:00:00,000 --> 00:00:01,000\n2026-05-31 16:15:29.797\n[latitude: 0.000000] [longitude: 0.000000]\n"


def seconds(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=timezone.utc).timestamp()


def grey(path: Path) -> Path:
    return film(path, (np.full((48, 64, 3), 10 * k % 250, np.uint8) for k in range(20)))


def stamped(path: Path, created_s: float, wide: bool = False) -> Path:
    """The video with its movie header's creation time set (seconds since 1970); ``wide``: of version 1."""
    if not wide:
        return created(path, created_s)
    data = bytearray(path.read_bytes())
    at = data.index(b"mvhd") + 4
    old, tail = struct.unpack_from(">IIII", data, at + 4), bytes(data[at + 20 : at + 88])
    data[at : at + 100] = struct.pack(">B3xQQIQ", 1, round(created_s) + 2082844800, 0, old[2], old[3]) + tail
    path.write_bytes(data)
    return path


def clock(path: Path, **settings: object) -> VideoClock:
    return video_clock(path, ScanSettings(**settings))


@pytest.mark.parametrize("wide", [False, True])
def test_the_container_says_when_a_video_began(tmp_path: Path, wide: bool) -> None:
    video = stamped(grey(tmp_path / "a.mp4"), START, wide)
    found = clock(video)
    assert found.start_s == START and found.known and found.utc
    assert "2024-05-01 10:00:00 UTC" in found.note and "--scan.video-offset SECONDS, or end" in found.note
    assert clock(video, video_offset=("end",)).start_s == pytest.approx(START - 2.0, abs=0.11)  # 20 frames, 10 a second
    assert clock(video, video_offset=("-7200.5",)).start_s == START - 7200.5


def test_a_video_without_creation_time_counts_from_its_start(tmp_path: Path) -> None:
    for video in (grey(tmp_path / "a.mp4"), tmp_path / "cut.mp4", tmp_path / "loop.mp4"):
        if not video.exists():
            video.write_bytes(b"\0\0\0\x04ftyp" if video.name == "loop.mp4" else b"\0\0\0\x08free" * 3 + b"\0\0")
        found = clock(video)
        assert (found.start_s, found.known, found.utc) == (0.0, False, False)
        assert f"{video.name}: it has no recording time" in found.note
    assert clock(tmp_path / "a.mp4", video_offset=(str(START),)).known


def test_pictures_carry_the_time_of_their_frames(tmp_path: Path) -> None:
    video = stamped(grey(tmp_path / "a.mp4"), START)
    taken = take_pictures(Recording(video), tmp_path / "out", sharpest(2.0), clock(video, video_offset=("0.25",)))
    found = [exif(f) for f in sorted((tmp_path / "out").glob("*.jpg"))]
    assert [e.time_s for e in found] == pytest.approx([START + 0.25 + s for s in taken.stamps_s], abs=1e-6)
    assert all(e.utc for e in found) and len(found) == 4
    assert all(np.isnan(e.lat_deg) for e in found)


def exif(file: Path) -> Exif:
    with Image.open(file) as image:
        return read_exif(image, image.size)


@pytest.mark.parametrize("taken", [Taken(-41.4247244, 2.2341561, -3.21, 11.5, time_s=START + 0.123456, utc=True),
                                   Taken(0.0000123, -179.9999999, time_s=12.5)])  # fmt: skip
def test_what_is_written_is_read_again(tmp_path: Path, taken: Taken) -> None:
    Image.new("RGB", (40, 30)).save(tmp_path / "a.jpg", exif=exif_of(taken))
    found = exif(tmp_path / "a.jpg")
    assert found.time_s == pytest.approx(taken.time_s, abs=1e-6) and found.utc == taken.utc
    assert (found.lat_deg, found.lon_deg) == pytest.approx((taken.lat_deg, taken.lon_deg), abs=1e-9)
    assert found.height_m == pytest.approx(taken.height_m, abs=1e-3, nan_ok=True)
    assert found.sigma_m == pytest.approx(taken.sigma_m, abs=1e-3, nan_ok=True)


@pytest.mark.parametrize(
    "text, start, place, later",
    [(NEW, "2024-05-01T12:00:00.774808", (41.424724, -2.234156, 132.86), (41.42473, -2.234166, 133.5)),
     (OLD, "2017-07-29T15:18:50", (-25.2089, 131.166, np.nan), (-25.2088, 131.1661, np.nan)),
     (MATRICE, "2022-06-21T16:06:17", (36.6146, -6.112, 12.5), (36.6146, -6.112, 12.5)),
     (DATELESS, "", (59.0, 18.0, 100.0), (59.0, 18.0, 100.0)),
     (NO_FIX, "2026-05-31T16:15:29.797", (np.nan,) * 3, (np.nan,) * 3)],
)  # fmt: skip
def test_each_form_of_a_drones_subtitles(tmp_path: Path, text: str, start: str, place: tuple, later: tuple) -> None:
    (tmp_path / "a.SRT").write_text(text)
    found = by_subtitles(tmp_path / "a.SRT", ScanSettings())
    assert found.start_s == pytest.approx(seconds(start) if start else 0.0, abs=1e-6) and found.known == bool(start)
    begin, end = found.places.stamp_s[-2:]
    middle = np.mean([place, later], axis=0)
    for stamp, expected in ((0.0, place), (begin / 2, middle), (begin, later), (end, later), (end + 0.1, [np.nan] * 3)):
        at = found.places.place(stamp)
        assert (at.lat_deg, at.lon_deg, at.height_m) == pytest.approx(expected, nan_ok=True)
    coarse = text in (OLD, MATRICE, DATELESS)  # four decimals: 11 m
    assert found.places.sigma_m == pytest.approx(np.hypot(5.0, 11.132) if coarse else np.nan, nan_ok=True)


def test_subtitles_beside_a_video_come_first_and_others_are_said(tmp_path: Path) -> None:
    video = stamped(grey(tmp_path / "DJI_0001.mp4"), START)
    (tmp_path / "DJI_0001.SRT").write_text(NEW)
    found = clock(video, video_offset=("-7200.0",))
    assert found.start_s == pytest.approx(seconds("2024-05-01T10:00:00.774808"), abs=1e-6) and not found.utc
    assert "2 of 2 rows have a position" in found.note and "own clock and zone" in found.note
    take_pictures(Recording(video), tmp_path / "out", sharpest(2.0), found)
    first = exif(min((tmp_path / "out").glob("*.jpg")))
    assert first.lat_deg == pytest.approx(41.42473, abs=1e-5) and 132 < first.height_m < 134
    (tmp_path / "DJI_0001.SRT").write_text("1\n00:00:00,000 --> 00:00:02,000\nA river, in 2024.\n")
    other = clock(video)
    assert other.start_s == START and "no times or positions of a DJI drone in them: not used" in other.note


def curve(shake: Shake, fps: float, length_s: float, begin_s: float, **camera: object) -> MotionCurve:
    """What a camera that began at a time sees, by its own stamps."""
    stamps = np.arange(round(length_s * fps)) / fps
    return motion_curve(zip(stamps, pictures(shake, begin_s + stamps, **camera)))


def drawn(seed: int, begin_s: float, mix: np.ndarray, noise_px: float = 1.0, fps: float = 20.0) -> MotionCurve:
    """A curve without pictures: a broad-band motion of three angles, mixed as a camera's axes do."""
    rng = np.random.default_rng(7)
    rate, phase = rng.uniform(0.1, 5.0, 60), rng.uniform(0, 2 * np.pi, (60, 3))
    time = begin_s + np.arange(400) / fps
    angles = np.sin(2 * np.pi * time[:, None, None] * rate[:, None] + phase).sum(axis=1)
    noise = np.random.default_rng(seed).normal(0, noise_px, (400, 4)).cumsum(axis=0)
    return MotionCurve(np.arange(400) / fps, angles @ mix + noise)


MIX = np.random.default_rng(1).normal(0, 1, (2, 3, 4))


@pytest.mark.slow
def test_cameras_that_look_elsewhere_at_another_rate_are_aligned_to_a_millisecond() -> None:
    shake = Shake.of(3)
    first = curve(shake, 30.0, 6.0, 0.0)
    second = curve(shake, 25.0, 6.0, 1.2137, turn_deg=(10, 70, 20), focal_px=110.0)
    found = find_offset(first, second)
    assert not found.refused and abs(found.seconds - 1.2137) < 1e-3
    assert 1e-5 < found.sigma_s < 2e-3 and abs(found.shared_s - 4.75) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("begin_s", [-7.313, -0.02, 3.171])
def test_offsets_and_their_sigmas(begin_s: float) -> None:
    errors, sigmas = [], []
    for seed in range(4):
        found = find_offset(drawn(2 * seed, 0.0, MIX[0]), drawn(2 * seed + 1, begin_s, MIX[1]))
        assert not found.refused
        errors.append(found.seconds - begin_s)
        sigmas.append(found.sigma_s)
    assert np.max(np.abs(errors)) < 2e-3  # a 25th of a frame
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) / np.sqrt(np.mean(np.square(sigmas))) < 3


@pytest.mark.slow
def test_videos_of_different_motion_are_refused() -> None:
    other = MotionCurve(np.arange(400) / 20, np.random.default_rng(5).normal(0, 1, (400, 4)).cumsum(axis=0))
    assert "stands out" in find_offset(drawn(0, 0.0, MIX[0]), other).refused
    still = MotionCurve(np.arange(400) / 20, np.zeros((400, 4)))
    assert "stands out" in find_offset(drawn(0, 0.0, MIX[0]), still).refused
    assert "stands out" in find_offset(still, still).refused
    short = drawn(0, 0.0, MIX[0])
    few = MotionCurve(short.stamp_s[:10], short.moved_px[:10])
    assert "10 frames are too few" in find_offset(short, few).refused
    brief = MotionCurve(short.stamp_s / 25, short.moved_px)
    assert "shorter than the 2 s" in find_offset(brief, brief).refused


@pytest.mark.slow
@pytest.mark.parametrize("late_s, word", [(0.055, "halves differ by"), (0.3, "no offset stands out")])
def test_a_clock_that_jumps_is_refused(late_s: float, word: str) -> None:
    whole = drawn(1, 2.0, MIX[1])
    jumped = drawn(1, 2.0 + late_s, MIX[1])
    half = len(whole.stamp_s) // 2
    moved = np.vstack([whole.moved_px[:half], jumped.moved_px[half:] + whole.moved_px[half] - jumped.moved_px[half]])
    found = find_offset(drawn(0, 0.0, MIX[0]), MotionCurve(whole.stamp_s, moved))
    assert word in found.refused


@pytest.mark.slow
def test_kitti_as_two_videos(tmp_path) -> None:
    """Ten pictures a second of a straight drive tell some ms: a twentieth of a frame."""
    folder = data("kitti_stereo", "KITTI_sequence_1")
    both = []
    for side, begin in (("image_l", 0), ("image_r", 7)):
        files = sorted((folder / side).iterdir())[begin:]
        both.append(motion_curve(((k / 10, cv2.imread(str(f))) for k, f in enumerate(files))))
    found = find_offset(*both)
    assert abs(found.seconds - 0.7) < 0.008 and 0.001 < found.sigma_s < 0.02


def test_which_videos_show_the_same() -> None:
    def groups(*folders: str, rig: str | None = None, size: tuple[int, int] = (64, 48), **settings: object) -> list:
        films = [Film(f, *size) for f in folders]
        return films_together(films, rig, None, ScanSettings(**settings), Tuning())

    assert groups("cam0", "cam1") == [(0, 1)]
    assert groups("cam0", "cam1", layout="sequence") == [(0,), (1,)]
    assert groups("morning", "noon") == [(0,), (1,)] and groups("walk") == [(0,)]
    assert groups("morning", "noon", rig="stereo") == [(0, 1)]
    assert groups("up/left", "up/right", "down/left", "down/right") == [(0, 1), (2, 3)]
    assert groups("left/up", "left/down", "right/up", "right/down") == [(0, 2), (1, 3)]
    assert groups("cam0", "cam1", size=(128, 64)) == [(0,), (1,)]  # of the whole sphere each


def test_offsets_by_name() -> None:
    given = ScanSettings(video_offset=("a/cam1=0.35", "cam2=-1"))
    assert offsets_given(["a/cam0", "a/cam1", "a/cam2"], given) == {1: 0.35, 2: -1.0}
    with pytest.raises(ValueError, match="cam9=1: no video is called so; here are cam0, cam1"):
        offsets_given(["cam0", "cam1"], ScanSettings(video_offset=("cam9=1",)))
    with pytest.raises(ValueError, match="several videos"):
        offsets_given(["a/cam1", "b/cam1"], ScanSettings(video_offset=("cam1=1",)))
    for wrong in ("cam1", "=3", "cam1=x", "cam1=nan", "nan", ""):
        with pytest.raises(ValueError, match="NAME=SECONDS"):
            ScanSettings(video_offset=(wrong,))
    for twice in (("cam1=1", "cam1=2"), ("3", "4"), ("end", "end")):
        with pytest.raises(ValueError, match="each once"):
            ScanSettings(video_offset=twice)
    every = video_offsets(("-7200.5", "cam1=2", "end"))
    assert (every.all_s, every.by_name, every.from_end) == (-7200.5, {"cam1": 2.0}, True)
    assert video_offsets(("end=3",)).by_name == {"end": 3.0}


def scanned(images: Path, out: Path) -> Project:
    return tiegraph.open(images, out, pool="serial").run("scan")


def sensors(project: Project) -> tuple:
    scene = project.scene()
    return len(scene), scene.frames, [s.name for s in scene.all_sensors]


def shot(path: Path, width: int = 96, seed: int = 0, lenses: int = 1) -> Path:
    """Two seconds of MP4 with a circle a lens, side by side."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(width) + 0.5 - width / 2)
    dark = np.tile(np.hypot(x, y) > 0.46 * width, lenses)[..., None]
    small = (rng.integers(80, 255, (6, 6 * lenses, 3), dtype=np.uint8) for _ in range(20))
    large = (cv2.resize(s, (width * lenses, width), interpolation=cv2.INTER_CUBIC) for s in small)
    return film(path, (np.where(dark, 0, picture).astype(np.uint8) for picture in large))


def test_two_files_of_a_shot_are_two_cameras() -> None:
    shot, alone = "a/VID_20220110_121609_657", "a/VID_20220110_130000_00_658"
    videos = ["a/VID_20220110_121609_00_657.insv", "a/VID_20220110_121609_10_657.insv", f"{alone}.insv"]
    assert picture_folders(videos) == [f"{shot}/fisheye0", f"{shot}/fisheye1", alone]
    others = [v.replace(".insv", ".mp4") for v in videos]
    assert picture_folders(others) == [v[:-4] for v in others]


@pytest.mark.slow
def test_videos_of_two_lenses_become_a_rig(tmp_path: Path) -> None:
    for lens in (0, 1):
        shot(tmp_path / "in" / f"VID_20220110_121609_{lens}0_657.insv", seed=1 + lens)
    project = scanned(tmp_path / "in", tmp_path / "out")
    assert sensors(project) == (8, 4, ["fisheye0", "fisheye1"])
    assert any("+0.0000 s after" in n and "the lenses of one recording" in n for n in project.receipt("scan")["notes"])
    shot(tmp_path / "both" / "VID_20220110_121609_00_657.insv", lenses=2)
    project = scanned(tmp_path / "both", tmp_path / "out2")
    assert sensors(project) == (8, 4, ["lens0", "lens1"])
    scene = project.scene()
    assert scene.rigs[0].nominal and (tmp_path / "out2" / "images" / scene.names[7]).exists()


@pytest.mark.slow
def test_videos_of_two_cameras_are_not_one_recording_by_their_ending(tmp_path: Path) -> None:
    for k in (0, 1):
        shot(tmp_path / "in" / f"cam{k}.insv", seed=1 + k)
    with refused(r"--scan.video-offset cam1=SECONDS"):
        scanned(tmp_path / "in", tmp_path / "out")


@pytest.mark.slow
def test_two_tracks_of_a_file_become_a_rig_with_times_and_positions(tmp_path: Path) -> None:
    one, other = shot(tmp_path / "one.mp4", seed=1), shot(tmp_path / "other.mp4", seed=2)
    video = tmp_path / "in" / "VID_20240501_120000_00_001.insv"
    video.parent.mkdir()
    start = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc)
    world.created(world.two_tracks(video, one, other), start.timestamp() + 7200)
    world.with_trailer(video, [(7, world.gps_record(world.walk(start, 30, 10)))], gap=100)
    project = scanned(tmp_path / "in", tmp_path / "out")
    scene, notes = project.scene(), project.receipt("scan")["notes"]
    assert sensors(project) == (8, 4, ["fisheye0", "fisheye1"])
    for track, file in enumerate((one, other)):  # each camera has the pictures of its lens
        alone = next(iter(frames(file)))
        name = next(n for k, n in enumerate(scene.names) if f"fisheye{track}" in n)
        with Image.open(tmp_path / "out" / "images" / name) as image:
            assert min(np.abs(np.asarray(image, float) - f).mean() for f in frames(file)) < 4 < alone.mean()
    assert 0 <= scene.time_s[0] - start.timestamp() < 0.5
    way = scene.world_from_rig[:, :2, 3] - scene.world_from_rig[0, :2, 3]
    assert np.hypot(*way.T) == pytest.approx(world.SPEED * (scene.time_s - scene.time_s[0]), abs=0.01)
    assert sum("2 h from UTC by these fixes" in n for n in notes) == 1
    assert any("001.insv, track 2 begins +0.0000 s after" in n and "the lenses of one" in n for n in notes)


@pytest.mark.slow
def test_the_fixes_in_the_file_of_one_lens_place_both(tmp_path: Path) -> None:
    start = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc)
    for lens in (0, 1):
        video = shot(tmp_path / "in" / f"VID_20240501_120000_{lens}0_001.insv", seed=lens)
        world.created(video, start.timestamp() + 7200)
        if lens == 0:
            world.with_trailer(video, [(7, world.gps_record(world.walk(start, 30, 10)))])
    project = scanned(tmp_path / "in", tmp_path / "out")
    scene = project.scene()
    assert np.isfinite(scene.world_from_rig[:, :3, 3]).all() and 0 <= scene.time_s[0] - start.timestamp() < 0.5
    assert not says(project.receipt("scan")["notes"], "by its own clock")


def frames(path: Path) -> list[np.ndarray]:
    """All pictures of a video, RGB."""
    capture, out = cv2.VideoCapture(str(path)), []
    while (read := capture.read())[0]:
        out.append(read[1][..., ::-1].astype(float))
    return out
