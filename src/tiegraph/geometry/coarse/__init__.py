"""A cloud laid on another without a start: descriptors of the surface, matches, and what of them is consistent.

``shape`` thins a cloud, tells its normals and describes the neighbourhood of each point by the angles between normals
(Rusu, Blodow, Beetz 2009). Most matches of such descriptors are wrong. ``consistent`` finds those that are true by what
a rigid motion keeps, the distances between points and the angles between normals, without any random choice (second
order compatibility: Chen, Sun, Yang, Tao 2022); so the same clouds give the same result.

Arrays only: which motion is believed is for the engine that asks.
"""

from pydantic import Field

from tiegraph.settings import Section


class CoarseTuning(Section):
    """A cloud laid on another without a start. Lengths are in sides of the voxels that thin the clouds."""

    points: int = Field(2500, ge=100)
    """Of a thinned cloud, about: the consistency of matches costs the square of their number."""
    normal_neighbours: int = Field(16, ge=3)
    """Points that tell a normal."""
    radius: float = Field(5.0, gt=1)
    """Of the neighbourhood that is described: 5 voxels, as usual for FPFH."""
    neighbours: int = Field(64, ge=8)
    """Of a neighbourhood, at most: a surface has 80 voxels in that radius."""
    nearest: int = Field(2, ge=1)
    """Most alike points of the other cloud that a point is matched with."""
    matches: int = Field(1500, ge=10)
    """That are asked for consistency, the most alike first: 2 million pairs of matches."""
    play: float = Field(1.5, gt=0)
    """By which the distances of two points in both clouds may differ: half a voxel of error at each of four ends."""
    least_apart: float = Field(4.0, gt=0)
    """Two matches nearer than this agree in any case, and say nothing of each other."""
    normal_play_deg: float = Field(25.0, gt=0, lt=90)
    """By which the angles between two normals may differ: a normal of 16 noisy points is known to 10 degrees."""
    seeds: int = Field(100, ge=1)
    """Matches whose companions are tried for a motion: those that most others bear out."""
    companions: int = Field(30, ge=3)
    """Of a seed, by the number of matches that bear out both."""
    least_matches: int = Field(6, ge=3)
    """Consistent matches, for a motion to be told at all."""
    hypotheses: int = Field(6, ge=1)
    """Motions told, the one that most matches agree with first."""
    apart: float = Field(4.0, gt=0)
    """Two motions that move no point of the cloud further apart than this are one."""
