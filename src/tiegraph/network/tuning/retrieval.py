"""Constants of retrieval, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class VocabularyTuning(Section):
    """Visual words (`vocabulary.py`)."""

    vocabularies: int = Field(2, gt=0)
    """Number of vocabularies, with different starts; two find 0.01 to 0.02 more than one."""
    training: int = Field(200_000, gt=0)
    """Descriptors from which a vocabulary is learnt, at most: 100 MB."""
    rounds: int = Field(8, ge=0)
    """Rounds of k-means."""


class LooseTuning(Section):
    """Loose photographs (`loose.py`).

    Kept: count / min_matches, between the floor and the ceiling of all counts, plus `support` times the cosine of the
    two images' ties reaches `enough`. Measured: recall 0.82 at precision 0.74 (rendered), 0.87 at 0.96 (photographs);
    the count alone at equal precision 0.79 and 0.84.
    """

    all_limit: int = Field(100, ge=0)
    """Images up to which all pairs are previewed: 4950 previews, half a minute."""
    best: int = Field(5, ge=0)
    """Pairs of an image that are kept whatever their count, so that no image is without pairs."""
    start: int = Field(8, gt=0)
    """Look-alikes with which an image starts: nine of ten share something."""
    by_name: int = Field(2, ge=0)
    """Next photographs by name with which an image starts: a camera numbers its pictures."""
    hit_rate: float = Field(0.15, ge=0, le=1)
    """A round in which a smaller share of the previews ties is the last."""
    few_ties: int = Field(4, ge=0)
    """Ties of an image below which it goes further down its list of look-alikes."""
    support: float = Field(3.0, ge=0)
    """Weight of the cosine between two images' ties relative to their count in units of `min_matches`."""
    enough: float = Field(2.0, ge=0)
    """Sum of count and weighted cosine from which a pair is kept."""


class LoopSearchTuning(Section):
    """Loops of passes (`timeline.py`, `retrieval.py`)."""

    ladder: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)
    """Frame distances at which similarity along a pass is measured."""
    strides_a_reach: int = Field(3, gt=0)
    """Sampled frames within a reach."""
    look_alikes: int = Field(4, gt=0)
    """Far images with which each sampled image is previewed."""
    patch: int = Field(10, ge=0)
    """Adjacent confirmed pairs that are needed to accept any of them. Simulated, four seeds of 300 frames: false
    patches reach 9 if one unrelated preview in five ties, 12 if three in ten do. On ``canal`` it costs two patches of
    6 and 9. In long surveys the whole rig must confirm them too (`retrieval.py`): there repeated walls make patches
    of any size."""
    previews_an_image: int = Field(16, ge=0)
    """Previews per sampled image, at most, for the search for loops."""
    speaks: float = Field(0.4, ge=0, le=1)
    """Level that a camera must reach at a loop, as a share of the range from the noise floor to the highest."""
    most_cameras: float = Field(0.6, ge=0, le=1)
    """Share of a rig's cameras that must reach it. Simulated, 2004 images: false loops 0.17 to 0.5, true ones 0.83 to
    1."""


class CopiesTuning(Section):
    """Passes that hold the same pictures (`offsets.py`)."""

    found_again: float = Field(0.55, ge=0, le=1)
    """Share of the features found again in a copy; measured: JPEG quality 60 .. 95: 0.59 .. 0.9, next frame 0.5."""
    strong: float = Field(3.0, gt=0)
    """Factor on `min_matches` from which a pair is tested for that."""


class RetrievalTuning(Section):
    """Retrieval of look-alikes."""

    sure_alike: float = Field(1.2, gt=0)
    """Factor on `min_matches`: a single preview of two similar images must be surer than an average over neighbouring
    frames, but its neighbours, in time or in the graph of ties, are tested before it is kept."""
    vocabulary: VocabularyTuning = Field(default_factory=VocabularyTuning)
    """Visual words."""
    loose: LooseTuning = Field(default_factory=LooseTuning)
    """Loose photographs."""
    loops: LoopSearchTuning = Field(default_factory=LoopSearchTuning)
    """Loops of passes."""
    copies: CopiesTuning = Field(default_factory=CopiesTuning)
    """The same pictures twice."""
