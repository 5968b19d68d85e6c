"""Calibrations of cameras and rigs: what is read projects points as the program's own formulas do, or is refused.

The formulas are written out here as the programs document them, in their own pixels."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from scan_worlds import exif_of, papers_rig, picture, scan

from said import refused, says
from tiegraph.cli.main import main
from tiegraph.geometry.transforms import centre, rigid
from tiegraph.scan.cameras import read_camera
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scan.tuning import RigTuning

RIG = RigTuning()
SIZE = (4000, 3000)
X, Y = (g.ravel() for g in np.meshgrid(np.linspace(-0.45, 0.45, 7), np.linspace(-0.35, 0.35, 5)))  # x/z, y/z
MILLI_PX = 1e-3
Points = tuple[np.ndarray, np.ndarray]


def _brown(x: np.ndarray, y: np.ndarray, k: tuple[float, ...], p: tuple[float, float], below: tuple = ()) -> Points:
    """Radial and tangential distortion as OpenCV writes them."""
    r2 = x * x + y * y
    radial = 1 + sum(c * r2 ** (n + 1) for n, c in enumerate(k))
    radial = radial / (1 + sum(c * r2 ** (n + 1) for n, c in enumerate(below)))
    p1, p2 = p
    dx, dy = 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return x * radial + dx, y * radial + dy


def _theta(x: np.ndarray, y: np.ndarray) -> Points:
    r = np.hypot(x, y)
    turn = np.where(r > 0, np.arctan(r) / np.maximum(r, 1e-300), 1.0)
    return x * turn, y * turn


def _pinhole(points: Points, fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    return np.stack([fx * points[0] + cx, fy * points[1] + cy], axis=1)


def _opencv(kind: str, k: list[float]) -> tuple[str, np.ndarray]:
    rows = {"rows": 3, "cols": 3, "data": [2900.0, 0, 2010.0, 0, 2910.0, 1490.0, 0, 0, 1]}
    text = f"image_width: 4000\nimage_height: 3000\ncamera_matrix: {json.dumps(rows)}\n"
    text += f"distortion_model: {kind}\ndistortion_coefficients: {json.dumps({'rows': 1, 'cols': len(k), 'data': k})}\n"
    if kind == "equidistant":
        x, y = _theta(X, Y)
        points = _brown(x, y, tuple(k), (0, 0))
    else:
        full = [*k, *[0.0] * (8 - len(k))]
        points = _brown(X, Y, (full[0], full[1], full[4]), (full[2], full[3]), tuple(full[5:]))
    return text, _pinhole(points, 2900.0, 2910.0, 2010.0, 1490.0) + 0.5  # OpenCV's first pixel is at 0, 0


def _ros_message() -> tuple[str, np.ndarray]:
    _, pixels = _opencv("plumb_bob", [0.1, -0.05, 0.001, -0.002, 0.01])
    k = "[2900.0, 0.0, 2010.0, 0.0, 2910.0, 1490.0, 0.0, 0.0, 1.0]"
    head = "height: 3000\nwidth: 4000\ndistortion_model: plumb_bob\n"
    return f"{head}d:\n- 0.1\n- -0.05\n- 0.001\n- -0.002\n- 0.01\nk: {k}\nbinning_x: 0\nroi:\n  x_offset: 0\n", pixels


def _opencv_xml() -> tuple[str, np.ndarray]:
    k = [0.05, -0.01, 0.002, -0.001]
    points = _brown(*_theta(X, Y), tuple(k), (0, 0))
    data = "2900. 0. 2010. 0. 2910. 1490. 0. 0. 1."
    text = f"""<?xml version="1.0"?>
