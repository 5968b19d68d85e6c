"""File names that are no text, too long, or lead elsewhere; order of names; what is kept of files in memory."""

from __future__ import annotations

import json
import os
import unicodedata
from pathlib import Path

import numpy as np
import pytest

import tiegraph
import worlds
from said import refused
from scan.scan_worlds import picture
from tiegraph.cli.main import main
from tiegraph.errors import SettingsError
from tiegraph.masks.folder import find_mask
from tiegraph.pipeline import features as previews
from tiegraph.pipeline import network
from tiegraph.project.settings import merged
from tiegraph.scan.scan import safe_names
from tiegraph.scene.atomic import cached_by_file
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.decoding import read_pixels
from tiegraph.scene.names import LONGEST_BYTES, check_name, clean, clean_names, inside, shortened, unclean
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.sorting import order_of, row_numbers, run_starts
from tiegraph.text import one_line, printable

SJIS = os.fsdecode(b"\x8e\xca\x90^.jpg")  # "photograph" in Shift-JIS, as Linux hands it to Python
ESCAPED = "%8E\u0290^.jpg"  # two of its bytes happen to be a letter in UTF-8


def test_a_name_is_text_after_cleaning_and_two_files_never_become_one() -> None:
    assert clean(SJIS) == ESCAPED and clean("a\x1b[31m\n\u202e.jpg") == "a%1B[31m%0A%E2%80%AE.jpg"
    assert clean("戻り 50%.jpg") == "戻り 50%.jpg", "what is text stays as it is"
    for name in (SJIS, "a\x1b\n.jpg", "b\x8e\u202ea.jpg", "100%41.jpg", os.fsdecode(b"%41\xff")):
        clean(name).encode()
        assert unclean(clean(name)) == name
    given = [f"{SJIS}/1.jpg", f"{ESCAPED}/1.jpg", f"{SJIS}/2.jpg", "plain/1.jpg"]
    made = clean_names(given)
    assert len(set(made)) == 4 and made[1] == given[1] and made[3] == given[3]
    assert Path(made[0]).parent == Path(made[2]).parent, "files of a folder stay together"
    assert clean_names(["a/b.jpg"]) == ["a/b.jpg"]


@pytest.mark.parametrize("name", ["x" * 241 + ".jpg", "戻" * 80 + ".jpg", "pass" * 60 + "/cam0/1.jpg", "x." + "y" * 99])
def test_long_names_leave_room_for_what_is_added(name: str) -> None:
    parts = [shortened(p) for p in name.split("/")]
    assert all(len(os.fsencode(p)) <= LONGEST_BYTES for p in parts)
    assert shortened(name[:-5] + "1.jpg") != shortened(name[:-5] + "2.jpg") or "/" in name
    assert shortened("short.jpg") == "short.jpg"


def test_safe_names_are_short_text_and_unique() -> None:
    given = ["x" * 240 + "1.jpg", "x" * 240 + "2.jpg", SJIS, "a b#.jpg"]
    safe = safe_names(given)
    assert len(set(safe)) == 4 and safe[2] == ESCAPED and safe[3] == "a_b_.jpg"
    assert all(len(s.encode()) <= LONGEST_BYTES and s.endswith(".jpg") for s in safe)
    for name in safe:
        check_name(name)


BAD = ("../../x.jpg", "/etc/x", "a//b", "..", ".", "", "a/../b", "a\0b", "a\x1b.jpg", "a\\..\\b", SJIS, 5, "a\u202eb")


@pytest.mark.parametrize("name", BAD)
def test_names_that_lead_elsewhere_are_refused(name: object, tmp_path: Path) -> None:
    with refused("image name"):
        inside(tmp_path, name)  # type: ignore[arg-type]
    assert inside(tmp_path, "up/cam 0/ü..jpg") == tmp_path / "up/cam 0/ü..jpg"


@pytest.mark.parametrize("name", BAD[:7])
def test_a_scene_refuses_them(name: str) -> None:
    rig, arrays = Rig("r", (Sensor("cam0"),)), ([0, 1], [0, 0])
    text = simple_scene(rig, ["a.jpg", "b.jpg"], *arrays).to_json()  # type: ignore[arg-type]
    assert Scene.from_json(text).names == ("a.jpg", "b.jpg")
    with refused("image name"):
        Scene.from_json(text.replace('"b.jpg"', f'"{name}"'))


def test_what_acts_is_shown_as_an_escape() -> None:
    assert printable(f"a\x1b[2J\r\x07\u202e{SJIS}\nb\tc") == "a\\x1b[2J\\r\\x07\\u202e\\x8e\u0290^.jpg\nb\tc"
    assert one_line("a\nb") == "a\\nb" and printable("戻り é") == "戻り é"


