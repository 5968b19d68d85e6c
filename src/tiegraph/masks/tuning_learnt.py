"""Constants of the learnt masks, from matches to the line of water; the platform is in `tuning.py`."""

from typing import Annotated

from pydantic import Field

from tiegraph.settings import Section

_Count = Annotated[int, Field(gt=0)]


class MatchabilityTuning(Section):
    """Matches in neighbouring frames, and their distance (`matchability.py`)."""

    most_pairs: int = Field(36, gt=0)
    """Pairs of neighbouring frames, of all cameras together, for learning which areas match."""
    match_px: int = Field(400, gt=0)
    """Longer side at which frames are matched."""
    most_features: int = Field(800, gt=0)
    """Of one frame."""
    contrast: float = Field(0.02, ge=0)
    """Threshold of SIFT: half of OpenCV's."""
    ratio: float = Field(0.75, gt=0, le=1)
    """Ratio of the best and second best distance."""
    min_inliers: int = Field(20, gt=0)
    """With fewer matches the two frames show different scenes, and neither is used."""
    epipolar_px: float = Field(1.0, gt=0)
    """Tolerance of a match from its epipolar line."""
    around: int = Field(3, gt=1)
    """Neighbouring matches that predict the position of a feature without a match."""
    focals: tuple[float, ...] = Field((0.9, 1.4), min_length=1)
    """Focal lengths that are tried, of the longer side: no lens is known yet."""


class ProofTuning(Section):
    """Tests of a class before anything is masked (`proof.py`)."""

    min_moving: float = Field(0.1, ge=0, le=1)
    """Share of the pairs of frames that must verify a motion before fixed parts are a platform."""
    near: float = Field(0.33, ge=0)
    """Share of the parallax at the scene's median depth: with more it is not sky."""
    refuted: float = Field(0.5, ge=0, le=1)
    """Share of near matches in a sky from which it is none."""
    least_matches: int = Field(3, gt=0)
    """Least matches in a class of all cameras for a decision."""
    inner_px: int = Field(21, gt=0)
    """Side of the square by which the edge of a sky is left out, at `frames.look_px`: it is that of trees and roofs,
    whose key points reach into it. With 7 of them the true skies of KITTI, PandaSet and kerry_park were refuted."""
    dense: float = Field(0.2, ge=0)
    """Share of the matches that an equal area of the images has: fewer are wires, lamps and tops of trees in a true sky
    (0.07 on PandaSet, 0.01 on kerry_park; where forest was taken for it, uav_bands, 0.32 and more)."""


class AppearanceTuning(Section):
    """The table over colour, brightness and texture (`classification.py`), at `frames.look_px`."""

    light_bins: int = Field(16, gt=0, le=256)
    """Bins of L."""
    colour_bins: int = Field(12, gt=0)
    """Bins of a and b each, about neutral."""
    texture_edges_grey: tuple[float, ...] = (0.8, 2.0, 4.5, 10.0)
    """Standard deviations of L between the bins of texture."""
    texture_px: int = Field(5, gt=0)
    """Side of the square over which this deviation is taken."""
    floor: float = Field(1e-5, gt=0)
    """Probability of a bin no seed ever fell into."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Bins of L, a, b and texture."""
        return self.light_bins, self.colour_bins, self.colour_bins, len(self.texture_edges_grey) + 1

    @property
    def bins(self) -> int:
        """Bins of the whole table."""
        light, a, b, texture = self.shape
        return light * a * b * texture


class SkylineTuning(Section):
    """The sky of one image by its border, or above a camera that looks up (`skyline.py`)."""

    border_px: int = Field(160, gt=0)
    """Longer side at which the border is searched: it gives seeds, not masks."""
    min_share: float = Field(0.02, ge=0, le=1)
    """Least share of the image that is sky ..."""
    rim_px: int = Field(3, gt=0)
    """Side of the square by which an accepted sky, and each calm area above an upward camera, loses its rim."""
    inner_px: int = Field(5, gt=0)
    """Side of the square by which it is shrunk before its texture is measured."""
    up_window_px: int = Field(5, gt=0)
    """Side of the square over which this deviation is taken."""


