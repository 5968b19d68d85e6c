"""Bad input on the command line: a clear error that names file, value and remedy, and nothing lost."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

import tiegraph
import worlds
from campaign.process import Server
from said import refused, says
from tiegraph.cli.main import main
from tiegraph.errors import ReconstructionError
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene import atomic

pytestmark = pytest.mark.slow
Run = Callable[..., tuple[int, str]]


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> worlds.Survey:
    """One pass of two cameras, four frames: eight images."""
    return worlds.make_survey(tmp_path_factory.mktemp("survey") / "images", passes=("up",), frames=4)


@pytest.fixture
def images(survey: worlds.Survey, tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(survey.images, tmp_path / "images"))


@pytest.fixture
def rig(survey: worlds.Survey, tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    write_rig_toml(survey.rig, path)
    return path


@pytest.fixture
def run(images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """``tiegraph run`` up to a stage: (exit code, what it said); the images must be as they were."""

    def command(*options: object, until: str = "scan", folder: Path = images) -> tuple[int, str]:
        before = _listing(folder)
        arguments = ["run", str(folder), "-o", str(tmp_path / "out"), "--pool", "serial", "--until", until]
        code = main([*arguments, *map(str, options)])
        said = capsys.readouterr()
        assert _listing(folder) == before, "the user's images were touched"
        return code, said.out + said.err

    return command


@pytest.fixture
def runs(run: Run) -> Callable[..., None]:
    """A run that must succeed."""

    def command(*options: object, **how: object) -> None:
        code, said = run(*options, **how)
        assert code == 0, said

    return command


@pytest.fixture
def refuses(run: Run) -> Callable[..., None]:
    """A run that must end with exit code 2 and say all the words."""

    def command(*options: object, said: Sequence[object] = (), **how: object) -> None:
        code, text = run(*options, **how)
        assert code == 2 and [w for w in said if str(w) not in text] == [], text

    return command


def _listing(folder: Path) -> list[tuple[str, int, int]]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return [(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in files]


def test_the_same_flags_again(runs: Run) -> None:
    for _ in range(2):  # the second time they are the folder's defaults
        runs("--coarse.method", "off", "--match.guided")


@pytest.mark.usefixtures("children_are_functions")
def test_two_images_make_no_survey_but_a_clear_answer(run: Run, survey: worlds.Survey, tmp_path: Path) -> None:
    pair = tmp_path / "pair"
    pair.mkdir()
    for k in (1, 2):
        shutil.copy(survey.images / f"up/cam0/{k:06d}.jpg", pair)
    code, said = run(folder=pair, until="sparse")
    assert code == 0 and (list((tmp_path / "out/sparse").glob("0/images.bin")) or "2 images" in said)


def _masks(images: Path, folder: Path, white: int = 255) -> Path:
    """Masks of all images, white but for the last rows."""
    mask = np.full((240, 320), white, np.uint8)
    mask[200:] = 255 - white
    for image in images.rglob("*.jpg"):
        path = folder / image.relative_to(images).with_name(image.name + ".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)
    return folder


def test_masks_that_leave_little_may_be_inverted(run: Run, images: Path, tmp_path: Path) -> None:
    for folder, white, asked in (tmp_path / "own", 255, False), (tmp_path / "inverted", 0, True):
        code, said = run("--masks.folder", _masks(images, folder, white), until="masks")
        assert code == 0 and ("are they inverted?" in said) == asked


def test_pairs_and_control_points_are_held_against_the_images_at_scan_and_before_a_second_run(
    runs: Run, refuses: Run, rig: Path, tmp_path: Path
) -> None:
    pairs, points = tmp_path / "mine.txt", tmp_path / "gcp_list.txt"
    one = "up/cam0/000000.jpg"
    pairs.write_text(f"{one} {one}\n{one} up/cam0/000001.jpg\n")
    head, place = "EPSG:32654\n", "386000 3951000 3"
    points.write_text(f"{head}{place} 5 5 {one} A\n{place} 5 5 up/cam0/000009.jpg A\n")
    runs("--rig", rig, "--candidates.sources", "file", "--candidates.pairs-file", pairs, "--gcp", points)
    notes = "\n".join(tiegraph.open(out=tmp_path / "out").receipt("scan")["notes"])
    assert "1 pairs from mine.txt; ignored: 1 self pairs (line 1)" in notes
    assert "gcp_list.txt, line 3: image 'up/cam0/000009.jpg' is not in the survey" in notes
    assert "1 of 1 points have less than 2 marks" in notes
    stored = (tmp_path / "out/tiegraph.toml").read_bytes()
    for path, text, message in (
        (points, f"{head}{place} 999 5 {one} A\n", "line 2: the mark (999, 5) of point 'A' lies outside"),
        (pairs, f"{one} {one}\n", "line 1: its 1 lines pair images with themselves"),
        (pairs, f"{one} up/cam9/0.jpg\n", "line 1: the survey has no image 'up/cam9/0.jpg'"),
    ):
        right = path.read_text()
        path.write_text(text)
        refuses("--cloud.voxel-size", 0.5, until="cloud", said=(message, path.name))
        assert (tmp_path / "out/tiegraph.toml").read_bytes() == stored and not (tmp_path / "out/masks").exists()
        path.write_text(right)


@pytest.mark.usefixtures("children_are_functions")
def test_no_matches_at_all(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(5):
        (tmp_path / "images").mkdir(exist_ok=True)
        blobs = cv2.resize(rng.integers(0, 256, (30, 40, 3), np.uint8), (320, 240), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(tmp_path / f"images/{k}.jpg"), blobs)
    project = tiegraph.open(tmp_path / "images", tmp_path / "out", pool="serial")
    with pytest.raises(ReconstructionError, match="no pair verified"):
        project.run(until="match")
    assert (tmp_path / "out/database.db").exists() and project.receipt("features")["counts"]["images"] == 5


@pytest.mark.usefixtures("children_are_functions")
def test_images_without_texture_end_in_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There is no model, and the exit code says so only if it is asked for."""
    (tmp_path / "images").mkdir()
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"images/{k}.jpg"), np.full((240, 320, 3), 60 + 10 * k, np.uint8))
    out = tmp_path / "out"
    for more, code in (("", 0), ("--until georef", 0), ("--strict", 3), ("--strict --until features", 0)):
        command = ["run", str(tmp_path / "images"), "-o", str(out), "--pool", "serial", *more.split()]
        assert main(command) == code
    said = json.loads((out / "report.json").read_text())
    assert said["verdict"]["level"] == "poor" and "No model could be made" in said["verdict"]["headline"]
    assert says(said["contradictions"], "no pair verified.* 4 of 4 images show little contrast, 0.0 grey levels")
    assert not says(said["warnings"], "interrupted")
    assert not (out / "world.json").exists() and "no pair verified" in capsys.readouterr().err


