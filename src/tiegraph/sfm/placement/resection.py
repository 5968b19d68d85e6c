"""A frame's place from the verified matches of its images with images that have theirs, by all its cameras at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.sfm.model import matrix, rigid3d
from tiegraph.sfm.tuning.placement import PlacementTuning, ResectionTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches


@dataclass(frozen=True)
class Resection:
    """world_from_rig (4, 4) model units, how many points agree, of how many, with how many partner images, cameras."""

    pose: np.ndarray
    inliers: int
    total: int
    partners: int
    cameras: int

    def holds(self, tuning: ResectionTuning) -> bool:
        """Whether it is more than chance."""
        enough = self.inliers >= tuning.min_inliers and self.partners >= tuning.min_partners
        return enough and self.inliers >= tuning.min_share * self.total


@dataclass(frozen=True)
class Correspondences:
    """Correspondences of one frame: image (K,), xy (K, 2), point (K, 3), partner image (K,)."""

    image: np.ndarray
    xy: np.ndarray
    xyz: np.ndarray
    partner: np.ndarray


def correspondences(images: Collection[int], verified: VerifiedMatches, seen: ImageObservations) -> Correspondences:
    """Matches of some images, one frame's, with points of the images in ``seen``."""
    image, xy, xyz, partner = [], [], [], []
    inside = np.isin(verified.pairs, sorted(images))
    for row in np.flatnonzero(inside.sum(axis=1) == 1):
        side = 0 if inside[row, 0] else 1
        own, other = int(verified.pairs[row, side]), int(verified.pairs[row, 1 - side])
        if other not in seen.point:
            continue
        matches = verified.matches[row]
        points = seen.point[other][matches[:, 1 - side]]
        for own_key, point in zip(matches[:, side], points):
            if point >= 0:
                image.append(own)
                xy.append(verified.xy[own][own_key])
                xyz.append(seen.xyz[int(point)])
                partner.append(other)
    return Correspondences(
        image=np.array(image, int),
        xy=np.array(xy).reshape(-1, 2),
        xyz=np.array(xyz).reshape(-1, 3),
        partner=np.array(partner, int),
    )


def resect(
    rows: Correspondences,
    cameras: Mapping[int, pycolmap.Camera],
    cam_from_rig: Mapping[int, np.ndarray],
    tuning: PlacementTuning,
) -> Resection | None:
    """The pose most correspondences agree with; ``cam_from_rig`` (model units) and cameras by scene index of images."""
    rows = _capped(rows, tuning.agreement.matches_a_pair)
    usable = np.isin(rows.image, [k for k in cam_from_rig if k in cameras])
    if usable.sum() < tuning.resection.min_inliers:
        return None
    images = sorted(set(rows.image[usable].tolist()))
    which = [images.index(k) for k in rows.image[usable]]
    options = pycolmap.RANSACOptions(
        max_error=tuning.resection.search_px, random_seed=0, max_num_trials=tuning.resection.trials
    )
    found = pycolmap.estimate_and_refine_generalized_absolute_pose(
        rows.xy[usable],
        rows.xyz[usable],
        which,
        [rigid3d(cam_from_rig[k]) for k in images],
        [cameras[k] for k in images],
        options,
    )
    if found is None:
        return None
    mask = np.asarray(found["inlier_mask"], bool)
    pose = transforms.invert(matrix(found["rig_from_world"]))
    good = rows.partner[usable][mask]
    seeing = set(np.array(which)[mask].tolist())
    return Resection(
        pose=pose,
        inliers=int(mask.sum()),
        total=int(usable.sum()),
        partners=len(set(good.tolist())),
        cameras=len(seeing),
    )


def _capped(rows: Correspondences, most: int) -> Correspondences:
    """No more than so many correspondences of a pair of images."""
    pair = rows.image.astype(np.int64) << 32 | rows.partner.astype(np.int64)
    keep = np.zeros(len(pair), bool)
    for value in np.unique(pair):
        of = np.flatnonzero(pair == value)
        keep[of[np.linspace(0, len(of) - 1, min(len(of), most)).astype(int)]] = True
    return Correspondences(image=rows.image[keep], xy=rows.xy[keep], xyz=rows.xyz[keep], partner=rows.partner[keep])
