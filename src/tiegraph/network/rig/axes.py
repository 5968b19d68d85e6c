"""What the optical axes of a rig say about which cameras can match, within a pass and between passes."""

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.rig import Rig


def allowed_within(rig: Rig, limit_deg: float) -> np.ndarray:
    """(S, S) bool: camera pairs of one pass whose axes permit a match; all, while the extrinsics are unknown."""
    angles = rig.axis_angles_deg()
    return ~(angles > limit_deg)


def vertical(rig: Rig) -> np.ndarray:
    """Unit vector (3,) in the rig frame about which a vehicle turns: normal of the plane of the side cameras' axes.

    With fewer than three side cameras, or axes that span no plane, the reference camera is taken to be level.
    """
    axes = np.stack(
        [s.optical_axis() for s in rig.sensors if s.role != "up"] or [s.optical_axis() for s in rig.sensors]
    )
    up = np.array([0.0, -1.0, 0.0])
    if len(axes) < 3 or not np.isfinite(axes).all():
        return up
    _, size, rows = np.linalg.svd(axes)
    if size[1] < 0.5 or size[2] > 0.5 * size[1]:
        return up
    return rows[2] if rows[2] @ up >= 0 else -rows[2]


def angles_deg(rig: Rig, yaw_deg: float) -> np.ndarray:
    """(S, S) angles between axis c in one pass and axis d in a pass whose heading differs by ``yaw_deg``."""
    axes = np.stack([s.optical_axis() for s in rig.sensors])
    turn = Rotation.from_rotvec(np.radians(yaw_deg) * vertical(rig)).as_matrix()
    return np.degrees(np.arccos(np.clip(axes @ (axes @ turn.T).T, -1, 1)))


def yaw_between(rig: Rig, evidence: np.ndarray) -> float | None:
    """Heading difference in degrees that best explains which cameras (S, S) match; None without evidence.

    Matching cameras look the same way: the yaw with the greatest evidence-weighted cosine between axes.
    """
    side = np.array([s.role != "up" for s in rig.sensors])
    evidence = evidence * side[:, None] * side[None, :]
    if evidence.sum() <= 0:
        return None
    yaws = np.arange(0, 360, 12.0)
    score = [np.sum(evidence * np.cos(np.radians(angles_deg(rig, y)))) for y in yaws]
    return float(yaws[int(np.argmax(score))])


def predicted_shift(rig: Rig, a: int, b: int) -> np.ndarray:
    """(2,) motion in the picture from camera a to b of a thing that stands midway between their axes."""
    pose_a, pose_b = rig.sensors[a].sensor_from_rig, rig.sensors[b].sensor_from_rig
    assert pose_a is not None and pose_b is not None
    centres = transforms.centre(pose_a), transforms.centre(pose_b)
    baseline = float(np.linalg.norm(centres[1] - centres[0]))
    # Things are assumed ten baselines away
    middle = rig.sensors[a].optical_axis() + rig.sensors[b].optical_axis()
    away = 10 * max(baseline, 1e-3) * middle / max(np.linalg.norm(middle), 1e-9)
    thing = 0.5 * (centres[0] + centres[1]) + away
    seen = [transforms.apply(pose, thing[None])[0] for pose in (pose_a, pose_b)]
    return seen[1][:2] / max(seen[1][2], 1e-3) - seen[0][:2] / max(seen[0][2], 1e-3)
