"""What the room offsets decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class ScoreMatrixTuning(Section):
    """Preview evidence on a lattice of frames (`scorematrix.py`)."""

    peak: float = Field(1.2, ge=0)
    """Times `min_matches`: what a patch of evidence must reach somewhere."""
    short_nodes: int = Field(8, ge=0)
    """Nodes of a short pass, whose lattice is most of what is previewed: its last node may take another's place."""
    kernel_cut_sigmas: float = Field(2.5, gt=0)
    """Where the kernel of the decision ends."""
    most_level: float = Field(0.8, ge=0, lt=1)
    """Of the way from the lowest to the highest mean: the highest level of unrelated frames that is taken off."""


class BackgroundTuning(Section):
    """What frames that share nothing reach (`background.py`)."""

    long_frames: int = Field(60, gt=2)
    """From which on most frames of a pass share nothing: evidence counts near its path only."""
    far_share: tuple[float, float] = (0.4, 0.6)
    """Of a pass: frames so far apart share nothing, also where its end is its beginning."""
    samples: int = Field(40, gt=0)
    """Far frame pairs that are previewed, for every two cameras."""
    enough: int = Field(12, gt=0)
    """Previews of two cameras that tell their own level; of fewer, that of all."""
    band: float = Field(0.15, ge=0, le=1)
    """Of the way from the level to the highest: what the frames at one distance from the path reach on average."""
    outstanding: float = Field(0.99, ge=0, le=1)
    """Share of the previews of far frames that a pair passes that is believed by itself."""


class ConstantTuning(Section):
    """One offset for each two cameras (`tiegraph.papers.meguro2024`)."""

    max_columns: int = Field(120, gt=0)
    """Frames of the other pass a sampled frame is compared with."""
    heading_frames: int = Field(3, gt=0)
    """Sampled frames that show the heading of one pass against the other first."""
    least_frames: int = Field(2, gt=0)
    """Sampled frames that must have been looked at near the best offset."""


class SurfaceTuning(Section):
    """Evidence between two passes, to be drawn, and the path through it (`surface.py`)."""

    ceiling: float = Field(6.0, gt=1)
    """Times `min_matches`: more matches are drawn alike; higher than the ceiling of the decision, to show peaks."""
    coarse: float = Field(0.15, ge=0, le=1)
    """Share of the nodes of the densest camera pair: one with fewer is left out of the rig's surface."""
    faint: float = Field(0.003, ge=0, le=1)
    """Share of the strongest camera pair below which one is not shown."""
    bend: float = Field(0.02, ge=0)
    """Price of a path moving one node aside, as a share of the highest evidence."""


class OffsetsTuning(Section):
    """Frame offsets within and between passes (`offsets.py`)."""

    ladder: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
    """Frame distances at which the reach of a camera is measured."""
    strides_a_reach: float = Field(5, gt=0)
    """Lattice strides in the frames over which a typical camera keeps seeing the same things."""
    strides_a_pass: int = Field(4, gt=0)
    """Lattice strides in a pass, at least."""
    max_stride: int = Field(16, gt=0)
    """Lattice stride, frames."""
    coarser_strides: int = Field(4, gt=0)
    """Strides in the longer pass, above which a lattice that took too many previews is tried again with a stride twice
    as long."""
    window_nodes: int = Field(10, gt=0)
    """Seeds reach this far from the path, in lattice nodes."""
    least_window_nodes: int = Field(3, gt=0)
    """The same on lattices that were made coarser."""
    window_margin_nodes: int = Field(2, ge=0)
    """So many nodes beyond the window evidence still counts."""
    flood_excess: float = Field(1.1, gt=0)
    """The lattice grows from nodes this much above `min_matches`: noise alone must not spread."""
    min_budget: int = Field(6000, ge=0)
    """Previews that are always affordable (less than a minute on one core)."""
    coarse_nodes: int = Field(24, gt=0)
    """Lattice nodes a side of the first look between two passes, at most ..."""
    least_coarse_nodes: int = Field(4, gt=0)
    """... and at least."""
    coarse_share: float = Field(0.5, gt=0, le=1)
    """Of the budget: what the first look may take."""
    scores: ScoreMatrixTuning = Field(default_factory=ScoreMatrixTuning)
    """Evidence on a lattice."""
    background: BackgroundTuning = Field(default_factory=BackgroundTuning)
    """What frames that share nothing reach."""
    constant: ConstantTuning = Field(default_factory=ConstantTuning)
    """One offset for each two cameras."""
    surface: SurfaceTuning = Field(default_factory=SurfaceTuning)
    """Evidence to be drawn, and the path through it."""