@pytest.mark.parametrize("artefact", ["scene.json", "000002.jpg.png", "masks.json"])
def test_disk_full_says_so_and_the_next_run_goes_on(
    artefact: str, runs: Run, refuses: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, made = os.replace, []

    def full(source: object, target: object) -> None:
        if str(target).endswith(artefact):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        made.append(str(target))
        real(source, target)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(atomic.os, "replace", full)
        refuses("--masks.source", "meguro2024", until="masks", said=(artefact, "No space left", "space"))
    assert not list((tmp_path / "out").rglob("*.part*")), "no half-written file stays"
    before = {p: p.stat().st_mtime_ns for p in map(Path, made) if p.suffix == ".png" and p.exists()}
    runs("--masks.source", "meguro2024", until="masks")
    assert all(path.stat().st_mtime_ns == when for path, when in before.items()), "finished masks were made again"


@pytest.mark.usefixtures("children_are_functions")
def test_database_that_cannot_grow_says_so_and_the_next_run_goes_on(
    runs: Run, images: Path, server: Server, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    command = ["run", str(images), "-o", str(out), "--pool", "serial", "--until", "features"]
    # A write past the limit fails, as on a full disk.
    limited = server.run(command, tmp_path / "said", 300, file_bytes=400_000)
    assert limited.code in (1, 2), limited
    assert "Traceback" not in limited.text and "ulimit -f" in limited.text and str(out) in limited.text
    scanned = (out / "receipts/scan.json").read_bytes()
    runs(until="features")
    assert (out / "receipts/scan.json").read_bytes() == scanned, "finished stages were made again"
    assert tiegraph.open(out=out).receipt("features")["counts"]["images"] == 8


def test_output_folder_that_cannot_be_made(images: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with refused("file"):
        tiegraph.open(images, tmp_path / "file" / "out", pool="serial").run(until="scan")
