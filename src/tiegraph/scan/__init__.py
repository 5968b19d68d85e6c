"""The scan stage: makes a Scene from a folder of images, videos or panoramas and the files that belong to it.

User inputs are checked before anything is made or stored (``pipeline.inputs``, ``project.inputs``), the rest
here. Every file of the user passes ``scene.atomic`` before it is opened (pipes and devices never end), and a folder
is searched once whatever links lead back to it. COLMAP models are read by ``scene.colmapmodel.read_model``, which
compares the records with the size of the file first. Images get names of ours where they are listed
(``scene.names``): no native library sees a name that is not UTF-8. A table's header says which column is which; the
order of a quaternion is that of the format or told by the path, never guessed (``scene.posefile``).

A position is far from the rest if it lies behind a gap in the sorted distances (``geometry.geodesy.far_from_rest``).
A CRS whose lengths are off by more than 1 % at the positions is refused.

Videos become pictures first (``video``), with the time and place of each frame as EXIF (``videotime``,
``telemetry``), so that everything for photographs applies to them; so does an image topic of a ROS bag (``bagfilms``).
Videos of one rig are distinguished by the same reading of folders as their pictures and aligned by their motion
(``videooffset``). PyAV's wheels bundle x264 and x265 (GPL); OpenCV's FFmpeg is LGPL, and gives stamps.
"""
