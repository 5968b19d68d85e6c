"""When a video was recorded: by its container, by the subtitles of a DJI drone beside it, or from its own start."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from tiegraph.scan.djisubtitles import Subtitles, read_subtitles, subtitles_of
from tiegraph.scan.mp4 import boxes
from tiegraph.scan.settings import ScanSettings, video_offsets
from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scene.exifwrite import Taken
from tiegraph.scene.names import clean
from tiegraph.scene.regular import regular

_MP4_EPOCH_S = datetime(1904, 1, 1, tzinfo=timezone.utc).timestamp()  # ISO/IEC 14496-12, 8.2.2


@dataclass(frozen=True)
class VideoClock:
    """How the stamps of a video become times: ``start_s`` + stamp, seconds since 1970; not known: since the start."""

    start_s: float = 0.0
    known: bool = False
    utc: bool = False
    shared: bool = False  # with others: the stamps of messages, of which the start is one
    subtitles: Subtitles | None = None
    note: str = ""

    def taken(self, stamp_s: float) -> Taken:
        """When and where the frame with a stamp was taken."""
        place = self.subtitles.place(stamp_s) if self.subtitles is not None else Taken()
        return Taken(
            time_s=self.start_s + stamp_s,
            utc=self.utc,
            lat_deg=place.lat_deg,
            lon_deg=place.lon_deg,
            height_m=place.height_m,
            sigma_m=place.sigma_m,
        )


def video_clock(video: Path, settings: ScanSettings, tuning: PicturesTuning) -> VideoClock:
    """The clock of a video, what ``scan.video_offset`` says of all videos applied; never raises for a broken file."""
    name, file, told = clean(video.name), subtitles_of(video), video_offsets(settings.video_offset)
    subtitles = None if file is None else read_subtitles(file, settings.gnss_sigma_m)
    notes = [] if file is None or subtitles is None else subtitles.notes(clean(file.name))
    if file is not None and subtitles is None:
        notes.append(f"{clean(file.name)}: subtitles, but no times or positions of a DJI drone in them: not used")
    if subtitles is not None and np.isfinite(subtitles.start_s):
        start, known, utc = subtitles.start_s, True, False
    else:
        start, known, said = _by_container(video, told.from_end, tuning)
        utc = known
        notes.append(f"{name}: {said}")
    known = known or told.all_s != 0
    return VideoClock(start_s=start + told.all_s, known=known, utc=utc, subtitles=subtitles, note="; ".join(notes))


def _by_container(video: Path, from_end: bool, tuning: PicturesTuning) -> tuple[float, bool, str]:
    """Start, whether it is known, and what to say of it."""
    created = _created(video)
    if created is None or not tuning.recorded_range_s[0] <= created[0] <= tuning.recorded_range_s[1]:
        remedy = "--scan.video-offset says when it began (seconds since 1970)"
        return 0.0, False, f"it does not say when it was recorded: its times count from its start; {remedy}"
    time_s, length_s = created
    start = time_s - (length_s if from_end else 0.0)
    when = datetime.fromtimestamp(start, timezone.utc).strftime("%Y-%m-%d %H:%M:%S")
    doubt = "which has whole seconds and may be local or that of its end (--scan.video-offset SECONDS, or end)"
    return start, True, f"begins at {when} UTC by the creation time in it, {doubt}"


def _created(video: Path) -> tuple[float, float] | None:
    """Creation time (seconds since 1970) and length (s) in the movie header of an MP4 or QuickTime file."""
    try:
        with regular(video, None).open("rb") as file:
            size = file.seek(0, 2)
            movie = next(boxes(file, b"moov", 0, size), None)
            header = movie and next(boxes(file, b"mvhd", *movie), None)
            if not header:
                return None
            file.seek(header[0])
            data = file.read(32)
            wide = data[0] == 1
            created, _, scale, length = struct.unpack_from(">QQIQ" if wide else ">IIII", data, 4)
    except (OSError, struct.error, IndexError):
        return None
    return created + _MP4_EPOCH_S, length / scale if scale else 0.0
