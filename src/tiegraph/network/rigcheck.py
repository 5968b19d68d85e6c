"""Are the nominal axes of a rig those of the images? The images of one frame say so, without any motion between them.

A preset may turn the wrong way round (mirrored), or its images may lie on their side (rolled). Each of these hypotheses
predicts which way a thing moves in the picture from one camera to the next; the previews of same-frame pairs vote.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.network.axes import allowed_within
from tiegraph.network.passes import Pass, PreviewBook
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene

FRAMES = 16  # frames whose images are compared
MIN_VOTES = 6  # image pairs with enough matches
AGREEMENT = 0.5  # mean cosine between predicted and seen motion that counts as agreement
MARGIN = 0.5  # a hypothesis must beat the nominal rig by this much to replace it
TIE = 0.03  # agreements this close are the same
INLIERS = 1.3  # times min_matches: a single preview must be surer than an average of many
FAR = 10.0  # assumed distance of things, in baselines

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RigCheck:
    """Outcome for one rig: the rig to use from here on, whether it was changed, and what was found."""

    rig: Rig
    changed: bool
    note: str


@dataclass(frozen=True)
class _Votes:
    """K same-frame pairs: sensors a, b, shift (K, 2), rotation angle of the axes in degrees (NaN = unknown)."""

    a: np.ndarray
    b: np.ndarray
    shift: np.ndarray
    angle_deg: np.ndarray


def check_rigs(
    scene: Scene, passes: Sequence[Pass], book: PreviewBook, settings: NetworkSettings
) -> tuple[Scene, tuple[str, ...]]:
    """The scene with rigs whose sense of rotation or roll the images contradict corrected, and what was found."""
    rigs, notes = list(scene.rigs), []
    for k, rig in enumerate(scene.rigs):
        if len(rig.sensors) < 2 or not rig.known():
            continue
        outcome = check_rig(rig, [p for p in passes if p.rig_index == k], book, settings)
        rigs[k] = outcome.rig
        notes.append(outcome.note)
    return scene.with_(rigs=tuple(rigs)), tuple(notes)


def check_rig(rig: Rig, passes: Sequence[Pass], book: PreviewBook, settings: NetworkSettings) -> RigCheck:
    """Vote on mirrored and rolled versions of a rig with same-frame previews; a calibrated rig is never changed."""
    votes = _collect(rig, passes, book, settings)
    if len(votes.a) < MIN_VOTES:
        text = f"rig {rig.name}: its axes could not be checked against the images: too few matches"
        return RigCheck(rig, False, f"{text} ({len(votes.a)} of {MIN_VOTES} pairs of one frame)")
    score = {name: _agreement(variant, votes) for name, variant in _hypotheses(rig)}
    # Of explanations that fit alike the first: side cameras of a ring cannot tell "mirrored" from "upside down".
    best = next(name for name, s in score.items() if s >= max(score.values()) - TIE)
    angles = _angles(rig, votes)
    if score["nominal"] >= AGREEMENT or best == "nominal":
        how = "agree with" if score["nominal"] >= AGREEMENT else "neither prove nor contradict"
        return RigCheck(rig, False, f"rig {rig.name}: the images {how} its sense of rotation{angles}")
    if score[best] < AGREEMENT or score[best] < score["nominal"] + MARGIN:
        return RigCheck(rig, False, f"rig {rig.name}: the images fit its axes badly; check the rig file{angles}")
    if rig.fixed:
        return RigCheck(rig, False, f"rig {rig.name}: the images say it is {best}, but it is calibrated: kept{angles}")
    corrected = dict(_hypotheses(rig))[best]
    return RigCheck(corrected, True, f"rig {rig.name}: the images show it {best}: corrected{_angles(corrected, votes)}")


def _hypotheses(rig: Rig) -> list[tuple[str, Rig]]:
    out = []
    for roll in (0, 90, 180, 270):
        turn = Rotation.from_euler("z", roll, degrees=True).as_matrix()
        for mirror in (False, True):
            name = " and ".join(["mirrored"] * mirror + [f"rolled by {roll} deg"] * (roll > 0)) or "nominal"
            out.append((name, _variant(rig, turn, mirror)))
    return out


def _variant(rig: Rig, turn: np.ndarray, mirror: bool) -> Rig:
    """Every camera turned about its own axis, and the rig reflected left to right as seen by the reference camera."""
    flip = np.diag([-1.0, 1.0, 1.0]) if mirror else np.eye(3)
    change = transforms.rigid(turn @ flip, np.zeros(3))
    sensors = []
    for s in rig.sensors:
        assert s.sensor_from_rig is not None
        sensors.append(replace(s, sensor_from_rig=change @ s.sensor_from_rig @ np.linalg.inv(change)))
    return replace(rig, sensors=tuple(sensors))


def _collect(rig: Rig, passes: Sequence[Pass], book: PreviewBook, settings: NetworkSettings) -> _Votes:
    allowed = allowed_within(rig, settings.axes_deg)
    couples = [(a, b) for a, b in np.argwhere(allowed) if a < b]
    each = max(1, FRAMES // max(1, len(passes)))
    rows = []
    for p in passes:
        for k in np.unique(np.linspace(0, len(p) - 1, min(len(p), each)).round().astype(int)):
            for c, d in couples:
                if p.images[c, k] >= 0 and p.images[d, k] >= 0:
                    rows.append((c, d, p.images[c, k], p.images[d, k]))
    if not rows:
        return _Votes(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    a, b, i, j = np.array(rows).T
    results = book.results(i, j)
    enough = [k for k, r in enumerate(results) if r.inliers >= INLIERS * settings.min_matches and r.shift is not None]
    angle = [np.nan if results[k].rotation is None else _axis_angle(results[k].rotation) for k in enough]
    shift = np.array([results[k].shift for k in enough]).reshape(-1, 2)
    return _Votes(a[enough], b[enough], shift, np.array(angle, float))


def _axis_angle(rotation: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(rotation[2, 2], -1, 1))))


def _agreement(rig: Rig, votes: _Votes) -> float:
    """Mean cosine between predicted and seen motion of the shared things, every camera pair with the same weight."""
    cosine = []
    for a, b in sorted(set(zip(votes.a.tolist(), votes.b.tolist()))):
        predicted = _predicted_shift(rig, a, b)
        seen = votes.shift[(votes.a == a) & (votes.b == b)]
        length = np.linalg.norm(seen, axis=1) * np.linalg.norm(predicted)
        if np.linalg.norm(predicted) > 1e-9:
            cosine.append(float(np.mean(seen @ predicted / np.maximum(length, 1e-9))))
    return float(np.mean(cosine)) if cosine else 0.0


def _predicted_shift(rig: Rig, a: int, b: int) -> np.ndarray:
    """(2,) motion in the picture from camera a to b of a thing that stands midway between their axes."""
    pose_a, pose_b = rig.sensors[a].sensor_from_rig, rig.sensors[b].sensor_from_rig
    assert pose_a is not None and pose_b is not None
    centres = transforms.centre(pose_a), transforms.centre(pose_b)
    baseline = float(np.linalg.norm(centres[1] - centres[0]))
    middle = rig.sensors[a].optical_axis() + rig.sensors[b].optical_axis()
    thing = 0.5 * (centres[0] + centres[1]) + FAR * max(baseline, 1e-3) * middle / max(np.linalg.norm(middle), 1e-9)
    seen = [transforms.apply(pose, thing[None])[0] for pose in (pose_a, pose_b)]
    return seen[1][:2] / max(seen[1][2], 1e-3) - seen[0][:2] / max(seen[0][2], 1e-3)


def _angles(rig: Rig, votes: _Votes) -> str:
    if any(s.camera is None or not s.camera.has_prior_focal_length for s in rig.sensors):
        return ""  # angles from a guessed focal length mean nothing
    nominal = rig.axis_angles_deg()
    parts = []
    for a, b in sorted(set(zip(votes.a.tolist(), votes.b.tolist()))):
        found = votes.angle_deg[(votes.a == a) & (votes.b == b)]
        found = found[np.isfinite(found)]
        if len(found) >= 3:
            names = f"{rig.sensors[a].name}-{rig.sensors[b].name}"
            parts.append(f"{names} {np.median(found):.0f} ({nominal[a, b]:.0f})")
    return f"; angles between axes found (nominal), deg: {', '.join(parts)}" if parts else ""
