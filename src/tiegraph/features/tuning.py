"""Constants of features, each with its unit, its meaning and the source of its value."""

from __future__ import annotations

from pydantic import Field

from tiegraph.settings import Section


class PreviewTuning(Section):
    """Low-resolution features and their matches (`preview.py`)."""

    contrast: float = Field(0.02, gt=0)
    """Least contrast of a feature, half of Lowe's: dark sections under bridges have little contrast."""
    cells: int = Field(8, gt=0)
    """Grid cells along the longest side, for the spreading."""
    min_used: float = Field(0.5, gt=0, le=1)
    """Share of a reduced pixel's area that the mask must leave for a feature there."""
    max_distance: float = Field(0.7, gt=0)
    """Between the unit descriptors of a match, as in COLMAP."""
    least_matches: int = Field(8, ge=5)
    """Least tentative matches or inliers of two previews: fewer are not worth a RANSAC, and count as none."""
    confidence: float = Field(0.99, gt=0, lt=1)
    """Confidence of the RANSAC to have met a sample without outliers."""
    trials: int = Field(200, gt=0)
    """Trials of the RANSAC, at most."""


class ContrastTuning(Section):
    """Images with little contrast (`sift.py`)."""

    enough: float = Field(10.0, ge=0)
    """Grey levels of local contrast that a tenth of an image has, or it is equalised: a sea floor has 3 to 9, an up
    camera below bridges 5 to 16, single bands 9 to 21, nine sets in daylight 12 and more; 0: never."""
    block: float = Field(0.02, gt=0, le=1)
    """Share of the longer side: the side of a block within which contrast is local."""
    limit: float = Field(4.0, gt=0)
    """CLAHE: largest amplification of the contrast of a tile, one of OpenCV's 8 x 8."""


class SiftTuning(Section):
    """Features at full resolution (`sift.py`)."""

    octave_layers: int = Field(3, gt=0)
    """Layers of the scale space: Lowe 2004, section 3.3; both extractors divide the contrast threshold by it."""
    edges: float = Field(12.0, gt=0)
    """Lowe's edge threshold: most that the two curvatures of a feature may differ, as a ratio. OpenCV's 10 leaves out a
    sixth of what COLMAP's extractor finds with its 10, found again as often as others; 15 takes more CPU time."""
    large_mpx: float = Field(4.5, gt=0)
    """Megapixels from which an image keeps as many features as it may. COLMAP's 8192 are 10 500 to
    14 000 with second orientations; on four sets of 6 to 16 megapixels 12 288 of ours had 0.73 to 0.94 of their
    inliers, 8192 had 0.47 to 0.74."""
    least_kept: float = Field(1 / 3, gt=0, le=1)
    """Share of that number for the smallest image: 4096 features of 1.5 megapixels and less."""
    enough_found: float = Field(0.75, gt=0)
    """Share of an image's largest number of features: with so many at its own resolution it is not doubled."""
    crowded_px: float = Field(180.0, ge=0)
    """Pixels that a feature takes where texture is densest (a bunch of bananas: 227, drones 259, facades 261): an image
    with too few for enough features is doubled at once."""
    support_sigmas: float = Field(3.0, ge=0)
    """Sigmas of a key point that must be free: where a building ends against a masked sky, the position of a blob is
    biased towards it. On canal such key points rotated the front camera against the rig by 0.01-0.02 deg; they are 5 %
    of all."""
    enough_free: int = Field(500, ge=0)
    """Least number of such; an image with fewer (an up camera, which sees mostly roof lines) keeps the others too."""
    network_px: int = Field(1600, gt=0)
    """Longer side of the image that a network sees: COLMAP's for ALIKED, which needs 2 GB a megapixel."""
    least_score: float = Field(0.2, ge=0, le=1)
    """Least score of a network's feature: COLMAP's, and ALIKED's own. 0.05 finds 1.7 times the true matches of a camera
    that looks up below a bridge, still fewer than SIFT; elsewhere not varied."""


class VerificationTuning(Section):
    """COLMAP's RANSAC over the matches of a pair (`matchblocks.py`).

    Both halve its time on facades, telephone photographs, two vehicles and a rendered boat, and change inliers by less
    than another seed does (benchmarks/README.md, *Matching*).
    """

    min_trials: int = Field(30, gt=0)
    """Least trials, of each geometry; COLMAP's 100 are more than pairs need of which nine matches in ten agree."""
    least_inlier_share: float = Field(0.4, gt=0, le=1)
    """Trials are enough to find a geometry that this share of the matches agrees with, in COLMAP a quarter: then a pair
    without overlap costs four times as much."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    contrast: ContrastTuning = Field(default_factory=ContrastTuning)
    """Images with little contrast."""
    preview: PreviewTuning = Field(default_factory=PreviewTuning)
    """Previews."""
    sift: SiftTuning = Field(default_factory=SiftTuning)
    """Full resolution."""
    verification: VerificationTuning = Field(default_factory=VerificationTuning)
    """Of matches at full resolution."""