@pytest.mark.slow
def test_pixels_of_a_file_that_opencv_could_not_name(tmp_path: Path) -> None:
    survey = worlds.make_survey(tmp_path / "s", passes=("up",), frames=1)
    path = tmp_path / SJIS
    path.write_bytes((survey.images / "up/cam0/000000.jpg").read_bytes())
    pixels = read_pixels(path)  # with cv2.imread the interpreter would end here
    assert pixels.shape == (240, 320)
    (tmp_path / "empty.jpg").touch()
    assert read_pixels(tmp_path / "empty.jpg") is None and read_pixels(tmp_path / "none.jpg") is None


def test_no_module_hands_a_path_to_opencv() -> None:
    source = Path(tiegraph.__file__).parent
    for path in source.rglob("*.py"):
        assert "cv2.imread(" not in path.read_text() and "cv2.imwrite(" not in path.read_text(), f"{path}: read_pixels"


def test_the_mask_of_an_image_with_such_a_name(tmp_path: Path) -> None:
    (tmp_path / f"{SJIS}.png").touch()
    assert find_mask(tmp_path, ESCAPED) == tmp_path / f"{SJIS}.png"
    assert find_mask(tmp_path, "x" * 251 + ".jpg") is None, "too long for a mask's name: no error"


@pytest.mark.parametrize("folder", ["NFC", "NFD"])
@pytest.mark.parametrize("file", ["NFC", "NFD"])
def test_a_mask_is_found_in_whatever_normal_form_folders_and_files_are(tmp_path: Path, folder: str, file: str) -> None:
    path = tmp_path / unicodedata.normalize(folder, "Süd") / f"{unicodedata.normalize(file, 'Höhe_1')}.jpg.png"
    path.parent.mkdir()
    path.touch()
    (name,) = clean_names([f"{unicodedata.normalize('NFD', 'Süd')}/Höhe_1.jpg"])
    assert name == "Süd/Höhe_1.jpg" and find_mask(tmp_path, name) == path


def scanned(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[Scene, str]:
    """The scene of a run's scan, and what it said."""
    out = folder / "out"
    code = main(["run", str(folder / "images"), "-o", str(out), "--pool", "serial", "--until", "scan", *more])
    said = capsys.readouterr().err
    assert code == 0, said
    return Scene.from_json((out / "scene.json").read_text()), said


@pytest.mark.slow
@pytest.mark.parametrize(("disk", "typed"), [("NFD", "NFC"), ("NFC", "NFD")])
def test_names_in_the_normal_forms_of_two_systems_are_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], disk: str, typed: str
) -> None:
    def written(name: str, text: str) -> str:
        (tmp_path / name).write_text(unicodedata.normalize(typed, text), encoding="utf-8")
        return str(tmp_path / name)

    names = [f"Rückweg/höhe{c}/Brücke_{k}.jpg" for c in range(2) for k in range(4)]
    for name in names:
        picture(tmp_path / "images" / unicodedata.normalize(disk, name), (320, 240))
    poses = [{"file_path": n, "transform_matrix": [[1, 0, 0, k], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]} for k, n in
             enumerate(names)]  # fmt: skip
    rows = "".join(f"{n},{35 + k % 4 * 1e-5},139,10\n" for k, n in enumerate(names))
    marks = "".join(f"{1e-5 * k + 139} 35.0 0 {30 + 9 * k} 40 {n} Tür{k}\n" for k in range(3) for n in names[:2])
    given = {
        "--rig": written("rig.toml", "".join(f'[[sensors]]\nname = "höhe{c}"\nposition_m = [{c}, 0, 0]\n'
                         "yaw_pitch_roll_deg = [0, 0, 0]\n" for c in range(2))),
        "--gnss": written("gnss.csv", f"image,lat,lon,height\n{rows}"),
        "--times": written("times.csv", "pass,frame,time\n" + "".join(f"Rückweg,Brücke_{k},{k}\n" for k in range(4))),
        "--gcp": written("gcp_list.txt", f"EPSG:4326\n{marks}"),
        "--start": written("transforms.json", json.dumps({"frames": poses}, ensure_ascii=False)),
        "--candidates.pairs-file": written("pairs.txt", f"{names[0]} {names[5]}\n"),
    }  # fmt: skip
    options = (word for pair in given.items() for word in pair)
    scene, said = scanned(tmp_path, capsys, "--candidates.sources", "file", *options)
    assert scene.names == tuple(names) and scene.frames == 4 and scene.time_s.tolist() == [0, 1, 2, 3]
    assert scene.has_positions() and "1 pairs from pairs.txt" in said and "not here" not in said


@pytest.mark.slow
def test_two_files_that_only_differ_in_their_normal_form_are_kept_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for form in ("NFC", "NFD"):
        picture(tmp_path / "images" / unicodedata.normalize(form, "Höhe.jpg"))
    scene, said = scanned(tmp_path, capsys)
    assert scene.names == ("Höhe.jpg", "Höhe_2.jpg")
    assert "1 images have the names of others but for the normal form of Unicode" in said


