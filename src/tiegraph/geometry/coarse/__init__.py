"""A cloud laid on another without a start: descriptors of the surface, matches, and what of them is consistent.

``shape`` thins a cloud, tells its normals and describes the neighbourhood of each point by the angles between normals
(Rusu, Blodow, Beetz 2009). Most matches of such descriptors are wrong. ``consistent`` finds those that are true by what
a rigid motion keeps, the distances between points and the angles between normals, without any random choice (second
order compatibility: Chen, Sun, Yang, Tao 2022); so the same clouds give the same result.

Arrays only: which motion is believed is for the engine that asks.
"""