<opencv_storage><image_width>4000</image_width><image_height>3000</image_height><fisheye_model>1</fisheye_model>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>{data}</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>4</rows><cols>1</cols><dt>d</dt>
<data>{" ".join(map(str, k))}</data></distortion_coefficients></opencv_storage>"""
    return text, _pinhole(points, 2900.0, 2910.0, 2010.0, 1490.0) + 0.5


def _kalibr(camera: str, distortion: str, given: list[float], k: list[float], points: Points) -> tuple[str, np.ndarray]:
    text = f"cam0:\n  camera_model: {camera}\n  distortion_model: {distortion}\n  distortion_coeffs: {k}\n"
    text += f"  intrinsics: {given}\n  resolution: [4000, 3000]\n"
    return text, _pinhole(points, *given[-4:]) + 0.5  # type: ignore[call-arg]


def _fov() -> tuple[str, np.ndarray]:
    w = 0.9
    r = np.hypot(X, Y)
    factor = np.where(r > 0, np.arctan(2 * r * np.tan(w / 2)) / (np.maximum(r, 1e-300) * w), 2 * np.tan(w / 2) / w)
    return _kalibr("pinhole", "fov", [1900.0, 1910, 2000, 1500], [w], (X * factor, Y * factor))


def _eucm() -> tuple[str, np.ndarray]:
    alpha, beta = 0.6, 1.1
    depth = alpha * np.sqrt(beta * (X * X + Y * Y) + 1) + 1 - alpha
    return _kalibr("eucm", "none", [alpha, beta, 1900.0, 1910, 2000, 1500], [], (X / depth, Y / depth))


def _omni() -> tuple[str, np.ndarray]:
    xi = 1.3
    depth = 1 + xi * np.sqrt(X * X + Y * Y + 1)
    return _kalibr("omni", "radtan", [xi, 4200.0, 4210, 2000, 1500], [0.0, 0.0, 0.0, 0.0], (X / depth, Y / depth))


def _opensfm(kind: str, points: Points, **values: float) -> tuple[str, np.ndarray]:
    row = {"projection_type": kind, "width": 4000, "height": 3000, **values}
    fx, fy = values.get("focal", values.get("focal_x", 0)), values.get("focal", values.get("focal_y", 0))
    norm = np.stack([fx * points[0] + values.get("c_x", 0), fy * points[1] + values.get("c_y", 0)], axis=1)
    pixels = norm * 4000 - 0.5 + np.array(SIZE) / 2  # denormalized_image_coordinates: the first pixel is at 0, 0
    return json.dumps({"v2 dji": row}), pixels + 0.5


def _agisoft(kind: str, points: Points, b1: float = 0.0, **k: float) -> tuple[str, np.ndarray]:
    values = {"f": 2900.0, "cx": 12.5, "cy": -7.25, "b1": b1, **k}
    rows = "".join(f"<{n}>{v!r}</{n}>" for n, v in values.items())
    text = f'<?xml version="1.0"?><calibration><projection>{kind}</projection><width>4000</width><height>3000</height>'
    u = 4000 * 0.5 + 12.5 + points[0] * 2900.0 + points[0] * b1
    v = 3000 * 0.5 - 7.25 + points[1] * 2900.0
    return f"{text}{rows}<date>2023-04-05T06:07:08Z</date></calibration>", np.stack([u, v], axis=1)


def _sensor_file() -> tuple[str, np.ndarray]:
    """A camera file of Metashape: the initial calibration and the adjusted one."""
    _, pixels = _agisoft("frame", (X, Y))
    old = '<calibration type="frame" class="initial"><resolution width="4000" height="3000"/><f>2000</f></calibration>'
    new = old.replace("initial", "adjusted").replace("<f>2000</f>", "<f>2900</f><cx>12.5</cx><cy>-7.25</cy>")
    head = '<document version="1.5.0"><chunk><sensors><sensor id="0" label="X"><resolution width="4000" height="3000"/>'
    return f"{head}{old}{new}</sensor></sensors></chunk></document>", pixels


K3, P = (0.1, -0.05, 0.01), (0.002, -0.001)
K3P = {"k1": K3[0], "k2": K3[1], "k3": K3[2], "p1": P[0], "p2": P[1]}
K4 = {"k1": 0.05, "k2": -0.01, "k3": 0.002, "k4": -0.001}
T4 = _brown(*_theta(X, Y), (0.05, -0.01, 0.002, -0.001), (0, 0))
FORMS: dict[str, tuple[Callable[[], tuple[str, np.ndarray]], str]] = {
    "plumb_bob": (lambda: _opencv("plumb_bob", [0.1, -0.05, 0.001, -0.002, 0.01]), "FULL_OPENCV"),
    "rational": (
        lambda: _opencv("rational_polynomial", [0.1, -0.05, 0.001, 0, 0.01, 0.05, 0.01, 0.001]), "FULL_OPENCV"
    ),
    "equidistant": (lambda: _opencv("equidistant", [0.05, -0.01, 0.002, -0.001]), "OPENCV_FISHEYE"),
    "ros2 message": (_ros_message, "FULL_OPENCV"),
    "opencv xml": (_opencv_xml, "OPENCV_FISHEYE"),
    "kalibr fov": (_fov, "FOV"),
    "kalibr eucm": (_eucm, "EUCM"),
    "kalibr omni": (_omni, "EUCM"),
    "perspective": (
        lambda: _opensfm("perspective", _brown(X, Y, K3[:2], (0, 0)), focal=0.7, k1=K3[0], k2=K3[1]), "RADIAL"
    ),
    "brown": (
        lambda: _opensfm(
            "brown", _brown(X, Y, K3, P), focal_x=0.7, focal_y=0.71, c_x=0.01, c_y=-0.02, k1=K3[0], k2=K3[1], k3=K3[2],
            p1=P[0], p2=P[1],
        ), "FULL_OPENCV",
    ),
    "simple_radial": (
        lambda: _opensfm("simple_radial", _brown(X, Y, (0.1,), (0, 0)), focal_x=0.7, focal_y=0.71, c_x=0.01, k1=0.1),
        "OPENCV",
    ),
    "fisheye": (
        lambda: _opensfm("fisheye", _brown(*_theta(X, Y), K3[:2], (0, 0)), focal=0.7, k1=K3[0], k2=K3[1]),
        "RADIAL_FISHEYE",
    ),
    "fisheye_opencv": (
        lambda: _opensfm("fisheye_opencv", T4, focal_x=0.7, focal_y=0.71, c_x=0.01, **K4),
        "OPENCV_FISHEYE",
    ),
    "fisheye62": (
        lambda: _opensfm(
            "fisheye62", _brown(*_theta(X, Y), (*K3, 0.001), P), focal_x=0.7, focal_y=0.7, k1=K3[0], k2=K3[1], k3=K3[2],
            k4=0.001, p1=P[0], p2=P[1],
        ), "THIN_PRISM_FISHEYE",
    ),
    "agisoft frame": (  # its p1 stands where OpenCV's p2 does
        lambda: _agisoft("frame", _brown(X, Y, K3, (P[1], P[0])), 8.0, k1=K3[0], k2=K3[1], k3=K3[2], p1=P[0], p2=P[1]),
        "FULL_OPENCV",
    ),
    "agisoft fisheye": (
        lambda: _agisoft("fisheye", T4, **K4), "OPENCV_FISHEYE"
    ),
    "agisoft fisheye p": (
        lambda: _agisoft("fisheye", _brown(*_theta(X, Y), K3, (P[1], P[0])), **K3P),
        "THIN_PRISM_FISHEYE",
    ),
    "metashape sensor": (_sensor_file, "OPENCV"),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_points_are_projected_as_the_program_does(tmp_path: Path, form: str) -> None:
    make, model = FORMS[form]
    text, pixels = make()
    path = tmp_path / "calibration.dat"  # what stands in it tells, not its name
    path.write_text(text)
    found = read_camera(str(path))
    assert found.model == model and found.size == SIZE and found.params is not None
    camera = pycolmap.Camera(model=found.model, width=SIZE[0], height=SIZE[1], params=list(found.params))
    mine = np.array([camera.img_from_cam(np.array([x, y, 1.0])) for x, y in zip(X, Y)]).reshape(-1, 2)
    assert np.ptp(pixels, axis=0).min() > 1000  # the points fill the image: half a pixel or a swapped term shows
    np.testing.assert_allclose(mine, pixels, rtol=0, atol=MILLI_PX)


def test_the_binary_of_colmap(tmp_path: Path) -> None:
    model = pycolmap.Reconstruction()
    model.add_camera(
        pycolmap.Camera(camera_id=3, model="OPENCV", width=64, height=48, params=[60, 61, 32, 24, 0.01, 0, 0, 0])
    )
    model.write_binary(str(tmp_path))
    found = read_camera(str(tmp_path / "cameras.bin"))
    assert found.model == "OPENCV" and found.params == (60, 61, 32, 24, 0.01, 0, 0, 0) and found.size == (64, 48)
    whole = (tmp_path / "cameras.bin").read_bytes()
    for wrong in (whole[:-3], whole + b"x", struct.pack("<Q", 0), b"", struct.pack("<QIi", 1, 1, 99) + whole[16:]):
        (tmp_path / "bad.bin").write_bytes(wrong)
        with refused(r"bad.bin: no cameras.bin of COLMAP, or cut off; export"):
            read_camera(str(tmp_path / "bad.bin"))


def _but(form: str, old: str, new: str) -> str:
    text = FORMS[form][0]()[0]
    assert old in text
    return text.replace(old, new)


def test_line_ends_of_windows_are_line_ends(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_bytes(_camchain([np.eye(4)]).replace("\n", "\r\n").encode())
    with refused(r"2 cameras \(cam0, cam1\); keep the one"):
        read_camera(str(tmp_path / "c.yaml"))
    assert len(read_rig_file(tmp_path / "c.yaml", RIG)[0].sensors) == 2


def test_several_cameras_in_one_file_are_named(tmp_path: Path) -> None:
    one = json.loads(FORMS["brown"][0]()[0])
    (tmp_path / "cameras.json").write_text(json.dumps({"a": one["v2 dji"], "b": one["v2 dji"]}))
    with refused(r"cameras.json: 2 cameras \(a, b\); keep the one"):
        read_camera(str(tmp_path / "cameras.json"))
    (tmp_path / "reconstruction.json").write_text(json.dumps([{"cameras": one, "shots": {}}]))
    assert read_camera(str(tmp_path / "reconstruction.json")).model == "FULL_OPENCV"


# --- whole rigs -------------------------------------------------------------------------------------------------------


def _camchain(links: list[np.ndarray], flow: bool = True) -> str:
    out = ""
    for number in range(len(links) + 1):
        out += f"cam{number}:\n"
        if number:
            out += "  T_cn_cnm1:\n"
            for row in links[number - 1].tolist():
                out += f"  - {row}\n" if flow else "  - - " + "\n    - ".join(map(repr, row)) + "\n"
        out += (
            "  camera_model: pinhole\n  distortion_coeffs: [0.01, -0.02, 0.001, -0.002]\n  distortion_model: radtan\n"
        )
        out += f"  intrinsics: [60.0, 61.0, 32.0, {24 - number}.0]\n  resolution: [64, 48]\n  timeshift_cam_imu: 0.0\n"
    return out


@pytest.mark.parametrize("flow", [True, False])
def test_a_camchain_is_a_rig(tmp_path: Path, flow: bool) -> None:
    """cam2 stands where two links bring it: a point goes from cam0 through cam1 to cam2."""
    first, second = (
        rigid(orient(72, 3, -1), np.array([0.1, 0.02, -0.03])),
        rigid(orient(70, -2, 4), np.array([0, 0.2, 0])),
    )
    path = tmp_path / "camchain.yaml"
    path.write_text(_camchain([first, second], flow))
    (rig,) = read_rig_file(path, RIG)
    assert [s.name for s in rig.sensors] == ["cam0", "cam1", "cam2"] and rig.body_is_reference
    point = np.array([0.3, -0.2, 5.0, 1.0])
    for sensor, wanted in zip(rig.sensors, (point, first @ point, second @ first @ point)):
        np.testing.assert_allclose(np.linalg.inv(sensor.body_from_sensor) @ point, wanted, atol=1e-9)
    assert rig.sensors[2].params == (60, 61, 32.5, 22.5, 0.01, -0.02, 0.001, -0.002)
    scene = scan(papers_rig(tmp_path / "in", ("up",), 3, 3), rig=str(path))
    np.testing.assert_allclose(scene.rigs[0].sensors[1].sensor_from_rig, first, atol=1e-9)
    assert scene.rigs[0].measured() and 0.1 < np.linalg.norm(centre(first)) < 0.2


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("[1.0, 0.0, 0.0,", "[1e999, 0.0, 0.0,", r"cam1: T_cn_cnm1 is no rotation and position"),
        ("T_cn_cnm1", "T_cam_imu", r"camchain.yaml, cam1: no T_cn_cnm1: its pose .* or give a rig.toml"),
        ("[1.0, 0.0, 0.0,", "[2.0, 0.0, 0.0,", r"cam1: T_cn_cnm1 is no rotation and position"),
        ("[0.0, 0.0, 1.0, 0.0]", "[0.0, 0.0, 1.0]", r"cam1: T_cn_cnm1: 15 numbers, 16 expected"),
        ("0.5]", "500.0]", r"'cam1' is 500 m from 'cam0', more than 100 m: are these millimetres"),
        ("pinhole", "omni", r"camchain.yaml, cam0: intrinsics \(xi, fu, fv, pu, pv\): 4 numbers, 5 expected"),
        ("[60.0", "[0.06", r"cam0: the focal length|cam0: the focal lengths"),
        ("camera_model", "model", r"no camera \(cam0: with camera_model"),
    ],
)
def test_camchains_that_cannot_be_meant(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = _camchain([rigid(np.eye(3), np.array([0.5, 0, 0]))])
    assert old in text
    (tmp_path / "camchain.yaml").write_text(text.replace(old, new))
    with refused(words):
        read_rig_file(tmp_path / "camchain.yaml", RIG)


def test_a_rig_file_names_the_calibrations_of_its_cameras(tmp_path: Path) -> None:
    (tmp_path / "left.yaml").write_text(FORMS["plumb_bob"][0]()[0])
    (tmp_path / "right.xml").write_text(FORMS["opencv xml"][0]()[0])
    rig = '[[sensors]]\nname = "l"\ncamera = {file = "left.yaml"}\n[[sensors]]\nname = "r"\n'
    path = tmp_path / "rig.toml"
    path.write_text(rig + '[sensors.camera]\nfile = "right.xml"\n')
    left, right = read_rig_file(path, RIG)[0].sensors
    assert (left.model, right.model) == ("FULL_OPENCV", "OPENCV_FISHEYE") and left.size == right.size == SIZE
    for camera, words in (
        ("file = 3", "line 7: camera of sensor 'r': file = the path"),
        ('file = "no.yaml"', "line 7: no.yaml"),
    ):
        path.write_text(f"{rig}[sensors.camera]\n{camera}\n")
        with refused(words):
            read_rig_file(path, RIG)


# One camera, as each program writes it: OpenCV and Kalibr count pixels from the centre of the first one.
PARAMS = [60.0, 61.0, 32.5, 24.5, 0.01, -0.02, 0.001, -0.002]
WORDS = "OPENCV,64x48," + ",".join(map(str, PARAMS))
COLMAP = (
    "# Camera list\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 OPENCV 64 48 " + " ".join(map(str, PARAMS)) + "\n"
)
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [60.0, 61.0, 32.0, 24.0]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
"""
BLOCK = KALIBR.replace("intrinsics: [60.0, 61.0, 32.0, 24.0]", "intrinsics:\n  - 60.0\n  - 61.0\n  - 32.0\n  - 24.0")
ROS = """image_width: 64
image_height: 48
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [60.0, 0.0, 32.0, 0.0, 61.0, 24.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.01, -0.02, 0.001, -0.002, 0.0]
"""
TOML = f'[camera]\nmodel = "OPENCV"\nsize = [64, 48]\nparams = {PARAMS}\n'
ONE = f'[[sensors]]\nname = "a"\ncamera = {{model = "OPENCV", size = [64, 48], params = {PARAMS}}}\n'


