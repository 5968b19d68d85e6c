"""Results of a finished run: `python examples/read_results.py tiegraph_demo` after `tiegraph demo`.

Nothing runs here: a project without images is the one that its run folder remembers.
"""

import sys

import numpy as np

import tiegraph


def main(out: str) -> None:
    """Print what model, cloud and receipts say."""
    project = tiegraph.open(out=out)
    registered = project.registered()
    print(f"{len(registered)} of {len(project.scene())} images are registered")
    model = project.model()  # a pycolmap.Reconstruction
    print(f"{model.num_points3D()} sparse points, {model.compute_mean_reprojection_error():.2f} px")
    cloud = project.cloud()
    print(f"{len(cloud)} points, median sigma {np.nanmedian(cloud.sigma_m):.4f} m")
    for stage in ("sparse", "georef"):
        receipt = project.receipt(stage)
        for sentence in (*receipt.get("contradictions", ()), *receipt["notes"]):
            print(f"{stage}: {sentence}")
    print(f"report: {project.report()}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tiegraph_demo")
