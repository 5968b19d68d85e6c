"""Pictures of ROS's messages, sensor_msgs/Image and sensor_msgs/CompressedImage, as BGR of 8 bits."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

KINDS = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")
# Encoding (sensor_msgs/image_encodings.hpp): bytes a pixel, and OpenCV's conversion to BGR.
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8uc1": (1, cv2.COLOR_GRAY2BGR),
    "mono16": (2, cv2.COLOR_GRAY2BGR),
    "bgr8": (3, None),
    "8uc3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
}


def unread(message: Any) -> str:
    """Why the pictures of a topic with such a message are not read; "" if they are."""
    if hasattr(message, "encoding"):
        known = message.encoding.lower() in _ENCODINGS
        return "" if known else f"encoding {message.encoding}, no picture of 8 bits (depths, perhaps)"
    return f"format {message.format}" if "compresseddepth" in message.format.lower() else ""


def bgr(message: Any) -> np.ndarray | None:
    """(H, W, 3) u1 of a message; None where it holds no picture, or less than it says."""
    try:
        if not hasattr(message, "encoding"):
            return cv2.imdecode(message.data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        size, conversion = _ENCODINGS[message.encoding.lower()]
        rows = message.data[: message.height * message.step].reshape(message.height, message.step)
        pixels = rows[:, : size * message.width].reshape(message.height, message.width, size)
        if message.encoding.lower() == "mono16":  # as cv_bridge does it: of the whole range
            pixels = pixels[:, :, :1] if message.is_bigendian else pixels[:, :, 1:]
        return pixels if conversion is None else cv2.cvtColor(np.ascontiguousarray(pixels), conversion)
    except (KeyError, ValueError, cv2.error):
        return None
