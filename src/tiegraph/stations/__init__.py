"""Clouds of single shots without poses put into one frame (paper 004, "object space methods for the registration").

``pairs`` thins each cloud and lays two on each other: what of their shapes is consistent gives starts
(``geometry.coarse``), small_gicp (Koide 2024; GICP: Segal, Haehnel, Thrun 2009) goes on from there, coarse to fine, and
the result is judged by overlap, residual and by how well the surfaces hold it. Surfaces that look alike deceive single
pairs, so the pairs are then judged together: ``loops`` leaves out those that loops of three contradict, and
distributes what remains of the loops' errors by the information of each pair. ``joined`` goes through all of it,
tries pairs again that the poses say overlap, and tells how far points of one cloud lie from the surfaces of
the others, by their distance from the station (paper 004, table 1).

Nothing is believed that could be otherwise: surfaces that slide (a plane, a sphere), pairs that fit as well in another
place, and clouds that nothing joins are refused with a reason.
"""