def _photographs(folder: Path, size: tuple[int, int] = (64, 48), count: int = 3) -> Path:
    for k in range(count):
        picture(folder / f"IMG_{k}.jpg", size)
    return folder


def _storage(path: Path) -> None:
    out = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    out.write("image_width", 64)
    out.write("image_height", 48)
    out.write("camera_matrix", np.array([[60.0, 0, 32], [0, 61, 24], [0, 0, 1]]))
    out.write("distortion_coefficients", np.array([[0.01, -0.02, 0.001, -0.002, 0.0]]))
    out.release()


@pytest.mark.parametrize(
    "name, content",
    [("", WORDS), ("cameras.txt", COLMAP), ("camchain.yaml", KALIBR), ("block.yaml", BLOCK), ("left.yaml", ROS),
     ("cv.yml", None), ("cv.xml", None), ("rig.toml", TOML), ("one.toml", ONE)],
)  # fmt: skip
def test_one_camera_in_every_form(tmp_path: Path, name: str, content: str | None) -> None:
    path = tmp_path / name
    if name and content is None:
        _storage(path)
    elif name:
        path.write_text(str(content))
    scene = scan(_photographs(tmp_path / "in"), camera=str(path) if name else WORDS)
    camera = scene.rigs[0].sensors[0].camera
    assert camera.model.name == "OPENCV" and (camera.width, camera.height) == (64, 48)
    np.testing.assert_allclose(camera.params, PARAMS, atol=1e-12)
    assert camera.has_prior_focal_length
    assert any("camera from" in n and (path.name if name else "--camera") in n for n in scene.notes)
    assert not any(str(tmp_path) in n for n in scene.notes), "no folder of this machine"


