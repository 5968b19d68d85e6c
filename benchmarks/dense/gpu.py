"""The matcher on a GPU beside the native module: same bits, milliseconds, disparities a second.

python -m benchmarks.dense.gpu save PAIRS.npz      # where the measuring data are: rendered pairs of 1.3 and 5 MP
python -m benchmarks.dense.gpu run PAIRS.npz -o benchmarks/results/dense_gpu.json
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.dense import cuda, tsgm
from tiegraph.dense.tuning import TsgmTuning

SIZES = {"1224 x 1024, 256": (1224, 1024, 256), "2448 x 2048, 512": (2448, 2048, 512)}
REPEATS = 15


def save(path: Path) -> None:
    """Rendered pairs of ``benchmarks.dense.data``, as the dense engine hands them to its matcher."""
    from benchmarks.dense.data import rendered

    root = Path(os.environ.get("TIEGRAPH_DATA", "../shared/data"))

    arrays = {}
    for name, (width, height, disparities) in SIZES.items():
        pair = rendered(root / "stereo_gt", width, height, disparities)
        arrays[name + " left"], arrays[name + " right"] = pair.left, pair.right
    np.savez_compressed(path, **arrays)


def median_ms(work: Callable[[], object], repeats: int, wait: Callable[[], None] = lambda: None) -> float:
    """Median of ``repeats`` after one that does not count."""
    times = []
    for _ in range(repeats + 1):
        wait()
        begin = time.perf_counter()
        work()
        wait()
        times.append(1e3 * (time.perf_counter() - begin))
    return statistics.median(times[1:])


def by_kernel(device: cuda.Matcher, work: Callable[[], object]) -> dict[str, float]:
    """Milliseconds of each kernel in one call of ``work``, by the device's own clock."""
    stream = device.xp.cuda
    spans: list[tuple[str, Any, Any]] = []
    get = device._module.get_function

    class Timed:
        def get_function(self, name: str) -> Callable[..., None]:
            def launch(*args: Any, **more: Any) -> None:
                begin, end = stream.Event(), stream.Event()
                begin.record()
                get(name)(*args, **more)
                end.record()
                spans.append((name, begin, end))

            return launch

    module, device._module = device._module, Timed()
    try:
        work()
        stream.runtime.deviceSynchronize()
    finally:
        device._module = module
    total: dict[str, float] = defaultdict(float)
    for name, begin, end in spans:
        total[name] += stream.get_elapsed_time(begin, end)
    return {name: round(ms, 3) for name, ms in sorted(total.items(), key=lambda item: -item[1])}


def measure(name: str, left: np.ndarray, right: np.ndarray, device: cuda.Matcher) -> dict[str, Any]:
    """One pair: the pyramid, and one match over all disparities at full size."""
    disparities = SIZES[name][2]
    wait = device.xp.cuda.runtime.deviceSynchronize
    cpu = TsgmTuning(kernel=tsgm.kernels()[0])
    row: dict[str, Any] = {"pair": name, "native kernel": cpu.kernel}

    def pyramid(tuning: TsgmTuning) -> np.ndarray:
        return tsgm.match(left, right, 0, disparities, tuning)

    found, expected = pyramid(TsgmTuning()), pyramid(cpu)
    row["pyramid equal"] = bool(np.array_equal(found.view(np.uint32), expected.view(np.uint32))) or int(
        ((found != expected) & ~(np.isnan(found) & np.isnan(expected))).sum()
    )
    row["pyramid native ms"] = median_ms(lambda: pyramid(cpu), 3)
    row["pyramid gpu ms"] = median_ms(lambda: pyramid(TsgmTuning()), REPEATS, wait)
    row["pyramid by kernel"] = by_kernel(device, lambda: pyramid(TsgmTuning()))

    options = tsgm._options(TsgmTuning(), tsgm._CENSUS)
    strips = tsgm._strips(np.full(len(left), left.shape[1] * disparities), TsgmTuning().strip_overlap_px)
    a, b = device.upload(left), device.upload(right)

    def full() -> object:
        return device.match_dense(a, b, (0, disparities), options, None, strips)

    row["full gpu ms"] = median_ms(full, REPEATS, wait)
    row["full by kernel"] = by_kernel(device, full)
    row["full gpu Gdisp/s"] = a.size * disparities / row["full gpu ms"] / 1e6
    native = tsgm._Native()
    row["full native ms"] = median_ms(
        lambda: native.match_dense(left, right, (0, disparities), options, None, strips), 1
    )
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["save", "run"])
    parser.add_argument("pairs", type=Path)
    parser.add_argument("-o", "--out", type=Path)
    args = parser.parse_args()
    if args.what == "save":
        return save(args.pairs)
    device = cuda.matcher()
    if device is None:
        raise SystemExit("no GPU with CuPy here")
    rows = []
    with np.load(args.pairs) as pairs:
        for name in SIZES:
            rows.append(measure(name, pairs[name + " left"], pairs[name + " right"], device))
            sys.stdout.write(json.dumps(rows[-1], indent=1) + "\n")
    if args.out:
        args.out.write_text(json.dumps({"device": cuda.device_name(), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
