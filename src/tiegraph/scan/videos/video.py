"""Videos as image sequences: the sharpest picture of each stretch of time, numbered in order, each with its time.

Videos of 360 cameras before stitching: Insta360's .insv, an MP4 by another name. There are three kinds. One video shows
both lenses side by side: its pictures are recognised by their two circles (``views``). Two files of one shot,
..._00_... and ..._10_..., or two video tracks of one file, have a lens each: their pictures become the two cameras of a
rig.
"""

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath, PurePosixPath

import cv2
import numpy as np

from tiegraph.scan.prepare import write_pixels
from tiegraph.scan.recording import VIDEO, BrokenTrack, OneVideoTrack, Recording, edits, tracks
from tiegraph.scan.videos.bagfilms import KINDS as TOPICS
from tiegraph.scan.videos.bagfilms import BagFilm
from tiegraph.scan.videos.videotime import VideoClock
from tiegraph.scene.atomic import real_path, regular, replacing, scratch_folder
from tiegraph.scene.bags import open_bag
from tiegraph.scene.names import clean_names, shortened

# Steps up to which frames of a rig's other cameras are taken: half a one, and a margin for stamps in whole milliseconds
NEAREST_STEPS = 0.75
_TAKEN = ".taken.json"  # hidden: no image

Frame = tuple[float, np.ndarray]  # stamp in s since the start of the recording, BGR picture


@dataclass(frozen=True)
class Choice:
    """The frames of a video that become pictures, with their numbers; and in words."""

    pick: Callable[[Iterator[Frame]], Iterator[tuple[int, Frame]]]
    words: str


@dataclass(frozen=True)
class Pictures:
    """The pictures taken from a video: their numbers and stamps (s), and notes."""

    numbers: tuple[int, ...] = ()
    stamps_s: tuple[float, ...] = ()
    said: str = ""


def picture_folders(videos: Sequence[str]) -> list[str]:
    """A folder for the pictures of each video: its name without the extension, if that is unique; <shot>/fisheye0 and
    <shot>/fisheye1 if two files of a shot have a lens each."""
    safe = ["/".join(shortened(part) for part in name.split("/")) for name in clean_names(videos)]
    bare = [str(PurePosixPath(v).with_suffix("")) for v in safe]
    found = [_of_lens(PurePosixPath(v)) for v in safe]
    shots = [str(PurePosixPath(v).with_name(f"{m[1]}_{m[3]}")) if m else "" for v, m in zip(safe, found)]
    return [
        f"{shot}/fisheye{m[2]}" if m and shots.count(shot) == 2 else b if bare.count(b) == 1 else v.replace(".", "_")
        for shot, m, b, v in zip(shots, found, bare, safe)
    ]


class OpenVideo:
    """An opened video: its frames with their stamps, and its faults."""

    broken = "cannot be decoded as a video: convert it to H.264 in MP4, or extract its pictures"

    def __init__(self, capture: cv2.VideoCapture, delay_s: float = 0.0) -> None:
        self._capture, self._delay_s = capture, delay_s
        self.count = self.unstamped = 0
        fps = float(capture.get(cv2.CAP_PROP_FPS)) if capture.isOpened() else 0.0
        self.fps = fps if 0 < fps < 1000.0 else 0.0  # frames a second; a header with more is wrong
        self.expected = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))

    def frames(self) -> Iterator[Frame]:
        """Frames in order; one whose stamp is not later than the previous one is assumed to follow it by 1 / fps."""
        last = -1.0
        while self.fps:
            there, picture = self._capture.read()
            if not there:
                return
            stamp = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000
            if not (np.isfinite(stamp) and stamp > last):
                stamp = last + 1 / self.fps if self.count else 0.0
                self.unstamped += self.count > 0
            self.count += 1
            last = stamp
            yield stamp + self._delay_s, picture

    def doubts(self) -> str:
        """Faults of the frames read, to follow other words; "" for none."""
        said = ""
        if self.count < 0.95 * self.expected:  # the count in some headers is an estimate
            said += f"; only {self.count} of its {self.expected:.0f} frames could be decoded: is the file cut off?"
        if self.unstamped:
            said += (
                f"; {self.unstamped} of its {self.count} frames have no stamp, or one out of order: assumed "
                f"{1 / self.fps:.3f} s after the one before"
            )
        return said


def check_film(recording: Recording) -> None:
    """Raise OSError for a video that is no file; faults of a bag's topic show when it is opened."""
    if recording.topic is None:
        regular(recording.file, None)


@contextmanager
def open_film(recording: Recording) -> Iterator[OpenVideo | BagFilm]:
    """A video or one track of it, by OpenCV, or the topic of a bag. Raises InputError for a damaged bag."""
    if recording.topic is not None:
        with open_bag(recording.file) as bag:
            yield BagFilm(bag, bag.only(TOPICS, (recording.topic,)))
        return
    os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "protocol_whitelist;file")  # a play list may name a server
    with ExitStack() as stack:
        if recording.track is None:
            capture = _capture(recording.file)
        else:
            view = stack.enter_context(OneVideoTrack(recording.file, recording.track))
            capture = cv2.VideoCapture(view, cv2.CAP_FFMPEG, [])  # type: ignore[call-overload]
        stack.callback(capture.release)
        yield OpenVideo(capture, _delay_s(recording))