def test_models_of_other_programs(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(KALIBR.replace("radtan", "equidistant"))
    assert read_camera(str(path)).model == "OPENCV_FISHEYE"
    path.write_text(ROS.replace("-0.002, 0.0]", "-0.002, 0.003]"))
    found = read_camera(str(path))
    assert found.model == "FULL_OPENCV" and found.params == (*PARAMS, 0.003, 0.0, 0.0, 0.0)


def test_parameters_of_another_size_are_rescaled_and_of_another_shape_refused(tmp_path: Path) -> None:
    camera = scan(_photographs(tmp_path / "in", (128, 96)), camera=WORDS).rigs[0].sensors[0].camera
    np.testing.assert_allclose(camera.params[:4], 2 * np.array(PARAMS[:4]), atol=1e-9)
    with refused(r"--camera OPENCV.* is for 64 x 48 images, but its images have 64 x 64"):
        scan(_photographs(tmp_path / "square", (64, 64)), camera=WORDS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "text, words",
    [
        ("OPENCV,60,61,32", r"--camera OPENCV,60,61,32: OPENCV has 8 parameters \(fx, fy, cx, cy, k1, .*\), got 3"),
        ("OPENVC,60", r"'OPENVC' is no camera model; perhaps you meant 'OPENCV'\?; give MODEL,.*cameras.txt"),
        ("PINHOLE,60,61,32,x", "'x' is no number; give MODEL"),
        ("PINHOLE,64x48,60,61,3200,24", r"principal point \(3200, 24\) is not inside the 64 x 48 image"),
        ("nowhere/cameras.txt", "nowhere/cameras.txt: no such file; give MODEL"),
    ],
)
def test_words_that_cannot_be_meant(tmp_path: Path, text: str, words: str, capsys: pytest.CaptureFixture) -> None:
    with refused(words):
        read_camera(text)
    images = _photographs(tmp_path / "in", count=2)
    assert main(["run", str(images), "-o", str(tmp_path / "out"), "--calibration", text]) == 2
    assert not (tmp_path / "out").exists() and "--camera" in capsys.readouterr().err


@pytest.mark.parametrize(
    "text, words",
    [
        (_but("agisoft frame", "<b1>", "<b2>0.5</b2><b1>"),
         r"b2 = 0.5, a term that no camera model of COLMAP has; optimise"),
        (_but("agisoft frame", "<k1>", "<k4>-0.01</k4><k1>"),
         r"k4 = -0.01, a term that no .* optimise or calibrate without it"),
        (_but("agisoft frame", "<k1>", "<p3>0.01</p3><k1>"), r"p3 = 0.01, a term that no"),
        (_but("agisoft frame", "<f>2900.0</f>", "<f>29x0</f>"), r"f = '29x0': expected a number"),
        (_but("agisoft fisheye", "<f>2900.0</f>", "<fy>2900.0</fy><f></f>"), r"of the calibration is unknown|f = ''"),
        (_but("kalibr fov", "[4000, 3000]", "[4000, 1e999]"), r"images of 4000 x 1000000000: at most"),
        (_but("agisoft frame", ">frame<", ">spherical<"), r"a camera of type spherical: read are frame and fisheye"),
        (_but("agisoft frame", "<width>4000</width>", ""), r"width and height are missing"),
        (_but("agisoft frame", "<f>2900.0</f>", "<fx>2900</fx><fy>2900</fy>"), r"old version \(fx, fy\): p1 = 0.002"),
        (_but("fisheye62", '"k1"', '"k5": 0.1, "k1"'), r"k5 = 0.1, a term that no .* calibrate as fisheye_opencv"),
        (_but("brown", "brown", "dual"), r"projection_type dual: read are perspective"),
        (_but("brown", '"width": 4000', '"width": 0'), r"width and height are missing"),
        (_but("brown", "0.71", '"x"'), r"focal_y = 'x': expected a finite number"),
        (_but("brown", "}}", "}"), r"not valid JSON"),
        (_but("kalibr omni", "[0.0, 0.0,", "[0.1, 0.0,"), r"xi = 1.3: k1 = 0.1, a term that no .* equidistant"),
        (_but("kalibr eucm", "eucm", "ds"), r"ds with none: read are pinhole|4 expected"),
        (_but("plumb_bob", "plumb_bob", "inverse_brown_conrady"),
         r"distortion_model inverse_brown_conrady: read are plumb_bob"),
        (_but("plumb_bob", "[2900.0, 0,", "[2900.0, 3.0,"), r"a skew of 3"),
        (_but("ros2 message", "binning_x: 0", "binning_x: 2"), r"binning_x = 2: the camera_info is of binned images"),
        (_but("plumb_bob", "camera_matrix", "camera_matrix: 1\ncamera_matrix"), r"2 camera matrices; keep those of"),
        (_but("kalibr fov", "cam0:", "cam0:\n  camera_model: pinhole\n  more:"), r"each camera needs one camera_model"),
        (_but("ros2 message", "x_offset: 0", "x_offset: 64"), r"x_offset = 64: the camera_info is of"),
        (COLMAP + "2 PINHOLE 64 48 60 60 32 24\n", r"2 cameras \(1, 2\); keep the one"),
        (COLMAP.replace("-0.002\n", "\n"), r"line 3: OPENCV has 8 parameters .*, got 7"),
        (KALIBR + KALIBR.replace("cam0", "cam1"), r"2 cameras \(cam0, cam1\); keep the one"),
        (KALIBR.replace("pinhole", "omni"), "xi = 60: k1 = 0.01, a term that no camera model|5 expected"),
        (KALIBR.replace(", 24.0]", "]"), r"intrinsics \(fu, fv, pu, pv\): 3 numbers, 4 expected"),
        (ROS.replace(", 0.0, 0.0, 1.0]", "]"), "camera_matrix: 6 numbers, 9 expected"),
        ("hello: world\n", "the format of the calibration is unknown; known are COLMAP"),
    ],
)  # fmt: skip
def test_files_that_cannot_be_meant(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "camera.x").write_text(text)
    with refused(words, "camera.x"):
        read_camera(str(tmp_path / "camera.x"))


def test_several_cameras_need_a_rig_file_and_photographs_of_others_keep_theirs(tmp_path: Path) -> None:
    with refused(r"images are of 3 cameras: cam0 \(64 x 48\), .* in a rig.toml"):
        scan(papers_rig(tmp_path / "rig"), camera=WORDS)
    for k in range(3):
        picture(tmp_path / "two" / f"IMG_{k}.jpg", exif=exif_of(make="A", model="B"))
        picture(tmp_path / "two" / f"P{k}.jpg", (60, 60), exif=exif_of(make="C", model="D"))
    scene = scan(tmp_path / "two", camera=WORDS)
    taken = next(s.camera for s in scene.all_sensors if s.camera.width == 64)
    np.testing.assert_allclose(taken.params, PARAMS)
    assert says(scene.notes, "1 other cameras keep the values of EXIF")
