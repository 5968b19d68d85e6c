"""Rolling shutters: the rows of an image are read one after another while the camera moves on.

A row is seen ``readout`` x (row / height - 1/2) later than the middle one, whose time the pose is of (``motion``). The
readout is one number, one more unknown of the normal equations with poses, points and all lenses eliminated.

Distortion that a lens model leaves out looks alike where a vehicle drives straight on (KITTI, a global shutter: 3 ms
with a sigma of 0.3), so what is too short for a real shutter or explains next to nothing is not believed. What is not
seen here: motion faster than the frames of a pass, and images that were turned on their side (rows are then columns).
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment import lens
from tiegraph.sfm.adjustment.adjust import free_cameras
from tiegraph.sfm.adjustment.jacobians import Layout
from tiegraph.sfm.covariance import Linearised
from tiegraph.sfm.motion import Motion
from tiegraph.sfm.systematic.mountings import of_time
from tiegraph.sfm.tuning import ShutterTuning, Tuning


@dataclass(frozen=True)
class Readout:
    """Seconds from the first row of an image to the last (negative: from the last), and their sigma; ``gain``: by which
    share it lowers the robust cost; ``step``: seconds that may be gone at once, for far from its minimum the robust
    cost is less curved than there; ``gap_s``: between the images whose poses tell the motion, median."""

    seconds: float
    sigma: float
    gain: float
    step: float
    gap_s: float

    def there(self, tuning: ShutterTuning) -> bool:
        """Whether it is a shutter's and not noise or a lens."""
        least, most = tuning.range_s
        sure = abs(self.seconds) > tuning.sigmas * self.sigma and self.gain > tuning.told_gain
        return sure and least <= abs(self.seconds) <= most

    def clear(self, tuning: ShutterTuning) -> bool:
        """Whether it is used unasked."""
        return self.gain > tuning.used_gain and self.gap_s <= tuning.used_gap_s

    def __str__(self) -> str:
        """In milliseconds."""
        return f"{1000 * self.seconds:.1f} ms (sigma {1000 * self.sigma:.1f})"


def rows_in_time(model: pycolmap.Reconstruction, scene: Scene, tuning: ShutterTuning) -> Motion | None:
    """The ways of a model's images; None where frames have no times, where nothing moves on, and of views, whose rows
    are not those of the camera."""
    if any(s.source is not None and s.source.rendered for s in scene.all_sensors):
        return None
    motion = Motion(model, scene, tuning.max_gap_s)
    return motion if motion.timed and len(motion.gaps) else None


def find_readout(
    model: pycolmap.Reconstruction, scene: Scene, fixed_rigs: Collection[int], tuning: Tuning
) -> Readout | None:
    """The readout of all cameras of a model by its residuals; None without times, motion or redundancy.

    All lenses are unknowns, calibrated ones too.
    """
    motion = rows_in_time(model, scene, tuning.shutter)
    if motion is None:
        return None
    free = free_cameras(model, tuning.adjust)
    loose = lens.extended(model, lens.extensible(model, free, ("RADIAL", *lens.UNDISTORTED)))
    layout = Layout(loose, free, set(model.rigs) - set(fixed_rigs))
    try:
        found = Linearised(loose, layout, {}, tuning, tuning.shutter.most_points)
        seen = found.weighed.seen
        ids, number = np.unique(seen.camera, return_inverse=True)
        height = np.array([loose.camera(k).height for k in ids.tolist()])[number]
        late = np.repeat(seen.xy[:, 1] / height - 0.5, 2)
        told = found.weighed.score((sparse.diags(late) @ of_time(seen, motion, np.arange(len(seen.xy)))).tocsr())
    except (ValueError, RuntimeError, np.linalg.LinAlgError):
        return None
    information = float(told.information[0, 0])
    if information <= 0:
        return None
    square = np.sum(found.weighed.seen.residual.reshape(-1, 2) ** 2, axis=1)
    cost = tuning.adjust.robust_px**2 * float(np.sum(np.log1p(square / tuning.adjust.robust_px**2)))
    score = float(told.score[0])
    first, second = found.weights
    return Readout(
        seconds=-score / information,
        step=-score / information * float(second.sum() / first.sum()),
        sigma=float(np.sqrt(max(told.noise[0, 0], 0.0))) / information,
        gain=score**2 / information / max(cost, 1e-12),
        gap_s=float(np.median(motion.gaps)),
    )
