"""Bad input: a clear error that names file, value and remedy, and nothing lost. One test a case of the list."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import tiegraph
import worlds
from tiegraph.cli.main import main
from tiegraph.errors import InputError, ReconstructionError, SettingsError
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene import atomic

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


def _listing(folder: Path) -> list[tuple[str, int, int]]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return [(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in files]


def _dropped(out: Path) -> dict[str, str]:
    """Name -> reason of what the scan left out."""
    return dict(tiegraph.open(out=out).receipt("scan")["dropped"])


@pytest.mark.slow
def test_the_same_flags_again(run: Run) -> None:
    for _ in range(2):  # the second time they are the folder's defaults
        code, said = run("--coarse.method", "off", "--match.guided")
        assert code == 0, said


# ------------------------------------------------------------------------------------------------------- the images


def test_empty_folder(run: Run, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    code, said = run(folder=empty)
    assert code == 2 and str(empty) in said and "empty folder" in said


def test_folder_without_images(run: Run, tmp_path: Path) -> None:
    texts = tmp_path / "texts"
    texts.mkdir()
    (texts / "notes.txt").write_text("not an image")
    code, said = run(folder=texts)
    assert code == 2 and str(texts) in said and ".jpg" in said, "says which kinds of files count as images"


def test_absent_folder_and_a_file_as_folder(run: Run, images: Path, tmp_path: Path) -> None:
    code, said = run(folder=tmp_path / "nowhere")
    assert code == 2 and "nowhere" in said
    code, said = run(folder=images / "up/cam0/000000.jpg")
    assert code == 2 and "000000.jpg" in said and "folder" in said


@pytest.mark.slow
@pytest.mark.usefixtures("children_are_functions")
def test_two_images_make_no_survey_but_a_clear_answer(run: Run, survey: worlds.Survey, tmp_path: Path) -> None:
    pair = tmp_path / "pair"
    pair.mkdir()
    for k in (1, 2):
        shutil.copy(survey.images / f"up/cam0/{k:06d}.jpg", pair)
    code, said = run(folder=pair, until="sparse")
    assert code == 0 and (list((tmp_path / "out/sparse").glob("0/images.bin")) or "2 images" in said)


def test_broken_and_truncated_images_are_left_out_with_a_reason(run: Run, images: Path, tmp_path: Path) -> None:
    (images / "up/cam0/000001.jpg").write_bytes(b"this is not a JPEG")
    whole = (images / "up/cam1/000002.jpg").read_bytes()
    (images / "up/cam1/000002.jpg").write_bytes(whole[: len(whole) // 2])
    (images / "up/cam1/000003.jpg").write_bytes(b"")
    code, said = run()
    assert code == 0, said
    dropped = _dropped(tmp_path / "out")
    assert set(dropped) == {"up/cam0/000001.jpg", "up/cam1/000002.jpg", "up/cam1/000003.jpg"}
    assert "truncated" in dropped["up/cam1/000002.jpg"] and "zero bytes" in dropped["up/cam1/000003.jpg"]
    assert dropped["up/cam0/000001.jpg"]
    scene = tiegraph.open(out=tmp_path / "out").scene()
    assert len(scene) == 5 and scene.frames == 4, "the partners of a broken image stay"


def test_an_image_of_another_size_is_left_out_with_a_reason(run: Run, images: Path, tmp_path: Path) -> None:
    odd = images / "up/cam0/000002.jpg"
    cv2.imwrite(str(odd), np.full((100, 100, 3), 90, np.uint8))
    code, said = run()
    assert code == 0, said
    dropped = _dropped(tmp_path / "out")
    assert list(dropped) == ["up/cam0/000002.jpg"] and "100" in dropped["up/cam0/000002.jpg"]


# -------------------------------------------------------------------------------------------------------- the masks


def _masks(images: Path, folder: Path) -> Path:
    for image in images.rglob("*.jpg"):
        path = folder / image.relative_to(images).with_name(image.name + ".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((240, 320), 255, np.uint8))
    return folder


def test_missing_mask(run: Run, images: Path, tmp_path: Path) -> None:
    masks = _masks(images, tmp_path / "own")
    (masks / "up/cam1/000002.jpg.png").unlink()
    code, said = run("--masks.folder", masks, until="masks")
    assert code == 2 and "up/cam1/000002.jpg" in said and str(masks) in said


def test_masks_that_leave_little_may_be_inverted(run: Run, images: Path, tmp_path: Path) -> None:
    for folder, white, asked in (tmp_path / "own", 255, False), (tmp_path / "inverted", 0, True):
        for path in _masks(images, folder).rglob("*.png"):
            mask = np.full((240, 320), white, np.uint8)
            mask[200:] = 255 - white
            cv2.imwrite(str(path), mask)
        code, said = run("--masks.folder", folder, until="masks")
        assert code == 0 and ("are they inverted?" in said) == asked


def test_mask_of_the_wrong_size(run: Run, images: Path, tmp_path: Path) -> None:
    masks = _masks(images, tmp_path / "own")
    cv2.imwrite(str(masks / "up/cam0/000001.jpg.png"), np.full((120, 160), 255, np.uint8))
    code, said = run("--masks.folder", masks, until="masks")
    assert code == 2 and "000001.jpg.png" in said and "160" in said and "320" in said


@pytest.mark.slow
def test_mask_with_values_that_are_none_is_repaired_by_hand_and_goes_on(run: Run, images: Path, tmp_path: Path) -> None:
    masks = _masks(images, tmp_path / "own")
    cv2.imwrite(str(masks / "up/cam0/000001.jpg.png"), np.full((240, 320), 7, np.uint8))
    code, said = run("--masks.folder", masks, until="masks")
    assert code == 2 and "000001.jpg.png" in said and "7" in said
    cv2.imwrite(str(masks / "up/cam0/000001.jpg.png"), np.full((240, 320), 255, np.uint8))
    code, said = run("--masks.folder", masks, until="masks")
    assert code == 0, said


def test_mask_folder_that_is_not_there(run: Run, tmp_path: Path) -> None:
    code, said = run("--masks.folder", tmp_path / "nowhere", until="masks")
    assert code == 2 and "nowhere" in said


# ------------------------------------------------------------------------------------------------ rig, GNSS, times


def test_rig_file_with_a_camera_that_has_no_images(run: Run, rig: Path) -> None:
    rig.write_text(rig.read_text().replace('folder = "cam1"', 'folder = "camera1"'))
    code, said = run("--rig", rig)
    assert code == 2 and "camera1" in said and rig.name in said


def test_rig_file_with_a_typo(run: Run, rig: Path) -> None:
    rig.write_text(rig.read_text().replace("position_m =", "positon_m =", 1))
    code, said = run("--rig", rig)
    line = 1 + rig.read_text().splitlines().index(next(s for s in rig.read_text().splitlines() if "positon_m =" in s))
    assert code == 2 and "positon_m" in said and "position_m" in said and f"line {line}" in said


def test_rig_file_that_is_not_there_lists_the_presets(run: Run) -> None:
    code, said = run("--rig", "ladybird5")
    assert code == 2 and "ladybird5" in said and "ladybug5" in said


def test_gnss_file_with_wrong_columns(run: Run, rig: Path, tmp_path: Path) -> None:
    gnss = tmp_path / "gnss.csv"
    gnss.write_text("time,x,y,z\n0,1,2,3\n")
    code, said = run("--rig", rig, "--gnss", gnss)
    assert code == 2 and "gnss.csv" in said and "lat" in said and "x, y, z" in said


def test_gnss_file_that_is_not_there(run: Run) -> None:
    code, said = run("--gnss", "nowhere.csv")
    assert code == 2 and "nowhere.csv" in said


def test_gnss_file_with_gaps_leaves_those_frames_without_a_prior(
    run: Run, survey: worlds.Survey, rig: Path, tmp_path: Path
) -> None:
    gnss = worlds.write_gnss(survey, tmp_path / "gnss.csv")
    rows = gnss.read_text().splitlines()
    rows[2] = rows[2].split(",")[0] + ",,,,,"  # a row without a fix
    gnss.write_text("\n".join(rows) + "\n")
    times = worlds.write_times(survey, tmp_path / "times.csv")
    code, said = run("--rig", rig, "--gnss", gnss, "--times", times, "--scan.max-gap-s", 0.5)
    assert code == 0, said
    scene = tiegraph.open(out=tmp_path / "out").scene()
    known = np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1)
    assert known.sum() == 3 and len(scene) == 8
    notes = " ".join(tiegraph.open(out=tmp_path / "out").receipt("scan")["notes"])
    assert "gnss.csv" in notes, "the row left out is told"


# ---------------------------------------------------------------------------------------------- pairs and matching


def test_pair_file_naming_an_unknown_image(run: Run, rig: Path, tmp_path: Path) -> None:
    pairs = tmp_path / "mine.txt"
    pairs.write_text("up/cam0/000000.jpg up/cam0/000001.jpg\nup/cam0/000000.jpg up/cam9/000001.jpg\n")
    code, said = run("--rig", rig, "--candidates.sources", "file", "--candidates.pairs-file", pairs, until="network")
    assert code == 2 and "up/cam9/000001.jpg" in said and "mine.txt" in said and "2" in said


@pytest.mark.slow
def test_pairs_and_control_points_are_held_against_the_images_at_scan_and_before_a_second_run(
    run: Run, rig: Path, tmp_path: Path
) -> None:
    pairs, points = tmp_path / "mine.txt", tmp_path / "gcp_list.txt"
    one = "up/cam0/000000.jpg"
    pairs.write_text(f"{one} {one}\n{one} up/cam0/000001.jpg\n")
    head, place = "EPSG:32654\n", "386000 3951000 3"
    points.write_text(f"{head}{place} 5 5 {one} A\n{place} 5 5 up/cam0/000009.jpg A\n")
    given = ("--rig", rig, "--candidates.sources", "file", "--candidates.pairs-file", pairs, "--gcp", points)
    code, said = run(*given)
    assert code == 0, said
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
        code, said = run("--cloud.voxel-size", 0.5, until="cloud")
        assert code == 2 and message in said and path.name in said
        assert (tmp_path / "out/tiegraph.toml").read_bytes() == stored and not (tmp_path / "out/masks").exists()
        path.write_text(right)


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.usefixtures("children_are_functions")
def test_images_without_texture_end_in_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There is no model, and the exit code says so only if it is asked for."""
    (tmp_path / "images").mkdir()
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"images/{k}.jpg"), np.full((240, 320, 3), 60 + 10 * k, np.uint8))
    out = tmp_path / "out"
    for more, code in (
        ([], 0),
        (["--until", "georef"], 0),
        (["--strict"], 3),
        (["--strict", "--until", "features"], 0),
    ):
        assert main(["run", str(tmp_path / "images"), "-o", str(out), "--pool", "serial", *more]) == code
    said = json.loads((out / "report.json").read_text())
    assert said["verdict"]["level"] == "poor" and "No model could be made" in said["verdict"]["headline"]
    assert any("no pair verified" in text for text in said["contradictions"])
    assert not any("interrupted" in text for text in said["warnings"])
    assert not (out / "world.json").exists() and "no pair verified" in capsys.readouterr().err


