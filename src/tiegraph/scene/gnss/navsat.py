"""Positions of a ROS bag: sensor_msgs/NavSatFix, whose height is above the ellipsoid and whose covariance is that of
east, north and up."""

from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.bags import open_bag, split_topics, stamp_ns
from tiegraph.scene.gnss.fixes import Fixes

KINDS = ("sensor_msgs/NavSatFix",)
_NO_FIX = -1  # NavSatStatus.STATUS_NO_FIX


def read_navsat(path: Path) -> Fixes:
    """The fixes of a bag's only topic of such, or of the one behind the path; a line is the number of a message.

    Raises InputError for several topics, none, a damaged bag, and where no message has a fix.
    """
    bag_path, asked = split_topics(path)
    rows, lines, lost = [], [], 0
    with open_bag(bag_path) as bag:
        topic = bag.only(KINDS, asked)
        for number, (fix, received_ns) in enumerate(bag.messages(topic), start=1):
            if fix.status.status == _NO_FIX:
                lost += 1
                continue
            unknown = fix.position_covariance_type == 0  # COVARIANCE_TYPE_UNKNOWN
            variance = np.full(3, np.nan) if unknown else np.asarray(fix.position_covariance, float)[[0, 4, 8]]
            place = fix.latitude, fix.longitude, fix.altitude
            rows.append((1e-9 * stamp_ns(fix.header, received_ns), *place, *variance))
            lines.append(number)
    if not rows:
        raise InputError(f"{path}: none of the messages of {topic} has a fix (status -1): give another source")
    table = np.array(rows, float)
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(table[:, 4:])
    notes = [f"{bag_path.name}: positions of {topic}"]
    if lost:
        notes[0] += f"; {lost} of them without a fix are left out"
    return Fixes(
        path=bag_path, line=lines, lat_lon_height=table[:, 1:4], time_s=table[:, 0], sigma_m=sigma, notes=notes
    )
