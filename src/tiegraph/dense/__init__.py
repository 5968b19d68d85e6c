"""Depth maps: partners, rectification, matching engines, consistency over views.

Two passes over the images: match each with its partners, then compare each depth map with those of its neighbours.
Another matcher is one more entry of ``engine.ENGINES``: ``ENGINES[name](reference, partners,
depth_range, settings, tuning) -> DepthMap``, or a ``PairMatcher`` of rectified images.

**Matcher ``tsgm``** (paper 004): a pyramid in ``tsgm``, and the kernels in the native module ``_sgm`` (C++17,
nanobind; ``native/sgm``). A kernel is one set of ``.inl`` files compiled once for each instruction set (plain,
SSE4.1, AVX2, AVX-512, NEON), chosen at run time. All arithmetic is in whole numbers, so every kernel and any number
of threads give the same bits; ``tests/dense/sgm_reference.py`` says which. In the ragged form, with a range of
disparities for each pixel, a pixel leaves its successors a message instead of its path costs: one unaligned load
bridges any two ranges. The dense form matches bands of a few rows together, each two pixels behind the one above, so
that path costs stay in the first-level cache; it makes its costs in both sweeps and stores one byte a disparity (half
the sum of four paths). The level with at most 256 disparities is matched over its full range, and pixels without an
answer on the coarser level get up to 254 disparities, because thin foreground structures that a coarser level loses
never come back. A level whose volumes would take more than 256 MB is matched in strips with 64 rows of overlap (0.2 %
of the pixels change, 6 in 100 000 by more than a pixel); the bound is in the receipt. Masked pixels are hardly
searched: sky is a hole on every coarser level. An install without a C++ compiler succeeds: scikit-build-core tries
again without the native part, the stage takes OpenCV's matcher (``sgbm``), and its receipt says so. On a GPU
(``cuda``, ``kernels/*.cu``) each of eight paths is walked by a group of lanes, and what it adds to the costs goes to
memory, a byte a disparity and path; one more kernel sums up in the order that gives the native module's rounding. The
strips are the same, since they show in the last bits; all of a level are matched in one launch.

``engine`` says how the rays of all partners are intersected, ``depth.check`` which points stand when depth maps are
compared. ``shot`` plans a single shot from the rig alone (paper 004: a cloud a station without any model; ``tiegraph
shots``).
``undistort`` hands depth maps over to COLMAP's ``stereo_fusion`` (``tiegraph export``).
"""
