"""Rigs in good form that make no sense: each is refused with file, line, key and value, or said."""

from __future__ import annotations

import json
from pathlib import Path

import pycolmap
import pytest
from scan_worlds import papers_rig, picture, scan
from test_scan_rigfile import FREE, LEFT, REF, TOML, colmap, toml

from tiegraph.errors import InputError
from tiegraph.scan.rigfiles.rigfaults import lens_fault
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import preset_sizes
from tiegraph.scan.tuning import RigTuning

RIG = RigTuning()
PAIR = '[[pairs]]\nsensors = ["cam0", "cam1"]\n'
ANTENNA, PLACE, TURN = "antenna_m = [0.9, 0.6, 0.3]", "position_m = [0, -0.06, 0]", "yaw_pitch_roll_deg = [90, 0, 0]"
NAN_MATRIX = "body_from_sensor = [[1, 0, 0, nan], [0, 1, 0, 0], [0, 0, 1, 0]]"
BOTTOM = "body_from_sensor = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]]"
HUGE = "1" + "0" * 400  # no float holds it


@pytest.mark.parametrize(
    "wrong, right, message",
    [
        ("position_m = [0, 10000, 0]", PLACE, "line 13: sensor 'cam1' is 10000 m from 'cam0', more than 100 m"),
        ("position_m = [0, 1e308, 0]", PLACE, "line 13: sensor 'cam1' is .* more than 100 m"),
        (f"position_m = [0, {HUGE}, 0]", PLACE, "line 13: position_m = .* finite"),
        ("antenna_m = [900, 600, 300]", ANTENNA, r"line 4: antenna_m: 1122\.\d* m from the nearest camera"),
        ("yaw_pitch_roll_deg = [9e9, 0, 0]", TURN, "line 14: yaw_pitch_roll_deg = .* degrees"),
        ("body_from_sensor_wxyz = [0, 0, 0, 0]", TURN, "line 14: .* length 0, not 1"),
        (NAN_MATRIX, f"{PLACE}\n{TURN}", "line 13: body_from_sensor: .* finite"),
        (BOTTOM, f"{PLACE}\n{TURN}", "line 13: body_from_sensor: the fourth row"),
        (f"{TURN}\nsigma_m = 1e300", TURN, "line 15: sigma_m = 1e.300: 100 at most"),
        (f"{TURN}\nsigma_deg = inf", TURN, "line 15: sigma_deg = inf: expected a finite number"),
        ("focal_px = 0", "hfov_deg = 90", "line 6: focal_px = 0: expected a number above 0"),
        (f"focal_px = {HUGE}", "hfov_deg = 90", "line 6: focal_px = 1000.*above 0"),
        ("hfov_deg = nan", "hfov_deg = 90", "line 6: hfov_deg = nan"),
        ("size = [96.5, 64]\nhfov_deg = 90", "hfov_deg = 90", "line 6: size = .* whole pixels"),
        ("size = [1e9, 1e9]\nhfov_deg = 90", "hfov_deg = 90", "line 6: size = .* whole pixels"),
        ('model = "EQUIRECTANGULAR"', "hfov_deg = 90", "line 6: unknown camera model 'EQUIRECTANGULAR'"),
    ],
)  # fmt: skip
def test_what_no_sensor_can_be(tmp_path: Path, wrong: str, right: str, message: str) -> None:
    assert right in TOML
    path = toml(tmp_path, TOML.replace(right, wrong, 1))
    with pytest.raises(InputError, match=message) as error:
        read_rig_file(path, RIG)
    assert str(path) in str(error.value) and len(str(error.value)) < 1000