# --------------------------------------------------------------------------------------------------------- settings


def test_unknown_setting(run: Run, images: Path, tmp_path: Path) -> None:
    code, said = run("--masks.sky-egde", 3)
    assert code == 2 and "sky-edge" in said
    with pytest.raises(SettingsError, match="sky_egde.*sky_edge"):
        tiegraph.open(images, tmp_path / "out", settings={"masks": {"sky_egde": 3}})
    (tmp_path / "out").mkdir()
    (tmp_path / "out/tiegraph.toml").write_text("[masks]\nsky_egde = 3\n")
    code, said = run()
    assert code == 2 and "tiegraph.toml" in said and "sky_edge" in said


def test_a_setting_that_was_stored_can_be_taken_out_again(run: Run, tmp_path: Path) -> None:
    (tmp_path / "masks").mkdir()
    code, said = run("--masks.source", "folder", "--masks.folder", tmp_path / "masks", until="scan")
    stored = tmp_path / "out/tiegraph.toml"
    assert code == 0 and "folder =" in stored.read_text(), said
    (tmp_path / "masks").rmdir()
    assert run(until="masks")[0] == 2
    code, said = run("--unset", "masks.folder", "--unset", "masks.source", until="scan")
    assert code == 0 and "folder =" not in stored.read_text(), said


