"""Nothing that is no file is opened, and nothing that a file declares is believed: no input makes the scan wait."""

import os
import socket
import struct
import time
import zlib
from pathlib import Path

import pytest
from PIL import Image
from scan_worlds import papers_rig, picture

import tiegraph
from said import refused
from tiegraph.cli.main import main
from tiegraph.scan.recording import Recording
from tiegraph.scan.videos.video import sharpest, take_pictures
from tiegraph.scan.videos.videotime import VideoClock
from tiegraph.scene import images as scene_images
from tiegraph.scene.atomic import regular
from tiegraph.scene.images import probe_image, search_images

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def images(tmp_path: Path) -> Path:
    return papers_rig(tmp_path / "images", frames=2)


def scanned(images: Path, out: Path, *more: str) -> int:
    return main(["run", str(images), "-o", str(out), "--pool", "serial", "--quiet", "--until", "scan", *more])


@pytest.mark.slow
def test_pipes_devices_and_rings_of_links_among_the_images_are_left_out_with_a_reason(images, tmp_path):
    os.mkfifo(images / "up/cam0/pipe.jpg")
    (images / "up/cam0/zero.jpg").symlink_to("/dev/zero")
    (images / "up/cam0/ring.jpg").symlink_to("ring.jpg")
    for name in ("a", "b"):
        (images / name).symlink_to(images, target_is_directory=True)
    (images / "up/again").symlink_to(images / "up/cam0", target_is_directory=True)
    (images / "above").symlink_to("/", target_is_directory=True)
    assert scanned(images, tmp_path / "out") == 0
    made = tiegraph.open(out=tmp_path / "out").receipt("scan")
    assert made["counts"]["images"] == 12
    reasons = dict(made["dropped"])
    assert "a named pipe, not a file" in reasons["up/cam0/pipe.jpg"]
    assert "a device, not a file" in reasons["up/cam0/zero.jpg"]
    assert "links" in reasons["up/cam0/ring.jpg"] and len(reasons) == 3
    passed = [note for note in made["notes"] if "skipped" in note]
    assert len(passed) == 4 and sum("above leads up to /" in note for note in passed) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "pool", ["local:100000", "local:0", "local:-1", "local:x", "serial:3", "clowd", "local:9" + "9" * 5000]
)
def test_an_impossible_pool_is_refused_before_anything_starts(images, tmp_path, pool, capsys):
    assert main(["run", str(images), "-o", str(tmp_path / "out"), "--pool", pool]) == 2
    said = capsys.readouterr().err
    assert pool[:20] in said and ("cores" in said) == pool.startswith(("local:1", "local:9"))
    assert not (tmp_path / "out/receipts").exists()


def test_a_folder_reached_by_a_link_alone_counts_at_the_link(tmp_path: Path) -> None:
    papers_rig(tmp_path / "elsewhere", passes=("day1",), cameras=1)
    picture(tmp_path / "images" / "z" / "0.jpg")
    for link, target in (("a", "images/z"), ("b", "elsewhere/day1")):
        (tmp_path / "images" / link).symlink_to(tmp_path / target, target_is_directory=True)
    names, notes = search_images(tmp_path / "images")
    assert names == ["b/cam0/000000.jpg", "b/cam0/000001.jpg", "b/cam0/000002.jpg", "z/0.jpg"]
    assert len(notes) == 1 and "z, which is searched already" in notes[0]


def test_a_folder_that_cannot_be_read_is_named(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.scandir

    def closed(path: Path):
        if Path(path).name == "cam1":
            raise PermissionError(13, "Permission denied", str(path))
        return real(path)

    monkeypatch.setattr(scene_images.os, "scandir", closed)
    with refused("up/cam1: cannot be read .Permission denied"):
        search_images(images / "up")


def test_what_is_no_file_says_what_it_is(tmp_path: Path) -> None:
    with open(tmp_path / "large", "wb") as file:
        file.truncate(10**12)  # takes no room
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(str(tmp_path / "s"))
        for name, words in (("s", "a socket, not"), (".", "a folder, not"), ("large", "931 GiB, more than the 4 GiB")):
            with pytest.raises(OSError, match=words):
                regular(tmp_path / name)
    assert regular(tmp_path / "large", None).name == "large"


def png(width: int, height: int, rows: bytes) -> bytes:
    parts = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(rows)))
    out = b"\x89PNG\r\n\x1a\n"
    for name, data in (*parts, (b"IEND", b"")):
        out += struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    return out


def tiff(width: int, next_page: int) -> bytes:
    """Grey, 64 rows at byte 300."""
    tags = ((256, width), (257, 64), (258, 8), (259, 1), (262, 1), (273, 300), (277, 1), (278, 64), (279, 4096))
    page = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    return (b"II*\0" + struct.pack("<I", 8) + page + struct.pack("<I", next_page)).ljust(300, b"\0") + bytes(4096)


BOMBS = {
    "all.png": (png(2**31 - 1, 2**31 - 1, bytes(1000)), "pixels"),
    "large.png": (png(40_000, 10_000, bytes(120_001 * 100)), "that is no photograph"),
    "huge.ppm": (b"P6 99999999 99999999 255\n" + bytes(1000), "pixels"),
    "wide.tif": (tiff(2**31 - 1, 0), "pixels"),
    "ring.tif": (tiff(64, 8), ""),  # its page is its next page: read once
}


@pytest.mark.parametrize("name", BOMBS)
def test_an_image_is_not_taken_by_its_own_word(tmp_path: Path, name: str) -> None:
    data, reason = BOMBS[name]
    (tmp_path / name).write_bytes(data)
    began = time.monotonic()
    said = probe_image(tmp_path / name).reason
    assert reason in said if reason else not said
    assert time.monotonic() - began < 20


def test_a_black_photograph_is_no_bomb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_images, "_BOMB_PX", 10_000)
    (tmp_path / "black.png").write_bytes(png(1000, 1000, bytes(3001 * 1000)))
    assert probe_image(tmp_path / "black.png").reason
    Image.new("RGB", (1000, 1000)).save(tmp_path / "black.jpg", quality=50)
    assert not probe_image(tmp_path / "black.jpg").reason


def test_what_is_no_video_does_not_hold_the_scan(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "empty.mp4").write_bytes(b"")
    (tmp_path / "text.mp4").write_text("no video" * 100)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}/a.ts"
        (tmp_path / "list.mkv").write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{address}\n#EXT-X-ENDLIST\n")
        for name in ("pipe.mp4", "empty.mp4", "text.mp4", "list.mkv"):
            out = tmp_path / "out" / name
            taken = take_pictures(Recording(tmp_path / name), out, sharpest(1.0), VideoClock())
            assert ("named pipe" if name == "pipe.mp4" else "decoded") in taken.said
