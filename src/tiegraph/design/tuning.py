"""Constants of design, each with its unit, its meaning and the source of its value.

Paper 002's numbers define the method fuse2014 and are in ``tiegraph.papers.fuse2014``.
"""

from pydantic import Field

from tiegraph.settings import Section


class MatchPredictionTuning(Section):
    """Matches by the points of the coarse model that two images should both see, and by the overlap, for pairs that
    were never previewed (`matchprediction.py`)."""

    angles_deg: tuple[float, ...] = Field((3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0), min_length=1)
    """Tried angles between the rays for the law: where probabilities fall to 1 / e."""
    octaves: tuple[float, ...] = Field((0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 3.0), min_length=1)
    """Tried ratios of the distances for the law, octaves: where probabilities fall to 1 / e."""
    cells: tuple[int, int] = (40, 30)
    """Cells, in angle and in octaves, of the table the law is fitted to: half of the smallest tried values wide; the
    last one contains all larger values."""
    sample: int = Field(3000, gt=0)
    """Previewed pairs for fitting the law: enough for its four numbers."""
    least_previewed: int = Field(30, gt=0)
    """Previewed pairs with common points below which the law is the usual one."""
    even_matches: float = Field(7.5, gt=0)
    """Preview matches with which every second pair is verified: full images find twice as many, 15 are needed."""


class NetTuning(Section):
    """The network as a one-dimensional adjustment of its tracks (`tracks.py`)."""

    wide_images: int = Field(300, gt=0)
    """Images of a track: a larger one, made by wrong matches, counts as one for each so many images in a row.
    COLMAP's mapper takes none of more than 100."""
    draws: int = Field(48, gt=0)
    """Random ones of a large net: a resistance is then known to sqrt(2 / 48) = 20 % (Spielman and Srivastava 2008); of
    its variance so many long waves are computed one by one."""
    least_share: float = Field(0.01, ge=0, le=1)
    """Share of the expected tracks of an unseen pair that always counts: no chosen pair ties nothing."""
    known: float = Field(0.05, ge=0)
    """Worth of a match whose track is joined already: another observation against outliers."""
    power: float = Field(2.5, ge=1)
    """Power from the ratio of predicted sigmas to that of adjusted ones (`Predictor.loss`)."""
    power_rig: float = Field(8.0, ge=1)
    """The same for frames of a known rig, whose net is stiffer than their adjustment: 2 on KITTI, 11 on PandaSet, 16 on
    canal_demo, where rig and intrinsics are adjusted too (design_real.py); too large costs only pairs."""


class SurfaceTuning(Section):
    """The map of the surface (`coverage.py`)."""

    cell: float = Field(0.1, gt=0)
    """Side of a cell, in median distances from image to point: an image of 60 degrees shows some ten by ten."""
    farthest: float = Field(4.0, gt=1)
    """Median distances beyond which a point is background, outside the survey."""
    least_points: int = Field(3, gt=0)
    """Points of a cell: fewer are as often errors of the model."""
    image_px: float = Field(0.5, gt=0)
    """Sigma of an image coordinate, full resolution, for a point's expected sigma: SIFT."""
    least_images: int = Field(3, gt=1)
    """Images of a cell: the third is the first that can contradict two (`dense` asks for as many by default)."""
    least_angle_deg: float = Field(4.0, gt=0)
    """Least angle between the outermost rays of a cell: below, depth is ten times as bad as lateral coordinates."""
    worse: float = Field(3.0, gt=1)
    """Factor of the survey's median sigma above which a cell is imprecise."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    few_points: int = Field(230, gt=0)
    """Tracks of previews that a group of frames shares with all others, below which `coverage.py` names it. The three
    frames that kerry_park misplaces share 84 to 183 in seven runs; the weakest frames of P8, canal_demo,
    canal, KITTI, PandaSet and a rendered room 296 and more."""
    few_points_alone: int = Field(50, gt=0)
    """The same of a single frame, which needs no more to be resected: kerry_park's blurred frame, off by up to 27 %,
    shares 0 to 36. Views of an object with little texture (40 of dino) share 63 and more."""
    start_share: float = Field(0.5, ge=0, le=1)
    """Share of a budget of pairs for the pairs that any design keeps."""
    few_pairs: float = Field(15.0, ge=0)
    """Candidates an image of loose photographs up to which all are matched: less than a tenth of the run (25 images
    with 300 pairs), while 79 images with 2848 pairs took a quarter longer with the same errors."""
    match_prediction: MatchPredictionTuning = Field(default_factory=MatchPredictionTuning)
    """Expected matches by the coarse model, or by overlap."""
    net: NetTuning = Field(default_factory=NetTuning)
    """The net of resistances and its tracks."""
    wanted: float = Field(3.0, gt=0)
    """Pairs across every cut that are expected to be verified, of those that any design keeps."""
    sure: float = Field(0.95, ge=0, le=1)
    """Probability from which a pair counts as sure."""
    growth: float = Field(0.05, gt=0)
    """Growth of the network in a round of the choice: 0.03, 0.05 and 0.1 choose 1373, 1431 and 1467 pairs of the
    example survey and 125, 126 and 126 of a rendered boat; a smaller one takes more rounds."""
    growth_look: float = Field(0.20, ge=0)
    """Growth of the network between two evaluations of its accuracy, which cost more than a round."""
    surface: SurfaceTuning = Field(default_factory=SurfaceTuning)
    """The map of the surface."""
