"""A run folder with every artefact, small and made up, so that the report is tested without the pipeline."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import laspy
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import geodesy, transforms
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import Accuracy, Answer, Figure
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Dropped, Scene, simple_scene

FRAMES, CAMERAS = 10, 3
PASSES = ("up", "down")
MISSING_FRAMES = (4, 17)  # no image of these is in the model
SIZE = (240, 180)
FOCAL = 200.0
_BASE = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # camera looking along x, z up
STAGES = (
    "scan", "masks", "preview", "candidates", "coarse", "network", "design", "features", "match", "sparse", "georef",
    "dense", "cloud", "evaluate",
)  # fmt: skip


def make_run(folder: Path, until: str = "evaluate", seed: int = 0) -> Path:
    """Write a run folder as if it had stopped after ``until``."""
    rng = np.random.default_rng(seed)
    scene = make_scene(rng)
    folder.mkdir(parents=True, exist_ok=True)
    stages = STAGES[: STAGES.index(until) + 1]
    (folder / "scene.json").write_text(scene.to_json())
    write_images(folder, scene, masks="masks" in stages)
    network = make_pairs(scene, rng)
    if "network" in stages:
        np.savez(folder / "network.npz", **network.to_npz())
        (folder / "network").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / "network" / "map.png"), rng.integers(0, 255, (120, 300, 3), np.uint8))
    design = network.drop(network.score < 40, "cut")
    if "design" in stages:
        np.savez(folder / "pairs.npz", **design.to_npz())
    if "match" in stages:
        inliers = np.where(design.dropped == 0, rng.integers(0, 600, len(design)), -1)
        inliers = np.where((inliers >= 0) & (inliers < 40), 0, inliers)
        matched = design.with_(inliers=inliers).drop(inliers == 0, "match")
        np.savez(folder / "match.npz", **matched.to_npz())
    if "sparse" in stages:
        write_model(folder / "sparse" / "0", scene)
    if "georef" in stages:
        write_model(folder / "sparse" / "world", scene)
        (folder / "world.json").write_text(json.dumps(make_world(scene, rng)))
    if "cloud" in stages:
        write_cloud(folder / "cloud.laz", scene, rng)
    if "evaluate" in stages:
        (folder / "metrics.json").write_text(json.dumps(make_metrics()))
    for k, stage in enumerate(stages):
        write_receipt(folder, stage, 3.0 * (k + 1) ** 1.5 * (1 + 0.3 * seed))
    return folder


def make_scene(rng: np.random.Generator) -> Scene:
    """Two passes of a three-camera ring along a bend."""
    camera = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=[FOCAL, FOCAL, 120, 90])
    turns = Rotation.from_rotvec(np.outer(np.radians(72.0 * np.arange(CAMERAS)), [0, 1, 0])).as_matrix()
    sensors = tuple(
        Sensor(f"cam{c}", camera, transforms.rigid(turns[c], [0.03 * c, 0, 0.02 * c]), "side", f"cam{c}")
        for c in range(CAMERAS)
    )
    frames = len(PASSES) * FRAMES
    names, frame, sensor = [], [], []
    for f in range(frames):
        for c in range(CAMERAS):
            names.append(f"{PASSES[f // FRAMES]}/cam{c}/{f % FRAMES:06d}.jpg")
            frame.append(f)
            sensor.append(c)
    order = np.argsort(names)
    prior = true_poses()
    prior[:, :3, 3] += rng.normal(0, 0.3, (frames, 3))
    prior[:, :3, :3] = np.nan
    return simple_scene(
        Rig("ring <of> 3", sensors),
        [names[k] for k in order],
        np.array(frame)[order],
        np.array(sensor)[order],
        np.repeat([0, 1], FRAMES),
        np.tile(np.arange(FRAMES), 2),
        sequences=PASSES,
        world_from_rig=prior,
        position_sigma_m=np.full((frames, 3), 0.3),
        section=np.repeat([0, 1, 0, 1], FRAMES // 2),
        origin=geodesy.make_origin(35.6965, 139.7695, 37.0),
        prior="gnss",
        dropped=(Dropped("up/cam0/broken.jpg", "truncated & unreadable <JPEG>"),),
        notes=("layout guessed: pass/camera/frame",),
    )


def true_poses() -> np.ndarray:
    """(F, 4, 4) world_from_rig: up the river and back."""
    s = np.concatenate([2.0 * np.arange(FRAMES), 18 - 2.0 * np.arange(FRAMES)])
    heading = np.where(np.arange(len(s)) < FRAMES, 0.0, np.pi) + 0.02 * s
    turn = Rotation.from_rotvec(np.outer(heading, [0, 0, 1])).as_matrix()
    side = np.where(np.arange(len(s)) < FRAMES, -2.0, 2.0)
    return transforms.rigid(turn @ _BASE, np.column_stack([s, side + np.sin(s / 6), 0 * s + 2]))


def write_images(folder: Path, scene: Scene, masks: bool) -> None:
    """Small pictures with a sky and a quay, and masks over sky and water."""
    for k, name in enumerate(scene.names):
        picture = np.full((SIZE[1], SIZE[0], 3), (235, 205, 160), np.uint8)
        picture[60:130] = (90, 110, 120)
        picture[130:] = (120, 100, 60)
        x = 20 + 17 * (k % 10)
        cv2.rectangle(picture, (x, 66), (x + 30, 120), (40, 60 + 5 * k % 150, 180), -1)
        mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
        mask[60:130] = 255
        files = [(folder / "images" / name, picture)]
        if masks:
            files.append((folder / "masks" / f"{name}.png", mask))
        for path, data in files:
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), data)


def make_pairs(scene: Scene, rng: np.random.Generator) -> Pairs:
    """Candidates between near steps of all cameras, some weak."""
    i, j = np.triu_indices(len(scene), 1)
    near = np.abs(scene.frame[i] % FRAMES - scene.frame[j] % FRAMES) <= 4
    i, j = i[near], j[near]
    score = rng.gamma(2.0, 40.0, len(i))
    pairs = Pairs.make(i, j, "offsets", score=score)
    pairs = pairs.drop((scene.sensor[pairs.i] + 2 == scene.sensor[pairs.j]), "axes")
    return pairs.drop(pairs.score < 20, "weak")


def write_model(folder: Path, scene: Scene) -> None:
    """A COLMAP model with the rig, a third of the points of the cloud, two frames missing; where the walls end, five
    images see fewer than 10 points."""
    model = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    for c, sensor in enumerate(scene.rigs[0].sensors):
        params = [FOCAL + c, FOCAL + c, 120, 90]
        camera = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=params, camera_id=c + 1)
        model.add_camera(camera)
        if c == 0:
            rig.add_ref_sensor(camera.sensor_id)
        else:
            rig.add_sensor(camera.sensor_id, pycolmap.Rigid3d(sensor.sensor_from_rig[:3]))
    model.add_rig(rig)
    surface = _surface(np.random.default_rng(5), 600)
    sights: list[list[tuple[int, int]]] = [[] for _ in surface[0]]
    for f, pose in enumerate(true_poses()):
        if f in MISSING_FRAMES:
            continue
        frame = pycolmap.Frame(frame_id=f + 1, rig_id=1)
        members = [k for k in range(len(scene)) if scene.frame[k] == f]
        for k in members:
            sensor_id = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, int(scene.sensor[k]) + 1)
            frame.add_data_id(pycolmap.data_t(sensor_id, k + 1))
        frame.rig_from_world = pycolmap.Rigid3d(transforms.invert(pose)[:3])
        model.add_frame(frame)
        for k in members:
            camera_id = int(scene.sensor[k]) + 1
            cam_from_world = scene.sensor_of(k).sensor_from_rig @ transforms.invert(pose)
            rows, xy = _seen(model.cameras[camera_id], transforms.apply(cam_from_world, surface[0]))
            for row, point in enumerate(rows):
                sights[point].append((k, row))
            image = pycolmap.Image(name=scene.names[k], camera_id=camera_id, image_id=k + 1, keypoints=xy)
            image.frame_id = f + 1
            model.add_image(image)
    for (point, colour), seen in zip(zip(*surface), sights):
        model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(k + 1, row) for k, row in seen]), colour)
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(folder)


def _seen(camera: pycolmap.Camera, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which points (K, 3), camera axes, a camera has in its picture, and where, half a pixel off."""
    ahead = np.flatnonzero(local[:, 2] > 0.5)
    xy = np.asarray(camera.img_from_cam(local[ahead]), float)
    inside = np.all((xy > 0) & (xy < SIZE), axis=1)
    return ahead[inside][:40], xy[inside][:40] + [0.5, 0.0]


