"""Glue of single shots: a point cloud for each shot of a calibrated rig, without any sparse model (shots); the cloud of
each posed shot from its rig's frame into the world of the georeferenced model; and clouds of shots without poses joined
to one filtered cloud, in a folder of its own (stations).
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.cloud.fuse import MapPoints, Maps, fuse, fuse_points
from tiegraph.cloud.settings import CloudSettings
from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.plan import CameraModel, DepthRange, ViewPlan
from tiegraph.dense.shot import Seen, ShotScale, depth_range, in_camera, plan_shot, shot_scale
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.pipeline.clouds import new_folder
from tiegraph.pipeline.dense import colours
from tiegraph.pipeline.files import load_map, load_model, whole, world_origin, world_unit
from tiegraph.project.folder import must_be_empty
from tiegraph.project.progress import Reporter
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings, VerbTunings
from tiegraph.project.stages import Outcome, save_json
from tiegraph.scene.atomic import replacing, scratch_folder
from tiegraph.scene.cloudfile import read_cloud, shift_of, write_cloud
from tiegraph.scene.colmapmodel import image_poses, tracks
from tiegraph.scene.composed import carries
from tiegraph.scene.names import shortened
from tiegraph.scene.posefile import read_poses, write_tum
from tiegraph.scene.results import save_depth
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, rig_from_sensor
from tiegraph.stations.joined import Band, Joined, by_distance, join, prepared
from tiegraph.stations.pairs import Pair, Shot, Station, spacing_of
from tiegraph.text import command, finite

_FOLDER = "shots"
ENDINGS = (".ply", ".las", ".laz")


def shots(run: Run) -> Outcome:
    """One cloud a shot (``shots/<pass>_<number>.ply``, in the frame of the rig's first camera) and its depth maps.

    Finished shots are skipped. Raises InputError for a rig whose cameras are not all calibrated.
    """
    scene = whole(run)
    for frame in range(scene.frames):
        _range_of(scene, frame, run.settings)
    todo = [frame for frame in range(scene.frames) if not cloud_path(run.folder, scene, frame).exists()]
    run.reporter.total(scene.frames, scene.frames - len(todo))
    run.map(_shot, todo, scene, run.folder, run.settings)
    return Outcome({"shots": scene.frames})


def _range_of(scene: Scene, frame: int, settings: Settings) -> DepthRange:
    return depth_range(shot_views(scene, frame), settings.shots.near_m, settings.shots.far_m)


def shot_views(scene: Scene, frame: int) -> list[ViewPlan]:
    """The images of one frame with the poses of their sensors in the rig's frame: the dependent ones, if there are any.

    Raises InputError for a sensor without intrinsics or pose in the rig.
    """
    views, own = [], carries(scene)
    for image in np.flatnonzero((scene.frame == frame) & (own.all() | ~own)):
        sensor = scene.sensor_of(int(image))
        if sensor.sensor_from_rig is None or not np.isfinite(sensor.sensor_from_rig).all():
            raise InputError(f"sensor {sensor.name}: its pose in the rig is unknown; a shot needs it (rig.toml)")
        if sensor.camera is None or not sensor.camera.has_prior_focal_length:
            raise InputError(f"sensor {sensor.name}: its intrinsics are unknown; a shot needs them (rig.toml)")
        views.append(ViewPlan(scene.names[image], CameraModel.of(sensor.camera), sensor.sensor_from_rig))
    return views


def cloud_path(folder: Path, scene: Scene, frame: int) -> Path:
    """The file of a frame's cloud."""
    sequence = int(scene.sequence[frame])
    name = shortened(scene.sequences[sequence].replace("/", "_")) if sequence >= 0 else "shot"
    return folder / _FOLDER / f"{name}_{frame:06d}.ply"


def _shot(frame: int, scene: Scene, folder: Path, settings: Settings) -> None:
    path = cloud_path(folder, scene, frame)
    dense, tuning, images = settings.dense, settings.tuning.dense, folder / "images"
    plan = plan_shot(shot_views(scene, frame), _range_of(scene, frame, settings), dense, tuning)
    masks = folder / "masks" if (folder / "masks").is_dir() else None
    first = {n: depth_map(p, images, masks, dense, tuning, cv2.getNumThreads()) for n, p in plan.images.items()}
    for name, image in plan.images.items():
        save_depth(confirmed_map(image, first[name], first.get, dense, tuning)[0], depth_path(folder, name))
    drawn = partial(colours, plans=plan.images, images=images, settings=dense)
    maps = Maps(lambda name: load_map(depth_path(folder, name)), drawn)
    tiles = folder / _FOLDER / ".tiles"
    tiles.mkdir(parents=True, exist_ok=True)
    with scratch_folder(tiles) as scratch:
        try:
            fused = fuse(sorted(plan.images), maps, scratch, settings.cloud, settings.tuning.cloud)
        except ReconstructionError as error:
            raise ReconstructionError(f"{path.stem}: {error}") from None
        with replacing(path) as temporary:
            write_cloud(fused.clouds(), temporary)


def depth_path(folder: Path, name: str) -> Path:
    """The file of the depth map of an image of a shot."""
    return folder / _FOLDER / "depth" / f"{name}.npz"


def posed_shots(run: Run, folder: Path) -> tuple[list[Path], str]:
    """Write the clouds of the shots whose frames have a pose to ``folder`` as LAZ, and the poses as ``poses.tum`` (time
    = number of the shot, metres), the start values of `tiegraph stations`; the clouds, and notes.

    A model without scale gets that of the shots. Raises InputError without shots, poses or metres, and for a folder
    that exists and is not empty.
    """
    scene = whole(run)
    frames = [f for f in range(scene.frames) if cloud_path(run.folder, scene, f).exists()]
    if not frames:
        raise InputError(f"{run.folder} has no shots: run `tiegraph shots` first")
    if not run.path("world.json").exists() or not run.path("sparse", "world").exists():
        raise InputError(
            f"--posed {folder}: {run.folder} has no poses in the world yet: "
            f"`{command('run', 'IMAGES', '-o', run.folder, '--rig', 'RIG', '--until', 'georef')}` makes them"
        )
    must_be_empty(folder, "--posed")
    model = load_model(run.path("sparse", "world"))
    poses = np.where(carries(scene)[:, None, None], image_poses(model, scene), np.nan)
    unit, said = 1.0, ""
    if world_unit(run.folder) != "m":
        found = _scale_by_shots(run, scene, model, poses)
        if found is None:
            raise InputError(
                f"--posed {folder}: the model of {run.folder} has no scale, but shots are in metres: determine it by "
                "the rig, positions, control points or scale bars; its own points do not lie on the shots either"
            )
        unit = found.metres_per_unit
        said = (
            f"the model had no scale: {unit:.6g} m a unit by {found.points} of its points on the depth maps of "
            f"{found.shots} shots (relative sigma {found.sigma:.2g})"
        )
    world_from_rig = frame_poses(poses, scene, unit)
    world_from_rig[:, :3, 3] *= unit
    written = _write(run, folder, {f: world_from_rig[f] for f in frames}, scene)
    if not written:
        raise InputError(f"--posed {folder}: none of the {len(frames)} shots has a pose in {run.folder}")
    write_tum(folder / "poses.tum", np.array(frames, float), world_from_rig[frames])
    return written, said


def _write(run: Run, folder: Path, poses: dict[int, np.ndarray], scene: Scene) -> list[Path]:
    origin, written = world_origin(run.folder), []
    for frame, pose in poses.items():
        if np.isfinite(pose).all():
            source = cloud_path(run.folder, scene, frame)
            cloud = read_cloud(source)
            written.append(folder / f"{source.stem}.laz")
            write_cloud(replace(cloud.moved(pose), origin=origin), written[-1], float(np.nanmedian(cloud.sigma_m)))
    return written


def _scale_by_shots(run: Run, scene: Scene, model: Any, poses: np.ndarray) -> ShotScale | None:
    """Metres in a unit of a model by the depth maps of its shots; None if it has no points on them."""
    xyz, image, point = tracks(model, scene)
    mounted = rig_from_sensor(scene)
    seen = []
    for k in np.flatnonzero(np.isfinite(poses).all(axis=(1, 2))):
        frame, local = int(scene.frame[k]), in_camera(poses[k], xyz[point[image == k]])
        for view in shot_views(scene, frame):
            path = depth_path(run.folder, view.name)
            if path.exists():
                seen.append(Seen(shot=frame, points=local, rig_from_camera=mounted[k], depth=load_map(path)))
    return shot_scale(seen)


def stations(
    sources: Sequence[Path],
    out: Path,
    poses: Path | None = None,
    voxel_m: float = 0.0,
    reporter: Reporter | None = None,
    tunings: VerbTunings | None = None,
) -> dict[str, Any]:
    """Join clouds of shots and write poses, one cloud and stations.json to the new folder ``out``; the content of the
    latter. ``poses``: a TUM file of prior ones; ``voxel_m``: the spacing of the cloud, 0 = by the shots.

    Raises InputError for clouds and poses that cannot be used; ReconstructionError if nothing joins.
    """
    reporter, tunings = reporter or Reporter("quiet"), tunings or VerbTunings()
    tuning = tunings.stations
    if not 0 <= voxel_m < np.inf:
        raise InputError(f"--voxel-m {voxel_m:g}: give metres above 0, or 0 for the spacing of the shots")
    files = cloud_files(sources)
    with new_folder(out) as folder:
        assert folder is not None
        with reporter.stage("read"):
            shots, origin, spacing_m = _read(files)
            shots = shots if poses is None else _with_poses(shots, poses)
        try:
            with reporter.stage("join"):
                ready, unfit = prepared(shots, tuning)
                joined = join(ready, tuning, lambda done, most: reporter.total(most, done))
        except ValueError as error:
            raise ReconstructionError(f"{error}: nothing is written; stations must share surface with shape, 30 % at "
                                      "least") from None  # fmt: skip
        told = _told_of(files, ready, joined, unfit, by_distance(ready, joined.poses, joined.believed, tuning))
        with reporter.stage("merge"), scratch_folder(folder) as scratch:
            path = {s.name: p for s, p in zip(ready, joined.poses) if np.isfinite(p).all()}
            known = {file.stem: file for file in files}
            voxel = voxel_m or spacing_m
            # Sigma of points without one
            noise = [p.residual_m / np.sqrt(2) for p in joined.believed] or [s.levels[-1].rough for s in ready]
            # The clouds added up by voxel, weighted by their sigmas, and filtered (SOR and radius) as those of a run
            points = partial(_points, files=known, poses=path, noise=float(np.median(noise)), voxel=voxel)
            merged = fuse_points(sorted(path), points, scratch, CloudSettings(voxel_size=voxel), tunings.cloud)
            assert merged is not None  # no cloud is empty
            notes = write_cloud((replace(c, origin=origin) for c in merged.clouds()), folder / "cloud.laz", voxel)
        first = ready[int(np.flatnonzero(np.isfinite(joined.poses[:, 0, 0]))[0])].name
        frame = f"that of {first}" if poses is None else f"the world of {poses.name}"
        frame = frame if origin is None else f"the world: {_called(origin)}"
        result = {**told, "frame": frame, "voxel_m": voxel, "cloud": merged.counts, "tuning": tunings.changed()}
        result["notes"] = list(notes)
        numbers = pose_numbers([s.name for s in ready])
        write_tum(folder / "stations.tum", np.array(numbers, float), joined.poses)
        save_json(folder / "stations.json", result)
    return result


def cloud_files(sources: Sequence[Path]) -> list[Path]:
    """Files of clouds: those named, and of a folder (of a run: its ``shots``) all in it, by name.

    Raises InputError if there are fewer than two, or two of one name.
    """
    files: list[Path] = []
    for source in sources:
        if source.is_dir():
            folder = source / "shots" if (source / "shots").is_dir() else source
            there = sorted(f for f in folder.iterdir() if f.suffix.lower() in ENDINGS)
            if not there:
                raise InputError(f"{folder}: no clouds in it ({', '.join(ENDINGS)}): `tiegraph shots` makes them")
            files += there
        elif source.suffix.lower() in ENDINGS and source.exists():
            files.append(source)
        else:
            raise InputError(f"{source}: give a folder of clouds, or files that end in {', '.join(ENDINGS)}")
    names = [f.stem for f in files]
    again = next((n for n in names if names.count(n) > 1), None)
    if again is not None:
        raise InputError(f"{again}: two clouds have this name: give each its own")
    if len(files) < 2:
        raise InputError(f"{files[0]}: the only cloud; there is nothing to register it to: give two at least")
    return files


def pose_numbers(names: Sequence[str]) -> list[int]:
    """The time of each cloud in a TUM file: the last number in its name; its place in the order, from 0, if these
    numbers are not unique."""
    found = [re.findall(r"\d+", name) for name in names]
    numbers = {int(digits[-1]): None for digits in found if digits}
    return list(numbers) if len(numbers) == len(names) else list(range(len(names)))


def _read(files: Sequence[Path]) -> tuple[list[Shot], Origin | None, float]:
    """The shots, their world if some have one (None = none has), and the spacing of the usual point, two digits."""
    shots, spacings, origin, first = [], [], None, files[0]
    for file in files:
        cloud = read_cloud(file)
        if not len(cloud):
            raise InputError(f"{file}: it has no points: leave it out, or make it again")
        lost = int(np.count_nonzero(~np.isfinite(cloud.xyz_m).all(axis=1)))
        if lost:
            raise InputError(f"{file}: {lost} points have no coordinates (NaN or infinite): remove them")
        known = None
        if cloud.origin is not None:
            if origin is None:
                origin, first = cloud.origin, file
            places = [(o.lat_deg, o.lon_deg, o.height_m) if o.crs == ENU else () for o in (origin, cloud.origin)]
            if not (origin.crs == cloud.origin.crs and places[0] == places[1]):
                raise InputError(
                    f"{file} is in {_called(cloud.origin)} and {first} in {_called(origin)}: bring all into one CRS"
                )
            known = transforms.rigid(np.eye(3), shift_of(cloud.origin) - shift_of(origin))
        spacings.append(float(np.median(spacing_of(cloud.xyz_m, known is None))))
        some = slice(None, None, -(-len(cloud) // 400_000))
        normal, sigma = cloud.normal[some].astype(float), cloud.sigma_m[some].astype(float)
        oriented = normal if np.isfinite(normal).all(axis=1).mean() > 0.5 else None
        shots.append(Shot(file.stem, cloud.xyz_m[some], oriented, sigma_m=sigma, known=known, own_frame=known is None))
    return shots, origin, float(f"{max(np.median(spacings), 1e-9):.2g}")


def _called(origin: Origin) -> str:
    return f"ENU about {origin.lat_deg:.6f}, {origin.lon_deg:.6f}" if origin.crs == ENU else origin.crs


def _with_poses(shots: list[Shot], path: Path) -> list[Shot]:
    """Shots with the prior poses of a file, by their numbers. Raises InputError for rows without a shot."""
    posed = next((s for s in shots if s.known is not None), None)
    if posed is not None:
        raise InputError(f"--poses {path}: {posed.name} is in a world already (it names a CRS): omit --poses")
    found = read_poses(path)
    numbers = {n: k for k, n in enumerate(pose_numbers([s.name for s in shots]))}
    times = found.time_s if np.isfinite(found.time_s).all() else np.arange(len(found.poses))
    out = list(shots)
    for time, pose in zip(times, found.poses):
        if round(time) not in numbers or abs(time - round(time)) > 1e-6:
            known = ", ".join(map(str, sorted(numbers)[:5]))
            raise InputError(f"--poses {path}: no cloud has the number {time:g}: the clouds are numbered {known}, ...")
        k = numbers[round(time)]
        out[k] = replace(shots[k], known=pose)
    return out


def _points(
    name: str, files: dict[str, Path], poses: dict[str, np.ndarray], noise: float, voxel: float
) -> list[MapPoints]:
    cloud, pose = read_cloud(files[name]), poses[name]
    sigma = np.where(np.isfinite(cloud.sigma_m) & (cloud.sigma_m > 0), cloud.sigma_m, noise).astype(np.float32)
    moved = replace(cloud.moved(pose), sigma_m=sigma, views=np.maximum(cloud.views, 1))
    return [(moved, np.maximum(spacing_of(cloud.xyz_m, cloud.origin is None), voxel), 0)]


def _told_of(
    files: Sequence[Path], ready: Sequence[Station], joined: Joined, unfit: dict[str, str], bands: Sequence[Band]
) -> dict[str, Any]:
    number = {s.name: k for k, s in enumerate(ready)}
    loops = {(p.first, p.second): row for p, row in zip(joined.believed, joined.loop_m)}

    def cloud(name: str) -> dict[str, Any]:
        k = number.get(name)
        why = unfit[name] if k is None else joined.left_out.get(k, "")
        pairs = sum(k in (p.first, p.second) for p in joined.believed)
        sigma = np.nan if k is None else float(joined.sigma_m[k])
        return finite({"name": name, "joined": not why, "why_not": why, "pairs": pairs, "sigma_m": sigma})

    return {
        "clouds": [cloud(f.stem) for f in files],
        "pairs": [_pair_told(p, ready, loops.get((p.first, p.second), (None, None))) for p in joined.pairs],
        "precision": [finite(b.__dict__) for b in bands],
    }


def _pair_told(pair: Pair, ready: Sequence[Station], loop: Sequence[float | None]) -> dict[str, Any]:
    return {
        "first": ready[pair.first].name,
        "second": ready[pair.second].name,
        "believed": not pair.why_not,
        "why_not": pair.why_not,
        "overlap": pair.overlap,
        "residual_m": pair.residual_m,
        "sigma_m": None if pair.why_not else pair.sigma_m,
        "looked_through": pair.through if np.isfinite(pair.through) else None,
        "loop_before_m": loop[0],
        "loop_after_m": loop[1],
    }
