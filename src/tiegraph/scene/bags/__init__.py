"""Recordings of ROS 1 and ROS 2 (bags), as far as a survey needs them; read by ``rosbags``, an extra.

A bag is named by its path, and some of what it holds by ``BAG:TOPIC`` (``topics``), wherever a file can be named. Only
messages of ROS's own packages are read. Their definitions have been the same in every release, so those that stand in
the bag, or are missing in it, do not matter. Messages come one after another (``bag``): a bag may be larger than the
memory. Positions are read in ``scene.gnss.navsat``, poses in ``scan.priors.trajectory``, pixels in
``scan.videos.bagfilms``, which asks which topics are cameras.

A message has two times: of its header, when it was measured, and of its receipt, later by what the way takes. The first
counts; where it is not set, the second.
"""