def _delay_s(recording: Recording) -> float:
    """When an MP4 shows its first frame by its edit list; OpenCV counts from there, and omits the part cut off."""
    try:
        with regular(recording.file, None).open("rb") as file:
            films = [track for track in tracks(file) if track.kind == VIDEO]
            return edits(file, films[recording.track or 0])[0] if films else 0.0
    except (BrokenTrack, OSError, IndexError):
        return 0.0


def _capture(video: Path) -> cv2.VideoCapture:
    """It gets a link as name: a name that is not UTF-8 would end the process, and %d would mean numbered files."""
    with scratch_folder() as folder:
        link = folder / f"video{video.suffix.lower()}"
        try:
            link.symlink_to(real_path(video))
        except (OSError, NotImplementedError):
            link = video
        return cv2.VideoCapture(str(link))


def take_pictures(recording: Recording, folder: Path, choice: Choice, clock: VideoClock) -> Pictures:
    """Write the chosen frames of a recording below ``folder``, with time and position in their EXIF.

    The folder is made whole or not at all; an existing one is kept. Never raises for a broken video; raises
    InputError for a damaged bag.
    """
    if folder.exists():
        data = json.loads((folder / _TAKEN).read_text())
        return Pictures(tuple(data["numbers"]), tuple(data["stamps_s"]), data["said"])
    name = recording.name
    try:
        check_film(recording)
    except OSError as error:
        return Pictures(said=f"{name} is no video: {error.strerror}")
    numbers, stamps = [], []
    with replacing(folder) as partial, open_film(recording) as opened:
        partial.mkdir()
        for number, (stamp, picture) in choice.pick(opened.frames()):
            write_pixels(partial / f"{folder.name}_{number:06d}.jpg", picture[..., ::-1], clock.taken(stamp))
            numbers.append(number)
            stamps.append(stamp)
        said = f"{name}: {len(stamps)} pictures, {choice.words}{opened.doubts()}"
        if not stamps:
            said = f"{name}: none of its {opened.count} frames is wanted" if opened.count else f"{name} {opened.broken}"
        found = Pictures(tuple(numbers), tuple(stamps), said)
        (partial / _TAKEN).write_text(json.dumps(asdict(found)))
    return found


def sharpest(per_second: float) -> Choice:
    """The sharpest frame of each 1/``per_second`` s.

    Sharpness is the variance of the Laplacian of the reduced grey picture: it only compares neighbours in time.
    """

    def choose(frames: Iterator[Frame]) -> Iterator[tuple[int, Frame]]:
        best: tuple[float, Frame] | None = None
        stretch = number = 0
        for frame in frames:
            now = int((frame[0] + 1e-6) * per_second)  # stamps are rounded by this much
            if now != stretch and best is not None:
                yield number, best[1]
                best, number = None, number + 1
            stretch, sharp = now, _sharpness(frame[1])
            if best is None or sharp > best[0]:
                best = sharp, frame
        if best is not None:
            yield number, best[1]

    return Choice(choose, f"the sharpest of every {1 / per_second:.2g} s")


def nearest(numbers: Sequence[int], stamps_s: Sequence[float], most_s: float) -> Choice:
    """The frame nearest to each of some increasing stamps, at most ``most_s`` away; numbered like them."""

    def choose(frames: Iterator[Frame]) -> Iterator[tuple[int, Frame]]:
        wanted = list(zip(numbers, stamps_s))[::-1]
        before: Frame | None = None
        for frame in frames:
            while wanted and wanted[-1][1] <= frame[0]:
                number, stamp = wanted.pop()
                near = frame if before is None or frame[0] - stamp < stamp - before[0] else before
                if abs(near[0] - stamp) <= most_s:
                    yield number, near
            before = frame
        for number, stamp in wanted[::-1]:
            if before is not None and abs(before[0] - stamp) <= most_s:
                yield number, before

    return Choice(choose, "those nearest in time to the pictures of the rig's first camera")


def _sharpness(picture: np.ndarray) -> float:
    scale = min(1.0, 480 / picture.shape[1])  # width at which sharpness is compared
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), cv2.CV_32F).var())


SUFFIX = ".insv"
_OF_LENS = re.compile(r"^(VID_\d+_\d+)_([01])0_(\d+)$", re.IGNORECASE)


def is_of_lens(recording: Recording) -> bool:
    """Whether a video, by its name, is one lens of a shot, or a track beside another, recorded together with it."""
    return recording.track is not None or _of_lens(recording.file) is not None


def _of_lens(video: PurePath) -> re.Match[str] | None:
    return _OF_LENS.match(video.stem) if video.suffix.lower() == SUFFIX else None


def recordings_of(video: Path, folder: str) -> list[tuple[Recording, str]]:
    """A video with the folder of its pictures; if its two lenses have a track each, <folder>/fisheye0 and 1."""
    shown: list[bytes] = []
    if video.suffix.lower() == SUFFIX:
        with suppress(OSError), regular(video, None).open("rb") as file:
            shown = [track.shown for track in tracks(file) if track.kind == VIDEO]
    if len(shown) != 2 or shown[0] != shown[1]:
        return [(Recording(video), folder)]
    return [(Recording(video, k), f"{folder}/fisheye{k}") for k in range(2)]