def _surface(rng: np.random.Generator, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Two quay walls with coloured stripes and windows."""
    x, z = rng.uniform(-8, 26, points), rng.uniform(0, 7, points)
    side = rng.integers(0, 2, points)
    y = np.where(side, 9.0, -8.0) + np.sin(x / 6) + rng.normal(0, 0.02, points)
    stripe = (np.floor(x / 3) % 2).astype(int)
    window = (np.mod(x, 3) > 1) & (np.mod(x, 3) < 2) & (np.mod(z, 2) > 0.8)
    rgb = np.where(stripe[:, None], [170, 120, 95], [200, 195, 180])
    return np.column_stack([x, y, z]), np.where(window[:, None], [60, 80, 100], rgb).astype(np.uint8)


def make_world(scene: Scene, rng: np.random.Generator) -> dict:
    """A world.json."""
    frames = [f for f in range(scene.frames) if f not in MISSING_FRAMES]
    residuals = rng.normal(0, [0.2, 0.2, 0.4], (len(frames), 3))
    return {
        "crs": scene.origin.crs,
        "shift_m": list(scene.origin.shift_m),
        "origin": scene.origin.to_dict(),
        "scale_from": "gnss",
        "similarity": {"scale": 1.7, "rotation": np.eye(3).tolist(), "translation": [0, 0, 0]},
        "placed": True,
        "notes": ["no GNSS under the bridge: 3 frames hang on their neighbours"],
        "frames": [{"frame": f, "residual_m": r.tolist()} for f, r in zip(frames, residuals)],
    }


def write_cloud(path: Path, scene: Scene, rng: np.random.Generator, points: int = 40_000) -> None:
    """A LAZ file in full CRS coordinates with sigma and views."""
    xyz, rgb = _surface(rng, points)
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.offsets, header.scales = np.array(scene.origin.shift_m), np.full(3, 0.001)
    header.add_extra_dims([laspy.ExtraBytesParams("sigma_m", "f4"), laspy.ExtraBytesParams("views", "u1")])
    las = laspy.LasData(header)
    las.xyz = xyz + scene.origin.shift_m
    las.red, las.green, las.blue = (rgb.astype(np.uint16) * 257).T
    las["sigma_m"] = rng.gamma(3, 0.01, points)
    las["views"] = rng.integers(3, 8, points)
    las.write(path)


def make_metrics() -> dict:
    """A metrics.json."""
    values = {"registered_images": (90.0, "%"), "backprojection_rmse": (0.0162, "m"), "ate_sim3_rmse": (0.082, "m"),
              "ate_se3_rmse": (0.121, "m"), "rpe_1m_translation": (None, "m"), "cloud_to_cloud_median": (0.034, "m"),
              "cloud_to_cloud_90": (0.21, "m")}  # fmt: skip
    metrics = [{"name": n, "value": v, "unit": u, "better": "low", "target": None} for n, (v, u) in values.items()]
    shares = [[0.02, 31.0, 22.0, 25.7], [0.05, 62.0, 40.0, 48.6], [0.1, 80.0, 55.0, 65.2], [0.2, 90.1, 63.0, 74.2]]
    columns = ["distance m", "accuracy %", "completeness %", "F %"]
    tables = {"cloud against reference": {"columns": columns, "rows": shares}}
    notes = ["Back-projection error is a round trip."]
    return {"accuracy": make_accuracy().to_dict(), "metrics": metrics, "tables": tables, "notes": notes}


def make_accuracy() -> Accuracy:
    """Figures of all layers, some predicted only, some measured."""
    figures = (
        Figure("world", "a point of the cloud (median)", 2.58, proves_not="what it does not know of"),
        Figure("world.nine_in_ten", "nine in ten points of the cloud", 3.1),
        Figure("world.check_points", "a check point", 0.05, 0.062, "3 check points", True, "anything elsewhere"),
        Figure("world.held_out", "a position", 0.3, 0.55, "4 positions held back from the fit"),
        Figure("world.positions", "a position", measured=0.51, by="the positions of the fit"),
        Figure("shape.whole", "a camera, over the whole", 0.1, 0.121, "54 reference poses", True),
        Figure("shape.10m", "what lies between two cameras 10 m apart", 0.004),
        Figure("point", "a point of the cloud (median)", 0.036),
    )
    placement = {"position_m": 0.06, "height_m": 0.11, "yaw_deg": 0.12, "tilt_deg": 0.3, "scale": 0.002}
    answer = Answer(
        0.05, "no", "3 check points measured more", "more control points, to the sides and at the ends of the way"
    )
    return Accuracy("m", "3 control points", figures, placement, answer)


def write_receipt(folder: Path, stage: str, seconds: float) -> None:
    """The receipt of a stage."""
    counts = {"scan": {"images": 60, "frames": 20}, "cloud": {"points": 40_000}}
    rows = [["cam0", 0.94, 0.88], ["cam1", 0.95, 0.9], ["all", 0.945, 0.89]]
    masks = {"accuracy": {"columns": ["camera", "pixel_accuracy", "iou"], "rows": rows}}
    receipt = {
        "stage": stage,
        "key": "0123456789abcdef",
        "version": 1,
        "settings": {"example": 3, "flag": True, "list": [1, 2], "nothing": None},
        "seconds": seconds,
        "cpu_s": 1.7 * seconds,
        "peak_mib": 400 + 10 * seconds,
        "counts": counts.get(stage, {"items": 7}),
        "dropped": [["up/cam0/broken.jpg", "truncated & unreadable <JPEG>"]] if stage == "scan" else [],
        "notes": [f"a note of {stage}"],
        "tables": masks if stage == "masks" else {},
        "software": {"tiegraph": "0.1.0", "python": "3.11"},
        "finished": "2026-01-01T00:00:00+00:00",
    }
    path = folder / "receipts" / f"{stage}.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(receipt))


def tell(folder: Path, stage: str, **more: object) -> None:
    """Other words in the receipt of a stage."""
    path = folder / "receipts" / f"{stage}.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **more}))
