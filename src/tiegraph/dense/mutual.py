"""Matching cost of mutual information (Hirschmueller 2008, section 2.1; paper 004, section 5.2.3)."""

from __future__ import annotations

import cv2
import numpy as np

from tiegraph.dense.tuning import TsgmTuning

_SMOOTHING_PX = 7  # window of the Gaussian that stands for the Parzen estimate, as in Hirschmueller 2008
_WORST = 62  # the largest cost, that of two census windows of 9 x 7 which differ everywhere


def mutual_information(joint: np.ndarray, tuning: TsgmTuning) -> np.ndarray:
    """Cost (256, 256) u1 of a left and a right grey value, from how often each two lie upon each other (256, 256). 0 =
    the most telling combination, _WORST = the least.
    """
    count = joint.astype(np.float32)
    share = count / max(1, joint.sum())
    entropy = _information(share)
    gain = entropy - _information(share.sum(axis=1))[:, None] - _information(share.sum(axis=0))[None, :]
    tail = tuning.mutual_tail_percent
    low, high = np.percentile(gain[count > 0], [tail, 100 - tail]) if count.any() else (0.0, 1.0)
    scaled = (gain - low) / max(high - low, 1e-6) * (tuning.mutual_span * _WORST)
    return np.clip(np.rint(scaled), 0, _WORST).astype(np.uint8)


def _information(share: np.ndarray) -> np.ndarray:
    """-log of smoothed probabilities, smoothed (Hirschmueller 2008, equations 5 and 6)."""
    window = (_SMOOTHING_PX, _SMOOTHING_PX if share.ndim == 2 else 1)
    flat = share.astype(np.float32) if share.ndim == 2 else share.astype(np.float32)[None, :]
    smooth = cv2.GaussianBlur(flat, window if share.ndim == 2 else (_SMOOTHING_PX, 1), 0)
    result = cv2.GaussianBlur(-np.log(np.maximum(smooth, 1e-9)), window, 0)
    return result if share.ndim == 2 else result[0]
