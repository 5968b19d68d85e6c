"""Makes the pictures of the README from a run of the example survey: `python docs/pictures.py tiegraph_demo`."""

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np

import tiegraph
from tiegraph.report.cloudview import standard_views

FOLDER = Path(__file__).with_name("pictures")
WIDTH, QUALITY = 1100, 86


def main(out: Path) -> None:
    """The tie graph as the stage design drew it, and an oblique view of the cloud."""
    shutil.copyfile(out / "design" / "map.png", FOLDER / "tie_graph.png")
    project = tiegraph.open(out=out)
    cloud = project.cloud()
    centres = [image.projection_center() for image in project.model().images.values()]
    view = standard_views(np.asarray(cloud.xyz_m), np.asarray(cloud.rgb), np.array(centres), WIDTH)[1]
    cv2.imwrite(str(FOLDER / "cloud.jpg"), view.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
