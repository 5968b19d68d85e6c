"""A whole rig from Kalibr's camchain.yaml.

``T_cn_cnm1`` of camera n takes points of camera n-1 into camera n (wiki, "yaml formats": "always with respect to the
last camera in the chain"), metres; the first camera has none and is the reference. A sensor is called as its camera
(cam0, ...), and so is its folder. What is said of an IMU (``T_cam_imu``, ``timeshift_cam_imu``) is no part of a rig of
cameras.
"""

from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import invert
from tiegraph.scan.rigfiles.camerafile import check_count, check_lens
from tiegraph.scan.rigfiles.cameraread import exactly, matrix_of
from tiegraph.scan.rigfiles.camerayaml import kalibr, kalibr_blocks
from tiegraph.scan.rigfiles.rigfaults import faults
from tiegraph.scan.rigfiles.rigspec import UNIT, RigSpec, SensorSpec
from tiegraph.scan.tuning import RigTuning

_CHAIN = "T_cn_cnm1"


def kalibr_rig(path: Path, content: str, name: str, tuning: RigTuning) -> RigSpec:
    """The rig of a camchain.yaml, called ``name``. Raises InputError naming camera and key."""
    blocks, pose, sensors = kalibr_blocks(content), np.eye(4), []
    if not blocks:
        raise InputError(f"{path}: no camera (cam0: with camera_model and intrinsics) in it: is it a camchain.yaml?")
    for number, (camera, found) in enumerate(zip(blocks, kalibr(content, str(path)))):
        check_count(found.model, found.params, found.where)
        check_lens(found, tuning.camera)
        if number:
            pose = pose @ invert(_link(blocks[camera], f"{path}, {camera}"))
        sensors.append(
            SensorSpec(
                name=camera,
                body_from_sensor=pose,
                model=found.model,
                size=found.size,
                params=found.params,
                number=number,
                at=found.where,
            )
        )
    rig = RigSpec(name, tuple(sensors), file=str(path), body_is_reference=True)
    for fault in faults(rig, tuning):
        raise InputError(f"{path}: {fault.message}")
    return rig


def _link(block: str, where: str) -> np.ndarray:
    """(4, 4) from the camera before to this one."""
    given = matrix_of(block, _CHAIN)
    if not given:
        raise InputError(
            f"{where}: no {_CHAIN}: where it is in the rig is not said. Calibrate the cameras together, or give "
            "a rig.toml"
        )
    matrix = np.array(exactly(given, 16, f"{where}: {_CHAIN}")).reshape(4, 4)
    turn = matrix[:3, :3]
    good = np.isfinite(matrix).all() and np.allclose(turn @ turn.T, np.eye(3), atol=UNIT) and np.linalg.det(turn) > 0
    if not good or not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise InputError(f"{where}: {_CHAIN} is no rotation and place (4 rows of 4, the last 0, 0, 0, 1)")
    return matrix
