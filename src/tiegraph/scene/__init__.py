"""The common data types of all engines, and their file formats.

Conventions, stated once:

* right-handed frames; a camera looks along +Z, x right, y down (COLMAP, OpenCV);
* pixel (0, 0) is the *corner* of the top-left pixel (COLMAP): OpenCV key points are moved by +0.5;
* transforms are named ``target_from_source``, float64 (4, 4), NaN = unknown;
* names carry units: ``_m _px _deg _s``; quaternions exist only inside file readers, ``_wxyz`` or ``_xyzw``;
* image names are POSIX paths below ``images/``;
* the world is metric, east-north-up, float64, with ONE recorded shift for every product (``Origin``), or the model's
  own frame and scale when nothing fixes them.
"""
