"""Videos of 360 cameras before stitching: Insta360's .insv, an MP4 by another name.

Three kinds are about. One video shows both lenses side by side: its pictures are told by their two circles
(``twolenses``). Two files of one shot, ..._00_... and ..._10_..., or two video tracks of one file, have a lens each:
their pictures become the two cameras of a rig.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path, PurePath, PurePosixPath

from tiegraph.scan.recording.recording import Recording
from tiegraph.scan.recording.tracks import VIDEO, tracks
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


def is_of_lens(recording: Recording) -> bool:
    """Whether a video is by its name one lens of a shot, or a track beside another, recorded together with it."""
    return recording.track is not None or _of_lens(recording.file) is not None


def _of_lens(video: PurePath) -> re.Match[str] | None:
    return _OF_LENS.match(video.stem) if video.suffix.lower() == SUFFIX else None


def recordings_of(video: Path, folder: str) -> list[tuple[Recording, str]]:
    """A video with the folder of its pictures; of one whose two lenses have a track each, <folder>/fisheye0 and 1."""
    if not (video.suffix.lower() == SUFFIX and _two_tracks(video)):
        return [(Recording(video), folder)]
    return [(Recording(video, k), f"{folder}/fisheye{k}") for k in range(2)]


def _two_tracks(path: Path) -> bool:
    """Whether a file has two video tracks of one size."""
    try:
        with regular(path, None).open("rb") as file:
            shown = [track.shown for track in tracks(file) if track.kind == VIDEO]
    except OSError:
        return False
    return len(shown) == 2 and shown[0] == shown[1]