@pytest.mark.slow
def test_setting_out_of_range_unknown_stage_preset_pool_and_input(run: Run, images: Path, tmp_path: Path) -> None:
    code, said = run("--masks.difference", 999)
    assert code == 2 and "difference" in said and "999" in said
    assert run(until="spasre")[0] == 2
    assert run("--preset", "meguro2042")[0] == 2
    assert run("--pool", "clowd")[0] == 2
    with pytest.raises(SettingsError, match="gps"):
        tiegraph.open(images, tmp_path / "out", gps="x.csv")


# -------------------------------------------------------------------------------------------------------- disk full


@pytest.mark.slow
@pytest.mark.parametrize("artefact", ["scene.json", "000002.jpg.png", "masks.json"])
def test_disk_full_says_so_and_the_next_run_goes_on(
    artefact: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, made = os.replace, []

    def full(source: object, target: object) -> None:
        if str(target).endswith(artefact):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        made.append(str(target))
        real(source, target)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(atomic.os, "replace", full)
        code, said = run("--masks.source", "meguro2024", until="masks")
    assert code == 2 and artefact in said and "No space left" in said and "space" in said
    assert not list((tmp_path / "out").rglob("*.part*")), "no half-written file stays"
    before = {p: p.stat().st_mtime_ns for p in map(Path, made) if p.suffix == ".png" and p.exists()}
    code, said = run("--masks.source", "meguro2024", until="masks")
    assert code == 0, said
    assert all(path.stat().st_mtime_ns == when for path, when in before.items()), "finished masks were made again"


_LIMITED = """
import resource, sys
limit = int(sys.argv[1])  # bytes of a file; a write past it fails, as on a full disk
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
from tiegraph.cli.main import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.slow
def test_database_that_cannot_grow_says_so_and_the_next_run_goes_on(run: Run, images: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ["run", str(images), "-o", str(out), "--pool", "serial", "--until", "match"]
    limited = subprocess.run(
        [sys.executable, "-c", _LIMITED, "400000", *command], capture_output=True, text=True, timeout=300, check=False
    )
    assert limited.returncode in (1, 2), limited.stderr
    assert "Traceback" not in limited.stderr and "ulimit -f" in limited.stderr and str(out) in limited.stderr
    scanned = (out / "receipts/scan.json").read_bytes()
    code, said = run(until="match")
    assert code == 0, said
    assert (out / "receipts/scan.json").read_bytes() == scanned, "finished stages were made again"
    assert tiegraph.open(out=out).receipt("features")["counts"]["images"] == 8


def test_output_folder_that_cannot_be_made(images: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="file"):
        tiegraph.open(images, tmp_path / "file" / "out", pool="serial").run(until="scan")
