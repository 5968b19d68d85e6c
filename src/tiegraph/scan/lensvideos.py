"""Videos of 360 cameras before stitching: Insta360's .insv, an MP4 by another name.

Three kinds are about. One video shows both lenses side by side: its pictures are told by their two circles
(``twolenses``). Two files of one shot, ..._00_... and ..._10_..., have a lens each: their pictures become the two
cameras of a rig. And one file has two video tracks, of which the reader here opens the first only.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path, PurePath, PurePosixPath
from typing import BinaryIO

from tiegraph.scan.mp4 import boxes
from tiegraph.scene.regular import regular

SUFFIX = ".insv"
_OF_LENS = re.compile(r"^(VID_\d+_\d+)_([01])0_(\d+)$", re.IGNORECASE)


def lens_folders(videos: Sequence[str], folders: Sequence[str]) -> list[str]:
    """Folders for the pictures of videos (names, POSIX): <shot>/fisheye0 and <shot>/fisheye1 where two files of a shot
    have a lens each, else the ``folders`` given."""
    found = [_of_lens(PurePosixPath(v)) for v in videos]
    shots = [str(PurePosixPath(v).with_name(f"{m[1]}_{m[3]}")) if m else "" for v, m in zip(videos, found)]
    return [
        f"{shot}/fisheye{m[2]}" if m and shots.count(shot) == 2 else folder
        for shot, m, folder in zip(shots, found, folders)
    ]


def is_of_lens(video: PurePath) -> bool:
    """Whether a video is by its name one lens of a shot, recorded together with the other."""
    return _of_lens(video) is not None


def _of_lens(video: PurePath) -> re.Match[str] | None:
    return _OF_LENS.match(video.stem) if video.suffix.lower() == SUFFIX else None


def two_tracks_note(video: Path) -> str:
    """What to do about a file whose lenses have a video track each, "" for others."""
    if video.suffix.lower() != SUFFIX or video_tracks(video) < 2:
        return ""
    name = video.name
    return (
        f"{name} has two video tracks, one a lens, and only the first is read: split it, for example by "
        f"`ffmpeg -i {name} -map 0:v:0 -c copy fisheye0.mp4 -map 0:v:1 -c copy fisheye1.mp4`, and give each file in a "
        "folder of its lens"
    )


def video_tracks(path: Path) -> int:
    """How many video tracks the header of an MP4 file names (ISO 14496-12: moov/trak/mdia/hdlr); 0 if it is none."""
    try:
        with regular(path, None).open("rb") as file:
            headers = boxes(file, b"moov", 0, file.seek(0, 2))
            tracks = [track for header in headers for track in boxes(file, b"trak", *header)]
            return sum(_is_video(file, *track) for track in tracks)
    except OSError:
        return 0


def _is_video(file: BinaryIO, start: int, end: int) -> bool:
    for media in boxes(file, b"mdia", start, end):
        for handler, _ in boxes(file, b"hdlr", *media):
            file.seek(handler + 8)  # version, flags and a field that is 0
            return file.read(4) == b"vide"
    return False