class LabelTuning(Section):
    """Seeds of sky, water and scene in single images, and whether a sky lies above what is not sky (`learnt.py`), at
    `frames.look_px`."""

    images: int = Field(40, gt=0)
    """Images, of all cameras together, from which appearance is learnt."""
    least_images: int = Field(2, gt=0)
    """Images of each camera, however many there are."""
    matched_sky: float = Field(0.25, ge=0)
    """Matched features on a sky, as a share of those on an equal area of the image: with more it is none."""
    rim_px: int = Field(5, gt=0)
    """Side of the square by which a sky is shrunk before its matched features are counted."""
    lower: float = Field(0.15, ge=0, le=1)
    """Share of the height, below all known sky: from there on is the ground ..."""
    wide: float = Field(0.12, ge=0, le=1)
    """Share of the image's width: narrower pieces of sky are no seeds."""
    agreed: float = Field(0.05, ge=0, le=1)
    """Share of the height: images whose lowest sky differs by less agree on the horizon."""
    places: tuple[_Count, _Count] = (12, 16)
    """Rows and columns of the map of places."""
    place_seeds: float = Field(0.5, gt=0)
    """Prior weight in images: as many for sky as for none at each place."""
    place_clip: float = Field(1.5, ge=0)
    """Limit of a place's log ratio."""
    min_down: float = Field(0.25, ge=-1, le=1)
    """Share of the length of all edges that faces down more than up: 0.4 and more for skies, also behind trees; 0.15
    and less of false ones, from the air, on facades and sand (benchmarks/masks/above.py)."""
    reach_px: int = Field(25, gt=0)
    """Side of the square over which the blur carries an edge: so near to what is not told, it is not its own."""


class RegionsTuning(Section):
    """Regions without an edge inside (`classification.py`), at `frames.look_px`."""

    edge_grey: float = Field(4.0, gt=0)
    """Grey levels a pixel: skylines are stronger, most clouds are not."""
    smooth_sigma_px: float = Field(0.7, gt=0)
    """Blur before this edge is searched."""
    min_share: float = Field(0.001, ge=0, le=1)
    """Share of the image: smaller regions do not decide about their pixels."""
    clip: float = Field(3.0, gt=0)
    """Limit of one pixel's log ratio for its region."""


class ClassificationTuning(Section):
    """Classification of an image by the learnt table (`classification.py`), at `frames.look_px` except the edge of the
    sky."""

    smooth_px: int = Field(5, gt=0)
    """Side of the square over which the log ratio of sky is averaged."""
    sky_credit: float = 1.0
    """Log ratio from which a place is sky."""
    sky_margin: float = Field(0.1, ge=0)
    """Of the height: so far below the lowest certain sky there may be some."""
    open_px: int = Field(3, gt=0)
    """Side of the square in which sky and burnt-out areas are opened: thinner parts are removed."""
    small: float = Field(0.002, ge=0, le=1)
    """Share of the image: smaller pieces of sky or holes in it are removed."""
    grow_window_px: int = Field(11, gt=0)
    """... side of the square over which its own brightness is taken there ..."""
    ring_px: int = Field(5, gt=0)
    """Side of the square by which a burnt-out area is grown to its surroundings."""
    edge_band_px: int = Field(9, gt=0)
    """Side of the square round its edge in which the edge of the sky is searched by the brightness."""
    edge_around_px: int = Field(10, ge=0)
    """To each side of a pixel: what its edge is learnt from."""


class WaterTuning(Section):
    """Where features never match, and the line below which everything is water (`water.py`)."""

    grid: tuple[_Count, _Count] = (60, 80)
    """Rows and columns of the map of matches of a camera."""
    reach_cells: float = Field(1.5, gt=0)
    """Sigma of this map."""
    water_rate: float = Field(0.02, gt=0, lt=1)
    """Share of features found again in the next frame: 0.01 .. 0.03 on water (rendered canal) ..."""
    min_scene_rate: float = Field(0.025, gt=0, lt=1)
    """... on the scene 0.24 .. 0.38 there, 0.1 .. 0.25 on streets (PandaSet, KITTI); less at the sides, where the scene
    leaves the image: at least this ..."""
    max_scene_rate: float = Field(0.25, gt=0, lt=1)
    """... and at most this."""
    min_area: float = Field(0.02, ge=0, le=1)
    """Share of the image: a smaller zone is none."""
    highest: float = Field(0.25, ge=0, le=1)
    """Share of the height: a zone that reaches above it is no water seen from above."""
    zone_says: float = 8.0
    """Log of P(features | water) / P(features | scene) from which a camera has a zone."""
    least_cameras: int = Field(3, gt=0)
    """Level cameras needed before water is accepted without being asked for. A road ahead does not match either
    when the car is fast (KITTI, CamVid), so cameras that look one way only prove nothing; to the side a road
    matches."""
    least_share: float = Field(0.6, ge=0, le=1)
    """Share of them that must have a zone then ..."""
    least_says: float = 120.0
    """... and the least sum of these zones' log ratios."""
    prior_clip: float = Field(1.0, ge=0)
    """Limit of a place's log ratio."""
    block_px: tuple[_Count, _Count] = (4, 2)
    """Width and height of the blocks on which the line is found, at `frames.look_px`."""
    max_credit: float = Field(3.0, gt=0)
    """Limit of one pixel's log ratio for the line."""
