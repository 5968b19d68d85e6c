"""Semi-global matching in plain NumPy, pixel by pixel: what the native kernels must give, bit by bit."""

from __future__ import annotations

import numpy as np

BLOCK = 16
# The four predecessors (dx, dy) of the downward sweep; the upward one mirrors them.
PATHS = ((-1, -1), (0, -1), (1, -1), (-1, 0))


def census(image, radius_x, radius_y):
    """(H, W, bits) bool: whether each pixel of the window is not brighter than its centre."""
    h, w = image.shape
    padded = np.pad(image, ((radius_y, radius_y), (radius_x, radius_x)), mode="edge")
    bits = [
        padded[radius_y + dy : radius_y + dy + h, radius_x + dx : radius_x + dx + w] <= image
        for dy in range(-radius_y, radius_y + 1)
        for dx in range(-radius_x, radius_x + 1)
        if (dx, dy) != (0, 0)
    ]
    return np.stack(bits, axis=-1)


def costs_of(left, right, first, count, options, mutual=None):
    """[y][x] -> (count[y, x],) int costs of the disparities from first[y, x] on."""
    a, b = (census(i, options.radius_x, options.radius_y) for i in (left, right))
    outside = a.shape[2] * 2 // 3
    h, w = left.shape
    result = [[np.zeros(0, int)] * w for _ in range(h)]
    for y in range(h):
        for x in range(w):
            column = x - first[y, x] - np.arange(count[y, x])
            inside = (column >= 0) & (column < right.shape[1])
            safe = np.clip(column, 0, right.shape[1] - 1)
            cost = (a[y, x] != b[y, safe]).sum(axis=-1)
            if options.mode:
                said = mutual[left[y, x], right[y, safe]].astype(int)
                cost = said if options.mode == 2 else (cost + said + 1) // 2
            result[y][x] = np.where(inside, cost, outside)
    return result


def large_penalty(left, options, y, x, yq, xq):
    """P2 between two pixels of the left image."""
    table = options.large_by_step or [options.large] * 16
    return table[min(abs(int(left[y, x]) - int(left[yq, xq])) >> 2, 15)]


def message(line, small, large):
    """What a pixel tells its successor: (n,) int of its path costs (n,)."""
    near = np.minimum(np.append(line[1:], 255), np.insert(line[:-1], 0, 255)) + small
    return np.minimum(np.minimum(line, near) - line.min(), large)


def totals(left, costs, first, options):
    """[y][x] -> (n,) int: path costs of all eight directions summed, those of the first four rounded up to even."""
    h, w = left.shape
    total = [[8 * c for c in row] for row in costs]
    for sign in (1, -1):
        if sign < 0:
            total = [[t + (t & 1) for t in row] for row in total]
        for dx, dy in PATHS:
            told = {}
            for y in range(h)[::sign]:
                for x in range(w)[::sign]:
                    xq, yq = x + sign * dx, y + sign * dy
                    n = len(costs[y][x])
                    part = np.zeros(n, int)
                    if (yq, xq) in told:
                        at = first[y, x] + np.arange(n) - first[yq, xq]
                        source = told[yq, xq]
                        inside = (at >= 0) & (at < len(source))
                        part = np.where(inside, source[np.clip(at, 0, len(source) - 1)], options.large)
                        part = np.minimum(part, large_penalty(left, options, y, x, yq, xq))
                    total[y][x] = total[y][x] + part
                    told[y, x] = message(costs[y][x] + part, options.small, options.large)
    return total


def match(left, right, first, count, options, mutual=None):
    """(disparity (H, W) f4, smallest total cost (H, W) u2); first and count (H, W) are the range of each pixel."""
    h, w = left.shape
    total = totals(left, costs_of(left, right, first, count, options, mutual), first, options)
    best = np.array([[np.argmin(t) for t in row] for row in total]).reshape(h, w)
    score = np.array([[t.min() for t in row] for row in total], np.uint16).reshape(h, w)
    disparity = np.full((h, w), np.nan, np.float32)
    whole = best + first
    alone = np.ones((h, w), bool)
    for y in range(h):
        for x in range(w):
            t, k = total[y][x], best[y, x]
            part = np.float32(0)
            if 0 < k < len(t) - 1:
                before, at, after = (np.float32(v) for v in t[k - 1 : k + 2])
                bend = before + after - 2 * at if options.parabola else max(before, after) - at
                part = (before - after) / (2 * bend) if bend > 0 else part
            disparity[y, x] = np.float32(whole[y, x]) + part
            rivals = np.delete(t, np.arange(max(k - 1, 0), min(k + 2, len(t))))
            if options.uniqueness and (rivals * (100 - options.uniqueness) < t[k] * 100).any():
                alone[y, x] = False
    return _checked(disparity, np.where(alone, whole, -32768), whole, score, right.shape[1], options), score


def _checked(disparity, kept, whole, score, right_width, options):
    result = disparity.copy()
    for y in range(len(whole)):
        winner = {}
        for x in range(whole.shape[1]):
            key = (int(score[y, x]), int(whole[y, x]))
            at = x - whole[y, x]
            winner[at] = min(winner.get(at, key), key)
        for x in range(whole.shape[1]):
            at = x - whole[y, x]
            fails = options.left_right >= 0 and (
                not 0 <= at < right_width or abs(winner[at][1] - whole[y, x]) > options.left_right
            )
            if kept[y, x] == -32768 or fails:
                result[y, x] = np.nan
    return result
