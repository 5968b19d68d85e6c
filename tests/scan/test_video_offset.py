"""When one video of a rig began after another, by the motion of their pictures: truth known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scan_worlds import data

from tiegraph.scan.settings import ScanSettings, video_offsets
from tiegraph.scan.tuning import MotionTuning, OffsetTuning, Tuning
from tiegraph.scan.videos.videooffset import Film, MotionCurve, films_together, find_offset, motion_curve, offsets_given
from video_world import Shake, pictures

OFFSET = OffsetTuning()


def curve(shake: Shake, fps: float, length_s: float, begin_s: float, **camera: object) -> MotionCurve:
    """What a camera that began at a time sees, by its own stamps."""
    stamps = np.arange(round(length_s * fps)) / fps
    return motion_curve(zip(stamps, pictures(shake, begin_s + stamps, **camera)), MotionTuning())


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
    found = find_offset(first, second, OFFSET)
    assert not found.refused and abs(found.seconds - 1.2137) < 1e-3
    assert 1e-5 < found.sigma_s < 2e-3 and abs(found.shared_s - 4.75) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("begin_s", [-7.313, -0.02, 3.171])
def test_offsets_and_their_sigmas(begin_s: float) -> None:
    errors, sigmas = [], []
    for seed in range(4):
        found = find_offset(drawn(2 * seed, 0.0, MIX[0]), drawn(2 * seed + 1, begin_s, MIX[1]), OFFSET)
        assert not found.refused
        errors.append(found.seconds - begin_s)
        sigmas.append(found.sigma_s)
    assert np.max(np.abs(errors)) < 2e-3  # a 25th of a frame
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) / np.sqrt(np.mean(np.square(sigmas))) < 3


@pytest.mark.slow
def test_videos_of_different_motion_are_refused() -> None:
    other = MotionCurve(np.arange(400) / 20, np.random.default_rng(5).normal(0, 1, (400, 4)).cumsum(axis=0))
    assert "stands out" in find_offset(drawn(0, 0.0, MIX[0]), other, OFFSET).refused
    still = MotionCurve(np.arange(400) / 20, np.zeros((400, 4)))
    assert "stands out" in find_offset(drawn(0, 0.0, MIX[0]), still, OFFSET).refused
    assert "stands out" in find_offset(still, still, OFFSET).refused
    short = drawn(0, 0.0, MIX[0])
    few = MotionCurve(short.stamp_s[:10], short.moved_px[:10])
    assert "10 frames are too few" in find_offset(short, few, OFFSET).refused
    brief = MotionCurve(short.stamp_s / 25, short.moved_px)
    assert "shorter than the 2 s" in find_offset(brief, brief, OFFSET).refused


@pytest.mark.parametrize("late_s, word", [(0.055, "halves differ by"), (0.3, "no offset stands out")])
def test_a_clock_that_jumps_is_refused(late_s: float, word: str) -> None:
    whole = drawn(1, 2.0, MIX[1])
    jumped = drawn(1, 2.0 + late_s, MIX[1])
    half = len(whole.stamp_s) // 2
    moved = np.vstack([whole.moved_px[:half], jumped.moved_px[half:] + whole.moved_px[half] - jumped.moved_px[half]])
    found = find_offset(drawn(0, 0.0, MIX[0]), MotionCurve(whole.stamp_s, moved), OFFSET)
    assert word in found.refused


@pytest.mark.slow
def test_kitti_as_two_videos(tmp_path) -> None:
    """Ten pictures a second of a straight drive tell some ms: a twentieth of a frame."""
    folder = data("kitti_stereo", "KITTI_sequence_1")
    both = []
    for side, begin in (("image_l", 0), ("image_r", 7)):
        files = sorted((folder / side).iterdir())[begin:]
        both.append(motion_curve(((k / 10, cv2.imread(str(f))) for k, f in enumerate(files)), MotionTuning()))
    found = find_offset(*both, OFFSET)
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