@pytest.mark.parametrize(
    "text, message",
    [
        (PAIR + "baseline_m = 0.1\nbaseline_sigma_m = 0\n", "line 23: baseline_sigma_m = 0: expected 1e-06 to 100"),
        (PAIR + "baseline_m = 0.1\nbaseline_sigma_m = -1\n", "line 23: baseline_sigma_m = -1: .*finite number, 0"),
        (PAIR + "baseline_m = 0.1\nbaseline_sigma_m = inf\n", "line 23: baseline_sigma_m = inf: .*finite number"),
        (PAIR + "baseline_m = 1e4\nbaseline_sigma_m = 1\n", "line 22: baseline_m = 10000: expected 0 to 100"),
        (PAIR + "axis_deg = 190\naxis_sigma_deg = 1\n", "line 22: axis_deg = 190: expected 0 to 180"),
        (PAIR + "axis_deg = 90\naxis_sigma_deg = 0\n", "line 23: axis_sigma_deg = 0: expected"),
        (PAIR, "line 21: the pair says nothing"),
        (2 * (PAIR + "axis_deg = 90\naxis_sigma_deg = 1\n"), "line 25: pair cam0 - cam1 is given twice"),
        ('[[pairs]]\nsensors = [["cam0"], "cam1"]\n', r"line 21: sensors = \[\['cam0'\], 'cam1'\]: expected two of"),
    ],
)
def test_what_no_pair_can_be(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_rig_file(toml(tmp_path, TOML + text), RIG)


def test_a_pair_against_the_positions_is_said(tmp_path: Path) -> None:
    pair = PAIR + "baseline_m = 0.5\nbaseline_sigma_m = 0.001\naxis_deg = 90\naxis_sigma_deg = 0.1\n"
    notes = scan(papers_rig(tmp_path / "in", frames=1), rig=str(toml(tmp_path, TOML + pair))).notes
    said = [n for n in notes if "pair cam0 - cam1" in n]
    assert len(said) == 1 and "0.5 m apart" in said[0] and "0.08485" in said[0] and "rig.toml" in said[0]
    nominal = TOML.replace('axes = "flu"', 'axes = "flu"\nnominal = true')
    notes = scan(papers_rig(tmp_path / "in", frames=1), rig=str(toml(tmp_path, nominal + pair))).notes
    assert not [n for n in notes if "pair cam0" in n]


@pytest.mark.parametrize(
    "model, params, message",
    [
        ("OPENCV", [500, 500, 400, 300, 1e9, 0, 0, 0], "without distortion"),
        ("OPENCV", [500, 500, 400, 300, -1e9, 0, 0, 0], "folds or tears"),
        ("OPENCV", [500, 500, 400, 300, 0, 0, 1e9, 0], "folds or tears"),
        ("RADIAL", [500, 400, 300, -0.6, 0], "folds or tears"),
        ("RADIAL", [500, 400, 300, 1e300, 0], "folds or tears"),
        ("FOV", [500, 500, 400, 300, 1e9], "folds or tears"),
        ("OPENCV_FISHEYE", [250, 250, 400, 300, -0.9, 0, 0, 0], "folds or tears"),
        ("OPENCV_FISHEYE", [250, 250, 400, 300, 1e9, 0, 0, 0], "without distortion"),
        ("PINHOLE", [0, 500, 400, 300], "focal length is 0 px"),
        ("PINHOLE", [-500, -500, 400, 300], "focal length is -500 px"),
        ("PINHOLE", [500, 5, 400, 300], "differ too much"),
        ("PINHOLE", [8.8, 8.8, 400, 300], "degrees across 800 px, not 1 to 170: is it in millimetres"),
        ("SIMPLE_PINHOLE", [1e6, 400, 300], "degrees across 800 px"),
        ("SIMPLE_PINHOLE", [500, 4000, 300], r"principal point \(4000, 300\)"),
        ("SIMPLE_PINHOLE", [500, 400, 300], ""),
        ("SIMPLE_PINHOLE", [500, 0.5, 0.5], r"principal point \(0.5, 0.5\) is in a corner"),  # shares of the sides
        ("SIMPLE_PINHOLE", [500, 12.5, 8.0], r"principal point \(12.5, 8\) is in a corner"),  # from the middle
        ("SIMPLE_PINHOLE", [500, 40, 300], ""),  # of a cropped image
        ("OPENCV", [500, 500, 400, 300, -0.28, 0.07, 1e-4, 1e-4], ""),
        ("RADIAL", [500, 400, 300, 0.5, 0.0], ""),
        ("OPENCV_FISHEYE", [129.1, 129.2, 400, 300, 0.038, -0.008, 0.0083, -0.0027], ""),
    ],
)
def test_lenses(tmp_path: Path, model: str, params: list[float], message: str) -> None:
    fault = lens_fault(pycolmap.Camera(model=model, width=800, height=600, params=params), RIG.camera)
    assert (message in fault) if message and "(" not in message else bool(fault) == bool(message)
    text = f'[camera]\nmodel = "{model}"\nsize = [800, 600]\nparams = {params}\n[[sensors]]\nname = "a"\n'
    if message:
        with pytest.raises(InputError, match=message) as error:
            read_rig_file(toml(tmp_path, text), RIG)
        assert "rig.toml, line 4" in str(error.value)
    else:
        read_rig_file(toml(tmp_path, text), RIG)


def test_a_lens_whose_image_size_only_the_images_tell(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / "in" / f"{k}.jpg", (96, 64))
    text = "[camera]\nmodel = 'RADIAL'\nparams = [80, 48, 32, {}, 0]\n[[sensors]]\nname = 'c'\n"
    with pytest.raises(InputError, match=r"rig.toml, line 3: sensor 'c': RADIAL .* folds"):
        scan(tmp_path / "in", rig=str(toml(tmp_path, text.format(-1))))
    with pytest.raises(InputError, match=r"rig.toml, line 2: sensor 'c': a focal length of 0.05 px"):
        scan(tmp_path / "in", rig=str(toml(tmp_path, "[camera]\nfocal_px = 0.05\n[[sensors]]\nname = 'c'\n")))
    with pytest.raises(InputError, match=r"rig.toml, line 2: sensor 'c': hfov_deg = 175: a SIMPLE_RADIAL image"):
        scan(tmp_path / "in", rig=str(toml(tmp_path, "[camera]\nhfov_deg = 175\n[[sensors]]\nname = 'c'\n")))


FAR = {**LEFT, "cam_from_rig_translation": [0, 0, 1e4]}
SECOND = {"image_prefix": "cam9/", "ref_sensor": True}


@pytest.mark.parametrize(
    "cameras, message",
    [
        ([REF, FAR], "line 10: sensor 'cam1' is 10000 m from 'cam0'"),
        ([{**LEFT, "cam_from_rig_translation": [0, 0, float("nan")]}, REF], "line 11: cam_from_rig_translation"),
        ([REF, {**LEFT, "cam_from_rig_rotation": [0, 0, 0, 0]}], "line 10: .*length 0, not 1"),
        ([REF, {**FREE, "camera_params": [float("inf"), 50, 32, 24]}], "line 11: camera_params"),
    ],
)
def test_what_no_rig_config_can_be(tmp_path: Path, cameras: list[dict], message: str) -> None:
    with pytest.raises(InputError, match=message.split(":", 1)[1].strip()):
        read_rig_file(Path(colmap(tmp_path, *cameras)), RIG)


def test_the_line_of_a_second_rig(tmp_path: Path) -> None:
    path = tmp_path / "rig_config.json"
    path.write_text(
        json.dumps([{"cameras": [REF, LEFT]}, {"cameras": [SECOND, {**FAR, "image_prefix": "cam8/"}]}], indent=1)
    )
    line = 1 + [k for k, text in enumerate(path.read_text().splitlines()) if "translation" in text][1]
    with pytest.raises(InputError, match=f"line {line}: sensor 'cam8' is 10000 m"):
        read_rig_file(path, RIG)


@pytest.mark.parametrize("text", ["ring:nan", "ring:inf", "stereo:nan", "stereo:1e9", "stereo:-1", "ring:2.5"])
def test_presets_with_numbers_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match=text):
        preset_sizes(text, RIG)


@pytest.mark.parametrize(
    "data, message",
    [
        (b"\xff\xfe[\0", "UTF-8"),
        (b"\x00\x01\x02", "not a valid TOML"),
        (b"[[" * 5000, "TOML"),
        (b"a = " + b"[" * 99999, "brackets"),
    ],
)
def test_no_text_at_all(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "rig.toml").write_bytes(data)
    with pytest.raises(InputError, match=message):
        read_rig_file(tmp_path / "rig.toml", RIG)
    with pytest.raises(InputError, match="a folder, not a file"):
        read_rig_file(tmp_path, RIG)
