"""A LiDAR-SLAM reference: trajectory and map of a scanner, and where it stands on the camera rig (paper 001).

In the order of ``pipeline/lidar.py``: scans are read one after another (``scans``; forms of files in ``formats``);
kiss-icp makes a first trajectory (``odometry``); the scans are adjusted by the planes that they share, because points
matched with points hold the rings of a scanner with few of them on walls; the scans are gone through again
for the map. Then a run: place and clock of the LiDAR on the rig by the motions of both (``handeye``) and
by the points that both measured (``odometry.tie_by_points``). The constants of ``tuning`` are read from the file of
``--tuning``.
"""
