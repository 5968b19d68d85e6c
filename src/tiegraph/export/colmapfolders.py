"""Folders that are COLMAP's, or written from its model: COLMAP, 3D Gaussian splatting, OpenMVS, Bundler."""

from pathlib import Path

from tiegraph.export.survey import Survey, write_offset
from tiegraph.scene.colmapmodel import matrix


def sparse(survey: Survey, target: Path) -> int:
    """``sparse/0``, binary and text; the number of images."""
    return _model(survey, target, "sparse/0", ("binary", "text"))


def openmvs(survey: Survey, target: Path) -> int:
    """``sparse`` as text, which is what InterfaceCOLMAP reads; the number of images."""
    return _model(survey, target, "sparse", ("text",))


def _model(survey: Survey, target: Path, folder: str, forms: tuple[str, ...]) -> int:
    (target / folder).mkdir(parents=True)
    for form in forms:
        getattr(survey.model, f"write_{form}")(str(target / folder))
    write_offset(survey, target)
    return len(survey.images())


def bundler(survey: Survey, target: Path) -> int:
    """``bundle.out`` (v0.3) and ``list.txt``; the number of images. Its cameras look along -z with y up, pixels count
    from the middle of the image."""
    images, model = survey.images(), survey.model
    number = {image.image_id: k for k, image in enumerate(images)}
    lines = ["# Bundle file v0.3", f"{len(images)} {len(model.points3D)}"]
    for image in images:
        pose = matrix(image.cam_from_world())[:3] * [[1], [-1], [-1]]
        lines.append(f"{model.camera(image.camera_id).mean_focal_length()!r} 0 0")
        lines += [" ".join(repr(float(v)) for v in row) for row in (*pose[:, :3], pose[:, 3])]
    for _, point in sorted(model.points3D.items()):
        views = []
        for element in point.track.elements:
            image = model.image(element.image_id)
            camera, (x, y) = model.camera(image.camera_id), image.points2D[element.point2D_idx].xy
            place = f"{x - camera.width / 2:.4f} {camera.height / 2 - y:.4f}"
            views.append(f"{number[element.image_id]} {element.point2D_idx} {place}")
        lines += [" ".join(repr(float(v)) for v in point.xyz), " ".join(map(str, point.color))]
        lines.append(" ".join([str(len(views)), *views]))
    (target / "bundle.out").write_text("\n".join([*lines, ""]), encoding="ascii")
    (target / "list.txt").write_text("".join(f"images/{image.name}\n" for image in images), encoding="utf-8")
    write_offset(survey, target)
    return len(images)
