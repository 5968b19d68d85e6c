"""Do poses that were made elsewhere agree with a model that the images made?

A model to start from may be bent, turned in one half, or of another survey. What of it agrees is found by its largest
part: the turn between the two worlds that most images share, then the similarity of their places. An image disagrees
that is turned against that part by more than the tuning allows, or stands off by more than a share of the distance to
what it sees. World and unit of both are free, so that a model that is only of another size agrees.
"""

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry.align import l1_mean_rotation, robust_umeyama
from tiegraph.geometry.transforms import angle_deg
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning import StartCheckTuning

_SAMPLE = 300  # images whose turns are tried: bounds the time
_NAMED = 3  # images that a sentence names


@dataclass(frozen=True)
class StartCheck:
    """Of N images: which have both poses, ``turned_deg`` (N,) against the part that agrees, ``off`` (N,) distance from
    where that part puts them over the distance to what is seen (NaN = not told), ``bad`` (N,) those that disagree."""

    both: np.ndarray
    turned_deg: np.ndarray
    off: np.ndarray
    bad: np.ndarray

    @property
    def share(self) -> float:
        """Of the images with both poses, those that disagree."""
        return float(self.bad.sum()) / max(int(self.both.sum()), 1)


def check_start(given: np.ndarray, made: np.ndarray, reach: float, tuning: StartCheckTuning) -> StartCheck:
    """Poses ``given`` (N, 4, 4) against those of a model ``made`` (N, 4, 4), world_from_camera, NaN = none; ``reach``:
    usual distance of the model's cameras to what they see, its units."""
    both = np.all(np.isfinite(given[:, :3]) & np.isfinite(made[:, :3]), axis=(1, 2))
    rows = np.flatnonzero(both)
    turned, off = np.full(len(given), np.nan), np.full(len(given), np.nan)
    if len(rows) < tuning.least:
        return StartCheck(both=both, turned_deg=turned, off=off, bad=np.zeros(len(given), bool))
    between = made[rows, :3, :3] @ np.swapaxes(given[rows, :3, :3], 1, 2)
    tried = between[:: max(1, len(rows) // _SAMPLE)]
    votes = [int(np.sum(angle_deg(between, one) <= tuning.turn_deg)) for one in tried]
    first = angle_deg(between, tried[int(np.argmax(votes))]) <= tuning.turn_deg
    turned[rows] = angle_deg(between, l1_mean_rotation(between[first]))
    alike = rows[turned[rows] <= tuning.turn_deg]
    if len(alike) >= tuning.least:
        places = given[alike, :3, 3], made[alike, :3, 3]
        fit, _ = robust_umeyama(*places, sigma=tuning.off / 3 * reach)  # which takes three sigmas
        off[rows] = np.linalg.norm(fit(given[rows, :3, 3]) - made[rows, :3, 3], axis=1) / reach
    bad = both & ~((turned <= tuning.turn_deg) & (off <= tuning.off))
    return StartCheck(both=both, turned_deg=turned, off=off, bad=bad)


def told(found: StartCheck, scene: Scene, tuning: StartCheckTuning) -> tuple[str, bool]:
    """The agreement of a start model in a sentence, and whether it contradicts the images."""
    count, bad = int(found.both.sum()), np.flatnonzero(found.bad)
    if count < tuning.least:
        return f"start model: {count} of its images are in the model, too few to test it", False
    good = found.both & ~found.bad
    agree = (
        f"{good.sum()} of {count} images agree with it, to {np.median(found.turned_deg[good]):.2g} deg and "
        f"{np.median(found.off[good]):.2g} of the distance to what is seen (median)"
        if good.any()
        else f"none of {count} images agrees with it"
    )
    if not len(bad):
        return f"start model: {agree}", False
    names = ", ".join(scene.names[k] for k in bad[:_NAMED]) + (" ..." if len(bad) > _NAMED else "")
    turned, off = np.median(found.turned_deg[bad]), found.off[found.bad & np.isfinite(found.off)]
    where = f" and {np.median(off):.2g} of that distance off" if len(off) else ""
    text = f"{len(bad)} images do not: turned against the others by {turned:.2g} deg{where} (median), such as {names}"
    why = (
        "is it of another survey, or are images named otherwise?" if found.share > tuning.most else "is it bent there?"
    )
    contradicts = found.share > tuning.share
    ending = f"; its poses chose pairs only: {why}" if contradicts else ""
    return f"start model and images: {agree}; {text}{ending}", contradicts
