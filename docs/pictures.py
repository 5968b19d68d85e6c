"""Makes the pictures of the README, and that of docs/mesh.md if the run has a mesh, from a run of the example survey:
`python docs/pictures.py tiegraph_demo`; the orthophoto of any surface and its heights beside each other:
`python docs/pictures.py OUT/products/map NAME`."""

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np

import tiegraph
from tiegraph.geometry.transforms import rigid
from tiegraph.mesh.views import fragments
from tiegraph.report.cloudview import standard_views

FOLDER = Path(__file__).with_name("pictures")
WIDTH, QUALITY = 1100, 86


def main(out: Path) -> None:
    """The tie graph as the stage design drew it, and an oblique view of the cloud."""
    shutil.copyfile(out / "design" / "map.png", FOLDER / "tie_graph.png")
    project = tiegraph.open(out=out)
    cloud = project.cloud()
    centres = [image.projection_center() for image in project.model().images.values()]
    _, view, _ = standard_views(np.asarray(cloud.xyz_m), np.asarray(cloud.rgb), np.array(centres), WIDTH)[1]
    cv2.imwrite(str(FOLDER / "cloud.jpg"), view[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if (out / "mesh" / "mesh.glb").exists():
        picture = mesh_view(out / "mesh" / "mesh.glb", np.array(centres))
        cv2.imwrite(str(FOLDER / "mesh.jpg"), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])


def sheet(surface: Path, name: str) -> None:
    """The orthophoto of a surface (its folder) and the heights of its terrain, or of itself, beside each other."""
    heights = next(surface / f for f in ("dtm.jpg", "dsm.jpg") if (surface / f).exists())
    parts = [cv2.imread(str(p), cv2.IMREAD_COLOR) for p in (surface / "overview.jpg", heights)]
    wide = WIDTH // 2
    parts = [cv2.resize(p, (wide, round(p.shape[0] * wide / p.shape[1])), None, 0, 0, cv2.INTER_AREA) for p in parts]
    out = np.full((max(len(p) for p in parts), 2 * wide, 3), 255, np.uint8)
    for k, part in enumerate(parts):
        out[: len(part), k * wide : (k + 1) * wide] = part
    cv2.imwrite(str(FOLDER / f"{name}.jpg"), out, [cv2.IMWRITE_JPEG_QUALITY, 80])


def mesh_view(
    path: Path, centres: np.ndarray, size: tuple[int, int] = (WIDTH, 620), focal: float = 560.0
) -> np.ndarray:
    """RGB (H, W, 3) u1 of a GLB file as seen by somebody who follows the cameras (N, 3) and looks to their right."""
    import trimesh

    middle = centres.mean(axis=0)
    along = np.linalg.svd(centres - middle)[2][0]
    side = np.cross(along, [0.0, 0.0, 1.0])
    z = 14 * side + 6 * along
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z])
    pose = rigid(turn, -turn @ (middle - 10 * along))
    depth, out = np.full(size[::-1], np.inf), np.full((*size[::-1], 3), 255, np.uint8)
    for part in trimesh.load(path, process=False).dump():
        xyz = np.stack([part.vertices[:, 0], -part.vertices[:, 2], part.vertices[:, 1]], axis=1)  # z up
        seen = xyz @ pose[:3, :3].T + pose[:3, 3]
        faces = part.faces[(seen[part.faces, 2] > 0.5).all(axis=1)]
        xy = focal * seen[:, :2] / seen[:, 2:] + np.array(size) / 2
        picture = np.asarray(part.visual.material.baseColorTexture)[..., :3]
        for drawn in fragments(xy[faces], size[::-1]):
            corners = faces[drawn.triangle]
            weight = drawn.weight / seen[corners, 2]
            far = 1 / weight.sum(axis=1)
            uv = np.einsum("nk,nkc->nc", weight * far[:, None], part.visual.uv[corners])
            pixel = np.clip(np.stack([1 - uv[:, 1], uv[:, 0]], axis=1), 0, 1 - 1e-9) * picture.shape[:2]
            order = np.argsort(-far, kind="stable")
            order = order[far[order] < depth[drawn.row[order], drawn.column[order]]]
            at = drawn.row[order], drawn.column[order]
            depth[at], out[at] = far[order], picture[tuple(pixel[order].astype(int).T)]
    return out


if __name__ == "__main__":
    (main if len(sys.argv) == 2 else sheet)(Path(sys.argv[1]), *sys.argv[2:])
