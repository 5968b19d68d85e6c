"""Videos as image sequences: the sharpest picture of each stretch of time, numbered in order."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from tiegraph.scan.lensvideos import lens_folders
from tiegraph.scan.prepare import write_pixels
from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scene.atomic import claim
from tiegraph.scene.images import files_below
from tiegraph.scene.names import clean, clean_names, shortened
from tiegraph.scene.regular import real_path, regular

SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".mts", ".webm", ".insv")


def find_videos(root: Path) -> list[str]:
    """Names (POSIX, relative to ``root``, sorted) of the videos below a folder; hidden ones are passed over."""
    return sorted(f.relative_to(root).as_posix() for f in files_below(root) if f.suffix.lower() in SUFFIXES)


def picture_folders(videos: Sequence[str]) -> list[str]:
    """A folder for the pictures of each video: its name without the ending, where that is unique."""
    safe = ["/".join(shortened(part) for part in name.split("/")) for name in clean_names(videos)]
    bare = [str(PurePosixPath(v).with_suffix("")) for v in safe]
    return lens_folders(safe, [b if bare.count(b) == 1 else v.replace(".", "_") for b, v in zip(bare, safe)])


def take_pictures(video: Path, folder: Path, per_second: float, tuning: PicturesTuning) -> str:
    """Write the sharpest picture of each 1/``per_second`` s of a video below ``folder``, numbered from 0.

    Sharpness is the variance of the Laplacian of the reduced grey picture: it only compares neighbours in time. The
    folder is made whole or not at all. Returns what a person should know of the video; never raises for a broken one.
    """
    if folder.exists():
        return ""
    try:
        regular(video, None)
    except OSError as error:
        return f"{clean(video.name)} is no video: {error.strerror}"
    os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "protocol_whitelist;file")  # a play list may name a server
    partial = folder.with_name(f".{os.getpid()}-{folder.name}")
    claim(partial)
    claim(folder)
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    capture, fps = _opened(video, partial / f"video{video.suffix.lower()}")
    count = 0
    try:
        expected = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        decoded = _Decoded(capture)
        for picture in _sharpest(decoded if 0 < fps < tuning.max_fps else (), fps, per_second, tuning):
            write_pixels(partial / f"{folder.name}_{count:06d}.jpg", picture[..., ::-1], tuning)
            count += 1
        if count:
            os.replace(partial, folder)
    finally:
        capture.release()
        shutil.rmtree(partial, ignore_errors=True)
    name = clean(video.name)
    if not count:
        return f"{name} cannot be decoded as a video: convert it to H.264 in MP4, or extract its pictures"
    said = f"{name}: {count} pictures, the sharpest of every {1 / per_second:.2g} s"
    if decoded.count < tuning.least_decoded * expected:
        said += f"; only {decoded.count} of its {expected:.0f} frames could be decoded: is the file cut off?"
    return said


def _opened(video: Path, link: Path) -> tuple[cv2.VideoCapture, float]:
    """The opened video and its frames a second, 0 if it cannot be decoded.

    OpenCV gets a link for a name: one that is not UTF-8 would end the process, and %d would mean numbered files.
    """
    try:
        link.symlink_to(real_path(video))
    except (OSError, NotImplementedError):
        link = video
    capture = cv2.VideoCapture(str(link))
    if link != video:
        link.unlink()
    return capture, float(capture.get(cv2.CAP_PROP_FPS)) if capture.isOpened() else 0.0


def _sharpest(
    pictures: Iterable[np.ndarray], fps: float, per_second: float, tuning: PicturesTuning
) -> Iterator[np.ndarray]:
    best: tuple[float, np.ndarray] | None = None
    stretch = 0
    for number, picture in enumerate(pictures):
        now = int(number / fps * per_second)
        if now != stretch and best is not None:
            yield best[1]
            best = None
        stretch, sharp = now, _sharpness(picture, tuning.sharp_px)
        if best is None or sharp > best[0]:
            best = sharp, picture
    if best is not None:
        yield best[1]


class _Decoded:
    """The pictures of a video, and how many there were."""

    def __init__(self, capture: cv2.VideoCapture) -> None:
        self._capture = capture
        self.count = 0

    def __iter__(self) -> Iterator[np.ndarray]:
        while True:
            there, picture = self._capture.read()
            if not there:
                return
            self.count += 1
            yield picture


def _sharpness(picture: np.ndarray, width_px: int) -> float:
    scale = min(1.0, width_px / picture.shape[1])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.CV_32F).var())