def test_a_model_with_such_a_name_is_refused(tmp_path: Path) -> None:
    for name, text in (("cameras", "1 PINHOLE 10 10 5 5 5 5\n"), ("points3D", ""), ("images", "1 1 0 0 0 0 0 0 1 ")):
        (tmp_path / f"{name}.txt").write_bytes(text.encode() + (b"\x8e\xca.jpg\n\n" if name == "images" else b""))
    with refused("not a readable COLMAP model"):
        read_model(tmp_path)


@pytest.mark.parametrize("value", ["a\x1bb", os.fsdecode(b"\x8e\xca"), "a\nb"])
def test_paths_that_no_file_of_ours_could_hold_are_refused(value: str, tmp_path: Path) -> None:
    for given in ({"images": tmp_path / value}, {"images": tmp_path, "out": tmp_path / value}):
        with refused(r"control characters.*UTF-8"):
            tiegraph.open(**given)  # type: ignore[arg-type]
    with refused("gnss"):
        tiegraph.open(tmp_path, tmp_path / "o", gnss=value)
    with pytest.raises(SettingsError, match="control characters"):
        merged({"masks": {"folder": value}})
    assert main(["status", value]) == 2


@pytest.mark.slow
def test_a_survey_of_nasty_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    survey = worlds.make_survey(tmp_path / "s", passes=("up",), frames=3)
    nasty = os.fsencode(tmp_path) + b"/images/\x8e\xca\x1b[31m\n\xe2\x80\xae$\\frac{ <script>'\""
    for k, path in enumerate(sorted(survey.images.rglob("*.jpg"))):
        folder = nasty + b"/" + path.parent.name.encode()
        os.makedirs(folder, exist_ok=True)
        with open(folder + f"/{path.stem}_{'x' * 234}{k}.jpg".encode(), "wb") as file:
            file.write(path.read_bytes())
    out = tmp_path / "out 'q\" #%20 $\\frac{"
    code = main(["run", str(tmp_path / "images"), "-o", str(out), "--pool", "serial", "--until", "preview"])
    said = capsys.readouterr().err
    assert code == 0, said
    assert "\x1b" not in said and "\u202e" not in said
    assert "6 images have names with control characters or bytes that are not UTF-8" in said
    made = [p for f in ("images", "masks", "preview") for p in (out / f).rglob("*") if p.is_file()]
    assert len(made) == 18 and all(len(os.fsencode(p.name)) < 255 for p in made)
    log = (out / "log.txt").read_text(encoding="utf-8")
    assert "\x1b" not in log and "\u202e" not in log


@pytest.mark.parametrize("most", [10, 2**40])
def test_order_is_stable(most):
    numbers = np.random.default_rng(0).integers(0, most, 1000)
    order = order_of(numbers)
    np.testing.assert_array_equal(order, np.argsort(numbers, kind="stable"))
    np.testing.assert_array_equal(numbers[order][run_starts(numbers[order])], np.unique(numbers))


def test_nothing_to_sort():
    assert len(order_of(np.zeros(0, int))) == len(run_starts(np.zeros(0, int))) == 0


@pytest.mark.parametrize("wide", [5, 2**30])
def test_equal_columns_have_equal_numbers(wide):
    columns = np.random.default_rng(0).integers(-wide, wide, (3, 200))
    columns[:, 100:] = columns[:, :100]
    numbers = row_numbers(columns)
    assert numbers.min() >= 0
    np.testing.assert_array_equal(numbers[:100], numbers[100:])
    np.testing.assert_array_equal(np.argsort(numbers[:100], kind="stable"), np.lexsort(columns[::-1, :100]))


def replace(path, text):
    path.with_suffix(".new").write_text(text)
    os.replace(path.with_suffix(".new"), path)


def test_a_file_is_read_once_and_again_when_replaced_or_changed(tmp_path):
    calls = []

    @cached_by_file(maxsize=2)
    def read(path, upper):
        calls.append(path)
        text = path.read_text()
        return text.upper() if upper else text

    path = tmp_path / "a.txt"
    replace(path, "one")
    assert [read(path, False), read(path, False), read(path, True)] == ["one", "one", "ONE"]
    assert len(calls) == 2
    replace(path, "two")
    assert read(path, False) == "two"
    path.write_text("three")
    assert read(path, False) == "three"
    read.cache_clear()
    path.unlink()
    with pytest.raises(FileNotFoundError):
        read(path, False)


@pytest.mark.parametrize(
    "read, below", [(previews.scene_of, ()), (network._checked, ("network",))], ids=["previews", "accuracy"]
)
def test_scene_of_a_run_folder_is_that_of_its_last_run(read, below, tmp_path, monkeypatch):
    monkeypatch.setattr(previews.Scene, "from_json", staticmethod(str))
    path = tmp_path.joinpath(*below, "scene.json")
    path.parent.mkdir(exist_ok=True)
    for text in ("first", "other"):
        replace(path, text)
        assert read(tmp_path) == text
