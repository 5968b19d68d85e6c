"""Positions and times that are wrong: each is refused or said at the scan, with file, line, value and remedy."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scan_worlds import exif_of, papers_rig, picture

from tiegraph.errors import InputError
from tiegraph.scan.scan import ScanInputs, build_scene, find_images, probe_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.exif import read_exif
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.images import Probe
from tiegraph.scene.scene import Scene
from tiegraph.scene.table import read_table
from tiegraph.scene.tuning import GnssTuning, ImageTuning

TUNING = Tuning()
HEAD = "time,lat,lon,height"
FRAMES = 8


class Survey:
    """A folder of images, opened once, scanned with any inputs."""

    def __init__(self, images: Path) -> None:
        self.images = images
        self.names = find_images(images)
        self.probes: Sequence[Probe] = [probe_image(images / n, ImageTuning()) for n in self.names]

    def scan(self, crs: str = "auto", settings: ScanSettings | None = None, **inputs: Path) -> Scene:
        settings = settings or ScanSettings(crs=crs)
        return build_scene(ScanInputs(self.images, **inputs), self.names, self.probes, settings, TUNING)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def one_pass(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    return Survey(papers_rig(tmp_path_factory.mktemp("one") / "in", ("up",), 2, FRAMES))


@pytest.fixture(scope="module")
def two_passes(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    return Survey(papers_rig(tmp_path_factory.mktemp("two") / "in", ("up", "down"), 2, 3))


def row(k: int, **other: object) -> str:
    """A row of the good GNSS file: 2 m a second, in Tokyo."""
    good: dict[str, object] = {"time": 100.0 + k, "lat": round(35.69 + 1e-5 * k, 8), "lon": 139.77, "height": 40.0}
    return ",".join(str(v) for v in {**good, **other}.values())


def table(*changed: tuple[int, dict], head: str = HEAD, more: str = "") -> str:
    rows = [row(k, **dict(changed).get(k, {})) + more for k in range(FRAMES)]
    return "\n".join([head, *rows]) + "\n"


def by_image(*lines: str, images: Sequence[str] = ()) -> str:
    rows = [f"{n},{35.69 + 1e-5 * k:.6f},139.77,40" for k, n in enumerate(images or ALL)]
    return "\n".join(["image,lat,lon,height", *rows, *lines]) + "\n"


ALL = [f"up/cam0/{k:06d}.jpg" for k in range(FRAMES)]
EVERY = {k: {} for k in range(FRAMES)}
RADIANS = tuple((k, {"lat": 0.6229 + 1e-7 * k, "lon": 2.4394}) for k in range(FRAMES))


def times_text(*lines: str, frames: int = FRAMES) -> str:
    return "\n".join(["pass,frame,time", *(f"up,{k:06d},{100 + k}" for k in range(frames)), *lines]) + "\n"


def scan_gnss(survey: Survey, folder: Path, text: str | bytes, crs: str = "auto") -> Scene:
    path = folder / "g.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    (folder / "t.csv").write_text(times_text())
    return survey.scan(crs, gnss=path, times=folder / "t.csv")


def scan_times(survey: Survey, folder: Path, text: str) -> Scene:
    (folder / "t.csv").write_text(text)
    return survey.scan(times=folder / "t.csv")


def says(scene: Scene, words: str) -> bool:
    return any(re.search(words, note) for note in scene.notes)


# --- GNSS ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, words",
    [
        (HEAD + "\n100,0,35,69,139,77,40,0\n", r"line 2: 8 cells below a header of 4 .*decimal commas"),
        (table() + "108,35.69,139.77,40,9\n", r"line 10: 5 cells below a header of 4"),
        (table(*RADIANS), r"line 2: lat 0.6229, lon 2.4394: .*radians do: write degrees"),
        (table(head="time,lat (rad),lon,height"), "column 'lat' is in radians: write degrees"),
        (table(*((k, {"height": 39558}) for k in EVERY)),
         r"none of 8 rows.*line 2, height '39558', not within -500 to 9000 m: in another unit"),
        (table(head=HEAD + ",sigma", more=",inf"), r"none of 8 rows.*line 2, accuracy 'inf'"),
        (table(head=HEAD + ",sigma", more=",1e300"), r"none of 8 rows.*line 2, accuracy '1e300'"),
        (table(*((k, {"lat": 3541.4, "lon": 13946.2}) for k in EVERY)), r"line 2, latitude '3541.4'.*NMEA"),
        (table(*((k, {"lat": 356914000, "lon": 1397700000}) for k in EVERY)), r"1e-7 degrees"),
        (table(*((k, {"lat": 139.77, "lon": 35.69}) for k in EVERY)), "lat and lon look exchanged"),
        (table(head=HEAD + ",lat", more=",1"), r"column 'lat' 2 times \(columns 2, 5\): leave the one"),
        (table() + "time,lon,lat,height\n110,139.77,35.69,40\n", "line 10: a second header with other columns"),
        (table(*((k, {"time": 103}) for k in EVERY)), r"line 3: all 8 rows have the time 103.00 s: give the time"),
        (table(*((k, {"time": 1e5 + 1e3 * k}) for k in EVERY)), r"do not overlap.*look like ms: .*time \(ms\)"),
        (HEAD + "\n", "no rows below its header"),
        (table().encode("utf-16-le"), "is no text"),
        (bytes(range(256)) * 20, "is no text"),
        (by_image(f"{ALL[2]},35.7,139.77,40"), r"line 10: image 'up/cam0/000002.jpg' has another place than in line 4"),
    ],
)  # fmt: skip
def test_gnss_files_that_cannot_be_meant(one_pass: Survey, tmp_path: Path, text: str | bytes, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        scan_gnss(one_pass, tmp_path, text)
    assert "g.csv" in str(error.value)


def test_short_names_that_several_passes_share(two_passes: Survey, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="several images are called so: write down/cam0/000000.jpg"):
        scan_gnss(two_passes, tmp_path, by_image(images=["000000.jpg", "000001.jpg"]))


@pytest.mark.parametrize(
    "text, words, known",
    [
        (table((3, {"height": 9000.5})), r"1 of 8 rows left out.*line 5, height '9000.5', not within -500 to 9", 8),
        (table((7, {"height": -9999})), r"1 of 8 rows left out.*line 9, height '-9999', not within -500 to", 7),
        (table((3, {"lat": 95})), r"line 5, latitude '95'; correct", 8),
        (table((7, {"lat": "nan"})), r"line 9, latitude 'nan'", 7),
        (table((7, {"time": "inf"})), r"line 9, time 'inf'", 7),
        (table((7, {"time": "1e308"})), r"line 9, time '1e308'", 7),
        (table((7, {"lat": 0, "lon": 0})), r"line 9, position 0, 0", 7),
        (table((7, {"height": "40,1e300"}), head=HEAD + ",sigma", more="").replace("40.0\n", "40.0,0.1\n"),
         r"line 9, accuracy '1e300'", 7),
        (table(head=HEAD + ",sigma", more=",-1"), r"line 2: 'sigma' '-1' is no standard deviation.*8 of 8", 8),
        (table(head=HEAD + ",sigma_h", more=",0"), r"line 2: 'sigma_h' '0' is no standard deviation", 8),
        (table(head=HEAD + ",sigma", more=",good"), r"'sigma' 'good' is no standard deviation", 8),
        (table(head=HEAD + ",heading", more=",1e9"), r"line 2: 'heading' '1e9' is no angle in degrees: not used", 8),
        (table((7, {"lat": 40.19})), r"line 9: lat 40.190000, lon 139.770000 lies 499 km from most.*1 of 8 pos", 7),
        (table((7, {"height": 9000})), r"line 9: lat 35.690070, lon 139.770000 lies 9 km", 7),
        (table(*((k, {"lat": 40.0}) for k in range(4))), r"lies 47\d km.*as 4 of 8 positions do: are these", 8),
        (table(*((k, {"lat": 35.69}) for k in EVERY)), r"all 8 positions are lat 35.690000, lon 139.770000", 8),
        (table(*((k, {"time": 107 - k}) for k in EVERY)), r"line 3: rows are not in time order", 8),
        (table() + row(3) + "\n", r"line 10: 1 rows have the time of another row and are left out, as at 103.00 s", 8),
        (table() + table(), r"line 10: the header again, left out", 8),
        (table() + "108,35.6", r"line 10: fewer cells than the header has columns \(4\), as in 1 of 9 rows", 8),
        (table(head="time,lat,lon,altitude,ellipsoidal_height", more=",80"),
         r"ellipsoidal_height; passed over, though it may count: altitude \(a height\)", 8),
        (table(*((k, {"time": 100e3 * k + 100}) for k in EVERY)), r"7 of 8 frames have no position.*look like ms", 1),
        ("# H\xf6he\n".encode("latin-1") + table().encode(), r"line 1: not UTF-8", 8),
        (by_image(f"{ALL[2]},35.690020,139.77,40"), r"line 10: image 'up/cam0/000002.jpg' stands there twice", 8),
        (by_image("up/cam1/000002.jpg,35.70,139.77,40"), r"line 10: up/cam1/000002.jpg lies 110\d.\d m from", 8),
        (by_image("x.jpg,35.7,139.77,40"), r"1 rows name images that are not here, such as x.jpg \(line 10\)", 8),
        (by_image(f"{ALL[7]},40.19,139.77,40", images=ALL[:7]), r"line 9: lat 40.19.* 499 km.*1 of 8 .*not used", 7),
        (by_image(*(f"{n},40.19,139.77,40" for n in ALL[5:]), images=ALL[:5]), r"3 of 8 positions do: are", 8),
    ],
)  # fmt: skip
def test_gnss_rows_that_are_said(one_pass: Survey, tmp_path: Path, text: str | bytes, words: str, known: int) -> None:
    scene = scan_gnss(one_pass, tmp_path, text)
    assert says(scene, words) and says(scene, "g.csv"), scene.notes
    positions = scene.world_from_rig[:, :3, 3]
    assert np.isfinite(positions[:, 0]).sum() == known


def test_what_is_left_out_is_not_in_the_way(one_pass: Survey, tmp_path: Path) -> None:
    """The others keep the places they have without the false row, also for georef, which reads the file itself."""
    clean = scan_gnss(one_pass, tmp_path, table())
    spoilt = scan_gnss(one_pass, tmp_path, table((7, {"lat": 40.19})))
    assert np.allclose(spoilt.world_from_rig[:7, :3, 3], clean.world_from_rig[:7, :3, 3], atol=1e-6)
    assert len(read_gnss(tmp_path / "g.csv", GnssTuning()).time_s) == 7


@pytest.mark.parametrize(
    "text",
    [
        table(),
        b"\xef\xbb\xbf" + table().encode(),
        table().encode("utf-16"),
        table().replace("\n", "\r\n"),
        table().replace("\n", "\r"),
        table().replace(",", ";"),
        table().replace(",", "\t"),
        table(*((k, {"time": f"{100 + k}.0"}) for k in EVERY)).replace(",", ";").replace(".", ",").encode("utf-16"),
        table(head="Time (s) Latitude [deg] Longitude [deg] Height (m)").replace(",", " "),
        table(*((k, {"time": 1000 * (100 + k)}) for k in EVERY), head="time (ms),lat,lon,height"),
        table(*((k, {"time": f'"{100 + k}"'}) for k in EVERY)),
        by_image(),
        by_image(images=[n.replace("/", "\\") for n in ALL]),
        by_image(images=[n.upper() for n in ALL]),
        "%  UTC           latitude(deg) longitude(deg)  height(m)\n"
        + "".join(f"1970/01/01 00:01:{40 + k}.000  {35.69 + 1e-5 * k:.8f}  139.77  40.0\n" for k in EVERY),
    ],
)  # fmt: skip
def test_good_files_of_many_kinds_say_nothing_but_the_accuracy(
    one_pass: Survey, tmp_path: Path, text: str | bytes
) -> None:
    scene = scan_gnss(one_pass, tmp_path, text)
    said = [n for n in scene.notes if "g.csv" in n and "columns read: " not in n]
    assert said == ["g.csv: accuracy not given; 5 m horizontal and 10 m vertical assumed"]
    north = scene.world_from_rig[:, 1, 3]
    assert np.diff(north) == pytest.approx(1.109, abs=0.01)


def test_a_comma_between_quotes_parts_no_columns(tmp_path: Path) -> None:
    (tmp_path / "g.csv").write_text('note,time,lat,lon,height\n"a, b",1,35,139,40\n"c",2,35,139,40\n')
    assert read_gnss(tmp_path / "g.csv", GnssTuning()).time_s.tolist() == [1, 2]


@pytest.mark.parametrize("what", ["folder", "pipe", "device", "absent"])
def test_tables_that_are_no_files(tmp_path: Path, what: str) -> None:
    import os

    path = {"folder": tmp_path, "pipe": tmp_path / "p", "device": Path("/dev/zero"), "absent": tmp_path / "no"}[what]
    if what == "pipe":
        os.mkfifo(path)
    with pytest.raises(InputError, match="is a folder|is no plain file|cannot be read") as error:
        read_table(path, "GNSS file", "time,lat,lon,height")
    assert str(path) in str(error.value) and "give the GNSS file" in str(error.value)


# --- CRS -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "crs, words",
    [
        ("EPSG:27700", r"EPSG:27700 \(.*\): lengths in it are 1.15.*35.690.*choose EPSG:32654"),
        ("EPSG:32632", r"1.268. times the true ones.*choose EPSG:32654"),
        ("EPSG:3857", r"1.23.. times the true ones.*choose EPSG:32654"),
        ("EPSG:4326", "not projected"),
        ("foo", "unknown CRS 'foo'"),
    ],
)
def test_a_crs_of_another_place_is_refused(one_pass: Survey, tmp_path: Path, crs: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        scan_gnss(one_pass, tmp_path, table(), crs)


def test_a_crs_that_is_only_near_is_said(one_pass: Survey, tmp_path: Path) -> None:
    scene = scan_gnss(one_pass, tmp_path, table(), "EPSG:32653")
    assert says(scene, r"EPSG:32653 .*: 8 of 8 positions lie outside its area of use.*EPSG:32654 would fit")
    assert not says(scan_gnss(one_pass, tmp_path, table(), "EPSG:6677"), "area of use")


def test_a_crs_without_positions_is_said_and_checked(one_pass: Survey) -> None:
    assert says(one_pass.scan("EPSG:6677"), r"--scan.crs EPSG:6677: nothing here has positions.*--gcp")
    assert not says(one_pass.scan(), "scan.crs")
    with pytest.raises(InputError, match="unknown CRS 'EPSG:1'"):
        one_pass.scan("EPSG:1")


# --- times ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, words",
    [
        (times_text().replace("up", "down"), r"line 2: none of its 8 rows.*\(down/0\).*the passes here are up"),
        (times_text("up,3,500"), r"line 10: up/3 has the time 500 s, but 103 s in line 5: leave the right one"),
        (times_text("up,8,nan"), r"line 10: 'nan' is no time"),
        (times_text("up,8,inf"), r"line 10: 'inf' is no time"),
        (times_text("up,8,1e308"), r"line 10: '1e308' is no time.*leave out rows without"),
        (times_text("up,8,1,5"), r"line 10: 4 cells below a header of 3"),
        (re.sub(r",\d+\n", ",7\n", times_text()), r"line 2: all 8 frames have the time 7 s: write the time of each"),
        ("image,time\nup/cam0/000001.jpg,1\nup/cam0/000001.jpg,2\n", r"line 3: up/cam0/000001.jpg has the time 2 s"),
        ("frame,time,time\n1,1,2\n", "the column 'time' 2 times"),
    ],
)  # fmt: skip
def test_times_that_cannot_be_meant(one_pass: Survey, tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        scan_times(one_pass, tmp_path, text)
    assert "t.csv" in str(error.value)


@pytest.mark.parametrize(
    "text, words",
    [
        (times_text("down,000001,5"), r"line 10: 1 of 9 rows name frames or images that are not here, such as down/1"),
        (times_text("up,99,500"), r"line 10: 1 of 9 rows .* such as up/99"),
        (times_text("up,3,103"), r"line 10: up/3 stands there twice, with one time"),
        (times_text("up,000007,106", frames=7), r"line 8, 9: two frames of one pass have the time 106 s"),
        (times_text("up,000007,107000", frames=7), r"line 9: time 107000 s is far from the 103.5 s of its pass"),
        ("image,time\nup/cam0/000001.jpg,1\nup/cam1/000001.jpg,31\nup/cam0/000002.jpg,40\n",
         r"line 2, 3: images of one frame are 30.00 s apart"),
    ],
)  # fmt: skip
def test_times_that_are_said(one_pass: Survey, tmp_path: Path, text: str, words: str) -> None:
    scene = scan_times(one_pass, tmp_path, text)
    assert says(scene, words) and np.isfinite(scene.time_s).any(), scene.notes


def test_good_times_say_nothing(one_pass: Survey, two_passes: Survey, tmp_path: Path) -> None:
    for text in (times_text(), times_text().replace("up,", ",")):
        scene = scan_times(one_pass, tmp_path, text)
        assert scene.time_s.tolist() == [100.0 + k for k in range(FRAMES)]
        assert [n for n in scene.notes if "t.csv" in n] == ["t.csv: columns read: pass, frame, time"]
    both = "pass,frame,time\n" + "".join(
        f"{p},{k},{t + k}\n" for p, t in (("up", 0), ("down", 90000)) for k in range(3)
    )
    assert not says(scan_times(two_passes, tmp_path, both), "t.csv(?!: columns read)")
    scene = scan_times(two_passes, tmp_path, both + "sideways,0,1\n")
    assert says(scene, r"line 8: 1 of 7 rows .* such as sideways/0")


def test_a_pass_whose_folders_have_no_name(one_pass: Survey, tmp_path: Path) -> None:
    scene = scan_times(Survey(one_pass.images / "up"), tmp_path, times_text())
    assert scene.sequences == ("all",) and says(scene, "line 2: pass 'up' is taken for the only one here")
    with pytest.raises(InputError, match="the passes here are all"):
        scan_times(Survey(one_pass.images / "up"), tmp_path, times_text("down,0,500"))


@pytest.mark.parametrize(
    "names, exif, words",
    [
        ("{k}.jpg", {"time": "2024:01:01 10:00:00"}, "EXIF: all 3 frames.* the same, 2024-01-01 10:00:00: not used"),
        ("20240101_100000_{k}.jpg", {}, "file names: all 3 frames.* the same, 2024-01-01 10:00:00: not used"),
    ],
)
def test_one_time_for_all_photographs_is_not_used(tmp_path: Path, names: str, exif: dict, words: str) -> None:
    for k in range(3):
        picture(tmp_path / names.format(k=k), exif=exif_of(**exif))
    scene = Survey(tmp_path).scan()
    assert says(scene, words) and np.isnan(scene.time_s).all()


# --- EXIF ----------------------------------------------------------------------------------------------------------


def photographs(folder: Path, count: int = 6, **of_last: float) -> Scene:
    for k in range(count):
        place = {"lat": 35.69 + 1e-4 * k, "lon": 139.77, "alt": 40.0, **(of_last if k == count - 1 else {})}
        picture(folder / f"IMG_{k}.jpg", exif=exif_of(**place))
    return Survey(folder).scan()


@pytest.mark.parametrize(
    "of_last, words, known",
    [
        ({"lat": 91.0}, r"EXIF of IMG_5.jpg: latitude 91, longitude 139.77 is no place.*not used, as in 1 of 6", 5),
        ({"lat": 0.0, "lon": 0.0}, r"IMG_5.jpg: latitude 0, longitude 0 is what a receiver without a fix writes", 5),
        (
            {"alt": 39558.0},
            r"EXIF of IMG_5.jpg: height 39558 m, not within -500 to 9000 m.*; 1 positions are",
            6,
        ),
        ({"lat": 40.19}, r"IMG_5.jpg: lat 40.190000, lon 139.770000 lies 499 km .*1 of 6 positions are not used", 5),
    ],
)
def test_exif_positions_that_are_said(tmp_path: Path, of_last: dict, words: str, known: int) -> None:
    scene = photographs(tmp_path, **of_last)
    assert says(scene, words), scene.notes
    places = scene.world_from_rig[:, :3, 3]
    assert np.isfinite(places[:, 0]).sum() == known and np.nanmax(np.abs(np.ptp(places[:5], axis=0))) < 60


def test_heights_of_an_aircraft_that_says_so(tmp_path: Path) -> None:
    (tmp_path / "g.csv").write_text("time,lat,lon,height\n0,35.69,139.77,11000\n1,35.691,139.77,-600\n")
    with pytest.raises(InputError, match="none of 2 rows"):
        read_gnss(tmp_path / "g.csv", GnssTuning())
    assert len(read_gnss(tmp_path / "g.csv", GnssTuning(), (-500.0, 12000.0)).time_s) == 1
    for k in range(3):
        picture(tmp_path / "in" / f"IMG_{k}.jpg", exif=exif_of(lat=35.69 + 1e-4 * k, lon=139.77, alt=11000.0))
    for settings, sigma in ((ScanSettings(), 100.0), (ScanSettings(heights_m=(-500.0, 12000.0)), 10.0)):
        scene = Survey(tmp_path / "in").scan(settings=settings)
        assert np.all(scene.position_sigma_m[:, 2] == sigma)
        assert abs(scene.origin.height_m - (0 if sigma == 100 else 11000)) < 1


def test_no_exif_position_in_range(tmp_path: Path) -> None:
    for k in range(4):
        picture(tmp_path / f"{k}.jpg", exif=exif_of(lat=91.0, lon=139.77))
    scene = Survey(tmp_path).scan()
    assert says(scene, "latitude 91, .*as in 4 of 4 images; mend it in the files") and scene.prior == "none"


def test_one_exif_position_and_the_same_for_all(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / "same" / f"{k}.jpg", exif=exif_of(lat=35.69, lon=139.77, alt=40.0))
        picture(tmp_path / "one" / f"{k}.jpg", exif=exif_of(lat=35.69, lon=139.77) if k == 1 else Image.Exif())
    same = Survey(tmp_path / "same").scan()
    assert says(same, "EXIF: all 3 positions are lat 35.69.*Not used") and same.prior == "none"
    assert says(Survey(tmp_path / "one").scan(), "1 of 3 frames has a position.*not used")


def test_exif_without_hemisphere_and_of_no_accuracy(tmp_path: Path) -> None:
    exif = exif_of(lat=-35.69, lon=139.77, alt=40.0)
    del exif.get_ifd(0x8825)[1]
    found = read_exif(Image.open(picture(tmp_path / "a.jpg", exif=exif)), (64, 48), ImageTuning().focal_range)
    assert found.lat_deg > 0 and "north or south" in found.doubt
    exif = exif_of(lat=35.69, lon=139.77, alt=40.0)
    exif.get_ifd(0x8825)[31] = 1e7
    found = read_exif(Image.open(picture(tmp_path / "b.jpg", exif=exif)), (64, 48), ImageTuning().focal_range)
    assert np.isnan(found.lat_deg) and "accuracy of 1e+07 m is none" in found.doubt


def test_two_photographs_far_apart_are_said_and_used(tmp_path: Path) -> None:
    scene = photographs(tmp_path, 2, lat=40.19)
    assert says(scene, "499 km.*as 1 of 2 positions do") and np.isfinite(scene.world_from_rig[:, 0, 3]).all()
