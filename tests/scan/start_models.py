"""Small models as COLMAP, OpenSfM, nerfstudio and Metashape write them, all of the same poses.

Written by the programs' own formulas from camera_from_world; Metashape's after a real export (components with their
transform to the Earth, groups, a camera that was not aligned, two calibrations of a sensor).
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry.transforms import rigid

WIDTH, HEIGHT = 64, 48
FOCAL_PX, K1 = 60.0, -0.05
TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def walk(count: int = 6) -> dict[str, np.ndarray]:
    """camera_from_world of images a_0.jpg ...: a curve, each looking elsewhere."""
    out = {}
    for k in range(count):
        turn = Rotation.from_euler("zyx", [10 * k, 20 + 7 * k, 5 * k], degrees=True).as_matrix()
        out[f"a_{k}.jpg"] = np.linalg.inv(rigid(turn, np.array([k, 0.3 * k * k, 0.1 * k])))
    return out


LENS = f"7 SIMPLE_RADIAL {WIDTH} {HEIGHT} {FOCAL_PX} 32 24 {K1}"


def colmap_model(folder: Path, poses: dict[str, np.ndarray], binary: bool = False, lens: str = LENS) -> Path:
    """images.txt with quaternion (w first) and translation; one camera."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = ""
    for k, (name, pose) in enumerate(poses.items(), 1):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        numbers = " ".join(map(repr, map(float, (w, x, y, z, *pose[:3, 3]))))
        rows += f"{k} {numbers} {lens.split()[0]} {name}\n\n"
    for file, text in (("cameras", f"{lens}\n"), ("images", rows), ("points3D", "")):
        (folder / f"{file}.txt").write_text(text)
    if binary:
        model = pycolmap.Reconstruction(str(folder))
        for file in folder.iterdir():
            file.unlink()
        model.write_binary(str(folder))
    return folder


def opensfm_file(path: Path, poses: dict[str, np.ndarray], more: int = 0) -> Path:
    """reconstruction.json; ``more``: images of a second, smaller reconstruction before it."""
    camera = {"projection_type": "perspective", "width": WIDTH, "height": HEIGHT, "focal": FOCAL_PX / WIDTH,
              "k1": K1, "k2": 0.0}  # fmt: skip
    shots = {
        name: {"rotation": Rotation.from_matrix(p[:3, :3]).as_rotvec().tolist(), "translation": p[:3, 3].tolist(),
               "camera": "v2 x", "orientation": 1, "capture_time": 0.0}
        for name, p in poses.items()
    }  # fmt: skip
    part = {"cameras": {"v2 x": camera}, "shots": shots, "points": {}, "biases": {}}
    part["reference_lla"] = {"latitude": 35.0, "longitude": 139.0, "altitude": 0.0}
    odd = {f"other_{k}.jpg": next(iter(shots.values())) for k in range(more)}
    parts = [{**part, "shots": odd}, part] if more else [part]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(parts))
    return path


def nerf_file(path: Path, poses: dict[str, np.ndarray], **more: object) -> Path:
    """transforms.json: camera to world, x right, y up, z backward."""
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": (np.linalg.inv(p) @ TO_OPENGL).tolist()}
        for name, p in poses.items()
    ]
    lens = {"camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT, "fl_x": FOCAL_PX, "fl_y": FOCAL_PX, "cx": 32.0,
            "cy": 24.0, "k1": K1, "k2": 0.0, "p1": 0.0, "p2": 0.0}  # fmt: skip
    path.write_text(json.dumps({**lens, **more, "frames": frames}))
    return path


def metashape_file(path: Path, poses: dict[str, np.ndarray], lens: str = "", lost: int = 1) -> Path:
    """Export of cameras: world_from_camera of the chunk, labels without ending; ``lost`` cameras are not aligned."""
    rows = []
    for k, (name, pose) in enumerate(poses.items()):
        numbers = " ".join(f"{v:.17g}" for v in np.linalg.inv(pose).ravel())
        rows.append(f'<camera id="{k}" sensor_id="3" component_id="0" label="{name.rpartition(".")[0]}">'
                    f"<transform>{numbers}</transform><orientation>1</orientation></camera>")  # fmt: skip
    rows += [f'<camera id="{90 + k}" sensor_id="3" label="lost_{k}"></camera>' for k in range(lost)]
    size = f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
    calibration = f"{size}<f>{FOCAL_PX}</f><k1>{K1}</k1>{lens}"
    path.write_text(f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0">
 <chunk label="Chunk 1" enabled="true">
  <sensors next_id="4">
   <sensor id="2" label="unused" type="frame">{size}</sensor>
   <sensor id="3" label="X" type="frame">{size}
    <calibration type="frame" class="initial">{size}<f>50</f></calibration>
    <calibration type="frame" class="adjusted">{calibration}</calibration>
   </sensor>
  </sensors>
  <components next_id="1" active_id="0"><component id="0" label="Component 1"><transform>
   <rotation locked="true">0.87 0.31 -0.38 -0.49 0.57 -0.66 0.01 0.77 0.64</rotation>
   <translation locked="true">-2499366.4 -4256836.5 4029217.9</translation><scale locked="true">12.35</scale>
  </transform></component></components>
  <cameras next_id="99" next_group_id="1"><group id="0" label="Group 1" type="folder">
   {"".join(rows)}
  </group></cameras>
 </chunk>
</document>
""")
    return path
